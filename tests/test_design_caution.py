"""Limits that hold although the parameters are wrong, checked by another integrator."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import binom
from test_design import LIMITS, grid, quick, ship

from oed_sysid import Input, Limits, Model, Output, Parameter, State
from oed_sysid.design import Caution, Design, Levels, ZigZags, assess_limits
from oed_sysid.design.vehicles import (
    UNCERTAINTY,
    LimitBounds,
    Scenarios,
    at_least,
    draw_models,
)
from oed_sysid.errors import DesignError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.information import Information

CAUTION = Caution(0.9, 0.3, n_sets=60, n_checks=300)


@pytest.fixture(scope="module", name="careful")
def _careful() -> Design:
    """A design that keeps its limits on nine of ten vehicles, coefficients 30 % wrong."""
    return quick(caution=CAUTION)


def _reaches(commands: np.ndarray, b: float, d: float, c: float) -> tuple[float, float]:
    """Lowest and highest heading by SciPy's adaptive integrator, equations written anew."""

    def rates(_: float, x: np.ndarray, rudder: float) -> list[float]:
        return [x[1], b * rudder - d * x[1] - c * x[1] * abs(x[1])]

    low, high, x = 0.0, 0.0, np.zeros(2)
    edges = [0, *(np.flatnonzero(np.diff(commands[:-1])) + 1), len(commands) - 1]
    for first, last in pairwise(edges):
        times = 0.5 * np.arange(first, last + 1)
        span, held = (times[0], times[-1]), (commands[first],)
        path = solve_ivp(rates, span, x, t_eval=times, args=held, rtol=1e-7, atol=1e-9).y
        low, high, x = min(low, path[0].min()), max(high, path[0].max()), path[:, -1]
    return low, high


def test_stated_probability_holds_in_an_independent_simulation(careful: Design) -> None:
    """The share of violations found by another integrator agrees with the stated one."""
    assert careful.assurance is not None
    stated = careful.assurance.probability
    assert stated >= 0.9
    rng = np.random.default_rng(99)
    n_vehicles = 80
    commands = careful.trajectory.inputs[:, 0]
    kept = 0
    for _ in range(n_vehicles):
        b, d, c = np.array([0.12, 0.4, 1.5]) * (1 + 0.3 * rng.uniform(-1, 1, 3))
        low, high = _reaches(commands, b, d, c)
        kept += low >= -0.6 and high <= 0.6
    assert binom.ppf(1e-3, n_vehicles, stated) <= kept <= binom.ppf(1 - 1e-3, n_vehicles, stated)


def test_caution_costs_little_and_its_absence_breaks_limits(careful: Design) -> None:
    """Without caution many of these vehicles leave the limits; with it most of the gain stays."""
    bold = quick()
    found = assess_limits(
        ship(), bold.experiment, limits=LIMITS, spread=0.3, rng=np.random.default_rng(5)
    )
    assert found.probability < 0.85
    assert sum(found.left.values()) == found.n_checked - found.n_kept
    for safe, free in zip(careful.references, bold.references, strict=True):
        assert careful.gain(safe)[0] > 0.6 * bold.gain(free)[0]
    assert "limits kept on" in careful.report()


def test_guards_have_the_derivatives_of_differences() -> None:
    """Changes of limited signals from an edge on equal those of whole runs."""
    model, fitted = ship(), grid()
    shape = Levels(12).on(fitted)
    bounds = LimitBounds.of(model, Limits(signals={"psi": (-0.3, 0.3)}), {"r": (-0.1, 0.1)})
    scenarios = Scenarios(
        [model.with_values({"d": 0.3})], fitted.times, shape.edges, np.array([0.0, 0.01]), bounds
    )
    assert scenarios.bounds.names == ("psi",), "the end is a goal of the nominal vehicle"
    numbers = np.full((2, 12), 0.6)
    numbers[1, 7] = 0.9
    first, second = shape.commands(numbers)
    before, after = scenarios.run(0, first), scenarios.run(0, second)
    edge = int(np.searchsorted(shape.edges, np.flatnonzero((first != second)[:, 0])[0], "right"))
    changed = scenarios.change(0, before, second, edge - 1)
    start = shape.edges[edge - 1]
    np.testing.assert_allclose(changed, (after.signals - before.signals)[start:], atol=1e-12)


def test_waived_vehicles_do_not_count() -> None:
    """The level is that of the worst vehicle that still counts, and the first limit is named."""
    model, fitted = ship(), grid()
    bounds = LimitBounds.of(model, Limits(signals={"psi": (-0.3, 0.3)}))
    models = [model.with_values({"b": b}) for b in (0.05, 0.12, 0.2)]
    scenarios = Scenarios(models, fitted.times, np.array([0]), np.zeros(2), bounds, n_waived=1)
    commands = np.full((81, 1), 0.1)
    runs = [scenarios.run(i, commands) for i in range(3)]
    assert scenarios.level(runs) == runs[2].excess
    scenarios.waive(runs)
    assert scenarios.level(runs) == runs[1].excess
    assert scenarios.decisive(runs) == [1, 0]
    pushed = simulate_inputs(models[2], fitted.times, inputs=commands)
    assert bounds.first_left(pushed) == "psi upper limit"


def test_closed_loop_keeps_limits_on_other_vehicles() -> None:
    """A cautious zigzag closes its loop on each vehicle and keeps the heading there."""
    found = quick(
        family=ZigZags("psi"),
        caution=replace(CAUTION, n_sets=20, n_checks=40),
    )
    assert found.experiment.reacts
    assert found.assurance is not None
    assert found.assurance.probability >= 0.9
    again = assess_limits(
        ship(), found.experiment, limits=LIMITS, rng=np.random.default_rng(8), vehicles=40
    )
    assert again.probability >= 0.8


def test_nonsense_is_named() -> None:
    """A probability of two is answered with advice."""
    with pytest.raises(DesignError, match="probability 2"):
        Caution(2.0)
    with pytest.raises(DesignError, match="spread 3"):
        Caution(spread=3.0)


def test_priors_may_be_too_narrow() -> None:
    """Of declared priors every other vehicle is drawn three times as far; a fit is believed."""
    priors = Parameter("K", 0.2, "1/s", prior_std=0.01)
    ship = Model(
        "ship", (State("r", "rad/s"),), (Input("d", "rad"),), (Output("r", "rad/s"),),
        kinematics={"r": "K*d - 0.1*r"}, parameters=(priors,),
    )  # fmt: skip
    rng = np.random.default_rng(0)
    drawn = np.array([one.values["K"] for one in draw_models(ship, None, 4000, None, rng)])
    assert np.std(drawn[::2]) == pytest.approx(0.01, rel=0.05)
    assert np.std(drawn[1::2]) == pytest.approx(0.03, rel=0.05)
    known = Information.from_matrix(("K",), np.array([[1e4]]), np.array([0.2]))
    drawn = np.array([one.values["K"] for one in draw_models(ship, None, 4000, known, rng)])
    assert np.std(drawn) == pytest.approx(0.01, rel=0.05)


def test_what_nobody_knows_may_be_far_off() -> None:
    """Beside a prior, coefficients without one are drawn up to a share of their value off."""
    model = Model(
        "ship", (State("r", "rad/s"),), (Input("d", "rad"),), (Output("r", "rad/s"),),
        kinematics={"r": "K*d - c*r"},
        parameters=(Parameter("K", 0.2, "1/s", prior_std=0.01), Parameter("c", 0.1, "1/s")),
    )  # fmt: skip
    drawn = draw_models(model, None, 2000, None, np.random.default_rng(0))
    shares = np.array([one.values["c"] for one in drawn]) / 0.1 - 1.0
    assert np.abs(shares).max() == pytest.approx(UNCERTAINTY, rel=0.01)
    assert np.std(shares) == pytest.approx(UNCERTAINTY / np.sqrt(3.0), rel=0.05)
    assert np.std([one.values["K"] for one in drawn[::2]]) == pytest.approx(0.01, rel=0.1)


def test_the_stated_bound_is_that_of_the_binomial() -> None:
    """At the lower end so many or more would be kept in one case of twenty."""
    for kept, n in ((190, 200), (20, 20), (3, 200)):
        assert binom.sf(kept - 1, n, at_least(kept, n)) == pytest.approx(0.05, rel=1e-6)
    assert at_least(0, 50) == 0.0
