"""Where a model fails: stage, equation, and the smoothed residual force."""

from __future__ import annotations

import json

import numpy as np
import pytest
from diving_plane import PROBLEM, records

from oed_sysid.evidence.locate import locate
from oed_sysid.evidence.residual_forces import let_in
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.disturbances import places
from oed_sysid.physics import Force
from oed_sysid.physics.parameters import Parameter

DRAG = -120.0
CROSSFLOW = Force("drag", {"Z": "Z_d*w*abs(w)"}, (Parameter("Z_d", 0.0, "kg/m", scale=100.0),))


def begun(train, candidates=()):  # type: ignore[no-untyped-def]
    """The study of the nominal model, and its fit."""
    return Study.begin(PROBLEM.model, train, None, candidates, known_noise=False)


@pytest.fixture(scope="module")
def drag():  # type: ignore[no-untyped-def]
    """Records of a vehicle with a cross-flow drag that the model lacks."""
    train, _, _ = records(1, lambda u, w, q, *_: (0.0, DRAG * w * abs(w), 0.0), duration=40.0)
    study, fit = begun(train, (CROSSFLOW,))
    return train, study, fit


def test_a_missing_heave_force_is_found_in_the_heave_equation(drag) -> None:  # type: ignore[no-untyped-def]
    """A cross-flow drag is located in Z, and the true structure's signature agrees best."""
    train, study, fit = drag
    right = study.estimate(study.candidates, fit.values, fit, max_iterations=25)
    assert right is not None
    assert right.values["Z_d"] == pytest.approx(DRAG, rel=0.1)
    found = locate(fit, study.unit, {"drag": right})
    assert found.best == "force Z"
    assert "in the forces of the Z equation" in found.verdict
    assert found.agreement["drag"] > 0.9
    assert "not the missing force itself" in found.report()
    assert json.loads(json.dumps(found.to_dict()))["best"] == "force Z"
    assert found.forces[0].values.shape == (train[0].n_samples, 3)
    # What the derivatives absorbed is not in the residual force: it is far smaller than the drag.
    part = right.problem.passes(right.point.unknowns, columns=False)[0]
    w = part.path[:, 1]
    assert np.std(found.forces[0].values[:, 1]) < 0.8 * np.std(DRAG * w * np.abs(w))


def test_standard_errors_of_residual_forces_are_honest() -> None:
    """Without missing physics the smoothed force is noise of the size that it states."""
    train, _, _ = records(2, duration=40.0)
    study, fit = begun(train)
    found = locate(fit, study.unit)
    assert found.best is None
    assert found.group == ()
    assert "noise" in found.verdict
    for series in found.forces:
        assert np.mean(np.abs(series.values) < 2.5 * series.std) > 0.95


@pytest.mark.parametrize(
    ("place", "options"),
    [
        ("actuator ds", {"fin_of": lambda command: command + 0.03}),
        ("sensor q", {"sensors": lambda truth: truth + np.array([0, 0, 0.006, 0, 0])}),
        ("force M", {"extra": lambda u, w, q, *_: (0.0, 0.0, -70.0 * q * abs(q))}),
    ],
)
def test_other_stages_are_told_apart(place: str, options: dict) -> None:  # type: ignore[type-arg]
    """A bent fin, a biased gyro and a pitch damping are each found where they are."""
    extra = options.pop("extra", lambda *_: (0.0, 0.0, 0.0))
    train, _, _ = records(3, extra, duration=40.0, **options)
    study, fit = begun(train)
    assert locate(fit, study.unit).best == place


def test_places_cover_the_chain_of_any_model() -> None:
    """Every signal, equation, kinematic relation and output is a place with a unit."""
    found = {place.name: place.unit for place in places(PROBLEM.model)}
    assert found["actuator ds"] == "rad"
    assert found["flow w_r"] == "m/s"
    assert found["force M"] == "N m"
    assert found["kinematics theta"] == "rad/s"
    assert found["kinematics z"] == "m/s"
    assert found["sensor z"] == "m"


def test_filtered_trajectory_is_near_the_measurements(drag) -> None:  # type: ignore[no-untyped-def]
    """The path of the filter follows the records where the model itself does not."""
    train, study, fit = drag
    problem, unknowns = let_in(fit, study.unit)
    noise = np.array([0.02, 0.02, 0.004, 0.004, 0.03])
    for index, part in enumerate(problem.passes(unknowns, columns=False)):
        record = train[index]
        alone, _, _ = problem.alone(unknowns, index)
        own = np.sqrt(np.mean(((record.outputs - alone) / noise) ** 2))
        followed = np.sqrt(np.mean(((record.outputs - part.path[:, :5]) / noise) ** 2))
        assert followed < 1.05
        assert own > followed
