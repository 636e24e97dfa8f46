"""Page 2: estimate the parameters of the nominal model."""

from __future__ import annotations

from functools import partial

import streamlit as st

from oed_sysid.app import commands, tasks
from oed_sysid.app.panels import Asked, command, html_download, work
from oed_sysid.app.panels import show as show_page
from oed_sysid.app.study import Study


def show(study: Study) -> None:
    """Draw the page."""
    st.header("Fit")
    line = commands.fit(study)
    study.training()
    about = Asked("Fit", "fit", line)
    outcome = work("Fit", ("fit", *study.key), about, partial(tasks.fit, study))
    if outcome is not None:
        st.caption(outcome.page.subtitle)
        show_page(outcome.page)
        html_download(outcome.page, "fit")
    command(line)
