"""One iterate of multiple shooting: what it costs and what a step would gain.

Two ways to the same numbers. :class:`Exact` holds the sensitivities of every
sample, as covariances and robust losses need them. :class:`Gathered` holds sums
of their products only, gathered while the trajectory runs: several times
faster, and for least squares enough, save that rounding errors are
squared where an unstable trajectory amplifies them. Iterations therefore run on
gathered sums and end on exact ones.

Two iterates of the likelihood with disturbance forces: frozen gain, and the filter as it is.

:class:`Whitened` has derivatives along the filtered path at frozen gain, from one pass.
:class:`Differentiated` has those of the filter as it is, by differences of whole filters, and its
cost alone takes a pass without any derivative.

Damped Gauss-Newton steps for multiple shooting, with an exact-penalty line search.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from oed_sysid.compiled.normal_equations import Blocks, gather
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.projection import bounded_step
from oed_sysid.likelihood.shooting import Linearisation, Point, Shooting
from oed_sysid.likelihood.unknowns import node_maps


class Iterate(Protocol):
    """What a search asks of a point."""

    @property
    def point(self) -> Point:
        """Unknowns and nodes."""

    @property
    def cost(self) -> float:
        """Half the (robust) sum of squares of residuals and priors, defects excluded."""

    @property
    def defect(self) -> float:
        """Sum of the scaled jumps at all nodes."""

    @property
    def maps(self) -> tuple[np.ndarray, ...]:
        """Change of the nodes per unknown, per record."""

    @property
    def offsets(self) -> tuple[np.ndarray, ...]:
        """Change of the nodes that closes the defects, per record."""

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and right-hand side, priors excluded."""

    def predicted(self, step: np.ndarray) -> float:
        """Cost of the linearised problem after a full step, defects closed."""


class Exact:
    """A point with the sensitivities of every sample; see :class:`Iterate`."""

    def __init__(self, shooting: Shooting, point: Point, lin: Linearisation) -> None:
        self._shooting, self.point, self.linearisation = shooting, point, lin
        self.cost = shooting.cost(lin, point.unknowns)
        self.defect = shooting.defect(lin)
        self.maps, self.offsets = lin.node_maps, lin.node_offsets

    @classmethod
    def at(cls, shooting: Shooting, point: Point) -> Exact | None:
        """Evaluate a point; None where a trajectory diverges."""
        lin = shooting.linearise(point)
        return None if lin is None else cls(shooting, point, lin)

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Iterate`."""
        return self._shooting.normal_equations(self.linearisation)

    def predicted(self, step: np.ndarray) -> float:
        """See :class:`Iterate`."""
        return self._shooting.predicted_cost(self.linearisation, self.point.unknowns, step)


@dataclass(frozen=True, eq=False)
class Gathered:
    """A point with gathered sums, for least squares; see :class:`Iterate`.

    Attributes
    ----------
    closed : float
        Half the sum of squares once the defects are closed, to first order,
        at unchanged unknowns, priors excluded.
    """

    shooting: Shooting
    point: Point
    cost: float
    defect: float
    maps: tuple[np.ndarray, ...]
    offsets: tuple[np.ndarray, ...]
    matrix: np.ndarray
    right: np.ndarray
    closed: float

    @classmethod
    def at(cls, shooting: Shooting, point: Point) -> Gathered | None:
        """Evaluate a point; None where a trajectory diverges."""
        n = shooting.layout.n_unknowns
        matrix, right = np.zeros((n, n)), np.zeros(n)
        squares = closed = defect = 0.0
        maps, offsets = [], []
        for index, record in enumerate(shooting.records):
            values = shooting.values(point.unknowns, index)
            z0, dz0 = shooting.full_start(point.unknowns, index)
            nodes = np.vstack([z0[None], point.nodes[index]])
            blocks = gather(
                shooting.kernel,
                record.times,
                record.inputs,
                values,
                nodes,
                record.outputs,
                shooting.sigma,
                starts=shooting.starts[index],
                linked=True,
            )
            slopes = shooting.slopes(point.unknowns, index)
            n_own = shooting.layout.n_own
            part = None if blocks is None else _condensed(blocks, nodes, dz0, n_own, slopes)
            if blocks is None or part is None:
                return None
            found, map_, defects = part
            columns = shooting.layout.record_columns(index)
            matrix[np.ix_(columns, columns)] += found[:-1, :-1]
            right[columns] += found[:-1, -1]
            closed += 0.5 * float(found[-1, -1])
            squares += 0.5 * float(blocks.gram[:, -1, -1].sum())
            defect += float(np.abs(defects / shooting.state_scale).sum())
            n_full = nodes.shape[1]
            maps.append(map_[1:, :n_full, :-1])
            offsets.append(map_[1:, :n_full, -1])
        cost = squares + shooting.prior_cost(point.unknowns)
        return cls(
            shooting, point, cost, defect, tuple(maps), tuple(offsets), matrix, right, closed
        )

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Iterate`."""
        return self.matrix, self.right

    def predicted(self, step: np.ndarray) -> float:
        """See :class:`Iterate`."""
        change = float(step @ (0.5 * (self.matrix @ step) - self.right))
        return self.closed + change + self.shooting.prior_cost(self.point.unknowns + step)


def _condensed(
    blocks: Blocks, nodes: np.ndarray, dz0: np.ndarray, n_own: int, slopes: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Products ``[J t]' [J t]`` of a record's condensed rows and closed residuals.

    Also the maps of its nodes and the defects; None where these overflow.
    """
    assert blocks.ends is not None
    assert blocks.end_sensitivities is not None
    defects = blocks.ends[:-1] - nodes[1:]
    with np.errstate(over="ignore", invalid="ignore"):
        maps = node_maps(blocks.end_sensitivities, defects, dz0, n_own, slopes)
        # Residuals once the defects are closed are one more combination of [J r].
        wide = np.zeros((len(nodes), blocks.gram.shape[1], maps.shape[2]))
        wide[:, :-1] = maps
        wide[:, :-1, -1] *= -1.0
        wide[:, -1, -1] = 1.0
        found = (wide.transpose(0, 2, 1) @ (blocks.gram @ wide)).sum(axis=0)
    if not (np.isfinite(found).all() and np.isfinite(maps).all()):
        return None
    return found, maps, defects


# Information by differences of whole filters over that at frozen gain beyond which it is rounding
# that an unstable model amplifies. Rounding falls with the square of the step, information does
# not: where a standard deviation is smaller than at frozen gain by the second factor, and as much
# smaller than with steps so many times longer, it is rounding as well.
AMPLIFIED, SMALLER, FARTHER = 1.2, 0.8, 3.0
# Share of the largest eigenvalue below which nothing is known.
NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class Whitened:
    """A point with gradients along the filtered path at frozen gain; an iterate.

    A rise of the cost within ``slack`` near the end is the frozen gain's, not a wrong step.
    """

    problem: Filtered
    point: Point
    cost: float
    matrix: np.ndarray
    right: np.ndarray
    defect: float = 0.0
    offsets: tuple[np.ndarray, ...] = ()

    @classmethod
    def at(cls, problem: Filtered, point: Point) -> Whitened | None:
        """Evaluate a point; None where the filter diverges."""
        found = problem.passes(point.unknowns)
        objective = sum(part.objective for part in found)
        if not np.isfinite(objective):
            return None
        matrix, right = problem.gathered(point.unknowns, found)
        if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
            return None
        cost = 0.5 * objective + problem.prior_cost(point.unknowns)
        return cls(problem, point, cost, matrix, right)

    @property
    def maps(self) -> tuple[np.ndarray, ...]:
        """How levels follow times."""
        return self.problem.maps(self.point, self.matrix)

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and right-hand side, priors excluded."""
        return self.matrix, self.right

    def predicted(self, step: np.ndarray) -> float:
        """Cost of the quadratic model after a step."""
        return _predicted(self.problem, self.point, self.cost, self.matrix, self.right, step)


class Differentiated:
    """A point with the gradient of the filter as it is; derivatives only when asked for."""

    defect = 0.0
    offsets: tuple[np.ndarray, ...] = ()

    def __init__(self, problem: Filtered, point: Point, cost: float) -> None:
        self.problem, self.point, self.cost = problem, point, cost
        self._equations: tuple[np.ndarray, np.ndarray] | None = None

    @classmethod
    def at(cls, problem: Filtered, point: Point) -> Differentiated | None:
        """Evaluate a point; None where the filter diverges."""
        objective = problem.objective(point.unknowns)
        return cls(problem, point, 0.5 * objective) if np.isfinite(objective) else None

    @property
    def maps(self) -> tuple[np.ndarray, ...]:
        """How levels follow times."""
        return self.problem.maps(self.point, self.equations()[0])

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and right-hand side, priors excluded."""
        if self._equations is None:
            problem, unknowns = self.problem, self.point.unknowns
            base = problem.passes(unknowns, rows=True)
            frozen, right = problem.gathered(unknowns, base)
            size = np.diag(frozen) + problem.limits.prior_weight
            scale = problem.limits.scale
            std = np.where(size > 0, 1.0 / np.sqrt(np.where(size > 0, size, 1.0)), scale)
            step = np.minimum(std, scale)
            whole = problem.differentiated(unknowns, base, step)
            known = np.arange(problem.layout.levels.start)
            # A vehicle so unstable that moved filters overflow is one whose rounding is amplified.
            more = not all(np.isfinite(part).all() for part in whole)
            more = more or bool(
                (np.diag(whole[0])[known] > AMPLIFIED * np.diag(frozen)[known]).any()
            )
            found = None if more else self._std(whole[0])
            if found is not None and (found < SMALLER * self._std(frozen)).any():
                farther, _ = problem.differentiated(unknowns, base, FARTHER * step)
                more = not np.isfinite(farther).all()
                more = more or bool((found < SMALLER * self._std(farther)).any())
            self._equations = (frozen, right) if more else whole
        return self._equations

    def _std(self, matrix: np.ndarray) -> np.ndarray:
        """Standard deviations of the shared parameters, everything else unknown."""
        matrix = matrix + np.diag(self.problem.limits.prior_weight)
        size = np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), 1.0))
        inverse = np.linalg.pinv(matrix / size / size[:, None], rcond=NOTHING, hermitian=True)
        shared = len(self.problem.layout.shared)
        return np.asarray(np.sqrt(np.maximum(np.diag(inverse)[:shared], 0.0)) / size[:shared])

    def predicted(self, step: np.ndarray) -> float:
        """Cost of the quadratic model after a step."""
        matrix, right = self.equations()
        return _predicted(self.problem, self.point, self.cost, matrix, right, step)


def _predicted(
    problem: Filtered,
    point: Point,
    cost: float,
    matrix: np.ndarray,
    right: np.ndarray,
    step: np.ndarray,
) -> float:
    # Joint knowledge is in matrix and right-hand side already, priors of single unknowns are not.
    change = float(step @ (0.5 * (matrix @ step) - right))
    limits = problem.limits
    away = point.unknowns - limits.prior_mean
    prior = 0.5 * float(limits.prior_weight @ ((away + step) ** 2 - away**2))
    return cost + change + prior


# Lengths of a step that are tried, and the ratio of one to the one before.
LINE_SEARCH_STEPS, SHORTER = 5, 0.4
# A trajectory whose scaled jumps sum to less is continuous.
CLOSED = 1e-8
# Rounding errors grow along an unstable trajectory. Jumps below the first number that no longer
# shrink are theirs, and then so are gains below a share of the cost, or a cost, of the others:
# estimates are within 0.04 standard errors of where they would end.
NEARLY_CLOSED, ROUNDING_SHARE, ROUNDING_COST = 1e-6, 1e-8, 1e-3
# With disturbance forces: the step that ends the iterations at frozen gain, the rise of the cost
# that its gradient may cause near the end, most steps of the exact one, the gain below which the
# last of these was enough, and its equations serve where it led, and the promised gain below which
# a search without a way on has arrived.
FROZEN_TOLERANCE, SLACK, POLISH_STEPS, SETTLED, STALLED_NEAR = 1e-3, 0.1, 8, 0.1, 0.1
# Where the frozen gradient promises what no step keeps, few trials show it.
MOST_DAMPING, FEW_LENGTHS = 10.0, 3
# Steps at frozen gain after which one looks back, and the fall of the cost over these that is too
# small to go on for, least and in tolerances: its gradient then leads to and fro.
LOOK_BACK, LEAST_FALL, FALL_TOLERANCES = 3, 0.05, 10.0

Evaluate = Callable[[Any, Point], Any]
Trust = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Progress:
    """What a solver reports after each iteration."""

    iteration: int
    cost: float
    defect: float
    decrement: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the iterations ended.

    ``reason`` is ``"converged"``, ``"stalled"``, ``"iterations"``, ``"interrupted"``,
    ``"enough"`` or, from constrained solvers, ``"infeasible"``.
    """

    point: Point
    linearisation: Linearisation
    cost: float
    iterations: int
    reason: str


def solve(
    shooting: Shooting,
    point: Point,
    *,
    max_iterations: int = 60,
    tolerance: float = 1e-6,
    callback: Callable[[Progress], None] | None = None,
    enough: Callable[[Progress], bool] | None = None,
) -> Solution | None:
    """Minimise by damped Gauss-Newton steps with an exact-penalty line search.

    Parameters
    ----------
    shooting : Shooting
        The problem.
    point : Point
        Where to start.
    max_iterations : int
        Most Gauss-Newton iterations.
    tolerance : float
        Stop when the step would change the cost by less than this and the
        trajectory is continuous; costs are in units of half a squared standard
        deviation, so 1e-6 leaves estimates 0.001 standard errors off.
    callback : callable, optional
        Called after each iteration.
    enough : callable, optional
        Whether to stop after an iteration, before the end is reached.

    Returns
    -------
    Solution or None
        None where even the start trajectory is not finite. A keyboard
        interrupt ends the iterations and keeps the best point.
    """
    # Robust weights need residuals sample by sample.
    evaluate: Evaluate = Gathered.at if shooting.loss is None else Exact.at
    begin = evaluate(shooting, point)
    if begin is None:
        return None
    search = _Search(shooting, begin, evaluate, Exact.at)
    reason, iteration = "iterations", 0
    try:
        for iteration in range(1, max_iterations + 1):
            outcome = search.advance(tolerance)
            if outcome and search.confirm():
                outcome = search.advance(tolerance)
            if outcome:
                reason = outcome
                break
            progress = Progress(iteration, search.now.cost, search.now.defect, search.decrease)
            if callback is not None:
                callback(progress)
            if enough is not None and enough(progress):
                reason = "enough"
                break
    except KeyboardInterrupt:
        reason = "interrupted"
    search.confirm()
    now = search.now
    if not isinstance(now, Exact):
        return None
    return Solution(now.point, now.linearisation, now.cost, iteration, reason)


@dataclass(frozen=True, eq=False)
class FilteredSolution:
    """Where the iterations of a likelihood with disturbance forces ended.

    ``matrix`` is the information of all unknowns there, ``right`` half the negative
    gradient, priors excluded.
    """

    problem: Filtered
    point: Point
    cost: float
    matrix: np.ndarray
    right: np.ndarray
    iterations: int
    reason: str

    @property
    def objective(self) -> float:
        """Minus twice the log-likelihood, priors included, up to a constant."""
        return 2.0 * self.cost

    @property
    def promise(self) -> float:
        """Fall of the cost that the last equations promise."""
        limits, unknowns = self.problem.limits, self.point.unknowns
        right = self.right + limits.prior_weight * (limits.prior_mean - unknowns)
        matrix = self.matrix + np.diag(limits.prior_weight)
        step = bounded_step(matrix, right, limits.lower - unknowns, limits.upper - unknowns, 0.0)
        return float(right @ step - 0.5 * step @ matrix @ step)

    @property
    def noise(self) -> NoiseModel:
        """Noise model at the end."""
        return self.problem.noise(self.point.unknowns)

    @property
    def values(self) -> dict[str, float]:
        """Value of every parameter of the model; those of each record at their mean."""
        layout, model = self.problem.layout, self.problem.model
        free = [layout.parameters(self.point.unknowns, i) for i in range(layout.n_records)]
        # The mean of equal numbers may miss them, and then a bound, by rounding.
        means = np.clip(np.mean(free, axis=0), np.min(free, axis=0), np.max(free, axis=0))
        return model.values | dict(zip(layout.free_names, map(float, means), strict=True))

    @property
    def initial(self) -> list[np.ndarray]:
        """Start states of every record."""
        count = self.problem.layout.n_records
        return [self.problem.initial_state(self.point.unknowns, i).copy() for i in range(count)]

    @property
    def local(self) -> list[dict[str, float]]:
        """Values of per-record parameters, by record."""
        layout = self.problem.layout
        found = []
        for index in range(layout.n_records):
            own = layout.parameters(self.point.unknowns, index)
            found.append({layout.free_names[i]: float(own[i]) for i in layout.local})
        return found


def solve_filtered(
    problem: Filtered,
    point: Point,
    *,
    max_iterations: int = 40,
    tolerance: float = FROZEN_TOLERANCE,
    polish: int = POLISH_STEPS,
    callback: Callable[[Progress], None] | None = None,
) -> FilteredSolution | None:
    """Minimise the likelihood of innovations: frozen gain first, then the filter as it is.

    Parameters
    ----------
    problem : Filtered
    point : Point
        Where to start.
    max_iterations : int
        Most iterations at frozen gain.
    tolerance : float
        Stop when a step would change the cost by less.
    polish : int
        Most steps with the gradient of the filter as it is; with none, errors are
        those of the frozen gain.
    callback : callable, optional
        Called after each iteration.

    Returns
    -------
    FilteredSolution or None
        None where the filter diverges at the start.
    """
    begin = Whitened.at(problem, point)
    if begin is None:
        return None
    search = _Search(problem, begin, Whitened.at, Differentiated.at if polish else Whitened.at)
    search.slack, search.most_damping, search.lengths = SLACK, MOST_DAMPING, FEW_LENGTHS
    search.trust, search.cheap = problem.trusted, Differentiated.at
    reason, iteration = "iterations", 0
    best: Iterate = begin
    costs = [begin.cost]
    fall = max(LEAST_FALL, FALL_TOLERANCES * tolerance)
    try:
        for iteration in range(1, max_iterations + 1):
            outcome = search.advance(tolerance)
            if outcome:
                reason = outcome
                break
            best = min(best, search.now, key=lambda point: point.cost)
            costs.append(best.cost)
            if callback is not None:
                callback(Progress(iteration, search.now.cost, 0.0, search.decrease))
            if costs[-1 - LOOK_BACK :][0] - best.cost < fall and iteration >= LOOK_BACK:
                reason = "converged"
                break
        search.now = best
        if polish and search.confirm():
            search.slack = 0.0
            for _ in range(polish):
                iteration += 1
                before = search.now
                if search.advance(tolerance):
                    break
                if search.decrease < SETTLED:
                    search.settled = _shifted(before, search.now.point)
                    break
            # The exact gradient has the last word, whatever the frozen one ended with.
            if reason == "iterations" and search.decrease < STALLED_NEAR:
                reason = "converged"
    except KeyboardInterrupt:
        reason = "interrupted"
    # The frozen gain is not the exact gradient: where it finds no way on, the end is near.
    if reason == "stalled" and search.decrease < STALLED_NEAR:
        reason = "converged"
    now = search.now
    matrix, right = search.settled or now.equations()
    return FilteredSolution(problem, now.point, now.cost, matrix, right, iteration, reason)


def _shifted(before: Iterate, point: Point) -> tuple[np.ndarray, np.ndarray]:
    """Equations of an iterate as they hold at a point close by, for the cost of a product."""
    matrix, right = before.equations()
    return matrix, right - matrix @ (point.unknowns - before.point.unknowns)


class _Search:
    """State of the iterations: where they are, how they evaluate, damping and penalty."""

    def __init__(self, shooting: Any, begin: Iterate, evaluate: Evaluate, exact: Evaluate) -> None:
        self.shooting, self.now, self.evaluate, self.exact = shooting, begin, evaluate, exact
        self.slack, self.most_damping, self.lengths = 0.0, 1e8, LINE_SEARCH_STEPS
        self.damping, self.penalty, self.decrease = 0.0, 1.0, np.inf
        self.at_floor, self.length = False, 1.0
        self.trust: Trust | None = None
        self.cheap: Evaluate | None = None
        self.settled: tuple[np.ndarray, np.ndarray] | None = None

    def confirm(self) -> bool:
        """Go on with exact sensitivities at the same point; return whether that is news."""
        if self.evaluate is self.exact:
            return False
        exact = self.exact(self.shooting, self.now.point)
        if exact is None:
            return False
        self.now, self.evaluate, self.damping = exact, self.exact, 0.0
        return True

    def advance(self, tolerance: float) -> str:
        """Take one step; return why there is none, or an empty string."""
        now, limits = self.now, self.shooting.limits
        unknowns = now.point.unknowns
        matrix, right = now.equations()
        right = right + limits.prior_weight * (limits.prior_mean - unknowns)
        matrix = matrix + np.diag(limits.prior_weight)
        lower, upper = limits.lower - unknowns, limits.upper - unknowns
        if self.trust is not None:
            lower, upper = self.trust(unknowns, matrix, lower, upper)
        closed = now.defect < CLOSED or self.at_floor
        if self.at_floor:
            tolerance = max(tolerance, min(ROUNDING_SHARE * abs(now.cost), ROUNDING_COST))
        while self.damping < self.most_damping:
            step = bounded_step(matrix, right, lower, upper, self.damping)
            self.decrease = now.cost - now.predicted(step)
            if abs(self.decrease) < tolerance and closed:
                if self.damping == 0.0:
                    return "converged"
                # A damped step is short everywhere; only a full one proves the end.
                full = bounded_step(matrix, right, lower, upper, 0.0)
                if abs(now.cost - now.predicted(full)) < tolerance:
                    return "converged"
            if now.defect > 0 and self.decrease < 0.5 * self.penalty * now.defect:
                self.penalty = max(self.penalty, -2.0 * self.decrease / now.defect)
            if self._line_search(step):
                self.damping = self.damping / 10.0 if self.damping > 1e-7 else 0.0
                return ""
            self.damping = max(10.0 * self.damping, 1e-4)
        return "stalled"

    def _line_search(self, step: np.ndarray) -> bool:
        now = self.now
        expected = self.decrease + self.penalty * now.defect
        # Where only short steps were good, the next begins a little longer than the last.
        length = min(1.0, self.length / SHORTER)
        evaluate = self.evaluate
        for _ in range(self.lengths):
            trial = self.shooting.move(now.point, now.maps, now.offsets, step, length)
            new = evaluate(self.shooting, trial)
            if new is not None:
                merit = now.cost - new.cost + self.penalty * (now.defect - new.defect)
                # Near the optimum the gain drowns in rounding: any step that does no harm will do.
                tiny = expected < 1e-6 * abs(now.cost) and merit >= -1e-10 * abs(now.cost)
                if expected < 1.0:
                    tiny = tiny or merit > -self.slack
                good = merit > 1e-4 * length * expected or tiny
                if good and evaluate is not self.evaluate:
                    new = self.evaluate(self.shooting, trial)
                if good and new is not None:
                    self.at_floor = 0.1 * now.defect < new.defect < NEARLY_CLOSED
                    self.now, self.length = new, length
                    return True
            length *= SHORTER
            evaluate = self.cheap or evaluate
        self.length = 1.0
        return False
