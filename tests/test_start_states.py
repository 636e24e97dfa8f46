"""Start states that are free, held, or known with a stated error."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import (
    Dataset,
    Fit,
    Input,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    Record,
    State,
)
from oed_sysid.compiled.kernels import kernel
from oed_sysid.errors import DataError

TIMES = np.arange(0.0, 3.0, 0.1)
NOISE, KNOWN = 0.05, 0.03
TRUE_START = np.array([1.0, -0.5])


def oscillator() -> Model:
    """A damped oscillator, of which the position is measured."""
    return Model(
        "oscillator",
        (State("x", "m"), State("v", "m/s")),
        (Input("force", "N"),),
        (Output("x", "m", noise_std=NOISE),),
        {"x": "v", "v": "force - k*x - c*v"},
        parameters=(Parameter("k", 1.0, "1/s^2"), Parameter("c", 0.4, "1/s")),
    )


def record(rng: np.random.Generator, times: np.ndarray = TIMES, name: str = "run") -> Record:
    """A free decay with a little forcing, and noise."""
    model = oscillator()
    inputs = 0.3 * np.sin(2.0 * times)[:, None]
    code = kernel(model)
    z, _ = code.start(TRUE_START, inputs[0], model.value_vector, 0.0)
    clean = code.run(times, inputs, model.value_vector, z).outputs
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
            code = kernel(model)
            z, _ = code.start(TRUE_START, data[0].inputs[0], model.value_vector, 0.0)
            ends.append(code.run(TIMES, data[0].inputs, model.value_vector, z).outputs[:, 0])
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
    count = 60 if "random" in way else 150
    for _ in range(count):
        data = Dataset((record(rng),))
        starts: dict[str, object] = {}
        if way.startswith("known"):
            believed = TRUE_START + KNOWN * rng.normal(size=2)
            starts = {n: (float(b), KNOWN) for n, b in zip("xv", believed, strict=True)}
        elif way == "held":
            starts = dict(zip("xv", map(float, TRUE_START), strict=True))
        if "random" in way:
            fit = disturbed(oscillator(), data, starts)
        else:
            fit = ESTIMATOR.fit(oscillator(), data, start_states=starts)  # type: ignore[arg-type]
        root = np.linalg.cholesky(fit.covariance)
        scores.append(np.linalg.solve(root, fit.estimates - [1.0, 0.4]))
    variance = float(np.mean(np.square(scores)))
    spread = np.sqrt(2.0 / np.size(scores))
    # With a force admitted that is not there, intervals may be a little too wide.
    assert (0.5 if "random" in way else 1.0 - 3.5 * spread) < variance < 1.0 + 3.5 * spread


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
        ({"x": float("nan")}, "held"),
    ):
        with pytest.raises(DataError, match=words):
            ESTIMATOR.fit(oscillator(), data, start_states=starts)  # type: ignore[arg-type]


def test_a_fit_with_known_starts_is_kept_in_full(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """What was known of the start states is saved and reported."""
    data = Dataset((record(np.random.default_rng(7)),))
    fit = ESTIMATOR.fit(oscillator(), data, start_states={"x": (1.0, 0.02)})
    fit.save(tmp_path / "fit.json")
    again = Fit.load(tmp_path / "fit.json")
    assert again.start_states == fit.start_states == ({"x": (1.0, 0.02)},)
    assert again.n_unknowns == fit.n_unknowns == 4
    assert "start of run given: x 1.000 ± 0.039 (95 %)" in again.report()
