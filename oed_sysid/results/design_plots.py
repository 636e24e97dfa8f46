"""Pictures before a trial: one run, a programme of runs, and the sea-trial card.

What to command, what to expect, which parameters it will tell, and the sea room that it needs.
"""

from __future__ import annotations

from itertools import zip_longest

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter

from oed_sysid.design import Candidate, Design, Programme
from oed_sysid.design.assurance import PredictedTracks
from oed_sysid.design.card import TrialCard
from oed_sysid.experiments.experiment import Limits
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information import SensitivityRanking
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.results import style as draw
from oed_sysid.runtime.display import share
from oed_sysid.text.units import shown_unit

# What those on board watch, where no limit says so.
_TELLING = ("theta", "psi", "phi", "z", "u")


def plot_sensitivity(ranking: SensitivityRanking, *, ax: Axes | None = None) -> Axes:
    """Plot the relative error of every parameter, alone and with the others.

    The distance between the two dots of a row is what the other unknowns cost;
    beyond the line the error is larger than the value.

    Parameters
    ----------
    ranking : SensitivityRanking
        From :func:`~oed_sysid.information.rank_parameters`.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    rows = ranking.rows
    ax, places = draw.row_axes(
        ax, [draw.symbol_of(row.name) for row in rows], 6.8, tall=0.28, edge=1.4
    )
    finite = [r.error for r in rows if np.isfinite(r.error)]
    edge = 3 * max([*finite, 1.0])
    for position, row in zip(places, rows, strict=True):
        right = min(row.error, edge)
        ax.plot([row.error_alone, right], [position, position], color=draw.NEUTRAL, lw=2, zorder=1)
        ax.plot(row.error_alone, position, "o", ms=5, mfc="white", mec=draw.TRUTH,
                label="if all others were known")  # fmt: skip
        ax.plot(right, position, "o" if np.isfinite(row.error) else ">", ms=6,
                color=draw.COLOURS[1], label="estimated together")  # fmt: skip
    ax.axvline(1.0, color=draw.TRUTH, ls="--", lw=1)
    _in_percent(ax)
    known = sum(row.error < 1.0 for row in rows)
    return draw.done(
        ax,
        f"{known} of {len(rows)} parameters have a standard error below their value; best known is "
        f"{rows[0].name} ({share(rows[0].error)}), least {rows[-1].name} "
        f"({share(rows[-1].error)}).",
        legend=2,
        xlabel="standard error / value [%]",
    )


def plot_accuracy(design: Design | Programme, *, ax: Axes | None = None) -> Axes:
    """Plot expected relative errors: before, after the design, after standard manoeuvres.

    Bars are the range over other vehicles that are possible.

    Parameters
    ----------
    design : Design or Programme
        From :func:`~oed_sysid.design.design_experiment` or
        :func:`~oed_sysid.design.design_programme`.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    title = "designed" if isinstance(design, Design) else "programme"
    cases, before = [(title, design.relative_errors), *design.others.items()], design.prior_errors
    order = np.argsort(design.relative_errors)  # the largest below
    named = [draw.symbol_of(design.names[i]) for i in order]
    ax, rows = draw.row_axes(ax, named, 6.8, tall=0.28, edge=1.4)
    if (spread := design.spread) is not None:
        ax.hlines(rows, spread.lowest[order], spread.highest[order], color=draw.COLOURS[1], lw=4,
                  alpha=0.35, label="other vehicles")  # fmt: skip
    looks = [(draw.COLOURS[1], "o"), *((draw.COLOURS[2 * i % 6], "s^D"[i % 3]) for i in range(9))]
    if np.isfinite(before).any():
        looks[len(cases) :] = [(draw.NEUTRAL, "|")]
        cases.append(("before", before))
    for (name, errors), (colour, marker) in zip(cases, looks, strict=False):
        ax.plot(errors[order], rows, marker, color=colour, ms=6, mew=1.3, label=name)
    _in_percent(ax)
    said = ", ".join(f"{name} {share(errors[order[-1]])}" for name, errors in cases)
    return draw.done(
        ax,
        f"Least certain is {design.names[order[-1]]}; its expected standard error is {said} of "
        "the value.",
        legend=min(len(cases) + 1, 3),
        xlabel="expected standard error / value [%]",
    )


def _beside(figure: Figure, grid: np.ndarray, design: Design | Programme) -> None:
    """Draw the accuracy in the last column of a grid."""
    spec = grid[0, -1].get_gridspec()
    for ax in grid[:, -1]:
        ax.remove()
    plot_accuracy(design, ax=figure.add_subplot(spec[:, -1]))


def draw_motion(
    ax: Axes,
    channel: Input | Output | State,
    times: np.ndarray,
    values: np.ndarray,
    limits: Limits,
) -> None:
    """Draw a command or a motion in the unit that people read, with limits where they are near.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    channel : Input, Output or State
        What it is.
    times, values : ndarray (n_times,)
        Over time, SI.
    limits : Limits
        Those of the run.
    """
    turned = draw.shown(channel, values)
    ax.plot(times, turned, color=draw.COLOURS[1], lw=1.3, **draw.stepped(channel))
    ranges = limits.inputs if isinstance(channel, Input) else limits.signals
    for bound in draw.shown(channel, ranges.get(channel.name, ())):
        if np.isfinite(bound) and abs(bound - turned).min() < 1.5 * (np.ptp(turned) + 1e-9):
            ax.axhline(bound, color=draw.TRUTH, ls="--", lw=0.9)
    draw.done(ax, draw.between(channel, turned), ylabel=draw.label(channel, lines=2))


def figure_design(design: Design) -> Figure:
    """Draw commands and predicted motion with their limits, and the accuracy.

    Parameters
    ----------
    design : Design
        The design.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    model, run = design.model, design.trajectory
    limits = design.experiment.limits
    moved: dict[str, State | Output] = {one.name: one for one in model.states}
    moved |= {one.name: one for one in model.outputs}
    names = dict.fromkeys(n for n in (*limits.signals, *_TELLING, *moved) if n in moved)
    channels: list[Input | Output | State] = [
        *(one for one in model.inputs if np.ptp(run.signal(one.name)) > 0),
        *(moved[name] for name in list(names)[:3]),
    ]
    figure, grid = draw.new_figure(len(channels), 2, size=(11.0, 1.7 * max(len(channels), 3)))
    for ax, channel in zip(grid[:, 0], channels, strict=True):
        draw_motion(ax, channel, run.times, run.signal(channel.name), limits)
        ax.tick_params(labelbottom=ax is grid[-1, 0])
    grid[-1, 0].set_xlabel("time [s]")
    grid[0, 0].set_title("commands and predicted motion; dashed: limits")
    _beside(figure, grid, design)
    return figure


def _in_percent(ax: Axes) -> None:
    """Make the axis of shares logarithmic, and label it at 1, 2, 5, 10 ... per cent."""
    ax.set_xscale("log")
    n_decades = np.diff(np.log10(ax.get_xlim()))[0]
    draw.decades(ax, "x", (1.0, 2.0, 5.0) if n_decades < 2.5 else (1.0,))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{100 * share:.4g}"))


def figure_programme(programme: Programme) -> Figure:
    """Draw command and motion of every run, and the accuracy after all of them.

    Parameters
    ----------
    programme : Programme
        From :func:`~oed_sysid.design.design_programme`.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    runs = {run.name: run for run in programme.runs}
    figure, grid = draw.new_figure(len(runs), 3, size=(13.0, 1.9 * max(len(runs), 2)))
    for (left, right, _), run in zip(grid, runs.values(), strict=True):
        places = [str(i) for i, one in enumerate(programme.runs, start=1) if one.name == run.name]
        left.set_title(f"{', '.join(places)}: {run.name}", fontsize=9, loc="left")
        _draw_run(programme, run, left, right)
    for ax in grid[-1, :2]:
        ax.set_xlabel("time [s]")
    _beside(figure, grid, programme)
    return figure


def _draw_run(programme: Programme, run: Candidate, left: Axes, right: Axes) -> None:
    """Draw the command of a run, and the motion that tells most, with the range that is kept."""
    model, limits, times = programme.model, run.experiment.limits, run.experiment.times
    record = simulate(model, run.experiment, noise=False)
    varied = [one for one in model.inputs if one.name not in record.constant_channels]
    command = (varied or model.inputs)[0]
    draw_motion(left, command, times, record.input(command.name), limits)
    outputs = {one.name: one for one in model.outputs}
    motion = next(outputs[n] for n in (*limits.signals, *_TELLING, *outputs) if n in outputs)
    draw_motion(right, motion, times, record.output(motion.name), limits)
    kept = programme.assurances.get(run.name)
    for bound in kept.ranges.get(motion.name, ()) if kept is not None else ():
        right.axhline(float(draw.shown(motion, bound)), color=draw.NEUTRAL, ls=":", lw=1)


DANGER = "#b00020"
_HEADS = ("SEA TRIAL CARD", "STOP THE RUN", "ACCURACY TO EXPECT")


def plot_tracks(tracks: PredictedTracks, *, ax: Axes | None = None) -> Axes:
    """Plot the drawn track, the range of plausible ones, and the sea room as a box.

    Parameters
    ----------
    tracks : PredictedTracks
        Of :attr:`oed_sysid.design.Assurance.tracks`.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(5.4, 4.6))
    # Tracks over ground: north up, starboard to the right; in depth: along to the right, down down.
    right_up = [0, 1] if tracks.is_vertical else [1, 0]
    others = tracks.plausible[:60, :, right_up].T
    ax.plot(*others, color=draw.COLOURS[0], lw=0.5, alpha=0.35, label="other vehicles")
    own, room = tracks.nominal[:, right_up], tracks.room[right_up]
    ax.plot(*own.T, color=draw.TRUTH, lw=1.5, label="predicted")
    ax.plot(*own[0], "o", mfc="white", mec=draw.TRUTH, ms=6, label="start")
    wide, long = np.ptp(room, axis=1)
    box = (room[0, 0], room[1, 0]), wide, long
    ax.add_patch(Rectangle(*box, fill=False, ls="--", ec=draw.NEUTRAL, label="sea room (95 %)"))
    if tracks.is_vertical:
        words = ("along the course [m]", "depth [m]")
        ax.invert_yaxis()
    else:
        words = ("to starboard [m]", "ahead [m]")
        ax.set_aspect("equal", adjustable="datalim")
    draw.legend_above(ax, 2, fontsize=6.5)
    many = len(tracks.plausible)
    said = f"95 % of {many} vehicles stay in a sea room of {wide:.0f} by {long:.0f} m."
    return draw.done(ax, said, xlabel=words[0], ylabel=words[1])


def plot_orders(design: Design | TrialCard, *, ax: Axes | None = None) -> Axes:
    """Plot the designed commands over time, angles in degrees.

    Parameters
    ----------
    design : Design or TrialCard
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(5.4, 2.2))
    moved = [n for n in design.model.inputs if n.name not in design.experiment.constants]
    said = []
    for index, channel in enumerate(moved):
        values = draw.shown(channel, design.trajectory.signal(channel.name))
        words = f"{draw.symbol_of(channel.name)} [{shown_unit(channel.unit)[1]}]"
        colour = draw.model_style(index).colour
        ax.plot(design.trajectory.times, values, color=colour, lw=1.2, drawstyle="steps-post",
                label=words)  # fmt: skip
        said.append(draw.between(channel, values))
    draw.legend_above(ax, len(moved), fontsize=6.5)
    return draw.done(ax, " ".join(said), xlabel="time $t$ [s]", ylabel="orders")


def _folded(lines: list[str], most: int = 14) -> list[str]:
    """The card with more orders than so many in two columns."""
    if "RUN" not in lines:
        return lines
    first = lines.index("RUN") + 1
    last = next((i for i in range(first, len(lines)) if not lines[i]), len(lines))
    rows = lines[first:last]
    # The head of the list, and its last words on how to give the orders, stay as they are.
    head, orders, tail = rows[:1], rows[1:-1], rows[-1:]
    if len(orders) <= most:
        return lines
    half = (len(orders) + 1) // 2
    wide = 4 + max(map(len, orders))
    pairs = [f"{a:<{wide}}{b}".rstrip() for a, b in zip_longest(orders[:half], orders[half:],
                                                                fillvalue="")]  # fmt: skip
    return [*lines[:first], *head, *pairs, *tail, *lines[last:]]


def figure_card(card: TrialCard) -> Figure:
    """Compose the sea-trial card on one page of A4; danger in red above everything.

    Without tracks the orders take the whole width.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    figure = Figure(figsize=(8.27, 11.69))  # A4, inches
    FigureCanvasAgg(figure)
    edge, pictures, tracks = 0.035, 0.26, card.tracks  # shares of the page
    _write_lines(figure, _folded(card.text().split("\n")), edge, pictures)
    low, tall, wide = 2 * edge, pictures - edge, 0.94 - 2 * edge
    left = 0.03 + edge
    plot_orders(card, ax=figure.add_axes((left, low, (0.47 if tracks else 1.0) * wide, tall)))
    if tracks is not None:
        plot_tracks(tracks, ax=figure.add_axes((left + 0.62 * wide, low, 0.38 * wide, tall)))
    for ax in figure.axes:
        ax.tick_params(labelsize=6.5)
        ax.xaxis.label.set_fontsize(7)
        ax.yaxis.label.set_fontsize(7)
    return figure


def _write_lines(figure: Figure, lines: list[str], edge: float, pictures: float) -> None:
    """Write a card on its page, as large as it fits above the pictures, at most 7.2 points."""
    height = 72 * figure.get_figheight()
    size = min(7.2, height * (0.98 - 2 * edge - pictures) / (1.25 * len(lines)))
    # Danger stands above the head of the card.
    head = next((i for i, text in enumerate(lines) if text.startswith(_HEADS[0])), 0)
    for number, text in enumerate(lines):
        alarming = number < head
        bold = alarming or text.startswith(_HEADS) or text.isupper()
        figure.text(
            edge, 1.0 - edge - 1.25 * size / height * number, text, family="monospace",
            fontsize=size, va="top", color=DANGER if alarming else draw.TRUTH,
            weight="bold" if bold else "normal",
        )  # fmt: skip
