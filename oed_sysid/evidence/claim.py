r"""One claim, which anybody can recompute: a statistic, a threshold, and whole runs.

A candidate set that moves the fit of the training records :math:`t` and the prediction of the
validation records :math:`v` is worth

.. math::
    T = \underbrace{2 \ln L_1(y_t) - 2 \ln L_0(y_t)}_\text{training}
      + \underbrace{2 \ln p_1(y_v | y_t) - 2 \ln p_0(y_v | y_t)}_\text{validation}

with 0 before and 1 after, each at its own optimum; what the training records say of the parameters
is the prior of the validation records (:mod:`oed_sysid.evidence.study`). It is claimed where

1. :math:`T > \chi^{2,-1}_k(1 - \alpha / m)`, with :math:`k` freedoms and :math:`m` candidates left
   (Bonferroni; a periodic force counts the frequencies that the records tell apart), both terms
   counted per independent innovation where no process noise is admitted;
2. the error of the model on its own over whole validation records is finite and does not rise;
   where process noise acts, runs of the better model may wander, too, but only of one under which
   the validation records are likelier;
3. no amplitude ends at a bound beyond which the training records are likelier by more than the
   same threshold, everything estimated again without that bound: else the effect stands for another
   one. With less beyond it, the value rests at its bound.

4. it is above the threshold, too, where measured inputs that are noisy are smoothed beforehand:
   what averages neighbours of a noisy input, as a delay of less than a sample does, predicts better
   than the input as logged (errors in variables; Fuller 1987).

Of several the largest excess :math:`T - \chi^{2,-1}` leads, and those within the error of their
difference are one group. What is in the model is asked the same question the other way round: what
costs less than its threshold to leave out goes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.evidence.misfit import are_white
from oed_sysid.evidence.study import RISE, Prediction, Study, allowed_rise, information, worse
from oed_sysid.likelihood.departures import CLEARLY
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.information import whiteness
from oed_sysid.likelihood.judgement import UNSEEN
from oed_sysid.physics import Effect
from oed_sysid.physics.parameters import Parameter, with_parameters
from oed_sysid.runtime.constants import ROUNDING
from oed_sysid.runtime.display import as_dict


@dataclass(frozen=True, eq=False)
class Claim:
    """One decision with every term of it.

    Attributes
    ----------
    name : str
        What was asked: an effect, or several joined by ``" + "``.
    training : float
        Likelihood-ratio statistic on the training records.
    validation : float
        The same of the prediction of the validation records; NaN without any.
    needed : float
        Threshold, less ``spared``.
    before, after : float
        Errors of whole validation runs, in units of the noise; NaN without any.
    allowed : float
        Ratio of the two that is no rise where the validation records are likelier.
    bounds : tuple of str
        Amplitudes that end at a bound.
    beyond : float
        What the training statistic would rise by without these bounds.
    independent : float
        Share of the samples that count as independent; both terms are multiplied by it.
    models : tuple of (float, Prediction)
        What both terms are made of, before and after: minus twice the log-likelihood of the
        training records, and the :class:`~oed_sysid.evidence.study.Prediction` of the validation
        records (None without any).
    behind : str
        What was taken before it, or why it was not taken, where it stands.
    spared : float
        Thresholds of the effects that it takes the place of.
    """

    name: str
    training: float
    validation: float
    needed: float
    before: float = np.nan
    after: float = np.nan
    allowed: float = RISE
    bounds: tuple[str, ...] = ()
    beyond: float = 0.0
    independent: float = 1.0
    models: tuple[tuple[float, Prediction | None], ...] = ()
    behind: str = ""
    spared: float = 0.0

    @property
    def statistic(self) -> float:
        """The statistic T."""
        return self.training + (0.0 if np.isnan(self.validation) else self.validation)

    @property
    def excess(self) -> float:
        """What T has beyond the threshold."""
        return self.statistic - self.needed

    @property
    def rises(self) -> bool:
        """Whether whole validation runs get worse, or end."""
        # Where the validation records are less likely too, nothing in them speaks for it.
        allowed = RISE if self.validation < 0.0 else self.allowed
        return worse(self.before, self.after, allowed)

    @property
    def held(self) -> bool:
        """Whether bounds keep the records from being clearly likelier."""
        return self.beyond > max(self.needed + self.spared, 0.0)

    @property
    def stands(self) -> bool:
        """Whether it is claimed."""
        return self.excess > 0.0 and not self.held and not self.rises

    @property
    def decision(self) -> str:
        """The decision in words."""
        if not self.excess > 0.0:
            return f"T below threshold {self.behind}".rstrip()
        names = ", ".join(self.bounds)
        if np.isinf(self.beyond):
            return f"grows without end ({names})"
        at = f"at its bound ({names})"
        if self.held:
            return f"{at}, {self.beyond:.1f} likelier beyond"
        if self.rises:
            return "whole runs get worse"
        if self.behind:
            return f"passes, {self.behind}"
        return f"stands, {at}" if self.bounds else "stands"

    def passed_over(self, why: str) -> Claim:
        """The same, not taken where it stands."""
        return replace(self, behind=why) if self.stands else self

    to_dict = as_dict(
        "name", "training", "validation", "statistic", "needed", "before", "after", "decision",
        "independent",
    )  # fmt: skip


def claim(
    study: Study,
    before: FilteredSolution,
    after: FilteredSolution,
    effects: Sequence[Effect],
    needed: float,
    spared: float = 0.0,
) -> Claim:
    """Ask whether effects are to be claimed.

    Parameters
    ----------
    study : Study
    before, after : FilteredSolution
        Without and with them, each estimated on the training records.
    effects : sequence of Effect
        What is asked.
    needed : float
        Threshold.
    spared : float
        Thresholds of the effects that they take the place of.
    """
    share, records, fits = independent_share(study, before), study.validation, (before, after)
    models = tuple(
        (fit.objective, None if records is None else study.predict(fit, records)) for fit in fits
    )
    told = [prediction.value for _, prediction in models if prediction]
    found = Claim(
        joined(effects),
        share * (before.objective - after.objective),
        share * difference(*told) if told else np.nan,
        needed - spared,
        study.own_error(before),
        study.own_error(after),
        allowed=allowed_rise(after), independent=share, models=models, spared=spared,
    )  # fmt: skip
    if not (effects and found.excess > 0.0):
        return found
    found = _bounded(study, after, effects, found)
    calm = _smoothed(study, *fits)
    if calm is None:
        return found
    again = claim(*calm, effects, needed, spared)
    return found if again.excess > 0.0 else replace(again, behind="with inputs smoothed")


def joined(effects: Iterable[Effect]) -> str:
    """Identifiers of effects that are asked together."""
    return " + ".join(effect.name for effect in effects)


def _smoothed(
    study: Study, before: FilteredSolution, after: FilteredSolution
) -> tuple[Study, FilteredSolution, FilteredSolution] | None:
    """Study and fits with noisy inputs smoothed; None where none is noisy or a fit diverges."""
    calm = study.smoothed
    if calm is None:
        return None
    old, new = (calm.estimate(calm.effects_of(fit), fit.values, fit) for fit in (before, after))
    return None if old is None or new is None else (calm, old, new)


def _bounded(
    study: Study, after: FilteredSolution, effects: Sequence[Effect], found: Claim
) -> Claim:
    """A claim with the bounds at which its effects end."""
    # An optimum at infinity, such as the lag of a sensor that stands still, is no size.
    large = _amplitudes(after, effects, lambda p, value: abs(value) > UNSEEN * p.magnitude)
    if endless := tuple(name for name in large if not _is_shown(after, name)):
        return replace(found, bounds=endless, beyond=np.inf)
    bounds = at_bounds(after, effects)
    return replace(found, bounds=bounds, beyond=_beyond(study, after, bounds)) if bounds else found


def independent_share(study: Study, before: FilteredSolution) -> float:
    """Share of a fit's innovations that count as independent.

    One where process noise is admitted, which models what is correlated, or where the innovations
    are white. Without it what is missing besides stays in them, and every sample would count for
    many (Bartlett 1946; :func:`~oed_sysid.likelihood.information.effective_sample_size`).
    """
    if study.setting.drifting or study.train.only_tests:
        return 1.0
    passes = before.problem.passes(before.point.unknowns, columns=False)
    series = [part.innovations / np.sqrt(part.variances) for part in passes]
    tests = [whiteness(own) for one in series for own in one.T if np.isfinite(own).any()]
    if are_white(tests):
        return 1.0
    effective, counted = np.sum([(one.effective_samples, one.n_samples) for one in tests], axis=0)
    return float(effective / counted)


def _beyond(study: Study, fit: FilteredSolution, bounds: Sequence[str]) -> float:
    """What the training statistic rises by where amplitudes are not held at their bounds."""

    def opened(p: Parameter) -> Parameter:
        lower = -np.inf if p.lower < 0.0 else p.lower
        return replace(p, lower=lower, upper=np.inf) if p.name in bounds else p

    effects = study.effects_of(fit)
    wide = [with_parameters(one, tuple(map(opened, one.parameters))) for one in effects]
    free = study.estimate(wide, fit.values, fit)
    return 0.0 if free is None else max(fit.objective - free.objective, 0.0)


def at_bounds(fit: FilteredSolution, effects: Sequence[Effect]) -> tuple[str, ...]:
    """Amplitudes that end at a bound other than nothing."""
    return _amplitudes(fit, effects, rests)


def _is_shown(fit: FilteredSolution, name: str) -> bool:
    """Whether the training records tell an amplitude that all of them share from nothing."""
    shared = fit.problem.layout.shared_names
    if name not in shared:
        return False
    at = np.array([shared.index(name)])
    return bool(information(fit, at) * fit.point.unknowns[at] ** 2 > CLEARLY**2)


def _amplitudes(
    fit: FilteredSolution, effects: Sequence[Effect], asked: Callable[[Parameter, float], bool]
) -> tuple[str, ...]:
    """Amplitudes of which something holds, in any record."""
    own = set[str]().union(*(effect.amplitude_names for effect in effects))
    free = (one for one in fit.problem.model.free_parameters if one.name in own)
    parts = (fit.values, *fit.local)
    sizes = ((one, [part[one.name] for part in parts if one.name in part]) for one in free)
    return tuple(one.name for one, values in sizes if any(asked(one, value) for value in values))


def rests(parameter: Parameter, value: float) -> bool:
    """Whether a value is at a bound of its parameter other than nothing."""
    bounds = [b for b in (parameter.lower, parameter.upper) if b and np.isfinite(b)]
    return any(abs(value - bound) <= ROUNDING * abs(bound) for bound in bounds)


def difference(before: float, after: float) -> float:
    """Statistic of a model over another, either of which may not run at all."""
    if not np.isfinite(after):
        return -np.inf
    return before - after if np.isfinite(before) else np.inf
