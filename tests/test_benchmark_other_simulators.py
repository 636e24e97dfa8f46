"""Vehicles that nobody tuned for: their simulators, nominal models and expected gains."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from benchmarks.other_vehicles.judge import nominal
from benchmarks.other_vehicles.truth import VEHICLES, auv, catamaran, coaster
from benchmarks.other_vehicles.truth.detect import gains
from benchmarks.other_vehicles.truth.simulator import (
    Manoeuvre,
    Plant,
    Vehicle,
    constant,
    multisine,
    simulate,
)
from benchmarks.truth import gauss_markov
from oed_sysid.experiments.simulation import simulate_inputs

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
    found = simulate(
        vehicle, {}, rng=RNG, parameters={**vehicle.parameters, **zero}, manoeuvres=[run]
    )
    return found.states[0, :, : len(vehicle.states)]


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
    masses = np.array(
        [
            catamaran.MASS - catamaran.X_UDOT,
            catamaran.MASS - catamaran.Y_VDOT,
            catamaran.INERTIA,
        ]
    )
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
    masses = np.array(
        [
            along,
            across,
            across,
            auv.I_X - auv.K_PDOT,
            auv.I_Y - auv.M_QDOT,
            auv.I_Y - auv.M_QDOT,
        ]
    )
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
    found = simulate(
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
    found = simulate(vehicle, {}, rng=RNG)
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
    found = simulate(vehicle, {}, rng=RNG)
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
        found = simulate(
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


def test_expected_gain_is_what_least_squares_finds() -> None:
    """Noise-free record of a weak effect: the sum of squares that a nominal fit leaves."""
    vehicle = shortened(VEHICLES["motor"], 60)
    hidden = {"quadratic": -0.04}
    runs = simulate(vehicle, hidden, rng=RNG)
    expected = gains(
        vehicle,
        runs,
        vehicle.parameters,
        hidden,
        (vehicle.parameters, {}),
        list(vehicle.free),
        waves=0.0,
    )
    noise = np.array(list(vehicle.noise.values()))

    def residuals(unknown: np.ndarray) -> np.ndarray:
        start = dict(zip(vehicle.states, unknown[3:], strict=True))
        again = simulate(
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
    runs = simulate(vehicle, hidden, rng=RNG)
    calm, rough, noisy = (
        gains(
            vehicle,
            runs,
            vehicle.parameters,
            hidden,
            (vehicle.parameters, {}),
            list(vehicle.free),
            waves=waves,
            input_noise=noise,
        ).train
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
        runs = simulate(vehicle, hidden, rng=RNG)
        structure = (vehicle.parameters, lag)
        names = list(vehicle.free)
        found.append(
            gains(vehicle, runs, vehicle.parameters, hidden, structure, names, waves=0.0).train
        )
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
