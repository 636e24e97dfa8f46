r"""Realised over stated errors of planned runs under disturbance forces.

    OMP_NUM_THREADS=1 python -m benchmarks.realised [--repetitions 20] [--forces 1.0]
                                                    [--plans designed] [--swell 8]

The REMUS-like vehicle plays *plan* again and again under forces of medium size (times ``--forces``)
and 2 s, or in a swell of these levels with ``--swell``, the peak period of its JONSWAP spectrum.
Each repetition is integrated by `benchmarks.missing_physics` (no code of the package) and estimated
by ``MultipleShooting(disturbances="auto")``, or with a ``Sea()`` of which nothing else is declared
where the plan was made for a swell; no priors. Stated are the errors of ``information_of`` before
the trial, for these forces and for white noise alone. With ``n`` repetitions a ratio has a standard
error of about :math:`1/\sqrt{2n}`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from benchmarks.harness import (
    RESULTS,
    TWO_SIDED_95,
    Row,
    Store,
    grouped,
    ignorant,
    known,
    markdown,
    study,
)
from benchmarks.missing_physics.simulator import SAMPLE, Case, Truth, integrate
from benchmarks.random_forces.scenarios import MEDIUM, REMUS
from benchmarks.random_forces.simulator import swell as waves_of_swell
from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Experiment, Limits, Model, MultipleShooting, Record, load_problem
from oed_sysid.design import DOptimal, Knowledge, Levels, Search, Trial, design_experiment
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information import information_of
from oed_sysid.likelihood.noise_model import NoiseModel, Sea

TIME = 2.0
PLANS = ("zigzags", "designed")
JONSWAP_WIDTH = 0.2  # of the spectrum at half its power
STORE = Store(RESULTS / "realised.jsonl")
# Realised over stated errors that count as true.
TRUE = (0.8, 1.25)


def believed() -> Model:
    """The vehicle without priors, at the values that the simulator has."""
    return ignorant(load_problem("remus_diving_plane").model).with_values(REMUS.believed)


def sea(model: Model, factor: float, swell: float = 0.0) -> NoiseModel:
    """Noise of the sensors, and disturbance forces: first-order ones, or a swell of this period."""
    white = np.array(REMUS.noise_std)
    if swell:
        levels = dict(zip(REMUS.forces, factor * np.array(MEDIUM), strict=True))
        waves = Sea(period=swell, bandwidth=JONSWAP_WIDTH, levels=levels)
        return replace(NoiseModel.white_only(white, model.output_names), seas=(waves,))
    return NoiseModel(
        white, np.zeros_like(white), factor * np.array(MEDIUM), force_time=TIME,
        outputs=model.output_names, places=tuple(f"force {axis}" for axis in REMUS.forces),
    )  # fmt: skip


def trial(limits: Limits, duration: float) -> Trial:
    """A run from 25 m that begins and is driven as the zigzags of the problem."""
    pattern = load_problem("remus_diving_plane").experiment("zigzag_10_10")
    start = {**pattern.initial, "z": 25.0}
    return Trial(
        limits=limits, duration=duration, sample_time=0.1, constants=pattern.constants,
        initial=start,
    )  # fmt: skip


def plan(model: Model, name: str, noise: NoiseModel) -> list[Experiment]:
    """Runs as open-loop commands at 0.1 s."""
    problem = load_problem("remus_diving_plane")
    if name == "zigzags":
        chosen = [problem.experiment(n) for n in ("zigzag_5_5", "zigzag_10_10", "zigzag_15_12")]
        return [replace(one, duration=60.0, feedback="true") for one in chosen]
    largest = math.radians(20.0)
    limits = replace(problem.limits, inputs={"fin_command": (-largest, largest)})
    found = design_experiment(
        model,
        trial(limits, 62.0),
        rng=np.random.default_rng(1),
        criterion=DOptimal(),
        search=Search(family=Levels(20), n_starts=2, n_candidates=30, n_steps=10, n_workers=1),
        knowledge=Knowledge(noise=noise),
    )
    return [found.experiment]


def drawn(noise: NoiseModel, n: int, rng: np.random.Generator) -> np.ndarray:
    """Forces at ``n`` samples, ``(n, 3)``; those of a swell are sums of waves of random phase."""
    for one in noise.seas:
        return waves_of_swell(rng, n, SAMPLE / float(one.period or 0.0), 3) * one.level
    return gauss_markov(rng.standard_normal((n, 3)), math.exp(-SAMPLE / TIME)) * noise.force


def repeated(
    model: Model, run: Experiment, noise: NoiseModel, rng: np.random.Generator, number: int
) -> Record:
    """One run with forces and sensor noise, integrated in NumPy at 0.01 s."""
    nominal = simulate(model, run, noise=False)
    commands = nominal.inputs[:, :, None]
    forces = drawn(noise, nominal.n_samples, rng)
    truth = Truth([Case(run.name, REMUS.believed)])
    start = np.array([run.initial["u"]]), np.array([run.initial.get("z", 0.0)])
    states = integrate(truth, start, forces[:, :, None], lambda k, _: tuple(commands[k]))
    clean = np.array([truth.measure(state)[:, 0] for k, state in states if k is not None])
    outputs = clean + rng.standard_normal(clean.shape) * noise.white
    return Record(f"{run.name}_{number}", nominal.times, nominal.inputs, outputs, model.channels)


def repetition(
    key: str, model: Model, runs: Sequence[Experiment], noise: NoiseModel, facts: dict[str, Any]
) -> Row:
    """One fit: its errors beside those stated."""
    rng = np.random.default_rng([facts["seed"], facts["number"]])
    data = Dataset(repeated(model, run, noise, rng, facts["number"]) for run in runs)
    # Of a swell that was planned for is known that it acts, as `campaign` knows it.
    fit = MultipleShooting(disturbances=Sea() if noise.seas else "auto").fit(model, data)
    truth = np.array([model.values[name] for name in model.free_names])
    errors = dict(zip(model.free_names, (fit.estimates - truth).tolist(), strict=True))
    stated = np.array([fit.std_errors[name] for name in model.free_names])
    inside = np.abs(fit.estimates - truth) < TWO_SIDED_95 * stated
    return {
        "key": key, **facts, "converged": fit.status.ok, "errors": errors,
        "inside": inside.tolist(),
    }  # fmt: skip


def cases(
    name: str, factor: float, swell: float, seed: int, repetitions: int
) -> dict[str, partial[Row]]:
    """Repetitions of one plan by the name of each."""
    model = believed()
    noise = sea(model, factor, swell)
    runs = plan(model, name, noise)
    stated, white = (
        information_of(model, runs, noise=one, priors=None).std_errors.tolist()
        for one in (noise, noise.white)
    )
    facts = {"plan": name, "forces": factor, "swell": swell, "seed": seed}
    found = {}
    for number in range(repetitions):
        key = f"{name} x{factor:g} swell {swell:g} seed {seed} {number}"
        own = {**facts, "number": number, "stated": stated, "white": white}
        found[key] = partial(repetition, key, model, runs, noise, own)
    return found


def ratios(rows: Sequence[Row]) -> np.ndarray:
    """Realised over stated errors of each parameter, ``(n_parameters,)``."""
    errors = np.array([list(row["errors"].values()) for row in rows])
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)) / rows[0]["stated"])


def table(rows: Sequence[Row]) -> list[str]:
    """Lines on one plan: a table of its parameters, and how many ratios are true."""
    sizes, ratio = np.abs([believed().values[name] for name in rows[0]["errors"]]), ratios(rows)
    stated, white = np.array(rows[0]["stated"]), np.array(rows[0]["white"])
    shares = zip(stated / sizes, ratio * stated / sizes, ratio, ratio * stated / white, strict=True)
    lines = [
        (parameter, f"{a:.2%}", f"{b:.2%}", f"{c:.2f}", f"{d:.2f}")
        for parameter, (a, b, c, d) in zip(rows[0]["errors"], shares, strict=True)
    ]
    near = int(np.sum((ratio >= TRUE[0]) & (ratio <= TRUE[1])))
    inside = np.mean([row["inside"] for row in rows])
    kind = f"swell of {rows[0]['swell']:g} s" if rows[0]["swell"] else "first-order forces"
    return [
        f"{rows[0]['plan']}, {kind} x {rows[0]['forces']:g}: {len(rows)} repetitions, "
        f"{sum(row['converged'] for row in rows)} converged; {near} of {len(ratio)} ratios from "
        f"{TRUE[0]:g} to {TRUE[1]:g}; 95 % intervals hold {inside:.0%}",
        "",
        *markdown(("parameter", "stated", "realised", "ratio", "to white"), lines),
        "",
    ]


def wanted(
    *,
    repetitions: int = 20,
    forces: Sequence[float] = (1.0,),
    plans: Sequence[str] = ("designed",),
    swell: float = 0.0,
    seed: int = 0,
) -> dict[str, partial[Row]]:
    """Repetitions of some plans under some forces, by name.

    Parameters
    ----------
    repetitions : int
        of every plan
    forces : sequence of float
        times the medium ones
    plans : sequence of str
        zigzags, designed
    swell : float
        peak period of a swell, s; 0 for first-order forces
    seed : int
        of forces and noise
    """
    found: dict[str, partial[Row]] = {}
    for factor, name in product(forces, plans):
        found |= cases(known(name, PLANS, "plan"), factor, swell, seed, repetitions)
    return found


def tables(rows: Sequence[Row]) -> str:
    """Every plan under every kind of forces."""
    kinds = grouped(rows, lambda row: (row["plan"], row["forces"], row["swell"]))
    return "\n".join(line for group in kinds.values() for line in table(group))


if __name__ == "__main__":
    study(wanted, tables, STORE, tell=lambda row: row["key"])
