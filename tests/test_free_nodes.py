"""The globalisation phase: from parameters far off to where the real problem begins."""

from __future__ import annotations

import numpy as np
import pytest
from yaw_vehicle import NOISE, TRUE, yaw_data, yaw_model

from oed_sysid.likelihood.gauss_newton import Convergence, Descent, Iterate
from oed_sysid.likelihood.shooting import Point, Shooting
from oed_sysid.likelihood.windows import CONTROL, Windows, climb
from oed_sysid.physics.parameters import Parameter

WILD = {"K": -0.4, "T": 30.0, "alpha": -40.0}


@pytest.mark.parametrize("n_samples", [2, 5, 20])
def test_short_intervals_come_close_from_far(n_samples: int) -> None:
    """Free-node intervals bring wild parameters to the neighbourhood of the truth."""
    shooting = Shooting(yaw_model().with_values(WILD), yaw_data(), NOISE)
    unknowns = climb(shooting, shooting.start_unknowns(), n_samples)
    assert unknowns[0] / unknowns[1] == pytest.approx(TRUE["K"] / TRUE["T"], rel=0.4)


def test_truth_stays_near_the_truth() -> None:
    """Started at the truth, the problem without continuity does not wander off."""
    shooting = Shooting(yaw_model(), yaw_data(), NOISE)
    unknowns = climb(shooting, shooting.start_unknowns(), 20)
    assert unknowns[0] == pytest.approx(TRUE["K"], rel=0.1)
    assert unknowns[1] == pytest.approx(TRUE["T"], rel=0.2)


def test_bounds_and_held_unknowns_are_respected() -> None:
    """Bounds hold on the way in, too."""
    model = yaw_model(T=Parameter("T", 30.0, lower=10.0, upper=40.0)).with_values(
        {"K": -0.4, "alpha": -40.0}
    )
    shooting = Shooting(model, yaw_data(), NOISE)
    unknowns = climb(shooting, shooting.start_unknowns(), 5)
    assert 10.0 <= unknowns[1] <= 40.0


def test_priors_are_respected() -> None:
    """A tight prior keeps a parameter where it is known to be."""
    model = yaw_model(alpha=Parameter("alpha", 12.0, prior_mean=30.0, prior_std=1e-3))
    shooting = Shooting(model, yaw_data(), NOISE)
    unknowns = climb(shooting, shooting.start_unknowns(), 5)
    assert unknowns[2] == pytest.approx(30.0, abs=0.01)


def test_result_is_a_point_of_the_real_problem() -> None:
    """The improved point can be linearised and is better than where it began."""
    shooting = Shooting(yaw_model().with_values(WILD), yaw_data(), NOISE)
    begin = shooting.start_point()
    point = shooting.start_point(climb(shooting, begin.unknowns, 5))
    before, after = shooting.linearise(begin), shooting.linearise(point)
    assert shooting.cost(after, point.unknowns) < 0.5 * shooting.cost(before, begin.unknowns)


def test_explosive_start_is_returned_unchanged() -> None:
    """Where even short intervals overflow, the start comes back as it was."""
    shooting = Shooting(yaw_model().with_values({"alpha": -1e12}), yaw_data(), NOISE)
    begin = shooting.start_unknowns()
    assert np.isfinite(climb(shooting, begin, 60)).all()


@pytest.mark.parametrize("horizon", [2.0, 15.0])
def test_eliminated_start_states_leave_the_slope_of_the_whole_cost(horizon: float) -> None:
    """With start states at their best, the slope by a parameter is that of re-fitted costs."""
    shooting = Shooting(yaw_model().with_values({"K": 0.9 * TRUE["K"]}), yaw_data(), NOISE)

    def best(unknowns: np.ndarray) -> Iterate:
        held = shooting.holding(np.arange(3), unknowns[:3])
        problem = Windows.overlapping(held, horizon, begin)
        point = Point(unknowns, problem.start.nodes)
        descent = Descent(problem.at(point), Windows.at, Convergence(1e-14), CONTROL)
        descent.run(50)
        return descent.now

    begin = shooting.start_unknowns()
    found = best(begin)
    for i, step in enumerate(1e-4 * np.abs(begin[:3])):
        moved = [begin.copy(), begin.copy()]
        moved[0][i], moved[1][i] = begin[i] + step, begin[i] - step
        slope = (best(moved[0]).cost - best(moved[1]).cost) / (2 * step)
        assert -found.equations.right[i] == pytest.approx(slope, rel=1e-4)
