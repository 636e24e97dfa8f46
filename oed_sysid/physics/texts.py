"""Sums and products of texts, without zeros and ones.

>>> plus(times("m", "u"), minus(times("m", "0", "r")), times("1", "q"))
'm*u + q'
"""

from __future__ import annotations

import re
from collections.abc import Sequence

Component = float | str
Place = Sequence[Component]

_SUM = re.compile(r"(?<![eE*(])[+-]")


def text_of(value: Component) -> str:
    """A number or a text as text; whole numbers without a point."""
    if isinstance(value, str):
        return value
    short = f"{value:.12g}"
    return short if float(short) == value else repr(float(value))


def minus(text: str) -> str:
    """The negative of a text."""
    if text == "0":
        return "0"
    return text[1:] if text.startswith("-") and not _is_sum(text[1:]) else f"-{_grouped(text)}"


def times(*factors: str) -> str:
    """Product of texts; sums among them are put in parentheses."""
    if "0" in factors:
        return "0"
    negative = False
    kept = []
    for factor in factors:
        while factor.startswith("-") and not _is_sum(factor[1:]):
            negative, factor = not negative, factor[1:]
        if factor != "1":
            kept.append(_grouped(factor))
    text = "*".join(kept) or "1"
    return f"-{text}" if negative else text


def plus(*terms: str) -> str:
    """Sum of texts."""
    text = ""
    for term in terms:
        if term == "0":
            continue
        if not text:
            text = term
        elif term.startswith("-"):
            text += f" - {term[1:]}"
        else:
            text += f" + {term}"
    return text or "0"


def cross(first: Sequence[str], second: Sequence[str]) -> tuple[str, str, str]:
    """Vector product of two vectors of texts.

    >>> cross(("0", "0", "T"), ("x", "0", "0"))
    ('0', 'T*x', '0')
    """
    (a, b, c), (x, y, z) = first, second
    return (
        plus(times(b, z), minus(times(c, y))),
        plus(times(c, x), minus(times(a, z))),
        plus(times(a, y), minus(times(b, x))),
    )


def _is_sum(text: str) -> bool:
    """Whether a sum stands outside of all parentheses."""
    depth, outside = 0, []
    for sign in text:
        depth += (sign == "(") - (sign == ")")
        outside.append(sign if depth == 0 else " ")
    return bool(_SUM.search("".join(outside)[1:]))


def _grouped(text: str) -> str:
    return f"({text})" if _is_sum(text) else text
