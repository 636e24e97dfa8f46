"""Comparison, where a model fails, terms proposed, ranking, and the improvement loop."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import turning_ship
from altered import with_outputs
from golden_files import restored
from marks import slow
from motion import small
from scipy import stats
from turning_ship import CANDIDATES, GYRO_BIAS, NOISE, SHIP, dataset
from turning_ship import CUBIC as DAMPING
from turning_ship import improved as improved_ship

from benchmarks.missing_physics.cases import true_derivatives
from benchmarks.missing_physics.judge import nominal
from benchmarks.missing_physics.simulator import TRAIN, Case, simulate
from oed_sysid import Dataset, Fit, Record, improve, load_problem, read_csv, simulate_inputs
from oed_sysid.errors import DataError, OedSysidError
from oed_sysid.evidence import improvement
from oed_sysid.evidence.compare import Comparison, compare, forecasts
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.evidence.locate import locate
from oed_sysid.evidence.propose import Signal as Cause
from oed_sysid.evidence.propose import Signals, Term, TermScores, propose, terms
from oed_sysid.evidence.rank import Ranking, rank
from oed_sysid.evidence.residual_forces import let_in
from oed_sysid.evidence.score import Score, scores
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.disturbances import places
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.physics import Force, Parameter, sensor_bias
from oed_sysid.text.units import same_dimension

NOMINAL = SHIP.with_values({"K": 0.5, "T": 4.0})


def record(
    name: str, seed: int, cubic: float, *, gap: bool = False, amplitude: float = 0.5
) -> Record:
    """A record of the ship that turns, its rate maybe silent for six seconds."""
    rng = np.random.default_rng(seed)
    found = turning_ship.record(name, rng, cubic, amplitude=amplitude)
    silent = np.isin(np.arange(found.n_samples), range(50, 80)) & gap
    return found.with_outputs(np.where(silent[:, None] & [False, True], np.nan, found.outputs))


@pytest.fixture(scope="module")
def both() -> Comparison:
    """The believed and the true structure, fitted to two records, judged on two others."""
    train = Dataset((record("a", 1, -20.0), record("b", 2, -20.0, amplitude=0.25)))
    test = Dataset((record("c", 3, -20.0, gap=True), record("d", 5, -20.0)))
    fits = [
        MultipleShooting(disturbances="none").fit(model, train)
        for model in (NOMINAL, NOMINAL + DAMPING)
    ]
    return compare(fits, test)


def test_the_true_structure_leaves_noise_and_the_believed_one_does_not(both: Comparison) -> None:
    """Misfit, band, whiteness and verdict tell a right model from a wrong one."""
    wrong, right = both.models
    assert right.is_noise
    assert right.verdict.startswith("base + cubic_damping: the misfit is noise")
    assert right.relative == pytest.approx(1.0, abs=0.06)
    assert not wrong.is_noise
    assert wrong.relative > 1.5
    assert both.best is right
    for good, bad in zip(right.outputs, wrong.outputs, strict=True):
        assert good.coverage == pytest.approx(0.95, abs=0.03)
        assert bad.coverage < 0.85
        assert bad.effective_samples < 0.6 * bad.n_samples


def test_numbers_are_those_of_the_residuals(both: Comparison) -> None:
    """RMSE, sample counts and windows agree with a direct calculation that skips gaps."""
    part = both[0]
    stacked = np.vstack(part.prediction.residuals)
    rate = part.output("r")
    assert rate.n_samples == 600 - 30
    assert rate.rmse == pytest.approx(float(np.sqrt(np.nanmean(stacked[:, 1] ** 2))))
    assert rate.relative == pytest.approx(rate.rmse / NOISE[1])
    first = part.prediction.residuals[0][:50, 1] / NOISE[1]
    assert len(rate.windows[0]) == 6
    assert rate.windows[0][0] == pytest.approx(np.sqrt(np.mean(first**2)))
    scaled = stacked / NOISE
    assert part.relative == pytest.approx(float(np.sqrt(np.nanmean(scaled**2))))


def test_forecasts_of_a_right_model_leave_what_is_expected(both: Comparison) -> None:
    """A right model's forecast error is one in its own standard deviations, a wrong one's more."""
    assert both[1].forecasts.overall == pytest.approx(1.0, abs=0.08)
    assert both[0].forecasts.overall > 1.3
    assert both[1].forecasts.n_forecasts == 10
    ahead = both[0].forecasts
    sizes = zip(ahead.errors, ahead.expected, strict=True)
    squares = np.vstack([(error / size)[:, :, 0] for error, size in sizes]) ** 2
    growth = np.sqrt(np.nanmean(squares, axis=0))
    assert growth.shape == (50,)
    assert np.mean(growth[-10:]) > np.mean(growth[:10])


def test_short_records_give_no_forecast() -> None:
    """A record shorter than one and a half horizons yields none, and nothing breaks."""
    short = Dataset((record("a", 1, 0.0).window(0.0, 10.0),))
    assert forecasts(NOMINAL, short, NOISE, horizon=10.0).n_forecasts == 0
    assert compare(NOMINAL, short, horizon=10.0).report()


def test_a_model_that_diverges_is_a_verdict_not_a_crash() -> None:
    """An unstable model is reported as diverging."""
    wild = NOMINAL + DAMPING.with_values({"n3": 500.0})
    found = compare(wild, Dataset((record("a", 1, 0.0),)))
    assert found[0].relative == np.inf
    assert "diverges" in found.verdict
    assert found.report()


def test_empty_comparisons_are_refused() -> None:
    """Nothing to compare, and impossible horizons, are explained."""
    data = Dataset((record("a", 1, 0.0),))
    with pytest.raises(DataError, match="at least one fit"):
        compare([], data)
    with pytest.raises(DataError, match="above zero"):
        compare(NOMINAL, data, horizon=0.0)


def test_what_differs_from_record_to_record_is_estimated_on_each() -> None:
    """A gyro bias that is declared per record is neither misfit nor forecast error."""
    first, second = record("a", 1, 0.0), record("b", 2, 0.0)
    shifted = second.with_outputs(second.outputs + np.array([0.0, 0.02]))
    found = compare({"biased": NOMINAL + GYRO_BIAS, "plain": NOMINAL}, Dataset((first, shifted)))
    assert found["biased"].is_noise
    assert found["biased"].forecasts.overall == pytest.approx(1.0, abs=0.08)
    assert not found["plain"].is_noise
    assert found["biased"].prediction.local_values[1]["b_r"] == pytest.approx(0.02, abs=0.002)


@pytest.mark.slow
def test_errors_of_a_search_and_of_a_comparison_are_the_same() -> None:
    """Declared levels measure both, though the search estimates its noise again."""
    train = Dataset((record("a", 1, -20.0), record("b", 2, -20.0, amplitude=0.25)))
    test = Dataset((record("c", 3, -20.0),))
    found = improve(NOMINAL, train, test, candidates=CANDIDATES)
    assert not np.allclose(found.base_fit.noise.sensors, NOISE, rtol=1e-3)
    fits = {"nominal": found.base_fit, "improved": found.fit}
    by_default = compare(fits, test)
    np.testing.assert_array_equal(by_default.sigma, NOISE)
    errors = [found.base_error["test"], found.final_error["test"]]
    for same in (by_default, compare(fits, test, sigma=found.yardstick.sigma)):
        np.testing.assert_allclose([part.relative for part in same.models], errors, rtol=2e-3)
    doubled = compare(fits, test, sigma=2.0 * NOISE)
    np.testing.assert_allclose([2.0 * part.relative for part in doubled.models], errors, rtol=2e-3)


PROBLEM, DRAG = nominal(), -120.0
CROSSFLOW = Force("drag", {"Z": "Z_d*w*abs(w)"}, (Parameter("Z_d", 0.0, "kg/m", scale=100.0),))


HIDDEN_IN = {
    "drag": (1, {"heave_crossflow_drag": DRAG}),
    "nothing": (1, {}),
    "nothing, other derivatives": (2, {}),
    "sensor q": (3, {"bias_q": 0.006}),
    "actuator ds": (3, {"fin_offset": 0.03}),
    "force M": (3, {"pitch_quadratic_damping": -70.0}),
    "cubic": (4, {"unknown_cubic_pitch_damping": -250.0}),
    "nothing, yet others": (5, {}),
}


@cache
def simulated() -> dict[str, list]:
    """Steps and a zigzag of vehicles with hidden effects, derivatives drawn, all side by side."""
    cases = [
        Case(name, true_derivatives(np.random.default_rng(seed)), hidden, seed=seed)
        for name, (seed, hidden) in HIDDEN_IN.items()
    ]
    return dict(zip(HIDDEN_IN, simulate(cases, TRAIN[:2]), strict=True))


def records(name: str, duration: float = 40.0) -> Dataset:
    """The beginning of what was simulated."""
    return Dataset(
        Record(run.name, one.times, one.inputs, one.outputs, PROBLEM.channels).window(0.0, duration)
        for run, one in zip(TRAIN, simulated()[name], strict=False)
    )


def begun(train):  # type: ignore[no-untyped-def]
    """The study of the nominal model, and its fit."""
    return Study.begin(PROBLEM.model, train, None, (CROSSFLOW,), known_noise=False)


@pytest.fixture(scope="module")
def drag():  # type: ignore[no-untyped-def]
    """Records of a vehicle with a cross-flow drag that the model lacks."""
    train = records("drag")
    study, fit = begun(train)
    return train, study, fit


def test_a_missing_heave_force_is_found_in_the_heave_equation(drag) -> None:  # type: ignore[no-untyped-def]
    """A cross-flow drag is located in Z, and the true structure's signature agrees best."""
    train, study, fit = drag
    right = study.estimate(study.candidates, fit.values, fit, max_iterations=25)
    assert right.values["Z_d"] == pytest.approx(DRAG, rel=0.1)
    found = locate(fit, study.unit, {"drag": right})
    assert found.best == "force Z"
    assert found.verdict.startswith(
        "What the sensors alone do not explain enters most likely in the forces of the Z equation"
    )
    std = np.vstack([one.std for one in found.forces]).ravel()
    seen = np.vstack([one.values for one in found.forces]).ravel() / std
    meant = np.vstack(found.signatures["drag"]).ravel() / std
    assert seen @ meant > 0.9 * np.linalg.norm(seen) * np.linalg.norm(meant)
    assert "not the missing force itself" in found.report()
    assert json.loads(json.dumps(found.to_dict()))["best"] == "force Z"
    assert found.forces[0].values.shape == (train[0].n_samples, 3)
    # What the derivatives absorbed is not in the residual force: it is far smaller than the drag.
    part = right.problem.passes(right.point.unknowns, columns=False)[0]
    w = part.path[:, 1]
    assert np.std(found.forces[0].values[:, 1]) < 0.8 * np.std(DRAG * w * np.abs(w))


def test_a_fit_without_forces_shows_those_of_the_fit_that_has_them(drag) -> None:  # type: ignore[no-untyped-def]
    """Places are judged alike; residual forces are seen where they may be larger than nothing."""
    train, study, fit = drag
    calm = Study.begin(study.base, train, None, (), known_noise=True, disturbances="none")[1]
    alone, beside = locate(calm, study.unit), locate(calm, study.unit, moved=fit)
    assert alone.gains == beside.gains
    named = beside.force_names.index("Z")
    size, unseen = (np.std(one.forces[0].values[:, named]) for one in (beside, alone))
    assert size > 100.0 * unseen
    expected = locate(fit, study.unit).forces[0].values
    np.testing.assert_allclose(beside.forces[0].values, expected)


def test_standard_errors_of_residual_forces_are_honest() -> None:
    """Without missing physics the smoothed force is noise of the size that it states."""
    study, fit = begun(records("nothing, other derivatives"))
    found = locate(fit, study.unit)
    assert found.best is None
    assert found.group == ()
    assert "noise" in found.verdict
    for series in found.forces:
        assert np.mean(np.abs(series.values) < 2.5 * series.std) > 0.95


@pytest.mark.parametrize("place", ["sensor q", *slow("actuator ds", "force M")])
def test_other_stages_are_told_apart(place: str) -> None:
    """A bent fin, a biased gyro and a pitch damping are each found where they are."""
    study, fit = begun(records(place))
    assert locate(fit, study.unit).best == place


def test_places_cover_the_chain_of_any_model() -> None:
    """Every signal, equation, kinematic relation and output is a place with a unit."""
    found = {place.name: place.unit for place in places(PROBLEM.model)}
    assert found["actuator ds"] == "rad"
    assert found["flow w_r"] == "m/s"
    assert found["force M"] == "N m"
    assert found["kinematics theta"] == "rad/s"
    assert found["kinematics z"] == "m/s"
    assert found["sensor z"] == "m"


def test_filtered_trajectory_is_near_the_measurements(drag) -> None:  # type: ignore[no-untyped-def]
    """The path of the filter follows the records where the model itself does not."""
    train, study, fit = drag
    problem, unknowns = let_in(fit, study.unit)
    noise = np.array([0.02, 0.02, 0.004, 0.004, 0.03])
    for index, part in enumerate(problem.passes(unknowns, columns=False)):
        record = train[index]
        alone, _, _ = problem.alone(unknowns, index)
        own = np.sqrt(np.mean(((record.outputs - alone) / noise) ** 2))
        followed = np.sqrt(np.mean(((record.outputs - part.path[:, :5]) / noise) ** 2))
        assert followed < 1.05
        assert own > followed


VEHICLE = (
    Cause("u_r", "m/s", "motion", True),
    Cause("w_r", "m/s", "motion", False),
    Cause("q", "rad/s", "motion", False),
    Cause("theta", "rad", "angle", False),
    Cause("ds", "rad", "motion", False),
    Cause("T", "N", "thrust", True),
)
UNITS = {signal.name: signal.unit for signal in VEHICLE}


def test_dictionary_holds_what_engineers_write() -> None:
    """Drag, lift, damping, thrust and restoring terms are all there, each once per equation."""
    found = terms(PROBLEM.model, VEHICLE)
    texts = [term.expression for term in found if term.equation == "M"]
    assert len(set(texts)) == len(texts)
    for text in ("1", "abs(q)*q", "q**3", "u_r*w_r", "u_r**2*ds", "T", "q*T"):
        assert text in texts
    assert "sin(theta)*cos(theta)" in texts
    assert "abs(u_r)" not in texts
    assert 300 < len(found) < 500
    symbols = [term.symbol for term in found]
    assert len(set(symbols)) == len(symbols)


@pytest.mark.parametrize(
    ("equation", "expression", "factors", "text", "unit"),
    [
        ("M", "q**3", (("q", False),) * 3, "M_qqq q^3", "N m s^3"),
        ("Z", "abs(w_r)*w_r", (("w_r", True), ("w_r", False)), "Z_absww w|w|", "kg/m"),
        ("M", "q*T", (("q", False), ("T", False)), "M_qT q T", "m s"),
        ("M", "sin(theta)*cos(theta)", (), "M_sinthetacostheta sin(theta) cos(theta)", "N m"),
        ("X", "1", (), "X_0", "N"),
    ],
)
def test_terms_have_names_and_units(
    equation: str,
    expression: str,
    factors: tuple,
    text: str,
    unit: str,  # type: ignore[type-arg]
) -> None:
    """Names follow the notation where it reaches, units follow from dimensions."""
    term = Term(equation, expression, factors)
    assert term.text == text
    effect = term.effect(PROBLEM.model, UNITS, 1.0)
    assert same_dimension(effect.parameters[0].unit, unit)
    assert effect.terms[equation].endswith(expression) or expression == "1"
    assert PROBLEM.model + effect


def test_coefficients_get_another_name_where_theirs_is_taken() -> None:
    """A term whose derivative the model has already does not collide with it."""
    term = Term("M", "u_r*q", (("u_r", False), ("q", False)))
    assert term.effect(PROBLEM.model, UNITS, 1.0).parameters[0].name == "E_M_uq"


def test_scores_are_those_of_the_wider_model() -> None:
    """A term's statistic is what its column on a filter that holds it as a parameter gives."""
    train = records("nothing", 20.0)
    term = Term("M", "abs(q)*q", (("q", True), ("q", False)))
    effect = term.effect(PROBLEM.model, UNITS, 1.0)
    study, fit = Study.begin(PROBLEM.model, train, None, (), known_noise=True)
    problem, unknowns = let_in(fit, study.unit)
    found = TermScores(problem, unknowns).scores
    score = next(s for s in found if s.term == term)
    model = problem.model + effect
    wide = Filtered(model, train, problem.levels)
    point = wide.point(fit.initial).unknowns
    matrix, right = wide.gathered(point, wide.passes(point))
    limits = wide.limits
    matrix = matrix + np.diag(limits.prior_weight)
    right = right + limits.prior_weight * (limits.prior_mean - point)
    at = wide.layout.free_names.index(effect.parameters[0].name)
    size = 1.0 / np.sqrt(np.diag(matrix))
    inverse = size[:, None] * np.linalg.inv(matrix * size[:, None] * size) * size
    # Terms are evaluated halfway between samples, and held over the step.
    assert score.std_error == pytest.approx(np.sqrt(inverse[at, at]), rel=0.03)
    assert score.estimate == pytest.approx(float(inverse[at] @ right), abs=0.05 * score.std_error)


def test_terms_of_a_large_force_are_compared() -> None:
    """The cube of 300 MN m, squared, is beyond single precision."""
    law = {"phi": "p", "p": "-b*p - k*phi + m*moment"}
    values = {"b [1/s]": 0.1, "k [1/s^2]": 1.0, "m [1/(kg m^2)]": 1e-9}
    noise = {"phi": 0.001, "p": 0.001}
    model = small("roll", "phi [rad], p [rad/s] <- moment [N m]", law, values, noise, step=0.5)
    rng = np.random.default_rng(0)
    moment = np.repeat(rng.uniform(-3e8, 3e8, 20), 10)[:, None]
    record = Record("run", 0.5 * np.arange(200), moment, np.zeros((200, 2)), model.channels)
    run = simulate_inputs(model, record.times, inputs=moment)
    measured = run.outputs + 0.001 * rng.standard_normal((200, 2))
    train = Dataset((record.with_outputs(measured),))
    study, fit = Study.begin(model, train, None, (), known_noise=True)
    found = TermScores(*let_in(fit, study.unit))
    assert "moment**3" in {one.term.expression for one in found.scores}
    assert np.diag(found.likeness) == pytest.approx(np.ones(len(found.likeness)), abs=0.01)


@pytest.mark.slow
def test_a_cubic_damping_is_proposed_with_its_value() -> None:
    """The true term comes first, in its equation, near its value, and removes the misfit."""
    train = records("cubic", 45.0)
    study, fit = Study.begin(PROBLEM.model, train, None, (), known_noise=False)
    found = propose(study, fit, n_refits=4)
    assert found.best.term.equation == "M"
    assert "M_qqq q^3" in found.group
    cubic = next(p for p in found.proposals if p.term.text == "M_qqq q^3")
    assert cubic.effect.parameters[0].value == pytest.approx(-250.0, rel=0.15)
    assert PROBLEM.model + found.best.effect


@pytest.mark.slow
def test_nothing_is_proposed_where_nothing_is_missing() -> None:
    """Noise alone gives no claim, however many terms are looked at."""
    train = records("nothing, yet others")
    study, fit = Study.begin(PROBLEM.model, train, None, (), known_noise=False)
    found = propose(study, fit, n_refits=3)
    assert found.best is None
    assert found.group == ()


def test_models_without_axes_have_a_dictionary() -> None:
    """An ordinary differential equation is searched in the rates that hold parameters."""
    law = {"phi": "p", "p": "-b*p - k*phi + moment"}
    values = {"b [1/s]": 0.1, "k [1/s^2]": 1.0}
    model = small("roll", "phi [rad], p [rad/s] <- moment [N m]", law, values, {"phi": 0.001})
    signals = (
        Cause("phi", "rad", "motion", False),
        Cause("p", "rad/s", "motion", False),
        Cause("moment", "N m", "motion", False),
    )
    found = terms(model, signals)
    assert {term.equation for term in found} == {"p"}
    damping = next(term for term in found if term.expression == "abs(p)*p")
    assert same_dimension(damping.effect(model, {"p": "rad/s"}, 1.0).parameters[0].unit, "1")


def test_powers_of_a_position_are_there_where_a_force_knows_it() -> None:
    """A spring that may harden as a mooring does; a depth that no force knows has none."""
    for spring, known in (("- k*z", True), ("", False)):
        model = small(
            "moored",
            "w [m/s], z [m] <- push [N]",
            {"z": "w"},
            {"c [kg/s]": 8.0, "k [N/m]": 15.0},
            {"z": 0.01},
            axes={"Z": "w"},
            inertia={("Z", "w"): "20.0"},
            effects=(Force("hull", {"Z": f"push - c*w {spring}"}),),
        )
        found = terms(
            model, (Cause("w", "m/s", "motion", False), Cause("z", "m", "position", False))
        )
        texts = [term.expression for term in found]
        assert "z" in texts
        assert ("z**3" in texts) is known


def test_a_heading_is_no_cause() -> None:
    """Signals of a steering model leave out the heading, on which nothing depends."""
    ship = load_problem("kvlcc2").model
    record = Record(
        "any",
        np.arange(5.0),
        np.linspace(0.0, 0.1, 5)[:, None],
        np.zeros((5, len(ship.outputs))),
        ship.channels,
    )
    states = np.linspace(0.0, 0.2, 5)[:, None] * np.ones(len(ship.states))
    named = {signal.name for signal in Signals(ship, Dataset((record,)), [states]).signals}
    assert "r" in named
    assert "psi" not in named


def score(name: str, statistic: float, signature: np.ndarray) -> Score:
    """Score of a candidate with one amplitude."""
    effect = Force(name, {"X": f"E_{name}"}, (Parameter(f"E_{name}", 0.0, "N", scale=1.0),))
    amplitude = {f"E_{name}": 1.0}
    return Score(effect, statistic, 1, amplitude, amplitude, 0.5, signature[:, np.newaxis])


def test_a_candidate_that_was_not_refitted_joins_the_group_if_its_signature_is_the_same() -> None:
    """At a correlation of 0.995 two effects are one to the records; at 0.8 they are not."""
    rng = np.random.default_rng(0)
    first, other = np.linalg.qr(rng.standard_normal((200, 2)))[0].T
    ranking = Ranking(
        (
            score("drag", 40.0, first),
            score("alike", 39.0, -3.0 * (0.995 * first + np.sqrt(1 - 0.995**2) * other)),
            score("related", 30.0, 0.8 * first + 0.6 * other),
            score("absorbed", 0.0, 0.0 * first),
        ),
        (),
        first,
    )
    assert ranking.alike("drag") == ("alike",)
    assert set(ranking.alike("drag", 0.5)) == {"alike", "related"}


@pytest.mark.parametrize("brim", [5.0, *slow(1.0)], ids=["above every level", "near"])
def test_several_shapes_are_estimated_from_their_own_values(brim: float) -> None:
    """Every shape is looked for over its bounds, even where the given value shows nothing."""
    law = {"upper": "-drain*upper", "lower": "drain*upper - drain*lower"}
    tank = small("tanks", "upper [m], lower [m]", law, {"drain [1/s]": 0.4})
    overflow = Force(
        "overflow",
        {
            "upper": "-E_overflow*max(upper - brim, 0)",
            "lower": "E_overflow*share*max(upper - brim, 0)",
        },
        (
            Parameter("E_overflow", 0.0, "1/s", lower=0.0, upper=2.0, scale=0.1),
            Parameter("share", 0.5, "1", lower=0.0, upper=1.0),
            Parameter("brim", brim, "m", lower=0.5, upper=6.0),
        ),
        amplitudes=("E_overflow",),
    )
    true = (tank + overflow).with_values({"E_overflow": 0.5, "share": 0.7, "brim": 1.0})
    times = np.arange(0.0, 10.0, 0.1)
    clean = simulate_inputs(true, times, inputs={}, initial=[3.0, 0.5]).outputs
    noisy = clean + 0.002 * np.random.default_rng(2).standard_normal(clean.shape)
    data = Dataset((Record("drain", times, [], noisy, tank.channels),))
    found = improve(tank, data, candidates=(overflow,))
    assert [step.added for step in found.steps] == ["overflow"]
    assert abs(found.model.values["share"] - 0.7) < 0.1
    assert abs(found.model.values["brim"] - 1.0) < 0.1


def candidate(name: str, needs: str, error: float) -> Score:
    """Score of a candidate of typical size one whose error in these records is given."""
    parameter = Parameter(f"E_{name}", 0.0, "N", scale=1.0)
    effect = Force(name, {"X": f"E_{name}"}, (parameter,), needs=needs)
    key = parameter.name
    return Score(effect, 1.0, 1, {key: 0.0}, {key: error}, 0.5, np.ones((3, 1)))


RANKING = Ranking(
    (
        candidate("drag", "coasting", 0.01),
        candidate("bias", "several speeds", 0.01),
        candidate("faint", "storms", 5.0),
    ),
    (),
    np.ones(3),
)
ESTIMATES = ({"name": "E_drag", "value": 2.0, "std_error": 0.1, "unit": "N"},)


def step(*group: str, test_gain: float = 9.0, test_error: float = 1.0) -> SimpleNamespace:
    """A step as far as the advice looks at it."""
    effect = next(s.effect for s in RANKING.scores if s.effect.name == group[0])
    return SimpleNamespace(
        added=group[0],
        group=group,
        effect=effect,
        claim=SimpleNamespace(validation=test_gain),
        test_error=test_error,
        fit=None,
    )


def advice(
    steps: Sequence[SimpleNamespace],
    ranking: Ranking,
    parameters: Sequence[dict[str, Any]],
    *,
    kind: str = "adequate",
    before: float = np.nan,
    last: Ranking | None = None,
) -> list[str]:
    """Advice on a result as far as it is looked at."""
    result: Any = SimpleNamespace(
        steps=steps,
        headlined=steps,
        ranking=ranking,
        last=last,
        parameters=parameters,
        base_error={"test": before},
        base=SimpleNamespace(inputs=("fin",)),
        remains=SimpleNamespace(kind=kind),
    )
    return improvement.advice(result)


def test_one_effect_is_believed_with_its_size() -> None:
    """A single confirmed effect is stated with value and error; what is invisible is not denied."""
    text = "\n".join(advice([step("drag")], RANKING, ESTIMATES))
    assert "drag is missing, the validation records agree: E_drag = 2.00 ± 0.20 N (95 %)" in text
    assert "that faint is absent: its typical" in text
    assert "Next at sea" not in text


def test_a_group_is_not_believed_to_be_its_first_member() -> None:
    """Rivals are named, with the manoeuvres that they need and the command that designs one."""
    text = "\n".join(advice([step("drag", "bias")], RANKING, ESTIMATES, kind="structure missing"))
    assert "drag or bias helps, the validation records agree; it may stand for" in text
    assert "that it is drag (E_drag = 2.00 ± 0.20 N (95 %)): bias does as well" in text
    assert "coasting; several speeds" in text
    assert "--discriminate drag bias" in text
    assert "standard errors of the parameters: more is missing than was found" in text
    text = "\n".join(advice([step("drag")], RANKING, ESTIMATES, kind="not known"))
    assert "standard errors of the parameters: whether more is missing is not known" in text


@pytest.mark.parametrize(("quadratic", "said"), [(-0.35, True), (0.35, False)])
def test_two_effects_against_each_other_may_stand_for_another_law(
    quadratic: float, said: bool
) -> None:
    """Dry friction and a quadratic drag that drives: damping by the root of the rate, say."""
    sizes = {"dry": 0.02, "quad": quadratic}
    terms = {"dry": "-E_dry*tanh(r/0.015)", "quad": "-E_quad*r*abs(r)"}
    steps, rows = [], []
    for name, size in sizes.items():
        effect = Force(name, {"r": terms[name]}, (Parameter(f"E_{name}", 0.0, "1", scale=1.0),))
        own = {"added": name, "group": (name,), "effect": effect}
        steps.append(SimpleNamespace(**{**vars(step("drag")), **own}))
        rows.append({"name": f"E_{name}", "value": size, "std_error": 0.001, "unit": "1"})
    lines = advice(steps, RANKING, rows)
    told = [line for line in lines if "may stand for another law of r" in line]
    assert len(told) == (2 if said else 0)
    assert any("E_quad = 0.3500 ± 0.0020 (95 %)" in line for line in lines) is not said


def test_an_untested_claim_is_not_believed() -> None:
    """Without validation records the claim waits for one."""
    text = "\n".join(advice([step("drag", test_gain=np.nan)], RANKING, ESTIMATES))
    assert "validation records agree" not in text
    assert "drag before a validation record has confirmed it" in text


def test_a_claim_beside_a_rising_error_is_doubted() -> None:
    """Only the step with which validation runs become worse is named, and sizes without errors."""
    estimates = ({"name": "E_drag", "value": 2.0, "std_error": np.inf, "unit": "N"},)
    steps = [step("drag", test_error=1.5), step("faint", test_error=0.9)]
    lines = advice(steps, RANKING, estimates, before=1.2)
    doubted = [line for line in lines if "alone" in line]
    assert len(doubted) == 1
    assert "drag" in doubted[0]
    assert any("size of E_drag" in line for line in lines)
    assert not any("inf" in line for line in lines)


@pytest.mark.parametrize(("std_error", "told"), [(0.1, True), (15.0, True), (60.0, False)])
def test_a_size_that_may_be_anything_is_not_stated(std_error: float, told: bool) -> None:
    """An error of more than forty typical sizes tells no size; nor one beyond all bounds."""
    row = {"name": "E_drag", "value": 2.0, "std_error": std_error, "unit": "N"}
    lines = advice([step("drag")], RANKING, (row,))
    assert any("size of E_drag" in line for line in lines) != told
    bounded = replace(step("drag").effect.parameters[0], lower=0.0, upper=3.0)
    effect = replace(step("drag").effect, parameters=(bounded,))
    claim = SimpleNamespace(**{**vars(step("drag")), "effect": effect})
    lines = advice([claim], RANKING, (row,))
    assert any("size of E_drag" in line for line in lines) == (std_error > 1.0)


def test_nothing_is_believed_of_a_log_that_contradicts_itself() -> None:
    """What was found is listed under a condition, and there is no list of what to believe."""
    lines = advice([step("drag")], RANKING, ESTIMATES, kind="log suspect")
    titles = [line for line in lines if not line.startswith(" ")]
    assert titles[0] != advice([step("drag")], RANKING, ESTIMATES, kind="structure missing")[0]
    assert "Believe:" not in titles
    assert any("drag is missing" in line for line in lines)


def test_what_shows_in_one_amplitude_is_not_said_to_be_invisible() -> None:
    """Of two amplitudes one is known to a hundredth of its size, the other not at all."""
    sizes = tuple(Parameter(name, 0.0, "N", scale=1.0) for name in ("E_along", "E_across"))
    effect = Force("wind", {"X": "E_along", "Y": "E_across"}, sizes)

    def of(across: float, along: float) -> Score:
        errors = {"E_along": along, "E_across": across}
        return Score(effect, 1.0, 2, dict.fromkeys(errors, 0.0), errors, 0.5, np.ones((3, 2)))

    assert not Ranking((of(9.0, 0.01),), (), np.ones(3)).undetectable()
    assert set(Ranking((of(9.0, 9.0),), (), np.ones(3)).undetectable()) == {"wind"}


def test_what_would_not_show_is_asked_of_the_last_round() -> None:
    """Beside the nominal model the wind would not show; beside the better one it would."""
    first = Ranking((candidate("wind", "", 9.0),), (), np.ones(3))
    last = Ranking((candidate("wind", "", 0.01),), (), np.ones(3))
    assert set(first.undetectable()) == {"wind"}
    assert len(advice((), first, ())) == 2  # a title and a line
    assert not advice((), first, (), last=last)


def test_what_free_parameters_do_is_named_apart() -> None:
    """An effect whose signature the parameters imitate is not one that would not show."""
    wind, same = candidate("wind", "", 9.0), candidate("same", "", np.inf)
    ranking = Ranking((wind, replace(same, distinct=0.0)), (), np.ones(3))
    assert ranking.imitated() == ("same",)
    _, unseen, imitated = advice((), ranking, ())
    assert ("wind" in unseen, "same" in unseen) == (True, False)
    assert ("wind" in imitated, "same" in imitated) == (False, True)


@pytest.mark.parametrize(("std_error", "doubted"), [(0.1, 0), (1.5, 1)])
def test_a_claim_whose_interval_holds_zero_is_doubted(std_error: float, doubted: int) -> None:
    """Correlated residuals widen the interval after the likelihood has spoken."""
    row = {"name": "E_drag", "value": 2.0, "std_error": std_error, "unit": "N"}
    lines = advice([step("drag")], RANKING, (row,))
    told = lines[lines.index("Do not believe:") :] if "Do not believe:" in lines else []
    assert sum("drag" in line for line in told) == doubted


@pytest.mark.slow
def test_score_is_chi_squared_where_nothing_is_missing() -> None:
    """Over seeds, the statistic of an absent effect follows its distribution."""
    statistics = []
    for seed in range(30):
        study, fit = Study.begin(SHIP, dataset(seed), None, CANDIDATES, known_noise=True)
        found, _ = scores(study, fit, study.candidates)
        statistics += [one.statistic for one in found if one.effect.name == "cubic_damping"]
    assert stats.kstest(statistics, stats.chi2(1).cdf).pvalue > 0.002
    assert np.mean(statistics) == pytest.approx(1.0, abs=0.8)


@pytest.mark.parametrize("cubic", [-0.2, -0.5])
def test_score_is_the_likelihood_gain_to_first_order(cubic: float) -> None:
    """For a weak effect the statistic is what refitting gains, and the estimate is the refit's."""
    study, fit = Study.begin(SHIP, dataset(7, cubic), None, CANDIDATES, known_noise=True)
    ranking = rank(study, fit, study.candidates, also=["cubic_damping"])
    refit = next(r for r in ranking.refits if r.name == "cubic_damping")
    assert refit.score.statistic == pytest.approx(refit.gain, rel=0.2, abs=0.3)
    error = refit.score.std_errors["n3"]
    assert refit.score.estimate["n3"] == pytest.approx(refit.fit.values["n3"], abs=error)


def test_forces_act_only_where_they_are_let_in() -> None:
    """Levels of forces that are ruled out stay zero; places named are estimated."""
    levels = {}
    for asked in ("auto", "none", "r"):
        _, fit = Study.begin(
            SHIP, dataset(22, force=0.02), None, CANDIDATES, known_noise=True, disturbances=asked
        )
        levels[asked] = dict(zip(fit.noise.places, fit.noise.force, strict=True))
    assert levels["none"]["force r"] == 0
    assert levels["auto"]["force r"] == pytest.approx(0.02, rel=0.4)
    assert levels["r"] == levels["auto"]
    _, fit = Study.begin(
        SHIP, dataset(22, force=0.02), None, CANDIDATES, known_noise=True, disturbances=("psi",)
    )
    named = dict(zip(fit.noise.places, fit.noise.force, strict=True))
    assert named["force r"] == 0
    assert named["kinematics psi"] > 0


def test_a_misfit_without_a_claim_is_not_nothing() -> None:
    """A yaw rate of the other sign: nothing is claimed, and nothing is certified either."""
    spoilt = (
        with_outputs(dataset(seed, n_records=1), lambda r: r.outputs * [1.0, -1.0])
        for seed in (11, 12)
    )
    found = improve(SHIP, *spoilt, candidates=CANDIDATES)
    assert found.steps == ()
    assert found.final_error["test"] > 10
    assert found.verdict == "unexplained"


@pytest.mark.slow
def test_correlation_time_of_sensor_noise_is_found() -> None:
    """Noise that remembers for two seconds is seen as such, and nothing is claimed from it."""
    found = [dataset(seed, colour=0.9) for seed in (30, 31)]
    _, fit = Study.begin(SHIP, found[0], found[1], CANDIDATES, known_noise=False)
    truth = -0.2 / np.log(0.9)
    assert np.all((truth / 2 < fit.noise.colour_time) & (fit.noise.colour_time < truth * 2))
    np.testing.assert_allclose(fit.noise.colour, [0.01, 0.004], rtol=0.3)
    improved = improve(SHIP, *found, candidates=CANDIDATES)
    assert improved.verdict == "nothing_missing"
    assert improved.explained
    assert "correlated over about" in improved.report().splitlines()[-1]


def test_steps_can_be_undone() -> None:
    """The model after any number of steps can be had: none is the believed one, all the final."""
    found = improved_ship()
    assert found.at_step(0) == found.base == found.at_step(-1)
    final = found.at_step(1)
    assert final.effect_names == found.model.effect_names
    assert final.values == pytest.approx(found.model.values)


HIDDEN = Path(os.environ.get("OED_SYSID_DATA", "")) / "hidden_effects"
given = pytest.mark.skipif(not (HIDDEN / "case_013").is_dir(), reason="other records are not here")


def improved(case: str) -> Improvement:
    """The believed AUV improved on the records of one given case."""
    problem = load_problem("remus_diving_plane")
    train, test = (
        read_csv(sorted((HIDDEN / case).glob(f"{part}*.csv")), problem.channels)
        for part in ("train", "test")
    )
    return improve(problem.model, train, test, candidates=problem.effects)


@given
@pytest.mark.slow
def test_a_term_is_proposed_where_no_known_effect_is_right() -> None:
    """Cubic pitch damping, which no candidate holds, is proposed with its value and unit."""
    found = improved("case_013")
    assert [step.added for step in found.steps] == ["term_M_qqq"]
    term = found.proposed[0]
    assert (term["expression"], term["equation"], term["unit"]) == ("q**3", "M", "kg m^2 s")
    # True value of the simulation, see the records' README.
    assert term["value"] == pytest.approx(-267.9, rel=0.05)
    assert "pitch_quadratic_damping" in term["replaces"]
    assert found.final_error["test"] == pytest.approx(1.0, abs=0.05)


@given
@pytest.mark.slow
@pytest.mark.parametrize("number", range(13))
def test_given_cases_get_the_right_story(number: int) -> None:
    """What is added is what was hidden, and nothing else."""
    truth = json.loads((HIDDEN / "answers.json").read_text(encoding="utf-8"))[number]
    found = improved(truth["case"])
    assert {step.added for step in found.steps} == set(truth["hidden_effects"])
    assert found.explained


def test_what_was_found_stays_where_a_later_stage_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second ranking breaks off: the effect of the first is kept, and the reason is told."""
    calls = []

    def ranked(*args: object, **settings: object) -> object:
        calls.append(1)
        if len(calls) == 2:
            raise OedSysidError("a stage that fails")
        return rank(*args, **settings)

    monkeypatch.setattr("oed_sysid.evidence.search.rank", ranked)
    found = improve(SHIP, dataset(11, -15.0), dataset(12, -15.0), candidates=CANDIDATES)
    assert [step.added for step in found.steps] == ["cubic_damping"]
    assert any("a stage that fails" in note for note in found.notes)


N3 = -15.0
BIASES = (0.02, -0.015)


@pytest.fixture(scope="module")
def found() -> Improvement:
    """A ship that lacks cubic damping, under a random yaw acceleration."""
    return improve(
        SHIP, dataset(11, N3, force=0.01), dataset(12, N3, force=0.01), candidates=CANDIDATES
    )


def test_every_step_is_a_fit(found: Improvement) -> None:
    """Nominal model and step are fits with noise model, innovations and errors that cover."""
    assert [step.added for step in found.steps] == ["cubic_damping"]
    assert len(found.fits) == 2
    for fit in found.fits:
        assert isinstance(fit, Fit)
        assert fit.noise.has_forces
        assert fit.innovations is not None
    last = found.fit
    for name, truth in (("K", 0.5), ("T", 4.0), ("n3", N3)):
        assert abs(last.values[name] - truth) < 4 * last.std_errors[name]
    assert last.log_likelihood - found.base_fit.log_likelihood > 10.0
    # What the step gained is the difference of the likelihoods of the two fits.
    gain = 2 * (last.log_likelihood - found.base_fit.log_likelihood)
    assert gain == pytest.approx(found.steps[0].claim.training, rel=0.1, abs=2.0)


def test_fits_are_saved_loaded_and_predict(found: Improvement, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A fit from its file predicts other records as the one that was written."""
    again, other = restored(found.fit, tmp_path), dataset(13, N3)
    errors = again.predict(other).rms
    assert errors == pytest.approx(found.fit.predict(other).rms, rel=1e-9)
    np.testing.assert_allclose(list(errors.values()), NOISE, rtol=0.2)


def test_the_error_table_is_what_compare_prints(found: Improvement) -> None:
    """Errors of every step, on training and validation records, are those of a comparison."""
    test = dataset(12, N3, force=0.01)
    names = list(SHIP.output_names)
    rms = [found.base_rms, *(step.rms for step in found.steps)]
    for judged, key in ((found.fit.dataset, "train"), (test, "test")):
        compared = compare(list(found.fits), judged)
        for part, errors in zip(compared.models, rms, strict=True):
            own = part.prediction.rms
            assert errors[key] == pytest.approx([own[name] for name in names], rel=1e-3)


def test_errors_in_units_of_the_noise_are_those_of_the_table(found: Improvement) -> None:
    """Relative errors follow from those of each output; both outputs have as many samples."""
    for errors, rms in (
        (found.base_error, found.base_rms),
        (found.final_error, found.steps[-1].rms),
    ):
        for key in ("train", "test"):
            expected = np.sqrt(np.mean((rms[key] / NOISE) ** 2))
            assert errors[key] == pytest.approx(expected, rel=1e-9)


def biased(seed: int, cubic: float = 0.0) -> Dataset:
    """Records of a ship whose gyro has another bias on each."""
    runs = zip(dataset(seed, cubic), BIASES, strict=True)
    return Dataset(part.with_outputs(part.outputs + np.array([0.0, size])) for part, size in runs)


def test_a_bias_of_each_record_is_a_candidate() -> None:
    """Gyro biases that differ between records are claimed as such, each with its size."""
    bias = sensor_bias("bias_r", "r", "rad/s", scale=0.01, per_record=True)
    candidates = [DAMPING, CANDIDATES[1], bias]
    result = improve(SHIP, biased(21), biased(22), candidates=candidates)
    assert [step.added for step in result.steps] == ["bias_r"]
    assert "E_bias_r" not in result.fit.names
    for own, truth in zip(result.fit.local_values, BIASES, strict=True):
        assert own["E_bias_r"] == pytest.approx(truth, abs=0.002)
    assert result.final_error["test"] == pytest.approx(1.0, abs=0.08)


@pytest.mark.slow
def test_a_bias_of_each_record_in_the_model_hides_nothing() -> None:
    """With record-wise biases in the nominal model the missing damping is found."""
    candidates = [DAMPING, CANDIDATES[1]]
    result = improve(SHIP + GYRO_BIAS, biased(31, N3), biased(32, N3), candidates=candidates)
    assert [step.added for step in result.steps] == ["cubic_damping"]
    assert abs(result.fit.values["n3"] - N3) < 4 * result.fit.std_errors["n3"]
    for own, truth in zip(result.fit.local_values, BIASES, strict=True):
        assert own["b_r"] == pytest.approx(truth, abs=0.003)
