"""Manoeuvres: what is commanded during an experiment, and the indices of standard tests.

Examples
--------
>>> from math import radians
>>> from oed_sysid.experiments.manoeuvres import Combined, Constant, ZigZag
>>> trial = Combined((Constant("thrust", 700.0), ZigZag("rudder", radians(10), radians(10))))
>>> trial.describe()
'thrust constant at 700; zigzag 10/10 deg of rudder, reversed on psi, positive side first, from 0 s'
"""

from oed_sysid.experiments.base import (
    Controller,
    Excitation,
    Manoeuvre,
    OpenLoop,
    Stepwise,
    command_all,
)
from oed_sysid.experiments.composite import Combined, RateLimited, Saturated, Sequence
from oed_sysid.experiments.indices import (
    TurningIndices,
    ZigZagIndices,
    turning_indices,
    zigzag_indices,
)
from oed_sysid.experiments.orthogonal import orthogonal_multisines, peak_factor
from oed_sysid.experiments.prbs import PRBS, maximum_length_sequence
from oed_sysid.experiments.pulses import Doublet, ThreeTwoOneOne
from oed_sysid.experiments.sines import Chirp, Multisine, schroeder_phases
from oed_sysid.experiments.spirals import ReverseSpiral, Spiral
from oed_sysid.experiments.tabulated import FromRecord, Piecewise
from oed_sysid.experiments.turning import Constant, PullOut, TurningCircle
from oed_sysid.experiments.zigzag import ZigZag, ZigZagLike

__all__ = [
    "PRBS",
    "Chirp",
    "Combined",
    "Constant",
    "Controller",
    "Doublet",
    "Excitation",
    "FromRecord",
    "Manoeuvre",
    "Multisine",
    "OpenLoop",
    "Piecewise",
    "PullOut",
    "RateLimited",
    "ReverseSpiral",
    "Saturated",
    "Sequence",
    "Spiral",
    "Stepwise",
    "ThreeTwoOneOne",
    "TurningCircle",
    "TurningIndices",
    "ZigZag",
    "ZigZagIndices",
    "ZigZagLike",
    "command_all",
    "maximum_length_sequence",
    "orthogonal_multisines",
    "peak_factor",
    "schroeder_phases",
    "turning_indices",
    "zigzag_indices",
]
