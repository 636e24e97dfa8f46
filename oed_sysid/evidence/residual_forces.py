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
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.projection import inverse_of
from oed_sysid.likelihood.score_test import LEAST_SEEN, Scored
from oed_sysid.likelihood.smoother import smoothable
from oed_sysid.runtime.constants import IMMATERIAL
from oed_sysid.runtime.display import as_dict


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
    fit: FilteredSolution, unit: NoiseModel, near: FilteredSolution | None = None
) -> tuple[Filtered, np.ndarray]:
    """The likelihood of a fit with a force in every equation, however small, and its unknowns.

    Parameters
    ----------
    fit : FilteredSolution
    unit : NoiseModel
        Natural size of every level.
    near : FilteredSolution, optional
        Its parameters, and its noise of the same places, take those of the fit's place.
    """
    old, near = fit.problem, near or fit
    noise = near.noise
    # A sea, or noise of a logged input, stands in the place of forces.
    more = [place for place in unit.places if place not in noise.places]
    noise = noise.with_places(more, [unit.level(place)[1] for place in more])
    # Where no force was found one may have acted all the same.
    least = [IMMATERIAL * unit.level(place)[0] for place in noise.places]
    noise = replace(
        noise,
        white=np.maximum(noise.white, LEAST_SEEN * unit.white),
        force=np.maximum(noise.force, least),
    )
    model = old.model.with_values(
        {name: value for name, value in near.values.items() if name in old.model.values}
    )
    held = old.levels.held().starting(noise)
    problem = old.posed(replace(held, disturbances=noise.disturbances), model=model)
    return problem, problem.point(fit.initial, fit.local).unknowns


class ResidualForces:
    """Smoother of one fit.

    Attributes
    ----------
    problem : Filtered
        With no level unknown.
    point : Scored
        Innovations and their derivatives by the unknowns.
    covariance : ndarray (n_unknowns, n_unknowns)
        Of the unknowns.
    paths : sequence of Path
        Of every record.
    columns : list of ndarray (n_times, n_disturbances, n_unknowns_here)
        Derivatives of the smoothed disturbances by the unknowns of each record.
    """

    def __init__(self, problem: Filtered, unknowns: np.ndarray) -> None:
        self.problem = problem
        passes, self.paths = smoothable(problem, unknowns)
        self.point = Scored(problem, unknowns, passes)
        self.covariance = inverse_of(self.point.equations[0])
        self.columns = []
        for index, (part, path) in enumerate(zip(passes, self.paths, strict=True)):
            rows = part.rows * problem.columns_of(unknowns, index)[1]
            self.columns.append(path.disturbances(rows * np.sqrt(part.variances)[:, :, None]))

    def series(self) -> Iterator[Series]:
        """Smoothed disturbances, per record."""
        parts = zip(self.paths, self.columns, self._smoothed(self.point), strict=True)
        for index, (path, columns, values) in enumerate(parts):
            where = self.problem.layout.record_columns(index)
            spread = np.sum((columns @ self.covariance[np.ix_(where, where)]) * columns, axis=2)
            std = np.sqrt(path.std**2 + np.maximum(spread, 0.0))
            yield Series(self.problem.records[index].times, values, std)

    def signature(self, measured: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
        """What would be smoothed had the records been others.

        Parameters
        ----------
        measured : sequence of ndarray (n_times, n_outputs)
            What to put in place of the measurements, per record.

        Yields
        ------
        ndarray (n_times, n_disturbances)
        """
        passes = self.problem.passes(self.point.unknowns, measured=measured)
        return self._smoothed(replace(self.point, passes=passes))

    def _smoothed(self, point: Scored) -> Iterator[np.ndarray]:
        step = self.covariance @ point.equations[1]
        for index, (path, part) in enumerate(zip(self.paths, point.passes, strict=True)):
            own = path.disturbances(part.innovations[:, :, None])[:, :, 0]
            where = self.problem.layout.record_columns(index)
            yield own + self.columns[index] @ step[where]
