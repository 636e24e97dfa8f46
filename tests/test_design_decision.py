"""Stop or go on: goals, the next run, and what it buys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_design import LIMITS, ship

from oed_sysid import Dataset, Experiment, Limits, MultipleShooting
from oed_sysid.design import (
    Candidate,
    ParameterGoal,
    PredictionGoal,
    candidate_runs,
    decide,
    goals_of,
)
from oed_sysid.errors import DesignError
from oed_sysid.experiments.manoeuvres import Doublet, ThreeTwoOneOne
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information import information_of

PATTERN = Experiment("pattern", duration=40.0, sample_time=0.5)
WHITE = MultipleShooting(disturbances="none", noise="given")
TURN = Experiment("turn", Doublet("rudder", 0.2, pulse_time=5.0), duration=20.0, sample_time=0.5)


@pytest.fixture(name="candidates", scope="module")
def _candidates() -> tuple[Candidate, ...]:
    """Runs of every kind."""
    return candidate_runs(
        ship(), PATTERN, limits=LIMITS, rng=np.random.default_rng(0), turnaround=300.0
    )


@pytest.fixture(name="fit", scope="module")
def _fit(candidates: tuple[Candidate, ...]) -> object:
    """What is known after one gentle run."""
    gentle = next(run for run in candidates if run.kind == "zigzag").experiment
    record = simulate(ship(), gentle, rng=np.random.default_rng(1))
    return WHITE.fit(ship(), Dataset((record,)))


def test_the_next_run_buys_most_of_all(fit, candidates) -> None:
    """No other safe candidate lowers the errors that are asked for further per hour."""
    goals = goals_of(fit.model, {"all": 0.005})
    found = decide(fit, candidates, goals, rng=np.random.default_rng(0))
    assert found.action == "go on"
    assert found.next_run is not None
    sizes = np.abs([fit.model.values[n] for n in fit.names])

    def left(run: Candidate) -> float:
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
    met = goals_of(fit.model, {"all": 1.05 * worst})
    check = decide(fit, candidates, met, rng=rng)
    assert check.is_check
    assert check.runs_left == 1
    assert check.next_run is not None
    again = simulate(ship(), check.next_run.experiment, rng=np.random.default_rng(2))
    both = WHITE.fit(ship(), Dataset((*fit.dataset, replace(again, name="check"))))
    enough = decide(both, candidates, met, rng=rng)
    assert enough.answer(2, 0.18) == (
        "STOP after 2 runs, 0.18 h: everything asked for is known well enough."
    )
    assert enough.stop
    assert enough.action == "enough"
    assert enough.contradiction is None
    assert enough.report().startswith("STOP: everything")
    closed = decide(fit, [c for c in candidates if c.kind != "straight"], met, rng=rng,
                    limits=Limits(signals={"psi": (-1e-6, 1e-6)}))  # fmt: skip
    assert closed.action == "unchecked"
    some, more = (
        decide(fit, candidates, goals_of(fit.model, {"all": share * worst}), rng=rng)
        for share in (0.5, 0.01)
    )
    assert 1 <= some.runs_left < more.runs_left
    assert some.hours_left == pytest.approx(some.runs_left * 340.0 / 3600.0)
    late = decide(fit, candidates, goals_of(fit.model, {"all": 0.5 * worst}), rng=rng, hours=0.05)
    assert late.action == "no time"
    n = len(fit.names)
    met = sum(one.is_met for one in late.goals)
    assert late.answer(2, 0.2).endswith(f"that is left ({met} of {n} goals met).")


def test_a_run_that_all_but_meets_a_goal_is_no_reason_to_go_home(fit, candidates) -> None:
    """A goal that is missed by a thousandth is met by the next run, and not called hopeless."""
    errors = np.array(list(fit.std_errors.values()))
    worst = float((errors / np.abs(list(fit.values.values()))).max())
    goals = goals_of(fit.model, {"all": worst / 1.001})
    found = decide(fit, candidates, goals, rng=np.random.default_rng(0))
    assert sum(not one.is_met for one in found.goals) == 1
    assert found.action == "go on"
    assert found.runs_left == 1
    assert all(one.then <= one.goal.tolerance for one in found.goals)


def test_runs_that_contradict_one_another_are_not_enough(candidates) -> None:
    """The model lacks quadratic damping: errors say that all is known, weak and strong runs not."""
    known = ship().parameter("c")
    linear = replace(
        ship(),
        parameters=tuple(
            replace(known, value=0.0, fixed=True) if p.name == "c" else p for p in ship().parameters
        ),
    )
    rng = np.random.default_rng(3)
    records = []
    for index, size in enumerate((0.1, 0.35)):
        run = Experiment(f"run {index + 1}", ThreeTwoOneOne("rudder", size, unit_time=5.0),
                         duration=60.0, sample_time=0.25)  # fmt: skip
        records.append(simulate(ship(), run, rng=rng))
    goals = goals_of(linear, {"all": 0.05})
    lacking = MultipleShooting().fit(linear, Dataset(tuple(records)))
    assert abs(lacking.values["d"] / 0.4 - 1.0) > 10 * lacking.std_errors["d"]
    found = decide(lacking, candidates, goals, rng=rng)
    assert all(one.is_met for one in found.goals)
    assert found.action == "contradicted"
    assert found.stop
    assert found.next_run is None
    assert found.contradiction is not None
    assert found.contradiction.chance < 0.01
    assert found.to_dict()["contradiction"]["freedom"] == 2
    assert found.report().startswith("STOP: on paper")
    assert "the records contradict it" in found.answer(2, 0.2)
    tighter = decide(lacking, candidates, goals_of(linear, {"all": 1e-4}), rng=rng)
    assert tighter.action == "go on"
    assert tighter.contradiction is not None
    assert tighter.answer(2, 0.2).startswith("WARNING")
    right = MultipleShooting().fit(ship(), Dataset(tuple(records)))
    assert decide(right, candidates, goals_of(ship(), {"all": 0.05}), rng=rng).action == "enough"


def test_errors_between_records_are_those_of_the_decision(candidates) -> None:
    """A fit that states errors between its records is judged by these."""
    run = next(run for run in candidates if run.kind == "3-2-1-1").experiment
    rng = np.random.default_rng(4)
    records = tuple(replace(simulate(ship(), run, rng=rng), name=f"run {i}") for i in range(5))
    fit = WHITE.fit(ship(), Dataset(records)).with_record_errors()
    found = decide(fit, candidates, goals_of(fit.model, {"all": 0.001}), rng=rng)
    stated = [fit.record_errors[n] / abs(fit.values[n]) for n in fit.names]
    usual = fit.information.std_errors / np.abs(fit.estimates)
    np.testing.assert_allclose([one.now for one in found.goals], stated, rtol=1e-5)
    assert np.abs(np.array(stated) / usual - 1.0).max() > 0.1


def test_a_prediction_is_a_goal(fit, candidates) -> None:
    """The deviation of a predicted heading is that of the linear theory, and falls."""
    goal = PredictionGoal(TURN, "psi", 1e-5)
    found = decide(fit, candidates, [goal], rng=np.random.default_rng(0))
    rows = goal.rows(fit.model, fit.names)
    expected = np.sqrt(np.einsum("ij,jk,ik->i", rows, fit.information.covariance, rows).max())
    assert found.goals[0].now == pytest.approx(expected, rel=1e-4)
    assert found.goals[0].then < 0.9 * found.goals[0].now


def test_runs_that_may_leave_their_limits_are_refused(fit, candidates) -> None:
    """Narrower limits than those of the library lead to gentler runs, or to none."""
    goals = goals_of(fit.model, {"all": 0.001})
    narrow = Limits(signals={"psi": (-0.25, 0.25)})
    found = decide(fit, candidates, goals, rng=np.random.default_rng(0), limits=narrow)
    assert found.refused
    assert found.next_run is not None
    motion = simulate(fit.model, replace(found.next_run.experiment, limits=Limits()), noise=False)
    assert np.abs(motion.output("psi")).max() <= 0.25
    assert found.assurance is not None
    assert found.assurance.n_checked == 201
    assert found.kept is not None
    assert found.kept >= 0.95
    words = found.answer(1, 0.1)
    assert words.startswith(f"GO ON after 1 run, 0.1 h: {found.next_run.name} next (0.094 h)")
    assert found.assurance.report() in words
    none = Limits(signals={"psi": (-1e-6, 1e-6)})
    closed = decide(fit, [c for c in candidates if c.kind != "straight"], goals,
                    rng=np.random.default_rng(0), limits=none)  # fmt: skip
    assert closed.action == "useless"


def test_decision_takes_less_than_a_second(fit, candidates) -> None:
    """On board nobody waits: one decision over the whole library, warm."""
    goals = goals_of(fit.model, {"all": 0.005})
    import time

    began = time.process_time()
    decide(fit, candidates, goals, rng=np.random.default_rng(0))
    assert time.process_time() - began < 1.0


def test_goals_that_do_not_fit_are_named(fit, candidates) -> None:
    """Unknown parameters, outputs and empty lists are said."""
    rng = np.random.default_rng(0)
    with pytest.raises(DesignError, match="'q' is no free parameter"):
        goals_of(fit.model, {"q": 0.1})
    with pytest.raises(DesignError, match="no output of model"):
        decide(fit, candidates, [PredictionGoal(TURN, "x", 1.0)], rng=rng)
    with pytest.raises(DesignError, match="Give both"):
        decide(fit, candidates, [], rng=rng)
    with pytest.raises(DesignError, match="Give a share"):
        ParameterGoal("b", 0.0)
