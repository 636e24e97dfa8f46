"""Whether records and priors can all be right about one model: chi-squared, and what it finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_design import ship

from oed_sysid import Dataset, Experiment, Fit, Model, MultipleShooting
from oed_sysid.experiments.manoeuvres import ThreeTwoOneOne
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.between_records import CHANCE, Sources, sources_of

WHITE = MultipleShooting(disturbances="none", noise="given")


def linear(rng: np.random.Generator, n_records: int, shift: float = 0.0) -> Sources:
    """Priors and records of a linear model of three parameters; one record may be of another."""
    truth = np.zeros(3)
    prior = np.diag([1.0, 4.0, 0.0])
    mean = truth + np.array([1.0, 0.5, 0.0]) * rng.standard_normal(3)
    matrices, own = [], []
    for index in range(n_records):
        # The second record does not see the last parameter.
        rows = rng.standard_normal((20, 3)) * [1.0, 2.0, 0.0 if index == 1 else 0.5]
        at = truth + shift * (index == 0) * np.array([1.0, 0.0, 0.0])
        measured = rows @ at + rng.standard_normal(20)
        matrices.append(rows.T @ rows)
        own.append(rows.T @ measured)
    whole = prior + np.sum(matrices, axis=0)
    joint = np.linalg.solve(whole, prior @ mean + np.sum(own, axis=0))
    scores = [right - matrix @ joint for matrix, right in zip(matrices, own, strict=True)]
    found = sources_of(matrices, scores, prior)
    assert found is not None
    np.testing.assert_allclose(found.scores[0], prior @ (mean - joint), atol=1e-9)
    return found


def test_right_sources_agree_as_often_as_chance_says() -> None:
    """Statistics are chi-squared with the stated freedom, also where a source sees not all."""
    rng = np.random.default_rng(0)
    found = [linear(rng, 3).agreement() for _ in range(400)]
    one = found[0]
    # Ranks 2, 3, 2, 3 of priors and records, less three parameters.
    assert one.freedom == 7
    assert one.each_freedom == (2, 3, 2, 3)
    chances = np.array([agreement.chances for agreement in found])
    # The mean of 400 uniform variables has a standard error of 0.014.
    np.testing.assert_allclose(chances.mean(axis=0), 0.5, atol=0.06)
    for share in (0.05, 0.2):
        np.testing.assert_allclose((chances < share).mean(axis=0), share, atol=0.06)
    assert np.mean([agreement.chance < 0.05 for agreement in found]) < 0.08


def test_a_record_of_another_vehicle_is_named_and_a_small_difference_allowed() -> None:
    """The source that differs is the worst; within the allowance it is not."""
    rng = np.random.default_rng(1)
    found = [linear(rng, 4, shift=2.0) for _ in range(20)]
    told = [sources.agreement() for sources in found]
    assert sum(agreement.chance < 1e-3 for agreement in told) >= 18
    assert sum(agreement.worst == 1 for agreement in told) >= 18
    apart = np.array([sources.apart(1) for sources in found])
    assert np.all(np.abs(apart[:, 0]) > 3.0)
    assert np.median(np.abs(apart[:, 1:])) < 2.0
    allowed = [sources.agreement(allowance=np.array([2.0, 0.0, 0.0])).chance for sources in found]
    assert sum(chance < 1e-3 for chance in allowed) == 0


def test_allowance_and_inflation_are_errors_added() -> None:
    """Two records of one parameter: the difference over the root of all variances."""
    sources = Sources(np.array([0.0, 1.0, 1.0])[:, None, None], np.array([[0.0], [2.0], [-2.0]]))
    assert sources.agreement().statistic == pytest.approx(16 / 2)
    assert sources.agreement(allowance=np.ones(1)).statistic == pytest.approx(16 / 4)
    assert sources.agreement(inflation=2.0).statistic == pytest.approx(16 / 4)
    assert sources.agreement().each == pytest.approx((0.0, 8.0, 8.0))


def runs(truth: Model, sizes: tuple[float, ...], seed: int) -> Dataset:
    """Runs of 3-2-1-1 of these rudder angles."""
    rng = np.random.default_rng((7, seed))
    records = []
    for index, size in enumerate(sizes):
        experiment = Experiment(
            f"run {index + 1}", ThreeTwoOneOne("rudder", size, unit_time=5.0), duration=60.0,
            sample_time=0.25,
        )  # fmt: skip
        records.append(simulate(truth, experiment, rng=rng))
    return Dataset(tuple(records))


def straight(model: Model) -> Model:
    """The ship believed to have linear damping only."""
    known = model.parameter("c")
    return replace(
        model,
        parameters=tuple(
            replace(known, value=0.0, fixed=True) if p.name == "c" else p for p in model.parameters
        ),
    )


@pytest.mark.parametrize("estimator", [WHITE, MultipleShooting()], ids=["white", "forces"])
def test_a_missing_term_shows_where_runs_differ_in_strength(estimator: MultipleShooting) -> None:
    """Quadratic damping that the model lacks: each run looks well, weak and strong ones differ."""
    contradicted, plain = [], []
    for seed in range(8):
        lacking = estimator.fit(straight(ship()), runs(ship(), (0.1, 0.35), seed))
        right = estimator.fit(ship(), runs(ship(), (0.1, 0.35), seed))
        for fit, chances in ((lacking, contradicted), (right, plain)):
            assert fit.sources is not None
            grown = np.mean(np.diag(fit.covariance) / np.diag(fit.information.covariance))
            chances.append(fit.sources.agreement(inflation=max(1.0, grown)).chance)
    assert sum(chance < CHANCE for chance in contradicted) >= 7
    assert sum(chance < CHANCE for chance in plain) == 0


def test_it_is_kept_in_a_file(tmp_path) -> None:
    """A saved fit agrees as it did."""
    fit = WHITE.fit(ship(), runs(ship(), (0.1, 0.3), 0))
    fit.save(tmp_path / "fit.json")
    again = Fit.load(tmp_path / "fit.json")
    assert again.sources is not None
    assert fit.sources is not None
    assert again.sources.agreement() == fit.sources.agreement()
