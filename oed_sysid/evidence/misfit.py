r"""What is left of one output after a model has been subtracted, in numbers and words.

On independent tests a model fails as a function of motion and input, not of time. Rows of captive
tests have no order, so that no disturbance links one with the next. The residual :math:`r` of each
output is averaged in classes of one input after the other (held velocities are inputs there); the
share of its squares that the :math:`k` means :math:`m_c` of :math:`n` rows explain beyond chance
(Fisher's analysis of variance) tells on what it depends,

.. math::
    \eta^2 = \frac{\sum_c n_c m_c^2}{\sum r^2}, \qquad
    F = \frac{n - k}{k} \frac{\eta^2}{1 - \eta^2} \sim F_{k,\,n-k} .

Of time series the windows with the largest misfit are told. What it follows is asked where noise is
estimated, by a score test of laws (:mod:`oed_sysid.likelihood.laws`) and of effects
(:mod:`oed_sysid.evidence.rank`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.chance import FALSE_CLAIMS
from oed_sysid.evidence.study import total_error
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.information import Whiteness, whiteness
from oed_sysid.likelihood.laws import KNOTS
from oed_sysid.likelihood.noise_levels import RARE, given_levels
from oed_sysid.physics.channels import Input, Output
from oed_sysid.runtime.constants import IMMATERIAL
from oed_sysid.runtime.display import as_dict
from oed_sysid.text.units import shown_unit

# Misfit that is called noise: up to this many times the noise.
NOISE_LIMIT = 1.0 + IMMATERIAL


@dataclass(frozen=True, eq=False)
class OutputMisfit:
    """Residual of one output over all records.

    Attributes
    ----------
    output : Output
    rmse, sigma, bias : float
        Root mean square residual, noise level and mean residual, in its unit.
    record_rmse : tuple of float
        Root mean square residual of each record.
    n_samples : int
    coverage : float
        Share of the measurements within the 95 % prediction band.
    tests : tuple of Whiteness
        Of each record.
    windows : tuple of ndarray (n_windows,)
        Root mean square residual in consecutive windows, in noise, per record.
    worst : tuple
        Record, start and end of the worst window, s, and its misfit in noise. Of independent
        tests the number of the worst, twice.
    in_time : bool
        Whether the records are time series, and not independent tests.
    """

    output: Output
    rmse: float
    sigma: float
    bias: float
    record_rmse: tuple[float, ...]
    n_samples: int
    coverage: float
    tests: tuple[Whiteness, ...]
    windows: tuple[np.ndarray, ...]
    worst: tuple[str, float, float, float]
    in_time: bool = True

    @property
    def where(self) -> str:
        """Record and seconds, or number of the test, of the largest misfit; empty without any."""
        name, begin, end, _ = self.worst
        if not name:
            return ""
        return (
            f"{name}, {begin:.0f} to {end:.0f} s" if self.in_time else f"{name}, test {begin:.0f}"
        )

    @property
    def relative(self) -> float:
        """Root mean square residual in units of the noise."""
        return self.rmse / self.sigma

    @property
    def effective_samples(self) -> float:
        """Number of independent residuals."""
        return float(sum(test.effective_samples for test in self.tests))

    @property
    def is_white(self) -> bool:
        """Whether no record's residual is correlated in time."""
        return are_white(self.tests)

    @property
    def is_noise(self) -> bool:
        """Whether the misfit is as small and as shapeless as noise."""
        small = self.relative < _noise_limit(self.n_samples)
        return self.n_samples == 0 or (small and self.is_white)

    @property
    def verdict(self) -> str:
        """The misfit in words."""
        name = self.output.label or self.output.name
        plain = {
            f"{name}: not measured": self.n_samples == 0,
            f"{name}: the prediction diverges": not np.isfinite(self.rmse),
            f"{name}: the misfit is noise": self.is_noise,
        }
        if said := next((text for text, true in plain.items() if true), ""):
            return said
        small = f"{name} is off by no more than the noise, but correlated in time"
        large = f"{name} deviates by {self.relative:.2g} x noise"
        return small if self.relative < NOISE_LIMIT else large

    to_dict = as_dict(
        "rmse", "relative", "bias", "record_rmse", "n_samples", "effective_samples", "windows",
        "worst", "verdict",
        output="output.name", unit="output.unit", noise="sigma", coverage_95="coverage",
        white="is_white",
    )  # fmt: skip


def are_white(tests: Sequence[Whiteness]) -> bool:
    """Whether chance makes some series of white noise as correlated as these, if rarely."""
    return all(test.p_value > RARE / len(tests) for test in tests)


def _noise_limit(n_samples: int) -> float:
    """Root mean square in units of the noise up to which samples are noise, chance included."""
    return max(NOISE_LIMIT, 1.0 + 3.0 / float(np.sqrt(2.0 * max(n_samples, 1))))


def output_misfit(
    output: Output,
    residuals: Sequence[np.ndarray],
    sigma: float,
    inside_band: Sequence[np.ndarray],
    dataset: Dataset,
    window: float,
) -> OutputMisfit:
    """Describe the residual of one output.

    Rows of independent tests have no neighbours: they count whole, and windows are single tests.

    Parameters
    ----------
    output : Output
    residuals : sequence of ndarray (n_times,)
        Measured minus model, per record; NaN where nothing was measured,
        infinite where the prediction diverged.
    sigma : float
        Noise level.
    inside_band : sequence of ndarray of bool (n_times,)
        Whether each measurement is within the 95 % band.
    dataset : Dataset
        The records.
    window : float
        Length of the windows, s.
    """
    in_time, times = not dataset.only_tests, [record.times for record in dataset]
    pooled = np.concatenate(residuals)
    seen = ~np.isnan(pooled)
    scaled = [residual / sigma for residual in residuals]
    windows = tuple(
        _windows(t, r, window) if in_time else np.abs(r) for t, r in zip(times, scaled, strict=True)
    )
    # Records on which the prediction diverged have no pattern to look at.
    tested = [r for r in residuals if not np.isinf(r).any() and np.isfinite(r).sum() > 10]
    return OutputMisfit(
        output, total_error(pooled), sigma, _mean(pooled[seen]), tuple(map(total_error, residuals)),
        n_samples=int(seen.sum()), coverage=_mean(np.concatenate(inside_band)[seen]),
        tests=tuple(map(whiteness if in_time else _apart, tested)),
        windows=windows, worst=_worst(windows, dataset), in_time=in_time,
    )  # fmt: skip


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if values.size else np.nan


def _windows(times: np.ndarray, residual: np.ndarray, window: float) -> np.ndarray:
    """Root mean square in equal windows of about this length; NaN where nothing was measured."""
    duration = times[-1] - times[0]
    count = max(1, round(float(duration / window)))
    index = np.minimum(((times - times[0]) / duration * count).astype(int), count - 1)
    return np.array([total_error(residual[index == i]) for i in range(count)])


def _apart(residual: np.ndarray) -> Whiteness:
    """What independent tests are by their nature."""
    count = int(np.isfinite(residual).sum())
    return Whiteness(0.0, 1.0, 0.0, float(count), count)


def _worst(windows: Sequence[np.ndarray], dataset: Dataset) -> tuple[str, float, float, float]:
    """Record, begin and end, s, and misfit of the worst window; of tests the number, twice."""
    best = ("", np.nan, np.nan, np.nan)
    for part, record in zip(windows, dataset, strict=True):
        # Windows without a measurement, or beyond a divergence, are never the worst.
        filled = np.where(np.isfinite(part), part, -1.0)
        i = int(np.argmax(filled))
        if filled[i] > 0 and not filled[i] <= best[3]:
            edges = np.linspace(record.times[0], record.times[-1], len(part) + 1)
            begin, end = (i + 1, i + 1) if dataset.only_tests else edges[i : i + 2]
            best = (record.name, float(begin), float(end), float(filled[i]))
    return best


# Values of an input that are classes of their own, at most, and classes where there are more.
VALUES, CLASSES = 7, KNOTS


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

    def __init__(
        self, output: Output, rows: np.ndarray, inputs: np.ndarray, signals: tuple[Input, ...]
    ) -> None:
        self.output, self.share = output, 0.0
        self.signal: Input | None = None
        self.error = float(np.sqrt(np.mean(rows**2))) if len(rows) else 0.0
        self.values = self.means = np.empty(0)
        found = [_explained(rows, column) for column in inputs.T]
        chances = [chance for chance, *_ in found]
        if min(chances, default=np.inf) * len(signals) < FALSE_CLAIMS:
            best = int(np.argmin(chances))
            self.signal = signals[best]
            _, self.share, self.values, self.means = found[best]

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
        one = ByMotion(output, residuals[seen, column], inputs[seen], problem.model.inputs)
        if one.error > _noise_limit(int(seen.sum())):
            found.append(one)
    return tuple(sorted(found, key=lambda one: -one.error))


def in_words(fit: FilteredSolution) -> str:
    """Where a model fails on independent tests, in sentences."""
    found = failing(fit)
    begin = "The records are independent tests, asked by motion and input and not in time: "
    if not found:
        return begin + "no force is off by more than its noise."
    return begin + "; ".join(one.text for one in found) + "."


def _explained(rows: np.ndarray, column: np.ndarray) -> tuple[float, float, np.ndarray, np.ndarray]:
    """What means of classes of a signal explain of rows.

    The chance of as much, the share of the squares, and means of signal and rows in each class.
    """
    labels = _classes(column)
    counts = np.bincount(labels)
    values, means = (np.bincount(labels, of) / counts for of in (column, rows))
    count, freedom = len(counts), len(rows) - len(counts)
    if count < 2 or freedom <= 0:
        return np.inf, 0.0, values, means
    share = float(np.sum(counts * means**2) / max(rows @ rows, 1e-300))
    # Analysis of variance: F of the class means, none of which was fitted.
    ratio = freedom / count * share / max(1.0 - share, 1e-12)
    # Where chance is beyond the digits of a number, the larger share is the clearer one.
    return float(fdtrc(count, freedom, ratio)) - 1e-12 * share, share, values, means


def _classes(column: np.ndarray) -> np.ndarray:
    """Class of every row, ``(n_rows,)``, in ascending order of the signal; none of them empty."""
    values, labels = np.unique(column, return_inverse=True)
    if len(values) > VALUES:
        edges = np.quantile(column, np.arange(1, CLASSES) / CLASSES)
        _, labels = np.unique(np.searchsorted(edges, column), return_inverse=True)
    return np.asarray(labels).ravel()
