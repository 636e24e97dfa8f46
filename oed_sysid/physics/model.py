"""A vehicle's model: kinematics, inertia and a set of effects.

A model is text and numbers only. :mod:`oed_sysid.compiled.graph` turns it into CasADi
expressions and :mod:`oed_sysid.compiled.kernels` into compiled code.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import MappingProxyType

import casadi as ca

from oed_sysid.errors import ModelError
from oed_sysid.physics import Effect
from oed_sysid.physics.channels import SAYS, Input, Output, State
from oed_sysid.physics.parameters import Parameter, changed
from oed_sysid.physics.registers import refined
from oed_sysid.physics.structure import Structure, settle_parts, validate
from oed_sysid.runtime.display import as_html
from oed_sysid.text import callables, expressions

_RATE, _NAME = re.compile(r"dot\((\w+)\)"), re.compile(r"\b[^\W\d]\w*")


@dataclass(frozen=True)
class Model(Structure):
    r"""Equations of motion, actuators and sensors of one vehicle.

    .. math::

        M(p)\,\dot\nu = \sum_e \tau_e(x, d, t, p), \qquad
        \dot\eta = k(x, d, t, p), \qquad y = s(x, d, p)

    Parameters
    ----------
    name : str
        Name of the model.
    states : tuple of State
        State vector, in order.
    inputs : tuple of Input
        Commanded signals.
    outputs : tuple of Output
        Measured signals.
    kinematics : mapping
        ``state -> expression`` of its rate, for every state that is not the
        velocity of an axis; an identity model of any ODE has only these.
    axes : mapping
        ``axis -> velocity state``, for instance ``{"Z": "w"}``.
    inertia : mapping
        ``(axis, state) -> expression`` of the mass matrix; an axis without an
        entry has unit mass.
    actuators : mapping
        ``signal -> expression`` of inputs: what reaches the forces when
        actuators are ideal. Empty means the inputs themselves.
    signals : mapping
        Further names, in order of evaluation, such as relative velocities;
        environment effects act on them.
    effects : tuple of Effect
        What acts on the vehicle.
    parameters : tuple of Parameter
        Shared constants such as mass and length.
    step : float
        Largest integration step, s.
    integrator : str
        ``"explicit"``, the classical Runge-Kutta method of order four; or, for stiff
        models, ``"implicit"``: L-stable, of order three (:mod:`oed_sysid.compiled.graph`).
        A motion much faster than the step, such as that of a quick actuator, needs it.
    tables : mapping
        ``name -> (x, y)`` or ``(x, y, values)``, callable in every text.
    functions : tuple of Function
        Functions of CasADi symbols, callable in every text.

    Examples
    --------
    >>> from oed_sysid import Force, Input, Model, Output, Parameter, State
    >>> nomoto = Model(
    ...     name="first-order Nomoto",
    ...     states=(State("psi", "rad"), State("r", "rad/s")),
    ...     inputs=(Input("delta", "rad"),),
    ...     outputs=(Output("psi", "rad"),),
    ...     kinematics={"psi": "r", "r": "(K*delta - r)/T"},
    ...     parameters=(Parameter("K", 0.2, "1/s"), Parameter("T", 15.0, "s")),
    ... )
    >>> print(nomoto.equations())
    psi' = r
    r' = (K delta - r)/T
    measured psi = psi
    """

    def __post_init__(self) -> None:
        settle_parts(self)
        validate(self)
        effects = tuple(refined(effect, self.step) for effect in self.effects)
        object.__setattr__(self, "effects", effects)

    @classmethod
    def from_casadi(
        cls,
        f: ca.Function,
        h: ca.Function | None = None,
        *,
        states: Sequence[State],
        inputs: Sequence[Input] = (),
        parameters: Sequence[Parameter] = (),
        outputs: Sequence[Output] | None = None,
        name: str = "",
        step: float = 0.1,
        integrator: str = "explicit",
    ) -> Model:
        r"""Return the model that functions of CasADi describe.

        .. math:: \dot x = f(x, u, p, t), \qquad y = h(x, u, p, t)

        Parameters
        ----------
        f : casadi.Function
            Rates ``(n_states,)``. Arguments called ``x``, ``u``, ``p`` and ``t`` may stand in
            any order, others stand for x, u, p and t as they come; each is a column, and those
            that are not needed may be left out. Elementary operations become those of the model.
            Interpolants, rootfinders and external functions are called as they are: they cost
            their own time, exports need C that CasADi generates, and a saved fit is read where
            this model has been built before.
        h : casadi.Function, optional
            Outputs ``(n_outputs,)``; without it, each output is the state of its name.
        states, inputs, parameters : sequence of State, Input, Parameter
            The elements of x, u and p, in order.
        outputs : sequence of Output, optional
            Names, units and noise of the elements of y; by default every state is measured.
        name, step, integrator
            As of any model.

        Raises
        ------
        ModelError
            If sizes do not agree, or a function cannot be copied (a callback of Python).

        Examples
        --------
        >>> import casadi as ca
        >>> from oed_sysid import Input, Parameter, State
        >>> x, u, p = ca.MX.sym("x", 2), ca.MX.sym("u"), ca.MX.sym("p", 2)
        >>> f = ca.Function("f", [x, u, p], [ca.vertcat(x[1], (p[0] * u - x[1]) / p[1])])
        >>> nomoto = Model.from_casadi(
        ...     f,
        ...     states=(State("psi", "rad"), State("r", "rad/s")),
        ...     inputs=(Input("delta", "rad"),),
        ...     parameters=(Parameter("K", 0.2, "1/s"), Parameter("T", 15.0, "s")),
        ... )
        >>> print(nomoto.equations())
        psi' = r
        r' = f_r(r, delta, K, T)
        measured psi = psi
        measured r = r
        """
        columns: dict[str, Sequence[State | Input | Parameter]]
        columns = {"x": states, "u": inputs, "p": parameters}
        symbols = {key: [one.name for one in column] for key, column in columns.items()}
        symbols["t"] = ["t"]
        _check_derivatives(f)
        rates = callables.elements(f, symbols, symbols["x"])
        if outputs is None:
            outputs = [Output(one.name, one.unit) for one in states]
        seen = {}
        if h is not None:
            _check_derivatives(h)
            seen = callables.elements(h, symbols, [one.name for one in outputs])
            outputs = [replace(o, expression=callables.call_text(seen[o.name])) for o in outputs]
        return cls(
            name or f.name(),
            tuple(states),
            tuple(inputs),
            tuple(outputs),
            kinematics={key: callables.call_text(rate) for key, rate in rates.items()},
            parameters=tuple(parameters),
            step=step,
            integrator=integrator,
            functions=(*rates.values(), *seen.values()),
        )

    # -- new models from old -------------------------------------------------------

    def __add__(self, other: Effect | Iterable[Effect]) -> Model:
        """Return the model with one or several effects added."""
        added = (other,) if isinstance(other, Effect) else tuple(other)
        for effect in added:
            if effect.name in self.effect_names:
                raise ModelError(SAYS["effect_again"].format(self, effect=effect))
        return replace(self, effects=(*self.effects, *added))

    def without(self, *names: str) -> Model:
        """Return the model without the named effects."""
        for name in names:
            self.effect(name)
        return replace(self, effects=tuple(e for e in self.effects if e.name not in names))

    def with_values(self, values: Mapping[str, float]) -> Model:
        """Return the model with some parameter values replaced."""
        return self.changed(values, lambda p: p.with_value(values[p.name]))

    def within_bounds(self, values: Mapping[str, float]) -> Model:
        """Return the model at values moved inside their bounds; what is not finite stays."""
        finite = [name for name, value in values.items() if math.isfinite(value)]
        return self.changed(
            finite, lambda p: p.with_value(min(max(values[p.name], p.lower), p.upper))
        )

    def fix(self, *names: str) -> Model:
        """Return the model with the named parameters held at their values."""
        return self.changed(names, lambda p: replace(p, fixed=True))

    def free(self, *names: str) -> Model:
        """Return the model with the named parameters open to estimation."""
        return self.changed(names, lambda p: replace(p, fixed=False))

    def with_parameter(self, parameter: Parameter) -> Model:
        """Return the model with one parameter replaced by another of the same name."""
        return self.changed((parameter.name,), lambda p: parameter)

    def with_noise(self, levels: Iterable[float]) -> Model:
        """Return the model whose outputs declare these standard deviations of their noise."""
        pairs = zip(self.outputs, levels, strict=True)
        return replace(self, outputs=tuple(replace(o, noise_std=float(std)) for o, std in pairs))

    def changed(self, names: Collection[str], change: Callable[[Parameter], Parameter]) -> Model:
        """Return the model with some of its parameters changed, wherever they are declared."""
        for name in names:
            self.parameter(name)
        effects = tuple(changed(one, names, change) for one in self.effects)
        return changed(self, names, change, effects=effects)

    # -- words ---------------------------------------------------------------------

    def __repr__(self) -> str:
        names = ", ".join(self.effect_names[:6]) or "none"
        more = ", ..." if len(self.effects) > 6 else ""
        return (
            f"<Model {self.name!r}: {len(self.states)} states, {len(self.free_names)} free "
            f"parameters, effects {names}{more}>"
        )

    _repr_html_ = as_html

    @property
    def content(self) -> str:
        """Everything in the model as one text: equal models have equal texts."""
        listed = ", ".join(f"{one.name}={getattr(self, one.name)!r}" for one in fields(self))
        return f"Model({listed})"

    def equations(self) -> str:
        """Return the model as readable equations, one per line."""
        lines = []
        for kind, left, right, effect in self._rows():
            sign = "<-" if kind.endswith("change") else "="
            tag = f"   [{effect}]" if effect else ""
            left = _RATE.sub(r"\1'", expressions.to_text(left))
            measured = "measured " if kind.startswith("measured") else ""
            lines.append(f"{measured}{left} {sign} {expressions.to_text(right)}{tag}")
        return "\n".join(lines)

    def latex(self) -> str:
        r"""Return the equations as LaTeX, one per line, aligned at ``&``; without dollar signs.

        Examples
        --------
        >>> from oed_sysid import load_problem
        >>> print(load_problem("nomoto_sparse_heading").model.latex().splitlines()[0])
        T \, \dot{r} &= K \, \delta - r
        """
        return "\n".join(latex_lines(self))

    def _rows(self) -> list[tuple[str, str, str, str]]:
        """Every equation: its kind, left and right side, and the effect that it belongs to."""
        rows: list[tuple[str, str, str, str]] = []
        for signal, text in self.actuator_signals.items():
            changes = self._changes("change", "actuator", signal)
            if text != signal or changes:
                rows += [("", signal, text, ""), *changes]
        for signal, text in self.signals.items():
            rows += [("", signal, text, ""), *self._changes("change", "environment", signal)]
        rows += self._of_effects(lambda one: one.definitions.items())
        rows += [("", _inertia_text(self, axis), _force_text(self, axis), "") for axis in self.axes]
        for state, rate in self.kinematics.items():
            added = _force_text(self, state)
            rows.append(("", f"dot({state})", rate if added == "0" else f"{rate} + {added}", ""))
        rows += self._of_effects(lambda one: [(f"dot({s.name})", s.rate) for s in one.states])
        for output in self.outputs:
            rows.append(("measured", output.name, output.source, ""))
            rows += self._changes("measured change", "sensor", output.name)
        return rows

    def _of_effects(
        self, parts: Callable[[Effect], Iterable[tuple[str, str]]]
    ) -> Iterator[tuple[str, str, str, str]]:
        """Equations that effects bring."""
        for effect in self.effects:
            yield from (("", left, right, effect.name) for left, right in parts(effect))

    def _changes(self, kind: str, stage: str, signal: str) -> list[tuple[str, str, str, str]]:
        """What the effects of a stage turn a signal into."""
        return [
            (kind, signal, effect.terms[signal], effect.name)
            for effect in self.effects
            if effect.stage == stage and signal in effect.terms
        ]

    # -- identity ------------------------------------------------------------------

    def structure_key(self) -> str:
        """Digest of everything that shapes the compiled code; values excluded."""
        return self._structure

    @cached_property
    def _structure(self) -> str:
        parts = (
            tuple(s.name for s in self.states),
            tuple((i.name, i.interpolation) for i in self.inputs),
            tuple((o.name, o.source) for o in self.outputs),
            tuple(self.kinematics.items()),
            tuple(self.axes.items()),
            tuple((str(k), v) for k, v in self.inertia.items()),
            tuple(self.actuators.items()),
            tuple(self.signals.items()),
            tuple(effect.structure() for effect in self.effects),
            self.parameter_names,
            self.free_names,
            *(() if self.integrator == "explicit" else (self.integrator,)),
            tuple((name, *callables.digest(t)) for name, t in sorted(self.tables.items())),
            tuple((f.name, *callables.digest(f)) for f in self.functions),
        )
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]


def _check_derivatives(function: ca.Function) -> None:
    """Refuse what is no function of CasADi, or calls what cannot be differentiated."""
    if not isinstance(function, ca.Function):
        raise ModelError(SAYS["no_casadi"].format(function=function))
    try:
        function.jacobian()
    except RuntimeError as error:
        raise ModelError(
            f"CasADi has no derivatives of {function.name()!r} ({str(error).splitlines()[-1]}). "
            "Give an external function its forward and reverse derivatives, or make it with "
            "{'enable_fd': True}."
        ) from None


def latex_lines(model: Model, values: Mapping[str, float] = MappingProxyType({})) -> list[str]:
    """Equations as LaTeX, with numbers in the place of the names that ``values`` has."""

    def write(text: str) -> str:
        return expressions.to_latex(_NAME.sub(lambda m: _number(values, m[0]), text))

    lines = []
    for kind, left, right, effect in model._rows():
        measured = r"\text{measured }" if kind.startswith("measured") else ""
        sign = r"\leftarrow" if kind.endswith("change") else "="
        tag = f"\\quad\\text{{({effect.replace('_', ' ')})}}" if effect else ""
        lines.append(f"{measured}{write(left)} &{sign} {write(right)}{tag}")
    return lines


def _number(values: Mapping[str, float], name: str) -> str:
    return f"({values[name]:.4g})" if name in values else name


def _force_text(model: Model, key: str) -> str:
    """Sum of the forces on an axis or a state, as a text."""
    effects = (one for one in model.effects if one.stage == "force" and key in one.terms)
    return " + ".join(f"({effect.terms[key]})" for effect in effects) or "0"


def _inertia_text(model: Model, axis: str) -> str:
    """Left side of the equation of an axis: what multiplies the rates of velocities."""
    entries = list(model.inertia.items())
    for effect in model.effects:
        entries += effect.terms.items() if effect.stage == "inertia" else ()
    stated = any(row == axis for row, _ in model.inertia)
    parts = [] if stated else [f"dot({model.axes[axis]})"]
    for velocity in model.axes.values():
        texts = [text for key, text in entries if key == (axis, velocity)]
        parts += [f"({' + '.join(texts)})*dot({velocity})"] if texts else []
    return " + ".join(parts)
