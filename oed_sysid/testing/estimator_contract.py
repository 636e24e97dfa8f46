"""The contract of an estimator, to be run on every estimator that is added.

>>> from math import radians
>>> from oed_sysid.physics.channels import Input, Output, State
>>> from oed_sysid.baselines import MultipleShooting
>>> from oed_sysid.experiments.experiment import Experiment
>>> from oed_sysid.experiments.manoeuvres import Doublet
>>> from oed_sysid.physics.model import Model
>>> from oed_sysid.physics.parameters import Parameter
>>> nomoto = Model(
...     "Nomoto", (State("psi", "rad"), State("r", "rad/s")), (Input("delta", "rad"),),
...     (Output("psi", "rad", noise_std=0.01),), {"psi": "r", "r": "(K*delta - r)/T"},
...     parameters=(Parameter("K", 0.1, "1/s"), Parameter("T", 10.0, "s")),
... )
>>> test = Experiment("test", Doublet("delta", 0.2, pulse_time=30.0), duration=90.0)
>>> report = check_estimator(
...     MultipleShooting(), nomoto, (test,), rng=np.random.default_rng(1), n_repeats=5
... )
>>> report.error < 1e-6, report.coverage > 0.7
(True, True)
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.base import Estimator
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.model import Model

LEVEL = 0.95


@dataclass(frozen=True)
class EstimatorCheck:
    """What was measured while an estimator was checked.

    Attributes
    ----------
    error : float
        Largest error without noise, in typical magnitudes of the parameters.
    coverage : float
        Share of the 95 per cent intervals that held the truth; NaN if not asked.
    """

    error: float
    coverage: float


def check_estimator(
    estimator: Estimator,
    model: Model,
    experiments: Sequence[Experiment],
    *,
    rng: np.random.Generator,
    start: Mapping[str, float] | None = None,
    tolerance: float = 1e-3,
    coverage: float | None = 0.85,
    n_repeats: int = 20,
) -> EstimatorCheck:
    """Check everything that the package relies on in an estimator.

    * It has a name, and its result has the model's free parameters, finite
      values and errors, and residuals of every record.
    * Without noise it finds the values that made the data, to ``tolerance``.
    * With noise its 95 per cent intervals hold the truth at least in the share
      ``coverage`` of all cases.
    * It changes neither model nor data, and gives the same result twice.

    Parameters
    ----------
    estimator : Estimator
        The estimator, as configured.
    model : Model
        A model at its true values; outputs state their noise.
    experiments : sequence of Experiment
        What to simulate.
    rng : numpy.random.Generator
        Source of the noise.
    start : mapping of str to float, optional
        Start values; by default a tenth above the truth, within bounds.
    tolerance : float
        What the estimator promises without noise, as a share of each
        parameter's typical magnitude.
    coverage : float or None
        What it promises of its intervals; None where its documentation says
        that they leave something out, such as the bias of noisy regressors.
    n_repeats : int
        Noise realisations.

    Returns
    -------
    EstimatorCheck
        What was measured.

    Raises
    ------
    AssertionError
        With a line for every broken promise.
    """
    broken: list[str] = []
    if not isinstance(estimator, Estimator) or not str(estimator.name):
        raise AssertionError("An estimator has a name and fit(model, dataset) -> Fit.")
    first = model.with_values(_start(model) if start is None else start)
    exact = Dataset(tuple(simulate(model, e, noise=False) for e in experiments))
    before = copy.deepcopy((first, [(r.times, r.inputs, r.outputs) for r in exact]))
    fit = estimator.fit(first, exact)
    again = estimator.fit(first, exact)
    broken += _shape(fit, first, exact)
    if fit.status.code not in ("converged", "iterations", "stalled"):
        broken.append(f"ends without noise as {fit.status}")
    error = float(np.max(np.abs(_errors(fit, model)) / _magnitudes(model)))
    if not error <= tolerance:
        worst = model.free_names[int(np.argmax(np.abs(_errors(fit, model)) / _magnitudes(model)))]
        broken.append(f"is off by {error:.2g} in {worst} without noise, promised {tolerance:g}")
    if not np.array_equal(fit.estimates, again.estimates):
        broken.append("gives two results for the same data; take a seed")
    after = (first, [(r.times, r.inputs, r.outputs) for r in exact])
    if not _same(before, after):
        broken.append("changes the model or the data that it is given")
    share = float("nan")
    if coverage is not None:
        share = _coverage(estimator, model, first, experiments, rng, n_repeats)
        if share < coverage:
            broken.append(f"its 95 % intervals hold the truth in {share:.0%}, below {coverage:.0%}")
    if broken:
        lines = "\n".join(f"- {text}" for text in broken)
        raise AssertionError(f"Estimator {estimator.name!r}:\n{lines}")
    return EstimatorCheck(error, share)


def _start(model: Model) -> dict[str, float]:
    return {
        p.name: float(np.clip(p.value + 0.1 * p.magnitude, p.lower, p.upper))
        for p in model.free_parameters
    }


def _magnitudes(model: Model) -> np.ndarray:
    return np.array([p.magnitude for p in model.free_parameters])


def _errors(fit: Fit, model: Model) -> np.ndarray:
    """Estimates minus truth, shape ``(n_free,)``."""
    return np.array([fit.values[name] - model.values[name] for name in model.free_names])


def _shape(fit: Fit, model: Model, dataset: Dataset) -> list[str]:
    """What a result must hold, whatever the estimator."""
    broken = []
    n = len(model.free_names)
    if tuple(fit.names) != model.free_names:
        broken.append(f"returns {fit.names}, expected {model.free_names}")
    if fit.estimates.shape != (n,) or fit.covariance.shape != (n, n):
        broken.append("returns estimates or covariance of another shape than the parameters")
    elif not (np.isfinite(fit.estimates).all() and np.isfinite(fit.covariance).all()):
        broken.append("returns values or errors that are not finite")
    elif np.linalg.eigvalsh(fit.correlation).min() < -1e-6:
        broken.append("returns a covariance with negative variances")
    shapes = [record.outputs.shape for record in dataset]
    if [r.shape for r in fit.residuals] != shapes or [r.shape for r in fit.predictions] != shapes:
        broken.append("returns residuals or predictions of another shape than the records")
    if not fit.report():
        broken.append("returns a fit without a report")
    return broken


def _same(before: tuple, after: tuple) -> bool:
    if before[0] != after[0]:
        return False
    pairs = zip(before[1], after[1], strict=True)
    return all(
        np.array_equal(old, new, equal_nan=True)
        for first, second in pairs
        for old, new in zip(first, second, strict=True)
    )


def _coverage(
    estimator: Estimator,
    model: Model,
    start: Model,
    experiments: Sequence[Experiment],
    rng: np.random.Generator,
    n_repeats: int,
) -> float:
    """Share of intervals that hold the truth, over noise realisations and parameters."""
    held = []
    for _ in range(n_repeats):
        data = Dataset(tuple(simulate(model, e, rng=rng) for e in experiments))
        fit = estimator.fit(start, data)
        for name in model.free_names:
            low, high = fit.interval(name, LEVEL)
            held.append(low <= model.values[name] <= high)
    return float(np.mean(held))
