"""Pictures of predictions: records that were not fitted to, and the polar of a sailing vehicle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid.errors import DataError
from oed_sysid.evidence.compare import Comparison
from oed_sysid.likelihood.prediction import Prediction
from oed_sysid.prediction.speed_polar import SpeedPolar
from oed_sysid.results.fit_plots import plot_input
from oed_sysid.results.style import (
    DATA,
    NEUTRAL,
    TRUTH,
    abscissa,
    clean,
    joined,
    label,
    model_style,
    new_axes,
    new_figure,
    plot_band,
    say,
    shown,
    spread_legend,
)
from oed_sysid.runtime.display import TWO_SIDED_95

# Best and worst record of an output, those that did not measure it left out.
_ENDS = (np.nanmin, np.nanmax)


def plot_prediction(
    predictions: Prediction | Sequence[Prediction],
    output: str,
    *,
    record: str | int = 0,
    labels: Sequence[str] | None = None,
    styles: Sequence[int] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot one measured output and what one or several models predict for it.

    Each band holds 95 % of new measurements if its model is right: noise and
    the uncertainty of the parameters together.

    Parameters
    ----------
    predictions : Prediction or sequence of Prediction
        Of the same records.
    output : str
        Which output.
    record : str or int
        Which record.
    labels : sequence of str, optional
        Names of the models.
    styles : sequence of int, optional
        Places of the models in a comparison, for their colours; by default
        their order.
    ax : Axes, optional
        Where to draw.
    """
    several, row, column, styles = _chosen(predictions, output, record, styles)
    ax = new_axes(ax)
    data = several[0].dataset[row]
    channel = data.channels.outputs[column]
    along, words = abscissa(data)
    ax.plot(
        along, shown(channel, data.outputs[:, column]), ".", color=DATA, ms=2.5,
        label="measured", rasterized=True,
    )  # fmt: skip
    for number, (place, one) in enumerate(zip(styles, several, strict=True)):
        look = model_style(place)
        mean = shown(channel, one.outputs[row][:, column])
        half = TWO_SIDED_95 * shown(channel, one.std[row][:, column])
        plot_band(
            ax, data, mean - half, mean + half, color=look.colour, alpha=0.2, lw=0,
            rasterized=True,
        )  # fmt: skip
        ax.plot(
            along, mean, color=look.colour, lw=1.5, **joined(data, look.dashes),
            label=labels[number] if labels else f"model {number + 1}",
        )  # fmt: skip
    ax.set(xlabel=words, ylabel=label(channel))
    return say(clean(ax), " ".join(_errors(several, row, column, labels)))


def plot_prediction_error(
    predictions: Prediction | Sequence[Prediction],
    output: str,
    *,
    record: str | int = 0,
    labels: Sequence[str] | None = None,
    styles: Sequence[int] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot measured minus predicted of one output in units of the noise.

    The grey band holds 95 % of the noise. Parameters as in
    :func:`plot_prediction`.
    """
    several, row, column, styles = _chosen(predictions, output, record, styles)
    ax = new_axes(ax)
    ax.axhspan(-TWO_SIDED_95, TWO_SIDED_95, color=NEUTRAL, alpha=0.3, lw=0)
    ax.axhline(0.0, color=TRUTH, lw=0.8)
    for number, (place, one) in enumerate(zip(styles, several, strict=True)):
        look = model_style(place)
        data = one.dataset[row]
        along, words = abscissa(data)
        ax.plot(
            along, one.residuals[row][:, column] / one.sigma[column],
            color=look.colour, lw=0.9, label=labels[number] if labels else f"model {number + 1}",
            rasterized=True, **joined(data),
        )  # fmt: skip
    ax.set(xlabel=words, ylabel="error [noise]")
    return clean(ax)


def plot_comparison(comparison: Comparison, *, ax: Axes | None = None) -> Axes:
    """Plot the misfit of each output in units of the noise, models side by side.

    The line at one is what noise alone leaves. The whisker shows the records
    that are best and worst.

    Parameters
    ----------
    comparison : Comparison
        Of one or several models.
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax, size=(7.2, 3.4))
    models = comparison.models
    width = 0.8 / len(models)
    for number, part in enumerate(models):
        look = model_style(number)
        measured = [one for one in part.outputs if one.n_samples]
        places = np.arange(len(measured)) + (number - (len(models) - 1) / 2) * width
        heights = np.array([one.relative for one in measured])
        ends = np.array([[f(one.record_rmse) / one.sigma for one in measured] for f in _ENDS])
        ax.bar(
            places, heights, width=0.9 * width, color=look.colour, hatch=look.hatch, alpha=0.75,
            edgecolor="0.2", lw=0.6, label=f"{part.label}: {part.relative:.3g} overall",
            yerr=np.maximum([heights - ends[0], ends[1] - heights], 0.0),
            error_kw={"lw": 1.0, "capsize": 3},
        )  # fmt: skip
    ax.axhline(1.0, color=TRUTH, lw=1.0)
    ax.set_xticks(range(len(measured)), [one.output.label or one.output.name for one in measured])
    if max(part.relative for part in models) > 8.0:
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
    ax.set(ylabel="rms error [noise]")
    clean(ax)
    ax.grid(False, axis="x")
    spread_legend(ax, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)
    return say(ax, comparison.verdict.splitlines()[-1])


def figure_predictions(
    predictions: Prediction | Sequence[Prediction],
    record: str | int = 0,
    *,
    labels: Sequence[str] | None = None,
    styles: Sequence[int] | None = None,
) -> Figure:
    """All outputs of one record: predictions on the left, errors on the right."""
    first = predictions if isinstance(predictions, Prediction) else predictions[0]
    data = first.dataset[record]
    outputs = [n for n in data.channels.output_names if n not in data.missing_outputs]
    inputs = [n for n in data.channels.input_names if n not in data.constant_channels]
    rows = len(outputs) + (1 if inputs else 0)
    figure, axes = new_figure(rows, 2, size=(11.0, 1.1 + 1.55 * rows), sharex=True)
    for line, name in zip(axes, outputs, strict=False):
        channel = data.channels.outputs[data.channels.output_names.index(name)]
        for draw, ax in ((plot_prediction, line[0]), (plot_prediction_error, line[1])):
            draw(predictions, name, record=record, labels=labels, styles=styles, ax=ax)
        line[0].set_ylabel(label(channel, lines=2))
    for ax, name in zip(axes[-1], inputs, strict=False):
        plot_input(data, name, ax=ax)
        ax.set_ylabel(label(data.channels.inputs[data.channels.input_names.index(name)], lines=2))
    for ax in axes[:-1].flat:
        ax.set_xlabel("")
    if len(inputs) == 1:
        axes[-1, 1].axis("off")
        axes[-2, 1].tick_params(labelbottom=True)
        axes[-2, 1].set_xlabel("time $t$ [s]")
    axes[0, 0].set_title(f"{data.name}: measured and predicted")
    axes[0, 1].set_title("measured − predicted, in units of the noise")
    # Room above the curves, so that the legend hides none of them.
    low, high = axes[0, 0].get_ylim()
    axes[0, 0].set_ylim(low, high + 0.18 * (high - low))
    spread_legend(axes[0, 0], loc="upper right", ncols=3, fontsize=8, markerscale=3)
    figure.align_ylabels()
    return figure


def _errors(
    several: Sequence[Prediction], row: int, column: int, labels: Sequence[str] | None
) -> list[str]:
    """Root mean square error of each model on one output, in units of the noise."""
    said = []
    for number, one in enumerate(several):
        off = one.residuals[row][:, column] / one.sigma[column]
        name = labels[number] if labels else f"model {number + 1}"
        output = one.dataset.channels.output_names[column]
        if np.isfinite(off).any():
            size = float(np.sqrt(np.nanmean(off**2)))
            said.append(f"{name} misses {output} by {size:.3g} times its noise.")
    return said


def _chosen(
    predictions: Prediction | Sequence[Prediction],
    output: str,
    record: str | int,
    styles: Sequence[int] | None,
) -> tuple[list[Prediction], int, int, Sequence[int]]:
    """Predictions as a list, row of the record, column of the output, places in a comparison."""
    several = [predictions] if isinstance(predictions, Prediction) else list(predictions)
    dataset = several[0].dataset
    row = dataset.names.index(dataset[record].name)
    column = dataset.channels.output_names.index(output)
    return several, row, column, styles or range(len(several))


def plot_polar(
    polars: SpeedPolar | Sequence[SpeedPolar],
    *,
    truth: SpeedPolar | None = None,
    labels: Sequence[str] | None = None,
    level: float = 0.95,
    ax: Axes | None = None,
) -> Axes:
    """Plot speed polars with credible bands: wind from above, speed outward.

    Parameters
    ----------
    polars : SpeedPolar or sequence of SpeedPolar
        One curve and band each.
    truth : SpeedPolar, optional
        What the simulator sails, in black.
    labels : sequence of str, optional
        Names of the curves; by default the wind speeds.
    level : float
        Probability of the bands.
    ax : Axes, optional
        Polar axes (``projection="polar"``) to draw on.

    Raises
    ------
    DataError
        If the axes are not polar.
    """
    several = [polars] if isinstance(polars, SpeedPolar) else list(polars)
    ax = _polar_axes() if ax is None else ax
    if ax.name != "polar":
        raise DataError("A speed polar needs polar axes. Make them with projection='polar'.")
    names = labels or [f"{polar.wind_speed:g} m/s wind" for polar in several]
    for index, (polar, name) in enumerate(zip(several, names, strict=True)):
        look = model_style(index)
        ax.plot(polar.angles, polar.speeds, color=look.colour, ls=look.dashes, lw=1.6, label=name)
        low, high = polar.interval(level)
        if np.isfinite(low).any():
            ax.fill_between(
                polar.angles, low, high, color=look.colour, alpha=0.25, lw=0, label=f"{level:.0%}"
            )
    if truth is not None:
        ax.plot(truth.angles, truth.speeds, ".", color=TRUTH, ms=6, label="truth")
    ax.set_theta_zero_location("N")  # type: ignore[attr-defined]
    ax.set_theta_direction(-1)  # type: ignore[attr-defined]
    ax.set_thetamin(0)  # type: ignore[attr-defined]
    ax.set_thetamax(180)  # type: ignore[attr-defined]
    ax.set_rlim(bottom=0.0)  # type: ignore[attr-defined]
    ax.grid(True, color="0.88", linewidth=0.7)
    ax.tick_params(colors="0.25", labelsize=9)
    ax.set_title("speed [m/s] over angle to the true wind", fontsize=11)
    spread_legend(ax, loc="center left", bbox_to_anchor=(-0.28, 0.5))
    return ax


def _polar_axes() -> Axes:
    _, axes = new_figure(1, 1, size=(5.4, 6.0), subplot_kw={"projection": "polar"})
    return axes[0, 0]
