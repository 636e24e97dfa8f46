"""Forces, flow and inertia: directions, signs and limits."""

from __future__ import annotations

import numpy as np
import pytest
from vehicles import remus, ship

from oed_sysid import physics as effects
from oed_sysid.compiled.kernels import Kernel
from oed_sysid.errors import ModelError
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.text import expressions


def evaluate(effect: Effect, key: str, **scope: float) -> float:
    """Value of one term of an effect at its present parameters."""
    values = {p.name: p.value for p in effect.parameters} | scope
    for name, text in effect.definitions.items():
        values[name] = float(expressions.to_numpy(text, values, effect.tables))
    return float(expressions.to_numpy(effect.terms[key], values, effect.tables))


def accelerations(model: Model, own: list[float], command: list[float]) -> np.ndarray:
    """Rates of the model's states by a tiny step."""
    kernel, h = Kernel(model, compiled=False), 1e-6
    z, _ = kernel.start(np.array(own), np.array(command), model.value_vector, 0.0)
    times, inputs = np.array([0.0, h]), np.tile(command, (2, 1))
    run = kernel.run(times, inputs, model.value_vector, z)
    return (run.ends[0] - z)[: kernel.n_own] / h


def test_drag_opposes_motion_and_is_odd() -> None:
    """Quadratic drag with a negative coefficient opposes either direction."""
    drag = effects.quadratic_drag("drag", "Z", "w_r", value=-100.0)
    assert evaluate(drag, "Z", w_r=0.2) == pytest.approx(-4.0)
    assert evaluate(drag, "Z", w_r=-0.2) == pytest.approx(4.0)
    assert drag.parameters[0].unit == "kg/m"


@pytest.mark.parametrize(
    ("effect", "unit"),
    [
        (effects.linear_damping("e", "X", "u_r"), "kg/s"),
        (effects.quadratic_drag("e", "M", "q"), "kg m^2"),
        (effects.crossed_drag("e", "N", "v_r", "r"), "kg m"),
        (effects.induced_drag("e", "w_r"), "kg/m"),
        (effects.deflection_drag("e", "ds"), "kg/m"),
        (effects.cubic_restoring("e"), "N m"),
        (effects.fluid_memory("e", "Z", "w"), "kg/s"),
        (effects.added_mass_error("e", "M", "q"), "kg m^2"),
    ],
)
def test_units_follow_from_names(effect: Effect, unit: str) -> None:
    """The unit of an amplitude is derived, never typed."""
    assert effect.parameters[0].unit == unit


def test_heavy_vehicle_sinks() -> None:
    """More weight than buoyancy accelerates downwards, along earth's vertical."""
    level = remus()
    heavy = level + effects.excess_buoyancy(value=2.0)
    still = [0.0, 0.0, 0.0, 0.0, 10.0]
    change = accelerations(heavy, still, [0.0, 0.0]) - accelerations(level, still, [0.0, 0.0])
    assert change[1] > 0
    assert evaluate(effects.excess_buoyancy(value=2.0), "X", theta=np.pi / 2) == pytest.approx(-2.0)


@pytest.mark.parametrize("theta", [0.0, 0.3, -1.0])
def test_drifting_with_the_current_is_rest(theta: float) -> None:
    """A vehicle that moves with the water has no velocity through it."""
    ahead, down = effects.current_forward(value=0.4), effects.current_down(value=0.1)
    u = 0.4 * np.cos(theta) - 0.1 * np.sin(theta)
    w = 0.4 * np.sin(theta) + 0.1 * np.cos(theta)
    for key, over_ground in (("u_r", u), ("w_r", w)):
        once = evaluate(ahead, key, **{key: over_ground}, theta=theta)
        assert evaluate(down, key, **{key: once}, theta=theta) == pytest.approx(0.0, abs=1e-15)


def test_current_in_the_horizontal_plane_is_earth_fixed() -> None:
    """Heading east, a current towards the east comes from astern."""
    current = effects.current_horizontal_plane(north=0.2, east=0.5)
    assert evaluate(current, "u_r", u_r=5.0, psi=np.pi / 2) == pytest.approx(4.5)
    assert evaluate(current, "v_r", v_r=0.0, psi=np.pi / 2) == pytest.approx(0.2)


def test_wind_from_astern_pushes() -> None:
    """Wind that blows where the ship is heading pushes it; from port, to starboard."""
    angles = np.linspace(-np.pi, np.pi, 721)
    tables = {"X": (angles, np.cos(angles)), "Y": (angles, np.sin(angles))}
    wind = effects.wind_load(
        "wind", tables, speed=10.0, direction=0.0, area=500.0, length=100.0, value=1.0
    )
    pressure = 0.5 * 1.225 * 500.0 * 100.0
    assert evaluate(wind, "X", u=0.0, v=0.0, psi=0.0) == pytest.approx(pressure, rel=1e-4)
    starboard = -np.pi / 2  # heading west, a wind towards north comes from port
    assert evaluate(wind, "Y", u=0.0, v=0.0, psi=starboard) == pytest.approx(pressure, rel=1e-4)


def test_memory_fades_in_steady_motion() -> None:
    """Fluid memory starts without force and adds none to steady motion."""
    memory = effects.fluid_memory("memory", "Z", "w", value=-15.0)
    assert memory.states[0].initial == "w"
    assert evaluate(memory, "Z", w=0.1, mu_memory=0.1) == 0.0


def test_added_mass_slows_the_response() -> None:
    """Doubling the inertia of sway halves its acceleration."""
    own, command = [7.0, 0.5, 0.0, 0.0, 0.0, 0.0], [0.0, 7e5]
    model = ship()
    double = model + effects.added_mass_factor("loading", {("Y", "v"): "m_y"}, scale=1, value=0.9)
    ratio = accelerations(double, own, command)[1] / accelerations(model, own, command)[1]
    assert ratio == pytest.approx(1 / 1.9, rel=1e-6)


def test_hull_derivatives_fill_in_units_and_refuse_added_mass() -> None:
    """Hull terms come from names; accelerations belong to the inertia."""
    hull = effects.hull_derivatives("hull", [Parameter("Z_absww", -100.0)])
    assert hull.parameters[0].unit == "kg/m"
    with pytest.raises(ModelError, match="inertia"):
        effects.hull_derivatives("hull", [Parameter("Z_wdot", -30.0)])


def test_righting_arm_is_interpolated() -> None:
    """A tabulated righting arm is linear between its points."""
    arm = effects.righting_arm_table("gz", [-1.0, 0.0, 1.0], [-0.5, 0.0, 0.5], value=10.0)
    assert evaluate(arm, "K", phi=0.4) == pytest.approx(-2.0)


def test_wave_has_two_amplitudes_and_a_bounded_frequency() -> None:
    """Phase and size are amplitudes; the frequency is a shape within its bounds."""
    wave = effects.wave_force("wave", "Z", frequency=1.0, spread=0.4)
    assert wave.amplitude_names == ("E_wave_cos", "E_wave_sin")
    assert wave.shape_names == ("omega_wave",)
    assert (wave.parameters[2].lower, wave.parameters[2].upper) == pytest.approx((0.6, 1.4))
