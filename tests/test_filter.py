"""The filter and its smoother against dense covariances; noise levels; trials drawn at sea."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
from scipy.linalg import expm
from simple_models import AUV
from test_design import DOUBLET, sea, ship
from turning_ship import CANDIDATES, SHIP

from oed_sysid import Doublet, Experiment, Limits, Model, NoiseModel, load_problem, simulate
from oed_sysid.compiled.compile import _compiler
from oed_sysid.compiled.filtering import (
    COLOUR_TIME,
    COLOUR_VARIANCE,
    FORCE_TIME,
    FORCE_VARIANCE,
    SEA_DAMPING,
    SEA_PERIOD,
    SEA_PHASE,
    SEA_VARIANCE,
    WHITE_VARIANCE,
    Along,
    Disturbed,
    FilterKernel,
    FilterPass,
    filter_kernel,
)
from oed_sysid.design import assess_limits
from oed_sysid.likelihood.filtered import active_components, disturbed_model
from oed_sysid.likelihood.noise_model import Levels
from oed_sysid.likelihood.realisation import simulate_at_sea
from oed_sysid.likelihood.smoother import Path, interpolated

SHIP_FORCES = ("disturbance_force_r", "disturbance_actuator_delta")
AUV_FORCES = ("disturbance_force_Z", "disturbance_force_M", "disturbance_actuator_ds")
GAIN, TIME = 0.5, 4.0


def interpreted(kernel: FilterKernel) -> FilterKernel:
    """The same filter in NumPy, as a machine without a compiler has it."""
    other = object.__new__(FilterKernel)  # copies of a kernel are the kernel itself
    other.__dict__.update(kernel.__dict__, library=None)
    return other


def assert_same(one: FilterPass, other: FilterPass) -> None:
    """Everything that two passes return is the same, to rounding."""
    assert one.failed_at == other.failed_at == -1
    for name, value in vars(one).items():
        if value is None:
            continue
        a, b = np.asarray(value), np.asarray(getattr(other, name))
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
# Two seas besides, of one axis both and of another one alone, one of each shape.
AUV_SEA = replace(
    AUV_NOISE,
    disturbances=(*AUV_FORCES, *AUV_FORCES[:2], AUV_FORCES[0]),
    variance=np.array([4.0, 0.3, 0.01, 2.0, 0.5, 1.0]) ** 2,
    time=np.array([1.5, 0.0, 3.0, 2.5, 2.5, 0.9]),
    damping=np.array([0.0, 0.0, 0.0, 0.15, 0.15, 0.4]),
    turn=np.array([0, 0, 0, -1, -1, 1]),
    sea=np.array([-1, -1, -1, 0, 0, 1]),
    phase=np.nan,
)
SEA_LEVELS = (
    *EVERY_LEVEL,
    (FORCE_TIME, -1),
    (SEA_VARIANCE, 0),
    (SEA_VARIANCE, 2),
    (SEA_PERIOD, 0),
    (SEA_DAMPING, 0),
    (SEA_PERIOD, 1),
    (SEA_DAMPING, 1),
)
AUV_WAVE = replace(AUV_SEA, phase=np.array([np.nan, np.nan, np.nan, 0.3, 2.0, np.nan]))
SHARED_TIMES = ((FORCE_VARIANCE, 1), (FORCE_TIME, -1), (COLOUR_VARIANCE, 1), (COLOUR_TIME, -1))


@pytest.mark.parametrize(
    ("noise", "levels"),
    [
        (AUV_NOISE, ()),
        (AUV_NOISE, EVERY_LEVEL),
        (AUV_NOISE, SHARED_TIMES),
        (AUV_SEA, ()),
        (AUV_SEA, SEA_LEVELS),
        (AUV_WAVE, (*SEA_LEVELS, (SEA_PHASE, 1))),
    ],
    ids=["none", "own", "shared", "seas", "levels of seas", "one wave"],
)
@pytest.mark.parametrize("longest_step", [None, 0.06], ids=["samples", "sub-steps"])
def test_compiled_filter_is_the_interpreted_one(
    noise: Disturbed, levels: tuple[tuple[int, int], ...], longest_step: float | None
) -> None:
    """Actuator and sensor memory, gaps, colours, seas and sub-steps: C and NumPy agree to 1e-9."""
    kernel = filter_kernel(disturbed_model(AUV, AUV_FORCES))
    if _compiler() is None:
        pytest.skip("no compiler")
    assert kernel.library is not None
    times, inputs, measured = auv_record()
    values = kernel.model.value_vector
    own = np.array([1.5, 0.02, 0.0, 0.05, 2.0])

    def run(filter_: FilterKernel) -> FilterPass:
        along = Along(times, inputs, values, own, measured, noise, longest_step=longest_step)
        return filter_.filter(
            along, names=("X_absuu",), levels=levels, rows=True, gains=True, moves=True
        )

    assert_same(run(kernel), run(interpreted(kernel)))


@pytest.mark.parametrize("noise", [AUV_NOISE, AUV_SEA], ids=["first order", "seas"])
@pytest.mark.parametrize("longest_step", [None, 0.06], ids=["samples", "sub-steps"])
def test_replay_repeats_the_filter_and_shows_what_a_value_changes(
    longest_step: float | None, noise: Disturbed
) -> None:
    """At the values of the pass the same innovations; at others the columns at frozen gain."""
    kernel = filter_kernel(disturbed_model(AUV, AUV_FORCES))
    times, inputs, measured = auv_record()
    values = kernel.model.value_vector
    own = np.array([1.5, 0.02, 0.0, 0.05, 2.0])
    step = 1e-5
    moved = values.copy()
    moved[kernel.model.parameter_names.index("X_absuu")] += step
    slopes = []
    for filter_ in (kernel, interpreted(kernel)):
        along = Along(times, inputs, values, own, measured, noise, longest_step=longest_step)
        found = filter_.filter(along, names=("X_absuu",), own_columns=False, rows=True, gains=True)
        assert found.gains is not None
        same, other = (
            filter_.replay(replace(along, values=at), found.gains) for at in (values, moved)
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
    own, active = np.array([0.1, 0.01]), active_components(kernel.model, model)
    # A kernel serves every model of its structure, whatever the values of the first were.
    values = kernel.model.with_values(SHIP.values).value_vector
    along = Along(times, inputs, values, own, measured, noise, active)
    levels = ((FORCE_VARIANCE, 0), (FORCE_TIME, -1), (WHITE_VARIANCE, 1))
    return kernel.filter(along, names=names, rows=True, levels=levels)


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
    return replace(noise, **{"phase": np.nan, **changes})  # type: ignore[arg-type]


def test_a_filter_of_all_candidates_serves_each_smaller_model() -> None:
    """With candidates absent, the filter that holds them is that of the model without them."""
    wide = filter_kernel(disturbed_model(SHIP + CANDIDATES, SHIP_FORCES))
    small = filter_kernel(disturbed_model(SHIP, SHIP_FORCES))
    assert len(active_components(wide.model, SHIP)) < wide.n_full
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
    along = Along(times, inputs, values, own, measured, noise, longest_step=0.2)
    return kernel.filter(along, **options)  # type: ignore[arg-type]


def remembered(
    noise: Disturbed, i: int, j: int, starts: np.ndarray, lengths: Sequence[float]
) -> np.ndarray:
    """Correlation of what acts over steps: the value at their start, of a sea the mean.

    That of a force of second order is as textbooks of vibration have it. Parts of one wave are sums
    of the force and its quadrature: of a displacement, and its rate with the sign turned; of a
    velocity, and the displacement.
    """
    age = np.subtract.outer(starts, starts)
    if noise.turn[j] == 0:
        return (i == j) * np.exp(-np.abs(age) / max(noise.time[j], 1e-9))
    same_wave = np.isfinite(noise.phase[[i, j]]).all() and noise.sea[i] == noise.sea[j]
    if i != j and not same_wave:
        return np.zeros(age.shape)
    z, frequency = noise.damping[j], 2 * np.pi / noise.time[j]
    root = np.sqrt(1 - z**2)

    def same(turn: float) -> Callable[[np.ndarray], np.ndarray]:
        def correlation(later: np.ndarray) -> np.ndarray:
            angle = frequency * np.abs(later)
            wave = np.cos(angle * root) + turn * z / root * np.sin(angle * root)
            return np.exp(-z * angle) * wave

        return correlation

    def across(later: np.ndarray) -> np.ndarray:
        """Of the force with its quadrature some time later: minus the slope of a displacement's."""
        angle = frequency * np.abs(later)
        return np.sign(later) * np.exp(-z * angle) * np.sin(angle * root) / root

    nodes, weights = np.polynomial.legendre.leggauss(12)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    points = np.add.outer(starts, np.zeros(12)) + np.outer(lengths, nodes)
    apart = np.subtract.outer(points, points)  # (step, node, step, node)

    def of_means(correlation: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        found = np.einsum("m,imjn,n->ij", weights, correlation(apart), weights)
        # Within a step the distance has a kink, which its own distribution has not.
        both = correlation(np.outer(lengths, nodes)) + correlation(-np.outer(lengths, nodes))
        np.fill_diagonal(found, both @ (weights * (1.0 - nodes)))
        return found

    force, quadrature = of_means(same(noise.turn[j])), of_means(same(-noise.turn[j]))
    # Row is a time, column another: of the column's quadrature with the row's force.
    mixed = of_means(lambda later: across(-later))
    one, other = np.sqrt(np.diag(force)), np.sqrt(np.diag(quadrature))
    force, quadrature = force / np.outer(one, one), quadrature / np.outer(other, other)
    mixed = mixed / np.outer(one, other)
    phase = np.nan_to_num(noise.phase[[i, j]])  # without one, a force of its own
    (c, d), (s, t) = np.cos(phase), np.sin(phase)
    return c * d * force + s * t * quadrature + c * t * mixed + s * d * mixed.T


def dense(noise: Disturbed) -> tuple[float, float]:
    """Log determinant and weighted square of all measurements, from their joint covariance."""
    covariance, residual, _ = joint(noise)
    determinant = float(np.linalg.slogdet(covariance)[1])
    return determinant, float(residual @ np.linalg.solve(covariance, residual))


def joint(noise: Disturbed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariance of all measurements, their residuals, covariance of the disturbances with them.

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
    covariance = np.zeros((len(full), len(full)))
    across = np.zeros((len(times) - 1, len(noise.disturbances), len(full)))
    columns = [full[:, :, SHIP_FORCES.index(name)] for name in noise.disturbances]
    size = np.sqrt(noise.variance)
    for (i, one), (j, other) in product(enumerate(columns), repeat=2):
        memory = size[i] * size[j] * remembered(noise, i, j, np.array(starts), lengths)
        covariance += one @ memory @ other.T
        across[:, i] += (memory @ other.T)[ends[:-1]]
    between = np.abs(np.subtract.outer(times, times))
    for i, output in enumerate(noise.coloured):
        coloured = noise.colour_variance[i] * np.exp(-between / noise.colour_time[i])
        covariance[output::2, output::2] += coloured
    covariance += np.diag(np.tile(noise.white, len(times)))
    residual = (measured - expected).ravel()
    seen = np.isfinite(residual)
    return covariance[np.ix_(seen, seen)], residual[seen], across[..., seen]


def ship_sea(turn: int = -1, phase: tuple[float, float] = (np.nan, np.nan)) -> Disturbed:
    """Two seas beside the forces: one in both places, one of the other shape on top of it.

    The first may be one wave, of which each place has a part with a phase.
    """
    return ship_noise(
        phase=np.array([np.nan, np.nan, *phase, np.nan]),
        disturbances=(*SHIP_FORCES, *SHIP_FORCES, SHIP_FORCES[0]),
        variance=np.array([0.02, 0.1, 0.03, 0.05, 0.02]) ** 2,
        time=np.array([1.0, 3.0, 2.5, 2.5, 6.0]),
        damping=np.array([0.0, 0.0, 0.12, 0.12, 0.3]),
        turn=np.array([0, 0, turn, turn, -turn]),
        sea=np.array([-1, -1, 0, 0, 1]),
    )


FORCES_AND_COLOURS = [
    ship_noise(time=np.array([1.0, time]), colour_variance=np.array([colour**2]))
    for time in (0.0, 0.3, 30.0)
    for colour in (0.0, 0.003)
]


SMOOTHED = [FORCES_AND_COLOURS[2], FORCES_AND_COLOURS[3], ship_sea(-1), ship_sea(1)]
WAVES = [ship_sea(-1, (0.0, 1.9)), ship_sea(1, (0.4, -1.1))]


# A colour that lasts for ever is the zero of a sensor.
ZERO = ship_noise(colour_variance=np.array([1e-4]), colour_time=np.array([np.inf]))


@pytest.mark.parametrize("noise", [*FORCES_AND_COLOURS, ZERO, ship_sea(-1), ship_sea(1), *WAVES])
def test_likelihood_is_that_of_the_joint_normal_distribution(noise: Disturbed) -> None:
    """On a linear model log determinant and square equal those of a dense covariance to 1e-8.

    So with narrow-band forces of both shapes, several of them in one place.
    """
    found = linear_pass(noise)
    determinant, square = dense(noise)
    assert found.log_variance == pytest.approx(determinant, rel=1e-8)
    assert found.square == pytest.approx(square, rel=1e-8)
    assert found.objective == pytest.approx(determinant + square, rel=1e-8)


@pytest.mark.parametrize("noise", [*SMOOTHED, *WAVES])
def test_smoothed_disturbances_are_those_of_the_joint_normal_distribution(noise: Disturbed) -> None:
    """Expectation and standard error of every disturbance equal those of conditioning at once."""
    found = linear_pass(noise, gains=True, moves=True)
    path = Path.of(found, len(noise.coloured), noise.n_second)
    covariance, residual, across = joint(noise)
    expected = across @ np.linalg.solve(covariance, residual)
    columns = found.innovations[:, :, None] * np.array([1.0, -3.0])
    smoothed = path.disturbances(columns)[:-1] / np.array([1.0, -3.0])
    tolerance = 1e-7 * np.abs(expected).max()
    np.testing.assert_allclose(smoothed, expected[..., None].repeat(2, axis=2), atol=tolerance)
    told = np.einsum("kjs,st,kjt->kj", across, np.linalg.inv(covariance), across)
    np.testing.assert_allclose(path.std[:-1], np.sqrt(noise.variance - told), rtol=1e-6)


@pytest.mark.parametrize("noise", [*SMOOTHED, *WAVES])
def test_departures_from_all_others_are_those_of_the_normal_distribution(noise: Disturbed) -> None:
    r"""With their joint covariance ``C`` it is :math:`(C^{-1} y)_i (C^{-1})_{ii}^{-1/2}`."""
    found = linear_pass(noise, gains=True, moves=True)
    covariance, residual, _ = joint(noise)
    inverse = np.linalg.inv(covariance)
    expected = inverse @ residual / np.sqrt(np.diag(inverse))
    seen = np.isfinite(found.innovations)
    np.testing.assert_allclose(interpolated(found, seen)[seen], expected, rtol=1e-7, atol=1e-9)


def test_responses_are_those_of_the_filter() -> None:
    """What is added to the states changes the innovations as the filter's own start does."""
    noise = ship_sea()
    found = linear_pass(noise, rows=True, gains=True, moves=True)
    path = Path.of(found, len(noise.coloured), noise.n_second)
    drive = np.zeros((*path.closed.shape[:2], 2))
    drive[0] = path.closed[0][:, :2]
    later = np.isfinite(found.innovations)
    later[0] = False
    expected = found.rows[:, :, :2][later]
    np.testing.assert_allclose(path.responses(drive)[later], expected, rtol=1e-9, atol=1e-12)


def test_filter_with_a_sea_is_a_textbook_kalman_filter() -> None:
    """Innovations and variances equal those of a plain NumPy filter with matrix exponentials."""
    noise = ship_noise(
        variance=np.array([4e-4, 0.0]), time=np.array([2.5, 1.0]),
        damping=np.array([0.12, 0.0]), turn=np.array([-1, 0]), sea=np.array([0, -1]),
        coloured=np.zeros(0, dtype=int), colour_variance=np.zeros(0), colour_time=np.zeros(0),
    )  # fmt: skip
    times, _, measured = linear_record()
    w, z = 2 * np.pi / 2.5, 0.12
    rows, q = np.array([[0.0, w], [-w, -2 * z * w]]), np.diag([0.0, 4 * z * w])
    mean, p = np.array([*START, 0.0, 0.0]), np.diag([0.0, 0.0, 4e-4, 4e-4])
    innovations, variances = np.full(measured.shape, np.nan), np.full(measured.shape, np.nan)
    for k, row in enumerate(measured):
        for i in np.flatnonzero(np.isfinite(row)):
            s = p[i, i] + noise.white[i]
            innovations[k, i], variances[k, i] = row[i] - mean[i], s
            gain = p[:, i] / s
            mean = mean + gain * innovations[k, i]
            p = p - np.outer(gain, gain) * s
        if k + 1 == len(times):
            break
        count = int(np.ceil((times[k + 1] - times[k]) / 0.2 - 1e-6))
        h = (times[k + 1] - times[k]) / count
        # Heading, rate, held force, held rudder.
        held = np.zeros((4, 4))
        held[0, 1], held[1, 1], held[1, 2], held[1, 3] = 1.0, -1 / TIME, 1.0, GAIN / TIME * 0.2
        held = expm(held * h)
        # Displacement and velocity of the sea, and the integral of the latter; their fresh noise
        # by Van Loan's (1978) exponential.
        wide = np.zeros((3, 3))
        wide[:2, :2], wide[2, 1] = rows, 1.0
        both = np.zeros((6, 6))
        both[:3, :3], both[3:, 3:], both[:2, 3:5] = -wide, wide.T, q
        both = expm(both * h)
        sea, fresh = both[3:, 3:].T, 4e-4 * both[3:, 3:].T @ both[:3, 3:]
        # What acts is the mean over the step, at the standard deviation of the level.
        turned = np.array([*sea[2, :2], np.sqrt(fresh[2, 2] / 4e-4)])
        size = np.linalg.norm(turned)
        move = np.zeros((4, 4))
        move[:2, :2], move[2:, 2:] = held[:2, :2], sea[:2, :2]
        move[:2, 2:] = np.outer(held[:2, 2], sea[2, :2]) / size
        into = np.zeros((4, 3))
        into[:2, 2], into[2:, :2] = held[:2, 2] / size, np.eye(2)
        for _ in range(count):
            mean = move @ mean + np.array([*held[:2, 3], 0.0, 0.0])
            p = move @ p @ move.T + into @ fresh @ into.T
    found = linear_pass(noise)
    seen = np.isfinite(measured)
    np.testing.assert_allclose(found.innovations[seen], innovations[seen], rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(found.variances[seen], variances[seen], rtol=1e-7)


LEVELS = (
    (FORCE_VARIANCE, 0),
    (FORCE_VARIANCE, 1),
    (FORCE_TIME, 0),
    (FORCE_TIME, -1),
    (WHITE_VARIANCE, 0),
    (COLOUR_VARIANCE, 0),
    (COLOUR_TIME, 0),
    (SEA_VARIANCE, 0),
    (SEA_VARIANCE, 2),
    (SEA_PERIOD, 0),
    (SEA_PERIOD, 1),
    (SEA_DAMPING, 0),
    (SEA_DAMPING, 1),
)
# Of one wave in both places besides: with the phase of the second.
LEVELS_AT_SEA = [(ship_sea(), LEVELS, one) for one in range(len(LEVELS))]
LEVELS_AT_SEA += [
    (WAVES[k], (*LEVELS, (SEA_PHASE, 1)), one) for k in (0, 1) for one in (7, 9, 11, 13)
]
NAMES = {
    SEA_PHASE: "phase",
    FORCE_VARIANCE: "variance",
    FORCE_TIME: "time",
    WHITE_VARIANCE: "white",
    COLOUR_VARIANCE: "colour_variance",
    COLOUR_TIME: "colour_time",
    SEA_VARIANCE: "variance",
    SEA_PERIOD: "time",
    SEA_DAMPING: "damping",
}
VARIANCES = (FORCE_VARIANCE, WHITE_VARIANCE, COLOUR_VARIANCE, SEA_VARIANCE)


def positions(noise: Disturbed, level: tuple[int, int]) -> np.ndarray:
    """Entries of an array of the noise that a level moves."""
    kind, index = level
    if kind in (SEA_VARIANCE, SEA_PHASE):
        return np.array([2 + index])
    if kind in (SEA_PERIOD, SEA_DAMPING):
        return np.flatnonzero(noise.sea == index)
    if kind == FORCE_TIME and index < 0:
        return np.flatnonzero(noise.sea < 0)
    return np.array([index])


def shifted(noise: Disturbed, level: tuple[int, int], by: float) -> Disturbed:
    """Noise with one variance moved by a share of itself, or one time by a factor."""
    array, where = getattr(noise, NAMES[level[0]]).copy(), positions(noise, level)
    if level[0] == SEA_PHASE:
        array[where] += by
    else:
        array[where] = array[where] * (1 + by if level[0] in VARIANCES else np.exp(by))
    return replace(noise, **{NAMES[level[0]]: array})


@pytest.mark.parametrize(("noise", "levels", "position"), LEVELS_AT_SEA)
def test_tangents_of_levels_are_exact_on_a_linear_model(
    noise: Disturbed, levels: tuple[tuple[int, int], ...], position: int
) -> None:
    """Slope of the likelihood, of every innovation and of its variance equal differences."""
    level, size = levels[position], 1e-4
    found = linear_pass(noise, levels=levels, rows=True)
    up, down = (linear_pass(shifted(noise, level, sign * size)) for sign in (1, -1))
    # Tangents are by the variance itself, differences by a share of it.
    own = getattr(noise, NAMES[level[0]])[positions(noise, level)]
    unit = own[0] if level[0] in VARIANCES else 1.0
    n_columns = found.gram.shape[0] - 1 - len(levels)
    slope = found.level_slope[position] + found.gram[n_columns + position, -1]
    expected = 0.5 * (up.objective - down.objective) / (2 * size * unit)
    assert slope == pytest.approx(expected, rel=1e-6)
    root = np.sqrt(found.variances)
    seen = np.isfinite(found.innovations)
    moved = (up.innovations - down.innovations) / (2 * size * unit) / root
    tangent = found.rows[:, :, n_columns + position]
    np.testing.assert_allclose(tangent[seen], moved[seen], atol=1e-6 * np.nanmax(np.abs(moved)))
    grown = np.log(up.variances / down.variances) / (2 * size * unit)
    q = found.rows[:, :, n_columns + len(levels) + position]
    np.testing.assert_allclose(q[seen], grown[seen], atol=1e-6 * np.abs(grown).max())
    assert found.level_information[position, position] == pytest.approx(
        0.5 * np.sum(grown[seen] ** 2), rel=1e-6
    )


def test_columns_are_exact_where_the_gain_does_not_move() -> None:
    """Derivatives by start states and by a gain that only scales the input equal differences."""
    noise = ship_noise(variance=np.array([4e-4, 0.0]))
    found = linear_pass(noise, names=("K", "T"), rows=True)
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
    kernel = filter_kernel(disturbed_model(SHIP + CANDIDATES, SHIP_FORCES))
    wild = kernel.model.with_values({"n3": 1e4}).value_vector
    times = np.arange(0.0, 40.0, 0.2)
    args = (times, np.full((200, 1), 1.0), wild, np.array([0.0, 3.0]))
    for one in (kernel, interpreted(kernel)):
        found = one.filter(Along(*args, np.full((200, 2), np.nan), ship_noise()))
        assert not found.ok
        assert 0 <= found.failed_at < 200
        assert found.objective == np.inf


def _levels(*, own_times: bool) -> Levels:
    noise = NoiseModel(
        white=np.array([0.1, 0.2]),
        colour=np.array([0.0, 0.3]),
        force=np.array([2.0, 5.0]),
        colour_time=np.array([1.0, 1.0]),
        force_time=np.array([1.0, 0.0]),
        outputs=("u", "q"),
        places=("force Z", "input ds"),
    )
    parts = ("colour", "force", "colour_time", "force_time")
    unit = replace(noise, **dict.fromkeys(parts, np.ones(2)))
    free = {"white": np.array([True, False]), "colour": np.array([False, True]), "force": True}
    return Levels.of(noise, unit, own_times=own_times, **free)


@pytest.mark.parametrize("own_times", [False, True])
@pytest.mark.parametrize("power", [1.0, -1.0])
def test_a_step_in_time_alone_keeps_to_the_curve(own_times: bool, power: float) -> None:
    """A force and a coloured sensor keep what their power says; white input noise stays."""
    levels = _levels(own_times=own_times)
    start = levels.vector()
    step = np.zeros(len(levels))
    names = list(levels.names)
    longer = [i for i, name in enumerate(names) if name.endswith("time")]
    step[longer] = 0.7
    # The straight part of that curve, d(sigma^2) = a sigma^2 d(ln tau), is part of the step.
    lasting = [names.index("force Z level"), names.index("colour of q level")]
    step[lasting] = 0.7 * power * start[lasting]
    moved = levels.moved(start, step, np.full(len(levels), power))
    noise, begin = levels.at(moved), levels.noise
    kept = noise.force[0] ** 2 / noise.force_time[0] ** power
    assert kept == pytest.approx(begin.force[0] ** 2 / begin.force_time[0] ** power)
    kept = noise.colour[1] ** 2 / noise.colour_time[1] ** power
    assert kept == pytest.approx(begin.colour[1] ** 2 / begin.colour_time[1] ** power)
    # What is white from step to step has no time.
    assert noise.force[1] == begin.force[1]


def test_small_steps_are_straight_to_second_order() -> None:
    """A step a tenth as long departs from the straight one a hundredth as much."""
    levels = _levels(own_times=False)
    start = levels.vector()
    rng = np.random.default_rng(0)
    step = rng.normal(size=len(levels)) * np.maximum(np.abs(start), 0.1)
    power = rng.uniform(-1.0, 1.0, len(levels))
    away = [
        float(np.abs(levels.moved(start, size * step, power) - (start + size * step)).max())
        for size in (1e-2, 1e-3)
    ]
    assert away[1] < 0.02 * away[0]


def test_what_ends_at_zero_gets_there_in_a_straight_step() -> None:
    """Where nothing of a level is left, the step stays straight; bounds do the rest."""
    levels = _levels(own_times=False)
    start = levels.vector()
    step = np.zeros(len(levels))
    step[0] = -1.5 * start[0]
    moved = levels.moved(start, step, np.ones(len(levels)))
    assert moved[0] == pytest.approx(-0.5 * start[0])


@pytest.mark.parametrize(("slope", "power"), [(1.0, 1.0), (-1.0, -1.0), (9.0, 2.0)])
def test_levels_follow_their_time_as_the_information_says(slope: float, power: float) -> None:
    """Of records that tell only ``sigma^2 tau^-a``, the power is ``a``, within its bounds."""
    levels = _levels(own_times=True)
    start = levels.vector()
    names = list(levels.names)
    level, time = names.index("force Z level"), names.index("force Z time")
    row = np.zeros(len(levels))
    row[level], row[time] = 1.0 / start[level], -slope
    information = np.outer(row, row) + 1e-9 * np.eye(len(levels))
    found = levels.following(information, start)
    assert found[level] == pytest.approx(power, rel=1e-6)
    assert np.count_nonzero(found) == 1


def test_without_forces_it_is_the_plain_simulation() -> None:
    """At level zero the record is that of the simulator with the same noise."""
    found = simulate_at_sea(ship(), DOUBLET, sea(0.0), rng=np.random.default_rng(1))
    plain = simulate(ship(), DOUBLET, rng=np.random.default_rng(1))
    np.testing.assert_allclose(found.outputs, plain.outputs, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.inputs, plain.inputs, atol=1e-12)


def test_yaw_rate_scatters_as_a_first_order_process_through_the_hull() -> None:
    """With linear damping the variance of the yaw rate is that of theory, within sampling error."""
    model = ship().with_values({"c": 0.0})
    quiet = replace(sea(0.01), white=np.array([1e-9, 1e-9]))
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
    waves = NoiseModel(
        white, np.zeros(5), np.array([0.3]), force_time=2.0,
        outputs=problem.model.output_names, places=("force M",),
    )  # fmt: skip
    records = [
        simulate_at_sea(problem.model, run, one, rng=np.random.default_rng(0))
        for one in (waves, replace(waves, force=np.array([1e-9])))
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
        simulate_at_sea(problem.model, run, one, rng=np.random.default_rng(0))
        for one in (quiet, replace(quiet, places=("actuator ds",), force_time=np.zeros(1)))
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
            sea=waves,
            rng=np.random.default_rng(0),
        )
        for waves in (None, sea(0.02))
    ]
    assert found[0].probability == 1.0
    assert found[1].probability < 0.8
    assert sum(found[1].left.values()) == 40 - found[1].n_kept
    assert "in waves (r 0.02 over 3 s)" in found[1].report()
