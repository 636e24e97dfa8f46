"""PINTS: its CMA-ES on the sum of squares, as its examples do, over the numba simulator."""

from __future__ import annotations

import numpy as np
import pints

from benchmarks.peers.simulator import residuals
from benchmarks.peers.task import begin, load, report


class _Error(pints.ErrorMeasure):
    """Half the weighted sum of squares, by shares of the start values."""

    def __init__(self, inputs: np.ndarray, outputs: np.ndarray, scale: np.ndarray) -> None:
        self.inputs, self.outputs, self.scale = inputs, outputs, scale

    def __call__(self, shares: np.ndarray) -> float:
        found = residuals(np.asarray(shares) * self.scale, self.inputs, self.outputs)
        return float(min(0.5 * found @ found, 1e15))

    def n_parameters(self) -> int:
        return len(self.scale)


def main() -> None:
    """One optimisation with default stopping rules."""
    _, inputs, outputs = load()
    start = begin(outputs)
    scale = np.where(start != 0, np.abs(start), 1.0)
    error = _Error(inputs, outputs, scale)
    error(start / scale)
    np.random.seed(1)  # noqa: NPY002  (PINTS draws from the global generator)

    def solve() -> np.ndarray:
        controller = pints.OptimisationController(
            error, start / scale, sigma0=0.1 * np.ones(13), method=pints.CMAES
        )
        controller.set_log_to_screen(False)
        controller.set_max_iterations(3000)
        return (controller.run()[0] * scale)[:8]

    report(solve)


if __name__ == "__main__":
    main()
