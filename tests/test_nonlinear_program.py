"""IPOPT on the uncondensed problem: the same optimum, and constraints among parameters."""

from __future__ import annotations

import numpy as np
import pytest
from test_shooting import LAG, diving_data
from vehicles import remus
from yaw_vehicle import NOISE, yaw_data, yaw_model

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.estimator import Solver
from oed_sysid.likelihood.gauss_newton import Progress
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.physics.parameters import Parameter

CONDENSED = MultipleShooting(noise=NOISE, coloured="never", disturbances="none")


def difference(fit, other) -> float:  # type: ignore[no-untyped-def]
    """Largest difference of two fits in standard errors."""
    return float(np.max(np.abs(fit.estimates - other.estimates) / np.sqrt(np.diag(fit.covariance))))


@pytest.mark.parametrize("hessian", ["exact", "gauss-newton"])
@pytest.mark.parametrize("irregular", [False, True])
def test_same_optimum_as_gauss_newton(hessian: str, irregular: bool) -> None:
    """Several records, remainders, gaps and irregular sampling: same estimates and errors."""
    data = yaw_data(1, irregular=irregular)
    outputs = data[0].outputs.copy()
    outputs[30:50] = np.nan
    data = Dataset((data[0].with_outputs(outputs), *data.records[1:]))
    model = yaw_model(
        K=Parameter("K", 0.08, per_record=True),
        alpha=Parameter("alpha", 5.0, prior_mean=12.0, prior_std=2.0),
    )
    condensed = CONDENSED.fit(model, data)
    program = MultipleShooting(
        noise=NOISE, coloured="never", solver=Solver("ipopt", hessian=hessian)
    ).fit(model, data)
    assert program.status.ok
    assert difference(condensed, program) < 2e-3
    assert np.allclose(condensed.covariance, program.covariance, rtol=1e-3)
    assert program.cost == pytest.approx(condensed.cost, abs=1e-5)
    assert [v["K"] for v in program.local_values] == pytest.approx(
        [v["K"] for v in condensed.local_values], rel=1e-4
    )


def test_memory_and_substeps() -> None:
    """A model with actuator memory and several integration steps per sample."""
    model = remus() + LAG
    data = diving_data(model, 60)
    noise = [0.02, 0.02, 0.004, 0.004, 0.03]
    rough = model.with_values({"Z_uw": -35.0, "E_lag": 0.4, "M_uq": -8.0})
    fit = MultipleShooting(noise=noise, solver=Solver("ipopt")).fit(rough, data)
    assert fit.status.ok
    for name in model.free_names:
        assert fit.values[name] == pytest.approx(model.values[name], rel=1e-4)


@pytest.mark.parametrize("loss", ["huber", "student"])
def test_robust_losses(loss: str) -> None:
    """Robust losses have the same optimum in both solvers."""
    data = yaw_data(2)
    outputs = data[0].outputs.copy()
    outputs[::17] += 0.1
    data = Dataset((data[0].with_outputs(outputs), *data.records[1:]))
    condensed = MultipleShooting(noise=NOISE, loss=loss, solver=Solver(tolerance=1e-9)).fit(
        yaw_model(), data
    )
    program = MultipleShooting(noise=NOISE, loss=loss, solver=Solver("ipopt", hessian="exact")).fit(
        yaw_model(), data
    )
    assert difference(condensed, program) < 0.02
    assert program.cost == pytest.approx(condensed.cost, rel=1e-5)


def test_bounds() -> None:
    """An active bound is held exactly."""
    model = yaw_model(T=Parameter("T", 6.0, lower=0.5, upper=7.5))
    condensed = CONDENSED.fit(model, yaw_data(3))
    program = MultipleShooting(noise=NOISE, solver=Solver("ipopt")).fit(model, yaw_data(3))
    assert program.values["T"] == pytest.approx(7.5, abs=1e-6)
    assert program.cost == pytest.approx(condensed.cost, abs=1e-4)


def test_constraints_among_parameters() -> None:
    """An equation among parameters is the same as eliminating one of them."""
    data = yaw_data(4)
    constrained = MultipleShooting(
        noise=NOISE, solver=Solver("ipopt", constraints=("alpha == 1.2*T", "K/T > 0.001"))
    ).fit(yaw_model(), data)
    assert constrained.status.ok
    assert constrained.values["alpha"] == pytest.approx(1.2 * constrained.values["T"], rel=1e-6)
    tied = yaw_model()
    tied = type(tied)(
        **{
            **{f: getattr(tied, f) for f in ("name", "states", "inputs", "outputs", "step")},
            "kinematics": {"psi": "r", "r": "(K*delta - r - 1.2*T*r**3)/T"},
            "parameters": (tied.parameter("K"), tied.parameter("T")),
        }
    )
    eliminated = CONDENSED.fit(tied, data)
    assert constrained.cost == pytest.approx(eliminated.cost, abs=1e-3)
    assert constrained.values["T"] == pytest.approx(eliminated.values["T"], rel=1e-3)


def test_contradictions_are_said() -> None:
    """Constraints that exclude each other end with a status, not an exception."""
    fit = MultipleShooting(
        noise=NOISE, solver=Solver("ipopt", constraints=("K > 0.3", "K < 0.01"))
    ).fit(yaw_model(), yaw_data(4))
    assert fit.status.code == "infeasible"
    assert "Loosen" in fit.status.advice


def test_noise_levels_and_progress(capfd: pytest.CaptureFixture[str]) -> None:
    """Noise is estimated as by the other solver; progress is reported; nothing is printed."""
    seen: list[Progress] = []
    data = yaw_data(5)
    fit = MultipleShooting(noise="estimate", solver=Solver("ipopt"), progress=seen.append).fit(
        yaw_model(), data
    )
    other = MultipleShooting(noise="estimate", disturbances="none").fit(yaw_model(), data)
    assert np.allclose(fit.sigma, other.sigma, rtol=2e-3)
    assert len(seen) > 3
    assert seen[-1].defect < 1e-4
    assert capfd.readouterr().out == ""


def test_limit_of_iterations() -> None:
    """Too few iterations are reported as such."""
    fit = MultipleShooting(noise=NOISE, solver=Solver("ipopt", max_iterations=1), start="near").fit(
        yaw_model().with_values({"K": 0.05}), yaw_data(6)
    )
    assert fit.status.code == "iterations"


def test_a_path_is_kept_at_every_sample() -> None:
    """A limit below the largest yaw rate is held everywhere, and named with where it binds."""
    data = yaw_data(4)
    free = MultipleShooting(noise=NOISE, solver=Solver("ipopt")).fit(yaw_model(), data)
    most = max(float(one[:, 1].max()) for one in free.predictions)
    limit = 0.98 * most
    kept = MultipleShooting(
        noise=NOISE, solver=Solver("ipopt", constraints=(f"r <= {limit!r}",))
    ).fit(yaw_model(), data)
    assert kept.status.ok
    assert max(float(one[:, 1].max()) for one in kept.predictions) == pytest.approx(limit, rel=1e-5)
    assert kept.cost > free.cost
    assert kept.binding
    assert all(one.text.startswith("r <= ") and " s of " in one.text for one in kept.binding)
    # To first order the optimum without the limit lies beyond it by what was cut off.
    assert kept.binding[0].beyond == pytest.approx(most - limit, rel=0.3)


def test_ends_are_kept() -> None:
    """A start state that is tied has that value; an end keeps its side."""
    data, tied = yaw_data(4), "start(r) == 0.001"
    first = MultipleShooting(noise=NOISE, solver=Solver("ipopt", constraints=(tied,)))
    fit = first.fit(yaw_model(), data)
    assert fit.status.ok
    assert [float(one[0, 1]) for one in fit.predictions] == pytest.approx(
        [0.001] * len(data.records), abs=1e-7
    )
    end = min(float(one[-1, 0]) for one in fit.predictions) + 0.002
    both = MultipleShooting(
        noise=NOISE, solver=Solver("ipopt", constraints=(tied, f"end(psi) >= {end!r}"))
    ).fit(yaw_model(), data)
    assert min(float(one[-1, 0]) for one in both.predictions) == pytest.approx(end, abs=1e-6)
    assert any(one.text.startswith("end(psi) >= ") for one in both.binding)


@pytest.mark.parametrize(
    ("constraint", "words"),
    [
        ("start(r) < end(r)", "mixes start and end"),
        ("start(K) < 1", "those of an output"),
        ("K + T", "one comparison"),
        ("K < gain", "unknown name"),
        ("1 < 2", "no parameter"),
    ],
)
def test_unreadable_constraints_are_refused(constraint: str, words: str) -> None:
    """A constraint compares expressions of known parameters."""
    with pytest.raises(ModelError, match=words):
        MultipleShooting(noise=NOISE, solver=Solver("ipopt", constraints=(constraint,))).fit(
            yaw_model(), yaw_data(0)
        )
