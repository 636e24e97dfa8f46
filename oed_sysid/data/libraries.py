"""Libraries that read one format each, imported only when a log needs them."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from oed_sysid.errors import DataError


def library(name: str, what: str, *, extra: str = "logs") -> ModuleType:
    """Import a library, or say what to install.

    Parameters
    ----------
    name : str
        Module, for instance ``"pyulog"``.
    what : str
        What it reads, for the message.
    extra : str
        Extra of this package that brings it.

    Raises
    ------
    DataError
        If it is not installed.

    Examples
    --------
    >>> library("json", "JSON").__name__
    'json'
    >>> library("no_such_reader", "a log of Nobody's")
    Traceback (most recent call last):
    ...
    oed_sysid.errors.DataError: Reading a log of Nobody's needs no_such_reader, which is not
    installed. Run  pip install "oed_sysid[logs]"  and repeat.
    """
    try:
        return import_module(name)
    except ImportError:
        raise DataError(
            f"Reading {what} needs {name.partition('.')[0]}, which is not installed. Run  "
            f'pip install "oed_sysid[{extra}]"  and repeat.'
        ) from None
