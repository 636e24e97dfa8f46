r"""Whether a size that all records share is the same in each of them.

An effect is claimed with one size for all records. Where something else is missing, that size is
what imitates it best, and another in a weak manoeuvre than in a strong one: a yaw rate that was
smoothed, for instance, is short by as much as the ship turns to and fro quickly, which one scale
error cannot be. With information :math:`H_i` and score :math:`g_i` of record *i* at the fit, its
start states and own parameters eliminated, the sizes :math:`\hat a + \delta_i` that records would
have of their own, the other parameters :math:`b` remaining common, solve

.. math::
    H_{i,aa}\,\delta_i + H_{i,ab}\,\beta = g_{i,a}, \qquad
    \sum_i H_{i,ba}\,\delta_i + \Bigl(\Lambda + \sum_i H_{i,bb}\Bigr) \beta
        = \Lambda (\mu_b - \hat b) + \sum_i g_{i,b},

with covariance :math:`C` of the sizes :math:`a`, and :math:`W = C^{-1}`. Were there one size,

.. math:: Q = (a - \bar a)' W (a - \bar a), \qquad \bar a = \frac{1'Wa}{1'W1}

would be :math:`\chi^2_{n-1}` (Cochran 1954, Biometrics 10). What exceeds it is scatter of the size
itself (DerSimonian & Laird 1986, Control. Clin. Trials 7, for sizes that are estimated together),

.. math:: \tau^2 = \frac{Q - (n - 1)}{\operatorname{tr}(W - W 1 1' W / 1'W1)},

and a further record would show, in 95 of 100 cases, a size within

.. math:: \bar a \pm t_{n-2} \sqrt{\tau^2 + 1 / (1'W1)}

(Higgins, Thompson & Spiegelhalter 2009, J. R. Stat. Soc. A 172, eq. 12).

Sizes that differ beyond chance show that the likelihood is not that of the records: an effect is
then told from what else is missing only if whole runs get better, or if it is large: if a further
record would show it, too, and if it moves a signal by a good share of what the model still misses
there. What is a hundredth of that asks the model of the misfit to be right to a hundredth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, stdtrit

from oed_sysid.evidence.improvement import RISE
from oed_sysid.evidence.search import own_error
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.summary import record_information
from oed_sysid.physics import Effect

# Records from which on their sizes tell something: two degrees of freedom of the interval.
FEWEST_RECORDS = 4
# Chance that sizes which are one are said to differ.
CHANCE = 1e-3
# Share of what a model on its own still misses of a signal, below which an effect may be imitated.
SMALL = 0.1
# Scaled information below this share of the largest is none.
NOTHING = 1e-10
# Information of a record about a size, over that of the best, below which it tells nothing.
SILENT = 1e-6


@dataclass(frozen=True, eq=False)
class Sizes:
    """One amplitude as each record shows it, the other parameters in common.

    Attributes
    ----------
    name : str
        The amplitude.
    each : ndarray (n_records,)
        Its size in every record that tells of it.
    mean, std_error : float
        The size that all would share, and its error, were there one.
    q : float
        Cochran's statistic.
    scatter : float
        Standard deviation of the size between records beyond errors.
    """

    name: str
    each: np.ndarray
    mean: float
    std_error: float
    q: float
    scatter: float

    @property
    def chance(self) -> float:
        """How often chance makes sizes differ as much where there is one."""
        return float(chdtrc(len(self.each) - 1, self.q))

    @property
    def elsewhere(self) -> tuple[float, float]:
        """95 % interval of the size that a further record would show."""
        half = float(stdtrit(len(self.each) - 2, 0.975))
        half *= float(np.hypot(self.scatter, self.std_error))
        return self.mean - half, self.mean + half

    @property
    def differ(self) -> bool:
        """Whether the sizes differ by more than chance."""
        return self.chance < CHANCE

    @property
    def repeats(self) -> bool:
        """Whether a further record would show the effect, too, as far as these records tell."""
        low, high = self.elsewhere
        return not low <= 0.0 <= high


def imitates(
    study: Study,
    after: FilteredSolution,
    effect: Effect,
    without: Callable[[], FilteredSolution | None],
) -> tuple[Sizes, ...]:
    """Sizes of an effect that cannot be told from what else is missing; empty where it can.

    Parameters
    ----------
    study : Study
    after : FilteredSolution
        With the effect.
    effect : Effect
    without : callable
        The fit without it, made only where sizes differ.

    Returns
    -------
    tuple of Sizes
        Empty where an amplitude is the same in all records, where records are too few to tell,
        where whole validation runs (training runs without any) get better by more than chance, and
        where the effect is large.
    """
    found = sizes_by_record(study, after, effect)
    if not found or not all(one.differ for one in found):
        return ()
    if any(one.repeats for one in found) and share_of_misfit(study, after, effect) > SMALL:
        return ()
    before, judges = without(), study.validation or study.train
    if before is None or RISE * own_error(study, after, judges) < own_error(study, before, judges):
        return ()
    return tuple(found)


def share_of_misfit(study: Study, fit: FilteredSolution, effect: Effect) -> float:
    """By how much an effect moves training runs, over what the model on its own misses there.

    Returns
    -------
    float
        Root mean squares of the signal in which it is largest; infinite without a run to compare.
    """
    problem, unknowns = fit.problem, fit.point.unknowns
    names = list(problem.layout.shared_names)
    absent = unknowns.copy()
    absent[[names.index(name) for name in effect.amplitude_names if name in names]] = 0.0
    moved, missed = np.zeros(len(study.base.outputs)), np.zeros(len(study.base.outputs))
    for index, record in enumerate(study.train):
        seen = np.isfinite(record.outputs)
        present = problem.alone(unknowns, index)[0]
        change = present - problem.alone(absent, index)[0]
        with np.errstate(over="ignore", invalid="ignore"):
            moved += (np.where(seen, change, 0.0) ** 2).sum(axis=0)
            missed += (np.where(seen, record.residuals(present), 0.0) ** 2).sum(axis=0)
    if not np.all(np.isfinite(moved + missed)):
        return np.inf
    share = np.sqrt(moved / np.where(missed > 0, missed, np.inf))
    return float(share.max(initial=0.0))


def doubt(effect: Effect, sizes: Sequence[Sizes]) -> str:
    """Why a likelier effect is no claim."""
    ranges = ", ".join(
        f"{one.name} from {one.each.min():.2g} to {one.each.max():.2g}" for one in sizes
    )
    return (
        f"{effect.name} cannot be told from what else is missing: its size is another in every "
        f"record ({ranges}), by more than noise, and no whole run is better for it. No claim is "
        "made."
    )


def sizes_by_record(study: Study, fit: FilteredSolution, effect: Effect) -> list[Sizes]:
    """Each shared amplitude of an effect as training and validation records show it.

    Parameters
    ----------
    study : Study
    fit : FilteredSolution
        With the effect.
    effect : Effect

    Returns
    -------
    list of Sizes
        Of amplitudes that four records or more tell of.
    """
    problem, unknowns = fit.problem, fit.point.unknowns
    names = list(problem.layout.shared_names)
    asked = [name for name in effect.amplitude_names if name in names]
    fits = [fit]
    if asked and study.validation is not None:
        alone = study.alone(fit, study.validation)
        fits += [] if alone is None else [alone]
    if not asked or sum(len(one.problem.records) for one in fits) < FEWEST_RECORDS:
        return []
    told = [pair for one in fits for pair in _told(one)]
    matrices, scores = zip(*told, strict=True) if told else ((), ())
    if not np.isfinite(np.array(matrices)).all():
        return []
    n_shared = len(problem.layout.shared)
    values, slopes = problem.layout.shared_values(unknowns)
    prior = problem.limits.prior_weight[:n_shared]
    pull = prior * (problem.limits.prior_mean - unknowns)[:n_shared] / slopes
    found = [
        _sizes(name, names.index(name), values, matrices, scores, prior / slopes**2, pull)
        for name in asked
    ]
    return [one for one in found if one is not None]


def _told(fit: FilteredSolution) -> list[tuple[np.ndarray, np.ndarray]]:
    """Information and score of the shared parameters from every record of a fit."""
    unknowns = fit.point.unknowns
    return [
        record_information(fit.problem, unknowns, index, part)
        for index, part in enumerate(fit.problem.passes(unknowns, columns=True))
        if not fit.problem.records[index].independent
    ]


def _sizes(
    name: str,
    place: int,
    values: np.ndarray,
    matrices: Sequence[np.ndarray],
    scores: Sequence[np.ndarray],
    prior: np.ndarray,
    pull: np.ndarray,
) -> Sizes | None:
    """One parameter with a value of its own in every record.

    Parameters
    ----------
    name : str
    place : int
        Of the parameter among the shared ones.
    values : ndarray (n_shared,)
    matrices : sequence of ndarray (n_shared, n_shared)
        Information of each record.
    scores : sequence of ndarray (n_shared,)
    prior, pull : ndarray (n_shared,)
        Information of priors and their slope.
    """
    rest = np.setdiff1d(np.arange(len(prior)), [place])
    own = np.array([matrix[place, place] for matrix in matrices])
    told = np.flatnonzero(own > SILENT * own.max(initial=0.0))
    if len(told) < FEWEST_RECORDS:
        return None
    count = len(told)
    whole = np.zeros((count + len(rest),) * 2)
    right = np.concatenate([np.zeros(count), pull[rest]])
    whole[count:, count:] = np.diag(prior[rest])
    for matrix, score in zip(matrices, scores, strict=True):
        whole[count:, count:] += matrix[np.ix_(rest, rest)]
        right[count:] += score[rest]
    for position, index in enumerate(map(int, told)):
        whole[position, position] = own[index]
        whole[position, count:] = whole[count:, position] = matrices[index][place, rest]
        right[position] = scores[index][place]
    inverse = _inverse(whole)
    each = values[place] + (inverse @ right)[:count]
    weights = np.linalg.pinv(inverse[:count, :count], rcond=NOTHING, hermitian=True)
    total, sums = float(weights.sum()), weights.sum(axis=0)
    if not total > 0:
        return None
    mean = float(sums @ each) / total
    q = float((each - mean) @ weights @ (each - mean))
    spread = float(np.trace(weights) - sums @ sums / total)
    scatter = max(q - (count - 1), 0.0) / spread if spread > 0 else 0.0
    return Sizes(name, each, mean, total**-0.5, q, float(np.sqrt(scatter)))


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of an information, parameters in units of their own."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(matrix / scale[:, None] / scale)
    clear = values > NOTHING * values[-1]
    inner = vectors[:, clear] / scale[:, None]
    return (inner / values[clear]) @ inner.T
