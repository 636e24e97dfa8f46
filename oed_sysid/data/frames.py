"""Columns of data frames (pandas) and data sets (xarray), as tables of numbers.

Nothing here imports either library: a frame that comes in has been made by it already.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data import SAYS
from oed_sysid.data.csv_columns import TIME_NAMES
from oed_sysid.errors import DataError, library
from oed_sysid.text.csv_table import Table
from oed_sysid.text.units import parse_header

RECORD = "record"


def columns_of(table: Any) -> dict[str, np.ndarray]:
    """Columns of a frame or data set; times that are its index become a column ``t [s]``.

    Parameters
    ----------
    table : pandas.DataFrame or xarray.Dataset
        One row per sample; units in the headers, or in xarray's attribute ``units``.

    Returns
    -------
    dict of str to numpy.ndarray
        Header with unit to values ``(n_rows,)``; numbers as float with NaN where missing, dates
        as seconds since 1970, texts as objects.

    Raises
    ------
    DataError
        If it is neither, or a variable has more than one dimension.
    """
    if hasattr(table, "data_vars") and hasattr(table, "coords"):
        return dict(_variables(table))
    if not (hasattr(table, "columns") and hasattr(table, "index")):
        raise DataError(SAYS["no_frame"].format(kind=type(table).__name__))
    columns = {str(name): plain(_array(table[name])) for name in table.columns}
    return columns if any(map(is_time, columns)) else {**_times_of(table.index), **columns}


def _times_of(index: Any) -> dict[str, np.ndarray]:
    """The index of a frame as a column of times, if it holds such."""
    values, named = _array(index), str(index.name or "")
    if values.dtype.kind not in "mM" and not is_time(named):
        return {}
    stated = parse_header(named)[1] if values.dtype.kind != "m" else None
    return {named if stated else "t [s]": plain(values)}


def tables_of(table: Any, name: str) -> Iterator[tuple[str, Table]]:
    """Yield name and table of every record of a frame; a column ``record`` tells them apart.

    Parameters
    ----------
    table : pandas.DataFrame or xarray.Dataset
        The frame.
    name : str
        Name of the record where no column tells.
    """
    columns = columns_of(table)
    labels = columns.pop(RECORD, None)
    if not columns:
        raise DataError(f"The frame {name!r} has no columns.")
    parts: dict[str, np.ndarray] = {name: np.arange(len(next(iter(columns.values()))))}
    if labels is not None:
        texts = np.array([str(label) for label in labels])
        parts = {text: np.flatnonzero(texts == text) for text in dict.fromkeys(texts)}
    for part, rows in parts.items():
        values, faults = [], {}
        for index, (header, column) in enumerate(columns.items()):
            if column.dtype.kind == "O":
                faults[index] = f"Column {header!r} of {part!r} holds {column[rows[0]]!r:.40}."
                values.append(np.full(rows.size, np.nan))
            else:
                values.append(column[rows])
        stacked = np.column_stack(values)
        yield part, Table(Path(part), tuple(columns), stacked, rows + 1, {}, faults)


def _variables(table: Any) -> Iterator[tuple[str, np.ndarray]]:
    for name in [*table.coords, *table.data_vars]:
        variable = table[name]
        if variable.ndim != 1:
            raise DataError(SAYS["dimensions"].format(name=name, dimensions=tuple(variable.dims)))
        values, header = np.asarray(variable.to_numpy()), str(name)
        unit = variable.attrs.get("units")
        if values.dtype.kind == "m":
            header, unit = "t" if is_time(header) else header, "s"
        stated = not unit or parse_header(header)[1] is not None
        yield header if stated else f"{header} [{unit}]", plain(values)


def _array(column: Any) -> np.ndarray:
    """Values of a column or an index: without time zone (UTC), missing numbers as NaN."""
    if getattr(column.dtype, "tz", None) is not None:
        column = column.tz_convert(None) if hasattr(column, "tz_convert") else column
        column = column.dt.tz_convert(None) if getattr(column.dtype, "tz", None) else column
    values = np.asarray(column.to_numpy())
    if values.dtype.kind == "O" and getattr(column.dtype, "kind", "O") in "fiub":
        return np.asarray(column.to_numpy(dtype=float, na_value=np.nan))
    return values


def plain(values: np.ndarray) -> np.ndarray:
    """Numbers as float, dates as seconds since 1970, spans of time as s, the rest as objects.

    >>> plain(np.array([1, 2])), plain(np.array(["2020-01-01"], dtype="datetime64[s]"))
    (array([1., 2.]), array([1.5778368e+09]))
    """
    if values.dtype.kind == "m":
        return values / np.timedelta64(1, "s")
    if values.dtype.kind == "M":
        whole = values.astype("datetime64[ns]").astype(np.int64)
        return np.where(np.isnat(values), np.nan, whole * 1e-9)
    if values.dtype.kind in "fiub":
        return values.astype(float)
    try:
        return np.array([np.nan if value is None else float(value) for value in values])
    except (TypeError, ValueError):
        return values.astype(object)


def is_time(header: str) -> bool:
    """Whether a header, with or without its unit, is that of a column of times."""
    return header.lower() in TIME_NAMES or parse_header(header)[0].lower() in TIME_NAMES


def frame(columns: Mapping[str, np.ndarray]) -> Any:
    """Make a pandas data frame of columns.

    Raises
    ------
    DataError
        If pandas is not installed.
    """
    return library("pandas", "A data frame").DataFrame(dict(columns))
