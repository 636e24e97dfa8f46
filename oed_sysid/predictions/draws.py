"""Parameter sets drawn from what a fit knows."""

from __future__ import annotations

import math

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.fitting.fit import Fit


def draw(fit: Fit, n_draws: int, rng: np.random.Generator) -> np.ndarray:
    """Draw parameter sets ``(n_draws, n_parameters)`` from what the fit knows.

    Shared parameters come from their covariance, parameters that differ by record from their
    scatter over the records; values beyond a bound are set to it.

    Raises
    ------
    ModelError
        If the fit does not determine a parameter.
    """
    if not np.all(np.isfinite(fit.covariance)):
        unknown = [n for n, error in fit.std_errors.items() if not math.isfinite(error)]
        raise ModelError(
            f"The fit does not determine {', '.join(unknown)}: no uncertainty can be drawn. Fix "
            "these parameters, or give them a prior, and fit again; or pass fit.model."
        )
    model = fit.model
    table = np.tile(model.value_vector, (n_draws, 1))
    position = {name: i for i, name in enumerate(model.parameter_names)}
    shared = rng.multivariate_normal(fit.estimates, fit.covariance, size=n_draws, method="eigh")
    table[:, [position[name] for name in fit.names]] = shared
    for name in fit.local_values[0] if fit.local_values else ():
        spread = np.std([local[name] for local in fit.local_values])
        table[:, position[name]] += spread * rng.standard_normal(n_draws)
    lower = [parameter.lower for parameter in model.all_parameters]
    upper = [parameter.upper for parameter in model.all_parameters]
    return np.clip(table, lower, upper)
