"""The published experiment on the unmanned sailboat."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest

from benchmarks.documents.published import paper
from benchmarks.documents.published.sailboat import errors, exact, gibbs, in_errors
from oed_sysid import load_problem, simulate_inputs
from oed_sysid.baselines import EquationError

PROBLEM = load_problem("sailboat")
SCRIPT = paper("sailboat")
DATA = SCRIPT.clean


def test_number_of_terms() -> None:
    """The hull has the published 8, 10, 10 and 10 terms, with units from their names."""
    free = PROBLEM.model.free_names
    assert [sum(n.startswith(f"{axis}_") for n in free) for axis in "XYNK"] == [8, 10, 10, 10]
    assert PROBLEM.model.parameter("Y_absvv").unit == "kg/m"
    assert "Y_absvr |v| r" in PROBLEM.model.equations()


def test_exact_accelerations_give_all_derivatives() -> None:
    """With exact rates the regression returns all 38 numbers."""
    assert max(errors(exact()).values()) < 1e-6


def test_gibbs_finds_what_carries_the_forces() -> None:
    """With 2 % noise dominant derivatives return within 2 %, and the chains have mixed."""
    fit = gibbs(0.02, 0, n_draws=1000)
    for name in SCRIPT.DOMINANT:
        assert fit.values[name] == pytest.approx(PROBLEM.truth[name], rel=0.02), name
    assert max(fit.posterior.r_hat.values()) < 1.01
    rates = SCRIPT.noisy_rates(0, 0.02)
    least = EquationError(rule="exact", rates=rates, coloured="never").fit(PROBLEM.model, DATA)
    assert SCRIPT.apart(fit, least) < 0.15


def test_coordinate_draws_have_not_converged_where_joint_draws_have() -> None:
    """The published draw, one coefficient at a time, mixes slowly on this problem."""
    fit = gibbs(0.1, 1, draw="coordinate", n_draws=1000)
    assert fit.status.code == "iterations"
    assert min(fit.posterior.effective_draws.values()) < 200


def test_steady_sailing() -> None:
    """On a beam reach at 5 m/s the boat makes 1.6 m/s, heels to leeward and drifts little."""
    found = SCRIPT.steady(PROBLEM.model, 90.0, 40.0)
    assert found["u"] == pytest.approx(1.64, abs=0.01)
    assert -radians(8) < found["phi"] < -radians(3)
    leeway = -found["v"] / found["u"]
    assert np.sign(found["phi"]) * -leeway * -1 > 0 or abs(leeway) < radians(3)


def test_tacks_are_mirror_images() -> None:
    """With the wind from the other side everything but the speed changes sign."""
    starboard = SCRIPT.steady(PROBLEM.model, 60.0, 40.0)
    port = SCRIPT.steady(PROBLEM.model, -60.0, 40.0)
    for name, value in starboard.items():
        mirrored = value if name == "u" else -value
        assert port[name] == pytest.approx(mirrored, abs=1e-6), name


def test_no_wind_stops_the_boat() -> None:
    """Without wind the boat slows down, stands upright and loses energy all the time."""
    run = simulate_inputs(
        PROBLEM.model,
        np.arange(0, 120, 0.2),
        inputs={"delta": 0.0, "sheet": 0.5, "wind_speed": 0.0, "wind_from": 0.0},
        initial={"u": 1.0, "phi": 0.3},
    )
    assert run.signal("u")[-1] < 0.35
    assert abs(run.signal("phi")[-1]) < 1e-3
    values = PROBLEM.model.values
    energy = (
        0.5 * (values["m"] + values["m_x"]) * run.signal("u") ** 2
        + 0.5 * (values["m"] + values["m_y"]) * run.signal("v") ** 2
        + 0.5 * values["I_xx_total"] * run.signal("p") ** 2
        + 0.5 * values["I_zz_total"] * run.signal("r") ** 2
        + values["m"] * 9.81 * values["GM"] * (1 - np.cos(run.signal("phi")))
    )
    assert np.all(np.diff(energy) < 1e-3 * energy[0])


def test_trajectories_do_not_hang_on_the_step() -> None:
    """A finer integration step moves no signal by its noise, gybes included."""
    noise = np.array([output.noise_std for output in PROBLEM.model.outputs])
    for record, experiment in zip(DATA, PROBLEM.experiments.values(), strict=True):
        finer = simulate_inputs(
            replace(PROBLEM.model, step=0.01),
            record.times,
            inputs=record.inputs,
            initial=experiment.initial,
        )
        away = np.sqrt(np.mean(((finer.outputs - record.outputs) / noise) ** 2, axis=0))
        assert np.all(away < 0.5), record.name


def test_sail_changes_sides_without_a_jump() -> None:
    """A tenth of a degree on either side of dead astern the forces of the sail are almost equal."""
    loads = []
    for angle in (179.9, 180.1):
        run = simulate_inputs(
            PROBLEM.model,
            np.array([0.0, 0.01]),
            inputs={"delta": 0.0, "sheet": 0.9, "wind_speed": 6.0, "wind_from": radians(angle)},
            initial={"u": 0.8},
        )
        loads.append(run.signal("p")[-1])
    jumping = 1.225 / 2 * 0.512 * 5.2**2 * 0.85 / 0.709 * 0.01  # roll rate that half a jump makes
    assert abs(loads[0] - loads[1]) < 0.05 * jumping


@pytest.mark.parametrize("seed", range(3))
def test_multiple_shooting_from_far_starts(seed: int) -> None:
    """From start values up to 30 % off, 38 derivatives return within four standard errors."""
    fit = SCRIPT.from_afar(seed)
    # A gybe hangs on the integration step, and the status says so; the simulator shares the step.
    assert fit.status.code in ("converged", "integration")
    assert in_errors(fit) < 4.0
