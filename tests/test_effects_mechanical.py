"""Friction, play, cogging, hysteresis and delay, and tables from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oed_sysid import Force, Input, Model, Output, Parameter, State
from oed_sysid.compiled.kernels import kernel
from oed_sysid.errors import DataError
from oed_sysid.physics import (
    bouc_wen_hysteresis,
    coulomb_friction,
    dahl_friction,
    delayed_force,
    mechanical_effects,
    steady_wind,
    table_from_csv,
)
from oed_sysid.testing import check_effect


def pendulum(*effects) -> Model:
    """A driven pendulum of unit inertia."""
    return Model(
        "pendulum",
        (State("phi", "rad"), State("p", "rad/s")),
        (Input("torque", "N m", interpolation="linear"),),
        (Output("phi", "rad"), Output("p", "rad/s")),
        {"phi": "p"},
        axes={"K": "p"},
        inertia={("K", "p"): "J"},
        effects=(Force("drive", {"K": "torque - k*phi"}), *effects),
        parameters=(
            Parameter("J", 1.0, "kg m^2", fixed=True),
            Parameter("k", 2.0, "N m/rad", fixed=True),
        ),
        step=0.01,
    )


CANDIDATES = (
    *mechanical_effects(force=1.0, stiffness=2.0),
    bouc_wen_hysteresis("hysteresis", "K", "p", yielding=0.1, unit="N m", displacement_unit="rad"),
    delayed_force("late", "K", "phi", unit="N m/rad", start="phi", delay=0.3),
)


@pytest.mark.parametrize("effect", CANDIDATES, ids=lambda effect: effect.name)
def test_contract(effect: Force) -> None:
    """Every mechanical effect is absent at zero and has exact derivatives."""
    check_effect(
        effect,
        pendulum(),
        rng=np.random.default_rng(1),
        initial={"phi": 0.4, "p": 0.3},
        n_points=1,
        mirror=() if effect.name == "cogging" else ("phi", "p", "torque"),
    )


def states(
    model: Model, torque, end: float = 6.0, phi: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times and states from an angle at rest."""
    times = np.arange(0.0, end, 0.01)
    inputs = torque(times)[:, None]
    z, _ = kernel(model).start(np.array([phi, 0.0]), inputs[0], model.value_vector, 0.0)
    return times, kernel(model).run(times, inputs, model.value_vector, z).states


def test_dry_friction_takes_the_same_from_every_swing() -> None:
    """The amplitude of a free swing falls by 2 F/k at each half turn, as Coulomb's law says."""
    friction = coulomb_friction("dry", "K", "p", unit="N m", value=0.1, smooth=0.001)
    _, found = states(pendulum(friction), lambda t: 0 * t, phi=1.0, end=8.0)
    phi, p = found[:, 0], found[:, 1]
    turning = [phi[i] for i in range(2, len(p)) if p[i - 1] * p[i] < 0]
    expected = [-0.9, 0.8, -0.7]
    np.testing.assert_allclose(turning[:3], expected, atol=2e-3)
    _, held = states(pendulum(friction), lambda t: 0.08 * np.minimum(t, 1.0))
    assert np.abs(held[:, 0]).max() < 0.01


def test_dahl_friction_runs_around_a_loop() -> None:
    """Force against displacement encloses the area of friction, as the rule says exactly."""
    effect = dahl_friction(
        "dahl", "K", "p", stiffness=20.0, unit="N m", displacement_unit="rad", value=0.4
    )
    _, found = states(pendulum(effect), lambda t: np.sin(2 * t))
    phi, p, z = found[:, 0], found[:, 1], found[:, 2]
    assert np.abs(z).max() <= 1.0
    # dz/dphi = sigma (1 - sign(p) z): the exponential approach on the first stroke.
    first = int(np.argmax(p[1:] < 0))
    np.testing.assert_allclose(z[:first], 1 - np.exp(-20 * phi[:first]), atol=2e-4)


def test_delayed_force_is_late() -> None:
    """A force of the angle 0.2 s ago equals that of the shifted sine, within 1 per cent."""
    effect = delayed_force("late", "K", "phi", unit="N m/rad", start="phi", delay=0.2, value=0.01)
    model = pendulum(effect)
    times, found = states(model, lambda t: np.sin(3 * t), end=12.0)
    low, high, phi = found[:, 2], found[:, 3], found[:, 0]
    second = 12 * (phi - low) - 6 * high
    late = low - high / 2 + second / 12
    expected = np.interp(times - 0.2, times, phi)
    scale = np.abs(phi).max()
    assert np.abs(late - expected)[100:].max() < 0.01 * scale
    assert np.abs(phi - expected)[100:].max() > 0.3 * scale


def test_bouc_wen_against_scipy() -> None:
    """The hysteretic state follows its rule, integrated independently."""
    effect = bouc_wen_hysteresis(
        "h", "K", "p", yielding=0.1, unit="N m", displacement_unit="rad", value=0.6
    )
    times, found = states(pendulum(effect), lambda t: np.sin(2 * t))

    def rates(t: float, x: np.ndarray) -> list[float]:
        v, z = x[1], x[2]
        rate = (v - 0.5 * (abs(v) * abs(z) * z + v * z * z)) / 0.1
        return [v, np.sin(2 * t) - 2 * x[0] - 0.6 * z, rate]

    exact = solve_ivp(rates, (0, times[-1]), np.zeros(3), t_eval=times, rtol=1e-9, atol=1e-11).y.T
    # The command is linear between samples here: 1e-4 of difference.
    np.testing.assert_allclose(found, exact, atol=2e-4)


def test_steady_wind_turns_with_the_heading() -> None:
    """Wind towards north pushes a ship that heads east to port, by the same force."""
    wind = steady_wind()
    assert set(wind.terms) == {"X", "Y", "N"}
    from oed_sysid.text.expressions import to_numpy

    scope = {"E_wind_north": 3.0, "E_wind_east": 0.0, "arm_wind": 2.0, "psi": np.pi / 2}
    forces = [float(to_numpy(wind.terms[axis], scope)) for axis in ("X", "Y", "N")]
    assert forces == pytest.approx([0.0, -3.0, -6.0], abs=1e-12)


def test_table_of_two_arguments_from_a_file(tmp_path: Path) -> None:
    """Rows in any order become a grid in SI units."""
    file = tmp_path / "kt.csv"
    rows = ["10,2,5", "0,2,3", "0,1,1", "10,1,2"]
    file.write_text("beta [deg],V [m/s],K [kN]\n" + "\n".join(rows) + "\n")
    x, y, values = table_from_csv(file)
    np.testing.assert_allclose(x, np.radians([0, 10]))
    np.testing.assert_allclose(values, 1000 * np.array([[1, 3], [2, 5]]))
    assert y.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("x [m],y [m],z [m]\n0,0,1\n0,1,2\n1,0,3\n", "0 rows for the point"),
        ("x [m],z\n0,1\n1,2\n", "has no unit"),
        ("x [m],z [m]\n0,1\n1,\n", "row 3"),
        ("x [m],z [m]\n0,1\n0,2\n", "does not increase"),
        ("x [m]\n0\n1\n", "expected two"),
    ],
)
def test_wrong_table_files_are_refused(tmp_path: Path, text: str, complaint: str) -> None:
    """Gaps, missing units and repeated points are named."""
    file = tmp_path / "table.csv"
    file.write_text(text)
    with pytest.raises((DataError, ValueError), match=complaint):
        table_from_csv(file)
