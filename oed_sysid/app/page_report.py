"""Page 6: everything to take home, and the commands that repeat it."""

from __future__ import annotations

import io
import zipfile
from functools import partial

import streamlit as st

from oed_sysid.app.panels import Asked, asked, desk, download, html_download
from oed_sysid.app.plans import commands_csv
from oed_sysid.app.records import archive
from oed_sysid.app.study import Study
from oed_sysid.app.tasks import Outcome
from oed_sysid.design import Design


def show(study: Study) -> None:
    """Draw the page."""
    st.header("Report")
    done = finished(study)
    if not done:
        st.write("Nothing has been computed for these records yet.")
    for about, outcome in done:
        left, right = st.columns([4, 1], vertical_alignment="center")
        left.write(about.title)
        with right:
            html_download(outcome.page, about.file)
    st.divider()
    left, right, _ = st.columns([1, 1, 2])
    with left:
        download(
            "Records (ZIP)", partial(archive, study.train, study.test), "records.zip",
            "application/zip",
        )  # fmt: skip
    with right:
        download("Everything (ZIP)", partial(everything, study, done), "study.zip",
                 "application/zip")  # fmt: skip
    st.subheader("The same on the command line")
    st.caption("In the folder where the records were unpacked.")
    st.code(script(done) or "# nothing yet", language="bash", wrap_lines=True)


def finished(study: Study) -> list[tuple[Asked, Outcome]]:
    """What was computed for a study in this session, one entry per report."""
    found: dict[str, tuple[Asked, Outcome]] = {}
    for key, about in asked().items():
        job = desk().find(key)
        same = isinstance(key, tuple) and key[-len(study.key) :] == study.key
        if same and job is not None and job.state == "done":
            found[about.file] = (about, job.result)
    return list(found.values())


def script(done: list[tuple[Asked, Outcome]]) -> str:
    """Commands that repeat what was computed."""
    return "\n".join(dict.fromkeys(line for a, _ in done for line in a.command.splitlines()))


def everything(study: Study, done: list[tuple[Asked, Outcome]]) -> bytes:
    """Records, reports, commands, and a designed trial in one ZIP file."""
    target = io.BytesIO(archive(study.train, study.test))
    with zipfile.ZipFile(target, "a", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("commands.sh", script(done) + "\n")
        for about, outcome in done:
            packed.writestr(f"{about.file}.html", outcome.page.html())
            if isinstance(outcome.result, Design):
                packed.writestr("design.csv", commands_csv(outcome.result))
                packed.writestr("card.txt", outcome.result.sea_trial_card() + "\n")
    return target.getvalue()
