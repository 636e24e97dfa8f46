"""How objects show themselves in a notebook, numbers in a sentence, and packages to others.

HTML is written by :mod:`oed_sysid.report`, above everything that it shows. An object below
offers ``_repr_html_ = as_html``; the writer is looked up by name when a notebook asks, so
that nothing imports upwards and nothing is imported before it is needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import ModuleType

# Sizes that are written without an exponent.
ORDINARY = (1e-4, 1e6)

# The module whose function ``html`` writes any object that has this method.
WRITER = "oed_sysid.report.notebook"


def as_html(self: object) -> str:
    """Return HTML for a notebook; the method ``_repr_html_`` of what a notebook shows."""
    text: str = import_module(WRITER).html(self)
    return text


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
    if "e" not in text or not ORDINARY[0] <= abs(float(text)) < ORDINARY[1]:
        return text
    return f"{float(text):.0f}"


def exported(names: Mapping[str, object]) -> list[str]:
    """Return the public names of a package's ``__init__``, for its ``__all__``: what it hands on.

    Parameters
    ----------
    names : mapping of str to object
        Its ``globals()``; modules and private names are left out.
    """
    return sorted(
        name
        for name, thing in names.items()
        if not (name.startswith("_") or isinstance(thing, ModuleType) or thing is exported)
    )
