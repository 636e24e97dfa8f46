"""SciPy's least squares with finite differences over a numba-compiled simulator."""

from __future__ import annotations

import time

import numpy as np
from scipy.optimize import least_squares

from benchmarks.peers.simulator import residuals
from benchmarks.peers.task import begin, load, report


def main() -> None:
    """Trust-region reflective method, unknowns scaled by the jacobian."""
    _, inputs, outputs = load()
    start = begin(outputs)
    began = time.process_time()
    residuals(start, inputs, outputs)
    build = time.process_time() - began

    def solve() -> np.ndarray:
        found = least_squares(residuals, start, x_scale="jac", args=(inputs, outputs))
        return found.x[:8]

    report(solve, build, repeats=7)


if __name__ == "__main__":
    main()
