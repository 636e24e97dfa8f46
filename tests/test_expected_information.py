"""Information under random forces before any data, and the sea that it is stated for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_design import LIMITS, quick, ship

from oed_sysid import Experiment, NoiseModel, load_problem
from oed_sysid.design import accuracy_range
from oed_sysid.errors import DesignError
from oed_sysid.experiments.manoeuvres import Doublet
from oed_sysid.information import information_of, information_of_each, sea_noise, sea_words
from oed_sysid.physics.model import Model

TEST = Experiment("doublet", Doublet("rudder", 0.2, pulse_time=8.0), duration=40.0, sample_time=0.5)


def sea(model: Model, level: float = 0.01, time: float = 3.0, colour: float = 0.0) -> NoiseModel:
    """Random yaw acceleration, and colour of the rate sensor."""
    return NoiseModel(
        np.array([5e-3, 2e-3]), np.array([0.0, colour]), np.array([level]), colour_time=1.0,
        force_time=time, outputs=model.output_names, places=("force r",),
    )  # fmt: skip


def dense_information(model: Model, noise: NoiseModel) -> np.ndarray:
    """The same by one large Gaussian: outputs linear in the forces about the nominal run."""
    from oed_sysid.experiments.simulation import simulate_inputs
    from oed_sysid.information import plays, respond

    play = plays(model, TEST)[0]
    base = respond(model, play)
    n, step = len(play.times), float(play.times[1])

    def outputs(forces: np.ndarray) -> np.ndarray:
        # The force as an input that is held over a sample, as the filter takes it.
        rate = f"{model.kinematics['r']} + w"
        wide = replace(
            model,
            inputs=(*model.inputs, replace(model.inputs[0], name="w", unit="")),
            kinematics={**model.kinematics, "r": rate},
        )
        both = np.column_stack([play.inputs, forces])
        return simulate_inputs(wide, play.times, inputs=both, initial=play.initial).outputs

    still = outputs(np.zeros(n))
    by_force = np.stack(
        [((outputs(1e-4 * unit) - still) / 1e-4).ravel() for unit in np.eye(n)], axis=1
    )
    lags = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * step
    memory = noise.force[0] ** 2 * np.exp(-lags / noise.force_time[0])
    sensors = np.kron(np.eye(n), np.diag(noise.white**2))
    sensors += np.kron(np.exp(-lags / noise.colour_time[1]), np.diag(noise.colour**2))
    covariance = by_force @ memory @ by_force.T + sensors
    rows = base.jacobian.reshape(-1, base.jacobian.shape[2])
    matrix = rows.T @ np.linalg.solve(covariance, rows)
    own = len(model.states)
    kept = matrix[own:, own:]
    return kept - matrix[own:, :own] @ np.linalg.solve(matrix[:own, :own], matrix[:own, own:])


@pytest.mark.parametrize("colour", [0.0, 4e-3])
def test_expected_information_is_that_of_the_whole_gaussian(colour: float) -> None:
    """The filter's information equals that of all samples with their joint covariance."""
    model = ship(step=0.05)
    noise = sea(model, colour=colour)
    found = information_of(model, TEST, noise=noise, priors=None).matrix
    expected = dense_information(model, noise)
    # Nonlinear damping: the nominal path differs from its start states' only in rounding.
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-4 * np.abs(expected).max())


def test_without_forces_it_is_the_white_bound() -> None:
    """A noise model of white sensors gives the information of their levels."""
    model = ship()
    white = NoiseModel.white_only(np.array([5e-3, 2e-3]), model.output_names)
    found = information_of(model, TEST, noise=white).matrix
    np.testing.assert_allclose(found, information_of(model, TEST).matrix, rtol=1e-9)


def test_information_of_each_is_that_of_one_after_the_other() -> None:
    """Made ready once, the model tells the same; a run that diverges tells nothing."""
    model = ship()
    wild = replace(TEST, initial={"r": 1e200})
    found = information_of_each(model, [TEST, wild, TEST], noise=sea(model), priors=None)
    alone = information_of(model, TEST, noise=sea(model), priors=None)
    assert found[1] is None
    for one in (found[0], found[2]):
        assert one is not None
        np.testing.assert_array_equal(one.factor, alone.factor)


def test_forces_cost_information_and_sensors_bring_it() -> None:
    """More force, or one sensor less, never lowers an error; null directions stay null."""
    model = ship()
    errors = [
        information_of(model, TEST, noise=sea(model, level), priors=None).std_errors
        for level in (1e-4, 1e-2, 1e-1)
    ]
    assert np.all(np.diff(errors, axis=0) > 0)
    one = information_of(model, TEST, noise=sea(model), priors=None, outputs=("psi",))
    assert np.all(one.std_errors > errors[1])
    still = Experiment("straight", duration=20.0, sample_time=0.5, constants={"rudder": 0.0})
    blind = information_of(model, still, noise=sea(model), priors=None)
    assert any("b does not influence" in text for text in blind.null_directions())


def test_sea_in_words_grows_and_levels_are_taken() -> None:
    """Words are shares of the manoeuvre's motion, levels are what was said."""
    problem = load_problem("remus_diving_plane")
    runs = [problem.experiment("zigzag_10_10")]
    calm, rough = (sea_noise(problem.model, word, runs) for word in ("calm", "rough"))
    np.testing.assert_allclose(rough.force, 15 * calm.force)
    slow = sea_noise(problem.model, "calm,time=8", runs)
    np.testing.assert_allclose(slow.force, calm.force / 4)
    given = sea_noise(problem.model, "Z=0.3, M=0.06, time=5", runs)
    assert given.level("force Z") == (0.3, 5.0)
    assert sea_words(given) == "Z 0.3, M 0.06 over 5 s"
    assert sea_noise(problem.model, "still", runs).is_white
    for wrong, words in (("stormy", "Say still"), ("Z=much", "NAME=NUMBER"), ("K=1", "no place")):
        with pytest.raises(Exception, match=words):
            sea_noise(problem.model, wrong, runs)


def test_noise_that_does_not_fit_is_named() -> None:
    """Missing sensors and sensors without noise are said."""
    model = ship()
    short = NoiseModel.white_only(np.array([5e-3]), ("psi",))
    with pytest.raises(DesignError, match=r"says nothing of the output.* r "):
        information_of(model, TEST, noise=short)
    perfect = NoiseModel.white_only(np.array([5e-3, 0.0]), model.output_names)
    with pytest.raises(DesignError, match="white noise of r"):
        information_of(model, TEST, noise=perfect)
    with pytest.raises(DesignError, match="no output 'x'"):
        information_of(model, TEST, outputs=("x",))


def test_design_states_accuracy_for_the_sea() -> None:
    """A design under forces promises less than in still water, and says for which forces."""
    noise = sea(ship(), 0.02)
    found = quick(noise=noise, n_starts=2)
    bound = information_of(found.model, found.experiment, noise=noise, priors=None)
    np.testing.assert_allclose(found.information.std_errors, bound.std_errors, rtol=1e-6)
    still = information_of(found.model, found.experiment, noise=noise.white, priors=None)
    assert np.all(still.std_errors < 0.7 * bound.std_errors)
    assert "Random forces assumed: r 0.02 over 3 s" in found.sea_trial_card()
    assert found.to_dict()["sea"]["disturbances"]["force r"]["level"] == 0.02


def test_beyond_a_third_no_number_is_stated() -> None:
    """Where forces drown the manoeuvre the card says so instead of a number; ranges are told."""
    model = ship()
    weak = replace(LIMITS, inputs={"rudder": (-0.01, 0.01)})
    found = quick(noise=sea(model, 0.02), limits=weak)
    assert found.relative_errors.max() > 0.3
    assert "not id." in found.sea_trial_card()
    other = accuracy_range(
        model, TEST, noise=sea(model, 1e-3), spread=0.2, rng=np.random.default_rng(0)
    )
    nominal = information_of(model, TEST, noise=sea(model, 1e-3)).std_errors
    nominal /= np.abs([model.values[n] for n in other.names])
    assert np.all(other.lowest < nominal)
    assert np.all(nominal < other.highest)
