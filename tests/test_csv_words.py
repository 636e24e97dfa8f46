"""What is said of CSV files that cannot be used, or that hide what they hold."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from oed_sysid.cli import BAD_INPUT, DONE, main
from oed_sysid.data.dataset import read_csv
from oed_sysid.data.record import closest
from oed_sysid.errors import DataError, ProblemError, UnitWarning
from oed_sysid.experiments.problem import load_problem
from oed_sysid.physics.channels import Channels, Input, Output

SHIP = Channels((Input("delta", "rad"),), (Output("psi", "rad"), Output("r", "rad/s")))
HEADER = "t [s],delta [rad],psi [rad]"


def rows(n: int = 12) -> list[str]:
    """Rows of a good log: t, delta, psi."""
    return [f"{0.5 * i},{0.1 * (i % 5 > 2):g},{0.01 * i:g}" for i in range(n)]


def written(folder: Path, lines: list[str], header: str = HEADER) -> Path:
    """A log in a file."""
    path = folder / "log.csv"
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def with_row(index: int, text: str) -> list[str]:
    """Good rows, one of them another."""
    return [*rows()[:index], text, *rows()[index + 1 :]]


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (with_row(4, ",0.1,0.2"), "Row 6 of log.csv: the time is empty or no number (1 such row)"),
        ([*rows()[:5], rows()[4], *rows()[5:]], "Row 7 of log.csv repeats the row before (time 2)"),
        (with_row(5, "2,0.1,0.2"), "Row 7 of log.csv: time 2 repeats that of the row before"),
        (rows()[::-1], "log.csv runs backwards: its rows stand in reverse"),
        (with_row(5, "1,0.1,0.2"), "Row 7 of log.csv: time 1 after 2 runs backwards"),
        (with_row(5, "2.5"), "Row 7 of log.csv has 1 cell, but the header has 3"),
        (with_row(5, "2.5,1"), "Row 7 of log.csv has 2 cells, but the header has 3"),
    ],
)
def test_times_and_cells(lines: list[str], words: str, tmp_path: Path) -> None:
    """Each fault has its own words: the row, what is wrong and what to do."""
    with pytest.raises(DataError) as caught:
        read_csv(written(tmp_path, lines), SHIP)
    assert words in str(caught.value)


def test_midnight_is_recognised(tmp_path: Path) -> None:
    """Times of day that begin anew at midnight are no unsorted rows, and counting on is read."""
    seconds = 86395.0 + np.arange(12)
    texts = [f"{int(s) // 3600:02d}:{int(s) // 60 % 60:02d}:{s % 60:04.1f}" for s in seconds]
    days = [text.replace("24:", "00:", 1) for text in texts]
    for clock, expected in ((days, None), (texts, 11.0)):
        lines = [f"{c},0,{0.01 * i}" for i, c in enumerate(clock)]
        path = written(tmp_path, lines, "time,delta [rad],psi [rad]")
        if expected is not None:
            with pytest.warns(UserWarning, match="times of a clock"):
                assert read_csv(path, SHIP)[0].duration == expected
            continue
        with pytest.raises(
            DataError, match=r"Row 7 .* 00:00:00 after 23:59:59 looks like midnight"
        ):
            read_csv(path, SHIP)


def test_header_behind_a_mark_of_remarks(tmp_path: Path) -> None:
    """Headers as numpy.savetxt writes them, with # before, are headers; other remarks are none."""
    record = read_csv(written(tmp_path, rows(), f"# {HEADER}"), SHIP)[0]
    assert record.n_samples == 12
    assert record.output("psi")[3] == 0.03
    with pytest.raises(DataError, match="holds numbers, not headers"):
        read_csv(written(tmp_path, rows(), "# trial, calm water, north"), SHIP)


def test_wrapped_angle_is_said_in_units_of_the_file(tmp_path: Path) -> None:
    """A heading in degrees that jumps names the row, the column and both values in degrees."""
    lines = [f"{0.5 * i},0,{(350 + 4 * i) % 360}" for i in range(90)]
    path = written(tmp_path, lines, "t [s],delta [rad],psi [deg]")
    with pytest.raises(DataError) as caught:
        read_csv(path, SHIP)
    said = str(caught.value)
    assert "Column 'psi [deg]' of log.csv jumps by a full turn once in row 5" in said or (
        "Column 'psi [deg]' of log.csv jumps by a full turn 2 times, first in row 5" in said
    )
    assert "from 358 to 2 deg. The angle is wrapped: declare Output(" in said


def test_slips_in_names(tmp_path: Path) -> None:
    """A column that is spelt almost as a channel is offered; another channel's is not."""
    with pytest.raises(
        DataError, match=r"none of the outputs psi, r\..*Did you mean 'phsi \[rad\]'"
    ):
        read_csv(written(tmp_path, rows(), "t [s],delta [rad],phsi [rad]"), SHIP)
    with pytest.raises(DataError, match=r"no column 'delta' .*Did you mean 'DELTA'"):
        read_csv(written(tmp_path, rows(), "t [s],DELTA [rad],psi [rad]"), SHIP)
    both = Channels((Input("delta", "rad"),), (Output("phi", "rad"), Output("psi", "rad")))
    assert read_csv(written(tmp_path, rows()), both)[0].missing_outputs == ("phi",)
    three = Channels((Input("delta", "rad"),), (Output("theta", "rad"), Output("psi", "rad")))
    path = written(tmp_path, [f"{row},0.1" for row in rows()], f"{HEADER},tehta [rad]")
    with pytest.warns(UserWarning, match=r"no column 'theta', but 'tehta \[rad\]', which is not"):
        read_csv(path, three)
    assert closest("Psi", ["psi", "phi"]) == " Did you mean 'psi'?"


def test_same_file_twice(tmp_path: Path) -> None:
    """One file under two names is no second record."""
    path = written(tmp_path, rows())
    with pytest.raises(DataError, match=r"log\.csv' is given twice"):
        read_csv([path, tmp_path / "." / "log.csv"], SHIP)
    with pytest.raises(DataError, match=r"log\.csv' is given twice"):
        read_csv([tmp_path, path], SHIP)


def test_advice_holds_on_the_command_line() -> None:
    """What an error tells to do exists where the error is read."""
    with pytest.raises(ProblemError, match="oed-sysid new FOLDER, in Python"):
        load_problem("no_such_vehicle_anywhere")
    with pytest.raises(ProblemError, match=r"no model 'nomnal'.*default is the nominal one"):
        load_problem("nomoto_sparse_heading", variant="nomnal")


def test_commands_for_a_folder_with_a_space(tmp_path: Path, monkeypatch, capsys) -> None:
    """The command that `new` prints can be pasted, and the page says it quoted, too."""
    monkeypatch.chdir(tmp_path)
    assert main(["new", "my vehicle"]) == DONE
    assert "oed-sysid problems 'my vehicle'" in capsys.readouterr().out
    assert "'my vehicle'" in (tmp_path / "my vehicle" / "README.md").read_text()
    assert main(["new", "my vehicle"]) == BAD_INPUT
    assert "oed-sysid problems FOLDER" in capsys.readouterr().err


def milliseconds(folder: Path, unit: str, n: int = 400) -> str:
    """A log of a turn with a sample every 100 ms."""
    angles = np.where(np.arange(n) // 80 % 2, -0.2, 0.2)
    rate, heading, lines = 0.0, 0.0, []
    for i, angle in enumerate(angles):
        lines.append(f"{100 * i},{angle},{heading:.6f}")
        rate += 0.1 * (0.5 * angle - rate)
        heading += 0.1 * rate
    return str(written(folder, lines, f"t [{unit}],delta [rad],psi [rad]"))


def test_milliseconds_as_seconds_are_refused(tmp_path: Path, capsys) -> None:
    """A log a thousand times too long for its problem is refused, with the options that help."""
    path = milliseconds(tmp_path, "s")
    for command in ("check", "fit", "diagnose"):
        assert main([command, "nomoto_sparse_heading", path, "--quiet"]) == BAD_INPUT
        said = capsys.readouterr()
        assert "its times seem to be milliseconds" in said.err
        assert "--time-unit ms; if they are seconds, add --time-unit s." in said.err
        assert not said.out
    assert main(["check", "nomoto_sparse_heading", path, "--time-unit", "s"]) == DONE
    assert "milliseconds" not in capsys.readouterr().err


def test_time_unit_takes_precedence(tmp_path: Path, capsys) -> None:
    """With --time-unit ms the wrong header reads as the right one; other words are refused."""
    results = []
    for unit, option in (("s", ["--time-unit", "ms"]), ("ms", [])):
        stored = tmp_path / f"{unit}.json"
        line = ["rank", "nomoto_sparse_heading", milliseconds(tmp_path, unit), *option]
        assert main([*line, "--json", str(stored), "--quiet"]) == DONE
        results.append(json.loads(stored.read_text())["ranking"])
    assert results[0] == results[1]
    path = milliseconds(tmp_path, "s")
    assert main(["check", "nomoto_sparse_heading", path, "--time-unit", "weeks"]) == BAD_INPUT
    assert "weeks" in capsys.readouterr().err


def test_unlikely_units_are_said_although_quiet(tmp_path: Path, capsys) -> None:
    """A unit that is most likely wrong is noted on standard error, --quiet or not."""
    lines = [f"{0.1 * i:g},0,{i}" for i in range(60)]
    path = str(written(tmp_path, lines))
    main(["check", "nomoto_sparse_heading", path, "--quiet"])
    assert "more than three turns" in capsys.readouterr().err
    with pytest.warns(UnitWarning, match="steps by 100 s"):
        read_csv(milliseconds(tmp_path, "s"), SHIP)
