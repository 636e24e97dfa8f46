"""Frozen dataclasses as JSON, and back without loss.

Only classes that the caller names are ever built, so that a file from
elsewhere can be opened safely. Arrays keep their shape, and NaN stays NaN
(``null`` in the file, which every JSON reader accepts).

Saved results: what they are, who made them from what, and whether they are whole.

A saved result is one JSON object,

    {"format": 2, "kind": "fit", "made": {version, command, settings, records},
     "sha256": digest of the content, "content": the result}

so that a reader in ten years can say which program, which command and which
data made it. Files of format 1, which held the fit alone, are still read.
"""

from __future__ import annotations

import hashlib
import json
import math
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from operator import attrgetter
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, OedSysidError
from oed_sysid.likelihood.estimate import Estimate
from oed_sysid.runtime.files import read_bytes, write_text
from oed_sysid.runtime.version import __version__
from oed_sysid.text.csv_table import kind_of


def encode(value: Any) -> Any:
    """Turn a value into what JSON can hold.

    >>> encode({"a": np.array([1.0, np.nan])})
    {'mapping': [['a', {'array': [1.0, None], 'shape': [2], 'dtype': 'float64'}]]}
    """
    for kinds, written in _WRITTEN.items():
        if isinstance(value, kinds):
            return written(value)
    if is_dataclass(value) and not isinstance(value, type):
        content = {f.name: encode(getattr(value, f.name)) for f in fields(value) if f.init}
        return {"class": type(value).__name__, "fields": content}
    raise DataError(f"A {type(value).__name__} cannot be kept in a file: {value!r}.")


# How values other than dataclasses are written.
_WRITTEN: dict[Any, Callable[[Any], Any]] = {
    (str, bool, int, type(None)): lambda value: value,
    (float, np.floating): lambda value: (
        float(value) if math.isfinite(value) else {"number": repr(float(value))}
    ),
    (np.integer, np.bool_): lambda value: value.item(),
    np.ndarray: lambda value: {
        "array": [_finite(item) for item in value.ravel().tolist()],
        "shape": list(value.shape),
        "dtype": str(value.dtype),
    },
    (tuple, list): lambda value: {"tuple": [encode(item) for item in value]},
    Mapping: lambda value: {"mapping": [[encode(k), encode(v)] for k, v in value.items()]},
}


def dataclasses_of(kind: type) -> tuple[type, ...]:
    """A dataclass, all that its fields are declared to hold, and what these are the base of.

    >>> from oed_sysid.likelihood.noise_model import NoiseModel
    >>> [one.__name__ for one in dataclasses_of(NoiseModel)]
    ['NoiseModel', 'Sea']
    """
    found: list[type] = []
    waiting: list[Any] = [kind]
    while waiting:
        one = waiting.pop(0)
        if not (isinstance(one, type) and is_dataclass(one)):
            waiting += get_args(one)
        elif one not in found:
            found.append(one)
            waiting += [*get_type_hints(one).values(), *one.__subclasses__()]
    return tuple(found)


def decode(data: Any, classes: Iterable[type]) -> Any:
    """Rebuild a value from :func:`encode`.

    Parameters
    ----------
    data : plain data
        As JSON returns it.
    classes : iterable of type
        Dataclasses that may be built.

    Raises
    ------
    DataError
        If the data is not what :func:`encode` returns, or holds what the classes
        refuse; the message says where.

    Examples
    --------
    >>> decode({"array": [1.0, None], "shape": [2], "dtype": "float64"}, ())
    array([ 1., nan])
    """
    return _Builder({cls.__name__: cls for cls in classes}).build(data, "")


class _Builder:
    """One pass over encoded data; the place is kept for messages."""

    def __init__(self, known: Mapping[str, type]) -> None:
        self.known = known

    def build(self, item: Any, place: str) -> Any:
        """Rebuild what stands at a place of the file."""
        if not isinstance(item, dict):
            if item is None or isinstance(item, str | bool | int | float):
                return item
            raise _damage(place, f"a {type(item).__name__} without a kind")
        for kind in ("number", "array", "tuple", "mapping", "class"):
            if kind in item:
                return getattr(self, f"_{kind}")(item, place)
        raise _damage(place, f"an object with {_listed(item)}, of no known kind")

    def _number(self, item: dict, place: str) -> float:
        try:
            return float(item["number"])
        except (TypeError, ValueError, OverflowError):
            raise _damage(place, f"{item['number']!r:.40} in place of a number") from None

    def _array(self, item: dict, place: str) -> np.ndarray:
        flat, shape, kind = item["array"], item.get("shape"), item.get("dtype")
        if not isinstance(flat, list) or kind not in _DTYPES:
            raise _damage(place, f"an array of {kind!r:.40}; expected one of {', '.join(_DTYPES)}")
        if not isinstance(shape, list) or len(shape) > 8 or not all(map(_is_length, shape)):
            raise _damage(place, f"an array of shape {shape!r:.40}")
        if math.prod(shape) != len(flat):
            raise _damage(place, f"{len(flat)} numbers for an array of shape {tuple(shape)}")
        try:
            return np.array([_number(entry) for entry in flat], dtype=kind).reshape(shape)
        except (TypeError, ValueError, OverflowError):
            raise _damage(place, f"an array of {kind} with something else in it") from None

    def _tuple(self, item: dict, place: str) -> tuple:
        if not isinstance(item["tuple"], list):
            raise _damage(place, "a tuple that is no list")
        return tuple(self.build(one, f"{place}[{i}]") for i, one in enumerate(item["tuple"]))

    def _mapping(self, item: dict, place: str) -> dict:
        pairs = item["mapping"]
        if not isinstance(pairs, list) or not all(
            isinstance(p, list) and len(p) == 2 for p in pairs
        ):
            raise _damage(place, "a mapping that is no list of pairs")
        result = {}
        for key, entry in pairs:
            built = self.build(key, f"{place} key")
            try:
                result[built] = self.build(entry, f"{place}[{built!r:.40}]")
            except TypeError:  # unhashable
                raise _damage(place, "a key that cannot be one") from None
        return result

    def _class(self, item: dict, place: str) -> Any:
        name, entries = item["class"], item.get("fields")
        if not isinstance(name, str) or name not in self.known:
            raise DataError(
                f"The file holds a {name!r:.60}{_at(place)}, which this version does not know. It "
                "was written by another version, or is not a saved fit."
            )
        if not isinstance(entries, dict):
            raise _damage(place, f"a {name} without fields")
        cls = self.known[name]
        _check_names(cls, entries, place)
        hints, content = get_type_hints(cls), {}
        for key, entry in entries.items():
            within = f"{place}.{key}".lstrip(".")
            content[key] = self.build(entry, within)
            if hints[key] is float and type(content[key]) is int:  # as JSON may write it
                content[key] = self._number({"number": entry}, within)
            if not _fits(content[key], hints[key]):
                kind = getattr(hints[key], "__name__", hints[key])
                raise _damage(within, f"{content[key]!r:.40}, which is no {kind}")
        try:
            return getattr(cls, "of_saved", cls)(**content)
        except OedSysidError as error:
            raise DataError(
                f"The file holds a {name}{_at(place)} that is refused: {error}"
            ) from None
        except (TypeError, ValueError, KeyError, AttributeError, IndexError) as error:
            raise _damage(place, f"a {name} that cannot be built ({error})") from None


def _check_names(cls: type, entries: Mapping[str, Any], place: str) -> None:
    """Raise :class:`DataError` unless entries are fields of a class, none of them missing."""
    expected = {f.name: f for f in fields(cls) if f.init}
    if extra := [key for key in entries if key not in expected]:
        raise _damage(
            place,
            f"a {cls.__name__} with {extra[0]!r:.40}, which this version of the package does not "
            "know",
        )
    for key, one in expected.items():
        if key not in entries and one.default is MISSING and one.default_factory is MISSING:
            raise _damage(place, f"a {cls.__name__} without its {key}")


# What is said of files that nobody can use, and what mends them.
DAMAGED, AGAIN = "is damaged, or was changed by hand:", "Use a copy of it, or make it again."
_DTYPES = ("float64", "float32", "int64", "int32", "bool")


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of the kind that a field is declared with."""
    kind = get_origin(hint) or hint
    if kind in _FITTING:
        return _FITTING[kind](value, get_args(hint))
    return isinstance(value, kind) if isinstance(kind, type) else True


def _fits_tuple(value: Any, inner: tuple[Any, ...]) -> bool:
    if not isinstance(value, tuple):
        return False
    kinds = inner[:1] * len(value) if inner[1:] == (...,) else inner
    return len(value) == len(kinds) and all(map(_fits, value, kinds))


_FITTING: dict[Any, Callable[[Any, tuple[Any, ...]], bool]] = {
    Any: lambda value, inner: True,
    float: lambda value, inner: isinstance(value, int | float),
    int: lambda value, inner: isinstance(value, int) and not isinstance(value, bool),
    np.ndarray: lambda value, inner: (
        isinstance(value, np.ndarray) or _fits(value, tuple[float | np.ndarray, ...])
    ),
    tuple: _fits_tuple,
    Mapping: lambda value, inner: (
        isinstance(value, Mapping)
        and all(_fits(key, inner[0]) and _fits(one, inner[1]) for key, one in value.items())
    ),
    **dict.fromkeys(
        (Union, UnionType), lambda value, inner: any(_fits(value, one) for one in inner)
    ),
}


def _at(place: str) -> str:
    return f" at {place}" if place else ""


def _listed(item: Mapping) -> str:
    return ", ".join(f"{key!r:.30}" for key in list(item)[:5]) or "nothing in it"


def _is_length(number: object) -> bool:
    return type(number) is int and number >= 0


def _damage(place: str, found: str) -> DataError:
    """Error about something that :func:`encode` does not write."""
    return DataError(f"The file {DAMAGED} it holds {found}{_at(place)}. {AGAIN}")


def _finite(item: Any) -> Any:
    if not isinstance(item, float) or math.isfinite(item):
        return item
    return None if math.isnan(item) else repr(item)


def _number(entry: Any) -> Any:
    if entry is None:
        return math.nan
    return float(entry) if isinstance(entry, str) else entry


# Of the file; raised when older programs could not read it.
FORMAT = 2
# What a file of each format holds beside its number.
PARTS = {1: ("fit",), 2: ("kind", "made", "sha256", "content")}


def made_by(
    datasets: Iterable[Dataset] = (),
    *,
    command: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Say who made a result, how and from what.

    Parameters
    ----------
    datasets : iterable of Dataset
        Records that the result depends on.
    command : str, optional
        How it was called; by default the command line of this process.
    settings : mapping, optional
        What was chosen, as plain data.

    Returns
    -------
    dict
        ``version``, ``command``, ``settings`` and, by name of the record, the hash of
        its values.
    """
    if command is None:
        command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]) if sys.argv else ""
    return {
        "version": __version__,
        "command": command,
        "settings": dict(settings or {}),
        "records": {record.name: record.content_hash for data in datasets for record in data},
    }


def write_result(path: str | Path, kind: str, content: Any, made: Mapping[str, Any]) -> None:
    """Write a result whole or not at all.

    Parameters
    ----------
    path : str or Path
        The file.
    kind : str
        What it is, such as ``"fit"``.
    content : plain data
        The result as :func:`oed_sysid.likelihood.archive.encode` returns it.
    made : mapping
        See :func:`made_by`.
    """
    head = {"format": FORMAT, "kind": kind, "made": dict(made), "sha256": _digest(content)}
    write_text(path, json.dumps({**head, "content": content}, allow_nan=False))


def read_result(path: str | Path, kind: str) -> tuple[Any, dict[str, Any]]:
    """Read what :func:`write_result` wrote, and files of format 1.

    Returns
    -------
    content : plain data
        For :func:`oed_sysid.likelihood.archive.decode`.
    made : dict
        Who made it; empty for format 1, which did not say.

    Raises
    ------
    DataError
        If the file is missing, damaged, or something else; the message says which.
    """
    data = read_json(path)
    fault = next(_faults_of_head(data, kind), None)
    if fault is not None:
        raise DataError(f"{path} {fault}")
    # Version 0.1 wrote a fit without a head.
    return (data["fit"], {}) if data["format"] == 1 else (data["content"], data["made"])


def _faults_of_head(data: Any, kind: str) -> Iterator[str]:
    """What a saved result of a kind does not have, one after the other; the first is grave."""
    wanted = (
        "Expected what fit.save(), or --save of `oed-sysid fit` and `oed-sysid improve`, writes "
        f"({kind})."
    )
    if not isinstance(data, dict):
        yield f"holds a {_WORDS[type(data)]}, not a saved result. {wanted}"
    version, made = data.get("format"), data.get("made", {})
    if version is None:
        yield _foreign(data, wanted)
    if type(version) is not int or version < 1:
        yield f"is of format {version!r:.40}, which is none. {wanted}"
    if version > FORMAT:
        by = made.get("version", "?") if isinstance(made, dict) else "?"
        yield (
            f"is of format {version}, written by oed_sysid {by!s:.20}. This is {__version__}, "
            f"which reads formats up to {FORMAT}: update it."
        )
    for key in PARTS[version]:
        if key not in data:
            yield f"is of format {version} but has no {key!r}: a part of it is missing. {AGAIN}"
    if version == FORMAT:
        yield from _faults_of_whole(data, kind, wanted)


def _faults_of_whole(data: dict[str, Any], kind: str, wanted: str) -> Iterator[str]:
    """What a result with all its parts does not have."""
    if not isinstance(data["made"], dict):
        yield f"does not say who made it: its 'made' is no object. {wanted}"
    if data["kind"] != kind:
        yield f"holds a {data['kind']!r:.40}, expected a {kind}."
    if _digest(data["content"]) != data["sha256"]:
        yield f"{DAMAGED} its content does not have the digest that was written with it. {AGAIN}"


def decode_result(path: str | Path, kind: str, classes: Iterable[type]) -> Any:
    """Read a result and build it; see :func:`read_result` and :func:`decode`."""
    content, _ = read_result(path, kind)
    try:
        result = decode(content, classes)
    except DataError as error:
        raise DataError(f"{path} cannot be loaded. {error}") from None
    if type(result).__name__.lower() != kind:
        raise DataError(f"{path} holds a {type(result).__name__}, expected a {kind}.")
    return result


def check_fit(fit: Estimate, where: str) -> None:
    """Raise :class:`DataError` unless all arrays of a fit suit its model and its records.

    Parameters
    ----------
    fit : Estimate
        As decoded.
    where : str
        The file, for the message.
    """
    fault = next(_faults(fit), None)
    if fault is not None:
        raise DataError(f"{where} {DAMAGED} it holds {fault}. {AGAIN}")


def _faults(fit: Estimate) -> Iterator[str]:
    """What does not suit the model or the records, one after the other."""
    n, each, forces = len(fit.names), (len(fit.model.outputs),), (len(fit.noise.places),)
    shapes = {"estimates": (n,), "covariance": (n, n), "sigma": each, "sigma_estimated": each}
    shapes |= dict.fromkeys(("noise.white", "noise.colour", "noise.colour_time"), each)
    shapes |= {"noise.force": forces, "noise.force_time": forces}
    shapes |= {"information.scales": (len(fit.information.names),)}
    for name, shape in shapes.items():
        found = attrgetter(name)(fit)
        if not isinstance(found, np.ndarray) or found.shape != shape:
            yield f"{name} of shape {np.shape(found)}, expected {shape}"
    if fit.sigma_estimated.dtype != bool:
        yield "sigma_estimated that is not true or false"
    for name in sorted({*fit.names}.union(*fit.local_values) - {*fit.model.parameter_names}):
        yield f"an estimate of {name!r}, which is no parameter of the model"
    if fit.dataset.channels != fit.model.channels:
        yield "records with other channels than the model"
    if len(fit.noise.outputs) != each[0]:
        yield f"noise of {len(fit.noise.outputs)} outputs"
    if np.shape(fit.information.factor)[1:] != (len(fit.information.names),):
        yield f"information of shape {np.shape(fit.information.factor)}"
    yield from _faults_of_records(fit)


def _faults_of_records(fit: Estimate) -> Iterator[str]:
    """Series that do not suit their records."""
    filtered = [] if fit.innovations is None else ["innovations", "innovation_std"]
    sampled = ["predictions", "residuals", *filtered]
    for name in (*sampled, "states", "initial_states", "local_values"):
        parts = getattr(fit, name) or ()
        if len(parts) != len(fit.dataset):
            yield f"{len(parts)} {name} for {len(fit.dataset)} records"
        for part, record in zip(parts, fit.dataset, strict=True):
            if name in sampled and np.shape(part) != record.outputs.shape:
                yield f"{name} of shape {np.shape(part)} for record {record.name!r}"


def read_json(path: str | Path) -> Any:
    """Read a JSON file, with every fault of it said in words.

    Raises
    ------
    DataError
        If it cannot be read, or is not JSON.
    """
    raw = read_bytes(path)
    if not raw.strip():
        raise DataError(f"{path} is empty. {AGAIN}")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        what, _ = kind_of(raw) or ("binary data, or text in another encoding", "")
        raise DataError(
            f"{path} is no text file (UTF-8), so it is not a saved result but {what}."
        ) from None
    if text.lstrip().startswith("<"):
        raise DataError(
            f"{path} is a page to read in a browser; it holds no model. Give the file that --save "
            "of fit or improve wrote."
        )
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        cut = " It ends in the middle: the file was cut." if error.pos >= len(text) - 1 else ""
        raise DataError(
            f"{path} is no saved fit, nor any JSON: line {error.lineno}, column {error.colno}: "
            f"{error.msg}.{cut} {AGAIN}"
        ) from None
    except RecursionError:
        raise DataError(f"{path} is nested too deeply to be a saved result.") from None
    except ValueError as error:  # a whole number of thousands of digits
        raise DataError(f"{path} holds a number that cannot be read ({error}).") from None


_WORDS = {list: "list", str: "text", int: "number", float: "number", bool: "truth value"}
_WORDS[type(None)] = "null"


def is_numbers_of_fit(data: Any) -> bool:
    """Whether this is what ``oed-sysid fit --json`` writes: numbers without model and data."""
    return isinstance(data, dict) and {"parameters", "estimator", "covariance"} <= set(data)


def _foreign(data: Mapping[str, Any], wanted: str) -> str:
    """Say what a JSON object without a format is."""
    if is_numbers_of_fit(data):
        return (
            "holds the numbers of a fit, as --json writes them, without model and data. Repeat the "
            "fit with --save FILE and give that file."
        )
    if isinstance(data.get("oed_sysid"), dict):
        command = data["oed_sysid"].get("command", "")
        return f"holds what --json of `{command!s:.80}` wrote, not a saved fit. {wanted}"
    return f"does not hold a saved fit but an object with {_listed(data)}. {wanted}"


def _digest(content: Any) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
