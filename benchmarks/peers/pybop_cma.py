"""PyBOP: its CMA-ES on its sum of squared errors, over the numba simulator."""

from __future__ import annotations

import numpy as np
import pybop

from benchmarks.peers.simulator import simulate
from benchmarks.peers.task import NOISE, begin, load, report

SIGNALS = [f"output {j}" for j in range(5)]


class _Simulator(pybop.BaseSimulator):
    """Outputs in units of their noise, by shares of the start values.

    A twentieth of the distance between bounds is the first spread: 0.1, as for PINTS.
    """

    def __init__(self, inputs: np.ndarray, scale: np.ndarray, shares: np.ndarray) -> None:
        self.inputs, self.scale = inputs, scale
        super().__init__(
            {
                f"share {j}": pybop.Parameter(initial_value=v, bounds=(v - 1.0, v + 1.0))
                for j, v in enumerate(shares)
            }
        )

    def solve_batch(self, inputs: list, calculate_sensitivities: bool = False) -> list:
        solutions = []
        for shares in inputs:
            unknowns = np.array([shares[f"share {j}"] for j in range(13)], dtype=float) * self.scale
            path = simulate(self.inputs, unknowns[:8], unknowns[8:]) / NOISE
            solution = pybop.Solution(shares)
            for j, name in enumerate(SIGNALS):
                column = np.clip(np.nan_to_num(path[:, j], nan=1e6), -1e6, 1e6)
                solution.set_solution_variable(name, data=column)
            solutions.append(solution)
        return solutions


def main() -> None:
    """One optimisation with default stopping rules but more iterations."""
    times, inputs, outputs = load()
    start = begin(outputs)
    scale = np.where(start != 0, np.abs(start), 1.0)
    simulate(inputs, start[:8], start[8:])
    data = {"Time [s]": times}
    data |= {name: outputs[:, j] / NOISE[j] for j, name in enumerate(SIGNALS)}
    cost = pybop.SumSquaredError(pybop.Dataset(data), target=SIGNALS)
    np.random.seed(1)  # noqa: NPY002  (PINTS draws from the global generator)

    def solve() -> np.ndarray:
        problem = pybop.Problem(_Simulator(inputs, scale, start / scale), cost)
        # A gain of one hundredth, the default, is no end; PINTS itself stops at 1e-11. (A relative
        # tolerance of zero times the first best value, infinity, would end nothing but patience.)
        options = pybop.PintsOptions(
            max_iterations=3000,
            max_unchanged_iterations=200,
            relative_tolerance=1e-12,
            absolute_tolerance=1e-11,
        )
        return (np.array(pybop.CMAES(problem, options=options).run().x) * scale)[:8]

    report(solve)


if __name__ == "__main__":
    main()
