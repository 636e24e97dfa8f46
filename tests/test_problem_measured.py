"""Measured data: roll decay, tanks, Silverbox, drive and glider, as their READMEs describe."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from marks import MEASURED
from scipy.io import loadmat

from benchmarks.scoreboard import drive
from oed_sysid import Dataset, Fit, Model, MultipleShooting, Problem, compare, improve, load_problem
from oed_sysid.data.third_party import fetch
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.evidence.rank import rank
from oed_sysid.evidence.study import Study
from oed_sysid.information.shifts import GROUP_WIDTH
from oed_sysid.text.expressions import to_numpy

ESTIMATOR = MultipleShooting(disturbances="none")
pytestmark = MEASURED


@cache
def shipped(name: str, variant: str | None = None) -> tuple[Problem, Dataset, Dataset]:
    """A problem, its records to learn from, and those to judge by."""
    problem = load_problem(name, variant=variant)
    data = problem.data()
    return problem, *data.split(test=[one for one in data.names if one.startswith("test")])


def test_record_begins_after_the_release() -> None:
    """Crests fall from the first sample on, and no sample belongs to both parts."""
    _, train, test = shipped("roll_decay")
    phi = np.degrees(train[0].output("phi"))
    crests = [phi[i] for i in range(1, len(phi) - 1) if phi[i - 1] < phi[i] >= phi[i + 1]]
    assert 9.0 < max(crests) < 9.5
    assert np.all(np.diff(crests) <= 0.02)
    assert abs(np.degrees(test[0].outputs)).max() < 4.7


def test_hydrostatics_give_a_credible_inertia() -> None:
    """The radius of gyration, added inertia included, is 0.35 to 0.50 of the beam."""
    problem, train, _ = shipped("roll_decay")
    fit = ESTIMATOR.fit(problem.model, train)
    mass, beam = 312653.0 / 68.0**3 * 1000.0, 58.0 / 68.0
    assert 0.35 < np.sqrt(fit.values["I_xx"] / mass) / beam < 0.50


def test_quadratic_damping_as_published() -> None:
    """With linear stiffness the coefficient is the literature's 0.117 1/rad, within its error."""
    problem, train, _ = shipped("roll_decay")
    fit = ESTIMATOR.fit(problem.model + problem.effect("roll_quadratic_damping"), train)
    name = "E_roll_quadratic_damping"
    published = -problem.published["quadratic damping over inertia, 1/rad, 0 kn"]
    inertia = fit.values["I_xx"]
    assert abs(fit.values[name] / inertia - published) < 2 * fit.std_errors[name] / inertia


def test_saturated_readings_are_missing() -> None:
    """No reading at the end of the range is taken for a level, and each half has such ones."""
    for half in shipped("cascaded_tanks")[1:]:
        level = half[0].output("level")
        assert half[0].n_samples == 512
        assert 10 < np.isnan(level).sum() < 40
        assert np.nanmax(level) < 10.0


def test_gravity_outflow_leads_from_linear_to_square_root() -> None:
    """With amplitude 1 the lower tank's balance is that of square-root outflows."""
    problem = shipped("cascaded_tanks")[0]
    effect = problem.effect("gravity_outflow")
    scope = {**problem.model.values, "E_gravity": 1.0, "upper": 7.0, "lower": 2.0}
    scope |= {"drain_upper": 0.3, "drain_lower": 0.2}
    linear = 0.3 * 7.0 - 0.2 * 2.0
    root = 0.3 * np.sqrt(5.0 * 7.0) - 0.2 * np.sqrt(5.0 * 2.0)
    assert linear + to_numpy(effect.terms["lower"], scope) == pytest.approx(root)
    inside = {**scope, "E_gravity": 0.0}
    assert to_numpy(effect.terms["lower"], inside) == 0.0


@pytest.fixture(scope="module", params=[None, "torricelli"])
def tanks_improved(request: pytest.FixtureRequest) -> tuple[Improvement, Dataset]:
    """What is found from the linear model and from Torricelli's law, and the second half."""
    problem, train, test = shipped("cascaded_tanks", request.param)
    return improve(problem.model, train, test, candidates=problem.effects), test


@pytest.mark.slow
def test_the_error_falls_in_the_tanks(tanks_improved: tuple[Improvement, Dataset]) -> None:
    """One level hardly separates the candidates: the error falls, and more is left than noise."""
    found, test = tanks_improved
    names = [step.added for step in found.steps]
    assert "upper_overflow" in names
    assert len(set(names)) == len(names)
    check = compare({"before": found.base, "after": found.model}, test)
    before, after = (part.prediction.rms["level"] for part in check.models)
    # Nothing is called complete: no other signal tells whether the level jumped.
    assert found.remains.kind in ("structure missing", "not known")
    # Torricelli's law begins at half the error.
    assert after < (0.4 if "linear" in found.base.name else 0.45) * before


FINER = 4  # input values per measured output


def _error(fit: Fit, test: Dataset) -> float:
    """Error on validation samples in mV."""
    return 1e3 * fit.predict(test).rms["y"]


def test_finer_input_passes_through_the_samples() -> None:
    """Interpolated input has no power beyond 200 Hz, where the measured one has none either."""
    record = shipped("silverbox")[1][0]
    u = record.input("u")[: FINER * 1024] * np.hanning(FINER * 1024)
    power = np.abs(np.fft.rfft(u)) ** 2
    frequency = np.fft.rfftfreq(len(u), record.sample_time)
    assert power[frequency > 210.0].sum() < 1e-4 * power.sum()
    assert record.sample_time == pytest.approx(1.0 / (FINER * 610.3515625))
    assert np.isfinite(record.output("y")).sum() == 1500


def cubic() -> Model:
    """The model with cubic stiffness and an offset."""
    problem = shipped("silverbox")[0]
    return problem.model + [problem.effect(n) for n in ("cubic_stiffness", "constant_force")]


@pytest.fixture(scope="module")
def better() -> Fit:
    """Its fit."""
    return ESTIMATOR.fit(cubic(), shipped("silverbox")[1])


def test_hardening_spring_and_offset(better: Fit) -> None:
    """Cubic stiffness and an offset bring another realisation from 9 to below 0.4 mV."""
    problem, train, test = shipped("silverbox")
    assert _error(ESTIMATOR.fit(problem.model, train), test) > 8.0
    assert _error(better, test) < 0.4
    assert better.values["E_cubic_stiffness"] > 100 * better.std_errors["E_cubic_stiffness"]


def test_coarse_input_costs_accuracy(better: Fit) -> None:
    """With straight lines between the measured inputs the same model errs twice as much."""
    _, *data = shipped("silverbox")
    train, test = (Dataset((half[0].thin(FINER),)) for half in data)
    rough_error = _error(ESTIMATOR.fit(cubic(), train), test)
    assert rough_error > 2.0 * _error(better, data[1])


def test_cubic_stiffness_ranks_first() -> None:
    """Among springs, dampers, offsets and a lag the cubic spring explains most."""
    problem, train, _ = shipped("silverbox")
    study, fit = Study.begin(problem.model, train, None, problem.effects, known_noise=False)
    assert rank(study, fit, study.candidates).refits[0].name == "cubic_stiffness"


def test_force_of_the_drive_is_the_mean_of_its_samples() -> None:
    """Impulses of both halves are those of the original, and positions its own samples."""
    content = loadmat(str(fetch("emps/DATA_EMPS.mat")))
    force = float(content["gtau"][0, 0]) * np.ravel(content["vir"])
    first, second = shipped("positioning_drive")[0].data()
    assert first.n_samples == second.n_samples == 1242
    joined = np.concatenate([first.inputs[:, 0], second.inputs[:, 0]])
    assert joined.sum() * 0.01 == pytest.approx(force[:24840].sum() * 0.001)
    assert second.outputs[0, 0] == np.ravel(content["qm"])[12420]


def test_odds_of_two_claims_count_independent_samples() -> None:
    """Correlated innovations let two statistics differ by less, not by more."""
    problem, train, _ = shipped("positioning_drive")
    study, fit = Study.begin(
        problem.model, train, None, problem.effects, known_noise=False, disturbances="none"
    )
    found = rank(study, fit, study.candidates)
    best, other = found.refits[:2]
    full, quarter = found.error(best, other), found.error(best, other, 0.25)
    assert quarter in (pytest.approx(GROUP_WIDTH), pytest.approx(0.5 * full))


@pytest.mark.slow
def test_dry_friction_and_offset_are_found_and_nothing_else() -> None:
    """The four parameters of the authors are in their intervals, whole runs as good as theirs."""
    problem, train, test = shipped("positioning_drive")
    found = improve(problem.model, train, test, candidates=problem.effects)
    assert {step.added for step in found.steps} == {"offset", "coulomb_friction"}
    authors = {"m": 95.1, "X_v": -203.5, "E_coulomb_friction": 20.4, "X_0": 3.16}
    for name, value in authors.items():
        low, high = found.fit.interval(name)
        assert low < value < high
    force, position = (signal[12420:24840] for signal in drive.original(fetch(drive.ORIGINAL)))
    theirs = drive.error(drive.AUTHORS, force, position)
    assert found.fit.predict(test).rms["x"] < 1.1 * theirs


def test_records_are_dives() -> None:
    """Eleven dives, irregular in time, each with a speed at once and on the way down only."""
    _, train, test = shipped("slocum_glider")
    assert (len(train), len(test)) == (3, 8)
    for record in (*train, *test):
        speed, pitch = record.output("speed"), record.input("pitch")
        measured = np.isfinite(speed)
        assert measured[0]
        assert 200 < measured.sum() < 250
        assert np.all(pitch[measured] < 0.01)
        assert np.diff(record.times).max() < 10.0
        assert not record.is_uniform


def test_inertia_at_one_is_the_published_mass() -> None:
    """Amplitude 1 makes mass and added mass as published, the settling mass included."""
    terms = shipped("slocum_glider")[0].effect("inertia").terms
    values = {
        "E_inertia": 1.0, "m_g": 70.0, "m_settle": 14.0, "k_along": 0.2, "k_across": 0.98
    }  # fmt: skip
    for theta in (-0.4, 0.0, 0.7):
        scope = {**values, "theta": theta}
        horizontal, vertical, coupled = (
            to_numpy(terms[key], scope) for key in (("X", "u"), ("Z", "w"), ("X", "w"))
        )
        matrix = np.array([[horizontal + 14.0, coupled], [coupled, vertical + 14.0]])
        expected = np.array([70.0 * 1.2, 70.0 * 1.98])
        assert np.linalg.eigvalsh(matrix) == pytest.approx(expected)


@pytest.mark.slow
def test_published_model_is_recovered() -> None:
    """Drag and mass agree with the literature, and inertia halves the error of speed."""
    problem, train, test = shipped("slocum_glider")
    steady, published = problem.variant("corrected_pitch").model, problem.published
    moving = (steady + problem.effect("inertia")).with_values({"E_inertia": 1.0})
    before, after = (ESTIMATOR.fit(one, train) for one in (steady, moving.fix("E_inertia")))
    assert before.status.ok
    assert after.status.ok
    assert after.values["C_D0"] == pytest.approx(published["C_D0, dynamic"], abs=0.004)
    assert after.values["m_g"] == pytest.approx(published["m_g, dynamic, kg"], abs=0.02)
    errors = [fit.predict(test).rms["speed"] for fit in (before, after)]
    assert errors[1] < 0.0125
    assert errors[0] > 1.6 * errors[1]


def test_pitch_scale_agrees_with_the_authors() -> None:
    """From the logged pitch the scale comes out as the correction that the authors applied."""
    problem, train, _ = shipped("slocum_glider")
    effects = [problem.effect("inertia"), problem.effect("pitch_scale")]
    fit = ESTIMATOR.fit(problem.model + effects, train)
    difference = fit.values["E_pitch_scale"] - (0.86 - 1.0)
    assert abs(difference) < 2 * fit.std_errors["E_pitch_scale"] < 0.05


@pytest.mark.slow
def test_inertia_is_found_first() -> None:
    """Among eleven candidates inertia explains most, and the validation dives agree.

    Disturbance forces that last as long as a dive would explain what inertia does.
    """
    problem, *data = shipped("slocum_glider")
    found = improve(
        problem.model, *data, candidates=problem.effects, max_effects=1, disturbances="none"
    )
    assert [step.added for step in found.steps] == ["inertia"]
    assert found.steps[0].claim.validation > 0
