"""Hydrodynamic derivatives as effects: everything follows from the name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from oed_sysid.effects.amplitudes import amplitude
from oed_sysid.effects.base import Force
from oed_sysid.errors import ModelError
from oed_sysid.language import notation
from oed_sysid.parameters import Parameter

SNAME = "SNAME (1950), Technical and Research Bulletin 1-5."
ABKOWITZ = "Abkowitz (1964), Lectures on ship hydrodynamics, report Hy-5, Lyngby."

#: Velocities through the water; pass ``symbols={}`` where a model has none.
THROUGH_WATER: Mapping[str, str] = {"u": "u_r", "v": "v_r", "w": "w_r"}


def factor_of(signal: str) -> str:
    """Letter that a velocity signal has in the name of a derivative.

    >>> factor_of("w_r"), factor_of("q")
    ('w', 'q')
    """
    return signal.removesuffix("_r")


def derivative(
    name: str,
    coefficient: str,
    *,
    symbols: Mapping[str, str] = THROUGH_WATER,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
    description: str = "",
    source: str = SNAME,
    needs: str = "",
) -> Force:
    r"""One term of a force expansion, such as :math:`Z_{w|w|} w_r|w_r|`.

    Parameters
    ----------
    name : str
        Name of the effect.
    coefficient : str
        The derivative; axis, factors and unit follow from it.
    symbols : mapping
        Signals for factors; velocities through the water by default.
    scale, value, parameter
        See :func:`~oed_sysid.effects.amplitudes.amplitude`.
    description, source, needs : str
        Words; by default what the derivative's name says.

    Examples
    --------
    >>> derivative("crossflow", "Z_absww", parameter="Z_absww", value=-100.0).terms
    {'Z': 'Z_absww*abs(w_r)*w_r'}
    """
    parsed = notation.parse(coefficient)
    size = amplitude(
        name,
        notation.unit(coefficient),
        scale=scale,
        value=value,
        parameter=parameter,
        description=parsed.description,
    )
    factors = notation.term(coefficient, symbols=symbols)[len(coefficient) :]
    shown = [symbols.get(factor.symbol, factor.symbol) for factor in parsed.factors]
    return Force(
        name,
        {parsed.axis: size.name + factors},
        (size,),
        description=description or parsed.description,
        source=source,
        needs=needs or f"{', '.join(dict.fromkeys(shown)) or 'nothing'} of varied size",
    )


def derivative_group(
    name: str,
    coefficients: Mapping[str, float],
    *,
    symbols: Mapping[str, str] = THROUGH_WATER,
    description: str,
    source: str = SNAME,
    needs: str,
) -> Force:
    """Several terms that come and go together, each with its own amplitude.

    Parameters
    ----------
    name : str
        Name of the effect; amplitudes are called ``E_name_coefficient``.
    coefficients : mapping
        Typical amplitude of each derivative.
    symbols, description, source, needs
        See :func:`derivative`.

    Examples
    --------
    >>> effect = derivative_group(
    ...     "turn", {"X_vr": 1e6, "X_vv": 1e4}, description="loss of speed", needs="turns"
    ... )
    >>> effect.terms
    {'X': 'E_turn_X_vr*v_r*r + E_turn_X_vv*v_r**2'}
    """
    terms: dict[str, list[str]] = {}
    parameters: list[Parameter] = []
    for coefficient, scale in coefficients.items():
        part = derivative(f"{name}_{coefficient}", coefficient, symbols=symbols, scale=scale)
        parameters += part.parameters
        for axis, text in part.terms.items():
            terms.setdefault(axis, []).append(text)
    joined = {axis: " + ".join(texts) for axis, texts in terms.items()}
    return Force(
        name, joined, tuple(parameters), description=description, source=source, needs=needs
    )


def hull_derivatives(
    name: str,
    parameters: Iterable[Parameter],
    *,
    symbols: Mapping[str, str] = THROUGH_WATER,
    extra: Mapping[str, str] | None = None,
    source: str = SNAME,
) -> Force:
    """Hull forces of a base model: one term per named derivative.

    Parameters
    ----------
    name : str
        Name of the effect.
    parameters : iterable of Parameter
        Derivatives such as ``Z_uw``; a missing unit is filled in.
    symbols, source
        See :func:`derivative`.
    extra : mapping
        ``axis -> expression`` of further terms, such as ``{"X": "T - m*q*w"}``.

    Raises
    ------
    ModelError
        If a parameter is an acceleration derivative: these belong in the
        model's inertia.

    Examples
    --------
    >>> hull = hull_derivatives("hull", [Parameter("Z_uw", -40.0)], extra={"Z": "m*u*q"})
    >>> hull.terms, hull.parameters[0].unit
    ({'Z': 'm*u*q + Z_uw*u_r*w_r'}, 'kg/m')
    """
    terms = {axis: [text] for axis, text in (extra or {}).items()}
    complete: list[Parameter] = []
    for parameter in parameters:
        parsed = notation.parse(parameter.name)
        if parsed.is_dot:
            raise ModelError(
                f"{parameter.name!r} multiplies an acceleration. Put it in the model's inertia."
            )
        complete.append(replace(parameter, unit=parameter.unit or notation.unit(parameter.name)))
        terms.setdefault(parsed.axis, []).append(notation.term(parameter.name, symbols=symbols))
    joined = {axis: " + ".join(texts) for axis, texts in terms.items()}
    return Force(
        name,
        joined,
        tuple(complete),
        description="hull forces and moments",
        source=source,
        needs="motion in every direction",
    )


def coupling(
    name: str,
    axis: str,
    velocity: str,
    *,
    speed: str = "u_r",
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    r"""Lift-type coupling :math:`E\,u_r v` of one motion into another axis."""
    factor = factor_of(velocity)
    return derivative(
        name,
        f"{axis}_u{factor}",
        symbols={"u": speed, factor: velocity},
        scale=scale,
        value=value,
        parameter=parameter,
        source=ABKOWITZ,
        needs=f"{velocity} independent of the other motions",
    )
