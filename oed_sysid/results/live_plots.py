r"""Estimates on their way: parameters against time, and the starts of a multistart.

The waterfall shows how many starts found the optimum, and what the others found. Starts are
sorted by their objective

.. math:: J_i = -2 \log L_i - 2 \log \pi(p_i), \qquad \Delta_i = J_i - \min_j J_j

(twice the negative log-likelihood, with priors). Starts that found the same optimum lie on a
plateau. Many on the lowest one: it is likely the global optimum. One alone: search on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed_sysid.errors import DataError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multistart import SAME_OPTIMUM
from oed_sysid.results.style import (
    NEUTRAL,
    TRUTH,
    clean,
    model_style,
    new_axes,
    new_figure,
    save_figure,
    say,
    spread_legend,
    symbol_of,
)
from oed_sysid.runtime.display import TWO_SIDED_95
from oed_sysid.runtime.files import whole_file


def plot_history(
    times: np.ndarray,
    values: np.ndarray,
    stds: np.ndarray | None = None,
    *,
    name: str = "",
    unit: str = "",
    reference: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot one parameter against time, with its 95 % band.

    Parameters
    ----------
    times, values : ndarray (n,)
        When, s, and what was estimated then; NaN leaves a gap.
    stds : ndarray (n,), optional
        Standard errors.
    name, unit : str
        For the label of the axis.
    reference : float, optional
        A known or published value, drawn in black.
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax, size=(6.4, 2.6))
    look = model_style(0)
    band = np.zeros(len(values)) if stds is None else TWO_SIDED_95 * np.asarray(stds)
    if stds is not None:
        low, high = values - band, values + band
        ax.fill_between(times, low, high, color=look.colour, alpha=0.25, lw=0, label="95 %")
    ax.plot(times, values, color=look.colour, lw=1.5, label="estimate")
    if reference is not None:
        ax.axhline(reference, color=TRUTH, lw=1.0, ls=":", label="reference")
    ax.set_ylim(*_range_of(values, band, reference))
    ax.set_ylabel(f"{symbol_of(name)} [{unit or '-'}]" if name else "")
    return clean(ax)


class LiveParameters:
    """A figure of parameters with bands that grows while estimates arrive.

    It draws at most once per ``every`` seconds of wall-clock time, however often
    :meth:`update` is called, so a loop on board is not held up. Without a screen
    it writes ``file`` anew at every drawing; with one, give it a figure of pyplot
    (``plt.ion(); figure=plt.figure()``), whose window it refreshes.

    Parameters
    ----------
    names : sequence of str
        Parameters, one panel each.
    units : mapping of str to str
        Their units.
    references : mapping of str to float
        Known or published values, in black.
    file : path, optional
        Picture that is kept up to date (PNG, SVG or PDF by its name).
    every : float
        Least time between two drawings, s.
    figure : Figure, optional
        Where to draw; by default one that needs no screen.
    clock : callable
        Wall-clock time, s.

    Examples
    --------
    >>> live = LiveParameters(["K", "T"], units={"K": "1/s", "T": "s"})
    >>> for k in range(1, 40):
    ...     live.update(1.5 * k, {"K": 0.2, "T": 15.0}, {"K": 0.1 / k, "T": 8.0 / k})
    >>> live.n_samples, live.figure.axes[1].get_ylabel()
    (39, '$T$ [s]')
    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        units: Mapping[str, str] | None = None,
        references: Mapping[str, float] | None = None,
        file: str | Path | None = None,
        every: float = 0.5,
        figure: Figure | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not names:
            raise DataError("A live plot needs at least one parameter. Give names.")
        if every < 0:
            raise DataError(f"every is {every} s. Give 0 to draw at each update, or more.")
        self.names = tuple(names)
        self._units, self._references = dict(units or {}), dict(references or {})
        self._file, self._every, self._clock = file, every, clock
        self._times: list[float] = []
        self._values: list[list[float]] = []
        self._stds: list[list[float]] = []
        self._drawn_at = -np.inf
        self.n_drawings = 0
        if figure is None:
            size = (6.4, 0.8 + 1.8 * len(self.names))
            self.figure, axes = new_figure(len(self.names), 1, size=size, sharex=True)
        else:
            self.figure = figure
            axes = figure.subplots(len(self.names), 1, squeeze=False, sharex=True)
        self._axes: tuple[Axes, ...] = tuple(axes[:, 0])

    @property
    def n_samples(self) -> int:
        """Updates so far."""
        return len(self._times)

    def update(
        self, t: float, values: Mapping[str, float], stds: Mapping[str, float] | None = None
    ) -> None:
        """Take the estimates of one instant, and draw if the last drawing is old enough.

        Parameters
        ----------
        t : float
            Time, s, later than before.
        values, stds : mapping of str to float
            Estimates and standard errors; what is not known is left out.
        """
        if unknown := [name for name in (*values, *(stds or {})) if name not in self.names]:
            raise DataError(
                f"The live plot has no parameter {unknown[0]!r}, only {', '.join(self.names)}."
            )
        if self._times and not t > self._times[-1]:
            raise DataError(
                f"The estimates at t = {t:g} s are not later than those at {self._times[-1]:g} s."
            )
        self._times.append(float(t))
        self._values.append([float(values.get(name, np.nan)) for name in self.names])
        self._stds.append([float((stds or {}).get(name, np.nan)) for name in self.names])
        if self._clock() - self._drawn_at >= self._every:
            self.draw()

    def draw(self) -> None:
        """Draw all that is known, write the file and refresh the window."""
        self._draw_until(self.n_samples)
        self._drawn_at = self._clock()
        self.n_drawings += 1
        if self._file is not None:
            save_figure(self.figure, self._file, dpi=110)
        self.figure.canvas.draw_idle()
        self.figure.canvas.flush_events()

    def animate(self, path: str | Path, *, frames: int = 50, per_second: int = 10) -> None:
        """Write what happened so far as an animated GIF.

        Parameters
        ----------
        path : path
            File to write.
        frames : int
            Pictures, evenly spread over the samples.
        per_second : int
            Pictures per second.
        """
        if not self.n_samples:
            raise DataError("There is nothing to animate yet. Call update first.")
        counts = np.unique(np.linspace(1, self.n_samples, frames).astype(int))
        moving = FuncAnimation(
            self.figure,
            lambda count: self._draw_until(int(count)),
            frames=counts.tolist(),
            init_func=lambda: (),
            blit=False,
        )
        with whole_file(path) as part:
            moving.save(part, writer=PillowWriter(fps=per_second), dpi=80)

    def _draw_until(self, count: int) -> tuple[Axes, ...]:
        times = np.array(self._times[:count])
        values = np.array(self._values[:count]).reshape(count, len(self.names))
        stds = np.array(self._stds[:count]).reshape(count, len(self.names))
        for index, (name, ax) in enumerate(zip(self.names, self._axes, strict=True)):
            ax.clear()
            plot_history(
                times,
                values[:, index],
                stds[:, index],
                name=name,
                unit=self._units.get(name, ""),
                reference=self._references.get(name),
                ax=ax,
            )
        self._axes[-1].set_xlabel("time [s]")
        spread_legend(self._axes[0], ncols=3, loc="upper right", fontsize=8)
        return self._axes


def _range_of(values: np.ndarray, band: np.ndarray, reference: float | None) -> tuple[float, float]:
    """Limits that show the later half with its band; early estimates may leave them."""
    late = slice(len(values) // 2, None)
    band = np.where(np.isfinite(band), band, 0.0)
    shown = [*(values - band)[late], *(values + band)[late]]
    shown += [] if reference is None else [reference]
    finite = np.array([value for value in shown if np.isfinite(value)])
    if not finite.size:
        return -1.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    pad = 0.4 * (high - low) or 0.05 * abs(high) or 1.0
    return low - pad, high + pad


# Plateaus above the lowest one that get a number.
MOST_NAMED = 4


def plateaus(objectives: Sequence[float] | np.ndarray) -> list[tuple[int, int]]:
    """First and last position of starts that found the same optimum, in sorted objectives.

    Examples
    --------
    >>> plateaus([0.0, 0.001, 0.01, 5.0, 9.0, 9.001])
    [(0, 2), (3, 3), (4, 5)]
    """
    values = np.asarray(objectives, dtype=float)
    found: list[tuple[int, int]] = []
    for position, value in enumerate(values):
        if not np.isfinite(value):
            break
        # Measured from the plateau's own floor: a slope is no plateau.
        if found and value - values[found[-1][0]] < SAME_OPTIMUM:
            found[-1] = (found[-1][0], position)
        else:
            found.append((position, position))
    return found


def plot_waterfall(result: Fit, ax: Axes | None = None) -> Axes:
    """Sorted objectives of all starts above the best, plateaus marked.

    Parameters
    ----------
    result : Fit
        What :meth:`oed_sysid.likelihood.multistart.Multistart.fit` returned.
    ax : Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes

    Raises
    ------
    DataError
        If the fit was made from one start only.
    """
    attempts = result.attempts
    if attempts is None:
        raise DataError(
            f"The fit by {result.estimator!r} holds no starts. Make it with "
            "Multistart(estimator, n_starts=20).fit(model, dataset) of oed_sysid.likelihood."
        )
    objectives, converged = attempts.objectives, attempts.converged
    order = np.argsort(np.where(np.isfinite(objectives), objectives, np.inf), kind="stable")
    objectives, converged = objectives[order], converged[order]
    ax = new_axes(ax)
    finite = np.isfinite(objectives)
    if not finite.any():
        ax.set_title("no start led to a finite objective")
        return clean(ax)
    above = objectives - objectives[0]
    places = np.arange(1, len(above) + 1)
    good, other = model_style(1), model_style(0)
    groups = plateaus(above)
    last = groups[0][1]
    top = max(10.0 * SAME_OPTIMUM, float(above[finite].max()))
    ax.set_yscale("symlog", linthresh=SAME_OPTIMUM, linscale=0.4)
    ax.axhspan(-0.5 * SAME_OPTIMUM, SAME_OPTIMUM, color=good.colour, alpha=0.12, linewidth=0)
    ax.plot(places[finite], above[finite], color=NEUTRAL, linewidth=1.0, zorder=1)
    lowest = finite & (places <= last + 1)
    for chosen, style in (
        (lowest & converged, {"marker": "o", "color": good.colour, "label": "the best optimum"}),
        (
            finite & ~lowest & converged,
            {"marker": "o", "color": other.colour, "mfc": "white", "label": "other optima"},
        ),
        (finite & ~converged, {"marker": "x", "color": "0.25", "label": "did not converge"}),
    ):
        if chosen.any():
            ax.plot(places[chosen], above[chosen], linestyle="none", markersize=6, **style)  # type: ignore[arg-type]
    own = int(np.flatnonzero(order == 0)[0])
    if finite[own]:
        ax.plot(
            places[own], above[own], marker="o", markersize=12, mfc="none", color="black",
            linestyle="none", label="the model's own values",
        )  # fmt: skip
    for first, end in [g for g in groups[1:] if g[1] > g[0]][:MOST_NAMED]:
        ax.annotate(
            f"{end - first + 1} starts", (0.5 * (places[first] + places[end]), above[first]),
            xytext=(0, 7), textcoords="offset points", ha="center", fontsize=9, color="0.25",
        )  # fmt: skip
    lost = int((~finite).sum())
    title = f"{last + 1} of {len(above)} starts found the best optimum"
    ax.set_title(title + (f"; {lost} diverged" if lost else ""), loc="left")
    ax.set_xlabel("start, sorted")
    ax.set_ylabel("objective above the best, $-2\\,\\Delta\\log L$ [-]")
    ax.set_xlim(0.5, len(above) + 0.5)
    ax.set_ylim(-0.5 * SAME_OPTIMUM, 3.0 * top)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    spread_legend(ax, loc="best")
    return say(clean(ax), f"{title}{f'; {lost} diverged' if lost else ''}.")
