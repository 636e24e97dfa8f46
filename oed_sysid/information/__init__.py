"""What a manoeuvre can tell, before any data exist."""

from oed_sysid.errors import respelled_names as _respelled_names
from oed_sysid.information.bound import (
    Confirmation,
    confirm_bound,
    information_of,
)
from oed_sysid.information.identifiability import (
    Structure,
    Subset,
    collinearity_index,
    identifiable_subset,
    structural_identifiability,
)
from oed_sysid.information.noise import SEAS, noise_of, sea_noise, sea_words
from oed_sysid.information.ranking import (
    Drop,
    Reduction,
    Sensitivity,
    SensitivityRanking,
    rank_parameters,
    reduce_model,
)
from oed_sysid.information.response import CommandedRun, Response, commanded_runs, respond
from oed_sysid.runtime.version import exported

__all__ = exported(globals())

__getattr__ = _respelled_names(
    __name__,
    {
        "Bode": "control.FrequencyResponseData",
        "Noise": "numpy.ndarray",
        "Spectrum": "scipy.signal.periodogram",
        "bode": "control.frequency_response(linearise(model, point))",
        "collinear_groups": "identifiable_subset",
        "excitation_spectrum": "scipy.signal.periodogram",
        "fitted_colour": "MultipleShooting(...).fit(...).noise",
        "information_of_each": "information_of",
        "nomoto": "control.ss2tf(linearise(model, point))",
        "straight_line_stability": "numpy.linalg.eigvals(linearise(model, point).A)",
    },
)
