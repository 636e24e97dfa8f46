"""Samples while they are measured: lines of CSV or NMEA 0183, or MAVLink messages.

A *source* is a file that grows, ``-`` for standard input, ``udp://HOST:PORT`` for lines, or
``mavlink://HOST:PORT`` for MAVLink over UDP. The first line of CSV is its header, with units, and
each further line one sample. Sentences and messages come one by one: a sample is what was last said
of every channel, taken at a fixed period.

Channels of sentences and messages are named by ``TOPIC.FIELD``, with a unit behind a colon where it
is not SI: ``psi=HDT.heading:deg``, ``r=ATTITUDE.yawspeed``.
"""

from __future__ import annotations

import math
import socket
import sys
import time as clock
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.csv_columns import Columns
from oed_sysid.data.formats import sentence_of
from oed_sysid.data.record import TURN
from oed_sysid.errors import DataError, library
from oed_sysid.physics.channels import Channels
from oed_sysid.runtime.constants import LONGEST_LINE
from oed_sysid.text.csv_table import Table
from oed_sysid.text.units import dimension, to_si

Sample = tuple[float, dict[str, float]]


@dataclass(frozen=True)
class Place:
    """Where a channel is found in sentences or messages.

    Attributes
    ----------
    topic, field : str
    unit : str
        Of the number there; empty for SI.
    """

    topic: str
    field: str
    unit: str = ""

    @classmethod
    def of(cls, text: str) -> Place:
        """Read ``TOPIC.FIELD:UNIT``."""
        place, _, unit = text.partition(":")
        topic, _, name = place.partition(".")
        if not topic or not name:
            raise DataError(f"{text!r} names no field. Write TOPIC.FIELD or TOPIC.FIELD:UNIT.")
        if unit:
            to_si(0.0, unit)
        return cls(topic, name, unit)


def samples(
    source: str,
    channels: Channels,
    *,
    places: Mapping[str, Place] | None = None,
    period: float = 1.0,
    silence: float = 10.0,
) -> Iterator[Sample]:
    """Samples of a source as they come: time in s, channels in SI units by name.

    Parameters
    ----------
    source : str
        File, ``-``, ``udp://HOST:PORT`` or ``mavlink://HOST:PORT``.
    channels : Channels
        Inputs and outputs that are wanted.
    places : mapping of str to Place, optional
        Channels of sentences and messages.
    period : float
        Between samples of these, s.
    silence : float
        The run is over after so many seconds without a word.

    Raises
    ------
    DataError
        If the source cannot be read, or does not hold every channel.
    """
    found: Iterator[Sample]
    if source.startswith("mavlink://"):
        found = _gathered(
            _messages(source.removeprefix("mavlink://"), silence), places or {}, period
        )
    else:
        lines = _lines(source, silence)
        first = next(lines, None)
        if first is None:
            raise DataError(f"Nothing came from {source!r} for {silence:g} s.")
        if first.lstrip("\\0123456789.,; \t")[:1] in ("$", "!"):
            said = filter(None, map(sentence_of, chain((first,), lines)))
            found = _gathered(said, places or {}, period)
        else:
            found = _rows(source, first, lines, channels)
    yield from _unwrapped(found, channels)


def _unwrapped(found: Iterator[Sample], channels: Channels) -> Iterator[Sample]:
    """Angles that wrap go on past half a turn; samples that are not later are left out."""
    angles = [one.name for one in channels.outputs if dimension(one.unit) == dimension("rad")]
    last: dict[str, float] = {}
    before = -math.inf
    for time, sample in found:
        if not time > before:
            continue
        for name in angles:
            value = sample.get(name, math.nan)
            if math.isfinite(value):
                sample[name] = value + TURN * round((last.get(name, value) - value) / TURN)
                last[name] = sample[name]
        before = time
        yield time, sample


def _lines(source: str, silence: float) -> Iterator[str]:
    """Whole lines of a source, without their ends."""
    if source == "-":
        yield from (line.rstrip("\r\n") for line in sys.stdin)
    elif source.startswith("udp://"):
        yield from _datagrams(source.removeprefix("udp://"), silence)
    else:
        yield from _growing(Path(source), silence)


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit():
        raise DataError(f"{text!r} is no address. Write HOST:PORT, such as 127.0.0.1:5005.")
    return host, int(port)


def _datagrams(address: str, silence: float) -> Iterator[str]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        try:
            port.bind(_address(address))
        except OSError as error:
            raise DataError(f"{address!r} cannot be listened to: {error.strerror}.") from None
        port.settimeout(silence)
        while True:
            try:
                content = port.recv(LONGEST_LINE)
            except TimeoutError:
                return
            yield from content.decode(errors="replace").splitlines()


def _growing(path: Path, silence: float) -> Iterator[str]:
    """Lines of a file, and those that are written to it later."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            part, quiet = "", 0.0
            while quiet < silence:
                part += file.read(LONGEST_LINE)
                *whole, part = part.split("\n")
                yield from (line.rstrip("\r") for line in whole)
                if len(part) >= LONGEST_LINE:
                    raise DataError(f"{str(path)!r} holds no lines.")
                if whole:
                    quiet = 0.0
                else:
                    clock.sleep(0.05)
                    quiet += 0.05
            if part:
                yield part.rstrip("\r")
    except OSError as error:
        raise DataError(f"{str(path)!r} cannot be read: {error.strerror}.") from None


def _rows(source: str, header: str, lines: Iterable[str], channels: Channels) -> Iterator[Sample]:
    """Samples of lines of CSV; a line that is torn is left out."""
    mark = max(",;\t", key=header.count)
    headers = tuple(text.strip().strip('"') for text in header.split(mark))
    empty = np.empty((0, len(headers)))
    columns = Columns(Table(Path(source), headers, empty, empty[:, 0]), {})
    clock = columns.time_column()
    found = {"t": (clock, columns.parsed[clock][1] or "s", 1.0)}
    found |= {one.name: (*columns.place(one), one.sign) for one in channels.all}
    for line in lines:
        cells = line.split(mark)
        try:
            row = {name: sign * _number(cells[i], unit) for name, (i, unit, sign) in found.items()}
        except (ValueError, IndexError):
            continue
        if math.isfinite(time := row.pop("t")):
            yield time, row


def _number(cell: str, unit: str) -> float:
    return float(to_si(float(cell), unit)[0]) if cell.strip() else math.nan


# Time in front of it if there is one, type, numbers.
Message = tuple[float | None, str, Mapping[str, Any]]


def _messages(address: str, silence: float) -> Iterator[Message]:
    """MAVLink messages of a port."""
    mavutil = library("pymavlink.mavutil", "Reading MAVLink")
    host, port = _address(address)
    link = mavutil.mavlink_connection(f"udpin:{host}:{port}")
    while (message := link.recv_match(blocking=True, timeout=silence)) is not None:
        yield None, message.get_type(), message.to_dict()


def _gathered(
    messages: Iterator[Message], places: Mapping[str, Place], period: float
) -> Iterator[Sample]:
    """What was last said of every channel, every period."""
    if not places:
        raise DataError(
            "Sentences and messages need to be told where channels are: --map psi=HDT.heading:deg."
        )
    last: dict[str, float] = {}
    begun, due = math.nan, 0.0
    for stamp, topic, fields in messages:
        now = clock.monotonic() if stamp is None else stamp
        begun = now if math.isnan(begun) else begun
        if len(last) == len(places) and now - begun >= due:
            yield now - begun, dict(last)
            due = now - begun + period
        last |= _told(topic, fields, places)
    if silent := [name for name in places if name not in last]:
        raise DataError(f"No message ever told {', '.join(silent)}. Look at the names of --map.")


def _told(topic: str, fields: Mapping[str, Any], places: Mapping[str, Place]) -> dict[str, float]:
    """Channels that a message tells, SI."""
    return {
        name: float(to_si(float(fields[place.field]), place.unit or "1")[0])
        for name, place in places.items()
        if place.topic == topic and place.field in fields
    }
