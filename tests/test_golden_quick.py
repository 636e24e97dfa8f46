"""Behaviour that stays: fits without process noise, saved fits, ranking, signatures."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from pathlib import Path
from typing import Any

import pytest
from golden_cases import EVERY, facts, fit_of, problem, records
from golden_files import check
from marks import slow

import oed_sysid
from oed_sysid import Fit, rank_parameters

HERE = Path(__file__).parent
# Modules that export what users import, beside the rooms themselves.
SUBJECTS = (
    "physics.bodies",
    "data.logs",
    "experiments.manoeuvres",
    "experiments.problem",
    "experiments.simulation",
    "evidence.check",
    "baselines.benchmark",
)

# The two whose kernels and fits are the largest wait for `make test-slow`.
LARGE = ("remus_6dof", "esso_osaka")
NAMES = [*(one for one in EVERY if one not in LARGE), *slow(*LARGE)]


@pytest.mark.parametrize("name", NAMES)
def test_fit_without_process_noise(name: str) -> None:
    """Values, errors, noise, status and concerns of the fit of each shipped problem."""
    check("white", name, facts(fit_of(name)))


@pytest.mark.parametrize("name", NAMES)
def test_ranking(name: str) -> None:
    """Order and bounds of the parameters on the same records."""
    model, noise = problem(name).model, fit_of(name).sigma
    found = rank_parameters(
        model, records(name), noise=dict(zip(model.output_names, noise, strict=True))
    )
    rows = {
        row.name: [row.output_change, row.peak_change, row.error_alone, row.error]
        for row in found.rows
    }
    check(
        "ranking",
        name,
        {
            "by_information": list(found.by_information),
            "by_output_change": list(found.by_output_change),
            "rows": rows,
        },
    )


@pytest.mark.parametrize(
    "file",
    [*(HERE / "saved").glob("fit_format*.json"), HERE / "saved_fits" / "nomoto_format_1.json"],
    ids=lambda file: file.stem,
)
def test_saved_fit(file: Path) -> None:
    """Files of earlier versions give their numbers."""
    check("saved", file.stem, facts(Fit.load(file)))


def public() -> dict[str, str]:
    """Names and signatures of all that the package and its rooms export, without their places."""
    rooms = [
        importlib.import_module(f"oed_sysid.{one.name}")
        for one in pkgutil.iter_modules(oed_sysid.__path__)
        if one.ispkg
    ] + [importlib.import_module(f"oed_sysid.{one}") for one in SUBJECTS]
    found: dict[str, set[str]] = {}
    for room in (oed_sysid, *rooms):
        for name in getattr(room, "__all__", ()):
            found.setdefault(name, set()).add(signature(getattr(room, name)))
    return {name: " or ".join(sorted(lines)) for name, lines in found.items()}


def signature(thing: Any) -> str:
    """Parameters of a function or of what makes a class, with defaults."""
    if not callable(thing):
        return "a value"
    try:
        given = inspect.signature(thing).parameters.values()
    except ValueError:
        return "a class"
    words: list[str] = []
    for one in given:
        if one.kind is one.KEYWORD_ONLY and "*" not in words:
            words.append("*")
        plain = isinstance(one.default, str | int | float | bool | tuple | None)
        shown = repr(one.default) if plain else "..."
        words.append(one.name if one.default is one.empty else f"{one.name}={shown}")
    return f"({', '.join(words)})"


def test_public_signatures() -> None:
    """Every public name is there, with its parameters and defaults."""
    check("signatures", "public", public())
