"""Fits that earlier versions have saved."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import oed_sysid
from oed_sysid import Fit
from oed_sysid.errors import DataError

FOLDER = Path(__file__).parent / "saved_fits"
OLD = FOLDER / "nomoto_format_1.json"


@pytest.fixture
def old() -> Fit:
    """The fit, loaded by this version."""
    return Fit.load(OLD)


@pytest.fixture
def numbers() -> dict[str, Any]:
    """What the version that made it said."""
    return json.loads((FOLDER / "nomoto_format_1_numbers.json").read_text(encoding="utf-8"))


def test_the_file_is_an_old_one() -> None:
    """None of the later fields is in the file, so that the test means something."""
    fields = json.loads(OLD.read_text(encoding="utf-8"))["fit"]["fields"]
    assert not fields.keys() & {"noise", "noise_std", "innovations", "start_states"}


def test_numbers_and_report_are_those_of_the_time(old: Fit, numbers: dict[str, Any]) -> None:
    """Values, errors, likelihood and every line of the report are the same."""
    assert old.values == numbers["values"]
    assert old.std_errors == pytest.approx(numbers["std_errors"], rel=1e-12)
    assert old.log_likelihood == pytest.approx(numbers["log_likelihood"], rel=1e-12)
    assert old.aic == pytest.approx(numbers["aic"], rel=1e-12)
    assert old.n_unknowns == numbers["n_unknowns"]
    assert old.rms == pytest.approx(numbers["rms"], rel=1e-12)
    angles = {}
    since = ("one step", "whole runs")
    lines = [line for line in old.report().splitlines() if not line.strip().startswith(since)]
    for now, then in zip(lines, numbers["report"].splitlines(), strict=True):
        output = then.split()[:1]
        if then.endswith(("  rad", "rad/s")) and output[0] in old.model.output_names:
            # Angles were printed in radians then, and are in degrees now.
            angles[output[0]] = [
                (float(a), float(b))
                for a, b in zip(now.split()[1:3], then.split()[1:3], strict=True)
            ]
            assert now.split()[3:] == then.replace("rad", "deg").split()[3:]
        elif output != ["output"]:
            assert now.strip() == then.strip()
    assert set(angles) == {"psi", "r"}
    for degrees, radians in (pair for pairs in angles.values() for pair in pairs):
        assert degrees == pytest.approx(np.degrees(radians), rel=0.01)


def test_what_is_new_has_a_meaning_for_it(old: Fit, tmp_path: Path) -> None:
    """It has white noise and free start states, predicts, and is saved in today's form."""
    assert old.noise is not None
    assert old.noise.is_white
    assert old.noise.white == pytest.approx(old.sigma)
    assert old.start_states == ()
    assert not any(p.log for p in old.model.all_parameters)
    assert old.model.integrator == "explicit"
    prediction = old.predict(old.dataset)
    for found, stored in zip(prediction.outputs, old.predictions, strict=True):
        assert np.abs((found - stored) / old.sigma).max() < 0.5
    old.save(tmp_path / "again.json")
    assert Fit.load(tmp_path / "again.json").report() == old.report()


def test_what_was_told_in_extras_is_typed_now(tmp_path: Path) -> None:
    """Entries of ``extras`` that decided something in version 0.1 are fields; others stay."""
    content = json.loads(OLD.read_text(encoding="utf-8"))
    pair = {"tuple": [3, 900]}
    told = {
        "magnitudes": {"mapping": [["K", 1.0]]},
        "nominal": {"mapping": [["K", 0.05]]},
        "excluded": {"mapping": [["psi", pair]]},
        "disturbance_test": 31.0,
        "process_noise_failed": "stalled",
        "white_delay": {"tuple": ["psi", "output", 0.4, 0.1]},
        "white_starts": {"tuple": [{"tuple": ["rudder", "delta", "a", 0.1, 0.02, 0.5]}]},
        "captive": {"mapping": [["Y", 0.02]]},
        "captive_misfit": {"mapping": [["Y", 1.1]]},
        "tests_scatter": True,
        "horizon": 10.0,
        "windows": 12,
        "history": {"tuple": [1.0, 2.0]},
    }
    content["fit"]["fields"]["extras"] = {"mapping": [[k, v] for k, v in told.items()]}
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    fit = Fit.load(path)
    assert (fit.nominal, fit.excluded) == ({"K": 0.05}, {"psi": (3, 900)})
    test = fit.process_noise
    assert test is not None
    assert (test.statistic, test.failed) == (31.0, "stalled")
    assert (test.delay.signal, test.delay.seconds) == ("psi", 0.4)
    assert [one.effect for one in test.actuator_starts] == ["rudder"]
    assert (fit.captive.relative, fit.captive.in_noise) == ({"Y": 0.02}, {"Y": 1.1})
    assert (fit.tests_scatter, fit.horizon, fit.n_windows) == (True, 10.0, 12)
    assert fit.extras == {"history": (1.0, 2.0)}
    assert "3 of 900 samples of psi excluded" in fit.report()
    fit.save(tmp_path / "again.json")
    again = Fit.load(tmp_path / "again.json")
    assert again.process_noise.actuator_starts == test.actuator_starts
    assert again.report() == fit.report()


def test_nothing_is_decided_by_extras() -> None:
    """Only estimators write ``extras``; no other module of the package reads them."""
    package = Path(oed_sysid.__file__).parent
    readers = [
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if ".extras" in path.read_text(encoding="utf-8")
    ]
    assert readers == []


@pytest.mark.parametrize(
    ("change", "words"), [("add", "does not know"), ("remove", "make it again")]
)
def test_what_cannot_be_read_says_what_to_do(tmp_path: Path, change: str, words: str) -> None:
    """Unknown fields are those of a newer version; missing ones without default need a new fit."""
    content = json.loads(OLD.read_text(encoding="utf-8"))
    if change == "add":
        content["fit"]["fields"]["colour_of_the_ship"] = "red"
    else:
        del content["fit"]["fields"]["covariance"]
    (tmp_path / "fit.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(DataError, match=words):
        Fit.load(tmp_path / "fit.json")
