"""Question: how many dives until every coefficient is known to six per cent, waves included?

A programme is planned for a moderate sea. The real vehicle is up to 12 per cent off in every
coefficient, has a pitch damping that the model does not know, and is pushed by waves. After each
dive all records are fitted, random forces included, and the rule says: go on, or stop. The standard
trials (zigzags 10/10 and 20/20 in turn) go on until the same rule stops them.
"""

from dataclasses import replace

import numpy as np

from oed_sysid import Dataset, Experiment, Limits, MultipleShooting, Record, load_problem
from oed_sysid.design import decide, design_programme, goals_of
from oed_sysid.noise.realisation import simulate_at_sea
from oed_sysid.sensitivity import sea_noise

HOURS, GOAL = 3.0, 0.06
problem = load_problem("remus_diving_plane")
rng = np.random.default_rng(7)
# Dives begin at 25 m: room above for whatever the vehicle does.
patterns = [
    replace(run, initial={**run.initial, "z": 25.0}, duration=60.0, sample_time=0.2)
    for run in (problem.experiment("zigzag_10_10"),)
]
sea = sea_noise(problem.model, "moderate", patterns)

programme = design_programme(
    problem.model, patterns, limits=problem.limits, hours=HOURS / 4, noise=sea, rng=rng,
    n_draws=1, n_vehicles=4, n_rounds=0, kinds=("zigzag", "3-2-1-1", "levels"),
)  # fmt: skip
print(programme.report(), "\n")

# The vehicle as it is: nobody on board knows this.
off = {n: v * (1 + rng.uniform(-0.12, 0.12)) for n, v in problem.model.values.items()}
hidden = problem.effect("pitch_quadratic_damping").with_values({"E_pitch_quadratic_damping": -40.0})
truth = (problem.model + hidden).with_values({n: off[n] for n in problem.model.free_names})
goals = goals_of(problem.model, {"all": GOAL})
left: list[str] = []


def dive(run: Experiment, number: int) -> Record:
    """One run at sea; limits that it leaves are noted."""
    record = simulate_at_sea(truth, replace(run, limits=Limits()), sea, rng=rng)
    signals = {name: record.output(name) for name in problem.limits.signals}
    left.extend(Limits(signals=problem.limits.signals).violations(record.times, signals))
    return replace(record, name=f"dive {number}")


def trial(choose: object) -> tuple[int, float, object]:
    """Dive, fit, decide, until the rule stops; the time it took, and the last fit."""
    known, records, spent = problem.model, (), 0.0
    while True:
        decision = decide(known, programme.candidates, goals, rng=rng, noise=sea,
                          hours=HOURS - spent)  # fmt: skip
        if decision.stop:
            print(f"after {len(records)} dives, {spent:.2f} h: {decision.report()}\n")
            return len(records), spent, known
        run = choose(decision, len(records))  # type: ignore[operator]
        records = (*records, dive(run.experiment, len(records) + 1))
        spent += run.cost / 3600.0
        known = MultipleShooting().fit(problem.model, Dataset(records))


names = programme.standard.names
standard = [run for run in programme.candidates if run.name in names]
planned = trial(lambda decision, number: decision.next_run)
usual = trial(lambda decision, number: standard[number % len(standard)])
errors = {n: abs(planned[2].values[n] / off[n] - 1) for n in problem.model.free_names}
worst = max(errors, key=errors.get)
print(
    f"Conclusion: the rule stopped after {planned[0]} planned dives ({planned[1]:.2f} h) and "
    f"{usual[0]} standard ones ({usual[1]:.2f} h); limits were left {len(left)} times. The worst "
    f"coefficient, {worst}, was {errors[worst]:.1%} off, with damping hidden in it."
)
