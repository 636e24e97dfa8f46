"""Smaller models: which derivatives can go, and what prediction loses by it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.display import as_dict
from oed_sysid.errors import SimulationError
from oed_sysid.model import Model
from oed_sysid.sensitivity.bound import information_of
from oed_sysid.sensitivity.noise import Colour, Levels, noise_of
from oed_sysid.sensitivity.response import Run, plays, respond


@dataclass(frozen=True)
class Drop:
    """One parameter that was set to zero, after those before it.

    Attributes
    ----------
    name : str
    cost : float
        Increase of the whitened sum of squares by all drops so far, the
        remaining parameters refitted (linearised): below 2 per dropped
        parameter the data do not notice (Akaike).
    predicted_rms : float
        Root mean square change of the outputs that this means, in noise units.
    rms : mapping of str to float
        Change of each output as a share of its own rms deviation from the
        start value, dropped parameters at zero and the others as they were.
    """

    name: str
    cost: float
    predicted_rms: float
    rms: Mapping[str, float]

    to_dict = as_dict("name", "cost", "predicted_rms", "rms")


@dataclass(frozen=True, eq=False)
class Reduction:
    """A model without the derivatives that a manoeuvre does not notice.

    Attributes
    ----------
    model : Model
        Dropped parameters at zero and fixed; the others unchanged.
    full : Model
        The model before.
    drops : tuple of Drop
        In order; those beyond ``n_dropped`` show what more would cost.
    n_dropped : int
        How many were dropped.
    n_samples : int
        Measured samples behind the costs.
    """

    model: Model
    full: Model
    drops: tuple[Drop, ...]
    n_dropped: int
    n_samples: int

    @property
    def dropped(self) -> tuple[str, ...]:
        """Names of the dropped parameters."""
        return tuple(drop.name for drop in self.drops[: self.n_dropped])

    def report(self) -> str:
        """Return the order of dropping and its cost as text."""
        outputs = self.full.output_names
        lines = [
            f"{self.full.name}: {self.n_dropped} of {len(self.drops)} parameters dropped "
            f"({', '.join(self.dropped) or 'none'})",
            f"{'':>3} {'dropped':<20} {'chi-square':>11} {'rms/noise':>9}  change of "
            f"{', '.join(outputs)}, others unchanged",
        ]
        for index, drop in enumerate(self.drops, start=1):
            mark = "" if index <= self.n_dropped else " x"
            shares = "  ".join(f"{drop.rms[name]:.2%}" for name in outputs)
            lines.append(
                f"{index:>3} {drop.name:<20} {drop.cost:>11.3g} {drop.predicted_rms:>9.3g}"
                f"  {shares}{mark}"
            )
        return "\n".join(lines)

    to_dict = as_dict("dropped", "n_samples", model="full.name", steps="drops")


def reduce_model(
    model: Model,
    runs: Run | Dataset | Iterable[Run],
    *,
    noise: Levels = None,
    coloured: Colour = None,
    initial_states: Sequence[Mapping[str, float] | np.ndarray] | None = None,
    keep: Sequence[str] = (),
    largest_rms: float | None = None,
) -> Reduction:
    r"""Drop free parameters one by one, the least missed first.

    With the others refitted, setting the parameters of a set :math:`D` to zero
    raises the sum of squares by :math:`p_D' C_{DD}^{-1} p_D`, where :math:`C`
    is the bound. No simulation is needed for the order; each step is then
    simulated to say what it costs if nothing is refitted.

    Parameters
    ----------
    model, runs, noise, coloured, initial_states
        See :func:`~oed_sysid.sensitivity.bound.information_of`; start states
        are refitted.
    keep : sequence of str
        Parameters that stay in any case.
    largest_rms : float, optional
        Drop as long as the predicted rms change of the outputs stays below
        this, in units of the noise; by default as long as the sum of squares
        grows by less than 2 per dropped parameter.
    """
    played = plays(model, runs, initial_states=initial_states)
    own = [play.initial for play in played]
    information = information_of(
        model, runs, noise=noise, coloured=coloured, priors=None, initial_states=own
    )
    n_samples = sum(int(play.present.sum()) for play in played)
    fisher = information.matrix
    values = np.array([model.values[name] for name in information.names])
    base = [respond(model, play).outputs for play in played]
    spans = [noise_of(model, noise, coloured, changed=play.noise).sigma for play in played]
    gone: list[int] = []
    rest = [i for i, name in enumerate(information.names) if name not in keep]
    drops = []
    n_dropped, open_ended = 0, True
    while rest:
        costs = [_cost(fisher, values, [*gone, candidate]) for candidate in rest]
        best = int(np.argmin(costs))
        gone.append(rest.pop(best))
        cost = max(float(costs[best]), 0.0)
        rms = float(np.sqrt(cost / n_samples))
        names = [information.names[i] for i in gone]
        reduced = (
            model.with_values(dict.fromkeys(names, 0.0)) if _allows_zero(model, names) else None
        )
        drops.append(Drop(names[-1], cost, rms, _changes(reduced, model, played, base, spans)))
        fits = rms <= largest_rms if largest_rms is not None else cost <= 2.0 * len(gone)
        open_ended = open_ended and fits and reduced is not None
        n_dropped += open_ended
    names = [drop.name for drop in drops[:n_dropped]]
    small = model.with_values(dict.fromkeys(names, 0.0)).fix(*names)
    return Reduction(replace(small, name=f"{model.name}, reduced"), model, tuple(drops), n_dropped,
                     n_samples)  # fmt: skip


def _cost(fisher: np.ndarray, values: np.ndarray, gone: list[int]) -> float:
    """Increase of the sum of squares when ``gone`` are zero and the others refitted."""
    rest = [i for i in range(len(values)) if i not in gone]
    schur = fisher[np.ix_(gone, gone)]
    if rest:
        mixed = fisher[np.ix_(rest, gone)]
        inner = fisher[np.ix_(rest, rest)]
        scale = 1 / np.sqrt(np.maximum(np.diag(inner), 1e-300))
        solved = np.linalg.lstsq(
            inner * scale[:, None] * scale, mixed * scale[:, None], rcond=1e-13
        )
        schur = schur - mixed.T @ (solved[0] * scale[:, None])
    return float(values[gone] @ schur @ values[gone])


def _allows_zero(model: Model, names: Sequence[str]) -> bool:
    return all(model.parameter(n).lower <= 0.0 <= model.parameter(n).upper for n in names)


def _changes(
    reduced: Model | None,
    model: Model,
    played: Sequence[Any],
    base: Sequence[np.ndarray],
    spans: Sequence[np.ndarray],
) -> dict[str, float]:
    """Relative rms change of each output; infinite where the reduced model diverges."""
    if reduced is None:
        return dict.fromkeys(model.output_names, float("inf"))
    change, size = np.zeros(len(model.outputs)), np.zeros(len(model.outputs))
    for play, outputs, span in zip(played, base, spans, strict=True):
        try:
            new = respond(reduced, play).outputs
        except SimulationError:
            return dict.fromkeys(model.output_names, float("inf"))
        change += ((new - outputs) ** 2).sum(axis=0)
        size += np.maximum(((outputs - outputs[0]) ** 2).sum(axis=0), len(outputs) * span**2)
    return dict(zip(model.output_names, map(float, np.sqrt(change / size)), strict=True))
