"""MATLAB files (.mat up to version 7), read with SciPy."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from oed_sysid.data.log import Log, assemble
from oed_sysid.errors import DataError

_TIMES = ("t", "time", "times", "tout", "timestamp")


def read_matlab(path: Path) -> Log:
    """Read a MAT file with vectors, structures, or Simulink's "structure with time".

    A structure is a topic if it has a vector ``t`` or ``time``; vectors beside each other in
    the workspace belong to the time vector of their length.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If it is of version 7.3, damaged, or without a time vector.
    """
    try:
        content = loadmat(str(path), simplify_cells=True)
    except NotImplementedError:
        raise DataError(
            f"{path.name} is a MATLAB file of version 7.3. Write it again with  save('{path.name}'"
            ", '-v7')  in MATLAB."
        ) from None
    except Exception as error:  # whatever a damaged file makes of the parser
        raise DataError(
            f"{path.name} cannot be read as a MATLAB file ({str(error)[:100]}). Write it again with"
            f"  save('{path.name}', '-v7')"
        ) from None
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    topics = dict(_topics(path.stem, variables))
    if not topics:
        raise DataError(
            f"{path.name} has no vector called t or time beside its signals: "
            f"{', '.join(list(variables)[:8]) or 'it is empty'}. Timeseries objects: write "
            "s.time = ts.Time; s.y = ts.Data; save(..., 's', '-v7')."
        )
    return assemble(path, "MATLAB file", topics)


def _topics(name: str, content: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Structures with a time, at any depth."""
    vectors = {
        key: np.asarray(value, dtype=float)
        for key, value in content.items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.ndim <= 2
    }
    clock = next((vectors[key] for key in vectors if key.lower() in _TIMES), None)
    if clock is not None and clock.ndim == 1 and clock.size > 1:
        fields: dict[str, np.ndarray] = {}
        for key, value in (vectors | dict(_simulink(content))).items():
            if key.lower() in _TIMES:
                continue
            if value.ndim == 1 and value.size == clock.size:
                fields[key] = value
            elif value.ndim == 2 and clock.size in value.shape:
                columns = value.T if value.shape[0] == clock.size else value
                fields |= {f"{key}[{i}]": column for i, column in enumerate(columns)}
        if fields:
            yield name, (clock, fields)
    for key, value in content.items():
        if isinstance(value, dict) and key != "signals":
            yield from _topics(key, value)


def _simulink(content: dict[str, Any]) -> Iterator[tuple[str, np.ndarray]]:
    """Signals of a "structure with time"."""
    signals = content.get("signals", ())
    for index, one in enumerate([signals] if isinstance(signals, dict) else list(signals)):
        if isinstance(one, dict) and isinstance(one.get("values"), np.ndarray):
            label = str(one.get("label") or f"signal_{index}")
            yield label, np.asarray(one["values"], dtype=float)
