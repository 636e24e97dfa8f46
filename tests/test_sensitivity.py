"""Information, rankings and reduced models, checked against closed forms and refits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motion import small
from simple_models import nomoto

from benchmarks.plans import best_by_trial, bias_of, described, errors_by_differences
from oed_sysid import Dataset, Experiment, Model, MultipleShooting, Output, Parameter, simulate
from oed_sysid.errors import DesignError
from oed_sysid.experiments.manoeuvres import Constant, Doublet, ZigZag
from oed_sysid.information import (
    collinearity_index,
    confirm_bound,
    identifiability,
    identifiable_subset,
    information_of,
    noise_of,
    rank_parameters,
    reduce_model,
    structural_identifiability,
)
from oed_sysid.likelihood.information import Information

GAIN, TIME, RUDDER, NOISE = 0.1, 10.0, 0.2, 1e-3


def first_order(**changes: object) -> Model:
    """Nomoto's first-order model with its yaw rate measured."""
    law, values = {"r": "(K*rudder - r)/T"}, {"K [1/s]": GAIN, "T [s]": TIME}
    model = small("Nomoto", "r [rad/s] <- rudder [rad]", law, values, NOISE, step=0.05)
    return replace(model, **changes)  # type: ignore[arg-type]


def step_test(duration: float = 40.0) -> Experiment:
    """Rudder put over and held."""
    return Experiment("step", Constant("rudder", RUDDER), duration=duration, sample_time=0.5)


def closed_form(times: np.ndarray) -> np.ndarray:
    """Derivatives of the step response by start, gain and time constant, ``(n_times, 3)``."""
    decay = np.exp(-times / TIME)
    return np.column_stack([decay, RUDDER * (1 - decay), -GAIN * RUDDER * times / TIME**2 * decay])


def oscillator() -> Model:
    """Second-order roll model with a weak cubic term and an unseen product."""
    law = {"phi": "p", "p": "b*moment - d*p - k*phi - c*phi**3"}
    values = {"b": 1.0, "d": 0.3, "k": 1.5, "c": 0.02}
    return small("roll", "phi [rad], p [rad/s] <- moment", law, values, 2e-3, step=0.05)


def roll_test(name: str = "doublet", amplitude: float = 0.3) -> Experiment:
    """Doublet of the roll moment."""
    return Experiment(
        name, Doublet("moment", amplitude, pulse_time=2.0), duration=20.0, sample_time=0.1
    )


def test_information_equals_the_closed_form_with_known_start() -> None:
    """The Fisher information of a step response is the sum of squared exact derivatives."""
    found = information_of(first_order(), step_test(), start="known")
    rows = closed_form(step_test().times)[:, 1:] / NOISE
    np.testing.assert_allclose(found.matrix, rows.T @ rows, rtol=1e-8)


def test_unknown_start_states_are_eliminated() -> None:
    """With an unknown start the bound is the block of the full inverse."""
    found = information_of(first_order(), [step_test(), step_test(20.0)], start="unknown")
    long, short = (closed_form(test.times) / NOISE for test in (step_test(), step_test(20.0)))
    rows = np.block(
        [
            [long[:, :1], np.zeros((len(long), 1)), long[:, 1:]],
            [np.zeros((len(short), 1)), short[:, :1], short[:, 1:]],
        ]
    )
    full = np.linalg.inv(rows.T @ rows)
    np.testing.assert_allclose(found.covariance, full[2:, 2:], rtol=1e-7)


def test_start_deviations_lie_between_known_and_unknown() -> None:
    """A start known to a standard deviation gives the information of that extra observation."""
    rows = np.vstack([closed_form(step_test().times) / NOISE, [1 / 0.004, 0, 0]])
    found = information_of(first_order(), step_test(), start={"r": 0.004})
    np.testing.assert_allclose(found.covariance, np.linalg.inv(rows.T @ rows)[1:, 1:], rtol=1e-7)


def test_priors_add_their_inverse_variance() -> None:
    """A prior standard deviation adds one over its square; earlier information adds itself."""
    model = first_order()
    plain = information_of(model, step_test(), priors=None)
    known = information_of(model, step_test(), priors={"T": 0.5})
    np.testing.assert_allclose(known.matrix - plain.matrix, np.diag([0.0, 4.0]), atol=1e-7)
    twice = information_of(model, step_test(), priors=plain)
    np.testing.assert_allclose(twice.matrix, 2 * plain.matrix, rtol=1e-9)


def test_missing_samples_carry_no_information() -> None:
    """A record with NaN gives the information of the samples it has."""
    model = first_order()
    record = simulate(model, step_test(), noise=False)
    outputs = record.outputs.copy()
    outputs[10:30] = np.nan
    found = information_of(
        model, record.with_outputs(outputs), start="known", initial_states=[{"r": 0.0}]
    )
    rows = np.delete(closed_form(record.times)[:, 1:] / NOISE, np.s_[10:30], axis=0)
    np.testing.assert_allclose(found.matrix, rows.T @ rows, rtol=1e-8)


def test_noise_errors_say_what_to_do() -> None:
    """Unknown noise and another description of colour are refused with advice."""
    silent = first_order(outputs=(Output("r", "rad/s"),))
    with pytest.raises(DesignError, match="noise_std"):
        information_of(silent, step_test())
    with pytest.raises(DesignError, match="no output"):
        noise_of(first_order(), {"psi": 0.2})
    with pytest.raises(DesignError, match="NoiseModel"):
        information_of(first_order(), step_test(), coloured={"r": 0.5})


def test_collinearity_follows_its_definition() -> None:
    """The index is one over the smallest singular value of the normalised sensitivities."""
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((50, 3))
    rows[:, 2] = rows[:, 0] + 0.05 * rows[:, 2]
    information = Information.from_jacobian(("a", "b", "c"), rows)
    unit = rows / np.linalg.norm(rows, axis=0)
    expected = 1 / np.sqrt(np.linalg.eigvalsh(unit.T @ unit)[0])
    assert collinearity_index(information) == pytest.approx(expected, rel=1e-9)
    assert collinearity_index(information, ["a", "b"]) < 2


def test_best_subset_leaves_out_one_of_two_twins() -> None:
    """Of two parameters with nearly the same effect only one is kept."""
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((80, 4))
    rows[:, 3] = 0.5 * rows[:, 1] + 0.01 * rows[:, 3]
    names = ("a", "b", "c", "twin")
    subset = identifiable_subset(Information.from_jacobian(names, rows), dict.fromkeys(names, 1.0))
    assert set(subset.names) == {"a", "b", "c"}
    assert subset.left_out == ("twin",)
    assert "to fix: twin" in subset.report()


@pytest.mark.parametrize("seed", range(6))
def test_best_set_is_that_of_enumeration(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of collinear columns the set is the best of all, and exchange alone finds its size."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((40, 4)) @ rng.standard_normal((4, 9))
    rows = (rows + 0.1 * rng.standard_normal(rows.shape)) * rng.uniform(0.5, 30.0, 9)
    names = tuple("abcdefghi")
    information = Information.from_jacobian(names, rows)
    for limit, error in ((8.0, np.inf), (50.0, np.inf), (50.0, 0.3)):
        size, index = best_by_trial(rows.T @ rows, error, limit)
        ones = dict.fromkeys(names, 1.0)
        found = identifiable_subset(information, ones, limit=limit, largest_error=error)
        assert found.size == size
        assert found.collinearity == pytest.approx(index, rel=1e-6)
        monkeypatch.setattr(identifiability, "ENUMERATED", 0)
        exchanged = identifiable_subset(information, ones, limit=limit, largest_error=error)
        monkeypatch.undo()
        assert exchanged.size == size


def test_errors_and_biases_are_those_of_finite_differences() -> None:
    """Errors of a set have the others fixed, and a wrong fixed value moves the estimates."""
    model, test = oscillator(), roll_test()
    known = information_of(model, test, start="known", priors=None)
    found = identifiable_subset(known, model.values, limit=3.0, assumed={"c": 0.01})
    columns = {}
    for name in known.names:
        value = model.parameter(name).value
        ends = [
            simulate(
                model.with_values({name: value * (1 + sign * 1e-4)}), test, noise=False
            ).outputs
            for sign in (1, -1)
        ]
        columns[name] = ((ends[0] - ends[1]) / 2e-4 / 2e-3).ravel()
    for place in found.places:
        others = [name for name in found.names if name != place.name]
        rows = np.column_stack([columns[name] for name in (*others, place.name)])
        bound = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
        assert place.error == pytest.approx(bound[-1], rel=0.01)
        change = np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0]
        share = 0.01 / 0.02 if place.name == "c" else identifiability.ASSUMED
        assert place.assumed == pytest.approx(share)
        assert place.bias == pytest.approx(np.abs(change).max() * share, rel=0.01)
    assert 0 < found.size < len(known.names)


def test_errors_are_those_of_differences() -> None:
    """The errors of the set of a ship, the others fixed, by differences of simulations."""
    model, runs = described("online_ship", None, "zigzag_5_5")
    information = information_of(model, runs, priors=None)
    values = {name: model.values[name] for name in information.names}
    own = [place for place in identifiable_subset(information, values).places if place.free]
    found = errors_by_differences(model, runs, [place.name for place in own])
    stated = [place.error * abs(values[place.name]) for place in own]
    assert found == pytest.approx(stated, rel=1e-4)


def test_a_bias_is_that_of_a_fit() -> None:
    """Of a ship in a zigzag, one parameter fixed ten per cent off after the other."""
    row = bias_of("ship", "online_ship", None, "zigzag_5_5")
    assert len(row["stated"]) > 3
    assert row["stated"] == pytest.approx(row["fitted"], rel=0.2)


def test_weak_and_alike_are_told_apart() -> None:
    """A column of its own that is small is no one else's; one that is nearly a sum is shared."""
    rng = np.random.default_rng(1)
    rows = np.linalg.qr(rng.standard_normal((20, 4)))[0] @ np.diag([50.0, 50.0, 2.0, 0.0])
    rows[:, 3] = rows[:, 0] + rows[:, 1] + 1e-3 * rng.standard_normal(20)
    found = identifiable_subset(
        Information.from_jacobian(tuple("abcd"), rows), dict.fromkeys("abcd", 1.0)
    )
    reasons = {one.split(":")[0] for one in found.reasons}
    assert "These runs hardly depend on c" in reasons
    assert any(one.startswith("These runs hardly separate") for one in reasons)


def test_reason_names_the_motions_that_keep_a_ratio() -> None:
    """Where sway and yaw rate are proportional, the sentence says so and which run would tell."""
    rng = np.random.default_rng(3)
    v, delta = rng.standard_normal((2, 60))
    r = 0.4 * v + 1e-3 * rng.standard_normal(60)
    rows = np.column_stack([v, r, delta])
    names = ("Y_v", "Y_r", "Y_dr")
    found = identifiable_subset(
        Information.from_jacobian(names, 100 * rows),
        dict.fromkeys(names, 1.0),
        assumed={"Y_r": 50.0},
        motions={"v": v, "r": r, "dr": delta},
    )
    assert found.left_out == ("Y_r",)
    assert found.places[-1].advice == "prior"
    assert "Y_r +10 % looks like Y_v +4.0%" in found.reasons[0]
    assert "r and v keep nearly one ratio in them (cosine 1.000); a pull-out" in found.reasons[0]
    assert found.places[-1].bias == pytest.approx(0.4 * 50.0, rel=1e-3)


def test_structural_check_finds_a_product() -> None:
    """Only the product of two gains is seen; a second gain inside makes both visible."""
    product = first_order(
        kinematics={"r": "a*b*rudder - r/T"},
        parameters=(Parameter("a", 0.5), Parameter("b", 0.1), Parameter("T", TIME)),
    )
    rng = np.random.default_rng(5)
    found = structural_identifiability(product, inputs={"rudder": (-0.3, 0.3)}, rng=rng)
    assert (found.rank, found.identifiable) == (2, False)
    assert "a" in found.directions[0]
    assert "b" in found.directions[0]
    whole = structural_identifiability(first_order(), inputs={"rudder": (-0.3, 0.3)}, rng=rng)
    assert whole.identifiable
    assert whole.margin > 1e-3


def test_ranking_shows_mimicry_that_the_index_hides() -> None:
    """Two coefficients with one effect both move the output, yet neither is determined."""
    twins = first_order(
        kinematics={"r": "(K*rudder + L*rudder*(1 + 0.01*rudder) - r)/T"},
        parameters=(Parameter("K", 0.1), Parameter("L", 0.1), Parameter("T", TIME)),
    )
    test = Experiment(
        "doublet", Doublet("rudder", 0.2, pulse_time=60.0), duration=120.0, sample_time=0.5
    )
    ranking = rank_parameters(twins, test)
    assert set(ranking.by_output_change[:2]) == {"K", "L"}
    assert ranking.by_information[0] == "T"
    assert ranking.row("K").inflation > 50
    assert ranking.to_dict()["by_information"][0] == "T"
    assert any("K" in text and "L" in text for text in ranking.together.reasons)


def test_output_change_is_the_published_sum() -> None:
    """The index of the gain of a linear model is the relative change itself."""
    ranking = rank_parameters(first_order(), step_test(), change=0.2)
    assert ranking.row("K").output_change == pytest.approx(0.2, rel=1e-6)
    assert ranking.row("K").peak_change == pytest.approx(1.0, rel=1e-6)


def test_dropping_costs_what_a_refit_finds() -> None:
    """The predicted cost of dropping a term equals the misfit of a refit without it."""
    model = oscillator()
    reduction = reduce_model(model, [roll_test(), roll_test("small", 0.15)])
    first = reduction.drops[0]
    assert first.name == "c"
    data = Dataset(
        simulate(model, test, noise=False) for test in (roll_test(), roll_test("s", 0.15))
    )
    without = model.with_values({"c": 0.0}).fix("c")
    fit = MultipleShooting(noise="given", coloured="never", disturbances="none").fit(without, data)
    assert 2 * fit.cost == pytest.approx(first.cost, rel=0.03)
    assert reduction.drops[-1].cost > 1e3 * first.cost
    assert reduction.model.free_names == tuple(
        name for name in model.free_names if name not in reduction.dropped
    )


def test_small_terms_are_dropped_and_needed_ones_kept() -> None:
    """A negligible cubic goes, everything else stays; keep= is respected."""
    model = oscillator().with_values({"c": 1e-4})
    assert reduce_model(model, roll_test()).dropped == ("c",)
    assert reduce_model(model, roll_test(), keep=["c"]).dropped == ()


def test_bound_predicts_the_errors_found() -> None:
    """Sixty simulated and fitted experiments scatter as the bound says."""
    result = confirm_bound(
        oscillator().fix("c"), roll_test(), rng=np.random.default_rng(11), n_runs=60
    )
    assert result.n_failed == 0
    assert result.confirmed, result.report()
    assert np.all(result.coverage > 0.8)


def test_feedback_is_resolved_before_derivatives_are_taken() -> None:
    """A zigzag's information is that of its commands as a given history."""
    model = replace(nomoto(GAIN, TIME), outputs=(Output("psi", "rad", noise_std=2e-3),), step=0.05)
    test = Experiment("zigzag", ZigZag("rudder", 0.2, 0.2), duration=60.0, sample_time=0.5)
    logged = simulate(model, test, noise=False)
    planned = information_of(model, test)
    recorded = information_of(model, logged, initial_states=[{"psi": 0.0, "r": 0.0}])
    np.testing.assert_allclose(planned.matrix, recorded.matrix, rtol=1e-12)
