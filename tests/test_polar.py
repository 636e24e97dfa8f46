"""Static velocity prediction against sailing that can be solved by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from oed_sysid import Dataset, Experiment, Input, Model, Output, Parameter, State
from oed_sysid.baselines import EquationError
from oed_sysid.errors import DataError, ModelError
from oed_sysid.experiments.manoeuvres import Piecewise
from oed_sysid.experiments.simulation import simulate
from oed_sysid.prediction.speed_polar import SailingNames, speed_polar
from oed_sysid.results import plot_polar

# Thrust ~ wind^2 sin(angle) with a quadratic optimum at 0.6 rad of sheet; drag ~ drag*u^2.
CART = Model(
    "land yacht",
    (State("u", "m/s"), State("r", "rad/s"), State("psi", "rad")),
    (
        Input("delta", "rad"),
        Input("sheet", "rad"),
        Input("wind_speed", "m/s"),
        Input("wind_from", "rad"),
    ),
    (
        Output("u", "m/s", noise_std=0.01),
        Output("r", "rad/s", noise_std=1e-3),
        Output("psi", "rad", noise_std=1e-3),
    ),
    {
        "u": "(sin(wind_from - psi)*wind_speed**2*(1 - (sheet - 0.6)**2) - drag*u*abs(u))/10",
        "r": "delta - 0.1 - r",
        "psi": "r",
    },
    parameters=(Parameter("drag", 4.0, "kg/m", lower=0.1),),
)
ANGLES = np.radians([30.0, 60.0, 90.0])
SHEETS = (0.2, 0.6, 1.0)


def test_speed_is_that_of_the_balance() -> None:
    """Thrust equals drag: u = wind*sqrt(sin(angle)/drag), at the sheet of most thrust."""
    polar = speed_polar(CART, wind_speed=5.0, angles=ANGLES, sheets=SHEETS)
    assert polar.speeds == pytest.approx(5.0 * np.sqrt(np.sin(ANGLES) / 4.0), rel=1e-6)
    assert polar.sheets == pytest.approx(0.6)
    assert polar.states["delta"] == pytest.approx(0.1)
    assert "land yacht" in polar.report()


def test_band_follows_the_uncertainty_of_the_fit() -> None:
    """Speed goes with drag to the power -1/2: its relative spread is half that of the drag."""
    run = Experiment(
        "gusts",
        Piecewise("wind_speed", (0.0, 10.0, 20.0), (3.0, 6.0, 4.0)),
        duration=30.0,
        sample_time=0.5,
        constants={"delta": 0.1, "sheet": 0.6, "wind_from": 1.5},
        initial={"u": 1.0},
    )
    data = Dataset((simulate(CART, run, rng=np.random.default_rng(3)),))
    fit = EquationError(coloured="never").fit(CART, data)
    polar = speed_polar(fit, wind_speed=5.0, angles=ANGLES, sheets=SHEETS, n_draws=200)
    share = fit.std_errors["drag"] / fit.values["drag"]
    low, high = polar.interval(0.95)
    assert (high - low) / polar.speeds == pytest.approx(2 * 1.96 * share / 2, rel=0.2)
    assert np.all((low < polar.speeds) & (polar.speeds < high))
    plain = speed_polar(fit.model, wind_speed=5.0, angles=ANGLES, sheets=SHEETS)
    assert np.isnan(plain.interval()[0]).all()
    ax = plot_polar(polar, truth=plain)
    assert np.allclose(ax.lines[0].get_ydata(), polar.speeds)
    assert "m/s" in ax.get_title()


def test_no_wind_from_ahead_is_said() -> None:
    """Straight into the wind nothing drives: no speed, and the table says none."""
    polar = speed_polar(CART, wind_speed=5.0, angles=[-0.5], sheets=SHEETS)
    assert math.isnan(polar.speeds[0])
    assert "none" in polar.report()
    assert polar.to_dict()["speeds"] == [None]


def test_missing_channels_are_named() -> None:
    """Other names of channels can be told, and a wrong one is named."""
    renamed = replace(CART, name="without a sheet", inputs=CART.inputs)
    with pytest.raises(ModelError, match="no input 'main_sheet'"):
        speed_polar(
            renamed,
            wind_speed=5.0,
            angles=ANGLES,
            sheets=SHEETS,
            names=SailingNames(sheet="main_sheet"),
        )
    with pytest.raises(ModelError, match="at least one angle"):
        speed_polar(CART, wind_speed=5.0, angles=[], sheets=SHEETS)


def test_polar_needs_polar_axes() -> None:
    """Square axes are refused with words."""
    from oed_sysid.results import new_figure

    polar = speed_polar(CART, wind_speed=5.0, angles=ANGLES[:1], sheets=SHEETS)
    _, axes = new_figure(1, 1, size=(3, 3))
    with pytest.raises(DataError, match="polar axes"):
        plot_polar(polar, ax=axes[0, 0])
