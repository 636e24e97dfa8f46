"""Errors from what records say apart from one another: to first order, and by refits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from golden_files import restored
from marks import slow
from turning_ship import GAIN, NOISE, SHIP, TIME, record

from oed_sysid import Dataset, Fit, Model, MultipleShooting, Record, jackknife, turning_circle
from oed_sysid.errors import DataError, ModelError, SimulationError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.between_records import sources_of

WHITE = MultipleShooting(disturbances="none")


def ships(n: int, variation: float, seed: int, force: float = 0.0) -> Dataset:
    """Zigzags of ships whose K and T differ by a share from run to run."""
    rng = np.random.default_rng((11, seed))
    runs = []
    for index in range(n):
        run = record(f"run_{index}", rng, force=force)
        if not force:
            values = np.array([GAIN, TIME]) * (1 + variation * rng.standard_normal(2))
            own = SHIP.with_values({"K": float(values[0]), "T": float(values[1])})
            clean = simulate_inputs(own, run.times, inputs=run.inputs, initial={}).outputs
            run = run.with_outputs(clean + NOISE * rng.standard_normal(clean.shape))
        runs.append(run)
    return Dataset(runs)


@pytest.fixture(scope="module")
def differing() -> Dataset:
    """Six runs of ships that differ by a tenth."""
    return ships(6, 0.1, seed=2)


@pytest.fixture(scope="module")
def fit(differing: Dataset) -> Fit:
    """One ship fitted to all of them."""
    return WHITE.fit(SHIP, differing)


@pytest.mark.parametrize(
    ("estimator", "force", "n", "near"),
    [
        (WHITE, 0.0, 6, 0.15),
        (MultipleShooting(disturbances="none", horizon=10.0), 0.0, 6, 0.15),
        # Levels of the forces are estimated anew in refits, and held to first order.
        *slow((MultipleShooting(), 0.02, 4, 0.35)),
    ],
    ids=["whole records", "horizon", "disturbance forces"],
)
def test_first_order_is_near_refits(
    estimator: MultipleShooting, force: float, n: int, near: float
) -> None:
    """Leaving a record out of the sums moves estimates as leaving it out of the data does."""
    data = ships(n, 0.05, seed=1, force=force)
    found = estimator.fit(SHIP, data)
    assert (found.innovations is not None) == (force > 0)
    refits = jackknife(estimator, SHIP, data).std_errors
    for name in ("K", "T"):
        assert found.record_errors[name] == pytest.approx(refits[name], rel=near)


def sums(
    rng: np.random.Generator, variation: float, n: int = 6, size: int = 2
) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray, np.ndarray]:
    """Information and residual scores of unequal records of a linear model, error and white."""
    matrices, raw = [], []
    for _ in range(n):
        rows = np.exp(0.4 * rng.standard_normal()) * rng.standard_normal((20, size))
        matrices.append(rows.T @ rows)
        own = variation * rng.standard_normal(size)
        raw.append(matrices[-1] @ own + rows.T @ rng.standard_normal(20))
    inverse = np.linalg.inv(np.sum(matrices, axis=0))
    error = inverse @ np.sum(raw, axis=0)
    return matrices, [s - m @ error for m, s in zip(matrices, raw, strict=True)], error, inverse


@pytest.mark.parametrize("variation", [0.3, *slow(0.0, 2.0)])
def test_intervals_hold_and_are_not_smaller_than_honest(variation: float) -> None:
    """Noise alone, or parameters that vary from record to record: 95 % intervals hold."""
    rng = np.random.default_rng(3)
    errors, squares, held, stated = [], [], [], []
    for _ in range(500):
        matrices, scores, error, inverse = sums(rng, variation)
        scatter = sources_of(matrices, scores, np.zeros((2, 2))).scatter()
        errors.append(error)
        squares.append(np.diag(scatter.covariance))
        held.append(np.abs(error) < scatter.half_width())
        stated.append(np.abs(error) < 1.96 * np.sqrt(np.diag(inverse)))
    ratio = np.sqrt(np.mean(np.square(errors)) / np.mean(squares))
    # Efron & Stein: on average a jackknife does not understate.
    assert 0.7 < ratio < 1.05
    assert 0.9 < np.mean(held) < 0.985
    if variation == 2.0:  # what the information alone would have said
        assert np.mean(stated) < 0.5


def test_differences_that_noise_explains_are_seldom_told() -> None:
    """One right fit in a hundred may be told; parameters that clearly vary mostly are."""
    rng = np.random.default_rng(5)
    told = {}
    for variation in (0.0, 2.0):
        count = 0
        for _ in range(500):
            matrices, scores, _, inverse = sums(rng, variation)
            scatter = sources_of(matrices, scores, np.zeros((2, 2))).scatter()
            white = np.diag(inverse)
            count += bool(scatter.exceeds(white, white)[1].any())
        told[variation] = count / 500
    assert told[0.0] < 0.025
    assert told[2.0] > 0.9


def test_a_parameter_of_one_record_has_no_scatter() -> None:
    """What a single record tells is infinite between records, and does not spoil the others."""
    matrices = [np.diag([4.0, 1.0 if index == 2 else 0.0]) for index in range(5)]
    scores = [np.array([value, 0.0]) for value in (1.0, -1.0, 2.0, -2.0, 0.0)]
    scatter = sources_of(matrices, scores, np.zeros((2, 2))).scatter()
    assert np.isinf(scatter.covariance[1, 1])
    assert scatter.covariance[0, 1] == 0.0
    alone = sources_of(
        [m[:1, :1] for m in matrices], [s[:1] for s in scores], np.zeros((1, 1))
    ).scatter()
    assert scatter.covariance[0, 0] == pytest.approx(alone.covariance[0, 0])
    factor, clear = scatter.exceeds(np.full(2, 1e-9), np.full(2, 0.05))
    assert factor[0] > 100.0
    assert clear.tolist() == [True, False]


def test_what_a_prior_decides_keeps_its_error() -> None:
    """Records that tell nothing neither shrink the error of a prior nor differ."""
    rng = np.random.default_rng(6)
    matrices, scores, _, _ = sums(rng, 2.0)
    weak = [1e-4 * matrix for matrix in matrices]
    scatter = sources_of(weak, [1e-4 * score for score in scores], np.eye(2)).scatter()
    assert np.diag(scatter.covariance) == pytest.approx(np.ones(2), rel=0.1)
    factor, clear = scatter.exceeds(np.ones(2), np.diag(np.linalg.inv(np.eye(2) + sum(weak))))
    assert factor == pytest.approx(np.ones(2), rel=0.1)
    assert not clear.any()


def test_a_fit_says_that_records_differ(fit: Fit) -> None:
    """The report has a column of its own and names the parameters; the interval is Student's."""
    concern = next(one for one in fit.concerns if one.kind == "records_differ")
    assert concern.size > 2.0
    assert concern.signal in ("K", "T")
    text = fit.report()
    assert "between records" in text
    assert "jackknife()" in text
    low, high = fit.record_interval("K")
    assert (high - low) / 2 == pytest.approx(2.5706 * fit.record_errors["K"], rel=1e-4)
    assert low < GAIN < high
    inside = fit.interval("K")
    assert high - low > inside[1] - inside[0]


def test_a_right_fit_does_not() -> None:
    """Runs of one ship: no concern, no column, and errors as stated within a factor."""
    found = WHITE.fit(SHIP, ships(6, 0.0, seed=2))
    assert not [one for one in found.concerns if one.kind == "records_differ"]
    assert "between records" not in found.report()
    for name, error in found.record_errors.items():
        assert 0.4 < error / found.std_errors[name] < 2.5


def test_errors_between_records_can_be_taken_along(fit: Fit, tmp_path: Path) -> None:
    """They become the covariance, and are saved with the fit."""
    honest = fit.with_record_errors()
    assert honest.std_errors == pytest.approx(fit.record_errors)
    assert honest.values == fit.values
    assert restored(fit, tmp_path).record_errors == fit.record_errors


def test_what_is_predicted_carries_the_caveat(fit: Fit, differing: Dataset) -> None:
    """Bands and circles of the fit are said to be too narrow, those of the wider errors are not."""
    honest, right = fit.with_record_errors(), WHITE.fit(SHIP, ships(6, 0.0, seed=2))
    for one, narrow in ((fit, True), (honest, False), (right, False)):
        circle = turning_circle(one, speed=1.0, rudder=0.3, n_draws=10)
        found = one.predict(Dataset((differing[0],)))
        assert bool(one.caveat) == bool(circle.caveat) == bool(found.caveat) == narrow
        assert circle.to_dict()["caveat"] == one.caveat
        assert (one.caveat in circle.report()) == (one.caveat in found.report())
    wide = honest.predict(differing).model_std[0]
    assert np.nanmedian(wide / fit.predict(differing).model_std[0]) > 2.0


def test_too_few_records_are_refused(differing: Dataset) -> None:
    """Three records have no scatter to first order, two no jackknife."""
    three = WHITE.fit(SHIP, Dataset(differing[i] for i in range(3)))
    assert three.record_scatter is None
    assert three.record_errors == {}
    for ask in (three.with_record_errors, lambda: three.record_interval("K")):
        with pytest.raises(DataError, match="jackknife"):
            ask()
    with pytest.raises(DataError, match="Give 3 or more"):
        jackknife(WHITE, SHIP, Dataset(differing[i] for i in range(2)))


def test_a_jackknife_tells_who_moves_it(differing: Dataset) -> None:
    """Quantities of a purpose; a failing fit is left out and counted; the report names a run."""
    left_out = "run_4"

    def purpose(found: Fit) -> dict[str, float]:
        if left_out not in found.dataset.names:
            raise SimulationError("It never turns.")
        return {"K/T": found.values["K"] / found.values["T"]}

    found = jackknife(WHITE, SHIP, differing, purpose=purpose)
    assert set(found.without) == set(differing.names) - {left_out}
    assert found.freedom == 4
    rows = np.array([row[0] for row in found.without.values()])
    expected = np.sqrt(4 / 5 * np.sum((rows - rows.mean()) ** 2))
    assert found.std_errors["K/T"] == pytest.approx(expected)
    low, high = found.interval("K/T")
    assert (high - low) / 2 == pytest.approx(2.7764 * expected, rel=1e-4)
    worst = max(found.without, key=lambda name: abs(found.without[name][0] - found.values[0]))
    assert worst in found.report()
    assert "1 of the fits" in found.report()
    with pytest.raises(ModelError, match="Nothing is wanted"):
        jackknife(WHITE, SHIP, differing, purpose=lambda fit: {})


def test_one_success_is_no_scatter(differing: Dataset) -> None:
    """Where all fits but one fail, errors are infinite."""

    class Picky:
        """Fits all records, or all but the first."""

        def fit(self, model: Model, dataset: Dataset) -> Fit:
            if len(dataset) < 6 and "run_0" in dataset.names:
                raise SimulationError("No.")
            return WHITE.fit(model, dataset)

    found = jackknife(Picky(), SHIP, differing)
    assert found.std_errors == {"K": np.inf, "T": np.inf}
    assert found.interval("K") == (-np.inf, np.inf)


def test_records_keep_their_length_in_the_sums() -> None:
    """A record of twice the samples counts as what it is: unequal records are no trouble."""
    data = ships(6, 0.05, seed=4)
    longer: Record = data[0]
    shorter = Dataset((longer, *(run.window(0.0, 30.0) for run in list(data)[1:])))
    found = WHITE.fit(SHIP, shorter)
    refits = jackknife(WHITE, SHIP, shorter).std_errors
    for name in ("K", "T"):
        assert found.record_errors[name] == pytest.approx(refits[name], rel=0.3)
