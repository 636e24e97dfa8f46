"""Dataclasses through JSON and back."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from vehicles import remus

from oed_sysid.errors import DataError
from oed_sysid.likelihood.archive import decode, encode
from oed_sysid.likelihood.fit import ARCHIVED


@pytest.mark.parametrize(
    "value",
    [
        1.5,
        math.inf,
        -math.inf,
        0,
        True,
        "text",
        None,
        (1.0, ("a", None)),
        {("Z", "w"): "m - Z_wdot", "x": {"y": 2.0}},
    ],
)
def test_plain_values_come_back(value: object) -> None:
    """Numbers, text, tuples and mappings, also with tuples as keys, are unchanged."""
    assert decode(json.loads(json.dumps(encode(value), allow_nan=False)), ()) == value


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


def test_a_whole_model_comes_back() -> None:
    """A model with effects is equal to itself after the journey, and so is its structure."""
    model = remus()
    again = decode(json.loads(json.dumps(encode(model))), ARCHIVED)
    assert again == model
    assert again.structure_key() == model.structure_key()


def test_only_known_classes_are_built() -> None:
    """A class that the caller did not name is refused, whatever the file says."""
    with pytest.raises(DataError, match="does not know"):
        decode({"class": "Model", "fields": {}}, ())
    with pytest.raises(DataError, match="cannot be kept"):
        encode(object())
