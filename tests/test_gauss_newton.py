"""Single steps against a general bounded least-squares solver, and how iterations end."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear
from yaw_vehicle import NOISE, TRUE, yaw_data, yaw_model

from oed_sysid.likelihood.gauss_newton import (
    Convergence,
    Descent,
    Equations,
    Iterate,
    Progress,
    StepControl,
    bounded_step,
    solve,
)
from oed_sysid.likelihood.shooting import Point, Shooting
from oed_sysid.likelihood.unknowns import Limits

FREE = np.full(4, np.inf)


def rows(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A random overdetermined linear problem with badly scaled columns."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((20, 4)) * [1.0, 1e3, 1e-3, 10.0], rng.standard_normal(20)


@pytest.mark.parametrize("seed", range(8))
def test_bounded_step_is_the_bounded_minimum(seed: int) -> None:
    """The step equals that of a bounded-variable least-squares solver."""
    a, b = rows(seed)
    free = np.linalg.lstsq(a, b, rcond=None)[0]
    lower, upper = -0.6 * np.abs(free), 0.6 * np.abs(free)
    step = bounded_step(a.T @ a, a.T @ b, lower, upper, 0.0)
    scale = np.abs(free)
    expected = lsq_linear(a * scale, b, (lower / scale, upper / scale), method="bvls").x * scale
    assert np.allclose(step, expected, rtol=1e-6)
    assert np.allclose(bounded_step(a.T @ a, a.T @ b, -FREE, FREE, 0.0), free, rtol=1e-8)


def test_unseen_directions_do_not_move() -> None:
    """Along a null direction the step is the smallest one, not rounding errors over zero."""
    a, b = rows(9)
    a[:, 1] = 1e3 * a[:, 0]  # only the sum of the first two is seen
    step = bounded_step(a.T @ a, a.T @ b, -FREE, FREE, 0.0)
    expected = np.linalg.lstsq(a / np.linalg.norm(a, axis=0), b, rcond=1e-10)[0]
    assert np.allclose(step, expected / np.linalg.norm(a, axis=0), rtol=1e-5)
    a[:, 1] = 0.0
    assert bounded_step(a.T @ a, a.T @ b, -FREE, FREE, 0.0)[1] == 0.0


def test_held_unknowns_stay() -> None:
    """Coinciding bounds remove an unknown; the others take their own minimum."""
    a, b = rows(10)
    lower, upper = -FREE.copy(), FREE.copy()
    lower[2] = upper[2] = 0.0
    step = bounded_step(a.T @ a, a.T @ b, lower, upper, 0.0)
    keep = [0, 1, 3]
    assert step[2] == 0.0
    assert np.allclose(step[keep], np.linalg.lstsq(a[:, keep], b, rcond=None)[0], rtol=1e-8)


def test_damping_shortens_the_step() -> None:
    """More damping never makes a longer step, in equilibrated unknowns."""
    a, b = rows(11)
    norms = np.linalg.norm(a, axis=0)
    sizes = [
        np.linalg.norm(norms * bounded_step(a.T @ a, a.T @ b, -FREE, FREE, damping))
        for damping in (0.0, 1e-2, 1.0, 1e2)
    ]
    assert sizes == sorted(sizes, reverse=True)


def test_solution_is_stationary_and_closed() -> None:
    """At the end the gradient of the whole-trajectory cost vanishes and nothing jumps."""
    shooting = Shooting(yaw_model().with_values({"K": 0.08, "T": 12.0}), yaw_data(), NOISE)
    seen: list[Progress] = []
    solution = solve(shooting, shooting.start_point(), callback=seen.append)
    assert solution.reason == "converged"
    assert shooting.defect(solution.linearisation) < 1e-8
    matrix, right = shooting.normal_equations(solution.linearisation)
    # The remaining step is worth less than a thousandth of a standard error.
    assert right @ np.linalg.solve(matrix, right) < 1e-5
    assert [progress.iteration for progress in seen] == list(range(1, len(seen) + 1))
    assert seen[-1].cost == solution.cost


def test_interrupt_keeps_the_best_point() -> None:
    """A keyboard interrupt ends the iterations with what has been reached."""
    shooting = Shooting(yaw_model().with_values({"K": 0.05}), yaw_data(), NOISE)
    costs = []

    def stop(progress: Progress) -> None:
        costs.append(progress.cost)
        if len(costs) == 2:
            raise KeyboardInterrupt

    solution = solve(shooting, shooting.start_point(), callback=stop)
    assert solution.reason == "interrupted"
    assert solution.cost == costs[-1]


def test_limit_of_iterations_is_said() -> None:
    """Too few iterations are reported as such."""
    shooting = Shooting(yaw_model().with_values({"K": 0.05}), yaw_data(), NOISE)
    assert solve(shooting, shooting.start_point(), max_iterations=1).reason == "iterations"


def test_exact_data_give_exact_parameters() -> None:
    """Without noise the truth is found to integration accuracy."""
    data = yaw_data(noise=np.zeros(2))
    shooting = Shooting(yaw_model().with_values({"K": 0.06, "T": 15.0, "alpha": 5.0}), data, NOISE)
    solution = solve(shooting, shooting.start_point(), tolerance=1e-12)
    assert np.allclose(solution.point.unknowns[:3], list(TRUE.values()), rtol=1e-7)


class Valley:
    """Rosenbrock's residuals ``10 (y - x^2), 1 - x`` within bounds, with a prior on ``y``."""

    def __init__(self, upper: float = np.inf, weight: float = 0.0) -> None:
        self.limits = Limits(
            np.full(2, -np.inf), np.array([upper, np.inf]), np.array([0.0, 3.0]),
            np.array([0.0, weight]), np.ones(2),
        )  # fmt: skip

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Residuals without the prior."""
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])

    def at(self, point: Point) -> Iterate:
        """Cost and equations."""
        x = point.unknowns
        error, jacobian = self.residuals(x), np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])
        closed = 0.5 * float(error @ error)
        equations = Equations(jacobian.T @ jacobian, -jacobian.T @ error, closed)
        return Iterate(self, point, closed + self.limits.prior_cost(x), lambda _: equations)

    def move(self, point: Point, follows, step: np.ndarray, length: float) -> Point:
        """The point after a share of a step."""
        return Point(point.unknowns + length * step, ())


@pytest.mark.parametrize("control", [StepControl(), StepControl(lengths=1, damping=1e-3)])
@pytest.mark.parametrize(("upper", "weight"), [(np.inf, 0.0), (0.5, 0.0), (np.inf, 4.0)])
def test_descent_ends_where_another_solver_ends(
    control: StepControl, upper: float, weight: float
) -> None:
    """Line search and damping alone find the minimum of SciPy's trust region, bounds and priors."""
    valley = Valley(upper, weight)
    descent = Descent(valley.at(Point(np.array([-1.2, 1.0]), ())), Valley.at, Convergence(1e-12),
                      control)  # fmt: skip
    assert descent.run(200) == "converged"
    expected = least_squares(
        lambda x: [*valley.residuals(x), np.sqrt(weight) * (x[1] - 3.0)],
        [-1.2, 1.0], bounds=([-np.inf, -np.inf], [upper, np.inf]), xtol=1e-14, ftol=1e-14,
    )  # fmt: skip
    assert descent.now.point.unknowns == pytest.approx(expected.x, abs=2e-5)
    assert descent.now.cost == pytest.approx(expected.cost, abs=1e-9)


def test_a_share_of_the_cost_ends_a_descent_early() -> None:
    """With a share, steps end once one gains less than that of the cost."""
    begin = Valley().at(Point(np.array([-1.2, 1.0]), ()))
    whole, early = (
        Descent(begin, Valley.at, Convergence(1e-12, share=share)) for share in (0.0, 0.5)
    )
    assert whole.run(200) == early.run(200) == "converged"
    assert 0 < early.steps < whole.steps
