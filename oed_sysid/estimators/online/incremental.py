"""Incremental LS-SVM: the kernel matrix grows by one row, its inverse by bordering."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.linalg import solve_triangular

from oed_sysid.errors import ModelError, PrecisionWarning
from oed_sysid.estimators.baselines.ls_svm import KernelFunction, LinearKernel, check_weight

# Relative residual of the dual system above which the solution is announced as lost. Rounding
# leaves 1e-5 where three digits of the coefficients are right, and more than 1e-2 where none is.
LOST = 1e-3


class IncrementalLSSVM:
    r"""Least-squares support vector machine that learns one sample at a time.

    With :math:`\Gamma_t = K_t + I/C` and :math:`P_t = \Gamma_t^{-1}`, a new sample
    with :math:`W = k(X_t, x)` borders the inverse,

    .. math::
        P_{t+1} = \begin{bmatrix} P_t + gg^T/s & -g/s\\ -g^T/s & 1/s\end{bmatrix},
        \quad g = P_tW,\quad s = k(x,x) + 1/C - W^Tg .

    Time and memory of a step grow with the square of the samples kept: use a
    ``window``, or :class:`RecursiveLSSVM`, which has the same solution.

    Parameters
    ----------
    C : float
        Weight of the errors.
    kernel : callable, optional
        Linear by default.
    bias : bool
        Whether there is a constant.
    method : str
        ``"cholesky"`` appends a row to the triangular factor of
        :math:`\Gamma`, five digits more exact; ``"inverse"`` is the published
        recursion, whose digits may run out: it warns.
    window : int or None
        Largest number of samples kept; the oldest is dropped.
    refresh : int
        With ``"inverse"`` and a window: invert anew after this many drops, which
        keeps rounding errors from piling up.

    Warns
    -----
    PrecisionWarning
        Once, when the solution no longer solves its equations (:attr:`residual`): the
        published recursion multiplies rounding errors by :math:`\lVert P\rVert
        \lVert\Gamma\rVert`, which grows with ``C`` and with the square of the unit.

    References
    ----------
    Xu, Zou & Yin (2012), On-line identification of ship manoeuvring by
    incremental LS-SVM, J. Ship Mechanics 16(3); the drop of the oldest sample:
    Sayed (2003), Fundamentals of adaptive filtering, sec. 2.

    Examples
    --------
    >>> machine = IncrementalLSSVM(C=1e6)
    >>> machine.start([[0.0], [1.0]], [1.0, 3.0])
    >>> machine.update([2.0], 5.0)
    >>> print(machine.coefficients.round(4), round(machine.bias, 4))
    [2.] 1.0
    """

    def __init__(
        self,
        *,
        C: float = 3e4,
        kernel: KernelFunction | None = None,
        bias: bool = True,
        method: str = "cholesky",
        window: int | None = None,
        refresh: int = 20,
    ) -> None:
        check_weight(C)
        if method not in ("cholesky", "inverse"):
            raise ModelError(f"method is {method!r}. Choose cholesky or inverse.")
        if window is not None and window < 2:
            raise ModelError(f"window is {window}. Keep at least two samples.")
        self.C, self.bias_wanted, self.method = C, bias, method
        self.kernel = kernel or LinearKernel()
        self.window, self.refresh = window, refresh
        self._n = 0
        self._dropped = 0
        self._warned = False
        self._matrix = np.empty((0, 0))
        self._features = np.empty((0, 0))
        self._targets = np.empty(0)

    def start(self, features: np.ndarray, targets: np.ndarray) -> None:
        """Begin with some samples, features ``(n, n_features)`` and targets ``(n,)``."""
        features = np.atleast_2d(np.asarray(features, dtype=float))
        targets = np.asarray(targets, dtype=float).ravel()
        if len(features) != len(targets) or not len(targets):
            raise ModelError(
                f"Got {len(features)} features and {len(targets)} targets. Give one of each."
            )
        self._n = self._dropped = 0
        self._features = np.empty((0, features.shape[1]))
        self._targets = np.empty(0)
        self._matrix = np.empty((0, 0))
        for row, target in zip(features, targets, strict=True):
            self.update(row, target)

    def update(self, features: np.ndarray, target: float) -> None:
        """Learn one sample, features ``(n_features,)``."""
        row = np.asarray(features, dtype=float).ravel()
        if self._n == 0:
            self._features = np.empty((0, len(row)))
        self._reserve(len(row))
        border = self.kernel(self._features[: self._n], row[None])[:, 0]
        corner = float(self.kernel(row[None], row[None])[0, 0]) + 1.0 / self.C
        n = self._n
        if self.method == "inverse":
            inverse = self._matrix[:n, :n]
            g = inverse @ border
            s = corner - border @ g
            inverse += np.outer(g, g) / s
            self._matrix[n, :n] = self._matrix[:n, n] = -g / s
            self._matrix[n, n] = 1.0 / s
        else:
            lower = solve_triangular(self._matrix[:n, :n], border, lower=True, check_finite=False)
            # The last diagonal cannot fall below the ridge, whatever rounding says.
            self._matrix[n, :n] = lower
            self._matrix[n, n] = np.sqrt(max(corner - lower @ lower, 1.0 / self.C))
        self._features[n], self._targets[n] = row, float(target)
        self._n = n + 1
        if self.window is not None and self._n > self.window:
            self._drop_oldest()

    @property
    def n_samples(self) -> int:
        """Number of samples kept."""
        return self._n

    @property
    def bias(self) -> float:
        """The constant."""
        return self.solution()[1]

    @property
    def multipliers(self) -> np.ndarray:
        """Lagrange multipliers of the samples kept, shape ``(n_samples,)``."""
        return self.solution()[0]

    @property
    def coefficients(self) -> np.ndarray:
        """Coefficients of the features, shape ``(n_features,)``; linear kernel only."""
        if not isinstance(self.kernel, LinearKernel):
            raise ModelError("Only the linear kernel has coefficients. Use predict.")
        return self._features[: self._n].T @ self.multipliers

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Values ``(n,)`` at features ``(n, n_features)``."""
        multipliers, bias = self.solution()
        support = self._features[: self._n]
        return self.kernel(np.atleast_2d(features), support) @ multipliers + bias

    @property
    def residual(self) -> float:
        r"""How badly the solution solves its equations; rounding leaves 1e-11 or so.

        .. math::
            \max|K\alpha + \alpha/C + b - y| \,/\, \max|y|
        """
        multipliers, bias = self._solve()
        return self._residual(multipliers, bias)

    def solution(self) -> tuple[np.ndarray, float]:
        """Multipliers and bias, at the cost of one solution."""
        multipliers, bias = self._solve()
        if self.method == "inverse" and not self._warned:
            left = self._residual(multipliers, bias)
            if not left < LOST:
                self._warned = True
                warnings.warn(
                    f"The recursion of the inverse has lost its digits after {self._n} samples: "
                    f"its equations are met to {left:.1g} of the targets. Coefficients are not to "
                    "be believed. Use method='cholesky', RecursiveLSSVM, a smaller C or smaller "
                    "units.",
                    PrecisionWarning,
                    stacklevel=2,
                )
        return multipliers, bias

    def _residual(self, multipliers: np.ndarray, bias: float) -> float:
        support, targets = self._features[: self._n], self._targets[: self._n]
        if isinstance(self.kernel, LinearKernel):
            again = support @ (support.T @ multipliers)
        else:
            again = self.kernel(support, support) @ multipliers
        left = np.abs(again + multipliers / self.C + bias - targets).max()
        size = np.abs(targets).max()
        return float(left / size) if size > 0 else float(left)

    def _solve(self) -> tuple[np.ndarray, float]:
        if not self._n:
            raise ModelError("The machine has learnt nothing yet. Call start or update.")
        targets = self._targets[: self._n]
        columns = np.column_stack([targets, np.ones(self._n)])
        matrix = self._matrix[: self._n, : self._n]
        if self.method == "inverse":
            solved = matrix @ columns
        else:
            half = solve_triangular(matrix, columns, lower=True, check_finite=False)
            solved = solve_triangular(matrix.T, half, lower=False, check_finite=False)
        bias = float(solved[:, 0].sum() / solved[:, 1].sum()) if self.bias_wanted else 0.0
        return solved[:, 0] - bias * solved[:, 1], bias

    def _reserve(self, n_features: int) -> None:
        """Double the room when it is full, so that a step copies nothing on average."""
        if self._n < len(self._targets):
            return
        size = max(16, 2 * self._n)
        matrix = np.zeros((size, size))
        matrix[: self._n, : self._n] = self._matrix[: self._n, : self._n]
        features = np.zeros((size, n_features))
        features[: self._n] = self._features[: self._n]
        targets = np.zeros(size)
        targets[: self._n] = self._targets[: self._n]
        self._matrix, self._features, self._targets = matrix, features, targets

    def _drop_oldest(self) -> None:
        n = self._n
        old = self._matrix[:n, :n]
        if self.method == "inverse":
            kept = old[1:, 1:] - np.outer(old[1:, 0], old[0, 1:]) / old[0, 0]
        else:
            kept = _raised(old[1:, 1:], old[1:, 0])
        self._features[: n - 1] = self._features[1:n]
        self._targets[: n - 1] = self._targets[1:n]
        self._n = n - 1
        self._dropped += 1
        if self.method == "inverse" and self._dropped % self.refresh == 0:
            support = self._features[: n - 1]
            kept = np.linalg.inv(self.kernel(support, support) + np.eye(n - 1) / self.C)
        self._matrix[: n - 1, : n - 1] = kept


def _raised(factor: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Lower factor of ``factor factor' + vector vector'``."""
    both = np.vstack([factor.T, vector])
    upper = np.asarray(np.linalg.qr(both, mode="r"))
    signs = np.where(np.diag(upper) < 0, -1.0, 1.0)
    return (upper * signs[:, None]).T
