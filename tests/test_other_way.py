"""An input of the other sign or unit is named by the start values, which kinematics cannot do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oed_sysid import (
    Dataset,
    Input,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    Record,
    State,
    improve,
    load_problem,
)
from oed_sysid.likelihood.departures import other_way
from oed_sysid.physics import quadratic_drag

TRUE = {"K": 0.05, "n": 1.0, "n3": 400.0, "b": 0.02, "d0": 0.01, "U": 5.0}
# Drift and yaw of a ship by its rudder, which appears in both; the zero of its rudder is unknown.
SHIP = Model(
    "drifting",
    (State("psi", "rad"), State("r", "rad/s", scale=0.02), State("v", "m/s", scale=0.2)),
    (Input("rudder", "rad"),),
    (
        Output("psi", "rad", noise_std=0.003),
        Output("r", "rad/s", noise_std=3e-4),
        Output("v", "m/s", noise_std=0.01),
    ),
    {
        "psi": "r",
        "r": "(K*(rudder + d0) - n*r - n3*r**3)/20",
        "v": "b*(rudder + d0) - v/8 - 0.5*r",
    },
    parameters=(
        Parameter("K", 0.03, "1/s"),
        Parameter("n", 0.8, "1"),
        Parameter("n3", 300.0, "s^2", scale=100.0),
        Parameter("b", 0.015, "m/s^2", scale=0.01),
        Parameter("d0", 0.0, "rad", scale=0.01),
    ),
    step=0.5,
)


def runs(*, factor: float = 1.0, seed: int = 0) -> Dataset:
    """Two records by SciPy; the log holds the true rudder over ``factor``."""
    rng = np.random.default_rng(seed)
    found = []
    for name in ("one", "two"):
        times = np.arange(0.0, 300.0, 1.0)
        rudder = np.repeat(rng.choice([-0.2, 0.0, 0.2], 30), 10)

        def rates(t: float, x: np.ndarray, rudder: np.ndarray = rudder) -> list[float]:
            _, r, v = x
            d = rudder[min(int(t), len(rudder) - 1)] + TRUE["d0"]
            turning = (TRUE["K"] * d - TRUE["n"] * r - TRUE["n3"] * r**3) / 20
            return [r, turning, TRUE["b"] * d - v / 8 - 0.5 * r]

        run = solve_ivp(rates, (0, 299), [0, 0, 0], t_eval=times, max_step=0.5, rtol=1e-7).y.T
        seen = run + rng.standard_normal(run.shape) * [0.003, 3e-4, 0.01]
        found.append(Record(name, times, rudder[:, None] / factor, seen, SHIP.channels))
    return Dataset(tuple(found))


@pytest.mark.parametrize("factor", [1.0, -1.0, 180 / np.pi, np.pi / 180])
def test_sign_and_unit_are_named_and_nothing_where_they_are_right(factor: float) -> None:
    """Both coefficients are of the other sign, or 57 times as large; the residuals are noise."""
    fit = MultipleShooting().fit(SHIP, runs(factor=factor))
    assert fit.status.ok
    assert 2.0 * fit.cost < 1.1 * fit.n_observations
    assert fit.values["K"] == pytest.approx(factor * TRUE["K"], rel=0.05)
    said = [concern for concern in fit.concerns if concern.kind == "other_way"]
    if factor == 1.0:
        assert not said
    else:
        assert [one.signal for one in said] == ["rudder"]
        assert said[0].size == pytest.approx(factor)


def test_one_start_value_of_the_wrong_sign_says_nothing() -> None:
    """Of two coefficients of the rudder one was expected with the other sign: a bad guess."""
    wrong = SHIP.with_values({"b": -0.015})
    fit = MultipleShooting().fit(wrong, runs())
    assert fit.values["b"] == pytest.approx(TRUE["b"], rel=0.1)
    assert not [concern for concern in fit.concerns if concern.kind == "other_way"]


def test_search_says_so_as_well() -> None:
    """`improve` finds nothing missing in a log with a reversed rudder, and says what it holds."""
    data = runs(factor=-1.0)
    train, test = Dataset((data[0],)), Dataset((data[1],))
    absent = replace(quadratic_drag("drag", "N", "r"), terms={"r": "-E_drag*r*abs(r)"})
    found = improve(SHIP, train, test, candidates=[absent])
    assert not found.steps
    nominal = {p.name: p.value for p in SHIP.free_parameters}
    (said,) = other_way(found.fit, nominal)
    assert said.factor == -1.0
    assert set(said.values) == {"K", "b"}
    assert found.remains.kind == "log suspect"
    assert found.log is not None
    assert [f.says for f in found.log.findings if f.kind == "other_way"] == [said.text]


@pytest.mark.parametrize("name", ["remus_diving_plane", "catamaran"])
def test_published_problems_act_as_they_say(name: str) -> None:
    """No input of a shipped problem is reversed in its own records."""
    problem = load_problem(name)
    fit = MultipleShooting(disturbances="none").fit(problem.model, problem.data())
    assert fit.status.code in ("converged", "stalled", "iterations")
    assert not other_way(fit, problem.model.values)
