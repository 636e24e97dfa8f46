r"""Datasets: records of the same channels, read from and written to CSV files.

Units stand in the headers, as ``theta [deg]`` or ``theta_deg``, and are
converted to SI here; after this border nothing has another unit.

Whether two records hold the same measurement, whatever they are called.

Measurement noise is a fingerprint: two runs of the same manoeuvre never share
it, a copy always does. Record :math:`b` is taken for (a part of) record
:math:`a` if there is one shift :math:`d` of time with

.. math:: y_b(t_i) = y_a(t_i + d) \quad \text{for nearly all } i
          \text{ with a sample of } a \text{ at } t_i + d,

for every output that both have. The shift is voted for: each of a few rows of
one record is looked up among all rows of the other, and every match proposes a
shift. Copies under other names, with another clock, thinned, cut, or written
to a file in other units are found; equality is judged to the digits that a file
keeps. Rows where nothing moves prove nothing and do not count. Smooth records
(simulated without noise) may share a beginning, so there half of the shorter
record has to agree, with every input.
"""

from __future__ import annotations

import glob
import hashlib
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress, product
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data import SAYS
from oed_sysid.data.csv_columns import Columns
from oed_sysid.data.frames import RECORD, frame, tables_of
from oed_sysid.data.record import Record, empty_outputs, nearest
from oed_sysid.errors import DataError, located
from oed_sysid.physics.channels import Channels
from oed_sysid.runtime.constants import IMMATERIAL
from oed_sysid.runtime.display import as_html
from oed_sysid.text.csv_table import Table, read_table, write_table
from oed_sysid.text.units import parse_header

# -- Datasets --------------------------------------------------------------------------


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
                raise DataError(SAYS["records_of_one_name"].format(record=record))
            if record.channels != self.channels:
                raise DataError(SAYS["other_channels"].format(self, record=record))

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
        return located(DataError, "There is no record", [name], self.names)[0]

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
            raise DataError(SAYS["empty_side"].format(n=len(chosen), n_records=len(self)))
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
        """Read records from a pandas data frame, or an xarray data set of variables over time.

        Columns are found and converted as :func:`read_csv` does. The time is a column, or the
        index if that holds dates or is called ``t`` or ``time``. A column ``record`` tells
        several records apart.

        Parameters
        ----------
        table : pandas.DataFrame or xarray.Dataset
            One row per sample, or variables with one dimension, the time; of these units come
            from the attribute ``units``.
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
        _check_channels(channels)
        return cls(tuple(_records(tables_of(table, name), channels, time, units)))

    from_xarray = from_dataframe

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
    >>> from oed_sysid.physics.channels import Input, Output
    >>> channels = Channels((Input("fin", "rad"),), (Output("q", "rad/s"),))
    >>> record = read_csv(path, channels)["step"]
    >>> print(record.duration, record.input("fin").max().round(4))
    2.5 0.1745
    >>> folder.cleanup()
    """
    _check_channels(channels)
    files = _files(paths)
    if name is not None and len(files) > 1:
        raise DataError(SAYS["one_name"].format(name=name, n=len(files)))
    places = [file.resolve() for file in files]
    if twice := [file for i, file in enumerate(files) if places[i] in places[:i]]:
        raise DataError(SAYS["given_twice"].format(file=str(twice[0])))
    names = [name] if name is not None else _names_of(files)
    tables = (
        (one, read_table(file, columns_of_text=True))
        for one, file in zip(names, files, strict=True)
    )
    return Dataset(tuple(_records(tables, channels, time, units)))


def _names_of(files: Sequence[Path]) -> list[str]:
    """Names of records by those of their files; with their folders' where these are alike."""
    stems = [file.stem for file in files]
    return [
        stem if stems.count(stem) == 1 else f"{file.parent.name}/{stem}"
        for file, stem in zip(files, stems, strict=True)
    ]


def write_csv(record: Record, path: str | Path) -> None:
    """Write a record so that :func:`read_csv` returns the same numbers.

    Headers carry SI units; missing samples become empty cells.

    Parameters
    ----------
    record : Record
        The record.
    path : str or Path
        The file, overwritten if it exists.

    Raises
    ------
    FileError
        If the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from oed_sysid import Channels, Output, Record
    >>> channels = Channels((), (Output("psi", "rad"),))
    >>> record = Record("run", np.arange(5.0), np.zeros((5, 0)), np.ones((5, 1)), channels)
    >>> with TemporaryDirectory() as folder:
    ...     write_csv(record, Path(folder) / "run.csv")
    ...     print((Path(folder) / "run.csv").read_text().splitlines()[0])
    t [s],psi [rad]
    """
    headers, values = _columns_of(record)
    measured = [name not in record.missing_outputs for name in record.channels.output_names]
    written = [True] * (1 + len(record.channels.inputs)) + measured
    write_table(Path(path), [*compress(headers, written)], values[:, written])


def _columns_of(record: Record) -> tuple[list[str], np.ndarray]:
    """Headers with SI units and the columns below them, signs as in the log."""
    headers, columns = ["t [s]"], [record.times]
    signals = np.hstack([record.inputs, record.outputs]).T
    for channel, signal in zip(record.channels.all, signals, strict=True):
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
    files = [file for entry in entries for file in _found(entry)]
    if not files:
        raise DataError("No files were given. Name at least one.")
    return files


def _found(entry: str | Path) -> list[Path]:
    """Files that a path, a folder or a pattern stands for."""
    path = Path(entry).expanduser()
    if path.exists() and not path.is_dir():
        return [path]
    matches = path.glob("[!.]*.csv") if path.is_dir() else map(Path, glob.glob(str(path)))
    if found := sorted(matches):
        return found
    what = "holds no *.csv file" if path.is_dir() else "is no file, folder or pattern"
    raise DataError(f"{str(entry)!r} {what}. Check the path.")


def _check_channels(channels: Channels) -> None:
    if not isinstance(channels, Channels):
        raise DataError(
            f"channels is a {type(channels).__name__}, expected problem.channels or model.channels."
        )


def _records(
    tables: Iterable[tuple[str, Table]],
    channels: Channels,
    time: str | None,
    units: Mapping[str, str] | None,
) -> list[Record]:
    """Records of named tables; what looks suspicious in them is warned of."""
    records = []
    for name, table in tables:
        columns = Columns(table, units or {})
        records.append(_read_record(columns, name, channels, time))
        for suspicion in (*columns.suspicions, *records[-1].notes):
            warnings.warn(suspicion, UserWarning, stacklevel=3)
    return records


def _read_record(columns: Columns, name: str, channels: Channels, time: str | None) -> Record:
    """Assemble a record from the columns of a file."""
    times = columns.times(time)
    inputs = [columns.input(channel) for channel in channels.inputs]
    outputs = [columns.output(channel) for channel in channels.outputs]
    for channel in channels.outputs:
        if not columns.has(channel):
            columns.say_near(channel)
    if not np.isfinite(outputs).any():
        raise DataError(_without_outputs(columns, channels))
    columns.check_units_used(channels)
    measured = np.column_stack(outputs)
    return Record(
        name,
        times,
        np.column_stack(inputs) if inputs else np.empty((times.size, 0)),
        measured,
        channels,
        source=str(columns.path),
        missing_outputs=empty_outputs(measured, channels.output_names),
        ignored_columns=columns.unused,
    )


def _without_outputs(columns: Columns, channels: Channels) -> str:
    """Say why a file measures nothing that was asked for."""
    wanted = ", ".join(channel.column or channel.name for channel in channels.outputs)
    if any(map(columns.has, channels.outputs)):
        return (
            f"{columns.path.name} holds no sample of any output: all cells of {wanted} are empty."
        )
    near = next(filter(None, map(columns.near, channels.outputs)), None)
    return (
        f"{columns.path.name} has none of the outputs {wanted}. {columns.found}"
        f"{f' Did you mean {near!r}?' if near else ''} Rename a header, or set "
        "Output(column=...) in the problem."
    )


# -- whether two records hold the same measurement -------------------------------------


@dataclass(frozen=True)
class _Comparison:
    """What makes two records one measurement.

    Of the span of a signal, conversions of units and decimal digits leave 1e-8 different and
    rounding to four digits 2e-4. What a cubic does not explain is noise, and tells copies apart,
    above ``noise``; without, or below the last digit of a coarse sensor, inputs and nearly all
    rows have to agree.
    """

    tolerance: float
    noise: float | None
    part: float  # of the shorter record that has to have a partner
    agreeing: float  # share of those that have to agree


_COMPARISONS = (
    _Comparison(1e-8, 1e-6, 0.0, 0.9),
    _Comparison(2e-4, 1e-3, 0.5, 0.9),
    _Comparison(1e-8, None, 0.5, 0.995),
)


@dataclass(frozen=True)
class Overlap:
    """What two records have in common.

    Parameters
    ----------
    n_equal : int
        Rows of the second record that the first holds too, among those that move.
    n_rows : int
        Rows of the second record with a partner, among those that move.
    shift : float
        Time of the first record minus that of the second, s.
    """

    n_equal: int
    n_rows: int
    shift: float


def check_disjoint(train: Iterable[Record], validation: Iterable[Record]) -> None:
    """Refuse validation records that are, or are part of, training records.

    Parameters
    ----------
    train, validation : Dataset or iterable of Record
        What is learnt from, and what is judged with; equal channels.

    Raises
    ------
    DataError
        If two of them hold the same measurement; the message names both.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Channels, Output
    >>> channels = Channels((), (Output("r", "rad/s"),))
    >>> rng = np.random.default_rng(0)
    >>> t = np.arange(50.0)
    >>> run, again = (
    ...     Record(name, t, [], np.sin(0.1 * t) + 0.01 * rng.standard_normal(50), channels)
    ...     for name in ("run", "again")
    ... )
    >>> check_disjoint([run], [again])
    >>> check_disjoint([run], [again, run.thin(2).rename("other")])
    Traceback (most recent call last):
    oed_sysid.errors.DataError: Validation record 'other' is training record 'run': 24 of its 25 \
    rows are the same. What was learnt from cannot judge; give records of other runs, or divide \
    with dataset.split().
    """
    for judged, known in product(validation, train):
        if (found := overlap(known, judged)) is None:
            continue
        clock = f", {abs(found.shift):.6g} s {'later' if found.shift > 0 else 'earlier'} there"
        moved = clock if abs(found.shift) > 0.5 * judged.sample_time else ""
        raise DataError(
            f"Validation record {judged.name!r} is training record {known.name!r}: {found.n_equal} "
            f"of its {judged.n_samples} rows are the same{moved}. What was learnt from cannot "
            "judge; give records of other runs, or divide with dataset.split()."
        )


def overlap(a: Record, b: Record) -> Overlap | None:
    """Return what two records have in common; None if they are different measurements.

    Parameters
    ----------
    a, b : Record
        Of equal channels.
    """
    if a.content_hash == b.content_hash:
        return Overlap(b.n_samples, b.n_samples, 0.0)
    if a.outputs.shape[1] != b.outputs.shape[1] or a.inputs.shape[1] != b.inputs.shape[1]:
        return None
    span = _span(np.vstack([a.outputs, b.outputs]))
    noise = np.maximum(_noise(a.outputs, span), _noise(b.outputs, span))
    for how in _COMPARISONS:
        if how.noise is not None and not noise > how.noise:
            continue
        for shift in _shifts(a, b, span, how.tolerance):
            found = _compared(a, b, shift, span, how)
            if found is not None and found.n_rows >= how.part * min(_moving(a), _moving(b)):
                return found
    return None


def _span(signals: np.ndarray) -> np.ndarray:
    """Largest minus smallest value of each signal, shape ``(n_signals,)``; 0 if constant."""
    filled = np.where(np.isfinite(signals).any(axis=0), signals, 0.0)
    span = np.nanmax(filled, axis=0) - np.nanmin(filled, axis=0)
    # A heading of 350 deg that moves by one has lost digits to its size.
    size = np.nanmax(np.abs(filled), axis=0)
    return np.asarray(np.maximum(span, 1e-6 * size))


def _noise(outputs: np.ndarray, span: np.ndarray) -> float:
    """Largest noise of the outputs as a share of their span, from third differences."""
    levels = [0.0]
    for signal, width in zip(outputs.T, span, strict=True):
        present = signal[np.isfinite(signal)]
        if present.size > 7 and width > 0 and np.unique(present).size > present.size // 2:
            # The variance of a third difference of white noise is 20 times its own.
            levels.append(float(np.median(np.abs(np.diff(present, 3))) / np.sqrt(20) / width))
    return max(levels)


def _moves(record: Record) -> np.ndarray:
    """Rows with a measured output that differs from its last value, ``(n_samples,)`` of bool."""
    moves = np.zeros(record.n_samples, dtype=bool)
    for signal in record.outputs.T:
        rows = np.flatnonzero(np.isfinite(signal))
        moves[rows[1:]] |= np.diff(signal[rows]) != 0.0
    return moves


def _moving(record: Record) -> int:
    return int(_moves(record).sum())


def _shifts(a: Record, b: Record, span: np.ndarray, tolerance: float) -> list[float]:
    """Shifts that most of the anchors vote for."""
    votes: list[float] = []
    for one, other, sign in ((a, b, 1.0), (b, a, -1.0)):
        # Rows with most outputs first: they say most.
        moving = np.flatnonzero(_moves(other))
        if not moving.size:
            return []
        count = np.isfinite(other.outputs[moving]).sum(axis=1)
        best = moving[count == count.max()]
        anchors = best[np.unique(np.linspace(0, best.size - 1, 32).astype(int))]
        for row in anchors:
            measured = np.isfinite(other.outputs[row])
            near = np.abs(one.outputs[:, measured] - other.outputs[row, measured])
            matches = np.flatnonzero(np.all(near <= tolerance * span[measured], axis=1))
            if matches.size <= 50:
                votes += (sign * (one.times[matches] - other.times[row])).tolist()
    if not votes:
        return []
    step = max(IMMATERIAL * min(a.sample_time, b.sample_time), 1e-12)
    found = np.array(votes)
    _, first, counts = np.unique(np.round(found / step), return_index=True, return_counts=True)
    order = np.argsort(-counts, kind="stable")[:6]
    return found[first[order]].tolist()


def _compared(
    a: Record, b: Record, shift: float, span: np.ndarray, how: _Comparison
) -> Overlap | None:
    """Compare all rows at one shift; None if they are not the same."""
    partner, distance = nearest(b.times + shift, a.times)
    clock = IMMATERIAL * min(a.sample_time, b.sample_time)
    first, second = a.outputs[partner], b.outputs
    both = np.isfinite(first) & np.isfinite(second)
    compared = (distance <= clock) & both.any(axis=1) & _moves(b)
    with np.errstate(invalid="ignore"):
        equal = np.all(~both | (np.abs(first - second) <= how.tolerance * span), axis=1)
    if how.noise is None and b.inputs.shape[1]:
        width = _span(np.vstack([a.inputs, b.inputs]))
        equal &= np.all(np.abs(a.inputs[partner] - b.inputs) <= how.tolerance * width, axis=1)
    equal &= compared
    n_rows, n_equal = int(compared.sum()), int(equal.sum())
    safe = np.where(span > 0, span, 1.0)
    different = np.unique(np.round(np.where(both, second, 0.0)[equal] / safe, 7), axis=0)
    needed = min(10, max(4, min(_moving(a), _moving(b)) // 2))
    if n_rows and n_equal >= how.agreeing * n_rows and len(different) >= needed:
        return Overlap(n_equal, n_rows, shift)
    return None


def together(train: Dataset, validation: Dataset) -> Dataset:
    """All records; validation records that are called as training records say what they are.

    Parameters
    ----------
    train, validation : Dataset
        With the same channels.

    Returns
    -------
    Dataset
        The training records first.
    """
    taken = set(train.names)
    others = [
        replace(record, name=f"{record.name} (validation)") if record.name in taken else record
        for record in validation
    ]
    return Dataset((*train, *others))
