"""What is left of one output after a model has been subtracted, in numbers and words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.evidence.regimes import Concentration, Regime, Signal, concentrations
from oed_sysid.likelihood.information import Whiteness, autocorrelation, whiteness
from oed_sysid.physics.channels import Output
from oed_sysid.runtime.display import as_dict

# Lags up to which residuals are compared with inputs and states, s.
LONGEST_LAG = 5.0
# A correlation is named if it is this many standard errors from zero, over all lags looked at.
CLEAR_CORRELATION = 4.5
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
    """

    signal: str
    value: float
    lag: float
    score: float

    @property
    def is_clear(self) -> bool:
        """Whether chance is excluded."""
        return abs(self.score) > CLEAR_CORRELATION


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
        limit = max(NOISE_LIMIT, 1.0 + 3.0 / np.sqrt(2.0 * max(self.n_samples, 1)))
        return self.n_samples == 0 or (self.relative < limit and self.is_white)

    @property
    def verdict(self) -> str:
        """The misfit in words."""
        name = self.output.label or self.output.name
        if self.n_samples == 0:
            return f"{name}: not measured"
        if not np.isfinite(self.rmse):
            return f"{name}: the prediction leaves the numbers"
        if self.is_noise:
            return f"{name}: the misfit is noise"
        if self.relative < NOISE_LIMIT:
            text = f"{name} is off by no more than the noise, but correlated in time"
        else:
            text = f"{name} deviates by {self.relative:.2g} x noise"
        details = []
        clear = [regime for regime in self.regimes if regime.is_clear]
        if clear:
            details.append(f"mostly {clear[0].words}")
        related = [c for c in self.correlations if c.is_clear]
        if related:
            details.append(f"correlated with {related[0].signal}")
        return ", ".join([text, *details])

    to_dict = as_dict(
        "rmse", "relative", "bias", "record_rmse", "n_samples", "effective_samples",
        "correlations", "windows", "worst", "verdict",
        output="output.name", unit="output.unit", noise="sigma", coverage_95="coverage",
        white="is_white", regimes=lambda self: [one for one in self.regimes if one.is_clear],
    )  # fmt: skip


def output_misfit(
    output: Output,
    residuals: Sequence[np.ndarray],
    sigma: float,
    inside_band: Sequence[np.ndarray],
    times: Sequence[np.ndarray],
    names: Sequence[str],
    signals: Sequence[Signal],
    parts: Sequence[Regime],
    window: float,
    *,
    in_time: bool = True,
) -> OutputMisfit:
    """Describe the residual of one output.

    Parameters
    ----------
    output : Output
    residuals : sequence of ndarray (n_times,)
        Measured minus model, per record; NaN where nothing was measured,
        infinite where the prediction left the numbers.
    sigma : float
        Noise level.
    inside_band : sequence of ndarray of bool (n_times,)
        Whether each measurement is within the 95 % band.
    times : sequence of ndarray (n_times,)
    names : sequence of str
        Of the records.
    signals : sequence of Signal
        Inputs and states to compare with.
    parts : sequence of Regime
        Parts of the manoeuvre to compare.
    window : float
        Length of the windows, s.
    in_time : bool
        Whether the records are time series. Rows of independent tests have no neighbours: they
        count whole, correlations are those at the same row, and windows are single tests.
    """
    pooled = np.concatenate(residuals)
    seen = ~np.isnan(pooled)
    scaled = [residual / sigma for residual in residuals]
    windows = tuple(
        _windows(t, r, window) if in_time else np.abs(r) for t, r in zip(times, scaled, strict=True)
    )
    # Records on which the prediction left the numbers have no pattern to look at.
    whole = [i for i, residual in enumerate(residuals) if not np.isinf(residual).any()]
    usable = [residuals[i] for i in whole]
    return OutputMisfit(
        output=output,
        rmse=_rms(pooled),
        sigma=sigma,
        bias=float(np.mean(pooled[seen])) if seen.any() else np.nan,
        record_rmse=tuple(_rms(residual) for residual in residuals),
        n_samples=int(seen.sum()),
        coverage=float(np.mean(np.concatenate(inside_band)[seen])) if seen.any() else np.nan,
        tests=tuple(
            whiteness(r) if in_time else _apart(r) for r in usable if np.isfinite(r).sum() > 10
        ),
        correlations=(
            _correlations(usable, signals, times, in_time) if len(whole) == len(times) else ()
        ),
        regimes=(
            tuple(concentrations(scaled, parts, in_time=in_time))
            if len(whole) == len(times)
            else ()
        ),
        windows=windows,
        worst=_worst(windows, times, names) if in_time else _worst_test(windows, names),
        in_time=in_time,
    )


def _correlations(
    residuals: Sequence[np.ndarray],
    signals: Sequence[Signal],
    times: Sequence[np.ndarray],
    in_time: bool,
) -> tuple[Correlation, ...]:
    found = [correlate(residuals, signal, times, in_time=in_time) for signal in signals]
    return tuple(sorted((c for c in found if c is not None), key=lambda c: -abs(c.score)))


def correlate(
    residuals: Sequence[np.ndarray],
    signal: Signal,
    times: Sequence[np.ndarray],
    *,
    in_time: bool = True,
) -> Correlation | None:
    """Largest cross-correlation of a residual with a signal that precedes it.

    The standard error takes both autocorrelations into account (Bartlett 1946). Unless ``in_time``,
    rows are independent tests: without lag and without autocorrelation.
    """
    step = float(np.median(np.diff(times[0])))
    longest = min(round(LONGEST_LAG / step), min(len(t) for t in times) // 3)
    lags = np.arange(0, longest + 1 if in_time else 1)
    covariance, pairs = np.zeros(len(lags)), np.zeros(len(lags))
    square_r = square_s = 0.0
    colour = 0.0
    for residual, series in zip(residuals, signal.series, strict=True):
        seen = np.isfinite(residual)
        if seen.sum() < 20 or not np.ptp(series) > 0:
            continue
        r = np.where(seen, residual - np.nanmean(residual), 0.0)
        s = series - np.mean(series)
        square_r += float(r @ r)
        square_s += float(np.sum(s[seen] ** 2))
        for i, lag in enumerate(lags):
            covariance[i] += r[lag:] @ s[: len(s) - lag]
            pairs[i] += seen[lag:].sum()
        if not in_time:
            colour += seen.sum()
            continue
        n_lags = min(len(s) // 3, 300)
        product = autocorrelation(residual, n_lags) * autocorrelation(series, n_lags)
        taper = 1.0 - np.arange(n_lags + 1) / (n_lags + 1.0)
        colour += seen.sum() * max(1.0 + 2.0 * float(product[1:] @ taper[1:]), 0.1)
    if not (square_r > 0 and square_s > 0):
        return None
    values = covariance / np.sqrt(square_r * square_s)
    best = int(np.argmax(np.abs(values)))
    error = np.sqrt(colour) / pairs[0]
    return Correlation(
        signal.words, float(values[best]), float(lags[best] * step), float(values[best] / error)
    )


def _rms(values: np.ndarray) -> float:
    seen = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(seen**2))) if len(seen) else np.nan


def _windows(times: np.ndarray, residual: np.ndarray, window: float) -> np.ndarray:
    """Root mean square in equal windows of about this length; NaN where nothing was measured."""
    index = _window_index(times, window)
    return np.array([_rms(residual[index == i]) for i in range(index[-1] + 1)])


def _window_index(times: np.ndarray, window: float) -> np.ndarray:
    duration = times[-1] - times[0]
    count = max(1, round(float(duration / window)))
    return np.minimum(((times - times[0]) / duration * count).astype(int), count - 1)


def _apart(residual: np.ndarray) -> Whiteness:
    """What independent tests are by their nature."""
    count = int(np.isfinite(residual).sum())
    return Whiteness(0.0, 1.0, 0.0, float(count), count)


def _worst_test(
    windows: Sequence[np.ndarray], names: Sequence[str]
) -> tuple[str, float, float, float]:
    """Series, number (twice) and misfit of the worst of independent tests."""
    best = ("", np.nan, np.nan, np.nan)
    for part, name in zip(windows, names, strict=True):
        filled = np.where(np.isfinite(part), part, -1.0)
        i = int(np.argmax(filled))
        if filled[i] > 0 and not filled[i] <= best[3]:
            best = (name, float(i + 1), float(i + 1), float(filled[i]))
    return best


def _worst(
    windows: Sequence[np.ndarray],
    times: Sequence[np.ndarray],
    names: Sequence[str],
) -> tuple[str, float, float, float]:
    best = ("", np.nan, np.nan, np.nan)
    for part, t, name in zip(windows, times, names, strict=True):
        filled = np.where(np.isfinite(part), part, -1.0)
        i = int(np.argmax(filled))
        if filled[i] > 0 and not filled[i] <= best[3]:
            length = float(t[-1] - t[0]) / len(part)
            best = (
                name,
                float(t[0]) + i * length,
                float(t[0]) + (i + 1) * length,
                float(filled[i]),
            )
    return best
