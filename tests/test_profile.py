"""Profile likelihood intervals against parabolas, closed forms and known open ends."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from yaw_vehicle import NOISE, yaw_data, yaw_model

from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.multistart import profile
from oed_sysid.physics.channels import Output, State
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter

CHI2 = 3.841458820694124


def test_linear_parameter_has_the_standard_interval() -> None:
    """Where the misfit is a parabola, profile and standard error give the same interval."""
    line = Model(
        "line",
        (State("x", "m"),),
        (),
        (Output("x", "m"),),
        {"x": "slope"},
        parameters=(Parameter("slope", 1.0, "m/s"),),
    )
    times = np.linspace(0, 10, 50)
    noise = 0.3 * np.random.default_rng(0).standard_normal(50)
    data = Dataset((Record("line", times, [], 0.5 * times + noise, line.channels),))
    fit = MultipleShooting(noise=[0.3], coloured="never").fit(line, data)
    found = profile(fit, "slope")
    low, high = fit.interval("slope")
    width = high - low
    assert found.lower == pytest.approx(low, abs=2e-3 * width)
    assert found.upper == pytest.approx(high, abs=2e-3 * width)
    assert found.is_bounded
    expected = ((found.values - fit.values["slope"]) / fit.std_errors["slope"]) ** 2
    assert np.allclose(found.rises, expected, atol=1e-4)


DECAY = Model(
    "decay",
    (State("x", "m"),),
    (),
    (Output("x", "m"),),
    {"x": "-a*x"},
    parameters=(Parameter("a", 1.0, "1/s", lower=0.0, upper=50.0),),
    step=0.02,
)


def decay_fit(rate: float, seed: int, noise: float = 0.12) -> tuple[Dataset, object]:
    """A few noisy samples of a decay: strongly nonlinear in its rate."""
    times = np.linspace(0, 3, 8)
    rng = np.random.default_rng(seed)
    values = np.exp(-rate * times) + noise * rng.standard_normal(8)
    data = Dataset((Record("decay", times, [], values, DECAY.channels),))
    return data, MultipleShooting(noise=[noise], coloured="never").fit(DECAY, data)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nonlinear_interval_is_the_closed_form(seed: int) -> None:
    """The initial value drops out in closed form: the ends solve one scalar equation."""
    data, fit = decay_fit(1.0, seed)
    times, values = data[0].times, data[0].outputs[:, 0]

    def twice_cost(rate: float) -> float:
        shape = np.exp(-rate * times)
        best = shape @ values / (shape @ shape)
        return float(np.sum((values - best * shape) ** 2)) / 0.12**2

    estimate = fit.values["a"]
    least = twice_cost(estimate)
    found = profile(fit, "a")
    lower = brentq(lambda a: twice_cost(a) - least - CHI2, -2.0, estimate)
    if lower < 0:
        assert found.lower == 0.0
        assert found.lower_end == "bound"
    else:
        assert found.lower == pytest.approx(lower, rel=5e-3)
    upper = brentq(lambda a: twice_cost(a) - least - CHI2, estimate, 49.0)
    assert found.upper == pytest.approx(upper, rel=5e-3)
    assert found.upper - estimate > 1.1 * (estimate - lower)  # asymmetric, as it should be


def test_open_end_is_said() -> None:
    """A decay faster than the sampling has no upper limit; the profile stops at the bound."""
    _, fit = decay_fit(8.0, 5, noise=0.1)
    found = profile(fit, "a")
    assert found.upper_end == "bound"
    assert "not because of the data" in found.report()
    free = fit.model.with_parameter(Parameter("a", fit.values["a"], "1/s", lower=0.0))
    wide = profile(MultipleShooting(noise=[0.1]).fit(free, fit.dataset), "a")
    assert wide.upper_end in ("open", "diverged")
    assert "do not bound it" in wide.report() or "diverges" in wide.report()
    assert not wide.is_bounded


def test_unseen_parameter_is_open_on_both_sides() -> None:
    """What no output depends on may take any value."""
    model = yaw_model(other=Parameter("other", 1.0))
    fit = MultipleShooting(noise=NOISE, coloured="never").fit(model, yaw_data(0))
    found = profile(fit, "other")
    assert (found.lower, found.upper) == (-np.inf, np.inf)
    assert found.report().count("do not bound it") == 2


def test_coloured_residuals_widen_the_profile() -> None:
    """The threshold grows with the ratio of the sandwich to the white variance."""
    data = yaw_data(1)
    white = MultipleShooting(noise=NOISE, coloured="never").fit(yaw_model(), data)
    forced = MultipleShooting(noise=NOISE, coloured="always").fit(yaw_model(), data)
    ratio = forced.std_errors["T"] / white.std_errors["T"]
    widths = [found.upper - found.lower for found in (profile(f, "T") for f in (white, forced))]
    assert widths[1] / widths[0] == pytest.approx(ratio, rel=0.03)


def test_unknown_names_and_levels_are_refused() -> None:
    """The error lists what can be profiled."""
    fit = MultipleShooting(noise=NOISE).fit(yaw_model(), yaw_data(0))
    with pytest.raises(ModelError, match="K, T, alpha"):
        profile(fit, "gain")
    with pytest.raises(ModelError, match="between 0 and 1"):
        profile(fit, "T", level=95)
