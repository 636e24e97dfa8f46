"""Tables with a header: CSV, Excel (openpyxl), Parquet (pyarrow), pandas and xarray objects."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.csv_columns import EPOCH, TIME_NAMES
from oed_sysid.data.frames import columns_of, plain
from oed_sysid.data.libraries import library
from oed_sysid.data.log import Log, assemble
from oed_sysid.errors import DataError
from oed_sysid.text.csv_table import read_table
from oed_sysid.text.units import parse_header, to_si


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
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheets = {
            sheet.title: [list(row) for row in sheet.iter_rows(values_only=True)] for sheet in book
        }
        book.close()
    except Exception as error:  # whatever a damaged file makes of the parser
        raise DataError(
            f"{path.name} cannot be read as an Excel workbook ({str(error)[:100]}). Save it again "
            "as .xlsx or as CSV."
        ) from None
    tables = {}
    for title, rows in sheets.items():
        rows = [row for row in rows if any(cell is not None for cell in row)]
        if len(rows) < 3:
            continue
        headers = [str(cell).strip() if cell is not None else "" for cell in rows[0]]
        tables[title.replace(" ", "_")] = {
            header: np.array([_cell(row[i]) for row in rows[1:]])
            for i, header in enumerate(headers)
            if header
        }
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
    try:
        table = parquet.read_table(path)
        columns = {name: plain(table[name].to_numpy()) for name in table.column_names}
    except Exception as error:  # whatever a damaged file makes of the library
        raise DataError(
            f"{path.name} cannot be read as Parquet ({str(error)[:100]}). Write it again."
        ) from None
    return _log(path, "Parquet file", {path.stem: _numeric(columns)})


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
    columns = columns_of(table)
    return _log(Path(name), type(table).__name__, {name: _numeric(columns)})


def _numeric(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: values for name, values in columns.items() if values.dtype.kind == "f"}


def _log(path: Path, kind: str, tables: Mapping[str, Mapping[str, np.ndarray]]) -> Log:
    topics = {}
    for topic, columns in tables.items():
        clock = next(
            (
                header
                for header in columns
                if header.lower() in TIME_NAMES or parse_header(header)[0].lower() in TIME_NAMES
            ),
            None,
        )
        if clock is None:
            continue
        times = to_si(columns[clock], parse_header(clock)[1] or "s")[0]
        fields = {header: values for header, values in columns.items() if header != clock}
        if np.isfinite(times).sum() > 1 and fields:
            topics[topic] = (times, fields)
    if not topics:
        raise DataError(
            f"{path.name} has no column with times. Call it 't [s]' or 'time [s]'; found were "
            f"{', '.join(repr(h) for c in tables.values() for h in list(c)[:6]) or 'no columns'}."
        )
    first = min(float(np.nanmin(times)) for times, _ in topics.values())
    origin = None
    if EPOCH[0] < first < EPOCH[1]:
        origin = f"{datetime.fromtimestamp(first).astimezone().isoformat()}"
    return assemble(path, kind, topics, origin=origin)
