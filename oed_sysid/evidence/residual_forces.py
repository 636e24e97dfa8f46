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

What was taken for a disturbance may be a dynamic function of inputs and motion. With :math:`\hat d`
the smoothed force, of correlation time :math:`\tau`, and :math:`f_j` functions of logged inputs and
of the model's own run (piecewise linear in one or two signals, and low-pass filtered ones), its
shocks are regressed on all records but one and compared on the one left out,

.. math::
    \hat d_k - \phi \hat d_{k-1} = \sum_j a_j\, (f_{j,k} - \phi f_{j,k-1}) + s_k,
    \qquad \phi = e^{-\Delta/\tau}

A shock of a true disturbance knows nothing of what was commanded before it, and the error of
:math:`\hat d` is orthogonal to all that was measured: also where a helmsman or an autopilot answers
the disturbance, the correlation :math:`\rho` of shocks and regression is zero but for chance,

.. math:: \sigma_\rho^2 = \frac1n\Bigl(1 + 2\sum_{k>0} \rho_s(k)\,\rho_m(k)\Bigr)

(Bartlett 1935, *J. R. Stat. Soc.* 98, 536). The same is asked of slow noise of a sensor.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.signal import lfilter

from oed_sysid.compiled.filtering import FilterPass
from oed_sysid.data.record import Record
from oed_sysid.errors import SimulationError
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.information import lagged_products
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.projection import bounded_step
from oed_sysid.likelihood.smoother import Path
from oed_sysid.physics.model import Model
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
    more = [place for place in unit.places if place not in noise.places]
    noise = replace(  # a sea, or noise of a logged input, stands in the place of forces
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
        passes, paths = smoothable(problem, unknowns)
        matrix, right = problem.gathered(unknowns, passes)
        columns = []
        for index, (part, path) in enumerate(zip(passes, paths, strict=True)):
            rows = rows_of(problem, unknowns, index, part.rows)
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


def smoothable(
    problem: Filtered, unknowns: np.ndarray
) -> tuple[list[FilterPass], tuple[Path, ...]]:
    """Passes of all records with what a smoother needs, and the paths of that."""
    passes = problem.passes(unknowns, rows=True, gains=True, moves=True)
    if not all(part.ok for part in passes):
        raise SimulationError(
            f"Model {problem.model.name!r} diverges although a force may act in every equation. "
            "Cut the record, or bound the parameters."
        )
    levels = problem.levels
    return passes, tuple(Path.of(part, levels.n_coloured, levels.n_second) for part in passes)


def rows_of(
    problem: Filtered, unknowns: np.ndarray, index: int, rows: np.ndarray | None, more: int = 0
) -> np.ndarray:
    """Rows of a pass by the unknowns of its record, and so many more, zero where not measured."""
    assert rows is not None
    layout = problem.layout
    where = layout.record_columns(index)
    size = np.ones(len(where) + more)
    size[layout.n_own : len(where)] = layout.slopes(unknowns[where[layout.n_own :]])
    known = np.isfinite(problem.records[index].outputs)[:, :, None]
    return np.where(known, rows[:, :, : len(size)] * size, 0.0)


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


# Knots of a piecewise linear function, and low-pass filters of every signal.
KNOTS, FILTERS = 5, 3
# Standard errors of a correlation, and share of the force's square, from which it repeats: with
# thirty questions one in a thousand searches would say so by chance.
SURE, SHARE = 4.0, 0.2
# What two signals leave of the square, over what one of them leaves, to be named both.
CLEARLY = 0.7
# How the slow noise of a sensor is called in the place of a force.
SLOW = "noise of "
# Lags over which correlations are added, as a share of a record.
LAGS = 0.25


@dataclass(frozen=True)
class Repeated:
    """A force or noise of a sensor taken for random that is a function of the motion.

    Attributes
    ----------
    place : str
        ``"force Z"``, or ``"noise of q"``.
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


@dataclass(frozen=True, eq=False)
class _Part:
    """What one record, or a half of it, shows.

    Attributes
    ----------
    times : ndarray (n_times,)
    series : mapping of str to ndarray (n_times,)
        Smoothed forces and residuals of sensors with autocorrelated noise, by place.
    signals : mapping of str to ndarray (n_times,)
        Of the model's own run, and commands that move.
    """

    times: np.ndarray
    series: Mapping[str, np.ndarray]
    signals: Mapping[str, np.ndarray]

    def halves(self) -> list[_Part]:
        """Its first and its second half."""
        middle = len(self.times) // 2
        return [
            _Part(
                self.times[part],
                {name: values[part] for name, values in self.series.items()},
                {name: values[part] for name, values in self.signals.items()},
            )
            for part in (slice(middle), slice(middle, None))
        ]


def repeated(
    study: Study, fit: FilteredSolution, other: FilteredSolution | None
) -> tuple[Repeated, ...] | None:
    """Disturbance forces and slow noise of a fit that follow inputs and motion, one entry each.

    None where that cannot be asked: the smoother or the model on its own diverges.

    Parameters
    ----------
    study : Study
    fit : FilteredSolution
        To the training records.
    other : FilteredSolution or None
        The same parameters on the validation records; None without these, or where it fails.
    """
    parts = [part for one in (fit, other) if one is not None for part in _series(one, study.unit)]
    if len(parts) < len(study.train.records):
        return None
    names = set.intersection(*(set(part.signals) for part in parts))
    known = [name for name in parts[0].signals if name in names]
    asked = parts[0].series if known else ()
    found = [_followed(place, parts, _time(study, fit.noise, place), known) for place in asked]
    return tuple(one for one in found if one.share > SHARE)


def _time(study: Study, noise: NoiseModel, place: str) -> float:
    """Correlation time of a force, or of the slow noise of a sensor, s."""
    if place in noise.places:
        return float(noise.force_time[noise.places.index(place)])
    return float(noise.colour_time[study.base.output_names.index(place.removeprefix(SLOW))])


def _followed(place: str, parts: Sequence[_Part], time: float, known: Sequence[str]) -> Repeated:
    """The signal or the two that explain most of a series, and the share of it."""
    # On validation records a force may have vanished; a record alone is asked by halves.
    own = [part for part in parts if place in part.series]
    own = own if len(own) > 1 else own[0].halves()

    def best(sets: Iterable[tuple[str, ...]]) -> Repeated:
        shares = ((_share(own, place, time, names), names) for names in sets)
        share, names = max(shares, default=(0.0, ()))
        return Repeated(place, names, float(share))

    alone, pair = best((name,) for name in known), best(combinations(known, 2))
    # Two signals only where they leave clearly less than the better of them.
    return pair if 1.0 - pair.share < CLEARLY * (1.0 - alone.share) else alone


def _series(fit: FilteredSolution, unit: NoiseModel) -> list[_Part]:
    """Forces, slow noise and signals of the own run, per record; none if that fails."""
    problem, noise = fit.problem, fit.noise
    try:
        forces = ResidualForces.of(*let_in(fit, unit)).series()
    except SimulationError:
        return []
    acting = [
        (index, place)
        for index, place in enumerate(unit.places)
        if noise.level(place)[0] > 0 and place.startswith("force")
    ]
    slow = np.flatnonzero((noise.colour > 0) & (not acting))
    result = []
    for index, record in enumerate(problem.records):
        outputs, states, ok = problem.alone(fit.point.unknowns, index)
        if not ok:
            return []
        residuals, names = record.residuals(outputs), problem.model.output_names
        series = {place: forces[index].values[:, column] for column, place in acting}
        series |= {f"{SLOW}{names[column]}": _filled(residuals[:, column]) for column in slow}
        result.append(_Part(record.times, series, _moving(problem.model, record, states)))
    return result


def _moving(model: Model, record: Record, states: np.ndarray) -> dict[str, np.ndarray]:
    """States of a model's own run, and the inputs that move, by name."""
    own = zip(model.states, states.T, strict=False)
    found = {state.name: _turned(series, state.unit) for state, series in own}
    commands = zip(record.channels.input_names, record.inputs.T, strict=True)
    return found | {name: series for name, series in commands if np.ptp(series) > 0}


def _filled(series: np.ndarray) -> np.ndarray:
    """A series with missing samples linear in between; zero where there are none at all."""
    known = np.flatnonzero(np.isfinite(series))
    if not len(known):
        return np.zeros(len(series))
    return np.interp(np.arange(len(series)), known, series[known])


def _turned(series: np.ndarray, unit: str) -> np.ndarray:
    """A heading that goes round is the same after a turn."""
    if unit == "rad" and np.ptp(series) > np.pi:
        return np.angle(np.exp(1j * series))
    return series


def _share(parts: Sequence[_Part], place: str, time: float, names: Sequence[str]) -> float:
    """Share of a series' square that a function of signals explains on records left out.

    Zero where chance might.
    """
    features = _features(parts, names)
    series = [part.series[place] for part in parts]
    mean = float(np.mean(np.concatenate(series)))
    squares = float(np.mean((np.concatenate(series) - mean) ** 2))
    if not squares > 0:
        return 0.0
    memory = [np.exp(-np.diff(part.times) / max(time, 1e-300)) for part in parts]
    shocks, rows = _shocks(series, memory), _shocks(features, memory)
    # Each function may be as large as the series: a normal prior of that spread.
    prior = float(np.mean(np.concatenate(shocks) ** 2)) / squares * np.eye(features[0].shape[1])
    prior[-1, -1] = 0.0  # the constant
    sizes = _left_out(rows, shocks, prior)
    left, told, said = [], [], []
    for own, row, feature, size in zip(shocks, rows, features, sizes, strict=True):
        left.append(own - row[:, -1] * size[-1])
        told.append(row[:, :-1] @ size[:-1])
        said.append(feature[:, :-1] @ size[:-1])
    if not _correlation(left, told) > SURE * _standard_error(left, told):
        return 0.0
    return max(_correlation([own - mean for own in series], said), 0.0) ** 2


def _shocks(parts: Sequence[np.ndarray], memory: Sequence[np.ndarray]) -> list[np.ndarray]:
    """What of each series the sample before does not tell, ``(n_times - 1, ...)`` each."""
    return [(own[1:].T - phi * own[:-1].T).T for own, phi in zip(parts, memory, strict=True)]


def _left_out(
    rows: Sequence[np.ndarray], shocks: Sequence[np.ndarray], prior: np.ndarray
) -> list[np.ndarray]:
    """Coefficients ``(n_functions,)`` on all parts but one, for each."""
    matrices = [own.T @ own for own in rows]
    rights = [own.T @ of for own, of in zip(rows, shocks, strict=True)]
    return [
        np.linalg.lstsq(sum(matrices) - own + prior, sum(rights) - right, rcond=None)[0]
        for own, right in zip(matrices, rights, strict=True)
    ]


def _correlation(seen: Sequence[np.ndarray], said: Sequence[np.ndarray]) -> float:
    one, other = np.concatenate(seen), np.concatenate(said)
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(one @ other) / size if size > 0 else 0.0


def _features(parts: Sequence[_Part], names: Sequence[str]) -> list[np.ndarray]:
    """Functions of some signals, of unit size, and a constant, ``(n_times, n_functions)`` each."""
    hats, slow = [], []
    for name in names:
        columns = [part.signals[name] for part in parts]
        pooled = np.concatenate(columns)
        knots = np.unique(np.quantile(pooled, np.linspace(0, 1, KNOTS)))
        hats.append(
            [np.column_stack([np.interp(c, knots, one) for one in np.eye(len(knots))])
             for c in columns]
        )  # fmt: skip
        scale = max(float(np.std(pooled)), 1e-300)
        slow.append(
            [_low_passed(part.times, c / scale) for part, c in zip(parts, columns, strict=True)]
        )
    found = []
    for index, part in enumerate(parts):
        grid = hats[0][index]
        for other in hats[1:]:
            grid = (grid[:, :, None] * other[index][:, None, :]).reshape(len(part.times), -1)
        constant = np.ones((len(part.times), 1))
        found.append(np.hstack([grid, *(one[index] for one in slow), constant]))
    return found


def _low_passed(times: np.ndarray, series: np.ndarray) -> np.ndarray:
    """A signal after first-order lags, from some samples to a tenth of the record."""
    step, length = float(np.median(np.diff(times))), float(times[-1] - times[0])
    found = []
    for time in np.geomspace(3.0 * step, max(0.1 * length, 3.0 * step), FILTERS):
        share = -np.expm1(-step / time)
        begin = np.array([(1.0 - share) * series[0]])
        found.append(lfilter([share], [1.0, share - 1.0], series, zi=begin)[0])
    return np.column_stack(found)


def _standard_error(seen: Sequence[np.ndarray], said: Sequence[np.ndarray]) -> float:
    """Standard error of the correlation of two series that have nothing to do with each other."""
    variance, squares = 0.0, np.zeros(2)
    for one, other in zip(seen, said, strict=True):
        lags = max(int(LAGS * len(one)), 1)
        own, its = (lagged_products(series, lags) for series in (one, other))
        variance += float(own[0] * its[0] + 2.0 * own[1:] @ its[1:]) / len(one)
        squares += own[0], its[0]
    return float(np.sqrt(max(variance, 0.0) / squares[0] / squares[1]))
