r"""How much of every output a fitted model explains on its own, and whether that is enough.

.. math::
    s^2 = \frac{\sum_k (y_k - \hat y_k)^2}{\sum_k (y_k - \bar y)^2}, \qquad
    s_h^2 = \frac{\sum_k (\Delta_h y_k - \Delta_h \hat y_k)^2}{\sum_k (\Delta_h y_k)^2}

with the model run on its own, :math:`\hat y`. A constant has :math:`s = 1`. Random forces make
a heading or a position drift away although the model answers rightly to every command; there the
increments over :math:`h` samples count too, and the smallest of all shares is taken.

Estimated noise, of sensors or of forces, can absorb whatever a model does not explain, so that
the misfit is one and the iterations converge. :func:`grave` says so.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed_sysid.likelihood.estimate import Estimate
from oed_sysid.likelihood.judgement import BARELY, MOVES, Concern
from oed_sysid.likelihood.noise_levels import white_levels

# Concerns with which a fit may converge and must still not be used.
GRAVE = ("absorbed", "degenerate", "few_samples")
# Lengths of increments as shares of a record; fewer samples than FEWEST say nothing.
HORIZONS, FEWEST = (0.02, 0.05, 0.125), 10


def unexplained(fit: Estimate) -> dict[str, float]:
    """Share of every output's movement that the model on its own leaves, by name.

    Parameters
    ----------
    fit : Estimate
        With or without random forces.

    Returns
    -------
    dict
        Root of the smallest ratio of squares: 0 where everything is explained, 1 where a
        constant is as good; NaN where nothing, or next to nothing, was measured.
    """
    found = {}
    for column, name in enumerate(fit.model.output_names):
        pairs = []
        for record, part in zip(fit.dataset, fit.predictions, strict=True):
            seen = np.isfinite(record.outputs[:, column])
            if seen.any():
                pairs.append((record.outputs[seen, column], part[seen, column]))
        shares = [_share([(y - y.mean(), y - model) for y, model in pairs])]
        for horizon in HORIZONS if fit.innovations is not None else ():
            moved = []
            for y, model in pairs:
                h = max(int(horizon * len(y)), 1)
                moved.append((y[h:] - y[:-h], (y - model)[h:] - (y - model)[:-h]))
            shares.append(_share(moved))
        few = sum(len(y) for y, _ in pairs) < FEWEST
        found[name] = np.nan if few else float(np.nanmin([*shares, np.inf]))
    return {name: share if np.isfinite(share) else np.nan for name, share in found.items()}


def _share(pairs: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Root of the squares that are left over the squares that were there."""
    own = sum(float(signal @ signal) for signal, _ in pairs)
    with np.errstate(over="ignore", invalid="ignore"):
        left = sum(float(rest @ rest) for _, rest in pairs)
    if not own > 0.0:
        return np.nan
    return float(np.sqrt(left / own)) if np.isfinite(left) else np.inf


def grave(fit: Estimate, concerns: Sequence[Concern]) -> tuple[Concern, ...]:
    """What makes a fit useless although it converged: the noise holds what a model should.

    Parameters
    ----------
    fit : Estimate
    concerns : sequence of Concern
        What speaks against it, as :func:`.judgement.judge` finds it.

    Returns
    -------
    tuple of Concern
        ``absorbed``, ``degenerate`` and ``few_samples``; empty where the fit can be used, or
        where its status says already that it cannot.
    """
    if not fit.status.ok:
        return ()
    found = [concern for concern in concerns if concern.kind in GRAVE]
    named = {concern.signal for concern in found}
    shares = {name: share for name, share in unexplained(fit).items() if not np.isnan(share)}
    poor = [name for name, share in shares.items() if share >= BARELY]
    if not poor or not fit.dataset.channels.inputs:
        return tuple(found)
    everything = len(poor) == len(shares)
    moving = _moving(fit)
    what = "random forces hold the rest" if fit.innovations is not None else "the noise is the rest"
    for name in poor:
        if name in named or not (everything or name in moving):
            continue
        found.append(
            Concern(
                "degenerate",
                name,
                "",
                shares[name],
                f"A constant explains {name} as well as the model on its own does (what is left "
                f"is {shares[name]:.3g} times its movement; {what}). Check signs, units and "
                "clocks with `oed-sysid check`, and look for what is missing with improve().",
            )
        )
    return tuple(found)


def _moving(fit: Estimate) -> set[str]:
    """Outputs that move by more than their noise."""
    noise, _ = white_levels(fit.dataset)
    found = set()
    for column, name in enumerate(fit.model.output_names):
        own, count = 0.0, 0
        for record in fit.dataset:
            y = record.outputs[:, column]
            y = y[np.isfinite(y)]
            if len(y):
                own, count = own + float(np.sum((y - y.mean()) ** 2)), count + len(y)
        if count and own > (MOVES * noise[column]) ** 2 * count:
            found.add(name)
    return found
