"""Kalman filters on states and parameters together, sample by sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar
from scipy.special import chdtr, chdtrc

from oed_sysid.baselines.equations import check_free
from oed_sysid.baselines.regression import (
    CONVERGED,
    Baseline,
    Regression,
    assumed_levels,
)
from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import ModelError, located
from oed_sysid.likelihood.between_records import CHANCE, WORTH_TELLING
from oed_sysid.likelihood.disturbances import disturbed_equations
from oed_sysid.likelihood.estimate import Status
from oed_sysid.likelihood.estimator import check_choice, check_count, check_positive
from oed_sysid.likelihood.start_guess import (
    VAGUE,
    check_channels,
    measured_columns,
    measured_states,
)
from oed_sysid.physics.model import Model

KINDS = ("extended", "unscented")
LIKELIEST = "likeliest"
# A start value without a prior is known to this share of its magnitude.
RELATIVE_PRIOR = 0.5
DIVERGED = Status(
    "diverged",
    "the filter diverged. Start closer, give smaller prior_std, add process_std, or "
    "use MultipleShooting, whose result does not depend on the order of the samples.",
)


@dataclass(frozen=True)
class JointKalmanFilter(Baseline):
    r"""Kalman filter whose state is the vehicle's state and the free parameters.

    The extended filter linearises one step with the exact derivatives of the
    compiled kernel; the unscented one sends ``2n + 1`` points through it. Without
    process noise the extended filter is a recursive, approximate output-error
    method: one pass over the data, each sample linearised once. Samples that
    were linearised far from the truth are not looked at again, so the stated
    errors are too small in strongly nonlinear cases.

    Parameters
    ----------
    kind : str
        ``"extended"`` or ``"unscented"``.
    process_std : mapping of str to float, or ``"likeliest"``
        Intensity of the noise on each state's rate, in its unit per
        :math:`\sqrt{s}`; zero where nothing is said. The likeliest is one share of the scale of
        every velocity, chosen so that the innovations are likeliest.
    drift_std : mapping of str to float
        The same for parameters that change in time.
    reach : float
        Distance of the points of the unscented filter, in standard deviations.
        Further out, at the :math:`\sqrt{n}` of the cubature rule, ten parameters
        known to a half are tried at minus and plus two times their values, and
        stated errors come out far too small.
    passes : int
        How often the data is gone through; each pass starts with the values
        of the one before and the first uncertainty, so that errors stay those
        of a single pass.

    Notes
    -----
    Values and covariance of a fit are those after the last sample; its ``extras`` hold
    ``history`` and ``history_std`` by parameter, one number per sample of the last
    pass, and ``innovation`` (root mean square innovation in units of
    its stated standard deviation, one where the filter is honest).

    References
    ----------
    Ljung (1979), Asymptotic behavior of the extended Kalman filter as a parameter
    estimator for linear systems, IEEE Trans. Automatic Control 24; Wan & van der
    Merwe (2000), The unscented Kalman filter for nonlinear estimation, AS-SPCC;
    Arasaratnam & Haykin (2009), Cubature Kalman filters, IEEE TAC 54, for the rule
    that ``reach`` departs from.

    Examples
    --------
    >>> JointKalmanFilter("unscented").name
    'unscented Kalman filter of states and parameters'
    """

    kind: str = "extended"
    process_std: Mapping[str, float] | str = field(default_factory=dict)
    drift_std: Mapping[str, float] = field(default_factory=dict)
    reach: float = 3.0**0.5
    passes: int = 1

    def __post_init__(self) -> None:
        check_choice("kind", self.kind, KINDS)
        if isinstance(self.process_std, str):
            check_choice("process_std", self.process_std, (LIKELIEST,))
        check_positive("reach", self.reach, "Give a positive number of deviations.")
        check_count("passes", self.passes)

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        passes = "" if self.passes == 1 else f", {self.passes} passes"
        return f"{self.kind} Kalman filter of states and parameters{passes}"

    def _estimate(self, model: Model, dataset: Dataset) -> Regression:
        """Filter all records in turn; parameters are carried over."""
        check_channels(model, dataset)
        if self.process_std != LIKELIEST:
            located(ModelError, "process_std names", self.process_std, model.state_names)
        located(ModelError, "drift_std names", self.drift_std, model.free_names)
        check_free(model, "a filter")
        filter_ = self._filtered(model, dataset)
        values, covariance = filter_.known
        status = consistency(filter_.innovation**2, filter_.count)
        if not filter_.is_finite:
            values = np.array([p.value for p in model.free_parameters])
            covariance, status = np.diag(np.full(len(values), np.inf)), DIVERGED
        tracks, spreads = np.array(filter_.track), np.array(filter_.spreads)
        extras = {
            "history": dict(zip(model.free_names, tracks.T, strict=True)),
            "history_std": dict(zip(model.free_names, spreads.T, strict=True)),
            "innovation": filter_.innovation,
        }
        return Regression(values, covariance, status=status, iterations=len(tracks), facts=extras)

    def _filtered(self, model: Model, dataset: Dataset) -> JointFilter:
        """The filter after all records, with the likeliest process noise where that is wanted."""
        if isinstance(noise := self.process_std, str):
            return self._likeliest(model, dataset)
        filter_ = JointFilter(self, model, assumed_levels(model, dataset), noise)
        for _ in range(self.passes):
            filter_.restart()
            for record in dataset:
                filter_.run(record)
            if not filter_.is_finite:
                break
        return filter_

    def _likeliest(self, model: Model, dataset: Dataset) -> JointFilter:
        """The filter whose innovations are likeliest, of all shares of process noise and none."""
        speeds = set(model.axes.values()) or set(disturbed_equations(model))

        def at(share: float) -> JointFilter:
            noise = {s.name: share * s.scale for s in model.states if s.name in speeds}
            return replace(self, process_std=noise)._filtered(model, dataset)

        found = minimize_scalar(
            lambda power: -at(10.0**power).log_likelihood,
            # From what no record shows to what hides every motion, as shares per root second.
            bounds=(-4.0, 0.0),
            method="bounded",
            options={"xatol": 0.1},  # a quarter of the level: errors of the values are flat there
        )
        return max(at(0.0), at(10.0**found.x), key=lambda one: one.log_likelihood)


def consistency(square: float, count: int) -> Status:
    r"""Status of a filter from its normalised innovation squared.

    .. math:: \bar\nu = \frac{1}{n} \sum_k e_k' S_k^{-1} e_k,

    one where the stated covariances ``S`` are right (Bar-Shalom, Li & Kirubarajan 2001,
    *Estimation with applications to tracking and navigation*, section 5.4).

    Parameters
    ----------
    square : float
        Normalised innovation squared per measured value.
    count : int
        Number of measured values.
    """
    chance = min(chdtr(count, count * square), chdtrc(count, count * square))
    if chance > CHANCE or 1.0 / WORTH_TELLING <= np.sqrt(square) <= WORTH_TELLING:
        return CONVERGED
    found = f"the normalised innovations squared are {square:.3g} on average (expected 1): "
    if square < 1.0:  # values can be used, their errors are on the safe side
        todo = "the stated errors are too large. Declare less noise_std or process_std."
        return Status("converged", found + todo)
    todo = (
        "the stated errors are too small. Give process_std, more noise_std, or use "
        "MultipleShooting(disturbances='auto')."
    )
    return Status("inconsistent", found + todo)


def _first_values(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Start values of the parameters and their covariance: the prior's, or by their sizes."""
    free = model.free_parameters
    known = [p.prior_spread or RELATIVE_PRIOR * p.magnitude for p in free]
    values = [p.value if p.prior_mean is None else p.prior_mean for p in free]
    return np.array(values, dtype=float), np.diag(np.square(known))


class JointFilter:
    """Mean and covariance of ``[full state, free parameters]``, in scaled units.

    Attributes
    ----------
    known : (ndarray (n_free,), ndarray (n_free, n_free))
        Parameters as known by now and their covariance, in their own units.
    mean : ndarray (n,)
    spread : ndarray (n, n)
        Covariance.
    track, spreads : list of ndarray (n_free,)
        Parameters and their standard deviations after every sample of the records gone through.
    count : int
        Number of measured values so far.
    """

    def __init__(
        self,
        settings: JointKalmanFilter,
        model: Model,
        sigma: np.ndarray,
        noise: Mapping[str, float],
    ) -> None:
        self.settings, self.model, self.sigma = settings, model, sigma
        self.kernel: Kernel = kernel(model)
        n_extra = self.kernel.n_full - self.kernel.n_own
        free = model.free_parameters
        self.n_z = self.kernel.n_full
        self.scale = np.array(
            [*(s.scale for s in model.states), *np.ones(n_extra), *(p.magnitude for p in free)]
        )
        self.unit = self.scale[self.n_z :]
        self.columns = [model.parameter_names.index(name) for name in model.free_names]
        self.lower, self.upper = np.array([(p.lower, p.upper) for p in free]).T
        rates = [noise.get(s.name, 0.0) for s in model.states]
        drifts = [settings.drift_std.get(p.name, 0.0) for p in free]
        self.intensity = (np.array([*rates, *np.zeros(n_extra), *drifts]) / self.scale) ** 2
        self.mean, self.spread = np.empty(0), np.empty((0, 0))
        self.known = self._first = _first_values(model)

    def restart(self) -> None:
        """Begin another pass: with the present values, as uncertain as the first ones were."""
        self.known = self.known[0], self._first[1]
        self.track: list[np.ndarray] = []
        self.spreads: list[np.ndarray] = []
        self._squares, self._log_variances, self.count = 0.0, 0.0, 0

    @property
    def innovation(self) -> float:
        """Root mean square innovation in units of its stated deviation."""
        return float(np.sqrt(self._squares / max(self.count, 1)))

    @property
    def log_likelihood(self) -> float:
        r"""Of the innovations, :math:`-\tfrac12 \sum_k (e_k' S_k^{-1} e_k + \ln\det S_k)`."""
        found = -0.5 * (self._squares + self._log_variances)
        return found if self.is_finite and np.isfinite(found) else -np.inf

    @property
    def is_finite(self) -> bool:
        """Whether the filter has not diverged."""
        return bool(np.isfinite(self.known[0]).all() and np.isfinite(self.mean).all())

    def run(self, record: Record) -> None:
        """Filter one record: states anew from its first sample, parameters as known by now."""
        if not self.is_finite:
            return
        self._begin(record)
        predict = self._extended if self.settings.kind == "extended" else self._unscented
        for k, outputs in enumerate(record.outputs):
            last, row = max(k - 1, 0), min(k, 1)
            times = record.times[[last, k]]
            if k == 0:  # the sample is at the earlier of two times, where the mean is already
                times = times + np.array([0.0, self.model.step])
            with np.errstate(all="ignore"):
                predicted, cross, expected = predict(times, record.inputs[[last, k]], row)
                self._correct(outputs - predicted, cross, expected)
            block = self.spread[self.n_z :, self.n_z :] * self.unit[:, None] * self.unit
            self.known = values, covariance = self.mean[self.n_z :] * self.unit, block
            if not self.is_finite:
                break
            self.track.append(values)
            self.spreads.append(np.sqrt(np.maximum(np.diag(covariance), 0.0)))

    def _begin(self, record: Record) -> None:
        """Mean and covariance before the first measurement of a record."""
        values, covariance = self.known
        model, n_own, n_free = self.model, self.kernel.n_own, len(values)
        own = np.zeros(n_own)
        std = np.array([state.scale for state in model.states])
        columns = measured_columns(model)
        for position, series in measured_states(model, record).items():
            own[position] = series[0]
            # A measured start state is as vague before its first measurement.
            std[position] = VAGUE * self.sigma[columns[position]]
        z, dz = self.kernel.start(own, record.inputs[0], self._all(values), record.times[0])
        # Memory of actuators and sensors starts in equilibrium with states and parameters.
        shape = np.vstack([dz, np.eye(n_own + n_free)[n_own:]])
        spread = shape @ block_diag(np.diag(std**2), covariance) @ shape.T
        self.mean = np.concatenate([z, values]) / self.scale
        self.spread = spread / self.scale[:, None] / self.scale

    def _all(self, values: np.ndarray) -> np.ndarray:
        """All parameter values, the free ones within their bounds."""
        complete = self.model.value_vector
        complete[self.columns] = np.clip(values, self.lower, self.upper)
        return complete

    def _extended(
        self, times: np.ndarray, inputs: np.ndarray, row: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Predict with exact derivatives: measurement, its covariances with all and its own."""
        n_z, full = self.n_z, self.mean * self.scale
        run = self.kernel.run(
            times,
            inputs,
            self._all(full[n_z:]),
            full[:n_z],
            starts=np.array([0, 1]),
            from_nodes=0,
            sensitivities=True,
        )
        if row:
            # Exact derivatives of the step; parameters stay as they are.
            transition = np.eye(len(full))
            transition[:n_z] = run.end_sensitivities[0]
            transition = transition * self.scale / self.scale[:, None]
            self.mean = np.concatenate([run.states[1], full[n_z:]]) / self.scale
            self.spread = transition @ self.spread @ transition.T
            self.spread = self.spread + np.diag(self.intensity * (times[1] - times[0]))
        slope = run.output_sensitivities[row] * self.scale
        cross = self.spread @ slope.T
        return run.outputs[row], cross, slope @ cross

    def _unscented(
        self, times: np.ndarray, inputs: np.ndarray, row: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Predict with the mean and two points per direction: as :meth:`_extended`."""
        mean, n, n_z, reach = self.mean, len(self.mean), self.n_z, self.settings.reach
        values, vectors = np.linalg.eigh(0.5 * (self.spread + self.spread.T))
        offsets = vectors * (reach * np.sqrt(np.maximum(values, 0.0)))
        points = np.vstack([mean, mean + offsets.T, mean - offsets.T])
        outputs = np.empty((2 * n + 1, len(self.sigma)))
        for i, point in enumerate(points):
            full = point * self.scale
            run = self.kernel.run(times, inputs, self._all(full[n_z:]), full[:n_z])
            outputs[i] = run.outputs[row]
            if row:
                points[i, :n_z] = run.states[1] / self.scale[:n_z]
        # Moments about the image of the mean: the weights of Wan & van der Merwe, summed so that
        # no negative weight of the middle point can make a covariance indefinite.
        away, change = points[1:] - points[0], outputs[1:] - outputs[0]
        weight = 0.5 / reach**2
        shift, expected = weight * away.sum(axis=0), weight * change.sum(axis=0)
        both = 2.0 - reach**2 / n  # 2: peakedness of a normal distribution
        self.mean = points[0] + shift
        self.spread = weight * away.T @ away + both * np.outer(shift, shift)
        if row:
            self.spread = self.spread + np.diag(self.intensity * (times[1] - times[0]))
        cross = weight * away.T @ change + both * np.outer(shift, expected)
        own = weight * change.T @ change + both * np.outer(expected, expected)
        return outputs[0] + expected, cross, own

    def _correct(self, innovation: np.ndarray, cross: np.ndarray, expected: np.ndarray) -> None:
        """Learn one measurement; missing outputs are passed over."""
        seen = np.flatnonzero(np.isfinite(innovation))
        if not len(seen):
            return
        # S = C P C' + R, scaled to a unit diagonal: outputs differ by orders of magnitude.
        total = expected[np.ix_(seen, seen)] + np.diag(self.sigma[seen] ** 2)
        unit = np.sqrt(np.diag(total))
        scaled = total / unit[:, None] / unit
        if not np.isfinite(scaled).all():
            self.mean = np.full_like(self.mean, np.nan)
            return
        gain = np.linalg.solve(scaled, (cross[:, seen] / unit).T).T / unit
        self.mean = self.mean + gain @ innovation[seen]
        # P - K C P, made symmetric against rounding.
        spread = self.spread - gain @ cross[:, seen].T
        self.spread = 0.5 * (spread + spread.T)
        # A value beyond its bounds could not be simulated with.
        free = slice(self.n_z, None)
        self.mean[free] = np.clip(self.mean[free], self.lower / self.unit, self.upper / self.unit)
        self._squares += float(innovation[seen] @ np.linalg.solve(total, innovation[seen]))
        self._log_variances += float(2 * np.log(unit).sum() + np.linalg.slogdet(scaled)[1])
        self.count += len(seen)
