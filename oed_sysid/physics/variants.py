r"""Effects made of effects: of another size in every record, or with an unknown start.

What is steady in a record and another in the next (trims, currents and winds of the day) has
amplitudes of its own in each. An actuator with memory begins at the first command, as if it had
been held for long; a record that is cut out of a manoeuvre, or begins with a step, begins
elsewhere: the fin was still on its way, and backlash was anywhere in its gap. With memory
:math:`m` of command :math:`\delta`,

.. math:: m_0 = \delta_0 + s_i, \qquad s_i \sim N(0, \sigma^2) ,

:math:`s_i` is one more start value of record *i*, with a prior as wide as commands are.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from fnmatch import fnmatch

from oed_sysid.errors import ModelError
from oed_sysid.physics.base import Actuator, Effect
from oed_sysid.physics.channels import SAYS
from oed_sysid.physics.parameters import about_zero

BY_RECORD = "_by_record"
# What is steady in a record and another in the next: trims, currents and winds.
FROM_DAY_TO_DAY = ("*_offset", "*_neutral_angle", "current*", "drift_*", "wind")


def day_to_day(effects: Iterable[Effect]) -> list[Effect]:
    """Those of some effects that differ from day to day, of their own size in every record."""
    kinds = FROM_DAY_TO_DAY
    return [in_each_record(e) for e in effects if any(fnmatch(e.name, kind) for kind in kinds)]


def in_each_record(effect: Effect) -> Effect:
    """Return an effect whose amplitudes differ from record to record; its shape is shared.

    Parameters
    ----------
    effect : Effect
        Without states, memory or definitions of its own.

    Returns
    -------
    Effect
        Its name and parameters end in ``_by_record``, so that both can be candidates.

    Raises
    ------
    ModelError
        If the effect has states, memory or definitions.

    Examples
    --------
    >>> from oed_sysid.physics import actuator_offset
    >>> trim = in_each_record(actuator_offset("trim", "delta"))
    >>> trim.name, trim.terms, trim.parameters[0].per_record
    ('trim_by_record', {'delta': 'delta + E_trim_by_record'}, True)
    """
    if effect.states or effect.memory or effect.definitions:
        raise ModelError(SAYS["shared_parts"].format(effect=effect))
    renamed = {parameter.name: f"{parameter.name}{BY_RECORD}" for parameter in effect.parameters}
    known = re.compile(rf"\b({'|'.join(map(re.escape, renamed))})\b")
    sizes = effect.amplitude_names
    return replace(
        effect,
        name=f"{effect.name}{BY_RECORD}",
        terms={
            place: known.sub(lambda match: renamed[match[0]], text)
            for place, text in effect.terms.items()
        },
        parameters=tuple(
            replace(parameter, name=renamed[parameter.name], per_record=parameter.name in sizes)
            for parameter in effect.parameters
        ),
        amplitudes=tuple(renamed[name] for name in sizes),
        description=f"{effect.description}, another in every record",
    )


def unknown_start(effect: Actuator, std: float, unit: str = "rad") -> Actuator:
    """Return an actuator whose memory begins beside the first command, another way in every record.

    Parameters
    ----------
    effect : Actuator
        Such as :func:`~oed_sysid.physics.actuator_lag` or
        :func:`~oed_sysid.physics.backlash`: its memories begin at a command.
    std : float
        Standard deviation of the actual value about the first command, in its unit: how far
        commands move, or half the gap of a backlash.
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
    >>> from oed_sysid.physics import actuator_lag
    >>> lag = unknown_start(actuator_lag("fin_lag", "ds"), 0.1)
    >>> lag.memory[0].initial, lag.parameters[1].per_record, lag.amplitude_names
    ('ds + start_fin_lag', True, ('E_fin_lag',))
    """
    if not std > 0.0:
        raise ModelError(SAYS["start_std"].format(effect=effect, std=std))
    signals = [name for name in effect.terms if name in {m.initial for m in effect.memory}]
    if not signals:
        raise ModelError(SAYS["no_start"].format(effect=effect))
    many = len(signals) > 1
    names = {signal: f"start_{effect.name}" + f"_{signal}" * many for signal in signals}
    words = "actual {} before the record, less its first command"
    starts = (about_zero(name, unit, std, words.format(one)) for one, name in names.items())
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
