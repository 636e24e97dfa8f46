"""Frozen dataclasses as JSON, and back without loss.

Only classes that the caller names are ever built, so that a file from
elsewhere can be opened safely. Arrays keep their shape, and NaN stays NaN
(``null`` in the file, which every JSON reader accepts).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from oed_sysid.errors import DataError


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
    """
    known = {cls.__name__: cls for cls in classes}

    def build(item: Any) -> Any:
        if not isinstance(item, dict):
            return item
        if "number" in item:
            return float(item["number"])
        if "array" in item:
            flat = [_number(entry) for entry in item["array"]]
            return np.array(flat, dtype=item["dtype"]).reshape(item["shape"])
        if "tuple" in item:
            return tuple(map(build, item["tuple"]))
        if "mapping" in item:
            return {build(key): build(entry) for key, entry in item["mapping"]}
        if item.get("class") not in known:
            raise DataError(
                f"The file holds a {item.get('class')!r}, which this version does not know. It was "
                "written by another version, or is not a saved fit."
            )
        content = {name: build(entry) for name, entry in item["fields"].items()}
        cls = known[item["class"]]
        # Fields that the file's version had not yet take their defaults.
        if strange := sorted(content.keys() - {f.name for f in fields(cls)}):
            raise DataError(
                f"The file holds a {item['class']} with {', '.join(strange)}, which this version "
                "does not know. It was written by a newer one: update oed_sysid, or fit again."
            )
        try:
            return cls(**content)
        except TypeError as error:
            raise DataError(
                f"The file holds a {item['class']} that lacks what this version needs ({error}). "
                "It was written by another one: fit again."
            ) from None

    return build(data)


def _finite(item: Any) -> Any:
    if not isinstance(item, float) or math.isfinite(item):
        return item
    return None if math.isnan(item) else repr(item)


def _number(entry: Any) -> Any:
    if entry is None:
        return math.nan
    return float(entry) if isinstance(entry, str) else entry
