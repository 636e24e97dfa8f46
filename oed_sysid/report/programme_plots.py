"""Pictures of a programme: what each run commands and moves, what all of them tell."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid.channels import Input, Output, State
from oed_sysid.design import Candidate, Programme
from oed_sysid.report.design_plots import _in_percent
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
from oed_sysid.simulation import simulate

_TELLING = ("theta", "psi", "phi", "r", "q", "z", "u")


def plot_programme_accuracy(programme: Programme, *, ax: Axes | None = None) -> Axes:
    """Plot expected relative errors: before, after the programme, after standard trials.

    Bars are the range over other vehicles that are possible.

    Parameters
    ----------
    programme : Programme
        From :func:`~oed_sysid.design.design_programme`.
    ax : Axes, optional
        Where to draw.
    """
    errors = programme.relative_errors
    order = np.argsort(-errors)
    ax = new_axes(ax, size=(6.8, 1.4 + 0.28 * len(order)))
    place = np.arange(len(order))
    names = [programme.names[i] for i in order]
    if programme.spread is not None:
        ax.hlines(place, programme.spread.lowest[order], programme.spread.highest[order],
                  color=COLOURS[1], lw=4, alpha=0.35, label="other vehicles")  # fmt: skip
    ax.plot(errors[order], place, "o", color=COLOURS[1], ms=6, label="programme")
    if programme.standard is not None:
        theirs = [programme.standard.errors[name] for name in names]
        ax.plot(theirs, place, "s", color=COLOURS[0], ms=6, label="standard trials, equal time")
    if programme.prior is not None:
        before = programme.prior.std_errors / programme.sizes
        ax.plot(before[order], place, "|", color=NEUTRAL, ms=8, mew=1.5, label="before")
    ax.set(xscale="log", xlabel="expected standard error / value [%]")
    ax.set_yticks(place, [symbol_of(name) for name in names])
    clean(ax)
    _in_percent(ax)
    spread_legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return ax


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
    spec = grid[0, 2].get_gridspec()
    for ax in grid[:, 2]:
        ax.remove()
    plot_programme_accuracy(programme, ax=figure.add_subplot(spec[:, 2]))
    return figure


def _draw_run(programme: Programme, run: Candidate, left: Axes, right: Axes) -> None:
    model, limits = programme.model, run.experiment.limits
    record = simulate(model, run.experiment, noise=False)
    varied = [i for i in model.inputs if np.ptp(record.input(i.name)) > 0] or [model.inputs[0]]
    channels: dict[str, State | Output] = {o.name: o for o in model.outputs}
    names = [n for n in (*limits.signals, *_TELLING, *channels) if n in channels]
    shown: list[tuple[Axes, Input | State | Output, np.ndarray]] = [
        (left, varied[0], record.input(varied[0].name)),
        (right, channels[names[0]], record.output(names[0])),
    ]
    times = run.experiment.times
    number = [i for i, one in enumerate(programme.runs, start=1) if one.name == run.name]
    left.set_title(f"{', '.join(map(str, number))}: {run.name}", fontsize=9, loc="left")
    for ax, channel, values in shown:
        turn = DEGREE if channel.unit in ("rad", "rad/s") else 1.0
        ax.plot(times, turn * values, color=COLOURS[1], lw=1.2)
        text = label(channel, lines=2)
        ax.set_ylabel(text.replace("[rad", "[deg") if turn != 1.0 else text)
        kept = programme.assurances.get(run.name)
        if not isinstance(channel, Input) and kept is not None and channel.name in kept.ranges:
            for bound in kept.ranges[channel.name]:
                ax.axhline(turn * bound, color=NEUTRAL, ls=":", lw=1)
        pair = (limits.inputs if isinstance(channel, Input) else limits.signals).get(channel.name)
        for bound in pair or ():
            if np.isfinite(bound) and abs(bound - values).min() < 1.5 * (np.ptp(values) + 1e-9):
                ax.axhline(turn * bound, color=TRUTH, ls="--", lw=0.9)
        clean(ax)
