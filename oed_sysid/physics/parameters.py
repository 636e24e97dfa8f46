"""Parameters: value, unit, bounds and prior knowledge of one number of a model."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.physics.channels import SAYS, check_signal

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Part = TypeVar("Part", bound="DataclassInstance")


@dataclass(frozen=True)
class Parameter:
    """One number of a model.

    Parameters
    ----------
    name : str
        SNAME-style name, for instance ``"Z_uw"``.
    value : float
        Present value, in ``unit``.
    unit : str
        SI unit.
    lower, upper : float
        Bounds that an estimate must respect.
    prior_mean, prior_std : float or None
        What is known before the data, as a normal distribution; ``None``
        means that nothing is known.
    fixed : bool
        A fixed parameter is never estimated.
    scale : float or None
        Typical magnitude; ``None`` takes it from the value, the prior or the
        bounds, or else 1. It conditions the numerics and never changes an estimate; one that
        ends 1e8 times beyond it is said to have run away.
    per_record : bool
        The value differs from record to record (a sensor bias set at
        switch-on, the phase of a wave).
    description : str
        What the parameter means, with its source.
    log : bool
        A positive number that may be wrong by a factor: it is estimated as its
        logarithm. ``prior_std`` is then relative (0.1 is ten per cent), and 95 %
        intervals are log-normal.

    Examples
    --------
    >>> Parameter("Z_uw", -40.0, "kg/m", prior_mean=-40.0, prior_std=4.0).magnitude
    40.0
    """

    name: str
    value: float
    unit: str = ""
    lower: float = -math.inf
    upper: float = math.inf
    prior_mean: float | None = None
    prior_std: float | None = None
    fixed: bool = False
    scale: float | None = None
    per_record: bool = False
    description: str = ""
    log: bool = False

    def __post_init__(self) -> None:
        check_signal("Parameter", self.name, self.unit)
        self._check_types()
        if self.log:
            self._check_log()
        if self.lower > self.upper:
            raise ModelError(SAYS["bounds_swapped"].format(self))
        if not self.lower <= self.value <= self.upper:
            raise ModelError(SAYS["value_outside"].format(self))
        if self.prior_std is not None and self.prior_mean is None:
            object.__setattr__(self, "prior_mean", self.value)
        if self.prior_mean is not None and not self.lower <= self.prior_mean <= self.upper:
            raise ModelError(SAYS["prior_outside"].format(self))

    def _check_types(self) -> None:
        """Refuse what is no number, or none of the size that its name asks for."""
        who = f"Parameter {self.name!r}"
        for field in ("value", "lower", "upper", "prior_mean", "prior_std", "scale"):
            given = getattr(self, field)
            if given is not None or field in ("value", "lower", "upper"):
                _check_number(who, field, given)
        for field in ("fixed", "log", "per_record"):
            given = getattr(self, field)
            if not isinstance(given, bool | np.bool_):
                raise ModelError(f"{who} has {field} {given!r:.40}. Expected True or False.")
        if self.prior_std is not None and not 0 < self.prior_std < math.inf:
            raise ModelError(SAYS["prior_std"].format(self, who=who))
        if self.scale is not None and not self.scale > 0:
            raise ModelError(f"{who} has scale {self.scale}. Give a positive one.")

    def _check_log(self) -> None:
        if self.lower == -math.inf:
            object.__setattr__(self, "lower", 0.0)
        smallest = min(self.value, math.inf if self.prior_mean is None else self.prior_mean)
        if not smallest > 0 or self.lower < 0:
            raise ModelError(SAYS["log_of_none"].format(self))

    @property
    def prior_spread(self) -> float | None:
        """Standard deviation of the prior in the parameter's own unit."""
        if not self.log or self.prior_std is None or self.prior_mean is None:
            return self.prior_std
        return self.prior_std * self.prior_mean

    @property
    def magnitude(self) -> float:
        """Typical size, used for scaling; always positive."""
        if self.scale is not None:
            return self.scale
        for candidate in (self.value, self.prior_mean, self.prior_spread):
            if candidate:
                return abs(candidate)
        finite = [abs(bound) for bound in (self.lower, self.upper) if math.isfinite(bound)]
        return max(finite, default=1.0) or 1.0

    @property
    def reference(self) -> float:
        """What makes an error relative: the absolute value, or the magnitude of a zero."""
        return abs(self.value) or self.magnitude

    def with_value(self, value: float) -> Parameter:
        """Return the same parameter at another value; the prior stays."""
        same = isinstance(self.value, float) and value == self.value
        return self if same else replace(self, value=float(value))


def about_zero(name: str, unit: str, std: float, description: str) -> Parameter:
    """A number of each record that is normal about zero, with this standard deviation."""
    known: dict[str, Any] = {"prior_mean": 0.0, "prior_std": std, "scale": std}
    return Parameter(name, 0.0, unit, per_record=True, description=description, **known)


def _check_number(who: str, field: str, given: Any) -> None:
    """Refuse what is no number; only bounds may be infinite. Sizes are judged by their sign."""
    if isinstance(given, bool) or not isinstance(given, int | float | np.number):
        raise ModelError(f"{who} has {field} {given!r:.40}. Expected a number.")
    if math.isnan(given) and field in ("value", "lower", "upper"):
        raise ModelError(f"{who} has {field} NaN. Give a number.")
    if field in ("value", "prior_mean") and not math.isfinite(given):
        raise ModelError(f"{who} has {field} {given}. Give a number.")


def with_parameters(part: Part, parameters: tuple[Parameter, ...], **changes: Any) -> Part:
    """Return a model or effect with other parameters of the same names.

    What its constructor checks does not depend on their values, and takes a hundred times as long.
    """
    changes["parameters"] = parameters
    other = object.__new__(type(part))
    for field in fields(part):
        object.__setattr__(other, field.name, changes.get(field.name, getattr(part, field.name)))
    return other


def changed(
    part: Part, names: Collection[str], change: Callable[[Parameter], Parameter], **others: Any
) -> Part:
    """Return a model or effect with some of its own parameters changed."""
    own: tuple[Parameter, ...] = part.parameters  # type: ignore[attr-defined]
    return with_parameters(part, tuple(change(p) if p.name in names else p for p in own), **others)


def check_unique(parameters: tuple[Parameter, ...], *, owner: str) -> None:
    """Raise :class:`ModelError` if two parameters share a name."""
    seen: set[str] = set()
    for parameter in parameters:
        if parameter.name in seen:
            raise ModelError(SAYS["parameter_twice"].format(owner=owner, parameter=parameter))
        seen.add(parameter.name)
