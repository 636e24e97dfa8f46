"""Effects in people's words, with their formulas: what acts, and what it grows with.

The sentence is read off the formula: a force or moment that is one product, of its size and of
powers of signals, "grows with" these. Everything else is told by the words that it was declared
with, its signals by their labels.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator, Mapping

from oed_sysid.physics.base import Effect
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.physics.model import Model
from oed_sysid.text import expressions, notation
from oed_sysid.text.typeset import terms

_POWERS = {1: "", 2: "the square of ", 3: "the cube of "}


def in_words(effect: Effect, model: Model) -> str:
    """Say what an effect is, with its formula where that is short.

    Parameters
    ----------
    effect : Effect
        It need not be a part of the model.
    model : Model
        Whose signals have labels.

    Returns
    -------
    str
        Without a full stop.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> problem = load_problem("remus_diving_plane")
    >>> for name in ("pitch_quadratic_damping", "heave_crossflow_drag", "bias_q"):
    ...     print(in_words(problem.effect(name), problem.model))
    pitch moment that grows with the square of pitch rate, M = M_q|q| q|q|
    heave force that grows with the square of heave velocity through the water, Z = Z_w|w| w_r|w_r|
    constant error of pitch rate q, measured q → q + E_bias_q
    """
    labels = _labels(model)
    factors = _factors(effect, labels)
    said, product = effect.description, ""
    if factors is not None:
        key = str(next(iter(effect.terms)))
        product = _product(key, factors)
        # Of a size, and of a term that was proposed, the formula says more than the words.
        if not said or " equation" in said or said in {p.description for p in effect.parameters}:
            what = notation.AXES.get(key) or f"rate of {labels.get(key, key)}"
            said = _grows(what, factors, labels)
    if said == effect.description:
        said = _labelled(said, labels) or effect.name.replace("_", " ")
    formula = ", ".join(_formulas(effect, product))
    return f"{said}, {formula}" if formula else said


def _labels(model: Model) -> dict[str, str]:
    """What people call the signals of a model."""
    channels: tuple[Input | Output | State, ...] = (*model.outputs, *model.inputs, *model.states)
    found = {one.name: one.label or one.name for one in channels}
    for name, source in model.signals.items():
        found.setdefault(name, f"{found.get(source, source)} through the water")
    for name, source in model.actuator_signals.items():
        found.setdefault(name, found.get(source, name))
    return found


def _factors(effect: Effect, labels: Mapping[str, str]) -> Counter[str] | None:
    """Powers of the signals, ``|w|`` apart from ``w``, that a force is the product of."""
    if effect.stage != "force" or len(effect.terms) != 1 or effect.definitions or effect.states:
        return None
    products = terms(expressions.parse(*effect.terms.values()))
    if len(products) != 1 or products[0].below:
        return None
    found: Counter[str] = Counter()
    for name, power in map(_power, products[0].above):
        found[name] += power
    moving = Counter({name: n for name, n in found.items() if name.strip("|") in labels})
    return moving if found.keys() - moving.keys() <= {p.name for p in effect.parameters} else None


def _power(node: ast.expr) -> tuple[str, int]:
    """Name and power of a factor; no name of what is neither."""
    match node:
        case ast.Name(id=name):
            return name, 1
        case ast.Call(func=ast.Name(id="abs"), args=[ast.Name(id=name)]):
            return f"|{name}|", 1
        case ast.BinOp(op=ast.Pow(), left=ast.Name(id=name), right=ast.Constant(value=int(power))):
            return name, power
    return "", 0


def _grows(what: str, factors: Counter[str], labels: Mapping[str, str]) -> str:
    """The sentence on a product."""
    powers: Counter[str] = Counter()
    for name, power in factors.items():
        powers[name.strip("|")] += power
    if not powers:
        return f"constant {what}"
    # Of |p| alone; p|p| is said to grow with the square, as the field does.
    sized = {one: "the size of " * (one not in factors) for one in powers}
    named = [
        f"{_POWERS.get(n, f'power {n} of ')}{sized[one]}{labels[one]}" for one, n in powers.items()
    ]
    return f"{what} that grows with {' times '.join(named)}"


def _product(axis: str, factors: Counter[str]) -> str:
    """SNAME's symbol of the size of a product and the product; empty where it has none."""
    names = list(dict.fromkeys(name.strip("|") for name in factors))
    pieces = sorted(factors, key=lambda one: (names.index(one.strip("|")), "|" in one))
    short = [one.replace("_r", "") for one in pieces for _ in range(factors[one])]
    coded = "".join(f"abs{one.strip('|')}" if "|" in one else one for one in short)
    if not notation.is_derivative(f"{axis}_{coded or 0}"):
        return ""
    written = " ".join(
        expressions.to_text(f"x**{n}")[1:].join((one, "")) if (n := factors[one]) > 1 else one
        for one in pieces
    )
    return f"{axis}_{''.join(short) or 0} {written.replace(' |', '|')}".rstrip()


def _labelled(said: str, labels: Mapping[str, str]) -> str:
    """Words of the library, with labels before the symbols of signals."""

    def named(found: re.Match[str]) -> str:
        name = found[0]
        label = labels.get(name, name)
        return name if name == "a" or name in label.split() else f"{label} {name}"

    return said if "=" in said else re.sub(r"(?<![\w/])[A-Za-z]\w*", named, said)


def _formulas(effect: Effect, product: str) -> Iterator[str]:
    """What an effect adds to or makes of each signal; nothing of what keeps a memory."""
    if effect.definitions or effect.memory or effect.states or effect.stage == "inertia":
        return
    written = []
    for key, text in effect.terms.items():
        shown = expressions.to_text(text).replace("-", "−")
        if product:
            shown = "−" * shown.startswith("−") + product
        if effect.stage == "force":
            written.append(f"{key} = {shown}" if key in notation.AXES else f"{key}' = … + {shown}")
        else:
            measured = "measured " if effect.stage == "sensor" else ""
            written.append(f"{measured}{key} → {shown}")
    # A longer formula no longer helps a sentence.
    if sum(map(len, written)) <= 70 and "where(" not in "".join(written):
        yield from (one.replace("+ −", "− ") for one in written)
