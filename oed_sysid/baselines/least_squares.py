"""Regressions in closed form: equation error, total least squares, heading differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from oed_sysid.baselines.equations import (
    WINDOW,
    Rates,
    Rows,
    check_rule,
    rows_of,
)
from oed_sysid.baselines.regression import (
    Baseline,
    Regression,
    RegressionEstimator,
    assumed_levels,
    column_norms,
    each_equation,
    residual_covariance,
    solve_rows,
)
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import DataError, ModelError
from oed_sysid.likelihood.estimator import check_choice
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.physics.model import Model


@dataclass(frozen=True)
class EquationError(RegressionEstimator):
    r"""Least squares on measured states and the derivatives taken from them.

    Inertia times measured rate is explained by forces at the measured states,

    .. math:: M\dot x_k = \Phi(x_k, d_k)\,\theta + e_k ,

    which is linear in the parameters, has one solution and needs no start
    values. The model must be linear in its free parameters and every state in
    the equations measured. Noise in the states enters the regressors and biases
    the estimates towards zero; the stated intervals do not contain this bias.
    It falls with the noise, and with the ``window``.

    Parameters
    ----------
    rule : str
        Where derivatives come from, see
        :mod:`oed_sysid.baselines.equations`.
    window : int
        Samples of the local cubic, odd.
    rates : mapping of str to ndarray (n_times, n_states), optional
        For ``rule="exact"``: rates by record, from accelerometers or a
        simulation.
    coloured : str
        ``"auto"`` reports the sandwich covariance where errors are correlated
        in time; ``"never"`` and ``"always"`` force it.

    References
    ----------
    Klein & Morelli (2006), Aircraft system identification, ch. 5 (equation-error
    method); Savitzky & Golay (1964) for the local cubic.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Input, Output, State
    >>> from oed_sysid.physics import Force
    >>> from oed_sysid.experiments.experiment import Experiment
    >>> from oed_sysid.experiments.manoeuvres import Doublet
    >>> from oed_sysid.physics.parameters import Parameter
    >>> from oed_sysid.experiments.simulation import simulate
    >>> yaw = Model(
    ...     "yaw", (State("r", "rad/s"),), (Input("delta", "rad"),), (Output("r", "rad/s"),),
    ...     axes={"N": "r"}, inertia={("N", "r"): "T"},
    ...     effects=(Force("turn", {"N": "K*delta - r"}, (Parameter("K", 0.1, "1/s"),)),),
    ...     parameters=(Parameter("T", 10.0, "s"),),
    ... )
    >>> test = Experiment("test", Doublet("delta", 0.2, pulse_time=20.0), duration=60.0)
    >>> fit = EquationError(rule="simpson").fit(yaw, Dataset((simulate(yaw, test, noise=False),)))
    >>> {name: round(value, 3) for name, value in fit.values.items()}
    {'T': 10.0, 'K': 0.1}
    """

    apart: ClassVar[bool] = False
    rule: str = "local"
    window: int = WINDOW
    rates: Rates | None = None
    coloured: str = "auto"

    def __post_init__(self) -> None:
        check_rule(self.rule, self.window)
        check_choice("coloured", self.coloured, ("auto", "never", "always"))
        if (self.rule == "exact") != (self.rates is not None):
            raise ModelError("Exact rates and rule='exact' belong together: give both or none.")

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        window = f", {self.window} samples" if self.rule == "local" else ""
        return f"equation error ({self.rule} derivatives{window})"

    def _solve(self, rows: Rows) -> Regression:
        return solve_rows(rows, self.coloured)


@dataclass(frozen=True)
class TotalLeastSquares(RegressionEstimator):
    r"""Generalised total least squares, one equation at a time.

    With ``D = [regressors, target]`` and ``W`` the covariance of the errors of
    its columns, the solution is the direction that minimises

    .. math:: \frac{v^T D^T D v}{v^T W v}, \qquad v \propto (\theta, -1).

    Columns without noise, such as commanded angles, are exact. ``W`` follows
    from the noise levels of the outputs, carried through smoothing, derivatives
    and products by perturbing the data. Where the least ratio is far from one
    the stated noise does not explain the misfit.

    Parameters
    ----------
    rule, window
        Where derivatives come from, see :class:`EquationError`.
    seed : int
        Of the perturbations.

    References
    ----------
    Van Huffel & Vandewalle (1991), The total least squares problem, SIAM,
    ch. 10 (generalised TLS).

    Examples
    --------
    >>> TotalLeastSquares(window=15).name
    'total least squares (local derivatives)'
    """

    words: ClassVar[str] = "total least squares ({rule} derivatives)"
    rule: str = "local"
    window: int = WINDOW
    seed: int = 0

    def __post_init__(self) -> None:
        check_rule(self.rule, self.window)
        if self.rule == "exact":
            raise ModelError("Exact rates have no noise to share out. Use EquationError.")

    def _solve(self, rows: Rows) -> Regression:
        column_errors = self._column_errors(rows)

        def solve(index: int) -> tuple[Sequence[str], Regression]:
            regressors, target, names = rows.equation(index)
            if len(target) <= len(names):
                raise ModelError(
                    f"The equation of {rows.form.equations[index]} has {len(target)} complete rows "
                    f"for {len(names)} parameters. Give a longer record."
                )
            values, ratio = generalised_tls(regressors, target, column_errors[index])
            # Noise in the regressors adds n W to X'X, which says nothing of the parameters.
            noise = len(target) * ratio * column_errors[index][:-1, :-1]
            covariance, coloured = residual_covariance(
                regressors, target - regressors @ values, len(target) - len(names), -noise
            )
            facts = {"noise_ratio": float(np.sqrt(ratio))}
            return names, Regression(values, covariance, coloured=coloured, facts=facts)

        return each_equation(rows, solve)

    def _column_errors(self, rows: Rows) -> list[np.ndarray]:
        """Covariance of the errors of ``[regressors, target]`` per row, by equation."""
        form, rng = rows.form, np.random.default_rng(self.seed)
        sigma = assumed_levels(form.model, rows.dataset)
        sums = [np.zeros(()) for _ in form.equations]
        used = [
            [form.names.index(name) for name in rows.equation(index)[2]]
            for index in range(len(form.equations))
        ]
        targets, regressors = np.vstack(rows.targets), np.vstack(rows.regressors)
        n_copies = 12  # of the data, to measure how noise enters the columns

        def noisy(record: Record) -> Record:
            errors = sigma * rng.standard_normal(record.outputs.shape)
            return record.with_outputs(record.outputs + errors)

        for _ in range(n_copies):
            copies = Dataset(tuple(map(noisy, rows.dataset)))
            moved = rows_of(form, copies, rule=self.rule, window=self.window)
            by_target = np.vstack(moved.targets) - targets
            by_regressor = np.vstack(moved.regressors) - regressors
            for index, columns in enumerate(used):
                change = np.column_stack([by_regressor[:, index, columns], by_target[:, index]])
                change = change[np.isfinite(change).all(axis=1)]
                sums[index] = sums[index] + change.T @ change / max(len(change), 1)
        return [total / n_copies for total in sums]


def generalised_tls(
    regressors: np.ndarray, target: np.ndarray, errors: np.ndarray
) -> tuple[np.ndarray, float]:
    """Solve ``target = regressors @ values`` where all columns have errors.

    Parameters
    ----------
    regressors : ndarray (n_rows, n_parameters)
    target : ndarray (n_rows,)
    errors : ndarray (n_parameters + 1, n_parameters + 1)
        Covariance of the errors of one row of ``[regressors, target]``; may be
        singular.

    Returns
    -------
    values : ndarray (n_parameters,)
    ratio : float
        Mean square of the misfit over that of the stated errors.

    Examples
    --------
    >>> x = np.array([[1.0], [2.0], [3.0]])
    >>> values, ratio = generalised_tls(x, 2 * x[:, 0], np.eye(2))
    >>> print(values.round(6))
    [2.]
    """
    matrix = np.column_stack([regressors, target])
    norms = column_norms(matrix)
    _, values, vectors = np.linalg.svd(matrix / norms, full_matrices=False)
    # Rounding is the smallest misfit that can be told from none.
    values = np.maximum(values, 1e-14 * values[0])
    whitener = vectors.T / values
    scaled = errors / norms[:, None] / norms
    # Largest eigenvalue of W in the metric of D'D: the least ratio without inverting W.
    inner = whitener.T @ scaled @ whitener
    found, directions = np.linalg.eigh(0.5 * (inner + inner.T))
    direction = whitener @ directions[:, -1] / norms
    if abs(direction[-1]) < 1e-12 * np.abs(direction * norms).max() / norms[-1]:
        raise ModelError(
            "Total least squares has no solution here: the least misfit lies in the regressors "
            "alone, which are not independent. Remove a parameter, or use EquationError."
        )
    ratio = 1.0 / (found[-1] * len(target)) if found[-1] > 0 else 0.0
    return -direction[:-1] / direction[-1], float(ratio)


SCHEMES = ("forward", "central")


@dataclass(frozen=True)
class HeadingDifferences(Baseline):
    r"""Least squares for :math:`T\ddot\psi + \dot\psi = K\delta` from sampled headings.

    With :math:`D` the sample time, the published ``"forward"`` scheme is

    .. math:: \psi_{k+2} - 2\psi_{k+1} + \psi_k
              = \frac{KD^2}{T}\,\delta_k - \frac{D}{T}\,(\psi_{k+1} - \psi_k),

    of first order in ``D``; ``"central"`` takes :math:`\delta_{k+1}` and
    :math:`(\psi_{k+2} - \psi_k)/2` and is of second order. Errors that coarse
    sampling makes are not in the stated intervals.

    Parameters
    ----------
    scheme : str
        ``"forward"`` or ``"central"``.

    Notes
    -----
    The model has the output ``psi``, the input ``delta`` and the free parameters ``T`` and ``K``.

    References
    ----------
    Han, Bai, Yu & Lian (2023), Ship Science and Technology 45(7), doi
    10.3404/j.issn.1672-7649.2023.07.017, eq. 11-15, with the sign of the
    second regressor corrected.

    Examples
    --------
    >>> HeadingDifferences("central").name
    'heading differences (central)'
    """

    words: ClassVar[str] = "heading differences ({scheme})"
    scheme: str = "forward"

    def __post_init__(self) -> None:
        check_choice("scheme", self.scheme, SCHEMES)

    def _estimate(self, model: Model, dataset: Dataset) -> Regression:
        check_channels(model, dataset)
        if set(model.free_names) != {"K", "T"}:
            raise ModelError(
                f"Model {model.name!r} has the free parameters {', '.join(model.free_names)}; "
                "expected K and T. Fix the others, or use MultipleShooting."
            )
        matrix, right = map(np.concatenate, zip(*map(self._rows, dataset), strict=True))
        present = np.isfinite(right) & np.isfinite(matrix).all(axis=1)
        matrix, right = matrix[present], right[present]
        first, second = np.linalg.lstsq(matrix, right, rcond=None)[0]
        if not second < 0:
            raise DataError(
                "The heading's differences give a time constant that is not positive: the sampling "
                "is too coarse or too noisy for them. Use MultipleShooting."
            )
        # Rows are divided by the sample time, so that first = K/T and second = -1/T.
        values = {"T": -1.0 / second, "K": -first / second}
        errors = right - matrix @ [first, second]
        variance = float(errors @ errors) / max(len(right) - 2, 1)
        inner = variance * np.linalg.inv(matrix.T @ matrix)
        # First-order propagation from (K/T, -1/T) to T and K.
        slopes = {"T": (0.0, 1.0 / second**2), "K": (-1.0 / second, first / second**2)}
        jacobian = np.array([slopes[name] for name in model.free_names])
        estimates = np.array([values[name] for name in model.free_names])
        return Regression(estimates, jacobian @ inner @ jacobian.T)

    def _rows(self, record: Record) -> tuple[np.ndarray, np.ndarray]:
        """Rows ``(n, 2)`` and right-hand sides ``(n,)`` of a record, as accelerations."""
        if not record.is_uniform:
            raise DataError(
                f"Record {record.name!r} is not sampled uniformly, which differences need."
            )
        heading, rudder = record.output("psi"), record.input("delta")
        steps = np.diff(heading) / record.sample_time
        right = np.diff(steps) / record.sample_time
        if self.scheme == "forward":
            return np.column_stack([rudder[:-2], steps[:-1]]), right
        return np.column_stack([rudder[1:-1], (steps[1:] + steps[:-1]) / 2]), right
