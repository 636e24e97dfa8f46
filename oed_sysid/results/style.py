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
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import ArrayLike

from oed_sysid.data.record import Record
from oed_sysid.errors import FileError
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.runtime.files import whole_file
from oed_sysid.text import notation
from oed_sysid.text.units import shown_unit

TRUTH = "black"
DATA = "0.45"
NEUTRAL = "0.6"
# Colours for colour-blind readers after Okabe & Ito (2008), ordered so that
# neighbours also differ in brightness; the line style repeats the distinction.
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES = ("--", "-", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
HATCHES = ("", "///", "...", "xxx", "\\\\\\", "+++")
DEGREE = np.degrees(1.0)
# Blue over white to vermilion; darkness says how strong in greyscale.
DIVERGING = LinearSegmentedColormap.from_list(
    "correlation", ["#003f66", "#8fbfdc", "white", "#f0a87f", "#8a2f00"]
)


@dataclass(frozen=True)
class ModelStyle:
    """Colour, dashes and hatch that stand for one model in every figure."""

    colour: str
    dashes: str | tuple
    hatch: str

    @property
    def line(self) -> dict[str, Any]:
        """Colour and dashes of its lines."""
        return {"color": self.colour, "ls": self.dashes}


def model_style(index: int) -> ModelStyle:
    """Style of the model at a position in a comparison; the first is the nominal one.

    Returns
    -------
    ModelStyle
        Colour, dashes and hatch.

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

    Returns
    -------
    Path
        The file.

    Raises
    ------
    FileError
        If the ending is no format, or the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> figure, _ = new_figure(1, 1, size=(2.0, 1.0))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     print(save_figure(figure, Path(folder) / "empty.svg").name)
    empty.svg
    """
    formats = figure.canvas.get_supported_filetypes()
    ending = Path(path).suffix.lower().lstrip(".")
    if "format" not in settings and ending not in formats:
        raise FileError(
            f"{str(path)!r} does not end like a picture. Choose .{', .'.join(sorted(formats))}."
        )
    key = {"png": "Description", "svg": "Description", "pdf": "Subject"}.get(ending)
    text = finding(figure)
    if key and text:
        settings = {"metadata": {key: text}} | settings
    with whole_file(path) as part:
        figure.savefig(part, **settings)
    return Path(path)


def several(things: Any) -> list[Any]:
    """One thing, or a sequence of them, as a list."""
    return list(things) if isinstance(things, Sequence) else [things]


def new_axes(ax: Axes | None, *, size: tuple[float, float] = (6.4, 4.0)) -> Axes:
    """Return the given axes, or those of a new figure of ``size`` in inches."""
    if ax is not None:
        return ax
    _, made = plt.subplots(figsize=size, layout="constrained")
    return made


def new_figure(
    rows: int, columns: int, *, size: tuple[float, float], **layout: object
) -> tuple[Figure, np.ndarray]:
    """Return a figure that pyplot does not keep, and its axes ``(rows, columns)``.

    Returns
    -------
    figure : Figure
    axes : ndarray of Axes (rows, columns)

    Examples
    --------
    >>> figure, axes = new_figure(2, 1, size=(6.0, 4.0))
    >>> axes.shape
    (2, 1)
    """
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **layout)  # type: ignore[call-overload]


def clean(ax: Axes, grid: str = "both") -> Axes:
    """Give axes the house style: light grid along ``grid``, no box, ticks that can be read."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color("0.4")
    ax.grid(False)
    ax.grid(True, axis=grid, color="0.9", linewidth=0.7)  # type: ignore[arg-type]
    ax.set_axisbelow(True)
    ax.tick_params(colors="0.25", labelsize=9)
    for axis in (ax.xaxis, ax.yaxis):
        axis.label.set_fontsize(10)
    ax.title.set_fontsize(11)
    return ax


def done(
    ax: Axes,
    finding: str = "",
    *,
    grid: str = "both",
    legend: int | dict[str, Any] | None = None,
    **labels: Any,
) -> Axes:
    """Return axes on which everything is drawn, in the house style and with its finding.

    Parameters
    ----------
    ax : Axes
        Where something was drawn.
    finding : str
        See :func:`say`.
    grid : str
        See :func:`clean`.
    legend : int or dict, optional
        Columns of a legend above the axes, or options of :func:`spread_legend`.
    **labels
        Of :meth:`matplotlib.axes.Axes.set`.
    """
    ax.set(**labels)
    clean(ax, grid)
    if isinstance(legend, int):
        legend_above(ax, legend)
    elif legend is not None:
        spread_legend(ax, **legend)
    return say(ax, finding) if finding else ax


def bars(
    ax: Axes, rows: ArrayLike, lengths: ArrayLike, colour: str, hatch: str = "", **look: Any
) -> None:
    """Draw bars along rows, outlined and hatched so that they can be told apart in grey."""
    settings = {"height": 0.62, "color": colour, "edgecolor": "0.25", "lw": 0.6, **look}
    ax.barh(rows, lengths, hatch=hatch or None, **settings)


def decades(ax: Axes, which: str, subs: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Make the axis ``x`` or ``y`` logarithmic, plain numbers along it, none between its ticks."""
    ax.set(**{f"{which}scale": "log"})  # type: ignore[arg-type]
    axis = ax.xaxis if which == "x" else ax.yaxis
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def errors_axis(ax: Axes, largest: float) -> None:
    """Make the axis of errors in units of the noise logarithmic where they are large."""
    if largest > 8.0:
        decades(ax, "y")


def row_axes(
    ax: Axes | None, names: Sequence[str], width: float, *, tall: float = 0.3, edge: float = 1.3
) -> tuple[Axes, np.ndarray]:
    """Return axes with one named row per name, the first on top, and the places of the rows."""
    ax = new_axes(ax, size=(width, edge + tall * len(names)))
    rows = np.arange(len(names))[::-1]
    ax.set_yticks(rows, names)
    ax.set_ylim(-0.7, len(names) - 0.3)
    return ax, rows


def legend_above(ax: Axes, columns: int = 3, **options: Any) -> None:
    """Add the legend above the axes, where it hides nothing."""
    where = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": columns}
    spread_legend(ax, **where, **options)


def panels(
    count: int, columns: int, size: tuple[float, float], **layout: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure of so many axes of a size (inches) in columns, row by row."""
    columns = max(min(columns, count), 1)
    rows = -(-count // columns)
    figure, grid = new_figure(rows, columns, size=(size[0] * columns, size[1] * rows), **layout)
    for ax in grid.flat[count:]:
        ax.axis("off")
    return figure, list(grid.flat[:count])


def label(channel: State | Input | Output, *, lines: int = 1) -> str:
    """Axis label of a signal: words, symbol and the unit that is shown; see :func:`shown`.

    Examples
    --------
    >>> label(State("q", "rad/s", "pitch rate"))
    'pitch rate $q$ [deg/s]'
    >>> label(Output("w", "m/s", "heave velocity")), label(Input("thrust", "N", "thrust"))
    ('heave velocity $w$ [m/s]', 'thrust [N]')
    """
    symbol, unit = symbol_of(channel.name), f"[{shown_unit(channel.unit)[1] or '-'}]"
    if symbol.startswith("$"):
        parts = (channel.label, f"{symbol} {unit}")
    else:
        parts = (channel.label or symbol, unit)
    return ("\n" if lines > 1 else " ").join(part for part in parts if part)


def abscissa(record: Record) -> tuple[np.ndarray, str]:
    """Along what a record is drawn, and the label of that: its times, or numbers of its tests."""
    if record.independent:
        return np.arange(1.0, record.n_samples + 1.0), "test"
    return record.times, "time $t$ [s]"


def joined(record: Record) -> dict[str, Any]:
    """Line of a signal of a record; rows of independent tests are marks that nothing joins."""
    return {"ls": "", "marker": "_", "ms": 5.0} if record.independent else {"ls": "-"}


def stepped(channel: State | Input | Output) -> dict[str, Any]:
    """How the samples of a signal are joined: a command that is held between them in steps."""
    held = isinstance(channel, Input) and channel.interpolation == "hold"
    return {"drawstyle": "steps-post" if held else "default"}


def zero(ax: Axes, half: float = 0.0, words: str | None = None) -> None:
    """Draw the line at zero, and a grey band around it."""
    if half:
        ax.axhspan(-half, half, color=NEUTRAL, alpha=0.3, lw=0, label=words)
    ax.axhline(0.0, color=TRUTH, lw=0.8)


def shown(channel: State | Input | Output, values: ArrayLike) -> np.ndarray:
    """Values of a signal in the unit of its label: angles in degrees.

    Examples
    --------
    >>> shown(State("theta", "rad"), [0.1, 0.2]).round(2).tolist()
    [5.73, 11.46]
    """
    return shown_unit(channel.unit)[0] * np.asarray(values, dtype=float)


def signal_of(record: Record, channel: Input | Output) -> np.ndarray:
    """Signal of a record in the unit of its label."""
    kind = record.input if isinstance(channel, Input) else record.output
    return shown(channel, kind(channel.name))


def say(ax: Axes, finding: str) -> Axes:
    """Attach the finding of a picture to its axes, for those who cannot see it.

    It is written into the file by :func:`save_figure`; :func:`finding` reads it.
    """
    ax.set_label(finding)
    return ax


def between(channel: State | Input | Output, values: np.ndarray) -> str:
    """Range of a signal, given in the unit that is shown, as a sentence."""
    if not np.isfinite(values).any():
        return f"{channel.name} is not measured."
    unit = shown_unit(channel.unit)[1]
    words = f"{channel.name} between {np.nanmin(values):.3g} and {np.nanmax(values):.3g} {unit}"
    return f"{words.rstrip()}."


def finding(picture: Axes | Figure) -> str:
    """What a picture shows, in words.

    Returns
    -------
    str
        Empty where nothing was attached.

    Examples
    --------
    >>> ax = say(new_axes(None), "Z_w is 12 % too small.")
    >>> finding(ax.figure)
    'Z_w is 12 % too small.'
    """
    several = picture.axes if isinstance(picture, Figure) else [picture]
    said = [str(ax.get_label()) for ax in several]
    return " ".join(text for text in dict.fromkeys(said) if text and not text.startswith("<"))


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
