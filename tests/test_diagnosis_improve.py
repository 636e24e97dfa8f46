"""Score test, refits and the improvement loop on ships whose truth is known."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from golden_cases import improved_diver
from scipy import stats
from turning_ship import CANDIDATES, CUBIC, SHIP, dataset
from turning_ship import improved as improved_ship

from oed_sysid import Dataset, load_problem, read_csv
from oed_sysid.errors import OedSysidError
from oed_sysid.evidence.improve import improve
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.evidence.rank import rank, threshold
from oed_sysid.evidence.score import scores
from oed_sysid.evidence.study import Study


def test_score_is_chi_squared_where_nothing_is_missing() -> None:
    """Over seeds, the statistic of an absent effect follows its distribution."""
    statistics = []
    for seed in range(30):
        study, fit = Study.begin(SHIP, dataset(seed), None, [CUBIC], known_noise=True)
        found, _ = scores(study, fit, study.candidates)
        statistics.append(found[0].statistic)
    assert stats.kstest(statistics, stats.chi2(1).cdf).pvalue > 0.002
    assert np.mean(statistics) == pytest.approx(1.0, abs=0.8)


@pytest.mark.parametrize("cubic", [-0.2, -0.5])
def test_score_is_the_likelihood_gain_to_first_order(cubic: float) -> None:
    """For a weak effect the statistic is what refitting gains, and the estimate is the refit's."""
    study, fit = Study.begin(SHIP, dataset(7, cubic), None, CANDIDATES, known_noise=True)
    ranking = rank(study, fit, study.candidates, also=["cubic_damping"])
    refit = next(r for r in ranking.refits if r.name == "cubic_damping")
    assert refit.score.statistic == pytest.approx(refit.gain, rel=0.2, abs=0.3)
    error = refit.score.std_errors["n3"]
    assert refit.score.estimate["n3"] == pytest.approx(refit.fit.values["n3"], abs=error)


def test_threshold_pays_for_the_number_of_candidates() -> None:
    """The gain that chance reaches rarely is the quantile corrected for all candidates."""
    assert stats.chi2(2).sf(threshold(50, 2, 0.01)) == pytest.approx(0.01 / 50)


def test_hidden_damping_is_found_and_explains_the_records() -> None:
    """Cubic damping is added, the error falls to the noise, and its value covers the truth."""
    found = improved_ship()
    assert [step.added for step in found.steps] == ["cubic_damping"]
    assert found.base_error["test"] > 1.1
    assert found.final_error["test"] == pytest.approx(1.0, abs=0.06)
    row = next(row for row in found.parameters if row["name"] == "n3")
    assert abs(row["value"] + 15.0) < 4 * row["std_error"]
    assert found.model.effect_names == ("cubic_damping",)
    assert SHIP.effect_names == ()


@pytest.mark.parametrize(
    ("seed", "force"),
    [
        (20, 0.0),
        (22, 0.02),
        *(pytest.param(*more, marks=pytest.mark.slow) for more in ((21, 0.0), (23, 0.02))),
    ],
)
def test_nothing_is_claimed_where_nothing_is_missing(seed: int, force: float) -> None:
    """A right model stays as it is, under white noise and under disturbance forces."""
    train, validation = (dataset(one, force=force) for one in (seed, seed + 50))
    assert improve(SHIP, train, validation, candidates=CANDIDATES).verdict == "nothing_missing"


def test_forces_act_only_where_they_are_let_in() -> None:
    """Levels of forces that are ruled out stay zero; places named are estimated."""
    levels = {}
    for asked in ("auto", "none", "r"):
        _, fit = Study.begin(
            SHIP, dataset(22, force=0.02), None, CANDIDATES, known_noise=True, disturbances=asked
        )
        levels[asked] = dict(zip(fit.noise.places, fit.noise.force, strict=True))
    assert levels["none"]["force r"] == 0
    assert levels["auto"]["force r"] == pytest.approx(0.02, rel=0.4)
    assert levels["r"] == levels["auto"]
    _, fit = Study.begin(
        SHIP, dataset(22, force=0.02), None, CANDIDATES, known_noise=True, disturbances=("psi",)
    )
    named = dict(zip(fit.noise.places, fit.noise.force, strict=True))
    assert named["force r"] == 0
    assert named["kinematics psi"] > 0


def test_a_misfit_without_a_claim_is_not_nothing() -> None:
    """A yaw rate of the other sign: nothing is claimed, and nothing is certified either."""
    spoilt = [
        Dataset([replace(r, outputs=r.outputs * [1.0, -1.0]) for r in dataset(seed)])
        for seed in (11, 12)
    ]
    found = improve(SHIP, *spoilt, candidates=CANDIDATES)
    assert found.steps == ()
    assert found.final_error["test"] > 10
    assert found.verdict == "unexplained"


def test_correlation_time_of_sensor_noise_is_found() -> None:
    """Noise that remembers for two seconds is seen as such, and nothing is claimed from it."""
    found = [dataset(seed, colour=0.9) for seed in (30, 31)]
    _, fit = Study.begin(SHIP, found[0], found[1], CANDIDATES, known_noise=False)
    truth = -0.2 / np.log(0.9)
    assert np.all((truth / 2 < fit.noise.colour_time) & (fit.noise.colour_time < truth * 2))
    np.testing.assert_allclose(fit.noise.colour, [0.01, 0.004], rtol=0.3)
    improved = improve(SHIP, *found, candidates=CANDIDATES)
    assert improved.verdict == "nothing_missing"
    assert improved.explained
    assert "correlated over about" in improved.report().splitlines()[-1]


@pytest.fixture(scope="module")
def auv() -> Improvement:
    """The shipped hidden-effect records: drag in heave, quadratic in the relative velocity."""
    return improved_diver()


def test_shipped_auv_lacks_crossflow_drag(auv: Improvement) -> None:
    """The effect is found alone, with its value, and the rest is noise."""
    assert auv.verdict == "missing"
    assert [step.added for step in auv.steps] == ["heave_crossflow_drag"]
    assert auv.steps[0].group == ("heave_crossflow_drag",)
    assert auv.explained
    assert auv.base_error["test"] > 2.0
    assert auv.final_error["test"] == pytest.approx(1.0, abs=0.05)
    row = next(r for r in auv.parameters if r["name"] == "E_heave_crossflow_drag")
    # True value of the simulation, see the data's README.
    assert abs(row["value"] + 101.46) < 4 * row["std_error"]


def test_steps_can_be_undone(auv: Improvement) -> None:
    """The model after any number of steps can be had: none is the believed one, all the final."""
    assert auv.at_step(0) == auv.base == auv.at_step(-1)
    final = auv.at_step(1)
    assert final.effect_names == auv.model.effect_names
    assert final.values == pytest.approx(auv.model.values)


HIDDEN = Path(os.environ.get("OED_SYSID_DATA", "")) / "hidden_effects"
given = pytest.mark.skipif(not (HIDDEN / "case_013").is_dir(), reason="other records are not here")


def improved(case: str) -> Improvement:
    """The believed AUV improved on the records of one given case."""
    problem = load_problem("remus_diving_plane")
    train, test = (
        read_csv(sorted((HIDDEN / case).glob(f"{part}*.csv")), problem.channels)
        for part in ("train", "test")
    )
    return improve(problem.model, train, test, candidates=problem.effects)


@given
@pytest.mark.slow
def test_a_term_is_proposed_where_no_known_effect_is_right() -> None:
    """Cubic pitch damping, which no candidate holds, is proposed with its value and unit."""
    found = improved("case_013")
    assert [step.added for step in found.steps] == ["term_M_qqq"]
    term = found.proposed[0]
    assert (term["expression"], term["equation"], term["unit"]) == ("q**3", "M", "kg m^2 s")
    # True value of the simulation, see the records' README.
    assert term["value"] == pytest.approx(-267.9, rel=0.05)
    assert "pitch_quadratic_damping" in term["replaces"]
    assert found.final_error["test"] == pytest.approx(1.0, abs=0.05)


@given
@pytest.mark.slow
@pytest.mark.parametrize("number", range(13))
def test_given_cases_get_the_right_story(number: int) -> None:
    """What is added is what was hidden, and nothing else."""
    truth = json.loads((HIDDEN / "answers.json").read_text(encoding="utf-8"))[number]
    found = improved(truth["case"])
    assert {step.added for step in found.steps} == set(truth["hidden_effects"])
    assert found.explained


def test_improvement_as_plain_data(auv: Improvement) -> None:
    """The dictionary has its documented keys, and JSON takes it."""
    plain = auv.to_dict()
    assert set(plain) == {
        "verdict",
        "steps",
        "ranking",
        "located",
        "base_error",
        "final_error",
        "proposed_terms",
        "remains",
        "conclusion",
        "noise",
        "notes",
        "parameters",
        "decisions",
    }
    step = plain["steps"][0]
    assert {"added", "group", "gain", "test_gain", "statistic", "needed"} <= set(step)
    assert step["statistic"] == pytest.approx(step["gain"] + step["test_gain"])
    assert {"name", "training", "validation", "needed", "before", "after"} <= set(
        plain["decisions"][0]
    )
    assert set(plain["ranking"][0]) == {"effect", "statistic"}
    assert plain["ranking"][0]["effect"] == "heave_crossflow_drag"
    assert len(plain["ranking"]) == len(load_problem("remus_diving_plane").effects)
    assert set(plain["base_error"]) == set(plain["final_error"]) == {"train", "test"}
    assert set(plain["parameters"][0]) == {"name", "value", "std_error", "unit"}
    assert json.loads(json.dumps(plain))["verdict"] == "missing"


def test_improvement_tells_its_story(auv: Improvement) -> None:
    """The report names the effect, the errors and the verdict."""
    text = auv.report()
    assert "heave_crossflow_drag" in text
    assert "noise" in text.splitlines()[-1] or "Verdict" in text


def test_what_was_found_stays_where_a_later_stage_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second ranking breaks off: the effect of the first is kept, and the reason is told."""
    calls = []

    def ranked(*args: object, **settings: object) -> object:
        calls.append(1)
        if len(calls) == 2:
            raise OedSysidError("a stage that fails")
        return rank(*args, **settings)

    monkeypatch.setattr("oed_sysid.evidence.search.rank", ranked)
    found = improve(SHIP, dataset(11, -15.0), dataset(12, -15.0), candidates=CANDIDATES)
    assert [step.added for step in found.steps] == ["cubic_damping"]
    assert any("a stage that fails" in note for note in found.notes)
