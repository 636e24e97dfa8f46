"""Pictures of a log check: how well equations between signals hold, and what was found."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid.evidence.check import Balance, LogCheck
from oed_sysid.results.style import (
    COLOURS,
    NEUTRAL,
    TRUTH,
    clean,
    new_axes,
    new_figure,
    span,
    symbol_of,
)
from oed_sysid.text.units import shown_unit

_BEFORE, _AFTER = COLOURS[0], COLOURS[1]
_MOST_RECORDS = 3
# Residuals beyond this many of the corrected ones are cut off, or the corrected ones vanish.
_TALL = 12.0


def plot_balances(found: LogCheck, ax: Axes | None = None) -> Axes:
    """Plot what each equation leaves of the changes of its left side, before and after.

    Parameters
    ----------
    found : LogCheck
        A check with equations.
    ax : Axes, optional
        Where to draw.
    """
    n = len(found.balances)
    ax = new_axes(ax, size=(6.4, 1.3 + 0.5 * n))
    rows = np.arange(n)[::-1]
    before = np.array([100.0 * one.before for one in found.balances])
    after = np.array([100.0 * one.after for one in found.balances])
    ax.hlines(rows, np.minimum(before, after), np.maximum(before, after), color=NEUTRAL, lw=2.0)
    ax.plot(before, rows, "s", color=_BEFORE, ms=8, label="as logged")
    ax.plot(after, rows, "o", color=_AFTER, ms=6, mec="white", label="findings undone")
    ax.axvline(100.0, color=TRUTH, lw=1.0, ls=":")
    ax.set_xscale("log")
    low, high = min(after.min(), before.min()), max(before.max(), after.max(), 100.0)
    ax.set_xlim(low / 2.0, high * 2.0)
    ax.xaxis.set_major_formatter("{x:g}")
    ax.set_yticks(rows, [one.relation for one in found.balances])
    ax.set_ylim(-0.6, n - 0.4)
    ax.set_xlabel("unexplained share of the left side's changes [%]")
    clean(ax)
    ax.grid(False, axis="y")
    ax.legend(frameon=False, fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return ax


def plot_balance(balance: Balance, record: str, ax: Axes | None = None) -> Axes:
    """Plot a signal minus the integral of the others, as logged and with the findings undone.

    Parameters
    ----------
    balance : Balance
        Of one equation.
    record : str
        Which record.
    ax : Axes, optional
        Where to draw.

    Notes
    -----
    The constant of integration is chosen so that the mean is zero. Where the log as it is leaves
    far more than the corrected one, the axis follows the corrected one, twelve times as wide.
    """
    ax = new_axes(ax, size=(6.4, 2.4))
    turn, unit = shown_unit(balance.unit)
    chosen = [part for part in balance.series if part[0] == record]
    shown: list[np.ndarray] = []
    for number, (_, times, before, after) in enumerate(chosen):
        start = times[0]
        names = ("as logged", "findings undone") if number == 0 else (None, None)
        same = np.allclose(before, after)
        ax.plot(times - start, turn * before, color=_BEFORE, lw=1.4, label=names[0])
        if not same:
            ax.plot(times - start, turn * after, color=_AFTER, lw=1.0, label=names[1])
        shown.append(turn * after)
    whole = np.concatenate(shown) if shown else np.zeros(1)
    reach = float(np.max(np.abs(whole))) or 1.0
    most = max((float(np.max(np.abs(turn * p[2]))) for p in chosen), default=reach)
    if most > _TALL * reach:
        ax.set_ylim(-_TALL * reach, _TALL * reach)
        ax.text(
            0.99, 0.97, f"as logged up to {most:.3g} {unit}", transform=ax.transAxes, ha="right",
            va="top", fontsize=8, color="0.3", bbox={"fc": "white", "ec": "none", "pad": 1.0},
        )  # fmt: skip
    else:
        ax.set_ylim(*span([-most, most]))
    ax.axhline(0.0, color=TRUTH, lw=0.8)
    ax.set(xlabel="time from the start [s]", ylabel=f"{symbol_of(balance.target)} left [{unit}]")
    return clean(ax)


def figure_check(found: LogCheck) -> Figure:
    """Draw the residuals of all equations, one row each, for up to three records.

    Parameters
    ----------
    found : LogCheck
        A check with equations.
    """
    names = found.records[:_MOST_RECORDS]
    n = len(found.balances)
    figure, axes = new_figure(n, len(names), size=(1.2 + 3.4 * len(names), 0.6 + 1.9 * n))
    for row, balance in enumerate(found.balances):
        for column, name in enumerate(names):
            ax = axes[row, column]
            plot_balance(balance, name, ax=ax)
            if row == 0:
                ax.set_title(name, fontsize=10)
            if row < n - 1:
                ax.set_xlabel("")
            if column:
                ax.set_ylabel("")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    for ax in axes.flat:
        more = ax.get_legend_handles_labels()
        if len(more[0]) > len(handles):
            handles, labels = more
    figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False, fontsize=9)
    return figure
