"""Cases: what is hidden, disturbed and declared, each drawn again from its name alone."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import cycle, islice
from typing import Any

import numpy as np

from benchmarks.other_vehicles.truth import VEHICLES
from benchmarks.other_vehicles.truth.detect import Gains, gains
from benchmarks.other_vehicles.truth.simulator import Hidden, Runs, Sizes, Vehicle, simulate

# Kinds of case in turn: what is hidden, and what disturbs.
KINDS = """
none/white single/white single/white single/waves none/waves single/white single/white pair/white
single/waves none/input_noise single/white single/white none/waves single/waves single/white
single/input_noise none/white single/white pair/waves single/white
"""
PATTERN = tuple(tuple(kind.split("/")) for kind in KINDS.split())
WRONG = (0.10, 0.30)  # by which the nominal values of free parameters are wrong
SPREAD = 0.03  # of the true parameters about those of their vehicle
FACTOR = (0.3, 2.0)  # hidden sizes in typical ones
FARTHEST = 3.0  # states beyond this many times those of the undisturbed vehicle are drawn again
ATTEMPTS = 20


@dataclass(frozen=True)
class Draw:
    """A case before it is drawn: vehicle, number, what is hidden, what disturbs."""

    vehicle: str
    number: int
    hidden: str
    condition: str
    declared: bool

    @property
    def key(self) -> str:
        """Name of the case."""
        noise = "declared" if self.declared else "undeclared"
        return f"{self.vehicle}/{self.number}/{self.hidden}/{self.condition}/{noise}"

    @property
    def disturbed(self) -> dict[str, Any]:
        """Sizes of the disturbance forces and of the noise on a logged input."""
        return {kind: float(self.condition == kind) for kind in ("waves", "input_noise")}


@dataclass(frozen=True, eq=False)
class Case:
    """A case with its records.

    Attributes
    ----------
    draw : Draw
    effects : tuple of str
        Names of what is hidden.
    hidden : dict
        Its sizes, by keys of the simulator; arrays have an entry per record.
    parameters : dict
        True parameters.
    start : dict
        Nominal values of the free ones.
    lacking : str or None
        Usual part that the nominal model does without.
    runs : Runs
        Training records first.
    """

    draw: Draw
    effects: tuple[str, ...]
    hidden: Sizes
    parameters: Mapping[str, float]
    start: Mapping[str, float]
    lacking: str | None
    runs: Runs

    @property
    def vehicle(self) -> Vehicle:
        """The true vehicle."""
        return VEHICLES[self.draw.vehicle]

    def structure(self, present: Sequence[str]) -> tuple[Sizes, Sizes]:
        """Parameters and hidden sizes of a structure with some of the hidden effects."""
        parameters, hidden = dict(self.parameters), dict(self.hidden)
        for name in self.effects:
            if name not in present:
                for key in self.vehicle.hidden[name].sizes:
                    if self.vehicle.hidden[name].lacking:
                        parameters[key] = 0.0
                    else:
                        hidden.pop(key)
        return parameters, hidden

    def gain(self, name: str) -> Gains:
        """Expected gain of one hidden effect, all others in the model."""
        others = [other for other in self.effects if other != name]
        own = self.vehicle.hidden[name]
        taken = set(own.sizes) if own.lacking else set()
        estimated = [p for p in self.vehicle.free if p not in taken]
        return gains(
            self.vehicle,
            self.runs,
            self.parameters,
            self.hidden,
            self.structure(others),
            estimated,
            **self.draw.disturbed,
        )


def draws(vehicles: Sequence[str], count: int) -> list[Draw]:
    """The first cases of every vehicle, vehicles in turn.

    Noise levels are declared in every other case of a kind; single effects have their
    turn one after another.

    Examples
    --------
    >>> [draw.key for draw in draws(["motor"], 2)]
    ['motor/0/none/white/declared', 'motor/1/single/white/declared']
    """
    if unknown := [name for name in vehicles if name not in VEHICLES]:
        raise ValueError(f"Unknown vehicle {unknown[0]!r}. Use {', '.join(VEHICLES)}.")
    kinds, found = list(islice(cycle(PATTERN), count)), []
    for number, kind in enumerate(kinds):
        declared = kinds[:number].count(kind) % 2 == 0
        found += [Draw(name, number, *kind, declared) for name in vehicles]
    return found


def single_effect(draw: Draw) -> str:
    """The hidden effect whose turn it is."""
    names = tuple(VEHICLES[draw.vehicle].hidden)
    earlier = sum(PATTERN[i % len(PATTERN)][0] == "single" for i in range(draw.number))
    return names[earlier % len(names)]


def draw_case(draw: Draw) -> Case:
    """Draw and simulate a case; one that leaves the usual motions is drawn again, weaker."""
    vehicle = VEHICLES[draw.vehicle]
    n, reach = len(vehicle.states), _reach(draw.vehicle)
    for attempt in range(ATTEMPTS):
        case = _attempt(draw, vehicle, attempt)
        far = np.max(np.abs(case.runs.states[..., :n]), axis=1)
        if np.all(np.isfinite(far)) and np.all(far < reach):
            return case
    raise RuntimeError(f"No usable draw of {draw.key} in {ATTEMPTS} attempts.")


@lru_cache
def _reach(name: str) -> np.ndarray:
    """Largest motions of every record that are kept, ``(n_records, n_states)``."""
    vehicle = VEHICLES[name]
    usual = simulate(vehicle, {}, rng=np.random.default_rng(0))
    reach = FARTHEST * np.max(np.abs(usual.states[..., : len(vehicle.states)]), axis=1)
    return np.maximum(reach, 0.3 * np.max(reach, axis=0)) + 1e-6


def _attempt(draw: Draw, vehicle: Vehicle, attempt: int) -> Case:
    rng = np.random.default_rng(zlib.crc32(f"{draw.key}/{attempt}".encode()))
    names = _names(draw, vehicle, rng)
    weaker = 0.85**attempt
    hidden: dict[str, float | np.ndarray] = {}
    lacking = None
    for name in names:
        kind = vehicle.hidden[name]
        if kind.lacking:
            lacking = name
            continue
        sizes = _sizes(kind, len(vehicle.train + vehicle.validation), rng)
        hidden |= {key: weaker * size for key, size in sizes.items()}
    spread = rng.uniform(-SPREAD, SPREAD, len(vehicle.free))
    free = {k: v * (1 + e) for (k, v), e in zip(vehicle.free.items(), spread, strict=True)}
    wrong = rng.uniform(*WRONG, len(free)) * rng.choice([-1.0, 1.0], len(free))
    parameters = {**vehicle.fixed, **free}
    runs = simulate(vehicle, hidden, rng=rng, parameters=parameters, **draw.disturbed)
    start = {k: v * (1 + e) for (k, v), e in zip(free.items(), wrong, strict=True)}
    return Case(draw, names, hidden, parameters, start, lacking, runs)


def _names(draw: Draw, vehicle: Vehicle, rng: np.random.Generator) -> tuple[str, ...]:
    if draw.hidden == "none":
        return ()
    if draw.hidden == "single":
        return (single_effect(draw),)
    eligible = [name for name, kind in vehicle.hidden.items() if not kind.lacking]
    first, second = rng.choice(len(eligible), 2, replace=False)
    return eligible[first], eligible[second]


def _sizes(kind: Hidden, n_records: int, rng: np.random.Generator) -> dict[str, float | np.ndarray]:
    factor = math.exp(rng.uniform(math.log(FACTOR[0]), math.log(FACTOR[1])))
    side = 1.0 if kind.sign else float(rng.choice([-1.0, 1.0]))
    if kind.per_record:
        ((key, size),) = kind.sizes.items()
        part = rng.uniform(0.4, 1.6, n_records) * rng.choice([-1.0, 1.0], n_records)
        return {key: size * part}
    if kind.sign == 0 and len(kind.sizes) == 2:  # a vector of any direction
        angle = rng.uniform(-math.pi, math.pi)
        parts = (math.sqrt(2) * math.cos(angle), math.sqrt(2) * math.sin(angle))
        return {k: factor * s * e for (k, s), e in zip(kind.sizes.items(), parts, strict=True)}
    return {k: factor * side * (kind.sign or 1) * s for k, s in kind.sizes.items()}
