"""Chen, Yan and Wang (2011): a torpedo-like body, by a differential swarm."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from benchmarks.documents.page import Numbers, paper
from oed_sysid.likelihood.fit import Fit

LEVEL = 3.0  # per cent of noise, as published
SEEDS = 6  # at 500 samples per second


def allowed() -> Numbers:
    """Standard errors that the record allows at 1 % noise, per cent; shooting without noise."""
    script = paper("torpedo")
    body = script.bound_known_start(script.problem.variant("body_axes").model)
    fit, seconds = timed(script.shooting, 0.0, 0)
    unknown, known = script.bound(), script.bound_known_start(script.problem.model)
    return {
        "free": len(unknown),
        "masses": sum(name.startswith("lambda") for name in unknown),
        "unknown": unknown,
        "known": known,
        "at_level": {name: LEVEL * one for name, one in known.items()},
        # Where only rounding informs there is no bound at all: the worst of those that there are.
        "body_worst": float(np.nanmax(list(body.values()))),
        "shooting": {"error": max(script.errors(fit).values()) / 100, "seconds": seconds},
    }


def swarm() -> Numbers:
    """The published search: errors in per cent, misfits in units of 1 % noise, and its time."""
    script = paper("torpedo")
    rows = []
    for level, seed in script.RUNS:
        fit, seconds = timed(script.swarm_fit, level, seed)
        record = script.data(level, seed)[0]
        rows.append(
            {
                "level": level,
                "seed": seed,
                "errors": script.errors(fit),
                "misfit": script.misfit(fit.values, record),
                "truth": script.misfit(script.problem.truth, record),
                "seconds": seconds,
            }
        )
    noisy = [row for row in rows if row["level"] == LEVEL]
    apart = [row["misfit"] / row["truth"] for row in rows if row["level"]]
    return {
        "rows": rows,
        "generations": script.N_GENERATIONS,
        "clean": max(max(row["errors"].values()) for row in rows if not row["level"]),
        "misfits": apart,
        "worst": [max(row["errors"].values()) for row in noisy],
        "names": [max(row["errors"], key=row["errors"].__getitem__) for row in noisy],
        "seeds": [row["seed"] for row in noisy],
        "seconds": [row["seconds"] for row in rows],
    }


def fast() -> Numbers:
    """At 500 samples per second: the bound at 3 % noise, and the largest error by seed."""
    script = paper("torpedo")
    name = "pitching_500_hz"
    bound = {one: LEVEL * share for one, share in script.bound(name).items()}
    fits = [script.shooting(LEVEL, seed, name) for seed in range(SEEDS)]
    return {
        "bound": bound,
        "worst": max(bound, key=bound.__getitem__),
        "largest": [max(script.errors(fit).values()) for fit in fits],
    }


def timed(work: Callable[[float, int], Fit], level: float, seed: int) -> tuple[Fit, float]:
    """A fit at this noise, per cent, and its processor time, s."""
    began = time.process_time()
    return work(level, seed), time.process_time() - began
