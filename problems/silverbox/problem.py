"""Silverbox: an electronic circuit made to behave like a mass on a hardening spring.

The nominal model is the linear one. The input is a multisine with power up to
200 Hz, measured 610.35 times a second: between the samples it is neither held
nor linear, so it is interpolated here as the band-limited signal that it is.
"""

from __future__ import annotations

import numpy as np

from oed_sysid import (
    Dataset,
    Force,
    Input,
    Limits,
    Model,
    Output,
    Parameter,
    Problem,
    Record,
    State,
    read_csv,
)
from oed_sysid.data.third_party import fetch
from oed_sysid.physics import actuator_lag, sensor_bias

SAMPLING = 1e7 / 2**14  # Hz; the file's times are rounded to microseconds
FINER = 4  # input values per sample; twice as many change the errors by one per cent
PADDING = 300  # samples on either side, so that the ends of a part do not ring
# First and last sample of a part, each within another realisation of the multisine.
PARTS = {"train_first_realisation": (1000, 2500), "test_third_realisation": (18000, 20000)}

ANGULAR = 430.0  # rad/s, resonance at 68 Hz
SWING = 0.055  # V, standard deviation of the output

model = Model(
    name="silverbox, linear",
    states=(
        State("y", "V", "output", scale=SWING),
        State("rate", "V/s", "rate of the output", scale=SWING * ANGULAR),
    ),
    inputs=(Input("u", "V", "input", interpolation="linear", column="u_V"),),
    outputs=(Output("y", "V", "output", column="y_V"),),
    kinematics={"y": "rate", "rate": "omega**2*(gain*u - y) - 2*zeta*omega*rate"},
    parameters=(
        Parameter("omega", ANGULAR, "rad/s", lower=50.0, description="natural frequency"),
        Parameter("zeta", 0.05, "1", lower=0.0, upper=1.0, description="damping ratio"),
        Parameter("gain", 1.0, "1", description="static gain"),
    ),
    step=1.01 / (FINER * SAMPLING),
)


def _force(name: str, term: str, unit: str, share: float, size: float, text: str) -> Force:
    """Candidate force; its scale makes it ``share`` of the linear spring at ``SWING``."""
    scale = share * ANGULAR**2 * SWING / size
    amplitude = Parameter(
        f"E_{name}", 0.0, unit, lower=-50 * scale, upper=50 * scale, scale=scale, description=text
    )
    return Force(
        name,
        {"rate": f"-E_{name}*{term}"},
        (amplitude,),
        description=text,
        needs="an output of small and large amplitude",
    )


SPEED = SWING * ANGULAR
effects = (
    _force("quadratic_stiffness", "y**2", "1/(V s^2)", 0.02, SWING**2, "spring not symmetric"),
    _force("cubic_stiffness", "y**3", "1/(V^2 s^2)", 0.02, SWING**3, "hardening spring"),
    _force("quintic_stiffness", "y**5", "1/(V^4 s^2)", 0.02, SWING**5, "spring hardens later"),
    _force("quadratic_damping", "rate*abs(rate)", "1/V", 0.01, SPEED**2, "turbulent damping"),
    _force("swing_damping", "y**2*rate", "1/(V^2 s)", 0.01, SWING**2 * SPEED, "van der Pol"),
    _force("constant_force", "1", "V/s^2", 0.1, 1.0, "offset of the input"),
    sensor_bias("output_bias", "y", "V", scale=0.1 * SWING),
    actuator_lag("input_lag", "u", scale=1e-4),
)


def band_limited(signal: np.ndarray, first: int, last: int) -> np.ndarray:
    """Values of a band-limited signal at ``FINER`` times the sampling rate.

    Fourier interpolation of the samples ``first`` to ``last`` and ``PADDING``
    more on either side.
    """
    low, high = first - PADDING, last + PADDING
    part = signal[low:high]
    fine = FINER * np.fft.irfft(np.fft.rfft(part), n=FINER * len(part))
    begin = FINER * PADDING
    return fine[begin : begin + FINER * (last - first)]


def records() -> Dataset:
    """Parts of two realisations: one to learn from, one to judge by."""
    whole = read_csv(fetch("silverbox/multisine.csv"), model.channels)[0]
    parts = []
    for name, (first, last) in PARTS.items():
        u = band_limited(whole.input("u"), first, last)
        y = np.full(len(u), np.nan)
        y[::FINER] = whole.output("y")[first:last]
        times = np.arange(len(u)) / (FINER * SAMPLING)
        parts.append(Record(name, times, u, y, model.channels, source=whole.source))
    return Dataset(tuple(parts))


problem = Problem(
    name="silverbox",
    title="Silverbox, an electronic Duffing oscillator",
    model=model,
    effects=effects,
    limits=Limits(inputs={"u": (-0.15, 0.15)}),
    records=records,
    references=(
        "Wigren & Schoukens (2013), Three free data sets for development and benchmarking in "
        "nonlinear system identification, European Control Conference",
    ),
    description="A linear resonance explains most of it; find the spring that is not straight.",
)
