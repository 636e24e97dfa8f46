"""Where a search stands: what it has added, the fits on the way, and how these are judged.

Effects that only smooth the noise of a logged input (a lag, a backlash) are no claims.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.improvement import RISE
from oed_sysid.evidence.rank import FALSE_CLAIMS, FALSE_CLAIMS_BEFORE_TEST, Ranking, threshold
from oed_sysid.evidence.residual_forces import repeated
from oed_sysid.evidence.study import Study, total_error
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.physics import Effect

# Error of whole runs, over that of a fit without disturbance forces, that they should not cost.
BOUGHT = 2.0
# Error of whole validation runs after an addition, over that before, that is no rise while random
# forces act, and where the validation records gain as much as chance never gives besides: runs
# wander under forces, and those of the better model may wander further. In seas a bias that was
# there rose to 1.03 (gain on validation 127), a current to 1.24 (gain 384).
WANDERING, WANDERING_FAR, BEYOND_CHANCE = 1.1, 1.5, 50.0
# Training gain, over that needed, from which validation records that cannot tell need not confirm.
ALONE = 2.0
# Gain in twice the log-likelihood on validation records that confirms a claim.
CONFIRMED = 2.0


@dataclass(frozen=True, eq=False)
class Added:
    """One effect that was added, why, and the fit with it."""

    effect: Effect
    ranking: Ranking | None
    gain: float
    needed: float
    validation_gain: float
    group: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Standing:
    """Where the loop stands: what was added, the fit with it, and all fits on the way.

    ``dismissed`` holds names of likelier effects that are no claims, and why.
    """

    study: Study
    added: tuple[Added, ...]
    fit: FilteredSolution
    path: tuple[FilteredSolution, ...]
    replaced: tuple[str, ...] = ()
    dismissed: tuple[tuple[str, str], ...] = ()
    dropped: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects that were added, in their order."""
        return tuple(one.effect for one in self.added)

    @property
    def left(self) -> list[Effect]:
        """Candidates that may still be added."""
        gone = {effect.name for effect in self.effects} | set(self.dropped)
        return [e for e in self.study.candidates if e.name not in gone]

    @property
    def share(self) -> float:
        """Share of false claims allowed before validation records, if any, are asked."""
        return FALSE_CLAIMS if self.study.validation is None else FALSE_CLAIMS_BEFORE_TEST

    def needed(self, effect: Effect) -> float:
        """Gain that chance rarely gives, were the effect among the candidates left."""
        return threshold(len(self.left) + 1, len(effect.parameters), self.share)

    def others(self, one: Added) -> tuple[Added, ...]:
        """What was added besides."""
        return tuple(other for other in self.added if other is not one)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why likelier effects are no claims, but those that became claims after all."""
        claimed = {effect.name for effect in self.effects}
        return tuple(why for name, why in self.dismissed if name not in claimed)

    def doubting(self, name: str, why: str) -> Standing:
        """The same with a word about an effect that is no claim, in place of an earlier one."""
        return replace(self, dismissed=tuple((dict(self.dismissed) | {name: why}).items()))

    def dropping(self, one: Added, fit: FilteredSolution) -> Standing:
        """The same without one effect, which does not come back."""
        gone = (*self.dropped, one.effect.name)
        return replace(self, added=self.others(one), fit=fit, dropped=gone)


def absent(fit: FilteredSolution, effect: Effect) -> dict[str, float]:
    """Values of a fit with one effect at nothing."""
    return dict(fit.values) | dict.fromkeys(effect.amplitude_names, 0.0)


def difference(before: float, after: float) -> float:
    """Gain of a model over another, either of which may not run at all."""
    if not np.isfinite(after):
        return -np.inf
    return before - after if np.isfinite(before) else np.inf


def confirmed(
    study: Study, before: FilteredSolution, after: FilteredSolution, gain: float, excess: float
) -> bool:
    r"""Whether validation records agree with an effect.

    They do where they become more likely; and where they could not tell while the training records
    leave no doubt. An effect that moves the runs by :math:`d` noise levels altogether is expected
    to gain :math:`d^2 \pm 2d`: less than two deviations below that is no contradiction.

    Parameters
    ----------
    study : Study
    before, after : FilteredSolution
    gain : float
        On the validation records.
    excess : float
        Gain on the training records, over that needed.
    """
    assert study.validation is not None
    if gain > CONFIRMED:
        return True
    if not (excess > ALONE and gain > -CONFIRMED):
        return False
    distance = study.apart(before, after, study.validation)
    return gain > distance**2 - 4.0 * distance


def rises(
    study: Study, before: FilteredSolution, after: FilteredSolution, gain: float | None = None
) -> bool:
    """Whether the error of the model on its own on validation records rises or is infinite.

    Parameters
    ----------
    study : Study
    before, after : FilteredSolution
    gain : float, optional
        In twice the log-likelihood of the validation records: with a named effect that gains
        there, runs may wander under disturbance forces.
    """
    assert study.validation is not None
    old, new = (own_error(study, fit, study.validation) for fit in (before, after))
    if not np.isfinite(new):
        return True
    if new <= RISE * old:
        return False
    if gain is None or not after.noise.has_forces:
        return True
    far = WANDERING_FAR if gain > BEYOND_CHANCE else WANDERING
    if new > far * old or not np.isfinite(own_error(study, after, study.train)):
        return True
    # A force that follows the motion is structure, and under that no run wanders by chance.
    return bool(repeated(study, after, study.on_records(after, study.validation)))


def own_error(study: Study, found: FilteredSolution, dataset: Dataset) -> float:
    """Error over all outputs of the model on its own on records, in units of the noise."""
    return total_error(study.rms(found, dataset) / study.setting.white)


# Candidates per round that the validation records are asked about.
ASKED = 3


def without_smoothers(state: Standing, ranking: Ranking) -> tuple[Ranking, dict[str, str]]:
    """The ranking without refits that only smooth the noise of a logged input, and why."""
    study, told = state.study, dict[str, str]()
    asked = [r for r in ranking.refits[:ASKED] if r.gain >= ranking.needed(r)]
    if study.smoothed is None or not asked:
        return ranking, {}
    before = smoothed_fit(study, state.fit)
    for refit in ranking.refits:
        if refit in asked and not persists(study, before, refit.fit, ranking.needed(refit)):
            told[refit.name] = dismissal(study, refit.name)
    return ranking.without(told), told


def smoothed_fit(study: Study, fit: FilteredSolution) -> FilteredSolution | None:
    """The same model on the training records with the noise of logged inputs smoothed."""
    assert study.smoothed is not None
    other = replace(study, train=study.smoothed)
    return other.estimate(other.effects_of(fit), fit.values, fit, max_iterations=12)


def persists(
    study: Study, before: FilteredSolution | None, after: FilteredSolution, needed: float
) -> bool:
    """Whether a gain over a fit to smoothed records is left there.

    The vehicle answers to the true input. What flattens the answer to a noisy log (a play, a lag)
    is likelier, whether or not it is there.
    """
    found = smoothed_fit(study, after)
    if before is None or found is None:
        return True
    return before.objective - found.objective >= needed


def dismissal(study: Study, name: str) -> str:
    """Why a likelier effect is no claim."""
    return (
        f"{name} may explain no more than the noise of the logged {', '.join(study.noisy_inputs)}: "
        "no claim is made."
    )
