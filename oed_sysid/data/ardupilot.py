"""ArduPilot DataFlash logs (.bin), read with pymavlink."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path

import numpy as np

from oed_sysid.data.libraries import library
from oed_sysid.data.log import Log, assemble
from oed_sysid.errors import DataError
from oed_sysid.text.units import dimension

# ArduPilot's words for units that this package writes otherwise.
_SPELLINGS = {
    "m/s/s": "m/s^2",
    "deg/s/s": "deg/s^2",
    "rad/s/s": "rad/s^2",
    "degheading": "deg",
    "deglatitude": "deg",
    "deglongitude": "deg",
    "°C": "degC",
    "PWM": "us",
}
_PREFIXES = {"d": 1e-1, "c": 1e-2, "m": 1e-3, "µ": 1e-6, "n": 1e-9}
# What a log is made of, not what the vehicle did.
_ADMINISTRATION = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "FILE", "CMD")


def read_dataflash(path: Path) -> Log:
    """Read a DataFlash log.

    Topics are the message names, several instances with their number (``IMU_1``); units and
    multipliers are those that the log states itself.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If pymavlink is missing or the file holds no messages.
    """
    reader_module = library("pymavlink.DFReader", "an ArduPilot log (DataFlash)")
    rows: dict[str, list[tuple[float, list[float]]]] = {}
    formats: dict[str, tuple[list[str], dict[str, tuple[str, float]]]] = {}
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            reader = reader_module.DFReader_binary(str(path), zero_time_base=True)
            while True:
                message = reader.recv_msg()
                if message is None:
                    break
                _keep(message, rows, formats)
            if reader.data_len - reader.offset > 0:
                said.write("skipped: the last message is not whole")
            reader.close()
    except Exception as error:  # whatever a damaged file makes of the parser
        if not rows:
            raise DataError(
                f"{path.name} begins as an ArduPilot log but cannot be read "
                f"({str(error)[:100] or type(error).__name__}). Copy it again from the vehicle."
            ) from None
        said.write("bad")
    notes = []
    if "bad" in said.getvalue().lower() or "skipped" in said.getvalue().lower():
        notes.append(f"{path.name} is damaged or breaks off: parts of it were skipped.")
    topics, units = {}, {}
    for topic, messages in rows.items():
        columns, known = formats[topic]
        table = np.array([values for _, values in messages])
        times = np.array([time for time, _ in messages])
        fields = {}
        for index, name in enumerate(columns):
            unit, factor = known.get(name, ("", 1.0))
            if np.isfinite(table[:, index]).any():
                fields[name] = table[:, index] * factor
                if unit:
                    units[f"{topic}.{name}"] = unit
        if fields:
            topics[topic] = (times, fields)
    if not topics:
        raise DataError(
            f"{path.name} holds no message with a time: it is empty, torn, or no DataFlash log. "
            "Copy it again from the vehicle."
        )
    return assemble(path, "ArduPilot log (DataFlash)", topics, units=units, notes=notes)


def _keep(message: object, rows: dict, formats: dict) -> None:
    """Take the numbers of one message, if it has a time of its own."""
    kind = message.get_type()  # type: ignore[attr-defined]
    form = message.fmt  # type: ignore[attr-defined]
    if kind in _ADMINISTRATION or kind == "BAD_DATA":
        return
    clock = next(((name, size) for name, size in _CLOCKS if name in form.columns), None)
    if clock is None:
        return
    time = _number(message, clock[0]) * clock[1]
    topic = kind
    if form.instance_field is not None:
        number = int(_number(message, form.instance_field))
        topic = kind if number == 0 else f"{kind}_{number}"
    columns = [name for name in form.columns if name not in (clock[0], form.instance_field)]
    if topic not in formats:
        formats[topic] = (columns, {name: _unit(form.get_unit(name)) for name in columns})
        rows[topic] = []
    rows[topic].append((time, [_number(message, name) for name in formats[topic][0]]))


_CLOCKS = (("TimeUS", 1e-6), ("TimeMS", 1e-3))


def _number(message: object, name: str) -> float:
    value = getattr(message, name, None)
    return float(value) if isinstance(value, int | float) else np.nan


def _unit(text: str | None) -> tuple[str, float]:
    """Unit as this package writes it, and the factor that brings the numbers into it."""
    if not text or text in ("UNKNOWN", "instance"):
        return "", 1.0
    scaled = re.fullmatch(r"([\d.e+-]+) (.+)", text)
    factor, unit = (float(scaled[1]), scaled[2]) if scaled else (1.0, text)
    unit = _SPELLINGS.get(unit, unit)
    if _known(unit):
        return unit, factor
    prefix, rest = unit[0], _SPELLINGS.get(unit[1:], unit[1:])
    if prefix in _PREFIXES and _known(rest):
        return rest, factor * _PREFIXES[prefix]
    return "", 1.0


def _known(unit: str) -> bool:
    try:
        dimension(unit)
    except DataError:
        return False
    return bool(unit)
