"""What is left is called noise only where a sensor could have made it."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Input, Model, Output, Parameter, Record, State, improve
from oed_sysid.evidence.remainder import RandomForceFound, Remains, remains
from oed_sysid.evidence.study import Study
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.physics import Force

CART = Model(
    "cart",
    (State("u", "m/s", scale=0.3),),
    (Input("push", "N"),),
    (Output("u", "m/s"),),
    {"u": "(push - d*u)/m"},
    parameters=(
        Parameter("m", 2.0, "kg", lower=0.1),
        Parameter("d", 1.0, "kg/s", lower=0.0),
    ),
    step=0.1,
)
DRY = Force("dry", {"u": "-F*tanh(u/0.02)/m"}, parameters=(Parameter("F", 0.0, "N"),))
FINE = 0.001  # m/s


def runs(slow: float, seed: int) -> list[Record]:
    """Two records of the cart as modelled, its sensor fine but for a slow drift, m/s."""
    rng = np.random.default_rng(seed)
    found = []
    for name in ("one", "two"):
        times = np.arange(0.0, 120.0, 0.1)
        push = np.repeat(rng.choice([-0.4, 0.0, 0.4], 30), 40)
        run = simulate_inputs(CART, times, inputs={"push": push}).outputs
        drift = np.zeros(len(times))
        for k in range(1, len(times)):
            drift[k] = 0.99 * drift[k - 1] + slow * np.sqrt(1 - 0.99**2) * rng.standard_normal()
        seen = run + (drift + FINE * rng.standard_normal(len(times)))[:, np.newaxis]
        found.append(Record(name, times, push[:, np.newaxis], seen, CART.channels))
    return found


@pytest.mark.parametrize(("slow", "kind"), [(0.0, "adequate"), (0.08, "structure missing")])
def test_slow_misfit_far_above_the_wiggles_is_no_noise(slow: float, kind: str) -> None:
    """A third of the signal, ten times its finest wiggles, is named; the same sensor is not."""
    one, two = runs(slow, 1)
    found = improve(CART, Dataset((one,)), Dataset((two,)), candidates=[DRY], disturbances="none")
    assert found.remains.kind == kind
    assert bool(found.remains.drifting) == (slow > 0)
    if slow:
        assert found.remains.over_wiggles["u"] > 10
        assert found.remains.shares["u"] > 0.2


@pytest.mark.parametrize(
    ("share", "ratio", "time", "kind"),
    [
        (0.3, 30.0, 40.0, "structure missing"),
        (0.05, 30.0, 40.0, "adequate"),  # small against the signal
        (0.3, 3.0, 1.0, "adequate"),  # colour as sensors have it
        (0.3, 30.0, None, "adequate"),  # white: a coarse sensor
        (0.6, 1.0, None, "structure missing"),
    ],
)
def test_what_a_sensor_can_be(share: float, ratio: float, time: float | None, kind: str) -> None:
    """Large, slow and far above the wiggles: all three."""
    left = Remains(0.0, time, shares={"u": share}, over_wiggles={"u": ratio})
    assert left.kind == kind


@pytest.mark.parametrize(
    ("share", "ratio", "kind"),
    [(0.05, 5.0, "structure missing"), (0.05, 2.0, "adequate"), (0.005, 5.0, "adequate")],
)
def test_declared_noise_leaves_less_room(share: float, ratio: float, kind: str) -> None:
    """Slow misfit of five times the declared noise is no sensor's, however large the signal."""
    left = Remains(0.0, 30.0, shares={"psi": share}, over_wiggles={"psi": ratio}, declared=("psi",))
    assert left.kind == kind


@pytest.mark.parametrize(("told", "kind"), [(True, "structure missing"), (False, "random forces")])
def test_levels_differ_where_the_records_tell_them_apart(told: bool, kind: str) -> None:
    """Three times the level is another sea only where the records are likelier with it."""
    force = RandomForceFound("force Y", "N", 6.0, 0.5, 500.0, 2.0, told)
    assert force.is_the_same_elsewhere is not told
    assert Remains(500.0, None, random=(force,), shares={"y": 0.2}, follows=()).kind == kind


def test_a_model_that_leaves_the_numbers_is_not_adequate() -> None:
    """However likely the records are with random forces or noise alone."""
    left = Remains(0.0, None, shares={"u": np.inf, "z": 0.01}, over_wiggles={"u": np.inf})
    assert left.kind == "structure missing"
    assert left.diverging == ("u",)
    assert left.to_dict()["shares"] == {"u": None, "z": 0.01}


DRIFTER = Model(
    "drifter",
    (State("u", "m/s", scale=1.0), State("x", "m", scale=10.0)),
    (Input("push", "N"),),
    (Output("x", "m", noise_std=0.3),),
    {"u": "(push - d*u)/m", "x": "u"},
    parameters=(Parameter("m", 60.0, "kg", fixed=True), Parameter("d", 2.0, "kg/s", lower=0.0)),
    step=0.1,
)


def drifts(seed: int, level: float, n: int, seconds: float = 40.0) -> Dataset:
    """Positions of a craft of 60 kg and 3 kg/s under a force that lasts a second, N."""
    rng = np.random.default_rng(seed)
    found = []
    for index in range(n):
        times = np.arange(0.0, seconds, 0.1)
        push = np.repeat(rng.choice([5.0, 15.0, 25.0], len(times) // 60 + 1), 60)[: len(times)]
        x, u, w = np.zeros(len(times)), 3.0, 0.0
        for k in range(len(times) - 1):
            w = np.exp(-0.1) * w + np.sqrt(1 - np.exp(-0.2)) * level * rng.standard_normal()
            x[k + 1] = x[k] + 0.1 * u
            u += 0.1 * (push[k] + w - 3.0 * u) / 60.0
        seen = x + 0.3 * rng.standard_normal(len(times))
        seen[np.arange(len(times)) % 5 > 0] = np.nan
        found.append(
            Record(f"run {seed} {index}", times, push[:, None], seen[:, None], DRIFTER.channels)
        )
    return Dataset(tuple(found))


@pytest.mark.parametrize("level", [8.0, 32.0])
def test_short_records_do_not_tell_level_from_time(level: float) -> None:
    """The same sea is the same where another level and time fit as well; a fourfold one is not."""
    train, test = drifts(19, 8.0, 2), drifts(20, level, 1)
    study, fit = Study.begin(DRIFTER, train, test, (), known_noise=False)
    (force,) = remains(study, study.settle(fit)).random
    assert max(force.level, force.elsewhere) > 2.0 * min(force.level, force.elsewhere)
    assert force.told is (level == 32.0)
    assert force.is_the_same_elsewhere is (level == 8.0)
