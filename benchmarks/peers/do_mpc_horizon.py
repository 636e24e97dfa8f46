"""do-mpc: moving-horizon estimation with one horizon over the whole record."""

from __future__ import annotations

import time
import warnings

import casadi as ca
import numpy as np

warnings.filterwarnings("ignore")

import do_mpc  # noqa: E402

from benchmarks.peers.task import NOISE, STEP, TRUE, load, rates, report, share  # noqa: E402


def main() -> None:
    """Collocation between samples; parameters estimated, no arrival cost to speak of."""
    _, inputs, outputs = load()
    n = len(outputs)
    began = time.process_time()
    model = do_mpc.model.Model("continuous")
    x = [model.set_variable("_x", name) for name in ("u", "w", "q", "theta", "z")]
    command = [model.set_variable("_u", name) for name in ("fin", "thrust")]
    shares = [model.set_variable("_p", f"share{j}") for j in range(8)]
    slopes = rates(x, command, [s * v for s, v in zip(shares, TRUE, strict=True)], ca.sin, ca.cos)
    for state, slope in zip(("u", "w", "q", "theta", "z"), slopes, strict=True):
        model.set_rhs(state, slope)
        model.set_meas(f"{state}_m", model.x[state], meas_noise=True)
    for name in ("fin", "thrust"):
        model.set_meas(f"{name}_m", model.u[name], meas_noise=False)
    model.setup()
    horizon = do_mpc.estimator.MHE(model, [f"share{j}" for j in range(8)])
    horizon.set_param(
        n_horizon=n - 1,
        t_step=STEP,
        store_full_solution=False,
        meas_from_data=True,
        nlpsol_opts={"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0},
    )
    horizon.set_default_objective(1e-6 * np.eye(5), np.diag(NOISE**-2.0), 1e-6 * np.eye(8))
    horizon.setup()
    build = time.process_time() - began

    def solve() -> np.ndarray:
        horizon.x0, horizon.p_est0 = outputs[0], np.full(8, share())
        horizon.set_initial_guess()
        # Its own guess keeps the first state throughout and ends in another optimum.
        for k, y in enumerate(outputs):
            horizon.opt_x_num["_x", k] = [y] * len(horizon.opt_x_num["_x", k])
            if k + 1 < n:
                horizon.opt_x_num["_u", k] = inputs[k]
        # A measurement belongs to the end of an interval, its command to the whole of it.
        rows = np.hstack([outputs[1:], inputs[:-1]])
        for row in rows[:-1]:
            horizon.data.update(_y=row)
        horizon.make_step(rows[-1])
        if not horizon.solver_stats["success"]:
            raise RuntimeError(horizon.solver_stats["return_status"])
        return np.array(horizon.p_est0.cat).ravel() * TRUE

    report(solve, build)


if __name__ == "__main__":
    main()
