r"""What is not the same twice: disturbance forces, noise of logged inputs, unknown inputs.

.. math::
    w(t + \Delta) = e^{-\Delta/\tau} w(t) + \sqrt{1 - e^{-2\Delta/\tau}}\, \sigma\, \epsilon

A random effect adds a first-order Gauss-Markov process ``w`` of standard deviation :math:`\sigma`
and correlation time :math:`\tau` to a force, a logged input or a measurement: Gelb (1974). It is
absent at :math:`\sigma = 0`. On its own a model takes it at its mean, which is zero; an estimator
that knows of process noise (:class:`~oed_sysid.likelihood.multiple_shooting.MultipleShooting`)
estimates both.

A command that nobody logged, or wind, can also be a series that is estimated, Jategaonkar (2015).
It is linear between nodes :math:`t_0 + k\,\Delta` after the beginning of the record,

.. math::
    d(t) = E_0 + \sum_{k=1}^{n} E_k \, \operatorname{clip}\Big(\frac{t - t_0}{\Delta} - k + 1,
    \, 0,\, 1\Big),

:math:`E_0` its first value and :math:`E_k` what it changes by from one node to the next. Each is a
parameter of its own for each record, with a normal prior, :math:`E_0 \sim N(0, s^2)` and
:math:`E_k \sim N(0, c^2)`: a random walk, which keeps the series smooth where the record says
little.
:func:`RandomForce` is the better choice for what changes within seconds; an estimated series is the
better one for what is slow, deterministic in its effect, or to be seen.
"""

from __future__ import annotations

import math
from typing import TypeVar

from oed_sysid.errors import ModelError
from oed_sysid.physics import base
from oed_sysid.physics.base import Actuator, Effect, Force, Sensor
from oed_sysid.physics.channels import SAYS
from oed_sysid.physics.parameters import Parameter, about_zero
from oed_sysid.text.expressions import DEEPEST

GELB = "Gelb (1974), Applied optimal estimation, section 3.8."
SOURCE = "Jategaonkar (2015), Flight vehicle system identification, chapter 3 (unknown inputs)."
# The sum of the series is nested as deep as it has terms; the rest is for what stands about them.
MOST_NODES = DEEPEST - 10

Kind = TypeVar("Kind", bound=Effect)


def RandomForce(
    equation: str, *, level: float = 0.0, time: float = 1.0, known: bool = False
) -> Force:
    """Disturbance force in one equation: waves, gusts, turbulence.

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

    Returns
    -------
    Force
        Absent at level zero.
    """
    words = ("random_force", f"disturbance force in {equation}")
    return _random(Force, equation, words, level, time, known)


def InputNoise(signal: str, *, level: float = 0.0, known: bool = False) -> Actuator:
    """White noise on a logged input: a measured fin angle is a sensor too.

    >>> InputNoise("ds", level=0.002).noise.time
    0.0

    Returns
    -------
    Actuator
        Absent at level zero.
    """
    words = ("input_noise", f"noise on the logged {signal}")
    return _random(Actuator, signal, words, level, 0.0, known)


def SensorDrift(
    output: str, *, level: float = 0.0, time: float = 60.0, known: bool = False
) -> Sensor:
    """Zero of a sensor that wanders.

    >>> SensorDrift("q", level=0.001).terms
    {'q': 'q + disturbance_sensor_q'}

    Returns
    -------
    Sensor
        Absent at level zero.
    """
    words = ("sensor_drift", f"wandering zero of {output}")
    return _random(Sensor, output, words, level, time, known)


def _random(
    kind: type[Kind], key: str, words: tuple[str, str], level: float, time: float, known: bool
) -> Kind:
    """Effect of a Gauss-Markov process, which a model alone takes at its mean."""
    place, name = f"{kind.stage} {key}", f"disturbance_{kind.stage}_{key}"
    if level < 0 or time < 0:
        raise ModelError(SAYS["random_process"].format(place=place, level=level, time=time))
    return kind(
        f"{words[0]}_{key}",
        {key: name if kind is Force else f"{key} + {name}"},
        (Parameter(name, 0.0, fixed=True),),
        noise=base.RandomProcess(place, name, level, time, known),
        description=words[1],
        source=GELB,
    )


def UnknownInput(
    signal: str,
    unit: str,
    *,
    duration: float,
    spacing: float,
    scale: float,
    change: float | None = None,
) -> Actuator:
    """Add an estimated series to an input: a rudder that was not logged, a wind.

    An input that was not logged at all is declared in the model and constant in the records
    (``constant = 0`` in a mapping of a log).

    Parameters
    ----------
    signal : str
        Input, or another signal of the actuators, that the series is added to.
    unit : str
        SI unit of the signal.
    duration : float
        Length of the longest record, s; the series is constant after it.
    spacing : float
        Time between two nodes, s.
    scale : float
        Standard deviation of the first value, in ``unit``.
    change : float, optional
        Standard deviation of the change from node to node; half of ``scale`` if not given.

    Returns
    -------
    Actuator
        With ``duration/spacing + 1`` parameters of each record.

    Raises
    ------
    ModelError
        If a number is not positive, or there are too many nodes.

    Examples
    --------
    >>> effect = UnknownInput("rudder", "rad", duration=60.0, spacing=15.0, scale=0.1)
    >>> [parameter.name for parameter in effect.parameters]
    ['E_rudder_0', 'E_rudder_1', 'E_rudder_2', 'E_rudder_3', 'E_rudder_4']
    >>> effect.parameters[1].prior_std, effect.parameters[1].per_record
    (0.05, True)
    """
    return _estimated(Actuator, signal, unit, (duration, spacing, scale, change))


def UnknownForce(
    equation: str,
    unit: str,
    *,
    duration: float,
    spacing: float,
    scale: float,
    change: float | None = None,
) -> Force:
    """Add an estimated series to an equation: a towing force, a slow wind.

    Parameters
    ----------
    equation : str
        Axis (``"N"``) or state that it acts on.
    unit : str
        N, N m, or the state's unit per second.
    duration, spacing, scale, change : float
        As of :func:`UnknownInput`.

    Returns
    -------
    Force

    Raises
    ------
    ModelError
        If a number is not positive, or there are too many nodes.

    Examples
    --------
    >>> effect = UnknownForce("N", "N m", duration=100.0, spacing=25.0, scale=10.0, change=2.0)
    >>> len(effect.parameters), effect.states[0].initial
    (5, 't')
    """
    return _estimated(Force, equation, unit, (duration, spacing, scale, change))


def _estimated(
    kind: type[Kind], place: str, unit: str, sizes: tuple[float, float, float, float | None]
) -> Kind:
    """Effect of a series of nodes, from the beginning of the record on."""
    origin, spacing = f"begin_{place}", sizes[1]
    parameters = _parameters(place, unit, *sizes)
    sampled, word = kind is Actuator, "input" if kind is Actuator else "force"
    # A sampled effect gives the mean over a step: that at its middle.
    now = "t + h/2" if sampled else "t"
    return kind(
        f"unknown_{word}_{place}",
        {place: f"{place} + {_series(parameters)}" if sampled else _series(parameters)},
        parameters,
        definitions={"node": f"({now} - {origin})/{spacing!r}"},
        memory=(base.Memory(origin, origin, "t"),) if sampled else (),
        states=() if sampled else (base.ExtraState(origin, "0", "t"),),
        description=f"unknown {'part of' if sampled else 'force in'} {place}, a node every "
        f"{spacing:g} s",
        source=SOURCE,
        needs="outputs that answer to it faster than it changes",
    )


def _parameters(
    name: str, unit: str, duration: float, spacing: float, scale: float, change: float | None
) -> tuple[Parameter, ...]:
    step = 0.5 * scale if change is None else change
    facts = {"duration": duration, "spacing": spacing, "scale": scale, "change": step}
    for what, value in facts.items():
        if not (isinstance(value, int | float) and 0.0 < value < math.inf):
            raise ModelError(
                f"The unknown input of {name!r} has {what} {value!r}. Give a number above 0."
            )
    count = math.ceil(duration / spacing - 1e-9)
    if count > MOST_NODES:
        raise ModelError(
            f"The unknown input of {name!r} has {count + 1} nodes, more than {MOST_NODES}. Give a "
            "longer spacing; what changes faster is a RandomForce."
        )
    changes = (
        about_zero(f"E_{name}_{k}", unit, step, f"change up to {k * spacing:g} s")
        for k in range(1, count + 1)
    )
    return (about_zero(f"E_{name}_0", unit, scale, "value at the beginning"), *changes)


def _series(parameters: tuple[Parameter, ...]) -> str:
    """The series as a text of the place ``node`` in units of the spacing."""
    terms = [parameters[0].name]
    terms += [f"{one.name}*clip(node - {k}, 0, 1)" for k, one in enumerate(parameters[1:])]
    return " + ".join(terms)
