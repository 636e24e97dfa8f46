"""Recursive least squares in the size of the features: the same cost at every sample."""

from __future__ import annotations

from collections import deque

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.estimators.baselines.ls_svm import check_weight


class RecursiveLSSVM:
    r"""The linear LS-SVM, bias included, as an exact recursion of flat cost.

    The primal normal matrix of :math:`z = (x, 1)`,
    :math:`A_t = \sum zz^T + \mathrm{diag}(I/C, 0)`, changes by one outer product
    per sample, and so does its inverse ``S``:

    .. math:: k = \frac{Sz}{1 + z^TSz},\quad
              \theta \leftarrow \theta + k\,(y - z^T\theta),\quad S \leftarrow S - k\,(z^TS).

    It starts after the first sample, where the bias row gets its first one.
    With a ``window`` the matrix itself is kept, the sample that leaves is
    subtracted from it, and the system is solved when asked for: subtracting
    from the inverse loses digits at every step.

    Parameters
    ----------
    C : float
        Weight of the errors.
    window : int or None
        Number of latest samples to learn from; all by default.

    Notes
    -----
    Equal to the batch solution: with :math:`\Gamma = XX^T + I/C` and
    :math:`w = X^T\alpha`, the condition :math:`1^T\alpha = 0` is the bias row of
    ``A``, and :math:`X^T(y - 1b) = (X^TX + I/C)\,w` the others.

    References
    ----------
    Sherman & Morrison (1950), Ann. Math. Statist. 21, for the update; Xu, Zou &
    Yin (2012), J. Ship Mechanics 16(3), for the problem that it solves.

    Examples
    --------
    >>> machine = RecursiveLSSVM(C=1e6)
    >>> machine.start([[0.0], [1.0]], [1.0, 3.0])
    >>> machine.update([2.0], 5.0)
    >>> print(machine.coefficients.round(4), round(machine.bias, 4))
    [2.] 1.0
    """

    def __init__(self, *, C: float = 3e4, window: int | None = None) -> None:
        check_weight(C)
        if window is not None and window < 2:
            raise ModelError(f"window is {window}. Keep at least two samples.")
        self.C, self.window = C, window
        self._inverse: np.ndarray | None = None
        self._normal: np.ndarray | None = None
        self._moment = np.empty(0)
        self._values = np.empty(0)
        self._kept: deque[tuple[np.ndarray, float]] = deque()
        self.n_samples = 0

    def start(self, features: np.ndarray, targets: np.ndarray) -> None:
        """Begin with some samples, features ``(n, n_features)`` and targets ``(n,)``."""
        self._inverse = self._normal = None
        self._kept.clear()
        self.n_samples = 0
        for row, target in zip(
            np.atleast_2d(np.asarray(features, float)), np.ravel(targets), strict=True
        ):
            self.update(row, float(target))

    def update(self, features: np.ndarray, target: float) -> None:
        """Learn one sample, features ``(n_features,)``."""
        x = np.asarray(features, dtype=float)
        z = np.empty(x.size + 1)
        z[:-1] = x
        z[-1] = 1.0
        self.n_samples += 1
        if self.window is not None:
            self._slide(z, target)
        elif self._inverse is None:
            self._begin(z, target)
        else:
            gain = self._inverse @ z
            share = 1.0 / (1.0 + z @ gain)
            self._values += gain * ((target - z @ self._values) * share)
            # Exactly symmetric, or rounding errors grow.
            self._inverse -= share * np.outer(gain, gain)

    def _slide(self, z: np.ndarray, target: float) -> None:
        """Add one sample to the normal equations and take the oldest away."""
        if self._normal is None:
            self._normal = np.diag(np.append(np.full(z.size - 1, 1.0 / self.C), 0.0))
            self._moment = np.zeros(z.size)
        self._normal += np.outer(z, z)
        self._moment += z * target
        self._kept.append((z, target))
        if len(self._kept) > (self.window or 0):
            old, old_target = self._kept.popleft()
            self._normal -= np.outer(old, old)
            self._moment -= old * old_target
            self.n_samples -= 1

    def _begin(self, z: np.ndarray, target: float) -> None:
        """State after one sample: no slope yet, and a bias equal to the target.

        ``A = zz' + diag(I/C, 0)`` has the inverse
        ``[[C I, -C x], [-C x', 1 + C x'x]]``.
        """
        x = z[:-1]
        inverse = np.empty((z.size, z.size))
        inverse[:-1, :-1] = self.C * np.eye(x.size)
        inverse[:-1, -1] = inverse[-1, :-1] = -self.C * x
        inverse[-1, -1] = 1.0 + self.C * (x @ x)
        self._inverse = inverse
        self._values = np.zeros(z.size)
        self._values[-1] = target

    def solution(self) -> tuple[np.ndarray, float]:
        """Coefficients and bias, at the cost of one solution."""
        if self._normal is not None:
            scale = 1.0 / np.sqrt(np.diag(self._normal))
            scaled = self._normal * scale[:, None] * scale
            values = scale * np.linalg.solve(scaled, scale * self._moment)
        elif self._inverse is not None:
            values = self._values
        else:
            raise ModelError("The machine has learnt nothing yet. Call start or update.")
        return values[:-1].copy(), float(values[-1])

    @property
    def coefficients(self) -> np.ndarray:
        """Coefficients of the features, shape ``(n_features,)``."""
        return self.solution()[0]

    @property
    def bias(self) -> float:
        """The constant."""
        return self.solution()[1]

    @property
    def inverse(self) -> np.ndarray:
        """Inverse of the normal matrix of ``[features, 1]``.

        Times the variance of the errors it is the covariance of the estimates.
        """
        self.solution()
        if self._normal is not None:
            return np.linalg.inv(self._normal)
        assert self._inverse is not None
        return self._inverse.copy()

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Values ``(n,)`` at features ``(n, n_features)``."""
        coefficients, bias = self.solution()
        return np.atleast_2d(features) @ coefficients + bias


class RecursiveLeastSquares:
    r"""Least squares with exponential forgetting, for parameters that drift.

    A sample that is ``n`` samples old counts :math:`\lambda^n`.

    Parameters
    ----------
    values : ndarray (n_features,)
        Start values.
    std : float or ndarray (n_features,)
        How uncertain they are, in units of the errors.
    forgetting : float
        :math:`\lambda`, at most 1; the memory is about ``1/(1 - forgetting)``
        samples.
    largest_std : float
        The inverse normal matrix is kept below its square: without excitation
        forgetting would let it grow without limit.

    References
    ----------
    Ljung (1999), System identification: theory for the user, sec. 11.2.

    Examples
    --------
    >>> filter = RecursiveLeastSquares(np.zeros(1), std=1e3, forgetting=0.98)
    >>> for k in range(200):
    ...     filter.update([1.0], 1.0 if k < 100 else 2.0)
    >>> print(filter.coefficients.round(2))
    [1.88]
    """

    def __init__(
        self,
        values: np.ndarray,
        *,
        std: float | np.ndarray = 1e6,
        forgetting: float = 1.0,
        largest_std: float = 1e9,
    ) -> None:
        if not 0 < forgetting <= 1:
            raise ModelError(f"forgetting is {forgetting}. Give a factor above 0, at most 1.")
        self._values = np.array(values, dtype=float).ravel()
        spread = np.broadcast_to(np.asarray(std, dtype=float), self._values.shape)
        self._inverse = np.diag(spread**2)
        self.forgetting, self.largest_std = forgetting, largest_std
        self.n_samples = 0

    def start(self, features: np.ndarray, targets: np.ndarray) -> None:
        """Learn some samples, features ``(n, n_features)`` and targets ``(n,)``."""
        for row, target in zip(
            np.atleast_2d(np.asarray(features, float)), np.ravel(targets), strict=True
        ):
            self.update(row, float(target))

    def update(self, features: np.ndarray, target: float) -> None:
        """Learn one sample, features ``(n_features,)``."""
        x = np.asarray(features, dtype=float)
        gain = self._inverse @ x
        share = 1.0 / (self.forgetting + x @ gain)
        self._values += gain * ((target - x @ self._values) * share)
        # Exactly symmetric, or forgetting lets rounding errors grow.
        self._inverse -= share * np.outer(gain, gain)
        if self.forgetting < 1:
            self._inverse /= self.forgetting
            excess = np.trace(self._inverse) / (len(x) * self.largest_std**2)
            if excess > 1:
                self._inverse /= excess
        self.n_samples += 1

    @property
    def coefficients(self) -> np.ndarray:
        """Present values, shape ``(n_features,)``."""
        return self._values.copy()

    @property
    def inverse(self) -> np.ndarray:
        """Times the variance of errors, the covariance of the estimates."""
        return self._inverse.copy()

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Values ``(n,)`` at features ``(n, n_features)``."""
        return np.atleast_2d(features) @ self._values
