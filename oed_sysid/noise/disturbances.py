"""Every place of the signal chain at which something may be wrong, as a disturbance.

command -> actuator -> flow -> force -> kinematics -> sensor: at each place an
unknown signal can be let in, and the linear deviations say what it does to the
outputs.
"""

from __future__ import annotations

from dataclasses import dataclass

from oed_sysid.diagnosis.linearise import DISTURBANCE, disturbed_equations
from oed_sysid.effects import Actuator, Effect, Environment, Force
from oed_sysid.model import Model
from oed_sysid.parameters import Parameter


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
    """

    stage: str
    signal: str
    unit: str = ""

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
        Place("actuator", signal, input_units.get(text, ""))
        for signal, text in model.actuator_signals.items()
    ]
    found += [
        Place("flow", signal, state_units.get(text, "")) for signal, text in model.signals.items()
    ]
    found += [Place("force", name, _force_unit(model, name, state_units)) for name in equations]
    found += [
        Place("kinematics", name, _rate(state_units[name]))
        for name in model.kinematics
        if name not in equations
    ]
    found += [Place("sensor", output.name, output.unit) for output in model.outputs]
    return tuple(found)


def _force_unit(model: Model, name: str, state_units: dict[str, str]) -> str:
    if name not in model.axes:
        return _rate(state_units[name])
    return "N m" if name in ("K", "M", "N") else "N"


def _rate(unit: str) -> str:
    """Unit of the rate of change of a quantity."""
    if not unit:
        return "1/s"
    head, slash, denominator = unit.partition("/")
    if denominator == "s":
        return f"{head}/s^2"
    return f"{unit}/s" if not slash else f"{head}/({denominator} s)"


def disturbance(place: Place) -> Effect | None:
    """The disturbance of a place as an effect; None for sensors, which need no dynamics."""
    kind = {"actuator": Actuator, "flow": Environment, "force": Force, "kinematics": Force}
    if place.stage not in kind:
        return None
    name = f"{DISTURBANCE}{place.stage}_{place.signal}"
    text = name if kind[place.stage] is Force else f"{place.signal} + {name}"
    return kind[place.stage](name, {place.signal: text}, (Parameter(name, 0.0),))
