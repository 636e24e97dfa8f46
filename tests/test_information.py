"""Information about parameters: before data, at sea, of slow sensors, and whether it holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_design import DOUBLET, LIMITS, quick, sea, ship
from yaw_vehicle import NOISE, TRUE, yaw_data, yaw_model

from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Experiment, Model, NoiseModel, Sea, load_problem, simulate_inputs
from oed_sysid.design import accuracy_range
from oed_sysid.errors import DesignError
from oed_sysid.information import commanded_runs, information_of, respond, sea_noise, sea_words
from oed_sysid.information.bound import RunInformation
from oed_sysid.likelihood.information import (
    Information,
    autocorrelation,
    coloured_score_covariance,
    effective_sample_size,
    whiteness,
)
from oed_sysid.likelihood.multiple_shooting import MultipleShooting

NAMES = ("a", "b", "c")


def jacobian(seed: int = 0, n: int = 40) -> np.ndarray:
    """A well-conditioned Jacobian of three unknowns."""
    return np.random.default_rng(seed).standard_normal((n, 3)) * [1.0, 10.0, 0.01]


@pytest.mark.parametrize("scales", [None, [3.0, 1e-6, 1e6]])
def test_covariance_is_the_inverse(scales: list[float] | None) -> None:
    """Covariance, errors and determinant agree with the inverse of J'J, whatever the scales."""
    rows = jacobian()
    information = Information.from_jacobian(NAMES, rows, None if scales is None else scales)
    dense = np.linalg.inv(rows.T @ rows)
    assert np.allclose(information.covariance, dense, rtol=1e-9)
    assert np.allclose(information.std_errors, np.sqrt(np.diag(dense)), rtol=1e-9)
    assert np.allclose(information.matrix, rows.T @ rows, rtol=1e-9)
    assert information.log_determinant == pytest.approx(-np.linalg.slogdet(dense)[1], rel=1e-9)
    assert information.rank == 3


def test_matrix_and_jacobian_agree_even_with_bad_scales() -> None:
    """A matrix with scales that are off by twelve orders gives the same covariance."""
    rows = jacobian()
    from_matrix = Information.from_matrix(NAMES, rows.T @ rows, [1e6, 1.0, 1e-6])
    from_rows = Information.from_jacobian(NAMES, rows)
    assert np.allclose(from_matrix.covariance, from_rows.covariance, rtol=1e-8)


def test_experiments_add() -> None:
    """The information of two experiments is that of their joined Jacobians."""
    first, second = jacobian(1), jacobian(2)
    total = Information.from_jacobian(NAMES, first, [2.0, 1.0, 1.0]) + Information.from_jacobian(
        NAMES, second, [1.0, 5.0, 1.0]
    )
    joined = Information.from_jacobian(NAMES, np.vstack([first, second]))
    assert np.allclose(total.covariance, joined.covariance, rtol=1e-9)


def test_other_unknowns_do_not_add() -> None:
    """Information on different unknowns is not added silently."""
    with pytest.raises(ValueError, match="same unknowns"):
        Information.from_jacobian(NAMES, jacobian()) + Information.from_jacobian(
            ("a", "b", "d"), jacobian()
        )


def test_null_direction_is_named_with_its_ratio() -> None:
    """Two columns in fixed proportion are found free to move together, the third is not."""
    rows = jacobian()
    rows[:, 1] = -2.0 * rows[:, 0]
    information = Information.from_jacobian(NAMES, rows)
    assert information.rank == 2
    (text,) = information.null_directions()
    # b changes the outputs twice as much, with opposite sign: moving a by 2 and b by 1 cancels.
    assert "a: +2" in text or "b: +0.5" in text
    assert "c" not in text.split("(")[1]
    assert np.isinf(information.std_errors[:2]).all()
    assert information.std_errors[2] < 100


def test_unseen_unknown_is_said_to_be_unseen() -> None:
    """A column of zeros is named, and does not disturb the others."""
    rows = jacobian()
    alone = Information.from_jacobian(("a", "c"), rows[:, [0, 2]])
    rows[:, 1] = 0.0
    information = Information.from_jacobian(NAMES, rows)
    assert information.null_directions() == ("b does not influence any output",)
    assert np.allclose(information.std_errors[[0, 2]], alone.std_errors, rtol=1e-9)
    assert information.log_determinant == -np.inf


def test_fewer_rows_than_unknowns() -> None:
    """One observation of three unknowns leaves two directions free."""
    information = Information.from_jacobian(NAMES, np.ones((1, 3)))
    assert information.rank == 1
    assert len(information.null_directions()) == 2


def test_nothing_to_estimate() -> None:
    """Without unknowns there is an empty covariance, no error."""
    information = Information.from_jacobian((), np.zeros((5, 0)))
    assert information.covariance.shape == (0, 0)
    assert information.null_directions() == ()


def ar1(n: int, memory: float, rng: np.random.Generator, columns: int = 1) -> np.ndarray:
    """Stationary first-order autoregressive noise of unit variance, ``(n, columns)``."""
    return gauss_markov(rng.standard_normal((n, columns)), memory)


def test_autocorrelation_is_the_direct_sum() -> None:
    """The transform gives what the definition gives, missing samples left out."""
    rng = np.random.default_rng(3)
    series = rng.standard_normal(50)
    series[[4, 20, 21]] = np.nan
    centred = series - np.nanmean(series)
    direct = []
    for lag in range(6):
        products = centred[: 50 - lag] * centred[lag:]
        direct.append(np.nanmean(products))
    assert np.allclose(autocorrelation(series, 5), np.array(direct) / direct[0])


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.8, 0.95])
def test_effective_samples_of_autoregressive_noise(memory: float) -> None:
    """The count of independent samples is near n (1 - a) / (1 + a)."""
    rng = np.random.default_rng(4)
    counts = [effective_sample_size(ar1(4000, memory, rng)[:, 0]) for _ in range(10)]
    expected = 4000 * (1 - memory) / (1 + memory)
    assert np.mean(counts) == pytest.approx(expected, rel=0.15)


def test_whiteness_has_its_level() -> None:
    """White series are rejected at 5 % about once in twenty times, coloured ones always."""
    rng = np.random.default_rng(5)
    values = [whiteness(rng.standard_normal(400)).p_value for _ in range(300)]
    assert 0.02 < np.mean(np.array(values) < 0.05) < 0.085
    assert not whiteness(ar1(400, 0.4, rng)[:, 0]).is_white


def test_score_covariance_is_the_double_sum() -> None:
    """Much noise of known colour gives the sum over t and s of J_t' C(s - t) J_s."""
    rng = np.random.default_rng(6)
    n, n_outputs, n_unknowns = 80, 2, 3
    rows = rng.standard_normal((n, n_outputs, n_unknowns))
    mixing = np.array([[1.0, 0.6], [0.0, 0.8]])
    long = ar1(200_000, 0.6, rng, 2) @ mixing
    direct = np.zeros((n_unknowns, n_unknowns))
    for t in range(n):
        for s in range(n):
            direct += rows[t].T @ (mixing.T @ mixing * 0.6 ** abs(s - t)) @ rows[s]
    found = coloured_score_covariance([rows], [long])
    assert np.allclose(found, direct, rtol=0.02, atol=0.01 * np.trace(direct))


def test_score_covariance_of_white_noise_is_the_information() -> None:
    """For white residuals of unit variance the sandwich's middle is J'J."""
    rng = np.random.default_rng(7)
    t = np.arange(3000) * 0.01
    rows = np.stack([np.sin(t), np.cos(2 * t)], axis=1)[:, None, :]
    ratios = []
    for _ in range(20):
        found = coloured_score_covariance([rows], [rng.standard_normal((3000, 1))])
        ratios.append(np.diag(found) / np.diag(rows[:, 0].T @ rows[:, 0]))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_sandwich_covers_in_coloured_regression() -> None:
    """Slopes of smooth regressors in coloured noise: intervals cover about 95 %."""
    rng = np.random.default_rng(8)
    t = np.linspace(0, 10, 1000)
    design = np.stack([np.sin(t), t / 10, np.ones_like(t)], axis=1)
    inverse = np.linalg.inv(design.T @ design)
    inside = []
    for _ in range(200):
        noise = ar1(1000, 0.9, rng)
        estimate = inverse @ design.T @ noise[:, 0]
        residual = noise - (design @ estimate)[:, None]
        middle = coloured_score_covariance([design[:, None, :]], [residual])
        errors = np.sqrt(np.diag(inverse @ middle @ inverse))
        inside.append(np.abs(estimate) < 1.96 * errors)
    # The residual's own fit costs a little: not below 88 %.
    assert 0.88 < np.mean(inside) < 0.98


def test_missing_samples_do_not_count() -> None:
    """Rows without measurement carry no information and no correlation."""
    rng = np.random.default_rng(9)
    rows, residuals = rng.standard_normal((200, 1, 2)), rng.standard_normal((200, 1))
    residuals[::2] = np.nan
    rows[::2] = 0.0
    found = coloured_score_covariance([rows], [residuals])
    assert np.isfinite(found).all()
    assert np.trace(found) == pytest.approx(np.sum(rows**2), rel=0.4)


@pytest.mark.parametrize("stride", [2, 4, 7])
def test_colour_shows_between_missing_rows(stride: int) -> None:
    """A series with empty rows in between is as coloured as without them."""
    rng = np.random.default_rng(3)
    series = gauss_markov(rng.standard_normal(2000), 0.9)
    sparse = np.full(2000 * stride, np.nan)
    sparse[1::stride] = series
    assert effective_sample_size(sparse) == pytest.approx(effective_sample_size(series))
    assert whiteness(sparse).lag_one == pytest.approx(0.9, abs=0.05)
    assert not whiteness(sparse).is_white


def test_white_series_with_gaps_stays_white() -> None:
    """Samples lost at random leave a white series white."""
    rng = np.random.default_rng(4)
    series = rng.standard_normal(3000)
    series[rng.random(3000) < 0.3] = np.nan
    assert whiteness(series).is_white


def dense_information(model: Model, noise: NoiseModel) -> np.ndarray:
    """The same by one large Gaussian: outputs linear in the forces about the nominal run."""
    given = commanded_runs(model, DOUBLET)[0]
    base = respond(model, given)
    n, step = len(given.times), float(given.times[1])

    def outputs(forces: np.ndarray) -> np.ndarray:
        # The force as an input that is held over a sample, as the filter takes it.
        rate = f"{model.kinematics['r']} + w"
        wide = replace(
            model,
            inputs=(*model.inputs, replace(model.inputs[0], name="w", unit="")),
            kinematics={**model.kinematics, "r": rate},
        )
        both = np.column_stack([given.inputs, forces])
        return simulate_inputs(wide, given.times, inputs=both, initial=given.initial).outputs

    still = outputs(np.zeros(n))
    by_force = np.stack(
        [((outputs(1e-4 * unit) - still) / 1e-4).ravel() for unit in np.eye(n)], axis=1
    )
    lags = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * step
    memory = noise.force[0] ** 2 * np.exp(-lags / noise.force_time[0])
    # A sea acts by its means over steps: autocovariance under the triangle of two of them. Its
    # level is that of such a mean.
    ends = np.linspace(-step, step, 401)
    for waves in noise.seas:
        z, w = waves.bandwidth / 2, 2 * np.pi / waves.period
        root, means = np.sqrt(1 - z**2), np.zeros_like(lags)
        for away in ends:
            t = np.abs(lags + away)
            shape = np.cos(w * root * t) - z / root * np.sin(w * root * t)
            means += (step - abs(away)) * np.exp(-z * w * t) * shape
        memory += waves.level[0] ** 2 * means / means[0, 0]
    sensors = np.kron(np.eye(n), np.diag(noise.white**2))
    sensors += np.kron(np.exp(-lags / noise.colour_time[1]), np.diag(noise.colour**2))
    covariance = by_force @ memory @ by_force.T + sensors
    rows = base.jacobian.reshape(-1, base.jacobian.shape[2])
    matrix = rows.T @ np.linalg.solve(covariance, rows)
    own = len(model.states)
    kept = matrix[own:, own:]
    return kept - matrix[own:, :own] @ np.linalg.solve(matrix[:own, :own], matrix[:own, own:])


@pytest.mark.parametrize(
    ("level", "colour", "waves"), [(0.01, 0.0, 0.0), (0.01, 4e-3, 0.0), (0.0, 0.0, 0.02)]
)
def test_expected_information_is_that_of_the_whole_gaussian(
    level: float, colour: float, waves: float
) -> None:
    """The filter's information equals that of all samples with their joint covariance."""
    model = ship(step=0.05)
    noise = sea(level, colour=colour)
    if waves:
        noise = replace(
            noise, seas=(Sea(period=7.0, bandwidth=0.2, levels={"r": waves}, shape="velocity"),)
        )
    found = information_of(model, DOUBLET, noise=noise, priors=None).matrix
    expected = dense_information(model, noise)
    # Nonlinear damping: the nominal path differs from its start states' only in rounding.
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-4 * np.abs(expected).max())


def test_without_forces_it_is_the_white_bound() -> None:
    """A noise model of white sensors gives the information of their levels."""
    model = ship()
    white = NoiseModel.white_only(np.array([5e-3, 2e-3]), model.output_names)
    found = information_of(model, DOUBLET, noise=white).matrix
    np.testing.assert_allclose(found, information_of(model, DOUBLET).matrix, rtol=1e-9)


def test_a_model_made_ready_once_tells_the_same_of_every_run() -> None:
    """Made ready once, the model tells the same; a run that diverges tells nothing."""
    model = ship()
    wild = replace(DOUBLET, initial={"r": 1e200})
    told = RunInformation(model, sea(0.01))
    found = [told.matrix(run) for run in (DOUBLET, wild, DOUBLET)]
    alone = information_of(model, DOUBLET, noise=sea(0.01), priors=None)
    assert found[1] is None
    for one in (found[0], found[2]):
        assert one is not None
        np.testing.assert_allclose(one, alone.matrix, rtol=1e-12)


def test_forces_cost_information_and_sensors_bring_it() -> None:
    """More force, or one sensor less, never lowers an error; null directions stay null."""
    model = ship()
    errors = [
        information_of(model, DOUBLET, noise=sea(level), priors=None).std_errors
        for level in (1e-4, 1e-2, 1e-1)
    ]
    assert np.all(np.diff(errors, axis=0) > 0)
    one = information_of(model, DOUBLET, noise=sea(0.01), priors=None, outputs=("psi",))
    assert np.all(one.std_errors > errors[1])
    still = Experiment("straight", duration=20.0, sample_time=0.5, constants={"rudder": 0.0})
    blind = information_of(model, still, noise=sea(0.01), priors=None)
    assert any("b does not influence" in text for text in blind.null_directions())


def test_sea_in_words_grows_and_levels_are_taken() -> None:
    """Words are shares of the manoeuvre's motion, levels are what was said."""
    problem = load_problem("remus_diving_plane")
    runs = [problem.experiment("zigzag_10_10")]
    calm, rough = (sea_noise(problem.model, word, runs) for word in ("calm", "rough"))
    np.testing.assert_allclose(rough.force, 15 * calm.force)
    slow = sea_noise(problem.model, "calm,time=8", runs)
    np.testing.assert_allclose(slow.force, calm.force / 4)
    given = sea_noise(problem.model, "Z=0.3, M=0.06, time=5", runs)
    assert given.level("force Z") == (0.3, 5.0)
    assert sea_words(given) == "Z 0.3, M 0.06 over 5 s"
    assert sea_noise(problem.model, "still", runs).is_white
    for wrong, words in (("stormy", "Say still"), ("Z=much", "NAME=NUMBER"), ("K=1", "no place")):
        with pytest.raises(Exception, match=words):
            sea_noise(problem.model, wrong, runs)


def test_noise_that_does_not_fit_is_named() -> None:
    """Missing sensors and sensors without noise are said."""
    model = ship()
    short = NoiseModel.white_only(np.array([5e-3]), ("psi",))
    with pytest.raises(DesignError, match="no level for an output"):
        information_of(model, DOUBLET, noise=short)
    perfect = NoiseModel.white_only(np.array([5e-3, 0.0]), model.output_names)
    with pytest.raises(DesignError, match="white noise of r"):
        information_of(model, DOUBLET, noise=perfect)
    with pytest.raises(DesignError, match="no output 'x'"):
        information_of(model, DOUBLET, outputs=("x",))


def test_design_states_accuracy_for_the_sea() -> None:
    """A design under forces promises less than in still water, and says for which forces."""
    noise = sea(0.02)
    found = quick(noise=noise, n_starts=2)
    bound = information_of(found.model, found.experiment, noise=noise, priors=None)
    np.testing.assert_allclose(found.information.std_errors, bound.std_errors, rtol=1e-6)
    still = information_of(found.model, found.experiment, noise=noise.white, priors=None)
    assert np.all(still.std_errors < 0.7 * bound.std_errors)
    assert "r 0.02 over 3 s" in found.sea_trial_card()
    assert found.to_dict()["sea"]["disturbances"]["force r"]["level"] == 0.02


def test_beyond_a_third_no_number_is_stated() -> None:
    """Where forces drown the manoeuvre the card says so instead of a number; ranges are told."""
    model = ship()
    weak = replace(LIMITS, inputs={"rudder": (-0.01, 0.01)})
    found = quick(noise=sea(0.02), limits=weak)
    assert found.relative_errors.max() > 0.3
    assert "not id." in found.sea_trial_card()
    other = accuracy_range(
        model, DOUBLET, noise=sea(1e-3), spread=0.2, rng=np.random.default_rng(0)
    )
    nominal = information_of(model, DOUBLET, noise=sea(1e-3)).std_errors
    nominal /= np.abs([model.values[n] for n in other.names])
    assert np.all(other.lowest < nominal)
    assert np.all(nominal < other.highest)


TRUTH = np.array(list(TRUE.values()))


def repeat(memory: float, n_runs: int, **options: object) -> tuple[np.ndarray, ...]:
    """Deviations from the truth, white errors and stated errors, each ``(n_runs, 3)``."""
    clean = yaw_data(0, noise=np.zeros(2))
    estimator = MultipleShooting(**{"noise": NOISE, **options})
    rows = []
    for seed in range(n_runs):
        rng = np.random.default_rng(seed)
        noise = [NOISE * ar1(record.n_samples, memory, rng, 2) for record in clean]
        data = [one.with_outputs(one.outputs + own) for one, own in zip(clean, noise, strict=True)]
        fit = estimator.fit(yaw_model(), Dataset(data))
        assert fit.status.ok
        errors = np.sqrt(np.diag(fit.covariance))
        rows.append((fit.estimates - TRUTH, fit.information.std_errors, errors))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def coverage(deviation: np.ndarray, errors: np.ndarray) -> float:
    """Share of 95 % intervals that hold the truth."""
    return float(np.mean(np.abs(deviation) < 1.959964 * errors))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("memory", "n_runs", "options", "least", "most"),
    [
        (0.0, 300, {"coloured": "auto"}, 0.93, 0.97),
        (0.5, 300, {"disturbances": "none"}, 0.92, 0.985),
        (0.0, 300, {"loss": "huber", "coloured": "never"}, 0.92, 0.975),
        (0.5, 100, {}, 0.92, 0.985),  # the estimator finds the colour on its own
    ],
    ids=["white", "coloured", "robust", "usual"],
)
def test_stated_intervals_hold(
    memory: float, n_runs: int, options: dict, least: float, most: float
) -> None:
    """In white noise, in slow noise, where white intervals fail, and with Huber's loss."""
    deviation, white, stated = repeat(memory, n_runs, **options)
    assert least < coverage(deviation, stated) < most
    if options.get("disturbances") == "none":
        assert coverage(deviation, white) < 0.8
