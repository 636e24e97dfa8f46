r"""The vehicles of the benchmark: equations of motion in plain NumPy.

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

A ship of 160 m in four degrees of freedom and a sailing drone of 2 m, per unit of inertia
(:func:`ship_rate`, :func:`drone_rate`); the drone's satellite receiver is ten times slower than
its gyro.

The disturbance forces :math:`w` are first-order Gauss-Markov processes of standard
deviation :math:`\sigma` and time :math:`\tau`, or a swell of a JONSWAP spectrum.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

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
    cruise : float
        First state at the beginning.
    every : tuple of int
        Samples between two measurements of each output; one where it is left out.
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
    cruise: float = 0.0
    every: tuple[int, ...] = ()


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


def ship_rate(
    state: np.ndarray, inputs: np.ndarray, force: np.ndarray, values: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Derivatives of ``u v r p phi psi``; the input is the rudder angle."""
    u, v, r, p, phi, _ = state
    helm = u * u * inputs[0]
    return np.stack(
        [
            values["X_uu"] * u * abs(u) + SHIP_THRUST + v * r + force[0],
            values["Y_uv"] * u * v + values["Y_ur"] * u * r + values["Y_d"] * helm + force[1],
            values["N_uv"] * u * v + values["N_ur"] * u * r + values["N_d"] * helm + force[2],
            values["K_phi"] * phi + values["K_p"] * p + values["K_ur"] * u * r
            + values["K_d"] * helm + force[3],
            p,
            r,
        ]
    )  # fmt: skip


def drone_rate(
    state: np.ndarray, inputs: np.ndarray, force: np.ndarray, values: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Derivatives of ``u v r psi``; the input is the rudder angle."""
    u, v, r, _ = state
    helm = u * u * inputs[0]
    return np.stack(
        [
            values["X_uu"] * u * abs(u) + DRONE_THRUST + 1.5 * v * r + force[0],
            values["Y_uv"] * u * v + values["Y_ur"] * u * r + values["Y_d"] * helm + force[1],
            values["N_uv"] * u * v + values["N_ur"] * u * r + values["N_d"] * helm + force[2],
            r,
        ]
    )


# Accelerations of both by their propellers, m/s^2.
SHIP_THRUST, DRONE_THRUST = 0.015, 0.4


SHIP = Vehicle(
    name="ship",
    believed={
        "X_uu": -2.5e-4,
        "Y_uv": -6.5e-3,
        "Y_ur": -0.4,
        "Y_d": -4e-4,
        "N_uv": -1e-4,
        "N_ur": -1.05e-2,
        "N_d": 7.7e-5,
        "K_phi": -0.2,
        "K_p": -0.06,
        "K_ur": 0.13,
        "K_d": -3e-4,
    },
    local={},
    states=("u", "v", "r", "p", "phi", "psi"),
    inputs=("rudder",),
    forces=("u", "v", "r", "p"),
    noise_std=(0.02, 0.03, 5e-4, 2e-3, 3e-3, 3e-3),
    sample_time=1.0,
    substeps=10,
    begin=10.0,
    duration=300.0,
    steered=5,
    rate_output=2,
    sense=-1.0,
    rate=ship_rate,
    cruise=7.7,
)


DRONE = Vehicle(
    name="drone",
    believed={
        "X_uu": -0.1,
        "Y_uv": -0.35,
        "Y_ur": -0.4,
        "Y_d": -0.05,
        "N_uv": -0.1,
        "N_ur": -0.6,
        "N_d": 0.12,
    },
    local={},
    states=("u", "v", "r", "psi"),
    inputs=("rudder",),
    forces=("u", "v", "r"),
    noise_std=(0.05, 0.05, 5e-3, 0.01),
    sample_time=0.1,
    substeps=4,
    begin=2.0,
    duration=90.0,
    steered=3,
    rate_output=2,
    sense=-1.0,
    rate=drone_rate,
    cruise=2.0,
    every=(10, 10, 1, 2),
)


VEHICLES = {vehicle.name: vehicle for vehicle in (REMUS, YAW, SHIP, DRONE)}


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


MEDIUM = (0.1, 0.3, 0.06)  # X [N], Z [N], M [N m]


@dataclass(frozen=True)
class Manoeuvre:
    """A zigzag: fin or rudder amplitude and switching angle in degrees, thrust in N.

    It turns when the measured angle plus ``lead`` (s) times its measured rate
    passes the switching angle; or, with a finite ``hold``, every so many seconds.
    """

    name: str
    amplitude: float
    switch: float
    thrust: float = 0.0
    duration: float | None = None
    lead: float = 0.0
    hold: float = math.inf


ZIGZAGS = (
    Manoeuvre("zigzag_5_5", 5.0, 5.0, 5.0),
    Manoeuvre("zigzag_10_10", 10.0, 10.0, 9.0),
    Manoeuvre("zigzag_15_12", 15.0, 12.0, 10.0),
)


CLOCKED = tuple(
    replace(zigzag, name=f"clocked_{i}", hold=hold)
    for i, (zigzag, hold) in enumerate(zip(ZIGZAGS, (3.5, 3.4, 3.3), strict=True))
)


CALM = tuple(Manoeuvre(f"calm_{i}", 1.0, 1.0, thrust) for i, thrust in enumerate((5.0, 9.0, 10.0)))


FRESH = Manoeuvre("zigzag_12_8", 12.0, 8.0, 8.0)


# An unstable vehicle turns before its pitch angle can no longer be caught.
STEADIED = tuple(
    Manoeuvre(f"steadied_{switch:g}", 15.0, switch, thrust, lead=2.0)
    for switch, thrust in ((28.0, 7.0), (34.0, 8.5), (40.0, 10.0), (34.0, 9.0))
)


GENTLE = (Manoeuvre("gentle", 2.0, 3.0, 9.0, 30.0),)


RUDDER = (
    Manoeuvre("zigzag_10_10", 10.0, 10.0),
    Manoeuvre("zigzag_20_20", 20.0, 20.0),
    Manoeuvre("zigzag_15_30", 15.0, 30.0),
)


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
    swell : float or None
        The forces have a JONSWAP spectrum with this peak period instead, s.
    pole : float or None
        The vehicle is made unstable in pitch with this pole, 1/s.
    level : float
        Sensor noise over the declared one.
    colour : float
        First-order autoregressive coefficient of the noise of output ``coloured``.
    coloured : int
    spikes : float
        Share of samples with a spike of ``spike_size`` standard deviations.
    one_sided : bool
        All spikes go up.
    fin_noise : float
        White noise of the logged first input, deg.
    missing : float
        Share of samples that were not taken.
    dropped : float
        Share of rows that the log does not have: the sampling is irregular. A
        row in which the command changes is always there.
    hidden : bool
        The fitted model does not know the parameters that differ from record to record.
    may_flag : bool
        Wrong sensors: intervals hold, or the report says that they may not.
    """

    name: str
    title: str
    vehicle: str = "remus"
    records: tuple[Manoeuvre, ...] = ZIGZAGS
    fresh: Manoeuvre = FRESH
    force: tuple[float, ...] = (0.0, 0.0, 0.0)
    force_time: float = 2.0
    swell: float | None = None
    pole: float | None = None
    level: float = 1.0
    colour: float = 0.0
    coloured: int = 3
    spikes: float = 0.0
    spike_size: float = 10.0
    one_sided: bool = False
    fin_noise: float = 0.0
    missing: float = 0.0
    dropped: float = 0.0
    hidden: bool = False
    may_flag: bool = False


def _times(factor: float) -> tuple[float, ...]:
    return tuple(factor * level for level in MEDIUM)


_YAW = Scenario(
    "yaw_zero",
    "yaw model, a rudder zero of each record",
    vehicle="yaw",
    records=RUDDER,
    fresh=Manoeuvre("zigzag_12_15", 12.0, 15.0),
    force=(0.0,),
    force_time=10.0,
)


# Accelerations by waves: a sway of 0.08 m/s and a roll of 0.2 degrees, as much as its sensor.
_SHIP = Scenario(
    "ship_swell",
    "ship, zigzags on the measured heading, swell of 8 s",
    vehicle="ship",
    records=RUDDER,
    fresh=Manoeuvre("zigzag_12_15", 12.0, 15.0),
    force=(0.02, 0.06, 4e-4, 1.5e-3),
    swell=8.0,
)
_DRONE = Scenario(
    "drone_swell",
    "drone with slow sensors, 10 % missing, swell of 8 s",
    vehicle="drone",
    records=RUDDER,
    fresh=Manoeuvre("zigzag_12_15", 12.0, 15.0),
    force=(0.05, 0.1, 0.06),
    swell=8.0,
    missing=0.1,
)


SCENARIOS = {
    scenario.name: scenario
    for scenario in (
        Scenario("white", "white noise as declared"),
        Scenario("tiny", "random forces, 0.1 x medium", force=_times(0.1)),
        Scenario("small", "random forces, 0.3 x medium", force=_times(0.3)),
        Scenario("medium", "random forces 0.1 N, 0.3 N, 0.06 N m, 2 s", force=_times(1.0)),
        Scenario("medium_5s", "the same, 5 s", force=_times(1.0), force_time=5.0),
        Scenario(
            "medium_clock",
            "medium, fin reversed by the clock",
            records=CLOCKED,
            fresh=replace(FRESH, hold=3.4),
            force=_times(1.0),
        ),
        Scenario("large", "random forces, 3 x medium", force=_times(3.0)),
        Scenario("large_calm", "3 x medium, fin within 1 deg", force=_times(3.0), records=CALM),
        Scenario(
            "unstable",
            "medium, pitch pole +0.5 1/s",
            records=STEADIED[:3],
            fresh=STEADIED[3],
            force=_times(1.0),
            pole=0.5,
        ),
        *(
            Scenario(
                f"swell_{period:g}",
                f"medium, JONSWAP with peak at {period:g} s",
                force=_times(1.0),
                swell=period,
                may_flag=True,
            )
            for period in (3.0, 6.0, 12.0)
        ),
        Scenario("missing", "medium, half of the samples missing", force=_times(1.0), missing=0.5),
        Scenario("irregular", "medium, 60 % of the rows missing", force=_times(1.0), dropped=0.6),
        Scenario("colour_0.6", "noise of theta: AR(1), 0.6", colour=0.6, may_flag=True),
        Scenario("colour_0.8", "noise of theta: AR(1), 0.8", colour=0.8, may_flag=True),
        Scenario("noise_2x", "noise 2 x declared", level=2.0, may_flag=True),
        Scenario("spikes", "2 % spikes of 10 sigma", spikes=0.02, may_flag=True),
        Scenario("spikes_up", "2 % spikes, one-sided", spikes=0.02, one_sided=True, may_flag=True),
        Scenario("fin_0.1", "logged fin with 0.1 deg noise", fin_noise=0.1, may_flag=True),
        Scenario("fin_0.5", "logged fin with 0.5 deg noise", fin_noise=0.5, may_flag=True),
        Scenario("weak", "weak trial: 30 s, fin within 2 deg", records=GENTLE),
        Scenario(
            "weak_small", "weak trial, 0.3 x medium forces", records=GENTLE, force=_times(0.3)
        ),
        _YAW,
        replace(
            _YAW,
            name="yaw_zero_hidden",
            title="the same, the model knows no zero",
            hidden=True,
            may_flag=True,
        ),
        replace(
            _YAW, name="yaw_zero_force", title="rudder zeros and a random moment", force=(3e-4,)
        ),
        _SHIP,
        replace(
            _SHIP,
            name="ship_designed",
            title="ship, rudder by the clock, swell of 8 s",
            records=tuple(
                replace(zigzag, name=f"clocked_{hold:g}", hold=hold)
                for zigzag, hold in zip(RUDDER, (9.0, 17.0, 31.0), strict=True)
            ),
        ),
        replace(_SHIP, name="ship_gusts", title="ship, first-order forces", swell=None),
        replace(_SHIP, name="ship_white", title="ship, no forces", force=(0.0,) * 4, swell=None),
        _DRONE,
        replace(_DRONE, name="drone_gusts", title="drone, first-order forces", swell=None),
        replace(_DRONE, name="drone_white", title="drone, no forces", force=(0.0,) * 3, swell=None),
        Scenario(
            "remus_swell",
            "medium, JONSWAP with peak at 8 s",
            force=_times(1.0),
            swell=8.0,
        ),
    )
}
