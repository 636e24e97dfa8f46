r"""Estimation within constraints, by IPOPT.

The unknowns are those of :mod:`oed_sysid.likelihood.gauss_newton`, whose optimum without
constraints is where the search begins. The program knows cost and constraints in numbers, with
their derivatives; its Hessian is the expected information, that of the cost alone. See Waechter &
Biegler (2006) for the solver.

Constraints are comparisons in SI units: among parameters, ``"M_uq < 0"``; of predicted outputs
at every sample of every record (a path), ``"z < 25"``; at the first or last one,
``"start(theta) == 0"``, ``"end(u) > 1.5"``.

At the end of a constrained search, by whichever solver, the gradient is not zero. With information
``H`` and half the negative gradient ``b`` of all unknowns, priors in both, the optimum of the
quadratic model lies a step :math:`\delta = H^{-1} b` away. A constraint :math:`g(p) \le 0` that is
active with gradient ``a`` is exceeded there, and to first order its value is known, by

.. math:: a'\delta = \lambda\, a' H^{-1} a, \qquad \sigma_g = \sqrt{a' H^{-1} a}

so that Lagrange's multiplier of a single one is :math:`\lambda = a'\delta / \sigma_g^2`.

What a constraint says is known, and errors hold it. Of a normal density beyond whose mean, by
:math:`d = a'\delta / \sigma_g`, a limit cuts off, the mean square about the limit is

.. math:: m(d) = 1 + d^2 - d \, \varphi(d) / \Phi(-d), \qquad
    C' = C - (1 - m) \, \frac{C a a' C}{\sigma_g^2},

from one where the constraint only begins to act to zero where it holds like an equation, which
it is from the first (:math:`m = 0`). Several act one after the other. Bounds of parameters only
say where a search ended: they leave errors alone.

Where process noise acts, the likelihood is that of the innovations
(:mod:`oed_sysid.likelihood.filtered`), levels of the noise among the unknowns. Constraints are of
the undisturbed run: what the filter predicts follows the records.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.special import erfcx

from oed_sysid.compiled.kernels import kernel
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.estimate import Binding
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import (
    FilteredSolution,
    Iterate,
    Progress,
    Solution,
    differences,
    differentiated,
    exact,
    solve,
)
from oed_sysid.likelihood.projection import inverse_of
from oed_sysid.likelihood.shooting import Point, Shooting
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import DIFFERENCE_STEP, THREE_DIGITS
from oed_sysid.text import expressions

_REASONS = {
    "Solve_Succeeded": "converged",
    "Solved_To_Acceptable_Level": "converged",
    "Feasible_Point_Found": "converged",
    "Maximum_Iterations_Exceeded": "iterations",
    "Maximum_CpuTime_Exceeded": "iterations",
    "Maximum_WallTime_Exceeded": "iterations",
    "User_Requested_Stop": "interrupted",
    "Infeasible_Problem_Detected": "infeasible",
}


def _hessian(at: list[ca.MX], n_rows: int, matrix: ca.MX) -> ca.Function:
    """Hessian of the Lagrangian as IPOPT takes it, of a cost alone: constraints do not bend."""
    factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", n_rows)
    names, upper = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
    wanted = [*at, factor, multipliers]
    return ca.Function("hess_lag", wanted, [ca.triu(factor * matrix)], names, upper)


def solve_constrained(
    problem: Shooting | Filtered,
    point: Point,
    constraints: Sequence[str],
    *,
    max_iterations: int = 200,
    tolerance: float = 1e-6,
) -> tuple[Iterate, int, str]:
    """Minimise within constraints with IPOPT.

    Parameters
    ----------
    problem : Shooting or Filtered
    point : Point
        Where to begin; only its unknowns are used.
    constraints : sequence of str
        See the head of this module.
    max_iterations : int
        Most iterations of IPOPT.
    tolerance : float
        Of the scaled gradient, where that is exact.

    Returns
    -------
    end : Iterate
    iterations : int
    reason : str
        See :class:`~oed_sysid.likelihood.gauss_newton.Solution`.
    """
    user, limits = [Constraint.of(problem.model, text) for text in constraints], problem.limits
    scale, n = limits.scale, len(limits.scale)
    # Twice the same would leave its multipliers undetermined.
    asked = [
        (one, record.times[one.samples])
        for index, record in enumerate(problem.dataset)
        for one in _asked(user, index)
    ]
    sides = [[one.lower, one.upper] for one, times in asked for _ in times]
    lower, upper = np.reshape(sides, (-1, 2)).T

    def constrained_by(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        runs = enumerate(_predicted(problem, unknowns))
        told = [one.linear(run) for index, run in runs for one in _asked(user, index)]
        if not told:  # the undisturbed run diverges, or nothing constrains it
            return np.full(len(lower), np.nan), np.full((len(lower), n), np.nan)
        rows, slopes = zip(*told, strict=True)
        return np.concatenate(rows), np.vstack(slopes)

    def levels(scaled: np.ndarray) -> list[Any]:
        unknowns = scaled * scale
        return [_at(problem, unknowns).cost, constrained_by(unknowns)[0]]

    def slopes(scaled: np.ndarray) -> list[Any]:
        unknowns = scaled * scale
        matrix, right = limits.with_priors(*_equations(problem, unknowns), unknowns)
        told = constrained_by(unknowns)[1] * scale
        return [-(right * scale)[None], told, matrix * scale[:, None] * scale]

    cost_and_rows = _Numbers("levels", n, [(1, 1), (len(lower), 1)], levels)
    derived = _Numbers("slopes", n, [(1, n), (len(lower), n), (n, n)], slopes)
    x, nothing = ca.MX.sym("x", n), ca.MX.sym("p", 0)
    f, g = cost_and_rows(x)
    gradient, jacobian, hessian = derived(x)
    at = [x, nothing]
    options: dict[str, Any] = {
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": max_iterations,
        # Of a filter, differences are rounding below. Where slopes are no better than rounding,
        # which an unstable motion amplifies, the cost stands still.
        "ipopt.tol": DIFFERENCE_STEP if isinstance(problem, Filtered) else min(1e-8, tolerance),
        "ipopt.acceptable_tol": 0.1,
        "ipopt.acceptable_iter": 5,
        "ipopt.acceptable_obj_change_tol": 1e-9,
        "ipopt.acceptable_constr_viol_tol": 1e-8,
        "ipopt.bound_relax_factor": 0.0,
        "no_nlp_grad": True,
        "grad_f": ca.Function("g", at, [f, gradient.T], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("j", at, [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": _hessian(at, len(lower), hessian),
    }
    solver = ca.nlpsol("estimation", "ipopt", {"x": x, "p": nothing, "f": f, "g": g}, options)
    begin = point.unknowns
    result = solver(
        x0=begin / scale,
        lbx=limits.lower / scale,
        ubx=limits.upper / scale,
        lbg=lower,
        ubg=upper,
    )
    stats = solver.stats()
    found = np.clip(np.asarray(result["x"]).ravel() * scale, limits.lower, limits.upper)
    usable = bool(np.isfinite(found).all())
    now = _at(problem, found if usable else begin)
    reason = _REASONS.get(stats["return_status"], "stalled")
    reason = reason if usable and np.isfinite(now.cost) else "diverged"
    return now, int(stats["iter_count"]), reason


def solve_within(
    shooting: Shooting,
    point: Point,
    *,
    constraints: Sequence[str],
    max_iterations: int,
    tolerance: float,
    callback: Callable[[Progress], None] | None = None,
) -> Solution:
    """Minimise over multiple shooting, first without constraints, then within them.

    Parameters
    ----------
    shooting, point, max_iterations, tolerance, callback
        See :func:`oed_sysid.likelihood.gauss_newton.solve`.
    constraints : sequence of str
        See the head of this module.
    """
    most = max_iterations
    free = solve(shooting, point, max_iterations=most, tolerance=tolerance, callback=callback)
    if free.finite is None or free.reason == "interrupted":
        return free
    end, steps, reason = solve_constrained(
        shooting, free.point, constraints, max_iterations=most, tolerance=tolerance
    )
    return Solution(end, free.iterations + steps, reason)


def _at(problem: Shooting | Filtered, unknowns: np.ndarray) -> Iterate:
    """A point of either likelihood, its trajectory continuous."""
    if isinstance(problem, Filtered):
        return differentiated(problem, Point(unknowns, ()))
    return exact(problem, problem.continuous(unknowns))


def _equations(problem: Shooting | Filtered, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information and half the negative gradient, priors excluded."""
    if not isinstance(problem, Filtered):
        equations = _at(problem, unknowns).equations
        return equations.matrix, equations.right
    base = problem.passes(unknowns, rows=True, gains=True)
    # A program needs the slope of its cost, not the one that holds over a standard error.
    moved = DIFFERENCE_STEP * differences(problem, problem.gathered(unknowns, base)[0], unknowns)
    return problem.differentiated(unknowns, base, moved)


class _Numbers(ca.Callback):
    """Functions of the unknowns, one vector, that are known in numbers alone."""

    def __init__(
        self,
        name: str,
        n: int,
        shapes: Sequence[tuple[int, int]],
        work: Callable[[np.ndarray], list[Any]],
    ) -> None:
        ca.Callback.__init__(self)
        self._n, self._shapes, self._work = n, shapes, work
        self.construct(name, {})

    def get_n_out(self) -> int:
        return len(self._shapes)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._n, 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self._shapes[i])

    def eval(self, arguments: Sequence[ca.DM]) -> list[ca.DM]:
        unknowns = np.asarray(arguments[0]).ravel()
        # IPOPT goes back from where there are no numbers.
        if not np.isfinite(unknowns).all():
            return [ca.DM.nan(*shape) for shape in self._shapes]
        return [ca.DM(one) for one in self._work(unknowns)]


@dataclass(frozen=True, eq=False)
class _Predicted:
    """Outputs of a record as the model predicts them on its own.

    Attributes
    ----------
    outputs : ndarray (n_times, n_outputs)
    by_unknowns : ndarray (n_times, n_outputs, n_unknowns)
    values : ndarray (n_parameters,)
    values_by_unknowns : ndarray (n_parameters, n_unknowns)
    """

    outputs: np.ndarray
    by_unknowns: np.ndarray
    values: np.ndarray
    values_by_unknowns: np.ndarray


def _predicted(problem: Shooting | Filtered, unknowns: np.ndarray) -> list[_Predicted]:
    """Predictions of every record; none where the model diverges."""
    model, layout, found = problem.model, problem.layout, []
    runner = kernel(model)
    place = [model.parameter_names.index(name) for name in layout.free_names]
    for index, record in enumerate(problem.dataset):
        columns, slopes = layout.record_columns(index), layout.record_slopes(unknowns, index)
        values = model.value_vector
        values[place] = layout.parameters(unknowns, index)
        own = unknowns[columns[: layout.n_own]]
        run = runner.simulate(record.times, record.inputs, values, own, sensitivities=True)
        if not run.ok:
            return []
        by_unknowns = np.zeros((*run.outputs.shape, len(unknowns)))
        by_unknowns[:, :, columns] = run.output_sensitivities * slopes
        by_values = np.zeros((len(values), len(unknowns)))
        by_values[place, columns[layout.n_own :]] = slopes[layout.n_own :]
        found.append(_Predicted(run.outputs, by_unknowns, values, by_values))
    return found


# Functions that choose a sample: of the first, or of the last one of a record.
_ENDS = {"start": slice(0, 1), "end": slice(-1, None)}


@dataclass(frozen=True, eq=False)
class Constraint:
    """One constraint of the user: among parameters, along predicted outputs, or at their ends.

    Attributes
    ----------
    text : str
        A comparison in SI units.
    difference : casadi.Function
        Left less right side and its derivatives, of outputs ``(n_outputs,)`` and parameters
        ``(n_parameters,)``.
    of_outputs : bool
        Whether it holds an output.
    of_records : bool
        Whether it differs from record to record: it holds an output, or a parameter of each.
    samples : slice
        Of a record, at which it is asked; the first alone where it holds no output.
    lower, upper : float
        Of left less right side.
    """

    text: str
    difference: ca.Function
    of_outputs: bool
    of_records: bool
    samples: slice
    lower: float
    upper: float

    @classmethod
    def of(cls, model: Model, text: str) -> Constraint:
        """Read a comparison of parameters and outputs of a model."""
        values = ca.SX.sym("values", len(model.all_parameters))
        outputs = ca.SX.sym("outputs", len(model.outputs))
        scope = dict(zip(model.output_names, ca.vertsplit(outputs), strict=True))
        scope |= dict(zip(model.parameter_names, ca.vertsplit(values), strict=True))
        left, right, kind, end = _compared(text)
        for side in (left, right):
            expressions.check(side, tuple(scope), where="Constraint")
        level = expressions.to_casadi(left, scope) - expressions.to_casadi(right, scope)
        of_outputs = bool(ca.depends_on(level, outputs))
        if not ca.depends_on(level, ca.vertcat(values, outputs)):
            raise ModelError(f"Constraint {text!r} holds no parameter and no output.")
        if end and not of_outputs:
            raise ModelError(f"Constraint {text!r}: start and end are those of an output.")
        own = [
            part
            for part, p in zip(ca.vertsplit(values), model.all_parameters, strict=True)
            if p.per_record
        ]
        derived = [level, ca.jacobian(level, outputs), ca.jacobian(level, values)]
        return cls(
            text,
            ca.Function("constraint", [outputs, values], derived),
            of_outputs,
            of_outputs or bool(ca.depends_on(level, ca.vertcat(*own))),
            _ENDS.get(end, slice(None) if of_outputs else slice(0, 1)),
            -np.inf if kind in (ast.Lt, ast.LtE) else 0.0,
            np.inf if kind in (ast.Gt, ast.GtE) else 0.0,
        )

    def linear(self, record: _Predicted) -> tuple[np.ndarray, np.ndarray]:
        """Left less right side at every sample asked, and its derivatives by all unknowns."""
        outputs, by_unknowns = record.outputs[self.samples], record.by_unknowns[self.samples]
        # One column for each sample, for which CasADi repeats the parameters.
        found = (np.asarray(one) for one in self.difference(outputs.T, record.values))
        level, by_outputs, by_values = (one.reshape(len(outputs), -1) for one in found)
        slopes = np.einsum("to,tou->tu", by_outputs, by_unknowns)
        return level.ravel(), slopes + by_values @ record.values_by_unknowns

    def tightest(self, record: _Predicted) -> tuple[int, float, np.ndarray]:
        """Where it is nearest to being broken.

        Returns
        -------
        sample : int
        excess : float
            Left less right side, with the sign in which it breaks the constraint.
        slope : ndarray (n_unknowns,)
            Derivatives of the excess.
        """
        level, slopes = self.linear(record)
        # Brought to one sign: above zero breaks the constraint.
        sign = 1.0 if self.lower == -np.inf else -1.0
        row = int(np.nanargmax(sign * level))
        sample = range(len(record.outputs))[self.samples][row]
        return sample, float(sign * level[row]), sign * slopes[row]


def _asked(constraints: Sequence[Constraint], index: int) -> list[Constraint]:
    """Constraints that a record adds: what is the same in all is one, of the first."""
    return [one for one in constraints if one.of_records or not index]


def _compared(text: str) -> tuple[str, str, type, str]:
    """Left and right side, kind of comparison, and which of start() and end() is in it, if any."""
    try:  # an equation is allowed here, in expressions it is not
        tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        tree = None
    if not isinstance(tree, ast.Compare) or len(tree.ops) != 1:
        raise ModelError(
            f"Constraint {text!r} is not one comparison. Write for instance 'M_uq < 0'."
        )
    chosen = _Chosen()
    tree = chosen.visit(tree)
    if len(chosen.ends) > 1:
        raise ModelError(f"Constraint {text!r} mixes start and end. Write one constraint for each.")
    end = next(iter(chosen.ends), "")
    return ast.unparse(tree.left), ast.unparse(tree.comparators[0]), type(tree.ops[0]), end


class _Chosen(ast.NodeTransformer):
    """Takes start() and end() away, and remembers them."""

    def __init__(self) -> None:
        self.ends: set[str] = set()

    def visit_Call(self, node: ast.Call) -> ast.AST:
        """Return what stands in the brackets."""
        self.generic_visit(node)
        name = getattr(node.func, "id", "")
        if name in _ENDS and len(node.args) == 1 and not node.keywords:
            self.ends.add(name)
            return node.args[0]
        return node


# Distance of a value from its limit, in standard errors, up to which it is on it.
ACTIVE = THREE_DIGITS


@dataclass(frozen=True, eq=False)
class _Active:
    """A bound or constraint at the end of a search: text, gradient, and whether errors hold it."""

    text: str
    excess: float
    gradient: np.ndarray
    known: bool = False

    @property
    def is_equation(self) -> bool:
        """Whether it holds on both sides."""
        return "==" in self.text


def constrained(fit: Fit, end: Solution | FilteredSolution, constraints: Sequence[str] = ()) -> Fit:
    """A fit with what binds it, the farthest exceeded first, and errors that know constraints.

    Parameters
    ----------
    fit : Fit
        As if nothing did.
    end : Solution or FilteredSolution
        Of the search.
    constraints : sequence of str
        Beside bounds.

    Returns
    -------
    Fit
    """
    problem: Shooting | Filtered = end.shooting
    limits, unknowns = problem.limits, end.point.unknowns
    if not constraints and not np.any((unknowns <= limits.lower) | (unknowns >= limits.upper)):
        return fit
    total, slope = limits.with_priors(end.matrix, end.right, unknowns)
    covariance = inverse_of(total)
    found = list(_bounds(problem, unknowns))
    if constraints:
        found += _constraints(problem, unknowns, constraints)
    result = sorted(_binding(found, covariance, slope), key=lambda pair: -pair[0].distance)
    known = [one for _, one in result if one.known]
    # An equation is known wherever the optimum of the records lies.
    known += [one for one in found if one.is_equation and one not in known]
    scale = problem.layout.shared_values(unknowns)[1]
    errors = _within(fit.covariance, known, covariance, slope, scale)
    return replace(fit, covariance=errors, binding=tuple(binding for binding, _ in result))


def _binding(
    found: Sequence[_Active], covariance: np.ndarray, slope: np.ndarray
) -> Iterator[tuple[Binding, _Active]]:
    """What of bounds and constraints the optimum of the records lies beyond."""
    for one in found:
        answer = covariance @ one.gradient
        std = float(np.sqrt(max(float(one.gradient @ answer), 0.0)))
        beyond = float(answer @ slope)
        beyond = abs(beyond) if one.is_equation else beyond
        if std > 0 and abs(one.excess) < ACTIVE * std and beyond > ACTIVE * std:
            yield Binding(one.text, beyond, std), one


def _within(
    stated: np.ndarray,
    known: Sequence[_Active],
    covariance: np.ndarray,
    slope: np.ndarray,
    scale: np.ndarray,
) -> np.ndarray:
    """Covariance of the shared parameters where constraints are known.

    Parameters
    ----------
    stated : ndarray (n_shared, n_shared)
        Of the parameters without constraints, the colour of residuals in it.
    known : sequence of _Active
    covariance, slope : ndarray (n_unknowns, n_unknowns), (n_unknowns,)
        Inverse information and half the negative gradient of all unknowns.
    scale : ndarray (n_shared,)
        Derivatives of the parameters by their unknowns.
    """
    seen = np.flatnonzero(np.isfinite(np.diag(stated)))
    stated = stated.copy()
    for one in known:
        answer = covariance @ one.gradient
        square = float(one.gradient @ answer)
        if square <= 0.0:  # said by others
            continue
        left = 0.0 if one.is_equation else _mean_square(float(answer @ slope) / np.sqrt(square))
        # In the shared parameters alone, all others following.
        shared = (answer[: len(scale)] * scale)[seen]
        inner = covariance[: len(scale), : len(scale)] * scale[:, None] * scale
        direction = np.linalg.pinv(inner[np.ix_(seen, seen)], hermitian=True) @ shared
        own = stated[np.ix_(seen, seen)] @ direction
        size = float(direction @ own)
        if size > 0.0:
            share = float(direction @ shared) / square
            stated[np.ix_(seen, seen)] -= (1.0 - left) * share / size * np.outer(own, own)
        covariance = covariance - (1.0 - left) / square * np.outer(answer, answer)
    return stated


def _mean_square(distance: float) -> float:
    """Mean square about a limit of the part of a standard normal beyond it, ``m`` above."""
    hazard = np.sqrt(2.0 / np.pi) / erfcx(distance / np.sqrt(2.0))
    return float(np.clip(1.0 + distance * (distance - hazard), 0.0, 1.0))


def _bounds(problem: Shooting | Filtered, unknowns: np.ndarray) -> Iterator[_Active]:
    """Every bound of a shared parameter."""
    values, slopes = problem.layout.shared_values(unknowns)
    for index, name in enumerate(problem.layout.shared_names):
        parameter = problem.model.parameter(name)
        for sign, limit, relation in ((-1, parameter.lower, ">="), (1, parameter.upper, "<=")):
            gradient = np.zeros(len(unknowns))
            gradient[index] = sign * slopes[index]
            excess = float(sign * (values[index] - limit))
            yield _Active(f"{name} {relation} {limit:.6g}", excess, gradient)


def _constraints(
    problem: Shooting | Filtered, unknowns: np.ndarray, constraints: Sequence[str]
) -> Iterator[_Active]:
    """Every constraint of the user, along a path where it is exceeded most."""
    user = [Constraint.of(problem.model, text) for text in constraints]
    # None is predicted where the model diverges.
    pairs = zip(problem.dataset, _predicted(problem, unknowns), strict=False)
    for index, (record, predicted) in enumerate(pairs):
        for one in _asked(user, index):
            sample, excess, gradient = one.tightest(predicted)
            where = f" at {record.times[sample]:g} s" if one.of_outputs else ""
            where += f" of {record.name}" if one.of_records else ""
            yield _Active(f"{one.text}{where}", excess, gradient, known=True)
