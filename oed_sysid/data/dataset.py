"""Datasets: records of the same channels, read from and written to CSV files.

Units stand in the headers, as ``theta [deg]`` or ``theta_deg``, and are
converted to SI here; after this border nothing has another unit.
"""

from __future__ import annotations

import glob
import hashlib
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.csv_columns import Columns
from oed_sysid.data.frames import RECORD, frame, tables_of
from oed_sysid.data.record import Record, closest
from oed_sysid.errors import DataError
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.runtime.display import as_html
from oed_sysid.text.csv_table import read_table, write_table
from oed_sysid.text.units import parse_header

__all__ = ["Dataset", "Record", "read_csv", "write_csv"]


@dataclass(frozen=True, eq=False)
class Dataset:
    """Records of the same channels.

    Parameters
    ----------
    records : iterable of Record
        At least one; names are unique.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Channels, Output
    >>> channels = Channels((), (Output("phi", "rad"),))
    >>> t = np.arange(8.0)
    >>> a = Record("roll_1", t, [], np.cos(t), channels)
    >>> dataset = Dataset((a, a.rename("roll_2"), a.rename("roll_3")))
    >>> train, test = dataset.split(test=["roll_2"])
    >>> train.names, test["roll_2"].n_samples
    (('roll_1', 'roll_3'), 8)
    """

    records: tuple[Record, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "records", tuple(self.records))
        if not self.records:
            raise DataError("A dataset needs at least one record.")
        for index, record in enumerate(self.records):
            if not isinstance(record, Record):
                raise DataError(
                    f"A dataset holds records, but one of these is a {type(record).__name__}."
                )
            if record.name in self.names[:index]:
                raise DataError(
                    f"Two records are called {record.name!r}. Give each of them once, or rename "
                    "one: the file, or in Python the record, with rename()."
                )
            if record.channels != self.channels:
                raise DataError(
                    f"Record {record.name!r} has other channels than {self.records[0].name!r}. "
                    "Read both with the channels of the same model."
                )

    _repr_html_ = as_html

    def __repr__(self) -> str:
        names = ", ".join(self.names[:8]) + (", ..." if len(self) > 8 else "")
        samples = sum(record.n_samples for record in self)
        return f"<Dataset of {len(self)} records, {samples} samples: {names}>"

    def __iter__(self) -> Iterator[Record]:
        return iter(self.records)

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, key: str | int) -> Record:
        if isinstance(key, str):
            return self.records[self._position(key)]
        return self.records[key]

    def __add__(self, other: Dataset | Record) -> Dataset:
        more = (other,) if isinstance(other, Record) else other.records
        return Dataset(self.records + more)

    def _position(self, name: str) -> int:
        if name not in self.names:
            raise DataError(
                f"There is no record {name!r}. The records are {', '.join(self.names)}."
                + closest(name, self.names)
            )
        return self.names.index(name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(record.name for record in self.records)

    @property
    def channels(self) -> Channels:
        """Channels that all records share."""
        return self.records[0].channels

    @property
    def n_samples(self) -> int:
        """Number of times in all records together."""
        return sum(record.n_samples for record in self.records)

    @property
    def only_tests(self) -> bool:
        """Whether no record is a time series: all are independent tests, such as captive ones."""
        return all(record.independent for record in self.records)

    @property
    def content_hash(self) -> str:
        """Digest of the records' values, whatever their names and order."""
        parts = sorted(record.content_hash for record in self.records)
        return hashlib.sha256(" ".join(parts).encode()).hexdigest()

    def split(self, test: str | Iterable[str]) -> tuple[Dataset, Dataset]:
        """Divide into the records to learn from and those to judge with.

        Parameters
        ----------
        test : str or iterable of str
            Names of the records that no choice may touch.

        Returns
        -------
        train, test : Dataset
            The other records, and the named ones.
        """
        names = (test,) if isinstance(test, str) else tuple(test)
        chosen = {self._position(name) for name in names}
        if not 0 < len(chosen) < len(self):
            raise DataError(
                f"A split with {len(chosen)} of {len(self)} records for the test leaves one side "
                "empty. Keep at least one record on each side."
            )
        train = tuple(r for i, r in enumerate(self.records) if i not in chosen)
        return Dataset(train), Dataset(tuple(self.records[i] for i in sorted(chosen)))

    @classmethod
    def from_dataframe(
        cls,
        table: Any,
        channels: Channels,
        *,
        name: str = "record",
        time: str | None = None,
        units: Mapping[str, str] | None = None,
    ) -> Dataset:
        """Read records from a pandas data frame.

        Columns are found and converted as :func:`read_csv` does. The time is a column, or the
        index if that holds dates or is called ``t`` or ``time``. A column ``record`` tells
        several records apart.

        Parameters
        ----------
        table : pandas.DataFrame
            One row per sample.
        channels : Channels
            What to look for.
        name : str
            Name of the record, where there is one.
        time : str, optional
            Header of the time column.
        units : mapping of str to str, optional
            Units of columns without one in the header.

        Raises
        ------
        DataError
            If the frame cannot be used; the message names row and column.

        Examples
        --------
        >>> import pandas
        >>> from oed_sysid.physics.channels import Channels, Output
        >>> channels = Channels((), (Output("r", "rad/s"),))
        >>> frame = pandas.DataFrame({"t [s]": np.arange(6.0), "r [deg/s]": np.full(6, 90.0)})
        >>> dataset = Dataset.from_dataframe(frame, channels, name="turn")
        >>> print(dataset.names, dataset["turn"].output("r")[0].round(6))
        ('turn',) 1.570796
        >>> list(dataset.to_dataframe().columns)
        ['record', 't [s]', 'r [rad/s]']
        """
        if not isinstance(channels, Channels):
            raise DataError(
                f"channels is a {type(channels).__name__}, expected problem.channels or "
                "model.channels."
            )
        records = []
        for part, found in tables_of(table, name):
            columns = Columns(found, units or {})
            records.append(_read_record(columns, part, channels, time))
            for suspicion in (*columns.suspicions, *records[-1].notes):
                warnings.warn(suspicion, UserWarning, stacklevel=2)
        return cls(tuple(records))

    @classmethod
    def from_xarray(
        cls,
        table: Any,
        channels: Channels,
        *,
        name: str = "record",
        time: str | None = None,
        units: Mapping[str, str] | None = None,
    ) -> Dataset:
        """Read records from an xarray data set of variables over time.

        Units come from the attribute ``units`` of each variable; everything else is as in
        :meth:`from_dataframe`.

        Parameters
        ----------
        table : xarray.Dataset
            Variables with one dimension, the time.
        channels : Channels
            What to look for.
        name : str
            Name of the record, where there is one.
        time : str, optional
            Name of the time coordinate.
        units : mapping of str to str, optional
            Units of variables without one.
        """
        return cls.from_dataframe(table, channels, name=name, time=time, units=units)

    def to_dataframe(self) -> Any:
        """All records as one pandas data frame: ``record``, ``t [s]``, then one column per channel.

        Headers carry SI units, so that :meth:`from_dataframe` returns the same numbers.

        Raises
        ------
        DataError
            If pandas is not installed.
        """
        headers, _ = _columns_of(self.records[0])
        parts = [_columns_of(record)[1] for record in self.records]
        labels = [[record.name] * record.n_samples for record in self.records]
        stacked = np.vstack(parts)
        columns: dict[str, Any] = {RECORD: [one for part in labels for one in part]}
        return frame(columns | dict(zip(headers, stacked.T, strict=True)))


def read_csv(
    paths: str | Path | Iterable[str | Path],
    channels: Channels,
    *,
    name: str | None = None,
    time: str | None = None,
    units: Mapping[str, str] | None = None,
) -> Dataset:
    r"""Read records from CSV files.

    The first line holds headers with units: ``theta [deg]``, ``theta(deg)`` or
    ``theta_deg``. Columns are converted to SI and compared with the channels.
    An empty cell or ``nan`` is a sample that was not taken; an output without a
    column is noted in ``missing_outputs``; columns that no channel asks for are
    noted in ``ignored_columns``.

    Parameters
    ----------
    paths : str, Path or iterable of these
        Files, folders (all ``*.csv`` in it) or patterns such as ``"run_*.csv"``.
    channels : Channels
        What to look for; ``column`` and ``sign`` of a channel are respected.
    name : str, optional
        Name of the record, if there is one file; otherwise the file names are used.
    time : str, optional
        Header of the time column; by default ``t`` or ``time``.
    units : mapping of str to str, optional
        Units of columns whose headers cannot be changed, by channel name or
        header, for instance ``{"theta": "rad"}``. They take precedence.

    Returns
    -------
    Dataset
        One record per file.

    Raises
    ------
    DataError
        If a file cannot be used; the message says which row or column, and what
        to do about it.

    Examples
    --------
    >>> import tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = Path(folder.name) / "step.csv"
    >>> rows = [f"{0.5 * i},{10 if i > 1 else 0},{i}" for i in range(6)]
    >>> _ = path.write_text("\n".join(["t_s,fin_deg,q [deg/s]", *rows]))
    >>> channels = Channels((Input("fin", "rad"),), (Output("q", "rad/s"),))
    >>> record = read_csv(path, channels)["step"]
    >>> print(record.duration, record.input("fin").max().round(4))
    2.5 0.1745
    >>> folder.cleanup()
    """
    if not isinstance(channels, Channels):
        raise DataError(
            f"channels is a {type(channels).__name__}, expected problem.channels or model.channels."
        )
    files = _files(paths)
    if name is not None and len(files) > 1:
        raise DataError(
            f"One name, {name!r}, was given for {len(files)} files. Leave it out: "
            "records are named after their files."
        )
    places = [file.resolve() for file in files]
    twice = next((file for i, file in enumerate(files) if places[i] in places[:i]), None)
    if twice is not None:
        raise DataError(
            f"{str(twice)!r} is given twice. Give every record once: a pattern or a folder may "
            "name it already."
        )
    stems = [file.stem for file in files]
    names = [
        stem if stems.count(stem) == 1 else f"{file.parent.name}/{stem}"
        for file, stem in zip(files, stems, strict=True)
    ]
    records = []
    for file, default in zip(files, names, strict=True):
        columns = Columns(read_table(file, columns_of_text=True), units or {})
        records.append(_read_record(columns, name or default, channels, time))
        for suspicion in (*columns.suspicions, *records[-1].notes):
            warnings.warn(suspicion, UserWarning, stacklevel=2)
    return Dataset(tuple(records))


def write_csv(record: Record, path: str | Path) -> None:
    """Write a record so that :func:`read_csv` returns the same numbers.

    Headers carry SI units; missing samples become empty cells.

    Parameters
    ----------
    record : Record
        The record.
    path : str or Path
        The file, overwritten if it exists.
    """
    headers, values = _columns_of(record)
    first = 1 + len(record.channels.inputs)
    written = list(range(first)) + [
        first + index
        for index, name in enumerate(record.channels.output_names)
        if name not in record.missing_outputs
    ]
    write_table(Path(path), [headers[i] for i in written], values[:, written])


def _columns_of(record: Record) -> tuple[list[str], np.ndarray]:
    """Headers with SI units and the columns below them, signs as in the log."""
    headers, columns = ["t [s]"], [record.times]
    channels: list[Input | Output] = [*record.channels.inputs, *record.channels.outputs]
    signals = np.hstack([record.inputs, record.outputs]).T
    for channel, signal in zip(channels, signals, strict=True):
        title = parse_header(channel.column)[0] if channel.column else channel.name
        headers.append(f"{title} [{channel.unit or '-'}]")
        columns.append(channel.sign * signal)
    return headers, np.column_stack(columns)


def _files(paths: str | Path | Iterable[str | Path]) -> list[Path]:
    """Expand folders and patterns; the order is that of names within each."""
    try:
        entries = [paths] if isinstance(paths, str | Path) else [Path(one) for one in paths]
    except TypeError:
        raise DataError(f"{paths!r:.60} names no files. Give a path, or a list of paths.") from None
    files: list[Path] = []
    for entry in entries:
        path = Path(entry).expanduser()
        if path.is_dir():
            found = sorted(p for p in path.glob("*.csv") if not p.name.startswith("."))
        elif path.exists():
            found = [path]
        else:
            found = sorted(Path(match) for match in glob.glob(str(path)))
        if not found:
            what = "holds no *.csv file" if path.is_dir() else "is no file, folder or pattern"
            raise DataError(f"{str(entry)!r} {what}. Check the path.")
        files += found
    if not files:
        raise DataError("No files were given. Name at least one.")
    return files


def _read_record(columns: Columns, name: str, channels: Channels, time: str | None) -> Record:
    """Assemble a record from the columns of a file."""
    times = columns.times(time)
    inputs = [columns.input(channel) for channel in channels.inputs]
    outputs = [columns.output(channel) for channel in channels.outputs]
    for channel in channels.outputs:
        if not columns.has(channel):
            columns.say_near(channel)
    missing = [
        channel.name
        for channel, values in zip(channels.outputs, outputs, strict=True)
        if np.all(np.isnan(values))
    ]
    if len(missing) == len(outputs):
        wanted = ", ".join(channel.column or channel.name for channel in channels.outputs)
        if any(columns.has(channel) for channel in channels.outputs):
            raise DataError(
                f"{columns.path.name} holds no sample of any output: all cells of {wanted} are "
                "empty."
            )
        near = next(filter(None, (columns.near(channel) for channel in channels.outputs)), None)
        raise DataError(
            f"{columns.path.name} has none of the outputs {wanted}. {columns.found}"
            f"{f' Did you mean {near!r}?' if near else ''} Rename a header, or set "
            "Output(column=...) in the problem."
        )
    columns.check_units_used(channels)
    return Record(
        name,
        times,
        np.column_stack(inputs) if inputs else np.empty((times.size, 0)),
        np.column_stack(outputs),
        channels,
        source=str(columns.path),
        missing_outputs=tuple(missing),
        ignored_columns=columns.unused,
    )
