"""Functions of time that several manoeuvres share."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from oed_sysid.errors import ModelError
from oed_sysid.experiments.base import Waveform
from oed_sysid.experiments.checks import FloatArray, Numbers

# A switch at 0.1 * 3 s has happened on the sample at 0.3 s: times this close are the same.
_SAME_TIME = 1e-9


def interval(times: FloatArray, edges: FloatArray) -> NDArray[np.intp]:
    """Return for each time how many of the increasing ``edges`` have passed."""
    return np.searchsorted(edges, times + _SAME_TIME * (1 + np.abs(times)), side="right")


def staircase(
    times: Numbers,
    levels: Numbers,
    *,
    before: float = 0.0,
    rate: float | None = None,
) -> Waveform:
    """Return a command that steps, or moves at a limited rate, to each level.

    Parameters
    ----------
    times : sequence of float, shape (n,)
        Increasing times of the steps [s].
    levels : sequence of float, shape (n,)
        Command ordered at each step.
    before : float
        Command before the first step.
    rate : float or None
        Largest slope [unit/s]; None lets the command jump.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = staircase([1.0], [0.3], rate=0.1)
    >>> print(ramp(np.array([0.0, 2.0, 9.0])))
    [0.  0.1 0.3]
    """
    if rate is None:
        held, edges = np.array([before, *levels]), np.array(times)
        return lambda moments: held[interval(moments, edges)]
    corners, value = [(times[0], before)], before
    for begin, end, level in zip(times, [*times[1:], math.inf], levels, strict=True):
        arrival = begin + abs(level - value) / rate
        corners.append((begin, value))
        if arrival <= end:
            value = level
            corners.append((arrival, value))
        else:
            value += math.copysign(rate * (end - begin), level - value)
    corner_times, corner_values = np.array(corners).T
    return lambda moments: np.interp(moments, corner_times, corner_values)


def about(neutral: float, swing: Waveform) -> Waveform:
    """Return a waveform about a neutral command instead of about zero."""
    return swing if neutral == 0.0 else lambda moments: neutral + swing(moments)


def centre(neutral: float) -> str:
    """Return words for a neutral command that is not zero."""
    return f", about {neutral:g}" if neutral else ""


def within(start: float, end: float, inside: Waveform) -> Waveform:
    """Return ``inside`` of the time since ``start``, and zero outside start to end [s]."""

    def windowed(moments: FloatArray) -> FloatArray:
        running = interval(moments, np.array([start, end])) == 1
        return np.where(running, inside(moments - start), 0.0)

    return windowed


class SlopeLimit:
    """Follow an order that may jump, at a limited rate.

    Between two samples the command moves towards the order of the earlier one,
    as a steering gear does: an order is first seen in the command one sample
    after it was given.

    Parameters
    ----------
    rate : float or None
        Largest slope [unit/s]; None passes every order through.
    initial : float
        Command at the first sample, if there is a rate.
    """

    def __init__(self, rate: float | None, *, initial: float) -> None:
        self._rate = rate
        self._command = initial
        self._order = initial
        self._time: float | None = None

    def follow(self, order: float, time: float) -> float:
        """Return the command at ``time`` [s] and remember the order given there."""
        if self._time is not None and time < self._time:
            raise ModelError(
                f"A controller was asked for {time:g} s after {self._time:g} s. Call it with "
                "increasing times, and make a fresh controller() for each run."
            )
        if self._rate is None:
            self._command = order
        elif self._time is not None:
            reach = self._rate * (time - self._time)
            self._command += min(max(self._order - self._command, -reach), reach)
        self._order, self._time = order, time
        return self._command

    def foreseen(self, order: float, times: FloatArray) -> FloatArray:
        """Commands ``(n_times,)`` at later times [s] while one order stands; nothing is kept."""
        found = np.full(len(times), float(order))
        if self._rate is None:
            return found
        command, standing, time = self._command, self._order, self._time
        for index, now in enumerate(times.tolist()):
            # By the same steps as follow(), so that the same numbers come out.
            if time is not None:
                reach = self._rate * (now - time)
                command += min(max(standing - command, -reach), reach)
            standing, time = order, now
            found[index] = command
            if command == order:
                break
        return found

    def skip(self, order: float, times: FloatArray) -> None:
        """Go on past later times [s] at which one order stood."""
        if len(times):
            self._command = float(self.foreseen(order, times)[-1])
            self._order, self._time = order, float(times[-1])
