"""Experiments say what is commanded, and refuse what contradicts itself."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from oed_sysid.errors import DesignError
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.manoeuvres import (
    Constant,
    Doublet,
    Piecewise,
    RateLimited,
    TurningCircle,
    ZigZag,
)
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.physics.model import Model

SHIP = Model(
    "ship",
    states=(State("psi", "rad"), State("r", "rad/s"), State("u", "m/s")),
    inputs=(Input("rudder", "rad"), Input("thrust", "N")),
    outputs=(Output("psi", "rad", noise_std=0.01),),
    kinematics={"psi": "r", "r": "(0.1*rudder - r)/10", "u": "(thrust - u*abs(u))/100"},
)


def test_times_cover_the_duration() -> None:
    """The last sample is at the duration, also where the quotient is not exact in binary."""
    experiment = Experiment("a", Constant("rudder", 0.1), duration=0.3, sample_time=0.1)
    assert len(experiment.times) == 4
    assert experiment.times[-1] == pytest.approx(0.3)


def test_duration_comes_from_the_manoeuvre() -> None:
    """A doublet knows how long it takes; a zigzag does not, and the message says what to do."""
    doublet = Experiment("a", Doublet("rudder", 0.1, pulse_time=4.0))
    assert doublet.duration == pytest.approx(Doublet("rudder", 0.1, pulse_time=4.0).duration)
    with pytest.raises(DesignError, match="no natural end"):
        Experiment("b", ZigZag("rudder", 0.2, 0.2))


def test_several_manoeuvres_and_constants_become_columns() -> None:
    """Commands stand in the order of the model's inputs, whoever gives them."""
    both = Experiment(
        "both",
        [Constant("thrust", 5.0), Piecewise("rudder", [0.0, 1.0], [0.0, 0.2])],
        duration=2.0,
        sample_time=1.0,
    )
    np.testing.assert_allclose(
        both.commands(SHIP.input_names), [[0.0, 5.0], [0.2, 5.0], [0.2, 5.0]]
    )
    held = Experiment("held", duration=2.0, sample_time=1.0, constants={"rudder": 0.1, "thrust": 2})
    np.testing.assert_allclose(held.commands(("thrust", "rudder")), [[2.0, 0.1]] * 3)


def test_an_input_without_value_is_an_error() -> None:
    """No input is silently zero."""
    experiment = Experiment("a", Constant("rudder", 0.1), duration=3.0)
    with pytest.raises(DesignError, match=r"constants=\{'thrust': value\}"):
        experiment.commands(SHIP.input_names)
    with pytest.raises(DesignError, match="thrust"):
        experiment.check_model(SHIP)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"duration": 5.0, "sample_time": 0.0}, "sample_time"),
        ({"duration": 5.0, "feedback": "guessed"}, "measured, true"),
        ({"duration": 5.0, "constants": {"rudder": 0.0}}, "Remove one"),
        ({"duration": 5.0, "initial": {"r": math.nan}}, "'r' = nan"),
    ],
)
def test_settings_are_checked(settings: dict, message: str) -> None:
    """A setting that cannot be meant is named."""
    with pytest.raises(DesignError, match=message):
        Experiment("a", TurningCircle("rudder", 0.2), **settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"initial": {"w": 1.0}}, "starts at 'w'"),
        ({"noise": {"u": 1.0}}, "adds noise to 'u'"),
        ({"constants": {"thrust": 1.0, "sail": 1.0}}, "commands 'sail'"),
        ({"limits": Limits(signals={"depth": (0, 5)})}, "signal 'depth' is on nothing"),
        ({"limits": Limits(rates={"fin": 1.0})}, "input 'fin' is on nothing"),
    ],
)
def test_misfit_with_a_model_is_named(settings: dict, message: str) -> None:
    """Names that the model does not have are found before anything runs."""
    complete = {"duration": 5.0, "constants": {"thrust": 1.0}} | settings
    with pytest.raises(DesignError, match=message):
        Experiment("a", TurningCircle("rudder", 0.2), **complete).check_model(SHIP)


def test_feedback_has_to_be_measurable() -> None:
    """A zigzag on a signal that is neither output nor state is refused."""
    zigzag = ZigZag("rudder", 0.2, 0.2, feedback=("heading",))
    experiment = Experiment("a", zigzag, duration=5.0, constants={"thrust": 1.0})
    with pytest.raises(DesignError, match="reacts to 'heading'"):
        experiment.check_model(SHIP)
    with pytest.raises(DesignError, match="not known in advance"):
        experiment.commands(SHIP.input_names)


def test_commands_beyond_a_limit_are_refused_with_its_name() -> None:
    """Amplitude, rate, constant and start are each compared with their limit."""
    limits = Limits(inputs={"rudder": (-0.3, 0.3)}, rates={"rudder": 0.1}, signals={"u": (0, 5)})
    with pytest.raises(DesignError, match=r"input 'rudder' reaches 0.4 .* above its limit of 0.3"):
        Experiment("a", TurningCircle("rudder", 0.4, rate=0.05), duration=30.0, limits=limits)
    with pytest.raises(DesignError, match="rate of 'rudder'"):
        Experiment("a", TurningCircle("rudder", 0.2, start=1.0), duration=30.0, limits=limits)
    with pytest.raises(DesignError, match=r"input 'rudder' reaches -0\.5"):
        Experiment("a", duration=3.0, constants={"rudder": -0.5}, limits=limits)
    with pytest.raises(DesignError, match="signal 'u' reaches 6"):
        Experiment("a", duration=3.0, initial={"u": 6.0}, limits=limits)
    slow = RateLimited(TurningCircle("rudder", 0.3), 0.1)
    assert Experiment("a", slow, duration=30.0, limits=limits).limits is limits


def test_violations_pass_over_missing_samples() -> None:
    """NaN is no violation, and the worst sample is the one that is reported."""
    limits = Limits(signals={"z": (2.0, 20.0)})
    times = np.arange(4.0)
    assert limits.violations(times, {"z": np.array([np.nan, 5.0, 20.0, 2.0])}) == ()
    (text,) = limits.violations(times, {"z": np.array([np.nan, 1.5, 0.5, 3.0])})
    assert "0.5 at t = 2 s, below its limit of 2" in text


def test_stored_experiment_is_the_same() -> None:
    """Through JSON and back nothing is lost."""
    experiment = Experiment(
        "a",
        [ZigZag("rudder", 0.2, 0.1, rate=0.05), Constant("thrust", 3.0)],
        duration=60.0,
        sample_time=0.5,
        initial={"u": 2.0},
        noise={"psi": 0.02},
        limits=Limits(inputs={"rudder": (-0.3, 0.3)}, signals={"u": (0.0, math.inf)}),
    )
    stored = json.loads(json.dumps(experiment.to_dict()))
    assert Experiment.from_dict(stored) == experiment
    with pytest.raises(DesignError, match="cannot be read"):
        Experiment.from_dict(stored | {"colour": "red"})
