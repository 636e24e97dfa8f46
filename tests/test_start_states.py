"""Start states, of vehicles and actuators: free, held, known with an error, guessed."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from golden_files import restored
from marks import slow
from motion import small
from simple_models import nomoto
from vehicles import DIVING_START, SHIP_START, remus, ship

from oed_sysid import Dataset, Fit, Model, MultipleShooting, Record, improve, simulate_inputs
from oed_sysid.errors import DataError, ModelError
from oed_sysid.likelihood.departures import estimate_starts
from oed_sysid.likelihood.start_guess import kinematic_states, measured_states, slope
from oed_sysid.physics import (
    actuator_delay,
    actuator_lag,
    actuator_offset,
    backlash,
    rate_limit,
    sensor_bias,
    unknown_start,
)

TIMES = np.arange(0.0, 3.0, 0.1)
NOISE, KNOWN = 0.05, 0.03
TRUE_START = np.array([1.0, -0.5])


def oscillator() -> Model:
    """A damped oscillator, of which the position is measured."""
    law = {"x": "v", "v": "force - k*x - c*v"}
    values = {"k [1/s^2]": 1.0, "c [1/s]": 0.4}
    return small("oscillator", "x [m], v [m/s] <- force [N]", law, values, {"x": NOISE})


def record(rng: np.random.Generator, times: np.ndarray = TIMES, name: str = "run") -> Record:
    """A free decay with a little forcing, and noise."""
    model = oscillator()
    inputs = 0.3 * np.sin(2.0 * times)[:, None]
    clean = simulate_inputs(model, times, inputs=inputs, initial=TRUE_START).outputs
    noisy = clean + NOISE * rng.normal(size=clean.shape)
    return Record(name, times, inputs, noisy, model.channels)


ESTIMATOR = MultipleShooting(noise="given", disturbances="none", coloured="never")


def disturbed(model: Model, data: Dataset, starts: object) -> Fit:
    """A fit in which a disturbance force is admitted, whatever the test says of it."""
    return MultipleShooting(noise="given", disturbances=("v",)).fit(
        model,
        data,
        start_states=starts,  # type: ignore[arg-type]
    )


def test_numbers_are_held_and_pairs_are_priors_in_both_engines() -> None:
    """Held states stay; a precise prior pulls as the normal equations say; the rest is free."""
    data = Dataset((record(np.random.default_rng(1)),))
    starts = {"x": 1.02, "v": (-0.45, 1e-6)}
    for fit in (
        ESTIMATOR.fit(oscillator(), data, start_states=starts),
        disturbed(oscillator(), data, [starts]),
    ):
        assert fit.initial_states[0][0] == 1.02
        assert fit.initial_states[0][1] == pytest.approx(-0.45, abs=1e-6)
        assert fit.start_states == ({"x": (1.02, 0.0), "v": (-0.45, 1e-6)},)
    free = ESTIMATOR.fit(oscillator(), data)
    assert abs(free.initial_states[0][0] - 1.02) > 1e-4
    assert fit.n_unknowns - len(fit.noise_std) == 3
    assert free.n_unknowns == 4


def test_held_states_are_not_eliminated() -> None:
    """With start states held, the covariance is that of least squares in the parameters alone."""
    data = Dataset((record(np.random.default_rng(2)),))
    starts = dict(zip(("x", "v"), map(float, TRUE_START), strict=True))
    fit = ESTIMATOR.fit(oscillator(), data, start_states=starts)
    columns, step = [], 1e-5
    for name in ("k", "c"):
        ends = []
        for sign in (1, -1):
            model = fit.model.with_values({name: fit.values[name] + sign * step})
            run = simulate_inputs(model, TIMES, inputs=data[0].inputs, initial=TRUE_START)
            ends.append(run.outputs[:, 0])
        columns.append((ends[0] - ends[1]) / (2 * step * NOISE))
    jacobian = np.array(columns).T
    assert fit.covariance == pytest.approx(np.linalg.inv(jacobian.T @ jacobian), rel=1e-5)


def test_a_vague_prior_leaves_the_fit_and_a_sharp_one_holds_it() -> None:
    """Between free and held the stated error interpolates, in values and in errors."""
    data = Dataset((record(np.random.default_rng(3)),))
    free = ESTIMATOR.fit(oscillator(), data)
    vague = ESTIMATOR.fit(oscillator(), data, start_states={"x": (0.9, 1e4), "v": (0.0, 1e4)})
    held = ESTIMATOR.fit(oscillator(), data, start_states={"x": 0.9, "v": -0.5})
    sharp = ESTIMATOR.fit(oscillator(), data, start_states={"x": (0.9, 1e-7), "v": (-0.5, 1e-7)})
    assert vague.estimates == pytest.approx(free.estimates, rel=1e-4)
    assert vague.covariance == pytest.approx(free.covariance, rel=1e-4)
    assert sharp.estimates == pytest.approx(held.estimates, rel=1e-4)
    assert sharp.covariance == pytest.approx(held.covariance, rel=1e-4)
    assert np.all(np.diag(held.covariance) < np.diag(free.covariance))


@pytest.mark.slow
@pytest.mark.parametrize("way", ["free", "known", "held", "known, disturbance force"])
def test_stated_errors_are_right(way: str) -> None:
    """Normalised errors of the parameters have unit variance, over 150 data sets."""
    rng, scores = np.random.default_rng(4), []
    count = 60 if "force" in way else 150
    for _ in range(count):
        data = Dataset((record(rng),))
        starts: dict[str, object] = {}
        if way.startswith("known"):
            believed = TRUE_START + KNOWN * rng.normal(size=2)
            starts = {n: (float(b), KNOWN) for n, b in zip("xv", believed, strict=True)}
        elif way == "held":
            starts = dict(zip("xv", map(float, TRUE_START), strict=True))
        if "force" in way:
            fit = disturbed(oscillator(), data, starts)
        else:
            fit = ESTIMATOR.fit(oscillator(), data, start_states=starts)  # type: ignore[arg-type]
        root = np.linalg.cholesky(fit.covariance)
        scores.append(np.linalg.solve(root, fit.estimates - [1.0, 0.4]))
    variance = float(np.mean(np.square(scores)))
    spread = np.sqrt(2.0 / np.size(scores))
    assert 1.0 - 3.5 * spread < variance < 1.0 + 3.5 * spread


def test_predictions_carry_the_error_of_given_starts() -> None:
    """A pair widens the band by what the error does to the trajectory, a number does not."""
    data = Dataset((record(np.random.default_rng(5)),))
    fit = ESTIMATOR.fit(oscillator().fix("c"), data)
    exact = fit.predict(data, initial={"x": 1.0, "v": -0.5})
    wide = fit.predict(data, initial={"x": (1.0, 0.2), "v": -0.5})
    assert wide.outputs[0] == pytest.approx(exact.outputs[0], abs=1e-12)
    added = wide.model_std[0] ** 2 - exact.model_std[0] ** 2
    assert added[0, 0] == pytest.approx(0.04, rel=1e-6)
    shifted = fit.predict(data, initial={"x": 1.0 + 1e-4, "v": -0.5})
    slope = (shifted.outputs[0] - exact.outputs[0]) / 1e-4
    assert added == pytest.approx((0.2 * slope) ** 2, abs=1e-6)


def test_what_does_not_belong_is_refused() -> None:
    """Unknown states, wrong counts, and errors that are no numbers are named."""
    data = Dataset((record(np.random.default_rng(6)),))
    for starts, words in (
        ({"y": 1.0}, "no state"),
        ([{}, {}], "2 mappings for 1 records"),
        ({"x": (1.0, -0.1)}, "standard deviation"),
        ({"x": (1.0, 0.1, 2.0)}, "standard deviation"),
        ({"x": float("nan")}, "a number or a pair"),
    ):
        with pytest.raises(DataError, match=words):
            ESTIMATOR.fit(oscillator(), data, start_states=starts)  # type: ignore[arg-type]


def test_a_fit_with_known_starts_is_kept_in_full(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """What was known of the start states is saved and reported."""
    data = Dataset((record(np.random.default_rng(7)),))
    again = restored(ESTIMATOR.fit(oscillator(), data, start_states={"x": (1.0, 0.02)}), tmp_path)
    assert again.start_states == ({"x": (1.0, 0.02)},)
    assert again.n_unknowns == 4
    assert "start of run given: x 1.000 ± 0.039 (95 %)" in again.report()


STEP, SAMPLE = 0.01, 0.25
LAG, PLAY = 2.0, 0.04
OFF = np.radians(5.0)
WHITE = MultipleShooting(disturbances="none", coloured="never")
SHIP = nomoto(0.12, 8.0, noise=(0.002, 0.0005), rudder="delta", step=SAMPLE)
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


@pytest.mark.parametrize(("kind", "off"), [("lag", OFF), *slow(("play", 0.03))])
def test_intervals_hold_where_the_start_is_estimated(kind: str, off: float) -> None:
    """A start beside the first command biases a fit by far; estimated, it does not."""
    held = deviations(kind, off, free=False)
    free = deviations(kind, off, free=True)
    assert np.mean(np.abs(held) < 1.96) < 0.7
    # 36 intervals of 95 %, three in each fit that are not independent.
    assert np.mean(np.abs(free) < 1.96) > 0.82
    assert np.abs(free.mean(axis=0)).max() < 1.0


@pytest.mark.parametrize("kind", ["lag", *slow("play")])
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


@pytest.mark.slow
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


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
def test_slope_is_about_as_good_as_it_says(noise: float) -> None:
    """The derivative of a noisy sine is found within a few of its stated errors."""
    times = np.arange(0, 30, 0.1)
    series = np.sin(times) + noise * np.random.default_rng(0).standard_normal(len(times))
    found, error = slope(times, series)
    actual = np.sqrt(np.mean((found - np.cos(times))[10:-10] ** 2))
    assert actual < 3 * error + 1e-3
    assert actual < max(0.5 * noise / 0.1, 0.02)


def only(model: Model, names: tuple[str, ...]) -> Model:
    """The model with only some outputs measured."""
    return replace(model, outputs=tuple(o for o in model.outputs if o.name in names))


@pytest.mark.parametrize(
    ("model", "keep", "found"),
    [
        (remus(), ("u", "theta", "z"), {"q", "w"}),
        (remus(), ("u", "w", "theta"), {"q"}),
        (ship(), ("psi", "x", "y"), {"u", "v", "r"}),
    ],
)
def test_velocities_follow_from_what_is_measured(
    model: Model, keep: tuple[str, ...], found: set[str]
) -> None:
    """Pitch rate from pitch, heave velocity from depth, u and pitch; a ship's from its track."""
    dives = model.name == "remus"
    times = np.arange(0, 60, 0.1) if dives else np.arange(0, 600, 2.0)
    inputs, initial = (
        ({"fin_command": 0.1 * np.sign(np.sin(0.5 * times)), "thrust": 9.0}, DIVING_START)
        if dives
        else (
            {"rudder_command": 0.2 * np.sign(np.sin(2 * np.pi * times / 200)), "thrust": 7e5},
            SHIP_START,
        )
    )
    run = simulate_inputs(model, times, inputs=inputs, initial=initial)
    part = only(model, keep)
    rng = np.random.default_rng(1)
    outputs = np.column_stack([run.signal(name) for name in part.output_names])
    outputs += 0.003 * dives * rng.standard_normal(outputs.shape)
    record = Record("run", times, run.inputs, outputs, part.channels)
    guesses = kinematic_states(part, record, measured_states(part, record))
    assert {part.state_names[i] for i in guesses} == found
    for position, guess in guesses.items():
        truth = run.signal(part.state_names[position])
        error = np.sqrt(np.mean((guess.series - truth) ** 2))
        assert error < (0.35 * np.std(truth) if dives else 0.2 * np.abs(truth).max())
        assert not dives or error < 5 * guess.std


def test_nothing_is_guessed_from_unknown_parameters() -> None:
    """An equation that holds a free parameter is not used."""
    model = only(remus(), ("q",))
    times = np.arange(0, 20, 0.1)
    record = Record("r", times, np.zeros((200, 2)), np.sin(times)[:, None], model.channels)
    guesses = kinematic_states(model, record, measured_states(model, record))
    assert guesses == {}
