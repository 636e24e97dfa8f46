r"""Which effect is missing: scores for all candidates, refits for the few that deserve one.

Where no single effect is claimed, two may be that hide each other, as an offset and dry friction
do: with projected signatures :math:`S = (s_i, s_j)` of a pair and the residual :math:`r`, the joint
score statistic :math:`r'S (S'S)^{-1} S'r` costs nothing beyond the scores of all, and pairs whose
joint statistic exceeds the threshold of all pairs are refitted together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Any

import numpy as np

from oed_sysid.evidence.chance import threshold
from oed_sysid.evidence.claim import Claim, at_bounds, joined
from oed_sysid.evidence.score import SIZES, Score, scores, two_sided
from oed_sysid.evidence.sentences import SAYS, say
from oed_sysid.evidence.study import Study, likelier, usual
from oed_sysid.information.shifts import GROUP_WIDTH
from oed_sysid.likelihood.fit import ALIKE, MOST_DRAWN
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.physics import Effect
from oed_sysid.physics.variants import BY_RECORD
from oed_sysid.runtime.constants import IMMATERIAL, MATERIAL
from oed_sysid.runtime.display import Figure, Report, Section, Table, as_text

# Candidates, and where none is claimed pairs, that are refitted in each round.
N_REFITS = 7


@dataclass(frozen=True, eq=False)
class Refit:
    """A candidate added and all parameters estimated again.

    Attributes
    ----------
    scores : tuple of Score
        What the score test had said; of several where a set was tried jointly.
    fit : FilteredSolution
        The new fit, noise levels included.
    gain : float
        Likelihood-ratio statistic on the training records.
    needed : float
        Threshold of a claim.
    """

    scores: tuple[Score, ...]
    fit: FilteredSolution
    gain: float
    needed: float

    @property
    def score(self) -> Score:
        """Score of the first effect."""
        return self.scores[0]

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects as they were fitted: bounds may be wider than those of the candidates."""
        known = {effect.name: effect for effect in self.fit.problem.model.effects}
        return tuple(known[score.effect.name] for score in self.scores)

    @property
    def name(self) -> str:
        """Identifier of the effect, or of all of a set."""
        return joined(score.effect for score in self.scores)

    @property
    def evidence(self) -> float:
        """Statistic less the threshold, which grows with freedoms and frequencies tried."""
        return self.gain - self.needed


@dataclass(frozen=True, eq=False)
class Ranking:
    """All candidates, best first.

    Attributes
    ----------
    scores : tuple of Score
        By score statistic.
    refits : tuple of Refit
        By evidence.
    residual : ndarray (n_rows,)
        Whitened residual, existing unknowns projected out.

    Examples
    --------
    What :func:`~oed_sysid.evidence.rank_effects` returns; see there.
    """

    scores: tuple[Score, ...]
    refits: tuple[Refit, ...]
    residual: np.ndarray

    @property
    def order(self) -> tuple[str, ...]:
        """Identifiers, refitted ones first by evidence, then the others by score."""
        refitted = [refit.name for refit in self.refits]
        return (*refitted, *(s.effect.name for s in self.scores if s.effect.name not in refitted))

    def needed_by(self, score: Score) -> float:
        """Statistic that a claim of one candidate needs."""
        return threshold(len(self.scores), score.freedom, trials=score.trials)

    def group(self, best: Refit | None = None, claims: Sequence[Claim] = ()) -> tuple[Refit, ...]:
        """The best refit, or another, and all that these data cannot tell from it.

        Compared by their claims where both were asked, else by the training records. The same with
        a size for every record is no rival: it holds the best as a special case.
        """
        if not self.refits:
            return ()
        lead = best or self.refits[0]
        asked = {one.name: one for one in claims}

        def near(refit: Refit) -> bool:
            if {lead.name, refit.name} <= set(asked):
                first, other = asked[lead.name], asked[refit.name]
                error = self.error(lead, refit, first.independent)
                return first.excess - other.excess < error
            return lead.evidence - refit.evidence < self.error(lead, refit)

        same = (lead.name, f"{lead.name}{BY_RECORD}")
        return lead, *(one for one in self.refits if one.name not in same and near(one))

    def error(self, best: Refit, other: Refit, independent: float = 1.0) -> float:
        r"""What two statistics may differ by and be the same.

        Odds of 20 to 1; of signatures that are nearly one, two standard errors of the difference,
        :math:`4 \sqrt{2 T (1 - \rho)}` (Vuong 1989, Econometrica 57): no noise model is so exact.
        Of claims, :math:`T` counts the share of the innovations that is ``independent``.
        """
        # The largest canonical correlation of the two signatures.
        cosines = _basis(best.score).T @ _basis(other.score)
        correlation = min(float(np.linalg.svd(cosines, compute_uv=False).max(initial=0.0)), 1.0)
        if correlation < ALIKE:
            return GROUP_WIDTH
        statistic = independent * best.gain
        return max(GROUP_WIDTH, 4.0 * float(np.sqrt(2.0 * statistic * (1.0 - correlation))))

    def alike(self, name: str, limit: float = ALIKE) -> tuple[str, ...]:
        """Candidates never refitted that explain nearly what another explains, by likeness.

        Those that were refitted are told from it, or not, by their evidence.
        """
        own = next(score for score in self.scores if score.effect.name == name)
        explained = _within(own, self.residual)
        size = float(np.linalg.norm(explained))
        told = {name, f"{name}{BY_RECORD}", *(refit.name for refit in self.refits)}
        found = {
            score.effect.name: float(np.linalg.norm(_within(score, explained))) / size
            for score in self.scores
            if size > 0 and score.effect.name not in told
        }
        return tuple(n for n in sorted(found, key=lambda n: -found[n]) if found[n] > limit)

    def claimed_with(self, refit: Refit, claims: Sequence[Claim] = ()) -> tuple[str, ...]:
        """A claimed effect and all that these data cannot tell from it."""
        names = (*(one.name for one in self.group(refit, claims)), *self.alike(refit.name))
        return tuple(dict.fromkeys(names))

    def document(self, *, hidden: bool = True) -> Report:
        """Return the best candidates and, with ``hidden``, what these records cannot show.

        What they cannot show beside the nominal model they may show beside a better one.
        """
        caption = SAYS["captions"]["plot_ranking"]
        drawing = Figure("plot_ranking", self, caption, size=(8.4, 5.2))
        imitated, seen = self.imitated(), self.undetectable()
        untold = {"hidden": sorted({*seen} - {*imitated}), "imitated": imitated}
        told = (["", say("ranking", row, names=", ".join(of))] for row, of in untold.items() if of)
        words = [*chain.from_iterable(told)] if hidden else []
        parts = [Section("Candidates", words, (self._table(),), (drawing,))]
        if seen:
            units = {p.name: p.unit for score in self.scores for p in score.effect.parameters}
            sizes = [(name, _visible_from(limits, units)) for name, limits in seen.items()]
            table = Table(("candidate", "would be seen from"), sizes, words=(1,))
            says = say("ranking", "invisible", count=len(seen), all=len(self.scores))
            parts.append(Section("Invisible at typical size", (says,), (table,), only="page"))
        return Report("Candidates", sections=parts)

    def _table(self) -> Table:
        """The best candidates with scores, likelihood-ratio statistics and thresholds."""
        refits = {refit.name: refit for refit in self.refits}
        scores = {score.effect.name: score for score in self.scores}
        rows = []
        for name in self.order[:MOST_DRAWN]:
            score = scores[name]
            gain = f"{refits[name].gain:.1f}" if name in refits else "-"
            needed = f"{self.needed_by(score):.1f}"
            rows.append((name, f"{score.statistic:.1f}", gain, needed, f"{score.distinct:.2f}"))
        return Table(("candidate effect", "score", "2ΔlnL", "threshold", "distinct"), rows)

    report = as_text

    def imitated(self) -> tuple[str, ...]:
        """Effects that free parameters of the model imitate completely, by name."""
        return tuple(sorted(score.effect.name for score in self.scores if score.absorbed))

    def scored(self) -> list[dict[str, Any]]:
        """Gain after refitting where refitted, score statistic elsewhere; best first."""
        gains = {score.effect.name: score.statistic for score in self.scores}
        gains |= {refit.name: refit.gain for refit in self.refits}
        return [{"effect": name, "statistic": gains[name]} for name in self.order]

    def undetectable(self) -> dict[str, dict[str, float]]:
        """Effects whose typical size these data would not show, with the size they would."""
        found = {}
        for score in self.scores:
            needed = self.needed_by(score) ** 0.5
            sizes = {p.name: p.magnitude for p in score.effect.parameters}
            limits = {name: needed * error for name, error in score.std_errors.items()}
            # What would show in one of its amplitudes would show.
            unseen = [limit > sizes[name] for name, limit in limits.items()]
            if score.absorbed or (unseen and all(unseen)):
                found[score.effect.name] = limits
        return found


def _visible_from(limits: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Amplitudes from which a candidate would show; none where free parameters imitate it."""
    if not all(np.isfinite(value) for value in limits.values()):
        return "no size: the free parameters imitate it"
    return ", ".join(
        f"{key} = {value:.3g} {'' if units[key] == '1' else units[key]}".rstrip()
        for key, value in limits.items()
    )


def _basis(score: Score) -> np.ndarray:
    """Orthonormal basis of an effect's signature; no column where there is none."""
    signature = score.signature if np.any(score.signature) else score.signature[:, :0]
    return np.linalg.qr(signature)[0]


def _within(score: Score, rows: np.ndarray) -> np.ndarray:
    """What the amplitudes of an effect can explain of some rows."""
    basis = _basis(score)
    return basis @ (basis.T @ rows)


def rank(
    study: Study,
    fit: FilteredSolution,
    candidates: Sequence[Effect],
    *,
    n_refits: int = N_REFITS,
    also: Sequence[str] = (),
) -> Ranking:
    """Score all candidates, refit the most promising.

    Parameters
    ----------
    study, fit
        The present model.
    candidates : sequence of Effect
        Absent effects, all held by the study's filter.
    n_refits : int
        How many to refit.
    also : sequence of str
        Identifiers that are refitted whatever their score.
    """
    scored, residual = scores(study, fit, candidates)
    ranking = Ranking(tuple(scored), (), residual)
    chosen = _promising(scored)[:n_refits]
    chosen += [s for s in scored if s.effect.name in also and s not in chosen]
    sets = [((score,), ranking.needed_by(score)) for score in chosen]
    return replace(ranking, refits=refitted(study, fit, sets))


def _promising(scored: Sequence[Score]) -> list[Score]:
    """Those that free parameters do not imitate; a size for every record only where it says more.

    More, that is, than one that all records share.
    """
    shared = {f"{s.effect.name}{BY_RECORD}": s.statistic for s in scored}
    return [
        s
        for s in scored
        if not s.absorbed and s.statistic > 2.0 + shared.get(s.effect.name, -s.apart) + s.apart
    ]


def refitted(
    study: Study,
    fit: FilteredSolution,
    sets: Sequence[tuple[Sequence[Score], float]],
    near: FilteredSolution | None = None,
) -> tuple[Refit, ...]:
    """Refits of sets of candidates, each with its threshold, by evidence.

    Noise levels are held, and free where a set may then be claimed.
    """
    tried = (refit(study, fit, scored, needed, near) for scored, needed in sets)
    quick = sorted((r for r in tried if r is not None), key=lambda r: -r.evidence)
    deep = [deepen(study, fit, r) if hopeful(r, quick[0].gain) else r for r in quick]
    return tuple(sorted(deep, key=lambda r: -r.evidence))


def hopeful(refit: Refit, best: float) -> bool:
    """Whether a refit may be claimed: validation records rarely say more than the training.

    An immaterial share of the best statistic makes no rival in this round.
    """
    return 2.0 * refit.gain > refit.needed and refit.gain > IMMATERIAL * best


def pairs(study: Study, fit: FilteredSolution, ranking: Ranking) -> tuple[Refit, ...]:
    """Refits of pairs that are strong together, best first.

    Parameters
    ----------
    study, fit
        The present model.
    ranking : Ranking
        Its scores.
    """
    single = [s for s in ranking.scores if not s.absorbed and s.signature.shape[1] == 1]
    if len(single) < 2:
        return ()
    columns = np.column_stack([s.signature[:, 0] for s in single])
    columns /= np.linalg.norm(columns, axis=0)
    likeness, along = columns.T @ columns, columns.T @ ranking.residual
    count = len(single) * (len(single) - 1) // 2
    found: list[tuple[float, tuple[Score, Score], float]] = []
    for i, j in combinations(range(len(single)), 2):
        rho, one, two = likeness[i, j], single[i], single[j]
        if abs(rho) > ALIKE:
            continue
        joint = (along[i] ** 2 + along[j] ** 2 - 2 * rho * along[i] * along[j]) / (1 - rho**2)
        needed = threshold(count, one.freedom + two.freedom, trials=one.trials * two.trials)
        if joint > needed:
            found.append((joint - needed, (one, two), needed))
    found.sort(key=lambda one: -one[0])
    return refitted(study, fit, [(both, needed) for _, both, needed in found[:N_REFITS]])


def refit(
    study: Study,
    fit: FilteredSolution,
    scored: Sequence[Score],
    needed: float,
    near: FilteredSolution | None = None,
) -> Refit | None:
    """Estimate parameters again with candidates added, noise levels held.

    An effect that may have either sign starts from nothing, where the first step is the score
    test's own; one that cannot be negative, and often has a kink there, starts from its one-step
    estimate, and so does one beside parameters of a fit that is ``near``. Further sizes follow
    where the first leads nowhere; then, noise levels free, what is usual: beside noise that is too
    small for what is missing, thresholds have many valleys.
    """
    scored = [_with_room(score) for score in scored]
    effects = (*study.effects_of(fit), *(score.effect for score in scored))
    best: FilteredSolution | None = None
    # No other size is begun from once a material share of the score statistic is reached.
    reached = fit.objective - MATERIAL * max(score.statistic for score in scored)
    for start, free in _begins(near or fit, scored, needed, beside=near is not None):
        steps = 25 if free else 6
        found = study.estimate(effects, start, fit, update_noise=free, max_iterations=steps)
        best = likelier(best, found)
        if best is not None and best.objective < reached:
            break
    if best is None:
        return None
    return Refit(tuple(scored), best, fit.objective - best.objective, needed)


def _with_room(score: Score) -> Score:
    """A score whose effect has no bound that nobody declared before its one-step estimate."""
    limits = {p.name: (p.lower, p.upper) for p in score.effect.parameters}
    within = all(limits[name][0] < v < limits[name][1] for name, v in score.estimate.items())
    return score if within else replace(score, effect=score.effect.widened())


def _begins(
    fit: FilteredSolution, scored: Sequence[Score], needed: float, *, beside: bool
) -> Iterator[tuple[dict[str, float], bool]]:
    """Values to begin a refit from in turn, and whether noise levels are free there."""
    plain = not beside and all(two_sided(score.effect) for score in scored)
    # The one-step estimate itself first, then sizes below and above it.
    steps = sorted(SIZES, key=lambda size: abs(size - 1.0))
    for size in (0.0, *steps) if plain else (*steps, 0.0):
        yield _start(fit, scored, size), False
    if not plain and 2.0 * max(score.statistic for score in scored) > needed:
        yield dict(fit.values) | usual([score.effect for score in scored]), True


def _start(fit: FilteredSolution, scored: Sequence[Score], size: float) -> dict[str, float]:
    """Values to begin a refit from, amplitudes in sizes of their one-step estimates."""
    start: dict[str, float] = {}
    for score in scored:
        effect = score.effect
        # Shapes that the score did not choose stay where the effect has them.
        start |= {p.name: p.value for p in effect.parameters if p.name in effect.shape_names}
    start |= fit.values
    for score in scored:
        limits = {p.name: (p.lower, p.upper) for p in score.effect.parameters}
        for name, value in score.estimate.items():
            scaled = size * value if name in score.effect.amplitude_names else value
            start[name] = float(np.clip(scaled, *limits[name]))
    return start


def deepen(study: Study, fit: FilteredSolution, quick: Refit) -> Refit:
    """Continue a refit with the noise levels free: what the effect explains is no noise.

    Where it ends at a bound that nobody declared it goes on without.
    """
    effects = study.effects_of(quick.fit)
    if at_bounds(quick.fit, quick.effects):
        own = {effect.name for effect in quick.effects}
        effects = tuple(one.widened() if one.name in own else one for one in effects)
    found = study.estimate(effects, quick.fit.values, quick.fit)
    if found is None or found.objective > quick.fit.objective:
        return quick
    deep = replace(quick, fit=found, gain=fit.objective - found.objective)
    once_more = at_bounds(found, deep.effects) and not at_bounds(quick.fit, quick.effects)
    return deepen(study, fit, deep) if once_more else deep
