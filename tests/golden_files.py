"""Stored behaviour: what a function returned before is compared with what it returns now.

``OED_SYSID_GOLDEN=update pytest tests/test_golden*.py tests/test_frozen*.py`` writes the files of
``tests/golden`` anew. Each number that this changes is a line in ``CHANGELOG.md``.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from oed_sysid.likelihood.fit import Fit

FOLDER = Path(__file__).parent / "golden"
UPDATE = os.environ.get("OED_SYSID_GOLDEN") == "update"
# Fits without process noise, and those with it or whatever rests on several of them.
WHITE, FILTERED = 1e-6, 1e-3
# Numbers below this are zero: everything frozen is in SI units of whole vehicles.
ZERO = 1e-12


def check(file: str, key: str, found: Any, relative: float = WHITE) -> None:
    """Compare with what is stored under ``key`` of ``golden/<file>.json``, or store it.

    Text, whole numbers and the names of entries have to be equal, other numbers to within
    ``relative``. A ``value`` beside its ``std_error`` may also be off by that share of the latter:
    an estimate of something absent is a random number near zero. Where that error is infinite the
    value is not compared.
    """
    found = _plain(found)
    path = FOLDER / f"{file}.json"
    stored = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if UPDATE:
        text = json.dumps({**stored, key: found}, indent=1, sort_keys=True, ensure_ascii=False)
        path.write_text(text + "\n", encoding="utf-8")
        return
    assert key in stored, f"{path} has no {key!r}: update it (see CONTRIBUTING.md)"
    changed = list(_differences(stored[key], found, relative, key))
    assert not changed, f"{len(changed)} changes against {path}:\n" + "\n".join(changed[:40])


def shape(value: Any) -> Any:
    """Keys and types of plain data; the items of a list are merged into one."""
    if isinstance(value, dict):
        return {key: shape(one) for key, one in value.items()}
    if isinstance(value, list):
        merged: Any = "nothing"
        for one in value:
            merged = _merged(merged, shape(one))
        return [merged]
    if value is None or isinstance(value, bool):
        return "null" if value is None else "bool"
    return "text" if isinstance(value, str) else "number"


def _merged(first: Any, second: Any) -> Any:
    """One shape that both fit."""
    if first == second or first == "nothing":
        return second
    if second == "nothing":
        return first
    if isinstance(first, dict) and isinstance(second, dict):
        return {k: _merged(first.get(k, "null"), second.get(k, "null")) for k in first | second}
    if isinstance(first, list) and isinstance(second, list):
        return [_merged(first[0], second[0])]
    kinds = {"list" if isinstance(one, list) else one for one in (first, second)}
    return "|".join(sorted({word for one in kinds for word in str(one).split("|")}))


def _plain(value: Any) -> Any:
    """As JSON gives it back, numbers with twelve digits."""

    def rounded(one: Any) -> Any:
        if isinstance(one, float):
            return float(f"{one:.12g}") if math.isfinite(one) else str(one)
        if isinstance(one, dict):
            return {str(key): rounded(item) for key, item in one.items()}
        return [rounded(item) for item in one] if isinstance(one, list | tuple) else one

    return json.loads(json.dumps(rounded(value), default=lambda one: one.tolist()))


def _differences(
    before: Any, now: Any, relative: float, where: str, slack: float = 0.0
) -> Iterator[str]:
    """Lines on what differs."""
    match before, now:
        case dict(), dict():
            yield from _of_keys(before, now, relative, where)
        case list(), list() if len(before) == len(now):
            for i, (one, other) in enumerate(zip(before, now, strict=True)):
                yield from _differences(one, other, relative, f"{where}/{i}")
        case float(), int() | float():
            if abs(now - before) > ZERO + relative * max(abs(before), slack):
                yield f"{where}: {before!r} -> {now!r}"
        case _:
            if before != now:
                yield f"{where}: {before!r} -> {now!r}"


def _of_keys(
    before: dict[str, Any], now: dict[str, Any], relative: float, where: str
) -> Iterator[str]:
    """Lines on what differs in two mappings; a value may move by a share of its standard error."""
    for key in sorted(before.keys() | now.keys()):
        if key not in before or key not in now:
            yield f"{where}/{key}: {'new' if key in now else 'gone'}"
            continue
        error = before.get("std_error") if key == "value" else None
        if error == now.get("std_error") == "inf":
            continue  # nothing tells it, so that it is where the iterations left it
        around = abs(error) if isinstance(error, int | float) else 0.0
        yield from _differences(before[key], now[key], relative, f"{where}/{key}", around)


def restored(fit: Fit, folder: Path) -> Fit:
    """The fit that comes back from its file, in everything the one that was written."""
    path = folder / "fit.json"
    fit.save(path)
    again = Fit.load(path)
    assert again.report() == fit.report()
    for one in ("model", "status", "purpose", "start_states", "n_unknowns", "local_values"):
        assert getattr(again, one) == getattr(fit, one), one
    assert np.array_equal(again.covariance, fit.covariance)
    for first, second in zip(fit.residuals, again.residuals, strict=True):
        assert np.array_equal(first, second, equal_nan=True)
    assert (fit.noise and fit.noise.to_dict()) == (again.noise and again.noise.to_dict())
    errors = [one.whole_runs.each("error") for one in (fit, again)]
    np.testing.assert_allclose(*errors, rtol=1e-6)
    assert again.log_likelihood == pytest.approx(fit.log_likelihood, rel=1e-9)
    sources = [one.sources and one.sources.agreement() for one in (fit, again)]
    assert sources[0] == sources[1]
    return again
