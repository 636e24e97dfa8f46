"""What was answered about a log: which column is which channel, and where to cut."""

from __future__ import annotations

import streamlit as st

from oed_sysid.app import visit
from oed_sysid.app.commands import factor, shown
from oed_sysid.data.logs import LogMapping, Source
from oed_sysid.data.mapping import CommandCuts, Cut
from oed_sysid.errors import DataError
from oed_sysid.experiments.problem import Problem
from oed_sysid.physics.channels import Input, Output

NOT_LOGGED = "not logged"
WHOLE, BY_TIME, BY_COMMANDS = "Whole file", "From … to", "Where a command leaves its rest"
SPAN = ("from", "to")
AROUND = ("threshold", "before", "after")
_FACTS = ("field", "unit", "flip", "wrap", "factor", "trim", "delay", "constant")


class NothingMappedError(DataError):
    """No column was chosen yet for any measured signal."""


def time_column(source: str) -> tuple[str, str] | None:
    """Header of the column of time, and its unit, where none is called so."""
    header = visit.chosen("map", source, "time")
    if not header:
        return None
    return str(header), str(visit.chosen("map", source, "time unit", default="s"))


def asked(source: str, problem: Problem) -> LogMapping:
    """The mapping that was asked for.

    Raises
    ------
    NothingMappedError
        If no output is mapped.
    DataError
        If an answer cannot be.
    """
    inputs, outputs = {}, {}
    for channel in problem.model.inputs:
        found = _source(source, channel)
        if found is None:
            value = float(str(answer(source, channel.name, "constant") or 0.0))
            found = Source(constant=value, unit=shown(channel.unit) if channel.unit else "1")
        inputs[channel.name] = found
    for output in problem.model.outputs:
        measured = _source(source, output)
        if measured is not None:
            outputs[output.name] = measured
    if not outputs:
        raise NothingMappedError(
            "No output is mapped yet. Choose a column for at least one measured signal."
        )
    how = visit.chosen("map", source, "cuts", default=WHOLE)
    cuts: tuple[Cut, ...] = ()
    by_commands = None
    if how == BY_TIME:
        first, last = (float(visit.chosen("map", source, one, default=0.0)) for one in SPAN)
        cuts = (Cut("manoeuvre", first, last),)
    elif how == BY_COMMANDS:
        values = [float(visit.chosen("map", source, one, default=1.0)) for one in AROUND]
        threshold = values[0] / factor(departure_unit(problem))
        by_commands = CommandCuts(threshold, before=values[1], after=values[2])
    return LogMapping(inputs, outputs, cuts=cuts, by_commands=by_commands)


def departure_unit(problem: Problem) -> str:
    """Unit of all commands; empty where they have several, so that SI is meant."""
    units = {channel.unit for channel in problem.model.inputs}
    return units.pop() if len(units) == 1 else ""


def place(source: str, channel: str, fact: str) -> str:
    """Key of one answer about a channel."""
    return visit.kept("map", source, channel, fact)


def answer(source: str, channel: str, fact: str) -> object:
    """One answer about a channel."""
    return st.session_state.get(place(source, channel, fact))


def _source(source: str, channel: Input | Output) -> Source | None:
    """What was answered about one channel; None where it was not logged."""
    answers = {fact: answer(source, channel.name, fact) for fact in _FACTS}
    field = answers["field"]
    if field in (None, "", NOT_LOGGED):
        return None

    def number(fact: str, default: float) -> float:
        value = answers[fact]
        return default if value is None else float(str(value))

    return Source(
        str(field),
        unit=str(answers["unit"] or "").strip() or None,
        sign=-1 if answers["flip"] else 1,
        factor=number("factor", 1.0),
        trim=number("trim", 0.0),
        delay=number("delay", 0.0),
        wrap=bool(answers["wrap"]),
    )
