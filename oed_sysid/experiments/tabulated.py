"""Commands given by a table: designed points, or the replay of a record."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.experiments import checks
from oed_sysid.experiments.base import OpenLoop, Waveform
from oed_sysid.experiments.checks import Numbers
from oed_sysid.experiments.waveforms import staircase
from oed_sysid.physics.channels import INTERPOLATIONS


@dataclass(frozen=True)
class Piecewise(OpenLoop):
    """Command through given points; designed inputs have this form.

    Before the first time the first value holds, after the last time the last.

    Parameters
    ----------
    input : str
        Commanded channel.
    times : sequence of float, shape (n,)
        Increasing times [s].
    values : sequence of float, shape (n,)
        Command at each time.
    interpolation : {"hold", "linear"}
        What happens between: keep the last value, or connect the points.

    Examples
    --------
    >>> print(Piecewise("rudder", [0, 2], [0.0, 0.2], interpolation="linear").commands([1, 5]))
    [0.1 0.2]
    """

    kind: ClassVar[str] = "piecewise"
    times: Numbers
    values: Numbers
    _: KW_ONLY
    interpolation: str = "hold"

    def _validate(self) -> None:
        times, values = _table(self._owner, self.times, self.values)
        self._set(
            times=times,
            values=values,
            interpolation=checks.choice(
                self._owner, "interpolation", self.interpolation, INTERPOLATIONS
            ),
        )

    @property
    def duration(self) -> float | None:
        """Until the last time [s]."""
        return self.times[-1]

    def waveform(self) -> Waveform:
        """Return the function of time."""
        return _between(self.times, self.values, self.interpolation)

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"piecewise {self.interpolation} command of {self.input}: {len(self.times)} points "
            f"from {self.times[0]:g} to {self.times[-1]:g} s"
        )


@dataclass(frozen=True)
class FromRecord(OpenLoop):
    """Replay of a recorded command; the first recorded time becomes ``start``.

    Parameters
    ----------
    input : str
        Commanded channel.
    times : sequence of float, shape (n,)
        Times of the record [s], increasing, on any clock.
    values : sequence of float, shape (n,)
        Recorded command, without gaps.
    record : str
        Name of the record, for the description.
    interpolation : {"hold", "linear"}
        What happens between the samples.
    start : float
        Time at which the replay begins [s].

    Examples
    --------
    >>> replay = FromRecord("rudder", [600.0, 601.0], [0.0, 0.2], record="trial_3")
    >>> print(replay.commands([0.0, 1.0]), replay.duration)
    [0.  0.2] 1.0
    """

    kind: ClassVar[str] = "from_record"
    times: Numbers
    values: Numbers
    _: KW_ONLY
    record: str = ""
    interpolation: str = "hold"
    start: float = 0.0

    def _validate(self) -> None:
        times, values = _table(self._owner, self.times, self.values)
        self._set(
            times=times,
            values=values,
            interpolation=checks.choice(
                self._owner, "interpolation", self.interpolation, INTERPOLATIONS
            ),
            start=checks.finite(self._owner, "start", self.start),
        )

    @property
    def duration(self) -> float | None:
        """Until the end of the record [s]."""
        return self.start + self.times[-1] - self.times[0]

    def waveform(self) -> Waveform:
        """Return the function of time."""
        shifted = np.asarray(self.times) - self.times[0] + self.start
        return _between(shifted, self.values, self.interpolation)

    def describe(self) -> str:
        """Return one line in words."""
        source = f" of record {self.record!r}" if self.record else ""
        return f"replay of {self.input}{source}: {len(self.times)} samples from {self.start:g} s"


def _table(owner: str, times: Numbers, values: Numbers) -> tuple[tuple[float, ...], ...]:
    """Return checked times and values."""
    moments = checks.increasing(owner, "times", checks.numbers(owner, "times", times))
    levels = checks.numbers(owner, "values", values)
    if len(moments) != len(levels):
        raise ModelError(
            f"{owner} has {len(moments)} times but {len(levels)} values. Give one value per time."
        )
    return moments, levels


def _between(times: Numbers, values: Numbers, interpolation: str) -> Waveform:
    """Return the function through the points."""
    points, levels = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    if interpolation == "hold":
        return staircase(points.tolist(), levels.tolist(), before=float(levels[0]))
    return lambda moments: np.interp(moments, points, levels)
