"""Physical effects: the words in which a model and its deficiencies are written.

:data:`LIBRARY` lists every effect with its stage, term, unit, source and what shows it; each has a
constructor of its name.
"""

from oed_sysid.physics.base import (
    STAGES,
    Actuator,
    Effect,
    Environment,
    ExtraState,
    Force,
    Inertia,
    Memory,
    Sensor,
    amplitude,
)
from oed_sysid.physics.candidates import (
    diving_plane_effects,
    mechanical_effects,
    roll_effects,
    surface_ship_effects,
)
from oed_sysid.physics.forces import (
    added_mass_coupling,
    added_mass_error,
    added_mass_factor,
    bouc_wen_hysteresis,
    cg_offset,
    cogging,
    coulomb_friction,
    coupling,
    crossed_drag,
    cubic_damping,
    cubic_restoring,
    current_down,
    current_forward,
    current_horizontal_plane,
    dahl_friction,
    dead_zone,
    deflection_drag,
    delayed_force,
    end_stop,
    excess_buoyancy,
    fluid_memory,
    heel_moment,
    hidden_lag,
    hidden_oscillator,
    hull_asymmetry,
    hull_compressibility,
    induced_drag,
    linear_damping,
    metacentric_moment,
    nonlinear_yaw_damping,
    propeller_thrust,
    quadratic_drag,
    righting_arm_table,
    rudder_in_slipstream,
    rudder_neutral_angle,
    rudder_stall,
    shallow_water,
    single_screw_asymmetry,
    speed_loss_in_turn,
    steady_wind,
    stribeck_friction,
    thrust_decay,
    thrust_speed_loss,
    wave_force,
    wind_load,
)
from oed_sysid.physics.signals import (
    actuator_delay,
    actuator_gain_error,
    actuator_lag,
    actuator_offset,
    actuator_start,
    backlash,
    deadband,
    maximum_rate,
    rate_limit,
    saturation,
    sensor_bias,
    sensor_delay,
    sensor_drift,
    sensor_lag,
    sensor_lever_arm,
    sensor_misalignment,
    sensor_scale,
    stall,
    unknown_limit,
)
from oed_sysid.physics.table import (
    LIBRARY,
    derivative,
    derivative_group,
    hull_derivatives,
    table_from_csv,
)
from oed_sysid.physics.unknown import (
    InputNoise,
    RandomForce,
    SensorDrift,
    UnknownForce,
    UnknownInput,
)
from oed_sysid.physics.variants import in_each_record, unknown_start
from oed_sysid.runtime.version import exported

__all__ = exported(globals())
