"""Every mistake that a user can make ends in a sentence that says what to do."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from altered import with_inputs, with_outputs
from bad_input import folder_of
from bad_input.problem_files import REFUSED, SOUND
from yaw_vehicle import NOISE, yaw_data, yaw_model

from oed_sysid import Model, check, diagnose, improve, simulate, turning_circle, usual_effects
from oed_sysid.data.dataset import Dataset, Record, read_csv
from oed_sysid.errors import OedSysidError, ProblemError
from oed_sysid.experiments.definition import faults
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.problem import list_problems, load_problem
from oed_sysid.likelihood.estimator import Solver
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.physics import ExtraState, Force, Parameter
from oed_sysid.physics.channels import Channels, Input, Output, State

DATA = yaw_data(0)
MODEL = yaw_model()
FIT = MultipleShooting(noise=NOISE)


def declared(level: float | None) -> Model:
    """The model with a noise level declared for both outputs."""
    return replace(
        MODEL, outputs=tuple(replace(output, noise_std=level) for output in MODEL.outputs)
    )


def redeclared(level: float | None) -> tuple[Model, Dataset]:
    """Model and data with that declaration."""
    model = declared(level)
    return model, Dataset(replace(record, channels=model.channels) for record in DATA)


def short() -> Dataset:
    """A record with a single measured value more than nothing."""
    times = np.arange(5.0)
    outputs = np.full((5, 2), np.nan)
    outputs[0, 0], outputs[3, 1] = 0.0, 0.01
    return Dataset((Record("short", times, np.ones((5, 1)), outputs, MODEL.channels),))


def other_outputs() -> Dataset:
    """A record that lacks the yaw rate."""
    channels = replace(MODEL, outputs=(Output("psi", "rad"),)).channels
    record = DATA[0]
    return Dataset((Record("a", record.times, record.inputs, record.outputs[:, :1], channels),))


NAN, INF = float("nan"), float("inf")
ERRORS = (Path(__file__).parent.parent / "docs" / "errors.md").read_text(encoding="utf-8")
CHANNELS = Channels((), (Output("y", "m"),))
SIZE = (Parameter("E", 0.0),)

# What a fit is refused with: docs/errors.md has the answers, word by word.
MISTAKES: dict[str, Callable[[], object]] = {
    "noise level zero in the model": lambda: MultipleShooting(noise="given").fit(*redeclared(0.0)),
    "noise level zero in the estimator": lambda: MultipleShooting(noise=[0.0, 1.0]).fit(
        MODEL, DATA
    ),
    "noise level infinite": lambda: MultipleShooting(noise=[1.0, np.inf]).fit(MODEL, DATA),
    "noise level undeclared although insisted upon": lambda: MultipleShooting(noise="given").fit(
        MODEL, DATA
    ),
    "fewer samples than unknowns": lambda: FIT.fit(MODEL, short()),
    "record of another model": lambda: FIT.fit(MODEL, other_outputs()),
    "a record instead of a dataset": lambda: FIT.fit(MODEL, DATA[0]),
    "initial guess of an unknown state": lambda: FIT.fit(
        MODEL, DATA, initial_states=[{"yaw": 0.1}, {}, {}]
    ),
    "one initial guess for three records": lambda: FIT.fit(
        MODEL, DATA, initial_states=[{"psi": 0.1}]
    ),
    "initial guess that is not a number": lambda: FIT.fit(
        MODEL, DATA, initial_states=[{"psi": np.nan}, {}, {}]
    ),
    "too few noise levels": lambda: MultipleShooting(noise=[0.1]).fit(MODEL, DATA),
    "unknown noise option": lambda: MultipleShooting(noise="guess"),
    "unknown loss": lambda: MultipleShooting(loss="cauchy"),
    "unknown start": lambda: MultipleShooting(start="far"),
    "unknown treatment of colour": lambda: MultipleShooting(coloured="yes"),
    "unknown solver": lambda: Solver("snopt"),
    "constraints without IPOPT": lambda: Solver(constraints=("K > 0",)),
    "shooting interval of no length": lambda: MultipleShooting(noise=NOISE, interval=0.0).fit(
        MODEL, DATA
    ),
    "no iteration allowed": lambda: Solver(max_iterations=0),
    "tolerance of zero": lambda: Solver(tolerance=0.0),
    "start value outside its bounds": lambda: Parameter("T", 5.0, lower=6.0),
    "prior without spread": lambda: Parameter("T", 5.0, prior_std=0.0),
}

# What other parts are refused with: the words that its message has.
CASES: dict[str, tuple[Callable[[], object], tuple[str, ...]]] = {
    "limit NaN": (lambda: Limits(inputs={"a": (NAN, 1.0)}), ("expected (lower, upper)",)),
    "limit upside down": (lambda: Limits(signals={"z": (10.0, 2.0)}), ("signal 'z'",)),
    "rate of zero": (lambda: Limits(rates={"a": 0.0}), ("above zero",)),
    "limit as a number": (lambda: Limits(inputs={"a": 3.0}), ("expected (lower, upper)",)),
    "limits as a list": (lambda: Limits(inputs=[1.0]), ("expected a mapping",)),
    "rate NaN": (lambda: Limits(rates={"a": NAN}), ("above zero",)),
    "rate as text": (lambda: Limits(rates={"a": "1"}), ("above zero",)),
    "duration NaN": (lambda: Experiment("a", duration=NAN), ("several samples",)),
    "duration infinite": (lambda: Experiment("a", duration=INF), ("several samples",)),
    "duration as text": (lambda: Experiment("a", duration="5"), ("duration '5'",)),
    "sampled more slowly than it lasts": (
        lambda: Experiment("a", duration=5, sample_time=50),
        ("several samples",),
    ),
    "experiment named by a number": (lambda: Experiment(5, duration=5), ("Give text",)),
    "constant NaN": (lambda: Experiment("a", duration=5, constants={"r": NAN}), ("'r' = nan",)),
    "constant as text": (lambda: Experiment("a", duration=5, constants={"r": "x"}), ("mapping",)),
    "noise below zero": (lambda: Experiment("a", duration=5, noise={"r": -1}), ("'r' = -1",)),
    "manoeuvre as text": (lambda: Experiment("a", "zigzag", duration=5), ("got a str",)),
    "table as a number": (
        lambda: Force("f", {"X": "E*T(u)"}, SIZE, tables={"T": 5}),
        ("expected rows of numbers",),
    ),
    "unit of an added state": (
        lambda: ExtraState("mu", "-mu", "0", "foo"),
        ("Unknown unit 'foo'",),
    ),
    "noise level below zero": (lambda: Output("y", "m", noise_std=-1.0), ("noise_std -1.0",)),
    "noise level NaN": (lambda: Output("y", "m", noise_std=NAN), ("noise_std nan",)),
    "scale of zero": (lambda: State("y", "m", scale=0.0), ("scale 0.0",)),
    "sign of zero": (lambda: Input("y", "m", sign=0.0), ("sign 0.0",)),
    "times as text": (
        lambda: Record("a", ["x"] * 6, [], [1.0] * 6, CHANNELS),
        ("no real numbers",),
    ),
    "complex outputs": (
        lambda: Record("a", range(6), [], [1j] * 6, CHANNELS),
        ("no real numbers",),
    ),
    "ragged outputs": (
        lambda: Record("a", range(6), [], [[1], [2, 3]] * 3, CHANNELS),
        ("no real numbers",),
    ),
    "dataset of text": (lambda: Dataset(("a",)), ("one of these is a str",)),
    "no path": (lambda: read_csv(None, CHANNELS), ("names no files",)),
    "no channels": (lambda: read_csv("a.csv", None), ("expected problem.channels",)),
}


@pytest.mark.parametrize("title", MISTAKES)
def test_a_mistake_is_answered_as_the_page_says(title: str) -> None:
    """The error of a fit is of the kind, and has the very words, that docs/errors.md tells."""
    with pytest.raises(OedSysidError) as caught:
        MISTAKES[title]()
    assert f"| {title} | `{type(caught.value).__name__}`: {caught.value} |" in ERRORS


@pytest.mark.parametrize(("act", "words"), CASES.values(), ids=[*CASES])
def test_message_says_what_to_do(act: Callable[[], object], words: tuple[str, ...]) -> None:
    """The error is of the package's own kind and names culprit and remedy."""
    with pytest.raises(OedSysidError) as caught:
        act()
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "act",
    [
        lambda: FIT.fit(DATA, MODEL),  # type: ignore[arg-type]
        lambda: FIT.fit(MODEL, list(DATA)),  # type: ignore[arg-type]
        lambda: improve(DATA, MODEL),  # type: ignore[arg-type]
        lambda: improve(MODEL, DATA, list(DATA)),  # type: ignore[arg-type]
        lambda: diagnose(DATA, MODEL),  # type: ignore[arg-type]
        lambda: check(MODEL, DATA),  # type: ignore[arg-type]
        lambda: usual_effects(DATA, MODEL),  # type: ignore[arg-type]
        lambda: simulate(DATA, MODEL),  # type: ignore[arg-type]
        lambda: turning_circle(DATA, speed=1.0),  # type: ignore[arg-type]
    ],
)
def test_arguments_in_the_wrong_place_are_named(act: Callable[[], object]) -> None:
    """What was expected and what was got, from every entry that takes a model and records."""
    with pytest.raises(OedSysidError, match=r"Expected a .*, got (Dataset|Model|list)|got Dataset"):
        act()


def test_constant_measurements_are_fitted_and_explained() -> None:
    """A vehicle at rest is no error: the fit says that nothing moved and nothing is known."""
    held = with_inputs(DATA, lambda record: 0 * record.inputs)
    still = with_outputs(held, lambda record: 0 * record.outputs + [0.1, 0.0])
    fit = MultipleShooting(noise=NOISE).fit(MODEL, still)
    report = fit.report()
    assert "Input delta never moves in any record" in report
    assert "K does not influence any output" in report
    assert np.isinf(fit.std_errors["K"])


def test_exact_data_with_estimated_noise_do_not_divide_by_zero() -> None:
    """Data without any noise give a finite level and a finite report."""
    exact = yaw_data(1, noise=np.zeros(2))
    fit = MultipleShooting(noise="estimate").fit(MODEL, exact)
    assert np.all(fit.sigma > 0)
    assert fit.status.ok
    assert "nan" not in fit.report()


def test_numbers_of_numpy_are_numbers() -> None:
    """What NumPy returns is as good as Python's own numbers."""
    parameter = Parameter("K", np.float64(0.1), "1/s", lower=np.float32(0.0), scale=np.int64(2))
    assert parameter.magnitude == 2
    assert Output("y", "m", noise_std=np.float64(0.1)).noise_std == 0.1
    assert Limits(rates={"a": np.float64(0.1)}).rates == {"a": 0.1}


def test_sound_problem_loads(tmp_path: Path) -> None:
    """The problem that the faulty ones are made from is without fault."""
    problem = load_problem(folder_of(tmp_path / "ferry", SOUND))
    assert problem.model.free_names == ("K", "T")
    assert [effect.name for effect in problem.effects] == ["drag", "bias"]


@pytest.mark.parametrize(
    ("files", "words"), [one[1:] for one in REFUSED], ids=[one[0] for one in REFUSED]
)
def test_refused_when_loaded(
    tmp_path: Path, files: dict[str, str | bytes], words: tuple[str, ...]
) -> None:
    """A faulty folder ends in a ProblemError that names the file and what is wrong."""
    with pytest.raises(ProblemError) as caught:
        load_problem(folder_of(tmp_path / "ferry", files))
    message = str(caught.value)
    assert "ferry" in message
    # A user sees the own file, not the inside of the package.
    assert caught.value.__context__ is None or caught.value.__suppress_context__
    for word in words:
        assert word in message


def test_a_problem_does_not_move_the_process(tmp_path: Path) -> None:
    """What a problem does to the working folder ends with its loading."""
    here = os.getcwd()
    load_problem(folder_of(tmp_path / "ferry", SOUND + "import os\nos.chdir('/')\n"))
    assert os.getcwd() == here


@pytest.mark.parametrize("name", ["", "  ", 7, None, "a\0b"])
def test_what_is_no_name_is_refused(name: object) -> None:
    """Something else than a name or a folder is refused in words."""
    with pytest.raises(ProblemError):
        load_problem(name)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", list_problems())
def test_shipped_problems_are_sound(name: str) -> None:
    """No shipped problem has an error of dimension, or a candidate that is there at zero."""
    problem = load_problem(name)
    for one in (problem, *problem.others.values()):
        assert faults(one.name, one.models, one.effects) == ()
    assert problem.notes() == ()  # their numbers have no units of their own
