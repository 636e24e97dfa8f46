r"""Values for runs: replay, simulation and export of a model that lacks physics.

Where process noise holds structure, the fit ``F`` with it tells the derivatives best, and one
without, ``W``, the runs that were measured. In between lies ``B``: the process noise of ``F`` held
at a small share of its level, sensors white as they are granted. Chosen is

====================================================== ==========================================
``F``                                                  where whole runs are as its noise model
                                                       would have left them
``B``                                                  else, where its whole-run error is within
                                                       twice that of ``W``
``W``                                                  else
====================================================== ==========================================

and never what is off further than ``F`` over the records that were fitted.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from oed_sysid.likelihood.departures import TWOFOLD
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import solve_filtered
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_model import Levels
from oed_sysid.likelihood.summary import Procedure, summarise_filtered

# Share of the level of process noise that is left to it; chosen on cases with physics hidden, no
# more than that, as is the whole-run error over that of a fit without from which none is (twofold).
WEAK = 0.1


def replayed(fit: Fit) -> Fit:
    """The fit whose values are for runs: replay on records, simulation, export.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    Fit
        The same where it has no process noise or whole runs are as that would have left them; else
        one whose :attr:`~oed_sysid.likelihood.fit.Fit.purpose` is ``"replay"``: derivatives, errors
        and the search for what is missing keep ``fit``.

    Examples
    --------
    Of a fit with process noise, for runs without measurements::

        replayed(fit).save("replay.json")
    """
    if not fit.whole_runs.took_the_work:
        return fit
    noise, own = fit.whole_runs.each("noise"), fit.whole_runs.relative
    estimator = MultipleShooting(disturbances="none")
    begun = fit.model.with_values({n: v for n, v in fit.nominal.items() if n in fit.model.values})
    # Without process noise from its values, and from those of before.
    ends = (estimator.fit(fit.model, fit.dataset, warm=fit), estimator.fit(begun, fit.dataset))
    errors = [(end.whole_runs.size(noise=noise), end) for end in ends if end.status.ok]
    error, chosen = min(errors, key=lambda one: one[0], default=(np.inf, fit))
    if not error < own:
        return fit
    weak = _weak(fit, chosen)
    if weak is not None and weak.whole_runs.size(noise=noise) < min(TWOFOLD * error, own):
        chosen = weak
    return replace(chosen, purpose="replay")


def _weak(fit: Fit, white: Fit) -> Fit | None:
    """The fit with process noise held at a small share of its level; None where it fails."""
    began, noise = time.perf_counter(), fit.noise
    weak = replace(
        noise,
        white=fit.whole_runs.each("noise"),
        colour=np.zeros(len(noise.white)),
        force=WEAK * noise.force,
        seas=tuple(sea.with_levels(WEAK * sea.level) for sea in noise.seas),
    )
    problem = Filtered(white.model, fit.dataset, Levels.of(weak, weak, seas=weak.seas))
    try:
        found = solve_filtered(problem, problem.point(white.initial_states, white.local_values))
        if found.finite is None:
            return None
        label, nothing = f"{fit.estimator}, for replay", np.zeros(len(noise.white), dtype=bool)
        result = summarise_filtered(found, Procedure(label, nothing, found.iterations, began))
    except np.linalg.LinAlgError:
        return None
    return replace(result, nominal=fit.nominal)
