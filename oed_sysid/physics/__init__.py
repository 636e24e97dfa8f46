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
from oed_sysid.physics.forces import *  # noqa: F403 -- one constructor for each row
from oed_sysid.physics.signals import *  # noqa: F403 -- one constructor for each row
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
