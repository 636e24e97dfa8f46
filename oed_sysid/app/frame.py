"""The frame around the pages: navigation, what is being studied, errors in words.

It is the script that ``streamlit run`` executes, once per click.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path

import streamlit as st

from oed_sysid.app import choices, page_problem, takeaway, visit
from oed_sysid.app import pages as tasks
from oed_sysid.app.jobs import said_of
from oed_sysid.app.panels import message, style
from oed_sysid.app.trust import is_user
from oed_sysid.app.visit import ago, new_id
from oed_sysid.cli.study import Study
from oed_sysid.errors import OedSysidError

_ICON = str(Path(__file__).with_name("icon.svg"))


def _of_study(title: str, page: Callable[[Study], None]) -> None:
    """Draw a page on the study."""
    st.header(title)
    page(choices.study())


# Title, address and symbol of each page, in the order of the work.
PAGES: tuple[tuple[str, str, str, Callable[[], None]], ...] = (
    (visit.FIRST, "problem", "directions_boat", page_problem.show),
    *(
        (title, address, symbol, partial(_of_study, title, draw))
        for title, address, symbol, draw in (
            ("Check the log", "check", "fact_check", tasks.check),
            ("Fit", "fit", "tune", tasks.fit),
            ("Compare and diagnose", "compare", "compare_arrows", tasks.compare),
            ("Improve", "improve", "add_circle", tasks.improve),
            ("Plan the next trial", "plan", "route", tasks.plan),
            ("Report", "report", "description", takeaway.show),
        )
    ),
)


def show(initial: str | None = None) -> None:
    """Draw the application.

    Parameters
    ----------
    initial : str, optional
        Problem to begin with.
    """
    # An own icon of the browser's tab: that of a page's symbol would be fetched from elsewhere.
    st.set_page_config("oed_sysid", _ICON, layout="wide")
    if not st.session_state.get("is_user"):
        if not is_user(st.query_params.get("key")):
            message(
                "This address does not carry the key of this application. Open the one that was "
                "printed in the terminal when it was started."
            )
            st.stop()
        st.session_state["is_user"] = True
        st.session_state["key"] = st.query_params.get("key")
    if st.session_state["key"] and st.query_params.get("key") != st.session_state["key"]:
        st.query_params["key"] = st.session_state["key"]  # for a reload of any page
    visit.begin()
    choices.begin(initial)
    style()
    pages = [
        st.Page(_guarded(draw), title=title, url_path=address, icon=f":material/{symbol}:",
                default=title == visit.FIRST)
        for title, address, symbol, draw in PAGES
    ]  # fmt: skip
    st.session_state["pages"] = {page.title: page for page in pages}
    page = st.navigation(pages)
    st.session_state["drawn"] = page.title
    page.run()
    if page in pages[:-1]:
        following = pages[pages.index(page) + 1]
        if st.button(f"Next: {following.title}", icon=":material/arrow_forward:", key="next"):
            st.switch_page(following)
    with st.sidebar:
        _guarded(_aside)()
    _guarded(_keep)()


def _aside() -> None:
    """Say what is being studied; what is wrong with it, the page says."""
    _studies()
    try:
        study = choices.study()
    except OedSysidError:
        return
    st.markdown(f"**{study.problem.title}**")
    parts = (("Training records", study.train), ("Validation records", study.test))
    for words, records in parts:
        st.caption(f"{words}: {', '.join(records.names) if records else 'none'}")
    if running := visit.desk().running(visit.study_id()):
        st.caption(f":material/hourglass_top: {running} at work")


def _studies() -> None:
    """Lead to earlier studies and to a new one."""
    here = visit.study_id()
    with st.popover("Studies", icon=":material/folder_open:", width="stretch"):
        if st.button("New study", icon=":material/add:", key="new study", width="stretch"):
            visit.open_study(new_id())
            st.rerun()
        for name, (title, when) in visit.shelf().recent().items():
            if name == here:
                continue
            left, right = st.columns([5, 1], vertical_alignment="center")
            if left.button(f"{title}, {ago(when)}", key=f"open:{name}", width="stretch"):
                visit.open_study(name)
                st.rerun()
            if right.button("", icon=":material/delete:", key=f"forget:{name}", help="Forget it"):
                visit.shelf().forget(name)
                st.rerun()


def _keep() -> None:
    """Put the study on the shelf as it is now."""
    try:
        title = choices.study().problem.title
    except OedSysidError:
        title = str(choices.chosen("source") or "")
    visit.end(title)


def _guarded(draw: Callable[[], None]) -> Callable[[], None]:
    """Draw, and say in words what cannot be drawn."""

    def drawn() -> None:
        try:
            draw()
        except Exception as error:
            if not isinstance(error, OedSysidError):
                traceback.print_exc()  # for the terminal
            message(said_of(error))

    return drawn


if __name__ == "__main__":
    show(sys.argv[1] if len(sys.argv) > 1 else None)
