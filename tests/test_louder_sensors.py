"""Sensors that are noisier than declared lead no search astray."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oed_sysid import Dataset, Input, Record
from oed_sysid.evidence.study import Study
from oed_sysid.physics.bodies import rigid_body

TRUE = {
    "X_u": -20.0, "X_absuu": -90.0, "Z_w": -30.0, "Z_absww": -160.0, "N_r": -8.0, "N_absrr": -30.0,
}  # fmt: skip
DECLARED = {"u": 0.02, "w": 0.02, "r": 0.005, "psi": 0.02, "z": 0.05}
ARM = 0.25  # m
BODY = rigid_body(
    ("surge", "heave", "yaw"),
    mass=120.0,
    inertia=12.0,
    added_mass={"X_udot": -40.0, "Z_wdot": -90.0, "N_rdot": -8.0},
    weight=1177.2,
    buoyancy=1179.2,
    position=("z",),
)
CRAFT = BODY.model(
    "three thrusters",
    inputs=(Input("T_port", "N"), Input("T_starboard", "N"), Input("T_down", "N")),
    effects=(
        BODY.hull(
            {
                "X_u": -25.0,
                "X_absuu": -80.0,
                "Z_w": -25.0,
                "Z_absww": -140.0,
                "N_r": -7.0,
                "N_absrr": -25.0,
            }
        ),
        BODY.thruster("port", "T_port", at=(0, -ARM, 0)),
        BODY.thruster("starboard", "T_starboard", at=(0, ARM, 0)),
        BODY.thruster("down", "T_down", direction=(0, 0, 1)),
    ),
    noise=DECLARED,
    step=0.1,
)


def runs(seed: int, louder: float) -> Dataset:
    """Records by SciPy of a craft that lacks nothing; its sensors are ``noisier`` than declared."""
    rng = np.random.default_rng(seed)
    found = []
    for index in range(3):
        times = np.arange(0.0, 90.0, 0.1)
        level, swing = np.array([25.0, 25.0, 8.0]), np.array([20.0, 20.0, 24.0])
        thrust = np.repeat(level + swing * rng.choice([-1, 0, 1], (30, 3)), 30, axis=0)

        def rates(t: float, x: np.ndarray, thrust: np.ndarray = thrust) -> list[float]:
            u, w, r, _, _ = x
            port, starboard, down = thrust[min(int(t / 0.1 + 1e-9), len(thrust) - 1)]
            surge = port + starboard + TRUE["X_u"] * u + TRUE["X_absuu"] * abs(u) * u
            heave = down - 2.0 + TRUE["Z_w"] * w + TRUE["Z_absww"] * abs(w) * w
            yaw = ARM * (port - starboard) + TRUE["N_r"] * r + TRUE["N_absrr"] * abs(r) * r
            return [surge / 160.0, heave / 210.0, yaw / 20.0, r, w]

        start = [0.3, 0.0, 0.0, 0.3, 5.0]
        run = solve_ivp(rates, (0, 89.9), start, t_eval=times, max_step=0.1, rtol=1e-6).y.T
        seen = run + louder * np.array(list(DECLARED.values())) * rng.standard_normal(run.shape)
        seen[np.arange(len(times)) % 2 > 0, :2] = np.nan  # speeds come half as often
        seen[np.arange(len(times)) % 5 > 0, 4] = np.nan
        found.append(Record(f"run {index}", times, thrust, seen, CRAFT.channels))
    return Dataset(tuple(found))


@pytest.mark.parametrize("seed", [0, 3])
def test_noise_declared_three_times_too_small_is_found(seed: int) -> None:
    """No force that follows every wiggle, no parameter that follows the force."""
    _, best = Study.begin(CRAFT, runs(seed, 3.0), None, (), known_noise=False)
    for name, value in TRUE.items():
        assert best.values[name] == pytest.approx(value, rel=0.25)
    loud = 3.0 * np.array(list(DECLARED.values()))
    np.testing.assert_allclose(best.noise.white, loud, rtol=0.1)
