"""Spikes, bursts and drop-outs of sensors: what the default fit makes of them.

Data sets of `benchmarks.random_forces` are spoilt after the simulation (the pilot saw none of it)
and fitted with ``MultipleShooting()``; each is compared with the fit to the same set unspoilt,
``clean`` with the one that looks for no spikes (``loss="square"``); docs/estimation.md has the
numbers (`python -m benchmarks.documents estimation`). What spoils a record:

``share_size``
    This share of the samples of every output is off by so many standard deviations of its noise,
    up or down; with ``_up`` all upward; ``mixed``: 5 to 50, uniform.
``bursts``
    2 % of the samples, 20 standard deviations of either sign, in groups of two to five.
``zeros``, ``absent``, ``held``
    2 % of the samples, in groups of five to twenty, read zero, are not there (NaN), or repeat the
    last value before them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from benchmarks.harness import TWO_SIDED_95, Row
from benchmarks.random_forces.measures import errors
from benchmarks.random_forces.scenarios import SCENARIOS, VEHICLES
from benchmarks.random_forces.simulator import Set, simulate, stream
from benchmarks.random_forces.trial import Outcome, outcome

# Spoils the outputs of one record; noise levels and random numbers as arguments.
Spoil = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]


def single(
    outputs: np.ndarray, noise: np.ndarray, rng: np.random.Generator,
    *, share: float, sizes: tuple[float, float], up: bool = False,
) -> np.ndarray:  # fmt: skip
    """Single samples that are off by some standard deviations."""
    hit = rng.random(outputs.shape) < share
    size = rng.uniform(*sizes, outputs.shape)
    sign = np.where(up | (rng.random(outputs.shape) < 0.5), 1.0, -1.0)
    return np.where(hit, outputs + sign * size * noise, outputs)


def groups(
    outputs: np.ndarray, noise: np.ndarray, rng: np.random.Generator,
    *, kind: str, share: float, lengths: tuple[int, int],
) -> np.ndarray:  # fmt: skip
    """Groups of samples that are off, read zero, repeat the last value, or are absent."""
    spoilt = outputs.copy()
    n, n_outputs = outputs.shape
    middle = 0.5 * sum(lengths)
    for column in range(n_outputs):
        for first in np.flatnonzero(rng.random(n) < share / middle):
            part = slice(max(first, 1), first + int(rng.integers(lengths[0], lengths[1] + 1)))
            there = spoilt[part, column]
            sign = np.where(rng.random(len(there)) < 0.5, -1.0, 1.0)
            spoilt[part, column] = {
                "bursts": there + 20.0 * noise[column] * sign,
                "zeros": np.zeros(len(there)),
                "absent": np.full(len(there), np.nan),
                "held": np.full(len(there), spoilt[part.start - 1, column]),
            }[kind]
    return np.where(np.isnan(outputs), np.nan, spoilt)


KINDS: dict[str, Spoil] = {
    f"{100 * share:g}%_{size:g}{'_up' * up}": partial(
        single, share=share, sizes=(size, size), up=up
    )
    for share in (0.005, 0.02, 0.05)
    for size in (5.0, 10.0, 20.0, 50.0)
    for up in (False, True)
}
KINDS |= {
    f"{100 * share:g}%_mixed": partial(single, share=share, sizes=(5.0, 50.0))
    for share in (0.005, 0.02, 0.05)
}
KINDS["bursts"] = partial(groups, kind="bursts", share=0.02, lengths=(2, 5))
for name in ("zeros", "absent", "held"):
    KINDS[name] = partial(groups, kind=name, share=0.02, lengths=(5, 20))


def fitted(world: str, data: Set, spoil: Spoil | None, seed: int, loss: str = "auto") -> Outcome:
    """What a fit to one set says; ``left_out`` as a share of the samples that were spoilt."""
    scenario = SCENARIOS[world]
    noise = np.array(VEHICLES[scenario.vehicle].noise_std)
    runs, spoilt = [], 0
    for run in data.runs:
        outputs = run.outputs
        if spoil is not None:
            outputs = spoil(outputs, noise, stream(seed, data.number, run.name, "spoilt"))
        spoilt += int(np.sum((outputs != run.outputs) & np.isfinite(outputs)))
        runs.append(replace(run, outputs=outputs))
    found = outcome(scenario, replace(data, runs=tuple(runs)), {"loss": loss, "predict": False})
    return replace(found, spoilt=spoilt)


@lru_cache(maxsize=1)
def unspoilt(world: str, sets: int, seed: int) -> tuple[list[Set], list[Outcome]]:
    """Data sets and what the default fit says of them."""
    data = simulate(SCENARIOS[world], seed, range(sets))
    fitted(world, data[0], None, seed)  # compile
    return data, [fitted(world, one, None, seed) for one in data]


def case(world: str, kind: str, sets: int, seed: int) -> Row:
    """One kind of spoilt samples in one world: all its numbers."""
    data, clean = unspoilt(world, sets, seed)
    spoil = KINDS.get(kind)
    if spoil is None:
        clean = [fitted(world, one, None, seed, "square") for one in data]
    spoilt = [fitted(world, one, spoil, seed) for one in data]
    return {"key": [world, kind, sets, seed], **measured(spoilt, clean)}


def sizes(fits: Sequence[Outcome], names: Sequence[str]) -> np.ndarray:
    """Root mean square error of each parameter."""
    apart = [[one.estimates[name] - one.truth[name] for name in names] for one in fits]
    return np.asarray(np.sqrt(np.nanmean(np.square(apart), axis=0)))


def measured(fits: Sequence[Outcome], clean: Sequence[Outcome]) -> Row:
    """What the fits to spoilt sets state, against the truth and the clean ones."""
    names = list(fits[0].truth)
    held = np.abs(errors(fits, names)[1]) <= TWO_SIDED_95
    ratio = sizes(fits, names) / sizes(clean, names)
    seconds, before = ([one.seconds for one in own] for own in (fits, clean))
    warned = [{kind for kind in one.concerns if kind != one.status} for one in fits]
    found: dict[str, Any] = {
        "coverage": 100 * float(held.mean()),
        "coverage_error": 100 * float(held.mean(axis=1).std() / np.sqrt(len(fits))),
        "worst": 100 * float(held.mean(axis=0).min()),
        "ratio": float(np.sqrt(np.mean(ratio**2))),
        "worst_ratio": float(ratio.max()),
        "not_ok": sum(one.status != "converged" for one in fits),
        "raised": sum(one.status.startswith("raised") for one in fits),
        "forces": sum(one.disturbed for one in fits),
        "left_out": sum(one.left_out for one in fits) / max(sum(one.spoilt for one in fits), 1),
        "seconds": float(np.median(seconds)),
        "slower": sum(seconds) / sum(before),
        "concerns": dict(sorted(Counter(kind for own in warned for kind in own).items())),
    }
    return {name: round(v, 4) if isinstance(v, float) else v for name, v in found.items()}
