r"""Contracts of methods, of estimators and of criteria.

The contract of an estimator, to be run on every estimator that is added.

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

The contract of a design criterion, to be run on every criterion that is added.

A criterion maps the information :math:`F` on scaled parameters to a number, larger is
better. With :math:`S` a change of units and :math:`v v'` one more measurement,

.. math::
    \phi(F + v v') \ge \phi(F), \qquad
    \phi_S(S F_1 S) - \phi_S(S F_2 S) = \phi(F_1) - \phi(F_2)

the first for all that measure size, the second for those that are invariant.

>>> from oed_sysid.physics.channels import Input, Output, State
>>> from oed_sysid.design import DOptimal
>>> from oed_sysid.physics.model import Model
>>> from oed_sysid.physics.parameters import Parameter
>>> nomoto = Model(
...     "Nomoto",
...     (State("psi", "rad"), State("r", "rad/s")),
...     (Input("delta", "rad"),),
...     (Output("psi", "rad", noise_std=0.01),),
...     {"psi": "r", "r": "(K*delta - r)/T"},
...     parameters=(Parameter("K", 0.2, "1/s"), Parameter("T", 15.0, "s")),
... )
>>> check_criterion(DOptimal(), nomoto, rng=np.random.default_rng(1), invariant=True)
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oed_sysid import Dataset, Experiment, Fit, Model, OedSysidError, simulate
from oed_sysid.design.criteria import Criterion, Setting
from oed_sysid.information.noise import noise_of
from oed_sysid.likelihood.estimator import Estimator
from oed_sysid.runtime.constants import DIFFERENCE_STEP, ROUNDING
from oed_sysid.testing.problem_contract import refuse, unkept

# -- the contract of an estimator ------------------------------------------------------


@dataclass(frozen=True)
class EstimatorCheck:
    """What was measured while an estimator was checked.

    Attributes
    ----------
    error : float
        Largest error without noise, in typical magnitudes of the parameters.
    coverage : float
        Share of the 95 per cent intervals that held the truth; NaN if not asked.

    Examples
    --------
    >>> EstimatorCheck(error=2e-5, coverage=0.94).coverage
    0.94
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

    Examples
    --------
    In a test, of an estimator ``mine`` on a problem's model and experiments::

        check_estimator(mine, problem.true_model(), [*problem.experiments.values()], rng=rng)
    """
    if not isinstance(estimator, Estimator) or not str(estimator.name):
        raise AssertionError("An estimator has a name and fit(model, dataset) -> Fit.")
    free = model.free_parameters
    away = {p.name: p.value + 0.1 * p.magnitude for p in free}
    first = model.within_bounds(away) if start is None else model.with_values(start)

    def simulated(**noise: Any) -> Dataset:
        return Dataset(tuple(simulate(model, e, **noise) for e in experiments))

    exact = simulated(noise=False)
    before = copy.deepcopy((first, _arrays(exact)))
    fit, again = estimator.fit(first, exact), estimator.fit(first, exact)
    same = before[0] == first and before[1] == _arrays(exact)
    errors = [abs(fit.values[p.name] - p.value) / p.magnitude for p in free]
    error, share, least = float(max(errors)), float("nan"), coverage or 0.0
    worst = model.free_names[int(np.argmax(errors))]
    if coverage is not None:
        share = _coverage(estimator, model, first, (simulated(rng=rng) for _ in range(n_repeats)))
    claims = (
        (fit.status.code in ("converged", "iterations", "stalled"),
         f"ends without noise as {fit.status}"),
        (error <= tolerance,
         f"is off by {error:.2g} in {worst} without noise, promised {tolerance:g}"),
        (np.array_equal(fit.estimates, again.estimates),
         "gives two results for the same data; take a seed"),
        (same, "changes the model or the data that it is given"),
        (not share < least, f"its 95 % intervals hold the truth in {share:.0%}, below {least:.0%}"),
    )  # fmt: skip
    refuse(f"Estimator {estimator.name!r}", [*_shape(fit, first, exact), *unkept(claims)])
    return EstimatorCheck(error, share)


def _arrays(dataset: Dataset) -> list[bytes]:
    return [part.tobytes() for r in dataset for part in (r.times, r.inputs, r.outputs)]


def _shape(fit: Fit, model: Model, dataset: Dataset) -> list[str]:
    """What a result must hold, whatever the estimator."""
    n = len(model.free_names)
    sized = fit.estimates.shape == (n,) and fit.covariance.shape == (n, n)
    finite = sized and np.isfinite([*fit.estimates, *fit.covariance.ravel()]).all()
    shapes = [record.outputs.shape for record in dataset]
    found = [[part.shape for part in parts] for parts in (fit.residuals, fit.predictions)]
    claims = (
        (tuple(fit.names) == model.free_names, f"returns {fit.names}, expected {model.free_names}"),
        (sized, "returns estimates or covariance of another shape than the parameters"),
        (finite or not sized, "returns values or errors that are not finite"),
        (not finite or np.linalg.eigvalsh(fit.correlation).min() >= -1e-6,
         "returns a covariance with negative variances"),
        (found == [shapes, shapes],
         "returns residuals or predictions of another shape than the records"),
        (fit.report(), "returns a fit without a report"),
    )  # fmt: skip
    return unkept(claims)


def _coverage(estimator: Estimator, model: Model, start: Model, noisy: Iterable[Dataset]) -> float:
    """Share of intervals that hold the truth, over noise realisations and parameters."""
    held = []
    for data in noisy:
        fit = estimator.fit(start, data)
        for name in model.free_names:
            low, high = fit.interval(name, 0.95)
            held.append(low <= model.values[name] <= high)
    return float(np.mean(held))


# -- the contract of a design criterion ------------------------------------------------


def check_criterion(
    criterion: Criterion,
    model: Model,
    *,
    rng: np.random.Generator,
    invariant: bool = False,
    monotone: bool = True,
    n_points: int = 4,
) -> None:
    """Check everything that the search for experiments relies on in a criterion.

    * It has a name, and ``bind`` gives a value and a symmetric derivative of the shape of
      the information; both are finite, also where nothing is known of a parameter.
    * It gives the same result twice and leaves the matrix alone.
    * Its derivative equals finite differences.
    * More information never counts less, where that is claimed.
    * Comparisons of designs do not depend on the parameters' units, where that is claimed.

    Parameters
    ----------
    criterion : Criterion
        The criterion, as configured.
    model : Model
        With two or more free parameters, and outputs that state their noise.
    rng : numpy.random.Generator
        Source of the matrices.
    invariant : bool
        Whether it claims invariance under a change of units (D does, A and E do not).
    monotone : bool
        Whether it claims that information never harms (a condition number cannot).
    n_points : int
        Random information matrices.

    Raises
    ------
    AssertionError
        With a line for every broken promise.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> from oed_sysid.design import DOptimal
    >>> model = load_problem("nomoto_sparse_heading").model
    >>> check_criterion(DOptimal(), model, rng=np.random.default_rng(0))
    """
    names = tuple(p.name for p in model.free_parameters if not p.per_record)
    scales = np.array([model.parameter(name).magnitude for name in names])
    setting = Setting(model, names, scales, noise_of(model))
    name = str(getattr(criterion, "name", ""))
    if not name or not isinstance(criterion, Criterion):
        raise AssertionError("A criterion has a name and bind(setting).")
    try:
        measure = criterion.bind(setting)
    except OedSysidError as error:
        raise AssertionError(f"Criterion {name!r}:\n- does not bind: {error}") from None
    matrices = [_matrix(rng, len(names)) for _ in range(n_points)]
    broken = [line for one in matrices for line in _at_point(measure, one, rng, monotone)]
    if invariant:
        broken += _invariant(criterion, setting, matrices, rng)
    blind = _matrix(rng, len(names))
    blind[0], blind[:, 0] = 0.0, 0.0
    if not all(np.isfinite(part).all() for part in measure(blind)):
        broken.append("is not finite where nothing is known of a parameter")
    refuse(f"Criterion {name!r}", broken)


def _at_point(
    measure: Any, matrix: np.ndarray, rng: np.random.Generator, monotone: bool
) -> list[str]:
    """Value and derivative at one information matrix, and what one more measurement changes."""
    kept = matrix.copy()
    (value, gradient), (again, _) = measure(matrix), measure(matrix)
    broken = [] if np.array_equal(matrix, kept) else ["changes the matrix that it is given"]
    matrix[:] = kept
    if value != again:
        broken.append("gives two results for the same information")
    if gradient.shape != matrix.shape or not np.isfinite(gradient).all():
        return [*broken, f"returns a derivative of shape {gradient.shape} or not finite"]
    if not np.allclose(gradient, gradient.T, rtol=1e-6, atol=1e-9 * np.abs(gradient).max()):
        broken.append("returns a derivative that is not symmetric")
    row, other = rng.normal(size=(2, len(matrix))) * np.sqrt(np.diag(matrix))
    direction = np.outer(row, row)
    up, down = (measure(matrix + sign * DIFFERENCE_STEP * direction)[0] for sign in (1, -1))
    slope, stated = (up - down) / (2.0 * DIFFERENCE_STEP), float(np.sum(gradient * direction))
    if abs(slope - stated) > DIFFERENCE_STEP * max(abs(slope), abs(stated), 1e-3):
        broken.append(f"states the slope {stated:.6g} where differences find {slope:.6g}")
    more = measure(matrix + np.outer(other, other))[0]
    if monotone and more < value - ROUNDING * max(abs(value), 1.0):
        broken.append(f"falls from {value:.6g} to {more:.6g} by one more measurement")
    return broken


def _invariant(
    criterion: Criterion, setting: Setting, matrices: list[np.ndarray], rng: np.random.Generator
) -> list[str]:
    """Designs compare alike in other units: so much smaller scales, so much less information."""
    units = np.exp(rng.uniform(-1.0, 1.0, len(setting.names)))
    measure = criterion.bind(setting)
    rescaled = criterion.bind(replace(setting, scales=setting.scales * units))
    values = np.diff([measure(one)[0] for one in matrices])
    others = np.diff([rescaled(one * units[:, None] * units)[0] for one in matrices])
    return [
        f"prefers by {one:.6g}, in other units by {two:.6g}"
        for one, two in zip(values, others, strict=True)
        if abs(one - two) > 1e-6 * max(abs(one), abs(two), 1.0)
    ]


def _matrix(rng: np.random.Generator, n: int) -> np.ndarray:
    """A well conditioned information matrix with errors of some per cent."""
    rows = rng.normal(size=(4 * n, n)) * np.exp(rng.uniform(1.0, 3.0, n))
    return rows.T @ rows
