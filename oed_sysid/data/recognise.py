r"""What the fields of a log are, from their numbers: role, unit, sign, wrap, and the unit of time.

Whatever the forces are, the motion of a rigid body obeys (Fossen 2021, Handbook of Marine Craft,
eqs. 2.26 and 2.38, at small roll)

.. math::
    \psi(t) - \psi(0) = \int r, \qquad \phi: \int p, \qquad \theta: \int q, \qquad
    x + i y = \int (u + i v)\, e^{i\psi}, \qquad z = \int (w\cos\theta - u\sin\theta) .

A field :math:`a` in an unknown unit and with an unknown sign is :math:`a = s\,f\,y`. Regressed on
the integral of another field, with a constant and a bias, it gives a slope :math:`k` and a share
:math:`R^2` that is explained; :math:`|k|` is the ratio of two units, which is one of a few numbers,
and the sign of :math:`k` is the product of two signs. Positions are regressed on
:math:`\int u\cos\psi` and :math:`\int u\sin\psi`: the size of the two slopes is a ratio of units
again, their direction says which axis it is and how a heading counts. Jumps by a turn give the unit
of an angle by themselves.

Each explanation is worth :math:`-\tfrac{n}{2}\ln(1-R^2)` nats for :math:`n` independent samples,
less what the slope is away from its ratio; sizes of motions and names in several languages add
what they are worth as a prior. What has less than :data:`SURE` of the sum of its alternatives is a
doubt, to be asked. Mirrored axes, all of them at once, obey the same equations: there only
conventions and names tell, and where they are weak it is asked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np

from oed_sysid.data.log import TABLE, Log, Series, groups_of, meaning, symbol_of
from oed_sysid.data.mapping import LogMapping, Source
from oed_sysid.data.record import TURN, clear_wraps, unwrapped
from oed_sysid.errors import DataError
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.runtime.display import align, as_dict
from oed_sysid.text.units import converts, is_unit, parse_header, shown_unit, to_si

# Probability from which on a choice is not asked. At 0.9 one mirrored log in ten passes unasked.
SURE = 0.95
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
NAMED, USUAL, DEFINED = 4.0, 2.5, 12.0
# Roles of measured motion, and of commands.
MOTION = ("psi", "r", "phi", "p", "theta", "q", "u", "v", "w", "x", "y", "z")
COMMANDS = ("rudder", "rpm", "thrust")
RATES = {"psi": "r", "phi": "p", "theta": "q"}
TIMES = {"s": 0.0, "ms": -1.0, "us": -2.0, "min": -2.0, "h": -4.0}


@dataclass(frozen=True)
class Guess:
    """What one field is taken for.

    Parameters
    ----------
    role : str
        SNAME symbol, or ``rudder``, ``rpm``, ``thrust``.
    field : str
        Name in the log.
    unit : str
        Unit of its numbers.
    sign : int
        -1 where its axis points the other way than the symbol says.
    wrap : bool
        Whether it may jump by full turns.
    trim : float
        Reading that is zero, in ``unit``: 90 deg where a heading counts from east.
    doubts : tuple of str
        What should be asked: ``field``, ``unit``, ``sign``.
    why : str
        What told it.

    Examples
    --------
    >>> Guess("r", "gyro.z", "deg/s", sign=-1, doubts=("sign",)).to_dict()["sign"]
    -1
    """

    role: str
    field: str
    unit: str
    sign: int = 1
    wrap: bool = False
    trim: float = 0.0
    doubts: tuple[str, ...] = ()
    why: str = ""

    to_dict = as_dict("role", "field", "unit", "sign", "wrap", "trim", "doubts", "why")


@dataclass(frozen=True)
class Recognised:
    """What the fields of a log are.

    Attributes
    ----------
    guesses : tuple of Guess
        One for each role that was found.
    time_unit : str
        Unit in which the clock counts.
    doubts : tuple of str
        What should be asked of the clock: ``unit`` or nothing.

    Examples
    --------
    What :func:`recognise` returns; see there.
    """

    guesses: tuple[Guess, ...]
    time_unit: str = "s"
    doubts: tuple[str, ...] = ()

    def __getitem__(self, role: str) -> Guess:
        if (found := self.get(role)) is None:
            raise DataError(f"No field was recognised as {role!r}.")
        return found

    def get(self, role: str) -> Guess | None:
        """The field of a role, if there is one."""
        return next((one for one in self.guesses if one.role == role), None)

    def says(self) -> list[str]:
        """Each guess in a sentence, and what should be confirmed."""
        lines = []
        for one in self.guesses:
            turned = " reversed" if one.sign < 0 else ""
            asked = f" Please confirm: {', '.join(one.doubts)}." if one.doubts else ""
            wraps = ", within one turn" if one.wrap else ""
            lines.append(f"{one.role} = {one.field} [{one.unit}]{turned}{wraps}: {one.why}.{asked}")
        return lines

    def rows(self, log: Log) -> list[dict[str, str]]:
        """Each guess with its range as logged and as read, what is to be confirmed first."""
        return [
            {
                "field": one.field,
                "is": ("-" if one.sign < 0 else "") + one.role,
                "as logged": _reach(log[one.field].values, one.unit),
                "as read": _reach(*_read(one, log)),
                "because": one.why,
                "please confirm": ", ".join(one.doubts),
            }
            for one in sorted(self.guesses, key=lambda one: not one.doubts)
        ]

    def table(self, log: Log) -> str:
        """The rows as text, before and after."""
        rows = self.rows(log)
        cells = [tuple(rows[0]), *(tuple(row.values()) for row in rows)] if rows else []
        return "\n".join(align(cells, left=range(6)))

    to_dict = as_dict("time_unit", "doubts", "guesses")


def _read(one: Guess, log: Log) -> tuple[np.ndarray, str]:
    """A field as it is read, in the unit that people are shown."""
    values, si = to_si(one.sign * (log[one.field].values - one.trim), one.unit)
    values = unwrapped(values) if one.wrap else values
    factor, unit = shown_unit(si)
    return np.asarray(values * factor), unit


def _reach(values: np.ndarray, unit: str) -> str:
    """Smallest and largest value."""
    good = values[np.isfinite(values)]
    return f"{good.min():.4g} to {good.max():.4g} {unit}" if good.size else "no number"


@dataclass(frozen=True, eq=False)
class _Field:
    """One field on the common grid."""

    name: str
    values: np.ndarray = field(repr=False)  # unwrapped, as logged
    stated: str  # unit; empty where nobody says it
    wraps: bool
    low: float  # smallest reading
    hint: str  # role that its name means
    weight: float  # nats that the name is worth
    held: bool  # whether it mostly stays at one value
    jumps: float  # period of its jumps in its own unit, or 0


def recognise(log: Log) -> Recognised:
    """Say what the fields of a log are.

    Parameters
    ----------
    log : Log
        As :func:`~oed_sysid.data.formats.open_log` returns it.

    Returns
    -------
    Recognised
        Fields by role, with what should be asked.

    Examples
    --------
    >>> from pathlib import Path
    >>> from oed_sysid.data.log import assemble
    >>> t = np.arange(0.0, 400.0, 0.5)
    >>> heading = 20.0 + 150.0 * np.sin(0.02 * t)
    >>> rate = 60.0 * 3.0 * np.cos(0.02 * t)
    >>> log = assemble(Path("a.csv"), "", {"a": (t, {"ch1": -rate, "cap": heading % 360.0})})
    >>> for line in recognise(log).says():
    ...     print(line)
    psi = a.cap [deg], within one turn: it jumps by a turn of 360 deg, and is the integral of a.ch1.
    r = a.ch1 [deg/min] reversed: it is the rate of a.cap.
    """
    units = TIMES if log.clock_unit is None else (log.clock_unit,)
    works = [_Work(log, unit) for unit in units]
    best = max(works, key=lambda one: one.score)
    chance = _chances([one.score for one in works])[works.index(best)]
    return best.result(("unit",) * bool(chance < SURE))


# -- the log on a grid -------------------------------------------------------------------


def _usable(log: Log) -> list[Series]:
    """Fields that change and are no clock."""
    found = []
    for one in log.series:
        good = np.isfinite(one.values)
        clock = log.clock and one.name.endswith(f".{log.clock}")
        if good.sum() > 4 and np.ptp(one.values[good]) > 0.0 and not clock:
            found.append(one)
    return found


def _gridded(log: Log, factor: float) -> tuple[np.ndarray, list[_Field]]:
    """Times ``(n,)`` in s, and means of all fields over blocks about them."""
    every = _usable(log)
    if len(every) > 48:  # those with meaningful names first: work grows with their square
        every = sorted(every, key=lambda one: -meaning(one.name)[1])[:48]
    if not every:
        return np.arange(2.0), []
    first = max(one.span[0] for one in every)
    last = min(one.span[1] for one in every)
    if not last > first:
        first, last = log.span
    # Rates and positions are integrals: more means than these would only cost time.
    rows = int(np.clip(max(one.times.size for one in every), 16, 1500))
    times = np.linspace(first, last, rows)
    return times * factor, [_field(one, times) for one in every]


def _field(series: Series, times: np.ndarray) -> _Field:
    good = np.isfinite(series.values)
    at, values = series.times[good], series.values[good]
    wraps = clear_wraps(values)
    jumps = 0.0 if wraps is None else wraps[0]
    smooth = unwrapped(values, period=jumps) if jumps else values
    role, letters = meaning(series.name)
    defined = symbol_of(series.name, by_name=False)
    stated = series.unit if series.unit and is_unit(series.unit) else ""
    kept = float(np.mean(np.diff(values) == 0.0)) if values.size > 1 else 1.0
    return _Field(
        series.name,
        _block_means(at, smooth, times),
        stated,
        jumps > 0.0,
        float(values.min()),
        defined or role,
        DEFINED if defined else NAMED * min(letters / 4.0, 1.0),
        kept > 0.5,
        jumps,
    )


def _block_means(at: np.ndarray, values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Means of a series over blocks about the times of the grid, by its integral."""
    half = 0.5 * (times[1] - times[0])
    if at.size <= times.size:
        return np.interp(times, at, values)
    whole = _integrals(at, values[:, None])[:, 0]
    low, high = np.maximum(times - half, at[0]), np.minimum(times + half, at[-1])
    width = np.maximum(high - low, 1e-12)
    return (np.interp(high, at, whole) - np.interp(low, at, whole)) / width


def _integrals(times: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Cumulative integrals of columns ``(n, k)``, by trapezia."""
    steps = np.diff(times)[:, None] * 0.5 * (columns[1:] + columns[:-1])
    return np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(steps, axis=0)])


def _line(by: np.ndarray, series: np.ndarray) -> tuple[float, float]:
    """Share of a series that a multiple of another explains, and the factor; both without mean."""
    power, both = float(by @ by), float(by @ series)
    return both**2 / max(power * float(series @ series), 1e-300), both / max(power, 1e-300)


@cache
def _factor(unit: str) -> float:
    """A unit in SI."""
    return float(to_si(1.0, unit)[0])


def _explained(share: float) -> float:
    """Nats of a share of variance that is explained, above what drifts explain of each other."""
    left = np.clip((1.0 - share) / (1.0 - SPURIOUS), 1e-4, 1.0)
    return -0.5 * INDEPENDENT * float(np.log(left))


def _match(slope: float, ratio: float, error: float = SLOPE) -> float:
    """Nats by which a slope is that of two units, against one that may be any within a decade."""
    away = np.log(max(abs(slope), 1e-30) / ratio) / error
    density = np.log(np.log(10.0) / (error * np.sqrt(TURN)))
    return float(max(density - 0.5 * away**2, -10.0))


def _certain(share: float, match: float, named: float) -> bool:
    """Whether a field is what it is taken for, and not another that goes with the motion.

    Its name says so; or, where its name says nothing else, it explains more than others do that go
    with the motion (a sway velocity follows the yaw rate in slow turns, and a rudder the sway),
    with the slope of two units, where any slope would be as likely.
    """
    odds = float(np.clip(_explained(share) - _explained(RIVAL), -NAMED, NAMED)) + match
    return bool(named > 0.0 or (named == 0.0 and odds > np.log(SURE / (1.0 - SURE))))


def _chances(scores: Sequence[float]) -> np.ndarray:
    """Probabilities of alternatives with scores in nats."""
    weights = np.exp(np.array(scores) - max(scores))
    return weights / weights.sum()


# -- the likeliest roles -----------------------------------------------------------------


@dataclass(frozen=True)
class _Angle:
    """An angle and its rate: indices of fields (-1 without a rate), units, sign of the slope."""

    angle: int
    unit: str
    rate: int
    rate_unit: str
    sign: int
    score: float
    sure: bool = True  # that it is the rate, and not another field that goes with the motion


@dataclass(frozen=True)
class _Plane:
    """Positions by heading and speed: indices, units, directions in rad against the heading."""

    speed: int
    speed_unit: str
    axes: tuple[int, int]
    unit: str
    directions: tuple[float, float]
    score: float
    doubts: tuple[str, ...] = ()  # about the speed
    scaled: bool = True  # whether the unit of the positions is sure
    told: float = 0.0  # nats of what the motion explains alone
    pace: float = 0.0  # positions' change for one of the speed


class _Row(NamedTuple):
    """One reading of one field: nats, index, unit, sign, whether it is this field for certain."""

    score: float
    at: int
    unit: str
    sign: int
    sure: bool
    doubts: tuple[str, ...] = ()


def _likeliest(rows: Sequence[_Row]) -> _Row:
    """The best of several rows, with what is not sure of it: its unit, and whether it is meant."""
    best = max(rows)
    units = _chances([row.score for row in rows if row.at == best.at])
    doubts = ("unit",) * bool(units.max() < SURE) + ("field",) * (not best.sure)
    return best._replace(doubts=doubts)


# None of them.
_STILL = _Angle(-1, "", -1, "", 1, 0.0)
_NOWHERE = _Plane(-1, "", (-1, -1), "", (0.0, 0.0), 0.0)
_LEVEL = _Row(0.0, -1, "", 0, True)


def _indices(one: _Angle, more: _Plane | _Row) -> list[int]:
    """Fields that an angle, its rate and what it explains take."""
    theirs = [more.speed, *more.axes] if isinstance(more, _Plane) else [more.at]
    return [i for i in (one.angle, one.rate, *theirs) if i >= 0]


def _apart(indices: Iterable[int]) -> bool:
    """Whether no field is taken twice."""
    taken = list(indices)
    return len(set(taken)) == len(taken)


class _Work:
    """One log read with one unit of time: fields on a grid, and the likeliest roles."""

    def __init__(self, log: Log, time_unit: str) -> None:
        self.time_unit = time_unit
        self.times, self.fields = _gridded(log, _factor(time_unit) / _factor(log.clock_unit or "s"))
        self.found: dict[str, Guess] = {}
        self.used: set[int] = set()
        # Asked again and again of the same fields.
        self.options, self.pairs = cache(self._options), cache(self._pairs)
        self.plane_of = cache(self._plane_of)
        step = float(np.median(np.diff(self.times)))
        # Vehicles are logged some times in a second to some times in a minute.
        self.score = TIMES.get(time_unit, 0.0) - 0.5 * float(np.log(step / 0.5) / 2.5) ** 2
        if self.fields:
            self.columns = np.stack([one.values for one in self.fields], axis=1)
            self.sums = self._free(_integrals(self.times, self.columns))
            self.free = self._free(self.columns)
            self._rotations()
            self._rest()

    def _free(self, columns: np.ndarray) -> np.ndarray:
        """Columns without their mean and trend."""
        base = np.column_stack([np.ones_like(self.times), self.times - self.times.mean()])
        base = np.linalg.qr(base)[0]
        return np.asarray(columns - base @ (base.T @ columns))

    def _options(self, index: int, role: str) -> dict[str, float]:
        """Units in which a field may be that of a role, with their nats."""
        one = self.fields[index]
        needed, size, spread = TABLE["roles"][role]
        if one.stated:
            units = {one.stated: 0.0} if converts(one.stated, needed) else {}
        elif one.wraps:
            unit = "rad" if one.jumps == TURN else "deg"
            units = {unit: 0.0} if role in ("psi", "phi") else {}
        else:
            units = TABLE["written"][needed]
        named = self._named(index, role) + USUAL * bool(one.wraps and role == "psi")
        mean = 0.0 if needed in ("rad", "m") else float(one.values.mean())
        own = float(np.hypot(one.values.std(), mean))

        def worth(unit: str) -> float:
            away = np.log(own * _factor(unit) / size) / spread
            return named - 0.5 * float(away) ** 2

        return {unit: nats + worth(unit) for unit, nats in units.items()}

    def _pairs(self, role: str) -> list[_Angle]:
        """Angles with their rates, and angles without one, that may be of a role; best first."""
        found = [one for a in self.open_to(role) for one in self._angles(a, role)]
        return sorted(found, key=lambda one: -one.score)

    def _angles(self, a: int, role: str) -> Iterator[_Angle]:
        """A field as an angle: without a rate, and with each that may be its rate."""
        for unit, score in self.options(a, role).items():
            yield _Angle(a, unit, -1, "", 1, score)
            for b in self.open_to(RATES[role]):
                share, slope = _line(self.sums[:, b], self.free[:, a])
                if a == b or share < SPURIOUS:
                    continue
                for by, more in self.options(b, RATES[role]).items():
                    fits = _match(slope, _factor(by) / _factor(unit))
                    sure = _certain(share, fits, self._named(b, RATES[role]))
                    if fits > -4.0:
                        total = score + more + fits + _explained(share)
                        yield _Angle(a, unit, b, by, int(np.sign(slope)), total, sure)

    # -- heading, yaw rate, speed and positions; attitudes --

    def _rotations(self) -> None:
        """Heading, pitch and roll with their rates, together.

        That a field is the rate of another says that they are an angle and a rate, and not of
        which axis: the three axes are told together.
        """
        rows = [
            (sum(score for score, _, _ in row), row)
            for row in product(*map(self._turning, RATES))
            if _apart(i for _, one, more in row for i in _indices(one, more))
        ]
        rows.sort(key=lambda one: -one[0])
        score, (psi, phi, theta) = rows[0]
        self.score += score
        doubts = {
            role: ("field",) * (not self._alone(role, index, rows))
            for index, role in enumerate(RATES)
        }
        if psi[1].angle >= 0:
            asked = self._unit_doubts("psi", psi[1]) + doubts["psi"]
            self._senses(psi[1], psi[2], asked)
        for role, (_, angle, dive) in (("theta", theta), ("phi", phi)):
            if angle.angle >= 0:
                self._attitude(role, angle, doubts[role], dive)
        if psi[2].axes[0] >= 0:
            self._sway(psi[2])

    def _turning(self, role: str) -> list[tuple[float, _Angle, Any]]:
        """Angles of a role, what they explain, and nats of both; first that there is none."""
        ways: dict[str, tuple[Any, float, Callable[[_Angle], Any]]] = {
            "psi": (_NOWHERE, NAMED - 2.0, self._plane),
            "phi": (_LEVEL, 1.5 * USUAL, lambda one: _LEVEL),
            "theta": (_LEVEL, 1.5 * USUAL, self._dive),
        }
        nothing, least, explained = ways[role]
        rows = [(one, explained(one)) for one in self._some(role)]
        found = [(one.score + more.score, one, more) for one, more in rows]
        return [(0.0, _STILL, nothing), *(row for row in found if row[0] > least)]

    def _some(self, role: str) -> list[_Angle]:
        """The likeliest angles of a role, each with its likeliest rates and with none."""
        seen: Counter[tuple[int, bool]] = Counter()
        found = []
        for one in self.pairs(role):
            seen[one.angle, one.rate < 0] += 1
            if seen[one.angle, one.rate < 0] <= 2:
                found.append(one)
        return found[:12]

    def _alone(self, role: str, index: int, rows: Sequence[tuple[float, Any]]) -> bool:
        """Whether no other field could as well be the angle of a role."""
        score, best = rows[0]
        if best[index][1].angle < 0:
            return True
        others = [s for s, row in rows if row[index][1].angle != best[index][1].angle]
        return bool(_chances([score, max(others, default=score - 99.0)])[0] > SURE)

    def _unit_doubts(self, role: str, angle: _Angle) -> tuple[str, ...]:
        """Whether other units explain as much."""
        same = [
            p for p in self.pairs(role) if (p.angle, p.rate) == (angle.angle, angle.rate)
        ]  # fmt: skip
        scores = [p.score + (self._plane(p).score if role == "psi" else 0.0) for p in same]
        return ("unit",) * bool(_chances(scores)[same.index(angle)] < SURE)

    def _plane(self, angle: _Angle) -> _Plane:
        """Positions that an angle explains, with the speed that does it best."""
        return self.plane_of(angle.angle, angle.unit, angle.rate)

    def _plane_of(self, angle: int, unit: str, rate: int) -> _Plane:
        taken, psi = {angle, rate}, self.columns[:, angle] * _factor(unit)
        speeds = [i for i in self.open_to("u") if i not in taken and self.options(i, "u")]
        steady = self._along(psi, -1, taken)
        found = [self._along(psi, s, taken | {s}) for s in speeds]
        # What hardly changes explains as much as a steady speed does, whatever it is.
        better = [
            one
            for one in found
            if one.speed < 0 or self._named(one.speed, "u") > 0.0 or one.told > steady.told + NAMED
        ]
        return max([steady, *better], key=lambda one: one.score)

    def open_to(self, role: str) -> list[int]:
        """Fields whose names do not say that they are something else."""
        return [i for i, one in enumerate(self.fields) if one.hint in ("", role)]

    def _along(self, psi: np.ndarray, speed: int, taken: set[int]) -> _Plane:
        """The two fields that are the positions of a motion along a heading, if there are two."""
        size = self.columns[:, speed] if speed >= 0 else np.ones_like(psi)
        turned = np.column_stack([size * np.cos(psi), size * np.sin(psi)])
        base = self._free(_integrals(self.times, turned))
        slopes, *_ = np.linalg.lstsq(base, self.free, rcond=1e-6)
        power = np.sum(self.free**2, axis=0)
        left = np.sum((self.free - base @ slopes) ** 2, axis=0)
        shares = 1.0 - left / np.maximum(power, 1e-300)
        axes = [
            i
            for i in np.argsort(-shares)[:8].tolist()
            if i not in taken and shares[i] > SPURIOUS and self.options(i, "x")
        ]
        rows = [self._axes(speed, pair, slopes, shares) for pair in permutations(axes[:5], 2)]
        found = max((row for row in rows if row), key=lambda one: one.score, default=None)
        # One axis alone moves with the heading too, but does not say which it is.
        named = [_explained(float(shares[i])) for i in axes if self.fields[i].hint in ("x", "y")]
        return found or replace(_NOWHERE, score=max(named, default=0.0))

    def _axes(
        self, speed: int, pair: tuple[int, int], slopes: np.ndarray, shares: np.ndarray
    ) -> _Plane | None:
        """Two fields as axes of the plane, in the units that fit best; None if they are not."""
        one, other = pair
        ways = tuple(float(np.arctan2(slopes[1, i], slopes[0, i])) for i in pair)
        size = float(np.sqrt(np.prod([np.hypot(*slopes[:, i]) for i in pair])))
        if one > other or abs(np.cos(ways[0] - ways[1])) > 0.2 or size <= 0.0:
            return None
        told = sum(_explained(float(shares[i])) for i in pair)
        rows = list(self._units(speed, pair, size, told))
        if not rows or max(rows)[0] <= 0.0:
            return None
        score, unit, by, fits = max(rows)
        chances = _chances([row[0] for row in rows])

        def sure_of(column: int, value: str) -> bool:
            same = (c for c, row in zip(chances, rows, strict=True) if row[column] == value)
            return bool(sum(same) > SURE)

        share = float(min(shares[i] for i in pair))
        sure = bool(by) and _certain(share, fits, self._named(speed, "u"))
        doubts = ("unit",) * (not sure_of(2, by)) + ("field",) * (not sure)
        # Any field that hardly changes does for a speed; only a sure one gives the unit of the way.
        score -= USUAL * (not sure and bool(by))
        scaled = bool(self.fields[one].stated) or (sure and sure_of(1, unit))
        return _Plane(speed, by, pair, unit, (ways[0], ways[1]), score, doubts, scaled, told, size)

    def _units(
        self, speed: int, pair: tuple[int, int], size: float, told: float
    ) -> Iterator[tuple[float, str, str, float]]:
        """Nats by unit of the positions and of the speed, and what the size of the slope adds."""
        theirs = self.options(speed, "u") if speed >= 0 else {"": 0.0}
        ahead, abeam = self.options(pair[0], "x"), self.options(pair[1], "y")
        for unit, by in product((one for one in ahead if one in abeam), theirs):
            # Without a speed any size of the slope will do, and anything may drive the motion.
            fits = _match(size, _factor(by) / _factor(unit)) if by else 0.0
            yield told + ahead[unit] + abeam[unit] + theirs[by] + fits, unit, by, fits

    def _named(self, index: int, role: str) -> float:
        """Nats that a field's name is worth for a role."""
        one = self.fields[index]
        return one.weight if one.hint == role else -one.weight if one.hint else 0.0

    def _senses(self, angle: _Angle, plane: _Plane, doubts: tuple[str, ...]) -> None:
        """Which way a heading counts, which axis is north, and the signs that follow."""
        rows = list(self._worlds(angle, plane))
        if not rows:  # axes that stand askew to the heading
            plane = _NOWHERE
            rows = list(self._worlds(angle, plane))
        chances = _chances([score for score, _ in rows])
        best = rows[int(np.argmax(chances))][1]

        def sure(*keys: str) -> bool:
            same = [c for c, (_, row) in zip(chances, rows, strict=True)
                    if all(row.get(k) == best.get(k) for k in keys)]  # fmt: skip
            return bool(sum(same) > SURE)

        one = self.fields[angle.angle]
        turn = 0.25 * TURN / _factor(angle.unit)
        unsure = ("sign",) * (not sure("sense"))
        reach = float(np.ptp(one.values)) * _factor(angle.unit)
        self._take(
            "psi", angle.angle, angle.unit, -1 if best["sense"] else 1, (*doubts, *unsure),
            self._why(angle, plane), wrap=one.wraps or reach < TURN,
            trim=turn if best["sense"] == 2 else 0.0,
        )  # fmt: skip
        if angle.rate >= 0:
            turned = ("sign",) * (not sure("r"))
            units = (*(d for d in doubts if d == "unit"), *("field",) * (not angle.sure))
            said = f"it is the rate of {one.name}"
            self._take("r", angle.rate, angle.rate_unit, best["r"], (*units, *turned), said)
        for role in "xy" if plane.axes[0] >= 0 else "":
            # Another world often means the other axis; the log of a sure one says its names.
            asked = ("unit",) * (not plane.scaled)
            asked += ("field", "sign") * (not sure(role, f"{role} sign"))
            said = f"it follows {one.name}"
            self._take(role, best[role], plane.unit, best[f"{role} sign"], asked, said)
        if plane.speed >= 0:
            asked = (*plane.doubts, *("sign",) * (not sure("u sign")))
            said = "the positions move as fast"
            self._take("u", plane.speed, plane.speed_unit, best["u sign"], asked, said)

    def _why(self, angle: _Angle, plane: _Plane) -> str:
        """What told a heading."""
        one, why = self.fields[angle.angle], []
        if one.wraps:
            why.append(f"it jumps by a turn of {'360 deg' if one.jumps > 7 else '2 pi rad'}")
        if angle.rate >= 0:
            why.append(f"is the integral of {self.fields[angle.rate].name}")
        if plane.axes[0] >= 0:
            why.append("is the direction in which the positions move")
        return ", and ".join(why) or "its name and size"

    def _worlds(self, angle: _Angle, plane: _Plane) -> Iterator[tuple[float, dict[str, int]]]:
        """Ways in which a heading may count (clockwise, back, from east), with their nats."""
        one = self.fields[angle.angle]
        # A compass counts 0 to 360 clockwise; a yaw angle may be of east-north-up.
        is_compass = meaning(one.name)[0] == "psi" and "compass" in groups_of(one.name)
        compass = (one.jumps == 360.0 and one.low >= 0.0) + NAMED * is_compass
        for sense, nats in ((0, compass), (1, -3.0), (2, -1.5)):
            way = 1 if sense == 0 else -1
            r = angle.sign * way
            # Of a compass the rate may be port positive; in east-north-up both count alike.
            base = nats - 2.0 * (sense == 0 and r < 0) - 3.0 * (sense == 2 and angle.sign < 0)
            if plane.axes[0] < 0:
                yield base, {"sense": sense, "r": r}
                continue
            for score, row in self._ground(plane, sense):
                yield base + score, {"sense": sense, "r": r} | row

    def _ground(self, plane: _Plane, sense: int) -> Iterator[tuple[float, dict[str, int]]]:
        """Which field is north, which east, and the signs that a sense of the heading allows."""
        axes = list(zip(plane.axes, plane.directions, strict=True))
        wanted = ((0.0, 0.25), (0.0, -0.25), (0.25, 0.0))[sense]
        ways = (1, -1) if plane.speed >= 0 else (1,)
        for pair, signs, su in product((axes, axes[::-1]), product((1, -1), (1, -1)), ways):
            right = (
                np.cos(d - TURN * w) * s * su >= 0.9
                for (_, d), w, s in zip(pair, wanted, signs, strict=True)
            )
            if not all(right):
                continue
            score = -USUAL * sum(s < 0 for s in signs)
            if plane.speed >= 0:
                score += 3.0 * su * float(np.sign(self.columns[:, plane.speed].mean()))
            for (i, _), role, other, sign in zip(pair, "xy", "yx", signs, strict=True):
                named = self.fields[i]
                # What is called east does not count to the west.
                score += sign * named.weight if named.hint == role else 0.0
                score -= named.weight if named.hint == other else 0.0
            (x, _), (y, _) = pair
            yield score, {"x": x, "y": y, "x sign": signs[0], "y sign": signs[1], "u sign": su}

    def _take(
        self, role: str, index: int, unit: str, sign: int, doubts: Sequence[str], why: str,
        *, wrap: bool = False, trim: float = 0.0,
    ) -> None:  # fmt: skip
        """Give a field a role."""
        self.used.add(index)
        asked = tuple(dict.fromkeys(doubts))
        name = self.fields[index].name
        self.found[role] = Guess(role, name, unit, sign, wrap, trim, asked, why)

    def series(self, role: str) -> np.ndarray | None:
        """A role that was found for certain, SI ``(n,)``."""
        one = self.found.get(role)
        if one is None or "field" in one.doubts:
            return None
        index = next(i for i, f in enumerate(self.fields) if f.name == one.field)
        raw = self.columns[:, index] - one.trim
        return np.asarray(one.sign * to_si(raw, one.unit)[0])

    def _sway(self, plane: _Plane) -> None:
        """Speed abeam: what the positions show beside the speed ahead."""
        psi, u, x, y = (self.series(role) for role in ("psi", "u", "x", "y"))
        if psi is None or x is None or y is None:
            return
        if u is None:
            u = np.full_like(psi, plane.pace * _factor(plane.unit))
        theta = self.series("theta")
        u = u if theta is None else u * np.cos(theta)
        ahead = np.concatenate([self._sum(u * np.cos(psi)), self._sum(u * np.sin(psi))])
        moved = np.concatenate([self._free(x[:, None])[:, 0], self._free(y[:, None])[:, 0]])

        def abeam(v: np.ndarray) -> np.ndarray:
            return np.concatenate([self._sum(-v * np.sin(psi)), self._sum(v * np.cos(psi))])

        self._explain("v", moved, ahead, abeam, "the positions drift with it")

    def _sum(self, rate: np.ndarray) -> np.ndarray:
        """Integral of a rate, without mean and trend ``(n,)``."""
        return np.asarray(self._free(_integrals(self.times, rate[:, None]))[:, 0])

    def _explain(
        self, role: str, target: np.ndarray, base: np.ndarray,
        moves: Callable[[np.ndarray], np.ndarray], why: str,
    ) -> None:  # fmt: skip
        """Take for a role the field that explains best what is left of a motion, if any is good.

        ``moves`` makes of a field's values the motion that they would add to that of ``base``.
        """
        rows = [
            row
            for i in self.open_to(role)
            if i not in self.used
            for row in self._added(i, role, target, base, moves(self.columns[:, i]))
        ]
        rows = self._same_units(role, rows)
        if not rows or max(rows).score < NAMED:
            return
        best = _likeliest(rows)
        rivals = (row.score for row in rows if row.at != best.at)
        alone = _chances([best.score, max(rivals, default=best.score - 99.0)])[0]
        doubts = (*best.doubts, *("field",) * bool(alone < SURE))
        # Sway counts with the heading, heave with the pitch.
        leading = self.found.get({"v": "psi", "w": "theta"}.get(role, ""))
        doubts += ("sign",) * (role in "vw" and (leading is None or "sign" in leading.doubts))
        # What explains a motion in a unit that is in doubt is itself in doubt.
        bases = (self.found.get(one) for one in {"v": "uxy", "w": "uz"}.get(role, ""))
        doubts += ("unit",) * any(one is not None and "unit" in one.doubts for one in bases)
        self._take(role, best.at, best.unit, best.sign, doubts, why)

    def _added(
        self, i: int, role: str, target: np.ndarray, base: np.ndarray, column: np.ndarray
    ) -> list[_Row]:
        """What a field explains of what ``base`` leaves of a motion, by unit."""
        both = np.column_stack([base, column])
        left = target - base * _line(base, target)[1]
        solution = np.linalg.lstsq(both, target, rcond=1e-9)[0]
        rest, slope = target - both @ solution, float(solution[-1])
        share = 1.0 - float(rest @ rest) / max(float(left @ left), 1e-300)
        rows = []
        for unit, nats in self.options(i, role).items():
            # A small part of the motion is known less well than the whole.
            fits = _match(slope, _factor(unit), 0.15)
            score = nats + _explained(share) + fits
            sure = _certain(share, fits, self._named(i, role))
            rows.append(_Row(score, i, unit, int(np.sign(slope) or 1), sure))
        return rows if share > 0.3 else []

    # -- pitch, roll, depth --

    def _attitude(self, role: str, one: _Angle, doubts: tuple[str, ...], dive: _Row) -> None:
        """Take an angle and its rate, and with a pitch the depth."""
        doubts = (*doubts, *self._unit_doubts(role, one))
        if dive.at >= 0:
            again = self._dive(one, self.series("u"), (dive.at,))
            dive = again if again.at >= 0 else dive
        worlds = list(self._ways(role, one, dive))
        scores = [w[0] for w in worlds]
        unsure = ("sign",) * bool(max(_chances(scores)) < SURE)
        _, angle, turning, z = max(worlds)
        told = "its name and size"
        if self._named(one.angle, role) <= 0.0:  # which axis it is, no equation tells for sure
            doubts = (*doubts, "field")
        if one.rate >= 0:
            told = f"it is the integral of {self.fields[one.rate].name}"
            said = f"it is the rate of {self.fields[one.angle].name}"
            asked = (*doubts, *unsure, *("field",) * (not one.sure))
            self._take(RATES[role], one.rate, one.rate_unit, turning, asked, said)
        self._take(role, one.angle, one.unit, angle, (*doubts, *unsure), told)
        if dive.at >= 0:
            said = f"it changes with {self.fields[one.angle].name}"
            self._take("z", dive.at, dive.unit, z, (*dive.doubts, *unsure), said)

    def _ways(self, role: str, one: _Angle, dive: _Row) -> Iterator[tuple[float, int, int, int]]:
        """Signs of an angle, of its rate and of the depth that agree with each other: nats, signs.

        Where the heading is that of east-north-up, the body's axes are forward-left-up as a rule.
        """
        left_up = self.flu if role == "theta" else 0.0
        for angle in (1, -1):
            turning = angle * one.sign if one.rate >= 0 else 1
            score = (-3.0 if angle < 0 else 0.0) + left_up * (-angle)
            score -= 2.5 * (turning * angle < 0)
            z = -dive.sign * angle
            if dive.at >= 0:
                score += self._depth(self.fields[dive.at], z)
            yield score, angle, turning, z

    def _depth(self, one: _Field, z: int) -> float:
        """Nats for a depth that counts downwards (1) or upwards (-1)."""
        below = -1 if _is_up(one.name) else 1
        named = one.weight * (z == below) if one.hint == "z" else 0.0
        # What dives is below the surface all the time, whatever the column is called.
        one_sided = one.low > 0.0 or one.values.max() < 0.0
        dives = (NAMED + USUAL) * (z * one.values.mean() > 0.0) if one_sided else 0.0
        return float(named + dives)

    @property
    def flu(self) -> float:
        """Half the nats for axes forward-left-up: more where the heading counts from east."""
        heading = self.found.get("psi")
        if heading is None or "sign" in heading.doubts:
            return 0.5
        return 2.0 if heading.sign < 0 else 0.0

    def _dive(
        self, theta: _Angle, u: np.ndarray | None = None, among: Sequence[int] | None = None
    ) -> _Row:
        """The depth that a pitch explains, if there is one."""
        angle = self.columns[:, theta.angle] * _factor(theta.unit)
        column = self._sum((1.0 if u is None else u) * np.sin(angle))
        rows = []
        for i in self.open_to("z") if among is None else among:
            share, slope = _line(column, self.free[:, i])
            if i in (theta.angle, theta.rate) or share < SPURIOUS:
                continue
            for unit, nats in self.options(i, "z").items():
                # What the heave adds is not asked: ten per cent of the speed.
                fits = 0.0 if u is None else _match(slope, 1.0 / _factor(unit), 0.1)
                sure = _certain(share, fits, self._named(i, "z"))
                score = nats + _explained(share) + fits
                rows.append(_Row(score, i, unit, int(np.sign(slope)), sure))
        return _likeliest(rows) if rows else _LEVEL

    # -- what has a name only --

    def _rest(self) -> None:
        """Roles that nothing but name, unit and size tells; commands."""
        theta, u, z = (self.series(role) for role in ("theta", "u", "z"))
        if theta is not None and u is not None and z is not None:
            dived, target = self._sum(-u * np.sin(theta)), self._free(z[:, None])[:, 0]
            heaved = np.cos(theta)
            said = "the depth changes with it"
            self._explain("w", target, dived, lambda w: self._sum(w * heaved), said)
        for angle in RATES:
            if angle not in self.found:
                self._by_name(angle)
            if angle in self.found and RATES[angle] not in self.found:
                self._euler(angle)
        for role in (*MOTION, *COMMANDS):
            if role not in self.found:
                self._by_name(role)

    def _euler(self, angle: str) -> None:
        """A rate that is one of an angle with the other angles and rates taken into account."""
        target = self.series(angle)
        if target is None:
            return
        zero = np.zeros_like(target)
        theirs = (self.series(n) for n in ("phi", "theta", "q", "r"))
        phi, theta, q, r = (zero if one is None else one for one in theirs)
        turning = q * np.sin(phi) + r * np.cos(phi)
        others, factor = {
            "phi": (turning * np.tan(theta), np.ones_like(phi)),
            "theta": (-r * np.sin(phi), np.cos(phi)),
            "psi": (q * np.sin(phi) / np.cos(theta), np.cos(phi) / np.cos(theta)),
        }[angle]
        left = self._free(target[:, None])[:, 0] - self._sum(others)
        role, said = RATES[angle], f"it is the rate of {self.found[angle].field}"
        self._explain(role, left, zero, lambda rate: self._sum(rate * factor), said)
        # Through the other angles their doubtful signs are its own.
        others = (one for one in self.found.values() if one.role in (*RATES, "q", "r"))
        if role in self.found and any("sign" in one.doubts for one in others):
            self.found[role] = _asked(self.found[role], "sign")

    def _by_name(self, role: str) -> None:
        """Take the field that is called so."""
        rows = [
            _Row(nats, i, unit, 1, True)
            for i, one in enumerate(self.fields)
            if i not in self.used and one.hint == role
            for unit, nats in self.options(i, role).items()
        ]
        if not rows:
            return
        best = _likeliest(self._same_units(role, rows))
        doubts = (*best.doubts, *("field",) * (len({row.at for row in rows}) > 1))
        # Forward, down and clockwise are usual; of other axes a name does not tell the direction.
        doubts += ("sign",) * (role in ("v", "w", "p", "q", "r", "y"))
        sign = -1 if role == "z" and _is_up(self.fields[best.at].name) else 1
        self._take(role, best.at, best.unit, sign, doubts, "its name and size")

    def _same_units(self, role: str, rows: Sequence[_Row]) -> list[_Row]:
        """A logger mostly writes quantities of one kind in one unit."""
        needed = TABLE["roles"][role][0]
        known = {
            one.unit
            for other, one in self.found.items()
            if TABLE["roles"][other][0] == needed and not {"unit", "field"} & {*one.doubts}
        }
        return [row._replace(score=row.score + 1.5 * (row.unit in known)) for row in rows]

    def result(self, doubts: tuple[str, ...] = ()) -> Recognised:
        """The guesses, in the usual order of symbols."""
        order = (*MOTION, *COMMANDS)
        found = tuple(self.found[role] for role in order if role in self.found)
        if doubts:  # a rate is known as well as the clock is
            rates = [one for one in found if one.role in RATES.values() and "rate" in one.why]
            found = tuple(_asked(one, "unit") if one in rates else one for one in found)
        return Recognised(found, self.time_unit, doubts)


def _asked(one: Guess, doubt: str) -> Guess:
    """A guess with one more thing to be asked."""
    return replace(one, doubts=tuple(dict.fromkeys((*one.doubts, doubt))))


def _is_up(name: str) -> bool:
    """Whether a name counts upwards."""
    return "up" in groups_of(name)


# -- mapping files -----------------------------------------------------------------------


def role_of(channel: Input | Output) -> str:
    """Role of a channel of a problem, by its name or what it is called; empty where none is known.

    Examples
    --------
    >>> role_of(Output("yaw_rate", "rad/s")), role_of(Input("delta", "rad"))
    ('r', 'rudder')
    """
    name = channel.name if channel.name in TABLE["roles"] else ""
    found = name or meaning(channel.name)[0] or meaning(channel.label or "")[0]
    fits = found in TABLE["roles"] and converts(TABLE["roles"][found][0], channel.unit)
    return found if fits else ""


def draft(
    log: Log,
    channels: Channels | None = None,
    *,
    problem: str = "",
    found: Recognised | None = None,
) -> LogMapping | None:
    """Guess a mapping from the numbers of a log, to be confirmed by a person.

    Parameters
    ----------
    log : Log
        The log.
    channels : Channels, optional
        What is wanted; by default all that was recognised.
    problem : str
        Name of the problem, to be written into the mapping.
    found : Recognised, optional
        What :func:`recognise` said of the log.

    Returns
    -------
    LogMapping or None
        None where no output is found; inputs that are not found are constant zeros.

    Examples
    --------
    >>> from pathlib import Path
    >>> from oed_sysid.data.log import assemble
    >>> t = np.arange(0.0, 400.0, 0.5)
    >>> heading = (20.0 + 150.0 * np.sin(0.02 * t)) % 360.0
    >>> log = assemble(Path("a.csv"), "", {"a": (t, {"cap": heading})})
    >>> draft(log).outputs["psi"].unit
    'deg'
    """
    found = found or recognise(log)
    sources = {one.role: source_of(one) for one in found.guesses}
    if channels is None:
        inputs, outputs = (
            {role: sources[role] for role in roles if role in sources}
            for roles in (COMMANDS, MOTION)
        )
    else:
        inputs, outputs = _of_channels(channels, log, sources)
    told = log.clock_unit or "s"
    time_unit = "" if found.time_unit == told else found.time_unit
    return LogMapping(inputs, outputs, problem=problem, time_unit=time_unit) if outputs else None


def _of_channels(
    channels: Channels, log: Log, sources: Mapping[str, Source]
) -> tuple[dict[str, Source], dict[str, Source]]:
    """Sources of a problem's inputs, constant where there is none, and of its outputs."""
    taken = {c.name: _wanted(c, log, sources) for c in channels.all}
    outputs = {c.name: s for c in channels.outputs if (s := taken[c.name]) is not None}
    inputs = {
        c.name: taken[c.name] or Source(constant=0.0, unit=c.unit or "1") for c in channels.inputs
    }
    return inputs, outputs


def source_of(one: Guess) -> Source:
    """Where a channel of a guess's role comes from."""
    return Source(one.field, unit=one.unit, sign=one.sign, wrap=one.wrap, trim=one.trim)


def _wanted(channel: Input | Output, log: Log, sources: Mapping[str, Source]) -> Source | None:
    """Where a channel comes from: a field of its name, or the one of its role."""
    for one in log.series:
        last = parse_header(one.name.rpartition(".")[2])[0]
        if last in (channel.name, channel.column) and one.unit and converts(one.unit, channel.unit):
            same = [s for s in sources.values() if s.field == one.name]
            wraps = channel.unit == "rad" and channel.name in ("psi", "phi")
            return same[0] if same else Source(one.name, unit=one.unit, wrap=wraps)
    return sources.get(role_of(channel))
