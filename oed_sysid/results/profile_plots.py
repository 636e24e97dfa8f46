"""How well parameters are known, beyond one interval: profile curves and joint regions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from oed_sysid.errors import DataError
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.multistart import Profile
from oed_sysid.results.style import (
    NEUTRAL,
    TRUTH,
    clean,
    model_style,
    new_axes,
    say,
    spread_legend,
    symbol_of,
)
from oed_sysid.runtime.display import TWO_SIDED_95


def plot_profile(profile: Profile, *, ax: Axes | None = None) -> Axes:
    """Plot the profile likelihood of a parameter, and the parabola that a standard error means.

    Parameters
    ----------
    profile : Profile
        From :func:`~oed_sysid.likelihood.multistart`.
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax, size=(5.6, 3.6))
    look = model_style(1)
    ax.axhline(profile.threshold, color=TRUTH, ls="--", lw=1.0, label=f"{profile.level:.0%}")
    bounded = [end for end in (profile.lower, profile.upper) if np.isfinite(end)]
    ax.plot(profile.values, profile.rises, "o-", color=look.colour, ms=3.5, lw=1.5, label="profile")
    half = [abs(end - profile.estimate) for end in bounded if end != profile.estimate]
    if half:
        fine = np.linspace(profile.values.min(), profile.values.max(), 101)
        # The parabola through the nearer end: what a symmetric interval would claim.
        curve = profile.threshold * ((fine - profile.estimate) / min(half)) ** 2
        ax.plot(fine, curve, color=NEUTRAL, lw=1.2, ls=":", label="if it were quadratic")
    for end in bounded:
        ax.axvline(end, color=NEUTRAL, lw=0.9)
    ax.axvline(profile.estimate, color=TRUTH, lw=0.9)
    top = max(2.0 * profile.threshold, 1.0)
    ax.set(
        xlabel=f"{symbol_of(profile.name)} [{profile.unit or '-'}]",
        ylabel=r"rise of $-2\,\log L$ [-]",
        ylim=(min(0.0, float(profile.rises.min())) - 0.03 * top, top),
    )
    spread_legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return say(clean(ax), profile.report())


def plot_ellipses(
    informations: Sequence[Information],
    pair: tuple[str, str],
    *,
    centres: Sequence[tuple[float, float]] | None = None,
    labels: Sequence[str] | None = None,
    units: tuple[str, str] | None = None,
    truth: tuple[float, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot what records or experiments tell about two parameters together.

    The shadow of an ellipse on each axis is that parameter's 95 % interval; a long thin one means
    that only a combination of the two is known.

    Parameters
    ----------
    informations : sequence of Information
        Such as ``fit.information`` or ``design.information``.
    pair : tuple of str
        Parameters on the horizontal and on the vertical axis.
    centres : sequence of tuple of float, optional
        Estimates; zero by default.
    labels : sequence of str, optional
        Names.
    units : tuple of str, optional
        Units of the two, such as ``fit.model.parameter(name).unit``.
    truth : tuple of float, optional
        True values, where they are known.
    ax : Axes, optional
        Where to draw.

    Raises
    ------
    DataError
        If a parameter is not among those of an information, or has no finite error.
    """
    ax = new_axes(ax, size=(5.2, 4.6))
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    said = []
    for number, one in enumerate(informations):
        absent = [name for name in pair if name not in one.names]
        if absent:
            raise DataError(f"There is no {absent[0]!r}; there are {', '.join(one.names)}.")
        rows = [one.names.index(name) for name in pair]
        covariance = one.covariance[np.ix_(rows, rows)]
        if not np.isfinite(covariance).all():
            raise DataError(
                f"{pair[0]} and {pair[1]} are not both determined, so there is no ellipse."
            )
        axes, turned = np.linalg.eigh(covariance)
        edge = TWO_SIDED_95 * turned @ (np.sqrt(np.maximum(axes, 0.0))[:, None] * circle)
        centre = (0.0, 0.0) if centres is None else centres[number]
        look, name = model_style(number), labels[number] if labels else f"case {number + 1}"
        ax.plot(centre[0] + edge[0], centre[1] + edge[1], color=look.colour, ls=look.dashes,
                lw=1.6, label=name)  # fmt: skip
        ax.plot(*centre, "+", color=look.colour, ms=8)
        errors = np.sqrt(np.diag(covariance))
        rho = covariance[0, 1] / errors.prod()
        half = ", ".join(
            f"{n} ± {TWO_SIDED_95 * e:.2g}{f' {unit}' if unit else ''}"
            for n, e, unit in zip(pair, errors, units or ("", ""), strict=True)
        )
        said.append(f"{name}: {half} (95 %), correlation {rho:+.2f}.")
    if truth is not None:
        ax.plot(*truth, "x", color=TRUTH, ms=8, mew=2, label="truth")
    about = "" if centres is not None else " away from the estimate"
    x, y = (f"{symbol_of(n)}{about}{_in(u)}" for n, u in zip(pair, units or ("", ""), strict=True))
    ax.set(xlabel=x, ylabel=y)
    spread_legend(ax, loc="best")
    return say(clean(ax), " ".join(said))


def _in(unit: str) -> str:
    return f" [{unit}]" if unit else ""
