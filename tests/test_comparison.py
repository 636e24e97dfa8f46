"""What acts in the worlds of the comparison, rivals tuned as their users would, and its numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import welch
from sklearn.linear_model import Ridge
from sklearn.model_selection import KFold, cross_val_score
from test_benchmark_worlds import made

from benchmarks.comparison import PAGE, STORE, cells, merged, ratios, summary, tables
from oed_sysid.baselines import JointKalmanFilter, LeastSquaresSVM
from oed_sysid.baselines.contest import Cell, load_scenario, run_cell, with_region
from oed_sysid.baselines.equations import exact_rates, regression_form, rows_of
from oed_sysid.baselines.support_vectors import best_weight
from oed_sysid.baselines.world import WORLDS, _narrow_band
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError

PROBLEM = "online_ship"


def test_swell_has_unit_variance_its_period_and_its_width() -> None:
    """The spectrum peaks at the period and is as wide at half its power as stated."""
    period = 25.0
    wave = _narrow_band((200_000, 2), period, 0.2, np.random.default_rng(1))
    assert wave.std(axis=0) == pytest.approx(1.0, rel=0.03)
    frequency, power = welch(wave[:, 0], nperseg=4096)
    assert frequency[np.argmax(power)] == pytest.approx(1 / period, rel=0.06)
    wide = np.ptp(frequency[power > 0.5 * power.max()]) * period
    assert wide == pytest.approx(0.2, rel=0.3)


def test_offsets_are_twice_the_noise_and_hidden_damping_moves_the_ship() -> None:
    """An offset is constant over the run; damping that a model lacks slows every motion."""
    sigma = load_scenario(PROBLEM).noise(1.0)
    clean, off = (made(world, noise=False, problem=PROBLEM) for world in ("ideal", "offset"))
    off = off - clean
    assert np.ptp(off, axis=0) == pytest.approx(0.0, abs=1e-12)
    assert np.abs(off[0]) == pytest.approx(2.0 * sigma)
    free, damped = (
        made(world, noise=False, problem="kvlcc2").std(axis=0) for world in ("ideal", "hidden")
    )
    slower = damped / free
    assert np.all(slower < 0.98)
    assert np.all(slower > 0.8)


def test_the_likeliest_process_noise_is_found_where_forces_act() -> None:
    """Innovations are of their stated size, and likelier than with any other level."""
    scenario = load_scenario(PROBLEM)
    model = scenario.with_noise(scenario.noise(1.0))
    rng = np.random.default_rng(5)
    record = WORLDS["forces_5"].record(model, scenario.train[0], rng=rng, noise=True)
    dataset = Dataset((record,))
    tuned, plain = JointKalmanFilter(process_std="likeliest"), JointKalmanFilter()
    size = tuned.fit(model, dataset).extras["innovation"]
    assert size == pytest.approx(1.0, abs=0.15)
    assert plain.fit(model, dataset).extras["innovation"] > 1.2 * size
    best = tuned._filtered(model, dataset).log_likelihood
    speeds = {s.name: s.scale for s in model.states if s.name in model.axes.values()}
    for share in (0.0, 1e-4, 1e-3, 1e-2, 1e-1):
        noise = {name: share * scale for name, scale in speeds.items()}
        other = replace(plain, process_std=noise)._filtered(model, dataset)
        assert other.log_likelihood <= best + 0.5


def test_cross_validated_weights_are_those_of_a_library() -> None:
    """Of the same weights scikit-learn's ridge regression chooses the same one."""
    rng = np.random.default_rng(2)
    features = rng.standard_normal((120, 6))
    targets = features @ rng.standard_normal(6) + 3.0 * rng.standard_normal(120) + 1.0
    found = best_weight(features, targets, bias=True)
    weights = 10.0 ** np.arange(-2, 9) / np.mean(features**2)
    folds = KFold(5)
    scores = [
        cross_val_score(
            Ridge(alpha=1.0 / weight), features, targets, cv=folds, scoring="neg_mean_squared_error"
        ).mean()
        for weight in weights
    ]
    assert found == pytest.approx(weights[int(np.argmax(scores))])
    with pytest.raises(ModelError, match="cross-validated"):
        LeastSquaresSVM(C="best")


def test_populations_search_a_region_that_the_problem_does_not_have() -> None:
    """From a quarter to four times the start value, for negative ones too; stated bounds stay."""
    model = load_scenario(PROBLEM).model
    free = with_region(model).free_parameters
    for p in free:
        assert (p.lower, p.upper) == pytest.approx(sorted((p.value / 4, 4 * p.value)))
    outcome = run_cell(Cell(PROBLEM, "cma_es", 1.0))
    assert outcome.errors
    bounded = load_scenario("torpedo").model
    kept = [(p.lower, p.upper) for p in with_region(bounded).free_parameters]
    assert kept == [(p.lower, p.upper) for p in bounded.free_parameters]


def test_ratios_compare_runs_on_the_same_record() -> None:
    """Medians of paired ratios by problem, their geometric mean, and reasons apart."""
    ours, rival = "multiple_shooting_disturbed", "ls_svm"
    rows = [
        {"problem": "a", "world": "ideal", "seed": seed, "runs": {ours: [one, 1, 1, 0, 0.1]}}
        for seed, one in enumerate((0.1, 0.2, 0.4))
    ]
    later = [
        {"problem": "a", "world": "ideal", "seed": seed, "runs": {rival: [other, 0, 1, 1, 0.1]}}
        for seed, other in enumerate((0.2, 0.6, 1.6))
    ]
    refused = {"problem": "b", "world": "ideal", "seed": 0}
    refused |= {"runs": {ours: [0.1, 1, 1, 0, 0.1], rival: "it is not linear"}}
    found = list(merged([*rows, *later, refused]).values())
    assert len(found) == 4
    assert ratios(found, "ideal", rival) == {"a": pytest.approx(3.0)}
    assert summary(found, ["ideal", "swell"], [ours, rival]) == pytest.approx(
        np.array([[1.0, np.nan], [3.0, np.nan]]), nan_ok=True
    )
    assert cells(found)["b", "ideal", rival] == "it is not linear"


def test_the_page_is_made_of_the_store() -> None:
    """Every number on the page of the comparison is that of the finished runs."""
    rows = list(merged(STORE.rows()).values())
    assert rows
    assert tables(rows) in PAGE.read_text(encoding="utf-8")


def test_equations_that_share_a_parameter_are_one_machine() -> None:
    """With the true rates of a torpedo, whose drag acts in surge and heave, it finds the truth."""
    problem = load_scenario("torpedo")
    run = WORLDS["ideal"].record(
        problem.model, problem.train[0], rng=np.random.default_rng(0), noise=False
    )
    dataset = Dataset((run,))
    rates = exact_rates(problem.model, dataset)
    for scale in ("raw", "unit"):
        machine = LeastSquaresSVM(C=1e12, scale=scale, rule="exact", rates=rates)
        fit = machine.fit(problem.model, dataset)
        found = np.array([fit.values[name] for name in problem.truth])
        assert found == pytest.approx(list(problem.truth.values()), rel=1e-4)
    assert rows_of(regression_form(problem.model), dataset).groups() == [(0, 1, 2)]
