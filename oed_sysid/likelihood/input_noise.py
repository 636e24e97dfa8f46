r"""White noise in the log of an input: how much, and what is left when it is smoothed.

The level is that of third differences, which hardly see a command; it is noise where fourth
differences say the same,

.. math:: \sigma^2 = \operatorname{median}(\Delta^3 u)^2 \,/\, (0.4549 \cdot 20).

A sigma filter (Lee 1983, *Comput. Vision Graph. Image Process.* 24, 255) averages each sample
with those neighbours that differ from it by no more than chance: jumps stay where they are, and
slopes are kept where there are as many before as after. What a vehicle answers to is the slow
part of the noise, and only many rounds take that from a command that is held.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from oed_sysid.data.dataset import Dataset

# White noise of a logged input, as a share of its spread: above, it is an excitation.
INPUT_SHARE = (1e-5, 0.3)
# Level of fourth differences over that of third ones, from which these are noise.
FLAT = 0.85
# Neighbours on each side, largest difference in levels, and rounds of the sigma filter.
NEIGHBOURS, WITHIN, ROUNDS = 10, 4.0, 25


def fast_level(parts: Sequence[np.ndarray]) -> float:
    """Level of white noise with third differences as large as these; NaN without any.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> held = np.repeat([0.0, 0.3, -0.3], 200)
    >>> round(fast_level([held + 0.01 * rng.standard_normal(600)]), 3)
    0.01
    """
    pooled = [np.diff(part[np.isfinite(part)], 3) ** 2 for part in parts]
    differences = np.concatenate(pooled)
    return float(np.sqrt(np.median(differences) / 0.4549 / 20.0)) if len(differences) else np.nan


def is_noise(parts: Sequence[np.ndarray]) -> bool:
    """Whether the level of differences no longer falls from the third to the fourth order."""
    fourth = np.concatenate([np.diff(values, 4) ** 2 for values in parts])
    third = fast_level(parts)
    if not len(fourth) or not third > 0:
        return False
    return bool(np.sqrt(np.median(fourth) / 0.4549 / 70.0) > FLAT * third)


def shown_in_log(dataset: Dataset, name: str) -> float:
    """Level of white noise that would wiggle as fast as the log of an input does, in its unit.

    An upper limit: a command that changes from sample to sample wiggles, too. Infinite where no
    input has that name, or where records are too short to tell.

    Parameters
    ----------
    dataset : Dataset
    name : str
    """
    names = [channel.name for channel in dataset[0].channels.inputs]
    if name not in names:
        return float("inf")
    column = names.index(name)
    level = fast_level([record.inputs[:, column] for record in dataset])
    return level if np.isfinite(level) else float("inf")


def noisy_inputs(dataset: Dataset) -> dict[str, float]:
    """Level of the white noise of every input whose log shows some, in its unit.

    Parameters
    ----------
    dataset : Dataset
    """
    found = {}
    for column, name in enumerate(channel.name for channel in dataset[0].channels.inputs):
        series = [record.inputs[:, column] for record in dataset if not record.independent]
        if not series:
            continue
        level = fast_level(series)
        spread = float(np.std(np.concatenate(series)))
        low, high = INPUT_SHARE
        if spread > 0 and low * spread < level < high * spread and is_noise(series):
            found[name] = level
    return found


def smoothed(dataset: Dataset, levels: Mapping[str, float]) -> Dataset:
    """Records with some inputs smoothed, jumps and slopes kept.

    Parameters
    ----------
    dataset : Dataset
    levels : mapping of str to float
        Level of the noise of the inputs to smooth, in their units.
    """
    names = [channel.name for channel in dataset[0].channels.inputs]
    records = []
    for record in dataset:
        inputs = record.inputs.copy()
        for name, level in levels.items():
            column = names.index(name)
            inputs[:, column] = sigma_filter(inputs[:, column], level)
        records.append(replace(record, inputs=inputs))
    return Dataset(tuple(records))


def sigma_filter(series: np.ndarray, level: float) -> np.ndarray:
    """Mean of each sample and those of its neighbours that differ by no more than chance.

    Parameters
    ----------
    series : ndarray (n_samples,)
    level : float
        Standard deviation of the noise.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> held = np.repeat([0.0, 0.3], 200)
    >>> left = sigma_filter(held + 0.01 * rng.standard_normal(400), 0.01) - held
    >>> float(np.std(left)) < 0.004
    True
    """
    result = np.array(series, dtype=float)
    n, limit = len(result), WITHIN * level
    for _ in range(ROUNDS):
        total, count = result.copy(), np.ones(n)
        for away in range(1, min(NEIGHBOURS, n - 1) + 1):
            early, late = result[:-away], result[away:]
            near = np.abs(late - early) < limit
            total[:-away] += np.where(near, late, 0.0)
            total[away:] += np.where(near, early, 0.0)
            count[:-away] += near
            count[away:] += near
        result = total / count
        limit = WITHIN * level / np.sqrt(2.0 * NEIGHBOURS + 1.0)
    return result
