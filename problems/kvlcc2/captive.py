"""Captive tests of this hull in another basin, brought to the scale of the free-running model.

HMRI (SIMMAN 2014), 81 static tests of a model of 1:46.426: rudder angles at six speeds, drift,
drift with rudder. Forces come divided by rho/2 U^2 L^2 (moments by L^3), which is inferred from
their size. A test is taken over at the same advance ratio: the speed of the 7 m model is that
whose J at its own revolutions is the test's.
"""

from __future__ import annotations

import csv

import numpy as np

from oed_sysid.data.third_party import fetch
from oed_sysid.likelihood.captive import CaptiveTests

from .particulars import LENGTH, PROPELLER

FILE = "kvlcc2_hmri_captive/captive.csv"
HSVA_SCALE, HMRI_SCALE = 45.714, 46.426
# How far a model of static forces is believed, as a share of the largest force of the series.
BELIEF = 0.03


def captive_tests() -> CaptiveTests:
    """Side force and yaw moment of the different tests; repeats of a row count once."""
    with fetch(FILE).open(newline="", encoding="utf-8") as lines:
        rows = list(csv.reader(lines))[1:]
    # Columns: run, beta, delta, r, speed, rps, X', Y', N', ...
    table = np.unique(np.array([[float(cell) for cell in row[1:9]] for row in rows]), axis=0)
    beta, delta, _, speed, rps, _, side, moment = table.T
    known = {parameter.name: parameter.value for parameter in PROPELLER}
    diameter = known["D_P"] * HSVA_SCALE / HMRI_SCALE
    at_scale = speed / (rps * diameter) * known["n_P"] * known["D_P"]
    pressure = 0.5 * 1000.0 * at_scale**2 * LENGTH**2
    drift = np.radians(beta)
    forces = {"Y": side * pressure, "N": moment * pressure * LENGTH}
    return CaptiveTests(
        "HMRI",
        {"u": at_scale * np.cos(drift), "v": -at_scale * np.sin(drift)},
        {"delta": np.radians(delta)},
        forces,
        {axis: BELIEF * float(np.abs(force).max()) for axis, force in forces.items()},
    )
