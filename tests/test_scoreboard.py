"""The scoreboard of measured data: readers, rows and decays."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from marks import MEASURED

from benchmarks.documents import turns
from benchmarks.scoreboard import __main__ as board
from benchmarks.scoreboard import drive, esso_osaka, roll_decay, silverbox, tanks
from benchmarks.scoreboard.row import Row, columns
from oed_sysid import Record, load_problem, simulate_inputs
from oed_sysid.data.third_party import data_folder
from oed_sysid.errors import DataError


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data folder with the estimation record of the tanks and the registered roll decay."""
    for name in (tanks.ESTIMATION, f"{roll_decay.FOLDER}/{roll_decay.REGISTERED}.csv"):
        (tmp_path / name).parent.mkdir()
        shutil.copy(data_folder() / name, tmp_path / name)
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    return tmp_path


@pytest.fixture
def folder(data: Path) -> Path:
    """Where the roll decays of this data folder lie."""
    return data / roll_decay.FOLDER


def test_reference_of_the_drive_slides_and_stops() -> None:
    """Without dry friction speed dies away exponentially; with it the carriage stops and stays."""
    still, start = np.zeros(3000), np.array([0.1, 0.5])
    free = drive.sliding(np.array([90.0, 200.0, 0.0, 0.0]), still, start)
    times = drive.STEP * np.arange(3000)
    decay = 90.0 / 200.0
    assert free == pytest.approx(0.1 + 0.5 * decay * (1.0 - np.exp(-times / decay)), abs=5e-5)
    braked = drive.sliding(np.array([90.0, 0.0, 45.0, 0.0]), still, start)
    # v = 0.5 - t/2: it stands after a second and a quarter of a metre.
    assert braked[1001:] == pytest.approx(0.35, abs=1e-3)
    assert np.ptp(braked[1002:]) == 0.0


def test_reference_of_the_drive_finds_what_was_simulated() -> None:
    """SciPy gives the four parameters of a run of the same equations back."""
    truth = np.array([90.0, 180.0, 15.0, -2.0])
    force = 60.0 * np.sign(np.sin(2.0 * np.pi * 1e-3 * np.arange(3000)))
    run = drive.sliding(truth, force, np.zeros(2))
    assert drive.reference(force, run) == pytest.approx(truth, rel=1e-3)
    assert drive.error(truth, force, run + 1e-3) < 1e-6


def test_a_perfect_prediction_scores_nothing() -> None:
    """A run of the model itself has no error 100 s ahead; a shift of u has its share."""
    model = load_problem("esso_osaka").variant("wind").model
    times = np.arange(0.0, 200.5, 0.5)
    inputs = np.column_stack([0.3 * np.sin(times / 20), 10.0 + 0 * times, times / 100, 0 * times])
    run = simulate_inputs(model, times, inputs=inputs, initial={"u": 0.3})
    record = Record("self", times, inputs, run.outputs, model.channels)
    errors = esso_osaka.errors(model, record)
    assert esso_osaka.relative(errors) == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    away = run.outputs.copy()
    away[50:, 1] += 0.029
    ratio = esso_osaka.relative(esso_osaka.errors(model, record.with_outputs(away)))
    assert 0.6 < ratio[1] < 1.2


def test_silverbox_parts_keep_their_samples() -> None:
    """Between the samples the input is band-limited; at the samples it is what was measured."""
    model = load_problem("silverbox").model
    time = np.arange(5000) / silverbox.SAMPLING
    wave = np.sin(2 * np.pi * 40.0 * time)
    record = silverbox.part_of(wave, wave, (1000, 3000), model)
    assert record.n_samples == 2000 * silverbox.FINER
    measured = record.outputs[:: silverbox.FINER, 0]
    assert measured == pytest.approx(wave[1000:3000])
    assert record.inputs[:: silverbox.FINER, 0] == pytest.approx(wave[1000:3000], abs=0.02)
    edge = silverbox.part_of(wave, wave, (100, 3000), model)  # fewer samples before than padding
    assert edge.inputs[1000 :: silverbox.FINER, 0] == pytest.approx(wave[350:3000], abs=0.02)


@MEASURED
def test_held_back_tanks_are_scored(data: Path) -> None:
    """A validation record that the model made scores zero, one that is 0.1 V off scores 0.1."""
    model = load_problem("cascaded_tanks").variant("torricelli").model
    record = tanks.read(tanks.ESTIMATION, model)
    found = tanks.fit(model, record)
    assert found.rms["level"] == pytest.approx(0.56, abs=0.03)
    start = dict(zip(model.state_names, found.initial_states[0], strict=True))
    run = simulate_inputs(found.model, record.times, inputs=record.inputs, initial=start)
    level, pump = columns(data / tanks.ESTIMATION, "y_V", "u_V")
    made = np.minimum(run.outputs[:, 0], 10.0)

    def publish(own: np.ndarray, shift: float) -> None:
        table = np.column_stack([pump, pump, own, made + shift])
        np.savetxt(
            data / tanks.PUBLISHED, table, delimiter=",", header="uEst,uVal,yEst,yVal", comments=""
        )

    for shift in (0.0, 0.1):
        publish(level, shift)
        validation = tanks.read_validation(model.channels)
        assert tanks.validation_error(found, validation) == pytest.approx(shift, abs=1e-3)
    publish(level + 0.1, 0.0)
    with pytest.raises(DataError, match="yEst is not that of the estimation record"):
        tanks.read_validation(model.channels)
    grown = tanks.fit(tanks.grow(found.model, "level_zero"), record, start="near")
    assert grown.rms["level"] < found.rms["level"]


@MEASURED
def test_roll_decay_needs_nonlinear_terms() -> None:
    """Small angles are met three times better with cubic restoring and quadratic damping."""
    linear, quadratic, both = (row.ours for row in roll_decay.score()[:3])
    assert linear == pytest.approx(0.0866, abs=1e-3)
    assert both < 0.4 * linear
    assert quadratic > 2 * both


def test_turns_are_summed_up_by_quantity() -> None:
    """Rms over turns of the advance, then of the tactical diameter; the transfer is not scored."""
    measured = {
        f"{name} turn_{side}": 2.0
        for side in ("port", "starboard")
        for name in ("advance", "transfer", "tactical_diameter")
    }
    found = dict(measured)
    found["advance turn_port"], found["advance turn_starboard"] = 2.06, 1.92  # 3 and -4 per cent
    found["tactical_diameter turn_port"] = 2.2
    found["transfer turn_port"] = 9.0
    reached = turns._reached(found, measured)
    assert reached["advance"] == pytest.approx(np.sqrt((3.0**2 + 4.0**2) / 2))
    assert set(reached) == {"advance", "tactical_diameter"}
    assert reached["tactical_diameter"] == pytest.approx(np.sqrt(10.0**2 / 2))


HEADER_DECAYS = "t_s,x_m,y_m,z_m,phi_rad,theta_rad,psi_rad"
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
    np.savetxt(path, table, delimiter=",", header=HEADER_DECAYS, comments="", fmt="%.8g")


def test_the_free_decay_is_cut_out(tmp_path: Path) -> None:
    """From the first turning point after the release until a fifth is left, or the tow stops."""
    channels = roll_decay.models()[roll_decay.FULL].channels
    path = tmp_path / "model_test_99.csv"
    stand_in(path, AT_REST, degrees=9.0, duration=80.0)
    found = roll_decay.read_decay(path, channels)
    assert found.begin == pytest.approx(21.3 + 1.28, abs=0.1)  # half a period later
    assert not found.towed
    assert found.record.times[-1] + found.begin == pytest.approx(79.0, abs=1.5)
    assert np.degrees(found.amplitudes[0]) == pytest.approx(8.4, abs=0.3)
    stand_in(path, AT_SPEED, degrees=9.0, duration=110.0, speed=0.967, stops=50.0)
    found = roll_decay.read_decay(path, channels)
    assert "(15.5 kn)" in found.title
    assert found.record.times[-1] + found.begin == pytest.approx(49.5, abs=0.5)
    stand_in(path, AT_SPEED, degrees=9.0, duration=110.0, speed=0.967)
    found = roll_decay.read_decay(path, channels)
    assert 0.2 <= found.amplitudes[-1] / found.amplitudes[0] < 0.25
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    table[:, 4] += np.radians(0.5)  # a heel
    np.savetxt(path, table, delimiter=",", header=HEADER_DECAYS, comments="")
    heeled = roll_decay.read_decay(path, channels)
    assert heeled.amplitudes == pytest.approx(found.amplitudes)


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


def test_a_board_that_fails_leaves_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error of any type becomes a row in words, which no bar or line's end breaks."""
    fine = Row("fine", 1.0, "-")

    def broken() -> list[Row]:
        raise KeyError("a | b\nc")

    monkeypatch.setattr(board, "BOARDS", {"broken": broken, "fine": lambda: [fine]})
    output = tmp_path / "table.md"
    board.main(output=output)
    page = output.read_text(encoding="utf-8")
    assert "| fine | 1 | - |" in page
    assert "cannot be scored: the board broken: unforeseen KeyError: 'a \\| b\\nc'" in page
