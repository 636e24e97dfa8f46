"""The check of logs on spoilt and on measured records; `spoilt_logs` has the exam with rates.

    python -m benchmarks.compatibility [spoilt measured]

The simulated logs that tests use come from kinematics alone, integrated ten times finer than they
are sampled: velocities and rates are sums of sines with random phases, positions and angles their
integrals. Nothing of them is shared with the package.
"""

from __future__ import annotations

import math
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.harness import command, known
from benchmarks.kinematics import diving_plane, ship
from benchmarks.truth import gauss_markov
from oed_sysid import (
    Dataset,
    Input,
    Model,
    Output,
    Parameter,
    Problem,
    Record,
    State,
    load_problem,
    read_csv,
)
from oed_sysid.evidence.check import LogCheck, check, quick_check

Spoil = Callable[[dict[str, np.ndarray], np.ndarray, np.random.Generator], None]

DEGREES = 180.0 / math.pi


def _turn(s: dict[str, np.ndarray], name: str, factor: float) -> None:
    s[name] = factor * s[name]


def _swap(s: dict[str, np.ndarray], first: str, second: str) -> None:
    s[first], s[second] = s[second], s[first]


def _earth(s: dict[str, np.ndarray]) -> None:
    u, w, theta = s["u"], s["w"], s["theta"]
    s["u"] = u * np.cos(theta) + w * np.sin(theta)
    s["w"] = -u * np.sin(theta) + w * np.cos(theta)


def _spikes(s: dict[str, np.ndarray], rng: np.random.Generator) -> None:
    hit = rng.random(s["theta"].size) < 0.01
    s["theta"] = s["theta"] + np.where(hit, 0.3 * rng.standard_normal(hit.size), 0.0)


def _late(s: dict[str, np.ndarray], times: np.ndarray) -> None:
    # What was measured before the record began is continued by a straight line.
    early = s["z"][0] + (s["z"][10] - s["z"][0]) * (times - times[0] - 1.0)
    late = np.interp(times - 1.0, times, s["z"])
    rng = np.random.default_rng(5)
    noisy = early + 0.03 * rng.standard_normal(times.size)
    s["z"] = np.where(times - 1.0 < times[0], noisy, late)


# Name of the copy, what the check has to say (kind, signal), and how it is made.
SPOILS: dict[str, tuple[str, str, Spoil]] = {
    "theta_sign": ("sign", "theta", lambda s, t, g: _turn(s, "theta", -1.0)),
    "q_deg": ("unit", "q", lambda s, t, g: _turn(s, "q", DEGREES)),
    "q_sign": ("sign", "q", lambda s, t, g: _turn(s, "q", -1.0)),
    "z_up": ("sign", "z", lambda s, t, g: _turn(s, "z", -1.0)),
    "z_feet": ("unit", "z", lambda s, t, g: _turn(s, "z", 1.0 / 0.3048)),
    "u_w_swap": ("swap", "u", lambda s, t, g: _swap(s, "u", "w")),
    "earth": ("frame", "u", lambda s, t, g: _earth(s)),
    "spikes": ("spikes", "theta", lambda s, t, g: _spikes(s, g)),
    "w_dead": ("dead", "w", lambda s, t, g: _turn(s, "w", 0.0)),
    "fin_deg": ("unit", "fin_command", lambda s, t, g: _turn(s, "fin_command", DEGREES)),
    "fin_sign": ("sign", "fin_command", lambda s, t, g: _turn(s, "fin_command", -1.0)),
    "q_bias": ("bias", "q", lambda s, t, g: s.update(q=s["q"] + 0.01)),
    "u_scale": ("scale", "u", lambda s, t, g: _turn(s, "u", 1.05)),
    "z_late": ("delay", "z", lambda s, t, g: _late(s, t)),
    "w_lever": ("lever", "w", lambda s, t, g: s.update(w=s["w"] + 0.5 * s["q"])),
}


def spoil(data: Dataset, name: str, *, seed: int = 3) -> Dataset:
    """Return copies of records with one fault of :data:`SPOILS`."""
    change = SPOILS[name][2]
    records = []
    for record in data:
        rng = np.random.default_rng(seed)
        names = (record.channels.input_names, record.channels.output_names)
        signals = {n: record.input(n) for n in names[0]} | {n: record.output(n) for n in names[1]}
        change(signals, record.times, rng)
        records.append(
            replace(
                record,
                inputs=np.column_stack([signals[n] for n in names[0]]),
                outputs=np.column_stack([signals[n] for n in names[1]]),
            )
        )
    return Dataset(tuple(records))


def named_as(found: LogCheck, name: str) -> bool:
    """Whether a spoilt copy was named: its kind and signal, and nothing else as suspect."""
    kind, signal, _ = SPOILS[name]
    return len(found.serious) == 1 and found.named(kind, signal) is not None


def data_folder() -> Path:
    """Folder of third-party data."""
    return Path(os.environ.get("OED_SYSID_DATA", "."))


def hidden_effect_cases() -> dict[str, tuple[Problem, Dataset]]:
    """Training records of all hidden-effect cases, by name."""
    problem = load_problem("remus_diving_plane")
    folders = sorted((data_folder() / "hidden_effects").glob("case_*"))
    return {
        folder.name: (problem, read_csv(sorted(folder.glob("train_*.csv")), problem.channels))
        for folder in folders
    }


def free_running(columns: dict[str, str], rudder: str, *, wrap: bool = False) -> Model:
    """Return a ship in surge, sway and yaw as a check needs it: kinematics and names of columns."""
    units = {"x": "m", "y": "m", "psi": "rad", "u": "m/s", "v": "m/s", "r": "rad/s"}
    kinematics = {
        "x": "u*cos(psi) - v*sin(psi)",
        "y": "u*sin(psi) + v*cos(psi)",
        "psi": "r",
        "u": "-u/T",
        "v": "-v/T",
        "r": "(K*delta - r)/T",
    }
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


def measured_files() -> Iterator[tuple[str, Model, Callable[[], Dataset]]]:
    """Title, model and reader of each measured file, its velocities taken as the labels say."""
    folder = data_folder()
    model = free_running(HSVA, "delta")
    for path in sorted((folder / "kvlcc2_hsva_zigzag").glob("HSVA*.csv")):
        yield path.stem, model, lambda path=path: read_csv(path, model.channels)
    tanker = free_running(ESSO, "delta_rudder", wrap=True)
    for path in sorted((folder / "esso_osaka").glob("*.csv")):
        yield path.stem, tanker, lambda path=path: read_filled(path, tanker)


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
    ship(),
    _ship,
    {"u": 0.03, "v": 0.03, "r": 0.002, "psi": 0.004, "x": 0.1, "y": 0.1},
    0.25,
    225.0,
)

VEHICLES = (DIVER, SHIP)


@dataclass(frozen=True)
class Fault:
    """A fault that is put into a log."""

    kind: str
    signals: tuple[str, ...]
    size: float
    other: str = ""


def motions(vehicle: Vehicle, rng: np.random.Generator) -> list[dict[str, np.ndarray]]:
    """Return true signals on the fine grid, one set for each speed."""
    n = round(vehicle.duration / vehicle.step) * FINE + 1
    return [vehicle.motion(speed, n, vehicle.step / FINE, rng) for speed in SPEEDS]


def log(
    vehicle: Vehicle,
    truth: Sequence[dict[str, np.ndarray]],
    faults: Sequence[Fault],
    colour: float,
    rng: np.random.Generator,
) -> Dataset:
    """Return what would have been logged: faults, sampling, noise with correlation ``colour``."""
    records = []
    dt = vehicle.step / FINE
    for number, signals in enumerate(truth):
        here = dict(signals)
        fine = np.arange(here["u"].size) * dt
        for fault in faults:
            if fault.kind == "lever":
                here[fault.signals[0]] = here[fault.signals[0]] + fault.size * here[fault.other]
        for fault in faults:
            for name in fault.signals:
                if fault.kind == "scale":
                    here[name] = (1.0 + fault.size) * here[name]
                elif fault.kind == "bias":
                    here[name] = here[name] + fault.size
                elif fault.kind == "delay":
                    here[name] = np.interp(fine - fault.size, fine, here[name])
        times = fine[::FINE]
        columns = []
        for name in vehicle.model.output_names:
            white = gauss_markov(rng.standard_normal(times.size), colour)
            columns.append(here[name][::FINE] + vehicle.noise[name] * white)
        rows = slice(round(3.0 / vehicle.step), None)
        matrix = np.column_stack(columns)[rows]
        inputs = np.zeros((matrix.shape[0], 1))
        records.append(Record(f"run_{number}", times[rows], inputs, matrix, vehicle.model.channels))
    return Dataset(tuple(records))


def is_named(found: LogCheck, fault: Fault) -> bool:
    """Whether a fault is among the findings, as the finding itself or in its group."""
    if match(found, fault) is not None:
        return True
    words = {"lever": "lever arm of"}.get(fault.kind, f"{fault.kind} of")
    text = f"{words} {' and '.join(fault.signals)}"
    return any(text in other for one in found.findings for other in one.alternatives)


def match(found: LogCheck, fault: Fault):  # type: ignore[no-untyped-def]
    """Return the finding that names a fault outright, or None."""
    for one in found.findings:
        fix = one.correction
        if fix is not None and fix.kind == fault.kind and set(fix.signals) == set(fault.signals):
            return one
    return None


def spoilt() -> None:
    """The spoilt copies of hidden-effect records, and the records as they are."""
    cases = hidden_effect_cases()
    if not cases:
        print("spoilt: no hidden_effects folder below OED_SYSID_DATA")
        return
    problem, data = cases["case_010"]
    right = 0
    for name in SPOILS:
        found = check(spoil(data, name), problem)
        quick = quick_check(spoil(data, name), problem.model)
        right += named_as(found, name)
        print(f"{name:12} {'named' if named_as(found, name) else 'MISSED'}: {found.verdict}")
        print(f"{'':12} quick: {quick.verdict}")
    print(f"spoilt copies named: {right} of {len(SPOILS)}")
    for name, (own, records) in cases.items():
        print(f"{name} {check(records, own).verdict}", flush=True)


def measured() -> None:
    """What the check says about measured files."""
    for title, model, load in measured_files():
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always")
            found = check(load(), model)
        wrapped = any("unwrapped" in str(note.message) for note in notes)
        print(f"{title}{' (heading wraps)' if wrapped else ''}")
        for one in found.findings:
            print(f"     {'*' if one.suspect else ' '} {one.says}", flush=True)


PARTS = {"spoilt": spoilt, "measured": measured}


def main(parts: Sequence[str] = tuple(PARTS)) -> None:
    """Run the parts that are asked for."""
    for name in parts:
        print(f"\n-- {name}", flush=True)
        PARTS[known(name, PARTS, "part")]()


if __name__ == "__main__":
    command(main)
