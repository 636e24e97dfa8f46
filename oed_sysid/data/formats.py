"""Which format a log has, by its first bytes, then by its name; readers of the simpler ones.

Read here are tables with a header (CSV, Excel with openpyxl, Parquet with pyarrow, objects of
pandas and xarray), PX4 logs (ULog, with pyulog), ArduPilot DataFlash logs (.bin, with pymavlink)
and MATLAB files (.mat up to version 7, with SciPy).
"""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from importlib.util import find_spec
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from oed_sysid.data import apart
from oed_sysid.data.apart import guarded, read_apart
from oed_sysid.data.csv_columns import EPOCH
from oed_sysid.data.frames import columns_of, is_time, plain
from oed_sysid.data.log import TABLE, Log, Rows, assemble, library, topics_of
from oed_sysid.data.nmea import read_nmea
from oed_sysid.data.ros import read_bag, read_mcap
from oed_sysid.errors import DataError
from oed_sysid.text.csv_table import read_table
from oed_sysid.text.units import is_unit, parse_header, to_si

# -- tables with a header --------------------------------------------------------------


def read_csv_log(path: Path) -> Log:
    """Read a CSV file as a log of one topic, named after the file."""
    table = read_table(path, columns_of_text=True)
    columns = {
        header: table.values[:, i]
        for i, header in enumerate(table.headers)
        if i not in table.faults
    }
    return _log(path, "CSV file", {path.stem: columns})


def read_excel(path: Path) -> Log:
    """Read an Excel workbook: every sheet is a topic with headers in its first row.

    Raises
    ------
    DataError
        If openpyxl is missing, the file is damaged, or no sheet has a time column.
    """
    openpyxl = library("openpyxl", "an Excel workbook")
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
    parquet = library("pyarrow.parquet", "a Parquet file")
    table = parquet.read_table(path)
    columns = {name: plain(table[name].to_numpy()) for name in table.column_names}
    return _log(path, "Parquet file", {path.stem: columns})


def log_of(table: Any, *, name: str = "table") -> Log:
    """Make a log of a pandas data frame or an xarray data set.

    Parameters
    ----------
    table : pandas.DataFrame or xarray.Dataset
        With a time column, or times as index or coordinate. Units of xarray variables
        are read from their attribute ``units``.
    name : str
        Name of the topic.

    Examples
    --------
    >>> import pandas
    >>> frame = pandas.DataFrame({"t": [0.0, 0.5, 1.0], "r [deg/s]": [0.0, 1.0, 2.0]})
    >>> log_of(frame)["table.r [deg/s]"].unit
    'deg/s'
    """
    return _log(Path(name), type(table).__name__, {name: columns_of(table)})


def _log(path: Path, kind: str, tables: Mapping[str, Mapping[str, np.ndarray]]) -> Log:
    topics = {}
    for topic, columns in tables.items():
        fields = {name: values for name, values in columns.items() if values.dtype.kind == "f"}
        clock = next(filter(is_time, fields), None)
        if clock is None:
            continue
        times = to_si(fields.pop(clock), parse_header(clock)[1] or "s")[0]
        if np.isfinite(times).sum() > 1 and fields:
            topics[topic] = (times, fields)
    if not topics:
        found = ", ".join(repr(h) for columns in tables.values() for h in list(columns)[:6])
        raise DataError(
            f"{path.name} has no column with times. Call it 't [s]' or 'time [s]'; found were "
            f"{found or 'no columns'}."
        )
    first = min(float(np.nanmin(times)) for times, _ in topics.values())
    origin = None
    if EPOCH[0] < first < EPOCH[1]:
        origin = datetime.fromtimestamp(first).astimezone().isoformat()
    return assemble(path, kind, topics, origin=origin)


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
    pyulog = library("pyulog", "a PX4 log (ULog)")
    with contextlib.redirect_stdout(io.StringIO()):
        ulog = pyulog.ULog(str(path))
    notes = []
    if ulog.file_corruption:
        notes.append(f"{path.name} is damaged: parts of it were skipped.")
    elif _broke_off(path):
        notes.append(f"{path.name} breaks off; what stands before the end is used.")
    if ulog.dropouts:
        lost = sum(one.duration for one in ulog.dropouts) / 1000.0
        notes.append(f"The logger lost samples {len(ulog.dropouts)} times, {lost:.2f} s in all.")
    topics: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]] = {}
    units: dict[str, str] = {}
    for data in ulog.data_list:
        name = data.name if data.multi_id == 0 else f"{data.name}_{data.multi_id}"
        fields = {
            key: np.asarray(values, dtype=float)
            for key, values in data.data.items()
            if key != "timestamp" and np.asarray(values).dtype.kind in "fiub"
        }
        clock = np.asarray(data.data.get("timestamp", ()), dtype=float)
        if fields and clock.size:
            topics[name] = (clock * 1e-6, fields)
        units |= {f"{name}.{key}": "us" for key in fields if "timestamp" in key}
    return assemble(path, "PX4 log (ULog)", topics, units=units, notes=notes)


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
    rows, units, said = _messages(path)
    notes = []
    if "bad" in said or "skipped" in said:
        notes.append(f"{path.name} is damaged or breaks off: parts of it were skipped.")
    if not rows:
        raise DataError(
            f"{path.name} holds no message with a time: it is empty, torn, or no DataFlash log. "
            "Copy it again from the vehicle."
        )
    kind = "ArduPilot log (DataFlash)"
    return assemble(path, kind, topics_of(rows), units=units, notes=notes)


def _messages(path: Path) -> tuple[Rows, dict[str, str], str]:
    """Rows of every topic and units of every field, and what the reader complained of."""
    reader_module = library("pymavlink.DFReader", "an ArduPilot log (DataFlash)")
    rows: Rows = {}
    units: dict[str, tuple[str, float]] = {}
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            reader = reader_module.DFReader_binary(str(path), zero_time_base=True)
            for message in iter(reader.recv_msg, None):
                _keep(message, rows, units)
            if reader.data_len - reader.offset > 0:
                said.write("skipped: the last message is not whole")
            reader.close()
    except Exception:  # whatever a damaged file makes of the parser
        if not rows:
            raise
        said.write("bad")
    known = {name: unit for name, (unit, _) in units.items() if unit}
    return rows, known, said.getvalue().lower()


def _keep(message: Any, rows: Rows, units: dict[str, tuple[str, float]]) -> None:
    """Take the numbers of one message, if it has a time of its own."""
    topic, form = message.get_type(), message.fmt
    clock = next((name for name in _CLOCKS if name in form.columns), None)
    if topic in _ADMINISTRATION or clock is None:
        return
    number = {
        name: float(value)
        for name in form.columns
        if isinstance(value := getattr(message, name, None), int | float)
    }
    time, instance = number.pop(clock, np.nan), number.pop(form.instance_field, 0.0)
    topic = f"{topic}_{instance:.0f}" if instance else topic
    row = {}
    for name, value in number.items():
        full = f"{topic}.{name}"
        if full not in units:
            units[full] = _unit(form.get_unit(name))
        row[name] = value * units[full][1]
    if np.isfinite([*row.values()]).any():
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


# -- MATLAB files ----------------------------------------------------------------------


_TIMES = ("t", "time", "times", "tout", "timestamp")


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
        If it is of version 7.3, damaged, or without a time vector.
    """
    from scipy.io import loadmat

    try:
        content = loadmat(str(path), simplify_cells=True)
    except NotImplementedError:
        raise DataError(
            f"{path.name} is a MATLAB file of version 7.3. Write it again with  save('{path.name}'"
            ", '-v7')  in MATLAB."
        ) from None
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    topics = dict(_topics(path.stem, variables))
    if not topics:
        raise DataError(
            f"{path.name} has no vector called t or time beside its signals: "
            f"{', '.join(list(variables)[:8]) or 'it is empty'}. Timeseries objects: write "
            "s.time = ts.Time; s.y = ts.Data; save(..., 's', '-v7')."
        )
    return assemble(path, "MATLAB file", topics)


def _topics(name: str, content: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Structures with a time, at any depth."""
    vectors = {
        key: np.asarray(value, dtype=float)
        for key, value in content.items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.ndim <= 2
    }
    clock = next((vectors[key] for key in vectors if key.lower() in _TIMES), None)
    if clock is not None and clock.ndim == 1 and clock.size > 1:
        fields = dict(_fields(vectors | dict(_simulink(content)), clock.size))
        if fields:
            yield name, (clock, fields)
    for key, value in content.items():
        if isinstance(value, dict) and key != "signals":
            yield from _topics(key, value)


def _fields(vectors: dict[str, np.ndarray], n_times: int) -> Iterator[tuple[str, np.ndarray]]:
    """Vectors, and columns of matrices, as long as the times."""
    for key, value in vectors.items():
        if key.lower() in _TIMES:
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
    """One format: how it is called and read, how its files begin, and how their names end."""

    words: str
    reader: Callable[[Path], Log]
    starts: tuple[bytes, ...]
    endings: tuple[str, ...]
    needs: str  # library of somebody else, which runs in a process of its own
    advice: str  # what to do about a damaged file
    marks: tuple[bytes, ...] = ()  # what its first bytes hold somewhere

    def read(self, place: Path) -> Log:
        """Read one file, apart where the parser is somebody else's."""
        if not self.needs:
            return guarded(self.reader, place, self.words, self.advice)
        if find_spec(self.needs) is None:
            library(self.needs, self.words)
        return read_apart(place, self.words, self.advice)


_AGAIN = "Copy it again from the vehicle."
_ROS = "If the recorder was killed, repair it with"
FORMATS = (
    Format(
        *("a PX4 log (ULog)", read_ulog, (b"ULog\x01\x12\x35",), (".ulg",), "pyulog"),
        f"{_AGAIN} If it broke off in flight, cut its last part off.",
    ),
    Format(
        *("an ArduPilot log (DataFlash)", read_dataflash, (b"\xa3\x95",), (".bin",), "pymavlink"),
        _AGAIN,
    ),
    Format(
        *("a ROS bag", read_bag, (b"#ROSBAG",), (".bag",), "rosbags"),
        f"{_ROS}  rosbag reindex  or  ros2 bag reindex.",
    ),
    Format(
        *("an MCAP file", read_mcap, (b"\x89MCAP0\r\n",), (".mcap",), "mcap"),
        f"{_ROS}  mcap recover.",
    ),
    Format(
        *("NMEA 0183 sentences", read_nmea, (), (".nmea",), "pynmea2"),
        "Log whole lines, from $ to the checksum.",
        (b"$GP", b"$GN", b"$HE", b"$II", b"$WI", b"!AI", b"$SD"),
    ),
    Format(
        *("a MATLAB file", read_matlab, (b"MATLAB ", b"\x89HDF"), (".mat",), "scipy"),
        "Copy it again, or write it again with  save(..., '-v7').",
    ),
    Format(
        *("an Excel workbook", read_excel, (b"PK\x03\x04",), (".xlsx", ".xlsm"), "openpyxl"),
        "Save it again as .xlsx or as CSV.",
    ),
    Format(
        *("a Parquet file", read_parquet, (b"PAR1",), (".parquet",), "pyarrow"), "Write it again."
    ),
    Format("a CSV file", read_csv_log, (), (".csv", ".tsv", ".txt", ".dat"), "", "Write it again."),
)


def format_of(place: Path) -> Format:
    """Format of a file, by its first bytes, then by its name.

    Raises
    ------
    DataError
        If there is no such file, or its format is not known.
    """
    # A ROS 2 bag is a folder.
    start = b"#ROSBAG" if (place / "metadata.yaml").exists() else _start(place)
    for form in FORMATS:
        if start.startswith(form.starts) or any(mark in start for mark in form.marks):
            return form
    named = next((form for form in FORMATS if place.suffix.lower() in form.endings), None)
    if named is None:
        read = ", ".join(form.words for form in FORMATS)
        raise DataError(f"{place.name} has no format that is known. Read are: {read}.")
    if named.starts:
        raise DataError(
            f"{place.name} ends like a log that is read, but does not begin like one: it is "
            "damaged, or something else. Copy it again from the vehicle."
        )
    return named


def serve(place: str, target: str) -> None:
    """Read a log in the child process of :mod:`oed_sysid.data.apart`."""

    def read(path: Path) -> Log:
        form = format_of(path)
        return guarded(form.reader, path, form.words, form.advice)

    apart.serve(read, Path(place), Path(target))


def open_log(path: str | Path) -> Log:
    r"""Open a log of any format that is known.

    Parameters
    ----------
    path : str or Path
        The file; of a ROS 2 bag, the folder.

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
    return format_of(place).read(place)


def _start(place: Path) -> bytes:
    """First bytes of a file."""
    shown = repr(str(place))
    if "\0" in str(place) or not place.exists():
        raise DataError(f"There is no file {shown}. Check the path.")
    if place.is_dir():
        raise DataError(
            f"{shown} is a folder without metadata.yaml, so no ROS 2 bag. Give one log file, "
            "or write metadata.yaml with  ros2 bag reindex."
        )
    try:
        with place.open("rb") as stream:
            start = stream.read(1024)
    except OSError as error:
        raise DataError(f"{place} cannot be read: {error.strerror or error}.") from None
    if not start:
        raise DataError(f"{place.name} is empty: nothing was logged, or the copy failed.")
    return start
