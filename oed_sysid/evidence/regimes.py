"""Where in a manoeuvre a misfit sits: fast or slow, turning or straight, after a command.

Regimes are derived from the signals themselves, so that they exist for any
system: large or small values of a state or input, one sign or the other, and
the seconds after a command has changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.likelihood.information import effective_sample_size

# Seconds after a change of a command that count as its consequence.
AFTER_CHANGE = 2.0
# A regime is worth naming if it concentrates the misfit this much, this surely.
CLEAR_RATIO, CLEAR_SCORE = 1.5, 3.0


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
    """

    words: str
    ratio: float
    share_of_misfit: float
    share_of_time: float
    score: float

    @property
    def is_clear(self) -> bool:
        """Whether the regime deserves to be named."""
        return self.ratio > CLEAR_RATIO and self.score > CLEAR_SCORE


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
            found += _split(signal, np.abs(pooled), "large", "small", absolute=True)
            found += _split(signal, pooled, "positive", "negative")
        else:
            found += _split(signal, pooled, "high", "low")
        if signal.is_input and in_time:
            changed = _after_changes(signal, times)
            if changed is not None:
                found.append(changed)
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
    effective: float = sum(effective_sample_size(residual**2) for residual in residuals)
    if not in_time:
        effective = float(seen.sum())
    if seen.sum() < 20:
        return []
    result = []
    for regime in candidates:
        inside = np.concatenate(regime.inside)[seen]
        share = float(inside.mean())
        if not 0.05 < share < 0.8:
            continue
        within, outside = squares[seen][inside], squares[seen][~inside]
        variance = np.var(within) / (effective * share) + np.var(outside) / (
            effective * (1.0 - share)
        )
        score = (within.mean() - outside.mean()) / np.sqrt(max(variance, 1e-300))
        result.append(
            Concentration(
                regime.words,
                float(within.mean() / max(outside.mean(), 1e-300)),
                float(within.sum() / max(squares[seen].sum(), 1e-300)),
                share,
                float(score),
            )
        )
    return sorted(result, key=lambda c: -c.score)


def _split(
    signal: Signal, values: np.ndarray, above: str, below: str, *, absolute: bool = False
) -> list[Regime]:
    """Upper and lower third of a signal."""
    first, second = np.quantile(values, [1 / 3, 2 / 3])
    series = [np.abs(part) if absolute else part for part in signal.series]
    unit = f" {signal.unit}" if signal.unit else ""
    return [
        Regime(
            f"while {signal.words} is {above} (above {second:.2g}{unit})",
            tuple(part > second for part in series),
        ),
        Regime(
            f"while {signal.words} is {below} (below {first:.2g}{unit})",
            tuple(part < first for part in series),
        ),
    ]


def _after_changes(signal: Signal, times: Sequence[np.ndarray]) -> Regime | None:
    """Samples soon after a command has moved by a fifth of its range."""
    pooled = np.concatenate(signal.series)
    threshold = 0.2 * float(np.ptp(pooled))
    inside = []
    for series, t in zip(signal.series, times, strict=True):
        jumps = t[1:][np.abs(np.diff(series)) > threshold]
        since = _since(t, jumps) if len(jumps) else np.full_like(t, np.inf)
        inside.append(since <= AFTER_CHANGE)
    if not any(part.any() for part in inside):
        return None
    return Regime(f"in the {AFTER_CHANGE:g} s after {signal.words} changes", tuple(inside))


def _since(times: np.ndarray, events: np.ndarray) -> np.ndarray:
    """Time since the last event, infinite before the first."""
    last = np.searchsorted(events, times, side="right") - 1
    return np.where(last >= 0, times - events[np.maximum(last, 0)], np.inf)
