"""Sensors that are off by a constant, by a simulator of its own: a ship that rolls."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from marks import slow
from motion import small
from scipy.signal import cont2discrete

from oed_sysid import Dataset, Fit, MultipleShooting, Record, Solver

TRUE = {"Kp": 0.30, "Kb": 0.5, "Kd": 0.6}
STD = np.array([4e-3, 3e-3])
MODEL = small(
    "rolls",
    "p [rad/s], phi [rad] <- da [rad]",
    {"phi": "p", "p": "-Kp*p - Kb*phi + Kd*da"},
    {"Kp [1/s]": 1.2 * TRUE["Kp"], "Kb [1/s^2]": 1.2 * TRUE["Kb"], "Kd [1/s^2]": 1.2 * TRUE["Kd"]},
    {"p": STD[0], "phi": STD[1]},
    scales={"p": 0.1, "phi": 0.1},
    step=0.25,
)
PUSH, LASTS = 0.03, 2.0


@cache
def fitted(seed: int, off: float, *, pushed: bool = False, disturbances: str = "auto") -> Fit:
    """Two runs with a fin in squares, both sensors off by so many deviations of their noise."""
    rng, found = np.random.default_rng(seed), []
    rates = np.array([[-TRUE["Kp"], -TRUE["Kb"]], [1.0, 0.0]])
    driven = np.array([[TRUE["Kd"], 1.0], [0.0, 0.0]])
    phi, gamma, *_ = cont2discrete((rates, driven, np.eye(2), np.zeros((2, 2))), 0.25)
    keep = np.exp(-0.25 / LASTS)
    times = 0.25 * np.arange(400)
    for run, half in enumerate((6.0, 9.0)):
        fin = np.where((times // half) % 2 < 1, 0.2, -0.2)
        state, force, states = np.zeros(2), 0.0, []
        for one in fin:
            states.append(state)
            state = phi @ state + gamma @ [one, pushed * PUSH * force]
            force = keep * force + np.sqrt(1 - keep**2) * rng.standard_normal()
        noise = STD * rng.standard_normal((len(times), 2))
        zeros = off * STD * rng.choice([-1.0, 1.0], 2)
        measured = np.array(states) + zeros + noise
        found.append(Record(f"run {run}", times, fin[:, None], measured, MODEL.channels))
    return MultipleShooting(disturbances=disturbances).fit(MODEL, Dataset(found))


def errors(fit: Fit) -> np.ndarray:
    """Of the parameters, in stated standard errors."""
    return np.array([(fit.values[k] - v) / fit.std_errors[k] for k, v in TRUE.items()])


def test_zeros_are_estimated_with_everything_else() -> None:
    """Both are within twice of what they are, and nothing else seems to act."""
    fit = fitted(0, 3.0)
    ratios = fit.noise.zeros / (3.0 * STD)
    assert np.all((ratios > 0.5) & (ratios < 2.0))
    assert fit.noise.force.max() < 0.02 * PUSH
    said = {
        one.signal: one.size
        for one in fit.concerns
        if one.kind in ("offset", "zero", "noise_level")
    }
    # Of p -3 and 3 deviations in the two runs, of phi 3 in both.
    assert said["phi"] == pytest.approx(3.0 * STD[1], rel=0.1)
    assert said["p"] == pytest.approx(0.0, abs=0.3 * STD[0])
    np.testing.assert_allclose(fit.noise.sensors, STD, rtol=0.2)


@pytest.mark.slow
def test_ipopt_knows_zeros() -> None:
    """It ends where the damped steps do, to a twentieth of a standard error."""
    fit = fitted(0, 3.0)
    again = MultipleShooting(solver=Solver("ipopt")).fit(MODEL, fit.dataset)
    off = [(again.values[name] - fit.values[name]) / fit.std_errors[name] for name in TRUE]
    assert np.abs(off).max() < 0.05
    np.testing.assert_allclose(again.noise.zeros, fit.noise.zeros, rtol=0.05)


@pytest.mark.parametrize(("pushed", "count"), [(False, 10), (True, 4), *slow((True, 10))])
def test_sensors_that_are_not_off_have_no_zeros(pushed: bool, count: int) -> None:
    """In none of ten sets, in white noise and beside forces."""
    assert not any(fitted(seed, 0.0, pushed=pushed).noise.zeros.any() for seed in range(count))


@pytest.mark.slow
@pytest.mark.parametrize("pushed", [False, True], ids=["white", "first order"])
def test_intervals_hold_where_sensors_are_off(pushed: bool) -> None:
    """As often as they say, and the errors are those of sensors that are right, about."""
    off = np.array([errors(fitted(seed, 3.0, pushed=pushed)) for seed in range(40)])
    assert np.mean(np.abs(off) < 1.96) > 0.9
    right = [fitted(seed, 0.0, pushed=pushed) for seed in range(40)]
    ratio = [
        np.std([fit.values[k] for fit in (fitted(s, 3.0, pushed=pushed) for s in range(40))])
        / np.std([fit.values[k] for fit in right])
        for k in TRUE
    ]
    assert max(ratio) < 1.6


def test_zeros_are_saved_and_are_plain_data(tmp_path: Path) -> None:
    """A number for JSON, not an infinite time."""
    fit = fitted(0, 3.0)
    told = json.loads(json.dumps(fit.noise.to_dict(), allow_nan=False))["sensors"]
    assert {name: one["zero"] for name, one in told.items()} == pytest.approx(
        dict(zip(("p", "phi"), fit.noise.zeros, strict=True))
    )
    fit.save(tmp_path / "off.fit")
    np.testing.assert_array_equal(Fit.load(tmp_path / "off.fit").noise.zeros, fit.noise.zeros)
