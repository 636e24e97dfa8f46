"""The same fit by us and by other people's tools: how long, and does it arrive.

    OMP_NUM_THREADS=1 python -m benchmarks.fit_peers [names] [--python PATH]

One record of 2,400 samples of five outputs, eight derivatives 30 % too small
(``--share 0.7``) and five unknown initial states
(:mod:`benchmarks.peers.task`). Every peer runs in a process of its own, with the
interpreter of ``--python``; what is not installed there is left out and said
so (``pip install "oed-sysid[bench]"``). Times are processor
times of the solution alone; building a solver is listed beside it.
*Off* is the largest distance from our estimates in our standard errors: the
optimum is the same, so more than about one means that it was not found, and
the time of such a peer says nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness import ONE_THREAD, dive, ignorant, machine, scaled, verdict
from benchmarks.peers.task import STEP
from benchmarks.truth import NAMES
from oed_sysid import Dataset, Fit, MultipleShooting, load_problem
from oed_sysid.physics.model import Model

N_SAMPLES, LONGEST = 2400, 240.0
# Of `benchmarks.peers.fits`, and how many times faster than it we want to be.
PEERS = {
    "casadi_shooting": 10.0,
    "scipy_numba": 2.0,
    "parmest_collocation": 50.0,
    "pints_cma": 50.0,
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


def run_peer(words: Sequence[str], data: Path, python: str, longest: float = LONGEST) -> dict | str:
    """What a peer found, or why it is left out; after so many seconds it is ended."""
    environment = {
        **os.environ, **ONE_THREAD, "PYTHONPATH": str(Path(__file__).resolve().parent.parent),
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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("peers", nargs="*", default=list(PEERS))
    parser.add_argument("--python", default=sys.executable, help="interpreter that has the peers")
    parser.add_argument("--share", type=float, default=0.7, help="start values over true ones")
    parser.add_argument("--samples", type=int, default=N_SAMPLES, help="length of the record")
    options = parser.parse_args()
    model, data = task(options.share, options.samples)
    seconds, fit = ours(model, data)
    assert fit.status.ok, fit.status
    best = np.array([fit.values[name] for name in NAMES])
    errors = np.array([fit.std_errors[name] for name in NAMES])
    print(machine())
    print(f"{'':22} {'solve, s':>9} {'build, s':>9} {'off':>8}   times ours")
    print(f"{'multiple shooting':22} {seconds:>9.4f} {'':>9} {0.0:>8.2f}   1")
    lines = [verdict(f"our fit of {options.samples:,} samples", 1e3 * seconds, 40.0, "ms")]
    with tempfile.TemporaryDirectory() as folder:
        path, record = Path(folder) / "dive.npz", data[0]
        np.savez(
            path,
            times=record.times,
            inputs=record.inputs,
            outputs=record.outputs,
            share=options.share,
        )
        for name in options.peers:
            found = run_peer(("benchmarks.peers.fits", name), path, options.python)
            # Again beside each peer: other loads on the machine come and go.
            seconds = min(seconds, ours(model, data, 6)[0]) if isinstance(found, dict) else seconds
            if isinstance(found, str):
                print(f"{name:22} {found}", flush=True)
                continue
            off = np.max(np.abs(np.array(found["estimates"]) - best) / errors)
            ratio = found["seconds"] / seconds
            print(
                f"{name:22} {found['seconds']:>9.4f} {found['build']:>9.2f} {off:>8.2f}   "
                f"{ratio:.1f}",
                flush=True,
            )
            if off < 1.0:
                lines.append(verdict(f"{name} / ours", ratio, PEERS[name], at_most=False))
    print("\n".join(lines))


if __name__ == "__main__":
    main()
