r"""The reference: full maximum likelihood of an extended Kalman filter, started at the truth.

.. math::

    -2 \log L(p, x_0, \sigma, \tau) = \sum_k \log S_k + e_k^2 / S_k

with innovations :math:`e_k` and their variances :math:`S_k` from ``filter.c``.
Every unknown moves at once: parameters, start states, logarithms of levels and
times. Their derivatives are differences of whole filters, so nothing is frozen;
with :math:`q = \partial \log S` the gradient and the expected information are

.. math::

    g = \sum_k \tfrac12 q (1 - e^2/S) + \frac{e\, \partial e}{S}, \qquad
    I = \sum_k \tfrac12 q q' + \frac{\partial e\, \partial e'}{S}

and Fisher's scoring, damped after Levenberg and Marquardt, finds the maximum.
It knows which kinds of noise act (see :func:`structure`), not how large they
are. No code of the package is used.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from benchmarks.harness import RESULTS, Row, Store, command, markdown
from benchmarks.harness import known as is_known
from benchmarks.random_forces.measures import errors, estimated, of_reference
from benchmarks.random_forces.scenarios import SCENARIOS, VEHICLES, Scenario, Vehicle
from benchmarks.random_forces.simulator import Run, Set, simulate

LANES = 8
ITERATIONS = 60
# Largest expected fall of -log L at which the iteration ends.
TOLERANCE = 1e-5
# A level never falls below this share of its true one: it has vanished there.
VANISHED = 0.01
NOTHING = 1e-9
LARGEST_STEP = 0.7


@lru_cache(maxsize=2)
def library(vehicle: str) -> ctypes.CDLL:
    """The compiled filter of a vehicle."""
    compiler = next(filter(None, map(shutil.which, ("gcc", "clang"))), None)
    if compiler is None:
        raise RuntimeError("The reference needs gcc or clang. Install one, or use what is kept.")
    folder = Path(tempfile.mkdtemp(prefix="random_forces_"))
    target = folder / f"{vehicle}.so"
    flags = ("-std=c11", "-O3", "-march=native", "-ffast-math", "-shared", "-fPIC")
    source = Path(__file__).with_name("filter.c")
    command = [compiler, *flags, f"-D{vehicle.upper()}", str(source), "-o", str(target), "-lm"]
    subprocess.run(command, check=True)
    loaded = ctypes.CDLL(str(target))
    shutil.rmtree(folder)
    return loaded


def _address(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def innovations(
    vehicle: Vehicle, run: Run, values: np.ndarray, coloured: int = -1
) -> tuple[np.ndarray, np.ndarray]:
    """Innovations and their variances of one record for several vectors of values.

    Parameters
    ----------
    vehicle : Vehicle
    run : Run
        NaN where nothing was measured.
    values : ndarray (n_vectors, n_values)
        In the order that ``filter.c`` states.
    coloured : int
        Output with coloured noise, or -1.

    Returns
    -------
    innovations, variances : ndarray (n_vectors, n_times, n_outputs)
    """
    n, n_outputs = run.outputs.shape
    present = np.isfinite(run.outputs)
    outputs = np.ascontiguousarray(np.where(present, run.outputs, 0.0))
    mask = np.ascontiguousarray(present, dtype=np.uint8)
    inputs = np.ascontiguousarray(run.inputs, dtype=float)
    groups = []
    for first in range(0, len(values), LANES):
        group = values[first : first + LANES]
        lanes = np.repeat(group[-1:], LANES, axis=0)
        lanes[: len(group)] = group
        given = np.ascontiguousarray(lanes.T)
        e, variance = np.empty((n, n_outputs, LANES)), np.empty((n, n_outputs, LANES))
        library(vehicle.name).filter_record(
            ctypes.c_int(n),
            ctypes.c_double(vehicle.sample_time),
            ctypes.c_int(coloured),
            *(_address(a) for a in (outputs, mask, inputs, given, e, variance)),
        )
        groups.append(np.stack([e, variance])[..., : len(group)])
    e, variance = np.moveaxis(np.concatenate(groups, axis=-1), -1, 1)
    return e, variance


@dataclass(frozen=True)
class Structure:
    """Which noise acts, with values to begin with; those in ``free`` are estimated.

    Attributes
    ----------
    values : dict
        Every level and time, in the order that ``filter.c`` states.
    free : tuple of str
    coloured : int
        Output with coloured noise, or -1.
    """

    values: dict[str, float]
    free: tuple[str, ...]
    coloured: int = -1


def structure(scenario: Scenario) -> Structure:
    """The kinds of noise of a scenario, at their true levels."""
    vehicle = VEHICLES[scenario.vehicle]
    white = [sigma * scenario.level for sigma in vehicle.noise_std]
    forces = [f"force {name}" for name in vehicle.forces]
    whites = [f"white {name}" for name in vehicle.states]
    values = dict(zip(forces, (max(level, NOTHING) for level in scenario.force), strict=True))
    values["force time"] = scenario.force_time
    values |= dict(zip(whites, white, strict=True))
    values |= {"colour": NOTHING, "colour time": 1.0, "input": NOTHING}
    free = [*forces, "force time"] if any(scenario.force) else []
    if scenario.level != 1.0:
        free += whites
    if scenario.colour:
        values["colour"] = white[scenario.coloured]
        values["colour time"] = -vehicle.sample_time / np.log(scenario.colour)
        values[whites[scenario.coloured]] = 1e-3 * white[scenario.coloured]
        free += ["colour", "colour time"]
    if scenario.fin_noise:
        values["input"] = float(np.radians(scenario.fin_noise))
        free.append("input")
    return Structure(values, tuple(free), scenario.coloured if scenario.colour else -1)


@dataclass(frozen=True, eq=False)
class Maximum:
    """A maximum of the likelihood.

    Attributes
    ----------
    estimates, std_errors : dict
        Of shared parameters, and of levels and times.
    converged : bool
    """

    estimates: dict[str, float]
    std_errors: dict[str, float]
    converged: bool


class _Problem:
    """Unknowns: shared parameters, logarithms of noise, then those of each record."""

    def __init__(self, vehicle: Vehicle, runs: Sequence[Run], noise: Structure) -> None:
        self.vehicle, self.runs, self.noise = vehicle, runs, noise
        self.n_shared = len(vehicle.believed)
        self.n_local = len(vehicle.local)
        self.n_states = len(vehicle.states)
        names = list(noise.values)
        self.noise_index = np.array([names.index(name) for name in noise.free], dtype=int)
        self.n_common = self.n_shared + len(self.noise_index)
        self.n_own = self.n_local + self.n_states
        self.step = np.concatenate(
            [
                1e-5 * np.abs(list(vehicle.believed.values())),
                np.full(len(self.noise_index), 1e-4),
                np.full(self.n_local, 1e-6),
                1e-3 * np.array(vehicle.noise_std),
            ]
        )

    def start(self, truth: Mapping[str, float]) -> np.ndarray:
        """Unknowns at the truth."""
        levels = np.array(list(self.noise.values.values()))[self.noise_index]
        own = [[*run.local.values(), *run.clean[0]] for run in self.runs]
        shared = [truth[name] for name in self.vehicle.believed]
        return np.concatenate([shared, np.log(levels), *own])

    def columns(self, record: int) -> np.ndarray:
        """Unknowns that one record depends on."""
        first = self.n_common + record * self.n_own
        return np.concatenate([np.arange(self.n_common), np.arange(first, first + self.n_own)])

    def vectors(self, unknowns: np.ndarray) -> np.ndarray:
        """Values for the filter from the unknowns of one record, ``(n_vectors, n_values)``."""
        shared = unknowns[:, : self.n_shared]
        own = unknowns[:, self.n_common :]
        noise = np.repeat([list(self.noise.values.values())], len(unknowns), axis=0)
        noise[:, self.noise_index] = np.exp(unknowns[:, self.n_shared : self.n_common])
        return np.hstack([shared, own, noise])

    def objective(self, unknowns: np.ndarray) -> float:
        """Minus twice the log-likelihood."""
        total = 0.0
        for i, run in enumerate(self.runs):
            values = self.vectors(unknowns[None, self.columns(i)])
            e, variance = innovations(self.vehicle, run, values, self.noise.coloured)
            total += float(np.sum(np.log(variance) + e**2 / variance))
        return total if np.isfinite(total) else np.inf

    def derivatives(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient of minus the log-likelihood, and the expected information."""
        gradient = np.zeros(len(unknowns))
        information = np.zeros((len(unknowns), len(unknowns)))
        for i, run in enumerate(self.runs):
            columns = self.columns(i)
            here = unknowns[columns]
            moved = np.vstack([here, here + np.diag(self.step)])
            e, variance = innovations(self.vehicle, run, self.vectors(moved), self.noise.coloured)
            e, variance = e.reshape(len(e), -1), variance.reshape(len(e), -1)
            slope = (e[1:] - e[0]) / self.step[:, None]
            by_log = np.log(variance[1:] / variance[0]) / self.step[:, None]
            ratio = e[0] ** 2 / variance[0]
            gradient[columns] += 0.5 * by_log @ (1.0 - ratio) + slope @ (e[0] / variance[0])
            information[np.ix_(columns, columns)] += (
                0.5 * by_log @ by_log.T + (slope / variance[0]) @ slope.T
            )
        return gradient, information


def maximise(
    vehicle: Vehicle, runs: Sequence[Run], noise: Structure, truth: Mapping[str, float]
) -> Maximum:
    """The most likely parameters, start states and noise, from the true ones."""
    problem = _Problem(vehicle, runs, noise)
    unknowns = problem.start(truth)
    levels = slice(problem.n_shared, problem.n_common)
    is_level = np.zeros(len(unknowns), dtype=bool)
    is_level[levels] = ["time" not in name for name in noise.free]
    is_log = np.zeros(len(unknowns), dtype=bool)
    is_log[levels] = True
    lowest = np.where(is_level, unknowns + np.log(VANISHED), -np.inf)
    lowest = np.where(is_log & ~is_level, unknowns - 3.0, lowest)
    highest = np.where(is_log & ~is_level, unknowns + 3.0, np.inf)
    value, damping, converged = problem.objective(unknowns), 0.0, False
    gradient, information = problem.derivatives(unknowns)
    for _ in range(ITERATIONS):
        held = (unknowns <= lowest) & (gradient > 0) | (unknowns >= highest) & (gradient < 0)
        free = np.flatnonzero(~held)
        scale = np.sqrt(np.diag(information)[free])
        scaled = information[np.ix_(free, free)] / np.outer(scale, scale)
        move = np.zeros(len(unknowns))
        change = np.linalg.solve(scaled + damping * np.eye(len(free)), gradient[free] / scale)
        move[free] = -change / scale
        # No level or time changes more than twofold in a step.
        move[is_log] = np.clip(move[is_log], -LARGEST_STEP, LARGEST_STEP)
        proposed = np.clip(unknowns + move, lowest, highest)
        expected = -float(gradient @ (proposed - unknowns))
        new = problem.objective(proposed)
        converged = expected < TOLERANCE
        if new <= value + 1e-7:
            unknowns, value, damping = proposed, new, 0.1 * damping if damping > 1e-6 else 0.0
            gradient, information = problem.derivatives(unknowns)
        else:
            damping = max(1e-3, 10.0 * damping)
        if converged or damping > 1e8:
            break
    covariance = np.linalg.pinv(information)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # Levels and times from their logarithms.
    names = [*vehicle.believed, *noise.free]
    estimates, errors = unknowns[: problem.n_common].copy(), std[: problem.n_common]
    estimates[levels] = np.exp(estimates[levels])
    errors[levels] *= estimates[levels]
    return Maximum(
        dict(zip(names, estimates.tolist(), strict=True)),
        dict(zip(names, errors.tolist(), strict=True)),
        converged,
    )


def reference(scenario: Scenario, data: Set) -> Maximum:
    """What full maximum likelihood makes of one data set."""
    return maximise(VEHICLES[scenario.vehicle], data.runs, structure(scenario), data.truth)


STORE = Store(RESULTS / "reference.jsonl")


def key(scenario: Scenario, seed: int, number: int) -> str:
    """Name of an entry."""
    return f"{scenario.name}/{seed}/{number}"


def names(scenario: Scenario) -> list[str]:
    """What the reference estimates, in order."""
    return [*VEHICLES[scenario.vehicle].believed, *structure(scenario).free]


def entry(scenario: Scenario, seed: int, data: Set, found: Maximum) -> Row:
    """One line of the store: estimates and standard errors in the order of :func:`names`."""
    return {
        "key": key(scenario, seed, data.number),
        "data": data.fingerprint,
        "converged": found.converged,
        "estimates": [float(f"{found.estimates[name]:.7g}") for name in names(scenario)],
        "std_errors": [float(f"{found.std_errors[name]:.3g}") for name in names(scenario)],
    }


def known(
    scenario: Scenario, seed: int, data: Mapping[int, float], store: Store = STORE
) -> dict[int, Row]:
    """What is known of data sets of these fingerprints, by number."""
    done, order, found = store.done(), names(scenario), {}
    for number, fingerprint in data.items():
        line = done.get(key(scenario, seed, number))
        if line is not None and abs(line["data"] / fingerprint - 1.0) < 1e-7:
            parts = ("estimates", "std_errors")
            values = {part: dict(zip(order, line[part], strict=True)) for part in parts}
            found[number] = {"converged": line["converged"], **values}
    return found


def complete(scenario: Scenario, seed: int, sets: Sequence[Set]) -> list[SimpleNamespace]:
    """Compute what is missing; what the reference makes of all sets, with their truth."""
    data = {one.number: one.fingerprint for one in sets}
    have = known(scenario, seed, data)
    for one in sets:
        if one.number not in have:
            STORE.add(entry(scenario, seed, one, reference(scenario, one)))
    return of_reference(sets, known(scenario, seed, data))


def row(scenario: Scenario, fits: Sequence[SimpleNamespace]) -> tuple[object, ...]:
    """Whether the reference itself is what it should be."""
    order = list(VEHICLES[scenario.vehicle].believed)
    found, noise = estimated(order, *errors(fits, order)), structure(scenario)
    ratios = {
        name: np.median([fit.estimates[name] for fit in fits]) / noise.values[name]
        for name in noise.free
    }
    told = ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items())
    converged = 100 * np.mean([fit.converged for fit in fits])
    coverage = f"{found['coverage']:.1f} ± {found['coverage_error']:.1f}"
    return scenario.name, len(fits), coverage, f"{found['z']:.2f}", f"{converged:.0f} %", told


def main(scenarios: Sequence[str] = tuple(SCENARIOS), *, sets: int = 40, seed: int = 0) -> None:
    """Fill the store, and say whether the reference is what it should be.

    Parameters
    ----------
    scenarios : sequence of str
        all of them by default
    sets : int
        data sets per scenario
    seed : int
        of the data sets
    """
    rows = []
    for name in scenarios:
        scenario = SCENARIOS[is_known(name, SCENARIOS, "scenario")]
        rows.append(row(scenario, complete(scenario, seed, simulate(scenario, seed, range(sets)))))
        print(*rows[-1], flush=True)
    head = ("scenario", "sets", "coverage, %", "z", "converged", "levels and times / true, median")
    print("\n".join(markdown(head, rows)))


if __name__ == "__main__":
    command(main)
