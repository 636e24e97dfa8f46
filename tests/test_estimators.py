"""What every estimator promises, and filters that estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from altered import overwritten
from marks import slow
from motion import small

from oed_sysid import Dataset, Experiment, Fit, Model, Multisine, Record, baselines, simulate
from oed_sysid.baselines import MultipleShooting, Multistart
from oed_sysid.baselines.contest import load_scenario
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.noise_levels import credible_levels, white_levels
from oed_sysid.likelihood.start_guess import measured_states
from oed_sysid.physics import Force, Parameter
from oed_sysid.physics.channels import Channels, Output
from oed_sysid.testing import check_estimator

YAW = small(
    "yaw",
    "psi [rad], r [rad/s] <- delta [rad]",
    {"psi": "r"},
    [Parameter("I", 5.0, "kg m^2", fixed=True)],
    {"psi": 2e-3, "r": 1e-3},
    scales={"r": 0.1},
    interpolation="linear",
    axes={"N": "r"},
    inertia={("N", "r"): "I"},
    effects=(
        Force(
            "hull",
            {"N": "N_r*r + N_absrr*r*abs(r) + N_delta*delta"},
            (
                Parameter("N_r", -1.0, "N m s", lower=-3.0, upper=0.0),
                Parameter("N_absrr", -4.0, "kg m^2", lower=-10.0, upper=0.0),
                Parameter("N_delta", 0.8, "N m", lower=0.0, upper=3.0),
            ),
        ),
    ),
)
TEST = Experiment(
    "multisine", Multisine("delta", (0.02, 0.05, 0.1, 0.16), amplitudes=(0.2,) * 4), duration=80.0
)

# Estimator, accuracy without noise, coverage promised (None: intervals exclude a stated bias).
# Differences of a rudder that has corners at the samples are good to a thousandth, local
# cubics smear more; the others simulate.
CASES = [
    (MultipleShooting(), 1e-6, 0.85, 10),
    (baselines.OutputError(), 1e-6, 0.85, 10),
    (Multistart(n_starts=3, n_jobs=1), 1e-6, None, 0),
    *slow(
        (baselines.JointKalmanFilter(), 1e-4, 0.85, 10),
        (baselines.JointKalmanFilter(kind="unscented"), 1e-3, 0.8, 4),
    ),
    (baselines.JointKalmanFilter(), 1e-4, None, 0),
    (baselines.JointKalmanFilter(kind="unscented"), 1e-3, None, 0),
    (baselines.EquationError(rule="simpson"), 5e-3, 0.85, 10),
    (baselines.EquationError(window=9), 5e-3, None, 0),
    (baselines.TotalLeastSquares(window=9), 5e-3, None, 0),
    (baselines.LeastSquaresSVM(C=1e8), 5e-3, 0.85, 10),
    (baselines.SupportVectorRegression(), 1e-2, None, 0),
    (baselines.OnlineRegression(C=1e8), 5e-3, 0.85, 5),
    (baselines.GibbsRegression(rule="simpson", n_draws=300), 5e-3, None, 0),
    (baselines.GibbsRegression(rule="simpson", n_draws=2000, draw="coordinate"), 1e-2, None, 0),
    *slow(
        (baselines.DifferentialSwarm(n_particles=40, n_generations=120), 1e-3, 0.85, 12),
        (baselines.DifferentialEvolution(n_particles=30, n_generations=80), 1e-3, 0.85, 12),
        (baselines.CovarianceMatrixAdaptation(n_generations=120), 1e-3, 0.85, 12),
    ),
    *slow(
        (baselines.DifferentialEvolution(n_particles=30, n_generations=80), 1e-3, None, 0),
        (baselines.CovarianceMatrixAdaptation(n_generations=120), 1e-3, None, 0),
    ),
    (baselines.ParticleSwarm(n_particles=30, n_generations=80), 1e-2, None, 0),
]


@pytest.mark.parametrize(
    ("estimator", "tolerance", "coverage", "n_repeats"),
    CASES,
    ids=lambda value: type(value).__name__ if hasattr(value, "fit") else "",
)
def test_contract(
    estimator: object, tolerance: float, coverage: float | None, n_repeats: int
) -> None:
    """It finds the truth without noise, covers it with noise, and changes nothing."""
    check_estimator(
        estimator,  # type: ignore[arg-type]
        YAW,
        (TEST,),
        rng=np.random.default_rng(7),
        tolerance=tolerance,
        coverage=coverage,
        n_repeats=n_repeats,
    )


@dataclass(frozen=True)
class Shifted:
    """An estimator that breaks one promise on purpose."""

    fault: str
    name: str = "shifted"

    def fit(self, model: Model, dataset: object) -> Fit:
        """Fit well, then spoil it."""
        fit = MultipleShooting(disturbances="none").fit(model, dataset)  # type: ignore[arg-type]
        if self.fault == "value":
            return replace(fit, estimates=1.01 * fit.estimates)
        if self.fault == "errors":
            return replace(fit, covariance=1e-4 * fit.covariance)
        if self.fault == "random":
            noise = 1e-9 * np.random.default_rng().standard_normal(len(fit.estimates))
            return replace(fit, estimates=fit.estimates + noise)
        return replace(fit, names=fit.names[::-1])


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("value", "is off by"),
        ("errors", "intervals hold the truth"),
        ("random", "two results"),
        ("names", "returns"),
    ],
)
def test_contract_finds_broken_promises(fault: str, message: str) -> None:
    """The check fails, with the right words, for an estimator that breaks a promise."""
    with pytest.raises(AssertionError, match=message):
        check_estimator(Shifted(fault), YAW, (TEST,), rng=np.random.default_rng(1), n_repeats=5)


# A ramp of unknown slope: linear in states and parameter together.
SLOPE = Parameter("slope", 0.0, "m/s", scale=1.0)
RAMP = small("ramp", "x [m]", {"x": "slope"}, [SLOPE], 0.3)


def ramp_data(n: int = 60) -> Dataset:
    """Noisy samples of a ramp of slope 2."""
    t = 0.1 * np.arange(n)
    x = 2.0 * t + 0.3 * np.random.default_rng(0).standard_normal(n)
    return Dataset((Record("ramp", t, np.empty((n, 0)), x, RAMP.channels),))


@pytest.mark.parametrize("kind", ["extended", "unscented"])
def test_linear_model_gives_regularised_least_squares(kind: str) -> None:
    """For a linear model either filter equals least squares with the same priors."""
    data = ramp_data()
    record = data[0]
    known = RAMP.with_parameter(replace(RAMP.parameter("slope"), prior_std=5.0))
    fit = baselines.JointKalmanFilter(kind=kind).fit(known, data)
    start = measured_states(RAMP, record)[0][0]
    design = np.column_stack([np.ones(60), record.times]) / 0.3
    rows = np.vstack([design, [[1 / 3.0, 0.0], [0.0, 1 / 5.0]]])
    right = np.concatenate([record.output("x") / 0.3, [start / 3.0, 0.0]])
    solution = np.linalg.lstsq(rows, right, rcond=None)[0]
    spread = np.linalg.inv(rows.T @ rows)
    assert fit.values["slope"] == pytest.approx(solution[1], rel=1e-8)
    assert fit.std_errors["slope"] == pytest.approx(np.sqrt(spread[1, 1]), rel=1e-8)
    track, errors = (fit.extras[name]["slope"] for name in ("history", "history_std"))
    assert len(track) == len(errors) == record.n_samples
    assert errors[-1] == pytest.approx(fit.std_errors["slope"])
    assert errors[0] > 10 * errors[-1]
    assert fit.extras["innovation"] == pytest.approx(1.0, abs=0.2)


def test_drift_is_followed() -> None:
    """With drift allowed the filter follows a slope that changes; without it, it averages."""
    t = 0.1 * np.arange(400)
    x = np.where(t < 20, t, 20 + 3 * (t - 20))
    x = x + 0.05 * np.random.default_rng(1).standard_normal(400)
    data = Dataset((Record("bend", t, np.empty((400, 0)), x, RAMP.channels),))
    follows = baselines.JointKalmanFilter(drift_std={"slope": 0.5}, process_std={"x": 0.1}).fit(
        RAMP, data
    )
    rigid = baselines.JointKalmanFilter().fit(RAMP, data)
    assert follows.values["slope"] == pytest.approx(3.0, abs=0.2)
    assert follows.extras["history"]["slope"][150] == pytest.approx(1.0, abs=0.3)
    assert abs(rigid.values["slope"] - 3.0) > 0.5


def test_missing_samples_widen_the_errors() -> None:
    """Samples that are missing are passed over, and the errors grow."""
    data = ramp_data()
    full = baselines.JointKalmanFilter().fit(RAMP, data)
    half = baselines.JointKalmanFilter().fit(RAMP, overwritten(data, 0, np.s_[1::2], np.nan))
    assert half.std_errors["slope"] == pytest.approx(np.sqrt(2) * full.std_errors["slope"], rel=0.1)


def test_unknown_names_are_refused() -> None:
    """Settings that name a state or parameter that does not exist are errors."""
    with pytest.raises(ModelError, match="process_std names 'y'"):
        baselines.JointKalmanFilter(process_std={"y": 1.0}).fit(RAMP, ramp_data())
    with pytest.raises(ModelError, match="kind is"):
        baselines.JointKalmanFilter(kind="particle")


@pytest.mark.slow
def test_points_far_out_make_the_unscented_filter_too_sure() -> None:
    """On the torpedo 95 % intervals hold the truth nine times of ten, but not from far points."""
    scenario = load_scenario("torpedo")
    model = scenario.with_noise(scenario.noise(1.0))
    held: dict[float, list[bool]] = {3.0**0.5: [], 4.0: []}
    for seed in range(8):
        rng = np.random.default_rng(seed)
        data = Dataset(simulate(model, run, rng=rng) for run in scenario.train)
        away = {n: v * (1 + 0.3 * rng.uniform(-1, 1)) for n, v in scenario.truth.items()}
        for reach, found in held.items():
            filter_ = baselines.JointKalmanFilter("unscented", reach=reach)
            fit = filter_.fit(model.with_values(away), data)
            intervals = {name: fit.interval(name) for name in fit.names}
            found += [low <= scenario.truth[n] <= high for n, (low, high) in intervals.items()]
    near, far = (float(np.mean(found)) for found in held.values())
    assert near >= 0.85
    assert far < near - 0.1


DECAY = small("decay", "x [m]", {"x": "-k*x"}, [Parameter("k", 0.5, "1/s", fixed=True)])


@pytest.mark.parametrize("start", ["near", "wide"])
def test_initial_state_of_a_known_model(start: str) -> None:
    """The initial state is the closed-form least-squares amplitude of the known decay."""
    times = np.arange(0.0, 6.0, 0.1)
    shape = np.exp(-0.5 * times)
    rng = np.random.default_rng(5)
    measured = 2.0 * shape + 0.05 * rng.standard_normal(times.size)
    data = Dataset((Record("decay", times, [], measured, DECAY.channels),))
    fit = MultipleShooting(start=start).fit(DECAY, data)
    expected = shape @ measured / (shape @ shape)
    assert fit.status.ok
    assert fit.names == ()
    assert fit.covariance.shape == (0, 0)
    assert fit.normalised_rms == pytest.approx(1.0, abs=0.1)
    assert fit.initial_states[0][0] == pytest.approx(expected, rel=1e-5)
    assert "initial states only" in fit.report()


CHANNELS = Channels((), (Output("y", "m", "level"),))


def record(motion: np.ndarray, noise: float, seed: int = 0) -> Record:
    """A motion at 10 Hz with white noise added."""
    rng = np.random.default_rng(seed)
    values = motion + noise * rng.standard_normal(len(motion))
    times = 0.1 * np.arange(len(motion))
    return Record("r", times, np.zeros((len(times), 0)), values[:, np.newaxis], CHANNELS)


@pytest.mark.parametrize("frequency", [0.02, 0.5, 1.5], ids=["slow", "faster", "seven samples"])
def test_white_noise_is_seen_below_a_motion_a_hundred_times_larger(frequency: float) -> None:
    """However fast the motion, up to seven samples a period, the level is found within a fifth."""
    motion = np.sin(2 * np.pi * frequency * 0.1 * np.arange(3000))
    levels, seen = white_levels(Dataset((record(motion, 0.01),)))
    assert seen[0]
    assert levels[0] == pytest.approx(0.01, rel=0.2)


def test_missing_samples_between_the_measured_ones_do_not_matter() -> None:
    """A sensor with every fourth sample shows the noise that it has."""
    full = record(np.zeros(4000), 0.3)
    sparse = np.where(np.arange(4000) % 4 == 0, full.outputs[:, 0], np.nan)
    levels, _ = white_levels(Dataset((full.with_outputs(sparse[:, np.newaxis]),)))
    assert levels[0] == pytest.approx(0.3, rel=0.1)


def test_motion_without_noise_is_not_called_noise() -> None:
    """Where every order of differences shows less, the level is only an upper limit, and small."""
    motion = np.sin(0.1 * 0.1 * np.arange(500))
    levels, _ = white_levels(Dataset((record(motion, 0.0),)))
    assert levels[0] < 1e-6


def test_a_filtered_log_is_not_measured_without_error() -> None:
    """The last digit of a file is no sensor's noise; noise that one sees is left as it is."""
    motion = np.sin(0.2 * 0.1 * np.arange(3000))
    rounded = Dataset((record(np.round(motion, 8), 0.0),))
    levels, seen = credible_levels(rounded)
    assert not seen[0]
    assert levels[0] == pytest.approx(1e-3 * np.std(motion), rel=0.1)
    fine = Dataset((record(motion, 1e-4),))
    levels, seen = credible_levels(fine)
    assert seen[0]
    assert levels[0] == pytest.approx(1e-4, rel=0.2)
