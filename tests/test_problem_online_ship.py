"""The published experiments on online identification of ships."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, load_problem, simulate
from oed_sysid.baselines import EquationStream, OnlineRegression, RecursiveLSSVM

PROBLEM = load_problem("online_ship")
RECORD = simulate(PROBLEM.model, PROBLEM.experiment("zigzag_5_5"), noise=False)


def test_manoeuvre() -> None:
    """The zigzag is the one that an independent program made."""
    assert RECORD.n_samples == PROBLEM.published["samples"] + 1
    assert np.degrees(np.abs(RECORD.output("psi")).max()) == pytest.approx(21.98, abs=0.01)
    assert np.degrees(np.abs(RECORD.output("r")).max()) == pytest.approx(0.2440, abs=1e-4)
    assert np.abs(RECORD.output("v")).max() == pytest.approx(0.599, abs=1e-3)
    assert np.sum(np.diff(np.sign(RECORD.input("delta")[1:])) != 0) == 2


def test_ship_is_unstable_on_course() -> None:
    """The dimensionless system matrix has the published entries and a negative determinant."""
    values = PROBLEM.model.values
    sway, yaw = values["inertia_Yv"], values["inertia_Nr"]
    matrix = np.array(
        [
            [values["Y_v"] / sway, values["Y_r"] / sway],
            [values["N_v"] / yaw, values["N_r"] / yaw],
        ]
    )
    assert matrix == pytest.approx(np.array([[-0.5965, -0.3723], [-3.6607, -1.875]]), abs=1e-4)
    assert np.linalg.det(matrix) == pytest.approx(-0.2443, abs=1e-4)


def test_loop_on_board() -> None:
    """In the loop of a vehicle's computer, all six coefficients arrive within 0.3 per cent."""
    stream = EquationStream(PROBLEM.model, rule="trapezoid")
    machines = {equation: RecursiveLSSVM(C=3e5) for equation in stream.equations}
    for k, moment in enumerate(RECORD.times):
        sample = {"delta": RECORD.input("delta")[k]}
        sample |= {name: RECORD.output(name)[k] for name in ("v", "r", "psi")}
        for row in stream.push(float(moment), sample):
            machines[row.equation].update(row.features, row.target)
    for equation, machine in machines.items():
        for name, value in zip(stream.names(equation), machine.coefficients, strict=True):
            assert value == pytest.approx(PROBLEM.truth[name], rel=3e-3)


def test_noise_is_averaged_out_with_time() -> None:
    """With measurement noise the estimates at 300 samples are closer than at 60."""
    errors = {60: [], 300: []}
    for seed in range(6):
        record = simulate(
            PROBLEM.model, PROBLEM.experiment("zigzag_10_10"), rng=np.random.default_rng(seed)
        )
        fit = OnlineRegression(C=3e5, rule="trapezoid").fit(PROBLEM.model, Dataset((record,)))
        for count, collected in errors.items():
            track = fit.extras["history"]["N_delta"]
            at = min(count, len(track)) - 1
            collected.append(abs(track[at] / PROBLEM.truth["N_delta"] - 1))
    assert np.mean(errors[300]) < np.mean(errors[60])
