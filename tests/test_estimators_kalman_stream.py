"""The Kalman filter fed sample by sample equals the one that plays back a log."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, load_problem
from oed_sysid.baselines import JointKalmanFilter
from oed_sysid.baselines.online import KalmanStream
from oed_sysid.errors import ModelError
from oed_sysid.experiments.simulation import simulate

PROBLEM = load_problem("nomoto_sparse_heading")
RECORD = simulate(
    PROBLEM.model, PROBLEM.experiment("zigzag_15_15"), rng=np.random.default_rng(0)
).thin(10)
AWAY = PROBLEM.model.with_values({"K": 1.5, "T": 0.5})


@pytest.mark.parametrize("kind", ["extended", "unscented"])
def test_stream_gives_the_history_of_the_filter(kind: str) -> None:
    """After every sample values and errors are those of the filter on the whole record."""
    settings = JointKalmanFilter(kind)
    fit = settings.fit(AWAY, Dataset((RECORD,)))
    stream = KalmanStream(AWAY, settings)
    for k, moment in enumerate(RECORD.times[:60]):
        sample = {"delta": RECORD.input("delta")[k], "psi": RECORD.output("psi")[k]}
        stream.update(float(moment), sample)
        for name in ("K", "T"):
            assert stream.values[name] == pytest.approx(fit.extras["history"][name][k], rel=1e-9)
            expected = fit.extras["history_std"][name][k]
            assert stream.std_errors[name] == pytest.approx(expected, rel=1e-9)


def test_a_new_run_keeps_what_is_known() -> None:
    """A second run begins with the parameters and errors that the first ended with."""
    stream = KalmanStream(AWAY)
    for k in range(30):
        sample = {"delta": RECORD.input("delta")[k], "psi": RECORD.output("psi")[k]}
        stream.update(float(RECORD.times[k]), sample)
    values, errors = stream.values, stream.std_errors
    stream.start()
    assert stream.values == pytest.approx(values)
    assert stream.std_errors == pytest.approx(errors)
    stream.update(0.0, {"delta": 0.0, "psi": 0.0})
    assert stream.n_samples == 31


def test_impossible_samples_are_refused() -> None:
    """A missing command, a clock set back and unknown noise are errors with advice."""
    stream = KalmanStream(AWAY)
    stream.update(1.0, {"delta": 0.1, "psi": 0.0})
    with pytest.raises(ModelError, match="has no delta"):
        stream.update(2.0, {"psi": 0.0})
    with pytest.raises(ModelError, match="not later"):
        stream.update(1.0, {"delta": 0.1, "psi": 0.0})
