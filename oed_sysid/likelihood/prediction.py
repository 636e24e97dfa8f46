r"""Predictions of a fitted model on records it has not seen, with their uncertainty.

Without measurements a trajectory spreads by three causes: parameters and start states,

.. math:: V(t) = J(t)\, C\, J(t)' + P(t), \qquad P_{k+1} = F P_k F' + Q

the disturbance forces of the noise model (``P``, from a filter that is shown nothing), and the
sensors. Where a first-order band would mislead, because parameters are poorly known or random
forces throw the vehicle far, ``V`` is the mean square of runs in which all is drawn.

What is predicted where all that is uncertain is drawn, not carried to first order.

Mean squares about the prediction, of runs with parameters, start states and disturbance forces
drawn together: beyond first order an unstable vehicle falls to one side or the other.

Estimated series of unknown inputs, read off a fit; see :mod:`oed_sysid.physics.unknown`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.errors import DataError
from oed_sysid.experiments.simulation import simulate_batch
from oed_sysid.likelihood.disturbances import chosen_places, with_disturbance_inputs
from oed_sysid.likelihood.estimate import Estimate
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.gauss_newton import solve, solve_filtered
from oed_sysid.likelihood.levels import Levels
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.realisation import gauss_markov
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.likelihood.unknowns import KnownStarts, Layout, StartState
from oed_sysid.physics.model import Model

# Draws that show whether a first-order band would mislead, draws of a band, and at once.
N_PROBE, N_DRAWS, CHUNK = 20, 200, 20
RUNAWAY = 1e100  # a draw beyond is no run of a vehicle
# Mean over a run of drawn over first-order variances from which (or below whose inverse) it does;
# three times the scatter of so few draws.
MISLEADS = 2.0
# The same where both are of the same draws, so that no chance is in it.
MISLEADS_SURELY = 1.2

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
        root, own = _root(self.covariance[np.ix_(known, known)]), _root(self.other_covariance)
        steps = np.zeros((n_draws, len(self.shared)))
        steps[:, known] = rng.normal(size=(n_draws, len(root))) @ root.T
        found = np.tile(self.unknowns, (n_draws, 1))
        found[:, self.shared] += steps
        alone = rng.normal(size=(n_draws, len(own))) @ own.T
        found[:, self.others] += alone - steps @ self.gain.T
        return np.clip(found, *self.bounds)

    def mean_square(
        self, simulate: SimulateAll, outputs: np.ndarray, n_draws: int = N_DRAWS
    ) -> np.ndarray:
        """Mean square about ``outputs`` of runs that do not run away, ``(n_times, n_outputs)``."""
        rng = np.random.default_rng(0)  # the same draws for the same fit
        total, count = np.zeros_like(outputs), 0
        for done in range(0, n_draws, CHUNK):
            runs = simulate(self.draw(min(CHUNK, n_draws - done), rng), rng)
            runs = runs[(np.abs(runs) < RUNAWAY).all(axis=(1, 2))]
            total += ((runs - outputs) ** 2).sum(axis=0)
            count += len(runs)
        return total / count if count else np.full_like(outputs, np.inf)


def misleads(variance: np.ndarray, drawn: np.ndarray, limit: float = MISLEADS) -> bool:
    """Whether first-order variances differ clearly from those of some draws, on the whole."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(np.isfinite(variance) & (variance > 0), drawn / variance, np.nan)
    seen = ~np.isnan(ratio).all(axis=0)
    means = np.nanmean(ratio[:, seen], axis=0)
    return bool(np.any((means > limit) | (means < 1.0 / limit)))


def runs_at_sea(
    model: Model,
    record: Record,
    noise: NoiseModel,
    split: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> SimulateAll:
    """Runs of a record under drawn disturbance forces.

    Parameters
    ----------
    model : Model
    record : Record
        Gives times and inputs.
    noise : NoiseModel
        Its forces are drawn; sensors are without noise.
    split : callable
        From unknowns to all values of the model's parameters and its own start states.
    """
    acting = [i for i in range(len(noise.force)) if noise.force[i] > 0]
    places = chosen_places(model, [noise.places[i] for i in acting])
    vehicle = with_disturbance_inputs(model, places)

    def simulate(unknowns: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        values, starts = (np.array(part) for part in zip(*map(split, unknowns), strict=True))
        waves = [
            [gauss_markov(noise.force[i], noise.force_time[i], record.times, rng) for i in acting]
            for _ in unknowns
        ]
        calm = np.broadcast_to(record.inputs, (len(unknowns), *record.inputs.shape))
        shape = (len(unknowns), len(acting), len(record.times))
        inputs = np.concatenate([calm, np.reshape(waves, shape).swapaxes(1, 2)], axis=2)
        return simulate_batch(vehicle, record.times, inputs=inputs, values=values, initials=starts)

    return simulate


def _root(covariance: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


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
    found = next((one for one in fit.model.effects if one.name == effect), None)
    spacing = None if found is None else re.search(r"/([\d.e+-]+)$", found.definitions["node"])
    if found is None or spacing is None:
        names = [e.name for e in fit.model.effects if e.name.startswith("unknown_")]
        raise DataError(
            f"The fit has no unknown input {effect!r}. It has {', '.join(names) or 'none'}."
        )
    names = [parameter.name for parameter in found.parameters]
    steps = np.arange(len(names)) * float(spacing[1])
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
# Relative standard error of a parameter from which bands are drawn, and share of the band that it
# must matter.
DRAWN, MATTERS = 0.15, 0.3


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
        states gives them; infinite where a parameter is not identifiable and
        matters.
    sigma : ndarray (n_outputs,)
        Standard deviation of the measurement noise.
    initial_states : tuple of mapping
        The model's own initial states, per record.
    way : str
        Where these come from: ``fit``, ``first`` or ``given``.
    local_values : tuple of mapping
        Values of per-record parameters, per record.
    caveat : str
        Why the bands are too narrow; empty where nothing says so.
    """

    dataset: Dataset
    outputs: tuple[np.ndarray, ...]
    model_std: tuple[np.ndarray, ...]
    sigma: np.ndarray
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
        result = {}
        for name, column in zip(self.dataset.channels.output_names, ratios.T, strict=True):
            seen = column[np.isfinite(column)]
            result[name] = float(np.mean(np.abs(seen) <= factor)) if len(seen) else np.nan
        return result

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square residual of each output over all records, in its unit."""
        stacked = np.vstack(self.residuals)
        count = np.maximum(np.isfinite(stacked).sum(axis=0), 1)
        squares = np.nansum(stacked**2, axis=0) / count
        empty = ~np.isfinite(stacked).any(axis=0)
        values = np.where(empty, np.nan, np.sqrt(squares))
        return dict(zip(self.dataset.channels.output_names, map(float, values), strict=True))

    def report(self) -> str:
        """Return the prediction errors as text."""
        lines = [
            f"prediction of {', '.join(self.dataset.names)}",
            f"  initial states: {WAYS[self.way]}",
        ]
        coverage = self.coverage()
        for output, (name, rms), sigma in zip(
            self.dataset.channels.outputs, self.rms.items(), self.sigma, strict=True
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
    if isinstance(initial, Mapping):
        unknown = [name for name in initial if name not in model.state_names]
        if unknown or len(initial) < len(model.states):
            raise DataError(
                f"initial gives {', '.join(initial) or 'nothing'}; give a value for each of "
                f"{', '.join(model.state_names)}."
            )
    if noise.is_white:
        parts = [_predict(model, r, covariance, noise.white, initial, way) for r in dataset]
    else:
        parts = [_predict_disturbed(model, r, covariance, noise, initial, way) for r in dataset]
    outputs, stds, starts, local = zip(*parts, strict=True)
    return Prediction(dataset, outputs, stds, noise.white.copy(), starts, way, local)


def _predict(
    model: Model,
    record: Record,
    covariance: np.ndarray,
    sigma: np.ndarray,
    initial: Initial,
    way: str,
) -> tuple[np.ndarray, np.ndarray, dict[str, float], dict[str, float]]:
    known = _given(model, record, initial)
    shooting = Shooting(model, Dataset((record,)), sigma, known_starts=known)
    layout = shooting.layout
    n_shared, n_own = len(layout.shared), layout.n_own
    shared = np.arange(n_shared)
    point = shooting.start_point()
    own_variance = np.zeros(n_own)
    if way == "fit":
        held = shooting.holding(shared, point.unknowns[shared])
        solution = solve(held, held.start_point())
        if solution is not None:
            point = solution.point
    elif way == "first":
        stds = shooting.guess_std[0, :n_own]
        own_variance = np.where(np.isfinite(stds), stds, 0.0) ** 2
    elif known is not None:
        own_variance = known.std[0] ** 2
    smooth = shooting.continuous(point.unknowns)
    lin = shooting.linearise(smooth)
    states = dict(zip(model.state_names, map(float, point.unknowns[n_shared:]), strict=False))
    own = layout.parameters(point.unknowns, 0)
    values = {layout.free_names[i]: float(own[i]) for i in layout.local}
    covariance = _of_unknowns(covariance, layout, point.unknowns)
    if lin is None:
        empty = np.full(record.outputs.shape, np.nan)
        return empty, empty, states, values
    jacobian = lin.jacobians[0]
    by_shared = at_given_others = jacobian[:, :, n_own + layout.shared]
    others = np.concatenate([np.arange(n_own), n_own + layout.local])
    by_other = jacobian[:, :, others]
    if way == "fit":
        # Re-estimated for every value of the shared parameters, and noisy themselves.
        columns = layout.record_columns(0)
        present = np.isfinite(lin.residuals[0]) / sigma
        prior = np.sqrt(shooting.limits.prior_weight[columns[others]])
        inner = np.vstack(
            [(by_other * present[:, :, None]).reshape(-1, len(others)), np.diag(prior)]
        )
        outer = (by_shared * present[:, :, None]).reshape(-1, n_shared)
        inverse = np.linalg.pinv(inner, rcond=1e-10)
        by_shared = by_shared - by_other @ (inverse[:, : len(outer)] @ outer)
        other_covariance = inverse @ inverse.T
    else:
        other_covariance = np.diag([*own_variance, *np.zeros(len(layout.local))])
    variance = _carry(by_other, other_covariance) + _carry_uncertain(by_shared, covariance)
    outputs = _outputs(shooting, point.unknowns)
    if np.any(variance > (MATTERS * sigma) ** 2):
        gain = np.zeros((len(others), n_shared))
        if way == "fit":
            gain = inverse[:, : len(outer)] @ outer
        spread = Spread(
            point.unknowns,
            shared,
            layout.record_columns(0)[others],
            gain,
            covariance,
            other_covariance,
            (shooting.limits.lower, shooting.limits.upper),
        )

        def simulated(unknowns: np.ndarray, _: np.random.Generator) -> np.ndarray:
            return np.array([_outputs(shooting, one) for one in unknowns])

        def linear(unknowns: np.ndarray, _: np.random.Generator) -> np.ndarray:
            away = unknowns - spread.unknowns
            far = np.einsum("tij,kj->kti", at_given_others, away[:, spread.shared])
            return outputs + far + np.einsum("tij,kj->kti", by_other, away[:, spread.others])

        # The same draws, to first order and simulated, over the whole run: what differs is no
        # chance, and no moment at which nothing moves to first order.
        first_order, few = (
            spread.mean_square(run, outputs, N_PROBE).mean(axis=0, keepdims=True)
            for run in (linear, simulated)
        )
        if _poorly_known(model, layout.shared_names, covariance) or misleads(
            first_order, few, MISLEADS_SURELY
        ):
            drawn = spread.mean_square(simulated, outputs)
            variance = np.where(np.isfinite(variance), drawn, variance)
    return outputs, np.sqrt(variance), states, values


def _predict_disturbed(
    model: Model,
    record: Record,
    covariance: np.ndarray,
    noise: NoiseModel,
    initial: Initial,
    way: str,
) -> tuple[np.ndarray, np.ndarray, dict[str, float], dict[str, float]]:
    """One record under disturbance forces or coloured sensors."""
    known = _given(model, record, initial)
    start = Shooting(model, Dataset((record,)), noise.sensors, known_starts=known)
    begin = start.start_unknowns()
    disturbances = tuple(f"disturbance_{place.replace(' ', '_', 1)}" for place in noise.places)
    nothing = np.zeros(0, dtype=bool)
    levels = Levels.of(
        noise,
        noise,
        disturbances,
        white=np.zeros(len(noise.white), dtype=bool),
        colour=np.zeros(len(noise.white), dtype=bool),
        force=np.zeros(len(noise.force), dtype=bool) if len(noise.force) else nothing,
    )
    problem = Filtered(model, Dataset((record,)), levels)
    layout = problem.layout
    n_shared, n_own = len(layout.shared), layout.n_own
    columns = layout.record_columns(0)
    shared = np.arange(n_shared)
    others = np.concatenate([columns[:n_own], columns[n_own + layout.local]])
    point = problem.point([begin[columns[:n_own]]])
    other_covariance = np.zeros((len(others), len(others)))
    gain = np.zeros((len(others), n_shared))
    if way == "fit":
        held = problem.holding(shared, point.unknowns[shared])
        solution = solve_filtered(held, point, polish=0)
        if solution is not None:
            point = solution.point
            matrix = solution.matrix + np.diag(problem.limits.prior_weight)
            other_covariance = np.linalg.pinv(matrix[np.ix_(others, others)], rcond=1e-10)
            gain = other_covariance @ matrix[np.ix_(others, shared)]
    elif way == "first":
        stds = start.guess_std[0, :n_own]
        own_variance = np.where(np.isfinite(stds), stds, 0.0) ** 2
        other_covariance = np.diag([*own_variance, *np.zeros(len(layout.local))])
    elif known is not None:
        other_covariance = np.diag([*known.std[0] ** 2, *np.zeros(len(layout.local))])
    unknowns = point.unknowns
    covariance = _of_unknowns(covariance, layout, unknowns)
    blind = np.full(record.outputs.shape, np.nan)
    (part,) = problem.passes(unknowns, rows=True, measured=[blind])
    states = dict(
        zip(model.state_names, map(float, problem.initial_state(unknowns, 0)), strict=True)
    )
    own = layout.parameters(unknowns, 0)
    values = {layout.free_names[i]: float(own[i]) for i in layout.local}

    position = {name: i for i, name in enumerate(model.parameter_names)}
    free = [position[name] for name in layout.free_names]

    def split(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own = model.value_vector.copy()
        own[free] = layout.parameters(vector, 0)
        return own, problem.initial_state(vector, 0)

    outputs, _, _ = problem.alone(unknowns, 0)
    if not part.ok or part.rows is None:
        return np.full(record.outputs.shape, np.nan), blind, states, values
    jacobian = -part.rows * np.sqrt(part.variances)[:, :, None]
    if layout.logged is not None:
        jacobian[:, :, n_own : n_own + len(layout.free_names)] *= layout.slopes(
            unknowns[columns[n_own:]]
        )
    by_shared = jacobian[:, :, n_own + layout.shared]
    by_other = jacobian[:, :, np.concatenate([np.arange(n_own), n_own + layout.local])]
    by_shared = by_shared - by_other @ gain
    variance = _carry(by_other, other_covariance) + _carry_uncertain(by_shared, covariance)
    # White noise of sensors is no matter of the model; their colour is, as of what drifts.
    total = variance + np.maximum(part.variances - noise.white**2, 0.0)
    bounds = (problem.limits.lower, problem.limits.upper)
    spread = Spread(unknowns, shared, others, gain, covariance, other_covariance, bounds)
    simulate = runs_at_sea(model, record, noise, split)
    doubtful = _poorly_known(model, layout.shared_names, covariance) and bool(
        np.any(variance > MATTERS**2 * part.variances)
    )
    colour = noise.colour**2
    if doubtful or misleads(total, colour + spread.mean_square(simulate, outputs, N_PROBE)):
        drawn = colour + spread.mean_square(simulate, outputs)
        total = np.where(np.isfinite(total), drawn, total)
    return outputs, np.sqrt(total), states, values


def _given(model: Model, record: Record, initial: Initial) -> KnownStarts | None:
    """What is stated of the start states."""
    if isinstance(initial, str):
        return None
    return KnownStarts.of(model, Dataset((record,)), initial)


def _of_unknowns(covariance: np.ndarray, layout: Layout, unknowns: np.ndarray) -> np.ndarray:
    """Covariance of the shared unknowns from that of the values of shared parameters."""
    if layout.logged is None:
        return covariance
    slopes = layout.shared_values(unknowns)[1]
    return covariance / slopes[:, None] / slopes


def _poorly_known(model: Model, names: Sequence[str], covariance: np.ndarray) -> bool:
    """Whether some unknown's error is too large for a first-order band."""
    errors = np.sqrt(np.diag(covariance))
    parameters = [model.parameter(name) for name in names]
    sizes = np.array([1.0 if p.log else abs(p.value) for p in parameters])
    return bool(np.any(np.isfinite(errors) & (errors > DRAWN * sizes)))


def _outputs(shooting: Shooting, unknowns: np.ndarray) -> np.ndarray:
    record, values = shooting.records[0], shooting.values(unknowns, 0)
    z0, _ = shooting.full_start(unknowns, 0)
    return shooting.kernel.run(record.times, record.inputs, values, z0).outputs


def _carry(jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.maximum(np.einsum("tij,jk,tik->ti", jacobian, covariance, jacobian), 0.0)


def _carry_uncertain(jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Variance of outputs; infinite where an infinitely uncertain parameter matters."""
    finite = np.isfinite(np.diag(covariance))
    variance = _carry(jacobian[:, :, finite], covariance[np.ix_(finite, finite)])
    blind = np.abs(jacobian[:, :, ~finite]).max(axis=2, initial=0.0) > 1e-12
    return np.where(blind, np.inf, variance)
