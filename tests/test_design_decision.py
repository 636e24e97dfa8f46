"""Stop or go on: goals, the next run, and what it buys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_design import LIMITS, ship

from oed_sysid import Dataset, Experiment, Limits, MultipleShooting
from oed_sysid.cli.answers import of_decision
from oed_sysid.design import (
    Candidate,
    ParameterGoal,
    PredictionGoal,
    candidate_runs,
    decide,
    goals_of,
)
from oed_sysid.errors import DesignError
from oed_sysid.manoeuvres import Doublet
from oed_sysid.sensitivity import information_of
from oed_sysid.simulation import simulate

PATTERN = Experiment("pattern", duration=40.0, sample_time=0.5)
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
    return MultipleShooting(disturbances="none", noise="given").fit(ship(), Dataset((record,)))


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
    enough = decide(fit, candidates, goals_of(fit.model, {"all": 1.05 * worst}), rng=rng)
    assert of_decision(enough, 1, 0.09) == (
        "STOP after 1 run, 0.09 h: everything asked for is known well enough."
    )
    assert enough.stop
    assert enough.action == "enough"
    assert enough.report().startswith("STOP: everything")
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
    assert of_decision(late, 2, 0.2).endswith(f"that is left ({met} of {n} goals met).")


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
    assert found.n_checked == 21
    assert found.kept is not None
    assert found.kept >= 0.95
    words = of_decision(found, 1, 0.1)
    assert words.startswith(f"GO ON after 1 run, 0.1 h: {found.next_run.name} next (0.094 h)")
    assert f"limits kept on {found.kept:.0%} of 21 possible vehicles" in words
    assert f"kept on {found.kept:.0%} of 21 vehicles" in found.report()
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
