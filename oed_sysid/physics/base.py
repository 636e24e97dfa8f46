"""The noun of the package: one physical contribution at one stage of the chain.

command -> **actuator** -> **environment** (relative flow) -> **force** ->
**inertia** -> states -> **sensor** -> measured outputs
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Self

from oed_sysid.errors import ModelError, located
from oed_sysid.physics.channels import SAYS, check_signal, settle
from oed_sysid.physics.parameters import Parameter, changed, check_unique
from oed_sysid.text import callables, expressions
from oed_sysid.text.callables import Function, Table, argument_names

# Bounds of an amplitude in typical ones: wide enough to never decide, tight enough to converge.
SPAN = 20.0
STAGES = ("actuator", "environment", "force", "inertia", "sensor")
# Which effects may go on in time: within the motion, or from sample to sample.
_GOING_ON = (
    ("states", "add", ("actuator", "force", "environment")),
    ("memory", "keep", ("actuator", "sensor")),
)


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

    Examples
    --------
    >>> ExtraState("lag", "(u_r - lag)/T_lag", "u_r", "m/s").name
    'lag'
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
    shortest : float
        Of a register of past values, the shortest step, s, for which it is long enough: a model
        divides it by its own (:func:`oed_sysid.physics.registers.refined`). Zero where any is.

    Examples
    --------
    >>> Memory("last", "delta", "0").initial
    '0'
    """

    name: str
    update: str
    initial: str
    shortest: float = 0.0


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


_KINDS: Mapping[str, Any] = {
    **{"name": str, "terms": {object: object}, "parameters": [Parameter]},
    **{"states": [ExtraState], "memory": [Memory], "functions": [Function]},
}


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
        Continuous states the effect adds (actuator, force and environment stages).
    memory : tuple of Memory
        Sampled memory (actuator and sensor stages).
    tables : mapping
        ``name -> (x, y)`` or ``(x, y, values)``, callable in expressions.
    amplitudes : tuple of str or None
        Parameters that are all zero when the effect is absent; ``None`` means
        every parameter of the effect that is not fixed.
    description, source : str
        Words and citation.
    needs : str
        What a manoeuvre must contain for the effect to show.
    noise : RandomProcess or None
        Level and time of what is random about the effect; see
        :mod:`oed_sysid.physics.unknown`.
    functions : tuple of Function
        Functions of CasADi symbols, callable in expressions.
    optional : bool
        Whether a problem leaves this candidate out where its model lacks what it acts on, as those
        of a ready-made list; others are refused.

    Examples
    --------
    >>> from oed_sysid.physics import quadratic_drag
    >>> drag = quadratic_drag("crossflow", "Z", "w_r")
    >>> isinstance(drag, Effect), drag.stage, drag.amplitude_names
    (True, 'force', ('E_crossflow',))
    """

    name: str
    terms: Mapping[Any, str]
    parameters: tuple[Parameter, ...] = ()
    definitions: Mapping[str, str] = field(default_factory=dict)
    states: tuple[ExtraState, ...] = ()
    memory: tuple[Memory, ...] = ()
    tables: Mapping[str, Table] = field(default_factory=dict)
    amplitudes: tuple[str, ...] | None = None
    description: str = ""
    source: str = ""
    needs: str = ""
    noise: RandomProcess | None = None
    functions: tuple[Function, ...] = ()
    optional: bool = False

    stage: ClassVar[str] = ""

    def __post_init__(self) -> None:
        if type(self) is Effect:
            raise ModelError("Use one of Actuator, Environment, Force, Inertia or Sensor.")
        where = f"Effect {self.name!r:.60}"
        settle(self, where, _KINDS)
        tables = {name: callables.check_table(name, t) for name, t in self.tables.items()}
        object.__setattr__(self, "tables", tables)
        self._check_parts()
        for text in self._texts():
            expressions.check_calls(text, where=where, tables=self.callable, complete=False)

    def _check_parts(self) -> None:
        """Refuse parts that do not go together, or not with the stage."""
        where, known = f"Effect {self.name!r}", [parameter.name for parameter in self.parameters]
        check_unique(self.parameters, owner=where)
        if not self.terms and not self.states:
            raise ModelError(f"{where} contributes nothing: give at least one term.")
        for part, verb, stages in _GOING_ON:
            if self.stage not in stages and getattr(self, part):
                raise ModelError(f"{where}: a {self.stage} effect cannot {verb} {part}.")
        if self.memory and self.states:
            raise ModelError(SAYS["memory_and_states"].format(where=where))
        located(ModelError, f"{where} names the amplitude", self.amplitudes or (), known)

    @classmethod
    def from_function(
        cls,
        name: str,
        function: Callable[..., Any],
        targets: str | Sequence[str],
        *,
        parameters: Sequence[Parameter] = (),
        arguments: Sequence[str] = (),
        amplitudes: Sequence[str] | None = None,
        description: str = "",
        source: str = "",
        needs: str = "",
    ) -> Self:
        """Return the effect that a Python function of CasADi symbols describes.

        Parameters
        ----------
        name : str
            Name of the effect; the model prints it as ``name(arguments)``.
        function : callable
            Its arguments are named as states, signals and parameters of the model.
            It returns one scalar, or one for each of several targets.
        targets : str or sequence of str
            What the results are added to (forces) or replace (other stages).
        parameters, amplitudes, description, source, needs
            As of any effect.
        arguments : sequence of str, optional
            Names of the arguments, where the function's own do not say them.

        Examples
        --------
        >>> import casadi as ca
        >>> E = Parameter("E_soft", 0.0, "N s^2/m^2", scale=1.0)
        >>> drag = Force.from_function(
        ...     "soft_drag", lambda u, E_soft: -E_soft * u * ca.sqrt(u**2 + 1e-4), "X",
        ...     parameters=(E,),
        ... )
        >>> drag.terms
        {'X': 'soft_drag(u, E_soft)'}
        """
        keys = (targets,) if isinstance(targets, str) else tuple(targets)
        named = tuple(arguments) or argument_names(name, function)
        functions = tuple(
            Function(
                name if len(keys) == 1 else f"{name}_{key}",
                partial(_result, name, function, place, len(keys)),
                named,
            )
            for place, key in enumerate(keys)
        )
        calls = [f"{part.name}({', '.join(named)})" for part in functions]
        return cls(
            name,
            dict(zip(keys, calls, strict=True)),
            tuple(parameters),
            amplitudes=None if amplitudes is None else tuple(amplitudes),
            description=description,
            source=source,
            needs=needs,
            functions=functions,
        )

    @property
    def callable(self) -> dict[str, Table | Function]:
        """Tables and functions of its own, by name."""
        return {**self.tables, **{function.name: function for function in self.functions}}

    def uses(self) -> frozenset[str]:
        """Names that the effect refers to and does not define itself."""
        own = {*self.definitions, *(m.name for m in self.memory), *(s.name for s in self.states)}
        inside = [*self.terms.values(), *self.definitions.values()]
        inside += [*(s.rate for s in self.states), *(m.update for m in self.memory)]
        return frozenset(name for text in inside for name in expressions.names(text)) - own

    def _texts(self) -> tuple[str, ...]:
        return (
            *(*self.terms.values(), *self.definitions.values()),
            *(text for state in self.states for text in (state.rate, state.initial)),
            *(text for memory in self.memory for text in (memory.update, memory.initial)),
        )

    @property
    def amplitude_names(self) -> tuple[str, ...]:
        """Parameters that are zero when the effect is absent."""
        if self.amplitudes is not None:
            return self.amplitudes
        return tuple(p.name for p in self.parameters if not p.fixed)

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Estimated parameters that are no amplitudes and that records share, as a frequency."""
        return self._others(per_record=False)

    @property
    def start_names(self) -> tuple[str, ...]:
        """Estimated parameters of each record that are no amplitudes, such as a start value."""
        return self._others(per_record=True)

    def _others(self, *, per_record: bool) -> tuple[str, ...]:
        free = [p.name for p in self.parameters if not p.fixed and p.per_record == per_record]
        return tuple(name for name in free if name not in self.amplitude_names)

    def absent(self) -> Effect:
        """Return the effect with every amplitude at zero."""
        return self.with_values(dict.fromkeys(self.amplitude_names, 0.0))

    def with_values(self, values: Mapping[str, float]) -> Effect:
        """Return the effect with some parameter values replaced."""
        if not any(parameter.name in values for parameter in self.parameters):
            return self
        return changed(self, values, lambda p: p.with_value(values[p.name]))

    def widened(self) -> Effect:
        """Return the effect without those bounds of its amplitudes that nobody declared."""
        return changed(self, self.amplitude_names, _unbounded)

    def structure(self) -> tuple[Hashable, ...]:
        """Everything that shapes the equations, values of parameters excluded."""
        return (
            self.stage,
            self.name,
            tuple((str(key), text) for key, text in self.terms.items()),
            tuple(self.definitions.items()),
            tuple((s.name, s.rate, s.initial) for s in self.states),
            tuple((m.name, m.update, m.initial) for m in self.memory),
            tuple((name, *callables.digest(table)) for name, table in self.tables.items()),
            tuple(p.name for p in self.parameters),
            tuple((f.name, *callables.digest(f)) for f in self.functions),
        )


def _unbounded(parameter: Parameter) -> Parameter:
    """The parameter without bounds that only follow from its typical size."""
    by_default = parameter.upper >= SPAN * parameter.magnitude
    if not by_default or not math.isfinite(parameter.upper):
        return parameter
    lowest = -math.inf if parameter.lower < 0.0 else parameter.lower
    return replace(parameter, lower=lowest, upper=math.inf)


def _result(name: str, function: Callable[..., Any], place: int, count: int, *x: Any) -> Any:
    """One of the results of a function that serves several targets."""
    results = function(*x)
    if count == 1:
        return results
    if not isinstance(results, tuple | list) or len(results) != count:
        raise ModelError(f"{name!r} returns {results!r}; expected a tuple of {count} results.")
    return results[place]


@dataclass(frozen=True)
class Actuator(Effect):
    """What happens between command and actual deflection or thrust.

    ``terms`` maps an actuator signal of the model to its new value, as an
    expression of its present value (the same name), inputs, parameters,
    memory, the time ``t`` and the step ``h``. The value is the mean over the
    integration step, so that lags, delays and rate limits are exact for held
    commands.

    An effect that names states of the model, or adds states, acts within the
    equations of motion instead, on what the sampled effects leave: a steering
    engine that slows down under load, a thruster with inertia.

    Examples
    --------
    >>> from oed_sysid.physics import actuator_lag
    >>> lag = actuator_lag("rudder_lag", "delta")
    >>> lag.stage, list(lag.terms)
    ('actuator', ['delta'])
    """

    stage: ClassVar[str] = "actuator"


@dataclass(frozen=True)
class Environment(Effect):
    """Current, wind, waves as flow: ``terms`` maps a flow signal to its new value.

    Examples
    --------
    >>> from oed_sysid.physics import current_forward
    >>> current_forward().stage
    'environment'
    """

    stage: ClassVar[str] = "environment"


@dataclass(frozen=True)
class Force(Effect):
    """A generalized force: ``terms`` maps an axis (or a state) to what is added.

    For an axis (``"X"``, ``"Z"``, ``"M"`` ...) the unit is N or N m; for the
    name of a state it is that state's unit per second.

    Examples
    --------
    >>> from oed_sysid import Parameter
    >>> drag = Force("drag", {"X": "-X_uu*u*abs(u)"}, (Parameter("X_uu", 0.0, "kg/m"),))
    >>> drag.stage, drag.amplitude_names
    ('force', ('X_uu',))
    """

    stage: ClassVar[str] = "force"


@dataclass(frozen=True)
class Inertia(Effect):
    """Mass and added mass: ``terms`` maps ``(axis, state)`` to what is added.

    Examples
    --------
    >>> from oed_sysid.physics import added_mass_coupling, LIBRARY
    >>> LIBRARY["added_mass_coupling"].row.kind is Inertia
    True
    """

    stage: ClassVar[str] = "inertia"


@dataclass(frozen=True)
class Sensor(Effect):
    """Imperfect measurement: ``terms`` maps an output to its new value.

    Names of outputs mean the signal as it reaches this effect; ``h`` is the
    time since the previous sample.

    Examples
    --------
    >>> from oed_sysid.physics import sensor_bias
    >>> sensor_bias("gyro", "r", "rad/s", scale=0.01).terms
    {'r': 'r + E_gyro'}
    """

    stage: ClassVar[str] = "sensor"


def amplitude(
    effect: str,
    unit: str,
    *,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
    positive: bool = False,
    bound: float = math.inf,
    per_record: bool = False,
    description: str = "",
) -> Parameter:
    """Parameter that measures an effect's size.

    Parameters
    ----------
    effect : str
        Name of the effect; the parameter is called ``"E_" + effect``.
    unit : str
        SI unit.
    scale : float, optional
        Typical amplitude, in ``unit``; by default the size of ``value``, or 1.
    value : float
        Present value; zero is absent.
    parameter : str, optional
        Another name.
    positive : bool
        Whether the amplitude cannot be negative, as a delay cannot.
    bound : float
        Largest magnitude that makes sense, where it is less than twenty scales.
    per_record : bool
        Whether the value differs from record to record.
    description : str
        What the parameter means.

    Returns
    -------
    Parameter
        Free, and zero where no value is given.

    Examples
    --------
    >>> lag = amplitude("fin_lag", "s", scale=0.25, positive=True)
    >>> lag.name, lag.lower, lag.upper
    ('E_fin_lag', 0.0, 5.0)
    """
    size = abs(value) or 1.0 if scale is None else scale
    limit = min(SPAN * max(size, abs(value)), bound)
    return Parameter(
        name=parameter or f"E_{effect}",
        value=value,
        unit=unit,
        lower=0.0 if positive else -limit,
        upper=limit,
        scale=size,
        per_record=per_record,
        description=description,
    )
