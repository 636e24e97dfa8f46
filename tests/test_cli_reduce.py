"""A smaller model is offered, fitted and checked on records from the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import told

import oed_sysid
from oed_sysid import Doublet, Experiment, simulate, write_csv
from oed_sysid.evidence.chance import threshold


def test_what_records_cannot_tell_is_fixed_and_checked(tmp_path: Path) -> None:
    """Of sway and yaw that keep one ratio some are fixed; the loss is that of two fits."""
    problem = oed_sysid.load_problem("online_ship")
    run = Experiment(
        "doublet", Doublet("delta", 0.1, pulse_time=8.0), duration=32.0, sample_time=0.1
    )
    rng = np.random.default_rng(0)
    paths = [str(tmp_path / f"{i}.csv") for i in (1, 2)]
    for path in paths:
        write_csv(simulate(problem.model, run, rng=rng), path)
    line = ["reduce", "online_ship", paths[0], "--validate", paths[1], "--known-noise"]
    found = told(tmp_path, line)
    assert found["fixed"] == [one["name"] for one in found["subset"]["parameters"]
                              if one["advice"] == "fix"]  # fmt: skip
    assert found["fixed"]
    fits = {}
    for name in ("nominal", "reduced"):
        model = problem.model if name == "nominal" else problem.model.fix(*found["fixed"])
        data = oed_sysid.read_csv(paths[:1], model.channels)
        fits[name] = oed_sysid.MultipleShooting(noise="given").fit(model, data)
    lost = 2 * (fits["nominal"].log_likelihood - fits["reduced"].log_likelihood)
    assert found["lost"] == pytest.approx(lost, rel=1e-3, abs=1e-3)
    assert lost < threshold(1, len(found["fixed"]))
