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
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullFormatter

from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import DataError
from oed_sysid.evidence.claim import GROUP_WIDTH
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.evidence.locate import Located
from oed_sysid.evidence.rank import Ranking
from oed_sysid.likelihood.information import effective_sample_size
from oed_sysid.physics.channels import Input, Output
from oed_sysid.results.style import (
    COLOURS,
    DATA,
    NEUTRAL,
    TRUTH,
    clean,
    label,
    legend_above,
    model_style,
    new_axes,
    new_figure,
    row_axes,
    say,
    shown,
    spread_legend,
    symbol_of,
    zero,
)
from oed_sysid.runtime.display import TWO_SIDED_95

_BEST, _GROUP = COLOURS[1], COLOURS[5]


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
    """
    names = ranking.order[:n_shown]
    ax, rows = row_axes(ax, [name.replace("_", " ") for name in names], 7.2)
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
    largest = max([*gain.values(), *(score[name] for name in names), 1.0])
    _readable_scale(ax, largest)
    ax.set(xlabel="likelihood-ratio statistic [-]")
    clean(ax, grid="x")
    _explain_bars(ax, alike=len(group) > 1)
    if not ranking.refits:
        return say(ax, "No candidate was worth a refit.")
    best = ranking.refits[0]
    return say(
        ax,
        f"{best.name} has the largest likelihood-ratio statistic, {best.gain:.4g}; "
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
    clean(ax, grid="y")
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
    ax, rows = row_axes(ax, [name for name, _ in places], 6.4)
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
    ax.set(xlabel="behind the best place: twice the log-likelihood [-]")
    clean(ax, grid="x")
    legend_above(ax)
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


_N_BINS = 12


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
    """
    column = _column(located, equation)
    ax = new_axes(ax, size=(7.6, 3.0))
    series = located.forces[record]
    mean, half = series.values[:, column], TWO_SIDED_95 * series.std[:, column]
    zero(ax)
    ax.fill_between(series.times, mean - half, mean + half, color="0.75", alpha=0.6, lw=0)
    ax.plot(series.times, mean, color="0.25", lw=1.2, label="seen in the residuals (95 %)")
    for number, (name, parts) in enumerate(located.signatures.items(), start=1):
        look = model_style(number)
        ax.plot(
            series.times, parts[record][:, column], color=look.colour, linestyle=look.dashes,
            lw=1.4, label=f"expected of {name.replace('_', ' ')}",
        )  # fmt: skip
    ax.set(xlabel="time $t$ [s]", ylabel=f"residual {_name(located, equation)}")
    clean(ax)
    legend = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.98), "borderaxespad": 0.0}
    spread_legend(ax, ncols=3, fontsize=8, **legend)
    seen = np.isfinite(mean) & (np.abs(mean) > half)
    return say(
        ax,
        f"Record {record + 1}: residual {equation} up to {np.nanmax(np.abs(mean)):.2g} "
        f"{_unit(located, equation)}, beyond its 95 % band for {np.mean(seen):.0%} of the time.",
    )


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
    """
    column = _column(located, equation)
    ax = new_axes(ax, size=(4.4, 3.2))
    channel = _channel(dataset, signal)
    x = shown(channel, np.concatenate([_signal(record, signal) for record in dataset]))
    y = np.concatenate([series.values[:, column] for series in located.forces])
    seen = np.isfinite(x) & np.isfinite(y)
    x, y = x[seen], y[seen]
    zero(ax)
    ax.plot(x, y, ".", color=DATA, ms=1.5, alpha=0.35, rasterized=True)
    independent = sum(effective_sample_size(s.values[:, column]) for s in located.forces)
    share = independent / sum(len(s.times) for s in located.forces)
    centres, means, half = slice_means(x, y, share)
    ax.errorbar(centres, means, yerr=half, fmt="o", ms=5, color=COLOURS[1], capsize=3, lw=1.4)
    ax.set(xlabel=label(channel), ylabel=f"residual {_name(located, equation)}")
    clear = int(np.sum(np.abs(means) > half))
    return say(
        clean(ax),
        f"Residual {equation} over {signal}: {clear} of {len(means)} means differ from zero.",
    )


def figure_force(located: Located, equation: str, dataset: Dataset) -> Figure:
    """Residual force of one equation in every record over time, and against every signal."""
    signals = [
        name
        for name in (*dataset.channels.output_names, *dataset.channels.input_names)
        if any(_varies(record, name) for record in dataset)
    ]
    records = list(range(min(len(dataset), 4)))
    columns = min(len(signals), 4)
    rows = -(-len(signals) // columns)
    height = 1.7 * len(records) + 2.4 * rows
    figure, _ = new_figure(1, 1, size=(11.0, height))
    figure.clear()
    halves = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.7 * len(records), 2.4 * rows])
    upper, lower = halves[:, 0]
    over_time = upper.subplots(len(records), 1, squeeze=False)[:, 0]
    for ax, record in zip(over_time, records, strict=True):
        plot_residual_force(located, equation, record=record, ax=ax)
        ax.set_title(dataset.names[record], fontsize=9.5, loc="left")
        if record != records[-1]:
            ax.set_xlabel("")
        if record and ax.get_legend() is not None:
            ax.get_legend().remove()
    against = lower.subplots(rows, columns, squeeze=False, sharey=True)
    for ax, name in zip(against.flat, signals, strict=False):
        plot_force_against(located, equation, dataset, name, ax=ax)
    for ax in against[:, 1:].flat:
        ax.set_ylabel("")
    for ax in against.flat[len(signals) :]:
        ax.axis("off")
    return figure


def slice_means(
    x: np.ndarray, y: np.ndarray, share: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means of ``y`` in slices of ``x`` that hold equally many samples.

    Parameters
    ----------
    x, y : ndarray (n_samples,)
        Signal and force.
    share : float
        Share of the samples that count as independent.

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
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _N_BINS + 1)))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    centres, means, half = [], [], []
    for part in range(max(len(edges) - 1, 1)):
        inside = y[index == part]
        if len(inside) < 5:
            continue
        centres.append(float(np.mean(x[index == part])))
        means.append(float(np.mean(inside)))
        half.append(TWO_SIDED_95 * float(np.std(inside)) / np.sqrt(max(share * len(inside), 1.0)))
    return np.array(centres), np.array(means), np.array(half)


def _column(located: Located, equation: str) -> int:
    if equation not in located.force_names:
        raise DataError(
            f"There is no residual force {equation!r}. There are {', '.join(located.force_names)}."
        )
    return located.force_names.index(equation)


def _unit(located: Located, equation: str) -> str:
    units: Mapping[str, str] = {place.name: place.unit for place in located.places}
    return units.get(f"force {equation}", "") or "-"


def _name(located: Located, equation: str) -> str:
    return f"{symbol_of(equation)} [{_unit(located, equation)}]"


def _signal(record: Record, name: str) -> np.ndarray:
    inputs = record.channels.input_names
    return record.input(name) if name in inputs else record.output(name)


def _channel(dataset: Dataset, name: str) -> Input | Output:
    channels: list[Input | Output] = [*dataset.channels.inputs, *dataset.channels.outputs]
    return next(channel for channel in channels if channel.name == name)


def _varies(record: Record, name: str) -> bool:
    values = _signal(record, name)
    values = values[np.isfinite(values)]
    return bool(values.size and np.ptp(values) > 0)
