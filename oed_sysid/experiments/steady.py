"""Equilibria (trim conditions) and linear models around them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from scipy.optimize import least_squares

from oed_sysid.compiled import graph as graph_module
from oed_sysid.compiled.graph import Graph
from oed_sysid.errors import SimulationError
from oed_sysid.experiments.experiment import Limits
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import Report, as_text

if TYPE_CHECKING:
    import control

# A rate counts as zero below this share of its state's scale per second.
_STEADY = 1e-8


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
    given = dict(inputs or {}) | dict(fixed or {})
    graph = graph_module.build(model)
    names, wanted = graph.state_names, tuple(free)
    _check(model, names, given, wanted, (*(steady or ()), *(guess or {})))
    function = _rates(graph, model.step)
    depended = _depended(function, names)
    target = tuple(steady) if steady is not None else depended
    order = (*names, *model.input_names)
    unknowns = tuple(n for n in order if n not in given and n in (*depended, *wanted))
    known = {**dict.fromkeys(order, 0.0), **(guess or {}), **given}
    point = np.array([known[name] for name in order])
    search = _Search(model, function, names, [names.index(n) for n in target],
                     [order.index(n) for n in unknowns], point)  # fmt: skip
    full = search.solved(_bounds(limits or Limits(), unknowns))
    return _described(model, search, full, target, unknowns)


def _described(
    model: Model,
    search: _Search,
    full: np.ndarray,
    target: tuple[str, ...],
    unknowns: tuple[str, ...],
) -> Equilibrium:
    """The point that a search has ended at, and whether it is an equilibrium."""
    misses, names = search.misses(full), search.names
    ok = bool(np.isfinite(misses).all() and (misses < _STEADY).all())
    worst = target[int(np.argmax(misses))] if len(misses) else ""
    rates = dict(zip(names, search.rates(full).tolist(), strict=True))
    return Equilibrium(
        states=dict(zip(names, full[: len(names)].tolist(), strict=True)),
        inputs=dict(zip(model.input_names, full[len(names) :].tolist(), strict=True)),
        rates=rates,
        steady=target,
        solved=unknowns,
        ok=ok,
        status=_status(model, ok, worst, rates.get(worst, 0.0), unknowns),
    )


class _Search:
    """Zero of chosen rates, in units of their states' scales, by least squares within bounds."""

    def __init__(
        self,
        model: Model,
        function: ca.Function,
        names: tuple[str, ...],
        rows: list[int],
        columns: list[int],
        point: np.ndarray,
    ) -> None:
        self.function, self.values = function, model.value_vector
        self.names, self.n = names, len(names)
        self.rows, self.columns, self.point = rows, columns, point
        self.scales = np.array([*_scales(model, names), *np.ones(len(model.input_names))])

    def full(self, trial: np.ndarray) -> np.ndarray:
        """States and inputs with the unknowns in their places."""
        full = self.point.copy()
        full[self.columns] = trial
        return full

    def rates(self, full: np.ndarray) -> np.ndarray:
        """Rate of every state."""
        return np.array(self.function(full[: self.n], full[self.n :], self.values)[0]).ravel()

    def residuals(self, trial: np.ndarray) -> np.ndarray:
        """Rates that should vanish, in scales per second."""
        return self.rates(self.full(trial))[self.rows] / self.scales[self.rows]

    def derivatives(self, trial: np.ndarray) -> np.ndarray:
        """Their derivatives by the unknowns."""
        full = self.full(trial)
        jacobian = np.array(self.function(full[: self.n], full[self.n :], self.values)[1])
        return jacobian[np.ix_(self.rows, self.columns)] / self.scales[self.rows, np.newaxis]

    def misses(self, full: np.ndarray) -> np.ndarray:
        """How far each rate is from zero."""
        return np.abs(self.residuals(full[self.columns]))

    def solved(self, bounds: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """States and inputs at the best point found from several starts."""
        first, sizes = self.point[self.columns], self.scales[self.columns]
        best = first
        for push in (0.0, 0.1, 1.0, -1.0) if self.columns and self.rows else ():
            # Zero is often a singular start: |u|u has no slope there.
            start = np.clip(first + push * sizes, *bounds)
            if not np.isfinite(self.residuals(start)).all():
                continue
            found = least_squares(
                self.residuals, start, self.derivatives, bounds, x_scale=sizes, xtol=1e-15,
                ftol=1e-15, gtol=1e-15, max_nfev=500,
            )  # fmt: skip
            if np.linalg.norm(found.fun) < np.linalg.norm(self.residuals(best)) or not push:
                best = found.x
            if np.abs(self.residuals(best)).max() < _STEADY:
                break
        return self.full(best)


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
    if unknown := [name for name in kept if name not in model.output_names]:
        raise SimulationError(
            f"Model {model.name!r} has no output {unknown[0]!r}. It has "
            f"{', '.join(model.output_names)}."
        )
    n_states = graph.n_states
    x = np.array([point.states[name] for name in graph.state_names])
    u = np.array([point.inputs[name] for name in model.input_names])
    _, motion = _rates(graph, model.step)(x, u, model.value_vector)
    seen = np.array(_readings(graph, model.step)(x, u, model.value_vector))
    motion, rows = np.array(motion), [model.output_names.index(name) for name in kept]
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


def _settled(graph: Graph, step: float) -> tuple[tuple[ca.SX, ca.SX, ca.SX], ca.SX, ca.SX]:
    """Symbols ``(states, inputs, parameters)``, settled signals and settled full state."""
    model = graph.model
    x = ca.SX.sym("x", graph.n_states)
    u = ca.SX.sym("u", len(model.inputs))
    p = ca.SX.sym("p", len(model.all_parameters))
    full = graph.start(x[: graph.n_own, 0], u, p, 0.0)
    memory = full[graph.n_states : graph.n_states + graph.n_actuator_memory, 0]
    signals, _ = graph.actuate(memory, u, p, 0.0, step)
    return (x, u, p), signals, full


def _rates(graph: Graph, step: float) -> ca.Function:
    """Rates and their derivatives by states and inputs, with settled actuators."""
    (x, u, p), signals, _ = _settled(graph, step)
    rates = graph.rates(x, signals, p, 0.0)
    return ca.Function("steady", [x, u, p], [rates, ca.jacobian(rates, ca.vertcat(x, u))])


def _readings(graph: Graph, step: float) -> ca.Function:
    """Return the derivatives of settled sensors by states and inputs."""
    (x, u, p), signals, full = _settled(graph, step)
    sensors = full[graph.n_states + graph.n_actuator_memory :, 0]
    y, _ = graph.observe(x, signals, sensors, p, 0.0, step)
    return ca.Function("readings", [x, u, p], [ca.densify(ca.jacobian(y, ca.vertcat(x, u)))])


def _depended(function: ca.Function, names: tuple[str, ...]) -> tuple[str, ...]:
    """States on which some rate depends; a position usually is not among them."""
    used = {column for _, column in zip(*function.sparsity_out(1).get_triplet(), strict=True)}
    return tuple(name for index, name in enumerate(names) if index in used)


def _scales(model: Model, names: tuple[str, ...]) -> np.ndarray:
    known = {state.name: state.scale for state in model.states}
    return np.array([known.get(name, 1.0) for name in names])


def _bounds(limits: Limits, unknowns: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    ranges = dict(limits.inputs) | dict(limits.signals)
    pairs = [ranges.get(name, (-np.inf, np.inf)) for name in unknowns]
    lower, upper = np.array(pairs, dtype=float).reshape(-1, 2).T
    return lower, upper


def _check(
    model: Model,
    states: tuple[str, ...],
    given: Mapping[str, float],
    free: tuple[str, ...],
    mentioned: tuple[str, ...],
) -> None:
    """Raise if a name is unknown, or an input neither given nor free."""
    known = (*states, *model.input_names)
    for name in (*given, *free, *mentioned):
        if name not in known:
            raise SimulationError(
                f"Model {model.name!r} has no state or input {name!r}. It has {', '.join(known)}."
            )
    if both := set(given) & set(free):
        raise SimulationError(f"{', '.join(sorted(both))} is both given and free. Choose one.")
    for name in model.input_names:
        if name not in given and name not in free:
            raise SimulationError(
                f"The input {name!r} is neither given nor free. Pass inputs={{{name!r}: value}} "
                f"or free=[{name!r}]."
            )


def _status(model: Model, ok: bool, worst: str, rate: float, unknowns: tuple[str, ...]) -> str:
    if ok:
        return f"Equilibrium of {model.name}: all {len(unknowns)} unknowns found."
    tied = [name for name in model.input_names if name not in unknowns]
    more = f" Free another input ({', '.join(tied)})," if tied else " Widen the limits,"
    return (
        f"No equilibrium of {model.name} was found with {', '.join(unknowns) or 'nothing'} to "
        f"solve for: {worst} keeps changing at {rate:.3g} per second.{more} begin from another "
        "guess, or ask for fewer steady states."
    )
