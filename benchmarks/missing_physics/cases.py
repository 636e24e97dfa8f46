"""Random cases of many kinds, each drawn from its own name so that any one can be drawn again."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.missing_physics.simulator import PRIORS, TEST, TRAIN, Case, Noise, Records, simulate
from benchmarks.tables import tables

SPREAD = 0.09  # of the true derivatives about what is believed
STEEPEST = 1.6  # largest pitch of a record that is kept, rad
ATTEMPTS = 20

DATA = tables(__file__)
EFFECTS, UNKNOWN_TERMS = tuple(DATA["effects"]), tuple(DATA["unknown"])

FORCE = (0.1, 0.3, 0.06)  # a moderate disturbance force, N, N, N m
_slow = {
    level: tuple(size * f for f in FORCE)
    for level, size in (("low", 0.3), ("mid", 1.0), ("high", 3.0))
}
CONDITIONS: dict[str, Noise] = {
    "white": Noise(),
    "colour5": Noise(colour=0.5),
    "colour9": Noise(colour=0.9),
    **{f"force_{level}": Noise(force=force, force_time=1.0) for level, force in _slow.items()},
    # Spread over all frequencies, the same disturbance needs larger samples.
    **{
        f"gust_{level}": Noise(force=tuple(5.0 * f for f in force))
        for level, force in _slow.items()
    },
}
HIDDEN = ("none", "single", "pair", "unknown")


@dataclass(frozen=True)
class Draw:
    """A kind of case and its number: ``single/white/7``."""

    hidden: str
    condition: str
    number: int

    @property
    def key(self) -> str:
        """Name of the case."""
        return f"{self.hidden}/{self.condition}/{self.number}"


def draws(plan: str) -> list[Draw]:
    """Cases of a plan such as ``"single/white:40 none/colour5:20-40"``.

    Kinds take turns, so that a run that is cut short has its share of every kind.

    Examples
    --------
    >>> [draw.key for draw in draws("none/white:2 pair/white:5-6")]
    ['none/white/0', 'pair/white/5', 'none/white/1']
    """
    found: list[tuple[float, Draw]] = []
    for part in plan.split():
        kind, _, numbers = part.partition(":")
        hidden, condition = kind.split("/")
        if hidden not in HIDDEN or condition not in CONDITIONS:
            raise ValueError(
                f"Unknown kind {kind!r}. Use one of {', '.join(HIDDEN)}, a slash, and one of "
                f"{', '.join(CONDITIONS)}."
            )
        first, _, last = numbers.rpartition("-")
        numbers_wanted = range(int(first or 0), int(last))
        found += [
            ((place + 0.5) / len(numbers_wanted), Draw(hidden, condition, number))
            for place, number in enumerate(numbers_wanted)
        ]
    return [draw for _, draw in sorted(found, key=lambda pair: pair[0])]


def true_derivatives(rng: np.random.Generator) -> dict[str, float]:
    """Derivatives about those that are believed."""
    scatter = np.clip(rng.standard_normal(len(PRIORS)), -2.7, 2.7)
    return {n: v * (1 + SPREAD * s) for (n, v), s in zip(PRIORS.items(), scatter, strict=True)}


def case(draw: Draw, attempt: int = 0) -> Case:
    """Draw what is true in a case."""
    seed = zlib.crc32(f"{draw.key}/{attempt}".encode())
    rng = np.random.default_rng(seed)
    derivatives = true_derivatives(rng)
    # Amplitudes fall where half of the attempts capsized already.
    factor = 0.8 ** max(attempt - ATTEMPTS // 2, 0)
    return Case(
        draw.key,
        derivatives,
        {name: factor * size for name, size in _hidden(draw, rng).items()},
        CONDITIONS[draw.condition],
        seed,
        wave_frequency=rng.uniform(0.8, 1.25),
        wave_phase=rng.uniform(-math.pi, math.pi),
    )


def _hidden(draw: Draw, rng: np.random.Generator) -> dict[str, float]:
    if draw.hidden == "none":
        return {}
    if draw.hidden == "unknown":
        name = UNKNOWN_TERMS[draw.number % len(UNKNOWN_TERMS)]
        return {name: DATA["unknown"][name]["typical"] * _factor(rng)}
    if draw.hidden == "single":
        # Every effect in turn.
        return _amplitude(EFFECTS[draw.number % len(EFFECTS)], rng)
    first, second = rng.choice(len(EFFECTS), 2, replace=False)
    return _amplitude(EFFECTS[first], rng) | _amplitude(EFFECTS[second], rng)


def _factor(rng: np.random.Generator) -> float:
    """Amplitude in typical ones: mostly moderate, some weak, some strong."""
    low, high = ((0.6, 2.0), (0.2, 0.6), (2.0, 3.0))[rng.choice(3, p=(0.7, 0.15, 0.15))]
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _amplitude(name: str, rng: np.random.Generator) -> dict[str, float]:
    own, factor = DATA["effects"][name], _factor(rng)
    if name == "fin_rate_limit":  # the slower, the stronger
        return {name: max(own["typical"] / factor, 0.08)}
    size = min(own["typical"] * factor, own.get("largest", math.inf))
    return {name: size * (own.get("sign") or (1 if rng.random() < 0.5 else -1))}


def simulate_draws(wanted: Sequence[Draw]) -> list[tuple[Case, list[Records]]]:
    """Simulate all manoeuvres of many cases; one that capsizes is drawn again."""
    done: dict[Draw, tuple[Case, list[Records]]] = {}
    left = list(wanted)
    for attempt in range(ATTEMPTS):
        trial = [case(draw, attempt) for draw in left]
        for draw, own, parts in zip(left, trial, simulate(trial, (*TRAIN, *TEST)), strict=True):
            pitch = max(np.max(np.abs(part.clean[:, 3])) for part in parts)
            if np.isfinite(pitch) and pitch < STEEPEST:
                done[draw] = own, parts
        left = [draw for draw in wanted if draw not in done]
        if not left:
            return [done[draw] for draw in wanted]
    lost = ", ".join(draw.key for draw in left)
    raise RuntimeError(f"No usable draw of {lost} in {ATTEMPTS} attempts.")
