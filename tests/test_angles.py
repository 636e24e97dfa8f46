"""Angles that wrap: made continuous where declared, refused elsewhere, never guessed."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from oed_sysid import (
    Channels,
    Dataset,
    Input,
    Model,
    MultipleShooting,
    OedSysidError,
    Output,
    Parameter,
    Record,
    State,
    read_csv,
)
from oed_sysid.data.record import clear_wraps, unwrapped

T = np.arange(200) * 0.5
TURNING = np.radians(300.0 + 1.5 * T)  # from 300 to 449 degrees: passes north once
WRAPPED = np.mod(TURNING, 2.0 * np.pi)


def channels(*, wrap: bool) -> Channels:
    """A rudder and a heading."""
    return Channels((Input("rudder", "rad"),), (Output("psi", "rad", wrap=wrap),))


def record(psi: np.ndarray, *, wrap: bool) -> Record:
    """A record with a given heading."""
    return Record("run", T, np.zeros(T.size), psi, channels(wrap=wrap))


def test_wrapped_heading_is_made_continuous_and_said() -> None:
    """A declared compass that passes north comes out without the jump, with a note."""
    found = record(WRAPPED, wrap=True)
    assert np.allclose(found.output("psi"), TURNING, atol=1e-12)
    assert "unwrapped: 1 full turn" in found.notes[0]
    assert found.window(10.0, 90.0).notes == found.notes


def test_plus_minus_180_is_unwrapped_with_gaps() -> None:
    """The cut at 180 degrees and missing samples make no difference."""
    psi = np.mod(TURNING - 2.0 + np.pi, 2.0 * np.pi) - np.pi
    psi[::7] = np.nan
    rest = record(psi, wrap=True).output("psi") - (TURNING - 2.0)
    assert np.nanmax(np.abs(rest - np.nanmean(rest))) < 1e-12


def test_undeclared_wrap_is_refused_with_the_line_to_write() -> None:
    """A jump of a full turn without wrap=True stops with the declaration that helps."""
    with pytest.raises(OedSysidError, match=r'Output\("psi", "rad", wrap=True\)'):
        record(WRAPPED, wrap=False)


def test_degrees_passed_as_radians_are_recognised_at_the_cut() -> None:
    """A jump by 360 in radians is a heading in degrees."""
    with pytest.raises(OedSysidError, match=r"psi \[deg\]"):
        record(np.degrees(WRAPPED), wrap=False)


def test_sparse_or_fast_headings_are_left_alone() -> None:
    """Jumps that may be real turns are not called wraps."""
    rng = np.random.default_rng(0)
    assert clear_wraps(np.radians([10.0, 350.0, 20.0, 340.0, 200.0])) is None
    assert clear_wraps(rng.uniform(0.0, 2.0 * np.pi, 50)) is None
    assert clear_wraps(np.cumsum(rng.standard_normal(500)) * 0.1) is None
    step = np.concatenate([np.zeros(50), np.full(50, 3.0)])
    assert clear_wraps(step) is None


def test_thinning_a_continuous_heading_does_not_turn_it_back() -> None:
    """More than half a turn between thinned samples stays what it is."""
    fast = record(np.mod(np.radians(20.0) * np.arange(T.size), 2.0 * np.pi), wrap=True)
    thin = fast.thin(15)
    assert np.allclose(np.diff(thin.output("psi")), np.radians(300.0))


def test_noise_at_north_does_not_add_turns() -> None:
    """A compass that flickers around north is unwrapped to the flicker."""
    rng = np.random.default_rng(1)
    true = 0.01 * rng.standard_normal(300)
    assert np.ptp(unwrapped(np.mod(true, 2.0 * np.pi))) < 0.1


def test_reading_a_wrapped_file_says_so(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A CSV file in degrees is unwrapped in radians, and the user is told."""
    path = tmp_path / "run.csv"
    rows = [f"{t},0,{np.degrees(p)}" for t, p in zip(T, WRAPPED, strict=True)]
    path.write_text("\n".join(["t [s],rudder [deg],psi [deg]", *rows]), encoding="utf-8")
    with pytest.warns(UserWarning, match="unwrapped"):
        data = read_csv(path, channels(wrap=True))
    assert np.ptp(data[0].output("psi")) == pytest.approx(np.ptp(TURNING))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert data[0].thin(2).n_samples == 100


def test_only_angles_wrap() -> None:
    """A length that wraps is refused where it is declared."""
    with pytest.raises(OedSysidError, match="only an angle"):
        Output("z", "m", wrap=True)


def test_turns_within_a_gap_are_counted_by_the_rates_beside_it() -> None:
    """A ship that turns on while its compass is silent for 80 s comes out where it is."""
    t = np.arange(0.0, 200.0, 0.5)
    rng = np.random.default_rng(0)
    true = np.radians(6.0) * t
    logged = np.mod(true + 0.005 * rng.standard_normal(t.size), 2.0 * np.pi)
    logged[(t > 60.0) & (t < 140.0)] = np.nan
    whole = unwrapped(logged, times=t)
    assert np.nanmax(np.abs(whole - true)) < 0.03
    assert np.nanmax(np.abs(unwrapped(logged) - true)) > 6.0


def test_gap_between_unlike_rates_adds_no_turn() -> None:
    """Where the rates beside a gap disagree, or nothing turns, no turn is invented."""
    t = np.arange(0.0, 200.0, 0.5)
    slow = 0.5 * np.sin(0.05 * t)
    slow[(t > 60.0) & (t < 110.0)] = np.nan
    np.testing.assert_array_equal(unwrapped(slow, times=t), slow)
    turning = np.where(t < 60.0, 0.2 * t, 12.0)
    turning[(t > 58.0) & (t < 140.0)] = np.nan
    found = unwrapped(np.mod(turning, 2.0 * np.pi), times=t)
    assert abs(found[-1] - found[110]) < np.pi


def test_residuals_of_a_heading_are_on_the_circle_and_others_are_not() -> None:
    """A prediction one turn away is right for a compass, and wrong for what does not wrap."""
    signals = Channels(
        (Input("rudder", "rad"),), (Output("psi", "rad", wrap=True), Output("phi", "rad"))
    )
    run = Record("run", T, np.zeros(T.size), np.column_stack([WRAPPED, TURNING]), signals)
    whole = run.outputs + 2.0 * np.pi + 0.01
    errors = run.residuals(whole)
    assert errors[:, 0] == pytest.approx(-0.01, abs=1e-9)
    assert errors[:, 1] == pytest.approx(-0.01 - 2.0 * np.pi)


@pytest.mark.parametrize("start", [300.0, -60.0, 660.0])
def test_a_start_heading_is_moved_to_the_turn_of_the_record(start: float) -> None:
    """The same compass course on any turn begins the same trajectory, with errors of noise size."""
    model = Model(
        "heading",
        states=(State("psi", "rad", "heading"),),
        inputs=(Input("rudder", "rad"),),
        outputs=(Output("psi", "rad", noise_std=0.01, wrap=True),),
        kinematics={"psi": "rate + rudder"},
        parameters=(Parameter("rate", 0.02, "rad/s"),),
    )
    noise = 0.01 * np.random.default_rng(2).standard_normal(T.size)
    log = Record("run", T, np.zeros(T.size), np.mod(TURNING + noise, 2 * np.pi), model.channels)
    fit = MultipleShooting(disturbances="none").fit(
        model, Dataset((log,)), start_states={"psi": np.radians(start)}
    )
    assert fit.rms["psi"] == pytest.approx(0.01, rel=0.2)
    assert fit.values["rate"] == pytest.approx(np.radians(1.5), rel=0.01)
    errors = fit.predict(Dataset((log,)), initial={"psi": np.radians(start)}).residuals[0]
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.01, rel=0.2)
