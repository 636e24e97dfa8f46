"""Steering of surface ships: rudder, turning and course-keeping."""

from __future__ import annotations

from collections.abc import Mapping

from oed_sysid.effects.actuators import actuator_offset
from oed_sysid.effects.amplitudes import amplitude
from oed_sysid.effects.base import Actuator, Force
from oed_sysid.effects.derivatives import ABKOWITZ, THROUGH_WATER, derivative, derivative_group

NORRBIN = "Norrbin (1971), Theory and observations on the use of a mathematical model, SSPA 68."
BECH = "Bech & Wagner Smith (1969), Analogue simulation of ship manoeuvres, HyA report Hy-14."
VANTORRE = "Vantorre et al. (2017), Manoeuvring in shallow and confined water, Encyclopedia."
MMG = "Yasukawa & Yoshimura (2015), Introduction of MMG standard method, J. Mar. Sci. Tech. 20."


def rudder_neutral_angle(
    name: str = "rudder_neutral_angle",
    signal: str = "delta",
    *,
    scale: float = 0.01,
    value: float = 0.0,
) -> Actuator:
    """Rudder angle that keeps a ship straight is not zero: offset of the actual angle."""
    return actuator_offset(name, signal, scale=scale, value=value)


def speed_loss_in_turn(
    name: str = "speed_loss_in_turn",
    *,
    scales: Mapping[str, float],
    symbols: Mapping[str, str] = THROUGH_WATER,
) -> Force:
    """Added resistance of drift, yaw rate and rudder, quadratic and even.

    ``scales`` gives the typical size of any of ``X_vr X_vv X_rr X_deltadelta``.
    """
    return derivative_group(
        name,
        scales,
        symbols=symbols,
        description="speed falls in a turn",
        source=ABKOWITZ,
        needs="turning circles of several rudder angles, with speed measured",
    )


def nonlinear_yaw_damping(
    name: str = "nonlinear_yaw_damping",
    *,
    axis: str = "N",
    rate: str = "r",
    scales: Mapping[str, float],
) -> Force:
    r"""Norrbin's and Bech's steady characteristic, :math:`n_0 + n_2 r^2 + n_3 r^3`.

    The linear term belongs to the base model. ``scales`` gives typical sizes of
    ``constant``, ``quadratic`` and ``cubic``; those left out are zero.
    """
    factors = {"constant": "0", "quadratic": rate * 2, "cubic": rate * 3}
    return derivative_group(
        name,
        {f"{axis}_{factors[kind]}": scale for kind, scale in scales.items()},
        symbols={},
        description="turning rate is no linear function of the rudder angle",
        source=f"{NORRBIN} {BECH}",
        needs="a spiral test, or turns with small and large rudder angles to both sides",
    )


def shallow_water(
    name: str = "shallow_water",
    *,
    terms: Mapping[str, str],
    scale: float = 0.3,
    value: float = 0.0,
) -> Force:
    r"""Hull forces that grow in proportion where the water is shallow, :math:`E\,\tau_{hull}`.

    ``terms`` holds the hull forces of the nominal model, for instance
    ``{"Y": "Y_uv*u_r*v_r", "N": "N_ur*u_r*r"}``. Added masses grow as well: see
    :func:`~oed_sysid.effects.inertia.added_mass_factor`. One depth per data set.
    """
    size = amplitude(name, "1", scale=scale, value=value, bound=3.0)
    return Force(
        name,
        {axis: f"{size.name}*({text})" for axis, text in terms.items()},
        (size,),
        description="hull forces changed in proportion, by the depth of the water",
        source=VANTORRE,
        needs="turns at several speeds in one depth of water",
    )


def rudder_stall(
    name: str,
    axis: str,
    *,
    rudder: str = "delta",
    velocity: str = "u_r",
    scale: float | None = None,
    value: float = 0.0,
) -> Force:
    r"""Rudder force that grows less than its angle, :math:`E\,u_r^2\delta^3`."""
    return derivative(
        name,
        f"{axis}_uu{rudder * 3}",
        symbols={"u": velocity},
        scale=scale,
        value=value,
        source=ABKOWITZ,
        needs=f"small and large {rudder}",
    )


def rudder_in_slipstream(
    name: str,
    axis: str,
    *,
    thrust: str = "T",
    rudder: str = "delta",
    scale: float = 0.3,
    value: float = 0.0,
) -> Force:
    r"""Rudder force of the propeller race, :math:`E\,T\delta`; for a moment ``E`` holds the arm."""
    size = amplitude(name, "m" if axis in "KMN" else "1", scale=scale, value=value)
    return Force(
        name,
        {axis: f"{size.name}*{thrust}*{rudder}"},
        (size,),
        description="the rudder acts in the propeller's race",
        source=MMG,
        needs="rudder angles at several thrusts and speeds",
    )
