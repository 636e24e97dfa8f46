"""Simulated problems: the catamaran and REMUS in six degrees of freedom."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from marks import slow
from published import PUBLISHED

from oed_sysid import MultipleShooting, Problem, improve, load_problem, simulate, simulate_inputs
from oed_sysid.compiled.graph import build
from oed_sysid.text import expressions

PROBLEM, PROBLEM_6DOF = load_problem("catamaran"), load_problem("remus_6dof")
# Of each problem the records that judge, and what is hidden.
HIDDEN = (
    (PROBLEM, "turns", {"propeller_lag", "thrust_asymmetry"}),
    (PROBLEM_6DOF, "wide", {"fin_lag", "current"}),
)


def steady(port: float, starboard: float, seconds: float = 60.0) -> dict[str, float]:
    """States after a while at constant revolutions."""
    times = np.arange(0.0, seconds, 0.1)
    run = simulate_inputs(
        PROBLEM.model,
        times,
        inputs={"n_port": port, "n_starboard": starboard},
        initial={"u": 1.0},
    )
    return dict(zip(PROBLEM.model.state_names, run.states[-1], strict=True))


def test_equal_thrusts_run_straight_at_the_speed_of_their_balance() -> None:
    """Two equal propellers give the speed at which drag equals twice the thrust."""
    end, values = steady(70.0, 70.0), PROBLEM.model.values
    thrust = 2 * values["k_n"] * 70.0**2
    drag = -values["X_u"] * end["u"] - values["X_absuu"] * end["u"] ** 2
    assert drag == pytest.approx(thrust, rel=1e-6)
    assert abs(end["psi"]) < 1e-9


def test_more_on_port_turns_to_starboard_by_the_lever_of_the_hulls() -> None:
    """A turn is to the side of the weaker propeller, and mirrored thrusts mirror it."""
    right, left = steady(80.0, 60.0), steady(60.0, 80.0)
    assert right["r"] > 0.1
    assert left["r"] == pytest.approx(-right["r"], rel=1e-9)
    assert left["u"] == pytest.approx(right["u"], rel=1e-9)


def test_commands_swing_about_cruise() -> None:
    """No manoeuvre commands a propeller far from 70 rad/s, and each begins there."""
    for experiment in PROBLEM.experiments.values():
        commands = experiment.commands(PROBLEM.model.input_names)
        assert commands.min() >= 40.0
        assert commands.max() <= 100.0


@pytest.mark.parametrize(("problem", "judge", "hidden"), [HIDDEN[0], *slow(HIDDEN[1])])
def test_records_fit_with_what_is_hidden(problem: Problem, judge: str, hidden: set[str]) -> None:
    """With lag, asymmetry or current the fit reaches the noise and holds the truth."""
    train = problem.data().split(test=[judge])[0]
    model = problem.model + [effect for effect in problem.effects if effect.name in hidden]
    fit = MultipleShooting().fit(model, train)
    noise = np.array([output.noise_std for output in model.outputs])
    rms = np.sqrt(np.mean(np.concatenate(fit.residuals) ** 2, axis=0))
    np.testing.assert_allclose(rms, noise, rtol=0.1)
    # Of the catamaran every parameter has a truth of its own.
    known = {} if problem is PROBLEM else fit.values | problem.model.values
    truth = known | problem.truth
    for name in fit.values:
        low, high = fit.interval(name, 0.9999)
        assert low < truth[name] < high, name


@pytest.mark.slow
@pytest.mark.parametrize(("problem", "judge", "hidden"), HIDDEN)
def test_hidden_effects_are_found(problem: Problem, judge: str, hidden: set[str]) -> None:
    """Improvement names the lag, and the weaker propeller or the current, and nothing false."""
    found = improve(problem.model, *problem.data().split(test=[judge]), candidates=problem.effects)
    assert set(found.model.effect_names) - set(problem.model.effect_names) == hidden


AXES = "XYZKMN"
# Prestero (2001), tables B.1 and B.2: products of two velocities, and fins.
TABLE_B = PUBLISHED["table_B"]


def forces(**motion: float) -> np.ndarray:
    """Forces on six axes of water, hull and fins; ``ds`` and ``dr`` may be given."""
    model = PROBLEM_6DOF.model
    scope = model.values | dict.fromkeys((*"uvwpqr", "ds", "dr", "T"), 0.0) | motion
    scope |= {f"{v}_r": scope[v] for v in "uvw"}
    total = np.zeros(6)
    for name in ("added_mass", "hull", "stern_planes", "rudder"):
        effect, local = model.effect(name), dict(scope)
        for word, text in effect.definitions.items():
            local[word] = float(expressions.to_numpy(text, local))
        for axis, text in effect.terms.items():
            total[AXES.index(axis)] += float(expressions.to_numpy(text, local))
    return total


def mixed(axis: str, first: str, second: str) -> float:
    """Coefficient of the product of two velocities, without squares of either."""
    i = AXES.index(axis)
    corners = [a * b * forces(**{first: a, second: b})[i] for a in (1.0, -1.0) for b in (1.0, -1.0)]
    return sum(corners) / 4


def coefficient(name: str) -> float:
    """Combined coefficient of the model under a name of table B."""
    axis, factors = name.split("_")
    i = AXES.index(axis)
    if factors.startswith("uud"):
        fin = factors[2:]
        return (forces(u=1.0, **{fin: 0.1})[i] - forces(u=1.0, **{fin: -0.1})[i]) / 0.2
    first, second = factors
    if first == second:
        return (forces(**{first: 1.0})[i] + forces(**{first: -1.0})[i]) / 2
    return mixed(axis, first, second)


@pytest.mark.parametrize("name", TABLE_B)
def test_combined_coefficients_of_the_thesis(name: str) -> None:
    """Builder, fins and hull add up to tables B.1 and B.2, within their three digits."""
    assert coefficient(name) == pytest.approx(TABLE_B[name], rel=3e-3, abs=0.02)


def test_propeller_torque_heels_the_vehicle() -> None:
    """At cruise the torque of 0.543 N m balances z_G W sin(phi)."""
    experiment = PROBLEM_6DOF.experiment("cruise")
    record = simulate(PROBLEM_6DOF.model, experiment, noise=False)
    mean = float(np.mean(record.output("phi")))
    assert mean == pytest.approx(-np.arcsin(0.543 / (0.0196 * 299)), abs=0.02)


def test_hull_is_unstable_in_pitch() -> None:
    """The pitch motion at 1.54 m/s has the growing pair of poles 0.43 +- 0.18i."""
    model, graph = PROBLEM_6DOF.model, build(PROBLEM_6DOF.model)
    names = list(graph.state_names)
    state = np.zeros(len(names))
    state[names.index("u")] = 1.54
    x = ca.SX.sym("x", len(names))
    rates = graph.rates(x, ca.DM([0, 0, 3.84]), model.value_vector, 0.0)
    jacobian = np.array(ca.Function("j", [x], [ca.jacobian(rates, x)])(state))
    plane = [names.index(name) for name in ("u", "w", "q", "theta")]
    poles = np.linalg.eigvals(jacobian[np.ix_(plane, plane)])
    worst = poles[np.argmax(poles.real)]
    assert worst.real == pytest.approx(PROBLEM_6DOF.published["pitch_poles"][0].real, abs=0.02)
    assert abs(worst.imag) == pytest.approx(PROBLEM_6DOF.published["pitch_poles"][0].imag, abs=0.02)
