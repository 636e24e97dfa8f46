"""Pictures before a trial: what to command, what to expect, which parameters it will tell."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from oed_sysid.channels import Input, Output, State
from oed_sysid.design import Design
from oed_sysid.report.style import (
    COLOURS,
    DEGREE,
    NEUTRAL,
    TRUTH,
    clean,
    label,
    new_axes,
    new_figure,
    spread_legend,
    symbol_of,
)
from oed_sysid.sensitivity import Bode, SensitivityRanking, Spectrum

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
        From :func:`~oed_sysid.sensitivity.rank_parameters`.
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
    return ax


def plot_accuracy(design: Design, *, ax: Axes | None = None) -> Axes:
    """Plot expected relative errors: before, after the design, after standard manoeuvres.

    Parameters
    ----------
    design : Design
        From :func:`~oed_sysid.design.design_experiment`.
    ax : Axes, optional
        Where to draw.
    """
    order = np.argsort(-design.relative_errors)
    ax = new_axes(ax, size=(6.8, 1.4 + 0.28 * len(order)))
    place = np.arange(len(order))
    columns = [("designed", design.relative_errors, COLOURS[1], "o")]
    for index, reference in enumerate(design.references):
        errors = reference.information.std_errors / design.sizes
        columns.append(
            (reference.name, errors, COLOURS[(2 * index) % len(COLOURS)], _MARKERS[1 + index % 3])
        )
    if np.isfinite(design.prior_errors).any():
        columns.append(("before", design.prior_errors, NEUTRAL, "|"))
    for name, errors, colour, marker in columns:
        ax.plot(errors[order], place, marker, color=colour, ms=6, mew=1.2, label=name, ls="none")
    ax.set(xscale="log", xlabel="expected standard error / value [%]")
    ax.set_yticks(place, [symbol_of(design.names[i]) for i in order])
    clean(ax)
    _in_percent(ax)
    spread_legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(columns))
    return ax


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
    channels = {s.name: s for s in model.states} | outputs
    shown: list[Input | Output | State] = [*varied]
    names = dict.fromkeys((*limits.signals, *_TELLING, *channels))
    shown += [channels[n] for n in names if n in channels][:3]
    figure, grid = new_figure(len(shown), 2, size=(11.0, 1.7 * max(len(shown), 3)))
    for row, channel in enumerate(shown):
        ax = grid[row, 0]
        turn = DEGREE if channel.unit in ("rad", "rad/s") else 1.0
        values = turn * run.signal(channel.name)
        step = "post" if isinstance(channel, Input) and channel.interpolation == "hold" else None
        if step:
            ax.step(run.times, values, where=step, color=COLOURS[1], lw=1.3)
        else:
            ax.plot(run.times, values, color=COLOURS[1], lw=1.3)
        pair = (limits.inputs if isinstance(channel, Input) else limits.signals).get(channel.name)
        for bound in pair or ():
            inside = abs(turn * bound - values).min() < 1.5 * np.ptp(values)
            if np.isfinite(bound) and inside:
                ax.axhline(turn * bound, color=TRUTH, ls="--", lw=0.9)
        text = label(channel, lines=2)
        ax.set_ylabel(text.replace("[rad", "[deg") if turn != 1.0 else text)
        clean(ax)
        if row < len(shown) - 1:
            ax.tick_params(labelbottom=False)
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
        From :func:`~oed_sysid.sensitivity.bode`.
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
    ax.xaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{100 * share:.3g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
