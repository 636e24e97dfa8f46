"""Pictures of records: signals, the check of a log, the track and the zigzag diagram."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError
from oed_sysid.evidence.check import Balance, LogCheck
from oed_sysid.experiments.indices import zigzag_indices
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.prediction import Prediction
from oed_sysid.physics.channels import Input, Output
from oed_sysid.results.prediction_plots import Said, draw_input, said_of
from oed_sysid.results.style import (
    COLOURS,
    DATA,
    DEGREE,
    NEUTRAL,
    TRUTH,
    abscissa,
    band,
    between,
    clean,
    label,
    legend_above,
    new_axes,
    new_figure,
    panels,
    row_axes,
    say,
    shown,
    span,
    spread_legend,
    symbol_of,
    zero,
)
from oed_sysid.runtime.display import TWO_SIDED_95
from oed_sysid.text.units import shown_unit


def figure_record(record: Record) -> Figure:
    """Draw every input and output of a record over time; angles in degrees.

    Commands are lines as they act between samples, measurements are dots; an
    output that was not measured is left out.

    Parameters
    ----------
    record : Record
        The record.
    """
    measured = [o for o in record.channels.outputs if np.isfinite(record.output(o.name)).any()]
    channels: list[Input | Output] = [*record.channels.inputs, *measured]
    columns = 1 if len(channels) < 4 else 2
    figure, axes = panels(len(channels), columns, (5.4, 1.9), sharex=True)
    for place, (ax, channel) in enumerate(zip(axes, channels, strict=True)):
        if isinstance(channel, Input):
            draw_input(ax, record, channel)
            values = shown(channel, record.input(channel.name))
        else:
            along, words = abscissa(record)
            values = shown(channel, record.output(channel.name))
            clean(ax).plot(along, values, ".", color=DATA, ms=2.0, rasterized=True)
            ax.set_xlabel(words)
        ax.set_ylabel(label(channel, lines=2))
        lowest = place + columns >= len(channels)
        ax.tick_params(labelbottom=lowest)
        if not lowest:
            ax.set_xlabel("")
        say(ax, between(channel, values))
    return figure


_BEFORE, _AFTER = COLOURS[0], COLOURS[1]
_MOST_RECORDS = 3
# Residuals beyond this many of the corrected ones are cut off, or the corrected ones vanish.
_TALL = 12.0


def plot_balances(found: LogCheck, ax: Axes | None = None) -> Axes:
    """Plot what each equation leaves of the changes of its left side, before and after.

    Parameters
    ----------
    found : LogCheck
        A check with equations.
    ax : Axes, optional
        Where to draw.
    """
    ax, rows = row_axes(ax, [one.relation for one in found.balances], 6.4, tall=0.5)
    before = np.array([100.0 * one.before for one in found.balances])
    after = np.array([100.0 * one.after for one in found.balances])
    ax.hlines(rows, np.minimum(before, after), np.maximum(before, after), color=NEUTRAL, lw=2.0)
    ax.plot(before, rows, "s", color=_BEFORE, ms=8, label="as logged")
    ax.plot(after, rows, "o", color=_AFTER, ms=6, mec="white", label="findings undone")
    ax.axvline(100.0, color=TRUTH, lw=1.0, ls=":")
    ax.set_xscale("log")
    low, high = min(after.min(), before.min()), max(before.max(), after.max(), 100.0)
    ax.set_xlim(low / 2.0, high * 2.0)
    ax.xaxis.set_major_formatter("{x:g}")
    ax.set_xlabel("unexplained share of the left side's changes [%]")
    legend_above(ax, 2)
    return clean(ax, grid="x")


def plot_balance(balance: Balance, record: str, ax: Axes | None = None) -> Axes:
    """Plot a signal minus the integral of the others, as logged and with the findings undone.

    Parameters
    ----------
    balance : Balance
        Of one equation.
    record : str
        Which record.
    ax : Axes, optional
        Where to draw.

    Notes
    -----
    The constant of integration is chosen so that the mean is zero. Where the log as it is leaves
    far more than the corrected one, the axis follows the corrected one, twelve times as wide.
    """
    ax = new_axes(ax, size=(6.4, 2.4))
    turn, unit = shown_unit(balance.unit)
    chosen = [part for part in balance.series if part[0] == record]
    shown: list[np.ndarray] = []
    for number, (_, times, before, after) in enumerate(chosen):
        start = times[0]
        names = ("as logged", "findings undone") if number == 0 else (None, None)
        same = np.allclose(before, after)
        ax.plot(times - start, turn * before, color=_BEFORE, lw=1.4, label=names[0])
        if not same:
            ax.plot(times - start, turn * after, color=_AFTER, lw=1.0, label=names[1])
        shown.append(turn * after)
    whole = np.concatenate(shown) if shown else np.zeros(1)
    reach = float(np.max(np.abs(whole))) or 1.0
    most = max((float(np.max(np.abs(turn * p[2]))) for p in chosen), default=reach)
    if most > _TALL * reach:
        ax.set_ylim(-_TALL * reach, _TALL * reach)
        ax.text(
            0.99, 0.97, f"as logged up to {most:.3g} {unit}", transform=ax.transAxes, ha="right",
            va="top", fontsize=8, color="0.3", bbox={"fc": "white", "ec": "none", "pad": 1.0},
        )  # fmt: skip
    else:
        ax.set_ylim(*span([-most, most]))
    zero(ax)
    ax.set(xlabel="time from the start [s]", ylabel=f"{symbol_of(balance.target)} left [{unit}]")
    return clean(ax)


def figure_check(found: LogCheck) -> Figure:
    """Draw the residuals of all equations, one row each, for up to three records.

    Parameters
    ----------
    found : LogCheck
        A check with equations.
    """
    names = found.records[:_MOST_RECORDS]
    n = len(found.balances)
    figure, axes = new_figure(n, len(names), size=(1.2 + 3.4 * len(names), 0.6 + 1.9 * n))
    for row, balance in enumerate(found.balances):
        for column, name in enumerate(names):
            ax = axes[row, column]
            plot_balance(balance, name, ax=ax)
            if row == 0:
                ax.set_title(name, fontsize=10)
            if row < n - 1:
                ax.set_xlabel("")
            if column:
                ax.set_ylabel("")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    for ax in axes.flat:
        more = ax.get_legend_handles_labels()
        if len(more[0]) > len(handles):
            handles, labels = more
    figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False, fontsize=9)
    return figure


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
    for one in said_of(models, record, labels) if models else ():
        ends = [shown(c, one.mean[:, k]) for c, k in zip(channels, columns, strict=True)]
        look, name = one.look, one.name
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
    legend_above(ax, markerscale=2)
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
    said = said_of(models, record, labels) if models else []
    for one in said:
        model, half = one.mean[:, column] * DEGREE, TWO_SIDED_95 * one.std[:, column] * DEGREE
        band(ax, record, model - half, model + half, one.look.colour)
        ax.plot(
            record.times, model, color=one.look.colour, linestyle=one.look.dashes, lw=1.5,
            label=one.name,
        )  # fmt: skip
    zero(ax)
    _write_overshoots(ax, record, heading, angle, said)
    ax.set(xlabel="time $t$ [s]", ylabel="angle [deg]", title=record.name)
    clean(ax)
    spread_legend(ax, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=4, markerscale=3)
    return ax


def _write_overshoots(
    ax: Axes, record: Record, heading: str, angle: np.ndarray, models: Sequence[Said]
) -> None:
    """Mark the first two overshoots where they are, and say those of the models."""
    column = record.channels.output_names.index(heading)
    turned = record.output(heading)
    said = []
    for name, one in [("measured", turned), *((m.name, m.mean[:, column]) for m in models)]:
        peaks = _overshoots(record, one, angle)
        if peaks:
            angles = " and ".join(f"{abs(past) * DEGREE:.1f}°" for _, _, past in peaks)
            said.append(f"{name}: overshoots {angles}.")
    for row, reversed_at, past in _overshoots(record, turned, angle):
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
