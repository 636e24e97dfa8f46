r"""Whether two records hold the same measurement, whatever they are called.

Measurement noise is a fingerprint: two runs of the same manoeuvre never share
it, a copy always does. Record :math:`b` is taken for (a part of) record
:math:`a` if there is one shift :math:`d` of time with

.. math:: y_b(t_i) = y_a(t_i + d) \quad \text{for nearly all } i
          \text{ with a sample of } a \text{ at } t_i + d,

for every output that both have. The shift is voted for: each of a few rows of
one record is looked up among all rows of the other, and every match proposes a
shift. Copies under other names, with another clock, thinned, cut, or written
to a file in other units are found; equality is judged to the digits that a file
keeps. Rows where nothing moves prove nothing and do not count. Smooth records
(simulated without noise) may share a beginning, so there half of the shorter
record has to agree, with every input.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.errors import DataError

# Of the span of a signal: what conversions of units and decimal digits leave different,
# and what rounding to four digits does.
EXACT, ROUNDED = 1e-8, 2e-4
# Share of the span above which what a cubic does not explain is noise: it tells copies apart.
NOISE_EXACT, NOISE_ROUNDED = 1e-6, 1e-3
# Rows that have to agree, of those that have a partner, and as a part of the shorter record.
N_ROWS, AGREEING, PART = 10, 0.9, 0.5
# Without noise, or with noise below the last digit of a coarse sensor, only this is a copy.
AGREEING_SMOOTH = 0.995
_N_ANCHORS, _N_SHIFTS = 32, 6
# Times are the same within this part of a sampling interval.
_CLOCK = 0.02


@dataclass(frozen=True)
class Overlap:
    """What two records have in common.

    Parameters
    ----------
    n_equal : int
        Rows of the second record that the first holds too, among those that move.
    n_rows : int
        Rows of the second record with a partner, among those that move.
    shift : float
        Time of the first record minus that of the second, s.
    """

    n_equal: int
    n_rows: int
    shift: float


def check_disjoint(train: Iterable[Record], validation: Iterable[Record]) -> None:
    """Refuse validation records that are, or are part of, training records.

    Parameters
    ----------
    train, validation : Dataset or iterable of Record
        What is learnt from, and what is judged with; equal channels.

    Raises
    ------
    DataError
        If two of them hold the same measurement; the message names both.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Channels, Output
    >>> channels = Channels((), (Output("r", "rad/s"),))
    >>> rng = np.random.default_rng(0)
    >>> t = np.arange(50.0)
    >>> run, again = (
    ...     Record(name, t, [], np.sin(0.1 * t) + 0.01 * rng.standard_normal(50), channels)
    ...     for name in ("run", "again")
    ... )
    >>> check_disjoint([run], [again])
    >>> check_disjoint([run], [again, run.thin(2).rename("other")])
    Traceback (most recent call last):
    oed_sysid.errors.DataError: Validation record 'other' is training record 'run': 24 of its 25 \
    rows are the same. What was learnt from cannot judge; give records of other runs, or divide \
    with dataset.split().
    """
    train = tuple(train)
    for judged in validation:
        for known in train:
            found = overlap(known, judged)
            if found is not None:
                raise DataError(_words(known, judged, found))


def _words(known: Record, judged: Record, found: Overlap) -> str:
    clock = f", {abs(found.shift):.6g} s {'later' if found.shift > 0 else 'earlier'} there"
    moved = clock if abs(found.shift) > 0.5 * judged.sample_time else ""
    return (
        f"Validation record {judged.name!r} is training record {known.name!r}: {found.n_equal} of "
        f"its {judged.n_samples} rows are the same{moved}. What was learnt from cannot judge; give "
        "records of other runs, or divide with dataset.split()."
    )


def overlap(a: Record, b: Record) -> Overlap | None:
    """Return what two records have in common; None if they are different measurements.

    Parameters
    ----------
    a, b : Record
        Of equal channels.
    """
    if a.content_hash == b.content_hash:
        return Overlap(b.n_samples, b.n_samples, 0.0)
    if a.outputs.shape[1] != b.outputs.shape[1] or a.inputs.shape[1] != b.inputs.shape[1]:
        return None
    span = _span(np.vstack([a.outputs, b.outputs]))
    noise = np.maximum(_noise(a.outputs, span), _noise(b.outputs, span))
    for tolerance, needed, share in (
        (EXACT, NOISE_EXACT, 0.0),
        (ROUNDED, NOISE_ROUNDED, PART),
        (EXACT, None, PART),
    ):
        if needed is not None and not noise > needed:
            continue
        smooth = needed is None
        for shift in _shifts(a, b, span, tolerance):
            found = _compared(a, b, shift, span, tolerance, with_inputs=smooth)
            if found is not None and found.n_rows >= share * min(_moving(a), _moving(b)):
                return found
    return None


def _span(signals: np.ndarray) -> np.ndarray:
    """Largest minus smallest value of each signal, shape ``(n_signals,)``; 0 if constant."""
    finite = np.where(np.isfinite(signals), signals, np.nan)
    seen = np.isfinite(finite).any(axis=0)
    filled = np.where(seen, finite, 0.0)
    span = np.nanmax(filled, axis=0) - np.nanmin(filled, axis=0)
    # A heading of 350 deg that moves by one has lost digits to its size.
    size = np.nanmax(np.abs(filled), axis=0)
    return np.asarray(np.maximum(span, 1e-6 * size))


def _noise(outputs: np.ndarray, span: np.ndarray) -> float:
    """Largest noise of the outputs as a share of their span, from third differences."""
    levels = [0.0]
    for signal, width in zip(outputs.T, span, strict=True):
        present = signal[np.isfinite(signal)]
        if present.size > 7 and width > 0 and np.unique(present).size > present.size // 2:
            # The variance of a third difference of white noise is 20 times its own.
            levels.append(float(np.median(np.abs(np.diff(present, 3))) / np.sqrt(20) / width))
    return max(levels)


def _moves(record: Record) -> np.ndarray:
    """Rows with a measured output that differs from its last value, ``(n_samples,)`` of bool."""
    moves = np.zeros(record.n_samples, dtype=bool)
    for signal in record.outputs.T:
        rows = np.flatnonzero(np.isfinite(signal))
        moves[rows[1:]] |= np.diff(signal[rows]) != 0.0
    return moves


def _moving(record: Record) -> int:
    return int(_moves(record).sum())


def _shifts(a: Record, b: Record, span: np.ndarray, tolerance: float) -> list[float]:
    """Shifts that most of the anchors vote for."""
    votes: list[float] = []
    for one, other, sign in ((a, b, 1.0), (b, a, -1.0)):
        # Rows with most outputs first: they say most.
        moving = np.flatnonzero(_moves(other))
        if not moving.size:
            return []
        count = np.isfinite(other.outputs[moving]).sum(axis=1)
        best = moving[count == count.max()]
        anchors = best[np.unique(np.linspace(0, best.size - 1, _N_ANCHORS).astype(int))]
        for row in anchors:
            measured = np.isfinite(other.outputs[row])
            near = np.abs(one.outputs[:, measured] - other.outputs[row, measured])
            matches = np.flatnonzero(np.all(near <= tolerance * span[measured], axis=1))
            if matches.size <= 50:
                votes += (sign * (one.times[matches] - other.times[row])).tolist()
    if not votes:
        return []
    step = max(_CLOCK * min(a.sample_time, b.sample_time), 1e-12)
    found = np.array(votes)
    bins, first, counts = np.unique(np.round(found / step), return_index=True, return_counts=True)
    order = np.argsort(-counts, kind="stable")[:_N_SHIFTS]
    return [float(found[first[i]]) for i in order if bins.size]


def _compared(
    a: Record, b: Record, shift: float, span: np.ndarray, tolerance: float, *, with_inputs: bool
) -> Overlap | None:
    """Compare all rows at one shift; None if they are not the same."""
    wanted = b.times + shift
    right = np.clip(np.searchsorted(a.times, wanted), 1, a.n_samples - 1)
    nearer = np.abs(a.times[right] - wanted) < np.abs(a.times[right - 1] - wanted)
    partner = np.where(nearer, right, right - 1)
    clock = _CLOCK * min(a.sample_time, b.sample_time)
    first, second = a.outputs[partner], b.outputs
    both = np.isfinite(first) & np.isfinite(second)
    compared = (np.abs(a.times[partner] - wanted) <= clock) & both.any(axis=1) & _moves(b)
    with np.errstate(invalid="ignore"):
        equal = np.all(~both | (np.abs(first - second) <= tolerance * span), axis=1)
    if with_inputs and b.inputs.shape[1]:
        width = _span(np.vstack([a.inputs, b.inputs]))
        equal &= np.all(np.abs(a.inputs[partner] - b.inputs) <= tolerance * width, axis=1)
    equal &= compared
    n_rows, n_equal = int(compared.sum()), int(equal.sum())
    safe = np.where(span > 0, span, 1.0)
    different = np.unique(np.round(np.where(both, second, 0.0)[equal] / safe, 7), axis=0)
    needed = min(N_ROWS, max(4, min(_moving(a), _moving(b)) // 2))
    share = AGREEING_SMOOTH if with_inputs else AGREEING
    if n_rows and n_equal >= share * n_rows and len(different) >= needed:
        return Overlap(n_equal, n_rows, shift)
    return None


def together(train: Dataset, validation: Dataset) -> Dataset:
    """All records; validation records that are called as training records say what they are.

    Parameters
    ----------
    train, validation : Dataset
        With the same channels.

    Returns
    -------
    Dataset
        The training records first.
    """
    taken = set(train.names)
    others = [
        replace(record, name=f"{record.name} (validation)") if record.name in taken else record
        for record in validation
    ]
    return Dataset((*train, *others))
