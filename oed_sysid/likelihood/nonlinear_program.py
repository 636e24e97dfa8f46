r"""Multiple shooting as a nonlinear program for IPOPT.

The same problem as :mod:`oed_sysid.likelihood.gauss_newton` solves, with the state at every sample
an unknown and continuity an equality constraint, so that the exact Hessian can be
used and the user may add constraints. It is slower and needs
no condensing; see Waechter & Biegler (2006) for the solver.

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
(:mod:`oed_sysid.likelihood.filtered`). States are then what the filter has made of all that was
measured before, so that parameters, start states and levels are all that is unknown. Constraints
are of the undisturbed run: what the filter predicts follows the records. The Hessian is the
expected information.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.special import erfcx

from oed_sysid.compiled.graph import Graph, build
from oed_sysid.compiled.kernels import kernel
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.estimate import Binding
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import (
    FilteredSolution,
    Progress,
    Solution,
    differences,
    differentiated,
    exact,
    nowhere,
)
from oed_sysid.likelihood.projection import inverse_of
from oed_sysid.likelihood.shooting import Point, Shooting
from oed_sysid.physics.model import Model
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


class NonlinearProgram:
    """The estimation problem as IPOPT sees it.

    Parameters
    ----------
    shooting : Shooting
        Cut at every sample.
    hessian : str
        ``"exact"`` or ``"gauss-newton"``.
    constraints : sequence of str
        Inequalities or equations, see above.
    """

    def __init__(
        self, shooting: Shooting, *, hessian: str = "exact", constraints: Sequence[str] = ()
    ) -> None:
        self._graph = build(shooting.model)
        layout = shooting.layout
        n_all = sum(shooting.interval_counts) - layout.n_records
        self._scale = np.append(shooting.limits.scale, np.tile(shooting.state_scale, n_all))
        scaled = ca.MX.sym("unknowns", len(self._scale))
        unknowns = scaled * self._scale
        # A parameter of the program, so that noise levels can be estimated without building it
        # again.
        inverse_sigma = ca.MX.sym("inverse_sigma", len(shooting.sigma))
        residuals, jumps, extra = [], [], []
        user = self._user = UserConstraints(shooting.model, constraints)
        position = layout.n_unknowns
        for index in range(layout.n_records):
            columns = layout.record_columns(index)
            own = unknowns[columns[: layout.n_own].tolist()]
            free = unknowns[columns[layout.n_own :].tolist()]
            logged = np.flatnonzero(layout.logged).tolist()
            free[logged] = ca.exp(free[logged])
            values = ca.MX(ca.DM(shooting.model.value_vector))
            values[list(self._graph.free_indices)] = free
            n_nodes = shooting.interval_counts[index] - 1
            n_entries = n_nodes * self._graph.n_full
            nodes = ca.reshape(
                unknowns[position : position + n_entries], self._graph.n_full, n_nodes
            )
            position += n_entries
            part, defects, seen = self._record(shooting, index, own, values, nodes)
            residuals.append(ca.vec(part * ca.repmat(inverse_sigma, 1, part.shape[1])))
            jumps.append(defects)
            extra.append(user.of_record(seen, values))
        residual = ca.vertcat(*residuals)
        loss, weight = residual**2, ca.MX.ones(residual.shape)
        if shooting.loss is not None:
            loss, weight = shooting.loss(residual, functions=ca)
        weighted = np.flatnonzero(shooting.limits.prior_weight).tolist()
        # As further residuals, which a Gauss-Newton Hessian then counts like the others.
        prior = (unknowns[weighted] - shooting.limits.prior_mean[weighted]) * np.sqrt(
            shooting.limits.prior_weight[weighted]
        )
        cost = 0.5 * (ca.sum1(loss) + ca.sumsqr(prior))
        jump = ca.vertcat(*jumps)
        limits = ca.vertcat(jump, *extra)
        self._n_jumps = jump.shape[0]
        zeros = np.zeros(self._n_jumps)
        counts = [user.counts(len(record.times)) for record in shooting.records]
        self._lower_g = np.concatenate([zeros, *(np.repeat(user.lower, one) for one in counts)])
        self._upper_g = np.concatenate([zeros, *(np.repeat(user.upper, one) for one in counts)])
        self._problem = {"x": scaled, "p": inverse_sigma, "f": cost, "g": limits}
        self._options: dict[str, Any] = {}
        if hessian == "gauss-newton":
            jacobian = ca.jacobian(ca.vertcat(residual, prior), scaled)
            root = ca.vertcat(ca.sqrt(weight), ca.MX.ones(prior.shape))
            # Constraints are left out of it: linear ones have no curvature, defects are near zero.
            rows = ca.mtimes(ca.diag(root), jacobian) if shooting.loss else jacobian
            at = [scaled, inverse_sigma]
            self._options["hess_lag"] = _hessian(at, limits.shape[0], ca.mtimes(rows.T, rows))

    def _record(
        self, shooting: Shooting, index: int, own: ca.MX, values: ca.MX, nodes: ca.MX
    ) -> tuple[ca.MX, ca.MX, ca.MX]:
        """Residuals of one record, the scaled jumps at its nodes, and the outputs."""
        record = shooting.records[index]
        z0 = self._graph.start(own, record.inputs[0], values, record.times[0])
        data, steps = _samples(shooting, index)
        n, n_nodes = data.shape[1], nodes.shape[1]
        seen = bool(self._user.of_outputs)
        step = _step(self._graph, int(steps.max()), bool(np.ptp(steps) > 0), seen)
        after, residuals, outputs = step.map(n)(
            ca.horzcat(z0, nodes), ca.repmat(values, 1, n), ca.DM(data)
        )
        scale = ca.repmat(ca.DM(shooting.state_scale), 1, n_nodes)
        # In units of the states, so that one tolerance holds for metres and radians.
        jumps = ca.vec((after[:, :n_nodes] - nodes) / scale)
        return residuals, jumps, outputs

    def solve(
        self,
        shooting: Shooting,
        point: Point,
        *,
        max_iterations: int = 200,
        tolerance: float = 1e-6,
        callback: Callable[[Progress], None] | None = None,
    ) -> Solution:
        """Minimise with IPOPT; see :func:`~oed_sysid.likelihood.gauss_newton.solve`.

        ``shooting`` may differ from the one at construction in its noise levels.
        """
        watcher = _Watcher(self._problem, self._n_jumps, callback) if callback else None
        options = {**self._options, **_settings(max_iterations, tolerance)}
        options |= {"iteration_callback": watcher} if watcher else {}
        solver = ca.nlpsol("estimation", "ipopt", self._problem, options)
        n_nodes = sum(nodes.size for nodes in point.nodes)
        free = np.full(n_nodes, np.inf)
        limits = shooting.limits
        start = np.concatenate([point.unknowns, *(nodes.ravel() for nodes in point.nodes)])
        result = solver(
            x0=start / self._scale,
            p=1.0 / shooting.sigma,
            lbx=np.concatenate([limits.lower, -free]) / self._scale,
            ubx=np.concatenate([limits.upper, free]) / self._scale,
            lbg=self._lower_g,
            ubg=self._upper_g,
        )
        stats = solver.stats()
        found = np.asarray(result["x"]).ravel() * self._scale
        reason = _REASONS.get(stats["return_status"], "stalled")
        usable = np.isfinite(found).all()
        now = exact(shooting, _point(shooting, found)) if usable else nowhere(shooting, point)
        reason = reason if np.isfinite(now.cost) else "diverged"
        return Solution(now, int(stats["iter_count"]), reason)


# Share of a standard error by which parameters are moved for the gradient of a filter.
NEAR = 1e-4


def _settings(max_iterations: int, tolerance: float) -> dict[str, Any]:
    """Options of IPOPT."""
    return {
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": max_iterations,
        "ipopt.tol": min(1e-8, tolerance),
        "ipopt.bound_relax_factor": 0.0,
    }


def _hessian(at: list[ca.MX], n_rows: int, matrix: ca.MX) -> ca.Function:
    """Hessian of the Lagrangian as IPOPT takes it, of a cost alone: constraints do not bend."""
    factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", n_rows)
    names, upper = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
    wanted = [*at, factor, multipliers]
    return ca.Function("hess_lag", wanted, [ca.triu(factor * matrix)], names, upper)


def solve_innovations(
    problem: Filtered,
    begin: np.ndarray,
    constraints: Sequence[str],
    *,
    max_iterations: int = 200,
    tolerance: float = 1e-6,
) -> FilteredSolution:
    """Minimise the likelihood of innovations with IPOPT.

    Parameters
    ----------
    problem : Filtered
    begin : ndarray (n_unknowns,)
    constraints : sequence of str
        See the head of this module.
    max_iterations, tolerance
        See :meth:`NonlinearProgram.solve`.

    Returns
    -------
    FilteredSolution
    """
    user, limits = UserConstraints(problem.model, constraints), problem.limits
    scale, n = limits.scale, len(limits.scale)
    counts = [user.counts(len(record.times)) for record in problem.dataset]
    lower, upper = (
        np.concatenate([np.repeat(side, one) for one in counts])
        for side in (user.lower, user.upper)
    )

    def constrained_by(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        told = [user.linear(one) for one in _predicted(problem, unknowns)]
        if not told:  # the undisturbed run diverges
            return np.full(len(lower), np.nan), np.full((len(lower), n), np.nan)
        rows, slopes = zip(*told, strict=True)
        return np.concatenate(rows), np.vstack(slopes)

    def levels(scaled: np.ndarray) -> list[Any]:
        unknowns = scaled * scale
        cost = differentiated(problem, Point(unknowns, ())).cost
        return [cost, constrained_by(unknowns)[0]]

    def slopes(scaled: np.ndarray) -> list[Any]:
        unknowns = scaled * scale
        base = problem.passes(unknowns, rows=True, gains=True)
        # A program needs the slope of its cost, not the one that holds over a standard error.
        moved = NEAR * differences(problem, problem.gathered(unknowns, base)[0], unknowns)
        equations = problem.differentiated(unknowns, base, moved)
        matrix, right = limits.with_priors(*equations, unknowns)
        told = constrained_by(unknowns)[1] * scale
        return [-(right * scale)[None], told, matrix * scale[:, None] * scale]

    cost_and_rows = _Numbers("levels", n, [(1, 1), (len(lower), 1)], levels)
    derived = _Numbers("slopes", n, [(1, n), (len(lower), n), (n, n)], slopes)
    x, nothing = ca.MX.sym("x", n), ca.MX.sym("p", 0)
    f, g = cost_and_rows(x)
    gradient, jacobian, hessian = derived(x)
    at = [x, nothing]
    options = {
        **_settings(max_iterations, tolerance),
        # Below, differences are rounding; where slopes are worse than that the cost stands still.
        "ipopt.tol": 0.1 * NEAR,
        "ipopt.acceptable_tol": 0.1,
        "ipopt.acceptable_iter": 5,
        "ipopt.acceptable_obj_change_tol": 1e-9,
        "ipopt.acceptable_constr_viol_tol": 1e-8,
        "no_nlp_grad": True,
        "grad_f": ca.Function("g", at, [f, gradient.T], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("j", at, [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": _hessian(at, len(lower), hessian),
    }
    solver = ca.nlpsol("estimation", "ipopt", {"x": x, "p": nothing, "f": f, "g": g}, options)
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
    now = differentiated(problem, Point(found if usable else begin, ()))
    reason = _REASONS.get(stats["return_status"], "stalled") if usable else "diverged"
    return FilteredSolution(now, int(stats["iter_count"]), reason)


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
        free = layout.parameters(unknowns, index)
        values = model.with_values(dict(zip(layout.free_names, free, strict=True))).value_vector
        own = unknowns[columns[: layout.n_own]]
        run = runner.simulate(record.times, record.inputs, values, own, sensitivities=True)
        if not run.ok or run.output_sensitivities is None:
            return []
        by_unknowns = np.zeros((*run.outputs.shape, len(unknowns)))
        by_unknowns[:, :, columns] = run.output_sensitivities * slopes
        by_values = np.zeros((len(values), len(unknowns)))
        by_values[place, columns[layout.n_own :]] = slopes[layout.n_own :]
        found.append(_Predicted(run.outputs, by_unknowns, values, by_values))
    return found


# Functions that choose a sample: of the first, or of the last one of a record.
_ENDS = {"start": 0, "end": -1}


class UserConstraints:
    """The user's constraints: among parameters, along predicted outputs, and at their ends.

    Parameters
    ----------
    model : Model
        Names parameters and outputs.
    texts : sequence of str
        Comparisons in SI units.

    Attributes
    ----------
    lower, upper : ndarray (n_constraints,)
        Of left less right side.
    of_outputs : tuple of int
        Positions of those that hold an output.
    """

    def __init__(self, model: Model, texts: Sequence[str]) -> None:
        values = ca.SX.sym("values", len(model.all_parameters))
        outputs = ca.SX.sym("outputs", len(model.outputs))
        scope = dict(zip(model.output_names, ca.vertsplit(outputs), strict=True))
        scope |= dict(zip(model.parameter_names, ca.vertsplit(values), strict=True))
        self.texts = tuple(texts)
        self._functions, self._places = list[ca.Function](), list[int | None]()
        self._rows = dict[tuple[int, ...], ca.Function]()
        lower, upper = [], []
        for text in texts:
            left, right, kind, place = _compared(text)
            for side in (left, right):
                expressions.check(side, tuple(scope), where="Constraint")
            difference = expressions.to_casadi(left, scope) - expressions.to_casadi(right, scope)
            if not ca.depends_on(difference, ca.vertcat(values, outputs)):
                raise ModelError(f"Constraint {text!r} holds no parameter and no output.")
            if place is not None and not ca.depends_on(difference, outputs):
                raise ModelError(f"Constraint {text!r}: start and end are those of an output.")
            self._functions.append(ca.Function("constraint", [outputs, values], [difference]))
            self._places.append(place)
            lower.append(-np.inf if kind in (ast.Lt, ast.LtE) else 0.0)
            upper.append(np.inf if kind in (ast.Gt, ast.GtE) else 0.0)
        self.lower, self.upper = np.array(lower), np.array(upper)
        self.of_outputs = tuple(
            i for i, one in enumerate(self._functions) if one.jac_sparsity(0, 0).nnz() > 0
        )

    def counts(self, n_times: int) -> list[int]:
        """Rows of every constraint on a record of so many samples."""
        return [
            n_times if i in self.of_outputs and place is None else 1
            for i, place in enumerate(self._places)
        ]

    def of_record(self, outputs: ca.MX, values: ca.MX) -> ca.MX:
        """Left less right sides of a record, ``(n_rows,)``, in the order of the constraints.

        Parameters
        ----------
        outputs : casadi.MX or DM (n_outputs, n_times)
            Predicted; without columns where no constraint holds one.
        values : casadi.MX or DM (n_parameters,)
        """
        rows = []
        for i, (function, place) in enumerate(zip(self._functions, self._places, strict=True)):
            if i not in self.of_outputs:
                rows.append(function(np.zeros(function.size1_in(0)), values))
            elif place is None:
                n = outputs.shape[1]
                rows.append(function.map(n)(outputs, ca.repmat(values, 1, n)).T)
            else:
                rows.append(function(outputs[:, place], values))
        return ca.vertcat(*rows)

    def linear(self, record: _Predicted) -> tuple[np.ndarray, np.ndarray]:
        """Rows of :meth:`of_record` in numbers, and their derivatives by all unknowns."""
        outputs = record.outputs if self.of_outputs else record.outputs[:0]
        shape = outputs.T.shape
        if shape not in self._rows:
            seen, values = ca.MX.sym("seen", *shape), ca.MX.sym("values", len(record.values))
            rows = self.of_record(seen, values)
            derived = [rows, ca.jacobian(rows, seen), ca.jacobian(rows, values)]
            self._rows[shape] = ca.Function("rows", [seen, values], derived)
        level, by_outputs, by_values = self._rows[shape](outputs.T, record.values)
        slopes = np.asarray(by_values) @ record.values_by_unknowns
        if self.of_outputs:
            slopes += by_outputs.sparse() @ record.by_unknowns.reshape(outputs.size, -1)
        return np.asarray(level).ravel(), slopes

    def tightest(self, record: _Predicted) -> Iterator[tuple[str, int | None, float, np.ndarray]]:
        """Where each constraint of a record is nearest to being broken.

        Yields
        ------
        text : str
        sample : int or None
            None where it holds no output.
        excess : float
            Left less right side, with the sign in which it breaks the constraint.
        slope : ndarray (n_unknowns,)
            Derivatives of the excess.
        """
        level, slopes = self.linear(record)
        counts = self.counts(len(record.outputs))
        ends = np.cumsum(counts)
        for i, (text, place, count, end) in enumerate(
            zip(self.texts, self._places, counts, ends, strict=True)
        ):
            # Brought to one sign: above zero breaks the constraint.
            sign = 1.0 if self.lower[i] == -np.inf else -1.0
            own = sign * level[end - count : end]
            row = int(np.nanargmax(own))
            sample = row if place is None else place % len(record.outputs)
            found = sample if i in self.of_outputs else None
            yield text, found, float(own[row]), sign * slopes[end - count + row]


def _compared(text: str) -> tuple[str, str, type, int | None]:
    """Left and right side, kind of comparison, and the sample that start() or end() chooses."""
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
    if len(chosen.places) > 1:
        raise ModelError(f"Constraint {text!r} mixes start and end. Write one constraint for each.")
    place = next(iter(chosen.places), None)
    return ast.unparse(tree.left), ast.unparse(tree.comparators[0]), type(tree.ops[0]), place


class _Chosen(ast.NodeTransformer):
    """Takes start() and end() away, and remembers them."""

    def __init__(self) -> None:
        self.places: set[int] = set()

    def visit_Call(self, node: ast.Call) -> ast.AST:
        """Return what stands in the brackets."""
        self.generic_visit(node)
        name = getattr(node.func, "id", "")
        if name in _ENDS and len(node.args) == 1 and not node.keywords:
            self.places.add(_ENDS[name])
            return node.args[0]
        return node


class _Watcher(ca.Callback):
    """Reports IPOPT's iterations."""

    def __init__(
        self, problem: dict[str, ca.MX], n_jumps: int, report: Callable[[Progress], None]
    ) -> None:
        ca.Callback.__init__(self)
        self._n_x, self._n_g = problem["x"].shape[0], problem["g"].shape[0]
        self._n_p, self._n_jumps = problem["p"].shape[0], n_jumps
        self._report, self._count, self._last = report, 0, np.inf
        self.construct("watcher", {})

    def get_n_in(self) -> int:
        return ca.nlpsol_n_out()

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        sizes = {"x": self._n_x, "lam_x": self._n_x, "g": self._n_g, "lam_g": self._n_g}
        sizes |= {"f": 1, "lam_p": self._n_p}
        return ca.Sparsity.dense(sizes[ca.nlpsol_out(i)], 1)

    def eval(self, arguments: Sequence[ca.DM]) -> list[int]:
        cost, jumps = float(arguments[1]), np.asarray(arguments[2]).ravel()[: self._n_jumps]
        decrement = self._last - cost
        self._report(Progress(self._count, cost, float(np.abs(jumps).sum()), decrement))
        self._count, self._last = self._count + 1, cost
        return [0]


def _step(graph: Graph, n_steps: int, uneven: bool, seen: bool) -> ca.Function:
    """From one sample to the next: ``(z, values, data) -> (next z, weighted residuals, outputs)``.

    ``data`` stacks the inputs at the start and end, time, duration, number of
    integration steps, time since the previous sample, measurement and weight.
    """
    n_inputs, n_outputs = len(graph.model.inputs), len(graph.model.outputs)
    z, values = ca.SX.sym("z", graph.n_full), ca.SX.sym("values", len(graph.model.all_parameters))
    sizes = (n_inputs, n_inputs, 1, 1, 1, 1, n_outputs, n_outputs)
    symbols = [ca.SX.sym(f"d{i}", size) for i, size in enumerate(sizes)]
    begin, end, time, duration, count, since, measured, weight = symbols
    outputs, state = graph.sample(z, begin, values, time, since)
    h = duration / count
    slope = ca.DM([float(linear) for linear in graph.linear_inputs]) * (end - begin) / count
    for i in range(n_steps):
        after = graph.advance(
            state, begin + i * slope, begin + (i + 1) * slope, values, time + i * h, h
        )
        state = ca.if_else(i < count, after, state) if uneven and i else after
    kept = outputs if seen else ca.SX(0, 1)
    return ca.Function(
        "step", [z, values, ca.vertcat(*symbols)], [state, weight * (measured - outputs), kept]
    )


def _samples(shooting: Shooting, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Data of each sample as :func:`_step` takes it, ``(n_data, n_times)``; integration steps."""
    record, model = shooting.records[index], shooting.model
    durations = np.diff(record.times)
    # Nothing follows the last sample; a repeated step keeps the numbers finite.
    ahead, since = np.append(durations, durations[-1]), np.insert(durations, 0, durations[0])
    steps = np.maximum(1, np.ceil(ahead / model.step - 1e-9))
    following = np.vstack([record.inputs[1:], record.inputs[-1:]])
    present = np.isfinite(record.outputs)
    rows = (
        *(record.inputs.T, following.T, record.times[None], ahead[None], steps[None], since[None]),
        *(np.where(present, record.outputs, 0.0).T, present.T.astype(float)),
    )
    return np.vstack(rows), steps


def _point(shooting: Shooting, found: np.ndarray) -> Point:
    """Split the unknowns of the program into those of the condensed problem and nodes."""
    n, n_full, limits = shooting.layout.n_unknowns, shooting.kernel.n_full, shooting.limits
    stops = np.cumsum([(count - 1) * n_full for count in shooting.interval_counts])[:-1]
    nodes = (part.reshape(-1, n_full) for part in np.split(found[n:], stops))
    return Point(np.clip(found[:n], limits.lower, limits.upper), tuple(nodes))


# Distance of a value from its limit, in standard errors, up to which it is on it.
ACTIVE = 1e-3


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
        found += _constraints(problem, unknowns, UserConstraints(problem.model, constraints))
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
    layout = problem.layout
    columns = layout.record_columns(0)[layout.n_own :]
    values, slopes = layout.parameters(unknowns, 0), layout.slopes(unknowns[columns])
    for index, name in zip(layout.shared, layout.shared_names, strict=True):
        parameter = problem.model.parameter(name)
        for sign, limit, relation in ((-1, parameter.lower, ">="), (1, parameter.upper, "<=")):
            gradient = np.zeros(len(unknowns))
            gradient[columns[index]] = sign * slopes[index]
            excess = float(sign * (values[index] - limit))
            yield _Active(f"{name} {relation} {limit:.6g}", excess, gradient)


def _constraints(
    problem: Shooting | Filtered, unknowns: np.ndarray, user: UserConstraints
) -> Iterator[_Active]:
    """Every constraint of the user, along a path where it is exceeded most."""
    # None is predicted where the model diverges.
    pairs = zip(problem.dataset, _predicted(problem, unknowns), strict=False)
    for index, (record, predicted) in enumerate(pairs):
        for text, sample, excess, gradient in user.tightest(predicted):
            if sample is None and index:
                continue
            where = "" if sample is None else f" at {record.times[sample]:g} s of {record.name}"
            yield _Active(f"{text}{where}", excess, gradient, known=True)
