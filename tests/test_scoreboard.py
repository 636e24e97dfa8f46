"""The scoreboard: held-back files are scored as soon as they are there, and named until then."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks.scoreboard import __main__ as board
from benchmarks.scoreboard import boehm, esso_osaka, roll_decay, silverbox, tanks, turns
from oed_sysid import Record, load_problem
from oed_sysid.data.third_party import data_folder
from oed_sysid.experiments.simulation import simulate_inputs

MEASURED = pytest.mark.skipif("OED_SYSID_DATA" not in os.environ, reason="measured data absent")


def test_missing_files_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without data a board has no figure and says which file belongs where."""
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    (row,) = boehm.score()
    assert row.ours is None
    assert "boehm_2014/" in row.note
    output = tmp_path / "table.md"
    board.main(["boehm", "--output", str(output)])
    board.main(["boehm", "--output", str(output)])  # a second run replaces its section
    page = output.read_text(encoding="utf-8")
    assert page.count("| missing |") == 1
    assert page.count("## boehm") == 1


def test_unknown_board_is_refused(capsys: pytest.CaptureFixture) -> None:
    """A wrong name ends with the names that there are."""
    with pytest.raises(SystemExit):
        board.main(["tank"])
    assert "silverbox" in capsys.readouterr().err


def test_a_perfect_prediction_scores_nothing() -> None:
    """A run of the model itself has no error 100 s ahead; a shift of u has its share."""
    model = load_problem("esso_osaka").variant("wind").model
    times = np.arange(0.0, 200.5, 0.5)
    inputs = np.column_stack([0.3 * np.sin(times / 20), 10.0 + 0 * times, times / 100, 0 * times])
    run = simulate_inputs(model, times, inputs=inputs, initial={"u": 0.3})
    record = Record("self", times, inputs, run.outputs, model.channels)
    assert esso_osaka.ahead(model, record) == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    away = run.outputs.copy()
    away[50:, 1] += 0.029
    ratio = esso_osaka.ahead(model, record.with_outputs(away))
    assert 0.6 < ratio[1] < 1.2


def test_silverbox_parts_keep_their_samples() -> None:
    """Between the samples the input is band-limited; at the samples it is what was measured."""
    model = load_problem("silverbox").model
    time = np.arange(5000) / silverbox.SAMPLING
    wave = np.sin(2 * np.pi * 40.0 * time)
    record = silverbox.part_of(wave, wave, (1000, 3000), model)
    assert record.n_samples == 2000 * silverbox.FINER
    measured = record.outputs[:: silverbox.FINER, 0]
    assert measured == pytest.approx(wave[1000:3000])
    assert record.inputs[:: silverbox.FINER, 0] == pytest.approx(wave[1000:3000], abs=0.02)
    edge = silverbox.part_of(wave, wave, (100, 3000), model)  # fewer samples before than padding
    assert edge.inputs[1000 :: silverbox.FINER, 0] == pytest.approx(wave[350:3000], abs=0.02)


@MEASURED
def test_held_back_tanks_are_scored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A validation file that the model made scores zero, one that is 0.1 V off scores 0.1."""
    name = "cascaded_tanks/estimation.csv"
    (tmp_path / "cascaded_tanks").mkdir()
    shutil.copy(data_folder() / name, tmp_path / name)
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    model = load_problem("cascaded_tanks").variant("torricelli").model
    record = tanks.read(name, model)
    found = tanks.fit(model, record)
    assert found.rms["level"] == pytest.approx(0.56, abs=0.03)
    start = dict(zip(model.state_names, found.initial_states[0], strict=True))
    run = simulate_inputs(found.model, record.times, inputs=record.inputs, initial=start)
    for shift in (0.0, 0.1):
        table = np.column_stack(
            [record.times, record.inputs[:, 0], np.minimum(run.outputs[:, 0], 10.0) + shift]
        )
        np.savetxt(
            tmp_path / tanks.VALIDATION, table, delimiter=",", header="t_s,u_V,y_V", comments=""
        )
        validation, name = tanks.read_validation(model.channels)
        assert name == "validation.csv"
        assert tanks.validation_error(found, validation) == pytest.approx(shift, abs=1e-3)
    grown = tanks.fit(tanks.grow(found.model, "level_zero"), record, start="near")
    assert grown.rms["level"] < found.rms["level"]


@MEASURED
def test_roll_decay_needs_nonlinear_terms() -> None:
    """Small angles are met three times better with cubic restoring and quadratic damping."""
    linear, quadratic, both = (row.ours for row in roll_decay.score()[:3])
    assert linear == pytest.approx(0.0866, abs=1e-3)
    assert both < 0.4 * linear
    assert quadratic > 2 * both


def decay(folder: Path) -> None:
    """Files of a small problem: a decays into b at a rate, and the share of b is measured."""
    libsbml = pytest.importorskip("libsbml")
    folder.mkdir()
    document = libsbml.SBMLDocument(2, 4)
    sbml = document.createModel()
    for kind, name in (("Compartment", "cell"), ("Species", "a"), ("Species", "b")):
        one = getattr(sbml, f"create{kind}")()
        one.setId(name)
        if kind == "Species":
            one.setCompartment("cell")
            one.setInitialConcentration(4.0 if name == "a" else 0.0)
        else:
            one.setSize(2.0)
    parameter = sbml.createParameter()
    parameter.setId("k")
    reaction = sbml.createReaction()
    reaction.setId("decay")
    for taking_part, name in ((reaction.createReactant(), "a"), (reaction.createProduct(), "b")):
        taking_part.setSpecies(name)
        taking_part.setStoichiometry(1.0)
    reaction.createKineticLaw().setMath(libsbml.parseL3Formula("cell * k * a^2"))
    libsbml.writeSBMLToFile(document, str(folder / boehm.FILES["model"]))
    (folder / boehm.FILES["observables"]).write_text(
        "observableId\tobservableFormula\nshare\t100 * b / (a + b)\n", encoding="utf-8"
    )
    (folder / boehm.FILES["parameters"]).write_text(
        "parameterId\tlowerBound\tupperBound\tnominalValue\testimate\n"
        "k\t1e-4\t1\t0.05\t1\nsd_share\t1e-5\t1e5\t1\t1\n",
        encoding="utf-8",
    )
    rng = np.random.default_rng(4)
    times = np.arange(0.0, 40.0, 2.0)
    # a' = -k a^2, by hand: the law is an amount per time, the volume divides it.
    share = 100.0 * (1.0 - 1.0 / (1.0 + 4.0 * 0.05 * times)) + 0.5 * rng.standard_normal(len(times))
    lines = [f"share\t{y}\t{t}" for t, y in zip(times, share, strict=True)]
    (folder / boehm.FILES["measurements"]).write_text(
        "\n".join(["observableId\tmeasurement\ttime", *lines]), encoding="utf-8"
    )


def test_petab_files_become_a_model_that_fits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Equations, start and bounds come from the files; the likelihood is the closed form's."""
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    monkeypatch.setattr(boehm, "STARTS", 3)
    folder = tmp_path / boehm.FOLDER
    decay(folder)
    paths = [folder / boehm.FILES[key] for key in ("model", "observables", "parameters")]
    model, start = boehm.read_model(*paths)
    assert start == {"a": 4.0, "b": 0.0}
    record = boehm.read_record(folder / boehm.FILES["measurements"], model)
    times = record.times
    true = simulate_inputs(
        model.with_values({"k": 0.05}), times, inputs=np.empty((len(times), 0)), initial=start
    )
    closed = 100.0 * (1.0 - 1.0 / (1.0 + 0.2 * times))
    assert true.outputs[:, 0] == pytest.approx(closed, abs=0.02)
    (row,) = boehm.score()
    assert row.ours is not None
    best = min(
        boehm.negative_log_likelihood(
            record.outputs - 100.0 * (1.0 - 1.0 / (1.0 + 4.0 * k * times))[:, None]
        )
        for k in np.linspace(0.04, 0.06, 201)
    )
    assert row.ours == pytest.approx(best, abs=0.01)


def test_turns_are_summed_up_by_quantity() -> None:
    """Rms over turns of the advance, then of the tactical diameter; the transfer is not scored."""
    measured = {
        f"{name} turn_{side}": 2.0
        for side in ("port", "starboard")
        for name in ("advance", "transfer", "tactical_diameter")
    }
    found = dict(measured)
    found["advance turn_port"], found["advance turn_starboard"] = 2.06, 1.92  # 3 and -4 per cent
    found["tactical_diameter turn_port"] = 2.2
    found["transfer turn_port"] = 9.0
    reached = turns._reached(found, measured)
    assert reached["advance"] == pytest.approx(np.sqrt((3.0**2 + 4.0**2) / 2))
    assert set(reached) == {"advance", "tactical_diameter"}
    assert reached["tactical_diameter"] == pytest.approx(np.sqrt(10.0**2 / 2))
