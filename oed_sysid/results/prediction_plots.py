"""Pictures of what models say about records: fits and predictions, one signal or all of a record.

A fit is drawn on the records that it was made from, with the band of its noise; a prediction on
others, with the band of noise and uncertain parameters together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError
from oed_sysid.evidence.compare import Comparison
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.prediction import Prediction
from oed_sysid.physics.channels import Input, Output
from oed_sysid.prediction.speed_polar import SpeedPolar
from oed_sysid.results.style import (
    DATA,
    TRUTH,
    ModelStyle,
    abscissa,
    band,
    clean,
    joined,
    label,
    model_style,
    new_axes,
    new_figure,
    say,
    shown,
    spread_legend,
    zero,
)
from oed_sysid.runtime.display import TWO_SIDED_95

Source = Fit | Prediction


@dataclass(frozen=True)
class Said:
    """What one model says about one record.

    Parameters
    ----------
    record : Record
    mean, std, residuals : ndarray (n_times, n_outputs)
        Outputs, their standard deviations, and measured minus said, SI.
    sigma : ndarray (n_outputs,)
        Levels of the noise, SI.
    name : str
        What it is called.
    look : ModelStyle
    """

    record: Record
    mean: np.ndarray
    std: np.ndarray
    residuals: np.ndarray
    sigma: np.ndarray
    name: str
    look: ModelStyle


def said_of(
    models: Source | Sequence[Source],
    record: str | int | Record,
    labels: Sequence[str] | None = None,
    styles: Sequence[int] | None = None,
) -> list[Said]:
    """Return what models say about one record.

    Parameters
    ----------
    models : Fit, Prediction or sequence of them
    record : str, int or Record
        Of the first model's records, or one that all know by its name.
    labels : sequence of str, optional
        Names of the models.
    styles : sequence of int, optional
        Places of the models in a comparison, for their colours; by default their order.

    Raises
    ------
    DataError
        If a model knows no record of that name.
    """
    several = [models] if isinstance(models, Fit | Prediction) else list(models)
    found = []
    for number, model in enumerate(several):
        data = record if isinstance(record, Record) else model.dataset[record]
        if data.name not in model.dataset.names:
            raise DataError(
                f"A model was not fitted to record {data.name!r} and says nothing about it (it "
                f"knows {', '.join(model.dataset.names)}). Give fit.predict(Dataset((record,))) "
                "instead."
            )
        row = model.dataset.names.index(data.name)
        mean = model.predictions[row] if isinstance(model, Fit) else model.outputs[row]
        std = np.broadcast_to(model.sigma, mean.shape) if isinstance(model, Fit) else model.std[row]
        name = labels[number] if labels else f"model {number + 1}"
        look = model_style(styles[number] if styles else number)
        found.append(Said(data, mean, std, model.residuals[row], model.sigma, name, look))
    return found


def _column(said: Said, output: str) -> tuple[int, Output]:
    column = said.record.channels.output_names.index(output)
    return column, said.record.channels.outputs[column]


def draw_output(ax: Axes, models: Sequence[Said], output: str, band_label: str = "") -> Axes:
    """Draw one measured output, and of each model a line with its 95 % band."""
    data = models[0].record
    column, channel = _column(models[0], output)
    along, words = abscissa(data)
    measured = shown(channel, data.outputs[:, column])
    ax.plot(along, measured, ".", color=DATA, ms=2.5, label="measured", rasterized=True)
    for one in models:
        mean = shown(channel, one.mean[:, column])
        half = TWO_SIDED_95 * shown(channel, one.std[:, column])
        colour = one.look.colour
        band(ax, data, mean - half, mean + half, colour, label=band_label or None)
        line = joined(data, one.look.dashes)
        ax.plot(along, mean, color=colour, lw=1.5, label=one.name, **line)
    ax.set(xlabel=words, ylabel=label(channel))
    return clean(ax)


def draw_error(ax: Axes, models: Sequence[Said], output: str, *, scaled: bool) -> Axes:
    """Draw measured minus said, in its unit or in units of the noise, whose 95 % band is grey."""
    column, channel = _column(models[0], output)
    along, words = abscissa(models[0].record)
    level = 1.0 if scaled else float(shown(channel, models[0].sigma[column]))
    zero(ax, TWO_SIDED_95 * level, "95 % of the noise")
    for one in models:
        off = one.residuals[:, column] / one.sigma[column] * level
        mark = joined(one.record) if scaled else {"ls": "", "marker": ".", "ms": 2.5}
        ax.plot(along, off, color=one.look.colour, lw=0.9, label=one.name, rasterized=True, **mark)
    unit = "noise" if scaled else label(channel).rpartition("[")[2].rstrip("]")
    ax.set(xlabel=words, ylabel=f"{'error' if scaled else 'residual'} [{unit}]")
    return clean(ax)


def plot_output(
    fit: Fit, output: str, *, record: str | int = 0, style: int = 0, ax: Axes | None = None
) -> Axes:
    """Plot one measured output and the model, with the band in which 95 % should lie.

    Parameters
    ----------
    fit : Fit
        The fit.
    output : str
        Which output.
    record : str or int
        Which of its records.
    style : int
        Position of the model in a comparison; sets its colour.
    ax : Axes, optional
        Where to draw.
    """
    (said,) = said_of(fit, record, ["model"], [style])
    said = replace(said, look=replace(said.look, dashes="-"))
    draw_output(ax := new_axes(ax), [said], output, "model ± noise (95 %)")
    size = fit.rms[output] / fit.sigma[_column(said, output)[0]]
    words = f"residuals of {output} are {size:.3g} times its noise."
    return say(ax, f"{said.record.name}: {words}")


def plot_residual(
    fit: Fit, output: str, *, record: str | int = 0, style: int = 0, ax: Axes | None = None
) -> Axes:
    """Plot measured minus model of one output, with the 95 % band of its noise."""
    said = said_of(fit, record, ["measured − model"], [style])
    return draw_error(new_axes(ax), said, output, scaled=False)


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
    labels, styles
        See :func:`said_of`.
    ax : Axes, optional
        Where to draw.
    """
    models = said_of(predictions, record, labels, styles)
    return say(draw_output(new_axes(ax), models, output), " ".join(_errors(models, output)))


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
    models = said_of(predictions, record, labels, styles)
    return draw_error(new_axes(ax), models, output, scaled=True)


def _errors(models: Sequence[Said], output: str) -> Iterator[str]:
    """Root mean square error of each model on one output, in units of the noise."""
    for one in models:
        column, _ = _column(one, output)
        off = one.residuals[:, column] / one.sigma[column]
        if np.isfinite(off).any():
            size = float(np.sqrt(np.nanmean(off**2)))
            yield f"{one.name} misses {output} by {size:.3g} times its noise."


def draw_input(ax: Axes, record: Record, channel: Input) -> Axes:
    """Draw one commanded signal of a record, as it acts between samples."""
    along, words = abscissa(record)
    style = "steps-post" if channel.interpolation == "hold" else "default"
    values = shown(channel, record.input(channel.name))
    ax.plot(along, values, color=TRUTH, lw=1.0, drawstyle=style, **joined(record))
    ax.set(xlabel=words, ylabel=label(channel))
    return clean(ax)


def plot_input(record: Record, name: str, *, ax: Axes | None = None) -> Axes:
    """Plot one commanded signal of a record, as it acts between samples."""
    channel = record.channels.inputs[record.channels.input_names.index(name)]
    return draw_input(new_axes(ax, size=(6.4, 2.0)), record, channel)


def figure_fit(fit: Fit, record: str | int = 0, *, style: int = 0) -> Figure:
    """Data and model on the left, residuals on the right, commands below, of one record."""
    models = said_of(fit, record, ["model"], [style])
    models = [replace(one, look=replace(one.look, dashes="-")) for one in models]
    return _side_by_side(models, ("measured and model", "measured − model"), scaled=False)


def figure_predictions(
    predictions: Prediction | Sequence[Prediction],
    record: str | int = 0,
    *,
    labels: Sequence[str] | None = None,
    styles: Sequence[int] | None = None,
) -> Figure:
    """All outputs of one record: predictions on the left, errors on the right."""
    models = said_of(predictions, record, labels, styles)
    titles = ("measured and predicted", "measured − predicted, in units of the noise")
    return _side_by_side(models, titles, scaled=True)


def _side_by_side(models: Sequence[Said], titles: tuple[str, str], *, scaled: bool) -> Figure:
    """Outputs of a record on the left, errors on the right, commands below."""
    data = models[0].record
    outputs = [name for name in data.channels.output_names if name not in data.missing_outputs]
    inputs = [one for one in data.channels.inputs if one.name not in data.constant_channels]
    rows = len(outputs) + bool(inputs)
    figure, axes = new_figure(rows, 2, size=(11.0, 1.1 + 1.55 * rows), sharex=True)
    for (left, right), name in zip(axes, outputs, strict=False):
        words = "" if scaled else "model ± noise (95 %)"
        say(draw_output(left, models, name, words), " ".join(_errors(models, name)))
        draw_error(right, models, name, scaled=scaled)
        left.set_ylabel(label(_column(models[0], name)[1], lines=2))
    for ax, command in zip(axes[-1], inputs, strict=False):
        draw_input(ax, data, command).set_ylabel(label(command, lines=2))
    for ax in axes[:-1].flat:
        ax.set_xlabel("")
    if len(inputs) == 1:
        axes[-1, 1].axis("off")
        axes[-2, 1].tick_params(labelbottom=True)
        axes[-2, 1].set_xlabel(abscissa(data)[1])
    axes[0, 0].set_title(f"{data.name}: {titles[0]}", pad=20)
    axes[0, 1].set_title(titles[1])
    spread_legend(
        axes[0, 0], loc="lower left", bbox_to_anchor=(0.0, 0.97), ncols=4, fontsize=8,
        markerscale=3, borderaxespad=0.0,
    )  # fmt: skip
    figure.align_ylabels()
    return figure


# Best and worst record of an output, those that did not measure it left out.
_ENDS = (np.nanmin, np.nanmax)


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
    clean(ax, grid="y")
    spread_legend(ax, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)
    return say(ax, comparison.verdict.splitlines()[-1])


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
