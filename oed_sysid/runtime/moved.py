"""Import paths of version 0.1: still understood, with a warning that says the new one.

Problem folders and scripts outlive a layout. A path that is in :data:`MOVED` is the module that
now holds its names, not a copy of it.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

from oed_sysid.runtime.tables import tables

# Old public path and where its names are, below the package.
MOVED: dict[str, str] = tables(__file__)


def new_path(name: str) -> str | None:
    """Return where a module of an old path is now; None for every other path.

    >>> new_path("oed_sysid.effects.base"), new_path("oed_sysid.physics"), new_path("numpy")
    ('oed_sysid.physics.base', None, None)
    """
    package, _, old = name.partition(".")
    if package != "oed_sysid" or not old:
        return None
    parts = old.split(".")
    for count in range(len(parts), 0, -1):
        home = MOVED.get(".".join(parts[:count]))
        if home is not None:
            return ".".join((package, home, *parts[count:]))
    return None


class _Moved(MetaPathFinder, Loader):
    """Finds modules under their old paths."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return how to load an old path; None for every other one."""
        new = new_path(name)
        if new is None or find_spec(new) is None:
            return None
        # A package, so that paths below it are asked for here as well.
        return ModuleSpec(name, self)

    def exec_module(self, module: ModuleType) -> None:
        """Put the module that holds the names now in the place of the old one."""
        name, new = module.__name__, str(new_path(module.__name__))
        warnings.warn(f"{name} is now {new}: import from there.", DeprecationWarning, stacklevel=2)
        sys.modules[name] = import_module(new)
        # An import binds the module to its name in the package above, where that name may be taken.
        sys.modules[name.rpartition(".")[0]].__class__ = _Package


class _Package(ModuleType):
    """A package in which no module of an old path takes the place of a function or a class."""

    def __setattr__(self, name: str, value: object) -> None:
        """Bind a name, unless an import would hide what the package offers by it."""
        if not (isinstance(value, ModuleType) and callable(vars(self).get(name))):
            super().__setattr__(name, value)


def understand_old_paths() -> None:
    """Let ``import`` find what has moved."""
    if not any(isinstance(finder, _Moved) for finder in sys.meta_path):
        # Before the finder of files, which would load a second copy of a module under its old path.
        sys.meta_path.insert(0, _Moved())
