"""Pictures that seafarers know: the track in a plane and the zigzag diagram."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from oed_sysid.data.dataset import Record
from oed_sysid.errors import DataError
from oed_sysid.experiments.indices import zigzag_indices
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.prediction import Prediction
from oed_sysid.results.style import (
    DATA,
    DEGREE,
    NEUTRAL,
    TRUTH,
    clean,
    label,
    model_style,
    new_axes,
    say,
    shown,
    spread_legend,
    symbol_of,
)
from oed_sysid.runtime.display import TWO_SIDED_95
from oed_sysid.text.units import shown_unit


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
    return _in_plane(ax, record, models, (across, along), labels)


def plot_phase(
    record: Record,
    models: Sequence[Fit | Prediction] = (),
    *,
    across: str,
    along: str,
    labels: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot one signal against another: loops show lags and coupling, a spiral shows damping.

    Parameters
    ----------
    record : Record
        What was measured.
    models : sequence of Fit or Prediction
        What models say about a record of this name.
    across, along : str
        Outputs on the rightward and on the upward axis, such as heading and yaw rate.
    labels : sequence of str, optional
        Names of the models.
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax, size=(5.4, 4.4))
    _in_plane(ax, record, models, (across, along), labels, equal=False)
    return ax


def _in_plane(
    ax: Axes,
    record: Record,
    models: Sequence[Fit | Prediction],
    names: tuple[str, str],
    labels: Sequence[str] | None,
    *,
    equal: bool = True,
) -> Axes:
    """Draw the second named output over the first, measured and of the models."""
    outputs = record.channels.output_names
    columns = [outputs.index(name) for name in names]
    channels = [record.channels.outputs[column] for column in columns]
    right, up = (shown(c, record.output(c.name)) for c in channels)
    ax.plot(right, up, ".", color=DATA, ms=3, label="measured", rasterized=True)
    said = []
    for index, one in enumerate(models):
        look = model_style(index)
        rows, _ = _said(one, record)
        ends = [shown(c, rows[:, k]) for c, k in zip(channels, columns, strict=True)]
        name = labels[index] if labels else f"model {index + 1}"
        ax.plot(*ends, color=look.colour, linestyle=look.dashes, lw=1.6, label=name)
        off = np.hypot(ends[0] - right, ends[1] - up)
        same = channels[0].unit == channels[1].unit
        if same and np.isfinite(off).any():
            unit = shown_unit(channels[0].unit)[1]
            said.append(f"{name} is at most {np.nanmax(off):.3g} {unit} away".rstrip() + ".")
    start = np.flatnonzero(np.isfinite(up + right))[:1]
    ax.plot(right[start], up[start], "o", mfc="white", mec=TRUTH, ms=7, label="start")
    ax.set(xlabel=label(channels[0]), ylabel=label(channels[1]))
    if equal:
        ax.set_aspect("equal", adjustable="datalim")
        if names[1] == "z" and not ax.yaxis_inverted():
            ax.invert_yaxis()
    spread_legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, markerscale=2)
    return say(clean(ax), " ".join([f"{record.name}: {names[1]} over {names[0]}.", *said]))


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
    _write_overshoots(ax, record, turned, angle, models, column, labels)
    ax.set(xlabel="time $t$ [s]", ylabel="angle [deg]", title=record.name)
    clean(ax)
    spread_legend(ax, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=4, markerscale=3)
    return ax


def _said(model: Fit | Prediction, record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Outputs of a model on a record and their standard deviation, ``(n_times, n_outputs)``."""
    if record.name not in model.dataset.names:
        raise DataError(
            f"A model was not fitted to record {record.name!r} and says nothing about it (it knows "
            f"{', '.join(model.dataset.names)}). Give fit.predict(Dataset((record,))) instead."
        )
    row = model.dataset.names.index(record.name)
    if isinstance(model, Fit):
        return model.predictions[row], np.broadcast_to(model.sigma, model.predictions[row].shape)
    return model.outputs[row], model.std[row]


def _write_overshoots(
    ax: Axes,
    record: Record,
    turned: np.ndarray,
    angle: np.ndarray,
    models: Sequence[Fit | Prediction],
    column: int,
    labels: Sequence[str] | None,
) -> None:
    """Mark the first two overshoots where they are, and say those of the models."""
    said = []
    for index, (name, heading) in enumerate(
        [
            ("measured", turned),
            *(
                (labels[k] if labels else f"model {k + 1}", _said(one, record)[0][:, column])
                for k, one in enumerate(models)
            ),
        ]
    ):
        peaks = _overshoots(record, heading, angle)
        if not peaks:
            continue
        angles = " and ".join(f"{abs(past) * DEGREE:.1f}°" for _, _, past in peaks)
        said.append(f"{name}: overshoots {angles}.")
        if index == 0:
            for row, reversed_at, past in peaks:
                _mark(ax, record.times[row], reversed_at, turned[row], past)
    say(ax, " ".join([f"{record.name}.", *said]))
    ax.margins(y=0.16)


def _overshoots(
    record: Record, turned: np.ndarray, angle: np.ndarray
) -> list[tuple[int, float, float]]:
    """Sample of the first two peaks, heading at the execute before, and overshoot, rad."""
    present = np.isfinite(turned)
    if not present.any():
        return []
    times = record.times[present]
    try:
        indices = zigzag_indices(times, turned[present], angle[present])
    except DataError:
        return []  # not a zigzag, or too short for indices: nothing to write
    peaks = zip(indices.executes[1:], indices.check_times, indices.overshoots, strict=False)
    found = []
    for execute, check, overshoot in list(peaks)[:2]:
        row = int(np.nanargmin(np.where(present, np.abs(record.times - execute - check), np.nan)))
        begun = float(np.interp(execute, times, turned[present]))
        found.append((row, begun, float(overshoot)))
    return found


def _mark(ax: Axes, time: float, begun: float, peak: float, past: float) -> None:
    """Stroke from the heading at which the rudder was reversed to the peak."""
    side = 1 if peak > 0 else -1
    ends = (begun * DEGREE, peak * DEGREE)
    ax.plot((time, time), ends, color=TRUTH, lw=1.2, marker="_", ms=9, mew=1.2)
    ax.annotate(
        f"overshoot {abs(past) * DEGREE:.1f}°", (time, peak * DEGREE), xytext=(4, 6 * side),
        textcoords="offset points", va="bottom" if side > 0 else "top", fontsize=8.5,
    )  # fmt: skip
