"""Are errors true when a trial programme says stop? And how many dives does it take?

    OMP_NUM_THREADS=1 python -m benchmarks.stopping [--seeds 20] [--hidden NAME ...] [--rules ...]
                                                    [--swell 8]

Dives of the REMUS-like vehicle in a moderate sea, or in a swell of that period, until all eight
coefficients are known to six per cent, or three hours are over; coefficients are up to 12 per cent
off, and something may act that the model does not know (`EFFECT` of usual size, or `EFFECT=SIZE`).
Dives are planned (those that `decide` chooses) or the standard programme's in turn. They stop by

- *errors*: all stated errors are small enough (nothing else is asked);
- *checked*: `decide` says stop, or that records contradict the model;
- *searched*: the same, but what contradicts starts a search for what is missing (`improve`); the
  model found is fitted, and dives go on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import product
from typing import Any

import numpy as np

from benchmarks.harness import RESULTS, TWO_SIDED_95, Row, Store, grouped, study, tabulate
from oed_sysid import Dataset, Limits, Model, MultipleShooting, OedSysidError, improve, load_problem
from oed_sysid.design import (
    Budget,
    Candidate,
    Knowledge,
    ProgrammeSearch,
    decide,
    design_programme,
    goals_of,
)
from oed_sysid.information import sea_noise
from oed_sysid.likelihood.realisation import simulate_at_sea

STORE = Store(
    RESULTS / "stopping.jsonl",
    lambda row: (row["hidden"], row["arm"], row["rule"], row["seed"], row.get("swell", 0.0)),
)
HOURS, GOAL, SPREAD = 3.0, 0.06, 0.12
RULES, ARMS = ("errors", "checked", "searched"), ("planned", "standard")
NOTHING = "nothing"


class Trial:
    """What all trials share: the vehicle, its sea, the programme.

    That is the programme of `examples/programme_for_an_auv.py`, or the same in a swell.
    """

    def __init__(self, swell: float = 0.0) -> None:
        self.problem = load_problem("remus_diving_plane")
        run = self.problem.experiment("zigzag_10_10")
        pattern = replace(run, initial={**run.initial, "z": 25.0}, duration=60.0, sample_time=0.2)
        words = f"moderate,period={swell}" if swell else "moderate"
        self.sea = sea_noise(self.problem.model, words, [pattern])
        self.programme = design_programme(
            self.problem.model,
            pattern,
            limits=self.problem.limits,
            rng=np.random.default_rng(7),
            budget=Budget(hours=HOURS / 4),
            search=ProgrammeSearch(
                kinds=("zigzag", "3-2-1-1", "levels"), n_draws=1, n_vehicles=4, n_rounds=0
            ),
            knowledge=Knowledge(noise=self.sea),
        )

    def truth(self, hidden: str, rng: np.random.Generator) -> Model:
        """The vehicle as it is."""
        model = self.problem.model
        off = {n: v * (1 + SPREAD * rng.uniform(-1, 1)) for n, v in model.values.items()}
        values = {n: off[n] for n in model.free_names}
        if hidden == NOTHING:
            return model.with_values(values)
        name, _, size = hidden.partition("=")
        effect = self.problem.effect(name)
        sizes = {p.name: float(size) if size else p.magnitude for p in effect.parameters}
        return (model + effect.with_values(sizes)).with_values(values)

    def run(self, hidden: str, arm: str, rule: str, seed: int) -> dict[str, Any]:
        """One trial until it stops."""
        rng = np.random.default_rng(1000 + seed)
        truth, base = self.truth(hidden, rng), self.problem.model
        goals = goals_of(base, {"all": GOAL})
        standard_names = () if self.programme.standard is None else self.programme.standard.names
        standard = [run for run in self.programme.candidates if run.name in standard_names]
        model, known, records, spent, searched = base, base, (), 0.0, 0
        added: list[str] = []
        while True:
            decision = decide(known, self.programme.candidates, goals, rng=rng, noise=self.sea,
                              hours=HOURS - spent)  # fmt: skip
            doubted = decision.contradiction is not None
            if rule == "searched" and doubted and len(records) > searched:
                searched = len(records)
                found = improve(base, Dataset(records), candidates=self.problem.effects)
                added = [step.effect.name for step in found.steps]
                model = found.model
                known = MultipleShooting().fit(model, Dataset(records))
                continue
            ends = {"errors": all(one.is_met for one in decision.goals), "checked": doubted}
            if decision.stop or ends.get(rule):
                break
            chosen = decision.next_run if arm == "planned" else standard[len(records) % 2]
            assert isinstance(chosen, Candidate)
            run = replace(chosen.experiment, limits=Limits())
            record = simulate_at_sea(truth, run, self.sea, rng=rng)
            records = (*records, replace(record, name=f"dive {len(records) + 1}"))
            spent += chosen.cost / 3600.0
            known = MultipleShooting().fit(model, Dataset(records))
        apart = {
            n: (known.values[n] - truth.values[n]) / known.std_errors[n] for n in base.free_names
        }
        worst = max(abs(known.values[n] / truth.values[n] - 1.0) for n in base.free_names)
        return {
            "hidden": hidden, "arm": arm, "rule": rule, "seed": seed, "dives": len(records),
            "action": decision.action, "doubted": doubted, "added": added, "apart": apart,
            "worst": worst,
        }  # fmt: skip


def known(group: Sequence[Row]) -> list[Row]:
    """Trials whose coefficients are called known; by errors alone a contradiction is not asked for.

    Examples
    --------
    >>> known([{"action": "time", "rule": "errors"}])
    []
    """
    return [
        row
        for row in group
        if row["action"] in ("enough", "contradicted", "go on")
        and (row["rule"] == "errors" or not row["doubted"])
    ]


def dives(group: Sequence[Row]) -> str:
    """Median and range of the dives done."""
    numbers = [row["dives"] for row in group]
    return f"{np.median(numbers):g} ({min(numbers)} to {max(numbers)})"


def within(group: Sequence[Row]) -> list[bool]:
    """Which 95 % intervals hold the truth."""
    return [abs(value) < TWO_SIDED_95 for row in group for value in row["apart"].values()]


def held(group: Sequence[Row]) -> str:
    """Share of the 95 % intervals that hold the truth where coefficients are called known."""
    inside = within(known(group))
    return f"{np.mean(inside):.0%} of {len(inside)}" if inside else "-"


COLUMNS: dict[str, Callable[[tuple[str, str, str, float], list[Row]], object]] = {
    "hidden": lambda key, _: f"`{key[0]}`",
    "sea": lambda key, _: f"swell of {key[3]:g} s" if key[3] else "moderate",
    "rule": lambda key, _: key[1],
    "dives": lambda key, _: key[2],
    "trials": lambda _, group: len(group),
    "dives done, median (range)": lambda _, group: dives(group),
    "called known": lambda _, group: len(known(group)),
    "95 % intervals hold there": lambda _, group: held(group),
    "worst error there, median": lambda _, group: (
        f"{np.median([row['worst'] for row in there]):.0%}" if (there := known(group)) else "-"
    ),
    "contradicted": lambda key, group: (
        "-" if key[1] == "errors" else sum(row["doubted"] for row in group)
    ),
}


def table(rows: list[Row]) -> str:
    """Rows of a table in Markdown."""
    groups = grouped(
        (row for row in rows if "failed" not in row),
        lambda row: (row["hidden"], row["rule"], row["arm"], row.get("swell", 0.0)),
    )
    failed = [row for row in rows if "failed" in row]
    words = [f"{row['hidden']}, seed {row['seed']}: {row['failed']}" for row in failed]
    return "\n".join([*tabulate(groups, COLUMNS), *words])


@cache
def trial(swell: float) -> Trial:
    """What trials in a sea share."""
    return Trial(swell)


def case(hidden: str, arm: str, rule: str, seed: int, swell: float) -> Row:
    """One trial, or why there is none."""
    try:
        found = trial(swell).run(hidden, arm, rule, seed)
    except OedSysidError as error:
        found = {"hidden": hidden, "arm": arm, "rule": rule, "seed": seed, "failed": str(error)}
    return found | {"swell": swell}


def cases(
    *,
    seeds: int = 20,
    hidden: Sequence[str] = (NOTHING, "pitch_quadratic_damping=-40"),
    arms: Sequence[str] = ARMS,
    rules: Sequence[str] = RULES,
    swell: float = 0.0,
) -> dict[tuple[object, ...], partial[Row]]:
    """Trials of every kind.

    Parameters
    ----------
    seeds : int
        trials of each kind
    hidden : sequence of str
        effects that the model lacks, as NAME or NAME=SIZE
    arms : sequence of str
        planned, standard
    rules : sequence of str
        errors, checked, searched
    swell : float
        period of a swell of the same strength in place of first-order forces, s; 0 for none
    """
    keys = [(*key, swell) for key in product(hidden, arms, rules, range(seeds))]
    return {key: partial(case, *key) for key in keys}


if __name__ == "__main__":
    study(cases, table, STORE)
