"""Xu, Zou and Yin (2012): a tanker on line, by incremental LS-SVM."""

from __future__ import annotations

import contextlib
import tempfile
import time
from typing import Any

import numpy as np

from benchmarks.documents.measured_data import ran
from benchmarks.documents.page import Numbers, paper

COUNTS = (30, 60, 200)  # samples after which errors are stated
FROM = {0.0: 10, 0.01: 50}  # noise of the second example, and the first sample that counts
SEEDS = 20
SIZES = (250, 1000, 2000)
TIMED = 40  # updates, of which the fastest is stated: others had the machine, too


def simulated() -> Numbers:
    """Recursions against the batch, derivatives in per cent, and the second example."""
    script = paper("online_ship")
    return {
        "gaps": {
            kind: max(
                script.recursion_gap(make(script.WEIGHT), *script.yaw_rows(noise))
                for noise in (0.0, 0.01)
            )
            for kind, make in script.MACHINES.items()
        },
        "errors": {rule: after(rule) for rule in ("trapezoid", "euler")},
        "second": {
            str(noise): max(away(noise, seed) for seed in range(SEEDS if noise else 1))
            for noise in FROM
        },
        "seeds": SEEDS,
    }


def after(rule: str) -> dict[str, float]:
    """Largest error of the six derivatives, per cent, after some samples."""
    found = paper("online_ship").on_line(rule)
    at = {int(k): row for k, row in zip(found["samples"], found["errors"], strict=True)}
    return {str(count): float(np.abs(at[count]).max()) for count in COUNTS}


def away(noise: float, seed: int) -> float:
    """Largest relative error of K and T of the second example, from its first sample on."""
    script = paper("online_ship")
    found = script.second_example(noise, seed)[FROM[noise] - 3 :]
    return float(np.abs(found / script.PUBLISHED - 1).max())


def cost() -> Numbers:
    """Processor time of one update with six features, µs, by recursion and samples learnt."""
    script = paper("online_ship")
    return {kind: updates(make(script.WEIGHT)) for kind, make in script.MACHINES.items()}


def updates(machine: Any) -> dict[str, float]:
    """Least time of an update of a machine that grows, µs, at some sizes."""
    rng = np.random.default_rng(0)
    features = rng.standard_normal((max(SIZES) + TIMED, 6))
    targets = rng.standard_normal(len(features))
    machine.start(features[:2], targets[:2])
    took = []
    for row, target in zip(features[2:], targets[2:], strict=True):
        began = time.process_time()
        machine.update(row, target)
        took.append(time.process_time() - began)
    return {str(n): 1e6 * min(took[n - 2 : n - 2 + TIMED]) for n in SIZES}


def measured() -> Numbers:
    """K, 1/s, and T, s, of the measured zigzags of KVLCC2, and where the published form is lost."""
    script = paper("online_ship")
    averages = {"instant": script.INSTANT, "average": script.AVERAGE}
    sound = {name: script.measured(one, script.WEIGHT, 1.0) for name, one in averages.items()}
    lost = [
        script.measured(one, weight, unit)
        for weight, unit in ((1e8, 1.0), (script.WEIGHT, np.degrees(1.0)))
        for one in averages.values()
    ]
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):  # it leaves a picture
        example = ran("tanker_on_line")
    gain, period, spread = example["history"][-1]
    return {
        "mean": {name: one["Cholesky"].mean(axis=0) for name, one in sound.items()},
        "alone": {name: one["Cholesky"][script.RUNS.index("15_05")] for name, one in sound.items()},
        "residual": max(float(one["residual"].max()) for one in sound.values()),
        "lost": [float(one["residual"].max()) for one in lost],
        "noise": [float(np.abs(one["inverse"] / one["Cholesky"] - 1).max()) for one in lost],
        "warned": [bool(one["warned"].any()) for one in lost],
        "on_line": [gain, period, 1.96 * spread],
        "settled": example["settled"],
    }
