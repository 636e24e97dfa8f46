r"""Which continuous faults a log has: forward selection with exchange and drop.

A set :math:`S` of faults gains :math:`b_S^T (G_{SS} + P_S^{-1})^{-1} b_S`, with normal equations
:math:`G, b` and the squares of plausible sizes on the diagonal of :math:`P`. A fault enters if it
gains more than its limit and is of a size that matters.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed_sysid.evidence.blocks import Candidate

MOST_FAULTS = 5
# A rival has to be of a size that such faults have.
LARGEST = 4.0
# A size has to exceed this multiple of what noise in its regressor may have made.
DOUBT = 1.5
# What linearisation leaves of a large fault: a further one has to gain this share of it.
SHARE = 1e-3


def ridge(faults: tuple[Candidate, ...], chosen: Sequence[int]) -> np.ndarray:
    """What plausible sizes add to the normal equations, ``(n_chosen, n_chosen)``."""
    return np.diag([faults[k].plausible ** -2.0 for k in chosen])


def solve(
    gram: np.ndarray, right: np.ndarray, faults: tuple[Candidate, ...], chosen: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of chosen faults and their standard deviations."""
    inner = gram[np.ix_(chosen, chosen)] + ridge(faults, chosen)
    inverse = np.linalg.inv(inner)
    return inverse @ right[list(chosen)], np.sqrt(inverse.diagonal())


def gain_of(
    gram: np.ndarray, right: np.ndarray, faults: tuple[Candidate, ...], chosen: Sequence[int]
) -> float:
    """Log-likelihood gain of a set of faults."""
    if not chosen:
        return 0.0
    inner = gram[np.ix_(chosen, chosen)] + ridge(faults, chosen)
    return float(right[list(chosen)] @ np.linalg.solve(inner, right[list(chosen)]))


def select(
    gram: np.ndarray,
    right: np.ndarray,
    faults: tuple[Candidate, ...],
    limits: np.ndarray,
    doubt: np.ndarray,
    start: list[int],
) -> list[int]:
    """Forward selection with exchange and drop."""
    chosen = list(start)
    able = [k for k in range(len(faults)) if gram[k, k] > 0.0]
    chosen = [k for k in chosen if k in able]
    seen: set[frozenset[int]] = set()
    while frozenset(chosen) not in seen:
        # A set that comes back means that adding and dropping take turns.
        seen.add(frozenset(chosen))
        gain = gain_of(gram, right, faults, chosen)
        if len(chosen) < MOST_FAULTS:
            trials = [
                (
                    gain_of(gram, right, faults, [*chosen, k])
                    - gain
                    - max(limits[k], SHARE * gain),
                    k,
                )
                for k in able
                if k not in chosen and is_material(gram, right, doubt, faults, [*chosen, k])
            ]
            if trials and max(trials)[0] > 0.0:
                chosen.append(max(trials)[1])
        for position in range(len(chosen)):
            gain = gain_of(gram, right, faults, chosen)
            rest = chosen[:position] + chosen[position + 1 :]
            swaps = [
                (gain_of(gram, right, faults, [*rest, k]), k)
                for k in able
                if k not in chosen and is_material(gram, right, doubt, faults, [*rest, k])
            ]
            if swaps and max(swaps)[0] > gain + 1.0:
                chosen = [*rest, max(swaps)[1]]
        dropped = True
        while dropped and chosen:
            gain = gain_of(gram, right, faults, chosen)
            losses = [
                (
                    gain
                    - gain_of(gram, right, faults, [j for j in chosen if j != k])
                    - max(limits[k], SHARE * gain),
                    k,
                )
                for k in chosen
            ]
            small = [
                k
                for k in chosen
                if not is_material(gram, right, doubt, faults, [*(j for j in chosen if j != k), k])
            ]
            worst = min(losses)
            dropped = worst[0] < 0.0 or bool(small)
            if worst[0] < 0.0:
                chosen.remove(worst[1])
            elif small:
                chosen.remove(small[0])
    return chosen


def is_material(
    gram: np.ndarray,
    right: np.ndarray,
    doubt: np.ndarray,
    faults: tuple[Candidate, ...],
    chosen: list[int],
) -> bool:
    """Whether the last of the chosen faults is large enough to matter, and not absurd."""
    sizes, std = solve(gram, right, faults, chosen)
    last = faults[chosen[-1]]
    least = last.material + DOUBT * float(std[-1]) ** 2 * doubt[chosen[-1]]
    return least <= abs(float(sizes[-1])) <= LARGEST * last.plausible
