"""Manoeuvres made of manoeuvres: at the same time, in turn, limited."""

from __future__ import annotations

from collections import abc
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from itertools import accumulate
from typing import ClassVar

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.experiments.base import (
    Controller,
    Excitation,
    Manoeuvre,
    Numbers,
    Rule,
    Stepwise,
    numbers,
    positive,
)
from oed_sysid.experiments.reacting import SlopeLimit
from oed_sysid.experiments.schedules import interval


@dataclass(frozen=True)
class Combined(Excitation):
    """Several manoeuvres at the same time, each on an input of its own.

    Parameters
    ----------
    manoeuvres : sequence of Manoeuvre
        One for each input.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import Constant, TurningCircle
    >>> trial = Combined((Constant("thrust", 700.0), TurningCircle("rudder", 0.6)))
    >>> trial.inputs
    ('thrust', 'rudder')
    """

    kind: ClassVar[str] = "combined"
    manoeuvres: abc.Sequence[Manoeuvre]

    def __post_init__(self) -> None:
        self._set(manoeuvres=_parts("Combined", self.manoeuvres))
        if len(set(self.inputs)) < len(self.inputs):
            raise ModelError(
                f"Combined has inputs {', '.join(self.inputs)}; each may be commanded once only. "
                "Use Sequence for one manoeuvre after another."
            )

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the commanded channels."""
        return tuple(part.input for part in self.manoeuvres)

    @property
    def feedback(self) -> abc.Sequence[str]:
        """Names of the measured signals that any of them reacts to."""
        return _signals(self.manoeuvres)

    @property
    def duration(self) -> float | None:
        """The longest suggestion [s]; None if no manoeuvre has one."""
        return max(
            (d for part in self.manoeuvres if (d := part.duration) is not None), default=None
        )

    def controllers(self) -> dict[str, Controller]:
        """Return one fresh controller for each input; see :func:`command_all`."""
        return {part.input: part.controller() for part in self.manoeuvres}

    def describe(self) -> str:
        """Return one line in words."""
        return "; ".join(part.describe() for part in self.manoeuvres)


@dataclass(frozen=True)
class Sequence(Stepwise):
    """Manoeuvres on one input, one after another; each counts time from its own beginning.

    Parameters
    ----------
    manoeuvres : sequence of Manoeuvre
        All on the same input.
    durations : sequence of float, optional
        Time of each [s]; by default their own. The last manoeuvre goes on
        after its time, and may be left without one.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import Constant, Doublet
    >>> wait = Constant("rudder", 0.0)
    >>> parts = Sequence((wait, Doublet("rudder", 0.2, pulse_time=1.0)), durations=(5.0, 3.0))
    >>> print(parts.commands([4.0, 5.0, 6.0, 7.0]))
    [ 0.   0.2 -0.2  0. ]
    """

    kind: ClassVar[str] = "sequence"
    input: str = field(init=False)
    manoeuvres: abc.Sequence[Manoeuvre]
    _: KW_ONLY
    durations: Numbers | None = None

    def __post_init__(self) -> None:
        parts = _parts("Sequence", self.manoeuvres)
        self._set(manoeuvres=parts, input=parts[0].input)
        super().__post_init__()

    def _validate(self) -> None:
        parts = self.manoeuvres
        if len({part.input for part in parts}) > 1:
            raise ModelError(
                f"Sequence has inputs {', '.join(part.input for part in parts)}; all must be the "
                "same. Use Combined for manoeuvres on several inputs."
            )
        if self.durations is None:
            for part in parts[:-1]:
                if part.duration is None:
                    raise ModelError(
                        f"{self._owner} cannot know how long the {type(part).__name__} takes. "
                        "Give durations, one for each manoeuvre."
                    )
            return
        times = numbers(self._owner, "durations", self.durations)
        for index, time in enumerate(times):
            positive(self._owner, f"durations[{index}]", time)
        if len(times) not in (len(parts), len(parts) - 1):
            raise ModelError(
                f"{self._owner} has {len(parts)} manoeuvres but {len(times)} durations. Give one "
                "for each; that of the last may be left out."
            )
        self._set(durations=times)

    @property
    def feedback(self) -> abc.Sequence[str]:
        """Names of the measured signals that any of them reacts to."""
        return _signals(self.manoeuvres)

    @property
    def duration(self) -> float | None:
        """Sum of the durations [s]; None if the last has none."""
        times = self._times()
        return None if len(times) < len(self.manoeuvres) else sum(times)

    def controller(self) -> Controller:
        """Return a fresh controller."""
        begins = [0.0, *accumulate(self._times()[: len(self.manoeuvres) - 1])]
        return _InTurn(self.manoeuvres, begins)

    def describe(self) -> str:
        """Return one line in words."""
        return ", then ".join(part.describe() for part in self.manoeuvres)

    def _times(self) -> list[float]:
        """Return the time of each part, without the last if it has none [s]."""
        if self.durations is not None:
            return [float(time) for time in self.durations]
        return [time for part in self.manoeuvres if (time := part.duration) is not None]


@dataclass(frozen=True)
class _Shaped(Stepwise):
    """A manoeuvre that shapes what another one orders."""

    input: str = field(init=False)
    manoeuvre: Manoeuvre

    def __post_init__(self) -> None:
        self._set(input=_parts(type(self).__name__, (self.manoeuvre,))[0].input)
        super().__post_init__()

    @property
    def feedback(self) -> abc.Sequence[str]:
        """Names of the measured signals that the manoeuvre reacts to."""
        return self.manoeuvre.feedback

    @property
    def duration(self) -> float | None:
        """That of the manoeuvre [s]."""
        return self.manoeuvre.duration


@dataclass(frozen=True)
class RateLimited(_Shaped):
    """A manoeuvre whose command changes at a limited rate, as a steering gear's does.

    Between two samples the command moves towards the order of the earlier one.
    An actuator's own rate limit belongs in the model; this one shapes what is
    commanded.

    Parameters
    ----------
    manoeuvre : Manoeuvre
        What is ordered.
    rate : float
        Largest slope [unit/s], above zero.
    initial : float
        Command at the first sample.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import TurningCircle
    >>> slow = RateLimited(TurningCircle("rudder", 0.3), 0.1)
    >>> print(slow.commands([0.0, 1.0, 2.0, 3.0, 4.0]).round(3))
    [0.  0.1 0.2 0.3 0.3]
    """

    kind: ClassVar[str] = "rate_limited"
    rules: ClassVar[Mapping[str, Rule]] = {"rate": positive}
    rate: float
    _: KW_ONLY
    initial: float = 0.0

    def controller(self) -> Controller:
        """Return a fresh controller."""
        limit = SlopeLimit(self.rate, initial=self.initial)
        return _Shaper(self.manoeuvre.controller(), limit.follow)

    def describe(self) -> str:
        """Return one line in words."""
        return f"{self.manoeuvre.describe()}, at most {self.rate:.4g} per second"


@dataclass(frozen=True)
class Saturated(_Shaped):
    """A manoeuvre whose command is cut off at a limit to either side.

    Parameters
    ----------
    manoeuvre : Manoeuvre
        What is ordered.
    limit : float
        Largest absolute command, above zero.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import Piecewise
    >>> print(Saturated(Piecewise("rudder", [0, 1], [0.5, -0.1]), 0.3).commands([0, 1]))
    [ 0.3 -0.1]
    """

    kind: ClassVar[str] = "saturated"
    limit: float

    def controller(self) -> Controller:
        """Return a fresh controller."""
        limit = self.limit
        return _Shaper(self.manoeuvre.controller(), lambda order, _: min(max(order, -limit), limit))

    def describe(self) -> str:
        """Return one line in words."""
        return f"{self.manoeuvre.describe()}, cut off at {self.limit:.4g}"


class _InTurn(Controller):
    """Run controllers one after another, each on its own clock."""

    def __init__(self, parts: abc.Sequence[Manoeuvre], begins: list[float]) -> None:
        self._controllers = [part.controller() for part in parts]
        self._begins = np.array(begins)

    def command(self, time: float, signals: Mapping[str, float]) -> float:
        index = max(int(interval(np.array([time]), self._begins)[0]) - 1, 0)
        return self._controllers[index].command(time - self._begins[index], signals)


class _Shaper(Controller):
    """Shape what another controller orders at each time."""

    def __init__(self, ordering: Controller, shape: abc.Callable[[float, float], float]) -> None:
        self._ordering, self._shape = ordering, shape

    def command(self, time: float, signals: Mapping[str, float]) -> float:
        return self._shape(self._ordering.command(time, signals), time)


def _parts(owner: str, manoeuvres: abc.Iterable[Manoeuvre]) -> tuple[Manoeuvre, ...]:
    """Return the manoeuvres as a tuple that is not empty."""
    parts = tuple(manoeuvres)
    if not parts:
        raise ModelError(f"{owner} has no manoeuvres. Give at least one.")
    for part in parts:
        if not isinstance(part, Manoeuvre):
            raise ModelError(
                f"{owner} got a {type(part).__name__}; it takes manoeuvres on one input each, "
                "such as ZigZag or Constant."
            )
    return parts


def _signals(manoeuvres: abc.Iterable[Manoeuvre]) -> tuple[str, ...]:
    """Return the names of all measured signals, each once."""
    return tuple(dict.fromkeys(name for part in manoeuvres for name in part.feedback))
