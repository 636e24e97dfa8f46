"""Page 4: find the missing effects, or keep a choice of them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import streamlit as st

from oed_sysid.app import choices, commands, tasks
from oed_sysid.app.panels import Asked, command, html_download, work
from oed_sysid.app.panels import show as show_page
from oed_sysid.app.study import Study

if TYPE_CHECKING:
    from oed_sysid.diagnosis.improvement import Improvement


def show(study: Study) -> None:
    """Draw the page."""
    st.header("Improve")
    study.training()
    if study.test is None:
        st.warning(
            "There is no validation record, so what is found cannot be tested. Choose one on the "
            "page Problem."
        )
    key = choices.preset(choices.kept("most", study.source, study.variant), 4)
    most = st.columns(2)[0].slider("Most effects to add", 1, 6, key=key)
    line = commands.improve(study, most)
    about = Asked("Missing physics", "improve", line)
    asked = ("improve", most, *study.key)
    outcome = work("Find what is missing", asked, about, partial(tasks.improve, study, most))
    if outcome is not None:
        show_page(outcome.page)
        html_download(outcome.page, "improve")
        _tell_apart(study, outcome.result)
    command(line)
    if outcome is not None and study.test is not None:
        _step_back(study, outcome.result)


def _tell_apart(study: Study, found: Improvement) -> None:
    """Lead from effects that cannot be told apart to the trial that tells them apart."""
    known = {effect.name for effect in study.problem.effects}
    for step in found.steps:
        group = [name for name in step.group if name in known]
        if len(group) > 1 and st.button(
            f"Design the trial that tells {' and '.join(group)} apart", key=f"apart:{step.added}"
        ):
            st.session_state[choices.kept("rivals", study.source, study.variant)] = group
            st.session_state[choices.kept("plan")] = "Design"
            st.switch_page(st.session_state["pages"]["Plan the next trial"])


def _step_back(study: Study, found: Improvement) -> None:
    """Choose which effects to keep, and judge that choice."""
    st.subheader("Take a step back")
    known = [effect.name for effect in study.problem.effects]
    added = [step.added for step in found.steps if step.added in known]
    key = choices.preset(choices.kept("effects", study.source, study.variant), added)
    effects = tuple(st.multiselect("Effects to keep", known, key=key))
    if not effects:
        st.caption("Without an effect this is the nominal model.")
        return
    groups = (effects,)
    line = commands.compare(study, groups)
    about = Asked(f"With {', '.join(effects)}", "kept", line.replace("compare.html", "kept.html"))
    asked = ("compare", groups, *study.key)
    outcome = work("Fit with these", asked, about, partial(tasks.compare, study, groups))
    if outcome is not None:
        show_page(outcome.page)
        html_download(outcome.page, "kept")
    command(about.command)
