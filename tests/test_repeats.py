"""Forces taken for random: those that follow the motion are told from those that do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oed_sysid import Dataset, Input, Model, Output, Parameter, Record, State, improve
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.evidence.residual_forces import _standard_error
from oed_sysid.likelihood.information import lagged_products
from oed_sysid.physics import Force, quadratic_drag

BODY = Model(
    "moored body",
    (State("w", "m/s", scale=0.2), State("z", "m", scale=0.5)),
    (Input("push", "N"),),
    (Output("w", "m/s", noise_std=0.005), Output("z", "m", noise_std=0.005)),
    axes={"Z": "w"},
    inertia={("Z", "w"): "m"},
    kinematics={"z": "w"},
    effects=(),
    parameters=(Parameter("m", 20.0, "kg", fixed=True),),
    step=0.1,
)


def truth(k: int, *, cubic: float = 0.0, stop: float = 0.0, sea: float = 0.0) -> Record:
    """One run, by SciPy: a spring that hardens, a soft stop, a random force; N/m^3, N/m, N."""
    rng = np.random.default_rng([5, k])
    times = np.arange(0.0, 120.0, 0.2)
    push = np.repeat(rng.uniform(-12.0, 12.0, 20), 30)
    force, state = np.zeros(len(times)), np.zeros((len(times), 2))
    keep = np.exp(-0.2 / 2.0)
    for i in range(1, len(times)):
        force[i] = keep * force[i - 1] + sea * np.sqrt(1 - keep**2) * rng.standard_normal()

        def rate(t: float, x: np.ndarray, i: int = i) -> list[float]:
            w, z = x
            spring = 15 * z + cubic * z**3 + stop * max(z - 0.2, 0.0)
            return [(push[i - 1] + force[i - 1] - 8 * w - spring) / 20.0, w]

        state[i] = solve_ivp(rate, (0.0, 0.2), state[i - 1], rtol=1e-8).y[:, -1]
    seen = state + 0.005 * rng.standard_normal(state.shape)
    return Record(f"run {k}", times, push[:, np.newaxis], seen, BODY.channels)


@pytest.fixture(scope="module")
def model() -> Model:
    """The body with the spring and the damping that are known of."""
    hull = Force(
        "hull",
        {"Z": "push - Z_w*w - Z_z*z"},
        (Parameter("Z_w", 6.0, "N s/m", lower=0.0), Parameter("Z_z", 12.0, "N/m", lower=0.0)),
    )
    return BODY + hull


def improved(model: Model, **hidden: float) -> Improvement:
    """The search with a candidate that is not it."""
    runs = [truth(k, **hidden) for k in range(4)]
    damping = quadratic_drag("damping", "Z", "w", scale=5.0)
    return improve(model, Dataset(runs[:2]), Dataset(runs[2:]), candidates=[damping])


def test_a_spring_that_hardens_is_found(model: Model) -> None:
    """Powers of a position that a force knows are in the dictionary of terms."""
    found = improved(model, cubic=40.0)
    assert [step.added for step in found.steps] == ["term_Z_zzz"]
    size = next(p for p in found.parameters if p["name"] == "Z_zzz")
    assert abs(size["value"] + 40.0) < 4 * size["std_error"]
    assert found.remains.kind == "adequate"


def test_a_stop_is_no_sea(model: Model) -> None:
    """A force that no term holds is said to follow the depth."""
    found = improved(model, stop=60.0)
    assert found.remains.kind == "structure missing"
    assert found.remains.follows is not None
    (force,) = found.remains.follows
    assert force.signals == ("z",)
    assert force.share > 0.4


def test_a_sea_follows_nothing(model: Model) -> None:
    """A random force stays one."""
    found = improved(model, sea=3.0)
    assert not found.steps
    assert found.remains.kind == "random forces"
    assert found.remains.follows == ()


def test_standard_error_of_a_correlation() -> None:
    """Of slow series that have nothing to do with each other, by a thousand draws."""
    rng = np.random.default_rng(3)
    keep, n = 0.9, 400
    drawn = np.zeros((2000, n))
    for i in range(1, n):
        drawn[:, i] = keep * drawn[:, i - 1] + rng.standard_normal(2000)
    one, other = drawn[:1000], drawn[1000:]
    norms = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
    scatter = np.std((one * other).sum(axis=1) / norms)
    stated = [_standard_error([a], [b]) for a, b in zip(one, other, strict=True)]
    assert np.median(stated) == pytest.approx(scatter, rel=0.15)


def test_lagged_products() -> None:
    """Sums of products, as written out."""
    series = np.array([1.0, -2.0, 0.5, 3.0])
    expected = [series @ series, series[:-1] @ series[1:], series[:-2] @ series[2:]]
    np.testing.assert_allclose(lagged_products(series, 2), expected, atol=1e-12)
