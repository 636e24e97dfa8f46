"""Experiments for missing physics: power of a search, rivals told apart, records in hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_design import LIMITS, quick, ship

from oed_sysid import Dataset, Experiment, Force, MultipleShooting, NoiseModel, Parameter
from oed_sysid.design import (
    Budget,
    Detect,
    Discriminate,
    Knowledge,
    ProgrammeSearch,
    Search,
    Trial,
    design_experiment,
    design_programme,
)
from oed_sysid.design.criteria import log_power, told_apart
from oed_sysid.errors import DesignError
from oed_sysid.experiments.experiment import Limits
from oed_sysid.experiments.manoeuvres import Doublet
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information import information_of, plays
from oed_sysid.information.bound import RunInformation
from oed_sysid.information.shifts import Shifts

CUBIC = Force("cubic", {"r": "-E_cubic*r**3"}, (Parameter("E_cubic", 0.0, scale=30.0),))
SINES = Force(
    "sines",
    {"r": "E_cos*cos(0.4*t) + E_sin*sin(0.4*t)"},
    (Parameter("E_cos", 0.0, scale=2e-4), Parameter("E_sin", 0.0, scale=2e-4)),
)
# A kink at zero: its amplitude has no tangent there.
DEAD = Force(
    "dead",
    {"r": "-E_dead*psi/(0.05 + abs(psi))"},
    (Parameter("E_dead", 0.0, lower=0.0, scale=4e-4),),
)
EFFECTS = (CUBIC, SINES, DEAD)
RUN = Experiment("doublet", Doublet("rudder", 0.2, pulse_time=10.0), duration=40.0, sample_time=0.5)


@pytest.mark.parametrize(
    "criterion",
    [Detect(EFFECTS), Detect(EFFECTS, worst=True), Discriminate(EFFECTS, size=1.0)],
    ids=lambda c: c.name,
)
def test_gradients_by_the_information_equal_differences(criterion: Detect) -> None:
    """Mean and smallest chance, and pairs with several amplitudes, have exact derivatives."""
    shifts = criterion.shifts(ship())
    assert len(shifts) == 4
    measure = criterion.bind_shifts(shifts, 3)
    rng = np.random.default_rng(1)
    rows = 0.6 * rng.standard_normal((40, 7))
    matrix = rows.T @ rows
    _, gradient = measure(matrix)
    direction = rng.standard_normal((7, 7))
    direction = direction @ direction.T
    slope = (measure(matrix + 1e-6 * direction)[0] - measure(matrix - 1e-6 * direction)[0]) / 2e-6
    assert np.sum(gradient * direction) == pytest.approx(slope, rel=1e-5)


def test_power_is_the_share_of_simulated_tests_that_exceed_the_threshold() -> None:
    """The power of a test is what repetitions with Gaussian noise show."""
    rng = np.random.default_rng(0)
    for freedom, gain, needed in ((1, 10.0, 13.4), (3, 20.0, 17.0)):
        draws = rng.standard_normal((40_000, freedom))
        draws[:, 0] += np.sqrt(gain)
        share = np.mean((draws**2).sum(axis=1) > needed)
        assert np.exp(log_power(gain, freedom, needed)[0]) == pytest.approx(share, abs=0.01)


def test_concave_log_power_keeps_the_certificate() -> None:
    """Halfway between two informations the mean log chance is at least the mean of both."""
    criterion = Detect(EFFECTS)
    measure = criterion.bind_shifts(criterion.shifts(ship()), 3)
    rng = np.random.default_rng(2)
    for _ in range(40):
        ends = [rng.standard_normal((9, 7)) * np.exp(rng.normal(0, 1, 7)) for _ in range(2)]
        first, second = (rows.T @ rows for rows in ends)
        middle = measure(0.5 * (first + second))[0]
        assert middle >= 0.5 * (measure(first)[0] + measure(second)[0]) - 1e-9


def test_parameters_keep_their_information_beside_shifts() -> None:
    """With shifts beside them and under disturbance forces, parameters keep their information."""
    model = ship()
    shifts = Shifts.of(model, EFFECTS)
    sea = NoiseModel(
        np.array([5e-3, 2e-3]), np.zeros(2), np.array([0.005]), force_time=3.0,
        outputs=("psi", "r"), places=("force r",),
    )  # fmt: skip
    n = len(model.free_parameters)
    for noise in (None, sea):
        joint = RunInformation(model, noise, shifts=shifts).matrix(RUN)
        assert joint is not None
        alone = information_of(model, RUN, noise=noise, priors=None).matrix
        np.testing.assert_allclose(joint[:n, :n], alone, rtol=1e-7)
    calm = replace(sea, force=np.array([1e-12]))
    white = RunInformation(model, None, shifts=shifts).matrix(RUN)
    weak = RunInformation(model, calm, shifts=shifts).matrix(RUN)
    assert white is not None
    assert weak is not None
    sizes = np.sqrt(np.diag(white))
    np.testing.assert_allclose(weak / sizes / sizes[:, None], white / sizes / sizes[:, None],
                               atol=1e-6)  # fmt: skip


@pytest.mark.parametrize("effect", [CUBIC, DEAD], ids=lambda e: e.name)
def test_expected_gain_is_what_a_refit_gains(effect: Force) -> None:
    """Noise-free data with an effect of its size: the nominal model misses them by its gain."""
    model = ship()
    effect = effect.with_values({p.name: 0.1 * p.magnitude for p in effect.parameters})
    data = Dataset((simulate(model + effect, RUN, noise=False),))
    plain = MultipleShooting(noise="given", coloured="never", disturbances="none").fit(model, data)
    criterion = Detect([effect])
    shifts = criterion.shifts(model)
    matrix = RunInformation(model, None, shifts=shifts).matrix(RUN)
    assert matrix is not None
    (found,) = criterion.detections(shifts, 0 * matrix, matrix, len(model.free_parameters))
    assert found.gain_before == pytest.approx(0.0, abs=1e-9)
    assert 2 * plain.cost == pytest.approx(found.gain_after, rel=0.3)


def test_a_design_reveals_what_the_records_could_not_show() -> None:
    """After a fit its records count, and the run makes visible what they leave hidden."""
    model = ship()
    truth = simulate(model, replace(RUN, limits=Limits()), rng=np.random.default_rng(0))
    fit = MultipleShooting(noise="given", coloured="never", disturbances="none").fit(
        model, Dataset((truth,))
    )
    hidden = CUBIC.with_values({"E_cubic": 20.0})
    found = design_experiment(
        fit,
        Trial(limits=LIMITS, duration=40.0, sample_time=0.5),
        criterion=Detect([hidden, DEAD]),
        rng=np.random.default_rng(0),
        search=Search(n_starts=1, n_candidates=15, n_steps=6),
    )
    cubic = found.chances[0]
    shifts = Shifts.of(fit.model, [hidden])
    (play,) = plays(fit.model, fit.dataset, initial_states=fit.initial_states)
    factor = RunInformation(fit.model, fit.sigma, shifts=shifts).factor(play)
    told = factor.T @ factor
    n = len(fit.model.free_parameters)
    left = told[n, n] - told[n, :n] @ np.linalg.solve(told[:n, :n], told[:n, n])
    assert cubic.gain_before == pytest.approx(left, rel=1e-3)
    assert cubic.before < 0.2 < 0.9 < cubic.after
    assert cubic.least < 1.0
    assert "would show at their usual size" in found.report()
    assert found.to_dict()["chances"][0]["after"] == cubic.after


def test_told_apart_rises_with_the_misfit_and_wrong_wishes_are_refused() -> None:
    """Certainty comes with the misfit; candidates must be there, each once, and of some size."""
    values = [told_apart(misfit) for misfit in (0.0, 2.0, 6.0, 16.0, 40.0)]
    assert values == sorted(values)
    assert values[0] == 0.0
    assert values[-1] > 0.99
    for wrong in ({"candidates": ()}, {"candidates": (CUBIC, CUBIC)},
                  {"candidates": (CUBIC,), "size": 0.0}):  # fmt: skip
        with pytest.raises(DesignError):
            Detect(**wrong)
    with pytest.raises(DesignError, match="no amplitude"):
        quick(criterion=Detect([replace(CUBIC, amplitudes=())]))


def test_a_programme_is_chosen_for_what_it_reveals() -> None:
    """Whole runs are chosen by the chance to show an effect, within the certificate."""
    pattern = Experiment("pattern", duration=40.0, sample_time=0.5, constants={})
    hidden = CUBIC.with_values({"E_cubic": 10.0})
    found = design_programme(
        ship(),
        pattern,
        limits=LIMITS,
        rng=np.random.default_rng(0),
        criterion=Detect([hidden]),
        certainty=0.5,
        budget=Budget(n_runs=2),
        search=ProgrammeSearch(kinds=("zigzag",), n_draws=1, n_vehicles=2, n_rounds=0),
        knowledge=Knowledge(spread=0.1),
    )
    assert found.value <= found.bound + 1e-9
    (chance,) = found.chances
    assert chance.after > chance.before
    shifts = Shifts.of(found.model, [hidden])
    best = 0.0
    for run in found.candidates:
        told = RunInformation(found.model, shifts=shifts).matrix(run.experiment)
        assert told is not None
        left = told[3, 3] - told[3, :3] @ np.linalg.pinv(told[:3, :3]) @ told[:3, 3]
        best = max(best, float(left))
    assert chance.gain_after >= best * 0.999
    assert "cubic" in found.report()
