"""Quantities as people at sea say them: angles in degrees, four digits."""

from __future__ import annotations

from math import degrees

from oed_sysid.model import Model


def units_of(model: Model) -> dict[str, str]:
    """Units of all states, inputs and outputs by name."""
    units = {output.name: output.unit for output in model.outputs}
    units |= {state.name: state.unit for effect in model.effects for state in effect.states}
    units |= {state.name: state.unit for state in model.states}
    return units | {channel.name: channel.unit for channel in model.inputs}


def quantity(value: float, unit: str) -> str:
    """Return a number with its unit, angles in degrees.

    Examples
    --------
    >>> quantity(0.0872665, "rad"), quantity(12.0, "m")
    ('5 deg', '12 m')
    """
    if unit in ("rad", "rad/s"):
        # Commands are floating-point sums: 5e-9 deg is zero.
        return f"{round(degrees(value), 6) + 0.0:.4g} {unit.replace('rad', 'deg')}"
    return f"{value:.4g} {unit}".rstrip()


def span(lower: float, upper: float, unit: str) -> str:
    """Return a range with one unit."""
    if lower == -float("inf"):
        return f"up to {quantity(upper, unit)}"
    if upper == float("inf"):
        return f"from {quantity(lower, unit)}"
    if lower == -upper:
        return f"+-{quantity(upper, unit)}"
    return f"{quantity(lower, unit).split(' ')[0]} to {quantity(upper, unit)}"


def percent(share: float) -> str:
    """Return a relative error, a dash where nothing is known; beyond ten its size is no matter."""
    if not share < 1e4:
        return "-"
    if share > 10:
        return ">1000%"
    return f"{100 * share:.3g}%"
