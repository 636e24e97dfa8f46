r"""Predictions of a fitted model on records it has not seen, with their uncertainty.

Start states and parameters that differ from record to record are estimated from the whole run
(:mod:`oed_sysid.likelihood.whole_runs`). A trajectory then spreads by the shared parameters, whose
covariance is ``C``, by those estimates, and by process noise and autocorrelated sensors,

.. math:: V(t) = J(t)\, C\, J(t)' + J_s(t)\, C_s\, J_s(t)' + \overline{r_b(t)^2}

with ``J`` the derivatives after the start was estimated anew, and ``r_b`` what that leaves of the
departures of runs that are drawn under process noise. Where first order misleads, ``V`` is the mean
square of runs in which parameters and starts are drawn too.

Estimated series of unknown inputs, read off a fit; see :mod:`oed_sysid.physics.unknown`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.errors import DataError, located
from oed_sysid.likelihood.estimate import Estimate, by_name
from oed_sysid.likelihood.laws import CHUNK
from oed_sysid.likelihood.noise_levels import root_mean_square
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.projection import root_of
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.likelihood.unknowns import KnownStarts, StartState
from oed_sysid.likelihood.whole_runs import WholeRun
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import IMMATERIAL, MATERIAL

# Mean over a run of drawn over first-order variances, of the same draws, from which (or below whose
# inverse) first order misleads: bands that differ by less are the same.
MISLEADS = (1.0 + IMMATERIAL) ** 2

SimulateAll = Callable[[np.ndarray, np.random.Generator], np.ndarray]


@dataclass(frozen=True, eq=False)
class Spread:
    """Distribution of the unknowns of one record.

    Attributes
    ----------
    unknowns : ndarray (n_unknowns,)
        Its centre.
    shared, others : ndarray of int
        Columns of shared parameters, and of start states and parameters of the record.
    gain : ndarray (n_others, n_shared)
        How the others follow the shared, as they would if they were estimated anew.
    covariance : ndarray (n_shared, n_shared)
        Infinite variances stay at the centre.
    other_covariance : ndarray (n_others, n_others)
        At given shared parameters.
    bounds : tuple of ndarray (n_unknowns,)
        Lower and upper; draws beyond are set to them.
    """

    unknowns: np.ndarray
    shared: np.ndarray
    others: np.ndarray
    gain: np.ndarray
    covariance: np.ndarray
    other_covariance: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]

    def draw(self, n_draws: int, rng: np.random.Generator) -> np.ndarray:
        """Unknowns, ``(n_draws, n_unknowns)``."""
        known = np.isfinite(np.diag(self.covariance))
        root, own = root_of(self.covariance[np.ix_(known, known)]), root_of(self.other_covariance)
        steps = np.zeros((n_draws, len(self.shared)))
        steps[:, known] = rng.normal(size=(n_draws, len(root))) @ root.T
        found = np.tile(self.unknowns, (n_draws, 1))
        found[:, self.shared] += steps
        alone = rng.normal(size=(n_draws, len(own))) @ own.T
        # A start that is estimated with other parameters follows them, and scatters besides.
        found[:, self.others] += alone - steps @ self.gain.T
        return np.clip(found, *self.bounds)

    def mean_square(
        self, simulate: SimulateAll, outputs: np.ndarray, n_draws: int = 200
    ) -> np.ndarray:
        """Mean square about ``outputs`` of runs that do not run away, ``(n_times, n_outputs)``."""
        rng = np.random.default_rng(0)  # the same draws for the same fit
        total, count = np.zeros_like(outputs), 0
        for done in range(0, n_draws, CHUNK):
            runs = simulate(self.draw(min(CHUNK, n_draws - done), rng), rng)
            runs = runs[(np.abs(runs) < 1e100).all(axis=(1, 2))]  # beyond, squares overflow
            total += ((runs - outputs) ** 2).sum(axis=0)
            count += len(runs)
        return total / count if count else np.full_like(outputs, np.inf)


def misleads(variance: np.ndarray, drawn: np.ndarray) -> bool:
    """Whether first-order variances differ clearly from those of some draws, on the whole."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(np.isfinite(variance) & (variance > 0), drawn / variance, np.nan)
    seen = ~np.isnan(ratio).all(axis=0)
    means = np.nanmean(ratio[:, seen], axis=0)
    return bool(np.any((means > MISLEADS) | (means < 1.0 / MISLEADS)))


def unknown_series(fit: Estimate, effect: str) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Times and values of the nodes of an unknown input, one pair for each record.

    Parameters
    ----------
    fit : Estimate
        Of a model with :func:`~oed_sysid.physics.unknown.UnknownInput` or
        :func:`~oed_sysid.physics.unknown.UnknownForce`.
    effect : str
        Name of the effect, for instance ``"unknown_input_rudder"``.

    Returns
    -------
    tuple of (times (n_nodes,), values (n_nodes,))
        In s as in the record, and in the unit of the signal; linear in between.

    Raises
    ------
    DataError
        If the model has no such effect.
    """
    inputs = {e.name: e for e in fit.model.effects if e.name.startswith("unknown_")}
    located(DataError, "The fit has no unknown input", [effect], inputs)
    names = [parameter.name for parameter in inputs[effect].parameters]
    # Nodes are counted by (t - begin)/spacing.
    spacing = float(inputs[effect].definitions["node"].rpartition("/")[2])
    steps = np.arange(len(names)) * spacing
    values = fit.model.values
    return tuple(
        (record.times[0] + steps, np.cumsum([local.get(n, values[n]) for n in names]))
        for record, local in zip(fit.dataset, fit.local_values, strict=True)
    )


WAYS = {
    "fit": "estimated on each record itself, all shared parameters held",
    "first": "the first measurement of each state",
    "given": "given",
}

Initial = str | StartState


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a model says about some records.

    Attributes
    ----------
    dataset : Dataset
        The records.
    outputs : tuple of ndarray (n_times, n_outputs)
        Model outputs, per record.
    model_std : tuple of ndarray (n_times, n_outputs)
        Standard deviation that the uncertainty of parameters and initial
        states gives them, and disturbance forces of the fit, if any; infinite
        where a parameter is not identifiable and matters.
    sigma : ndarray (n_outputs,)
        Standard deviation of the white measurement noise.
    sensors : ndarray (n_outputs,)
        That of all measurement noise, autocorrelated noise included: the measure of errors.
    initial_states : tuple of mapping
        The model's own initial states, per record.
    way : str
        Where these come from: ``fit``, ``first`` or ``given``.
    local_values : tuple of mapping
        Values of per-record parameters, per record.
    caveat : str
        Why the bands are too narrow; empty where nothing says so.

    Examples
    --------
    What :meth:`Fit.predict <oed_sysid.likelihood.fit.Fit.predict>` returns; its errors by output
    are in ``rms``, in the outputs' units.
    """

    dataset: Dataset
    outputs: tuple[np.ndarray, ...]
    model_std: tuple[np.ndarray, ...]
    sigma: np.ndarray
    sensors: np.ndarray
    initial_states: tuple[Mapping[str, float], ...]
    way: str
    local_values: tuple[Mapping[str, float], ...] = ()
    caveat: str = ""

    @property
    def residuals(self) -> tuple[np.ndarray, ...]:
        """Measured minus predicted, per record; NaN where nothing was measured."""
        pairs = zip(self.dataset, self.outputs, strict=True)
        return tuple(record.residuals(outputs) for record, outputs in pairs)

    @property
    def std(self) -> tuple[np.ndarray, ...]:
        """Standard deviation of a new measurement: model and noise together."""
        return tuple(np.hypot(std, self.sigma) for std in self.model_std)

    def coverage(self, factor: float = 1.959964) -> dict[str, float]:
        """Share of the measurements within ``factor`` standard deviations, by output."""
        ratios = np.vstack(
            [residual / std for residual, std in zip(self.residuals, self.std, strict=True)]
        )
        seen = np.isfinite(ratios)
        with np.errstate(invalid="ignore"):  # where nothing was measured
            share = (seen & (np.abs(ratios) <= factor)).sum(axis=0) / seen.sum(axis=0)
        return by_name(self.dataset.channels.output_names, share)

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square residual of each output over all records, in its unit."""
        names = self.dataset.channels.output_names
        return by_name(names, root_mean_square(self.residuals))

    def report(self) -> str:
        """Return the prediction errors as text."""
        lines = [
            f"prediction of {', '.join(self.dataset.names)}",
            f"  initial states: {WAYS[self.way]}",
        ]
        coverage = self.coverage()
        for output, (name, rms), sigma in zip(
            self.dataset.channels.outputs, self.rms.items(), self.sensors, strict=True
        ):
            lines.append(
                f"  {name}: rms {rms:.3g} {output.unit}, noise {sigma:.3g}; "
                f"{100 * coverage[name]:.0f} % within the 95 % band"
            )
        lines += [f"  {self.caveat}"] if self.caveat else []
        return "\n".join(lines)


def predict(
    model: Model,
    dataset: Dataset,
    covariance: np.ndarray,
    noise: NoiseModel | np.ndarray,
    *,
    initial: Initial = "fit",
) -> Prediction:
    """Predict records with a model at its values.

    Parameters
    ----------
    model : Model
        At the fitted values; its free parameters are uncertain.
    dataset : Dataset
        Records with the model's channels.
    covariance : ndarray (n_shared, n_shared)
        Of the free parameters that all records share, in the model's order.
    noise : NoiseModel or ndarray (n_outputs,)
        All that is random; levels alone stand for white noise.
    initial : str or mapping
        ``"fit"`` estimates the initial states (and per-record parameters) on
        each record with all shared parameters held, ``"first"`` takes the first
        measurements, a mapping gives the model's own states: a number is exact, a
        pair ``(value, std)`` has a standard error, which the bands then carry.

    Returns
    -------
    Prediction
        Its bands follow from the exact sensitivities to first order, or from draws
        where parameters are poorly known. For a record that the fit has used they are
        slightly too wide.
    """
    if not isinstance(noise, NoiseModel):
        noise = NoiseModel.white_only(np.asarray(noise), model.output_names)
    way = "given" if isinstance(initial, Mapping) else initial
    if way not in WAYS:
        raise DataError(f"initial is {initial!r}. Choose 'fit', 'first' or give the states.")
    if isinstance(initial, Mapping) and set(initial) != set(model.state_names):
        raise DataError(
            f"initial gives {', '.join(initial) or 'nothing'}; give a value for each of "
            f"{', '.join(model.state_names)}."
        )
    parts = [_predict(model, r, covariance, noise, initial, way) for r in dataset]
    outputs, stds, starts, local = zip(*parts, strict=True)
    white = noise.white.copy()
    return Prediction(dataset, outputs, stds, white, noise.sensors, starts, way, local)


def _predict(
    model: Model,
    record: Record,
    covariance: np.ndarray,
    noise: NoiseModel,
    initial: Initial,
    way: str,
) -> tuple[np.ndarray, np.ndarray, dict[str, float], dict[str, float]]:
    known = None if isinstance(initial, str) else KnownStarts.of(model, Dataset((record,)), initial)
    if way == "fit":
        run = WholeRun.fitted(model, record, noise.sensors)
    else:
        shooting = Shooting(model, Dataset((record,)), noise.sensors, known_starts=known)
        run = WholeRun.at(shooting, shooting.start_unknowns())
    if run.diverges:
        empty = np.full(record.outputs.shape, np.nan)
        return empty, empty, run.states, run.local
    variance = _variance(run, covariance, noise, way, known)
    return run.outputs, np.sqrt(variance), run.states, run.local


def _variance(
    run: WholeRun, covariance: np.ndarray, noise: NoiseModel, way: str, known: KnownStarts | None
) -> np.ndarray:
    """Variance of the outputs of a run, white noise of the sensors apart."""
    jacobian = run.jacobian
    spread, answer = _spread(run, covariance, way, known)
    by_other = jacobian[:, :, run.others]
    # Total derivative: shared parameters move the outputs, and the start that is fitted to them.
    by_shared = jacobian[:, :, run.shared] - by_other @ spread.gain
    of_start = _carry(by_other, spread.other_covariance)
    variance = of_start + _carry_uncertain(by_shared, spread.covariance)

    def alone(unknowns: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return np.array([run.simulated(one) for one in unknowns])

    def linear(unknowns: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return run.outputs + np.einsum("tij,kj->kti", jacobian, unknowns - run.unknowns)

    def disturbed(unknowns: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Runs under process noise, less what an estimate of the start makes of that."""
        runs = run.drawn(noise, unknowns, rng) if noise.has_forces else alone(unknowns, rng)
        away = runs - run.outputs
        if answer is not None:
            away = away + run.sensors(noise, len(runs), rng, white=False)
            whitened = (away * run.weights()).reshape(len(away), -1)
            # The start of a real run would be fitted to the disturbed record, and takes a part of
            # it away.
            away = away - np.einsum("tij,kj->kti", by_other, whitened @ answer.T)
        return run.outputs + away

    if not noise.is_white:
        given = spread
        if answer is not None:  # start states follow from the rest
            given = replace(spread, other_covariance=0.0 * spread.other_covariance)
        drawn = given.mean_square(disturbed, run.outputs)
        drawn += noise.colour**2 if answer is None else of_start
        return np.where(np.isfinite(variance), drawn, variance)
    if np.any(variance > (MATERIAL * noise.sensors) ** 2):
        # The same draws, to first order and simulated, over the whole run: what differs is no
        # chance, and no moment at which nothing moves to first order.
        first, few = (
            spread.mean_square(runs, run.outputs, CHUNK).mean(axis=0, keepdims=True)
            for runs in (linear, alone)
        )
        if misleads(first, few):
            drawn = spread.mean_square(alone, run.outputs)
            variance = np.where(np.isfinite(variance), drawn, variance)
    return variance


def _spread(
    run: WholeRun, covariance: np.ndarray, way: str, known: KnownStarts | None
) -> tuple[Spread, np.ndarray | None]:
    """What is uncertain of a run, and how its start answers a departure where it is estimated."""
    shooting, answer = run.shooting, None
    layout, shared, others = shooting.layout, run.shared, run.others
    gain = np.zeros((len(others), len(shared)))
    if way == "fit":
        # Estimated anew for every value of the shared parameters, and noisy itself.
        answer, other_covariance = run.answer()
        gain = answer @ run.rows()[:, shared]
    else:
        std = shooting.guess_std[0, : layout.n_own] if known is None else known.std[0]
        other_covariance = np.diag([*np.nan_to_num(std) ** 2, *np.zeros(len(layout.local))])
    # Of the shared unknowns, from that of the values of shared parameters.
    slopes = layout.shared_values(run.unknowns)[1]
    spread = Spread(
        run.unknowns,
        shared,
        others,
        gain,
        covariance / slopes[:, None] / slopes,
        other_covariance,
        (shooting.limits.lower, shooting.limits.upper),
    )
    return spread, answer


def _carry(jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.maximum(np.einsum("tij,jk,tik->ti", jacobian, covariance, jacobian), 0.0)


def _carry_uncertain(jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Variance of outputs; infinite where an infinitely uncertain parameter matters."""
    finite = np.isfinite(np.diag(covariance))
    variance = _carry(jacobian[:, :, finite], covariance[np.ix_(finite, finite)])
    blind = np.abs(jacobian[:, :, ~finite]).max(axis=2, initial=0.0) > 1e-12
    return np.where(blind, np.inf, variance)
