"""Columns of a file that no channel asked for, but whose names say what they are.

A log often holds more than a model needs: positions beside a heading model, say. Where such a
column carries a usual name of a rigid body's motion, kinematics can use it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from oed_sysid.data.record import Record, unwrapped
from oed_sysid.errors import DataError
from oed_sysid.evidence.relations import STANDARD_UNITS
from oed_sysid.text.csv_table import read_table
from oed_sysid.text.units import parse_header, to_si

NAMES = {
    "x0": "x", "xo": "x", "north": "x", "y0": "y", "yo": "y", "east": "y", "z0": "z", "depth": "z",
    "surge": "u", "sway": "v", "vm": "v", "heave": "w", "roll": "phi", "heel": "phi",
    "pitch": "theta", "heading": "psi", "hdg": "psi", "yaw": "psi", "yawrate": "r",
    "pitchrate": "q", "rollrate": "p", "yaw_rate": "r", "pitch_rate": "q", "roll_rate": "p",
}  # fmt: skip
# Words around a name that do not change what it is.
DECORATION = {
    "position", "pos", "velo", "velocity", "mid", "midship", "hat", "meas", "measured",
    "angvelo", "angle", "derived", "estimated", "est", "m",
}  # fmt: skip


def standard_name(header: str) -> tuple[str, str] | None:
    """Return the standard name and the unit of a column; None if its header does not tell.

    Examples
    --------
    >>> standard_name("x_position_mid [m]"), standard_name("heading [deg]")
    (('x', 'm'), ('psi', 'deg'))
    >>> standard_name("dx0_mps"), standard_name("wind_dir_true [rad]")
    (None, None)
    """
    name, unit = parse_header(header)
    words = [word for word in name.lower().split("_") if word not in DECORATION]
    bare = "_".join(words)
    found = NAMES.get(bare, bare)
    if found not in STANDARD_UNITS or unit is None:
        return None
    return found, unit


def spare_signals(record: Record) -> dict[str, np.ndarray]:
    """Signals that the file of a record holds beside its channels.

    Returns
    -------
    dict
        Standard name to series ``(n_samples,)`` in SI at the times of the record; empty if the
        record was not read from a file that is still there.
    """
    wanted: dict[str, tuple[str, str]] = {}
    taken = set(record.channels.output_names) | set(record.channels.input_names)
    for header in record.ignored_columns:
        found = standard_name(header)
        if found is not None and found[0] not in taken and found[0] not in wanted:
            wanted[found[0]] = (header, found[1])
    path = Path(record.source) if record.source else None
    if not wanted or path is None or not _is_file(path):
        return {}
    try:
        table = read_table(path)
        times = _times(table.headers, table.values)
        rows = np.clip(np.searchsorted(times, record.times), 0, times.size - 1)
        if not np.allclose(times[rows], record.times, rtol=0.0, atol=1e-9):
            return {}
        result = {}
        for name, (header, unit) in wanted.items():
            values, si_unit = to_si(table.values[rows, table.headers.index(header)], unit)
            if si_unit.replace(" ", "") != STANDARD_UNITS[name] or not np.isfinite(values).any():
                continue
            result[name] = unwrapped(values) if si_unit == "rad" else values
        return result
    except (DataError, ValueError, IndexError):
        # The check of what was read does not fail over what was not asked for.
        return {}


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:
        return False


def _times(headers: tuple[str, ...], values: np.ndarray) -> np.ndarray:
    """Times of a table in s; raises ValueError where there is no plain time column."""
    for index, header in enumerate(headers):
        name, unit = parse_header(header)
        if name.lower() in ("t", "time", "times", "timestamp"):
            return to_si(values[:, index], unit or "s")[0]
    raise ValueError("no time column")
