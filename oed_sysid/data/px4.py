"""PX4 logs (ULog), read with pyulog."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import numpy as np

from oed_sysid.data.libraries import library
from oed_sysid.data.log import Log, assemble
from oed_sysid.errors import DataError


def read_ulog(path: Path) -> Log:
    """Read a ULog file.

    Topics are named as PX4 names them, further instances with their number
    (``sensor_gyro_1``). A torn end is said; what stands before it is used.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If pyulog is missing or cannot read the file.
    """
    pyulog = library("pyulog", "a PX4 log (ULog)")
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            ulog = pyulog.ULog(str(path))
    except Exception as error:  # whatever a damaged file makes of the parser
        raise DataError(
            f"{path.name} begins as a PX4 log but cannot be read ({_words(error)}). Copy it again "
            "from the vehicle; if it broke off in flight, cut its last part off."
        ) from None
    notes = []
    if ulog.file_corruption:
        notes.append(f"{path.name} is damaged: parts of it were skipped.")
    elif _broke_off(path):
        notes.append(f"{path.name} breaks off; what stands before the end is used.")
    if ulog.dropouts:
        lost = sum(one.duration for one in ulog.dropouts) / 1000.0
        notes.append(f"The logger lost samples {len(ulog.dropouts)} times, {lost:.2f} s in all.")
    topics: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]] = {}
    units: dict[str, str] = {}
    for data in ulog.data_list:
        name = data.name if data.multi_id == 0 else f"{data.name}_{data.multi_id}"
        fields = {
            key: np.asarray(values, dtype=float)
            for key, values in data.data.items()
            if key != "timestamp" and np.asarray(values).dtype.kind in "fiub"
        }
        if fields and len(data.data["timestamp"]):
            topics[name] = (np.asarray(data.data["timestamp"], dtype=float) * 1e-6, fields)
        units |= {f"{name}.{key}": "us" for key in fields if "timestamp" in key}
    return assemble(path, "PX4 log (ULog)", topics, units=units, notes=notes)


def _broke_off(path: Path) -> bool:
    """Whether the last message is longer than the file: the parser leaves it out in silence."""
    content = path.read_bytes()
    place = 16  # behind the file's header, message after message: length, kind, body
    while place + 3 <= len(content):
        place += 3 + int.from_bytes(content[place : place + 2], "little")
    return place != len(content)


def _words(error: Exception) -> str:
    text = str(error).strip() or type(error).__name__
    return text[:120]
