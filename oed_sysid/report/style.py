"""How figures look: one colour per model, units in labels, readable in grey.

Nothing here touches matplotlib's global settings: every function sets what it
needs on the axes that it is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from oed_sysid.channels import Input, Output, State
from oed_sysid.errors import FileError
from oed_sysid.files import whole_file
from oed_sysid.language import notation

TRUTH = "black"
DATA = "0.45"
NEUTRAL = "0.6"
# Colours for colour-blind readers after Okabe & Ito (2008), ordered so that
# neighbours also differ in brightness; the line style repeats the distinction.
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES = ("--", "-", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
HATCHES = ("", "///", "...", "xxx", "\\\\\\", "+++")
# A 95 % interval of a normal variable, in standard deviations.
TWO_SIDED_95 = 1.96
DEGREE = np.degrees(1.0)


@dataclass(frozen=True)
class ModelStyle:
    """Colour, dashes and hatch that stand for one model in every figure."""

    colour: str
    dashes: str | tuple
    hatch: str


def model_style(index: int) -> ModelStyle:
    """Style of the model at a position in a comparison; the first is the believed one.

    Examples
    --------
    >>> model_style(0).colour != model_style(1).colour
    True
    """
    place = index % len(COLOURS)
    return ModelStyle(COLOURS[place], DASHES[place], HATCHES[place])


def save_figure(figure: Figure, path: str | Path, **settings: Any) -> Path:
    """Write a figure whole or not at all, in the format that the ending of its name says.

    Parameters
    ----------
    figure : Figure
        What to write.
    path : str or Path
        The file.
    **settings
        Of :meth:`matplotlib.figure.Figure.savefig`.

    Raises
    ------
    FileError
        If the ending is no format, or the file cannot be written.
    """
    formats = figure.canvas.get_supported_filetypes()
    ending = Path(path).suffix.lower().lstrip(".")
    if "format" not in settings and ending not in formats:
        raise FileError(
            f"{str(path)!r} does not end like a picture. Choose .{', .'.join(sorted(formats))}."
        )
    with whole_file(path) as part:
        figure.savefig(part, **settings)
    return Path(path)


def new_axes(ax: Axes | None, *, size: tuple[float, float] = (6.4, 4.0)) -> Axes:
    """Return the given axes, or those of a new figure of ``size`` in inches."""
    if ax is not None:
        return ax
    _, made = plt.subplots(figsize=size, layout="constrained")
    return made


def new_figure(
    rows: int, columns: int, *, size: tuple[float, float], **layout: object
) -> tuple[Figure, np.ndarray]:
    """Return a figure that pyplot does not keep, and its axes ``(rows, columns)``."""
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **layout)  # type: ignore[call-overload]


def clean(ax: Axes) -> Axes:
    """Give axes the house style: light grid, no box, ticks that can be read."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color("0.4")
    ax.grid(True, color="0.9", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.tick_params(colors="0.25", labelsize=9)
    ax.xaxis.label.set_fontsize(10)
    ax.yaxis.label.set_fontsize(10)
    ax.title.set_fontsize(11)
    return ax


def label(channel: State | Input | Output, *, lines: int = 1) -> str:
    """Axis label of a signal: words, symbol and unit.

    Examples
    --------
    >>> label(Output("w", "m/s", "heave velocity")), label(Input("thrust", "N", "thrust"))
    ('heave velocity $w$ [m/s]', 'thrust [N]')
    """
    symbol, unit = symbol_of(channel.name), f"[{channel.unit or '-'}]"
    if symbol.startswith("$"):
        parts = (channel.label, f"{symbol} {unit}")
    else:
        parts = (channel.label or symbol, unit)
    return ("\n" if lines > 1 else " ").join(part for part in parts if part)


def symbol_of(name: str) -> str:
    """Symbol of a signal or parameter: mathematics for short names, else the name.

    Examples
    --------
    >>> symbol_of("Z_absww"), symbol_of("fin_command")
    ('$Z_{w|w|}$', 'fin_command')
    """
    written = notation.latex(name)
    return name if "\\mathrm" in written else f"${written}$"


def spread_legend(ax: Axes, **options: object) -> None:
    """Add a legend without a frame, if anything is labelled."""
    handles, names = ax.get_legend_handles_labels()
    if handles:
        unique = dict(zip(names, handles, strict=True))
        settings: dict = {"frameon": False, "fontsize": 9} | options
        ax.legend(list(unique.values()), list(unique), **settings)


def span(values: Sequence[float] | np.ndarray, margin: float = 0.06) -> tuple[float, float]:
    """Limits of an axis that show all finite values with a margin."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return -1.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    pad = margin * (high - low) or 0.05 * abs(high) or 1.0
    return low - pad, high + pad
