"""The same vehicles as a stranger would write them with the package's public names.

What a nominal model has, and what it may lack, stands in ``models/NAME.toml``; a row there is the
function that makes something, its arguments and its options.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from benchmarks.tables import tables
from oed_sysid import Actuator, Force, Input, Model, Output, Parameter, State, physics
from oed_sysid.physics import Effect, amplitude

RELATIVE_PRIOR = 0.3
# Lists of a model, and what makes their rows.
LISTED = {"states": "State", "inputs": "Input", "outputs": "Output"}


def known(name: str, value: float, unit: str, description: str) -> Parameter:
    """A constant."""
    return Parameter(name, value, unit, fixed=True, description=description)


def guess(name: str, value: float, unit: str = "1", description: str = "") -> Parameter:
    """A parameter that is believed to within 30 per cent."""
    spread = RELATIVE_PRIOR * abs(value)
    return Parameter(name, value, unit, prior_mean=value, prior_std=spread, description=description)


def force(name: str, terms: Mapping[str, str], unit: str, scale: float, words: str) -> Force:
    """A force of one amplitude, which the terms are multiplied by."""
    size = amplitude(name, unit, scale=scale)
    scaled = {axis: f"{size.name}*({text})" for axis, text in terms.items()}
    return Force(name, scaled, (size,), description=words)


def zero(name: str, signal: str, unit: str, *, scale: float, bound: float = math.inf) -> Actuator:
    """The zero of an actuator, set anew before each run."""
    size = amplitude(name, unit, scale=scale, bound=bound, per_record=True)
    words = f"zero of {signal} set anew before each run"
    return Actuator(name, {signal: f"{signal} + {size.name}"}, (size,), description=words)


def wind(scale: float) -> Force:
    """A constant force from a fixed direction."""
    return Force(
        "wind_force",
        {
            "X": "E_wind_north*cos(psi) + E_wind_east*sin(psi)",
            "Y": "E_wind_east*cos(psi) - E_wind_north*sin(psi)",
        },
        (amplitude("wind_north", "N", scale=scale), amplitude("wind_east", "N", scale=scale)),
        description="constant force from a fixed direction",
        needs="several headings",
    )


OWN = (known, guess, force, zero, wind, Parameter, State, Input, Output)
MAKERS = vars(physics) | {maker.__name__: maker for maker in OWN}


def made(kind: str, *words: Any) -> Any:
    """What a row of data stands for."""
    has_options = isinstance(words[-1], dict)
    return MAKERS[kind](*words[:-1], **words[-1]) if has_options else MAKERS[kind](*words)


def written(row: Mapping[str, Any]) -> Effect:
    """An effect whose terms are written out."""
    parameters = tuple(made(*words) for words in row.get("parameters", ()))
    effect: Effect = MAKERS[row["kind"]](
        row["name"], row["terms"], parameters, description=row.get("description", "")
    )
    return effect


@dataclass(frozen=True)
class Nominal:
    """Model, candidates, and how hidden sizes read in their amplitudes.

    Attributes
    ----------
    whole : Model
        Nothing is left out, noise levels are declared.
    candidates : tuple of Effect
        What may be missing; a hidden effect has the same name here.
    part : Effect
        What the model usually has, and cases may leave out.
    """

    whole: Model
    candidates: tuple[Effect, ...]
    part: Effect

    def model(self, declared: bool, lacking: str | None) -> Model:
        """The model with its noise levels declared or not, and without the part of that name."""
        outputs = self.whole.outputs
        return replace(
            self.whole,
            outputs=outputs if declared else tuple(replace(o, noise_std=None) for o in outputs),
            effects=tuple(effect for effect in self.whole.effects if effect.name != lacking),
        )

    def effects(self, lacking: str | None) -> tuple[Effect, ...]:
        """Candidates of a case whose nominal model lacks one of its usual parts."""
        if lacking is None:
            return self.candidates
        absent = self.part.with_values(dict.fromkeys(self.part.amplitude_names, 0.0))
        return (*self.candidates, absent)

    def effect(self, name: str) -> Effect:
        """One effect by name."""
        return {effect.name: effect for effect in (*self.candidates, self.part)}[name]

    def values(self, name: str, sizes: Mapping[str, float]) -> dict[str, float]:
        """Amplitudes of an effect from the simulator's sizes, which stand in the same order.

        One amplitude for several keys (the lags of two propellers) has the size of the first.
        """
        return dict(zip(self.effect(name).amplitude_names, sizes.values(), strict=False))


def modelled(data: Mapping[str, Any]) -> Model:
    """A model from its rows: ``model``, and ``parts``, the effects that it has."""
    said = dict(data["model"])
    lists = {
        name: tuple(made(kind, *row) for row in said.pop(name)) for name, kind in LISTED.items()
    }
    lists["parameters"] = tuple(made(*row) for row in said.pop("parameters"))
    inertia = {tuple(pair.split()): term for pair, term in said.pop("inertia", {}).items()}
    effects = tuple(written(row) for row in data["parts"])
    return Model(**said, **lists, inertia=inertia, effects=effects)


@cache
def nominal(vehicle: str) -> Nominal:
    """The nominal model and candidates of a vehicle."""
    data = tables(__file__, f"models/{vehicle}")
    own = {row["name"]: written(row) for row in data.get("own", ())}
    whole = modelled(data)
    candidates = tuple(own[row[0]] if row[0] in own else made(*row) for row in data["candidates"])
    (part,) = (effect for effect in whole.effects if effect.name == data["may_lack"])
    return Nominal(whole, candidates, part)
