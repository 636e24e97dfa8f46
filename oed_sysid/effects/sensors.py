"""Imperfect measurement: bias, scale, misalignment, lever arm, lag, delay, drift.

Every constructor takes the output or outputs that it changes.
"""

from __future__ import annotations

from collections.abc import Sequence

from oed_sysid.effects.amplitudes import amplitude
from oed_sysid.effects.base import Memory, Sensor
from oed_sysid.effects.registers import delay_register

KINSEY = "Kinsey & Whitcomb (2007), In situ alignment calibration, IEEE Trans. Robotics 23."
GROVES = "Groves (2013), Principles of GNSS, inertial and multisensor navigation, ch. 4."
FRANKLIN = "Franklin, Powell & Workman (1998), Digital control of dynamic systems, ch. 4."


def sensor_bias(
    name: str,
    output: str,
    unit: str,
    *,
    scale: float,
    value: float = 0.0,
    per_record: bool = False,
) -> Sensor:
    """Constant error.

    >>> sensor_bias("bias_q", "q", "rad/s", scale=0.01).terms
    {'q': 'q + E_bias_q'}
    """
    size = amplitude(name, unit, scale=scale, value=value, per_record=per_record)
    return Sensor(
        name,
        {output: f"{output} + {size.name}"},
        (size,),
        description=f"constant error of {output}",
        source=GROVES,
        needs=f"{output} linked to other outputs, over longer than the initial transient",
    )


def sensor_scale(name: str, output: str, *, scale: float = 0.05, value: float = 0.0) -> Sensor:
    r"""Relative error, :math:`(1 + E)\,y`."""
    size = amplitude(name, "1", scale=scale, value=value, bound=0.9)
    return Sensor(
        name,
        {output: f"{output}*(1 + {size.name})"},
        (size,),
        description=f"relative error of {output}",
        source=GROVES,
        needs=f"large changes of {output}",
    )


def sensor_misalignment(
    name: str, first: str, second: str, *, scale: float = 0.02, value: float = 0.0
) -> Sensor:
    """Small rotation of a pair of axes: ``first - E second`` and ``second + E first``."""
    size = amplitude(name, "rad", scale=scale, value=value, bound=0.5)
    return Sensor(
        name,
        {
            first: f"{first} - {size.name}*{second}",
            second: f"{second} + {size.name}*{first}",
        },
        (size,),
        description=f"the sensor of {first} and {second} is rotated in its mount",
        source=KINSEY,
        needs=f"{first} of varied size, independent of {second}",
    )


def sensor_lever_arm(
    name: str, output: str, rate: str, *, scale: float = 0.3, value: float = 0.0
) -> Sensor:
    """Velocity sensor ahead of the origin: ``output - E rate``, as ``w - E q``."""
    size = amplitude(name, "m", scale=scale, value=value, description="distance from the origin")
    return Sensor(
        name,
        {output: f"{output} - {size.name}*{rate}"},
        (size,),
        description=f"the sensor of {output} is off the origin",
        source=GROVES,
        needs=f"quick changes of {rate}",
    )


def sensor_lag(
    name: str, outputs: str | Sequence[str], *, scale: float = 0.3, value: float = 0.0
) -> Sensor:
    """First-order lag of one or several outputs, exact for signals linear between samples."""
    names = (outputs,) if isinstance(outputs, str) else tuple(outputs)
    size = amplitude(name, "s", scale=scale, value=value, positive=True)
    definitions = {"decay": f"exp(-h/({size.name} + 1e-9))"}
    for y in names:
        behind = f"{size.name}*({y} - {y}_before)/h"
        definitions[f"{y}_behind"] = behind
        definitions[f"{y}_lagged"] = (
            f"{y} - {y}_behind + ({y}_filtered - {y}_before + {y}_behind)*decay"
        )
    memory = [Memory(f"{y}_filtered", f"{y}_lagged", y) for y in names]
    memory += [Memory(f"{y}_before", y, y) for y in names]
    return Sensor(
        name,
        {y: f"{y}_lagged" for y in names},
        (size,),
        definitions=definitions,
        memory=tuple(memory),
        description=f"{' and '.join(names)} measured through a first-order filter",
        source=FRANKLIN,
        needs="quick changes, sampled faster than the lag",
    )


def sensor_delay(
    name: str,
    output: str,
    *,
    max_delay: float = 1.0,
    interval: float = 0.1,
    scale: float = 0.2,
    value: float = 0.0,
) -> Sensor:
    """Late measurement, interpolated between samples a regular ``interval`` apart."""
    size = amplitude(name, "s", scale=scale, value=value, positive=True, bound=max_delay)
    late, memory = delay_register(output, size.name, max_delay=max_delay, step=interval)
    return Sensor(
        name,
        {output: late},
        (size,),
        memory=memory,
        description=f"{output} arrives late",
        source=GROVES,
        needs="quick changes, sampled faster than the delay",
    )


def sensor_drift(name: str, output: str, unit: str, *, scale: float, value: float = 0.0) -> Sensor:
    r"""Error that grows with time, :math:`y + E\,t`; ``unit`` is that of ``E``."""
    size = amplitude(name, unit, scale=scale, value=value)
    return Sensor(
        name,
        {output: f"{output} + {size.name}*t"},
        (size,),
        description=f"linear drift of {output}",
        source=GROVES,
        needs="a long record",
    )
