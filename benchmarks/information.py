"""How long the information of one record takes: ours, CasADi's jacobian, differences.

    OMP_NUM_THREADS=1 python benchmarks/information.py

Record: 2,400 samples of 0.1 s, five outputs, twelve free parameters and five
unknown start states of the REMUS-like diving plane. All ways share the same
equations, the same integration steps and the same triangularisation at the end.
"""

from __future__ import annotations

import time

import casadi as ca
import numpy as np

from benchmarks.measure import least
from oed_sysid import load_problem
from oed_sysid.compiled import graph as graphs
from oed_sysid.compiled.kernels import kernel
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.information import Play, noise_of, respond
from oed_sysid.information.bound import triangle, whitened_factor

N_SAMPLES, STEP, REPEATS = 2400, 0.1, 25
EXTRA = ("X_udot", "Z_wdot", "M_wdot", "M_qdot")

model = load_problem("remus_diving_plane").model.free(*EXTRA)
times = np.arange(N_SAMPLES) * STEP
fin = 0.1 * np.sign(np.sin(0.5 * times)) + 0.05 * np.sin(1.3 * times)
play = Play(
    "benchmark",
    times,
    np.column_stack([fin, np.full(N_SAMPLES, 9.0)]),
    np.array([1.5, 0.0, 0.0, 0.0, 10.0]),
    np.ones((N_SAMPLES, 5), dtype=bool),
)
noise = noise_of(model)
values, runner = model.value_vector, kernel(model)
free = [model.parameter_names.index(name) for name in model.free_names]


def ours() -> np.ndarray:
    response = respond(model, play)
    return whitened_factor(model, response.jacobian, response.present, noise)


def outputs(unknowns: np.ndarray) -> np.ndarray:
    """Plain trajectory from the same compiled code."""
    trial = values.copy()
    trial[free] = unknowns[5:]
    z, _ = runner.start(unknowns[:5], play.inputs[0], trial, 0.0)
    return runner.run(times, play.inputs, trial, z).outputs


POINT = np.concatenate([play.initial, values[free]])
SCALE = np.maximum(np.abs(POINT), 0.1)


def factor_of(jacobian: np.ndarray) -> np.ndarray:
    rows = (jacobian / noise.sigma[:, None]).reshape(-1, len(POINT))
    return triangle(rows)[5:, 5:]


def one_sided(share: float = 1e-7) -> np.ndarray:
    base = outputs(POINT)
    columns = [
        (outputs(POINT + share * SCALE[i] * np.eye(len(POINT))[i]) - base) / (share * SCALE[i])
        for i in range(len(POINT))
    ]
    return factor_of(np.stack(columns, axis=2))


def high_order(share: float = 3e-3) -> np.ndarray:
    """Central differences of eighth order, for accuracy only."""
    weights = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    columns = []
    for i in range(len(POINT)):
        step = share * SCALE[i] * np.eye(len(POINT))[i]
        columns.append(
            sum(
                w * (outputs(POINT + k * step) - outputs(POINT - k * step))
                for k, w in weights.items()
            )
            / (share * SCALE[i])
        )
    return np.stack(columns, axis=2)


def complex_step() -> np.ndarray:
    """Derivatives by an imaginary step, exact to rounding, from equations written anew.

    Independent of CasADi and of the compiled kernel: NumPy, the same
    Runge-Kutta steps, one column of complex unknowns for each derivative.
    """
    tiny = 1e-30
    names = model.free_names
    state = np.repeat(POINT[:5, None].astype(complex), len(POINT), axis=1)
    state[np.arange(5), np.arange(5)] += 1j * tiny
    known = {n: np.full(len(POINT), model.values[n], dtype=complex) for n in model.parameter_names}
    for i, name in enumerate(names):
        known[name][5 + i] += 1j * tiny
    a, b = known["m"] - known["Z_wdot"], -known["Z_qdot"]
    c, d = -known["M_wdot"], known["I_yy"] - known["M_qdot"]

    def rates(x: np.ndarray, fin: float, thrust: float) -> np.ndarray:
        u, w, q, theta, _ = x
        # Forward speed is positive, so u|u| is u squared.
        surge = thrust + known["X_uu"] * u * u - known["m"] * q * w
        heave = known["m"] * u * q + known["Z_uw"] * u * w + known["Z_uq"] * u * q
        heave = heave + known["Z_uuds"] * u * u * fin
        pitch = known["M_uw"] * u * w + known["M_uq"] * u * q + known["M_uuds"] * u * u * fin
        pitch = pitch - known["zgW"] * np.sin(theta)
        determinant = a * d - b * c
        return np.stack([
            surge / (known["m"] - known["X_udot"]), (d * heave - b * pitch) / determinant,
            (a * pitch - c * heave) / determinant, q, -u * np.sin(theta) + w * np.cos(theta),
        ])  # fmt: skip

    rows = [state.imag / tiny]
    for order in play.inputs[:-1]:
        k1 = rates(state, *order)
        k2 = rates(state + STEP / 2 * k1, *order)
        k3 = rates(state + STEP / 2 * k2, *order)
        k4 = rates(state + STEP * k3, *order)
        state = state + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        rows.append(state.imag / tiny)
    return np.stack(rows)


def interpreted() -> ca.Function:
    """CasADi's own jacobian of the whole trajectory by start and free parameters."""
    graph = graphs.build(model)
    z0, p_free = ca.MX.sym("z0", 5), ca.MX.sym("p", len(free))
    p = ca.MX(values)
    for position, index in enumerate(free):
        p[index] = p_free[position]
    z, u, q = ca.MX.sym("z", 5), ca.MX.sym("u", 2), ca.MX.sym("q", len(values))
    step = ca.Function("step", [z, u, q], [graph.advance(z, u, u, q, 0.0, STEP)])
    path = step.mapaccum("path", N_SAMPLES - 1)(
        z0, play.inputs[:-1].T, ca.repmat(p, 1, N_SAMPLES - 1)
    )
    # The outputs of this model are its states.
    stacked = ca.vec(ca.horzcat(z0, path))
    return ca.Function("J", [z0, p_free], [ca.jacobian(stacked, ca.vertcat(z0, p_free))])


print(f"{model.name}: {len(model.free_names)} free parameters, compiled: {runner.is_compiled}")
exact = respond(model, play).jacobian
began = time.perf_counter()
jacobian = interpreted()
build = time.perf_counter() - began
theirs = np.array(jacobian(POINT[:5], POINT[5:])).reshape(N_SAMPLES, 5, -1)
size = np.abs(exact).max(axis=(0, 1))
assert np.allclose(simulate_inputs(model, times, inputs=play.inputs, initial=play.initial).outputs,
                   outputs(POINT))  # fmt: skip
print(f"largest relative difference of the sensitivities to CasADi's jacobian "
      f"{np.max(np.abs(exact - theirs) / size):.1e}, to complex steps of NumPy equations "
      f"{np.max(np.abs(exact - complex_step()) / size):.1e}, to eighth-order differences "
      f"{np.max(np.abs(exact - high_order()) / size):.1e}")  # fmt: skip
reference = factor_of(theirs)
matrix = reference.T @ reference
for label, found in (("ours", ours()), ("one-sided differences", one_sided())):
    error = np.max(np.abs(found.T @ found - matrix) / np.sqrt(np.outer(*[np.diag(matrix)] * 2)))
    print(f"information, {label}: largest relative error {error:.1e}")
t_ours = least(ours, REPEATS)
t_differences = least(one_sided, REPEATS)
t_casadi = least(lambda: factor_of(
    np.array(jacobian(POINT[:5], POINT[5:])).reshape(N_SAMPLES, 5, -1)), REPEATS)  # fmt: skip
print(f"processor time: ours {1e3 * t_ours:.2f} ms; one-sided differences "
      f"{1e3 * t_differences:.2f} ms "
      f"({t_differences / t_ours:.1f}x); CasADi jacobian {1e3 * t_casadi:.1f} ms "
      f"({t_casadi / t_ours:.0f}x, built in {build:.2f} s)")  # fmt: skip
