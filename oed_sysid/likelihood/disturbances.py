"""Every place of the signal chain at which something may be wrong, as a disturbance.

command -> actuator -> flow -> force -> kinematics -> sensor: at each place an
unknown signal can be admitted, and the linear deviations say what it does to the
outputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from oed_sysid.errors import ModelError
from oed_sysid.physics import Actuator, Effect, Environment, Force, Sensor
from oed_sysid.physics.base import RandomProcess
from oed_sysid.physics.channels import Input
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.text import expressions

DISTURBANCE = "disturbance_"
# ... and where it is a signal.
WAVE = "wave_"


def disturbed_equations(model: Model) -> tuple[str, ...]:
    """Equations in which a force may be missing: axes, or states whose rate is no identity."""
    if model.axes:
        return tuple(model.axes)
    parameters = set(model.parameter_names)
    return tuple(
        state for state, rate in model.kinematics.items() if expressions.names(rate) & parameters
    )


def vehicle_axes(model: Model) -> dict[str, tuple[str, str]]:
    """Equation and velocity of every axis ``X Y Z K M N`` of a vehicle, however it is written.

    Declared axes, else what the names and units of states say: the rate of ``u`` in m/s is the
    surge equation of a model without axes, where it is no identity.
    """
    if model.axes:
        return {axis: (axis, velocity) for axis, velocity in model.axes.items()}
    units, forced = {s.name: s.unit for s in model.states}, disturbed_equations(model)
    found = zip("XYZKMN", "uvwpqr", ["m/s"] * 3 + ["rad/s"] * 3, strict=True)
    return {axis: (s, s) for axis, s, unit in found if s in forced and units[s] == unit}


@dataclass(frozen=True)
class Place:
    """One place of the chain.

    Attributes
    ----------
    stage : str
        ``actuator``, ``flow``, ``force``, ``kinematics`` or ``sensor``.
    signal : str
        Which actuator signal, flow signal, equation, state or output.
    unit : str
        Unit of the disturbance, where it can be told.
    channel : str
        Input from which an actuator's signal comes: its name, or the expression that it is.

    Examples
    --------
    >>> Place("force", "Z", "N").name
    'force Z'
    """

    stage: str
    signal: str
    unit: str = ""
    channel: str = ""

    @property
    def name(self) -> str:
        """Key, for instance ``"force Z"``."""
        return f"{self.stage} {self.signal}"


def places(model: Model) -> tuple[Place, ...]:
    """Places of a model, from command to measurement."""
    equations = disturbed_equations(model)
    state_units = {state.name: state.unit for state in model.states}
    input_units = {channel.name: channel.unit for channel in model.inputs}
    found = [
        Place("actuator", signal, input_units.get(text, ""), text)
        for signal, text in model.actuator_signals.items()
    ]
    found += [
        Place("flow", signal, state_units.get(text, "")) for signal, text in model.signals.items()
    ]
    rates = equation_units(model)
    found += [Place("force", name, rates[name]) for name in equations]
    found += [
        Place("kinematics", name, rates[name]) for name in model.kinematics if name not in equations
    ]
    found += [Place("sensor", output.name, output.unit) for output in model.outputs]
    return tuple(found)


def commands(model: Model) -> list[Place]:
    """Places of the commands: what acts there may be another one than was logged."""
    return [place for place in places(model) if place.stage == "actuator"]


def declared_noise(model: Model) -> list[RandomProcess]:
    """Process noise that a model's own effects state."""
    return [effect.noise for effect in model.effects if effect.noise is not None]


def equation_units(model: Model) -> dict[str, str]:
    """Units of what stands in the equations: rates by state, sums of forces by axis."""
    rates = {state.name: _rate(state.unit) for state in model.states}
    # What turns needs a moment, whatever the name of its axis.
    turns = {axis: rates[velocity].startswith("rad") for axis, velocity in model.axes.items()}
    return rates | {axis: "N m" if turns[axis] else "N" for axis in turns}


def _rate(unit: str) -> str:
    """Unit of the rate of change of a quantity."""
    if not unit:
        return "1/s"
    head, slash, denominator = unit.partition("/")
    if denominator == "s":
        return f"{head}/s^2"
    return f"{unit}/s" if not slash else f"{head}/({denominator} s)"


def disturbance(place: Place) -> Effect:
    """The disturbance of a place as an effect, with one parameter of its own name."""
    name = f"{DISTURBANCE}{place.stage}_{place.signal}"
    return replace(_let_in(place, name), parameters=(Parameter(name, 0.0),))


def with_disturbance_inputs(model: Model, places: Sequence[Place]) -> Model:
    """The model with the disturbances of some places as further inputs, in their order."""
    inputs = tuple(Input(f"{WAVE}{p.stage}_{p.signal}", p.unit) for p in places)
    # A model that names its actuator signals knows its inputs through them alone.
    signals = {**model.actuators, **{i.name: i.name for i in inputs}} if model.actuators else {}
    wide = replace(model, actuators=signals, inputs=(*model.inputs, *inputs))
    return wide + [_let_in(p, i.name) for p, i in zip(places, inputs, strict=True)]


def _let_in(place: Place, name: str) -> Effect:
    """A signal that is admitted at a place, as an effect of its name."""
    kinds: dict[str, type[Effect]] = {"actuator": Actuator, "flow": Environment, "sensor": Sensor}
    # Into equations and kinematics it comes as a force, which needs no signal to stand beside.
    kind = kinds.get(place.stage, Force)
    return kind(name, {place.signal: name if kind is Force else f"{place.signal} + {name}"})


def chosen_places(model: Model, names: Sequence[str] | str) -> tuple[Place, ...]:
    """Places that a user names.

    Parameters
    ----------
    model : Model
    names : str or sequence of str
        ``"all"`` for a force in every equation that may lack one; an equation or a state
        (``"Z"``); or a place in full (``"actuator fin"``, ``"flow u"``, ``"sensor q"``).
    """
    known = {place.name: place for place in places(model)}
    if names == "all":
        forces = tuple(place for place in known.values() if place.stage == "force")
        if not forces:
            raise ModelError(
                f"Model {model.name!r} has no equation with a parameter in which a force could "
                "act. Name the states that are disturbed, such as disturbances=('r',)."
            )
        return forces
    result = {}
    for name in [names] if isinstance(names, str) else names:
        spellings = (name, f"force {name}", f"kinematics {name}")
        found = next(filter(None, map(known.get, spellings)), None)
        if found is None:
            raise ModelError(
                f"There is no place {name!r} for a disturbance in model {model.name!r}. Places "
                f"are: {', '.join(known)}."
            )
        result[found.name] = found
    return tuple(result.values())
