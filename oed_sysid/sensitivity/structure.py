"""Structural identifiability: what no manoeuvre and no accuracy could separate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from oed_sysid.display import as_dict
from oed_sysid.errors import DesignError, SimulationError
from oed_sysid.information import Information
from oed_sysid.model import Model
from oed_sysid.sensitivity.bound import prior_factor, run_factor, triangle
from oed_sysid.sensitivity.noise import Noise
from oed_sysid.sensitivity.response import Play, respond


@dataclass(frozen=True)
class Structure:
    """Rank of the sensitivities over random values and inputs.

    Attributes
    ----------
    names : tuple of str
        Parameters that were looked at.
    rank : int
        Largest rank met; below ``len(names)`` no data can determine all.
    ranks : tuple of int
        Rank at each random set of values.
    directions : tuple of str
        Combinations that stay free, in words, at the values with most rank.
    margin : float
        Smallest scaled singular value that counts, as a share of the largest;
        far above 1e-7 means that the verdict is clear.
    n_runs : int
        Random runs for each set of values.
    """

    names: tuple[str, ...]
    rank: int
    ranks: tuple[int, ...]
    directions: tuple[str, ...]
    margin: float
    n_runs: int

    @property
    def identifiable(self) -> bool:
        """Whether all parameters can be determined by some manoeuvre."""
        return self.rank == len(self.names)

    def report(self) -> str:
        """Return the verdict in words."""
        head = (
            f"Structure: rank {self.rank} of {len(self.names)} over {len(self.ranks)} random sets "
            f"of values, {self.n_runs} random manoeuvres each (smallest share {self.margin:.1e})."
        )
        if self.identifiable:
            return f"{head}\nAll parameters are locally identifiable from these outputs."
        return "\n".join(
            [head, "No manoeuvre separates:", *(f"  {text}" for text in self.directions)]
        )

    to_dict = as_dict("names", "rank", "ranks", "identifiable", "directions", "margin")


def structural_identifiability(
    model: Model,
    *,
    inputs: Mapping[str, tuple[float, float]],
    rng: np.random.Generator,
    duration: float = 60.0,
    sample_time: float = 0.5,
    initial: Mapping[str, float] | None = None,
    spread: float = 0.3,
    n_points: int = 5,
    n_runs: int = 3,
    start: str = "unknown",
) -> Structure:
    """Check by rank whether the free parameters can be determined at all.

    At each of several random sets of values the sensitivities of several runs
    with random step inputs are put under each other, start states eliminated
    unless known. What stays without rank everywhere is a property of the
    equations and outputs, not of the manoeuvre.

    Parameters
    ----------
    model : Model
        The model; its outputs are what is measured.
    inputs : mapping of str to (lower, upper)
        Range in which every input is drawn.
    rng : numpy.random.Generator
        Source of values and inputs.
    duration, sample_time : float
        Length and sampling of the runs, s.
    initial : mapping of str to float, optional
        Start of the runs; states are scattered around it by a tenth of their
        scale, as a vehicle at rest shows less than one in motion.
    spread : float
        Relative half-width of the random values.
    n_points, n_runs : int
        Number of value sets, and of runs at each.
    start : {"unknown", "known"}
        Whether start states have to be estimated too.

    Raises
    ------
    DesignError
        If an input has no range, or no run stays finite.
    """
    if missing := [name for name in model.input_names if name not in inputs]:
        raise DesignError(f"The input {missing[0]!r} has no range. Give inputs={{...}} for all.")
    names = tuple(p.name for p in model.free_parameters if not p.per_record)
    found = []
    for _ in range(n_points):
        drawn = _draw(model, rng, spread)
        factors = []
        for _ in range(n_runs):
            play = _random_play(drawn, inputs, rng, duration, sample_time, initial or {})
            try:
                response = respond(drawn, play)
            except SimulationError:
                continue
            spans = np.ptp(response.outputs, axis=0)
            noise = Noise(np.where(spans > 0, spans, 1.0), ((),) * len(spans))
            factors.append(run_factor(drawn, response, noise, start))
        if factors:
            scales = np.array([drawn.parameter(name).magnitude for name in names])
            rows = np.vstack([*factors, prior_factor(drawn, names, None)])
            found.append(Information(names, triangle(rows) * scales, scales))
    if not found:
        raise DesignError(
            f"No random run of model {model.name!r} stays finite. Make the ranges of the inputs "
            "smaller, the runs shorter, or give initial={...} in the operating range."
        )
    best = max(found, key=lambda information: information.rank)
    _, values, _ = best._svd
    margin = values[best.rank - 1] / values[0] if best.rank else 0.0
    return Structure(
        names,
        best.rank,
        tuple(information.rank for information in found),
        best.null_directions(),
        float(margin),
        n_runs,
    )


def _draw(model: Model, rng: np.random.Generator, spread: float) -> Model:
    values = {}
    for parameter in model.free_parameters:
        centre = parameter.value or parameter.magnitude * rng.choice([-1.0, 1.0])
        drawn = centre * (1 + spread * rng.uniform(-1, 1))
        values[parameter.name] = float(np.clip(drawn, parameter.lower, parameter.upper))
    return model.with_values(values)


def _random_play(
    model: Model,
    inputs: Mapping[str, tuple[float, float]],
    rng: np.random.Generator,
    duration: float,
    sample_time: float,
    initial: Mapping[str, float],
) -> Play:
    times = np.arange(0.0, duration + 0.5 * sample_time, sample_time)
    columns = []
    for name in model.input_names:
        lower, upper = inputs[name]
        hold = max(1, int(rng.uniform(0.02, 0.15) * len(times)))
        levels = rng.uniform(lower, upper, size=len(times) // hold + 1)
        columns.append(np.repeat(levels, hold)[: len(times)])
    commands = np.column_stack(columns) if columns else np.empty((len(times), 0))
    own = np.array([initial.get(state.name, 0.0) for state in model.states])
    own = own + 0.1 * rng.standard_normal(len(own)) * [state.scale for state in model.states]
    present = np.ones((len(times), len(model.outputs)), dtype=bool)
    return Play("random steps", times, commands, own, present)
