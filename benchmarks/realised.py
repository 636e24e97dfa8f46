r"""Realised over stated errors of planned runs under disturbance forces.

    OMP_NUM_THREADS=1 python -m benchmarks.realised [--repetitions 20] [--forces 1.0]
                                                    [--plans designed]

The REMUS-like vehicle plays *plan* again and again under disturbance forces of 0.1 N, 0.3 N, 0.06 N
m
and 2 s (times ``--forces``) and white sensors; each repetition is integrated by the NumPy
equations of `benchmarks.missing_physics` (no code of the package) and estimated by
``MultipleShooting(disturbances="auto")``, levels and times unknown, no priors. Stated are the
errors of ``information_of`` before the trial, for these forces and for white noise alone.

With ``n`` repetitions a ratio has a standard error of about :math:`1/\sqrt{2n}`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.harness import command, ignorant, known, markdown
from benchmarks.missing_physics.simulator import SAMPLE, Case, Truth, integrate
from benchmarks.random_forces.scenarios import MEDIUM, REMUS
from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Experiment, Model, MultipleShooting, Record, load_problem
from oed_sysid.design import DOptimal, Knowledge, Levels, Search, Trial, design_experiment
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information import information_of
from oed_sysid.likelihood.noise_model import NoiseModel

TIME = 2.0
PLANS = ("zigzags", "designed", "calm")


def believed() -> Model:
    """The vehicle without priors, at the values that the simulator has."""
    return ignorant(load_problem("remus_diving_plane").model).with_values(REMUS.believed)


def sea(model: Model, factor: float) -> NoiseModel:
    """Noise of the sensors, and disturbance forces."""
    white = np.array(REMUS.noise_std)
    return NoiseModel(
        white, np.zeros_like(white), factor * np.array(MEDIUM), force_time=TIME,
        outputs=model.output_names, places=tuple(f"force {axis}" for axis in REMUS.forces),
    )  # fmt: skip


def plan(model: Model, name: str, noise: NoiseModel) -> list[Experiment]:
    """Runs as open-loop commands at 0.1 s."""
    problem = load_problem("remus_diving_plane")
    if name == "zigzags":
        chosen = [problem.experiment(n) for n in ("zigzag_5_5", "zigzag_10_10", "zigzag_15_12")]
        return [replace(one, duration=60.0, feedback="true") for one in chosen]
    pattern = problem.experiment("zigzag_10_10")
    largest = math.radians(20.0 if name == "designed" else 1.0)
    limits = replace(problem.limits, inputs={"fin_command": (-largest, largest)})
    found = design_experiment(
        model,
        Trial(
            limits=limits,
            duration=62.0,
            sample_time=0.1,
            constants=pattern.constants,
            initial={**pattern.initial, "z": 25.0},
        ),
        rng=np.random.default_rng(1),
        criterion=DOptimal(),
        search=Search(family=Levels(20), n_starts=2, n_candidates=30, n_steps=10, n_workers=1),
        knowledge=Knowledge(noise=noise),
    )
    return [found.experiment]


def repeated(
    model: Model, run: Experiment, noise: NoiseModel, rng: np.random.Generator, number: int
) -> Record:
    """One run with forces and sensor noise, integrated in NumPy at 0.01 s."""
    nominal = simulate(model, run, noise=False)
    commands = nominal.inputs[:, :, None]
    draws = rng.standard_normal((nominal.n_samples, 3))
    forces = gauss_markov(draws, math.exp(-SAMPLE / TIME)) * noise.force
    truth = Truth([Case(run.name, REMUS.believed)])
    start = np.array([run.initial["u"]]), np.array([run.initial.get("z", 0.0)])
    states = integrate(truth, start, forces[:, :, None], lambda k, _: tuple(commands[k]))
    clean = np.array([truth.measure(state)[:, 0] for k, state in states if k is not None])
    outputs = clean + rng.standard_normal(clean.shape) * noise.white
    return Record(f"{run.name}_{number}", nominal.times, nominal.inputs, outputs, model.channels)


def realised(
    model: Model, runs: Sequence[Experiment], noise: NoiseModel, n: int, seed: int
) -> tuple[np.ndarray, int]:
    """Root mean square errors over repetitions, and how many of them converged."""
    rng = np.random.default_rng(seed)
    truth = np.array([model.values[name] for name in model.free_names])
    errors, converged = [], 0
    for number in range(n):
        data = Dataset(tuple(repeated(model, run, noise, rng, number) for run in runs))
        fit = MultipleShooting(disturbances="auto").fit(model, data)
        converged += fit.status.ok
        errors.append(fit.estimates - truth)
    return np.sqrt(np.mean(np.square(errors), axis=0)), converged


def main(
    *,
    repetitions: int = 20,
    forces: Sequence[float] = (1.0,),
    plans: Sequence[str] = ("designed",),
    seed: int = 0,
) -> None:
    """Measure and print.

    Parameters
    ----------
    repetitions : int
        of every plan
    forces : sequence of float
        times the medium ones
    plans : sequence of str
        zigzags, designed, calm
    seed : int
        of forces and noise
    """
    model = believed()
    sizes = np.abs([model.values[name] for name in model.free_names])
    for factor in forces:
        noise = sea(model, factor)
        for name in plans:
            runs = plan(model, known(name, PLANS, "plan"), noise)
            stated = information_of(model, runs, noise=noise, priors=None).std_errors
            white = information_of(model, runs, noise=noise.white, priors=None).std_errors
            found, converged = realised(model, runs, noise, repetitions, seed)
            print(
                f"\n{name}, forces x {factor:g}: {repetitions} repetitions, {converged} converged"
            )
            shares = (stated / sizes, found / sizes, found / stated, found / white)
            rows = [
                (parameter, f"{a:.2%}", f"{b:.2%}", f"{c:.2f}", f"{d:.2f}")
                for parameter, a, b, c, d in zip(model.free_names, *shares, strict=True)
            ]
            head = ("parameter", "stated", "realised", "ratio", "to white")
            print("\n".join(markdown(head, rows)), flush=True)


if __name__ == "__main__":
    command(main)
