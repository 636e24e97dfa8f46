"""Candidates that nobody named, by SciPy: a hull that hardens, a current without sway."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oed_sysid import (
    Dataset,
    Force,
    Input,
    Model,
    Output,
    Parameter,
    Record,
    State,
    improve,
    usual_effects,
)
from oed_sysid.physics.bodies import rigid_body

ROLLING = Model(
    "rolling",
    (State("phi", "rad", scale=0.2), State("p", "rad/s", scale=0.2)),
    (Input("K_tank", "N m"),),
    (Output("phi", "rad", noise_std=0.003), Output("p", "rad/s", noise_std=0.003)),
    {"phi": "p"},
    axes={"K": "p"},
    inertia={("K", "p"): "I_xx"},
    effects=(
        Force(
            "roll",
            {"K": "K_tank - G*sin(phi) + K_p*p"},
            (Parameter("G", 900.0, "N m"), Parameter("K_p", -70.0, "N m s")),
        ),
    ),
    parameters=(Parameter("I_xx", 500.0, "kg m^2", fixed=True),),
    step=0.1,
)  # fmt: skip
HARD = -1500.0  # N m
BODY = rigid_body(
    ("surge", "yaw"), mass=120.0, inertia=12.0, added_mass={"X_udot": 0.0, "N_rdot": -8.0}
)
TURNING = BODY.model(
    "two thrusters",
    inputs=(Input("T_port", "N"), Input("T_starboard", "N")),
    effects=(
        BODY.hull({"X_absuu": -80.0, "N_r": -7.0}),
        BODY.thruster("port", "T_port", at=(0, -0.3, 0)),
        BODY.thruster("starboard", "T_starboard", at=(0, 0.3, 0)),
    ),
    noise={"u": 0.01, "r": 0.005, "psi": 0.01},
    step=0.2,
)
NORTH, EAST = 0.2, -0.1  # m/s


def run(model, rates, start, commands, seed: int) -> Record:  # type: ignore[no-untyped-def]
    """One record of 60 s by SciPy, commands held for 3 s, with white noise as declared."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, 60.0, 0.2)
    held = np.repeat(commands(rng), 15, axis=0)

    def rate(t: float, x: np.ndarray) -> list[float]:
        return rates(x, held[min(int(t / 0.2 + 1e-9), len(held) - 1)])

    seen = solve_ivp(rate, (0, times[-1]), start, t_eval=times, max_step=0.2, rtol=1e-7).y.T
    noise = np.array([output.noise_std for output in model.outputs])
    seen = seen + noise * rng.standard_normal(seen.shape)
    return Record(f"run {seed}", times, held, seen, model.channels)


def rolls(x: np.ndarray, command: np.ndarray) -> list[float]:
    """A ship that hardens as it heels."""
    phi, p = x
    return [p, (command[0] - 1000.0 * np.sin(phi) + HARD * phi**3 - 80.0 * p) / 500.0]


def turns(x: np.ndarray, command: np.ndarray) -> list[float]:
    """A craft whose hull sees the current along its heading."""
    u, r, psi = x
    flow = u - NORTH * np.cos(psi) - EAST * np.sin(psi)
    surge = command.sum() - 90.0 * abs(flow) * flow
    return [surge / 120.0, (0.3 * (command[0] - command[1]) - 8.0 * r) / 20.0, r]


@pytest.mark.parametrize("kind", ["hardening_K_phi", "current"])
def test_found_without_a_name(kind: str) -> None:
    """The effect that was hidden is the only one claimed, at its size."""
    hard = kind == "hardening_K_phi"
    model, rates = (ROLLING, rolls) if hard else (TURNING, turns)

    def commands(rng: np.random.Generator) -> np.ndarray:
        if hard:
            return rng.choice([-400.0, 0.0, 400.0], (20, 1))
        return 25.0 + 15.0 * rng.choice([-1, 0, 1], (20, 2))

    start = [0.3, 0.0] if hard else [0.5, 0.0, 0.3]
    train, test = (
        Dataset(tuple(run(model, rates, start, commands, seed) for seed in seeds))
        for seeds in ((1, 3), (4,))
    )
    assert kind in {effect.name for effect in usual_effects(model, train)}
    found = improve(model, train, test)
    assert [step.added for step in found.steps] == [kind]
    assert found.remains.kind == "adequate"
    truth = {"K_phiphiphi": HARD} if hard else {"E_current_north": NORTH, "E_current_east": EAST}
    for name, value in truth.items():
        assert found.fit.values[name] == pytest.approx(value, rel=0.15)
