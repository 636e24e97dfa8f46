"""Guesses of unmeasured states against the states they should find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from vehicles import DIVING_START, SHIP_START, remus, ship

from oed_sysid.data.dataset import Record
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.start_guess import kinematic_states, measured_states, slope
from oed_sysid.physics.model import Model


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
def test_slope_is_about_as_good_as_it_says(noise: float) -> None:
    """The derivative of a noisy sine is found within a few of its stated errors."""
    times = np.arange(0, 30, 0.1)
    series = np.sin(times) + noise * np.random.default_rng(0).standard_normal(len(times))
    found, error = slope(times, series)
    actual = np.sqrt(np.mean((found - np.cos(times))[10:-10] ** 2))
    assert actual < 3 * error + 1e-3
    assert actual < max(0.5 * noise / 0.1, 0.02)


def only(model: Model, names: tuple[str, ...]) -> Model:
    """The model with only some outputs measured."""
    return replace(model, outputs=tuple(o for o in model.outputs if o.name in names))


@pytest.mark.parametrize(
    ("keep", "found"), [(("u", "theta", "z"), ("q", "w")), (("u", "w", "theta"), ("q",))]
)
def test_diving_plane(keep: tuple[str, ...], found: tuple[str, ...]) -> None:
    """Pitch rate comes from pitch, heave velocity from depth, u and pitch."""
    model = remus()
    times = np.arange(0, 60, 0.1)
    fin = 0.1 * np.sign(np.sin(0.5 * times))
    run = simulate_inputs(
        model, times, inputs={"fin_command": fin, "thrust": 9.0}, initial=DIVING_START
    )
    part = only(model, keep)
    rng = np.random.default_rng(1)
    outputs = np.column_stack([run.signal(name) for name in part.output_names])
    outputs += 0.003 * rng.standard_normal(outputs.shape)
    record = Record("dive", times, run.inputs, outputs, part.channels)
    guesses = kinematic_states(part, record, measured_states(part, record))
    assert {part.state_names[i] for i in guesses} == set(found)
    for position, guess in guesses.items():
        truth = run.signal(part.state_names[position])
        error = np.sqrt(np.mean((guess.series - truth) ** 2))
        assert error < 0.35 * np.std(truth)
        assert error < 5 * guess.std


def test_velocities_of_a_ship_from_positions() -> None:
    """With heading and position measured, u, v and r follow from the kinematics."""
    model = ship()
    times = np.arange(0, 600, 2.0)
    rudder = 0.2 * np.sign(np.sin(2 * np.pi * times / 200))
    run = simulate_inputs(
        model, times, inputs={"rudder_command": rudder, "thrust": 7e5}, initial=SHIP_START
    )
    part = only(model, ("psi", "x", "y"))
    outputs = np.column_stack([run.signal(name) for name in part.output_names])
    record = Record("turn", times, run.inputs, outputs, part.channels)
    guesses = kinematic_states(part, record, measured_states(part, record))
    assert {part.state_names[i] for i in guesses} == {"u", "v", "r"}
    for position, guess in guesses.items():
        truth = run.signal(part.state_names[position])
        error = np.sqrt(np.mean((guess.series - truth) ** 2))
        assert error < 0.2 * np.abs(truth).max()


def test_nothing_is_guessed_from_unknown_parameters() -> None:
    """An equation that holds a free parameter is not used."""
    model = only(remus(), ("q",))
    times = np.arange(0, 20, 0.1)
    record = Record("r", times, np.zeros((200, 2)), np.sin(times)[:, None], model.channels)
    guesses = kinematic_states(model, record, measured_states(model, record))
    assert guesses == {}
