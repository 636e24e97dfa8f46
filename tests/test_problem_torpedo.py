"""The published experiment on the torpedo-like body."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.documents.published import paper
from oed_sysid import load_problem, simulate, simulate_inputs
from oed_sysid.baselines import DifferentialSwarm

PROBLEM = load_problem("torpedo")
EXPERIMENT = PROBLEM.experiment("pitching")
SCRIPT = paper("torpedo")
START = SCRIPT.START


def test_noise_levels_are_shares_of_the_peaks() -> None:
    """Declared noise is one per cent of each channel's peak excursion in the experiment."""
    outputs = simulate(PROBLEM.model, EXPERIMENT, noise=False).outputs
    peaks = np.abs(outputs).max(axis=0)
    peaks[4:] = np.abs(outputs[:, 4:] - outputs[0, 4:]).max(axis=0)
    declared = np.array([output.noise_std for output in PROBLEM.model.outputs])
    assert declared == pytest.approx(0.01 * peaks, rel=5e-3)
    attack = np.degrees(np.abs(np.arctan2(outputs[:, 1], outputs[:, 0])).max())
    assert attack < 16.0


def test_forces_against_a_hand_calculation() -> None:
    """First accelerations equal those of the source's equations in its own axes."""
    values = PROBLEM.model.values
    u, w, q, theta, delta = 4.0, -0.5, 0.1, 0.2, 0.05
    vx, vy = u, -w
    speed = np.hypot(vx, vy)
    alpha = -np.arctan2(vy, vx)
    pressure = 0.5 * 1025.0 * speed**2 * values["S"]
    turn = q * 6.0 / speed
    cy = 0.04 + 2.40 * alpha + 0.52 * delta + 1.00 * turn
    mz = 0.012 + 0.55 * alpha - 0.235 * delta - 0.62 * turn
    axial = pressure * (-0.145 * np.cos(alpha) + cy * np.sin(alpha))
    normal = pressure * (0.145 * np.sin(alpha) + cy * np.cos(alpha))
    weight, buoyancy = values["G"], values["B"]
    matrix = np.array([[1275.0, 0, 0], [0, 2480.0, -700.0], [0, -700.0, 6200.0]])
    right = [
        values["T"] - (weight - buoyancy) * np.sin(theta) + axial + 1250.0 * vy * q,
        normal - (weight - buoyancy) * np.cos(theta) - 1250.0 * vx * q,
        pressure * 6.0 * mz + buoyancy * 0.31 * np.cos(theta),
    ]
    expected = np.linalg.solve(matrix, right)
    h = 1e-5
    run = simulate_inputs(
        PROBLEM.model,
        [0.0, h],
        inputs={"delta": delta},
        initial={"u": u, "w": w, "q": q, "theta": theta},
    )
    rates = (run.states[1] - run.states[0]) / h
    found = [rates[0], -rates[1], rates[2]]
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-4)


def test_small_swarm_goes_the_right_way() -> None:
    """A short search lowers the misfit by orders of magnitude and lands near strong parameters."""
    fit = DifferentialSwarm(n_particles=40, n_generations=150, initial=START).fit(
        PROBLEM.model, SCRIPT.data(0.0, 0)
    )
    history = fit.extras["history"]
    assert history[-1] < 1e-2 * history[0]
    found = SCRIPT.errors(fit)
    assert found["m_z_omega"] < 5.0
    assert found["C_x"] < 10.0
