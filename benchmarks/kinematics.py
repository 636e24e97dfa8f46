"""Kinematics of the vehicles whose logs are judged; their dynamics nobody uses."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

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


def model(name: str, kinematics: dict[str, str], units: dict[str, str]) -> Model:
    """Kinematics with first-order responses of all velocities."""
    rates = {n: f"(K*fin - {n})/T" for n in units if n not in kinematics}
    return Model(
        name,
        states=tuple(State(n, u) for n, u in units.items()),
        inputs=(Input("fin", "rad"),),
        outputs=tuple(Output(n, u) for n, u in units.items()),
        kinematics=kinematics | rates,
        parameters=(Parameter("K", 1.0), Parameter("T", 5.0, "s")),
    )


def diving_plane() -> Model:
    """Surge, heave and pitch."""
    return model(
        "diving plane",
        {"theta": "q", "z": "-u*sin(theta) + w*cos(theta)"},
        {"u": "m/s", "w": "m/s", "q": "rad/s", "theta": "rad", "z": "m"},
    )


# Position and heading in the horizontal plane.
PLANE = {"x": "u*cos(psi) - v*sin(psi)", "y": "u*sin(psi) + v*cos(psi)", "psi": "r"}


def ship() -> Model:
    """Surge, sway and yaw."""
    return model(
        "ship",
        PLANE,
        {"u": "m/s", "v": "m/s", "r": "rad/s", "psi": "rad", "x": "m", "y": "m"},
    )


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
