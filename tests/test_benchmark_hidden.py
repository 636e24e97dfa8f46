"""Benchmarks of hidden effects: their simulators are true, and what is counted is right."""

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

from benchmarks import rates
from benchmarks.missing_physics import simulator
from benchmarks.missing_physics.cases import CONDITIONS, draws
from benchmarks.missing_physics.simulator import PRIORS, TEST, TRAIN, Case, simulate
from benchmarks.other_vehicles.cases import draws as draws_vehicles
from benchmarks.other_vehicles.cases import single_effect
from benchmarks.other_vehicles.models import nominal
from benchmarks.other_vehicles.truth import VEHICLES, auv, catamaran, coaster
from benchmarks.other_vehicles.truth.detect import gains
from benchmarks.other_vehicles.truth.simulator import Manoeuvre, Plant, Vehicle, constant
from benchmarks.other_vehicles.truth.simulator import simulate as simulate_vehicle
from benchmarks.truth import NOISE
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
                for m in manoeuvres
            ]
            for c in cases
        ]
    )
    replayed = simulate(cases, manoeuvres, commands=data[..., 1:3])
    free = simulate(cases, manoeuvres)
    clean = np.array([[record.clean for record in own] for own in replayed])
    own = np.array([[record.inputs for record in own] for own in free])
    size = np.sqrt(np.mean(((data[..., 3:] - clean) / NOISE) ** 2, axis=2))
    # A fin lag is integrated a little differently there, which shows as a tenth in pitch.
    assert size.max() < 1.15
    assert np.abs(size.mean(axis=(0, 2)) - 1.0).max() < 0.02
    # The last command acts on nothing. A relay that sees the same pitch reverses at the same
    # samples, but for ties in rounding.
    gap = np.abs(own - data[..., 1:3])[:, :, :-1].max(axis=(2, 3))
    assert np.mean(gap < 1e-5) > 0.9


def test_cases_are_what_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Size and colour of noise, every effect in its turn; an unknown kind is refused."""
    cases = [Case(f"{i}", PRIORS, noise=CONDITIONS["colour5"], seed=i) for i in range(18)]
    monkeypatch.setattr(simulator, "DURATION", 20.0)
    noise = np.array(
        [[(r.outputs - r.clean) / NOISE for r in own] for own in simulate(cases, TRAIN)]
    )
    assert np.std(noise) == pytest.approx(1.0, abs=0.02)
    assert np.mean(noise[:, :, 1:] * noise[:, :, :-1]) == pytest.approx(0.5, abs=0.02)
    mixed = [draw.key for draw in draws("none/white:4 pair/white:2")]
    assert mixed[:3] == ["none/white/0", "pair/white/0", "none/white/1"]
    for name, vehicle in VEHICLES.items():
        turns = {single_effect(d) for d in draws_vehicles([name], 40) if d.hidden == "single"}
        assert turns == set(vehicle.hidden)
    with pytest.raises(ValueError, match="Unknown kind"):
        draws("single/green:3")
    with pytest.raises(ValueError, match="Unknown vehicle"):
        draws_vehicles(["submarine"], 1)


def entry(key: str, hidden: list[str], added: list[str], **changes: Any) -> dict[str, Any]:
    """A finished case."""
    vehicle, kind, condition, _ = key.split("/")
    step = {"equation": "M", "test_error": 1.0}
    return {
        "key": key,
        "vehicle": vehicle,
        "hidden": kind,
        "condition": condition,
        "effects": hidden,
        "detectable": True,
        "steps": [{"added": n, "group": [n], **step} for n in added],
        "base_error": {"train": 3.0, "test": 3.0},
        "true_validation": 1.0,
        "found_validation": 1.1,
        "processor_seconds": 4.0,
        **changes,
    }


def test_measures_count_what_they_say() -> None:
    """Rates from cases whose outcome is known by construction."""
    rising = [{"added": "b", "group": ["b"], "test_error": "inf"}]
    entries = [
        entry("motor/none/white/0", [], []),
        entry("motor/none/waves/1", [], ["a"]),
        entry("motor/single/white/2", ["a"], ["a"]),
        entry("motor/single/white/3", ["a"], ["b", "a"]),
        entry("motor/single/white/4", ["a"], ["c"], same_as={"a": ["c"]}),
        entry("motor/single/white/5", ["a"], ["b"], steps=rising),
        entry("motor/single/white/6", ["a"], [], detectable=False),
        entry("motor/pair/white/7", ["a", "b"], ["a"]),
        entry("auv/unknown/white/8", ["cubic"], ["term"], axis="M", found_validation=1.04),
        entry("auv/unknown/white/9", ["drag"], ["term"], axis="X"),
    ]
    broken = entry("motor/single/waves/10", ["a"], [], error="ValueError: no")
    for key in ("steps", "base_error", "found_validation"):
        del broken[key]
    found = rates.measures([*entries, broken])
    value = {rate["name"]: rate["value"] for rate in found["rates"]}
    assert value["motor: right effect accepted"] == pytest.approx(3 / 5)
    assert value["motor: right effect accepted and nothing else"] == pytest.approx(2 / 5)
    assert value["motor: right effect first"] == pytest.approx(2 / 5)
    assert value["white: right effect first"] == pytest.approx(1 / 2)
    assert value["all: nothing hidden: false claims"] == 0.5
    assert value["waves: nothing hidden: false claims"] == 1.0
    assert value["no abort"] == pytest.approx(10 / 11)
    assert value["two hidden: both accepted"] == 0.0
    assert value["two hidden: one of them first"] == 1.0
    assert value["unknown effect: validation error <= 1.05 x true term's"] == 0.5
    assert value["unknown effect: only the right equation is changed"] == 0.5
    assert value["claim beside a validation error that rises"] == pytest.approx(1 / 11)
    faults = {row["case"].split("/")[-1]: row["fault"][0] for row in found["failures"]}
    assert faults == {
        "1": "false claim",
        "3": "wrong effect first",
        "5": "wrong effect",
        "7": "one of two missed",
        "9": "worse than the true term",
        "10": "aborted: ValueError: no",
    }
    (of_motor,) = found["by_effect"]
    assert (of_motor["cases"], of_motor["detectable"], of_motor["first"]) == (6, 5, 2)
    assert of_motor["otherwise"] == ["an abort", "b"]
    assert "| motor/single/white/5 |" in rates.table(found)


def test_an_improvement_that_takes_too_long_is_an_abort() -> None:
    """Processor time is limited, and the clock is stopped afterwards."""

    def for_ever() -> None:
        while True:
            sum(range(1000))

    with pytest.raises(TimeoutError, match=r"0\.2 s of processor time"), rates.at_most(0.2):
        for_ever()
    with rates.at_most(0.2):
        pass
    began = time.process_time()
    while time.process_time() - began < 0.3:
        sum(range(1000))


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
    vehicle = replace(shortened(auv.AUV, 30), substep=0.01)
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


@pytest.mark.parametrize("name", list(VEHICLES))
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
