"""Trials at sea, simulated: what is drawn has the level, the time and the place asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_design import ship

from oed_sysid import Experiment, Limits, NoiseModel, load_problem
from oed_sysid.design import assess_limits
from oed_sysid.experiments.manoeuvres import Doublet
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.realisation import simulate_at_sea

TEST = Experiment("doublet", Doublet("rudder", 0.2, pulse_time=8.0), duration=40.0, sample_time=0.5)


def noise(force: float, colour: float = 0.0) -> NoiseModel:
    """Random yaw acceleration of three seconds."""
    return NoiseModel(
        np.array([5e-3, 2e-3]), np.array([0.0, colour]), np.array([force]), colour_time=2.0,
        force_time=3.0, outputs=("psi", "r"), places=("force r",),
    )  # fmt: skip


def test_without_forces_it_is_the_plain_simulation() -> None:
    """At level zero the record is that of the simulator with the same noise."""
    found = simulate_at_sea(ship(), TEST, noise(0.0), rng=np.random.default_rng(1))
    plain = simulate(ship(), TEST, rng=np.random.default_rng(1))
    np.testing.assert_allclose(found.outputs, plain.outputs, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.inputs, plain.inputs, atol=1e-12)


def test_yaw_rate_scatters_as_a_first_order_process_through_the_hull() -> None:
    """With linear damping the variance of the yaw rate is that of theory, within sampling error."""
    model = ship().with_values({"c": 0.0})
    quiet = replace(noise(0.01), white=np.array([1e-9, 1e-9]))
    still = Experiment("still", duration=60.0, sample_time=0.25, constants={"rudder": 0.0})
    rng = np.random.default_rng(2)
    ends = [simulate_at_sea(model, still, quiet, rng=rng).output("r")[120:] for _ in range(40)]
    damping, rate = 0.4, 1 / 3.0
    expected = 0.01**2 / (damping * (damping + rate))
    assert np.mean(np.square(ends)) == pytest.approx(expected, rel=0.15)


def test_a_force_in_an_axis_meets_a_zigzag_that_reacts() -> None:
    """Under a pitch moment the closed loop switches elsewhere; commands stay in their range."""
    problem = load_problem("remus_diving_plane")
    run = replace(problem.experiment("zigzag_5_5"), duration=40.0)
    white = np.array([o.noise_std for o in problem.model.outputs])
    sea = NoiseModel(
        white, np.zeros(5), np.array([0.3]), force_time=2.0,
        outputs=problem.model.output_names, places=("force M",),
    )  # fmt: skip
    records = [
        simulate_at_sea(problem.model, run, one, rng=np.random.default_rng(0))
        for one in (sea, replace(sea, force=np.array([1e-9])))
    ]
    assert np.abs(records[0].inputs - records[1].inputs).max() > 0.1
    assert np.abs(records[0].input("fin_command")).max() == pytest.approx(np.radians(5))


def test_a_drifting_sensor_and_a_noisy_command_are_drawn_too() -> None:
    """A drift is added to its reading alone; a noise of the fin moves the vehicle."""
    problem = load_problem("remus_diving_plane")
    run = replace(problem.experiment("zigzag_5_5"), manoeuvre=(), duration=40.0,
                  constants={"fin_command": 0.05, "thrust": 9.0})  # fmt: skip
    names = problem.model.output_names
    quiet = NoiseModel(
        np.full(5, 1e-12), np.zeros(5), np.array([0.2]), force_time=np.array([5.0]),
        outputs=names, places=("sensor q",),
    )  # fmt: skip
    still = simulate(problem.model, run, noise=False)
    drawn = [
        simulate_at_sea(problem.model, run, sea, rng=np.random.default_rng(0))
        for sea in (quiet, replace(quiet, places=("actuator ds",), force_time=np.zeros(1)))
    ]
    drift, wiggle = (record.outputs - still.outputs for record in drawn)
    here = names.index("q")
    assert np.abs(np.delete(drift, here, axis=1)).max() < 1e-9
    assert np.std(drift[:, here]) == pytest.approx(0.2, rel=0.5)
    step, series = run.sample_time, drift[:, here]
    assert np.corrcoef(series[1:], series[:-1])[0, 1] == pytest.approx(np.exp(-step / 5), abs=0.05)
    assert np.std(wiggle[50:, here]) > 1e-3


def test_waves_count_in_how_surely_limits_hold() -> None:
    """A run with a narrow margin keeps its limits in still water and leaves them in waves."""
    steady = Experiment("doublet", Doublet("rudder", 0.1, pulse_time=8.0), duration=40.0,
                        sample_time=0.5)  # fmt: skip
    largest = float(np.abs(simulate(ship(), steady, noise=False).output("psi")).max())
    limits = Limits(signals={"psi": (-1.1 * largest, 1.1 * largest)})
    found = [
        assess_limits(
            ship(),
            steady,
            limits=limits,
            spread=0.01,
            vehicles=40,
            sea=sea,
            rng=np.random.default_rng(0),
        )
        for sea in (None, noise(0.02))
    ]
    assert found[0].probability == 1.0
    assert found[1].probability < 0.8
    assert sum(found[1].left.values()) == 40 - found[1].n_kept
    assert "in waves (r 0.02 over 3 s)" in found[1].report()
