r"""Information of manoeuvres, before any data exist: the Cramer-Rao bound.

Of a run with whitened sensitivities :math:`J = \Sigma^{-1/2}\, \partial y / \partial(x_0, p)`,
or with derivatives of the innovations in units of their deviations where disturbance forces act,
start states and parameters of the run are eliminated by a triangular factor with them in front,

.. math::
    J = Q \begin{pmatrix} R_{00} & R_{0p} \\ 0 & R_{pp} \end{pmatrix}, \qquad
    F = \sum_r R_{pp,r}' R_{pp,r} + F_0, \qquad \mathrm{cov}(\hat p) \ge F^{-1}

(:math:`R_{pp}' R_{pp}` is the Schur complement of :math:`J'J`). :class:`RunInformation` is the one
evaluation of it: for one run or many, parameters alone or with absent effects beside them.
:func:`confirm_bound` asks whether the bound holds, by repeated simulation and estimation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import chdtri

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DesignError, OedSysidError, located, respelled
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information.noise import Levels, noise_of
from oed_sysid.information.response import (
    SAYS,
    CommandedRun,
    Innovations,
    Run,
    commanded_runs,
    expected_noise,
    respond,
)
from oed_sysid.information.shifts import Shifts
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import TWO_SIDED_95, Report, Section, Table, as_dict, as_text

# Coloured sensors have one description.
COLOURED = {"coloured": "noise=NoiseModel(..., colour=..., colour_time=...)"}


@respelled(DesignError, COLOURED)
def information_of(
    model: Model,
    runs: Run | Dataset | Iterable[Run],
    *,
    noise: Levels | NoiseModel | Fit = None,
    priors: str | Mapping[str, float] | Information | None = "model",
    start: str | Mapping[str, float] = "unknown",
    initial_states: Sequence[Mapping[str, float] | np.ndarray] | None = None,
    outputs: Sequence[str] | None = None,
) -> Information:
    r"""Information that manoeuvres hold on a model's free parameters.

    .. math:: F = \sum_r J_r' \Sigma_r^{-1} J_r + F_0

    with the start states of every run, and parameters that differ from run to
    run, eliminated: the bound is the one of an estimator that has to find them
    too. Values of the model are taken as true, noise as Gaussian. Under random
    forces or coloured sensors (a noise model, or that of a fit) it is the
    information of the innovations (:mod:`oed_sysid.information.response`):
    residuals of disturbed records are far from white, and a bound that takes
    them for white promises errors several times too small.

    Parameters
    ----------
    model : Model
        The model, at the values in question.
    runs : Experiment, Record, Dataset or iterable of these
        Planned manoeuvres, records in hand, or both.
    noise : mapping or sequence of float, NoiseModel or Fit, optional
        Standard deviations of the outputs' noise, ``noise_std`` by default; or
        a noise model with disturbance forces, or a fit that found one.
    priors : {"model", None}, mapping of str to float, or Information
        What is known besides: the parameters' own ``prior_std``, nothing,
        standard deviations, or the information of earlier data.
    start : {"unknown", "known"} or mapping of str to float
        Start states are estimated too, exactly known, or known with these
        standard deviations (those left out are unknown).
    initial_states : sequence, optional
        See :func:`~oed_sysid.information.response.commanded_runs`.
    outputs : sequence of str, optional
        Outputs that are measured; by default all.

    Returns
    -------
    Information
        Of the free parameters that all runs share, in the model's order.

    Raises
    ------
    DesignError, SimulationError
        If noise is not known, or a run diverges.

    Examples
    --------
    >>> from oed_sysid import Experiment, Input, Model, Output, Parameter, State
    >>> from oed_sysid.experiments.manoeuvres import Doublet
    >>> nomoto = Model(
    ...     "Nomoto", (State("r", "rad/s"),), (Input("rudder", "rad"),),
    ...     (Output("r", "rad/s", noise_std=1e-3),), {"r": "(K*rudder - r)/T"},
    ...     parameters=(Parameter("K", 0.1, "1/s"), Parameter("T", 10.0, "s")),
    ... )
    >>> test = Experiment("doublet", Doublet("rudder", 0.2, pulse_time=20.0), duration=80.0)
    >>> known = information_of(nomoto, test, start="known")
    >>> print(known.names, known.std_errors.round(5))
    ('K', 'T') [0.00056 0.08128]
    """
    expected = RunInformation(model, noise, start, outputs)
    listed = commanded_runs(model, runs, initial_states=initial_states)
    return expected.joint([expected.factor(given) for given in listed], priors)


class RunInformation:
    """Information of single runs of one model under one noise, made ready once.

    Parameters
    ----------
    model, noise, start, outputs
        See :func:`information_of`.
    shifts : Shifts, optional
        Absent effects, kept beside the parameters.
    """

    def __init__(
        self,
        model: Model,
        noise: Levels | NoiseModel | Fit = None,
        start: str | Mapping[str, float] = "unknown",
        outputs: Sequence[str] | None = None,
        shifts: Shifts | None = None,
    ) -> None:
        lacking = f"Model {model.name!r} has no output"
        located(DesignError, lacking, outputs or (), model.output_names)
        disturbed, self._levels = expected_noise(model, noise)
        self._model, self._start, self._outputs = model, start, outputs
        self._shifts = shifts
        self._innovations = None if disturbed is None else Innovations.of(model, disturbed)

    def factor(self, given: CommandedRun) -> np.ndarray:
        """Factor of one run on the shared parameters and absent effects, ``(n, n)``."""
        model = self._model
        if self._outputs is not None:
            measured = [name in self._outputs for name in model.output_names]
            given = replace(given, present=given.present & measured)
        moved = None if self._shifts is None else partial(self._shifts.columns, given)
        if self._innovations is not None:
            return eliminated(model, self._innovations.rows(given, moved), self._start)
        response = respond(model, given)
        jacobian, sigma = response.jacobian, noise_of(model, self._levels, changed=given.noise)
        if moved is not None:
            jacobian = np.concatenate([jacobian, moved(response.outputs)], axis=2)
        white = np.where(given.present[:, :, None], jacobian / sigma[:, None], 0.0)
        return eliminated(model, white.reshape(-1, white.shape[2]), self._start)

    def matrix(self, run: Run) -> np.ndarray | None:
        """Information of a run alone, SI units, effects in units of their size.

        None where it diverges.
        """
        try:
            factor = self.factor(commanded_runs(self._model, run)[0])
        except OedSysidError:
            return None
        return factor.T @ factor

    def joint(
        self,
        factors: Sequence[np.ndarray],
        priors: str | Mapping[str, float] | Information | None,
    ) -> Information:
        """Information of several runs and what is known besides."""
        names = self._model.shared_names
        rows = np.vstack([*factors, prior_factor(self._model, names, priors)])
        scales = np.array([self._model.parameter(name).magnitude for name in names])
        return Information.from_jacobian(names, rows, scales)


def unknowns(model: Model, start: str | Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Columns of a run's derivatives that are kept: its own unknowns, then shared parameters.

    Parameters
    ----------
    model : Model
    start
        See :func:`information_of`; start states that are known exactly are left out.

    Returns
    -------
    columns : ndarray of int (n_kept,)
        Among own start states and free parameters.
    weights : ndarray (n_own_unknown,)
        Of the run's own unknowns, the first columns: 1 / std of what is known, or 0.
    """
    by_state = start_weights(model, start)
    states = np.flatnonzero(np.isfinite(by_state))
    own = np.array([parameter.per_record for parameter in model.free_parameters], dtype=bool)
    spreads = [p.prior_spread or np.inf for p in model.free_parameters if p.per_record]
    # A stable sort keeps the model's order within own and within shared parameters.
    order = len(by_state) + np.argsort(~own, kind="stable")
    return np.append(states, order), np.append(by_state[states], 1.0 / np.array(spreads))


def eliminated(
    model: Model, white: np.ndarray, start: str | Mapping[str, float] = "unknown"
) -> np.ndarray:
    """Factor on the shared parameters of whitened rows, start and own parameters eliminated.

    Parameters
    ----------
    model : Model
    white : ndarray (n_rows, n_own + n_free + n_more)
        By start states, free parameters, and whatever else is kept, in units of the noise.
    start
        See :func:`information_of`.

    Returns
    -------
    ndarray (n, n)
        Upper triangular, by shared parameters and what else is kept.
    """
    columns, weights = unknowns(model, start)
    more = range(len(model.states) + len(model.free_parameters), white.shape[1])
    rows = np.take(white, [*columns, *more], axis=1)
    if weights.any():
        # What is known of a start or of a run's own value is one more observation of it.
        known = weights[:, None] * np.eye(len(weights), rows.shape[1])
        rows = np.vstack([rows, known[weights > 0]])
    # R_pp: the unknowns in front are those eliminated.
    return triangle(rows)[len(weights) :, len(weights) :]


def triangle(rows: np.ndarray) -> np.ndarray:
    """Upper-triangular ``R`` with ``R'R = rows' rows``, shape ``(n, n)``.

    By Householder reflections, so that null directions stay null.
    """
    n = rows.shape[1]
    rows = np.vstack([rows, np.zeros((max(n - len(rows), 0), n))])
    return np.asarray(np.linalg.qr(rows, mode="r"))


def prior_factor(
    model: Model, names: Sequence[str], priors: str | Mapping[str, float] | Information | None
) -> np.ndarray:
    """Factor of what is known besides, shape ``(n_rows, n_names)``."""
    if priors is None:
        return np.zeros((0, len(names)))
    if isinstance(priors, Information):
        lacking = f"The prior is about more than is free: model {model.name!r} has no"
        columns = located(DesignError, lacking, priors.names, names)
        rows = np.zeros((len(priors.factor), len(names)))
        rows[:, columns] = priors.factor / priors.scales
        return rows
    if isinstance(priors, str):
        if priors != "model":
            raise DesignError(SAYS["priors"].format(priors=priors))
        own = {p.name: p.prior_spread for p in model.free_parameters if p.name in names}
        priors = {name: std for name, std in own.items() if std is not None}
    return np.diag(_weights("prior", names, priors))


def start_weights(model: Model, start: str | Mapping[str, float]) -> np.ndarray:
    """Weights of the start states: 0 unknown, infinity known, else 1 / std; shape ``(n_own,)``."""
    names = model.state_names
    if not isinstance(start, str):
        return _weights("start deviation", names, start, exact=True)
    if start not in ("unknown", "known"):
        raise DesignError(
            f"start is {start!r}. Choose 'unknown', 'known', or standard deviations by state."
        )
    return np.full(len(names), 0.0 if start == "unknown" else np.inf)


def _weights(
    what: str, names: Sequence[str], stds: Mapping[str, float], *, exact: bool = False
) -> np.ndarray:
    """One over standard deviations, 0 where nothing is known, infinity of what is exact."""
    for name, std in stds.items():
        if name not in names or not (std > 0 or (exact and std == 0)):
            raise DesignError(
                f"The {what} {name!r}: {std} is of no use. Give a {'' if exact else 'positive '}"
                f"standard deviation of one of {', '.join(names)}."
            )
    with np.errstate(divide="ignore"):
        return 1.0 / np.array([float(stds.get(name, np.inf)) for name in names])


@dataclass(frozen=True, eq=False)
class Confirmation:
    """Predicted and found accuracy of repeated simulated experiments.

    Attributes
    ----------
    names : tuple of str
    predicted : ndarray (n_names,)
        Standard errors from the Cramer-Rao bound.
    found : ndarray (n_names,)
        Root mean square of estimate minus truth.
    bias : ndarray (n_names,)
        Mean of estimate minus truth, in predicted standard errors.
    coverage : ndarray (n_names,)
        Share of runs whose reported 95 % interval holds the truth.
    n_runs, n_failed : int
        Runs, and those whose estimation did not converge (not counted above).

    Examples
    --------
    What :func:`confirm_bound` returns; see there.
    """

    names: tuple[str, ...]
    predicted: np.ndarray
    found: np.ndarray
    bias: np.ndarray
    coverage: np.ndarray
    n_runs: int
    n_failed: int

    @property
    def ratios(self) -> np.ndarray:
        """Found over predicted error, shape ``(n_names,)``."""
        return self.found / self.predicted

    @property
    def interval(self) -> tuple[float, float]:
        """Range in which 99 % of the ratios fall if the bound is exact."""
        return self._range(0.005)

    @property
    def confirmed(self) -> bool:
        """Whether all ratios lie in the interval, widened for looking at several."""
        low, high = self._range(0.005 / max(len(self.names), 1))
        return bool(np.all((self.ratios > low) & (self.ratios < high)))

    def _range(self, tail: float) -> tuple[float, float]:
        """Range of a ratio with this probability beyond either end."""
        n = self.n_runs - self.n_failed
        low, high = np.sqrt(chdtri(n, [1 - tail, tail]) / n)
        return float(low), float(high)

    def document(self) -> Report:
        """Return the comparison as a table."""
        low, high = self.interval
        title = (
            f"{self.n_runs} simulated experiments, {self.n_failed} not converged; found/predicted "
            f"lies in {low:.2f} to {high:.2f} with 99 % if the bound is exact: "
            f"{'confirmed' if self.confirmed else 'NOT confirmed'}"
        )
        columns = (self.predicted, self.found, self.ratios, self.bias, self.coverage)
        rows = [
            (name, f"{p:.3g}", f"{f:.3g}", f"{ratio:.2f}", f"{bias:.2f}", f"{100 * held:.0f} %")
            for name, p, f, ratio, bias, held in zip(self.names, *columns, strict=True)
        ]
        headers = ("parameter", "predicted", "found", "ratio", "bias/se", "coverage")
        return Report(title, sections=(Section("Bound", tables=(Table(headers, rows),)),))

    report = as_text

    to_dict = as_dict(
        "names", "predicted", "found", "bias", "coverage", "n_runs", "n_failed", "confirmed"
    )


def confirm_bound(
    model: Model,
    experiments: Experiment | Iterable[Experiment],
    *,
    rng: np.random.Generator,
    n_runs: int = 50,
) -> Confirmation:
    """Compare the bound with the errors of actual estimations.

    Each run simulates all experiments with fresh noise and estimates all free
    parameters and start states from them. Priors are left out: estimates that
    are drawn to the truth itself would scatter less than any bound says.

    Parameters
    ----------
    model : Model
        The truth; outputs need ``noise_std``.
    experiments : Experiment or iterable of Experiment
        What is run.
    rng : numpy.random.Generator
        Source of the noise.
    n_runs : int
        Repetitions.

    Returns
    -------
    Confirmation
        Predicted and found errors by parameter.

    Raises
    ------
    DesignError
        If there are too few runs, or too few of their estimations converge.

    Examples
    --------
    Of a problem's truth and one of its experiments::

        confirm_bound(problem.true_model(), experiment, rng=np.random.default_rng(0), n_runs=50)
    """
    planned = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    if n_runs < 3:
        raise DesignError(f"{n_runs} runs cannot confirm anything. Give at least 20.")
    for parameter in model.free_parameters:
        # A prior at the truth would pull every estimate there and flatter the bound.
        model = model.with_parameter(replace(parameter, prior_mean=None, prior_std=None))
    worker = MultipleShooting(disturbances="none", noise="given", coloured="never")
    information = information_of(model, planned)
    names, truth = information.names, model.values

    def one(generator: np.random.Generator) -> tuple[bool, np.ndarray, np.ndarray]:
        fit = worker.fit(model, Dataset(tuple(simulate(model, p, rng=generator) for p in planned)))
        errors = np.array([fit.values[name] - truth[name] for name in names])
        return fit.status.ok, errors, np.array([fit.std_errors[name] for name in names])

    good = [(errors, stated) for ok, errors, stated in map(one, rng.spawn(n_runs)) if ok]
    if len(good) < 3:
        raise DesignError(SAYS["few_converged"].format(n=len(good), n_runs=n_runs))
    errors, stated = (np.array(part) for part in zip(*good, strict=True))
    predicted = information.std_errors
    return Confirmation(
        names=names,
        predicted=predicted,
        found=np.sqrt(np.mean(errors**2, axis=0)),
        bias=errors.mean(axis=0) / predicted,
        coverage=np.mean(np.abs(errors) < TWO_SIDED_95 * stated, axis=0),
        n_runs=n_runs,
        n_failed=n_runs - len(good),
    )
