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

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from oed_sysid.baselines.equations import (
    SPANS,
    RegressionForm,
    check_rule,
    regression_form,
    rows_from,
    states_of,
)
from oed_sysid.baselines.kalman import JointFilter, JointKalmanFilter
from oed_sysid.baselines.machines import (
    IncrementalLSSVM,
    OnlineRegression,
    RecursiveLeastSquares,
    RecursiveLSSVM,
)
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.noise_levels import given_levels
from oed_sysid.likelihood.start_guess import measured_columns
from oed_sysid.physics.model import Model

__all__ = [
    "EquationStream",
    "IncrementalLSSVM",
    "KalmanStream",
    "OnlineRegression",
    "RecursiveLSSVM",
    "RecursiveLeastSquares",
]


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
    >>> from oed_sysid.baselines.online import RecursiveLeastSquares
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
