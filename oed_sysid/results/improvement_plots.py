"""Pictures of a search for missing physics: candidates, the fall of the error, residual forces.

Of a force that a model lacks, what is drawn is the part that the free parameters could not absorb,
not the missing force itself; a candidate's signature has been through the same projection and may
be compared with it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError
from oed_sysid.errors import located as located_names
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.evidence.locate import Located
from oed_sysid.evidence.rank import Ranking
from oed_sysid.information.shifts import GROUP_WIDTH
from oed_sysid.likelihood.information import effective_sample_size
from oed_sysid.results import style as draw
from oed_sysid.runtime.display import TWO_SIDED_95

# Colour, hatch and words for a candidate that was refitted.
_BEST = draw.COLOURS[1], "", "best after refit"
_ALIKE = draw.COLOURS[5], "///", "cannot be told from the best"
_OTHER = "0.8", "", "other refits"


def plot_ranking(ranking: Ranking, *, n_shown: int = 12, ax: Axes | None = None) -> Axes:
    """Plot the likelihood-ratio statistic of each candidate: quick score, and gain after a refit.

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

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    names = ranking.order[:n_shown]
    ax, rows = draw.row_axes(ax, [name.replace("_", " ") for name in names], 7.2)
    row_of = dict(zip(names, rows, strict=True))
    scores = {one.effect.name: one.statistic for one in ranking.scores}
    group = [refit.name for refit in ranking.group()]
    looks = dict.fromkeys(group, _ALIKE) | dict.fromkeys(group[:1], _BEST)
    for one in ranking.refits:
        if (row := row_of.get(one.name)) is not None:
            colour, hatch, words = looks.get(one.name, _OTHER)
            draw.bars(ax, row, max(one.gain, 0.0), colour, hatch, label=words)
            ax.plot(one.needed, row, "|", ms=18, mew=1.8, color=draw.TRUTH, zorder=4,
                    label="needed for a claim")  # fmt: skip
    shown = [scores[name] for name in names]
    ax.plot(shown, rows, "D", ms=4.5, mfc="white", mec=draw.TRUTH, zorder=3,
            label="score before refit")  # fmt: skip
    _readable_scale(ax, max([*(refit.gain for refit in ranking.refits), *shown, 1.0]))
    said = "No candidate was worth a refit."
    if ranking.refits:
        best = ranking.refits[0]
        said = (
            f"{best.name} has the largest likelihood-ratio statistic, {best.gain:.4g}; "
            f"{best.needed:.3g} are needed."
        )
    draw.legend_above(ax, fontsize=8.5, markerscale=0.6)
    return draw.done(ax, said, grid="x", xlabel="likelihood-ratio statistic [-]")


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

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(6.4, 3.6))
    steps = improvement.steps
    places = np.arange(len(steps) + 1)
    words = ["nominal", *(f"+ {step.added.replace('_', ' ')}" for step in steps)]
    train = [improvement.base_error["train"], *(step.train_error for step in steps)]
    test = [improvement.base_error["test"], *(step.test_error for step in steps)]
    ax.axhspan(0.95, 1.05, color=draw.NEUTRAL, alpha=0.3, lw=0)
    ax.axhline(1.0, color=draw.TRUTH, lw=0.9)
    ax.plot(places, train, "s--", color=draw.NEUTRAL, mfc="white", lw=1.2, ms=7,
            label="training records")  # fmt: skip
    kind, shown = "training", train
    if np.isfinite(test).any():
        kind, shown = "validation", test
        ax.plot(places, test, "o-", color=draw.COLOURS[1], lw=1.8, ms=7, label="validation records")
    for place in np.flatnonzero(np.isfinite(shown)):
        ax.annotate(f"{shown[place]:.3g}", (place, shown[place]), xytext=(7, 7),
                    textcoords="offset points", fontsize=9)  # fmt: skip
    largest = max(filter(np.isfinite, (*train, *test)), default=1.0)
    if not draw.errors_axis(ax, largest):
        ax.set_ylim(0.0, 1.15 * max(largest, 1.2))
    ax.set_xticks(places, words, rotation=0 if len(places) < 4 else 20)
    return draw.done(
        ax,
        f"The error on the {kind} records goes from {shown[0]:.3g} to {shown[-1]:.3g} times the "
        f"noise with {', '.join(step.added for step in steps) or 'nothing added'}.",
        grid="y", legend={"loc": "upper right"}, ylabel="prediction error [noise]",
        xlim=(-0.4, len(steps) + 0.5),
    )  # fmt: skip


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

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    top = max([*located.gains.values(), 0.0])
    places = [(place.name, top - located.gains[place.name]) for place in located.places]
    places = [*places[:n_shown], ("no disturbance", top)]
    ax, rows = draw.row_axes(ax, [name for name, _ in places], 6.4)
    ax.axvspan(
        0.0, GROUP_WIDTH, color=draw.NEUTRAL, alpha=0.3, lw=0, label="cannot be told from the best"
    )
    for (name, behind), row in zip(places, rows, strict=True):
        alike = name in located.group and name != located.best
        draw.bars(ax, row, behind, *("#f0b48a", "///") if alike else ("0.8",))
        if name == located.best:
            ax.plot(0.0, row, "D", ms=8, color=draw.COLOURS[0], mec="0.25", clip_on=False, zorder=4)
            words = f"  best: {top:,.0f} above no disturbance"
            ax.annotate(words, (0.0, row), xytext=(6, 0), textcoords="offset points",
                        va="center", fontsize=8.5)  # fmt: skip
    _readable_scale(ax, max([behind for _, behind in places], default=1.0))
    words = "behind the best place: twice the log-likelihood [-]"
    return draw.done(ax, located.verdict, grid="x", legend=3, xlabel=words)


def figure_diagnosis(located: Located, ranking: Ranking) -> Figure:
    """Where a model fails, above which candidates would explain it.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    n_places, n_names = min(len(located.places), 14), min(len(ranking.order), 12)
    heights = (1.4 + 0.28 * n_places, 2.0 + 0.3 * n_names)
    figure, axes = draw.new_figure(2, 1, size=(7.4, sum(heights)), height_ratios=heights)
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


def plot_residual_force(
    located: Located, equation: str, *, record: int = 0, ax: Axes | None = None
) -> Axes:
    """Plot the smoothed residual force of one equation over time, with its 95 % band.

    Signatures of candidates, where the finding holds them, are drawn as lines.

    Parameters
    ----------
    located : Located
        Where the model fails.
    equation : str
        Name of the equation, for instance ``"Z"``.
    record : int
        Which record.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    column = _column(located, equation)
    ax = draw.new_axes(ax, size=(7.6, 3.0))
    series = located.forces[record]
    mean, half = series.values[:, column], TWO_SIDED_95 * series.std[:, column]
    draw.zero(ax)
    ax.fill_between(series.times, mean - half, mean + half, color="0.75", alpha=0.6, lw=0)
    ax.plot(series.times, mean, color="0.25", lw=1.2, label="seen in the residuals (95 %)")
    for number, (name, parts) in enumerate(located.signatures.items(), start=1):
        ax.plot(series.times, parts[record][:, column], **draw.model_style(number).line, lw=1.4,
                label=f"expected of {name.replace('_', ' ')}")  # fmt: skip
    seen = np.isfinite(mean) & (np.abs(mean) > half)
    return draw.done(
        ax,
        f"Record {record + 1}: residual {equation} up to {np.nanmax(np.abs(mean)):.2g} "
        f"{_unit(located, equation)}, beyond its 95 % band for {np.mean(seen):.0%} of the time.",
        legend={"loc": "lower right", "bbox_to_anchor": (1.0, 0.98), "borderaxespad": 0.0,
                "ncols": 3, "fontsize": 8},
        xlabel="time $t$ [s]", ylabel=f"residual {_name(located, equation)}",
    )  # fmt: skip


def plot_force_against(
    located: Located, equation: str, dataset: Dataset, signal: str, *, ax: Axes | None = None
) -> Axes:
    """Plot the residual force of one equation against a measured signal or command.

    Dots are all samples of all records; the points with whiskers are means
    over slices of the signal with 95 % intervals; that a smoothed force changes
    slowly is taken into account.

    Parameters
    ----------
    located : Located
        Where the model fails on the records.
    equation : str
        Name of the equation.
    dataset : Dataset
        These records.
    signal : str
        Output or input.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(4.4, 3.2))
    channel = next(one for one in dataset.channels.all if one.name == signal)
    where = np.concatenate([draw.signal_of(record, channel) for record in dataset])
    x, y, (centres, means, half) = force_against(located, equation, where)
    draw.zero(ax)
    ax.plot(x, y, ".", color=draw.DATA, ms=1.5, alpha=0.35, rasterized=True)
    ax.errorbar(centres, means, yerr=half, fmt="o", ms=5, color=draw.COLOURS[1], capsize=3, lw=1.4)
    clear = int(np.sum(np.abs(means) > half))
    return draw.done(
        ax, f"Residual {equation} over {signal}: {clear} of {len(means)} means differ from zero.",
        xlabel=draw.label(channel), ylabel=f"residual {_name(located, equation)}",
    )  # fmt: skip


Means = tuple[np.ndarray, np.ndarray, np.ndarray]


def force_against(
    located: Located, equation: str, where: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Means]:
    """Return a signal and a residual force where both are known, and its :func:`slice_means`.

    Parameters
    ----------
    located : Located
        Where the model fails.
    equation : str
        Name of the equation.
    where : ndarray (n_samples,)
        The signal at all times of all records.
    """
    column = _column(located, equation)
    force = np.concatenate([series.values[:, column] for series in located.forces])
    seen = np.isfinite(where) & np.isfinite(force)
    independent = sum(effective_sample_size(s.values[:, column]) for s in located.forces)
    x, y = where[seen], force[seen]
    return x, y, slice_means(x, y, independent / force.size)


def figure_force(located: Located, equation: str, dataset: Dataset) -> Figure:
    """Residual force of one equation in every record over time, and against every signal.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    signals = [
        name
        for name in (*dataset.channels.output_names, *dataset.channels.input_names)
        if any(name not in (*one.constant_channels, *one.missing_outputs) for one in dataset)
    ]
    records = list(range(min(len(dataset), 4)))
    columns = min(len(signals), 4)
    rows = -(-len(signals) // columns)
    heights = [1.7 * len(records), 2.4 * rows]
    figure, _ = draw.new_figure(1, 1, size=(11.0, sum(heights)))
    figure.clear()
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=heights).flat
    over_time = upper.subplots(len(records), 1, squeeze=False)[:, 0]
    for ax, record in zip(over_time, records, strict=True):
        plot_residual_force(located, equation, record=record, ax=ax)
        ax.set_title(dataset.names[record], fontsize=9.5, loc="left")
        if record != records[-1]:
            ax.set_xlabel("")
        if record:
            ax.get_legend().remove()
    against = lower.subplots(rows, columns, squeeze=False, sharey=True)
    for ax, name in zip(against.flat, signals, strict=False):
        plot_force_against(located, equation, dataset, name, ax=ax)
    for ax in against[:, 1:].flat:
        ax.set_ylabel("")
    for ax in against.flat[len(signals) :]:
        ax.axis("off")
    return figure


def slice_means(x: np.ndarray, y: np.ndarray, share: float, n_slices: int = 12) -> Means:
    """Means of ``y`` in slices of ``x`` that hold equally many samples.

    Parameters
    ----------
    x, y : ndarray (n_samples,)
        Signal and force.
    share : float
        Share of the samples that count as independent.
    n_slices : int
        At most; ties of the signal leave fewer.

    Returns
    -------
    centres, means, half : ndarray (n_slices,)
        Mean of ``x``, mean of ``y`` and half of its 95 % interval.

    Examples
    --------
    >>> x = np.linspace(0.0, 1.0, 240)
    >>> centres, means, half = slice_means(x, 2.0 * x, 1.0)
    >>> print(centres.size, np.abs(means - 2.0 * centres).max().round(12))
    12 0.0
    """
    if not x.size:
        return x, y, y
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, n_slices + 1)))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    parts = [one for one in (index == k for k in range(max(len(edges) - 1, 1))) if one.sum() >= 5]
    centres, means = (np.array([values[one].mean() for one in parts]) for values in (x, y))
    errors = [y[one].std() / np.sqrt(max(share * one.sum(), 1.0)) for one in parts]
    return centres, means, TWO_SIDED_95 * np.array(errors)


def _column(located: Located, equation: str) -> int:
    return located_names(
        DataError,
        "The finding has no residual force of the equation",
        [equation],
        located.force_names,
    )[0]


def _unit(located: Located, equation: str) -> str:
    units: Mapping[str, str] = {place.name: place.unit for place in located.places}
    return units.get(f"force {equation}", "") or "-"


def _name(located: Located, equation: str) -> str:
    return f"{draw.symbol_of(equation)} [{_unit(located, equation)}]"
