"""Pyomo.DoE: held levels of the fin for the largest determinant of the information, or trace.

Its equations are discretised by the trapezoidal rule, one step per sample, for
every parameter a little too large and a little too small; their differences, the
information and its Cholesky factor are variables of one nonlinear program.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from pathlib import Path

import numpy as np
import pyomo.environ as pyo
from pyomo.contrib.doe import DesignOfExperiments
from pyomo.contrib.parmest.experiment import Experiment

from benchmarks.peers.fits import used
from benchmarks.truth import NAMES, NOISE, TRUE, rates


class _Dive(Experiment):
    """The record to come: known start, bounded fin, pitch and depth."""

    def __init__(self, given: dict[str, np.ndarray]) -> None:
        self.given, self.model = given, None

    def get_labeled_model(self) -> pyo.ConcreteModel:
        if self.model is None:
            self.model = self._build()
        return self.model

    def _build(self) -> pyo.ConcreteModel:
        given = self.given
        times, owner, start = given["times"], given["owner"], given["start"]
        low, high = given["corridor"]
        model = pyo.ConcreteModel()
        model.value = pyo.Var(list(NAMES), initialize=dict(zip(NAMES, TRUE.tolist(), strict=True)))
        model.value.fix()
        reach = float(given["reach"])
        model.fin = pyo.Var(
            range(len(given["levels"])),
            bounds=(-reach, reach),
            initialize=lambda _, i: float(given["levels"][i]),
        )
        model.x = pyo.Var(
            range(1, len(times)),
            range(5),
            bounds=lambda _, i, j: (_finite(low[j]), _finite(high[j])),
            initialize=lambda _, i, j: float(given["guess"][i, j]),
        )

        def slope(i: int, held: int) -> list:
            x = [model.x[i, j] if i else float(start[j]) for j in range(5)]
            level = int(owner[held])
            fin = model.fin[level] if level >= 0 else 0.0
            p = [model.value[name] for name in NAMES]
            return rates(x, [fin, float(given["thrust"])], p, pyo.sin, pyo.cos)

        model.gap = pyo.ConstraintList()
        for i in range(len(times) - 1):
            half = float(times[i + 1] - times[i]) / 2
            here, there = slope(i, i), slope(i + 1, i)
            for j in range(5):
                before = model.x[i, j] if i else float(start[j])
                model.gap.add(model.x[i + 1, j] == before + half * (here[j] + there[j]))
        for label in (
            "experiment_outputs", "measurement_error", "experiment_inputs", "unknown_parameters",
        ):  # fmt: skip
            model.add_component(label, pyo.Suffix(direction=pyo.Suffix.LOCAL))
        for i in range(1, len(times)):
            for j in range(5):
                model.experiment_outputs[model.x[i, j]] = None
                model.measurement_error[model.x[i, j]] = float(NOISE[j])
        for level in model.fin.values():
            model.experiment_inputs[level] = None
        for name in given["free"]:
            model.unknown_parameters[model.value[str(name)]] = pyo.value(model.value[str(name)])
        return model


def _finite(bound: float) -> float | None:
    return float(bound) if np.isfinite(bound) else None


def main() -> None:
    """Design, and print levels, status and times as JSON."""
    with np.load(sys.argv[1]) as file:
        given = dict(file)
    solver = pyo.SolverFactory("ipopt")  # its default asks for MA57, which is not free
    for word in given["options"]:
        name, _, value = str(word).partition("=")
        solver.options[name] = value
    # Pyomo.DoE 6.10 names parameters of a model that it has dropped; large models are collected
    # before that, and it ends with an AttributeError.
    gc.disable()
    began, clock = used(), time.perf_counter()
    study = DesignOfExperiments(
        _Dive(given),
        objective_option=str(given["objective"]),
        scale_nominal_param_value=True,
        scale_constant_value=float(given["scale"]),
        step=float(given["step"]),
        solver=solver,
    )
    study.run_doe()
    found = study.results
    result = {
        "seconds": used() - began,
        "clock": time.perf_counter() - clock,
        "solve": found["Solve Time"],
        "status": str(found["Termination Message"]),
        "levels": [float(level) for level in found["Experiment Design"]],
        "value": float(np.linalg.slogdet(np.array(found["FIM"]))[1]),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    sys.path.insert(0, str(Path.cwd()))
    main()
