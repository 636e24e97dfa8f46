"""Fits whose noise holds what the model should explain are not taken for fits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from oed_sysid import Fit, MultipleShooting, load_problem, read_csv, write_csv
from oed_sysid.cli import main
from oed_sysid.cli.tasks import SUSPECT
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.judgement import unexplained

PROBLEM = load_problem("kvlcc2")


@pytest.fixture(scope="module")
def zigzag() -> Record:
    """A zigzag of the nominal model, without noise."""
    return simulate(PROBLEM.model, PROBLEM.experiment("zigzag_20_20"), noise=False)


def noisy(record: Record, seed: int = 1) -> Record:
    """The record with sensor noise of 0.2 degrees and 0.01 degrees per second."""
    rng = np.random.default_rng(seed)
    levels = np.radians([0.2, 0.01])
    return replace(
        record, outputs=record.outputs + levels * rng.standard_normal((len(record.times), 2))
    )


def fitted(record: Record, **settings: str) -> Fit:
    """A fit of the nominal model."""
    return MultipleShooting(**settings).fit(PROBLEM.model, Dataset((record,)))


def test_right_fit_explains_its_outputs(zigzag: Record) -> None:
    """The true model leaves little more than the noise, and nothing grave is said."""
    fit = fitted(noisy(zigzag))
    shares = unexplained(fit)
    assert shares["psi"] < 0.05
    assert shares["r"] < 0.1
    assert fit.grave == ()
    assert fit.report().startswith(fit.model.name)


@pytest.mark.parametrize("disturbances", ["auto", "none"])
def test_other_input_explains_nothing(zigzag: Record, disturbances: str) -> None:
    """With a rudder of another run noise takes everything, and the first line says so."""
    rng = np.random.default_rng(3)
    foreign = replace(noisy(zigzag), inputs=0.2 * rng.standard_normal(zigzag.inputs.shape))
    fit = fitted(foreign, disturbances=disturbances)
    if fit.status.ok:
        assert {concern.kind for concern in fit.grave} & {"degenerate", "absorbed"}
        assert fit.report().startswith("Do not use these values: ")
    assert min(unexplained(fit).values()) > 0.9


def test_drift_of_an_integrated_output_is_no_fault(zigzag: Record) -> None:
    """A heading that disturbance forces carry away counts by its increments."""
    t = zigzag.times
    drift = np.radians(60.0) * np.sin(2 * np.pi * t / t[-1] / 1.5)
    rate = np.gradient(drift, t)
    record = noisy(zigzag)
    moved = replace(record, outputs=record.outputs + np.column_stack([drift, rate]))
    fit = fitted(moved)
    assert fit.innovations is not None
    levels = moved.outputs[:, 0] - fit.predictions[0][:, 0]
    assert unexplained(fit)["psi"] < np.std(levels) / np.std(moved.outputs[:, 0])
    assert not [one for one in fit.grave if one.signal == "psi"]


def test_few_samples_are_grave(zigzag: Record) -> None:
    """Six samples cannot carry two parameters, two start states and two levels."""
    rows = slice(0, None, len(zigzag.times) // 5)
    record = noisy(zigzag)
    six = replace(
        record,
        times=record.times[rows][:6],
        inputs=record.inputs[rows][:6],
        outputs=record.outputs[rows][:6],
    )
    fit = fitted(six)
    assert "few_samples" in {concern.kind for concern in fit.grave}


def test_command_line_says_what_is_not_usable(
    zigzag: Record, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`fit` on records that the model does not explain says so, below the faults of the log."""
    rng = np.random.default_rng(5)
    record = replace(noisy(zigzag), outputs=0.1 * rng.standard_normal(zigzag.outputs.shape))
    write_csv(record, tmp_path / "noise.csv")
    assert main(["fit", "kvlcc2", str(tmp_path / "noise.csv")]) == SUSPECT
    out = capsys.readouterr().out
    # A yaw rate of noise is not the derivative of a heading of noise: the log is suspect, too.
    assert out.startswith("Log suspect: ")
    assert "Not usable: A constant explains" in out


def test_suspect_log_stands_above_the_fit(
    zigzag: Record, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`fit` and `compare` name swapped columns above their result, and return 4."""
    swapped = replace(noisy(zigzag), outputs=noisy(zigzag).outputs[:, ::-1])
    write_csv(swapped, tmp_path / "swapped.csv")
    other = replace(noisy(zigzag, 2), outputs=noisy(zigzag, 2).outputs[:, ::-1])
    write_csv(other, tmp_path / "other.csv")
    read = read_csv(tmp_path / "swapped.csv", PROBLEM.channels)
    assert read[0].n_samples == len(zigzag.times)
    assert main(["fit", "kvlcc2", str(tmp_path / "swapped.csv")]) == SUSPECT
    out = capsys.readouterr().out
    assert out.startswith("Log suspect: ")
    assert "swap" in out.splitlines()[0]
    train, test = str(tmp_path / "swapped.csv"), str(tmp_path / "other.csv")
    assert main(["compare", "kvlcc2", "--train", train, "--test", test]) == SUSPECT
    assert capsys.readouterr().out.startswith("Log suspect: ")
