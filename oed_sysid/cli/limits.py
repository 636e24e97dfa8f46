"""Limits on the command line, written like headers: ``"rudder [deg]=-20:20"``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from oed_sysid.errors import DataError, DesignError
from oed_sysid.experiment import Limits
from oed_sysid.model import Model
from oed_sysid.units import parse_header, same_dimension, to_si


def narrowed(limits: Limits, model: Model, ranges: Iterable[str], rates: Iterable[str]) -> Limits:
    """Return limits with some commands' ranges and rates replaced.

    Parameters
    ----------
    limits : Limits
        The problem's.
    model : Model
        Whose inputs are meant.
    ranges : iterable of str
        As ``"rudder [deg]=-20:20"``.
    rates : iterable of str
        As ``"rudder [deg/s]=5"``.

    Raises
    ------
    DesignError
        If a limit cannot be read, or has a wrong unit.
    """
    units = {channel.name: channel.unit or "1" for channel in model.inputs}
    inputs, slopes = dict(limits.inputs), dict(limits.rates)
    for text in ranges:
        name, values = _read(text, units, "", 2)
        inputs[name] = (values[0], values[1])
    for text in rates:
        name, values = _read(text, units, "/s", 1)
        slopes[name] = values[0]
    return replace(limits, inputs=inputs, rates=slopes)


def _read(text: str, units: dict[str, str], per: str, n_values: int) -> tuple[str, list[float]]:
    """Name and SI values of one limit."""
    form = f'"NAME [UNIT{per}]=' + ("LEAST:LARGEST" if n_values == 2 else "RATE") + '"'
    head, _, tail = text.partition("=")
    name, unit = parse_header(head)
    parts = tail.split(":")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != n_values or unit is None:
        raise DesignError(f"The limit {text!r} cannot be read. Write it as {form}.")
    if name not in units:
        raise DesignError(
            f"The limit {text!r} is on {name!r}, which is no input. Inputs are {', '.join(units)}."
        )
    wanted = f"{units[name]}{per}"
    try:
        fits = same_dimension(unit, wanted)
    except DataError as error:
        raise DesignError(f"The limit {text!r}: {error}") from None
    if not fits:
        raise DesignError(f"The limit {text!r} has the unit {unit!r}; expected one like {wanted}.")
    return name, [float(to_si([number], unit)[0][0]) for number in numbers]
