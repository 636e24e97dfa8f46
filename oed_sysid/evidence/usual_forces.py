"""Forces and rates that an equation may lack, where nobody named any: low powers of each motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from oed_sysid.errors import OedSysidError
from oed_sysid.evidence.dictionary import Factors, Term, cyclic
from oed_sysid.evidence.sizes import Sizes
from oed_sysid.physics import Effect, Force, forces
from oed_sysid.physics.model import Model
from oed_sysid.physics.table import ABKOWITZ
from oed_sysid.text.dimensions import dimension_of
from oed_sysid.text.units import Dimension, dimension

# Share of the accelerations seen that a force makes.
OF_FORCE = 0.2
# Motions that a vehicle with a plane of symmetry couples: in the plane, and across it.
IN_PLANE, ACROSS = ("u", "w", "q"), ("v", "p", "r")
# Share of its typical speed over which dry friction changes sign.
SLOW = 0.02
# Angles whose sine turns a floating or submerged body back.
RIGHTING = {"K": "phi", "M": "theta"}


def usual_forces(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Terms of every equation that may lack one, absent."""
    units = {state.name: state.unit for state in model.states}
    units |= {channel.name: channel.unit for channel in model.inputs}
    through = {text: signal for signal, text in model.signals.items() if text in units}
    units |= {signal: units[state] for state, signal in through.items()}
    commands = commanded(model)
    units |= commands
    taken = {name.removesuffix("_prime") for name in model.free_names}
    for equation in sizes.mobility:
        state = model.axes.get(equation, equation)
        size = OF_FORCE * sizes.force(equation, state)
        for word, text, factors, level in _powers(model, sizes, equation, state, through, commands):
            term = Term(equation, text, factors)
            if size > 0 and level > 0 and term.symbol not in taken:
                yield _named(term.effect(model, units, size / level), word, equation, text)
        if size > 0 and not model.axes and state not in cyclic(model):
            yield forces.coulomb_friction(
                f"friction_{state}", equation, state, unit=_rate_unit(units[state]),
                velocity_unit=units[state], smooth=SLOW * sizes.level[state], scale=size,
            )  # fmt: skip


def _named(force: Force, word: str, equation: str, text: str) -> Force:
    """A term of the dictionary under a name that says what it is."""
    kind, _, signal = word.partition("_")
    return replace(
        force,
        name="_".join(part for part in (kind, equation, signal) if part),
        description=f"constant {equation}" if text == "1" else f"{text} in the {equation} equation",
        source=ABKOWITZ,
        needs=f"{signal} of varied size" if signal else "a steady part of the motion",
    )


def _rate_unit(unit: str) -> str:
    return str(Dimension((dimension(unit) / dimension("s")).exponents))


_Power = tuple[str, str, Factors, float]


def _powers(
    model: Model,
    sizes: Sizes,
    equation: str,
    state: str,
    through: dict[str, str],
    commands: dict[str, str],
) -> Iterator[_Power]:
    """Word, text, factors and typical size of every term that an equation may lack."""
    yield "constant", "1", (), 1.0
    for other in _coupled(model, equation, state):
        signal, level = through.get(other, other), sizes.level[other]
        plain, absolute = (signal, False), (signal, True)
        forward = through.get("u", "u")
        even = equation == "X" and other != "u"  # drag does not know starboard from port
        if even:
            yield f"quadratic_{signal}", f"{signal}**2", (plain, plain), level**2
            continue
        if "u" in model.axes.values() and other != "u":
            speed = sizes.level["u"]
            factors = ((forward, False), plain)
            yield f"lift_{signal}", f"{forward}*{signal}", factors, level * speed
        else:
            yield f"linear_{signal}", signal, (plain,), level
        yield f"quadratic_{signal}", f"abs({signal})*{signal}", (absolute, plain), level**2
        if not model.axes or (other == state and other != "u"):
            yield f"cubic_{signal}", f"{signal}**3", (plain,) * 3, level**3
    for signal, unit in commands.items():
        level = sizes.level.get(signal, 0.0)
        twice = ((signal, False),) * 2
        if equation == "X" and unit == "rad":
            yield f"drag_{signal}", f"{signal}**2", twice, level**2
        elif equation == "X" and "u" in model.axes.values() and unit != "m/s":
            forward = through.get("u", "u")  # thrust falls with the speed of advance
            pair, size = ((forward, False), (signal, False)), level * sizes.level["u"]
            yield f"advance_{signal}", f"{forward}*{signal}", pair, size
        elif not model.axes:
            one, size = (signal, False), level**2
            yield f"quadratic_{signal}", f"abs({signal})*{signal}", ((signal, True), one), size
    angle = RIGHTING.get(equation)
    if angle in model.state_names:
        yield f"righting_{angle}", f"sin({angle})", (), sizes.level[angle]
        thrice = ((angle, False),) * 3  # a hull that hardens or softens as it heels
        yield f"hardening_{angle}", f"{angle}**3", thrice, sizes.level[angle] ** 3


def _coupled(model: Model, equation: str, state: str) -> list[str]:
    """States whose motion an equation is expected to know, its own first."""
    if not model.axes:
        still = cyclic(model)
        others = [name for name in model.state_names if name != state and name not in still]
        return [state, *others]
    moving = list(model.axes.values())
    for plane in (IN_PLANE, ACROSS):
        if state in plane and equation != "X":
            moving = [name for name in moving if name in plane and name != "u"]
    return sorted(moving, key=lambda name: name != state)


def commanded(model: Model) -> dict[str, str]:
    """Actuator signals and their units, which follow from those of inputs and parameters."""
    units = {channel.name: channel.unit for channel in model.inputs}
    known = units | {p.name: p.unit for p in model.all_parameters}
    return {
        signal: units[text] if text in units else _unit(text, known)
        for signal, text in model.actuator_signals.items()
    }


def _unit(text: str, units: dict[str, str]) -> str:
    """Unit of an expression, radians dropped as in those of derivatives; empty if not told."""
    try:
        found = dimension_of(text, {name: dimension(unit) for name, unit in units.items()})
    except OedSysidError:  # units that do not fit are another message's matter
        return ""
    return "" if found is None else str(Dimension(found.exponents))
