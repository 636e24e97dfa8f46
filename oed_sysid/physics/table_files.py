"""Tables of an effect read from CSV files with units in their headers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from oed_sysid.errors import DataError
from oed_sysid.text.callables import Table, check_table
from oed_sysid.text.csv_table import read_table
from oed_sysid.text.units import parse_header, to_si


def table_from_csv(path: str | Path) -> Table:
    r"""Read a table of one or two arguments; the last column holds its values.

    Two columns make a table of one argument, ``phi [deg],gz [m]``, in any order of
    rows. Three make one of two, ``beta [deg],V [m/s],K [N m]``: one row for each point of a
    full grid. Units are converted to SI.

    Returns
    -------
    tuple of ndarray
        ``(x (n,), y (n,))`` or ``(x (n,), y (m,), values (n, m))``, as the ``tables`` of
        an effect or a model take it.

    Raises
    ------
    DataError
        If a header has no unit, or a point of the grid is missing or given twice.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "arm.csv"
    ...     _ = file.write_text("phi [deg],gz [m]\n0,0\n30,0.4\n90,0.1\n")
    ...     x, y = table_from_csv(file)
    >>> print(np.round(x, 3), y)
    [0.    0.524 1.571] [0.  0.4 0.1]
    """
    path = Path(path)
    table = read_table(path)
    columns = []
    for header, column in zip(table.headers, table.values.T, strict=True):
        name, unit = parse_header(header)
        if unit is None:
            raise DataError(
                f"{path.name}: column {header!r} has no unit. Write it as '{name} [deg]', "
                f"'{name} [m]' or '{name} [1]'."
            )
        if np.isnan(column).any():
            row = int(table.row_numbers[np.flatnonzero(np.isnan(column))[0]])
            raise DataError(f"{path.name}, row {row}: column {name!r} is empty. Fill the gap.")
        columns.append(to_si(column, unit)[0])
    if len(columns) == 2:
        order = np.argsort(columns[0], kind="stable")
        return check_table(path.name, (columns[0][order], columns[1][order]))
    if len(columns) != 3:
        raise DataError(
            f"{path.name} has {len(columns)} columns; expected two (x, value) or three "
            "(x, y, value)."
        )
    x, i = np.unique(columns[0], return_inverse=True)
    y, j = np.unique(columns[1], return_inverse=True)
    count = np.zeros((len(x), len(y)), dtype=int)
    np.add.at(count, (i, j), 1)
    if (count != 1).any():
        a, b = np.argwhere(count != 1)[0]
        raise DataError(
            f"{path.name} has {count[a, b]} rows for the point ({x[a]:g}, {y[b]:g}) in SI units; "
            "a table of two arguments needs exactly one for every pair."
        )
    values = np.empty((len(x), len(y)))
    values[i, j] = columns[2]
    return check_table(path.name, (x, y, values))
