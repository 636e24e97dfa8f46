r"""Residual forces: what must have acted in every equation, given the whole record.

The filter of a fit, disturbance forces admitted, gives innovations ``e`` and their derivatives by
all
unknowns; its smoother (:mod:`oed_sysid.likelihood.smoother`) turns both into forces. The unknowns
take the Gauss-Newton step that goes with the innovations, and their covariance enters the errors:

.. math::
    \hat w = S(e) + S(\partial e)\, \delta, \qquad
    \operatorname{var} \hat w = V + S(\partial e)\, C\, S(\partial e)'

Free parameters absorb part of a missing force. The residual force is the rest; a candidate is put
through the same projection and the same smoother before it is compared with it.

What was taken for a disturbance force may follow the motion of the vehicle. A force that nobody can
foresee knows nothing of where the model goes on its own. So the smoothed force :math:`\hat d` is
averaged, on all records but one, in classes of one or two signals :math:`s` of the model's own run;
on the record left out these means :math:`m(s(t))` are compared with :math:`\hat d(t)`, and so on
for every record. The correlation has the standard error

.. math:: \sigma_\rho^2 = \frac1n\Bigl(1 + 2\sum_{k>0} \rho_d(k)\,\rho_m(k)\Bigr)

(Bartlett 1935, *J. R. Stat. Soc.* 98, 536). Signals are those of the model on its own, not the
measured ones: these follow a disturbance force because it moves the vehicle. Commands that are not
held may answer it, too (a helmsman's rudder), and then nothing is asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import SimulationError
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.information import lagged_products
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.projection import bounded_step
from oed_sysid.likelihood.smoother import Path
from oed_sysid.runtime.display import as_dict

# Smallest force admitted, as a share of its unit: where none was found one may have acted all the
# same. Smallest white noise of a sensor, in the same way: a level that colour has taken over would
# make one sensor the whole truth.
LEAST_FORCE, LEAST_WHITE = 0.1, 0.5


@dataclass(frozen=True, eq=False)
class Series:
    """Smoothed signals of one record.

    Attributes
    ----------
    times : ndarray (n_times,)
        In s.
    values, std : ndarray (n_times, n_signals)
        Expectation, and standard error with the uncertainty of parameters and
        initial states in it.
    """

    times: np.ndarray
    values: np.ndarray
    std: np.ndarray

    def only(self, chosen: Sequence[int]) -> Series:
        """Some of the signals."""
        return Series(self.times, self.values[:, chosen], self.std[:, chosen])

    to_dict = as_dict("times", "values", "std")


def let_in(
    fit: FilteredSolution,
    unit: NoiseModel,
    values: Mapping[str, float] | None = None,
    noise: NoiseModel | None = None,
) -> tuple[Filtered, np.ndarray]:
    """The likelihood of a fit with a force in every equation, however small, and its unknowns.

    Parameters
    ----------
    fit : FilteredSolution
    unit : NoiseModel
        Natural size of every level.
    values : mapping, optional
        Parameters, and ``noise`` of the same places, in place of the fit's.
    noise : NoiseModel, optional
    """
    old, noise = fit.problem, fit.noise if noise is None else noise
    known = dict(zip(unit.places, unit.force, strict=True))
    more = [place for place in unit.places if place not in noise.places] if noise.seas else []
    noise = replace(  # a sea stands in the place of forces
        noise,
        force=np.append(noise.force, np.zeros(len(more))),
        force_time=np.append(noise.force_time, [unit.level(place)[1] for place in more]),
        places=(*noise.places, *more),
    )
    least = np.array([LEAST_FORCE * known.get(place, 0.0) for place in noise.places])
    noise = replace(
        noise,
        white=np.maximum(noise.white, LEAST_WHITE * unit.white),
        force=np.maximum(noise.force, least),
    )
    model = old.model.with_values(
        {name: value for name, value in (values or fit.values).items() if name in old.model.values}
    )
    problem = Filtered(
        model,
        old.dataset,
        replace(old.levels.held().starting(noise), disturbances=noise.disturbed().disturbances),
        kernel=old.kernel,
        known_starts=old.known_starts,
        knowledge=old.knowledge,
    )
    return problem, problem.point(fit.initial, fit.local).unknowns


@dataclass(frozen=True, eq=False)
class ResidualForces:
    """Smoother of one fit.

    Attributes
    ----------
    problem : Filtered
        With no level unknown.
    unknowns : ndarray (n_unknowns,)
    paths : tuple of Path
        Of every record.
    columns : tuple of ndarray (n_times, n_disturbances, n_unknowns_here)
        Derivatives of the smoothed disturbances by the unknowns of each record.
    innovations : tuple of ndarray (n_times, n_outputs)
    """

    problem: Filtered
    unknowns: np.ndarray
    paths: tuple[Path, ...]
    columns: tuple[np.ndarray, ...]
    innovations: tuple[np.ndarray, ...]
    matrix: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, problem: Filtered, unknowns: np.ndarray) -> ResidualForces:
        """Filter and smooth the records of a problem."""
        passes = problem.passes(unknowns, rows=True, gains=True, moves=True)
        if not all(part.ok for part in passes):
            raise SimulationError(
                f"Model {problem.model.name!r} diverges although a force may act in every "
                "equation. Cut the record, or bound the parameters."
            )
        matrix, right = problem.gathered(unknowns, passes)
        paths = tuple(
            Path.of(part, problem.levels.n_coloured, problem.levels.n_second) for part in passes
        )
        columns = []
        for index, (part, path) in enumerate(zip(passes, paths, strict=True)):
            rows = derivatives(problem, unknowns, index, part.rows)
            columns.append(path.disturbances(rows * np.sqrt(part.variances)[:, :, None]))
        innovations = tuple(part.innovations for part in passes)
        return cls(problem, unknowns, paths, tuple(columns), innovations, matrix, right)

    def series(self) -> tuple[Series, ...]:
        """Smoothed disturbances, per record."""
        covariance = _inverse(self.matrix + np.diag(self.problem.limits.prior_weight))
        values = self._smoothed(self.innovations, self.right)
        result = []
        for index, (path, columns) in enumerate(zip(self.paths, self.columns, strict=True)):
            where = self.problem.layout.record_columns(index)
            spread = np.sum((columns @ covariance[np.ix_(where, where)]) * columns, axis=2)
            std = np.sqrt(path.std**2 + np.maximum(spread, 0.0))
            result.append(Series(self.problem.records[index].times, values[index], std))
        return tuple(result)

    def signature(self, measured: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
        """What would be smoothed had the records been others.

        Parameters
        ----------
        measured : sequence of ndarray (n_times, n_outputs)
            What to put in place of the measurements, per record.

        Returns
        -------
        tuple of ndarray (n_times, n_disturbances)
        """
        passes = self.problem.passes(self.unknowns, measured=measured)
        _, right = self.problem.gathered(self.unknowns, passes)
        return self._smoothed([part.innovations for part in passes], right)

    def _smoothed(
        self, innovations: Sequence[np.ndarray], right: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        limits = self.problem.limits
        free = np.full(len(right), np.inf)
        step = bounded_step(
            self.matrix + np.diag(limits.prior_weight),
            right + limits.prior_weight * (limits.prior_mean - self.unknowns),
            -free,
            free,
            0.0,
        )
        result = []
        for index, (path, part) in enumerate(zip(self.paths, innovations, strict=True)):
            own = path.disturbances(part[:, :, None])[:, :, 0]
            where = self.problem.layout.record_columns(index)
            result.append(own + self.columns[index] @ step[where])
        return tuple(result)


def derivatives(
    problem: Filtered, unknowns: np.ndarray, index: int, rows: np.ndarray | None
) -> np.ndarray:
    """Rows of a pass by the unknowns of its record, zero where nothing was measured."""
    assert rows is not None
    layout = problem.layout
    where = layout.record_columns(index)
    slopes = layout.slopes(unknowns[where[layout.n_own :]])
    known = np.isfinite(problem.records[index].outputs)[:, :, None]
    size = np.concatenate([np.ones(layout.n_own), slopes])
    return np.where(known, rows[:, :, : len(where)] * size, 0.0)


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Covariance of the directions that the records see."""
    size = np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), np.inf))
    inverse = np.linalg.pinv(matrix / size[:, None] / size, rcond=1e-11, hermitian=True)
    return inverse / size[:, None] / size


def agreement(forces: Sequence[Series], signature: Sequence[np.ndarray]) -> float:
    """Correlation of residual forces and a signature, both in standard errors."""
    seen = np.concatenate([(s.values / s.std).ravel() for s in forces])
    expected = np.concatenate(
        [(part / s.std).ravel() for part, s in zip(signature, forces, strict=True)]
    )
    size = np.linalg.norm(seen) * np.linalg.norm(expected)
    return float(seen @ expected / size) if size > 0 else 0.0


# Classes of one signal, and of each of two; fewest samples in a class.
CLASSES, PAIRED, FEWEST = 10, 5, 10
# Standard errors of a correlation, and share of the force's square, from which it repeats: with
# thirty questions one in a thousand searches would say so by chance.
SURE, SHARE = 4.0, 0.2
# What two signals leave of the square, over what one of them leaves, to be named both.
CLEARLY = 0.7
# Share of samples at which a held command may change.
MOVING = 0.2
# Lags over which correlations are added, as a share of a record.
LAGS = 0.25


@dataclass(frozen=True)
class Repeated:
    """A force taken for random that is a function of the motion.

    Attributes
    ----------
    place : str
        ``"force Z"``.
    signals : tuple of str
        One or two signals of the model's own run.
    share : float
        Share of the force's square that they explain on records left out.
    """

    place: str
    signals: tuple[str, ...]
    share: float

    @property
    def text(self) -> str:
        """In words, for instance ``force Z follows z (81 % of it)``."""
        return f"{self.place} follows {' and '.join(self.signals)} ({100 * self.share:.0f} % of it)"


def repeated(
    study: Study, fit: FilteredSolution, other: FilteredSolution | None
) -> tuple[Repeated, ...] | None:
    """Random forces of a fit that repeat with the motion, one entry a force.

    None where it cannot be asked: without validation records, or with commands that may answer.

    Parameters
    ----------
    study : Study
    fit : FilteredSolution
        To the training records.
    other : FilteredSolution or None
        The same parameters on the validation records; None without these, or where it fails.
    """
    if study.validation is None or other is None:
        return None
    if not _held(study.train) or not _held(study.validation):
        return None
    parts = [*_series(fit, study.unit), *_series(other, study.unit)]
    if len(parts) < len(study.train.records) + len(study.validation.records):
        return None
    names = set.intersection(*(set(signals) for _, signals in parts))
    known = [name for name in parts[0][1] if name in names]
    found = []
    for index, place in enumerate(study.unit.places):
        if not fit.noise.level(place)[0] > 0 or not place.startswith("force"):
            continue
        share, chosen = _followed(parts, index, known)
        if share > SHARE:
            found.append(Repeated(place, chosen, float(share)))
    return tuple(found)


def _followed(
    parts: Sequence[Part], index: int, known: Sequence[str]
) -> tuple[float, tuple[str, ...]]:
    """The signal or the two that explain most of a force, and the share of it."""
    alone = max((_share(parts, index, (name,)), (name,)) for name in known)
    pairs = ((_share(parts, index, two), two) for two in combinations(known, 2))
    pair = max(pairs, default=(0.0, ()))
    # Two signals only where they leave clearly less than the better of them.
    return pair if 1.0 - pair[0] < CLEARLY * (1.0 - alone[0]) else alone


Part = tuple[np.ndarray, dict[str, np.ndarray]]


def _held(dataset: Dataset) -> bool:
    """Whether commands are held from sample to sample."""
    return all(
        np.mean(np.diff(column) != 0.0) < MOVING for record in dataset for column in record.inputs.T
    )


def _series(fit: FilteredSolution, unit: NoiseModel) -> list[Part]:
    """Smoothed forces, and the signals of the model's own run, per record; none if that fails."""
    problem = fit.problem
    try:
        forces = ResidualForces.of(*let_in(fit, unit)).series()
    except SimulationError:
        return []
    result = []
    for index, record in enumerate(problem.records):
        _, states, ok = problem.alone(fit.point.unknowns, index)
        if not ok:
            return []
        signals = {
            state.name: _turned(states[:, column], state.unit)
            for column, state in enumerate(problem.model.states)
        }
        commands = zip(record.channels.input_names, record.inputs.T, strict=True)
        signals |= {name: series for name, series in commands if np.ptp(series) > 0}
        result.append((forces[index].values, signals))
    return result


def _turned(series: np.ndarray, unit: str) -> np.ndarray:
    """A heading that goes round is the same after a turn."""
    if unit == "rad" and np.ptp(series) > np.pi:
        return np.angle(np.exp(1j * series))
    return series


def _share(parts: Sequence[Part], index: int, names: Sequence[str]) -> float:
    """Share of a force's square that means of the other records explain; 0 where chance might."""
    n_classes = CLASSES if len(names) == 1 else PAIRED
    columns = [np.concatenate([signals[name] for _, signals in parts]) for name in names]
    edges = [np.quantile(c, np.linspace(0, 1, n_classes + 1)[1:-1]) for c in columns]
    size = n_classes ** len(names)
    inside = [_classes([s[name] for name in names], edges, n_classes) for _, s in parts]
    forces = [force[:, index] for force, _ in parts]
    counts = np.array([np.bincount(own, minlength=size) for own in inside])
    totals = np.array(
        [np.bincount(o, weights=f, minlength=size) for o, f in zip(inside, forces, strict=True)]
    )
    seen, said = [], []
    for own, force, count, total in zip(inside, forces, counts, totals, strict=True):
        others = counts.sum(axis=0) - count
        whole = totals.sum(axis=0) - total
        mean = whole.sum() / max(others.sum(), 1)
        means = np.where(others >= FEWEST, whole / np.maximum(others, 1), mean) - mean
        seen.append(force - mean)
        said.append(means[own])
    all_seen, all_said = np.concatenate(seen), np.concatenate(said)
    norm = float(np.linalg.norm(all_seen) * np.linalg.norm(all_said))
    if not norm > 0:
        return 0.0
    correlation = float(all_seen @ all_said) / norm
    return correlation**2 if correlation > SURE * _standard_error(seen, said) else 0.0


def _classes(
    columns: Sequence[np.ndarray], edges: Sequence[np.ndarray], n_classes: int
) -> np.ndarray:
    """Class of each sample."""
    found = np.zeros(len(columns[0]), dtype=int)
    for column, edge in zip(columns, edges, strict=True):
        found = found * n_classes + np.searchsorted(edge, column)
    return found


def _standard_error(seen: Sequence[np.ndarray], said: Sequence[np.ndarray]) -> float:
    """Standard error of the correlation of two series that have nothing to do with each other."""
    variance, squares = 0.0, np.zeros(2)
    for one, other in zip(seen, said, strict=True):
        lags = max(int(LAGS * len(one)), 1)
        own, its = (lagged_products(series, lags) for series in (one, other))
        variance += float(own[0] * its[0] + 2.0 * own[1:] @ its[1:]) / len(one)
        squares += own[0], its[0]
    return float(np.sqrt(max(variance, 0.0) / squares[0] / squares[1]))
