r"""The two vehicles of the benchmark: equations of motion in plain NumPy.

Diving plane of a REMUS-like AUV, from Prestero (2001):

.. math::

    \begin{aligned}
    (m - X_{\dot u})\,\dot u &= -m q w + X_{uu} u|u| + T + w_X \\
    (m - Z_{\dot w})\,\dot w - Z_{\dot q}\,\dot q
        &= m u q + u (Z_{uw} w + Z_{uq} q) + Z_{uuds} u^2 \delta_s + w_Z \\
    -M_{\dot w}\,\dot w + (I_{yy} - M_{\dot q})\,\dot q
        &= u (M_{uw} w + M_{uq} q) + M_{uuds} u^2 \delta_s - z_G W \sin\theta + w_M \\
    \dot\theta &= q, \qquad \dot z = -u \sin\theta + w \cos\theta
    \end{aligned}

Yaw of a ship per unit of inertia, with a rudder zero of each record:

.. math:: \dot\psi = r, \qquad
    \dot r = N_r r + N_{|r|r} |r| r + N_\delta (\delta + \delta_0) + w_N

The random forces :math:`w` are first-order Gauss-Markov processes of standard
deviation :math:`\sigma` and time :math:`\tau`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

MASS, INERTIA = 30.48, 3.45
X_UDOT, Z_WDOT, Z_QDOT, M_WDOT, M_QDOT = -0.93, -35.5, -1.93, -1.93, -4.88
SURGE, HEAVE, PITCH = MASS - X_UDOT, MASS - Z_WDOT, INERTIA - M_QDOT
DETERMINANT = HEAVE * PITCH - Z_QDOT * M_WDOT

# state, input, force: (n_..., n_runs); parameters by name: (n_runs,)
Rate = Callable[[np.ndarray, np.ndarray, np.ndarray, Mapping[str, np.ndarray]], np.ndarray]


@dataclass(frozen=True)
class Vehicle:
    """A vehicle whose outputs are its states.

    Attributes
    ----------
    name : str
        Also the name of its equations in ``filter.c``.
    believed : dict
        Parameters that all records share.
    local : dict
        Standard deviation of the parameters that differ from record to record.
    states, inputs, forces : tuple of str
    noise_std : tuple of float
        Declared standard deviation of each output.
    sample_time, substeps : float, int
        Time between samples, s; integration steps of the truth in it.
    begin, duration : float
        First command and end of a record, s.
    steered : int
        The output on whose angle a zigzag turns.
    rate_output : int
        Its rate.
    sense : float
        Sign of the command that lowers this angle.
    rate : callable
        Time derivative of the state.
    """

    name: str
    believed: dict[str, float]
    local: dict[str, float]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    forces: tuple[str, ...]
    noise_std: tuple[float, ...]
    sample_time: float
    substeps: int
    begin: float
    duration: float
    steered: int
    rate_output: int
    sense: float
    rate: Rate


def remus_rate(
    state: np.ndarray, inputs: np.ndarray, force: np.ndarray, values: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Derivatives of ``u w q theta z``; inputs are fin angle and thrust."""
    u, w, q, theta, _ = state
    fin, thrust = inputs
    x = -MASS * q * w + values["X_uu"] * u * abs(u) + thrust + force[0]
    heave = (
        MASS * u * q
        + u * (values["Z_uw"] * w + values["Z_uq"] * q + values["Z_uuds"] * u * fin)
        + force[1]
    )
    moment = (
        u * (values["M_uw"] * w + values["M_uq"] * q + values["M_uuds"] * u * fin)
        - values["zgW"] * np.sin(theta)
        + force[2]
    )
    return np.stack(
        [
            x / SURGE,
            (PITCH * heave + Z_QDOT * moment) / DETERMINANT,
            (HEAVE * moment + M_WDOT * heave) / DETERMINANT,
            q,
            -u * np.sin(theta) + w * np.cos(theta),
        ]
    )


def yaw_rate(
    state: np.ndarray, inputs: np.ndarray, force: np.ndarray, values: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Derivatives of ``psi r``; the input is the rudder angle."""
    _, r = state
    turn = values["N_r"] * r + values["N_absrr"] * abs(r) * r
    return np.stack([r, turn + values["N_delta"] * (inputs[0] + values["rudder_zero"]) + force[0]])


REMUS = Vehicle(
    name="remus",
    believed={
        "X_uu": -3.9,
        "Z_uw": -40.0,
        "Z_uq": -9.0,
        "M_uw": 14.0,
        "M_uq": -9.0,
        "Z_uuds": -12.0,
        "M_uuds": -6.15,
        "zgW": 5.9,
    },
    local={},
    states=("u", "w", "q", "theta", "z"),
    inputs=("fin_command", "thrust"),
    forces=("X", "Z", "M"),
    noise_std=(0.02, 0.02, 0.004, 0.004, 0.03),
    sample_time=0.1,
    substeps=10,
    begin=2.0,
    duration=60.0,
    steered=3,
    rate_output=2,
    sense=1.0,
    rate=remus_rate,
)

YAW = Vehicle(
    name="yaw",
    believed={"N_r": -0.125, "N_absrr": -1.0, "N_delta": 0.015},
    local={"rudder_zero": 0.03},
    states=("psi", "r"),
    inputs=("rudder",),
    forces=("N",),
    noise_std=(0.004, 0.0015),
    sample_time=0.5,
    substeps=5,
    begin=5.0,
    duration=300.0,
    steered=0,
    rate_output=1,
    sense=-1.0,
    rate=yaw_rate,
)

VEHICLES = {vehicle.name: vehicle for vehicle in (REMUS, YAW)}


def pitch_pole(values: Mapping[str, float], speed: float) -> float:
    """Largest real part of the poles of heave and pitch about level trim, 1/s."""
    force = np.array(
        [
            [speed * values["Z_uw"], (MASS + values["Z_uq"]) * speed, 0.0],
            [speed * values["M_uw"], speed * values["M_uq"], -values["zgW"]],
        ]
    )
    inverse = np.array([[PITCH, Z_QDOT], [M_WDOT, HEAVE]]) / DETERMINANT
    matrix = np.vstack([inverse @ force, [0.0, 1.0, 0.0]])
    return float(np.linalg.eigvals(matrix).real.max())


def unstable(values: Mapping[str, float], pole: float, speed: float = 1.5) -> dict[str, float]:
    """The same vehicle, its centre of gravity so high that pitch diverges at a rate, 1/s."""
    low, high = -100.0, values["zgW"]
    for _ in range(60):
        middle = 0.5 * (low + high)
        if pitch_pole({**values, "zgW": middle}, speed) > pole:
            low = middle
        else:
            high = middle
    return {**values, "zgW": 0.5 * (low + high)}
