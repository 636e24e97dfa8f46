"""Ready-made candidate effects for the usual kinds of vehicle.

What a diagnosis tries when the user names nothing else. Each has one amplitude
(two where a direction or a phase is unknown), called ``"E_" + identifier``.
"""

from __future__ import annotations

from oed_sysid.physics import forces, signals
from oed_sysid.physics.base import Effect, Force
from oed_sysid.text import notation

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
        forces.quadratic_drag("heave_crossflow_drag", "Z", "w_r", scale=100.0),
        forces.quadratic_drag("heave_quadratic_pitch_damping", "Z", "q", scale=30.0),
        forces.quadratic_drag("pitch_crossflow_moment", "M", "w_r", scale=40.0),
        forces.quadratic_drag("pitch_quadratic_damping", "M", "q", scale=40.0),
        forces.induced_drag("surge_induced_drag", "w_r", scale=60.0),
        forces.deflection_drag("surge_fin_drag", "ds", scale=8.0),
        forces.linear_damping("surge_linear_drag", "X", "u_r", scale=1.0),
        forces.excess_buoyancy(scale=2.0),
        forces.cg_offset(scale=0.5),
        forces.hull_asymmetry("hull_asymmetry_heave", "Z", scale=0.6),
        forces.hull_asymmetry("hull_asymmetry_pitch", "M", scale=0.2),
        forces.added_mass_error("heave_added_mass_error", "Z", "w", scale=8.0, bound=40.0),
        forces.added_mass_error("surge_added_mass_error", "X", "u", scale=6.0, bound=20.0),
        forces.added_mass_error("pitch_added_inertia_error", "M", "q", scale=1.5, bound=6.0),
        forces.current_forward(scale=0.15),
        forces.current_down(scale=0.05),
        forces.thrust_decay(scale=0.0015),
        forces.thrust_speed_loss(scale=0.08),
        forces.fluid_memory("fluid_memory", "Z", "w", time_constant=2.0, scale=15.0),
        forces.hull_compressibility(reference=10.0, scale=0.15),
        forces.wave_force("wave_heave_force", "Z", frequency=1.0, scale=1.0),
        signals.actuator_offset("fin_offset", "ds", scale=0.02),
        signals.stall("fin_stall", "ds", scale=2.0),
        signals.actuator_lag("fin_lag", "ds", scale=0.25),
        signals.actuator_delay("fin_delay", "ds", max_delay=0.8, step=step, scale=0.2),
        signals.rate_limit("fin_rate_limit", "ds", scale=3.0),
        signals.deadband("fin_deadband", "ds", scale=0.03),
        signals.backlash("fin_backlash", "ds", scale=0.03),
        signals.sensor_bias("bias_u", "u", "m/s", scale=0.05),
        signals.sensor_bias("bias_w", "w", "m/s", scale=0.03),
        signals.sensor_bias("bias_q", "q", "rad/s", scale=0.01),
        signals.sensor_bias("bias_theta", "theta", "rad", scale=0.02),
        signals.sensor_scale("scale_u", "u", scale=0.04),
        signals.sensor_scale("scale_w", "w", scale=0.1),
        signals.sensor_scale("scale_q", "q", scale=0.05),
        signals.sensor_scale("scale_z", "z", scale=0.02),
        signals.sensor_misalignment("dvl_misalignment", "u", "w", scale=0.02),
        signals.sensor_lever_arm("dvl_lever_arm", "w", "q", scale=0.3),
        signals.sensor_lag("depth_lag", "z", scale=0.4),
        signals.sensor_lag("dvl_lag", ("u", "w"), scale=0.3),
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
        forces.quadratic_drag("yaw_crossflow", "N", "r", scale=prime("N_absrr", 5e-4)),
        forces.quadratic_drag("sway_crossflow", "Y", "v_r", scale=prime("Y_absvv", 2e-2)),
        forces.crossed_drag("sway_drift_yaw", "Y", "v_r", "r", scale=prime("Y_absvr", 5e-3)),
        forces.crossed_drag("sway_yaw_drift", "Y", "r", "v_r", scale=prime("Y_absrv", 5e-3)),
        forces.crossed_drag("yaw_drift_yaw", "N", "v_r", "r", scale=prime("N_absvr", 2e-3)),
        forces.crossed_drag("yaw_yaw_drift", "N", "r", "v_r", scale=prime("N_absrv", 2e-3)),
        forces.nonlinear_yaw_damping(scales={k: prime(*v) for k, v in swirl.items()}),
        forces.speed_loss_in_turn(scales={k: prime(k, v) for k, v in turning.items()}),
        forces.coupling("sway_yaw_coupling", "Y", "r", scale=prime("Y_ur", 1e-3)),
        forces.coupling("yaw_sway_coupling", "N", "v_r", scale=prime("N_uv", 5e-4)),
        forces.linear_damping("surge_linear_drag", "X", "u_r", scale=prime("X_u", 2e-4)),
        forces.deflection_drag("surge_rudder_drag", "delta", scale=prime("X_uudeltadelta", 1e-3)),
        forces.rudder_stall("sway_rudder_stall", "Y", scale=prime("Y_uudeltadeltadelta", 2e-3)),
        forces.rudder_stall("yaw_rudder_stall", "N", scale=prime("N_uudeltadeltadelta", 1e-3)),
        forces.rudder_in_slipstream("yaw_slipstream", "N", thrust=thrust, scale=0.15 * length),
        forces.rudder_neutral_angle(),
        forces.single_screw_asymmetry(thrust=thrust, arm=0.5 * length),
        forces.thrust_speed_loss(thrust=thrust, scale=0.3 / speed),
        forces.added_mass_error("surge_added_mass_error", "X", "u", scale=mass / 3, bound=mass),
        forces.added_mass_error("sway_added_mass_error", "Y", "v", scale=mass, bound=2 * mass),
        forces.added_mass_error("yaw_added_inertia_error", "N", "r", scale=spin, bound=3 * spin),
        forces.current_horizontal_plane(scale=0.05 * speed),
        forces.steady_wind(force=prime("X_absuu", 1e-4) * speed**2, arm=0.1 * length),
        forces.wave_force(
            "wave_yaw_moment", "N", "N m", frequency=0.6, scale=prime("N_rr", 1e-4) * yaw_rate**2
        ),
        signals.actuator_lag("rudder_lag", "delta", scale=2.0),
        signals.rate_limit("rudder_rate_limit", "delta", scale=20.0),
        signals.deadband("rudder_deadband", "delta", scale=0.01),
        signals.backlash("rudder_backlash", "delta", scale=0.01),
        signals.sensor_bias("bias_r", "r", "rad/s", scale=0.1 * yaw_rate),
        signals.sensor_bias("bias_psi", "psi", "rad", scale=0.02),
        signals.sensor_bias("bias_u", "u", "m/s", scale=0.02 * speed),
        signals.sensor_scale("scale_u", "u", scale=0.03),
        signals.sensor_scale("scale_r", "r", scale=0.05),
        signals.sensor_misalignment("log_misalignment", "u", "v", scale=0.02),
        signals.sensor_lever_arm("log_lever_arm", "v", "r", scale=0.2 * length),
        signals.sensor_lag("heading_lag", "psi", scale=1.0),
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
        forces.linear_damping("roll_linear_damping", "K", "p", scale=0.05 * inertia * frequency),
        forces.quadratic_drag("roll_quadratic_damping", "K", "p", scale=0.1 * inertia),
        forces.cubic_damping("roll_cubic_damping", "K", "p", scale=0.3 * inertia / frequency),
        forces.cubic_restoring("roll_cubic_restoring", scale=0.3 * stiffness),
        forces.heel_moment("heel_moment", scale=0.02 * stiffness),
        forces.added_mass_error(
            "roll_added_inertia_error", "K", "p", scale=0.05 * inertia, bound=0.5 * inertia
        ),
        forces.wave_force(
            "wave_roll_moment", "K", "N m", frequency=frequency, scale=0.02 * stiffness
        ),
        signals.sensor_bias("bias_phi", "phi", "rad", scale=0.01),
        signals.sensor_scale("scale_phi", "phi", scale=0.05),
        signals.sensor_lag("phi_lag", "phi", scale=0.05 / frequency),
    )


def mechanical_effects(
    axis: str = "K",
    position: str = "phi",
    velocity: str = "p",
    *,
    force: float,
    rotates: bool = True,
    speed: float = 1.0,
    stiffness: float | None = None,
    periods: int = 6,
) -> tuple[Force, ...]:
    """Candidate effects of a motor, joint or pendulum.

    Parameters
    ----------
    axis, position, velocity : str
        Names in the model.
    force : float
        Typical torque in N m (force in N where it does not rotate).
    rotates : bool
        Whether the position is an angle.
    speed : float
        Typical velocity in rad/s (m/s).
    stiffness : float, optional
        Of a spring that the model holds; only then a dead zone is among the candidates.
    periods : int
        Cogging periods per turn.
    """
    load, turn = ("N m", "rad/s") if rotates else ("N", "m/s")
    way = "rad" if rotates else "m"
    motion, dry, slow = (axis, velocity), 0.1 * force, 0.02 * speed
    found = [
        forces.linear_damping("viscous_friction", *motion, scale=0.2 * force / speed),
        forces.coulomb_friction(
            "coulomb_friction", *motion, unit=load, velocity_unit=turn, smooth=slow, scale=dry
        ),
        forces.stribeck_friction(
            "stribeck_friction", *motion, unit=load, velocity_unit=turn, smooth=slow,
            stribeck=0.1 * speed, scale=dry,
        ),
        forces.dahl_friction(
            "dahl_friction", *motion, unit=load, displacement_unit=way, stiffness=50.0, scale=dry
        ),
    ]  # fmt: skip
    if rotates:
        found.append(forces.cogging("cogging", axis, position, periods=periods, scale=dry))
    if stiffness is not None:
        found.append(
            forces.dead_zone(
                "dead_zone", axis, position, stiffness=stiffness, unit=way,
                stiffness_unit=f"{load}/{way}", scale=dry / stiffness,
            )
        )  # fmt: skip
    return tuple(found)
