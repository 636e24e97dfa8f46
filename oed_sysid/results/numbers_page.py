"""The report on the numbers of a fit, where model and data were not kept."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from oed_sysid.errors import DataError
from oed_sysid.results.page import Page, Section, Table


def numbers_page(content: Mapping[str, Any]) -> Page:
    """Compose a report from what ``oed-sysid fit --json`` wrote.

    Parameters
    ----------
    content : mapping
        As JSON returns it.

    Raises
    ------
    DataError
        If it is not what that command writes.
    """
    status = _part(content, "status", dict)
    code = _part(status, "code", str)
    parameters = []
    for entry in _part(content, "parameters", list):
        if not isinstance(entry, dict):
            raise DataError("One of the 'parameters' of this file is no object: it is damaged.")
        words = (str(entry.get("name", "?")), _number(entry.get("value")))
        parameters.append((*words, _number(entry.get("std_error")), str(entry.get("unit", ""))))
    noise, rms = _part(content, "noise", dict), _part(content, "rms", dict)
    outputs = [(str(name), _number(rms.get(name)), _number(level)) for name, level in noise.items()]
    made = content.get("oed_sysid")
    made = made if isinstance(made, dict) else {}
    records = made.get("records")
    hashes = records if isinstance(records, dict) else {}
    trust = (
        "The estimation converged."
        if code == "converged"
        else f"The estimation did not converge ({code}). Do not use the values."
    )
    columns = ("parameter", "value", "std. error", "unit")
    return Page(
        title=str(_part(content, "model", str)),
        subtitle=f"Fitted by {content.get('estimator')}; numbers only",
        verdict=(
            trust,
            "Model and data were not kept, so there are no pictures here: repeat the fit with "
            "--save FILE for those.",
        ),
        numbers=(
            ("misfit", f"{_number(content.get('normalised_rms'))} × noise"),
            ("parameters", str(len(parameters))),
            ("status", code),
        ),
        sections=(
            Section("Estimates", tables=(Table(columns, tuple(parameters), words=(0, 3)),)),
            Section(
                "Outputs",
                tables=(Table(("output", "rms residual", "noise"), tuple(outputs), words=(0,)),),
            ),
            Section(
                "Where it comes from",
                paragraphs=(
                    f"oed_sysid {made.get('version', 'of unknown version')}: "
                    f"{made.get('command', 'the command was not kept')}",
                    *(f"{name}: {digest}" for name, digest in hashes.items()),
                ),
            ),
        ),
    )


def _part(content: Mapping[str, Any], key: str, kind: type) -> Any:
    value = content.get(key)
    if not isinstance(value, kind):
        raise DataError(
            f"The numbers of this fit have no usable {key!r}: the file is damaged, or was changed "
            "by hand. Use a copy of it, or make it again."
        )
    return value


def _number(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "unknown" if value is None else str(value)[:40]
    try:
        return f"{value:.6g}"
    except OverflowError:  # a whole number beyond all floats
        return "beyond all numbers"
