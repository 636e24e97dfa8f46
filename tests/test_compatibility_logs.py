"""The check of logs over many simulated logs, and on measured ones."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
import pytest

from benchmarks.compatibility import (
    DIVER,
    ESSO,
    HSVA,
    SHIP,
    SPOILS,
    Fault,
    free_running,
    hidden_effect_cases,
    log,
    match,
    motions,
    named_as,
    read_filled,
    spoil,
)
from oed_sysid import Dataset, Problem, check, load_problem, read_csv, simulate
from oed_sysid.evidence.check import LogCheck

DATA = Path(os.environ.get("OED_SYSID_DATA", "nowhere"))


def diving_log(*faults: Fault, seed: int = 0, colour: float = 0.0) -> Dataset:
    """A log of the diving plane with faults."""
    rng = np.random.default_rng(seed)
    return log(DIVER, motions(DIVER, rng), faults, colour, rng)


def ship_log(*faults: Fault, seed: int = 0, colour: float = 0.0) -> Dataset:
    """A log of a ship with faults."""
    rng = np.random.default_rng(seed)
    return log(SHIP, motions(SHIP, rng), faults, colour, rng)


# -- answers that are faster than the sampling --------------------------------------------------

PUBLISHED = ("auv_diving_plane", "catamaran", "nomoto_sparse_heading", "online_ship", "remus_6dof",
             "sailboat", "torpedo")  # fmt: skip


def published_log(name: str) -> tuple[Problem, Dataset]:
    """What the truth of a problem logs in its experiments."""
    problem = load_problem(name)
    model, runs = problem.true_model(), problem.experiments.values()
    records = [
        simulate(model, run, rng=np.random.default_rng((0, number)), name=run.name)
        for number, run in enumerate(runs)
    ]
    return problem, Dataset(tuple(records))


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_published_vehicles_log_nothing_wrong(name: str) -> None:
    """Nothing is suspect, the roll rate of a sailboat after its sheet was let go included.

    Sampled at 5 Hz it is a single high sample, which used to be called a spike, and without which
    the roll angle asks for another scale of the rate.
    """
    problem, data = published_log(name)
    assert not check(data, problem).suspect


def test_beside_fast_answers_faults_are_found() -> None:
    """Spikes anywhere, a wrong scale and a wrong sign of the same roll rate are named."""
    problem, data = published_log("sailboat")
    here = problem.model.output_names.index("p")

    def with_rate(change) -> LogCheck:  # type: ignore[no-untyped-def]
        runs = []
        for record in data:
            outputs = record.outputs.copy()
            outputs[:, here] = change(outputs[:, here])
            runs.append(record.with_outputs(outputs))
        return check(Dataset(tuple(runs)), problem)

    rows = np.arange(37, 500, 50)  # in the middle between steps of the sheet
    spoilt = with_rate(lambda p: p + 0.5 * np.isin(np.arange(p.size), rows))
    assert [f.kind for f in spoilt.findings if f.suspect] == ["spikes"]
    assert spoilt.findings[0].size >= 0.8 * rows.size * len(data)
    (scale,) = (f for f in with_rate(lambda p: 1.3 * p).findings if f.suspect)
    assert (scale.kind, scale.signals) == ("scale", ("p",))
    assert scale.size == pytest.approx(0.3, abs=0.06)
    turned = with_rate(lambda p: -p)
    assert {f.kind for f in turned.findings if f.suspect} == {"sign"}


# -- statistics and measured data ------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "colour"), [(DIVER, 0.0), (SHIP, 0.0), (DIVER, 0.8), (SHIP, 0.8)]
)
def test_clean_logs_raise_no_alarm(vehicle, colour: float) -> None:  # type: ignore[no-untyped-def]
    """At most one of forty clean logs is called suspect."""
    alarms = 0
    for seed in range(40):
        rng = np.random.default_rng((21, seed))
        data = log(vehicle, motions(vehicle, rng), (), colour, rng)
        alarms += check(data, vehicle.model, inputs=False).suspect
    assert alarms <= 1


@pytest.mark.slow
def test_intervals_hold() -> None:
    """Of forty fitted biases and lever arms at least 34 lie in their 95 % interval."""
    held = 0
    for seed in range(20):
        for make, vehicle, fault in (
            (diving_log, DIVER, Fault("bias", ("q",), 0.006)),
            (ship_log, SHIP, Fault("lever", ("v",), 4.0, "r")),
        ):
            one = match(check(make(fault, seed=seed), vehicle.model, inputs=False), fault)
            held += one is not None and one.interval[0] < fault.size < one.interval[1]
    assert held >= 34


needs_data = pytest.mark.skipif(
    not (DATA / "hidden_effects").is_dir(), reason="third-party data is not here"
)


@pytest.mark.slow
@needs_data
def test_spoilt_copies_of_hidden_effect_records_are_named() -> None:
    """All fifteen spoilt copies of another simulator's records are named exactly."""
    problem, data = hidden_effect_cases()["case_010"]
    missed = [n for n in SPOILS if not named_as(check(spoil(data, n), problem), n)]
    assert not missed


@pytest.mark.slow
@needs_data
def test_hidden_physics_is_no_fault_of_the_log() -> None:
    """Of fourteen cases only the two with sensor effects are suspect, with the right sizes."""
    found = {n: check(data, problem) for n, (problem, data) in hidden_effect_cases().items()}
    assert {n for n, one in found.items() if one.suspect} == {"case_007", "case_008"}
    bias = found["case_007"].serious[0]
    assert bias.interval is not None
    assert bias.interval[0] < 0.006419 < bias.interval[1]
    turned = found["case_008"].serious[0]
    assert abs(abs(turned.size or 0.0) - 0.03895) < 0.001
    assert "misalignment" in " ".join((turned.kind, *turned.alternatives))


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "kvlcc2_hsva_zigzag").is_dir(), reason="data is not here")
def test_earth_fixed_velocities_of_the_towing_tank_are_named_unaided() -> None:
    """In every file whose velocity columns are along the tank this is the one finding."""
    model = free_running(HSVA, "delta")
    files = sorted((DATA / "kvlcc2_hsva_zigzag").glob("HSVA*.csv"))
    for path in files:
        found = check(read_csv(path, model.channels), model)
        assert found.named("frame", "u") is not None, path.name
    assert len(files) == 10


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "esso_osaka").is_dir(), reason="data is not here")
def test_lag_of_the_esso_osaka_files_is_found_in_all_twelve() -> None:
    """Velocities and heading come 0.7 to 1.0 s after the positions; headings wrap in six."""
    model = free_running(ESSO, "delta_rudder", wrap=True)
    lags, wraps = [], 0
    for path in sorted((DATA / "esso_osaka").glob("*.csv")):
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always")
            data = read_filled(path, model)
        wraps += any("unwrapped" in str(n.message) for n in notes)
        found = check(data, model)
        one = found.named("delay", "u")
        assert one is not None, path.name
        lags.append(one.size)
    assert wraps == 6
    assert len(lags) == 12
    assert min(lags) > 0.7
    assert max(lags) < 1.0
