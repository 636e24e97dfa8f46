"""Rigid bodies in water against an independent simulation; builder and candidates."""

from __future__ import annotations

from math import radians

import motion
import numpy as np
import pytest
from free_body import FreeBody, rotation
from marks import slow

from oed_sysid import Dataset, Experiment, Input, Model, MultipleShooting, Parameter, simulate
from oed_sysid.compiled.kernels import Run
from oed_sysid.errors import ModelError
from oed_sysid.experiments.manoeuvres import ZigZag, ZigZagLike
from oed_sysid.physics import Effect
from oed_sysid.physics.bodies import (
    RigidBody,
    catamaran_effects,
    load_cell,
    rigid_body,
    underwater_vehicle_effects,
)
from oed_sysid.testing.problem_contract import check_effect
from oed_sysid.text import expressions

CENTRE = np.array([0.03, -0.02, 0.05])
LIFT = np.array([-0.01, 0.015, -0.02])
INERTIA = np.array([[0.4, -0.02, -0.05], [-0.02, 3.6, 0.03], [-0.05, 0.03, 3.4]])
ADDED = {
    "X_udot": -1.0,
    "Y_vdot": -32.0,
    "Z_wdot": -36.0,
    "K_pdot": -0.1,
    "M_qdot": -4.5,
    "N_rdot": -5.0,
    "Y_rdot": 1.9,
    "Z_qdot": -1.7,
    "X_qdot": 0.3,
    "K_vdot": -0.2,
    "X_vdot": 0.4,
    "M_pdot": 0.05,
}
VELOCITY = np.array([1.4, 0.2, -0.1, 0.3, -0.2, 0.25])
ANGLES = np.array([0.3, -0.2, 0.5])


def added_matrix() -> np.ndarray:
    """Added inertia (6, 6) written by hand from the names."""
    matrix = np.zeros((6, 6))
    for name, value in ADDED.items():
        i, j = "XYZKMN".index(name[0]), "uvwpqr".index(name[2])
        matrix[i, j] = matrix[j, i] = -value
    return matrix


def body(attitude: str = "euler", *, heavy: bool = True, wet: bool = True) -> RigidBody:
    """An asymmetric body with every entry of its matrices filled."""
    return rigid_body(
        6,
        mass=30.0,
        inertia={"xx": 0.4, "yy": 3.6, "zz": 3.4, "xy": 0.02, "xz": 0.05, "yz": -0.03},
        centre_of_gravity=tuple(CENTRE),
        added_mass=ADDED if wet else {},
        weight=299.0 if heavy else None,
        buoyancy=303.0 if heavy else None,
        centre_of_buoyancy=tuple(LIFT) if heavy else (0.0, 0.0, 0.0),
        attitude=attitude,
    )


def reference(current: tuple[float, float, float] = (0, 0, 0), *, heavy: bool = True) -> FreeBody:
    """The same body in the independent simulation."""
    return FreeBody(
        30.0,
        INERTIA,
        CENTRE,
        added_matrix(),
        weight=299.0 if heavy else 0.0,
        buoyancy=303.0 if heavy else 0.0,
        lift_centre=LIFT,
        current=np.array(current, float),
    )


def model_of(parts: RigidBody, *effects, step: float = 0.001) -> Model:
    """The bare body as a model; an input is needed by nobody."""
    return parts.model("body", inputs=(Input("T", "N"),), effects=effects, step=step)


def ran(model: Model, start: dict[str, float], times: np.ndarray) -> Run:
    """A run without commands, from states by name."""
    own = np.array([start.get(name, 0.0) for name in model.state_names])
    inputs = np.zeros((len(times), len(model.inputs)))
    found = motion.ran(model, times, inputs, own, compiled=True)
    assert found.ok
    return found


def run(model: Model, start: dict[str, float], times: np.ndarray) -> dict[str, np.ndarray]:
    """States by name."""
    return dict(zip(model.state_names, ran(model, start, times).states.T, strict=False))


def moving(parts: RigidBody) -> dict[str, float]:
    """Start of all tests."""
    named = dict(zip("uvwpqr", VELOCITY, strict=True))
    phi, theta, psi = ANGLES
    return parts.start(phi=phi, theta=theta, psi=psi, x=1.0, y=-2.0, z=3.0, **named)


TIMES = np.linspace(0.0, 5.0, 51)


STREAM, STILL = (0.3, -0.4, 0.05), (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("attitude", "current"),
    [("quaternion", STREAM), *slow(("euler", STILL), ("euler", STREAM), ("quaternion", STILL))],
)
def test_trajectory_of_the_independent_simulator(attitude: str, current: tuple) -> None:
    """Six degrees of freedom, with restoring and current, agree to 1e-8."""
    parts = body(attitude)
    effects = []
    if any(current):
        effects = [parts.current(north=current[0], east=current[1], down=current[2])]
    model = model_of(parts, *effects)
    found = ran(model, moving(parts), TIMES[:21])
    ours = dict(zip(model.state_names, found.states.T, strict=False))
    velocity, turn, place = reference(current).run(
        TIMES[:21], VELOCITY, ANGLES, np.array([1, -2, 3.0])
    )
    np.testing.assert_allclose(np.column_stack([ours[v] for v in "uvwpqr"]), velocity, atol=1e-8)
    np.testing.assert_allclose(np.column_stack([ours[x] for x in "xyz"]), place, atol=1e-8)
    angles = [model.output_names.index(a) for a in ("phi", "theta", "psi")]
    np.testing.assert_allclose(rotation(*found.outputs[-1, angles]), turn[-1], atol=1e-8)
    if attitude == "quaternion":
        length = (1 + ours["de0"]) ** 2 + sum(ours[e] ** 2 for e in ("e1", "e2", "e3"))
        np.testing.assert_allclose(length, 1, atol=1e-9)


@pytest.mark.slow
def test_no_singularity_of_the_quaternion() -> None:
    """A body that pitches through the vertical again and again follows the reference."""
    parts = body("quaternion", heavy=False)
    spin = np.array([0.5, 0.0, 0.0, 0.1, 1.5, 0.05])
    start = parts.start(**dict(zip("uvwpqr", spin, strict=True)))
    ours = run(model_of(parts, step=0.0005), start, TIMES)
    velocity, turn, _ = reference(heavy=False).run(TIMES, spin, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(np.column_stack([ours[v] for v in "uvwpqr"]), velocity, atol=1e-8)
    steepest = np.abs(turn[:, 2, 0]).max()
    assert steepest > np.sin(radians(87))


def test_energy_is_conserved_without_damping_and_restoring() -> None:
    """Inertial forces do no work: kinetic energy stays for a minute."""
    parts = body("quaternion", heavy=False)
    times = np.linspace(0.0, 60.0, 61)
    ours = run(model_of(parts, step=0.005), moving(parts), times)
    velocities = np.column_stack([ours[v] for v in "uvwpqr"])
    matrix = parts.inertia_matrix()
    energy = 0.5 * np.einsum("ki,ij,kj->k", velocities, matrix, velocities)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-8)
    assert np.ptp(velocities, axis=0).min() > 0.05


def test_matrices_are_those_written_by_hand() -> None:
    """Rigid and added inertia equal their block forms, and are symmetric."""
    parts = body()
    np.testing.assert_allclose(parts.inertia_matrix("rigid"), reference().rigid, atol=1e-14)
    np.testing.assert_allclose(parts.inertia_matrix("added"), added_matrix(), atol=1e-14)


def test_coriolis_matrix_is_skew_and_is_what_the_texts_say() -> None:
    """C is skew at random velocities, and minus C nu equals the printed forces."""
    parts = body()
    rng = np.random.default_rng(3)
    values = {p.name: p.value for p in parts.parameters}
    for _ in range(20):
        nu = rng.normal(size=6)
        scope = values | dict(zip("uvwpqr", nu, strict=True))
        scope |= {f"{v}_r": scope[v] for v in "uvw"}
        total = np.zeros(6)
        for effect in parts.effects[:2]:
            local = dict(scope)
            for name, text in effect.definitions.items():
                local[name] = float(expressions.to_numpy(text, local))
            for axis, text in effect.terms.items():
                total["XYZKMN".index(axis)] += float(expressions.to_numpy(text, local))
        c = parts.coriolis_matrix(nu)
        np.testing.assert_allclose(c + c.T, 0.0, atol=1e-12)
        np.testing.assert_allclose(total, -c @ nu, atol=1e-11)
        assert abs(nu @ total) < 1e-11


@pytest.mark.parametrize("dof", [3, *slow(4, 6)])
def test_zero_current_is_no_current(dof: int) -> None:
    """A current of zero changes nothing at all, in every kind of body."""
    parts = rigid_body(
        dof,
        mass=30.0,
        inertia=(0.4, 3.6, 3.4),
        centre_of_gravity=(0.03, 0.0, 0.05),
        added_mass={"X_udot": -1.0, "Y_vdot": -32.0, "Y_rdot": 1.9, "N_rdot": -5.0},
    )
    start = dict.fromkeys(parts.velocities, 0.3)
    plain = run(model_of(parts), start, TIMES)
    with_zero = run(model_of(parts, parts.current()), start, TIMES)
    for name, values in plain.items():
        np.testing.assert_allclose(with_zero[name], values, rtol=1e-12, atol=1e-13)


def test_a_floating_hull_without_heave_has_no_depth() -> None:
    """It heels and sways at the surface; a submerged one that rolls does change its depth."""
    facts = {"mass": 30.0, "inertia": {"xx": 0.4, "zz": 3.4}, "weight": 294.3}
    ship = rigid_body(4, metacentric_height=0.1, **facts)
    assert list(ship.kinematics) == ["phi", "psi", "x", "y"]
    assert "z" in rigid_body(4, **facts).kinematics
    asked = rigid_body(4, metacentric_height=0.1, position=("z",), **facts)
    assert "z" in asked.kinematics


@pytest.mark.slow
def test_fewer_degrees_of_freedom_are_the_plane_motion_of_more() -> None:
    """A symmetric body that moves in the plane follows the six-degree equations."""
    facts = {"mass": 30.0, "inertia": (0.4, 3.6, 3.4), "centre_of_gravity": (0.03, 0.0, 0.0)}
    plane = {"X_udot": -1.0, "Y_vdot": -32.0, "Y_rdot": 1.9, "N_rdot": -5.0}
    start = {"u": 1.4, "v": 0.2, "r": 0.3}
    six = run(model_of(rigid_body(6, added_mass=plane, **facts)), start, TIMES)
    three = run(model_of(rigid_body(3, added_mass=plane, **facts)), start, TIMES)
    for name, values in three.items():
        np.testing.assert_allclose(values, six[name], atol=1e-10)
    dive = {"X_udot": -1.0, "Z_wdot": -36.0, "Z_qdot": -1.7, "M_qdot": -4.5}
    weights = {"weight": 299.0, "buoyancy": 303.0, "centre_of_buoyancy": (0.01, 0.0, -0.02)}
    start = {"u": 1.4, "w": 0.1, "q": 0.2, "theta": 0.1}
    six = run(model_of(rigid_body(6, added_mass=dive, **facts, **weights)), start, TIMES)
    names = ("surge", "heave", "pitch")
    down = run(model_of(rigid_body(names, added_mass=dive, **facts, **weights)), start, TIMES)
    for name, values in down.items():
        np.testing.assert_allclose(values, six[name], atol=1e-9)


def test_thruster_and_fin_by_vectors() -> None:
    """Forces and moments of appendages equal r x F with the flow of their own place."""
    parts = body()
    place, n = np.array([-0.64, 0.1, -0.2]), np.array([0.0, np.sin(0.6), -np.cos(0.6)])
    fin = parts.fin("canted", "0.1*T", at=tuple(place), normal=tuple(n), lift=5.0, drag=2.0)
    arm = Parameter("arm_pod", 0.02, "m")
    push = parts.thruster(
        "pod", "T", at=tuple(place), direction=(0.8, 0.6, 0), torque="arm_pod*T", parameters=(arm,)
    )
    thrust, flow, omega = 7.0, VELOCITY[:3], VELOCITY[3:]
    local = flow + np.cross(omega, place)
    angle, u = 0.1 * thrust, local[0]
    force = 5.0 * u * (u * angle - local @ n) * n - np.array([2.0 * u**2 * angle**2, 0, 0])
    along = np.array([0.8, 0.6, 0.0])
    for effect, vector, extra in ((fin, force, 0.0), (push, thrust * along, 0.02 * thrust * along)):
        scope = {p.name: p.value for p in effect.parameters} | {"T": thrust}
        scope |= dict(zip(("u_r", "v_r", "w_r"), flow, strict=True))
        scope |= dict(zip("pqr", omega, strict=True))
        for name, text in effect.definitions.items():
            scope[name] = float(expressions.to_numpy(text, scope))
        moment = np.cross(place, vector) + extra
        for axis, expected in zip("XYZKMN", [*vector, *moment], strict=True):
            text = effect.terms.get(axis, "0")
            assert float(expressions.to_numpy(text, scope)) == pytest.approx(
                expected, rel=1e-13, abs=1e-13
            )
    check_effect_of(parts, push)


def check_effect_of(parts: RigidBody, effect) -> None:
    """Jacobians of an appendage, which has no amplitude to be absent at."""
    model = parts.model("body", inputs=(Input("T", "N"),), step=0.02)
    check_effect(effect, model, rng=np.random.default_rng(4), inputs={"T": (1.0, 5.0)}, n_times=10)


def test_accelerometer_at_rest_and_in_free_motion() -> None:
    """At rest it shows minus gravity; off the origin it shows the acceleration of its place."""
    parts = body()
    place = np.array([0.4, -0.3, 0.2])
    sensors = [parts.accelerometer(f"a{i}", i, at=tuple(place)) for i in "xyz"]
    model = parts.model(
        "body", inputs=(Input("T", "N"),), outputs=(*sensors, load_cell("Z", "Z")), step=0.001
    )
    times = np.arange(0.0, 0.5, 0.002)
    found = ran(model, moving(parts), times)
    seen = found.outputs[:, -4:-1]
    states = dict(zip(model.state_names, found.states.T, strict=False))
    turns = [
        rotation(*angles)
        for angles in zip(*(states[a] for a in ("phi", "theta", "psi")), strict=True)
    ]
    track = np.column_stack([states[x] for x in "xyz"]) + [turn @ place for turn in turns]
    # Fourth-order second difference of the path of the sensor.
    second = (-track[4:] + 16 * track[3:-1] - 30 * track[2:-2] + 16 * track[1:-3] - track[:-4]) / (
        12 * 0.002**2
    )
    expected = [turn.T @ (a - [0, 0, 9.80665]) for turn, a in zip(turns[2:-2], second, strict=True)]
    np.testing.assert_allclose(seen[2:-2], expected, atol=2e-6)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"dof": 5}, "Choose 3, 4, 6"),
        ({"dof": ("surge", "dive")}, "no motion 'dive'"),
        ({"added_mass": {"Y_rdot": 1.0, "N_vdot": 1.0}}, "same entry of a symmetric"),
        ({"added_mass": {"Y_vdot": 3.0}}, "derivatives are negative"),
        ({"added_mass": {"Y_v": 3.0}}, "no acceleration derivative"),
        ({"dof": 3, "added_mass": {"Z_wdot": -3.0}}, "does not belong"),
        ({"inertia": (1.0, 0.0, 2.0)}, "I_yy is 0"),
        ({"inertia": 1.0}, "1 moment of inertia for 3"),
        ({"dof": 3, "attitude": "quaternion"}, "needs roll, pitch and yaw"),
        ({"buoyancy": 300.0}, "no weight"),
        ({"metacentric_height": 0.5}, "needs the weight"),
        ({"dof": 3, "position": ("z",)}, "changes no position 'z'"),
    ],
)
def test_wrong_bodies_are_refused(changes: dict, complaint: str) -> None:
    """What does not fit together is refused with what to do."""
    given = {"dof": 6, "mass": 30.0, "inertia": (0.4, 3.6, 3.4)} | changes
    with pytest.raises(ModelError, match=complaint):
        rigid_body(given.pop("dof"), **given)


def test_parameters_may_be_free() -> None:
    """A Parameter given to the builder keeps its prior under the standard name."""
    parts = rigid_body(
        3,
        mass=Parameter("any", 30.0, prior_std=1.0),
        inertia=3.4,
        added_mass=[Parameter("Y_vdot", -30.0, prior_std=3.0)],
    )
    assert model_of(parts).free_names == ("m", "Y_vdot")
    assert model_of(parts).parameter("Y_vdot").unit == "kg"


@pytest.mark.parametrize("disturbances", ["none", *slow("auto")])
def test_quaternion_model_can_be_fitted(disturbances: str) -> None:
    """From wrong values and unknown start states a fit with a quaternion finds the truth."""
    parts = rigid_body(
        6,
        mass=40.0,
        inertia=(0.4, 6.0, 6.0),
        centre_of_gravity=(0, 0, 0.02),
        added_mass={"X_udot": -1.5, "Y_vdot": -45.0, "Z_wdot": -45.0, "M_qdot": -7.0},
        weight=392.0,
        attitude="quaternion",
        position=("z",),
    )
    hull = parts.hull({"X_absuu": -3.5, "Y_uv": -25.0, "Z_uw": -25.0, "M_uq": -20.0, "N_ur": -20.0})
    known = Parameter("K_p", -0.6, fixed=True)
    fins = (
        parts.fin("stern", "ds", at=(-0.8, 0, 0), normal="horizontal", lift=14.0),
        parts.fin("rudder", "dr", at=(-0.8, 0, 0), normal="vertical", lift=14.0),
    )
    noise = {**dict.fromkeys("uvw", 0.02), **dict.fromkeys("pqr", 0.004), "z": 0.03}
    noise |= {"phi": 0.005, "theta": 0.004, "psi": 0.005}
    model = parts.model(
        "auv",
        inputs=(Input("ds", "rad"), Input("dr", "rad"), Input("T", "N")),
        effects=(hull, parts.hull([known], name="roll"), *fins, parts.thruster("screw", "T")),
        noise=noise,
        step=0.05,
    )
    run_ = Experiment(
        "run",
        (ZigZagLike("ds", 0.12, 0.09), ZigZag("dr", 0.17, 0.17, sign=-1)),
        duration=40.0,
        sample_time=0.2,
        constants={"T": 8.0},
        initial=parts.start(u=1.5, z=20.0, psi=0.7),
    )
    record = simulate(model, run_, rng=np.random.default_rng(3))
    wrong = model.with_values({name: 1.1 * model.values[name] for name in model.free_names})
    fit = MultipleShooting(disturbances=disturbances).fit(wrong, Dataset((record,)))
    assert fit.status.ok
    # The length of the start's quaternion moves nothing, and nothing goes after it.
    assert fit.iterations < 60
    for name in fit.names:
        low, high = fit.interval(name, 0.9999)
        assert low < model.values[name] < high, name


MEASURED = ("u", "v", "w", "p", "q", "r", "phi", "theta")
BODY = rigid_body(
    6,
    mass=30.0,
    inertia=(0.2, 3.4, 3.4),
    added_mass={"X_udot": -1.0, "Y_vdot": -35.0, "Z_wdot": -35.0, "M_qdot": -5.0, "N_rdot": -5.0},
    centre_of_gravity=(0.0, 0.0, 0.02),
    weight=299.0,
)
AUV = BODY.model(
    "auv",
    inputs=(Input("ds", "rad"), Input("dr", "rad"), Input("T", "N")),
    effects=(
        BODY.thruster("propeller", "T"),
        BODY.hull({"X_absuu": -2.0, "Y_absvv": -100.0}),
        BODY.fin("stern", "ds", at=(-0.6, 0, 0), normal="horizontal", lift=5.0),
        BODY.fin("rudder", "dr", at=(-0.6, 0, 0), normal="vertical", lift=5.0),
    ),
    step=0.05,
)
UNDERWATER = underwater_vehicle_effects(
    BODY, length=1.33, speed=1.5, diameter=0.19, outputs=MEASURED, step=0.05
)
HULLS = rigid_body(
    3, mass=55.0, inertia=20.0, added_mass={"X_udot": -5.0, "Y_vdot": -80.0, "N_rdot": -30.0}
)
CATAMARAN = HULLS.model(
    "catamaran",
    inputs=(Input("T_port", "N"), Input("T_starboard", "N")),
    effects=(
        HULLS.thruster("port", "T_port", at=(0, -0.4, 0)),
        HULLS.thruster("starboard", "T_starboard", at=(0, 0.4, 0)),
        HULLS.hull({"X_absuu": -20.0, "Y_v": -100.0, "N_r": -50.0}),
    ),
    step=0.05,
)
SURFACE = catamaran_effects(
    HULLS, length=2.0, speed=1.5, draught=0.25, outputs=("u", "v", "r"), step=0.05
)


def check(effect: Effect, model: Model, initial: dict[str, float]) -> None:
    """Short trajectories at ordinary speed."""
    inputs = {name: (-0.2, 0.2) for name in ("ds", "dr")}
    inputs |= {name: (5.0, 15.0) for name in ("T", "T_port", "T_starboard")}
    inputs = {name: span for name, span in inputs.items() if name in model.input_names}
    rng = np.random.default_rng(5)
    check_effect(effect, model, rng=rng, initial=initial, inputs=inputs, n_times=20, n_points=1)


@pytest.mark.slow
@pytest.mark.parametrize("effect", UNDERWATER, ids=lambda effect: effect.name)
def test_underwater_effects_keep_the_contract(effect: Effect) -> None:
    """Each candidate of an underwater vehicle has units, derivatives and a zero."""
    check(effect, AUV, {"u": 1.5, "z": 5.0})


@pytest.mark.slow
@pytest.mark.parametrize("effect", SURFACE, ids=lambda effect: effect.name)
def test_catamaran_effects_keep_the_contract(effect: Effect) -> None:
    """Each candidate of a catamaran has units, derivatives and a zero."""
    check(effect, CATAMARAN, {"u": 1.5})


def test_all_candidates_fit_their_model_together() -> None:
    """A model with all candidates at zero has one amplitude for each at least."""
    for model, effects in ((AUV, UNDERWATER), (CATAMARAN, SURFACE)):
        full = model + [effect.absent() for effect in effects]
        assert len(full.effect_names) == len(set(full.effect_names))
        assert len(full.free_names) >= len(model.free_names) + len(effects)


def test_plane_bodies_get_plane_candidates() -> None:
    """A body without heave and pitch is not offered effects in them."""
    plane = rigid_body(("surge", "heave", "pitch"), mass=30.0, inertia=3.4)
    found = underwater_vehicle_effects(plane, length=1.3, speed=1.5, diameter=0.19, fins=("ds",))
    axes = {str(key)[0] for effect in found if effect.stage == "force" for key in effect.terms}
    assert axes == {"X", "Z", "M"}
