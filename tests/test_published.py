"""What docs/published.md says beyond the problems' own tests, and that what it cites exists."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from oed_sysid import Dataset, Record, load_problem
from oed_sysid.data.reconstruction import reconstruct
from oed_sysid.estimators import HeadingDifferences, MultipleShooting
from oed_sysid.simulation import simulate, simulate_inputs

ROOT = Path(__file__).resolve().parent.parent


def cited() -> list[tuple[str, str]]:
    """File and name of every test that the document cites; '::name' is in the file before."""
    text = (ROOT / "docs" / "published.md").read_text(encoding="utf-8")
    found, file = [], ""
    for name, test in re.findall(r"`(test_\w+\.py)?::(test_\w+)`", text):
        file = name or file
        found.append((file, test))
    return found


@pytest.mark.parametrize(("file", "test"), cited())
def test_cited_tests_exist(file: str, test: str) -> None:
    """Every line of the table can be run."""
    assert f"def {test}(" in (ROOT / "tests" / file).read_text(encoding="utf-8")


def test_headings_against_the_truth() -> None:
    """Errors of K and T against the truth, and predictions, of sparse headings and curves."""
    problem = load_problem("nomoto_sparse_heading")
    record = simulate(problem.model, problem.experiment("zigzag_15_15"), noise=False)
    truth = np.array([problem.truth["K"], problem.truth["T"]])
    sparse = record.thin(50)

    def errors(one: Record) -> tuple[float, float, float]:
        fit = HeadingDifferences().fit(problem.model, Dataset((one,)))
        values = np.array([fit.values["K"], fit.values["T"]])
        run = simulate_inputs(fit.model, record.times, inputs=record.inputs)
        gain, time_constant = 100 * (values / truth - 1)
        return gain, time_constant, float(np.sqrt(np.mean((run.outputs - record.outputs) ** 2)))

    fine, spiral = errors(record.thin(10)), errors(reconstruct(sparse, 5, method="spiral"))
    assert fine[:2] == pytest.approx((-2.3, -18.1), abs=0.06)
    assert spiral == pytest.approx((0.31, -18.2, 0.0215), abs=0.01)
    assert spiral[2] == pytest.approx(0.0215, abs=1e-4)
    assert errors(reconstruct(sparse, 5, method="cubic"))[2] == pytest.approx(0.0227, abs=1e-4)
    assert errors(sparse)[2] == pytest.approx(0.0799, abs=1e-4)
    start = problem.model.with_values({"K": 1.0, "T": 1.0})
    fit = MultipleShooting().fit(start, Dataset((sparse,)))
    assert 100 * (fit.values["K"] / truth[0] - 1) == pytest.approx(2.24, abs=0.01)
    assert 100 * (fit.values["T"] / truth[1] - 1) == pytest.approx(-0.65, abs=0.01)
    outputs = np.full_like(record.thin(10).outputs, np.nan)
    outputs[::5] = record.thin(10).outputs[::5]
    fit = MultipleShooting().fit(start, Dataset((record.thin(10).with_outputs(outputs),)))
    assert abs(fit.values["K"] / truth[0] - 1) < 1e-3
