"""Saved results: bit-equal again, earlier versions read, damage said in words; old paths."""

from __future__ import annotations

import json
import sys
import warnings
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import oed_sysid
from oed_sysid import Fit, __version__
from oed_sysid.cli import main
from oed_sysid.errors import DataError
from oed_sysid.likelihood.archive import _digest, decode, encode, read_result
from oed_sysid.runtime.moved import MOVED, new_path

SAVED = Path(__file__).parent / "saved"
OLD = SAVED / "fit_format_1.json"
FIT = Fit.load(OLD)


def as_text(value: Any) -> str:
    """Everything in a result, to the last bit."""
    return json.dumps(encode(value))


def test_format_1_is_still_read() -> None:
    """A file of the first format gives the numbers that its program printed, to the last bit."""
    assert {name: value.hex() for name, value in FIT.values.items()} == {
        "K": "0x1.03cf7e989f761p-3",
        "T": "0x1.0e7b2dd5ce30cp+3",
        "alpha": "0x1.3dcee4453ac24p+6",
    }
    assert FIT.n_observations == 127
    assert np.isnan(FIT.dataset["zigzag"].outputs[5, 1])
    assert "converged" in FIT.report()


def test_saved_and_loaded_is_bit_equal(tmp_path: Path) -> None:
    """A fit comes back with every bit, also when it is saved and loaded twice."""
    FIT.save(tmp_path / "one.json")
    again = Fit.load(tmp_path / "one.json")
    assert as_text(again) == as_text(FIT)
    again.save(tmp_path / "two.json")
    assert as_text(Fit.load(tmp_path / "two.json")) == as_text(FIT)
    first, second = (read_result(tmp_path / f"{n}.json", "fit")[0] for n in ("one", "two"))
    assert first == second


def test_file_says_how_it_was_made(tmp_path: Path) -> None:
    """Version, command, settings and the hash of every record stand in the file."""
    FIT.save(tmp_path / "fit.json", command="make it", settings={"noise": "given"})
    _, made = read_result(tmp_path / "fit.json", "fit")
    assert made == {
        "version": __version__,
        "command": "make it",
        "settings": {"estimator": "multiple shooting", "noise": "given"},
        "records": {record.name: record.content_hash for record in FIT.dataset},
    }


def test_hash_depends_on_values_and_units_only() -> None:
    """Name and source do not enter the hash; one bit of one value does, and so does a channel."""
    record = FIT.dataset["zigzag"]
    same = record.rename("other")
    assert same.content_hash == record.content_hash
    outputs = record.outputs.copy()
    outputs[3, 0] = np.nextafter(outputs[3, 0], np.inf)
    assert record.with_outputs(outputs).content_hash != record.content_hash
    negative = np.where(record.outputs == 0.0, -0.0, record.outputs)
    assert record.with_outputs(negative).content_hash == record.content_hash
    assert record.thin(2).content_hash != record.content_hash
    swapped = type(FIT.dataset)(tuple(reversed(FIT.dataset.records)))
    assert swapped.content_hash == FIT.dataset.content_hash


# -- damage ----------------------------------------------------------------------------


def change(content: Any, path: str, to: Any) -> None:
    """Change one entry of the content of a file, fields by their names; ``...`` removes it."""
    *way, last = (int(one) if one.isdigit() else one for one in path.split("."))
    for key in way:
        content = _holding(content, key)[key]
    if to is ...:
        del _holding(content, last)[last]
    else:
        _holding(content, last)[last] = to


def _holding(content: Any, key: object) -> Any:
    """What has an entry of this name: an object, or its fields."""
    return content["fields"] if isinstance(content, dict) and key not in content else content


ARRAY = {"array": [1.0, 2.0], "shape": [2], "dtype": "float64"}
# What of the content of a good file is another, and a word of the message.
CONTENT: dict[str, tuple[str, Any, str]] = {
    "no class": ("class", ..., "of no known kind"),
    "a cost without end": ("cost", 10**400, "in place of a number"),
    "another class": ("class", "Popen", "does not know"),
    "class that is no name": ("class", ["Fit"], "does not know"),
    "no fields": ("fields", ..., "without fields"),
    "fields as a list": ("fields", [1], "without fields"),
    "field removed": ("sigma", ..., "without its sigma"),
    "field of a future version": ("charm", 1.0, "does not know"),
    "array as text": ("estimates", "abc", "'abc'"),
    "field without a default removed": ("covariance", ..., "make it again"),
    "array as null": ("covariance", None, "covariance"),
    "array cut": ("estimates.array", [1.0], "1 numbers for an array"),
    "array of text": ("estimates.array", ["x", 1, 2], "something else in it"),
    "array of objects": ("estimates.dtype", "object", "array of 'object'"),
    "array of huge text": ("estimates.dtype", "U999999999", "expected one of"),
    "no array where one is": ("sigma_estimated", {"tuple": []}, "sigma_estimated of shape (0,)"),
    "truth values as numbers": (
        "sigma_estimated.dtype",
        "float64",
        "sigma_estimated that is not true or false",
    ),
    "value of no parameter in a record": (
        "local_values",
        {"tuple": [{"mapping": [["zz", 1.0]]}, {"mapping": []}]},
        "'zz'",
    ),
    "innovations of no record": ("innovations", {"tuple": []}, "0 innovations"),
    "array of another length": ("estimates", ARRAY, "estimates of shape (2,)"),
    "shape negative": ("estimates.shape", [-3], "shape [-3]"),
    "shape not a number": ("estimates.shape", [None], "shape [None]"),
    "shape NaN": ("estimates.shape", [float("nan")], "shape [nan]"),
    "shape huge": ("estimates.shape", [10**12], "shape (1000000000000,)"),
    "shape with too many axes": ("estimates.shape", [1] * 70, "shape"),
    "shape missing": ("estimates.shape", ..., "shape None"),
    "number as text": ("cost", {"number": "many"}, "'many'"),
    "number as object": ("cost", {"value": 1}, "'value'"),
    "number as truth value in text": ("iterations", "4", "iterations"),
    "tuple as text": ("names", {"tuple": "K"}, "a tuple that is no list"),
    "names that are numbers": ("names", {"tuple": [1, 2, 3]}, "names"),
    "name of no parameter": ("names.tuple.0", "Q", "'Q'"),
    "mapping without pairs": ("extras", {"mapping": [1]}, "list of pairs"),
    "mapping with a list as key": ("extras", {"mapping": [[{"mapping": []}, 1]]}, "cannot be one"),
    "status of another class": (
        "status",
        {"class": "State", "fields": {"name": "a", "unit": "m"}},
        "status",
    ),
    "list where nothing may be": ("cost", [1], "cost"),
    "predictions of another shape": ("predictions.tuple.0", ARRAY, "predictions of shape (2,)"),
    "one record of residuals": ("residuals", {"tuple": []}, "0 residuals for 2 records"),
    "model with a bad expression": (
        "model.kinematics.mapping.0.1",
        "__import__('os')",
        "expected numbers",
    ),
    "model without states": ("model.states.tuple", [], "at least one state"),
    "parameter of no value": ("model.parameters.tuple.0.value", {"number": "nan"}, "NaN"),
    "parameter outside its bounds": ("model.parameters.tuple.1.lower", 1e9, "outside its bounds"),
    "times that run backwards": ("dataset.records.tuple.0.times.array.3", -1.0, "runs backwards"),
    "dataset without records": ("dataset.records.tuple", [], "at least one record"),
    "dataset as a number": ("dataset", 3.0, "dataset"),
    "output that is another class": ("model.outputs.tuple.0.class", "Status", "Status"),
}


@pytest.mark.parametrize(("path", "to", "word"), CONTENT.values(), ids=CONTENT)
def test_damaged_content_is_named(tmp_path: Path, path: str, to: Any, word: str) -> None:
    """Whatever is wrong inside a file without digest, a DataError says what it is."""
    data = json.loads(OLD.read_text())
    change(data["fit"], path, to)
    place = tmp_path / "fit.json"
    place.write_text(json.dumps(data))
    with pytest.raises(DataError) as caught:
        Fit.load(place)
    assert word.lower() in str(caught.value).lower()
    assert "fit.json" in str(caught.value)


def test_a_number_written_without_a_point_is_a_number(tmp_path: Path) -> None:
    """What other programs write of a float is read as one, however large."""
    data = json.loads(OLD.read_text())
    data["fit"]["fields"]["cost"] = 10**30
    (tmp_path / "fit.json").write_text(json.dumps(data))
    fit = Fit.load(tmp_path / "fit.json")
    assert type(fit.cost) is float
    assert fit.to_dict()["cost"] == 1e30


def whole() -> dict:
    """A good file of this version as plain data."""
    content = json.loads(OLD.read_text())["fit"]
    head = {"format": 2, "kind": "fit", "made": {"version": "0.1.0"}}
    return {**head, "sha256": _digest(content), "content": content}


def but(**changes: Any) -> bytes:
    """The good file with some entries changed or, with ``...``, removed."""
    data = {key: value for key, value in {**whole(), **changes}.items() if value is not ...}
    return json.dumps(data).encode()


GOOD = json.dumps(whole()).encode()
# The bytes of a file, and a word of the message.
FILES: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "is empty"),
    "blank": (b" \n\n", "is empty"),
    "cut in the middle": (GOOD[: len(GOOD) // 2], "is no saved fit, nor any JSON"),
    "cut at the end": (GOOD[:-1], "the file was cut"),
    "text": (b"Dear colleague,", "nor any JSON"),
    "binary": (bytes(range(256)), "binary data"),
    "zeros": (b"\0" * 100, "nor any JSON"),
    "pickle": (b"\x80\x04\x95\x00", "a Python pickle"),
    "Excel": (b"PK\x03\x04\xff\xfe", "an Excel workbook, or another ZIP archive"),
    "picture": (b"\x89PNG\r\n\x1a\n\xff", "a picture"),
    "compressed": (b"\x1f\x8b\x08\xff", "a gzip archive"),
    "UTF-16": ("{}".encode("utf-16"), "text in another encoding"),
    "list": (b"[1, 2]", "holds a list"),
    "number": (b"3", "holds a number"),
    "text in JSON": (b'"fit"', "holds a text"),
    "null": (b"null", "holds a null"),
    "nested too deeply": (b"[" * 100_000 + b"]" * 100_000, "nested too deeply"),
    "number too long": (b'{"a": ' + b"9" * 5000 + b"}", "number"),
    "empty object": (b"{}", "an object with nothing in it"),
    "another package's": (b'{"nbformat": 4, "cells": []}', "'nbformat', 'cells'"),
    "format of the future": (but(format=7, made={"version": "3.1"}), "written by oed_sysid 3.1"),
    "format as text": (but(format="2"), "format '2'"),
    "format as truth": (but(format=True), "format"),
    "format 0": (but(format=0), "format 0"),
    "format 1 without fit": (b'{"format": 1}', "has no 'fit'"),
    "no content": (but(content=...), "no 'content'"),
    "no digest": (but(sha256=...), "no 'sha256'"),
    "no maker": (but(made=...), "no 'made'"),
    "maker as text": (but(made="me"), "'made' is no object"),
    "another kind": (but(kind="design"), "'design'"),
    "another digest": (but(sha256="00"), "digest"),
    "one digit changed": (GOOD.replace(b"0.1", b"0.2", 3), "damaged"),
    "numbers of a fit": (
        (SAVED / "fit_json_0_1_0.json").read_bytes(),
        "Repeat the fit with --save",
    ),
}


@pytest.mark.parametrize(("content", "word"), FILES.values(), ids=FILES)
def test_damaged_file_is_named(tmp_path: Path, content: bytes, word: str) -> None:
    """Whatever is wrong with a file as a whole, a DataError says what it is."""
    place = tmp_path / "fit.json"
    place.write_bytes(content)
    with pytest.raises(DataError) as caught:
        Fit.load(place)
    assert word in str(caught.value)


def test_good_file_is_read(tmp_path: Path) -> None:
    """The file that the damaged ones are made from is read."""
    (tmp_path / "fit.json").write_bytes(GOOD)
    assert Fit.load(tmp_path / "fit.json").values == FIT.values


@pytest.mark.parametrize(("name", "word"), [("none.json", "There is no file"), ("", "is a folder")])
def test_what_is_no_file_is_named(tmp_path: Path, name: str, word: str) -> None:
    """A file that is not there, and a folder, are said in words."""
    with pytest.raises(DataError, match=word):
        Fit.load(tmp_path / name)
    with pytest.raises(DataError, match="There is no file"):
        Fit.load("a\0b")


# -- the command line ------------------------------------------------------------------


def test_report_reads_both_kinds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command report makes a page of a saved fit and of the numbers of --json."""
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: None)  # pixels are not the point
    assert main(["report", str(OLD), "--out", str(tmp_path / "full.html")]) == 0
    numbers = SAVED / "fit_json_0_1_0.json"
    assert main(["report", str(numbers), "--out", str(tmp_path / "numbers.html")]) == 0
    assert "--save FILE" in capsys.readouterr().err
    full, short = ((tmp_path / f"{n}.html").read_text() for n in ("full", "numbers"))
    assert "data:image" in full
    assert "data:image" not in short
    for name, value in FIT.values.items():
        assert name in short
        assert f"{value:.6g}" in short


@pytest.mark.parametrize(
    "change",
    [{"parameters": [3]}, {"noise": 1}, {"status": {}}, {"rms": None}, {"model": [1]}],
    ids=str,
)
def test_damaged_numbers_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict
) -> None:
    """Numbers of --json that were damaged end as bad input, not as a crash."""
    data = json.loads((SAVED / "fit_json_0_1_0.json").read_text()) | change
    (tmp_path / "fit.json").write_text(json.dumps(data))
    assert main(["report", str(tmp_path / "fit.json"), "--out", str(tmp_path / "a.html")]) == 2
    assert "damaged" in capsys.readouterr().err


def test_json_says_how_it_was_made(tmp_path: Path) -> None:
    """The command fit writes version, command line, settings and hashes beside its numbers."""
    data = SAVED.parent.parent / "problems" / "remus_diving_plane" / "data"
    record = data / "train_zigzag_5_5.csv"
    target = tmp_path / "fit.json"
    arguments = ["fit", "remus_diving_plane", str(record), "--json", str(target)]
    assert main([*arguments, "--save", str(tmp_path / "full.json")]) == 0
    made = json.loads(target.read_text())["oed_sysid"]
    assert made["version"] == __version__
    assert made["command"].startswith(f"oed-sysid fit remus_diving_plane {record} --json")
    assert made["settings"]["known_noise"] is False
    kept = Fit.load(tmp_path / "full.json")
    assert made["records"] == {one.name: one.content_hash for one in kept.dataset}
    assert read_result(tmp_path / "full.json", "fit")[1]["command"] == made["command"]


@pytest.mark.parametrize(
    "array",
    [np.zeros((0, 3)), np.array([[1.0, np.nan], [np.inf, -np.inf]]), np.array([True, False])],
)
def test_arrays_keep_shape_and_gaps(array: np.ndarray) -> None:
    """Empty arrays, missing and infinite numbers survive, in JSON that any reader accepts."""
    again = decode(json.loads(json.dumps(encode(array), allow_nan=False)), ())
    assert again.shape == array.shape
    assert again.dtype == array.dtype
    assert np.array_equal(again, array, equal_nan=array.dtype == float)


def test_only_known_classes_are_built() -> None:
    """A class that the caller did not name is refused, whatever the file says."""
    with pytest.raises(DataError, match="does not know"):
        decode({"class": "Model", "fields": {}}, ())
    with pytest.raises(DataError, match="cannot be kept"):
        encode(object())


FOLDER = Path(__file__).parent / "saved_fits"
OLD_FITS = FOLDER / "nomoto_format_1.json"


def test_the_file_is_an_old_one() -> None:
    """None of the later fields is in the file, so that the test means something."""
    fields = json.loads(OLD_FITS.read_text(encoding="utf-8"))["fit"]["fields"]
    assert not fields.keys() & {"noise", "noise_std", "innovations", "start_states"}


def test_numbers_are_those_of_the_time() -> None:
    """Values, errors and likelihood are those that the version which made it printed."""
    old = Fit.load(OLD_FITS)
    numbers = json.loads((FOLDER / "nomoto_format_1_numbers.json").read_text(encoding="utf-8"))
    assert old.values == numbers["values"]
    assert old.std_errors == pytest.approx(numbers["std_errors"], rel=1e-12)
    assert old.log_likelihood == pytest.approx(numbers["log_likelihood"], rel=1e-12)
    assert old.aic == pytest.approx(numbers["aic"], rel=1e-12)
    assert old.n_unknowns == numbers["n_unknowns"]
    assert old.rms == pytest.approx(numbers["rms"], rel=1e-12)


def test_what_is_new_has_a_meaning_for_it(tmp_path: Path) -> None:
    """It has white noise and free start states, predicts, and is saved in today's form."""
    old = Fit.load(OLD_FITS)
    assert old.noise.is_white
    assert old.noise.white == pytest.approx(old.sigma)
    assert old.start_states == ()
    assert not any(p.log for p in old.model.all_parameters)
    assert old.model.integrator == "explicit"
    prediction = old.predict(old.dataset)
    for found, stored in zip(prediction.outputs, old.predictions, strict=True):
        assert np.abs((found - stored) / old.sigma).max() < 0.5
    old.save(tmp_path / "again.json")
    assert Fit.load(tmp_path / "again.json").report() == old.report()


def test_what_was_told_in_extras_is_typed_now(tmp_path: Path) -> None:
    """Entries of ``extras`` that decided something in version 0.1 are fields; others stay."""
    content = json.loads(OLD_FITS.read_text(encoding="utf-8"))
    pair = {"tuple": [3, 900]}
    told = {
        "magnitudes": {"mapping": [["K", 1.0]]},
        "nominal": {"mapping": [["K", 0.05]]},
        "excluded": {"mapping": [["psi", pair]]},
        "disturbance_test": 31.0,
        "process_noise_failed": "stalled",
        "white_delay": {"tuple": ["psi", "output", 0.4, 0.1]},
        "white_starts": {"tuple": [{"tuple": ["rudder", "delta", "a", 0.1, 0.02, 0.5]}]},
        "captive": {"mapping": [["Y", 0.02]]},
        "captive_misfit": {"mapping": [["Y", 1.1]]},
        "tests_scatter": True,
        "horizon": 10.0,
        "windows": 12,
        "history": {"tuple": [1.0, 2.0]},
    }
    content["fit"]["fields"]["extras"] = {"mapping": [[k, v] for k, v in told.items()]}
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    fit = Fit.load(path)
    assert (fit.nominal, fit.excluded) == ({"K": 0.05}, {"psi": (3, 900)})
    test = fit.process_noise
    assert (test.statistic, test.failed) == (31.0, "stalled")
    found = test.departure
    assert (found.signal, found.kind, found.size) == ("psi", "late", 0.4)
    assert [one.effect for one in test.actuator_starts] == ["rudder"]
    assert (fit.captive.relative, fit.captive.in_noise) == ({"Y": 0.02}, {"Y": 1.1})
    assert (fit.tests_scatter, fit.horizon, fit.n_windows) == (True, 10.0, 12)
    assert fit.extras == {"history": (1.0, 2.0)}
    assert "3 of 900 samples of psi excluded" in fit.report()
    fit.save(tmp_path / "again.json")
    again = Fit.load(tmp_path / "again.json")
    assert again.process_noise.actuator_starts == test.actuator_starts
    assert again.report() == fit.report()


def test_nothing_is_decided_by_extras() -> None:
    """Only estimators write ``extras``; no other module of the package reads them."""
    package = Path(oed_sysid.__file__).parent
    readers = [
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if ".extras" in path.read_text(encoding="utf-8")
    ]
    assert readers == []


@pytest.mark.parametrize("old", MOVED)
def test_old_path_leads_to_the_module_that_has_its_names(old: str) -> None:
    """An old path is the new module itself, so that its classes are the same, and warns."""
    new = new_path(f"oed_sysid.{old}")
    assert new is not None
    sys.modules.pop(f"oed_sysid.{old}", None)
    with pytest.warns(DeprecationWarning, match=new):
        found = import_module(f"oed_sysid.{old}")
    assert found is import_module(new)


def test_modules_below_an_old_path_are_no_second_copies() -> None:
    """A class imported by its old path is the class of the package."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        old = import_module("oed_sysid.effects.base")
    assert old is import_module("oed_sysid.physics.base")


def test_an_old_path_hides_no_function_of_its_name() -> None:
    """The module of old ``estimators.profile`` leaves the function ``baselines.profile`` alone."""
    baselines = import_module("oed_sysid.baselines")
    sys.modules.pop("oed_sysid.estimators.profile", None)
    with pytest.warns(DeprecationWarning, match="multistart"):
        found = import_module("oed_sysid.estimators.profile")
    assert baselines.profile is found.profile


def test_what_never_was_is_not_found() -> None:
    """A path that no version had is no module."""
    with pytest.raises(ModuleNotFoundError):
        import_module("oed_sysid.nowhere")
    assert find_spec("oed_sysid.effects.nowhere") is None
