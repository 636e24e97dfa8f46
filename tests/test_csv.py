"""CSV files: every spelling that people write, what is noted and what is refused."""

from __future__ import annotations

import warnings
from pathlib import Path

import bad_input
import numpy as np
import pytest
from bad_input.csv_files import CHANNELS, GOOD, NOTED, READ, REFUSED
from bad_input.problem_files import REFUSED as FOLDERS
from commands import told
from marks import slow

from benchmarks.bad_input import NOTED_AND_REFUSED, PAGE, csv_message, table
from oed_sysid import Channels, Input, Output, Record, load_problem, read_csv
from oed_sysid.cli import BAD_INPUT, DONE, main
from oed_sysid.errors import DataError, ProblemError, UnitWarning, closest
from oed_sysid.text import csv_table
from oed_sysid.text.csv_table import Table, read_table, write_table

HEADER = "t [s];theta [rad];z [m]"


def read(tmp_path: Path, *lines: str, encoding: str = "utf-8", end: str = "\n") -> Table:
    """Write lines to a file and read them as a table."""
    path = tmp_path / "dive.csv"
    path.write_bytes(end.join(lines).encode(encoding))
    return read_table(path)


@pytest.mark.parametrize("delimiter", [";", "\t", ","])
def test_delimiters_and_gaps(tmp_path: Path, delimiter: str) -> None:
    """Semicolon, tab and comma delimit; empty cells and nan are gaps."""
    lines = (HEADER, "0;1.5;", "1;;2.5", ";nan;3", "3; ;")
    table = read(tmp_path, *(line.replace(";", delimiter) for line in lines))
    nan = np.nan
    expected = [[0, 1.5, nan], [1, nan, 2.5], [nan, nan, 3], [3, nan, nan]]
    np.testing.assert_array_equal(table.values, expected)
    assert table.headers == ("t [s]", "theta [rad]", "z [m]")


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_decimal_comma(tmp_path: Path, delimiter: str) -> None:
    """Where the comma does not delimit it is the decimal mark, also among quotes."""
    lines = (HEADER, "0;1,5;2", '1;"-2,5e1";')
    table = read(tmp_path, *(line.replace(";", delimiter) for line in lines))
    np.testing.assert_array_equal(table.values, [[0, 1.5, 2], [1, -25.0, np.nan]])


def test_row_numbers(tmp_path: Path) -> None:
    """Rows are counted as an editor counts them, with comments and blank lines."""
    table = read(tmp_path, "# from the logger", HEADER, "", "0;1;2", "# dropout", "1;1;2")
    np.testing.assert_array_equal(table.row_numbers, [4, 6])


def test_written_numbers_read_back_exactly(tmp_path: Path) -> None:
    """Every double survives, and so do gaps and a comma in a header."""
    values = np.random.default_rng(0).normal(size=(50, 3)) * [1e-300, 1.0, 1e300]
    values[4, 1] = np.nan
    write_table(tmp_path / "a.csv", ["a", "b, corrected", "c"], values)
    table = read_table(tmp_path / "a.csv")
    np.testing.assert_array_equal(table.values, values)
    assert table.headers[1] == "b, corrected"


CELLS = (
    "0",
    "1.5",
    "-2e-3",
    "+7",
    ".5",
    "5.",
    "",
    " ",
    "nan",
    "NA",
    "null",
    " 1",
    "2 ",
    "1e400",
    "inf",
)
ODD = ("x", "1,5", "1 2", "0x1F", "1_0", "--1", "1e", '"3"', "#", "\u0663", "1.2.3", "12:00:01")


@pytest.mark.parametrize("seed", [0, 1, 2, *slow(*range(3, 8))])
def test_read_in_blocks_as_cell_by_cell(
    tmp_path: Path, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the parser of blocks accepts is what the careful reader makes of the same file."""
    rng = np.random.default_rng(seed)
    monkeypatch.setattr(csv_table, "_BLOCK", 64)
    accepted = 0
    for _ in range(120):
        delimiter, end = rng.choice([",", ";", "\t"]), rng.choice(["\n", "\r\n"])
        n_columns, n_rows = rng.integers(1, 5), int(rng.integers(1, 30))
        table = [list(rng.choice(CELLS, n_columns)) for _ in range(n_rows)]
        kinds = rng.choice(4, n_columns, p=[0.7, 0.15, 0.1, 0.05])
        for number, row in enumerate(table):
            row[:] = [
                {1: f"12:00:{number:02d}.5", 2: "AUTO", 3: str(number)}.get(kind, cell)
                for kind, cell in zip(kinds, row, strict=True)
            ]
        if rng.random() < 0.3:
            table[rng.integers(n_rows)][rng.integers(n_columns)] = str(rng.choice(ODD))
        close = delimiter if rng.random() < 0.2 else ""
        lines = [*([str(h) for h in ("# remark", "")] * int(rng.integers(2)))]
        lines += [delimiter.join(f"c{i} [m]" for i in range(n_columns)) + close]
        lines += [delimiter.join(row) + close for row in table]
        path = tmp_path / "log.csv"
        path.write_bytes((end.join(lines) + end * int(rng.integers(3))).encode())
        quick = csv_table._quick(path, True)
        if quick is None:
            continue
        accepted += 1
        slow = csv_table._cell_by_cell(path, True)
        np.testing.assert_array_equal(quick.values, slow.values)
        np.testing.assert_array_equal(quick.row_numbers, slow.row_numbers)
        assert (quick.headers, quick.stamps, quick.faults) == (
            slow.headers,
            slow.stamps,
            slow.faults,
        )
    assert accepted > 12


SHIP = Channels((Input("delta", "rad"),), (Output("psi", "rad"), Output("r", "rad/s")))
HEADER_WORDS = "t [s],delta [rad],psi [rad]"


def rows(n: int = 12) -> list[str]:
    """Rows of a good log: t, delta, psi."""
    return [f"{0.5 * i},{0.1 * (i % 5 > 2):g},{0.01 * i:g}" for i in range(n)]


def written(folder: Path, lines: list[str], header: str = HEADER_WORDS) -> Path:
    """A log in a file."""
    return bad_input.written(folder / "log.csv", "\n".join([header, *lines]) + "\n")


def with_row(index: int, text: str) -> list[str]:
    """Good rows, one of them another."""
    return [*rows()[:index], text, *rows()[index + 1 :]]


def test_a_row_that_is_there_twice_is_told_from_a_time_that_repeats(tmp_path: Path) -> None:
    """A logger that wrote a row twice is another fault than two rows of one time."""
    for lines, words in (
        ([*rows()[:5], rows()[4], *rows()[5:]], "Row 7 of log.csv repeats the row before (time 2)"),
        (with_row(5, "2,0.1,0.2"), "Row 7 of log.csv: time 2 repeats that of the row before"),
    ):
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
    record = read_csv(written(tmp_path, rows(), f"# {HEADER_WORDS}"), SHIP)[0]
    assert record.n_samples == 12
    assert record.output("psi")[3] == 0.03
    with pytest.raises(DataError, match="holds numbers, not headers"):
        read_csv(written(tmp_path, rows(), "# trial, calm water, north"), SHIP)


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
    path = written(tmp_path, [f"{row},0.1" for row in rows()], f"{HEADER_WORDS},tehta [rad]")
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
        line = ["rank", "nomoto_sparse_heading", milliseconds(tmp_path, unit), *option, "--quiet"]
        results.append(told(tmp_path, line)["ranking"])
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


def read_of_csv(folder: Path, content: str | bytes) -> tuple[Record, str]:
    """The record in a file, and what was noted about it."""
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        record = read_csv(bad_input.written(folder / "log.csv", content), CHANNELS)[0]
    return record, " ".join(str(one.message) for one in noted)


@pytest.mark.parametrize(
    ("content", "words"), [one[1:] for one in REFUSED], ids=[one[0] for one in REFUSED]
)
def test_refused_in_its_own_words(
    tmp_path: Path, content: str | bytes, words: tuple[str, ...]
) -> None:
    """A file that cannot be read safely is refused, and the message names culprit and remedy."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(DataError) as caught:
            read_csv(bad_input.written(tmp_path / "log.csv", content), CHANNELS)
    message = str(caught.value)
    for word in words:
        assert word in message
    assert len(message) < 1000


@pytest.mark.parametrize(
    ("content", "words"), [one[1:] for one in NOTED], ids=[one[0] for one in NOTED]
)
def test_read_and_noted(tmp_path: Path, content: str | bytes, words: tuple[str, ...]) -> None:
    """What can be read safely is read, and what was made of it is said."""
    record, noted = read_of_csv(tmp_path, content)
    assert record.n_samples == 12
    for word in words:
        assert word in noted


@pytest.mark.parametrize("content", [one[1] for one in READ], ids=[one[0] for one in READ])
def test_read_as_the_good_file(tmp_path: Path, content: str | bytes) -> None:
    """Another spelling of the same numbers gives the same record, without a note."""
    good, _ = read_of_csv(tmp_path, GOOD)
    record, noted = read_of_csv(tmp_path, content)
    assert record.content_hash == good.content_hash
    assert noted == ""


@pytest.mark.parametrize(("headers", "found"), [("Datum", 1), ("logged,received", 2)])
def test_dates_are_times_whatever_their_column_is_called(tmp_path, headers, found) -> None:
    """Where no column is called time, one of dates is it; of two neither is."""
    dates = [f"2024-05-31T12:00:{s:02d}Z" for s in range(12)]
    rows = [f"{','.join([date] * found)},0,{0.01 * i}" for i, date in enumerate(dates)]
    path = written(tmp_path, rows, f"{headers},delta [rad],psi [rad]")
    if found == 1:
        with pytest.warns(UserWarning, match="times of a clock"):
            assert read_csv(path, SHIP)[0].duration == 11.0
    else:
        with pytest.raises(DataError):
            read_csv(path, SHIP)


def test_clocks_give_the_same_times(tmp_path: Path) -> None:
    """Times of every clock of the catalogue are those of the good file, from zero."""
    good, _ = read_of_csv(tmp_path, GOOD)
    clocks = [one for one in NOTED if "1970" in one[0] or "time" in one[0]]
    assert len(clocks) >= 6
    for _, content, _ in clocks:
        record, _ = read_of_csv(tmp_path, content)
        np.testing.assert_allclose(record.times, good.times, atol=1e-6)


def test_page_of_errors_is_current() -> None:
    """docs/errors.md holds every kind of the catalogues, and of files the very messages."""
    page = PAGE.read_text(encoding="utf-8")
    rows = table((kind, csv_message(content)) for kind, content, _ in NOTED_AND_REFUSED)
    assert rows in page, "run: python -m benchmarks.bad_input --write"
    for kind, _, _ in FOLDERS:
        assert f"| {kind} |" in page


@pytest.mark.parametrize("marks", [",.", ";,"], ids=["point", "comma"])
def test_fast_reader_gives_the_digits_of_the_other(tmp_path, monkeypatch, marks: str) -> None:
    """Many rows, with gaps and words for gaps, are the same bits with and without pyarrow."""
    rng = np.random.default_rng(0)
    values = rng.standard_normal((40_000, 3)) * 10.0 ** rng.integers(-300, 300, (40_000, 3))
    texts = np.array([repr(value) for value in values.ravel().tolist()]).reshape(values.shape)
    texts[rng.random(texts.shape) < 0.01] = ""
    texts[-5:, 2] = "NaN"
    lines = [f"{0.1 * k:.1f},{','.join(row)}" for k, row in enumerate(texts)]
    text = "\n".join(["t [s],u [m/s],v [m/s],w [m/s]", *lines, ""])
    file = tmp_path / "long.csv"
    file.write_text(text.translate(str.maketrans(",.", ";,")) if marks == ";," else text)
    pytest.importorskip("pyarrow")
    quick = csv_table.read_table(file)
    monkeypatch.setattr(csv_table, "_arrow", lambda: None)
    assert np.array_equal(quick.values, csv_table.read_table(file).values, equal_nan=True)
    kept = np.array([float(text or "nan") for text in texts.ravel()]).reshape(texts.shape)
    assert np.array_equal(quick.values[:, 1:], kept, equal_nan=True)


def test_a_shaft_turns_as_fast_as_it_likes(tmp_path: Path) -> None:
    """The speed of a shaft is no rate of a vehicle, be it measured; a yaw rate so high is noted."""
    channels = Channels((), (Output("n", "rad/s"), Output("r", "rad/s")))
    noted = []
    for speeds in ("81.5,0.1", "0.1,81.5"):
        lines = ["t [s],n [rad/s],r [rad/s]", *(f"{k},{speeds}" for k in range(12))]
        path = tmp_path / "bench.csv"
        path.write_text("\n".join(lines))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            read_csv(path, channels)
        noted.append([str(one.message) for one in caught if "no vehicle" in str(one.message)])
    assert noted[0] == []
    assert "r [rad/s]" in noted[1][0]


def test_units_in_a_line_of_their_own_keep_the_delimiter(tmp_path: Path) -> None:
    """The header that is proposed can be pasted: it keeps the delimiter, without empty units."""
    with pytest.raises(DataError) as caught:
        read(tmp_path, "Datum;Kurs;Fahrt", ";°;kn", "1;2;3")
    assert "'Datum;Kurs [°];Fahrt [kn]'" in str(caught.value)
