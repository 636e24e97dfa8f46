"""System identification and optimal experiment design for marine vehicles.

Names are imported when they are first used, so that ``import oed_sysid`` is
quick; ``oed_sysid/README.md`` is the map of the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from oed_sysid.runtime.moved import understand_old_paths
from oed_sysid.runtime.version import __version__

understand_old_paths()

# Public names by the module that holds them.
_NAMES = {
    "physics": (
        "Actuator Environment ExtraState Force Inertia Memory Sensor InputNoise RandomForce "
        "SensorDrift UnknownForce UnknownInput"
    ),
    "text.callables": "Function",
    "likelihood.noise_model": "NoiseModel Sea",
    "physics.channels": "Channels Input Output State",
    "data.dataset": "Dataset Record read_csv write_csv",
    "data.logs": "import_log open_log read_mapping",
    "experiments.simulation": "simulate simulate_inputs",
    "experiments.experiment": "Experiment Limits",
    "experiments.manoeuvres": (
        "PRBS Chirp Combined Constant Doublet FromRecord Multisine Piecewise PullOut "
        "ReverseSpiral Spiral ThreeTwoOneOne TurningCircle ZigZag ZigZagLike"
    ),
    "likelihood.fit": "Fit",
    "physics.model": "Model",
    "likelihood.estimator": "Solver",
    "likelihood.multiple_shooting": "MultipleShooting",
    "errors": "OedSysidError",
    "physics.parameters": "Parameter",
    "experiments.problem": "Problem list_problems load_problem new_problem",
    "prediction.jackknife": "jackknife",
    "likelihood.replay": "replayed",
    "prediction.turning_circle": "turning_circle",
    "prediction.speed_polar": "speed_polar",
    "design": (
        "AOptimal DOptimal DsOptimal EOptimal GOptimal VOptimal Discriminate Robust "
        "design_experiment"
    ),
    "evidence.check": "check",
    "evidence.compare": "compare diagnose",
    "evidence.improve": "improve",
    "evidence.usual": "usual_effects",
    "information": "information_of rank_parameters reduce_model structural_identifiability",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"oed_sysid.{_HOME[name]}"), name)
    raise AttributeError(f"module 'oed_sysid' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)


if TYPE_CHECKING:
    from oed_sysid.data.dataset import Dataset, Record, read_csv, write_csv
    from oed_sysid.data.logs import import_log, open_log, read_mapping
    from oed_sysid.design import (
        AOptimal,
        Discriminate,
        DOptimal,
        DsOptimal,
        EOptimal,
        GOptimal,
        Robust,
        VOptimal,
        design_experiment,
    )
    from oed_sysid.errors import OedSysidError
    from oed_sysid.evidence.check import check  # type: ignore[no-redef]
    from oed_sysid.evidence.compare import compare, diagnose
    from oed_sysid.evidence.improve import improve
    from oed_sysid.evidence.usual import usual_effects
    from oed_sysid.experiments.experiment import Experiment, Limits
    from oed_sysid.experiments.manoeuvres import (
        PRBS,
        Chirp,
        Combined,
        Constant,
        Doublet,
        FromRecord,
        Multisine,
        Piecewise,
        PullOut,
        ReverseSpiral,
        Spiral,
        ThreeTwoOneOne,
        TurningCircle,
        ZigZag,
        ZigZagLike,
    )
    from oed_sysid.experiments.problem import Problem, list_problems, load_problem, new_problem
    from oed_sysid.experiments.simulation import simulate, simulate_inputs
    from oed_sysid.information import (
        information_of,
        rank_parameters,
        reduce_model,
        structural_identifiability,
    )
    from oed_sysid.likelihood.fit import Fit
    from oed_sysid.likelihood.multiple_shooting import MultipleShooting
    from oed_sysid.likelihood.noise_model import NoiseModel, Sea
    from oed_sysid.likelihood.replay import replayed
    from oed_sysid.physics import (
        Actuator,
        Environment,
        ExtraState,
        Force,
        Inertia,
        InputNoise,
        Memory,
        RandomForce,
        Sensor,
        SensorDrift,
        UnknownForce,
        UnknownInput,
    )
    from oed_sysid.physics.channels import Channels, Input, Output, State
    from oed_sysid.physics.model import Model
    from oed_sysid.physics.parameters import Parameter
    from oed_sysid.prediction.jackknife import jackknife
    from oed_sysid.prediction.speed_polar import speed_polar
    from oed_sysid.prediction.turning_circle import turning_circle
    from oed_sysid.text.callables import Function
