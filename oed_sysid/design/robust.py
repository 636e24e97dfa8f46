"""Designs that still work when the model's values are wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.design.criteria import Criterion
from oed_sysid.errors import DesignError
from oed_sysid.information import Information
from oed_sysid.model import Model


@dataclass(frozen=True)
class Robust:
    """Expected or worst value of a criterion over sampled parameter values.

    Limits are kept for every sampled set, so that a manoeuvre that is safe only
    for the nominal vehicle is not proposed.

    Parameters
    ----------
    criterion : Criterion
        Judged at every set.
    spread : float or None
        Relative half-width of uniform draws around the values; None draws from
        what is known (prior standard deviations, or the covariance of the fit).
    n_sets : int
        Sampled sets besides the nominal one.
    worst : bool
        Judge by the (soft) minimum instead of the mean.
    softness : float
        Width of the soft minimum, in units of the criterion.

    References
    ----------
    L. Pronzato, E. Walter, Robust experiment design via stochastic
    approximation, *Mathematical Biosciences* 75 (1985) 103-120: expectation;
    and Robust experiment design via maximin optimization, 89 (1988) 161-176.
    """

    criterion: Criterion
    spread: float | None = 0.3
    n_sets: int = 6
    worst: bool = False
    softness: float = 0.3

    def __post_init__(self) -> None:
        if self.n_sets < 1 or (self.spread is not None and not 0 < self.spread < 1):
            raise DesignError(
                f"Robust has spread {self.spread} and {self.n_sets} sets. Give a spread between 0 "
                "and 1 (or None for the prior) and one set or more."
            )

    @property
    def name(self) -> str:
        """Name for reports."""
        kind = "worst" if self.worst else "expected"
        return f"{kind} {getattr(self.criterion, 'name', 'criterion')} over {self.n_sets + 1} sets"


def draw_models(
    model: Model,
    spread: float | None,
    n_sets: int,
    prior: Information | None,
    rng: np.random.Generator,
) -> tuple[Model, ...]:
    """Return the model at sampled values.

    Parameters
    ----------
    model : Model
        At the nominal values.
    spread : float or None
        Relative half-width of uniform draws; None draws from what is known.
    n_sets : int
        How many.
    prior : Information or None
        What is known besides the parameters' ``prior_std``.
    rng : numpy.random.Generator

    Raises
    ------
    DesignError
        If draws from the prior are wanted but there is none.
    """
    names = model.free_names
    values = np.array([model.values[name] for name in names])
    found = []
    deviations = _deviations(model, prior) if spread is None else None
    for _ in range(n_sets):
        if deviations is None:
            drawn = values * (1 + (spread or 0.0) * rng.uniform(-1, 1, len(names)))
        else:
            drawn = values + deviations @ rng.standard_normal(deviations.shape[1])
        found.append(model.with_values(_bounded(model, names, drawn)))
    return tuple(found)


def draw_structures(
    model: Model,
    others: Sequence[Model],
    spread: float | None,
    n_sets: int,
    prior: Information | None,
    rng: np.random.Generator,
) -> tuple[Model, ...]:
    """Return sampled vehicles of several structures in turn.

    Parameters
    ----------
    model : Model
        The nominal one, whose parameters the prior is about.
    others : sequence of Model
        Other structures; what the prior does not know of them stays at its value.
    spread, n_sets, prior, rng
        See :func:`draw_models`; ``n_sets`` over all structures.
    """
    structures = (model, *others)
    counts = [len(range(i, n_sets, len(structures))) for i in range(len(structures))]
    drawn = [
        draw_models(one, spread, count, prior, rng)
        for one, count in zip(structures, counts, strict=True)
    ]
    return tuple(drawn[i % len(structures)][i // len(structures)] for i in range(n_sets))


def _bounded(model: Model, names: Sequence[str], drawn: np.ndarray) -> dict[str, float]:
    return {
        name: float(np.clip(value, model.parameter(name).lower, model.parameter(name).upper))
        for name, value in zip(names, drawn, strict=True)
    }


def _deviations(model: Model, prior: Information | None) -> np.ndarray:
    """Root of the covariance of what is known, shape ``(n_free, n_free)``."""
    names = model.free_names
    root = np.zeros((len(names), len(names)))
    for i, parameter in enumerate(model.free_parameters):
        root[i, i] = parameter.prior_spread or 0.0
    if prior is not None:
        covariance = prior.covariance
        if not np.all(np.isfinite(covariance)):
            raise DesignError(
                "The prior does not determine all parameters, so nothing can be drawn from it. "
                "Give a spread, as in Robust(spread=0.3)."
            )
        rows = [names.index(name) for name in prior.names]
        values, vectors = np.linalg.eigh(covariance)
        root[np.ix_(rows, rows)] = vectors * np.sqrt(np.maximum(values, 0.0))
    if not root.any():
        raise DesignError(
            "Nothing is known about the spread of the parameters. Give a spread, as in "
            "Robust(spread=0.3) or Caution(spread=0.3), prior_std on the parameters, or a fit."
        )
    return root
