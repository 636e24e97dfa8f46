"""Mass and added mass: errors of the inertia matrix."""

from __future__ import annotations

from collections.abc import Mapping

from oed_sysid.effects.amplitudes import amplitude
from oed_sysid.effects.base import Inertia
from oed_sysid.language import notation

NEWMAN = "Newman (1977), Marine hydrodynamics, ch. 4, MIT Press."
VANTORRE = "Vantorre et al. (2017), Manoeuvring in shallow and confined water, Encyclopedia."


def added_mass_error(
    name: str,
    axis: str,
    state: str,
    *,
    scale: float | None = None,
    value: float = 0.0,
    bound: float = float("inf"),
) -> Inertia:
    """Error of one entry of the inertia matrix; ``bound`` keeps the matrix positive.

    >>> added_mass_error("heave_added_mass_error", "Z", "w").terms
    {('Z', 'w'): 'E_heave_added_mass_error'}
    """
    unit = notation.unit(f"{axis}_{state}dot")
    size = amplitude(name, unit, scale=scale, value=value, bound=bound)
    return Inertia(
        name,
        {(axis, state): size.name},
        (size,),
        description=f"inertia of {state} in {axis} differs from its nominal value",
        source=NEWMAN,
        needs="accelerations at several speeds, to tell inertia from damping",
    )


def added_mass_coupling(
    name: str,
    first: tuple[str, str],
    second: tuple[str, str],
    *,
    scale: float | None = None,
    value: float = 0.0,
    bound: float = float("inf"),
) -> Inertia:
    """Symmetric error of a pair of entries, such as ``("Z", "q")`` and ``("M", "w")``."""
    unit = notation.unit(f"{first[0]}_{first[1]}dot")
    size = amplitude(name, unit, scale=scale, value=value, bound=bound)
    return Inertia(
        name,
        {first: size.name, second: size.name},
        (size,),
        description=f"inertial coupling of {first[1]} and {second[1]}",
        source=NEWMAN,
        needs="angular and linear accelerations that are not in proportion",
    )


def added_mass_factor(
    name: str,
    entries: Mapping[tuple[str, str], str],
    *,
    scale: float = 0.2,
    value: float = 0.0,
) -> Inertia:
    """Relative change of several entries at once: shallow water, loading, fouling.

    ``entries`` holds what is multiplied, for instance ``{("Y", "v"): "-Y_vdot"}``.
    """
    size = amplitude(name, "1", scale=scale, value=value, bound=0.9)
    return Inertia(
        name,
        {key: f"{size.name}*({text})" for key, text in entries.items()},
        (size,),
        description="added mass changed in proportion, by depth of water or loading",
        source=VANTORRE,
        needs="accelerations at several speeds; one depth or loading per data set",
    )
