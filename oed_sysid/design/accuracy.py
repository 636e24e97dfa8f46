r"""What accuracy can be promised when the vehicle is not quite the nominal one.

The bound belongs to one set of values. On vehicles a few per cent off, realised errors are 0.65 to
1.8 times those stated, so the bound is taken on vehicles drawn from what is known as well,

.. math:: s_i(\theta) = \sqrt{[F(\theta)^{-1}]_{ii}}, \qquad \theta \sim p(\theta)

and the range that eight in ten of them stay within is stated. Beyond ``TRUSTED`` a linear bound
under random forces promises too much (calm fins with stated errors of 30 to 80 per cent realised
3.4 times more), so that no number is given there.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from oed_sysid.design.quantities import percent
from oed_sysid.design.robust import draw_models
from oed_sysid.display import as_dict
from oed_sysid.errors import DesignError, OedSysidError
from oed_sysid.experiment import Experiment
from oed_sysid.fitting.fit import Fit
from oed_sysid.information import Information
from oed_sysid.model import Model
from oed_sysid.noise.model import NoiseModel
from oed_sysid.sensitivity.bound import information_of
from oed_sysid.sensitivity.noise import Levels

# Relative error up to which a bound under random forces is taken as it is.
TRUSTED = 0.3
# Share of the vehicles left out at either end of a range.
_TAIL = 0.1


def stated(error: float, sea: NoiseModel | None) -> str:
    """Return a relative error in words, or that there is none to be stated.

    >>> sea = NoiseModel(np.ones(1), np.zeros(1), np.ones(1), places=("force Z",))
    >>> stated(0.42, None), stated(0.42, sea), stated(0.12, sea)
    ('42%', 'not id.', '12%')
    """
    if sea is not None and sea.has_forces and not error <= TRUSTED:
        return "not id."
    return percent(error)


@dataclass(frozen=True, eq=False)
class AccuracyRange:
    """Relative errors on vehicles that are possible.

    Attributes
    ----------
    names : tuple of str
    lowest, highest : ndarray (n,)
        Shares of the values that eight in ten of the vehicles stay within.
    n_drawn : int
        Vehicles on which the runs stayed finite.
    sea : NoiseModel or None
    """

    names: tuple[str, ...]
    lowest: np.ndarray
    highest: np.ndarray
    n_drawn: int
    sea: NoiseModel | None = None

    def words(self, name: str) -> str:
        """Range of one parameter in words."""
        i = self.names.index(name)
        low, high = stated(self.lowest[i], self.sea), stated(self.highest[i], self.sea)
        return f"{low} to {high}" if low != high else low

    to_dict = as_dict(
        "n_drawn",
        parameters=lambda self: dict(
            zip(self.names, zip(self.lowest, self.highest, strict=True), strict=True)
        ),
    )


def accuracy_range(
    model: Model,
    runs: Experiment | Iterable[Experiment],
    *,
    rng: np.random.Generator,
    noise: Levels | NoiseModel | Fit = None,
    spread: float | None = None,
    prior: Information | None = None,
    n_draws: int = 12,
) -> AccuracyRange:
    """Predict errors on vehicles drawn from what is known.

    Parameters
    ----------
    model : Model
        The nominal vehicle.
    runs : Experiment or iterable of Experiment
        Planned together.
    rng : numpy.random.Generator
        Source of the vehicles.
    noise : optional
        See :func:`~oed_sysid.sensitivity.information_of`.
    spread : float or None
        Relative half-width of uniform draws around the values; None draws from what is
        known (prior standard deviations, or ``prior``).
    prior : Information, optional
        Known before the runs; counts in the errors too.
    n_draws : int

    Returns
    -------
    AccuracyRange

    Raises
    ------
    DesignError
        If the runs diverge on most vehicles.
    """
    listed = [runs] if isinstance(runs, Experiment) else list(runs)
    errors = []
    names: tuple[str, ...] = ()
    for vehicle in draw_models(model, spread, n_draws, prior, rng):
        try:
            found = information_of(vehicle, listed, noise=noise, priors=prior)
        except OedSysidError:
            continue
        names = found.names
        sizes = [abs(model.values[n]) or model.parameter(n).magnitude for n in names]
        errors.append(found.std_errors / sizes)
    if len(errors) < max(2, n_draws // 2):
        raise DesignError(
            f"The runs stay finite on {len(errors)} of {n_draws} vehicles only, so that no range "
            "can be stated. Make them gentler, or shorter."
        )
    low, high = np.quantile(np.array(errors), [_TAIL, 1 - _TAIL], axis=0, method="nearest")
    sea = noise.noise if isinstance(noise, Fit) else noise
    kept = sea if isinstance(sea, NoiseModel) and not sea.is_white else None
    return AccuracyRange(names, low, high, len(errors), kept)
