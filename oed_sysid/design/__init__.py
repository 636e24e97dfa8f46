"""Experiments that tell most: criteria, families of commands, limits, search."""

from oed_sysid.design.assurance import (
    AbortRule,
    AccuracyRange,
    Assurance,
    Tracks,
    accuracy_range,
    assess_limits,
    plausible_tracks,
)
from oed_sysid.design.criteria import (
    AOptimal,
    Criterion,
    DOptimal,
    DsOptimal,
    EOptimal,
    GOptimal,
    ModifiedE,
    Setting,
    VOptimal,
)
from oed_sysid.design.decision import (
    Decision,
    Goal,
    ParameterGoal,
    PredictionGoal,
    decide,
    goals_of,
)
from oed_sysid.design.experiment_design import Stage, campaign, design_experiment, design_series
from oed_sysid.design.library import Candidate, Reference, candidate_runs
from oed_sysid.design.missing_effects import ByShifts, Chance, Discriminate, Reveal
from oed_sysid.design.on_board import Servo, write_bag, write_overrides
from oed_sysid.design.programme import design_programme
from oed_sysid.design.result import Design, Programme, Standard
from oed_sysid.design.search import Progress, ZigZags
from oed_sysid.design.vehicles import Caution, Robust
from oed_sysid.design.waveforms import Grid, Levels, Multisines, Parametrisation, Pulses

__all__ = [
    "design_experiment",
    "design_series",
    "design_programme",
    "Programme",
    "Standard",
    "Candidate",
    "decide",
    "Decision",
    "Goal",
    "ParameterGoal",
    "PredictionGoal",
    "goals_of",
    "candidate_runs",
    "campaign",
    "Stage",
    "Design",
    "Reference",
    "Criterion",
    "Setting",
    "DOptimal",
    "AOptimal",
    "EOptimal",
    "ModifiedE",
    "DsOptimal",
    "VOptimal",
    "GOptimal",
    "Discriminate",
    "Reveal",
    "Chance",
    "ByShifts",
    "Robust",
    "Caution",
    "AccuracyRange",
    "accuracy_range",
    "Assurance",
    "AbortRule",
    "Tracks",
    "plausible_tracks",
    "Servo",
    "write_overrides",
    "write_bag",
    "assess_limits",
    "Parametrisation",
    "Grid",
    "Levels",
    "Multisines",
    "Pulses",
    "ZigZags",
    "Progress",
]
