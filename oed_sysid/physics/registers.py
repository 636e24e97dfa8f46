"""Shift registers of delays, as fine as the integration steps of the model that holds them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from oed_sysid.physics.base import Effect, Memory


def register(signals: Sequence[str], delay: str, longest: float, step: float) -> dict[str, Any]:
    """Terms, definitions and memory of signals that come late by the same time.

    The value is interpolated linearly between present and past values a step apart: the exact mean
    over a step of a delayed held command, and a delayed measurement. Where two slopes meet in a
    corner the right one is taken, so that the derivative at zero is that of more delay. A delay
    longer than the register counts as the register's length.

    Parameters
    ----------
    signals : sequence of str
        Names of the signals; at the start, all past values of each equal its first one.
    delay : str
        Name of the delay, in s.
    longest : float
        Longest delay, in s: one past value for each step of it.
    step : float
        Shortest time between two past values, in s.

    Returns
    -------
    dict
        ``terms``, ``definitions`` and ``memory`` of the effect.

    Examples
    --------
    >>> late = register(("d",), "E", 0.1, 0.1)
    >>> late["definitions"]
    {'late_1': 'd + where(E < 0*h, 0, where(E < 1*h, E/h - 0, 1))*(past_1 - d)'}
    """
    terms: dict[str, str] = {}
    definitions: dict[str, str] = {}
    memory: list[Memory] = []
    for signal in signals:
        own = "" if len(signals) == 1 else f"_{signal}"
        newer = late = signal
        for i in range(1, math.ceil(longest / step - 1e-9) + 1):
            past = f"past{own}_{i}"
            share = f"where({delay} < {i - 1}*h, 0, where({delay} < {i}*h, {delay}/h - {i - 1}, 1))"
            definitions[f"late{own}_{i}"] = f"{late} + {share}*({past} - {newer})"
            memory.append(Memory(past, newer, signal, step))
            newer, late = past, f"late{own}_{i}"
        terms[signal] = late
    return {"terms": terms, "definitions": definitions, "memory": tuple(memory)}


def refined(effect: Effect, step: float) -> Effect:
    """The effect with registers that reach as far by shorter integration steps.

    Held commands are averaged over a step, and measurements are linear within it: by shorter steps
    both errors fall, as they do for lag, rate limit and backlash.

    Parameters
    ----------
    effect : Effect
    step : float
        Longest integration step, in s.

    Returns
    -------
    Effect
        Each step of a register is divided so often that none is longer than ``step``; without a
        register, or where that is so already, the effect as it is.

    Examples
    --------
    >>> from oed_sysid.physics import actuator_delay
    >>> late = actuator_delay("late", "d", max_delay=0.2, step=0.1)
    >>> [one.name for one in refined(late, 0.05).memory]
    ['past_1', 'past_2', 'past_3', 'past_4']
    """
    shortest = max((one.shortest for one in effect.memory), default=0.0)
    parts = math.ceil(shortest / step - 1e-9)
    if parts <= 1:
        return effect
    length = len(effect.memory) // len(effect.terms) * shortest
    finer = register(tuple(effect.terms), effect.amplitude_names[0], length, shortest / parts)
    # They begin as before: at the first command, or beside it.
    first = [one.initial for one in effect.memory for _ in range(parts)]
    memory = (replace(m, initial=i) for m, i in zip(finer["memory"], first, strict=True))
    return replace(effect, **finer | {"memory": tuple(memory)})
