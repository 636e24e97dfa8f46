r"""What an actuator that remembers held before the first sample, unknown in every record.

A lag, a delay, a limited rate and a play begin at the first command, as if it had been held for
long. A record that is cut out of a manoeuvre, or begins with a step, begins elsewhere: the fin was
still on its way, and a play was anywhere in its gap. With memory :math:`m` of command
:math:`\delta`,

.. math:: m_0 = \delta_0 + s_i, \qquad s_i \sim N(0, \sigma^2) ,

:math:`s_i` is one more start value of record *i*, with a prior as wide as commands are.
"""

from __future__ import annotations

from dataclasses import replace

from oed_sysid.effects.base import Actuator
from oed_sysid.errors import ModelError
from oed_sysid.parameters import Parameter


def unknown_start(effect: Actuator, std: float, unit: str = "rad") -> Actuator:
    """Return an actuator whose memory begins beside the first command, another way in every record.

    Parameters
    ----------
    effect : Actuator
        Such as :func:`~oed_sysid.effects.actuators.actuator_lag` or
        :func:`~oed_sysid.effects.actuators.backlash`: its memories begin at a command.
    std : float
        Standard deviation of the actual value about the first command, in its unit: how far
        commands move, or half the gap of a play.
    unit : str
        Of the command.

    Returns
    -------
    Actuator
        With a parameter ``start_NAME`` for each record (``start_NAME_SIGNAL`` for each of
        several signals). The effect is absent at the same amplitudes as before, whatever it holds.

    Raises
    ------
    ModelError
        If the effect remembers no command, or ``std`` is not above zero.

    Examples
    --------
    >>> from oed_sysid.effects import actuator_lag
    >>> lag = unknown_start(actuator_lag("fin_lag", "ds"), 0.1)
    >>> lag.memory[0].initial, lag.parameters[1].per_record, lag.amplitude_names
    ('ds + start_fin_lag', True, ('E_fin_lag',))
    """
    if not std > 0.0:
        raise ModelError(
            f"Effect {effect.name!r}: the start's standard deviation is {std}. Give one above "
            "zero, such as the range of the command, or leave the effect as it is."
        )
    signals = [name for name in effect.terms if name in {m.initial for m in effect.memory}]
    if not signals:
        raise ModelError(
            f"Effect {effect.name!r} has no memory that begins at a command. Only what remembers, "
            "as a lag, a delay, a limited rate or a play, has a start."
        )
    names = {
        signal: f"start_{effect.name}" + (f"_{signal}" if len(signals) > 1 else "")
        for signal in signals
    }
    starts = tuple(
        Parameter(
            name,
            0.0,
            unit,
            prior_mean=0.0,
            prior_std=std,
            scale=std,
            per_record=True,
            description=f"actual {signal} before the record, less its first command",
        )
        for signal, name in names.items()
    )
    memory = tuple(
        replace(m, initial=f"{m.initial} + {names[m.initial]}") if m.initial in names else m
        for m in effect.memory
    )
    return replace(
        effect,
        parameters=(*effect.parameters, *starts),
        memory=memory,
        amplitudes=effect.amplitude_names,
    )
