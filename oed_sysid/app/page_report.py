"""Page 7: everything to take home, and the commands and the script that repeat it."""

from __future__ import annotations

from functools import partial

import streamlit as st

from oed_sysid.app import choices, script, takeaway, visit
from oed_sysid.app.panels import download, html_download, message
from oed_sysid.app.records import archive
from oed_sysid.app.shelf import Asked
from oed_sysid.app.study import Study, digest
from oed_sysid.app.tasks import Outcome
from oed_sysid.errors import OedSysidError
from oed_sysid.likelihood.fit import Fit

# Reports in the order of the work.
_FILES = ("check", "fit", "compare", "diagnose", "improve", "kept", "rank", "design", "programme")
_ORDER = {file: place for place, file in enumerate(_FILES)}


def show(study: Study) -> None:
    """Draw the page."""
    st.header("Report")
    done = finished(study)
    if not done:
        st.write("Nothing has been computed for these records yet.")
    for about, outcome in done:
        left, right = st.columns([5, 1], vertical_alignment="center")
        with left:
            st.markdown(about.title)
            for words in outcome.page.first[:1]:
                st.caption(words)
        with right:
            html_download(outcome.page, about.file, wide=True)
    fits = takeaway.fits_of(done)
    if fits:
        st.subheader("Fitted models")
        _models(fits)
    st.subheader("Records, folder, everything")
    st.caption(
        "The folder is the problem with these records and fits. Everything is the records, "
        "reports, fits, commands and script of this study."
    )
    zip_ = "application/zip"
    name = study.problem.name
    offers = (
        ("Records (ZIP)", partial(archive, study.train, study.test), "records.zip"),
        ("Problem folder (ZIP)", partial(takeaway.problem_archive, study, fits), f"{name}.zip"),
        ("Everything (ZIP)", partial(takeaway.everything, study, done), "study.zip"),
    )
    for column, (label, content, file) in zip(st.columns(3), offers, strict=True):
        with column:
            download(label, content, file, zip_, wide=True)
    st.subheader("The same on the command line")
    st.caption("In the folder where the records were unpacked.")
    st.code(takeaway.commands(done) or "# nothing yet", language="bash", wrap_lines=True)
    st.subheader("The same in Python")
    code = script.whole(study, [about.code for about, _ in done])
    download("Script (study.py)", lambda: code, "study.py", "text/x-python")
    with st.expander("Show it"):
        st.code(code, language="python", wrap_lines=True)


def finished(study: Study) -> list[tuple[Asked, Outcome]]:
    """What was computed for a study, one entry per report."""
    found: dict[str, tuple[Asked, Outcome]] = {}
    this = digest(*study.key)
    for key, about in visit.asked().items():
        job = visit.desk().find(visit.study_id(), key) if about.about == this else None
        if job is not None and job.state == "done":
            found[about.file] = (about, job.result)
    return sorted(found.values(), key=lambda one: _ORDER.get(one[0].file, len(_ORDER)))


def _models(fits: dict[str, tuple[str, Fit]]) -> None:
    """Offer the fits, and their models for other programs."""
    left, middle, right = st.columns([2, 2, 2], vertical_alignment="bottom")
    best = "improved" if "improved" in fits else next(iter(fits))
    key = choices.preset(visit.kept("model"), best)
    name = left.selectbox("Model", list(fits), key=key)
    kind = middle.selectbox(
        "For", list(takeaway.KINDS), format_func=takeaway.KINDS.__getitem__, key=visit.kept("kind")
    )
    if name not in fits or kind not in takeaway.KINDS:
        return
    file, fit = fits[name]
    made: dict[tuple[str, str, str], bytes] = st.session_state.setdefault("exports", {})
    here = (name, kind, repr(fit.cost))
    trim = _trim(fit) if kind == "control" else {}
    with right:
        if st.button("Write the model", key="export", type="primary"):
            made.pop(here, None)
            try:
                with st.spinner("Writing"):
                    made[here] = takeaway.model_archive(fit, kind, trim)
            except OedSysidError as error:
                message(str(error))
    left, right, _ = st.columns([1, 1, 1])
    with left:
        download(
            f"Fit ({file}.json)", partial(takeaway.saved, fit), f"{file}.json", "application/json"
        )
    if here in made:
        with right:
            content = made[here]
            download(
                f"Model ({kind}, ZIP)", lambda: content, f"{file}_{kind}.zip", "application/zip"
            )


def _trim(fit: Fit) -> dict[str, float]:
    """Ask at which inputs the model is made linear."""
    found = {}
    inputs = fit.model.inputs
    for column, channel in zip(st.columns(max(len(inputs), 3)), inputs, strict=False):
        found[channel.name] = column.number_input(
            f"Trim: {channel.name} [{channel.unit or '-'}]", value=0.0, format="%.4g",
            key=visit.kept("trim", fit.model.name, channel.name),
        )  # fmt: skip
    return found
