"""From files with other names, units and signs to records: which column is which channel.

The answers become a :class:`~oed_sysid.data.mapping.LogMapping`, the same that ``oed-sysid import``
reads; files of one layout are read with one mapping, whatever they are called.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import streamlit as st

from oed_sysid import Channels, Dataset, Input, OedSysidError, Output, Problem, Record
from oed_sysid.app import visit
from oed_sysid.app.panels import download, message
from oed_sysid.app.trust import check_uploads
from oed_sysid.data.csv_columns import TIMES
from oed_sysid.data.formats import FORMATS
from oed_sysid.data.logs import (
    Log,
    LogMapping,
    Recognised,
    Source,
    draft,
    import_log,
    open_log,
    recognise,
)
from oed_sysid.data.mapping import CommandCuts, Cut, parse
from oed_sysid.data.recognise import role_of, source_of
from oed_sysid.data.record import clear_wraps
from oed_sysid.errors import DataError
from oed_sysid.text.csv_table import read_table
from oed_sysid.text.units import shown_unit, to_si

# Endings of the logs that are read.
ENDINGS = tuple(ending[1:] for form in FORMATS for ending in form.endings)
TIME_UNITS = ("s", "ms", "min", "h")


@dataclass(frozen=True, eq=False)
class Opened:
    """Logs by the names of their files; what was refused, and why."""

    logs: Mapping[str, Log]
    refused: Mapping[str, str]


def open_files(files: Mapping[str, bytes], time: tuple[str, str] | None = None) -> Opened:
    r"""Open the logs that were given.

    Parameters
    ----------
    files : mapping of str to bytes
        Contents by file name.
    time : (str, str), optional
        Header of the column of time in CSV files, and its unit, where it is not called ``t``.

    Examples
    --------
    >>> opened = open_files({"run.csv": b"clock,yaw [deg]\n0,1\n500,2\n"}, ("clock", "ms"))
    >>> opened.logs["run.csv"].names, opened.logs["run.csv"].span
    (('run.yaw [deg]',), (0.0, 0.5))
    """
    header, unit = time or ("", "")

    def opened(path: Path) -> Log:
        log = open_log(path, time=header)
        return log.timed(unit=unit) if header == log.clock else log

    return Opened(*read_each(files, opened))


Read = TypeVar("Read")


def read_each(
    files: Mapping[str, bytes], read: Callable[[Path], Read]
) -> tuple[dict[str, Read], dict[str, str]]:
    """Read uploaded files: what each one holds, and why the others cannot be read."""
    found, refused = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            path = Path(folder) / plain_name(name)
            path.write_bytes(content)
            try:
                found[name] = read(path)
            except DataError as error:
                refused[name] = str(error).replace(f"{folder}/", "")
    return found, refused


def is_table(name: str) -> bool:
    """Whether a file is a table in text."""
    return Path(name).suffix.lower() in (".csv", ".tsv", ".txt")


def headers(files: Mapping[str, bytes]) -> tuple[str, ...]:
    r"""Headers of the first table in text.

    >>> headers({"may.csv": b"# log of May\nclock;yaw [deg]\n0;1\n"})
    ('clock', 'yaw [deg]')
    """
    tables = {name: content for name, content in files.items() if is_table(name)}
    found, _ = read_each(tables, lambda path: read_table(path, columns_of_text=True).headers)
    return next(iter(found.values()), ())


def first_guess(log: Log, channels: Channels, found: Recognised | None = None) -> dict[str, Source]:
    r"""What numbers and names say about each channel, inputs and outputs alike.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> log = open_files({"a.csv": b"t,psi [deg]\n0,1\n1,2\n"}).logs["a.csv"]
    >>> found = first_guess(log, load_problem("esso_osaka").channels)
    >>> list(found), found["psi"].wrap
    (['psi'], True)
    """
    made = draft(log, channels, found=found)
    both = {} if made is None else {**made.inputs, **made.outputs}
    return {name: source for name, source in both.items() if source.field}


@st.cache_resource(show_spinner="Reading what the fields are", max_entries=10)
def _recognised(source: str, edition: str, _log: Log) -> Recognised:
    """What the fields of the first log are."""
    return recognise(_log)


def recognised(source: str, log: Log) -> Recognised:
    """What the fields of the first log of a problem are, once for each set of files."""
    return _recognised(source, f"{visit.edition()}:{time_column(source)}", log)


@dataclass(frozen=True, eq=False)
class Stock:
    """Records to choose from; why files were refused, by their names; what looks odd."""

    records: Dataset | None
    refused: Mapping[str, str]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, records: Iterable[Record], refused: Mapping[str, str], notes: Iterable[str]
    ) -> Stock:
        """Return what there is; none is no dataset, and nothing is said twice."""
        found = tuple(records)
        return cls(Dataset(found) if found else None, refused, tuple(dict.fromkeys(notes)))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the records."""
        return () if self.records is None else self.records.names


def imported(opened: Opened, mapping: LogMapping, channels: Channels) -> Stock:
    """Make records of all files.

    Parameters
    ----------
    opened : Opened
        The files.
    mapping : LogMapping
        Which field is which channel.
    channels : Channels
        Those of the problem.

    Returns
    -------
    Stock
        Its notes say what was done to the numbers.
    """
    records: list[Record] = []
    refused = dict(opened.refused)
    notes: list[str] = []
    for name, log in opened.logs.items():
        try:
            made = import_log(log, mapping, channels)
        except DataError as error:
            refused[name] = str(error)
            continue
        taken = {record.name for record in records}
        for record in made.dataset:
            again = f"{Path(name).stem}_{record.name}"
            records.append(record.rename(again) if record.name in taken else record)
        notes += made.notes
    return Stock.of(records, refused, notes)


def plain_name(name: str) -> str:
    """Name of an uploaded file without what could lead out of a folder.

    >>> plain_name("../../x.csv"), plain_name(".."), plain_name("dive 1.csv")
    ('x.csv', 'upload.csv', 'dive 1.csv')
    """
    last = re.split(r"[\\/]", name)[-1]
    kept = re.sub(r"[^\w.,()+\- ]", "_", last).lstrip(".")[-100:]
    return kept or "upload.csv"


# -- files that were given ---------------------------------------------------------------


def log_key(source: str) -> str:
    """Under what the logs for a problem are held."""
    return f"log:{source}"


def held(key: str) -> dict[str, bytes]:
    """Files that were given, by name."""
    return st.session_state.get(visit.FILES + key, {})


def take_files(words: str, key: str, endings: Sequence[str]) -> None:
    """Ask for files, and keep them when the page is left."""
    files = st.file_uploader(
        words, type=list(endings), accept_multiple_files=True, key=f"upload:{key}",
        on_change=_take, args=(key,),
    )  # fmt: skip
    if not files:  # drawn anew: it shows none of the files that were given before
        st.session_state[f"shown:{key}"] = set()
    if have := held(key):
        shown = st.session_state.get(f"shown:{key}", set())
        if hidden := [name for name in have if name not in shown]:
            st.caption(f"Given before: {', '.join(hidden)}")
        if st.button("Forget these files", key=f"forget:{key}"):
            have.clear()
            visit.files_changed()
            st.rerun()


def _take(key: str) -> None:
    """Keep the files that were given, and forget those that were taken back."""
    have: dict[str, bytes] = st.session_state.setdefault(visit.FILES + key, {})
    now = {file.name: file.getvalue() for file in st.session_state[f"upload:{key}"]}
    for name in st.session_state.get(f"shown:{key}", set()) - set(now):
        have.pop(name, None)
    have.update(now)
    visit.files_changed()
    st.session_state[f"shown:{key}"] = set(now)


def opened_logs(source: str) -> Opened:
    """Logs that were given for a problem."""
    key = log_key(source)
    check_uploads(held(key))
    return _opened(key, visit.edition(), time_column(source))


@st.cache_resource(show_spinner="Reading the logs", max_entries=10)
def _opened(key: str, edition: str, time: tuple[str, str] | None) -> Opened:
    return open_files(held(key), time)


# -- answers -----------------------------------------------------------------------------

NOT_LOGGED = "not logged"
WHOLE, BY_TIME, BY_COMMANDS = "Whole file", "From … to", "Where a command leaves its rest"
_SPAN, _AROUND = ("from", "to"), ("threshold", "before", "after")
# What is asked about each channel, and what holds before it is answered.
_FACTS: Mapping[str, Any] = {
    "field": NOT_LOGGED, "unit": "", "flip": False, "wrap": False, "factor": 1.0, "trim": 0.0,
    "delay": 0.0, "constant": 0.0,
}  # fmt: skip


class NothingMappedError(DataError):
    """No column was chosen yet for any measured signal."""


def time_column(source: str) -> tuple[str, str] | None:
    """Header of the column of time, and its unit, where none is called so."""
    header = visit.chosen("map", source, "time")
    return (str(header), str(visit.chosen("map", source, "time unit") or "s")) if header else None


def asked(source: str, problem: Problem) -> LogMapping:
    """The mapping that was asked for.

    Raises
    ------
    NothingMappedError
        If no output is mapped.
    DataError
        If an answer cannot be.
    """
    found = {one.name: _source(source, one) for one in problem.channels.all}
    outputs = {one.name: made for one in problem.model.outputs if (made := found[one.name]).field}
    if not outputs:
        raise NothingMappedError(
            "No output is mapped yet. Choose a column for at least one measured signal."
        )
    unit = str(visit.chosen("map", source, "clock unit") or "")
    inputs = {one.name: found[one.name] for one in problem.model.inputs}
    mapping = LogMapping(inputs, outputs, time_unit=unit)
    return replace(mapping, **_cuts(source, problem))


def _cuts(source: str, problem: Problem) -> dict[str, Any]:
    """How the log is cut into runs, as fields of a mapping."""
    how = visit.chosen("map", source, "cuts", default=WHOLE)
    if how == BY_TIME:
        first, last = (float(visit.chosen("map", source, one, default=0.0)) for one in _SPAN)
        return {"cuts": (Cut("manoeuvre", first, last),)}
    if how == BY_COMMANDS:
        least, *around = (float(visit.chosen("map", source, n, default=1.0)) for n in _AROUND)
        least /= shown_unit(_departure_unit(problem))[0]
        return {"by_commands": CommandCuts(least, before=around[0], after=around[1])}
    return {}


def _departure_unit(problem: Problem) -> str:
    """Unit of all commands; empty where they have several, so that SI is meant."""
    units = {channel.unit for channel in problem.model.inputs}
    return units.pop() if len(units) == 1 else ""


def _place(source: str, channel: str, fact: str) -> str:
    """Key of one answer about a channel."""
    return visit.kept("map", source, channel, fact)


def _source(source: str, channel: Input | Output) -> Source:
    """Where a channel stands in the logs, by what was answered; a constant if it is not logged."""
    said = ((fact, st.session_state.get(_place(source, channel.name, fact))) for fact in _FACTS)
    found = {**_FACTS, **{fact: value for fact, value in said if value not in (None, "")}}
    numbers: dict[str, Any] = {fact: float(found[fact]) for fact in ("factor", "trim", "delay")}
    if found["field"] == NOT_LOGGED:
        return Source(constant=float(found["constant"]), unit=shown_unit(channel.unit)[1] or "1")
    return Source(
        str(found["field"]), unit=str(found["unit"]).strip() or None,
        sign=-1 if found["flip"] else 1, wrap=bool(found["wrap"]),
        **numbers,
    )  # fmt: skip


# -- the part of the page that asks ------------------------------------------------------


def show(problem: Problem, source: str) -> None:
    """Take logs, and ask which of their fields are the channels of the problem."""
    left, right = st.columns([3, 2])
    with left:
        words = "Logs of one layout: " + ", ".join(f".{ending}" for ending in ENDINGS)
        take_files(words, log_key(source), ENDINGS)
    with right:
        _take_mapping(source)
    files = held(log_key(source))
    if not files:
        return
    opened = opened_logs(source)
    if not opened.logs or time_column(source) is not None:
        _ask_time(source, files)
        opened = opened_logs(source)
    if not opened.logs and any(map(is_table, files)) and time_column(source) is None:
        st.info("Choose the column that holds the times.")
        return
    for name, refusal in opened.refused.items():
        message(f"**{name}** was refused. {refusal}")
    if opened.logs:
        _ask(source, problem, next(iter(opened.logs.values())))


def _ask(source: str, problem: Problem, log: Log) -> None:
    """Ask about channels and cuts, and offer the mapping to take home."""
    _begin(source, problem, log)
    with st.expander(f"What {log.path.name} holds: {len(log.names)} fields"):
        heads = ("field", "samples", "rate", "from – to", "unit", "range")
        st.dataframe([dict(zip(heads, row, strict=True)) for row in log.rows()], hide_index=True)
    _say_guesses(source, log)
    if log.clock_unit is None:
        words = f"The clock, {log.clock}, counts in"
        st.selectbox(words, list(TIMES), key=visit.kept("map", source, "clock unit"))
    widths = [2.2, 3.0, 1.2, 0.9, 1.1, 1.1]
    heads = ("Channel", "Column", "Its unit", "Reversed", "Jumps by 360°", "")
    for column, head in zip(st.columns(widths), heads, strict=True):
        column.caption(head)
    for channel in problem.channels.all:
        _ask_channel(source, channel, log, st.columns(widths, vertical_alignment="center"))
    _ask_cuts(source, problem, log)
    with suppress(OedSysidError):  # said with the records
        text = f"problem = {json.dumps(source)}\n{asked(source, problem).text()}"
        download("Mapping file", lambda: text, "mapping.toml")


def _begin(source: str, problem: Problem, log: Log) -> None:
    """Fill in what names and units say, once per log; keep what was answered where it still is."""
    state, mark = st.session_state, visit.kept("map", source, "for")
    fields = list(log.names)
    is_new, guesses = state.get(mark) != fields, dict[str, Source]()
    if is_new:
        told = recognised(source, log)
        guesses = first_guess(log, problem.channels, told)
        if log.clock_unit is None:
            state.setdefault(visit.kept("map", source, "clock unit"), told.time_unit)
    for channel in problem.channels.all:
        key = partial(_place, source, channel.name)
        now = state.setdefault(key("field"), NOT_LOGGED)
        if now != NOT_LOGGED:
            now = state[key("field")] = log.as_here(str(now)) or NOT_LOGGED
        if now == NOT_LOGGED and (one := guesses.get(channel.name)) is not None:
            state.update({key(fact): value for fact, value in _answers(one).items()})
    state[mark] = fields


def _ask_channel(source: str, channel: Input | Output, log: Log, row: Sequence[Any]) -> None:
    """Ask which field is a channel, in which unit, which way round."""
    name, unit = channel.name, shown_unit(channel.unit)[1] or "-"

    def key(fact: str) -> str:
        return visit.preset(_place(source, name, fact), _FACTS[fact])

    hidden: dict[str, Any] = {"label_visibility": "collapsed"}
    kind = "command" if isinstance(channel, Input) else "measured"
    row[0].markdown(f"{channel.label or name} `{name}` [{unit}], {kind}")
    row[1].selectbox(
        f"Column of {name}", [NOT_LOGGED, *log.names], key=key("field"), on_change=_unit_of,
        args=(source, channel), **hidden,
    )  # fmt: skip
    if st.session_state.get(key("field")) == NOT_LOGGED:
        if isinstance(channel, Input):
            words = f"It did not change: its value, in {unit}"
            row[2].number_input(
                f"Value of {name}", key=key("constant"), format="%.4g", help=words, **hidden
            )
            row[3].caption(f"{unit}, constant")
        return
    row[2].text_input(f"Unit of {name}", key=key("unit"), placeholder="as logged", **hidden)
    row[3].checkbox(f"Flip {name}", key=key("flip"), help="Its axis points reversed.", **hidden)
    if channel.unit == "rad":
        words = "The log holds the angle within one turn: 0° to 360°, or ±180°."
        row[4].checkbox(f"Unwrap {name}", key=key("wrap"), help=words, **hidden)
    with row[5].popover("More", width="stretch"):
        st.caption("Channel = factor × (reading − trim)")
        logged = st.session_state.get(key("unit")) or "as logged"
        for fact, words in (("factor", "Factor"), ("trim", f"Trim: reading at zero [{logged}]"),
                            ("delay", "Late by [s]")):  # fmt: skip
            st.number_input(words, key=key(fact), format="%.6g")


def _unit_of(source: str, channel: Input | Output) -> None:
    """Write what is known of a newly chosen column: unit, wrap, sign and zero."""
    field = str(st.session_state.get(_place(source, channel.name, "field")))
    log = next(iter(opened_logs(source).logs.values()), None)
    if log is None or field not in log.names:
        return
    told = [one for one in recognised(source, log).guesses if one.field == field]
    jumps = clear_wraps(log[field].values)
    unit = log[field].unit or ("" if jumps is None else "rad" if jumps[0] < 7.0 else "deg")
    made = Source(field, unit=unit or None, wrap=jumps is not None)
    if told and role_of(channel) == told[0].role:
        made = source_of(told[0])
    facts = _answers(made)
    st.session_state.update({_place(source, channel.name, fact): v for fact, v in facts.items()})


def _say_guesses(source: str, log: Log) -> None:
    """Say what the fields were taken for and why; first what should be confirmed."""
    told = recognised(source, log)
    rows = told.rows(log)
    asked = any(one.doubts for one in told.guesses)
    if not rows:
        return
    with st.expander(f"What the numbers say: {len(rows)} fields", expanded=asked):
        if told.doubts:
            st.warning(f"Please confirm: the clock counts in {told.time_unit}.")
        st.dataframe(rows, hide_index=True)


def _ask_cuts(source: str, problem: Problem, log: Log) -> None:
    """Ask where manoeuvres begin and end."""
    keys = partial(visit.kept, "map", source)
    columns = st.columns([2.2, 1, 1, 1], vertical_alignment="bottom")
    how = columns[0].selectbox("Records", (WHOLE, BY_TIME, BY_COMMANDS), key=keys("cuts"))
    unit = _departure_unit(problem)
    least = 3.0 if unit == "rad" else 0.05
    offers: dict[Any, tuple[tuple[str, str, float], ...]] = {
        BY_TIME: tuple((n, f"{n} [s]", round(v, 3)) for n, v in zip(_SPAN, log.span, strict=True)),
        BY_COMMANDS: (
            ("threshold", f"Departure [{shown_unit(unit)[1] or 'SI'}]", least),
            ("before", "Before [s]", 5.0),
            ("after", "After [s]", 10.0),
        ),
    }
    for column, (name, label, value) in zip(columns[1:], offers.get(how, ()), strict=False):
        column.number_input(label, key=visit.preset(keys(name), value), format="%.4g")


def _ask_time(source: str, files: Mapping[str, bytes]) -> None:
    """Ask which column is the time, where none is called so."""
    if names := headers(files):
        left, right, _ = st.columns([2, 1, 1])
        left.selectbox(
            "Column of time", names, index=None,
            key=visit.kept("map", source, "time"),
            placeholder="No column is called t or time: choose one",
        )  # fmt: skip
        right.selectbox("Its unit", TIME_UNITS, key=visit.kept("map", source, "time unit"))


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
    state = st.session_state
    file = state.get(f"mapping:{source}")
    state.pop(f"mapping refused:{source}", None)
    if file is None:
        return
    try:
        made = parse(file.getvalue().decode("utf-8", errors="replace"), where=file.name)
    except OedSysidError as error:
        state[f"mapping refused:{source}"] = str(error)
        return
    for name, one in {**made.inputs, **made.outputs}.items():
        state.update({_place(source, name, fact): value for fact, value in _answers(one).items()})
    how, cuts = WHOLE, dict[str, Any]()
    if made.cuts:
        how, cuts = BY_TIME, dict(zip(_SPAN, (made.cuts[0].start, made.cuts[0].stop), strict=True))
    if (by := made.by_commands) is not None:
        how, cuts = BY_COMMANDS, {name: getattr(by, name) for name in _AROUND}
    state[visit.kept("map", source, "cuts")] = how
    state.update({visit.kept("map", source, name): float(one) for name, one in cuts.items()})
    visit.files_changed()


def _answers(one: Source) -> dict[str, Any]:
    """What would have been answered about a channel; see :func:`_source`."""
    fixed, si = to_si(one.constant or 0.0, one.unit or "1")
    return {
        "field": one.field or NOT_LOGGED, "unit": one.unit or "", "flip": one.sign == -1,
        "wrap": one.wrap, "constant": float(fixed) * shown_unit(si)[0],
        **{fact: float(getattr(one, fact)) for fact in ("factor", "trim", "delay")},
    }  # fmt: skip
