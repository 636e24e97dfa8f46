"""One visit of a browser tab: which study it works on, fetched at the begin, kept at the end."""

from __future__ import annotations

from secrets import token_hex
from typing import Any

import streamlit as st

from oed_sysid.app.jobs import Desk
from oed_sysid.app.shelf import Asked, Left, Shelf, is_id, new_id
from oed_sysid.runtime.files import private_cache

KEEP, SEEN, FILES = "keep:", "seen:", "files:"
_ADDRESS = "study"
# Title of the first page, and the choices that are made there only.
FIRST = "Problem"
_CHOICES = ("source", "variant", "origin", "known_noise", "train", "test", "look", "map")
_OF_FIRST = tuple(f"{KEEP}{name}" for name in _CHOICES)


@st.cache_resource(show_spinner=False)
def desk() -> Desk:
    """The desk at which the work of all studies is done."""
    return Desk(private_cache() / "app" / "results")


def shelf() -> Shelf:
    """The shelf of this user's studies."""
    return Shelf(private_cache() / "app" / "studies")


def begin() -> bool:
    """Open the study that the address names, or a new one; say whether it is an earlier one."""
    state = st.session_state
    earlier = False
    if "study" not in state:
        name = st.query_params.get(_ADDRESS)
        left = shelf().find(name) if name else None
        state["study"] = name if is_id(name) else new_id()
        state["edition"] = token_hex(4)
        if left is not None:
            _restore(left)
            earlier = True
    if st.query_params.get(_ADDRESS) != state["study"]:
        st.query_params[_ADDRESS] = state["study"]  # for a reload of any page
    # Streamlit forgets a widget that is not on the page, also while a part of the page is drawn
    # anew on its own, as the progress of a job is; these are kept all the same.
    # Where a job's progress was drawn, it also brings back widgets of earlier pages with nothing in
    # them: what a widget says counts only after its page was drawn.
    for key, value in state.get("held", {}).items():
        if key not in state or _elsewhere(key):
            state[key] = value
    for key in list(state):
        if str(key).startswith(KEEP):
            state[key] = state[key]
    _hold()
    if "kept text" in state:  # before anything is drawn: a reload may come at once
        end(str(state.get("title", "")))
    return earlier


def _elsewhere(key: str) -> bool:
    """Whether the page that was drawn last is none that has the widget of a kept value."""
    state = st.session_state
    drawn = state.get("drawn")
    if drawn is None:
        return False
    if key.startswith(_OF_FIRST):
        return bool(drawn != FIRST)
    homes = state.get("homes", {}).get(key)
    return bool(homes) and drawn not in homes


def _hold() -> None:
    """Note the kept values where no widget's coming and going touches them."""
    state = st.session_state
    state["held"] = {key: state[key] for key in list(state) if str(key).startswith(KEEP)}


def study_id() -> str:
    """Id of the study of this tab."""
    name: str = st.session_state.setdefault("study", new_id())
    return name


def asked() -> dict[str, Asked]:
    """What was asked for in this study, by key of the job."""
    found: dict[str, Asked] = st.session_state.setdefault("asked", {})
    return found


def note(key: str, about: Asked) -> None:
    """Remember that work was asked for."""
    asked()[key] = about


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
    st.session_state["edition"] = token_hex(4)


def edition() -> str:
    """What changes with the files of this visit."""
    return str(st.session_state.get("edition", ""))


def end(title: str) -> None:
    """Keep the study if anything in it has changed since it was looked at first."""
    state = st.session_state
    state["title"] = title
    _hold()
    left = _left(title)
    text = left.text()
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
    choices: dict[str, Any] = {
        str(key): value for key, value in state.items() if str(key).startswith((KEEP, SEEN))
    }
    files = {
        str(key).removeprefix(FILES): held
        for key, held in state.items()
        if str(key).startswith(FILES)
    }
    return Left(title, choices, state.get("agreed", {}), asked(), files)


def _restore(left: Left) -> None:
    state = st.session_state
    for key, value in left.choices.items():
        state[key] = value
    state["agreed"] = dict(left.agreed)
    state["asked"] = dict(left.asked)
    for source, held in left.files.items():
        state[FILES + source] = dict(held)
    state["kept text"] = _left(left.title).text()
