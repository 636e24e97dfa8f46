"""Motion of a rigid body in water by matrices alone, independent of the package.

Newton and Euler about the origin with NumPy and SciPy: mass matrices from their block
form, momentum and its rate in turning axes, attitude as a rotation matrix that is
integrated itself. Nothing here knows of texts, derivatives by name or Fossen's C(nu).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

GRAVITY_AXIS = np.array([0.0, 0.0, 1.0])


def skew(a: np.ndarray) -> np.ndarray:
    """Matrix of the vector product with a."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0.0]])


def rotation(phi: float, theta: float, psi: float) -> np.ndarray:
    """Rotation from body axes to NED: yaw, then pitch, then roll."""
    return Rotation.from_euler("ZYX", [psi, theta, phi]).as_matrix()


@dataclass
class FreeBody:
    """A body: mass, centres, inertia about the origin, added inertia, weight, buoyancy."""

    mass: float
    inertia: np.ndarray
    centre: np.ndarray
    added: np.ndarray
    weight: float = 0.0
    buoyancy: float = 0.0
    lift_centre: np.ndarray = field(default_factory=lambda: np.zeros(3))
    current: np.ndarray = field(default_factory=lambda: np.zeros(3))
    force: Callable[[float, np.ndarray, np.ndarray], np.ndarray] | None = None

    @property
    def rigid(self) -> np.ndarray:
        """Rigid-body inertia (6, 6)."""
        arm = self.mass * skew(self.centre)
        return np.block([[self.mass * np.eye(3), -arm], [arm, self.inertia]])

    def rates(self, time: float, state: np.ndarray) -> np.ndarray:
        """Rates of velocity (6), rotation matrix (9) and position (3)."""
        velocity, turn = state[:6], state[6:15].reshape(3, 3)
        omega = velocity[3:]
        drift = turn.T @ self.current
        flow = velocity - np.concatenate([drift, np.zeros(3)])
        # Momentum of body and water; its rate in turning axes is the force about the origin.
        body, water = self.rigid @ velocity, self.added @ flow
        linear, angular = body[:3] + water[:3], body[3:] + water[3:]
        gyroscopic = np.concatenate(
            [
                np.cross(omega, linear),
                np.cross(omega, angular)
                + np.cross(velocity[:3], body[:3])
                + np.cross(flow[:3], water[:3]),
            ]
        )
        down = turn.T @ GRAVITY_AXIS
        lever = self.weight * self.centre - self.buoyancy * self.lift_centre
        load = np.concatenate([(self.weight - self.buoyancy) * down, np.cross(lever, down)])
        if self.force is not None:
            load = load + self.force(time, velocity, flow)
        # Rate of the current seen from turning axes.
        unsteady = np.concatenate([-np.cross(omega, drift), np.zeros(3)])
        total = self.rigid + self.added
        accelerations = np.linalg.solve(total, load - gyroscopic + self.added @ unsteady)
        return np.concatenate([accelerations, (turn @ skew(omega)).ravel(), turn @ velocity[:3]])

    def run(
        self, times: np.ndarray, velocity: np.ndarray, angles: np.ndarray, place: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Velocities (n, 6), rotation matrices (n, 3, 3) and positions (n, 3)."""
        start = np.concatenate([velocity, rotation(*angles).ravel(), place])
        solution = solve_ivp(
            self.rates, times[[0, -1]], start, "DOP853", times, rtol=1e-12, atol=1e-13
        )
        states = solution.y.T
        return states[:, :6], states[:, 6:15].reshape(-1, 3, 3), states[:, 15:]

    def energy(self, velocity: np.ndarray) -> float:
        """Kinetic energy of body and water in still water."""
        return 0.5 * float(velocity @ (self.rigid + self.added) @ velocity)
