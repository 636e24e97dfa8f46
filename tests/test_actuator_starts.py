"""Lags and plays that do not begin at the first command: estimated where asked, told where not."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from oed_sysid import Dataset, Input, Model, MultipleShooting, Output, Parameter, Record, State
from oed_sysid.errors import ModelError
from oed_sysid.evidence.improve import improve
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.departures import estimate_starts
from oed_sysid.physics import (
    actuator_delay,
    actuator_lag,
    actuator_offset,
    backlash,
    rate_limit,
    sensor_bias,
    unknown_start,
)

STEP, SAMPLE = 0.01, 0.25
LAG, PLAY = 2.0, 0.04
OFF = np.radians(5.0)
WHITE = MultipleShooting(disturbances="none", coloured="never")
SHIP = Model(
    "ship",
    states=(State("psi", "rad", scale=0.3), State("r", "rad/s", scale=0.05)),
    inputs=(Input("delta", "rad"),),
    outputs=(Output("psi", "rad", noise_std=0.002), Output("r", "rad/s", noise_std=0.0005)),
    kinematics={"psi": "r", "r": "(K*delta - r)/T"},
    parameters=(
        Parameter("K", 0.12, "1/s", lower=0.01, upper=2.0),
        Parameter("T", 8.0, "s", lower=0.5, upper=100.0),
    ),
    step=SAMPLE,
)
RUDDERS = {
    "lag": actuator_lag("rudder_lag", "delta", scale=1.0, value=1.0),
    "play": backlash("rudder_play", "delta", scale=0.03, value=0.03),
}
TRUTH = {
    "lag": {"K": 0.15, "T": 10.0, "E_rudder_lag": LAG},
    "play": {"K": 0.15, "T": 10.0, "E_rudder_play": PLAY},
}


@lru_cache(maxsize=200)
def runs(kind: str, off: float, seed: int, sea: float = 0.0) -> Dataset:
    """Three runs in steps of 0.01 s, the rudder ``off`` its first command, to either side, rad.

    ``sea`` is the standard deviation of a disturbance force that lasts 2 s, as a rudder angle, rad.
    """
    rng = np.random.default_rng([3, seed])
    records = []
    for index, period in enumerate((14.0, 20.0, 26.0)):
        times = np.arange(0.0, 60.0 + STEP / 2, STEP)
        every = round(SAMPLE / STEP)
        at = times[::every]
        order = 0.2 * np.sign(np.sin(2 * np.pi * (at + 0.3 * period) / period))
        order *= np.where(at % (2 * period) < period, 1.0, 0.5)
        held = np.repeat(order, every)[: len(times)]
        rudder, rate, heading = held[0] + off * rng.choice([-1.0, 1.0]), 0.0, 0.0
        states, force = np.zeros((len(times), 2)), 0.0
        for k in range(len(times) - 1):
            if kind == "lag":
                mean = held[k] + (rudder - held[k]) * LAG / STEP * (1 - np.exp(-STEP / LAG))
                rudder = held[k] + (rudder - held[k]) * np.exp(-STEP / LAG)
            else:
                rudder = mean = float(np.clip(rudder, held[k] - PLAY, held[k] + PLAY))
            if sea:
                keep = np.exp(-STEP / 2.0)
                force = keep * force + sea * np.sqrt(1 - keep**2) * rng.standard_normal()
            end = 0.15 * (mean + force)
            decay = np.exp(-STEP / 10.0)
            heading += end * STEP + (rate - end) * 10.0 * (1 - decay)
            rate = end + (rate - end) * decay
            states[k + 1] = heading, rate
        seen = states[::every] + rng.standard_normal((len(at), 2)) * [0.002, 0.0005]
        records.append(Record(f"run_{index}", at, order[:, None], seen, SHIP.channels))
    return Dataset(records)


def deviations(kind: str, off: float, *, free: bool, count: int = 12) -> np.ndarray:
    """Errors of all parameters in standard errors, ``(count, 3)``."""
    rudder = RUDDERS[kind]
    model = SHIP + (unknown_start(rudder, 0.2 if kind == "lag" else 0.05) if free else rudder)
    found = []
    for seed in range(count):
        fit = WHITE.fit(model, runs(kind, off, seed))
        found.append([(fit.values[n] - v) / fit.std_errors[n] for n, v in TRUTH[kind].items()])
    return np.array(found)


@pytest.mark.parametrize(("kind", "off"), [("lag", OFF), ("play", 0.03)])
def test_intervals_hold_where_the_start_is_estimated(kind: str, off: float) -> None:
    """A start beside the first command biases a fit by far; estimated, it does not."""
    held = deviations(kind, off, free=False)
    free = deviations(kind, off, free=True)
    assert np.mean(np.abs(held) < 1.96) < 0.7
    # 36 intervals of 95 %, three in each fit that are not independent.
    assert np.mean(np.abs(free) < 1.96) > 0.82
    assert np.abs(free.mean(axis=0)).max() < 1.0


@pytest.mark.parametrize("kind", ["lag", "play"])
def test_little_changes_where_it_began_at_the_first_command(kind: str) -> None:
    """Estimates stay where they are, and errors grow by a quarter at most."""
    rudder = RUDDERS[kind]
    for seed in range(4):
        plain = WHITE.fit(SHIP + rudder, runs(kind, 0.0, seed))
        wide = WHITE.fit(SHIP + unknown_start(rudder, 0.2), runs(kind, 0.0, seed))
        for name in TRUTH[kind]:
            moved = (wide.values[name] - plain.values[name]) / plain.std_errors[name]
            assert abs(moved) < 1.5
            assert wide.std_errors[name] < 1.25 * plain.std_errors[name]


def test_fit_says_that_a_rudder_began_elsewhere() -> None:
    """The score of the start is clear where it was off, of the right sign, and not elsewhere."""
    model = SHIP + RUDDERS["lag"].with_values({"E_rudder_lag": LAG})
    off = WHITE.fit(model, runs("lag", OFF, 0))
    (concern,) = [c for c in off.concerns if c.kind == "actuator_start"]
    assert concern.signal == "delta"
    known = WHITE.fit(model.fix("E_rudder_lag", "K", "T").with_values(TRUTH["lag"]).free("K"),
                      runs("lag", OFF, 0))  # fmt: skip
    sizes = {one.record: one for one in estimate_starts(known)}
    rng = np.random.default_rng([3, 0])
    for name in ("run_0", "run_1", "run_2"):
        true = OFF * rng.choice([-1.0, 1.0])
        rng.standard_normal((241, 2))
        assert sizes[name].size == pytest.approx(true, abs=max(4 * sizes[name].std, 0.02))
    for seed in range(6):
        at = WHITE.fit(model, runs("lag", 0.0, seed))
        assert not [c for c in at.concerns if c.kind == "actuator_start"]
    free = SHIP + unknown_start(RUDDERS["lag"], 0.2)
    assert estimate_starts(WHITE.fit(free, runs("lag", OFF, 0))) == ()


def test_fit_with_random_forces_says_it_too_and_a_sea_is_no_start() -> None:
    """Disturbance forces absorb a start, so that it is looked for before they are admitted."""
    for kind, off in (("lag", OFF), ("play", 0.03)):
        for seed in range(3):
            fit = MultipleShooting().fit(SHIP + RUDDERS[kind], runs(kind, off, seed))
            assert [c.kind for c in fit.concerns].count("actuator_start") == 1
    for seed in range(8):
        fit = MultipleShooting().fit(SHIP + RUDDERS["lag"], runs("lag", 0.0, seed, sea=0.03))
        assert fit.noise.has_forces
        assert not [c for c in fit.concerns if c.kind == "actuator_start"]


def test_candidate_with_an_unknown_start_is_found() -> None:
    """A search finds the lag among others; its start is no size and no shape."""
    lag = unknown_start(RUDDERS["lag"].absent(), 0.2)
    assert lag.amplitude_names == ("E_rudder_lag",)
    assert lag.shape_names == ()
    assert lag.start_names == ("start_rudder_lag",)
    data = runs("lag", OFF, 0)
    found = improve(
        SHIP,
        Dataset(data.records[:2]),
        Dataset(data.records[2:]),
        candidates=[lag, sensor_bias("bias_r", "r", "rad/s", scale=0.001)],
        known_noise=True,
        disturbances="none",
    )
    assert [step.added for step in found.steps] == ["rudder_lag"]
    assert found.model.values["E_rudder_lag"] == pytest.approx(LAG, abs=0.3)


@pytest.mark.parametrize(
    "effect",
    [
        actuator_lag("a", "delta"),
        actuator_delay("a", "delta", max_delay=1.0, step=SAMPLE),
        rate_limit("a", "delta"),
        backlash("a", "delta"),
    ],
)
def test_start_of_an_absent_actuator_does_nothing(effect: object) -> None:
    """Whatever it held before, an actuator of no size follows its command at once."""
    times, inputs = np.arange(0.0, 10.0, SAMPLE), np.full((40, 1), 0.1)
    wide = SHIP + unknown_start(effect, 0.2).with_values({"start_a": 0.15})
    plain = simulate_inputs(SHIP, times, inputs=inputs, initial={}).outputs
    absent = simulate_inputs(wide, times, inputs=inputs, initial={}).outputs
    assert absent == pytest.approx(plain, abs=1e-12)
    present = wide.with_values({"E_a": 0.5})
    moved = simulate_inputs(present, times, inputs=inputs, initial={}).outputs
    assert np.abs(moved - plain).max() > 1e-4


def test_what_has_no_start_is_refused() -> None:
    """An offset remembers nothing; a spread of zero is none."""
    with pytest.raises(ModelError):
        unknown_start(actuator_offset("zero", "delta"), 0.1)
    with pytest.raises(ModelError):
        unknown_start(RUDDERS["lag"], 0.0)
