"""From a model and a stream of samples to the features and targets of its equations."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.estimators.baselines.regression_form import regression_form
from oed_sysid.estimators.baselines.regression_rows import check_rule, rows_from, states_of
from oed_sysid.estimators.online.sample import read_sample
from oed_sysid.model import Model

# Samples that each rule needs for one row, and which row of them is the newest.
SPANS = {"euler": 2, "trapezoid": 2, "simpson": 3}


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
        :mod:`oed_sysid.estimators.baselines.regression_rows`; a row is ready one or two
        samples late.

    Examples
    --------
    >>> from oed_sysid.channels import Input, Output, State
    >>> from oed_sysid.effects import Force
    >>> from oed_sysid.estimators.online import RecursiveLeastSquares
    >>> from oed_sysid.parameters import Parameter
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
        self.form = regression_form(model)
        if self.form.graph.n_actuator_memory:
            raise ModelError(
                f"Model {model.name!r} has actuators with memory. Feed the measured actuator "
                "signals as inputs and leave the actuator effects out with model.without(...)."
            )
        self._owners = self._find_owners()
        self._samples: deque[tuple[float, np.ndarray, np.ndarray]] = deque(maxlen=SPANS[rule])

    def _find_owners(self) -> tuple[np.ndarray, ...]:
        """Positions of the free parameters that each equation holds."""
        form, model = self.form, self.model
        rng = np.random.default_rng(0)
        n, n_states = 8, len(form.graph.state_names)
        _, regressors = form.evaluate(
            rng.uniform(0.5, 1.5, (n, n_states)),
            rng.uniform(0.5, 1.5, (n, n_states)),
            rng.uniform(0.5, 1.5, (n, form.graph.actuate.size1_out(0))),
            np.arange(n, dtype=float) + 0.5 * model.step,
        )
        return tuple(np.flatnonzero(block.any(axis=0)) for block in regressors.transpose(1, 0, 2))

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
        inputs, outputs = read_sample(
            self.model,
            time,
            sample,
            after=self._samples[-1][0] if self._samples else None,
            anew="Start a new stream for a new run.",
        )
        self._samples.append((time, inputs, outputs))
        if len(self._samples) < SPANS[self.rule]:
            return []
        targets, regressors = self._latest()
        return [
            StreamRow(equation, regressors[i, owners], float(targets[i]))
            for i, (equation, owners) in enumerate(
                zip(self.form.equations, self._owners, strict=True)
            )
            if np.isfinite(targets[i]) and np.isfinite(regressors[i, owners]).all()
        ]

    def _latest(self) -> tuple[np.ndarray, np.ndarray]:
        """Newest row of targets ``(n_equations,)`` and regressors ``(n_equations, n_free)``."""
        times, inputs, outputs = (np.array(part) for part in zip(*self._samples, strict=True))
        states = states_of(self.form, outputs)
        targets, regressors = rows_from(self.form, times, states, inputs, self.rule)
        return targets[-1], regressors[-1]
