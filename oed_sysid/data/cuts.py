"""Cutting a log into manoeuvres: by time, by what was commanded, or by a state of the vehicle."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.log import Log
from oed_sysid.data.series import Series
from oed_sysid.errors import DataError


@dataclass(frozen=True)
class Cut:
    """One manoeuvre by time.

    Parameters
    ----------
    name : str
        Name of the record.
    start, stop : float
        Times in s since the log's origin.
    """

    name: str
    start: float
    stop: float

    def __post_init__(self) -> None:
        if not self.stop > self.start:
            raise DataError(f"cut {self.name!r} ends at {self.stop} s, before it begins.")


@dataclass(frozen=True)
class CommandCuts:
    """Manoeuvres are where an input leaves its rest value.

    The rest value of an input is the one that it has most of the time (its median). A manoeuvre
    begins ``before`` seconds before the first departure by more than ``threshold``, and ends
    ``after`` seconds after the last one; departures less than ``rest`` seconds apart belong
    together.

    Parameters
    ----------
    threshold : float
        Smallest departure, in the SI unit of the input.
    inputs : tuple of str
        Which inputs; by default all.
    rest : float
        Time at rest that separates manoeuvres, s.
    before, after : float
        Time that is kept before and after, s.
    shortest : float
        Manoeuvres that are shorter are left out, s.

    Examples
    --------
    >>> t = np.arange(0.0, 100.0, 1.0)
    >>> rudder = np.where((t > 20) & (t < 40), 0.2, 0.0)
    >>> cuts = CommandCuts(0.05, before=5.0, after=10.0)
    >>> [(cut.name, cut.start, cut.stop) for cut in cuts.find({"rudder": (t, rudder)}, 99.0)]
    [('manoeuvre_1', 16.0, 50.0)]
    """

    threshold: float
    inputs: tuple[str, ...] = ()
    rest: float = 10.0
    before: float = 5.0
    after: float = 10.0
    shortest: float = 5.0

    def __post_init__(self) -> None:
        if not self.threshold > 0.0:
            raise DataError(f"threshold is {self.threshold}. Give the smallest departure.")
        if min(self.rest, self.before, self.after, self.shortest) < 0.0:
            raise DataError("rest, before, after and shortest are times of 0 s or more.")

    def find(
        self, commands: Mapping[str, tuple[np.ndarray, np.ndarray]], end: float
    ) -> Iterator[Cut]:
        """Yield the manoeuvres.

        Parameters
        ----------
        commands : mapping
            Input to times ``(n,)`` and values ``(n,)``, SI.
        end : float
            Last time of the log, s.
        """
        unknown = [name for name in self.inputs if name not in commands]
        if unknown:
            raise DataError(
                f"[cut_by_commands] names {unknown[0]!r}, which is no input of the mapping. "
                f"Inputs are {', '.join(commands) or 'none'}."
            )
        spans: list[list[float]] = []
        for name in self.inputs or commands:
            times, values = commands[name]
            away = np.abs(values - np.median(values)) > self.threshold
            until = np.append(times[1:], end)  # a command is held until the next
            spans += [[float(times[i]), float(until[i])] for i in np.flatnonzero(away)]
        joined: list[list[float]] = []
        for start, stop in sorted(spans):
            if joined and start - joined[-1][1] < self.rest:
                joined[-1][1] = max(stop, joined[-1][1])
            else:
                joined.append([start, stop])
        number = 0
        for index, (start, stop) in enumerate(joined):
            # What follows one manoeuvre is not the beginning of the next.
            free = joined[index - 1][1] + self.after if index else -np.inf
            after = joined[index + 1][0] if index + 1 < len(joined) else end
            if stop - start < self.shortest:
                continue
            number += 1
            yield Cut(
                f"manoeuvre_{number}",
                max(start - self.before, min(free, start), 0.0),
                min(stop + self.after, after, end),
            )


@dataclass(frozen=True)
class WhileCuts:
    """Manoeuvres are the stretches in which a field has a value, such as a mode or a switch.

    Parameters
    ----------
    field : str
        ``topic.field``.
    equals, above, below : float or None
        One of them: the value, or a limit.
    shortest : float
        Stretches that are shorter are left out, s.

    Examples
    --------
    >>> t = np.arange(0.0, 60.0, 1.0)
    >>> mode = Series("status.mode", t, np.where((t >= 10) & (t < 30), 3.0, 0.0))
    >>> [(cut.start, cut.stop) for cut in WhileCuts("status.mode", equals=3).find(mode, 59.0)]
    [(10.0, 30.0)]
    """

    field: str
    equals: float | None = None
    above: float | None = None
    below: float | None = None
    shortest: float = 5.0

    def __post_init__(self) -> None:
        given = [value for value in (self.equals, self.above, self.below) if value is not None]
        if len(given) != 1:
            raise DataError("Give one of equals, above and below.")

    def of(self, log: Log) -> Iterator[Cut]:
        """Yield the stretches of a log."""
        yield from self.find(log[self.field], log.span[1])

    def find(self, series: Series, end: float) -> Iterator[Cut]:
        """Yield the stretches of one field; its value is held until the next sample."""
        values = series.values
        if self.equals is not None:
            inside = values == self.equals
        elif self.above is not None:
            inside = values > self.above
        else:
            inside = values < self.below
        edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
        until = np.append(series.times, end)
        number = 0
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            start, stop = float(until[first]), float(until[last])
            if stop - start >= max(self.shortest, 1e-9):
                number += 1
                yield Cut(f"manoeuvre_{number}", start, stop)
