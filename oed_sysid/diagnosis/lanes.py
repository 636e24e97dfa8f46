"""Innovations of the same residuals under several noise models at once.

The search for noise levels differentiates the likelihood by every level. The
filters that this takes differ in their levels only, so they run side by side
in the lanes of the processor's vector unit.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files

import numpy as np

from oed_sysid.compiled.compile import call, load_source
from oed_sysid.noise.kalman import (
    Deviations,
    Innovations,
    Job,
    NoiseModel,
    innovations,
    memories,
    pool,
)

# Noise models filtered together: as many numbers as fit into one wide register.
LANES = 8


def innovations_by_model(
    models: Sequence[NoiseModel], records: Sequence[Deviations], series: Sequence[np.ndarray]
) -> list[list[Innovations]]:
    """Filter the residuals of several records under several noise models.

    Parameters
    ----------
    models : sequence of NoiseModel
        With the same correlation times.
    records : sequence of Deviations
    series : sequence of ndarray (n_times, n_outputs, 1)
        Residuals of each record; entries not measured are ignored.

    Returns
    -------
    list of list of Innovations
        For each model, one for each record.
    """
    coloured = any(model.has_colour for model in models)
    alone = len(models) < 3 or all(model.is_white for model in models)
    library = None if alone else _library(*_sizes(records[0]), int(coloured))
    if library is None:
        jobs: list[Job] = [
            (model, record, column)
            for model in models
            for record, column in zip(records, series, strict=True)
        ]
        found = innovations(jobs)
        count = len(records)
        return [found[i * count : (i + 1) * count] for i in range(len(models))]
    batches = [models[first : first + LANES] for first in range(0, len(models), LANES)]
    tasks = [(batch, r, s) for batch in batches for r, s in zip(records, series, strict=True)]
    parts = list(pool().map(lambda task: _filter(library, *task), tasks))
    n_records = len(records)
    return [
        [parts[batch * n_records + index][lane] for index in range(n_records)]
        for batch, members in enumerate(batches)
        for lane in range(len(members))
    ]


def _filter(
    library: ctypes.CDLL, models: Sequence[NoiseModel], record: Deviations, column: np.ndarray
) -> list[Innovations]:
    """Filter one record under at most :data:`LANES` models."""
    rows = [*models, *[models[-1]] * (LANES - len(models))]
    force_memory, colour_memory = memories(models[0], record)
    seen = record.present > 0
    white = np.empty((*seen.shape, LANES))
    roots = np.empty_like(white)
    broken = call(
        library.innovations_lanes,
        seen.shape[:1],
        record.transition,
        record.force_gain,
        record.output,
        record.present,
        np.where(seen, column[:, :, 0], 0.0),
        np.stack([model.force**2 for model in rows], axis=1),
        force_memory,
        np.stack([model.colour**2 for model in rows], axis=1),
        colour_memory,
        np.stack([model.white**2 for model in rows], axis=1),
        white,
        roots,
    )
    if broken:  # in some lane: which one, only filters of their own can tell
        return [innovations([(model, record, column)])[0] for model in models]
    return [
        Innovations(np.ascontiguousarray(white[:, :, lane, None]), roots[:, :, lane].copy())
        for lane in range(len(models))
    ]


def _sizes(record: Deviations) -> tuple[int, int, int]:
    n_outputs, n_states = record.output.shape[1:]
    return n_states, record.force_gain.shape[2], n_outputs


@lru_cache(maxsize=32)
def _library(n_states: int, n_forces: int, n_outputs: int, colour: int) -> ctypes.CDLL | None:
    sizes = {"NX": n_states, "NF": n_forces, "NY": n_outputs, "COLOUR": colour, "LANES": LANES}
    return load_source(
        "-".join(["innovations_lanes", *map(str, sizes.values())]),
        lambda: files("oed_sysid.compiled").joinpath("innovations_lanes.c").read_text(),
        what="the filter of linear deviations under many noise models",
        flags=tuple(f"-D{name}={size}" for name, size in sizes.items()),
    )
