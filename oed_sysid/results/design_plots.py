"""Pictures before a trial: one run, a programme of runs, and the sea-trial card.

What to command, what to expect, which parameters it will tell, and the sea room that it needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from oed_sysid.design import Candidate, Design, Programme
from oed_sysid.design.assurance import PredictedTracks
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information import Bode, SensitivityRanking, Spectrum
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.results.style import (
    COLOURS,
    NEUTRAL,
    TRUTH,
    between,
    clean,
    label,
    legend_above,
    new_axes,
    new_figure,
    row_axes,
    say,
    shown,
    spread_legend,
    symbol_of,
)
from oed_sysid.runtime.display import share
from oed_sysid.text.units import shown_unit

# What those on board watch, where no limit says so.
_TELLING = ("theta", "psi", "phi", "z", "u")
_MARKERS = ("o", "s", "^", "D")


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
    """
    rows = ranking.rows
    ax, places = row_axes(ax, [symbol_of(row.name) for row in rows], 6.8, tall=0.28, edge=1.4)
    finite = [r.error for r in rows if np.isfinite(r.error)]
    edge = 3 * max([*finite, 1.0])
    for position, row in zip(places, rows, strict=True):
        right = min(row.error, edge)
        ax.plot([row.error_alone, right], [position, position], color=NEUTRAL, lw=2, zorder=1)
        ax.plot(row.error_alone, position, "o", ms=5, mfc="white", mec=TRUTH,
                label="if all others were known")  # fmt: skip
        ax.plot(right, position, "o" if np.isfinite(row.error) else ">", ms=6, color=COLOURS[1],
                label="estimated together")  # fmt: skip
    ax.axvline(1.0, color=TRUTH, ls="--", lw=1)
    ax.set(xscale="log", xlabel="standard error / value [%]")
    clean(ax)
    _in_percent(ax)
    legend_above(ax, 2)
    known = sum(row.error < 1.0 for row in rows)
    return say(
        ax,
        f"{known} of {len(rows)} parameters have a standard error below their value; best known is "
        f"{rows[0].name} ({share(rows[0].error)}), least {rows[-1].name} "
        f"({share(rows[-1].error)}).",
    )


def plot_output_change(ranking: SensitivityRanking, *, ax: Axes | None = None) -> Axes:
    """Plot how much each parameter moves the outputs, as bars, the strongest above.

    What the bars leave out is whether other parameters move the outputs in the same way; that is
    in :func:`plot_sensitivity`.

    Parameters
    ----------
    ranking : SensitivityRanking
        From :func:`~oed_sysid.information.rank_parameters`.
    ax : Axes, optional
        Where to draw.
    """
    rows = [ranking.row(name) for name in ranking.by_output_change]
    ax, places = row_axes(ax, [symbol_of(row.name) for row in rows], 6.4, tall=0.28, edge=1.2)
    poor = [row.error >= 1.0 for row in rows]
    for flag, colour, hatch, words in (
        (False, COLOURS[1], "", "determined by these runs"),
        (True, COLOURS[5], "///", "error beyond the value"),
    ):
        chosen = [i for i, one in enumerate(poor) if one is flag]
        if chosen:
            lengths = [rows[i].output_change for i in chosen]
            ax.barh(places[chosen], lengths, height=0.62, color=colour, hatch=hatch,
                    edgecolor="0.25", lw=0.6, label=words)  # fmt: skip
    ax.set(xlabel=f"change of the outputs for {100 * ranking.change:g} % of the parameter [-]")
    clean(ax, grid="x")
    spread_legend(ax, loc="lower right")
    return say(
        ax,
        f"{rows[0].name} moves the outputs most ({rows[0].output_change:.3g}), {rows[-1].name} "
        f"least ({rows[-1].output_change:.3g}).",
    )


def plot_accuracy(design: Design | Programme, *, ax: Axes | None = None) -> Axes:
    """Plot expected relative errors: before, after the design, after standard manoeuvres.

    Bars of a programme are the range over other vehicles that are possible.

    Parameters
    ----------
    design : Design or Programme
        From :func:`~oed_sysid.design.design_experiment` or
        :func:`~oed_sysid.design.design_programme`.
    ax : Axes, optional
        Where to draw.
    """
    ranges, before = None, None
    if isinstance(design, Design):
        cases = [("designed", design.relative_errors)]
        cases += [(r.name, r.information.std_errors / design.sizes) for r in design.references]
        before = design.prior_errors
    else:
        cases = [("programme", design.relative_errors)]
        if (standard := design.standard) is not None:
            theirs = np.array([standard.errors[name] for name in design.names])
            cases.append(("standard trials, equal time", theirs))
        if design.prior is not None:
            before = design.prior.std_errors / design.sizes
        if design.spread is not None:
            ranges = (design.spread.lowest, design.spread.highest)
    looks = [(COLOURS[1], "o"), *((COLOURS[(2 * i) % 6], _MARKERS[1 + i % 3]) for i in range(9))]
    columns = [Column(*case, *look) for case, look in zip(cases, looks, strict=False)]
    if before is not None and np.isfinite(before).any():
        columns.append(Column("before", before, NEUTRAL, "|"))
    return draw_accuracy(design.names, columns, ranges=ranges, ax=ax)


def _beside(figure: Figure, grid: np.ndarray, design: Design | Programme) -> None:
    """Draw the accuracy in the last column of a grid."""
    spec = grid[0, -1].get_gridspec()
    for ax in grid[:, -1]:
        ax.remove()
    plot_accuracy(design, ax=figure.add_subplot(spec[:, -1]))


@dataclass(frozen=True)
class Column:
    """Relative errors of all parameters in one case, shape ``(n,)``, and their mark."""

    name: str
    errors: np.ndarray
    colour: str
    marker: str


def draw_accuracy(
    names: Sequence[str],
    columns: Sequence[Column],
    *,
    ranges: tuple[np.ndarray, np.ndarray] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw expected relative errors, one row per parameter, the largest of the first case below.

    Parameters
    ----------
    names : sequence of str
        Parameters.
    columns : sequence of Column
        Cases, the one that matters first.
    ranges : tuple of ndarray (n,), optional
        Lowest and highest errors of the first case on other vehicles.
    ax : Axes, optional
        Where to draw.
    """
    order = np.argsort(columns[0].errors)
    named = [symbol_of(names[i]) for i in order]
    ax, place = row_axes(ax, named, 6.8, tall=0.28, edge=1.4)
    if ranges is not None:
        ax.hlines(place, ranges[0][order], ranges[1][order], color=columns[0].colour, lw=4,
                  alpha=0.35, label="other vehicles")  # fmt: skip
    for one in columns:
        ax.plot(one.errors[order], place, one.marker, color=one.colour, ms=6, mew=1.3,
                label=one.name, ls="none")  # fmt: skip
    ax.set(xscale="log", xlabel="expected standard error / value [%]")
    clean(ax)
    _in_percent(ax)
    legend_above(ax, min(len(columns) + 1, 3))
    worst = order[-1]
    said = [f"{one.name} {share(one.errors[worst])}" for one in columns]
    return say(
        ax,
        f"Least certain is {names[worst]}; its expected standard error is {', '.join(said)} of "
        "the value.",
    )


def draw_motion(
    ax: Axes,
    channel: Input | Output | State,
    times: np.ndarray,
    values: np.ndarray,
    bounds: tuple[float, float] | None,
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
    bounds : tuple of float, optional
        Limits, SI.
    """
    turned = shown(channel, values)
    held = isinstance(channel, Input) and channel.interpolation == "hold"
    ax.plot(times, turned, color=COLOURS[1], lw=1.3,
            drawstyle="steps-post" if held else "default")  # fmt: skip
    for bound in shown(channel, bounds or ()):
        inside = abs(bound - turned).min() < 1.5 * (np.ptp(turned) + 1e-9)
        if np.isfinite(bound) and inside:
            ax.axhline(bound, color=TRUTH, ls="--", lw=0.9)
    ax.set_ylabel(label(channel, lines=2))
    clean(ax)
    say(ax, between(channel, turned))


def figure_design(design: Design) -> Figure:
    """Draw commands and predicted motion with their limits, and the accuracy.

    Parameters
    ----------
    design : Design
        The design.
    """
    model, run = design.model, design.trajectory
    limits = design.experiment.limits
    varied = [i for i in model.inputs if np.ptp(run.signal(i.name)) > 0]
    outputs = {o.name: o for o in model.outputs}
    moved = {s.name: s for s in model.states} | outputs
    names = dict.fromkeys((*limits.signals, *_TELLING, *moved))
    channels: list[Input | Output | State] = [*varied]
    channels += [moved[n] for n in names if n in moved][:3]
    figure, grid = new_figure(len(channels), 2, size=(11.0, 1.7 * max(len(channels), 3)))
    for ax, channel in zip(grid[:, 0], channels, strict=True):
        kind = limits.inputs if isinstance(channel, Input) else limits.signals
        bounds = kind.get(channel.name)
        draw_motion(ax, channel, run.times, run.signal(channel.name), bounds)
        ax.tick_params(labelbottom=ax is grid[-1, 0])
    grid[-1, 0].set_xlabel("time [s]")
    grid[0, 0].set_title("commands and predicted motion; dashed: limits")
    _beside(figure, grid, design)
    return figure


def plot_bode(bode: Bode, *, spectrum: Spectrum | None = None, ax: Axes | None = None) -> Axes:
    """Plot the gain of a model over frequency, and where an excitation has its power.

    Parameters
    ----------
    bode : Bode
        From :func:`~oed_sysid.information.bode`.
    spectrum : Spectrum, optional
        Of a command; its cumulative power is drawn on the right axis.
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax)
    ax.loglog(bode.frequencies, bode.gain, color=COLOURS[1], label=f"{bode.output}/{bode.input}")
    for pole in bode.poles:
        if abs(pole) > 1e-9:
            ax.axvline(abs(pole), color=NEUTRAL, lw=0.8, ls=":")
    ax.set(
        xlabel="angular frequency [rad/s]",
        ylabel=f"gain from {symbol_of(bode.input)} to {symbol_of(bode.output)}",
        xlim=(bode.frequencies[0], bode.frequencies[-1]),
    )
    clean(ax)
    if spectrum is not None:
        other = ax.twinx()
        other.plot(spectrum.frequencies, spectrum.share, color=COLOURS[0], ls="--")
        other.set(ylim=(0, 1.02), ylabel="share of the command's power below (dashed)")
    return ax


def _in_percent(ax: Axes) -> None:
    """Label a logarithmic axis of shares at 1, 2, 5, 10 ... per cent."""
    decades = np.diff(np.log10(ax.get_xlim()))[0]
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 2.5 else (1.0,)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{100 * share:.4g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())


_TELLING_OF_RUNS = ("theta", "psi", "phi", "r", "q", "z", "u")


def figure_programme(programme: Programme) -> Figure:
    """Draw command and motion of every run, and the accuracy after all of them.

    Parameters
    ----------
    programme : Programme
        From :func:`~oed_sysid.design.design_programme`.
    """
    runs = list({run.name: run for run in programme.runs}.values())
    figure, grid = new_figure(len(runs), 3, size=(13.0, 1.9 * max(len(runs), 2)))
    for row, run in enumerate(runs):
        _draw_run(programme, run, grid[row, 0], grid[row, 1])
    for column in (0, 1):
        grid[-1, column].set_xlabel("time [s]")
    _beside(figure, grid, programme)
    return figure


def _draw_run(programme: Programme, run: Candidate, left: Axes, right: Axes) -> None:
    model, limits = programme.model, run.experiment.limits
    record = simulate(model, run.experiment, noise=False)
    varied = [i for i in model.inputs if np.ptp(record.input(i.name)) > 0] or [model.inputs[0]]
    channels: dict[str, State | Output] = {o.name: o for o in model.outputs}
    names = [n for n in (*limits.signals, *_TELLING_OF_RUNS, *channels) if n in channels]
    shown: list[tuple[Axes, Input | State | Output, np.ndarray]] = [
        (left, varied[0], record.input(varied[0].name)),
        (right, channels[names[0]], record.output(names[0])),
    ]
    times = run.experiment.times
    number = [i for i, one in enumerate(programme.runs, start=1) if one.name == run.name]
    left.set_title(f"{', '.join(map(str, number))}: {run.name}", fontsize=9, loc="left")
    kept = programme.assurances.get(run.name)
    for ax, channel, values in shown:
        kind = limits.inputs if isinstance(channel, Input) else limits.signals
        draw_motion(ax, channel, times, values, kind.get(channel.name))
        if not isinstance(channel, Input) and kept is not None and channel.name in kept.ranges:
            factor = shown_unit(channel.unit)[0]
            for bound in kept.ranges[channel.name]:
                ax.axhline(factor * bound, color=NEUTRAL, ls=":", lw=1)


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
    legend_above(ax, 2, fontsize=6.5)
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
        values = shown(channel, design.trajectory.signal(channel.name))
        words = f"{symbol_of(channel.name)} [{shown_unit(channel.unit)[1]}]"
        ax.plot(design.trajectory.times, values, color=COLOURS[index % len(COLOURS)], lw=1.2,
                drawstyle="steps-post", label=words)  # fmt: skip
    ax.set(xlabel="time $t$ [s]", ylabel="orders")
    clean(ax)
    legend_above(ax, len(moved), fontsize=6.5)
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
