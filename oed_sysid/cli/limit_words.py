"""Limits on the command line: ``--max-fin 10``, ``--min-depth 80``, ``--limit pitch=-20:20``.

Words that people use stand for the model's channels; angles are in degrees.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from math import degrees, inf, isfinite, radians
from typing import Any

from oed_sysid import Input, Limits, Model, Output, State
from oed_sysid.errors import DesignError
from oed_sysid.runtime.tables import tables

_TABLE = tables(__file__)
SIGNALS, SURFACES = _TABLE["signals"], _TABLE["surfaces"]
Channel = Input | Output | State
# Which group of limits is of a channel that is an input or none, and what it is called.
_GROUPS = {True: ("inputs", "input"), False: ("signals", "signal")}
ANGLES = ("rad", "rad/s")
_FORM = re.compile(r"(?:(max|min):)?([A-Za-z_][\w-]*)=(.+)")
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(deg|rad)?(?:/s)?(?:m|m/s|N)?")


def with_limits(model: Model, limits: Limits, given: Sequence[str]) -> tuple[Limits, list[str]]:
    """Return limits changed by those of the command line, and what they are, in words.

    Parameters
    ----------
    model : Model
        Whose channels are limited.
    limits : Limits
        Of the problem.
    given : sequence of str
        ``max:NAME=VALUE``, ``min:NAME=VALUE``, ``NAME=VALUE`` or ``NAME=LOW:HIGH``.

    Raises
    ------
    DesignError
        If a name or a value is not understood; it lists what can be limited.
    """
    said = []
    for text in given:
        form = _FORM.fullmatch(text)
        if form is None:
            raise DesignError(
                f"The limit {text!r} is not understood. Write --max-fin 10, --min-depth 80, or "
                "--limit NAME=VALUE, --limit NAME=LOW:HIGH; angles in degrees."
            )
        side, word, value = form.groups(default="")
        is_rate = word == "rate" or (word.endswith("-rate") and word not in SIGNALS)
        change = _rate if is_rate else _range
        limits, words = change(model, limits, word, side, value)
        said.append(words)
    return limits, said


def limit_words(model: Model, limits: Limits) -> list[tuple[str, tuple[str, ...], str]]:
    """Return what can be limited: side, words for it (the first to be shown), and what it is.

    Parameters
    ----------
    model : Model
        Whose channels are limited.
    limits : Limits
        Those that hold without a word.

    Returns
    -------
    list of (str, tuple of str, str)
        The side is ``"max"``, ``"min"``, or empty for a range.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> problem = load_problem("auv_diving_plane")
    >>> offered = limit_words(problem.model, problem.limits)
    >>> [words[:2] for side, words, _ in offered if side == "min" and "pitch" in words]
    [('pitch', 'theta')]
    """
    offered: Offered = []
    taken: set[str] = set()
    meant = _meaning(model)
    for channel in _channels(model).values():
        is_input = isinstance(channel, Input)
        if words := [one for one in _words(channel, meant) if is_input or one not in taken]:
            offered += _offers(channel, tuple(words), limits)
        if is_input:
            taken |= {*words, *(f"{word}-rate" for word in words), "rate"}
    if model.inputs:
        offered.append(("max", ("rate",), "slope of every angle that is commanded, deg/s"))
    return offered


def _words(channel: Channel, meant: Mapping[str, list[Channel]]) -> dict[str, None]:
    """Words that mean a channel and no other, those of the trade first."""
    trade = sorted(chain.from_iterable(SURFACES.values()))
    known = trade if isinstance(channel, Input) else SIGNALS
    words = [word for word in known if meant.get(word) == [channel]]
    words.sort(key=lambda word: (word not in SURFACES, len(word)))
    name = channel.name
    return dict.fromkeys([*words, name, name.replace("_", "-"), name.lower()])


Offered = list[tuple[str, tuple[str, ...], str]]


def _offers(
    channel: Channel, words: tuple[str, ...], limits: Limits
) -> Iterator[tuple[str, tuple[str, ...], str]]:
    """What can be limited of one channel: both ends, the slope of an input, the range of others."""
    group, kind = _GROUPS[isinstance(channel, Input)]
    unit = channel.unit.replace("rad", "deg") or "1"
    label = f"{channel.label or kind} {channel.name}, {unit}"
    both = ", both ways" if channel.unit.startswith("rad") else ""
    now = getattr(limits, group).get(channel.name, (-inf, inf))
    yield "max", words, f"{label}{both}{_now(channel, now)}"
    yield "min", words, label
    if isinstance(channel, Input):
        rates = tuple(f"{word}-rate" for word in words)
        now = (limits.rates.get(channel.name, inf),) * 2
        yield "max", rates, f"slope of {channel.name}, {unit}/s{_now(channel, now)}"
    elif spoken := tuple(word for word in words if word in SIGNALS):
        yield "", spoken, f"{label}: range"


def _channels(model: Model) -> dict[str, Channel]:
    """Channels by name: inputs, outputs, states."""
    every: list[Channel] = [*model.inputs, *model.outputs, *model.states]
    # A later one of a name takes the place of an earlier one.
    return {one.name: one for one in [*every, *model.inputs]}


def _meaning(model: Model) -> dict[str, list[Channel]]:
    """What each word may mean: its name, before a common word, before part of a description."""
    channels, found = _channels(model), dict[str, list[Channel]]()
    for one in model.inputs:
        own = f"{one.name} {one.label}".lower().replace("_", " ")
        groups = (words for words in SURFACES.values() if any(word in own for word in words))
        for word in set(own.split()).union(*groups):
            found.setdefault(word, []).append(one)
    found |= {word: [channels[name]] for word, name in SIGNALS.items() if name in channels}
    return found | {name.lower(): [one] for name, one in channels.items()}


def _now(channel: Channel, now: tuple[float, float]) -> str:
    """What holds without a word."""
    if not any(map(isfinite, now)):
        return ""
    turn = degrees(1.0) if channel.unit in ANGLES else 1.0
    lower, upper = turn * now[0], turn * now[1]
    if lower == upper:
        return f"; now {upper:.4g}"
    return f"; now ±{upper:.4g}" if lower == -upper else f"; now {lower:.4g} to {upper:.4g}"


def _range(model: Model, limits: Limits, word: str, side: str, text: str) -> tuple[Limits, str]:
    channel = _channel(model, word)
    group, _ = _GROUPS[isinstance(channel, Input)]
    before = getattr(limits, group).get(channel.name, (-inf, inf))
    values = [_value(channel, part) for part in text.split(":", 1)]
    # Of a single value: angles and control surfaces work to both sides; depth and speed do not.
    if len(values) == 2:
        lower, upper = values
    elif side == "min":
        lower, upper = values[0], before[1]
    else:
        both = channel.unit in ANGLES and values[0] >= 0
        lower, upper = 0.0 - values[0] if both else before[0], values[0]
    if not lower < upper:
        raise DesignError(
            f"The limit {word} {text} leaves nothing between {lower:g} and {upper:g} "
            f"{channel.unit}. Correct it; an input stands still in the constants of an experiment."
        )
    words = f"{word} is {channel.name} ({channel.label or channel.unit})"
    return _changed(limits, group, {channel.name: (lower, upper)}), words


def _changed(limits: Limits, group: str, bounds: Mapping[str, Any]) -> Limits:
    """Limits with others in one of their groups."""
    made: dict[str, Any] = {group: {**getattr(limits, group), **bounds}}
    return replace(limits, **made)


def _rate(model: Model, limits: Limits, word: str, side: str, text: str) -> tuple[Limits, str]:
    if word == "rate":
        moved = [i for i in model.inputs if i.unit == "rad"] or list(model.inputs)
    else:
        found = _channel(model, word.removesuffix("-rate"))
        if not isinstance(found, Input):
            raise DesignError(
                f"The rate of {found.name!r} cannot be limited; only inputs have one: "
                f"{', '.join(f'--max-{i.name}-rate' for i in model.inputs)}."
            )
        moved = [found]
    rates = {i.name: _value(i, text) for i in moved}
    return _changed(limits, "rates", rates), f"{word} is of {', '.join(rates)}"


def _value(channel: Channel, text: str) -> float:
    form = _NUMBER.fullmatch(text.strip())
    if form is None:
        unit = channel.unit.replace("rad", "deg")
        raise DesignError(f"{text!r} is no number for {channel.name!r}; give it in {unit}.")
    value = float(form[1])
    return radians(value) if channel.unit in ANGLES and form[2] != "rad" else value


def _channel(model: Model, word: str) -> Channel:
    """Channel that a word means."""
    meant, word = _meaning(model), word.lower()
    found = meant.get(word.replace("-", "_")) or meant.get(word, [])
    if len(found) == 1:
        return found[0]
    if found:
        raise DesignError(
            f"{word!r} may mean {' or '.join(i.name for i in found)}. Say which: "
            f"--max-{found[0].name}."
        )
    possible = [f"--max-{words[0]}" for side, words, _ in limit_words(model, Limits())
                if side == "max"]  # fmt: skip
    raise DesignError(
        f"Model {model.name!r} has no {word!r} to limit; possible are {', '.join(possible)}, and "
        "lower limits with --min-."
    )
