"""Estimation on board: one sample at a time, at a known cost per sample.

============================  ========================================================
:class:`IncrementalLSSVM`     LS-SVM grown by one sample by the bordering recursion
:class:`RecursiveLSSVM`       the same solution in the size of the features, flat cost
:class:`RecursiveLeastSquares`  with exponential forgetting
:class:`EquationStream`       from a model and samples to features and targets
:class:`KalmanStream`         states and parameters together, by Kalman filter
:class:`OnlineRegression`     all of this behind the interface of the estimators
============================  ========================================================
"""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from oed_sysid.baselines.equations import (
    SPANS,
    WINDOW,
    Rates,
    RegressionForm,
    Rows,
    check_rule,
    regression_form,
    rows_from,
    states_of,
)
from oed_sysid.baselines.kalman import JointFilter, JointKalmanFilter
from oed_sysid.baselines.regression import (
    Regression,
    RegressionEstimator,
    SeparateSolution,
    separate,
)
from oed_sysid.baselines.support_vectors import (
    WEIGHT,
    KernelFunction,
    LinearKernel,
    check_weight,
)
from oed_sysid.errors import ModelError, PrecisionWarning
from oed_sysid.likelihood.estimator import check_choice
from oed_sysid.likelihood.noise_levels import given_levels
from oed_sysid.likelihood.start_guess import measured_columns
from oed_sysid.physics.model import Model


class OnlineMachine:
    """What machines on board have in common: they learn samples and say what these amount to."""

    def update(self, features: np.ndarray, target: float) -> None:
        """Learn one sample, features ``(n_features,)``."""
        raise NotImplementedError

    def linear(self) -> tuple[np.ndarray, float]:
        """Coefficients ``(n_features,)`` and bias, at the cost of one solution."""
        raise NotImplementedError

    def forget(self) -> None:
        """Forget all samples, where a batch is a beginning."""

    def start(self, features: np.ndarray, targets: np.ndarray) -> None:
        """Begin with some samples, features ``(n, n_features)`` and targets ``(n,)``."""
        features = np.atleast_2d(np.asarray(features, dtype=float))
        targets = np.asarray(targets, dtype=float).ravel()
        if len(features) != len(targets) or not len(targets):
            raise ModelError(
                f"Got {len(features)} features and {len(targets)} targets. Give one of each."
            )
        self.forget()
        for row, target in zip(features, targets, strict=True):
            self.update(row, float(target))

    @property
    def coefficients(self) -> np.ndarray:
        """Coefficients of the features, shape ``(n_features,)``."""
        return self.linear()[0]

    @property
    def bias(self) -> float:
        """The constant."""
        return self.linear()[1]

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Values ``(n,)`` at features ``(n, n_features)``."""
        coefficients, bias = self.linear()
        return np.atleast_2d(features) @ coefficients + bias


def check_window(window: int | None) -> None:
    """Raise :class:`ModelError` for a window of fewer than two samples."""
    if window is not None and window < 2:
        raise ModelError(f"window is {window}. Keep at least two samples.")


def learn(
    values: np.ndarray, inverse: np.ndarray, row: np.ndarray, target: float, forgetting: float = 1.0
) -> None:
    r"""Add one row to least squares, in place: values ``(n,)`` and inverse normal matrix.

    .. math:: k = \frac{Sz}{\lambda + z^TSz},\quad
              \theta \leftarrow \theta + k\,(y - z^T\theta),\quad S \leftarrow S - k\,(z^TS)
    """
    gain = inverse @ row
    share = 1.0 / (forgetting + row @ gain)
    values += gain * ((target - row @ values) * share)
    # Exactly symmetric, or rounding errors grow.
    inverse -= share * np.outer(gain, gain)


class RecursiveLSSVM(OnlineMachine):
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

    def __init__(self, *, C: float = WEIGHT, window: int | None = None) -> None:
        check_weight(C)
        check_window(window)
        self.C, self.window = C, window
        self.forget()

    def forget(self) -> None:
        """Forget all samples."""
        self._inverse: np.ndarray | None = None
        self._normal: np.ndarray | None = None
        self._moment = self._values = np.empty(0)
        self._kept: deque[tuple[np.ndarray, float]] = deque()
        self.n_samples = 0

    def update(self, features: np.ndarray, target: float) -> None:
        """Learn one sample, features ``(n_features,)``."""
        z = np.append(np.asarray(features, dtype=float), 1.0)
        self.n_samples += 1
        if self.window is not None:
            self._slide(z, target, self.window)
        elif self._inverse is None:
            # No slope yet: A = zz' + diag(I/C, 0) has this inverse, and the bias is the target.
            x, slopes = z[:-1], self.C * np.eye(z.size - 1)
            corner = 1.0 + self.C * (x @ x)
            self._inverse = np.block([[slopes, -self.C * x[:, None]], [-self.C * x, corner]])
            self._values = np.append(np.zeros(x.size), target)
        else:
            learn(self._values, self._inverse, z, target)

    def _slide(self, z: np.ndarray, target: float, window: int) -> None:
        """Add one sample to the normal equations and take the oldest away."""
        if self._normal is None:
            self._normal = np.diag(np.append(np.full(z.size - 1, 1.0 / self.C), 0.0))
            self._moment = np.zeros(z.size)
        self._normal += np.outer(z, z)
        self._moment += z * target
        self._kept.append((z, target))
        if len(self._kept) > window:
            old, old_target = self._kept.popleft()
            self._normal -= np.outer(old, old)
            self._moment -= old * old_target
            self.n_samples -= 1

    def linear(self) -> tuple[np.ndarray, float]:
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
    def inverse(self) -> np.ndarray:
        """Inverse of the normal matrix of ``[features, 1]``.

        Times the variance of the errors it is the covariance of the estimates.
        """
        self.linear()
        if self._normal is not None:
            return np.linalg.inv(self._normal)
        assert self._inverse is not None
        return self._inverse.copy()


class RecursiveLeastSquares(OnlineMachine):
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

    def update(self, features: np.ndarray, target: float) -> None:
        """Learn one sample, features ``(n_features,)``."""
        x = np.asarray(features, dtype=float)
        learn(self._values, self._inverse, x, target, self.forgetting)
        if self.forgetting < 1:
            self._inverse /= self.forgetting
            excess = np.trace(self._inverse) / (len(x) * self.largest_std**2)
            if excess > 1:
                self._inverse /= excess
        self.n_samples += 1

    def linear(self) -> tuple[np.ndarray, float]:
        """Present values; there is no constant but one among the features."""
        return self._values.copy(), 0.0

    @property
    def inverse(self) -> np.ndarray:
        """Times the variance of errors, the covariance of the estimates."""
        return self._inverse.copy()


# Relative residual of the dual system above which the solution is announced as lost. Rounding
# leaves 1e-5 where three digits of the coefficients are right, and more than 1e-2 where none is.
LOST = 1e-3


class IncrementalLSSVM(OnlineMachine):
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
        C: float = WEIGHT,
        kernel: KernelFunction | None = None,
        bias: bool = True,
        method: str = "cholesky",
        window: int | None = None,
        refresh: int = 20,
    ) -> None:
        check_weight(C)
        check_choice("method", method, ("cholesky", "inverse"))
        check_window(window)
        self.C, self.bias_wanted, self.method = C, bias, method
        self.kernel = kernel or LinearKernel()
        self.window, self.refresh = window, refresh
        self._warned = False
        self.forget()

    def forget(self) -> None:
        """Forget all samples."""
        self._n = self._dropped = 0
        self._features = self._matrix = np.empty((0, 0))
        self._targets = np.empty(0)

    def update(self, features: np.ndarray, target: float) -> None:
        """Learn one sample, features ``(n_features,)``."""
        row = np.asarray(features, dtype=float).ravel()
        if self._n == 0:
            self._features = np.empty((0, len(row)))
        self._reserve()
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
        """The constant, of any kernel."""
        return self.solution()[1]

    @property
    def multipliers(self) -> np.ndarray:
        """Lagrange multipliers of the samples kept, shape ``(n_samples,)``."""
        return self.solution()[0]

    def linear(self) -> tuple[np.ndarray, float]:
        """Coefficients of the features, of the linear kernel only, and the bias."""
        multipliers, bias = self.solution()
        if not isinstance(self.kernel, LinearKernel):
            raise ModelError("Only the linear kernel has coefficients. Use predict.")
        return self._features[: self._n].T @ multipliers, bias

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
        return self._residual(*self._solve())

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

    def _reserve(self) -> None:
        """Double the room when it is full, so that a step copies nothing on average."""
        if self._n == len(self._targets):
            more = max(16, self._n)
            self._matrix = np.pad(self._matrix, (0, more))
            self._features = np.pad(self._features, ((0, more), (0, 0)))
            self._targets = np.pad(self._targets, (0, more))

    def _drop_oldest(self) -> None:
        n = self._n
        old = self._matrix[:n, :n]
        if self.method == "inverse":
            kept = old[1:, 1:] - np.outer(old[1:, 0], old[0, 1:]) / old[0, 0]
        else:
            # Lower factor of what is left plus the oldest column's square.
            upper = np.asarray(np.linalg.qr(np.vstack([old[1:, 1:].T, old[1:, 0]]), mode="r"))
            kept = (upper * np.where(np.diag(upper) < 0, -1.0, 1.0)[:, None]).T
        self._features[: n - 1] = self._features[1:n]
        self._targets[: n - 1] = self._targets[1:n]
        self._n = n - 1
        self._dropped += 1
        if self.method == "inverse" and self._dropped % self.refresh == 0:
            support = self._features[: n - 1]
            kept = np.linalg.inv(self.kernel(support, support) + np.eye(n - 1) / self.C)
        self._matrix[: n - 1, : n - 1] = kept


METHODS = ("recursive", "incremental", "forgetting")


@dataclass(frozen=True)
class OnlineRegression(RegressionEstimator):
    """Play records back through an online regression, one equation at a time.

    The result is the last state of the recursion; ``extras["history"]`` holds,
    by parameter, its value after every sample.

    Parameters
    ----------
    method : str
        ``"recursive"`` (:class:`RecursiveLSSVM`), ``"incremental"``
        (:class:`IncrementalLSSVM`) or ``"forgetting"``
        (:class:`RecursiveLeastSquares`).
    C : float
        Weight of the errors of the LS-SVM.
    start : int
        Samples of the first batch; values before are NaN in the history.
    window : int or None
        Latest samples to learn from, all by default.
    forgetting : float
        Of ``"forgetting"``.
    bias : bool
        Whether equations without a constant term get one; always so with
        ``"recursive"``.
    scale : str or mapping
        See :class:`~oed_sysid.baselines.support_vectors.LeastSquaresSVM`.
    rule, rates
        Where derivatives come from, see
        :class:`~oed_sysid.baselines.least_squares.EquationError`.

    References
    ----------
    Xu, Zou & Yin (2012), On-line identification by incremental LS-SVM, J. Ship
    Mechanics 16(3).
    """

    method: str = "recursive"
    C: float = WEIGHT
    start: int = 2
    window: int | None = None
    forgetting: float = 0.99
    bias: bool = True
    scale: str | Mapping[str, float] = "raw"
    rule: str = "trapezoid"
    rates: Rates | None = None

    def __post_init__(self) -> None:
        check_weight(self.C)
        check_rule(self.rule, WINDOW)
        check_choice("method", self.method, METHODS)
        if self.start < 1:
            raise ModelError(f"start is {self.start}. Begin with at least one sample.")
        if self.rule == "local":
            raise ModelError("A local cubic needs later samples. Choose another rule.")

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        memory = "" if self.window is None else f", last {self.window} samples"
        setting = (
            f"forgetting {self.forgetting:g}" if self.method == "forgetting" else f"C {self.C:g}"
        )
        return f"online regression ({self.method}, {setting}{memory})"

    def _solve(self, rows: Rows) -> Regression:
        found = separate(rows, self._play, scale=self.scale, bias=self.bias)
        return replace(found, iterations=sum(map(len, rows.targets)))

    def _play(self, features: np.ndarray, targets: np.ndarray, bias: bool) -> SeparateSolution:
        columns = features
        machine: OnlineMachine
        if self.method == "recursive":
            machine = RecursiveLSSVM(C=self.C, window=self.window)
        elif self.method == "incremental":
            machine = IncrementalLSSVM(C=self.C, window=self.window, bias=bias)
        else:
            columns = np.hstack([features, np.ones((len(features), 1))]) if bias else features
            machine = RecursiveLeastSquares(np.zeros(columns.shape[1]), forgetting=self.forgetting)
        n = features.shape[1]
        track = np.full((len(targets), n + 1), np.nan)
        first = min(self.start, len(targets))
        machine.start(columns[:first], targets[:first])
        for k in range(first - 1, len(targets)):
            if k >= first:
                machine.update(columns[k], targets[k])
            # A machine that forgets has the constant among its coefficients.
            track[k] = np.append(*machine.linear())[: n + 1]
        age = np.arange(len(targets))[::-1]
        if self.method == "forgetting":
            ridge, weights = 0.0, self.forgetting**age
        else:
            ridge, weights = 1.0 / self.C, (age < (self.window or np.inf)).astype(float)
        return SeparateSolution(
            track[-1, :n], float(track[-1, n]), ridge, weights=weights, track=track
        )


def read_sample(
    model: Model,
    time: float,
    sample: Mapping[str, float],
    *,
    after: float | None,
    anew: str,
) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and outputs of a sample, in the model's order; a missing output is NaN.

    Parameters
    ----------
    model : Model
    time : float
        Time of the sample, s.
    sample : mapping of str to float
        Commands and measured outputs by name.
    after : float or None
        Time of the sample before, s.
    anew : str
        What to do for a new run, for the message.

    Raises
    ------
    ModelError
        If an input is missing, or the sample is not later than the one before.
    """
    missing = [name for name in model.input_names if name not in sample]
    if missing:
        raise ModelError(
            f"The sample at t = {time:g} s has no {', '.join(missing)}. Every input is needed."
        )
    if after is not None and not time > after:
        raise ModelError(
            f"The sample at t = {time:g} s is not later than the one before, at {after:g} s. {anew}"
        )
    inputs = np.array([sample[name] for name in model.input_names], dtype=float)
    return inputs, np.array([sample.get(name, np.nan) for name in model.output_names])


def streamed_form(model: Model) -> RegressionForm:
    """Targets and regressors of a model whose actuators keep no memory between samples.

    Raises
    ------
    ModelError
        If the equations are not linear in the free parameters, or an actuator has memory.
    """
    form = regression_form(model)
    if form.graph.n_actuator_memory:
        raise ModelError(
            f"Model {model.name!r} has actuators with memory. Feed the measured actuator "
            "signals as inputs and leave the actuator effects out with model.without(...)."
        )
    return form


@dataclass(frozen=True, eq=False)
class StreamRow:
    """One row of one equation: ``target = features @ parameters``."""

    equation: str
    features: np.ndarray
    target: float


class EquationStream:
    """Features and targets of a model's equations, one sample at a time.

    Parameters
    ----------
    model : Model
        Linear in its free parameters, every state of the equations measured.
        Actuators must have no memory: on board their signals are measured.
    rule : str
        ``"euler"``, ``"trapezoid"`` or ``"simpson"``, see
        :mod:`oed_sysid.baselines.equations`; a row is ready one or two
        samples late.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Input, Output, State
    >>> from oed_sysid.physics import Force
    >>> from oed_sysid.physics.parameters import Parameter
    >>> yaw = Model(
    ...     "yaw", (State("r", "rad/s"),), (Input("delta", "rad"),), (Output("r", "rad/s"),),
    ...     axes={"N": "r"}, inertia={("N", "r"): "T"},
    ...     effects=(Force("turn", {"N": "K*delta - r"}, (Parameter("K", 0.0, "1/s"),)),),
    ...     parameters=(Parameter("T", 10.0, "s", fixed=True),),
    ... )
    >>> stream, filter = EquationStream(yaw, rule="euler"), RecursiveLeastSquares(np.zeros(1))
    >>> r = 0.0
    >>> for k in range(50):
    ...     for row in stream.push(float(k), {"delta": 0.1 if k % 20 < 10 else -0.1, "r": r}):
    ...         filter.update(row.features, row.target)
    ...     r += (0.3 * (0.1 if k % 20 < 10 else -0.1) - r) / 10
    >>> print(filter.coefficients.round(4))
    [0.3]
    """

    def __init__(self, model: Model, *, rule: str = "trapezoid") -> None:
        check_rule(rule, 9)
        if rule not in SPANS:
            raise ModelError(f"rule is {rule!r}. A stream knows {', '.join(SPANS)}.")
        self.model, self.rule = model, rule
        self.form = streamed_form(model)
        # Positions of the free parameters that each equation holds.
        found = self.form.anywhere(8).transpose(1, 0, 2)
        self._owners = tuple(np.flatnonzero(block.any(axis=0)) for block in found)
        self._samples: deque[tuple[float, np.ndarray, np.ndarray]] = deque(maxlen=SPANS[rule] + 1)

    @property
    def equations(self) -> tuple[str, ...]:
        """Equations, by the state whose rate they give."""
        return self.form.equations

    def names(self, equation: str) -> tuple[str, ...]:
        """Parameters of one equation, in the order of its features."""
        owners = self._owners[self.form.equations.index(equation)]
        return tuple(self.form.names[i] for i in owners)

    def push(self, time: float, sample: dict[str, float]) -> list[StreamRow]:
        """Take one sample; return one row per equation as soon as there are enough.

        Parameters
        ----------
        time : float
            Time of the sample, s.
        sample : mapping of str to float
            Measured outputs and commands by name; a missing output is NaN.
        """
        now, measured = read_sample(
            self.model,
            time,
            sample,
            after=self._samples[-1][0] if self._samples else None,
            anew="Start a new stream for a new run.",
        )
        self._samples.append((time, now, measured))
        if len(self._samples) <= SPANS[self.rule]:
            return []
        times, inputs, outputs = (np.array(part) for part in zip(*self._samples, strict=True))
        states = states_of(self.form, outputs)
        rows = rows_from(self.form, times, states, inputs, self.rule)
        targets, regressors = rows[0][-1], rows[1][-1]
        return [
            StreamRow(equation, regressors[i, owners], float(targets[i]))
            for i, (equation, owners) in enumerate(
                zip(self.form.equations, self._owners, strict=True)
            )
            if np.isfinite(targets[i]) and np.isfinite(regressors[i, owners]).all()
        ]


class KalmanStream:
    """Parameters of a model while it sails: one :meth:`update` per sample.

    The same numbers, sample by sample, as :class:`JointKalmanFilter` plays back
    from a log; memory and cost per sample do not grow.

    Parameters
    ----------
    model : Model
        Its values are the start values; every output declares its noise.
    settings : JointKalmanFilter, optional
        Kind and uncertainties.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Output, State
    >>> from oed_sysid.physics.parameters import Parameter
    >>> ramp = Model(
    ...     "ramp", (State("x", "m"),), (), (Output("x", "m", noise_std=0.01),), {"x": "slope"},
    ...     parameters=(Parameter("slope", 0.0, "m/s", scale=1.0),),
    ... )
    >>> stream = KalmanStream(ramp)
    >>> for k in range(20):
    ...     stream.update(0.1 * k, {"x": 0.2 * k})
    >>> print(round(stream.values["slope"], 2))
    2.0
    """

    def __init__(self, model: Model, settings: JointKalmanFilter | None = None) -> None:
        self.model = model
        self._settings = settings or JointKalmanFilter()
        levels = given_levels(model.outputs)
        if not np.isfinite(levels).all():
            unknown = [o.name for o, s in zip(model.outputs, levels, strict=True) if np.isnan(s)]
            raise ModelError(
                f"The noise of {', '.join(unknown)} is not known, and a stream cannot wait to see "
                "it. Give Output(noise_std=...)."
            )
        self._settings.check(model)
        self._filter = JointFilter(self._settings, model, levels)
        self._parameters, self._covariance = self._filter.first_values()
        self._last: tuple[float, np.ndarray] | None = None
        self.n_samples = 0

    def start(self) -> None:
        """Begin a new run: states anew from its first sample, parameters as known by now."""
        self._parameters, self._covariance = self._known()
        self._last = None

    def update(self, time: float, sample: Mapping[str, float]) -> None:
        """Learn one sample.

        Parameters
        ----------
        time : float
            Time of the sample, s.
        sample : mapping of str to float
            Commands and measured outputs by name; an output may be missing.
        """
        inputs, outputs = read_sample(
            self.model,
            time,
            sample,
            after=None if self._last is None else self._last[0],
            anew="Call start() for a new run.",
        )
        if self._last is None:
            seen = {
                state: outputs[column]
                for state, column in measured_columns(self.model).items()
                if np.isfinite(outputs[column])
            }
            self._filter.begin(time, inputs, seen, self._parameters, self._covariance)
            times, commands = np.array([time, time + 1.0]), np.array([inputs, inputs])
        else:
            times = np.array([self._last[0], time])
            commands = np.array([self._last[1], inputs])
        self._filter.learn(times, commands, outputs, first=self._last is None)
        self._last = (time, inputs)
        self.n_samples += 1

    @property
    def values(self) -> dict[str, float]:
        """Parameters as known by now."""
        values = self._known()[0]
        return dict(zip(self.model.free_names, map(float, values), strict=True))

    @property
    def std_errors(self) -> dict[str, float]:
        """Their standard errors."""
        stds = np.sqrt(np.maximum(np.diag(self._known()[1]), 0.0))
        return dict(zip(self.model.free_names, map(float, stds), strict=True))

    def _known(self) -> tuple[np.ndarray, np.ndarray]:
        if self._last is None:
            return self._parameters, self._covariance
        return self._filter.parameters
