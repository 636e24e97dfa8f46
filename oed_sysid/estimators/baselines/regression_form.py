"""A model as linear regressions: which equations are linear in what is unknown.

The equations of motion, inertia times rates minus forces, are differentiated by
the free parameters. Where the derivatives do not depend on the parameters, the
equations are ``target = regressors @ parameters`` and least squares applies.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from oed_sysid.compiled.graph import Graph, build
from oed_sysid.errors import ModelError
from oed_sysid.model import Model

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
    >>> from oed_sysid.channels import Input, Output, State
    >>> from oed_sysid.effects import Force
    >>> from oed_sysid.parameters import Parameter
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
        n = len(times)
        if n == 0:
            return np.empty((0, len(self.equations))), np.empty(
                (0, len(self.equations), len(self.names))
            )
        values = ca.DM(self.model.value_vector)
        target, flat = self._function(states.T, rates.T, signals.T, values, times[None, :])
        # CasADi stacks columns: regressors come as (n_equations * n_free, n_rows).
        shaped = np.array(flat).reshape(len(self.names), len(self.equations), n)
        return np.array(target).T, shaped.transpose(2, 1, 0)


def regression_form(model: Model) -> RegressionForm:
    """Derive targets and regressors of a model.

    Raises
    ------
    ModelError
        If the equations are not linear in the free parameters; the message
        names the parameters and the equations.
    """
    free = model.free_parameters
    if not free:
        raise ModelError(f"Model {model.name!r} has no free parameter. Free some with model.free.")
    local = [p.name for p in free if p.per_record]
    if local:
        raise ModelError(
            f"{', '.join(local)} differ from record to record, which regressions do not know: "
            f"{INSTEAD}."
        )
    graph = build(model)
    x, rate, d, p, t = (graph.balance.sx_in(i) for i in range(5))
    p_free = p[list(graph.free_indices), 0]
    residual = graph.balance(x, rate, d, p, t)
    slope = ca.jacobian(residual, p_free)
    _check_linear(model, graph, slope, p_free)
    holds = np.array(ca.DM(slope.sparsity(), 1.0)) != 0
    rows = np.flatnonzero(holds.any(axis=1))
    names = model.free_names
    regressors = -slope[rows.tolist(), :]
    # The target is what is left when every free parameter is zero.
    target = ca.substitute(residual[rows.tolist(), 0], p_free, ca.DM.zeros(len(names)))
    both = ca.vertcat(target, ca.vec(regressors))
    needed = []
    for i, name in enumerate(graph.state_names):
        if ca.depends_on(both, ca.vertcat(x[i], rate[i])):
            needed.append(name)
    function = ca.Function(
        "regression",
        [x, rate, d, p, t],
        [ca.densify(target), ca.densify(ca.vec(ca.densify(regressors)))],
        {"cse": True},
    )
    _check_measured(model, tuple(needed))
    return RegressionForm(
        model=model,
        names=names,
        equations=tuple(graph.state_names[i] for i in rows),
        needed=tuple(needed),
        graph=graph,
        _function=function,
    )


def _check_linear(model: Model, graph: Graph, slope: ca.SX, p_free: ca.SX) -> None:
    """Raise where a parameter acts elsewhere than linearly in the equations of motion."""
    names, free = model.free_names, list(graph.free_indices)
    in_motion = (np.array(ca.DM(slope.sparsity(), 1.0)) != 0).any(axis=0)
    in_actuators = np.zeros(len(names), dtype=bool)
    if graph.actuate.size1_out(0):
        for output in range(2):
            pattern = np.array(ca.DM(graph.actuate.jac_sparsity(output, 2), 1.0))
            in_actuators |= (pattern[:, free] != 0).any(axis=0)
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
    wrong = [name for i, name in enumerate(names) if ca.depends_on(slope, p_free[i])]
    if wrong:
        states = [
            state
            for row, state in enumerate(graph.state_names)
            if ca.depends_on(slope[row, :], p_free)
        ]
        raise ModelError(
            f"Model {model.name!r} is not linear in {', '.join(wrong)}, in the equation of "
            f"{', '.join(states)}. Where one parameter divides another, write it as an inertia "
            "(axes={'N': 'r'}, inertia={('N', 'r'): 'T'}); otherwise fix all but one of them with "
            "model.fix(...), or use MultipleShooting, which needs no linearity."
        )


def _check_measured(model: Model, needed: tuple[str, ...]) -> None:
    """Raise where a state of the equations is not measured as it is."""
    measured = {output.source: output.name for output in model.outputs}
    missing = [name for name in needed if name not in measured]
    if missing:
        raise ModelError(
            f"The regressions of model {model.name!r} contain {', '.join(missing)}, which no "
            f"output measures. Measured are {', '.join(model.output_names)}. Add an output, or use "
            "MultipleShooting, which estimates states that are not measured."
        )
    for effect in model.effects:
        if effect.stage != "sensor" or not any(p.value for p in effect.parameters):
            continue
        touched = [name for name in needed if measured[name] in effect.terms]
        if touched:
            raise ModelError(
                f"The measurement of {', '.join(touched)} passes the sensor effect "
                f"{effect.name!r}, which regressions cannot undo. Use model.without"
                f"({effect.name!r}) and correct the record, or use MultipleShooting."
            )
