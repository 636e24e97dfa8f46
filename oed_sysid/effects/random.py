r"""Random forces, noise on logged inputs, drifting sensors: effects that are not the same twice.

.. math::
    w(t + \Delta) = e^{-\Delta/\tau} w(t) + \sqrt{1 - e^{-2\Delta/\tau}}\, \sigma\, \epsilon

A random effect adds a first-order Gauss-Markov process ``w`` of level :math:`\sigma` and time
:math:`\tau` to a force, a logged input or a measurement. It is absent at level zero. On its own a
model takes it at its mean, which is zero; an estimator that knows of random forces
(:class:`~oed_sysid.estimators.MultipleShooting`) estimates its level and time.
"""

from __future__ import annotations

from oed_sysid.effects.base import Actuator, Effect, Force, RandomProcess, Sensor
from oed_sysid.errors import ModelError
from oed_sysid.parameters import Parameter

GELB = "Gelb (1974), Applied optimal estimation, section 3.8."


def RandomForce(
    equation: str, *, level: float = 0.0, time: float = 1.0, known: bool = False
) -> Force:
    """Random force in one equation: waves, gusts, turbulence.

    Parameters
    ----------
    equation : str
        Axis (``"Z"``) or state that the force acts on.
    level : float
        Standard deviation, N, N m or the state's unit per second; where estimation begins.
    time : float
        Correlation time, s.
    known : bool
        Whether level and time are known rather than estimated.

    >>> RandomForce("Z", level=0.3, time=2.0).noise.place
    'force Z'
    """
    name = f"disturbance_force_{equation}"
    return Force(
        f"random_force_{equation}",
        {equation: name},
        (Parameter(name, 0.0, fixed=True),),
        noise=_process(f"force {equation}", name, level, time, known),
        description=f"random force in {equation}",
        source=GELB,
    )


def InputNoise(signal: str, *, level: float = 0.0, known: bool = False) -> Actuator:
    """White noise on a logged input: a measured fin angle is a sensor too.

    >>> InputNoise("ds", level=0.002).noise.time
    0.0
    """
    name = f"disturbance_actuator_{signal}"
    return Actuator(
        f"input_noise_{signal}",
        {signal: f"{signal} + {name}"},
        (Parameter(name, 0.0, fixed=True),),
        noise=_process(f"actuator {signal}", name, level, 0.0, known),
        description=f"noise on the logged {signal}",
        source=GELB,
    )


def SensorDrift(
    output: str, *, level: float = 0.0, time: float = 60.0, known: bool = False
) -> Sensor:
    """Zero of a sensor that wanders.

    >>> SensorDrift("q", level=0.001).terms
    {'q': 'q + disturbance_sensor_q'}
    """
    name = f"disturbance_sensor_{output}"
    return Sensor(
        f"sensor_drift_{output}",
        {output: f"{output} + {name}"},
        (Parameter(name, 0.0, fixed=True),),
        noise=_process(f"sensor {output}", name, level, time, known),
        description=f"wandering zero of {output}",
        source=GELB,
    )


def random_effects(effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
    """Those effects that are random."""
    return tuple(effect for effect in effects if effect.noise is not None)


def _process(place: str, name: str, level: float, time: float, known: bool) -> RandomProcess:
    if level < 0 or time < 0:
        raise ModelError(
            f"The random process at {place!r} has level {level} and time {time}. Give numbers "
            "that are not negative; level zero means absent."
        )
    return RandomProcess(place, name, level, time, known)
