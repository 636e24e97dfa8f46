r"""Damped Gauss-Newton: the one solver of sums of squares and of likelihoods of innovations.

With :math:`c(\theta)` half of minus twice the log-likelihood and the logarithm of the priors,
:math:`A` its Gauss-Newton matrix, :math:`b` its negative gradient, and :math:`d(\theta)` the sum of
the scaled jumps of the trajectory at its nodes, an iteration is

*Search direction* (:meth:`Descent.direction`), with :math:`D = \mathrm{diag}\,A` and within bounds
and the trust region,

.. math:: s(\lambda) = \arg\min_{\ell \le \theta + s \le u}\
    \tfrac12\, s'(A + \lambda D)\, s - b's

(start states of windows, which are eliminated, are damped with the rest).

*Step control* (:class:`StepControl`): lengths :math:`\alpha = 1, 0.4, 0.16, \ldots` of the
direction until the exact penalty function :math:`m = c + \pi d` falls by a share of what is
predicted,

.. math:: m(\theta) - m(\theta + \alpha s) > 10^{-4} \alpha\, (\Delta c + \pi d), \qquad
    \Delta c = c(\theta) - c_\text{model}(\theta + s), \qquad \pi \ge -2\, \Delta c / d ,

and where no length does, :math:`\lambda \leftarrow 10 \lambda`; after a step
:math:`\lambda \leftarrow \lambda / 10` (Levenberg-Marquardt).

*Convergence* (:class:`Convergence`): the trajectory is continuous and a full step, undamped, would
gain less than the tolerance, :math:`|\Delta c| < \tau`.

What is minimised says only how a point is evaluated (:class:`Iterate`) and how a step moves it:

- :func:`gathered`, sums of products of sensitivities, gathered while the trajectory runs: least
  squares over multiple shooting (:class:`~oed_sysid.likelihood.shooting.Shooting`). Several times
  faster than sample by sample, save that rounding errors are squared where an unstable trajectory
  amplifies them;
- :func:`exact`, the sensitivities of every sample, as covariances and robust losses need them.
  Iterations run on gathered sums and end on exact ones;
- :func:`whitened`, the likelihood of innovations with derivatives along the filtered path at frozen
  gain, from one pass (:class:`~oed_sysid.likelihood.filtered.Filtered`);
- :func:`differentiated`, that of the filter as it is, by differences of its gain; its cost
  alone takes a pass without any derivative;
- :func:`restricted`, the same with what parameters have followed of the noise (:func:`absorbed`):
  the noise is estimated by it, and noise models are compared by it;
- windows with start states of their own (:class:`~oed_sysid.likelihood.windows.Windows`), for the
  globalisation phase and for predictions a horizon ahead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any, Self

import numpy as np

from oed_sysid.compiled.filtering import FilterPass
from oed_sysid.compiled.kernels import Blocks
from oed_sysid.likelihood.between_records import WORTH_TELLING
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.projection import bounded_step, gain_within
from oed_sysid.likelihood.shooting import Follows, Linearisation, Point, Shooting
from oed_sysid.likelihood.unknowns import node_maps
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import IMMATERIAL, RANK_TOLERANCE, THREE_DIGITS

# Ratio of one length of a step that is tried to the one before.
SHORTER = 0.4
# A trajectory whose scaled jumps sum to less is continuous; and a share of a cost that is rounding.
CLOSED = 1e-8
# With disturbance forces: the step that ends the iterations at frozen gain, and those of the exact
# one, whose equations then serve where it led.
FROZEN_TOLERANCE = THREE_DIGITS
# Most steps at the exact gain; and those with white noise before process noise is asked for, and
# with forces of first order before a sea is: without it they do not converge.
FIRST_STEPS = 8
# Change of the cost that is none near the end: the rise that the frozen gradient may cause, the
# fall over some steps that is too small to go on for, and the promised gain below which a search
# without a way on has arrived.
NEAR = IMMATERIAL
# Where the frozen gradient promises what no step keeps, few trials show it.
MOST_DAMPING = 10.0
# Lengths that are tried there; and steps after which one looks back, whether the gradient leads to
# and fro, or the likeliest of several starts goes on alone.
FEW = 3


# -- points ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Equations:
    r"""Quadratic model of the cost about a point, priors excluded and defects closed.

    .. math:: c(\theta + s) \approx c_0 + \tfrac12 s'As - b's

    Attributes
    ----------
    matrix : ndarray (n_unknowns, n_unknowns)
    right : ndarray (n_unknowns,)
    closed : float
        The cost :math:`c_0` at unchanged unknowns.
    follows : tuple
        How nodes follow a step of the unknowns and close their defects, per record.
    """

    matrix: np.ndarray
    right: np.ndarray
    closed: float
    follows: Follows = ()


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point, what it costs, and, once asked for, its equations.

    Attributes
    ----------
    problem : Shooting, Filtered or Windows
        With ``limits`` of the unknowns, and ``move``, a step within them.
    point : Point
    cost : float
        Half the (robust) sum of squares of residuals and priors, defects excluded.
    derive : callable
        Gives the equations, eliminated unknowns damped.
    defect : float
        Sum of the scaled jumps at all nodes.
    linearisation : Linearisation or None
        Sensitivities of every sample, where they are there.
    """

    problem: Any
    point: Point
    cost: float
    derive: Callable[[float], Equations]
    defect: float = 0.0
    linearisation: Linearisation | None = None
    _derived: dict[float, Equations] = field(default_factory=dict, init=False, repr=False)

    @property
    def equations(self) -> Equations:
        """The quadratic model of the cost about the point."""
        return self.damped(0.0)

    def damped(self, damping: float) -> Equations:
        """The equations for a direction; unknowns that are eliminated are damped, too."""
        if damping not in self._derived:
            self._derived[damping] = self.derive(damping)
        return self._derived[damping]

    def predicted(self, step: np.ndarray, damping: float = 0.0) -> float:
        """Cost of the quadratic model after a full step, priors included."""
        equations, limits = self.damped(damping), self.problem.limits
        change = float(step @ (0.5 * (equations.matrix @ step) - equations.right))
        return equations.closed + change + limits.prior_cost(self.point.unknowns + step)

    def bounded(self, damping: float = 0.0) -> tuple[np.ndarray, ...]:
        """Matrix and right-hand side with what priors add, and bounds of a step."""
        equations, limits, unknowns = self.damped(damping), self.problem.limits, self.point.unknowns
        both = limits.with_priors(equations.matrix, equations.right, unknowns)
        return (*both, limits.lower - unknowns, limits.upper - unknowns)

    def kept(self, cost: float) -> Iterate:
        """The same at some cost, with equations that nothing changes and that files can hold."""
        return replace(self, cost=cost, derive=partial(_told, self.equations))

    def moved(self, step: np.ndarray, length: float, damping: float = 0.0) -> Point:
        """The point after a share of a step."""
        equations = self.damped(damping)
        return self.problem.move(self.point, equations.follows, step, length)


Evaluate = Callable[[Any, Point], Iterate]
# Gives a matrix and a right-hand side.
Derive = Callable[[], tuple[np.ndarray, np.ndarray]]
Trust = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def nowhere(problem: Any, point: Point) -> Iterate:
    """A point at which the model diverges: of infinite cost, with equations that tell nothing."""
    n = problem.limits.lower.size
    nothing = Equations(np.zeros((n, n)), np.zeros(n), np.inf)
    return Iterate(problem, point, np.inf, partial(_told, nothing))


def exact(shooting: Shooting, point: Point) -> Iterate:
    """Evaluate a point with the sensitivities of every sample."""
    lin = shooting.linearise(point)
    return nowhere(shooting, point) if lin is None else linearised(shooting, point, lin)


def linearised(shooting: Shooting, point: Point, lin: Linearisation) -> Iterate:
    """A point whose sensitivities are known, at the noise levels of a problem."""

    @cache
    def equations() -> Equations:
        matrix, right = shooting.normal_equations(lin)
        closed = shooting.closed_cost(lin)
        return Equations(matrix, right, closed, lin.follows)

    cost = shooting.cost(lin, point.unknowns)
    return Iterate(shooting, point, cost, lambda _: equations(), shooting.defect(lin), lin)


def gathered(shooting: Shooting, point: Point) -> Iterate:
    """Evaluate a point by gathered sums, for least squares."""
    n = shooting.layout.n_unknowns
    matrix, right = np.zeros((n, n)), np.zeros(n)
    squares = closed = defect = 0.0
    follows = []
    for index, (record, starts) in enumerate(zip(shooting.records, shooting.starts, strict=True)):
        z0, dz0 = shooting.full_start(point.unknowns, index)
        nodes = np.vstack([z0[None], point.nodes[index]])
        blocks = shooting.kernel.gather(
            record.times, record.inputs, shooting.values(point.unknowns, index), nodes,
            record.outputs, shooting.sigma, starts=starts, linked=True,
        )  # fmt: skip
        slopes = shooting.slopes(point.unknowns, index)
        n_own = shooting.layout.n_own
        part = None if blocks is None else _condensed(blocks, nodes, dz0, n_own, slopes)
        if blocks is None or part is None:
            return nowhere(shooting, point)
        found, map_, defects = part
        columns = shooting.layout.record_columns(index)
        matrix[np.ix_(columns, columns)] += found[:-1, :-1]
        right[columns] += found[:-1, -1]
        closed += 0.5 * float(found[-1, -1])
        squares += 0.5 * float(blocks.gram[:, -1, -1].sum())
        defect += float(np.abs(defects / shooting.state_scale).sum())
        n_full = nodes.shape[1]
        follows.append((map_[1:, :n_full, :-1], map_[1:, :n_full, -1]))
    found_equations = Equations(matrix, right, closed, tuple(follows))
    cost = squares + shooting.limits.prior_cost(point.unknowns)
    return Iterate(shooting, point, cost, lambda _: found_equations, defect)


def _condensed(
    blocks: Blocks, nodes: np.ndarray, dz0: np.ndarray, n_own: int, slopes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Products ``[J t]' [J t]`` of a record's condensed rows and closed residuals.

    Also the maps of its nodes and the defects; None where these overflow.
    """
    defects = blocks.ends[:-1] - nodes[1:]
    with np.errstate(over="ignore", invalid="ignore"):
        maps = node_maps(blocks.end_sensitivities, defects, dz0, n_own, slopes)
        # Residuals once the defects are closed are one more combination of [J r].
        wide = np.zeros((len(nodes), blocks.gram.shape[1], maps.shape[2]))
        wide[:, :-1] = maps
        wide[:, :-1, -1] *= -1.0
        wide[:, -1, -1] = 1.0
        # Products of rows by segments have been summed in C; here they are only combined.
        found = (wide.transpose(0, 2, 1) @ (blocks.gram @ wide)).sum(axis=0)
    if not (np.isfinite(found).all() and np.isfinite(maps).all()):
        return None
    return found, maps, defects


def whitened(problem: Filtered, point: Point, *, levels_only: bool = False) -> Iterate:
    """Evaluate a point with gradients along the filtered path at frozen gain.

    With ``levels_only`` the equations tell of the levels of the noise alone.
    """
    found = problem.passes(point.unknowns, levels_only=levels_only)
    matrix, right = problem.gathered(point.unknowns, found)
    objective = sum(part.objective for part in found)
    if not all(np.isfinite(one).all() for one in (objective, matrix, right)):
        return nowhere(problem, point)
    cost = 0.5 * objective + problem.prior_cost(point.unknowns)
    return _filtered(problem, point, cost, lambda: (matrix, right))


def differentiated(problem: Filtered, point: Point) -> Iterate:
    """Evaluate a point with the gradient of the filter as it is, once that is asked for."""
    cost = 0.5 * problem.objective(point.unknowns)
    return _filtered(problem, point, cost, partial(_of_the_filter, problem, point.unknowns))


def restricted(problem: Filtered, point: Point) -> Iterate:
    """Evaluate a point by the restricted likelihood, with the gradient of the filter as it is."""
    unknowns, levels = point.unknowns, problem.layout.levels

    def told(at: np.ndarray, found: Sequence[FilterPass]) -> tuple[float, float]:
        own, matrix = 0.5 * sum(part.objective for part in found), problem.gathered(at, found)[0]
        finite = np.isfinite(own) and np.isfinite(matrix).all()
        return own, absorbed(problem, matrix) if finite else np.inf

    passes = problem.passes(unknowns, levels=False)
    own, known = told(unknowns, passes)
    cost = own + problem.prior_cost(unknowns) + known
    if not np.isfinite(cost):
        return nowhere(problem, point)

    def derived() -> tuple[np.ndarray, np.ndarray]:
        matrix, right = _of_the_filter(problem, unknowns)
        # A tenth of a standard deviation of the noise's unknowns: ten times as long a step leaves a
        # tenth of a nat more.
        lengths = IMMATERIAL * differences(problem, matrix, unknowns)
        for index in range(levels.start, levels.stop):
            moved = unknowns.copy()
            moved[index] += lengths[index]
            there = problem.passes(moved, levels=False, instead_of=(passes, index - levels.start))
            slope = (told(moved, there)[1] - known) / lengths[index]
            right[index] -= slope if np.isfinite(slope) else 0.0  # where it diverges, none
        return matrix, right

    return _filtered(problem, point, cost, derived)


def absorbed(problem: Filtered, matrix: np.ndarray) -> float:
    r"""What the restricted likelihood adds to the cost: :math:`\tfrac12 \ln\det(1 + D A D)`.

    With the information :math:`A` of all that is no noise and its scales :math:`D`: what is
    estimated beside the noise has followed it, the more the less it is told (Patterson & Thompson
    1971, *Recovery of inter-block information when block sizes are unequal*, Biometrika 58).
    """
    limits, n = problem.limits, problem.layout.levels.start
    free = np.flatnonzero(~limits.held[:n])
    told = matrix[np.ix_(free, free)] + np.diag(limits.prior_weight[free])
    scale = limits.scale[free]
    wide = np.eye(len(free)) + told * scale[:, None] * scale
    return 0.5 * float(np.linalg.slogdet(wide)[1])


def _filtered(problem: Filtered, point: Point, cost: float, derive: Derive) -> Iterate:
    """A point of a likelihood of innovations, and how to derive matrix and right-hand side."""

    @cache
    def equations() -> Equations:
        matrix, right = derive()
        # Joint knowledge is in both of them already, priors of single unknowns are not.
        closed = cost - problem.limits.prior_cost(point.unknowns)
        return Equations(matrix, right, closed, problem.maps(point, matrix))

    return Iterate(problem, point, cost, lambda _: equations())


def differences(problem: Filtered, matrix: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """One standard deviation, others known, at most a scale; of what nothing tells, its scale."""
    size, scale = np.diag(matrix) + problem.limits.prior_weight, problem.limits.scale.copy()
    std = np.where(size > 0, 1.0 / np.sqrt(np.where(size > 0, size, 1.0)), scale)
    # Variances are often many decades above the unit in which they began; of one that is zero a
    # unit far below what the records begin to tell is rounding.
    levels = problem.layout.levels
    sizes = scale[levels], np.abs(unknowns[levels]), THREE_DIGITS * std[levels]
    scale[levels] = np.max(sizes, axis=0)
    return np.minimum(std, scale)


def _of_the_filter(problem: Filtered, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and right-hand side with what the gain adds by differences, or at frozen gain.

    At frozen gain where moved filters leave the numbers, or tell so much more of a parameter that
    it is curvature rather than information.
    """
    base = problem.passes(unknowns, rows=True, gains=True)
    frozen, right = problem.gathered(unknowns, base)
    whole = problem.differentiated(unknowns, base, differences(problem, frozen, unknowns))
    known = np.arange(problem.layout.levels.start)
    usable = all(np.isfinite(part).all() for part in whole)
    if not usable or (np.diag(whole[0])[known] > WORTH_TELLING * np.diag(frozen)[known]).any():
        return frozen, right
    return whole


# -- iterations --------------------------------------------------------------------


@dataclass(frozen=True)
class Progress:
    """What a solver reports after each iteration."""

    iteration: int
    cost: float
    defect: float
    decrement: float


@dataclass(frozen=True)
class StepControl:
    """How far along a direction a step goes, and when the search is given up.

    Attributes
    ----------
    lengths : int
        Lengths that are tried before the damping is raised.
    most_damping : float
        From which on no way on is left.
    slack : float
        Rise of the cost near the end that is the approximate gradient's, not a wrong step.
    quick : callable or None
        Cheaper evaluation of the cost of all but the first length.
    damping : float
        To begin with.
    """

    lengths: int = 5
    most_damping: float = 1e8
    slack: float = 0.0
    quick: Evaluate | None = None
    damping: float = 0.0

    def accepts(self, gained: float, expected: float, length: float, cost: float) -> bool:
        """Whether a step that gained so much is taken; see the head of this module."""
        # Near the optimum the gain drowns in rounding: any step that does no harm will do.
        harmless = expected < 1e-6 * abs(cost) and gained >= -1e-10 * abs(cost)
        if expected < 1.0:
            harmless = harmless or gained > -self.slack
        return gained > 1e-4 * length * expected or harmless


@dataclass(frozen=True)
class Convergence:
    """When an iterate is the minimum.

    Attributes
    ----------
    tolerance : float
        Gain of a full step below which it is.
    share : float
        The same, and that of the last step, as a share of the cost.
    """

    tolerance: float
    share: float = 0.0

    def gain(self, cost: float, *, at_floor: bool) -> float:
        """Gain that is none; more where rounding errors have been reached."""
        least = max(self.tolerance, self.share * cost)
        floor = min(CLOSED * abs(cost), FROZEN_TOLERANCE)
        return max(least, floor) if at_floor else least


@dataclass(eq=False)
class Descent:
    """Iterations: where they are, damping and penalty.

    Attributes
    ----------
    now, before : Iterate
        The last point and the one before it.
    lowest : Iterate
        The point of least cost.
    evaluate : callable
        Makes an iterate of a point; None where it diverges.
    convergence : Convergence
    control : StepControl
    trust : callable or None
        Bounds of a step within which the equations of a point still hold.
    decrease : float
        Gain that was predicted for the last step.
    steps : int
        Steps that were taken.
    """

    now: Iterate
    evaluate: Evaluate
    convergence: Convergence
    control: StepControl = field(default_factory=StepControl)
    trust: Trust | None = None
    decrease: float = np.inf
    steps: int = 0

    def __post_init__(self) -> None:
        self.before = self.lowest = self.now
        self._damping, self._penalty, self._length = self.control.damping, 1.0, 1.0
        self._at_floor = False

    def run(
        self,
        most: int,
        *,
        callback: Callable[[Progress], None] | None = None,
        enough: Callable[[Progress], bool] | None = None,
    ) -> str:
        """Take at most so many steps; return why they ended, or that there is none from here.

        A keyboard interrupt ends them and keeps the last point.
        """
        if not np.isfinite(self.now.cost):
            return "diverged"
        try:
            for _ in range(most):
                if outcome := self._advance():
                    return outcome
                progress = Progress(self.steps, self.now.cost, self.now.defect, self.decrease)
                if callback is not None:
                    callback(progress)
                if enough is not None and enough(progress):
                    return "enough"
        except KeyboardInterrupt:
            return "interrupted"
        return "iterations"

    def refine(self, evaluate: Evaluate, control: StepControl | None = None) -> bool:
        """Go on undamped, from the same point by some evaluation; return whether it has one."""
        known = evaluate is self.evaluate
        found = self.now if known else evaluate(self.now.problem, self.now.point)
        if not np.isfinite(found.cost):
            return False
        self.now, self.evaluate, self._damping = found, evaluate, 0.0
        self.control = control or self.control
        return True

    def direction(self, damping: float) -> np.ndarray:
        """The step at some damping."""
        matrix, right, lower, upper = self.now.bounded(damping)
        if self.trust is not None:
            lower, upper = self.trust(self.now.point.unknowns, matrix, lower, upper)
        return bounded_step(matrix, right, lower, upper, damping)

    def _advance(self) -> str:
        """Take one step; return why there is none, or an empty string."""
        while self._damping < self.control.most_damping:
            step = self.direction(self._damping)
            self.decrease = self.now.cost - self.now.predicted(step, self._damping)
            if self._arrived():
                return "converged"
            if self._take(step):
                self._damping = self._damping / 10.0 if self._damping > 1e-7 else 0.0
                return ""
            self._damping = max(10.0 * self._damping, 1e-4)
        return "stalled"

    def _arrived(self) -> bool:
        """Whether the point is the minimum, as its equations say."""
        now = self.now
        share = self.convergence.share
        if share > 0.0 and self.steps and self.before.cost - now.cost < share * now.cost:
            return True
        least = self.convergence.gain(now.cost, at_floor=self._at_floor)
        if not (now.defect < CLOSED or self._at_floor) or not abs(self.decrease) < least:
            return False
        # A damped step is short everywhere; only a full one proves the end.
        full = self._damping == 0.0
        return full or abs(now.cost - now.predicted(self.direction(0.0))) < least

    def _take(self, step: np.ndarray) -> bool:
        """Go along a step as far as it is good; return whether it is anywhere."""
        now = self.now
        if now.defect > 0 and self.decrease < 0.5 * self._penalty * now.defect:
            # Exact penalty: large enough that closing the defects pays for the cost it may raise.
            self._penalty = max(self._penalty, -2.0 * self.decrease / now.defect)
        expected = self.decrease + self._penalty * now.defect
        # Where only short steps were good, the next begins a little longer than the last, and its
        # cost alone is asked first.
        length = min(1.0, self._length / SHORTER)
        evaluate = self.evaluate
        if self._length < 1.0:
            evaluate = self.control.quick or evaluate
        for _ in range(self.control.lengths):
            trial = now.moved(step, length, self._damping)
            new = evaluate(now.problem, trial)
            gained = now.cost - new.cost + self._penalty * (now.defect - new.defect)
            if self.control.accepts(gained, expected, length, now.cost):
                if evaluate is not self.evaluate:
                    new = self.evaluate(now.problem, trial)
                if np.isfinite(new.cost):
                    # Rounding errors grow along an unstable trajectory. Small jumps that no longer
                    # shrink are theirs, and then so are gains below a share of the cost, or the
                    # tolerance at frozen gain, of the others: estimates are within 0.04 standard
                    # errors of where they would end.
                    self._at_floor = 0.1 * now.defect < new.defect < RANK_TOLERANCE
                    self.before, self.now, self._length = now, new, length
                    self.lowest = min(self.lowest, new, key=lambda one: one.cost)
                    self.steps += 1
                    return True
            length *= SHORTER
            evaluate = self.control.quick or evaluate
        self._length = SHORTER
        return False


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the iterations ended.

    ``reason`` is ``"converged"``, ``"stalled"``, ``"iterations"``, ``"interrupted"``,
    ``"enough"``, from constrained solvers ``"infeasible"``, or ``"diverged"`` where not even the
    start is finite: the cost is infinite then.
    """

    now: Iterate
    iterations: int
    reason: str

    @property
    def finite(self) -> Self | None:
        """The same where it has a finite cost, else None."""
        return self if np.isfinite(self.cost) else None

    @property
    def problem(self) -> Any:
        """What was minimised."""
        return self.now.problem

    @property
    def shooting(self) -> Shooting:
        """The problem over whole records, filtered or not; that of windows holds one."""
        return getattr(self.problem, "shooting", self.problem)

    @property
    def point(self) -> Point:
        """Unknowns and nodes."""
        return self.now.point

    @property
    def cost(self) -> float:
        """Half of minus twice the log-likelihood, priors included, up to a constant."""
        return self.now.cost

    @property
    def linearisation(self) -> Linearisation:
        """Sensitivities of every sample, of least squares over multiple shooting."""
        assert self.now.linearisation is not None
        return self.now.linearisation

    @property
    def matrix(self) -> np.ndarray:
        """Information of all unknowns, priors excluded."""
        return self.now.equations.matrix

    @property
    def right(self) -> np.ndarray:
        """Half the negative gradient, priors excluded."""
        return self.now.equations.right

    @property
    def residuals(self) -> Sequence[np.ndarray]:
        """Measured less model ``(n_times, n_outputs)``, per record."""
        lin = self.now.linearisation
        return self.problem.residuals(self.point) if lin is None else lin.residuals

    def rated(self, shooting: Shooting) -> Solution:
        """The same end where the noise levels are those of another problem."""
        lin, point = self.now.linearisation, self.point
        now = linearised(shooting, point, lin) if lin else self.problem.rated(shooting).at(point)
        return replace(self, now=now).finite or self


def solve(
    shooting: Shooting,
    point: Point,
    *,
    max_iterations: int = 60,
    tolerance: float = 1e-6,
    callback: Callable[[Progress], None] | None = None,
    enough: Callable[[Progress], bool] | None = None,
) -> Solution:
    """Minimise over multiple shooting.

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
    Solution
        A keyboard interrupt ends the iterations and keeps the best point.
    """
    # Robust weights need residuals sample by sample.
    evaluate = gathered if shooting.loss is None else exact
    descent = Descent(evaluate(shooting, point), evaluate, Convergence(tolerance))
    reason = descent.run(max_iterations, callback=callback, enough=enough)
    if reason == "diverged":
        return Solution(descent.now, 0, reason)
    if evaluate is gathered and descent.refine(exact) and reason in ("converged", "stalled"):
        left = max(max_iterations - descent.steps, 1)
        reason = descent.run(left, callback=callback, enough=enough)
    if descent.now.linearisation is None:
        return Solution(nowhere(shooting, point), descent.steps, "diverged")
    return Solution(descent.now, descent.steps + (reason in ("converged", "stalled")), reason)


class FilteredSolution(Solution):
    """Where the iterations of a likelihood with disturbance forces ended."""

    @property
    def problem(self) -> Filtered:
        """What was minimised."""
        return self.now.problem

    @property
    def objective(self) -> float:
        """Minus twice the log-likelihood, priors included, up to a constant."""
        return 2.0 * self.cost

    @property
    def restricted(self) -> float:
        """Half of minus twice the restricted log-likelihood, by which noise models compare."""
        return self.cost + absorbed(self.problem, self.matrix)

    @property
    def promise(self) -> float:
        """Fall of the cost that the last equations promise."""
        return 0.5 * gain_within(*self.now.bounded())[1]

    @property
    def noise(self) -> NoiseModel:
        """Noise model at the end."""
        return self.problem.noise(self.point.unknowns)

    @property
    def values(self) -> dict[str, float]:
        """Value of every parameter of the model; those of each record at their mean."""
        model = self.problem.model
        return model.values | self.problem.layout.means(model, self.point.unknowns)

    @property
    def model(self) -> Model:
        """The model at these values."""
        return self.problem.model.with_values(self.values)

    @property
    def initial(self) -> list[np.ndarray]:
        """Start states of every record."""
        return self.problem.initial_states(self.point.unknowns)

    @property
    def local(self) -> list[dict[str, float]]:
        """Values of per-record parameters, by record."""
        return self.problem.layout.local_values(self.point.unknowns)


def solve_filtered(
    problem: Filtered,
    point: Point,
    *,
    max_iterations: int = 40,
    tolerance: float = FROZEN_TOLERANCE,
    polish: int = FIRST_STEPS,
    callback: Callable[[Progress], None] | None = None,
    begin: Iterate | None = None,
) -> FilteredSolution:
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
    begin : Iterate, optional
        The start at frozen gain, where another solution ended there.
    """
    begin = begin or whitened(problem, point)
    if not np.isfinite(begin.cost):
        return FilteredSolution(begin, 0, "diverged")
    control = StepControl(FEW, MOST_DAMPING, NEAR, differentiated)
    descent = Descent(begin, whitened, Convergence(tolerance), control, problem.trusted)
    # Of twice the log-likelihood, of which the cost is half; the tolerance is immaterial in it.
    fall = max(0.5 * NEAR, tolerance / IMMATERIAL)
    lowest = [begin.cost]

    def to_and_fro(progress: Progress) -> bool:
        lowest.append(descent.lowest.cost)
        return len(lowest) > FEW and lowest[-1 - FEW] - lowest[-1] < fall

    reason = descent.run(max_iterations, callback=callback, enough=to_and_fro)
    reason = "converged" if reason == "enough" else reason
    descent.now = descent.lowest
    # The frozen gain is not the exact gradient: where it finds no way on, the end is near.
    near = ["stalled"]
    if reason != "interrupted" and polish and (last := _polished(descent, polish)):
        # The exact gradient has the last word, whatever the frozen one ended with.
        near.append("iterations")
        reason = last if last in ("interrupted", "stalled") else reason
    now, cost = descent.now, descent.now.cost
    # A damped step promises little everywhere, as in Descent._arrived: a full one proves the end.
    arrived = FilteredSolution(now, 0, reason).promise < NEAR
    if reason in near and arrived:
        reason = "converged"
    elif reason == "converged" and polish and not arrived:
        reason = "stalled"
    if descent.evaluate is restricted:  # what is told of the fit is its likelihood
        cost = 0.5 * problem.objective(now.point.unknowns)
    return FilteredSolution(now.kept(cost), descent.steps + 1, reason)


def _polished(descent: Descent, most: int) -> str:
    r"""Go on to where the gradient :math:`g` of the filter as it is vanishes; return why it ended.

    It costs a filter for every parameter, that at frozen gain, :math:`g_0`, one in all, and bends
    alike. Where the second look at it, from :math:`\theta_k`, promises much still, a few steps
    follow

    .. math:: g(\theta) \approx g_0(\theta) + g(\theta_k) - g_0(\theta_k)

    before the next (defect correction; Stetter 1978, Numer. Math. 29, 425).
    """
    last, problem = "", descent.now.problem
    for look in range(most):
        if not descent.refine(restricted, StepControl(FEW)):
            return last
        last = descent.run(1, enough=lambda progress: progress.decrement < FROZEN_TOLERANCE)
        before = descent.before
        if last == "enough":  # the equations before hold where so small a step has led
            step = descent.now.point.unknowns - before.point.unknowns
            right = before.equations.right - before.equations.matrix @ step
            kept = replace(before.equations, right=right)
            descent.now = replace(descent.now, derive=partial(_told, kept))
        if last != "iterations":
            return last
        if not look or descent.decrease < NEAR:
            continue
        frozen = whitened(problem, before.point).equations
        evaluate = partial(_corrected, lacks=before.equations.right - frozen.right)
        begin, control = evaluate(problem, descent.now.point), StepControl(1, MOST_DAMPING)
        inner = Descent(begin, evaluate, Convergence(FROZEN_TOLERANCE), control, descent.trust)
        ended = inner.run(FEW)
        if inner.steps:
            descent.now, descent.evaluate = inner.now, evaluate
            descent.steps += inner.steps
        if ended == "interrupted":
            last = ended
            break
    descent.refine(restricted)
    return last


def _corrected(problem: Filtered, point: Point, *, lacks: np.ndarray) -> Iterate:
    """Evaluate a point by the restricted likelihood, its gradient at frozen gain and what it lacks.

    As ``lacks`` has it, ``(n_unknowns,)``.
    """
    now = whitened(problem, point)
    if not np.isfinite(now.cost):
        return now
    equations, known = now.equations, absorbed(problem, now.equations.matrix)
    right, closed = equations.right + lacks, equations.closed + known
    kept = replace(equations, right=right, closed=closed)
    return replace(now, cost=now.cost + known, derive=partial(_told, kept))


def _told(equations: Equations, damping: float) -> Equations:
    """Equations that nothing changes, kept in files with what they are of."""
    return equations
