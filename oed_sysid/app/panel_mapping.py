"""The part of the page Problem that asks which column is which channel."""

from __future__ import annotations

import json
from functools import partial

import streamlit as st

from oed_sysid.app import choices, mapping, visit
from oed_sysid.app.answers import (
    AROUND,
    BY_COMMANDS,
    BY_TIME,
    NOT_LOGGED,
    SPAN,
    WHOLE,
    answer,
    asked,
    departure_unit,
    place,
    time_column,
)
from oed_sysid.app.commands import factor, shown
from oed_sysid.app.panels import download, message
from oed_sysid.data.logs import Log
from oed_sysid.data.mapping import parse
from oed_sysid.errors import OedSysidError
from oed_sysid.experiments.problem import Problem
from oed_sysid.physics.channels import Input
from oed_sysid.text.units import to_si


def show(problem: Problem, source: str) -> None:
    """Take logs, and ask which of their fields are the channels of the problem."""
    key = choices.log_key(source)
    left, right = st.columns([3, 2])
    with left:
        choices.take_files(
            "Logs of one layout: " + ", ".join(f".{ending}" for ending in mapping.ENDINGS),
            key,
            mapping.ENDINGS,
        )
    with right:
        _take_mapping(source)
    files = choices.held(key)
    if not files:
        return
    opened = choices.opened_logs(source)
    if not opened.logs or time_column(source) is not None:
        _ask_time(source, files)
        opened = choices.opened_logs(source)
    if not opened.logs and any(map(mapping.is_table, files)) and time_column(source) is None:
        st.info("Choose the column that holds the times.")
        return
    for name, refusal in opened.refused.items():
        message(f"**{name}** was refused. {refusal}")
    if not opened.logs:
        return
    log = next(iter(opened.logs.values()))
    _begin(source, problem, log)
    with st.expander(f"What {log.path.name} holds: {len(log.names)} fields"):
        heads = ("field", "samples", "rate", "from – to", "unit", "range")
        st.dataframe([dict(zip(heads, row, strict=True)) for row in log.rows()], hide_index=True)
    _ask_channels(source, problem, log)
    _ask_cuts(source, problem, log)
    try:
        text = asked(source, problem).text()
    except OedSysidError:
        return  # said with the records
    download(
        "Mapping file",
        lambda: f"problem = {json.dumps(source)}\n{text}",
        "mapping.toml",
        "text/plain",
    )


def _begin(source: str, problem: Problem, log: Log) -> None:
    """Fill in what names and units say, once per log; keep what was answered where it still is."""
    state, mark = st.session_state, choices.kept("map", source, "for")
    fields = list(log.names)
    tails = {name.partition(".")[2]: name for name in reversed(fields)}
    new = state.get(mark) != fields
    guesses = mapping.first_guess(log, problem.channels) if new else {}
    for channel in problem.channels.all:
        key = place(source, channel.name, "field")
        held = state.get(key)
        if held is not None and held != NOT_LOGGED and held not in fields:
            held = state[key] = tails.get(str(held).partition(".")[2], NOT_LOGGED)
        if held in (None, NOT_LOGGED) and channel.name in guesses:
            one = guesses[channel.name]
            state[key] = one.field
            state[place(source, channel.name, "unit")] = one.unit or ""
            state[place(source, channel.name, "wrap")] = one.wrap
        elif held is None:
            state[key] = NOT_LOGGED
    state[mark] = fields


def _ask_channels(source: str, problem: Problem, log: Log) -> None:
    """One row per channel."""
    widths = [2.2, 3.0, 1.2, 0.9, 1.1, 1.1]
    heads = ("Channel", "Column", "Its unit", "Reversed", "Jumps by 360°", "")
    for column, head in zip(st.columns(widths), heads, strict=True):
        column.caption(head)
    for channel in problem.channels.all:
        key = partial(place, source, channel.name)
        row = st.columns(widths, vertical_alignment="center")
        kind = "command" if isinstance(channel, Input) else "measured"
        words = channel.label or channel.name
        row[0].markdown(f"{words} `{channel.name}` [{shown(channel.unit)}], {kind}")
        row[1].selectbox(
            f"Column of {channel.name}", [NOT_LOGGED, *log.names], key=key("field"),
            label_visibility="collapsed", on_change=_unit_of, args=(source, channel.name),
        )  # fmt: skip
        if st.session_state.get(key("field")) == NOT_LOGGED:
            if isinstance(channel, Input):
                row[2].number_input(
                    f"Value of {channel.name}", key=choices.preset(key("constant"), 0.0),
                    format="%.4g", help=f"It did not change: its value, in {shown(channel.unit)}",
                    label_visibility="collapsed",
                )  # fmt: skip
                row[3].caption(f"{shown(channel.unit)}, constant")
            continue
        row[2].text_input(
            f"Unit of {channel.name}", key=choices.preset(key("unit"), ""),
            placeholder="as logged", label_visibility="collapsed",
        )  # fmt: skip
        row[3].checkbox(
            f"Flip {channel.name}", key=choices.preset(key("flip"), False),
            label_visibility="collapsed", help="Its axis points reversed.",
        )  # fmt: skip
        if channel.unit == "rad":
            row[4].checkbox(
                f"Unwrap {channel.name}", key=choices.preset(key("wrap"), False),
                label_visibility="collapsed",
                help="The log holds the angle within one turn: 0° to 360°, or ±180°.",
            )  # fmt: skip
        with row[5].popover("More", width="stretch"):
            st.caption("Channel = factor × (reading − trim)")
            st.number_input("Factor", key=choices.preset(key("factor"), 1.0), format="%.6g")
            logged = st.session_state.get(key("unit")) or "as logged"
            words = f"Trim: reading at zero [{logged}]"
            st.number_input(words, key=choices.preset(key("trim"), 0.0), format="%.6g")
            st.number_input("Late by [s]", key=choices.preset(key("delay"), 0.0), format="%.4g")


def _unit_of(source: str, channel: str) -> None:
    """Write the unit that a newly chosen column states."""
    field = answer(source, channel, "field")
    logs = choices.opened_logs(source).logs.values()
    log = next(iter(logs), None)
    if log is not None and field in log.names:
        st.session_state[place(source, channel, "unit")] = mapping.unit_of(log, str(field))


def _ask_cuts(source: str, problem: Problem, log: Log) -> None:
    """Ask where manoeuvres begin and end."""
    first, last = log.span
    keys = partial(choices.kept, "map", source)
    columns = st.columns([2.2, 1, 1, 1], vertical_alignment="bottom")
    how = columns[0].selectbox("Records", (WHOLE, BY_TIME, BY_COMMANDS), key=keys("cuts"))
    if how == BY_TIME:
        for column, name, value in zip(columns[1:], SPAN, (first, last), strict=False):
            column.number_input(
                f"{name} [s]", key=choices.preset(keys(name), round(value, 3)), format="%.4g"
            )
    elif how == BY_COMMANDS:
        unit = departure_unit(problem)
        words = (f"Departure [{shown(unit) if unit else 'SI'}]", "Before [s]", "After [s]")
        values = (3.0 if unit == "rad" else 0.05, 5.0, 10.0)
        for column, name, label, value in zip(columns[1:], AROUND, words, values, strict=True):
            column.number_input(label, 0.0, key=choices.preset(keys(name), value), format="%.4g")


def _ask_time(source: str, files: dict[str, bytes]) -> None:
    """Ask which column is the time, where none is called so."""
    name = next((one for one in files if mapping.is_table(one)), None)
    if name is None:
        return
    found = mapping.headers(files[name])
    left, right, _ = st.columns([2, 1, 1])
    left.selectbox("Column of time", found, index=None, key=choices.kept("map", source, "time"),
                   placeholder="No column is called t or time: choose one")  # fmt: skip
    right.selectbox("Its unit", mapping.TIME_UNITS, key=choices.kept("map", source, "time unit"))


def _take_mapping(source: str) -> None:
    """Take a mapping file of an earlier log."""
    st.file_uploader(
        "A mapping file of an earlier log, if there is one", type="toml",
        key=f"mapping:{source}", on_change=_read_mapping, args=(source,),
    )  # fmt: skip
    if refusal := st.session_state.get(f"mapping refused:{source}"):
        message(refusal)


def _read_mapping(source: str) -> None:
    """Fill in the answers of a mapping file."""
    file = st.session_state.get(f"mapping:{source}")
    st.session_state.pop(f"mapping refused:{source}", None)
    if file is None:
        return
    try:
        made = parse(file.getvalue().decode("utf-8", errors="replace"), where=file.name)
    except OedSysidError as error:
        st.session_state[f"mapping refused:{source}"] = str(error)
        return
    for name, one in {**made.inputs, **made.outputs}.items():
        fixed, si = to_si(one.constant or 0.0, one.unit or "1")
        answers = {
            "field": one.field or NOT_LOGGED, "unit": one.unit or "", "flip": one.sign == -1,
            "wrap": one.wrap, "factor": float(one.factor), "trim": float(one.trim),
            "delay": float(one.delay), "constant": float(fixed) * factor(si),
        }  # fmt: skip
        for fact, value in answers.items():
            st.session_state[place(source, name, fact)] = value
    if made.cuts:
        cut = made.cuts[0]
        st.session_state[choices.kept("map", source, "cuts")] = BY_TIME
        for name, value in zip(SPAN, (cut.start, cut.stop), strict=True):
            st.session_state[choices.kept("map", source, name)] = float(value)
    if (by := made.by_commands) is not None:
        st.session_state[choices.kept("map", source, "cuts")] = BY_COMMANDS
        for name, value in zip(AROUND, (by.threshold, by.before, by.after), strict=True):
            st.session_state[choices.kept("map", source, name)] = float(value)
    visit.files_changed()
