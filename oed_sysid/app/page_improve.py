"""Page 4: find the missing effects, or keep a choice of them."""

from __future__ import annotations

import sys
from functools import partial
from typing import TYPE_CHECKING

import streamlit as st

from oed_sysid.app import choices, commands, script, tasks, views
from oed_sysid.app.panels import command, html_download, work
from oed_sysid.app.panels import show as show_page
from oed_sysid.app.shelf import Asked
from oed_sysid.app.study import Study
from oed_sysid.evidence.preparation import prepared

if TYPE_CHECKING:
    from oed_sysid.evidence.compare import Comparison
    from oed_sysid.evidence.improvement import Improvement


def show(study: Study) -> None:
    """Draw the page."""
    st.header("Improve")
    study.training()
    if study.test is None:
        kept = prepared(study.training(), None, enough=sys.maxsize).notes
        st.warning(
            kept[0]
            if kept
            else "There is no validation record, so what is found cannot be tested. Choose one on "
            "the page Problem."
        )
    key = choices.preset(choices.kept("most", study.source, study.variant), 4)
    most = st.columns(2)[0].slider("Most effects to add", 1, 6, key=key)
    line = commands.improve(study, most)
    about = Asked("Improve: what is missing", "improve", line, script.improve(study, most))
    outcome = work("Find what is missing", about, study, tasks.improve, most)
    if outcome is not None:
        found = outcome.result
        pictures = views.of_comparison(outcome.comparison, "improve") | views.of_located(
            found.location, found.base_fit.dataset, found.base_fit, "improve"
        )
        show_page(outcome.page, pictures, lead=2)
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
    """Choose which effects to keep, and judge several such choices side by side."""
    st.subheader("Take a step back")
    groups = _chosen_groups(study, found)
    if not groups:
        st.caption("Without an effect this is the nominal model.")
        return
    st.caption("Side by side: nominal; " + "; ".join(" + ".join(group) for group in groups))
    line = commands.compare(study, groups).replace("compare.html", "kept.html")
    titles = "; ".join(", ".join(group) for group in groups)
    about = Asked(f"Improve: with {titles}", "kept", line, script.compare(study, groups))
    outcome = work("Fit with these", about, study, tasks.compare, groups)
    if outcome is not None:
        st.dataframe(side_by_side(outcome.result), hide_index=True)
        st.caption("Root mean square errors on the validation records, each in its unit.")
        show_page(outcome.page, views.of_comparison(outcome.result, "kept"))
        html_download(outcome.page, "kept")
    command(line)


def _chosen_groups(study: Study, found: Improvement) -> tuple[tuple[str, ...], ...]:
    """Ask for groups of effects, kept one beside the other."""
    known = [effect.name for effect in study.problem.effects]
    added = [step.added for step in found.steps if step.added in known]
    keys = partial(choices.kept, study.source, study.variant)
    state, beside = st.session_state, keys("beside")
    held = [tuple(group) for group in state.get(beside, []) if set(group) <= set(known)]
    left, middle, right = st.columns([4, 1, 1], vertical_alignment="bottom")
    picked = left.multiselect(
        "Effects to keep", known, key=choices.preset(keys("effects"), added), wrap=True
    )
    now = tuple(picked)
    if middle.button("Add", key="add", help="Keep this choice, and put another beside it.",
                     disabled=not now or now in held, width="stretch"):  # fmt: skip
        state[beside] = [list(group) for group in (*held, now)]
        st.rerun()
    if right.button("Undo", key="undo", help="Take the choice that was added last away.",
                    disabled=not held, width="stretch"):  # fmt: skip
        state[beside] = [list(group) for group in held[:-1]]
        st.rerun()
    return (*held, *([now] if now and now not in held else []))


def side_by_side(found: Comparison) -> list[dict[str, str]]:
    """Errors on the validation records, one row per model, angles in degrees."""
    rows = []
    for part in found.models:
        row = {"model": part.label, "error": f"{part.relative:.3g} × noise"}
        rms = part.prediction.rms
        for output in found.dataset.channels.outputs:
            turn, unit = commands.factor(output.unit), commands.shown(output.unit)
            row[f"{output.name} [{unit}]"] = f"{turn * rms[output.name]:.3g}"
        rows.append(row)
    return rows
