"""Parts that several pages are made of: work with its progress, results, commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from html import escape
from typing import Any

import streamlit as st

from oed_sysid.app import visit
from oed_sysid.app.jobs import Job
from oed_sysid.app.shelf import Asked
from oed_sysid.app.study import Study, digest
from oed_sysid.app.work import Request
from oed_sysid.results import style_sheet
from oed_sysid.runtime.display import Report, Section

_POLL = 0.5  # s between looks at a running job


def key_of(name: str, study: Study, *arguments: Any) -> str:
    """What the result of a task depends on, by content."""
    return f"{name} {digest(repr(arguments), *study.key)}"


def work(
    button: str,
    about: Asked,
    study: Study,
    task: Callable[..., Any],
    *arguments: Any,
    unasked: bool = False,
) -> Any:
    """Offer work, show its progress, and return its outcome once there is one.

    Parameters
    ----------
    button : str
        What to press.
    about : Asked
        Title, report, command and code.
    study : Study
        What it is done to.
    task : callable
        Function of a module, ``(study, *arguments, tell)``.
    *arguments
        For the task.
    unasked : bool
        Whether to begin without a press: for what is quick and always wanted.

    Returns
    -------
    Outcome or None
        None before there is one.
    """
    name, desk = visit.study_id(), visit.desk()
    key = key_of(task.__name__, study, *arguments)
    about = replace(about, about=digest(*study.key))
    job = desk.find(name, key)
    if job is None and unasked:
        job = desk.ask(name, key, Request.of(study, task, *arguments))
    if job is not None and (job.at_work or key in visit.asked() or unasked):
        visit.note(key, about)
    if job is not None and job.state == "done" and key in visit.asked():
        return job.result
    if job is not None and job.at_work:
        _progress(job)
        return None
    _say_ended(job)
    if st.button(button, type="primary", key=f"ask:{about.file}"):
        visit.note(key, about)
        desk.ask(name, key, Request.of(study, task, *arguments))
        st.rerun()
    if job is None and key in visit.asked():
        st.caption("This was asked for, but the program ended before it was done.")
    return None


def _say_ended(job: Job | None) -> None:
    """Say how work ended that has no result."""
    if job is not None and job.state == "failed":
        message(job.failure)
    if job is not None and job.state == "stopped":
        st.info("Stopped. Press again to begin anew.")


@st.fragment(run_every=_POLL)
def _progress(job: Job) -> None:
    """What a job is doing; the whole page is drawn anew at its end."""
    if not job.at_work:
        st.rerun()
    left, right = st.columns([5, 1], vertical_alignment="center")
    left.html(
        f'<div class="oed-busy" role="status"><i></i>{escape(job.doing)} · '
        f"{job.seconds:.0f} s</div>"
    )
    if right.button("Stop", key="stop"):
        job.stop()
        st.rerun()


def show(
    page: Report, pictures: Mapping[str, Callable[[], None]] | None = None, *, lead: int = 0
) -> None:
    """Show what a report says: outcome and numbers, then one tab per section.

    Parameters
    ----------
    page : Report
        The report.
    pictures : mapping of str to callable, optional
        Titles of further tabs, and what draws them.
    lead : int
        How many sections stand before these.
    """
    st.html(f'<div class="oed">{page.summary_html()}</div>')
    parts: list[tuple[str, Callable[[], None]]] = [
        (section.title, partial(_beneath, page, section)) for section in page.sections
    ]
    parts[lead:lead] = (pictures or {}).items()
    if not parts:
        return
    for tab, (_, draw) in zip(st.tabs([title for title, _ in parts]), parts, strict=True):
        with tab:
            draw()


def _beneath(page: Report, section: Section) -> None:
    """Show a section; what stands above the tabs need not be said again."""
    words = tuple(text for text in section.paragraphs if text not in page.first)
    part(replace(section, paragraphs=words))


def part(section: Section) -> None:
    """Show words, tables and pictures of one section."""
    st.html(f'<div class="oed">{section.html()}</div>')


def command(text: str) -> None:
    """Show the command that does the same; files are those of the page Report."""
    with st.expander("The same on the command line"):
        st.code(text, language="bash", wrap_lines=True)


def download(
    label: str, content: Callable[[], str | bytes], file: str, mime: str, *, wide: bool = False
) -> None:
    """Offer a file that is made when it is asked for."""
    st.download_button(
        label, content, file, mime, on_click="ignore", key=f"download:{file}",
        width="stretch" if wide else "content",
    )  # fmt: skip


def html_download(page: Report, file: str, *, wide: bool = False) -> None:
    """Offer a page as the HTML file that the command line writes."""
    download("Report (HTML)", page.html, f"{file}.html", "text/html", wide=wide)


def message(text: str) -> None:
    """Show an error of the package: expected, got, what to do."""
    st.error(text, icon=":material/error:")


def style() -> None:
    """Set the rules of the reports' tables and pictures for this application's parts."""
    st.html(f"<style>.oed {{ {style_sheet().replace(':root', '&')} }} {_STYLE}</style>")


_STYLE = """
.oed { --ink: currentColor; --soft: color-mix(in srgb, currentColor 68%, transparent);
  --line: color-mix(in srgb, currentColor 20%, transparent);
  --tint: color-mix(in srgb, currentColor 5%, transparent); color: inherit; }
.oed tr.marked td { background: rgba(0, 114, 178, .16); }
.oed figure img { background: white; border-radius: 6px; }
.oed .verdict { margin-top: 0; }
.oed .verdict p.danger { color: color-mix(in srgb, #e0002a 62%, currentColor); }
.oed th.words, .oed td.words { min-width: 6rem; }
.oed figure { margin-bottom: 1.6rem; }
.oed figure img { max-width: min(100%, 64rem); }
.oed-busy { opacity: .8; }
.oed-busy i { display: inline-block; width: .8em; height: .8em; margin-right: .6em;
  border: 2px solid #d7dce1; border-top-color: #0072b2; border-radius: 50%;
  animation: oed-turn 1s linear infinite; vertical-align: -.05em; }
@keyframes oed-turn { to { transform: rotate(360deg); } }
.oed-chain { display: flex; align-items: stretch; gap: .4rem; margin: .4rem 0; }
.oed-chain > b { align-self: center; opacity: .6; }
.oed-chain .stage { border: 1px solid rgba(128, 136, 144, .45); border-radius: 8px;
  padding: .5rem .5rem .6rem; display: flex; flex-direction: column; gap: .35rem;
  flex: 1 1 0; min-width: 0; }
.oed-chain h4 { margin: 0 0 .1rem; padding: 0; font-size: .82rem;
  font-weight: 500; opacity: .75; }
.oed-chain .place { border: 1px solid rgba(128, 136, 144, .45); border-radius: 5px;
  padding: .1rem .4rem; font-size: .9rem; display: flex; flex-wrap: wrap;
  justify-content: space-between; align-items: baseline; column-gap: .4em;
  overflow-wrap: anywhere; }
.oed-chain small { opacity: .75; font-variant-numeric: tabular-nums; }
.oed-chain .l1 { background: rgba(230, 159, 0, .18); }
.oed-chain .l2 { background: rgba(230, 159, 0, .42); }
.oed-chain .l3 { background: rgba(213, 94, 0, .55); }
.oed-chain .l4 { background: #c45500; color: white; border-color: #c45500; }
.oed-chain .best { outline: 2px solid #c45500; outline-offset: 2px; }
/* A bar over the page while a click is being answered, drawn by the browser itself: it comes after
   0.15 s however busy the server is, and so not for the looks at a running job. */
.stApp:is([data-test-script-state=running], [data-test-script-state=rerunRequested])::before {
  content: ""; position: fixed; top: 0; left: 0; width: 30%; height: 3px; z-index: 1000000;
  background: #2b87c4; opacity: 0; animation: oed-run 1.2s linear .15s infinite; }
@keyframes oed-run { from { opacity: 1; transform: translateX(-100%); }
  to { opacity: 1; transform: translateX(340%); } }
@media (max-width: 60rem) { .oed-chain { flex-wrap: wrap; }
  .oed-chain .stage { flex: 1 0 8rem; } .oed-chain > b { display: none; } }
.stMainBlockContainer { padding: 3rem 2.5rem 4rem; max-width: 76rem; }
.stTabs [role=tab] p { font-size: .875rem; }
.stTabs [role=tablist] { flex-wrap: wrap; overflow: visible; height: auto; row-gap: .4rem; }
"""
