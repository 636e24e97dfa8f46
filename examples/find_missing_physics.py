"""Question: what does the model of this small underwater vehicle lack?

Five runs, in which a separate program has hidden something. Three are to learn
from; the other two judge, and no choice looks at them.
"""

from oed_sysid import MultipleShooting, compare, improve, load_problem

problem = load_problem("remus_diving_plane")
train, test = problem.data().split(test=["test_steps", "test_zigzag_15_12"])

# The nominal model converges, and is wrong.
nominal = MultipleShooting().fit(problem.model, train)
print(compare(nominal, test).verdict)

found = improve(problem.model, train, test, candidates=problem.effects, known_noise=True)
print()
print(found.location.verdict)
for step in found.steps:
    others = ", ".join(step.group[1:]) or "no other candidate"
    print(f"Added {step.added}; as likely with these records: {others}.")

better = MultipleShooting().fit(found.model, train)
print()
print(compare(better, test).verdict)
print(
    f"\nConclusion: on records that nothing was fitted to the error falls from "
    f"{found.base_error['test']:.2f} to {found.final_error['test']:.3f} times the noise."
)
