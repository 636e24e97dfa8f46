"""Manoeuvres about a neutral command that is not zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oed_sysid.experiments.manoeuvres import (
    PRBS,
    Chirp,
    Doublet,
    Excitation,
    Multisine,
    OpenLoop,
    PullOut,
    ReverseSpiral,
    Spiral,
    ThreeTwoOneOne,
    TurningCircle,
)

CRUISE = 70.0  # rad/s of a propeller
SWINGS: tuple[OpenLoop, ...] = (
    ThreeTwoOneOne("n", 15.0, unit_time=2.0, start=1.0),
    Doublet("n", 15.0, pulse_time=2.0, start=1.0),
    PRBS("n", 15.0, bit_time=1.0, order=4, start=1.0),
    Multisine("n", [0.1, 0.2], amplitudes=[5.0, 5.0], start=1.0),
    Chirp("n", 15.0, first_frequency=0.1, last_frequency=0.5, sweep_time=10.0, start=1.0),
    TurningCircle("n", 15.0, start=1.0, rate=5.0),
    PullOut("n", 15.0, turn_duration=5.0, start=1.0, rate=5.0),
    Spiral("n", (5.0, 0.0, -5.0), hold=5.0, start=1.0, rate=5.0),
)


@pytest.mark.parametrize("swing", SWINGS, ids=lambda swing: swing.kind)
def test_neutral_shifts_the_whole_command(swing: OpenLoop) -> None:
    """The command about 70 rad/s is that about zero plus 70, before, during and after."""
    times = np.linspace(0.0, 20.0, 201)
    shifted = replace(swing, neutral=CRUISE)
    np.testing.assert_allclose(shifted.commands(times), CRUISE + swing.commands(times))
    assert shifted.commands([0.0])[0] == CRUISE
    assert Excitation.from_dict(shifted.to_dict()) == shifted
    assert shifted.commands(times).min() > 50.0


def test_reverse_spiral_steers_about_neutral() -> None:
    """Without error and before its start a reverse spiral holds the neutral command."""
    spiral = ReverseSpiral(
        "n", (0.0,), hold=9.0, gain=2.0, reset_time=5.0, limit=0.3, start=1.0, neutral=0.1
    )
    control = spiral.controller()
    assert control.command(0.0, {"r": 0.0}) == pytest.approx(0.1)
    assert control.command(1.0, {"r": 0.0}) == pytest.approx(0.1)
    assert control.command(2.0, {"r": -0.05}) == pytest.approx(0.1 + 0.1 + 0.02)
