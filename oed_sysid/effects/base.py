"""The noun of the package: one physical contribution at one stage of the chain.

command -> **actuator** -> **environment** (relative flow) -> **force** ->
**inertia** -> states -> **sensor** -> measured outputs
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from oed_sysid.channels import check_kinds, check_signal
from oed_sysid.errors import ModelError
from oed_sysid.language import expressions
from oed_sysid.parameters import Parameter, check_unique

STAGES = ("actuator", "environment", "force", "inertia", "sensor")


@dataclass(frozen=True)
class ExtraState:
    """A continuous state that an effect adds.

    Parameters
    ----------
    name : str
        Symbol, unique in the model.
    rate : str
        Time derivative, as an expression.
    initial : str
        Start value, as an expression of the model's own states, the first
        inputs and parameters, so that no unknown is added.
    unit : str
        SI unit.
    """

    name: str
    rate: str
    initial: str
    unit: str = ""

    def __post_init__(self) -> None:
        check_signal("State", self.name, self.unit)


@dataclass(frozen=True)
class Memory:
    """A value that a sampled stage (actuator or sensor) keeps between steps.

    Parameters
    ----------
    name : str
        Symbol, visible to its own effect only.
    update : str
        Value after the step, as an expression.
    initial : str
        Value before the first step.
    """

    name: str
    update: str
    initial: str


@dataclass(frozen=True)
class RandomProcess:
    """First-order Gauss-Markov process that drives an effect.

    Parameters
    ----------
    place : str
        Where it acts, ``"force Z"``, ``"actuator ds"`` or ``"sensor q"``.
    parameter : str
        Parameter of the effect that is random; its value is the mean, zero.
    level : float
        Standard deviation.
    time : float
        Correlation time, s; zero is white from sample to sample.
    known : bool
        Whether level and time are known rather than estimated.
    """

    place: str
    parameter: str
    level: float
    time: float
    known: bool = False


@dataclass(frozen=True)
class Effect:
    """Base of the five kinds of effect; never used directly.

    Parameters
    ----------
    name : str
        Identifier, for instance ``"heave_crossflow_drag"``.
    terms : mapping
        What the effect contributes; the key's meaning depends on the stage.
    parameters : tuple of Parameter
        The effect's own parameters.
    definitions : mapping
        Local names, evaluated in order before the terms.
    states : tuple of ExtraState
        Continuous states the effect adds (force and environment stages).
    memory : tuple of Memory
        Sampled memory (actuator and sensor stages).
    tables : mapping
        ``name -> (abscissae, ordinates)``, callable in expressions.
    amplitudes : tuple of str or None
        Parameters that are all zero when the effect is absent; ``None`` means
        every parameter of the effect that is not fixed.
    description, source : str
        Words and citation.
    needs : str
        What a manoeuvre must contain for the effect to show.
    noise : RandomProcess or None
        Level and time of what is random about the effect; see
        :mod:`oed_sysid.effects.random`.
    """

    name: str
    terms: Mapping[Any, str]
    parameters: tuple[Parameter, ...] = ()
    definitions: Mapping[str, str] = field(default_factory=dict)
    states: tuple[ExtraState, ...] = ()
    memory: tuple[Memory, ...] = ()
    tables: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    amplitudes: tuple[str, ...] | None = None
    description: str = ""
    source: str = ""
    needs: str = ""
    noise: RandomProcess | None = None

    stage: ClassVar[str] = ""

    def __post_init__(self) -> None:
        if type(self) is Effect:
            raise ModelError("Use one of Actuator, Environment, Force, Inertia or Sensor.")
        where = f"Effect {self.name!r:.60}"
        if not isinstance(self.name, str) or not isinstance(self.terms, Mapping):
            raise ModelError(f"{where}: expected a name and a mapping of terms, {{'Z': 'E*w'}}.")
        for what, kind in (("parameters", Parameter), ("states", ExtraState), ("memory", Memory)):
            parts = getattr(self, what)
            if isinstance(parts, kind):
                raise ModelError(f"{where}: {what} is one {kind.__name__}; write it as (...,).")
            object.__setattr__(self, what, tuple(parts))
            check_kinds(where, what, getattr(self, what), kind)
        check_unique(self.parameters, owner=f"Effect {self.name!r}")
        if not self.terms and not self.states:
            raise ModelError(f"Effect {self.name!r} contributes nothing: give at least one term.")
        if self.states and self.stage not in ("force", "environment"):
            raise ModelError(f"Effect {self.name!r}: a {self.stage} effect cannot add states.")
        if self.memory and self.stage not in ("actuator", "sensor"):
            raise ModelError(f"Effect {self.name!r}: a {self.stage} effect cannot keep memory.")
        for name in self.amplitudes or ():
            if name not in {parameter.name for parameter in self.parameters}:
                raise ModelError(
                    f"Effect {self.name!r} names the amplitude {name!r}, which is not one of its "
                    f"parameters: {', '.join(p.name for p in self.parameters)}."
                )
        for name, table in self.tables.items():
            _check_table(f"{where}, table {name!r}", table)
        texts = [*self.terms.values(), *self.definitions.values()]
        texts += [text for state in self.states for text in (state.rate, state.initial)]
        texts += [text for memory in self.memory for text in (memory.update, memory.initial)]
        for text in texts:
            expressions.check_calls(text, where=where, tables=self.tables)

    @property
    def amplitude_names(self) -> tuple[str, ...]:
        """Parameters that are zero when the effect is absent."""
        if self.amplitudes is not None:
            return self.amplitudes
        return tuple(p.name for p in self.parameters if not p.fixed)

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Estimated parameters that are not amplitudes, such as a frequency."""
        amplitudes = self.amplitude_names
        return tuple(p.name for p in self.parameters if not p.fixed and p.name not in amplitudes)

    def absent(self) -> Effect:
        """Return the effect with every amplitude at zero."""
        return self.with_values(dict.fromkeys(self.amplitude_names, 0.0))

    def with_values(self, values: Mapping[str, float]) -> Effect:
        """Return the effect with some parameter values replaced."""
        if not any(parameter.name in values for parameter in self.parameters):
            return self
        return replace(
            self,
            parameters=tuple(
                p.with_value(values[p.name]) if p.name in values else p for p in self.parameters
            ),
        )

    def structure(self) -> tuple[Hashable, ...]:
        """Everything that shapes the equations, values of parameters excluded."""
        return (
            self.stage,
            self.name,
            tuple((str(key), text) for key, text in self.terms.items()),
            tuple(self.definitions.items()),
            tuple((s.name, s.rate, s.initial) for s in self.states),
            tuple((m.name, m.update, m.initial) for m in self.memory),
            tuple(
                (name, np.asarray(x, float).tobytes().hex(), np.asarray(y, float).tobytes().hex())
                for name, (x, y) in self.tables.items()
            ),
            tuple(p.name for p in self.parameters),
        )


def _check_table(where: str, table: Any) -> None:
    """Refuse a table that is not two rows of numbers over increasing abscissae."""
    try:
        abscissae, ordinates = (np.asarray(one, dtype=float) for one in table)
        good = abscissae.ndim == 1 and abscissae.shape == ordinates.shape and abscissae.size > 1
        good = good and bool(np.all(np.isfinite(ordinates)) and np.all(np.diff(abscissae) > 0))
    except (TypeError, ValueError):
        good = False
    if not good:
        raise ModelError(
            f"{where} is {table!r:.80}. Expected (abscissae, ordinates), two or more numbers each, "
            "finite, abscissae increasing."
        )


@dataclass(frozen=True)
class Actuator(Effect):
    """What happens between command and actual deflection or thrust.

    ``terms`` maps an actuator signal of the model to its new value, as an
    expression of its present value (the same name), inputs, parameters,
    memory, the time ``t`` and the step ``h``. The value is the mean over the
    integration step, so that lags, delays and rate limits are exact for held
    commands.
    """

    stage: ClassVar[str] = "actuator"


@dataclass(frozen=True)
class Environment(Effect):
    """Current, wind, waves as flow: ``terms`` maps a flow signal to its new value."""

    stage: ClassVar[str] = "environment"


@dataclass(frozen=True)
class Force(Effect):
    """A generalized force: ``terms`` maps an axis (or a state) to what is added.

    For an axis (``"X"``, ``"Z"``, ``"M"`` ...) the unit is N or N m; for the
    name of a state it is that state's unit per second.
    """

    stage: ClassVar[str] = "force"


@dataclass(frozen=True)
class Inertia(Effect):
    """Mass and added mass: ``terms`` maps ``(axis, state)`` to what is added."""

    stage: ClassVar[str] = "inertia"


@dataclass(frozen=True)
class Sensor(Effect):
    """Imperfect measurement: ``terms`` maps an output to its new value.

    Names of outputs mean the signal as it reaches this effect; ``h`` is the
    time since the previous sample.
    """

    stage: ClassVar[str] = "sensor"
