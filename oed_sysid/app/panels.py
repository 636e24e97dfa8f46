"""Parts that several pages are made of: options, work with its progress, results, commands."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from mimetypes import guess_type
from pathlib import Path
from typing import Any

import streamlit as st

from oed_sysid.app import visit
from oed_sysid.app.charts import chart, drawn, tabs_of
from oed_sysid.app.jobs import Job, Request
from oed_sysid.app.visit import Asked
from oed_sysid.cli.options import line_of, row_of
from oed_sysid.cli.script import part_of
from oed_sysid.cli.study import Outcome, Study, digest, options_of
from oed_sysid.cli.tasks import TASKS
from oed_sysid.results import style_sheet
from oed_sysid.runtime.display import Report, Section

Pictures = Mapping[str, Callable[[], None]]
# Files of the fits that commands keep.
FITTED, IMPROVED = "fit.json", "improved.json"
# Tabs of a report that are not folded away.
_SHOWN = 4
# Whether the page that is gone to begins its work at once.
BEGIN = "begin"


# -- options -----------------------------------------------------------------------------


def ask(
    task: str,
    study: Study,
    name: str,
    choices: Sequence[Any] | None = None,
    *,
    place: Any = st,
    first: Any = None,
    **settings: Any,
) -> Any:
    """Ask for an option of a task, by its row in the table of options.

    Parameters
    ----------
    task, name : str
        Which option of which task.
    study : Study
        What it is asked about; each problem keeps its own answers.
    choices : sequence, optional
        What there is to choose from; by default what the row names.
    place : container
        Where to ask.
    first : object, optional
        The first answer, where that is not the option's default.
    **settings
        Of the widget.
    """
    row = row_of(task, name)
    option = {one.name: one for one in options_of(TASKS[task].run)}[name]
    kind = str(option.kind)
    words = row.label or row.help.partition(".")[0]
    offered = list(row.choices if choices is None else choices)
    key = visit.kept(study.source, study.variant, task, name)
    settings = {"key": key, "help": row.help, "placeholder": "as usual", **settings}
    begin = option.default if first is None else first
    if kind.startswith("tuple"):
        visit.preset(key, list(begin))
        return tuple(place.multiselect(words, offered, **settings))
    if choices and begin not in offered:
        begin = offered[0]
    visit.preset(key, begin)
    if offered:
        return place.selectbox(
            words, offered, index=None if begin is None else 0,
            format_func=lambda one: row.words.get(str(one), str(one)), **settings,
        )  # fmt: skip
    number, form = (int, "%d") if "int" in kind else (float, "%.4g")
    least = None if row.least is None else number(row.least)
    return place.number_input(words, min_value=least, format=form, **settings)


# -- work --------------------------------------------------------------------------------


def result_of(
    study: Study,
    task: str,
    options: Mapping[str, Any],
    button: str,
    *,
    title: str = "",
    file: str = "",
    glance: bool = False,
    unasked: bool = False,
) -> Outcome | None:
    """Offer a task; show its progress, its result, the page to take home and its command.

    Parameters
    ----------
    study : Study
        What it is done to.
    task : str
        Which task.
    options : mapping
        Its options.
    button : str
        What to press.
    title, file : str
        On the page Report, and the name of the report; by default the task's.
    glance : bool
        Whether the first section says it all, so that the others are folded away.
    unasked : bool
        Whether to begin without a press: for what is quick and always wanted.

    Returns
    -------
    Outcome or None
        None before there is one.
    """
    row = TASKS[task]
    file = file or task
    line = line_of(row, study, options, file)
    if getattr(options.get("after"), "name", "") == FITTED:
        line = f"{line_of(TASKS['fit'], study, {})}\n{line}"
    about = Asked(title or row.title, file, line, part_of(row, study, options), digest(*study.key))
    outcome = _work(button, about, Request.of(study, row, options), study, unasked=unasked)
    if outcome is not None and outcome.page is not None:
        show(outcome.page, tabs_of(outcome, study.train, file), glance=glance)
        download("Report (HTML)", outcome.page.html, f"{file}.html")
    with st.expander("The same on the command line"):
        st.code(line, language="bash", wrap_lines=True)
    return outcome


def _work(
    button: str, about: Asked, request: Request, study: Study, *, unasked: bool
) -> Outcome | None:
    """Offer work, show its progress, and return its outcome once there is one."""
    name, desk = visit.study_id(), visit.desk()
    known = (f"{file} {fit.model.content} {fit.values}" for file, fit in study.saved.items())
    content = digest(repr(request.options), *study.key, *known)
    key = f"{getattr(request.task, 'name', '')} {content}"
    job = desk.find(name, key) or (desk.ask(name, key, request) if unasked else None)
    asked = visit.asked()
    if unasked:
        asked[key] = about
    if job is not None and job.at_work:
        asked[key] = about
        _progress(job)
        return None
    if job is not None and job.state == "done" and key in asked:
        asked[key] = about
        return job.result
    _say_ended(job, asked=key in asked)
    advised = st.session_state.pop(BEGIN, False)
    if st.button(button, type="primary", key=f"ask:{about.file}") or advised:
        asked[key] = about
        desk.ask(name, key, request)
        st.rerun()
    return None


def _say_ended(job: Job | None, *, asked: bool) -> None:
    """Say how work ended that has no result."""
    if job is None and asked:
        st.caption("This was asked for, but the program ended before it was done.")
    elif job is not None and job.state == "failed":
        message(job.failure)
    elif job is not None and job.state == "stopped":
        st.info("Stopped. Press again to begin anew.")


@st.fragment(run_every=0.5)  # s between looks at a running job
def _progress(job: Job) -> None:
    """What a job is doing; the whole page is drawn anew at its end."""
    if not job.at_work:
        st.rerun()
    left, right = st.columns([5, 1], vertical_alignment="center")
    # Without a share the bar wanders.
    bar = share = remaining = ""
    if job.share is not None and job.end_expected is not None:
        bar = f' style="width: {100 * job.share:.0f}%"'
        share = f"{100 * job.share:.0f} % · "
        remaining = f", about {max(job.end_expected - job.began - job.seconds, 0.0):.0f} s left"
    left.html(
        f'<div class="oed-busy" role="status">{escape(job.doing)} · {share}{job.seconds:.0f} s'
        f'{remaining}<div class="bar"><i{bar}></i></div></div>'
    )
    if right.button("Stop", key="stop"):
        job.stop(wait=False)  # the page says so at once
        st.rerun()


# -- results -----------------------------------------------------------------------------


def show(page: Report, pictures: Pictures, *, glance: bool = False) -> None:
    """Show what a report says: outcome and numbers, then one tab per section.

    Parameters
    ----------
    page : Report
        The report.
    pictures : mapping of str to callable
        Titles of further tabs, and what draws them.
    glance : bool
        Whether the first section says it all: it is drawn at once, the others when asked for.
    """
    # What stands at a glance has the numbers beside their pictures.
    summary = replace(page, numbers=()) if glance else page
    st.html(f'<div class="oed">{summary.summary_html()}</div>')
    parts: list[tuple[str, Callable[[], None]]] = []
    for section in page.sections:  # what stands above the tabs need not be said again
        words = tuple(text for text in section.paragraphs if text not in page.first)
        parts.append((section.title, partial(part, replace(section, paragraphs=words))))
    if glance:
        parts.pop(0)[1]()
    parts = [*pictures.items(), *parts]
    if not glance:
        st.caption(page.subtitle)
        tabs(parts[:_SHOWN])
        del parts[:_SHOWN]
    if parts:
        with st.expander(_more([title.partition(":")[0].lower() for title, _ in parts])):
            tabs(parts)


def _more(titles: list[str]) -> str:
    """What an expander says of the tabs in it."""
    if len(titles) <= _SHOWN + 1:
        return f"More: {', '.join(titles)}"
    return f"More: {', '.join(titles[:_SHOWN])} and {len(titles) - _SHOWN} more"


def tabs(parts: Sequence[tuple[str, Callable[[], object]]]) -> None:
    """Draw parts in tabs, by their titles."""
    made = st.tabs([title for title, _ in parts]) if parts else ()
    for tab, (_, draw) in zip(made, parts, strict=True):
        with tab:
            draw()


def part(section: Section) -> None:
    """Show words, tables and pictures of one section; pictures to point into where they can be."""
    live = [one for one in section.figures if getattr(one, "chart", None) is not None]
    still = [one for one in section.figures if one not in live]
    columns = st.columns(len(live) if section.beside else 1) * len(live) if live else []
    for column, picture in zip(columns, live, strict=False):
        with column:
            chart(drawn(picture.chart), f"{section.title}:{picture.finding}:{len(section.figures)}")
            st.caption(picture.caption)
    st.html(f'<div class="oed">{replace(section, figures=still).html()}</div>')


def download(
    label: str, content: Callable[[], str | bytes], file: str, *, wide: bool = False
) -> None:
    """Offer a file that is made when it is asked for."""
    st.download_button(
        label, content, file, guess_type(file)[0] or "text/plain", on_click="ignore",
        key=f"download:{file}", width="stretch" if wide else "content",
    )  # fmt: skip


def zipped(write: Callable[[Path], object], under: str = "") -> bytes:
    """Return what a function writes into a folder as a ZIP file."""
    target = io.BytesIO()
    with (
        tempfile.TemporaryDirectory() as place,
        zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as packed,
    ):
        write(Path(place))
        for file in sorted(Path(place).rglob("*")):
            if file.is_file():
                packed.write(file, f"{under}{file.relative_to(place).as_posix()}")
    return target.getvalue()


def written(name: str, write: Callable[[Path], object]) -> bytes:
    """Return what a function writes into a file."""
    with tempfile.TemporaryDirectory() as place:
        write(Path(place) / name)
        return (Path(place) / name).read_bytes()


def message(text: str) -> None:
    """Show an error of the package: expected, got, what to do."""
    st.error(text, icon=":material/error:")


def style() -> None:
    """Set the rules of the reports' tables and pictures for this application's parts."""
    own = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
    st.html(f"<style>.oed {{ {style_sheet().replace(':root', '&')} }} {own}</style>")
