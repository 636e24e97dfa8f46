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
from oed_sysid.results.chart import Chart, Mark
from oed_sysid.runtime.display import TWO_SIDED_95
from oed_sysid.text.units import scaled

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
    return chart_error_fall(improvement).on(ax)


def chart_error_fall(improvement: Improvement) -> Chart:
    """Describe :func:`plot_error_fall`."""
    steps = improvement.steps
    places = list(range(len(steps) + 1))
    errors = {
        "training": [improvement.base_error["train"], *(step.train_error for step in steps)],
        "validation": [improvement.base_error["test"], *(step.test_error for step in steps)],
    }
    looks = {"training": (draw.NEUTRAL, "--", "s"), "validation": (draw.COLOURS[1], "-", "o")}
    told = [kind for kind, values in errors.items() if np.isfinite(values).any()] or ["training"]
    shown = errors[told[-1]]
    marks = (
        Mark(places, errors[kind], f"{kind} records", *looks[kind],
             texts=[f"{one:.3g}" for one in errors[kind]] if kind == told[-1] else ())
        for kind in told
    )  # fmt: skip
    finite = [one for kind in told for one in errors[kind] if np.isfinite(one)]
    added = ", ".join(step.added for step in steps) or "nothing added"
    return Chart(
        tuple(marks), "", "prediction error [noise]",
        f"The error on the {told[-1]} records goes from {shown[0]:.3g} to "
        f"{shown[-1]:.3g} times the noise with {added}.",
        level=1.0, band=0.05, logarithmic=max(finite, default=1.0) > 8.0,
        names=["nominal", *(f"+ {step.added.replace('_', ' ')}" for step in steps)],
    )  # fmt: skip


def plot_force_found(improvement: Improvement, dataset: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the force that the nominal model lacks against motion, with the effect that was found.

    Dots are the residual force at all samples of the training records, points with whiskers its
    means over slices of the motion (95 %). The line is what would be seen if the effect were all
    that is missing: its signature, through the same projection as the residual force, so that
    both may be compared.

    Parameters
    ----------
    improvement : Improvement
        With at least one residual force.
    dataset : Dataset
        The training records, as the search has read them.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.

    Raises
    ------
    DataError
        If the records show no residual force.
    """
    return chart_force_found(improvement, dataset).on(ax)


def chart_force_found(improvement: Improvement, dataset: Dataset) -> Chart:
    """Describe :func:`plot_force_found`."""
    located, step = improvement.location, next(iter(improvement.steps), None)
    equation = force_equation(improvement)
    signals = {
        one.name: np.concatenate([draw.signal_of(record, one) for record in dataset])
        for one in dataset.channels.all
    }
    # What is in the formula of the effect, itself or as a velocity through the water.
    used = set() if step is None else step.effect.uses()
    moving = {name: values for name, values in signals.items() if {name, f"{name}_r"} & used}
    name = clearest(located, equation, moving or signals)
    channel = next(one for one in dataset.channels.all if one.name == name)
    found = "" if step is None else step.added
    return chart_residual(located, equation, signals[name], draw.label(channel), name, found)


def force_equation(improvement: Improvement) -> str:
    """Equation whose residual force shows what was found: that of the first effect, or the best.

    Raises
    ------
    DataError
        If the records show no residual force.
    """
    located = improvement.location
    wished = [str(key) for step in improvement.steps[:1] for key in step.effect.terms]
    for name in (*wished, located.equation):
        if name in located.force_names:
            return name
    raise DataError("There is no residual force in this finding.")


def clearest(located: Located, equation: str, signals: Mapping[str, np.ndarray]) -> str:
    """Name of the signal against which a residual force shows the clearest curve.

    That whose slice means are furthest from zero, in halves of their 95 % intervals.

    Parameters
    ----------
    located : Located
    equation : str
        Which of its ``force_names``; of another one the first signal is the clearest.
    signals : mapping of str to ndarray (n_samples,)
        At all times of all records.
    """
    if equation not in located.force_names:
        return next(iter(signals))

    def clear(name: str) -> float:
        _, means, half = force_against(located, equation, signals[name])[2]
        return float(np.mean((means / np.maximum(half, 1e-300)) ** 2)) if means.size else 0.0

    return max(signals, key=clear)


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
    top = located.top
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
    column, unit = _column(located, equation), _unit(located, equation)
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
        f"{unit}, beyond its 95 % band for {np.mean(seen):.0%} of the time.",
        legend={"loc": "lower right", "bbox_to_anchor": (1.0, 0.98), "borderaxespad": 0.0,
                "ncols": 3, "fontsize": 8},
        xlabel="time $t$ [s]", ylabel=f"residual {draw.symbol_of(equation)} [{unit}]",
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
    channel = next(one for one in dataset.channels.all if one.name == signal)
    where = np.concatenate([draw.signal_of(record, channel) for record in dataset])
    chart = chart_residual(located, equation, where, draw.label(channel), signal)
    return chart.on(ax, size=(4.4, 3.2))


def chart_residual(
    located: Located, equation: str, where: np.ndarray, words: str, name: str, found: str = ""
) -> Chart:
    """Describe the residual force of an equation against a signal: dots, and means with 95 %.

    Parameters
    ----------
    located : Located
        Where the nominal model fails.
    equation : str
        Which of its ``force_names``.
    where : ndarray (n_samples,)
        The signal at all times of all records, in the unit that ``words`` names.
    words, name : str
        Label of the axis; name of the signal.
    found : str
        An effect whose signature is drawn beside, where the finding holds it.
    """
    x, y, (centres, means, half) = force_against(located, equation, where)
    factor, unit = scaled(_unit(located, equation), float(np.abs(y).max(initial=0.0)))
    thin = slice(None, None, max(x.size // 4000, 1))  # what a browser draws without stutter
    marks = [
        Mark(x[thin], factor * y[thin], "every sample", dashes="", marker=".", faint=True),
        Mark(centres, factor * means, "mean, 95 %", draw.COLOURS[0], "", "o", factor * half),
    ]
    if found in located.signatures:
        column = _column(located, equation)
        parts = np.concatenate([one[:, column] for one in located.signatures[found]])
        seen = np.isfinite(where) & np.isfinite(parts)
        at, expected, _ = slice_means(where[seen], parts[seen], 1.0, 40)
        words_of = f"expected of {found.replace('_', ' ')}"
        marks.append(Mark(at, factor * expected, words_of, draw.COLOURS[1]))
    clear = int(np.sum(np.abs(means) > half))
    return Chart(
        tuple(marks), words, f"residual {draw.symbol_of(equation)} [{unit}]",
        f"Residual {equation} over {name}: {clear} of {len(means)} means differ from zero.",
        level=0.0,
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
    lacking = "The finding has no residual force of the equation"
    return located_names(DataError, lacking, [equation], located.force_names)[0]


def _unit(located: Located, equation: str) -> str:
    units: Mapping[str, str] = {place.name: place.unit for place in located.places}
    return units.get(f"force {equation}", "") or "-"
