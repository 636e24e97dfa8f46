"""Effects that only smooth the noise of a logged input are no claims."""

from __future__ import annotations

from dataclasses import replace

from oed_sysid.evidence.rank import Ranking
from oed_sysid.evidence.standing import Standing
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.gauss_newton import FilteredSolution

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
