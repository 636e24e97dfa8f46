r"""Pictures of estimators: values against time, starts of a multistart, one against the others.

The waterfall shows how many starts found the optimum, and what the others found. Starts are
sorted by their objective

.. math:: J_i = -2 \log L_i - 2 \log \pi(p_i), \qquad \Delta_i = J_i - \min_j J_j

(twice the negative log-likelihood, with priors). Starts that found the same optimum lie on a
plateau. Many on the lowest one: it is likely the global optimum. One alone: search on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from oed_sysid.baselines.benchmark import Benchmark, Row, logarithms_of_ratios
from oed_sysid.baselines.contest import OURS, OURS_DISTURBED, UNITS
from oed_sysid.errors import DataError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multistart import SAME_OPTIMUM
from oed_sysid.results import style as draw
from oed_sysid.runtime.display import TWO_SIDED_95, interval


def plot_history(
    times: np.ndarray,
    values: np.ndarray,
    stds: np.ndarray | None = None,
    *,
    name: str = "",
    unit: str = "",
    reference: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot one parameter against time, with its 95 % band.

    Parameters
    ----------
    times, values : ndarray (n,)
        When, s, and what was estimated then; NaN leaves a gap.
    stds : ndarray (n,), optional
        Standard errors.
    name, unit : str
        For the label of the axis.
    reference : float, optional
        A known or published value, drawn in black.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(6.4, 2.6))
    look = draw.model_style(0)
    band = np.zeros(len(values)) if stds is None else TWO_SIDED_95 * np.asarray(stds)
    if stds is not None:
        low, high = values - band, values + band
        ax.fill_between(times, low, high, color=look.colour, alpha=0.25, lw=0, label="95 %")
    ax.plot(times, values, color=look.colour, lw=1.5, label="estimate")
    if reference is not None:
        ax.axhline(reference, color=draw.TRUTH, lw=1.0, ls=":", label="reference")
    # The later half with its band is shown; early estimates may leave the picture.
    late, half = values[len(values) // 2 :], np.nan_to_num(band, posinf=0.0)[len(values) // 2 :]
    known = [] if reference is None else [reference]
    last = interval(float(values[-1]), float(band[-1]))
    return draw.done(
        ax,
        f"{name or 'estimate'} at {times[-1]:.4g} s: {last} {unit}".rstrip() + ".",
        ylim=draw.span([*(late - half), *(late + half), *known], 0.4),
        ylabel=f"{draw.symbol_of(name)} [{unit or '-'}]" if name else "",
    )


def plot_waterfall(result: Fit, ax: Axes | None = None) -> Axes:
    """Sorted objectives of all starts above the best.

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
    attempts = result.attempts
    if attempts is None:
        raise DataError(
            f"The fit by {result.estimator!r} holds no starts. Make it with "
            "Multistart(estimator, n_starts=20).fit(model, dataset) of oed_sysid.likelihood."
        )
    values = np.where(np.isfinite(attempts.objectives), attempts.objectives, np.inf)
    ax = draw.new_axes(ax)
    if not np.isfinite(values).any():
        return draw.done(ax, title="no start led to a finite objective")
    above = values - values.min()
    order = np.argsort(above, kind="stable")
    places, finite = np.argsort(order) + 1, np.isfinite(above)
    good, other = draw.model_style(1), draw.model_style(0)
    ax.set_yscale("symlog", linthresh=SAME_OPTIMUM, linscale=0.4)
    ax.axhspan(-0.5 * SAME_OPTIMUM, SAME_OPTIMUM, color=good.colour, alpha=0.12, linewidth=0)
    ax.plot(places[order], above[order], color=draw.NEUTRAL, linewidth=1.0, zorder=1)
    lowest, converged = above < SAME_OPTIMUM, attempts.converged
    for chosen, marker, colour, fill, words in (
        (lowest & converged, "o", good.colour, good.colour, "the best optimum"),
        (finite & ~lowest & converged, "o", other.colour, "white", "other optima"),
        (finite & ~converged, "x", "0.25", "0.25", "did not converge"),
    ):
        if chosen.any():
            ax.plot(places[chosen], above[chosen], marker, ms=6, color=colour, mfc=fill,
                    label=words)  # fmt: skip
    if finite[0]:
        ax.plot(places[0], above[0], "o", ms=12, mfc="none", color=draw.TRUTH,
                label="the model's own values")  # fmt: skip
    lost = int((~finite).sum())
    title = f"{attempts.arrived} of {len(above)} starts found the best optimum"
    title += f"; {lost} diverged" if lost else ""
    ax.set_title(title, loc="left")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    top = max(10.0 * SAME_OPTIMUM, float(above[finite].max()))
    return draw.done(
        ax, f"{title}.", legend={"loc": "best"}, xlabel="start, sorted",
        ylabel="objective above the best, $-2\\,\\Delta\\log L$ [-]",
        xlim=(0.5, len(above) + 0.5), ylim=(-0.5 * SAME_OPTIMUM, 3.0 * top),
    )  # fmt: skip


# -- the benchmark ---------------------------------------------------------------------------

MARKERS = ("o", "s", "^", "D", "v", "P")


def plot_errors(rows: Sequence[Row], *, ax: Axes | None = None) -> Axes:
    """Plot the error of each estimator on one problem, one mark per noise level.

    The error is that of the parameters which the data determine; the short
    vertical lines are what an unbiased estimator can reach (Cramér-Rao), in the
    colour of their noise level. A hollow mark says that some runs did not
    converge. Marks at the right edge lie beyond it. Estimators that cannot
    treat the problem are left out.

    Parameters
    ----------
    rows : sequence of Row
        Of one problem and sampling.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax)
    levels: dict[float, list[Row]] = {}
    errors: dict[str, list[float]] = {}
    for row in rows:
        if row.noise > 0 and not row.refused:
            levels.setdefault(row.noise, []).append(row)
            errors.setdefault(row.estimator, []).append(np.log(max(row.rmse_determined, 1e-9)))
    names = sorted(errors, key=lambda name: float(np.mean(errors[name])))  # the best on top
    for number, level in enumerate(sorted(levels)):
        look = {"color": draw.model_style(number).colour, "marker": MARKERS[number % len(MARKERS)]}
        shift = (number - (len(levels) - 1) / 2) * 0.22
        places = dict(zip(names, np.arange(len(names)) + shift, strict=True))
        _draw_level(ax, levels[level], places, look)
    if OURS in names:
        place = names.index(OURS)
        ax.axhspan(place - 0.45, place + 0.45, color=draw.NEUTRAL, alpha=0.18, lw=0)
    draw.decades(ax, "x", (1.0,))
    ax.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    words = "error of determined parameters [%]"
    said = f"{names[0].replace('_', ' ')} errs least." if names else "No estimator ran."
    return draw.done(ax, said, ylim=(len(names) - 0.4, -0.6), xlabel=words)


def _draw_level(
    ax: Axes, rows: Sequence[Row], places: Mapping[str, float], look: dict[str, Any]
) -> None:
    """Draw errors at one noise level: a mark per estimator, and what can be reached at best."""
    ax.axvline(100.0 * rows[0].bound, color=look["color"], lw=1.0, alpha=0.6, linestyle=":")
    for row in rows:
        error = np.clip(100.0 * row.rmse_determined, 1e-2, 1e4)  # beyond: at the edge
        fill = "none" if row.n_failed else look["color"]
        ax.plot(error, places[row.estimator], ms=5.5, mfc=fill, clip_on=False, **look)
    # The legend shows full marks, whichever estimator comes first.
    ax.plot([], [], ls="", label=f"noise {rows[0].noise:g} {UNITS[rows[0].noise_unit]}", **look)


def plot_comparison(
    ratios: np.ndarray, estimators: Sequence[str], worlds: Sequence[str], *, ax: Axes | None = None
) -> Axes:
    """Plot how much larger the error of each estimator is, by what acts on the records.

    Colours stand for the logarithm of the ratio; beyond a factor of ten they no longer change.
    What cannot be treated, or was not run, is left blank.

    Parameters
    ----------
    ratios : ndarray (n_estimators, n_worlds)
        Error over that of the estimator that all are compared with; NaN where there is none.
    estimators, worlds : sequence of str
        Their names.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(2.6 + 0.95 * len(worlds), 0.8 + 0.3 * len(estimators)))
    powers = np.log10(np.ma.masked_invalid(ratios))
    ax.imshow(powers, cmap=draw.DIVERGING, vmin=-1, vmax=1, aspect="auto")
    for (i, j), ratio in np.ndenumerate(ratios):
        if np.isfinite(ratio):
            dark = abs(np.log10(ratio)) > 0.7  # colours on which white is read better
            text = f"{ratio:.2f}" if ratio < 10 else f"{ratio:.0f}"
            ax.text(j, i, text, ha="center", va="center", color="white" if dark else "black")
    ax.set_yticks(range(len(estimators)), estimators)
    ax.set_xticks(range(len(worlds)), worlds)
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    return draw.say(ax, "error of the determined parameters over that of the default fit")


def _against(rows: Sequence[Row], names: Sequence[str], worlds: Sequence[str]) -> np.ndarray:
    """Geometric means, over settings, of errors over those of the first of the estimators."""
    runs = {(row.setting, row.estimator): row for row in rows if not row.refused}
    first = next((name for name in (OURS_DISTURBED, OURS) if name in names), names[0])
    logs: dict[tuple[str, str], list[float]] = {}
    for (setting, name), row in runs.items():
        if own := runs.get((setting, first)):
            of_setting = np.median(logarithms_of_ratios(row.by_seed, own.by_seed))
            logs.setdefault((name, row.world), []).append(float(of_setting))
    return np.array(
        [[np.exp(np.mean(logs.get((name, world), [np.nan]))) for world in worlds] for name in names]
    )


def figure_benchmark(result: Benchmark) -> Figure:
    """All problems of a benchmark, one panel each; see :func:`plot_errors`.

    Where there are several worlds, one comparison of them; see :func:`plot_comparison`.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    if len(worlds := list(dict.fromkeys(row.world for row in result.rows))) > 1:
        names = list(dict.fromkeys(row.estimator for row in result.rows if not row.refused))
        ax = plot_comparison(_against(result.rows, names, worlds), names, worlds)
        return cast(Figure, ax.figure)
    titled = groupby(result.rows, key=lambda row: (row.problem, row.sampling))
    groups = [(title, list(group)) for title, group in titled]
    figure, axes = draw.panels(len(groups), 2, (5.6, 3.4))
    for ax, ((problem, sampling), rows) in zip(axes, groups, strict=True):
        plot_errors(rows, ax=ax)
        rare = "" if sampling == 1 else f", {sampling} times rarer samples"
        ax.set_title(problem.replace("_", " ") + rare)
    handles, labels = axes[0].get_legend_handles_labels()
    note = Line2D([], [], marker="o", ls="", color=draw.NEUTRAL, mfc="none")
    bound = Line2D([], [], ls=":", color=draw.NEUTRAL)
    figure.legend(
        [*handles, note, bound],
        [*labels, "some runs did not converge", "Cramér-Rao bound"],
        loc="outside upper center", ncols=len(labels) + 2, frameon=False, fontsize=9,
    )  # fmt: skip
    return figure
