"""The sea-trial card as one page: text, commands, track and the sea room that it needs."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from oed_sysid.design import Design
from oed_sysid.design.assurance import PredictedTracks
from oed_sysid.results.style import (
    COLOURS,
    DEGREE,
    NEUTRAL,
    TRUTH,
    clean,
    new_axes,
    spread_legend,
    symbol_of,
)

DANGER = "#b00020"
_A4 = (8.27, 11.69)
_TOP, _BOTTOM, _LEFT, _RIGHT = 0.975, 0.02, 0.055, 0.975
# Share of the page that pictures take, and the largest type, points.
_PICTURES, _TYPE = 0.26, 7.2
_HEADS = ("SEA TRIAL CARD", "STOP THE RUN", "ACCURACY TO EXPECT", "MISSING PHYSICS")
# Orders above this number stand in two columns, this many characters apart.
_MANY, _APART = 14, 54


def plot_tracks(tracks: PredictedTracks, *, ax: Axes | None = None) -> Axes:
    """Plot the drawn track, the range of plausible ones, and the sea room as a box.

    Parameters
    ----------
    tracks : PredictedTracks
        From :func:`~oed_sysid.design.predicted_tracks`.
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax, size=(5.4, 4.6))
    # Tracks over ground: north up, starboard to the right; in depth: along to the right, down down.
    right, up = (0, 1) if tracks.is_vertical else (1, 0)
    for number, track in enumerate(tracks.plausible):
        ax.plot(track[:, right], track[:, up], color=COLOURS[0], lw=0.5, alpha=0.35,
                label="other vehicles" if number == 0 else None)  # fmt: skip
    own = tracks.nominal
    ax.plot(own[:, right], own[:, up], color=TRUTH, lw=1.5, label="predicted")
    ax.plot(own[0, right], own[0, up], "o", mfc="white", mec=TRUTH, ms=6, label="start")
    room = tracks.room
    ax.add_patch(
        Rectangle(
            (room[right, 0], room[up, 0]), np.ptp(room[right]), np.ptp(room[up]), fill=False,
            ls="--", ec=NEUTRAL, label="sea room (95 %)",
        )
    )  # fmt: skip
    if tracks.is_vertical:
        ax.set(xlabel="along the course [m]", ylabel="depth [m]")
        ax.invert_yaxis()
    else:
        ax.set(xlabel="to starboard [m]", ylabel="ahead [m]")
        ax.set_aspect("equal", adjustable="datalim")
    clean(ax)
    spread_legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=6.5, ncols=2)
    return ax


def plot_orders(design: Design, *, ax: Axes | None = None) -> Axes:
    """Plot the designed commands over time, angles in degrees.

    Parameters
    ----------
    design : Design
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax, size=(5.4, 2.2))
    moved = [n for n in design.model.inputs if n.name not in design.experiment.constants]
    for index, channel in enumerate(moved):
        column = design.model.input_names.index(channel.name)
        angle = channel.unit == "rad"
        values = design.trajectory.inputs[:, column] * (DEGREE if angle else 1.0)
        unit = "deg" if angle else channel.unit
        ax.plot(design.trajectory.times, values, color=COLOURS[index % len(COLOURS)], lw=1.2,
                drawstyle="steps-post", label=f"{symbol_of(channel.name)} [{unit}]")  # fmt: skip
    ax.set(xlabel="time $t$ [s]", ylabel="orders")
    clean(ax)
    spread_legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=6.5, ncols=len(moved))
    return ax


def _folded(lines: list[str]) -> list[str]:
    """The card with a long list of orders in two columns."""
    if "RUN" not in lines:
        return lines
    first = lines.index("RUN") + 1
    last = next((i for i in range(first, len(lines)) if not lines[i]), len(lines))
    rows = lines[first:last]
    # The head of the list, and its last words on how to give the orders, stay as they are.
    head, orders, tail = rows[:1], rows[1:-1], rows[-1:]
    if len(orders) <= _MANY:
        return lines
    half = (len(orders) + 1) // 2
    right = [*orders[half:], *[""] * (2 * half - len(orders))]
    pairs = [f"{a:<{_APART}}{b}".rstrip() for a, b in zip(orders[:half], right, strict=True)]
    return [*lines[:first], *head, *pairs, *tail, *lines[last:]]


def figure_card(design: Design, tracks: PredictedTracks | None = None) -> Figure:
    """Compose the sea-trial card on one page of A4; danger in red above everything.

    Parameters
    ----------
    design : Design
    tracks : PredictedTracks, optional
        Where the run goes; without them the orders take the whole width.
    """
    figure = Figure(figsize=_A4)
    FigureCanvasAgg(figure)
    lines = _folded(design.sea_trial_card().split("\n"))
    if tracks is not None:
        lines += ["", "SEA ROOM", *(f"  {words}" for words in tracks.words())]
    height = _A4[1] * 72 * (_TOP - _BOTTOM - _PICTURES - 0.03)
    size = min(_TYPE, height / (1.25 * len(lines)))
    alarming = 0
    if lines[0].startswith("DANGER"):
        alarming = next(i for i, text in enumerate(lines) if text.startswith("SEA TRIAL CARD"))
    step = 1.25 * size / (72 * _A4[1])
    for number, text in enumerate(lines):
        headed = text.startswith(_HEADS) or text.isupper()
        bold = number < alarming or headed
        figure.text(
            _LEFT, _TOP - number * step, text, family="monospace", fontsize=size, va="top",
            color=DANGER if number < alarming else TRUTH, weight="bold" if bold else "normal",
        )  # fmt: skip
    bottom, tall = _BOTTOM + 0.035, _PICTURES - 0.04
    wide = _RIGHT - _LEFT
    orders = figure.add_axes((_LEFT + 0.03, bottom, (0.47 if tracks else 0.97) * wide, tall))
    plot_orders(design, ax=orders)
    if tracks is not None:
        plot_tracks(tracks, ax=figure.add_axes((_LEFT + 0.62 * wide, bottom, 0.38 * wide, tall)))
    for ax in figure.axes:
        ax.tick_params(labelsize=6.5)
        ax.xaxis.label.set_fontsize(7)
        ax.yaxis.label.set_fontsize(7)
    return figure
