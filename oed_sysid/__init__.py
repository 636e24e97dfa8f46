"""System identification and optimal experiment design for marine vehicles.

Names are imported when they are first used, so that ``import oed_sysid`` is
quick; ``oed_sysid/README.md`` is the map of the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from oed_sysid.version import __version__

_HOME = {
    "Actuator": "effects",
    "Environment": "effects",
    "ExtraState": "effects",
    "Force": "effects",
    "Function": "language.callables",
    "Inertia": "effects",
    "Memory": "effects",
    "Sensor": "effects",
    "InputNoise": "effects",
    "RandomForce": "effects",
    "SensorDrift": "effects",
    "UnknownForce": "effects",
    "UnknownInput": "effects",
    "NoiseModel": "noise.model",
    "Channels": "channels",
    "Input": "channels",
    "Output": "channels",
    "State": "channels",
    "Dataset": "data.dataset",
    "Record": "data.dataset",
    "read_csv": "data.dataset",
    "write_csv": "data.dataset",
    "import_log": "logs",
    "open_log": "logs",
    "read_mapping": "logs",
    "simulate": "simulation",
    "simulate_inputs": "simulation",
    "Experiment": "experiment",
    "Limits": "experiment",
    "PRBS": "manoeuvres",
    "Chirp": "manoeuvres",
    "Combined": "manoeuvres",
    "Constant": "manoeuvres",
    "Doublet": "manoeuvres",
    "FromRecord": "manoeuvres",
    "Multisine": "manoeuvres",
    "Piecewise": "manoeuvres",
    "PullOut": "manoeuvres",
    "ReverseSpiral": "manoeuvres",
    "Spiral": "manoeuvres",
    "ThreeTwoOneOne": "manoeuvres",
    "TurningCircle": "manoeuvres",
    "ZigZag": "manoeuvres",
    "ZigZagLike": "manoeuvres",
    "Fit": "fitting.fit",
    "Model": "model",
    "MultipleShooting": "estimators",
    "OedSysidError": "errors",
    "Parameter": "parameters",
    "Problem": "problem",
    "list_problems": "problem",
    "load_problem": "problem",
    "new_problem": "problem",
    "jackknife": "predictions.jackknife",
    "turning_circle": "predictions.turning_circle",
    "speed_polar": "predictions.speed_polar",
    "AOptimal": "design",
    "DOptimal": "design",
    "DsOptimal": "design",
    "EOptimal": "design",
    "GOptimal": "design",
    "ModifiedE": "design",
    "VOptimal": "design",
    "check": "compatibility",
    "quick_check": "compatibility",
    "compare": "diagnosis.compare",
    "diagnose": "diagnosis.diagnose",
    "improve": "diagnosis.improve",
    "usual_effects": "diagnosis.usual",
    "Discriminate": "design",
    "Robust": "design",
    "design_experiment": "design",
    "design_series": "design",
    "information_of": "sensitivity",
    "rank_parameters": "sensitivity",
    "reduce_model": "sensitivity",
    "structural_identifiability": "sensitivity",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"oed_sysid.{_HOME[name]}"), name)
    raise AttributeError(f"module 'oed_sysid' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)


if TYPE_CHECKING:
    from oed_sysid.channels import Channels, Input, Output, State
    from oed_sysid.compatibility import check, quick_check  # type: ignore[no-redef]
    from oed_sysid.data.dataset import Dataset, Record, read_csv, write_csv
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
    from oed_sysid.diagnosis.compare import compare
    from oed_sysid.diagnosis.diagnose import diagnose
    from oed_sysid.diagnosis.improve import improve
    from oed_sysid.diagnosis.usual import usual_effects
    from oed_sysid.effects import (
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
    from oed_sysid.errors import OedSysidError
    from oed_sysid.estimators import MultipleShooting
    from oed_sysid.experiment import Experiment, Limits
    from oed_sysid.fitting.fit import Fit
    from oed_sysid.language.callables import Function
    from oed_sysid.logs import import_log, open_log, read_mapping
    from oed_sysid.manoeuvres import (
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
    from oed_sysid.model import Model
    from oed_sysid.noise.model import NoiseModel
    from oed_sysid.parameters import Parameter
    from oed_sysid.predictions.jackknife import jackknife
    from oed_sysid.predictions.speed_polar import speed_polar
    from oed_sysid.predictions.turning_circle import turning_circle
    from oed_sysid.problem import Problem, list_problems, load_problem, new_problem
    from oed_sysid.sensitivity import (
        information_of,
        rank_parameters,
        reduce_model,
        structural_identifiability,
    )
    from oed_sysid.simulation import simulate, simulate_inputs
