r"""Regression on equations of motion: which equations are linear, and their rows from records.

The equations of motion, inertia times rates minus forces, are differentiated by the free
parameters. Where the derivatives do not depend on the parameters, the equations are

.. math:: y_k = \Phi_k\,\theta + e_k, \qquad
          y = M_0\dot x - f_0(x, d), \quad \Phi = -\frac{\partial}{\partial\theta}
          \left(M\dot x - f(x, d)\right),

with what is left at :math:`\theta = 0` as the target, and least squares applies. Rates are not
measured; they come from a rule:

=============  ==================================================================
``euler``      :math:`(x_{k+1} - x_k)/h`, forces at the first of the two samples
``trapezoid``  the same difference, forces averaged over both samples
``simpson``    :math:`(x_{k+2} - x_k)/2h`, forces averaged with 1:4:1
``local``      value and slope of a cubic fitted to the samples around
``exact``      rates that are given
=============  ==================================================================

In all but the first the same average is taken on both sides of the equation, so that the rows
are unbiased for smooth motion and noise-free states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import casadi as ca
import numpy as np
from scipy.sparse.csgraph import connected_components

from oed_sysid.compiled.graph import Graph, build
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError
from oed_sysid.experiments.trajectory import input_array
from oed_sysid.likelihood.estimator import check_choice
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.physics.model import Model

INSTEAD = "fix it with model.fix(...), or use MultipleShooting, which needs no linearity"


@dataclass(frozen=True, eq=False)
class RegressionForm:
    """Targets and regressors of a model as functions of states, rates and signals.

    Attributes
    ----------
    model : Model
        The model.
    names : tuple of str
        Free parameters, in order.
    equations : tuple of str
        Equations that hold at least one of them, by the state whose rate they give.
    needed : tuple of str
        States that these equations contain and that have to be measured.
    graph : Graph
        The model's CasADi functions.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Input, Output, State
    >>> from oed_sysid.physics import Force
    >>> from oed_sysid.physics.parameters import Parameter
    >>> yaw = Model(
    ...     "yaw", (State("r", "rad/s"),), (Input("delta", "rad"),), (Output("r", "rad/s"),),
    ...     axes={"N": "r"}, inertia={("N", "r"): "T"},
    ...     effects=(Force("turn", {"N": "K*delta - r"}, (Parameter("K", 0.1, "1/s"),)),),
    ...     parameters=(Parameter("T", 10.0, "s"),),
    ... )
    >>> form = regression_form(yaw)
    >>> form.names, form.equations, form.needed
    (('T', 'K'), ('r',), ('r',))
    """

    model: Model
    names: tuple[str, ...]
    equations: tuple[str, ...]
    needed: tuple[str, ...]
    graph: Graph
    _function: ca.Function

    def evaluate(
        self, states: np.ndarray, rates: np.ndarray, signals: np.ndarray, times: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Targets and regressors at some moments.

        Parameters
        ----------
        states, rates : ndarray (n_rows, n_states)
            States, and their rates or the differences that stand for them.
        signals : ndarray (n_rows, n_signals)
            Actuator signals.
        times : ndarray (n_rows,)
            Times, s.

        Returns
        -------
        targets : ndarray (n_rows, n_equations)
        regressors : ndarray (n_rows, n_equations, n_free)
        """
        n, shape = len(times), (len(self.equations), len(self.names))
        if n == 0:
            return np.empty((0, shape[0])), np.empty((0, *shape))
        # Free parameters have been set to zero in the target: only known ones count of these.
        values = ca.DM(self.model.value_vector)
        target, flat = self._function(states.T, rates.T, signals.T, values, times[None, :])
        # CasADi stacks columns: regressors come as (n_equations * n_free, n_rows).
        shaped = np.array(flat).reshape(*shape[::-1], n)
        return np.array(target).T, shaped.transpose(2, 1, 0)

    def anywhere(self, n: int) -> np.ndarray:
        """Regressors ``(n, n_equations, n_free)`` at random motions, to see what they hold."""
        rng = np.random.default_rng(0)
        states, rates = rng.uniform(0.5, 1.5, (2, n, len(self.graph.state_names)))
        signals = rng.uniform(0.5, 1.5, (n, self.graph.actuate.size1_out(0)))
        times = (np.arange(n) + 0.5) * self.model.step
        return self.evaluate(states, rates, signals, times)[1]


def regression_form(model: Model) -> RegressionForm:
    """Derive targets and regressors of a model.

    Raises
    ------
    ModelError
        If the equations are not linear in the free parameters; the message
        names the parameters and the equations.
    """
    check_free(model, "a regression")
    # Inertia times rate minus forces: its derivatives by the parameters are the regressors.
    graph = build(model)
    x, rate, d, p, t = (graph.balance.sx_in(i) for i in range(5))
    p_free = p[list(graph.free_indices), 0]
    residual = graph.balance(x, rate, d, p, t)
    slope = ca.jacobian(residual, p_free)
    _check_linear(model, graph, slope, p_free)
    # Equations without a free parameter (kinematics) are no regressions.
    rows = np.flatnonzero((np.array(ca.DM(slope.sparsity(), 1.0)) != 0).any(axis=1))
    names = model.free_names
    regressors = -slope[rows.tolist(), :]
    # The target is what is left when every free parameter is zero.
    target = ca.substitute(residual[rows.tolist(), 0], p_free, ca.DM.zeros(len(names)))
    # Only states that the rows hold have to be measured; a position, say, may be left out.
    both = ca.vertcat(target, ca.vec(regressors))
    states = zip(graph.state_names, ca.vertsplit(x), ca.vertsplit(rate), strict=True)
    needed = tuple(name for name, *pair in states if ca.depends_on(both, ca.vertcat(*pair)))
    function = ca.Function(
        "regression",
        [x, rate, d, p, t],
        [ca.densify(target), ca.densify(ca.vec(ca.densify(regressors)))],
        {"cse": True},
    )
    _check_measured(model, needed)
    _check_sensors(model, needed)
    equations = tuple(graph.state_names[i] for i in rows)
    return RegressionForm(model, names, equations, needed, graph, function)


def _check_linear(model: Model, graph: Graph, slope: ca.SX, p_free: ca.SX) -> None:
    """Raise where a parameter acts elsewhere than linearly in the equations of motion."""
    names = model.free_names
    in_motion = (np.array(ca.DM(slope.sparsity(), 1.0)) != 0).any(axis=0)
    in_actuators = _act_on_actuators(graph)
    for index, name in enumerate(names):
        if in_actuators[index]:
            raise ModelError(
                f"{name} of model {model.name!r} acts on an actuator signal, ahead of the forces, "
                f"so that no regression can estimate it: {INSTEAD}."
            )
        if not in_motion[index]:
            raise ModelError(
                f"{name} of model {model.name!r} does not appear in the equations of motion (it "
                f"belongs to a sensor, a start value or nothing): {INSTEAD}."
            )
    # Linear in all together: no derivative may hold any of the parameters.
    wrong = [name for i, name in enumerate(names) if ca.depends_on(slope, p_free[i])]
    if wrong:
        rows = zip(graph.state_names, ca.vertsplit(slope), strict=True)
        states = [state for state, row in rows if ca.depends_on(row, p_free)]
        raise ModelError(
            f"Model {model.name!r} is not linear in {', '.join(wrong)}, in the equation of "
            f"{', '.join(states)}. Where one parameter divides another, write it as an inertia "
            "(axes={'N': 'r'}, inertia={('N', 'r'): 'T'}); otherwise fix all but one of them with "
            "model.fix(...), or use MultipleShooting, which needs no linearity."
        )


def _act_on_actuators(graph: Graph) -> np.ndarray:
    """Whether each free parameter changes an actuator's signal or memory, ``(n_free,)``."""
    free = list(graph.free_indices)
    acts = np.zeros(len(free), dtype=bool)
    if graph.actuate.size1_out(0):
        for output in range(2):  # signals, then memory
            # The pattern of the Jacobian: whether a parameter can act at all, at any values.
            pattern = np.array(ca.DM(graph.actuate.jac_sparsity(output, 2), 1.0))
            acts |= (pattern[:, free] != 0).any(axis=0)
    return acts


def _check_measured(model: Model, needed: tuple[str, ...]) -> None:
    """Raise where a state of the equations is not measured."""
    measured = {output.source for output in model.outputs}
    missing = [name for name in needed if name not in measured]
    if missing:
        raise ModelError(
            f"The regressions of model {model.name!r} contain {', '.join(missing)}, which no "
            f"output measures. Measured are {', '.join(model.output_names)}. Add an output, or use "
            "MultipleShooting, which estimates states that are not measured."
        )


def _check_sensors(model: Model, needed: tuple[str, ...]) -> None:
    """Raise where a state of the equations is measured otherwise than as it is."""
    measured = {output.source: output.name for output in model.outputs}
    for effect in model.effects:
        # At zero a sensor effect is absent.
        acts = effect.stage == "sensor" and any(p.value for p in effect.parameters)
        touched = [name for name in needed if acts and measured[name] in effect.terms]
        if touched:
            raise ModelError(
                f"The measurement of {', '.join(touched)} passes the sensor effect "
                f"{effect.name!r}, which regressions cannot undo. Use model.without"
                f"({effect.name!r}) and correct the record, or use MultipleShooting."
            )


# Weight and sample of each force that a difference is explained by, and whether its actuator
# signals are those just after or before the sample: actuators may jump there.
STENCILS: Mapping[str, tuple[tuple[float, int, str], ...]] = {
    "euler": ((1.0, 0, "after"),),
    "trapezoid": ((0.5, 0, "after"), (0.5, 1, "before")),
    "simpson": (
        (1 / 6, 0, "after"),
        (1 / 3, 1, "before"),
        (1 / 3, 1, "after"),
        (1 / 6, 2, "before"),
    ),
    "local": ((0.5, 0, "after"), (0.5, 0, "before")),
}
# Samples that a difference reaches over.
SPANS = {"euler": 1, "trapezoid": 1, "simpson": 2}
RULES = (*STENCILS, "exact")
# Samples of a local cubic, unless said otherwise.
WINDOW = 9

Rates = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows ``target = regressors @ parameters + error`` of all records.

    Attributes
    ----------
    form : RegressionForm
        Equations and names.
    dataset : Dataset
        The records.
    targets : tuple of ndarray (n_rows, n_equations)
        One array per record; NaN where a measurement is missing.
    regressors : tuple of ndarray (n_rows, n_equations, n_free)
        NaN in the same rows.
    """

    form: RegressionForm
    dataset: Dataset
    targets: tuple[np.ndarray, ...]
    regressors: tuple[np.ndarray, ...]

    def equation(self, index: int) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """Complete rows of one equation, over all records.

        Returns
        -------
        regressors : ndarray (n_rows, n_parameters)
        target : ndarray (n_rows,)
        names : tuple of str
            Parameters of this equation.
        """
        target = np.concatenate([t[:, index] for t in self.targets])
        regressors = np.vstack([r[:, index] for r in self.regressors])
        rows = np.isfinite(target) & np.isfinite(regressors).all(axis=1)
        used = np.flatnonzero(np.nan_to_num(regressors).any(axis=0))
        names = tuple(self.form.names[i] for i in used)
        return regressors[rows][:, used], target[rows], names

    def groups(self) -> list[tuple[int, ...]]:
        """Positions of the equations, those together that share a parameter with each other."""
        held = [{*self.equation(index)[2]} for index in range(len(self.form.equations))]
        shared = [[not one.isdisjoint(other) for other in held] for one in held]
        n_groups, labels = connected_components(np.array(shared))
        return [tuple(np.flatnonzero(labels == k).tolist()) for k in range(n_groups)]

    def check_separate(self) -> None:
        """Raise :class:`ModelError` where two equations share a parameter."""
        held = {equation: self.equation(i)[2] for i, equation in enumerate(self.form.equations)}
        for (one, own), (other, theirs) in combinations(held.items(), 2):
            if shared := [name for name in theirs if name in own]:
                raise ModelError(
                    f"{shared[0]} appears in the equations of {one} and of {other}; this estimator "
                    "solves each equation alone. Use EquationError, which solves them together."
                )


def rows_of(
    form: RegressionForm,
    dataset: Dataset,
    *,
    rule: str = "local",
    window: int = WINDOW,
    rates: Rates | None = None,
) -> Rows:
    """Build the rows of all records.

    Parameters
    ----------
    form : RegressionForm
        The model's equations.
    dataset : Dataset
        Records with the model's channels.
    rule : str
        One of :data:`RULES`.
    window : int
        Samples of a local cubic, odd.
    rates : mapping of str to ndarray (n_times, n_states), optional
        For ``"exact"``: rates of all states, by record.
    """
    check_rule(rule, window)
    check_channels(form.model, dataset)
    pairs = []
    for record in dataset:
        states = states_of(form, record.outputs)
        given = None
        if rule == "exact":
            given = (rates or {}).get(record.name)
            if given is None or np.shape(given) != states.shape:
                raise DataError(
                    f"Exact rates of record {record.name!r} are missing or not of shape "
                    f"{states.shape}, one column for each of {', '.join(form.graph.state_names)}."
                )
        pairs.append(rows_from(form, record.times, states, record.inputs, rule, window, given))
    return Rows(form, dataset, *zip(*pairs, strict=True))


def rows_from(
    form: RegressionForm,
    times: np.ndarray,
    states: np.ndarray,
    inputs: np.ndarray,
    rule: str,
    window: int = WINDOW,
    rates: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Targets and regressors of one run, see :func:`rows_of`."""
    after, before = actuator_signals(form, times, inputs)
    signals = {"after": after, "before": before}
    if rates is not None:
        return form.evaluate(states, np.asarray(rates, float), signals["after"], times)
    span = SPANS.get(rule, 0)
    n = max(len(times) - span, 0)
    if span:
        # The mean rate over an interval, exactly; the rule says which mean of the forces goes with
        # it.
        slopes = (states[span:] - states[:-span]) / (times[span:] - times[:-span])[:, None]
        if rule == "simpson":  # its weights hold for equal steps only
            steps = np.diff(times)
            slopes[np.abs(steps[1:] - steps[:-1]) >= 1e-3 * steps[1:]] = np.nan
    else:
        # Smoothed states and their rates of one and the same cubic.
        states, slopes = local_cubic(times, states, window)
    parts = []
    for weight, sample, side in STENCILS[rule]:
        part = slice(sample, sample + n)
        # The equation is linear in everything that is weighed, so that rows may be averaged.
        found = form.evaluate(states[part], slopes, signals[side][part], times[part])
        parts.append((weight * found[0], weight * found[1]))
    targets, regressors = zip(*parts, strict=True)
    return np.sum(targets, axis=0), np.sum(regressors, axis=0)


def check_free(model: Model, who: str) -> None:
    """Raise :class:`ModelError` without free parameters, or for some that differ by record."""
    if not model.free_parameters:
        raise ModelError(f"Model {model.name!r} has no free parameter. Free some with model.free.")
    if local := [p.name for p in model.free_parameters if p.per_record]:
        raise ModelError(
            f"{', '.join(local)} differ from record to record, which {who} does not know: "
            f"{INSTEAD}."
        )


def check_rule(rule: str, window: int) -> None:
    """Raise :class:`ModelError` for an unknown rule or an impossible window."""
    check_choice("rule", rule, RULES)
    if window < 5 or window % 2 == 0:
        raise ModelError(f"window is {window}. Give an odd number of samples, 5 or more.")


def exact_rates(model: Model, dataset: Dataset) -> dict[str, np.ndarray]:
    """Rates of a model at the measured states, for tests on simulated records.

    Every state has to be measured. The rates are those just after each sample.

    Returns
    -------
    dict of str to ndarray (n_times, n_states)
    """
    form = regression_form(model)
    found = {}
    for record in dataset:
        states = states_of(form, record.outputs)
        signals, _ = actuator_signals(form, record.times, record.inputs)
        rates = form.graph.rates(states.T, signals.T, model.value_vector, record.times[None, :])
        found[record.name] = np.array(rates).T
    return found


def states_of(form: RegressionForm, outputs: np.ndarray) -> np.ndarray:
    """Measured states ``(n_times, n_states)``; zero where an equation needs none."""
    sources = {output.source: column for column, output in enumerate(form.model.outputs)}
    states = np.zeros((len(outputs), len(form.graph.state_names)))
    for index, name in enumerate(form.graph.state_names):
        if name in sources:
            series = outputs[:, sources[name]]
            unused = name not in form.needed and not np.isfinite(series).all()
            states[:, index] = 0.0 if unused else series
    return states


def actuator_signals(
    form: RegressionForm, times: np.ndarray, inputs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Actuator signals just after and just before the samples.

    Returns
    -------
    after : ndarray (n_times, n_signals)
        At the beginning of the step that follows each sample.
    before : ndarray (n_times, n_signals)
        At the end of the step that led to it; of the first sample, ``after``.
    """
    graph, model = form.graph, form.model
    inputs = input_array(model, len(times), inputs)
    values, linear = model.value_vector, np.array(graph.linear_inputs, dtype=bool)
    if not graph.actuate.size1_out(0):
        return np.empty((len(times), 0)), np.empty((len(times), 0))
    # Actuators are integrated alone, in the steps of the simulation.
    intervals = np.diff(times, append=2 * times[-1] - times[-2])
    counts = np.maximum(np.ceil(intervals / model.step - 1e-9), 1.0)
    h = intervals / counts
    ends = np.where(linear, np.vstack([inputs[1:], inputs[-1:]]), inputs)
    slopes = (ends - inputs) / counts[:, None]
    # Their memory at the samples, and at the last step before the next sample.
    held, late = np.empty((2, len(times), graph.n_actuator_memory))
    if graph.n_actuator_memory:
        z = np.array(graph.start(np.zeros(graph.n_own), inputs[0], values, times[0])).ravel()
        memory = z[graph.n_states : graph.n_states + graph.n_actuator_memory]
        for k, time in enumerate(times):
            held[k] = memory
            for i in range(int(counts[k])):
                late[k] = memory
                middle = inputs[k] + (i + 0.5) * slopes[k]  # command at the middle of the step
                moved = graph.actuate(memory, middle, values, time + i * h[k], h[k])[1]
                memory = np.array(moved).ravel()

    def signals(memory: np.ndarray, commands: np.ndarray, at: np.ndarray) -> np.ndarray:
        found = graph.actuate(memory.T, commands.T, values, at[None, :], h[None, :])[0]
        return np.array(found).T

    after = signals(held, inputs, times)
    before = signals(late, ends, times + (counts - 1.0) * h)
    return after, np.vstack([after[:1], before[:-1]])


def local_cubic(times: np.ndarray, series: np.ndarray, window: int) -> tuple[np.ndarray, ...]:
    """Value and slope of cubics fitted to ``window`` samples around each time.

    Parameters
    ----------
    times : ndarray (n_times,)
        Any increasing times.
    series : ndarray (n_times, n_signals)
        A missing sample makes the values that need it NaN.
    window : int
        Odd number of samples; at the ends the cubic is one-sided.

    Returns
    -------
    values, slopes : ndarray (n_times, n_signals)

    References
    ----------
    Savitzky & Golay (1964), Smoothing and differentiation of data by
    simplified least squares procedures, Analytical Chemistry 36.
    """
    n = len(times)
    width = min(window, n)
    first = np.clip(np.arange(n) - width // 2, 0, n - width)
    index = first[:, None] + np.arange(width)
    offset = times[index] - times[:, None]
    # Offsets of unit size keep the powers of the cubic comparable.
    scale = np.abs(offset).max(axis=1)
    basis = (offset / scale[:, None])[:, :, None] ** np.arange(min(4, width))
    weights = np.linalg.pinv(basis)  # (n, order, width)
    values = np.einsum("nw,nws->ns", weights[:, 0], series[index])
    slopes = np.einsum("nw,nws->ns", weights[:, 1], series[index]) / scale[:, None]
    return values, slopes
