"""Multiple shooting with IPOPT as CasADi's manual and its ``sysid.py`` example teach."""

from __future__ import annotations

import time

import casadi as ca
import numpy as np

from benchmarks.peers.task import NOISE, STEP, begin, load, rates, report


def main() -> None:
    """Gauss-Newton Hessian, exact jacobian, one node per sample, mapped integrator."""
    times, inputs, outputs = load()
    n = len(times)
    began = time.process_time()
    x, u, p = ca.MX.sym("x", 5), ca.MX.sym("u", 2), ca.MX.sym("p", 8)
    slopes = rates(ca.vertsplit(x), ca.vertsplit(u), ca.vertsplit(p), ca.sin, ca.cos)
    f = ca.Function("f", [x, u, p], [ca.vertcat(*slopes)])
    k1 = f(x, u, p)
    k2 = f(x + STEP / 2 * k1, u, p)
    k3 = f(x + STEP / 2 * k2, u, p)
    k4 = f(x + STEP * k3, u, p)
    step = ca.Function("step", [x, u, p], [x + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    start = begin(outputs)
    scale = np.abs(start[:8])
    shares, nodes = ca.MX.sym("shares", 8), ca.MX.sym("X", 5, n)
    following = step.map(n - 1, "serial")(
        nodes[:, :-1], inputs[:-1].T, ca.repmat(shares * scale, 1, n - 1)
    )
    gaps = ca.vec(nodes[:, 1:] - following)
    residual = ca.vec((nodes - outputs.T) / NOISE)
    unknowns = ca.veccat(shares, nodes)
    jacobian = ca.jacobian(residual, unknowns)
    hessian = ca.triu(ca.mtimes(jacobian.T, jacobian))
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lam", gaps.shape[0])
    gauss_newton = ca.Function(
        "hess_lag", [unknowns, ca.MX(0, 1), sigma, multipliers], [sigma * hessian]
    )
    problem = {"x": unknowns, "f": 0.5 * ca.dot(residual, residual), "g": gaps}
    options = {
        "hess_lag": gauss_newton, "print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes",
    }  # fmt: skip
    solver = ca.nlpsol("solver", "ipopt", problem, options)
    build = time.process_time() - began
    guess = np.concatenate([start[:8] / scale, outputs.ravel()])

    def solve() -> np.ndarray:
        found = np.array(solver(x0=guess, lbg=0, ubg=0)["x"]).ravel()
        if not solver.stats()["success"]:
            raise RuntimeError(solver.stats()["return_status"])
        return found[:8] * scale

    report(solve, build, repeats=3)


if __name__ == "__main__":
    main()
