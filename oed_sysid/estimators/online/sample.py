"""One sample of a running vehicle, checked before it is learnt from."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.model import Model


def read_sample(
    model: Model,
    time: float,
    sample: Mapping[str, float],
    *,
    after: float | None,
    anew: str,
) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and outputs of a sample, in the model's order; a missing output is NaN.

    Parameters
    ----------
    model : Model
    time : float
        Time of the sample, s.
    sample : mapping of str to float
        Commands and measured outputs by name.
    after : float or None
        Time of the sample before, s.
    anew : str
        What to do for a new run, for the message.

    Raises
    ------
    ModelError
        If an input is missing, or the sample is not later than the one before.
    """
    missing = [name for name in model.input_names if name not in sample]
    if missing:
        raise ModelError(
            f"The sample at t = {time:g} s has no {', '.join(missing)}. Every input is needed."
        )
    if after is not None and not time > after:
        raise ModelError(
            f"The sample at t = {time:g} s is not later than the one before, at {after:g} s. {anew}"
        )
    inputs = np.array([sample[name] for name in model.input_names], dtype=float)
    return inputs, np.array([sample.get(name, np.nan) for name in model.output_names])
