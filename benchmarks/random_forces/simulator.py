r"""Simulated records, the truth: plain NumPy, no code of the package.

Commands are held between samples; the disturbance forces are drawn at the fine step from

.. math:: w_{k+1} = \varphi w_k + \sigma \sqrt{1 - \varphi^2}\, \varepsilon_k,
    \qquad \varphi = e^{-\Delta t/\tau}

beginning in their stationary distribution. All sets of a scenario are integrated side by side.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from benchmarks.random_forces.scenarios import VEHICLES, Manoeuvre, Scenario, Vehicle, unstable
from benchmarks.truth import gauss_markov, runge_kutta

SPREAD = 0.09  # of true parameters about the believed ones
FIRST_DEPTH = 10.0
# Of the waves of a sea, over that of the peak.
FREQUENCIES = np.linspace(0.4, 3.0, 200)
GRAVITY = 9.81  # m/s^2


@dataclass(frozen=True, eq=False)
class Run:
    """One record and what nobody measures.

    Attributes
    ----------
    name : str
    times : ndarray (n_times,)
    inputs, outputs : ndarray (n_times, ...)
        As logged; NaN where no sample was taken.
    clean : ndarray (n_times, n_outputs)
        The states.
    force : ndarray (n_times, n_forces)
    local : dict
        Parameters of this record.
    """

    name: str
    times: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    clean: np.ndarray
    force: np.ndarray
    local: dict[str, float]


@dataclass(frozen=True, eq=False)
class Set:
    """One data set: the records to fit, a fresh one, and the true parameters."""

    number: int
    truth: dict[str, float]
    runs: tuple[Run, ...]
    fresh: Run

    @property
    def fingerprint(self) -> float:
        """A number that changes whenever the data change."""
        return float(f"{sum(float(np.nansum(np.abs(run.outputs))) for run in self.runs):.9g}")


def stream(seed: int, number: int, *purpose: str) -> np.random.Generator:
    """Random numbers of one purpose in one data set."""
    return np.random.default_rng([seed, number, zlib.crc32(" ".join(purpose).encode())])


@lru_cache(maxsize=4)
def _waves(n: int, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Amplitudes, then cosines and sines of a sea at ``n`` times, in peak periods ``step`` apart.

    JONSWAP spectrum of peak factor 3.3 (Hasselmann et al. 1973) from 0.4 to 3 times its peak.
    """
    f = FREQUENCIES
    wide = np.where(f < 1.0, 0.07, 0.09)
    spectrum = f**-5.0 * np.exp(-1.25 * f**-4.0) * 3.3 ** np.exp(-((f - 1.0) ** 2) / (2 * wide**2))
    angle = 2.0 * np.pi * step * np.outer(np.arange(n), f)
    return np.sqrt(2.0 * spectrum / spectrum.sum()), np.cos(angle), np.sin(angle)


def swell(rng: np.random.Generator, n: int, step: float, count: int) -> np.ndarray:
    """Sums of waves of random phase, unit variance in all, ``(n, count)``; see :func:`_waves`."""
    size, cosine, sine = _waves(n, step)
    phase = rng.uniform(0.0, 2.0 * np.pi, (count, len(size)))
    return np.asarray(cosine @ (size * np.cos(phase)).T - sine @ (size * np.sin(phase)).T)


class Crested:
    """Long-crested seas that records meet where they are and as they are headed.

    Every component is a plane wave of deep water; loads in surge go with the cosine of the angle
    at which it is met, in yaw with the sine of twice that angle, in all others with its sine.
    """

    def __init__(self, scenario: Scenario, columns: Sequence[_Column]) -> None:
        self.size, _, _ = _waves(1, 1.0)
        self.omega = 2.0 * np.pi * FREQUENCIES / scenario.swell
        self.toward = np.radians(scenario.direction or 0.0)
        self.phase = np.stack([c.phase for c in columns], axis=-1)  # axis, component, record
        self.level = np.array(scenario.force)[:, None]
        self.axes = VEHICLES[scenario.vehicle].forces
        self.place = np.zeros((2, len(columns)))  # north and east, m

    def over(
        self, step: int, h: float, state: np.ndarray, heading: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces ``(axis, record)`` at both ends of a step of ``h`` seconds; all move along it."""
        begin = self.at(step * h, heading)
        ahead = np.stack([np.cos(heading), np.sin(heading)])
        aside = np.stack([-ahead[1], ahead[0]])
        self.place = self.place + h * (state[0] * ahead + state[1] * aside)
        return begin, self.at((step + 1) * h, heading + h * state[2])

    def at(self, t: float, heading: np.ndarray) -> np.ndarray:
        """Forces ``(axis, record)`` at a time, where records are."""
        along = self.place[0] * np.cos(self.toward) + self.place[1] * np.sin(self.toward)
        angle = self.omega[:, None] * t - np.outer(self.omega**2 / GRAVITY, along)
        waves = np.einsum("i,aik->ak", self.size, np.cos(angle + self.phase))
        met = self.toward - heading
        share = {"u": np.cos(met), "r": np.sin(2.0 * met)}
        return self.level * waves * np.stack([share.get(a, np.sin(met)) for a in self.axes])


def believed(scenario: Scenario) -> dict[str, float]:
    """Parameters before the trial: the start of every fit."""
    values = dict(VEHICLES[scenario.vehicle].believed)
    return values if scenario.pole is None else unstable(values, scenario.pole)


def true_values(scenario: Scenario, seed: int, number: int) -> dict[str, float]:
    """True parameters of a data set."""
    values = VEHICLES[scenario.vehicle].believed
    draws = stream(seed, number, "truth").standard_normal(len(values))
    drawn = {n: v * (1 + SPREAD * d) for (n, v), d in zip(values.items(), draws, strict=True)}
    return drawn if scenario.pole is None else unstable(drawn, scenario.pole)


def simulate(scenario: Scenario, seed: int, numbers: Sequence[int]) -> list[Set]:
    """Data sets of a scenario."""
    truths = [true_values(scenario, seed, number) for number in numbers]
    manoeuvres = (*scenario.records, scenario.fresh)
    columns = [
        _Column(scenario, manoeuvre, truth, seed, number)
        for number, truth in zip(numbers, truths, strict=True)
        for manoeuvre in manoeuvres
    ]
    runs = _integrate(scenario, columns)
    n = len(manoeuvres)
    return [
        Set(number, truth, tuple(runs[i * n : (i + 1) * n - 1]), runs[(i + 1) * n - 1])
        for i, (number, truth) in enumerate(zip(numbers, truths, strict=True))
    ]


class _Column:
    """One manoeuvre of one data set and all its random numbers.

    Disturbance forces at the fine step, sensor noise, samples that are absent, noise of the logged
    fin, parameters of the record.
    """

    def __init__(
        self,
        scenario: Scenario,
        manoeuvre: Manoeuvre,
        truth: dict[str, float],
        seed: int,
        number: int,
    ) -> None:
        vehicle = VEHICLES[scenario.vehicle]
        self.manoeuvre, self.truth = manoeuvre, truth
        self.n = round((manoeuvre.duration or vehicle.duration) / vehicle.sample_time) + 1
        force, noise, fin, zero = (
            stream(seed, number, manoeuvre.name, part) for part in ("force", "noise", "fin", "zero")
        )
        h = vehicle.sample_time / vehicle.substeps
        n_forces = len(vehicle.forces)
        draws = force.standard_normal(((self.n - 1) * vehicle.substeps + 1, n_forces))
        memory = np.exp(-h / scenario.force_time)
        self.force = np.array(scenario.force) * gauss_markov(draws, memory)
        if scenario.swell:
            seas = [
                swell(stream(seed, number, manoeuvre.name, name), len(draws), h / period, n_forces)
                for name, period in (("swell", scenario.swell), ("wind sea", scenario.wind_sea))
                if period
            ]
            self.force = np.array(scenario.force) * (sum(seas) / np.sqrt(len(seas)))
        waves = stream(seed, number, manoeuvre.name, "crests")
        self.phase = waves.uniform(0.0, 2.0 * np.pi, (n_forces, len(FREQUENCIES)))
        white = noise.standard_normal((self.n, len(vehicle.states)))
        if scenario.colour:
            column = scenario.coloured
            white[:, column] = gauss_markov(white[:, column], scenario.colour)
        self.noise = white * scenario.level * np.array(vehicle.noise_std)
        gaps = stream(seed, number, manoeuvre.name, "gaps")
        self.absent = gaps.random(white.shape) < scenario.missing
        self.absent |= gaps.random((self.n, 1)) < scenario.dropped
        self.absent[0] = False
        for column, stride in enumerate(vehicle.every):
            self.absent[:, column] |= np.arange(self.n) % stride != 0
        self.fin_noise = fin.standard_normal(self.n) * np.radians(scenario.fin_noise)
        zeros = zero.standard_normal(len(vehicle.local))
        self.local = {
            name: float(std * draw)
            for (name, std), draw in zip(vehicle.local.items(), zeros, strict=True)
        }


def _integrate(scenario: Scenario, columns: Sequence[_Column]) -> list[Run]:
    """All records side by side; arrays are ``(time, signal, record)``."""
    vehicle = VEHICLES[scenario.vehicle]
    n, width = max(column.n for column in columns), len(columns)
    h = vehicle.sample_time / vehicle.substeps
    force = np.zeros(((n - 1) * vehicle.substeps + 1, len(vehicle.forces), width))
    noise = np.zeros((n, len(vehicle.states), width))
    for i, column in enumerate(columns):
        force[: len(column.force), :, i] = column.force
        noise[: column.n, :, i] = column.noise
    names, drawn = (*vehicle.believed, *vehicle.local), [c.truth | c.local for c in columns]
    values = {name: np.array([own[name] for own in drawn]) for name in names}
    thrust = np.array([c.manoeuvre.thrust for c in columns])
    state = _begin(vehicle, thrust, values)
    crests = Crested(scenario, columns) if scenario.direction is not None else None
    clean = np.empty((n, *state.shape))
    inputs = np.empty((n, len(vehicle.inputs), width))
    command = _pilot(vehicle, [column.manoeuvre for column in columns])

    def rate(x: np.ndarray, stage: int, held: np.ndarray, pushes: Sequence) -> np.ndarray:
        return vehicle.rate(x, held, pushes[stage], values)

    for k in range(n):
        clean[k] = state
        inputs[k] = np.stack([command(k, state + noise[k]), thrust])[: inputs.shape[1]]
        if k + 1 == n:
            break
        for sub in range(k * vehicle.substeps, (k + 1) * vehicle.substeps):
            if crests is not None:
                force[sub], force[sub + 1] = crests.over(sub, h, state, state[vehicle.steered])
            pushes = force[sub], 0.5 * (force[sub] + force[sub + 1]), force[sub + 1]
            state = runge_kutta(rate, state, h, inputs[k], pushes)
    for i, column in enumerate(columns):
        column.force = force[: len(column.force), :, i]
    return [
        _run(scenario, c, inputs[: c.n, :, i], clean[: c.n, :, i]) for i, c in enumerate(columns)
    ]


def _begin(vehicle: Vehicle, thrust: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """States in which records begin, ``(n_states, n_records)``."""
    state = np.zeros((len(vehicle.states), len(thrust)))
    state[0] = vehicle.cruise
    if vehicle.name == "remus":
        state[0] = np.sqrt(thrust / -values["X_uu"])
        state[4] = FIRST_DEPTH
    return state


def _pilot(
    vehicle: Vehicle, manoeuvres: Sequence[Manoeuvre]
) -> Callable[[int, np.ndarray], np.ndarray]:
    """Fin or rudder of all records, from sample and measured state: relays, or by the clock."""
    amplitude, switch = np.radians([[m.amplitude, m.switch] for m in manoeuvres]).T
    lead = np.array([m.lead for m in manoeuvres])
    hold, gain = np.array([[m.hold, m.gain] for m in manoeuvres]).T
    relay = np.ones(len(manoeuvres))

    def command(k: int, seen: np.ndarray) -> np.ndarray:
        nonlocal relay
        angle = seen[vehicle.steered] + lead * seen[vehicle.rate_output]
        relay = np.where(angle > switch, 1.0, np.where(angle < -switch, -1.0, relay))
        elapsed = k * vehicle.sample_time - vehicle.begin + 1e-9
        by_clock = np.where(np.floor(elapsed / hold) % 2 == 0, 1.0, -1.0)
        relay = np.where(hold < np.inf, by_clock, relay)
        # A helmsman's rudder is a share of the amplitude.
        held = np.clip(gain * (angle - by_clock * switch) / amplitude, -1.0, 1.0)
        relay = np.where(gain > 0.0, held, relay)
        # A bow-down fin lowers theta, a positive rudder raises psi.
        return vehicle.sense * relay * amplitude * (elapsed >= 0.0)

    return command


def _run(scenario: Scenario, column: _Column, inputs: np.ndarray, clean: np.ndarray) -> Run:
    """One record as it is logged."""
    vehicle = VEHICLES[scenario.vehicle]
    logged = inputs.copy()
    outputs = clean + column.noise
    if scenario.dropped:
        column.absent[1:][np.any(np.diff(logged, axis=0) != 0.0, axis=1)] = False
    logged[:, 0] += column.fin_noise
    return Run(
        column.manoeuvre.name,
        np.arange(column.n) * vehicle.sample_time,
        logged,
        np.where(column.absent, np.nan, outputs),
        clean,
        column.force[:: vehicle.substeps],
        column.local,
    )
