"""Support vector machines on equations of motion: least squares, or an insensitive zone."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from oed_sysid.baselines.equations import WINDOW, Rates, Rows, check_rule
from oed_sysid.baselines.regression import (
    Regression,
    RegressionEstimator,
    SeparateSolution,
    column_norms,
    separate,
)
from oed_sysid.errors import ModelError, library
from oed_sysid.likelihood.estimate import Status
from oed_sysid.likelihood.estimator import check_choice

# Inner products ``(n_first, n_second)`` of the features of two sets of points.
Kernel = Callable[[np.ndarray, np.ndarray], np.ndarray]
FORMS = ("primal", "dual")
# Published weight of the errors.
WEIGHT = 3e4
CROSS_VALIDATED = "cross-validated"


def linear_kernel(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Inner products of the features themselves: coefficients can be read off."""
    return first @ second.T


def dual_solution(solved: np.ndarray, bias: bool) -> tuple[np.ndarray, float]:
    r"""Multipliers ``(n_samples,)`` and bias of an LS-SVM.

    .. math:: b = \frac{1^T\Gamma^{-1}y}{1^T\Gamma^{-1}1}, \qquad
              \alpha = \Gamma^{-1}y - b\,\Gamma^{-1}1

    Parameters
    ----------
    solved : ndarray (n_samples, 2)
        :math:`\Gamma^{-1}[y, 1]` with :math:`\Gamma = K + I/C`.
    bias : bool
        Whether there is one.
    """
    offset = float(solved[:, 0].sum() / solved[:, 1].sum()) if bias else 0.0
    return solved[:, 0] - offset * solved[:, 1], offset


@dataclass(frozen=True, eq=False)
class Machine:
    """A trained machine.

    Attributes
    ----------
    support : ndarray (n_samples, n_features)
        Samples it was trained on.
    multipliers : ndarray (n_samples,)
        Lagrange multipliers, ``C`` times the error of each sample.
    coefficients : ndarray (n_features,) or None
        With the linear kernel.
    bias : float
    kernel : callable
    """

    support: np.ndarray
    multipliers: np.ndarray
    coefficients: np.ndarray | None
    bias: float
    kernel: Kernel

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Values ``(n,)`` at features ``(n, n_features)``."""
        features = np.atleast_2d(features)
        if self.coefficients is not None:
            return features @ self.coefficients + self.bias
        return self.kernel(features, self.support) @ self.multipliers + self.bias


def train(
    features: np.ndarray,
    targets: np.ndarray,
    *,
    C: float,
    kernel: Kernel = linear_kernel,
    form: str = "primal",
    bias: bool = True,
) -> Machine:
    r"""Train a least-squares support vector machine.

    .. math:: \min_{w,b,e} \tfrac12 |w|^2 + \tfrac{C}{2} \sum_i e_i^2,\quad
              y_i = w^T\varphi(x_i) + b + e_i

    The dual is a linear system of the size of the samples; with the linear
    kernel the primal has the size of the features, the same solution and far
    better numbers.

    Parameters
    ----------
    features : ndarray (n_samples, n_features)
    targets : ndarray (n_samples,)
    C : float
        Weight of the errors; its meaning depends on the units of both.
    kernel : callable
        Linear by default.
    form : str
        ``"primal"`` (linear kernel only) or ``"dual"``.
    bias : bool
        Whether there is a constant, which is not penalised.

    References
    ----------
    Suykens et al. (2002), Least squares support vector machines, eq. 3.5-3.9;
    Xu, Zou, Yin & Cao (2012), J. Hydrodynamics 24(5).

    Examples
    --------
    >>> x = np.linspace(-1, 1, 20)[:, None]
    >>> machine = train(x, 2 * x[:, 0] + 1, C=1e6)
    >>> print(machine.coefficients.round(4), round(machine.bias, 4))
    [2.] 1.0
    """
    features = np.asarray(features, dtype=float)
    targets = np.asarray(targets, dtype=float)
    if features.ndim != 2 or targets.shape != (len(features),):
        raise ModelError(
            f"Features have shape {features.shape} and targets {targets.shape}; expected "
            "(n_samples, n_features) and (n_samples,)."
        )
    check_weight(C)
    linear = kernel is linear_kernel
    check_choice("form", form, FORMS)
    if form == "primal":
        if not linear:
            raise ModelError("Only the linear kernel has a primal form. Use form='dual'.")
        solution = ridge(features, targets, C, bias=bias)
        coefficients, offset = solution[:-1], float(solution[-1])
        errors = targets - features @ coefficients - offset
        return Machine(features, C * errors, coefficients, offset, kernel)
    n = len(targets)
    if n > 10_000:  # larger than 800 MB
        raise ModelError(
            f"The dual of {n} samples would need {n * n * 8 / 1e9:.1f} GB. Thin the record, or use "
            "form='primal'."
        )
    gamma = kernel(features, features) + np.eye(n) / C
    solved = np.linalg.solve(gamma, np.column_stack([targets, np.ones(n)]))
    multipliers, offset = dual_solution(solved, bias)
    read_off = features.T @ multipliers if linear else None
    return Machine(features, multipliers, read_off, offset, kernel)


def ridge(features: np.ndarray, targets: np.ndarray, C: float, *, bias: bool) -> np.ndarray:
    """Primal solution ``[w, b]`` by orthogonal transformations, ``b`` not penalised."""
    n, n_features = features.shape
    constant = np.ones((n, 1)) if bias else np.zeros((n, 1))
    upper = np.hstack([features, constant])
    lower = np.hstack([np.eye(n_features) / np.sqrt(C), np.zeros((n_features, 1))])
    matrix = np.vstack([upper, lower])
    scale = 1.0 / column_norms(matrix)
    right = np.concatenate([targets, np.zeros(n_features)])
    return scale * np.linalg.lstsq(matrix * scale, right, rcond=None)[0]


def best_weight(features: np.ndarray, targets: np.ndarray, bias: bool) -> float:
    r"""Weight of the errors that predicts left-out stretches best.

    .. math:: \hat C = \arg\min_C \sum_{j} \sum_{i \in S_j}
        \big(y_i - w_{-j}(C)^T x_i - b_{-j}(C)\big)^2,

    over stretches :math:`S_j` of consecutive rows: neighbours share their noise, so that rows left
    out one by one would be predicted by it (Burman, Chow & Nolan 1994, Biometrika 81).

    Parameters
    ----------
    features : ndarray (n_samples, n_features)
    targets : ndarray (n_samples,)
    bias : bool
        Whether there is a constant.
    """
    size = float(np.mean(features**2)) or 1.0
    stretches = np.array_split(np.arange(len(targets)), 5)  # left out one after the other

    def error(weight: float) -> float:
        total = 0.0
        for out in stretches:
            kept = np.setdiff1d(np.arange(len(targets)), out)
            solution = ridge(features[kept], targets[kept], weight, bias=bias)
            errors = targets[out] - features[out] @ solution[:-1] - solution[-1]
            total += float(errors @ errors)
        return total

    # Of features of unit size: from a pull on every coefficient to none.
    return min(10.0 ** np.arange(-2, 9) / size, key=error)


def check_weight(C: float) -> None:
    """Raise :class:`ModelError` for a weight that is not positive."""
    if not C > 0:
        raise ModelError(f"C is {C}. Give a positive weight of the errors.")


@dataclass(frozen=True)
class LeastSquaresSVM(RegressionEstimator):
    r"""Linear least-squares support vector regressions, one per equation.

    A parameter whose regressor is constant, such as a steady thrust, is taken
    as the bias of its equation, as published; one without a constant term gets a
    bias all the same (``extras["bias"]``). Equations that share parameters
    are one regression without a bias: with ``scale="unit"`` each counts alike.

    Parameters
    ----------
    C : float, or ``"cross-validated"``
        Weight of the errors. It has the unit of one over a squared feature, so
        what it does depends on the scale of the equations: with forces in
        newton the published 30000 penalises next to nothing, with equations
        divided by :math:`\rho L^n/2` it pulls weak terms to zero. Cross-validated, each equation
        takes the weight that predicts left-out stretches of the record best.
    form : str
        ``"primal"`` or ``"dual"``. In newton the dual system is so ill
        conditioned that it loses up to all digits; see ``extras["condition"]``.
    scale : str or mapping of str to float
        ``"raw"`` takes equations in SI units, ``"unit"`` scales targets and
        features to unit size, which gives ``C`` the same meaning in every
        equation; a mapping gives a divisor for each equation, by state.
    rule, window, rates
        Where derivatives come from, see :class:`EquationError`.

    References
    ----------
    Xu, Zou, Yin & Cao (2012), Identification of an AUV in the diving plane by
    LS-SVM, J. Hydrodynamics 24(5), doi 10.1016/S1001-6058(11)60299-0.

    Examples
    --------
    >>> LeastSquaresSVM(C="cross-validated", scale="unit").name
    'LS-SVM (primal, C cross-validated, simpson derivatives)'
    """

    apart: ClassVar[bool] = False
    C: float | str = WEIGHT
    form: str = "primal"
    scale: str | Mapping[str, float] = "raw"
    rule: str = "simpson"
    window: int = WINDOW
    rates: Rates | None = None

    def __post_init__(self) -> None:
        if isinstance(self.C, str):
            check_choice("C", self.C, (CROSS_VALIDATED,))
        else:
            check_weight(self.C)
        check_rule(self.rule, self.window)
        check_choice("form", self.form, FORMS)

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        weight = self.C if isinstance(self.C, str) else f"{self.C:g}"
        return f"LS-SVM ({self.form}, C {weight}, {self.rule} derivatives)"

    def _solve(self, rows: Rows) -> Regression:
        def solve(features: np.ndarray, targets: np.ndarray, bias: bool) -> SeparateSolution:
            given = self.C
            weight = given if not isinstance(given, str) else best_weight(features, targets, bias)
            machine = train(features, targets, C=weight, form=self.form, bias=bias)
            assert machine.coefficients is not None  # the kernel is linear
            # Of Gamma = X X' + I/C in the dual; the primal's rows have its root.
            spectrum = np.linalg.svd(features, compute_uv=False)
            condition = 1.0 + weight * float(spectrum[0]) ** 2
            condition = condition if self.form == "dual" else np.sqrt(condition)
            facts = {"C": weight, "condition": condition}
            return SeparateSolution(machine.coefficients, machine.bias, 1.0 / weight, facts=facts)

        return separate(rows, solve, scale=self.scale)


ITERATIONS = Status(
    "iterations", "the limit of iterations was reached. Raise max_iterations, or lower C."
)


@dataclass(frozen=True)
class SupportVectorRegression(RegressionEstimator):
    r"""Linear :math:`\varepsilon`-support vector regression, one equation at a time.

    .. math:: \min \tfrac12|w|^2 + C\sum_i \max(0, |y_i - w^Tx_i - b| - \varepsilon)

    Errors within the zone cost nothing and others linearly, so that outliers
    count little. Stated intervals treat the solution as least squares and are
    a rough guide only.

    Parameters
    ----------
    C : float
        Weight of the errors, in scaled units.
    epsilon : float
        Half-width of the zone, in scaled units.
    scale : str or mapping
        See :class:`LeastSquaresSVM`; ``"unit"`` makes both settings
        independent of units.
    rule, window, rates
        Where derivatives come from, see :class:`EquationError`.
    max_iterations : int
        Most iterations of the solver per equation.

    References
    ----------
    Smola & Schölkopf (2004), A tutorial on support vector regression,
    Statistics and Computing 14; solver: Fan et al. (2008), LIBLINEAR.

    Examples
    --------
    >>> SupportVectorRegression(epsilon=0.01).name
    'support vector regression (C 100, epsilon 0.01)'
    """

    words: ClassVar[str] = "support vector regression (C {C:g}, epsilon {epsilon:g})"
    C: float = 100.0  # of data scaled to one: errors outweigh the size of coefficients
    epsilon: float = 1e-3
    scale: str | Mapping[str, float] = "unit"
    rule: str = "simpson"
    window: int = WINDOW
    rates: Rates | None = None
    max_iterations: int = 200_000

    def __post_init__(self) -> None:
        check_weight(self.C)
        check_rule(self.rule, self.window)
        if not self.epsilon >= 0:
            raise ModelError(f"epsilon is {self.epsilon}. Give the half-width of the zone, >= 0.")

    def _solve(self, rows: Rows) -> Regression:
        svm = library("sklearn.svm", self.name, extra="baselines", error=ModelError)
        unfinished: list[int] = []

        def solve(features: np.ndarray, targets: np.ndarray, bias: bool) -> SeparateSolution:
            machine = svm.SVR(
                kernel="linear",
                C=self.C,
                epsilon=self.epsilon,
                tol=1e-6,
                max_iter=self.max_iterations,
            )
            # The bias is free, so that centred targets change the solver's way alone.
            centre = targets.mean() if bias else 0.0
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # reported in the status
                machine.fit(features, targets - centre)
            if machine.fit_status_ or machine.n_iter_ >= self.max_iterations:
                unfinished.append(int(machine.n_iter_))
            return SeparateSolution(
                machine.coef_.ravel(),
                float(machine.intercept_[0]) + float(centre),
                facts={"support_vectors": len(machine.support_)},
            )

        found = separate(rows, solve, scale=self.scale)
        return replace(found, status=ITERATIONS) if unfinished else found
