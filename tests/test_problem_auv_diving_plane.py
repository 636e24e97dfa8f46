"""The published experiment on the AUV in the diving plane."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.documents.published import paper
from oed_sysid import load_problem, simulate, simulate_inputs

PROBLEM = load_problem("auv_diving_plane")
RECORD = simulate(PROBLEM.model, PROBLEM.experiment("zigzag_5_5"), noise=False)
SCRIPT = paper("auv_diving_plane")
# An independent program's total sensitivity to a change of each coefficient by 20 per cent.
SENSITIVITY = {
    "M_absww_prime": 0.0001,
    "Z_wabsq_prime": 0.0004,
    "Z_absww_prime": 0.0006,
    "X_ww_prime": 0.0011,
    "X_qq_prime": 0.0014,
    "X_wq_prime": 0.0014,
    "M_uabsw_prime": 0.0021,
    "Z_uabsw_prime": 0.0043,
    "M_uu_prime": 0.0202,
    "Z_uu_prime": 0.0981,
    "M_uw_prime": 0.1064,
    "Z_uw_prime": 0.1875,
    "X_uu_prime": 0.1903,
    "M_uq_prime": 0.3014,
    "Z_uq_prime": 0.3688,
    "M_uuds_prime": 0.4023,
    "Z_uuds_prime": 0.4123,
}


def test_manoeuvre() -> None:
    """The zigzag is the one that an independent program made."""
    assert RECORD.n_samples == PROBLEM.published["samples"] + 1
    assert RECORD.output("u")[-1] == pytest.approx(1.353, abs=5e-4)
    theta = np.degrees(RECORD.output("theta"))
    assert (theta.min(), theta.max()) == pytest.approx((-5.77, 5.85), abs=5e-3)
    assert np.degrees(np.abs(RECORD.output("q")).max()) == pytest.approx(1.049, abs=5e-4)
    fin = RECORD.input("delta_s")
    assert np.sum(np.diff(np.sign(fin[1:])) != 0) == 4


def test_straight_speed() -> None:
    """Without fin the thrust drives the vehicle at 1.471 m/s, where drag equals it."""
    times = np.arange(0, 3000, 0.5)
    level = dict.fromkeys(("Z_uu_prime", "M_uu_prime"), 0.0)
    run = simulate_inputs(PROBLEM.model.with_values(level), times, inputs={"delta_s": 0.0})
    assert run.signal("u")[-1] == pytest.approx(1.471, abs=1e-3)


def test_sensitivities() -> None:
    """Sensitivities equal an independent program's, so the order of importance does too."""
    found = SCRIPT.sensitivities(RECORD)
    for name, expected in SENSITIVITY.items():
        assert found[name] == pytest.approx(expected, abs=1e-4), name
