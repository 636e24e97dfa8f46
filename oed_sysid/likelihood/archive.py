"""Frozen dataclasses as JSON, and back without loss.

Only classes that the caller names are ever built, so that a file from
elsewhere can be opened safely. Arrays keep their shape, and NaN stays NaN
(``null`` in the file, which every JSON reader accepts).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from oed_sysid.errors import DataError, OedSysidError


def encode(value: Any) -> Any:
    """Turn a value into what JSON can hold.

    >>> encode({"a": np.array([1.0, np.nan])})
    {'mapping': [['a', {'array': [1.0, None], 'shape': [2], 'dtype': 'float64'}]]}
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float | np.floating):
        number = float(value)
        return number if math.isfinite(number) else {"number": repr(number)}
    if isinstance(value, np.integer | np.bool_):
        return value.item()
    if isinstance(value, np.ndarray):
        return {
            "array": [_finite(item) for item in value.ravel().tolist()],
            "shape": list(value.shape),
            "dtype": str(value.dtype),
        }
    if isinstance(value, tuple | list):
        return {"tuple": [encode(item) for item in value]}
    if isinstance(value, Mapping):
        return {"mapping": [[encode(key), encode(item)] for key, item in value.items()]}
    if is_dataclass(value) and not isinstance(value, type):
        content = {f.name: encode(getattr(value, f.name)) for f in fields(value) if f.init}
        return {"class": type(value).__name__, "fields": content}
    raise DataError(f"A {type(value).__name__} cannot be kept in a file: {value!r}.")


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
        except (TypeError, ValueError):
            raise _damage(place, f"{item['number']!r:.40} in place of a number") from None

    def _array(self, item: dict, place: str) -> np.ndarray:
        flat, shape, kind = item["array"], item.get("shape"), item.get("dtype")
        if not isinstance(flat, list) or kind not in _DTYPES:
            raise _damage(place, f"an array of {kind!r:.40}; expected one of {', '.join(_DTYPES)}")
        if not isinstance(shape, list) or not all(type(n) is int and n >= 0 for n in shape):
            raise _damage(place, f"an array of shape {shape!r:.40}")
        if len(shape) > 8 or math.prod(shape) != len(flat):
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
        cls = self.known[name]
        expected = {f.name: f for f in fields(cls) if f.init}
        if not isinstance(entries, dict):
            raise _damage(place, f"a {name} without fields")
        if extra := [key for key in entries if key not in expected]:
            raise _damage(
                place,
                f"a {name} with {extra[0]!r:.40}, which this version of the package does not know",
            )
        required = [
            key
            for key, f in expected.items()
            if f.default is MISSING and f.default_factory is MISSING
        ]
        if lost := [key for key in required if key not in entries]:
            raise _damage(place, f"a {name} without its {lost[0]}")
        content = {
            key: self.build(entry, f"{place}.{key}".lstrip(".")) for key, entry in entries.items()
        }
        hints = get_type_hints(cls)
        for key, value in content.items():
            if not _fits(value, hints[key]):
                raise _damage(
                    f"{place}.{key}".lstrip("."),
                    f"{value!r:.40}, which is no {getattr(hints[key], '__name__', hints[key])}",
                )
        try:
            return cls(**content)
        except OedSysidError as error:
            raise DataError(
                f"The file holds a {name}{_at(place)} that is refused: {error}"
            ) from None
        except (TypeError, ValueError, KeyError, AttributeError, IndexError) as error:
            raise _damage(place, f"a {name} that cannot be built ({error})") from None


_DTYPES = ("float64", "float32", "int64", "int32", "bool")


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of the kind that a field is declared with."""
    if hint is Any or isinstance(hint, TypeVar):
        return True
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_fits(value, one) for one in arguments)
    if hint is float:
        return isinstance(value, int | float)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint is np.ndarray or origin is np.ndarray:
        return isinstance(value, np.ndarray) or (
            isinstance(value, tuple) and all(_fits(one, float | np.ndarray) for one in value)
        )
    if origin is tuple:
        if not isinstance(value, tuple):
            return False
        if len(arguments) == 2 and arguments[1] is ...:
            return all(_fits(one, arguments[0]) for one in value)
        return len(value) == len(arguments) and all(map(_fits, value, arguments))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return isinstance(value, Mapping) and all(
            _fits(key, arguments[0]) and _fits(one, arguments[1]) for key, one in value.items()
        )
    if hint is type(None):
        return value is None
    return isinstance(value, hint) if isinstance(hint, type) else True


def _at(place: str) -> str:
    return f" at {place}" if place else ""


def _listed(item: Mapping) -> str:
    return ", ".join(f"{key!r:.30}" for key in list(item)[:4]) or "nothing in it"


def _damage(place: str, found: str) -> DataError:
    """Error about something that :func:`encode` does not write."""
    return DataError(
        f"The file is damaged, or was changed by hand: it holds {found}{_at(place)}. Use a copy "
        "of it, or make it again."
    )


def _finite(item: Any) -> Any:
    if not isinstance(item, float) or math.isfinite(item):
        return item
    return None if math.isnan(item) else repr(item)


def _number(entry: Any) -> Any:
    if entry is None:
        return math.nan
    return float(entry) if isinstance(entry, str) else entry
