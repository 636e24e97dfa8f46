"""The answer of each command in one line: what a reader asked, before what it rests on."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oed_sysid.baselines.benchmark import Benchmark
    from oed_sysid.design.decision import Decision
    from oed_sysid.design.result import Design, Programme
    from oed_sysid.evidence.compare import Comparison, Diagnosis
    from oed_sysid.evidence.improvement import Improvement
    from oed_sysid.information import SensitivityRanking, Subset
    from oed_sysid.likelihood.fit import Fit

# Multiple of the noise up to which residuals say no more than noise would.
NOISE = 1.2
# And from which they are no measure: filtered logs have next to no noise.
SMOOTHED = 100.0
# Standard errors in half of a 95 % interval.
HALF_WIDTH = 1.96
# Probability from which an effect is said to show.
SURE = 0.9


def of_fit(fit: Fit, comparison: Comparison | None = None) -> str:
    """Say whether a fit can be used, how certain it is, and how well it fits and predicts."""
    n = len(fit.names)
    known = f"{n} parameters" if n != 1 else "1 parameter"
    if not fit.status.ok:
        return f"Not usable: the fit of {fit.model.name} ended as {fit.status.code}."
    if fit.grave:
        return f"Not usable: {fit.grave[0].text}"
    errors = {
        name: HALF_WIDTH * fit.std_errors[name] / abs(value) if value else math.inf
        for name, value in fit.values.items()
    }
    words = f"{fit.model.name}: {known} estimated"
    if errors:
        worst = max(errors, key=lambda name: errors[name])
        words += f", the least certain {worst} ± {share(errors[worst])} (95 %)"
    size = fit.normalised_rms
    words += f"; residuals are {size:.3g} × noise"
    if size > SMOOTHED:
        words += (
            ": the model is far off, or the log was smoothed and shows no noise; read errors in"
        )
        words += " units"
    elif not size < NOISE:
        words += ", so the model lacks something"
    if comparison is not None:
        words += f"; errors on the validation records {comparison.best.relative:.3g} × noise"
    return f"{words}."


def of_comparison(comparison: Comparison) -> str:
    """Say which model predicts best, and whether what is left is noise."""
    best = comparison.best
    left = "noise is left" if best.is_noise else "more than noise is left"
    if len(comparison.models) == 1:
        return f"{best.label} predicts to {best.relative:.3g} × noise: {left}."
    return (
        f"{best.label} predicts best, to {best.relative:.3g} × noise: {left}; the others to "
        + ", ".join(f"{m.relative:.3g} ({m.label})" for m in comparison.models if m is not best)
        + "."
    )


def of_diagnosis(diagnosis: Diagnosis) -> str:
    """Say which effect is missing."""
    group = diagnosis.group
    if not group:
        return f"{diagnosis.model.name}: no candidate explains more than chance does."
    others = f"; these records cannot tell it from {', '.join(group[1:])}" if group[1:] else ""
    return f"{diagnosis.model.name} lacks {group[0]}{others}."


def of_improvement(result: Improvement) -> str:
    """Say what is missing, and what it is worth on the validation records."""
    before, after = result.base_error, result.final_error
    kind = "train" if math.isnan(before["test"]) else "test"
    on = {"train": "training", "test": "validation"}[kind]
    if result.remains.kind == "log suspect":
        return f"Log suspect: nothing about {result.base.name} can be claimed from it."
    if result.verdict == "unexplained":
        return (
            f"{result.base.name} misses more than noise, and no candidate is confirmed: error on "
            f"the {on} records {before[kind]:.3g} × noise."
        )
    if not result.steps:
        return (
            f"Nothing is missing from {result.base.name} that these records could show: error on "
            f"the {on} records {before[kind]:.3g} × noise."
        )
    names = " and ".join(step.added for step in result.steps)
    goes = "falls" if after[kind] < before[kind] else "does not fall: it goes"
    return (
        f"{result.base.name} lacks {names}: with it the error on the {on} records {goes} from "
        f"{before[kind]:.3g} to {after[kind]:.3g} × noise; {result.remains.kind}."
    )


def of_ranking(ranking: SensitivityRanking, subset: Subset) -> str:
    """Say how many parameters can be estimated, and which not."""
    n, of = len(subset.names), len(subset.order)
    fixed = f"; fix {', '.join(subset.left_out)}" if subset.left_out else ""
    runs = ", ".join(ranking.runs)
    return f"{n} of {of} parameters can be estimated together from {runs}{fixed}."


def of_design(design: Design) -> str:
    """Say what the run will tell, and whether it keeps its limits."""
    errors = HALF_WIDTH * design.relative_errors
    words = f"{design.experiment.name}: "
    found = design.assurance
    if found is not None and not found.is_safe:
        words = f"DANGER: {words}"
    worst = int(errors.argmax())
    words += f"after {design.experiment.duration:g} s the least certain of {len(errors)} parameters"
    words += f" is {design.names[worst]}, ± {share(errors[worst])} (95 %)"
    if design.references:
        reference = design.references[0]
        gain = design.gain(reference)[0]
        words += (
            f"; {reference.name} would leave {gain:.3g} × larger errors"
            if math.isfinite(gain)
            else f"; {reference.name} alone would not determine all of them"
        )
    if found is not None and found.limited:
        words += f"; limits kept on {found.probability:.0%} of possible vehicles"
    return f"{words}."


def of_programme(programme: Programme) -> str:
    """Say how many runs and hours, what they buy, and whether they keep their limits."""
    kept = {n: one.probability for n, one in programme.assurances.items() if one.limited}
    n_runs = len(programme.runs)
    words = f"{n_runs} run{'s' if n_runs != 1 else ''}, {programme.hours:.3g} h"
    if programme.unsafe:
        worst = min(programme.unsafe, key=lambda name: kept[name])
        words = (
            f"DANGER: {worst!r} leaves its limits on {1 - kept[worst]:.0%} of possible vehicles; "
            + words
        )
    elif programme.is_unsafe_together:
        words = (
            f"DANGER: on {1 - programme.kept:.0%} of possible vehicles one run or another leaves "
            f"its limits; {words}"
        )
    words += f": {_bought(programme)}"
    if programme.standard is not None:
        ratio = programme.standard.ratio
        words += (
            f"; standard trials would need {ratio:.2g} × the ship time"
            if math.isfinite(ratio)
            else "; standard trials would never tell as much"
        )
    if not kept:
        words += "; no limit on the motion was given"
    elif not programme.unsafe:
        together = "all runs keep" if len(kept) > 1 else "the run keeps"
        words += f"; {together} the limits on {programme.kept:.0%} of possible vehicles"
    return f"{words}."


def _bought(programme: Programme) -> str:
    """What a programme was asked for, and how much of it is reached."""
    from oed_sysid.design.assurance import TRUSTED
    from oed_sysid.design.missing_effects import told_apart

    if programme.misfits:
        (first, second), least = min(programme.misfits.items(), key=lambda one: one[1])
        return f"{first} and {second} are told apart with a probability of {told_apart(least):.0%}"
    if programme.chances:
        before, after = (
            sum(value >= SURE for value in values)
            for values in zip(*((one.before, one.after) for one in programme.chances), strict=True)
        )
        n = len(programme.chances)
        return f"{after} of {n} effects would show, should they be missing (before: {before})"
    errors = programme.relative_errors
    worst = int(errors.argmax())
    words = f"the least certain of {len(errors)} parameters is {programme.names[worst]}, "
    if programme.sea is not None and not errors[worst] <= TRUSTED:
        return words + "which stays unidentified"
    words += f"± {share(HALF_WIDTH * errors[worst])} (95 %)"
    if programme.prior is not None:
        before = programme.prior.std_errors[worst] / programme.sizes[worst]
        words += f", ± {share(HALF_WIDTH * before)} before" if math.isfinite(before) else ""
    return words


def of_decision(decision: Decision, n_runs: int, hours: float) -> str:
    """Say whether to stop, or what to run next, what it buys, and whether it is safe.

    Parameters
    ----------
    decision : Decision
    n_runs, hours : int, float
        Done so far.
    """
    done = f" after {n_runs} run{'s' if n_runs != 1 else ''}, {hours:.2g} h" if n_runs else ""
    met = sum(one.is_met for one in decision.goals)
    run = decision.next_run
    if run is None:
        reason = {
            "enough": "everything asked for is known well enough",
            "contradicted": "on paper everything is known, but the records contradict it, so that "
            "its errors do not hold; look for what the model lacks (improve)",
            "unchecked": "on paper everything is known, but one run alone has said so, and no "
            "other that keeps its limits could check it",
            "useless": "no run that keeps its limits brings what is missing nearer",
            "no time": "not even the next run fits into the time that is left",
        }[decision.action]
        rest = "" if met == len(decision.goals) else f" ({met} of {len(decision.goals)} goals met)"
        return f"STOP{done}: {reason}{rest}."
    words = f"GO ON{done}: {run.name} next ({run.cost / 3600:.2g} h)"
    if decision.contradiction is not None:
        words = (
            "WARNING: the records contradict one another, so that the errors do not hold; look for "
            f"what the model lacks (improve) first; {words}"
        )
    if decision.is_check:
        words += " checks what one run alone has said"
    else:
        far = max(
            (one for one in decision.goals if not one.is_met),
            key=lambda one: one.now / one.goal.tolerance,
        )
        now, then = (far.goal.words(decision.model, value) for value in (far.now, far.then))
        words += f" brings {far.goal.name} from {now} to {then}"
    if math.isfinite(decision.hours_left):
        n = decision.runs_left
        words += f"; {n} run{'s' if n != 1 else ''}, {decision.hours_left:.2g} h to go"
    else:
        words += "; not all goals can be planned for"
    if decision.kept is not None:
        words += f"; limits kept on {decision.kept:.0%} of {decision.n_checked} possible vehicles"
    elif run.experiment.limits.signals:
        words += "; whether other vehicles keep the limits is not known"
    else:
        words += "; no limit on the motion was given"
    return f"{words}."


def share(value: float) -> str:
    """Write a share in per cent."""
    return f"{100 * value:.2g} %" if value < 10 else "more than 1000 %"


def of_benchmark(result: Benchmark) -> str:
    """Say who has the smallest errors, in how many settings."""
    settings: dict[object, str] = {}
    for row in result.rows:  # best first in each setting
        if not row.refused:
            settings.setdefault(row.setting, row.estimator)
    wins = Counter(settings.values()).most_common(3)
    return (
        "Smallest errors of the parameters that the data determine: "
        + ", ".join(f"{name} in {n} of {len(settings)} settings" for name, n in wins)
        + "."
    )


def of_rates(n_cases: int, rates: Sequence[Mapping[str, Any]]) -> str:
    """Say the first two rates of a benchmark of hidden effects."""
    named = "; ".join(f"{one['name']} {one['value']:.3g} of {one['count']}" for one in rates[:2])
    return f"{n_cases} cases: {named}."
