"""Question: what does a rolling tanker model do that linear damping does not explain?

The roll decay of the KVLCC2 was measured at zero speed. A linear model is fitted
to the large angles and judged by the small ones; then the missing effects are
sought. Finally the same question is put to the last five periods alone, whose
amplitude hardly changes: there the honest answer is that nothing more can be said.
"""

from math import degrees

from oed_sysid import Dataset, MultipleShooting, load_problem
from oed_sysid.evidence.improve import improve

problem = load_problem("roll_decay")
train, test = problem.data().split(test="test_small")

linear = MultipleShooting(disturbances="none").fit(problem.model, train)
print(linear.report())
print()

found = improve(problem.model, train, test, candidates=problem.effects)
print(found.report())
print()

better = MultipleShooting(disturbances="none").fit(found.model, train)
for name, fit in (("linear model", linear), ("improved model", better)):
    error = degrees(fit.predict(test).rms["phi"])
    print(f"{name:15} {degrees(fit.rms['phi']):.4f} degrees on large angles, {error:.4f} on small")
print()

# What the literature calls for is a nonlinear damping; ask where it does not show.
end = test["test_small"]
tail = Dataset((end.window(3.0, end.duration).rename("last_five_periods"),))
refused = improve(problem.model, tail, candidates=problem.effects)
nonlinear = [step.added for step in refused.steps if "damping" in step.added]
print(f"From the last five periods alone: {', '.join(nonlinear) or 'no nonlinear damping'}.")

before, after = (degrees(fit.predict(test).rms["phi"]) for fit in (linear, better))
print(
    f"Conclusion: {', '.join(step.added for step in found.steps)} make the error on validation "
    f"angles {before / after:.1f} times smaller."
)
