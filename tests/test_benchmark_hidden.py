"""Benchmarks of hidden effects: simulators, cases, limits, and what is counted."""

from __future__ import annotations

import json
import math
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from benchmarks.harness import Store, run_cases
from benchmarks.missing_physics.cases import CONDITIONS, Draw, case, draws
from benchmarks.missing_physics.measures import as_markdown, measures
from benchmarks.missing_physics.simulator import PRIORS, TEST, TRAIN, Case, Noise, simulate
from benchmarks.other_vehicles import run as runner
from benchmarks.other_vehicles.cases import PATTERN, draw_case, single_effect
from benchmarks.other_vehicles.cases import draws as draws_vehicles
from benchmarks.other_vehicles.judge import nominal_model, true_model
from benchmarks.other_vehicles.measures import as_markdown as as_markdown_vehicles
from benchmarks.other_vehicles.measures import measures as measures_vehicles
from benchmarks.other_vehicles.models import nominal
from benchmarks.other_vehicles.truth import VEHICLES, auv, catamaran, coaster
from benchmarks.other_vehicles.truth.detect import gains
from benchmarks.other_vehicles.truth.simulator import Manoeuvre, Plant, Vehicle, constant, multisine
from benchmarks.other_vehicles.truth.simulator import simulate as simulate_vehicle
from benchmarks.rates import at_most
from benchmarks.speed import six_degrees_task
from benchmarks.truth import NOISE, gauss_markov
from oed_sysid.experiments.simulation import simulate_inputs

SHARED = Path(os.environ.get("OED_SYSID_DATA", "")) / "hidden_effects"


@pytest.mark.slow
@pytest.mark.skipif(
    not (SHARED / "answers.json").exists(), reason="OED_SYSID_DATA holds no records"
)
def test_simulator_reproduces_records_of_another_simulator() -> None:
    """With the stated truth and the same commands, what is left of 70 records is their noise."""
    answers = json.loads((SHARED / "answers.json").read_text())
    cases = [Case(a["case"], a["true_parameters"], a["hidden_effects"]) for a in answers]
    manoeuvres = (*TRAIN, *TEST)
    data = np.array(
        [
            [
                np.loadtxt(SHARED / c.name / f"{m.name}.csv", delimiter=",", skiprows=1)
                for c in cases
            ]
            for m in manoeuvres
        ]
    )
    replayed = simulate(cases, manoeuvres, commands=data[..., 1:3])
    free = simulate(cases, manoeuvres)
    same = 0
    for rows, records, own in zip(data, replayed, free, strict=True):
        size = np.sqrt(np.mean(((rows[..., 3:] - records.clean) / NOISE) ** 2, axis=1))
        # A fin lag is integrated a little differently there, which shows as a tenth in pitch.
        assert size.max() < 1.15
        assert abs(size.mean() - 1.0) < 0.02
        # The last command acts on nothing.
        gap = np.abs(own.inputs - rows[..., 1:3])[:, :-1].max(axis=(1, 2))
        same += int(np.sum(gap < 1e-5))
    # A relay that sees the same pitch reverses at the same samples, but for ties in rounding.
    assert same > 0.9 * data.shape[0] * data.shape[1]


@pytest.mark.slow
def test_noise_is_what_was_asked_for_and_differs_between_records() -> None:
    """Size, colour and independence of sensor noise, over records and cases."""
    cases = [Case(f"{i}", PRIORS, noise=Noise(colour=0.5), seed=i) for i in range(6)]
    records = simulate(cases, TRAIN)
    noise = np.stack([r.outputs - r.clean for r in records]) / NOISE
    assert np.std(noise) == pytest.approx(1.0, abs=0.02)
    assert np.mean(noise[:, :, 1:] * noise[:, :, :-1]) == pytest.approx(0.5, abs=0.02)
    rows = noise.reshape(len(TRAIN) * len(cases), -1)
    between = np.corrcoef(rows) - np.eye(len(rows))
    assert np.abs(between).max() < 0.12


def test_cases_can_be_drawn_again() -> None:
    """A case follows from its name alone, and every effect has its turn."""
    draw = Draw("pair", "white", 17)
    assert case(draw) == case(draw)
    assert case(draw) != case(draw, attempt=1)
    hidden = {name for d in draws("single/white:40") for name in case(d).effects}
    assert len(hidden) == 40
    mixed = [draw.key for draw in draws("none/white:4 pair/white:2")]
    assert mixed[:3] == ["none/white/0", "pair/white/0", "none/white/1"]
    assert case(Draw("none", "gust_mid", 0)).noise == CONDITIONS["gust_mid"]
    with pytest.raises(ValueError, match="Unknown kind"):
        draws("single/green:3")


def entry(key: str, hidden: list[str], added: list[str], **changes: Any) -> dict[str, Any]:
    """A finished case of either benchmark."""
    *place, kind, condition, last = key.split("/")
    step = {"evidence": 30.0, "needed": 10.0, "test_gain": 5.0, "test_error": 1.0}
    return {
        "key": key,
        "vehicle": place[0] if place else "",
        "hidden": kind,
        "condition": condition,
        "declared": last == "declared",
        "effects": hidden,
        "detectable": True,
        "true_gains": dict.fromkeys(hidden, 25.0),
        "steps": [{"added": n, "equation": "M", "group": [n], **step} for n in added],
        "order": added,
        "rejected": [],
        "base_error": {"train": 3.0, "test": 3.0},
        "final_error": {"train": 1.0, "test": 1.0},
        "true_test_error": 1.0,
        "true_validation": 1.0,
        "found_validation": 1.1,
        "processor_seconds": 4.0,
        **changes,
    }


def test_measures_count_what_they_say() -> None:
    """Rates from cases whose outcome is known by construction."""
    entries = [
        entry("single/white/0", ["a"], ["a"]),
        entry("single/white/1", ["a"], ["b"]),
        entry("single/white/2", ["b"], [], detectable=False),
        entry("none/white/0", [], []),
        entry("none/white/1", [], ["a"]),
        entry("pair/white/0", ["a", "b"], ["b", "a"]),
        entry("unknown/white/0", ["unknown_cubic_pitch_damping"], ["term_M_qqq"]),
        entry("unknown/white/1", ["unknown_cubic_drag"], ["term_M_qqq"]),
        {"key": "single/white/3", "hidden": "single", "condition": "white", "error": "broken"},
    ]
    found = measures(entries)
    rates = {rate["name"]: rate for rate in found["rates"]}
    first = rates["single, detectable: right effect first"]
    assert (first["value"], first["count"]) == (0.5, 2)
    assert first["low"] < 0.5 < first["high"]
    assert rates["nothing hidden: false claims"]["value"] == 0.5
    assert rates["two, both detectable: both found"]["value"] == 1.0
    assert rates["unknown effect: only the right equation is changed"]["value"] == 0.5
    assert [failure["case"] for failure in found["failures"]] == ["single/white/1", "none/white/1"]
    assert found["broken"] == [{"case": "single/white/3", "error": "broken"}]
    assert "single/white/1" in as_markdown(found)


def test_cases_follow_from_their_names() -> None:
    """Drawn twice a case is the same; values are wrong by 10 to 30 per cent; logs are noisy."""
    draw = next(d for d in draws_vehicles(["coaster"], 20) if d.condition == "input_noise")
    first, second = draw_case(draw), draw_case(draw)
    np.testing.assert_array_equal(first.runs.outputs, second.runs.outputs)
    assert first.start == second.start
    wrong = [abs(first.start[k] / first.parameters[k] - 1) for k in first.start]
    assert min(wrong) >= 0.0999
    assert max(wrong) <= 0.3001
    channel = first.vehicle.inputs.index("rudder")
    error = (first.runs.logged - first.runs.commands)[:, :, channel]
    assert np.std(error) == pytest.approx(first.vehicle.logged[1], rel=0.1)
    assert draw_case(replace(draw, number=draw.number + 20)).start != first.start
    with pytest.raises(ValueError, match="Unknown vehicle"):
        draws_vehicles(["submarine"], 1)


def test_every_vehicle_has_enough_to_hide_and_to_confuse_it_with() -> None:
    """At least ten hidden effects, 15 to 40 candidates, each effect among them, each its turn."""
    for name, vehicle in VEHICLES.items():
        own = nominal(name)
        assert len(vehicle.hidden) >= 10
        assert 15 <= len(own.candidates) <= 40
        for effect, kind in vehicle.hidden.items():
            assert own.effect(effect).name == effect
            assert kind.lacking or len(own.values(effect, kind.sizes)) >= 1
        turns = {single_effect(d) for d in draws_vehicles([name], 40) if d.hidden == "single"}
        assert turns == set(vehicle.hidden)
    assert len(PATTERN) == 20


@pytest.mark.slow
def test_a_case_that_lacks_a_part_gets_it_as_a_candidate() -> None:
    """The nominal model is without the damping, the candidate starts absent, the truth has it."""
    draw = next(
        d
        for d in draws_vehicles(["motor"], 40)
        if d.hidden == "single" and single_effect(d) == "viscous_damping"
    )
    case = draw_case(draw)
    assert "viscous_damping" not in nominal_model(case).effect_names
    (candidate,) = [
        e for e in nominal("motor").effects(case.lacking) if e.name == "viscous_damping"
    ]
    assert candidate.parameters[0].value == 0.0
    assert true_model(case).values["b"] == pytest.approx(case.parameters["b"])
    assert case.gain("viscous_damping").train > 1000


def test_measures_on_other_vehicles_count_what_they_say() -> None:
    """Rates from cases whose outcome is known by construction."""
    entries = [
        entry("motor/0/none/white/declared", [], []),
        entry("motor/1/none/waves/declared", [], ["a"]),
        entry("motor/2/single/white/declared", ["a"], ["a"]),
        entry("motor/3/single/white/declared", ["a"], ["b", "a"]),
        entry("motor/4/single/white/declared", ["a"], ["c"], same_as={"a": ["c"]}),
        entry(
            "motor/5/single/white/declared",
            ["a"],
            ["b"],
            steps=[{"added": "b", "group": ["b"], "test_error": "inf"}],
        ),
        entry("motor/6/single/white/declared", ["a"], [], detectable=False),
        entry("motor/7/pair/white/declared", ["a", "b"], ["a"]),
    ]
    broken = entry("motor/8/single/waves/undeclared", ["a"], [], error="ValueError: no")
    for key in ("steps", "final_error", "base_error"):
        del broken[key]
    found = measures_vehicles([*entries, broken])
    rates = {rate["name"]: rate for rate in found["rates"]}
    assert rates["motor: right effect accepted"]["value"] == pytest.approx(3 / 5)
    assert rates["motor: right effect accepted"]["count"] == 5
    assert rates["motor: right effect first"]["value"] == pytest.approx(2 / 5)
    assert rates["all: no abort"]["value"] == pytest.approx(8 / 9)
    assert rates["all: nothing hidden: false claims"]["value"] == 0.5
    assert rates["waves, nothing hidden: false claims"]["value"] == 1.0
    assert rates["two hidden: both found"]["value"] == 0.0
    contradiction = rates["claim beside a validation error that rises"]
    assert contradiction["value"] == pytest.approx(1 / 9)
    faults = {row["case"].split("/")[1]: row["faults"][0] for row in found["failures"]}
    assert faults == {
        "1": "false claim",
        "3": "wrong effect first",
        "5": "wrong effect",
        "7": "one of two missed",
        "8": "aborted: ValueError: no",
    }
    assert "motor/5/single/white/declared" in as_markdown_vehicles(found)


def test_a_run_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Finished cases are not computed again, and a line cut short is computed once more."""
    asked: list[str] = []

    def judged(draw: Any, *, limit: float) -> dict[str, Any]:
        asked.append(draw.key)
        hidden = [] if draw.hidden == "none" else ["a"]
        return entry(draw.key, hidden, hidden)

    monkeypatch.setattr(runner, "judge", judged)
    store = tmp_path / "out.jsonl"
    quiet = {"say": lambda text: None}
    run_cases(Store(store), runner.cases(["motor"], cases=2), **quiet)
    lines = store.read_text().splitlines()
    store.write_text(lines[0] + "\n" + lines[1][:20])
    found = run_cases(Store(store), runner.cases(["motor"], cases=3), **quiet)
    assert len(asked) == 2 + 2
    assert len(found) == 3
    assert all(json.loads(line) for line in [lines[0]])


def test_an_improvement_that_takes_too_long_is_an_abort() -> None:
    """Processor time is limited, and the clock is stopped afterwards."""

    def for_ever() -> None:
        while True:
            sum(range(1000))

    with pytest.raises(TimeoutError, match=r"0\.2 s of processor time"), at_most(0.2):
        for_ever()
    with at_most(0.2):
        pass
    began = time.process_time()
    while time.process_time() - began < 0.3:
        sum(range(1000))


@pytest.mark.slow
def test_problem_of_the_times_has_its_size() -> None:
    """Twelve states, twenty-five free parameters and 36,030 samples."""
    model, train, _ = six_degrees_task()
    assert (len(model.state_names), len(model.free_names)) == (12, 25)
    assert sum(record.outputs.size for record in train) == 36030


RNG = np.random.default_rng(0)


def shortened(vehicle: Vehicle, samples: int, *, records: int = 1) -> Vehicle:
    """The same vehicle in shorter and fewer records."""
    return replace(
        vehicle,
        duration=samples * vehicle.sample,
        train=vehicle.train[:records],
        validation=vehicle.validation[: records - 1],
    )


def free_run(vehicle: Vehicle, start: dict[str, float], **zero: float) -> np.ndarray:
    """States ``(n_times, n_states)`` without commands, some parameters replaced."""
    run = Manoeuvre("free", start, {name: constant(0.0) for name in vehicle.inputs})
    found = simulate_vehicle(
        vehicle, {}, rng=RNG, parameters={**vehicle.parameters, **zero}, manoeuvres=[run]
    )
    return found.states[0, :, : len(vehicle.states)]


def gained(
    vehicle: Vehicle,
    runs: Any,
    hidden: dict[str, float],
    known: dict[str, float] | None = None,
    **disturbed: float,
) -> Any:
    """What hidden effects gain beside those that are known, at the true values."""
    structure = (vehicle.parameters, known or {})
    given = {"waves": 0.0, **disturbed}
    return gains(vehicle, runs, vehicle.parameters, hidden, structure, list(vehicle.free), **given)


def test_coaster_coasts_as_quadratic_drag_says() -> None:
    """Without thrust u = u0/(1 + k u0 t), and the way is ln(1 + k u0 t)/k."""
    found = free_run(coaster.COASTER, {"u": 5.0})
    times = coaster.COASTER.times
    slowing = -coaster.Q * coaster.COASTER.free["X_uu"] / coaster.SURGE
    growth = 1 + slowing * 5.0 * times
    np.testing.assert_allclose(found[:, 0], 5.0 / growth, rtol=1e-8)
    np.testing.assert_allclose(found[1:, 4], np.log(growth[1:]) / slowing, rtol=1e-7)


def test_catamaran_in_an_ideal_fluid_keeps_its_energy() -> None:
    """Coriolis and full Munk terms do no work."""
    none = dict.fromkeys(("X_u", "X_uu", "Y_v", "N_r", "k"), 0.0)
    found = free_run(
        shortened(catamaran.CATAMARAN, 160), {"u": 1.0, "v": 0.4, "r": 0.5}, munk=1.0, **none
    )
    along, across = catamaran.MASS - catamaran.X_UDOT, catamaran.MASS - catamaran.Y_VDOT
    masses = np.array([along, across, catamaran.INERTIA])
    energy = 0.5 * np.sum(masses * found[:, :3] ** 2, axis=1)
    assert np.ptp(found[:, 0]) > 0.5  # it does move
    np.testing.assert_allclose(energy, energy[0], rtol=1e-6)


def test_auv_in_an_ideal_fluid_keeps_energy_and_spins_its_momentum() -> None:
    """Kinetic and potential energy stay; so does linear momentum in earth axes."""
    none = dict.fromkeys(auv.AUV.free, 0.0) | {"zgW": 5.9}
    start = {"u": 1.0, "v": 0.2, "w": -0.3, "p": 0.4, "q": 0.2, "r": 0.3, "theta": 0.2}
    vehicle = replace(shortened(auv.AUV, 30), substep=0.05)
    found = free_run(vehicle, start, **none)
    along, across = auv.MASS - auv.X_UDOT, auv.MASS - auv.Y_VDOT
    rolling, pitching = auv.I_X - auv.K_PDOT, auv.I_Y - auv.M_QDOT
    masses = np.array([along, across, across, rolling, pitching, pitching])
    phi, theta, psi = found[:, 6:9].T
    energy = 0.5 * np.sum(masses * found[:, :6] ** 2, axis=1)
    energy = energy + 5.9 * (1 - np.cos(theta) * np.cos(phi))
    np.testing.assert_allclose(energy, energy[0], rtol=1e-6)
    own = masses[:3] * found[:, :3]
    cos, sin = np.cos, np.sin
    down = -own[:, 0] * sin(theta) + cos(theta) * (own[:, 1] * sin(phi) + own[:, 2] * cos(phi))
    level = own[:, 1] * cos(phi) - own[:, 2] * sin(phi)
    ahead = own[:, 0] * cos(theta) + sin(theta) * (own[:, 1] * sin(phi) + own[:, 2] * cos(phi))
    north, east = ahead * cos(psi) - level * sin(psi), ahead * sin(psi) + level * cos(psi)
    for momentum in (north, east, down):
        np.testing.assert_allclose(momentum, momentum[0], atol=1e-5)


def test_dry_friction_takes_its_work_and_holds_at_rest() -> None:
    """A swing that starts at rest turns where gravity's work is that of friction, and sticks."""
    vehicle = replace(VEHICLES["motor"], substep=0.001, duration=6.0)
    run = Manoeuvre("swing", {"theta": 1.0}, {"V": constant(0.0)})
    dry = 1.5
    found = simulate_vehicle(
        vehicle,
        {"coulomb": dry},
        rng=RNG,
        parameters={**vehicle.parameters, "b": 0.0},
        manoeuvres=[run],
    )
    theta, omega = found.states[0, :, :2].T
    first = int(np.argmax(omega > 0))  # one sample after the first turn
    turn = np.min(theta[: first + 2])
    # c (cos theta_1 - cos theta_0) = dry (theta_0 - theta_1), solved for theta_1 below zero.
    lost = lambda angle: 10.0 * (math.cos(angle) - math.cos(1.0)) - dry * (1.0 - angle)  # noqa: E731
    low, high = -1.0, -0.5
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if lost(middle) < 0 else (low, middle)
    assert turn == pytest.approx(low, abs=0.01)  # sampled every 0.05 s
    assert omega[-1] == 0.0
    assert abs(10.0 * math.sin(theta[-1])) <= dry


@pytest.mark.parametrize("name", ["coaster", "auv", "motor"])
def test_fixed_steps_agree_with_error_control(name: str) -> None:
    """One record again with SciPy's eighth-order method and tight tolerances."""
    vehicle = shortened(VEHICLES[name], 40)
    found = simulate_vehicle(vehicle, {}, rng=RNG)
    plant = Plant(vehicle, vehicle.parameters, {})
    n = len(vehicle.states)
    state = found.states[0, 0, :n]
    for k in range(40):
        acting = found.commands[0, k][:, None]

        def rate(_: float, x: np.ndarray, acting: np.ndarray = acting) -> np.ndarray:
            still = np.zeros((len(vehicle.forces), 1))
            return vehicle.rate(x[:, None], acting, vehicle.parameters, {}, still)[:, 0]

        state = solve_ivp(
            rate, (0, vehicle.sample), state, method="DOP853", rtol=1e-10, atol=1e-12
        ).y[:, -1]
    assert plant.measure(found.states[0, -1][:, None]).shape == (len(vehicle.outputs), 1)
    np.testing.assert_allclose(found.states[0, -1, :n], state, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", list(VEHICLES))
def test_nominal_model_at_true_values_is_the_vehicle(name: str) -> None:
    """Without anything hidden the package's model gives the simulator's outputs to 1e-6."""
    vehicle = shortened(VEHICLES[name], 100, records=2)
    vehicle = replace(vehicle, substep=vehicle.substep / 2)
    model = nominal(name).model(True, None)
    known = {k: v for k, v in vehicle.parameters.items() if k in model.parameter_names}
    model = replace(model.with_values(known), step=model.step / 4)
    found = simulate_vehicle(vehicle, {}, rng=RNG)
    assert [output.noise_std for output in model.outputs] == list(vehicle.noise.values())
    for record in range(len(found.names)):
        start = dict(zip(vehicle.states, found.states[record, 0], strict=False))
        again = simulate_inputs(
            model, found.times, inputs=found.commands[record], initial=start
        ).outputs
        size = np.max(np.abs(found.clean[record]), axis=0)
        assert np.max(np.abs(again - found.clean[record]) / size) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", list(VEHICLES))
def test_candidates_are_the_hidden_effects(name: str) -> None:
    """Every hidden effect at its true size leaves at most three per cent of what it does.

    But for dry friction, which the candidate smooths: it creeps where the motor sticks.
    """
    vehicle = replace(VEHICLES[name], train=VEHICLES[name].train[1:2], validation=())
    own, noise = nominal(name), np.array(list(vehicle.noise.values()))
    bare = own.model(True, None)
    bare = bare.with_values(
        {k: v for k, v in vehicle.parameters.items() if k in bare.parameter_names}
    )
    for effect, kind in vehicle.hidden.items():
        if kind.lacking:
            continue
        sizes = {k: 0.5 * (kind.sign or 1) * v for k, v in kind.sizes.items()}
        found = simulate_vehicle(
            vehicle, {k: np.array([v]) if kind.per_record else v for k, v in sizes.items()}, rng=RNG
        )
        model = bare + own.effect(effect)
        model = model.with_values(own.values(effect, sizes))
        start = dict(zip(vehicle.states, found.states[0, 0], strict=False))
        left, whole = (
            np.linalg.norm(
                (
                    simulate_inputs(m, found.times, inputs=found.commands[0], initial=start).outputs
                    - found.clean[0]
                )
                / noise
            )
            for m in (model, bare)
        )
        assert left < (0.05 if effect == "coulomb_friction" else 0.03) * whole, (
            effect,
            left / whole,
        )


@pytest.mark.slow
def test_expected_gain_is_what_least_squares_finds() -> None:
    """Noise-free record of a weak effect: the sum of squares that a nominal fit leaves."""
    vehicle = shortened(VEHICLES["motor"], 60)
    hidden = {"quadratic": -0.04}
    runs = simulate_vehicle(vehicle, hidden, rng=RNG)
    expected = gained(vehicle, runs, hidden)
    noise = np.array(list(vehicle.noise.values()))

    def residuals(unknown: np.ndarray) -> np.ndarray:
        start = dict(zip(vehicle.states, unknown[3:], strict=True))
        again = simulate_vehicle(
            vehicle,
            {},
            rng=np.random.default_rng(0),
            parameters=dict(zip(vehicle.free, unknown[:3], strict=True)),
            manoeuvres=[replace(vehicle.train[0], start=start)],
        )
        return ((again.clean[0] - runs.clean[0]) / noise).ravel()

    begin = np.array([*vehicle.free.values(), *runs.states[0, 0, :2]])
    best = least_squares(residuals, begin, x_scale=np.array([1.0, 1.0, 5.0, 0.1, 0.1]))
    assert expected.train == pytest.approx(2 * best.cost, rel=0.05)
    assert best.cost > 0.1


def test_disturbances_hide_what_white_noise_shows() -> None:
    """The same effect gains less where the likelihood has to allow for forces or input noise."""
    vehicle = shortened(VEHICLES["motor"], 100)
    hidden = {"torque": 0.1}
    runs = simulate_vehicle(vehicle, hidden, rng=RNG)
    calm, rough, noisy = (
        gained(vehicle, runs, hidden, waves=waves, input_noise=noise).train
        for waves, noise in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    )
    assert 0 < rough < 0.5 * calm
    assert 0 < noisy < 0.9 * calm


def test_an_effect_gains_as_much_beside_one_that_lags() -> None:
    """A lag that is in both structures takes little from another effect's gain."""
    vehicle = shortened(VEHICLES["motor"], 100)
    found = []
    for lag in ({}, {"lag:V": 0.1, "sensor_lag:omega": 0.02}):
        hidden = {"quadratic": -0.1, **lag}
        runs = simulate_vehicle(vehicle, hidden, rng=RNG)
        found.append(gained(vehicle, runs, hidden, lag).train)
    assert found[1] == pytest.approx(found[0], rel=0.3)


def test_forces_have_their_level_and_time() -> None:
    """Unit variance, and a correlation of exp(-1/5) from sample to sample."""
    drawn = gauss_markov(
        np.random.default_rng(1).standard_normal((3000, 100, 1)), math.exp(-0.2), axis=1
    )
    assert np.var(drawn) == pytest.approx(1.0, abs=0.03)
    assert np.mean(drawn[:, 1:] * drawn[:, :-1]) == pytest.approx(math.exp(-0.2), abs=0.03)


def test_multisine_has_the_size_that_was_asked_for() -> None:
    """Each sine of the stated amplitude about the base: its mean square is half a square."""
    pilot = multisine(0.3, (10.0, 5.0), seed=1, base=2.0)()
    values = np.array([pilot(t, np.empty(0)) for t in np.arange(0, 10, 0.01)])
    assert np.mean(values) == pytest.approx(2.0, abs=1e-3)
    assert np.var(values) == pytest.approx(0.3**2, rel=1e-3)
