r"""Forces, flow and inertia: hull, weight, water and air, propeller and rudder, motors and joints.

Damping and drag are hydrodynamic derivatives, whose axis, factors and unit follow from the name;
the rest states its terms. A current changes the velocity through the water, not the forces
themselves: it is steady and uniform, and the rotation of a steady current in body axes is left
out of the added-mass terms, as in the models that this package ships.

Dry friction is smooth here, :math:`\operatorname{sgn} v \approx \tanh(v/v_0)`, so that gradients
exist; within about :math:`v_0` of rest the model creeps instead of sticking. Choose :math:`v_0`
well below the velocities that matter and the integration step well below :math:`m v_0 / F_c`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from oed_sysid import errors
from oed_sysid.physics import table
from oed_sysid.physics.base import Actuator, Environment, Force, Inertia, amplitude
from oed_sysid.physics.parameters import Parameter
from oed_sysid.physics.signals import actuator_offset

# Rows of a table: laid out to be read as such.
# fmt: off
# -- hull: damping and drag -------------------------------------------------------------


@table.row(Force)
def linear_damping(name: str, axis: str, velocity: str, *, scale: float | None = None,
                   value: float = 0.0, parameter: str | None = None) -> None:
    """Force proportional to a velocity: skin friction at low Reynolds number, wave making.

    >>> linear_damping("surge_linear_drag", "X", "u_r").terms
    {'X': 'E_surge_linear_drag*u_r'}
    """


@table.row(Force)
def quadratic_drag(name: str, axis: str, velocity: str, *, scale: float | None = None,
                   value: float = 0.0, parameter: str | None = None) -> None:
    r"""Separated-flow drag :math:`E\,v|v|`; on another axis than the velocity's, its moment.

    >>> quadratic_drag("heave_crossflow_drag", "Z", "w_r", parameter="Z_absww").terms
    {'Z': 'Z_absww*abs(w_r)*w_r'}
    """


@table.row(Force)
def cubic_damping(name: str, axis: str, velocity: str, *, scale: float | None = None,
                  value: float = 0.0, parameter: str | None = None) -> None:
    """Damping that grows with the third power of a velocity."""


@table.row(Force)
def crossed_drag(name: str, axis: str, absolute: str, velocity: str, *, scale: float | None = None,
                 value: float = 0.0, parameter: str | None = None) -> None:
    r"""Cross-flow drag of combined drift and turn, such as :math:`E\,|v_r|r`."""


@table.row(Force)
def induced_drag(name: str, velocity: str, *, axis: str = "X", scale: float | None = None,
                 value: float = 0.0, parameter: str | None = None) -> None:
    r"""Drag due to lift, :math:`E\,w_r^2`: resistance grows with the angle of attack."""


@table.row(Force)
def deflection_drag(name: str, deflection: str, *, axis: str = "X", velocity: str = "u_r",
                    scale: float | None = None, value: float = 0.0,
                    parameter: str | None = None) -> None:
    r"""Drag of a deflected fin or rudder, :math:`E\,u_r^2 d^2`."""


@table.row(Force)
def hull_asymmetry(name: str, axis: str, *, velocity: str = "u_r", scale: float | None = None,
                   value: float = 0.0, parameter: str | None = None) -> None:
    r"""Lift or moment of a hull that is not symmetric, :math:`E\,u_r^2`."""


@table.row(Force)
def coupling(name: str, axis: str, velocity: str, *, speed: str = "u_r", scale: float | None = None,
             value: float = 0.0, parameter: str | None = None) -> None:
    r"""Lift-type coupling :math:`E\,u_r v` of one motion into another axis."""


# -- weight, buoyancy and restoring moments ---------------------------------------------


@table.row(Force)
def excess_buoyancy(name: str = "excess_buoyancy", *, axes: Sequence[str] = ("X", "Z"),
                    angle: str | None = "theta", scale: float = 2.0,
                    value: float = 0.0) -> table.Derived:
    r"""Weight that buoyancy does not carry, :math:`E = W - B`, in the diving plane.

    .. math:: X = -E\sin\theta, \quad Z = E\cos\theta

    ``axes`` are those of ``X Z`` that the model has; a model without pitch has the ``angle`` None.

    >>> excess_buoyancy().terms
    {'X': '-E_excess_buoyancy*sin(theta)', 'Z': 'E_excess_buoyancy*cos(theta)'}
    """
    return {"terms": _downward("{E}", axes, angle)}


@table.row(Force)
def cg_offset(name: str = "cg_offset_x", *, axis: str = "M", angle: str = "theta",
              scale: float = 0.5, value: float = 0.0) -> None:
    r"""Centre of gravity ahead of that of buoyancy: :math:`M = -E\cos\theta`, :math:`E = x_gW`."""


@table.row(Force)
def metacentric_moment(name: str, axis: str, angle: str, *, scale: float | None = None,
                       value: float = 0.0, parameter: str | None = None) -> None:
    r"""Righting moment :math:`-E\sin\theta` with :math:`E = \overline{BG}\,W`."""


@table.row(Force)
def cubic_restoring(name: str, axis: str = "K", angle: str = "phi", *, scale: float | None = None,
                    value: float = 0.0, parameter: str | None = None) -> None:
    r"""Hardening or softening of the restoring moment, :math:`E\,\varphi^3`."""


@table.row(Force)
def heel_moment(name: str, axis: str = "K", *, scale: float | None = None, value: float = 0.0,
                parameter: str | None = None) -> None:
    """Constant moment of shifted cargo or steady wind."""


@table.row(Force)
def righting_arm_table(name: str, angles: Sequence[float], arms: Sequence[float], *,
                       axis: str = "K", angle: str = "phi", scale: float | None = None,
                       value: float = 0.0, parameter: str | None = None) -> table.Derived:
    r"""Righting moment from a tabulated arm, :math:`-E\,\overline{GZ}(\varphi)`, :math:`E = W`.

    ``angles`` in rad, ascending, and ``arms`` in m; linear in between.
    """
    table = f"{name}_arm"
    return {"table": table, "tables": {table: (np.asarray(angles, float), np.asarray(arms, float))}}


@table.row(Force)
def hull_compressibility(name: str = "hull_compressibility", *, axes: Sequence[str] = ("X", "Z"),
                         angle: str | None = "theta", depth: str = "z", reference: float = 10.0,
                         scale: float = 0.15, value: float = 0.0) -> table.Derived:
    r"""Buoyancy lost with depth, :math:`W - B = E\,(z - z_0)`; absent at the reference depth.

    .. math:: X = -E\,(z - z_0)\sin\theta, \quad Z = E\,(z - z_0)\cos\theta

    ``axes`` are those of ``X Z`` that the model has; a model without pitch has the ``angle`` None.

    >>> hull_compressibility(axes=["Z"], angle=None).terms
    {'Z': 'E_hull_compressibility*(z - depth_hull_compressibility)'}
    """
    return {"terms": _downward("{E}*({depth} - {zero})", axes, angle)}


# -- mass and added mass ----------------------------------------------------------------


@table.row(Inertia)
def added_mass_error(name: str, axis: str, state: str, *, scale: float | None = None,
                     value: float = 0.0, bound: float = np.inf) -> table.Derived:
    """Error of one entry of the inertia matrix; ``bound`` keeps the matrix positive.

    >>> added_mass_error("heave_added_mass_error", "Z", "w").terms
    {('Z', 'w'): 'E_heave_added_mass_error'}
    """
    return {"terms": {(axis, state): "{E}"}}


@table.row(Inertia)
def added_mass_coupling(name: str, first: tuple[str, str], second: tuple[str, str], *,
                        scale: float | None = None, value: float = 0.0,
                        bound: float = np.inf) -> table.Derived:
    """Symmetric error of a pair of entries, such as ``("Z", "q")`` and ``("M", "w")``."""
    return {"terms": {first: "{E}", second: "{E}"}}


@table.row(Inertia)
def added_mass_factor(name: str, entries: Mapping[tuple[str, str], str], *, scale: float = 0.2,
                      value: float = 0.0) -> table.Derived:
    """Relative change of several entries at once: shallow water, loading, fouling.

    ``entries`` holds what is multiplied, for instance ``{("Y", "v"): "-Y_vdot"}``.
    """
    return {"terms": {key: f"{{E}}*({text})" for key, text in entries.items()}}


@table.row(Force)
def fluid_memory(name: str, axis: str, state: str, *, state_unit: str | None = None,
                 time_constant: float = 2.0, scale: float | None = None,
                 value: float = 0.0) -> table.Derived:
    r"""First-order memory :math:`E\,(w - \mu)`, :math:`\dot\mu = (w - \mu)/\tau`.

    The simplest approximation of the convolution with a retardation function:
    nothing in steady motion, damping in quick motion. ``time_constant`` is
    known; free the parameter ``tau_name`` to estimate it.

    Examples
    --------
    >>> fluid_memory("fluid_memory", "Z", "w").terms
    {'Z': 'E_fluid_memory*(w - mu_fluid_memory)'}
    """
    return {"state_unit": state_unit or ("m/s" if axis in "XYZ" else "rad/s")}


# -- current, wind and waves ------------------------------------------------------------


@table.row(Environment)
def current_forward(name: str = "current_horizontal", *, flow: tuple[str, str] = ("u_r", "w_r"),
                    angle: str = "theta", scale: float = 0.15, value: float = 0.0) -> None:
    """Horizontal water velocity along the track, diving plane."""


@table.row(Environment)
def current_down(name: str = "current_vertical", *, flow: tuple[str, str] = ("u_r", "w_r"),
                 angle: str = "theta", scale: float = 0.05, value: float = 0.0) -> None:
    """Vertical water velocity, diving plane, positive down."""


@table.row(Environment)
def current_horizontal_plane(name: str = "current", *, flow: tuple[str, str] = ("u_r", "v_r"),
                             heading: str = "psi", scale: float = 0.3, north: float = 0.0,
                             east: float = 0.0) -> None:
    """Steady current towards north and east, for a vehicle that turns."""


@table.row(Force)
def wave_force(name: str, axis: str, unit: str = "N", *, frequency: float = 1.0,
               spread: float = 0.4, scale: float = 1.0, per_record: bool = False) -> None:
    r"""Regular wave, :math:`E_c\cos\omega t + E_s\sin\omega t`, of unknown frequency.

    The frequency of encounter may differ from ``frequency`` by the fraction
    ``spread``; ``per_record`` frees amplitude and phase in every record.
    """


@table.row(Force)
def steady_wind(name: str = "wind", *, axes: tuple[str, ...] = ("X", "Y", "N"),
                heading: str = "psi", force: float = 1.0, arm: float = 1.0,
                span: float = 10.0) -> table.Derived:
    r"""Steady wind on a vehicle whose own speed is small against it, without coefficient tables.

    .. math:: X = E_n\cos\psi + E_e\sin\psi, \quad Y = s\,(E_e\cos\psi - E_n\sin\psi), \quad
              N = l\,Y

    Two amplitudes are the force towards north and east on the bow; the side, which is larger on
    most hulls, takes :math:`s` times as much, and its lever :math:`l` is a length that is zero when
    the wind pushes at the origin. A first candidate, to be replaced by :func:`wind_load`.

    Parameters
    ----------
    name : str
        Name of the effect.
    axes : tuple of str
        Which of ``X Y N`` the model has.
    heading : str
        State or signal of the heading.
    force, arm : float
        Typical force in N and lever in m.
    span : float
        Factor by which the side may take more, or less, than the bow.
    """
    lever = Parameter(f"arm_{name}", 0.0, "m", -3 * arm, 3 * arm, scale=arm, description="lever")
    ratio = Parameter(f"side_{name}", 1.0, "1", 1.0 / span, span, log=True,
                      description="side over bow")
    side = "({E_east}*cos({heading}) - {E_north}*sin({heading}))"
    side = f"{{ratio}}*{side}" if {"X", "Y"} <= {*axes} else side
    along = "{E_north}*cos({heading}) + {E_east}*sin({heading})"
    terms = {"X": along, "Y": side, "N": f"{{lever}}*{side}"}
    return {"scale": force, **({"lever": lever} if "N" in axes else {}),
            **({"ratio": ratio} if {"X", "Y"} <= {*axes} else {}),
            "terms": {axis: terms[axis] for axis in axes}}


@table.row(Force)
def wind_load(name: str, coefficients: Mapping[str, tuple[Sequence[float], Sequence[float]]], *,
              speed: float, direction: float, area: float, length: float, heading: str = "psi",
              scale: float = 0.3, value: float = 0.0) -> table.Derived:
    r"""Wind load from coefficient tables, :math:`E\,\frac{\rho}{2}AV^2C(\gamma)`.

    ``coefficients`` holds ``axis -> (angles [rad] in ±π, values)``, where the
    angle of attack :math:`\gamma = \operatorname{atan2}(-v_a, -u_a)` is the direction,
    in body axes, that the relative wind blows to: 0 from astern, π/2 from port.
    ``direction`` (from north, clockwise) is where the true wind blows to. Moments are
    multiplied by ``length``. ``E`` is 1 where the tables hold and 0 without any wind load.
    """
    load = "{E}*{density}/2*{area}*(air_u**2 + air_v**2)"
    lever = {axis: "*{length}" if axis in "KMN" else "" for axis in coefficients}
    terms = {axis: f"{load}*{name}_{axis}(attack){lever[axis]}" for axis in coefficients}
    tables = {f"{name}_{axis}": (np.asarray(x, float), np.asarray(y, float))
              for axis, (x, y) in coefficients.items()}
    return {"terms": terms, "tables": tables}


# -- propeller and rudder ---------------------------------------------------------------


@table.row(Actuator)
def thrust_decay(name: str = "thrust_decay", signal: str = "T", *, scale: float = 0.0015,
                 value: float = 0.0) -> None:
    """Thrust that falls with time, ``T (1 - E t)``, as a battery does; short records only."""


@table.row(Force)
def thrust_speed_loss(name: str = "thrust_speed_loss", *, axis: str = "X", thrust: str = "T",
                      velocity: str = "u_r", scale: float = 0.08, value: float = 0.0) -> None:
    """Thrust that falls with the advance speed: adds ``E T u_r``, with ``E`` below zero.

    Valid for moderate changes of the advance ratio about bollard pull.
    """


@table.row(Force)
def propeller_thrust(name: str = "propeller", *, axis: str = "X", revolutions: str = "n",
                     velocity: str = "u_r", bollard: float, advance: float = 0.0) -> None:
    r"""Thrust of a propeller, :math:`T_{nn}\,n|n| + T_{nu}\,|n|u_r`, for a base model.

    ``bollard`` is :math:`\rho D^4 K_{T0}` in kg m and ``advance`` the (negative)
    slope :math:`\rho D^3 K_{TJ}(1-w)` in kg, with ``n`` in 1/s.
    """


@table.row(Force)
def single_screw_asymmetry(name: str = "single_screw_asymmetry", *, thrust: str = "T",
                           arm: float = 1.0, scale: float = 0.02) -> table.Derived:
    """Side force and yaw moment of a single screw: ``Y = E_Y T`` and ``N = E_N T``.

    ``arm`` is a typical lever in m (half the length), ``scale`` that of the side force.
    """
    return {"E_Y": amplitude(f"{name}_Y", "1", scale=scale),
            "E_N": amplitude(f"{name}_N", "m", scale=scale * arm)}


def rudder_neutral_angle(name: str = "rudder_neutral_angle", signal: str = "delta", *,
                         scale: float = 0.01, value: float = 0.0) -> Actuator:
    """Rudder angle that keeps a ship straight is not zero: offset of the actual angle.

    Returns
    -------
    Actuator
        Absent where the angle is zero.

    Examples
    --------
    >>> rudder_neutral_angle().terms
    {'delta': 'delta + E_rudder_neutral_angle'}
    """
    return actuator_offset(name, signal, scale=scale, value=value)


@table.row(Force)
def rudder_stall(name: str, axis: str, *, rudder: str = "delta", velocity: str = "u_r",
                 scale: float | None = None, value: float = 0.0) -> None:
    r"""Rudder force that grows less than its angle, :math:`E\,u_r^2\delta^3`."""


@table.row(Force)
def rudder_in_slipstream(name: str, axis: str, *, thrust: str = "T", rudder: str = "delta",
                         scale: float = 0.3, value: float = 0.0) -> table.Derived:
    r"""Rudder force of the slipstream, :math:`E\,T\delta`; for a moment ``E`` holds the arm."""
    return {"unit": "m" if axis in "KMN" else "1"}


@table.row(Force)
def shallow_water(name: str = "shallow_water", *, terms: Mapping[str, str], scale: float = 0.3,
                  value: float = 0.0) -> table.Derived:
    r"""Hull forces that grow in proportion where the water is shallow, :math:`E\,\tau_{hull}`.

    ``terms`` holds the hull forces of the nominal model, for instance
    ``{"Y": "Y_uv*u_r*v_r", "N": "N_ur*u_r*r"}``. Added masses grow as well: see
    :func:`added_mass_factor`. One depth per data set.
    """
    return {"terms": {axis: f"{{E}}*({text})" for axis, text in terms.items()}}


def speed_loss_in_turn(name: str = "speed_loss_in_turn", *, scales: Mapping[str, float],
                       symbols: Mapping[str, str] = table.THROUGH_WATER) -> Force:
    """Added resistance of drift, yaw rate and rudder, quadratic and even.

    ``scales`` gives the typical size of any of ``X_vr X_vv X_rr X_deltadelta``.

    Returns
    -------
    Force
        Absent where all its amplitudes are zero.

    Examples
    --------
    >>> speed_loss_in_turn(scales={"X_vr": 10.0}).terms
    {'X': 'E_speed_loss_in_turn_X_vr*v_r*r'}
    """
    return table.derivative_group(
        name, scales, symbols=symbols, description="speed falls in a turn", source=table.ABKOWITZ,
        needs="turning circles of several rudder angles, with speed measured")


def nonlinear_yaw_damping(name: str = "nonlinear_yaw_damping", *, axis: str = "N", rate: str = "r",
                          scales: Mapping[str, float]) -> Force:
    r"""Norrbin's and Bech's steady characteristic, :math:`n_0 + n_2 r^2 + n_3 r^3`.

    The linear term belongs to the base model. ``scales`` gives typical sizes of
    ``constant``, ``quadratic`` and ``cubic``; those left out are zero.

    Returns
    -------
    Force
        Absent where all its amplitudes are zero.

    Examples
    --------
    >>> nonlinear_yaw_damping(scales={"quadratic": 0.1}).terms
    {'N': 'E_nonlinear_yaw_damping_N_rr*r**2'}
    """
    factors = {"constant": "0", "quadratic": rate * 2, "cubic": rate * 3}
    return table.derivative_group(
        name, {f"{axis}_{factors[kind]}": scale for kind, scale in scales.items()}, symbols={},
        description="turning rate is no linear function of the rudder angle",
        source=table.SOURCES["NORRBIN"],
        needs="a spiral test, or turns with small and large rudder angles to both sides")


# -- motors, joints and linkages --------------------------------------------------------


@table.row(Force)
def coulomb_friction(name: str, axis: str, velocity: str, *, unit: str = "N",
                     velocity_unit: str = "m/s", smooth: float = 0.01, span: float = 1.0,
                     scale: float = 1.0, value: float = 0.0) -> None:
    r"""Dry friction, :math:`-E\tanh(v/v_0)`; ``smooth`` is :math:`v_0`.

    With a ``span`` above one :math:`v_0` is estimated, between ``smooth`` divided by it and times
    it: nobody knows how fast a friction sets in.

    >>> coulomb_friction("dry", "X", "v").terms
    {'X': '-E_dry*tanh(v/v0_dry)'}
    """


@table.row(Force)
def stribeck_friction(name: str, axis: str, velocity: str, *, unit: str = "N",
                      velocity_unit: str = "m/s", smooth: float = 0.01, stribeck: float = 0.1,
                      scale: float = 1.0, value: float = 0.0) -> None:
    r"""Extra friction near rest, :math:`-E e^{-(v/v_s)^2}\tanh(v/v_0)`.

    Added to :func:`coulomb_friction` it makes breakaway larger than sliding friction
    by ``E``; ``stribeck`` is :math:`v_s`, known unless its parameter is freed.
    """


@table.row(Force)
def cogging(name: str, axis: str, angle: str, *, periods: int, unit: str = "N m",
            scale: float = 0.1) -> None:
    r"""Cogging torque, :math:`E_c\cos n\vartheta + E_s\sin n\vartheta`, ``periods`` per turn."""


@table.row(Force)
def dead_zone(name: str, axis: str, position: str, *, stiffness: float, unit: str = "m",
              stiffness_unit: str = "N/m", scale: float = 0.01,
              value: float = 0.0) -> None:
    r"""Dead zone of a spring: of a force :math:`-k x` the part within :math:`\pm E` is lost.

    The base model holds :math:`-k x` already; this adds :math:`k\,\mathrm{clip}(x, -E, E)`.
    """


@table.row(Force)
def end_stop(name: str, axis: str, position: str, *, reach: float, unit: str = "N/m",
             position_unit: str = "m", scale: float = 1.0, value: float = 0.0) -> None:
    r"""Stop at an unknown position, :math:`-E\,\operatorname{sgn}(x)\max(|x| - x_s, 0)`.

    ``reach`` is the largest position seen: the stop is sought between a third of it and all.
    """


@table.row(Force)
def hidden_lag(name: str, axis: str, signal: str, *, unit: str, signal_unit: str = "1",
               start: str = "0", time_constant: float = 1.0, span: float = 10.0,
               scale: float = 1.0, value: float = 0.0) -> None:
    r"""Force of a hidden state of first order, :math:`E z`, :math:`\tau \dot z = s - z`.

    What a tank, a filter or slow flow does; its pole is estimated, between ``time_constant``
    divided by ``span`` and times it. ``start`` is the state before the record, an expression of
    states.

    >>> hidden_lag("tank", "K", "p", unit="N m s/rad").terms
    {'K': 'E_tank*z_tank'}
    """


@table.row(Force)
def hidden_oscillator(name: str, axis: str, signal: str, *, unit: str, signal_unit: str = "1",
                      frequency: float = 1.0, span: float = 5.0, damping: float = 0.2,
                      scale: float = 1.0, value: float = 0.0) -> None:
    r"""Force of a hidden state of second order, :math:`E z`.

    .. math:: \ddot z = \omega^2 (s - z) - 2 \zeta \omega \dot z

    What an anti-roll tank, sloshing or a flexible mast does; frequency and damping are estimated.
    """


@table.row(Force)
def dahl_friction(name: str, axis: str, velocity: str, *, stiffness: float, unit: str = "N",
                  displacement_unit: str = "m", scale: float = 1.0,
                  value: float = 0.0) -> None:
    r"""Dry friction with memory (hysteresis), :math:`-E z`, :math:`\dot z = \sigma(v - |v| z)`.

    Presliding is elastic with stiffness :math:`E\sigma`; ``stiffness`` is :math:`\sigma`,
    the inverse of the displacement over which friction builds up.
    """


@table.row(Force)
def bouc_wen_hysteresis(name: str, axis: str, velocity: str, *, yielding: float, unit: str = "N",
                        displacement_unit: str = "m", scale: float = 1.0,
                        value: float = 0.0) -> None:
    r"""Hysteretic restoring force of memory, :math:`-E z` with Bouc and Wen's rule.

    .. math:: \dot z = \bigl(v - \tfrac12(|v| |z| z + v z^2)\bigr)/x_y

    the case of equal shape constants and exponent two; ``yielding`` is :math:`x_y`, the
    displacement at which it yields, known unless its parameter is freed.
    """


@table.row(Force)
def delayed_force(name: str, axis: str, signal: str, *, unit: str, start: str, delay: float = 1.0,
                  scale: float = 1.0, value: float = 0.0) -> None:
    r"""Force of what a state or signal was a while ago, :math:`E\,x(t - \tau)`.

    The delay is Padé's approximation of order 2,
    :math:`(1 - \tau s/2 + \tau^2 s^2/12)/(1 + \tau s/2 + \tau^2 s^2/12)`: exact in steady
    motion, within 1 % up to :math:`\omega\tau = 1.3`. ``start`` is its value before the
    record, an expression of the model's own states; ``unit`` is that of ``E``.
    """


# fmt: on
def _downward(load: str, axes: Sequence[str], angle: str | None) -> dict[str, str]:
    """A force straight down in body axes of the diving plane; Fossen (2021), equation 4.6."""
    if angle is None:
        axes = [axis for axis in axes if axis != "X"]
    both = {"X": f"-{load}*sin({angle})", "Z": f"{load}*cos({angle})" if angle else load}
    errors.located(errors.ModelError, "The diving plane has no axis", axes, both)
    return {axis: both[axis] for axis in axes}
