"""Cascaded tanks: the validation record, in the form of estimation.csv or as it is published."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.scoreboard.row import place
from benchmarks.scoreboard.table import Table, first_readable, read_table
from oed_sysid import Channels, Record
from oed_sysid.errors import DataError

VALIDATION = "cascaded_tanks/validation.csv"
PUBLISHED = "cascaded_tanks/dataBenchmark.csv"
ESTIMATION = "cascaded_tanks/estimation.csv"
FORM = (
    "the 1024 validation samples, in the form of estimation.csv (t_s,u_V,y_V; the published "
    "dataBenchmark.csv is read as well)"
)
SAMPLES, SAMPLING = 1024, 4.0  # s
LOWEST, HIGHEST = -1.0, 11.0  # V, of pump and level
SAME = 1e-3  # V; five digits are kept of the estimation record


def at_hand() -> list[str]:
    """Files that may hold the validation record."""
    return [path for path in (VALIDATION, PUBLISHED) if place(path).is_file()]


def read_validation(channels: Channels) -> tuple[Record, str]:
    """The validation record, and which file it is from.

    Raises
    ------
    DataError
        If none of the files holds it.
    """
    paths = (place(VALIDATION), place(PUBLISHED))
    (columns, name), fault = first_readable(paths, (_own_form, _published_form))
    record = Record("validation", columns[0], columns[1], columns[2], channels, name)
    return record, f"{name}, because {fault}" if fault else name


def _own_form(path: Path) -> tuple[tuple[np.ndarray, ...], str]:
    """Times, input and level of a file with columns t_s, u_V and y_V."""
    table = read_table(path, {"t_s": ("t", "time_s", "time"), "u_V": ("u",), "y_V": ("y",)})
    _check_length(table.file, len(table))
    times = table.numbers("t_s")
    steps = np.diff(times)
    if np.abs(steps - SAMPLING).max() > 0.01 * SAMPLING:
        line = table.lines[int(np.argmax(np.abs(steps - SAMPLING))) + 1]
        raise DataError(
            f"{path.name} has steps of {steps.min():g} to {steps.max():g} s (line {line}); "
            f"expected {SAMPLING:g} s between samples. Correct t_s."
        )
    return _checked(path.name, table.numbers("u_V"), table.numbers("y_V"), times - times[0])


def _published_form(path: Path) -> tuple[tuple[np.ndarray, ...], str]:
    """The validation columns of the published table, its estimation columns compared."""
    names = ("uEst", "uVal", "yEst", "yVal")
    table = read_table(path, {**{name: () for name in names}, "Ts": ()})
    _check_length(table.file, len(table))
    sampling = table.numbers("Ts", slice(0, 1))[0]
    if abs(sampling - SAMPLING) > 0.01 * SAMPLING:
        raise DataError(f"{path.name} has Ts {sampling:g} s; expected {SAMPLING:g} s. Correct it.")
    own = _estimation()
    if own is not None:
        for name, column in (("uEst", "u_V"), ("yEst", "y_V")):
            if np.abs(table.numbers(name) - own.numbers(column)).max() > SAME:
                raise DataError(
                    f"{path.name}: {name} is not {column} of estimation.csv. Are columns swapped, "
                    "or is it another measurement? Put the published table there."
                )
    times = SAMPLING * np.arange(SAMPLES)
    return _checked(path.name, table.numbers("uVal"), table.numbers("yVal"), times)


def _check_length(file: str, rows: int) -> None:
    if rows != SAMPLES:
        raise DataError(
            f"{file} has {rows} samples; expected the {SAMPLES} of the official validation record. "
            "Put the whole record there."
        )


def _checked(
    file: str, pump: np.ndarray, level: np.ndarray, times: np.ndarray
) -> tuple[tuple[np.ndarray, ...], str]:
    """Columns in volts that are not those of the estimation record."""
    for name, column in (("the input", pump), ("the level", level)):
        if column.min() < LOWEST or column.max() > HIGHEST:
            raise DataError(
                f"{file}: {name} reaches from {column.min():g} to {column.max():g}; expected 0 to "
                "10 V. Give volts."
            )
    own = _estimation()
    if own is not None and np.abs(level - own.numbers("y_V")).max() < SAME:
        raise DataError(
            f"{file} holds the level of the estimation record, which was fitted to. Put the "
            "validation samples there."
        )
    return (times, pump[:, np.newaxis], level[:, np.newaxis]), file


def _estimation() -> Table | None:
    """The estimation record, if it is there."""
    path = place(ESTIMATION)
    return read_table(path, {"u_V": (), "y_V": ()}) if path.is_file() else None
