"""Copies of records in which some outputs are others, and records of a problem's experiments."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from oed_sysid import Dataset, Experiment, Model, Record, simulate


def altered(
    data: Dataset, *numbers: int, **outputs: np.ndarray | Callable[[Record], np.ndarray]
) -> Dataset:
    """Copies of records; in those of the numbers, or in all, outputs are others.

    Each is given as an array, or as a function of the record.
    """
    records = list(data)
    for k in numbers or range(len(records)):
        columns = dict(zip(data.channels.output_names, records[k].outputs.T, strict=True))
        for name, new in outputs.items():
            columns[name] = new(records[k]) if callable(new) else new
        records[k] = records[k].with_outputs(np.column_stack(list(columns.values())))
    return Dataset(records)


def with_outputs(data: Iterable[Record], of: Callable[[Record], np.ndarray]) -> Dataset:
    """Copies of records whose outputs are others, of each a function of the record."""
    return Dataset(record.with_outputs(of(record)) for record in data)


def with_inputs(data: Iterable[Record], of: Callable[[Record], np.ndarray]) -> Dataset:
    """The same of their inputs."""
    return Dataset(replace(record, inputs=of(record)) for record in data)


def trials(
    model: Model, runs: Iterable[Experiment], rng: np.random.Generator | int | tuple[int, ...]
) -> Dataset:
    """Records of experiments, simulated with noise.

    One generator draws for all, or one for each, whose seeds begin with a tuple.
    """
    one = None if isinstance(rng, tuple) else np.random.default_rng(rng)
    return Dataset(
        simulate(model, run, rng=one or np.random.default_rng((*rng, k)))
        for k, run in enumerate(runs)
    )


def overwritten(data: Dataset, number: int, where: object, value: object) -> Dataset:
    """Copies of records; samples of the outputs of one of them, and no others, have a value."""
    records = list(data)
    outputs = records[number].outputs.copy()
    outputs[where] = value
    records[number] = records[number].with_outputs(outputs)
    return Dataset(records)


def part(record: Record, rows: object) -> Record:
    """Some rows of a record."""
    columns = {name: getattr(record, name)[rows] for name in ("times", "inputs", "outputs")}
    return replace(record, **columns)
