"""Limits on the command line: ``--max-fin 10``, ``--min-depth 80``, ``--limit pitch=-20:20``.

Words that people use stand for the model's channels; angles are in degrees.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from math import degrees, inf, isfinite, radians

from oed_sysid.errors import DesignError
from oed_sysid.experiments.experiment import Limits
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.physics.model import Model

# Words for one channel each, whatever its name in the model.
SIGNALS = {
    "pitch": "theta", "heel": "phi", "roll": "phi", "heading": "psi", "yaw": "psi",
    "depth": "z", "speed": "u", "surge": "u", "sway": "v", "heave": "w",
    "distance": "x", "advance": "x", "transfer": "y",
    "pitch-rate": "q", "roll-rate": "p", "yaw-rate": "r",
}  # fmt: skip
# A control surface answers to these words if its name or description holds one of its group.
SURFACES = (
    {"fin", "fins", "plane", "planes", "stern plane", "sternplane", "elevator", "hydroplane"},
    {"rudder", "helm"},
    {"thrust", "propeller", "revolutions"},
)
_FORM = re.compile(r"(?:(max|min):)?([A-Za-z_][\w-]*)=(.+)")
_NUMBER = re.compile(r"([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(deg|rad)?(?:/s)?(?:m|m/s|N)?")


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
        side, word, value = form[1] or "", form[2], form[3]
        if word == "rate" or (word.endswith("-rate") and word not in SIGNALS):
            limits, words = _rate(model, limits, word, value)
        else:
            limits, words = _range(model, limits, word, side, value)
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
    names = sorted(set().union(*SURFACES))
    for channel in _channels(model).values():
        is_input = isinstance(channel, Input)
        words = _words(model, channel, names if is_input else SIGNALS)
        words = tuple(word for word in words if is_input or word not in taken)
        if words:
            offered += _offers(channel, words, limits)
        if is_input:
            taken |= {*words, *(f"{word}-rate" for word in words), "rate"}
    if model.inputs:
        offered.append(("max", ("rate",), "slope of every angle that is commanded, deg/s"))
    return offered


Offered = list[tuple[str, tuple[str, ...], str]]


def _offers(
    channel: Input | State | Output, words: tuple[str, ...], limits: Limits
) -> Iterator[tuple[str, tuple[str, ...], str]]:
    """What can be limited of one channel: both ends, the slope of an input, the range of others."""
    is_input = isinstance(channel, Input)
    kind = "input" if is_input else "signal"
    label = f"{getattr(channel, 'label', '') or kind} {channel.name}, {_unit(channel)}"
    both = ", both ways" if channel.unit.startswith("rad") else ""
    now = (limits.inputs if is_input else limits.signals).get(channel.name)
    yield "max", words, f"{label}{both}{_now(channel, now)}"
    yield "min", words, label
    if is_input:
        rate = limits.rates.get(channel.name)
        stands = "" if rate is None else f"; now {_shown(channel, rate)}"
        rates = tuple(f"{word}-rate" for word in words)
        yield "max", rates, f"slope of {channel.name}, {_unit(channel)}/s{stands}"
    elif spoken := tuple(word for word in words if word in SIGNALS):
        yield "", spoken, f"{label}: range"


def _channels(model: Model) -> dict[str, Input | State | Output]:
    """Channels by name: inputs, outputs, states."""
    every: list[Input | State | Output] = [*model.inputs, *model.outputs, *model.states]
    # A later one of a name takes the place of an earlier one.
    return {one.name: one for one in [*every, *model.inputs]}


def _words(model: Model, channel: Input | State | Output, common: Iterable[str]) -> tuple[str, ...]:
    """Words that mean this channel and no other, those of the trade first."""
    found = []
    for word in common:
        if " " in word:
            continue
        try:
            if _channel(model, word).name == channel.name:
                found.append(word)
        except DesignError:  # means several, or none
            continue
    found.sort(key=lambda word: (word not in ("fin", "rudder", "thrust"), len(word)))
    name = channel.name
    return tuple(dict.fromkeys([*found, name, name.replace("_", "-"), name.lower()]))


def _unit(channel: Input | State | Output) -> str:
    return channel.unit.replace("rad", "deg") or "1"


def _shown(channel: Input | State | Output, value: float) -> str:
    return f"{degrees(value) if channel.unit in ('rad', 'rad/s') else value:.4g}"


def _now(channel: Input | State | Output, now: tuple[float, float] | None) -> str:
    if now is None or not any(map(isfinite, now)):
        return ""
    lower, upper = now
    if lower == -upper:
        return f"; now ±{_shown(channel, upper)}"
    return f"; now {_shown(channel, lower)} to {_shown(channel, upper)}"


def _range(model: Model, limits: Limits, word: str, side: str, text: str) -> tuple[Limits, str]:
    channel = _channel(model, word)
    group = limits.inputs if isinstance(channel, Input) else limits.signals
    before = group.get(channel.name, (-inf, inf))
    first, colon, last = text.partition(":")
    if colon:
        lower, upper = _value(channel, first), _value(channel, last)
    else:
        value = _value(channel, text)
        # Angles and control surfaces work to both sides; depth and speed do not.
        both = channel.unit in ("rad", "rad/s") and side != "min" and value > 0
        lower, upper = (-value, value) if both else before
        if not both:
            lower, upper = (value, upper) if side == "min" else (lower, value)
    if not lower < upper:
        raise DesignError(
            f"The limit {word} {text} leaves nothing between {lower:g} and {upper:g} "
            f"{channel.unit}. Correct it."
        )
    ranges = {**group, channel.name: (lower, upper)}
    is_input = isinstance(channel, Input)
    changed = replace(limits, inputs=ranges) if is_input else replace(limits, signals=ranges)
    return changed, f"{word} is {channel.name} ({channel.label or channel.unit})"


def _rate(model: Model, limits: Limits, word: str, text: str) -> tuple[Limits, str]:
    if word == "rate":
        moved = [i for i in model.inputs if i.unit == "rad"] or list(model.inputs)
    else:
        found = _channel(model, word.removesuffix("-rate"))
        if not isinstance(found, Input):
            raise DesignError(f"The rate of {found.name!r} cannot be limited; {_possible(model)}")
        moved = [found]
    rates = {i.name: _value(i, text) for i in moved}
    return replace(limits, rates={**limits.rates, **rates}), f"{word} is of {', '.join(rates)}"


def _value(channel: Input | State | Output, text: str) -> float:
    form = _NUMBER.fullmatch(text.strip())
    try:
        value = float(form[1]) if form else None
    except ValueError:
        value = None
    if form is None or value is None:
        unit = channel.unit.replace("rad", "deg")
        raise DesignError(f"{text!r} is no number for {channel.name!r}; give it in {unit}.")
    angle = channel.unit in ("rad", "rad/s")
    return radians(value) if angle and form[2] != "rad" else value


def _channel(model: Model, word: str) -> Input | State | Output:
    """Channel that a word means: its name, a common word, or part of its description."""
    word = word.lower()
    channels = _channels(model)
    by_name = {name.lower(): channel for name, channel in channels.items()}
    if word.replace("-", "_") in by_name:
        return by_name[word.replace("-", "_")]
    if SIGNALS.get(word) in channels:
        return channels[SIGNALS[word]]
    found = [i for i in model.inputs if _answers(i, word)]
    if len(found) == 1:
        return found[0]
    if len(found) > 1:
        raise DesignError(
            f"{word!r} may mean {' or '.join(i.name for i in found)}. Say which: "
            f"--max-{found[0].name}."
        )
    raise DesignError(f"Model {model.name!r} has no {word!r} to limit; {_possible(model)}")


def _answers(channel: Input, word: str) -> bool:
    own = f"{channel.name} {channel.label}".lower().replace("_", " ")
    parts = set(own.split())
    return word in parts or any(
        word in group and any(name in own for name in group) for group in SURFACES
    )


def _possible(model: Model) -> str:
    """What can be limited, in words."""
    inputs = [f"--max-{i.name}" for i in model.inputs]
    surfaces = [min(group & {"fin", "rudder", "thrust"}) for group in SURFACES
                if any(_answers(i, word) for i in model.inputs for word in group)]  # fmt: skip
    names = {*model.state_names, *model.output_names}
    words = [word for word, name in SIGNALS.items() if name in names]
    return (
        f"possible are {', '.join([*inputs, *(f'--max-{s}' for s in surfaces)])}, --max-rate, and "
        f"--max- or --min- with {', '.join([*words, *sorted(names)])}."
    )
