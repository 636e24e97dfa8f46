r"""Waterfall of a multistart: how many starts found the optimum, and what the others found.

Starts are sorted by their objective

.. math:: J_i = -2 \log L_i - 2 \log \pi(p_i), \qquad \Delta_i = J_i - \min_j J_j

(twice the negative log-likelihood, with priors). Starts that found the same optimum lie on a
plateau. Many on the lowest one: it is likely the global optimum. One alone: search on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from oed_sysid.errors import DataError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multistart import SAME_OPTIMUM
from oed_sysid.results.style import NEUTRAL, clean, model_style, new_axes, say, spread_legend

# Plateaus above the lowest one that get a number.
MOST_NAMED = 4


def plateaus(objectives: Sequence[float] | np.ndarray) -> list[tuple[int, int]]:
    """First and last position of starts that found the same optimum, in sorted objectives.

    Examples
    --------
    >>> plateaus([0.0, 0.001, 0.01, 5.0, 9.0, 9.001])
    [(0, 2), (3, 3), (4, 5)]
    """
    values = np.asarray(objectives, dtype=float)
    found: list[tuple[int, int]] = []
    for position, value in enumerate(values):
        if not np.isfinite(value):
            break
        # Measured from the plateau's own floor: a slope is no plateau.
        if found and value - values[found[-1][0]] < SAME_OPTIMUM:
            found[-1] = (found[-1][0], position)
        else:
            found.append((position, position))
    return found


def plot_waterfall(result: Fit, ax: Axes | None = None) -> Axes:
    """Sorted objectives of all starts above the best, plateaus marked.

    Parameters
    ----------
    result : Fit
        What :meth:`oed_sysid.likelihood.multistart.Multistart.fit` returned.
    ax : Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes

    Raises
    ------
    DataError
        If the fit was made from one start only.
    """
    extras = result.extras
    if "log_likelihoods" not in extras or "converged" not in extras:
        raise DataError(
            f"The fit by {result.estimator!r} holds no starts. Make it with "
            "Multistart(estimator, n_starts=20).fit(model, dataset) of oed_sysid.likelihood."
        )
    likelihoods = np.asarray(extras["log_likelihoods"], dtype=float)
    objectives = np.asarray(extras.get("objectives", -2.0 * likelihoods), dtype=float)
    converged = np.asarray(extras["converged"], dtype=bool)
    order = np.argsort(np.where(np.isfinite(objectives), objectives, np.inf), kind="stable")
    objectives, converged = objectives[order], converged[order]
    ax = new_axes(ax)
    finite = np.isfinite(objectives)
    if not finite.any():
        ax.set_title("no start led to a finite objective")
        return clean(ax)
    above = objectives - objectives[0]
    places = np.arange(1, len(above) + 1)
    good, other = model_style(1), model_style(0)
    groups = plateaus(above)
    last = groups[0][1]
    top = max(10.0 * SAME_OPTIMUM, float(above[finite].max()))
    ax.set_yscale("symlog", linthresh=SAME_OPTIMUM, linscale=0.4)
    ax.axhspan(-0.5 * SAME_OPTIMUM, SAME_OPTIMUM, color=good.colour, alpha=0.12, linewidth=0)
    ax.plot(places[finite], above[finite], color=NEUTRAL, linewidth=1.0, zorder=1)
    lowest = finite & (places <= last + 1)
    for chosen, style in (
        (lowest & converged, {"marker": "o", "color": good.colour, "label": "the best optimum"}),
        (
            finite & ~lowest & converged,
            {"marker": "o", "color": other.colour, "mfc": "white", "label": "other optima"},
        ),
        (finite & ~converged, {"marker": "x", "color": "0.25", "label": "did not converge"}),
    ):
        if chosen.any():
            ax.plot(places[chosen], above[chosen], linestyle="none", markersize=6, **style)  # type: ignore[arg-type]
    own = int(np.flatnonzero(order == 0)[0])
    if finite[own]:
        ax.plot(
            places[own], above[own], marker="o", markersize=12, mfc="none", color="black",
            linestyle="none", label="the model's own values",
        )  # fmt: skip
    for first, end in [g for g in groups[1:] if g[1] > g[0]][:MOST_NAMED]:
        ax.annotate(
            f"{end - first + 1} starts", (0.5 * (places[first] + places[end]), above[first]),
            xytext=(0, 7), textcoords="offset points", ha="center", fontsize=9, color="0.25",
        )  # fmt: skip
    lost = int((~finite).sum())
    title = f"{last + 1} of {len(above)} starts found the best optimum"
    ax.set_title(title + (f"; {lost} diverged" if lost else ""), loc="left")
    ax.set_xlabel("start, sorted")
    ax.set_ylabel("objective above the best, $-2\\,\\Delta\\log L$ [-]")
    ax.set_xlim(0.5, len(above) + 0.5)
    ax.set_ylim(-0.5 * SAME_OPTIMUM, 3.0 * top)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    spread_legend(ax, loc="best")
    return say(clean(ax), f"{title}{f'; {lost} diverged' if lost else ''}.")
