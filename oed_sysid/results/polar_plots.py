"""The polar of a sailing vehicle: steady speed over the angle to the true wind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from oed_sysid.errors import DataError
from oed_sysid.prediction.speed_polar import SpeedPolar
from oed_sysid.results.style import TRUTH, model_style, new_figure, spread_legend


def plot_polar(
    polars: SpeedPolar | Sequence[SpeedPolar],
    *,
    truth: SpeedPolar | None = None,
    labels: Sequence[str] | None = None,
    level: float = 0.95,
    ax: Axes | None = None,
) -> Axes:
    """Plot speed polars with credible bands: wind from above, speed outward.

    Parameters
    ----------
    polars : SpeedPolar or sequence of SpeedPolar
        One curve and band each.
    truth : SpeedPolar, optional
        What the simulator sails, in black.
    labels : sequence of str, optional
        Names of the curves; by default the wind speeds.
    level : float
        Probability of the bands.
    ax : Axes, optional
        Polar axes (``projection="polar"``) to draw on.

    Raises
    ------
    DataError
        If the axes are not polar.
    """
    several = [polars] if isinstance(polars, SpeedPolar) else list(polars)
    ax = _polar_axes() if ax is None else ax
    if ax.name != "polar":
        raise DataError("A speed polar needs polar axes. Make them with projection='polar'.")
    names = labels or [f"{polar.wind_speed:g} m/s wind" for polar in several]
    for index, (polar, name) in enumerate(zip(several, names, strict=True)):
        look = model_style(index)
        ax.plot(polar.angles, polar.speeds, color=look.colour, ls=look.dashes, lw=1.6, label=name)
        low, high = polar.interval(level)
        if np.isfinite(low).any():
            ax.fill_between(
                polar.angles, low, high, color=look.colour, alpha=0.25, lw=0, label=f"{level:.0%}"
            )
    if truth is not None:
        ax.plot(truth.angles, truth.speeds, ".", color=TRUTH, ms=6, label="truth")
    ax.set_theta_zero_location("N")  # type: ignore[attr-defined]
    ax.set_theta_direction(-1)  # type: ignore[attr-defined]
    ax.set_thetamin(0)  # type: ignore[attr-defined]
    ax.set_thetamax(180)  # type: ignore[attr-defined]
    ax.set_rlim(bottom=0.0)  # type: ignore[attr-defined]
    ax.grid(True, color="0.88", linewidth=0.7)
    ax.tick_params(colors="0.25", labelsize=9)
    ax.set_title("speed [m/s] over angle to the true wind", fontsize=11)
    spread_legend(ax, loc="center left", bbox_to_anchor=(-0.28, 0.5))
    return ax


def _polar_axes() -> Axes:
    _, axes = new_figure(1, 1, size=(5.4, 6.0), subplot_kw={"projection": "polar"})
    return axes[0, 0]
