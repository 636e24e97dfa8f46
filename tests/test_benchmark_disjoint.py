"""Halves of measured zigzags, and records whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from benchmarks.disjoint import (
    BEGIN,
    END,
    KINDS,
    PAGE,
    Case,
    Scores,
    compare,
    halves,
    simulated,
    weak_and_strong,
)
from benchmarks.harness import between
from oed_sysid import Dataset, Fit, Model, MultipleShooting, load_problem
from oed_sysid.data import third_party
from oed_sysid.prediction.structures import Structure
from tests.turning_ship import SHIP, record

needs_data = pytest.mark.skipif(
    not (third_party.data_folder() / "kvlcc2_hsva_zigzag").is_dir(),
    reason="third-party data is not in OED_SYSID_DATA",
)


@pytest.mark.parametrize("freedom", [4.0, 8.0, np.inf])
def test_statistics_of_honest_errors_are_those_of_student(freedom: float) -> None:
    """The median and the coverage are one and 95 % whatever the freedom; the rms has its tails."""
    rng = np.random.default_rng(0)
    z = student.rvs(1e9 if np.isinf(freedom) else freedom, size=20000, random_state=rng)
    scores = Scores(z, np.full(len(z), freedom))
    assert scores.median == pytest.approx(1.0, abs=0.03)
    assert scores.coverage == pytest.approx(0.95, abs=0.005)
    expected = 1.0 if np.isinf(freedom) else np.sqrt(freedom / (freedom - 2))
    assert scores.rms == pytest.approx(expected, rel=0.06)
    small = Scores(3.0 * z, scores.freedom)
    assert small.median == pytest.approx(3 * scores.median)
    assert small.coverage < 0.75


def test_errors_of_what_follows_from_parameters() -> None:
    """To first order by both covariances; refits are jackknifed; fits are made once."""
    rng = np.random.default_rng(2)
    data = Dataset(tuple(record(f"run_{i}", rng) for i in range(4)))
    count = []

    class Counted:
        """Counts its fits."""

        def fit(self, model: Model, dataset: Dataset) -> Fit:
            count.append(len(dataset))
            return MultipleShooting(disturbances="none").fit(model, dataset)

    case = Case(
        "sum",
        Structure("", SHIP, Counted()),
        data,
        lambda fit: {"20 K + T": 20 * fit.model.values["K"] + fit.model.values["T"]},
    )
    everything = tuple(range(4))
    answer = case.answer(everything)
    fit = case.fit(everything)
    assert answer is not None
    assert fit is not None
    weights = np.array([20.0, 1.0])
    assert answer.stated[0] == pytest.approx(np.sqrt(weights @ fit.covariance @ weights))
    between = fit.record_scatter.covariance
    assert answer.between[0] == pytest.approx(np.sqrt(weights @ between @ weights))
    errors, freedom = case.jackknife(everything)
    assert freedom == 3
    assert errors[0] == pytest.approx(answer.between[0], rel=0.2)
    assert case.jackknife(everything)[0] == pytest.approx(errors)
    assert sorted(count) == [3, 3, 3, 3, 4]


def test_halves_are_disjoint_and_complete() -> None:
    """Every record is in one half; partitions differ."""
    found = halves(10, 6)
    for first, second in found:
        assert len(first) == len(second) == 5
        assert sorted(first + second) == list(range(10))
    assert len(set(found)) == 6


@pytest.mark.parametrize("variation", [0.0, 0.15])
def test_simulated_truth(variation: float) -> None:
    """Errors between records hold with one ship and with five, those of the fit less often then."""
    rng = np.random.default_rng(1)
    logs = [record(f"run_{i}", rng) for i in range(5)]
    trial = simulated(SHIP, logs, variation, 25)
    size, between = np.abs(trial.errors), trial.between
    held = np.mean(size < student.ppf(0.975, 4) * between)
    ratio = np.sqrt(np.mean(trial.errors**2 / np.mean(between**2, axis=0)))
    assert held > 0.85
    assert 0.6 < ratio < 1.3
    stated = np.mean(size < 1.96 * trial.stated)
    assert trial.told < 0.2
    if variation:
        assert stated < held
    else:
        assert stated > 0.85
    assert f"{100 * stated:.0f} %" in trial.row("ships")


@needs_data
def test_zigzags_of_the_tanker_differ_by_more_than_stated() -> None:
    """Two random halves: stated errors are far too small, both kinds between records are not."""
    heading = load_problem("kvlcc2")
    white = MultipleShooting(disturbances="none")
    case = Case("Nomoto", Structure("", heading.model, white), heading.data())
    random, lost = compare(case, halves(10, 2))
    assert lost == 0
    assert random[KINDS[0]].rms > 1.5
    for kind in KINDS[1:]:
        assert 0.3 < random[kind].rms < 1.4
        assert random[kind].coverage > 0.8
    weak, strong = weak_and_strong(case.dataset)
    rudder = [float(np.abs(run.input("delta")).max()) for run in case.dataset]
    assert max(rudder[i] for i in weak) <= min(rudder[i] for i in strong) * 1.05


def test_the_page_has_the_tables() -> None:
    """The command writes between the marks of the page and nowhere else."""
    page = PAGE.read_text(encoding="utf-8")
    assert page.count(BEGIN) == page.count(END) == 1
    new = between(page, BEGIN, END, ["| new |"])
    assert "| new |" in new
    assert new.partition(BEGIN)[0] == page.partition(BEGIN)[0]
    assert new.partition(END)[2] == page.partition(END)[2]
