"""Several runs together: weights with a certificate, exchange, and whole programmes."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest
from test_design import LIMITS, sea, ship

from oed_sysid import Experiment, Input, Limits, Parameter, design, simulate
from oed_sysid.design import (
    AOptimal,
    Budget,
    DOptimal,
    Knowledge,
    Programme,
    ProgrammeSearch,
    Setting,
    candidate_runs,
    design_programme,
)
from oed_sysid.design.allocation import Library, Selection, select, weights
from oed_sysid.design.vehicles import draw_models
from oed_sysid.errors import DesignError
from oed_sysid.information import information_of, noise_of
from oed_sysid.likelihood.information import Information

PATTERN = Experiment("pattern", duration=40.0, sample_time=0.5, constants={})
SEA = sea(0.005)


def library(rng: np.random.Generator, criterion: object, *, prior: float = 0.0) -> Library:
    """Ten random runs of four parameters that see few directions each, on three vehicles."""
    base = rng.standard_normal((10, 3, 4)) * np.exp(rng.normal(0, 1, (10, 1, 4)))
    rows = base[None] * (1 + 0.1 * rng.standard_normal((3, 10, 3, 4)))
    information = np.einsum("sika,sikb->siab", rows, rows)
    costs = rng.uniform(0.5, 2.0, 10)
    setting = Setting(ship(), ("b",), np.ones(1), noise_of(ship()))
    measure = criterion.bind(setting)  # type: ignore[attr-defined]
    return Library(information, prior * np.eye(4), costs, criterion, measure)


def enumerated(library: Library, *, budget: float | None, n_runs: int) -> Selection:
    """Best of all selections, by trying each."""
    best, best_value = np.zeros(library.n_runs, dtype=int), -np.inf
    for size in range(1, n_runs + 1):
        for chosen in combinations_with_replacement(range(library.n_runs), size):
            counts = np.bincount(chosen, minlength=library.n_runs)
            if budget is not None and counts @ library.costs > budget * (1 + 1e-9):
                continue
            value = library.value(counts)
            if value > best_value:
                best, best_value = counts, value
    return Selection(best, best_value, best_value)


@pytest.mark.parametrize("criterion", [DOptimal(), AOptimal()], ids=lambda c: c.name)
@pytest.mark.parametrize(("budget", "n_runs"), [(4.0, None), (None, 4), (4.0, 4)])
def test_no_programme_exceeds_the_bound_and_the_gap_is_small(
    criterion: object, budget: float | None, n_runs: int | None
) -> None:
    """The certificate holds for random weights and whole runs, and weights come near it."""
    rng = np.random.default_rng(3)
    runs = library(rng, criterion, prior=0.1)
    found = weights(replace(runs, budget=budget or np.inf, most=n_runs or np.inf))
    gap = found.bound - found.value
    assert gap >= -1e-9
    if budget is None or n_runs is None:
        assert gap <= 1e-3
    used = found.repetitions
    assert budget is None or used @ runs.costs <= budget * (1 + 1e-9)
    assert n_runs is None or used.sum() <= n_runs * (1 + 1e-9)
    for _ in range(200):
        x = rng.dirichlet(np.full(10, 0.2))
        room = [np.inf if budget is None else budget / (x @ runs.costs)]
        room.append(np.inf if n_runs is None else n_runs)
        assert runs.value(min(room) * x) <= found.bound + 1e-9
    best = enumerated(runs, budget=budget, n_runs=n_runs or 4)
    assert best.value <= found.bound + 1e-9


def test_exchange_is_within_a_per_cent_of_enumeration_and_never_below_greedy() -> None:
    """On small random libraries the exchange finds the best programme, where greedy does not."""
    worse = 0
    for seed in range(3):
        for criterion in (DOptimal(), AOptimal()):
            runs = library(np.random.default_rng(seed), criterion, prior=1e-3)
            runs = replace(runs, budget=4.0, most=3)
            found = select(runs, weights(runs))
            best = enumerated(runs, budget=4.0, n_runs=3)
            assert runs.factor(best.value - found.value) <= 1.01
            assert found.value >= found.greedy - 1e-12
            assert found.counts @ runs.costs <= 4.0 * (1 + 1e-9)
            worse += runs.factor(best.value - found.greedy) > 1.01
    assert worse >= 1


def test_candidates_keep_the_limits_on_all_vehicles_shown() -> None:
    """Every candidate keeps range, rate and heading, also on vehicles that differ."""
    rng = np.random.default_rng(0)
    vehicles = draw_models(ship(), 0.2, 6, None, rng)
    runs = candidate_runs(ship(), PATTERN, limits=LIMITS, rng=rng, vehicles=vehicles)
    kinds = {run.kind for run in runs}
    assert {"straight", "zigzag", "3-2-1-1", "multisine", "levels"} <= kinds
    assert len({run.name for run in runs}) == len(runs)
    for run in runs:
        assert run.cost == 640.0
        for vehicle in (ship(), *vehicles):
            record = simulate(vehicle, run.experiment, noise=False)
            assert np.abs(record.output("psi")).max() <= 0.6 * (1 + 1e-9)
            assert np.abs(np.diff(record.input("rudder"))).max() <= 0.1 * (1 + 1e-6)


def test_every_input_that_a_pattern_leaves_is_commanded_in_turn() -> None:
    """A moment that only a thruster tells is known after the next run, with the rudder at trim."""
    model = ship(
        inputs=(Input("rudder", "rad"), Input("thrust", "N")),
        kinematics={"psi": "r", "r": "b*rudder - d*r - c*r*abs(r) + e*thrust"},
        parameters=tuple(
            replace(one, prior_std=0.5 * one.value)
            for one in (*ship().parameters, Parameter("e", 0.02, "1/(N s^2)"))
        ),
    )
    limits = replace(LIMITS, inputs=LIMITS.inputs | {"thrust": (-2.0, 2.0)})
    rng = np.random.default_rng(0)
    kinds = ("straight", "zigzag", "levels")
    runs = candidate_runs(model, PATTERN, limits=limits, rng=rng, kinds=kinds)
    assert len({run.name for run in runs}) == len(runs)
    moved = {(run.kind, one.input) for run in runs for one in run.experiment.manoeuvres}
    assert moved == {
        ("straight", "rudder"), ("zigzag", "rudder"), ("levels", "rudder"), ("levels", "thrust")
    }  # fmt: skip
    of_thrust = [run for run in runs if " N of thrust" in run.name]
    goals = (design.ParameterGoal("b", 1e-3), design.ParameterGoal("e", 0.05))
    found = design.decide(model, of_thrust, goals, rng=rng)
    assert [one.now for one in found.goals] == pytest.approx([0.5, 0.5])
    assert found.goals[0].then == pytest.approx(0.5)
    assert found.goals[1].then < 0.05
    # The goal that the run brings nearer, although the other is the further one.
    assert "brings e from 50% to" in found.answer()


def test_quick_zigzags_keep_a_corridor_that_equal_ones_leave_and_tell_more() -> None:
    """Within 12 degrees, full rudder turned early tells more than gentle equal angles."""
    narrow = replace(LIMITS, signals={"psi": (-0.21, 0.21)})
    runs = candidate_runs(ship(), PATTERN, limits=narrow, rng=np.random.default_rng(0),
                          kinds=("zigzag",))  # fmt: skip
    shapes = {run.name: run.experiment.excitation for run in runs}
    quick = [run for run in runs if shapes[run.name].switch < shapes[run.name].amplitude]
    equal = [run for run in runs if run not in quick]
    assert quick
    assert equal

    def told(run: object) -> float:
        return information_of(ship(), run.experiment, noise=SEA, priors=None).log_determinant  # type: ignore[attr-defined]

    assert max(map(told, quick)) > max(map(told, equal))
    for run in runs:
        assert np.abs(simulate(ship(), run.experiment, noise=False).output("psi")).max() <= 0.21


def test_zigzags_that_look_ahead_keep_a_corridor_on_more_vehicles() -> None:
    """Full rudder within 20 degrees of heading: looking ahead keeps it where equal angles leave."""
    narrow = replace(LIMITS, signals={"psi": (-0.35, 0.35)})
    vehicles = draw_models(ship(), 0.3, 12, None, np.random.default_rng(5))
    runs = candidate_runs(ship(), PATTERN, limits=narrow, rng=np.random.default_rng(0),
                          kinds=("zigzag", "zigzag ahead"), vehicles=vehicles)  # fmt: skip
    ahead = [run for run in runs if run.kind == "zigzag ahead"]
    assert all(run.experiment.excitation.lead > 0 for run in ahead)  # type: ignore[union-attr]
    rest = [run for run in runs if run not in ahead]
    assert ahead
    assert all(run.experiment.excitation.keep_gain == 0 for run in ahead)  # type: ignore[union-attr]
    largest = max(run.experiment.excitation.amplitude for run in rest)  # type: ignore[union-attr]
    assert max(run.experiment.excitation.amplitude for run in ahead) >= largest  # type: ignore[union-attr]
    for run in ahead:
        for vehicle in vehicles:
            heading = simulate(vehicle, run.experiment, noise=False).output("psi")
            assert np.abs(heading).max() <= 0.35


def test_all_runs_together_keep_their_limits_on_as_many_vehicles_as_wanted() -> None:
    """The share is of vehicles on which every run keeps them, so it is below that of any run."""
    narrow = replace(LIMITS, signals={"psi": (-0.5, 0.5)})
    found = design_programme(
        ship(),
        PATTERN,
        limits=narrow,
        rng=np.random.default_rng(2),
        certainty=0.9,
        budget=Budget(n_runs=3, turnaround=300.0),
        search=ProgrammeSearch(n_draws=1, n_vehicles=4, n_rounds=0),
        knowledge=Knowledge(noise=SEA, spread=0.3),
    )
    shares = [one.probability for one in found.assurances.values()]
    masks = np.array([one.kept for one in found.assurances.values()])
    assert found.limited
    assert found.kept == masks.all(axis=0).mean()
    assert 0.9 <= found.kept <= min(shares)
    assert found.to_dict()["limits_kept"] == found.kept


@pytest.fixture
def few_judges(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits are judged on few vehicles, where how surely they are kept is not the point."""
    monkeypatch.setattr("oed_sysid.design.programme.CHECKED", 20)


@pytest.fixture(name="programme", scope="module")
def _programme() -> Programme:
    """A programme of half an hour and four runs at most, under disturbance forces."""
    return design_programme(
        ship(),
        PATTERN,
        limits=LIMITS,
        rng=np.random.default_rng(1),
        budget=Budget(hours=0.5, n_runs=4, turnaround=300.0),
        search=ProgrammeSearch(n_draws=2, n_vehicles=6),
        knowledge=Knowledge(noise=SEA, spread=0.1),
    )


def test_programme_keeps_to_its_budget_and_states_what_it_is_worth(programme: Programme) -> None:
    """Time and runs are kept, the bound is above, the errors are those of all runs together."""
    assert len(programme.runs) <= 4
    assert programme.hours <= 0.5 + 1e-9
    assert programme.value <= programme.bound + 1e-9
    assert 0.9 < programme.share <= 1.0
    assert programme.refined_factor >= 1 - 1e-9
    together = information_of(
        programme.model, [run.experiment for run in programme.runs], noise=SEA, priors=None
    )
    np.testing.assert_allclose(programme.information.std_errors, together.std_errors, rtol=1e-5)
    assert np.all(programme.spread.lowest <= programme.relative_errors * (1 + 1e-5))


def test_programme_beats_standard_trials(programme: Programme) -> None:
    """Zigzags need longer for the same criterion, and the report says how much longer."""
    assert programme.standard.ratio > 1.05
    words = programme.report()
    assert f"{programme.standard.ratio:.3g} times the ship" in words.replace("\n  ", " ")
    assert "DANGER" not in words
    stored = programme.to_dict()
    assert [run["name"] for run in stored["runs"]] == [run.name for run in programme.runs]
    assert Experiment.from_dict(stored["runs"][0]["experiment"]).duration == 40.0


def test_the_first_line_of_a_programme_is_the_answer(programme: Programme) -> None:
    """Runs, hours, what they buy and whether they are safe; danger stands before all of it."""
    words = programme.document().answer
    n, worst = len(programme.runs), int(np.argmax(programme.relative_errors))
    name, half_width = programme.names[worst], 1.96 * programme.relative_errors[worst]
    assert words.startswith(f"{n} runs, {programme.hours:.3g} h: ")
    assert f"{name}, which stays unidentified" in words
    joint = programme.information
    known = Information.from_matrix(joint.names, 100.0 * joint.matrix, programme.sizes)
    sharp = replace(programme, information=known).document().answer
    assert f"{name}, ± {100 * half_width / 10.0:.2g} % (95 %)" in sharp
    assert f"the limits on {100 * programme.kept:.0f} % of possible vehicles" in words
    name = programme.runs[0].name
    risky = {**programme.assurances, name: replace(programme.assurances[name], n_kept=150)}
    words = replace(programme, assurances=risky).document().answer
    assert words.startswith(f"DANGER: {name!r} leaves its limits on 25 % of possible vehicles; {n}")
    few = {
        name: replace(one, kept=np.roll(np.arange(100) > 3, 4 * index))
        for index, (name, one) in enumerate(programme.assurances.items())
    }
    together = replace(programme, assurances=few)
    assert not together.unsafe
    assert together.kept == pytest.approx(1 - 0.04 * len(few))
    assert (not together.together.is_enough) == (len(few) > 1)


@pytest.mark.usefixtures("few_judges")
def test_refined_commands_keep_the_rate_at_the_samples_of_the_run() -> None:
    """A search in coarse steps orders jumps; at fine samples they are ramps within the rate."""
    slow = replace(LIMITS, rates={"rudder": 0.05}, signals={"psi": (-1.5, 1.5)})
    long = replace(PATTERN, duration=200.0)
    found = design_programme(
        ship(),
        long,
        limits=slow,
        rng=np.random.default_rng(1),
        criterion=DOptimal(),
        budget=Budget(n_runs=2),
        search=ProgrammeSearch(kinds=("zigzag",), n_draws=1, n_vehicles=2),
        knowledge=Knowledge(noise=SEA, spread=0.05),
    )
    refined = [run for run in found.candidates if run.kind == "designed"]
    assert refined
    for run in refined:
        rudder = simulate(ship(), run.experiment, noise=False).input("rudder")
        assert np.abs(np.diff(rudder)).max() <= 0.05 * PATTERN.sample_time * (1 + 1e-6)


def test_programme_writes_every_run(programme: Programme, tmp_path) -> None:
    """One table of commands for each run, in order, playable as it stands, and its card."""
    paths = programme.write(tmp_path / "runs")
    tables, cards = paths[::2], paths[1::2]
    assert [path.name[:2] for path in tables] == [f"{i + 1:02d}" for i in range(len(tables))]
    assert [path.with_suffix(".csv") for path in cards] == list(tables)
    for path, run in zip(tables, programme.runs, strict=True):
        table = np.genfromtxt(path, delimiter=",", skip_header=1)
        planned = simulate(programme.model, run.experiment, noise=False)
        np.testing.assert_allclose(table[:, 1], planned.input("rudder"), atol=1e-9)


@pytest.mark.usefixtures("few_judges")
def test_sensors_are_chosen_by_what_they_cost() -> None:
    """A gyro that costs nothing is taken, one that costs all the time is not."""
    few = ProgrammeSearch(kinds=("zigzag",), n_draws=1, n_vehicles=2, n_rounds=0)
    found = [
        design_programme(
            ship(), PATTERN, limits=LIMITS, rng=np.random.default_rng(1), search=few,
            budget=Budget(hours=0.5, turnaround=300.0, sensors={"r": cost}),
            knowledge=Knowledge(noise=SEA, spread=0.1),
        )
        for cost in (0.0, 0.4)
    ]  # fmt: skip
    assert found[0].outputs == ("psi", "r")
    assert found[1].outputs == ("psi",)
    assert found[0].sensor_options["none"][1] < 1.0 < found[1].sensor_options["none"][1] + 1e-9


def test_impossible_programmes_are_named() -> None:
    """No time, no kind, no end: each is said with what to do."""

    def planned(hours: float, limits: Limits = LIMITS, kind: str = "zigzag") -> Programme:
        return design_programme(
            ship(), PATTERN, limits=limits, rng=np.random.default_rng(0), budget=Budget(hours),
            search=ProgrammeSearch(kinds=(kind,), n_vehicles=2), knowledge=Knowledge(spread=0.1),
        )  # fmt: skip

    with pytest.raises(DesignError, match="Not even the shortest run"):
        planned(0.1)
    with pytest.raises(DesignError, match="programme needs an end"):
        Budget()
    with pytest.raises(DesignError, match="no kind of run 'crash'"):
        planned(1.0, kind="crash")
    with pytest.raises(DesignError, match="No run of any kind"):
        planned(1.0, replace(LIMITS, signals={"psi": (0.1, 0.2)}))


def test_arguments_that_are_gone_say_the_new_spelling() -> None:
    """An old script is told what to write, for arguments and for names."""
    with pytest.raises(DesignError, match=r"'hours'. Write budget=Budget\(hours=...\)"):
        design_programme(ship(), PATTERN, limits=LIMITS, hours=1.0)  # type: ignore[call-arg]
    with pytest.raises(DesignError, match=r"trial=Trial\(duration=...\); search=Search\(n_starts"):
        design.design_experiment(ship(), duration=40.0, n_starts=1)  # type: ignore[call-arg]
    with pytest.raises(AttributeError, match="Reveal is Detect now"):
        _ = design.Reveal
