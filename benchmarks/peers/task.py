"""The task that every peer solves, written without this project's own model.

Fit eight derivatives and five initial states of the diving plane of a
REMUS-like vehicle to one record of 2,400 samples of five outputs, by least
squares weighted with the noise, from derivatives that are too small. Commands are
held between samples, one Runge-Kutta step of fourth order per sample.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version

import numpy as np

from benchmarks.truth import TRUE

STEP = 0.1


def load() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times ``(n,)``, commands ``(n, 2)``, measured outputs ``(n, 5)``, and unknowns at the start.

    These are wrong derivatives, then the first measurement.
    """
    with np.load(sys.argv[-1]) as file:
        outputs = file["outputs"]
        start = np.concatenate([share() * TRUE, outputs[0]])
        return file["times"], file["inputs"], outputs, start


def share() -> float:
    """Start values as a share of the true ones."""
    with np.load(sys.argv[-1]) as file:
        return float(file["share"])


def used() -> float:
    """Processor time of this process and of the programs it has called, s."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def report(
    packages: Sequence[str], solve: Callable[[], np.ndarray], build: float = 0.0, repeats: int = 1
) -> None:
    """Time a solution and print it as JSON, with its estimates and the versions of packages."""
    taken = []
    for _ in range(repeats):
        began = used()
        found = solve()
        taken.append(used() - began)
    result = {
        "seconds": min(taken),
        "build": build,
        "estimates": np.asarray(found).tolist(),
        "versions": {name: version(name) for name in packages},
    }
    print(json.dumps(result))
