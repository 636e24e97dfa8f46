"""The frame around the pages: navigation, what is being studied, errors in words.

It is the script that ``streamlit run`` executes, once per click.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import streamlit as st

from oed_sysid.app import advice, choices, page_problem, takeaway, visit
from oed_sysid.app import pages as tasks
from oed_sysid.app.jobs import said_of
from oed_sysid.app.panels import BEGIN, message, style
from oed_sysid.app.trust import is_user
from oed_sysid.app.visit import ago, new_id
from oed_sysid.cli.study import Study
from oed_sysid.errors import OedSysidError

_ICON = str(Path(__file__).with_name("icon.svg"))


@dataclass(frozen=True)
class Step:
    """One step of the work, with a page of its own.

    Parameters
    ----------
    title, address, symbol : str
    purpose : str
        What it is for, in one sentence.
    draw : callable
        Draws the page on the study.
    reports : tuple of str
        Reports of which one ticks it off.
    """

    title: str
    address: str
    symbol: str
    purpose: str
    draw: Callable[[Study], None]
    reports: tuple[str, ...] = ()

    def show(self) -> None:
        """Draw title, purpose, the next step and the page."""
        st.header(self.title)
        st.caption(self.purpose)
        study = choices.study()
        _point(self.title, study)
        self.draw(study)


# In the order of the work.
STEPS = (
    Step(advice.CHECK, "check", "fact_check",
         "Whether the signals agree with each other, before any model of forces.",
         tasks.check, ("check",)),
    Step(advice.FIT, "fit", "tune",
         "The parameters of the model that you believe in, and how well it predicts.",
         tasks.fit, ("fit",)),
    Step(advice.FAILS, "fails", "compare_arrows",
         "In which signal, when and where in the chain of command, forces and sensors it fails.",
         tasks.compare, ("compare", "diagnose")),
    Step(advice.MISSING, "missing", "add_circle",
         "The effects that the model lacks, each tested on records that no choice has seen.",
         tasks.improve, ("improve",)),
    Step(advice.PLAN, "plan", "route",
         "The trial that tells most about what is still uncertain, within the limits.",
         tasks.plan, ("rank", *advice.PLANNED)),
    Step(advice.REPORT, "report", "description",
         "What was done and found, as pages, commands and a script that repeat it.",
         takeaway.show),
    Step(advice.EXPORT, "export", "ios_share",
         "The model for other programs, and the records and the folder with it.",
         takeaway.give),
)  # fmt: skip


def _point(here: str, study: Study) -> None:
    """Lead to the one next step that the evidence asks for, where that is another page."""
    told = advice.following(study, takeaway.results(study))
    if told.page == here:
        return
    with st.container(horizontal=True, vertical_alignment="center", key="pointer"):
        words = f"Next: {told.page}"
        if st.button(words, icon=":material/arrow_forward:", key="next", type="primary"):
            # Once this page is drawn, and its choices kept; work that needs no choice begins there.
            st.session_state["going"] = told.page, told.page in (advice.FIT, advice.MISSING)
        st.markdown(told.why, width="content")


def _ticks() -> set[str]:
    """Titles of the steps that are done for these records."""
    try:
        study = choices.study()
    except OedSysidError:
        return set()
    done = takeaway.results(study)
    found = {step.title for step in STEPS if any(one in done for one in step.reports)}
    found |= {visit.FIRST} if study.train is not None else set()
    found |= {advice.EXPORT} if st.session_state.get("exports") else set()
    return found | ({advice.REPORT} if st.session_state.get("read") and done else set())


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
    ticks = _ticks()
    rail = [(visit.FIRST, "data", "directions_boat", _first)]
    rail += [(step.title, step.address, step.symbol, step.show) for step in STEPS]
    pages = [
        st.Page(_guarded(draw), title=title, url_path=address, default=title == visit.FIRST,
                icon=f":material/{'check_circle' if title in ticks else symbol}:")
        for title, address, symbol, draw in rail
    ]  # fmt: skip
    st.session_state["pages"] = {page.title: page for page in pages}
    page = st.navigation(pages)
    st.session_state["drawn"] = page.title
    page.run()
    with st.sidebar:
        _guarded(_aside)()
    _guarded(_keep)()
    st.session_state.pop(BEGIN, None)  # of this page, whether or not it had anything to begin
    title, begins = st.session_state.pop("going", (None, False))
    if title is not None:
        st.session_state[BEGIN] = begins
        st.switch_page(st.session_state["pages"][title])


def _first() -> None:
    """Draw the page of data: it chooses what the others are about."""
    st.caption("The vehicle, and the records of it: which to learn from, and which to judge by.")
    above = st.container()
    page_problem.show()
    with suppress(OedSysidError), above:  # what is wrong is said where the records are
        _point(visit.FIRST, choices.study())


def _aside() -> None:
    """Say what is being studied; what is wrong with it, the page says."""
    _studies()
    try:
        study = choices.study()
    except OedSysidError:
        return
    st.markdown(f"**{study.problem.title}**")
    for words, records in (("Training records", study.train), ("Validation records", study.test)):
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
