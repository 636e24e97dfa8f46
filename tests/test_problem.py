"""Problems and starter folders: found, checked, and failing with file and line."""

from __future__ import annotations

import pickle
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from bad_input import folder_of
from motion import small
from vehicles import remus, ship

import oed_sysid
from oed_sysid import Dataset, Experiment, Force, Parameter, Record, improve, simulate
from oed_sysid.cli import DONE, main
from oed_sysid.design import DOptimal, Search, Trial, design_experiment
from oed_sysid.errors import ProblemError
from oed_sysid.evidence.usual import settled
from oed_sysid.experiments import catalogue
from oed_sysid.experiments.problem import Problem, list_problems, load_problem, new_problem
from oed_sysid.experiments.starter import TEMPLATES
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.physics import bodies, diving_plane_effects, sensor_bias, surface_ship_effects

MODEL = small("tug", "r [rad/s] <- rudder [rad]", {"r": "K*rudder - r"}, {"K [1/s]": 0.1}, 0.001)
DRAG = Force("drag", {"r": "-E*r*abs(r)"}, (Parameter("E", 0.0, "1/rad"),))
SOURCE = """\
from oed_sysid import Input, Model, Output, Parameter, Problem, State

model = Model(
    "barge", (State("r", "rad/s"),), (Input("rudder", "rad"),), (Output("r", "rad/s"),),
    {"r": "(rudder/T - r)/T"}, parameters=(Parameter("T", 1.0, "s"),),
)
problem = Problem("barge", model)
"""


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A catalogue with two problems."""
    folder = tmp_path / "catalogue"
    folder_of(folder / "river_barge", SOURCE)
    folder_of(folder / "harbour_tug", SOURCE)
    (folder / "README.md").write_text("no problem")
    monkeypatch.setattr(catalogue, "catalogue_folder", lambda: folder)
    return folder


def test_shipped_problems_are_listed_and_loaded_by_name(shipped: Path) -> None:
    """Names are those of the folders; listing executes nothing."""
    folder_of(shipped / "broken", "raise RuntimeError")
    assert list_problems() == ("broken", "harbour_tug", "river_barge")
    assert load_problem("river_barge").name == "barge"


def test_wheel_comes_before_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Problems inside the package are used where there are any, those beside it otherwise."""
    monkeypatch.setattr(catalogue, "_PACKAGE", tmp_path / "oed_sysid")
    assert catalogue.catalogue_folder() is None
    assert catalogue.list_problems() == ()
    (tmp_path / "problems").mkdir()
    assert catalogue.catalogue_folder() == tmp_path / "problems"
    (tmp_path / "oed_sysid" / "_problems").mkdir(parents=True)
    assert catalogue.catalogue_folder() == tmp_path / "oed_sysid" / "_problems"


def test_own_folder_by_any_kind_of_path(
    tmp_path: Path, shipped: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Path, text, file and a plain word all lead to the user's folder; edits are seen."""
    folder = folder_of(tmp_path / "mine", SOURCE)
    monkeypatch.chdir(tmp_path)
    for given in (folder, str(folder), folder / "problem.py", "mine", "./mine"):
        assert load_problem(given).name == "barge"
    folder_of(folder, SOURCE.replace('Problem("barge"', 'Problem("raft"'))
    assert load_problem(folder).name == "raft"
    assert [path.name for path in folder.iterdir()] == ["problem.py"]


def test_shipped_name_wins_over_a_folder_of_that_name(
    tmp_path: Path, shipped: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A plain word means the shipped problem; './word' means the folder."""
    folder_of(tmp_path / "river_barge", SOURCE.replace('Problem("barge"', 'Problem("mine"'))
    monkeypatch.chdir(tmp_path)
    assert load_problem("river_barge").name == "barge"
    assert load_problem("./river_barge").name == "mine"


def test_unknown_name_gets_near_matches_and_advice(shipped: Path) -> None:
    """The message names the nearest problem, all others, and how to begin one's own."""
    with pytest.raises(ProblemError, match="Did you mean 'river_barge'") as caught:
        load_problem("river_barg")
    assert "harbour_tug, river_barge" in str(caught.value)
    assert "new_problem" in str(caught.value)
    with pytest.raises(ProblemError, match="there is no folder /no/where"):
        load_problem("/no/where")
    with pytest.raises(ProblemError, match="is a file"):
        load_problem(Path(__file__).with_name("published.toml"))


def test_variants_change_what_is_believed() -> None:
    """Another model becomes the default, and candidates it contains are left out."""
    problem = Problem("tug", MODEL, effects=(DRAG,), models={"with_drag": MODEL + DRAG})
    assert problem.variants == ("default", "with_drag")
    other = problem.variant("with_drag")
    assert other.model.effect_names == ("drag",)
    assert other.effects == ()
    assert problem.variant("default") is problem
    with pytest.raises(ProblemError, match="Did you mean 'with_drag'"):
        problem.variant("with_drug")


def test_a_list_of_candidates_leaves_out_what_a_model_lacks() -> None:
    """Errors of logs that there are not are left out and named; what the user wrote is refused."""
    diver = remus()
    blind = replace(diver, outputs=tuple(o for o in diver.outputs if o.name not in ("u", "w")))
    problem = Problem("diver", blind, effects=diving_plane_effects())
    assert set(problem.left_out) == {
        *("bias_u", "bias_w", "scale_u", "scale_w"),
        *("dvl_misalignment", "dvl_lever_arm", "dvl_lag"),
    }
    assert len(problem.effects) + len(problem.left_out) == len(diving_plane_effects())
    assert "left out" in problem.describe()
    assert Problem("diver", diver, effects=diving_plane_effects()).left_out == ()
    with pytest.raises(ProblemError, match="Remove it, or give"):
        Problem("diver", blind, effects=(sensor_bias("log", "u", "m/s", scale=0.1),))


@pytest.mark.parametrize("count", [1, 2])
def test_candidates_of_the_day_need_several_records(count: int) -> None:
    """Current, wind and trim of the list are each record's own too, where there are several."""
    listed = surface_ship_effects()
    model = ship()
    times = np.arange(40.0)
    still = np.zeros((40, 2)), np.zeros((40, len(model.outputs)))
    runs = [Record(str(i), times, *still, model.channels) for i in range(count)]
    found, _ = settled(model, Dataset(runs), listed)
    day = {"current_by_record", "wind_by_record", "rudder_neutral_angle_by_record"}
    assert {e.name for e in listed} - {e.name for e in found} == (day if count == 1 else set())


def test_true_model_holds_values_and_hidden_effects() -> None:
    """The truth names parameters of the model and of candidates; zero means absent."""
    problem = Problem("tug", MODEL, effects=(DRAG,), truth={"K": 0.2, "E": 3.0})
    assert problem.true_model().values == {"K": 0.2, "E": 3.0}
    absent = replace(problem, truth={"K": 0.2, "E": 0.0})
    assert absent.true_model().effect_names == ()
    with pytest.raises(ProblemError, match="not known"):
        Problem("tug", MODEL).true_model()
    with pytest.raises(ProblemError, match="comes without records"):
        problem.data()


def test_parts_by_name() -> None:
    """Effects and experiments are found by name, with a hint where the name is wrong."""
    run = Experiment("run", duration=1.0, constants={"rudder": 0.1})
    problem = Problem("tug", MODEL, effects=(DRAG,), experiments={"run": run})
    assert problem.effect("drag") is DRAG
    assert problem.experiment("run") is run
    with pytest.raises(ProblemError, match="Did you mean 'drag'"):
        problem.effect("drags")
    with pytest.raises(ProblemError, match="It has run"):
        problem.experiment("walk")
    assert "1 parameters to estimate" in problem.describe()
    assert pickle.loads(pickle.dumps(problem)) == problem


def test_starter_folder_works_at_once(tmp_path: Path) -> None:
    """Loaded, its data read and fitted, the hidden effect explains what the model cannot."""
    folder = new_problem(tmp_path / "my ship")
    problem = load_problem(folder)
    assert problem.name == "my_ship"
    assert "# My ship" in (folder / "README.md").read_text()
    train, _ = problem.data().split(test=["turning_circle"])
    better = oed_sysid.MultipleShooting().fit(
        problem.model + problem.effect("yaw_quadratic_damping"), train
    )
    assert better.status.ok
    for name, estimate in zip(better.names, better.estimates, strict=True):
        assert estimate == pytest.approx(problem.truth[name], rel=0.05)


def test_starter_data_is_reproducible(tmp_path: Path) -> None:
    """Two starter folders hold the same numbers."""
    first, second = new_problem(tmp_path / "a"), new_problem(tmp_path / "b")
    for file in sorted((first / "data").iterdir()):
        assert file.read_bytes() == (second / "data" / file.name).read_bytes()


def test_starter_never_overwrites(tmp_path: Path) -> None:
    """A folder in use is left alone."""
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ProblemError, match="not an empty folder"):
        new_problem(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


PARTS = """\
from oed_sysid import Model, Output, Parameter, Problem, State

from .physics import RATE

RATES = (Parameter("a", 1.0, "1/s"),)
tank = Model("tank", (State("z", "m"),), (), (Output("z", "m"),), {"z": RATE}, parameters=RATES)
dial = Model("dial", (State("z", "m"),), (), (Output("level", "m", expression="z"),), {"z": RATE},
             parameters=RATES)
problem = Problem("tank", tank, others={"dial": Problem("tank_dial", dial)})
"""


def test_a_folder_may_have_modules_of_its_own(tmp_path: Path) -> None:
    """`from .physics import ...` works in any folder, and edits are seen when loaded again."""
    folder = tmp_path / "my tank"
    folder.mkdir()
    (folder / "problem.py").write_text(PARTS, encoding="utf-8")
    (folder / "physics.py").write_text('RATE = "-a*z"\n', encoding="utf-8")
    assert load_problem(folder).model.kinematics == {"z": "-a*z"}
    (folder / "physics.py").write_text('RATE = "-0.25*a*z"\n', encoding="utf-8")
    assert load_problem(folder).model.kinematics == {"z": "-0.25*a*z"}


def test_a_variant_may_have_other_channels(tmp_path: Path) -> None:
    """The same system seen through other sensors is found as a variant."""
    folder = tmp_path / "tank"
    folder.mkdir()
    (folder / "problem.py").write_text(PARTS, encoding="utf-8")
    (folder / "physics.py").write_text('RATE = "-a*z"\n', encoding="utf-8")
    assert load_problem(folder).variants == ("default", "dial")
    assert load_problem(folder, variant="dial").channels.output_names == ("level",)
    with pytest.raises(ProblemError, match="It has default, dial"):
        load_problem(folder, variant="glass")


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
            trim={command: 60.0} if template == "usv" else {},
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
    with pytest.raises(ProblemError, match="It has generic, ship, auv"):
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
    fit = MultipleShooting(disturbances="none").fit(problem.model, problem.data())
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


def test_candidates_that_are_left_out_say_what_the_model_lacks() -> None:
    """An optional candidate on an unknown signal goes, and the signal is named."""
    whole = load_problem("remus_6dof")
    odd = Force("odd", {"X": "k*sheet"}, (Parameter("k", 1.0, "N"),), optional=True)
    changed = replace(whole, effects=(*whole.effects, odd))
    assert changed.left_out == ("odd",)
    assert changed.effects == whole.effects
    assert "'sheet'" in changed.lacking
    assert not whole.lacking


def test_names_that_a_module_has_not_are_none_of_it() -> None:
    """What asks whether a name exists gets an answer."""
    assert not hasattr(bodies, "nonsense")
    with pytest.raises(AttributeError, match=r"RigidBody\.fin"):
        _ = bodies.fin
