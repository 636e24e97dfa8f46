"""One grammar for all commands: files, records to judge with, limits, quiet, pictures, examples."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import matplotlib.image
import pytest
import typer
from commands import told
from marks import slow
from plain_pages import plain_pages  # noqa: F401
from test_walks import mapping_of, write_log

from oed_sysid import check, list_problems, load_problem, new_problem, read_csv
from oed_sysid.cli import BAD_INPUT, DONE, main, terminal
from oed_sysid.cli.application import app
from oed_sysid.cli.tasks import _round
from oed_sysid.cli.terminal import Shown
from oed_sysid.errors import DataError
from oed_sysid.likelihood.gauss_newton import Progress
from oed_sysid.results import figure_check

PROBLEM = "remus_diving_plane"
# Fewer equations: what a command prints and draws is there sooner.
TANKER = "online_ship"


def commands() -> dict[str, object]:
    """Every command with its words, ``benchmark estimators`` included."""
    found = {}
    for name, command in typer.main.get_command(app).commands.items():
        inner = getattr(command, "commands", None)
        if inner:
            found |= {f"{name} {word}": one for word, one in inner.items()}
        else:
            found[name] = command
    return found


def examples() -> list[tuple[str, str]]:
    """Name and line of every example in a help text."""
    lines = []
    for name, command in commands().items():
        text = re.sub(r"\s*\n\s*(?=[^\n])", " ", command.help.replace("\n\n", "\f"))
        lines += [(name, one) for one in re.findall(r"Example\[/bold\]: ([^\f]*)", text)]
    return lines


# What does not end within seconds.
LONG = (
    *("check", "report", "design", "programme", "campaign", "diagnose", "improve", "benchmark"),
    *("compare", "fit", "reduce", "import", "watch"),
)


@pytest.fixture(name="dives", scope="module")
def _dives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three short records of an AUV, a saved fit of two of them, and two records of a tanker."""
    folder = tmp_path_factory.mktemp("dives")
    line = ["simulate", PROBLEM, "--out", str(folder / "runs"), "--experiment"]
    names = ("zigzag_5_5", "zigzag_10_10", "steps")
    assert main([*line, *names]) == DONE
    for number, name in enumerate(names, start=1):
        lines = (folder / "runs" / f"{name}.csv").read_text().splitlines(keepends=True)
        (folder / f"dive_{number}.csv").write_text("".join(lines[:401]))
    assert main(["simulate", TANKER, "--out", str(folder / "runs")]) == DONE
    for number, name in enumerate(("zigzag_5_5", "zigzag_10_10"), start=1):
        shutil.copy(folder / "runs" / f"{name}.csv", folder / f"turn_{number}.csv")
    files = [str(folder / f"dive_{number}.csv") for number in (1, 2)]
    assert main(["fit", PROBLEM, *files, "--save", str(folder / "fit.json")]) == DONE
    shutil.copy(folder / "fit.json", folder / "better.json")
    return folder


def test_every_command_has_examples() -> None:
    """Each help text shows at least one line, which names its own command."""
    shown = examples()
    assert {name for name, _ in shown} == set(commands())
    for name, line in shown:
        assert line.startswith(f"oed-sysid {name} "), line


@pytest.mark.parametrize(
    "line",
    [
        pytest.param(line, marks=pytest.mark.slow if name.split()[0] in LONG else ())
        for name, line in examples()
    ],
)
def test_example_runs(
    line: str, dives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """Every example of a help text ends well where the files that it names exist."""
    started = []
    monkeypatch.setattr("oed_sysid.app.launch.start", lambda *given, **_: started.append(given))
    for file in dives.glob("*.*"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    if " import " in line:
        folder = new_problem(tmp_path / "my_ship", template="ship")
        shutil.copy(min((folder / "data").glob("*.csv")), "trial.csv")
        write_log("ship", tmp_path)
        Path("ship.toml").write_text(mapping_of("ship"))
    assert main(shlex.split(line)[1:]) == DONE
    assert capsys.readouterr().out.strip() or started == [(PROBLEM,)]
    for option in ("--out", "--html", "--save"):
        if option in shlex.split(line):
            words = shlex.split(line)
            assert Path(words[words.index(option) + 1]).exists()


def test_older_words_mean_the_same(dives: Path, tmp_path: Path, capsys) -> None:
    """--train, --test and --records give the numbers of the present words, and are not shown."""
    one, two = (str(dives / f"turn_{number}.csv") for number in (1, 2))
    found = []
    for given in (["--train", one, "--test", two], [one, "--validate", two]):
        found.append(told(tmp_path, ["compare", TANKER, *given])["models"])
    assert found[0] == found[1]
    capsys.readouterr()
    for command in ("compare", "improve", "diagnose", "fit", "report", "rank", "check"):
        assert main([command, "--help"]) == DONE
        shown = capsys.readouterr().out
        assert not re.search(r"--(train|test|records)\b", shown)


def test_fit_judges_with_validation_records(dives: Path, tmp_path: Path, capsys) -> None:
    """`fit --validate` predicts other records, and refuses those that it has learnt from."""
    one, two, three = (str(dives / f"dive_{number}.csv") for number in (1, 2, 3))
    (model,) = told(tmp_path, ["fit", PROBLEM, one, two, "--validate", three])["validation"][
        "models"
    ]
    assert 0.9 < model["relative"] < 1.1
    assert f"{model['relative']:.3g} × noise" in capsys.readouterr().out.splitlines()[0]
    assert main(["fit", PROBLEM, one, two, "--validate", two]) == BAD_INPUT


def assert_one_line(capfd) -> None:  # type: ignore[no-untyped-def]
    """One line was printed and, but for a compilation, nothing on standard error."""
    printed = capfd.readouterr()
    assert len(printed.out.splitlines()) == 1
    assert not [text for text in printed.err.splitlines() if "compiling" not in text]


@pytest.mark.parametrize(
    "line",
    [
        "problems",
        "new made",
        "export fit.json --as python --out model.py",
        *slow(f"problems {PROBLEM}"),
    ],
)
def test_quiet_is_one_line(line: str, dives: Path, monkeypatch, capfd) -> None:
    """With --quiet a command prints its answer in one line and nothing on standard error."""
    monkeypatch.chdir(dives)
    assert main([*line.split(), "--quiet"]) == DONE
    assert_one_line(capfd)
    shutil.rmtree(dives / "made", ignore_errors=True)


@pytest.mark.parametrize(
    "line",
    [
        f"simulate {TANKER} --experiment zigzag_5_5 --out one.csv",
        f"check {TANKER} turn_1.csv",
        f"rank {TANKER} turn_1.csv",
        f"fit {TANKER} turn_1.csv --validate turn_2.csv",
        *slow(
            f"fit {TANKER} turn_1.csv",
            f"compare {TANKER} turn_1.csv --validate turn_2.csv",
            "report fit.json --validate dive_3.csv",
        ),
    ],
)
def test_picture_of_a_result(line: str, dives: Path, monkeypatch, capfd) -> None:
    """--picture draws the result of a command, never a blank page; --quiet leaves one line."""
    monkeypatch.chdir(dives)
    picture = dives / "result.png"
    picture.unlink(missing_ok=True)
    assert main([*line.split(), "--picture", str(picture), "--quiet"]) == DONE
    assert_one_line(capfd)
    pixels = matplotlib.image.imread(picture)[..., :3]
    assert pixels.shape[0] > 200
    assert (pixels < 0.9).any(axis=2).mean() > 0.01


def test_a_log_that_no_equation_judges_is_drawn_itself(dives: Path, monkeypatch, capfd) -> None:
    """Where a check has no residuals its picture is the log; in Python it is an error in words."""
    monkeypatch.chdir(dives)
    name, picture = "nomoto_sparse_heading", dives / "log.png"
    line = f"simulate {name} --experiment zigzag_15_15 --out heading.csv"
    assert main(line.split()) == DONE
    assert main(f"check {name} heading.csv --picture {picture}".split()) == DONE
    assert picture.stat().st_size > 10_000
    problem = load_problem(name)
    found = check(read_csv(dives / "heading.csv", problem.model.channels), problem)
    with pytest.raises(DataError, match="figure_record"):
        figure_check(found)


def test_every_result_can_be_drawn_and_silenced() -> None:
    """--quiet belongs to every command, --picture to all whose result is more than text."""
    words = {name: {w for p in one.params for w in p.opts} for name, one in commands().items()}
    assert all("--quiet" in some for some in words.values())
    without = {name for name, some in words.items() if "--picture" not in some}
    plain = {"problems", "new", "export", "app", "campaign", "watch", "benchmark missing-physics"}
    assert without <= plain
    for name in ("fit", "compare", "improve", "report", "check"):
        assert "--validate" in words[name]


# -- limits ------------------------------------------------------------------------------


def test_limits_of_a_problem_are_options(capsys) -> None:
    """`design PROBLEM --help` lists the limits of that vehicle, with those that hold now."""
    assert main(["design", "auv_diving_plane", "--help"]) == DONE
    shown = capsys.readouterr().out
    for word in ("--max-fin", "--max-fin-rate", "--max-pitch", "--min-depth", "--depth"):
        assert re.search(rf"{word}\s", shown), word
    assert "now ±5" in shown
    assert "--max-rudder" not in shown
    assert main(["design", "online_ship", "--help"]) == DONE
    shown = capsys.readouterr().out
    assert "--max-rudder" in shown
    assert "--min-depth" not in shown
    assert main(["fit", "auv_diving_plane", "--help"]) == DONE
    assert "--min-depth" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "limit"),
    [
        (["--max-fin", "10"], "max:fin=10"),
        (["--max-fin=10deg"], "max:fin=10deg"),
        (["--max-delta_s", "10"], "max:delta_s=10"),
        (["--max-delta-s", "10"], "max:delta-s=10"),
        (["--depth", "80:120"], "depth=80:120"),
        (["--pitch=-20:15"], "pitch=-20:15"),
        (["--min-depth", "80", "--limit", "u=1:2"], "min:depth=80"),
    ],
)
def test_limits_are_parsed_as_options(given: list[str], limit: str) -> None:
    """An option of a limit is one value of --limit, wherever it stands on the line."""
    command = commands()["design"]
    for line in (["auv_diving_plane", *given], [*given, "--seed", "1"]):
        if line[0].startswith("-"):
            line = ["auv_diving_plane", *line]
        context = command.make_context("design", list(line))
        assert limit in context.params["limit"]
        assert not [name for name in context.params if name.startswith("limit_")]


# -- the shell ---------------------------------------------------------------------------


def test_shell_completes_commands_problems_and_choices(monkeypatch, capsys) -> None:
    """A command, the name of a shipped problem, and the word of a choice are completed."""
    monkeypatch.setenv("_OED_SYSID_COMPLETE", "complete_bash")

    def complete(line: str) -> list[str]:
        """What the shell offers after a line."""
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
        main([])
        return capsys.readouterr().out.split()

    names = [name for name in list_problems() if name.startswith("remus")]
    assert complete("oed-sysid fit remus") == names
    assert complete("oed-sysid design online_ship --effort th") == ["thorough"]
    # As the shell asks, in a process of its own.
    monkeypatch.setenv("COMP_WORDS", "oed-sysid imp")
    monkeypatch.setenv("COMP_CWORD", "1")
    asked = [sys.executable, "-m", "oed_sysid.cli"]
    done = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert sorted(done.stdout.split()) == ["import", "improve"]


# -- progress ----------------------------------------------------------------------------


def test_time_left_of_a_fit_follows_its_convergence() -> None:
    """A tenfold fall of the promised decrease per second gives the seconds down to 1e-6."""
    now = [0.0]
    shown = Shown("fitting", clock=lambda: now[0])
    for iteration in range(1, 5):
        shown.iteration(Progress(iteration, 10.0, 0.0, 10.0 ** (3 - iteration)))
        now[0] += 1.0
    # At 3 s the promise was 0.1: five more decades, a second each; that was a second ago.
    assert "(4 s, about 4 s left)" in shown.line
    shown.say("predicting")
    assert shown.line == "Predicting (4 s)"
    shown.share(0.2, at_most=True)
    assert shown.line == "Predicting (4 s, about 16 s left, or less)"
    now[0] += 20.0
    assert shown.line == "Predicting (24 s, time left not known)"


def test_progress_in_a_pipe_is_plain_lines(monkeypatch, capsys) -> None:
    """Without a terminal progress is lines on standard error, none for what is quick."""
    monkeypatch.setattr(terminal, "PATIENCE", 0.05)
    with terminal.progress("Quick"):
        pass
    assert capsys.readouterr().err == ""
    with terminal.progress("Slow") as shown:
        shown.left(60.0)
        for _ in range(100):
            time.sleep(0.02)
            if capsys.readouterr().err.count("left)\n") >= 1:
                break
        else:
            pytest.fail("nothing was said")


def test_a_search_that_begins_again_is_timed_anew() -> None:
    """A pass of 8 rounds takes 10 s, the next 40 s; of neither is it said that it is the last."""
    now, left = [0.0], []
    show = Shown("Designing", clock=lambda: now[0], told=lambda _, seconds: left.append(seconds))
    for seconds in (10.0, 40.0):
        for number in range(8):
            now[0] += seconds / 8
            show.share((number + 1) / 8, at_most=True, of="this pass")
            if number == 0 and seconds == 40.0:
                # What the pass before took tells nothing of this one.
                assert show.remaining == ""
            if number == 3:
                assert left[-1] == pytest.approx(seconds / 2)
                assert show.remaining == f"about {seconds / 2:.0f} s left of this pass, or less"
        now[0] += 5.0


def test_rounds_bound_the_time_of_a_search() -> None:
    """A fit of 7 s is one of six parts of a search of at most four rounds; so is each round."""
    now, left = [10.0], []
    show = Shown("Ranking", clock=lambda: now[0], told=lambda _, seconds: left.append(seconds))
    _round(show, 4, "fitting the nominal model")
    assert left[-1] is None
    for words, seconds in (("ranking, round 1", 35.0), ("ranking, round 2", 28.0)):
        now[0] += 7.0
        _round(show, 4, words)
        assert left[-1] == pytest.approx(seconds)
    now[0] += 7.0
    assert show.remaining == "about 21 s left, or less"
    now[0] += 30.0
    show.say("ranking, round 2: still")
    assert left[-1] is None
    # What ended early leaves this and no rounds.
    now[0] += 9.0
    _round(show, 4, "locating where the nominal model fails")
    assert left[-1] == pytest.approx(60.0 / 5)
    _round(show, 4, "fits and errors of every step")
    assert left[-1] == pytest.approx(60.0 / 5)


@pytest.mark.parametrize("given", ["problems online_ship --json told.json", *slow("fit --help")])
def test_closed_pipe_is_no_failure(given: str, tmp_path: Path) -> None:
    """A reader that stops, as `head` does, changes neither the exit code nor what is written."""
    ours, theirs = os.pipe()
    os.close(ours)
    line = [sys.executable, "-m", "oed_sysid.cli", *given.split()]
    done = subprocess.run(line, stdout=theirs, stderr=subprocess.PIPE, cwd=tmp_path)
    os.close(theirs)
    told = tmp_path / "told.json"
    written = given.endswith(told.name)
    assert (done.returncode, done.stderr) == (0, b"Written: told.json\n" * written)
    assert not written or json.loads(told.read_text())["name"] == "online_ship"


def test_json_on_standard_output_stands_there_alone(capsys) -> None:
    """`--json -` leaves standard output to the numbers; the words go to standard error."""
    assert main(["problems", "online_ship", "--json", "-"]) == DONE
    printed = capsys.readouterr()
    assert json.loads(printed.out)["name"] == "online_ship"
    assert "Equations of motion" in printed.err


def test_tables_as_latex(dives: Path, capsys) -> None:
    """`--as latex` prints the tables of a report, one row of LaTeX per row."""
    line = ["rank", "nomoto_sparse_heading", "--quiet", "--as", "latex"]
    assert main(line) == DONE
    said = capsys.readouterr().out
    assert said.count(r"\begin{tabular}") == said.count(r"\end{tabular}") > 0
    assert main([*line[:-1], "word"]) == BAD_INPUT
