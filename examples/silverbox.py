"""Question: which nonlinearity is in the box?

The Silverbox is an electronic circuit that resonates like a mass on a spring. It
was driven by a multisine; a linear model is fitted to two seconds of it and
judged by another realisation. What is missing is sought among springs, dampers,
offsets and a lag, one after the other.
"""

from oed_sysid import MultipleShooting, load_problem
from oed_sysid.evidence.improve import improve

problem = load_problem("silverbox")
train, test = problem.data().split(test="test_third_realisation")

linear = MultipleShooting(disturbances="none").fit(problem.model, train)
print(linear.report())
print()

found = improve(problem.model, train, test, candidates=problem.effects, max_effects=4)
print(found.report())
print()

# The same structures as plain least-squares fits, one effect more each time.
model, errors = problem.model, {"linear": linear}
for step in found.steps:
    model = model + step.effect
    errors[f"+ {step.added}"] = MultipleShooting(disturbances="none").fit(model, train)
print("error in mV              train   test")
for name, fit in errors.items():
    mistake = fit.predict(test).rms["y"]
    print(f"{name:22} {1e3 * fit.rms['y']:7.3f} {1e3 * mistake:6.3f}")
print()

first, last = (1e3 * fit.predict(test).rms["y"] for fit in (linear, fit))
print(
    f"Conclusion: the spring hardens ({found.steps[0].added}); with {len(found.steps)} effects the "
    f"error on another realisation falls from {first:.2f} to {last:.2f} mV."
)
