"""Every mistake that a user can make ends in a sentence that says what to do.

The list is that of docs/errors.md: what was done, which error, which words.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from yaw_vehicle import NOISE, yaw_data, yaw_model

from oed_sysid import check, diagnose, improve, simulate, turning_circle, usual_effects
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import DataError, ModelError, OedSysidError
from oed_sysid.likelihood.estimator import Solver
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.physics.channels import Output
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter

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
    return model, Dataset(tuple(replace(record, channels=model.channels) for record in DATA))


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


CASES: list[tuple[str, Callable[[], object], type[OedSysidError], tuple[str, ...]]] = [
    (
        "noise level zero in the model",
        lambda: MultipleShooting(noise="given").fit(*redeclared(0.0)),
        DataError,
        ("'psi' is 0.0", "positive standard deviation"),
    ),
    (
        "noise level zero in the estimator",
        lambda: MultipleShooting(noise=[0.0, 1.0]).fit(MODEL, DATA),
        DataError,
        ("'psi' is 0.0", "noise='estimate'"),
    ),
    (
        "noise level infinite",
        lambda: MultipleShooting(noise=[1.0, np.inf]).fit(MODEL, DATA),
        DataError,
        ("'r' is inf",),
    ),
    (
        "too few noise levels",
        lambda: MultipleShooting(noise=[0.1]).fit(MODEL, DATA),
        ModelError,
        ("1 levels, expected 2", "psi, r"),
    ),
    (
        "noise level undeclared although insisted upon",
        lambda: MultipleShooting(noise="given").fit(MODEL, DATA),
        DataError,
        ("psi, r is not declared", "noise='auto'"),
    ),
    (
        "unknown noise option",
        lambda: MultipleShooting(noise="guess"),
        ModelError,
        ("'guess'", "auto, given, estimate"),
    ),
    (
        "unknown loss",
        lambda: MultipleShooting(loss="cauchy"),
        ModelError,
        ("'cauchy'", "square, huber, student"),
    ),
    (
        "unknown start",
        lambda: MultipleShooting(start="far"),
        ModelError,
        ("'far'", "auto, near or wide"),
    ),
    (
        "unknown treatment of colour",
        lambda: MultipleShooting(coloured="yes"),
        ModelError,
        ("'yes'", "auto, never or always"),
    ),
    (
        "unknown solver",
        lambda: Solver("snopt"),
        ModelError,
        ("'snopt'", "gauss-newton or ipopt"),
    ),
    (
        "unknown Hessian",
        lambda: Solver("ipopt", hessian="bfgs"),
        ModelError,
        ("'bfgs'", "exact or gauss-newton"),
    ),
    (
        "constraints without IPOPT",
        lambda: Solver(constraints=("K > 0",)),
        ModelError,
        ("Solver('ipopt')", "Parameter(lower=..., upper=...)"),
    ),
    (
        "shooting interval of no length",
        lambda: MultipleShooting(noise=NOISE, interval=0.0).fit(MODEL, DATA),
        ModelError,
        ("positive length",),
    ),
    (
        "no iteration allowed",
        lambda: Solver(max_iterations=0),
        ModelError,
        ("max_iterations is 0", "1 or more"),
    ),
    (
        "tolerance of zero",
        lambda: Solver(tolerance=0.0),
        ModelError,
        ("tolerance is 0.0", "positive"),
    ),
    (
        "fewer samples than unknowns",
        lambda: FIT.fit(MODEL, short()),
        DataError,
        ("2 measured samples and 0 priors cannot determine 5 unknowns", "prior_std"),
    ),
    (
        "record of another model",
        lambda: FIT.fit(MODEL, other_outputs()),
        DataError,
        ("expects ('psi', 'r')", "Read it with the model's channels"),
    ),
    (
        "a record instead of a dataset",
        lambda: FIT.fit(MODEL, DATA[0]),
        DataError,
        ("Dataset((record,))",),
    ),
    (
        "initial guess of an unknown state",
        lambda: FIT.fit(MODEL, DATA, initial_states=[{"yaw": 0.1}, {}, {}]),
        DataError,
        ("'yaw'", "psi, r"),
    ),
    (
        "one initial guess for three records",
        lambda: FIT.fit(MODEL, DATA, initial_states=[{"psi": 0.1}]),
        DataError,
        ("1 guesses for 3 records",),
    ),
    (
        "initial guess that is not a number",
        lambda: FIT.fit(MODEL, DATA, initial_states=[{"psi": np.nan}, {}, {}]),
        DataError,
        ("'psi'", "nan"),
    ),
    (
        "start value outside its bounds",
        lambda: Parameter("T", 5.0, lower=6.0),
        ModelError,
        ("starts at 5, outside its bounds", "widen the bounds"),
    ),
    (
        "prior without spread",
        lambda: Parameter("T", 5.0, prior_std=0.0),
        ModelError,
        ("prior_std 0.0", "fixed=True"),
    ),
]


@pytest.mark.parametrize(
    ("act", "error", "words"), [case[1:] for case in CASES], ids=[case[0] for case in CASES]
)
def test_message_says_what_to_do(
    act: Callable[[], object], error: type[OedSysidError], words: tuple[str, ...]
) -> None:
    """The error is of the package's own kind and names culprit and remedy."""
    with pytest.raises(error) as caught:
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


def test_list_is_complete() -> None:
    """docs/errors.md lists every case, with the words that the user will read."""
    text = (Path(__file__).parent.parent / "docs" / "errors.md").read_text(encoding="utf-8")
    for title, _, _, words in CASES:
        assert title in text
        for word in words:
            assert word in text, f"{title}: {word}"


def test_numbers_that_are_no_numbers_are_refused() -> None:
    """Infinite outputs and gaps in inputs are found when the record is made."""
    record = DATA[0]
    outputs = record.outputs.copy()
    outputs[3, 0] = np.inf
    with pytest.raises(DataError, match="Mark missing samples with NaN"):
        record.with_outputs(outputs)
    inputs = record.inputs.copy()
    inputs[7] = np.nan
    with pytest.raises(DataError, match="have to be known at every time"):
        replace(record, inputs=inputs)


def test_constant_measurements_are_fitted_and_explained() -> None:
    """A vehicle at rest is no error: the fit says that nothing moved and nothing is known."""
    still = Dataset(
        tuple(
            Record(r.name, r.times, 0 * r.inputs, 0 * r.outputs + [0.1, 0.0], r.channels)
            for r in DATA
        )
    )
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
