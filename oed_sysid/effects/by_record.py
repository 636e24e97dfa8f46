"""The same effect, of another size in every record: trims, currents and winds of the day."""

from __future__ import annotations

import re
from dataclasses import replace

from oed_sysid.effects.base import Effect
from oed_sysid.errors import ModelError

BY_RECORD = "_by_record"


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
    >>> from oed_sysid.effects import actuator_offset
    >>> trim = in_each_record(actuator_offset("trim", "delta"))
    >>> trim.name, trim.terms, trim.parameters[0].per_record
    ('trim_by_record', {'delta': 'delta + E_trim_by_record'}, True)
    """
    if effect.states or effect.memory or effect.definitions:
        raise ModelError(
            f"Effect {effect.name!r} has states, memory or definitions of its own, which two "
            "effects cannot share. Write the second one with Parameter(..., per_record=True)."
        )
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
