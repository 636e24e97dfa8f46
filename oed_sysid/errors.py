"""Errors: every message names what was expected, what was got and what to do.

A solver that does not converge is not an error but a status (see
:mod:`oed_sysid.likelihood.fit`); errors are for input that cannot be worked with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from functools import wraps
from importlib import import_module
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


class OedSysidError(ValueError):
    """Base class of all errors raised on purpose by this package.

    Examples
    --------
    >>> try:
    ...     raise OedSysidError("Name a record.")
    ... except OedSysidError as error:
    ...     print(error)
    Name a record.
    """


class DataError(OedSysidError):
    """A measured record cannot be used as it is."""


class FileError(OedSysidError):
    """A file cannot be written, or not be trusted."""


class ModelError(OedSysidError):
    """A model, effect or expression is inconsistent."""


class ProblemError(OedSysidError):
    """A problem folder cannot be found or does not fulfil its contract."""


class SimulationError(OedSysidError):
    """A trajectory diverged (overflow or NaN) before its end."""


class DesignError(OedSysidError):
    """An experiment cannot be designed within the limits that were given."""


class UnitWarning(UserWarning):
    """A unit, of the time or of a signal, that is most likely not that of the numbers."""


class PrecisionWarning(UserWarning):
    """A calculation has lost so many digits to rounding that its result is not to be trusted."""


# -- names that there are not ----------------------------------------------------------


# Names that a message lists; of more it says how many.
_SHOWN = 30


def listed(names: Iterable[str], most: int = _SHOWN) -> str:
    """Names in a row, the first thirty of many, or ``most``.

    >>> listed(["psi", "r"]), listed([])
    ('psi, r', 'none')
    """
    every = tuple(names)
    rest = f" and {len(every) - most} more" if len(every) > most else ""
    return (", ".join(every[:most]) or "none") + rest


def closest(name: str, names: Iterable[str]) -> str:
    """Sentence that suggests the nearest name, empty if none is near."""
    # Letters that differ in size only are the nearest.
    known = {one.lower(): one for one in names}
    matches = get_close_matches(name.lower(), list(known), n=1)
    return f" Did you mean {known[matches[0]]!r}?" if matches else ""


def located(
    error: type[OedSysidError],
    lacking: str,
    names: Iterable[str],
    known: Iterable[str],
    advice: str = "",
) -> list[int]:
    """Positions of names among those that there are; an error about the first that is not there.

    Parameters
    ----------
    error : type
        Of the error.
    lacking : str
        Who has no such name, and what it would be.
    names, known : iterable of str
        What is asked for, and what there is.
    advice : str
        What to do, after what there is.

    Examples
    --------
    >>> located(DesignError, "Model 'ship' has no output", ["r"], ["psi", "r"])
    [1]
    >>> located(DesignError, "Model 'ship' has no output", ["rr"], ["psi", "r"])
    Traceback (most recent call last):
        ...
    oed_sysid.errors.DesignError: Model 'ship' has no output 'rr'. It has psi, r. Did you mean 'r'?
    """
    there = [*known]
    places = {name: index for index, name in reversed([*enumerate(there)])}
    for name in (wanted := [*names]):
        if name not in places:
            has = listed(map(str, there))
            near, said = closest(str(name), map(str, there)), f" {advice}" if advice else ""
            raise error(f"{lacking} {name!r}. It has {has}.{near}{said}")
    return [places[name] for name in wanted]


# -- libraries that need not be there ---------------------------------------------------


def library(
    name: str, what: str, *, extra: str = "logs", error: type[OedSysidError] = DataError
) -> ModuleType:
    """Import a module of an optional library, or say what to install.

    Parameters
    ----------
    name : str
        Module, for instance ``"pyulog"``.
    what : str
        What needs it, for the message.
    extra : str
        Extra of this package that brings it.
    error : type
        Of the error where it is not installed.

    Examples
    --------
    >>> library("json", "Reading JSON").__name__
    'json'
    >>> library("no_such_reader", "Reading a log of Nobody's")
    Traceback (most recent call last):
        ...
    oed_sysid.errors.DataError: Reading a log of Nobody's needs no_such_reader, which is not
    installed. Run  pip install "oed_sysid[logs]"  and repeat.
    """
    try:
        return import_module(name)
    except ImportError:
        raise error(
            f"{what} needs {name.partition('.')[0]}, which is not installed. Run  "
            f'pip install "oed_sysid[{extra}]"  and repeat.'
        ) from None


# -- old spellings ---------------------------------------------------------------------


def respelled(
    error: type[OedSysidError], table: Mapping[str, str]
) -> Callable[[Callable[_Arguments, _Result]], Callable[_Arguments, _Result]]:
    """Let a function raise an error that says the new spelling of arguments that are gone.

    Parameters
    ----------
    error : type
        Of the error.
    table : mapping of str to str
        Old argument, and what to write now.

    Examples
    --------
    >>> @respelled(DesignError, {"duration": "Trial(duration=...)"})
    ... def design(trial):
    ...     return trial
    >>> design(duration=60.0)
    Traceback (most recent call last):
        ...
    oed_sysid.errors.DesignError: design has no argument 'duration'. Write Trial(duration=...).
    """

    def decorated(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
        @wraps(function)
        def checked(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
            gone = [name for name in kwargs if name in table]
            if gone:
                write = "; ".join(dict.fromkeys(table[name] for name in gone))
                raise error(
                    f"{function.__qualname__.removesuffix('.__init__')} has no argument "
                    f"{', '.join(map(repr, gone))}. Write {write}."
                )
            return function(*args, **kwargs)

        return checked

    return decorated


def respelled_names(module: str, table: Mapping[str, str]) -> Callable[[str], Any]:
    """Return a module's ``__getattr__`` that says the new spelling of names that are gone.

    Parameters
    ----------
    module : str
    table : mapping of str to str
        Old name, and the new one.
    """

    def missing(name: str) -> Any:
        if name in table:
            raise AttributeError(f"{module}.{name} is {table[name]} now. Write {table[name]}.")
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return missing
