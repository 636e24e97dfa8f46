"""What an estimation found, in numbers: values, their uncertainty, residuals and a status."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from scipy.special import ndtri

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.frames import frame
from oed_sysid.errors import DataError
from oed_sysid.likelihood.between_records import FEWEST, RecordScatter, Sources
from oed_sysid.likelihood.information import Information, Whiteness, whiteness
from oed_sysid.likelihood.noise_levels import root_mean_square
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model

Answer = TypeVar("Answer")
Asked = ParamSpec("Asked")

# Fewest samples of a record of which whiteness is tested.
TESTED = 11


@dataclass(frozen=True)
class Status:
    """How an estimation ended, and what to do about it.

    ``code`` is one of ``converged``, ``stalled``, ``iterations``,
    ``interrupted``, ``infeasible``, ``diverged``; or, where the iterations ended
    at values that must not be used, ``runaway``, ``integration``, ``degenerate``
    (:mod:`oed_sysid.likelihood.judgement`) or ``inconsistent`` (a filter whose errors
    are far from those it states).

    Examples
    --------
    >>> status = Status("iterations", "Give it more iterations.")
    >>> status.ok, str(status)
    (False, 'iterations: Give it more iterations.')
    """

    code: str
    advice: str

    @property
    def ok(self) -> bool:
        """Whether the values can be used."""
        return self.code == "converged"

    def __str__(self) -> str:
        return f"{self.code}: {self.advice}" if self.advice else self.code


@dataclass(frozen=True)
class Departure:
    """Score estimate of what is wrong with one signal, or with those of one instrument.

    Attributes
    ----------
    signal : str
    kind : str
        ``"late"``, ``"slow"`` (its clock), ``"off"`` or ``"scale"`` of an output, ``"acts late"``
        or ``"acts off"`` (larger than logged) of an input, or where from the origin positions or
        accelerations are measured: ``"ahead"``, ``"to starboard"`` or ``"below"``.
    size, std : float
        In s, in the unit of the signal, in m, or the share of time lost or by which its scale is
        larger; and its standard error.
    gain : float
        What it explains, in twice the log-likelihood.
    share : float
        Of the misfit beyond noise.
    rivals : tuple of str
        Others that explain as much.
    together : tuple of str
        Other signals of the same instrument that depart with it.
    """

    signal: str
    kind: str
    size: float
    std: float
    gain: float
    share: float
    rivals: tuple[str, ...] = ()
    together: tuple[str, ...] = ()

    @property
    def signals(self) -> tuple[str, ...]:
        """All signals that depart."""
        return (self.signal, *self.together)


@dataclass(frozen=True)
class ActuatorStart:
    """Score estimate of where an actuator began in one record.

    Attributes
    ----------
    effect, signal, record : str
    size, std : float
        Actual value before the record less the first command, and its standard error, in the
        unit of the command.
    share : float
        Of the record's misfit beyond noise that it explains.
    """

    effect: str
    signal: str
    record: str
    size: float
    std: float
    share: float


@dataclass(frozen=True)
class Binding:
    """A bound or constraint at which an estimate ends.

    Attributes
    ----------
    text : str
        ``"N_v <= 0"``.
    beyond, std : float
        How far beyond it the optimum of the records lies, and the standard error of that, to
        first order.
    """

    text: str
    beyond: float
    std: float

    @property
    def distance(self) -> float:
        """How far beyond, in standard errors."""
        return self.beyond / self.std


@dataclass(frozen=True)
class Integration:
    """Why a fit was made by finer steps than those of the model that was given.

    Attributes
    ----------
    step : float
        Integration step of the model that was given, s.
    parameter : str
        Whose estimate moved most with the finer step; empty where a search went on from there.
    shift : float
        By how many of its standard errors; NaN there.
    """

    step: float
    parameter: str = ""
    shift: float = np.nan


@dataclass(frozen=True)
class ProcessNoiseTest:
    """What the fit to white noise said of process noise, and of what that would absorb.

    Attributes
    ----------
    statistic : float
        Likelihood-ratio statistic 2 delta ln L that the score test expects.
    failed : str
        How the fit with process noise ended, where its values are not those that are returned.
    departure : Departure or None
        Clear departure of a signal.
    actuator_starts : tuple of ActuatorStart
        Clear starts of actuators beside their first command.
    departure_likelier : bool
        Whether that departure alone makes the records likelier than process noise does.
    """

    statistic: float
    failed: str = ""
    departure: Departure | None = None
    actuator_starts: tuple[ActuatorStart, ...] = ()
    departure_likelier: bool = False


@dataclass(frozen=True)
class CaptiveErrors:
    """Errors of forces that were measured at given motion, by axis.

    Attributes
    ----------
    relative : mapping of str to float
        Root mean square error over the root mean square of the force.
    in_noise : mapping of str to float
        Over the noise; NaN where nothing was measured.
    """

    relative: Mapping[str, float]
    in_noise: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Attempts:
    """Where estimations from several starts ended.

    Attributes
    ----------
    start_values : tuple of mapping of str to float
        Start values by parameter, a mapping a start; the model's own first.
    log_likelihoods : ndarray (n_starts,)
    objectives : ndarray (n_starts,)
        Minus twice the log-likelihood, with priors; infinite where it diverged.
    converged : ndarray of bool (n_starts,)
    arrived : int
        Starts that found the optimum that is returned.
    """

    start_values: tuple[Mapping[str, float], ...]
    log_likelihoods: np.ndarray
    objectives: np.ndarray
    converged: np.ndarray
    arrived: int


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws of a sampler, by parameter.

    Attributes
    ----------
    draws : mapping of str to ndarray (n_chains, n_draws)
    r_hat : mapping of str to float
        Spread between halves of chains over that within; one where they agree.
    effective_draws : mapping of str to float
        Independent draws that are worth as much.
    """

    draws: Mapping[str, np.ndarray]
    r_hat: Mapping[str, float]
    effective_draws: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Estimate:
    """Numbers of a :class:`oed_sysid.likelihood.fit.Fit`; see there for the attributes."""

    model: Model
    dataset: Dataset
    estimator: str
    names: tuple[str, ...]
    estimates: np.ndarray
    information: Information
    covariance: np.ndarray
    coloured: bool
    sigma: np.ndarray
    sigma_estimated: np.ndarray
    predictions: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    states: tuple[np.ndarray, ...]
    initial_states: tuple[np.ndarray, ...]
    local_values: tuple[Mapping[str, float], ...]
    cost: float
    status: Status
    iterations: int
    seconds: float
    extras: Mapping[str, Any] = field(default_factory=dict)
    noise: NoiseModel = None  # type: ignore[assignment]  # white, unless given
    noise_std: Mapping[str, float] = field(default_factory=dict)
    innovations: tuple[np.ndarray, ...] | None = None
    innovation_std: tuple[np.ndarray, ...] | None = None
    start_states: tuple[Mapping[str, tuple[float, float]], ...] = ()
    record_scatter: RecordScatter | None = None
    sources: Sources | None = None
    nominal: Mapping[str, float] = field(default_factory=dict)
    excluded: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    process_noise: ProcessNoiseTest | None = None
    tests_scatter: bool = False
    captive: CaptiveErrors | None = None
    horizon: float | None = None
    n_windows: int = 0
    attempts: Attempts | None = None
    posterior: Posterior | None = None
    purpose: str = "derivatives"
    binding: tuple[Binding, ...] = ()
    integration: Integration | None = None

    def __post_init__(self) -> None:
        if self.noise is None:
            white = NoiseModel.white_only(self.sigma, self.model.output_names)
            object.__setattr__(self, "noise", white)

    @property
    def values(self) -> dict[str, float]:
        """Estimated value by name."""
        return by_name(self.names, self.estimates)

    @property
    def std_errors(self) -> dict[str, float]:
        """Standard error by name."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return by_name(self.names, errors)

    @property
    def record_errors(self) -> dict[str, float]:
        """Standard error by name from the scatter between records; empty for fewer than four.

        To first order; see :mod:`oed_sysid.likelihood.between_records`.
        """
        if self.record_scatter is None:
            return {}
        return by_name(self.names, np.sqrt(np.diag(self.record_scatter.covariance)))

    @property
    def shared_covariance(self) -> np.ndarray:
        """Covariance of the shared parameters in the model's order; zero of what is known."""
        shared = [p.name for p in self.model.free_parameters if not p.per_record]
        covariance = np.zeros((len(shared), len(shared)))
        known = [i for i, name in enumerate(shared) if name in self.names]
        columns = [self.names.index(shared[i]) for i in known]
        covariance[np.ix_(known, known)] = self.covariance[np.ix_(columns, columns)]
        return covariance

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of the estimates, shape ``(n_free, n_free)``."""
        errors = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore", divide="ignore"):
            result = self.covariance / errors[:, None] / errors
        return np.where(np.isfinite(result), result, 0.0)

    @property
    def n_observations(self) -> int:
        """Number of measured samples, over all outputs."""
        return int(sum(np.isfinite(residual).sum() for residual in self.residuals))

    @property
    def log_likelihood(self) -> float:
        """Gaussian log-likelihood at the reported noise model."""
        total = 0.0
        for errors, std in self._one_step:
            present = np.isfinite(errors)
            scaled = np.where(present, errors, 0.0) / std
            total -= 0.5 * float(np.sum(scaled**2))
            # By the innovations: their product is the density of the record.
            total -= float(np.sum(np.where(present, np.log(std * np.sqrt(2 * np.pi)), 0.0)))
        return total

    @property
    def _one_step(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Errors that should be white, and their standard deviations, per record."""
        if self.innovations is None or self.innovation_std is None:
            return [(part, np.broadcast_to(self.sigma, part.shape)) for part in self.residuals]
        return list(zip(self.innovations, self.innovation_std, strict=True))

    @property
    def whitened(self) -> tuple[np.ndarray, ...]:
        """One-step errors in units of their standard deviation, NaN where missing, per record.

        White and of unit variance, if model and noise model are right.
        """
        return tuple(errors / std for errors, std in self._one_step)

    @property
    def series(self) -> tuple[np.ndarray, ...]:
        """As :attr:`whitened`, NaN throughout records whose samples have no order."""
        return tuple(
            np.full(part.shape, np.nan) if record.independent else part
            for record, part in zip(self.dataset, self.whitened, strict=True)
        )

    @property
    def n_unknowns(self) -> int:
        """Number of estimated values: parameters, initial states, noise levels."""
        local = sum(len(values) for values in self.local_values)
        states = sum(len(own) for own in self.initial_states)
        # Held start states are known, not estimated.
        states -= sum(std == 0.0 for known in self.start_states for _, std in known.values())
        # With process noise the levels of the sensors are counted among noise_std already.
        levels = int(np.sum(self.sigma_estimated)) if self.innovations is None else 0
        return len(self.names) + states + local + levels + len(self.noise_std)

    @property
    def aic(self) -> float:
        """Akaike's information criterion; takes residuals as independent."""
        return 2.0 * self.n_unknowns - 2.0 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Schwarz's information criterion; takes residuals as independent."""
        return self.n_unknowns * float(np.log(self.n_observations)) - 2.0 * self.log_likelihood

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square residual of each output over all records, in its unit."""
        return by_name(self.model.output_names, root_mean_square(self.residuals))

    @property
    def normalised_rms(self) -> float:
        """Root mean square residual over all outputs, in units of the noise."""
        return _rms(np.vstack(self.residuals) / self.sigma)

    @property
    def one_step_rms(self) -> float:
        """Root mean square one-step error, in its stated standard deviation: one if all is right.

        Minus twice the log-likelihood is its square times the samples, but for a constant and the
        determinants of the standard deviations.
        """
        return _rms(np.vstack(self.whitened))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of one parameter from its standard error.

        Normal; log-normal where the parameter was estimated as its logarithm.
        """
        half = float(ndtri(0.5 + level / 2)) * self.std_errors[name]
        return self._about(name, half)

    def record_interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of one parameter from the scatter between records.

        Of Student's distribution with one degree of freedom less than there are records.

        Raises
        ------
        DataError
            If there are fewer than four records.
        """
        half = checked_scatter(self).half_width(level)[self.names.index(name)]
        return self._about(name, float(half))

    def _about(self, name: str, half: float) -> tuple[float, float]:
        """Values at either side of an estimate."""
        if self.model.parameter(name).log:
            # The standard error of a logarithm is the relative one.
            factor = np.exp(half / self.values[name])
            return float(self.values[name] / factor), float(self.values[name] * factor)
        return float(self.values[name] - half), float(self.values[name] + half)

    def whiteness(self) -> dict[str, tuple[Whiteness, ...]]:
        """Whiteness of the one-step errors, by output, one entry per record that measured it."""
        return {
            name: tuple(
                whiteness(residual[:, column])
                for residual in self.series
                if np.isfinite(residual[:, column]).sum() >= TESTED
            )
            for column, name in enumerate(self.model.output_names)
        }

    def effective_samples(self) -> dict[str, tuple[float, int]]:
        """Effective and actual number of samples of each output.

        Independent tests, and records that are too short for a test of whiteness, count whole.
        """
        alone = np.zeros(len(self.model.outputs), dtype=int)
        for record, residual in zip(self.dataset, self.residuals, strict=True):
            seen = np.isfinite(residual).sum(axis=0)
            alone += np.where(record.independent | (seen < TESTED), seen, 0)
        return {
            name: (
                float(sum(test.effective_samples for test in tests)) + float(count),
                int(sum(test.n_samples for test in tests)) + int(count),
            )
            for (name, tests), count in zip(self.whiteness().items(), alone, strict=True)
        }

    def to_dataframe(self) -> Any:
        """Estimates as a pandas data frame, one row per parameter.

        Returns
        -------
        pandas.DataFrame
            Index: the names. Columns ``value``, ``std_error``, ``low`` and ``high`` (95 %
            interval), ``unit``.

        Raises
        ------
        DataError
            If pandas is not installed.
        """
        limits = np.array([self.interval(name) for name in self.names]).reshape(-1, 2)
        columns: dict[str, Any] = {
            "parameter": list(self.names),
            "value": self.estimates,
            "std_error": list(self.std_errors.values()),
            "low": limits[:, 0],
            "high": limits[:, 1],
            "unit": [self.model.parameter(name).unit for name in self.names],
        }
        return frame(columns).set_index("parameter")


def once_a_fit(ask: Callable[Asked, Answer], place: int = 0) -> Callable[Asked, Answer]:
    """Remember what is asked of a fit, the argument at a place, for as long as that fit is there.

    The same is asked where all other arguments are the same objects.
    """
    known: WeakKeyDictionary[Any, list[tuple[tuple[Any, ...], Answer]]] = WeakKeyDictionary()

    @wraps(ask)
    def asked(*given: Asked.args, **named: Asked.kwargs) -> Answer:
        others = (*given[:place], *given[place + 1 :], *named.values())
        answers = known.setdefault(given[place], [])
        for before, answer in answers:
            if all(one is other for one, other in zip(before, others, strict=True)):
                return answer
        answers.append((others, ask(*given, **named)))
        return answers[-1][1]

    return asked


def by_name(names: Sequence[str], numbers: np.ndarray) -> dict[str, float]:
    """Numbers by name."""
    return dict(zip(names, map(float, numbers), strict=True))


def _rms(numbers: np.ndarray) -> float:
    """Root mean square of what is a number; NaN where nothing is."""
    present = np.isfinite(numbers)
    return float(np.sqrt(np.mean(numbers[present] ** 2))) if present.any() else np.nan


def checked_scatter(fit: Estimate) -> RecordScatter:
    """Scatter between records of a fit that has one.

    Raises
    ------
    DataError
        If it has none.
    """
    if fit.record_scatter is None:
        raise DataError(
            f"This fit of {len(fit.dataset)} records does not tell how they scatter. Fit "
            f"{FEWEST} records or more by MultipleShooting, or refit without each of them "
            "by jackknife()."
        )
    return fit.record_scatter
