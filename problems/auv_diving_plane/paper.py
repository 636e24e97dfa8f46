"""The headline of Xu, Zou, Yin and Cao (2012): 18 coefficients from one zigzag by LS-SVM.

Prints the error of every coefficient for each way to take accelerations, next to
the sensitivity that explains it, and what multiple shooting makes of the same record.
"""

from __future__ import annotations

from oed_sysid import Dataset, MultipleShooting, load_problem, rank_parameters
from oed_sysid.estimators import LeastSquaresSVM, SupportVectorRegression
from oed_sysid.estimators.baselines.regression_rows import exact_rates
from oed_sysid.simulate import simulate

problem = load_problem("auv_diving_plane")
experiment = problem.experiment("zigzag_5_5")
data = Dataset((simulate(problem.model, experiment, noise=False),))
away = problem.model.with_values({name: 1.3 * value for name, value in problem.truth.items()})

fits = {
    "exact": LeastSquaresSVM(rule="exact", rates=exact_rates(problem.model, data)),
    "Simpson": LeastSquaresSVM(rule="simpson"),
    "trapezoid": LeastSquaresSVM(rule="trapezoid"),
    "Euler": LeastSquaresSVM(rule="euler"),
    "e-SVR": SupportVectorRegression(rule="simpson"),
}
columns = {name: method.fit(problem.model, data).values for name, method in fits.items()}
columns["shooting"] = MultipleShooting().fit(away, data).values

ranking = rank_parameters(problem.model, [experiment])
print(f"errors in per cent{'':8}" + "".join(f"{name:>12}" for name in columns))
for name, truth in problem.truth.items():
    errors = (100 * (values[name] / truth - 1) for values in columns.values())
    print(f"{name:26}" + "".join(f"{error:12.2f}" for error in errors))
wrong = {
    rule: sum(abs(values[name] / truth - 1) > 0.05 for name, truth in problem.truth.items())
    for rule, values in columns.items()
}
print()
print(ranking.report())
print()
rates, area = exact_rates(problem.model, data), 0.5 * 1025 * 5.3**2  # rho/2 L^2
for weight in (3e2, 3e4, 3e6, 3e14):
    scaled = LeastSquaresSVM(
        C=weight, rule="exact", rates=rates, scale={"u": area, "w": area, "q": area * 5.3}
    ).fit(problem.model, data)
    worst = max(abs(scaled.values[name] / truth - 1) for name, truth in problem.truth.items())
    print(f"C = {weight:.0e} in dimensionless equations: largest error {100 * worst:.3g} %")
print(f"beyond 5 %: {wrong} (published: 2; how accelerations were taken is not said)")
