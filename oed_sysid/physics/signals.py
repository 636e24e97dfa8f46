"""Actuators and sensors: what happens to a command on its way, and to a measurement.

Commands are held between samples, and the value handed on is the mean over the integration step;
lag, delay and rate limit are exact in this sense, so that they are smooth functions of their
parameter and exactly absent at zero. Sensors see the motion where every step begins, and lines in
between. What remembers goes on by integration steps, so that shorter ones make its error as small
as that of the motion. Lag, delay, rate limit, dead band and backlash take one signal or several
that share the parameter, such as the fins of one make.
"""

from __future__ import annotations

from collections.abc import Sequence

from oed_sysid.physics import registers, table
from oed_sysid.physics.base import Actuator, Sensor, amplitude

# Rows of a table: laid out to be read as such.
# fmt: off


@table.row(Actuator)
def actuator_offset(name: str, signal: str, unit: str = "rad", *, scale: float = 0.02,
                    value: float = 0.0) -> None:
    """Constant difference between actual and commanded value.

    >>> actuator_offset("fin_offset", "ds").terms
    {'ds': 'ds + E_fin_offset'}
    """


@table.row(Actuator)
def actuator_gain_error(name: str, signal: str, *, scale: float = 0.1, value: float = 0.0) -> None:
    """Actual value is ``1 + E`` times the command; free force derivatives absorb it."""


@table.row(Actuator)
def stall(name: str, signal: str, *, scale: float = 2.0, value: float = 0.0) -> None:
    """Loss of lift at large angles, :math:`d(1 - E d^2)`; valid before full stall."""


@table.row(Actuator)
def actuator_fading(name: str, signal: str | Sequence[str], *, scale: float = 1e-3,
                    value: float = 0.0) -> None:
    r"""Gain that changes with the time since the record began, :math:`1 + E (t - t_0)`.

    Batteries that sag, motors and oil that warm up; of one signal or of several alike.

    >>> actuator_fading("sag", "n").description
    'gain of n changes over each record'
    """


@table.row(Actuator)
def actuator_speed_gain(name: str, signal: str | Sequence[str], speed: str = "u", *,
                        scale: float = 0.1, value: float = 0.0) -> None:
    r"""Gain that changes with a speed, :math:`1 + E u`, of one signal or of several alike.

    Thrust falls with the speed of advance, and a tunnel thruster is swept by the flow; a fin that
    was modelled at one speed has more lift at a higher one.

    >>> actuator_speed_gain("bow_thruster_at_speed", "n_bow").terms
    {'n_bow': 'n_bow*(1 + E_bow_thruster_at_speed*u)'}
    """


@table.row(Actuator)
def actuator_lag(name: str, signal: str | Sequence[str], *, scale: float = 0.25, value: float = 0.0,
                 parameter: str | None = None) -> None:
    """First-order lag of time constant ``E``, of one signal or of several alike.

    >>> sorted(actuator_lag("lag", ("port", "starboard")).terms)
    ['port', 'starboard']
    """


@table.row(Actuator)
def actuator_delay(name: str, signal: str | Sequence[str], *, max_delay: float = 1.0,
                   step: float = 0.1, scale: float = 0.2, value: float = 0.0) -> table.Derived:
    """Pure delay of ``E`` seconds; ``step`` is the shortest time between two samples.

    A model whose integration steps are shorter divides it.
    """
    return _late(name, table.channels(signal), max_delay, step, scale, value)


@table.row(Actuator)
def rate_limit(name: str, signal: str | Sequence[str], unit: str = "rad", *, scale: float = 3.0,
               value: float = 0.0) -> table.Derived:
    """Limited rate, by its slowness ``E = 1/rate`` so that zero means unlimited.

    The rate itself is one over the value.
    """
    return {"per": f"s/({unit})" if "/" in unit else f"s/{unit or 1}"}


@table.row(Actuator)
def deadband(name: str, signal: str | Sequence[str], unit: str = "rad", *, scale: float = 0.03,
             value: float = 0.0) -> None:
    """Commands within ``±E`` do nothing, larger ones lose ``E``; of one signal or of several."""


@table.row(Actuator)
def backlash(name: str, signal: str | Sequence[str], unit: str = "rad", *, scale: float = 0.03,
             value: float = 0.0) -> None:
    """Backlash of half-width ``E``: the actual value moves when its flank is touched.

    Of one signal or of several alike.
    """


@table.row(Actuator)
def saturation(name: str, signal: str, limit: float, unit: str = "rad") -> table.Derived:
    """Mechanical stops at ``±limit``, a known property of a base model."""
    return {"value": limit, "parameter": f"limit_{name}", "amplitudes": ()}


@table.row(Actuator)
def unknown_limit(name: str, signal: str, unit: str = "rad", *, scale: float = 3.0,
                  value: float = 0.0) -> table.Derived:
    """Saturation at an unknown limit, by its inverse ``E`` so that zero means unlimited."""
    return {"per": f"1/({unit})" if "/" in unit else f"1/{unit or 1}"}


@table.row(Actuator)
def actuator_start(name: str, signal: str, unit: str = "rad", *, time_constant: float = 1.0,
                   span: float = 10.0, scale: float = 0.1) -> None:
    r"""Start of an actuator beside its first command, which fades, :math:`E_i e^{-t/\tau}`.

    Another size in every record; the time constant is estimated.
    """


@table.row(Sensor)
def sensor_bias(name: str, output: str, unit: str, *, scale: float, value: float = 0.0,
                per_record: bool = False) -> None:
    """Constant error.

    >>> sensor_bias("bias_q", "q", "rad/s", scale=0.01).terms
    {'q': 'q + E_bias_q'}
    """


@table.row(Sensor)
def sensor_scale(name: str, output: str, *, scale: float = 0.05, value: float = 0.0) -> None:
    r"""Relative error, :math:`(1 + E)\,y`."""


@table.row(Sensor)
def sensor_misalignment(name: str, first: str, second: str, *, scale: float = 0.02,
                        value: float = 0.0) -> None:
    """Small rotation of a pair of axes: ``first - E second`` and ``second + E first``."""


@table.row(Sensor)
def sensor_lever_arm(name: str, output: str, rate: str, *, scale: float = 0.3,
                     value: float = 0.0) -> table.Derived:
    r"""Velocity sensor off the origin: a component of :math:`v + \omega \times r`.

    ``E`` is the coordinate in body axes, for a sensor ahead ``w - E q`` and ``v + E r``. Of other
    names than ``u v w p q r`` the sign is minus.

    >>> sensor_lever_arm("log_ahead", "v", "r").terms
    {'v': 'v + E_log_ahead*r'}
    """
    # Of v + q z - r y and its like, the terms that are added.
    return {"way": "+" if (output, rate) in (("u", "q"), ("v", "r"), ("w", "p")) else "-"}


@table.row(Sensor)
def sensor_lag(name: str, outputs: str | Sequence[str], *, scale: float = 0.3,
               value: float = 0.0) -> None:
    """First-order lag of one or several outputs, exact for signals linear within a step.

    Of one that curves within an integration step ``h`` the estimate is low by some
    :math:`h^2/(12 E)`; a fit takes finer steps where that moves an estimate.
    """


@table.row(Sensor)
def sensor_delay(name: str, output: str, *, max_delay: float = 1.0, interval: float = 0.1,
                 scale: float = 0.2, value: float = 0.0) -> table.Derived:
    """Late measurement of samples a regular ``interval`` apart, interpolated between steps."""
    return _late(name, (output,), max_delay, interval, scale, value)


@table.row(Sensor)
def sensor_drift(name: str, output: str, unit: str, *, scale: float, value: float = 0.0) -> None:
    r"""Error that grows with time, :math:`y + E\,t`; ``unit`` is that of ``E``."""


# fmt: on
def _late(
    name: str, signals: Sequence[str], longest: float, step: float, scale: float, value: float
) -> table.Derived:
    """Amplitude of signals that come late by the same time, and their registers."""
    delay = amplitude(name, "s", scale=scale, value=value, positive=True, bound=longest)
    return {"E": delay, **registers.register(signals, delay.name, longest, step)}
