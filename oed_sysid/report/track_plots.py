"""Pictures that seafarers know: the track in a plane and the zigzag diagram."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from oed_sysid.data.dataset import Record
from oed_sysid.errors import DataError
from oed_sysid.fitting.fit import Fit
from oed_sysid.fitting.prediction import Prediction
from oed_sysid.manoeuvres.indices import zigzag_indices
from oed_sysid.report.style import (
    DATA,
    DEGREE,
    NEUTRAL,
    TRUTH,
    TWO_SIDED_95,
    clean,
    label,
    model_style,
    new_axes,
    spread_legend,
    symbol_of,
)


def plot_track(
    record: Record,
    models: Sequence[Fit | Prediction] = (),
    *,
    along: str = "x",
    across: str = "y",
    labels: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot the path in a plane, as measured and as the fitted models follow it.

    Parameters
    ----------
    record : Record
        What was measured.
    models : sequence of Fit or Prediction
        What models say about a record of this name.
    along, across : str
        Outputs on the upward and on the rightward axis: north and east, or
        depth (drawn downwards) and distance.
    labels : sequence of str, optional
        Names of the models.
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax, size=(5.4, 5.4))
    up, right = record.output(along), record.output(across)
    ax.plot(right, up, ".", color=DATA, ms=3, label="measured", rasterized=True)
    names = record.channels.output_names
    for index, one in enumerate(models):
        look = model_style(index)
        rows, _ = _said(one, record)
        ax.plot(
            rows[:, names.index(across)],
            rows[:, names.index(along)],
            color=look.colour,
            linestyle=look.dashes,
            lw=1.6,
            label=labels[index] if labels else f"model {index + 1}",
        )
    start = np.flatnonzero(np.isfinite(up + right))[:1]
    ax.plot(right[start], up[start], "o", mfc="white", mec=TRUTH, ms=7, label="start")
    channels = record.channels.outputs
    ax.set(xlabel=label(channels[names.index(across)]), ylabel=label(channels[names.index(along)]))
    ax.set_aspect("equal", adjustable="datalim")
    if along == "z" and not ax.yaxis_inverted():
        ax.invert_yaxis()
    spread_legend(ax, loc="best")
    return clean(ax)


def plot_zigzag(
    record: Record,
    models: Sequence[Fit | Prediction] = (),
    *,
    heading: str = "psi",
    rudder: str = "rudder",
    labels: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot heading and rudder of a zigzag in degrees, with the overshoot angles.

    The band around each model's heading holds 95 % of the noise, and of a
    prediction's uncertainty as well.
    Overshoots are written where the manoeuvre is one (two executes or more).

    Parameters
    ----------
    record : Record
        What was measured.
    models : sequence of Fit or Prediction
        What models say about a record of this name.
    heading : str
        Output that the zigzag reverses on: heading, or pitch in the diving plane.
    rudder : str
        Commanded input, or an output that holds the measured angle.
    labels : sequence of str, optional
        Names of the models.
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax, size=(7.6, 4.2))
    commands = {channel.name: channel for channel in record.channels.inputs}
    angle = record.input(rudder) if rudder in commands else record.output(rudder)
    held = rudder in commands and commands[rudder].interpolation == "hold"
    turned = record.output(heading)
    ax.plot(
        record.times, angle * DEGREE, color=NEUTRAL, lw=1.2, label=symbol_of(rudder),
        drawstyle="steps-post" if held else "default",
    )  # fmt: skip
    ax.plot(
        record.times, turned * DEGREE, ".", color=DATA, ms=2.5, rasterized=True,
        label=f"{symbol_of(heading)} measured",
    )  # fmt: skip
    column = record.channels.output_names.index(heading)
    for index, one in enumerate(models):
        look = model_style(index)
        rows, std = _said(one, record)
        model, half = rows[:, column] * DEGREE, TWO_SIDED_95 * std[:, column] * DEGREE
        ax.fill_between(
            record.times, model - half, model + half, color=look.colour, alpha=0.25, lw=0
        )
        ax.plot(
            record.times, model, color=look.colour, linestyle=look.dashes, lw=1.5,
            label=labels[index] if labels else f"model {index + 1}",
        )  # fmt: skip
    ax.axhline(0.0, color=TRUTH, lw=0.8)
    _write_overshoots(ax, record, turned, angle)
    ax.set(xlabel="time $t$ [s]", ylabel="angle [deg]", title=record.name)
    clean(ax)
    spread_legend(ax, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=4, markerscale=3)
    return ax


def _said(model: Fit | Prediction, record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Outputs of a model on a record and their standard deviation, ``(n_times, n_outputs)``."""
    row = model.dataset.names.index(record.name)
    if isinstance(model, Fit):
        return model.predictions[row], np.broadcast_to(model.sigma, model.predictions[row].shape)
    return model.outputs[row], model.std[row]


def _write_overshoots(ax: Axes, record: Record, turned: np.ndarray, angle: np.ndarray) -> None:
    present = np.isfinite(turned)
    try:
        indices = zigzag_indices(record.times[present], turned[present], angle[present])
    except DataError:
        return  # not a zigzag, or too short for indices: nothing to write
    peaks = zip(indices.executes[1:], indices.check_times, indices.overshoots, strict=False)
    for execute, check, overshoot in list(peaks)[:2]:
        row = int(np.nanargmin(np.where(present, np.abs(record.times - execute - check), np.nan)))
        side = 1 if turned[row] > 0 else -1
        ax.annotate(
            f"overshoot {overshoot * DEGREE:.1f}°",
            (record.times[row], turned[row] * DEGREE),
            xytext=(4, 6 * side),
            textcoords="offset points",
            va="bottom" if side > 0 else "top",
            fontsize=8.5,
        )
    ax.margins(y=0.12)
