"""Which effect is missing: scores for all candidates, refits for the few that deserve one."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from oed_sysid.evidence.score import Score, scores, two_sided
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.physics import Effect
from oed_sysid.physics.variants import BY_RECORD
from oed_sysid.runtime.display import Figure, Report, Section, Table

# Candidates refitted in each round.
N_REFITS = 7
# Of these, how many again with the noise levels free, and which share of the best gain
# makes one worth it.
N_FULL, SHARE = 4, 0.1
# Share of the gain that a claim needs below which free noise levels will not reach it either.
HOPELESS = 0.3
# A rival whose refit is this close, in twice the log-likelihood, cannot be told apart.
GROUP_WIDTH = 6.0
# Correlation of two signatures, free parameters projected out, above which they are one.
ALIKE = 0.95
# Of two such effects, the one that explains less by no more than this share is not refuted: noise
# models are never that exact.
NEARLY = 0.015
# Share of false claims over all candidates where no validation record can be asked, and
# where one is: chance passes both once in several hundred searches.
FALSE_CLAIMS, FALSE_CLAIMS_BEFORE_TEST = 0.01, 0.05


def threshold(
    n_candidates: int, freedom: int, share: float = FALSE_CLAIMS, *, trials: float = 1.0
) -> float:
    """Gain in twice the log-likelihood that chance exceeds rarely, however many candidates.

    ``trials`` counts the frequencies of which a candidate takes the best.

    Examples
    --------
    >>> round(threshold(40, 1), 1)
    13.4
    """
    return float(chdtri(freedom, share / (max(n_candidates, 1) * max(trials, 1.0))))


@dataclass(frozen=True, eq=False)
class Refit:
    """A candidate added and all parameters estimated again.

    Attributes
    ----------
    score : Score
        What the score test had said.
    fit : FilteredSolution
        The new fit, noise levels included.
    gain : float
        Gain in twice the log-likelihood.
    """

    score: Score
    fit: FilteredSolution
    gain: float

    @property
    def name(self) -> str:
        """Identifier of the effect."""
        return self.score.effect.name

    @property
    def evidence(self) -> float:
        """Gain less what freedom costs (two per parameter, as in Akaike's criterion).

        A size for every record costs twice that: it is estimated anew on validation records, too,
        so that these cannot refuse it in favour of one that all share. The best of many frequencies
        gains twice their logarithm by chance.
        """
        chance = 2.0 * float(np.log(self.score.trials))
        return self.gain - 2.0 * self.score.freedom - 2.0 * self.score.apart - chance


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
    share : float
        Share of false claims that chance may make on these records.
    """

    scores: tuple[Score, ...]
    refits: tuple[Refit, ...]
    residual: np.ndarray
    share: float = FALSE_CLAIMS

    @property
    def order(self) -> tuple[str, ...]:
        """Identifiers, refitted ones first by evidence, then the others by score."""
        refitted = [refit.name for refit in self.refits]
        return (*refitted, *(s.effect.name for s in self.scores if s.effect.name not in refitted))

    def without(self, names: Collection[str]) -> Ranking:
        """The same with some refits left out: no rivals of what is claimed."""
        kept = tuple(refit for refit in self.refits if refit.name not in names)
        return replace(self, refits=kept)

    def needed(self, refit: Refit) -> float:
        """Gain that a claim needs."""
        return self.needed_by(refit.score)

    def needed_by(self, score: Score) -> float:
        """Gain that a claim of one candidate needs."""
        return threshold(len(self.scores), score.freedom, self.share, trials=score.trials)

    def group(self, width: float = GROUP_WIDTH) -> tuple[Refit, ...]:
        """The best refit and all that these data cannot tell from it.

        The same with a size for every record is no rival: it holds the best as a special case.
        """
        if not self.refits:
            return ()
        best = self.refits[0]
        return tuple(
            refit
            for refit in self.refits
            if refit.name != f"{best.name}{BY_RECORD}"
            and (
                best.evidence - refit.evidence < width
                or (
                    best.gain - refit.gain < NEARLY * best.gain
                    and self.similarity(best, refit) > ALIKE
                )
            )
        )

    def similarity(self, first: Refit, second: Refit) -> float:
        """Largest canonical correlation of two effects' signatures."""
        cosines = _basis(first.score).T @ _basis(second.score)
        return float(np.linalg.svd(cosines, compute_uv=False).max(initial=0.0))

    def alike(self, name: str, limit: float = ALIKE) -> tuple[str, ...]:
        """Candidates never refitted that explain nearly what another explains, by likeness.

        Those that were refitted are told from it, or not, by their evidence.
        """
        own = next(score for score in self.scores if score.effect.name == name)
        explained = _within(own, self.residual)
        size = float(np.linalg.norm(explained))
        refitted = {refit.name for refit in self.refits}
        found = {
            score.effect.name: float(np.linalg.norm(_within(score, explained))) / size
            for score in self.scores
            if size > 0
            and score.effect.name not in refitted
            and score.effect.name not in (name, f"{name}{BY_RECORD}")
        }
        return tuple(n for n in sorted(found, key=lambda n: -found[n]) if found[n] > limit)

    def claimed_with(self, name: str) -> tuple[str, ...]:
        """A claimed effect and all that these data cannot tell from it or from the best."""
        names = (name, *(refit.name for refit in self.group()), *self.alike(name))
        return tuple(dict.fromkeys(names))

    def document(self, *, hidden: bool = True) -> Report:
        """Return the best candidates and, with ``hidden``, what these records cannot show.

        What they cannot show beside the nominal model they may show beside a better one.
        """
        rows = []
        refits = {refit.name: refit for refit in self.refits}
        scores = {score.effect.name: score for score in self.scores}
        for name in self.order[:8]:
            score = scores[name]
            gain = f"{refits[name].gain:.1f}" if name in refits else "-"
            needed = f"{self.needed_by(score):.1f}"
            rows.append((name, f"{score.statistic:.1f}", gain, needed, f"{score.distinct:.2f}"))
        headers = ("candidate effect", "score", "gain", "needed", "distinct")
        drawing = Figure(
            "plot_ranking", self,
            "The candidates in the first round. The score is computed without refitting; the most "
            "promising candidates are then refitted.",
            size=(8.4, 5.2),
        )  # fmt: skip
        imitated = self.imitated()
        seen = self.undetectable()
        unseen = sorted(set(seen) - set(imitated))
        words = []
        if hidden and unseen:
            words += ["", "These records would not show the typical size of: " + ", ".join(unseen)]
        if hidden and imitated:
            text = "Parameters that are free already do the same in these records as: "
            words += ["", text + ", ".join(imitated)]
        parts = [Section("Candidates", words, (Table(headers, rows),), (drawing,))]
        if seen:
            units = {p.name: p.unit for score in self.scores for p in score.effect.parameters}
            sizes = [(name, _visible_from(limits, units)) for name, limits in seen.items()]
            table = Table(("candidate", "would be seen from"), sizes, words=(1,))
            says = (
                f"{len(seen)} of {len(self.scores)} candidates would not be seen in these "
                "records at their typical size. That they were not found says nothing about them."
            )
            parts.append(Section("Invisible at typical size", (says,), (table,), only="page"))
        return Report("Candidates", sections=parts)

    def report(self, *, hidden: bool = True) -> str:
        """Return the document as text."""
        return "\n".join(self.document(hidden=hidden).sections[0].lines())

    def imitated(self) -> tuple[str, ...]:
        """Effects that free parameters of the model imitate completely, by name."""
        return tuple(sorted(score.effect.name for score in self.scores if score.absorbed))

    def statistics(self) -> list[tuple[str, float]]:
        """Gain after refitting where refitted, score statistic elsewhere; best first."""
        gains = {refit.name: refit.gain for refit in self.refits}
        scored = {score.effect.name: score.statistic for score in self.scores}
        return [(name, gains.get(name, scored[name])) for name in self.order]

    def scored(self) -> list[dict[str, Any]]:
        """Return :meth:`statistics` as plain data."""
        return [{"effect": name, "statistic": size} for name, size in self.statistics()]

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
    share: float = FALSE_CLAIMS,
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
    share : float
        Share of false claims that chance may make on these records.
    """
    scored, residual = scores(study, fit, candidates)
    shared = {f"{s.effect.name}{BY_RECORD}": s.statistic for s in scored}
    chosen = [
        s
        for s in scored
        # A size for every record only where it says more than one that all share.
        if not s.absorbed and s.statistic > 2.0 + shared.get(s.effect.name, -s.apart) + s.apart
    ][:n_refits]
    chosen += [s for s in scored if s.effect.name in also and s not in chosen]
    quick = [r for r in (refit(study, fit, score) for score in chosen) if r is not None]
    quick.sort(key=lambda r: -r.evidence)
    best = quick[0].gain if quick else 0.0

    def worth(position: int, r: Refit) -> bool:
        needed = threshold(len(scored), r.score.freedom, share, trials=r.score.trials)
        return position < N_FULL and r.gain > SHARE * best and r.gain > HOPELESS * needed

    refits = [deepen(study, fit, r) if worth(n, r) else r for n, r in enumerate(quick)]
    refits.sort(key=lambda r: -r.evidence)
    return Ranking(tuple(scored), tuple(refits), residual, share)


def refit(study: Study, fit: FilteredSolution, score: Score) -> Refit | None:
    """Estimate parameters again with one candidate added, noise levels held.

    An effect that may have either sign starts from nothing, where the first
    step is the score test's own; one that cannot be negative, and often has a
    kink there, starts from its one-step estimate. Further starts follow where
    the first leads nowhere.
    """
    effect = score.effect
    best: FilteredSolution | None = None
    shares = (0.0, 1.0, 0.2) if two_sided(effect) else (1.0, 0.2, 0.0)
    for share in shares:
        # Shapes that the score did not choose stay where the effect has them.
        start = {p.name: p.value for p in effect.parameters if p.name in effect.shape_names}
        start.update(fit.values)
        for name, value in score.estimate.items():
            start[name] = share * value if name in effect.amplitude_names else value
        found = study.estimate(
            (*study.effects_of(fit), effect),
            start,
            fit,
            update_noise=False,
            max_iterations=6,
        )
        if found is not None and (best is None or found.objective < best.objective):
            best = found
        if best is not None and fit.objective - best.objective > 0.3 * score.statistic:
            break
    if best is None:
        return None
    return Refit(score, best, fit.objective - best.objective)


def deepen(study: Study, fit: FilteredSolution, quick: Refit) -> Refit:
    """Continue a refit with the noise levels free: what the effect explains is no noise."""
    found = study.estimate(
        study.effects_of(quick.fit), quick.fit.values, quick.fit, max_iterations=25
    )
    if found is None or found.objective > quick.fit.objective:
        return quick
    return Refit(quick.score, found, fit.objective - found.objective)
