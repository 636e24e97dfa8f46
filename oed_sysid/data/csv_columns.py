"""Columns of a table on their way to channels: which one, which unit, which sign.

Words for a column of times that cannot be used: which row, what is wrong, what to do.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import numpy as np

from oed_sysid.data import SAYS
from oed_sysid.data.log import symbol_of
from oed_sysid.data.record import TIME_ADVICE, check_wraps, time_fault
from oed_sysid.errors import DataError, UnitWarning, closest, listed, located
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.runtime.display import counted
from oed_sysid.text.csv_table import Table, time_stamp
from oed_sysid.text.units import (
    converts,
    dimension,
    foreign,
    latin,
    parse_header,
    same_unit,
    to_si,
)

# -- columns of a table on their way to channels ---------------------------------------


# Seconds.
DAY = timedelta(days=1).total_seconds()
TIME_NAMES = ("t", "time", "times", "tout", "timestamp")
# Seconds since 1970 of the years 2000 to 2100: a time there counts from 1970.
EPOCH = tuple(datetime(year, 1, 1, tzinfo=UTC).timestamp() for year in (2000, 2100))
# Nats of the units of a clock that names none.
TIMES = {"s": 0.0, "ms": -1.0, "us": -2.0, "min": -2.0, "h": -4.0}
# What no vehicle reaches, by SI unit.
SUSPICIOUS_SIZE = {"rad": 20.0, "rad/s": 50.0, "m/s": 500.0, "m/s^2": 1e4, "m": 1e8}
# Loggers write in single precision: a larger number is no measurement.
LARGEST_NUMBER = float(np.finfo(np.float32).max)
# Numbers that loggers write where they have no sample.
SENTINELS = (
    *(-99.0, -999.0, -9999.0, -99999.0, -999999.0, 999.0, 9999.0, 99999.0, 999999.0),
    *(9999999.0, -999.25, -32768.0, 32767.0, 65535.0, -2147483648.0, 2147483647.0),
    *(4294967295.0, 1e20, -1e20, 1e30, -1e30, 1e35, 1e37, 9.969209968386869e36, -1e34),
)
# Days before 1970 in spreadsheets, and in MATLAB, which counts a leap year 0 that Python does not.
UNIX = date(1970, 1, 1)
DAYS = ((UNIX - date(1899, 12, 30)).days, UNIX.toordinal() + 366)


class Columns:
    """The columns of one table, found by channel and converted to SI.

    Parameters
    ----------
    table : Table
        The table as read.
    units : mapping of str to str
        Units that take precedence over the headers, by channel name or header.

    Attributes
    ----------
    suspicions : list of str or UnitWarning
        What is not wrong for certain, as warnings for the user.
    """

    def __init__(self, table: Table, units: Mapping[str, str]) -> None:
        self.table = table
        self.units = units
        self.parsed = [parse_header(header) for header in table.headers]
        self.suspicions: list[str | UnitWarning] = []
        self._used: set[int] = set()

    @property
    def path(self) -> Path:
        """The file that the table was read from."""
        return self.table.path

    @property
    def unused(self) -> tuple[str, ...]:
        """Headers that no channel has asked for so far."""
        return tuple(h for i, h in enumerate(self.table.headers) if i not in self._used)

    @property
    def found(self) -> str:
        """Sentence that lists the headers, for messages."""
        return f"Columns found: {listed(map(repr, self.table.headers))}."

    def times(self, time: str | None) -> np.ndarray:
        """Return the times in s, shape ``(n_rows,)``, checked to increase."""
        index = self.time_column(time)
        times = self._times(index)
        check_times(self.table, index, times)
        return times

    def time_column(self, time: str | None = None) -> int:
        """Position of the column of times: of the name given, named as usual, or of dates."""
        wanted = TIME_NAMES if time is None else (time,)
        ways = zip(self.table.headers, self.parsed, strict=True)
        matches = [i for i, (header, (name, _)) in enumerate(ways) if {header, name} & {*wanted}]
        # A name that was given is meant to the letter; a thrust T beside a time t is no time.
        if time is None and not matches:
            matches = [i for i, (name, _) in enumerate(self.parsed) if name.lower() in wanted]
            # Where no name says so, cells that are dates do.
            matches = matches or [*self.table.stamps]
        if len(matches) != 1:
            what = "no" if not matches else "more than one"
            raise DataError(SAYS["time_columns"].format(self, what=what))
        return matches[0]

    def _times(self, index: int) -> np.ndarray:
        """Times in s as they are, or since the first row where the log counts from elsewhere."""
        values = self.table.values[:, index]
        if index in self.table.stamps:
            self._used.add(index)
            self.suspicions.append(
                f"{self._where(index)} holds times of a clock: t = 0 is {self.table.stamps[index]}."
            )
            return values
        times = self._convert(index, Input("time", "s"))
        first = values[0]
        unit = self.units.get("time") or self.parsed[index][1] or "s"
        if not np.isfinite(first) or not np.all(np.isfinite(times)):
            return times
        seconds = to_si(1.0, unit)[0]
        if EPOCH[0] < first * seconds < EPOCH[1]:
            moment = datetime.fromtimestamp(float(first * seconds), UTC)
            self.suspicions.append(
                f"{self._where(index)} counts from 1970: t = 0 is {moment:%Y-%m-%dT%H:%M:%S.%fZ}."
            )
            return np.asarray((values - first) * seconds)
        self._check_seconds(index, times, unit)
        return times

    def _check_seconds(self, index: int, times: np.ndarray, unit: str) -> None:
        """Refuse, or note, times that are no seconds of one clock."""
        if unit == "s":
            self._check_count(index, times)
        jumps = np.flatnonzero(np.diff(times) > 3652.5 * DAY)
        if jumps.size:
            row = int(jumps[0]) + 1
            raise DataError(
                f"Row {self.table.row_numbers[row]} of {self.path.name}: time "
                f"{self._cell(row, index)} after {self._cell(row - 1, index)} is "
                f"{(times[row] - times[row - 1]) / (365.25 * DAY):.0f} years later: the clock was "
                "set. Cut the log there, and read both parts."
            )
        step = float(np.median(np.diff(times))) if times.size > 1 else 0.0
        unlikely = step > 0.0 and odds_of_clock("ms", 1e-3 * step) > odds_of_clock("s", step)
        if unlikely and unit == "s" and "time" not in self.units:
            words = f"{self._where(index)} steps by {step:.4g} s. If it is in "
            words += "milliseconds, write the header as 't [ms]'."
            self.suspicions.append(UnitWarning(words))

    def _check_count(self, index: int, times: np.ndarray) -> None:
        """Refuse numbers under seconds that are digits of a clock, days, or count from 1970."""
        first, where = self.table.values[0, index], self._where(index)
        counted = unit_of_counts(self.table.values[:, index])
        if counted == "clock":
            raise DataError(SAYS["digits_of_a_clock"].format(where=where, first=first))
        if counted == "day":
            origin = max(origin for origin in DAYS if origin < first)
            moment = datetime.fromtimestamp((first - origin) * DAY, UTC)
            raise DataError(
                f"{where} starts at {first:.12g} and steps by {np.median(np.diff(times)):.3g}: it "
                f"seems to count days ({moment:%Y-%m-%d %H:%M}). Write seconds since the first "
                f"row, 86400*({self.table.headers[index]} - {first:.12g})."
            )
        if counted is not None:
            raise DataError(
                f"{where} starts at {first:.12g}, which is no time in s but looks like {counted} "
                f"since 1970. Write the header as 't [{counted}]'."
            )

    def _cell(self, row: int, column: int) -> str:
        return f"{self.table.values[row, column]:.12g}"

    def _where(self, index: int, row: int | None = None) -> str:
        """Words for a column, or for a cell of it."""
        header = self.table.headers[index]
        if row is None:
            return f"Column {header!r} of {self.path.name}"
        return f"Row {self.table.row_numbers[row]} of {self.path.name}, column {header!r}"

    def input(self, channel: Input) -> np.ndarray:
        """Return an input in SI, shape ``(n_rows,)``, checked to be known throughout."""
        index = self._needed(channel)
        values = self._convert(index, channel)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise DataError(
                f"{self._where(index, bad[0])}: input {channel.name!r} is empty, NaN or infinite "
                f"({bad.size} such rows). Inputs have to be known at every time: write what the "
                "command was, or cut the file there."
            )
        return values

    def output(self, channel: Output) -> np.ndarray:
        """Return an output in SI, shape ``(n_rows,)``; all NaN without a column."""
        index = self._find(channel)
        if index is None:
            return np.full(self.table.values.shape[0], np.nan)
        values = self._convert(index, channel)
        infinite = np.flatnonzero(np.isinf(values))
        if infinite.size:
            raise DataError(
                f"{self._where(index, infinite[0])}: output {channel.name!r} is infinite "
                f"({infinite.size} such rows). Leave the cell empty for a missing sample."
            )
        check_wraps(
            channel,
            values,
            self._where(index),
            raw=self.table.values[:, index],
            unit=self.units.get(channel.name) or self.parsed[index][1] or channel.unit,
            at=lambda row: f"in row {self.table.row_numbers[row]}",
            advice='declare Output("{}", "rad", wrap=True) in the problem',
        )
        present = values[np.isfinite(values)]
        if present.size > 1 and np.ptp(present) == 0.0:
            self.suspicions.append(
                f"{self._where(index)} is {present[0]:.6g} in "
                f"all {present.size} rows: it tells nothing. Is the sensor connected?"
            )
        return values

    def has(self, channel: Output) -> bool:
        """Whether an output has a column, be it empty."""
        return self._find(channel) is not None

    def near(self, channel: Output) -> str | None:
        """Header of a column that no channel has asked for and that may be meant for this one."""
        wanted = channel.column or channel.name
        names = {
            name.strip(): self.table.headers[index]
            for index, (name, _) in enumerate(self.parsed)
            if index not in self._used
        }
        for name, header in names.items():
            if re.split(r"\W", name.lower())[0] == wanted.lower() or latin(name) == wanted:
                return header
        lower = {name.lower(): header for name, header in names.items()}
        # So alike is a slip: psi and phsi, not psi and phi.
        alike = difflib.get_close_matches(wanted.lower(), list(lower), n=1, cutoff=0.8)
        return lower[alike[0]] if alike else None

    def say_near(self, channel: Output) -> None:
        """Note a column that may be meant where an output has none; after all were read."""
        header = self.near(channel)
        if header is not None:
            why = "Names are compared letter by letter"
            why += "" if header.isascii() else f", and {foreign(header)}"
            self.suspicions.append(
                f"{self.path.name} has no column {channel.column or channel.name!r}, but "
                f"{header!r}, which is not read. {why}: rename it, or set Output(column=...)."
            )

    def _find(self, channel: Input | Output) -> int | None:
        """Column of a channel: by whole header, then by name without unit."""
        wanted = channel.column or channel.name
        bare = parse_header(channel.column)[0] if channel.column else wanted
        names = [name for name, _ in self.parsed]
        # "psi_deg [deg]" says its unit twice.
        twice = [parse_header(name)[0] if unit else "" for name, unit in self.parsed]
        ways = (self.table.headers, wanted), (names, wanted), (names, bare), (twice, wanted)
        found = ([i for i, one in enumerate(texts) if one == text] for texts, text in ways)
        matches = next(filter(None, found), [])
        if len(matches) > 1:
            headers = " and ".join(repr(self.table.headers[i]) for i in matches)
            raise DataError(SAYS["alike"].format(self, headers=headers, channel=channel))
        return matches[0] if matches else None

    def _needed(self, channel: Input | Output) -> int:
        """Column of a channel that has to have one."""
        if (index := self._find(channel)) is not None:
            return index
        wanted, kind = channel.column or channel.name, type(channel).__name__
        names = dict.fromkeys([*(name for name, _ in self.parsed), *self.table.headers])
        raise DataError(
            f"{self.path.name} has no column {wanted!r} for {kind.lower()} {channel.name!r}. "
            f"{self.found}{closest(wanted, names)} Rename the header, or set "
            f"{kind}(column=...) in the problem."
        )

    def place(self, channel: Input | Output) -> tuple[int, str]:
        """Position and unit of the column of a channel that has to have one."""
        index = self._needed(channel)
        return index, self._unit(index, channel)

    def _convert(self, index: int, channel: Input | Output) -> np.ndarray:
        """One column in SI, with the sign of the channel; shape ``(n_rows,)``."""
        self._used.add(index)
        if index in self.table.faults:
            raise DataError(self.table.faults[index])
        where = self._where(index)
        if index in self.table.stamps:
            raise DataError(SAYS["clock_for_numbers"].format(where=where, channel=channel))
        unit = self._unit(index, channel)
        self._check_plausible(index, where)
        values, si_unit = to_si(self.table.values[:, index], unit)
        size = float(np.nanmax(np.abs(values), initial=0.0))
        self._suspect_size(channel, index, unit, si_unit, size)
        return channel.sign * values

    def _named(self, index: int, channel: Input | Output) -> tuple[str, str | None]:
        """Name of a column and the unit that its header states."""
        header = self.table.headers[index]
        # The channel is called so as a whole: "delta_s" is no delta in seconds.
        return (header, None) if header == channel.name else self.parsed[index]

    def _unit(self, index: int, channel: Input | Output) -> str:
        """Unit of a column, which has to be one that its channel can be given in."""
        header, (name, stated) = self.table.headers[index], self._named(index, channel)
        where, needed = self._where(index), dimension(channel.unit)
        if not np.isclose(to_si(1.0, channel.unit)[0], 1.0, rtol=1e-12):
            raise DataError(
                f"Channel {channel.name!r} is declared in [{channel.unit}]. Channels are SI: "
                f"declare it in [{to_si(1.0, channel.unit)[1]}]; files may use any unit."
            )
        given = (self.units.get(key) for key in (channel.name, header, name))
        asked = next((unit for unit in given if unit is not None), None)
        if asked is None and name != channel.name:
            _check_said_once(where, channel, name, stated)
        # Nothing is said where nothing has to be: of a ratio.
        plain = "1" if needed.is_dimensionless and not needed.radian else None
        unit = next((one for one in (asked, stated, plain) if one is not None), None)
        if unit is None:
            raise DataError(
                f"{where} has no unit. Write the header as '{header} [{channel.unit}]', or "
                f"whichever unit it is in, or, in Python, pass "
                f"units={{{channel.name!r}: {channel.unit!r}}}."
            )
        _check_unit(where, channel, name, unit)
        return unit

    def _suspect_size(
        self, channel: Input | Output, index: int, unit: str, si_unit: str, size: float
    ) -> None:
        """Note what is larger than a vehicle makes it."""
        words = f"{self._where(index)} reaches {size:.3g} {si_unit}, "
        if size <= SUSPICIOUS_SIZE.get(si_unit, np.inf):
            return
        if si_unit == unit == "rad":
            words += "more than three turns. If it is in degrees, write the header as "
            words += f"'{self._named(index, channel)[0]} [deg]'."
        # A compass may count many turns in degrees, and what is no rate of the vehicle, such as a
        # shaft, turns as fast as it likes.
        elif si_unit == "rad" or (si_unit == "rad/s" and symbol_of(channel.name) not in {*"pqr"}):
            return
        else:
            words += f"which no vehicle does. Check that [{unit}] is its unit."
        self.suspicions.append(UnitWarning(words))

    def _check_plausible(self, index: int, where: str) -> None:
        """Refuse numbers that stand for something else, or are too large to be squared."""
        values = self.table.values[:, index]
        size = np.abs(values[np.isfinite(values)])
        if size.size and size.max() > LARGEST_NUMBER:
            row = int(np.nanargmax(np.where(np.isfinite(values), np.abs(values), -1.0)))
            raise DataError(
                f"{self._where(index, row)}: {values[row]:.3g} is no measurement. Leave the "
                "cell empty for a missing sample, or check the unit."
            )
        # Such a mark is the largest of all, so that no other has to be looked for.
        largest = size.max() if size.size else 0.0
        for mark in (mark for mark in SENTINELS if abs(mark) == largest):
            rows = np.flatnonzero(values == mark)
            others = values[np.isfinite(values) & (values != mark)]
            if rows.size and others.size and np.abs(others).max() * 5 < abs(mark):
                raise DataError(
                    f"{where} holds {mark:g} in {rows.size} rows, first in row "
                    f"{self.table.row_numbers[rows[0]]}; all others are between {others.min():.4g} "
                    f"and {others.max():.4g}. It seems to mark missing samples: leave those cells "
                    "empty."
                )

    def check_units_used(self, channels: Channels) -> None:
        """Refuse units for something that is neither a channel nor a column."""
        known = {*channels.input_names, *channels.output_names, "time"}
        known |= {*self.table.headers, *(name for name, _ in self.parsed)}
        located(DataError, f"{self.path.name} has no channel or column", self.units, known)


def _check_said_once(where: str, channel: Input | Output, name: str, unit: str | None) -> None:
    """Refuse a header that says one unit in brackets and another in its name."""
    suffix = parse_header(name)[1]
    if unit is not None and suffix is not None and not same_unit(suffix, unit):
        raise DataError(
            f"{where} says two units, {suffix} and {unit}. Write the one that the numbers are in, "
            f"as '{channel.name} [{unit}]'."
        )


def _check_unit(where: str, channel: Input | Output, name: str, unit: str) -> None:
    """Refuse a unit in which its channel cannot be given."""
    try:
        found = dimension(unit)
    except DataError as error:
        raise DataError(f"{where}: {error}") from error
    if found.radian and re.search("%|percent", unit):
        raise DataError(SAYS["part_of_an_angle"].format(where=where, unit=unit, name=name))
    if not converts(unit, channel.unit):
        mend = "Correct the unit in the header, as"
        if converts(f"{unit} rad", channel.unit):
            factor = 2.0 * np.pi * to_si(1.0, unit)[0]
            mend = f"Multiply the numbers by {factor:.6g} (2 pi rad a revolution) and write"
        raise DataError(
            f"{where} is in [{unit}] but channel {channel.name} needs [{channel.unit}] or a "
            f"unit that converts to it. {mend} '{name} [{channel.unit}]', or choose another column "
            "with column=..."
        )


def odds_of_clock(unit: str, step: float) -> float:
    """Nats of a clock's unit, by the step in s that it makes of a log's.

    Vehicles are logged some times in a second to some times in a minute.

    Examples
    --------
    >>> odds_of_clock("s", 100.0) < odds_of_clock("ms", 0.1)
    True
    """
    return TIMES.get(unit, 0.0) - 0.5 * (float(np.log(step / 0.5)) / 2.5) ** 2


def unit_of_counts(counts: np.ndarray) -> str | None:
    """Unit of a clock by where it begins: of seconds since 1970, or days; None where no one tells.

    A date or a clock in digits is ``"clock"``.

    Examples
    --------
    >>> unit_of_counts(np.array([1.7e12, 1.7e12 + 100])), unit_of_counts(np.arange(5.0))
    ('ms', None)
    """
    good = counts[np.isfinite(counts)]
    if not good.size:
        return None
    for unit in ("s", "ms", "us", "ns"):
        if EPOCH[0] < good[0] * float(to_si(1.0, unit)[0]) < EPOCH[1]:
            return unit
    step = float(np.median(np.diff(good))) if good.size > 1 else 0.0
    until = EPOCH[1] / DAY
    if any(origin < good[0] and good[-1] < origin + until and 0.0 < step < 0.01 for origin in DAYS):
        return "day"
    return "clock" if clock_of_digits(good) else None


def counted_on(moments: np.ndarray) -> np.ndarray:
    """Times of day ``(n,)``, s, across midnight: those that go back by half a day are the next's.

    >>> counted_on(np.array([86398.0, 86399.0, 0.0]))[-1]
    np.float64(86400.0)
    """
    return np.asarray(moments + DAY * np.cumsum(np.diff(moments, prepend=moments[0]) < -0.5 * DAY))


def clock_of_digits(times: np.ndarray) -> bool:
    """Whether numbers are a date or a clock in digits: 115959 is followed by 120000.

    Read as digits, with or without a date before them, they step evenly across a full minute
    where the numbers themselves jump.
    """
    if times.size < 2 or np.any(times % 100.0 >= 60.0):
        return False
    date, clock = np.divmod(times, 1e6)
    minutes, seconds = np.divmod(clock, 100.0)
    hours, minutes = np.divmod(minutes, 100.0)
    if np.any((hours >= 24) | (minutes >= 60)):
        return False
    month, day = np.divmod(date % 1e4, 100.0)
    if date[0] and np.all((month >= 1) & (month <= 12) & (day >= 1) & (day <= 31)):
        return bool(1e5 < date[0] < 1e9)
    steps, read = np.diff(times), np.diff(3600.0 * hours + 60.0 * minutes + seconds)
    jumps = np.abs(steps - read) > 1e-3 * np.median(steps)
    few = 0.0 < jumps.mean() < 0.5
    return bool(not date.any() and few and np.all(read[jumps] < 2.0 * np.median(steps)))


# -- words for a column of times that cannot be used -----------------------------------


def check_times(table: Table, column: int, times: np.ndarray) -> None:
    """Refuse times of which one is missing or not later than the one before.

    Parameters
    ----------
    table : Table
        The table as read.
    column : int
        The column of times.
    times : numpy.ndarray
        Shape ``(n_rows,)``, s.

    Raises
    ------
    DataError
        About the first such time.
    """
    if (fault := time_fault(times)) is None:
        return
    row, what = fault
    where = f"Row {table.row_numbers[row]} of {table.path.name}"
    if np.isnan(times[row]):
        n = int(np.isnan(times).sum())
        raise DataError(SAYS["empty_time"].format(where=where, rows=counted(n, "such row")))
    now, before = (f"{table.values[max(at, 0), column]:.12g}" for at in (row, row - 1))
    if np.array_equal(table.values[row], table.values[row - 1], equal_nan=True):
        raise DataError(f"{where} repeats the row before (time {now}). Remove one of them.")
    if what == "repeats":
        raise DataError(f"{where}: time {now} repeats that of the row before. {TIME_ADVICE}")
    if np.isfinite(times[row]) and np.all(np.diff(times) < 0.0):
        raise DataError(
            f"{table.path.name} runs backwards: its rows stand in reverse. Turn them around."
        )
    after = f" after {before}" if row else ""
    midnight = _past_midnight(table, column, row, times)
    raise DataError(f"{where}: {midnight or f'time {now}{after} {what}. {TIME_ADVICE}'}")


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
