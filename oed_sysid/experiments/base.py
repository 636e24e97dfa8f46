"""What every excitation offers: controllers, a description and a dictionary.

A new manoeuvre is a frozen dataclass derived from :class:`OpenLoop` (its
command depends on time only) or :class:`Stepwise` (it may look at measured
signals), with a class attribute ``kind`` that names it in stored files.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.experiments.checks import FloatArray, Numbers

Waveform = Callable[[FloatArray], FloatArray]


class Controller(ABC):
    """The running side of a manoeuvre: gives one command per sample.

    A controller that can tell what it will command as long as nothing happens lets a simulation go
    many samples ahead at once; the commands are the same.
    """

    @abstractmethod
    def command(self, time: float, signals: Mapping[str, float]) -> float:
        """Return the command at ``time`` [s]; called with increasing times."""

    def foreseen(self, times: FloatArray) -> FloatArray | None:
        """Commands ``(n_times,)`` at later times while it does not react; None if unknown."""
        return None

    def undisturbed(self, times: FloatArray, signals: Mapping[str, FloatArray]) -> int:
        """Return at how many of the first samples the command is sure to be as foreseen."""
        return 0

    def skip(self, times: FloatArray) -> None:
        """Go on past samples at which the command was as foreseen."""
        return


@dataclass(frozen=True)
class Excitation(ABC):
    """One manoeuvre, or several on different inputs at the same time."""

    kind: ClassVar[str]

    @property
    @abstractmethod
    def inputs(self) -> tuple[str, ...]:
        """Names of the commanded channels."""

    @property
    @abstractmethod
    def feedback(self) -> Sequence[str]:
        """Names of the measured signals that the commands react to."""

    @property
    @abstractmethod
    def duration(self) -> float | None:
        """Suggested time to run it [s]; None if it has no natural end."""

    @abstractmethod
    def controllers(self) -> dict[str, Controller]:
        """Return one fresh controller for each input."""

    @abstractmethod
    def describe(self) -> str:
        """Return one line in words."""

    def to_dict(self) -> dict[str, Any]:
        """Return a dictionary that JSON can store; see :meth:`from_dict`."""
        stored = {field.name: _plain(getattr(self, field.name)) for field in _settings(self)}
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
        name = data.get("kind")
        if name not in known:
            raise ModelError(f"Unknown kind of manoeuvre {name!r}. Known: {', '.join(known)}.")
        found = known[name]
        if not issubclass(found, cls):
            raise ModelError(
                f"A stored {name!r} is a {found.__name__}, not a {cls.__name__}. "
                "Use Excitation.from_dict."
            )
        allowed = {field.name for field in _settings(found)}
        settings = {key: _revived(value) for key, value in data.items() if key != "kind"}
        if unknown := settings.keys() - allowed:
            raise ModelError(
                f"A stored {name!r} has the unknown setting(s) {', '.join(sorted(unknown))}. "
                f"Known: {', '.join(sorted(allowed))}."
            )
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
    """A manoeuvre on one commanded channel, ``input``."""

    input: str

    def __post_init__(self) -> None:
        self._validate()
        if not isinstance(self.input, str) or not self.input:
            raise ModelError(
                f"{type(self).__name__} has input {self.input!r}; give the name of a commanded "
                "channel, for instance 'rudder'."
            )

    @property
    def inputs(self) -> tuple[str, ...]:
        """The one commanded channel, as a tuple."""
        return (self.input,)

    def controllers(self) -> dict[str, Controller]:
        """Return the fresh controller under the name of the input."""
        return {self.input: self.controller()}

    @abstractmethod
    def controller(self) -> Controller:
        """Return a fresh controller."""

    @abstractmethod
    def commands(self, times: Numbers) -> FloatArray:
        """Return the commands ``(n_times,)`` of a manoeuvre without feedback."""

    @abstractmethod
    def _validate(self) -> None:
        """Check and normalise the settings, at construction."""

    @property
    def _owner(self) -> str:
        """Name for error messages."""
        return f"{type(self).__name__} of {self.input!r}"


class OpenLoop(Manoeuvre):
    """A manoeuvre whose command is a function of time only."""

    @abstractmethod
    def waveform(self) -> Waveform:
        """Return the function from times ``(n,)`` [s] to commands ``(n,)``."""

    @property
    def feedback(self) -> Sequence[str]:
        """Nothing: the command is a function of time."""
        return ()

    def controller(self) -> Controller:
        """Return a fresh controller, which plays the waveform."""
        return _Playback(self.waveform())

    def commands(self, times: Numbers) -> FloatArray:
        """Return the commands ``(n_times,)`` at times ``(n_times,)`` [s]."""
        return self.waveform()(np.asarray(times, dtype=float))


class Stepwise(Manoeuvre):
    """A manoeuvre whose command depends on what happened before."""

    def commands(self, times: Numbers) -> FloatArray:
        """Return the commands ``(n_times,)`` at increasing times ``(n_times,)`` [s].

        Raises
        ------
        ModelError
            If the manoeuvre reacts to measured signals.
        """
        if self.feedback:
            raise ModelError(
                f"{self._owner} reacts to {', '.join(self.feedback)}, so its commands do not "
                "depend on time alone. Run its controller() within a simulation."
            )
        controller = self.controller()
        return np.array([controller.command(float(time), {}) for time in np.asarray(times)])


class _Playback(Controller):
    """Controller of an open-loop manoeuvre."""

    def __init__(self, waveform: Waveform) -> None:
        self._waveform = waveform

    def command(self, time: float, signals: Mapping[str, float]) -> float:
        return float(self._waveform(np.array([time], dtype=float))[0])

    def foreseen(self, times: FloatArray) -> FloatArray | None:
        return self._waveform(times)

    def undisturbed(self, times: FloatArray, signals: Mapping[str, FloatArray]) -> int:
        return len(times)


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


def _plain(value: Any) -> Any:
    """Return a value in the types that JSON knows."""
    if isinstance(value, Excitation):
        return value.to_dict()
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value


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
