"""One case of the benchmark: improve the nominal model, and compare with the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np

from benchmarks.harness import Row
from benchmarks.missing_physics.cases import DATA, UNKNOWN_TERMS, Draw
from benchmarks.missing_physics.simulator import TEST, TRAIN, Case, Records
from benchmarks.rates import detectable, judged
from oed_sysid import Dataset, Force, Parameter, Problem, Record, load_problem
from oed_sysid.evidence.chance import threshold
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.physics import Effect


def true_structure(
    problem: Problem, train: Dataset, test: Dataset, case: Case, found: Improvement | None
) -> Row:
    """Fit the true structure, from the nominal model's fit and from the truth: what could be known.

    Returns
    -------
    dict
        The likelihood-ratio statistic of each hidden effect with all others in the model, whether
        every one has what a claim needs, and the error of the true structure on the test records,
        in units of the noise.
    """
    effects = [_effect(problem, name) for name in case.effects]
    if not effects:  # the nominal structure is the true one
        error = np.nan if found is None else found.base_error["test"]
        return {"true_gains": {}, "detectable": True, "true_test_error": error}
    unknown = any(name in UNKNOWN_TERMS for name in case.effects)
    candidates = effects if unknown else [*problem.effects]
    study, base = Study.begin(problem.model, train, test, candidates, known_noise=False)
    fits = _fits(study, base, effects, case)
    freedom = max(len(e.amplitude_names) + len(e.shape_names) for e in effects)
    gains = {name: fits.get(name, base).objective - fits[""].objective for name in case.effects}
    needed = threshold(len({effect.name for effect in (*problem.effects, *effects)}), freedom)
    # Records are whole, so that every output counts alike.
    errors = study.rms(fits[""], test) / [output.noise_std for output in problem.model.outputs]
    return {
        "true_gains": gains,
        "detectable": detectable(gains.values(), needed),
        "true_test_error": float(np.sqrt(np.mean(errors**2))),
    }


def _fits(
    study: Study, base: FilteredSolution, effects: Sequence[Effect], case: Case
) -> dict[str, FilteredSolution]:
    """Most likely fits of the true structure, whole and without each of several effects.

    Each from the nominal fit, with true sizes, and from the truth.
    """
    start = dict(base.values)
    for effect in effects:
        start |= _true_values(effect, case)
    noise, found = study.loosened(base.noise), {}
    for left_out in ("", *(case.effects if len(effects) > 1 else ())):
        kept = [effect for effect in effects if effect.name != left_out]
        tried = (
            study.estimate(kept, values, base, noise=noise, max_iterations=25)
            for values in (dict(base.values), start, start | dict(case.derivatives))
        )
        fits = [fit for fit in tried if fit is not None]
        found[left_out] = study.settle(min(fits, key=lambda fit: fit.objective))
    return found


def _effect(problem: Problem, name: str) -> Effect:
    if name in UNKNOWN_TERMS:
        unknown = DATA["unknown"][name]
        size = Parameter(f"E_{name}", 0.0, "1", scale=1.0)
        return Force(
            name,
            {unknown["axis"]: f"{size.name}*{unknown['term']}"},
            (size,),
            amplitudes=(size.name,),
        )
    return problem.effect(name)


def _true_values(effect: Effect, case: Case) -> dict[str, float]:
    size = case.effects[effect.name]
    if effect.name == "wave_heave_force":
        cosine, sine = effect.amplitude_names
        phase = case.wave_phase
        return {
            cosine: size * math.cos(phase),
            sine: -size * math.sin(phase),
            effect.shape_names[0]: case.wave_frequency,
        }
    if effect.name == "fin_rate_limit":
        size = 1.0 / size
    return {effect.amplitude_names[0]: size}


@lru_cache(maxsize=1)
def nominal() -> Problem:
    """The problem whose model lacks what is hidden."""
    return load_problem("remus_diving_plane")


def datasets(problem: Problem, records: Sequence[Records]) -> tuple[Dataset, Dataset]:
    """Training and test records of one simulated case."""
    found = tuple(
        Record(manoeuvre.name, part.times, part.inputs, part.outputs, problem.channels)
        for manoeuvre, part in zip((*TRAIN, *TEST), records, strict=True)
    )
    return Dataset(found[: len(TRAIN)]), Dataset(found[len(TRAIN) :])


def judge(draw: Draw, case: Case, records: Sequence[Records]) -> Row:
    """Improve the nominal model on one case, and compare with the truth."""
    problem, data = nominal(), datasets(nominal(), records)
    entry: Row = {
        "key": draw.key,
        "hidden": draw.hidden,
        "condition": draw.condition,
        "effects": dict(case.effects),
    }
    truth = partial(true_structure, problem, *data, case)
    return judged(entry, problem.model, data, problem.effects, truth)
