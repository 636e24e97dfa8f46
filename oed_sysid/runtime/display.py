"""How results are told: plain data, numbers in a sentence, and documents with their renderings.

A result is facts: a frozen dataclass. Its dictionary follows from the facts
(:func:`as_dict`), and its sentences are made of them once, in its ``document()``: a
:class:`Report` of sentences, tables and figures by name. Everything else is a rendering of
that document: ``report()`` is its text, a page its HTML with the figures drawn, a notebook
its HTML without them.

HTML is written by :mod:`oed_sysid.results`, above everything that it shows, and looked up by
name when it is asked for, so that nothing imports upwards and nothing is imported before it
is needed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from types import NoneType
from typing import Any

from oed_sysid.runtime.files import write_text

# Half of a 95 % interval of a normal variable, in standard deviations.
TWO_SIDED_95 = 1.96

# The module that renders documents as HTML: functions ``html``, ``notebook`` and ``drawn``.
WRITER = "oed_sysid.results.page"


# -- plain data ------------------------------------------------------------------------


def plain(value: Any) -> Any:
    """Return a value as what JSON has: numbers, text, lists, dictionaries and None.

    Arrays and tuples become lists, NaN and infinity None, and dataclasses what their
    ``to_dict`` says, or their fields where they have none.

    Examples
    --------
    >>> import numpy as np
    >>> plain({"a": np.array([1.0, np.nan]), "b": (2, "three")})
    {'a': [1.0, None], 'b': [2, 'three']}
    """
    for kind, way in _PLAIN:
        if isinstance(value, kind):
            return way(value)
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if hasattr(value, "to_dict"):
        return plain(value.to_dict())
    if is_dataclass(value):
        return {one.name: plain(getattr(value, one.name)) for one in fields(value)}
    return str(value)


# In this order: an enumeration of words is a word.
_PLAIN: tuple[tuple[Any, Callable[[Any], Any]], ...] = (
    (NoneType | str | bool | int, lambda value: value),
    (float, lambda value: float(value) if math.isfinite(value) else None),
    (complex, lambda value: [value.real, value.imag]),
    (Enum, lambda value: plain(value.value)),
    (Mapping, lambda value: {str(key): plain(item) for key, item in value.items()}),
    (list | tuple | set | frozenset, lambda value: [plain(item) for item in value]),
)


def as_dict(*names: str, **others: str | Callable[[Any], Any]) -> Callable[[Any], dict[str, Any]]:
    """Return a method ``to_dict`` that is derived from the facts of a class.

    Parameters
    ----------
    *names : str
        Attributes under their own names; without any, and without others, all fields.
    **others : str or callable
        Attributes under other names: a path such as ``model.name``, or a function of the object.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Run:
    ...     name: str
    ...     cost: float
    ...     to_dict = as_dict("name", cost_s="cost", letters=lambda run: len(run.name))
    >>> Run("zigzag", 60.0).to_dict()
    {'name': 'zigzag', 'cost_s': 60.0, 'letters': 6}
    """
    table = {name: attrgetter(name) for name in names} | {
        name: attrgetter(way) if isinstance(way, str) else way for name, way in others.items()
    }

    def to_dict(self: Any) -> dict[str, Any]:
        """Return plain data for JSON."""
        ways = table or {one.name: attrgetter(one.name) for one in fields(self)}
        return {name: plain(way(self)) for name, way in ways.items()}

    return to_dict


# -- words -----------------------------------------------------------------------------


def digits(value: float, count: int = 2) -> str:
    """Return a number with so many significant digits, without an exponent where it is ordinary.

    Parameters
    ----------
    value : float
    count : int
        Significant digits.

    Examples
    --------
    >>> digits(147.2), digits(0.0123), digits(98765.0, 3), digits(3.2e-7), digits(2.0)
    ('150', '0.012', '98800', '3.2e-07', '2')
    """
    text = f"{value:.{count}g}"
    if "e" not in text or not 1e-4 <= abs(float(text)) < 1e6:
        return text
    return f"{float(text):.0f}"


def share(value: float, count: int = 2) -> str:
    """Return a share in per cent; small ones are said to be small, none is 0.00 %.

    >>> share(0.0312), share(25.0), share(2e-6), share(0.0), share(float("nan"))
    ('3.1 %', 'more than 1000 %', 'below 0.01 %', '0 %', 'not known')
    """
    if math.isnan(value):
        return "not known"
    if 0.0 < abs(value) < 1e-4:
        return "below 0.01 %"
    return f"{digits(100 * value, count)} %" if value < 10 else "more than 1000 %"


def rounded(value: float, half: float = math.nan) -> str:
    """Return a value with the digits that its uncertainty leaves; four without one.

    Parameters
    ----------
    value : float
        Not finite is said in words.
    half : float
        Half of its 95 % interval; two of its digits are shown.

    Examples
    --------
    >>> rounded(12.3456, 0.0321), rounded(12345.6, 321.0), rounded(1.23456), rounded(math.nan)
    ('12.346', '12350', '1.235', 'not known')
    """
    if not math.isfinite(value):
        return "not known" if math.isnan(value) else "unbounded"
    if not (math.isfinite(half) and half > 0.0):
        return digits(value, 4)
    places = 1 - math.floor(math.log10(half))
    shown = round(value, places)
    return f"{shown:.{max(places, 0)}f}" if places < 7 and abs(shown) < 1e6 else digits(value, 4)


def interval(value: float, half: float) -> str:
    """Return a value with half of its 95 % interval, which says how many digits are shown.

    >>> interval(12.3456, 0.0321), interval(1.5, math.nan), interval(0.5, 0.0)
    ('12.346 ± 0.032', '1.5', '0.5')
    """
    if not (math.isfinite(half) and half > 0.0):
        return rounded(value)
    return f"{rounded(value, half)} ± {rounded(half, half)}"


# Numbers as Python writes them and people do not: none at all, and ordinary ones with an exponent.
_NO_NUMBER = re.compile(r"(?<![\w.])nan(?![\w.])(?: ?%)?")
_EXPONENT = re.compile(r"(?<![\w.])-?\d(?:\.\d+)?e\+0[0-5](?!\d)")
# Shares: a space before the sign, as SI has it; one that rounds to nothing is below its last digit.
_SHARE, _NOTHING = re.compile(r"(?<=\d)%"), re.compile(r"(?<![\d.,])0\.(0+) %")
_TIMES = re.compile(r"(?<=\d) x (?=noise|the |what|its )")


def told(text: str) -> str:
    """Return a sentence or a cell with its numbers as people write them.

    Documents apply it to all that they say, so that no row of a table reads ``nan m/s``.

    Examples
    --------
    >>> told("1.5e+02 x noise"), told("nan %"), told("2e-07 N"), told("Z_nan = 1e+09")
    ('150 × noise', '–', '2e-07 N', 'Z_nan = 1e+09')
    >>> told("5% of 0.00%"), told("kept on 100.0%")
    ('5 % of below 0.01 %', 'kept on 100.0 %')
    """
    text = _EXPONENT.sub(lambda found: f"{float(found[0]):.0f}", _NO_NUMBER.sub("–", text))
    text = _TIMES.sub(" × ", _SHARE.sub(" %", text))
    return _NOTHING.sub(lambda found: f"below 0.{found[1][:-1]}1 %", text)


def _tell(part: Any, *names: str) -> None:
    """Write the numbers in texts, and in sequences of texts, of something new as people do."""

    def in_words(value: Any) -> Any:
        return told(value) if isinstance(value, str) else tuple(map(in_words, value))

    for name in names:
        object.__setattr__(part, name, in_words(getattr(part, name)))


def counted(count: int, noun: str) -> str:
    """Return a number with its noun.

    >>> counted(1, "run"), counted(3, "run")
    ('1 run', '3 runs')
    """
    return f"{count} {noun}{'' if count == 1 else 's'}"


def align(rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> list[str]:
    """Lay rows of text out in columns; those of ``left`` flush left, the others right.

    >>> align([("name", "value"), ("Z_w", "-65.5")])
    ['name  value', 'Z_w   -65.5']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if i in left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


# Characters that LaTeX reads as commands, and what writes them.
_TEX = str.maketrans({one: f"\\{one}" for one in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "±": r"$\pm$", "×": r"$\times$", "−": "$-$", "≤": r"$\le$", "≥": r"$\ge$", "°": r"$^\circ$",
    "<": "$<$", ">": "$>$",
})  # fmt: skip


# -- documents -------------------------------------------------------------------------


@dataclass(frozen=True)
class Table:
    """Rows of text.

    Parameters
    ----------
    headers : tuple of str
    rows : tuple of tuple of str
    caption : str
    words : tuple of int
        Columns to set flush left.
    marked : tuple of int
        Rows to stress.

    Examples
    --------
    >>> for line in Table(("name", "share"), [("Z_w", "3 %")]).lines():
    ...     print(line)
    name  share
    Z_w     3 %
    """

    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    words: tuple[int, ...] = ()
    marked: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        _tell(self, "headers", "rows")

    def lines(self) -> list[str]:
        """Return the table as aligned lines of text."""
        return align([self.headers, *self.rows], left=(0, *self.words))

    def latex(self) -> str:
        r"""Return the table as LaTeX, with the rules of the package booktabs.

        Examples
        --------
        >>> print(Table(("name", "share"), [("Z_w", "3 %")]).latex())
        \begin{tabular}{lr}
        \toprule
        name & share \\
        \midrule
        Z\_w & 3 \% \\
        \bottomrule
        \end{tabular}
        """
        flush = "".join("l" if i in (0, *self.words) else "r" for i in range(len(self.headers)))
        cells = ([cell.translate(_TEX) for cell in row] for row in (self.headers, *self.rows))
        head, *rows = (" & ".join(row) + r" \\" for row in cells)
        inner = [r"\toprule", head, r"\midrule", *rows, r"\bottomrule"]
        return "\n".join([rf"\begin{{tabular}}{{{flush}}}", *inner, r"\end{tabular}"])


@dataclass(frozen=True, eq=False)
class Figure:
    """A figure by name, drawn when a page is made.

    Parameters
    ----------
    name : str
        Function of :mod:`oed_sysid.results`: ``figure_x(subject, *arguments)``, or
        ``plot_x(subject, *arguments, ax=...)``.
    subject : object
        What it shows.
    caption : str
        What is to be seen and how to read it.
    arguments : tuple
    options : mapping
    size : (float, float), optional
        Of a ``plot_x``, inches; None leaves it to the plot.

    Examples
    --------
    >>> Figure("figure_record", subject=None, caption="What was measured.").name
    'figure_record'
    """

    name: str
    subject: Any
    caption: str
    arguments: tuple[Any, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    size: tuple[float, float] | None = (7.6, 3.8)


@dataclass(frozen=True)
class Section:
    """One part of a document.

    Parameters
    ----------
    title : str
        Heading of a page; text has it where ``heading`` says so.
    paragraphs : tuple of str
    tables : tuple of Table
    figures : tuple
        :class:`Figure`, or as a page has drawn it.
    listing : str
        Lines to be set as they are.
    heading : bool
    indent : int
        Of lines in text.
    only : str
        ``"text"`` or ``"page"`` where only one of them has it.
    beside : bool
        Whether figures stand beside each other where the page is wide enough.

    Examples
    --------
    >>> for line in Section("Errors", ("Over whole runs.",), heading=True).lines():
    ...     print(line)
    Errors
    Over whole runs.
    """

    title: str = ""
    paragraphs: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Any] = ()
    listing: str = ""
    heading: bool = False
    indent: int = 0
    only: str = ""
    beside: bool = False

    def __post_init__(self) -> None:
        _tell(self, "title", "paragraphs")

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing below the heading."""
        return not (self.paragraphs or self.tables or self.figures or self.listing)

    def lines(self) -> list[str]:
        """Return the section as lines of text."""
        parts = [one.lines() for one in self.tables]
        lines = [line for part in parts for line in ["", *part]][1:]
        lines += [*self.paragraphs, *self.listing.splitlines()]
        if not lines:
            return []
        margin = " " * self.indent
        return [*([self.title] * self.heading), *(f"{margin}{line}".rstrip() for line in lines)]

    def html(self) -> str:
        """Return the part below the heading as HTML, to be put inside another page."""
        return str(import_module(WRITER).html(self, "section"))


@dataclass(frozen=True)
class Report:
    """What a result says: one document, whose renderings are text, page and notebook.

    Parameters
    ----------
    title, subtitle : str
        What this is about; the subtitle stands on pages only.
    answer : str
        The outcome in one line.
    warnings : tuple of str
        What must be read before everything else: danger, a suspect log, values not to be used.
    verdict : tuple of str
        The outcome in sentences: last in text, first on a page.
    numbers : tuple of (str, str)
        The few numbers that matter most, by name; on a page.
    headline : str
        First line of a text; the title by default.
    head : tuple of (str, str)
        What was done to what, below the first line of a text.
    sections : tuple of Section

    Examples
    --------
    >>> page = Report("Trial", verdict=("It fits.",), head=(("misfit", "1.01 × noise"),))
    >>> print(page.text())
    Trial
      misfit  1.01 × noise
    <BLANKLINE>
    It fits.
    """

    title: str
    subtitle: str = ""
    verdict: Sequence[str] = ()
    numbers: Sequence[tuple[str, str]] = ()
    sections: Sequence[Section] = ()
    answer: str = ""
    warnings: Sequence[str] = ()
    headline: str = ""
    head: Sequence[tuple[str, str]] = ()

    def __post_init__(self) -> None:
        _tell(self, "answer", "headline", "verdict", "warnings", "numbers", "head")

    @property
    def first(self) -> tuple[str, ...]:
        """What a page says before everything else."""
        said = (*self.warnings, self.answer, *self.verdict)
        return tuple(dict.fromkeys(line for text in said for line in text.splitlines() if line))

    def text(self) -> str:
        """Return the document as text, tables aligned."""
        width = max((len(name) for name, _ in self.head), default=0)
        parts = [[*self.warnings, self.headline or self.title]]
        parts[0] += [f"  {name:<{width}}  {value}" for name, value in self.head]
        parts += [one.lines() for one in self.sections if one.only != "page"]
        parts.append(list(self.verdict))
        return "\n".join(line for part in filter(None, parts) for line in ["", *part]).lstrip("\n")

    def latex(self) -> str:
        """Return the tables of the document as LaTeX, each below a comment with its heading."""
        return "\n\n".join(
            f"% {part.caption or one.title or self.title}\n{part.latex()}"
            for one in self.sections
            for part in one.tables
        )

    def html(self) -> str:
        """Return the document as a page of HTML that refers to nothing outside itself."""
        return str(import_module(WRITER).html(self, "page"))

    def summary_html(self) -> str:
        """Return verdict and numbers as HTML, to be put inside another page."""
        return str(import_module(WRITER).html(self, "summary"))

    def drawn(self) -> Report:
        """Return the document with its figures drawn, so that it depends on no result."""
        return import_module(WRITER).drawn(self)

    def write(self, path: str | Path) -> Path:
        """Write the page and return its path.

        Raises
        ------
        FileError
            If the file cannot be written; an older one is untouched.
        """
        write_text(path, self.html())
        return Path(path)


def as_text(self: Any) -> str:
    """Return the result as text; the method ``report`` of what has a ``document``."""
    return str(self.document().text())


def as_html(self: object) -> str:
    """Return HTML for a notebook; the method ``_repr_html_`` of what a notebook shows."""
    return import_module(WRITER).notebook(self)
