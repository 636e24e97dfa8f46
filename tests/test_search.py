"""The search for missing effects: no stage returns less than it was given, nor than a plain fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from marks import slow
from motion import small
from scipy.linalg import expm

import oed_sysid.evidence.search as search_module
import oed_sysid.evidence.study as study_module
from oed_sysid import Dataset, Force, MultipleShooting, NoiseModel, Parameter, Record, improve
from oed_sysid.evidence.claim import Claim
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.evidence.rank import Ranking, Refit, rank
from oed_sysid.evidence.remainder import Remains
from oed_sysid.evidence.search import (
    Added,
    Ended,
    Search,
    Standing,
    eliminated,
    not_astray,
    with_alike,
    with_refit,
    with_waves,
)
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.laws import Law
from oed_sysid.likelihood.noise_parts import begun
from oed_sysid.likelihood.projection import eliminate
from oed_sysid.physics import actuator_delay, actuator_lag, sensor_bias
from oed_sysid.runtime.journal import Journal

TURNING = {"a_v": 0.12, "a_r": 3.0, "a_d": 0.25, "c_v": 0.004, "c_r": 0.16, "c_d": 0.022}
SHIP = small(
    "turning ship",
    "v [m/s], r [rad/s] <- rudder [rad]",
    {"v": "-a_v*v - a_r*r + a_d*delta", "r": "-c_v*v - c_r*r - c_d*delta"},
    {f"{name} [1]": 0.9 * value for name, value in TURNING.items()},
    {"v": 0.02, "r": 0.0006},
    scales={"v": 0.5, "r": 0.03},
    actuators={"delta": "rudder"},
    step=0.5,
)


def turns(seed: int, lag: float, gusts: float = 0.0) -> Dataset:
    """One run of the ship, rudder held between samples, lagging, in white gusts of sway, m/s^2."""
    rng, n, step = np.random.default_rng(seed), 400, 0.5
    rudder = np.repeat(rng.uniform(-0.3, 0.3, n // 20), 20)
    k = TURNING
    rates = np.array([
        [-k["a_v"], -k["a_r"], k["a_d"], 0.0],
        [-k["c_v"], -k["c_r"], -k["c_d"], 0.0],
        [0.0, 0.0, -1.0 / lag, 1.0 / lag],
        [0.0, 0.0, 0.0, 0.0],
    ])  # fmt: skip
    move = expm(step * rates)
    state, states = np.array([0.0, 0.0, rudder[0], rudder[0]]), np.zeros((n, 2))
    for i, angle in enumerate(rudder):
        state[3] = angle
        states[i] = state[:2]
        state = move @ state + gusts * step * rng.standard_normal() * np.eye(4)[0]
    seen = states + np.array([0.02, 0.0006]) * rng.standard_normal((n, 2))
    return Dataset(
        (Record(f"turn {seed}", step * np.arange(n), rudder[:, None], seen, SHIP.channels),)
    )


def small_forces(study: Study, base: FilteredSolution) -> NoiseModel:
    """The noise of a fit with forces no larger than the records begin to tell."""
    unit = dict(zip(study.unit.places, study.unit.force, strict=True))
    small = np.minimum(base.noise.force, [unit.get(place, 0.0) for place in base.noise.places])
    return replace(base.noise, force=small)


def test_an_effect_is_estimated_anew_from_nominal_values() -> None:
    """A lag in the place of the ship's own time leads back to nowhere; white noise does."""
    lag = actuator_lag("rudder_lag", "delta", scale=0.5)
    study, base = Study.begin(SHIP, turns(0, 1.5), None, (lag,), known_noise=False)
    swapped = {"a_v": -0.07, "a_r": -3.6, "a_d": 0.65, "c_v": 0.02, "c_r": 0.7, "c_d": 0.06}
    start = base.values | swapped | {"E_rudder_lag": 3.7}
    astray = study.estimate(study.candidates, start, base, noise=study.loosened(base.noise))
    assert astray.values["E_rudder_lag"] > 3.0
    found = not_astray(study, astray)
    assert found.values["E_rudder_lag"] == pytest.approx(1.5, abs=0.1)
    assert found.objective < astray.objective - 90.0


def test_what_does_as_well_beside_the_model_that_was_made_is_in_its_group() -> None:
    """Of two that were behind an offset of the rudder one does nearly the same, a push does not."""

    def force(name: str, **by: float) -> Force:
        size = Parameter(f"E_{name}", 0.0, "1", scale=0.05)
        return Force(name, {axis: f"{one}*E_{name}" for axis, one in by.items()}, (size,))

    offset, near = force("offset", v=0.25, r=-0.022), force("near", v=0.23, r=-0.023)
    push = force("push", v=0.25)
    (run,) = turns(0, 0.05)
    data = Dataset((replace(run, inputs=run.inputs - 0.02),))
    study, base = Study.begin(SHIP, data, None, (offset, near, push), known_noise=False)
    fit = study.estimate((offset,), base.values, base, noise=small_forces(study, base))
    assert fit.values["E_offset"] == pytest.approx(0.02, abs=0.005)
    behind = tuple(
        Claim(one.name, 40.0, np.nan, 10.0, behind="behind offset") for one in (near, push)
    )
    added = Added(offset, Claim("offset", 50.0, np.nan, 10.0), ("offset",))
    state = Standing(study, (added,), fit, (base, fit), behind)
    (found,) = with_alike(state, rank(study, fit, state.left, n_refits=0)).added
    assert found.group == ("offset", "near")
    # What is in the model by itself is no other name for what stands beside it.
    ranking = rank(study, fit, (near, push), n_refits=0, also=("near",))
    claims = [Claim("near", 40.0, np.nan, 10.0)]
    after = with_refit(replace(state, added=(found,)), ranking.refits[0], claims, ranking)
    assert [one.group[0] for one in after.added] == ["offset", "near"]
    assert after.added[0].group == ("offset",)


PUSH = Force("push", {"v": "E_push"}, (Parameter("E_push", 0.0, "m/s^2", scale=0.1),))


def gusty(seed: int) -> tuple[Dataset, list[tuple[Study, FilteredSolution]]]:
    """A run in gusts, and the nominal fits to it with disturbance forces and without."""
    data = turns(seed, 0.1, gusts=0.3)
    begin = partial(Study.begin, SHIP, data, None, (PUSH,), known_noise=False)
    return data, [begin(disturbances=where) for where in ("auto", "none")]


@pytest.mark.parametrize(("seed", "better"), [(4, 2.0), *slow((3, 1.1))])
def test_forces_are_not_left_out_for_nothing(
    seed: int, better: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is found without them and not needed beside them is no reason, nor are better runs."""
    data, ((study, base), (calm, fit)) = gusty(seed)
    pushed = calm.estimate((PUSH,), fit.values, fit)
    assert study.own_error(base, data) > better * calm.own_error(fit, data)
    ranking = rank(study, base, ())
    claimed = Added(PUSH, Claim("push", 20.0, np.nan, 10.0), ("push",))
    state = Standing(calm, (claimed,), pushed, (fit, pushed))
    monkeypatch.setattr(Search, "ended", lambda *given: (state, ranking, None))
    left = Remains(500.0, None, follows=(Law("force v", ("v",), 90.0, 40, 80.0),))
    end = Ended(Standing(study, (), base, (base,)), ranking, None, left)
    looking = Search(1, lambda text: None, Journal(), [], None, terms=False)
    found = looking.calmer(end, calm, fit).state
    assert not found.added
    assert found.fit.objective < pushed.objective - 200.0
    assert found.fit.noise.level("force v")[0] == base.noise.level("force v")[0]


def test_what_whole_runs_refuse_is_not_asked_effect_by_effect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whole runs less than twice as good are no reason to leave out forces, whatever is needed."""
    data, ((study, base), (calm, fit)) = gusty(3)
    ranking, added = rank(study, base, ()), Added(PUSH, Claim("push", 20.0, np.nan, 10.0), ())
    state, asked = Standing(calm, (added,), fit, (fit,)), list[Standing]()
    monkeypatch.setattr(Search, "ended", lambda *given: (state, ranking, None))
    monkeypatch.setattr(search_module, "eliminated", lambda *given: asked.append(given[0]))
    end = Ended(Standing(study, (), base, (base,)), ranking, None, Remains(500.0, None))
    looking = Search(1, lambda text: None, Journal(), [], None, terms=False)
    assert 1.1 < study.own_error(base, data) / calm.own_error(fit, data) < 2.0
    found = looking.calmer(end, calm, fit).state
    assert found.fit is base
    assert [one.name for one in found.decisions] == ["push"]
    assert not asked


ROLLING = small(
    "rolling ship",
    "p [rad/s], phi [rad] <- rudder [rad]",
    {"p": "-K_p*p - K_phi*phi - K_d*rudder", "phi": "p"},
    {"K_p [1]": 0.05, "K_phi [1]": 0.15, "K_d [1]": 0.02},
    {"phi": 0.003},
    scales={"p": 0.01, "phi": 0.05},
    step=0.5,
)


def rolls(seed: int, level: float) -> Dataset:
    """Three runs in twelve waves about 9 s, of a level in rad/s^2; forces held a tenth of 1 s."""
    rng, times, found = np.random.default_rng(seed), np.arange(300.0), []
    rates = np.array([[-0.05, -0.15, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    move, middle = expm(0.1 * rates), np.arange(3000) * 0.1 + 0.05
    for run in range(3):
        rudder = np.repeat(rng.uniform(-0.3, 0.3, 15), 20)
        phases = 2 * np.pi * (middle[:, None] / np.linspace(8.0, 10.0, 12) + rng.random(12))
        push = level * np.cos(phases).sum(axis=1) / np.sqrt(6.0) - 0.02 * np.repeat(rudder, 10)
        states = np.zeros((3001, 3))
        for k, force in enumerate(push):
            states[k, 2] = force
            states[k + 1] = move @ states[k]
        seen = states[:3000:10, 1:2] + 0.003 * rng.standard_normal((300, 1))
        found.append(Record(f"run {run}", times, rudder[:, None], seen, ROLLING.channels))
    return Dataset(found)


@pytest.mark.slow
def test_a_swell_is_found_that_the_noise_of_a_sensor_had_taken() -> None:
    """It moves the ship about as much as the inclinometer's noise, which is free to grow."""
    data = rolls(1, 0.0008)
    study, base = Study.begin(ROLLING, data, None, (), known_noise=False)
    fit = study.settle(base)
    assert fit.noise.has_colour
    found = with_waves(Standing(study, (), fit, (fit,)), None)
    (sea,) = found.fit.noise.seas
    assert sea.period == pytest.approx(8.8, abs=0.3)
    assert sea.level[0] == pytest.approx(0.0008, rel=0.15)
    assert found.fit.noise.white[0] == pytest.approx(0.003, rel=0.05)
    assert found.fit.objective < fit.objective - 100.0
    plain = MultipleShooting().fit(ROLLING, data)
    posed = study.polished(found.fit)
    assert study.result(posed, "").log_likelihood > plain.log_likelihood - 1.0


def test_a_sea_is_asked_again_beside_a_term(monkeypatch: pytest.MonkeyPatch) -> None:
    """For want of the term its forces may have followed motion; the nominal fit stays the first."""
    study, base = Study.begin(ROLLING, rolls(1, 0.003), None, (), known_noise=False)
    noise = small_forces(study, base)
    calm = study.estimate((), base.values, base, noise=noise, update_noise=False)
    assert calm is not None
    state = Standing(study, (), base, (calm,))
    monkeypatch.setattr(search_module, "with_term", lambda *given: (state, "the term", ()))
    end = Ended(state, rank(study, base, ()), None, Remains(500.0, None))
    looking = Search(1, lambda text: None, Journal(), [], None, terms=True)
    found = looking.beyond(end).state
    (sea,) = found.fit.noise.seas
    assert sea.period == pytest.approx(8.9, abs=0.3)
    assert sea.level[0] == pytest.approx(0.003, rel=0.15)
    assert found.path == (calm, found.fit)


@pytest.fixture(scope="module")
def lagging() -> tuple[Study, FilteredSolution, FilteredSolution, Ranking]:
    """A ship with a small lag: its study, fit, one of much worse runs, and the lag's refit."""
    lag = actuator_lag("rudder_lag", "delta", scale=0.5)
    study, base = Study.begin(SHIP, turns(5, 0.05), turns(6, 0.05), (lag,), known_noise=False)
    with_lag = study.estimate((lag,), base.values, base)
    unknowns = with_lag.point.unknowns.copy()
    unknowns[:2] *= 2.0
    worse = FilteredSolution(begun(with_lag.problem, unknowns), 1, "converged")
    assert study.own_error(worse) > 2.0 * study.own_error(base)
    ranking = rank(study, base, study.candidates, n_refits=0)
    refit = Refit(ranking.scores, with_lag, 0.0, 10.0)
    return study, base, worse, replace(ranking, refits=(refit,))


def test_no_stage_returns_worse_whole_runs(
    lagging: tuple[Study, FilteredSolution, FilteredSolution, Ranking],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where a better likelihood predicts worse, every stage returns what it was given."""
    study, base, worse, ranking = lagging
    (lag,) = ranking.refits
    better = study.polished(base)
    assert better is not base
    assert study.own_error(better) == pytest.approx(study.own_error(base), rel=1e-2)
    claimed = Claim(lag.name, 20.0, 1.0, 10.0)
    state = Standing(study, (), base, (base,))
    added = with_refit(state, lag, [claimed], ranking)
    assert study.own_error(added.fit) < 1.02 * study.own_error(lag.fit)

    monkeypatch.setattr(study_module, "solved", lambda *given, **named: worse)
    monkeypatch.setattr(Study, "settle", lambda self, fit: worse)
    monkeypatch.setattr(Study, "resolved", lambda self, fit: worse)
    assert study.polished(lag.fit) is lag.fit
    assert with_refit(state, lag, [claimed], ranking).fit is lag.fit
    # Left out for less than its threshold, were the runs without it not worse.
    spared = replace(added, added=(*added.added, *added.added))
    monkeypatch.setattr(search_module, "_without", lambda state, one: worse)
    monkeypatch.setattr(search_module, "claim", lambda *given: Claim("lag", 0.0, 0.0, 10.0))
    assert eliminated(spared) is spared


def test_a_bound_is_asked_with_the_threshold_of_what_is_claimed() -> None:
    """What takes the place of others needs less; its bound is no more suspect for it."""
    one = Claim("x", 111.0, 272.0, 4.9, 24.5, 13.1, 1.25, ("E_x",), 5.0, spared=21.0)
    assert one.decision == "stands, at its bound (E_x)"
    assert replace(one, beyond=26.0).decision.endswith("26.0 likelier beyond")


def test_rounding_of_what_is_known_makes_no_prediction(
    lagging: tuple[Study, FilteredSolution, FilteredSolution, Ranking],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A filter that nearly diverges leaves a direction known less than nothing: not known."""
    study, base, *_ = lagging
    assert study.validation is not None
    honest = study.predict(base, study.validation).misfit

    def rounded(matrix: np.ndarray, kept: np.ndarray, others: np.ndarray) -> np.ndarray:
        found = eliminate(matrix, kept, others)
        values, vectors = np.linalg.eigh(found)
        return found - (values[0] + 1e-3 * values[-1]) * np.outer(vectors[:, 0], vectors[:, 0])

    monkeypatch.setattr(study_module, "eliminate", rounded)
    found = study.predict(replace(base), study.validation)
    told = np.linalg.eigvalsh(found.known)
    assert told[0] > -1e-9 * told[-1]
    assert found.misfit == pytest.approx(honest, abs=10.0)


CARRIAGE = small(
    "carriage",
    "v [m/s] <- pull [N]",
    {"v": "(pull - drag*v)/10"},
    {"drag [N*s/m]": 2.5},
    {"v": 0.01},
    step=0.05,
)


def pulled(seed: int, resistance: Callable[[float], float]) -> Record:
    """Ten kilograms, 2 N s/m and a resistance, N, of the speed; the pull held."""
    rng, n, inner = np.random.default_rng(seed), 300, 50
    pull = np.repeat(rng.uniform(-8.0, 8.0, n // 10), 10)
    v, seen = 0.0, np.zeros(n)
    for i, force in enumerate(pull):
        seen[i] = v
        for _ in range(inner):
            v += 0.1 / inner * (force - 2.0 * v - resistance(v)) / 10.0
    noisy = seen + 0.01 * rng.standard_normal(n)
    times = 0.1 * np.arange(n)
    return Record(f"pull {seed}", times, pull[:, None], noisy[:, None], CARRIAGE.channels)


def improved_carriage(resistance: Callable[[float], float]) -> Improvement:
    """The carriage improved, of which only a quadratic drag was named as a candidate."""
    first, second, last = (pulled(seed, resistance) for seed in (1, 2, 3))
    drag = Force("square", {"v": "-square*abs(v)*v/10"}, [Parameter("square", 0.0, "kg/m")])
    return improve(CARRIAGE, Dataset((first, second)), Dataset((last,)), candidates=[drag])


@pytest.mark.slow
def test_usual_physics_is_asked_before_a_polynomial() -> None:
    """Dry friction of 1.5 N that sets in within 0.02 m/s."""
    found = improved_carriage(lambda v: 1.5 * np.tanh(v / 0.02))
    assert [step.added for step in found.steps] == ["friction_v"]
    assert found.remains.kind == "adequate"
    assert 10.0 * found.fit.values["E_friction_v"] == pytest.approx(1.5, rel=0.05)


def test_a_polynomial_that_explains_more_is_asked_before_usual_physics() -> None:
    """A cube of the speed: no usual effect is claimed on the way to it, or asked at all."""
    found = improved_carriage(lambda v: 8.0 * v**3)
    assert [step.added for step in found.steps] == ["term_v_vvv"]
    assert found.remains.kind == "adequate"
    assert -10.0 * found.fit.values["v_vvv"] == pytest.approx(8.0, rel=0.05)
    assert "friction_v" not in {one.name for one in found.decisions}


def test_a_place_to_begin_waits_for_its_integration_step(
    lagging: tuple[Study, FilteredSolution, FilteredSolution, Ranking],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only a search whose estimates are handed on resolves them after every addition."""
    study, base, _, ranking = lagging
    (lag,) = ranking.refits
    claimed = Claim(lag.name, 20.0, 1.0, 10.0)
    state, steps = Standing(study, (), base, (base,)), list[float]()

    def resolved(self: Study, fit: FilteredSolution) -> FilteredSolution:
        steps.append(fit.problem.model.step)
        return fit

    monkeypatch.setattr(Study, "resolved", resolved)
    first = with_refit(replace(state, provisional=True), lag, [claimed], ranking)
    assert not steps
    assert with_refit(state, lag, [claimed], ranking).fit.objective == first.fit.objective
    assert steps == [0.5]


LIGHT = {"c": 0.06, "k": 0.4, "b": 0.01}
STEADY = small(
    "lightly damped roll",
    "phi [rad], p [rad/s] <- push [1]",
    {"phi": "p", "p": "-c*p - k*phi + b*push"},
    {f"{name} [1]": 1.2 * value for name, value in LIGHT.items()},
    {"phi": 0.001, "p": 0.001},
    step=2.0,
)


def swings(step: float, values: Mapping[str, float], push: np.ndarray) -> np.ndarray:
    """Angle and rate of an oscillation, exact between samples, where a push is held."""
    c, k, b = values.values()
    move = expm(step * np.array([[0.0, 1.0, 0.0], [-k, -c, b], [0.0, 0.0, 0.0]]))
    states = np.zeros((push.size, 3))
    for row in range(push.size - 1):
        states[row, 2] = push[row]
        states[row + 1] = move @ states[row]
    return states[:, :2]


def pushed(seed: int) -> Dataset:
    """A run of the roll, five samples a period."""
    rng, n = np.random.default_rng(seed), 300
    push = np.repeat(rng.uniform(-1.0, 1.0, n // 10), 10)
    measured = swings(2.0, LIGHT, push) + 0.001 * rng.standard_normal((n, 2))
    record = Record(f"run_{seed}", 2.0 * np.arange(n), push[:, None], measured, STEADY.channels)
    return Dataset((record,))


def test_where_nothing_is_missing_no_estimate_depends_on_the_step() -> None:
    """By the step as given, which damps the roll itself, a lag of the push was claimed."""
    found = improve(STEADY, pushed(0), pushed(1), candidates=[actuator_lag("lag", "push")])
    assert not found.steps
    assert found.fit.model.step < 2.0
    assert "finer_step" in {one.kind for one in found.fit.concerns}
    plain = MultipleShooting().fit(STEADY, pushed(0))
    for name, value in LIGHT.items():
        error = found.fit.std_errors[name]
        assert abs(found.fit.values[name] - value) < 3.0 * error
        assert abs(found.fit.values[name] - plain.values[name]) < 0.3 * error


HEAVY = {"d": 0.45, "k": 0.28, "b": -0.5}
SWING = small(
    "swing",
    "x [m], v [m/s] <- u [1]",
    {"x": "v", "v": "b*u - d*v - k*x"},
    {f"{name} [1]": 1.25 * value for name, value in HEAVY.items()},
    {"x": 0.031, "v": 0.014},
    step=0.25,
)


@pytest.mark.parametrize("error", [1.76, *slow(3.0)])
def test_a_velocity_far_off_is_no_force(error: float) -> None:
    """By two and four times its motion: forces that followed it left models that diverge."""
    runs = []
    for seed in (0, 1):
        rng, times = np.random.default_rng(seed), 0.25 * np.arange(400)
        push = np.sin(2.0 * np.pi * (0.02 + 0.002 * times) * times + seed)
        noise = [0.031, 0.014] * rng.standard_normal((times.size, 2))
        measured = swings(0.25, HEAVY, push) + noise + [0.0, error]
        run = Record(f"run_{seed}", times, push[:, None], measured, SWING.channels)
        runs.append(Dataset((run,)))
    candidates = [actuator_lag("lag", "u"), sensor_bias("bias", "v", "m/s", scale=0.01)]
    found = improve(SWING, *runs, candidates=candidates, terms=False)
    assert found.base_error["train"] < error / 0.014
    assert [step.added for step in found.steps] == ["bias"]
    for name, value in {**HEAVY, "E_bias": error}.items():
        assert abs(found.fit.values[name] - value) < 4.0 * found.fit.std_errors[name]


@pytest.mark.slow
def test_spikes_are_left_out_of_a_search_as_of_a_fit() -> None:
    """Five of fifteen standard deviations in each record change no more than gaps there do."""
    rows = [40, 95, 150, 203, 260]
    spoilt, lost = list[Dataset](), list[Dataset]()
    for (record,) in (pushed(2), pushed(3)):
        spikes, gaps = (record.outputs.copy() for _ in range(2))
        spikes[rows, 0] += 0.015
        gaps[rows, 0] = np.nan
        spoilt.append(Dataset((record.with_outputs(spikes),)))
        lost.append(Dataset((record.with_outputs(gaps),)))
    found, right = (
        improve(STEADY, *records, candidates=[actuator_lag("lag", "push")], terms=False)
        for records in (spoilt, lost)
    )
    assert found.fit.excluded == {"phi": (5, 300)}
    assert "Left out of the training records as spikes: 5 of 300 samples of phi." in found.notes
    assert not right.fit.excluded
    assert found.remains.kind == right.remains.kind == "adequate"
    for name, error in right.fit.std_errors.items():
        assert found.fit.values[name] == pytest.approx(right.fit.values[name], abs=0.01 * error)
        assert found.fit.std_errors[name] == pytest.approx(error, rel=0.01)


def test_no_estimate_is_coarser_than_the_filter_of_its_study() -> None:
    """A filter made for a finer step holds the registers of a delay that go with it."""
    late = actuator_delay("late", "delta", max_delay=2.0, step=0.5, scale=0.5)
    study, base = Study.begin(SHIP, turns(5, 0.05), turns(6, 0.05), (late,), known_noise=False)
    finer = replace(study, kernel=study.kernel_by(0.25))
    found = finer.estimate((late,), base.values, base, max_iterations=2)
    assert found.problem.model.step == 0.25
    assert finer.own_error(found) == pytest.approx(study.own_error(base), rel=0.05)


def test_both_of_a_pair_are_asked_again(
    lagging: tuple[Study, FilteredSolution, FilteredSolution, Ranking],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of two effects that were claimed as one, either may do without the other."""
    study, base, _, ranking = lagging
    (lag,) = ranking.refits
    first, second = (replace(lag.effects[0], name=name) for name in ("first", "second"))
    asked = list[str]()
    monkeypatch.setattr(
        search_module, "_spared", lambda state, there, one, rise: asked.append(one.effect.name)
    )
    single = [Added(one, Claim(one.name, 20.0, 1.0, 10.0), (one.name,)) for one in (first, second)]
    eliminated(Standing(study, tuple(single), base, (base,)))
    assert asked == ["first"]
    both = Claim("first + second", 20.0, 1.0, 10.0)
    eliminated(Standing(study, tuple(replace(one, claim=both) for one in single), base, (base,)))
    assert asked == ["first", "first", "second"]
