"""Parts that are made in Python: what is of the wrong kind is refused where it is made."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from oed_sysid.cli import BAD_INPUT, main
from oed_sysid.data.dataset import Dataset, Record, read_csv
from oed_sysid.errors import OedSysidError
from oed_sysid.experiments import manoeuvres as m
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.physics import ExtraState, Force
from oed_sysid.physics.channels import Channels, Input, Output, State
from oed_sysid.physics.parameters import Parameter

NAN, INF = float("nan"), float("inf")
CHANNELS = Channels((), (Output("y", "m"),))
SIZE = (Parameter("E", 0.0),)

CASES: dict[str, tuple[Callable[[], object], str]] = {
    "limit NaN": (lambda: Limits(inputs={"a": (NAN, 1.0)}), "expected (lower, upper)"),
    "limit as text": (lambda: Limits(inputs={"a": ("x", 1.0)}), "expected (lower, upper)"),
    "limit upside down": (lambda: Limits(signals={"z": (10.0, 2.0)}), "signal 'z'"),
    "rate of zero": (lambda: Limits(rates={"a": 0.0}), "above zero"),
    "limit as a number": (lambda: Limits(inputs={"a": 3.0}), "expected (lower, upper)"),
    "limits as a list": (lambda: Limits(inputs=[1.0]), "expected a mapping"),
    "rate NaN": (lambda: Limits(rates={"a": NAN}), "above zero"),
    "rate as text": (lambda: Limits(rates={"a": "1"}), "above zero"),
    "duration of zero": (lambda: Experiment("a", duration=0), "several samples"),
    "duration NaN": (lambda: Experiment("a", duration=NAN), "several samples"),
    "duration infinite": (lambda: Experiment("a", duration=INF), "several samples"),
    "duration as text": (lambda: Experiment("a", duration="5"), "duration '5'"),
    "sampled more slowly than it lasts": (
        lambda: Experiment("a", duration=5, sample_time=50),
        "several samples",
    ),
    "experiment named by a number": (lambda: Experiment(5, duration=5), "Give text"),
    "constant NaN": (lambda: Experiment("a", duration=5, constants={"r": NAN}), "'r' = nan"),
    "constant as text": (lambda: Experiment("a", duration=5, constants={"r": "x"}), "mapping"),
    "noise below zero": (lambda: Experiment("a", duration=5, noise={"r": -1}), "'r' = -1"),
    "manoeuvre as text": (lambda: Experiment("a", "zigzag", duration=5), "got a str"),
    "amplitude NaN": (lambda: m.ZigZag("r", NAN, 0.1), "amplitude nan"),
    "table of unequal rows": (
        lambda: Force("f", {"X": "E*T(u)"}, SIZE, tables={"T": ([0, 1], [1])}),
        "Table 'T'",
    ),
    "table that runs backwards": (
        lambda: Force("f", {"X": "E*T(u)"}, SIZE, tables={"T": ([1, 0], [1, 2])}),
        "does not increase strictly",
    ),
    "table as a number": (
        lambda: Force("f", {"X": "E*T(u)"}, SIZE, tables={"T": 5}),
        "expected rows of numbers",
    ),
    "unit of an added state": (lambda: ExtraState("mu", "-mu", "0", "foo"), "Unknown unit 'foo'"),
    "noise level below zero": (lambda: Output("y", "m", noise_std=-1.0), "noise_std -1.0"),
    "noise level NaN": (lambda: Output("y", "m", noise_std=NAN), "noise_std nan"),
    "noise level as text": (lambda: Output("y", "m", noise_std="1"), "noise_std '1'"),
    "scale of zero": (lambda: State("y", "m", scale=0.0), "scale 0.0"),
    "sign of zero": (lambda: Input("y", "m", sign=0.0), "sign 0.0"),
    "times as text": (lambda: Record("a", ["x"] * 6, [], [1.0] * 6, CHANNELS), "no real numbers"),
    "complex outputs": (lambda: Record("a", range(6), [], [1j] * 6, CHANNELS), "no real numbers"),
    "ragged outputs": (
        lambda: Record("a", range(6), [], [[1], [2, 3]] * 3, CHANNELS),
        "no real numbers",
    ),
    "dataset of text": (lambda: Dataset(("a",)), "one of these is a str"),
    "no path": (lambda: read_csv(None, CHANNELS), "names no files"),
    "no channels": (lambda: read_csv("a.csv", None), "expected problem.channels"),
}


@pytest.mark.parametrize(("make", "words"), CASES.values(), ids=CASES)
def test_refused_where_it_is_made(make: Callable[[], object], words: str) -> None:
    """A part of the wrong kind ends in the package's own error, which says what is expected."""
    with pytest.raises(OedSysidError) as caught:
        make()
    assert words in str(caught.value)


def test_numbers_of_numpy_are_numbers() -> None:
    """What NumPy returns is as good as Python's own numbers."""
    parameter = Parameter("K", np.float64(0.1), "1/s", lower=np.float32(0.0), scale=np.int64(2))
    assert parameter.magnitude == 2
    assert Output("y", "m", noise_std=np.float64(0.1)).noise_std == 0.1
    assert Limits(rates={"a": np.float64(0.1)}).rates == {"a": 0.1}


def test_design_of_no_duration(capsys: pytest.CaptureFixture[str]) -> None:
    """A duration of zero on the command line is not taken for one that was not given."""
    assert main(["design", "remus_diving_plane", "--duration", "0"]) == BAD_INPUT
    assert "ten samples or more" in capsys.readouterr().err
