"""Fits by other people's tools, one of a kind; each is run in a process of its own.

    python -m benchmarks.peers.fits casadi_shooting dive.npz

casadi_shooting
    Multiple shooting with IPOPT as CasADi's manual and its ``sysid.py`` example teach:
    Gauss-Newton Hessian, exact jacobian, one node per sample, mapped integrator.
scipy_numba
    SciPy's trust-region least squares with finite differences over a numba-compiled simulator.
parmest_collocation
    Pyomo parmest: the discretised model as algebraic equations, trapezoidal rule, by IPOPT.
pints_cma
    PINTS: its CMA-ES on the sum of squares over the numba simulator, default stopping rules.
"""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Callable

import numpy as np

from benchmarks.peers.task import STEP, begin, load, report, share
from benchmarks.truth import NOISE, TRUE, rates, runge_kutta

Solver = Callable[[], np.ndarray]


def casadi_shooting() -> tuple[Solver, float, int]:
    """What solves, how long it took to build, s, and how often to time it."""
    import casadi as ca

    times, inputs, outputs = load()
    n = len(times)
    began = time.process_time()
    x, u, p = ca.MX.sym("x", 5), ca.MX.sym("u", 2), ca.MX.sym("p", 8)
    slopes = rates(ca.vertsplit(x), ca.vertsplit(u), ca.vertsplit(p), ca.sin, ca.cos)
    f = ca.Function("f", [x, u, p], [ca.vertcat(*slopes)])
    step = ca.Function("step", [x, u, p], [runge_kutta(lambda z, _: f(z, u, p), x, STEP)])
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

    return solve, build, 3


def compiled() -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Weighted residuals ``(n * 5,)`` by numba; large where the model diverges."""
    from numba import njit

    slopes = njit(rates)

    @njit
    def simulate(inputs, p, x0):  # type: ignore[no-untyped-def]
        n = len(inputs)
        path, k, x = np.empty((n, 5)), np.empty((4, 5)), x0.copy()
        for i in range(n):
            path[i] = x
            for stage in range(4):
                h = 0.0 if stage == 0 else (STEP if stage == 3 else STEP / 2)
                y = x + h * k[stage - 1] if stage else x
                found = slopes(y, inputs[i], p, math.sin, math.cos)
                for j in range(5):
                    k[stage, j] = found[j]
            x = x + STEP / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
        return path

    def residuals(unknowns: np.ndarray, inputs: np.ndarray, outputs: np.ndarray) -> np.ndarray:
        scaled = (simulate(inputs, unknowns[:8], unknowns[8:]) - outputs) / NOISE
        return np.nan_to_num(scaled, nan=1e6, posinf=1e6, neginf=-1e6).ravel()

    return residuals


def scipy_numba() -> tuple[Solver, float, int]:
    """Trust-region reflective method, unknowns scaled by the jacobian."""
    from scipy.optimize import least_squares

    _, inputs, outputs = load()
    start = begin(outputs)
    began = time.process_time()
    residuals = compiled()
    residuals(start, inputs, outputs)
    build = time.process_time() - began

    def solve() -> np.ndarray:
        return least_squares(residuals, start, x_scale="jac", args=(inputs, outputs)).x[:8]

    return solve, build, 7


def parmest_collocation() -> tuple[Solver, float, int]:
    """The weighted sum of squares of parmest."""
    import pyomo.contrib.parmest.parmest as parmest
    import pyomo.environ as pyo
    from pyomo.contrib.parmest.experiment import Experiment

    if shutil.which("ipopt") is None:
        raise ModuleNotFoundError("No program named 'ipopt'")
    _, inputs, outputs = load()
    n = len(outputs)
    model = pyo.ConcreteModel()
    model.share = pyo.Var(range(8), initialize=share())
    model.x = pyo.Var(range(n), range(5), initialize=lambda _, i, j: float(outputs[i, j]))

    def slope(i: int, command: np.ndarray) -> list:
        x = [model.x[i, j] for j in range(5)]
        p = [model.share[j] * float(TRUE[j]) for j in range(8)]
        return rates(x, [float(c) for c in command], p, pyo.sin, pyo.cos)

    model.gap = pyo.ConstraintList()
    for i in range(n - 1):
        here, there = slope(i, inputs[i]), slope(i + 1, inputs[i])  # inputs are held
        for j in range(5):
            model.gap.add(model.x[i + 1, j] == model.x[i, j] + STEP / 2 * (here[j] + there[j]))
    for label in ("experiment_outputs", "measurement_error", "unknown_parameters"):
        model.add_component(label, pyo.Suffix(direction=pyo.Suffix.LOCAL))
    for i in range(n):
        for j in range(5):
            model.experiment_outputs[model.x[i, j]] = float(outputs[i, j])
            model.measurement_error[model.x[i, j]] = float(NOISE[j])
    for j in range(8):
        model.unknown_parameters[model.share[j]] = share()

    class Dive(Experiment):
        """One record."""

        def get_labeled_model(self) -> pyo.ConcreteModel:
            return model

    def solve() -> np.ndarray:
        _, found = parmest.Estimator([Dive()], obj_function="SSE_weighted").theta_est()
        return np.array([float(found[f"share[{j}]"]) for j in range(8)]) * TRUE

    return solve, 0.0, 1


def pints_cma() -> tuple[Solver, float, int]:
    """Half the weighted sum of squares, by shares of the start values."""
    import pints

    _, inputs, outputs = load()
    start, residuals = begin(outputs), compiled()
    scale = np.where(start != 0, np.abs(start), 1.0)

    class Misfit(pints.ErrorMeasure):
        """To be minimised."""

        def __call__(self, shares: np.ndarray) -> float:
            found = residuals(np.asarray(shares) * scale, inputs, outputs)
            return float(min(0.5 * found @ found, 1e15))

        def n_parameters(self) -> int:
            return len(scale)

    Misfit()(start / scale)
    np.random.seed(1)  # noqa: NPY002  (PINTS draws from the global generator)

    def solve() -> np.ndarray:
        controller = pints.OptimisationController(
            Misfit(), start / scale, sigma0=0.1 * np.ones(13), method=pints.CMAES
        )
        controller.set_log_to_screen(False)
        controller.set_max_iterations(3000)
        return (controller.run()[0] * scale)[:8]

    return solve, 0.0, 1


TOOLS = (casadi_shooting, scipy_numba, parmest_collocation, pints_cma)

if __name__ == "__main__":
    report(*next(tool for tool in TOOLS if tool.__name__ == sys.argv[1])())
