"""Page 1: the system, what may be missing in its model, and the records."""

from __future__ import annotations

from collections.abc import Sequence

import streamlit as st

from oed_sysid.app import choices, commands
from oed_sysid.app.panels import command, message, part
from oed_sysid.app.study import content
from oed_sysid.app.trust import NotTrustedError, check_trusted, code_of
from oed_sysid.channels import Input, Output
from oed_sysid.data.dataset import Dataset
from oed_sysid.problem import Problem, list_problems
from oed_sysid.report import Picture, Section, Table, figure_record


def show() -> None:
    """Draw the page."""
    shipped = list_problems()
    source = choices.chosen("source")
    left, right = st.columns([2, 1])
    left.selectbox(
        "Problem",
        [*shipped, *([source] if source and source not in shipped else [])],
        key=choices.kept("source"),
        accept_new_options=True,
        help="A shipped problem, or type the path of your own folder. "
        "`oed-sysid new my_vehicle` makes one. You are asked before its problem.py is run.",
    )
    source = str(choices.chosen("source") or "").strip()
    try:
        check_trusted(source, choices.agreed())
    except NotTrustedError:
        _ask_consent(source)
        return
    problem = choices.problem_of(source, choices.DEFAULT_MODEL)
    variant = choices.DEFAULT_MODEL
    if len(problem.variants) > 1:
        variant = right.selectbox("Model", problem.variants, key=choices.kept("variant", source))
        problem = choices.problem_of(source, variant)
    st.header(problem.title)
    if problem.description:
        st.write(problem.description)
    names = ("Records", "Equations", "Parameters", "May be missing", "Experiments", "Sources")
    records, equations, parameters, missing, experiments, sources = st.tabs(names)
    with records:
        _records(problem, source, variant)
    with equations:
        st.code(problem.model.equations(), language=None, wrap_lines=True)
    with parameters:
        part(Section("", tables=(_parameters(problem),)))
    with missing:
        part(Section("", tables=(_candidates(problem),)))
    with experiments:
        lines = [run.describe() for run in problem.experiments.values()]
        part(Section("", tuple(lines) or ("None.",)))
    with sources:
        part(Section("", problem.references or ("None stated.",)))
    command(commands.describe(choices.study()))


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


def _records(problem: Problem, source: str, variant: str) -> None:
    """Choose records, and which of them to learn from."""
    left, right = st.columns([2, 1], vertical_alignment="bottom")
    options = choices.origins(problem)
    first = choices.first_origin(source, problem)
    key = choices.preset(choices.kept("origin", source, variant), first)
    left.segmented_control("Records", options, key=key, required=True, label_visibility="collapsed")
    origin = str(st.session_state[key])
    right.toggle(
        "Noise levels are known",
        key=choices.kept("known_noise", source),
        help="Trust the noise levels that the problem declares. Otherwise they are estimated, "
        "correlation in time included.",
    )
    if origin == choices.UPLOADED:
        _upload(problem, source)
    stock = choices.stock(source, variant, origin)
    for name, refusal in stock.refused.items():
        message(f"**{name}** was refused. {refusal}")
    for note in stock.notes:
        st.warning(note)
    if stock.records is None:
        return
    try:
        choices.selection(source, variant, origin, stock.names)
    finally:
        left, right = st.columns(2)
        for column, label, side in ((left, "Learn from", "train"), (right, "Judge with", "test")):
            column.multiselect(
                label,
                stock.names,
                key=choices.kept(side, source, variant, origin),
                help="No choice looks at these." if side == "test" else None,
                wrap=True,
            )
    name = st.selectbox("Look at", stock.names, key=f"look:{source}:{origin}")
    if name in stock.names:
        record = stock.records[name]
        if record.missing_outputs:
            st.caption(f"Not measured: {', '.join(record.missing_outputs)}")
        if record.ignored_columns:
            st.caption(f"Columns not used: {', '.join(record.ignored_columns)}")
        one = Dataset((record,))
        part(Section("", pictures=(_picture(content(one), one),)))


def _upload(problem: Problem, source: str) -> None:
    """Take CSV files, and keep them when the page is left."""
    channels = problem.channels
    wanted: Sequence[Input | Output] = (*channels.inputs, *channels.outputs)
    columns = ", ".join(f"{one.column or one.name} [{one.unit or '-'}]" for one in wanted)
    files = st.file_uploader(
        f"Columns: t [s], {columns}. Other units are converted.",
        type="csv",
        accept_multiple_files=True,
        key=f"upload:{source}",
        on_change=_take,
        args=(source,),
    )
    if not files:  # drawn anew: it shows none of the files that were given before
        st.session_state[f"shown:{source}"] = set()
    held = st.session_state.get(f"files:{source}")
    if held and st.button("Forget these files"):
        held.clear()
        st.rerun()


def _take(source: str) -> None:
    """Keep the files that were given, and forget those that were taken back."""
    held: dict[str, bytes] = st.session_state.setdefault(f"files:{source}", {})
    now = {file.name: file.getvalue() for file in st.session_state[f"upload:{source}"]}
    for name in st.session_state.get(f"shown:{source}", set()) - set(now):
        held.pop(name, None)
    held.update(now)
    st.session_state[f"shown:{source}"] = set(now)


def _parameters(problem: Problem) -> Table:
    rows = tuple(
        (
            one.name,
            one.description,
            f"{one.value:.5g}",
            "" if one.prior_std is None else f"± {one.prior_std:.2g}",
            "fixed" if one.fixed else "per record" if one.per_record else "estimated",
            one.unit,
        )
        for one in problem.model.all_parameters
    )
    headers = ("parameter", "meaning", "believed", "", "", "unit")
    return Table(headers, rows, words=(1,))


def _candidates(problem: Problem) -> Table:
    rows = tuple(
        (one.name, one.stage, one.description, one.needs or "", one.source or "")
        for one in problem.effects
    )
    headers = ("effect", "stage", "meaning", "shows in", "source")
    return Table(headers, rows, words=(1, 2, 3, 4))


@st.cache_resource(show_spinner=False, max_entries=30)
def _picture(key: str, _dataset: Dataset) -> Picture:
    return Picture.of(figure_record(_dataset[0]), "")
