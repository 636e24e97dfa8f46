"""Logs made of kinematics alone, with faults: nothing of them is shared with the package.

Velocities and rates are sums of sines with random phases, positions and angles their integrals,
ten times finer than they are sampled.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.spoilt_logs import PLANE, diving_plane, ship
from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Input, Model, Output, Parameter, Record, State, read_csv
from oed_sysid.evidence.check import LogCheck

FINE = 10
SPEEDS = (1.0, 1.5, 2.1)


@dataclass(frozen=True)
class Vehicle:
    """Kinematics of a vehicle with the noise of its sensors."""

    model: Model
    motion: Callable[[float, int, float, np.random.Generator], dict[str, np.ndarray]]
    noise: dict[str, float]
    step: float
    duration: float


def _wander(n: int, dt: float, fast: float, rng: np.random.Generator) -> np.ndarray:
    """Return a smooth random signal of unit size with periods down to ``fast`` seconds."""
    t = np.arange(n) * dt
    periods = fast * np.exp(rng.uniform(0.0, 1.6, 5))
    phases = rng.uniform(0.0, 2.0 * math.pi, 5)
    waves = [np.sin(2.0 * math.pi * t / p + a) for p, a in zip(periods, phases, strict=True)]
    return np.sum(waves, axis=0) / math.sqrt(2.5)


def _diving(speed: float, n: int, dt: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
    theta = 0.17 * _wander(n, dt, 9.0, rng)
    q = np.gradient(theta, dt)
    u = speed * (1.0 + 0.08 * _wander(n, dt, 20.0, rng) - 0.5 * theta**2)
    w = 0.06 * speed * _wander(n, dt, 7.0, rng) + 0.3 * q
    rate = -u * np.sin(theta) + w * np.cos(theta)
    return {"u": u, "w": w, "q": q, "theta": theta, "z": 10.0 + _integral(rate, dt)}


def _ship(speed: float, n: int, dt: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
    r = 0.04 * _wander(n, dt, 20.0, rng)
    psi = 2.0 + _integral(r, dt)
    u = speed * (1.0 - 30.0 * r**2 + 0.05 * _wander(n, dt, 30.0, rng))
    v = -2.0 * r + 0.02 * speed * _wander(n, dt, 15.0, rng)
    x = _integral(u * np.cos(psi) - v * np.sin(psi), dt)
    y = _integral(u * np.sin(psi) + v * np.cos(psi), dt)
    return {"u": u, "v": v, "r": r, "psi": psi, "x": x, "y": y}


def _integral(rate: np.ndarray, dt: float) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * dt * (rate[1:] + rate[:-1]))])


DIVER = Vehicle(
    diving_plane(),
    _diving,
    {"u": 0.02, "w": 0.02, "q": 0.004, "theta": 0.004, "z": 0.03},
    0.1,
    90.0,
)

SHIP = Vehicle(
    ship(), _ship, {"u": 0.03, "v": 0.03, "r": 0.002, "psi": 0.004, "x": 0.1, "y": 0.1}, 0.25, 225.0
)

VEHICLES = (DIVER, SHIP)


@dataclass(frozen=True)
class Fault:
    """A fault that is put into a log."""

    kind: str
    signals: tuple[str, ...]
    size: float
    other: str = ""

    def alter(self, motion: dict[str, np.ndarray], times: np.ndarray) -> None:
        """Put the fault into a motion that is known at these times."""
        for name in self.signals:
            true = motion[name]
            if self.kind == "lever":
                motion[name] = true + self.size * motion[self.other]
            elif self.kind == "scale":
                motion[name] = (1.0 + self.size) * true
            elif self.kind == "bias":
                motion[name] = true + self.size
            elif self.kind == "delay":
                motion[name] = np.interp(times - self.size, times, true)


def log(
    vehicle: Vehicle, *faults: Fault, seed: int | tuple[int, ...] = 0, colour: float = 0.0,
    runs: int = 3,
) -> Dataset:  # fmt: skip
    """Return what would have been logged: faults, sampling, noise with correlation ``colour``.

    The first of three records, one for each speed, of motions that are random.
    """
    rng = np.random.default_rng(seed)
    n = round(vehicle.duration / vehicle.step) * FINE + 1
    dt = vehicle.step / FINE
    fine = np.arange(n) * dt
    records = []
    for number, here in enumerate([vehicle.motion(speed, n, dt, rng) for speed in SPEEDS]):
        for fault in sorted(faults, key=lambda one: one.kind != "lever"):  # of true rates
            fault.alter(here, fine)
        times = fine[::FINE]
        columns = []
        for name in vehicle.model.output_names:
            white = gauss_markov(rng.standard_normal(times.size), colour)
            columns.append(here[name][::FINE] + vehicle.noise[name] * white)
        rows = slice(round(3.0 / vehicle.step), None)
        matrix = np.column_stack(columns)[rows]
        inputs = np.zeros((matrix.shape[0], 1))
        records.append(Record(f"run_{number}", times[rows], inputs, matrix, vehicle.model.channels))
    return Dataset(records[:runs])


def match(found: LogCheck, fault: Fault):  # type: ignore[no-untyped-def]
    """Return the finding that names a fault outright, or None."""
    for one in found.findings:
        fix = one.correction
        if fix is not None and fix.kind == fault.kind and set(fix.signals) == set(fault.signals):
            return one
    return None


def free_running(columns: dict[str, str], rudder: str, *, wrap: bool = False) -> Model:
    """Return a ship in surge, sway and yaw as a check needs it: kinematics and names of columns."""
    units = {"x": "m", "y": "m", "psi": "rad", "u": "m/s", "v": "m/s", "r": "rad/s"}
    kinematics = PLANE | {"u": "-u/T", "v": "-v/T", "r": "(K*delta - r)/T"}
    return Model(
        "free-running model",
        states=tuple(State(name, unit) for name, unit in units.items()),
        inputs=(Input("delta", "rad", column=rudder),),
        outputs=tuple(
            Output(name, unit, column=columns[name], wrap=wrap and name == "psi")
            for name, unit in units.items()
        ),
        kinematics=kinematics,
        parameters=(Parameter("K", 0.1, "1/s"), Parameter("T", 10.0, "s")),
    )


HSVA = {"x": "x0", "y": "y0", "psi": "psi", "u": "dx0", "v": "dy0", "r": "r"}
ESSO = {
    "x": "x_position_mid", "y": "y_position_mid", "psi": "psi_hat", "u": "u_velo", "v": "vm_velo",
    "r": "r_angvelo",
}  # fmt: skip


def read_filled(path: Path, model: Model) -> Dataset:
    """Read a file without the empty rows at its end."""
    lines = path.read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if line.split(",")[0].strip() not in ("", "nan", "NaN")]
    if len(kept) == len(lines):
        return read_csv(path, model.channels)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_text("\n".join([*kept, ""]), encoding="utf-8")
        return read_csv(copy, model.channels)
