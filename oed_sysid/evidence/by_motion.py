r"""Where a model fails on independent tests: as a function of motion and input, not of time.

Rows of captive tests have no order, so that no disturbance links one with the next. The residual
:math:`r` of each output is averaged in classes of one input after the other (held velocities are
inputs there); the share of its squares that the :math:`k` means :math:`m_c` of :math:`n` rows
explain beyond chance (Fisher's analysis of variance) tells on what it depends,

.. math::
    \eta^2 = \frac{\sum_c n_c m_c^2}{\sum r^2}, \qquad
    F = \frac{n - k}{k} \frac{\eta^2}{1 - \eta^2} \sim F_{k,\,n-k} .
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from oed_sysid.evidence.misfit import NOISE_LIMIT
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.noise_levels import given_levels
from oed_sysid.physics.channels import Input, Output
from oed_sysid.text.units import shown_unit

# Values of an input that are classes of their own, and classes where there are more.
VALUES, CLASSES = 7, 5
# Chance, over all inputs, that a residual of noise is said to depend on one.
CHANCE = 1e-3


@dataclass(frozen=True, eq=False)
class ByMotion:
    """How the residual of an output depends on an input.

    Attributes
    ----------
    output : Output
    signal : Input or None
        On which it depends most; None where on none clearly.
    error : float
        Root mean square residual, in units of the noise.
    share : float
        Of its squares that the means explain.
    values, means : ndarray (n_classes,)
        Mean of the input in each class, in its unit, and of the residual, in units of the noise.
    """

    output: Output
    signal: Input | None
    error: float
    share: float
    values: np.ndarray
    means: np.ndarray

    @property
    def text(self) -> str:
        """The finding in words."""
        what = self.output.label or self.output.name
        begin = f"{what} is off by {self.error:.2g} x noise"
        if self.signal is None:
            return f"{begin}, by none of the motions and inputs clearly"
        factor, unit = shown_unit(self.signal.unit)
        at = ", ".join(f"{factor * value:.3g}" for value in self.values)
        means = ", ".join(f"{mean:+.2g}" for mean in self.means)
        return (
            f"{begin}, {100 * self.share:.0f} % of it as a function of "
            f"{self.signal.label or self.signal.name}: {means} x noise at {at} {unit}"
        )


def failing(fit: FilteredSolution) -> tuple[ByMotion, ...]:
    """Outputs that a model misses by more than their noise on independent tests, worst first.

    Parameters
    ----------
    fit : FilteredSolution
        To independent tests alone.
    """
    problem, unknowns = fit.problem, fit.point.unknowns
    records, outputs = problem.dataset.records, problem.model.outputs
    levels = given_levels(outputs)
    sigma = np.where(np.isfinite(levels), levels, fit.noise.sensors)
    residuals = np.vstack(
        [r.residuals(problem.alone(unknowns, i)[0]) / sigma for i, r in enumerate(records)]
    )
    inputs = np.vstack([record.inputs for record in records])
    found = []
    for column, output in enumerate(outputs):
        seen = np.isfinite(residuals[:, column])
        rows = residuals[seen, column]
        limit = max(NOISE_LIMIT, 1.0 + 3.0 / np.sqrt(2.0 * max(len(rows), 1)))
        error = float(np.sqrt(np.mean(rows**2))) if len(rows) else 0.0
        if error > limit:
            found.append(_dependence(output, error, rows, inputs[seen], problem.model.inputs))
    return tuple(sorted(found, key=lambda one: -one.error))


def in_words(fit: FilteredSolution) -> str:
    """Where a model fails on independent tests, in sentences."""
    found = failing(fit)
    begin = "The records are independent tests, asked by motion and input and not in time: "
    if not found:
        return begin + "no force is off by more than its noise."
    return begin + "; ".join(one.text for one in found) + "."


def _dependence(
    output: Output,
    error: float,
    rows: np.ndarray,
    inputs: np.ndarray,
    signals: tuple[Input, ...],
) -> ByMotion:
    best, nothing = (np.inf, -1), np.empty(0)
    for place in range(len(signals)):
        labels = _classes(inputs[:, place])
        count = int(labels.max()) + 1
        if count < 2 or len(rows) <= count:
            continue
        share = _share(rows, labels)
        ratio = (len(rows) - count) / count * share / max(1.0 - share, 1e-12)
        # Where chance is beyond the digits of a number, the larger share is the clearer one.
        best = min(best, (float(fdtrc(count, len(rows) - count, ratio)) - 1e-12 * share, place))
    if not best[0] * len(signals) < CHANCE:
        return ByMotion(output, None, error, 0.0, nothing, nothing)
    column = inputs[:, best[1]]
    labels = _classes(column)
    groups = [labels == one for one in range(int(labels.max()) + 1)]
    return ByMotion(
        output,
        signals[best[1]],
        error,
        _share(rows, labels),
        np.array([column[group].mean() for group in groups]),
        np.array([rows[group].mean() for group in groups]),
    )


def _share(rows: np.ndarray, labels: np.ndarray) -> float:
    """Share of the squares that means of classes explain."""
    sums, counts = np.bincount(labels, rows), np.bincount(labels)
    return float(np.sum(sums**2 / counts) / max(rows @ rows, 1e-300))


def _classes(column: np.ndarray) -> np.ndarray:
    """Class of every row, ``(n_rows,)``, in ascending order of the signal; none of them empty."""
    values, labels = np.unique(column, return_inverse=True)
    if len(values) > VALUES:
        edges = np.quantile(column, np.arange(1, CLASSES) / CLASSES)
        _, labels = np.unique(np.searchsorted(edges, column), return_inverse=True)
    return np.asarray(labels).ravel()
