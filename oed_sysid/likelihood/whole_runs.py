r"""Whole runs: a model on its own along a record, and what an estimator makes of disturbed ones.

Where a vehicle starts, and what differs from record to record (a zero of the helm), is estimated
from the whole run, all shared parameters held:

.. math::
    \hat s = \arg\min_s \sum_k \frac{(y_k - \hat y_k(s))^2}{\sigma^2} + (s - m)' \Lambda (s - m)

A filter would let process noise correct a start that is off, sample by sample; a run without it
then turns away from the record. Of runs drawn under process noise, departing by ``d`` from the
undisturbed one, an estimator with derivatives ``J`` (whitened, priors ``Λ``) returns and leaves

.. math:: t = (J'J + \Lambda)^{-1} J'd, \qquad r = d - J t .

*Could disturbances this strong have left runs this good, or this bad?* Process noise that acts
accumulates in a run; no constant parameters undo that. Let ``S_o`` be the sum of squares over
:math:`\sigma_o^2` that a fit without process noise leaves of the runs of output ``o``, and
``S_bo`` that of :math:`r_b` for runs drawn under the noise model in question,

.. math::
    z_o = \frac{\log S_o - \operatorname{median}_b \log S_{bo}}
               {\text{half width of the middle 68 \% of } \log S_{bo} \text{ on that side}}

Above 6 the process noise does not explain them. It stands only where the departures of the fit's
own runs, of which the same estimator leaves :math:`S_o = |d_o - (J t)_o|^2`, are as far from usual:
a fit without process noise may be led far beyond first order by forces that are strong. Draws hold
the commands as they were; where these answered the disturbance, as a helmsman or a zigzag does,
runs are better or worse than that. Whether process noise holds structure is therefore asked of
innovations, which do not mind (:mod:`oed_sysid.likelihood.laws`); only where that cannot be asked
runs that are too good, below -6, say it. Without process noise the draws are of the sensors alone,
at their *declared* level, and the statistic, a chi-square that may be autocorrelated, counts from
4.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from oed_sysid.compiled.kernels import Kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.experiments.simulation import simulate_batch
from oed_sysid.likelihood.between_records import CHANCE, WORTH_TELLING
from oed_sysid.likelihood.disturbances import chosen_places, with_disturbance_inputs
from oed_sysid.likelihood.estimate import Estimate, by_name
from oed_sysid.likelihood.gauss_newton import solve
from oed_sysid.likelihood.laws import CHUNK, Law, with_sea_of_its_records
from oed_sysid.likelihood.noise_levels import (
    DIFFERENCE_ERROR,
    believed_levels,
    root_mean_square,
    signal_spread,
    white_levels,
)
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.projection import inverse_of, root_of
from oed_sysid.likelihood.realisation import drawn_disturbances, gauss_markov
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import BEYOND
from oed_sysid.runtime.display import as_dict
from oed_sysid.text.units import shown_unit

# Runs drawn: the widths that z is in are then known to a tenth.
DRAWS = 120


@dataclass(frozen=True, eq=False)
class WholeRun:
    """One record, and a model that runs along it on its own.

    Attributes
    ----------
    shooting : Shooting
        Of this record alone, in one piece.
    unknowns : ndarray (n_unknowns,)
    outputs : ndarray (n_times, n_outputs)
        NaN from where the model diverges.
    jacobian : ndarray (n_times, n_outputs, n_unknowns)
        Derivatives of the outputs by shared parameters, start states and parameters of the record,
        in the order of the unknowns; NaN where the model diverges.
    """

    shooting: Shooting
    unknowns: np.ndarray
    outputs: np.ndarray
    jacobian: np.ndarray

    @classmethod
    def at(cls, shooting: Shooting, unknowns: np.ndarray) -> WholeRun:
        """The run at given unknowns."""
        outputs = shooting.run(unknowns, 0).outputs
        found = shooting.linearise(shooting.continuous(unknowns))
        jacobian = np.full((*outputs.shape, len(unknowns)), np.nan)
        if found is not None:
            jacobian[:, :, shooting.layout.record_columns(0)] = found.jacobians[0]
        return cls(shooting, unknowns, outputs, jacobian)

    @classmethod
    def fitted(
        cls,
        model: Model,
        record: Record,
        sigma: np.ndarray,
        start: tuple[np.ndarray, Mapping[str, float]] | None = None,
        runner: Kernel | None = None,
    ) -> WholeRun:
        """The run whose start states and values of the record are fitted to the whole record.

        Parameters
        ----------
        model : Model
            At its values; shared parameters are held.
        record : Record
        sigma : ndarray (n_outputs,)
            Standard deviation of one measurement.
        start : pair of ndarray (n_own,) and mapping, optional
            Start states and parameters of the record to begin with.
        runner : Kernel, optional
            What runs the model; by default its own kernel.
        """
        shooting = Shooting(model, Dataset((record,)), sigma, runner=runner)
        point = shooting.start_point()
        shared = np.arange(len(shooting.layout.shared))
        held = shooting.holding(shared, point.unknowns[shared])
        begin = point.unknowns.copy()
        if start is not None:
            shooting.fill(begin, 0, *start)
        # From the measured states and from the fit: whole runs of unstable vehicles have many
        # optima.
        ends = [solve(held, held.start_point(begin))]
        if start is not None:
            ends.append(solve(held, held.continuous(begin)))
        found = min(ends, key=lambda end: end.cost)
        diverged = np.isinf(found.cost)
        return cls.at(shooting, point.unknowns if diverged else found.point.unknowns)

    @property
    def diverges(self) -> bool:
        """Whether the model does, so that nothing follows from the run."""
        return bool(np.isnan(self.jacobian).any())

    @property
    def record(self) -> Record:
        """The record."""
        return self.shooting.records[0]

    @property
    def shared(self) -> np.ndarray:
        """Positions of the shared parameters among the unknowns."""
        return np.arange(len(self.shooting.layout.shared))

    @property
    def others(self) -> np.ndarray:
        """Positions of start states and parameters of the record, behind these."""
        return np.arange(len(self.shooting.layout.shared), len(self.unknowns))

    @property
    def states(self) -> dict[str, float]:
        """Start values of the model's own states."""
        shooting = self.shooting
        return by_name(shooting.model.state_names, shooting.initial_state(self.unknowns, 0))

    @property
    def local(self) -> dict[str, float]:
        """Values of the parameters of the record."""
        return self.shooting.layout.local_values(self.unknowns)[0]

    def weights(self) -> np.ndarray:
        """Inverse standard deviations ``(n_times, n_outputs)``, zero where nothing was measured."""
        return np.isfinite(self.record.outputs) / self.shooting.sigma

    def rows(self) -> np.ndarray:
        """Derivatives in standard deviations, ``(n_times * n_outputs, n_unknowns)``."""
        return (self.jacobian * self.weights()[:, :, None]).reshape(-1, len(self.unknowns))

    def whitened(self) -> np.ndarray:
        """Residuals in standard deviations ``(n_times, n_outputs)``, zero where not measured."""
        left = self.record.residuals(self.outputs)
        return np.where(self.weights() > 0, left, 0.0) * self.weights()

    def answer(self) -> tuple[np.ndarray, np.ndarray]:
        """What a fit of :attr:`others` makes of a departure, and its covariance from white noise.

        Returns
        -------
        inverse : ndarray (n_others, n_times * n_outputs)
            Takes a whitened departure to the change of the estimates.
        covariance : ndarray (n_others, n_others)
        """
        rows, prior = self.rows()[:, self.others], self.shooting.limits.prior_weight[self.others]
        # Least squares with priors: what a fit of the start makes of a departure.
        inverse = inverse_of(rows.T @ rows + np.diag(prior))
        return inverse @ rows.T, inverse

    def simulated(self, unknowns: np.ndarray) -> np.ndarray:
        """Outputs at other unknowns, ``(n_times, n_outputs)``."""
        return self.shooting.run(unknowns, 0).outputs

    def drawn(
        self, noise: NoiseModel, unknowns: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Runs under drawn disturbance forces, without noise of sensors.

        Parameters
        ----------
        noise : NoiseModel
        unknowns : ndarray (n_draws, n_unknowns)
            Of each run.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray (n_draws, n_times, n_outputs)
            NaN from where a run diverges.
        """
        shooting, record = self.shooting, self.record
        model = shooting.model
        forces = [drawn_disturbances(noise.on(record.name), record.times, rng) for _ in unknowns]
        vehicle = with_disturbance_inputs(model, chosen_places(model, list(forces[0])))
        # The same commands under every draw; forces stand beside them as further inputs.
        calm = np.broadcast_to(record.inputs, (len(unknowns), *record.inputs.shape))
        shape = (len(unknowns), len(forces[0]), len(record.times))
        drawn = np.reshape([list(one.values()) for one in forces], shape).swapaxes(1, 2)
        inputs = np.concatenate([calm, drawn], axis=2)
        return simulate_batch(
            vehicle,
            record.times,
            inputs=inputs,
            values=[shooting.values(one, 0) for one in unknowns],
            initials=[shooting.initial_state(one, 0) for one in unknowns],
        )

    def sensors(
        self, noise: NoiseModel, n_draws: int, rng: np.random.Generator, *, white: bool = True
    ) -> np.ndarray:
        """Drawn noise of the sensors, ``(n_draws, n_times, n_outputs)``; its white part too."""
        times = self.record.times
        found = np.zeros((n_draws, len(times), len(noise.white)))
        if white:
            found += noise.white * rng.standard_normal(found.shape)
        for column in np.flatnonzero(noise.colour > 0):
            for one in found:
                one[:, column] += gauss_markov(
                    noise.colour[column], noise.colour_time[column], times, rng
                )
        return found


def whole_runs(
    model: Model,
    dataset: Dataset,
    sigma: np.ndarray,
    starts: Sequence[tuple[np.ndarray, Mapping[str, float]]] | None = None,
    runner: Kernel | None = None,
) -> tuple[WholeRun, ...]:
    """Whole runs along all records, each with its own start fitted."""
    begun = [None] * len(dataset) if starts is None else starts
    return tuple(
        WholeRun.fitted(model, record, sigma, start=start, runner=runner)
        for record, start in zip(dataset, begun, strict=True)
    )


def rms(runs: Sequence[WholeRun]) -> np.ndarray:
    """Root mean square residual of whole runs, ``(n_outputs,)``.

    Infinite where the model diverges, NaN where nothing was measured.
    """
    residuals = np.vstack([run.record.residuals(run.outputs) for run in runs])
    seen = np.vstack([np.isfinite(run.record.outputs) for run in runs])
    with np.errstate(over="ignore"):
        found = root_mean_square([residuals])
    return np.where(np.any(seen & ~np.isfinite(residuals), axis=0), np.inf, found)


@dataclass(frozen=True)
class OutputRuns:
    """What the whole runs of a fit say of one output.

    Attributes
    ----------
    output, unit : str
    error, without : float
        Root mean square residual of whole runs, starts fitted, of the fit and of one without
        process noise, in the unit of the output; infinite where they diverge, NaN where nothing
        was measured.
    spread : float
        Standard deviation of the measured signal.
    noise : float
        Standard deviation that the sensor is granted: the declared one, or that of the records'
        high-frequency content where that is larger; what was estimated where none was declared.
    declared : bool
        Whether that is not an estimate, which no run could exceed.
    z : float
        How far the runs of the fit without process noise lie from what the noise model would have
        left, in standard widths; NaN where that was not asked.
    """

    output: str
    unit: str
    error: float
    without: float
    spread: float
    noise: float
    declared: bool
    z: float

    @property
    def share(self) -> float:
        """Whole-run error beyond the noise, as a share of the spread; NaN of nothing measured."""
        return float(np.sqrt(np.maximum(self.error**2 - self.noise**2, 0.0)) / self.spread)

    @property
    def size(self) -> str:
        """Whole-run error in its unit and in per cent of the signal, in words."""
        factor, shown = shown_unit(self.unit)
        words = f"{factor * self.error:.2g} {shown}".rstrip()
        return f"{words} ({100 * self.error / self.spread:.2g} %) of {self.output}"

    to_dict = as_dict("error", "unit", "noise", "share", "z", without_process_noise="without")


@dataclass(frozen=True)
class WholeRuns:
    """What the whole runs of a fit say of its noise model.

    Attributes
    ----------
    outputs : tuple of OutputRuns
    process_noise : bool
        Whether the noise model has process noise.
    unasked : str
        Why ``z`` was not asked; empty where it was.
    usual_ratio : float
        Of the ratios that the noise model brings, that which one in a hundred exceeds; infinite
        where that was not asked.
    follows : tuple of Law
        Disturbances that are functions of motion and commands; None where that was not asked.
    """

    outputs: tuple[OutputRuns, ...]
    process_noise: bool
    unasked: str = ""
    usual_ratio: float = np.inf
    follows: tuple[Law, ...] | None = None

    def each(self, fact: str) -> np.ndarray:
        """One fact of every output, ``(n_outputs,)``."""
        return np.array([getattr(one, fact) for one in self.outputs])

    def size(self, error: str = "error", noise: np.ndarray | None = None) -> float:
        """Error of whole runs over all measured outputs, in units of a noise, by default theirs."""
        ratio = self.each(error) / (self.each("noise") if noise is None else noise)
        seen = ratio[~np.isnan(ratio)]
        return float(np.sqrt(np.mean(seen**2))) if len(seen) else np.nan

    @property
    def relative(self) -> float:
        """Whole-run error over all outputs, in noise units."""
        return self.size()

    @property
    def ratio(self) -> float:
        """Whole-run error of the fit over that of one without process noise, in noise units."""
        other = self.size("without")
        return self.relative / other if 0 < other < np.inf else np.nan

    @property
    def shares(self) -> dict[str, float]:
        """Whole-run error of every measured output beyond its noise, as a share of its spread."""
        return {one.output: one.share for one in self.outputs if not np.isnan(one.share)}

    @property
    def diverging(self) -> tuple[str, ...]:
        """Outputs of which a whole run diverges."""
        return tuple(one.output for one in self.outputs if np.isinf(one.error))

    @property
    def beyond(self) -> tuple[str, ...]:
        """Outputs whose runs the noise model would not have left."""
        return (*self._beyond(-1), *self._beyond(1))

    def _beyond(self, side: int) -> list[str]:
        """Outputs whose runs are better (-1) or worse (1) than the noise model would have left.

        Runs of sensors alone that are too good tell a level that is declared too large. Where the
        level of a sensor was not declared, it may be the sensor. Commands that answer a disturbance
        hold runs that they would not hold if they were given: laws are asked in their place. Where
        commands answer a disturbance, as a zigzag's do, departures are wider than where they are
        given: the largest of 60 true ones of an AUV was 1.2 times :data:`BEYOND`.
        """
        if side < 0 and self.follows is not None:
            return []
        if self.process_noise:
            return [o.output for o in self.outputs if side * o.z > WORTH_TELLING * BEYOND]
        return [o.output for o in self.outputs if side > 0 and o.z > BEYOND and o.declared]

    @property
    def objections(self) -> tuple[str, ...]:
        """Why the noise model could not have left these runs, in words; empty where it could."""
        if self.diverging:
            return (f"whole runs diverge in {', '.join(self.diverging)}",)
        what = "process noise" if self.process_noise else "noise of the sensors"
        said = {
            f"{what} this strong would not have left whole runs as good in": self._beyond(-1),
            f"{what} would not have left whole runs as bad in": self._beyond(1),
            f"{what} cannot be most of": self._mostly_noise,
        }
        found = [f"{words} {', '.join(names)}" for words, names in said.items() if names]
        if self.process_noise and self.ratio > max(WORTH_TELLING, self.usual_ratio):
            found.append(
                f"with process noise a whole run is off {self.ratio:.2g} times as much as without"
            )
        return tuple(found)

    @property
    def said(self) -> tuple[str, ...]:
        """All that speaks against the noise model, in words."""
        return (*(law.text for law in self.follows or ()), *self.objections)

    @property
    def _mostly_noise(self) -> list[str]:
        """Outputs with more noise than signal, of a level that nobody declared."""
        named = {*self.beyond, *(self.shares if self.process_noise else ())}
        return [name for name, share in self.shares.items() if share > 0.5 and name not in named]

    @property
    def open_questions(self) -> tuple[str, ...]:
        """What these runs could not tell, in words."""
        found = [f"whole runs were not asked: {self.unasked}"] if self.unasked else []
        doubtful = [
            f"{one.output} ({one.error / one.noise:.2g} times its high-frequency content)"
            for one in self.outputs
            if one.z > BEYOND and not (one.declared or self.process_noise)
        ]
        if doubtful:
            found.append(
                f"what is left of {', '.join(doubtful)} may be its sensor or the model: "
                "declare its noise (noise_std)"
            )
        return tuple(found)

    @property
    def sizes(self) -> str:
        """Whole-run errors in units and per cent of the signals, the largest three, in words."""
        rows = [(o.error / o.spread, o.size) for o in self.outputs if np.isfinite(o.error)]
        return ", ".join(words for _, words in sorted(rows, reverse=True)[:3])

    @property
    def took_the_work(self) -> bool:
        """Whether process noise has taken the work of physics."""
        return self.process_noise and bool(self.said)

    to_dict = as_dict(
        "ratio", "usual_ratio", "process_noise", "unasked", "objections", "open_questions",
        "follows",
        outputs=lambda self: {one.output: one for one in self.outputs},
    )  # fmt: skip


def _granted(
    dataset: Dataset, declared: np.ndarray, fitted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviation that every sensor is granted, and the error of its variance's logarithm.

    Declared, or of the records' high-frequency content where that is larger: no model and no option
    enters. That content where nothing was declared, and what a fit estimated where the records do
    not show it. The error is zero where it is no estimate.
    """
    fast, seen = white_levels(dataset)
    taken = seen & ~(fast <= declared)
    count = sum(np.isfinite(record.outputs).sum(axis=0) for record in dataset)
    error = 2.0 * DIFFERENCE_ERROR / np.sqrt(np.maximum(count, 1))
    levels = np.where(np.isfinite(declared), declared, fitted)
    return np.where(taken, fast, levels), np.where(taken, error, 0.0)


def judged_runs(fit: Estimate, other: Dataset | None = None, *, unasked: str = "") -> WholeRuns:
    """Ask whether the noise model of a fit could have left the runs that were measured.

    Parameters
    ----------
    fit : Estimate
    other : Dataset, optional
        Records that the fit has not seen, in place of its own: parameters then scatter by their
        covariance, and only starts and the sea, which is another one on another day, are estimated
        anew.
    unasked : str
        Why draws would say nothing (waves that the noise model does not hold); errors are told
        all the same.
    """
    dataset = fit.dataset if other is None else other
    declared = believed_levels(fit.model.outputs, dataset)
    granted = _granted(dataset, declared, fit.noise.sensors)
    starts = _starts(fit) if other is None else None
    own = runs = whole_runs(fit.model, dataset, granted[0], starts)
    if other is not None:
        fit = _in_another_sea(fit, dataset, own)
    elif not fit.noise.is_white:
        runs = without_process_noise(fit, granted[0], own) or own
    without, z, usual = rms(runs), np.full(len(declared), np.nan), np.inf
    if dataset.only_tests:
        unasked = unasked or "independent tests have no runs"
    while not unasked:
        departure = partial(_departure, fit, declared, granted, shared=other is None)
        z, usual, unasked = _asked(departure, own, runs)
        coarse = np.isfinite(declared) & (z < -BEYOND)
        if fit.noise.has_forces or not coarse.any():
            break
        # The declared noise would not have left runs as good: it is not the sensor's.
        declared = np.where(coarse, np.nan, declared)
        granted = _granted(dataset, declared, without)
    facts = (rms(own), without, signal_spread(dataset), granted[0], np.isfinite(declared), z)
    return WholeRuns(
        tuple(
            OutputRuns(output.name, output.unit, *(part[column].item() for part in facts))
            for column, output in enumerate(fit.model.outputs)
        ),
        fit.noise.has_forces,
        unasked,
        usual,
    )


def _in_another_sea(fit: Estimate, dataset: Dataset, own: Sequence[WholeRun]) -> Estimate:
    """The fit with the sea of records that it has not seen, where it has one."""
    if not fit.noise.seas:
        return fit
    begun = tuple(run.shooting.initial_state(run.unknowns, 0) for run in own)
    sizes = tuple(run.local for run in own)
    there = replace(fit, dataset=dataset, initial_states=begun, local_values=sizes)
    return replace(fit, noise=with_sea_of_its_records(there))


def _asked(
    departure: Callable[[Sequence[WholeRun]], tuple[np.ndarray, float, str]],
    own: Sequence[WholeRun],
    runs: Sequence[WholeRun],
) -> tuple[np.ndarray, float, str]:
    """``z`` of every output, the usual ratio, and why not where they cannot be told.

    A fit without process noise may be led far beyond first order by forces that are strong: what is
    clear there is asked once more at the fit's own values, where the same operator acts on what was
    measured as on what is drawn, and both have to say it.
    """
    z, usual, unasked = departure(runs)
    if runs is own:
        return z, usual, unasked
    usual = usual if _near(own, runs) else np.inf
    if unasked or (np.abs(z) > BEYOND).any():
        here, _, silent = departure(own)
        unasked = unasked and silent  # what one of the two tells was asked
        z = np.where(np.isnan(z), here, np.sign(z) * np.fmin(np.abs(z), np.abs(here)))
    return z, usual, unasked


def _near(own: Sequence[WholeRun], runs: Sequence[WholeRun]) -> bool:
    """Whether first order leads from some runs to others: it mispredicts less than it moves.

    A fit without process noise may end in another basin, whose runs say nothing about these.
    """
    missed = moved = 0.0
    for one, other in zip(own, runs, strict=True):
        if one.diverges:
            return False
        away = (other.outputs - one.outputs) * one.weights()
        step = other.unknowns - one.unknowns
        linear = np.einsum("tij,j->ti", one.jacobian, step) * one.weights()
        # The step is of first order where the tangent leaves less than it takes.
        moved += float(np.sum(away**2))
        missed += float(np.sum((away - linear) ** 2))
    return missed < moved


def _starts(fit: Estimate) -> list[tuple[np.ndarray, Mapping[str, float]]] | None:
    """Start states and parameters of every record, where a fit tells them."""
    if not len(fit.initial_states) == len(fit.local_values) == len(fit.dataset):
        return None
    return list(zip(fit.initial_states, fit.local_values, strict=True))


def without_process_noise(
    fit: Estimate, sigma: np.ndarray, own: Sequence[WholeRun]
) -> tuple[WholeRun, ...] | None:
    """Runs of the same model fitted to the same records with noise of sensors alone.

    Parameters
    ----------
    fit : Estimate
    sigma : ndarray (n_outputs,)
    own : sequence of WholeRun
        Whole runs of the fit: one search begins there, in one piece, and only goes down; others at
        measured states with the values of the fit and with those that it began at. The best end.
    """
    nominal = {n: v for n, v in fit.nominal.items() if n in fit.model.values}
    shooting = Shooting(fit.model, fit.dataset, sigma)
    points = [shooting.start_point()]
    if nominal:
        points.append(Shooting(fit.model.with_values(nominal), fit.dataset, sigma).start_point())
    if not any(run.diverges for run in own):
        begin = shooting.start_unknowns()
        for index, run in enumerate(own):
            columns = shooting.layout.record_columns(index)
            begin[columns] = run.unknowns[run.shooting.layout.record_columns(0)]
        points.append(shooting.continuous(begin))
    found = [
        tuple(
            WholeRun.at(*shooting.part([index], end.point.unknowns))
            for index in range(len(fit.dataset))
        )
        for point in points
        if np.isfinite((end := solve(shooting, point)).cost)
    ]
    # By whole runs: where iterations stall, the pieces of a trajectory need not meet.
    return min(found, key=_square, default=None)


def _square(runs: Sequence[WholeRun]) -> float:
    """Sum of squares of whole runs in noise units; infinite where one diverges."""
    total = sum(float(np.sum(run.whitened() ** 2)) for run in runs)
    return total if np.isfinite(total) else np.inf


def _departure(
    fit: Estimate,
    declared: np.ndarray,
    granted: tuple[np.ndarray, np.ndarray],
    runs: Sequence[WholeRun],
    *,
    shared: bool,
) -> tuple[np.ndarray, float, str]:
    """``z`` of every output, the usual ratio, and why not where they cannot be told.

    Sensors are no noisier than they are granted, whatever a fit took for their noise; beside
    process noise only where that was declared.
    """
    nothing = np.full(len(declared), np.nan)
    if any(run.diverges for run in runs):
        return nothing, np.inf, "the model diverges without process noise"
    (levels, error), covariance = granted, fit.shared_covariance
    taken = np.isfinite(declared) | (not fit.noise.has_forces)
    noise = fit.noise.at_most(np.where(taken, levels, np.inf))
    root = root_of(np.where(np.isfinite(covariance), covariance, 0.0))
    sums = _draws(runs, noise, root, shared=shared)
    if sum(len(left) for left, _ in sums) < 0.5 * DRAWS:
        return nothing, np.inf, "most runs under this process noise diverge"
    drawn, scattered = map(np.concatenate, zip(*sums, strict=True))
    # At the optimum of the runs that is what they leave already.
    seen = _Estimator.of(runs, shared=shared).leaves([run.whitened()[None] for run in runs])[0]
    count = sum((run.weights() > 0).sum(axis=0) for run in runs)
    with np.errstate(divide="ignore", invalid="ignore"):
        low, middle, high = np.quantile(np.log(drawn), [0.16, 0.5, 0.84], axis=0)
        distance = np.log(seen) - middle
        z = distance / np.hypot(np.where(distance > 0, high - middle, middle - low), error)
        means = [np.nanmean(part / count, axis=1) for part in (scattered, drawn)]
        usual = float(np.sqrt(np.quantile(means[0] / means[1], 1.0 - CHANCE)))
    return np.where(count > 0, z, np.nan), usual, ""


def _draws(
    runs: Sequence[WholeRun], noise: NoiseModel, root: np.ndarray, *, shared: bool
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Sums of squares ``(n_draws, n_outputs)`` that estimators leave of drawn runs, some at once.

    The first is of the estimator of the runs, the second of one whose shared parameters scatter.
    """
    whole, starts = (_Estimator.of(runs, shared=one) for one in (shared, False))
    rng = np.random.default_rng(0)  # the same draws for the same fit
    sums = []
    for _ in range(0, DRAWS, CHUNK):
        away = [_drawn(run, noise, rng) for run in runs]
        finite = np.all([np.isfinite(part).all(axis=(1, 2)) for part in away], axis=0)
        if not finite.any():
            continue
        away = [part[finite] for part in away]
        moved = rng.standard_normal((len(away[0]), len(root))) @ root.T
        off = [part + _moved(run, moved) for run, part in zip(runs, away, strict=True)]
        sums.append((whole.leaves(away if shared else off), starts.leaves(off)))
    return sums


def _drawn(run: WholeRun, noise: NoiseModel, rng: np.random.Generator) -> np.ndarray:
    """Whitened departures of some runs under a noise model, ``(n_draws, n_times, n_outputs)``."""
    away = run.sensors(noise, CHUNK, rng)
    if noise.has_forces:
        away += run.drawn(noise, np.tile(run.unknowns, (CHUNK, 1)), rng) - run.outputs
    return away * run.weights()


def _moved(run: WholeRun, moved: np.ndarray) -> np.ndarray:
    """Whitened departures by other shared parameters, ``(n_draws, n_times, n_outputs)``."""
    slopes = run.shooting.layout.shared_values(run.unknowns)[1]
    away = np.einsum("tij,kj->kti", run.jacobian[:, :, run.shared], moved / slopes)
    return np.asarray(away * run.weights())


@dataclass(frozen=True, eq=False)
class _Estimator:
    """Least squares of all unknowns of some runs together, to first order.

    Attributes
    ----------
    rows : tuple of ndarray (n_times * n_outputs, n_here)
        Whitened derivatives of each run by its unknowns.
    columns : tuple of ndarray of int (n_here,)
        Where these stand among all.
    inverse : ndarray (n_all, n_all)
    """

    rows: tuple[np.ndarray, ...]
    columns: tuple[np.ndarray, ...]
    inverse: np.ndarray

    @classmethod
    def of(cls, runs: Sequence[WholeRun], *, shared: bool) -> _Estimator:
        """The estimator of start states and parameters of every record, and of shared ones."""
        layout = replace(runs[0].shooting.layout, n_records=len(runs))
        here = layout.record_columns(0)
        columns = tuple(layout.record_columns(index) for index in range(len(runs)))
        rows = tuple(run.rows()[:, here] for run in runs)
        matrix, prior = np.zeros((layout.n_unknowns,) * 2), np.zeros(layout.n_unknowns)
        for run, own, part in zip(runs, columns, rows, strict=True):
            matrix[np.ix_(own, own)] += part.T @ part
            prior[own] = run.shooting.limits.prior_weight[here]
        matrix += np.diag(prior)
        if not shared:
            held = runs[0].shared
            matrix[held], matrix[:, held] = 0.0, 0.0
        return cls(rows, columns, inverse_of(matrix))

    def leaves(self, away: Sequence[np.ndarray]) -> np.ndarray:
        """Sums of squares that are left of whitened departures, ``(n_draws, n_outputs)``."""
        flat = [part.reshape(len(part), -1).T for part in away]
        right = np.zeros((len(self.inverse), len(away[0])))
        for rows, own, part in zip(self.rows, self.columns, flat, strict=True):
            right[own] += rows.T @ part
        answer = self.inverse @ right
        total = np.zeros((len(away[0]), away[0].shape[2]))
        for rows, own, part, like in zip(self.rows, self.columns, flat, away, strict=True):
            rest = (part - rows @ answer[own]).T.reshape(like.shape)
            total += (rest**2).sum(axis=1)
        return total
