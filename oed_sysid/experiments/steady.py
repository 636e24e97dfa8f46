"""Equilibria (trim conditions) and linear models around them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from oed_sysid.compiled import graph as graph_module
from oed_sysid.compiled.graph import Graph
from oed_sysid.errors import SimulationError, located
from oed_sysid.experiments import SAYS
from oed_sysid.experiments.experiment import Limits
from oed_sysid.experiments.trajectory import state_scales
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import ROUNDING
from oed_sysid.runtime.display import Report, as_text

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class Equilibrium:
    """A state and inputs at which chosen rates vanish.

    Attributes
    ----------
    states : mapping of str to float
        All states, those that effects add included.
    inputs : mapping of str to float
        All inputs.
    rates : mapping of str to float
        Rate of every state there; a turning ship keeps changing its heading.
    steady : tuple of str
        States whose rates were asked to vanish.
    solved : tuple of str
        States and inputs that were solved for.
    ok : bool
        Whether these rates vanish.
    status : str
        What came out, and what to do if there is none.

    Examples
    --------
    What :func:`~oed_sysid.experiments.steady.equilibrium` returns; see there.
    """

    states: Mapping[str, float]
    inputs: Mapping[str, float]
    rates: Mapping[str, float] = field(repr=False)
    steady: tuple[str, ...]
    solved: tuple[str, ...]
    ok: bool
    status: str

    @property
    def residual(self) -> float:
        """Largest of the rates that should vanish, in SI units per second."""
        return max((abs(self.rates[name]) for name in self.steady), default=0.0)

    def document(self) -> Report:
        """Return the trim condition."""
        values = {**self.states, **self.inputs}
        return Report(self.status, head=tuple((n, f"{v: .6g}") for n, v in values.items()))

    report = as_text


def equilibrium(
    model: Model,
    *,
    inputs: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    free: Iterable[str] = (),
    steady: Iterable[str] | None = None,
    guess: Mapping[str, float] | None = None,
    limits: Limits | None = None,
) -> Equilibrium:
    """Find a trim condition: the states and inputs for which nothing accelerates.

    Parameters
    ----------
    model : Model
        The model. Its actuators are taken as settled and the time as zero.
    inputs : mapping of str to float
        Inputs that are given.
    fixed : mapping of str to float
        States that are given.
    free : iterable of str
        Inputs to solve for (all states that are not fixed are solved for,
        unless nothing depends on them, as on a position).
    steady : iterable of str, optional
        States whose rates vanish; by default all on which something depends.
        Name positions here to hold them too, such as the depth.
    guess : mapping of str to float
        Where the search begins; zero unless stated.
    limits : Limits, optional
        Ranges of inputs and states that the search respects.

    Returns
    -------
    Equilibrium
        With ``ok=False`` and a status that advises if there is none.

    Raises
    ------
    SimulationError
        If names are unknown, or an input is neither given nor free.

    Examples
    --------
    A body that sinks with quadratic drag reaches its terminal speed:

    >>> from oed_sysid.physics.channels import Input, Output, State
    >>> body = Model(
    ...     "sinking body", (State("z", "m"), State("w", "m/s")), (Input("weight", "N"),),
    ...     (Output("z", "m"),), {"z": "w", "w": "(weight - 8*w*abs(w))/20"},
    ... )
    >>> trim = equilibrium(body, inputs={"weight": 2.0})
    >>> trim.ok, round(trim.states["w"], 6), trim.rates["z"] == trim.states["w"]
    (True, 0.5, True)
    """
    graph = graph_module.build(model)
    names, wanted = graph.state_names, tuple(free)
    order = (*names, *model.input_names)
    given = {**(inputs or {}), **(fixed or {})}
    known = {**dict.fromkeys(order, 0.0), **(guess or {}), **given}
    function = _settled(graph, model.step)
    # States on which some rate depends; a position usually is not among them.
    used = sorted(set(function.sparsity_out(1).get_triplet()[1]))
    depended = tuple(names[index] for index in used if index < len(names))
    target = tuple(steady) if steady is not None else depended
    lacking = f"Model {model.name!r} has no state or input"
    located(SimulationError, lacking, (*given, *wanted, *target, *known), order)
    if both := {*given} & {*wanted}:
        raise SimulationError(f"{', '.join(sorted(both))} is both given and free. Choose one.")
    for name in model.input_names:
        if name not in {*given, *wanted}:
            raise SimulationError(SAYS["neither_given_nor_free"].format(name=name))
    unknowns = tuple(name for name in order if name in {*depended, *wanted} - given.keys())
    point = np.array([known[name] for name in order])
    rows, columns = [*map(names.index, target)], [*map(order.index, unknowns)]
    scales = np.array([*state_scales(model, len(names)), *np.ones(len(model.input_names))])

    def settled(trial: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Point with the unknowns in their places; rates there, and their derivatives."""
        full = point.copy()
        full[columns] = trial
        found = function(full[: len(names)], full[len(names) :], model.value_vector)
        return full, np.array(found[0]).ravel(), np.array(found[1])

    def misses(trial: np.ndarray) -> np.ndarray:
        return settled(trial)[1][rows] / scales[rows]

    def slopes(trial: np.ndarray) -> np.ndarray:
        return settled(trial)[2][np.ix_(rows, columns)] / scales[rows, np.newaxis]

    best = _zero(misses, slopes, point[columns], scales[columns], _bounds(limits, unknowns))
    full, found, _ = settled(best)
    left, rates = np.abs(misses(best)), dict(zip(names, found.tolist(), strict=True))
    ok = bool(np.isfinite(left).all() and (left < ROUNDING).all())
    worst = target[int(np.argmax(left))] if target else ""
    return Equilibrium(
        states=dict(zip(names, full[: len(names)].tolist(), strict=True)),
        inputs=dict(zip(model.input_names, full[len(names) :].tolist(), strict=True)),
        rates=rates,
        steady=target,
        solved=unknowns,
        ok=ok,
        status=_status(model, ok, worst, rates.get(worst, 0.0), unknowns),
    )


def _zero(
    misses: Callable[[np.ndarray], np.ndarray],
    slopes: Callable[[np.ndarray], np.ndarray],
    first: np.ndarray,
    sizes: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Where least squares within bounds, from several starts, leaves least of the misses."""
    from scipy.optimize import least_squares  # a fifth of a second, which fits do without

    best = first
    for push in (0.0, 0.1, 1.0, -1.0) if len(first) and len(misses(first)) else ():
        # Zero is often a singular start: |u|u has no slope there.
        start = np.clip(first + push * sizes, *bounds)
        if not np.isfinite(misses(start)).all():
            continue
        found = least_squares(
            misses, start, slopes, bounds, x_scale=sizes, xtol=1e-15, ftol=1e-15, gtol=1e-15,
            max_nfev=500,
        )  # fmt: skip
        if np.linalg.norm(found.fun) < np.linalg.norm(misses(best)) or not push:
            best = found.x
        if np.abs(misses(best)).max() < ROUNDING:
            break
    return best


def linearise(
    model: Model, point: Equilibrium, *, outputs: Iterable[str] | None = None
) -> control.StateSpace:
    """Linear state-space model for small deviations from an equilibrium.

    Actuators and sensors are taken as settled: their gains and offsets are in
    the result, their delays and lags are not.

    Parameters
    ----------
    model : Model
        The model.
    point : Equilibrium
        From :func:`equilibrium`; rates that do not vanish there (a position
        that travels) only move the point.
    outputs : iterable of str, optional
        Outputs to keep; all by default.

    Returns
    -------
    control.StateSpace
        Labelled with the names of inputs, outputs and states; ``poles()``
        gives the modes.

    Raises
    ------
    SimulationError
        If the point is no equilibrium or an output is unknown.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Input, Output, State
    >>> nomoto = Model(
    ...     "Nomoto", (State("r", "rad/s"),), (Input("rudder", "rad"),),
    ...     (Output("r", "rad/s"),), {"r": "(0.1*rudder - r)/8"},
    ... )
    >>> linear = linearise(nomoto, equilibrium(nomoto, inputs={"rudder": 0.0}))
    >>> print(linear.poles().real, linear.input_labels, float(linear.dcgain()))
    [-0.125] ['rudder'] 0.1
    """
    import control  # slow to import, and needed here only

    if not point.ok:
        raise SimulationError(
            f"Model {model.name!r} can be linearised at an equilibrium only. {point.status}"
        )
    graph = graph_module.build(model)
    kept = tuple(outputs) if outputs is not None else model.output_names
    rows = located(SimulationError, f"Model {model.name!r} has no output", kept, model.output_names)
    n_states = graph.n_states
    x = np.array([point.states[name] for name in graph.state_names])
    u = np.array([point.inputs[name] for name in model.input_names])
    motion, seen = map(np.array, _settled(graph, model.step)(x, u, model.value_vector)[1:])
    return control.ss(
        motion[:, :n_states],
        motion[:, n_states:],
        seen[rows, :n_states],
        seen[rows, n_states:],
        inputs=list(model.input_names),
        outputs=list(kept),
        states=list(graph.state_names),
        name=model.name,
    )


def _settled(graph: Graph, step: float) -> ca.Function:
    """Rates, and the derivatives of rates and of outputs by states and inputs.

    Actuators and sensors are settled, and the time is zero.
    """
    model = graph.model
    x = ca.SX.sym("x", graph.n_states)
    u = ca.SX.sym("u", len(model.inputs))
    p = ca.SX.sym("p", len(model.all_parameters))
    full = graph.start(x[: graph.n_own, 0], u, p, 0.0)
    memory, sensors = ca.vertsplit(
        full[graph.n_states :, 0],
        [0, graph.n_actuator_memory, full.numel() - graph.n_states],
    )
    signals, _ = graph.actuate(memory, u, p, 0.0, step)
    rates = graph.rates(x, signals, p, 0.0)
    y, _ = graph.observe(x, signals, sensors, p, 0.0, step)
    both = ca.vertcat(x, u)
    slopes = [ca.jacobian(rates, both), ca.densify(ca.jacobian(y, both))]
    return ca.Function("settled", [x, u, p], [rates, *slopes])


def _bounds(limits: Limits | None, unknowns: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    ranges = {} if limits is None else dict(limits.inputs) | dict(limits.signals)
    pairs = [ranges.get(name, (-np.inf, np.inf)) for name in unknowns]
    lower, upper = np.array(pairs, dtype=float).reshape(-1, 2).T
    return lower, upper


def _status(model: Model, ok: bool, worst: str, rate: float, unknowns: tuple[str, ...]) -> str:
    if ok:
        return str(SAYS["equilibrium"].format(model, n=len(unknowns)))
    tied = [name for name in model.input_names if name not in unknowns]
    more = f"Free another input ({', '.join(tied)})" if tied else "Widen the limits"
    facts = {"unknowns": ", ".join(unknowns) or "nothing", "worst": worst, "rate": rate}
    return str(SAYS["no_equilibrium"].format(model, **facts, more=more))
