"""Question: which derivatives can a diving-plane zigzag determine, before any trial?

Sensitivity alone says which parameters move the outputs. Whether they can be
told apart is another matter, and depends on the manoeuvre.
"""

from oed_sysid import load_problem
from oed_sysid.information import rank_parameters

problem = load_problem("remus_diving_plane")
gentle = problem.experiment("zigzag_5_5")
both = [gentle, problem.experiment("steps")]

for words, runs in (("one gentle zigzag", [gentle]), ("zigzag and steps", both)):
    ranking = rank_parameters(problem.model, runs)
    subset = ranking.together
    worst = ranking.rows[-1]
    print(f"{words}: {subset.size} of {len(subset.order)} parameters can be told apart")
    print(f"  best found together: {', '.join(subset.names)}")
    print(f"  worst: {worst.name}, relative standard error {worst.error:.1%}")
    print(f"  (its error would be {worst.error_alone:.1%} if all others were known)\n")

mover = rank_parameters(problem.model, both).by_output_change[0]
place = rank_parameters(problem.model, both).by_information.index(mover) + 1
print(
    f"Conclusion: {mover} moves the outputs most, yet is only number {place} of "
    f"{len(problem.model.free_names)} in what the records say about it."
)
