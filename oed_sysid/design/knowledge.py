r"""What is known before a run, and what the run is expected to tell.

With knowledge :math:`F_0` in hand (a fit, priors) and the information :math:`F(u; \hat\theta)` of
a run, start states eliminated, both on the shared parameters in units :math:`\theta_s` of their
sizes and on absent effects in units of theirs,

.. math::
    M(u) = D \left(F_0 + F(u; \hat\theta)\right) D, \qquad D = \mathrm{diag}(\theta_s, 1),
    \qquad \text{worth} = \varphi(M)

with the criterion :math:`\varphi` of :mod:`oed_sysid.design.criteria` or
:mod:`oed_sysid.design.criteria`. Designs, programmes and decisions all take the expected
information from here; disturbance forces and autocorrelated sensors are in :math:`F`
(:mod:`oed_sysid.information.bound`).

A search sees white noise. Its levels are raised by one factor until a run is worth to it what it
is worth under the forces,

.. math:: \kappa^2 = (\det M^{white} / \det M)^{1/n}
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.design import criteria
from oed_sysid.design.vehicles import check_spread
from oed_sysid.errors import DesignError
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.information.bound import RunInformation, information_of, prior_factor
from oed_sysid.information.noise import noise_of
from oed_sysid.information.response import Levels, commanded_runs, expected_noise
from oed_sysid.information.shifts import Shifts
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known before a run, how well, and the noise to expect.

    Parameters
    ----------
    prior : {"auto", None} or Information
        Of a fit its information, of a model the parameters' ``prior_std``; None ignores both.
    start : {"unknown", "known"} or mapping of str to float
        See :func:`~oed_sysid.information.information_of`.
    noise : optional
        Standard deviations, a noise model with disturbance forces, or a fit; by default the fit's
        noise, disturbance forces included, or the model's ``noise_std``.
    spread : float or None
        Relative half-width of uniform draws of vehicles that are possible; None draws from what
        is known (prior standard deviations, or the fit).

    Examples
    --------
    >>> Knowledge(prior=None, start="known").start
    'known'
    """

    prior: str | Information | None = "auto"
    start: str | Mapping[str, float] = "unknown"
    noise: Levels | NoiseModel | Fit = None
    spread: float | None = None

    def __post_init__(self) -> None:
        if isinstance(self.prior, str) and self.prior != "auto":
            raise DesignError(f"prior is {self.prior!r}. Choose 'auto', None or an Information.")
        check_spread(self.spread)

    def before(self, given: Model | Fit, model: Model) -> Information | None:
        """What is known before the run, on all shared free parameters."""
        names = model.shared_names
        if self.prior is None:
            return None
        known: Information | str = "model"
        if isinstance(self.prior, Information):
            known = self.prior
        elif isinstance(given, Fit):
            known = _information(given)
        if not (rows := prior_factor(model, names, known)).any():
            return None
        scales = np.array([model.parameter(name).magnitude for name in names])
        return Information.from_jacobian(names, rows, scales)


@dataclass(frozen=True, eq=False)
class ExpectedInformation:
    """What runs are expected to tell a criterion, for one nominal vehicle.

    Attributes
    ----------
    model : Model
        At the values in question, with the sensors' levels in use.
    criterion : Criterion
    sigma : ndarray (n_outputs,)
        Standard deviations of the sensors' noise, white and coloured together.
    sea : NoiseModel or None
        Disturbance forces and autocorrelated sensors, if any.
    prior : Information or None
        Known before, on the shared parameters.
    before : ndarray (n, n)
        The same in SI units, effects in units of their size beside it: with a fit, what its
        records would have shown of them.
    start
        See :class:`Knowledge`.
    shifts : Shifts or None
        Absent effects that the criterion asks for.
    raised : float
        Factor of the levels that a search sees.
    """

    model: Model
    criterion: criteria.Criterion
    sigma: np.ndarray
    sea: NoiseModel | None
    prior: Information | None
    before: np.ndarray
    start: str | Mapping[str, float]
    shifts: Shifts | None
    raised: float = 1.0

    @classmethod
    def of(
        cls, given: Model | Fit, criterion: criteria.Criterion, knowledge: Knowledge
    ) -> ExpectedInformation:
        """Return what is expected of runs of a vehicle, or after a fit."""
        model = given.model if isinstance(given, Fit) else given
        noise = given if isinstance(given, Fit) and knowledge.noise is None else knowledge.noise
        sea, levels = expected_noise(model, noise)
        sigma = noise_of(model, levels)
        # The levels belong to the model, so that reports and cards state them.
        model = model.with_noise(sigma)
        prior = knowledge.before(given, model)
        shifts = _shifts(criterion, model)
        n = len(model.shared_names)
        before = np.zeros((n if shifts is None else n + len(shifts),) * 2)
        if prior is not None:
            before[:n, :n] = prior.matrix
        found = cls(model, criterion, sigma, sea, prior, before, knowledge.start, shifts)
        if shifts is None or not isinstance(given, Fit) or not isinstance(knowledge.prior, str):
            return found
        return found._after_records(given)

    def _after_records(self, fit: Fit) -> ExpectedInformation:
        """The same with what the records of a fit, judged at its values, show of the effects."""
        n, before = len(self.names), np.zeros_like(self.before)
        rows = prior_factor(self.model, self.names, "model")
        before[:n, :n] = rows.T @ rows
        told = RunInformation(self.model, self.expected, shifts=self.shifts)
        for given in commanded_runs(self.model, fit.dataset, initial_states=fit.initial_states):
            factor = told.factor(given)
            before += factor.T @ factor
        return replace(self, before=before)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that all runs share."""
        return self.model.shared_names

    @property
    def expected(self) -> NoiseModel | np.ndarray:
        """Noise under which the information is taken."""
        return self.sigma if self.sea is None else self.sea

    def scales(self) -> np.ndarray:
        """Units of the shared parameters, ``(n_names,)``."""
        return np.array([self.model.parameter(name).magnitude for name in self.names])

    def on(self, vehicle: Model) -> ExpectedInformation:
        """What is expected on another vehicle, and what absent effects do there."""
        if vehicle is self.model:
            return self
        return replace(self, model=vehicle, shifts=_shifts(self.criterion, vehicle))

    def measure(self, scales: np.ndarray | None = None) -> criteria.Measure:
        """The criterion as a function of matrices in units of the parameters."""
        units = self.scales() if scales is None else scales
        setting = criteria.Setting(self.model, self.names, units, self.sigma, self.shifts)
        return self.criterion.bind(setting)

    def relative(self, matrix: np.ndarray, scales: np.ndarray | None = None) -> np.ndarray:
        """A matrix in SI units in units of the parameters; effects are in units of their size."""
        units = self.scales() if scales is None else scales
        units = np.concatenate([units, np.ones(matrix.shape[-1] - len(units))])
        return matrix * units[:, None] * units

    def told(self, outputs: Sequence[str] | None = None) -> RunInformation:
        """What single runs tell, nothing known before.

        Parameters
        ----------
        outputs : sequence of str, optional
            Outputs that are measured; by default all.
        """
        return RunInformation(self.model, self.expected, self.start, outputs, self.shifts)

    def total(self, run: Experiment | None) -> np.ndarray:
        """Relative information after a run, or before it (None).

        Raises
        ------
        DesignError, SimulationError
            If the run diverges.
        """
        more = 0.0
        if run is not None:
            factor = self.told().factor(commanded_runs(self.model, run)[0])
            more = factor.T @ factor
        return self.relative(self.before + more)

    def bound(self, run: Experiment) -> Information:
        """Information on the parameters after a run, prior knowledge included."""
        return information_of(
            self.model, run, noise=self.expected, priors=self.prior, start=self.start
        )

    def worth(self, run: Experiment) -> float:
        """Criterion after a run, under the noise that is expected."""
        return self.measure()(self.total(run))[0]

    def seen_white(self, run: Experiment) -> ExpectedInformation:
        """The same with the levels of a search raised until a run tells what it will tell.

        Without it a search by shifts would take records in hand, judged under disturbance forces,
        for worse than what it may plan.
        """
        if self.sea is None or self.shifts is None:
            return self
        told = information_of(self.model, run, noise=self.sea, priors=None).matrix
        return replace(self, raised=self.raising(run, self.relative(told)))

    def raising(self, run: Experiment, told: np.ndarray, scales: np.ndarray | None = None) -> float:
        r"""Factor :math:`\kappa` of the levels at which white noise lets a run tell that little.

        Parameters
        ----------
        run : Experiment
        told : ndarray (n, n)
            Relative information on the parameters under the forces.
        scales : ndarray (n,), optional
            Units of ``told``; by default the parameters' own.
        """
        white = information_of(self.model, run, noise=self.sigma, priors=None).matrix
        most = criteria.log_determinant(self.relative(white, scales))
        more = most - criteria.log_determinant(told)
        return float(np.exp(0.5 * max(more, 0.0) / len(told)))

    def misfits(self, total: np.ndarray) -> dict[tuple[str, str], float]:
        """For discrimination: expected ``2 dlogL`` of every rival over every other."""
        if not isinstance(self.criterion, criteria.Discriminate) or self.shifts is None:
            return {}
        return self.criterion.misfits(self.model, self.shifts, total, len(self.names))

    def detections(self, total: np.ndarray) -> tuple[criteria.Detection, ...]:
        """For detection: how surely every candidate shows, before and after."""
        if not isinstance(self.criterion, criteria.Detect) or self.shifts is None:
            return ()
        return self.criterion.detections(self.shifts, self.total(None), total, len(self.names))


def _shifts(criterion: criteria.Criterion, model: Model) -> Shifts | None:
    """Absent effects that a criterion asks for, if it does."""
    if hasattr(criterion, "bind_shifts"):
        raise DesignError("A criterion has no bind_shifts. Write bind(Setting(..., shifts=...)).")
    return criterion.shifts(model) if isinstance(criterion, criteria.ByShifts) else None


def _information(fit: Fit) -> Information:
    """What a fit knows: the inverse of the covariance that it states.

    Its information where these are one; not where noise is autocorrelated or scatters.
    """
    if fit.purpose == "replay":
        warnings.warn(criteria.SAYS["replay"], UserWarning, stacklevel=3)
    information = fit.information
    if not len(fit.names) or not np.all(np.isfinite(fit.covariance)):
        return information
    if np.allclose(fit.covariance, information.covariance, rtol=1e-9, atol=0.0):
        return information
    return Information.from_matrix(fit.names, np.linalg.inv(fit.covariance), information.scales)
