"""The amplitude of an effect: the parameter whose zero means that the effect is absent."""

from __future__ import annotations

import math

from oed_sysid.parameters import Parameter

_SPAN = 20.0  # bounds, in typical amplitudes: wide enough to never decide, tight enough to converge


def amplitude(
    effect: str,
    unit: str,
    *,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
    positive: bool = False,
    bound: float = math.inf,
    per_record: bool = False,
    description: str = "",
) -> Parameter:
    """Parameter that measures an effect's size.

    Parameters
    ----------
    effect : str
        Name of the effect; the parameter is called ``"E_" + effect``.
    unit : str
        SI unit.
    scale : float, optional
        Typical amplitude, in ``unit``; by default the size of ``value``, or 1.
    value : float
        Present value; zero is absent.
    parameter : str, optional
        Another name.
    positive : bool
        Whether the amplitude cannot be negative, as a delay cannot.
    bound : float
        Largest magnitude that makes sense, where it is less than twenty scales.
    per_record : bool
        Whether the value differs from record to record.
    description : str
        What the parameter means.

    Examples
    --------
    >>> lag = amplitude("fin_lag", "s", scale=0.25, positive=True)
    >>> lag.name, lag.lower, lag.upper
    ('E_fin_lag', 0.0, 5.0)
    """
    size = abs(value) or 1.0 if scale is None else scale
    limit = min(_SPAN * max(size, abs(value)), bound)
    return Parameter(
        name=parameter or f"E_{effect}",
        value=value,
        unit=unit,
        lower=0.0 if positive else -limit,
        upper=limit,
        scale=size,
        per_record=per_record,
        description=description,
    )
