"""Frequency responses of records: errors against a closed form, and the band of a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import told
from motion import small
from plain_pages import plain_pages  # noqa: F401
from scipy.signal import lfilter
from simple_models import NOMOTO, K, T

import oed_sysid
from oed_sysid import PRBS, Dataset, Experiment, Record, compare, simulate, write_csv
from oed_sysid.cli.script import part_of
from oed_sysid.cli.study import Study
from oed_sysid.cli.tasks import TASKS
from oed_sysid.errors import DataError
from oed_sysid.evidence.frequency import FAILS, HOLDS, compare_frequency, frequency_response

STEP, POLES, GAINS = 0.5, np.array([0.9, 0.6]), np.array([2.0, -0.7])
TWO_INPUTS = small("two lags", "x [m] <- a [m], b [m]", {"x": "a + b - x"}, noise=0.1)


def two_lags(rng: np.random.Generator, n: int = 4000, alike: float = 0.5) -> Record:
    """Sum of two first-order lags of correlated inputs with white noise, by SciPy's filter."""
    first, second = rng.standard_normal((2, n))
    inputs = np.column_stack([first, alike * first + second])
    parts = [
        lfilter([0.0, gain * (1.0 - pole)], [1.0, -pole], one)
        for gain, pole, one in zip(GAINS, POLES, inputs.T, strict=True)
    ]
    output = np.sum(parts, axis=0) + 0.3 * rng.standard_normal(n)
    return Record("run", STEP * np.arange(n), inputs, output[:, np.newaxis], TWO_INPUTS.channels)


def exact(frequencies: np.ndarray) -> np.ndarray:
    """Closed form of both responses, ``(n_frequencies, 2)``."""
    delay = np.exp(-2j * np.pi * frequencies * STEP)[:, np.newaxis]
    return GAINS * (1.0 - POLES) * delay / (1.0 - POLES * delay)


def test_stated_errors_cover_the_closed_form() -> None:
    """Over seeds, 95 % intervals of both parts of both responses hold the truth."""
    inside, scaled = [], []
    for seed in range(20):
        found = frequency_response(Dataset((two_lags(np.random.default_rng(seed)),)), window=100.0)
        off = found.values[:, 0] - exact(found.frequencies)
        for part in (off.real, off.imag):
            inside.append(np.abs(part) < 1.96 * found.errors[:, 0])
            scaled.append(part / found.errors[:, 0])
    assert 0.93 < np.mean(inside) < 0.97
    assert 0.95 < np.std(scaled) < 1.06


def test_coherence_is_that_of_the_closed_form() -> None:
    """Partial and multiple coherence are those of the known spectra."""
    found = frequency_response(Dataset((two_lags(np.random.default_rng(1), 100000),)), window=300.0)
    truth = exact(found.frequencies)
    # Of inputs (f, f/2 + s), f and s white of one level: conditional powers 4/5 and 1.
    explained = np.abs(truth[:, 0] + 0.5 * truth[:, 1]) ** 2 + np.abs(truth[:, 1]) ** 2
    noise = 0.3**2
    off = found.multiple[:, 0] - explained / (explained + noise)
    assert np.abs(off[1:]).max() < 0.12
    assert np.sqrt(np.mean(off**2)) < 0.03
    own = np.abs(truth) ** 2 * np.array([0.8, 1.0])
    assert np.sqrt(np.mean((found.coherence[:, 0] - own / (own + noise)) ** 2)) < 0.04
    # One-sided density of the input: twice its variance times the sampling interval.
    assert np.mean(found.input_spectra[:, 0]) == pytest.approx(2.0 * STEP, rel=0.03)


def test_inputs_that_move_alike_tell_nothing() -> None:
    """Where inputs are one signal, no response is told; tests without order are refused."""
    record = two_lags(np.random.default_rng(2))
    same = record.with_inputs(np.repeat(record.inputs[:, :1], 2, axis=1))
    found = frequency_response(Dataset((same,)))
    assert not found.told.any()
    with pytest.raises(DataError, match="independent windows"):
        frequency_response(Dataset((record,)), window=2000.0)


def _runs(seed: int) -> Dataset:
    run = Experiment(
        "prbs", PRBS("rudder", 0.2, bit_time=4.0, order=9), duration=1600.0, sample_time=0.5
    )
    return Dataset((simulate(NOMOTO, run, rng=np.random.default_rng(seed)),))


def test_a_right_model_holds_and_a_wrong_one_fails_where_it_is_wrong() -> None:
    """The right model fails nowhere; one with half the time constant only at high frequency."""
    dataset = _runs(0)
    wrong = NOMOTO.with_values({"T": T / 2.0})
    found = compare_frequency(compare({"right": NOMOTO, "fast": wrong}, dataset))
    right, fast = found.models
    assert not (right.verdicts == FAILS).any()
    j = found.record.outputs.index("r")
    hertz = found.record.frequencies
    # |H| of the two differ by less than 2 % below a tenth of 1/(2 pi T), by two far above.
    held = hertz[fast.verdicts[:, j, 0] == HOLDS]
    failed = hertz[fast.verdicts[:, j, 0] == FAILS]
    assert failed.size
    assert failed.min() < 2.0 / (2.0 * np.pi * T)
    assert not held.size or held.min() < failed.min()
    bands = [b for b in found.bands if (b.model, b.output, b.verdict) == ("fast", "r", FAILS)]
    assert max(b.ratio for b in bands) == pytest.approx(2.0, rel=0.1)
    assert sum(b.count for b in bands) == failed.size
    # Nomoto's closed form for an input that is held between samples.
    delay = np.exp(-2j * np.pi * hertz * 0.5)
    pole = np.exp(-0.5 / T)
    closed = K * (1.0 - pole) * delay / (1.0 - pole * delay)
    told = found.record.told[:, j, 0]
    ratio = np.abs(right.values[told, j, 0] / closed[told])
    # The lowest frequency has leakage, which the run of the model shares with the record.
    assert ratio[0] == pytest.approx(1.0, abs=0.2)
    assert ratio[1:] == pytest.approx(1.0, abs=0.05)


def test_right_models_rarely_fail() -> None:
    """Of twelve right models on records of their own, at most one is failed anywhere."""
    failed = 0
    for seed in range(12):
        found = compare_frequency(compare({"right": NOMOTO}, _runs(seed)))
        failed += any(band.verdict == FAILS for band in found.bands)
    assert failed <= 1


def test_the_command_compares_frequency_responses(tmp_path: Path) -> None:
    """Text, JSON and page of ``compare --frequency`` hold the bands."""
    problem = oed_sysid.load_problem("online_ship")
    run = Experiment(
        "prbs", PRBS("delta", 0.1, bit_time=3.0, order=7), duration=200.0, sample_time=0.2
    )
    rng = np.random.default_rng(0)
    paths = [str(tmp_path / f"{i}.csv") for i in (1, 2)]
    for path in paths:
        write_csv(simulate(problem.model, run, rng=rng), path)
    page = tmp_path / "c.html"
    line = ["compare", "online_ship", paths[0], "--validate", paths[1], "--frequency"]
    found = told(tmp_path, [*line, "--disturbances", "none", "--html", page])["frequency"]
    assert {band["verdict"] for band in found["bands"]} >= {HOLDS}
    assert any("delta to r: holds over" in words for words in found["verdict"])
    assert "Frequency responses" in page.read_text()


def test_the_script_of_the_page_compares_frequency_responses() -> None:
    """The same in Python has the call only where it was asked for."""
    study = Study.named("online_ship")
    asked = part_of(TASKS["compare"], study, {"frequency": True})
    compile(asked, "study.py", "exec")
    assert "compare_frequency(comparison)" in asked
    assert "compare_frequency" not in part_of(TASKS["compare"], study, {})
