"""Terms proposed for what no known effect explains."""

from __future__ import annotations

import numpy as np
import pytest
from diving_plane import PROBLEM, records

from oed_sysid import Dataset, Input, Model, Output, Parameter, Record, State, load_problem
from oed_sysid.evidence.dictionary import Signal, Term, signals_along, terms
from oed_sysid.evidence.propose import propose, term_scores
from oed_sysid.evidence.residual_forces import let_in
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.text.units import same_dimension

VEHICLE = (
    Signal("u_r", "m/s", "motion", True),
    Signal("w_r", "m/s", "motion", False),
    Signal("q", "rad/s", "motion", False),
    Signal("theta", "rad", "angle", False),
    Signal("ds", "rad", "motion", False),
    Signal("T", "N", "thrust", True),
)
UNITS = {signal.name: signal.unit for signal in VEHICLE}


def test_dictionary_holds_what_engineers_write() -> None:
    """Drag, lift, damping, thrust and restoring terms are all there, each once per equation."""
    found = terms(PROBLEM.model, VEHICLE)
    texts = [term.expression for term in found if term.equation == "M"]
    assert len(set(texts)) == len(texts)
    for text in ("1", "abs(q)*q", "q**3", "u_r*w_r", "u_r**2*ds", "T", "q*T"):
        assert text in texts
    assert "sin(theta)*cos(theta)" in texts
    assert "abs(u_r)" not in texts
    assert 300 < len(found) < 500
    symbols = [term.symbol for term in found]
    assert len(set(symbols)) == len(symbols)


@pytest.mark.parametrize(
    ("equation", "expression", "factors", "text", "unit"),
    [
        ("M", "q**3", (("q", False),) * 3, "M_qqq q^3", "N m s^3"),
        ("Z", "abs(w_r)*w_r", (("w_r", True), ("w_r", False)), "Z_absww w|w|", "kg/m"),
        ("M", "q*T", (("q", False), ("T", False)), "M_qT q T", "m s"),
        ("M", "sin(theta)*cos(theta)", (), "M_sinthetacostheta sin(theta) cos(theta)", "N m"),
        ("X", "1", (), "X_0", "N"),
    ],
)
def test_terms_have_names_and_units(
    equation: str,
    expression: str,
    factors: tuple,
    text: str,
    unit: str,  # type: ignore[type-arg]
) -> None:
    """Names follow the notation where it reaches, units follow from dimensions."""
    term = Term(equation, expression, factors)
    assert term.text == text
    effect = term.effect(PROBLEM.model, UNITS, 1.0)
    assert same_dimension(effect.parameters[0].unit, unit)
    assert effect.terms[equation].endswith(expression) or expression == "1"
    assert PROBLEM.model + effect


def test_coefficients_get_another_name_where_theirs_is_taken() -> None:
    """A term whose derivative the model has already does not collide with it."""
    term = Term("M", "u_r*q", (("u_r", False), ("q", False)))
    assert term.effect(PROBLEM.model, UNITS, 1.0).parameters[0].name == "E_M_uq"


def test_scores_are_those_of_the_wider_model() -> None:
    """A term's statistic is what its column on a filter that holds it as a parameter gives."""
    train, _, _ = records(1, duration=20.0)
    term = Term("M", "abs(q)*q", (("q", True), ("q", False)))
    effect = term.effect(PROBLEM.model, UNITS, 1.0)
    study, fit = Study.begin(PROBLEM.model, train, None, (), known_noise=True)
    problem, unknowns = let_in(fit, study.unit)
    found = term_scores(problem, unknowns).scores
    score = next(s for s in found if s.term == term)
    model = problem.model + effect
    wide = Filtered(model, train, problem.levels)
    point = wide.point(fit.initial).unknowns
    matrix, right = wide.gathered(point, wide.passes(point))
    limits = wide.limits
    matrix = matrix + np.diag(limits.prior_weight)
    right = right + limits.prior_weight * (limits.prior_mean - point)
    at = wide.layout.free_names.index(effect.parameters[0].name)
    size = 1.0 / np.sqrt(np.diag(matrix))
    inverse = size[:, None] * np.linalg.inv(matrix * size[:, None] * size) * size
    # Terms are evaluated halfway between samples, and held over the step.
    assert score.std_error == pytest.approx(np.sqrt(inverse[at, at]), rel=0.03)
    assert score.estimate == pytest.approx(float(inverse[at] @ right), abs=0.05 * score.std_error)


def test_a_cubic_damping_is_proposed_with_its_value() -> None:
    """The true term comes first, in its equation, near its value, and removes the misfit."""
    train, _, _ = records(4, lambda u, w, q, *_: (0.0, 0.0, -250.0 * q**3), duration=45.0)
    study, fit = Study.begin(PROBLEM.model, train, None, (), known_noise=False)
    found = propose(study, fit, n_refits=4)
    assert found.best is not None
    assert found.best.term.equation == "M"
    assert "M_qqq q^3" in found.group
    cubic = next(p for p in found.proposals if p.term.text == "M_qqq q^3")
    assert cubic.effect.parameters[0].value == pytest.approx(-250.0, rel=0.15)
    assert PROBLEM.model + found.best.effect


def test_nothing_is_proposed_where_nothing_is_missing() -> None:
    """Noise alone gives no claim, however many terms are looked at."""
    train, _, _ = records(5, duration=40.0)
    study, fit = Study.begin(PROBLEM.model, train, None, (), known_noise=False)
    found = propose(study, fit, n_refits=3)
    assert found.best is None
    assert found.group == ()


def test_models_without_axes_have_a_dictionary() -> None:
    """An ordinary differential equation is searched in the rates that hold parameters."""
    model = Model(
        "roll",
        states=(State("phi", "rad"), State("p", "rad/s")),
        inputs=(Input("moment", "N m"),),
        outputs=(Output("phi", "rad", noise_std=0.001),),
        kinematics={"phi": "p", "p": "-b*p - k*phi + moment"},
        parameters=(Parameter("b", 0.1, "1/s"), Parameter("k", 1.0, "1/s^2")),
    )
    signals = (
        Signal("phi", "rad", "motion", False),
        Signal("p", "rad/s", "motion", False),
        Signal("moment", "N m", "motion", False),
    )
    found = terms(model, signals)
    assert {term.equation for term in found} == {"p"}
    damping = next(term for term in found if term.expression == "abs(p)*p")
    assert same_dimension(damping.effect(model, {"p": "rad/s"}, 1.0).parameters[0].unit, "1")


def test_a_heading_is_no_cause() -> None:
    """Signals of a steering model leave out the heading, on which nothing depends."""
    ship = load_problem("kvlcc2").model
    record = Record(
        "any",
        np.arange(5.0),
        np.linspace(0.0, 0.1, 5)[:, None],
        np.zeros((5, len(ship.outputs))),
        ship.channels,
    )
    states = np.linspace(0.0, 0.2, 5)[:, None] * np.ones(len(ship.states))
    named = {signal.name for signal in signals_along(ship, Dataset((record,)), [states]).signals}
    assert "r" in named
    assert "psi" not in named
