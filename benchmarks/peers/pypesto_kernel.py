"""pyPESTO with a least-squares optimiser, fed residuals and sensitivities by our own kernel."""

from __future__ import annotations

import numpy as np
import pypesto
import pypesto.optimize

from benchmarks.peers.task import NAMES, NOISE, begin, load, report
from oed_sysid import load_problem
from oed_sysid.compiled.kernels import kernel


def main() -> None:
    """One start, SciPy's trust-region method, exact sensitivities."""
    times, inputs, outputs = load()
    model = load_problem("remus_diving_plane").model
    runner, values = kernel(model), model.value_vector
    columns = [model.parameter_names.index(name) for name in NAMES]
    order = [5 + model.free_names.index(name) for name in NAMES] + list(range(5))
    start = begin(outputs)
    scale = np.where(start != 0, np.abs(start), 1.0)
    last: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def both(shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = np.asarray(shares).tobytes()
        if key not in last:
            unknowns = shares * scale
            trial = values.copy()
            trial[columns] = unknowns[:8]
            run = runner.run(times, inputs, trial, unknowns[8:], sensitivities=True)
            residual = np.nan_to_num((run.outputs - outputs) / NOISE, nan=1e6)
            slope = run.output_sensitivities[:, :, order] * scale / NOISE[:, None]
            last.clear()
            last[key] = residual.ravel(), np.nan_to_num(slope.reshape(-1, 13))
        return last[key]

    # Far bounds: pyPESTO asks for finite ones.
    shares = start / scale
    objective = pypesto.Objective(res=lambda x: both(x)[0], sres=lambda x: both(x)[1])
    problem = pypesto.Problem(
        objective, lb=shares - 5, ub=shares + 5, x_guesses=[shares], copy_objective=False
    )

    def solve() -> np.ndarray:
        result = pypesto.optimize.minimize(
            problem,
            optimizer=pypesto.optimize.ScipyOptimizer(method="ls_trf"),
            n_starts=1,
            progress_bar=False,
            filename=None,
        )
        return (result.optimize_result.x[0] * scale)[:8]

    solve()
    report(solve, repeats=5)


if __name__ == "__main__":
    main()
