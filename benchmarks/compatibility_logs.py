"""Logs for the benchmark of the check: spoilt copies and measured files."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from oed_sysid import (
    Dataset,
    Input,
    Model,
    Output,
    Parameter,
    Problem,
    State,
    load_problem,
    read_csv,
)
from oed_sysid.evidence.check import LogCheck

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
    ship = free_running(HSVA, "delta")
    for path in sorted((folder / "kvlcc2_hsva_zigzag").glob("HSVA*.csv")):
        yield path.stem, ship, lambda path=path: read_csv(path, ship.channels)
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
