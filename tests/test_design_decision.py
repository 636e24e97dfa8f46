"""Stop or go on, and experiments for missing physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from test_design import LIMITS, TURN, assert_slope, quick, sea, ship, straight, weak_and_strong

from oed_sysid import Dataset, Experiment, Force, Limits, MultipleShooting, Parameter, design
from oed_sysid.design.criteria import Setting, log_power, told_apart
from oed_sysid.errors import DesignError
from oed_sysid.experiments.manoeuvres import Doublet
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information import commanded_runs, information_of
from oed_sysid.information.bound import RunInformation
from oed_sysid.information.shifts import Shifts

PATTERN = Experiment("pattern", duration=40.0, sample_time=0.5)
WHITE = MultipleShooting(disturbances="none", noise="given")


@pytest.fixture(name="candidates", scope="module")
def _candidates() -> tuple[design.Candidate, ...]:
    """Runs of every kind that does not react, and two zigzags, which take far longer."""
    runs = design.candidate_runs(
        ship(), PATTERN, limits=LIMITS, rng=np.random.default_rng(0), turnaround=300.0
    )
    kept = ("zigzag 5/5", "zigzag 20/20")
    return tuple(run for run in runs if run.name in kept or not run.experiment.reacts)


@pytest.fixture(name="fit", scope="module")
def _fit(candidates: tuple[design.Candidate, ...]) -> object:
    """What is known after one gentle run."""
    gentle = next(run for run in candidates if run.kind == "zigzag").experiment
    record = simulate(ship(), gentle, rng=np.random.default_rng(1))
    return WHITE.fit(ship(), Dataset((record,)))


def test_the_next_run_buys_most_of_all(fit, candidates) -> None:
    """No other safe candidate lowers the errors that are asked for further per hour."""
    goals = design.goals_of(fit.model, {"all": 0.005})
    found = design.decide(fit, candidates, goals, rng=np.random.default_rng(0))
    assert found.action == "go on"
    sizes = np.abs([fit.model.values[n] for n in fit.names])

    def left(run: design.Candidate) -> float:
        known = information_of(fit.model, run.experiment, noise=fit.sigma, priors=fit.information)
        return float(np.sum(np.log(np.maximum(known.std_errors / sizes, 0.005))))

    others = [left(run) for run in candidates if run.name not in found.refused]
    assert left(found.next_run) == pytest.approx(min(others), abs=1e-6)
    after = information_of(
        fit.model, found.next_run.experiment, noise=fit.sigma, priors=fit.information
    )
    np.testing.assert_allclose(
        [one.then for one in found.goals], after.std_errors / sizes, rtol=1e-5
    )


def test_it_stops_when_enough_is_known_and_forecasts_the_rest(fit, candidates) -> None:
    """Goals that are met end the trial; tighter ones need as many runs as are foretold."""
    errors = np.array(list(fit.std_errors.values()))
    worst = float((errors / np.abs(list(fit.values.values()))).max())
    rng = np.random.default_rng(0)
    met = design.goals_of(fit.model, {"all": 1.05 * worst})
    check = design.decide(fit, candidates, met, rng=rng)
    assert check.action == "go on"
    assert not check.unmet
    assert check.runs_left == 1
    again = simulate(ship(), check.next_run.experiment, rng=np.random.default_rng(2))
    both = WHITE.fit(ship(), Dataset((*fit.dataset, replace(again, name="check"))))
    enough = design.decide(both, candidates, met, rng=rng)
    assert enough.answer(2, 0.18) == (
        "STOP after 2 runs, 0.18 h: everything asked for is known well enough."
    )
    assert enough.stop
    assert enough.action == "enough"
    assert enough.contradiction is None
    assert enough.report().startswith("STOP: everything")
    closed = design.decide(fit, [c for c in candidates if c.kind != "straight"], met, rng=rng,
                    limits=Limits(signals={"psi": (-1e-6, 1e-6)}))  # fmt: skip
    assert closed.action == "unchecked"
    some, more = (
        design.decide(fit, candidates, design.goals_of(fit.model, {"all": share * worst}), rng=rng)
        for share in (0.5, 0.01)
    )
    assert 1 <= some.runs_left < more.runs_left
    assert some.hours_left == pytest.approx(some.runs_left * 340.0 / 3600.0)
    late = design.decide(
        fit, candidates, design.goals_of(fit.model, {"all": 0.5 * worst}), rng=rng, hours=0.05
    )
    assert late.action == "no time"
    n = len(fit.names)
    met = sum(one.is_met for one in late.goals)
    assert late.answer(2, 0.2).endswith(f"that is left ({met} of {n} goals met).")


@pytest.mark.slow
def test_a_run_that_all_but_meets_a_goal_is_no_reason_to_go_home(fit, candidates) -> None:
    """A goal that is missed by a thousandth is met by the next run, and not called hopeless."""
    errors = np.array(list(fit.std_errors.values()))
    worst = float((errors / np.abs(list(fit.values.values()))).max())
    goals = design.goals_of(fit.model, {"all": worst / 1.001})
    found = design.decide(fit, candidates, goals, rng=np.random.default_rng(0))
    assert sum(not one.is_met for one in found.goals) == 1
    assert found.action == "go on"
    assert found.runs_left == 1
    assert all(one.then <= one.goal.tolerance for one in found.goals)


def test_runs_that_contradict_one_another_are_not_enough(candidates) -> None:
    """The model lacks quadratic damping: errors say that all is known, weak and strong runs not."""
    linear, rng = straight(), np.random.default_rng(3)
    records = weak_and_strong(rng)
    goals = design.goals_of(linear, {"all": 0.05})
    lacking = WHITE.fit(linear, records)
    assert abs(lacking.values["d"] / 0.4 - 1.0) > 10 * lacking.std_errors["d"]
    found = design.decide(lacking, candidates, goals, rng=rng)
    assert all(one.is_met for one in found.goals)
    assert found.action == "contradicted"
    assert found.stop
    assert found.next_run is None
    assert found.contradiction.chance < 0.01
    assert found.to_dict()["contradiction"]["freedom"] == 2
    assert found.report().startswith("STOP: on paper")
    assert "the records contradict it" in found.answer(2, 0.2)
    tighter = design.decide(lacking, candidates, design.goals_of(linear, {"all": 1e-4}), rng=rng)
    assert tighter.action == "go on"
    assert tighter.contradiction is not None
    assert tighter.answer(2, 0.2).startswith("WARNING")
    right = WHITE.fit(ship(), records)
    assert (
        design.decide(right, candidates, design.goals_of(ship(), {"all": 0.05}), rng=rng).action
        == "enough"
    )


def test_errors_between_records_are_those_of_the_decision(candidates) -> None:
    """A fit that states errors between its records is judged by these."""
    run = next(run for run in candidates if run.kind == "3-2-1-1").experiment
    rng = np.random.default_rng(4)
    records = tuple(replace(simulate(ship(), run, rng=rng), name=f"run {i}") for i in range(5))
    fit = WHITE.fit(ship(), Dataset(records)).with_record_errors()
    found = design.decide(fit, candidates, design.goals_of(fit.model, {"all": 0.001}), rng=rng)
    stated = [fit.record_errors[n] / abs(fit.values[n]) for n in fit.names]
    usual = fit.information.std_errors / np.abs(fit.estimates)
    np.testing.assert_allclose([one.now for one in found.goals], stated, rtol=1e-5)
    assert np.abs(np.array(stated) / usual - 1.0).max() > 0.1


def test_a_prediction_is_a_goal(fit, candidates) -> None:
    """The deviation of a predicted heading is that of the linear theory, and falls."""
    goal = design.PredictionGoal(TURN, "psi", 1e-5)
    found = design.decide(fit, candidates, [goal], rng=np.random.default_rng(0))
    rows = goal.rows(fit.model, fit.names)
    expected = np.sqrt(np.einsum("ij,jk,ik->i", rows, fit.information.covariance, rows).max())
    assert found.goals[0].now == pytest.approx(expected, rel=1e-4)
    assert found.goals[0].then < 0.9 * found.goals[0].now


def test_runs_that_may_leave_their_limits_are_refused(fit, candidates) -> None:
    """Narrower limits than those of the library lead to gentler runs, or to none."""
    goals = design.goals_of(fit.model, {"all": 0.001})
    narrow = Limits(signals={"psi": (-0.25, 0.25)})
    found = design.decide(fit, candidates, goals, rng=np.random.default_rng(0), limits=narrow)
    assert found.refused
    motion = simulate(fit.model, replace(found.next_run.experiment, limits=Limits()), noise=False)
    assert np.abs(motion.output("psi")).max() <= 0.25
    assert found.assurance.n_checked == 200
    assert found.kept is not None
    assert found.kept >= 0.95
    words = found.answer(1, 0.1)
    assert words.startswith(f"GO ON after 1 run, 0.1 h: {found.next_run.name} next (0.094 h)")
    assert found.assurance.report() in words
    none = Limits(signals={"psi": (-1e-6, 1e-6)})
    closed = design.decide(fit, [c for c in candidates if c.kind != "straight"], goals,
                    rng=np.random.default_rng(0), limits=none)  # fmt: skip
    assert closed.action == "useless"


def test_goals_that_do_not_fit_are_named(fit, candidates) -> None:
    """Unknown parameters, outputs and empty lists are said."""
    rng = np.random.default_rng(0)
    with pytest.raises(DesignError, match="no 'q'"):
        design.goals_of(fit.model, {"q": 0.1})
    with pytest.raises(DesignError, match="no output"):
        design.decide(fit, candidates, [design.PredictionGoal(TURN, "x", 1.0)], rng=rng)
    with pytest.raises(DesignError, match="Give both"):
        design.decide(fit, candidates, [], rng=rng)
    with pytest.raises(DesignError, match="Give a share"):
        design.ParameterGoal("b", 0.0)


CUBIC = Force("cubic", {"r": "-E_cubic*r**3"}, (Parameter("E_cubic", 0.0, scale=30.0),))
SINES = Force(
    "sines",
    {"r": "E_cos*cos(0.4*t) + E_sin*sin(0.4*t)"},
    (Parameter("E_cos", 0.0, scale=2e-4), Parameter("E_sin", 0.0, scale=2e-4)),
)
# A kink at zero: its amplitude has no tangent there.
DEAD = Force(
    "dead",
    {"r": "-E_dead*psi/(0.05 + abs(psi))"},
    (Parameter("E_dead", 0.0, lower=0.0, scale=4e-4),),
)
EFFECTS = (CUBIC, SINES, DEAD)
RUN = Experiment("doublet", Doublet("rudder", 0.2, pulse_time=10.0), duration=40.0, sample_time=0.5)


def setting(shifts: Shifts) -> Setting:
    """What a criterion is bound to, three parameters of the ship and some effects."""
    return Setting(ship(), ship().free_names, np.ones(3), np.ones(2), shifts)


@pytest.mark.parametrize(
    "criterion",
    [
        design.Detect(EFFECTS),
        design.Detect(EFFECTS, worst=True),
        design.Discriminate(EFFECTS, size=1.0),
    ],
    ids=lambda c: c.name,
)
def test_gradients_by_the_information_equal_differences(criterion: design.Detect) -> None:
    """Mean and smallest chance, and pairs with several amplitudes, have exact derivatives."""
    shifts = criterion.shifts(ship())
    assert len(shifts) == 4
    measure = criterion.bind(setting(shifts))
    rng = np.random.default_rng(1)
    assert_slope(measure, 0.6 * rng.standard_normal((40, 7)), rng)


def test_power_is_the_share_of_simulated_tests_that_exceed_the_threshold() -> None:
    """The power of a test is what repetitions with Gaussian noise show."""
    rng = np.random.default_rng(0)
    for freedom, gain, needed in ((1, 10.0, 13.4), (3, 20.0, 17.0)):
        draws = rng.standard_normal((40_000, freedom))
        draws[:, 0] += np.sqrt(gain)
        share = np.mean((draws**2).sum(axis=1) > needed)
        assert np.exp(log_power(gain, freedom, needed)[0]) == pytest.approx(share, abs=0.01)


def test_concave_log_power_keeps_the_certificate() -> None:
    """Halfway between two informations the mean log chance is at least the mean of both."""
    criterion = design.Detect(EFFECTS)
    measure = criterion.bind(setting(criterion.shifts(ship())))
    rng = np.random.default_rng(2)
    for _ in range(40):
        ends = [rng.standard_normal((9, 7)) * np.exp(rng.normal(0, 1, 7)) for _ in range(2)]
        first, second = (rows.T @ rows for rows in ends)
        middle = measure(0.5 * (first + second))[0]
        assert middle >= 0.5 * (measure(first)[0] + measure(second)[0]) - 1e-9


def test_parameters_keep_their_information_beside_shifts() -> None:
    """With shifts beside them and under disturbance forces, parameters keep their information."""
    model = ship()
    shifts = Shifts.of(model, EFFECTS)
    n = len(model.free_parameters)
    for noise in (None, sea(0.005)):
        joint = RunInformation(model, noise, shifts=shifts).matrix(RUN)
        alone = information_of(model, RUN, noise=noise, priors=None).matrix
        np.testing.assert_allclose(joint[:n, :n], alone, rtol=1e-7)
    white = RunInformation(model, None, shifts=shifts).matrix(RUN)
    weak = RunInformation(model, sea(1e-12), shifts=shifts).matrix(RUN)
    assert white is not None
    assert weak is not None
    sizes = np.sqrt(np.diag(white))
    np.testing.assert_allclose(weak / sizes / sizes[:, None], white / sizes / sizes[:, None],
                               atol=1e-6)  # fmt: skip


@pytest.mark.parametrize("effect", [CUBIC, DEAD], ids=lambda e: e.name)
def test_expected_gain_is_what_a_refit_gains(effect: Force) -> None:
    """Noise-free data with an effect of its size: the nominal model misses them by its gain."""
    model = ship()
    effect = effect.with_values({p.name: 0.1 * p.magnitude for p in effect.parameters})
    data = Dataset((simulate(model + effect, RUN, noise=False),))
    plain = MultipleShooting(noise="given", coloured="never", disturbances="none").fit(model, data)
    criterion = design.Detect([effect])
    shifts = criterion.shifts(model)
    matrix = RunInformation(model, None, shifts=shifts).matrix(RUN)
    assert matrix is not None
    (found,) = criterion.detections(shifts, 0 * matrix, matrix, len(model.free_parameters))
    assert found.gain_before == pytest.approx(0.0, abs=1e-9)
    assert 2 * plain.cost == pytest.approx(found.gain_after, rel=0.3)


def test_a_design_reveals_what_the_records_could_not_show() -> None:
    """After a fit its records count, and the run makes visible what they leave hidden."""
    model = ship()
    truth = simulate(model, replace(RUN, limits=Limits()), rng=np.random.default_rng(0))
    fit = replace(WHITE, coloured="never").fit(model, Dataset((truth,)))
    hidden = CUBIC.with_values({"E_cubic": 20.0})
    found = design.design_experiment(
        fit,
        design.Trial(limits=LIMITS, duration=40.0, sample_time=0.5),
        criterion=design.Detect([hidden, DEAD]),
        rng=np.random.default_rng(0),
        search=design.Search(n_starts=1, n_candidates=15, n_steps=6, n_workers=1),
        caution=None,
    )
    cubic = found.chances[0]
    shifts = Shifts.of(fit.model, [hidden])
    (given,) = commanded_runs(fit.model, fit.dataset, initial_states=fit.initial_states)
    factor = RunInformation(fit.model, fit.sigma, shifts=shifts).factor(given)
    told = factor.T @ factor
    n = len(fit.model.free_parameters)
    left = told[n, n] - told[n, :n] @ np.linalg.solve(told[:n, :n], told[:n, n])
    assert cubic.gain_before == pytest.approx(left, rel=1e-3)
    assert cubic.before < 0.2 < 0.9 < cubic.after
    assert cubic.least < 1.0
    # Of one amplitude: a normal variable beyond either end, 1 % of false claims over two effects.
    seen, edge = cubic.least * np.sqrt(cubic.gain_after), norm.isf(0.5 * 0.01 / 2)
    assert norm.sf(edge - seen) + norm.cdf(-edge - seen) == pytest.approx(0.9, abs=1e-9)
    assert "would show at their usual size" in found.report()
    assert found.to_dict()["chances"][0]["after"] == cubic.after


def test_told_apart_rises_with_the_misfit_and_wrong_wishes_are_refused() -> None:
    """Certainty comes with the misfit; candidates must be there, each once, and of some size."""
    values = [told_apart(misfit) for misfit in (0.0, 2.0, 6.0, 16.0, 40.0)]
    assert values == sorted(values)
    assert values[0] == 0.0
    assert values[-1] > 0.99
    for wrong in ({"candidates": ()}, {"candidates": (CUBIC, CUBIC)},
                  {"candidates": (CUBIC,), "size": 0.0}):  # fmt: skip
        with pytest.raises(DesignError):
            design.Detect(**wrong)
    with pytest.raises(DesignError, match="no amplitude"):
        quick(criterion=design.Detect([replace(CUBIC, amplitudes=())]))


def test_a_programme_is_chosen_for_what_it_reveals() -> None:
    """Whole runs are chosen by the chance to show an effect, within the certificate."""
    pattern = Experiment("pattern", duration=40.0, sample_time=0.5, constants={})
    hidden = CUBIC.with_values({"E_cubic": 10.0})
    found = design.design_programme(
        ship(),
        pattern,
        limits=LIMITS,
        rng=np.random.default_rng(0),
        criterion=design.Detect([hidden]),
        certainty=0.5,
        budget=design.Budget(n_runs=2),
        search=design.ProgrammeSearch(kinds=("zigzag",), n_draws=1, n_vehicles=2, n_rounds=0),
        knowledge=design.Knowledge(spread=0.1),
    )
    assert found.value <= found.bound + 1e-9
    (chance,) = found.chances
    assert chance.after > chance.before
    shifts = Shifts.of(found.model, [hidden])
    best = 0.0
    for run in found.candidates:
        told = RunInformation(found.model, shifts=shifts).matrix(run.experiment)
        left = told[3, 3] - told[3, :3] @ np.linalg.pinv(told[:3, :3]) @ told[:3, 3]
        best = max(best, float(left))
    assert chance.gain_after >= best * 0.999
    assert "cubic" in found.report()
