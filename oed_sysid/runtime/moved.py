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
from types import ModuleType

# Old public path and where its names are, below the package.
MOVED = {
    "batch": "runtime",
    "benchmark": "baselines.benchmark",
    "bodies": "physics.bodies",
    "channels": "physics.channels",
    "compatibility": "evidence.check",
    "diagnosis": "evidence",
    "effects": "physics",
    "estimators": "baselines",
    "estimators.baselines": "baselines",
    "estimators.baselines.equation_error": "baselines.least_squares",
    "estimators.baselines.ls_svm": "baselines.support_vectors",
    "estimators.baselines.regression_form": "baselines.equations",
    "estimators.baselines.regression_rows": "baselines.equations",
    "estimators.baselines.swarm": "baselines.population",
    "estimators.baselines.trajectory_cost": "baselines.population",
    "experiment": "experiments.experiment",
    "fitting": "likelihood",
    "language": "text",
    "logs": "data.logs",
    "manoeuvres": "experiments.manoeuvres",
    "model": "physics.model",
    "noise": "likelihood.noise",
    "parameters": "physics.parameters",
    "predictions": "prediction",
    "predictions.course_control": "prediction.laws",
    "predictions.smooth_heading": "prediction.helmsman",
    "predictions.zigzag_control": "prediction.laws",
    "problem": "experiments.problem",
    "report": "results",
    "sensitivity": "information",
    "simulation": "experiments.simulation",
}


class _Moved(MetaPathFinder, Loader):
    """Finds modules under their old paths."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return how to load an old path; None for every other one."""
        package, _, old = name.partition(".")
        if package != "oed_sysid" or old not in MOVED:
            return None
        # A package, so that paths below it are asked for here as well.
        return ModuleSpec(name, self)

    def exec_module(self, module: ModuleType) -> None:
        """Put the module that holds the names now in the place of the old one."""
        new = f"oed_sysid.{MOVED[module.__name__.partition('.')[2]]}"
        warnings.warn(
            f"{module.__name__} is now {new}: import from there.", DeprecationWarning, stacklevel=2
        )
        sys.modules[module.__name__] = import_module(new)


def understand_old_paths() -> None:
    """Let ``import`` find what has moved."""
    if not any(isinstance(finder, _Moved) for finder in sys.meta_path):
        sys.meta_path.append(_Moved())
