"""How long disturbances and sensor noise remember, by likelihood.

Scores and gains mean what they say only in the colour that the noise really
has: at a wrong correlation time chance looks like physics.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oed_sysid.diagnosis.greybox import GreyBox, Task, residuals, with_noise
from oed_sysid.noise.kalman import NoiseModel
from oed_sysid.noise.levels import estimate_noise

# Ratio of neighbouring times that are tried; between them the likelihood is flat.
RATIO = 2.0
# Gain in twice the log-likelihood below which a time stays what it was.
WORTH = 4.0
# Shortest time in samples, longest as a share of the shortest record.
SHORTEST, LONGEST = 0.5, 0.05


def with_correlation_times(task: Task, fit: GreyBox) -> tuple[Task, GreyBox]:
    """Correlation times that make the residuals of a fit most likely.

    Parameters of the model stay, noise levels follow. A time is looked for
    only where there is a disturbance that has it.

    Parameters
    ----------
    task : Task
    fit : GreyBox

    Returns
    -------
    task : Task
        With the times in its units.
    fit : GreyBox
        Judged under the new noise model.
    """
    if fit.noise.has_colour:
        task, fit = _search(task, fit, "colour_time")
    if np.any(fit.noise.force > 0):
        task, fit = _search(task, fit, "force_time")
    return task, fit


def _search(task: Task, fit: GreyBox, name: str) -> tuple[Task, GreyBox]:
    """Go to longer times while that pays, else to shorter ones."""
    shortest = SHORTEST * min(record.sample_time for record in task.dataset)
    longest = LONGEST * min(record.duration for record in task.dataset)
    began = fit
    for ratio in (RATIO, 1.0 / RATIO):
        while True:
            time = getattr(fit.noise, name) * ratio
            if not shortest <= time <= longest:
                break
            trial_task = replace(task, units=_at(task.units, name, time))
            trial = _judged(trial_task, fit, _at(fit.noise, name, time), ratio, name)
            if trial.objective > fit.objective - WORTH:
                break
            task, fit = trial_task, trial
        if fit is not began:
            break
    return task, fit


def _at(noise: NoiseModel, name: str, time: float) -> NoiseModel:
    if name == "colour_time":
        return replace(noise, colour_time=time)
    return replace(noise, force_time=time)


def _judged(task: Task, fit: GreyBox, noise: NoiseModel, ratio: float, name: str) -> GreyBox:
    """The fit with levels for new times, begun where slow disturbances stay as strong."""
    if name == "force_time":
        noise = replace(noise, force=noise.force / np.sqrt(ratio))
    levels = estimate_noise(
        noise,
        task.units,
        task.deviations,
        residuals(task.dataset, fit.outputs),
        known=task.known_noise,
        least_white=task.least_white,
        tolerance=0.5,
        max_iterations=8,
    )
    return with_noise(task, fit, levels)
