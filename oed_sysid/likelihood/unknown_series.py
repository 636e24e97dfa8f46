"""Estimated series of unknown inputs, read off a fit; see :mod:`oed_sysid.physics.unknown`."""

from __future__ import annotations

import re

import numpy as np

from oed_sysid.errors import DataError
from oed_sysid.likelihood.fit import Fit


def unknown_series(fit: Fit, effect: str) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Times and values of the nodes of an unknown input, one pair for each record.

    Parameters
    ----------
    fit : Fit
        Of a model with :func:`~oed_sysid.physics.unknown.UnknownInput` or
        :func:`~oed_sysid.physics.unknown.UnknownForce`.
    effect : str
        Name of the effect, for instance ``"unknown_input_rudder"``.

    Returns
    -------
    tuple of (times (n_nodes,), values (n_nodes,))
        In s as in the record, and in the unit of the signal; linear in between.

    Raises
    ------
    DataError
        If the model has no such effect.
    """
    found = next((one for one in fit.model.effects if one.name == effect), None)
    spacing = None if found is None else re.search(r"/([\d.e+-]+)$", found.definitions["node"])
    if found is None or spacing is None:
        names = [e.name for e in fit.model.effects if e.name.startswith("unknown_")]
        raise DataError(
            f"The fit has no unknown input {effect!r}. It has {', '.join(names) or 'none'}."
        )
    names = [parameter.name for parameter in found.parameters]
    steps = np.arange(len(names)) * float(spacing[1])
    values = fit.model.values
    return tuple(
        (record.times[0] + steps, np.cumsum([local.get(n, values[n]) for n in names]))
        for record, local in zip(fit.dataset, fit.local_values, strict=True)
    )
