"""Pictures before a trial: what to command, what to expect, which parameters it will tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from oed_sysid.design import Design
from oed_sysid.information import Bode, SensitivityRanking, Spectrum
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.results.style import (
    COLOURS,
    NEUTRAL,
    TRUTH,
    between,
    clean,
    label,
    new_axes,
    new_figure,
    say,
    shown,
    spread_legend,
    symbol_of,
)

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
    rows = ranking.rows[::-1]
    ax = new_axes(ax, size=(6.8, 1.4 + 0.28 * len(rows)))
    finite = [r.error for r in rows if np.isfinite(r.error)]
    edge = 3 * max([*finite, 1.0])
    for position, row in enumerate(rows):
        right = min(row.error, edge)
        ax.plot([row.error_alone, right], [position, position], color=NEUTRAL, lw=2, zorder=1)
        ax.plot(row.error_alone, position, "o", ms=5, mfc="white", mec=TRUTH,
                label="if all others were known")  # fmt: skip
        ax.plot(right, position, "o" if np.isfinite(row.error) else ">", ms=6, color=COLOURS[1],
                label="estimated together")  # fmt: skip
    ax.axvline(1.0, color=TRUTH, ls="--", lw=1)
    ax.set(xscale="log", xlabel="standard error / value [%]", ylim=(-0.7, len(rows) - 0.3))
    ax.set_yticks(range(len(rows)), [symbol_of(row.name) for row in rows])
    clean(ax)
    _in_percent(ax)
    spread_legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    known = sum(row.error < 1.0 for row in rows)
    return say(
        ax,
        f"{known} of {len(rows)} parameters have a standard error below their value; best known is "
        f"{rows[-1].name} ({100 * rows[-1].error:.2g} %), least {rows[0].name} "
        f"({100 * rows[0].error:.2g} %).",
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
    rows = [ranking.row(name) for name in reversed(ranking.by_output_change)]
    ax = new_axes(ax, size=(6.4, 1.2 + 0.28 * len(rows)))
    places = np.arange(len(rows))
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
    ax.set_yticks(places, [symbol_of(row.name) for row in rows])
    clean(ax)
    ax.grid(False, axis="y")
    spread_legend(ax, loc="lower right")
    return say(
        ax,
        f"{rows[-1].name} moves the outputs most ({rows[-1].output_change:.3g}), {rows[0].name} "
        f"least ({rows[0].output_change:.3g}).",
    )


def plot_accuracy(design: Design, *, ax: Axes | None = None) -> Axes:
    """Plot expected relative errors: before, after the design, after standard manoeuvres.

    Parameters
    ----------
    design : Design
        From :func:`~oed_sysid.design.design_experiment`.
    ax : Axes, optional
        Where to draw.
    """
    columns = [Column("designed", design.relative_errors, COLOURS[1], "o")]
    for index, reference in enumerate(design.references):
        errors = reference.information.std_errors / design.sizes
        colour, marker = COLOURS[(2 * index) % len(COLOURS)], _MARKERS[1 + index % 3]
        columns.append(Column(reference.name, errors, colour, marker))
    if np.isfinite(design.prior_errors).any():
        columns.append(Column("before", design.prior_errors, NEUTRAL, "|"))
    return draw_accuracy(design.names, columns, ax=ax)


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
    order = np.argsort(-columns[0].errors)
    ax = new_axes(ax, size=(6.8, 1.4 + 0.28 * len(order)))
    place = np.arange(len(order))
    if ranges is not None:
        ax.hlines(place, ranges[0][order], ranges[1][order], color=columns[0].colour, lw=4,
                  alpha=0.35, label="other vehicles")  # fmt: skip
    for one in columns:
        ax.plot(one.errors[order], place, one.marker, color=one.colour, ms=6, mew=1.3,
                label=one.name, ls="none")  # fmt: skip
    ax.set(xscale="log", xlabel="expected standard error / value [%]")
    ax.set_yticks(place, [symbol_of(names[i]) for i in order])
    clean(ax)
    _in_percent(ax)
    spread_legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=min(len(columns) + 1, 3))
    worst = order[0]
    said = [f"{one.name} {100 * one.errors[worst]:.2g} %" for one in columns]
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
    spec = grid[0, 1].get_gridspec()
    for ax in grid[:, 1]:
        ax.remove()
    plot_accuracy(design, ax=figure.add_subplot(spec[:, 1]))
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
