"""A vehicle's log as it was written: topics, each with its own times."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from oed_sysid.data.derived import derived
from oed_sysid.data.record import closest
from oed_sysid.data.series import Series
from oed_sysid.errors import DataError


@dataclass(frozen=True, eq=False)
class Log:
    """All numeric fields of a log.

    Parameters
    ----------
    path : Path
        The file or folder.
    kind : str
        Words for its format.
    series : iterable of Series
        The fields; names are unique.
    origin : str
        What t = 0 is, in words.
    notes : tuple of str
        What the reader has to say: a torn end, drop-outs, a choice of clock.

    Raises
    ------
    DataError
        If there is no numeric field.
    """

    path: Path
    kind: str
    series: tuple[Series, ...] = field(repr=False)
    origin: str = "the first sample of the log"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "series", tuple(self.series))
        if not self.series:
            raise DataError(f"{self.path.name} ({self.kind}) holds no numbers over time.")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all fields."""
        return tuple(one.name for one in self.series)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the log, in s."""
        spans = [one.span for one in self.series]
        return min(first for first, _ in spans), max(last for _, last in spans)

    def __getitem__(self, name: str) -> Series:
        for one in self.series:
            if one.name == name:
                return one
        inside = [known for known in self.names if name.lower() in known.lower()][:4]
        near = f" It has {', '.join(inside)}." if inside else closest(name, self.names)
        raise DataError(
            f"{self.path.name} has no field {name!r}.{near} All fields: oed-sysid import "
            f"{self.path.name} --list"
        )

    def rows(self, text: str = "") -> list[tuple[str, ...]]:
        """Name, samples, rate, span, unit and range of every field whose name holds a text."""
        found: list[tuple[str, ...]] = []
        for one in self.series:
            if text.lower() not in one.name.lower():
                continue
            good = one.values[np.isfinite(one.values)]
            reach = f"{good.min():.5g} to {good.max():.5g}" if good.size else "no number"
            rate = f"{one.rate:.3g} Hz" if np.isfinite(one.rate) else "-"
            unit = one.unit or "?"
            found.append(
                (
                    one.name,
                    str(one.values.size),
                    rate,
                    f"{one.span[0]:.2f} to {one.span[1]:.2f} s",
                    unit + (f" ({one.derived})" if one.derived else ""),
                    reach,
                )
            )
        return found

    def describe(self, text: str = "") -> str:
        """Say what the log holds, one line per field.

        Parameters
        ----------
        text : str
            Only fields whose names hold this.
        """
        rows = [("field", "samples", "rate", "from - to", "unit", "range"), *self.rows(text)]
        widths = [max(len(row[i]) for row in rows) for i in range(6)]
        first, last = self.span
        lines = [f"{self.path.name}: {self.kind}, {last - first:.1f} s; t = 0 is {self.origin}"]
        lines += [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in rows
        ]
        return "\n".join([*lines, *self.notes])


def assemble(
    path: Path,
    kind: str,
    topics: Mapping[str, tuple[np.ndarray, Mapping[str, np.ndarray]]],
    *,
    units: Mapping[str, str] | None = None,
    origin: str | None = None,
    notes: Iterable[str] = (),
) -> Log:
    """Make a log of topics whose times count from anywhere.

    Parameters
    ----------
    path : Path
        Where it comes from.
    kind : str
        Words for its format.
    topics : mapping
        Topic to times ``(n,)`` in s and fields ``(n,)``.
    units : mapping of str to str, optional
        Units that the log states, by ``topic.field``.
    origin : str, optional
        Words for t = 0.
    notes : iterable of str
        What the reader has to say.

    Returns
    -------
    Log
        Times count from the earliest sample; derived fields stand beside the others.

    Examples
    --------
    >>> log = assemble(Path("a.ulg"), "test", {"imu": (np.array([5.0, 5.5]), {"r": np.ones(2)})})
    >>> log.names, log["imu.r"].span
    (('imu.r',), (0.0, 0.5))
    """
    from oed_sysid.data.meanings import unit_of

    used = {}
    for topic, (times, fields) in topics.items():
        # A message with a damaged time tells nothing about when its numbers were.
        good = np.isfinite(times)
        if good.any():
            used[topic] = (times[good], {name: values[good] for name, values in fields.items()})
    first = min((float(times.min()) for times, _ in used.values()), default=0.0)
    series = []
    for topic, (times, fields) in used.items():
        since = np.round(times - first, 9)  # beyond a nanosecond is rounding
        known = {}
        for name, values in fields.items():
            full = f"{topic}.{name}"
            unit = (units or {}).get(full) or unit_of(full)
            known[name] = Series(full, since, values, unit)
        series += [*known.values(), *derived(topic, known)]
    words = {} if origin is None else {"origin": origin}
    return Log(path, kind, tuple(series), notes=tuple(notes), **words)
