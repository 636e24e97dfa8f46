"""Dataclasses through JSON and back."""

from __future__ import annotations

import json

import numpy as np
import pytest

from oed_sysid.errors import DataError
from oed_sysid.likelihood.archive import decode, encode


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
