"""What the user chose, kept while pages come and go, and the study that follows from it.

Records come with the problem, are simulated, or are uploaded.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import streamlit as st

from oed_sysid import Dataset, Problem, list_problems, load_problem, read_csv, simulate
from oed_sysid.app import mapping, visit
from oed_sysid.app.mapping import Stock
from oed_sysid.app.trust import check_trusted, check_uploads, consent, folder_of
from oed_sysid.app.visit import chosen, kept
from oed_sysid.cli.study import DEFAULT_MODEL, Study
from oed_sysid.data.logs import LogMapping
from oed_sysid.data.third_party import data_folder, registered
from oed_sysid.errors import DataError

_FIRST = "remus_diving_plane"
WITH_PROBLEM, SIMULATED = "With the problem", "Simulated"
UPLOADED, MAPPED = "My CSV files", "My logs"


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
    if options[0] == WITH_PROBLEM and not at_hand(folder_of(source)):
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
    variant = chosen("variant", source, default=DEFAULT_MODEL)
    problem = problem_of(source, variant)
    origin = chosen("origin", source, variant) or first_origin(source, problem)
    held = stock(source, variant, origin)
    learn, judge = selection(source, variant, origin, held.names)
    train, test = (
        Dataset(tuple(held.records[name] for name in names)) if held.records and names else None
        for names in (learn, judge)
    )
    return Study(source, variant, problem, train, test, bool(chosen("known_noise", source)))


def selection(
    source: str, variant: str, origin: str, names: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the training and the validation records; those that exist."""
    guess = likely_test(names)
    defaults = {"train": [n for n in names if n not in guess], "test": list(guess)}
    learn, judge = (
        _picked(kept(part, source, variant, origin), names, default)
        for part, default in defaults.items()
    )
    if both := [name for name in learn if name in judge]:
        raise DataError(
            f"{', '.join(both)} is chosen for training and for validation. An error on records "
            "that a model was fitted to proves nothing: take it out on one side."
        )
    return learn, judge


def _picked(key: str, names: tuple[str, ...], default: Sequence[str]) -> tuple[str, ...]:
    """What is picked of records; a new file joins by its name."""
    known = set(st.session_state.get(visit.SEEN + key, ()))
    picked = st.session_state.get(key, [])
    now = [n for n in names if (n in picked if n in known else n in default)]
    st.session_state[visit.SEEN + key] = list(names)
    if now != picked or key not in st.session_state:
        st.session_state[key] = now
    return tuple(now)


def measured() -> tuple[str, ...]:
    """Shipped problems with measured records of others that are at hand."""
    folders = {name: folder_of(name) for name in list_problems()}
    return tuple(n for n, place in folders.items() if measured_sets(place) and at_hand(place))


def _stamp(source: str) -> float:
    """Time of the last change of a folder's Python files; zero for a shipped problem."""
    folder = folder_of(source)
    if source in list_problems() or not folder.is_dir():
        return 0.0
    files = [*folder.glob("*.py"), *folder.glob("data/*.csv")]
    return max((file.stat().st_mtime for file in files), default=0.0)


@st.cache_resource(show_spinner="Reading the problem", max_entries=20)
def _loaded(source: str, variant: str, stamp: float) -> Problem:
    return load_problem(source, variant=variant)


def _mapped(source: str, problem: Problem) -> Stock:
    if not mapping.held(mapping.log_key(source)):
        return Stock(None, {})
    opened = mapping.opened_logs(source)
    if not opened.logs:
        return Stock(None, dict(opened.refused))
    made = mapping.asked(source, problem)
    asked = (visit.edition(), mapping.time_column(source), made.text())
    return _imported(source, asked, made, problem)


@st.cache_resource(show_spinner="Making records", max_entries=10)
def _imported(source: str, asked: tuple[Any, ...], _made: LogMapping, _problem: Problem) -> Stock:
    return mapping.imported(mapping.opened_logs(source), _made, _problem.channels)


@st.cache_resource(show_spinner="Reading the files", max_entries=10)
def _uploaded(source: str, variant: str, stamp: float, edition: str) -> Stock:
    files = mapping.held(source)
    check_uploads(files)
    return read_uploads(_loaded(source, variant, stamp), files)


@st.cache_resource(show_spinner="Reading the records", max_entries=10)
def _shipped(source: str, variant: str, stamp: float, origin: str) -> Dataset:
    problem = _loaded(source, variant, stamp)
    return simulated(problem) if origin == SIMULATED else problem.data()


# -- records -----------------------------------------------------------------------------


def read_uploads(problem: Problem, files: Mapping[str, bytes]) -> Stock:
    """Read uploaded CSV files with the checks and messages of :func:`read_csv`.

    Parameters
    ----------
    problem : Problem
        Whose channels are looked for.
    files : mapping of str to bytes
        Contents by file name.

    Returns
    -------
    Stock
        Its notes say what looks odd in the files that can be used.
    """
    with warnings.catch_warnings(record=True) as odd:
        warnings.simplefilter("always", UserWarning)
        found, refused = mapping.read_each(files, lambda path: read_csv(path, problem.channels))
    notes = (str(one.message) for one in odd if issubclass(one.category, UserWarning))
    return Stock.of(chain.from_iterable(found.values()), refused, notes)


def simulated(problem: Problem, *, seed: int = 0) -> Dataset:
    """Simulate every experiment of a problem, its truth where it states one.

    The same as ``oed-sysid simulate PROBLEM [--truth] --seed SEED``.

    Parameters
    ----------
    problem : Problem
        With experiments.
    seed : int
        Of the measurement noise.
    """
    if not problem.experiments:
        raise DataError(
            f"Problem {problem.name!r} has no experiments to simulate. Add one to its problem.py, "
            "or upload records."
        )
    model = problem.true_model() if problem.truth else problem.model
    rng = np.random.default_rng(seed)
    return Dataset(tuple(simulate(model, one, rng=rng) for one in problem.experiments.values()))


def measured_sets(folder: Path) -> tuple[str, ...]:
    """Files of third-party data that a problem's programs name, by their sets.

    Parameters
    ----------
    folder : Path
        Of the problem.
    """
    code = "".join(
        file.read_text(encoding="utf-8", errors="replace") for file in sorted(folder.glob("*.py"))
    )
    return tuple(path for path in registered() if path.partition("/")[0] in code)


def at_hand(folder: Path) -> bool:
    """Whether the records of a problem can be read without a download.

    Parameters
    ----------
    folder : Path
        Of the problem: its records are in its ``data``, or measured by others and fetched before.
    """
    if any(folder.glob("data/*")):
        return True
    files = measured_sets(folder)
    return bool(files) and all((data_folder() / path).is_file() for path in files)


def likely_test(names: tuple[str, ...]) -> tuple[str, ...]:
    """Records that look as if they were meant for the test; else the last of several.

    Examples
    --------
    >>> likely_test(("train_1", "test_1")), likely_test(("a", "b")), likely_test(("a",))
    (('test_1',), ('b',), ())
    """
    named = tuple(name for name in names if name.lower().startswith(("test", "valid")))
    if named and len(named) < len(names):
        return named
    return names[-1:] if len(names) > 1 else ()
