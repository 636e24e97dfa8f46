"""Where shooting begins: cutting records and guessing states from measurements."""

from __future__ import annotations

import numpy as np

from oed_sysid.dataset import Dataset, Record
from oed_sysid.errors import DataError, ModelError
from oed_sysid.kernels import Kernel
from oed_sysid.model import Model

# Longest interval by default: over more samples a wrong model runs far from the
# measurements, and iterations grow with the record.
MOST_SAMPLES = 100


def check_channels(model: Model, dataset: Dataset) -> None:
    """Raise :class:`DataError` where records and model name different signals."""
    if isinstance(dataset, Record):
        raise DataError("Expected a dataset, got a single record. Write Dataset((record,)).")
    for record in dataset:
        if record.channels.input_names != model.input_names:
            raise DataError(
                f"Record {record.name!r} has inputs {record.channels.input_names}, model "
                f"{model.name!r} expects {model.input_names}. Read it with the model's channels."
            )
        if record.channels.output_names != model.output_names:
            raise DataError(
                f"Record {record.name!r} has outputs {record.channels.output_names}, model "
                f"{model.name!r} expects {model.output_names}. Read it with the model's channels."
            )


def cut(record: Record, interval: float | None) -> np.ndarray:
    """Index of the first sample of each shooting interval."""
    n = len(record.times)
    if interval is None:
        length = min(max(5, int(np.ceil(n / 30))), MOST_SAMPLES)
        return np.arange(0, max(n - length // 2, 1), length, dtype=np.intc)
    if not interval > 0:
        raise ModelError(f"Shooting interval is {interval} s. Give a positive length.")
    if not np.isfinite(interval):
        return np.zeros(1, dtype=np.intc)
    edges = np.arange(record.times[0], record.times[-1], interval)
    starts = np.unique(np.searchsorted(record.times, edges - 1e-9))
    keep = [0]
    for start in starts[1:]:
        if start - keep[-1] >= 2 and n - start >= 2:
            keep.append(int(start))
    return np.array(keep, dtype=np.intc)


def measured_columns(model: Model) -> dict[int, int]:
    """Map the position of every state that is measured directly to its output."""
    return {
        model.state_names.index(output.source): column
        for column, output in enumerate(model.outputs)
        if output.source in model.state_names
    }


def measured_states(model: Model, record: Record) -> dict[int, np.ndarray]:
    """Smoothed series of every state that an output measures directly."""
    result: dict[int, np.ndarray] = {}
    for state, column in measured_columns(model).items():
        series = record.outputs[:, column]
        present = np.isfinite(series)
        if present.sum() < 2:
            continue
        filled = np.interp(record.times, record.times[present], series[present])
        result[state] = smooth(filled)
    return result


def smooth(series: np.ndarray) -> np.ndarray:
    """Average over five samples, with straight-line ends."""
    if len(series) < 10:
        return series
    padded = np.concatenate(
        [2 * series[0] - series[2:0:-1], series, 2 * series[-1] - series[-2:-4:-1]]
    )
    return np.convolve(padded, np.full(5, 0.2), mode="valid")


def state_series(
    kernel: Kernel,
    record: Record,
    values: np.ndarray,
    z0: np.ndarray,
    scale: np.ndarray,
    measured: dict[int, np.ndarray],
) -> np.ndarray:
    """Guess of the full state at every sample.

    Measured states follow their measurement; the others are simulated from
    them, in short pieces, so that wild parameters cannot carry them far.

    Parameters
    ----------
    kernel : Kernel
        Of the model.
    record : Record
        What was measured.
    values : ndarray (n_parameters,)
        All parameter values.
    z0 : ndarray (n_full,)
        Full state at the first sample.
    scale : ndarray (n_full,)
        Typical magnitudes of the full state.
    measured : dict
        As :func:`measured_states` returns it.

    Returns
    -------
    ndarray (n_times, n_full)
    """
    n = len(record.times)
    series = np.empty((n, len(z0)))
    if len(measured) < len(z0):
        starts = cut(record, None)
        z = z0
        for first, stop in zip(starts, [*starts[1:], n - 1], strict=True):
            part = slice(first, stop + 1)
            run = kernel.run(record.times[part], record.inputs[part], values, z)
            # A wild start value must not carry nonsense from piece to piece.
            tame = np.abs(run.states) < 1e3 * (1 + np.abs(z) + scale)
            series[part] = np.where(tame, run.states, z)
            z = series[stop].copy()
            for state, column in measured.items():
                z[state] = column[stop]
    for state, column in measured.items():
        series[1:, state] = column[1:]
    series[0] = z0
    return series
