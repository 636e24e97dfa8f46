"""What a fit says against itself: right fits say nothing, each fault is named with its size."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from yaw_vehicle import NOISE, TRUE, simulate_yaw, yaw_data, yaw_model

from oed_sysid import Dataset, Input, Model, MultipleShooting, Output, Parameter, State
from oed_sysid.baselines import JointKalmanFilter
from oed_sysid.data.record import Record
from oed_sysid.likelihood.departures import estimate_delays
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.judgement import CHECKS, FATAL, Concern, judge
from oed_sysid.likelihood.noise_levels import spike_masks

WHITE = MultipleShooting(noise=NOISE, disturbances="none")


def kinds(fit: Fit) -> set[str]:
    """Kinds of a fit's concerns."""
    return {concern.kind for concern in fit.concerns}


def changed(data: Dataset, change) -> Dataset:  # type: ignore[no-untyped-def]
    """The same records with other outputs."""
    return Dataset(tuple(record.with_outputs(change(record)) for record in data))


def lag(rate: float = 9.0, step: float = 0.1) -> Model:
    """A first-order lag, ``x' = -a (x - u)``."""
    return Model(
        "lag",
        (State("x", "m"),),
        (Input("u", "m"),),
        (Output("x", "m", noise_std=0.01),),
        {"x": "-a*(x - u)"},
        parameters=(Parameter("a", rate, "1/s"),),
        step=step,
    )


def lag_data(model: Model, seed: int = 0, *, n: int = 200, rate: float = 9.0) -> Dataset:
    """The lag's exact answer to a square wave, sampled every 0.1 s."""
    rng = np.random.default_rng(seed)
    times = 0.1 * np.arange(n)
    inputs, x = np.sign(np.sin(2.0 * times)), np.zeros(n)
    for k in range(n - 1):
        x[k + 1] = inputs[k] + (x[k] - inputs[k]) * np.exp(-0.1 * rate)
    outputs = x + 0.01 * rng.standard_normal(n)
    return Dataset((Record("a", times, inputs[:, None], outputs[:, None], model.channels),))


def test_right_fits_say_nothing() -> None:
    """Of forty fits with right model and noise at most one has a concern."""
    said = [bool(WHITE.fit(yaw_model(), yaw_data(seed)).concerns) for seed in range(40)]
    assert sum(said) <= 1


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_wrong_noise_levels_are_found(factor: float) -> None:
    """Levels declared half and double are named with their factor, for every output."""
    for seed in range(10):
        fit = MultipleShooting(noise=factor * NOISE, disturbances="none").fit(
            yaw_model(), yaw_data(seed)
        )
        found = {c.signal: c.size for c in fit.concerns if c.kind == "noise_level"}
        assert set(found) == {"psi", "r"}
        assert np.allclose(list(found.values()), 1.0 / factor, rtol=0.15)


@pytest.mark.parametrize("size", [6.0, 10.0])
@pytest.mark.parametrize("one_sided", [False, True])
def test_spikes_are_found_and_left_out(size: float, one_sided: bool) -> None:
    """Two per cent of spikes are flagged; ``loss="auto"`` leaves them out and keeps the rest."""
    rng = np.random.default_rng(1)
    clean, hit = yaw_data(5), []

    def spoil(record: Record) -> np.ndarray:
        mask = rng.random(record.outputs.shape) < 0.02
        hit.append(mask)
        signs = 1.0 if one_sided else rng.choice([-1.0, 1.0], mask.shape)
        return record.outputs + mask * signs * size * NOISE

    spoilt = changed(clean, spoil)
    plain = WHITE.fit(yaw_model(), spoilt)
    assert "spikes" in kinds(plain)
    robust = replace(WHITE, loss="auto").fit(yaw_model(), spoilt)
    gone = [
        np.isnan(after.outputs) & ~np.isnan(before.outputs)
        for after, before in zip(robust.dataset, spoilt, strict=True)
    ]
    right = sum(int((a & b).sum()) for a, b in zip(gone, hit, strict=True))
    n_spikes = sum(int(mask.sum()) for mask in hit)
    assert right >= 0.8 * n_spikes
    assert sum(int(mask.sum()) for mask in gone) - right <= 1
    counts = robust.excluded
    assert sum(count for count, _ in counts.values()) == sum(int(mask.sum()) for mask in gone)
    assert any("excluded as spikes" in c.text for c in robust.concerns)
    true = WHITE.fit(yaw_model(), clean)
    for name, error in true.std_errors.items():
        assert abs(robust.values[name] - true.values[name]) < 1.5 * error


def test_without_spikes_nothing_changes() -> None:
    """On clean records ``loss="auto"`` gives the numbers of the square to the last digit."""
    for seed in range(5):
        data = yaw_data(seed)
        plain = WHITE.fit(yaw_model(), data)
        robust = replace(WHITE, loss="auto").fit(yaw_model(), data)
        assert np.array_equal(plain.estimates, robust.estimates)
        assert not robust.excluded


def test_a_slow_bump_is_no_spike() -> None:
    """Neighbouring samples that err together are not outliers; single ones among them are."""
    rng = np.random.default_rng(2)
    series = rng.standard_normal(1000)
    series[400:410] += 15.0
    assert not spike_masks([series[:, None]])[0].any()
    series[700] += 9.0
    assert np.flatnonzero(spike_masks([series[:, None]])[0]).tolist() == [700]


@pytest.mark.parametrize("delay", [0.25, -0.2])
def test_delays_are_measured(delay: float) -> None:
    """A heading half a sample late or early is named, its delay within three standard errors."""

    def shift(record: Record) -> np.ndarray:
        late = record.outputs.copy()
        late[:, 0] -= delay * late[:, 1]
        return late

    for seed in range(4):
        fit = WHITE.fit(yaw_model(), changed(yaw_data(seed), shift))
        (found,) = (c for c in fit.concerns if c.kind == "delay")
        assert found.signal == "psi"
        one = next(d for d in estimate_delays(fit) if d.signal == "psi")
        assert abs(one.seconds - delay) < 3.5 * one.std + 0.1 * abs(delay)


def test_a_late_input_is_measured() -> None:
    """A rudder that acts a sample later than logged is told apart from a late sensor."""
    rng = np.random.default_rng(3)
    records = []
    for index, period in enumerate((30.0, 17.0, 45.0)):
        times = 0.5 * np.arange(300)
        true = 0.3 * np.sign(np.sin(2 * np.pi * times / period))
        states = simulate_yaw(times, np.r_[0.0, true[:-1]], np.zeros(2), TRUE)
        outputs = states + NOISE * rng.standard_normal(states.shape)
        records.append(Record(str(index), times, true[:, None], outputs, yaw_model().channels))
    fit = WHITE.fit(yaw_model(), Dataset(tuple(records)))
    found = [c for c in fit.concerns if c.kind == "delay"]
    assert [c.signal for c in found] == ["delta"]
    assert found[0].size == pytest.approx(0.5, rel=0.2)


def test_colour_counts_independent_samples() -> None:
    """Noise that remembers 0.7 per sample is named with the share of independent samples."""
    rng = np.random.default_rng(4)

    def colour(record: Record) -> np.ndarray:
        slow = np.zeros(record.outputs.shape)
        for k in range(1, len(slow)):
            slow[k] = 0.7 * slow[k - 1] + np.sqrt(1 - 0.49) * rng.standard_normal(2)
        return record.outputs + NOISE * slow

    fit = WHITE.fit(yaw_model(), changed(yaw_data(6, noise=np.zeros(2)), colour))
    shares = {c.signal: c.size for c in fit.concerns if c.kind == "colour"}
    assert set(shares) == {"psi", "r"}
    # (1 - 0.7) / (1 + 0.7) = 0.18 of a long series.
    assert all(0.1 < share < 0.45 for share in shares.values())
    assert "noise_level" not in kinds(fit)


def test_visible_integration_errors_are_not_converged() -> None:
    """A lag of 9 1/s fitted from 500 ends at the edge of stability, and does not pass."""
    model = lag(500.0)
    fit = MultipleShooting().fit(model, lag_data(model))
    assert fit.values["a"] == pytest.approx(21.7, rel=0.01)
    assert fit.status.code == "integration"
    assert not fit.status.ok
    right = MultipleShooting().fit(lag(8.0, step=0.02), lag_data(model))
    assert right.status.ok
    assert right.values["a"] == pytest.approx(9.0, abs=4 * right.std_errors["a"])


def test_runaway_values_are_not_converged() -> None:
    """Values and outputs beyond any scale end the trust in a fit."""
    fit = WHITE.fit(yaw_model(), yaw_data(7))
    far = replace(fit, estimates=fit.estimates * np.array([1.0, -1e130, 1.0]))
    assert [c.kind for c in judge(far)] == ["runaway"]
    away = replace(fit, predictions=tuple(1e12 + part for part in fit.predictions))
    assert [c.kind for c in judge(away)] == ["runaway"]


def test_a_model_at_rest_is_degenerate() -> None:
    """A fit whose rates are all zero explains less than a constant, and says so."""
    free = lag()
    model = free.with_parameter(Parameter("a", 1e-6, "1/s", lower=0.0, upper=1e-5, scale=1e-6))
    fit = MultipleShooting(disturbances="none").fit(model, lag_data(free))
    assert fit.status.code == "degenerate"
    assert not fit.status.ok
    assert [c.signal for c in fit.concerns if c.kind == "degenerate"] == ["x"]


def test_per_record_zeros_that_follow_the_rudder() -> None:
    """A zero that grows with the rudder is named; one that is calibration is not."""
    rng = np.random.default_rng(9)
    model = replace(
        yaw_model(),
        kinematics={"psi": "r", "r": "(K*(delta + zero) - r - alpha*r**3)/T"},
        parameters=(
            *yaw_model().parameters,
            Parameter("zero", 0.0, "rad", scale=0.03, per_record=True),
        ),
    )
    for grows in (True, False):
        records = []
        for index, size in enumerate((0.1, 0.2, 0.3, 0.4, 0.5)):
            times = 0.5 * np.arange(200)
            delta = size * np.sign(np.sin(2 * np.pi * times / 30.0))
            zero = 0.1 * size if grows else 0.03 * (-1.0) ** index
            states = simulate_yaw(times, delta + zero, np.zeros(2), TRUE)
            outputs = states + NOISE * rng.standard_normal(states.shape)
            records.append(Record(str(index), times, delta[:, None], outputs, model.channels))
        fit = WHITE.fit(model, Dataset(tuple(records)))
        found = [c for c in fit.concerns if c.kind == "per_record_follows"]
        assert [c.signal for c in found] == (["zero"] if grows else [])
        if grows:
            assert found[0].size > 0.95


def test_few_samples_and_absorbed_noise() -> None:
    """Too few samples, and estimated noise that hides a model without rudder, are named."""
    data = yaw_data(10)
    short = WHITE.fit(yaw_model().fix("alpha"), Dataset((data[0].window(0.0, 2.0),)))
    assert [c.size for c in short.concerns if c.kind == "few_samples"] == [10 / 4]
    blind = yaw_model(K=Parameter("K", -0.02, "1/s", fixed=True))
    fit = MultipleShooting(noise="estimate", disturbances="none").fit(blind, data)
    factors = [c.size for c in fit.concerns if c.kind == "absorbed"]
    assert factors
    assert min(factors) > 1.5


def test_noise_of_a_logged_input_is_named() -> None:
    """White noise on the logged rudder is found where it matters, a clean log is not accused."""
    rng = np.random.default_rng(11)
    clean = yaw_data(11)
    noisy = Dataset(
        tuple(
            replace(r, inputs=r.inputs + 0.02 * rng.standard_normal(r.inputs.shape)) for r in clean
        )
    )
    assert "input_noise" in kinds(WHITE.fit(yaw_model(), noisy))
    assert "input_noise" not in kinds(WHITE.fit(yaw_model(), clean))


def test_filters_state_whether_their_innovations_are_right() -> None:
    """A joint filter with noise declared four times too small is not converged."""
    outputs = yaw_model().outputs
    data = yaw_data(12)
    for factor, code in ((1.0, "converged"), (0.25, "inconsistent")):
        declared = tuple(
            replace(output, noise_std=float(factor * level))
            for output, level in zip(outputs, NOISE, strict=True)
        )
        fit = JointKalmanFilter().fit(replace(yaw_model(), outputs=declared), data)
        assert fit.status.code == code
        assert (fit.extras["innovation"] ** 2 > 2.0) == (code != "converged")


def test_concerns_are_reported_and_stored() -> None:
    """Every concern is in the report's warnings and, as plain data, in ``to_dict``."""
    fit = MultipleShooting(noise=0.5 * NOISE, disturbances="none").fit(yaw_model(), yaw_data(13))
    assert fit.concerns is fit.concerns
    text, plain = fit.report(), fit.to_dict()
    assert len(plain["concerns"]) == len(fit.concerns) == 2
    json.dumps(plain["concerns"], allow_nan=False)
    for concern in fit.concerns:
        assert concern.text in text


def test_what_no_record_shows_and_has_left_its_scale_ran_away() -> None:
    """A value far beyond its start whose own error is infinite is no estimate."""
    fit = WHITE.fit(yaw_model(), yaw_data(10))
    start = fit.nominal[fit.names[0]]
    seen = replace(fit, estimates=np.array([1e5 * start, *fit.estimates[1:]]))
    assert "runaway" not in [c.kind for c in judge(seen)]
    covariance = fit.covariance.copy()
    covariance[0, 0] = np.inf
    unseen = replace(seen, covariance=covariance)
    assert [c.kind for c in judge(unseen)] == ["runaway"]


def test_every_kind_of_concern_is_a_row_and_is_documented() -> None:
    """Kinds of the table are those of :class:`Concern`; each says what it takes."""
    for check in CHECKS:
        assert f"``{check.kind}``" in Concern.__doc__
        assert check.threshold
    fatal = [check.kind for check in CHECKS][: len(FATAL)]
    assert fatal == list(FATAL)
