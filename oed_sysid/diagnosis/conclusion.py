"""What the last fit of an improvement says: errors of parameters, and what remains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from oed_sysid.diagnosis.greybox import (
    GreyBox,
    Task,
    estimate,
    residuals,
    whitened,
    with_noise,
)
from oed_sysid.fitting.noise_levels import residual_levels
from oed_sysid.information import Information

# Twice the log-likelihood that disturbances may gain before they count as real.
REMAINDER_LIMIT = 14.0


def information(task: Task, fit: GreyBox) -> Information:
    """Information of the parameters in the metric of the noise model, starts eliminated."""
    jacobian = whitened(task, fit).jacobian
    n_names = len(fit.names)
    # Columns of the start states first: what is left below them is free of them.
    order = np.r_[n_names : jacobian.shape[1], :n_names]
    triangle = np.asarray(np.linalg.qr(jacobian[:, order], mode="r"))
    first = jacobian.shape[1] - n_names
    scales = np.array([task.super_model.model.parameter(n).magnitude for n in fit.names])
    return Information.from_jacobian(fit.names, triangle[first:, first:], scales)


def parameter_table(task: Task, fit: GreyBox) -> tuple[Mapping[str, Any], ...]:
    """Name, value, standard error and unit of every estimated parameter."""
    errors = information(task, fit).std_errors
    return tuple(
        {
            "name": name,
            "value": fit.values[name],
            "std_error": float(error),
            "unit": task.super_model.model.parameter(name).unit,
        }
        for name, error in zip(fit.names, errors, strict=True)
    )


@dataclass(frozen=True)
class Remains:
    """What a fit leaves unexplained.

    Attributes
    ----------
    forces : float
        Gain in twice the log-likelihood that forces bring over noise of the
        sensors alone, which may be correlated in time where it needs no force
        beside it.
    sensor_time : float or None
        Correlation time of the sensors' noise, s; None where white noise
        explains them too.
    """

    forces: float
    sensor_time: float | None

    @property
    def is_noise(self) -> bool:
        """Whether no disturbance is needed any more."""
        return self.forces < REMAINDER_LIMIT


def remains(task: Task, fit: GreyBox) -> Remains:
    """Judge what a fit leaves.

    The white levels of the alternative are its own most likely ones, unless the
    task declares them known.
    """
    if fit.noise.is_white:
        return Remains(0.0, None)
    coloured = fit.noise.with_levels(fit.noise.white, fit.noise.colour, 0 * fit.noise.force)
    without_forces = with_noise(task, fit, coloured).objective - fit.objective
    over_white = _over_white(task, fit)
    is_coloured = fit.noise.has_colour and over_white >= REMAINDER_LIMIT
    return Remains(
        max(min(without_forces, over_white), 0.0), fit.noise.colour_time if is_coloured else None
    )


def _over_white(task: Task, fit: GreyBox) -> float:
    """Gain of everything beyond white noise of the sensors."""
    levels = fit.noise.white
    alternative = fit
    for _ in range(1 if task.known_noise else 3):
        quiet = fit.noise.with_levels(levels, 0 * fit.noise.colour, 0 * fit.noise.force)
        found = estimate(
            task, fit.names, fit.values, fit.initial, quiet, update_noise=False, max_iterations=8
        )
        if found is None:
            return np.inf
        alternative = found
        if not task.known_noise:
            levels = residual_levels(residuals(task.dataset, found.outputs), 0)
            levels = np.maximum(levels, 1e-6 * task.units.white)
    best = with_noise(
        task,
        alternative,
        fit.noise.with_levels(levels, 0 * fit.noise.colour, 0 * fit.noise.force),
    )
    return best.objective - fit.objective
