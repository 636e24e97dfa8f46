r"""Values for runs: replay, simulation and export of a model that lacks physics.

Where process noise holds structure, the fit with it tells the derivatives best, because it asks of
the model one sample ahead. A fit without process noise asks for whole runs, and trusts them too
much: what a model that lacks physics leaves of them is larger than the noise of sensors, and
correlated, so that the :math:`n_j` samples of output :math:`j` tell no more than
:math:`n^\mathrm{eff}_j` independent ones
(:func:`~oed_sysid.likelihood.information.effective_sample_size`). Taken for what they tell, their
residuals :math:`e_{jk}` have the standard deviation

.. math:: \sigma_j^2 = \frac{1}{n^\mathrm{eff}_j}
    \max\Bigl( \sum_k e_{jk}^2,\; n_j \sigma_{j,0}^2 \Bigr),

:math:`\sigma_{j,0}` the noise that the sensor is granted. With these levels (a tempered likelihood;
Bissiri, Holmes & Walker 2016, J. R. Stat. Soc. B 78) the fit follows whole runs where they are
sure, and priors where they are not.

Which of the two tells other runs better, runs left out say (Stone 1974, J. R. Stat. Soc. B 36): the
error of each whole run, its start fitted, under parameters that were estimated without it. The
values without process noise are for runs where they tell most of them better. Of a single record
halves are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import OedSysidError
from oed_sysid.likelihood.departures import slowness
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import solve_filtered
from oed_sysid.likelihood.laws import posed_again
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_levels import residual_levels
from oed_sysid.likelihood.whole_runs import rms, whole_runs
from oed_sysid.physics.model import Model

WITHOUT = MultipleShooting(disturbances="none")
# A model estimated from records at some positions, and these; None where that fails.
_Refit = Callable[[Sequence[int], Dataset], Model | None]


def replayed(fit: Fit) -> Fit:
    """The fit whose values are for runs: replay on records, simulation, export.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    Fit
        The same where it has no process noise, whole runs are as that would have left them, or it
        tells most runs left out better; else one without process noise, its noise what whole runs
        leave, whose :attr:`~oed_sysid.likelihood.fit.Fit.purpose` is ``"replay"``: derivatives,
        errors and the search for what is missing keep ``fit``.

    Examples
    --------
    Of a fit with process noise, for runs without measurements::

        replayed(fit).save("replay.json")
    """
    if not fit.whole_runs.took_the_work:
        return fit
    noise = fit.whole_runs.each("noise")
    # From its values, and from those of before.
    begun = fit.model.with_values({n: v for n, v in fit.nominal.items() if n in fit.model.values})
    ends = (WITHOUT.fit(fit.model, fit.dataset, warm=fit), WITHOUT.fit(begun, fit.dataset))
    white = min(ends, key=lambda end: np.nan_to_num(end.whole_runs.size(noise=noise), nan=np.inf))
    # Standard deviations with which its whole runs tell as much as they do.
    levels = np.fmax(residual_levels(white.residuals), noise) * [*slowness(white).values()]
    tempered = replace(WITHOUT, noise=tuple(levels.tolist()))
    tried = _fits(tempered, (fit.model, white.model, begun), fit.dataset)
    calm = min(tried, key=lambda end: end.cost, default=white)
    try:
        parts, states = _parts(calm)
    except OedSysidError:  # halves that are too short tell nothing
        return fit

    def without(_: Sequence[int], rest: Dataset) -> Model | None:
        return next((end.model for end in _fits(tempered, (calm.model,), rest)), None)

    def disturbed(kept: Sequence[int], rest: Dataset) -> Model | None:
        try:
            problem, _ = posed_again(replace(fit, dataset=rest))
            found = solve_filtered(problem, problem.point([states[index] for index in kept]))
        except (OedSysidError, np.linalg.LinAlgError):
            return None
        return None if found.finite is None else found.model

    with np.errstate(invalid="ignore"):
        gained = _left_out(disturbed, parts, noise) - _left_out(without, parts, noise)
    # A run that neither tells decides nothing.
    if not np.median(np.where(np.isnan(gained), 0.0, gained)) > 0.0:
        return fit
    left = residual_levels(calm.residuals)
    sigma = np.where(left > 0.0, left, calm.sigma)
    return replace(calm, sigma=sigma, noise=replace(calm.noise, white=sigma), purpose="replay")


def _fits(tempered: MultipleShooting, begun: Iterable[Model], dataset: Dataset) -> Iterator[Fit]:
    """Fits that end, from each beginning."""
    for model in begun:
        try:
            found = tempered.fit(model, dataset)
        except OedSysidError:  # it diverges, or what is left is too little
            continue
        if np.isfinite(found.cost):
            yield found


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
        kept = [index for index in range(len(parts)) if index != out]
        model = refit(kept, Dataset(tuple(parts[index] for index in kept)))
        squares = np.inf
        if model is not None:
            squares = np.nanmean((rms(whole_runs(model, Dataset((record,)), noise)) / noise) ** 2)
        errors.append(0.5 * np.log(squares))
    return np.array(errors)
