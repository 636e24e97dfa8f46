"""Mapping files: which field of a log is which channel, kept as text and repeated on the next log.

A mapping is TOML::

    problem = "my_auv"          # a shipped problem or a folder; its channels are written
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
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.log import Log, Series, symbol_of
from oed_sysid.errors import DataError, OedSysidError, closest
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.runtime.files import write_text
from oed_sysid.text.units import dimension, to_si

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
        unknown = [name for name in self.inputs if name not in commands]
        if unknown:
            raise DataError(
                f"[cut_by_commands] names {unknown[0]!r}, which is no input of the mapping. "
                f"Inputs are {', '.join(commands) or 'none'}."
            )
        spans: list[list[float]] = []
        for name in self.inputs or commands:
            times, values = commands[name]
            away = np.abs(values - np.median(values)) > self.threshold
            until = np.append(times[1:], end)  # a command is held until the next
            spans += [[float(times[i]), float(until[i])] for i in np.flatnonzero(away)]
        joined: list[list[float]] = []
        for start, stop in sorted(spans):
            if joined and start - joined[-1][1] < self.rest:
                joined[-1][1] = max(stop, joined[-1][1])
            else:
                joined.append([start, stop])
        number = 0
        for index, (start, stop) in enumerate(joined):
            # What follows one manoeuvre is not the beginning of the next.
            free = joined[index - 1][1] + self.after if index else -np.inf
            after = joined[index + 1][0] if index + 1 < len(joined) else end
            if stop - start < self.shortest:
                continue
            number += 1
            yield Cut(
                f"manoeuvre_{number}",
                max(start - self.before, min(free, start), 0.0),
                min(stop + self.after, after, end),
            )


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
        given = [value for value in (self.equals, self.above, self.below) if value is not None]
        if len(given) != 1:
            raise DataError("Give one of equals, above and below.")

    def of(self, log: Log) -> Iterator[Cut]:
        """Yield the stretches of a log."""
        yield from self.find(log[self.field], log.span[1])

    def find(self, series: Series, end: float) -> Iterator[Cut]:
        """Yield the stretches of one field; its value is held until the next sample."""
        values = series.values
        if self.equals is not None:
            inside = values == self.equals
        elif self.above is not None:
            inside = values > self.above
        else:
            inside = values < self.below
        edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
        until = np.append(series.times, end)
        number = 0
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            start, stop = float(until[first]), float(until[last])
            if stop - start >= max(self.shortest, 1e-9):
                number += 1
                yield Cut(f"manoeuvre_{number}", start, stop)


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
        if self.clock != "outputs" and self.clock not in self.outputs:
            raise DataError(
                f"{self.where}: clock is {self.clock!r}. Choose 'outputs' or one of "
                f"{', '.join(self.outputs)}."
            )
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
            lines += ["", "[[cuts]]", f"name = {_toml(cut.name)}"]
            lines += [f"from = {_toml(cut.start)}", f"to = {_toml(cut.stop)}"]
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
        f"{one.name} = {_toml(getattr(value, one.name))}"
        for one in fields(value)
        if getattr(value, one.name) != one.default
    ]


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_toml(one) for one in value) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {_toml(v)}" for k, v in value.items()) + " }"
    return json.dumps(value)


def read_mapping(path: str | Path) -> LogMapping:
    """Read a mapping file.

    Raises
    ------
    DataError
        If it is no TOML, or says something unknown; the message names the place.
    """
    place = Path(path)
    try:
        text = place.read_text(encoding="utf-8")
    except OSError as error:
        raise DataError(f"{place} cannot be read: {error.strerror or error}.") from None
    except UnicodeDecodeError:
        raise DataError(f"{place} is no text file (UTF-8), so it is not a mapping.") from None
    return parse(text, where=place.name)


_PLAIN = ("problem", "clock", "tolerance", "sample_time")
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
    _known(where, "", content, (*_PLAIN, "inputs", "outputs", "cuts", *_CUTTERS))
    found: dict[str, Any] = {key: content[key] for key in _PLAIN if key in content}
    for kind in ("inputs", "outputs"):
        tables = content.get(kind, {})
        if not isinstance(tables, dict) or not all(isinstance(t, dict) for t in tables.values()):
            raise DataError(f"{where}: {kind} are tables, as [{kind}.psi].")
        found[kind] = {
            name: _built(Source, table, f"{where}: [{kind}.{name}]")
            for name, table in tables.items()
        }
    cuts = content.get("cuts", [])
    if not isinstance(cuts, list):
        raise DataError(f"{where}: write every cut under [[cuts]], in two brackets.")
    renamed = [{_CUT.get(key, key): value for key, value in cut.items()} for cut in cuts]
    found["cuts"] = tuple(
        _built(Cut, cut, f"{where}: cut {number}") for number, cut in enumerate(renamed, start=1)
    )
    for key, (target, cutter) in _CUTTERS.items():
        if key in content:
            found[target] = _built(cutter, content[key], f"{where}: [{key}]")
    return LogMapping(**found, where=where)


_CUT = {"from": "start", "to": "stop"}
# What a value of TOML is in the type of a field.
_KINDS = {str: "str", tuple: "tuple", int: "float", float: "float"}


def _known(where: str, table: str, content: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in content:
        if key not in known:
            raise DataError(
                f"{where}{table} says {key!r}, which is not known. Known are {', '.join(known)}."
                + closest(key, known)
            )


def _built(kind: type, table: Mapping[str, Any], where: str) -> Any:
    """An object of a table, with every fault said where it stands."""
    known = {one.name: one for one in fields(kind)}
    _known(where, "", table, tuple(known))
    values = {}
    for key, value in table.items():
        text = str(known[key].type)
        if isinstance(value, list):
            value = tuple(value)
        kind_of = "bool" if isinstance(value, bool) else _KINDS.get(type(value), "nothing")
        if kind_of not in text:
            raise DataError(f"{where}: {key} is {value!r:.40}, expected {_words(text)}.")
        values[key] = value
    try:
        return kind(**values)
    except TypeError as error:
        lost = re.findall(r"'(\w+)'", str(error))
        back = {new: old for old, new in _CUT.items()}
        raise DataError(
            f"{where} lacks {', '.join(back.get(name, name) for name in lost)}."
        ) from None
    except OedSysidError as error:
        raise DataError(f"{where}: {error}") from None


def _words(text: str) -> str:
    for kind, words in (("tuple", "a list"), ("bool", "true or false"), ("float", "a number")):
        if kind in text:
            return words
    return "text in quotation marks"


def draft(log: Log, channels: Channels, *, problem: str = "") -> LogMapping | None:
    """Guess a mapping from names and units, to be read and corrected by a person.

    Parameters
    ----------
    log : Log
        The log.
    channels : Channels
        What is wanted.
    problem : str
        Name of the problem, to be written into the mapping.

    Returns
    -------
    LogMapping or None
        With the first field that has the name or symbol of each output, or None where no output
        is found; inputs that are not found are constant zeros.
    """

    def found(name: str, unit: str) -> Source | None:
        for one in log.series:
            last = one.name.rpartition(".")[2].split(" ")[0]
            same = last == name or symbol_of(one.name) == name
            if same and one.unit and dimension(one.unit) == dimension(unit):
                turns = unit == "rad" and name in ("psi", "phi")
                return Source(one.name, unit=one.unit, wrap=turns)
        return None

    outputs = {one.name: found(one.name, one.unit) for one in channels.outputs}
    inputs = {one.name: found(one.name, one.unit) for one in channels.inputs}
    present = {name: source for name, source in outputs.items() if source is not None}
    if not present:
        return None
    return LogMapping(
        {
            channel.name: inputs[channel.name] or Source(constant=0.0, unit=channel.unit or "1")
            for channel in channels.inputs
        },
        present,
        problem=problem,
    )
