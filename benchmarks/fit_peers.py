"""The same fit by us and by other people's tools: how long, and does it arrive.

    OMP_NUM_THREADS=1 python -m benchmarks.documents performance --write --only peers

The task and how each peer is used stand in :mod:`benchmarks.peers.fits`. Every peer runs in a
process of its own, with the first interpreter of ``PEERS_PYTHON`` that has it (``pip install do-mpc
numba optimistix jax pypesto[amici,petab,fides] antimony swig pyomo pandas``). Times are processor
times of the solution alone. *Off* is the largest distance from our estimates in our standard
errors: the optimum is the same, so more than about one means that it was not found, and the time of
such a peer says nothing.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness import ONE_THREAD, ROOT, Row, dive, ignorant, scaled
from benchmarks.peers.fits import STEP
from benchmarks.truth import NAMES
from oed_sysid import Dataset, Fit, Model, MultipleShooting, load_problem

N_SAMPLES, LONGEST = 2400, 240.0
STARTS = (0.7, 0.97)  # over the true values
# Of `benchmarks.peers.fits`: what each is, and how many times faster than it we want to be.
PEERS = {
    "casadi_expanded": ("CasADi, multiple shooting, expanded", 20.0),
    "casadi_generated": ("CasADi, the same as generated C", 20.0),
    "do_mpc_window": ("do-mpc, one window of its MHE", 20.0),
    "scipy_numba": ("SciPy, differences over a numba simulator", 2.0),
    "optimistix_scan": ("Optimistix over a JAX scan", 2.0),
    "pypesto_amici": ("pyPESTO over AMICI", 2.0),
    "parmest_collocation": ("Pyomo parmest, trapezoidal rule", 50.0),
}


def task(share: float, n_samples: int = N_SAMPLES) -> tuple[Model, Dataset]:
    """Our model at the start values, priors dropped, and the record."""
    model = load_problem("remus_diving_plane").model
    record = dive(model, STEP * np.arange(n_samples))
    return ignorant(scaled(model, share)), Dataset((record,))


def ours(model: Model, data: Dataset, repeats: int = 12) -> tuple[float, Fit]:
    """Least processor time, s, and the fit."""
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        fit = MultipleShooting(disturbances="none", noise="given").fit(model, data)
        taken.append(time.process_time() - began)
    return min(taken), fit


def run_peer(
    words: Sequence[str], data: Path, pythons: Sequence[str], longest: float = LONGEST
) -> Row | str:
    """What a peer found, or why it is left out; after so many seconds it is ended."""
    found: Row | str = "no interpreter"
    for python in pythons:
        found = _run(words, data, python, longest)
        if isinstance(found, dict):
            break
    return found


def _run(words: Sequence[str], data: Path, python: str, longest: float) -> Row | str:
    # Where there is no program ipopt, the one beside the peers stands in.
    places = Path(python).parent, os.environ["PATH"], ROOT / "benchmarks" / "peers"
    environment = {
        **os.environ, **ONE_THREAD, "PYTHONPATH": str(ROOT), "CASADI_PYTHON": sys.executable,
        "PATH": os.pathsep.join(map(str, places)),
    }  # fmt: skip
    command = [python, "-m", *words, str(data)]
    # In a group of its own, so that programs which the peer has called end with it.
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
        start_new_session=True,
    ) as peer:  # fmt: skip
        try:
            output, errors = peer.communicate(timeout=longest)
        except subprocess.TimeoutExpired:
            return f"no result after {longest:.0f} s on the clock"
        finally:
            if peer.poll() is None:
                os.killpg(peer.pid, signal.SIGKILL)
    lines = [line for line in output.splitlines() if line.startswith("{")]
    if peer.returncode or not lines:
        return f"left out: {(errors.strip().splitlines() or ['no output'])[-1][:90]}"
    return json.loads(lines[-1])


def compared(names: Sequence[str], share: float, pythons: Sequence[str]) -> Iterator[Row]:
    """Our fit, then each peer's, from one start."""
    model, data = task(share)
    seconds, fit = ours(model, data)
    assert fit.status.ok, fit.status
    best = np.array([fit.values[name] for name in NAMES])
    errors = np.array([fit.std_errors[name] for name in NAMES])
    yield {"name": "", "start": share, "seconds": seconds}
    with tempfile.TemporaryDirectory() as folder:
        path, record = Path(folder) / "dive.npz", data[0]
        np.savez(
            path, times=record.times, inputs=record.inputs, outputs=record.outputs, share=share
        )
        for name in names:
            found = run_peer(("benchmarks.peers.fits", name), path, pythons)
            title, target = PEERS[name]
            row = {"name": name, "title": title, "target": target, "start": share}
            if isinstance(found, str):
                yield {**row, "left_out": found}
                continue
            # Again beside each peer: other loads on the machine come and go.
            seconds = min(seconds, ours(model, data, 6)[0])
            off = float(np.max(np.abs(np.array(found["estimates"]) - best) / errors))
            ratio = found["seconds"] / seconds
            yield {**row, **found, "off": off, "ours": seconds, "ratio": ratio}


def pythons() -> list[str]:
    """Interpreters that ``PEERS_PYTHON`` names, else this one."""
    return os.environ.get("PEERS_PYTHON", sys.executable).split(os.pathsep)
