"""What the user chose, kept while pages come and go, and the study that follows from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import streamlit as st

from oed_sysid.app import answers, mapping, visit
from oed_sysid.app.records import at_hand, likely_test, measured_sets, read_uploads, simulated
from oed_sysid.app.study import Study
from oed_sysid.app.trust import check_trusted, check_uploads, consent
from oed_sysid.app.visit import chosen, kept, preset
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.logs import LogMapping
from oed_sysid.errors import DataError
from oed_sysid.experiments.catalogue import catalogue_folder
from oed_sysid.experiments.problem import Problem, list_problems, load_problem

_FIRST = "remus_diving_plane"
DEFAULT_MODEL = "default"
WITH_PROBLEM, SIMULATED = "With the problem", "Simulated"
UPLOADED, MAPPED = "My CSV files", "My logs"

__all__ = [
    "MAPPED", "SIMULATED", "UPLOADED", "WITH_PROBLEM", "agree", "agreed", "begin", "chosen",
    "first_origin", "held", "kept", "log_key", "measured", "open_measured", "opened_logs",
    "origins", "preset", "problem_of", "selection", "stock", "study", "take_files",
]  # fmt: skip


def begin(initial: str | None) -> None:
    """Choose a problem on the first visit."""
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
    return [*found, *([SIMULATED] if problem.experiments else []), UPLOADED, MAPPED]


def first_origin(source: str, problem: Problem) -> str:
    """Where records come from before the user says so: nothing is downloaded unasked."""
    options = origins(problem)
    if options[0] == WITH_PROBLEM and not at_hand(_folder(source)):
        return UPLOADED
    return options[0]


def stock(source: str, variant: str, origin: str) -> Stock:
    """Records of one origin."""
    problem = problem_of(source, variant)
    if origin == UPLOADED:
        return _uploaded(source, variant, _stamp(source), visit.edition())
    if origin == MAPPED:
        return _mapped(source, problem)
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
    """Names of the training and the validation records; those that exist."""
    guess = likely_test(names)
    defaults = {"train": [n for n in names if n not in guess], "test": list(guess)}
    found = []
    for part, default in defaults.items():
        key = kept(part, source, variant, origin)
        # A new file joins the training or the validation records, by its name.
        known = set(st.session_state.get(visit.SEEN + key, ()))
        picked = st.session_state.get(key, [])
        now = [n for n in names if (n in picked if n in known else n in default)]
        st.session_state[visit.SEEN + key] = list(names)
        if now != picked or key not in st.session_state:
            st.session_state[key] = now
        found.append(tuple(now))
    learn, judge = found
    if both := [name for name in learn if name in judge]:
        raise DataError(
            f"{', '.join(both)} is chosen for training and for validation. An error on records "
            "that a model was fitted to proves nothing: take it out on one side."
        )
    return learn, judge


def measured() -> tuple[str, ...]:
    """Shipped problems with measured records of others that are at hand."""
    folders = {name: _folder(name) for name in list_problems()}
    return tuple(n for n, place in folders.items() if measured_sets(place) and at_hand(place))


def open_measured(source: str) -> None:
    """Choose a shipped problem and its measured records."""
    st.session_state[kept("source")] = source
    st.session_state[kept("origin", source, DEFAULT_MODEL)] = WITH_PROBLEM


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


def log_key(source: str) -> str:
    """Under what the logs for a problem are held."""
    return f"log:{source}"


def held(key: str) -> dict[str, bytes]:
    """Files that were given, by name."""
    files: dict[str, bytes] = st.session_state.get(visit.FILES + key, {})
    return files


def take_files(words: str, key: str, endings: Sequence[str]) -> None:
    """Ask for files, and keep them when the page is left."""
    files = st.file_uploader(
        words, type=list(endings), accept_multiple_files=True, key=f"upload:{key}",
        on_change=_take, args=(key,),
    )  # fmt: skip
    if not files:  # drawn anew: it shows none of the files that were given before
        st.session_state[f"shown:{key}"] = set()
    if have := held(key):
        shown = st.session_state.get(f"shown:{key}", set())
        if hidden := [name for name in have if name not in shown]:
            st.caption(f"Given before: {', '.join(hidden)}")
        if st.button("Forget these files", key=f"forget:{key}"):
            have.clear()
            visit.files_changed()
            st.rerun()


def _take(key: str) -> None:
    """Keep the files that were given, and forget those that were taken back."""
    have: dict[str, bytes] = st.session_state.setdefault(visit.FILES + key, {})
    now = {file.name: file.getvalue() for file in st.session_state[f"upload:{key}"]}
    for name in st.session_state.get(f"shown:{key}", set()) - set(now):
        have.pop(name, None)
    have.update(now)
    visit.files_changed()
    st.session_state[f"shown:{key}"] = set(now)


def opened_logs(source: str) -> mapping.Opened:
    """Logs that were given for a problem."""
    key = log_key(source)
    check_uploads(held(key))
    return _opened(key, visit.edition(), answers.time_column(source))


@st.cache_resource(show_spinner="Reading the logs", max_entries=10)
def _opened(key: str, edition: str, time: tuple[str, str] | None) -> mapping.Opened:
    return mapping.open_files(held(key), time)


def _mapped(source: str, problem: Problem) -> Stock:
    if not held(log_key(source)):
        return Stock(None, {})
    opened = opened_logs(source)
    if not opened.logs:
        return Stock(None, dict(opened.refused))
    made = answers.asked(source, problem)
    return _imported(
        source, visit.edition(), answers.time_column(source), made.text(), made, problem
    )


@st.cache_resource(show_spinner="Making records", max_entries=10)
def _imported(
    source: str,
    edition: str,
    time: tuple[str, str] | None,
    text: str,
    _made: LogMapping,
    _problem: Problem,
) -> Stock:
    return Stock(*mapping.imported(opened_logs(source), _made, _problem.channels))


@st.cache_resource(show_spinner="Reading the files", max_entries=10)
def _uploaded(source: str, variant: str, stamp: float, edition: str) -> Stock:
    files: dict[str, bytes] = st.session_state.get(visit.FILES + source, {})
    check_uploads(files)
    return (
        Stock(*read_uploads(_loaded(source, variant, stamp), files)) if files else Stock(None, {})
    )


@st.cache_resource(show_spinner="Reading the records", max_entries=10)
def _shipped(source: str, variant: str, stamp: float, origin: str) -> Dataset:
    problem = _loaded(source, variant, stamp)
    return simulated(problem) if origin == SIMULATED else problem.data()
