"""Effects of several signals at once, and of each record apart."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Force, Input, Model, Output, Parameter, State
from oed_sysid.errors import ModelError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.physics import (
    actuator_lag,
    actuator_offset,
    backlash,
    deadband,
    in_each_record,
    rate_limit,
    steady_wind,
)

TWIN = Model(
    name="twin screw",
    states=(State("u", "m/s"), State("r", "rad/s")),
    inputs=(Input("port", "N"), Input("starboard", "N")),
    outputs=(Output("u", "m/s"), Output("r", "rad/s")),
    axes={"X": "u", "N": "r"},
    inertia={("X", "u"): "m", ("N", "r"): "I"},
    parameters=(Parameter("m", 100.0, "kg"), Parameter("I", 80.0, "kg m^2")),
    effects=(Force("screws", {"X": "port + starboard - 40*u", "N": "port - starboard - 60*r"}),),
    step=0.05,
)
TIMES = np.arange(400) * 0.1
INPUTS = {"port": 20 * np.sin(0.7 * TIMES), "starboard": 15 * np.sin(0.4 * TIMES + 1)}


@pytest.mark.parametrize("kind", [deadband, backlash, rate_limit, actuator_lag])
def test_of_two_signals_is_of_each(kind) -> None:  # type: ignore[no-untyped-def]
    """One effect of both screws moves the vessel as two effects, one of each, of the same size."""
    unit = {} if kind is actuator_lag else {"unit": "N"}
    both = TWIN + kind("both", ("port", "starboard"), value=0.4, **unit)
    apart = TWIN + [kind(f"of_{s}", s, value=0.4, **unit) for s in ("port", "starboard")]
    found, expected, without = (
        simulate_inputs(model, TIMES, inputs=INPUTS).outputs for model in (both, apart, TWIN)
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert np.abs(found - without).max() > 1e-3


def test_a_size_for_every_record() -> None:
    """Amplitudes are free in every record under names of their own; the shape is shared."""
    wind = steady_wind(axes=("X", "Y", "N"))
    found = in_each_record(wind)
    assert found.amplitude_names == ("E_wind_north_by_record", "E_wind_east_by_record")
    assert found.shape_names == ("arm_wind_by_record",)
    assert [p.per_record for p in found.parameters] == [True, True, False]
    same = {f"{p.name}_by_record": p.value for p in wind.parameters}
    assert {p.name: p.value for p in found.parameters} == same
    for axis, text in found.terms.items():
        assert text.replace("_by_record", "") == wind.terms[axis]
    trim = actuator_offset("trim", "port", "N", value=3.0)
    shared, own = (simulate_inputs(TWIN + e, TIMES, inputs=INPUTS) for e in (trim,
                   in_each_record(trim)))  # fmt: skip
    np.testing.assert_array_equal(shared.outputs, own.outputs)


def test_an_effect_with_memory_is_refused() -> None:
    """Two effects cannot share what one remembers: what to do is said."""
    with pytest.raises(ModelError, match="per_record=True"):
        in_each_record(backlash("play", "port", "N"))
