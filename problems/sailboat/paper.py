"""The headline of Chen, Deng and Xu (2023): a sailboat's derivatives, and what it sails.

Gibbs sampling on accelerations with noise, its diagnostics against the closed form; how often
its intervals hold the truth when accelerations are exact but for white noise, and when they are
taken from noisy motions; multiple shooting on the same motions; the forces that follow, and the
speed polar with credible bands. ``--figures FOLDER`` draws forces and polar.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from oed_sysid import Dataset, MultipleShooting, load_problem, speed_polar
from oed_sysid.baselines import EquationError, GibbsRegression
from oed_sysid.baselines.equations import exact_rates
from oed_sysid.errors import SimulationError
from oed_sysid.experiments.simulation import equilibrium, simulate
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.model import Model
from oed_sysid.prediction.speed_polar import SpeedPolar
from oed_sysid.results import new_figure, plot_polar

NOISE = 0.1  # of the standard deviation of each acceleration
problem = load_problem("sailboat")
runs = tuple(problem.experiments.values())
clean = Dataset(tuple(simulate(problem.model, run, noise=False) for run in runs))
exact = exact_rates(problem.model, clean)
COURSES = ((60.0, 40.0), (120.0, 60.0))  # angle off the wind and sheet, degrees
# Derivatives that carry the forces in these runs.
DOMINANT = ("X_uu", "X_vv", "Y_v", "Y_p", "Y_absvv", "Y_absvp", "N_r", "N_absvv", "K_v", "K_p",
            "K_absvv", "K_pabsv")  # fmt: skip
AXES = {"X": ("u", "N"), "Y": ("v", "N"), "K": ("p", "N m"), "N": ("r", "N m")}


def noisy_rates(seed: int, level: float = NOISE) -> dict[str, np.ndarray]:
    """Exact accelerations with white noise, a share of their standard deviation."""
    rng = np.random.default_rng(seed)
    spread = np.vstack(list(exact.values())).std(axis=0)
    return {n: r + level * spread * rng.standard_normal(r.shape) for n, r in exact.items()}


def noisy_motions(seed: int) -> Dataset:
    """The four runs with the declared noise of the sensors."""
    rng = np.random.default_rng(seed)
    return Dataset(tuple(simulate(problem.model, run, rng=rng) for run in runs))


def held(fit: Fit) -> list[bool]:
    """Which 95 % intervals hold the truth."""
    return [low <= problem.truth[n] <= high for n in fit.names for low, high in [fit.interval(n)]]


def covered(seed: int) -> dict[str, list[bool]]:
    """Which 95 % intervals hold the truth in one realisation, by data and method."""
    away = {name: 0.8 * value for name, value in problem.truth.items()}
    rates, motions = noisy_rates(seed), noisy_motions(seed)
    fits = {
        "Gibbs, exact accelerations + 10 % white noise": GibbsRegression(
            rule="exact", rates=rates, n_draws=400
        ).fit(problem.model, clean),
        "Gibbs, noisy motions, Simpson's rule": GibbsRegression(rule="simpson", n_draws=400).fit(
            problem.model, motions
        ),
        "Gibbs, noisy motions, local polynomials": GibbsRegression(rule="local", n_draws=400).fit(
            problem.model, motions
        ),
        "multiple shooting, the same motions": MultipleShooting(disturbances="none").fit(
            problem.model.with_values(away), motions
        ),
    }
    return {label: held(fit) for label, fit in fits.items()}


def coverage(seeds: int = 10) -> dict[str, float]:
    """Share of 95 % intervals that hold the truth, over realisations, per cent."""
    rows = [covered(seed) for seed in range(seeds)]
    return {label: 100 * float(np.mean([row[label] for row in rows])) for label in rows[0]}


def apart(gibbs: Fit, closed: Fit) -> float:
    """Largest difference of posterior means and least squares, in standard errors."""
    return max(abs(gibbs.values[n] - closed.values[n]) / closed.std_errors[n] for n in gibbs.names)


def resultants(model: Model) -> dict[str, np.ndarray]:
    """Resultant of each equation along the noise-free runs, in the axis's unit."""
    rates = np.vstack(list(exact_rates(model, clean).values()))
    inertia = {"X": "m + m_x", "Y": "m + m_y", "K": "I_xx_total", "N": "I_zz_total"}
    values = model.values
    sizes = {
        axis: sum(values[n.strip()] for n in text.split("+")) for axis, text in inertia.items()
    }
    return {axis: sizes[axis] * rates[:, k] for k, axis in enumerate(AXES)}


def resultant_errors(identified: Model) -> dict[str, float]:
    """Error of each equation's resultant, rms, per cent of its spread."""
    true, found = resultants(problem.model), resultants(identified)
    return {
        axis: 100 * float(np.sqrt(np.mean((found[axis] - true[axis]) ** 2)) / np.std(true[axis]))
        for axis in AXES
    }


def polars(fit: Fit) -> tuple[SpeedPolar, SpeedPolar]:
    """Speed polar at 5 m/s of wind, of the simulator and of a fit with its 95 % band."""
    settings = {
        "wind_speed": 5.0,
        "angles": np.radians([40, 60, 75, 90, 105, 120, 135, 150, 165]),
        "sheets": np.radians(np.arange(5, 91, 10)),
        "guess": {"u": 0.8, "phi": -0.05},
        "limits": problem.limits,
    }
    return speed_polar(problem.model, **settings), speed_polar(fit, n_draws=25, **settings)


def steady(model: Model, angle: float, sheet: float, wind: float = 5.0) -> dict[str, float]:
    """Steady states with the wind from ``angle`` degrees to starboard, and the rudder."""
    found = equilibrium(
        model,
        inputs={"sheet": np.radians(sheet), "wind_speed": wind, "wind_from": 0.0},
        fixed={"psi": -np.radians(angle), "r": 0.0, "p": 0.0},
        free=("delta",),
        guess={"u": 0.8, "phi": -np.sign(angle) * 0.05},
        limits=problem.limits,
    )
    if not found.ok:
        raise SimulationError(f"No steady sailing at {angle:g} degrees: {found.status}")
    return {**found.states, "delta": found.inputs["delta"]}


def speed_error(level: float, seed: int) -> float:
    """Largest error of the steady speed on a reach and a run, per cent, at a level of noise."""
    method = EquationError(rule="exact", rates=noisy_rates(seed, level))
    model = method.fit(problem.model, clean).model
    speeds = [[steady(m, *c)["u"] for m in (model, problem.model)] for c in COURSES]
    return max(100 * abs(found / truth - 1) for found, truth in speeds)


def from_afar(seed: int) -> Fit:
    """Multiple shooting on noisy motions, from start values up to 30 % off."""
    rng = np.random.default_rng(seed)
    motions = Dataset(tuple(simulate(problem.model, run, rng=rng) for run in runs))
    away = {name: value * (1 + 0.3 * rng.uniform(-1, 1)) for name, value in problem.truth.items()}
    return MultipleShooting(disturbances="none").fit(problem.model.with_values(away), motions)


def figures(folder: Path, identified: Model) -> None:
    """Resultants of the four equations on the beat, true and identified."""
    true, found = resultants(problem.model), resultants(identified)
    first = clean[0].n_samples
    record = clean[1]
    part = slice(first, first + record.n_samples)
    figure, grid = new_figure(4, 1, size=(7, 8), sharex=True)
    for axes, (axis, (_, unit)) in zip(grid[:, 0], AXES.items(), strict=True):
        axes.plot(record.times, true[axis][part], color="black", label="simulator")
        axes.plot(record.times, found[axis][part], "--", color="C1", label="identified")
        axes.set_ylabel(f"{axis} [{unit}]")
    grid[0, 0].legend(ncols=2)
    grid[0, 0].set_title(f"resultant of each equation, {record.name}")
    grid[-1, 0].set_xlabel("time [s]")
    figure.savefig(folder / "sailboat_forces.png", dpi=120)


def main(arguments: list[str] | None = None) -> None:
    """Print the headline."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figures", type=Path, help="folder for the figures")
    parser.add_argument("--seeds", type=int, default=10, help="realisations for the coverage")
    given = parser.parse_args(arguments)
    rates = noisy_rates(0)
    gibbs = GibbsRegression(rule="exact", rates=rates).fit(problem.model, clean)
    closed = EquationError(rule="exact", rates=rates, coloured="never").fit(problem.model, clean)
    shooting = from_afar(0)

    print(f"{'derivative':12}{'truth':>9}{'Gibbs':>18}{'R-hat':>7}{'draws':>7}{'shooting':>18}")
    for name, truth in problem.truth.items():
        cells = [
            f"{fit.values[name]:9.2f} ±{1.96 * fit.std_errors[name]:7.2f}"
            for fit in (gibbs, shooting)
        ]
        facts = gibbs.posterior.r_hat[name], gibbs.posterior.effective_draws[name]
        print(f"{name:12}{truth:9.2f}{cells[0]:>18}{facts[0]:7.3f}{facts[1]:7.0f}{cells[1]:>18}")
    off = apart(gibbs, closed)
    print("(± is the 95 % interval)")
    print()
    print(f"posterior means and the closed form differ by {off:.3f} standard deviations at most")
    print()
    print(f"95 % intervals that hold the truth, {given.seeds} realisations:")
    for label, percent in coverage(given.seeds).items():
        print(f"  {label:46}{percent:5.1f} %")
    print()
    for axis, error in resultant_errors(gibbs.model).items():
        print(f"{axis}: identified and true resultant differ by {error:.2f} % of its spread")

    truth, polar = polars(gibbs)
    print()
    print(polar.report())
    error = 100 * np.abs(polar.speeds / truth.speeds - 1).max()
    print(f"The polar is off by {error:.2f} % at most.")
    if given.figures:
        given.figures.mkdir(parents=True, exist_ok=True)
        figures(given.figures, gibbs.model)
        plot_polar(polar, truth=truth).figure.savefig(given.figures / "sailboat_polar.png", dpi=120)


if __name__ == "__main__":
    main()
