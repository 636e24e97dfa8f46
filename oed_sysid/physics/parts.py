"""The parts of a model: each of its own kind, and no definition in a circle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from oed_sysid.errors import ModelError
from oed_sysid.physics import Effect
from oed_sysid.physics.channels import Input, Output, State, check_kinds
from oed_sysid.physics.parameters import Parameter
from oed_sysid.text import callables, expressions
from oed_sysid.text.callables import Function

_TUPLES: Mapping[str, type] = {
    "states": State,
    "inputs": Input,
    "outputs": Output,
    "effects": Effect,
    "parameters": Parameter,
    "functions": Function,
}
_MAPPINGS = ("kinematics", "axes", "inertia", "actuators", "signals", "tables")


def settle_parts(model: Any) -> None:
    """Turn the parts of a new model into tuples and dictionaries, or refuse them.

    Parameters
    ----------
    model : Model
        Under construction.

    Raises
    ------
    ModelError
        If a part is of another kind, or definitions refer to each other in a circle.
    """
    owner = f"Model {model.name!r:.60}"
    if not isinstance(model.name, str):
        raise ModelError(f"{owner}: its name is a {type(model.name).__name__}. Give text.")
    for what, kind in _TUPLES.items():
        value = getattr(model, what)
        if isinstance(value, kind | str | bytes | Mapping) or not hasattr(value, "__iter__"):
            raise ModelError(
                f"{owner}: {what} is a {type(value).__name__}, expected a tuple of "
                f"{kind.__name__}(...). One alone is written ({kind.__name__}(...),)."
            )
        parts = tuple(value)
        check_kinds(owner, what, parts, kind)
        object.__setattr__(model, what, parts)
    for what in _MAPPINGS:
        value = getattr(model, what)
        if not isinstance(value, Mapping):
            raise ModelError(
                f"{owner}: {what} is a {type(value).__name__}, expected a mapping such as "
                "{'psi': 'r'}."
            )
        object.__setattr__(model, what, dict(value))
    tables = {name: callables.check_table(name, table) for name, table in model.tables.items()}
    object.__setattr__(model, "tables", tables)
    for key in model.inertia:
        if not (isinstance(key, tuple) and len(key) == 2):
            raise ModelError(f"{owner}: inertia has the key {key!r:.60}, expected ('Z', 'w').")
    if isinstance(model.step, bool) or not isinstance(model.step, int | float):
        raise ModelError(f"{owner} has step {model.step!r:.40}. Give seconds above zero.")
    if not math.isfinite(model.step):
        raise ModelError(f"{owner} has step {model.step}. Give seconds above zero.")
    check_order(f"{owner}, signal", model.signals)
    for effect in model.effects:
        check_order(f"{owner}, effect {effect.name!r}, definition", effect.definitions)


def check_order(owner: str, definitions: Mapping[str, str]) -> None:
    """Refuse a definition that uses itself or one that comes after it."""
    names = list(definitions)
    for position, (name, text) in enumerate(definitions.items()):
        for later in names[position:]:
            if later in expressions.names(text):
                circle = later == name or name in expressions.names(definitions[later])
                raise ModelError(
                    f"{owner} {name!r} is {text!r:.80}, which uses {later!r}: "
                    + ("they are defined in a circle." if circle else "that is defined after it.")
                    + " Definitions are evaluated in order; use only what stands above."
                )
