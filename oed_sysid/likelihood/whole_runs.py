r"""Whole runs: a model on its own along a record, and what an estimator makes of disturbed ones.

Where a vehicle starts, and what differs from record to record (a zero of the helm), is estimated
from the whole run, all shared parameters held:

.. math::
    \hat s = \arg\min_s \sum_k \frac{(y_k - \hat y_k(s))^2}{\sigma^2} + (s - m)' \Lambda (s - m)

A filter would let process noise correct a start that is off, sample by sample; a run without it
then turns away from the record. Of runs drawn under process noise, departing by ``d`` from the
undisturbed one, an estimator with derivatives ``J`` (whitened, priors ``Λ``) returns and leaves

.. math:: t = (J'J + \Lambda)^{-1} J'd, \qquad r = d - J t .
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.experiments.simulation import simulate_batch
from oed_sysid.likelihood.disturbances import chosen_places, with_disturbance_inputs
from oed_sysid.likelihood.gauss_newton import solve
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.realisation import drawn_disturbances, gauss_markov
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.likelihood.unknowns import KnownStarts
from oed_sysid.physics.model import Model

# Singular directions of whitened derivatives below this share of the largest are not answered.
SINGULAR = 1e-10


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
    jacobian : ndarray (n_times, n_outputs, n_unknowns), or None
        Derivatives of the outputs by shared parameters, start states and parameters of the record,
        in the order of the unknowns; None where the model diverges.
    """

    shooting: Shooting
    unknowns: np.ndarray
    outputs: np.ndarray
    jacobian: np.ndarray | None

    @classmethod
    def at(cls, shooting: Shooting, unknowns: np.ndarray) -> WholeRun:
        """The run at given unknowns."""
        outputs = _simulated(shooting, unknowns)
        found = shooting.linearise(shooting.continuous(unknowns))
        if found is None:
            return cls(shooting, unknowns, outputs, None)
        jacobian = np.empty((*outputs.shape, len(unknowns)))
        jacobian[:, :, shooting.layout.record_columns(0)] = found.jacobians[0]
        return cls(shooting, unknowns, outputs, jacobian)

    @classmethod
    def fitted(
        cls,
        model: Model,
        record: Record,
        sigma: np.ndarray,
        known: KnownStarts | None = None,
        start: tuple[np.ndarray, Mapping[str, float]] | None = None,
    ) -> WholeRun:
        """The run whose start states and values of the record are fitted to the whole record.

        Parameters
        ----------
        model : Model
            At its values; shared parameters are held.
        record : Record
        sigma : ndarray (n_outputs,)
            Standard deviation of one measurement.
        known : KnownStarts, optional
        start : pair of ndarray (n_own,) and mapping, optional
            Start states and parameters of the record to begin with.
        """
        shooting = Shooting(model, Dataset((record,)), sigma, known_starts=known)
        point = shooting.start_point()
        shared = np.arange(len(shooting.layout.shared))
        held = shooting.holding(shared, point.unknowns[shared])
        begin = point.unknowns if start is None else _begun(shooting, point.unknowns, *start)
        ends = [solve(held, held.start_point(begin))]
        if start is not None:
            ends.append(solve(held, held.continuous(begin)))
        found = min((end for end in ends if end is not None), key=lambda e: e.cost, default=None)
        return cls.at(shooting, point.unknowns if found is None else found.point.unknowns)

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
        """Positions of start states and parameters of the record among the unknowns."""
        layout = self.shooting.layout
        columns = layout.record_columns(0)
        return np.concatenate([columns[: layout.n_own], columns[layout.n_own + layout.local]])

    @property
    def states(self) -> dict[str, float]:
        """Start values of the model's own states."""
        names = self.shooting.model.state_names
        return dict(
            zip(names, map(float, self.shooting.initial_state(self.unknowns, 0)), strict=True)
        )

    @property
    def local(self) -> dict[str, float]:
        """Values of the parameters of the record."""
        layout = self.shooting.layout
        own = layout.parameters(self.unknowns, 0)
        return {layout.free_names[i]: float(own[i]) for i in layout.local}

    def weights(self) -> np.ndarray:
        """Inverse standard deviations ``(n_times, n_outputs)``, zero where nothing was measured."""
        return np.isfinite(self.record.outputs) / self.shooting.sigma

    def answer(self) -> tuple[np.ndarray, np.ndarray]:
        """What a fit of :attr:`others` makes of a departure, and its covariance from white noise.

        Returns
        -------
        inverse : ndarray (n_others, n_times * n_outputs)
            Takes a whitened departure to the change of the estimates.
        covariance : ndarray (n_others, n_others)
        """
        assert self.jacobian is not None
        own = self.jacobian[:, :, self.others] * self.weights()[:, :, None]
        prior = np.sqrt(self.shooting.limits.prior_weight[self.others])
        rows = np.vstack([own.reshape(-1, len(self.others)), np.diag(prior)])
        inverse = np.linalg.pinv(rows, rcond=SINGULAR)
        return inverse[:, : len(rows) - len(prior)], inverse @ inverse.T

    def simulated(self, unknowns: np.ndarray) -> np.ndarray:
        """Outputs at other unknowns, ``(n_times, n_outputs)``."""
        return _simulated(self.shooting, unknowns)

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
        forces = [drawn_disturbances(noise, record.times, rng) for _ in unknowns]
        vehicle = with_disturbance_inputs(model, chosen_places(model, list(forces[0])))
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


def _simulated(shooting: Shooting, unknowns: np.ndarray) -> np.ndarray:
    record, values = shooting.records[0], shooting.values(unknowns, 0)
    z0, _ = shooting.full_start(unknowns, 0)
    return shooting.kernel.run(record.times, record.inputs, values, z0).outputs


def _begun(
    shooting: Shooting, unknowns: np.ndarray, states: np.ndarray, local: Mapping[str, float]
) -> np.ndarray:
    """Unknowns with given start states and values of the record."""
    layout, begin = shooting.layout, unknowns.copy()
    columns = layout.record_columns(0)
    begin[columns[: layout.n_own]] = states
    values = layout.natural(unknowns[columns[layout.n_own :]]).copy()
    for i in layout.local:
        values[i] = local.get(layout.free_names[i], values[i])
    begin[columns[layout.n_own + layout.local]] = layout.inward(values)[layout.local]
    return begin


def whole_runs(
    model: Model,
    dataset: Dataset,
    sigma: np.ndarray,
    starts: Sequence[tuple[np.ndarray, Mapping[str, float]]] | None = None,
) -> tuple[WholeRun, ...]:
    """Whole runs along all records, each with its own start fitted."""
    begun = [None] * len(dataset) if starts is None else starts
    return tuple(
        WholeRun.fitted(model, record, sigma, start=start)
        for record, start in zip(dataset, begun, strict=True)
    )


def rms(runs: Sequence[WholeRun]) -> np.ndarray:
    """Root mean square residual of whole runs, ``(n_outputs,)``.

    Infinite where the model diverges, NaN where nothing was measured.
    """
    residuals = np.vstack([run.record.residuals(run.outputs) for run in runs])
    seen = np.vstack([np.isfinite(run.record.outputs) for run in runs])
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        squares = np.where(seen, residuals, 0.0) ** 2
        found = np.sqrt(squares.sum(axis=0) / seen.sum(axis=0))
    return np.where(seen.any(axis=0) & ~np.isfinite(found), np.inf, found)
