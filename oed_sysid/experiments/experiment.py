"""Experiments: what is commanded, for how long, from which state, within which limits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, cast

import numpy as np

from oed_sysid.errors import DesignError, located
from oed_sysid.experiments import SAYS
from oed_sysid.experiments.manoeuvres import Combined, Excitation, Manoeuvre
from oed_sysid.physics.channels import settle
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import ROUNDING, TABLE_BYTES
from oed_sysid.runtime.display import as_dict

FEEDBACKS = ("measured", "true")


@dataclass(frozen=True)
class Limits:
    """What must not be exceeded during an experiment.

    Parameters
    ----------
    inputs : mapping of str to (lower, upper)
        Range of each command, SI.
    rates : mapping of str to float
        Largest absolute slope of each command, SI per second.
    signals : mapping of str to (lower, upper)
        Corridor of states or outputs, such as depth or pitch, SI.

    Raises
    ------
    DesignError
        If a limit contradicts itself.

    Examples
    --------
    >>> limits = Limits(inputs={"fin": (-0.3, 0.3)}, signals={"z": (2.0, 20.0)})
    >>> times = np.array([0.0, 1.0, 2.0])
    >>> limits.violations(times, {"z": np.array([5.0, 15.0, 21.5])})
    ("signal 'z' reaches 21.5 at t = 2 s, above its limit of 20",)
    """

    inputs: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)
    signals: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        kinds = {key: {str: object} for key in ("inputs", "signals", "rates")}
        settle(self, "Limits", kinds, DesignError)
        for kind in ("inputs", "signals"):
            ranges = {n: _range(kind, n, r) for n, r in getattr(self, kind).items()}
            object.__setattr__(self, kind, ranges)
        for name, rate in self.rates.items():
            if isinstance(rate, str | None) or not np.ndim(rate) == 0 or not rate > 0:
                raise DesignError(SAYS["rate_limit"].format(name=name, rate=rate))
        object.__setattr__(self, "rates", {n: float(r) for n, r in self.rates.items()})

    def violations(self, times: np.ndarray, signals: Mapping[str, np.ndarray]) -> tuple[str, ...]:
        """Say in words which limits the signals break; empty if none.

        Parameters
        ----------
        times : ndarray (n_times,)
            Times, s.
        signals : mapping of str to ndarray (n_times,)
            Inputs, states or outputs by name; limits of other names are not
            looked at, and NaN is passed over.
        """
        broken: list[str] = []
        for kind, ranges in (("input", self.inputs), ("signal", self.signals)):
            for name, (lower, upper) in ranges.items():
                if name in signals:
                    broken += _beyond(kind, name, times, np.asarray(signals[name]), lower, upper)
        for name, limit in self.rates.items():
            if name in signals and len(times) > 1:
                slopes = np.abs(np.diff(signals[name])) / np.diff(times)
                where = int(np.nanargmax(slopes))
                if slopes[where] > limit * (1 + 1e-6):
                    broken.append(
                        f"rate of {name!r} reaches {slopes[where]:.4g} at t = {times[where]:g} s, "
                        f"above its limit of {limit:g}"
                    )
        return tuple(broken)

    def check_names(self, model: Model) -> None:
        """Raise :class:`DesignError` if a limit is on something the model does not have."""
        for kind, limited, known in (
            ("input", (*self.inputs, *self.rates), model.input_names),
            ("signal", self.signals, (*model.all_state_names, *model.output_names)),
        ):
            lacking = f"A limit is on nothing: model {model.name!r} has no {kind}"
            located(DesignError, lacking, limited, known)


@dataclass(frozen=True)
class Experiment:
    """One run: manoeuvres on some inputs, constants on the others, a start state.

    Parameters
    ----------
    name : str
        Name of the run, and of the record that it gives.
    manoeuvre : Excitation, sequence of Manoeuvre or None
        What is commanded; several manoeuvres act on different inputs at the
        same time. None leaves all inputs constant, as in a decay test.
    duration : float or None
        Length, s; None takes the manoeuvre's own.
    sample_time : float
        Time between samples, s.
    constants : mapping of str to float
        Value of every input that no manoeuvre commands.
    initial : mapping of str to float
        Start values of the model's states; those left out are zero.
    noise : mapping of str to float
        Standard deviation of the noise of outputs, where it differs from the
        model's.
    feedback : {"measured", "true"}
        Whether a manoeuvre that reacts to an output sees it with noise.
    limits : Limits
        What must be kept; what is known in advance is checked here.

    Raises
    ------
    DesignError
        If the settings contradict each other or a limit.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import TurningCircle
    >>> circle = Experiment(
    ...     "circle", TurningCircle("rudder", 0.3), duration=60.0, sample_time=0.5,
    ...     constants={"propeller": 10.0}, initial={"u": 7.0},
    ... )
    >>> float(circle.times[-1]), circle.inputs
    (60.0, ('rudder', 'propeller'))
    """

    name: str
    manoeuvre: Excitation | Sequence[Manoeuvre] | None = None
    _: KW_ONLY
    duration: float | None = None
    sample_time: float = 0.1
    constants: Mapping[str, float] = field(default_factory=dict)
    initial: Mapping[str, float] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    feedback: str = "measured"
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        excitation = self.manoeuvre
        if excitation is not None and not isinstance(excitation, Excitation):
            parts = tuple(excitation)
            excitation = None if not parts else parts[0] if len(parts) == 1 else Combined(parts)
        object.__setattr__(self, "manoeuvre", excitation)
        for key in ("constants", "initial", "noise"):
            given = getattr(self, key)
            try:
                object.__setattr__(self, key, {name: float(x) for name, x in given.items()})
            except (AttributeError, TypeError, ValueError):
                raise DesignError(
                    f"Experiment {self.name!r} has {key} {given!r:.60}. Expected a mapping from "
                    "names to numbers."
                ) from None
        if self.duration is None:
            object.__setattr__(self, "duration", excitation.duration if excitation else None)
        self._validate()

    def _validate(self) -> None:
        owner = f"Experiment {self.name!r}"
        if not isinstance(self.name, str):
            raise DesignError(f"{owner} is named by a {type(self.name).__name__}. Give text.")
        self._check_times(owner)
        if self.feedback not in FEEDBACKS:
            raise DesignError(
                f"{owner} has feedback {self.feedback!r}. Choose one of {', '.join(FEEDBACKS)}."
            )
        for key in ("constants", "initial", "noise"):
            for name, value in getattr(self, key).items():
                if not math.isfinite(value) or (key == "noise" and value < 0):
                    raise DesignError(f"{owner} has {key} {name!r} = {value}. Correct the number.")
        if twice := set(self.constants) & set(self._commanded):
            raise DesignError(
                f"{owner} commands {', '.join(sorted(twice))} by a manoeuvre and as a constant. "
                "Remove one of the two."
            )
        start = {name: np.array([value]) for name, value in self.initial.items()}
        self.check_limits(
            *self.limits.violations(self.times[:1], start),
            *self.limits.violations(self.times, self.known_commands()),
        )

    def check_limits(self, *broken: str) -> None:
        """Raise :class:`DesignError` where limits are broken, said in words."""
        if broken:
            raise DesignError(SAYS["beyond_limits"].format(self, broken="; ".join(broken)))

    def _check_times(self, owner: str) -> None:
        """Refuse a run without end, without samples, or of more than there is room for."""
        if self.duration is None:
            raise DesignError(SAYS["no_duration"].format(owner=owner))
        for key in ("duration", "sample_time"):
            given = getattr(self, key)
            if isinstance(given, str | bool) or np.ndim(given):
                raise DesignError(f"{owner} has {key} {given!r:.40}. Give seconds.")
        if not 0 < self.sample_time < math.inf:
            raise DesignError(f"{owner} has sample_time {self.sample_time}. Give seconds above 0.")
        if not self.sample_time <= self.duration < math.inf:
            raise DesignError(SAYS["short_run"].format(self, owner=owner))
        if self.duration > TABLE_BYTES / np.dtype(float).itemsize * self.sample_time:
            raise DesignError(
                f"{owner} lasts {self.duration:g} s with a sample every {self.sample_time:g} s: "
                f"that is {self.duration / self.sample_time:.0e} samples. Give a shorter run, or a "
                "longer time between samples."
            )

    @property
    def _commanded(self) -> tuple[str, ...]:
        return self.excitation.inputs if self.excitation else ()

    @property
    def excitation(self) -> Excitation | None:
        """The manoeuvre, several ones combined; None if all inputs are constant."""
        return cast(Excitation | None, self.manoeuvre)  # by __post_init__

    @property
    def manoeuvres(self) -> tuple[Manoeuvre, ...]:
        """The manoeuvres on the single inputs."""
        return self.excitation.parts if self.excitation else ()

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of all inputs that get a value."""
        return (*self._commanded, *self.constants)

    @property
    def reacts(self) -> bool:
        """Whether a command depends on measured signals."""
        return bool(self.excitation and self.excitation.feedback)

    @property
    def times(self) -> np.ndarray:
        """Sample times from zero, s, shape ``(n_times,)``."""
        n_steps = math.floor(float(self.duration or 0.0) / self.sample_time + ROUNDING)
        return np.arange(n_steps + 1) * self.sample_time

    def commands(self, names: Iterable[str]) -> np.ndarray:
        """Commands of an experiment without feedback.

        Parameters
        ----------
        names : iterable of str
            The model's inputs, in order.

        Returns
        -------
        ndarray (n_times, n_inputs)

        Raises
        ------
        DesignError
            If an input gets no value, or a manoeuvre reacts to signals.
        """
        known = self.known_commands()
        wanted = tuple(names)
        if self.reacts:
            raise DesignError(SAYS["reacts"].format(self))
        if missing := [name for name in wanted if name not in known]:
            raise DesignError(self._no_command(missing))
        columns = [known[name] for name in wanted]
        return np.column_stack([np.empty((len(self.times), 0)), *columns])

    def known_commands(self) -> dict[str, np.ndarray]:
        """Commands ``(n_times,)`` of the inputs that do not react, by name."""
        times = self.times
        known = {name: np.full(len(times), value) for name, value in self.constants.items()}
        known |= {m.input: m.commands(times) for m in self.manoeuvres if not m.feedback}
        return known

    def _no_command(self, missing: Sequence[str]) -> str:
        return SAYS["no_command"].format(self, names=", ".join(missing), missing=missing)

    def check_model(self, model: Model) -> None:
        """Raise :class:`DesignError` if the experiment does not fit a model."""
        seen = [name for manoeuvre in self.manoeuvres for name in manoeuvre.feedback]
        for kind, names, known in (
            ("input", self.inputs, model.input_names),
            ("state", self.initial, model.state_names),
            ("output", self.noise, model.output_names),
            ("output or state", seen, (*model.output_names, *model.state_names)),
        ):
            lacking = f"Experiment {self.name!r} does not fit: model {model.name!r} has no {kind}"
            located(DesignError, lacking, names, known)
        if missing := [name for name in model.input_names if name not in self.inputs]:
            raise DesignError(self._no_command(missing))
        self.limits.check_names(model)

    def describe(self) -> str:
        """Return one line in words."""
        what = self.excitation.describe() if self.excitation else "all inputs constant"
        return f"{self.name}: {what}; {self.duration:g} s, a sample every {self.sample_time:g} s"

    to_dict = as_dict(
        "name", "duration", "sample_time", "constants", "initial", "noise", "feedback", "limits",
        manoeuvre="excitation",
    )  # fmt: skip

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Experiment:
        """Return the experiment that :meth:`to_dict` stored.

        Raises
        ------
        DesignError
            If a setting is unknown or missing.
        """
        settings = dict(data)
        try:
            manoeuvre = settings.pop("manoeuvre")
            limits = Limits(**settings.pop("limits", {}))
            name = settings.pop("name")
            excitation = None if manoeuvre is None else Excitation.from_dict(manoeuvre)
            return cls(name, excitation, limits=limits, **settings)
        except (KeyError, TypeError) as error:
            raise DesignError(f"A stored experiment cannot be read: {error}.") from None


def _range(kind: str, name: str, given: Sequence[float]) -> tuple[float, float]:
    try:
        words = any(isinstance(bound, str | bool) for bound in given)
        # A stored open side is no number: JSON knows no infinity.
        sides = zip(given, (-math.inf, math.inf), strict=True)
        pair = () if words else tuple(float(open_ if b is None else b) for b, open_ in sides)
    except (TypeError, ValueError):
        pair = ()
    if len(pair) != 2 or not pair[0] < pair[1]:
        raise DesignError(SAYS["no_range"].format(kind=kind[:-1], name=name, given=given))
    return pair[0], pair[1]


def _beyond(
    kind: str, name: str, times: np.ndarray, values: np.ndarray, lower: float, upper: float
) -> list[str]:
    """Sentences about the worst sample beyond either bound."""
    broken = []
    for bound, side, excess in ((lower, "below", lower - values), (upper, "above", values - upper)):
        if np.isnan(excess).all():
            continue
        where = int(np.nanargmax(excess))
        if excess[where] > ROUNDING * max(1.0, abs(bound)):
            broken.append(
                f"{kind} {name!r} reaches {values[where]:.4g} at t = {times[where]:g} s, "
                f"{side} its limit of {bound:g}"
            )
    return broken
