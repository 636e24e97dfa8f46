"""Rigid bodies in water: equations of motion from numbers, three to six degrees of freedom.

Body axes x forward, y to starboard, z down about an origin of the user's choice;
positions in NED; SI and radians.

Examples
--------
>>> from oed_sysid import Input
>>> from oed_sysid.physics.bodies import rigid_body
>>> body = rigid_body(
...     6, mass=30.5, inertia=(0.18, 3.45, 3.45), centre_of_gravity=(0, 0, 0.02),
...     added_mass={"X_udot": -0.93, "Y_vdot": -35.5, "Z_wdot": -35.5}, weight=299.0,
... )
>>> auv = body.model("auv", inputs=[Input("T", "N")], effects=[body.thruster("propeller", "T")])
>>> len(auv.states), sorted(auv.axes)
(12, ['K', 'M', 'N', 'X', 'Y', 'Z'])
"""

from oed_sysid.physics.body_candidates import catamaran_effects, underwater_vehicle_effects
from oed_sysid.physics.rigid_body import RigidBody, load_cell, rigid_body
from oed_sysid.runtime.version import exported

__all__ = exported(globals())


def __getattr__(name: str) -> object:
    if name in ("fin", "thruster"):
        raise AttributeError(f"{name} is a method of a body: RigidBody.{name}.")
    raise AttributeError(f"There is no {name} in {__name__}.")
