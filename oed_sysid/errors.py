"""Errors: every message names what was expected, what was got and what to do.

A solver that does not converge is not an error but a status (see
:mod:`oed_sysid.likelihood.fit`); errors are for input that cannot be worked with.
"""

from __future__ import annotations


class OedSysidError(ValueError):
    """Base class of all errors raised on purpose by this package."""


class DataError(OedSysidError):
    """A measured record cannot be used as it is."""


class FileError(OedSysidError):
    """A file cannot be written, or not be trusted."""


class ModelError(OedSysidError):
    """A model, effect or expression is inconsistent."""


class ProblemError(OedSysidError):
    """A problem folder cannot be found or does not fulfil its contract."""


class SimulationError(OedSysidError):
    """A trajectory left the numbers (overflow or NaN) before its end."""


class DesignError(OedSysidError):
    """An experiment cannot be designed within the limits that were given."""


class UnitWarning(UserWarning):
    """A unit, of the time or of a signal, that is most likely not that of the numbers."""


class PrecisionWarning(UserWarning):
    """A calculation has lost so many digits to rounding that its result is not to be trusted."""
