"""A measured record before anything is done with it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from oed_sysid.data.record import Record
from oed_sysid.physics.channels import Input, Output
from oed_sysid.results.style import (
    DATA,
    TRUTH,
    abscissa,
    between,
    clean,
    joined,
    label,
    new_figure,
    say,
    shown,
)


def figure_record(record: Record) -> Figure:
    """Draw every input and output of a record over time; angles in degrees.

    Commands are lines as they act between samples, measurements are dots; an
    output that was not measured is left out.

    Parameters
    ----------
    record : Record
        The record.
    """
    along, words = abscissa(record)
    measured = [o for o in record.channels.outputs if np.isfinite(record.output(o.name)).any()]
    channels: list[Input | Output] = [*record.channels.inputs, *measured]
    columns = 1 if len(channels) < 4 else 2
    rows = -(-len(channels) // columns)
    figure, grid = new_figure(rows, columns, size=(5.4 * columns, 1.9 * rows), sharex=True)
    for ax, channel in zip(grid.T.flat, channels, strict=False):
        if isinstance(channel, Input):
            style = "steps-post" if channel.interpolation == "hold" else "default"
            values = shown(channel, record.input(channel.name))
            ax.plot(along, values, color=TRUTH, lw=1.0, drawstyle=style, **joined(record))
        else:
            values = shown(channel, record.output(channel.name))
            ax.plot(along, values, ".", color=DATA, ms=2.0, rasterized=True)
        ax.set_ylabel(label(channel, lines=2))
        say(clean(ax), between(channel, values))
    for ax in list(grid.T.flat)[len(channels) :]:
        ax.set_visible(False)
    for column in grid.T:
        lowest = [ax for ax in column if ax.get_visible()][-1]
        lowest.set_xlabel(words)
        lowest.tick_params(labelbottom=True)
    return figure
