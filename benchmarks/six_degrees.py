"""Time of a fit and of a search in six degrees of freedom.

    OMP_NUM_THREADS=1 python -m benchmarks.six_degrees

12 states, 25 parameters, 36,030 samples: the AUV of :mod:`benchmarks.other_vehicles`, simulated by
that benchmark's own code, three records of 60 s at 20 Hz, ten outputs. Free are its fifteen
derivatives and ten quadratic or crossed drags; derivatives begin 10 to 30 % wrong. Times are given
as they pass and as processor time; targets are 2.5 s for the fit and 90 s for the search among 30
candidates. Compiling is left out: a first fit warms up.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.other_vehicles.models.auv import NOMINAL
from benchmarks.other_vehicles.truth import VEHICLES
from benchmarks.other_vehicles.truth.simulator import simulate
from oed_sysid import Dataset, Model, MultipleShooting, Record, improve

DRAGS = (
    "heave_crossflow", "sway_crossflow", "pitch_quadratic_damping", "yaw_quadratic_damping",
    "roll_quadratic_damping", "pitch_crossflow_moment", "yaw_crossflow_moment", "sway_drift_yaw",
    "crossflow_drag", "surge_linear_drag",
)  # fmt: skip
HIDDEN = {"lag:stern": 0.25}
CANDIDATES = 30


def prepared() -> tuple[Model, Dataset, Dataset]:
    """The nominal model, training and validation records."""
    vehicle = replace(VEHICLES["auv"], sample=0.05, substep=0.05)
    rng = np.random.default_rng(36030)
    runs = simulate(vehicle, HIDDEN, rng=rng)
    model = NOMINAL.model(True, None)
    for name in DRAGS:
        model = model + NOMINAL.effect(name)
    wrong = rng.uniform(0.1, 0.3, len(vehicle.free)) * rng.choice([-1, 1], len(vehicle.free))
    start = {k: v * (1 + e) for (k, v), e in zip(vehicle.free.items(), wrong, strict=True)}
    model = model.with_values({k: v for k, v in start.items() if k in model.parameter_names})
    records = [
        Record(name, runs.times, runs.logged[i], runs.outputs[i], model.channels)
        for i, name in enumerate(runs.names)
    ]
    n_train = len(vehicle.train)
    return model, Dataset(records[:n_train]), Dataset(records[n_train:])


def timed(words: str, call: Callable[[], Any]) -> Any:
    """Call something and say how long it took."""
    wall, processor = time.perf_counter(), time.process_time()
    result = call()
    spent = time.perf_counter() - wall, time.process_time() - processor
    print(f"{words}: {spent[0]:.1f} s, processor {spent[1]:.1f} s", flush=True)
    return result


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.six_degrees")
    parser.add_argument("--fit-only", action="store_true", help="leave out the search")
    options = parser.parse_args(arguments)
    model, train, test = prepared()
    n_samples = sum(int(np.isfinite(record.outputs).sum()) for record in train)
    print(f"{len(model.state_names)} states, {len(model.free_names)} free, {n_samples} samples")
    full = model + NOMINAL.effect("stern_lag")
    for words, disturbances in (("white", "none"), ("random forces", "auto")):
        estimator = MultipleShooting(noise="given", disturbances=disturbances)
        estimator.fit(full, Dataset((train[0],)))
        fit = timed(f"fit, {words}", lambda e=estimator: e.fit(full, train))
        print(f"  {fit.status.code}, {fit.iterations} iterations, {fit.normalised_rms:.3f} x noise")
    if options.fit_only:
        return
    others = [effect for effect in NOMINAL.candidates if effect.name not in DRAGS]
    chosen = [NOMINAL.effect("stern_lag"), *others][: CANDIDATES + 1]
    chosen = list({effect.name: effect for effect in chosen}.values())[:CANDIDATES]
    found = timed(
        f"improve, {len(chosen)} candidates",
        lambda: improve(model, train, test, candidates=chosen),
    )
    print("  found", ", ".join(step.added for step in found.steps) or "nothing")


if __name__ == "__main__":
    main()
