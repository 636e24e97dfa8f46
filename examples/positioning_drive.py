"""Question: what holds back the carriage of a positioning drive?

A motor moves a carriage to and fro in a closed loop; force and position were measured. A mass
with viscous friction is fitted to half of the record. What it lacks is sought in the second half
among dry friction of three kinds, an offset, polynomials of the speed and a lag of the motor.
"""

from oed_sysid import MultipleShooting, load_problem
from oed_sysid.evidence.improve import improve

problem = load_problem("positioning_drive")
train, test = problem.data().split(test="test_second_half")

nominal = MultipleShooting(disturbances="none").fit(problem.model, train)
found = improve(problem.model, train, test, candidates=problem.effects)
print(found.report())
print()

fit = found.fit
published = problem.published
print("parameter             found (95 % interval)         published")
for name, value in published.items():
    if name in fit.names:
        low, high = fit.interval(name)
        print(f"{name:20}{fit.values[name]:8.2f}  ({low:.2f} to {high:.2f}){value:14.2f}")

errors = {name: one.predict(test).rms["x"] for name, one in (("before", nominal), ("after", fit))}
added = " and ".join(step.added.replace("_", " ") for step in found.steps)
print(
    f"\nConclusion: {added}; on the second half the whole-run error falls from "
    f"{1e3 * errors['before']:.1f} to {1e3 * errors['after']:.2f} mm."
)
