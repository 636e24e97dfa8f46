"""The scripts of the published papers as modules."""

from __future__ import annotations

import functools
import importlib.util
from types import ModuleType

from benchmarks.documents.page import ROOT


@functools.cache
def paper(name: str) -> ModuleType:
    """What ``problems/NAME/paper.py`` computes; nothing is printed.

    Examples
    --------
    >>> paper("torpedo").N_GENERATIONS
    300
    """
    path = ROOT / "problems" / name / "paper.py"
    spec = importlib.util.spec_from_file_location(f"paper_{name}", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} cannot be read as a module.")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
