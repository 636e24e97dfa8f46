"""One case of the benchmark: improve the nominal model, and compare with the truth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.missing_physics.cases import Draw
from benchmarks.missing_physics.simulator import TEST, TRAIN, Case, Records
from benchmarks.missing_physics.truth import true_structure
from oed_sysid import Dataset, Problem, Record, load_problem
from oed_sysid.evidence.improve import improve
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.physics import Effect


@lru_cache(maxsize=1)
def _problem() -> Problem:
    return load_problem("remus_diving_plane")


def datasets(problem: Problem, records: Sequence[Records]) -> tuple[Dataset, Dataset]:
    """Training and test records of one simulated case."""
    found = {
        manoeuvre.name: Record(
            manoeuvre.name, part.times, part.inputs, part.outputs, problem.channels
        )
        for manoeuvre, part in zip((*TRAIN, *TEST), records, strict=True)
    }
    return (
        Dataset([found[m.name] for m in TRAIN]),
        Dataset([found[m.name] for m in TEST]),
    )


def judge(draw: Draw, case: Case, records: Sequence[Records]) -> dict[str, Any]:
    """Improve the nominal model on one case, and compare with the truth."""
    problem = _problem()
    train, test = datasets(problem, records)
    entry: dict[str, Any] = {
        "key": draw.key,
        "hidden": draw.hidden,
        "condition": draw.condition,
        "effects": dict(case.effects),
    }
    began, processor = time.perf_counter(), time.process_time()
    try:
        found = improve(problem.model, train, test, candidates=problem.effects)
        entry |= {
            "seconds": time.perf_counter() - began,
            "processor_seconds": time.process_time() - processor,
        }
        entry |= _found(found)
        truth = true_structure(problem, train, test, case, found)
    except Exception as error:  # a case that breaks is a result too
        return entry | {"error": f"{type(error).__name__}: {error}"}
    return entry | {
        "true_gain": truth.gain,
        "true_gains": dict(truth.gains),
        "needed": truth.needed,
        "detectable": truth.detectable,
        "true_train_error": truth.train_error,
        "true_test_error": truth.test_error,
    }


def _found(found: Improvement) -> dict[str, Any]:
    plain = found.to_dict()
    gains = {refit.name: round(refit.gain, 2) for refit in found.ranking.refits}
    return {
        "verdict": found.verdict,
        "steps": [
            {
                "added": step.added,
                "equation": _equation(step.effect),
                "group": list(step.group),
                "evidence": step.evidence,
                "needed": step.needed,
                "test_gain": step.test_gain,
            }
            for step in found.steps
        ],
        "order": list(found.ranking.order[:8]),
        "gains": gains,
        "rejected": list(found.rejected),
        "remainder": float(np.nan_to_num(found.remainder, posinf=1e9)),
        "proposed": [dict(term) for term in found.proposed],
        "base_error": plain["base_error"],
        "final_error": plain["final_error"],
    }


def _equation(effect: Effect) -> str:
    """Axis on which a force acts, else the stage of the effect."""
    return "+".join(map(str, effect.terms)) if effect.stage == "force" else effect.stage
