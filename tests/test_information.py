"""Information against dense linear algebra, series statistics against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from oed_sysid.likelihood.information import (
    Information,
    autocorrelation,
    coloured_score_covariance,
    effective_sample_size,
    whiteness,
)

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
    white = rng.standard_normal((n + 500, columns)) * np.sqrt(1 - memory**2)
    return lfilter([1.0], [1.0, -memory], white, axis=0)[500:]


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
