"""Records of a small AUV in the diving plane that hide known effects.

Written from the published equations alone, in plain NumPy: it shares no code
with the package that it judges. Runge-Kutta at 0.01 s, commands held for
0.1 s; many cases are integrated side by side.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np

from benchmarks.truth import MASSES, NAMES, NOISE, TRUE, gauss_markov, runge_kutta

SAMPLE, SUBSTEPS = 0.1, 10
STEP = SAMPLE / SUBSTEPS


class Fin:
    """From fin command to fin angle: delay, dead band, play, rate limit, lag, offset, stall."""

    def __init__(self, truth: Truth, first: np.ndarray) -> None:
        self.truth = truth
        self.commands = [first]
        self.play = self._dead(first)
        self.angle = self.play.copy()

    def command(self, command: np.ndarray) -> None:
        """Take the command of the next sample."""
        self.commands.append(command.copy())

    def _dead(self, angle: np.ndarray) -> np.ndarray:
        half = self.truth.of("fin_deadband")
        return np.sign(angle) * np.maximum(abs(angle) - half, 0.0)

    def _delayed(self, sub: int) -> np.ndarray:
        """Mean over one substep of the command a delay ago."""
        if not np.any(self.truth.of("fin_delay")):
            return self.commands[-1]
        history = np.stack(self.commands)
        newest = len(self.commands) - 1
        # Time since the newest command came, in samples, at both ends of the substep.
        begin = newest + sub / SUBSTEPS - self.truth.of("fin_delay") / SAMPLE
        end = begin + 1 / SUBSTEPS
        early = np.clip(np.floor(begin + 1e-9).astype(int), 0, newest)
        late = np.clip(np.floor(end - 1e-9).astype(int), 0, newest)
        share = np.where(late > early, (end - late) * SUBSTEPS, 1.0)
        every = np.arange(len(begin))
        return share * history[late, every] + (1 - share) * history[early, every]

    def advance(self, sub: int) -> tuple[np.ndarray, ...]:
        """Fin angle at the start, middle and end of the next substep."""
        of = self.truth.of
        wanted = self._dead(self._delayed(sub))
        half = of("fin_backlash")
        self.play = np.clip(self.play, wanted - half, wanted + half)
        lag, limit = of("fin_lag"), of("fin_rate_limit")
        begin = self.angle
        parts = [begin]
        for share in (0.5, 1.0):
            toward = np.where(lag > 0, 1 - np.exp(-share * STEP / np.maximum(lag, 1e-9)), 1.0) * (
                self.play - begin
            )
            reach = np.where(limit > 0, share * STEP * limit, np.inf)
            parts.append(begin + np.clip(toward, -reach, reach))
        parts[0] = np.where((lag == 0) & (limit == 0), self.play, begin)
        self.angle = parts[2]
        angles = np.array(parts) + of("fin_offset")
        return tuple(angles * (1 - of("fin_stall") * angles**2))


MASS, INERTIA, X_UDOT, Z_WDOT, Z_QDOT, M_WDOT, M_QDOT = MASSES
BELIEVED = dict(zip(NAMES, map(float, TRUE), strict=True))
# In the order in which cases draw them.
ORDER = ("X_uu", "Z_uw", "Z_uq", "Z_uuds", "M_uw", "M_uq", "M_uuds", "zgW")
PRIORS = {name: BELIEVED[name] for name in ORDER}
MEMORY_TIME = 2.0  # of the fluid's memory, s
FIRST_DEPTH = 10.0
Force = Callable[[SimpleNamespace], np.ndarray]


# Generalized force per unit of amplitude, by axis. Lower-case u, w: through the water.
FORCES: dict[str, dict[str, Force]] = {
    "heave_crossflow_drag": {"Z": lambda s: s.w * abs(s.w)},
    "heave_quadratic_pitch_damping": {"Z": lambda s: s.q * abs(s.q)},
    "pitch_crossflow_moment": {"M": lambda s: s.w * abs(s.w)},
    "pitch_quadratic_damping": {"M": lambda s: s.q * abs(s.q)},
    "surge_induced_drag": {"X": lambda s: s.w**2},
    "surge_fin_drag": {"X": lambda s: s.u**2 * s.d**2},
    "surge_linear_drag": {"X": lambda s: s.u},
    "excess_buoyancy": {"X": lambda s: -s.sin, "Z": lambda s: s.cos},
    "cg_offset_x": {"M": lambda s: -s.cos},
    "hull_asymmetry_heave": {"Z": lambda s: s.u**2},
    "hull_asymmetry_pitch": {"M": lambda s: s.u**2},
    "fluid_memory": {"Z": lambda s: s.w_ground - s.memory},
    "hull_compressibility": {
        "X": lambda s: -(s.z - FIRST_DEPTH) * s.sin,
        "Z": lambda s: (s.z - FIRST_DEPTH) * s.cos,
    },
    "wave_heave_force": {"Z": lambda s: np.cos(s.wave_frequency * s.t + s.wave_phase)},
    # What no vocabulary holds:
    "unknown_cubic_pitch_damping": {"M": lambda s: s.q**3},
    "unknown_speed_pitch_damping": {"M": lambda s: s.u * s.q * abs(s.q)},
    "unknown_pitch_moment_wq": {"M": lambda s: s.w * s.q},
    "unknown_heave_rate_drag": {"Z": lambda s: s.w * abs(s.q)},
    "unknown_pitch_drift_damping": {"M": lambda s: s.q * abs(s.w)},
    "unknown_cubic_moment": {"M": lambda s: s.w**3},
    "unknown_cubic_drag": {"X": lambda s: s.u**3},
    "unknown_thrust_moment": {"M": lambda s: s.thrust},
    "unknown_fin_in_slipstream": {"M": lambda s: s.thrust * s.d},
    "unknown_double_angle_moment": {"M": lambda s: s.sin * s.cos},
}


@dataclass(frozen=True)
class Noise:
    """What disturbs the vehicle and its sensors.

    Attributes
    ----------
    colour : float
        Correlation of sensor noise from sample to sample.
    force : tuple of float
        Standard deviation of random X [N], Z [N] and M [N m].
    force_time : float
        Their correlation time in s; 0 for forces drawn anew every sample.
    """

    colour: float = 0.0
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    force_time: float = 0.0


@dataclass(frozen=True)
class Case:
    """What is true, and what disturbs.

    Attributes
    ----------
    name : str
    derivatives : mapping
        True values of the believed derivatives.
    effects : mapping
        Identifier to amplitude, of everything hidden.
    noise : Noise
    seed : int
        Of noise and disturbances.
    wave_frequency, wave_phase : float
        Of ``wave_heave_force``.
    """

    name: str
    derivatives: Mapping[str, float]
    effects: Mapping[str, float] = field(default_factory=dict)
    noise: Noise = Noise()
    seed: int = 0
    wave_frequency: float = 1.0
    wave_phase: float = 0.0


@dataclass(frozen=True)
class Manoeuvre:
    """One record: a relay zigzag in pitch, or a sequence of steps of the fin.

    Attributes
    ----------
    name : str
    thrust : float
        Commanded thrust, N.
    amplitude, switch : float
        Of a zigzag: fin angle and pitch at which it is reversed, degrees.
    levels : tuple of float
        Of steps: fin angles in degrees, repeated to the end.
    hold : float
        Time at each level, s.
    """

    name: str
    thrust: float
    amplitude: float = 0.0
    switch: float = 0.0
    levels: tuple[float, ...] = ()
    hold: float = 1.0


BEGIN, DURATION = 2.0, 90.0
TRAIN = (
    Manoeuvre("train_steps", 12.0, levels=(8, -8, 8, -8, 0, 12, -12, 4, -4, 0), hold=4.0),
    Manoeuvre("train_zigzag_10_10", 9.0, 10.0, 10.0),
    Manoeuvre("train_zigzag_5_5", 5.0, 5.0, 5.0),
)
TEST = (
    Manoeuvre("test_steps", 7.0, levels=(6, 0, -10, 10, -6, 3, -3, 14, -14, 0), hold=5.0),
    Manoeuvre("test_zigzag_15_12", 10.0, 15.0, 12.0),
)


@dataclass(frozen=True)
class Records:
    """One simulated manoeuvre.

    Attributes
    ----------
    times : ndarray (n_times,)
    inputs : ndarray (n_times, 2)
        Fin command [rad] and thrust [N].
    clean, outputs : ndarray (n_times, 5)
        Outputs without and with noise.
    """

    times: np.ndarray
    inputs: np.ndarray
    clean: np.ndarray
    outputs: np.ndarray


def simulate(
    cases: Sequence[Case],
    manoeuvres: Sequence[Manoeuvre],
    *,
    commands: np.ndarray | None = None,
) -> list[list[Records]]:
    """Simulate manoeuvres for many cases, all side by side.

    Parameters
    ----------
    cases : sequence of Case
    manoeuvres : sequence of Manoeuvre
        Each starts from level trim at 10 m.
    commands : ndarray (n_cases, n_manoeuvres, n_times, 2), optional
        Commands to replay in place of the manoeuvres' own.

    Returns
    -------
    list of list of Records
        The manoeuvres of every case.
    """
    times = np.arange(round(DURATION / SAMPLE) + 1) * SAMPLE
    rows = [(case, manoeuvre) for case in cases for manoeuvre in manoeuvres]
    # Of each record the forces are drawn first, then the noise.
    forces, noise = zip(*(_drawn(case, run, len(times)) for case, run in rows), strict=True)
    truth = Truth([case for case, _ in rows])
    thrust = np.array([manoeuvre.thrust for _, manoeuvre in rows])
    pilot = _pilot([manoeuvre for _, manoeuvre in rows])
    inputs = np.zeros((len(rows), len(times), 2))
    clean = np.zeros((len(rows), len(times), 5))
    given = None if commands is None else commands.reshape(inputs.shape)

    def command(k: int, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        wanted = np.column_stack([pilot(k, state[3]), thrust]) if given is None else given[:, k]
        inputs[:, k] = wanted
        return inputs[:, k, 0], inputs[:, k, 1]

    start = np.sqrt(thrust / -truth.derivatives["X_uu"]), np.full(len(rows), FIRST_DEPTH)
    for k, state in integrate(truth, start, np.stack(forces, 2), command):
        if k is not None:
            clean[:, k] = truth.measure(state).T
            last = state
    command(len(times) - 1, last)  # which acts on nothing
    found = [Records(times, *one) for one in zip(inputs, clean, clean + noise, strict=True)]
    n = len(manoeuvres)
    return [found[first : first + n] for first in range(0, len(found), n)]


def integrate(
    truth: Truth,
    start: tuple[np.ndarray, np.ndarray],
    forces: np.ndarray,
    command: Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> Iterator[tuple[int | None, np.ndarray]]:
    """States ``(9, n_cases)`` of all cases side by side, at every sample and between samples.

    Parameters
    ----------
    truth : Truth
    start : tuple of ndarray (n_cases,)
        Speed, m/s, and depth, m.
    forces : ndarray (n_times, 3, n_cases)
        X, Z in N, M in N m, held from sample to sample.
    command : callable
        From sample and state to fin, rad, and thrust, N, of all cases, held likewise.

    Yields
    ------
    sample, state
        The sample is None between samples, every 0.01 s.
    """
    state = np.zeros((9, forces.shape[2]))
    state[0] = state[7] = start[0]
    state[4] = state[6] = start[1]
    fin = Fin(truth, command(0, state)[0])
    for k in range(len(forces)):
        yield k, state
        if k + 1 < len(forces):
            angle, thrust = command(k, state)
            fin.command(angle)
            for sub in range(SUBSTEPS):
                given = k * SAMPLE + sub * STEP, fin.advance(sub), thrust, forces[k]
                state = runge_kutta(truth.rate, state, STEP, *given)
                yield None, state


def _pilot(manoeuvres: Sequence[Manoeuvre]) -> Callable[[int, np.ndarray], np.ndarray]:
    """Commands from sample and pitch angle: steps by the clock, zigzags by a relay on the angle."""
    amplitude, switch = np.radians([[m.amplitude, m.switch] for m in manoeuvres]).T
    relay = np.ones(len(manoeuvres))

    def command(sample: int, pitch: np.ndarray) -> np.ndarray:
        """Fin commands at one sample; positive ones pitch the bow down."""
        elapsed = sample - round(BEGIN / SAMPLE)
        if elapsed < 0:
            return np.zeros(len(relay))
        relay[pitch < -switch] = -1.0
        relay[pitch > switch] = 1.0
        steps = [
            m.levels[elapsed // round(m.hold / SAMPLE) % len(m.levels)] if m.levels else 0.0
            for m in manoeuvres
        ]
        return relay * amplitude + np.radians(steps)

    return command


def _drawn(case: Case, manoeuvre: Manoeuvre, n_times: int) -> tuple[np.ndarray, np.ndarray]:
    """Forces of one record, held from sample to sample, and noise of its sensors."""
    rng, noise = np.random.default_rng([case.seed, zlib.crc32(manoeuvre.name.encode())]), case.noise
    memory = np.exp(-SAMPLE / noise.force_time) if noise.force_time > 0 else 0.0
    forces = gauss_markov(rng.standard_normal((n_times, 3)), memory) * np.array(noise.force)
    return forces, gauss_markov(rng.standard_normal((n_times, 5)), noise.colour) * NOISE


class Truth:
    """Equations of motion and of measurement, for all cases at once.

    State rows: ``u w q theta z`` over ground, memory of the fluid, lagged
    ``z u w``.
    """

    def __init__(self, cases: Sequence[Case]) -> None:
        self.derivatives = {n: np.array([c.derivatives[n] for c in cases]) for n in PRIORS}
        known = set().union(*(case.effects for case in cases))
        self.size = {n: np.array([c.effects.get(n, 0.0) for c in cases]) for n in known}
        self.nothing = np.zeros(len(cases))
        self.wave_frequency = np.array([c.wave_frequency for c in cases])
        self.wave_phase = np.array([c.wave_phase for c in cases])
        self.surge = MASS - X_UDOT + self.of("surge_added_mass_error")
        self.heave = MASS - Z_WDOT + self.of("heave_added_mass_error")
        self.pitch = INERTIA - M_QDOT + self.of("pitch_added_inertia_error")
        self.determinant = self.heave * self.pitch - Z_QDOT * M_WDOT

    def of(self, name: str) -> np.ndarray:
        """Amplitude of an effect in every case."""
        return self.size.get(name, self.nothing)

    def rate(
        self,
        state: np.ndarray,
        stage: int,
        begin: float,
        fins: Sequence[np.ndarray],
        thrust: np.ndarray,
        forces: np.ndarray,
    ) -> np.ndarray:
        """Time derivative of the state in a step from ``begin`` on; ``fins`` at all its stages."""
        time, fin = begin + stage * STEP / 2, fins[stage]
        u, w, q, theta, z, memory, z_lagged, u_lagged, w_lagged = state
        sin, cos = np.sin(theta), np.cos(theta)
        forward, down = self.of("current_horizontal"), self.of("current_vertical")
        u_r = u - forward * cos + down * sin
        w_r = w - forward * sin - down * cos
        c = self.derivatives
        push = thrust * (1 - self.of("thrust_decay") * time)
        push = push + thrust * self.of("thrust_speed_loss") * u_r
        x = -MASS * q * w + c["X_uu"] * u_r * abs(u_r) + push + forces[0]
        heave = MASS * u * q + u_r * (c["Z_uw"] * w_r + c["Z_uq"] * q + c["Z_uuds"] * u_r * fin)
        moment = u_r * (c["M_uw"] * w_r + c["M_uq"] * q + c["M_uuds"] * u_r * fin)
        total = {"X": x, "Z": heave + forces[1], "M": moment - c["zgW"] * sin + forces[2]}
        signals = SimpleNamespace(
            u=u_r, w=w_r, w_ground=w, q=q, z=z, sin=sin, cos=cos, d=fin, thrust=thrust, t=time,
            memory=memory, wave_frequency=self.wave_frequency, wave_phase=self.wave_phase,
        )  # fmt: skip
        for name, size in self.size.items():
            for axis, force in FORCES.get(name, {}).items():
                total[axis] = total[axis] + size * force(signals)
        rate = np.zeros_like(state)
        rate[0] = total["X"] / self.surge
        # [heave, -Z_qdot; -M_wdot, pitch] [w', q'] = [Z, M]
        rate[1] = (self.pitch * total["Z"] + Z_QDOT * total["M"]) / self.determinant
        rate[2] = (self.heave * total["M"] + M_WDOT * total["Z"]) / self.determinant
        rate[3] = q
        rate[4] = -u * sin + w * cos
        rate[5] = (w - memory) / MEMORY_TIME
        depth_lag, dvl_lag = self.of("depth_lag"), self.of("dvl_lag")
        rate[6] = np.where(depth_lag > 0, (z - z_lagged) / np.maximum(depth_lag, STEP), 0.0)
        rate[7] = np.where(dvl_lag > 0, (u - u_lagged) / np.maximum(dvl_lag, STEP), 0.0)
        rate[8] = np.where(dvl_lag > 0, (w - w_lagged) / np.maximum(dvl_lag, STEP), 0.0)
        return rate

    def measure(self, state: np.ndarray) -> np.ndarray:
        """Measured ``u w q theta z`` without noise."""
        u, w, q, theta, z, _, z_lagged, u_lagged, w_lagged = state
        u = np.where(self.of("dvl_lag") > 0, u_lagged, u)
        w = np.where(self.of("dvl_lag") > 0, w_lagged, w)
        z = np.where(self.of("depth_lag") > 0, z_lagged, z)
        turn = self.of("dvl_misalignment")
        u, w = u - turn * w, w + turn * u
        w = w - self.of("dvl_lever_arm") * q
        return np.stack(
            [
                u * (1 + self.of("scale_u")) + self.of("bias_u"),
                w * (1 + self.of("scale_w")) + self.of("bias_w"),
                q * (1 + self.of("scale_q")) + self.of("bias_q"),
                theta + self.of("bias_theta"),
                z * (1 + self.of("scale_z")),
            ]
        )
