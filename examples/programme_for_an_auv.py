"""Question: how many dives until every coefficient is known to six per cent, waves included?

A programme is planned for a moderate sea. The real vehicle is up to 12 per cent off in every
coefficient, has a pitch damping that the model does not know, and is pushed by waves. After each
dive all records are fitted, disturbance forces included, and the rule says: go on, or stop. Where
records contradict one another, what is missing is looked for first. The standard trials (zigzags
10/10 and 12/12 in turn) go on until the same rule stops them.
"""

from dataclasses import replace

import numpy as np

from oed_sysid import Dataset, Limits, MultipleShooting, improve, load_problem
from oed_sysid.design import Budget, Knowledge, ProgrammeSearch, decide, design_programme, goals_of
from oed_sysid.information import sea_noise
from oed_sysid.likelihood.realisation import simulate_at_sea

HOURS, GOAL = 3.0, 0.06
problem = load_problem("remus_diving_plane")
rng = np.random.default_rng(7)
# Dives begin at 25 m: room above for whatever the vehicle does.
pattern = problem.experiment("zigzag_10_10")
pattern = replace(pattern, initial={**pattern.initial, "z": 25.0}, duration=60.0, sample_time=0.2)
sea = sea_noise(problem.model, "moderate", [pattern])
kinds = ("zigzag", "3-2-1-1", "levels")
programme = design_programme(
    problem.model,
    pattern,
    limits=problem.limits,
    rng=rng,
    budget=Budget(hours=HOURS / 4),
    search=ProgrammeSearch(kinds=kinds, n_draws=1, n_vehicles=4, n_rounds=0),
    knowledge=Knowledge(noise=sea),
)
print(programme.report(), "\n")

# The vehicle as it is: nobody on board knows this.
off = {n: v * (1 + rng.uniform(-0.12, 0.12)) for n, v in problem.model.values.items()}
hidden = problem.effect("pitch_quadratic_damping").with_values({"E_pitch_quadratic_damping": -40.0})
truth = (problem.model + hidden).with_values({n: off[n] for n in problem.model.free_names})
goals = goals_of(problem.model, {"all": GOAL})


def trial(choose: object) -> str:
    """Dive, fit, decide, until the rule stops; what came of it, in words."""
    known, model, records, spent, searched = problem.model, problem.model, (), 0.0, 0
    while True:
        decision = decide(known, programme.candidates, goals, rng=rng, noise=sea,
                          hours=HOURS - spent)  # fmt: skip
        if decision.contradiction is not None and len(records) > searched:
            print(f"after {len(records)} dives: {decision.contradiction.text}\n")
            searched = len(records)
            model = improve(problem.model, Dataset(records), candidates=problem.effects).model
            known = MultipleShooting().fit(model, Dataset(records))
            continue
        if decision.stop:
            break
        run = choose(decision, len(records))  # type: ignore[operator]
        dive = simulate_at_sea(truth, replace(run.experiment, limits=Limits()), sea, rng=rng)
        records = (*records, replace(dive, name=f"dive {len(records) + 1}"))
        spent += run.cost / 3600.0
        known = MultipleShooting().fit(model, Dataset(records))
    print(f"after {len(records)} dives, {spent:.2f} h: {decision.report()}\n")
    found = set(model.parameter_names) - set(problem.model.parameter_names)
    errors = {n: known.values[n] / off[n] - 1 for n in problem.model.free_names}
    worst = max(errors, key=lambda n: abs(errors[n]))
    inside = sum(abs(errors[n] * off[n]) < 1.96 * known.std_errors[n] for n in errors)
    return (
        f"{len(records)} dives ({spent:.2f} h; found to be missing: {', '.join(found) or 'nothing'}"
        f"; {inside} of {len(errors)} 95 % intervals hold, {worst} is {errors[worst]:+.1%} off)"
    )


names = programme.standard.names
standard = [run for run in programme.candidates if run.name in names]
planned = trial(lambda decision, number: decision.next_run)
usual = trial(lambda decision, number: standard[number % len(standard)])
print(f"Conclusion: planned, it took {planned}; standard trials took {usual}.")
