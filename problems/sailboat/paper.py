"""The headline of Chen, Deng and Xu (2023): a sailboat's derivatives, and what it sails.

Gibbs sampling on accelerations with noise, its diagnostics against the closed form, the
forces of the hull that follow, multiple shooting on the same runs without accelerations,
and the speed polar with credible bands against the simulator (``sailboat_polar.png``).
"""

from __future__ import annotations

import numpy as np

from oed_sysid import Dataset, MultipleShooting, load_problem, speed_polar
from oed_sysid.estimators import EquationError, GibbsRegression
from oed_sysid.estimators.baselines.regression_rows import exact_rates
from oed_sysid.report import plot_polar
from oed_sysid.simulate import simulate

NOISE = 0.1  # of the standard deviation of each acceleration
problem = load_problem("sailboat")
runs = tuple(problem.experiments.values())
clean = Dataset(tuple(simulate(problem.model, run, noise=False) for run in runs))
rng = np.random.default_rng(0)
exact = exact_rates(problem.model, clean)
spread = np.vstack(list(exact.values())).std(axis=0)
rates = {n: rate + NOISE * spread * rng.standard_normal(rate.shape) for n, rate in exact.items()}
gibbs = GibbsRegression(rule="exact", rates=rates).fit(problem.model, clean)
closed = EquationError(rule="exact", rates=rates, coloured="never").fit(problem.model, clean)
away = {name: value * (1 + 0.3 * rng.uniform(-1, 1)) for name, value in problem.truth.items()}
noisy = Dataset(tuple(simulate(problem.model, run, rng=rng) for run in runs))
shooting = MultipleShooting().fit(problem.model.with_values(away), noisy)

print(f"{'derivative':12}{'truth':>9}{'Gibbs':>18}{'R-hat':>7}{'draws':>7}{'shooting':>18}")
for name, truth in problem.truth.items():
    cells = [f"{fit.values[name]:9.2f} ±{fit.std_errors[name]:7.2f}" for fit in (gibbs, shooting)]
    facts = gibbs.extras["r_hat"][name], gibbs.extras["effective_draws"][name]
    print(f"{name:12}{truth:9.2f}{cells[0]:>18}{facts[0]:7.3f}{facts[1]:7.0f}{cells[1]:>18}")
off = max(abs(gibbs.values[n] - closed.values[n]) / closed.std_errors[n] for n in gibbs.names)
print()
print(f"posterior means and the closed form differ by {off:.3f} standard deviations at most")
for label, fit in (("Gibbs, accelerations", gibbs), ("multiple shooting, motions", shooting)):
    held = [low <= problem.truth[n] <= high for n in fit.names for low, high in [fit.interval(n)]]
    print(f"{label}: {sum(held)} of {len(held)} intervals of 95 % hold the truth")
captive = exact_rates(gibbs.model, clean)
for axis, state in problem.model.axes.items():
    column = ["u", "v", "p", "r"].index(state)
    forces = [
        np.concatenate([part[:, column] for part in one.values()]) for one in (captive, exact)
    ]
    error = np.sqrt(np.mean((forces[0] - forces[1]) ** 2)) / np.std(forces[1])
    print(f"{axis}: identified and true resultant differ by {100 * error:.2f} % of its spread")

settings = {
    "wind_speed": 5.0,
    "angles": np.radians([40, 60, 75, 90, 105, 120, 135, 150, 165]),
    "sheets": np.radians(np.arange(5, 91, 10)),
    "guess": {"u": 0.8, "phi": -0.05},
    "limits": problem.limits,
}
truth = speed_polar(problem.model, **settings)
found = speed_polar(gibbs, n_draws=25, **settings)
print()
print(found.report())
plot_polar(found, truth=truth).figure.savefig("sailboat_polar.png", dpi=120)
error = 100 * np.abs(found.speeds / truth.speeds - 1).max()
print(f"The polar is off by {error:.2f} % at most; it is drawn in sailboat_polar.png.")
