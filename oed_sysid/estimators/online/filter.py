"""The Kalman filter of states and parameters, fed sample by sample on board."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.estimators.kalman import JointFilter, JointKalmanFilter
from oed_sysid.estimators.online.sample import read_sample
from oed_sysid.fitting.noise_levels import given_levels
from oed_sysid.fitting.start_guess import measured_columns
from oed_sysid.model import Model


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
    >>> from oed_sysid.channels import Output, State
    >>> from oed_sysid.parameters import Parameter
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
        if self.n_samples:
            self._parameters, self._covariance = self._filter.parameters(self._mean, self._spread)
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
            self._mean, self._spread = self._filter.begin(
                time, inputs, seen, self._parameters, self._covariance
            )
            times, commands = np.array([time, time + 1.0]), np.array([inputs, inputs])
        else:
            times = np.array([self._last[0], time])
            commands = np.array([self._last[1], inputs])
        self._mean, self._spread = self._filter.learn(
            self._mean, self._spread, times, commands, outputs, first=self._last is None
        )
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
        return self._filter.parameters(self._mean, self._spread)
