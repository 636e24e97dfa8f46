"""Linear views: frequency response, Nomoto indices, course stability."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Input, Model, Output, Parameter, State
from oed_sysid.errors import DesignError
from oed_sysid.experiments.simulation import equilibrium
from oed_sysid.information import (
    bode,
    excitation_spectrum,
    nomoto,
    nomoto_of,
    straight_line_stability,
)

# Esso 190 000 dwt in the bis system, linearised at 80 rpm from the coefficients of
# van Berlekom & Goddard (1972).
TANKER = np.array([[-0.5965, -0.3723], [-3.661, -1.875]])
RUDDER = np.array([0.1133, -0.8755])
# Mariner-like stable variant: less destabilising moment of sway.
STABLE = np.array([[-0.9, -0.3], [-1.2, -2.0]])


def ship(matrix: np.ndarray) -> Model:
    """Linear sway-yaw model with heading."""
    names = ("a11", "a12", "a21", "a22", "b1", "b2")
    values = (*matrix.ravel(), *RUDDER)
    return Model(
        "linear ship",
        (State("v", ""), State("r", ""), State("psi", "rad")),
        (Input("delta", "rad"),),
        (Output("r", ""), Output("psi", "rad")),
        {"v": "a11*v + a12*r + b1*delta", "r": "a21*v + a22*r + b2*delta", "psi": "r"},
        parameters=tuple(Parameter(n, float(v)) for n, v in zip(names, values, strict=True)),
    )


def test_nomoto_indices_match_published_values() -> None:
    """K, T1, T2, T3 of the tanker as published with its coefficients."""
    found = nomoto_of(TANKER, RUDDER)
    assert found.gain == pytest.approx(3.84, abs=0.02)
    assert found.time_constants == pytest.approx((-10.5, 0.39), abs=0.02)
    assert found.numerator_time == pytest.approx(0.93, abs=0.01)


def test_nomoto_reproduces_the_frequency_response() -> None:
    """The four indices give the same response as the whole model at every frequency."""
    model = ship(STABLE)
    point = equilibrium(model, inputs={"delta": 0.0})
    indices = nomoto(model, point, rudder="delta")
    found = bode(model, point, input="delta", output="r")
    s = 1j * found.frequencies
    first, second = indices.time_constants
    expected = indices.gain * (1 + indices.numerator_time * s) / (1 + first * s) / (1 + second * s)
    np.testing.assert_allclose(found.gain, np.abs(expected), rtol=1e-9)
    assert indices.prime(2.0, 4.0).gain == pytest.approx(indices.gain / 2)


def test_course_stability_criterion_and_poles_agree() -> None:
    """A negative determinant means one unstable pole, as for the tanker."""
    for matrix, stable in ((TANKER, False), (STABLE, True)):
        model = ship(matrix)
        found = straight_line_stability(model, equilibrium(model, inputs={"delta": 0.0}))
        assert found.stable is stable
        assert (found.criterion > 0) is stable
        assert found.criterion == pytest.approx(np.prod(found.poles).real)
    assert "stable" in found.report()


def test_spectrum_keeps_the_variance() -> None:
    """The density integrates to the variance of the command (Parseval)."""
    times = np.arange(512) * 0.25
    commands = 0.1 * np.sin(0.7 * times) + 0.05 * np.sign(np.sin(2.1 * times))
    spectrum = excitation_spectrum(times, commands)
    width = spectrum.frequencies[1] - spectrum.frequencies[0]
    assert np.sum(spectrum.density) * width == pytest.approx(np.var(commands), rel=1e-9)
    low, high = spectrum.band(0.9)
    assert low < 0.8 < high


def test_unknown_names_are_refused() -> None:
    """Names that the model does not have are told."""
    model = ship(STABLE)
    point = equilibrium(model, inputs={"delta": 0.0})
    with pytest.raises(DesignError, match="no input 'fin'"):
        bode(model, point, input="fin", output="r")
    with pytest.raises(DesignError, match="no state 'w'"):
        straight_line_stability(model, point, states=("w", "q"))
