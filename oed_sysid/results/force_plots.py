"""Pictures of the force that a model lacks: over time, and against what the vehicle did.

What is drawn is the part that the free parameters could not absorb, not the
missing force itself; a candidate's signature has been through the same
projection and may be compared with it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import DataError
from oed_sysid.evidence.locate import Located
from oed_sysid.likelihood.information import effective_sample_size
from oed_sysid.physics.channels import Input, Output
from oed_sysid.results.style import (
    COLOURS,
    DATA,
    TRUTH,
    clean,
    label,
    model_style,
    new_axes,
    new_figure,
    say,
    shown,
    spread_legend,
    symbol_of,
)
from oed_sysid.runtime.display import TWO_SIDED_95

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
    ax.axhline(0.0, color=TRUTH, lw=0.8)
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
    ax.axhline(0.0, color=TRUTH, lw=0.8)
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
