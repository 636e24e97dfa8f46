"""Ready-made candidate effects for the usual kinds of vehicle.

What a diagnosis tries when the user names nothing else. Each has one amplitude
(two where a direction or a phase is unknown), called ``"E_" + identifier``.
"""

from __future__ import annotations

from oed_sysid.effects import actuators as act
from oed_sysid.effects import drag, environment, memory, propulsion, restoring
from oed_sysid.effects import inertia as mass_matrix
from oed_sysid.effects import sensors as sense
from oed_sysid.effects import steering as steer
from oed_sysid.effects.base import Effect
from oed_sysid.effects.derivatives import coupling
from oed_sysid.language import notation

SEA_WATER_DENSITY = 1025.0  # kg/m3, at 15 degrees Celsius and 3.5 per cent salinity


def diving_plane_effects(*, step: float = 0.1) -> tuple[Effect, ...]:
    """Candidate effects of a small AUV in the diving plane.

    The model has states ``u w q theta z``, flow signals ``u_r w_r``, actuator
    signals ``ds T``, axes ``X Z M`` and outputs named as the states. Scales suit
    a vehicle of about 30 kg and 1.5 m at 1.5 m/s.

    Parameters
    ----------
    step : float
        Shortest integration step in s, which sizes the register of the delay.

    Examples
    --------
    >>> effects = diving_plane_effects()
    >>> len(effects), effects[0].name, effects[0].amplitude_names
    (40, 'heave_crossflow_drag', ('E_heave_crossflow_drag',))
    """
    return (
        drag.quadratic_drag("heave_crossflow_drag", "Z", "w_r", scale=100.0),
        drag.quadratic_drag("heave_quadratic_pitch_damping", "Z", "q", scale=30.0),
        drag.quadratic_drag("pitch_crossflow_moment", "M", "w_r", scale=40.0),
        drag.quadratic_drag("pitch_quadratic_damping", "M", "q", scale=40.0),
        drag.induced_drag("surge_induced_drag", "w_r", scale=60.0),
        drag.deflection_drag("surge_fin_drag", "ds", scale=8.0),
        drag.linear_damping("surge_linear_drag", "X", "u_r", scale=1.0),
        restoring.excess_buoyancy(scale=2.0),
        restoring.cg_offset(scale=0.5),
        drag.hull_asymmetry("hull_asymmetry_heave", "Z", scale=0.6),
        drag.hull_asymmetry("hull_asymmetry_pitch", "M", scale=0.2),
        mass_matrix.added_mass_error("heave_added_mass_error", "Z", "w", scale=8.0, bound=40.0),
        mass_matrix.added_mass_error("surge_added_mass_error", "X", "u", scale=6.0, bound=20.0),
        mass_matrix.added_mass_error("pitch_added_inertia_error", "M", "q", scale=1.5, bound=6.0),
        environment.current_forward(scale=0.15),
        environment.current_down(scale=0.05),
        propulsion.thrust_decay(scale=0.0015),
        propulsion.thrust_speed_loss(scale=0.08),
        memory.fluid_memory("fluid_memory", "Z", "w", time_constant=2.0, scale=15.0),
        restoring.hull_compressibility(reference=10.0, scale=0.15),
        environment.wave_force("wave_heave_force", "Z", frequency=1.0, scale=1.0),
        act.actuator_offset("fin_offset", "ds", scale=0.02),
        act.stall("fin_stall", "ds", scale=2.0),
        act.actuator_lag("fin_lag", "ds", scale=0.25),
        act.actuator_delay("fin_delay", "ds", max_delay=0.8, step=step, scale=0.2),
        act.rate_limit("fin_rate_limit", "ds", scale=3.0),
        act.deadband("fin_deadband", "ds", scale=0.03),
        act.backlash("fin_backlash", "ds", scale=0.03),
        sense.sensor_bias("bias_u", "u", "m/s", scale=0.05),
        sense.sensor_bias("bias_w", "w", "m/s", scale=0.03),
        sense.sensor_bias("bias_q", "q", "rad/s", scale=0.01),
        sense.sensor_bias("bias_theta", "theta", "rad", scale=0.02),
        sense.sensor_scale("scale_u", "u", scale=0.04),
        sense.sensor_scale("scale_w", "w", scale=0.1),
        sense.sensor_scale("scale_q", "q", scale=0.05),
        sense.sensor_scale("scale_z", "z", scale=0.02),
        sense.sensor_misalignment("dvl_misalignment", "u", "w", scale=0.02),
        sense.sensor_lever_arm("dvl_lever_arm", "w", "q", scale=0.3),
        sense.sensor_lag("depth_lag", "z", scale=0.4),
        sense.sensor_lag("dvl_lag", ("u", "w"), scale=0.3),
    )


def surface_ship_effects(
    *,
    length: float = 160.93,
    speed: float = 7.72,
    density: float = SEA_WATER_DENSITY,
    thrust: str = "T",
) -> tuple[Effect, ...]:
    """Candidate effects of a surface ship in surge, sway and yaw.

    The model has states ``u v r psi x y``, flow signals ``u_r v_r``, actuator
    signals ``delta`` and ``thrust``, axes ``X Y N`` and outputs named as the
    states. Scales are typical prime-system values times size and speed; the
    defaults are those of the Mariner class at 15 knots.

    Parameters
    ----------
    length : float
        Length in m.
    speed : float
        Service speed in m/s.
    density : float
        Density of the water in kg/m3.
    thrust : str
        Actuator signal of the thrust.
    """

    def prime(coefficient: str, value: float) -> float:
        scale = notation.prime_scale(coefficient, density=density, length=length, speed=speed)
        return value * scale

    yaw_rate = 0.3 * speed / length  # of a moderate turn
    turning = {"X_vr": 3e-3, "X_vv": 3e-3, "X_rr": 3e-4, "X_deltadelta": 5e-4}
    swirl = {"constant": ("N_0", 2e-5), "quadratic": ("N_rr", 2e-4), "cubic": ("N_rrr", 1e-3)}
    mass, spin = prime("Y_vdot", 3e-3), prime("N_rdot", 1e-4)
    return (
        drag.quadratic_drag("yaw_crossflow", "N", "r", scale=prime("N_absrr", 5e-4)),
        drag.quadratic_drag("sway_crossflow", "Y", "v_r", scale=prime("Y_absvv", 2e-2)),
        drag.crossed_drag("sway_drift_yaw", "Y", "v_r", "r", scale=prime("Y_absvr", 5e-3)),
        drag.crossed_drag("sway_yaw_drift", "Y", "r", "v_r", scale=prime("Y_absrv", 5e-3)),
        drag.crossed_drag("yaw_drift_yaw", "N", "v_r", "r", scale=prime("N_absvr", 2e-3)),
        drag.crossed_drag("yaw_yaw_drift", "N", "r", "v_r", scale=prime("N_absrv", 2e-3)),
        steer.nonlinear_yaw_damping(scales={k: prime(*v) for k, v in swirl.items()}),
        steer.speed_loss_in_turn(scales={k: prime(k, v) for k, v in turning.items()}),
        coupling("sway_yaw_coupling", "Y", "r", scale=prime("Y_ur", 1e-3)),
        coupling("yaw_sway_coupling", "N", "v_r", scale=prime("N_uv", 5e-4)),
        drag.linear_damping("surge_linear_drag", "X", "u_r", scale=prime("X_u", 2e-4)),
        drag.deflection_drag("surge_rudder_drag", "delta", scale=prime("X_uudeltadelta", 1e-3)),
        steer.rudder_stall("sway_rudder_stall", "Y", scale=prime("Y_uudeltadeltadelta", 2e-3)),
        steer.rudder_stall("yaw_rudder_stall", "N", scale=prime("N_uudeltadeltadelta", 1e-3)),
        steer.rudder_in_slipstream("yaw_slipstream", "N", thrust=thrust, scale=0.15 * length),
        steer.rudder_neutral_angle(),
        propulsion.single_screw_asymmetry(thrust=thrust, arm=0.5 * length),
        propulsion.thrust_speed_loss(thrust=thrust, scale=0.3 / speed),
        mass_matrix.added_mass_error(
            "surge_added_mass_error", "X", "u", scale=mass / 3, bound=mass
        ),
        mass_matrix.added_mass_error("sway_added_mass_error", "Y", "v", scale=mass, bound=2 * mass),
        mass_matrix.added_mass_error(
            "yaw_added_inertia_error", "N", "r", scale=spin, bound=3 * spin
        ),
        environment.current_horizontal_plane(scale=0.05 * speed),
        environment.steady_wind(force=prime("X_absuu", 1e-4) * speed**2, arm=0.1 * length),
        environment.wave_force(
            "wave_yaw_moment", "N", "N m", frequency=0.6, scale=prime("N_rr", 1e-4) * yaw_rate**2
        ),
        act.actuator_lag("rudder_lag", "delta", scale=2.0),
        act.rate_limit("rudder_rate_limit", "delta", scale=20.0),
        act.deadband("rudder_deadband", "delta", scale=0.01),
        act.backlash("rudder_backlash", "delta", scale=0.01),
        sense.sensor_bias("bias_r", "r", "rad/s", scale=0.1 * yaw_rate),
        sense.sensor_bias("bias_psi", "psi", "rad", scale=0.02),
        sense.sensor_bias("bias_u", "u", "m/s", scale=0.02 * speed),
        sense.sensor_scale("scale_u", "u", scale=0.03),
        sense.sensor_scale("scale_r", "r", scale=0.05),
        sense.sensor_misalignment("log_misalignment", "u", "v", scale=0.02),
        sense.sensor_lever_arm("log_lever_arm", "v", "r", scale=0.2 * length),
        sense.sensor_lag("heading_lag", "psi", scale=1.0),
    )


def roll_effects(*, inertia: float, frequency: float) -> tuple[Effect, ...]:
    """Candidate effects of a rolling ship or a roll-decay test.

    The model has states ``phi p``, axis ``K`` and outputs named as the states.

    Parameters
    ----------
    inertia : float
        Roll inertia with added inertia, in kg m2.
    frequency : float
        Natural frequency in rad/s.
    """
    stiffness = inertia * frequency**2
    return (
        drag.linear_damping("roll_linear_damping", "K", "p", scale=0.05 * inertia * frequency),
        drag.quadratic_drag("roll_quadratic_damping", "K", "p", scale=0.1 * inertia),
        drag.cubic_damping("roll_cubic_damping", "K", "p", scale=0.3 * inertia / frequency),
        restoring.cubic_restoring("roll_cubic_restoring", scale=0.3 * stiffness),
        restoring.heel_moment("heel_moment", scale=0.02 * stiffness),
        mass_matrix.added_mass_error(
            "roll_added_inertia_error", "K", "p", scale=0.05 * inertia, bound=0.5 * inertia
        ),
        environment.wave_force(
            "wave_roll_moment", "K", "N m", frequency=frequency, scale=0.02 * stiffness
        ),
        sense.sensor_bias("bias_phi", "phi", "rad", scale=0.01),
        sense.sensor_scale("scale_phi", "phi", scale=0.05),
        sense.sensor_lag("phi_lag", "phi", scale=0.05 / frequency),
    )
