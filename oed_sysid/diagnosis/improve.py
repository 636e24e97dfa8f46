"""The loop: fit, locate, rank, add, refit, until what remains is noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.batch.threads import single_threaded
from oed_sysid.data.dataset import Dataset
from oed_sysid.diagnosis.conclusion import Remains, parameter_table, remains
from oed_sysid.diagnosis.error_table import Yardstick
from oed_sysid.diagnosis.greybox import GreyBox, estimate
from oed_sysid.diagnosis.improvement import Improvement, Step
from oed_sysid.diagnosis.locate import Located, likeliest, locate
from oed_sysid.diagnosis.rank import (
    FALSE_CLAIMS,
    FALSE_CLAIMS_BEFORE_TEST,
    Ranking,
    Refit,
    rank,
    threshold,
)
from oed_sysid.diagnosis.unknown import Unknown, find_unknown
from oed_sysid.diagnosis.workbench import Workbench
from oed_sysid.effects import Effect
from oed_sysid.errors import DataError
from oed_sysid.model import Model
from oed_sysid.noise.kalman import NoiseModel

# A rival must be this much more likely to take an earlier effect's place.
SWAP_MARGIN = 6.0
# Gain in twice the log-likelihood on untouched records that confirms a claim.
CONFIRMED = 2.0


@dataclass(frozen=True, eq=False)
class _State:
    """Where the loop stands: effects in the model, and the fit with them."""

    added: tuple[Effect, ...]
    fit: GreyBox
    bench: Workbench


@single_threaded
def improve(
    model: Model,
    train: Dataset,
    test: Dataset | None = None,
    *,
    candidates: Sequence[Effect],
    known_noise: bool = False,
    max_effects: int = 4,
    progress: Callable[[str], None] | None = None,
) -> Improvement:
    """Find the effects that a model lacks.

    Choices are made on the training records; an effect is claimed only where
    it also makes the untouched records more likely.

    Parameters
    ----------
    model : Model
        What is believed.
    train, test : Dataset
        Records to learn from, and untouched ones to judge by.
    candidates : sequence of Effect
        What may be missing.
    known_noise : bool
        Whether the declared noise levels are right and sensors have no other
        noise; otherwise levels and colour are estimated.
    max_effects : int
        Most effects to add.
    progress : callable, optional
        Told in words what is being done.
    """
    tell = progress or (lambda text: None)
    if not candidates:
        raise DataError(
            "There is no candidate effect. Give problem.effects, or effects of your own."
        )
    tell("fitting the model as it is believed")
    bench, base_fit = Workbench.build(model, train, test, candidates, known_noise=known_noise)
    state = _State((), base_fit, bench)
    first: Ranking | None = None
    steps: list[tuple[Refit, Ranking, float]] = []
    fits: list[GreyBox] = []
    rejected: list[str] = []
    while len(state.added) < max_effects:
        tell(f"ranking candidates, round {len(state.added) + 1}")
        ranking = rank(state.bench.train, state.fit, _left(state), share=_share(state))
        first = first or ranking
        chosen, test_gain, refused = _choose(state, ranking)
        rejected += refused
        if chosen is None:
            break
        tell(f"adding {chosen.name}")
        state = _settle(state, chosen)
        steps.append((chosen, ranking, test_gain))
        fits.append(state.fit)
        if len(state.added) > 1:
            tell("reconsidering the effects added before")
            state, steps, fits = _review(state, steps, fits)
    assert first is not None
    tell("locating where the believed model fails")
    location = locate(bench.train, base_fit, likeliest(first))
    fits = _consistent(state.bench, steps, fits)
    unknown = None
    left = remains(state.bench.train, state.fit)
    if not left.is_noise:
        tell("looking for a term that no known effect holds")
        unknown = find_unknown(state.bench, state.added, [base_fit, *fits])
        if unknown is not None and len(state.added) == max_effects and not unknown.remains.is_noise:
            # The search was cut short: a known effect may yet explain what remains.
            unknown = None
    if unknown is not None:
        left = unknown.remains
    sigma = _sigma(model, state.fit, state.bench.train.units)
    return _result(
        state, model, base_fit, first, location, steps, fits, rejected, sigma, unknown, left
    )


def _left(state: _State) -> list[Effect]:
    present = {effect.name for effect in state.added}
    return [e for e in state.bench.train.super_model.candidates if e.name not in present]


def _share(state: _State) -> float:
    """Share of false claims allowed before untouched records, if any, are asked."""
    return FALSE_CLAIMS if state.bench.test is None else FALSE_CLAIMS_BEFORE_TEST


def _choose(state: _State, ranking: Ranking) -> tuple[Refit | None, float, list[str]]:
    """Best candidate whose gain chance does not explain and the test records confirm."""
    refused: list[str] = []
    before = state.bench.test_objective(state.fit) if state.bench.test else np.nan
    for refit in ranking.refits[:3]:
        if refit.gain < ranking.needed(refit):
            continue
        if state.bench.test is None:
            return refit, np.nan, refused
        gain = before - state.bench.test_objective(refit.fit)
        if gain > CONFIRMED:
            return refit, gain, refused
        refused.append(refit.name)
    return None, np.nan, refused


def _settle(state: _State, chosen: Refit) -> _State:
    """Linearise anew with the effect in the model, and estimate once more."""
    bench, fit = state.bench.settle(chosen.fit)
    return _State((*state.added, chosen.score.effect), fit, bench)


def _review(
    state: _State,
    steps: list[tuple[Refit, Ranking, float]],
    fits: list[GreyBox],
) -> tuple[_State, list[tuple[Refit, Ranking, float]], list[GreyBox]]:
    """Drop or replace earlier effects that the later ones have made doubtful."""
    for position in range(len(state.added) - 1):
        old = state.added[position]
        others = tuple(e for i, e in enumerate(state.added) if i != position)
        names = tuple(n for n in state.fit.names if n not in {p.name for p in old.parameters})
        values = dict(state.fit.values)
        values.update(dict.fromkeys(old.amplitude_names, 0.0))
        noise = _loosened(state.fit.noise, state.bench.train.units)
        without = estimate(state.bench.train, names, values, state.fit.initial, noise)
        if without is None:
            continue
        needed = threshold(len(_left(state)) + 1, len(old.parameters), _share(state))
        if without.objective - state.fit.objective < needed:
            kept = [i for i in range(len(steps)) if i != position]
            bench, settled = state.bench.settle(without)
            state = _State(others, settled, bench)
            return state, [steps[i] for i in kept], [fits[i] for i in kept[:-1]] + [state.fit]
        reduced = _State(others, without, state.bench)
        ranking = rank(
            reduced.bench.train,
            without,
            _left(reduced),
            also=(old.name,),
            n_refits=5,
            share=_share(state),
        )
        present = next((r for r in ranking.refits if r.name == old.name), None)
        best = ranking.refits[0] if ranking.refits else None
        if best is None:
            continue
        chosen = best
        if present is not None and best.evidence < present.evidence + SWAP_MARGIN:
            chosen = present
        if chosen.name != old.name:
            if state.bench.test is not None and state.bench.test_objective(
                chosen.fit
            ) > state.bench.test_objective(state.fit):
                continue
            state = _settle(reduced, chosen)
            steps = [
                *steps[:position],
                *steps[position + 1 :],
                (chosen, ranking, steps[position][2]),
            ]
            fits = [*fits[:position], *fits[position + 1 :], state.fit]
        else:
            steps = [
                (step[0], ranking, step[2]) if i == position else step
                for i, step in enumerate(steps)
            ]
    return state, steps, fits


def _loosened(noise: NoiseModel, units: NoiseModel) -> NoiseModel:
    """Noise model in which an absent disturbance can come back."""
    return replace(noise, force=np.maximum(noise.force, 0.3 * units.force))


def _sigma(model: Model, fit: GreyBox, units: NoiseModel) -> np.ndarray:
    """Noise level of every output: declared, else all sensor noise of the final fit."""
    estimated = np.maximum(np.hypot(fit.noise.white, fit.noise.colour), units.white)
    declared = [output.noise_std for output in model.outputs]
    return np.array(
        [e if d is None else d for d, e in zip(declared, estimated, strict=True)], dtype=float
    )


def _group(ranking: Ranking, added: str) -> tuple[str, ...]:
    names = [refit.name for refit in ranking.group()]
    return tuple(dict.fromkeys((added, *names, *ranking.alike(added))))


def _result(
    state: _State,
    model: Model,
    base_fit: GreyBox,
    first: Ranking,
    location: Located,
    steps: list[tuple[Refit, Ranking, float]],
    fits: list[GreyBox],
    rejected: list[str],
    sigma: np.ndarray,
    unknown: Unknown | None,
    left: Remains,
) -> Improvement:
    bench = state.bench

    done = []
    present: list[Effect] = []
    for (refit, ranking, test_gain), fit in zip(steps, fits, strict=True):
        present.append(refit.score.effect)
        fit = _with_only(bench, present, fit)
        rms = bench.rms(fit)
        error = bench.relative(rms, sigma)
        done.append(
            Step(
                _at_estimates(refit.score.effect, fit),
                _group(ranking, refit.name),
                refit.gain,
                ranking.needed(refit),
                test_gain,
                error["train"],
                error["test"],
                fit,
                rms,
            )
        )
    if unknown is not None:
        bench, state, done = _with_unknown(unknown, state, done, sigma)
    known = set(model.parameter_names)
    base = model.with_values({k: v for k, v in base_fit.values.items() if k in known})
    final = (model + state.added).with_values(
        {
            k: v
            for k, v in state.fit.values.items()
            if k in known or k in {p.name for e in state.added for p in e.parameters}
        }
    )
    base_rms = bench.rms(base_fit)
    base_error = bench.relative(base_rms, sigma)
    return Improvement(
        model=final,
        base=base,
        steps=tuple(done),
        ranking=first,
        base_fit=base_fit,
        base_error=base_error,
        final_error={"train": done[-1].train_error, "test": done[-1].test_error}
        if done
        else base_error,
        location=location,
        remains=left,
        parameters=parameter_table(bench.train, state.fit),
        base_rms=base_rms,
        yardstick=Yardstick.of(bench.train.dataset, sigma),
        rejected=tuple(rejected),
        proposed=() if unknown is None else (unknown.to_dict(),),
    )


def _at_estimates(effect: Effect, fit: GreyBox) -> Effect:
    own = {p.name for p in effect.parameters}
    return effect.with_values({k: v for k, v in fit.values.items() if k in own})


def _consistent(
    bench: Workbench, steps: Sequence[tuple[Refit, Ranking, float]], fits: Sequence[GreyBox]
) -> list[GreyBox]:
    """The fits of all steps, each with the effects of its own and earlier steps only."""
    present = [refit.score.effect for refit, _, _ in steps]
    return [_with_only(bench, present[: i + 1], fit) for i, fit in enumerate(fits)]


def _with_only(bench: Workbench, present: Sequence[Effect], fit: GreyBox) -> GreyBox:
    """The fit of a step, made again where it held an effect that was dropped later."""
    names = [*bench.train.super_model.base.free_names]
    for effect in present:
        names += [p.name for p in effect.parameters if not p.fixed]
    if set(names) == set(fit.names):
        return fit
    absent = [e for e in bench.train.super_model.candidates if e not in present]
    values = dict(fit.values) | dict.fromkeys((n for e in absent for n in e.amplitude_names), 0.0)
    for effect in present:  # an amplitude that was absent starts from its typical size
        values = {p.name: p.value for p in effect.parameters} | values
    again = estimate(bench.train, names, values, fit.initial, fit.noise)
    return fit if again is None else again


def _with_unknown(
    unknown: Unknown, state: _State, done: list[Step], sigma: np.ndarray
) -> tuple[Workbench, _State, list[Step]]:
    """The state with a proposed term in it, and the steps that led there."""
    rms = unknown.bench.rms(unknown.fit)
    error = unknown.bench.relative(rms, sigma)
    kept = [step for step in done if step.added not in unknown.replaces]
    last = Step(
        _at_estimates(unknown.effect, unknown.fit),
        (unknown.effect.name,),
        unknown.gain + sum(step.evidence for step in done if step not in kept),
        unknown.proposals.needed,
        unknown.test_gain,
        error["train"],
        error["test"],
        unknown.fit,
        rms,
    )
    joined = _State((*unknown.kept, unknown.effect), unknown.fit, unknown.bench)
    return unknown.bench, joined, [*kept, last]
