"""Are estimates as good as theory allows, and do their intervals hold?

    OMP_NUM_THREADS=1 python -m benchmarks.efficiency [runs] [--fresh]

Monte Carlo on the diving plane of a REMUS-like vehicle (eight unknown
parameters and five unknown initial states per record, three zigzag-like
records). White noise: the variance of the estimates over the Cramer-Rao bound
should be 0.95 to 1.10 and 95 % intervals should cover 93 to 97 %. Coloured
noise (first-order autoregressive, the same standard deviation): intervals from
the sandwich covariance beside those that take residuals as white.

Finished blocks of runs are kept in ``out/efficiency`` and not repeated.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from scipy.signal import lfilter

from benchmarks.harness import NOISE, START
from oed_sysid import Dataset, MultipleShooting, load_problem
from oed_sysid.data.record import Record
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.physics.model import Model

FOLDER = Path("out/efficiency")
# White noise gets five times the runs: a variance from 400 runs is known to 7 % only.
RUNS, BLOCK = 400, 50
# Memory of the noise per sample of 0.1 s; 0 is white.
MEMORIES = (0.0, 0.5, 0.8, 0.95)
# Duration (s), fin amplitude (rad), thrust (N) and period (s) of each record.
TESTS = ((60.0, 0.10, 9.0, 14.0), (60.0, 0.15, 7.0, 9.0), (40.0, 0.06, 11.0, 20.0))


@dataclass(frozen=True, eq=False)
class Outcome:
    """Estimates and standard errors of some runs, each ``(n_runs, n_parameters)``."""

    estimates: np.ndarray
    white_errors: np.ndarray
    errors: np.ndarray


def clean_records(model: Model) -> list[Record]:
    """Records of the truth without noise."""
    records = []
    for index, (duration, amplitude, thrust, period) in enumerate(TESTS):
        times = np.arange(0.0, duration, 0.1)
        fin = amplitude * np.sign(np.sin(2 * np.pi * times / period))
        inputs = {"fin_command": fin, "thrust": thrust}
        run = simulate_inputs(model, times, inputs=inputs, initial=START)
        name = f"zigzag_{index}"
        records.append(Record(name, times, run.inputs, run.outputs, model.channels))
    return records


def noisy(records: list[Record], memory: float, rng: np.random.Generator) -> Dataset:
    """Records with stationary autoregressive noise of the stated levels."""

    def noise(n_times: int) -> np.ndarray:
        white = rng.standard_normal((n_times + 200, len(NOISE))) * np.sqrt(1 - memory**2)
        return lfilter([1.0], [1.0, -memory], white, axis=0)[200:] * NOISE

    return Dataset(tuple(r.with_outputs(r.outputs + noise(r.n_samples)) for r in records))


def run_block(memory: float, seeds: range, *, estimate_noise: bool) -> Outcome:
    """Fit one data set per seed."""
    model = vehicle()
    records = clean_records(model)
    estimator = MultipleShooting(disturbances="none", noise="estimate" if estimate_noise else NOISE)
    rows = []
    for seed in seeds:
        rng = np.random.default_rng([seed, round(1000 * memory)])
        fit = estimator.fit(model, noisy(records, memory, rng))
        if not fit.status.ok:
            raise RuntimeError(f"seed {seed}: {fit.status}")
        errors = np.sqrt(np.diag(fit.covariance))
        rows.append((fit.estimates, fit.information.std_errors, errors))
    return Outcome(*(np.array(column) for column in zip(*rows, strict=True)))


def vehicle() -> Model:
    """The model that makes and fits the data."""
    return load_problem("remus_diving_plane").model


def stored_block(memory: float, first: int, *, estimate_noise: bool) -> Outcome:
    """One block of runs, from disk if it has been done before."""
    path = FOLDER / f"{memory:g}_{'estimated' if estimate_noise else 'given'}_{first}.npz"
    if path.exists():
        with np.load(path) as file:
            return Outcome(file["estimates"], file["white_errors"], file["errors"])
    outcome = run_block(memory, range(first, first + BLOCK), estimate_noise=estimate_noise)
    FOLDER.mkdir(parents=True, exist_ok=True)
    np.savez(path, **vars(outcome))
    return outcome


def table(outcome: Outcome, truth: np.ndarray, names: tuple[str, ...]) -> list[str]:
    """Variance over the bound and coverages, by parameter and over all."""
    deviation = outcome.estimates - truth
    bound = np.mean(outcome.white_errors**2, axis=0)
    ratio = np.var(outcome.estimates, axis=0) / bound
    bias = deviation.mean(axis=0) / np.sqrt(bound)
    white = np.mean(np.abs(deviation) < 1.959964 * outcome.white_errors, axis=0)
    stated = np.mean(np.abs(deviation) < 1.959964 * outcome.errors, axis=0)
    lines = [f"  {'':9} {'var/bound':>9} {'bias/err':>9} {'cover white':>11} {'cover':>6}"]
    for row in zip(names, ratio, bias, white, stated, strict=True):
        lines.append("  {:9} {:9.3f} {:+9.3f} {:10.1%} {:6.1%}".format(*row))
    means = (ratio.mean(), np.abs(bias).mean(), white.mean(), stated.mean())
    lines.append("  {:9} {:9.3f} {:9.3f} {:10.1%} {:6.1%}".format("mean", *means))
    return lines


def whitened(outcome: Outcome, model: Model) -> str:
    """Variance over the bound of uncorrelated combinations of the parameters.

    Parameters whose estimates are correlated by 0.99 err together; these do not.
    """
    clean = Dataset(tuple(clean_records(model)))
    bound = (
        MultipleShooting(disturbances="none", noise=NOISE, coloured="never")
        .fit(model, clean)
        .covariance
    )
    root = np.linalg.cholesky(np.linalg.inv(bound))
    ratios = np.var(outcome.estimates @ root, axis=0)
    spread = np.sqrt(2.0 / len(outcome.estimates))
    return (
        f"uncorrelated combinations: {ratios.min():.3f} to {ratios.max():.3f}, each known to "
        f"{spread:.3f}; mean {ratios.mean():.3f}, known to {spread / np.sqrt(len(ratios)):.3f}"
    )


def main() -> None:
    """Run, or finish, the benchmark and print its tables."""
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    runs = numbers[0] if numbers else RUNS
    if "--fresh" in sys.argv:
        for path in FOLDER.glob("*.npz"):
            path.unlink()
    model = vehicle()
    truth = np.array([model.values[name] for name in model.free_names])
    began = time.perf_counter()
    cases = [(0.0, False), *((memory, True) for memory in MEMORIES)]
    for memory, estimate_noise in cases:
        n_runs = runs if estimate_noise else 5 * runs
        blocks = Parallel(n_jobs=2)(
            delayed(stored_block)(memory, first, estimate_noise=estimate_noise)
            for first in range(0, n_runs, BLOCK)
        )
        outcome = Outcome(
            *(np.vstack([getattr(b, n) for b in blocks]) for n in Outcome.__dataclass_fields__)
        )
        colour = "white noise" if memory == 0 else f"noise with memory {memory:g} per sample"
        print(f"{colour}, levels {'estimated' if estimate_noise else 'given'}, {n_runs} runs")
        print("\n".join(table(outcome, truth, model.free_names)))
        if memory == 0:
            print(f"  {whitened(outcome, model)}")
    print(f"{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
