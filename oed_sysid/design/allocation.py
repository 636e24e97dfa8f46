r"""How much of which run: convex weights with a certificate, and whole runs by exchange.

With information ``F_i`` of run ``i`` (in relative units, on vehicles ``s`` drawn from what is
known), its cost ``c_i``, and knowledge ``F_0``, a programme with ``x_i`` repetitions is worth

.. math:: \Phi(x) = \frac1S \sum_s \varphi\Big(F_{0s} + \sum_i x_i F_{is}\Big), \qquad
    d_i = \frac{\partial \Phi}{\partial x_i} = \frac1S \sum_s \mathrm{tr}(G_s F_{is}), \quad
    G_s = \varphi'(\cdot)

All criteria here are logarithms of positive, concave, homogeneous functions (``log det``,
``-log tr C``; Pukelsheim 2006, *Optimal design of experiments*, ch. 6), so :math:`\Phi` is concave
and

.. math:: \Phi(x^*) \le \Phi(x) + \max_y \sum_i d_i (y_i - x_i)

over all :math:`y \ge 0` within the budget: the equivalence theorem (Kiefer & Wolfowitz 1960) as a
bound, the gap being the last term. It holds for every programme made of *these* runs, whole or not;
commands that are not in the library may do better.

Weights: the multiplicative algorithm :math:`w_i \leftarrow w_i d_i^\lambda / \sum_j w_j
d_j^\lambda` per share of the budget (Silvey, Titterington & Torsney 1978; :math:`\lambda` 1 for
D, 1/2 else). With a limit both on time and on the number of runs, the two are summed with a
multiplier :math:`\theta`: every :math:`\theta` gives a valid bound, and the smallest is taken.

Whole runs: greedy, by gain per cost and by gain, from nothing and from every single run, and
rounded weights; the best are improved by exchange (Fedorov 1972): leave out one run or two, add
one of those that tell most, fill up, as long as that helps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from oed_sysid.design.criteria import NOTHING, SAYS, AOptimal, Criterion, DOptimal, Measure
from oed_sysid.errors import DesignError
from oed_sysid.runtime.constants import NEGLIGIBLE

# Runs tried in an exchange, and starts that are exchanged.
_TRIED = 4


@dataclass(frozen=True, eq=False)
class Library:
    """Information and cost of candidate runs, on several vehicles, and what may be spent.

    Attributes
    ----------
    information : ndarray (n_vehicles, n_runs, n, n)
        In relative units of the parameters; the nominal vehicle first.
    prior : ndarray (n, n)
        Known before, in the same units.
    costs : ndarray (n_runs,)
        Positive.
    criterion : Criterion
    measure : Measure
        The criterion, bound.
    budget : float
        Largest sum of costs.
    most : float
        Largest number of runs.
    """

    information: np.ndarray
    prior: np.ndarray
    costs: np.ndarray
    criterion: Criterion
    measure: Measure
    budget: float = np.inf
    most: float = np.inf

    def __post_init__(self) -> None:
        if not np.all(self.costs > 0):
            raise DesignError("A run without cost would be repeated for ever. Give costs above 0.")

    @property
    def n_runs(self) -> int:
        """Number of candidates."""
        return len(self.costs)

    def total(self, x: np.ndarray) -> np.ndarray:
        """Information of a programme on every vehicle, ``(n_vehicles, n, n)``."""
        return self.prior + np.einsum("i,siab->sab", x, self.information)

    def slope(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Worth of a programme and its derivatives by the repetitions, ``(n_runs,)``."""
        parts = [self.measure(matrix) for matrix in self.total(x)]
        gradient = np.stack([part[1] for part in parts]) / len(parts)
        by_run = np.einsum("sab,siab->i", gradient, self.information)
        return float(np.mean([part[0] for part in parts])), by_run

    def values(self, stack: np.ndarray) -> np.ndarray:
        """Worth of many programmes, ``stack`` is ``(n_programmes, n_vehicles, n, n)``."""
        n = stack.shape[-1]
        if isinstance(self.criterion, DOptimal):
            found = np.linalg.slogdet(stack + NOTHING * np.eye(n))[1]
        elif isinstance(self.criterion, AOptimal):
            bounds = np.linalg.inv(stack + NOTHING * np.eye(n))
            found = -np.log(np.maximum(np.trace(bounds, axis1=-2, axis2=-1), 1e-300) / n)
        else:
            flat = [self.measure(matrix)[0] for matrix in stack.reshape(-1, n, n)]
            found = np.array(flat).reshape(stack.shape[:2])
        return np.mean(found, axis=1)

    def value(self, counts: np.ndarray) -> float:
        """Worth of whole or broken numbers of runs."""
        return float(self.values(self.total(counts)[None])[0])

    def factor(self, difference: float) -> float:
        """How many times the information a difference of the criterion is worth."""
        n = self.prior.shape[0] if isinstance(self.criterion, DOptimal) else 1
        return float(np.exp(difference / n))

    def fits(self, counts: np.ndarray) -> np.ndarray:
        """Runs that may be added to whole runs ``(n_runs,)``."""
        if counts.sum() + 1 > self.most:
            return np.zeros(0, dtype=int)
        return np.flatnonzero(self.costs <= self.budget * (1 + 1e-9) - counts @ self.costs)

    def added(self, counts: np.ndarray, runs: np.ndarray) -> np.ndarray:
        """Worth with each of some runs added."""
        base = self.total(counts.astype(float))
        return self.values(base[None] + self.information[:, runs].transpose(1, 0, 2, 3))


@dataclass(frozen=True, eq=False)
class Weights:
    """Solution of the relaxed problem.

    Attributes
    ----------
    repetitions : ndarray (n_runs,)
        May be broken.
    value : float
        Worth reached.
    bound : float
        No programme of these runs within the budget is worth more.
    """

    repetitions: np.ndarray
    value: float
    bound: float


def relaxed(library: Library, costs: np.ndarray) -> Weights:
    """Maximise the worth over weights, ``sum(costs * x) = 1``.

    Parameters
    ----------
    library : Library
    costs : ndarray (n_runs,)
        As shares of the budget.

    Returns
    -------
    Weights
    """
    scale = library.prior.shape[0] if isinstance(library.criterion, DOptimal) else 1
    # Exponents with which the multiplicative iteration rises monotonically (Yu 2010, Annals of
    # Statistics 38).
    power = 1.0 if isinstance(library.criterion, DOptimal) else 0.5
    # Weights that start above zero can reach any design; a zero would stay one.
    w = np.full(library.n_runs, 1.0 / library.n_runs)
    best, ceiling = Weights(w / costs, -np.inf, np.inf), np.inf
    for sweep in range(1, 6000 + 1):
        value, by_run = library.slope(w / costs)
        d = np.maximum(by_run / costs, 0.0)
        if sweep % 20 == 1 or sweep == 6000:
            # Every sweep gives a bound; the smallest counts.
            ceiling = min(ceiling, value + float(d.max() - w @ d))
            if value > best.value:
                best = Weights(w / costs, value, ceiling)
            # So near their bound, per parameter of D, weights are optimal: a hundredth of the least
            # that a run has to be worth.
            if ceiling - best.value < NEGLIGIBLE**2 * scale:
                break
            # A run of hardly any weight cannot come back unless its slope says so.
            w = np.where((w < 1e-10) & (d < w @ d), 0.0, w)
        grown = w * d**power
        if not grown.sum() > 0:
            break  # everything that these runs could tell is told already
        w = grown / grown.sum()
    return replace(best, bound=ceiling)


def weights(library: Library) -> Weights:
    """Best weights within a budget of cost, of runs, or of both, with a bound."""
    shares = (library.costs / library.budget, np.full(library.n_runs, 1.0 / library.most))
    limits = [one for one in shares if one.any()]
    found = []
    for limit in limits:
        found.append(relaxed(library, limit))
        if all(other @ found[-1].repetitions <= 1 + 1e-9 for other in limits):
            return found[-1]
    return _within_both(library, limits, found)


def _within_both(library: Library, limits: Sequence[np.ndarray], found: list[Weights]) -> Weights:
    """Best weights within two limits, of which each alone leads beyond the other."""
    time, count = limits
    low, high = 0.0, 1.0
    for _ in range(8):
        # Bisection of the multiplier between the limits: the bound of each mixture is one of both.
        theta = 0.5 * (low + high)
        middle = relaxed(library, theta * time + (1 - theta) * count)
        found.append(middle)
        # More weight on whichever limit is passed.
        over_time = time @ middle.repetitions > count @ middle.repetitions
        low, high = (theta, high) if over_time else (low, theta)
    bound = min(one.bound for one in found)
    inside = [
        Weights(x, library.value(x), bound)
        for one in found
        for x in [one.repetitions / max(time @ one.repetitions, count @ one.repetitions, 1.0)]
    ]
    return max(inside, key=lambda one: one.value)


@dataclass(frozen=True, eq=False)
class Selection:
    """Whole runs.

    Attributes
    ----------
    counts : ndarray of int (n_runs,)
    value : float
    greedy : float
        What the greedy selection alone is worth.
    """

    counts: np.ndarray
    value: float
    greedy: float


def _filled(library: Library, counts: np.ndarray, *, per_cost: bool) -> np.ndarray:
    """Add the most telling run until the budget is used."""
    counts, value = counts.copy(), library.value(counts)
    while len(runs := library.fits(counts)):
        gain = library.added(counts, runs) - value
        best = int(np.argmax(gain / library.costs[runs] if per_cost else gain))
        counts[runs[best]] += 1
        value += float(gain[best])
    return counts


def _exchanged(library: Library, counts: np.ndarray) -> np.ndarray:
    """Replace runs, or leave one out and fill up, as long as that helps."""
    counts = _filled(library, counts, per_cost=True)
    value = library.value(counts)
    while True:
        chosen = np.repeat(np.arange(len(counts)), counts).tolist()
        # One or two runs out, so that a swap of two short ones for a long one is found too.
        fewer = [
            counts - np.bincount(pick, minlength=len(counts))
            for pick in {*combinations(chosen, 1), *combinations(chosen, 2)}
        ]
        trials = [trial for one in fewer for trial in (one, *_best_added(library, one))]
        options = [_filled(library, one, per_cost=flag) for one in trials for flag in (True, False)]
        found = [library.value(option) for option in options]
        if not found or max(found) <= value + 1e-9:
            return counts
        counts = options[int(np.argmax(found))]
        value = max(found)


def _best_added(library: Library, fewer: np.ndarray) -> list[np.ndarray]:
    """With the few runs added that tell most on their own."""
    runs = library.fits(fewer)
    best = runs[np.argsort(-library.added(fewer, runs))[:_TRIED]]
    return list(fewer + np.eye(len(fewer), dtype=int)[best])


def select(library: Library, shares: Weights, begin: Sequence[np.ndarray] = ()) -> Selection:
    """Choose whole runs: greedy ways and rounded weights, each improved by exchange.

    Parameters
    ----------
    library : Library
    shares : Weights
        Of the relaxed problem.
    begin : sequence of ndarray of int (n_runs,)
        Further selections to improve.

    Raises
    ------
    DesignError
        If not even one run fits.
    """
    none = np.zeros(library.n_runs, dtype=int)
    if not len(alone := library.fits(none)):
        raise DesignError(SAYS["no_run_fits"].format(minutes=library.costs.min() / 60))

    def both(counts: np.ndarray) -> list[np.ndarray]:
        return [_filled(library, counts, per_cost=flag) for flag in (True, False)]

    greedy, rounded = both(none), np.floor(shares.repetitions + 1e-6).astype(int)
    filled = [way for one in np.eye(library.n_runs, dtype=int)[alone] for way in both(one)]
    filled.sort(key=library.value, reverse=True)
    starts = [*greedy, rounded, *begin, *filled[:_TRIED]]
    distinct = {tuple(start): start for start in starts}.values()
    found = [*greedy, *(_exchanged(library, start) for start in distinct)]
    best = max(found, key=library.value)
    return Selection(best, library.value(best), max(map(library.value, greedy)))


def order(library: Library, counts: Sequence[int]) -> list[int]:
    """Sequence of runs: each the one that tells most per cost after those before it."""
    left, done = np.array(counts), np.zeros(len(counts), dtype=int)
    sequence = []
    while left.any():
        runs = np.flatnonzero(left)
        gain = (library.added(done, runs) - library.value(done)) / library.costs[runs]
        chosen = int(runs[int(np.argmax(gain))])
        sequence.append(chosen)
        left[chosen] -= 1
        done[chosen] += 1
    return sequence
