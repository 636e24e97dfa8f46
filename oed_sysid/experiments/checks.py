"""Checks of a manoeuvre's numbers, made once, when it is constructed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oed_sysid.errors import ModelError

FloatArray = NDArray[np.float64]
Numbers = Sequence[float] | FloatArray


def finite(owner: str, name: str, value: float) -> float:
    """Return ``value`` as a float, or raise if it is not a finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        raise ModelError(f"{owner} has {name} {value!r}. Give a finite number.")
    return number


def positive(owner: str, name: str, value: float, advice: str = "") -> float:
    """Return ``value`` as a float, or raise if it is not above zero."""
    number = finite(owner, name, value)
    if number <= 0:
        raise ModelError(f"{owner} has {name} {number:g}; it must be above zero. {advice}".rstrip())
    return number


def not_zero(owner: str, name: str, value: float, advice: str) -> float:
    """Return ``value`` as a float, or raise if it is zero."""
    number = finite(owner, name, value)
    if number == 0:
        raise ModelError(f"{owner} has {name} 0, which moves nothing. {advice}")
    return number


def slope(owner: str, value: float | None) -> float | None:
    """Return a rate limit: a number above zero, or None for no limit."""
    if value is None:
        return None
    return positive(owner, "rate", value, "Leave it None for a command without rate limit.")


def side(owner: str, name: str, value: int) -> int:
    """Return +1 or -1, or raise."""
    if value not in (1, -1):
        raise ModelError(f"{owner} has {name} {value!r}; it must be +1 or -1.")
    return int(value)


def numbers(owner: str, name: str, values: Numbers, *, at_least: int = 1) -> tuple[float, ...]:
    """Return a tuple of finite floats, or raise."""
    array = np.asarray(values, dtype=float)
    if array.ndim != 1 or len(array) < at_least:
        raise ModelError(
            f"{owner} has {name} of shape {array.shape}; give a sequence of at least "
            f"{at_least} number(s)."
        )
    if not np.all(np.isfinite(array)):
        where = int(np.flatnonzero(~np.isfinite(array))[0])
        raise ModelError(
            f"{owner} has {array[where]} at position {where} of {name}. A command needs a value "
            "everywhere: fill or cut the gap first."
        )
    return tuple(array.tolist())


def increasing(owner: str, name: str, values: tuple[float, ...]) -> tuple[float, ...]:
    """Return the values, or raise if they are not strictly increasing."""
    steps = np.diff(values)
    if np.any(steps <= 0):
        where = int(np.flatnonzero(steps <= 0)[0])
        raise ModelError(
            f"{owner} has {name} that do not increase: {values[where]:g} is followed by "
            f"{values[where + 1]:g} at position {where + 1}. Sort them and remove repetitions."
        )
    return values


def choice(owner: str, name: str, value: str, options: tuple[str, ...]) -> str:
    """Return the value, or raise if it is none of the options."""
    if value not in options:
        raise ModelError(f"{owner} has {name} {value!r}. Choose one of {', '.join(options)}.")
    return value


def feedback(owner: str, signals: Sequence[str], more: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the measured signals that a manoeuvre reacts to: one, and what ``more`` says."""
    names = (signals,) if isinstance(signals, str) else tuple(signals)
    if len(names) != 1 + len(more) or not all(names):
        words = "".join(f", then {one}" for one in more)
        wanted = "exactly one measured signal" if not more else f"the attitude{words}"
        raise ModelError(
            f"{owner} has feedback {names!r}; it reacts to {wanted}, for instance "
            f"{('psi', 'r', 'y')[: 1 + len(more)] if more else 'psi'!r}."
        )
    return names
