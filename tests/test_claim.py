"""The one claim and the filter that serves it: statistic, threshold, bounds, groups."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from altered import with_outputs
from marks import slow
from motion import small
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.stats import chi2
from turning_ship import CANDIDATES, CUBIC, NOISE, SAMPLE, SHIP, dataset, improved, rates
from yaw_vehicle import NOISE as NOISE_YAW
from yaw_vehicle import yaw_data, yaw_model

from oed_sysid import (
    Dataset,
    Force,
    Input,
    Model,
    NoiseModel,
    Output,
    Parameter,
    Record,
    State,
    improve,
)
from oed_sysid.errors import DataError
from oed_sysid.evidence.chance import FALSE_CLAIMS, threshold
from oed_sysid.evidence.claim import Claim, at_bounds, claim, independent_share
from oed_sysid.evidence.rank import pairs, rank
from oed_sysid.evidence.score import two_sided
from oed_sysid.evidence.study import RISE, RISE_DISTURBED, Study, usual, worse
from oed_sysid.evidence.usual import usual_effects
from oed_sysid.likelihood.disturbances import disturbed_equations
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.noise_model import Levels
from oed_sysid.likelihood.smoother import Path
from oed_sysid.physics import sensor_bias, sensor_delay, sensor_lag, sensor_scale
from oed_sysid.physics.table import POLYNOMIAL

# Knots in a metre per second.
KNOTS = 3600.0 / 1852.0
BIASED = Force("push", {"r": "E_push"}, (Parameter("E_push", 0.0, "rad/s^2", scale=0.01),))


@pytest.mark.parametrize(("count", "freedom", "trials"), [(1, 1, 1.0), (40, 2, 1.0), (40, 3, 25.0)])
def test_threshold_is_the_quantile_for_all_that_was_tried(
    count: int, freedom: int, trials: float
) -> None:
    """Chance exceeds it in one of a hundred searches: checked with SciPy's quantile."""
    expected = chi2.isf(FALSE_CLAIMS / (count * trials), freedom)
    assert threshold(count, freedom, trials=trials) == pytest.approx(expected, rel=1e-9)


FORTY = threshold(40, 1)


@pytest.mark.parametrize(
    ("training", "validation", "needed", "before", "after", "beyond", "decision"),
    [
        # Validation runs that hardly move need not gain.
        (18.1, 1.1, FORTY, 1.0, 1.0, None, "stands"),
        (18.1, np.nan, FORTY, np.nan, np.nan, None, "stands"),
        (12.0, 1.0, FORTY, 1.0, 1.0, None, "T below threshold"),
        (20.0, -9.0, FORTY, 1.0, 1.0, None, "T below threshold"),
        (90.0, 80.0, FORTY, 1.0, 1.03, None, "whole runs get worse"),
        (90.0, 80.0, FORTY, 1.0, np.inf, None, "whole runs get worse"),
        (90.0, 80.0, FORTY, 1.0, 0.5, 13.5, "at its bound (E_x), 13.5 likelier beyond"),
        (90.0, 80.0, FORTY, 1.0, 0.5, 13.3, "stands, at its bound (E_x)"),
        # A term in the place of two effects needs less than nothing; no bound, nothing beyond it.
        (887.0, 574.0, -9.0, 2.4, 1.0, None, "stands"),
        (887.0, 574.0, -9.0, 2.4, 1.0, 0.5, "at its bound (E_x), 0.5 likelier beyond"),
    ],
)
def test_decision_needs_all_three_conditions(
    training: float,
    validation: float,
    needed: float,
    before: float,
    after: float,
    beyond: float | None,
    decision: str,
) -> None:
    """The total statistic, whole runs that do not rise, and little beyond the size's bounds."""
    bounds = () if beyond is None else ("E_x",)
    one = Claim("x", training, validation, needed, before, after, RISE, bounds, beyond or 0.0)
    assert one.decision == decision
    assert one.stands == decision.startswith("stands")


def test_statistic_of_a_search_is_that_of_its_fits() -> None:
    """Both terms come again from the two fits, and the report prints every decision."""
    found = improved()
    step, one = found.steps[0], found.decisions[0]
    assert one.name == "cubic_damping"
    assert step.claim is one
    training = 2.0 * (found.fit.log_likelihood - found.base_fit.log_likelihood)
    assert step.claim.training == pytest.approx(training, abs=0.5)
    text = found.report()
    for number in (one.training, one.validation, one.statistic, one.needed):
        assert f"{number:.1f}" in text
    assert "T below threshold" in text or len(found.decisions) == 1


def test_prediction_of_validation_records_is_laplaces_approximation() -> None:
    """On linear Gaussian records the statistic is the closed form of the predictive density."""
    train, test = dataset(3), dataset(4)
    study, base = Study.begin(SHIP, train, test, [BIASED], known_noise=True, disturbances="none")
    found = study.estimate(study.candidates, base.values, base, max_iterations=25)
    one = claim(study, base, found, study.candidates, 10.0)
    assert one.training == pytest.approx(base.objective - found.objective)
    # An absent effect: validation records lose about what its uncertainty costs.
    assert -10.0 < one.validation < 5.0
    assert not one.stands


def test_correlated_innovations_count_as_fewer_where_no_process_noise_explains_them() -> None:
    """All samples count where the model is right or process noise acts; else the independent."""
    right, lacking = dataset(3), dataset(11, -15.0)
    shares = {}
    for name, train, forces in (
        ("right", right, "none"),
        ("lacking", lacking, "none"),
        ("disturbed", lacking, "auto"),
    ):
        study, base = Study.begin(SHIP, train, None, [], known_noise=True, disturbances=forces)
        shares[name] = independent_share(study, base)
    assert shares["right"] == shares["disturbed"] == 1.0
    assert 0.0 < shares["lacking"] < 0.5


@pytest.mark.slow
def test_size_that_a_bound_holds_back_is_no_claim_and_one_without_declared_bound_goes_on() -> None:
    """A declared bound holds and is named; twenty typical sizes are no bound of the vehicle."""
    train, test = dataset(11, -15.0), dataset(12, -15.0)
    narrow = CUBIC.parameters[0].name
    declared, by_size = (
        replace(CUBIC, parameters=(Parameter(narrow, 0.0, "s/rad^2", -most, most, scale=scale),))
        for most, scale in ((5.0, 1.0), (2.0, 0.1))
    )
    held = improve(SHIP, train, test, candidates=[declared], terms=False)
    assert not held.steps
    told = f"at its bound ({narrow})"
    assert any(one.decision.startswith(told) and one.held for one in held.decisions)
    by_chance = replace(declared, parameters=(replace(declared.parameters[0], lower=-14.9),))
    rests = improve(SHIP, train, test, candidates=[by_chance], terms=False)
    assert rests.decisions[0].decision == f"stands, {told}"
    assert f"{narrow} = -14.9 s/rad^2, at its bound" in rests.report()
    freed = improve(SHIP, train, test, candidates=[by_size], terms=False)
    assert [step.added for step in freed.steps] == ["cubic_damping"]
    value, error = freed.fit.values[narrow], freed.fit.std_errors[narrow]
    assert abs(value + 15.0) < 3.0 * error


def test_a_sensor_that_stands_still_has_no_size_of_lag() -> None:
    """A lag without end is no claim."""
    train = yaw_data(3)
    rng = np.random.default_rng(5)

    def dead(record: Record) -> np.ndarray:
        still = 0.02 + NOISE_YAW[1] * rng.standard_normal(record.n_samples)
        return np.column_stack([record.outputs[:, 0], still])

    lag = sensor_lag("late", "r", scale=1.0)
    study, fit = Study.begin(
        yaw_model(), with_outputs(train, dead), None, (lag,), known_noise=False
    )
    ended = study.estimate((lag.widened(),), {**fit.values, "E_late": 1e7}, fit)
    assert ended is not None
    asked = claim(study, fit, ended, (lag,), 10.0)
    assert asked.statistic > asked.needed
    assert not asked.stands
    assert np.isinf(asked.beyond)


@pytest.mark.slow
def test_a_rate_in_knots_has_a_size_of_scale() -> None:
    """A scale goes as far as the records say, to 1.944."""
    train, test = yaw_data(3), yaw_data(4)

    def knots(record: Record) -> np.ndarray:
        return record.outputs * [1.0, KNOTS]

    found = improve(
        yaw_model(), with_outputs(train, knots), with_outputs(test, knots),
        candidates=(sensor_scale("scale", "r"), sensor_bias("bias", "r", "rad/s", scale=0.01)),
    )  # fmt: skip
    assert [step.added for step in found.steps] == ["scale"]
    error = found.fit.std_errors["E_scale"]
    assert found.fit.values["E_scale"] == pytest.approx(KNOTS - 1.0, abs=3.5 * error)
    assert error < 0.05


def test_what_noise_hid_in_the_nominal_fit_joins_the_group_beside_the_improved_one() -> None:
    """On a spring, the bias of a displacement and a constant force are one, however large."""
    step = expm(0.1 * np.array([[0.0, 1.0, 0.0], [-0.5, -1.0, 1.0], [0.0, 0.0, 0.0]]))

    def run(name: str, seed: int) -> Record:
        rng, times = np.random.default_rng(seed), 0.1 * np.arange(400)
        pushes = np.repeat(rng.uniform(-1.0, 1.0, 16), 25)
        states = np.zeros((400, 2))
        for k in range(399):  # exact for a held push, which acts as a third state
            states[k + 1] = (step @ [*states[k], pushes[k]])[:2]
        outputs = states + [8.0, 0.0] + 0.01 * rng.standard_normal(states.shape)
        return Record(name, times, pushes[:, None], outputs, moored.channels)

    law = {"x": "v", "v": "b*push - d*v - k*x"}
    values = {"b [1]": 0.8, "d [1/s]": 1.2, "k [1/s^2]": 0.4}
    moored = small("moored", "x [m], v [m/s] <- push [m/s^2]", law, values, 0.01, step=0.1)
    force = Force("force", {"v": "E_force"}, (Parameter("E_force", 0.0, "m/s^2", scale=0.1),))
    found = improve(
        moored, Dataset((run("a", 1), run("b", 2))), Dataset((run("c", 3),)),
        candidates=(force, sensor_bias("bias", "x", "m", scale=0.1)), terms=False,
    )  # fmt: skip
    assert [set(step.group) for step in found.steps] == [{"force", "bias"}]


def test_whole_runs_may_wander_under_process_noise_only() -> None:
    """A rise of a tenth is refused in calm water, and allowed where forces act: of what predicts.

    Where the validation records are less likely too, they speak against it in both ways.
    """
    sizes = (30.0, 20.0, 10.0, 1.0, 1.1)
    assert not Claim("x", *sizes, allowed=RISE).stands
    assert Claim("x", *sizes, allowed=RISE_DISTURBED).stands
    refused = Claim("x", 30.0, -5.0, 10.0, 1.0, 1.1, allowed=RISE_DISTURBED)
    assert (refused.statistic, refused.decision) == (25.0, "whole runs get worse")
    assert replace(refused, after=1.01).stands


@pytest.mark.parametrize(
    ("error", "likelier", "kept"),
    [(1.01, -3.0, "after"), (1.1, 3.0, "after"), (1.1, -3.0, "before"), (1.3, 3.0, "before")],
)
def test_a_stage_is_kept_as_a_claim_is(error: float, likelier: float, kept: str) -> None:
    """Beside process noise whole runs may be a tenth worse where the records are likelier."""
    predicted = {"before": 10.0, "after": 10.0 - likelier}
    study: Any = SimpleNamespace(
        validation=object(),
        rises=lambda *_, allowed=RISE_DISTURBED: worse(1.0, error, allowed),
        predict=lambda fit, _: SimpleNamespace(value=predicted[fit]),
    )
    stages: Any = ("before", "after")
    assert Study.kept(study, *stages) == kept


def test_what_stands_and_was_not_taken_says_why() -> None:
    """One of several that pass, and what does not pass anyway."""
    strong, weak = Claim("x", 30.0, 20.0, 10.0), Claim("y", 1.0, 2.0, 10.0)
    assert strong.passed_over("behind z").decision == "passes, behind z"
    assert weak.passed_over("behind z").decision == "T below threshold"


@pytest.mark.parametrize(
    ("term", "unit", "group"),
    [
        ("n_d*r**3", "s/rad^2", ("drag", "cubic_damping")),
        *slow(("n_d*r*abs(r)", "1/rad", ("cubic_damping",))),
    ],
)
def test_named_physics_leads_its_group(term: str, unit: str, group: tuple[str, ...]) -> None:
    """Of two that are as likely the named one leads; a clearly likelier polynomial stays first."""
    train, test = dataset(11, -15.0), dataset(12, -15.0)
    series = replace(CUBIC, source=POLYNOMIAL)
    drag = Force("drag", {"r": term}, (Parameter("n_d", 0.0, unit, scale=1.0),))
    heave = Force("heave", {"w": "n_w*w"}, (Parameter("n_w", 0.0, "1/s", scale=1.0),))
    found = improve(SHIP, train, test, candidates=[series, drag, heave], terms=False)
    assert found.steps[0].group[: len(group)] == group
    assert found.steps[0].added == group[0]
    # A candidate on signals of other vehicles is not asked, and named.
    assert [note for note in found.notes if "cannot take" in note and "heave" in note]


def test_zero_is_no_bound_of_an_amplitude_that_cannot_be_negative() -> None:
    """An amplitude at nothing is absent, not at its bound."""
    parameter = Parameter("E_lag", 0.0, "s", 0.0, 5.0, scale=0.25)
    effect = SimpleNamespace(amplitude_names=("E_lag",))
    for value, expected in ((0.0, ()), (2.0, ()), (5.0, ("E_lag",))):
        fit = SimpleNamespace(
            values={"E_lag": value},
            local=[],
            problem=SimpleNamespace(model=SimpleNamespace(free_parameters=(parameter,))),
        )
        assert at_bounds(fit, [effect]) == expected  # type: ignore[arg-type, list-item]


def test_pair_that_hides_each_other_is_found_together() -> None:
    """Where no single effect is worth a claim, two whose signatures oppose each other are."""
    train, test = dataset(11, -15.0), dataset(12, -15.0)
    study, base = Study.begin(SHIP, train, test, CANDIDATES, known_noise=False)
    ranking = rank(study, base, study.candidates)
    found = pairs(study, base, ranking)
    assert found
    assert "cubic_damping" in found[0].name
    assert found[0].gain > ranking.refits[0].gain - 0.5


N3 = -15.0


def flow(state: np.ndarray, rudder: float, push: float) -> np.ndarray:
    """Heading and yaw rate one sample later."""

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return rates(x, rudder, N3) + np.array([0.0, push])

    return solve_ivp(rate, (0.0, SAMPLE), state, rtol=1e-11, atol=1e-13).y[:, -1]


def test_moves_of_the_filter_are_derivatives_of_the_step() -> None:
    """Transition and force gain equal central differences of a tight adaptive integrator."""
    data = dataset(0, N3, 1)
    model = (SHIP + CUBIC).with_values({"K": 0.5, "T": 4.0, "n3": N3})
    noise = NoiseModel(NOISE, np.zeros(2), np.array([1e-3]), 1.0, 2.0, ("psi", "r"), ("force r",))
    levels = Levels.of(noise, noise)
    problem = Filtered(model, data, levels)
    unknowns = problem.point([data[0].outputs[0]]).unknowns
    part = problem.passes(unknowns, columns=False, gains=True, moves=True)[0]
    path = Path.of(part)
    assert part.moves is not None
    size = 1e-4
    for k in (10, 77, 150, 280):
        state, push = part.path[k, :2], part.path[k, 2]
        rudder = float(data[0].inputs[k, 0])
        for column in range(2):
            move = size * np.eye(2)[column]
            ends = [flow(state + sign * move, rudder, push) for sign in (1, -1)]
            slope = (ends[0] - ends[1]) / (2 * size)
            np.testing.assert_allclose(part.moves[k, :2, column], slope, atol=1e-5)
        ends = [flow(state, rudder, push + sign * size) for sign in (1, -1)]
        np.testing.assert_allclose(
            path.drive[k, :2, 0], (ends[0] - ends[1]) / (2 * size), atol=1e-5
        )
    np.testing.assert_allclose(part.gains[3, :, 0, :2], np.eye(2), atol=1e-12)  # type: ignore[index]


def test_only_equations_with_parameters_are_disturbed() -> None:
    """Heading is the integral of yaw rate by definition; yaw acceleration may lack physics."""
    assert disturbed_equations(SHIP) == ("r",)


def twin() -> tuple[Model, Dataset]:
    """The ship with two rudders alike, of which the second follows some samples later."""
    model = replace(
        SHIP,
        inputs=(*SHIP.inputs, Input("second", "rad", "second rudder")),
        kinematics={"psi": "r", "r": "(K*(delta_1 + 0.5*delta_2) - r)/T"},
        actuators={"delta_1": "rudder", "delta_2": "second"},
    )
    (one,) = dataset(1, N3, 1)
    inputs = np.column_stack([one.inputs, np.roll(one.inputs, 9)])
    return model, Dataset((Record(one.name, one.times, inputs, one.outputs, model.channels),))


@pytest.mark.parametrize("rudders", [1, 2])
def test_sub_models_of_a_study_are_the_models_themselves(rudders: int) -> None:
    """On the filter of all candidates each model has the likelihood it has on its own."""
    if rudders == 1:
        base, data, candidates = SHIP, dataset(1, N3, 1), CANDIDATES
        tried = [(), CANDIDATES[:1], CANDIDATES[::-1]]
    else:
        # What an offset moves goes through all that remembers both rudders, and is not there.
        base, data = twin()
        candidates = usual_effects(base, data)
        tried = [(one,) for one in candidates if one.name in ("delta_1_offset", "delta_2_gain")]
        assert len(tried) == 2
    study, fit = Study.begin(base, data, None, candidates, known_noise=False)
    assert len(study.candidates) == len(candidates)
    levels = study.levels(fit.noise, data)
    for effects in tried:
        values = fit.values | usual(effects)
        model = study.model(effects, values)
        through = Filtered(model, data, levels, kernel=study.kernel)
        alone = Filtered(model, data, levels)
        point = through.point(fit.initial)
        assert through.layout.free_names == alone.layout.free_names
        value = alone.objective(point.unknowns)
        assert through.objective(point.unknowns) == pytest.approx(value, rel=1e-9)
        matrix, right = through.gathered(point.unknowns, through.passes(point.unknowns))
        own_matrix, own_right = alone.gathered(point.unknowns, alone.passes(point.unknowns))
        np.testing.assert_allclose(matrix, own_matrix, rtol=1e-7, atol=1e-9 * own_matrix.max())
        size = np.sqrt(np.diag(own_matrix))
        np.testing.assert_allclose(right / size, own_right / size, atol=1e-6)


def test_a_candidate_that_does_not_fit_is_left_out() -> None:
    """A candidate on signals that the model lacks is skipped and named."""
    candidates = (*CANDIDATES, sensor_bias("bias_depth", "z", "m", scale=0.1))
    study, _ = Study.begin(SHIP, dataset(1, N3, 1), None, candidates, known_noise=True)
    assert [effect.name for effect in study.candidates] == [e.name for e in CANDIDATES]
    assert [two_sided(effect) for effect in study.candidates] == [True, True, False, True]


def test_known_noise_has_to_be_declared() -> None:
    """Levels that nobody declared cannot be taken as known, and the outputs are named."""
    with pytest.raises(DataError, match="psi, r"):
        Study.begin(yaw_model(), yaw_data(), None, [CUBIC], known_noise=True)


def test_validation_prefers_the_true_structure() -> None:
    """Records that were not fitted are likelier under the model with the hidden damping."""
    train, other = dataset(11, N3), dataset(12, N3)
    study, fit = Study.begin(SHIP, train, other, CANDIDATES, known_noise=False)
    right = study.estimate(study.candidates[:1], fit.values, fit, max_iterations=25)
    wrong = study.estimate(study.candidates[1:2], fit.values, fit, max_iterations=25)
    assert right is not None
    assert wrong is not None
    assert study.predict(fit, other).value - study.predict(right, other).value > 50.0
    assert study.predict(wrong, other).value - study.predict(right, other).value > 50.0
    np.testing.assert_allclose(study.rms(right, other), NOISE, rtol=0.12)
    assert np.all(study.rms(fit, other) > 1.3 * study.rms(right, other))


def driven(seed: int, late: float) -> Dataset:
    """A motor whose noisy current moves it and is its force, of autocorrelated noise, 50 ms apart.

    The force is ``late`` by some seconds; current in A, speed in m/s, force in N.
    """
    rng, times = np.random.default_rng(seed), np.arange(600) * MOTOR.step
    phases, speeds = rng.uniform(0.0, 2.0 * np.pi, 4), np.array([0.6, 1.7, 3.1, 4.4])
    # Of each sine both the current and the speed that it makes are known.
    angles = speeds * times[:, None] + phases
    answer = 22.0 / np.hypot(40.0, 85.0 * speeds), np.arctan2(85.0 * speeds, 40.0)
    speed = np.sum(answer[0] * np.sin(angles - answer[1]), axis=1)
    force = 22.0 * np.sum(np.sin(angles - late * speeds), axis=1)
    slow = np.array([lfilter([0.6], [1.0, -0.8], part) for part in rng.standard_normal((2, 600))])
    outputs = np.column_stack([speed + 0.006 * slow[0], force + slow[1]])
    current = np.sum(np.sin(angles), axis=1) + 0.01 * rng.standard_normal(600)
    record = Record(f"run_{seed}", times, current[:, None], outputs, MOTOR.channels)
    return Dataset((record,))


MOTOR = Model(
    "motor",
    (State("w", "m/s", scale=0.2),),
    (Input("i", "A", interpolation="linear"),),
    (
        Output("w", "m/s", noise_std=0.006),
        Output("F", "N", expression="k_i*i", noise_std=1.0),
    ),
    {"w": "(k_i*i - b*w)/85"},
    parameters=(Parameter("b", 40.0, "kg/s"), Parameter("k_i", 22.0, "N/A")),
    step=0.05,
)


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_what_averages_the_noise_of_an_input_is_no_delay(late: float) -> None:
    """Beside autocorrelated noise of a force a delay averages that of the current; a true one not.

    As logged, 0.3 % of noise on the current is worth a delay of a fortieth of a sample.
    """
    effect, needed = sensor_delay("late", "F"), threshold(1, 1)
    study, base = Study.begin(MOTOR, driven(3, late), None, [effect], known_noise=False)
    found = study.estimate([effect], dict(base.values) | {"E_late": 0.01}, base)
    assert base.objective - found.objective > needed
    decided = claim(study, base, found, [effect], needed)
    if late:
        assert decided.stands
        assert found.values["E_late"] == pytest.approx(late, abs=0.002)
    else:
        assert found.values["E_late"] == pytest.approx(0.0033, abs=0.0005)
        assert decided.decision == "T below threshold with inputs smoothed"


def test_what_makes_whole_runs_worse_is_no_headline_where_structure_is_left() -> None:
    """Forces let runs of the better model wander by chance only where nothing else is left."""
    found = improve(SHIP, dataset(11, -15.0), dataset(12, -15.0), candidates=CANDIDATES)
    assert found.headlined == found.steps
    before, (step,) = found.base_error["test"], found.steps
    open_ = replace(found.remains, unjudged=("something",))
    calm = replace(found.remains, unjudged=())
    for ratio, remains, verdict in (
        (0.99 * RISE, open_, "missing"),
        (1.01 * RISE, open_, "unexplained"),
        (1.01 * RISE, calm, "missing"),
        (np.inf, open_, "unexplained"),
    ):
        worsened = replace(step, errors={"train": 1.0, "test": ratio * before})
        told = replace(found, steps=(worsened,), remains=remains)
        assert told.verdict == verdict
        assert len(told.headlined) == (verdict == "missing")
    # A step after it was found beside it, and is no headline either.
    later = replace(step, errors={"train": 1.0, "test": 0.5 * before})
    first = replace(step, errors={"train": 1.0, "test": 0.8 * before})
    both = replace(found, steps=(first, worsened, later), remains=open_)
    assert both.headlined == (first,)
    assert both.verdict == "missing"
