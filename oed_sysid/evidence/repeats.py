r"""Whether what was taken for a random force follows the motion of the vehicle.

A force that nobody can foresee knows nothing of where the model goes on its own. So the smoothed
force :math:`\hat d` is averaged, on all records but one, in classes of one or two signals
:math:`s` of the model's own run; on the record left out these means :math:`m(s(t))` are compared
with :math:`\hat d(t)`, and so on for every record. The correlation has the standard error

.. math:: \sigma_\rho^2 = \frac1n\Bigl(1 + 2\sum_{k>0} \rho_d(k)\,\rho_m(k)\Bigr)

(Bartlett 1935, *J. R. Stat. Soc.* 98, 536). Signals are those of the model on its own, not the
measured ones: these follow a random force because it moves the vehicle. Commands that are not held
may answer it, too (a helmsman's rudder), and then nothing is asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import SimulationError
from oed_sysid.evidence.residual_forces import ResidualForces, let_in
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.information import lagged_products
from oed_sysid.likelihood.noise_model import NoiseModel

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
    try:
        parts = [*_series(fit, study.unit), *_series(other, study.unit)]
    except SimulationError:  # deviations grow beyond all bounds: nothing to be smoothed
        return None
    if len(parts) < len(study.train.records) + len(study.validation.records):
        return None
    names = set.intersection(*(set(signals) for _, signals in parts))
    known = [name for name in parts[0][1] if name in names]
    found = []
    for index, place in enumerate(study.unit.places):
        if not fit.noise.level(place)[0] > 0 or not place.startswith("force"):
            continue
        alone = max((_share(parts, index, (name,)), (name,)) for name in known)
        pair = max(
            ((_share(parts, index, two), two) for two in combinations(known, 2)),
            default=(0.0, ()),
        )
        # Two signals only where they leave clearly less than the better of them.
        share, chosen = pair if 1.0 - pair[0] < CLEARLY * (1.0 - alone[0]) else alone
        if share > SHARE:
            found.append(Repeated(place, chosen, float(share)))
    return tuple(found)


Part = tuple[np.ndarray, dict[str, np.ndarray]]


def _held(dataset: Dataset) -> bool:
    """Whether commands are held from sample to sample."""
    return all(
        np.mean(np.diff(column) != 0.0) < MOVING for record in dataset for column in record.inputs.T
    )


def _series(fit: FilteredSolution, unit: NoiseModel) -> list[Part]:
    """Smoothed forces, and the signals of the model's own run, per record; none if that fails."""
    problem = fit.problem
    forces = ResidualForces.of(*let_in(fit, unit)).series()
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
