"""Iterates: gathered sums and sample-by-sample sensitivities tell the same story."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from vehicles import DIVING_START, remus
from yaw_vehicle import NOISE, yaw_data, yaw_model

from oed_sysid import MultipleShooting
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.gauss_newton import exact, gathered, solve
from oed_sysid.likelihood.shooting import Shooting, loss_by_name
from oed_sysid.physics.parameters import Parameter

SIGMA = np.array([0.02, 0.02, 0.004, 0.004, 0.03])


def diving(n: int = 300) -> Shooting:
    """Two dives with gaps, of a vehicle whose values are 10 % off and have no priors."""
    model, times, rng = remus(), 0.1 * np.arange(n), np.random.default_rng(0)
    records = []
    for index, period in enumerate((9.0, 14.0)):
        fin = 0.1 * np.sign(np.sin(2 * np.pi * times / period))
        run = simulate_inputs(
            model, times, inputs={"fin_command": fin, "thrust": 9.0}, initial=DIVING_START
        )
        outputs = run.outputs + SIGMA * rng.standard_normal(run.outputs.shape)
        outputs[20:60, 4] = np.nan
        records.append(Record(f"dive_{index}", times, run.inputs, outputs, model.channels))
    for p in model.free_parameters:
        start = replace(p, value=0.9 * p.value, prior_mean=None, prior_std=None)
        model = model.with_parameter(start)
    return Shooting(model, Dataset(tuple(records)), SIGMA)


def yaw_with_own_gain() -> Shooting:
    """A model with a parameter of its own in every record, and a prior."""
    model = yaw_model(
        K=Parameter("K", 0.08, per_record=True),
        alpha=Parameter("alpha", 10.0, prior_mean=12.0, prior_std=1.0),
    )
    return Shooting(model, yaw_data(3), NOISE)


@pytest.mark.parametrize("problem", [diving, yaw_with_own_gain])
def test_gathered_sums_are_those_of_the_jacobian(problem) -> None:
    """Cost, defect, normal equations, prediction and node maps agree to rounding."""
    shooting = problem()
    point = shooting.start_point()
    whole, quick = exact(shooting, point), gathered(shooting, point)
    assert quick.cost == pytest.approx(whole.cost, rel=1e-12)
    assert quick.defect == pytest.approx(whole.defect, rel=1e-12)
    assert whole.defect > 1e-3
    one, other = quick.equations, whole.equations
    size = np.sqrt(np.diag(other.matrix))
    assert np.allclose(one.matrix / np.outer(size, size), other.matrix / np.outer(size, size),
                       rtol=1e-9, atol=1e-9)  # fmt: skip
    assert np.allclose(one.right / size, other.right / size, rtol=1e-9, atol=1e-9)
    step = np.linspace(-1.0, 1.0, shooting.layout.n_unknowns) / size
    assert quick.predicted(step) == pytest.approx(whole.predicted(step), rel=1e-10)
    for own, its in zip(one.follows, other.follows, strict=True):
        assert np.allclose(own[0], its[0], rtol=1e-12)
        assert np.allclose(own[1], its[1], rtol=1e-12)


@pytest.mark.parametrize("problem", [diving, yaw_with_own_gain])
def test_both_ways_end_at_the_same_optimum(problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """Estimates and standard errors do not depend on how iterates are evaluated."""
    shooting = problem()
    estimator = MultipleShooting(noise=shooting.sigma)
    quick = estimator.fit(shooting.model, shooting.dataset)
    monkeypatch.setattr("oed_sysid.likelihood.gauss_newton.gathered", exact)
    slow = estimator.fit(shooting.model, shooting.dataset)
    assert quick.status.ok
    assert np.allclose(quick.estimates, slow.estimates, rtol=1e-8)
    assert np.allclose(quick.covariance, slow.covariance, rtol=1e-6)
    assert quick.cost == pytest.approx(slow.cost, rel=1e-12)


def test_robust_losses_are_weighed_sample_by_sample() -> None:
    """With a robust loss the solution is stationary for the weighted residuals."""
    data = yaw_data(1)
    outputs = data[0].outputs.copy()
    outputs[10:14, 0] += 40 * NOISE[0]
    shooting = Shooting(yaw_model(), Dataset((data[0].with_outputs(outputs),)), NOISE)
    robust = shooting.with_loss(loss_by_name("huber"))
    plain, solution = (solve(s, s.start_point()) for s in (shooting, robust))
    matrix, right = robust.normal_equations(solution.linearisation)
    assert right @ np.linalg.solve(matrix, right) < 1e-5
    assert np.abs(solution.point.unknowns[:3] - plain.point.unknowns[:3]).max() > 1e-3


def test_explosion_is_said_by_both() -> None:
    """Where the model diverges neither gives an iterate."""
    shooting = Shooting(yaw_model().with_values({"alpha": -1e12}), yaw_data(1), NOISE)
    point = shooting.start_point()
    assert exact(shooting, point) is None
    assert gathered(shooting, point) is None
