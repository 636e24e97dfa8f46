"""Chen, Deng and Xu (2023): an unmanned sailboat, by Bayesian regression."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.documents.page import Numbers, paper
from oed_sysid.baselines import EquationError, GibbsRegression
from oed_sysid.likelihood.estimate import Posterior
from oed_sysid.likelihood.fit import Fit

SEEDS = 20  # realisations for the coverage
FEWER = 8  # and for the speeds and the weak terms
LEVELS = (0.02, 0.1, 0.3)
STARTS = 3  # realisations of multiple shooting from afar
KINDS = ("exact", "simpson", "local", "shooting")  # data and method, in the paper's order
DRAWS = {"coordinate": 3000, "joint": 2000}  # draws kept of each of four chains


def drawn(fit: Fit) -> Posterior:
    """The draws of a sampler, which it has."""
    assert fit.posterior is not None
    return fit.posterior


def derivatives() -> Numbers:
    """Terms, errors in per cent, convergence of both draws, and shooting from afar."""
    script = paper("sailboat")
    free = script.problem.model.free_names
    all_errors = [errors(gibbs(0.02, seed, n_draws=1000)) for seed in range(FEWER)]
    chains = {draw: gibbs(0.1, 0, draw=draw, n_draws=n) for draw, n in DRAWS.items()}
    closed = EquationError(rule="exact", rates=script.noisy_rates(0), coloured="never").fit(
        script.problem.model, script.clean
    )
    began = time.process_time()
    shot = [script.from_afar(seed) for seed in range(STARTS)]
    seconds = (time.process_time() - began) / STARTS
    return {
        "terms": [sum(name.startswith(f"{axis}_") for name in free) for axis in "XYNK"],
        "exact": max(errors(exact()).values()) / 100,
        "dominant": [max(found[name] for name in script.DOMINANT) for found in all_errors],
        "weak": [max(found.values()) for found in all_errors],
        "seeds": FEWER,
        "chains": {
            draw: {
                "draws": DRAWS[draw],
                "r_hat": max(drawn(fit).r_hat.values()),
                "worth": min(drawn(fit).effective_draws.values()),
                "code": fit.status.code,
            }
            for draw, fit in chains.items()
        },
        "apart": script.apart(chains["joint"], closed),
        "shooting": {
            "seconds": seconds,
            "runs": STARTS,
            "held": 100 * float(np.mean([script.held(fit) for fit in shot])),
            "away": max(in_errors(fit) for fit in shot),
        },
    }


def gibbs(level: float, seed: int, *, draw: str = "joint", n_draws: int = 400) -> Fit:
    """Gibbs sampling on exact accelerations with white noise."""
    script = paper("sailboat")
    method = GibbsRegression(
        rule="exact", rates=script.noisy_rates(seed, level), draw=draw, n_draws=n_draws
    )
    return method.fit(script.problem.model, script.clean)


def exact() -> Fit:
    """Least squares on exact accelerations."""
    script = paper("sailboat")
    return EquationError(rule="exact", rates=script.exact).fit(script.problem.model, script.clean)


def errors(fit: Fit) -> dict[str, float]:
    """Errors of all derivatives, per cent."""
    truth = paper("sailboat").problem.truth
    return {name: 100 * abs(value / truth[name] - 1) for name, value in fit.values.items()}


def in_errors(fit: Fit) -> float:
    """Largest error in standard errors."""
    truth = paper("sailboat").problem.truth
    return max(abs(fit.values[n] - truth[n]) / fit.std_errors[n] for n in fit.names)


def coverage() -> Numbers:
    """Share of 95 % intervals that hold the truth, per cent."""
    rows = [held(seed) for seed in range(SEEDS)]
    return {
        "seeds": SEEDS,
        "rows": rows,
        "mean": {kind: float(np.mean([row[kind] for row in rows])) for kind in KINDS},
    }


def held(seed: int) -> dict[str, float]:
    """Share of the 38 intervals that hold the truth in one realisation, per cent."""
    found = paper("sailboat").covered(seed).values()
    return {kind: 100 * float(np.mean(one)) for kind, one in zip(KINDS, found, strict=True)}


def speed() -> Numbers:
    """Forces and polar from accelerations with 10 % noise, and speeds by noise, per cent."""
    script = paper("sailboat")
    fit = gibbs(script.NOISE, 0, n_draws=2000)
    truth, polar = script.polars(fit)
    low, high = polar.interval()
    inside = (low <= truth.speeds) & (truth.speeds <= high)
    return {
        "forces": script.resultant_errors(fit.model),
        "angles": len(truth.speeds),
        "inside": int(inside.sum()),
        "mean": 100 * float(np.abs(polar.speeds / truth.speeds - 1).max()),
        "seeds": FEWER,
        "levels": [100 * level for level in LEVELS],
        "errors": [max(script.speed_error(lv, seed) for seed in range(FEWER)) for lv in LEVELS],
    }
