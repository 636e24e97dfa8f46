"""Page 1: the system, what may be missing in its model, and the records."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import streamlit as st

from oed_sysid.app import choices, mapping, visit
from oed_sysid.app.charts import look_at
from oed_sysid.app.mapping import NothingMappedError, headers, plain_name
from oed_sysid.app.panels import message, part, tabs
from oed_sysid.app.trust import NotTrustedError, code_of
from oed_sysid.cli.study import DEFAULT_MODEL
from oed_sysid.data.frames import is_time
from oed_sysid.errors import OedSysidError, ProblemError
from oed_sysid.experiments.problem import Problem, list_problems, load_problem, new_problem
from oed_sysid.experiments.starter import TEMPLATES
from oed_sysid.results.page import parameter_table
from oed_sysid.runtime.display import Section, Table
from oed_sysid.text.units import parse_header, shown_unit


def show() -> None:
    """Draw the page."""
    shipped = list_problems()
    source = visit.chosen("source")
    left, right = st.columns([2, 1])
    left.selectbox(
        "Problem", [*shipped, *([source] if source and source not in shipped else [])],
        key=visit.kept("source"), accept_new_options=True,
        help="A shipped problem, or type the path of your own folder. "
        "`oed-sysid new my_vehicle` makes one. You are asked before its problem.py is run.",
    )  # fmt: skip
    first, second, _ = st.columns([1, 1, 2])
    wide: dict[str, Any] = {"width": "stretch", "on_change": "rerun"}
    with first.popover("New vehicle", icon=":material/add:", key=_NEW, **wide):
        _new_vehicle()
    with second.popover("Measured data", icon=":material/database:", key=_OPEN, **wide):
        _measured()
    source = str(visit.chosen("source") or "").strip()
    try:
        problem = choices.problem_of(source, DEFAULT_MODEL)
    except NotTrustedError:
        _ask_consent(source)
        return
    variant = DEFAULT_MODEL
    if len(problem.variants) > 1:
        variant = right.selectbox("Model", problem.variants, key=visit.kept("variant", source))
        problem = choices.problem_of(source, variant)
    _describe(problem, source, variant)


def _describe(problem: Problem, source: str, variant: str) -> None:
    """Show what a problem holds, and ask for its records."""
    st.header(problem.title)
    if problem.description:
        st.write(problem.description)
    lines = tuple(run.describe() for run in problem.experiments.values())
    units = ("Amplitudes without a unit are in SI units; angles then in radians.",) if lines else ()
    parts: dict[str, Callable[[], object]] = {
        "Records": partial(_records, problem, source, variant),
        "Equations": partial(st.code, problem.model.equations(), language=None, wrap_lines=True),
        "Parameters": partial(part, Section("", tables=(parameter_table(problem.model),))),
        "May be missing": partial(part, Section("", tables=(_candidates(problem),))),
        "Experiments": partial(part, Section("", (*lines, *units) or ("None.",))),
        "Sources": partial(part, Section("", problem.references or ("None stated.",))),
    }
    tabs(list(parts.items()))
    with st.expander("The same on the command line"):
        model = "" if variant == DEFAULT_MODEL else f" --model {variant}"
        st.code(f"oed-sysid problems {shlex.quote(source)}{model}", language="bash")


def _measured() -> None:
    """Lead to the measured records that are at hand."""
    names = choices.measured()
    if not names:
        st.caption(
            "None is on this computer yet. Choose a problem and its records *With the problem*: "
            "they are downloaded once."
        )
    for name in names:
        st.button(
            name.replace("_", " "), key=f"measured:{name}", width="stretch",
            on_click=_open_measured, args=(name,),
        )  # fmt: skip


def _open_measured(name: str) -> None:
    """Choose a shipped problem and its measured records, and close the list of them."""
    st.session_state[visit.kept("source")] = name
    st.session_state[visit.kept("origin", name, DEFAULT_MODEL)] = choices.WITH_PROBLEM
    st.session_state[_OPEN] = False


_FROM_LOG = "from a log"
# Keys of what pops up; true while it is open.
_NEW, _OPEN = "new vehicle", "measured data"


def _new_vehicle() -> None:
    """Make the folder of a problem: from a template, or around a log."""
    st.text_input("Folder to make", key="new:folder", placeholder="~/vehicles/my_ship")
    if st.selectbox("Begin with", [*TEMPLATES, _FROM_LOG], key="new:kind") == _FROM_LOG:
        words = "Log of any format; what its columns are is told by their numbers"
        file = st.file_uploader(words, type=list(mapping.ENDINGS), key="new:log")
        if file is not None and mapping.is_table(file.name):
            columns = (h for h in headers({file.name: file.getvalue()}) if not is_time(h))
            names = [parse_header(column)[0] for column in columns]
            st.multiselect(
                "Commands", names, key="new:commands",
                help="Columns that are commands; empty lets their names decide.",
            )  # fmt: skip
    st.button("Make it", key="new:make", type="primary", on_click=_make)
    if refusal := st.session_state.get("new:refusal"):
        message(refusal)


def _make() -> None:
    """Make the folder that was asked for, and open it."""
    state = st.session_state
    state.pop("new:refusal", None)
    folder = Path(str(state.get("new:folder") or "").strip()).expanduser()
    log = state.get("new:log") if state.get("new:kind") == _FROM_LOG else None
    try:
        if not folder.name:
            raise ProblemError("Name the folder to make, such as ~/vehicles/my_ship.")
        if state.get("new:kind") != _FROM_LOG:
            made = new_problem(folder, template=str(state["new:kind"]))
        elif log is None:
            raise ProblemError("Give the log that the problem is made of.")
        else:
            with tempfile.TemporaryDirectory() as place:
                file = Path(place) / plain_name(log.name)
                file.write_bytes(log.getvalue())
                inputs = list(state.get("new:commands") or [])
                made = new_problem(folder, log=file, inputs=inputs)
        load_problem(made)
    except OedSysidError as error:
        state["new:refusal"] = str(error)
        return
    choices.agree(str(made))  # it was written by this package, a moment ago
    state[visit.kept("source")] = str(made)
    state[_NEW] = False


def _ask_consent(source: str) -> None:
    """Show the programs of a folder, and run them only when the user says so."""
    code = code_of(source)
    st.warning(
        f"**{source}** is not a problem of this package. To open it, its program `problem.py` is "
        "run with your rights: it could read, change and send your files. Open it only if you "
        "know where it comes from.",
        icon=":material/warning:",
    )
    for path, text in code.items():
        with st.expander(f"{path.name} ({len(text.splitlines())} lines)"):
            st.code(text[:100_000], language="python")
    if st.button("Run it and open the problem", key="agree"):
        choices.agree(source)
        st.rerun()


_SIDES = (
    ("train", "Training records", "Models are fitted to these, and effects are sought in them."),
    ("test", "Validation records", "Nothing is fitted to these, and no choice looks at them."),
)


def _records(problem: Problem, source: str, variant: str) -> None:
    """Choose records, and which of them are for training and which for validation."""
    left, right = st.columns([2, 1], vertical_alignment="bottom")
    options = choices.origins(problem)
    key = visit.preset(visit.kept("origin", source, variant), choices.first_origin(source, problem))
    left.segmented_control("Records", options, key=key, required=True, label_visibility="collapsed")
    origin = str(st.session_state[key])
    says = (
        "Trust the noise levels that the problem declares. Otherwise they are estimated, "
        "correlation in time included."
    )
    right.toggle("Noise levels are known", key=visit.kept("known_noise", source), help=says)
    _ask_files(origin, problem, source)
    try:
        stock = choices.stock(source, variant, origin)
    except NothingMappedError as error:
        st.info(str(error))
        return
    said = mapping.opened_logs(source).refused if origin == choices.MAPPED else {}
    for name in sorted(stock.refused.keys() - said.keys()):
        message(f"**{name}** was refused. {stock.refused[name]}")
    if stock.refused and origin == choices.UPLOADED:
        st.caption(f"*{choices.MAPPED}* takes files with other names of columns, units and signs.")
    if stock.notes:
        st.info("  \n".join(stock.notes))
    if stock.records is not None:
        _share_out(stock, source, variant, origin)
        look_at(stock.records, f"{source}:{origin}")


def _share_out(stock: mapping.Stock, source: str, variant: str, origin: str) -> None:
    """Ask which records are for training and which for validation."""
    try:
        choices.selection(source, variant, origin, stock.names)
    finally:
        for column, (side, label, says) in zip(st.columns(2), _SIDES, strict=True):
            key = visit.kept(side, source, variant, origin)
            column.multiselect(label, stock.names, key=key, help=says, wrap=True)


def _ask_files(origin: str, problem: Problem, source: str) -> None:
    """Ask for the user's own records, as CSV files or as logs."""
    if origin == choices.UPLOADED:
        columns = ", ".join(
            f"{one.column or one.name} [{shown_unit(one.unit)[1] or '-'}]"
            for one in problem.channels.all
        )
        words = f"Columns: t [s], {columns}. Other units in the header are converted."
        mapping.take_files(words, source, ("csv",))
    elif origin == choices.MAPPED:
        mapping.show(problem, source)


def _candidates(problem: Problem) -> Table:
    rows = tuple(
        (one.name, one.stage, one.description, one.needs or "", one.source or "")
        for one in problem.effects
    )
    return Table(("effect", "stage", "meaning", "shows in", "source"), rows, words=(1, 2, 3, 4))
