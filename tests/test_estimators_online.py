"""Online regressions: equal to the batch at every sample, at a flat cost."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from benchmarks.documents.published import paper
from oed_sysid import Dataset, load_problem
from oed_sysid.baselines import (
    EquationStream,
    IncrementalLSSVM,
    OnlineRegression,
    RecursiveLeastSquares,
    RecursiveLSSVM,
)
from oed_sysid.baselines.support_vectors import GaussianKernel, train
from oed_sysid.errors import ModelError, PrecisionWarning
from oed_sysid.experiments.simulation import simulate

SHIP = load_problem("online_ship")
RECORD = simulate(SHIP.model, SHIP.experiment("zigzag_5_5"), noise=False)
DATA = Dataset((RECORD,))
SCRIPT = paper("online_ship")
FEATURES, TARGETS = SCRIPT.yaw_rows()


def gap(first: np.ndarray, second: np.ndarray) -> float:
    """Relative difference of two vectors."""
    return float(np.linalg.norm(first - second) / np.linalg.norm(second))


@pytest.mark.parametrize(
    ("method", "noise", "weight", "limit"),
    [
        ("cholesky", 0.0, 3e5, 1e-11),
        ("cholesky", 0.01, 3e5, 1e-11),
        ("inverse", 0.0, 3e5, 1e-8),
        ("inverse", 0.01, 3e5, 1e-8),
        ("inverse", 0.01, 1e3, 1e-11),
    ],
)
def test_incremental_equals_batch_at_every_step(
    method: str, noise: float, weight: float, limit: float
) -> None:
    """From two samples to two hundred the recursion equals the batch dual solution."""
    machine = IncrementalLSSVM(C=weight, method=method)
    assert SCRIPT.recursion_gap(machine, *SCRIPT.yaw_rows(noise)) < limit


@pytest.mark.parametrize("weight", [1e3, 3e5])
def test_primal_recursion_equals_batch_at_every_step(weight: float) -> None:
    """The recursion in the size of the features is the LS-SVM, from the second sample on."""
    machine = RecursiveLSSVM(C=weight)
    machine.start(FEATURES[:1], TARGETS[:1])
    assert machine.bias == pytest.approx(TARGETS[0])
    assert SCRIPT.recursion_gap(RecursiveLSSVM(C=weight), FEATURES, TARGETS) < 1e-11


@pytest.mark.parametrize(
    ("machine", "limit"),
    [
        (IncrementalLSSVM(C=3e5, window=60), 1e-9),
        (IncrementalLSSVM(C=3e5, window=60, method="inverse", refresh=10), 1e-5),
        (RecursiveLSSVM(C=3e5, window=60), 1e-7),
    ],
    ids=["cholesky", "inverse", "primal"],
)
def test_window_forgets_exactly(machine: IncrementalLSSVM | RecursiveLSSVM, limit: float) -> None:
    """After any number of slides the machine equals a batch over the last sixty samples."""
    machine.start(FEATURES[:2], TARGETS[:2])
    worst = 0.0
    for k in range(2, len(TARGETS)):
        machine.update(FEATURES[k], TARGETS[k])
        if k >= 60:
            window = slice(k - 59, k + 1)
            batch = train(FEATURES[window], TARGETS[window], C=3e5)
            worst = max(worst, gap(machine.coefficients, batch.coefficients))
    assert machine.n_samples == 60
    assert worst < limit


def test_incremental_learns_any_kernel() -> None:
    """With an RBF kernel the recursion predicts as the batch does."""
    x = np.linspace(0, 6, 50)[:, None]
    kernel = GaussianKernel(0.8)
    machine = IncrementalLSSVM(C=100.0, kernel=kernel)
    machine.start(x[:2], np.sin(x[:2, 0]))
    for row in x[2:]:
        machine.update(row, np.sin(row[0]))
    batch = train(x, np.sin(x[:, 0]), C=100.0, kernel=kernel, form="dual")
    assert machine.predict(x + 0.05) == pytest.approx(batch.predict(x + 0.05), abs=1e-9)
    with pytest.raises(ModelError, match="linear kernel"):
        _ = machine.coefficients


def test_primal_state_does_not_grow() -> None:
    """What the recursion keeps has the size of the features, however many samples came."""
    rng = np.random.default_rng(1)
    x, y = rng.standard_normal((3000, 6)), rng.standard_normal(3000)
    machine = RecursiveLSSVM(C=1e3)
    machine.start(x[:2], y[:2])
    for row, target in zip(x[2:], y[2:], strict=True):
        machine.update(row, target)
    assert machine.n_samples == 3000
    assert machine.inverse.shape == (7, 7)


# Printed by an independent program, per cent, after 60 and after 200 samples.
INDEPENDENT = {
    "trapezoid": (
        [-1.317, -0.831, -1.375, -1.077, 0.637, -0.531],
        [-0.14, -0.113, -0.197, -0.198, 0.115, -0.119],
    ),
    "euler": (
        [-0.015, -5.843, -24.295, -16.707, 4.483, -9.991],
        [-16.332, -14.37, -3.563, -3.27, 11.719, -2.728],
    ),
}


@pytest.mark.parametrize("rule", INDEPENDENT)
@pytest.mark.parametrize("method", ["recursive", "incremental"])
def test_error_table_of_the_tanker(rule: str, method: str) -> None:
    """Errors of the six coefficients equal those of an independent program at both lengths."""
    fit = OnlineRegression(method=method, C=3e5, rule=rule).fit(SHIP.model, DATA)
    names = ("Y_v", "Y_r", "N_v", "N_r", "Y_delta", "N_delta")
    early, late = INDEPENDENT[rule]
    for name, at_60, at_200 in zip(names, early, late, strict=True):
        truth, track = SHIP.truth[name], fit.extras["history"][name]
        assert 100 * (track[59] / truth - 1) == pytest.approx(at_60, abs=2e-3)
        assert 100 * (fit.values[name] / truth - 1) == pytest.approx(at_200, abs=2e-3)


def test_stream_gives_the_rows_of_the_batch() -> None:
    """Samples pushed one by one give the rows that the whole record gives."""
    stream = EquationStream(SHIP.model, rule="trapezoid")
    rows = []
    for k, moment in enumerate(RECORD.times):
        sample = {"delta": RECORD.input("delta")[k]}
        sample |= {name: RECORD.output(name)[k] for name in ("v", "r", "psi")}
        rows += [row for row in stream.push(float(moment), sample) if row.equation == "r"]
    assert stream.names("r") == ("N_v", "N_r", "N_delta")
    assert np.array([row.features for row in rows]) == pytest.approx(FEATURES)
    assert np.array([row.target for row in rows]) == pytest.approx(TARGETS)


def test_stream_skips_missing_and_refuses_impossible_samples() -> None:
    """A missing output gives no row; a missing command or a clock set back is an error."""
    stream = EquationStream(SHIP.model, rule="euler")
    whole = {"delta": 0.1, "v": 0.0, "r": 0.0}
    assert stream.push(0.0, whole) == []
    assert stream.push(3.0, {"delta": 0.1, "v": np.nan, "r": 0.0}) == []
    with pytest.raises(ModelError, match="has no delta"):
        stream.push(6.0, {"v": 0.0, "r": 0.0})
    with pytest.raises(ModelError, match="not later"):
        stream.push(3.0, whole)


def test_forgetting_equals_weighted_least_squares() -> None:
    """With forgetting the recursion is least squares with weights that decay."""
    rng = np.random.default_rng(4)
    x, y = rng.standard_normal((300, 3)), rng.standard_normal(300)
    filter_ = RecursiveLeastSquares(np.zeros(3), std=1e4, forgetting=0.97)
    filter_.start(x, y)
    root = 0.97 ** (np.arange(300)[::-1] / 2)
    batch = np.linalg.lstsq(x * root[:, None], y * root, rcond=None)[0]
    assert filter_.coefficients == pytest.approx(batch, abs=1e-6)


def test_forgetting_without_excitation_stays_bounded() -> None:
    """Zero features for a long time do not blow the covariance up without limit."""
    filter_ = RecursiveLeastSquares(np.zeros(2), std=1.0, forgetting=0.9, largest_std=100.0)
    for _ in range(2000):
        filter_.update(np.zeros(2), 0.0)
    assert np.trace(filter_.inverse) <= 2 * 100.0**2 * (1 + 1e-9)


def test_machines_must_learn_before_they_tell() -> None:
    """A machine that has seen nothing says what to call."""
    for machine in (IncrementalLSSVM(), RecursiveLSSVM()):
        with pytest.raises(ModelError, match="learnt nothing"):
            _ = machine.bias


def test_published_recursion_warns_when_its_digits_are_lost() -> None:
    """With a weight beyond its digits the inverse warns and errs; Cholesky is silent and right."""
    first, second = (IncrementalLSSVM(C=1e14, method=way) for way in ("inverse", "cholesky"))
    batch = train(FEATURES, TARGETS, C=1e14)
    for machine in (first, second):
        machine.start(FEATURES[:2], TARGETS[:2])
        for row, target in zip(FEATURES[2:], TARGETS[2:], strict=True):
            machine.update(row, target)
    with pytest.warns(PrecisionWarning, match="lost its digits"):
        lost = gap(first.coefficients, batch.coefficients)
    assert first.residual > 1e-3
    assert lost > 0.01
    assert second.residual < 1e-3
    assert gap(second.coefficients, batch.coefficients) < 1e-3


def test_published_recursion_is_silent_where_it_is_sound() -> None:
    """At the published weight the residual is rounding, and nothing is said."""
    machine = IncrementalLSSVM(C=3e5, method="inverse")
    machine.start(FEATURES[:2], TARGETS[:2])
    for row, target in zip(FEATURES[2:], TARGETS[2:], strict=True):
        machine.update(row, target)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        coefficients = machine.coefficients
    assert machine.residual < 1e-6
    assert gap(coefficients, train(FEATURES, TARGETS, C=3e5).coefficients) < 1e-7
