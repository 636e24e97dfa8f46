"""Pictures of records: signals, the check of a log, the track and the zigzag diagram."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError
from oed_sysid.evidence.check import Balance, LogCheck
from oed_sysid.experiments.indices import zigzag_indices
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.prediction import Prediction
from oed_sysid.physics.channels import Input
from oed_sysid.results import style as draw
from oed_sysid.results.fit_plots import chart_output, chart_signal, said_of
from oed_sysid.text.units import shown_unit


def figure_record(record: Record) -> Figure:
    """Draw every input and output of a record over time; angles in degrees.

    Commands are lines as they act between samples, measurements are dots; an
    output that was not measured is left out.

    Parameters
    ----------
    record : Record
        The record.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    channels = [one for one in record.channels.all if one.name not in record.missing_outputs]
    columns = 1 if len(channels) < 4 else 2
    figure, axes = draw.panels(len(channels), columns, (5.4, 1.9), sharex=True)
    for place, (ax, channel) in enumerate(zip(axes, channels, strict=True)):
        chart_signal(record, channel).on(ax, legend=None)
        lowest = place + columns >= len(channels)
        ax.tick_params(labelbottom=lowest)
        if not lowest:
            ax.set_xlabel("")
    return figure


# How a signal is drawn as logged, and with the findings of a check undone.
_BEFORE: dict[str, Any] = {"color": draw.COLOURS[0], "label": "as logged"}
_AFTER: dict[str, Any] = {"color": draw.COLOURS[1], "label": "findings undone"}


def plot_balances(found: LogCheck, ax: Axes | None = None) -> Axes:
    """Plot what each equation leaves of the changes of its left side, before and after.

    Parameters
    ----------
    found : LogCheck
        A check with equations.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax, rows = draw.row_axes(ax, [one.relation for one in found.balances], 6.4, tall=0.5)
    both = 100.0 * np.array([(one.before, one.after) for one in found.balances])
    ax.hlines(rows, both.min(axis=1), both.max(axis=1), color=draw.NEUTRAL, lw=2.0)
    ax.plot(both[:, 0], rows, "s", ms=8, **_BEFORE)
    ax.plot(both[:, 1], rows, "o", ms=6, mec="white", **_AFTER)
    ax.axvline(100.0, color=draw.TRUTH, lw=1.0, ls=":")
    ax.set(xscale="log", xlim=(both.min() / 2.0, 2.0 * max(both.max(), 100.0)))
    ax.xaxis.set_major_formatter("{x:g}")
    words = "unexplained share of the left side's changes [%]"
    rest = "{:.3g} % of {} is unexplained as logged, {:.3g} % with the findings undone.".format
    shares = zip(found.balances, both, strict=True)
    said = " ".join(rest(before, one.relation, after) for one, (before, after) in shares)
    return draw.done(ax, said, grid="x", legend=2, xlabel=words)


def plot_balance(
    balance: Balance, record: str, ax: Axes | None = None, *, tall: float = 12.0
) -> Axes:
    """Plot a signal minus the integral of the others, as logged and with the findings undone.

    Parameters
    ----------
    balance : Balance
        Of one equation.
    record : str
        Which record.
    ax : Axes, optional
        Where to draw.
    tall : float
        Residuals beyond this many of the corrected ones are cut off, or the corrected ones vanish.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.

    Notes
    -----
    The constant of integration is chosen so that the mean is zero.
    """
    ax = draw.new_axes(ax, size=(6.4, 2.4))
    turn, unit = shown_unit(balance.unit)
    chosen = [part for part in balance.series if part[0] == record]
    for _, times, before, after in chosen:
        ax.plot(times - times[0], turn * before, lw=1.4, **_BEFORE)
        if not np.allclose(before, after):
            ax.plot(times - times[0], turn * after, lw=1.0, **_AFTER)
    most, reach = (
        turn * max((float(np.abs(part[place]).max()) for part in chosen), default=0.0) or 1.0
        for place in (2, 3)
    )
    if most > tall * reach:
        ax.set_ylim(-tall * reach, tall * reach)
        ax.text(
            0.99, 0.97, f"as logged up to {most:.3g} {unit}", transform=ax.transAxes, ha="right",
            va="top", fontsize=8, color="0.3", bbox={"fc": "white", "ec": "none", "pad": 1.0},
        )  # fmt: skip
    else:
        ax.set_ylim(*draw.span([-most, most]))
    draw.zero(ax)
    words = f"{draw.symbol_of(balance.target)} left [{unit}]"
    said = (
        f"{balance.relation} in {record}: up to {most:.3g} {unit} is left as logged, "
        f"{reach:.3g} {unit} with the findings undone."
    )
    return draw.done(ax, said, xlabel="time from the start [s]", ylabel=words)


def figure_check(found: LogCheck, *, n_shown: int = 3) -> Figure:
    """Draw the residuals of all equations, one row each, one column per record.

    Parameters
    ----------
    found : LogCheck
        A check with equations.
    n_shown : int
        How many records; more beside each other are not read.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.

    Raises
    ------
    DataError
        If no equation relates the signals.
    """
    if not found.balances:
        raise DataError(
            "No equation relates the signals of these records, so there are no residuals to draw. "
            "Draw the records themselves: figure_record."
        )
    names = found.records[:n_shown]
    n = len(found.balances)
    figure, axes = draw.new_figure(n, len(names), size=(1.2 + 3.4 * len(names), 0.6 + 1.9 * n))
    for (balance, name), ax in zip(product(found.balances, names), axes.flat, strict=True):
        plot_balance(balance, name, ax=ax)
    for ax, name in zip(axes[0], names, strict=True):
        ax.set_title(name, fontsize=10)
    for ax in axes[:-1].flat:
        ax.set_xlabel("")
    for ax in axes[:, 1:].flat:
        ax.set_ylabel("")
    lines = {line.get_label(): line for ax in axes.flat for line in ax.get_lines()}
    handles = [lines[one["label"]] for one in (_BEFORE, _AFTER) if one["label"] in lines]
    figure.legend(handles=handles, loc="outside upper right", ncols=2, frameon=False, fontsize=9)
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
    """Plot one output over another, as measured and as the fitted models follow it.

    Two of one unit have one scale, so that a path in a plane keeps its proportions; of others it is
    a phase plane, in which loops show lags and coupling, and a spiral shows damping.

    Parameters
    ----------
    record : Record
        What was measured.
    models : sequence of Fit or Prediction
        What models say about a record of this name.
    along, across : str
        Outputs on the upward and on the rightward axis: north and east, depth (drawn downwards) and
        distance, or yaw rate and heading.
    labels : sequence of str, optional
        Names of the models.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    columns = [record.channels.output_names.index(name) for name in (across, along)]
    channels = [record.channels.outputs[column] for column in columns]
    alike = channels[0].unit == channels[1].unit
    ax = draw.new_axes(ax, size=(5.4, 5.4 if alike else 4.4))
    if alike:
        ax.set_aspect("equal", adjustable="datalim")
    ax.yaxis.set_inverted(along == "z")
    right, up = (draw.shown(c, record.output(c.name)) for c in channels)
    ax.plot(right, up, ".", color=draw.DATA, ms=3, label="measured", rasterized=True)
    said = []
    for one in said_of(models, record, labels):
        ends = [draw.shown(c, one.mean[:, k]) for c, k in zip(channels, columns, strict=True)]
        ax.plot(*ends, **one.look.line, lw=1.6, label=one.name)
        off = np.hypot(ends[0] - right, ends[1] - up)
        if alike and np.isfinite(off).any():
            unit = shown_unit(channels[0].unit)[1]
            said.append(f"{one.name} is at most {np.nanmax(off):.3g} {unit} away".rstrip() + ".")
    start = np.flatnonzero(np.isfinite(up + right))[:1]
    ax.plot(right[start], up[start], "o", mfc="white", mec=draw.TRUTH, ms=7, label="start")
    draw.legend_above(ax, markerscale=2)
    said.insert(0, f"{record.name}: {along} over {across}.")
    right_label, up_label = map(draw.label, channels)
    return draw.done(ax, " ".join(said), xlabel=right_label, ylabel=up_label)


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

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(7.6, 4.2))
    channel = next(one for one in record.channels.all if one.name == rudder)
    angle = record.input(rudder) if isinstance(channel, Input) else record.output(rudder)
    column = record.channels.output_names.index(heading)
    turned = record.output(heading)
    ax.plot(
        record.times, angle * draw.DEGREE, color=draw.NEUTRAL, lw=1.2,
        label=draw.symbol_of(rudder), **draw.stepped(channel),
    )  # fmt: skip
    said_by = said_of(models, record, labels)
    chart_output(record, said_by, heading).on(ax, legend=None)
    headings = [("measured", turned), *((one.name, one.mean[:, column]) for one in said_by)]
    draw.zero(ax)
    said = [f"{record.name}."]
    for name, followed in headings:
        if peaks := _overshoots(record, followed, angle):
            angles = " and ".join(f"{abs(past) * draw.DEGREE:.1f}°" for _, _, past in peaks)
            said.append(f"{name}: overshoots {angles}.")
    for row, reversed_at, past in _overshoots(record, turned, angle):
        _mark(ax, record.times[row], reversed_at, turned[row], past)
    ax.margins(y=0.16)
    return draw.done(
        ax, " ".join(said), xlabel="time $t$ [s]", ylabel="angle [deg]", title=record.name,
        legend={"loc": "upper center", "bbox_to_anchor": (0.5, -0.13), "ncols": 4,
                "markerscale": 3},
    )  # fmt: skip


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
    ends = np.degrees((begun, peak))
    ax.plot((time, time), ends, color=draw.TRUTH, lw=1.2, marker="_", ms=9, mew=1.2)
    ax.annotate(
        f"overshoot {np.degrees(abs(past)):.1f}°", (time, ends[1]), xytext=(4, 6 * side),
        textcoords="offset points", va="bottom" if side > 0 else "top", fontsize=8.5,
    )  # fmt: skip
