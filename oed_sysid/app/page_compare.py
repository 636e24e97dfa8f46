"""Page 3: where the model fails, on validation records and in the training records."""

from __future__ import annotations

from functools import partial

import streamlit as st

from oed_sysid.app import choices, commands, tasks
from oed_sysid.app.panels import Asked, command, html_download, work
from oed_sysid.app.panels import show as show_page
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
    about = Asked("Comparison on validation records", "compare", line)
    key = ("compare", groups, *study.key)
    outcome = work("Compare", key, about, partial(tasks.compare, study, groups))
    if outcome is not None:
        show_page(outcome.page)
        html_download(outcome.page, "compare")
    command(line)


def _diagnose(study: Study) -> None:
    study.training()
    line = commands.diagnose(study)
    about = Asked("Diagnosis", "diagnose", line)
    outcome = work("Diagnose", ("diagnose", *study.key), about, partial(tasks.diagnose, study))
    if outcome is not None:
        show_page(outcome.page)
        html_download(outcome.page, "diagnose")
    command(line)
