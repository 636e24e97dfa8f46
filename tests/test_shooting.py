"""The condensed problem against simulation, finite differences and its own definition."""

from __future__ import annotations

import numpy as np
import pytest
from altered import overwritten
from vehicles import DIVING_START, remus
from yaw_vehicle import NOISE, TRUE, simulate_yaw, yaw_data, yaw_model

from oed_sysid import Actuator, Dataset, Memory, Model, Parameter, Record, simulate_inputs
from oed_sysid.likelihood.gauss_newton import exact
from oed_sysid.likelihood.shooting import Shooting

LAG = Actuator(
    "fin_lag",
    {"ds": "ds + (a - ds)*E_lag/h*(1 - exp(-h/E_lag))"},
    (Parameter("E_lag", 0.3, "s", lower=0.01),),
    memory=(Memory("a", "ds + (a - ds)*exp(-h/E_lag)", "fin_command"),),
)


def diving_data(model: Model, n: int = 60) -> Dataset:
    """Noise-free record of a diving vehicle; z missing at every second sample."""
    times = np.arange(n) * 0.2
    fin = 0.1 * np.sign(np.sin(times))
    run = simulate_inputs(
        model, times, inputs={"fin_command": fin, "thrust": 9.0}, initial=DIVING_START
    )
    data = Dataset((Record("dive", times, run.inputs, run.outputs, model.channels),))
    return overwritten(data, 0, np.s_[::2, -1], np.nan)


@pytest.mark.parametrize("interval", [None, 5.0, np.inf])
def test_jacobian_is_that_of_the_simulation(interval: float | None) -> None:
    """Condensed sensitivities equal finite differences of whole trajectories, memory included."""
    model = remus() + LAG
    shooting = Shooting(model, diving_data(model), np.ones(5), interval=interval)
    unknowns = shooting.start_unknowns() + 0.01
    lin = shooting.linearise(shooting.continuous(unknowns))
    columns = shooting.layout.record_columns(0)
    for column, position in enumerate(columns):
        h = 1e-5 * max(1.0, abs(unknowns[position]))
        results = []
        for sign in (1, -1):
            moved = unknowns.copy()
            moved[position] += sign * h
            results.append(shooting.linearise(shooting.continuous(moved)).residuals[0])
        slope = -(results[0] - results[1]) / (2 * h)
        exact = lin.jacobians[0][:, :, column]
        seen = np.isfinite(slope)
        size = np.abs(exact).max() + 1e-6
        assert np.allclose(slope[seen], exact[seen], atol=2e-5 * size)


def test_residuals_are_those_of_a_hand_written_simulator() -> None:
    """On a continuous point, residuals are the measurements minus an independent simulation."""
    data = yaw_data(1)
    shooting = Shooting(yaw_model(), data, NOISE)
    unknowns = shooting.start_unknowns()
    lin = shooting.linearise(shooting.continuous(unknowns))
    for index, record in enumerate(data):
        start = shooting.initial_state(unknowns, index)
        expected = record.outputs - simulate_yaw(record.times, record.inputs[:, 0], start, TRUE)
        assert np.allclose(lin.residuals[index], expected, atol=1e-12)
    scaled = [residual / NOISE for residual in lin.residuals]
    assert shooting.cost(lin, unknowns) == pytest.approx(0.5 * sum(np.sum(s**2) for s in scaled))
    assert shooting.defect(lin) < 1e-10


def test_a_full_step_closes_the_defects_of_a_linear_model() -> None:
    """For a linear model one move makes the trajectory continuous, as predicted."""
    model = yaw_model(alpha=Parameter("alpha", 0.0, fixed=True)).fix("K", "T")
    shooting = Shooting(model, yaw_data(2), NOISE)
    point = shooting.start_point()
    lin = shooting.linearise(point)
    assert shooting.defect(lin) > 0.1
    step = np.linspace(0.01, 0.03, shooting.layout.n_unknowns)
    after = shooting.linearise(shooting.move(point, lin.follows, step, 1.0))
    assert shooting.defect(after) < 1e-9
    predicted = exact(shooting, point).predicted(step)
    assert shooting.cost(after, point.unknowns + step) == pytest.approx(predicted, rel=1e-9)


def test_normal_equations_are_those_of_the_stacked_jacobian() -> None:
    """Matrix and right side come from the dense whitened Jacobian, gaps weighing nothing."""
    data = overwritten(yaw_data(3), 0, np.s_[5:40, 1], np.nan)
    shooting = Shooting(yaw_model(), data, NOISE)
    lin = shooting.linearise(shooting.start_point())
    matrix, right = shooting.normal_equations(lin)
    rows, targets = [], []
    for index in range(3):
        dense = np.zeros((*lin.residuals[index].shape, shooting.layout.n_unknowns))
        dense[:, :, shooting.layout.record_columns(index)] = lin.jacobians[index]
        target = (lin.residuals[index] - lin.offsets[index]) / NOISE
        seen = np.isfinite(target)
        rows.append((dense / NOISE[:, None])[seen])
        targets.append(target[seen])
    stacked = np.vstack(rows)
    assert np.allclose(matrix, stacked.T @ stacked)
    assert np.allclose(right, stacked.T @ np.concatenate(targets))


def test_layout_gives_every_unknown_one_place() -> None:
    """Shared parameters are common to the records; states and local ones are not."""
    model = yaw_model(K=Parameter("K", 0.1, per_record=True))
    layout = Shooting(model, yaw_data(), NOISE).layout
    assert layout.n_unknowns == 2 + 3 * (2 + 1)
    assert layout.shared_names == ("T", "alpha")
    columns = [set(layout.record_columns(i)) for i in range(3)]
    assert columns[0] & columns[1] == columns[1] & columns[2] == {0, 1}
    assert set.union(*columns) == set(range(layout.n_unknowns))


def test_values_of_local_parameters_become_their_mean() -> None:
    """The fitted model holds the mean of per-record values, within the bounds."""
    model = yaw_model(K=Parameter("K", 0.1, per_record=True, lower=0.0, upper=0.3))
    shooting = Shooting(model, yaw_data(), NOISE)
    unknowns = shooting.start_unknowns()
    layout = shooting.layout
    own = layout.n_own + layout.free_names.index("K")
    positions = [layout.record_columns(i)[own] for i in range(3)]
    unknowns[positions] = [0.1, 0.2, 0.3]
    assert shooting.layout.means(model, unknowns)["K"] == pytest.approx(0.2)


def test_bounds_hold_and_moves_stay_within() -> None:
    """A move never leaves the bounds, and held unknowns do not move at all."""
    model = yaw_model(T=Parameter("T", 8.0, lower=7.0, upper=9.0))
    shooting = Shooting(model, yaw_data(), NOISE)
    point = shooting.start_point()
    lin = shooting.linearise(point)
    moved = shooting.move(point, lin.follows, np.full(shooting.layout.n_unknowns, 5.0), 1.0)
    assert moved.unknowns[1] == 9.0
    held = shooting.holding(np.array([1]), np.array([8.5]))
    assert held.start_point(np.clip(point.unknowns, held.limits.lower, held.limits.upper)).unknowns[
        1
    ] == pytest.approx(8.5)
    assert shooting.limits.upper[1] == 9.0


def test_intervals_follow_the_sample_times() -> None:
    """Intervals are about as long as asked for, also with irregular samples."""
    data = yaw_data(4, irregular=True)
    shooting = Shooting(yaw_model(), data, NOISE, interval=10.0)
    for record, starts in zip(data, shooting.starts, strict=True):
        lengths = np.diff(record.times[starts])
        assert starts[0] == 0
        assert 5.0 < np.median(lengths) < 15.0
    single = Shooting(yaw_model(), data, NOISE, interval=np.inf)
    assert [len(starts) for starts in single.starts] == [1, 1, 1]
