"""Fits by other people's tools, one of a kind; each is run in a process of its own.

    python -m benchmarks.peers.fits casadi_expanded dive.npz

The task, written without this project's own model: eight derivatives and five initial states of the
diving plane of a REMUS-like vehicle from one record of 2,400 samples of five outputs, by least
squares weighted with the noise, from derivatives that are too small. Commands are held between
samples, one Runge-Kutta step of fourth order per sample.

Each is written as its authors' pages teach; what was chosen beyond them stands beside it.
"""

from __future__ import annotations

import json
import math
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version

import numpy as np

from benchmarks.truth import NOISE, TRUE, rates, runge_kutta

STEP = 0.1
Solver = Callable[[], np.ndarray]


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


def report(packages: Sequence[str], solve: Solver, build: float, repeats: int) -> None:
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


def casadi_expanded() -> tuple[Solver, float, int]:
    """One step as scalar operations, interpreted."""
    return casadi({})


def casadi_generated() -> tuple[Solver, float, int]:
    """All functions of the program as C, by the compiler of the machine."""
    flags = {"compiler": "gcc", "flags": ["-O3", "-march=native"]}
    return casadi({"jit": True, "compiler": "shell", "jit_options": flags})


def casadi(options: dict) -> tuple[Solver, float, int]:
    """Multiple shooting with IPOPT (CasADi's ``docs/examples/python/sysid.py``), a node a sample.

    Mapped integrator expanded into scalar operations, Gauss-Newton Hessian, exact jacobian. What
    solves is returned, how long it took to build, s, and how often to time it.
    """
    import casadi as ca

    times, inputs, outputs, start = load()
    n = len(times)
    began = used()
    x, u, p = ca.MX.sym("x", 5), ca.MX.sym("u", 2), ca.MX.sym("p", 8)
    slopes = rates(ca.vertsplit(x), ca.vertsplit(u), ca.vertsplit(p), ca.sin, ca.cos)
    f = ca.Function("f", [x, u, p], [ca.vertcat(*slopes)])
    following = runge_kutta(lambda z, _: f(z, u, p), x, STEP)
    step = ca.Function("step", [x, u, p], [following]).expand()
    scale = np.abs(start[:8])
    shares, nodes = ca.MX.sym("shares", 8), ca.MX.sym("X", 5, n)
    ends = step.map(n - 1, "serial")(
        nodes[:, :-1], inputs[:-1].T, ca.repmat(shares * scale, 1, n - 1)
    )
    gaps = ca.vec(nodes[:, 1:] - ends)
    residual = ca.vec((nodes - outputs.T) / NOISE)
    unknowns = ca.veccat(shares, nodes)
    jacobian = ca.jacobian(residual, unknowns)
    hessian = ca.triu(ca.mtimes(jacobian.T, jacobian))
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lam", gaps.shape[0])
    gauss_newton = ca.Function(
        "hess_lag", [unknowns, ca.MX(0, 1), sigma, multipliers], [sigma * hessian], options
    )
    problem = {"x": unknowns, "f": 0.5 * ca.dot(residual, residual), "g": gaps}
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    solver = ca.nlpsol("solver", "ipopt", problem, quiet | options | {"hess_lag": gauss_newton})
    build = used() - began
    guess = np.concatenate([start[:8] / scale, outputs.ravel()])

    def solve() -> np.ndarray:
        found = np.array(solver(x0=guess, lbg=0, ubg=0)["x"]).ravel()
        if not solver.stats()["success"]:
            raise RuntimeError(solver.stats()["return_status"])
        return found[:8] * scale

    return solve, build, 3


def do_mpc_window() -> tuple[Solver, float, int]:
    """One window over the record (do-mpc, *Getting started: MHE*), nothing known before it."""
    import casadi as ca
    import do_mpc

    _, inputs, outputs, start = load()
    n = len(outputs)
    began = used()
    model = do_mpc.model.Model("discrete")
    x = model.set_variable("_x", "x", (5, 1))
    u = model.set_variable("_u", "u", (2, 1))
    shares = model.set_variable("_p", "shares", (8, 1))
    p = ca.vertsplit(shares * start[:8])

    def slope(z: ca.SX, _: int) -> ca.SX:
        return ca.vertcat(*rates(ca.vertsplit(z), ca.vertsplit(u), p, ca.sin, ca.cos))

    model.set_meas("y", x / NOISE, meas_noise=True)
    model.set_meas("held", u, meas_noise=False)
    model.set_rhs("x", runge_kutta(slope, x, STEP), process_noise=False)
    model.setup()
    window = do_mpc.estimator.MHE(model, ["shares"])
    window.set_param(
        n_horizon=n - 1, t_step=STEP, meas_from_data=False,
        nlpsol_opts={"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0},
    )  # fmt: skip
    # A sample measures the state at the end of its step, and the first stands in the arrival cost.
    window.set_default_objective(P_x=np.diag(NOISE**-2.0), P_v=np.eye(5), P_p=1e-9 * np.eye(8))
    seen = window.get_y_template()
    for k in range(n - 1):
        seen["y_meas", k] = np.concatenate([outputs[k + 1] / NOISE, inputs[k]])
    window.set_y_fun(lambda _: seen)
    window.setup()
    build = used() - began

    def solve() -> np.ndarray:
        window.x0, window.u0, window.p_est0 = outputs[0], inputs[0], np.ones(8)
        window.set_initial_guess()
        for k in range(2, n):
            window.opt_x_num["_x", k, -1] = outputs[k]
        window.make_step(np.concatenate([outputs[-1] / NOISE, inputs[-1]])[:, None])
        if not window.solver_stats["success"]:
            raise RuntimeError(window.solver_stats["return_status"])
        return np.array(window.opt_x_num["_p_est"]).ravel() * start[:8]

    return solve, build, 1


def compiled() -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Weighted residuals ``(n * 5,)`` by numba; large where the model diverges."""
    from numba import njit

    slopes = njit(rates)

    @njit
    def moved(x, h, k, held, p):  # type: ignore[no-untyped-def]
        at = (x[0] + h * k[0], x[1] + h * k[1], x[2] + h * k[2], x[3] + h * k[3])
        return slopes(at, held, p, math.sin, math.cos)

    @njit
    def simulate(inputs, p, start, path):  # type: ignore[no-untyped-def]
        u, w, q, theta, z = start
        half, sixth = STEP / 2, STEP / 6
        for i in range(len(inputs)):
            path[i, 0], path[i, 1], path[i, 2], path[i, 3], path[i, 4] = u, w, q, theta, z
            x, held = (u, w, q, theta), (inputs[i, 0], inputs[i, 1])
            a = slopes(x, held, p, math.sin, math.cos)
            b = moved(x, half, a, held, p)
            c = moved(x, half, b, held, p)
            d = moved(x, STEP, c, held, p)
            u += sixth * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
            w += sixth * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
            q += sixth * (a[2] + 2 * b[2] + 2 * c[2] + d[2])
            theta += sixth * (a[3] + 2 * b[3] + 2 * c[3] + d[3])
            z += sixth * (a[4] + 2 * b[4] + 2 * c[4] + d[4])

    def residuals(unknowns: np.ndarray, inputs: np.ndarray, outputs: np.ndarray) -> np.ndarray:
        path = np.empty_like(outputs)
        simulate(inputs, tuple(unknowns[:8]), tuple(unknowns[8:]), path)
        scaled = (path - outputs) / NOISE
        return np.nan_to_num(scaled, nan=1e6, posinf=1e6, neginf=-1e6).ravel()

    return residuals


def scipy_numba() -> tuple[Solver, float, int]:
    """SciPy's trust-region reflective method, finite differences, scaled by the jacobian."""
    from scipy.optimize import least_squares

    _, inputs, outputs, start = load()
    began = time.process_time()
    residuals = compiled()
    residuals(start, inputs, outputs)
    build = time.process_time() - began

    def solve() -> np.ndarray:
        return least_squares(residuals, start, x_scale="jac", args=(inputs, outputs)).x[:8]

    return solve, build, 7


def parmest_collocation() -> tuple[Solver, float, int]:
    """Pyomo parmest (its *quick guide*): algebraic equations by the trapezoidal rule, IPOPT."""
    import pyomo.contrib.parmest.parmest as parmest
    import pyomo.environ as pyo
    from pyomo.contrib.parmest.experiment import Experiment

    if shutil.which("ipopt") is None:
        raise ModuleNotFoundError("No program named 'ipopt'")
    _, inputs, outputs, _ = load()
    n = len(outputs)
    model = pyo.ConcreteModel()
    model.share = pyo.Var(range(8), initialize=share())
    model.x = pyo.Var(range(n), range(5), initialize=lambda _, i, j: float(outputs[i, j]))

    def slope(i: int, command: np.ndarray) -> tuple:
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


def pypesto_amici() -> tuple[Solver, float, int]:
    """PyPESTO (its *AMICI in pyPESTO* example): sensitivities, Fides, Fisher information."""
    import amici.sim.sundials as sundials
    import pypesto
    import pypesto.optimize
    import sympy
    from amici.importers.antimony import MeasurementChannel, antimony2amici

    times, inputs, outputs, start = load()
    began = used()
    states, unknown = sympy.symbols("u w q theta z"), sympy.symbols("k1:9")
    derivatives = [float(value) * k for value, k in zip(start[:8], unknown, strict=True)]
    slopes = rates(states, (sympy.Symbol("fin"), 9.0), derivatives, sympy.sin, sympy.cos)
    lines = [f"{x}' = {sympy.ccode(rate)};" for x, rate in zip(states, slopes, strict=True)]
    lines += [f"{x} = {x}0; {x}0 = {value};" for x, value in zip(states, start[8:], strict=True)]
    lines += [f"{k} = 1.0;" for k in unknown]
    # The square wave is switched where the samples are; a held sine is late by half a step.
    square = inputs[:, 0] - 0.05 * np.sin(0.9 * times)
    lines += [f"fin := square + 0.05*sin(0.9*(time - {STEP / 2})); square = {square[0]};"]
    lines += [
        f"at (time >= {times[i]:.1f}): square = {square[i]:.1f};"
        for i in np.flatnonzero(np.abs(np.diff(square)) > 0.05) + 1
    ]
    channels = [
        MeasurementChannel(f"y_{x}", formula=str(x), sigma=str(noise))
        for x, noise in zip(states, NOISE, strict=True)
    ]
    with tempfile.TemporaryDirectory() as folder:
        model = antimony2amici(
            "\n".join(("model dive", *lines, "end")),
            model_name="dive", output_dir=folder, observation_model=channels,
        )  # fmt: skip
    model.set_timepoints(times.tolist())
    data = sundials.ExpData(model.get())
    data.set_measurements(outputs.ravel().tolist())
    integrator = model.create_solver()
    integrator.set_max_steps(100_000)
    integrator.set_absolute_tolerance(1e-8)  # of its own 1e-16 it does not arrive
    objective = pypesto.AmiciObjective(model, integrator, [data])
    guess = np.array(model.get_free_parameters())
    wide = 10.0 * np.maximum(np.abs(guess), 1.0)
    problem = pypesto.Problem(objective, guess - wide, guess + wide, x_guesses=[guess])
    ids = list(objective.x_ids)
    optimizer = pypesto.optimize.FidesOptimizer(verbose=40)
    build = used() - began

    def solve() -> np.ndarray:
        found = pypesto.optimize.minimize(problem, optimizer, n_starts=1, progress_bar=False)
        best = dict(zip(ids, found.optimize_result[0].x, strict=True))
        return np.array([best[str(k)] for k in unknown]) * start[:8]

    return solve, build, 1


def optimistix_scan() -> tuple[Solver, float, int]:
    """Optimistix's Levenberg-Marquardt (its *least squares* page) over a scan, forward mode."""
    import jax
    import jax.numpy as jnp
    import optimistix

    jax.config.update("jax_enable_x64", True)
    _, inputs, outputs, start = load()
    scale = np.append(np.abs(start[:8]), NOISE)
    commands, seen = jnp.asarray(inputs), jnp.asarray(outputs)

    def residuals(unknowns: jax.Array, _: None) -> jax.Array:
        p = unknowns[:8] * scale[:8]

        def step(x: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
            def rate(z: jax.Array, _: int) -> jax.Array:
                return jnp.stack(rates(z, u, p, jnp.sin, jnp.cos))

            return runge_kutta(rate, x, STEP), x

        path = jax.lax.scan(step, unknowns[8:] * scale[8:], commands)[1]
        return ((path - seen) / NOISE).ravel()

    method = optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8)

    @jax.jit
    def run(guess: jax.Array) -> jax.Array:
        options = {"jac": "fwd"}
        return optimistix.least_squares(
            residuals, method, guess, options=options, max_steps=200, throw=True
        ).value

    began = used()
    guess = jnp.asarray(start / scale)
    run(guess).block_until_ready()
    build = used() - began

    def solve() -> np.ndarray:
        return (np.asarray(run(guess)) * scale)[:8]

    return solve, build, 7


# What each needs, whose versions are reported.
TOOLS: dict[Callable[[], tuple[Solver, float, int]], tuple[str, ...]] = {
    casadi_expanded: ("casadi",),
    casadi_generated: ("casadi",),
    do_mpc_window: ("do-mpc", "casadi"),
    scipy_numba: ("scipy", "numba"),
    optimistix_scan: ("optimistix", "jax"),
    pypesto_amici: ("pypesto", "amici", "fides"),
    parmest_collocation: ("pyomo",),
}

if __name__ == "__main__":
    tool = next(tool for tool in TOOLS if tool.__name__ == sys.argv[1])
    report(TOOLS[tool], *tool())
