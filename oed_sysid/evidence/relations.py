r"""Equations between measured signals that hold whatever the forces are.

.. math:: \dot y = f(s_1, s_2, \dots) \quad\text{or}\quad y = f(s_1, s_2, \dots)

Two sources: the equations that a model declares (kinematics and outputs in which no unknown
parameter occurs), and the kinematics of a rigid body where measured signals carry the standard
names (SNAME 1950; Fossen 2021, Handbook of Marine Craft, eqs. 2.26 and 2.38),

.. math::

    \dot\phi &= p + (q \sin\phi + r \cos\phi) \tan\theta, \quad
    \dot\theta = q \cos\phi - r \sin\phi, \quad
    \dot\psi = (q \sin\phi + r \cos\phi) / \cos\theta, \\
    (\dot x, \dot y, \dot z)^T &= R_z(\psi) R_y(\theta) R_x(\phi)\, (u, v, w)^T,

with the angles and rates that are not measured taken as zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from oed_sysid.physics.model import Model
from oed_sysid.text import expressions

STANDARD_UNITS = {
    "x": "m", "y": "m", "z": "m", "u": "m/s", "v": "m/s", "w": "m/s",
    "phi": "rad", "theta": "rad", "psi": "rad", "p": "rad/s", "q": "rad/s", "r": "rad/s",
}  # fmt: skip
# Forms of each equation, the fullest first: names needed beside the left side, and the text.
STANDARD: dict[str, tuple[tuple[str, str], ...]] = {
    "phi": (("p q r theta", "p + (q*sin(phi) + r*cos(phi))*tan(theta)"), ("p", "p")),
    "theta": (("q r phi", "q*cos(phi) - r*sin(phi)"), ("q", "q")),
    "psi": (
        ("q r phi theta", "(q*sin(phi) + r*cos(phi))/cos(theta)"),
        ("r phi theta", "r*cos(phi)/cos(theta)"),
        ("r phi", "r*cos(phi)"),
        ("r theta", "r/cos(theta)"),
        ("r", "r"),
    ),
    "x": (
        (
            "u v w phi theta psi",
            "u*cos(psi)*cos(theta) + v*(cos(psi)*sin(theta)*sin(phi) - sin(psi)*cos(phi))"
            " + w*(cos(psi)*sin(theta)*cos(phi) + sin(psi)*sin(phi))",
        ),
        ("u v psi", "u*cos(psi) - v*sin(psi)"),
        ("u w theta", "u*cos(theta) + w*sin(theta)"),
    ),
    "y": (
        (
            "u v w phi theta psi",
            "u*sin(psi)*cos(theta) + v*(sin(psi)*sin(theta)*sin(phi) + cos(psi)*cos(phi))"
            " + w*(sin(psi)*sin(theta)*cos(phi) - cos(psi)*sin(phi))",
        ),
        ("u v psi", "u*sin(psi) + v*cos(psi)"),
    ),
    "z": (
        ("u v w phi theta", "-u*sin(theta) + v*cos(theta)*sin(phi) + w*cos(theta)*cos(phi)"),
        ("u w theta", "-u*sin(theta) + w*cos(theta)"),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Relation:
    """One equation between measured signals.

    Parameters
    ----------
    target : str
        Signal on the left side.
    signals : tuple of str
        Signals on the right side.
    text : str
        The right side, for people.
    is_rate : bool
        Whether the left side is the rate of the target, rather than the target itself.
    declared : bool
        Whether the model says so; otherwise it follows from standard names.
    steps : tuple of (str, str)
        Definitions to evaluate in order; the last one is the right side.
    constants : mapping
        Known constants in them.
    """

    target: str
    signals: tuple[str, ...]
    text: str
    is_rate: bool
    declared: bool
    steps: tuple[tuple[str, str], ...] = field(repr=False)
    constants: Mapping[str, float] = field(repr=False)

    def __str__(self) -> str:
        return f"{self.target}{chr(39) if self.is_rate else ''} = {expressions.to_text(self.text)}"

    def __call__(self, values: Mapping[str, np.ndarray], times: np.ndarray) -> np.ndarray:
        """Right side at every time, shape ``(n_times,)``; ``values`` by name of signal."""
        scope: dict[str, object] = {**self.constants, **values, "t": times}
        for name, text in self.steps:
            scope[name] = expressions.to_numpy(text, scope)
        return np.broadcast_to(np.asarray(scope[self.steps[-1][0]], dtype=float), times.shape)


def relations(
    model: Model, spare: Iterable[str] = (), missing: Iterable[str] = ()
) -> tuple[Relation, ...]:
    """All equations between measured signals.

    Parameters
    ----------
    model : Model
        The model; only kinematics, signals, outputs and inputs are used.
    spare : iterable of str
        Measured signals with standard names that the model does not ask for.
    missing : iterable of str
        Outputs that were not measured.
    """
    absent = set(missing)
    # A state is measured where an output shows it and nothing else.
    shown = {o.source: o.name for o in model.outputs if o.name not in absent}
    measured = {state: shown[state] for state in model.state_names if state in shown}
    found: list[Relation] = []
    for state, text in model.kinematics.items():
        if state in measured:
            one = _declared(model, measured[state], text, measured, is_rate=True)
            if one is not None and one.signals:
                found.append(one)
    for output in model.outputs:
        if output.source not in model.state_names and output.name not in absent:
            one = _declared(model, output.name, output.source, measured, is_rate=False)
            if one is not None and one.signals:
                found.append(one)
    return (*found, *_standard(model, set(spare), absent, {r.target for r in found}))


def _declared(
    model: Model, target: str, text: str, measured: Mapping[str, str], *, is_rate: bool
) -> Relation | None:
    """Equation of the model over measured signals; None if anything unknown enters it."""
    touched = {key for e in model.effects for key in e.terms if isinstance(key, str)}
    state = next((s for s, name in measured.items() if name == target), None)
    if is_rate and state in touched:
        return None
    constants = {p.name: p.value for p in model.all_parameters if p.fixed}
    used: list[str] = []
    inner: dict[str, str] = {}
    called = set(expressions.functions(text))
    pending = sorted(expressions.names(text))
    while pending:
        name = pending.pop(0)
        if name in measured:
            used.append(name)
        elif name in model.signals and name not in touched:
            if name not in inner:
                inner[name] = model.signals[name]
                called |= expressions.functions(model.signals[name])
                pending += sorted(expressions.names(model.signals[name]))
        elif name not in constants and name != "t":
            return None
    if called - set(expressions.FUNCTIONS):
        return None
    if is_rate and not _is_kinematic(model, target, {measured[s] for s in used}):
        return None
    aliases = [(s, measured[s]) for s in dict.fromkeys(used) if measured[s] != s]
    ordered = [(name, inner[name]) for name in model.signals if name in inner]
    signals = tuple(dict.fromkeys(measured[s] for s in used))
    steps = (*aliases, *ordered, (f"{target}_prime_", text))
    return Relation(target, signals, text, is_rate, True, steps, constants)


def _is_kinematic(model: Model, target: str, signals: set[str]) -> bool:
    """Whether a rate follows from motion alone, not from forces whose constants are known."""
    units = {o.name: o.unit for o in model.outputs}
    if units[target] in ("m/s", "rad/s"):
        accelerations = {name for name in signals if units[name] in ("m/s^2", "rad/s^2")}
        return bool(accelerations)
    return target not in signals or units[target] == "rad"


def _standard(
    model: Model, spare: set[str], absent: set[str], related: set[str]
) -> tuple[Relation, ...]:
    """Equations of a rigid body for signals with standard names and units."""
    units = {o.name: o.unit for o in model.outputs if o.name not in absent}
    odd = {o.name for o in model.outputs if o.expression not in (None, o.name)}
    own = {n for n, unit in units.items() if STANDARD_UNITS.get(n) == unit and n not in odd}
    known = own | {name for name in spare if name in STANDARD_UNITS and name not in units}
    # Where the model has an equation for one of these states, it knows better.
    mine = {s for s in model.kinematics if s in STANDARD} | related
    result = []
    for target, forms in STANDARD.items():
        if target not in known or target in mine:
            continue
        for needed, text in forms:
            names = tuple(needed.split())
            if known.issuperset(names):
                step = (f"{target}_prime_", text)
                signals = tuple(n for n in (*names, target) if n in expressions.names(text))
                result.append(Relation(target, signals, text, True, False, (step,), {}))
                break
    return tuple(result)
