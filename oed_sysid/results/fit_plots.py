"""Pictures of fits and predictions: data, frequencies, residuals, estimates, joint regions, polars.

A fit is drawn on the records that it was made from, with the band of its noise; a prediction on
others, with the band of noise and uncertain parameters together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError, located
from oed_sysid.evidence.compare import Comparison
from oed_sysid.evidence.frequency import TOLD, FrequencyComparison
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information, autocorrelation, effective_sample_size
from oed_sysid.likelihood.multistart import Profile
from oed_sysid.likelihood.prediction import Prediction
from oed_sysid.physics.channels import Input, Output
from oed_sysid.physics.model import Model
from oed_sysid.prediction.speed_polar import SpeedPolar
from oed_sysid.results import style as draw
from oed_sysid.results.chart import Chart, Mark
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
    look: draw.ModelStyle


def said_of(
    models: Source | Sequence[Source],
    record: str | int | Record,
    labels: Sequence[str] | None = None,
    first: int = 0,
) -> list[Said]:
    """Return what models say about one record.

    Parameters
    ----------
    models : Fit, Prediction or sequence of them
    record : str, int or Record
        Of the first model's records, or one that all know by its name.
    labels : sequence of str, optional
        Names of the models.
    first : int
        Place of the first model in a comparison, for the colours.

    Raises
    ------
    DataError
        If a model knows no record of that name.
    """
    found = []
    for number, model in enumerate(draw.several(models)):
        data = record if isinstance(record, Record) else model.dataset[record]
        if data.name not in model.dataset.names:
            raise DataError(
                f"A model was not fitted to record {data.name!r} and says nothing about it (it "
                f"knows {', '.join(model.dataset.names)}). Give fit.predict(Dataset((record,))) "
                "instead."
            )
        row = model.dataset.names.index(data.name)
        mean = model.predictions[row] if isinstance(model, Fit) else model.outputs[row]
        sensors = model.noise.sensors if isinstance(model, Fit) else model.sensors
        std = np.broadcast_to(sensors, mean.shape) if isinstance(model, Fit) else model.std[row]
        name = labels[number] if labels else f"model {number + 1}"
        look = draw.model_style(first + number)
        found.append(Said(data, mean, std, model.residuals[row], sensors, name, look))
    return found


def _column(record: Record, output: str) -> tuple[int, Output]:
    names = record.channels.output_names
    (column,) = located(DataError, f"Record {record.name!r} has no output", [output], names)
    return column, record.channels.outputs[column]


def chart_output(data: Record, models: Sequence[Said], output: str, band: str = "") -> Chart:
    """Describe one measured output, and of each model a line with its 95 % band."""
    column, channel = _column(data, output)
    along, words = draw.abscissa(data)
    measured = draw.shown(channel, data.outputs[:, column])
    marks = [Mark(along, measured, "measured", dashes="", marker=".")]
    for one in models:
        mean = draw.shown(channel, one.mean[:, column])
        half = TWO_SIDED_95 * draw.shown(channel, one.std[:, column])
        # Rows of independent tests are marks that nothing joins.
        line = ("", "_") if data.independent else (one.look.dashes, "")
        marks.append(Mark(along, mean, one.name, one.look.colour, *line, half, band))
    said = _errors(models, output) or draw.between(channel, measured)
    return Chart(tuple(marks), words, draw.label(channel, lines=2), said)


def draw_error(ax: Axes, models: Sequence[Said], output: str, *, scaled: bool) -> Axes:
    """Draw measured minus said, in its unit or in units of the noise, whose 95 % band is grey."""
    column, channel = _column(models[0].record, output)
    along, words = draw.abscissa(models[0].record)
    level = 1.0 if scaled else float(draw.shown(channel, models[0].sigma[column]))
    draw.zero(ax, TWO_SIDED_95 * level, "95 % of the noise")
    for one in models:
        off = one.residuals[:, column] / one.sigma[column] * level
        mark = draw.joined(one.record) if scaled else {"ls": "", "marker": ".", "ms": 2.5}
        ax.plot(along, off, color=one.look.colour, lw=0.9, label=one.name, rasterized=True, **mark)
    unit = "noise" if scaled else draw.label(channel).rpartition("[")[2].rstrip("]")
    label = f"{'error' if scaled else 'residual'} [{unit}]"
    return draw.done(ax, _errors(models, output), xlabel=words, ylabel=label)


def plot_prediction(
    models: Source | Sequence[Source],
    output: str,
    *,
    record: str | int = 0,
    labels: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot one measured output and what one or several models say about it.

    Each band holds 95 % of new measurements if its model is right: of a fit the noise, of a
    prediction the noise and the uncertainty of the parameters together.

    Parameters
    ----------
    models : Fit, Prediction or sequence of them
        Of the same records.
    output : str
        Which output.
    record : str or int
        Which record.
    labels
        See :func:`said_of`.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    said = said_of(models, record, labels)
    return chart_output(said[0].record, said, output).on(ax, size=(6.4, 4.0))


def plot_prediction_error(
    models: Source | Sequence[Source],
    output: str,
    *,
    record: str | int = 0,
    labels: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot measured minus said of one output in units of the noise.

    The grey band holds 95 % of the noise. Parameters as in :func:`plot_prediction`.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    return draw_error(draw.new_axes(ax), said_of(models, record, labels), output, scaled=True)


def _errors(models: Sequence[Said], output: str) -> str:
    """Root mean square error of each model on one output, in units of the noise."""
    said = []
    for one in models:
        column, _ = _column(one.record, output)
        off = one.residuals[:, column] / one.sigma[column]
        if np.isfinite(off).any():
            size = float(np.sqrt(np.nanmean(off**2)))
            said.append(f"{one.name} misses {output} by {size:.3g} times its noise.")
    return " ".join(said)


def chart_input(record: Record, channel: Input) -> Chart:
    """Describe one commanded signal of a record, as it acts between samples."""
    along, words = draw.abscissa(record)
    values = draw.signal_of(record, channel)
    line = ("", "_") if record.independent else ("-", "")
    held = channel.interpolation == "hold"
    mark = Mark(along, values, "commanded", draw.TRUTH, *line, held=held)
    return Chart((mark,), words, draw.label(channel, lines=2), draw.between(channel, values))


def chart_signal(record: Record, channel: Input | Output, models: Sequence[Said] = ()) -> Chart:
    """Describe one signal of a record, and what models say about it."""
    if isinstance(channel, Input):
        return chart_input(record, channel)
    return chart_output(record, models, channel.name)


def figure_fit(fit: Fit, record: str | int = 0, *, style: int = 0) -> Figure:
    """Data and model on the left, residuals on the right, commands below, of one record.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    titles = ("measured and model", "measured − model")
    (said,) = said_of(fit, record, ["model"], style)
    said = replace(said, look=replace(said.look, dashes="-"))
    return _side_by_side([said], titles, scaled=False)


def figure_predictions(
    predictions: Prediction | Sequence[Prediction],
    record: str | int = 0,
    *,
    labels: Sequence[str] | None = None,
) -> Figure:
    """All outputs of one record: predictions on the left, errors on the right.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    models = said_of(predictions, record, labels)
    titles = ("measured and predicted", "measured − predicted, in units of the noise")
    return _side_by_side(models, titles, scaled=True)


def _side_by_side(models: Sequence[Said], titles: tuple[str, str], *, scaled: bool) -> Figure:
    """Outputs of a record on the left, errors on the right, commands below."""
    data = models[0].record
    outputs = [name for name in data.channels.output_names if name not in data.missing_outputs]
    inputs = [one for one in data.channels.inputs if one.name not in data.constant_channels]
    rows = len(outputs) + bool(inputs)
    figure, axes = draw.new_figure(rows, 2, size=(11.0, 1.1 + 1.55 * rows), sharex=True)
    for (left, right), name in zip(axes, outputs, strict=False):
        words = "" if scaled else "model ± noise (95 %)"
        chart_output(data, models, name, words).on(left, legend=None)
        draw_error(right, models, name, scaled=scaled)
    for ax, command in zip(axes[-1], inputs, strict=False):
        chart_input(data, command).on(ax, legend=None)
    for ax in axes[:-1].flat:
        ax.set_xlabel("")
    if len(inputs) == 1:
        axes[-1, 1].axis("off")
        axes[-2, 1].tick_params(labelbottom=True)
        axes[-2, 1].set_xlabel(draw.abscissa(data)[1])
    axes[0, 0].set_title(f"{data.name}: {titles[0]}", pad=20)
    axes[0, 1].set_title(titles[1])
    draw.spread_legend(
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

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(7.2, 3.4))
    models = comparison.models
    width = 0.8 / len(models)
    for number, part in enumerate(models):
        look = draw.model_style(number)
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
    ax.axhline(1.0, color=draw.TRUTH, lw=1.0)
    ax.set_xticks(range(len(measured)), [one.output.label or one.output.name for one in measured])
    draw.errors_axis(ax, max(part.relative for part in models))
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.1), "ncols": 2}
    words = comparison.verdict.splitlines()[-1]
    return draw.done(ax, words, grid="y", legend=below, ylabel="rms error [noise]")


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

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.

    Raises
    ------
    DataError
        If the axes are not polar.
    """
    several: list[SpeedPolar] = draw.several(polars)
    if ax is None:
        figure, _ = draw.new_figure(1, 1, size=(5.4, 6.0), subplot_kw={"projection": "polar"})
        ax = figure.axes[0]
    if ax.name != "polar":
        raise DataError("A speed polar needs polar axes. Make them with projection='polar'.")
    names = labels or [f"{polar.wind_speed:g} m/s wind" for polar in several]
    said = []
    for index, (polar, name) in enumerate(zip(several, names, strict=True)):
        look = draw.model_style(index)
        ax.plot(polar.angles, polar.speeds, **look.line, lw=1.6, label=name)
        low, high = polar.interval(level)
        if np.isfinite(low).any():
            ax.fill_between(
                polar.angles, low, high, color=look.colour, alpha=0.25, lw=0, label=f"{level:.0%}"
            )
        best = int(np.argmax(polar.speeds))
        angle = np.degrees(polar.angles[best])
        said.append(f"{name}: {polar.speeds[best]:.3g} m/s at most, at {angle:.0f} deg.")
    if truth is not None:
        ax.plot(truth.angles, truth.speeds, ".", color=draw.TRUTH, ms=6, label="truth")
    ax.set(theta_zero_location="N", theta_direction=-1, thetamin=0, thetamax=180, rlim=0.0)
    ax.grid(True, color="0.88", linewidth=0.7)
    ax.tick_params(colors="0.25", labelsize=9)
    ax.set_title("speed [m/s] over angle to the true wind", fontsize=11)
    draw.spread_legend(ax, loc="center left", bbox_to_anchor=(-0.28, 0.5))
    return draw.say(ax, " ".join(said))


# -- the frequency domain -------------------------------------------------------------------


def figure_frequency(found: FrequencyComparison, output: str) -> Figure:
    """Draw magnitude, phase and coherence of one output, a column for each input.

    Parameters
    ----------
    found : FrequencyComparison
        Of :func:`oed_sysid.evidence.frequency.compare_frequency`.
    output : str
        Which output.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    record = found.record
    (j,) = located(DataError, "The comparison has no output", [output], record.outputs)
    figure, axes = draw.new_figure(
        3, len(record.inputs), size=(0.8 + 4.8 * len(record.inputs), 7.2), sharex=True
    )
    hertz = record.frequencies
    for i, command in enumerate(record.inputs):
        gain, turn, share = axes[:, i]
        told = record.told[:, j, i]
        # Where the records tell nothing their response is noise and would set the scale.
        measured = np.where(told, record.values[:, j, i], np.nan)
        half = TWO_SIDED_95 * record.errors[:, j, i]
        size = np.abs(measured)
        # In dB and degrees an error as large as the response itself has no lower end.
        low = 20.0 * np.log10(size / np.maximum(size - half, 0.01 * size))
        high = 20.0 * np.log10(1.0 + half / size)
        phase = _phase(measured, told)
        near = _nearest(phase, told)
        wide = np.degrees(np.minimum(half / size, np.pi))
        dots = {"fmt": ".", "color": draw.DATA, "elinewidth": 0.8, "label": "records"}
        gain.errorbar(hertz, _decibel(measured), np.array([low, high]), **dots)
        turn.errorbar(hertz, phase, wide, **dots)
        for place, one in enumerate(found.models):
            look, run = draw.model_style(place), one.values[:, j, i]
            gain.plot(hertz, _decibel(run), **look.line, label=one.label)
            turn.plot(hertz, _beside(run, near), **look.line)
        share.plot(hertz, record.coherence[:, j, i], color=draw.DATA, label="partial")
        share.plot(hertz, record.multiple[:, j], color=draw.NEUTRAL, ls="--", label="multiple")
        share.axhline(TOLD, color=draw.TRUTH, lw=0.8, ls=":")
        for ax in (gain, turn, share):
            low_end, high_end = ax.get_ylim()
            ax.fill_between(
                hertz, low_end, high_end, where=~told, color="0.93", step="mid", lw=0, zorder=0
            )
            ax.set(xscale="log", ylim=(low_end, high_end))
        said = " ".join(found.said_of(command, output))
        draw.done(gain, said, ylabel=f"{command} to {output}\nmagnitude [dB]", legend=3)
        draw.done(turn, ylabel="phase [deg]")
        share.set_ylim(0.0, 1.02)
        draw.done(share, ylabel="coherence", xlabel="frequency [Hz]", legend=2)
    return figure


def _decibel(values: np.ndarray) -> np.ndarray:
    """Magnitude in dB, SI."""
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(values), np.finfo(float).tiny)))


def _phase(values: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Phase in degrees, continuous where the records tell of it."""
    phase = np.angle(values)
    if told.any():
        phase[told] = np.unwrap(phase[told])
    return np.degrees(phase)


def _beside(values: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Continuous phase in degrees, on the turn that is nearest to another on the whole."""
    found = np.degrees(np.unwrap(np.angle(np.nan_to_num(values))))
    return np.asarray(found + 360.0 * np.round(np.median(phase - found) / 360.0))


def _nearest(phase: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Phase at every frequency, where the records tell nothing that of the nearest told one."""
    if not told.any():
        return np.zeros(len(phase))
    known = np.flatnonzero(told)
    return np.interp(np.arange(len(phase)), known, phase[known])


# -- estimates and residuals ----------------------------------------------------------------


def plot_autocorrelation(
    fit: Fit, output: str, *, max_lag: float | None = None, style: int = 0, ax: Axes | None = None
) -> Axes:
    """Plot the autocorrelation of the residuals of one output, one line per record.

    The band holds 95 % of the values if the residuals were white. Bars would
    hide one record behind the other, so each record is a line.

    Parameters
    ----------
    fit : Fit
        The fit.
    output : str
        Which output.
    max_lag : float, optional
        Longest lag, s; by default 60 samples.
    style : int
        Position of the model in a comparison.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax)
    lacking = f"Model {fit.model.name!r} has no output"
    (column,) = located(DataError, lacking, [output], fit.model.output_names)
    samples, effective, total = 0, 0.0, 0
    for record, residual in zip(fit.dataset, fit.residuals, strict=True):
        series = residual[:, column]
        present = int(np.isfinite(series).sum())
        if present < 10:
            continue
        step = record.sample_time
        n_lags = min(present // 4, 60 if max_lag is None else max(1, int(max_lag / step)))
        rho = autocorrelation(series, n_lags)
        ax.plot(
            np.arange(1, n_lags + 1) * step, rho[1:], lw=1.3, alpha=0.85,
            color=draw.model_style(style).colour, label="records",
        )  # fmt: skip
        samples = max(samples, present)
        effective += effective_sample_size(series)
        total += present
    half = TWO_SIDED_95 / np.sqrt(samples) if samples else 0.0
    draw.zero(ax, half, "95 % band of white noise")
    words = f"Residuals of {output}: {effective:.0f} of {total} samples are independent."
    return draw.done(
        ax, words if total else f"{output} was not measured.", ylim=(-1.05, 1.05),
        xlabel="lag [s]", ylabel="autocorrelation [-]",
        title=f"{draw.symbol_of(output)}: {effective:.0f} independent of {total} samples",
    )  # fmt: skip


def plot_intervals(
    fits: Fit | Sequence[Fit],
    *,
    labels: Sequence[str] | None = None,
    truth: dict[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot estimates with 95 % intervals, relative to the prior or the first fit.

    Parameters
    ----------
    fits : Fit or sequence of Fit
        Fits of models that share parameters.
    labels : sequence of str, optional
        Names of the fits; by default those of their models.
    truth : dict, optional
        True values, where they are known.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.

    Notes
    -----
    Values are divided by the size of the prior mean (the first fit's value
    where there is none), so that all parameters share an axis.
    """
    several: list[Fit] = draw.several(fits)
    names = list(dict.fromkeys(chain.from_iterable(fit.names for fit in several)))
    ax, rows = draw.row_axes(ax, [draw.symbol_of(name) for name in names], 6.4, tall=0.34, edge=0.8)
    row_of = dict(zip(names, rows, strict=True))
    scale = {name: _reference(several, name) for name in names}
    for index, fit in enumerate(several):
        shift = 0.22 * (index - (len(several) - 1) / 2)
        words = labels[index] if labels else f"{fit.model.name} (95 %)"
        _draw_estimates(ax, fit, row_of, scale, shift, label=words, fmt="osD^v<"[index % 6],
                        color=draw.model_style(index).colour)  # fmt: skip
    priors = _draw_priors(ax, several[0].model, row_of, scale)
    for name, value in (truth or {}).items():
        if name in row_of:
            ax.plot(value / scale[name], row_of[name], "|", color=draw.TRUTH, ms=14, mew=2,
                    label="truth")  # fmt: skip
    what = "the prior" if priors.intersection(several[0].names) else "the estimate"
    # The legend is above: below, its distance from the axis' label would depend on the height.
    words = " ".join(filter(None, map(_least_certain, several)))
    return draw.done(ax, words, legend=3, xlabel=f"value relative to {what} [-]")


def _draw_estimates(
    ax: Axes, fit: Fit, rows: dict[str, float], scale: dict[str, float], shift: float, **look: Any
) -> None:
    """Draw the estimates of one fit with their intervals, below their rows."""
    found = [name for name in rows if name in fit.values]
    sizes = np.array([scale[name] for name in found])
    half = TWO_SIDED_95 * np.array([fit.std_errors[name] for name in found]) / np.abs(sizes)
    ax.errorbar(
        np.array([fit.values[name] for name in found]) / sizes,
        np.array([rows[name] for name in found]) - shift,
        xerr=np.where(np.isfinite(half), half, 0.0), ms=4.5, elinewidth=1.6, capsize=3, **look,
    )  # fmt: skip


def _draw_priors(
    ax: Axes, model: Model, rows: dict[str, float], scale: dict[str, float]
) -> set[str]:
    """Draw 95 % of each prior as a grey bar; return the parameters that have a prior mean."""
    means = {p.name: p.prior_mean for p in model.all_parameters if p.prior_mean is not None}
    for name in filter(means.__contains__, rows):
        if (spread := model.parameter(name).prior_spread) is not None:
            half = TWO_SIDED_95 * spread / abs(scale[name])
            left = means[name] / scale[name] - half
            ax.barh(rows[name], 2 * half, left=left, height=0.7, color=draw.NEUTRAL,
                    alpha=0.3, lw=0, label="prior (95 %)", zorder=0.5)  # fmt: skip
    return set(means)


def plot_correlation(fit: Fit, *, ax: Axes | None = None) -> Axes:
    """Plot the correlation matrix of the estimates; numbers where it exceeds 0.5.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    size = 1.6 + 0.42 * len(fit.names)
    ax = draw.new_axes(ax, size=(size + 1.6, size + 0.3))
    matrix = fit.correlation
    picture = ax.imshow(matrix, cmap=draw.DIVERGING, vmin=-1, vmax=1)
    ticks, symbols = range(len(fit.names)), [draw.symbol_of(name) for name in fit.names]
    ax.set_xticks(ticks, symbols, rotation=60, ha="right", rotation_mode="anchor")
    ax.set_yticks(ticks, symbols)
    below = np.tril(matrix, -1)
    for i, j in zip(*np.nonzero(np.abs(below) > 0.5), strict=True):
        ax.text(
            j, i, f"{below[i, j]:+.2f}".replace("0.", "."), ha="center", va="center",
            fontsize=7.5, color="white" if abs(below[i, j]) > 0.8 else "black",
        )  # fmt: skip
    ax.tick_params(labelsize=9, length=0)
    bar = ax.get_figure().colorbar(picture, ax=ax, shrink=0.8)  # type: ignore[union-attr]
    bar.set_label("correlation [-]")
    if not below.size or not np.isfinite(below).any():
        return ax
    i, j = np.unravel_index(int(np.nanargmax(np.abs(below))), below.shape)
    return draw.say(
        ax,
        f"Hardest to tell apart are {fit.names[j]} and {fit.names[i]}: correlation "
        f"{matrix[i, j]:+.2f}.",
    )


def figure_whiteness(fit: Fit, *, style: int = 0) -> Figure:
    """Autocorrelation of the residuals of all outputs.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    outputs = fit.model.output_names
    figure, axes = draw.panels(len(outputs), 3, (3.7, 2.7), sharey=True)
    for place, (ax, name) in enumerate(zip(axes, outputs, strict=True)):
        plot_autocorrelation(fit, name, style=style, ax=ax)
        ax.title.set_fontsize(10)
        if place % 3:
            ax.set_ylabel("")
    return figure


def _least_certain(fit: Fit) -> str:
    """Which estimate of a fit has the widest interval."""
    half = {n: TWO_SIDED_95 * fit.std_errors[n] / abs(v) for n, v in fit.values.items() if v}
    if not half:
        return ""
    name = max(half, key=lambda one: half[one])
    return f"{fit.model.name}: least certain is {name}, ± {100 * half[name]:.2g} % (95 %)."


def _reference(fits: Sequence[Fit], name: str) -> float:
    fit = next(fit for fit in fits if name in fit.values)
    parameter = fit.model.parameter(name)
    return parameter.prior_mean or fit.values[name] or parameter.magnitude


def plot_profile(profile: Profile, *, ax: Axes | None = None) -> Axes:
    """Plot the profile likelihood of a parameter, and the parabola that a standard error means.

    Parameters
    ----------
    profile : Profile
        From :func:`~oed_sysid.likelihood.multistart`.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(5.6, 3.6))
    look = draw.model_style(1)
    ax.axhline(profile.threshold, color=draw.TRUTH, ls="--", lw=1.0, label=f"{profile.level:.0%}")
    bounded = [end for end in (profile.lower, profile.upper) if np.isfinite(end)]
    ax.plot(profile.values, profile.rises, "o-", color=look.colour, ms=3.5, lw=1.5, label="profile")
    half = [abs(end - profile.estimate) for end in bounded if end != profile.estimate]
    if half:
        fine = np.linspace(profile.values.min(), profile.values.max(), 101)
        # The parabola through the nearer end: what a symmetric interval would claim.
        curve = profile.threshold * ((fine - profile.estimate) / min(half)) ** 2
        ax.plot(fine, curve, color=draw.NEUTRAL, lw=1.2, ls=":", label="if it were quadratic")
    for end in bounded:
        ax.axvline(end, color=draw.NEUTRAL, lw=0.9)
    ax.axvline(profile.estimate, color=draw.TRUTH, lw=0.9)
    top = max(2.0 * profile.threshold, 1.0)
    return draw.done(
        ax, profile.report(), legend=3, ylabel=r"rise of $-2\,\log L$ [-]",
        xlabel=f"{draw.symbol_of(profile.name)} [{profile.unit or '-'}]",
        ylim=(min(0.0, float(profile.rises.min())) - 0.03 * top, top),
    )  # fmt: skip


def _covariance(information: Information, pair: tuple[str, str]) -> np.ndarray:
    """Covariance of two parameters, shape ``(2, 2)``."""
    rows = located(DataError, "The information has no parameter", pair, information.names)
    covariance: np.ndarray = information.covariance[np.ix_(rows, rows)]
    if not np.isfinite(covariance).all():
        raise DataError(f"{pair[0]} and {pair[1]} are not both determined, so there is no ellipse.")
    return covariance


def plot_ellipses(
    informations: Sequence[Information],
    pair: tuple[str, str],
    *,
    centres: Sequence[tuple[float, float]] | None = None,
    labels: Sequence[str] | None = None,
    units: tuple[str, str] = ("", ""),
    truth: tuple[float, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot what records or experiments tell about two parameters together.

    The shadow of an ellipse on each axis is that parameter's 95 % interval; a long thin one means
    that only a combination of the two is known.

    Parameters
    ----------
    informations : sequence of Information
        Such as ``fit.information`` or ``design.information``.
    pair : tuple of str
        Parameters on the horizontal and on the vertical axis.
    centres : sequence of tuple of float, optional
        Estimates; zero by default.
    labels : sequence of str, optional
        Names.
    units : tuple of str, optional
        Units of the two, such as ``fit.model.parameter(name).unit``.
    truth : tuple of float, optional
        True values, where they are known.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.

    Raises
    ------
    DataError
        If a parameter is not among those of an information, or has no finite error.
    """
    ax = draw.new_axes(ax, size=(5.2, 4.6))
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    in_units = [f" [{unit}]" if unit else "" for unit in units]
    said = []
    places = centres or [(0.0, 0.0)] * len(informations)
    for number, (one, centre) in enumerate(zip(informations, places, strict=True)):
        covariance = _covariance(one, pair)
        axes, turned = np.linalg.eigh(covariance)
        edge = TWO_SIDED_95 * turned @ (np.sqrt(np.maximum(axes, 0.0))[:, None] * circle)
        look, name = draw.model_style(number), labels[number] if labels else f"case {number + 1}"
        ax.plot(centre[0] + edge[0], centre[1] + edge[1], **look.line, lw=1.6, label=name)
        ax.plot(*centre, "+", color=look.colour, ms=8)
        errors = np.sqrt(np.diag(covariance))
        each = zip(pair, errors, units, strict=True)
        half = ", ".join(f"{n} ± {TWO_SIDED_95 * e:.2g} {unit}".rstrip() for n, e, unit in each)
        rho = covariance[0, 1] / errors.prod()
        said.append(f"{name}: {half} (95 %), correlation {rho:+.2f}.")
    if truth is not None:
        ax.plot(*truth, "x", color=draw.TRUTH, ms=8, mew=2, label="truth")
    about = "" if centres is not None else " away from the estimate"
    x, y = (f"{draw.symbol_of(n)}{about}{unit}" for n, unit in zip(pair, in_units, strict=True))
    return draw.done(ax, " ".join(said), legend={"loc": "best"}, xlabel=x, ylabel=y)
