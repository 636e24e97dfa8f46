r"""What is left of one output after a model has been subtracted, in numbers and words.

On independent tests a model fails as a function of motion and input, not of time. Rows of captive
tests have no order, so that no disturbance links one with the next. The residual :math:`r` of each
output is averaged in classes of one input after the other (held velocities are inputs there); the
share of its squares that the :math:`k` means :math:`m_c` of :math:`n` rows explain beyond chance
(Fisher's analysis of variance) tells on what it depends,

.. math::
    \eta^2 = \frac{\sum_c n_c m_c^2}{\sum r^2}, \qquad
    F = \frac{n - k}{k} \frac{\eta^2}{1 - \eta^2} \sim F_{k,\,n-k} .

Of time series, regimes say where in a manoeuvre a misfit sits: fast or slow, turning or straight,
after a command. They are derived from the signals themselves, so that they exist for any
system: large or small values of a state or input, one sign or the other, and
the seconds after a command has changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from scipy.special import fdtrc

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.chance import FALSE_CLAIMS, clear_score
from oed_sysid.evidence.study import total_error
from oed_sysid.likelihood.between_records import WORTH_TELLING
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.information import (
    Whiteness,
    autocorrelation,
    effective_sample_size,
    whiteness,
)
from oed_sysid.likelihood.noise_levels import given_levels
from oed_sysid.physics.channels import Input, Output
from oed_sysid.runtime.display import as_dict
from oed_sysid.text.units import shown_unit

# Lags up to which residuals are compared with inputs and states, s.
LONGEST_LAG = 5.0
# Misfit that is called noise: up to this many times the noise, and white at this level.
NOISE_LIMIT, WHITE_LEVEL = 1.05, 1e-4


@dataclass(frozen=True)
class Correlation:
    """Largest correlation of a residual with a signal.

    Attributes
    ----------
    signal : str
    value : float
        Correlation coefficient.
    lag : float
        Time by which the residual follows the signal, s.
    score : float
        The coefficient in standard errors, both series' own colour considered.
    limit : float
        What chance exceeds rarely at any of the lags and signals that were looked at.
    """

    signal: str
    value: float
    lag: float
    score: float
    limit: float = field(default=clear_score(1), repr=False)

    @property
    def is_clear(self) -> bool:
        """Whether chance is excluded."""
        return abs(self.score) > self.limit

    to_dict = as_dict("signal", "value", "lag", "score")


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
    correlations : tuple of Correlation
        With every input and state, the clearest first.
    regimes : tuple of Concentration
        Where the misfit sits, the clearest first.
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
    correlations: tuple[Correlation, ...]
    regimes: tuple[Concentration, ...]
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
        return all(test.p_value > WHITE_LEVEL for test in self.tests)

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
        regimes = (f"mostly {one.words}" for one in self.regimes if one.is_clear)
        related = (f"correlated with {c.signal}" for c in self.correlations if c.is_clear)
        details = (*islice(regimes, 1), *islice(related, 1))
        return ", ".join((small if self.relative < NOISE_LIMIT else large, *details))

    to_dict = as_dict(
        "rmse", "relative", "bias", "record_rmse", "n_samples", "effective_samples",
        "correlations", "windows", "worst", "verdict",
        output="output.name", unit="output.unit", noise="sigma", coverage_95="coverage",
        white="is_white", regimes=lambda self: [one for one in self.regimes if one.is_clear],
    )  # fmt: skip


def _noise_limit(n_samples: int) -> float:
    """Root mean square in units of the noise up to which samples are noise, chance included."""
    return max(NOISE_LIMIT, 1.0 + 3.0 / float(np.sqrt(2.0 * max(n_samples, 1))))


def output_misfit(
    output: Output,
    residuals: Sequence[np.ndarray],
    sigma: float,
    inside_band: Sequence[np.ndarray],
    dataset: Dataset,
    signals: Sequence[Signal],
    parts: Sequence[Regime],
    window: float,
) -> OutputMisfit:
    """Describe the residual of one output.

    Rows of independent tests have no neighbours: they count whole, correlations are those at the
    same row, and windows are single tests.

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
    signals : sequence of Signal
        Inputs and states to compare with.
    parts : sequence of Regime
        Parts of the manoeuvre to compare.
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
    usable = [residual for residual in residuals if not np.isinf(residual).any()]
    # Records on which the prediction diverged have no pattern to look at.
    whole = len(usable) == len(residuals)
    tested = [r for r in usable if np.isfinite(r).sum() > 10]
    related = (
        correlate(usable, one, times, in_time=in_time, among=len(signals))
        for one in (signals if whole else ())
    )
    return OutputMisfit(
        output=output,
        rmse=total_error(pooled),
        sigma=sigma,
        bias=_mean(pooled[seen]),
        record_rmse=tuple(map(total_error, residuals)),
        n_samples=int(seen.sum()),
        coverage=_mean(np.concatenate(inside_band)[seen]),
        tests=tuple(map(whiteness if in_time else _apart, tested)),
        correlations=tuple(sorted(filter(None, related), key=lambda c: -abs(c.score))),
        regimes=tuple(concentrations(scaled, parts, in_time=in_time)) if whole else (),
        windows=windows,
        worst=_worst(windows, dataset),
        in_time=in_time,
    )


def correlate(
    residuals: Sequence[np.ndarray],
    signal: Signal,
    times: Sequence[np.ndarray],
    *,
    in_time: bool = True,
    among: int = 1,
) -> Correlation | None:
    """Largest cross-correlation of a residual with a signal that precedes it.

    The standard error takes both autocorrelations into account (Bartlett 1946). Unless ``in_time``,
    rows are independent tests: without lag and without autocorrelation. The signal is one ``among``
    so many.
    """
    step = float(np.median(np.diff(times[0])))
    longest = min(round(LONGEST_LAG / step), min(len(t) for t in times) // 3) if in_time else 0
    covariance, squares, colour, n_seen = np.zeros(longest + 1), np.zeros(2), 0.0, 0
    for residual, series in zip(residuals, signal.series, strict=True):
        seen = np.isfinite(residual)
        if seen.sum() < 20 or not np.ptp(series) > 0:
            continue
        # Zero where nothing was measured: a gap adds nothing to any product.
        r = np.where(seen, residual - np.nanmean(residual), 0.0)
        s = series - np.mean(series)
        squares += r @ r, np.sum(s[seen] ** 2)
        covariance += [r[lag:] @ s[: len(s) - lag] for lag in range(longest + 1)]
        n_seen += seen.sum()
        memory = 1.0
        if in_time:
            n_lags = min(len(s) // 3, 300)
            # Variance of a cross-correlation of two series with memories: the sum of the products
            # of their autocorrelations (Bartlett 1946), tapered as Bartlett does.
            product = autocorrelation(residual, n_lags) * autocorrelation(series, n_lags)
            taper = 1.0 - np.arange(n_lags + 1) / (n_lags + 1.0)
            memory = max(1.0 + 2.0 * float(product[1:] @ taper[1:]), 0.1)
        colour += seen.sum() * memory
    if not (squares > 0).all():
        return None
    values = covariance / np.sqrt(squares.prod())
    lag = int(np.argmax(np.abs(values)))
    value, error = float(values[lag]), float(np.sqrt(colour)) / n_seen
    limit = clear_score(among * (longest + 1))
    return Correlation(signal.words, value, lag * step, value / error, limit)


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


# Values of an input that are classes of their own, and classes where there are more.
VALUES, CLASSES = 7, 5


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
        self.error = float(np.sqrt(np.mean(rows**2))) if len(rows) else 0.0
        self.signal: Input | None = None
        self.values = self.means = np.empty(0)
        best = (np.inf, -1)
        for place, column in enumerate(inputs.T):
            labels = _classes(column)
            count = len(np.unique(labels))
            if count < 2 or len(rows) <= count:
                continue
            share = _share(rows, labels)
            # Analysis of variance: F of the class means, none of which was fitted.
            ratio = (len(rows) - count) / count * share / max(1.0 - share, 1e-12)
            # Where chance is beyond the digits of a number, the larger share is the clearer one.
            chance = float(fdtrc(count, len(rows) - count, ratio)) - 1e-12 * share
            best = min(best, (chance, place))
        if best[0] * len(signals) < FALSE_CLAIMS:
            column = inputs[:, best[1]]
            labels = _classes(column)
            counts = np.bincount(labels)
            self.values, self.means = (np.bincount(labels, of) / counts for of in (column, rows))
            self.signal, self.share = signals[best[1]], _share(rows, labels)

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


# Seconds after a change of a command that count as its consequence.
AFTER_CHANGE = 2.0


@dataclass(frozen=True, eq=False)
class Signal:
    """A state or input over several records.

    Attributes
    ----------
    name, unit, label : str
    series : tuple of ndarray (n_times,)
        One per record.
    is_input : bool
    """

    name: str
    unit: str
    label: str
    series: tuple[np.ndarray, ...]
    is_input: bool

    @property
    def words(self) -> str:
        """Label and symbol."""
        return f"{self.label} {self.name}" if self.label and self.label != self.name else self.name


@dataclass(frozen=True, eq=False)
class Regime:
    """A part of the manoeuvre.

    Attributes
    ----------
    words : str
        For instance ``while pitch rate q is large (above 0.12 rad/s)``.
    inside : tuple of ndarray of bool (n_times,)
        Which samples belong to it, per record.
    """

    words: str
    inside: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Concentration:
    """How much of a misfit one regime holds.

    Attributes
    ----------
    words : str
        Of the regime.
    ratio : float
        Mean square residual inside over that outside.
    share_of_misfit, share_of_time : float
    score : float
        Difference of the mean squares in standard errors.
    limit : float
        What chance exceeds rarely in any of the regimes that were looked at.
    """

    words: str
    ratio: float
    share_of_misfit: float
    share_of_time: float
    score: float
    limit: float = field(default=clear_score(1), repr=False)

    @property
    def is_clear(self) -> bool:
        """Whether the regime deserves to be named."""
        return self.ratio > WORTH_TELLING and self.score > self.limit

    to_dict = as_dict("words", "ratio", "share_of_misfit", "share_of_time", "score")


def regimes(
    signals: Sequence[Signal], times: Sequence[np.ndarray], *, in_time: bool = True
) -> list[Regime]:
    """Regimes that the signals of a manoeuvre define.

    Parameters
    ----------
    signals : sequence of Signal
    times : sequence of ndarray (n_times,)
        Of each record, s.
    in_time : bool
        Whether records are time series; rows of independent tests follow no command.
    """
    found = []
    for signal in signals:
        pooled = np.concatenate(signal.series)
        low, high = np.quantile(pooled, [0.05, 0.95])
        if not high - low > 1e-9 * max(abs(low), abs(high), 1e-300):
            continue
        if low < 0 < high and min(-low, high) > 0.2 * (high - low):
            sizes = replace(signal, series=tuple(map(np.abs, signal.series)))
            found += [*_split(sizes, "large", "small"), *_split(signal, "positive", "negative")]
        else:
            found += _split(signal, "high", "low")
        if signal.is_input and in_time:
            found += _after_changes(signal, times)
    return found


def concentrations(
    residuals: Sequence[np.ndarray], candidates: Sequence[Regime], *, in_time: bool = True
) -> list[Concentration]:
    """How strongly each regime concentrates a misfit, the most significant first.

    Parameters
    ----------
    residuals : sequence of ndarray (n_times,)
        In units of the noise, NaN where nothing was measured.
    candidates : sequence of Regime
    in_time : bool
        Whether neighbours may be alike; rows of independent tests count whole.
    """
    squares = np.concatenate(residuals) ** 2
    seen = np.isfinite(squares)
    if seen.sum() < 20:
        return []
    effective = float(seen.sum())
    if in_time:
        effective = sum(effective_sample_size(residual**2) for residual in residuals)
    result, limit = [], clear_score(len(candidates))
    for regime in candidates:
        inside = np.concatenate(regime.inside)[seen]
        share = float(inside.mean())
        if not 0.05 < share < 0.8:
            continue
        within, outside = squares[seen][inside], squares[seen][~inside]
        variance = (np.var(within) / share + np.var(outside) / (1.0 - share)) / effective
        score = float((within.mean() - outside.mean()) / np.sqrt(max(variance, 1e-300)))
        ratio = float(within.mean() / max(outside.mean(), 1e-300))
        of_misfit = float(within.sum() / max(squares[seen].sum(), 1e-300))
        result.append(Concentration(regime.words, ratio, of_misfit, share, score, limit))
    return sorted(result, key=lambda c: -c.score)


def _split(signal: Signal, above: str, below: str) -> list[Regime]:
    """Upper and lower third of a signal."""
    first, second = np.quantile(np.concatenate(signal.series), [1 / 3, 2 / 3])
    unit, begin = f" {signal.unit}" if signal.unit else "", f"while {signal.words} is"
    high = tuple(part > second for part in signal.series)
    low = tuple(part < first for part in signal.series)
    return [
        Regime(f"{begin} {above} (above {second:.2g}{unit})", high),
        Regime(f"{begin} {below} (below {first:.2g}{unit})", low),
    ]


def _after_changes(signal: Signal, times: Sequence[np.ndarray]) -> list[Regime]:
    """Samples soon after a command has moved by a fifth of its range, where it does."""
    least = 0.2 * float(np.ptp(np.concatenate(signal.series)))
    inside = []
    for series, t in zip(signal.series, times, strict=True):
        jumps = np.r_[-np.inf, t[1:][np.abs(np.diff(series)) > least]]
        last = jumps[np.searchsorted(jumps, t, side="right") - 1]
        inside.append(t - last <= AFTER_CHANGE)
    words = f"in the {AFTER_CHANGE:g} s after {signal.words} changes"
    return [Regime(words, tuple(inside))] if any(part.any() for part in inside) else []
