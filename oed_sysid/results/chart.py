"""One description of a picture: a vector where it is printed, to be pointed at on a screen.

A :class:`Chart` is marks on a pair of axes. :meth:`Chart.on` draws it with matplotlib, for
reports, notebooks and files; :func:`oed_sysid.app.charts.drawn` with plotly, for the page. Both
take colours, dashes and words from here, so that a picture is described once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from oed_sysid.results import style as draw


@dataclass(frozen=True, eq=False)
class Mark:
    """Points of a chart, joined or not.

    Parameters
    ----------
    x, y : array_like (n_points,)
    label : str
        In the legend; empty where it has no place there.
    colour : str
        ``draw.DATA`` (what was measured), ``draw.TRUTH``, or one of ``draw.COLOURS``.
    dashes : str
        As matplotlib has them; empty leaves points unjoined.
    marker : str
        As matplotlib has them; empty for a line alone, ``"."`` for the dots of all samples.
    half : array_like (n_points,), optional
        Half of the 95 % interval of each point: a band around a line, else bars.
    band : str
        What the band holds, in the legend; empty where it has no place there.
    held : bool
        Whether a value holds until the next point.
    faint : bool
        Whether there are so many points that one alone tells nothing.
    texts : sequence of str
        What is written beside the points.
    """

    x: Any
    y: Any
    label: str = ""
    colour: str = draw.DATA
    dashes: str | tuple[Any, ...] = "-"
    marker: str = ""
    half: Any = None
    band: str = ""
    held: bool = False
    faint: bool = False
    texts: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Chart:
    """Marks on a pair of axes.

    Parameters
    ----------
    marks : tuple of Mark
    x_label, y_label : str
        With units; a line before the last one of an upward axis says what it is called.
    finding : str
        What is to be seen, for those who cannot see it.
    level : float, optional
        A line across, and half of a grey band around it.
    band : float
    logarithmic : bool
        Whether the upward axis is.
    names : sequence of str
        What is written at 0, 1, 2, ... along the axis, in the place of numbers.
    """

    marks: tuple[Mark, ...]
    x_label: str
    y_label: str
    finding: str
    level: float | None = None
    band: float = 0.0
    logarithmic: bool = False
    names: Sequence[str] = ()

    def on(
        self,
        ax: Axes | None = None,
        *,
        size: tuple[float, float] = (6.4, 3.6),
        legend: int | None = 2,
    ) -> Axes:
        """Draw on the given axes, or on those of a new figure (inches), a legend in columns."""
        # Beside others an axis is too short for words, symbol and unit in one line.
        y_label = self.y_label if ax else self.y_label.replace("\n", " ")
        ax = draw.new_axes(ax, size=size)
        if self.level is not None:
            low, high = self.level - self.band, self.level + self.band
            ax.axhspan(low, high, color=draw.NEUTRAL, alpha=0.3, lw=0)
            ax.axhline(self.level, color=draw.TRUTH, lw=0.9)
        for mark in self.marks:
            self._mark(ax, mark)
        if self.logarithmic:
            draw.decades(ax, "y")
        if self.names:
            # Two letters are as wide as one is high, and one is left between two names.
            letter = 0.5 * ax.get_xticklabels()[0].get_fontproperties().get_size_in_points()
            room = 72.0 * np.ptp(ax.bbox.intervalx) / ax.figure.dpi / len(self.names)
            width = max(int(room / letter) - 1, 1)
            folded = [fill(name, width, break_long_words=False) for name in self.names]
            ax.set_xticks(range(len(self.names)), folded)
            ax.set_xlim(-0.4, len(self.names) - 0.4)
        labels = {"xlabel": self.x_label, "ylabel": y_label}
        grid = "y" if self.names else "both"
        return draw.done(ax, self.finding, grid=grid, legend=legend, **labels)

    @staticmethod
    def _mark(ax: Axes, mark: Mark) -> None:
        look = _look(mark)
        if mark.half is not None and not mark.dashes:
            ax.errorbar(mark.x, mark.y, yerr=mark.half, capsize=3, **look)
        else:
            if mark.half is not None:
                ends = np.asarray(mark.y) + np.multiply.outer((-1.0, 1.0), mark.half)
                band: dict[str, Any] = {"color": mark.colour, "label": mark.band or None}
                ax.fill_between(mark.x, *ends, alpha=0.25, lw=0, rasterized=True, **band)
            ax.plot(mark.x, mark.y, **look)
        for x, y, text in zip(mark.x, mark.y, mark.texts, strict=False):
            if np.isfinite(y):
                ax.annotate(text, (x, y), (7, 7), textcoords="offset points", fontsize=9)


def _look(mark: Mark) -> dict[str, Any]:
    """How matplotlib draws the points of a mark."""
    look: dict[str, Any] = {"color": mark.colour, "label": mark.label or None}
    look |= {"ls": mark.dashes or "", "marker": mark.marker, "lw": 1.5, "ms": 6}
    look |= {"ms": 2.5, "rasterized": True} if mark.marker == "." else {}
    look |= {"ms": 1.5, "alpha": 0.35} if mark.faint else {}
    return look | ({"drawstyle": "steps-post"} if mark.held else {})
