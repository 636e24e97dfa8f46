"""The scoreboard of measured data: readers, rows and decays."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from benchmarks.scoreboard import __main__ as board
from benchmarks.scoreboard import (
    boehm,
    circles,
    esso_osaka,
    glider,
    roll_decay,
    silverbox,
    tanks,
    turns,
)
from benchmarks.scoreboard.row import Row, attempted, read_table
from oed_sysid import Dataset, MultipleShooting, Record, load_problem
from oed_sysid.data.third_party import data_folder
from oed_sysid.errors import DataError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.prediction.structures import Structure
from problems.esso_osaka.manoeuvring import MMG
from problems.esso_osaka.missing import WIND
from problems.esso_osaka.records import HEADER, load
from problems.kvlcc2.structures import ahead

MEASURED = pytest.mark.skipif("OED_SYSID_DATA" not in os.environ, reason="measured data absent")


def test_missing_files_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without data a board has no figure and says which file belongs where."""
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    (row,) = boehm.score()
    assert row.ours is None
    assert "boehm_2014/" in row.note
    output = tmp_path / "table.md"
    board.main(["boehm", "--output", str(output)])
    board.main(["boehm", "--output", str(output)])  # a second run replaces its section
    page = output.read_text(encoding="utf-8")
    assert page.count("| missing |") == 1
    assert page.count("## boehm") == 1


def test_unknown_board_is_refused(capsys: pytest.CaptureFixture) -> None:
    """A wrong name ends with the names that there are."""
    with pytest.raises(SystemExit):
        board.main(["tank"])
    assert "silverbox" in capsys.readouterr().err


def test_a_perfect_prediction_scores_nothing() -> None:
    """A run of the model itself has no error 100 s ahead; a shift of u has its share."""
    model = load_problem("esso_osaka").variant("wind").model
    times = np.arange(0.0, 200.5, 0.5)
    inputs = np.column_stack([0.3 * np.sin(times / 20), 10.0 + 0 * times, times / 100, 0 * times])
    run = simulate_inputs(model, times, inputs=inputs, initial={"u": 0.3})
    record = Record("self", times, inputs, run.outputs, model.channels)
    assert esso_osaka.ahead(model, record) == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    away = run.outputs.copy()
    away[50:, 1] += 0.029
    ratio = esso_osaka.ahead(model, record.with_outputs(away))
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
def test_held_back_tanks_are_scored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A validation file that the model made scores zero, one that is 0.1 V off scores 0.1."""
    name = "cascaded_tanks/estimation.csv"
    (tmp_path / "cascaded_tanks").mkdir()
    shutil.copy(data_folder() / name, tmp_path / name)
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    model = load_problem("cascaded_tanks").variant("torricelli").model
    record = tanks.read(name, model)
    found = tanks.fit(model, record)
    assert found.rms["level"] == pytest.approx(0.56, abs=0.03)
    start = dict(zip(model.state_names, found.initial_states[0], strict=True))
    run = simulate_inputs(found.model, record.times, inputs=record.inputs, initial=start)
    for shift in (0.0, 0.1):
        table = np.column_stack(
            [record.times, record.inputs[:, 0], np.minimum(run.outputs[:, 0], 10.0) + shift]
        )
        np.savetxt(
            tmp_path / tanks.VALIDATION, table, delimiter=",", header="t_s,u_V,y_V", comments=""
        )
        validation, name = tanks.read_validation(model.channels)
        assert name == "validation.csv"
        assert tanks.validation_error(found, validation) == pytest.approx(shift, abs=1e-3)
    grown = tanks.fit(tanks.grow(found.model, "level_zero"), record, start="near")
    assert grown.rms["level"] < found.rms["level"]


@MEASURED
def test_roll_decay_needs_nonlinear_terms() -> None:
    """Small angles are met three times better with cubic restoring and quadratic damping."""
    linear, quadratic, both = (row.ours for row in roll_decay.score()[:3])
    assert linear == pytest.approx(0.0866, abs=1e-3)
    assert both < 0.4 * linear
    assert quadratic > 2 * both


def decay(folder: Path) -> None:
    """Files of a small problem: a decays into b at a rate, and the share of b is measured."""
    libsbml = pytest.importorskip("libsbml")
    folder.mkdir()
    document = libsbml.SBMLDocument(2, 4)
    sbml = document.createModel()
    for kind, name in (("Compartment", "cell"), ("Species", "a"), ("Species", "b")):
        one = getattr(sbml, f"create{kind}")()
        one.setId(name)
        if kind == "Species":
            one.setCompartment("cell")
            one.setInitialConcentration(4.0 if name == "a" else 0.0)
        else:
            one.setSize(2.0)
    parameter = sbml.createParameter()
    parameter.setId("k")
    reaction = sbml.createReaction()
    reaction.setId("decay")
    for taking_part, name in ((reaction.createReactant(), "a"), (reaction.createProduct(), "b")):
        taking_part.setSpecies(name)
        taking_part.setStoichiometry(1.0)
    reaction.createKineticLaw().setMath(libsbml.parseL3Formula("cell * k * a^2"))
    libsbml.writeSBMLToFile(document, str(folder / boehm.FILES["model"]))
    (folder / boehm.FILES["observables"]).write_text(
        "observableId\tobservableFormula\nshare\t100 * b / (a + b)\n", encoding="utf-8"
    )
    (folder / boehm.FILES["parameters"]).write_text(
        "parameterId\tlowerBound\tupperBound\tnominalValue\testimate\n"
        "k\t1e-4\t1\t0.05\t1\nsd_share\t1e-5\t1e5\t1\t1\n",
        encoding="utf-8",
    )
    rng = np.random.default_rng(4)
    times = np.arange(0.0, 40.0, 2.0)
    # a' = -k a^2, by hand: the law is an amount per time, the volume divides it.
    share = 100.0 * (1.0 - 1.0 / (1.0 + 4.0 * 0.05 * times)) + 0.5 * rng.standard_normal(len(times))
    lines = [f"share\t{y}\t{t}" for t, y in zip(times, share, strict=True)]
    (folder / boehm.FILES["measurements"]).write_text(
        "\n".join(["observableId\tmeasurement\ttime", *lines]), encoding="utf-8"
    )


def test_petab_files_become_a_model_that_fits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Equations, start and bounds come from the files; the likelihood is the closed form's."""
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    monkeypatch.setattr(boehm, "STARTS", 3)
    folder = tmp_path / boehm.FOLDER
    decay(folder)
    paths = [folder / boehm.FILES[key] for key in ("model", "observables", "parameters")]
    model, start = boehm.read_model(*paths)
    assert start == {"a": 4.0, "b": 0.0}
    record = boehm.read_record(folder / boehm.FILES["measurements"], model)
    times = record.times
    true = simulate_inputs(
        model.with_values({"k": 0.05}), times, inputs=np.empty((len(times), 0)), initial=start
    )
    closed = 100.0 * (1.0 - 1.0 / (1.0 + 0.2 * times))
    assert true.outputs[:, 0] == pytest.approx(closed, abs=0.02)
    (row,) = boehm.score()
    assert row.ours is not None
    best = min(
        boehm.negative_log_likelihood(
            record.outputs - 100.0 * (1.0 - 1.0 / (1.0 + 4.0 * k * times))[:, None]
        )
        for k in np.linspace(0.04, 0.06, 201)
    )
    assert row.ours == pytest.approx(best, abs=0.01)


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
    np.savetxt(path, table, delimiter=",", header=HEADER_DECAYS, comments="")
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
    (folder / "model_test_2.csv").write_text(HEADER_DECAYS + "\n0,0,0,0,0,0,0\n", encoding="utf-8")
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
    np.savetxt(path, change(table), delimiter=",", header=HEADER_DECAYS, comments="")
    with pytest.raises(DataError, match=message):
        roll_decay.read_decay(path, roll_decay.models()[roll_decay.FULL].channels)


ZIGZAG = "esso_osaka/zigzag_31-Jul-2020_13_22_52.csv"
TURN = "esso_osaka/turn_14-Sep-2020_13_39_32.csv"


# -- rows and boards ---------------------------------------------------------------


def test_a_board_that_fails_leaves_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error of any type becomes a row in words, which no bar or line's end breaks."""
    fine = Row("fine", 1.0, "-")

    def broken() -> list[Row]:
        raise KeyError("a | b\nc")

    monkeypatch.setattr(board, "BOARDS", {"broken": broken, "fine": lambda: [fine]})
    output = tmp_path / "table.md"
    board.main(["--output", str(output)])
    page = output.read_text(encoding="utf-8")
    assert "| fine | 1 | - |" in page
    assert "cannot be scored: the board broken: unforeseen KeyError: 'a \\| b\\nc'" in page


def test_rows_of_a_file_are_tried() -> None:
    """What a file gives is kept; what goes wrong is told with its name, without the folder."""
    row = Row("fine", 1.0, "-")
    assert attempted("fine", "-", "a.csv", lambda: [row]) == [row]

    def wrong() -> list[Row]:
        raise DataError(f"{data_folder()}/a.csv is too short. Put a longer one there.")

    (found,) = attempted("fine", "-", "a.csv", wrong)
    assert found.cells()[1] == "cannot be scored"
    assert found.note == (
        "cannot be scored: a.csv: the data folder/a.csv is too short. Put a longer one there."
    )


def test_tables_are_read_by_name(tmp_path: Path) -> None:
    """Semicolons with decimal commas, tabs, quotes, a byte order mark and other columns do."""
    path = tmp_path / "table.csv"
    for text in (
        "V1,V2\n1.5,2\n-3,4e0\n",
        'index; "V2" ; V1 ;\n0;2;1,5;\n1;4;-3;\n\n',
        "\ufeffv2\tv1\n2\t1.5\n\n4\t-3\n",
    ):
        path.write_text(text, encoding="utf-8")
        table = read_table(path, {"V1": (), "V2": ()})
        assert table.numbers("V1") == pytest.approx([1.5, -3.0])
        assert table.numbers("V2") == pytest.approx([2.0, 4.0])
    for text, message in (
        ("", "is empty"),
        (",,\n", "separators only"),
        ("1,2\n3,4\n", "has no header"),
        ("V1,W\n3,4\n", "has no column V2; its columns are V1, W"),
        ("V1,V2\n", "no rows"),
        ("V1,V2\n1,x\n", "line 2, column V2: expected a finite number, got 'x'"),
        ("V1,V2\n1\n", "line 2, column V2: expected a finite number, got ''"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(DataError, match=message):
            read_table(path, {"V1": (), "V2": ()}).numbers("V2")


# -- circles -----------------------------------------------------------------------


def test_indices_are_read_as_people_write_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Order, spelling and blank lines do not matter; metres and unknown names are refused."""
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    found, rows = circles.judged()
    assert not found
    assert rows[0].instead == "missing"
    (tmp_path / "kvlcc2_circles").mkdir()
    path = tmp_path / circles.JUDGES
    path.write_text(
        "Lengths, Quantity, Side, basin\n3.1, Tactical diameter, Port, X\n"
        "3.3,tactical_diameter,STARBOARD,\n21.7,advance,port,X\n3.0,ADVANCE,ahead,\n"
        "3.2,height,port\n,advance,port,\n\n",
        encoding="utf-8",
    )
    found, rows = circles.judged()
    assert [(one.quantity, one.side, one.lengths) for one in found] == [
        ("tactical_diameter", "port", 3.1),
        ("tactical_diameter", "starboard", 3.3),
    ]
    words = ("Divide metres by the length", "'ahead'", "'height'", "got ''")
    for row, word in zip(rows, words, strict=True):
        assert word in row.note
    path.write_text("3.1,advance,port\n", encoding="utf-8")
    (row,) = circles.judged()[1]
    assert "has no header" in row.note
    path.write_text("", encoding="utf-8")
    (row,) = circles.judged()[1]
    assert "indices.csv is empty" in row.note


def test_errors_of_indices_are_relative() -> None:
    """Five per cent more than measured is an error of five per cent."""

    class Average:
        values = {"advance port": 3.15}  # noqa: RUF012

        def interval(self, name: str) -> tuple[float, float]:
            return 3.0, 3.3

    row = circles.row_of(circles.Index("advance", "port", 3.0, "", "a"), Average())  # type: ignore[arg-type]
    assert row.ours == pytest.approx(5.0)
    assert row.published == "-"


# -- Silverbox ---------------------------------------------------------------------


def test_silverbox_is_read_in_several_forms(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Text in either order, and the MATLAB file, hold the same; a short record is refused."""
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    (tmp_path / "silverbox").mkdir()
    rng = np.random.default_rng(0)
    first, second = 0.1 * rng.standard_normal((2, silverbox.LENGTH)).round(4)
    text, original = tmp_path / silverbox.WHOLE, tmp_path / silverbox.ORIGINAL
    lines = "".join(f"{k};{b:.5g};{a:.5g};\n" for k, (a, b) in enumerate(zip(first, second)))  # noqa: B905
    text.write_text("k;V2;V1;\n" + lines, encoding="utf-8")
    voltage, response, remark = silverbox.whole()
    assert voltage == pytest.approx(first, abs=1e-6)
    assert response == pytest.approx(second, abs=1e-6)
    assert remark == ""
    text.write_text("V1,V2,\n" + "0.1,0.2,\n" * 1000, encoding="utf-8")
    with pytest.raises(DataError, match=r"SNLS80mV.csv has 1,000 rows of V1; expected the 131,072"):
        silverbox.whole()
    savemat(original, {"V1": first[None], "V2": second[None]})
    voltage, response, remark = silverbox.whole()
    assert response == pytest.approx(second)
    assert "1,000 rows" in remark
    text.unlink()
    savemat(original, {"V1": 1e3 * first, "V2": second})
    with pytest.raises(DataError, match="Is it in mV"):
        silverbox.whole()
    savemat(original, {"u": first})
    with pytest.raises(DataError, match="no variable V1; it has U"):
        silverbox.whole()
    original.write_bytes(b"no MATLAB file")
    with pytest.raises(DataError, match="cannot be read as a MATLAB file"):
        silverbox.whole()


# -- cascaded tanks ----------------------------------------------------------------


@MEASURED
def test_tanks_are_read_in_both_forms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The published table gives the record that validation.csv gives; faults are named."""
    estimation = data_folder() / tanks.ESTIMATION
    own = np.genfromtxt(estimation, delimiter=",", skip_header=1)
    (tmp_path / "cascaded_tanks").mkdir()
    shutil.copy(estimation, tmp_path / tanks.ESTIMATION)
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    channels = load_problem("cascaded_tanks").model.channels
    pump, level = own[::-1, 1], own[::-1, 2]
    plain, published = tmp_path / tanks.VALIDATION, tmp_path / tanks.PUBLISHED

    def write(times: np.ndarray, level: np.ndarray) -> None:
        table = np.column_stack([times, pump[: len(times)], level[: len(times)]])
        np.savetxt(plain, table, delimiter=",", header="t_s,u_V,y_V", comments="")

    published.write_text(
        '"uEst","uVal","yEst","yVal","Ts",\n'
        + "".join(
            f"{u},{a},{y},{b},{4 if k == 0 else ''},\n"
            for k, (u, a, y, b) in enumerate(zip(own[:, 1], pump, own[:, 2], level, strict=True))
        ),
        encoding="utf-8",
    )
    record, name = tanks.read_validation(channels)
    assert name == "dataBenchmark.csv"
    assert record.inputs[:, 0] == pytest.approx(pump)
    assert record.outputs[:, 0] == pytest.approx(level)
    assert record.sample_time == 4.0
    write(own[:, 0], level)
    again, name = tanks.read_validation(channels)
    assert name == "validation.csv"
    assert again.outputs == pytest.approx(record.outputs)
    write(own[:1000, 0], level)
    _, name = tanks.read_validation(channels)
    assert name.startswith("dataBenchmark.csv, because validation.csv has 1000 samples; expected")
    published.unlink()
    spoilt = level.copy()
    spoilt[7] = np.nan
    for times, values, message in (
        (own[:, 0] / 4, level, "expected 4 s between samples"),
        (own[:, 0], spoilt, "line 9, column y_V: expected a finite number"),
        (own[:, 0], 100 * level, "Give volts"),
        (own[:, 0], own[:, 2], "the level of the estimation record"),
    ):
        write(times, values)
        with pytest.raises(DataError, match=message):
            tanks.read_validation(channels)


# -- Esso Osaka --------------------------------------------------------------------


def write_log(path: Path, table: np.ndarray, names: tuple[str, ...] = HEADER) -> None:
    """A log with these columns."""
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.10g")


@MEASURED
def test_columns_of_logs_are_found_by_name(tmp_path: Path) -> None:
    """Another order of named columns is put right; a log of one row is said to be short."""
    table = load(data_folder() / ZIGZAG)
    order = [0, 2, 1, *range(3, 13)]
    path = tmp_path / "log.csv"
    write_log(path, table[:, order], tuple(HEADER[k] for k in order))
    assert load(path) == pytest.approx(table)
    write_log(path, table[:1])
    with pytest.raises(DataError, match="is too short: 1 complete rows"):
        load(path)
    write_log(path, table[:, :12], HEADER[:12])
    with pytest.raises(DataError, match="has 12 columns; expected the 13"):
        load(path)


@MEASURED
@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({2: 1, 1: 2}, "u reaches"),
        ({5: 6, 6: 5}, "r reaches|yaw rate"),
        ({2: 4, 4: 2}, "positions x"),
        ({7: 8, 8: 7}, "rudder reaches"),
        ({1: 3, 3: 1}, "positions x"),
    ],
)
def test_swapped_columns_are_seen(tmp_path: Path, columns: dict[int, int], message: str) -> None:
    """Speed and position, heading and rate, surge and sway, revolutions and rudder, x and y."""
    table = load(data_folder() / TURN)
    path = tmp_path / "log.csv"
    write_log(path, table[:, [columns.get(k, k) for k in range(13)]])
    with pytest.raises(DataError, match=message):
        esso_osaka.pieces(path, load_problem("esso_osaka").variant("wind").model.channels)


@MEASURED
def test_further_logs_are_scored_each_for_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A copy scores as its original; gaps cut; a log at fault leaves the others."""
    folder = tmp_path / "esso_osaka"
    shutil.copytree(data_folder() / "esso_osaka", folder)
    folder.chmod(0o755)
    whole = load(data_folder() / ZIGZAG)
    shutil.copy(data_folder() / "esso_osaka/random_06-Aug-2020_16_24_25_6.csv", folder / "a.csv")
    write_log(folder / "b_gap.csv", np.delete(whole, slice(400, 450), axis=0))
    write_log(folder / "c_short.csv", whole[:100])
    write_log(folder / "d_degrees.csv", whole * np.where(np.arange(13) == 5, 57.3, 1.0))
    (folder / "e_binary.csv").write_bytes(bytes(range(256)) * 40)
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    model = load_problem("esso_osaka").variant("wind").model
    monkeypatch.setattr(esso_osaka, "learn", lambda: model)
    rows = {row.what.split(", ")[1]: row for row in esso_osaka.score()}
    assert len(rows) == 10
    assert rows["a"].ours == pytest.approx(rows["random_6"].ours)
    assert "6 windows of 100 s, last 94 s left out" in rows["a"].note
    assert "2 pieces between gaps" in rows["b_gap"].note
    assert rows["b_gap"].ours is not None
    assert "its longest piece without gaps in time has 9.9 s" in rows["c_short"].note
    assert "degrees given for radians" in rows["d_degrees"].note
    assert rows["e_binary"].note.startswith("cannot be scored: e_binary.csv: e_binary.csv has")


@MEASURED
@pytest.mark.slow
def test_further_turns_are_scored(tmp_path: Path) -> None:
    """The turn of a further file scores as the registered one that it is a copy of."""
    data = load_problem("esso_osaka").data()
    train = Dataset(tuple(record for record in data if record.name.startswith("zigzag")))
    model = ahead(10.0).fit(MMG + WIND, train).model
    few = tuple(Structure(f"{own:g} s", model, ahead(own)) for own in (10.0, 20.0))
    structures = tuple(turns.remembering(one) for one in few)
    path = tmp_path / "turn_copy.csv"
    shutil.copy(data_folder() / TURN, path)
    channels = data[0].channels
    rows = turns.further_rows(path, {"zigzags": (structures, train)}, channels)
    again = turns._rows(
        "zigzags", turns.predicted(few, train, Dataset((data["turn_10_starboard_35"],)))
    )
    assert [row.ours for row in rows] == pytest.approx([row.ours for row in again])
    assert rows[0].what == "Esso Osaka, turn_copy, advance from zigzags, error"
    fitted = structures[0].estimator.found  # type: ignore[attr-defined]
    before = len(fitted)
    write_log(path, load(data_folder() / TURN)[:1200])  # before the turn
    (row,) = turns.further_rows(path, {"zigzags": (structures, train)}, channels)
    assert row.instead == "cannot be scored"
    assert row.note.startswith("cannot be scored: turn_copy.csv: ")
    assert len(fitted) == before


# -- glider ------------------------------------------------------------------------


@MEASURED
def test_a_search_that_did_not_end_is_said() -> None:
    """The note names the inertia of the steady model and that its fit did not converge."""
    problem = load_problem("slocum_glider")
    one = Dataset((problem.data()[0],))
    fit = MultipleShooting(disturbances="none", start="near", max_iterations=2).fit(
        problem.model, one
    )
    note = glider.note_of(fit)
    assert "inertia of 14 kg" in note
    assert f"not converged after {fit.iterations} iterations" in note
