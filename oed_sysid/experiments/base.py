"""What every excitation offers: controllers, a description and a dictionary.

A new manoeuvre is a frozen dataclass derived from :class:`OpenLoop` (its
command depends on time only) or :class:`Stepwise` (it may look at measured
signals), with a class attribute ``kind`` that names it in stored files. Its
settings are checked once, when it is made: those of the names in ``RULES`` by
their name, others by ``rules`` of the class.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from oed_sysid.errors import ModelError, located
from oed_sysid.experiments import SAYS
from oed_sysid.runtime.display import plain

#: Advice for sizes below zero, where ``first`` says the side.
OTHER_SIDE = "Use first=-1 to begin to the other side."
FloatArray = NDArray[np.float64]
Numbers = Sequence[float] | FloatArray
Waveform = Callable[[FloatArray], FloatArray]
#: Check of a setting: from owner, name and value to the value that is kept.
Rule = Callable[[str, str, Any], Any]


def finite(owner: str, name: str, value: float) -> float:
    """Return ``value`` as a float, or raise if it is not a finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        raise ModelError(f"{owner} has {name} {value!r}. Give a finite number.")
    return number


def positive(owner: str, name: str, value: float, advice: str = "") -> float:
    """Return ``value`` as a float, or raise if it is not above zero."""
    if (number := finite(owner, name, value)) <= 0:
        raise ModelError(f"{owner} has {name} {number:g}; it must be above zero. {advice}".rstrip())
    return number


def not_zero(advice: str) -> Rule:
    """Rule of a number that is not zero, with advice for one that is."""

    def check(owner: str, name: str, value: float) -> float:
        if (number := finite(owner, name, value)) == 0:
            raise ModelError(f"{owner} has {name} 0, which moves nothing. {advice}")
        return number

    return check


def optional(rule: Rule) -> Rule:
    """Rule of a setting that may be None."""
    return lambda owner, name, value: None if value is None else rule(owner, name, value)


def above_zero(advice: str = "") -> Rule:
    """Rule of a number above zero, with advice for one that is not."""
    return lambda owner, name, value: positive(owner, name, value, advice)


def side(owner: str, name: str, value: int) -> int:
    """Return +1 or -1, or raise."""
    if value not in (1, -1):
        raise ModelError(f"{owner} has {name} {value!r}; it must be +1 or -1.")
    return int(value)


def numbers(owner: str, name: str, values: Numbers) -> tuple[float, ...]:
    """Return a tuple of finite floats, or raise."""
    array = np.asarray(values, dtype=float)
    if array.ndim != 1 or len(array) < 1:
        raise ModelError(
            f"{owner} has {name} of shape {array.shape}; give a sequence of at least 1 number(s)."
        )
    if not np.all(np.isfinite(array)):
        where = int(np.flatnonzero(~np.isfinite(array))[0])
        raise ModelError(
            SAYS["gap_in_command"].format(owner=owner, value=array[where], where=where, name=name)
        )
    return tuple(array.tolist())


def increasing(owner: str, name: str, values: tuple[float, ...]) -> tuple[float, ...]:
    """Return the values, or raise if they are not strictly increasing."""
    if np.any((steps := np.diff(values)) <= 0):
        where = int(np.flatnonzero(steps <= 0)[0])
        raise ModelError(
            f"{owner} has {name} that do not increase: {values[where]:g} is followed by "
            f"{values[where + 1]:g} at position {where + 1}. Sort them and remove repetitions."
        )
    return values


def one_of(*options: str) -> Rule:
    """Rule of a word among several."""

    def check(owner: str, name: str, value: str) -> str:
        if value not in options:
            raise ModelError(f"{owner} has {name} {value!r}. Choose one of {', '.join(options)}.")
        return value

    return check


def each_positive(advice: str) -> Rule:
    """Rule of one number above zero, or several, kept as a tuple."""

    def check(owner: str, name: str, values: float | Numbers) -> tuple[float, ...]:
        sequence = (values,) if isinstance(values, int | float) else values
        return tuple(
            positive(owner, f"{name}[{index}]", value, advice)
            for index, value in enumerate(numbers(owner, name, sequence))
        )

    return check


def feedback_of(owner: str, signals: Sequence[str], more: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the measured signals that a manoeuvre reacts to: one, and what ``more`` says."""
    names = (signals,) if isinstance(signals, str) else tuple(signals)
    if len(names) != 1 + len(more) or not all(names):
        words = "".join(f", then {one}" for one in more)
        wanted = "exactly one measured signal" if not more else f"the attitude{words}"
        raise ModelError(
            f"{owner} has feedback {names!r}; it reacts to {wanted}, for instance "
            f"{('psi', 'r', 'y')[: 1 + len(more)] if more else 'psi'!r}."
        )
    return names


#: Settings by other names in files of before.
OLDER = {"neutral": "trim"}
#: Rules of settings that mean the same in every manoeuvre.
RULES: Mapping[str, Rule] = {
    **dict.fromkeys(("start", "trim", "initial", "lead", "keep_gain"), finite),
    **dict.fromkeys(("hold", "turn_duration", "pulse_time", "unit_time", "bit_time"), positive),
    **dict.fromkeys(("sweep_time", "first_frequency", "last_frequency"), positive),
    **dict.fromkeys(("amplitude", "limit", "reset_time"), positive),
    **dict.fromkeys(("first", "sign"), side),
    **dict.fromkeys(("angles", "rates", "values"), numbers),
    "times": lambda owner, name, value: increasing(owner, name, numbers(owner, name, value)),
    "rate": optional(above_zero("Leave it None for a command without rate limit.")),
    "reference": optional(finite),
}


class Controller(ABC):
    """The running side of a manoeuvre: gives one command per sample.

    Examples
    --------
    :class:`Stepwise` manoeuvres begin one for every run.
    """

    @abstractmethod
    def command(self, time: float, signals: Mapping[str, float]) -> float:
        """Return the command at ``time`` [s]; called with increasing times."""


@dataclass(frozen=True)
class Law(Controller):
    """A controller that is a function of time and signals."""

    law: Callable[[float, Mapping[str, float]], float]

    def command(self, time: float, signals: Mapping[str, float]) -> float:
        """Return the command at ``time`` [s]."""
        return self.law(time, signals)


@dataclass(frozen=True)
class Excitation(ABC):
    """One manoeuvre, or several on different inputs at the same time.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import TurningCircle
    >>> isinstance(TurningCircle("rudder", 0.6), Excitation)
    True
    """

    kind: ClassVar[str]

    @property
    @abstractmethod
    def parts(self) -> tuple[Manoeuvre, ...]:
        """The manoeuvres that act at the same time, one for each input."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the commanded channels."""
        return tuple(part.input for part in self.parts)

    @property
    @abstractmethod
    def feedback(self) -> Sequence[str]:
        """Names of the measured signals that the commands react to."""

    @property
    @abstractmethod
    def duration(self) -> float | None:
        """Suggested time to run it [s]; None if it has no natural end."""

    def controllers(self) -> dict[str, Controller]:
        """Return one fresh controller for each input; see :func:`command_all`."""
        return {part.input: part.controller() for part in self.parts}

    @abstractmethod
    def describe(self) -> str:
        """Return one line in words."""

    def to_dict(self) -> dict[str, Any]:
        """Return a dictionary that JSON can store; see :meth:`from_dict`."""
        stored = {field.name: plain(getattr(self, field.name)) for field in _settings(self)}
        return {"kind": self.kind, **stored}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Return the excitation that :meth:`to_dict` stored.

        Parameters
        ----------
        data : mapping
            ``kind`` and the settings of that kind.

        Raises
        ------
        ModelError
            If the kind or one of the settings is unknown, or of another type
            than the class this is called on.

        Examples
        --------
        >>> from oed_sysid.experiments.manoeuvres import Doublet, Manoeuvre
        >>> stored = Doublet("rudder", 0.2, pulse_time=4.0).to_dict()
        >>> Manoeuvre.from_dict(stored).describe()
        'doublet of rudder: +0.2 then -0.2, 4 s each, from 0 s'
        """
        known = {kind.kind: kind for kind in _kinds() if "kind" in vars(kind)}
        name = str(data.get("kind"))
        located(ModelError, "This package has no kind of manoeuvre", [name], known)
        found = known[name]
        if not issubclass(found, cls):
            raise ModelError(SAYS["another_kind"].format(name=name, found=found, cls=cls))
        allowed = [field.name for field in _settings(found)]
        settings = {
            OLDER.get(key, key): _revived(value) for key, value in data.items() if key != "kind"
        }
        located(ModelError, f"A {name!r} has no setting", settings, allowed)
        try:
            return found(**settings)
        except TypeError as error:
            raise ModelError(f"A stored {name!r} lacks a setting: {error}.") from error

    def _set(self, **values: object) -> None:
        """Store normalised values; for use at construction only."""
        for name, value in values.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Manoeuvre(Excitation):
    """A manoeuvre on one commanded channel, ``input``.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import TurningCircle
    >>> TurningCircle("rudder", 0.6).input
    'rudder'
    """

    input: str

    rules: ClassVar[Mapping[str, Rule]] = {}

    def __post_init__(self) -> None:
        rules = {**RULES, **self.rules}
        for field in _settings(self):
            if field.name in rules:
                given = getattr(self, field.name)
                self._set(**{field.name: rules[field.name](self._owner, field.name, given)})
        self._validate()
        if not isinstance(self.input, str) or not self.input:
            raise ModelError(SAYS["no_input_name"].format(self, kind=type(self).__name__))

    @property
    def parts(self) -> tuple[Manoeuvre, ...]:
        """The manoeuvre alone."""
        return (self,)

    @property
    def duration(self) -> float | None:
        """None: it depends on the vehicle or has no end; for kinds that do not know it."""
        return None

    @abstractmethod
    def controller(self) -> Controller:
        """Return a fresh controller."""

    @abstractmethod
    def commands(self, times: Numbers) -> FloatArray:
        """Return the commands ``(n_times,)`` of a manoeuvre without feedback."""

    def _validate(self) -> None:
        """Check what more than one setting decides; for kinds that have such."""
        return

    @property
    def _owner(self) -> str:
        """Name for error messages."""
        return f"{type(self).__name__} of {self.input!r}"


@dataclass(frozen=True)
class Timed(Manoeuvre):
    """A command that begins at ``start`` [s] and moves about ``trim``."""

    _: KW_ONLY
    start: float = 0.0
    trim: float = 0.0

    @property
    def _when(self) -> str:
        """When it begins and about what, in words."""
        return f", from {self.start:g} s" + (f", about {self.trim:g}" if self.trim else "")


class OpenLoop(Manoeuvre):
    """A manoeuvre whose command is a function of time only.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import TurningCircle
    >>> isinstance(TurningCircle("rudder", 0.6), OpenLoop)
    True
    """

    @abstractmethod
    def waveform(self) -> Waveform:
        """Return the function from times ``(n,)`` [s] to commands ``(n,)``."""

    @property
    def feedback(self) -> Sequence[str]:
        """Nothing: the command is a function of time."""
        return ()

    def controller(self) -> Controller:
        """Return a fresh controller, which plays the waveform."""
        wave = self.waveform()
        return Law(lambda time, _: float(wave(np.array([time], dtype=float))[0]))

    def commands(self, times: Numbers) -> FloatArray:
        """Return the commands ``(n_times,)`` at times ``(n_times,)`` [s]."""
        return self.waveform()(np.asarray(times, dtype=float))


class Stepwise(Manoeuvre):
    """A manoeuvre whose command depends on what happened before.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import ZigZag
    >>> isinstance(ZigZag("rudder", 0.35, 0.35), Stepwise)
    True
    """

    def commands(self, times: Numbers) -> FloatArray:
        """Return the commands ``(n_times,)`` at increasing times ``(n_times,)`` [s].

        Raises
        ------
        ModelError
            If the manoeuvre reacts to measured signals.
        """
        if self.feedback:
            raise ModelError(SAYS["commands_react"].format(self, signals=", ".join(self.feedback)))
        controller = self.controller()
        return np.array([controller.command(float(time), {}) for time in np.asarray(times)])


def command_all(
    controllers: Mapping[str, Controller], time: float, signals: Mapping[str, float]
) -> dict[str, float]:
    """Return the command of every input at one time.

    Parameters
    ----------
    controllers : mapping of str to Controller
        From :meth:`Excitation.controllers`.
    time : float
        Time [s], later than in the call before.
    signals : mapping of str to float
        Measured signals at that time.

    Returns
    -------
    dict of str to float
        By input, SI.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import Combined, Constant, ZigZag, command_all
    >>> trial = Combined((Constant("thrust", 700.0), ZigZag("rudder", 0.2, 0.1)))
    >>> command_all(trial.controllers(), 0.0, {"psi": 0.0})
    {'thrust': 700.0, 'rudder': 0.2}
    """
    return {name: control.command(time, signals) for name, control in controllers.items()}


def _settings(owner: Excitation | type[Excitation]) -> list[Any]:
    """Return the dataclass fields that the constructor takes."""
    return [field for field in fields(owner) if field.init]


def _revived(value: Any) -> Any:
    """Return a value with stored excitations and tuples restored."""
    if isinstance(value, Mapping):
        return Excitation.from_dict(value)
    if isinstance(value, list):
        return tuple(_revived(item) for item in value)
    return value


def _kinds(owner: type | None = None) -> Iterator[type[Excitation]]:
    """Yield all classes of excitations, so that users' own kinds are found."""
    children: list[type[Excitation]] = type.__subclasses__(owner or Excitation)
    for child in children:
        yield child
        yield from _kinds(child)
