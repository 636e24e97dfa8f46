r"""Fields of a log on a common grid, and in which units each may be that of a role.

A field :math:`a` in an unknown unit and with an unknown sign is :math:`a = s\,f\,y`. Regressed on
the integral of another field, with a constant and a bias, it gives a slope :math:`k` and a share
:math:`R^2` that is explained; :math:`|k|` is the ratio of two units, which is one of a few numbers.
Each explanation is worth :math:`-\tfrac{n}{2}\ln(1-R^2)` nats for :math:`n` independent samples,
less what the slope is away from its ratio; sizes of motions and names in several languages add
what they are worth as a prior.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.special import expit, softmax

from oed_sysid.data.log import TABLE, Log, Series, meaning, symbol_of
from oed_sysid.data.record import TURN, clear_wraps, unwrapped
from oed_sysid.runtime.constants import TOLD_APART
from oed_sysid.text.units import converts, is_unit, to_si

# Roles of measured motion, and of commands.
MOTION = ("psi", "r", "phi", "p", "theta", "q", "u", "v", "w", "x", "y", "z")
COMMANDS = ("rudder", "rpm", "shaft_speed", "thrust")
# Probability from which on a choice is not asked: the odds that tell explanations apart. At 0.9 one
# mirrored log in ten passes unasked.
SURE = float(expit(0.5 * TOLD_APART))
# Independent samples of a motion whose record may be long but has few manoeuvres; all evidence
# grows with it.
INDEPENDENT = 30
# Share that two slow drifts often explain of each other (Granger and Newbold 1974).
SPURIOUS = 0.8
# Share of a motion that signals explain which only go with it.
RIVAL = 0.97
# Relative error of a slope: calibration, currents, and 1/cos of a pitch of 14 degrees.
SLOPE = 0.03
# Nats that a name, a convention that most loggers keep, and a format's own definition are worth.
NAMED, USUAL, DEFINED = map(TABLE["nats"].__getitem__, ("name", "convention", "definition"))
# Most fields, and least and most rows of the grid: work grows with the square of the first, and
# rates and positions are integrals, to which more means would only add time.
MOST_FIELDS, ROWS = 48, (16, 1500)


@dataclass(frozen=True, eq=False)
class Field:
    """One field on the common grid.

    Attributes
    ----------
    name : str
    values : ndarray (n_times,)
        Unwrapped, as logged.
    stated : str
        Unit; empty where nobody says it.
    low : float
        Smallest reading.
    hint : str
        Role that its name means.
    weight : float
        Nats that the name is worth.
    jumps : float
        Period of its jumps in its own unit, or 0.
    """

    name: str
    values: np.ndarray = field(repr=False)
    stated: str
    low: float
    hint: str
    weight: float
    jumps: float

    @classmethod
    def of(cls, series: Series, times: np.ndarray) -> Field:
        """Means of a series over blocks about the times of the grid."""
        good = np.isfinite(series.values)
        at, values = series.times[good], series.values[good]
        wraps = clear_wraps(values)
        jumps = 0.0 if wraps is None else wraps[0]
        smooth = unwrapped(values, period=jumps) if jumps else values
        hint, weight = hint_of(series)
        return cls(
            series.name,
            _block_means(at, smooth, times),
            _stated(series),
            float(values.min()),
            hint,
            weight,
            jumps,
        )

    def named(self, role: str) -> float:
        """Nats that the name is worth for a role; less than none where it says another one."""
        return self.weight if self.hint == role else -self.weight if self.hint else 0.0


class Reading(NamedTuple):
    """One reading of one field: what it is worth in nats, and what is not sure of it.

    ``fits`` are the nats of its slope, ``sure`` says whether it is this field for certain.
    """

    score: float
    at: int
    unit: str
    sign: int = 1
    sure: bool = True
    fits: float = 0.0
    doubts: tuple[str, ...] = ()


# None of the fields.
NOTHING = Reading(0.0, -1, "")


class Fields:
    """A log on a grid, read with one unit of time.

    Attributes
    ----------
    times : ndarray (n_times,)
        In s.
    every : list of Field
    columns, free, sums : ndarray (n_times, n_fields)
        Values, the same without mean and trend, and integrals without mean and trend.
    """

    def __init__(self, log: Log, time_unit: str) -> None:
        every = _usable(log)
        if len(every) > MOST_FIELDS:  # those with meaningful names first
            every = sorted(every, key=lambda one: -hint_of(one)[1])[:MOST_FIELDS]
        times = _grid(log, every)
        self.times = times * (factor(time_unit) / factor(log.clock_unit or "s"))
        self.every = [Field.of(one, times) for one in every]
        self.columns = np.array([one.values for one in self.every]).T.reshape(len(times), -1)
        self.free = self.detrended(self.columns)
        self.sums = self.summed(self.columns)
        self.options = cache(self._options)  # asked again and again of the same fields

    def detrended(self, columns: np.ndarray) -> np.ndarray:
        """Columns ``(n_times, n)``, or one, without mean and trend."""
        base = np.column_stack([np.ones_like(self.times), self.times - self.times.mean()])
        base = np.linalg.qr(base)[0]
        return np.asarray(columns - base @ (base.T @ columns))

    def summed(self, rates: np.ndarray) -> np.ndarray:
        """Integrals of rates ``(n_times, n)``, or of one, without mean and trend."""
        return self.detrended(integrals(self.times, rates))

    def open_to(self, role: str) -> list[int]:
        """Fields whose names do not say that they are something else."""
        return [i for i, one in enumerate(self.every) if one.hint in ("", role)]

    def _options(self, index: int, role: str) -> dict[str, float]:
        """Units in which a field may be that of a role, with their nats."""
        one = self.every[index]
        needed, size, spread = TABLE["roles"][role]
        if one.stated:
            units = {one.stated: 0.0} if converts(one.stated, needed) else {}
        elif one.jumps:
            unit = "rad" if one.jumps == TURN else "deg"
            units = {unit: 0.0} if role in ("psi", "phi") else {}
        else:
            units = TABLE["written"][needed]
        named = one.named(role) + USUAL * bool(one.jumps and role == "psi")
        mean = 0.0 if needed in ("rad", "m") else float(one.values.mean())
        own = float(np.hypot(one.values.std(), mean))

        def worth(unit: str) -> float:
            away = np.log(own * factor(unit) / size) / spread
            return named - 0.5 * float(away) ** 2

        return {unit: nats + worth(unit) for unit, nats in units.items()}

    def readings(
        self, index: int, role: str, share: float, slope: float, error: float | None = SLOPE
    ) -> Iterator[Reading]:
        """Readings of a field that explains a share of a motion, by unit.

        Parameters
        ----------
        index, role
            Of the field, and what it would be.
        share, slope : float
            Of the motion it explains, and SI per its own unit.
        error : float or None
            Relative error of the slope; None where the slope tells nothing.
        """
        named = self.every[index].named(role)
        for unit, nats in self.options(index, role).items():
            fits = 0.0 if error is None else match(slope, factor(unit), error)
            score, sure = nats + explained(share) + fits, certain(share, fits, named)
            yield Reading(score, index, unit, int(np.sign(slope) or 1), sure, fits)


def _stated(series: Series) -> str:
    """Unit of a series, empty where nobody says it."""
    return series.unit if series.unit and is_unit(series.unit) else ""


def hint_of(series: Series) -> tuple[str, float]:
    """What a field's name means, and the nats that it is worth: a role, or what is none.

    A format's own definition stands above words. What was wanted may be a command, be it the
    setpoint of a rudder, but is no measured motion.
    """
    role, letters = meaning(series.name, _stated(series))
    defined = symbol_of(series.name, by_name=False)
    if defined and not (defined == "setpoint" and role in COMMANDS):
        return defined, DEFINED
    return role, NAMED * min(letters / 4.0, 1.0)


def _usable(log: Log) -> list[Series]:
    """Fields that change, are no clock, and are not said to be something else than motion."""
    found = []
    for one in log.series:
        good = np.isfinite(one.values)
        other = log.clock and one.name.endswith(f".{log.clock}")
        other = other or hint_of(one)[0] in TABLE["unmeasured"]
        if good.sum() > 4 and np.ptp(one.values[good]) > 0.0 and not other:
            found.append(_onward(one))
    return found


def _onward(series: Series) -> Series:
    """The longest part of a series in which its clock does not go back."""
    cuts = [0, *(np.flatnonzero(np.diff(series.times) < 0.0) + 1), series.times.size]
    first, last = max(pairwise(cuts), key=lambda part: part[1] - part[0])
    return replace(series, times=series.times[first:last], values=series.values[first:last])


def _grid(log: Log, every: Sequence[Series]) -> np.ndarray:
    """Times that fields have in common ``(n_times,)``, in units of the clock."""
    if not every:
        return np.arange(2.0)
    first, last = max(one.span[0] for one in every), min(one.span[1] for one in every)
    if not last > first:
        first, last = log.span
    return np.linspace(first, last, int(np.clip(max(one.times.size for one in every), *ROWS)))


def _block_means(at: np.ndarray, values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Means of a series over blocks about the times of the grid, by its integral."""
    half = 0.5 * (times[1] - times[0])
    if at.size <= times.size:
        return np.interp(times, at, values)
    whole = integrals(at, values)
    low, high = np.maximum(times - half, at[0]), np.minimum(times + half, at[-1])
    width = np.maximum(high - low, 1e-12)
    return (np.interp(high, at, whole) - np.interp(low, at, whole)) / width


def integrals(times: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Cumulative integrals of columns ``(n, k)``, or of one, by trapezia."""
    return np.asarray(cumulative_trapezoid(columns, times, axis=0, initial=0.0))


def line(by: np.ndarray, series: np.ndarray) -> tuple[float, float]:
    """Share of a series that a multiple of another explains, and the factor; both without mean."""
    power, both = float(by @ by), float(by @ series)
    return both**2 / max(power * float(series @ series), 1e-300), both / max(power, 1e-300)


@cache
def factor(unit: str) -> float:
    """A unit in SI."""
    return float(to_si(1.0, unit)[0])


def explained(share: float) -> float:
    """Nats of a share of variance that is explained, above what drifts explain of each other."""
    left = np.clip((1.0 - share) / (1.0 - SPURIOUS), 1e-4, 1.0)
    return -0.5 * INDEPENDENT * float(np.log(left))


def match(slope: float, ratio: float, error: float = SLOPE) -> float:
    """Nats by which a slope is that of two units, against one that may be any within a decade."""
    away = np.log(max(abs(slope), 1e-30) / ratio) / error
    density = np.log(np.log(10.0) / (error * np.sqrt(TURN)))
    return float(max(density - 0.5 * away**2, -10.0))


def certain(share: float, fits: float, named: float) -> bool:
    """Whether a field is what it is taken for, and not another that goes with the motion.

    Its name says so; or, where its name says nothing else, it explains more than others do that go
    with the motion (a sway velocity follows the yaw rate in slow turns, and a rudder the sway),
    with the slope of two units, where any slope would be as likely.
    """
    odds = float(np.clip(explained(share) - explained(RIVAL), -NAMED, NAMED)) + fits
    return bool(named > 0.0 or (named == 0.0 and odds > 0.5 * TOLD_APART))


def chances(scores: Sequence[float]) -> np.ndarray:
    """Probabilities of alternatives with scores in nats."""
    return np.asarray(softmax(scores))


def alone(score: float, others: Iterator[float]) -> bool:
    """Whether an alternative is sure against the best of others; with none it is."""
    return bool(chances([score, max(others, default=score - 99.0)])[0] > SURE)


def likeliest(rows: Sequence[Reading]) -> Reading:
    """The best of several readings; in doubt may be its unit, and whether it is meant."""
    best = max(rows)
    units = chances([row.score for row in rows if row.at == best.at])
    doubts = ("unit",) * bool(units.max() < SURE) + ("field",) * (not best.sure)
    return best._replace(doubts=doubts)
