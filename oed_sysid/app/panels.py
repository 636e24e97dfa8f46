"""Parts that several pages are made of: work with its progress, results, commands."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from functools import partial
from html import escape
from typing import Any

import streamlit as st

from oed_sysid.app.jobs import Desk, Job, Tell
from oed_sysid.app.tasks import Outcome
from oed_sysid.report import Page, Section, style_sheet

_POLL = 1.0  # s between looks at a running job


@dataclass(frozen=True)
class Asked:
    """Work that was asked for in this session.

    Parameters
    ----------
    title : str
        What it is.
    file : str
        Name of its report, without ending.
    command : str
        The same on the command line.
    """

    title: str
    file: str
    command: str


@st.cache_resource(show_spinner=False)
def desk() -> Desk:
    """The desk at which the work of all pages is done."""
    return Desk()


def asked() -> dict[Hashable, Asked]:
    """What was asked for in this session, by key."""
    return st.session_state.setdefault("asked", {})


def work(button: str, key: Hashable, about: Asked, task: Callable[[Tell], Outcome]) -> Any:
    """Offer work, show its progress, and return its outcome once there is one.

    Parameters
    ----------
    button : str
        What to press.
    key : hashable
        What the outcome depends on, by content.
    about : Asked
        Title, report and command.
    task : callable
        The work.

    Returns
    -------
    Outcome or None
        None before there is one.
    """
    job = desk().find(key)
    if job is not None and job.state == "done":
        asked()[key] = about
        return job.result
    if job is not None and job.at_work:
        asked()[key] = about
        _progress(job)
        return None
    if job is not None and job.state == "failed":
        message(job.failure)
    if job is not None and job.state == "stopped":
        st.info("Stopped.")
    if st.button(button, type="primary", key=f"ask:{about.file}"):
        asked()[key] = about
        desk().ask(key, task)
        st.rerun()
    return None


@st.fragment(run_every=_POLL)
def _progress(job: Job) -> None:
    """What a job is doing; the whole page is drawn anew at its end."""
    if not job.at_work:
        st.rerun()
    who = st.session_state.setdefault("session", secrets.token_hex(8))
    job.look(who)
    left, right = st.columns([5, 1], vertical_alignment="center")
    left.html(f'<div class="oed-busy"><i></i>{escape(job.doing)} · {job.seconds:.0f} s</div>')
    if right.button("Stop", key="stop") and not job.stop(who):
        st.info("Another window waits for the same work; it goes on for that one.")


def show(page: Page) -> None:
    """Show what a report says: outcome and numbers, then one tab per section."""
    st.html(f'<div class="oed">{page.summary_html()}</div>')
    if not page.sections:
        return
    for tab, section in zip(
        st.tabs([section.title for section in page.sections]), page.sections, strict=True
    ):
        # What stands above the tabs need not be said again.
        words = tuple(text for text in section.paragraphs if text not in page.verdict)
        with tab:
            part(replace(section, paragraphs=words))


def part(section: Section) -> None:
    """Show words, tables and pictures of one section."""
    st.html(f'<div class="oed">{section.html()}</div>')


def command(text: str) -> None:
    """Show the command that does the same; files are those of the page Report."""
    with st.expander("The same on the command line"):
        st.code(text, language="bash", wrap_lines=True)


def download(label: str, content: Callable[[], str | bytes], file: str, mime: str) -> None:
    """Offer a file that is made when it is asked for."""
    st.download_button(label, content, file, mime, on_click="ignore", key=f"download:{file}")


def html_download(page: Page, file: str) -> None:
    """Offer a page as the HTML file that the command line writes."""
    download("Report (HTML)", partial(Page.html, page), f"{file}.html", "text/html")


def message(text: str) -> None:
    """Show an error of the package: expected, got, what to do."""
    st.error(text, icon=":material/error:")


def style() -> None:
    """Set the rules of the reports' tables and pictures for this application's parts."""
    st.html(f"<style>.oed {{ {style_sheet().replace(':root', '&')} }} {_STYLE}</style>")


_STYLE = """
.oed { color: #1b1f24; }
.oed .verdict { margin-top: 0; }
.oed th.words, .oed td.words { min-width: 6rem; }
.oed figure { margin-bottom: 1.6rem; }
.oed figure img { max-width: min(100%, 64rem); }
.oed-busy { color: #59636e; }
.oed-busy i { display: inline-block; width: .8em; height: .8em; margin-right: .6em;
  border: 2px solid #d7dce1; border-top-color: #0072b2; border-radius: 50%;
  animation: oed-turn 1s linear infinite; vertical-align: -.05em; }
@keyframes oed-turn { to { transform: rotate(360deg); } }
.stMainBlockContainer { padding: 3rem 2.5rem 4rem; max-width: 76rem; }
.stTabs [role=tab] p { font-size: .875rem; }
"""
