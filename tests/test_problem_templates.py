"""Starter folders of every kind of vehicle, and from a log."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from oed_sysid.cli import DONE, main
from oed_sysid.design import DOptimal, Search, Trial, design_experiment
from oed_sysid.errors import ProblemError
from oed_sysid.evidence.improve import improve
from oed_sysid.experiments.problem import load_problem, new_problem
from oed_sysid.experiments.simulation import simulate
from oed_sysid.experiments.starter import TEMPLATES
from oed_sysid.likelihood.multiple_shooting import MultipleShooting

# One command of each to design, the others held, and a start.
DESIGNED: dict[str, tuple[str, dict[str, float], dict[str, float]]] = {
    "ship": ("rudder", {"thrust": 3.56e5}, {"u": 7.7}),
    "auv": ("dr", {"ds": 0.0, "T": 8.0}, {"u": 1.5, "z": 20.0}),
    "usv": ("n_port", {"n_starboard": 60.0}, {"u": 1.0}),
    "torpedo": ("stern", {"thrust": 9.0}, {"u": 1.5, "z": 10.0}),
    "sailboat": ("rudder", {"wind": 6.0, "angle": 1.4}, {"u": 1.0}),
}
VEHICLES = [name for name, kind in TEMPLATES.items() if kind]


@pytest.mark.slow
@pytest.mark.parametrize("template", VEHICLES)
def test_template_fits_improves_and_designs(tmp_path: Path, template: str) -> None:
    """A fresh folder fits its own data, finds what is hidden, and a better run can be designed."""
    folder = new_problem(tmp_path / "mine", template=template)
    problem, kind = load_problem(folder), TEMPLATES[template]
    assert f"`{kind['test']}`" in (folder / "README.md").read_text()
    train, test = problem.data().split(test=[kind["test"]])
    few = [problem.effect(kind["hidden"])]
    few += [e for e in problem.effects if e.name != kind["hidden"] and e.stage == "force"][:4]
    found = improve(problem.model, train, test, candidates=few)
    assert kind["hidden"] in found.model.effect_names
    fit = MultipleShooting().fit(problem.model + problem.effect(kind["hidden"]), train)
    assert fit.status.ok
    for name in fit.names:
        low, high = fit.interval(name, 0.9999)
        expected = problem.truth.get(name, problem.model.values.get(name))
        assert low < expected < high, name
    command, held, start = DESIGNED[template]
    design = design_experiment(
        fit.model,
        Trial(
            limits=problem.limits,
            duration=20.0,
            sample_time=0.5,
            inputs=[command],
            constants=held,
            neutral={command: 60.0} if template == "usv" else None,
            initial=start,
        ),
        criterion=DOptimal(),
        rng=np.random.default_rng(2),
        search=Search(n_starts=1, n_candidates=12, n_steps=5),
    )
    record = simulate(fit.model, design.experiment, noise=False)
    low, high = problem.limits.inputs[command]
    assert low - 1e-9 <= record.input(command).min() <= record.input(command).max() <= high + 1e-9
    assert np.ptp(record.input(command)) > 0.1 * (high - low)


@pytest.mark.parametrize("template", VEHICLES)
def test_templates_read_as_programs(template: str) -> None:
    """Every template compiles once its names are filled in, and names what it hides."""
    text = files("oed_sysid.experiments").joinpath("starter_files", f"{template}.txt").read_text()
    compile(text.replace("$name", "mine").replace("$title", "Mine"), template, "exec")
    assert f'"E_{TEMPLATES[template]["hidden"]}"' in text


def test_unknown_template_is_refused(tmp_path: Path) -> None:
    """A kind of vehicle that has no template is answered with those that have."""
    with pytest.raises(ProblemError, match="Choose generic, ship, auv"):
        new_problem(tmp_path / "boat", template="hovercraft")
    assert not (tmp_path / "boat").exists()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log in degrees and knots of a boat that answers linearly, with an odd header."""
    rng = np.random.default_rng(4)
    times = np.arange(0.0, 120.0, 0.2)
    rudder = np.repeat(rng.uniform(-0.3, 0.3, 60), 10)
    r, psi = np.zeros(len(times)), np.zeros(len(times))
    for k in range(len(times) - 1):
        r[k + 1] = r[k] + 0.2 * (0.3 * rudder[k] - 0.8 * r[k])
        psi[k + 1] = psi[k] + 0.2 * r[k]
    rows = np.column_stack([times, np.degrees(rudder), np.degrees(psi), np.degrees(r)])
    rows[:, 2:] += 0.05 * rng.standard_normal((len(times), 2))
    file = tmp_path / "sea trial.csv"
    header = "t [s],rudder angle [deg],psi [deg],r [deg/s]"
    np.savetxt(file, rows, delimiter=",", header=header, comments="", fmt="%.6g")
    return file


def test_problem_from_a_log(tmp_path: Path, log: Path) -> None:
    """Channels, units and a kinematic link come from the log, and the first model fits it."""
    folder = new_problem(tmp_path / "my_boat", log=log)
    problem = load_problem(folder)
    assert problem.channels.input_names == ("rudder_angle",)
    assert [output.unit for output in problem.model.outputs] == ["rad", "rad/s"]
    assert problem.model.kinematics["psi"] == "r"
    fit = MultipleShooting().fit(problem.model, problem.data())
    assert fit.status.ok
    # The log's difference equation, read as the exact answer to a held command.
    decay = np.log(1 - 0.2 * 0.8) / 0.2
    assert fit.values["r_r"] == pytest.approx(decay, rel=0.02)
    assert fit.values["r_rudder_angle"] == pytest.approx(-0.3 / 0.8 * decay, rel=0.02)


def test_command_takes_template_and_log(tmp_path: Path, log: Path, capsys) -> None:
    """oed-sysid new --from reads a log; commands can be named where names say nothing."""
    made = tmp_path / "boat"
    arguments = ["new", str(made), "--from", str(log), "--input", "rudder angle"]
    assert main(arguments) == DONE
    assert (made / "data" / "sea trial.csv").exists()
    text = log.read_text().replace("rudder angle", "a1")
    other = tmp_path / "other.csv"
    other.write_text(text)
    with pytest.raises(ProblemError, match="looks like a command"):
        new_problem(tmp_path / "third", log=other)
