"""Estimation on board: one sample at a time, at a known cost per sample.

============================  ========================================================
:class:`IncrementalLSSVM`     LS-SVM grown by one sample by the bordering recursion
:class:`RecursiveLSSVM`       the same solution in the size of the features, flat cost
:class:`RecursiveLeastSquares`  with exponential forgetting
:class:`EquationStream`       from a model and samples to features and targets
:class:`OnlineRegression`     a record played back, behind the interface of the estimators
============================  ========================================================
"""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from oed_sysid.baselines.equations import (
    SPANS,
    Rows,
    regression_form,
    rows_from,
    states_of,
)
from oed_sysid.baselines.regression import (
    Regression,
    RegressionEstimator,
    SeparateSolution,
    separate,
)
from oed_sysid.baselines.support_vectors import (
    WEIGHT,
    Kernel,
    check_weight,
    dual_solution,
    linear_kernel,
)
from oed_sysid.errors import ModelError, PrecisionWarning
from oed_sysid.likelihood.estimator import check_choice
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import THREE_DIGITS


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


class RecursiveLeastSquares(OnlineMachine):
    r"""Least squares, with exponential forgetting for parameters that drift.

    Of the rows :math:`(z, y)` learnt so far only ``R`` and ``d`` are kept, with
    :math:`\lVert R\theta - d\rVert^2` equal to their sum of squares but for a constant; a sample
    adds a row, and one orthogonal transformation makes the stack triangular again:

    .. math::
        Q^T\begin{bmatrix}\sqrt\lambda R & \sqrt\lambda d\\ z^T & y\end{bmatrix} =
        \begin{bmatrix}R' & d'\\ 0 & e\end{bmatrix} .

    A sample that is ``n`` samples old counts :math:`\lambda^n`.

    Parameters
    ----------
    values : ndarray (n_features,)
        Start values.
    std : float or ndarray (n_features,)
        How uncertain they are, in units of the errors; infinite where nothing is known.
    forgetting : float
        :math:`\lambda`, at most 1; the memory is about ``1/(1 - forgetting)``
        samples.
    largest_std : float
        The inverse normal matrix is kept below its square: without excitation
        forgetting would let it grow without limit.

    References
    ----------
    Bierman (1977), Factorization methods for discrete sequential estimation, sec. II.2 and V;
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
        start = np.array(values, dtype=float).ravel()
        known = 1.0 / np.broadcast_to(np.asarray(std, dtype=float), start.shape)
        self._factor = np.column_stack([np.diag(known), known * start])  # [R, d]
        self.forgetting, self.largest_std = forgetting, largest_std
        self.n_samples = 0

    def update(self, features: np.ndarray, target: float) -> None:
        """Learn one sample, features ``(n_features,)``."""
        # A prior of standard deviation s is a row 1/s; forgetting lowers all rows alike.
        self.learn(np.append(np.asarray(features, dtype=float), float(target)))
        if self.forgetting < 1:
            excess = np.trace(self.inverse) / (len(self._factor) * self.largest_std**2)
            self._factor *= np.sqrt(max(excess, 1.0))

    def learn(self, row: np.ndarray) -> None:
        """Learn features and target ``(n_features + 1,)``, without a limit to what is forgotten."""
        stack = np.vstack([np.sqrt(self.forgetting) * self._factor, row])
        self._factor = np.asarray(np.linalg.qr(stack, mode="r"))[: len(self._factor)]
        self.n_samples += 1

    def linear(self) -> tuple[np.ndarray, float]:
        """Present values; there is no constant but one among the features."""
        return solve_triangular(self._factor[:, :-1], self._factor[:, -1]), 0.0

    @property
    def inverse(self) -> np.ndarray:
        """Inverse of the normal matrix ``(n_features, n_features)``.

        Times the variance of the errors it is the covariance of the estimates.
        """
        root = solve_triangular(self._factor[:, :-1], np.eye(len(self._factor)))
        return root @ root.T


class RecursiveLSSVM(OnlineMachine):
    r"""The linear LS-SVM, bias included, as an exact recursion of flat cost.

    It is :class:`RecursiveLeastSquares` of the features and a constant, whose coefficients begin at
    zero with a standard deviation of :math:`\sqrt C` and whose bias begins unknown: the primal
    normal matrix of :math:`z = (x, 1)`,

    .. math:: A_t = \sum zz^T + \mathrm{diag}(I/C, 0).

    Parameters
    ----------
    C : float
        Weight of the errors.

    Notes
    -----
    Equal to the batch solution: with :math:`\Gamma = XX^T + I/C` and
    :math:`w = X^T\alpha`, the condition :math:`1^T\alpha = 0` is the bias row of
    ``A``, and :math:`X^T(y - 1b) = (X^TX + I/C)\,w` the others.

    References
    ----------
    Xu, Zou & Yin (2012), J. Ship Mechanics 16(3), for the problem that it solves.

    Examples
    --------
    >>> machine = RecursiveLSSVM(C=1e6)
    >>> machine.start([[0.0], [1.0]], [1.0, 3.0])
    >>> machine.update([2.0], 5.0)
    >>> print(machine.coefficients.round(4), round(machine.bias, 4))
    [2.] 1.0
    """

    def __init__(self, *, C: float = WEIGHT) -> None:
        check_weight(C)
        self.C = C
        self.forget()

    def forget(self) -> None:
        """Forget all samples."""
        self._recursion: RecursiveLeastSquares | None = None

    def update(self, features: np.ndarray, target: float) -> None:
        """Learn one sample, features ``(n_features,)``."""
        row = np.concatenate([np.asarray(features, dtype=float), [1.0, target]])
        if self._recursion is None:
            stds = np.append(np.full(row.size - 2, np.sqrt(self.C)), np.inf)
            self._recursion = RecursiveLeastSquares(np.zeros(stds.size), std=stds)
        self._recursion.learn(row)

    def _learnt(self) -> RecursiveLeastSquares:
        if self._recursion is None:
            raise ModelError("The machine has learnt nothing yet. Call start or update.")
        return self._recursion

    def linear(self) -> tuple[np.ndarray, float]:
        """Coefficients and bias, at the cost of one solution."""
        values, _ = self._learnt().linear()
        return values[:-1], float(values[-1])

    @property
    def n_samples(self) -> int:
        """Number of samples learnt."""
        return 0 if self._recursion is None else self._recursion.n_samples

    @property
    def inverse(self) -> np.ndarray:
        """Inverse of the normal matrix ``(n_features + 1, n_features + 1)``."""
        return self._learnt().inverse


# Relative residual of the dual system above which the solution is announced as lost. Rounding
# leaves 1e-5 where three digits of the coefficients are right, and more than 1e-2 where none is.
LOST = THREE_DIGITS


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
    kernel : callable
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
        kernel: Kernel = linear_kernel,
        method: str = "cholesky",
        window: int | None = None,
        refresh: int = 20,
    ) -> None:
        check_weight(C)
        check_choice("method", method, ("cholesky", "inverse"))
        if window is not None and window < 2:
            raise ModelError(f"window is {window}. Keep at least two samples.")
        self.C, self.method = C, method
        self.kernel, self.window, self.refresh = kernel, window, refresh
        self._warned = False
        self.forget()

    def forget(self) -> None:
        """Forget all samples."""
        self._dropped, self._targets = 0, np.empty(0)
        self._features: np.ndarray = np.empty((0, 0))
        self._matrix: np.ndarray = np.empty((0, 0))

    def update(self, features: np.ndarray, target: float) -> None:
        """Learn one sample, features ``(n_features,)``."""
        row, matrix, n = np.asarray(features, dtype=float).reshape(1, -1), self._matrix, len(self)
        known = self._features.reshape(n, row.size)
        # Gamma grows by the inner products of the new sample with those known.
        border = self.kernel(known, row)
        corner = self.kernel(row, row) + 1.0 / self.C
        if self.method == "inverse":
            g = matrix @ border
            s = corner - border.T @ g
            self._matrix = np.block([[matrix + g @ g.T / s, -g / s], [-g.T / s, 1.0 / s]])
        else:
            lower = solve_triangular(matrix, border, lower=True, check_finite=False)
            # The last diagonal cannot fall below the ridge, whatever rounding says.
            last = np.sqrt(np.maximum(corner - lower.T @ lower, 1.0 / self.C))
            self._matrix = np.block([[matrix, np.zeros((n, 1))], [lower.T, last]])
        self._features, self._targets = np.vstack([known, row]), np.append(self._targets, target)
        if self.window is not None and n + 1 > self.window:
            self._drop_oldest()

    def __len__(self) -> int:
        return len(self._targets)

    @property
    def n_samples(self) -> int:
        """Number of samples kept."""
        return len(self)

    @property
    def bias(self) -> float:
        """The constant, of any kernel."""
        return self.solution()[1]

    def linear(self) -> tuple[np.ndarray, float]:
        """Coefficients of the features, of the linear kernel only, and the bias."""
        multipliers, bias = self.solution()
        if self.kernel is not linear_kernel:
            raise ModelError("Only the linear kernel has coefficients. Use predict.")
        return self._features.T @ multipliers, bias

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Values ``(n,)`` at features ``(n, n_features)``."""
        multipliers, bias = self.solution()
        return self.kernel(np.atleast_2d(features), self._features) @ multipliers + bias

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
                    f"The recursion of the inverse has lost its digits after {len(self)} samples: "
                    f"its equations are met to {left:.1g} of the targets. Coefficients are not to "
                    "be believed. Use method='cholesky', RecursiveLSSVM, a smaller C or smaller "
                    "units.",
                    PrecisionWarning,
                    stacklevel=2,
                )
        return multipliers, bias

    def _residual(self, multipliers: np.ndarray, bias: float) -> float:
        again = self.kernel(self._features, self._features) @ multipliers
        left = np.abs(again + multipliers / self.C + bias - self._targets).max()
        return float(left / (np.abs(self._targets).max() or 1.0))

    def _solve(self) -> tuple[np.ndarray, float]:
        if not len(self):
            raise ModelError("The machine has learnt nothing yet. Call start or update.")
        columns = np.column_stack([self._targets, np.ones(len(self))])
        if self.method == "inverse":
            solved = self._matrix @ columns
        else:
            solved = cho_solve((self._matrix, True), columns, check_finite=False)
        return dual_solution(solved, bias=True)

    def _drop_oldest(self) -> None:
        old = self._matrix
        self._features, self._targets = self._features[1:], self._targets[1:]
        self._dropped += 1
        if self.method == "cholesky":
            # Lower factor of what is left plus the oldest column's square.
            upper = np.asarray(np.linalg.qr(np.vstack([old[1:, 1:].T, old[1:, 0]]), mode="r"))
            self._matrix = (upper * np.where(np.diag(upper) < 0, -1.0, 1.0)[:, None]).T
        elif self._dropped % self.refresh:
            self._matrix = old[1:, 1:] - np.outer(old[1:, 0], old[0, 1:]) / old[0, 0]
        else:
            again = self.kernel(self._features, self._features) + np.eye(len(self)) / self.C
            self._matrix = np.linalg.inv(again)


@dataclass(frozen=True)
class OnlineRegression(RegressionEstimator):
    """Play records back through :class:`RecursiveLSSVM`, one equation at a time.

    The fit is that after the last sample; ``history`` among its extras holds the values after every
    row of complete samples, by parameter: what a vehicle would have known by then.

    Parameters
    ----------
    C : float
        Weight of the errors.
    rule : str
        Where derivatives come from: ``"euler"``, ``"trapezoid"`` or ``"simpson"``, see
        :class:`~oed_sysid.baselines.least_squares.EquationError`. The others need later samples.

    References
    ----------
    Xu, Zou & Yin (2012), On-line identification by incremental LS-SVM, J. Ship
    Mechanics 16(3).

    Examples
    --------
    >>> OnlineRegression(rule="simpson").name
    'online regression (C 30000)'
    """

    words: ClassVar[str] = "online regression (C {C:g})"
    C: float = WEIGHT
    rule: str = "trapezoid"

    def __post_init__(self) -> None:
        check_weight(self.C)
        check_choice("rule", self.rule, SPANS)

    def _solve(self, rows: Rows) -> Regression:
        return replace(separate(rows, self._play), iterations=sum(map(len, rows.targets)))

    def _play(self, features: np.ndarray, targets: np.ndarray, bias: bool) -> SeparateSolution:
        machine = RecursiveLSSVM(C=self.C)
        track = np.empty((len(targets), features.shape[1] + 1))
        for k, (row, target) in enumerate(zip(features, targets, strict=True)):
            machine.update(row, target)
            track[k] = np.append(*machine.linear())
        return SeparateSolution(track[-1, :-1], float(track[-1, -1]), 1.0 / self.C, track=track)


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
        check_choice("rule", rule, tuple(SPANS))
        self.model, self.rule = model, rule
        self.form, self.n_samples = regression_form(model), 0
        if self.form.graph.n_actuator_memory:
            raise ModelError(
                f"Model {model.name!r} has actuators with memory. Feed the measured actuator "
                "signals as inputs and leave the actuator effects out with model.without(...)."
            )
        # Positions of the free parameters that each equation holds.
        # Eight random motions: a column that is zero in all of them is none of the equation.
        found = self.form.anywhere(8).transpose(1, 0, 2)
        self._owners = tuple(np.flatnonzero(block.any(axis=0)) for block in found)
        self.samples: deque[tuple[float, np.ndarray, np.ndarray]] = deque(maxlen=SPANS[rule] + 1)

    @property
    def equations(self) -> tuple[str, ...]:
        """Equations, by the state whose rate they give."""
        return self.form.equations

    def names(self, equation: str) -> tuple[str, ...]:
        """Parameters of one equation, in the order of its features."""
        owners = self._owners[self.form.equations.index(equation)]
        return tuple(self.form.names[i] for i in owners)

    def push(self, time: float, sample: Mapping[str, float]) -> list[StreamRow]:
        """Take one sample; return one row per equation as soon as there are enough.

        Parameters
        ----------
        time : float
            Time of the sample, s.
        sample : mapping of str to float
            Measured outputs and commands by name; a missing output is NaN.

        Raises
        ------
        ModelError
            If an input is missing, or the sample is not later than the one before.
        """
        return [
            StreamRow(equation, row[owners], float(target))
            for targets, regressors in self.rows(time, sample)
            for equation, owners, target, row in zip(
                self.form.equations, self._owners, targets, regressors, strict=True
            )
            if np.isfinite(target) and np.isfinite(row[owners]).all()
        ]

    def rows(
        self, time: float, sample: Mapping[str, float]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Targets ``(n_equations,)`` and regressors ``(n_equations, n_free)`` of a new sample."""
        self.samples.append((time, *self._checked(time, sample)))
        self.n_samples += 1
        if len(self.samples) > SPANS[self.rule]:
            times, inputs, outputs = (np.array(part) for part in zip(*self.samples, strict=True))
            states = states_of(self.form, outputs)
            yield from zip(*rows_from(self.form, times, states, inputs, self.rule), strict=True)

    def _checked(self, time: float, sample: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Inputs and outputs of a sample, in the model's order; a missing output is NaN."""
        if missing := [name for name in self.model.input_names if name not in sample]:
            raise ModelError(
                f"The sample at t = {time:g} s has no {', '.join(missing)}. Every input is needed."
            )
        if self.samples and not time > (last := self.samples[-1][0]):
            raise ModelError(
                f"The sample at t = {time:g} s is not later than the one before, at "
                f"{last:g} s. Call start() for a new run."
            )
        inputs = np.array([sample[name] for name in self.model.input_names], dtype=float)
        return inputs, np.array([sample.get(name, np.nan) for name in self.model.output_names])

    def start(self) -> None:
        """Begin a new run."""
        self.samples.clear()
