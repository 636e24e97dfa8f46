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

_HOME = {
    "Actuator": "physics",
    "Environment": "physics",
    "ExtraState": "physics",
    "Force": "physics",
    "Function": "text.callables",
    "Inertia": "physics",
    "Memory": "physics",
    "Sensor": "physics",
    "InputNoise": "physics",
    "RandomForce": "physics",
    "SensorDrift": "physics",
    "UnknownForce": "physics",
    "UnknownInput": "physics",
    "NoiseModel": "likelihood.noise_model",
    "Sea": "likelihood.noise_model",
    "Channels": "physics.channels",
    "Input": "physics.channels",
    "Output": "physics.channels",
    "State": "physics.channels",
    "Dataset": "data.dataset",
    "Record": "data.dataset",
    "read_csv": "data.dataset",
    "write_csv": "data.dataset",
    "import_log": "data.logs",
    "open_log": "data.logs",
    "read_mapping": "data.logs",
    "simulate": "experiments.simulation",
    "simulate_inputs": "experiments.simulation",
    "Experiment": "experiments.experiment",
    "Limits": "experiments.experiment",
    "PRBS": "experiments.manoeuvres",
    "Chirp": "experiments.manoeuvres",
    "Combined": "experiments.manoeuvres",
    "Constant": "experiments.manoeuvres",
    "Doublet": "experiments.manoeuvres",
    "FromRecord": "experiments.manoeuvres",
    "Multisine": "experiments.manoeuvres",
    "Piecewise": "experiments.manoeuvres",
    "PullOut": "experiments.manoeuvres",
    "ReverseSpiral": "experiments.manoeuvres",
    "Spiral": "experiments.manoeuvres",
    "ThreeTwoOneOne": "experiments.manoeuvres",
    "TurningCircle": "experiments.manoeuvres",
    "ZigZag": "experiments.manoeuvres",
    "ZigZagLike": "experiments.manoeuvres",
    "Fit": "likelihood.fit",
    "Model": "physics.model",
    "MultipleShooting": "baselines",
    "Solver": "baselines",
    "OedSysidError": "errors",
    "Parameter": "physics.parameters",
    "Problem": "experiments.problem",
    "list_problems": "experiments.problem",
    "load_problem": "experiments.problem",
    "new_problem": "experiments.problem",
    "jackknife": "prediction.jackknife",
    "replayed": "likelihood.replay",
    "turning_circle": "prediction.turning_circle",
    "speed_polar": "prediction.speed_polar",
    "AOptimal": "design",
    "DOptimal": "design",
    "DsOptimal": "design",
    "EOptimal": "design",
    "GOptimal": "design",
    "ModifiedE": "design",
    "VOptimal": "design",
    "check": "evidence.check",
    "quick_check": "evidence.check",
    "compare": "evidence.compare",
    "diagnose": "evidence.compare",
    "improve": "evidence.improve",
    "usual_effects": "evidence.usual",
    "Discriminate": "design",
    "Robust": "design",
    "design_experiment": "design",
    "design_series": "design",
    "information_of": "information",
    "rank_parameters": "information",
    "reduce_model": "information",
    "structural_identifiability": "information",
}

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
        ModifiedE,
        Robust,
        VOptimal,
        design_experiment,
        design_series,
    )
    from oed_sysid.errors import OedSysidError
    from oed_sysid.evidence.check import check, quick_check  # type: ignore[no-redef]
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
