"""What the user chose, kept while pages come and go, and the study that follows from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import streamlit as st

from oed_sysid.app.records import likely_test, read_uploads, simulated
from oed_sysid.app.study import Study
from oed_sysid.app.trust import check_trusted, check_uploads, consent
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError
from oed_sysid.problem import Problem, list_problems, load_problem
from oed_sysid.problem.catalogue import catalogue_folder

# Streamlit forgets a widget that is not on the page; these keys are kept all the same.
_KEEP = "keep:"
_FIRST = "remus_diving_plane"
DEFAULT_MODEL = "default"
WITH_PROBLEM, SIMULATED, UPLOADED = "With the problem", "Simulated", "My CSV files"


def begin(initial: str | None) -> None:
    """Hold on to what was chosen before; choose a problem on the first visit."""
    for key in list(st.session_state):
        if str(key).startswith(_KEEP):
            st.session_state[key] = st.session_state[key]
    shipped = list_problems()
    first = initial or (_FIRST if _FIRST in shipped else next(iter(shipped), ""))
    st.session_state.setdefault(kept("source"), first)
    if initial and "agreed" not in st.session_state:
        agree(initial)  # who starts the application names what it begins with


def agreed() -> dict[str, bool]:
    """Problems of the user's own that may be run in this session."""
    return st.session_state.setdefault("agreed", {})


def agree(source: str) -> None:
    """Let a problem be run in this session."""
    agreed()[consent(source)] = True


def kept(*names: str) -> str:
    """Key of a widget whose value outlives its page."""
    return _KEEP + ":".join(names)


def chosen(*names: str, default: Any = None) -> Any:
    """Value of a kept widget, or of none yet."""
    return st.session_state.get(kept(*names), default)


def preset(key: str, value: Any) -> str:
    """Give a widget its first value, and return its key."""
    st.session_state.setdefault(key, value)
    return key


@dataclass(frozen=True, eq=False)
class Stock:
    """Records to choose from; what was refused, and what looks odd."""

    records: Dataset | None
    refused: dict[str, str]
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the records."""
        return () if self.records is None else self.records.names


def problem_of(source: str, variant: str) -> Problem:
    """Load a problem, if it may be run; again when its files were changed."""
    check_trusted(source, agreed())
    return _loaded(source, variant, _stamp(source))


def origins(problem: Problem) -> list[str]:
    """Where records of a problem can come from."""
    found = [WITH_PROBLEM] if problem.records is not None else []
    return [*found, *([SIMULATED] if problem.experiments else []), UPLOADED]


def first_origin(source: str, problem: Problem) -> str:
    """Where records come from before the user says so: nothing is downloaded unasked."""
    options = origins(problem)
    if options[0] == WITH_PROBLEM and not any(_folder(source).glob("data/*")):
        return UPLOADED
    return options[0]


def stock(source: str, variant: str, origin: str) -> Stock:
    """Records of one origin."""
    problem = problem_of(source, variant)
    if origin == UPLOADED:
        files: dict[str, bytes] = st.session_state.get(f"files:{source}", {})
        check_uploads(files)
        return Stock(*read_uploads(problem, files)) if files else Stock(None, {})
    return Stock(_shipped(source, variant, _stamp(source), origin), {})


def study() -> Study:
    """Put together what was chosen.

    Raises
    ------
    OedSysidError
        If the problem or its records cannot be read.
    """
    source = str(chosen("source") or "").strip()
    problem = problem_of(source, DEFAULT_MODEL)
    variant = chosen("variant", source, default=DEFAULT_MODEL)
    if variant != DEFAULT_MODEL:
        problem = problem_of(source, variant)
    origin = chosen("origin", source, variant) or first_origin(source, problem)
    held = stock(source, variant, origin)
    learn, judge = selection(source, variant, origin, held.names)
    return Study(
        source,
        variant,
        problem,
        _subset(held.records, learn),
        _subset(held.records, judge),
        bool(chosen("known_noise", source)),
    )


def selection(
    source: str, variant: str, origin: str, names: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the records to learn from and to judge with; those that exist."""
    guess = likely_test(names)
    defaults = {"train": [n for n in names if n not in guess], "test": list(guess)}
    found = []
    for part, default in defaults.items():
        key = kept(part, source, variant, origin)
        # A new file joins the records to learn from, or those to judge with, by its name.
        known = set(st.session_state.get(f"seen:{key}", ()))
        picked = st.session_state.get(key, [])
        now = [n for n in names if (n in picked if n in known else n in default)]
        st.session_state[f"seen:{key}"] = names
        if now != picked or key not in st.session_state:
            st.session_state[key] = now
        found.append(tuple(now))
    learn, judge = found
    if both := [name for name in learn if name in judge]:
        raise DataError(
            f"{', '.join(both)} is chosen to learn from and to judge with. An error on records "
            "that were learnt from proves nothing: take it out on one side."
        )
    return learn, judge


def _subset(records: Dataset | None, names: tuple[str, ...]) -> Dataset | None:
    if records is None or not names:
        return None
    return Dataset(tuple(records[name] for name in names))


def _stamp(source: str) -> float:
    """Time of the last change of a folder's Python files; zero for a shipped problem."""
    folder = _folder(source)
    if source in list_problems() or not folder.is_dir():
        return 0.0
    files = [*folder.glob("*.py"), *folder.glob("data/*.csv")]
    return max((file.stat().st_mtime for file in files), default=0.0)


def _folder(source: str) -> Path:
    """Folder of a shipped or own problem."""
    shipped = catalogue_folder()
    own = Path(source).expanduser()
    return shipped / source if shipped is not None and source in list_problems() else own


@st.cache_resource(show_spinner="Reading the problem", max_entries=20)
def _loaded(source: str, variant: str, stamp: float) -> Problem:
    return load_problem(source, variant=None if variant == DEFAULT_MODEL else variant)


@st.cache_resource(show_spinner="Reading the records", max_entries=10)
def _shipped(source: str, variant: str, stamp: float, origin: str) -> Dataset:
    problem = _loaded(source, variant, stamp)
    return simulated(problem) if origin == SIMULATED else problem.data()
