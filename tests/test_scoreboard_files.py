"""The scoreboard: forms of held-back files, and files at fault, which take no other row along."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from benchmarks.scoreboard import __main__ as board
from benchmarks.scoreboard import (
    circles,
    esso_osaka,
    glider,
    silverbox,
    tanks,
    turns,
)
from benchmarks.scoreboard.row import Row, attempted, read_table
from oed_sysid import Dataset, MultipleShooting, load_problem
from oed_sysid.data.third_party import data_folder
from oed_sysid.errors import DataError
from oed_sysid.prediction.structures import Structure
from problems.esso_osaka.manoeuvring import MMG
from problems.esso_osaka.missing import WIND
from problems.esso_osaka.records import HEADER, load
from problems.kvlcc2.structures import ahead

MEASURED = pytest.mark.skipif("OED_SYSID_DATA" not in os.environ, reason="measured data absent")
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
