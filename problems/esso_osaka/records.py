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
COLUMNS = 13
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
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    if table.ndim != 2 or table.shape[1] != COLUMNS:
        raise DataError(
            f"{path} has {table.shape[-1]} columns; expected the {COLUMNS} of the published logs, "
            "from t to the true wind's direction."
        )
    table = table[np.isfinite(table).all(axis=1)]
    times, psi = table[:, 0] - table[0, 0], np.unwrap(table[:, 5])
    speed, comes_from = table[:, 11], table[:, 12]
    inputs = [table[:, 8], table[:, 7], -speed * np.cos(comes_from), -speed * np.sin(comes_from)]
    signals = np.column_stack([*inputs, table[:, 2], table[:, 4], table[:, 6], psi])
    means, rows = _means(signals), slice(None, None, SAMPLES_PER_STEP)
    return Record(
        name or NAMES.get(path.stem, path.stem),
        times[rows],
        means[rows, :4],
        means[rows, 4:],
        channels,
        str(path),
    )


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
