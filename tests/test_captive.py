"""Forces measured at given motion, alone and beside free-running records."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from golden_files import restored
from marks import slow
from motion import small

from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Experiment, Input, Output, State, ZigZag, simulate, simulate_inputs
from oed_sysid.baselines import MultipleShooting, OutputError, Solver
from oed_sysid.errors import DataError, ModelError, UnitWarning
from oed_sysid.likelihood.captive import CaptiveTests
from oed_sysid.likelihood.disturbances import chosen_places
from oed_sysid.physics import Actuator, ExtraState, Force, Parameter
from oed_sysid.physics.model import Model

TRUTH = {"Y_v": -40.0, "Y_r": 25.0, "N_v": -15.0, "N_r": -60.0, "Y_d": 12.0, "N_d": -30.0}
SPEED = 2.0


def ship() -> Model:
    """Sway and yaw of a ship at constant speed, with start values a third off."""
    parameters = tuple(Parameter(name, value / 1.5, "1") for name, value in TRUTH.items())
    return small(
        "sway and yaw",
        "v [m/s], r [rad/s], psi [rad] <- delta [rad]",
        {"psi": "r"},
        noise={"v": 0.01, "r": 0.005, "psi": 0.01},
        scales={"v": 0.2, "r": 0.1},
        axes={"Y": "v", "N": "r"},
        inertia={("Y", "v"): "150", ("N", "r"): "90"},
        effects=(
            Force(
                "hull and rudder",
                {"Y": "Y_v*v + Y_r*r + Y_d*delta", "N": "N_v*v + N_r*r + N_d*delta"},
                parameters,
            ),
        ),
        step=0.2,
    )


def forces(v: np.ndarray, delta: np.ndarray) -> dict[str, np.ndarray]:
    """What a carriage would measure, by hand."""
    return {
        "Y": TRUTH["Y_v"] * v + TRUTH["Y_d"] * delta,
        "N": TRUTH["N_v"] * v + TRUTH["N_d"] * delta,
    }


def test_what_turns_needs_a_moment_whatever_its_axis_is_called() -> None:
    """A shaft on a bench has an axis Q in N m, a cart an axis M in N."""
    for axis, rate, unit in (("Q", "rad/s", "N m"), ("M", "m/s", "N")):
        model = Model(
            "bench", (State("n", rate),), (Input("V", "V"),), (Output("n", rate),),
            axes={axis: "n"}, inertia={(axis, "n"): "2"},
            effects=(Force("motor", {axis: "k*V"}, (Parameter("k", 0.2),)),),
        )  # fmt: skip
        (force,) = chosen_places(model, "all")
        assert (force.name, force.unit) == (f"force {axis}", unit)
        towed = CaptiveTests("tests", {"n": [1.0]}, {"V": [1.0]}, {axis: [2.0]}, {axis: 0.1})
        assert towed.towed(model).outputs[-1].unit == unit


def drift_tests(noise: float = 0.0) -> CaptiveTests:
    """Drift and rudder, without yaw."""
    v = np.array([-0.4, -0.2, 0.2, 0.4, 0.0, 0.0])
    delta = np.array([0.0, 0.0, 0.0, 0.0, 0.3, -0.3])
    rng = np.random.default_rng(3)
    measured = {
        axis: force + noise * rng.standard_normal(len(force))
        for axis, force in forces(v, delta).items()
    }
    return CaptiveTests("carriage", {"v": v}, {"delta": delta}, measured, {"Y": 0.1, "N": 0.1})


def zigzag() -> Dataset:
    """A weak zigzag, in which sway follows yaw."""
    order = ZigZag("delta", 0.2, 0.1, sign=-1)
    test = Experiment("zigzag", order, duration=60.0, sample_time=0.2)
    return Dataset((simulate(ship().with_values(TRUTH), test, rng=np.random.default_rng(1)),))


def pushed() -> Dataset:
    """The zigzag in gusts that remember two seconds."""
    (record,) = zigzag()
    rng = np.random.default_rng(2)
    gust = 2.3 * gauss_markov(rng.standard_normal((record.n_samples, 2)), 0.9)
    gusts = (Input("gust_Y", "N", interpolation="linear"), Input("gust_N", "N m"))
    model = replace(ship(), inputs=(*ship().inputs, *gusts))
    model = model + Force("gusts", {"Y": "gust_Y", "N": "gust_N"})
    inputs = np.hstack([record.inputs, gust])
    run = simulate_inputs(model.with_values(TRUTH), record.times, inputs=inputs)
    noise = np.array([0.01, 0.005, 0.01]) * rng.standard_normal(run.outputs.shape)
    return Dataset((record.with_outputs(run.outputs + noise),))


def test_forces_at_given_motion_are_the_models_own() -> None:
    """The towed model says the sum of forces by hand, whatever its free states do."""
    tests = drift_tests()
    found = tests.predict(ship().with_values(TRUTH))
    for axis, force in tests.forces.items():
        assert found[axis] == pytest.approx(force, abs=1e-9)
    assert max(tests.relative_errors(ship().with_values(TRUTH)).values()) < 1e-9
    assert tests.relative_errors(ship())["Y"] == pytest.approx(1 / 3, rel=1e-6)


def test_captive_tests_alone_determine_what_they_excite() -> None:
    """Without yaw in the tests its derivatives stay unknown and the others return."""
    fit = drift_tests().fit(MultipleShooting(disturbances="none"), ship())
    for name in ("Y_v", "N_v", "Y_d", "N_d"):
        assert fit.values[name] == pytest.approx(TRUTH[name], rel=1e-6)
    assert not np.isfinite(fit.std_errors["Y_r"]) or fit.std_errors["Y_r"] > 1e3


def test_captive_tests_and_a_zigzag_share_one_likelihood() -> None:
    """What the zigzag cannot separate comes from the carriage; intervals hold the truth."""
    data, tests = zigzag(), drift_tests(noise=0.1)
    estimator = MultipleShooting(disturbances="none", coloured="never")
    alone = estimator.fit(ship(), data)
    both = tests.fit(estimator, ship(), data)
    assert both.status.ok
    assert both.std_errors["Y_v"] < 0.2 * alone.std_errors["Y_v"]
    for name, true in TRUTH.items():
        assert abs(both.values[name] - true) < 4 * both.std_errors[name]
    assert both.model.state_names == ship().state_names
    assert both.dataset is data
    assert both.normalised_rms == pytest.approx(1.0, abs=0.1)
    assert both.predict(data).rms["r"] == pytest.approx(0.005, rel=0.2)
    assert set(both.captive.relative) == {"Y", "N"}


def test_one_bollard_pull_is_enough_for_a_record() -> None:
    """A single test is padded, not refused, and weighs as one."""
    tests = CaptiveTests("pull", {}, {"delta": [0.3]}, {"Y": [3.6]}, {"Y": 0.1})
    (record,) = tests.records(ship())
    assert np.isfinite(record.outputs).sum() == 1
    assert tests.predict(ship().with_values(TRUTH))["Y"] == pytest.approx([3.6])


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"motions": {"w": [0.1]}}, ModelError, "no velocity of an axis"),
        ({"inputs": {}}, ModelError, "lack the input 'delta'"),
        ({"forces": {"K": [1.0]}}, ModelError, "no axis"),
        ({"inputs": {"delta": [0.1, 0.2]}}, DataError, "one value per test"),
        ({"motions": {"v": [np.nan]}}, DataError, "not finite"),
        ({"noise": {}}, DataError, "standard deviation"),
    ],
)
def test_what_does_not_fit_is_said(changes: dict, error: type, words: str) -> None:
    """Unknown states, inputs and axes, and columns of different lengths, are named."""
    given = {
        "motions": {"v": [0.1]},
        "inputs": {"delta": [0.0]},
        "forces": {"Y": [1.0]},
        "noise": {"Y": 0.1, "K": 0.1},
        **changes,
    }
    with pytest.raises(error, match=words):
        CaptiveTests("wrong", **given).records(ship())


def drift_series(order: np.ndarray | None = None, *, quadratic: float = -30.0) -> CaptiveTests:
    """Sixty tests sorted by drift; the hull may have a cross-flow drag that no parameter says."""
    n = 60
    v, delta = np.linspace(-0.4, 0.4, n), np.tile([-0.3, 0.0, 0.3], n // 3)
    rng = np.random.default_rng(3)
    measured = forces(v, delta)
    measured["Y"] = measured["Y"] + quadratic * v * np.abs(v)
    measured = {axis: f + 0.1 * rng.standard_normal(n) for axis, f in measured.items()}
    rows = np.arange(n) if order is None else order
    return CaptiveTests(
        "carriage",
        {"v": v[rows]},
        {"delta": delta[rows]},
        {axis: force[rows] for axis, force in measured.items()},
        {"Y": 0.1, "N": 0.1},
    )


@pytest.mark.parametrize(
    "settings",
    [
        {"disturbances": "none"},
        {"horizon": 10.0},
        {"loss": "auto"},
        {"solver": Solver("ipopt")},
        *slow({}),
    ],
)
@pytest.mark.parametrize("free_running", [False, True])
def test_the_order_of_tests_says_nothing(settings: dict, free_running: bool) -> None:
    """Rows that are shuffled give the same values and the same errors."""
    disturbed = free_running and not settings
    data = None if not free_running else pushed() if disturbed else zigzag()
    shuffled = np.random.default_rng(0).permutation(60)
    estimator = MultipleShooting(**settings)
    one = drift_series().fit(estimator, ship(), data)
    other = drift_series(shuffled).fit(estimator, ship(), data)
    assert one.status.ok
    assert other.estimates == pytest.approx(one.estimates, rel=1e-6)
    known = np.isfinite(np.diag(one.covariance))
    assert known.sum() == (6 if free_running else 4)
    assert np.sqrt(np.diag(other.covariance))[known] == pytest.approx(
        np.sqrt(np.diag(one.covariance))[known], rel=1e-5
    )
    assert "captive tests scatter" in one.report()
    found = {"disturbance forces" in fit.estimator for fit in (one, other)}
    assert found == {disturbed}


def test_errors_of_a_wrong_hull_are_those_of_white() -> None:
    """For tests alone the covariance is the sandwich by hand, and larger than the noise says."""
    tests = drift_series()
    fit = tests.fit(MultipleShooting(), ship())
    columns = np.column_stack([tests.motions["v"], tests.inputs["delta"]])
    inverse = np.linalg.inv(columns.T @ columns / 0.1**2)
    taken = np.einsum("tp,pq,tq->t", columns, inverse, columns) / 0.1**2
    residuals = [
        tests.forces[axis] - columns @ np.linalg.lstsq(columns, tests.forces[axis])[0]
        for axis in ("Y", "N")
    ]
    scaled = np.array(residuals) / 0.1
    for axis, own in zip(("Y", "N"), scaled, strict=True):
        lost = max(1.0, float(own @ own) / (60 - taken.sum()))
        middle = (columns * (own**2 + lost * taken)[:, None]).T @ columns / 0.1**2
        std = np.sqrt(np.diag(inverse @ middle @ inverse))
        for name, error in zip((f"{axis}_v", f"{axis}_d"), std, strict=True):
            assert fit.std_errors[name] == pytest.approx(error, rel=1e-6)
    assert fit.std_errors["Y_v"] > 3 * np.sqrt(inverse[0, 0])
    assert fit.std_errors["N_v"] == pytest.approx(np.sqrt(inverse[0, 0]), rel=0.4)


@pytest.mark.parametrize("noise", ["estimate", *slow("given")])
def test_intervals_of_captive_tests_hold_the_truth(noise: str) -> None:
    """Of 4 times 80 intervals of a right model 95 % hold the truth."""
    held = []
    tests = drift_series(quadratic=0.0)
    for seed in range(80):
        rng = np.random.default_rng(seed)
        clean = forces(tests.motions["v"], tests.inputs["delta"])
        drawn = {axis: f + 0.1 * rng.standard_normal(60) for axis, f in clean.items()}
        again = CaptiveTests("carriage", tests.motions, tests.inputs, drawn, tests.noise)
        fit = again.fit(MultipleShooting(noise=noise, coloured="auto"), ship())
        for name in ("Y_v", "Y_d", "N_v", "N_d"):
            low, high = fit.interval(name)
            held.append(low <= TRUTH[name] <= high)
    assert np.mean(held) == pytest.approx(0.95, abs=0.04)


def test_a_saved_fit_of_captive_tests_knows_that_they_are(tmp_path: Path) -> None:
    """Files keep that samples are independent."""
    fit = drift_series().fit(MultipleShooting(), ship())
    assert restored(fit, tmp_path).dataset[0].independent
    plain = replace(fit.dataset[0], independent=False)
    assert plain.content_hash != fit.dataset[0].content_hash


def test_tests_of_a_model_that_remembers_begin_anew() -> None:
    """A rudder that lags has settled in each test, whatever the one before was."""
    lag = Actuator(
        "lag", {"delta": "angle"}, states=(ExtraState("angle", "(delta - angle)/5", "delta"),)
    )
    tests = drift_series(quadratic=0.0)
    late = ship() + lag
    assert len(tests.records(late)) == 60
    fit = tests.fit(MultipleShooting(), late)
    fast = tests.fit(MultipleShooting(), ship())
    for name in ("Y_v", "Y_d", "N_v", "N_d"):
        assert fit.values[name] == pytest.approx(fast.values[name], rel=1e-6)
        assert fit.std_errors[name] == pytest.approx(fast.std_errors[name], rel=1e-6)
    found = drift_tests().predict(late.with_values(TRUTH))
    assert found["N"] == pytest.approx(drift_tests().forces["N"], abs=1e-9)
    assert "records       carriage 1 to carriage 60 (60 tests)" in fit.report()


def test_held_motion_does_not_turn_the_ship() -> None:
    """A force that depends on heading sees that of the start, however long the yaw rate is held."""
    wind = Force("wind", {"Y": "W*cos(psi)"}, (Parameter("W", 2.0, "N"),))
    n = 8
    tests = CaptiveTests(
        "rotating arm", {"r": np.full(n, 0.5)}, {"delta": np.zeros(n)}, {"Y": np.zeros(n)}, {"Y": 1}
    )
    found = tests.predict((ship() + wind).with_values(TRUTH))
    assert found["Y"] == pytest.approx(np.full(n, 0.5 * TRUTH["Y_r"] + 2.0))


def test_a_rudder_in_degrees_is_noticed() -> None:
    """Angles of more than half a turn are warned about."""
    tests = CaptiveTests("deg", {"v": [0.1]}, {"delta": [35.0]}, {"Y": [1.0]}, {"Y": 0.1})
    with pytest.warns(UnitWarning, match=r"reaches 35 rad.*np\.radians"):
        tests.predict(ship())


def test_far_starts_find_the_way_beside_few_tests() -> None:
    """One bollard pull beside a zigzag does not keep globalisation from longer intervals."""
    pull = CaptiveTests("pull", {}, {"delta": [0.3]}, {"Y": [3.6]}, {"Y": 0.1})
    far = ship().with_values({name: 0.1 * value for name, value in TRUTH.items()})
    fit = pull.fit(MultipleShooting(start="wide", disturbances="none"), far, zigzag())
    alone = MultipleShooting(disturbances="none").fit(ship().with_values(TRUTH), zigzag())
    assert fit.status.ok
    assert fit.cost == pytest.approx(alone.cost, rel=0.02)


def test_estimators_without_start_states_are_refused() -> None:
    """The estimator has to hold the start of a test."""
    with pytest.raises(ModelError, match="MultipleShooting; OutputError is not"):
        drift_tests().fit(OutputError(), ship())
