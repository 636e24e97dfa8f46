"""Page 2: estimate the parameters of the nominal model."""

from __future__ import annotations

import streamlit as st

from oed_sysid.app import commands, script, tasks, views
from oed_sysid.app.panels import command, html_download, work
from oed_sysid.app.panels import show as show_page
from oed_sysid.app.shelf import Asked
from oed_sysid.app.study import Study


def show(study: Study) -> None:
    """Draw the page."""
    st.header("Fit")
    line = commands.fit(study)
    study.training()
    about = Asked("Fit", "fit", line, script.fit(study))
    outcome = work("Fit", about, study, tasks.fit)
    if outcome is not None:
        st.caption(outcome.page.subtitle)
        show_page(outcome.page, views.of_fit(outcome.result, "fit"))
        html_download(outcome.page, "fit")
    command(line)
