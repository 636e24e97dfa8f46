"""Short groups of bad samples: found with their rows, and no answer or turn taken for one."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, check, load_problem, simulate
from oed_sysid.evidence.screens import bursts, deviations, screen, screened, weights
from oed_sysid.evidence.traces import Trace

TIMES = np.arange(800) * 0.1


def wave(seed: int = 0) -> np.ndarray:
    """A sine with noise of a hundredth of its size."""
    rng = np.random.default_rng(seed)
    return np.sin(0.5 * TIMES) + 0.01 * rng.standard_normal(TIMES.size)


def found_in(series: np.ndarray) -> dict[str, list[int]]:
    """Rows of all faults of one signal, by kind."""
    trace = Trace("run", TIMES, {"y": series}, {"y": "m"}, {"y": 0.01})
    return {fault.kind: fault.rows.tolist() for fault in screen(trace)}


def test_cubic_through_four_neighbours() -> None:
    """Cubics are followed exactly by groups of every length; a step of one sample is not."""
    t = np.arange(40.0)
    for length in (1, 2, 6):
        assert np.allclose(deviations(0.01 * t**3 - t, length), 0.0, atol=1e-9)
        assert np.allclose(weights(length).sum(axis=1), 1.0)
    lifted = np.zeros(40)
    lifted[10:13] = 1.0
    assert deviations(lifted, 3)[8].tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("length", [2, 3, 4, 5, 6])
@pytest.mark.parametrize("size", [0.3, -2.0])
def test_groups_are_found_with_all_their_samples(length: int, size: float) -> None:
    """Four groups of equal or of alternating sign, in one record of 800 samples."""
    rows = np.concatenate([first + np.arange(length) for first in (60, 231, 402, 655)])
    for signs in (np.ones(length), (-1.0) ** np.arange(length)):
        series = wave()
        series[rows] += size * np.tile(signs, 4)
        assert found_in(series) == {"spikes": rows.tolist()}


def test_neighbouring_spikes_of_other_sign_are_one_group() -> None:
    """Two spikes with one good sample between them are found together with it."""
    series = wave()
    series[300] += 1.0
    series[302] -= 1.0
    assert found_in(series) == {"spikes": [300, 301, 302]}


def test_clean_noise_holds_no_groups() -> None:
    """None in two hundred clean records of 800 samples, half of them with coloured noise."""
    alarms = 0
    for seed in range(200):
        rng = np.random.default_rng((1, seed))
        noise = rng.standard_normal(TIMES.size)
        if seed % 2:
            for k in range(1, noise.size):
                noise[k] = 0.8 * noise[k - 1] + 0.6 * noise[k]
        series = np.sin(0.5 * TIMES) + 0.05 * noise
        alarms += len(bursts(TIMES, series, np.zeros(TIMES.size, dtype=bool), 8.5, 0.02))
    assert alarms == 0


def test_a_short_hump_is_no_group() -> None:
    """A half sine of ten samples and a ramp that turns back rise from sample to sample."""
    nothing = np.zeros(TIMES.size, dtype=bool)
    hump = np.zeros(TIMES.size)
    hump[200:211] = np.sin(np.linspace(0.0, np.pi, 11))
    assert not bursts(TIMES, hump, nothing, 8.5, 0.02)
    ramp = np.interp(np.arange(800), [0, 300, 303, 306, 800], [0.0, 0.0, 1.0, 0.0, 0.0])
    assert not bursts(TIMES, ramp, nothing, 8.5, 0.02)


def test_groups_after_steps_of_the_inputs_are_answers() -> None:
    """Four groups that begin right after the four steps of an input are no spikes."""
    starts = np.array([100, 300, 500, 700])
    pushed = np.zeros(TIMES.size, dtype=bool)
    pushed[(starts[:, None] + np.arange(3)).ravel()] = True
    for shift, expected in ((0, 0), (40, 8)):
        series = wave()
        series[(starts[:, None] + shift + np.arange(2)).ravel()] += 1.0
        trace = Trace("run", TIMES, {"y": series}, {"y": "m"}, {"y": 0.01}, pushed=pushed)
        faults, (marked,) = screened([trace])
        assert sum(fault.rows.size for fault in faults) == expected
        assert ("y" in marked.fast) is (shift == 0)


@pytest.mark.parametrize("signal", ["w", "q", "theta", "z"])
def test_groups_in_a_log_are_the_only_finding(signal: str) -> None:
    """Three bursts of two to five samples of a dive: spikes, no bias, scale or delay."""
    problem = load_problem("remus_diving_plane")
    record = simulate(
        problem.model, problem.experiments["zigzag_10_10"], rng=np.random.default_rng(1)
    )
    outputs = record.outputs.copy()
    column = outputs[:, record.channels.output_names.index(signal)]
    size = 8.0 * column.std()
    for first, length in ((100, 2), (290, 3), (480, 5)):
        column[first : first + length] += size
    found = check(Dataset((record.with_outputs(outputs),)), problem)
    assert [(one.kind, one.signals, one.size) for one in found.serious] == [
        ("spikes", (signal,), 10.0)
    ]
