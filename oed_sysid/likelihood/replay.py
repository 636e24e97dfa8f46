r"""Values for runs: replay, simulation and export of a model that lacks physics.

Where process noise holds structure, the fit with it tells the derivatives best, and one without
the runs that were measured. Which of the two tells other runs better, runs left out say. With
:math:`E_i` the error of the whole run :math:`i`, its start fitted, under parameters that were
estimated without it, with process noise held at its level or without,

.. math:: d_i = \ln E_i\big(\hat\theta^\text{with}_{-i}\big)
    - \ln E_i\big(\hat\theta^\text{without}_{-i}\big)

(Stone 1974, J. R. Stat. Soc. B 36), it goes without where mean and median of :math:`d` are above
zero: one run alone decides nothing. Of a single record halves are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import OedSysidError
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import solve_filtered
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_model import Levels
from oed_sysid.likelihood.whole_runs import rms, whole_runs
from oed_sysid.physics.model import Model

WITHOUT = MultipleShooting(disturbances="none")
# A model estimated from some records, by their positions; None where that fails.
_Refit = Callable[[Sequence[int]], Model | None]


def replayed(fit: Fit) -> Fit:
    """The fit whose values are for runs: replay on records, simulation, export.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    Fit
        The same where it has no process noise, whole runs are as that would have left them, or it
        tells runs left out best; else one without process noise, whose
        :attr:`~oed_sysid.likelihood.fit.Fit.purpose` is ``"replay"``: derivatives, errors and the
        search for what is missing keep ``fit``.

    Examples
    --------
    Of a fit with process noise, for runs without measurements::

        replayed(fit).save("replay.json")
    """
    if not fit.whole_runs.took_the_work:
        return fit
    noise = fit.whole_runs.each("noise")
    begun = fit.model.with_values({n: v for n, v in fit.nominal.items() if n in fit.model.values})
    # Without process noise from its values, and from those of before.
    ends = (WITHOUT.fit(fit.model, fit.dataset, warm=fit), WITHOUT.fit(begun, fit.dataset))
    white = min(ends, key=lambda end: np.nan_to_num(end.whole_runs.size(noise=noise), nan=np.inf))
    try:
        parts, states = _parts(white)
    except OedSysidError:  # halves that are too short tell nothing
        return fit

    def without(kept: Sequence[int]) -> Model | None:
        try:
            return WITHOUT.fit(white.model, Dataset(tuple(parts[index] for index in kept))).model
        except OedSysidError:  # what is left may be too little
            return None

    def disturbed(kept: Sequence[int]) -> Model | None:
        rest = Dataset(tuple(parts[index] for index in kept))
        held = Levels.of(fit.noise, fit.noise, seas=fit.noise.seas)
        problem = Filtered(fit.model, rest, held)
        try:
            found = solve_filtered(problem, problem.point([states[index] for index in kept]))
        except (OedSysidError, np.linalg.LinAlgError):
            return None
        return None if found.finite is None else fit.model.with_values(found.values)

    # A run that neither tells decides nothing.
    with np.errstate(invalid="ignore"):
        told = _left_out(disturbed, parts, noise) - _left_out(without, parts, noise)
        gained = np.where(np.isnan(told), 0.0, told)
        mean, median = np.mean(gained), np.median(gained)
    better = mean > 0.0 and median > 0.0
    return replace(white, purpose="replay") if better else fit


def _parts(white: Fit) -> tuple[Dataset, Sequence[np.ndarray]]:
    """Records to leave out, and start states of each: those of the fit, or halves of its one."""
    if len(white.dataset) > 1:
        return white.dataset, white.initial_states
    (whole,) = white.dataset
    middle = whole.times[len(whole.times) // 2]
    first = whole.window(whole.times[0], np.nextafter(middle, -np.inf)).rename("first half")
    halves = Dataset((first, whole.window(middle, whole.times[-1]).rename("second half")))
    return halves, WITHOUT.fit(white.model, halves).initial_states


def _left_out(refit: _Refit, parts: Dataset, noise: np.ndarray) -> np.ndarray:
    """Logarithms of the errors of runs left out, in units of the noise, ``(n_records,)``."""
    errors = []
    for out, record in enumerate(parts):
        model = refit([index for index in range(len(parts)) if index != out])
        squares = np.inf
        if model is not None:
            squares = np.nanmean((rms(whole_runs(model, Dataset((record,)), noise)) / noise) ** 2)
        errors.append(0.5 * np.log(squares))
    return np.array(errors)
