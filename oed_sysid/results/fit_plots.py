"""Pictures of one fit: data, model, residuals, estimates, profile curves and joint regions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from oed_sysid.errors import DataError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information, autocorrelation, effective_sample_size
from oed_sysid.likelihood.multistart import Profile
from oed_sysid.results.style import (
    NEUTRAL,
    TRUTH,
    clean,
    legend_above,
    model_style,
    new_axes,
    panels,
    row_axes,
    say,
    spread_legend,
    symbol_of,
    zero,
)
from oed_sysid.runtime.display import TWO_SIDED_95

# Blue over white to vermilion; darkness says how strong in greyscale.
_DIVERGING = LinearSegmentedColormap.from_list(
    "correlation", ["#003f66", "#8fbfdc", "white", "#f0a87f", "#8a2f00"]
)


def plot_autocorrelation(
    fit: Fit, output: str, *, max_lag: float | None = None, style: int = 0, ax: Axes | None = None
) -> Axes:
    """Plot the autocorrelation of the residuals of one output, one line per record.

    The band holds 95 % of the values if the residuals were white. Bars would
    hide one record behind the other, so each record is a line.

    Parameters
    ----------
    fit : Fit
        The fit.
    output : str
        Which output.
    max_lag : float, optional
        Longest lag, s; by default 60 samples.
    style : int
        Position of the model in a comparison.
    ax : Axes, optional
        Where to draw.
    """
    ax = new_axes(ax)
    column = fit.model.output_names.index(output)
    samples, effective, total = 0, 0.0, 0
    for record, residual in zip(fit.dataset, fit.residuals, strict=True):
        series = residual[:, column]
        present = int(np.isfinite(series).sum())
        if present < 10:
            continue
        step = record.sample_time
        n_lags = min(present // 4, 60 if max_lag is None else max(1, int(max_lag / step)))
        rho = autocorrelation(series, n_lags)
        ax.plot(
            np.arange(1, n_lags + 1) * step, rho[1:], lw=1.3, alpha=0.85,
            color=model_style(style).colour, label="records",
        )  # fmt: skip
        samples = max(samples, present)
        effective += effective_sample_size(series)
        total += present
    half = TWO_SIDED_95 / np.sqrt(samples) if samples else 0.0
    zero(ax, half, "95 % band of white noise")
    ax.set(
        xlabel="lag [s]",
        ylabel="autocorrelation [-]",
        title=f"{symbol_of(output)}: {effective:.0f} independent of {total} samples",
        ylim=(-1.05, 1.05),
    )
    words = f"Residuals of {output}: {effective:.0f} of {total} samples are independent."
    return say(clean(ax), words if total else f"{output} was not measured.")


def plot_intervals(
    fits: Fit | Sequence[Fit],
    *,
    labels: Sequence[str] | None = None,
    truth: dict[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot estimates with 95 % intervals, relative to the prior or the first fit.

    Parameters
    ----------
    fits : Fit or sequence of Fit
        Fits of models that share parameters.
    labels : sequence of str, optional
        Names of the fits; by default those of their models.
    truth : dict, optional
        True values, where they are known.
    ax : Axes, optional
        Where to draw.

    Notes
    -----
    Values are divided by the size of the prior mean (the first fit's value
    where there is none), so that all parameters share an axis.
    """
    several = [fits] if isinstance(fits, Fit) else list(fits)
    names = list(dict.fromkeys(name for fit in several for name in fit.names))
    ax, rows = row_axes(ax, [symbol_of(name) for name in names], 6.4, tall=0.34, edge=0.8)
    scale = {name: _reference(several, name) for name in names}
    for index, fit in enumerate(several):
        shift = 0.22 * (index - (len(several) - 1) / 2)
        label = labels[index] if labels else f"{fit.model.name} (95 %)"
        _draw_estimates(ax, fit, index, dict(zip(names, rows - shift, strict=True)), scale, label)
    _draw_priors(ax, several[0], names, scale, rows)
    for name, row in zip(names, rows, strict=True):
        if truth and name in truth:
            ax.plot(truth[name] / scale[name], row, "|", color=TRUTH, ms=14, mew=2, label="truth")
    parameters = [several[0].model.parameter(name) for name in names if name in several[0].names]
    has_prior = any(parameter.prior_mean is not None for parameter in parameters)
    what = "the prior" if has_prior else "the estimate"
    ax.set(xlabel=f"value relative to {what} [-]")
    clean(ax)
    # Above: below, its distance from the axis' label would depend on the height.
    legend_above(ax)
    return say(ax, _least_certain(several))


def _draw_estimates(
    ax: Axes, fit: Fit, index: int, rows: dict[str, float], scale: dict[str, float], label: str
) -> None:
    """Draw the estimates of one fit with their intervals, in the look of its position."""
    found = [name for name in rows if name in fit.values]
    sizes = np.array([scale[name] for name in found])
    half = TWO_SIDED_95 * np.array([fit.std_errors[name] for name in found]) / np.abs(sizes)
    ax.errorbar(
        np.array([fit.values[name] for name in found]) / sizes, [rows[name] for name in found],
        xerr=np.where(np.isfinite(half), half, 0.0), fmt="osD^v<"[index % 6], ms=4.5,
        color=model_style(index).colour, elinewidth=1.6, capsize=3, label=label,
    )  # fmt: skip


def plot_correlation(fit: Fit, *, ax: Axes | None = None) -> Axes:
    """Plot the correlation matrix of the estimates; numbers where it exceeds 0.5."""
    size = 1.6 + 0.42 * len(fit.names)
    ax = new_axes(ax, size=(size + 1.6, size + 0.3))
    matrix = fit.correlation
    picture = ax.imshow(matrix, cmap=_DIVERGING, vmin=-1, vmax=1)
    ticks = range(len(fit.names))
    ax.set_xticks(
        ticks, [symbol_of(name) for name in fit.names], rotation=60, ha="right",
        rotation_mode="anchor",
    )  # fmt: skip
    ax.set_yticks(ticks, [symbol_of(name) for name in fit.names])
    for i in ticks:
        for j in range(i):
            value = matrix[i, j]
            if abs(value) > 0.5:
                ax.text(
                    j, i, f"{value:+.2f}".replace("0.", "."), ha="center", va="center",
                    fontsize=7.5, color="white" if abs(value) > 0.8 else "black",
                )  # fmt: skip
    ax.tick_params(labelsize=9, length=0)
    bar = ax.get_figure().colorbar(picture, ax=ax, shrink=0.8)  # type: ignore[union-attr]
    bar.set_label("correlation [-]")
    return say(ax, _closest(fit))


def figure_whiteness(fit: Fit, *, style: int = 0) -> Figure:
    """Autocorrelation of the residuals of all outputs."""
    outputs = fit.model.output_names
    figure, axes = panels(len(outputs), 3, (3.7, 2.7), sharey=True)
    for place, (ax, name) in enumerate(zip(axes, outputs, strict=True)):
        plot_autocorrelation(fit, name, style=style, ax=ax)
        ax.title.set_fontsize(10)
        if place % 3:
            ax.set_ylabel("")
    return figure


def _least_certain(fits: Sequence[Fit]) -> str:
    """Which estimate has the widest interval, of each fit."""
    said = []
    for fit in fits:
        half = {
            name: TWO_SIDED_95 * fit.std_errors[name] / abs(value)
            for name, value in fit.values.items()
            if value
        }
        if half:
            name = max(half, key=lambda one: half[one])
            said.append(
                f"{fit.model.name}: least certain is {name}, ± {100 * half[name]:.2g} % (95 %)."
            )
    return " ".join(said)


def _closest(fit: Fit) -> str:
    """Which two estimates are hardest to tell apart."""
    matrix = np.abs(np.tril(fit.correlation, -1))
    if not matrix.size or not np.isfinite(matrix).any():
        return ""
    i, j = np.unravel_index(int(np.nanargmax(matrix)), matrix.shape)
    return (
        f"Hardest to tell apart are {fit.names[j]} and {fit.names[i]}: correlation "
        f"{fit.correlation[i, j]:+.2f}."
    )


def _reference(fits: Sequence[Fit], name: str) -> float:
    for fit in fits:
        if name in fit.values:
            parameter = fit.model.parameter(name)
            return parameter.prior_mean or fit.values[name] or parameter.magnitude
    return 1.0


def _draw_priors(
    ax: Axes, fit: Fit, names: Sequence[str], scale: dict[str, float], rows: np.ndarray
) -> None:
    """Grey bars: 95 % of the prior of each parameter that has one."""
    for name, row in zip(names, rows, strict=True):
        parameter = fit.model.parameter(name) if name in fit.model.parameter_names else None
        if parameter is None or parameter.prior_spread is None or parameter.prior_mean is None:
            continue
        centre = parameter.prior_mean / scale[name]
        half = TWO_SIDED_95 * parameter.prior_spread / abs(scale[name])
        ax.barh(row, 2 * half, left=centre - half, height=0.7, color=NEUTRAL, alpha=0.3,
                lw=0, label="prior (95 %)", zorder=0.5)  # fmt: skip


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
    legend_above(ax)
    return say(clean(ax), profile.report())


def _covariance(information: Information, pair: tuple[str, str]) -> np.ndarray:
    """Covariance of two parameters, shape ``(2, 2)``."""
    absent = [name for name in pair if name not in information.names]
    if absent:
        raise DataError(f"There is no {absent[0]!r}; there are {', '.join(information.names)}.")
    rows = [information.names.index(name) for name in pair]
    covariance: np.ndarray = information.covariance[np.ix_(rows, rows)]
    if not np.isfinite(covariance).all():
        raise DataError(f"{pair[0]} and {pair[1]} are not both determined, so there is no ellipse.")
    return covariance


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
        covariance = _covariance(one, pair)
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
