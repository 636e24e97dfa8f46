"""Words for a column of times that cannot be used: which row, what is wrong, what to do."""

from __future__ import annotations

import numpy as np

from oed_sysid.data.record import TIME_ADVICE, time_fault
from oed_sysid.text.csv_cells import time_stamp
from oed_sysid.text.csv_table import Table

DAY = 86_400.0


def time_complaint(table: Table, column: int, times: np.ndarray) -> str | None:
    """Sentences about the first time that is missing or not later than the one before.

    Parameters
    ----------
    table : Table
        The table as read.
    column : int
        The column of times.
    times : numpy.ndarray
        Shape ``(n_rows,)``, s.

    Returns
    -------
    str or None
        ``None`` if the times increase.
    """
    fault = time_fault(times)
    if fault is None:
        return None
    row, what = fault
    where = f"Row {table.row_numbers[row]} of {table.path.name}"
    now = f"{table.values[row, column]:.12g}"
    if np.isnan(times[row]):
        n = int(np.isnan(times).sum())
        return (
            f"{where}: the time is empty or no number ({n} such {'row' if n == 1 else 'rows'}). "
            "Every row needs one: write it, or remove the row."
        )
    before = f"{table.values[row - 1, column]:.12g}" if row else ""
    if what == "repeats":
        if np.array_equal(table.values[row], table.values[row - 1], equal_nan=True):
            return f"{where} repeats the row before (time {now}). Remove one of them."
        return f"{where}: time {now} repeats that of the row before. {TIME_ADVICE}"
    if row and np.isfinite(times[row]) and np.all(np.diff(times) < 0.0):
        return f"{table.path.name} runs backwards: its rows stand in reverse. Turn them around."
    midnight = _past_midnight(table, column, row, times)
    if midnight:
        return f"{where}: {midnight}"
    return f"{where}: time {now}{f' after {before}' if before else ''} {what}. {TIME_ADVICE}"


def _past_midnight(table: Table, column: int, row: int, times: np.ndarray) -> str:
    """Say it where a time of day begins anew; empty if that is not what happened."""
    first = time_stamp(table.stamps.get(column, ""))
    if first is None or first[1] != "clock" or not row:
        return ""
    before, now = first[0] + times[row - 1], first[0] + times[row]
    # Late in the evening, then early in the morning: the same step a day later is a short one.
    if not (before > 0.75 * DAY and 0.0 <= now < 0.25 * DAY):
        return ""
    return (
        f"{_clock(now)} after {_clock(before)} looks like midnight. Write times with their date, "
        f"as 2024-05-31T{_clock(before)}, or go on counting hours: {_clock(now + DAY)}."
    )


def _clock(seconds: float) -> str:
    """Time of day.

    >>> _clock(86390.5)
    '23:59:50.5'
    """
    minutes, rest = divmod(round(seconds, 3), 60.0)
    hours, minutes = divmod(int(minutes), 60)
    whole, _, part = f"{rest:.3f}".partition(".")
    part = part.rstrip("0")
    return f"{hours:02d}:{minutes:02d}:{int(whole):02d}{'.' + part if part else ''}"
