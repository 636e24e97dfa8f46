r"""Integration steps so short that no estimate depends on them.

With :math:`y_h` the outputs of a fitted model by steps of ``h``, ``J`` their derivatives by all
unknowns and :math:`\sigma` the noise, half the step moves the estimates by

.. math:: \delta\hat\theta = (J'J)^{+} J'\, \frac{y_h - y_{h/2}}{\sigma}, \qquad
    \frac{|\delta\hat\theta_j|}{\operatorname{std}\hat\theta_j}
    \le \Big\| \frac{y_h - y_{h/2}}{\sigma} \Big\|_2

to first order; the bound is Cauchy's. An error of a hundredth of the noise in each of ten thousand
samples may be a standard error, so that samples one by one say nothing of it. Where the bound
leaves a shift possible that intervals would show, the fit goes on by half the step, and the finer
one is kept where an estimate did move. Dry friction and other steep forces need it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.likelihood.departures import outputs_of, values_of
from oed_sysid.likelihood.estimate import Estimate, Integration, once_a_fit
from oed_sysid.likelihood.noise_levels import signal_spread, white_levels
from oed_sysid.runtime.constants import MATERIAL

# A fit goes on as what it is.
Ended = TypeVar("Ended", bound=Estimate)
# Standard errors by which half the step may move an estimate: of a hundred intervals of 95 % that
# are off by so much 94 hold.
BIAS = MATERIAL
# Ends of a fit that a finer step may better.
ENDED = ("converged", "integration")


@dataclass(frozen=True)
class StepChange:
    """Change of the outputs with a finer step, in noise levels.

    Attributes
    ----------
    size : float
        Root mean square of the output and record that change most.
    output, record : str
        These; empty where nothing changes, or nothing can be said.
    total : float
        Root sum of squares over all measured samples: no estimate moves by more standard errors.
    """

    size: float = 0.0
    output: str = ""
    record: str = ""
    total: float = 0.0


def shown_noise(fit: Estimate) -> np.ndarray:
    """Noise levels ``(n_outputs,)``, estimated ones no larger than what the records show."""
    if not fit.sigma_estimated.any():
        return fit.sigma
    sigma = np.minimum(fit.sigma, white_levels(fit.dataset)[0])
    # Filtered or exact records: a thousandth of the signal is no visible error.
    least = np.maximum(sigma, 1e-3 * signal_spread(fit.dataset))
    return np.where(fit.sigma_estimated, least, fit.sigma)


@once_a_fit
def step_change(fit: Estimate) -> StepChange:
    """Change of the outputs with half the step, which shows 15/16 of an error of fourth order.

    With disturbance forces, or where windows are predicted, the model alone may drift away; there
    pieces of twenty samples begin at the states of the simulation, with settled actuators and
    sensors, whose memory another step divides in another way.
    """
    coarse = kernel(fit.model)
    fine = kernel(replace(fit.model, step=0.5 * fit.model.step))
    sigma = shown_noise(fit)
    worst, squares = StepChange(), 0.0
    for index, record in enumerate(fit.dataset):
        before, after = _both_steps(fit, index, coarse, fine)
        known = np.isfinite(before).all(axis=1)
        if not known.any():
            continue
        measured = np.isfinite(record.outputs)
        with np.errstate(invalid="ignore", over="ignore"):
            parts = np.nan_to_num(((after - before) / sigma) ** 2, nan=np.inf, posinf=np.inf)
        squares += float(parts[known[:, None] & measured].sum())
        change = np.where(measured.any(axis=0), np.sqrt(parts[known].mean(axis=0)), 0.0)
        column = int(np.argmax(change))
        if change[column] > worst.size:
            output = fit.model.output_names[column]
            worst = StepChange(float(change[column]), output, record.name)
    return replace(worst, total=float(np.sqrt(squares)))


def _both_steps(
    fit: Estimate, index: int, coarse: Kernel, fine: Kernel
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs of one record with both steps, whole or in pieces."""
    record, states = fit.dataset[index], fit.states[index]
    whole = not fit.noise.has_forces and fit.horizon is None
    if whole or states.shape[1] != coarse.n_full:
        return fit.predictions[index], outputs_of(fit, index, record.inputs, runner=fine)
    values = values_of(fit, index)
    last = int(np.isfinite(states).all(axis=1).cumprod().sum())
    starts = np.arange(0, record.n_samples, 20)
    starts = starts[starts < last] if last else starts[:1]
    moving = len(fit.model.all_state_names)

    def pieces(one: Kernel) -> np.ndarray:
        own = states[:, : one.n_own]
        begun = (one.start(own[k], record.inputs[k], values, record.times[k]) for k in starts)
        nodes = np.stack([z for z, _ in begun])
        nodes[:, :moving] = states[starts, :moving]
        return one.run(record.times, record.inputs, values, nodes, starts=starts).outputs

    return pieces(coarse), pieces(fine)


def resolved(fit: Ended, again: Callable[[float, Ended], Ended]) -> Ended:
    """The same fit by steps so short that no estimate depends on them.

    Parameters
    ----------
    fit : Fit
    again : callable
        The fit by another step in s, from where an earlier one ended.
    """
    first = fit
    for halvings in range(1, 5):  # to a sixteenth: what needs more jumps, and no step will do
        if fit.status.code not in ENDED or step_change(fit).total < BIAS:
            break
        finer = again(first.model.step / 2**halvings, fit)
        ended = finer.status.code in ENDED
        # What a finer step cures stays cured, though no estimate moved; what needs a cure goes on
        # to still finer ones, though the iterations between did not end.
        if fit.status.code == "converged" and not (ended and moved(fit, finer)[0] >= BIAS):
            break
        if ended:
            size, name = moved(first, finer)
            told = Integration(first.model.step, name, size)
            fit = replace(finer, integration=told, iterations=fit.iterations + finer.iterations)
    return fit


def moved(before: Estimate, after: Estimate) -> tuple[float, str]:
    """By how many of its standard errors an estimate moved: the largest such shift, and which."""
    shifts = [
        (abs(after.values[name] - before.values[name]) / error, name)
        for name, error in after.std_errors.items()
        if name in before.names and 0.0 < error < np.inf
    ]
    return max(shifts, default=(0.0, ""))
