"""The command line as a user meets it: results, words, exit codes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from oed_sysid.cli import BAD_INPUT, DONE, NO_RESULT, UNEXPECTED, main
from oed_sysid.cli.arguments import spread

NOMOTO = """
from oed_sysid import Experiment, Input, Model, Output, Parameter, Problem, State
from oed_sysid.experiments.manoeuvres import ZigZag

model = Model(
    name="Nomoto",
    states=(State("psi", "rad"), State("r", "rad/s", scale=0.05)),
    inputs=(Input("rudder", "rad"),),
    outputs=(Output("psi", "rad", noise_std=0.003), Output("r", "rad/s", noise_std=0.001)),
    kinematics={"psi": "r", "r": "(K*rudder - r)/T"},
    parameters=(Parameter("K", 0.1, "1/s"), Parameter("T", 8.0, "s", lower=0.1)),
)
experiments = {
    name: Experiment(name, ZigZag("rudder", angle, angle), duration=80.0, sample_time=0.5)
    for name, angle in (("zigzag_10", 0.17), ("zigzag_20", 0.35))
}
problem = Problem("ferry", model, title="A ferry", experiments=experiments)
"""


@pytest.fixture(name="ferry")
def _ferry(tmp_path: Path) -> Path:
    """A user's own problem folder."""
    folder = tmp_path / "ferry"
    folder.mkdir()
    (folder / "problem.py").write_text(NOMOTO)
    return folder


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("--with a b --limit c", "--with a --with b --limit c"),
        ("--with a --with b", "--with a --with b"),
        ("P --with a b --json o x", "P --with a --with b --json o x"),
        ("--with --limit c", "--with --limit c"),
        ("--with a -- P b", "--with a -- P b"),
        ("--with=a b", "--with=a b"),
        ("--with a - b", "--with a --with - --with b"),
        ("P --train a b --json o", "P a b --json o"),
        ("P --train=a b --limit c d", "P a b --limit c --limit d"),
        ("--with a --records b", "--with a b"),
        ("P --with a --test b c", "P --with a --limit b --limit c"),
        ("P --test=a", "P --limit=a"),
    ],
)
def test_values_after_one_option_are_spread(given: str, expected: str) -> None:
    """An option in front of several values is repeated before each, and nothing else changes."""
    older = {"--train": "", "--records": "", "--test": "--limit"}
    assert spread(given.split(), ["--with", "--limit"], older) == expected.split()


def test_simulate_then_fit_recovers_the_model(ferry: Path, tmp_path: Path, capsys) -> None:
    """What `simulate` writes, `fit` reads, and the intervals hold the simulated values."""
    runs, stored = tmp_path / "runs", tmp_path / "results" / "fit.json"
    assert main(["simulate", str(ferry), "--out", str(runs), "--seed", "3"]) == DONE
    files = sorted(str(file) for file in runs.glob("*.csv"))
    assert [Path(file).stem for file in files] == ["zigzag_10", "zigzag_20"]
    capsys.readouterr()
    assert main(["fit", str(ferry), *files, "--json", str(stored)]) == DONE
    printed = capsys.readouterr()
    assert "converged" in printed.out
    assert str(stored) in printed.err
    result = json.loads(stored.read_text())
    assert result["records"] == ["zigzag_10", "zigzag_20"]
    for parameter, truth in zip(result["parameters"], (0.1, 8.0), strict=True):
        assert abs(parameter["value"] - truth) < 5 * parameter["std_error"]
        assert parameter["std_error"] < 0.05 * truth


def test_one_experiment_goes_to_one_file(ferry: Path, tmp_path: Path, capsys) -> None:
    """--out names a file for one experiment and is refused for two, with the way out."""
    file = tmp_path / "one.csv"
    arguments = ["simulate", str(ferry), "--out", str(file)]
    assert main(arguments) == BAD_INPUT
    assert "--experiment" in capsys.readouterr().err
    assert not file.exists()
    assert main([*arguments, "--experiment", "zigzag_20"]) == DONE
    assert file.read_text().startswith("t [s],rudder [rad],psi [rad],r [rad/s]")


def test_problems_lists_and_describes(ferry: Path, tmp_path: Path, capsys) -> None:
    """A problem of the user's own is described with its equations and experiments."""
    stored = tmp_path / "problem.json"
    assert main(["problems", str(ferry), "--json", str(stored)]) == DONE
    printed = capsys.readouterr().out
    assert "r' = (K rudder - r)/T" in printed
    assert "zigzag_20" in printed
    assert json.loads(stored.read_text())["free_parameters"] == ["K", "T"]
    assert main(["problems"]) == DONE
    assert "remus_diving_plane" in capsys.readouterr().out


def test_new_folder_can_be_used_at_once(tmp_path: Path, capsys) -> None:
    """The starter folder is a problem that loads, and an existing one is not overwritten."""
    folder = tmp_path / "my_vehicle"
    assert main(["new", str(folder)]) == DONE
    assert main(["problems", str(folder)]) == DONE
    assert "my_vehicle" in capsys.readouterr().out
    assert main(["new", str(folder)]) == BAD_INPUT


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fit", "nowhere", "a.csv"], "no problem 'nowhere'"),
        (["fit", "{ferry}", "missing.csv"], "missing.csv"),
        (["simulate", "{ferry}", "--experiment", "zigzag_30"], "zigzag_10"),
        (["problems", "{ferry}", "--model", "big"], "no model 'big'"),
        (["problems", "{ferry}", "--json", "{ferry}"], "cannot be written"),
    ],
)
def test_bad_input_is_said_in_words(arguments, words, ferry: Path, capsys) -> None:
    """A mistake gives one sentence on standard error, no traceback and code 2."""
    given = [argument.format(ferry=ferry) for argument in arguments]
    assert main(given) == BAD_INPUT
    printed = capsys.readouterr().err
    assert words in printed
    assert "Traceback" not in printed


def test_wrong_command_line_is_bad_input(capsys) -> None:
    """A missing or unknown argument has the same code as any other bad input."""
    assert main(["fit", "remus_diving_plane"]) == BAD_INPUT
    assert main(["fit", "remus_diving_plane", "a.csv", "--nonsense"]) == BAD_INPUT
    assert "--nonsense" in capsys.readouterr().err


def test_model_that_diverges_is_said(ferry: Path, tmp_path: Path, capsys) -> None:
    """A model that runs off to 1e49 is bad input: its state, when, and what to look for."""
    unstable = NOMOTO.replace("(K*rudder - r)/T", "(K*rudder + r*11)/T")
    (ferry / "problem.py").write_text(unstable)
    out = tmp_path / "runs"
    assert main(["simulate", str(ferry), "--experiment", "zigzag_10", "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "'Nomoto' diverged between t = " in said
    assert "Check signs of damping and stiffness" in said
    assert not list(out.glob("*.csv"))


def test_debug_shows_the_traceback(ferry: Path, capsys) -> None:
    """--debug works at any place and shows where the error arose."""
    assert main(["fit", str(ferry), "--debug", "missing.csv"]) == BAD_INPUT
    assert "Traceback" in capsys.readouterr().err


def test_unexpected_error_tells_how_to_report(ferry: Path, capsys, monkeypatch) -> None:
    """An error that is the program's own fault has its own code and mentions --debug."""

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("broken inside")

    monkeypatch.setattr("oed_sysid.experiments.problem.load_problem", fail)
    assert main(["problems", str(ferry)]) == UNEXPECTED
    printed = capsys.readouterr().err
    assert "broken inside" in printed
    assert "--debug" in printed
    assert "Traceback" not in printed


def test_fit_that_does_not_converge_has_its_own_code(ferry: Path, tmp_path: Path) -> None:
    """A record without any excitation and a hopeless model give no usable result: code 1."""
    text = (ferry / "problem.py").read_text()
    # A growing mode of 1/s cannot follow 80 s of a stable ship from any start state.
    hopeless = text.replace("(K*rudder - r)/T", "(K*rudder - r)/T + 100*r/T + 3*T*r**3")
    file = tmp_path / "one.csv"
    assert main(["simulate", str(ferry), "--experiment", "zigzag_20", "--out", str(file)]) == DONE
    (ferry / "problem.py").write_text(hopeless)
    assert main(["fit", str(ferry), str(file)]) == NO_RESULT


def test_command_line_starts_quickly() -> None:
    """`oed-sysid --help` imports no numerical library."""
    code = (
        "import sys; from oed_sysid.cli import main; main(['--help']); "
        "print([m for m in ('numpy', 'casadi', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip().endswith("[]"), done.stdout + done.stderr


def test_several_experiments_after_one_option(ferry: Path, tmp_path: Path, capsys) -> None:
    """--experiment takes one name or many, and all by default."""
    stored = tmp_path / "rank.json"
    arguments = ["rank", str(ferry), "--json", str(stored), "--experiment"]
    assert main([*arguments, "zigzag_10", "zigzag_20"]) == DONE
    both = json.loads(stored.read_text())["ranking"]
    assert both["runs"] == ["zigzag_10", "zigzag_20"]
    assert main(arguments[:-1]) == DONE
    assert json.loads(stored.read_text())["ranking"] == both
    assert main([*arguments, "zigzag_10"]) == DONE
    one = json.loads(stored.read_text())["ranking"]
    errors = [{row["name"]: row["error"] for row in r["parameters"]} for r in (one, both)]
    # The second zigzag adds information on each parameter.
    assert all(errors[0][name] > errors[1][name] for name in ("K", "T"))


def test_rank_of_records_equals_rank_of_their_experiments(ferry: Path, tmp_path, capsys) -> None:
    """A noise-free record tells as much as the experiment that gave it."""
    file, stored = tmp_path / "zigzag_10.csv", tmp_path / "rank.json"
    simulated = ["simulate", str(ferry), "--experiment", "zigzag_10", "--no-noise"]
    assert main([*simulated, "--out", str(file)]) == DONE
    errors = []
    for runs in ([str(file)], ["--experiment", "zigzag_10"]):
        assert main(["rank", str(ferry), *runs, "--json", str(stored)]) == DONE
        rows = json.loads(stored.read_text())["ranking"]["parameters"]
        errors.append({row["name"]: row["error"] for row in rows})
    assert errors[0] == pytest.approx(errors[1], rel=0.05)
    arguments = ["rank", str(ferry), str(file), "--experiment", "zigzag_10"]
    assert main(arguments) == BAD_INPUT


def test_advice_on_noise_names_the_option(ferry: Path, tmp_path: Path, capsys) -> None:
    """A model whose noise is not known is simulated with the option that its error names."""
    code = NOMOTO.replace(", noise_std=0.003", "").replace(", noise_std=0.001", "")
    (ferry / "problem.py").write_text(code)
    line = ["simulate", str(ferry), "--out", str(tmp_path / "runs")]
    assert main(line) == BAD_INPUT
    assert "--no-noise" in capsys.readouterr().err
    assert main([*line, "--no-noise"]) == DONE
