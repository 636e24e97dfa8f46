"""Mapping files: which field of a log is which channel, kept as text and repeated on the next log.

A mapping is TOML::

    problem = "my_auv"          # a shipped problem or a folder; its channels are written
    time = "run.Uhr"            # field that holds the times, where the log's own are others
    time_unit = "ms"            # where the log does not say it
    clock = "outputs"           # or the name of an output whose times the records get
    tolerance = 0.002           # s; samples this near each other share a row
    sample_time = 0.1           # s; keep one sample of each output per interval

    [inputs.rudder]
    field = "actuator_controls_0.control[2]"
    factor = 0.35               # reading minus trim times factor is in unit
    unit = "rad"

    [outputs.psi]
    field = "vehicle_attitude.yaw"
    unit = "rad"
    sign = -1                   # axes of the log against those of the problem
    wrap = true                 # the log jumps at 180 or 360 degrees
    delay = 0.08                # s; the log says it that much later than it was
    trim = 0.02                 # reading at zero, in units of the log

    [[cuts]]
    name = "zigzag"
    from = 120.0                # s since the log's origin
    to = 180.0

Only ``field`` (or ``constant``, for an input that was not logged) is required; ``unit`` where the
log does not say it. ``[cut_by_commands]`` and ``[cut_while]`` find manoeuvres by themselves
(:class:`CommandCuts`, :class:`WhileCuts`).

Cutting a log into manoeuvres: by time, by what was commanded, or by a state of the vehicle.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.log import Log, Series
from oed_sysid.errors import DataError, OedSysidError, located
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.runtime.files import read_bytes, write_text
from oed_sysid.text.units import converts, dimension, to_si

# -- cutting a log into manoeuvres -----------------------------------------------------


@dataclass(frozen=True)
class Cut:
    """One manoeuvre by time.

    Parameters
    ----------
    name : str
        Name of the record.
    start, stop : float
        Times in s since the log's origin.
    """

    name: str
    start: float
    stop: float

    def __post_init__(self) -> None:
        if not self.stop > self.start:
            raise DataError(f"cut {self.name!r} ends at {self.stop} s, before it begins.")


@dataclass(frozen=True)
class CommandCuts:
    """Manoeuvres are where an input leaves its rest value.

    The rest value of an input is the one that it has most of the time (its median). A manoeuvre
    begins ``before`` seconds before the first departure by more than ``threshold``, and ends
    ``after`` seconds after the last one; departures less than ``rest`` seconds apart belong
    together.

    Parameters
    ----------
    threshold : float
        Smallest departure, in the SI unit of the input.
    inputs : tuple of str
        Which inputs; by default all.
    rest : float
        Time at rest that separates manoeuvres, s.
    before, after : float
        Time that is kept before and after, s.
    shortest : float
        Manoeuvres that are shorter are left out, s.

    Examples
    --------
    >>> t = np.arange(0.0, 100.0, 1.0)
    >>> rudder = np.where((t > 20) & (t < 40), 0.2, 0.0)
    >>> cuts = CommandCuts(0.05, before=5.0, after=10.0)
    >>> [(cut.name, cut.start, cut.stop) for cut in cuts.find({"rudder": (t, rudder)}, 99.0)]
    [('manoeuvre_1', 16.0, 50.0)]
    """

    threshold: float
    inputs: tuple[str, ...] = ()
    rest: float = 10.0
    before: float = 5.0
    after: float = 10.0
    shortest: float = 5.0

    def __post_init__(self) -> None:
        if not self.threshold > 0.0:
            raise DataError(f"threshold is {self.threshold}. Give the smallest departure.")
        if min(self.rest, self.before, self.after, self.shortest) < 0.0:
            raise DataError("rest, before, after and shortest are times of 0 s or more.")

    def find(
        self, commands: Mapping[str, tuple[np.ndarray, np.ndarray]], end: float
    ) -> Iterator[Cut]:
        """Yield the manoeuvres.

        Parameters
        ----------
        commands : mapping
            Input to times ``(n,)`` and values ``(n,)``, SI.
        end : float
            Last time of the log, s.
        """
        located(DataError, "[cut_by_commands]: there is no input", self.inputs, commands)
        spans: list[tuple[float, float]] = []
        for name in self.inputs or commands:
            times, values = commands[name]
            spans += _stretches(np.abs(values - np.median(values)) > self.threshold, times, end)
        joined: list[tuple[float, float]] = []
        for start, stop in sorted(spans):
            near = bool(joined) and start - joined[-1][1] < self.rest
            first, last = joined.pop() if near else (start, stop)
            joined.append((first, max(last, stop)))
        # What follows one manoeuvre is not the beginning of the next.
        free = [-np.inf, *(stop + self.after for _, stop in joined)]
        following = [*(start for start, _ in joined[1:]), end]
        rows = [
            (max(start - self.before, min(before, start), 0.0), min(stop + self.after, after, end))
            for (start, stop), before, after in zip(joined, free, following, strict=False)
            if stop - start >= self.shortest
        ]
        yield from _numbered(rows)


def _stretches(holds: np.ndarray, times: np.ndarray, end: float) -> list[tuple[float, float]]:
    """From when to when something holds, s; each sample is held until the next one."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(int), [0]])))
    moments = np.append(times, end)[edges].reshape(-1, 2)
    return [(start, stop) for start, stop in moments.tolist()]


def _numbered(spans: Iterable[tuple[float, float]]) -> Iterator[Cut]:
    for number, (start, stop) in enumerate(spans, start=1):
        yield Cut(f"manoeuvre_{number}", start, stop)


@dataclass(frozen=True)
class WhileCuts:
    """Manoeuvres are the stretches in which a field has a value, such as a mode or a switch.

    Parameters
    ----------
    field : str
        ``topic.field``.
    equals, above, below : float or None
        One of them: the value, or a limit.
    shortest : float
        Stretches that are shorter are left out, s.

    Examples
    --------
    >>> t = np.arange(0.0, 60.0, 1.0)
    >>> mode = Series("status.mode", t, np.where((t >= 10) & (t < 30), 3.0, 0.0))
    >>> [(cut.start, cut.stop) for cut in WhileCuts("status.mode", equals=3).find(mode, 59.0)]
    [(10.0, 30.0)]
    """

    field: str
    equals: float | None = None
    above: float | None = None
    below: float | None = None
    shortest: float = 5.0

    def __post_init__(self) -> None:
        if sum(getattr(self, name) is not None for name in _TESTS) != 1:
            raise DataError("Give one of equals, above and below.")

    def find(self, series: Series, end: float) -> Iterator[Cut]:
        """Yield the stretches of one field; its value is held until the next sample."""
        stated = [(name, getattr(self, name)) for name in _TESTS]
        name, limit = next(pair for pair in stated if pair[1] is not None)
        spans = _stretches(_TESTS[name](series.values, limit), series.times, end)
        least = max(self.shortest, 1e-9)
        yield from _numbered(span for span in spans if span[1] - span[0] >= least)


_TESTS: Mapping[str, Callable[..., np.ndarray]]
_TESTS = {"equals": np.equal, "above": np.greater, "below": np.less}


# -- mapping files ---------------------------------------------------------------------


@dataclass(frozen=True)
class Source:
    """Where a channel comes from: channel = sign * factor * (reading - trim), in ``unit``.

    Parameters
    ----------
    field : str
        ``topic.field``; empty for a constant.
    unit : str or None
        Unit of the result; by default that of the log.
    sign : float
        1 or -1.
    factor : float
        Units per reading, for servos in microseconds or normalised commands.
    trim : float
        Reading at zero.
    delay : float
        Time by which the log is late, in s.
    wrap : bool
        Whether the log holds an angle within one turn, to be made continuous.
    constant : float or None
        Value of an input that was not logged.
    interpolation : str or None
        Of an input without a problem: ``"hold"`` or ``"linear"``.

    Examples
    --------
    >>> servo = Source("rc.out1", unit="rad", factor=0.001, trim=1500.0)
    >>> servo.factor * (1600.0 - servo.trim)
    0.1
    """

    field: str = ""
    unit: str | None = None
    sign: float = 1
    factor: float = 1.0
    trim: float = 0.0
    delay: float = 0.0
    wrap: bool = False
    constant: float | None = None
    interpolation: str | None = None

    def __post_init__(self) -> None:
        if bool(self.field) == (self.constant is not None):
            raise DataError("Give either field = 'topic.field' or constant = number.")
        if self.sign not in (1, -1):
            raise DataError(f"sign is {self.sign!r}. Choose 1 or -1; a scale is a factor.")
        if not self.factor:
            raise DataError("factor is 0, which makes everything zero.")
        if self.unit is not None:
            dimension(self.unit)
        if self.interpolation not in (None, "hold", "linear"):
            raise DataError(f"interpolation is {self.interpolation!r}. Choose 'hold' or 'linear'.")


@dataclass(frozen=True)
class LogMapping:
    """How a log becomes records.

    Parameters
    ----------
    inputs, outputs : mapping of str to Source
        By channel name.
    problem : str
        Problem whose channels these are; empty without one.
    time : str
        Field that holds the times, ``topic.field``; empty where the log knows its own.
    time_unit : str
        Unit in which the clock counts; empty where the log says it.
    clock : str
        ``"outputs"``: the times of all outputs; or the name of one output whose times the
        records get.
    tolerance : float or None
        Samples of different outputs that lie within this (s) share a row; by default a tenth
        of the shortest sampling interval.
    sample_time : float or None
        Keep one sample of each output per interval of this length (s); by default all.
    cuts : tuple of Cut
        Manoeuvres by time.
    by_commands, while_ : CommandCuts, WhileCuts or None
        Manoeuvres that are found.

    Examples
    --------
    >>> mapping = parse('''
    ... [inputs.rudder]
    ... field = "RCOU.C1"
    ... trim = 1500
    ... factor = 0.001
    ... unit = "rad"
    ... [outputs.psi]
    ... field = "ATT.Yaw"
    ... wrap = true
    ... ''')
    >>> mapping.inputs["rudder"].trim, mapping.outputs["psi"].wrap
    (1500, True)
    >>> parse(mapping.text()) == mapping
    True
    """

    inputs: Mapping[str, Source]
    outputs: Mapping[str, Source]
    problem: str = ""
    time: str = ""
    time_unit: str = ""
    clock: str = "outputs"
    tolerance: float | None = None
    sample_time: float | None = None
    cuts: tuple[Cut, ...] = ()
    by_commands: CommandCuts | None = None
    while_: WhileCuts | None = None
    where: str = field(default="The mapping", compare=False)

    def __post_init__(self) -> None:
        if not self.outputs:
            raise DataError(f"{self.where} has no outputs. Add a table such as [outputs.psi].")
        for name, source in self.outputs.items():
            if source.constant is not None:
                raise DataError(f"{self.where}: output {name!r} is measured, not constant.")
        located(DataError, f"{self.where}: clock is", [self.clock], ("outputs", *self.outputs))
        if self.time_unit and not converts(self.time_unit, "s"):
            raise DataError(f"{self.where}: time_unit is {self.time_unit!r}. Give s, ms, min ...")
        for what in ("tolerance", "sample_time"):
            value = getattr(self, what)
            if value is not None and not value > 0.0:
                raise DataError(f"{self.where}: {what} is {value}. Give a time above 0 s.")
        names = [cut.name for cut in self.cuts]
        if len(set(names)) < len(names):
            raise DataError(f"{self.where}: two cuts have the same name. Rename one.")

    def channels(self, log: Log) -> Channels:
        """Channels of a mapping without a problem, in the SI unit of each field."""

        def unit(name: str, source: Source) -> str:
            stated = source.unit or (log[source.field].unit if source.field else None)
            if stated is None:
                raise DataError(
                    f"{self.where}: {source.field!r} ({name}) has no unit in the log. Add "
                    'unit = "..." to its table.'
                )
            return to_si(1.0, stated)[1]

        return Channels(
            tuple(
                Input(name, unit(name, one), interpolation=one.interpolation or "hold")
                for name, one in self.inputs.items()
            ),
            tuple(Output(name, unit(name, one)) for name, one in self.outputs.items()),
        )

    def text(self) -> str:
        """The mapping as TOML; :func:`parse` reads it."""
        lines = []
        for name in _PLAIN:
            value = getattr(self, name)
            if value not in ("", None, "outputs"):
                lines.append(f"{name} = {_toml(value)}")
        for kind in ("inputs", "outputs"):
            for name, source in getattr(self, kind).items():
                lines += ["", f"[{kind}.{name}]", *_entries(source)]
        for cut in self.cuts:
            lines += ["", "[[cuts]]", *_entries(cut)]
        for key, (name, _) in _CUTTERS.items():
            if getattr(self, name) is not None:
                lines += ["", f"[{key}]", *_entries(getattr(self, name))]
        return "\n".join(lines).lstrip() + "\n"

    def write(self, path: str | Path) -> None:
        """Write the mapping file."""
        write_text(path, self.text())


def _entries(value: Any) -> list[str]:
    """Lines of what differs from its default."""
    return [
        f"{key} = {_toml(getattr(value, one.name))}"
        for key, one in _keys(type(value)).items()
        if getattr(value, one.name) != one.default
    ]


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def read_mapping(path: str | Path) -> LogMapping:
    """Read a mapping file.

    Returns
    -------
    LogMapping
        Where each channel comes from.

    Raises
    ------
    DataError
        If it is no TOML, or says something unknown; the message names the place.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "map.toml"
    ...     _ = file.write_text('outputs = {psi = {field = "imu.yaw", unit = "deg", wrap = true}}')
    ...     print(read_mapping(file).outputs["psi"].field)
    imu.yaw
    """
    place = Path(path)
    try:
        text = read_bytes(place).decode("utf-8")
    except UnicodeDecodeError:
        raise DataError(f"{place} is no text file (UTF-8), so it is not a mapping.") from None
    return parse(text, where=place.name)


_PLAIN = ("problem", "time", "time_unit", "clock", "tolerance", "sample_time")
_CUTTERS = {"cut_by_commands": ("by_commands", CommandCuts), "cut_while": ("while_", WhileCuts)}


def parse(text: str, *, where: str = "The mapping") -> LogMapping:
    """Read a mapping from TOML text.

    Parameters
    ----------
    text : str
        As in the head of this module.
    where : str
        Words for messages.

    Raises
    ------
    DataError
        If it is no TOML, or says something unknown.
    """
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise DataError(f"{where} is no TOML: {error}. Texts stand in quotation marks.") from None
    parts = (*_PLAIN, *_SIDES, "cuts", *_CUTTERS)
    located(DataError, f"{where} has no setting", content, parts)
    found: dict[str, Any] = {key: content[key] for key in _PLAIN if key in content}
    for side in _SIDES:
        tables = _checked(content.get(side, {}), dict, f"{where}: [{side}]")
        found[side] = {
            name: _built(Source, table, f"{where}: [{side}.{name}]")
            for name, table in tables.items()
        }
    cuts = _checked(content.get("cuts", []), list, f"{where}: [[cuts]]")
    found["cuts"] = tuple(
        _built(Cut, cut, f"{where}: cut {number}") for number, cut in enumerate(cuts, start=1)
    )
    for key, (target, cutter) in _CUTTERS.items():
        if key in content:
            found[target] = _built(cutter, content[key], f"{where}: [{key}]")
    return LogMapping(**found, where=where)


_SIDES = ("inputs", "outputs")
# Fields that a file calls otherwise.
_CALLED = {"start": "from", "stop": "to"}
# Kinds of values, how the type of a field that takes them begins, and what people call them.
_KINDS: tuple[tuple[Any, str, str], ...] = (
    (dict, "dict", "a table, as [outputs.psi]"),
    (list, "tuple", "a list; cuts stand under [[cuts]]"),
    (bool, "bool", "true or false"),
    (int | float, "float", "a number"),
    (str, "str", "text in quotation marks"),
)


def _keys(kind: type) -> dict[str, Field[Any]]:
    """Fields of a part of a mapping, by what a file calls them."""
    return {_CALLED.get(one.name, one.name): one for one in fields(kind)}


def _checked(value: Any, wanted: type | str, where: str) -> Any:
    """A value of a file, which has to be of a kind, or of that of a field."""
    kind = next(row for row in _KINDS if row[0] is wanted or str(wanted).startswith(row[1]))
    if next((one for one, *_ in _KINDS if isinstance(value, one)), None) is not kind[0]:
        raise DataError(f"{where} is {value!r:.40}, expected {kind[2]}.")
    return value


def _built(kind: type, table: Any, where: str) -> Any:
    """An object of a table, with every fault said where it stands."""
    known = _keys(kind)
    located(DataError, f"{where} has no setting", _checked(table, dict, where), known)
    if lost := [key for key, one in known.items() if one.default is MISSING and key not in table]:
        raise DataError(f"{where} lacks {', '.join(lost)}.")
    values = {}
    for key, value in table.items():
        _checked(value, str(known[key].type), f"{where}: {key}")
        values[known[key].name] = tuple(value) if isinstance(value, list) else value
    try:
        return kind(**values)
    except OedSysidError as error:
        raise DataError(f"{where}: {error}") from None
