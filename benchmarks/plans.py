"""What is promised of plans, beside what was measured: one table in docs/programme.md.

    OMP_NUM_THREADS=1 python -m benchmarks.plans [sets bias flown priors ...] [--show]

*sets*: the set that can be estimated together against all :math:`2^n` sets, tried by code of this
file, and errors, the others fixed, against central differences. *bias*: what fixing a parameter at
a wrong value does to the estimate that suffers most, against fits. *flown*: the law of a written
ROS 2 node flies vehicles drawn from what is known, integrated by `benchmarks.missing_physics`, in
forces of their own. *priors*: the same where priors believe in 8 % and 25 % is true. *starts*:
Fourier regression of records in swell. *watch*: processor time of a sample. The other lines are
those of `benchmarks.realised` and `benchmarks.stopping`, as kept.
"""

from __future__ import annotations

import runpy
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import realised, stopping
from benchmarks.harness import RESULTS, Row, Store, grouped, ignorant, known, markdown, study
from benchmarks.random_forces.scenarios import SCENARIOS
from benchmarks.random_forces.simulator import simulate as data_sets
from benchmarks.random_forces.trial import dataset, nominal_model
from benchmarks.ship_hours import inside
from oed_sysid import Dataset, Experiment, Model, MultipleShooting, NoiseModel, load_problem
from oed_sysid.baselines.fourier import FourierRegression, FourierStream
from oed_sysid.design import (
    Assurance,
    Caution,
    Knowledge,
    Search,
    ZigZags,
    assess_limits,
    design_experiment,
    played,
    write_controller,
)
from oed_sysid.design.vehicles import at_least, draw_models
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.information import identifiable_subset, information_of
from oed_sysid.information.identifiability import ASSUMED
from oed_sysid.information.response import commanded_runs
from oed_sysid.likelihood.realisation import drawn_disturbances

STORE = Store(RESULTS / "plans.jsonl")
# Vehicles with at most 17 free parameters: shipped ones, and single runs of these.
SETS: tuple[tuple[str, str | None, str | None], ...] = (
    ("remus_diving_plane", None, None),
    ("remus_diving_plane", None, "steps"),
    ("online_ship", None, None),
    ("online_ship", None, "zigzag_5_5"),
    ("torpedo", None, None),
    ("catamaran", None, None),
    ("kvlcc2", "linear_hull", None),
    ("kvlcc2", "linear_hull", "zigzag_20_20"),
    ("remus_6dof", None, None),
    ("remus_6dof", None, "slow"),
)
FLIGHTS, SETS_IN_SWELL = 200, 12
# How wrong a fixed parameter is, as a share of its value.
WRONG = 0.1
# Records in swell: vehicles whose sensors see every state of their equations.
STARTS = ("ship_swell", "ship_designed", "remus_swell")
WATCHED = ("remus_diving_plane", "online_ship", "torpedo", "catamaran", "remus_6dof")


# -- sets ------------------------------------------------------------------------------


def described(name: str, variant: str | None, run: str | None) -> tuple[Model, list[Experiment]]:
    """A vehicle without priors, and its runs."""
    problem = load_problem(name, variant=variant)
    runs = [problem.experiment(run)] if run else list(problem.experiments.values())
    return ignorant(problem.model), runs


def best_by_trial(gram: np.ndarray, errors: float, limit: float) -> tuple[int, float]:
    """Size and smallest collinearity of the largest sets that may be estimated, all tried.

    Parameters
    ----------
    gram : ndarray (n, n)
        Information in units of the values.
    errors : float
        Largest relative error.
    limit : float
        Largest collinearity.
    """
    sizes = np.sqrt(np.diagonal(gram))
    unit = gram / np.outer(sizes, sizes)
    for size in range(len(gram), 0, -1):
        best = np.inf
        for chosen in combinations(range(len(gram)), size):
            part = unit[np.ix_(chosen, chosen)]
            least = float(np.linalg.eigvalsh(part)[0])
            if least < limit**-2.0:
                continue
            variances = np.diagonal(np.linalg.inv(part)) / sizes[list(chosen)] ** 2
            if np.all(variances <= errors**2):
                best = min(best, least**-0.5)
        if np.isfinite(best):
            return size, best
    return 0, 0.0


def errors_by_differences(
    model: Model, runs: Sequence[Experiment], names: Sequence[str]
) -> np.ndarray:
    """Standard errors of some parameters, all others fixed, start states free: differences."""
    sigma = np.array([output.noise_std for output in model.outputs])
    blocks = []
    for given in commanded_runs(model, runs):
        own = np.array(given.initial, dtype=float)

        def outputs(values: dict[str, float], start: np.ndarray, given: Any = given) -> np.ndarray:
            run = simulate_inputs(
                model.with_values(values), given.times, inputs=given.inputs, initial=start
            )
            return np.asarray((run.outputs / sigma)[given.present])

        columns = []
        for name in names:
            step = 1e-5 * model.parameter(name).magnitude
            ends = [outputs({name: model.values[name] + s * step}, own) for s in (1, -1)]
            columns.append((ends[0] - ends[1]) / (2 * step))
        steps = 1e-5 * np.diag([state.scale for state in model.states])
        starts = [(outputs({}, own + s) - outputs({}, own - s)) / (2 * s.sum()) for s in steps]
        free, own_states = np.array(columns).T, np.array(starts).T
        blocks.append(free - own_states @ np.linalg.lstsq(own_states, free, rcond=None)[0])
    rows = np.vstack(blocks)
    return np.sqrt(np.diagonal(np.linalg.inv(rows.T @ rows)))


def set_of(key: str, name: str, variant: str | None, run: str | None) -> Row:
    """The set that is found beside the best of all, and its errors beside differences."""
    model, runs = described(name, variant, run)
    information = information_of(model, runs, priors=None)
    values = {n: model.values[n] for n in information.names}
    found = identifiable_subset(information, values)
    sizes = np.array([abs(values[n]) or model.parameter(n).magnitude for n in information.names])
    gram = information.matrix * np.outer(sizes, sizes)
    size, index = best_by_trial(gram, ASSUMED, found.limit)
    own = [place for place in found.places if place.free]
    errors = errors_by_differences(model, runs, [place.name for place in own])
    units = [sizes[information.names.index(place.name)] for place in own]
    stated = np.array([place.error for place in own]) * units
    return {
        "key": key, "parameters": len(values), "size": found.size, "best": size,
        "optimal": found.size == size and found.collinearity <= index * (1 + 1e-6),
        "error": float(np.max(np.abs(stated / errors - 1.0))),
    }  # fmt: skip


# -- bias ------------------------------------------------------------------------------


def bias_of(key: str, name: str, variant: str | None, run: str | None) -> Row:
    """Biases that are stated if single parameters are fixed wrong, and those of fits."""
    model, runs = described(name, variant, run)
    values = {n: model.values[n] for n in model.free_names}
    sizes = {n: abs(value) or model.parameter(n).magnitude for n, value in values.items()}
    found = identifiable_subset(
        information_of(model, runs, priors=None), values,
        assumed={n: WRONG * size for n, size in sizes.items()},
        largest_error=ASSUMED,
    )  # fmt: skip
    data = Dataset(simulate(model, one, noise=False) for one in runs)
    stated, fitted = [], []
    for place in found.places:
        # What nobody would notice is not compared.
        if not place.bias > 0.01:
            continue
        moved = []
        for way in (1.0, -1.0):
            wrong = model.with_values(
                {place.name: values[place.name] + way * WRONG * sizes[place.name]}
            )
            others = [n for n in found.names if n != place.name]
            reduced = wrong.fix(*(n for n in values if n not in others))
            fit = MultipleShooting(disturbances="none").fit(reduced, data)
            moved.append((fit.values[place.biased] - values[place.biased]) / sizes[place.biased])
        stated.append(place.bias)
        # The part that is odd in the error is what a first derivative states.
        fitted.append(0.5 * abs(moved[0] - moved[1]))
    return {"key": key, "stated": stated, "fitted": fitted}


# -- flown -----------------------------------------------------------------------------


def planned(
    model: Model, sea: NoiseModel, certainty: float, spread: float | None, rng: np.random.Generator
) -> Experiment:
    """A run that reacts, planned with caution for vehicles that are so far off what is believed."""
    trial = realised.trial(load_problem("remus_diving_plane").limits, 60.0)
    return design_experiment(
        model, trial, rng=rng, search=Search(family=ZigZags()),
        knowledge=Knowledge(noise=sea, spread=spread),
        caution=Caution(certainty, spread, 80, FLIGHTS),
    ).experiment  # fmt: skip


def stated_of(
    model: Model, run: Experiment, sea: NoiseModel, spread: float | None, rng: np.random.Generator
) -> Assurance:
    """How surely a run is said to keep the limits."""
    limits = load_problem("remus_diving_plane").limits
    return assess_limits(
        model, run, rng=rng, limits=limits, spread=spread, vehicles=FLIGHTS, sea=sea
    )


def flown(key: str, spread: float, forces: float, seed: int) -> Row:
    """Limits stated of a run that reacts, and kept where its file flies other vehicles."""
    model, rng = realised.believed(), np.random.default_rng(seed)
    sea = realised.sea(model, forces)
    run = planned(model, sea, 0.9, spread, rng)
    row = {"key": key, "run": run.name}
    for name, one in (("closed", run), ("table", played(model, run))):
        stated = stated_of(model, one, sea, spread, rng)
        vehicles = draw_models(model, spread, FLIGHTS, None, rng)
        row[f"stated {name}"] = stated.n_kept
        row[f"flown {name}"] = int(np.sum(flights(model, one, vehicles, sea, rng)))
    return row


def doubted(key: str, seed: int) -> Row:
    """Limits stated by priors of 8 %, and kept on vehicles that are 25 % off."""
    model, rng = realised.believed(), np.random.default_rng(seed)
    believing = model
    for one in model.free_parameters:
        believing = believing.with_parameter(
            replace(one, prior_mean=one.value, prior_std=0.08 * abs(one.value))
        )
    sea = realised.sea(model, 1.0)
    run = planned(believing, sea, 0.95, None, rng)
    stated = stated_of(believing, run, sea, None, rng)
    true = [
        model.with_values({n: model.values[n] * (1.0 + 0.25 * rng.standard_normal())
                           for n in model.free_names})
        for _ in range(FLIGHTS)
    ]  # fmt: skip
    kept = int(np.sum(flights(model, run, true, sea, rng)))
    return {
        "key": key, "run": run.name, "stated": stated.n_kept, "least": stated.at_least,
        "kept": kept,
    }  # fmt: skip


def flights(
    model: Model, run: Experiment, vehicles: Sequence[Model], sea: Any, rng: np.random.Generator
) -> np.ndarray:
    """On which vehicles the written file keeps the limits, on the foreign simulator."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_controller(Path(folder) / "run.py", model, run, "ros2", aborts=[])
        law = runpy.run_path(str(path))["Run"]
        laws = [law() for _ in vehicles]
    drawn = [drawn_disturbances(sea, run.times, rng) for _ in vehicles]
    forces = [np.column_stack([one[place] for place in sea.places]) for one in drawn]
    thrust = run.constants["thrust"]
    names = ("u", "w", "q", "theta", "z")

    def command_of(k: int, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        fins = []
        for number, one in enumerate(laws):
            seen = dict(zip(names, map(float, state[:5, number]), strict=True))
            orders, _ = one.step(k * run.sample_time, seen)
            fins.append(orders["fin_command"])
        return np.array(fins), np.full(len(laws), thrust)

    return inside(run, vehicles, np.stack(forces, axis=2), command_of)


# -- starts ----------------------------------------------------------------------------


def start_of(key: str, scenario_name: str, number: int) -> Row:
    """Relative errors of start values, root mean square over the parameters of one data set."""
    scenario = SCENARIOS[scenario_name]
    model = nominal_model(scenario.vehicle)
    (one,) = data_sets(scenario, 0, [number])
    found = FourierRegression().fit(model, dataset(scenario, model, one.runs)).values
    shares = [found[n] / value - 1.0 for n, value in one.truth.items() if n in found]
    return {"key": key, "error": float(np.sqrt(np.mean(np.square(shares))))}


# -- watching -----------------------------------------------------------------


def watched(key: str, name: str) -> Row:
    """Processor time of a sample of a run, its share of what is said on the way included."""
    problem = load_problem(name)
    model, run = problem.model, next(iter(problem.experiments.values()))
    record = simulate(model, run, rng=np.random.default_rng(0))
    stream = FourierStream(model, duration=run.duration, period=run.sample_time)
    signals = (*model.input_names, *model.output_names)
    table = np.hstack([record.inputs, record.outputs]).tolist()
    pushes, said = [], 0.0
    # As often as `watch` says something; the first time compiles.
    stride = max(len(record.times) // 20, 1)
    for k, (now, row) in enumerate(zip(record.times.tolist(), table, strict=True)):
        began = time.process_time()
        stream.push(now, dict(zip(signals, row, strict=True)))
        pushes.append(time.process_time() - began)
        if k and k % stride == 0:
            began = time.process_time()
            stream.advice()
            said += time.process_time() - began if k > stride else 0.0
    n = len(pushes)
    return {"key": key, "push": 1e3 * float(np.mean(pushes)), "all": 1e3 * (sum(pushes) + said) / n}


# -- the table --------------------------------------------------------------------------


def sections() -> dict[str, dict[str, partial[Row]]]:
    """Cases by section."""
    sets = {f"set {n} {v or ''} {r or 'all'}": partial(set_of, name=n, variant=v, run=r)
            for n, v, r in SETS}  # fmt: skip
    closed = {f"flown {s:g} off": partial(flown, spread=s, forces=1.0, seed=1) for s in (0.12, 0.2)}
    bias = {f"bias{key.removeprefix('set')}": partial(bias_of, **one.keywords)
            for key, one in sets.items() if one.keywords["run"]}  # fmt: skip
    priors = {f"priors seed {seed}": partial(doubted, seed=seed) for seed in (1, 2)}
    starts = {
        f"start {name} {i}": partial(start_of, scenario_name=name, number=i)
        for name in STARTS for i in range(SETS_IN_SWELL)
    }  # fmt: skip
    watch = {f"watch {name}": partial(watched, name=name) for name in WATCHED}
    return {
        "sets": sets, "bias": bias, "flown": closed, "priors": priors, "starts": starts,
        "watch": watch,
    }  # fmt: skip


def cases(names: Sequence[str] = ()) -> dict[str, partial[Row]]:
    """Cases of some sections by name.

    Parameters
    ----------
    names : sequence of str
        sets, bias, flown, priors, starts, watch; all without a name
    """
    every = sections()
    chosen = [every[known(name, every, "section")] for name in names or every]
    return {key: partial(work, key) for own in chosen for key, work in own.items()}


def promised(stated: int, least: float, flown: int) -> str:
    """Shares of vehicles that keep the limits."""
    return f"stated {stated / FLIGHTS:.1%} (at least {least:.1%}), flown {flown / FLIGHTS:.1%}"


def table(rows: Sequence[Row]) -> str:
    """Promised beside measured, with what is kept of other benchmarks, as Markdown."""
    lines = [*_planned(rows), *_realised(), *_stopped()]
    return "\n".join(markdown(("what", "`python -m benchmarks.`", "of", "measured"), lines))


def _planned(rows: Sequence[Row]) -> Iterator[tuple[str, str, str, str]]:
    """Lines of this benchmark: what, how, how many, result."""
    sections = grouped(rows, lambda row: row["key"].split()[0])
    if sets := sections.get("set", []):
        how, n = "`plans sets`", f"{len(sets)} vehicles and runs"
        best = sum(row["optimal"] for row in sets)
        yield "largest set against all sets", how, n, f"best in {best} of {len(sets)}"
        error = max(row["error"] for row in sets)
        what = "errors, the others fixed, against differences"
        yield what, how, n, f"largest deviation {error:.1g}"
    for row in sections.get("flown", []):
        off = float(row["key"].split()[1])
        for kind, words in (("closed", "file of a run that reacts"), ("table", "its table")):
            stated = row[f"stated {kind}"]
            told = promised(stated, at_least(stated, FLIGHTS), row[f"flown {kind}"])
            what = f"limits kept, {words}, coefficients up to {off:.0%} off"
            yield what, "`plans flown`", f"{FLIGHTS} vehicles each", told
    if bias := sections.get("bias", []):
        ratio = np.concatenate([np.divide(row["stated"], row["fitted"]) for row in bias])
        near = int(np.sum(np.abs(ratio - 1.0) <= 0.2))
        what = f"largest bias if one parameter is fixed {WRONG:.0%} off, stated over fitted"
        n = f"{len(ratio)} parameters of {len(bias)} runs"
        told = f"{near} within 20 %; {min(ratio):.2f} to {max(ratio):.2f}"
        yield what, "`plans bias`", n, told
    for row in sections.get("priors", []):
        what = "limits kept, believed 8 % off, 25 % off in truth"
        n = f"{FLIGHTS} vehicles each, {row['key'].removeprefix('priors ')}"
        told = promised(row["stated"], row["least"], row["kept"])
        yield what, "`plans priors`", n, told
    kinds = grouped(sections.get("start", []), lambda row: SCENARIOS[row["key"].split()[1]].title)
    for title, group in kinds.items():
        errors = [row["error"] for row in group]
        told = f"{np.median(errors):.1%} ({min(errors):.1%} to {max(errors):.1%})"
        yield f"start values, {title}", "`plans starts`", f"{len(group)} data sets", told
    if watch := sections.get("watch", []):
        what = "processor time of a sample, alone and with advice every 5 % of a run"
        alone, all_ = (max(row[kind] for row in watch) for kind in ("push", "all"))
        told = f"at most {alone:.1f} and {all_:.1f} ms"
        yield what, "`plans watch`", f"{len(watch)} vehicles", told


def _realised() -> Iterator[tuple[str, str, str, str]]:
    """Lines of `benchmarks.realised`."""
    kinds = grouped(realised.STORE.rows(), lambda row: (row["plan"], row["forces"], row["swell"]))
    for (plan, forces, swell), group in kinds.items():
        ratio = realised.ratios(group)
        near = np.sum((ratio >= realised.TRUE[0]) & (ratio <= realised.TRUE[1]))
        mean, error = np.exp(np.mean(np.log(ratio))), 1.0 / np.sqrt(2.0 * len(group))
        held = np.mean([row["inside"] for row in group])
        what = f"realised over stated errors, {plan} run, {sea_of(swell)} x {forces:g}"
        told = (
            f"{near} of {len(ratio)} from 0.8 to 1.25, each ±{error:.2f}; mean {mean:.2f}; 95 % "
            f"intervals hold {held:.0%}"
        )
        yield what, f"`realised --swell {swell:g}`", f"{len(group)} repetitions", told


def sea_of(swell: float) -> str:
    """A swell of this period, s, or the forces that there are without."""
    return f"swell of {swell:g} s" if swell else "first-order forces"


def _stopped() -> Iterator[tuple[str, str, str, str]]:
    """Lines of `benchmarks.stopping` with nothing hidden."""
    kinds = grouped(
        (row for row in stopping.STORE.rows() if row["hidden"] == stopping.NOTHING
         and "failed" not in row and row["rule"] == "checked" and row["arm"] == "planned"),
        lambda row: row.get("swell", 0.0),
    )  # fmt: skip
    for swell, group in kinds.items():
        n, doubted = len(group), sum(row["doubted"] for row in group)
        inside = np.mean(stopping.within(group))
        how = f"`stopping --hidden nothing --rules checked --arms planned --swell {swell:g}`"
        most = 1 - at_least(n - doubted, n)
        told = f"{doubted} (at most {most:.0%}); intervals hold {inside:.0%}"
        yield f"right model called contradicted, {sea_of(swell)}", how, f"{n} trials", told


if __name__ == "__main__":
    study(cases, table, STORE, marks="plans")
