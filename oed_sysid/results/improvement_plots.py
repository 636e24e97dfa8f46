"""Pictures of a search for missing physics: candidates, groups, and the fall of the error."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullFormatter

from oed_sysid.evidence.improvement import Improvement
from oed_sysid.evidence.locate import GROUP_WIDTH, Located
from oed_sysid.evidence.rank import Ranking
from oed_sysid.results.style import (
    COLOURS,
    NEUTRAL,
    TRUTH,
    clean,
    new_axes,
    new_figure,
    say,
    spread_legend,
)

_BEST, _GROUP = COLOURS[1], COLOURS[5]


def plot_ranking(ranking: Ranking, *, n_shown: int = 12, ax: Axes | None = None) -> Axes:
    """Plot the log-likelihood gain of each candidate: quick score, and gain after a refit.

    Bars are the gain in twice the log-likelihood after all parameters were
    estimated again with the candidate; candidates that were not refitted show
    their score only. The strokes are the gain that chance rarely exceeds, however
    many candidates there are; hatched bars cannot be told from the best.

    Parameters
    ----------
    ranking : Ranking
        Of one round.
    n_shown : int
        How many candidates.
    ax : Axes, optional
        Where to draw.
    """
    names = ranking.order[:n_shown]
    ax = new_axes(ax, size=(7.2, 1.3 + 0.3 * len(names)))
    rows = np.arange(len(names))[::-1]
    score = {one.effect.name: one.statistic for one in ranking.scores}
    gain = {refit.name: refit.gain for refit in ranking.refits}
    group = [refit.name for refit in ranking.group()]
    for name, row in zip(names, rows, strict=True):
        if name in gain:
            alike = name in group
            colour = _BEST if name == group[0] else _GROUP if alike else "0.8"
            ax.barh(
                row, max(gain[name], 0.0), height=0.62, color=colour, edgecolor="0.25", lw=0.6,
                hatch="///" if alike and name != group[0] else None,
            )  # fmt: skip
        ax.plot(score[name], row, "D", ms=4.5, mfc="white", mec=TRUTH, zorder=3)
    for refit in ranking.refits:
        if refit.name in names:
            row, needed = rows[names.index(refit.name)], ranking.needed(refit)
            ax.plot([needed, needed], [row - 0.42, row + 0.42], color=TRUTH, lw=1.8, zorder=4)
    ax.set_yticks(rows, [name.replace("_", " ") for name in names])
    largest = max([*gain.values(), *(score[name] for name in names), 1.0])
    _readable_scale(ax, largest)
    ax.set(xlabel="log-likelihood gain [-]")
    clean(ax)
    ax.grid(False, axis="y")
    _explain_bars(ax, alike=len(group) > 1)
    if not ranking.refits:
        return say(ax, "No candidate was worth a refit.")
    best = ranking.refits[0]
    return say(
        ax,
        f"{best.name} has the largest log-likelihood gain, {best.gain:.4g}; "
        f"{ranking.needed(best):.3g} are needed.",
    )


def _explain_bars(ax: Axes, *, alike: bool) -> None:
    """Legend of the bars of a ranking; ``alike`` where some cannot be told from the best."""
    rest = Patch(fc=_GROUP, ec="0.25", hatch="///", label="cannot be told from the best")
    handles = [
        Patch(fc=_BEST, ec="0.25", label="best after refit"),
        *([rest] if alike else []),
        Patch(fc="0.8", ec="0.25", label="other refits"),
        ax.plot([], [], "D", ms=4.5, mfc="white", mec=TRUTH, label="score before refit")[0],
        ax.plot([], [], "|", ms=11, mew=1.8, color=TRUTH, label="needed for a claim")[0],
    ]
    ax.legend(
        handles=handles, frameon=False, fontsize=8.5, ncols=3, loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
    )  # fmt: skip


def plot_error_fall(improvement: Improvement, *, ax: Axes | None = None) -> Axes:
    """Plot the prediction error after each step, on training and validation records.

    Errors are over whole records, with nothing fitted but initial states. One
    is the error that a right model would have; the grey band is within five
    per cent of it.

    Parameters
    ----------
    improvement : Improvement
        The search.
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax, size=(6.4, 3.6))
    steps = improvement.steps
    places = np.arange(len(steps) + 1)
    words = ["nominal", *(f"+ {step.added.replace('_', ' ')}" for step in steps)]
    train = [improvement.base_error["train"], *(step.train_error for step in steps)]
    test = [improvement.base_error["test"], *(step.test_error for step in steps)]
    ax.axhspan(0.95, 1.05, color=NEUTRAL, alpha=0.3, lw=0)
    ax.axhline(1.0, color=TRUTH, lw=0.9)
    ax.plot(
        places, train, "s--", color=NEUTRAL, mfc="white", lw=1.2, ms=7, label="training records"
    )
    if np.isfinite(test).any():
        ax.plot(places, test, "o-", color=_BEST, lw=1.8, ms=7, label="validation records")
    shown = test if np.isfinite(test).any() else train
    for place, value in zip(places, shown, strict=True):
        if np.isfinite(value):
            ax.annotate(
                f"{value:.3g}", (place, value), xytext=(7, 7), textcoords="offset points",
                fontsize=9,
            )  # fmt: skip
    values = np.array([*train, *test])
    finite = values[np.isfinite(values)]
    if finite.size and finite.max() > 8.0:
        ax.set_yscale("log")
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter(NullFormatter())
    else:
        ax.set_ylim(0.0, 1.15 * max(finite.max(initial=1.0), 1.2))
    ax.set_xticks(places, words, rotation=0 if len(places) < 4 else 20)
    ax.set_xlim(-0.4, len(steps) + 0.5)
    ax.set(ylabel="prediction error [noise]")
    clean(ax)
    ax.grid(False, axis="x")
    spread_legend(ax, loc="upper right")
    kind = "validation" if np.isfinite(test).any() else "training"
    return say(
        ax,
        f"The error on the {kind} records goes from {shown[0]:.3g} to {shown[-1]:.3g} times the "
        f"noise with {', '.join(step.added for step in steps) or 'nothing added'}.",
    )


def plot_located(located: Located, *, n_shown: int = 14, ax: Axes | None = None) -> Axes:
    """Plot where a model fails: how far each place of the signal chain is behind the best.

    A disturbance at each place explains what is left, some better than others. Bars are what a
    place falls short of the best one, in twice the log-likelihood; the last row is no disturbance
    at all. Within the grey band records cannot tell a place from the best (hatched).

    Parameters
    ----------
    located : Located
        The finding.
    n_shown : int
        How many places.
    ax : Axes, optional
        Where to draw.
    """
    top = max([*located.gains.values(), 0.0])
    places = [(place.name, top - located.gains[place.name]) for place in located.places]
    places = [*places[:n_shown], ("no disturbance", top)]
    ax = new_axes(ax, size=(6.4, 1.2 + 0.3 * len(places)))
    rows = np.arange(len(places))[::-1]
    ax.axvspan(
        0.0, GROUP_WIDTH, color=NEUTRAL, alpha=0.3, lw=0, label="cannot be told from the best"
    )
    for (name, behind), row in zip(places, rows, strict=True):
        alike = name in located.group and name != located.best
        ax.barh(
            row, behind, height=0.62, color="#f0b48a" if alike else "0.8", edgecolor="0.25", lw=0.6,
            hatch="///" if alike else None,
        )  # fmt: skip
        if name == located.best:
            ax.plot(0.0, row, "D", ms=8, color=COLOURS[0], mec="0.25", clip_on=False, zorder=4)
            words = f"  best: {top:,.0f} above no disturbance"
            ax.annotate(words, (0.0, row), xytext=(6, 0), textcoords="offset points",
                        va="center", fontsize=8.5)  # fmt: skip
    _readable_scale(ax, max([behind for _, behind in places], default=1.0))
    ax.set_yticks(rows, [name for name, _ in places])
    ax.set(xlabel="behind the best place: twice the log-likelihood [-]")
    clean(ax)
    ax.grid(False, axis="y")
    spread_legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return say(ax, located.verdict)


def figure_diagnosis(located: Located, ranking: Ranking) -> Figure:
    """Where a model fails, above which candidates would explain it."""
    n_places, n_names = min(len(located.places), 14), min(len(ranking.order), 12)
    heights = (1.4 + 0.28 * n_places, 2.0 + 0.3 * n_names)
    figure, axes = new_figure(2, 1, size=(7.4, sum(heights)), height_ratios=heights)
    plot_located(located, ax=axes[0, 0])
    plot_ranking(ranking, ax=axes[1, 0])
    return figure


def _readable_scale(ax: Axes, largest: float) -> None:
    """Make the axis logarithmic beyond 30 where the best stands out by orders of magnitude."""
    if largest > 300:
        ax.set_xscale("symlog", linthresh=30)
        ax.set_xticks([0, 10, 30, *(10**k for k in range(2, int(np.log10(largest)) + 1))])
        ax.xaxis.set_major_formatter("{x:g}")
        ax.minorticks_off()
    ax.set_xlim(left=0.0)
