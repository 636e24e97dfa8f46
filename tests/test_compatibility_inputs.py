"""Signs and units of inputs, judged with sensors that are dead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oed_sysid import Dataset, Problem, Record, check, load_problem, simulate
from oed_sysid.likelihood.start_guess import kinematic_states, measured_states


@pytest.fixture(scope="module")
def dives() -> tuple[Problem, Dataset]:
    """Four simulated runs of the diving plane, and their problem."""
    problem = load_problem("remus_diving_plane")
    runs = [
        simulate(problem.model, run, rng=np.random.default_rng((0, k)), name=name)
        for k, (name, run) in enumerate(problem.experiments.items())
    ]
    return problem, Dataset(tuple(runs))


def with_dead(record: Record, name: str) -> Record:
    """A copy in which a sensor shows its first value for ever."""
    outputs = record.outputs.copy()
    column = record.channels.output_names.index(name)
    outputs[:, column] = outputs[0, column]
    return record.with_outputs(outputs)


@pytest.mark.parametrize("name", ["u", "w", "q", "theta", "z"])
def test_a_dead_output_is_the_only_finding(dives, name: str) -> None:  # type: ignore[no-untyped-def]
    """The inputs are judged without it, or not at all; nothing is singular."""
    problem, data = dives
    found = check(Dataset(tuple(with_dead(record, name) for record in data)), problem)
    assert [(one.kind, one.signals) for one in found.serious] == [("dead", (name,))]


def test_records_without_the_speed_are_left_out_of_the_judgement(dives) -> None:  # type: ignore[no-untyped-def]
    """Of a speed that follows from z' where the pitch is not zero the samples at level are lost.

    With it dead in one record the other three still show a fin of the other sign; with it dead in
    all of them nothing is claimed, and the report says so.
    """
    problem, data = dives
    fin = np.array(problem.model.input_names) == "fin_command"
    turned = [replace(r, inputs=np.where(fin, -r.inputs, r.inputs)) for r in data]
    one = check(Dataset((with_dead(turned[0], "u"), *turned[1:])), problem)
    assert {(f.kind, f.signals) for f in one.serious} == {
        ("dead", ("u",)),
        ("sign", ("fin_command",)),
    }
    every = check(Dataset(tuple(with_dead(record, "u") for record in turned)), problem)
    assert [f.kind for f in every.serious] == ["dead"]
    assert any(line.startswith("Signs and units of inputs") for line in every.unchecked)


def test_a_guess_says_where_it_is_lost(dives) -> None:  # type: ignore[no-untyped-def]
    """The speed from z' is lost at level pitch, the pitch rate from theta' nowhere."""
    problem, data = dives
    model = problem.model
    measured = measured_states(model, data[1])
    u, q = model.state_names.index("u"), model.state_names.index("q")
    known = {k: series for k, series in measured.items() if k not in (u, q)}
    found = kinematic_states(model, data[1], known)
    assert found[q].rms < 0.1 * np.std(data[1].output("q"))
    assert found[u].rms > np.ptp(data[1].output("u"))
