"""How long things take, beside their targets; all names: ``python -m benchmarks.speed --help``.

    OMP_NUM_THREADS=1 python -m benchmarks.speed kernel score

The vehicle is the diving plane of a REMUS-like AUV, five outputs, noise as declared, unless another
is named. Times are least processor times of warm calls, or on the clock where it is said. What
each part measures is said by its function, and listed by ``python -m benchmarks --list``.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.harness import (
    ONE_THREAD,
    START,
    Measured,
    command,
    dive,
    ignorant,
    known,
    least,
    machine,
    named,
    scaled,
)
from benchmarks.truth import NOISE
from oed_sysid import (
    Channels,
    Dataset,
    Input,
    Model,
    MultipleShooting,
    Output,
    Record,
    improve,
    load_problem,
    read_csv,
)
from oed_sysid.compiled import graph as graphs
from oed_sysid.compiled.kernels import kernel as compiled
from oed_sysid.evidence.study import Study
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.information import CommandedRun, noise_of
from oed_sysid.information.bound import RunInformation, triangle

N_SAMPLES, STEP = 2400, 0.1
EXTRA = ("X_udot", "Z_wdot", "M_wdot", "M_qdot")
REPEATS, ROUNDS = 60, 5
WHITE = MultipleShooting(disturbances="none")


def vehicle() -> Model:
    """The model that makes and fits the data."""
    return load_problem("remus_diving_plane").model


def split() -> tuple[Dataset, Dataset]:
    """The problem's records for training and for tests; something is hidden in them."""
    records = load_problem("remus_diving_plane").data()
    return named(records, "train"), named(records, "test")


# -- trajectory, sensitivities, information ----------------------------------------------


class Task:
    """One record to simulate with sensitivities to twelve parameters and the start state.

    The outputs of this model are its states; ``free`` are the positions of its free parameters.
    """

    def __init__(self) -> None:
        self.model = vehicle().free(*EXTRA)
        self.kernel = compiled(self.model)
        self.times = np.arange(N_SAMPLES) * STEP
        fin = 0.1 * np.sign(np.sin(0.5 * self.times)) + 0.05 * np.sin(1.3 * self.times)
        self.inputs = np.column_stack([fin, np.full(N_SAMPLES, 9.0)])
        self.start = np.array([1.5, 0.0, 0.0, 0.0, 10.0])
        self.free = [self.model.parameter_names.index(name) for name in self.model.free_names]

    def run(self) -> np.ndarray:
        """Sensitivities ``(n_times, n_outputs, n_columns)`` from our kernel."""
        values = self.model.value_vector
        run = self.kernel.run(self.times, self.inputs, values, self.start, sensitivities=True)
        assert run.output_sensitivities is not None
        return run.output_sensitivities

    def by_manual(self) -> tuple[ca.Function, float]:
        """``mapaccum`` of an expanded step over the record, and the jacobian of all outputs.

        CasADi 3.x user guide, sections on map and mapaccum and on differentiation. The time that
        building it takes on the clock, s, comes with it.
        """
        began = time.perf_counter()
        graph, values, n = graphs.build(self.model), self.model.value_vector, len(self.start)
        z0, unknown = ca.MX.sym("z0", n), ca.MX.sym("p", len(self.free))
        parameters = ca.MX(values)
        for position, index in enumerate(self.free):
            parameters[index] = unknown[position]
        z, u, q = ca.MX.sym("z", n), ca.MX.sym("u", 2), ca.MX.sym("q", len(values))
        step = ca.Function("step", [z, u, q], [graph.advance(z, u, u, q, 0.0, STEP)]).expand()
        path = step.mapaccum("path", N_SAMPLES - 1)(
            z0, self.inputs[:-1].T, ca.repmat(parameters, 1, N_SAMPLES - 1)
        )
        outputs = ca.vec(ca.horzcat(z0, path))
        jacobian = ca.jacobian(outputs, ca.vertcat(z0, unknown))
        return ca.Function("J", [z0, unknown], [outputs, jacobian]), time.perf_counter() - began

    def bare(self, program: Path, folder: Path) -> tuple[float, float]:
        """Least time of a call from C, s, and the sum of all sensitivities."""
        k, data = self.kernel, folder / "task.bin"
        sizes = (N_SAMPLES, k.n_inputs, k.n_parameters, k.n_full, k.n_outputs, k.n_columns)
        parts = (self.model.step, self.times, self.inputs, self.model.value_vector, self.start)
        with data.open("wb") as file:
            file.write(np.array(sizes, dtype=np.intc).tobytes())
            for part in parts:
                file.write(np.asarray(part, dtype=float).tobytes())
        words = [program, k.library._name, data, str(REPEATS)]
        told = subprocess.run(words, check=True, capture_output=True, text=True).stdout.split()
        return float(told[0]), float(told[1])


def kernel() -> Iterator[Measured]:
    """Trajectory and sensitivities of 2,400 samples by twelve parameters and five start states.

    Ours, the same compiled code called in a loop by a C program that owns its buffers (what is
    above it is the price of Python, of checks and of fresh arrays), and CasADi as its manual
    teaches.
    """
    job = Task()
    free = [job.model.values[name] for name in job.model.free_names]
    manual, built = job.by_manual()
    ours = job.run()
    theirs = np.array(manual(job.start, free)[1]).reshape(ours.shape)
    difference = float(np.max(np.abs(ours - theirs) / np.abs(ours).max(axis=(0, 1))))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        compiler = next(filter(None, map(shutil.which, ("gcc", "clang", "cc"))))
        program, code = folder / "kernel_loop", Path(__file__).with_name("kernel_loop.c")
        subprocess.run([compiler, "-O2", str(code), "-o", str(program), "-ldl"], check=True)
        # Both in turn, several times: other loads on the machine come and go.
        rounds = [(least(job.run, REPEATS), job.bare(program, folder)) for _ in range(ROUNDS)]
    t_ours, t_bare = min(one for one, _ in rounds), min(found[0] for _, found in rounds)
    assert abs(rounds[0][1][1] - ours.sum()) < 1e-9 * np.abs(ours).sum()
    t_manual = least(lambda: manual(job.start, free), 5)
    print(
        f"{N_SAMPLES} samples, 5 outputs, {len(free)} parameters + 5 initial states: bare C loop "
        f"{1e3 * t_bare:.3f} ms, ours {1e3 * t_ours:.3f} ms, CasADi jacobian "
        f"{1e3 * t_manual:.1f} ms (built in {built:.2f} s); largest relative difference of ours "
        f"to CasADi's {difference:.1e}"
    )
    yield Measured("trajectory and sensitivities over the bare C loop", t_ours / t_bare, 1.3)
    ratio = t_manual / t_ours
    yield Measured("CasADi's mapaccum and jacobian over ours", ratio, 20.0, at_most=False)


def information() -> Iterator[Measured]:
    """Information of that record: ours, one-sided differences, CasADi's jacobian.

    Every way from the same equations, the same steps and the same triangularisation.
    """
    job = Task()
    values, sigma = job.model.value_vector, noise_of(job.model)
    seen = np.ones((N_SAMPLES, 5), dtype=bool)
    given = CommandedRun("benchmark", job.times, job.inputs, job.start, seen)
    point = np.concatenate([job.start, values[job.free]])
    manual, _ = job.by_manual()

    def outputs(unknowns: np.ndarray) -> np.ndarray:
        trial = values.copy()
        trial[job.free] = unknowns[5:]
        z, _ = job.kernel.start(unknowns[:5], job.inputs[0], trial, 0.0)
        return job.kernel.run(job.times, job.inputs, trial, z).outputs

    def differences() -> np.ndarray:
        steps, base = 1e-7 * np.maximum(np.abs(point), 0.1), outputs(point)
        moved = [outputs(point + step) - base for step in np.diag(steps)]
        return np.stack(moved, axis=2) / steps

    def by_casadi() -> np.ndarray:
        return np.array(manual(point[:5], point[5:])[1]).reshape(N_SAMPLES, 5, -1)

    def factor_of(jacobian: np.ndarray) -> np.ndarray:
        rows = (jacobian / sigma[:, None]).reshape(-1, len(point))
        return triangle(rows)[5:, 5:]

    told = RunInformation(job.model)
    reference, own = factor_of(by_casadi()), told.factor(given)
    assert np.allclose(own.T @ own, reference.T @ reference, rtol=1e-8)
    ours = least(lambda: told.factor(given), 25)
    for words, jacobian, target in (
        ("one-sided differences", differences, 3.0), ("CasADi jacobian", by_casadi, 30.0),
    ):  # fmt: skip
        taken = least(lambda jacobian=jacobian: factor_of(jacobian()), 25)
        yield Measured(f"information by {words} over ours", taken / ours, target, at_most=False)


# -- fits --------------------------------------------------------------------------------

TESTS = ((90.0, 0.10, 9.0, 14.0), (90.0, 0.20, 6.0, 9.0), (60.0, 0.05, 12.0, 20.0))
N_STARTS, SPAN = 40, 4.0
SENSORS = (("u", "w", "q", "theta", "z"), ("u", "theta", "z"), ("u", "w", "theta"))
SIZES = (1_000, 3_000, 10_000, 30_000, 100_000)


def records(model: Model, outputs: tuple[str, ...]) -> tuple[Model, Dataset]:
    """The model with some outputs, and noisy records of it."""
    rng = np.random.default_rng(0)
    part = replace(model, outputs=tuple(o for o in model.outputs if o.name in outputs))
    columns = [model.output_names.index(name) for name in part.output_names]
    result = []
    for index, (duration, amplitude, thrust, period) in enumerate(TESTS):
        times = np.arange(0.0, duration, 0.1)
        fin = amplitude * np.sign(np.sin(2 * np.pi * times / period))
        inputs = {"fin_command": fin, "thrust": thrust}
        run = simulate_inputs(model, times, inputs=inputs, initial=START)
        noisy = run.outputs + NOISE * rng.standard_normal(run.outputs.shape)
        result.append(Record(f"r{index}", times, run.inputs, noisy[:, columns], part.channels))
    return part, Dataset(result)


def fit_speed() -> Iterator[Measured]:
    """Local fits, start values 30 % off, and arrival from wild starts, also without some sensors.

    Three records of 2,400 samples, or one of 900 and forty starts within four times each true
    value, signs included; success is the optimum that a start at the truth reaches.
    """
    model, data = records(vehicle(), SENSORS[0])
    for factor in (0.7, 1.3):
        for noise in ("given", "estimate"):
            estimator = replace(WHITE, noise=noise)
            taken = least(lambda f=factor, e=estimator: e.fit(scaled(model, f), data))
            words = f"white fit, 2,400 samples, start x {factor}, noise {noise}"
            yield Measured(words, 1e3 * taken, 40.0, "ms")
    for sensors in SENSORS:
        model, data = records(vehicle(), sensors)
        single = Dataset((data[0],))
        right = WHITE.fit(model, single)
        local = least(lambda m=model, d=single: WHITE.fit(scaled(m, 0.7), d))
        arrived, times = 0, []
        for seed in range(N_STARTS):
            rng = np.random.default_rng(seed)
            wild = {n: rng.uniform(-SPAN, SPAN) * abs(model.values[n]) for n in model.free_names}
            began = time.process_time()
            fit = WHITE.fit(model.with_values(wild), single)
            times.append(1e3 * (time.process_time() - began))
            arrived += fit.status.ok and fit.cost < right.cost + 0.01
        words = f"of {N_STARTS} wild starts, {', '.join(sensors)}:"
        yield Measured(f"{words} arrive", arrived, N_STARTS, at_most=False)
        yield Measured(f"{words} median time over a local fit", np.median(times) / 1e3 / local, 3.0)


def grown(n_samples: int) -> None:
    """Print least time of a fit (s) per sample and iteration, and the peak memory (bytes)."""
    model = vehicle()
    data = Dataset((dive(model, STEP * np.arange(n_samples)),))
    start, estimator = ignorant(scaled(model, 0.9)), replace(WHITE, noise="given", start="near")
    fit = estimator.fit(start, data)
    assert fit.status.ok, fit.status
    seconds = least(lambda: estimator.fit(start, data), max(3, min(20, 30_000 // n_samples)))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(f"{seconds / n_samples / fit.iterations} {peak}")


def growth() -> Iterator[Measured]:
    """Time and memory of a fit of 1,000 to 100,000 samples, each in a process of its own."""
    rows = []
    for n in SIZES:
        told = fresh(f"from benchmarks.speed import grown; grown({n})")[1].split()
        rows.append((float(told[-2]), float(told[-1]) / 2**30))
        print(f"{n:>8} samples: {1e6 * rows[-1][0]:.2f} us each, {rows[-1][1]:.2f} GiB", flush=True)
    more, peak = rows[-1][0] / rows[0][0] - 1.0, max(peak for _, peak in rows)
    yield Measured("time per sample and iteration, 100,000 / 1,000, growth", more, 0.15)
    yield Measured("peak memory of a fit of 100,000 samples", peak, 1.0, "GiB")


def swarm() -> Iterator[Measured]:
    """A swarm of 100 particles, 300 generations, 1,000 samples, on all cores: on the clock."""
    from oed_sysid.baselines import DifferentialSwarm

    model = vehicle()
    for parameter in model.free_parameters:
        lower, upper = sorted((0.5 * parameter.value, 1.5 * parameter.value))
        model = model.with_parameter(replace(parameter, lower=lower, upper=upper))
    data = Dataset((dive(model, STEP * np.arange(1000), ripple=False),))
    search = DifferentialSwarm(n_particles=100, n_generations=300, tolerance=0.0, initial=START)
    search.fit(model, data)
    _, clock = timed("swarm", lambda: search.fit(model, data))
    yield Measured("swarm, time on the clock", clock, 15.0, "s")


# -- process noise and missing physics ------------------------------------------------------


def likelihood() -> Iterator[Measured]:
    """A fit with process noise, the same from where an earlier one ended, an improvement."""
    from benchmarks.random_forces.scenarios import SCENARIOS
    from benchmarks.random_forces.simulator import simulate
    from benchmarks.random_forces.trial import believed, dataset, nominal_model

    problem, (train, test) = load_problem("remus_diving_plane"), split()
    scenario = SCENARIOS["medium"]
    (drawn,) = simulate(scenario, 0, range(1))
    model = nominal_model(scenario.vehicle).with_values(believed(scenario))
    data = dataset(scenario, model, drawn.runs)
    earlier = MultipleShooting().fit(model, data)
    samples = sum(record.n_samples for record in data)
    size = f"{samples:,} samples of {len(model.outputs)} outputs"
    for words, warm, target in (
        (f"fit with process noise, {size}", None, 100.0),
        ("the same from where an earlier fit ended", earlier, 50.0),
    ):
        seconds = least(lambda warm=warm: MultipleShooting().fit(model, data, warm=warm), 5)
        yield Measured(words, 1e3 * seconds, target, "ms")
    times = []
    for _ in range(3):
        began = time.process_time()
        found = improve(problem.model, train, test, candidates=problem.effects)
        times.append(time.process_time() - began)
    added = ", ".join(step.added for step in found.steps)
    yield Measured(f"improve, {len(problem.effects)} candidates ({added})", min(times), 3.0, "s")


def score() -> Iterator[Measured]:
    """The score test of all candidate effects on 2,703 samples; the first fit is not counted."""
    from oed_sysid.evidence.score import scores

    problem, (train, _) = load_problem("remus_diving_plane"), split()
    candidates = list(problem.effects)
    study, fit = Study.begin(problem.model, train, None, candidates, known_noise=False)

    def work() -> object:
        return scores(study, fit, study.candidates)

    seconds, clock = least(work, 12), least(work, 5, time.perf_counter)
    ranked, _ = scores(study, fit, study.candidates)
    n_samples = sum(record.n_samples for record in train)
    print(
        f"{len(candidates)} candidates on {n_samples} samples; best: "
        f"{', '.join(s.effect.name for s in ranked[:3])}; on the clock {clock:.3f} s"
    )
    yield Measured("score test of all candidates, processor time", seconds, 0.3, "s")


def timed(words: str, call: Callable[[], Any]) -> tuple[Any, float]:
    """Call something, say how long it took, and return the time on the clock as well."""
    wall, processor = time.perf_counter(), time.process_time()
    result = call()
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    print(f"{words}: {wall:.1f} s, processor {processor:.1f} s", flush=True)
    return result, wall


def long_search() -> Iterator[Measured]:
    """`improve` on one dive of half an hour at 50 Hz, which it splits, with a hidden heave drag."""
    problem = load_problem("remus_diving_plane")
    hidden = problem.effect("heave_crossflow_drag")
    (size,) = hidden.amplitude_names
    truth = (problem.model + hidden).with_values({size: -40.0})
    samples = 90_000
    run = dive(truth, 0.02 * np.arange(samples))
    data = Dataset((replace(run, channels=problem.channels),))
    found, wall = timed(
        f"improve, {samples} samples, {len(problem.effects)} candidates",
        lambda: improve(problem.model, data, candidates=problem.effects),
    )
    print("  found", ", ".join(step.added for step in found.steps) or "nothing")
    yield Measured(f"improve, {samples:,} samples in one record, on the clock", wall, 60.0, "s")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    yield Measured("peak memory of it", peak, 1.5, "GiB")


DRAGS = (
    "heave_crossflow", "sway_crossflow", "pitch_quadratic_damping", "yaw_quadratic_damping",
    "roll_quadratic_damping", "pitch_crossflow_moment", "yaw_crossflow_moment", "sway_drift_yaw",
    "crossflow_drag", "surge_linear_drag",
)  # fmt: skip
CANDIDATES = 30


def six_degrees_task() -> tuple[Model, Dataset, Dataset]:
    """The nominal model with ten drags, derivatives 10 to 30 % wrong, and both sets of records."""
    from benchmarks.other_vehicles.judge import datasets
    from benchmarks.other_vehicles.models import nominal
    from benchmarks.other_vehicles.truth import VEHICLES
    from benchmarks.other_vehicles.truth.simulator import simulate

    auv = replace(VEHICLES["auv"], sample=0.05, substep=0.05)
    own, rng = nominal("auv"), np.random.default_rng(36030)
    runs = simulate(auv, {"lag:stern": 0.25}, rng=rng)
    model = own.model(True, None)
    for name in DRAGS:
        model = model + own.effect(name)
    wrong = rng.uniform(0.1, 0.3, len(auv.free)) * rng.choice([-1, 1], len(auv.free))
    start = {k: v * (1 + e) for (k, v), e in zip(auv.free.items(), wrong, strict=True)}
    model = model.with_values({k: v for k, v in start.items() if k in model.parameter_names})
    return model, *datasets(auv, runs, model)


def six_degrees() -> Iterator[Measured]:
    """Two fits and a search in six degrees of freedom: 12 states, 25 parameters, 36,030 samples.

    The AUV of :mod:`benchmarks.other_vehicles`, simulated by that benchmark's own code at 20 Hz;
    compiling is left out.
    """
    from benchmarks.other_vehicles.models import nominal

    own, (model, train, test) = nominal("auv"), six_degrees_task()
    n_samples = sum(int(np.isfinite(record.outputs).sum()) for record in train)
    print(f"{len(model.state_names)} states, {len(model.free_names)} free, {n_samples} samples")
    full = model + own.effect("stern_lag")
    size = f"12 states, {n_samples:,} samples, on the clock"
    for words, disturbances, target in (("white", "none", 2.5), ("process noise", "auto", 30.0)):
        estimator = MultipleShooting(noise="given", disturbances=disturbances)
        estimator.fit(full, Dataset((train[0],)))
        fit, wall = timed(f"fit, {words}", lambda e=estimator: e.fit(full, train))
        print(f"  {fit.status.code}, {fit.iterations} iterations, {fit.normalised_rms:.3f} x noise")
        yield Measured(f"fit, {words}, {size}", wall, target, "s")
    others = [effect for effect in own.candidates if effect.name not in DRAGS]
    chosen = [own.effect("stern_lag"), *others][: CANDIDATES + 1]
    chosen = list({effect.name: effect for effect in chosen}.values())[:CANDIDATES]
    words = f"improve, {len(chosen)} candidates"
    found, wall = timed(words, lambda: improve(model, train, test, candidates=chosen))
    print("  found", ", ".join(step.added for step in found.steps) or "nothing")
    yield Measured(f"{words}, {size}", wall, 90.0, "s")


DECISIONS = (
    ("remus_diving_plane", None), ("online_ship", None), ("kvlcc2", "mmg"),
    ("nomoto_sparse_heading", None), ("torpedo", None), ("remus_6dof", None), ("esso_osaka", None),
)  # fmt: skip


def decision() -> Iterator[Measured]:
    """To stop or to go on (`decide`) over the library that `campaign` makes, in a moderate sea.

    Known is one run, the goal is half of the errors that it leaves; the first call, which compiles,
    and the least of three others.
    """
    from oed_sysid.design import ParameterGoal, candidate_runs, decide
    from oed_sysid.design.vehicles import draw_models
    from oed_sysid.information import information_of, sea_noise

    for name, variant in DECISIONS:
        problem, rng = load_problem(name, variant=variant), np.random.default_rng(0)
        model, patterns = problem.model, list(problem.experiments.values())
        vehicles = draw_models(model, 0.1, 4, None, rng)
        runs = candidate_runs(model, patterns, limits=problem.limits, rng=rng, vehicles=vehicles)
        sea = sea_noise(model, "moderate", patterns)
        known = information_of(model, runs[0].experiment, noise=sea)
        goals = [
            ParameterGoal(n, float(np.clip(0.5 * e / model.parameter(n).reference, 1e-6, 5.0)))
            for n, e in zip(known.names, known.std_errors, strict=True)
        ]
        taken = []
        for _ in range(4):
            began = time.process_time()
            decide(model, runs, goals, rng=np.random.default_rng(0), noise=sea, prior=known)
            taken.append(time.process_time() - began)
        samples = max(len(run.experiment.times) for run in runs)
        words = f"{name}: {len(goals)} parameters, {len(runs)} runs of {samples} samples"
        yield Measured(f"{words}, first {taken[0]:.2f} s, again", min(taken[1:]), 1.0, "s")


# -- fresh processes --------------------------------------------------------------------

IMPORT = "import oed_sysid"
# What a user's first lines do: load a problem, read a record from a CSV file, fit.
PREPARE = (
    "import sys, numpy as np; from oed_sysid import load_problem, write_csv; "
    "from oed_sysid.experiments.simulation import simulate; "
    "p = load_problem('remus_diving_plane'); "
    "r = simulate(p.model, p.experiment('steps'), rng=np.random.default_rng(0)); "
    "write_csv(r, sys.argv[1])"
)
FIT = (
    "import sys; from oed_sysid import MultipleShooting, load_problem, read_csv; "
    "p = load_problem('remus_diving_plane'); d = read_csv(sys.argv[1], p.channels); "
    "m = p.model.with_values({n: 0.7 * p.model.values[n] for n in p.model.free_names}); "
    "print(MultipleShooting(disturbances='none').fit(m, d).status.code)"
)
COMPILE = (
    "from oed_sysid import load_problem; from oed_sysid.compiled.kernels import kernel; "
    "kernel(load_problem('remus_diving_plane').model).library"
)


def fresh(
    code: str, *arguments: str, repeats: int = 1, **environment: str
) -> tuple[float, str, str]:
    """Least processor time of fresh processes that run some code, s, and what they said."""

    def children() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    # Modules are translated once, as on a user's machine.
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    found = []
    for _ in range(repeats):
        began = children()
        done = subprocess.run(
            [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True,
            env={**kept, **ONE_THREAD, **environment},
        )  # fmt: skip
        found.append(children() - began)
    return min(found), done.stdout, done.stderr


def startup() -> Iterator[Measured]:
    """Import, first fit and first compilation in fresh processes."""
    bare, _, _ = fresh("pass", repeats=7)
    light, _, _ = fresh(IMPORT, repeats=7)
    with tempfile.TemporaryDirectory() as folder:
        data = f"{folder}/dive.csv"
        fresh(PREPARE, data)
        fresh(FIT, data)
        began = time.perf_counter()
        fit, said, _ = fresh(FIT, data, repeats=5)
        clock = (time.perf_counter() - began) / 5
        assert said.strip() == "converged", said
        empty = {"OED_SYSID_CACHE": f"{folder}/cache"}
        cold, _, message = fresh(COMPILE, **empty)
        warm, _, silent = fresh(COMPILE, repeats=3, **empty)
    assert not silent, silent
    print(f"an empty Python process takes {bare:.2f} s of each; a first fit {clock:.2f} s by clock")
    yield Measured("import oed_sysid, whole process", light, 0.5, "s")
    yield Measured("first fit in a fresh process, kernel cached", fit, 1.5, "s")
    yield Measured("cold compilation, beyond the same with a cache", cold - warm, 5.0, "s")
    print(f"message while compiling: {message.strip()}")


def reading(call: Callable[[], Any]) -> None:
    """Print processor time (s) and growth of the peak memory (bytes) of a call."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    call()
    spent = time.process_time() - began
    print(spent, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024)


def by_pandas(path: str) -> None:
    """Numbers of a file by pandas."""
    import pandas

    reading(lambda: pandas.read_csv(path))


def by_records(path: str) -> None:
    """Records of a file."""
    outputs = tuple(map(Output, ("theta", "q", "z", "u"), ("rad", "rad/s", "m", "m/s")))
    channels = Channels((Input("fin", "rad"),), outputs)
    reading(lambda: read_csv(path, channels))


def tables() -> Iterator[Measured]:
    """Records of a CSV file of 2,000,000 rows and six columns, beside its numbers by pandas.

    Units, channels and all checks included; fresh processes, imports not counted.
    """
    rows = 2_000_000
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.csv"
        with path.open("w") as stream:
            stream.write("t [s],fin [deg],theta [deg],q [deg/s],z [m],u [m/s]\n")
            for first in range(0, rows, 100_000):
                n = min(100_000, rows - first)
                part = np.cumsum(rng.normal(size=(n, 6)), axis=0) * 1e-3
                part[:, 0] = 0.01 * (first + np.arange(n))
                np.savetxt(stream, part, "%.6f", ",")
        found = {}
        for name in ("by_pandas", "by_records"):
            code = f"import sys; from benchmarks.speed import {name}; {name}(sys.argv[1])"
            told = [fresh(code, str(path))[1].split()[-2:] for _ in range(5)]
            found[name] = np.array(told, dtype=float).min(axis=0)
    (ours, memory), (theirs, least_memory) = found["by_records"], found["by_pandas"]
    print(f"records {ours:.2f} s, {memory / 2**20:.0f} MiB; pandas {theirs:.2f} s, "
          f"{least_memory / 2**20:.0f} MiB")  # fmt: skip
    yield Measured(
        f"records of a CSV file of {rows:,} rows over numbers by pandas, time", ours / theirs, 4.0
    )
    yield Measured("the same, growth of memory", memory / least_memory, 2.0)


PARTS: dict[str, Callable[[], Iterator[Measured]]] = {
    part.__name__: part
    for part in (
        kernel, information, startup, score, growth, swarm, fit_speed, likelihood, long_search,
        six_degrees, decision, tables,
    )
}  # fmt: skip


def main(names: Sequence[str] = tuple(PARTS)) -> None:
    """Measure what is named.

    Parameters
    ----------
    names : sequence of str
        parts; all without a name
    """
    print(machine())
    for name in [known(name, PARTS, "part") for name in names]:
        print(f"\n{name}", flush=True)
        for row in PARTS[name]():
            print(row, flush=True)


if __name__ == "__main__":
    command(main)
