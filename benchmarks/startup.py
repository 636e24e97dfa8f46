"""How long it takes from nothing to a result: import, first fit, first compilation.

    OMP_NUM_THREADS=1 python -m benchmarks.startup

Everything in fresh processes. *Import* and *first fit* have files in the disk
cache of the operating system and the kernel in that of the package; *cold*
compiles the kernel, which happens once per model structure and says so.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time

from benchmarks.measure import machine, verdict

IMPORT = "import oed_sysid"
# What a user's first lines do: load a problem, read a record from a CSV file, fit.
PREPARE = (
    "import sys, numpy as np; from oed_sysid import load_problem, write_csv; "
    "from oed_sysid import simulate; p = load_problem('remus_diving_plane'); "
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
    "kernel(load_problem('remus_diving_plane').model)"
)


def children() -> float:
    """Processor time of all child processes so far, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def seconds(code: str, repeats: int, *arguments: str, **environment: str) -> tuple[float, str, str]:
    """Least processor time of fresh processes that run some code; what they said."""
    found = []
    for _ in range(repeats):
        began = children()
        done = subprocess.run(
            [sys.executable, "-c", code, *arguments],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"} | environment,
        )
        found.append(children() - began)
    return min(found), done.stdout, done.stderr


def main() -> None:
    """Print the times."""
    print(machine())
    bare, _, _ = seconds("pass", 7)
    light, _, _ = seconds(IMPORT, 7)
    with tempfile.TemporaryDirectory() as folder:
        data = f"{folder}/dive.csv"
        seconds(PREPARE, 1, data)
        seconds(FIT, 1, data)
        began = time.perf_counter()
        fit, said, _ = seconds(FIT, 5, data)
        clock = (time.perf_counter() - began) / 5
        assert said.strip() == "converged", said
        empty = {"OED_SYSID_CACHE": f"{folder}/cache"}
        cold, _, message = seconds(COMPILE, 1, **empty)
        warm, _, silent = seconds(COMPILE, 3, **empty)
    assert not silent, silent
    print(f"an empty Python process takes {bare:.2f} s of each; a first fit {clock:.2f} s by clock")
    print(verdict("import oed_sysid, whole process", light, 0.5, "s"))
    print(verdict("first fit in a fresh process, kernel cached", fit, 1.5, "s"))
    print(verdict("cold compilation, beyond the same with a cache", cold - warm, 5.0, "s"))
    print(f"message while compiling: {message.strip()}")


if __name__ == "__main__":
    main()
