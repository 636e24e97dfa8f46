"""The scoreboard: further roll decay tests, by simulated stand-ins of known damping."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks.scoreboard import roll_decay
from oed_sysid.data.third_party import data_folder
from oed_sysid.errors import DataError
from oed_sysid.experiments.simulation import simulate_inputs

MEASURED = pytest.mark.skipif("OED_SYSID_DATA" not in os.environ, reason="measured data absent")
HEADER = "t_s,x_m,y_m,z_m,phi_rad,theta_rad,psi_rad"
# Near what the registered test says: inertia, cubic restoring, linear and quadratic damping.
AT_REST = {
    "I_xx": 135.72,
    "E_roll_cubic_restoring": -686.6,
    "K_p": -0.82,
    "E_roll_quadratic_damping": -13.5,
}
AT_SPEED = {**AT_REST, "K_p": -9.0, "E_roll_quadratic_damping": 0.0}


def stand_in(
    path: Path,
    values: dict[str, float],
    *,
    degrees: float,
    duration: float,
    speed: float = 0.0,
    stops: float = np.inf,
) -> None:
    """A log with rest, half a swing of push, a decay and, with speed, the tow that stops.

    After the tow has stopped the model is shaken.
    """
    model = roll_decay.models()[roll_decay.FULL].with_values(values)
    times = np.arange(0.0, duration, 0.01)
    rest = times < 20.0
    pushed = ~rest & (times < 21.3)
    free = times >= 21.3
    after = times[free] - times[free][0]
    run = simulate_inputs(
        model,
        after,
        inputs=np.empty((len(after), 0)),
        initial={"phi": -np.radians(degrees), "p": 0.0},
    )
    phi = np.zeros(len(times))
    phi[pushed] = -np.radians(degrees) * 0.5 * (1 - np.cos(np.pi * (times[pushed] - 20.0) / 1.3))
    phi[free] = run.outputs[:, 0]
    shaken = times > stops + 1.0
    phi[shaken] += np.radians(2.0) * np.sin(1.7 * (times[shaken] - stops - 1.0))
    x = speed * np.minimum(times, stops)
    rng = np.random.default_rng(3)
    phi = np.radians(0.01) * np.round(np.degrees(phi) / 0.01 + 0.2 * rng.standard_normal(len(phi)))
    table = np.zeros((len(times), 7))
    table[:, 0], table[:, 1], table[:, 4] = times, x, phi
    np.savetxt(path, table, delimiter=",", header=HEADER, comments="", fmt="%.8g")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data folder with the registered test."""
    place = tmp_path / roll_decay.FOLDER
    place.mkdir()
    name = "model_test_21337.csv"
    shutil.copy(data_folder() / roll_decay.FOLDER / name, place / name)
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    return place


def test_the_free_decay_is_cut_out(tmp_path: Path) -> None:
    """From the first turning point after the release until a fifth is left, or the tow stops."""
    channels = roll_decay.models()[roll_decay.FULL].channels
    path = tmp_path / "model_test_99.csv"
    stand_in(path, AT_REST, degrees=9.0, duration=80.0)
    found = roll_decay.read_decay(path, channels)
    assert found.begin == pytest.approx(21.3 + 1.28, abs=0.1)  # half a period later
    assert not found.towed
    assert found.record.times[-1] + found.begin == pytest.approx(79.0, abs=1.5)
    assert np.degrees(found.first) == pytest.approx(8.4, abs=0.3)
    stand_in(path, AT_SPEED, degrees=9.0, duration=110.0, speed=0.967, stops=50.0)
    found = roll_decay.read_decay(path, channels)
    assert found.knots == pytest.approx(15.5, abs=0.1)
    assert found.record.times[-1] + found.begin == pytest.approx(49.5, abs=0.5)
    assert "slows down" in found.text
    stand_in(path, AT_SPEED, degrees=9.0, duration=110.0, speed=0.967)
    found = roll_decay.read_decay(path, channels)
    assert 0.2 <= found.last / found.first < 0.25
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    table[:, 4] += np.radians(0.5)
    np.savetxt(path, table, delimiter=",", header=HEADER, comments="")
    heeled = roll_decay.read_decay(path, channels)
    assert heeled.first == pytest.approx(found.first)
    assert "a heel of 0.50 deg" in heeled.text
    still = tmp_path / "model_test_21340.csv"
    stand_in(still, AT_SPEED, degrees=9.0, duration=70.0)
    found = roll_decay.read_decay(still, channels)
    assert found.towed
    assert "speed as stated" in found.text


@MEASURED
def test_a_further_decay_at_rest_is_predicted(folder: Path) -> None:
    """A stand-in of known damping is met, the missing row is gone, damping is separated."""
    stand_in(folder / "model_test_21338.csv", AT_REST, degrees=7.0, duration=195.0)
    rows = {row.what: row for row in roll_decay.score()}
    names = [f"roll decay 21338 (0 kn), {name}" for name in roll_decay.STRUCTURES]
    linear, quadratic, both = (rows[name].ours for name in names)
    assert both < 0.03
    assert quadratic > 0.3
    assert linear > 0.3
    together = rows["roll decay, tests at zero speed fitted together (21337, 21338), residual"]
    assert together.ours == pytest.approx(0.0122, abs=0.005)
    assert together.note.endswith(": separated")
    linear_part, quadratic_part = (
        float(together.note.split(f"{name} ")[1].split()[0]) for name in ("K_p", "K_abspp")
    )
    assert linear_part == pytest.approx(-0.82, abs=0.03)
    assert quadratic_part == pytest.approx(-13.5, abs=0.2)
    assert "roll decay 21338 (0 kn)" not in rows
    assert rows["roll decay 21340 (15.5 kn)"].instead == "missing"


@MEASURED
def test_damping_at_speed_is_fitted_to_the_first_half(folder: Path) -> None:
    """The linear damping put in comes out; beside it quadratic damping is not separated."""
    stand_in(
        folder / "model_test_21340.csv", AT_SPEED, degrees=9.0, duration=88.0, speed=0.967,
        stops=76.0,
    )  # fmt: skip
    rows = {row.what: row for row in roll_decay.score()}
    start = "roll decay 21340 (15.5 kn)"
    from_rest = rows[f"{start}, {roll_decay.FULL}"].ours
    own = rows[f"{start}, second half, linear damping and inertia of this speed"]
    assert own.ours < 0.02
    assert from_rest > 10 * own.ours
    said = float(own.note.split("K_p ")[1].split()[0])
    assert said == pytest.approx(-9.0, abs=0.05)
    both = rows[f"{start}, second half, linear and quadratic damping and inertia of this speed"]
    assert "not separated, because" in both.note


@MEASURED
def test_a_bad_decay_leaves_the_other_rows(folder: Path) -> None:
    """Files at fault have a row each that says why; the rows of the registered test stay."""
    (folder / "model_test_1.csv").write_text("", encoding="utf-8")
    (folder / "model_test_2.csv").write_text(HEADER + "\n0,0,0,0,0,0,0\n", encoding="utf-8")
    (folder / "model_test_21340.csv").write_bytes(b"\x00\x01binary")
    rows = roll_decay.score()
    assert [row.ours for row in rows[:3]] == pytest.approx([0.0866, 0.0751, 0.0281], abs=1e-3)
    notes = [row.note for row in rows if row.instead == "cannot be scored"]
    assert [note.split(": ")[1] for note in notes] == [
        "model_test_1.csv",
        "model_test_2.csv",
        "model_test_21340.csv",
    ]
    assert "is empty" in notes[0]
    assert "has 1 samples" in notes[1]
    assert "not plain text" in notes[2]
    assert rows[-1].ours == pytest.approx(0.0225, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t * [1, 1, 1, 1, 57.3, 1, 1], "Give radians"),
        (lambda t: t[:2600], "turning points"),
        (lambda t: np.delete(t, slice(4000, 4100), axis=0), "cut the log at its gaps"),
        (lambda t: t[::-1], "Sort the rows"),
        (lambda t: t * [1, 1, 1, 1, 0.05, 1, 1], "expected a decay from"),
    ],
)
def test_logs_that_are_no_decay_are_refused(tmp_path: Path, change, message: str) -> None:
    """Degrees, a short test, gaps, reversed rows and rest are named."""
    path = tmp_path / "model_test_99.csv"
    stand_in(path, AT_REST, degrees=9.0, duration=60.0)
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    np.savetxt(path, change(table), delimiter=",", header=HEADER, comments="")
    with pytest.raises(DataError, match=message):
        roll_decay.read_decay(path, roll_decay.models()[roll_decay.FULL].channels)
