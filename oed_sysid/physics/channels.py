"""Names, units and labels of the signals that cross a model's border.

States, inputs and outputs are declared once, in a model; everything else
(CSV headers, reports, plots) asks these declarations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from keyword import iskeyword
from typing import Any

import numpy as np

from oed_sysid.errors import DataError, ModelError, OedSysidError, located
from oed_sysid.runtime.tables import tables
from oed_sysid.text.units import dimension

# What models, effects and parameters are refused for.
SAYS: dict[str, Any] = tables(__file__, "sentences")
INTERPOLATIONS = ("hold", "linear")


def check_signal(kind: str, name: str, unit: str) -> None:
    """Raise :class:`ModelError` unless a name can stand in expressions and its unit is known."""
    if not isinstance(name, str) or not name.isidentifier() or iskeyword(name):
        raise ModelError(SAYS["no_identifier"].format(kind=kind, name=name))
    try:
        dimension(unit)
    except DataError as error:
        raise ModelError(f"{kind} {name!r}: {error}") from None


def settle(
    part: Any, owner: str, kinds: Mapping[str, Any], error: type[OedSysidError] = ModelError
) -> None:
    """Turn fields of something new into tuples and dictionaries, or refuse what they hold.

    Parameters
    ----------
    part : object
        Under construction.
    owner : str
        Its name, for messages.
    kinds : mapping
        Kind of every field: ``kind`` or ``(kind, words)``, ``[kind]`` for a tuple of it,
        ``{kind: kind}`` for a mapping.
    error : type
        What is raised for a field, or a member, of another kind.
    """

    def check(what: str, value: object, kind: Any, expected: str = "") -> None:
        if not isinstance(value, kind):
            words = expected or ("text" if kind is str else f"{kind.__name__}(...)")
            raise error(
                f"{owner}: {what} is a {type(value).__name__}, {value!r:.60}; expected {words}."
            )

    for what, shape in kinds.items():
        value = getattr(part, what)
        if isinstance(shape, list):
            listed = isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
            one = f"a tuple; one alone is ({what.removesuffix('s')},)"
            check(what, value, Iterable if listed else tuple, one)
            members = tuple(value)
            for member in members:
                check(f"one of its {what}", member, shape[0])
            object.__setattr__(part, what, members)
        elif isinstance(shape, dict):
            check(what, value, Mapping, "a mapping, such as {'psi': ...}")
            ((names, kind),) = shape.items()
            for key, member in value.items():
                check(f"a name in {what}", key, names)
                check(f"{what}[{key!r}]", member, kind)
            object.__setattr__(part, what, dict(value))
        else:
            check(what, value, *(shape if isinstance(shape, tuple) else (shape,)))


def check_positive(kind: str, name: str, what: str, value: float | None) -> None:
    """Raise :class:`ModelError` unless a number is positive and finite, or not stated."""
    if value is None:
        return
    is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not is_number or not 0.0 < value < math.inf:
        raise ModelError(f"{kind} {name!r} has {what} {value!r:.40}. Give a positive number.")


def _check_sign(kind: str, name: str, sign: float) -> None:
    if sign not in (1, -1):
        raise ModelError(SAYS["sign"].format(kind=kind, name=name, sign=sign))


@dataclass(frozen=True)
class State:
    """One state of a model.

    Parameters
    ----------
    name : str
        Symbol used in expressions, for instance ``"w"``.
    unit : str
        SI unit, for instance ``"m/s"``.
    label : str
        Words for reports and plots, for instance ``"heave velocity"``.
    scale : float
        Typical magnitude, in ``unit``; conditions the numerics only.

    Examples
    --------
    >>> State("w", "m/s", "heave velocity").label
    'heave velocity'
    """

    name: str
    unit: str
    label: str = ""
    scale: float = 1.0

    def __post_init__(self) -> None:
        check_signal("State", self.name, self.unit)
        check_positive("State", self.name, "scale", self.scale)


@dataclass(frozen=True)
class Input:
    """One commanded signal.

    ``interpolation`` says what happens between two samples: ``"hold"`` keeps
    the last value (a digital command), ``"linear"`` connects the samples (a
    measured angle). ``column`` and ``sign`` map a log that uses another name
    or the opposite sign convention.

    Examples
    --------
    >>> Input("rudder", "rad", "rudder angle", column="delta_deg", sign=-1).column
    'delta_deg'
    """

    name: str
    unit: str
    label: str = ""
    interpolation: str = "hold"
    column: str | None = None
    sign: float = 1.0

    def __post_init__(self) -> None:
        check_signal("Input", self.name, self.unit)
        _check_sign("Input", self.name, self.sign)
        what = f"Input {self.name!r} knows no interpolation"
        located(ModelError, what, [self.interpolation], INTERPOLATIONS)


@dataclass(frozen=True)
class Output:
    """One measured signal.

    Parameters
    ----------
    name : str
        Name of the measured channel.
    unit : str
        SI unit.
    label : str
        Words for reports and plots.
    expression : str or None
        What the sensor sees before sensor effects, as an expression of states
        and signals; ``None`` means the state of the same name.
    noise_std : float or None
        Standard deviation of the white measurement noise, in ``unit``;
        ``None`` means unknown, to be estimated.
    column, sign
        Column of the log and its sign, where they differ.
    wrap : bool
        Whether the log holds an angle within one turn, such as a compass that goes from 359 to
        0 degrees; it is made continuous when a record is made.

    Raises
    ------
    ModelError
        If something that is not an angle in rad is said to wrap.

    Examples
    --------
    >>> compass = Output("psi", "rad", "heading", noise_std=0.002, wrap=True)
    >>> compass.noise_std
    0.002
    """

    name: str
    unit: str
    label: str = ""
    expression: str | None = None
    noise_std: float | None = None
    column: str | None = None
    sign: float = 1.0
    wrap: bool = False

    def __post_init__(self) -> None:
        if self.wrap and self.unit != "rad":
            raise ModelError(SAYS["no_angle"].format(self))
        check_signal("Output", self.name, self.unit)
        if self.noise_std != 0.0:  # what zero means is said where residuals are divided by it
            check_positive("Output", self.name, "noise_std", self.noise_std)
        _check_sign("Output", self.name, self.sign)

    @property
    def source(self) -> str:
        """Expression that the sensor sees."""
        return self.name if self.expression is None else self.expression


@dataclass(frozen=True)
class Channels:
    """The signals that a record of a model must or may hold.

    Examples
    --------
    >>> Channels((Input("rudder", "rad"),), (Output("r", "rad/s"),)).output_names
    ('r',)
    """

    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]

    @property
    def all(self) -> tuple[Input | Output, ...]:
        """Commanded signals, then measured ones."""
        return (*self.inputs, *self.outputs)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the commanded signals."""
        return tuple(channel.name for channel in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the measured signals."""
        return tuple(channel.name for channel in self.outputs)
