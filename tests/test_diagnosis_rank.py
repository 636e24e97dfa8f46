"""Ranking of candidates, diagnosis without refits, shapes of missing terms, and advice."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from golden_cases import diagnosed_diver

from oed_sysid import (
    Dataset,
    Force,
    Model,
    Output,
    Parameter,
    Record,
    State,
    load_problem,
)
from oed_sysid.compiled.kernels import kernel
from oed_sysid.evidence.improve import improve
from oed_sysid.evidence.improvement import advice
from oed_sysid.evidence.rank import Ranking
from oed_sysid.evidence.score import Score


def score(name: str, statistic: float, signature: np.ndarray) -> Score:
    """Score of a candidate with one amplitude."""
    effect = Force(name, {"X": f"E_{name}"}, (Parameter(f"E_{name}", 0.0, "N", scale=1.0),))
    amplitude = {f"E_{name}": 1.0}
    return Score(effect, statistic, 1, amplitude, amplitude, 0.5, signature[:, np.newaxis])


def test_a_candidate_that_was_not_refitted_joins_the_group_if_its_signature_is_the_same() -> None:
    """At a correlation of 0.995 two effects are one to the records; at 0.8 they are not."""
    rng = np.random.default_rng(0)
    first, other = np.linalg.qr(rng.standard_normal((200, 2)))[0].T
    ranking = Ranking(
        (
            score("drag", 40.0, first),
            score("alike", 39.0, -3.0 * (0.995 * first + np.sqrt(1 - 0.995**2) * other)),
            score("related", 30.0, 0.8 * first + 0.6 * other),
            score("absorbed", 0.0, 0.0 * first),
        ),
        (),
        first,
    )
    assert ranking.alike("drag") == ("alike",)
    assert set(ranking.alike("drag", 0.5)) == {"alike", "related"}


def test_the_hidden_effect_of_the_shipped_records_leads() -> None:
    """On the shipped records the heave equation is accused and its cross-flow drag leads."""
    model, found = load_problem("remus_diving_plane").model, diagnosed_diver()
    assert found.best is not None
    assert found.best.name == "heave_crossflow_drag"
    assert found.group == ("heave_crossflow_drag",)
    assert found.location.best == "force Z"
    assert model.effect_names == (model + found.best).effect_names[:-1]
    assert json.loads(json.dumps(found.to_dict()))["ranking"][0]["effect"] == found.best.name
    assert "heave_crossflow_drag" in found.report()


@pytest.mark.parametrize("brim", [1.0, 5.0], ids=["near", "above every level"])
def test_several_shapes_are_estimated_from_their_own_values(brim: float) -> None:
    """Every shape is looked for over its bounds, even where the given value shows nothing."""
    tank = Model(
        "tanks",
        states=(State("upper", "m"), State("lower", "m")),
        inputs=(),
        outputs=(Output("upper", "m"), Output("lower", "m")),
        kinematics={"upper": "-drain*upper", "lower": "drain*upper - drain*lower"},
        parameters=(Parameter("drain", 0.4, "1/s"),),
    )
    overflow = Force(
        "overflow",
        {
            "upper": "-E_overflow*max(upper - brim, 0)",
            "lower": "E_overflow*share*max(upper - brim, 0)",
        },
        (
            Parameter("E_overflow", 0.0, "1/s", lower=0.0, upper=2.0, scale=0.1),
            Parameter("share", 0.5, "1", lower=0.0, upper=1.0),
            Parameter("brim", brim, "m", lower=0.5, upper=6.0),
        ),
        amplitudes=("E_overflow",),
    )
    true = (tank + overflow).with_values({"E_overflow": 0.5, "share": 0.7, "brim": 1.0})
    times = np.arange(0.0, 10.0, 0.1)
    values, own = true.value_vector, np.array([3.0, 0.5])
    runner = kernel(true)
    inputs = np.zeros((times.size, 0))
    start = runner.start(own, inputs[0], values, 0.0)[0]
    clean = runner.run(times, inputs, values, start).outputs
    noisy = clean + 0.002 * np.random.default_rng(2).standard_normal(clean.shape)
    data = Dataset((Record("drain", times, inputs, noisy, tank.channels),))
    found = improve(tank, data, candidates=(overflow,))
    assert [step.added for step in found.steps] == ["overflow"]
    assert abs(found.model.values["share"] - 0.7) < 0.1
    assert abs(found.model.values["brim"] - 1.0) < 0.1


def candidate(name: str, needs: str, error: float) -> Score:
    """Score of a candidate of typical size one whose error in these records is given."""
    parameter = Parameter(f"E_{name}", 0.0, "N", scale=1.0)
    effect = Force(name, {"X": f"E_{name}"}, (parameter,), needs=needs)
    key = parameter.name
    return Score(effect, 1.0, 1, {key: 0.0}, {key: error}, 0.5, np.ones((3, 1)))


RANKING = Ranking(
    (
        candidate("drag", "coasting", 0.01),
        candidate("bias", "several speeds", 0.01),
        candidate("faint", "storms", 5.0),
    ),
    (),
    np.ones(3),
)
ESTIMATES = ({"name": "E_drag", "value": 2.0, "std_error": 0.1, "unit": "N"},)


def step(*group: str, test_gain: float = 9.0, test_error: float = 1.0) -> SimpleNamespace:
    """A step as far as the advice looks at it."""
    effect = next(s.effect for s in RANKING.scores if s.effect.name == group[0])
    return SimpleNamespace(
        added=group[0],
        group=group,
        effect=effect,
        test_gain=test_gain,
        test_error=test_error,
        fit=None,
    )


def test_one_effect_is_believed_with_its_size() -> None:
    """A single confirmed effect is stated with value and error; what is invisible is not denied."""
    text = "\n".join(advice([step("drag")], RANKING, ESTIMATES, explained=True))
    assert "drag is missing, the validation records agree: E_drag = 2.00 ± 0.20 N (95 %)" in text
    assert "that faint is absent: its typical" in text
    assert "Next at sea" not in text


def test_a_group_is_not_believed_to_be_its_first_member() -> None:
    """Rivals are named, with the manoeuvres that they need and the command that designs one."""
    text = "\n".join(advice([step("drag", "bias")], RANKING, ESTIMATES, explained=False))
    assert "drag or bias is missing" in text
    assert "that it is drag (E_drag = 2.00 ± 0.20 N (95 %)): bias does as well" in text
    assert "coasting; several speeds" in text
    assert "--discriminate drag bias" in text
    assert "more is missing than was found" in text


def test_an_untested_claim_is_not_believed() -> None:
    """Without validation records the claim waits for one."""
    text = "\n".join(advice([step("drag", test_gain=np.nan)], RANKING, ESTIMATES, explained=True))
    assert "validation records agree" not in text
    assert "drag before a validation record has confirmed it" in text


def test_a_claim_beside_a_rising_error_is_doubted() -> None:
    """Only the step with which validation runs become worse is named, and sizes without errors."""
    estimates = ({"name": "E_drag", "value": 2.0, "std_error": np.inf, "unit": "N"},)
    steps = [step("drag", test_error=1.5), step("faint", test_error=0.9)]
    lines = advice(steps, RANKING, estimates, explained=True, before=1.2)
    doubted = [line for line in lines if "alone" in line]
    assert len(doubted) == 1
    assert "drag" in doubted[0]
    assert any("size of E_drag" in line for line in lines)
    assert not any("inf" in line for line in lines)


@pytest.mark.parametrize(("std_error", "told"), [(0.1, True), (30.0, True), (60.0, False)])
def test_a_size_that_may_be_anything_is_not_stated(std_error: float, told: bool) -> None:
    """An interval of more than a hundred typical sizes is no size; nor one beyond all bounds."""
    row = {"name": "E_drag", "value": 2.0, "std_error": std_error, "unit": "N"}
    lines = advice([step("drag")], RANKING, (row,), explained=True)
    assert any("size of E_drag" in line for line in lines) != told
    bounded = replace(step("drag").effect.parameters[0], lower=0.0, upper=3.0)
    effect = replace(step("drag").effect, parameters=(bounded,))
    claim = SimpleNamespace(**{**vars(step("drag")), "effect": effect})
    lines = advice([claim], RANKING, (row,), explained=True)
    assert any("size of E_drag" in line for line in lines) == (std_error > 1.0)


def test_nothing_is_believed_of_a_log_that_contradicts_itself() -> None:
    """What was found is listed under a condition, and there is no list of what to believe."""
    lines = advice([step("drag")], RANKING, ESTIMATES, explained=False, suspect=True)
    titles = [line for line in lines if not line.startswith(" ")]
    assert titles[0] != advice([step("drag")], RANKING, ESTIMATES, explained=False)[0]
    assert "Believe:" not in titles
    assert any("drag is missing" in line for line in lines)


def test_what_shows_in_one_amplitude_is_not_said_to_be_invisible() -> None:
    """Of two amplitudes one is known to a hundredth of its size, the other not at all."""
    sizes = tuple(Parameter(name, 0.0, "N", scale=1.0) for name in ("E_along", "E_across"))
    effect = Force("wind", {"X": "E_along", "Y": "E_across"}, sizes)

    def of(across: float, along: float) -> Score:
        errors = {"E_along": along, "E_across": across}
        return Score(effect, 1.0, 2, dict.fromkeys(errors, 0.0), errors, 0.5, np.ones((3, 2)))

    assert not Ranking((of(9.0, 0.01),), (), np.ones(3)).undetectable()
    assert set(Ranking((of(9.0, 9.0),), (), np.ones(3)).undetectable()) == {"wind"}


def test_what_would_not_show_is_asked_of_the_last_round() -> None:
    """Beside the nominal model the wind would not show; beside the better one it would."""
    first = Ranking((candidate("wind", "", 9.0),), (), np.ones(3))
    last = Ranking((candidate("wind", "", 0.01),), (), np.ones(3))
    assert set(first.undetectable()) == {"wind"}
    assert len(advice((), first, (), explained=True)) == 2  # a title and a line
    assert not advice((), first, (), explained=True, last=last)


def test_what_free_parameters_do_is_named_apart() -> None:
    """An effect whose signature the parameters imitate is not one that would not show."""
    wind, same = candidate("wind", "", 9.0), candidate("same", "", np.inf)
    ranking = Ranking((wind, replace(same, distinct=0.0)), (), np.ones(3))
    assert ranking.imitated() == ("same",)
    _, unseen, imitated = advice((), ranking, (), explained=True)
    assert ("wind" in unseen, "same" in unseen) == (True, False)
    assert ("wind" in imitated, "same" in imitated) == (False, True)


@pytest.mark.parametrize(("std_error", "doubted"), [(0.1, 0), (1.5, 1)])
def test_a_claim_whose_interval_holds_zero_is_doubted(std_error: float, doubted: int) -> None:
    """Correlated residuals widen the interval after the likelihood has spoken."""
    row = {"name": "E_drag", "value": 2.0, "std_error": std_error, "unit": "N"}
    lines = advice([step("drag")], RANKING, (row,), explained=True)
    told = lines[lines.index("Do not believe:") :] if "Do not believe:" in lines else []
    assert sum("drag" in line for line in told) == doubted
