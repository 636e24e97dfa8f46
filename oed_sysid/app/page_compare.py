"""Page 3: where the model fails, on validation records and in the training records."""

from __future__ import annotations

import streamlit as st

from oed_sysid.app import choices, commands, script, tasks, views
from oed_sysid.app.panels import command, html_download, work
from oed_sysid.app.panels import show as show_page
from oed_sysid.app.shelf import Asked
from oed_sysid.app.study import Study


def show(study: Study) -> None:
    """Draw the page."""
    st.header("Compare and diagnose")
    view = st.segmented_control(
        "View",
        ("Validation records", "Where it fails"),
        required=True,
        key=choices.preset(choices.kept("view"), "Validation records"),
        label_visibility="collapsed",
    )
    if view == "Validation records":
        _compare(study)
    else:
        _diagnose(study)


def _compare(study: Study) -> None:
    study.training(), study.validation()
    added = st.multiselect(
        "Also with one effect added",
        [effect.name for effect in study.problem.effects],
        key=choices.kept("with", study.source, study.variant),
    )
    groups = tuple((name,) for name in added)
    line = commands.compare(study, groups)
    code = script.compare(study, groups)
    about = Asked("Compare: validation records", "compare", line, code)
    outcome = work("Compare", about, study, tasks.compare, groups)
    if outcome is not None:
        show_page(outcome.page, views.of_comparison(outcome.result, "compare"))
        html_download(outcome.page, "compare")
    command(line)


def _diagnose(study: Study) -> None:
    study.training()
    line = commands.diagnose(study)
    about = Asked("Diagnose: where it fails", "diagnose", line, script.diagnose(study))
    outcome = work("Diagnose", about, study, tasks.diagnose)
    if outcome is not None:
        located = outcome.result.location
        fit = outcome.fits.get(tasks.NOMINAL)
        show_page(outcome.page, views.of_located(located, study.training(), fit, "diagnose"))
        html_download(outcome.page, "diagnose")
    command(line)
