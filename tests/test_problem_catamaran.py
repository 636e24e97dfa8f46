"""The catamaran with two propellers: straight running, turning, the hidden effects."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import MultipleShooting, improve, load_problem, simulate_inputs

PROBLEM = load_problem("catamaran")


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


def test_records_fit_with_what_is_hidden() -> None:
    """With lag and asymmetry the fit reaches the noise and holds the truth."""
    train = PROBLEM.data().split(test=["turns"])[0]
    hidden = [PROBLEM.effect(name) for name in ("propeller_lag", "thrust_asymmetry")]
    fit = MultipleShooting().fit(PROBLEM.model + hidden, train)
    noise = np.array([output.noise_std for output in PROBLEM.model.outputs])
    rms = np.sqrt(np.mean(np.concatenate(fit.residuals) ** 2, axis=0))
    np.testing.assert_allclose(rms, noise, rtol=0.1)
    for name in fit.values:
        low, high = fit.interval(name, 0.9999)
        assert low < PROBLEM.truth[name] < high, name


@pytest.mark.slow
def test_hidden_effects_are_found() -> None:
    """Improvement names the lag of the propellers and the weaker one, and nothing false."""
    train, test = PROBLEM.data().split(test=["turns"])
    found = improve(PROBLEM.model, train, test, candidates=PROBLEM.effects)
    assert set(found.model.effect_names) - set(PROBLEM.model.effect_names) == {
        "propeller_lag",
        "thrust_asymmetry",
    }
