"""One visit of a browser tab, and the studies of this user on their shelf.

A study is what was chosen, given and asked for. It has an id, which stands in the address of the
page: whoever opens that address again, in the same tab or another, after a reload or after the
program was started anew, finds the study as it was left. It is fetched at the begin of a visit and
kept at its end. The shelf stands in the private folder of the user's cache, sealed as results are:
what others could have written there is not read.
"""

from __future__ import annotations

import re
import secrets
import shutil
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import streamlit as st

from oed_sysid.app.jobs import Desk
from oed_sysid.errors import OedSysidError
from oed_sysid.runtime.files import make_private, private, private_cache
from oed_sysid.runtime.journal import CellStore

_ID = re.compile(r"[0-9a-f]{16}")


@dataclass(frozen=True)
class Asked:
    """Work that was asked for in a study.

    Parameters
    ----------
    title : str
        What it is.
    file : str
        Name of its report, without ending.
    command : str
        The same on the command line.
    code : str
        The same in Python, as a part of the script that repeats the study.
    about : str
        Digest of the study that it was asked about.
    """

    title: str
    file: str
    command: str
    code: str = ""
    about: str = ""


@dataclass(frozen=True)
class Left:
    """A study as it was left.

    Parameters
    ----------
    title : str
        Title of its problem.
    choices : mapping
        Values of widgets, by key.
    agreed : mapping of str to bool
        Problems that may be run.
    asked : mapping of str to Asked
        Work that was asked for, by key of its job.
    files : mapping
        Files that were given, by source and name.
    """

    title: str = ""
    choices: Mapping[str, Any] = field(default_factory=dict)
    agreed: Mapping[str, bool] = field(default_factory=dict)
    asked: Mapping[str, Asked] = field(default_factory=dict)
    files: Mapping[str, Mapping[str, bytes]] = field(default_factory=dict)

    @property
    def bare(self) -> Left:
        """Everything but the files."""
        return replace(self, files={})


@dataclass(frozen=True)
class Shelf:
    """A folder of studies.

    Parameters
    ----------
    folder : Path
        Made, for the user alone, when the first study is kept.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     shelf = Shelf(Path(place) / "studies")
    ...     name = new_id()
    ...     shelf.keep(name, Left("Ship", {"keep:source": "ship"}, files={"ship": {"a.csv": b"t"}}))
    ...     back = shelf.find(name)
    >>> back.title, back.choices, back.files
    ('Ship', {'keep:source': 'ship'}, {'ship': {'a.csv': b't'}})
    """

    folder: Path

    def keep(self, name: str, left: Left, *, files: bool = True) -> None:
        """Write a study.

        Parameters
        ----------
        name : str
            Its id.
        left : Left
            The study.
        files : bool
            Whether to write the given files as well, which seldom change.
        """
        store = self._store(name)
        make_private(store.folder)
        if files:
            store.write("files", left.files)
        store.write("study", left.bare)

    def find(self, name: str) -> Left | None:
        """Return a study; None where there is none that can be read."""
        if not is_id(name) or not private(self.folder / name):
            return None
        kept = self._store(name).find(("study", "files"))
        with suppress(KeyError, AttributeError):  # none, or one of another version
            return replace(kept["study"], files=kept.get("files", {}))
        return None

    def recent(self, most: int = 20) -> dict[str, tuple[str, float]]:
        """Titles and times (s since 1970) of the studies that were changed last, newest first."""
        found: dict[str, float] = {}
        with suppress(OSError):
            for name in (place.name for place in self.folder.iterdir() if is_id(place.name)):
                if (file := self._store(name).path("study")).is_file() and private(file.parent):
                    found[name] = file.stat().st_mtime
        newest = sorted(found, key=lambda name: -found[name])[:most]
        studies = {name: self._store(name).find(["study"]) for name in newest}
        return {n: (kept["study"].title, found[n]) for n, kept in studies.items() if kept}

    def forget(self, name: str) -> None:
        """Remove a study with its files."""
        if is_id(name):
            shutil.rmtree(self.folder / name, ignore_errors=True)

    def _store(self, name: str) -> CellStore:
        if not is_id(name):
            raise OedSysidError(f"{name!r:.40} is no study. Open the page Data and begin one.")
        return CellStore(self.folder / name)


def new_id() -> str:
    """Draw the id of a new study.

    >>> is_id(new_id())
    True
    """
    return secrets.token_hex(8)


def is_id(name: object) -> bool:
    """Whether a text can be the id of a study.

    >>> is_id("../../secrets"), is_id("0123456789abcdef")
    (False, True)
    """
    return isinstance(name, str) and _ID.fullmatch(name) is not None


def ago(when: float) -> str:
    """How long ago something was, in words.

    >>> ago(time.time() - 7300.0)
    '2 h ago'
    """
    minutes = max(time.time() - when, 0.0) / 60.0
    if minutes < 48 * 60:
        return f"{minutes:.0f} min ago" if minutes < 60 else f"{minutes / 60:.0f} h ago"
    return f"{minutes / 1440:.0f} days ago"


# -- the visit ---------------------------------------------------------------------------

KEEP, SEEN, FILES = "keep:", "seen:", "files:"
_ADDRESS = "study"
# Title of the first page, and the choices that are made there only.
FIRST = "Data"
_CHOICES = ("source", "variant", "origin", "known_noise", "train", "test", "look", "map")
_OF_FIRST = tuple(f"{KEEP}{name}" for name in _CHOICES)


@st.cache_resource(show_spinner=False)
def desk() -> Desk:
    """The desk at which the work of all studies is done."""
    return Desk(private_cache() / "app" / "results")


def shelf() -> Shelf:
    """The shelf of this user's studies."""
    return Shelf(private_cache() / "app" / "studies")


def begin() -> None:
    """Open the study that the address names, or a new one."""
    state = st.session_state
    if "study" not in state:
        name = str(st.query_params.get(_ADDRESS, ""))
        state["study"] = name if is_id(name) else new_id()
        state["edition"] = secrets.token_hex(4)
        if (left := shelf().find(name)) is not None:
            _restore(left)
    if st.query_params.get(_ADDRESS) != state["study"]:
        st.query_params[_ADDRESS] = state["study"]  # for a reload of any page
    # Streamlit forgets a widget that is not on the page, also while a part of the page is drawn
    # anew on its own, as the progress of a job is; these are kept all the same.
    # Where a job's progress was drawn, it also brings back widgets of earlier pages with nothing in
    # them: what a widget says counts only after its page was drawn.
    for key, value in state.get("held", {}).items():
        if key not in state or _elsewhere(key):
            state[key] = value
    _hold()
    state.update(state["held"])
    if "kept text" in state:  # before anything is drawn: a reload may come at once
        end(str(state.get("title", "")))


def _elsewhere(key: str) -> bool:
    """Whether the page that was drawn last is none that has the widget of a kept value."""
    state = st.session_state
    drawn = state.get("drawn")
    homes = {FIRST} if key.startswith(_OF_FIRST) else state.get("homes", {}).get(key)
    return drawn is not None and bool(homes) and drawn not in homes


def _hold() -> None:
    """Note the kept values where no widget's coming and going touches them."""
    state = st.session_state
    state["held"] = {key: state[key] for key in list(state) if str(key).startswith(KEEP)}


def study_id() -> str:
    """Id of the study of this tab."""
    return st.session_state.setdefault("study", new_id())


def asked() -> dict[str, Asked]:
    """What was asked for in this study, by key of the job."""
    return st.session_state.setdefault("asked", {})


def kept(*names: str) -> str:
    """Key of a widget whose value outlives its page."""
    key = KEEP + ":".join(names)
    homes: dict[str, set[str | None]] = st.session_state.setdefault("homes", {})
    homes.setdefault(key, set()).add(st.session_state.get("drawn"))
    return key


def chosen(*names: str, default: Any = None) -> Any:
    """Value of a kept widget, or of none yet."""
    return st.session_state.get(kept(*names), default)


def preset(key: str, value: Any) -> str:
    """Give a widget its first value, and return its key."""
    st.session_state.setdefault(key, value)
    return key


def files_changed() -> None:
    """Have the given files written at the end of this run, and read anew."""
    st.session_state["new files"] = True
    st.session_state["edition"] = secrets.token_hex(4)


def edition() -> str:
    """What changes with the files of this visit."""
    return str(st.session_state.get("edition", ""))


def end(title: str) -> None:
    """Keep the study if anything in it has changed since it was looked at first."""
    state = st.session_state
    state["title"] = title
    _hold()
    left = _left(title)
    text = repr(left.bare)
    new_files = state.pop("new files", False)
    known = state.setdefault("kept text", text)
    if text == known and not new_files:
        return
    shelf().keep(state["study"], left, files=new_files)
    state["kept text"] = text


def open_study(name: str) -> None:
    """Leave this study and open another, or a new one."""
    key = st.session_state.get("key")
    st.session_state.clear()
    st.session_state.update({"is_user": True, "key": key})
    st.query_params[_ADDRESS] = name


def _left(title: str) -> Left:
    state = st.session_state
    everything = {str(key): value for key, value in state.items()}
    choices = {key: one for key, one in everything.items() if key.startswith((KEEP, SEEN))}
    files = {k.removeprefix(FILES): one for k, one in everything.items() if k.startswith(FILES)}
    return Left(title, choices, state.get("agreed", {}), asked(), files)


def _restore(left: Left) -> None:
    state = st.session_state
    state.update(left.choices)
    state.update({"agreed": dict(left.agreed), "asked": dict(left.asked)})
    state.update({FILES + source: dict(held) for source, held in left.files.items()})
    state["kept text"] = repr(_left(left.title).bare)
