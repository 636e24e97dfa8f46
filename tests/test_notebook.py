"""Objects in a notebook: short texts, and HTML whose numbers are those of the objects."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from bs4 import BeautifulSoup
from starter import improved, starter

from oed_sysid import MultipleShooting, OedSysidError, check, compare
from oed_sysid.design import Search, Trial, design_experiment
from oed_sysid.results.page import notebook as html


@pytest.fixture(name="story", scope="module")
def _story() -> dict[str, object]:
    """One of each object, from the starter folder."""
    problem, train, test = starter()
    fit = MultipleShooting(noise="given", disturbances="none").fit(problem.model, train)
    design = design_experiment(
        problem.model,
        Trial(limits=problem.limits, duration=40.0, sample_time=1.0),
        rng=np.random.default_rng(0),
        search=Search(n_starts=1, n_candidates=3, n_steps=1),
    )
    return {
        "model": problem.model,
        "record": test.records[0],
        "dataset": train,
        "fit": fit,
        "comparison": compare(fit, test),
        "improvement": improved(),
        "design": design,
        "check": check(train, problem.model),
    }


def tables(thing: object) -> list[list[list[str]]]:
    """Cells of all tables of an object's HTML, which is whole."""
    text = thing._repr_html_()  # type: ignore[attr-defined]
    soup = BeautifulSoup(text, "html.parser")
    assert len(soup.find_all("div", class_="oed-sysid")) == 1
    for tag in ("table", "tr", "td", "div", "p"):
        assert text.count(f"<{tag}>") + text.count(f"<{tag} ") == text.count(f"</{tag}>"), tag
    return [
        [[c.get_text(strip=True) for c in row.find_all(["td", "th"])] for row in t.find_all("tr")]
        for t in soup.find_all("table")
    ]


NAMES = ("model", "record", "dataset", "fit", "comparison", "improvement", "design", "check")


@pytest.mark.parametrize("name", NAMES)
def test_short_text_is_one_line(name: str, story: dict[str, object]) -> None:
    """The repr of a result is one line that names its kind, and heads its HTML."""
    thing = story[name]
    assert re.fullmatch(r"<\w+ .{5,240}>", repr(thing))
    soup = BeautifulSoup(thing._repr_html_(), "html.parser")  # type: ignore[attr-defined]
    assert soup.find("b").get_text() == str(thing)


def test_fit_shows_values_with_their_errors(story: dict) -> None:
    """Estimates, their errors and residuals (angles in degrees) are those of the fit."""
    fit = story["fit"]
    estimates, intervals, residuals, *_ = tables(fit)
    for name, interval, *_ in intervals[1:]:
        ends = [float(end) for end in interval.split(" to ")]
        assert ends == pytest.approx(fit.interval(name), rel=0.01)
    for name, value, error, share, unit, _ in estimates[1:]:
        assert float(value) == pytest.approx(fit.values[name], abs=0.06 * fit.std_errors[name])
        assert float(error) == pytest.approx(fit.std_errors[name], rel=0.06)
        assert float(share) == pytest.approx(
            100 * fit.std_errors[name] / abs(fit.values[name]), rel=0.06
        )
        assert unit == fit.model.parameter(name).unit
    (psi,) = [row for row in residuals if row[0] == "psi"]
    assert float(psi[1]) == pytest.approx(np.degrees(fit.rms["psi"]), rel=0.01)
    assert psi[-1] == "deg"


def test_model_shows_typeset_equations(story: dict) -> None:
    """Every line of the equations is one line of LaTeX, with values in the table."""
    model = story["model"]
    soup = BeautifulSoup(model._repr_html_(), "html.parser")
    mathematics = soup.find("div", class_="oed-sysid").find("div").get_text()
    assert mathematics.startswith(r"$$\begin{aligned}")
    assert mathematics.count(r"\\ ") + 1 == len(model.equations().splitlines())
    assert r"\dot{\psi} &= r" in mathematics
    assert r"\frac{" in mathematics
    (table,) = tables(model)
    assert {row[0]: float(row[1]) for row in table[1:]} == pytest.approx(model.values, rel=1e-4)


def test_dataset_shows_spans_in_degrees(story: dict) -> None:
    """Length, samples and the range of each signal, angles in degrees."""
    dataset = story["dataset"]
    (table,) = tables(dataset)
    heads = table[0]
    for row, record in zip(table[1:], dataset, strict=True):
        cells = dict(zip(heads, row, strict=True))
        assert (cells["record"], int(cells["samples"])) == (record.name, record.n_samples)
        low, high = map(float, cells["psi [deg]"].split(" to "))
        psi = np.degrees(record.output("psi"))
        assert (low, high) == pytest.approx((np.nanmin(psi), np.nanmax(psi)), rel=0.01)


def test_comparison_and_improvement_show_errors(story: dict) -> None:
    """Errors on the validation records, in degrees and in units of the noise."""
    (table,) = tables(story["comparison"])
    part = story["comparison"].models[0]
    for row, one in zip(table[1:], part.outputs, strict=True):
        factor = np.degrees(1.0) if one.output.unit.startswith("rad") else 1.0
        assert float(row[1]) == pytest.approx(factor * one.rmse, rel=0.01)
        assert float(row[3]) == pytest.approx(one.relative, rel=0.01)
    found = story["improvement"]
    (table,) = [one for one in tables(found) if one[0][0] == "effect added"]
    assert table[2][0] == found.steps[0].added
    assert float(table[2][6]) == pytest.approx(found.final_error["test"], rel=5e-3)


def test_design_shows_expected_errors(story: dict) -> None:
    """Standard errors after the designed run, in per cent of the values."""
    design = story["design"]
    (table,) = tables(design)
    column = table[0].index("this run")
    for i, row in enumerate(table[1:]):
        expected = 100 * design.relative_errors[i]
        assert float(row[column].removesuffix("%")) == pytest.approx(expected, rel=0.06)


def test_text_of_users_is_escaped(story: dict, tmp_path: Path) -> None:
    """A name with markup in it is shown as text."""
    evil = story["record"].rename("<script>alert(1)</script>")
    assert "<script>" not in html(evil)
    assert "&lt;script&gt;" in html(evil)


def test_other_objects_are_refused() -> None:
    """What has no picture in a notebook is said so."""
    with pytest.raises(OedSysidError, match="A list has no picture"):
        html([])
