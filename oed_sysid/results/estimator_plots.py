r"""Pictures of estimators: values against time, starts of a multistart, one against the others.

The waterfall shows how many starts found the optimum, and what the others found. Starts are
sorted by their objective

.. math:: J_i = -2 \log L_i - 2 \log \pi(p_i), \qquad \Delta_i = J_i - \min_j J_j

(twice the negative log-likelihood, with priors). Starts that found the same optimum lie on a
plateau. Many on the lowest one: it is likely the global optimum. One alone: search on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from oed_sysid.baselines.benchmark import Benchmark, Row, logarithms_of_ratios
from oed_sysid.baselines.contest import OURS, OURS_DISTURBED, UNITS
from oed_sysid.errors import DataError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multistart import SAME_OPTIMUM
from oed_sysid.results import style as draw
from oed_sysid.runtime.display import TWO_SIDED_95, interval
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

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(6.4, 2.6))
    look = draw.model_style(0)
    band = np.zeros(len(values)) if stds is None else TWO_SIDED_95 * np.asarray(stds)
    if stds is not None:
        low, high = values - band, values + band
        ax.fill_between(times, low, high, color=look.colour, alpha=0.25, lw=0, label="95 %")
    ax.plot(times, values, color=look.colour, lw=1.5, label="estimate")
    if reference is not None:
        ax.axhline(reference, color=draw.TRUTH, lw=1.0, ls=":", label="reference")
    # The later half with its band is shown; early estimates may leave the picture.
    late, half = values[len(values) // 2 :], np.nan_to_num(band, posinf=0.0)[len(values) // 2 :]
    known = [] if reference is None else [reference]
    last = interval(float(values[-1]), float(band[-1]))
    return draw.done(
        ax,
        f"{name or 'estimate'} at {times[-1]:.4g} s: {last} {unit}".rstrip() + ".",
        ylim=draw.span([*(late - half), *(late + half), *known], 0.4),
        ylabel=f"{draw.symbol_of(name)} [{unit or '-'}]" if name else "",
    )


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
    clock : callable
        Wall-clock time, s.

    Examples
    --------
    >>> live = LiveParameters(["K", "T"], units={"K": "1/s", "T": "s"})
    >>> for k in range(1, 5):
    ...     live.update(1.5 * k, {"K": 0.2, "T": 15.0}, {"K": 0.1 / k, "T": 8.0 / k})
    >>> live.n_samples, live.figure.axes[1].get_ylabel()
    (4, '$T$ [s]')
    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        units: Mapping[str, str] | None = None,
        references: Mapping[str, float] | None = None,
        file: str | Path | None = None,
        every: float = 0.5,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not names:
            raise DataError("A live plot needs at least one parameter. Give names.")
        if every < 0:
            raise DataError(f"every is {every} s. Give 0 to draw at each update, or more.")
        self.names = tuple(names)
        self._units, self._references = dict(units or {}), dict(references or {})
        self._file, self._every, self._clock = file, every, clock
        # Time, values and standard errors of every update.
        self._rows: list[tuple[float, list[float], list[float]]] = []
        self._drawn_at = -np.inf
        self.n_drawings = 0
        size = (6.4, 0.8 + 1.8 * len(self.names))
        self.figure, axes = draw.new_figure(len(self.names), 1, size=size, sharex=True)
        self._axes: tuple[Axes, ...] = tuple(axes[:, 0])

    @property
    def n_samples(self) -> int:
        """Updates so far."""
        return len(self._rows)

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
        stds = stds or {}
        if unknown := [name for name in (*values, *stds) if name not in self.names]:
            raise DataError(
                f"The live plot has no parameter {unknown[0]!r}, only {', '.join(self.names)}."
            )
        if self._rows and not t > (last := self._rows[-1][0]):
            raise DataError(f"The estimates at t = {t:g} s are not later than those at {last:g} s.")
        row, half = (
            [float(one.get(name, np.nan)) for name in self.names] for one in (values, stds)
        )
        self._rows.append((float(t), row, half))
        if self._clock() - self._drawn_at >= self._every:
            self.draw()

    def draw(self) -> None:
        """Draw all that is known, write the file and refresh the window."""
        self._draw_until(self.n_samples)
        self._drawn_at = self._clock()
        self.n_drawings += 1
        if self._file is not None:
            draw.save_figure(self.figure, self._file, dpi=110)
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
        rows = self._rows[:count]
        times = np.array([t for t, _, _ in rows])
        for index, (name, ax) in enumerate(zip(self.names, self._axes, strict=True)):
            ax.clear()
            known = np.array([(row[index], half[index]) for _, row, half in rows]).reshape(-1, 2)
            plot_history(
                times, *known.T, name=name, ax=ax,
                unit=self._units.get(name, ""), reference=self._references.get(name),
            )  # fmt: skip
        self._axes[-1].set_xlabel("time [s]")
        draw.spread_legend(self._axes[0], ncols=3, loc="upper right", fontsize=8)
        return self._axes


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
    ax = draw.new_axes(ax)
    finite = np.isfinite(objectives)
    if not finite.any():
        ax.set_title("no start led to a finite objective")
        return draw.clean(ax)
    above = objectives - objectives[0]
    places = np.arange(1, len(above) + 1)
    good, other = draw.model_style(1), draw.model_style(0)
    groups = plateaus(above)
    last = groups[0][1]
    top = max(10.0 * SAME_OPTIMUM, float(above[finite].max()))
    ax.set_yscale("symlog", linthresh=SAME_OPTIMUM, linscale=0.4)
    ax.axhspan(-0.5 * SAME_OPTIMUM, SAME_OPTIMUM, color=good.colour, alpha=0.12, linewidth=0)
    ax.plot(places[finite], above[finite], color=draw.NEUTRAL, linewidth=1.0, zorder=1)
    lowest = finite & (places <= last + 1)
    for chosen, marker, colour, fill, words in (
        (lowest & converged, "o", good.colour, good.colour, "the best optimum"),
        (finite & ~lowest & converged, "o", other.colour, "white", "other optima"),
        (finite & ~converged, "x", "0.25", "0.25", "did not converge"),
    ):
        if chosen.any():
            ax.plot(places[chosen], above[chosen], marker, ms=6, color=colour, mfc=fill,
                    label=words)  # fmt: skip
    own = int(np.flatnonzero(order == 0)[0])
    if finite[own]:
        ax.plot(places[own], above[own], "o", ms=12, mfc="none", color=draw.TRUTH,
                label="the model's own values")  # fmt: skip
    for first, end in [g for g in groups[1:] if g[1] > g[0]]:
        ax.annotate(
            f"{end - first + 1} starts", (0.5 * (places[first] + places[end]), above[first]),
            xytext=(0, 7), textcoords="offset points", ha="center", fontsize=9, color="0.25",
        )  # fmt: skip
    lost = int((~finite).sum())
    title = f"{last + 1} of {len(above)} starts found the best optimum"
    title += f"; {lost} diverged" if lost else ""
    ax.set_title(title, loc="left")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    return draw.done(
        ax, f"{title}.", legend={"loc": "best"}, xlabel="start, sorted",
        ylabel="objective above the best, $-2\\,\\Delta\\log L$ [-]",
        xlim=(0.5, len(above) + 0.5), ylim=(-0.5 * SAME_OPTIMUM, 3.0 * top),
    )  # fmt: skip


# -- the benchmark ---------------------------------------------------------------------------

MARKERS = ("o", "s", "^", "D", "v", "P")


def plot_errors(rows: Sequence[Row], *, ax: Axes | None = None) -> Axes:
    """Plot the error of each estimator on one problem, one mark per noise level.

    The error is that of the parameters which the data determine; the short
    vertical lines are what an unbiased estimator can reach (Cramér-Rao), in the
    colour of their noise level. A hollow mark says that some runs did not
    converge. Marks at the right edge lie beyond it. Estimators that cannot
    treat the problem are left out.

    Parameters
    ----------
    rows : sequence of Row
        Of one problem and sampling.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax)
    levels: dict[float, list[Row]] = {}
    errors: dict[str, list[float]] = {}
    for row in rows:
        if row.noise > 0 and not row.refused:
            levels.setdefault(row.noise, []).append(row)
            errors.setdefault(row.estimator, []).append(np.log(max(row.rmse_determined, 1e-9)))
    names = sorted(errors, key=lambda name: float(np.mean(errors[name])))  # the best on top
    for number, level in enumerate(sorted(levels)):
        look = {"color": draw.model_style(number).colour, "marker": MARKERS[number % len(MARKERS)]}
        shift = (number - (len(levels) - 1) / 2) * 0.22
        places = dict(zip(names, np.arange(len(names)) + shift, strict=True))
        _draw_level(ax, levels[level], places, look)
    if OURS in names:
        place = names.index(OURS)
        ax.axhspan(place - 0.45, place + 0.45, color=draw.NEUTRAL, alpha=0.18, lw=0)
    draw.decades(ax, "x", (1.0,))
    ax.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    words = "error of determined parameters [%]"
    said = f"{names[0].replace('_', ' ')} errs least." if names else "No estimator ran."
    return draw.done(ax, said, ylim=(len(names) - 0.4, -0.6), xlabel=words)


def _draw_level(
    ax: Axes, rows: Sequence[Row], places: Mapping[str, float], look: dict[str, Any]
) -> None:
    """Draw errors at one noise level: a mark per estimator, and what can be reached at best."""
    ax.axvline(100.0 * rows[0].bound, color=look["color"], lw=1.0, alpha=0.6, linestyle=":")
    for row in rows:
        error = np.clip(100.0 * row.rmse_determined, 1e-2, 1e4)  # beyond: at the edge
        fill = "none" if row.n_failed else look["color"]
        ax.plot(error, places[row.estimator], ms=5.5, mfc=fill, clip_on=False, **look)
    # The legend shows full marks, whichever estimator comes first.
    ax.plot([], [], ls="", label=f"noise {rows[0].noise:g} {UNITS[rows[0].noise_unit]}", **look)


def plot_comparison(
    ratios: np.ndarray, estimators: Sequence[str], worlds: Sequence[str], *, ax: Axes | None = None
) -> Axes:
    """Plot how much larger the error of each estimator is, by what acts on the records.

    Colours stand for the logarithm of the ratio; beyond a factor of ten they no longer change.
    What cannot be treated, or was not run, is left blank.

    Parameters
    ----------
    ratios : ndarray (n_estimators, n_worlds)
        Error over that of the estimator that all are compared with; NaN where there is none.
    estimators, worlds : sequence of str
        Their names.
    ax : Axes, optional
        Where to draw.

    Returns
    -------
    Axes
        What was drawn on; its label is what the picture shows, in words.
    """
    ax = draw.new_axes(ax, size=(2.6 + 0.95 * len(worlds), 0.8 + 0.3 * len(estimators)))
    powers = np.log10(np.ma.masked_invalid(ratios))
    ax.imshow(powers, cmap=draw.DIVERGING, vmin=-1, vmax=1, aspect="auto")
    for (i, j), ratio in np.ndenumerate(ratios):
        if np.isfinite(ratio):
            dark = abs(np.log10(ratio)) > 0.7  # colours on which white is read better
            text = f"{ratio:.2f}" if ratio < 10 else f"{ratio:.0f}"
            ax.text(j, i, text, ha="center", va="center", color="white" if dark else "black")
    ax.set_yticks(range(len(estimators)), estimators)
    ax.set_xticks(range(len(worlds)), worlds)
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    return draw.say(ax, "error of the determined parameters over that of the default fit")


def _against(rows: Sequence[Row], names: Sequence[str], worlds: Sequence[str]) -> np.ndarray:
    """Geometric means, over settings, of errors over those of the first of the estimators."""
    runs = {(row.setting, row.estimator): row for row in rows if not row.refused}
    first = next((name for name in (OURS_DISTURBED, OURS) if name in names), names[0])
    logs: dict[tuple[str, str], list[float]] = {}
    for (setting, name), row in runs.items():
        if own := runs.get((setting, first)):
            of_setting = np.median(logarithms_of_ratios(row.by_seed, own.by_seed))
            logs.setdefault((name, row.world), []).append(float(of_setting))
    return np.array(
        [[np.exp(np.mean(logs.get((name, world), [np.nan]))) for world in worlds] for name in names]
    )


def figure_benchmark(result: Benchmark) -> Figure:
    """All problems of a benchmark, one panel each; see :func:`plot_errors`.

    Where there are several worlds, one comparison of them; see :func:`plot_comparison`.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    if len(worlds := list(dict.fromkeys(row.world for row in result.rows))) > 1:
        names = list(dict.fromkeys(row.estimator for row in result.rows if not row.refused))
        ax = plot_comparison(_against(result.rows, names, worlds), names, worlds)
        return cast(Figure, ax.figure)
    titled = groupby(result.rows, key=lambda row: (row.problem, row.sampling))
    groups = [(title, list(group)) for title, group in titled]
    figure, axes = draw.panels(len(groups), 2, (5.6, 3.4))
    for ax, ((problem, sampling), rows) in zip(axes, groups, strict=True):
        plot_errors(rows, ax=ax)
        rare = "" if sampling == 1 else f", {sampling} times rarer samples"
        ax.set_title(problem.replace("_", " ") + rare)
    handles, labels = axes[0].get_legend_handles_labels()
    note = Line2D([], [], marker="o", ls="", color=draw.NEUTRAL, mfc="none")
    bound = Line2D([], [], ls=":", color=draw.NEUTRAL)
    figure.legend(
        [*handles, note, bound],
        [*labels, "some runs did not converge", "Cramér-Rao bound"],
        loc="outside upper center", ncols=len(labels) + 2, frameon=False, fontsize=9,
    )  # fmt: skip
    return figure
