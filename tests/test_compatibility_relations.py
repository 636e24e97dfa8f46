"""Equations between signals: found in any model's text, or by standard names."""

from __future__ import annotations

import numpy as np

from benchmarks.compatibility import SHIP, Fault, log, motions
from oed_sysid import (
    Dataset,
    Input,
    Model,
    Output,
    Parameter,
    Record,
    State,
    check,
    read_csv,
    write_csv,
)
from oed_sysid.evidence.relations import relations, spare_signals


def ship_log(*faults: Fault, seed: int = 0, colour: float = 0.0) -> Dataset:
    """A log of a ship with faults."""
    rng = np.random.default_rng(seed)
    return log(SHIP, motions(SHIP, rng), faults, colour, rng)


def test_relations_come_from_the_model_in_its_own_names() -> None:
    """States, outputs and signals with unusual names are related through the model's text."""
    model = Model(
        "glider",
        states=(
            State("depth", "m"),
            State("nose", "rad"),
            State("turn", "rad/s"),
            State("V", "m/s"),
        ),
        inputs=(),
        outputs=(
            Output("gauge", "m", expression="depth"),
            Output("tilt", "rad", expression="nose"),
            Output("gyro", "rad/s", expression="turn"),
            Output("log", "m/s", expression="V"),
            Output("climb", "m/s", expression="V*sin(nose)"),
        ),
        kinematics={"depth": "-rise", "nose": "turn", "turn": "-turn/T", "V": "-V/T"},
        signals={"rise": "V*sin(nose)"},
        parameters=(Parameter("T", 1.0, "s"),),
    )
    found = {str(r) for r in relations(model)}
    assert found == {"gauge' = -rise", "tilt' = turn", "climb = V sin(nose)"}
    names = {r.target: set(r.signals) for r in relations(model)}
    assert names == {"gauge": {"log", "tilt"}, "tilt": {"gyro"}, "climb": {"log", "tilt"}}


def test_equations_with_unknown_parameters_are_left_alone() -> None:
    """A current that is to be estimated makes the equation of the position useless here."""
    model = Model(
        "drifting",
        states=(State("x", "m"), State("u", "m/s")),
        inputs=(),
        outputs=(Output("x", "m"), Output("u", "m/s")),
        kinematics={"x": "u + current", "u": "-u"},
        parameters=(Parameter("current", 0.0, "m/s"),),
    )
    assert relations(model) == ()
    assert len(relations(model.fix("current"))) == 1


def test_six_degrees_of_freedom_follow_from_standard_names() -> None:
    """Twelve measured signals with standard names have six equations, right on a random motion."""
    names = ("x", "y", "z", "phi", "theta", "psi", "u", "v", "w", "p", "q", "r")
    units = dict.fromkeys("xyz", "m") | dict.fromkeys("uvw", "m/s") | dict.fromkeys("pqr", "rad/s")
    units |= dict.fromkeys(("phi", "theta", "psi"), "rad")
    model = Model(
        "body",
        states=tuple(State(n, units[n]) for n in names),
        inputs=(),
        outputs=tuple(Output(n, units[n]) for n in names),
        kinematics={n: f"-a*{n}" for n in "uvwpqr"} | {n: f"a*{n}" for n in names[:6]},
        parameters=(Parameter("a", 1.0),),
    )
    # Identity kinematics with a parameter: the model does not say; names do not override it.
    assert relations(model) == ()
    free = Model(
        "sensors",
        states=(State("s", "m"),),
        inputs=(),
        outputs=(Output("s", "m"),),
        kinematics={"s": "-a*s"},
        parameters=(Parameter("a", 1.0),),
    )
    found = {r.target: r for r in relations(free, spare=names)}
    assert set(found) == {"x", "y", "z", "phi", "theta", "psi"}
    rng = np.random.default_rng(3)
    values = {n: rng.uniform(-0.7, 0.7, 40) for n in names}
    t = np.arange(40.0)
    speed = sum(found[n](values, t) ** 2 for n in "xyz")
    assert np.allclose(speed, values["u"] ** 2 + values["v"] ** 2 + values["w"] ** 2)
    # Angular velocity from the angles' rates (Fossen 2021, eq. 2.38, inverted).
    rates = {n: found[n](values, t) for n in ("phi", "theta", "psi")}
    p = rates["phi"] - np.sin(values["theta"]) * rates["psi"]
    assert np.allclose(p, values["p"])


def test_spare_columns_are_used(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A heading model checks the positions and speeds that its files hold beside it."""
    data = ship_log(Fault("scale", ("u",), 0.06))
    heading = Model(
        "heading",
        states=(State("psi", "rad"), State("r", "rad/s")),
        inputs=(Input("fin", "rad"),),
        outputs=(Output("psi", "rad"), Output("r", "rad/s")),
        kinematics={"psi": "r", "r": "(K*fin - r)/T"},
        parameters=(Parameter("K", 1.0, "1/s"), Parameter("T", 5.0, "s")),
    )
    for record in data:
        path = tmp_path / f"{record.name}.csv"
        write_csv(record, path)
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace("x [m]", "x_position_mid [m]", 1), encoding="utf-8")
    read = read_csv(tmp_path, heading.channels)
    assert set(spare_signals(read[0])) == {"x", "y", "u", "v"}
    found = check(read, heading)
    assert found.named("scale", "u") is not None
    assert len(found.relations) == 3


def test_missing_and_sparse_signals_are_no_faults() -> None:
    """Outputs at a slower rate and gaps of an output do not raise alarms."""
    records = []
    for record in ship_log():
        outputs = np.array(record.outputs)
        for name, every in (("x", 4), ("y", 4), ("u", 2)):
            column = record.channels.output_names.index(name)
            keep = np.zeros(record.n_samples, dtype=bool)
            keep[::every] = True
            outputs[~keep, column] = np.nan
        outputs[300:420, record.channels.output_names.index("psi")] = np.nan
        records.append(record.with_outputs(outputs))
    assert check(Dataset(tuple(records)), SHIP.model, inputs=False).ok


def test_log_without_equations_says_so() -> None:
    """Where nothing relates the signals, that is the verdict."""
    model = Model(
        "roll",
        states=(State("phi", "rad"),),
        inputs=(),
        outputs=(Output("phi", "rad"),),
        kinematics={"phi": "-a*phi"},
        parameters=(Parameter("a", 1.0, "1/s"),),
    )
    t = np.arange(300) * 0.1
    rng = np.random.default_rng(0)
    record = Record(
        "decay", t, [], np.exp(-0.1 * t) + 0.01 * rng.standard_normal(300), model.channels
    )
    found = check(Dataset((record,)), model)
    assert found.ok
    assert "no equation" in found.verdict
    assert any("phi" in text for text in found.unchecked)
