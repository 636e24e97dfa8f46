"""Pictures of a programme: what each run commands and moves, what all of them tell."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid.design import Candidate, Programme
from oed_sysid.experiments.simulation import simulate
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.results.design_plots import Column, draw_accuracy, draw_motion
from oed_sysid.results.style import COLOURS, NEUTRAL, new_figure
from oed_sysid.text.units import shown_unit

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
    columns = [Column("programme", programme.relative_errors, COLOURS[1], "o")]
    if programme.standard is not None:
        theirs = np.array([programme.standard.errors[name] for name in programme.names])
        columns.append(Column("standard trials, equal time", theirs, COLOURS[0], "s"))
    if programme.prior is not None:
        before = programme.prior.std_errors / programme.sizes
        columns.append(Column("before", before, NEUTRAL, "|"))
    spread = programme.spread
    ranges = None if spread is None else (spread.lowest, spread.highest)
    return draw_accuracy(programme.names, columns, ranges=ranges, ax=ax)


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
    kept = programme.assurances.get(run.name)
    for ax, channel, values in shown:
        kind = limits.inputs if isinstance(channel, Input) else limits.signals
        draw_motion(ax, channel, times, values, kind.get(channel.name))
        if not isinstance(channel, Input) and kept is not None and channel.name in kept.ranges:
            factor = shown_unit(channel.unit)[0]
            for bound in kept.ranges[channel.name]:
                ax.axhline(factor * bound, color=NEUTRAL, ls=":", lw=1)
