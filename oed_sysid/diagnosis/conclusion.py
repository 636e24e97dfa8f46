"""What the last fit of an improvement says: errors of parameters, and what remains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from oed_sysid.diagnosis.greybox import GreyBox, Task, estimate, whitened
from oed_sysid.information import Information


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


def remainder(task: Task, fit: GreyBox) -> float:
    """Gain in twice the log-likelihood that disturbances bring over white noise alone."""
    quiet = replace(fit.noise, force=0 * fit.noise.force, colour=0 * fit.noise.colour)
    if fit.noise.is_white:
        return 0.0
    white = estimate(
        replace(task, units=replace(task.units, force=1e-9 * task.units.force)),
        fit.names,
        fit.values,
        fit.initial,
        quiet,
        update_noise=False,
    )
    return np.inf if white is None else max(white.objective - fit.objective, 0.0)
