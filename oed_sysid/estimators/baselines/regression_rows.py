"""From measured records to the rows of a regression: where derivatives come from.

=============  ==================================================================
``euler``      :math:`(x_{k+1} - x_k)/h`, forces at the first of the two samples
``trapezoid``  the same difference, forces averaged over both samples
``simpson``    :math:`(x_{k+2} - x_k)/2h`, forces averaged with 1:4:1
``local``      value and slope of a cubic fitted to the samples around
``exact``      rates that are given
=============  ==================================================================

In all but the first the same average is taken on both sides of the equation,
so that the rows are unbiased for smooth motion and noise-free states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError
from oed_sysid.estimators.baselines.regression_form import RegressionForm, regression_form
from oed_sysid.fitting.start_guess import check_channels
from oed_sysid.model import Model
from oed_sysid.simulation.trajectory import input_array

RULES = ("euler", "trapezoid", "simpson", "local", "exact")

Rates = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows ``target = regressors @ parameters + error`` of all records.

    Attributes
    ----------
    form : RegressionForm
        Equations and names.
    targets : tuple of ndarray (n_rows, n_equations)
        One array per record; NaN where a measurement is missing.
    regressors : tuple of ndarray (n_rows, n_equations, n_free)
        NaN in the same rows.
    """

    form: RegressionForm
    targets: tuple[np.ndarray, ...]
    regressors: tuple[np.ndarray, ...]

    def equation(self, index: int) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """Complete rows of one equation, over all records.

        Returns
        -------
        regressors : ndarray (n_rows, n_parameters)
        target : ndarray (n_rows,)
        names : tuple of str
            Parameters of this equation.
        """
        target = np.concatenate([t[:, index] for t in self.targets])
        regressors = np.vstack([r[:, index] for r in self.regressors])
        rows = np.isfinite(target) & np.isfinite(regressors).all(axis=1)
        used = np.flatnonzero(np.nan_to_num(regressors).any(axis=0))
        names = tuple(self.form.names[i] for i in used)
        return regressors[rows][:, used], target[rows], names

    def check_separate(self) -> None:
        """Raise :class:`ModelError` where two equations share a parameter."""
        owner: dict[str, str] = {}
        for index, equation in enumerate(self.form.equations):
            for name in self.equation(index)[2]:
                if name in owner:
                    raise ModelError(
                        f"{name} appears in the equations of {owner[name]} and of {equation}; "
                        "this estimator solves each equation alone. Use EquationError, which "
                        "solves them together."
                    )
                owner[name] = equation


def rows_of(
    form: RegressionForm,
    dataset: Dataset,
    *,
    rule: str = "local",
    window: int = 9,
    rates: Rates | None = None,
) -> Rows:
    """Build the rows of all records.

    Parameters
    ----------
    form : RegressionForm
        The model's equations.
    dataset : Dataset
        Records with the model's channels.
    rule : str
        One of :data:`RULES`.
    window : int
        Samples of a local cubic, odd.
    rates : mapping of str to ndarray (n_times, n_states), optional
        For ``"exact"``: rates of all states, by record.
    """
    check_rule(rule, window)
    check_channels(form.model, dataset)
    targets, regressors = [], []
    for record in dataset:
        states = states_of(form, record.outputs)
        given = None
        if rule == "exact":
            given = (rates or {}).get(record.name)
            if given is None or np.shape(given) != states.shape:
                raise DataError(
                    f"Exact rates of record {record.name!r} are missing or not of shape "
                    f"{states.shape}, one column for each of {', '.join(form.graph.state_names)}."
                )
        pair = rows_from(form, record.times, states, record.inputs, rule, window, given)
        targets.append(pair[0])
        regressors.append(pair[1])
    return Rows(form, tuple(targets), tuple(regressors))


def rows_from(
    form: RegressionForm,
    times: np.ndarray,
    states: np.ndarray,
    inputs: np.ndarray,
    rule: str,
    window: int = 9,
    rates: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Targets and regressors of one run, see :func:`rows_of`."""
    after, before = actuator_signals(form, times, inputs)
    if rates is not None:
        return form.evaluate(states, np.asarray(rates, float), after, times)
    return _RULES[rule](form, times, states, after, before, window)


def check_rule(rule: str, window: int) -> None:
    """Raise :class:`ModelError` for an unknown rule or an impossible window."""
    if rule not in RULES:
        raise ModelError(f"rule is {rule!r}. Choose one of {', '.join(RULES)}.")
    if window < 5 or window % 2 == 0:
        raise ModelError(f"window is {window}. Give an odd number of samples, 5 or more.")


def exact_rates(model: Model, dataset: Dataset) -> dict[str, np.ndarray]:
    """Rates of a model at the measured states, for tests on simulated records.

    Every state has to be measured. The rates are those just after each sample.

    Returns
    -------
    dict of str to ndarray (n_times, n_states)
    """
    form = regression_form(model)
    found = {}
    for record in dataset:
        states = states_of(form, record.outputs)
        signals, _ = actuator_signals(form, record.times, record.inputs)
        rates = form.graph.rates(states.T, signals.T, model.value_vector, record.times[None, :])
        found[record.name] = np.array(rates).T
    return found


def states_of(form: RegressionForm, outputs: np.ndarray) -> np.ndarray:
    """Measured states ``(n_times, n_states)``; zero where an equation needs none."""
    sources = {output.source: column for column, output in enumerate(form.model.outputs)}
    states = np.zeros((len(outputs), len(form.graph.state_names)))
    for index, name in enumerate(form.graph.state_names):
        if name in sources:
            series = outputs[:, sources[name]]
            unused = name not in form.needed and not np.isfinite(series).all()
            states[:, index] = 0.0 if unused else series
    return states


def actuator_signals(
    form: RegressionForm, times: np.ndarray, inputs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Actuator signals just after and just before the samples.

    Returns
    -------
    after : ndarray (n_times, n_signals)
        At the beginning of the step that follows each sample.
    before : ndarray (n_times, n_signals)
        At the end of the step that led to it; of the first sample, ``after``.
    """
    graph, model = form.graph, form.model
    inputs = input_array(model, len(times), inputs)
    values = model.value_vector
    linear = np.array(graph.linear_inputs, dtype=bool)
    size = graph.actuate.size1_out(0)
    after, before = np.empty((len(times), size)), np.empty((len(times), size))
    if not size:
        return after, before
    if graph.n_actuator_memory == 0:
        steps = np.diff(times, append=2 * times[-1] - times[-2])
        empty = np.empty((0, len(times)))
        h = np.minimum(steps, model.step)

        def signals(commands: np.ndarray) -> np.ndarray:
            found = graph.actuate(empty, commands.T, values, times[None, :], h[None, :])[0]
            return np.array(found).T

        after[:] = signals(inputs)
        ends = np.where(linear, inputs[1:], inputs[:-1]) if inputs.shape[1] else inputs[:-1]
        before[:] = after
        before[1:] = signals(np.vstack([ends, inputs[-1:]]))[:-1]
        return after, before
    own = np.zeros(graph.n_own)
    z = np.array(graph.start(own, inputs[0], values, times[0])).ravel()
    memory = z[graph.n_states : graph.n_states + graph.n_actuator_memory]
    for k, time in enumerate(times):
        interval = times[k + 1] - time if k + 1 < len(times) else times[k] - times[k - 1]
        following = inputs[min(k + 1, len(times) - 1)]
        n_steps = max(1, int(np.ceil(interval / model.step - 1e-9)))
        h = interval / n_steps
        slope = np.where(linear, (following - inputs[k]) / n_steps, 0.0)
        for i in range(n_steps):
            begin, end = inputs[k] + i * slope, inputs[k] + (i + 1) * slope
            arguments = (values, time + i * h, h)
            if i == 0:
                after[k] = np.array(graph.actuate(memory, begin, *arguments)[0]).ravel()
                if k == 0:
                    before[0] = after[0]
            if k + 1 < len(times) and i + 1 == n_steps:
                before[k + 1] = np.array(graph.actuate(memory, end, *arguments)[0]).ravel()
            moved = graph.actuate(memory, (begin + end) / 2, *arguments)[1]
            memory = np.array(moved).ravel()
    return after, before


Pair = tuple[np.ndarray, np.ndarray]


def _mean(pairs: list[tuple[float, Pair]]) -> Pair:
    return (
        sum(weight * pair[0] for weight, pair in pairs),  # type: ignore[return-value]
        sum(weight * pair[1] for weight, pair in pairs),
    )


def _euler(
    form: RegressionForm, times: np.ndarray, x: np.ndarray, after: np.ndarray, *_: object
) -> Pair:
    rates = np.diff(x, axis=0) / np.diff(times)[:, None]
    return form.evaluate(x[:-1], rates, after[:-1], times[:-1])


def _trapezoid(
    form: RegressionForm,
    times: np.ndarray,
    x: np.ndarray,
    after: np.ndarray,
    before: np.ndarray,
    _: int,
) -> Pair:
    rates = np.diff(x, axis=0) / np.diff(times)[:, None]
    first = form.evaluate(x[:-1], rates, after[:-1], times[:-1])
    last = form.evaluate(x[1:], rates, before[1:], times[1:])
    return _mean([(0.5, first), (0.5, last)])


def _simpson(
    form: RegressionForm,
    times: np.ndarray,
    x: np.ndarray,
    after: np.ndarray,
    before: np.ndarray,
    _: int,
) -> Pair:
    steps = np.diff(times)
    rates = (x[2:] - x[:-2]) / (times[2:] - times[:-2])[:, None]
    even = np.abs(steps[1:] - steps[:-1]) < 1e-3 * steps[1:]
    rates[~even] = np.nan  # Simpson's weights hold for equal steps only
    first = form.evaluate(x[:-2], rates, after[:-2], times[:-2])
    to_middle = form.evaluate(x[1:-1], rates, before[1:-1], times[1:-1])
    from_middle = form.evaluate(x[1:-1], rates, after[1:-1], times[1:-1])
    last = form.evaluate(x[2:], rates, before[2:], times[2:])
    return _mean([(1 / 6, first), (1 / 3, to_middle), (1 / 3, from_middle), (1 / 6, last)])


def _local(
    form: RegressionForm,
    times: np.ndarray,
    x: np.ndarray,
    after: np.ndarray,
    before: np.ndarray,
    window: int,
) -> Pair:
    smooth, rates = local_cubic(times, x, window)
    first = form.evaluate(smooth, rates, after, times)
    last = form.evaluate(smooth, rates, before, times)
    return _mean([(0.5, first), (0.5, last)])


_RULES: dict[str, Callable[..., Pair]] = {
    "euler": _euler,
    "trapezoid": _trapezoid,
    "simpson": _simpson,
    "local": _local,
}


def local_cubic(times: np.ndarray, series: np.ndarray, window: int) -> tuple[np.ndarray, ...]:
    """Value and slope of cubics fitted to ``window`` samples around each time.

    Parameters
    ----------
    times : ndarray (n_times,)
        Any increasing times.
    series : ndarray (n_times, n_signals)
        A missing sample makes the values that need it NaN.
    window : int
        Odd number of samples; at the ends the cubic is one-sided.

    Returns
    -------
    values, slopes : ndarray (n_times, n_signals)

    References
    ----------
    Savitzky & Golay (1964), Smoothing and differentiation of data by
    simplified least squares procedures, Analytical Chemistry 36.
    """
    n = len(times)
    width = min(window, n)
    first = np.clip(np.arange(n) - width // 2, 0, n - width)
    index = first[:, None] + np.arange(width)
    offset = times[index] - times[:, None]
    scale = np.abs(offset).max(axis=1)
    basis = (offset / scale[:, None])[:, :, None] ** np.arange(min(4, width))
    weights = np.linalg.pinv(basis)  # (n, order, width)
    values = np.einsum("nw,nws->ns", weights[:, 0], series[index])
    slopes = np.einsum("nw,nws->ns", weights[:, 1], series[index]) / scale[:, None]
    return values, slopes
