"""From files with other names, units and signs to records: what the page Problem asks for it.

The answers become a :class:`~oed_sysid.data.mapping.LogMapping`, the same that ``oed-sysid import``
reads; files of one layout are read with one mapping, whatever they are called.
"""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from oed_sysid.app.records import plain_name
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.data.logs import Log, LogMapping, Source, import_log, open_log
from oed_sysid.data.logs import draft as guess
from oed_sysid.errors import DataError
from oed_sysid.physics.channels import Channels
from oed_sysid.text.units import parse_header

# Endings of the logs that are read.
ENDINGS = (
    "csv", "tsv", "txt", "ulg", "bin", "bag", "mcap", "mat", "xlsx", "parquet", "nmea",
)  # fmt: skip
TIME_UNITS = ("s", "ms", "min", "h")


@dataclass(frozen=True, eq=False)
class Opened:
    """Logs by the names of their files; what was refused, and why."""

    logs: Mapping[str, Log]
    refused: Mapping[str, str]


def open_files(files: Mapping[str, bytes], time: tuple[str, str] | None = None) -> Opened:
    r"""Open the logs that were given.

    Parameters
    ----------
    files : mapping of str to bytes
        Contents by file name.
    time : (str, str), optional
        Header of the column of time in CSV files, and its unit, where it is not called ``t``.

    Examples
    --------
    >>> opened = open_files({"run.csv": b"clock,yaw [deg]\n0,1\n500,2\n"}, ("clock", "ms"))
    >>> opened.logs["run.csv"].names, opened.logs["run.csv"].span
    (('run.yaw [deg]',), (0.0, 0.5))
    """
    logs, refused = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            path = Path(folder) / plain_name(name)
            path.write_bytes(renamed(content, *time) if time and is_table(name) else content)
            try:
                logs[name] = open_log(path)
            except DataError as error:
                refused[name] = str(error).replace(f"{folder}/", "")
    return Opened(logs, refused)


def is_table(name: str) -> bool:
    """Whether a file is a table in text."""
    return Path(name).suffix.lower() in (".csv", ".tsv", ".txt")


def headers(content: bytes) -> list[str]:
    r"""Headers of a table in text; the first line that is no comment.

    >>> headers(b"# log of May\nclock;yaw [deg]\n0;1\n")
    ['clock', 'yaw [deg]']
    """
    line = _header_line(content.decode("utf-8-sig", errors="replace"))
    if not line:
        return []
    mark = max(";\t,", key=line.count)
    return [one.strip() for one in next(csv.reader(io.StringIO(line), delimiter=mark))]


def renamed(content: bytes, header: str, unit: str) -> bytes:
    r"""A table whose column of time is called ``t``.

    >>> renamed(b"clock,yaw\n0,1\n", "clock", "ms")
    b't [ms],yaw\n0,1\n'
    """
    text = content.decode("utf-8-sig", errors="replace")
    line = _header_line(text)
    names = headers(content)
    if not line or header not in names:
        return content
    mark = max(";\t,", key=line.count)
    made = io.StringIO()
    row = [f"t [{unit}]" if one == header else one for one in names]
    csv.writer(made, delimiter=mark, lineterminator="").writerow(row)
    return text.replace(line, made.getvalue(), 1).encode()


def _header_line(text: str) -> str:
    for line in text.splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            return line
    return ""


def first_guess(log: Log, channels: Channels) -> dict[str, Source]:
    r"""What names and units say about each channel, inputs and outputs alike.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> log = open_files({"a.csv": b"t,psi [deg]\n0,1\n1,2\n"}).logs["a.csv"]
    >>> found = first_guess(log, load_problem("esso_osaka").channels)
    >>> list(found), found["psi"].wrap
    (['psi'], True)
    """
    made = guess(log, channels)
    if made is None:
        return {}
    both = {**made.inputs, **made.outputs}
    return {name: source for name, source in both.items() if source.field}


def unit_of(log: Log, field: str) -> str:
    r"""Unit of a field, where the log or its header says it.

    >>> unit_of(open_files({"a.csv": b"t,u [kn]\n0,1\n1,2\n"}).logs["a.csv"], "a.u [kn]")
    'kn'
    """
    return log[field].unit or parse_header(field)[1] or ""


def for_file(mapping: LogMapping, log: Log) -> LogMapping:
    r"""The mapping with the fields of another file of the same layout.

    A field of a table is called after its file; where a log has no field of a name, the one with
    the same name behind the first point is meant.

    Examples
    --------
    >>> logs = open_files({n: b"t,yaw [deg]\n0,1\n1,2\n" for n in ("a.csv", "b.csv")}).logs
    >>> mapping = LogMapping({}, {"psi": Source("a.yaw [deg]")})
    >>> for_file(mapping, logs["b.csv"]).outputs["psi"].field
    'b.yaw [deg]'
    """
    tails = {name.partition(".")[2]: name for name in reversed(log.names)}

    def here(source: Source) -> Source:
        tail = source.field.partition(".")[2]
        if not source.field or source.field in log.names or tail not in tails:
            return source
        return replace(source, field=tails[tail])

    return replace(
        mapping,
        inputs={name: here(one) for name, one in mapping.inputs.items()},
        outputs={name: here(one) for name, one in mapping.outputs.items()},
    )


def imported(
    opened: Opened, mapping: LogMapping, channels: Channels
) -> tuple[Dataset | None, dict[str, str], tuple[str, ...]]:
    """Make records of all files.

    Parameters
    ----------
    opened : Opened
        The files.
    mapping : LogMapping
        Which field is which channel.
    channels : Channels
        Those of the problem.

    Returns
    -------
    records : Dataset or None
        Of the files that can be used.
    refused : dict of str to str
        Why the others cannot, by file name.
    notes : tuple of str
        What was done to the numbers.
    """
    records: list[Record] = []
    refused = dict(opened.refused)
    notes: list[str] = []
    for name, log in opened.logs.items():
        try:
            made = import_log(log, for_file(mapping, log), channels)
        except DataError as error:
            refused[name] = str(error)
            continue
        taken = {record.name for record in records}
        for record in made.dataset:
            again = record.name in taken
            records.append(
                replace(record, name=f"{Path(name).stem}_{record.name}") if again else record
            )
        notes += made.notes
    return (Dataset(tuple(records)) if records else None), refused, tuple(dict.fromkeys(notes))
