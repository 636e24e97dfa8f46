"""Question: what do two tanks do that a linear model does not know?

A pump fills a tank, which drains into another, whose level is measured. From the
first half of a record the missing effects are found, starting from a linear
model; the second half confirms them. Then the same question is put to a model that
knows Torricelli's law already: does it lack the same things?
"""

from oed_sysid import load_problem
from oed_sysid.diagnosis.improve import improve

problem = load_problem("cascaded_tanks")
train, test = problem.data().split(test="test_second_half")

linear = improve(problem.model, train, test, candidates=problem.effects)
print(linear.report())
print()

# The square root is in this model; all other candidates may be missing.
law = problem.variant("torricelli")
others = [effect for effect in law.effects if effect.name != "gravity_outflow"]
torricelli = improve(law.model, train, test, candidates=others)
print(torricelli.report())
print()

print("error in V              train   test   added")
for name, found in (("linear", linear), ("square root", torricelli)):
    before, after = found.base_rms, found.steps[-1].rms
    added = ", ".join(step.added for step in found.steps)
    print(f"{name:20} {before['train'][0]:8.3f} {before['test'][0]:6.3f}   as believed")
    print(f"{name:20} {after['train'][0]:8.3f} {after['test'][0]:6.3f}   {added}")
print()

first = [step.added for step in linear.steps]
root = "is among them" if "gravity_outflow" in first else "is not among them"
errors = [float(found.steps[-1].rms["test"][0]) for found in (linear, torricelli)]
print(
    f"Conclusion: {', '.join(first)} are missing from the linear model; Torricelli's square root "
    f"{root}. The untouched half is then met to {errors[0]:.2f} V, or to {errors[1]:.2f} V from "
    "Torricelli's model onward."
)
