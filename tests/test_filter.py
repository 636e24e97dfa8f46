"""The filter with disturbance forces against its NumPy twin, dense covariances and differences."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm
from simple_models import AUV
from turning_ship import CANDIDATES, SHIP

from oed_sysid.compiled.compile import _compiler
from oed_sysid.compiled.filtering import (
    COLOUR_TIME,
    COLOUR_VARIANCE,
    FORCE_TIME,
    FORCE_VARIANCE,
    WHITE_VARIANCE,
    Disturbed,
    FilterKernel,
    FilterPass,
    filter_kernel,
)
from oed_sysid.likelihood.filtered import active_components, disturbed_model
from oed_sysid.physics.model import Model

SHIP_FORCES = ("disturbance_force_r", "disturbance_actuator_delta")
AUV_FORCES = ("disturbance_force_Z", "disturbance_force_M", "disturbance_actuator_ds")
GAIN, TIME = 0.5, 4.0


def interpreted(kernel: FilterKernel) -> FilterKernel:
    """The same filter in NumPy, as a machine without a compiler has it."""
    other = object.__new__(FilterKernel)  # copies of a kernel are the kernel itself
    other.__dict__.update(kernel.__dict__, _library=None)
    return other


def assert_same(one: FilterPass, other: FilterPass) -> None:
    """Everything that two passes return is the same, to rounding."""
    assert one.failed_at == other.failed_at == -1
    for name in (
        "gram",
        "level_slope",
        "level_information",
        "log_variance",
        "square",
        "innovations",
        "variances",
        "rows",
        "path",
        "gains",
        "moves",
    ):
        if getattr(one, name) is None:
            continue
        a, b = (np.asarray(getattr(part, name)) for part in (one, other))
        size = np.abs(np.nan_to_num(b)).max(initial=1e-300)
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * size, err_msg=name)


def auv_record(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Irregular times, commands, and measurements with gaps."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.choice([0.1, 0.1, 0.1, 0.25, 0.4], 60))
    inputs = np.column_stack([0.2 * np.sin(0.7 * times), 8.0 + np.cos(0.3 * times)])
    measured = 0.05 * rng.standard_normal((60, 3))
    measured[rng.random((60, 3)) < 0.2] = np.nan
    measured[20:23] = np.nan
    return times, inputs, measured


AUV_NOISE = Disturbed(
    AUV_FORCES,
    np.array([4.0, 0.3, 0.01]) ** 2,
    np.array([1.5, 0.0, 3.0]),
    np.array([0.004, 0.004, 0.03]) ** 2,
    np.array([0, 2]),
    np.array([0.003, 0.05]) ** 2,
    np.array([0.4, 2.0]),
)
EVERY_LEVEL = (
    (FORCE_VARIANCE, 0),
    (FORCE_VARIANCE, 2),
    (FORCE_TIME, 0),
    (WHITE_VARIANCE, 1),
    (COLOUR_VARIANCE, 0),
    (COLOUR_VARIANCE, 1),
    (COLOUR_TIME, 1),
)
SHARED_TIMES = ((FORCE_VARIANCE, 1), (FORCE_TIME, -1), (COLOUR_VARIANCE, 1), (COLOUR_TIME, -1))


@pytest.mark.parametrize("levels", [(), EVERY_LEVEL, SHARED_TIMES], ids=["none", "own", "shared"])
@pytest.mark.parametrize("longest_step", [None, 0.06], ids=["samples", "sub-steps"])
def test_compiled_filter_is_the_interpreted_one(
    levels: tuple[tuple[int, int], ...], longest_step: float | None
) -> None:
    """Actuator and sensor memory, gaps, colours and sub-steps: C and NumPy agree to 1e-9."""
    kernel = filter_kernel(disturbed_model(AUV, AUV_FORCES))
    if _compiler() is None:
        pytest.skip("no compiler")
    assert kernel._library is not None
    times, inputs, measured = auv_record()
    values = kernel.model.value_vector
    own = np.array([1.5, 0.02, 0.0, 0.05, 2.0])

    def run(filter_: FilterKernel) -> FilterPass:
        return filter_.filter(
            times, inputs, values, own, measured, AUV_NOISE, names=("X_uu",), levels=levels,
            rows=True, gains=True, moves=True, longest_step=longest_step,
        )  # fmt: skip

    assert_same(run(kernel), run(interpreted(kernel)))


@pytest.mark.parametrize("longest_step", [None, 0.06], ids=["samples", "sub-steps"])
def test_replay_repeats_the_filter_and_shows_what_a_value_changes(
    longest_step: float | None,
) -> None:
    """At the values of the pass the same innovations; at others the columns at frozen gain."""
    kernel = filter_kernel(disturbed_model(AUV, AUV_FORCES))
    times, inputs, measured = auv_record()
    values = kernel.model.value_vector
    own = np.array([1.5, 0.02, 0.0, 0.05, 2.0])
    step = 1e-5
    moved = values.copy()
    moved[kernel.model.parameter_names.index("X_uu")] += step
    slopes = []
    for filter_ in (kernel, interpreted(kernel)):
        found = filter_.filter(
            times, inputs, values, own, measured, AUV_NOISE, names=("X_uu",), own_columns=False,
            rows=True, gains=True, longest_step=longest_step,
        )  # fmt: skip
        assert found.gains is not None
        assert found.rows is not None
        same, other = (
            filter_.replay(
                times, inputs, at, own, measured, AUV_NOISE, found.gains, longest_step=longest_step
            )
            for at in (values, moved)
        )
        assert same[1]
        assert other[1]
        np.testing.assert_allclose(same[0], found.innovations, rtol=1e-9, atol=1e-12)
        seen = np.isfinite(found.innovations)
        slopes.append(((other[0] - same[0])[seen], found))
        expected = found.rows[seen][:, 0] * np.sqrt(found.variances[seen]) * step
        # The gain itself moves with the path, which the replay leaves out as the columns do.
        np.testing.assert_allclose(slopes[-1][0], expected, atol=2e-3 * np.abs(expected).max())
    np.testing.assert_allclose(slopes[0][0], slopes[1][0], atol=1e-5 * np.abs(slopes[0][0]).max())


def ship_run(
    kernel: FilterKernel, model: Model, names: tuple[str, ...], noise: Disturbed
) -> FilterPass:
    """A smaller model on the filter of a larger one, or on its own filter."""
    rng = np.random.default_rng(4)
    times = np.arange(0.0, 12.0, 0.2)
    inputs = 0.3 * np.sign(np.sin(times))[:, None]
    measured = 0.01 * rng.standard_normal((len(times), 2))
    return kernel.filter(
        times, inputs, kernel.model.value_vector, np.array([0.1, 0.01]), measured, noise,
        names=names, active=active_components(kernel.model, model), rows=True,
        levels=((FORCE_VARIANCE, 0), (FORCE_TIME, -1), (WHITE_VARIANCE, 1)),
    )  # fmt: skip


def ship_noise(**changes: object) -> Disturbed:
    """Both disturbances and a coloured gyro."""
    noise = Disturbed(
        SHIP_FORCES,
        np.array([0.02, 0.1]) ** 2,
        np.array([1.0, 3.0]),
        np.array([0.01, 0.004]) ** 2,
        np.array([1]),
        np.array([0.003]) ** 2,
        np.array([0.7]),
    )
    return replace(noise, **changes)  # type: ignore[arg-type]


def test_a_filter_of_all_candidates_serves_each_smaller_model() -> None:
    """With candidates absent, the filter that holds them is that of the model without them."""
    wide = filter_kernel(disturbed_model(SHIP + CANDIDATES, SHIP_FORCES))
    small = filter_kernel(disturbed_model(SHIP, SHIP_FORCES))
    assert active_components(wide.model, SHIP) is not None
    assert wide.n_full > small.n_full
    through_wide = ship_run(wide, SHIP, ("K", "T"), ship_noise())
    kept = [0, 1, *range(wide.n_full, through_wide.path.shape[1])]
    through_wide = replace(through_wide, path=through_wide.path[:, kept])
    assert_same(through_wide, ship_run(small, SHIP, ("K", "T"), ship_noise()))
    # The same columns, some of candidates, in C and in NumPy.
    names = ("T", "n3", "E_bias_r")
    assert_same(
        ship_run(wide, SHIP + CANDIDATES, names, ship_noise()),
        ship_run(interpreted(wide), SHIP + CANDIDATES, names, ship_noise()),
    )


# -- a linear ship ----------------------------------------------------------------

LINEAR = replace(SHIP.with_values({"K": GAIN, "T": TIME}), step=0.02)
START = np.array([0.3, -0.05])


def linear_record(seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Irregular times, a constant rudder, and measurements with gaps."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.choice([0.2, 0.2, 0.2, 0.5], 40))
    measured = 0.05 * rng.standard_normal((40, 2))
    measured[rng.random((40, 2)) < 0.15] = np.nan
    return times, np.full((40, 1), 0.2), measured


def linear_pass(noise: Disturbed, own: np.ndarray = START, **options: object) -> FilterPass:
    """The filter of the linear ship."""
    kernel = filter_kernel(disturbed_model(LINEAR, noise.disturbances))
    times, inputs, measured = linear_record()
    values = kernel.model.value_vector
    if "K" in options:
        values[kernel.model.parameter_names.index("K")] = options.pop("K")
    return kernel.filter(
        times, inputs, values, own, measured, noise, longest_step=0.2, **options  # type: ignore[arg-type]
    )  # fmt: skip


def dense(noise: Disturbed) -> tuple[float, float]:
    """Log determinant and weighted square of all measurements, from their joint covariance.

    Disturbances are held over steps of at most 0.2 s; their covariance, and that of the coloured
    errors, is written down from the definition, the response to them is a matrix exponential.
    """
    times, inputs, measured = linear_record()
    driven = np.array([[0.0, 0.0], [1.0, GAIN / TIME]])  # by a force, by an actuator error
    rows = np.array([[0.0, 1.0], [0.0, -1.0 / TIME]])
    starts, lengths, ends = [], [], [0]
    for begin, end in pairwise(times):
        count = int(np.ceil((end - begin) / 0.2 - 1e-6))
        lengths += [(end - begin) / count] * count
        starts += [begin + (end - begin) * i / count for i in range(count)]
        ends.append(len(starts))
    mean, response = START.copy(), np.zeros((2, len(starts), 2))
    means, responses = [mean], [response]
    for position, length in enumerate(lengths):
        whole = np.zeros((5, 5))
        whole[:2, :2], whole[:2, 2:4] = rows, driven
        whole[1, 4] = GAIN / TIME * inputs[0, 0]
        move = expm(whole * length)
        mean = move[:2, :2] @ mean + move[:2, 4]
        response = np.einsum("ij,jkl->ikl", move[:2, :2], response)
        response[:, position] += move[:2, 2:4]
        means.append(mean)
        responses.append(response)
    expected = np.array([means[i] for i in ends])
    full = np.array([responses[i] for i in ends]).reshape(len(times) * 2, len(starts), 2)
    age = np.abs(np.subtract.outer(starts, starts))
    covariance = np.zeros((len(full), len(full)))
    for j in range(2):
        force = noise.variance[j] * np.exp(-age / max(noise.time[j], 1e-9))
        covariance += full[:, :, j] @ force @ full[:, :, j].T
    between = np.abs(np.subtract.outer(times, times))
    for i, output in enumerate(noise.coloured):
        coloured = noise.colour_variance[i] * np.exp(-between / noise.colour_time[i])
        covariance[output::2, output::2] += coloured
    covariance += np.diag(np.tile(noise.white, len(times)))
    residual = (measured - expected).ravel()
    seen = np.isfinite(residual)
    covariance, residual = covariance[np.ix_(seen, seen)], residual[seen]
    determinant = float(np.linalg.slogdet(covariance)[1])
    return determinant, float(residual @ np.linalg.solve(covariance, residual))


@pytest.mark.parametrize("time", [0.0, 0.3, 30.0])
@pytest.mark.parametrize("colour", [0.0, 0.003])
def test_likelihood_is_that_of_the_joint_normal_distribution(time: float, colour: float) -> None:
    """On a linear model log determinant and square equal those of a dense covariance to 1e-8."""
    noise = ship_noise(time=np.array([1.0, time]), colour_variance=np.array([colour**2]))
    found = linear_pass(noise)
    determinant, square = dense(noise)
    assert found.log_variance == pytest.approx(determinant, rel=1e-8)
    assert found.square == pytest.approx(square, rel=1e-8)
    assert found.objective == pytest.approx(determinant + square, rel=1e-8)


LEVELS = (
    (FORCE_VARIANCE, 0),
    (FORCE_VARIANCE, 1),
    (FORCE_TIME, 0),
    (FORCE_TIME, -1),
    (WHITE_VARIANCE, 0),
    (COLOUR_VARIANCE, 0),
    (COLOUR_TIME, 0),
)


def shifted(noise: Disturbed, level: tuple[int, int], by: float) -> Disturbed:
    """Noise with one variance moved by a share of itself, or one time by a factor."""
    kind, index = level
    names = ("variance", "time", "white", "colour_variance", "colour_time")
    array = getattr(noise, names[kind]).copy()
    where = slice(None) if index < 0 else index
    array[where] = array[where] * (np.exp(by) if kind in (FORCE_TIME, COLOUR_TIME) else 1 + by)
    return replace(noise, **{names[kind]: array})


@pytest.mark.parametrize("position", range(len(LEVELS)))
def test_tangents_of_levels_are_exact_on_a_linear_model(position: int) -> None:
    """Slope of the likelihood, of every innovation and of its variance equal differences."""
    noise, level, size = ship_noise(), LEVELS[position], 1e-4
    found = linear_pass(noise, levels=LEVELS, rows=True)
    up, down = (linear_pass(shifted(noise, level, sign * size)) for sign in (1, -1))
    # Tangents are by the variance itself, differences by a share of it.
    kind, index = level
    names = ("variance", None, "white", "colour_variance", None)
    unit = getattr(noise, str(names[kind]))[index] if names[kind] else 1.0
    n_columns = found.gram.shape[0] - 1 - len(LEVELS)
    slope = found.level_slope[position] + found.gram[n_columns + position, -1]
    expected = 0.5 * (up.objective - down.objective) / (2 * size * unit)
    assert slope == pytest.approx(expected, rel=1e-6)
    assert found.rows is not None
    root = np.sqrt(found.variances)
    seen = np.isfinite(found.innovations)
    moved = (up.innovations - down.innovations) / (2 * size * unit) / root
    tangent = found.rows[:, :, n_columns + position]
    np.testing.assert_allclose(tangent[seen], moved[seen], atol=1e-6 * np.nanmax(np.abs(moved)))
    grown = np.log(up.variances / down.variances) / (2 * size * unit)
    q = found.rows[:, :, n_columns + len(LEVELS) + position]
    np.testing.assert_allclose(q[seen], grown[seen], atol=1e-6 * np.abs(grown).max())
    assert found.level_information[position, position] == pytest.approx(
        0.5 * np.sum(grown[seen] ** 2), rel=1e-6
    )


def test_columns_are_exact_where_the_gain_does_not_move() -> None:
    """Derivatives by start states and by a gain that only scales the input equal differences."""
    noise = ship_noise(variance=np.array([4e-4, 0.0]))
    found = linear_pass(noise, names=("K", "T"), rows=True)
    assert found.rows is not None
    size = 1e-4
    pairs = []
    for i in range(2):
        move = size * np.eye(2)[i]
        pairs.append([linear_pass(noise, own=START + sign * move) for sign in (1, -1)])
    pairs.append([linear_pass(noise, K=GAIN + sign * size) for sign in (1, -1)])
    for column, (up, down) in enumerate(pairs):
        slope = (up.innovations - down.innovations) / (2 * size) / np.sqrt(found.variances)
        seen = np.isfinite(slope)
        tolerance = 1e-7 * np.nanmax(np.abs(slope))
        np.testing.assert_allclose(found.rows[:, :, column][seen], slope[seen], atol=tolerance)


def test_a_model_that_leaves_the_numbers_is_said_to() -> None:
    """Where it fails is returned, the objective is infinite, nothing raises."""
    wild = (SHIP + CANDIDATES[0]).with_values({"n3": 1e4})
    kernel = filter_kernel(disturbed_model(wild, SHIP_FORCES))
    times = np.arange(0.0, 40.0, 0.2)
    args = (times, np.full((200, 1), 1.0), kernel.model.value_vector, np.array([0.0, 3.0]))
    for one in (kernel, interpreted(kernel)):
        found = one.filter(*args, np.full((200, 2), np.nan), ship_noise())
        assert not found.ok
        assert 0 <= found.failed_at < 200
        assert found.objective == np.inf
