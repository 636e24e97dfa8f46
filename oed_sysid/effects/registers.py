"""Shift registers: the past values from which a delayed one is made."""

from __future__ import annotations

import math

from oed_sysid.effects.base import Memory


def delay_register(
    signal: str, delay: str, *, max_delay: float, step: float, prefix: str = "past"
) -> tuple[str, tuple[Memory, ...]]:
    """Delayed value of a sampled signal and the memory that it needs.

    The value is a mean of present and past samples with hat functions of
    ``delay/h`` as weights: the exact mean over a step of a delayed held command,
    and the interpolation of a delayed measurement. Where two slopes meet in a
    corner the right one is taken, so that the derivative at zero is that of
    more delay. A delay longer than the register counts as the register's length.

    Parameters
    ----------
    signal : str
        Name of the signal; at the start, all past values equal its first one.
    delay : str
        Name of the delay, in s.
    max_delay : float
        Longest delay, in s.
    step : float
        Shortest time between two samples, in s.
    prefix : str
        First part of the names of the past values.

    Returns
    -------
    value : str
        Expression of the delayed value.
    memory : tuple of Memory
        One past value for each step of ``max_delay``.

    Examples
    --------
    >>> value, memory = delay_register("d", "E", max_delay=0.1, step=0.1)
    >>> value, memory[0].update
    ('where(E < h, 1 - E/h, 0)*d + where(E < 1*h, E/h, 1)*past_1', 'd')
    """
    past = [f"{prefix}_{i}" for i in range(1, math.ceil(max_delay / step - 1e-9) + 1)]
    pieces = [f"where({delay} < h, 1 - {delay}/h, 0)*{signal}"]
    for i, name in enumerate(past, start=1):
        rise = f"where({delay} < {i - 1}*h, 0, {delay}/h - {i - 1})" if i > 1 else f"{delay}/h"
        fall = f"where({delay} < {i + 1}*h, {i + 1} - {delay}/h, 0)" if i < len(past) else "1"
        pieces.append(f"where({delay} < {i}*h, {rise}, {fall})*{name}")
    newer = [signal, *past[:-1]]
    memory = tuple(Memory(own, update, signal) for own, update in zip(past, newer, strict=True))
    return " + ".join(pieces), memory
