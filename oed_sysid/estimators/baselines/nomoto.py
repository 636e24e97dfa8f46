"""Nomoto's K and T from headings alone, by differences of the heading."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError
from oed_sysid.estimators.baselines.regression_summary import fit_from_values
from oed_sysid.fitting.fit import Fit
from oed_sysid.fitting.start_guess import check_channels
from oed_sysid.model import Model

SCHEMES = ("forward", "central")


@dataclass(frozen=True)
class HeadingDifferences:
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
    heading, rudder, gain, time_constant : str
        Names of the output, the input and the two parameters in the model.

    References
    ----------
    Han, Bai, Yu & Lian (2023), Ship Science and Technology 45(7), doi
    10.3404/j.issn.1672-7649.2023.07.017, eq. 11-15, with the sign of the
    second regressor corrected.
    """

    scheme: str = "forward"
    heading: str = "psi"
    rudder: str = "delta"
    gain: str = "K"
    time_constant: str = "T"

    def __post_init__(self) -> None:
        if self.scheme not in SCHEMES:
            raise ModelError(f"scheme is {self.scheme!r}. Choose one of {', '.join(SCHEMES)}.")

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return f"heading differences ({self.scheme})"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate gain and time constant of a first-order Nomoto model.

        Raises
        ------
        ModelError
            If the model has other free parameters than the two.
        DataError
            If a record is not uniform, or its rows do not determine the two.
        """
        began = time.perf_counter()
        check_channels(model, dataset)
        if set(model.free_names) != {self.gain, self.time_constant}:
            raise ModelError(
                f"Model {model.name!r} has the free parameters {', '.join(model.free_names)}; "
                f"expected {self.gain} and {self.time_constant}. Fix the others, or use "
                "MultipleShooting."
            )
        matrices, rights = [], []
        for record in dataset:
            if not record.is_uniform:
                raise DataError(
                    f"Record {record.name!r} is not sampled uniformly, which differences need."
                )
            matrix, right = self._rows(
                record.output(self.heading), record.input(self.rudder), record.sample_time
            )
            present = np.isfinite(right) & np.isfinite(matrix).all(axis=1)
            matrices.append(matrix[present])
            rights.append(right[present])
        matrix, right = np.vstack(matrices), np.concatenate(rights)
        first, second = np.linalg.lstsq(matrix, right, rcond=None)[0]
        if not second < 0:
            raise DataError(
                "The heading's differences give a time constant that is not positive: the sampling "
                "is too coarse or too noisy for them. Use MultipleShooting."
            )
        # Rows are divided by the sample time, so that first = K/T and second = -1/T.
        values = {self.time_constant: -1.0 / second, self.gain: -first / second}
        errors = right - matrix @ [first, second]
        variance = float(errors @ errors) / max(len(right) - 2, 1)
        inner = variance * np.linalg.inv(matrix.T @ matrix)
        slopes = {
            self.time_constant: np.array([0.0, 1.0 / second**2]),
            self.gain: np.array([-1.0 / second, first / second**2]),
        }
        jacobian = np.array([slopes[name] for name in model.free_names])
        return fit_from_values(
            model,
            dataset,
            estimator=self.name,
            estimates=np.array([values[name] for name in model.free_names]),
            covariance=jacobian @ inner @ jacobian.T,
            began=began,
        )

    def _rows(
        self, heading: np.ndarray, rudder: np.ndarray, step: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rows ``(n, 2)`` and right-hand sides ``(n,)``, as accelerations."""
        right = (heading[2:] - 2 * heading[1:-1] + heading[:-2]) / step**2
        if self.scheme == "forward":
            rate = (heading[1:-1] - heading[:-2]) / step
            return np.column_stack([rudder[:-2], rate]), right
        rate = (heading[2:] - heading[:-2]) / (2 * step)
        return np.column_stack([rudder[1:-1], rate]), right
