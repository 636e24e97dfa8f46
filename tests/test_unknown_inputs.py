"""Unknown inputs as estimated series: recovered, with the parameters beside them."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import (
    Dataset,
    Input,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    Record,
    State,
    UnknownForce,
    UnknownInput,
)
from oed_sysid.errors import DataError, ModelError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.prediction import unknown_series

TRUE = {"K": 0.3, "T": 4.0, "a": 1.5}
NOISE = np.array([0.002, 0.003])
BOAT = Model(
    "boat",
    (State("r", "rad/s", scale=0.1), State("psi", "rad")),
    (Input("rudder", "rad"), Input("trim", "rad")),
    (Output("r", "rad/s"), Output("psi", "rad")),
    {"r": "(K*(rudder + trim) - r - a*r*abs(r))/T", "psi": "r"},
    parameters=(
        Parameter("K", 0.2, "1/s"),
        Parameter("T", 3.0, "s", lower=0.3),
        Parameter("a", 0.5, "s"),
    ),
    step=0.1,
)
SERIES = {"duration": 80.0, "spacing": 8.0, "scale": 0.1}


def hidden(times: np.ndarray, phase: float) -> np.ndarray:
    """A trim that nobody logged, rad."""
    return 0.08 * np.sin(2 * np.pi * times / 50 + phase) + 0.05


@pytest.fixture(scope="module")
def data() -> Dataset:
    """Two records with different origins of time, the trim logged as zero."""
    rng = np.random.default_rng(0)
    records = []
    for phase, origin in ((0.0, 0.0), (1.0, 500.0)):
        times = origin + np.arange(0.0, 80.0, 0.2)
        rudder = np.repeat(rng.choice([-0.2, 0.0, 0.2], 40), 10)
        inputs = {"rudder": rudder, "trim": hidden(times - origin, phase)}
        run = simulate_inputs(BOAT.with_values(TRUE), times, inputs=inputs)
        measured = run.outputs + NOISE * rng.standard_normal(run.outputs.shape)
        logged = np.column_stack([rudder, np.zeros(times.size)])
        records.append(Record(f"run_{phase:.0f}", times, logged, measured, BOAT.channels))
    return Dataset(tuple(records))


def fitted(model: Model, data: Dataset) -> Fit:
    """A fit with known noise and no disturbance forces."""
    return MultipleShooting(noise=NOISE, disturbances="none").fit(model, data)


def test_series_and_parameters_are_recovered(data: Dataset) -> None:
    """The unlogged trim comes back within a tenth of its swing, and the parameters are right."""
    fit = fitted(BOAT + UnknownInput("trim", "rad", **SERIES), data)
    assert fit.status.ok
    for name, true in TRUE.items():
        assert abs(fit.values[name] - true) < 3.5 * fit.std_errors[name]
    assert fit.std_errors["K"] < 0.015
    series = unknown_series(fit, "unknown_input_trim")
    for record, phase, (times, values) in zip(data, (0.0, 1.0), series, strict=True):
        truth = hidden(record.times - record.times[0], phase)
        away = np.interp(record.times, times, values) - truth
        assert np.sqrt(np.mean(away**2)) < 0.1 * np.std(truth)


def test_without_the_series_the_parameters_are_wrong(data: Dataset) -> None:
    """The same fit without it misses by far more than it states, or does not end well."""
    fit = fitted(BOAT, data)
    misses = [abs(fit.values[n] - true) / fit.std_errors[n] for n, true in TRUE.items()]
    assert not fit.status.ok or max(misses) > 10


def test_force_and_input_say_the_same(data: Dataset) -> None:
    """A series in the equation of r is the series of the trim times K/T."""
    by_input = fitted(BOAT + UnknownInput("trim", "rad", **SERIES), data)
    series = SERIES | {"scale": 0.1 * 0.3 / 4.0}
    by_force = fitted(BOAT + UnknownForce("r", "rad/s^2", **series), data)
    assert by_force.values["K"] == pytest.approx(by_input.values["K"], rel=0.01)
    (_, one), _ = unknown_series(by_force, "unknown_force_r")
    (_, other), _ = unknown_series(by_input, "unknown_input_trim")
    gain = by_input.values["K"] / by_input.values["T"]
    np.testing.assert_allclose(one, gain * other, atol=0.05 * gain * 0.1)


def test_prior_holds_what_the_record_does_not_say(data: Dataset) -> None:
    """Nodes behind the end of a record stay where the last one was."""
    longer = SERIES | {"duration": 160.0}
    fit = fitted(BOAT + UnknownInput("trim", "rad", **longer), data)
    (_, values), _ = unknown_series(fit, "unknown_input_trim")
    np.testing.assert_allclose(values[12:], values[11], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [({"spacing": 0.0}, "spacing 0.0"), ({"scale": -1.0}, "scale"), ({"spacing": 0.1}, "nodes")],
)
def test_impossible_series_are_refused(change: dict, words: str) -> None:
    """Times and levels are positive, and nodes few."""
    with pytest.raises(ModelError, match=words):
        UnknownInput("trim", "rad", **(SERIES | change))


def test_unknown_names_are_refused(data: Dataset) -> None:
    """A fit without such an effect says which it has."""
    fit = fitted(BOAT + UnknownInput("trim", "rad", **SERIES), data)
    with pytest.raises(DataError, match="unknown_input_trim"):
        unknown_series(fit, "unknown_input_rudder")
