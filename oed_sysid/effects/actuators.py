"""What happens between a command and the actual deflection, rate or thrust.

Every constructor takes the signal that it changes. Commands are held between
samples, and the value handed on is the mean over the integration step; lag,
delay and rate limit are exact in this sense, so that they are smooth functions
of their parameter and exactly absent at zero. Lag, delay and rate limit take one
signal or several that share the parameter, such as the fins of one make.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from oed_sysid.effects.amplitudes import amplitude
from oed_sysid.effects.base import Actuator, Memory
from oed_sysid.effects.registers import delay_register

AMERONGEN = "van Amerongen (1982), Adaptive steering of ships, TU Delft."
TAO = "Tao & Kokotović (1996), Adaptive control of systems with actuator nonlinearities, Wiley."
ABBOTT = "Abbott & von Doenhoff (1959), Theory of wing sections, Dover."
FRANKLIN = "Franklin, Powell & Workman (1998), Digital control of dynamic systems, ch. 4."

_GUARD = "1e-9"  # keeps a division by a vanishing time constant finite


def actuator_offset(
    name: str, signal: str, unit: str = "rad", *, scale: float = 0.02, value: float = 0.0
) -> Actuator:
    """Constant difference between actual and commanded value.

    >>> actuator_offset("fin_offset", "ds").terms
    {'ds': 'ds + E_fin_offset'}
    """
    size = amplitude(name, unit, scale=scale, value=value)
    return Actuator(
        name,
        {signal: f"{signal} + {size.name}"},
        (size,),
        description=f"constant offset of {signal}",
        source=AMERONGEN,
        needs="several speeds, to tell it from constant forces",
    )


def actuator_gain_error(
    name: str, signal: str, *, scale: float = 0.1, value: float = 0.0
) -> Actuator:
    """Actual value is ``1 + E`` times the command; free force derivatives absorb it."""
    size = amplitude(name, "1", scale=scale, value=value, bound=0.9)
    return Actuator(
        name,
        {signal: f"{signal}*(1 + {size.name})"},
        (size,),
        description=f"relative error of {signal}",
        source=AMERONGEN,
        needs="a measurement of the deflection, or known force derivatives",
    )


def stall(name: str, signal: str, *, scale: float = 2.0, value: float = 0.0) -> Actuator:
    """Loss of lift at large angles, :math:`d(1 - E d^2)`; valid before full stall."""
    size = amplitude(name, "1/rad^2", scale=scale, value=value)
    return Actuator(
        name,
        {signal: f"{signal}*(1 - {size.name}*{signal}**2)"},
        (size,),
        description=f"effect of {signal} grows less than in proportion",
        source=ABBOTT,
        needs=f"small and large {signal}",
    )


def actuator_lag(
    name: str,
    signal: str | Sequence[str],
    *,
    scale: float = 0.25,
    value: float = 0.0,
    parameter: str | None = None,
) -> Actuator:
    """First-order lag of time constant ``E``, of one signal or of several alike.

    >>> sorted(actuator_lag("lag", ("port", "starboard")).terms)
    ['port', 'starboard']
    """
    size = amplitude(name, "s", scale=scale, value=value, parameter=parameter, positive=True)
    terms, memory = {}, []
    for channel, actual in _remembered(signal):
        behind = f"({actual} - {channel})"
        terms[channel] = f"{channel} + {behind}*{size.name}/h*(1 - decay)"
        memory.append(Memory(actual, f"{channel} + {behind}*decay", channel))
    return Actuator(
        name,
        terms,
        (size,),
        definitions={"decay": f"exp(-h/({size.name} + {_GUARD}))"},
        memory=tuple(memory),
        description=f"{_listed(signal)} follows its command with a first-order lag",
        source=FRANKLIN,
        needs="steps or reversals, sampled faster than the lag",
    )


def actuator_delay(
    name: str,
    signal: str | Sequence[str],
    *,
    max_delay: float = 1.0,
    step: float = 0.1,
    scale: float = 0.2,
    value: float = 0.0,
) -> Actuator:
    """Pure delay of ``E`` seconds; ``step`` is the shortest integration step.

    See :func:`~oed_sysid.effects.registers.delay_register`.
    """
    size = amplitude(name, "s", scale=scale, value=value, positive=True, bound=max_delay)
    terms: dict[str, str] = {}
    memory: list[Memory] = []
    channels = _channels(signal)
    for channel in channels:
        prefix = "past" if len(channels) == 1 else f"past_{channel}"
        late, past = delay_register(
            channel, size.name, max_delay=max_delay, step=step, prefix=prefix
        )
        terms[channel] = late
        memory += past
    return Actuator(
        name,
        terms,
        (size,),
        memory=tuple(memory),
        description=f"{_listed(signal)} follows its command after a dead time",
        source=FRANKLIN,
        needs="steps or reversals, sampled faster than the delay",
    )


def rate_limit(
    name: str,
    signal: str | Sequence[str],
    unit: str = "rad",
    *,
    scale: float = 3.0,
    value: float = 0.0,
) -> Actuator:
    """Limited rate, by its slowness ``E = 1/rate`` so that zero means unlimited.

    See :func:`maximum_rate` for the rate itself.
    """
    per = f"s/({unit})" if "/" in unit else f"s/{unit or 1}"
    size = amplitude(
        name, per, scale=scale, value=value, positive=True, description="1 / maximum rate"
    )
    reach = f"h/max({size.name}, {_GUARD})"
    terms: dict[str, str] = {}
    definitions: dict[str, str] = {}
    memory: list[Memory] = []
    for channel, actual in _remembered(signal):
        ending = actual.removeprefix("actual")
        way, toward = f"way{ending}", f"toward{ending}"
        arrives = f"abs({way})*{size.name} <= h"
        definitions |= {way: f"{channel} - {actual}", toward: f"sign({way})"}
        terms[channel] = (
            f"where({arrives}, {channel} - {way}*abs({way})*{size.name}/(2*h), "
            f"{actual} + {toward}*{reach}/2)"
        )
        after = f"where({arrives}, {channel}, {actual} + {toward}*{reach})"
        memory.append(Memory(actual, after, channel))
    return Actuator(
        name,
        terms,
        (size,),
        definitions=definitions,
        memory=tuple(memory),
        description=f"{_listed(signal)} changes at no more than 1/{size.name} per second",
        source=AMERONGEN,
        needs="steps of different size: the time to arrive grows with the step",
    )


def _channels(signal: str | Sequence[str]) -> tuple[str, ...]:
    return (signal,) if isinstance(signal, str) else tuple(signal)


def _remembered(signal: str | Sequence[str]) -> list[tuple[str, str]]:
    """Each signal with the name of its remembered actual value."""
    channels = _channels(signal)
    return [(c, "actual" if len(channels) == 1 else f"actual_{c}") for c in channels]


def _listed(signal: str | Sequence[str]) -> str:
    return " and ".join(_channels(signal))


def maximum_rate(effect: Actuator) -> float:
    """Rate of a :func:`rate_limit`, infinite where it is absent.

    >>> maximum_rate(rate_limit("fin_rate_limit", "ds", value=4.0))
    0.25
    """
    slowness = effect.parameters[0].value
    return 1.0 / slowness if slowness > 0 else math.inf


def deadband(
    name: str,
    signal: str | Sequence[str],
    unit: str = "rad",
    *,
    scale: float = 0.03,
    value: float = 0.0,
) -> Actuator:
    """Commands within ``±E`` do nothing, larger ones lose ``E``; of one signal or of several."""
    size = amplitude(name, unit, scale=scale, value=value, positive=True, description="half-width")
    terms = {
        channel: f"where(abs({channel}) >= {size.name}, {channel} - {size.name}*sign({channel}), 0)"
        for channel in _channels(signal)
    }
    return Actuator(
        name,
        terms,
        (size,),
        description=f"small {_listed(signal)} commands have no effect",
        source=TAO,
        needs="commands near zero and far from it",
    )


def backlash(
    name: str,
    signal: str | Sequence[str],
    unit: str = "rad",
    *,
    scale: float = 0.03,
    value: float = 0.0,
) -> Actuator:
    """Play of half-width ``E``: the actual value moves when its flank is touched.

    Of one signal or of several alike.
    """
    size = amplitude(name, unit, scale=scale, value=value, positive=True, description="half-width")
    terms, definitions, memory = {}, {}, []
    for channel, actual in _remembered(signal):
        held = actual.replace("actual", "held")
        low, high = f"{channel} - {size.name}", f"{channel} + {size.name}"
        definitions[held] = (
            f"where({actual} > {high}, {high}, where({actual} < {low}, {low}, {actual}))"
        )
        terms[channel] = held
        memory.append(Memory(actual, held, channel))
    return Actuator(
        name,
        terms,
        (size,),
        definitions=definitions,
        memory=tuple(memory),
        description=f"play between command and actual {_listed(signal)}",
        source=TAO,
        needs="reversals of small and large amplitude",
    )


def saturation(name: str, signal: str, limit: float, unit: str = "rad") -> Actuator:
    """Mechanical stops at ``±limit``, a known property of a base model."""
    size = amplitude(name, unit, value=limit, parameter=f"limit_{name}", positive=True)
    return Actuator(
        name,
        {signal: f"max(min({signal}, {size.name}), -{size.name})"},
        (size,),
        amplitudes=(),
        description=f"mechanical stops of {signal}",
        source=AMERONGEN,
        needs="commands beyond the stops",
    )
