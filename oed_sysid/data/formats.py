"""Which format a log has, by its first bytes, then by its name; the readers of all of them.

Read are tables with a header (CSV, Excel with openpyxl, Parquet with pyarrow, objects of pandas and
xarray), PX4 logs (ULog, with pyulog), ArduPilot DataFlash logs (.bin, with pymavlink), ROS 1 and
ROS 2 bags (with rosbags), MCAP files (with mcap), NMEA 0183 sentences in a text file (with pynmea2)
and MATLAB files (.mat with SciPy, of version 7.3 with h5py).
"""

from __future__ import annotations

import contextlib
import io
import json
import re
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import is_dataclass, replace
from datetime import UTC, datetime
from functools import partial
from importlib.util import find_spec
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from oed_sysid.data import SAYS, apart
from oed_sysid.data.apart import guarded, read_apart
from oed_sysid.data.csv_columns import EPOCH, counted_on, unit_of_counts
from oed_sysid.data.frames import columns_of, is_time, plain
from oed_sysid.data.log import TABLE, Log, Rows, assemble, meaning, topics_of, until_torn
from oed_sysid.errors import DataError, library
from oed_sysid.runtime.files import read_bytes
from oed_sysid.runtime.tables import tables
from oed_sysid.text.csv_table import read_table, text_lines, time_stamp
from oed_sysid.text.units import is_unit, parse_header, to_si

# -- tables with a header --------------------------------------------------------------


def read_csv_log(path: Path, time: str = "") -> Log:
    """Read a CSV file as a log of one topic, named after the file; ``time`` is its column of it."""
    table = read_table(path, columns_of_text=True)
    columns = dict(zip(table.headers, table.values.T, strict=True))
    for i, first in table.stamps.items():
        stamp = time_stamp(first)
        if stamp is not None and stamp[1] == "clock":
            columns[table.headers[i]] = counted_on(table.values[:, i])
    faults = {table.headers[i]: fault for i, fault in table.faults.items()}
    for header in faults:
        del columns[header]
    stamps = [table.headers[i] for i in table.stamps]
    clocks = filter(columns.__contains__, (time, *filter(is_time, columns), *stamps))
    clock = next(clocks, None) or clock_of(columns)
    if clock is None and (called := next(filter(is_time, faults), None)) is not None:
        raise DataError(faults[called])
    return _log(path, "CSV file", {path.stem: columns}, clock, stamps)


def read_excel(path: Path) -> Log:
    """Read an Excel workbook: every sheet is a topic with headers in its first row.

    Raises
    ------
    DataError
        If openpyxl is missing, the file is damaged, or no sheet has a time column.
    """
    openpyxl = library("openpyxl", "Reading an Excel workbook")
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    tables = {}
    for sheet in book:
        every = sheet.iter_rows(values_only=True)
        rows = [row for row in every if any(cell is not None for cell in row)]
        if len(rows) > 2:
            tables[sheet.title.replace(" ", "_")] = {
                str(header).strip(): np.array([_cell(value) for value in column])
                for header, *column in zip_longest(*rows)
                if header is not None
            }
    book.close()
    return _log(path, "Excel workbook", tables)


def _cell(value: Any) -> float:
    if isinstance(value, datetime):
        return value.timestamp()
    if isinstance(value, bool | int | float):
        return float(value)
    return np.nan


def read_parquet(path: Path) -> Log:
    """Read a Parquet file as a log of one topic, named after the file.

    Raises
    ------
    DataError
        If pyarrow is missing, the file is damaged, or it has no time column.
    """
    parquet = library("pyarrow.parquet", "Reading a Parquet file")
    table = parquet.read_table(path)
    columns = {name: plain(table[name].to_numpy()) for name in table.column_names}
    dates = [f.name for f in table.schema if str(f.type).startswith(("timestamp", "duration"))]
    # The index of a frame, dates first: pandas names it in the file, or not at all.
    index = [one for one in (table.schema.pandas_metadata or {}).get("index_columns", [])
             if isinstance(one, str)]  # fmt: skip
    called = next(filter(is_time, columns), None)
    clock = called or next(iter([*(set(index) & set(dates)), *dates, *index]), None)
    return _log(path, "Parquet file", {path.stem: columns}, clock, dates)


def log_of(table: Any, *, name: str = "table") -> Log:
    """Make a log of a pandas data frame or an xarray data set.

    Parameters
    ----------
    table : pandas.DataFrame or xarray.Dataset
        With a time column, or times as index or coordinate. Units of xarray variables
        are read from their attribute ``units``.
    name : str
        Name of the topic.

    Returns
    -------
    Log
        With one field for each numeric column.

    Examples
    --------
    >>> import pandas
    >>> frame = pandas.DataFrame({"t": [0.0, 0.5, 1.0], "r [deg/s]": [0.0, 1.0, 2.0]})
    >>> log_of(frame)["table.r [deg/s]"].unit
    'deg/s'
    """
    return _log(Path(name), type(table).__name__, {name: columns_of(table)})


def _log(
    path: Path,
    kind: str,
    tables: Mapping[str, Mapping[str, np.ndarray]],
    header: str | None = None,
    in_seconds: Container[str] = (),
) -> Log:
    """Log of tables, whose clock is the column of a header, or the one that looks so."""
    timed = {topic: timed_by(columns, header, in_seconds) for topic, columns in tables.items()}
    topics = {topic: found for topic, found in timed.items() if found is not None}
    if not topics:
        raise _without_times(path, tables)
    clock = next(iter(topics.values()))
    first = min(float(np.nanmin(one.times)) for one in topics.values())
    is_moment = EPOCH[0] < first < EPOCH[1]
    moment = datetime.fromtimestamp(first).astimezone().isoformat() if is_moment else None
    read = {topic: (one.times, one.fields) for topic, one in topics.items()}
    notes = [] if is_time(clock.header) else [f"Times are those of {clock.header!r}."]
    made = assemble(path, kind, read, origin=moment, notes=notes)
    return replace(made, clock=clock.header, clock_unit=clock.unit)


class _Timed(NamedTuple):
    """Times ``(n,)`` in s, the other columns, the header of the clock, and its unit if told."""

    times: np.ndarray
    fields: dict[str, np.ndarray]
    header: str
    unit: str | None


def _without_times(path: Path, tables: Mapping[str, Mapping[str, np.ndarray]]) -> DataError:
    found = ", ".join(repr(h) for columns in tables.values() for h in list(columns)[:6])
    return DataError(SAYS["no_times"].format(path=path, found=found or "no columns"))


def _seconds_of_digits(clock: np.ndarray) -> np.ndarray:
    """Times of day, s, of a clock in digits: 115959 is a second before 120000."""
    hours, rest = np.divmod(np.mod(clock, 1e6), 1e4)
    minutes, seconds = np.divmod(rest, 100.0)
    return counted_on(3600.0 * hours + 60.0 * minutes + seconds)


def timed_by(
    columns: Mapping[str, np.ndarray], header: str | None = None, in_seconds: Container[str] = ()
) -> _Timed | None:
    """Find the clock of a table and its unit; None without two times and a number.

    A clock is called so, or it is the one column that grows in even steps. Its unit stands in its
    header or follows from counting since 1970, or since 1900 in days; else seconds are taken until
    the motion says otherwise (:mod:`~oed_sysid.data.recognise`).
    """
    fields = {name: values for name, values in columns.items() if values.dtype.kind == "f"}
    header = header or clock_of(fields)
    if header is None:
        return None
    counts = fields.pop(header)
    unit = parse_header(header)[1]
    if not (unit and is_unit(unit)):
        unit = "s" if header in in_seconds else unit_of_counts(counts)
    if unit == "clock":
        counts, unit = _seconds_of_digits(counts), "s"
    times = to_si(counts, unit or "s")[0]
    return _Timed(times, fields, header, unit) if np.isfinite(times).sum() > 1 and fields else None


def clock_of(fields: Mapping[str, np.ndarray]) -> str | None:
    """The column of times: called so, or growing evenly from row to row."""
    if (named := next(filter(is_time, fields), None)) is not None:
        return named
    rows: list[tuple[float, str]] = []
    for name, values in fields.items():
        steps = np.diff(values[np.isfinite(values)])
        if steps.size < 2 or np.any(steps <= 0.0):
            continue
        uneven = float(np.quantile(np.abs(steps / np.median(steps) - 1.0), 0.9))
        counts = bool(np.all(steps == 1.0)) and values[0] in (0.0, 1.0)  # numbers of rows
        rows.append((-uneven - counts + 2.0 * (meaning(name)[0] == "t"), name))
    return max(rows)[1] if rows else None


def _numeric(values: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Vectors and matrices of numbers, as float."""
    arrays = {key: np.asarray(value) for key, value in values.items()}
    whole = {key: one for key, one in arrays.items() if one.dtype.kind in "fiub"}
    return {key: one.astype(float) for key, one in whole.items() if one.ndim in (1, 2)}


def _instance(topic: str, number: float) -> str:
    """Name of one of several sensors of a kind; the first has none."""
    return f"{topic}_{number:.0f}" if number else topic


# -- PX4 logs --------------------------------------------------------------------------


def read_ulog(path: Path) -> Log:
    """Read a ULog file.

    Topics are named as PX4 names them, further instances with their number
    (``sensor_gyro_1``). A torn end is said; what stands before it is used.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If pyulog is missing or cannot read the file.
    """
    pyulog = library("pyulog", "Reading a PX4 log (ULog)")
    with contextlib.redirect_stdout(io.StringIO()):
        ulog = pyulog.ULog(str(path))
    topics: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]] = {}
    units: dict[str, str] = {}
    for data in ulog.data_list:
        name, fields = _instance(data.name, data.multi_id), _numeric(data.data)
        clock = fields.pop("timestamp", np.empty(0))
        if fields and clock.size:
            topics[name] = (clock * 1e-6, fields)
        units |= {f"{name}.{key}": "us" for key in fields if "timestamp" in key}
    notes = _losses(path, ulog)
    return assemble(path, "PX4 log (ULog)", topics, units=units, notes=notes)


def _losses(path: Path, ulog: Any) -> Iterator[str]:
    """What a log lacks, in sentences."""
    if ulog.file_corruption:
        yield f"{path.name} is damaged: parts of it were skipped."
    elif _broke_off(path):
        yield f"{path.name} breaks off; what stands before the end is used."
    if ulog.dropouts:
        lost = sum(one.duration for one in ulog.dropouts) / 1000.0
        yield f"The logger lost samples {len(ulog.dropouts)} times, {lost:.2f} s in all."


def _broke_off(path: Path) -> bool:
    """Whether the last message is longer than the file: the parser leaves it out in silence."""
    content = path.read_bytes()
    place = 16  # behind the file's header, message after message: length, kind, body
    while place + 3 <= len(content):
        place += 3 + int.from_bytes(content[place : place + 2], "little")
    return place != len(content)


# -- ArduPilot DataFlash logs ----------------------------------------------------------


# What a log is made of, not what the vehicle did.
_ADMINISTRATION = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "FILE", "CMD", "BAD_DATA")


def read_dataflash(path: Path) -> Log:
    """Read a DataFlash log.

    Topics are the message names, several instances with their number (``IMU_1``); units and
    multipliers are those that the log states itself.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If pymavlink is missing or the file holds no messages.
    """
    parser = library("pymavlink.DFReader", "Reading an ArduPilot log (DataFlash)")
    notes, said = list[str](), io.StringIO()
    rows: Rows = {}
    units: dict[str, tuple[str, float]] = {}
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        reader = parser.DFReader_binary(str(path), zero_time_base=True)
        for message in until_torn(iter(reader.recv_msg, None), path, notes):
            _keep(message, rows, units)
        torn = reader.data_len - reader.offset > 0  # the last message is not whole
        reader.close()
    if not notes and (torn or re.search("bad|skipped", said.getvalue().lower())):
        notes.append(f"{path.name} is damaged or breaks off: parts of it were skipped.")
    if not rows:
        raise DataError(SAYS["no_messages"].format(path=path))
    known = {name: unit for name, (unit, _) in units.items() if unit}
    kind = "ArduPilot log (DataFlash)"
    return assemble(path, kind, topics_of(rows), units=known, notes=notes)


def _keep(message: Any, rows: Rows, units: dict[str, tuple[str, float]]) -> None:
    """Take the numbers of one message, if it has a time of its own."""
    topic, form, row = message.get_type(), message.fmt, dict[str, float]()
    clock = next(filter(form.columns.__contains__, _CLOCKS), None)
    if topic in _ADMINISTRATION or clock is None:
        return
    topic = _instance(topic, getattr(message, form.instance_field or "", 0.0))
    for name in form.columns:
        value, field = getattr(message, name, None), f"{topic}.{name}"
        if name not in (clock, form.instance_field) and isinstance(value, int | float):
            if field not in units:
                units[field] = _unit(form.get_unit(name))
            row[name] = value * units[field][1]
    if np.isfinite([*row.values()]).any():
        time = float(getattr(message, clock, np.nan))
        rows.setdefault(topic, []).append((time * _CLOCKS[clock], row))


_CLOCKS = {"TimeUS": 1e-6, "TimeMS": 1e-3}


def _unit(text: str | None) -> tuple[str, float]:
    """Unit as this package writes it, and the factor that brings the numbers into it."""
    if not text or text in ("UNKNOWN", "instance"):
        return "", 1.0
    spellings, prefixes = TABLE["spellings"], TABLE["prefixes"]
    scaled = re.fullmatch(r"([\d.e+-]+) (.+)", text)
    factor, unit = (float(scaled[1]), scaled[2]) if scaled else (1.0, text)
    unit = spellings.get(unit, unit)
    rest = spellings.get(unit[1:], unit[1:])
    if is_unit(unit):
        return unit, factor
    if unit[0] in prefixes and is_unit(rest):
        return rest, factor * prefixes[unit[0]]
    return "", 1.0


# -- ROS bags and MCAP files -------------------------------------------------------------

# Longer arrays are pictures, scans and covariances.
MOST_ENTRIES = 16


# Topic, time of arrival (ns) and content of every message.
_Messages = Iterator[tuple[str, int, Callable[[], Any]]]
# Time of arrival, time of the header and numbers of messages, by topic.
_Stamped = dict[str, list[tuple[int, int, dict[str, float]]]]


def _of_messages(path: Path, kind: str, messages: _Messages) -> Log:
    """Log of topic, time of arrival (ns) and content of every message.

    Times stay whole nanoseconds as long as they count from far away: as floats they would be
    rounded.
    """
    rows: _Stamped = {}
    notes, skipped = list[str](), dict[str, str]()
    for topic, received, content in until_torn(messages, path, notes):
        if topic in skipped:
            continue
        try:
            numbers = dict(_flat(content(), ""))
        except Exception as error:  # an unknown type, or a torn message
            why = str(error) or type(error).__name__
            skipped[topic] = why if isinstance(error, DataError) else why[:80]
            continue
        seconds = numbers.pop("header.stamp.sec", numbers.pop("header.stamp.secs", 0.0))
        rest = numbers.pop("header.stamp.nanosec", numbers.pop("header.stamp.nsecs", 0.0))
        numbers.pop("header.seq", None)
        name = topic.strip("/").replace("/", "_") or "topic"
        rows.setdefault(name, []).append((received, int(seconds) * 10**9 + int(rest), numbers))
    notes += [f"Topic {topic} was left out: {why}" for topic, why in skipped.items()]
    if not rows and skipped:
        topic, why = next(iter(skipped.items()))
        raise DataError(f"No topic of {path.name} can be read. {topic}: {why}")
    return assemble(path, kind, topics_of(_timed(rows, notes)), notes=notes)


def _timed(rows: _Stamped, notes: list[str]) -> Rows:
    """Messages at the times of their headers, or of their arrival."""
    timed: Rows = {}
    first = min((got for every in rows.values() for got, _, _ in every), default=0)
    for name, every in rows.items():
        times = np.array([(got - first, own - first) for got, own, _ in every]) * 1e-9
        # A sensor's own clock is better than the recorder's, if it counts the same time.
        known = min(own for _, own, _ in every) > 0
        agrees = np.abs(times[:, 1] - times[:, 0]).max() < 60.0
        if known and not agrees:
            notes.append(f"{name}: header stamps are of another clock; times of arrival used.")
        clock = times[:, int(known and agrees)]
        timed[name] = [(time, row) for time, (_, _, row) in zip(clock, every, strict=True)]
    return timed


def _flat(message: Any, prefix: str) -> Iterator[tuple[str, float]]:
    """Names and values of all numbers in a message."""
    if isinstance(message, bool | int | float | np.number):
        yield prefix.lstrip("."), float(message)
    for key, value in _parts(message):
        yield from _flat(value, f"{prefix}{key}")


def _parts(message: Any) -> Iterator[tuple[str, Any]]:
    """Fields of a message and entries of a short array, by how they are written."""
    if isinstance(message, Mapping):
        yield from ((f".{key}", value) for key, value in message.items())
    elif is_dataclass(message):
        yield from _parts({key: one for key, one in vars(message).items() if key[:2] != "__"})
    elif isinstance(message, Sequence | np.ndarray) and not isinstance(message, str | bytes):
        few = len(message) <= MOST_ENTRIES
        yield from ((f"[{index}]", value) for index, value in enumerate(message if few else ()))


def read_bag(path: Path) -> Log:
    """Read a ROS 1 bag (file) or a ROS 2 bag (folder).

    Parameters
    ----------
    path : Path
        ``run.bag``, or the folder with ``metadata.yaml``.

    Raises
    ------
    DataError
        If rosbags is missing, or the bag is damaged or was not closed.
    """
    highlevel = library("rosbags.highlevel", "Reading a ROS bag")
    typesys = library("rosbags.typesys", "Reading a ROS bag")
    store = typesys.get_typestore(typesys.Stores.LATEST) if path.is_dir() else None

    def messages() -> _Messages:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            for connection, received, raw in reader.messages():
                content = partial(reader.deserialize, raw, connection.msgtype)
                yield connection.topic, received, content

    return _of_messages(path, "ROS 2 bag" if path.is_dir() else "ROS 1 bag", messages())


def read_mcap(path: Path) -> Log:
    """Read an MCAP file with messages of ROS 1, ROS 2, protobuf or JSON.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If mcap is missing, or nothing in the file can be read.
    """
    reader_module = library("mcap.reader", "Reading an MCAP file")
    decoders: dict[int, Callable[[bytes], Any]] = {}

    def content(schema: Any, channel: Any, raw: bytes) -> Any:
        if channel.id not in decoders:
            decoders[channel.id] = _decoder(schema, channel)
        return decoders[channel.id](raw)

    def messages() -> _Messages:
        with path.open("rb") as stream:
            reader = reader_module.NonSeekingReader(stream)
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                decoded = partial(content, schema, channel, message.data)
                yield channel.topic, message.log_time, decoded

    return _of_messages(path, "MCAP file", messages())


def _decoder(schema: Any, channel: Any) -> Callable[[bytes], Any]:
    """What turns the bytes of a channel into a message."""
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding in ("cdr", "ros1") and schema is not None:
        typesys = library("rosbags.typesys", "Reading an MCAP file of ROS messages")
        name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        text, idl = schema.data.decode(), schema.encoding == "ros2idl"
        store.register(
            typesys.get_types_from_idl(text) if idl else typesys.get_types_from_msg(text, name)
        )
        read = getattr(store, f"deserialize_{channel.message_encoding}")
        return lambda raw: read(raw, name)
    if channel.message_encoding == "protobuf" and schema is not None:
        return _protobuf(schema)
    raise DataError(SAYS["encoding"].format(channel=channel))


def _protobuf(schema: Any) -> Callable[[bytes], Any]:
    """What turns bytes into a message by the descriptors that the file holds."""
    what = "Reading an MCAP file of protobuf messages"
    descriptor = library("google.protobuf.descriptor_pb2", what)
    pools = library("google.protobuf.descriptor_pool", what)
    factory = library("google.protobuf.message_factory", what)
    files = descriptor.FileDescriptorSet.FromString(schema.data)
    kinds = factory.GetMessageClassesForFiles
    pool = pools.DescriptorPool()
    waiting = list(files.file)
    while waiting:  # each file behind those that it needs
        known = {one.name for one in waiting}
        ready = [one for one in waiting if known.isdisjoint(one.dependency)]
        for one in ready:
            pool.Add(one)
        if not ready:
            raise DataError("its protobuf descriptors need each other in a circle.")
        waiting = [one for one in waiting if one not in ready]
    made = kinds([one.name for one in files.file], pool)[schema.name]
    return lambda raw: _of_protobuf(made.FromString(raw))


def _of_protobuf(message: Any) -> dict[str, Any]:
    """Fields of a protobuf message as numbers, lists and tables; a header's stamp as of ROS."""
    return {
        one.name: (
            [_of_protobuf(part) if one.message_type else part for part in value]
            if one.is_repeated
            else _of_protobuf(value)
            if one.message_type
            else value
        )
        for one in message.DESCRIPTOR.fields
        if not (one.message_type and one.message_type.GetOptions().map_entry)
        for value in (getattr(message, one.name),)
    }


# -- NMEA 0183 -------------------------------------------------------------------------

# Few sentences have a time. Where lines begin with one (a number of seconds, an ISO time, or a tag
# block \c:1700000000*hh\), it is used. Otherwise the position sentences' own times (RMC, GGA, GLL,
# ZDA) are the clock, and the sentences between two of them are spread evenly.
_SENTENCE = re.compile(r"[$!][A-Z][A-Z0-9]{2,}[,*].*")
_TAG = re.compile(r"\\[^\\]*?c:(\d{9,16})[^\\]*\\")


def read_nmea(path: Path) -> Log:
    """Read a file of NMEA 0183 sentences.

    Topics are talker and sentence (``HEHDT``), fields those of pynmea2; latitude and longitude
    are in degrees, north and east positive.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If pynmea2 is missing, or no sentence can be read or timed.
    """
    parsed, bad = _sentences(path)
    if not parsed:
        raise DataError(SAYS["no_sentence"].format(path=path, bad=bad))
    notes = [f"{bad} of {bad + len(parsed)} sentences were torn and left out."] if bad else []
    times, words = _times(path, [stamp for _, _, stamp, _ in parsed], [t for *_, t in parsed])
    notes += [words] if words else []
    rows: Rows = {}
    for (topic, numbers, _, _), time in zip(parsed, times, strict=True):
        rows.setdefault(topic, []).append((time, numbers))
    return assemble(path, "NMEA 0183", topics_of(rows), notes=notes)


def sentence_of(line: str) -> tuple[float | None, str, dict[str, float]] | None:
    """Logger's time in front, type and numbers of one line; None if it holds no whole sentence.

    Parameters
    ----------
    line : str
        From a logger or a port.
    """
    before, sentence = _parsed(line)
    return sentence and (_stamp(before), sentence.sentence_type, _numbers(sentence))


def _parsed(line: str) -> tuple[str, Any]:
    """What stands in front of a sentence, and the sentence; None if there is no whole one."""
    pynmea2 = library("pynmea2", "Reading NMEA 0183 sentences")
    if (found := _SENTENCE.search(line)) is None:
        return line, None
    try:
        return line[: found.start()], pynmea2.parse(found.group().strip(), check=True)
    except Exception:  # a wrong checksum or a torn line
        return line, None


_Parsed = tuple[str, dict[str, float], float | None, float | None]


def _sentences(path: Path) -> tuple[list[_Parsed], int]:
    """Topic, numbers, time of the logger and time of day of every sentence; how many are torn."""
    parsed: list[_Parsed] = []
    lines = [line for _, line in text_lines(path) if _SENTENCE.search(line)]
    for line in lines:
        before, sentence = _parsed(line)
        if sentence is not None:
            topic = f"{getattr(sentence, 'talker', '') or ''}{sentence.sentence_type}"
            if sentence.sentence_type == "RPM":  # engines (E) and shafts (S) take turns
                topic += f"_{sentence.source}{sentence.engine_no}"
            parsed.append((topic, _numbers(sentence), _stamp(before), _time_of_day(sentence)))
    return parsed, len(lines) - len(parsed)


def _numbers(sentence: Any) -> dict[str, float]:
    names = [name for _, name, *_ in getattr(sentence, "fields", ())] + ["latitude", "longitude"]
    result = {}
    for name in names:
        if name not in ("lat", "lon", "timestamp", "datestamp"):
            with contextlib.suppress(TypeError, ValueError):
                result[name] = float(getattr(sentence, name, None))  # type: ignore[arg-type]
    return result


def _stamp(before: str) -> float | None:
    """Time of the logger in front of a sentence, in s."""
    tag = _TAG.search(before)
    if tag:
        value = float(tag[1])
        return value * 1e-3 if value > 1e11 else value
    text = before.strip().strip(",;: \t[]")
    number = re.fullmatch(r"\d+(\.\d+)?", text)
    if number:
        return float(text)
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _time_of_day(sentence: Any) -> float | None:
    moment = getattr(sentence, "timestamp", None)
    if moment is None or isinstance(moment, str):
        return None
    return 3600.0 * moment.hour + 60.0 * moment.minute + moment.second + 1e-6 * moment.microsecond


def _times(
    path: Path, stamps: list[float | None], of_day: list[float | None]
) -> tuple[np.ndarray, str]:
    """Time of every sentence, and what was done to find it."""
    if all(stamp is not None for stamp in stamps):
        return np.array(stamps, dtype=float), ""
    known = [index for index, time in enumerate(of_day) if time is not None]
    if not known:
        raise DataError(SAYS["sentences_without_times"].format(path=path))
    moments = np.array([of_day[index] for index in known], dtype=float)
    moments = counted_on(moments)
    # Sentences of one moment come after each other: the first of them has the time.
    first = np.concatenate([[True], np.diff(moments) > 0.0])
    places, values = np.array(known)[first].astype(float), moments[first]
    if len(values) < 2:
        raise DataError(f"{path.name} covers a single moment. Nothing moves in it.")
    # Before the first known moment and after the last one, at the usual pace.
    pace, last = (values[-1] - values[0]) / (places[-1] - places[0]), len(stamps) - 1.0
    begin, end = values[0] - pace * places[0], values[-1] + pace * (last - places[-1])
    times = np.interp(np.arange(last + 1.0), [0.0, *places, last], [begin, *values, end])
    step = float(np.median(np.diff(values)))
    return times, (
        f"Only {len(known)} of {len(stamps)} sentences have a time; the others are spread evenly "
        f"between these ({step:.3g} s apart), which may be wrong by as much. A logger that writes "
        "a time in front of each line is better."
    )


# -- MATLAB files ----------------------------------------------------------------------


def read_matlab(path: Path) -> Log:
    """Read a MAT file with vectors, structures, or Simulink's "structure with time".

    A structure is a topic if it has a vector ``t`` or ``time``; vectors beside each other in
    the workspace belong to the time vector of their length.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If it is damaged or without a time vector, or h5py is missing for one of version 7.3.
    """
    from scipy.io import loadmat

    if b"7.3" in read_bytes(path, 128) or read_bytes(path, 4) == b"\x89HDF":
        content = dict(_hdf(path))
    else:
        content = loadmat(str(path), simplify_cells=True)
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    topics = dict(_topics(path.stem, variables))
    if not topics:
        raise DataError(
            f"{path.name} has no vector of times beside its signals: "
            f"{', '.join(list(variables)[:8]) or 'it is empty'}. Timeseries objects: write "
            "s.time = ts.Time; s.y = ts.Data; save(..., 's', '-v7')."
        )
    return assemble(path, "MATLAB file", topics)


def _hdf(path: Path) -> Iterator[tuple[str, Any]]:
    """Variables of a MATLAB file of version 7.3, which is HDF5: matrices lie transposed there."""
    h5py = library("h5py", "Reading a MATLAB file of version 7.3")

    def value(item: Any) -> Any:
        if isinstance(item, h5py.Group):
            return {name: value(one) for name, one in item.items()}
        kind = item.attrs.get("MATLAB_class", b"")
        plain_kind = item.dtype.kind in "fiub" and kind not in (b"char", b"cell")
        empty = "MATLAB_empty" in item.attrs
        return np.squeeze(item[()].T) if plain_kind and not empty else None

    with h5py.File(path, "r") as file:
        yield from ((name, value(item)) for name, item in file.items() if name[:1] != "#")


def _topics(name: str, content: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Structures with a time, at any depth."""
    vectors = _numeric({k: one for k, one in content.items() if isinstance(one, np.ndarray)})
    clock, beside = _clocked(vectors)
    fields = dict(_fields(beside | dict(_simulink(content)), clock.size))
    if clock.ndim == 1 and clock.size > 1 and fields:
        yield name, (clock, fields)
    for key, value in content.items():
        if isinstance(value, dict) and key != "signals":
            yield from _topics(key, value)


def _clocked(vectors: dict[str, np.ndarray]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The vector that holds the times, empty where none does, and those beside it."""
    series = {key: one for key, one in vectors.items() if one.ndim == 1 and one.size > 1}
    called = next(filter(is_time, vectors), None) or clock_of(series)
    beside = {key: one for key, one in vectors.items() if key != called}
    return (vectors[called] if called else np.empty(0)), beside


def _fields(vectors: dict[str, np.ndarray], n_times: int) -> Iterator[tuple[str, np.ndarray]]:
    """Vectors, and columns of matrices, as long as the times."""
    for key, value in vectors.items():
        if is_time(key):
            continue
        if value.ndim == 1 and value.size == n_times:
            yield key, value
        elif value.ndim == 2 and n_times in value.shape:
            columns = value.T if value.shape[0] == n_times else value
            yield from ((f"{key}[{i}]", column) for i, column in enumerate(columns))


def _simulink(content: dict[str, Any]) -> Iterator[tuple[str, np.ndarray]]:
    """Signals of a "structure with time"."""
    signals = content.get("signals", ())
    for index, one in enumerate([signals] if isinstance(signals, dict) else list(signals)):
        if isinstance(one, dict) and isinstance(one.get("values"), np.ndarray):
            label = str(one.get("label") or f"signal_{index}")
            yield label, np.asarray(one["values"], dtype=float)


# -- which format a log has ------------------------------------------------------------


class Format(NamedTuple):
    """One format: a row of ``formats.toml``, where the columns are explained."""

    words: str
    reader: Callable[[Path], Log]
    endings: Sequence[str]
    advice: str
    starts: Sequence[str] = ()
    marks: Sequence[str] = ()
    needs: str = ""

    def begins(self, start: bytes) -> bool:
        """Whether a file that begins so is one."""
        text = start.decode("latin-1")
        return any(map(text.startswith, self.starts)) or any(mark in text for mark in self.marks)

    def read(self, place: Path) -> Log:
        """Read one file, apart where the parser is somebody else's."""
        if not self.needs:
            return guarded(self.reader, place, self.words, self.advice)
        if find_spec(self.needs) is None:
            library(self.needs, f"Reading {self.words}")
        return read_apart(place, self.words, self.advice)


# The table names the readers above.
_ROWS = tables(__file__)["formats"]
FORMATS = [Format(**row | {"reader": globals()[row["reader"]]}) for row in _ROWS]


def format_of(place: Path) -> Format:
    """Format of a file, by its first bytes, then by its name.

    Raises
    ------
    DataError
        If there is no such file, or its format is not known.
    """
    # A ROS 2 bag is a folder.
    start = b"#ROSBAG" if (place / "metadata.yaml").exists() else _start(place)
    if (begun := next((form for form in FORMATS if form.begins(start)), None)) is not None:
        return begun
    named = next((form for form in FORMATS if place.suffix.lower() in form.endings), None)
    if named is None:
        read = ", ".join(form.words for form in FORMATS)
        raise DataError(f"{place.name} has no format that is known. Read are: {read}.")
    if named.starts:
        raise DataError(SAYS["begins_otherwise"].format(place=place))
    return named


def serve(place: str, target: str) -> None:
    """Read a log in the child process of :mod:`oed_sysid.data.apart`."""

    def read(path: Path) -> Log:
        form = format_of(path)
        return guarded(form.reader, path, form.words, form.advice)

    apart.serve(read, Path(place), Path(target))


def open_log(path: str | Path, *, time: str = "") -> Log:
    r"""Open a log of any format that is known.

    Parameters
    ----------
    path : str or Path
        The file; of a ROS 2 bag, the folder.
    time : str
        Header of the column of time of a CSV file that does not call it so; a file without this
        column is read as without it.

    Returns
    -------
    Log
        Its numeric fields with their times.

    Raises
    ------
    DataError
        If the format is not known, the file is damaged, or the library that reads it is not
        installed.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "run.csv"
    ...     _ = file.write_text("t [s],psi [deg]\n0,1\n0.5,2\n1,3\n")
    ...     log = open_log(file)
    >>> print(log.kind, log.names, log["run.psi [deg]"].rate)
    CSV file ('run.psi [deg]',) 2.0
    """
    place = Path(path).expanduser()
    form = format_of(place)
    if form.reader is read_csv_log:
        form = form._replace(reader=partial(read_csv_log, time=time))
    return form.read(place)


def _start(place: Path) -> bytes:
    """First bytes of a file."""
    if place.is_dir():
        raise DataError(SAYS["plain_folder"].format(folder=str(place)))
    if not (start := read_bytes(place, 1024)):
        raise DataError(f"{place.name} is empty: nothing was logged, or the copy failed.")
    return start
