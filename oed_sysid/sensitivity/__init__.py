"""What a manoeuvre can tell, before any data exist."""

from oed_sysid.sensitivity.bound import information_of, information_of_each
from oed_sysid.sensitivity.confirmation import Confirmation, confirm_bound
from oed_sysid.sensitivity.identifiability import (
    Subset,
    collinear_groups,
    collinearity_index,
    identifiable_subset,
)
from oed_sysid.sensitivity.linear import (
    Bode,
    Spectrum,
    Stability,
    bode,
    excitation_spectrum,
    straight_line_stability,
)
from oed_sysid.sensitivity.noise import Noise, fitted_colour, noise_of
from oed_sysid.sensitivity.nomoto import Nomoto, nomoto, nomoto_of
from oed_sysid.sensitivity.ranking import Sensitivity, SensitivityRanking, rank_parameters
from oed_sysid.sensitivity.reduction import Drop, Reduction, reduce_model
from oed_sysid.sensitivity.response import Play, Response, plays, respond
from oed_sysid.sensitivity.sea import SEAS, sea_noise, sea_words
from oed_sysid.sensitivity.structure import Structure, structural_identifiability

__all__ = [
    "information_of",
    "information_of_each",
    "sea_noise",
    "sea_words",
    "SEAS",
    "Noise",
    "noise_of",
    "fitted_colour",
    "Play",
    "Response",
    "plays",
    "respond",
    "collinearity_index",
    "collinear_groups",
    "identifiable_subset",
    "Subset",
    "Structure",
    "structural_identifiability",
    "Sensitivity",
    "SensitivityRanking",
    "rank_parameters",
    "Drop",
    "Reduction",
    "reduce_model",
    "Confirmation",
    "confirm_bound",
    "Bode",
    "bode",
    "Spectrum",
    "excitation_spectrum",
    "Stability",
    "straight_line_stability",
    "Nomoto",
    "nomoto",
    "nomoto_of",
]
