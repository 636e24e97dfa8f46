"""The published experiment on sparse headings, and the curves that fill them in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.documents.published import paper
from oed_sysid import Dataset, Record, load_problem, simulate
from oed_sysid.baselines import HeadingDifferences
from oed_sysid.errors import DataError, ModelError

PROBLEM = load_problem("nomoto_sparse_heading")
SCRIPT = paper("nomoto_sparse_heading")
METHODS, dense_times, densify = SCRIPT.METHODS, SCRIPT.dense_times, SCRIPT.densify
archimedes_spiral, reconstruct = SCRIPT.archimedes_spiral, SCRIPT.reconstruct
# An independent program's mean of |dK| and |dT| relative to 0.1 s, per cent.
INDEPENDENT = {
    ("default", "zigzag_15_15"): (10.65, 33.10, 1.38, 2.01, 2.54, 14.22),
    ("K0.5_T0.6", "fast_rudder"): (5.12, 11.58, 2.34, 2.10, 3.38, 12.81),
    ("K0.5_T1", "fast_rudder"): (4.23, 11.95, 2.02, 1.56, 1.89, 10.41),
    ("K0.5_T2", "fast_rudder"): (3.91, 11.98, 0.92, 0.62, 1.09, 9.63),
}


def gain_and_time(record: Record, scheme: str = "forward") -> np.ndarray:
    """K and T by differences of the heading."""
    fit = HeadingDifferences(scheme).fit(PROBLEM.model, Dataset((record,)))
    return np.array([fit.values["K"], fit.values["T"]])


@pytest.mark.parametrize(("variant", "experiment"), INDEPENDENT, ids=lambda text: text)
def test_error_table(variant: str, experiment: str) -> None:
    """Errors of sparse sampling and of every curve equal an independent program's."""
    problem = PROBLEM.variant(variant)
    record = simulate(problem.model, problem.experiment(experiment), noise=False)
    sparse = record.thin(50)
    reference = gain_and_time(record.thin(10))
    candidates = [record.thin(20), sparse]
    candidates += [reconstruct(sparse, 5, method=m) for m in METHODS]
    found = [50 * np.abs(gain_and_time(c) / reference - 1).sum() for c in candidates]
    assert found == pytest.approx(INDEPENDENT[variant, experiment], abs=6e-3)


def test_central_differences_are_of_second_order() -> None:
    """At 0.1 s central differences are far closer than the published forward ones."""
    problem = PROBLEM.variant("K0.5_T1")
    record = simulate(problem.model, problem.experiment("fast_rudder"), noise=False).thin(10)
    truth = np.array([0.5, 1.0])
    forward, central = (
        np.abs(gain_and_time(record, s) / truth - 1).max() for s in ("forward", "central")
    )
    assert central < 0.1 * forward


@pytest.mark.parametrize("method", METHODS)
def test_curves_pass_through_the_samples(method: str) -> None:
    """Every method keeps the samples and is exact for a straight line."""
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.3, 0.7, 12))
    values = np.sin(times)
    dense = densify(times, values, 5, method=method)
    assert dense[::5] == pytest.approx(values, abs=1e-12)
    line = densify(times, 2 * times - 1, 5, method=method)
    assert line == pytest.approx(2 * dense_times(times, 5) - 1, abs=1e-9)


def test_spiral_lies_on_an_archimedes_spiral() -> None:
    """Inserted points fulfil the polar equation: distance in proportion to the turn."""
    times, values = np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 1.0])
    dense, grid = archimedes_spiral(times, values, 20), dense_times(times, 20)
    from_corner = np.column_stack([grid[21:] - 1.0, dense[21:]])
    distance = np.hypot(*from_corner.T)
    bearing = np.arctan2(from_corner[:, 1], from_corner[:, 0])
    assert distance / bearing == pytest.approx(np.full(20, np.sqrt(2) / (np.pi / 4)), rel=1e-9)


def test_chord_rule_damps_a_disturbance_and_exact_tangents_do_not() -> None:
    """A kink in the first samples decays by 4/5 per interval with the published rule only."""
    times = np.arange(40.0)
    values = np.where(times == 0, 0.05, 0.0)
    wiggle = {
        tangent: np.abs(archimedes_spiral(times, values, 5, tangent=tangent)[-50:]).max()
        for tangent in ("chord", "exact")
    }
    assert wiggle["chord"] < 1e-4
    assert wiggle["exact"] > 1e-2


def test_impossible_input_is_refused() -> None:
    """Uneven records and other models are errors with advice."""
    record = simulate(PROBLEM.model, PROBLEM.experiment("zigzag_15_15"), noise=False).thin(50)
    times = record.times.copy()
    times[5] += 0.1
    with pytest.raises(DataError, match="not sampled uniformly"):
        HeadingDifferences().fit(PROBLEM.model, Dataset((replace(record, times=times),)))
    with pytest.raises(ModelError, match="expected K and T"):
        HeadingDifferences().fit(PROBLEM.model.fix("K"), Dataset((record,)))
