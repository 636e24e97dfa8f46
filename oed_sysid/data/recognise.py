r"""What the fields of a log are, from their numbers: role, unit, sign, wrap, and the unit of time.

Whatever the forces are, the motion of a rigid body obeys (Fossen 2021, Handbook of Marine Craft,
eqs. 2.26 and 2.38, at small roll)

.. math::
    \psi(t) - \psi(0) = \int r, \qquad \phi: \int p, \qquad \theta: \int q, \qquad
    x + i y = \int (u + i v)\, e^{i\psi}, \qquad z = \int (w\cos\theta - u\sin\theta) .

What one field explains of another, and in which units, is :mod:`~oed_sysid.data.fields`. The sign
of a slope is the product of two signs. Positions are regressed on :math:`\int u\cos\psi` and
:math:`\int u\sin\psi`: the size of the two slopes is a ratio of units, their direction says which
axis it is and how a heading counts. Jumps by a turn give the unit of an angle by themselves.

What has less than :data:`~oed_sysid.data.fields.SURE` of the sum of its alternatives is a doubt, to
be asked. Mirrored axes, all of them at once, obey the same equations: there only conventions and
names tell, and where they are weak it is asked.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import permutations, product
from typing import Any

import numpy as np

from oed_sysid.data.csv_columns import TIMES, odds_of_clock
from oed_sysid.data.fields import (
    COMMANDS,
    MOTION,
    NAMED,
    NOTHING,
    SPURIOUS,
    SURE,
    USUAL,
    Field,
    Fields,
    Reading,
    alone,
    certain,
    chances,
    explained,
    factor,
    hint_of,
    likeliest,
    line,
    match,
)
from oed_sysid.data.log import TABLE, Log, Series, groups_of, meaning, side_of
from oed_sysid.data.mapping import LogMapping, Source
from oed_sysid.data.record import TURN, unwrapped
from oed_sysid.errors import DataError
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.runtime.display import align, as_dict
from oed_sysid.text.units import converts, is_unit, parse_header, shown_unit, to_si

RATES = {"psi": "r", "phi": "p", "theta": "q"}
_HEADS = ("field", "is", "as logged", "as read", "because", "please confirm")


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
    channel : str
        Name under which it is written; empty where that is its role.

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
    channel: str = ""

    to_dict = as_dict(
        "role", "field", "unit", "sign", "wrap", "trim", "doubts", "why", channel="name"
    )

    @property
    def name(self) -> str:
        """Name under which it is written: of a channel, or its role."""
        return self.channel or self.role

    def asked(self, *doubts: str) -> Guess:
        """The guess with more to be asked."""
        return replace(self, doubts=tuple(dict.fromkeys((*self.doubts, *doubts))))


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

    def rows(self, log: Log) -> list[dict[str, str]]:
        """Each guess with its range as logged and as read, what is to be confirmed first."""
        told = [
            (one.field, "-" * (one.sign < 0) + one.name, _reach(log[one.field].values, one.unit),
             _reach(*_read(one, log)), one.why, ", ".join(one.doubts))
            for one in sorted(self.guesses, key=lambda one: not one.doubts)
        ]  # fmt: skip
        told += [
            (one.name, "", _reach(one.values, one.unit or ""), "not read", _unread(one, log), "")
            for one in log.series
            if one.name not in {guess.field for guess in self.guesses}
        ]
        return [dict(zip(_HEADS, row, strict=True)) for row in told]

    def table(self, log: Log) -> str:
        """The rows as text, before and after."""
        rows = self.rows(log)
        cells = [tuple(rows[0]), *(tuple(row.values()) for row in rows)] if rows else []
        return "\n".join(align(cells, left=range(6)))

    to_dict = as_dict("time_unit", "doubts", "guesses")


def _unread(one: Series, log: Log) -> str:
    """Why a field was not recognised."""
    if log.clock and one.name.endswith(f".{log.clock}"):
        return "it is the clock"
    good = one.values[np.isfinite(one.values)]
    if good.size < 5:
        return f"it has {good.size} numbers"
    why = TABLE["unmeasured"].get(hint_of(one)[0], "neither name nor numbers tell it")
    return why if np.ptp(good) > 0.0 else "it never moves"


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
    >>> for one in recognise(log).guesses:
    ...     print(one.role, one.sign, one.field, one.unit, one.why, sep="; ")
    psi; 1; a.cap; deg; it jumps by a turn of 360 deg, and is the integral of a.ch1
    r; -1; a.ch1; deg/min; it is the rate of a.cap
    """
    units = TIMES if log.clock_unit is None else (log.clock_unit,)
    works = [_Work(log, unit) for unit in units]
    best = max(works, key=lambda one: one.score)
    chance = chances([one.score for one in works])[works.index(best)]
    found = best.result(("unit",) * bool(chance < SURE))
    held = (one for one in _held(log) if found.get(one.role) is None)
    return replace(found, guesses=(*_told_apart([*found.guesses, *held]),))


def _told_apart(guesses: Sequence[Guess]) -> Iterator[Guess]:
    """Commands of which there are several, such as two propellers, under their fields' own names.

    Two of a kind, or one that was wanted and one that was measured: it is asked.
    """
    roles = Counter(one.role for one in guesses)
    short = {one.field: _identifier(one.field.partition(".")[2]) for one in guesses}
    for one in guesses:
        if roles[one.role] == 1:
            yield one
            continue
        own = short[one.field]
        same = [*short.values()].count(own) > 1 or roles[own] == 1
        yield replace(one, channel=_identifier(one.field) if same else own).asked("field")


def _identifier(field: str) -> str:
    """Name of a field as that of a channel.

    >>> _identifier("Drehzahl Bb [1/min]"), _identifier("IIRPM_2.speed")
    ('Drehzahl_Bb', 'IIRPM_2_speed')
    """
    text = re.sub(r"\W+", "_", parse_header(field)[0]).strip("_")
    return text if text[:1].isalpha() else f"command_{text}"


def _held(log: Log) -> Iterator[Guess]:
    """Commands that stay at one value, as a trial holds its revolutions: a name and a unit tell."""
    for one in log.series:
        good = one.values[np.isfinite(one.values)]
        if not (one.unit and is_unit(one.unit) and good.size and np.ptp(good) == 0.0):
            continue
        if (role := meaning(one.name, one.unit)[0]) in COMMANDS:
            sign = _sided(role, one.name) or 1
            yield Guess(role, one.name, one.unit, sign, why="its name and unit; it never moves")


def _sided(role: str, name: str) -> int:
    """Sign of a role that counts to starboard, where the field's name says its side; else 0."""
    return side_of(name) if role in ("rudder", "r", "v", "y", "psi", "phi", "p") else 0


# -- the likeliest roles -----------------------------------------------------------------


@dataclass(frozen=True)
class _Angle:
    """A field as an angle, and the one that is its rate, if there is one."""

    angle: Reading = NOTHING
    rate: Reading = NOTHING

    @property
    def score(self) -> float:
        """Nats of both."""
        return self.angle.score + self.rate.score


@dataclass(frozen=True)
class _Plane:
    """Positions by heading and speed: indices, units, directions in rad against the heading."""

    speed: int = -1
    speed_unit: str = ""
    axes: tuple[int, int] = (-1, -1)
    unit: str = ""
    directions: tuple[float, float] = (0.0, 0.0)
    score: float = 0.0
    doubts: tuple[str, ...] = ()  # about the speed
    scaled: bool = True  # whether the unit of the positions is sure
    told: float = 0.0  # nats of what the motion explains alone
    pace: float = 0.0  # positions' change for one of the speed


def _apart(row: Sequence[tuple[float, _Angle, _Plane | Reading]]) -> bool:
    """Whether no field is taken twice by angles, their rates and what they explain."""
    taken = list[int]()
    for _, one, more in row:
        theirs = [more.speed, *more.axes] if isinstance(more, _Plane) else [more.at]
        taken += [i for i in (one.angle.at, one.rate.at, *theirs) if i >= 0]
    return len(set(taken)) == len(taken)


class _Work:
    """One log read with one unit of time, and the likeliest roles of its fields.

    Attributes
    ----------
    score : float
        Nats of this unit of time.
    found : dict
        Guesses by role.
    at : dict
        Indices of their fields.
    """

    def __init__(self, log: Log, time_unit: str) -> None:
        self.time_unit, self.fields = time_unit, Fields(log, time_unit)
        self.found: dict[str, Guess] = {}
        self.at: dict[str, int] = {}
        # Asked again and again of the same fields.
        self.pairs, self.plane_of = cache(self._pairs), cache(self._plane_of)
        step = float(np.median(np.diff(self.fields.times)))
        self.score = odds_of_clock(time_unit, step)
        self._rotations()
        self._rest()

    def _named(self, index: int, role: str) -> float:
        """Nats that a field's name is worth for a role; nothing where there is no field."""
        return self.fields.every[index].named(role) if index >= 0 else 0.0

    def _pairs(self, role: str) -> list[_Angle]:
        """Angles with their rates, and angles without one, that may be of a role; best first."""
        found = [one for a in self.fields.open_to(role) for one in self._angles(a, role)]
        return sorted(found, key=lambda one: -one.score)

    def _angles(self, a: int, role: str) -> Iterator[_Angle]:
        """A field as an angle: without a rate, and with each that may be its rate."""
        fields, rate = self.fields, RATES[role]
        lines = {b: line(fields.sums[:, b], fields.free[:, a]) for b in fields.open_to(rate)}
        for unit, nats in fields.options(a, role).items():
            angle = Reading(nats, a, unit)
            yield _Angle(angle)
            for b, (share, slope) in lines.items():
                if a != b and share >= SPURIOUS:
                    rows = fields.readings(b, rate, share, slope * factor(unit))
                    yield from (_Angle(angle, row) for row in rows if row.fits > -4.0)

    # -- heading, yaw rate, speed and positions; attitudes --

    def _rotations(self) -> None:
        """Heading, pitch and roll with their rates, together.

        That a field is the rate of another says that they are an angle and a rate, and not of
        which axis: the three axes are told together.
        """
        rows = [
            (sum(score for score, _, _ in row), row)
            for row in product(*map(self._turning, RATES))
            if _apart(row)
        ]
        rows.sort(key=lambda one: -one[0])
        score, best = rows[0]
        self.score += score
        doubts = {
            # Whether another field could as well be the angle of this role.
            role: ("field",) * (not alone(score, (s for s, row in rows
                                                  if row[index][1].angle.at != one.angle.at)))
            for index, (role, (_, one, _)) in enumerate(zip(RATES, best, strict=True))
            if one.angle.at >= 0
        }  # fmt: skip
        (_, psi, plane), (_, phi, level), (_, theta, dive) = best
        if "psi" in doubts:
            self._senses(psi, plane, self._unit_doubts("psi", psi) + doubts["psi"])
        for role, angle, more in (("theta", theta, dive), ("phi", phi, level)):
            if role in doubts:
                self._attitude(role, angle, doubts[role], more)
        if plane.axes[0] >= 0:
            self._sway(plane)

    def _turning(self, role: str) -> list[tuple[float, _Angle, Any]]:
        """Angles of a role, what they explain, and nats of both; first that there is none."""
        nothing, least = (_Plane(), NAMED - 2.0) if role == "psi" else (NOTHING, 1.5 * USUAL)
        explains: Any = {"psi": self._plane, "theta": self._dive}.get(role, lambda one: nothing)
        rows = ((one, explains(one)) for one in self._some(role))
        found = [(one.score + more.score, one, more) for one, more in rows]
        return [(0.0, _Angle(), nothing), *(row for row in found if row[0] > least)]

    def _some(self, role: str) -> list[_Angle]:
        """The likeliest angles of a role, each with its likeliest rates and with none."""
        seen: Counter[tuple[int, bool]] = Counter()
        found = []
        for one in self.pairs(role):
            kind = one.angle.at, one.rate.at < 0
            seen[kind] += 1
            if seen[kind] <= 2:
                found.append(one)
        return found[:12]

    def _unit_doubts(self, role: str, angle: _Angle) -> tuple[str, ...]:
        """Whether other units explain as much."""
        where = angle.angle.at, angle.rate.at
        same = [one for one in self.pairs(role) if (one.angle.at, one.rate.at) == where]
        scores = [p.score + (self._plane(p).score if role == "psi" else 0.0) for p in same]
        return ("unit",) * bool(chances(scores)[same.index(angle)] < SURE)

    def _plane(self, angle: _Angle) -> _Plane:
        """Positions that an angle explains, with the speed that does it best."""
        return self.plane_of(angle.angle.at, angle.angle.unit, angle.rate.at)

    def _plane_of(self, angle: int, unit: str, rate: int) -> _Plane:
        fields, taken = self.fields, {angle, rate}
        psi = fields.columns[:, angle] * factor(unit)
        speeds = [i for i in fields.open_to("u") if i not in taken and fields.options(i, "u")]
        steady = self._along(psi, -1, taken)
        found = [self._along(psi, s, taken | {s}) for s in speeds]
        # What hardly changes explains as much as a steady speed does, whatever it is.
        better = [
            one
            for one in found
            if one.speed < 0 or self._named(one.speed, "u") > 0.0 or one.told > steady.told + NAMED
        ]
        return max([steady, *better], key=lambda one: one.score)

    def _along(self, psi: np.ndarray, speed: int, taken: set[int]) -> _Plane:
        """The two fields that are the positions of a motion along a heading, if there are two."""
        fields = self.fields
        size = fields.columns[:, speed] if speed >= 0 else np.ones_like(psi)
        turned = np.column_stack([size * np.cos(psi), size * np.sin(psi)])
        base = fields.summed(turned)
        slopes, *_ = np.linalg.lstsq(base, fields.free, rcond=1e-6)
        power = np.sum(fields.free**2, axis=0)
        left = np.sum((fields.free - base @ slopes) ** 2, axis=0)
        shares = 1.0 - left / np.maximum(power, 1e-300)
        axes = [
            i
            for i in np.argsort(-shares)[:8].tolist()
            if i not in taken and shares[i] > SPURIOUS and fields.options(i, "x")
        ]
        rows = [self._axes(speed, pair, slopes, shares) for pair in permutations(axes[:5], 2)]
        found = max((row for row in rows if row), key=lambda one: one.score, default=None)
        # One axis alone moves with the heading too, but does not say which it is.
        named = [explained(float(shares[i])) for i in axes if fields.every[i].hint in ("x", "y")]
        return found or _Plane(score=max(named, default=0.0))

    def _axes(
        self, speed: int, pair: tuple[int, int], slopes: np.ndarray, shares: np.ndarray
    ) -> _Plane | None:
        """Two fields as axes of the plane, in the units that fit best; None if they are not."""
        one, other = pair
        ways = tuple(float(np.arctan2(slopes[1, i], slopes[0, i])) for i in pair)
        size = float(np.sqrt(np.prod([np.hypot(*slopes[:, i]) for i in pair])))
        if one > other or abs(np.cos(ways[0] - ways[1])) > 0.2 or size <= 0.0:
            return None
        told = sum(explained(float(shares[i])) for i in pair)
        rows = list(self._units(speed, pair, size, told))
        if not rows or max(rows)[0] <= 0.0:
            return None
        score, unit, by, fits = max(rows)
        odds = chances([row[0] for row in rows])

        def sure_of(column: int, value: str) -> bool:
            same = (c for c, row in zip(odds, rows, strict=True) if row[column] == value)
            return bool(sum(same) > SURE)

        share = float(min(shares[i] for i in pair))
        sure = bool(by) and certain(share, fits, self._named(speed, "u"))
        doubts = ("unit",) * (not sure_of(2, by)) + ("field",) * (not sure)
        # Any field that hardly changes does for a speed; only a sure one gives the unit of the way.
        score -= USUAL * (not sure and bool(by))
        scaled = bool(self.fields.every[one].stated) or (sure and sure_of(1, unit))
        return _Plane(speed, by, pair, unit, (ways[0], ways[1]), score, doubts, scaled, told, size)

    def _units(
        self, speed: int, pair: tuple[int, int], size: float, told: float
    ) -> Iterator[tuple[float, str, str, float]]:
        """Nats by unit of the positions and of the speed, and what the size of the slope adds."""
        options = self.fields.options
        theirs = options(speed, "u") if speed >= 0 else {"": 0.0}
        ahead, abeam = options(pair[0], "x"), options(pair[1], "y")
        for unit, by in product((one for one in ahead if one in abeam), theirs):
            # Without a speed any size of the slope will do, and anything may drive the motion.
            fits = match(size, factor(by) / factor(unit)) if by else 0.0
            yield told + ahead[unit] + abeam[unit] + theirs[by] + fits, unit, by, fits

    def _senses(self, angle: _Angle, plane: _Plane, doubts: tuple[str, ...]) -> None:
        """Which way a heading counts, which axis is north, and the signs that follow."""
        psi, rate = angle.angle, angle.rate
        one = self.fields.every[psi.at]
        rows = list(self._worlds(angle, plane))
        if not rows:  # axes that stand askew to the heading
            plane = _Plane()
            rows = list(self._worlds(angle, plane))
        odds = chances([score for score, _ in rows])
        best = rows[int(np.argmax(odds))][1]

        def unsure(*keys: str) -> tuple[str, ...]:
            """A doubt of the sign where worlds that agree in this are not sure together."""
            same = [c for c, (_, row) in zip(odds, rows, strict=True)
                    if all(row.get(k) == best.get(k) for k in keys)]  # fmt: skip
            return ("sign",) * bool(sum(same) <= SURE)

        turn = 0.25 * TURN / factor(psi.unit)
        reach = float(np.ptp(one.values)) * factor(psi.unit)
        self._take(
            "psi", psi, -1 if best["sense"] else 1, (*doubts, *unsure("sense")),
            self._why(angle, plane), wrap=one.jumps > 0.0 or reach < TURN,
            trim=turn if best["sense"] == 2 else 0.0,
        )  # fmt: skip
        units = (*(d for d in doubts if d == "unit"), *("field",) * (not rate.sure))
        self._take("r", rate, best["r"], (*units, *unsure("r")), f"it is the rate of {one.name}")
        for role in "xy" if plane.axes[0] >= 0 else "":
            # Another world often means the other axis; the log of a sure one says its names.
            asked = ("unit",) * (not plane.scaled)
            asked += ("field", "sign") * bool(unsure(role, f"{role} sign"))
            found = Reading(0.0, best[role], plane.unit)
            self._take(role, found, best[f"{role} sign"], asked, f"it follows {one.name}")
        asked = (*plane.doubts, *unsure("u sign"))
        speed = Reading(0.0, plane.speed, plane.speed_unit)
        self._take("u", speed, best.get("u sign", 1), asked, "the positions move as fast")

    def _why(self, angle: _Angle, plane: _Plane) -> str:
        """What told a heading."""
        one, why = self.fields.every[angle.angle.at], []
        if one.jumps:
            why.append(f"it jumps by a turn of {'360 deg' if one.jumps > 7 else '2 pi rad'}")
        if angle.rate.at >= 0:
            why.append(f"is the integral of {self.fields.every[angle.rate.at].name}")
        if plane.axes[0] >= 0:
            why.append("is the direction in which the positions move")
        return ", and ".join(why) or "its name and size"

    def _worlds(self, angle: _Angle, plane: _Plane) -> Iterator[tuple[float, dict[str, int]]]:
        """Ways in which a heading may count (clockwise, back, from east), with their nats."""
        one, turning = self.fields.every[angle.angle.at], angle.rate.sign
        # A compass counts 0 to 360 clockwise; a yaw angle may be of east-north-up.
        is_compass = meaning(one.name)[0] == "psi" and "compass" in groups_of(one.name)
        compass = (one.jumps == 360.0 and one.low >= 0.0) + NAMED * is_compass
        for sense, nats in ((0, compass), (1, -3.0), (2, -1.5)):
            r = turning if sense == 0 else -turning
            # Of a compass the rate may be port positive; in east-north-up both count alike.
            base = nats - 2.0 * (sense == 0 and r < 0) - 3.0 * (sense == 2 and turning < 0)
            ground = self._ground(plane, sense) if plane.axes[0] >= 0 else [(0.0, {})]
            yield from ((base + score, {"sense": sense, "r": r} | row) for score, row in ground)

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
                score += 3.0 * su * float(np.sign(self.fields.columns[:, plane.speed].mean()))
            for (i, _), role, other, sign in zip(pair, "xy", "yx", signs, strict=True):
                named = self.fields.every[i]
                # What is called east does not count to the west.
                score += sign * named.weight if named.hint == role else 0.0
                score -= named.weight if named.hint == other else 0.0
            (x, _), (y, _) = pair
            yield score, {"x": x, "y": y, "x sign": signs[0], "y sign": signs[1], "u sign": su}

    def _take(
        self, role: str, one: Reading, sign: int, doubts: Sequence[str], why: str,
        *, wrap: bool = False, trim: float = 0.0,
    ) -> None:  # fmt: skip
        """Give a field, if there is one, a role."""
        if one.at >= 0:
            asked, name = tuple(dict.fromkeys(doubts)), self.fields.every[one.at].name
            # Of a motion there is one, of a command there may be several.
            key = name if role in COMMANDS else role
            self.at[key] = one.at
            self.found[key] = Guess(role, name, one.unit, sign, wrap, trim, asked, why)

    def series(self, role: str) -> np.ndarray | None:
        """A role that was found for certain, SI ``(n,)``."""
        one = self.found.get(role)
        if one is None or "field" in one.doubts:
            return None
        raw = self.fields.columns[:, self.at[role]] - one.trim
        return np.asarray(one.sign * to_si(raw, one.unit)[0])

    def _sway(self, plane: _Plane) -> None:
        """Speed abeam: what the positions show beside the speed ahead."""
        psi, u, x, y = (self.series(role) for role in ("psi", "u", "x", "y"))
        if psi is None or x is None or y is None:
            return
        if u is None:
            u = np.full_like(psi, plane.pace * factor(plane.unit))
        theta, summed = self.series("theta"), self.fields.summed
        u = u if theta is None else u * np.cos(theta)
        ahead = np.concatenate([summed(u * np.cos(psi)), summed(u * np.sin(psi))])
        moved = np.concatenate([*map(self.fields.detrended, (x, y))])

        def abeam(v: np.ndarray) -> np.ndarray:
            return np.concatenate([summed(-v * np.sin(psi)), summed(v * np.cos(psi))])

        self._explain("v", moved, ahead, abeam, "the positions drift with it")

    def _explain(
        self, role: str, target: np.ndarray, base: np.ndarray,
        moves: Callable[[np.ndarray], np.ndarray], why: str,
    ) -> None:  # fmt: skip
        """Take for a role the field that explains best what is left of a motion, if any is good.

        ``moves`` makes of a field's values the motion that they would add to that of ``base``.
        """
        rows = self._same_units(role, [
            row
            for i in self.fields.open_to(role)
            if i not in self.at.values()
            for row in self._added(i, role, target, base, moves(self.fields.columns[:, i]))
        ])  # fmt: skip
        if not rows or max(rows).score < NAMED:
            return
        best = likeliest(rows)
        sole = alone(best.score, (row.score for row in rows if row.at != best.at))
        doubts = (*best.doubts, *("field",) * (not sole))
        # Sway counts with the heading, heave with the pitch.
        leading = self.found.get({"v": "psi", "w": "theta"}.get(role, ""))
        doubts += ("sign",) * (role in "vw" and (leading is None or "sign" in leading.doubts))
        # What explains a motion in a unit that is in doubt is itself in doubt.
        bases = (self.found.get(one) for one in {"v": "uxy", "w": "uz"}.get(role, ""))
        doubts += ("unit",) * any(one is not None and "unit" in one.doubts for one in bases)
        self._take(role, best, best.sign, doubts, why)

    def _added(
        self, i: int, role: str, target: np.ndarray, base: np.ndarray, column: np.ndarray
    ) -> Iterator[Reading]:
        """What a field explains of what ``base`` leaves of a motion, by unit."""
        both = np.column_stack([base, column])
        left = target - base * line(base, target)[1]
        solution = np.linalg.lstsq(both, target, rcond=1e-9)[0]
        rest, slope = target - both @ solution, float(solution[-1])
        share = 1.0 - float(rest @ rest) / max(float(left @ left), 1e-300)
        if share > 0.3:  # a small part of the motion is known less well than the whole
            yield from self.fields.readings(i, role, share, slope, 0.15)

    # -- pitch, roll, depth --

    def _attitude(self, role: str, one: _Angle, doubts: tuple[str, ...], dive: Reading) -> None:
        """Take an angle and its rate, and with a pitch the depth."""
        doubts = (*doubts, *self._unit_doubts(role, one))
        if dive.at >= 0:
            again = self._dive(one, self.series("u"), (dive.at,))
            dive = again if again.at >= 0 else dive
        worlds = list(self._ways(role, one, dive))
        scores = [w[0] for w in worlds]
        unsure = ("sign",) * bool(max(chances(scores)) < SURE)
        _, angle, turning, z = max(worlds)
        if self._named(one.angle.at, role) <= 0.0:  # which axis, no equation tells for sure
            doubts = (*doubts, "field")
        called, told = self.fields.every[one.angle.at].name, "its name and size"
        if one.rate.at >= 0:
            told = f"it is the integral of {self.fields.every[one.rate.at].name}"
        asked = (*doubts, *unsure, *("field",) * (not one.rate.sure))
        self._take(RATES[role], one.rate, turning, asked, f"it is the rate of {called}")
        self._take(role, one.angle, angle, (*doubts, *unsure), told)
        self._take("z", dive, z, (*dive.doubts, *unsure), f"it changes with {called}")

    def _ways(self, role: str, one: _Angle, dive: Reading) -> Iterator[tuple[float, int, int, int]]:
        """Signs of an angle, of its rate and of the depth that agree with each other: nats, signs.

        Where the heading is that of east-north-up, the body's axes are forward-left-up as a rule.
        """
        left_up = self.flu if role == "theta" else 0.0
        for angle in (1, -1):
            turning = angle * one.rate.sign if one.rate.at >= 0 else 1
            score = (-3.0 if angle < 0 else 0.0) + left_up * (-angle)
            score -= 2.5 * (turning * angle < 0)
            z = -dive.sign * angle
            if dive.at >= 0:
                score += self._depth(self.fields.every[dive.at], z)
            yield score, angle, turning, z

    def _depth(self, one: Field, z: int) -> float:
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
    ) -> Reading:
        """The depth that a pitch explains, if there is one."""
        fields = self.fields
        angle = fields.columns[:, theta.angle.at] * factor(theta.angle.unit)
        column = fields.summed((1.0 if u is None else u) * np.sin(angle))
        rows = list[Reading]()
        for i in fields.open_to("z") if among is None else among:
            share, slope = line(column, fields.free[:, i])
            if i not in (theta.angle.at, theta.rate.at) and share >= SPURIOUS:
                # What the heave adds is not asked: ten per cent of the speed.
                error = None if u is None else 0.1
                rows += fields.readings(i, "z", share, 1.0 / slope, error)
        return likeliest(rows) if rows else NOTHING

    # -- what has a name only --

    def _rest(self) -> None:
        """Roles that nothing but name, unit and size tells; commands."""
        self._heave()
        for angle in RATES:
            if angle not in self.found:
                self._by_name(angle, range(len(self.fields.every)))
            if angle in self.found and RATES[angle] not in self.found:
                self._euler(angle)
        for role in MOTION:
            if role not in self.found:
                self._by_name(role, range(len(self.fields.every)))
        for i, one in enumerate(self.fields.every):
            if one.hint in COMMANDS:
                self._by_name(one.hint, [i])

    def _heave(self) -> None:
        """A velocity with which the depth changes, beside speed and pitch."""
        theta, u, z = (self.series(role) for role in ("theta", "u", "z"))
        if theta is not None and u is not None and z is not None:
            summed, heaved = self.fields.summed, np.cos(theta)
            self._explain(
                "w", self.fields.detrended(z), summed(-u * np.sin(theta)),
                lambda w: summed(w * heaved), "the depth changes with it",
            )  # fmt: skip

    def _euler(self, angle: str) -> None:
        """A rate that is one of an angle with the other angles and rates taken into account."""
        target, summed = self.series(angle), self.fields.summed
        if target is None:
            return
        zero = np.zeros_like(target)
        theirs = (self.series(n) for n in ("phi", "theta", "q", "r"))
        phi, theta, q, r = (zero if one is None else one for one in theirs)
        turning = q * np.sin(phi) + r * np.cos(phi)
        others, size = {
            "phi": (turning * np.tan(theta), np.ones_like(phi)),
            "theta": (-r * np.sin(phi), np.cos(phi)),
            "psi": (q * np.sin(phi) / np.cos(theta), np.cos(phi) / np.cos(theta)),
        }[angle]
        left = self.fields.detrended(target) - summed(others)
        role, said = RATES[angle], f"it is the rate of {self.found[angle].field}"
        self._explain(role, left, zero, lambda rate: summed(rate * size), said)
        # Through the other angles their doubtful signs are its own.
        leading = (one for one in self.found.values() if one.role in (*RATES, "q", "r"))
        if role in self.found and any("sign" in one.doubts for one in leading):
            self.found[role] = self.found[role].asked("sign")

    def _by_name(self, role: str, among: Iterable[int]) -> None:
        """Take the field that is called so."""
        rows = [
            Reading(nats, i, unit)
            for i in among
            if i not in self.at.values() and self.fields.every[i].hint == role
            for unit, nats in self.fields.options(i, role).items()
        ]
        if not rows:
            return
        best = likeliest(self._same_units(role, rows))
        doubts = (*best.doubts, *("field",) * (len({row.at for row in rows}) > 1))
        # Forward, down and clockwise are usual; of other axes a name does not tell the direction.
        name = self.fields.every[best.at].name
        told = _sided(role, name)
        doubts += ("sign",) * (role in ("v", "w", "p", "q", "r", "y") and not told)
        sign = told or (-1 if role == "z" and _is_up(name) else 1)
        why = f"its name and size{', and that it counts to port' * (told < 0)}"
        self._take(role, best, sign, doubts, why)

    def _same_units(self, role: str, rows: Sequence[Reading]) -> list[Reading]:
        """A logger mostly writes quantities of one kind in one unit."""
        needed = TABLE["roles"][role][0]
        known = {
            one.unit
            for one in self.found.values()
            if TABLE["roles"][one.role][0] == needed and not {"unit", "field"} & {*one.doubts}
        }
        return [row._replace(score=row.score + 1.5 * (row.unit in known)) for row in rows]

    def result(self, doubts: tuple[str, ...] = ()) -> Recognised:
        """The guesses, in the usual order of symbols."""
        order = (*MOTION, *COMMANDS)
        found = tuple(sorted(self.found.values(), key=lambda one: order.index(one.role)))
        if doubts:  # a rate is known as well as the clock is
            rates = [one for one in found if one.role in RATES.values() and "rate" in one.why]
            found = tuple(one.asked("unit") if one in rates else one for one in found)
        return Recognised(found, self.time_unit, doubts)


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
    texts = filter(None, (channel.name, channel.label))
    found = name or next(filter(None, (meaning(text, channel.unit)[0] for text in texts)), "")
    fits = found in TABLE["roles"] and converts(TABLE["roles"][found][0], channel.unit)
    return found if fits else ""


def called(found: Recognised, channels: Channels, log: Log) -> Recognised:
    """Say what fields are in the words of a problem's channels.

    A channel is the field of its name, or the one of its role where no other channel has that
    role. A field of its name without a unit is asked for it, and never passed over.

    Parameters
    ----------
    found : Recognised
        What :func:`recognise` said of the log.
    channels : Channels
        Those of the problem.
    log : Log
        The log.
    """
    roles = Counter(map(role_of, channels.all))
    each = [_meant(one, found, log, roles[role_of(one)] == 1) for one in channels.all]
    wanted = [one for one in each if one is not None]
    used = {one.field for one in wanted}
    return replace(found, guesses=(*wanted, *(o for o in found.guesses if o.field not in used)))


def _meant(channel: Input | Output, found: Recognised, log: Log, sole: bool) -> Guess | None:
    """The field that is meant by a channel, if there is one."""
    role = role_of(channel) if sole else ""
    by_role = [one for one in found.guesses if one.role == role]
    named = [_named(one, channel, found) for one in log.series if _is_called(one, channel)]
    told = [one for one in named if log[one.field].unit and converts(one.unit, channel.unit)]
    best = next(iter((*told, *by_role, *named)), None)
    return best and replace(best, channel=channel.name)


def _is_called(one: Series, channel: Input | Output) -> bool:
    """Whether a field has the name of a channel, and may be a measurement of it if that is one."""
    if parse_header(one.name.rpartition(".")[2])[0] not in (channel.name, channel.column):
        return False
    if isinstance(channel, Input):  # asked for a factor where it is in another unit
        return True
    fits = not one.unit or converts(one.unit, channel.unit)
    return fits and hint_of(one)[0] not in TABLE["unmeasured"]


def _named(one: Series, channel: Input | Output, found: Recognised) -> Guess:
    """A field that has the name of a channel; its unit is asked where nobody says it."""
    known = [g for g in found.guesses if g.field == one.name and converts(g.unit, channel.unit)]
    if known:
        return replace(known[0], doubts=tuple(d for d in known[0].doubts if d != "field"))
    wraps = channel.unit == "rad" and channel.name in ("psi", "phi")
    why, asked = "it has the name of the channel", ("unit",) * (not one.unit)
    unit = one.unit or channel.unit
    return Guess(role_of(channel), one.name, unit, wrap=wraps, doubts=asked, why=why)


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
        None where no output is found. Inputs that are not found are left out, to be named.

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
    if channels is None:
        inputs, outputs = (
            {one.name: source_of(one) for one in found.guesses if one.role in roles}
            for roles in (COMMANDS, MOTION)
        )
    else:
        sources = {o.channel: source_of(o) for o in called(found, channels, log).guesses}
        inputs, outputs = (
            {name: sources[name] for name in names if name in sources}
            for names in (channels.input_names, channels.output_names)
        )
    told = log.clock_unit or "s"
    time_unit = "" if found.time_unit == told else found.time_unit
    return LogMapping(inputs, outputs, problem=problem, time_unit=time_unit) if outputs else None


def source_of(one: Guess) -> Source:
    """Where a channel of a guess's role comes from."""
    return Source(one.field, unit=one.unit, sign=one.sign, wrap=one.wrap, trim=one.trim)
