"""Libraries that only some baselines need: imported late, missed with advice."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from oed_sysid.errors import ModelError


def optional(module: str, package: str, *, wanted_by: str) -> ModuleType:
    """Import a module of an optional library, or say which extra installs it.

    Parameters
    ----------
    module : str
        Module to import, for instance ``"sklearn.svm"``.
    package : str
        Name under which it is installed.
    wanted_by : str
        What needs it, for the message.

    Raises
    ------
    ModelError
        If it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ModelError(
            f"{wanted_by} needs the optional library {package}, which is not installed ({error}). "
            "Install it with: pip install 'oed-sysid[baselines]'."
        ) from error
