"""Experiments that tell most: criteria, families of commands, limits, search."""

from oed_sysid.design.assurance import (
    AbortRule,
    AccuracyRange,
    Assurance,
    PredictedTracks,
    accuracy_range,
    assess_limits,
)
from oed_sysid.design.card import TrialCard
from oed_sysid.design.controllers import (
    Servo,
    played,
    write_bag,
    write_controller,
    write_overrides,
)
from oed_sysid.design.criteria import (
    AOptimal,
    ByShifts,
    Criterion,
    Detect,
    Detection,
    Discriminate,
    DOptimal,
    DsOptimal,
    EOptimal,
    GOptimal,
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
from oed_sysid.design.experiment_design import Stage, campaign, design_experiment
from oed_sysid.design.knowledge import Knowledge
from oed_sysid.design.library import Candidate, Reference, ZigZags, candidate_runs
from oed_sysid.design.programme import Budget, ProgrammeSearch, design_programme
from oed_sysid.design.result import Design, Programme, Standard
from oed_sysid.design.search import Progress
from oed_sysid.design.trial import Search, Trial
from oed_sysid.design.vehicles import Caution, Robust
from oed_sysid.design.waveforms import Grid, Levels, Multisines, Parametrisation, Pulses
from oed_sysid.errors import respelled_names as _respelled_names
from oed_sysid.runtime.version import exported

__all__ = exported(globals())

__getattr__ = _respelled_names(
    __name__,
    {
        "Reveal": "Detect",
        "ModifiedE": "EOptimal",
        "design_series": "design_programme",
        "Chance": "Detection",
        "Tracks": "PredictedTracks",
        "plausible_tracks": "assess_limits(...).tracks",
        "predicted_tracks": "assess_limits(...).tracks",
    },
)
