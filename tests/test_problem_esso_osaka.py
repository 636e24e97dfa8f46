"""Esso Osaka: what its forces do, how its logs are read, and that wind explains its runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from marks import MEASURED

from oed_sysid import Dataset, MultipleShooting, load_problem, simulate, simulate_inputs
from oed_sysid.errors import DataError
from problems.esso_osaka.records import HEADER, VALIDATION, read, windows

PROBLEM = load_problem("esso_osaka")
CALM = {"wind_north": 0.0, "wind_east": 0.0}


def after(model, seconds: float, *, start: dict, **inputs: float) -> dict[str, float]:
    """States after some time with constant inputs."""
    times = np.arange(0.0, seconds + 0.25, 0.5)
    given = CALM | {"delta": 0.0, "n": 0.0} | inputs
    run = simulate_inputs(model, times, inputs=given, initial=start)
    return {name: run.signal(name)[-1] for name in model.state_names}


def test_rudder_to_starboard_turns_to_starboard() -> None:
    """A positive rudder gives a positive yaw rate, a negative one the mirror image."""
    right = after(PROBLEM.model, 60.0, start={"u": 0.35}, n=10.0, delta=0.35)
    left = after(PROBLEM.model, 60.0, start={"u": 0.35}, n=10.0, delta=-0.35)
    assert right["r"] > np.radians(1.0)
    assert right["v"] < 0
    assert left["r"] == pytest.approx(-right["r"], rel=1e-6)
    assert left["u"] == pytest.approx(right["u"], rel=1e-6)


def test_astern_propeller_stops_the_ship_and_then_drives_it_back() -> None:
    """From 0.3 m/s ahead, ten revolutions astern end in steady motion astern."""
    early = after(PROBLEM.model, 20.0, start={"u": 0.3}, n=-10.0)
    late = after(PROBLEM.model, 300.0, start={"u": 0.3}, n=-10.0)
    assert 0.0 < early["u"] < 0.3
    assert -0.4 < late["u"] < -0.05


def test_without_thrust_and_wind_a_drifting_ship_loses_energy() -> None:
    """Kinetic energy of surge, sway and yaw falls all the time."""
    model = PROBLEM.model
    times = np.arange(0.0, 100.0, 0.5)
    run = simulate_inputs(
        model,
        times,
        inputs=CALM | {"delta": 0.0, "n": 0.0},
        initial={"u": 0.3, "v": 0.1, "r": 0.03},
    )
    value = model.values
    water = 0.5 * value["rho"] * value["L"] ** 2 * value["d"]
    m_x, m_y = value["m"] + water * value["m_x_prime"], value["m"] + water * value["m_y_prime"]
    yaw = value["I_z"] + value["m"] * value["x_G"] ** 2
    yaw += water * value["L"] ** 2 * value["J_z_prime"]
    u, v, r = (run.signal(name) for name in "uvr")
    energy = 0.5 * (m_x * u**2 + m_y * v**2 + yaw * r**2) + value["m"] * value["x_G"] * v * r
    assert np.all(np.diff(energy) < 0)
    assert energy[-1] < 0.5 * energy[0]


def test_wind_blows_the_ship_away() -> None:
    """Air from the west moves a ship that heads north to the east, from astern ahead."""
    windy = PROBLEM.variant("wind").model.with_values({"E_wind_X": 1.0, "E_wind_Y1": 0.8})
    abeam = after(windy, 20.0, start={}, wind_east=3.0)
    astern = after(windy, 20.0, start={}, wind_north=3.0)
    assert abeam["v"] > 0.005
    assert astern["u"] > 0.001
    # Steady acceleration of the first instants: half rho A C V^2 over mass and added mass.
    value = windy.values
    mass = value["m"] + 0.5 * 1000 * 9 * 0.201 * value["m_x_prime"]
    first = after(windy, 0.5, start={}, wind_north=3.0)["u"]
    assert first == pytest.approx(0.5 * 0.5 * 1.225 * 0.135 * 9.0 / mass, rel=0.02)


def test_absent_wind_is_no_wind() -> None:
    """With all coefficients zero the model with wind sails as the one without."""
    experiment = PROBLEM.experiment("zigzag_20_20")
    plain = simulate(PROBLEM.model, experiment, noise=False)
    windy = simulate(PROBLEM.variant("wind").model, experiment, noise=False)
    assert windy.outputs == pytest.approx(plain.outputs, abs=1e-9)


def test_logs_are_unwound_and_averaged(tmp_path: Path) -> None:
    """A heading through pi has no jump, wind from north blows south, means last half a second."""
    times = np.arange(0.0, 20.0, 0.1)
    psi = (3.0 + 0.05 * times + np.pi) % (2 * np.pi) - np.pi
    columns = [times, times, times, times, 0 * times, psi, 0 * times + 0.05, 10 + 0 * times]
    columns += [0 * times, 0 * times, 0 * times, 2.0 + 0 * times, 0 * times]
    table = np.column_stack(columns)
    table = np.vstack([table, np.full((3, 13), np.nan)])
    path = tmp_path / "turn.csv"
    np.savetxt(path, table, delimiter=",", header=",".join("abcdefghijklm"))
    record = read(path, PROBLEM.model.channels)
    assert record.n_samples == 40
    assert np.abs(np.diff(record.output("psi"))).max() < 0.03
    assert record.input("wind_north") == pytest.approx(np.full(40, -2.0))
    assert record.output("u")[1:-1] == pytest.approx(record.times[1:-1])
    order = [0, 2, 1, *range(3, 13)]
    names = ",".join(HEADER[k] for k in order)
    np.savetxt(path, table[:, order], delimiter=",", header=names, comments="")
    assert read(path, PROBLEM.model.channels).content_hash == record.content_hash
    np.savetxt(path, table[:, :5], delimiter=",", header="a,b,c,d,e")
    with pytest.raises(DataError, match="expected the 13"):
        read(path, PROBLEM.model.channels)


@pytest.mark.slow
@MEASURED
def test_wind_makes_left_out_runs_predictable() -> None:
    """Errors 100 s ahead fall with the wind on files that nothing was fitted to."""
    train, test = PROBLEM.data().split(test=VALIDATION)
    assert len(test) == 5
    published = np.array([0.044, 0.029, np.radians(0.97)])
    mean = {}
    for label in ("default", "wind"):
        model = PROBLEM.variant(label).model
        fit = MultipleShooting(disturbances="none", noise="given").fit(model, windows(train, 25.0))
        ratios = {}
        for part in windows(test, 100.0):
            start = dict(zip(model.state_names, part.outputs[0], strict=True))
            run = simulate_inputs(fit.model, part.times, inputs=part.inputs, initial=start)
            square = np.mean((run.outputs - part.outputs)[:, :3] ** 2, axis=0)
            ratios.setdefault(part.name.rpartition("_")[0], []).append(square)
        errors = {run: np.sqrt(np.mean(rows, axis=0)) / published for run, rows in ratios.items()}
        mean[label] = np.mean(list(errors.values()))
    assert mean["default"] == pytest.approx(0.69, abs=0.05)
    assert mean["wind"] == pytest.approx(0.40, abs=0.02)
    assert max(errors["random_6"]) < 0.5
    assert max(errors["turn_10_port_35"]) < 0.5
    assert fit.values["E_wind_X"] == pytest.approx(0.98, abs=0.05)
    low, high = fit.interval("E_wind_Y1")
    assert 0.4 < low < high < 0.8


@MEASURED
def test_every_log_is_read(tmp_path: Path) -> None:
    """Twelve runs at 2 Hz, headings continuous, wind of the size that the README states."""
    data = PROBLEM.data()
    assert len(data) == 12
    assert isinstance(data, Dataset)
    for record in data:
        assert record.sample_time == pytest.approx(0.5)
        assert np.abs(np.diff(record.output("psi"))).max() < 0.2
        wind = np.hypot(record.input("wind_north"), record.input("wind_east"))
        assert 1.0 < wind.mean() < 2.6
