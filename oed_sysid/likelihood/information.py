"""What data say about unknowns: information, null directions, honest errors.

The information matrix is kept as the scaled triangular factor of the whitened
Jacobian. A direction the data do not see stays visible there, while an
inverted matrix would only show large numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import next_fast_len
from scipy.special import gammaincc

from oed_sysid.runtime.constants import RANK_TOLERANCE

# Residuals that count fewer independent samples than this share are autocorrelated.
COLOUR_LIMIT = 0.8
# Largest gain per sample of the recursion that is taken out of coloured residuals.
LONGEST_MEMORY = 0.97


@dataclass(frozen=True, eq=False)
class Information:
    """Fisher information of some unknowns, as a factor.

    Parameters
    ----------
    names : tuple of str
        Names of the unknowns.
    factor : ndarray (n_rows, n_unknowns)
        ``R`` with ``R' R`` the information of the *scaled* unknowns.
    scales : ndarray (n_unknowns,)
        Unknown = scale * scaled unknown.

    Examples
    --------
    >>> information = Information.from_jacobian(("a", "b"), np.diag([2.0, 0.5]))
    >>> information.std_errors.round(3)
    array([0.5, 2. ])
    """

    names: tuple[str, ...]
    factor: np.ndarray
    scales: np.ndarray

    @classmethod
    def from_jacobian(
        cls, names: Sequence[str], jacobian: np.ndarray, scales: np.ndarray | None = None
    ) -> Information:
        """Build from a whitened Jacobian ``(n_rows, n_unknowns)``."""
        n = len(names)
        scales = np.ones(n) if scales is None else np.asarray(scales, dtype=float)
        rows = np.asarray(jacobian, dtype=float)
        rows = rows.reshape(rows.size // n if n else 0, n) * scales
        factor = np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) >= n else rows
        return cls(tuple(names), factor, scales)

    @classmethod
    def from_matrix(
        cls, names: Sequence[str], matrix: np.ndarray, scales: np.ndarray | None = None
    ) -> Information:
        """Build from an information matrix ``(n_unknowns, n_unknowns)``."""
        scales = np.ones(len(names)) if scales is None else np.asarray(scales, dtype=float)
        scaled = np.asarray(matrix) * scales[:, None] * scales
        # Equilibrated first: the scales may be far from what the data say.
        size = np.sqrt(np.maximum(np.diag(scaled), 0.0))
        size = np.where(size > 0, size, 1.0)
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T) / size[:, None] / size)
        # Root of each eigenvalue times its vector: a factor where a Cholesky one would fail.
        factor = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * size
        return cls(tuple(names), factor, scales)

    @property
    def matrix(self) -> np.ndarray:
        """Information matrix of the unknowns, shape ``(n, n)``."""
        scaled = self.factor.T @ self.factor
        return scaled / self.scales[:, None] / self.scales

    @cached_property
    def _svd(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Column norms, singular values and right vectors of the equilibrated factor.

        And which of these directions the data see.
        """
        norms = np.linalg.norm(self.factor, axis=0)
        safe = np.where(norms > 0, norms, 1.0)
        _, values, vectors = np.linalg.svd(self.factor / safe, full_matrices=True)
        padded = np.zeros(len(self.names))
        padded[: len(values)] = values
        seen = padded > RANK_TOLERANCE * max(padded.max(initial=0.0), 1e-300)
        return safe, padded, vectors, seen

    @property
    def rank(self) -> int:
        """Number of directions that the data see."""
        return int(np.sum(self._svd[3]))

    @cached_property
    def covariance(self) -> np.ndarray:
        """Cramer-Rao bound, shape ``(n, n)``; infinite along null directions."""
        norms, values, vectors, seen = self._svd
        inner = vectors[seen].T * values[seen] ** -1.0
        covariance = inner @ inner.T
        scale = self.scales / norms
        covariance = covariance * scale[:, None] * scale
        # Whatever has a part in a direction that nothing sees is not known at all.
        blind = np.abs(vectors[~seen]).max(axis=0, initial=0.0) > 1e-6
        covariance[blind, :] = covariance[:, blind] = 0.0
        covariance[blind, blind] = np.inf
        return covariance

    @property
    def std_errors(self) -> np.ndarray:
        """Square roots of the bound's diagonal, shape ``(n,)``."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def log_determinant(self) -> float:
        """Natural logarithm of the determinant of the information; -inf when singular."""
        sign, value = np.linalg.slogdet(self.matrix)
        return float(value) if sign > 0 else -np.inf

    def __add__(self, other: Information) -> Information:
        """Information of two independent experiments on the same unknowns."""
        if other.names != self.names:
            raise ValueError("Only information on the same unknowns can be added.")
        # Stacked factors: their products, the information, add up.
        rows = np.vstack([self.factor, other.factor * (self.scales / other.scales)])
        return Information.from_jacobian(self.names, rows / self.scales, self.scales)

    def null_directions(self) -> tuple[str, ...]:
        """Name, in words, every combination of unknowns that the data do not see."""
        norms, _, vectors, seen = self._svd
        words = []
        for vector in vectors[~seen]:
            # Relative change of each unknown along the direction.
            change = vector / norms * self.scales
            share = np.abs(vector)
            members = [i for i in np.argsort(-share) if share[i] > 0.05]
            if len(members) == 1:
                words.append(f"{self.names[members[0]]} does not influence any output")
                continue
            lead = change[members[0]]
            ratios = ", ".join(f"{self.names[i]}: {change[i] / lead:+.3g}" for i in members)
            words.append(f"free to move together ({ratios})")
        return tuple(words)


def autocorrelation(series: np.ndarray, n_lags: int) -> np.ndarray:
    """Sample autocorrelation at lags ``0..n_lags``; missing samples are skipped.

    Returns
    -------
    ndarray (n_lags + 1,)
    """
    present = np.isfinite(series)
    centred = np.where(present, series - np.nanmean(series), 0.0)
    # Products of the mask with itself count the pairs, which gaps make fewer.
    pairs = np.maximum(np.round(lagged_products(present.astype(float), n_lags)), 1.0)
    covariance = lagged_products(centred, n_lags) / pairs
    return covariance / covariance[0] if covariance[0] > 0 else np.eye(1, n_lags + 1)[0]


def lagged_products(series: np.ndarray, n_lags: int) -> np.ndarray:
    """Sums of products of a series with itself at lags ``0..n_lags``, ``(n_lags + 1,)``."""
    # Twice the length, or the end would meet the beginning.
    size = 1 << int(np.ceil(np.log2(2 * len(series))))
    spectrum = np.fft.rfft(series, size)
    return np.fft.irfft(spectrum * spectrum.conj(), size)[: n_lags + 1]


def effective_sample_size(series: np.ndarray) -> float:
    """Number of independent samples that would average as well as this series.

    Uses the initial positive pair sums of the autocorrelation (Geyer 1992),
    never more than the number of samples.
    """
    series = [*own_samples([series])[0], series][0]
    n = int(np.isfinite(series).sum())
    if n < 8:
        return float(n)
    rho = autocorrelation(series, min(n - 1, max(20, n // 2)))
    pairs = rho[1:-1:2] + rho[2::2]
    negative = np.flatnonzero(pairs <= 0)
    total = float(np.sum(pairs[: negative[0] if len(negative) else len(pairs)]))
    # The first lag counts even when the first pair sum is negative.
    total = max(total, float(min(rho[1], 0.0)))
    return float(np.clip(n / max(1.0 + 2.0 * total, 1e-12), 1.0, n))


def counted_samples(
    residuals: Iterable[np.ndarray], fewest: int = 20
) -> Iterator[tuple[np.ndarray, float]]:
    """Samples of every output and record with more than some, and how many are independent.

    Of fewer the correlation cannot be estimated.
    """
    for column in (column for residual in residuals for column in residual.T):
        seen = column[np.isfinite(column)]
        if len(seen) > fewest:
            yield seen, effective_sample_size(column)


@dataclass(frozen=True)
class Whiteness:
    """Portmanteau test of one series.

    Attributes
    ----------
    statistic, p_value : float
        Ljung-Box statistic and its probability if the series were white.
    lag_one : float
        Autocorrelation at lag one.
    effective_samples, n_samples : float, int
        See :func:`effective_sample_size`.
    """

    statistic: float
    p_value: float
    lag_one: float
    effective_samples: float
    n_samples: int

    @property
    def is_white(self) -> bool:
        """Whether whiteness is not rejected at one in a thousand."""
        return self.p_value > 1e-3


def own_samples(series: Sequence[np.ndarray]) -> tuple[list[np.ndarray], int]:
    """Rows at which a sensor slower than the records can have sampled, and their stride.

    Series with fewer than two samples are left out.
    """
    rows = [np.flatnonzero(np.isfinite(one)) for one in series]
    steps = [np.diff(one) for one in rows if len(one) > 1]
    if not steps:
        return [], 1
    stride = int(np.gcd.reduce(np.concatenate(steps)))
    parts = [one[own[0] :: stride] for one, own in zip(series, rows, strict=True) if len(own) > 1]
    return parts, stride


def whiteness(series: np.ndarray, n_lags: int = 20) -> Whiteness:
    """Test a residual series for whiteness (Ljung & Box 1978).

    Lags count samples of the sensor itself, which may be slower than the record.
    """
    series = [*own_samples([series])[0], series][0]
    n = int(np.isfinite(series).sum())
    n_lags = min(n_lags, max(1, n // 5))
    rho = autocorrelation(series, n_lags)
    # rho has the number of pairs as divisor, not the number of samples as theirs has.
    statistic = (n + 2) / n * float(np.sum(rho[1:] ** 2 * (n - np.arange(1, n_lags + 1))))
    return Whiteness(
        statistic,
        float(gammaincc(n_lags / 2, statistic / 2)),
        float(rho[1]),
        effective_sample_size(series),
        n,
    )


def coloured_score_covariance(
    jacobians: Sequence[np.ndarray],
    residuals: Sequence[np.ndarray],
    *,
    lags: int | None = None,
) -> np.ndarray:
    """Covariance of ``J' r`` when the residuals ``r`` are stationary but coloured.

    The autocovariances of all pairs of outputs are estimated from the
    residuals themselves, tapered by a trapezoid where they fade into
    estimation noise (Politis & Romano 1995), and carried through the Jacobian.
    This is the middle of a sandwich covariance; it needs far fewer samples
    than a heteroscedasticity-consistent one, because the noise does not depend
    on the manoeuvre.

    Parameters
    ----------
    jacobians : sequence of ndarray (n_times, n_outputs, n_unknowns)
        In units of the noise, zero rows where nothing was measured.
    residuals : sequence of ndarray (n_times, n_outputs)
        In units of the noise, NaN where nothing was measured; sampled alike.
    lags : int, optional
        Samples over which autocovariances are kept, at most a quarter of the shortest record; by
        default until they fade.

    Returns
    -------
    ndarray (n_unknowns, n_unknowns)
        Positive semidefinite.
    """
    n_unknowns = jacobians[0].shape[2]
    total = np.zeros((n_unknowns, n_unknowns))
    colour = _Colour(residuals, lags)
    for jacobian in jacobians:
        # Twice the length: a colour with memory must not wrap around.
        size = next_fast_len(2 * len(jacobian) + len(colour.covariance), real=True)
        values, vectors = np.linalg.eigh(colour.spectrum(size))
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        # A convolution in time is a product in frequency.
        rows = root.conj().transpose(0, 2, 1) @ np.fft.rfft(jacobian, size, axis=0)
        # All frequencies but zero (and the last, if the size is even) occur twice.
        twice = np.full(len(rows), 2.0)
        twice[[0, -1] if size % 2 == 0 else [0]] = 1.0
        rows = (rows * np.sqrt(twice / size)[:, None, None]).reshape(-1, n_unknowns)
        total += (rows.conj().T @ rows).real
    return total


class _Colour:
    """Spectrum of residuals: a first-order recursion, and what it leaves, tapered.

    Taking the recursion out first (Andrews & Monahan 1992) leaves little for
    the taper to spoil, so that slow residuals need fewer samples.
    """

    def __init__(self, residuals: Sequence[np.ndarray], lags: int | None = None) -> None:
        rough = _lagged_covariance(residuals, 1)
        a = _stable(rough[1].T @ np.linalg.pinv(rough[0], rcond=1e-8))
        whiter = [r[1:] - r[:-1] @ a.T for r in residuals]
        n_left = sum(int(np.isfinite(w).sum()) for w in whiter)
        if n_left <= 0.5 * sum(int(np.isfinite(r).sum()) for r in residuals):
            # Too many gaps for differences between neighbours.
            a, whiter = np.zeros_like(a), list(residuals)
        longest = max(2, min(len(residual) for residual in whiter) // 4)
        if lags is None:
            # Where the slowest output's correlation has faded, times a margin.
            faded = max([1.0, *(len(seen) / some for seen, some in counted_samples(whiter))])
            lags = int(4 * faded)
        lags = min(lags, longest)
        # Flat over half the lags, then a straight line to zero.
        taper = np.minimum(1.0, 2.0 * (1.0 - np.arange(lags + 1) / (lags + 1.0)))
        # Through the covariances of the residuals themselves, so that no sample is lost to a gap.
        own = _lagged_covariance(residuals, lags + 1)
        before = np.concatenate([own[1:2].transpose(0, 2, 1), own[:lags]])
        # Covariance of r(t) - A r(t - 1), from those of r.
        left = own[:-1] - before @ a.T - a @ own[1:] + a @ own[:-1] @ a.T
        self.recursion, self.covariance = a, left * taper[:, None, None]

    def spectrum(self, size: int) -> np.ndarray:
        """Cross spectra at the frequencies of a real transform, ``(n, m, m)``."""
        one_sided = np.fft.rfft(self.covariance, size, axis=0).conj()
        left = one_sided + one_sided.conj().transpose(0, 2, 1) - self.covariance[0]
        turn = np.exp(-2j * np.pi * np.arange(len(left)) / size)
        filtered = np.eye(len(self.recursion)) - turn[:, None, None] * self.recursion
        inverse = np.linalg.inv(filtered)
        return inverse @ left @ inverse.conj().transpose(0, 2, 1)


def _stable(recursion: np.ndarray) -> np.ndarray:
    """Shrink a recursion that remembers for longer than a record can tell."""
    left, values, right = np.linalg.svd(recursion)
    return (left * np.minimum(values, LONGEST_MEMORY)) @ right


def _lagged_covariance(residuals: Sequence[np.ndarray], lags: int) -> np.ndarray:
    """``E[r_i(t) r_j(t + lag)]`` over all records, shape ``(lags + 1, n, n)``."""
    n_outputs = residuals[0].shape[1]
    sums = np.zeros((lags + 1, n_outputs, n_outputs))
    counts = np.zeros_like(sums)
    for residual in residuals:
        present = np.isfinite(residual).astype(float)
        filled = np.where(present > 0, residual, 0.0)
        for lag in range(min(lags, len(filled) - 1) + 1):
            stop = len(filled) - lag
            sums[lag] += filled[:stop].T @ filled[lag:]
            counts[lag] += present[:stop].T @ present[lag:]
    return sums / np.maximum(counts, 1.0)
