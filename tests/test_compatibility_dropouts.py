"""Runs of one value: drop-outs, limits and frozen sensors told from each other."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, check, load_problem, simulate
from oed_sysid.evidence.screens import screen
from oed_sysid.evidence.traces import Trace

TIMES = np.arange(800) * 0.1
RUNS = ((100, 3), (290, 8), (520, 15))
ROWS = np.concatenate([np.arange(first, first + length) for first, length in RUNS])


def wave(seed: int = 0) -> np.ndarray:
    """A sine about 3 with noise."""
    rng = np.random.default_rng(seed)
    return 3.0 + np.sin(0.5 * TIMES) + 0.01 * rng.standard_normal(TIMES.size)


def found_in(series: np.ndarray) -> dict[str, list[int]]:
    """Rows of all faults of one signal, by kind."""
    trace = Trace("run", TIMES, {"y": series}, {"y": "m"}, {"y": 0.01})
    return {fault.kind: fault.rows.tolist() for fault in screen(trace)}


@pytest.mark.parametrize("value", [0.0, 6.0, -1.0])
def test_runs_that_a_signal_falls_to_at_once_are_dropouts(value: float) -> None:
    """Runs of 3, 8 and 15 samples below or above everything else, with all their samples."""
    series = wave()
    series[ROWS] = value
    assert found_in(series) == {"dropouts": ROWS.tolist()}


def test_a_single_run_of_zeros_is_a_dropout() -> None:
    """Beyond all other values one run is enough."""
    series = wave()
    series[290:298] = 0.0
    assert found_in(series) == {"dropouts": list(range(290, 298))}


@pytest.mark.parametrize("limit", [2.2, 3.5, 3.8])
def test_a_limit_that_is_approached_cuts_off(limit: float) -> None:
    """A signal that runs into a limit with its usual steps is cut off there, at every crest."""
    series = np.maximum(wave(), limit) if limit < 3.0 else np.minimum(wave(), limit)
    found = found_in(series)
    assert set(found) == {"saturated"}
    # Where noise takes it over the limit for one or two samples, these are no runs.
    assert len(found["saturated"]) > 0.8 * np.sum(series == limit)


def test_a_sensor_that_stands_still_is_frozen() -> None:
    """Its value is one of its own, and it goes on from elsewhere."""
    series = wave()
    series[200:230] = series[200]
    assert found_in(series) == {"frozen": list(range(201, 230))}


def test_the_end_of_a_short_hold_is_no_step() -> None:
    """Five equal samples of a quick signal, and the jump to where it is by then."""
    rng = np.random.default_rng(0)
    series = np.sin(2.0 * TIMES) + 0.01 * rng.standard_normal(TIMES.size)
    for first in (100, 333, 610):
        series[first : first + 5] = series[first]
    assert "step" not in found_in(series)


@pytest.mark.parametrize("signal", ["u", "z"])
def test_zeros_in_a_log_are_dropouts_and_nothing_else(signal: str) -> None:
    """The speed and the depth of a dive are positive: zeros there are no limit."""
    problem = load_problem("remus_diving_plane")
    records = []
    for number, name in enumerate(("zigzag_5_5", "zigzag_10_10")):
        run = simulate(
            problem.model, problem.experiments[name], rng=np.random.default_rng(number), name=name
        )
        outputs = run.outputs.copy()
        outputs[ROWS, run.channels.output_names.index(signal)] = 0.0
        records.append(run.with_outputs(outputs))
    found = check(Dataset(tuple(records)), problem)
    assert [(one.kind, one.signals, one.size) for one in found.serious] == [
        ("dropouts", (signal,), 52.0)
    ]
