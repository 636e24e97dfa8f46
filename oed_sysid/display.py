"""How objects show themselves in a notebook.

HTML is written by :mod:`oed_sysid.report`, above everything that it shows. An object below
offers ``_repr_html_ = as_html``; the writer is looked up by name when a notebook asks, so
that nothing imports upwards and nothing is imported before it is needed.
"""

from __future__ import annotations

from importlib import import_module

# The module whose function ``html`` writes any object that has this method.
WRITER = "oed_sysid.report.notebook"


def as_html(self: object) -> str:
    """Return HTML for a notebook; the method ``_repr_html_`` of what a notebook shows."""
    text: str = import_module(WRITER).html(self)
    return text
