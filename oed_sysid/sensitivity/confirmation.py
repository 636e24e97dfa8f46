"""Does the bound hold: repeated simulated experiments, each of them estimated."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from joblib import Parallel, delayed
from scipy.special import chdtri

from oed_sysid.data.dataset import Dataset
from oed_sysid.display import as_dict
from oed_sysid.errors import DesignError
from oed_sysid.estimators import MultipleShooting
from oed_sysid.experiment import Experiment
from oed_sysid.fitting.fit import Fit
from oed_sysid.model import Model
from oed_sysid.sensitivity.bound import information_of
from oed_sysid.simulation import simulate


class _Estimator(Protocol):
    def fit(self, model: Model, dataset: Dataset) -> Fit: ...


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
        n = self.n_runs - self.n_failed
        low, high = chdtri(n, [0.995, 0.005]) / n
        return float(np.sqrt(low)), float(np.sqrt(high))

    @property
    def confirmed(self) -> bool:
        """Whether all ratios lie in the interval, widened for looking at several."""
        n = self.n_runs - self.n_failed
        tail = 0.005 / max(len(self.names), 1)
        low, high = np.sqrt(chdtri(n, [1 - tail, tail]) / n)
        return bool(np.all((self.ratios > low) & (self.ratios < high)))

    def report(self) -> str:
        """Return the comparison as a table."""
        low, high = self.interval
        lines = [
            f"{self.n_runs} simulated experiments, {self.n_failed} not converged; found/predicted "
            f"lies in {low:.2f} to {high:.2f} with 99 % if the bound is exact: "
            f"{'confirmed' if self.confirmed else 'NOT confirmed'}",
            f"{'parameter':<20} {'predicted':>10} {'found':>10} {'ratio':>6} {'bias/se':>8}"
            f" {'coverage':>8}",
        ]
        for i, name in enumerate(self.names):
            lines.append(
                f"{name:<20} {self.predicted[i]:>10.3g} {self.found[i]:>10.3g} "
                f"{self.ratios[i]:>6.2f} {self.bias[i]:>8.2f} {self.coverage[i]:>8.0%}"
            )
        return "\n".join(lines)

    to_dict = as_dict(
        "names", "predicted", "found", "bias", "coverage", "n_runs", "n_failed", "confirmed"
    )


def confirm_bound(
    model: Model,
    experiments: Experiment | Iterable[Experiment],
    *,
    rng: np.random.Generator,
    n_runs: int = 50,
    estimator: _Estimator | None = None,
    start_model: Model | None = None,
    n_jobs: int = 1,
    progress: Callable[[int], None] | None = None,
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
    estimator : Estimator, optional
        By default :class:`~oed_sysid.estimators.MultipleShooting` with given noise.
    start_model : Model, optional
        Start values of the estimation; the truth by default.
    n_jobs : int
        Processes.
    progress : callable, optional
        Called with the number of runs done (serial runs only).
    """
    planned = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    if n_runs < 3:
        raise DesignError(f"{n_runs} runs cannot confirm anything. Give at least 20.")
    model = _without_priors(model)
    started = model if start_model is None else _without_priors(start_model)
    worker = estimator or MultipleShooting(disturbances="none", noise="given", coloured="never")
    information = information_of(model, planned)
    names, truth = information.names, model.values
    seeds = rng.spawn(n_runs)

    def one(index: int) -> tuple[bool, np.ndarray, np.ndarray]:
        generator = seeds[index]
        data = Dataset(tuple(simulate(model, plan, rng=generator) for plan in planned))
        fit = worker.fit(started, data)
        if progress is not None and n_jobs == 1:
            progress(index + 1)
        errors = np.array([fit.values[name] - truth[name] for name in names])
        return fit.status.ok, errors, np.array([fit.std_errors[name] for name in names])

    results = Parallel(n_jobs=n_jobs)(delayed(one)(index) for index in range(n_runs))
    good = [(errors, stated) for ok, errors, stated in results if ok]
    if len(good) < 3:
        raise DesignError(
            f"Only {len(good)} of {n_runs} estimations converged; the experiments do not determine "
            "the parameters. See information_of(...).null_directions()."
        )
    errors = np.array([errors for errors, _ in good])
    stated = np.array([stated for _, stated in good])
    predicted = information.std_errors
    return Confirmation(
        names=names,
        predicted=predicted,
        found=np.sqrt(np.mean(errors**2, axis=0)),
        bias=errors.mean(axis=0) / predicted,
        coverage=np.mean(np.abs(errors) < 1.96 * stated, axis=0),
        n_runs=n_runs,
        n_failed=n_runs - len(good),
    )


def _without_priors(model: Model) -> Model:
    for parameter in model.free_parameters:
        if parameter.prior_std is not None:
            model = model.with_parameter(replace(parameter, prior_mean=None, prior_std=None))
    return model
