"""Trajectory and all sensitivities: ours, the bare compiled loop, CasADi as its manual teaches.

    OMP_NUM_THREADS=1 python -m benchmarks.kernel

A record of the diving plane of a REMUS-like vehicle: 2,400 samples of 0.1 s,
five outputs, derivatives by twelve parameters and five initial states. *Bare*
is the same compiled code called in a loop by a C program that owns its buffers:
what is above it is the price of Python, of checks and of fresh arrays.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from benchmarks.measure import least, machine, verdict
from oed_sysid import load_problem
from oed_sysid.compiled import graph as graphs
from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.physics.model import Model

N_SAMPLES, STEP = 2400, 0.1
EXTRA = ("X_udot", "Z_wdot", "M_wdot", "M_qdot")
REPEATS, ROUNDS = 60, 5


@dataclass(frozen=True, eq=False)
class Task:
    """One record to simulate with sensitivities."""

    model: Model
    kernel: Kernel
    times: np.ndarray
    inputs: np.ndarray
    start: np.ndarray

    def run(self) -> np.ndarray:
        """Sensitivities ``(n_times, n_outputs, n_columns)`` from our kernel."""
        run = self.kernel.run(
            self.times, self.inputs, self.model.value_vector, self.start, sensitivities=True
        )
        assert run.output_sensitivities is not None
        return run.output_sensitivities


def task() -> Task:
    """The task of this benchmark."""
    model = load_problem("remus_diving_plane").model.free(*EXTRA)
    times = np.arange(N_SAMPLES) * STEP
    fin = 0.1 * np.sign(np.sin(0.5 * times)) + 0.05 * np.sin(1.3 * times)
    inputs = np.column_stack([fin, np.full(N_SAMPLES, 9.0)])
    return Task(model, kernel(model), times, inputs, np.array([1.5, 0.0, 0.0, 0.0, 10.0]))


def build_loop(folder: Path) -> Path:
    """Compile the C program that calls the kernel in a loop."""
    compiler = next(filter(None, map(shutil.which, ("gcc", "clang", "cc"))))
    program, code = folder / "kernel_loop", Path(__file__).with_name("kernel_loop.c")
    subprocess.run([compiler, "-O2", str(code), "-o", str(program), "-ldl"], check=True)
    return program


def bare(job: Task, program: Path, folder: Path) -> tuple[float, float]:
    """Least time of a call from C, s, and the sum of all sensitivities."""
    k, data = job.kernel, folder / "task.bin"
    sizes = (N_SAMPLES, k.n_inputs, k.n_parameters, k.n_full, k.n_outputs, k.n_columns)
    with data.open("wb") as file:
        file.write(np.array(sizes, dtype=np.intc).tobytes())
        for part in (job.model.step, job.times, job.inputs, job.model.value_vector, job.start):
            file.write(np.asarray(part, dtype=float).tobytes())
    library = k._library._name
    told = subprocess.run(
        [program, library, data, str(REPEATS)], check=True, capture_output=True, text=True
    ).stdout.split()
    return float(told[0]), float(told[1])


def by_manual(job: Task) -> ca.Function:
    """``mapaccum`` over the record, and the jacobian of all outputs.

    CasADi 3.x user guide, sections on map and mapaccum and on differentiation.
    """
    graph, values = graphs.build(job.model), job.model.value_vector
    free = [job.model.parameter_names.index(name) for name in job.model.free_names]
    z0, unknown = ca.MX.sym("z0", 5), ca.MX.sym("p", len(free))
    parameters = ca.MX(values)
    for position, index in enumerate(free):
        parameters[index] = unknown[position]
    z, u, q = ca.MX.sym("z", 5), ca.MX.sym("u", 2), ca.MX.sym("q", len(values))
    step = ca.Function("step", [z, u, q], [graph.advance(z, u, u, q, 0.0, STEP)])
    path = step.mapaccum("path", N_SAMPLES - 1)(
        z0, job.inputs[:-1].T, ca.repmat(parameters, 1, N_SAMPLES - 1)
    )
    # The outputs of this model are its states.
    outputs = ca.vec(ca.horzcat(z0, path))
    return ca.Function("J", [z0, unknown], [outputs, ca.jacobian(outputs, ca.vertcat(z0, unknown))])


def main() -> None:
    """Print the ratios."""
    job = task()
    free = [job.model.values[name] for name in job.model.free_names]
    began = time.perf_counter()
    manual = by_manual(job)
    built = time.perf_counter() - began
    ours = job.run()
    theirs = np.array(manual(job.start, free)[1]).reshape(ours.shape)
    difference = float(np.max(np.abs(ours - theirs) / np.abs(ours).max(axis=(0, 1))))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = build_loop(folder)
        # Both in turn, several times: other loads on the machine come and go.
        rounds = [(least(job.run, REPEATS), bare(job, program, folder)) for _ in range(ROUNDS)]
    t_ours = min(ours for ours, _ in rounds)
    t_bare = min(found[0] for _, found in rounds)
    assert abs(rounds[0][1][1] - ours.sum()) < 1e-9 * np.abs(ours).sum()
    t_manual = least(lambda: manual(job.start, free), 5)
    print(machine())
    print(
        f"{N_SAMPLES} samples, 5 outputs, {len(free)} parameters + 5 initial states: bare C loop "
        f"{1e3 * t_bare:.3f} ms, ours {1e3 * t_ours:.3f} ms, CasADi jacobian "
        f"{1e3 * t_manual:.1f} ms (built in {built:.2f} s); largest relative difference of ours "
        f"to CasADi's {difference:.1e}"
    )
    print(verdict("ours / bare C loop", t_ours / t_bare, 1.3))
    print(f"CasADi's jacobian / ours: {t_manual / t_ours:.0f}")


if __name__ == "__main__":
    main()
