"""Equation error: least squares on the equations of motion themselves."""

from __future__ import annotations

import time
from dataclasses import dataclass

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.estimators.baselines.regression_form import regression_form
from oed_sysid.estimators.baselines.regression_rows import Rates, check_rule, rows_of
from oed_sysid.estimators.baselines.regression_solution import solve_rows
from oed_sysid.estimators.baselines.regression_summary import fit_from_values
from oed_sysid.fitting.fit import Fit
from oed_sysid.model import Model


@dataclass(frozen=True)
class EquationError:
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
        :mod:`oed_sysid.estimators.baselines.regression_rows`.
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
    >>> from oed_sysid.channels import Input, Output, State
    >>> from oed_sysid.effects import Force
    >>> from oed_sysid.experiment import Experiment
    >>> from oed_sysid.manoeuvres import Doublet
    >>> from oed_sysid.parameters import Parameter
    >>> from oed_sysid.simulation import simulate
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

    rule: str = "local"
    window: int = 9
    rates: Rates | None = None
    coloured: str = "auto"

    def __post_init__(self) -> None:
        check_rule(self.rule, self.window)
        if self.coloured not in ("auto", "never", "always"):
            raise ModelError(f"coloured is {self.coloured!r}. Choose auto, never or always.")
        if (self.rule == "exact") != (self.rates is not None):
            raise ModelError("Exact rates and rule='exact' belong together: give both or none.")

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        window = f", {self.window} samples" if self.rule == "local" else ""
        return f"equation error ({self.rule} derivatives{window})"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate the free parameters from all records at once.

        Raises
        ------
        ModelError
            If the model is not linear in its free parameters or a state is not
            measured; the message says which and what to do.
        DataError
            If data and model do not belong together.
        """
        began = time.perf_counter()
        form = regression_form(model)
        rows = rows_of(form, dataset, rule=self.rule, window=self.window, rates=self.rates)
        solved = solve_rows(rows, model, coloured=self.coloured)
        levels = dict(zip(form.equations, map(float, solved.levels), strict=True))
        return fit_from_values(
            model,
            dataset,
            estimator=self.name,
            estimates=solved.estimates,
            covariance=solved.covariance,
            information=solved.information,
            coloured=solved.coloured,
            began=began,
            extras={"equation_errors": levels, "equation_residuals": solved.residuals},
        )


def is_linear(model: Model) -> bool:
    """Whether :class:`EquationError` can be used on a model at all.

    Examples
    --------
    >>> from oed_sysid.channels import Output, State
    >>> from oed_sysid.parameters import Parameter
    >>> lag = Model(
    ...     "lag", (State("x", "m"),), (), (Output("x", "m"),), {"x": "-x/T"},
    ...     parameters=(Parameter("T", 1.0, "s"),),
    ... )
    >>> is_linear(lag)
    False
    """
    try:
        regression_form(model)
    except ModelError:
        return False
    return True
