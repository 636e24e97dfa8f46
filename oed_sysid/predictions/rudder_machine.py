r"""A rudder that follows its order at a limited rate and angle, fitted to a logged rudder.

.. math::
    w_k = \Phi_k \beta, \qquad
    \delta_k = \mathrm{clip}\big(\mathrm{clip}(w_k, \pm\delta_\mathrm{max}),\;
        \delta_{k-1} \pm \dot\delta_\mathrm{max} (t_k - t_{k-1})\big) ,

with the regressors :math:`\Phi` of the law. :math:`\beta`, the first rudder, the rate and the
limit make the sum of squares of logged minus followed rudder least. Standard errors are raised by
:math:`\sqrt{(1 + \rho) / (1 - \rho)}` for residuals with the correlation :math:`\rho` from sample
to sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

# Residuals below this are rounding, rad.
LEAST_RESIDUAL = 1e-6


@dataclass(frozen=True, eq=False)
class Followed:
    """Logged rudder, explained.

    Attributes
    ----------
    law : ndarray (n_regressors,)
        Coefficients of the order.
    first, rate, limit : float
        First rudder, rad; largest rate, rad/s, and angle, rad, or inf.
    covariance : ndarray (n_regressors + 2, n_regressors + 2)
        Of the law, the rate and the limit; zero for those that are not fitted.
    residuals : ndarray (n_times,)
        Logged minus followed rudder, rad.
    """

    law: np.ndarray
    first: float
    rate: float
    limit: float
    covariance: np.ndarray = field(repr=False)
    residuals: np.ndarray = field(repr=False)

    @property
    def squares(self) -> float:
        """Sum of squares of the residuals, those of rounding included."""
        return float((self.residuals**2).sum()) + len(self.residuals) * LEAST_RESIDUAL**2

    @property
    def n_parameters(self) -> int:
        """How many numbers were fitted."""
        return len(self.law) + 1 + math.isfinite(self.rate) + math.isfinite(self.limit)

    @property
    def memory(self) -> float:
        """Correlation of the residuals from sample to sample."""
        return correlation(self.residuals)

    def criterion(self, n_changes: int = 0) -> float:
        """Bayesian information criterion; each time of a change is one more number."""
        n = len(self.residuals)
        return n * math.log(self.squares / n) + (self.n_parameters + n_changes) * math.log(n)


def follow(
    orders: np.ndarray, times: np.ndarray, first: float, rate: float, limit: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rudder that follows orders.

    Returns
    -------
    rudder : ndarray (n_times,)
        rad.
    origin : ndarray of int (n_times,)
        Sample at which the rudder last was where it was ordered; -1 where not yet.
    moved : ndarray (n_times,)
        Time at the largest rate since then, with its sign, s.
    """
    wanted = np.clip(orders, -limit, limit)
    if math.isinf(rate):
        rudder = wanted.copy()
        rudder[0] = first
        origin = np.arange(len(times))
        origin[0] = -1
        return rudder, origin, np.zeros(len(times))
    reached, origins, moved = [first], [-1], [0.0]
    last, since, total = first, -1, 0.0
    steps = np.diff(times).tolist()
    for k, (order, step) in enumerate(zip(wanted[1:].tolist(), steps, strict=True), start=1):
        change = order - last
        if abs(change) <= rate * step:
            last, since, total = order, k, 0.0
        else:
            ahead = math.copysign(step, change)
            last, total = last + rate * ahead, total + ahead
        reached.append(last)
        origins.append(since)
        moved.append(total)
    return np.array(reached), np.array(origins), np.array(moved)


def fit_machine(
    regressors: np.ndarray,
    times: np.ndarray,
    rudder: np.ndarray,
    *,
    law: np.ndarray,
    rate: float = math.inf,
    limit: float = math.inf,
    first: float | None = None,
    n_steps: int = 60,
) -> Followed:
    """Fit law, first rudder and, where they are finite, rate and limit to a logged rudder.

    Parameters
    ----------
    regressors : ndarray (n_times, n_regressors)
        The order is their product with the law.
    times, rudder : ndarray (n_times,)
        s and rad.
    law : ndarray (n_regressors,)
        Start values.
    rate, limit : float
        Start values, rad/s and rad; inf where there is none.
    first : float, optional
        Start value, rad; the first sample by default.
    n_steps : int
        Most evaluations.
    """
    n = regressors.shape[1]
    rated, limited = math.isfinite(rate), math.isfinite(limit)

    def parts(values: np.ndarray) -> tuple[np.ndarray, float, float, float]:
        """Law, first rudder, rate and limit."""
        more = list(values[n + 1 :])
        allowed = abs(more.pop(0)) if rated else math.inf
        return values[:n], float(values[n]), allowed, abs(more.pop(0)) if limited else math.inf

    def errors(values: np.ndarray) -> np.ndarray:
        beta, begin, allowed, most = parts(values)
        return follow(regressors @ beta, times, begin, allowed, most)[0] - rudder

    def slopes(values: np.ndarray) -> np.ndarray:
        beta, begin, allowed, most = parts(values)
        orders = regressors @ beta
        _, origin, moved = follow(orders, times, begin, allowed, most)
        free = (origin >= 0) & (np.abs(orders[origin]) < most)
        table = np.zeros((len(times), len(values)))
        table[:, :n] = regressors[origin] * free[:, None]
        table[:, n] = origin < 0
        if rated:
            table[:, n + 1] = moved
        if limited:
            table[:, -1] = np.sign(orders[origin]) * ((origin >= 0) & ~free)
        return table

    start = [*law, rudder[0] if first is None else first]
    start += [rate] * rated + [limit] * limited
    found = least_squares(errors, start, jac=slopes, x_scale="jac", max_nfev=n_steps)
    beta, begin, allowed, most = parts(found.x)
    whole = _covariance(found.jac, found.fun)
    position = [*range(n)]
    covariance = np.zeros((n + 2, n + 2))
    into = [*range(n)]
    if rated:
        position.append(n + 1)
        into.append(n)
    if limited:
        position.append(len(found.x) - 1)
        into.append(n + 1)
    covariance[np.ix_(into, into)] = whole[np.ix_(position, position)]
    return Followed(beta, begin, allowed, most, covariance, -found.fun)


def _covariance(jacobian: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """Covariance of least squares with correlated residuals."""
    count = jacobian.shape[1]
    size = np.sqrt((jacobian**2).sum(axis=0))
    size = np.where(size > 0, size, 1.0)
    scaled = jacobian / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    return variance(residuals, count) * inverse / np.outer(size, size)


def variance(residuals: np.ndarray, n_parameters: int) -> float:
    """Variance of residuals, raised as if fewer of them were independent: AR(1)."""
    n = len(residuals)
    whole = float((residuals**2).sum()) / max(n - n_parameters, 1)
    memory = np.clip(correlation(residuals), 0.0, 0.95)
    return whole * float((1 + memory) / (1 - memory))


def correlation(residuals: np.ndarray) -> float:
    """Correlation of residuals from sample to sample."""
    size = float((residuals**2).sum())
    return float(residuals[1:] @ residuals[:-1]) / size if size > 0 else 0.0
