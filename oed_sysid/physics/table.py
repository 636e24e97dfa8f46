r"""Effects of the library as rows of one table, and the builder that makes effects of them.

A row of ``effects.toml`` says an effect's terms, the unit of its amplitude, where it comes from
and what a manoeuvre must contain for it to show. Braces hold the arguments of the constructor, so
that one row serves every axis, velocity or signal:

.. code-block:: toml

    [metacentric_moment]
    terms = { "{axis}" = "-{E}*sin({angle})" }
    unit = "N m"

``{E}`` is the amplitude. The constructor of the same name states the stage, the arguments and the
paragraph; where names have to be worked out it returns them: a
:class:`~oed_sysid.physics.parameters.Parameter` becomes one of the effect's, and anything else
stands for its name in the texts.

Hydrodynamic derivatives need less: axis, factors and unit follow from the name of the
coefficient, SNAME (1950).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import wraps
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import numpy as np

from oed_sysid.errors import DataError, ModelError
from oed_sysid.physics.base import Effect, ExtraState, Force, Memory, amplitude
from oed_sysid.physics.channels import SAYS
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.tables import tables
from oed_sysid.text import expressions, notation
from oed_sysid.text.callables import Table, check_table
from oed_sysid.text.csv_table import read_table
from oed_sysid.text.units import parse_header, to_si

_TABLE = tables(__file__, "effects")
#: Citations by the names that rows use.
SOURCES: Mapping[str, str] = _TABLE.pop("sources")
#: Cited by effects of rigid bodies.
FOSSEN = "Fossen (2011), Handbook of marine craft hydrodynamics and motion control, Wiley."
SNAME = "SNAME (1950), Technical and Research Bulletin 1-5."
ABKOWITZ = SOURCES["ABKOWITZ"]
#: Source of a term that fits and is no physics with a name.
POLYNOMIAL = "Taylor series: no physics of its own."

#: Velocities through the water; pass ``symbols={}`` where a model has none.
THROUGH_WATER: Mapping[str, str] = {"u": "u_r", "v": "v_r", "w": "w_r"}

Arguments = ParamSpec("Arguments")
Kind = TypeVar("Kind", bound=Effect)
Derived = Mapping[str, Any] | None


@dataclass(frozen=True)
class Row(Generic[Kind]):
    """One effect of the library.

    Parameters
    ----------
    kind : type of Effect
        Stage at which it acts.
    source, needs, description : str
        Citation, what shows it, and words.
    terms : mapping
        What it contributes, as of :class:`~oed_sysid.physics.Effect`.
    unit : str or None
        Of the amplitude, or after an equals sign the derivative that has it; None where the
        constructor gives the amplitudes itself.
    parts : sequence of str
        Of which there is an amplitude each, such as ``cos`` and ``sin``; an argument of that name
        is its value.
    size : mapping
        Further facts of the amplitude: ``positive``, ``bound``, ``description``.
    each : str
        Argument that is one signal or several; texts with ``{c}`` are repeated for each, and
        ``{_c}`` tells their names apart.
    definitions, memory : mapping
        As of an effect; of memory its update and where it begins.
    parameters : mapping
        Parameters beside the amplitude, called ``key_name``: the value that they are ``of``,
        ``unit``, bounds and words; numbers are formulas of the arguments. They are known, so
        fixed, but for a ``span`` above one: a positive value wrong by a factor of up to it.
    states : sequence of sequence of str
        Name, rate, start and unit of continuous states.
    derivative : str
        Name of a hydrodynamic derivative, with arguments in braces; signals as their letters.
        Everything else follows from it.
    symbols : mapping or None
        Signals for factors, as of :func:`derivative`; None for velocities through the water.
    example : str
        A call of the constructor.
    """

    kind: type[Kind]
    source: str
    needs: str
    description: str = ""
    terms: Mapping[str, str] = field(default_factory=dict)
    unit: str | None = None
    parts: Sequence[str] = ()
    size: Mapping[str, Any] = field(default_factory=dict)
    each: str = ""
    definitions: Mapping[str, str] = field(default_factory=dict)
    memory: Mapping[str, Sequence[str]] = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    states: Sequence[Sequence[str]] = ()
    derivative: str = ""
    symbols: Mapping[str, str] | None = None
    example: str = ""

    def documented(self, said: str) -> str:
        """What a constructor says of itself, with what it returns and an example."""
        terms = self.derivative or "; ".join(self.terms.values()) or "as given"
        stage, told = self.kind.stage, inspect.cleandoc(said)
        made = f"``{terms}``, absent at zero. Shows in: {self.needs}. {self.source}"
        wrong = "ModelError\n    If a name or a unit is none, or there is no such derivative."
        lines = [told, f"Returns\n-------\n{self.kind.__name__}\n    {made}"]
        lines.append(f"Raises\n------\n{wrong}")
        if ">>>" not in told:
            lines.append(f"Examples\n--------\n>>> {self.example}.stage\n{stage!r}")
        return "\n\n".join(lines)

    def effect(self, arguments: Mapping[str, Any], derived: Mapping[str, Any]) -> Effect:
        """The effect for the arguments of a constructor and what follows from them."""
        # What the constructor worked out goes before the argument of the same name.
        known = {**arguments, **derived}
        signals = channels(arguments[self.each]) if self.each else ()
        if signals:
            known[self.each] = " and ".join(signals)
        parameters = self._parameters(known)
        known |= {key: parameter.name for key, parameter in parameters.items()}
        # A letter beside the signal tells several alike apart; one alone needs none.
        each = [known | {"c": one, "_c": f"_{one}" * (len(signals) > 1)} for one in signals]
        scopes = each or [known]
        memory = [
            Memory(name.format(**scope), update.format(**scope), begin.format(**scope))
            for name, (update, begin) in self.memory.items()
            for scope in scopes
        ]
        return self.kind(
            arguments["name"],
            _filled(known.get("terms", self.terms), scopes),
            tuple(parameters.values()),
            definitions=known.get("definitions", _filled(self.definitions, scopes)),
            states=tuple(ExtraState(*_formatted(state, known)) for state in self.states),
            memory=known.get("memory", tuple(dict.fromkeys(memory))),
            tables=known.get("tables", {}),
            amplitudes=known.get("amplitudes", _amplitudes(parameters)),
            description=self.description.format(**known),
            source=self.source,
            needs=self.needs.format(**known),
        )

    def _parameters(self, known: Mapping[str, Any]) -> dict[str, Parameter]:
        """The amplitude or its parts, where the row has their unit, and further parameters."""
        others = {key: p for key, p in known.items() if isinstance(p, Parameter)}
        others |= {key: self._parameter(key, known) for key in self.parameters}
        if self.unit is None:
            return others
        own = ("scale", "value", "parameter", "per_record", "bound")
        given = {key: known[key] for key in own if key in known}
        unit = self.unit.format(**known)
        unit = notation.unit(unit[1:]) if unit.startswith("=") else unit
        facts = {"unit": unit, **given, **self.size}
        sizes = {} if self.parts else {"E": amplitude(known["name"], **facts)}
        for part in self.parts:
            value = known.get(part, facts.get("value", 0.0))
            sizes[f"E_{part}"] = amplitude(f"{known['name']}_{part}", **facts | {"value": value})
        return sizes | others

    def _parameter(self, key: str, known: Mapping[str, Any]) -> Parameter:
        """The parameter of this key, from formulas of the arguments."""
        facts = {"name": f"{key}_{{name}}", "fixed": True, **self.parameters[key]}
        facts |= {text: facts[text].format(**known) for text in ("name", "unit")}
        for number in facts.keys() & {"of", "span", "lower", "upper", "scale"}:
            facts[number] = float(expressions.to_numpy(str(facts[number]), known))
        value, span = facts.pop("of"), facts.pop("span", 1.0)
        if span > 1.0:
            facts |= {"lower": value / span, "upper": value * span, "log": True, "fixed": False}
        return Parameter(value=value, **facts)

    def force(self, arguments: Mapping[str, Any], derived: Mapping[str, Any]) -> Force:
        """The effect of one hydrodynamic derivative."""
        # The name of a derivative has the letter of the velocity, the term has the signal: w, w_r.
        letters = {k: factor_of(v) for k, v in arguments.items() if isinstance(v, str)}
        factors = (self.symbols or {}).items()
        symbols = {key.format(**letters): text.format(**arguments) for key, text in factors}
        return derivative(
            arguments["name"],
            self.derivative.format(**letters),
            symbols=THROUGH_WATER if self.symbols is None else symbols,
            scale=arguments["scale"],
            value=arguments["value"],
            parameter=arguments.get("parameter"),
            description=self.description,
            source=self.source,
            needs=self.needs.format(**arguments),
        )


@dataclass(frozen=True)
class Entry:
    """A row and its constructor."""

    row: Row[Any]
    constructor: Callable[..., Effect]


#: Every effect of the library by the name of its constructor.
LIBRARY: dict[str, Entry] = {}


def row(
    kind: type[Kind],
) -> Callable[[Callable[Arguments, Derived]], Callable[Arguments, Kind]]:
    """Make a constructor of the function that states the arguments of the row of its name."""

    def enter(function: Callable[Arguments, Derived]) -> Callable[Arguments, Kind]:
        facts = _TABLE[function.__name__]
        own = Row(kind, **{**facts, "source": SOURCES[facts["source"]]})
        stated = inspect.signature(function).replace(return_annotation=kind.__name__)
        make = own.force if own.derivative else own.effect

        @wraps(function)
        def construct(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Any:
            bound = stated.bind(*args, **kwargs)
            bound.apply_defaults()
            return make(bound.arguments, function(*args, **kwargs) or {})

        construct.__signature__ = stated  # type: ignore[attr-defined]
        construct.__doc__ = own.documented(function.__doc__ or "")
        LIBRARY[function.__name__] = Entry(own, construct)
        return construct

    return enter


def _amplitudes(parameters: Mapping[str, Parameter]) -> tuple[str, ...] | None:
    """Which parameters make an effect absent; None where all do, or nothing else says."""
    sizes = tuple(p.name for key, p in parameters.items() if key.startswith("E"))
    return sizes if 0 < len(sizes) < len(parameters) else None


def _formatted(texts: Sequence[str], known: Mapping[str, Any]) -> list[str]:
    return [text.format(**known) for text in texts]


def _filled(texts: Mapping[Any, str], scopes: Sequence[Mapping[str, Any]]) -> dict[Any, str]:
    """Texts with their arguments, for each channel; keys are places or pairs of them."""
    found: dict[Any, str] = {}
    for scope in scopes:
        for key, text in texts.items():
            place = tuple(_formatted(key, scope)) if isinstance(key, tuple) else key.format(**scope)
            found[place] = text.format(**scope)
    return found


def channels(signal: str | Sequence[str]) -> tuple[str, ...]:
    """One signal or several as a tuple."""
    return (signal,) if isinstance(signal, str) else tuple(signal)


# -- hydrodynamic derivatives: everything follows from the name -------------------------


def factor_of(signal: str) -> str:
    """Letter that a velocity signal has in the name of a derivative.

    >>> factor_of("w_r"), factor_of("q")
    ('w', 'q')
    """
    return signal.removesuffix("_r")


def derivative(
    name: str,
    coefficient: str,
    *,
    symbols: Mapping[str, str] = THROUGH_WATER,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
    description: str = "",
    source: str = SNAME,
    needs: str = "",
) -> Force:
    r"""One term of a force expansion, such as :math:`Z_{w|w|} w_r|w_r|`.

    Parameters
    ----------
    name : str
        Name of the effect.
    coefficient : str
        The derivative; axis, factors and unit follow from it.
    symbols : mapping
        Signals for factors; velocities through the water by default.
    scale, value, parameter
        See :func:`~oed_sysid.physics.amplitude`.
    description, source, needs : str
        Words; by default what the derivative's name says.

    Returns
    -------
    Force
        Stage, term and unit follow from the name.

    Examples
    --------
    >>> derivative("crossflow", "Z_absww", parameter="Z_absww", value=-100.0).terms
    {'Z': 'Z_absww*abs(w_r)*w_r'}
    """
    parsed = notation.parse(coefficient)
    size = amplitude(
        name,
        notation.unit(coefficient),
        scale=scale,
        value=value,
        parameter=parameter,
        description=parsed.description,
    )
    factors = notation.term(coefficient, symbols=symbols)[len(coefficient) :]
    shown = [symbols.get(factor.symbol, factor.symbol) for factor in parsed.factors]
    return Force(
        name,
        {parsed.axis: size.name + factors},
        (size,),
        description=description or parsed.description,
        source=source,
        needs=needs or f"{', '.join(dict.fromkeys(shown)) or 'nothing'} of varied size",
    )


def derivative_group(
    name: str,
    coefficients: Mapping[str, float],
    *,
    symbols: Mapping[str, str] = THROUGH_WATER,
    description: str,
    source: str = SNAME,
    needs: str,
) -> Force:
    """Several terms that come and go together, each with its own amplitude.

    Parameters
    ----------
    name : str
        Name of the effect; amplitudes are called ``E_name_coefficient``.
    coefficients : mapping
        Typical amplitude of each derivative.
    symbols, description, source, needs
        See :func:`derivative`.

    Returns
    -------
    Force
        One effect with an amplitude for each derivative.

    Examples
    --------
    >>> effect = derivative_group(
    ...     "turn", {"X_vr": 1e6, "X_vv": 1e4}, description="loss of speed", needs="turns"
    ... )
    >>> effect.terms
    {'X': 'E_turn_X_vr*v_r*r + E_turn_X_vv*v_r**2'}
    """
    parts = [
        derivative(f"{name}_{coefficient}", coefficient, symbols=symbols, scale=scale)
        for coefficient, scale in coefficients.items()
    ]
    return Force(
        name,
        _joined((axis, text) for part in parts for axis, text in part.terms.items()),
        tuple(parameter for part in parts for parameter in part.parameters),
        description=description,
        source=source,
        needs=needs,
    )


def hull_derivatives(
    name: str,
    parameters: Iterable[Parameter],
    *,
    symbols: Mapping[str, str] = THROUGH_WATER,
    extra: Mapping[str, str] | None = None,
    source: str = SNAME,
) -> Force:
    """Hull forces of a base model: one term per named derivative.

    Parameters
    ----------
    name : str
        Name of the effect.
    parameters : iterable of Parameter
        Derivatives such as ``Z_uw``; a missing unit is filled in.
    symbols, source
        See :func:`derivative`.
    extra : mapping
        ``axis -> expression`` of further terms, such as ``{"X": "T - m*q*w"}``.

    Returns
    -------
    Force
        One effect with all derivatives.

    Raises
    ------
    ModelError
        If a parameter is an acceleration derivative: these belong in the
        model's inertia.

    Examples
    --------
    >>> hull = hull_derivatives("hull", [Parameter("Z_uw", -40.0)], extra={"Z": "m*u*q"})
    >>> hull.terms, hull.parameters[0].unit
    ({'Z': 'm*u*q + Z_uw*u_r*w_r'}, 'kg/m')
    """
    terms = list((extra or {}).items())
    complete: list[Parameter] = []
    for parameter in parameters:
        parsed = notation.parse(parameter.name)
        if parsed.is_dot:
            raise ModelError(
                f"{parameter.name!r} multiplies an acceleration. Put it in the model's inertia."
            )
        complete.append(replace(parameter, unit=parameter.unit or notation.unit(parameter.name)))
        terms.append((parsed.axis, notation.term(parameter.name, symbols=symbols)))
    return Force(
        name,
        _joined(terms),
        tuple(complete),
        description="hull forces and moments",
        source=source,
        needs="motion in every direction",
    )


def _joined(terms: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Terms of the same axis as one sum."""
    found: dict[str, str] = {}
    for axis, text in terms:
        found[axis] = f"{found[axis]} + {text}" if axis in found else text
    return found


# -- tables of an effect, from CSV files with units in their headers ---------------------


def table_from_csv(path: str | Path) -> Table:
    r"""Read a table of one or two arguments; the last column holds its values.

    Two columns make a table of one argument, ``phi [deg],gz [m]``, in any order of
    rows. Three make one of two, ``beta [deg],V [m/s],K [N m]``: one row for each point of a
    full grid. Units are converted to SI.

    Returns
    -------
    tuple of ndarray
        ``(x (n,), y (n,))`` or ``(x (n,), y (m,), values (n, m))``, as the ``tables`` of
        an effect or a model take it.

    Raises
    ------
    DataError
        If a header has no unit, or a point of the grid is missing or given twice.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "arm.csv"
    ...     _ = file.write_text("phi [deg],gz [m]\n0,0\n30,0.4\n90,0.1\n")
    ...     x, y = table_from_csv(file)
    >>> print(np.round(x, 3), y)
    [0.    0.524 1.571] [0.  0.4 0.1]
    """
    path = Path(path)
    table = read_table(path)
    columns = []
    for header, column in zip(table.headers, table.values.T, strict=True):
        name, unit = parse_header(header)
        if unit is None:
            raise DataError(SAYS["column_without_unit"].format(path=path, header=header, name=name))
        if np.isnan(column).any():
            row = int(table.row_numbers[np.flatnonzero(np.isnan(column))[0]])
            raise DataError(f"{path.name}, row {row}: column {name!r} is empty. Fill the gap.")
        columns.append(to_si(column, unit)[0])
    if len(columns) == 2:
        order = np.argsort(columns[0], kind="stable")
        return check_table(path.name, (columns[0][order], columns[1][order]))
    if len(columns) != 3:
        raise DataError(SAYS["columns_of_table"].format(path=path, n=len(columns)))
    x, i = np.unique(columns[0], return_inverse=True)
    y, j = np.unique(columns[1], return_inverse=True)
    count = np.zeros((len(x), len(y)), dtype=int)
    np.add.at(count, (i, j), 1)
    if (count != 1).any():
        a, b = np.argwhere(count != 1)[0]
        raise DataError(SAYS["rows_of_a_point"].format(path=path, n=count[a, b], x=x[a], y=y[b]))
    values = np.empty((len(x), len(y)))
    values[i, j] = columns[2]
    return check_table(path.name, (x, y, values))
