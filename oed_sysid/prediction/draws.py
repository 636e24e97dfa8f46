"""What predictions are asked of, a fit or a model, and parameter sets drawn from a fit."""

from __future__ import annotations

import math

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.model import Model


def asked(fit_or_model: Fit | Model) -> tuple[Fit | None, Model]:
    """The fit, if it is one, and the model to predict with.

    Raises
    ------
    ModelError
        If it is neither.
    """
    if isinstance(fit_or_model, Fit):
        return fit_or_model, fit_or_model.model
    if not isinstance(fit_or_model, Model):
        raise ModelError(f"Expected a fit or a model, got {type(fit_or_model).__name__}.")
    return None, fit_or_model


def parameter_sets(
    fit: Fit | None, model: Model, n_draws: int, rng: np.random.Generator | None
) -> list[np.ndarray]:
    """All parameters ``(n_parameters,)`` at the fitted values, then of each draw from a fit.

    Parameters
    ----------
    fit : Fit or None
        Without one there are no draws.
    model : Model
    n_draws : int
    rng : numpy.random.Generator, optional
        By default one with a fixed seed.
    """
    if fit is None or n_draws <= 0:
        return [model.value_vector]
    return [model.value_vector, *draw(fit, n_draws, rng or np.random.default_rng(0))]


def draw(fit: Fit, n_draws: int, rng: np.random.Generator) -> np.ndarray:
    """Draw parameter sets ``(n_draws, n_parameters)`` from what the fit knows.

    Shared parameters come from the draws of a sampler, where the fit has some, else from their
    covariance; parameters that differ by record from their scatter over the records. Values beyond
    a bound are set to it.

    Raises
    ------
    ModelError
        If the fit does not determine a parameter.
    """
    shared, model = _shared(fit, n_draws, rng), fit.model
    table = np.tile(model.value_vector, (len(shared), 1))
    position = {name: i for i, name in enumerate(model.parameter_names)}
    table[:, [position[name] for name in fit.names]] = shared
    for name in fit.local_values[0] if fit.local_values else ():
        spread = np.std([local[name] for local in fit.local_values])
        table[:, position[name]] += spread * rng.standard_normal(len(shared))
    bounds = [(parameter.lower, parameter.upper) for parameter in model.all_parameters]
    return np.clip(table, *np.reshape(bounds, (-1, 2)).T)


def _shared(fit: Fit, n_draws: int, rng: np.random.Generator) -> np.ndarray:
    """Draws ``(n_draws, n_names)`` of the parameters that all records share."""
    sampled = {} if fit.posterior is None else fit.posterior.draws
    if sampled and set(fit.names) <= set(sampled):
        flat = np.column_stack([np.ravel(sampled[name]) for name in fit.names])
        return flat[rng.choice(len(flat), min(n_draws, len(flat)), replace=False)]
    if np.all(np.isfinite(fit.covariance)):
        return rng.multivariate_normal(fit.estimates, fit.covariance, size=n_draws, method="eigh")
    unknown = [n for n, error in fit.std_errors.items() if not math.isfinite(error)]
    raise ModelError(
        f"The fit does not determine {', '.join(unknown)}: no uncertainty can be drawn. Fix "
        "these parameters, or give them a prior, and fit again; or pass fit.model."
    )
