"""The motions of a body: names of degrees of freedom, words, units and typical sizes."""

from __future__ import annotations

from collections.abc import Mapping

from oed_sysid.physics.attitude import QUATERNION
from oed_sysid.physics.momentum import VELOCITIES

DEGREES: Mapping[int, str] = {3: "uvr", 4: "uvpr", 6: "uvwpqr"}
MOTIONS = dict(zip(("surge", "sway", "heave", "roll", "pitch", "yaw"), VELOCITIES, strict=True))
LABELS = {
    **{v: f"{m} velocity" for m, v in MOTIONS.items() if v in "uvw"},
    **{v: f"{m} rate" for m, v in MOTIONS.items() if v in "pqr"},
    **{"x": "north", "y": "east", "z": "depth", "phi": "roll angle", "theta": "pitch angle"},
    "psi": "heading",
}
UNITS = {
    **dict.fromkeys("uvw", "m/s"),
    **dict.fromkeys("pqr", "rad/s"),
    **dict.fromkeys("xyz", "m"),
    **dict.fromkeys(("phi", "theta", "psi"), "rad"),
    **dict.fromkeys(QUATERNION, "1"),
}
SIZES = {"v": 0.3, "w": 0.3, "p": 0.2, "q": 0.2, "r": 0.2, "x": 10.0, "y": 10.0}
SIZES |= {"phi": 0.3, "theta": 0.3, **dict.fromkeys(QUATERNION, 0.5), "de0": 0.05}
