"""Question: what do two tanks do that a linear model does not know?

A pump fills a tank, which drains into another, whose level is measured. From the
first half of a record the missing effects are found, starting from a linear
model; the second half validates them. Then the same question is put to a model that
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

print("error in V              train  validation   added")
for name, found in (("linear", linear), ("square root", torricelli)):
    before = found.base_rms
    after = found.steps[-1].rms if found.steps else before
    added = ", ".join(step.added for step in found.steps) or "nothing"
    print(f"{name:20} {before['train'][0]:8.3f} {before['test'][0]:11.3f}   nominal")
    print(f"{name:20} {after['train'][0]:8.3f} {after['test'][0]:11.3f}   {added}")
print()

named = [
    ", ".join(step.added for step in found.steps) or "nothing" for found in (linear, torricelli)
]
kinds = [found.remains.kind for found in (linear, torricelli)]
print(
    f"Conclusion: from the linear model {named[0]} is added, from Torricelli's {named[1]}; the "
    f"verdicts are '{kinds[0]}' and '{kinds[1]}'. With one level measured, a random force in a "
    "tank does what an overflow does: the scoreboard's choice, by masked blocks, gets further."
)
