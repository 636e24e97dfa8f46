"""Experiments that tell most: criteria, families of commands, limits, search."""

from oed_sysid.design.accuracy import AccuracyRange, accuracy_range
from oed_sysid.design.assurance import AbortRule, Assurance, assess_limits
from oed_sysid.design.autopilot import Servo, write_bag, write_overrides
from oed_sysid.design.campaign import Stage, campaign
from oed_sysid.design.caution import Caution
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
from oed_sysid.design.discrimination import ByShifts, Discriminate
from oed_sysid.design.experiment_design import design_experiment, design_series
from oed_sysid.design.library import Candidate, candidate_runs
from oed_sysid.design.multisines import Multisines
from oed_sysid.design.parametrisation import Grid, Levels, Parametrisation, Pulses
from oed_sysid.design.programme import design_programme
from oed_sysid.design.reference import Reference
from oed_sysid.design.result import Design
from oed_sysid.design.reveal import Chance, Reveal
from oed_sysid.design.robust import Robust
from oed_sysid.design.schedule import Programme, Standard
from oed_sysid.design.search import Progress
from oed_sysid.design.tracks import Tracks, plausible_tracks
from oed_sysid.design.zigzags import ZigZags

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
