r"""A vehicle's log as it was written: topics, each with its own times.

Units and symbols of fields that logs do not spell out but their formats define.

Sources: PX4 message definitions (``msg/*.msg``, comments in SI, NED and FRD frames), ROS REP 103
(SI units everywhere), and suffixes that loggers put into names.

One field of a log, with times of its own.

Fields that follow from others of the same topic: Euler angles, positions in metres.

A unit quaternion :math:`e_0, e_1, e_2, e_3` from body to earth axes gives (Diebel 2006, eq. 290)

.. math::
    \phi   = \operatorname{atan2}(2(e_2 e_3 + e_0 e_1),\; e_0^2 - e_1^2 - e_2^2 + e_3^2), \quad
    \theta = \arcsin(2(e_0 e_2 - e_1 e_3)), \quad
    \psi   = \operatorname{atan2}(2(e_1 e_2 + e_0 e_3),\; e_0^2 + e_1^2 - e_2^2 - e_3^2).

PX4 and ArduPilot give it for body axes forward-right-down in north-east-down. ROS (REP 103)
gives it for forward-left-up in east-north-up; in NED the same attitude has

.. math:: \phi_N = \phi, \qquad \theta_N = -\theta, \qquad \psi_N = \pi/2 - \psi .

Latitude and longitude become north and east of the first fix with the radii of curvature of the
ellipsoid WGS 84 there,

.. math:: R_M = a(1-e^2)/(1-e^2\sin^2\varphi)^{3/2}, \qquad R_N = a/\sqrt{1-e^2\sin^2\varphi},

good to 1e-4 of the distance within 10 km below 60 degrees of latitude.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.record import on_circle
from oed_sysid.errors import DataError, closest
from oed_sysid.runtime.display import align
from oed_sysid.runtime.tables import tables
from oed_sysid.text.units import converts, is_unit, parse_header, to_si

# -- units and symbols of fields that logs do not spell out but their formats define ---


TABLE = tables(__file__, "fields")
_KNOWN = tuple((re.compile(pattern), unit, symbol) for pattern, unit, symbol in TABLE["known"])


def unit_of(name: str) -> str | None:
    """Unit of a field, from what its format defines or from its name; None if neither says.

    Parameters
    ----------
    name : str
        ``topic.field``.

    Examples
    --------
    >>> unit_of("vehicle_angular_velocity.xyz[2]"), unit_of("airspeed.true_airspeed_m_s")
    ('rad/s', 'm/s')
    >>> unit_of("imu.orientation.w"), unit_of("sheet.rudder [deg]"), unit_of("status.mode")
    ('1', 'deg', None)
    """
    for pattern, unit, _ in _KNOWN:
        if unit and pattern.fullmatch(name):
            return unit
    bare = re.sub(r"\[\d+\]$", "", name)
    for ending, unit in TABLE["endings"]:
        if bare.endswith(ending):
            return unit
    header = name.rpartition(".")[2] if "[" not in name else name.split(".", 1)[-1]
    if re.search(r"\[\d*\]$", header):
        return None
    unit = parse_header(header)[1] or ""
    return unit if is_unit(unit) else None


def symbol_of(name: str, *, by_name: bool = True) -> str:
    """SNAME symbol of a field, empty if it has none that is known.

    Parameters
    ----------
    name : str
        ``topic.field``.
    by_name : bool
        Whether its words count, or only what its format defines.

    Examples
    --------
    >>> symbol_of("vehicle_attitude.yaw"), symbol_of("boat.heading"), symbol_of("cpu.load")
    ('psi', 'psi', '')
    """
    for pattern, _, symbol in _KNOWN:
        if symbol and pattern.fullmatch(name):
            return symbol
    field = parse_header(name.rpartition(".")[2])[0]
    if field in TABLE["roles"]:
        return field
    return meaning(name)[0] if by_name else ""


@cache
def meaning(name: str, unit: str = "") -> tuple[str, int]:
    """Role that the words of a name mean, in any of several languages, and how many letters say so.

    Parameters
    ----------
    name : str
        ``topic.field``, with or without a unit.
    unit : str
        Its unit, where that is known: what cannot have it is not meant.

    Examples
    --------
    >>> meaning("log.Gierrate [grad/s]"), meaning("run.vitesse de lacet"), meaning("ch7")
    (('r', 8), ('r', 12), ('', 0))
    >>> meaning("log.Kreisel", "deg"), meaning("log.Kreisel", "deg/s")
    (('psi', 7), ('r', 7))
    """
    said = groups_of(name)
    found = ("", 0)
    for role, forms in TABLE["meanings"].items():
        needed = TABLE["roles"].get(role, ("",))[0]
        if unit and needed and not converts(needed, unit):
            continue
        for form in forms:
            letters = sum(said.get(group, -99) for group in form.split())
            found = (role, letters) if letters > found[1] else found
    return found


@cache
def groups_of(name: str) -> Mapping[str, int]:
    """Groups of words that a name holds one of, and the letters of that word."""
    field = parse_header(name.rpartition(".")[2] if "[" not in name else name.split(".", 1)[-1])[0]
    plain = unicodedata.normalize("NFKD", field)
    plain = "".join(letter for letter in plain if not unicodedata.combining(letter))
    plain = re.sub(r"([a-z])([A-Z])", r"\1 \2", plain).lower()
    tokens = re.findall(r"[a-z]+", plain)
    said = {}
    for group, words in TABLE["groups"].items():
        letters = max((_letters(word, token) for word in words for token in tokens), default=0)
        if letters:
            said[group] = letters
    return said


def side_of(name: str) -> int:
    """Whether a name says that it counts to starboard (1), or to port (-1); 0 where it does not.

    >>> side_of("run.Ruderlage Bb+ [deg]"), side_of("rudder (+ = stbd)"), side_of("port rudder")
    (-1, 1, 0)
    """
    for sign, words in ((-1, TABLE["sides"]["port"]), (1, TABLE["sides"]["starboard"])):
        any_of = "|".join(words)
        told = rf"\b(?:{any_of})\.?\s*(?P<after>[+-])(?!\w)|(?P<before>[+-])\s*=?\s*(?:{any_of})\b"
        if (found := re.search(told, name.lower())) is not None:
            return sign if "+" in (found["after"], found["before"]) else -sign
    return 0


def _letters(word: str, token: str) -> int:
    """Letters of a word that a token holds: as its beginning, anywhere if long, or as a whole."""
    if word.endswith("$"):
        return len(word) - 1 if token == word[:-1] else 0
    return len(word) if (word in token if len(word) > 3 else token.startswith(word)) else 0


# -- one field of a log ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Series:
    """One field of one topic.

    Parameters
    ----------
    name : str
        ``topic.field``, as mapping files name it.
    times : numpy.ndarray
        Shape ``(n_samples,)``, in s since the log's origin, in the order of the log.
    values : numpy.ndarray
        Shape ``(n_samples,)``, in ``unit``.
    unit : str or None
        Unit, where the log or its format says so; else None.
    derived : str
        What it was calculated from, empty where it stands in the log.

    Examples
    --------
    >>> series = Series("gyro.z", np.arange(11) * 0.1, np.zeros(11), "rad/s")
    >>> print(round(series.rate, 6), series.span)
    10.0 (0.0, 1.0)
    """

    name: str
    times: np.ndarray = field(repr=False)
    values: np.ndarray = field(repr=False)
    unit: str | None = None
    derived: str = ""

    @property
    def step(self) -> float:
        """Median time from one sample to the next, s; infinite with a single sample."""
        steps = np.diff(self.times)
        steps = steps[steps > 0.0]
        return float(np.median(steps)) if steps.size else np.inf

    @property
    def rate(self) -> float:
        """Samples per second: the inverse of the median step; NaN with a single sample."""
        return 1.0 / self.step if np.isfinite(self.step) else np.nan

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, in s."""
        return float(np.min(self.times)), float(np.max(self.times))


# -- fields that follow from others of the same topic ----------------------------------


_ROS = ("orientation.w", "orientation.x", "orientation.y", "orientation.z")
_AXIS, _FLATTENING = 6378137.0, 1.0 / 298.257223563  # WGS 84, NIMA TR8350.2


def euler_angles(quaternion: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Roll, pitch and yaw of quaternions.

    Parameters
    ----------
    quaternion : numpy.ndarray
        Shape ``(n_samples, 4)``, scalar part first; normalised here.

    Returns
    -------
    roll, pitch, yaw : numpy.ndarray
        Shape ``(n_samples,)``, rad; NaN where the quaternion is zero or not finite.

    Examples
    --------
    >>> half = np.radians(40.0) / 2
    >>> roll, pitch, yaw = euler_angles(np.array([[np.cos(half), 0.0, 0.0, np.sin(half)]]))
    >>> print(np.degrees([roll[0], pitch[0], yaw[0]]).round(9))
    [ 0.  0. 40.]
    """
    length = np.sqrt(np.sum(np.square(quaternion), axis=1, keepdims=True))
    with np.errstate(invalid="ignore", divide="ignore"):
        w, x, y, z = np.where(length > 1e-6, quaternion / length, np.nan).T
    roll = np.arctan2(2 * (y * z + w * x), w * w - x * x - y * y + z * z)
    pitch = np.arcsin(np.clip(2 * (w * y - x * z), -1.0, 1.0))
    yaw = np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)
    return roll, pitch, yaw


def local_position(latitude: np.ndarray, longitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """North and east of the first fix.

    Parameters
    ----------
    latitude, longitude : numpy.ndarray
        Shape ``(n_samples,)``, degrees; NaN where there is no fix.

    Returns
    -------
    north, east : numpy.ndarray
        Shape ``(n_samples,)``, m.

    Examples
    --------
    >>> north, east = local_position(np.array([54.0, 54.001]), np.array([10.0, 10.001]))
    >>> print(north[1].round(2), east[1].round(2))
    111.31 65.58
    """
    good = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))
    if not good.size:
        return np.full(latitude.shape, np.nan), np.full(latitude.shape, np.nan)
    first = good[0]
    phi = np.radians(latitude[first])
    squared = _FLATTENING * (2.0 - _FLATTENING)
    root = 1.0 - squared * np.sin(phi) ** 2
    north = np.radians(latitude - latitude[first]) * _AXIS * (1.0 - squared) / root**1.5
    turn = (longitude - longitude[first] + 180.0) % 360.0 - 180.0
    east = np.radians(turn) * _AXIS / np.sqrt(root) * np.cos(phi)
    return north, east


def derived(topic: str, fields: Mapping[str, Series]) -> Iterator[Series]:
    """Yield what follows from the fields of one topic.

    Parameters
    ----------
    topic : str
        Its name.
    fields : mapping
        Field name to series.
    """
    names = next((names for names in TABLE["quaternions"] if fields.keys() >= {*names}), None)
    if names is not None:
        yield from _attitude(topic, fields, names, "", f"from {names[0]} to {names[3]}")
    yield from _ros_attitude(topic, fields)
    fix = next((pair for pair in TABLE["fixes"] if fields.keys() >= {*pair}), None)
    if fix is not None:
        lat, lon = (fields[name] for name in fix)
        position = local_position(_degrees(lat), _degrees(lon))
        for name, values in zip(("north", "east"), position, strict=True):
            if name not in fields:
                yield Series(f"{topic}.{name}", lat.times, values, "m", "of the first fix")


def _ros_attitude(topic: str, fields: Mapping[str, Series]) -> Iterator[Series]:
    """Attitude from quaternions of ROS, as they are and in NED."""
    for prefix in {name[: -len(_ROS[0])] for name in fields if name.endswith(_ROS[0])}:
        parts = tuple(prefix + name for name in _ROS)
        if fields.keys() >= {*parts}:
            angles = [*_attitude(topic, fields, parts, f"{prefix}orientation.", "from quaternion")]
            yield from angles
            roll, pitch, yaw = (one.values for one in angles)
            turned = on_circle(np.pi / 2 - yaw)
            for one, values in zip(angles, (roll, -pitch, turned), strict=True):
                words = "NED, if the log is ENU and FLU"
                yield Series(f"{one.name}_ned", one.times, values, "rad", words)


def _attitude(
    topic: str, fields: Mapping[str, Series], names: Sequence[str], prefix: str, words: str
) -> Iterator[Series]:
    times = fields[names[0]].times
    angles = euler_angles(np.column_stack([fields[name].values for name in names]))
    for name, values in zip(("roll", "pitch", "yaw"), angles, strict=True):
        if prefix or name not in fields:
            yield Series(f"{topic}.{prefix}{name}", times, values, "rad", words)


def _degrees(series: Series) -> np.ndarray:
    """Degrees, NaN without a fix: receivers write zero, or values out of range."""
    values = series.values.astype(float)
    finite = values[np.isfinite(values)]
    if finite.size and np.abs(finite).max() > 400.0:
        values = values * 1e-7  # whole numbers of that many degrees
    return np.where((np.abs(values) > 1e-9) & (np.abs(values) <= 180.0), values, np.nan)


# -- a vehicle's log as it was written -------------------------------------------------


@dataclass(frozen=True, eq=False)
class Log:
    """All numeric fields of a log.

    Parameters
    ----------
    path : Path
        The file or folder.
    kind : str
        Words for its format.
    series : iterable of Series
        The fields; names are unique.
    origin : str
        What t = 0 is, in words.
    notes : tuple of str
        What the reader has to say: a torn end, drop-outs, a choice of clock.
    clock : str
        Header of the times, where a table was read.
    clock_unit : str or None
        Unit in which it counts; None where it was taken for seconds without being told.

    Raises
    ------
    DataError
        If there is no numeric field.

    Examples
    --------
    What :func:`~oed_sysid.data.formats.open_log` returns; see there.
    """

    path: Path
    kind: str
    series: tuple[Series, ...] = field(repr=False)
    origin: str = "the first sample of the log"
    notes: tuple[str, ...] = ()
    clock: str = ""
    clock_unit: str | None = "s"

    def __post_init__(self) -> None:
        object.__setattr__(self, "series", tuple(self.series))
        if not self.series:
            raise DataError(f"{self.path.name} ({self.kind}) holds no numbers over time.")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all fields."""
        return tuple(one.name for one in self.series)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the log, in s."""
        spans = [one.span for one in self.series]
        return min(first for first, _ in spans), max(last for _, last in spans)

    def as_here(self, name: str) -> str:
        """Name of a field in this log; empty where there is none.

        A table calls its fields after its file: the same column of another file is meant, too.

        Examples
        --------
        >>> run = {"run_2": (np.arange(2.0), {"psi [deg]": np.ones(2)})}
        >>> log = assemble(Path("run_2.csv"), "CSV file", run)
        >>> log.as_here("run_1.psi [deg]"), log.as_here("psi [deg]"), log.as_here("run_1.psi")
        ('run_2.psi [deg]', 'run_2.psi [deg]', '')
        """
        own = f"{self.path.stem}."
        if name in self.names or not all(known.startswith(own) for known in self.names):
            return name if name in self.names else ""
        fitting = (one for one in self.names if f".{name}".endswith(one[len(own) - 1 :]))
        return max(fitting, key=len, default="")

    def __getitem__(self, name: str) -> Series:
        here = self.as_here(name)
        for one in self.series:
            if one.name == here:
                return one
        inside = [known for known in self.names if name.lower() in known.lower()][:4]
        near = f" It has {', '.join(inside)}." if inside else closest(name, self.names)
        raise DataError(
            f"{self.path.name} has no field {name!r}.{near} All fields: oed-sysid import "
            f"{self.path.name} --list"
        )

    def timed(self, field: str = "", unit: str = "") -> Log:
        """The log with another clock.

        Parameters
        ----------
        field : str
            Field that holds the times of its topic and of all with as many samples; empty: the
            present ones.
        unit : str
            Unit in which they count; empty: as they are said to.

        Examples
        --------
        >>> topic = np.arange(3.0), {"ms": np.array([0.0, 500.0, 1000.0])}
        >>> log = assemble(Path("a"), "", {"run": topic})
        >>> log.timed("run.ms", "ms").span
        (0.0, 1.0)
        """
        if not field or (self.clock and field.endswith(f".{self.clock}")):
            return self._counting_in(unit) if unit else self
        clock = self[field]
        unit = unit or clock.unit or "s"
        times = to_si(clock.values, unit)[0]
        good = np.isfinite(times)
        times = times - np.nanmin(times)
        kept = tuple(
            replace(one, times=times[good], values=one.values[good])
            for one in self.series
            if one.values.size == times.size and good.any()
        )
        name = field.rpartition(".")[2]
        return replace(self, series=kept, clock=name, clock_unit=unit)

    def _counting_in(self, unit: str) -> Log:
        """The log with times that count in another unit than they were said to."""
        ratio = float(to_si(1.0, unit)[0]) / float(to_si(1.0, self.clock_unit or "s")[0])
        if ratio == 1.0:
            return self
        series = tuple(replace(one, times=one.times * ratio) for one in self.series)
        return replace(self, series=series, clock_unit=unit)

    def rows(self, text: str = "") -> list[tuple[str, ...]]:
        """Name, samples, rate, span, unit and range of every field whose name holds a text."""
        found: list[tuple[str, ...]] = []
        for one in (one for one in self.series if text.lower() in one.name.lower()):
            seen = np.isfinite(one.values)  # a cell that is empty is no sample
            good = one.values[seen]
            one = replace(one, times=one.times[seen], values=good) if good.size else one
            reach = f"{good.min():.5g} to {good.max():.5g}" if good.size else "no number"
            rate = f"{one.rate:.3g} Hz" if np.isfinite(one.rate) else "-"
            unit = (one.unit or "?") + (f" ({one.derived})" if one.derived else "")
            span = f"{one.span[0]:.2f} to {one.span[1]:.2f} s"
            found.append((one.name, str(good.size), rate, span, unit, reach))
        return found

    def describe(self, text: str = "") -> str:
        """Say what the log holds, one line per field.

        Parameters
        ----------
        text : str
            Only fields whose names hold this.
        """
        rows = [("field", "samples", "rate", "from - to", "unit", "range"), *self.rows(text)]
        first, last = self.span
        title = f"{self.path.name}: {self.kind}, {last - first:.1f} s; t = 0 is {self.origin}"
        return "\n".join([title, *align(rows, left=range(6)), *self.notes])


# Messages by topic: time in s and numbers by name.
Rows = dict[str, list[tuple[float, dict[str, float]]]]
Topics = Mapping[str, tuple[np.ndarray, Mapping[str, np.ndarray]]]


def until_torn(messages: Iterable[Any], path: Path, notes: list[str]) -> Iterator[Any]:
    """Messages up to where a damaged file makes its library fail, which is noted.

    Of a file that begins so nothing can be read: the library's own error is raised.
    """
    some = False
    try:
        for message in messages:
            yield message
            some = True
    except Exception as error:  # whatever a damaged file makes of the library
        if not some:
            raise
        notes.append(f"{path.name} breaks off ({str(error)[:80]}); what stands before is used.")


def topics_of(rows: Rows) -> Topics:
    """Times ``(n,)`` and fields ``(n,)`` of messages, NaN where one lacks a number."""
    topics = {}
    for topic, messages in rows.items():
        names = dict.fromkeys(name for _, numbers in messages for name in numbers)
        fields = {n: np.array([numbers.get(n, np.nan) for _, numbers in messages]) for n in names}
        if fields:
            topics[topic] = (np.array([time for time, _ in messages]), fields)
    return topics


def assemble(
    path: Path,
    kind: str,
    topics: Topics,
    *,
    units: Mapping[str, str] | None = None,
    origin: str | None = None,
    notes: Iterable[str] = (),
) -> Log:
    """Make a log of topics whose times count from anywhere.

    Parameters
    ----------
    path : Path
        Where it comes from.
    kind : str
        Words for its format.
    topics : mapping
        Topic to times ``(n,)`` in s and fields ``(n,)``.
    units : mapping of str to str, optional
        Units that the log states, by ``topic.field``.
    origin : str, optional
        Words for t = 0.
    notes : iterable of str
        What the reader has to say.

    Returns
    -------
    Log
        Times count from the earliest sample; derived fields stand beside the others.

    Examples
    --------
    >>> log = assemble(Path("a.ulg"), "test", {"imu": (np.array([5.0, 5.5]), {"r": np.ones(2)})})
    >>> log.names, log["imu.r"].span
    (('imu.r',), (0.0, 0.5))
    """
    used = {}
    for topic, (times, fields) in topics.items():
        # A message with a damaged time tells nothing about when its numbers were.
        good = np.isfinite(times)
        if good.any():
            used[topic] = (times[good], {name: values[good] for name, values in fields.items()})
    first = min((float(times.min()) for times, _ in used.values()), default=0.0)
    series = []
    for topic, (times, fields) in used.items():
        since = np.round(times - first, 9)  # beyond a nanosecond is rounding
        known = {}
        for name, values in fields.items():
            full = f"{topic}.{name}"
            unit = (units or {}).get(full) or unit_of(full)
            known[name] = Series(full, since, values, unit)
        series += [*known.values(), *derived(topic, known)]
    words = {} if origin is None else {"origin": origin}
    return Log(path, kind, tuple(series), notes=tuple(notes), **words)
