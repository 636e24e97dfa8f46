r"""The vehicles of the benchmark: equations of motion in plain NumPy.

Diving plane of a REMUS-like AUV (:func:`benchmarks.truth.rates`).

Yaw of a ship per unit of inertia, with a rudder zero of each record:

.. math:: \dot\psi = r, \qquad
    \dot r = N_r r + N_{|r|r} |r| r + N_\delta (\delta + \delta_0) + w_N

A ship of 160 m in four degrees of freedom and a sailing drone of 2 m, per unit of inertia
(:func:`ship_rate`, :func:`drone_rate`); the drone's satellite receiver is ten times slower than
its gyro.

The disturbance forces :math:`w` are first-order Gauss-Markov processes of standard
deviation :math:`\sigma` and time :math:`\tau`, or a swell of a JONSWAP spectrum.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.tables import tables
from benchmarks.truth import MASSES, NAMES, rates

DATA = tables(__file__)
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
    local : dict
        Standard deviation of the parameters that differ from record to record.
    cruise : float
        First state at the beginning.
    every : tuple of int
        Samples between two measurements of each output; one where it is left out.
    """

    name: str
    believed: dict[str, float]
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
    local: dict[str, float] = field(default_factory=dict)
    cruise: float = 0.0
    every: tuple[int, ...] = ()


def remus_rate(
    state: np.ndarray, inputs: np.ndarray, force: np.ndarray, values: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Derivatives of ``u w q theta z``; inputs are fin angle and thrust."""
    derivatives = [values[name] for name in NAMES]
    return np.stack(rates(state, inputs, derivatives, np.sin, np.cos, force))


def yaw_rate(
    state: np.ndarray, inputs: np.ndarray, force: np.ndarray, values: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Derivatives of ``psi r``; the input is the rudder angle."""
    _, r = state
    turn = values["N_r"] * r + values["N_absrr"] * abs(r) * r
    return np.stack([r, turn + values["N_delta"] * (inputs[0] + values["rudder_zero"]) + force[0]])


def _hull(
    state: np.ndarray, rudder: np.ndarray, force: np.ndarray, values: Mapping[str, np.ndarray]
) -> list[np.ndarray]:
    """Accelerations in sway and yaw of both surface vessels."""
    u, v, r = state[:3]
    return [
        values[f"{axis}_uv"] * u * v + values[f"{axis}_ur"] * u * r
        + values[f"{axis}_d"] * u * u * rudder + push
        for axis, push in zip("YN", force[1:3], strict=True)
    ]  # fmt: skip


def ship_rate(
    state: np.ndarray, inputs: np.ndarray, force: np.ndarray, values: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Derivatives of ``u v r p phi psi``; the input is the rudder angle."""
    u, v, r, p, phi, _ = state
    surge = values["X_uu"] * u * abs(u) + SHIP_THRUST + v * r + force[0]
    roll = values["K_phi"] * phi + values["K_p"] * p + values["K_ur"] * u * r
    roll = roll + values["K_d"] * (u * u * inputs[0]) + force[3]
    return np.stack([surge, *_hull(state, inputs[0], force, values), roll, p, r])


def drone_rate(
    state: np.ndarray, inputs: np.ndarray, force: np.ndarray, values: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Derivatives of ``u v r psi``; the input is the rudder angle."""
    u, v, r, _ = state
    surge = values["X_uu"] * u * abs(u) + DRONE_THRUST + 1.5 * v * r + force[0]
    return np.stack([surge, *_hull(state, inputs[0], force, values), r])


# Accelerations of both by their propellers, m/s^2.
SHIP_THRUST, DRONE_THRUST = 0.015, 0.4


def _frozen(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of data, its lists as tuples."""
    return {k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}


RATES = {"remus": remus_rate, "yaw": yaw_rate, "ship": ship_rate, "drone": drone_rate}
VEHICLES = {n: Vehicle(n, rate=RATES[n], **_frozen(row)) for n, row in DATA["vehicles"].items()}
REMUS, YAW = VEHICLES["remus"], VEHICLES["yaw"]


def pitch_pole(values: Mapping[str, float], speed: float) -> float:
    """Largest real part of the poles of heave and pitch about level trim, 1/s."""
    m, inertia, _, z_wdot, z_qdot, m_wdot, m_qdot = MASSES
    force = np.array(
        [
            [speed * values["Z_uw"], (m + values["Z_uq"]) * speed, 0.0],
            [speed * values["M_uw"], speed * values["M_uq"], -values["zgW"]],
        ]
    )
    heavy, lagging = m - z_wdot, inertia - m_qdot
    inverse = np.array([[lagging, z_qdot], [m_wdot, heavy]]) / (heavy * lagging - z_qdot * m_wdot)
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


MEDIUM = (0.1, 0.3, 0.06)  # X [N], Z [N], M [N m]


@dataclass(frozen=True)
class Manoeuvre:
    """A zigzag: fin or rudder amplitude and switching angle in degrees, thrust in N.

    It turns when the measured angle plus ``lead`` (s) times its measured rate
    passes the switching angle; or, with a finite ``hold``, every so many seconds.
    With a ``gain`` it is a helmsman instead, who steers courses of plus and minus the
    switching angle in turn: the command is the gain times how far the measured angle,
    with its lead, is from the course, up to the amplitude.
    """

    name: str
    amplitude: float
    switch: float
    thrust: float = 0.0
    duration: float | None = None
    lead: float = 0.0
    hold: float = math.inf
    gain: float = 0.0


RECORDS = {kind: tuple(Manoeuvre(**row) for row in rows) for kind, rows in DATA["records"].items()}


@dataclass(frozen=True)
class Scenario:
    """One way in which vehicle and sensors are disturbed.

    Attributes
    ----------
    name, title : str
    vehicle : str
    records : tuple of Manoeuvre
        What is fitted to.
    fresh : Manoeuvre
        What is predicted.
    force : tuple of float
        Standard deviation of each disturbance force.
    force_time : float
        Their time, s.
    swell : float
        The forces have a JONSWAP spectrum with this peak period instead, s; 0 for none.
    wind_sea : float
        Half of their power is in a second one with this peak period, s; 0 for none.
    direction : float or None
        The swell is long-crested and runs to this bearing, deg: its period is met as the vehicle
        moves and turns.
    pole : float or None
        The vehicle is made unstable in pitch with this pole, 1/s.
    level : float
        Sensor noise over the declared one.
    colour : float
        First-order autoregressive coefficient of the noise of output ``coloured``.
    coloured : int
    fin_noise : float
        White noise of the logged first input, deg.
    missing : float
        Share of samples that were not taken.
    dropped : float
        Share of rows that the log does not have: the sampling is irregular. A
        row in which the command changes is always there.
    hidden : bool
        The fitted model does not know the parameters that differ from record to record.
    """

    name: str
    title: str
    vehicle: str = "remus"
    records: tuple[Manoeuvre, ...] = RECORDS["zigzags"]
    fresh: Manoeuvre = RECORDS["fresh"][0]
    force: tuple[float, ...] = (0.0, 0.0, 0.0)
    force_time: float = 2.0
    swell: float = 0.0
    wind_sea: float = 0.0
    direction: float | None = None
    pole: float | None = None
    level: float = 1.0
    colour: float = 0.0
    coloured: int = 3
    fin_noise: float = 0.0
    missing: float = 0.0
    dropped: float = 0.0
    hidden: bool = False


def _scenarios() -> dict[str, Scenario]:
    """Scenarios by name."""
    found: dict[str, Scenario] = {}
    for name, row in DATA["scenarios"].items():
        said = _frozen(row)
        base = found.get(said.pop("like", ""), Scenario(name, ""))
        if "medium" in said:
            factor = said.pop("medium")
            said["force"] = tuple(factor * level for level in MEDIUM)
        if "records" in said:
            said["records"] = RECORDS[said["records"]]
        if "fresh" in said:
            (said["fresh"],) = RECORDS[said["fresh"]]
        found[name] = replace(base, name=name, **said)
    return found


SCENARIOS = _scenarios()
