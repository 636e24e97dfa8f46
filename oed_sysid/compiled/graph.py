r"""From a model's text to CasADi expressions: actuate, move, observe, start.

The chain is cut where physics cuts it. *Actuate* and *observe* are sampled
maps with memory; *rates* is an ordinary differential equation between them.

=========  =====================================  ========================
function   arguments                              results
=========  =====================================  ========================
actuate    memory, inputs, parameters, t, h       signals, next memory
rates      states, signals, parameters, t         rates of the states
balance    states, their rates, signals,          inertia times rates minus
           parameters, t                          forces, zero in motion
observe    states, signals, memory, parameters,   outputs, next memory; rates and
           t, h                                   forces where an output names them
start      own states, inputs, parameters, t      full state
=========  =====================================  ========================

Explicit models move by the classical Runge-Kutta method of order four. Stiff ones
(``Model(integrator="implicit")``) by three stages of order three, L-stable and stiffly
accurate, each solved by Newton's method,

.. math::
    X_i = x + h \sum_{j<i} a_{ij} k_j + h\gamma\, f(X_i, d(t + c_i h)), \qquad
    k_i = \frac{X_i - x}{h\gamma} - \sum_{j<i} \frac{a_{ij}}{\gamma} k_j, \qquad
    x^+ = X_3

with :math:`\gamma` the root of :math:`\gamma^3 - 3\gamma^2 + 3\gamma/2 - 1/6` near 0.436
(Alexander 1977, *SIAM J. Numer. Anal.* 14, 1006). Sensitivities are those of the stages'
own equations, :math:`(I - h\gamma f_x)\, S_i = s + h\sum a_{ij} k_j' + h\gamma (f_d d' + f_p)`,
and hence exact for the step as it is.

The full state ``z`` stacks the model's own states, states added by effects,
actuator memory and sensor memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.physics.structure import is_sampled
from oed_sysid.runtime.constants import RANK_TOLERANCE, ROUNDING
from oed_sysid.text.expressions import names, to_casadi

Scope = dict[str, ca.SX]

# The implicit method: gamma, the middle root of 6 x^3 - 18 x^2 + 9 x - 1, with which three stages
# are of third order and L-stable (Alexander 1977), and what follows: coefficients of stages, times.
GAMMA = 1.0 + math.sqrt(2.0) * math.cos((math.acos(math.sqrt(8.0) / 3.0) - math.tau) / 3.0)
STAGES = (
    (GAMMA, 0.0, 0.0),
    ((1.0 - GAMMA) / 2.0, GAMMA, 0.0),
    (
        -(6.0 * GAMMA**2 - 16.0 * GAMMA + 1.0) / 4.0,
        (6.0 * GAMMA**2 - 20.0 * GAMMA + 5.0) / 4.0,
        GAMMA,
    ),
)
FRACTIONS = (GAMMA, (1.0 + GAMMA) / 2.0, 1.0)
# Steps after which Newton's method gives up: one that only halves its error has found all digits
# of a number by then. It ends where a step is rounding.
NEWTON_MOST = int(np.finfo(float).nmant)
# Sum of the states from which on a run has diverged: cubes of its errors are still numbers.
DIVERGED = float(np.cbrt(np.finfo(float).max))


@dataclass(frozen=True)
class Graph:
    """CasADi functions of a model and the sizes of their arguments."""

    model: Model
    actuate: ca.Function
    rates: ca.Function
    balance: ca.Function
    observe: ca.Function
    start: ca.Function
    state_names: tuple[str, ...]
    n_own: int
    n_states: int
    n_actuator_memory: int
    n_sensor_memory: int

    @property
    def n_full(self) -> int:
        """Length of the full state ``z``."""
        return self.n_states + self.n_actuator_memory + self.n_sensor_memory

    @property
    def free_indices(self) -> tuple[int, ...]:
        """Places of the free parameters among all."""
        free = set(self.model.free_names)
        return tuple(i for i, name in enumerate(self.model.parameter_names) if name in free)

    @property
    def linear_inputs(self) -> tuple[bool, ...]:
        """For each input, whether it is interpolated linearly between samples."""
        return tuple(channel.interpolation == "linear" for channel in self.model.inputs)

    @cached_property
    def settled(self) -> ca.Function:
        """Rates of the own states, and outputs, where effects are settled.

        Of ``(own states, inputs, p, t)``.
        """
        own, inputs, p, t = self.start.sx_in()
        x, memory, sensor = self._split(self.start(own, inputs, p, t))
        drive, _ = self.actuate(memory, inputs, p, t, 1.0)
        rates = self.rates(x, drive, p, t)[: self.n_own]
        outputs, _ = self.observe(x, drive, sensor, p, t, 1.0)
        return ca.Function("settled", [own, inputs, p, t], [rates, outputs], {"cse": True})

    @cached_property
    def advance(self) -> ca.Function:
        """One integration step ``(z, inputs at start and end, p, t, h) -> z``.

        Sensor memory is left to :attr:`sample`, between two steps as at the samples.
        """
        z, start, end, p, t, h = self._step_symbols()
        if self.model.integrator == "implicit":
            moved = self._stages(z, start, end, p, t, h)
            return ca.Function("advance", [z, start, end, p, t, h], [moved])
        x, memory, sensor = self._split(z)
        # Held inputs are one and the same over a step; linear ones are asked at its start, middle,
        # end.
        linear = any(self.linear_inputs)
        asked = (start, (start + end) / 2, end) if linear else (start, start, start)
        acting = (self.actuate(memory, inputs, p, t, h) for inputs in asked)
        (first, _), (centre, memory_next), (last, _) = acting
        k1 = self.rates(x, first, p, t)
        k2 = self.rates(x + h / 2 * k1, centre, p, t + h / 2)
        k3 = self.rates(x + h / 2 * k2, centre, p, t + h / 2)
        k4 = self.rates(x + h * k3, last, p, t + h)
        x_next = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        z_next = ca.vertcat(x_next, memory_next, sensor)
        return ca.Function("advance", [z, start, end, p, t, h], [z_next], {"cse": True})

    def _stages(self, z: ca.SX, start: ca.SX, end: ca.SX, p: ca.SX, t: ca.SX, h: ca.SX) -> ca.SX:
        """State after an implicit step."""
        x, memory, sensor = self._split(z)
        stage, slopes = self._stage(), list[ca.SX]()
        change = ca.SX([float(one) for one in self.linear_inputs]) * (end - start)
        for weights, fraction in zip(STAGES, FRACTIONS, strict=True):
            base = x + sum(h * a * k for a, k in zip(weights, slopes, strict=False))
            d, _ = self.actuate(memory, start + fraction * change, p, t, h)
            reached = stage(base, d, p, t + fraction * h, h)
            # The slope of a stage follows from where it arrives, without evaluating the rates
            # again.
            slopes.append((reached - base) / (h * GAMMA))
        _, following = self.actuate(memory, start + change / 2, p, t, h)
        # Stiffly accurate: the last stage is the end of the step.
        return ca.vertcat(reached, following, sensor)

    def _stage(self) -> ca.Function:
        """Solution of one stage ``(base, signals, p, t, h) -> x``; NaN where there is none."""
        y, base = ca.SX.sym("y", self.n_states), ca.SX.sym("base", self.n_states)
        d, p = (ca.SX.sym(name, self.rates.size1_in(i)) for name, i in (("d", 1), ("p", 2)))
        t, h = ca.SX.sym("t"), ca.SX.sym("h")
        # In units of each state's size, so that one tolerance serves all of them.
        size = ca.fmax(
            ca.fmax(ca.fabs(base), ca.fabs(h * GAMMA * self.rates(base, d, p, t))),
            RANK_TOLERANCE,  # of an SI unit: a state that is zero has no size of its own
        )
        miss = y - (base + h * GAMMA * self.rates(y * size, d, p, t)) / size
        known = ca.vertcat(base, d, p, t, h)
        options = {"abstolStep": ROUNDING, "max_iter": NEWTON_MOST, "line_search": False}
        problem = {"x": y, "p": known, "g": miss}
        solve = ca.rootfinder("solve", "newton", problem, options | {"error_on_fail": False})
        # What the solver takes for converged is one step of Newton's method away from it.
        last = ca.Function("last", [y, known], [ca.solve(ca.jacobian(miss, y), miss)])
        reached = solve(base / size, known)
        step = last(reached, known)
        arrived = ca.mmax(ca.fabs(step)) <= ROUNDING
        return ca.Function(
            "stage", [base, d, p, t, h], [ca.if_else(arrived, (reached - step) * size, np.nan)]
        )

    @cached_property
    def sample(self) -> ca.Function:
        """One measurement ``(z, inputs, p, t, h) -> (y, z with updated sensor memory)``.

        Sensor memory takes in every moment between two integration steps, and ``h`` is the length
        of the last step: what sensors make of a signal is as exact as its integration.
        """
        z, start, _, p, t, h = self._step_symbols()
        x, memory, sensor = self._split(z)
        signals, _ = self.actuate(memory, start, p, t, h)
        y, sensor_next = self.observe(x, signals, sensor, p, t, h)
        z_next = ca.vertcat(x, memory, sensor_next)
        return ca.Function("sample", [z, start, p, t, h], [y, z_next], {"cse": True})

    def _step_symbols(self) -> tuple[ca.SX, ...]:
        n_inputs = len(self.model.inputs)
        return (
            ca.SX.sym("z", self.n_full),
            ca.SX.sym("start", n_inputs),
            ca.SX.sym("end", n_inputs),
            ca.SX.sym("p", len(self.model.all_parameters)),
            ca.SX.sym("t"),
            ca.SX.sym("h"),
        )

    def _split(self, z: ca.SX) -> list[ca.SX]:
        """States, memory of actuators and memory of sensors."""
        memories = self.n_states, self.n_states + self.n_actuator_memory
        return ca.vertsplit(z, [0, *memories, self.n_full])


_CACHE: dict[str, Graph] = {}


def build(model: Model) -> Graph:
    """Build (or fetch) the CasADi functions of a model's structure."""
    key = model.structure_key()
    if key not in _CACHE:
        _CACHE[key] = _build(model)
    return _CACHE[key]


def differentiated(
    function: ca.Function, arguments: Iterable[int], p: int, free: tuple[int, ...], name: str
) -> ca.Function:
    """Function with, behind its results, the sparse derivatives of each by some arguments.

    The argument ``p``, of all parameters, stands for its ``free`` entries only.
    """
    symbols = function.sx_in()
    results = function.call(symbols)
    jacobians = []
    for result in results:
        for index in arguments:
            jacobian = ca.jacobian(result, symbols[index])
            jacobians.append(jacobian[:, list(free)] if index == p else jacobian)
    return ca.Function(f"{function.name()}_{name}", symbols, [*results, *jacobians], {"cse": True})


def _chain(effects: Iterable[Effect], stage: str) -> list[Effect]:
    return [effect for effect in effects if effect.stage == stage]


def _apply(effect: Effect, scope: Scope, tables: Mapping) -> tuple[Scope, Scope]:
    """Evaluate definitions and terms of a signal effect; all read the old values."""
    local = dict(scope)
    for name, text in effect.definitions.items():
        local[name] = to_casadi(text, local, tables)
    return local, {key: to_casadi(text, local, tables) for key, text in effect.terms.items()}


def _symbols(named: Iterable[str]) -> Scope:
    return {name: ca.SX.sym(name) for name in named}


def _vertcat(items: Iterable[ca.SX]) -> ca.SX:
    parts = list(items)
    return ca.densify(ca.vertcat(*parts)) if parts else ca.SX(0, 1)


def _build(model: Model) -> Graph:
    tables = model.library
    states = _symbols(model.all_state_names)
    inputs, parameters = _symbols(model.input_names), _symbols(model.parameter_names)
    t, h = ca.SX.sym("t"), ca.SX.sym("h")
    always = parameters | {"t": t, "h": h}
    p, x, command = (_vertcat(part.values()) for part in (parameters, states, inputs))

    # Actuators: sampled, with memory; those with states of their own move with the vehicle.
    actuators = _chain(model.effects, "actuator")
    sampled = [effect for effect in actuators if is_sampled(model, effect)]
    scope = inputs | always
    ideal = {name: to_casadi(text, scope, tables) for name, text in model.actuator_signals.items()}
    acting = _Sampled.of(sampled, scope, ideal, tables)
    actuate = ca.Function(
        "actuate",
        [acting.memory, command, p, t, h],
        [_vertcat(acting.signals.values()), acting.following],
        {"cse": True},
    )

    # Motion between the samples.
    drive = _symbols(acting.signals)
    speeds = {name: ca.SX.sym(f"{name}_rate") for name in states}
    rates, balance, scope = _motion(model, speeds, states | drive | always)
    d = _vertcat(drive.values())
    move = ca.Function("rates", [x, d, p, t], [rates], {"cse": True})
    equations = ca.Function("balance", [x, _vertcat(speeds.values()), d, p, t], [balance])

    # Sensors: sampled, with memory.
    measured = {o.name: to_casadi(o.source, scope, tables) for o in model.outputs}
    sensing = _Sampled.of(_chain(model.effects, "sensor"), scope, measured, tables)
    observe = ca.Function(
        "observe",
        [x, d, sensing.memory, p, t, h],
        [_vertcat(sensing.signals.values()), sensing.following],
        {"cse": True},
    )

    # Start: what the model's own states imply for everything else.
    own = {name: states[name] for name in model.state_names}
    ready = own | inputs | always | acting.settled
    # States of effects begin where own states, parameters and settled actuators put them.
    extra = [to_casadi(s.initial, ready, tables) for e in model.effects for s in e.states]
    x_start = _vertcat([*own.values(), *extra])
    first = ca.Function("first", [x, d, p, t, h], [sensing.initial], {"allow_free": False})
    full = ca.vertcat(
        x_start, acting.initial, first(x_start, _vertcat(acting.settled.values()), p, t, 1.0)
    )
    # The step length is not known before the first sample; nothing may depend on it.
    full = ca.densify(ca.substitute(full, h, 1.0))
    start = ca.Function("start", [_vertcat(own.values()), command, p, t], [full], {"cse": True})
    return Graph(
        model=model,
        actuate=actuate,
        rates=move,
        balance=equations,
        observe=observe,
        start=start,
        state_names=tuple(states),
        n_own=len(own),
        n_states=len(states),
        n_actuator_memory=acting.memory.numel(),
        n_sensor_memory=sensing.memory.numel(),
    )


@dataclass(frozen=True)
class _Sampled:
    """A chain of signals with memory, effect by effect: of actuators, or of sensors.

    ``memory``, ``following`` and ``initial`` stack what is remembered, the same a sample later
    and at the first one; ``signals`` leave the chain, ``settled`` do so where every memory is at
    its initial value.
    """

    memory: ca.SX
    following: ca.SX
    initial: ca.SX
    signals: Scope
    settled: Scope

    @classmethod
    def of(
        cls, effects: Iterable[Effect], scope: Scope, signals: Scope, tables: Mapping
    ) -> _Sampled:
        signals, settled = dict(signals), dict(signals)
        memory, following, initial = list[ca.SX](), list[ca.SX](), list[ca.SX]()
        for effect in effects:
            kept = {m.name: ca.SX.sym(f"{effect.name}.{m.name}") for m in effect.memory}
            local, new = _apply(effect, scope | signals | kept, tables)
            memory += kept.values()
            following += [to_casadi(m.update, local, tables) for m in effect.memory]
            begin = {m.name: to_casadi(m.initial, scope | settled, tables) for m in effect.memory}
            initial += begin.values()
            # In order along the chain: what one effect settles to is what the next one sees.
            settled |= _apply(effect, scope | settled | begin, tables)[1]
            signals |= new
        return cls(_vertcat(memory), _vertcat(following), _vertcat(initial), signals, settled)


def _motion(model: Model, speeds: Scope, scope: Scope) -> tuple[ca.SX, ca.SX, Scope]:
    """Rates of all states, the equations of their ``speeds``, and all that a sensor may see.

    Forces are those from ``scope``, in which actuators that move with the vehicle act before
    everything else.
    """
    tables = model.library
    rates: Scope = {}
    for effect in _chain(model.effects, "actuator"):
        if is_sampled(model, effect):
            continue
        local, new = _apply(effect, scope, tables)
        rates |= {state.name: to_casadi(state.rate, local, tables) for state in effect.states}
        scope = scope | new
    scope = _with_flow(model, scope)
    forces, sensed = _forces(model, scope, rates)
    for name, text in model.kinematics.items():
        rates[name] = to_casadi(text, scope, tables) + forces.get(name, ca.SX(0))
    # x' - f = 0: the form that is linear in masses and forces, which regressions use.
    balance = {name: speeds[name] - rates[name] for name in rates}
    accelerations, momentum = _momentum(model, scope, forces, speeds)
    rates |= accelerations
    balance |= momentum
    for key in (*model.axes, *model.kinematics):
        sensed[f"force({key})"] = forces.get(key, ca.SX(0))
    sensed |= {f"dot({name})": rate for name, rate in rates.items()}
    stacked = [_vertcat(part[name] for name in speeds) for part in (rates, balance)]
    return stacked[0], stacked[1], scope | sensed


def _with_flow(model: Model, scope: Scope) -> Scope:
    """Signals of the model, each as the effects of the environment leave it."""
    scope, tables = dict(scope), model.library
    for signal, text in model.signals.items():
        scope[signal] = to_casadi(text, scope, tables)
        for effect in _chain(model.effects, "environment"):
            if signal in effect.terms:
                local = dict(scope)
                for name, definition in effect.definitions.items():
                    # Definitions may need signals that come later in the chain; those are not for
                    # this signal.
                    if names(definition) <= local.keys():
                        local[name] = to_casadi(definition, local, tables)
                scope[signal] = to_casadi(effect.terms[signal], local, tables)
    return scope


def _forces(model: Model, scope: Scope, rates: Scope) -> tuple[Scope, Scope]:
    """Sum of the terms of each equation, and each of them; ``rates`` of added states are filled."""
    tables, total, single = model.library, Scope(), Scope()
    for effect in model.effects:
        if effect.stage == "actuator":
            continue
        local = scope
        if effect.stage == "force":
            local, new = _apply(effect, scope, tables)
            for key, term in new.items():
                total[key] = total.get(key, ca.SX(0)) + term
                single[f"force({key}, {effect.name})"] = term
        for state in effect.states:
            rates[state.name] = to_casadi(state.rate, local, tables)
    return total, single


def _momentum(model: Model, scope: Scope, forces: Scope, speeds: Scope) -> tuple[Scope, Scope]:
    """Solve the mass matrix for the accelerations of the axes.

    Also returned are the equations before that, inertia times ``speeds`` minus
    forces, by velocity: unlike the accelerations they are linear in masses.
    """
    if not model.axes:
        return {}, {}
    axes, velocities = list(model.axes), list(model.axes.values())
    stated = {axis for axis, _ in model.inertia}
    mass = ca.SX(ca.densify(ca.diag([float(axis not in stated) for axis in axes])))
    entries = [*model.inertia.items()]
    for effect in _chain(model.effects, "inertia"):
        entries += effect.terms.items()
    for (axis, velocity), text in entries:
        row, column = axes.index(axis), velocities.index(velocity)
        mass[row, column] += to_casadi(text, scope, model.library)
    right = ca.vertcat(*(forces.get(axis, ca.SX(0)) for axis in axes))
    balance = mass @ ca.vertcat(*(speeds[velocity] for velocity in velocities)) - right
    solved = dict(zip(velocities, ca.vertsplit(_solved(mass, right)), strict=True))
    return solved, dict(zip(velocities, ca.vertsplit(balance), strict=True))


def _solved(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solution of linear equations, by the cheapest way that the matrix allows."""
    n = matrix.size1()
    if n <= 4:
        return ca.inv_minor(matrix) @ right
    if all(ca.is_equal(matrix[i, j], matrix[j, i], 9) for i in range(n) for j in range(i)):
        # By the factors L D L': fewer operations than CasADi's QR, and no roots. Zeros stay zeros,
        # so that planes of motion that do not couple cost nothing; an inertia matrix is positive
        # definite, so that no pivot is sought.
        return ca.ldl_solve(right, *ca.ldl(ca.sparsify(matrix), False))
    return ca.solve(matrix, right)


def ways(model: Model) -> dict[str, bytes]:
    """How every actuator signal acts: in which equations, by which states and free parameters.

    The same for twin propellers, whatever they are called: neither has a coefficient of its own
    that is estimated.

    Parameters
    ----------
    model : Model

    Returns
    -------
    dict
        What is the same for signals that act alike, by signal.
    """
    if not model.inputs:
        return {}
    graph = build(model)
    x, rate, drive, p, t = graph.balance.sx_in()
    slopes = ca.jacobian(graph.balance(x, rate, drive, p, t), drive)
    by = ca.vertcat(x, p[list(graph.free_indices)])
    held = ca.jacobian_sparsity(ca.vec(ca.densify(slopes)), by)
    there, held = (np.array(ca.DM(where, 1.0)) != 0 for where in (slopes.sparsity(), held))
    each = np.split(held, there.shape[1])  # rows run through the equations of one after another
    free = set(model.free_names)
    return {
        signal: there[:, k].tobytes()
        + each[k].tobytes()
        + " ".join(sorted(names(text) & free)).encode()
        for k, (signal, text) in enumerate(model.actuator_signals.items())
    }
