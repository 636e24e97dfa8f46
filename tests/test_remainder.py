"""What is left after the last step: random, repeated, or not known."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import steered_ship
from marks import slow
from motion import small
from simple_models import nomoto
from turning_ship import CANDIDATES, CUBIC, SHIP, dataset

from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Model, Output, Parameter, Record, improve, simulate_inputs
from oed_sysid.evidence import remainder
from oed_sysid.evidence.compare import forecasts
from oed_sysid.evidence.preparation import coarser, prepared
from oed_sysid.evidence.remainder import REMAINDER_LIMIT, RandomForceFound, Remains, remains
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.information import lagged_products
from oed_sysid.likelihood.whole_runs import OutputRuns, WholeRuns
from oed_sysid.physics import Effect, Force, actuator_lag, backlash

SIZES = [Parameter("m", 2.0, "kg", lower=0.1), Parameter("d", 1.0, "kg/s", lower=0.0)]
LAW = {"u": "(push - d*u)/m"}
CART = small("cart", "u [m/s] <- push [N]", LAW, SIZES, scales={"u": 0.3}, step=0.1)
DRY = Force("dry", {"u": "-F*tanh(u/0.02)/m"}, parameters=(Parameter("F", 0.0, "N"),))
FINE = 0.001  # m/s


def runs(slow: float, seed: int) -> list[Record]:
    """Two records of the cart as modelled, its sensor fine but for a slow drift, m/s."""
    rng = np.random.default_rng(seed)
    found = []
    for name in ("one", "two"):
        times = np.arange(0.0, 120.0, 0.1)
        push = np.repeat(rng.choice([-0.4, 0.0, 0.4], 30), 40)
        run = simulate_inputs(CART, times, inputs={"push": push}).outputs
        drift = slow * gauss_markov(rng.standard_normal(len(times)), 0.99)
        seen = run + (drift + FINE * rng.standard_normal(len(times)))[:, np.newaxis]
        found.append(Record(name, times, push[:, np.newaxis], seen, CART.channels))
    return found


@pytest.mark.parametrize(("slow", "kind"), [(0.0, "adequate"), (0.08, "not known")])
def test_slow_misfit_far_above_the_fast_content_is_not_certified(slow: float, kind: str) -> None:
    """Sixteen times the fast content of a sensor nobody declared is its drift, or the model's."""
    one, two = runs(slow, 1)
    found = improve(CART, Dataset((one,)), Dataset((two,)), candidates=[DRY], disturbances="none")
    assert found.remains.kind == kind
    assert found.verdict == ("unexplained" if slow else "nothing_missing")
    assert ("noise_std" in found.conclusion) == (slow > 0)


def dragged(seed: int, amplitude: float) -> Record:
    """Forty seconds of the cart with a little quadratic drag, 0.03 kg/m."""
    rng, times, u, rows = np.random.default_rng(seed), 0.1 * np.arange(400), 0.0, []
    push = amplitude * np.repeat(rng.choice([-1.0, 0.0, 1.0], 10), 40)
    for one in push:
        rows.append(u + 0.002 * rng.standard_normal())
        for _ in range(4):
            u += 0.025 * (one - u - 0.03 * u * abs(u)) / 2.0
    return Record(f"{seed}", times, push[:, None], np.array(rows), CART.channels)


def test_a_verdict_is_asked_with_the_noise_that_it_names() -> None:
    """Forces that are not real do not widen what sensors may have left of validation runs."""
    sensed = replace(CART, outputs=(Output("u", "m/s", noise_std=0.002),))
    train, test = (Dataset((dragged(*one),)) for one in ((3, 0.4), (53, 0.8)))
    found = improve(sensed, train, test, candidates=[DRY], terms=False)
    assert found.fit.noise.has_forces
    left = found.remains
    assert left.forces < REMAINDER_LIMIT
    assert not left.training.process_noise
    assert left.validation.outputs[0].z == pytest.approx(5.4, abs=0.3)  # 4 is noise
    assert left.kind == "structure missing"


def whole(
    z: float = 0.0,
    *,
    error: float = 1.0,
    forces: bool = False,
    declared: bool = True,
    without: float = 1.0,
    unasked: str = "",
) -> WholeRuns:
    """Whole runs of one output, noise 1 and spread 10."""
    one = OutputRuns("u", "m/s", error, without, 10.0, 1.0, declared, z)
    return WholeRuns((one,), forces, unasked, np.inf if unasked else 1.2)


@pytest.mark.parametrize(
    ("facts", "kind"),
    [
        ({}, "adequate"),
        ({"z": 5.0, "error": 3.0}, "structure missing"),
        ({"z": -5.0, "error": 0.5}, "adequate"),  # a sensor better than declared
        ({"z": 5.0, "error": 3.0, "declared": False}, "not known"),
        ({"error": 6.0, "declared": False}, "structure missing"),  # most of the signal
        ({"error": np.inf}, "structure missing"),
        ({"z": np.nan, "unasked": "runs diverge"}, "not known"),
        ({"forces": True}, "disturbance"),
        ({"forces": True, "z": -7.0}, "structure missing"),  # laws were not asked
        ({"forces": True, "z": 5.0}, "disturbance"),  # commands that answer widen it
        ({"forces": True, "z": 7.0, "declared": False}, "structure missing"),
        ({"forces": True, "error": 2.0}, "structure missing"),  # twice that without
        ({"forces": True, "error": 2.0, "z": np.nan, "unasked": "narrow-band"}, "not known"),
    ],
)
def test_the_verdict_is_of_whole_runs(facts: dict, kind: str) -> None:
    """Every kind from the facts alone, on training and on validation records alike."""
    runs_ = whole(**facts)
    force = RandomForceFound("force Y", "N", 6.0, 0.5, 500.0, 2.0, False)
    known = {"random": (force,), "follows": ()} if runs_.process_noise else {}
    gain = 500.0 if runs_.process_noise else 0.0
    found = Remains(gain, None, training=runs_, **known)
    assert found.kind == kind
    assert found.sentence.startswith(kind)
    calm = whole(forces=runs_.process_noise)
    assert Remains(gain, None, training=calm, validation=runs_, **known).kind == kind
    assert Remains(gain, None, training=runs_, suspect="A.", **known).kind == "log suspect"


def test_what_was_not_asked_is_not_known() -> None:
    """Without whole runs, or a question to the force, nothing is certified."""
    assert Remains(0.0, None).kind == "not known"
    force = RandomForceFound("force Y", "N", 6.0, 0.5, 500.0, np.nan, False)
    found = Remains(500.0, None, random=(force,), training=whole(forces=True))
    assert found.kind == "not known"
    assert "was not asked" in found.sentence


@pytest.mark.parametrize(("told", "kind"), [(True, "structure missing"), (False, "disturbance")])
def test_levels_differ_where_the_records_tell_them_apart(told: bool, kind: str) -> None:
    """Three times the level is another sea only where the records are likelier with it."""
    force = RandomForceFound("force Y", "N", 6.0, 0.5, 500.0, 2.0, told)
    assert force.is_the_same_elsewhere is not told
    found = Remains(500.0, None, random=(force,), training=whole(forces=True), follows=())
    assert found.kind == kind


def stiff(seed: int, noise: float, model: Model) -> Dataset:
    """Runs of a cart with dry friction that the model does not have."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, 120.0, 0.1)
    push = np.repeat(rng.choice([-0.4, 0.0, 0.4], 30), 40)
    u, path = 0.0, np.zeros(len(times))
    for k in range(len(times) - 1):
        for _ in range(10):
            u += 0.01 * (push[k] - u - 0.15 * np.tanh(u / 0.02)) / 2.0
        path[k + 1] = u
    seen = path + noise * rng.standard_normal(len(times))
    return Dataset((Record(f"dry {seed}", times, push[:, None], seen[:, None], model.channels),))


OPTIONS = list(product((0.5, 1.0, 20.0), ("none", "auto"), (False, True)))
QUICK = [(0.5, "auto", False), (1.0, "none", True), (20.0, "auto", True)]


@pytest.mark.parametrize(
    ("declared", "disturbances", "known_noise"),
    [*QUICK, *slow(*(one for one in OPTIONS if one not in QUICK))],
)
def test_no_option_certifies_a_run_beyond_its_spread(
    known_noise: bool, disturbances: str, declared: float
) -> None:
    """Dry friction that no candidate holds: noise known or not, fine or coarse, forces or none."""
    output = Output("u", "m/s", noise_std=declared * FINE)
    model = replace(CART, outputs=(output,))
    options = {"known_noise": known_noise, "disturbances": disturbances}
    train, test = (stiff(seed, FINE, model) for seed in (1, 2))
    study, fit = Study.begin(model, train, test, (), **options)
    found = study.result(study.polished(study.settle(fit)), "fit")
    left = replace(remains(study, fit), training=found.whole_runs, validation=found.runs_on(test))
    assert left.kind in ("structure missing", "not known")


HEAVY = [Parameter("m", 60.0, "kg", fixed=True), Parameter("d", 2.0, "kg/s", lower=0.0)]
DRIFTER = small(
    "drifter", "u [m/s], x [m] <- push [N]", LAW | {"x": "u"}, HEAVY, {"x": 0.3},
    scales={"x": 10.0}, step=0.1,
)  # fmt: skip


def drifts(seed: int, level: float, n: int, seconds: float = 40.0) -> Dataset:
    """Positions of a craft of 60 kg and 3 kg/s under a force that lasts a second, N."""
    rng = np.random.default_rng(seed)
    found = []
    for index in range(n):
        times = np.arange(0.0, seconds, 0.1)
        push = np.repeat(rng.choice([5.0, 15.0, 25.0], len(times) // 60 + 1), 60)[: len(times)]
        x, u, w = np.zeros(len(times)), 3.0, 0.0
        for k in range(len(times) - 1):
            w = np.exp(-0.1) * w + np.sqrt(1 - np.exp(-0.2)) * level * rng.standard_normal()
            x[k + 1] = x[k] + 0.1 * u
            u += 0.1 * (push[k] + w - 3.0 * u) / 60.0
        seen = x + 0.3 * rng.standard_normal(len(times))
        seen[np.arange(len(times)) % 5 > 0] = np.nan
        found.append(
            Record(f"run {seed} {index}", times, push[:, None], seen[:, None], DRIFTER.channels)
        )
    return Dataset(found)


@pytest.mark.parametrize("level", [8.0, 32.0])
def test_short_records_do_not_tell_level_from_time(level: float) -> None:
    """The same sea is the same where another level and time fit as well; a fourfold one is not."""
    train, test = drifts(19, 8.0, 2), drifts(20, level, 1)
    study, fit = Study.begin(DRIFTER, train, test, (), known_noise=False)
    (force,) = remains(study, study.settle(fit)).random
    assert max(force.level, force.elsewhere) > 2.0 * min(force.level, force.elsewhere)
    assert force.told is (level == 32.0)
    assert force.is_the_same_elsewhere is (level == 8.0)


def test_forces_that_are_real_together_are_named_and_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each costs little to leave out where others stand for it, all of them do not."""
    study, fit = Study.begin(DRIFTER, drifts(19, 8.0, 2), None, (), known_noise=False)
    costs = iter([31.0, 10.0])
    monkeypatch.setattr(remainder, "_lost", lambda *_: next(costs))
    found = remains(study, fit)
    assert [(one.place, one.gain) for one in found.random] == [("force u", 10.0)]
    assert found.random[0].level == fit.noise.force[0] > 0.0
    assert found.follows == ()
    assert replace(found, training=whole(forces=True)).kind == "disturbance"


def wall(r: float, psi: float, lagged: float) -> float:
    """A soft wall that turns the ship back."""
    return -0.04 * np.tanh(20.0 * (psi - 0.2))


@pytest.mark.parametrize(
    ("law", "kind"), [(wall, "structure missing"), *slow((steered_ship.nothing, "disturbance"))]
)
def test_a_wall_is_no_sea(law: steered_ship.Share, kind: str) -> None:
    """A force that no term holds is said to follow the heading; a disturbance stays one."""
    train, test = (steered_ship.two(seed, law) for seed in (0, 1))
    study, fit = Study.begin(steered_ship.YAW, train, test, (), known_noise=False)
    found = study.result(study.polished(study.settle(fit)), "fit")
    left = replace(remains(study, fit), training=found.whole_runs, validation=found.runs_on(test))
    assert left.kind == kind
    assert left.follows is not None
    for force in left.follows:
        assert "psi" in force.signals
        assert force.statistic > 2 * force.needed
    assert bool(left.follows) is (law is wall)
    # The forces themselves say so, where whole runs say nothing.
    assert replace(left, training=whole(forces=True), validation=None).kind == kind


def test_lagged_products() -> None:
    """Sums of products, as written out."""
    series = np.array([1.0, -2.0, 0.5, 3.0])
    expected = [series @ series, series[:-1] @ series[1:], series[:-2] @ series[2:]]
    np.testing.assert_allclose(lagged_products(series, 2), expected, atol=1e-12)


YAW = nomoto(0.3, 2.0, noise=(0.002, 0.001), step=0.1)


@pytest.mark.parametrize(
    ("effect", "size"),
    [(backlash("play", "rudder"), 0.05), *slow((actuator_lag("lag", "rudder"), 3.0))],
)
def test_of_the_truth_forecasts_are_as_good_as_stated(effect: Effect, size: float) -> None:
    """Errors over their stated size are one, with a play and with a slow rudder."""
    rng = np.random.default_rng(4)
    model = (YAW + effect).with_values({effect.amplitude_names[0]: size})
    times = np.arange(0.0, 300.0, 0.2)
    rudder = np.repeat(rng.uniform(-0.3, 0.3, 100), 15)
    run = simulate_inputs(model, times, inputs={"rudder": rudder})
    seen = run.outputs + np.array([0.002, 0.001]) * rng.standard_normal(run.outputs.shape)
    record = Record("run", times, rudder[:, np.newaxis], seen, model.channels)
    found = forecasts(model, Dataset((record,)), np.array([0.002, 0.001]), horizon=10.0)
    assert found.n_forecasts > 20
    ratio = np.sqrt(np.nanmean((found.errors[0] / found.expected[0]) ** 2))
    assert ratio == pytest.approx(1.0, abs=0.1)


def long_dive(n_samples: int, step: float, *, noise: float, period: float = 20.0) -> Record:
    """A ship that steers to and fro by the clock, with cubic damping, sampled fast."""
    truth = (SHIP + CUBIC).with_values({"K": 0.5, "T": 4.0, "n3": -15.0})
    times = step * np.arange(n_samples)
    rudder = 0.5 * np.sign(np.sin(2 * np.pi * times / period))
    run = simulate_inputs(truth, times, inputs={"rudder": rudder})
    random = np.random.default_rng(3).standard_normal(run.outputs.shape)
    scale = noise * np.array([0.01, 0.004])
    return Record("dive", times, run.inputs, run.outputs + random * scale, SHIP.channels)


def test_of_a_single_record_the_end_is_kept_for_validation() -> None:
    """Every sample is on one side, in order, and the words name the time of the cut."""
    record = dataset(1)[0]
    ready = prepared(Dataset((record,)), None)
    times = [*ready.train[0].times, *ready.validation[0].times]
    assert times == list(record.times)
    assert ready.train.n_samples == pytest.approx(0.6 * record.n_samples, abs=1)
    assert f"{ready.validation[0].times[0]:.4g} s" in ready.notes[0]


def test_several_records_and_short_ones_stay_as_they_are() -> None:
    """Nobody's choice of records is changed, and nothing is cut from what is short."""
    several = dataset(1)
    assert prepared(several, None).validation is None
    short = Dataset((several[0].window(0.0, 30.0),))
    assert prepared(short, None).train is short


def test_mean_inputs_keep_the_trajectory() -> None:
    """With fewer samples of the inputs the ship moves as it did, unlike with every fifth one."""
    record = long_dive(3000, 0.02, noise=0.0, period=7.3)
    few = coarser(record, 5)
    truth = (SHIP + CUBIC).with_values({"K": 0.5, "T": 4.0, "n3": -15.0})
    errors = []
    for inputs in (few.inputs, record.thin(5).inputs):
        run = simulate_inputs(truth, few.times, inputs={"rudder": inputs[:, 0]})
        errors.append(np.abs(run.outputs - few.outputs).max(axis=0))
    assert np.all(errors[0] < 0.2 * errors[1])


def test_stride_is_bounded_by_what_the_signal_does() -> None:
    """A log without noise that bends within a few samples is read more finely than a calm one."""
    calm = prepared(Dataset((long_dive(3000, 0.02, noise=1.0),)), None, enough=100)
    quick = long_dive(3000, 0.4, noise=0.001, period=5.0)
    fine = prepared(Dataset((quick,)), None, enough=100)
    assert calm.train[0].sample_time == pytest.approx(0.02 * 30)
    assert fine.train[0].sample_time < 4 * 0.4


def test_a_long_log_is_searched_in_fewer_samples_and_the_effect_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The hidden damping comes out of a thinned log with its value, and the result says so."""
    monkeypatch.setattr(prepared, "__kwdefaults__", {"enough": 1500})
    log = Dataset((long_dive(6000, 0.05, noise=1.0),))
    found = improve(SHIP, log, candidates=CANDIDATES)
    assert [step.added for step in found.steps] == ["cubic_damping"]
    row = next(row for row in found.parameters if row["name"] == "n3")
    assert abs(row["value"] + 15.0) < 4 * row["std_error"]
    assert found.fit.dataset.n_samples == 900
    assert len(found.notes) >= 2
