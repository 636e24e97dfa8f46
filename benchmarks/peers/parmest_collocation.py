"""Pyomo parmest: the discretised model as algebraic equations, solved by IPOPT."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pyomo.contrib.parmest.parmest as parmest
import pyomo.environ as pyo
from pyomo.contrib.parmest.experiment import Experiment

from benchmarks.peers.task import NAMES, NOISE, STEP, TRUE, load, rates, report, share


class _Dive(Experiment):
    """One record, trapezoidal rule between samples (inputs are held)."""

    def __init__(self, inputs: np.ndarray, outputs: np.ndarray) -> None:
        self.inputs, self.outputs, self.model = inputs, outputs, None

    def get_labeled_model(self) -> pyo.ConcreteModel:
        if self.model is None:
            self.model = self._build()
        return self.model

    def _build(self) -> pyo.ConcreteModel:
        n = len(self.outputs)
        model = pyo.ConcreteModel()
        model.share = pyo.Var(range(8), initialize=share())
        model.x = pyo.Var(range(n), range(5), initialize=lambda _, i, j: float(self.outputs[i, j]))

        def slope(i: int, command: np.ndarray) -> list:
            x = [model.x[i, j] for j in range(5)]
            p = [model.share[j] * float(TRUE[j]) for j in range(8)]
            return rates(x, [float(c) for c in command], p, pyo.sin, pyo.cos)

        model.gap = pyo.ConstraintList()
        for i in range(n - 1):
            here, there = slope(i, self.inputs[i]), slope(i + 1, self.inputs[i])
            for j in range(5):
                model.gap.add(model.x[i + 1, j] == model.x[i, j] + STEP / 2 * (here[j] + there[j]))
        model.experiment_outputs = pyo.Suffix(direction=pyo.Suffix.LOCAL)
        model.measurement_error = pyo.Suffix(direction=pyo.Suffix.LOCAL)
        model.unknown_parameters = pyo.Suffix(direction=pyo.Suffix.LOCAL)
        for i in range(n):
            for j in range(5):
                model.experiment_outputs[model.x[i, j]] = float(self.outputs[i, j])
                model.measurement_error[model.x[i, j]] = float(NOISE[j])
        for j in range(8):
            model.unknown_parameters[model.share[j]] = share()
        return model


def main() -> None:
    """Estimate with the weighted sum of squares of parmest."""
    if shutil.which("ipopt") is None:
        raise ModuleNotFoundError("No program named 'ipopt'")
    _, inputs, outputs = load()

    def solve() -> np.ndarray:
        estimator = parmest.Estimator([_Dive(inputs, outputs)], obj_function="SSE_weighted")
        _, found = estimator.theta_est()
        return np.array([float(found[f"share[{j}]"]) for j in range(len(NAMES))]) * TRUE

    report(solve)


if __name__ == "__main__":
    sys.path.insert(0, str(Path.cwd()))
    main()
