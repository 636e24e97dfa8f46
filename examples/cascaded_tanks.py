"""Question: what do two tanks do that a linear model does not know?

A pump fills a tank, which drains into another, whose level is measured. From the
first half of a record the missing effects are found, starting from a linear
model; the second half, which no choice has touched, judges them. Then Torricelli's
law is given the same effects: is the square root still needed?
"""

from oed_sysid import MultipleShooting, load_problem
from oed_sysid.diagnosis.compare import compare
from oed_sysid.diagnosis.improve import improve

problem = load_problem("cascaded_tanks")
train, test = problem.data().split(test="test_second_half")

found = improve(problem.model, train, test, candidates=problem.effects)
print(found.report())
print()

names = [step.added for step in found.steps]
linear = MultipleShooting().fit(found.model, train)

# The same effects around outflows that follow a square root. Their fits have several
# local minima: start from several dead voltages, and let the training half choose.
law = problem.variant("torricelli").model + [problem.effect(name) for name in names]
starts = [
    law.with_values({"E_dead_voltage": dead, "E_upper_overflow": 0.4, "share": 0.9})
    for dead in (0.5, 1.0, 1.5, 2.0)
]
fits = [MultipleShooting().fit(start, train) for start in starts]
torricelli = min(fits, key=lambda fit: fit.rms["level"])

models = {"as believed": found.base, "improved": linear, "improved, square root": torricelli}
on_train, on_test = (compare(models, data) for data in (train, test))
print("error in V               train   test")
for name in models:
    errors = [check[name].prediction.rms["level"] for check in (on_train, on_test)]
    print(f"{name:22} {errors[0]:7.3f} {errors[1]:6.3f}")
print()

before, after, root = (on_test[name].prediction.rms["level"] for name in models)
print(
    f"Conclusion: {', '.join(names)} reduce the error on the untouched half from {before:.2f} to "
    f"{after:.2f} V; with Torricelli's square root it is {root:.2f} V."
)
