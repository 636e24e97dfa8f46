"""Twelve free-running tests in a pond, read for the models of this folder.

The logs hold wind as speed and direction, and headings that jump by 2 pi. Here the wind
becomes the velocity of the air, to north and east, which has no jumps, and the heading is
unwound. Velocities, heading and inputs are means over a step; positions are not used,
because they lead velocities and heading by 0.6 to 1 s (README).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from oed_sysid import Channels, Dataset, Record
from oed_sysid.data.third_party import fetch, registered
from oed_sysid.errors import DataError

FOLDER = "esso_osaka/"
SAMPLES_PER_STEP = 5  # 10 Hz to 2 Hz
LEAST_ROWS = 2 * SAMPLES_PER_STEP
HEADER = (
    "t [s]",
    "x_position_mid [m]",
    "u_velo [m/s]",
    "y_position_mid [m]",
    "vm_velo [m/s]",
    "psi_hat [rad]",
    "r_angvelo [rad/s]",
    "n_prop [rps]",
    "delta_rudder [rad]",
    "wind_velo_relative_mid [m/s]",
    "wind_dir_relative_mid [rad]",
    "wind_velo_true [m/s]",
    "wind_dir_true [rad]",
)
# Nothing was fitted to these five; they hold one of each kind of turn, two zigzags, one random run.
VALIDATION = (
    "zigzag_12_30",
    "zigzag_12_20",
    "turn_10_port_35",
    "turn_10_starboard_20",
    "random_6",
)
# Revolutions per second and rudder in degrees stand in the names.
NAMES = {
    "zigzag_31-Jul-2020_13_22_52": "zigzag_10_15",
    "zigzag_31-Jul-2020_13_29_19": "zigzag_12_15",
    "zigzag_31-Jul-2020_13_50_28": "zigzag_12_30",
    "zigzag_31-Jul-2020_13_57_45": "zigzag_15_20",
    "zigzag_31-Jul-2020_14_03_39": "zigzag_12_20",
    "turn_14-Sep-2020_13_39_32": "turn_10_starboard_35",
    "turn_14-Sep-2020_14_16_04": "turn_10_port_35",
    "turn_cut_14-Sep-2020_15_58_08": "turn_10_starboard_20",
    "turn_cut_14-Sep-2020_16_09_02": "turn_10_port_20",
    "random_06-Aug-2020_16_24_25_4": "random_4",
    "random_06-Aug-2020_16_24_25_5": "random_5",
    "random_06-Aug-2020_16_24_25_6": "random_6",
}


def load(path: Path) -> np.ndarray:
    """Rows of one log that are complete, ``(n, 13)``, columns in the published order.

    Columns are found by their names where the header has all of them, by their places otherwise.

    Raises
    ------
    DataError
        If there are other than 13 columns, or fewer than two steps of complete rows.
    """
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        header = [cell.strip().strip('"') for cell in lines.readline().split(",")]
        # A text whose rows are read by commas, so that a row too long or too short is missing.
        rows = [line.strip().split(",") for line in lines if line.strip(" \t\r\n,")]
    while header and not header[-1]:
        header.pop()
    if len(header) != len(HEADER):
        raise DataError(
            f"{path.name} has {len(header)} columns; expected the {len(HEADER)} of the published "
            f"logs, separated by commas, from {HEADER[0]!r} to {HEADER[-1]!r}."
        )
    order = [header.index(name) for name in HEADER] if set(header) == set(HEADER) else None
    table = np.array([_numbers(row) for row in rows]).reshape(-1, len(HEADER))
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < LEAST_ROWS:
        raise DataError(
            f"{path.name} is too short: {len(table)} complete rows of numbers; expected at least "
            f"{LEAST_ROWS}, ten a second. Put a longer log there."
        )
    return table if order is None else table[:, order]


def _numbers(row: list[str]) -> list[float]:
    """The cells of a row; all missing if one is."""
    try:
        numbers = [float(cell) for cell in row[: len(HEADER)]]
    except ValueError:
        numbers = []
    return numbers if len(numbers) == len(HEADER) else [np.nan] * len(HEADER)


def read(path: Path, channels: Channels, *, name: str = "") -> Record:
    """Read one log; its empty rows at the end are left out.

    Parameters
    ----------
    path : Path
        A file in the form of the published ones, 10 Hz.
    channels : Channels
        Of a model of this problem.
    name : str
        Name of the record; that of the file if empty.
    """
    return record_of(load(path), channels, name or NAMES.get(path.stem, path.stem), str(path))


def record_of(table: np.ndarray, channels: Channels, name: str, source: str = "") -> Record:
    """The record of complete rows in the published order, ``(n, 13)``."""
    times, psi = table[:, 0] - table[0, 0], np.unwrap(table[:, 5])
    speed, comes_from = table[:, 11], table[:, 12]
    inputs = [table[:, 8], table[:, 7], -speed * np.cos(comes_from), -speed * np.sin(comes_from)]
    signals = np.column_stack([*inputs, table[:, 2], table[:, 4], table[:, 6], psi])
    means, rows = _means(signals), slice(None, None, SAMPLES_PER_STEP)
    return Record(name, times[rows], means[rows, :4], means[rows, 4:], channels, source)


def _means(signals: np.ndarray) -> np.ndarray:
    """Centred mean over a step, ``(n, n_signals)``; at the ends over what there is."""
    half = SAMPLES_PER_STEP // 2
    sums = np.vstack([np.zeros(signals.shape[1]), np.cumsum(signals, axis=0)])
    index = np.arange(len(signals))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(signals))
    return (sums[high] - sums[low]) / (high - low)[:, None]


def records(channels: Channels) -> Dataset:
    """Return the twelve runs."""
    return Dataset(tuple(read(fetch(path), channels) for path in registered(FOLDER)))


def windows(dataset: Dataset, duration: float = 100.0, *, skip: float = 0.0) -> Dataset:
    """Cut every record into consecutive windows; what is left over at the end is dropped.

    Parameters
    ----------
    dataset : Dataset
        Whole runs.
    duration : float
        Length of a window, s.
    skip : float
        Beginning of each run that is left out, s.
    """
    parts = []
    for record in dataset:
        rest = record.window(record.times[0] + skip, record.times[-1])
        for k in range(int(rest.duration // duration)):
            begin = rest.times[0] + k * duration
            parts.append(
                rest.window(begin, begin + duration).rename(
                    f"{record.name}_{skip + k * duration:g}"
                )
            )
    return Dataset(tuple(parts))
