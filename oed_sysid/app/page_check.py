"""Page 2: whether the records agree with themselves, before any model of forces."""

from __future__ import annotations

from functools import partial

import streamlit as st

from oed_sysid.app import commands, script, tasks
from oed_sysid.app.panels import command, download, html_download, work
from oed_sysid.app.panels import show as show_page
from oed_sysid.app.shelf import Asked
from oed_sysid.app.study import Study
from oed_sysid.evidence.check import why_not_more


def show(study: Study) -> None:
    """Draw the page; the check is quick, so that nobody has to ask for it."""
    st.header("Check the log")
    line = commands.check(study)
    study.records()
    about = Asked("Check the log", "check", line, script.check(study))
    outcome = work("Check", about, study, tasks.check, unasked=True)
    if outcome is not None:
        if outcome.result.suspect:
            st.error(outcome.result.verdict, icon=":material/warning:")
        st.caption(outcome.page.subtitle)
        show_page(outcome.page)
        html_download(outcome.page, "check")
        if outcome.result.suspect:
            copies = partial(tasks.corrected, study, outcome.result)
            download("Corrected copies (ZIP)", copies, "corrected.zip", "application/zip")
            reason = why_not_more(outcome.result)
            if reason:
                st.warning(f"Not corrected: {reason}.")
    command(line)
