"""Pictures of estimators against each other."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from oed_sysid.baselines.benchmark import OURS, UNITS, Benchmark, Row
from oed_sysid.results.style import NEUTRAL, clean, model_style, new_axes, panels

# Errors beyond these are drawn at the edge, in per cent.
LEAST, MOST = 1e-2, 1e4
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
    """
    ax = new_axes(ax)
    able = [row for row in rows if not row.refused]
    levels = sorted({row.noise for row in able if row.noise > 0})
    names = _order(able)
    for number, level in enumerate(levels):
        colour = model_style(number).colour
        of_level = {row.estimator: row for row in able if row.noise == level}
        bound = next(iter(of_level.values())).bound
        shift = (number - (len(levels) - 1) / 2) * 0.22
        ax.axvline(100.0 * bound, color=colour, lw=1.0, alpha=0.6, linestyle=":")
        for name, row in of_level.items():
            error = np.clip(100.0 * row.rmse_determined, LEAST, MOST)
            ax.plot(
                error, names.index(name) + shift, MARKERS[number % len(MARKERS)], ms=5.5,
                color=colour, mfc="none" if row.n_failed else colour, clip_on=False,
            )  # fmt: skip
        # The legend shows full marks, whichever estimator comes first.
        unit = UNITS[able[0].noise_unit]
        ax.plot(
            [], [], MARKERS[number % len(MARKERS)], color=colour, label=f"noise {level:g} {unit}"
        )
    if OURS in names:
        place = names.index(OURS)
        ax.axhspan(place - 0.45, place + 0.45, color=NEUTRAL, alpha=0.18, lw=0)
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter("{x:g}")
    # Within a decade matplotlib would also label 2, 3, 4 and 6, one over the other.
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set(xlabel="error of determined parameters [%]")
    return clean(ax)


def figure_benchmark(result: Benchmark) -> Figure:
    """All problems of a benchmark, one panel each; see :func:`plot_errors`."""
    groups = [
        (title, list(group))
        for title, group in groupby(result.rows, key=lambda row: (row.problem, row.sampling))
    ]
    figure, axes = panels(len(groups), 2, (5.6, 3.4))
    for ax, ((problem, sampling), rows) in zip(axes, groups, strict=True):
        plot_errors(rows, ax=ax)
        rare = "" if sampling == 1 else f", {sampling} times rarer samples"
        ax.set_title(problem.replace("_", " ") + rare)
    handles, labels = axes[0].get_legend_handles_labels()
    note = Line2D([], [], marker="o", ls="", color=NEUTRAL, mfc="none")
    bound = Line2D([], [], ls=":", color=NEUTRAL)
    figure.legend(
        [*handles, note, bound],
        [*labels, "some runs did not converge", "Cramér-Rao bound"],
        loc="outside upper center", ncols=len(labels) + 2, frameon=False, fontsize=9,
    )  # fmt: skip
    return figure


def _order(rows: Sequence[Row]) -> list[str]:
    """Estimators, the best over all noise levels on top."""
    errors: dict[str, list[float]] = {}
    for row in rows:
        if row.noise > 0:
            errors.setdefault(row.estimator, []).append(np.log(max(row.rmse_determined, 1e-9)))
    return sorted(errors, key=lambda name: float(np.mean(errors[name])))
