"""Steps, iterates and normal equations against general solvers, IPOPT included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from altered import overwritten
from marks import slow
from scipy.optimize import least_squares, lsq_linear
from steered_ship import YAW, two
from test_shooting import LAG, diving_data
from vehicles import DIVING_START, remus
from yaw_vehicle import NOISE, TRUE, yaw_data, yaw_model

from oed_sysid import Dataset, Model, MultipleShooting, Parameter, Record, Solver, simulate_inputs
from oed_sysid.compiled.kernels import Kernel
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.gauss_newton import (
    Convergence,
    Descent,
    Equations,
    Iterate,
    Progress,
    StepControl,
    bounded_step,
    exact,
    gathered,
    solve,
)
from oed_sysid.likelihood.nonlinear_program import Constraint, _mean_square
from oed_sysid.likelihood.shooting import Point, Shooting, loss_by_name
from oed_sysid.likelihood.unknowns import Limits
from oed_sysid.likelihood.windows import CONTROL, Windows, climb, eliminate

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
    # The last step is one of rounding.
    assert seen[-1].cost == pytest.approx(solution.cost, rel=1e-12)


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


SIGMA = np.array([0.02, 0.02, 0.004, 0.004, 0.03])


def diving(n: int = 300) -> Shooting:
    """Two dives with gaps, of a vehicle whose values are 10 % off and have no priors."""
    model, times, rng = remus(), 0.1 * np.arange(n), np.random.default_rng(0)
    records = []
    for index, period in enumerate((9.0, 14.0)):
        fin = 0.1 * np.sign(np.sin(2 * np.pi * times / period))
        run = simulate_inputs(
            model, times, inputs={"fin_command": fin, "thrust": 9.0}, initial=DIVING_START
        )
        outputs = run.outputs + SIGMA * rng.standard_normal(run.outputs.shape)
        outputs[20:60, 4] = np.nan
        records.append(Record(f"dive_{index}", times, run.inputs, outputs, model.channels))
    for p in model.free_parameters:
        start = replace(p, value=0.9 * p.value, prior_mean=None, prior_std=None)
        model = model.with_parameter(start)
    return Shooting(model, Dataset(records), SIGMA)


def yaw_with_own_gain() -> Shooting:
    """A model with a parameter of its own in every record, and a prior."""
    model = yaw_model(
        K=Parameter("K", 0.08, per_record=True),
        alpha=Parameter("alpha", 10.0, prior_mean=12.0, prior_std=1.0),
    )
    return Shooting(model, yaw_data(3), NOISE)


@pytest.mark.parametrize("problem", [diving, yaw_with_own_gain])
def test_gathered_sums_are_those_of_the_jacobian(problem) -> None:
    """Cost, defect, normal equations, prediction and node maps agree to rounding."""
    shooting = problem()
    point = shooting.start_point()
    whole, quick = exact(shooting, point), gathered(shooting, point)
    assert quick.cost == pytest.approx(whole.cost, rel=1e-12)
    assert quick.defect == pytest.approx(whole.defect, rel=1e-12)
    assert whole.defect > 1e-3
    one, other = quick.equations, whole.equations
    size = np.sqrt(np.diag(other.matrix))
    assert np.allclose(one.matrix / np.outer(size, size), other.matrix / np.outer(size, size),
                       rtol=1e-9, atol=1e-9)  # fmt: skip
    assert np.allclose(one.right / size, other.right / size, rtol=1e-9, atol=1e-9)
    step = np.linspace(-1.0, 1.0, shooting.layout.n_unknowns) / size
    assert quick.predicted(step) == pytest.approx(whole.predicted(step), rel=1e-10)
    for own, its in zip(one.follows, other.follows, strict=True):
        assert np.allclose(own[0], its[0], rtol=1e-12)
        assert np.allclose(own[1], its[1], rtol=1e-12)


@pytest.mark.parametrize("problem", [diving, yaw_with_own_gain])
def test_both_ways_end_at_the_same_optimum(problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """Estimates and standard errors do not depend on how iterates are evaluated."""
    shooting = problem()
    estimator = MultipleShooting(noise=shooting.sigma)
    quick = estimator.fit(shooting.model, shooting.dataset)
    monkeypatch.setattr("oed_sysid.likelihood.gauss_newton.gathered", exact)
    slow = estimator.fit(shooting.model, shooting.dataset)
    assert quick.status.ok
    assert np.allclose(quick.estimates, slow.estimates, rtol=1e-8)
    assert np.allclose(quick.covariance, slow.covariance, rtol=1e-6)
    assert quick.cost == pytest.approx(slow.cost, rel=1e-12)


def test_robust_losses_are_weighed_sample_by_sample() -> None:
    """With a robust loss the solution is stationary for the weighted residuals."""
    data = Dataset(yaw_data(1).records[:1])
    off = overwritten(data, 0, np.s_[10:14, 0], data[0].outputs[10:14, 0] + 40 * NOISE[0])
    shooting = Shooting(yaw_model(), off, NOISE)
    robust = shooting.having(loss=loss_by_name("huber"))
    plain, solution = (solve(s, s.start_point()) for s in (shooting, robust))
    matrix, right = robust.normal_equations(solution.linearisation)
    assert right @ np.linalg.solve(matrix, right) < 1e-5
    assert np.abs(solution.point.unknowns[:3] - plain.point.unknowns[:3]).max() > 1e-3


def test_explosion_is_said_by_both() -> None:
    """Where the model diverges neither gives an iterate."""
    shooting = Shooting(yaw_model().with_values({"alpha": -1e12}), yaw_data(1), NOISE)
    point = shooting.start_point()
    assert exact(shooting, point).cost == np.inf
    assert gathered(shooting, point).cost == np.inf


def dive(n: int = 120) -> tuple[Model, np.ndarray, np.ndarray, np.ndarray]:
    """Model, times, inputs and outputs of a dive, some samples missing."""
    model, times = remus(), 0.1 * np.arange(n)
    inputs = {"fin_command": 0.1 * np.sign(np.sin(times)), "thrust": 9.0}
    run = simulate_inputs(model, times, inputs=inputs, initial=DIVING_START)
    outputs = run.outputs + 0.01 * np.random.default_rng(0).standard_normal(run.outputs.shape)
    outputs[5:17, 1] = np.nan
    outputs[30] = np.nan
    return model, times, run.inputs, outputs


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("length", [2, 7, 200])
def test_sums_are_those_of_the_sensitivities(length: int, compiled: bool) -> None:
    """Each block holds the products of scaled rows and residuals, missing samples left out."""
    model, times, inputs, outputs = dive(40 if not compiled else 120)
    kernel = Kernel(model, compiled=compiled)
    starts = np.arange(0, len(times), length, dtype=np.intc)
    nodes = np.tile([1.5, 0.0, 0.02, -0.01, 10.0], (len(starts), 1))
    nodes[:, 1] = 0.01 * np.arange(len(starts))
    values = 0.8 * model.value_vector
    blocks = Kernel.gather(
        kernel, times, inputs, values, nodes, outputs, SIGMA, starts=starts, linked=True
    )
    run = kernel.run(times, inputs, values, nodes, starts=starts, sensitivities=True)
    for i, first in enumerate(starts):
        rows = []
        for k in range(first, min(first + length, len(times))):
            for j in range(5):
                if np.isfinite(outputs[k, j]):
                    residual = outputs[k, j] - run.outputs[k, j]
                    rows.append(np.append(run.output_sensitivities[k, j], residual) / SIGMA[j])
        expected = np.array(rows).T @ np.array(rows)
        assert np.allclose(blocks.gram[i], expected, rtol=1e-10, atol=1e-12 * expected.max())
    assert np.array_equal(blocks.ends, run.ends)
    assert np.array_equal(blocks.end_sensitivities, run.end_sensitivities)


def test_segments_without_ends_have_the_same_sums() -> None:
    """Where ends are not wanted the sums stay what they are."""
    model, times, inputs, outputs = dive()
    starts = np.arange(0, len(times), 4, dtype=np.intc)
    nodes = np.nan_to_num(outputs[starts])
    given = times, inputs, model.value_vector, nodes, outputs, SIGMA
    both = [
        Kernel.gather(Kernel(model), *given, starts=starts, linked=linked)
        for linked in (True, False)
    ]
    assert np.array_equal(both[0].gram, both[1].gram)
    assert not both[1].ends.size


@pytest.mark.parametrize("compiled", [True, False])
def test_explosion_is_said(compiled: bool) -> None:
    """A trajectory that diverges gives None."""
    model, record = yaw_model().with_values({"alpha": -1e12}), yaw_data(1)[0]
    blocks = Kernel.gather(
        Kernel(model, compiled=compiled),
        record.times,
        record.inputs,
        model.value_vector,
        np.array([[0.0, 1.0]]),
        record.outputs,
        NOISE,
        starts=np.zeros(1, dtype=np.intc),
        linked=False,
    )
    assert blocks is None


def test_elimination_solves_the_whole_problem() -> None:
    """Parameters and start states are those of one dense system of all unknowns."""
    rng = np.random.default_rng(1)
    n_segments, n_full, n_free = 6, 5, 8
    rows = rng.standard_normal((n_segments, 30, n_full + n_free + 1))
    gram = rows.transpose(0, 2, 1) @ rows
    away, weight = rng.standard_normal((n_segments, n_full)), rng.uniform(0.5, 2.0, n_full)
    found = eliminate(gram, away, weight, 0.1)
    size = n_segments * n_full
    matrix, right = np.zeros((size + n_free, size + n_free)), np.zeros(size + n_free)
    for i in range(n_segments):
        own = np.arange(i * n_full, (i + 1) * n_full)
        columns = np.concatenate([own, size + np.arange(n_free)])
        block = gram[i].copy()
        block[range(n_full), range(n_full)] += weight
        block[range(n_full), range(n_full)] *= 1.1
        block[:n_full, -1] -= weight * away[i]
        matrix[np.ix_(columns, columns)] += block[:-1, :-1]
        right[columns] += block[:-1, -1]
    expected = np.linalg.solve(matrix, right)
    step = np.linalg.solve(found.matrix, found.right)
    assert np.allclose(step, expected[size:], rtol=1e-9)
    moved = found.solved[:, :, -1] - found.solved[:, :, :-1] @ step
    assert np.allclose(moved.ravel(), expected[:size], rtol=1e-9)
    # Twice the drop of the quadratic: right-hand side times solution.
    assert found.gain + found.right @ step == pytest.approx(right @ expected, rel=1e-9)


def test_start_states_that_look_alike_do_not_stop_the_step() -> None:
    """Blocks that are singular give a finite step, and the exact one elsewhere."""
    column = np.array([1e12, -1e12, 0.5, 1.0])
    alike = np.outer(column, column)
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((6, 4))
    gram, away, weight = np.stack([alike, rows.T @ rows]), np.zeros((2, 2)), np.full(2, 1e-12)
    found = eliminate(gram, away, weight, 0.0)
    assert np.isfinite(found.solved).all()
    block = rows.T @ rows
    exact = np.linalg.solve(block[:2, :2] + np.diag(weight), block[:2, 2:])
    np.testing.assert_allclose(found.solved[1], exact, rtol=1e-10)


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


def test_bounds_and_priors_are_respected() -> None:
    """Bounds hold on the way in, too; a tight prior keeps a parameter where it is known to be."""
    bounded = yaw_model(T=Parameter("T", 30.0, lower=10.0, upper=40.0)).with_values(
        {"K": -0.4, "alpha": -40.0}
    )
    known = yaw_model(alpha=Parameter("alpha", 12.0, prior_mean=30.0, prior_std=1e-3))
    problems = [Shooting(model, yaw_data(), NOISE) for model in (bounded, known)]
    held, near = (climb(problem, problem.start_unknowns(), 5) for problem in problems)
    assert 10.0 <= held[1] <= 40.0
    assert near[2] == pytest.approx(30.0, abs=0.01)


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


CONDENSED = MultipleShooting(noise=NOISE, coloured="never", disturbances="none")


def constrained(*constraints: str, **settings: object) -> MultipleShooting:
    """An estimator of known levels by IPOPT."""
    solver = Solver("ipopt", constraints=constraints)
    return MultipleShooting(noise=NOISE, solver=solver, **settings)  # type: ignore[arg-type]


def difference(fit, other) -> float:  # type: ignore[no-untyped-def]
    """Largest difference of two fits in standard errors."""
    return float(np.max(np.abs(fit.estimates - other.estimates) / np.sqrt(np.diag(fit.covariance))))


@pytest.mark.parametrize("irregular", [False, True])
def test_same_optimum_as_gauss_newton(irregular: bool) -> None:
    """Several records, remainders, gaps and irregular sampling: same estimates and errors."""
    data = overwritten(yaw_data(1, irregular=irregular), 0, np.s_[30:50], np.nan)
    model = yaw_model(
        K=Parameter("K", 0.08, per_record=True),
        alpha=Parameter("alpha", 5.0, prior_mean=12.0, prior_std=2.0),
    )
    condensed = CONDENSED.fit(model, data)
    program = MultipleShooting(noise=NOISE, coloured="never", solver=Solver("ipopt")).fit(
        model, data
    )
    assert program.status.ok
    assert difference(condensed, program) < 2e-3
    assert np.allclose(condensed.covariance, program.covariance, rtol=1e-3)
    assert program.cost == pytest.approx(condensed.cost, abs=1e-5)
    assert [v["K"] for v in program.local_values] == pytest.approx(
        [v["K"] for v in condensed.local_values], rel=1e-4
    )


def test_memory_and_substeps() -> None:
    """A model with actuator memory and several integration steps per sample."""
    model = remus() + LAG
    data = diving_data(model, 60)
    noise = [0.02, 0.02, 0.004, 0.004, 0.03]
    rough = model.with_values({"Z_uw": -35.0, "E_lag": 0.4, "M_uq": -8.0})
    fit = MultipleShooting(noise=noise, solver=Solver("ipopt")).fit(rough, data)
    assert fit.status.ok
    for name in model.free_names:
        assert fit.values[name] == pytest.approx(model.values[name], rel=1e-4)


@pytest.mark.parametrize("loss", ["student", *slow("huber")])
def test_robust_losses(loss: str) -> None:
    """Robust losses have the same optimum in both solvers."""
    data = yaw_data(2)
    data = overwritten(data, 0, np.s_[::17], data[0].outputs[::17] + 0.1)
    condensed, program = (
        MultipleShooting(noise=NOISE, loss=loss, solver=solver).fit(yaw_model(), data)
        for solver in (Solver(tolerance=1e-9), Solver("ipopt"))
    )
    assert difference(condensed, program) < 0.02
    assert program.cost == pytest.approx(condensed.cost, rel=1e-5)


def test_bounds() -> None:
    """An active bound is held exactly."""
    model = yaw_model(T=Parameter("T", 6.0, lower=0.5, upper=7.5))
    condensed = CONDENSED.fit(model, yaw_data(3))
    program = constrained(disturbances="none").fit(model, yaw_data(3))
    assert program.values["T"] == pytest.approx(7.5, abs=1e-6)
    assert program.cost == pytest.approx(condensed.cost, abs=1e-4)


def test_constraints_among_parameters() -> None:
    """An equation among parameters is the same as eliminating one of them."""
    data = yaw_data(4)
    fit = constrained("alpha == 1.2*T", "K/T > 0.001").fit(yaw_model(), data)
    assert fit.status.ok
    assert fit.values["alpha"] == pytest.approx(1.2 * fit.values["T"], rel=1e-6)
    tied = replace(
        yaw_model(),
        kinematics={"psi": "r", "r": "(K*delta - r - 1.2*T*r**3)/T"},
        parameters=tuple(p for p in yaw_model().parameters if p.name != "alpha"),
    )
    eliminated = CONDENSED.fit(tied, data)
    assert fit.cost == pytest.approx(eliminated.cost, abs=1e-3)
    assert fit.values["T"] == pytest.approx(eliminated.values["T"], rel=1e-3)
    # So are the errors, which the constraint ties as it does the values.
    for name in ("K", "T"):
        assert fit.std_errors[name] == pytest.approx(eliminated.std_errors[name], rel=1e-2)
    assert fit.std_errors["alpha"] == pytest.approx(1.2 * fit.std_errors["T"])


def test_contradictions_are_said() -> None:
    """Constraints that exclude each other end with a status, not an exception."""
    fit = constrained("K > 0.3", "K < 0.01").fit(yaw_model(), yaw_data(4))
    assert fit.status.code == "infeasible"
    assert "Loosen" in fit.status.advice


def test_noise_levels_and_progress(capfd: pytest.CaptureFixture[str]) -> None:
    """Noise is estimated as by the other solver; progress is reported; nothing is printed."""
    seen: list[Progress] = []
    data = yaw_data(5)
    fit = MultipleShooting(noise="estimate", solver=Solver("ipopt"), progress=seen.append).fit(
        yaw_model(), data
    )
    other = MultipleShooting(noise="estimate", disturbances="none").fit(yaw_model(), data)
    assert np.allclose(fit.sigma, other.sigma, rtol=2e-3)
    assert len(seen) > 3
    assert seen[-1].defect < 1e-4
    assert capfd.readouterr().out == ""


def test_limit_of_iterations() -> None:
    """Too few iterations are reported as such."""
    fit = MultipleShooting(noise=NOISE, solver=Solver("ipopt", max_iterations=1), start="near").fit(
        yaw_model().with_values({"K": 0.05}), yaw_data(6)
    )
    assert fit.status.code == "iterations"


def test_a_path_is_kept_at_every_sample() -> None:
    """A limit below the largest yaw rate is held everywhere, and named with where it binds."""
    data = yaw_data(4)
    free = constrained().fit(yaw_model(), data)
    most = max(float(one[:, 1].max()) for one in free.predictions)
    limit = 0.98 * most
    kept = constrained(f"r <= {limit!r}").fit(yaw_model(), data)
    assert kept.status.ok
    assert max(float(one[:, 1].max()) for one in kept.predictions) == pytest.approx(limit, rel=1e-5)
    assert kept.cost > free.cost
    assert kept.binding
    assert all(one.text.startswith("r <= ") and " s of " in one.text for one in kept.binding)
    # To first order the optimum without the limit lies beyond it by what was cut off.
    assert kept.binding[0].beyond == pytest.approx(most - limit, rel=0.3)


@pytest.mark.parametrize("beyond", [0.0, 0.5, 3.0, 12.0])
def test_error_about_a_limit_is_that_of_a_density_cut_off_there(beyond: float) -> None:
    """By quadrature: from one, where a limit only begins to act, to zero far beyond it."""
    x = beyond + np.linspace(0.0, 12.0, 200_001)
    density = np.exp(-0.5 * (x**2 - beyond**2))
    expected = np.sum((x - beyond) ** 2 * density) / np.sum(density)
    assert _mean_square(beyond) == pytest.approx(expected, rel=1e-3)


def test_a_limit_narrows_the_errors_of_what_it_holds() -> None:
    """The density of a linear fit cut off at the limit, drawn: mean squares about its corner."""
    data = yaw_data(4)
    free = MultipleShooting(noise=NOISE).fit(yaw_model(), data)
    limit = free.values["T"] - 1.5 * free.std_errors["T"]
    held = constrained(f"T <= {limit!r}").fit(yaw_model(), data)
    drawn = np.random.default_rng(0).multivariate_normal(
        free.estimates, free.covariance, size=400_000
    )
    kept = drawn[drawn[:, held.names.index("T")] <= limit] - held.estimates
    expected = np.sqrt(np.mean(kept**2, axis=0))
    stated = np.sqrt(np.diag(held.covariance))
    assert stated == pytest.approx(expected, rel=0.06)
    assert stated[held.names.index("T")] < 0.6 * free.std_errors["T"]


def test_ends_are_kept() -> None:
    """A start state that is tied has that value; an end keeps its side."""
    data, tied = yaw_data(4), "start(r) == 0.001"
    plain = replace(CONDENSED, loss="square", disturbances="none")
    fit = replace(plain, solver=Solver("ipopt", constraints=(tied,))).fit(yaw_model(), data)
    assert fit.status.ok
    assert [float(one[0, 1]) for one in fit.predictions] == pytest.approx(
        [0.001] * len(data.records), abs=1e-7
    )
    # Errors are those of a fit to which the rate at the start of every record is known.
    starts = [{"r": 0.001}] * len(data)
    known = plain.fit(yaw_model(), data, start_states=starts)
    assert known.cost == pytest.approx(fit.cost, rel=1e-5)
    assert np.allclose(fit.covariance, known.covariance, rtol=0.02)
    end = min(float(one[-1, 0]) for one in fit.predictions) + 0.002
    both = constrained(tied, f"end(psi) >= {end!r}").fit(yaw_model(), data)
    assert min(float(one[-1, 0]) for one in both.predictions) == pytest.approx(end, abs=1e-6)
    assert any(one.text.startswith("end(psi) >= ") for one in both.binding)


@pytest.mark.parametrize(
    ("constraint", "words"),
    [
        ("start(r) < end(r)", "mixes start and end"),
        ("start(K) < 1", "those of an output"),
        ("K + T", "one comparison"),
        ("K < gain", "unknown name"),
        ("1 < 2", "no parameter"),
    ],
)
def test_unreadable_constraints_are_refused(constraint: str, words: str) -> None:
    """A constraint compares expressions of known parameters."""
    with pytest.raises(ModelError, match=words):
        constrained(constraint).fit(yaw_model(), yaw_data(0))


def test_what_is_the_same_in_every_record_is_asked_once() -> None:
    """An output, or a parameter of each record, has a constraint in every record."""
    own = replace(YAW.parameter("T"), per_record=True)
    model = replace(YAW, parameters=(YAW.parameter("K"), own))
    asked = {text: Constraint.of(model, text).of_records for text in ("K > 0", "T > K", "r < 1")}
    assert asked == {"K > 0": False, "T > K": True, "r < 1": True}


def test_the_program_with_process_noise_ends_where_gauss_newton_does() -> None:
    """The same likelihood of innovations, levels of the disturbance estimated along."""
    data = two(4)
    free = MultipleShooting().fit(YAW, data)
    program = MultipleShooting(solver=Solver("ipopt")).fit(YAW, data)
    assert free.noise.has_forces
    assert program.status.code == "converged"
    for name, error in free.std_errors.items():
        assert program.values[name] == pytest.approx(free.values[name], abs=0.15 * error)
        assert program.std_errors[name] == pytest.approx(error, rel=0.05)
    (level,), (same,) = program.noise.force, free.noise.force
    assert level == pytest.approx(same, rel=0.05)


def test_an_equation_beside_process_noise_is_one_parameter_less() -> None:
    """Values and errors are those of the model in which it was solved for a parameter."""
    data = two(4)
    tied = MultipleShooting(solver=Solver("ipopt", constraints=("K == 0.1*T",))).fit(YAW, data)
    solved = replace(
        YAW, kinematics={"r": "(0.1*T*delta - r)/T", "psi": "r"}, parameters=(YAW.parameter("T"),)
    )
    own = MultipleShooting().fit(solved, data)
    assert tied.noise.has_forces
    assert own.noise.has_forces
    assert tied.values["K"] == pytest.approx(0.1 * tied.values["T"], rel=1e-6)
    error = own.std_errors["T"]
    assert tied.values["T"] == pytest.approx(own.values["T"], abs=0.3 * error)
    assert tied.std_errors["T"] == pytest.approx(error, rel=0.1)
    assert tied.status.code == "converged"
    assert [one.text for one in tied.binding] == ["K == 0.1*T"]


@pytest.mark.slow
def test_a_path_beside_process_noise_is_kept_within_its_limit() -> None:
    """Yaw rates of undisturbed runs are nowhere beyond, and the moment is named."""
    data = two(4)
    free = MultipleShooting(solver=Solver("ipopt")).fit(YAW, data)
    limit = 0.97 * max(float(run[:, 1].max()) for run in free.predictions)
    solver = Solver("ipopt", constraints=(f"r <= {limit!r}",))
    kept = MultipleShooting(solver=solver).fit(YAW, data)
    assert kept.noise.has_forces
    assert kept.status.code == "converged"
    assert max(float(run[:, 1].max()) for run in kept.predictions) == pytest.approx(limit, rel=1e-5)
    for name, error in free.std_errors.items():
        assert kept.values[name] == pytest.approx(free.values[name], abs=3.0 * error)
    assert kept.binding[0].text.startswith("r <=")
