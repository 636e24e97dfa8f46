r"""A measured record: times, inputs and outputs as they were logged.

Nothing is resampled, filtered, shifted or repaired here. A sample that is
missing is NaN; a fault is an error that says where.

Angles that wrap: a compass that goes from 359 to 0 degrees has not turned back.

A heading is known up to full turns, and a log usually holds it within one of them,

.. math:: \psi_m = \psi - 2\pi\,k, \qquad k \in \mathbb{Z},

so that the logged series jumps by one period where the vehicle passes the cut. Differential
equations need the continuous angle: of all series that agree with the log up to full turns, the
one that never moves by more than half a turn between two samples. In a gap it may: there it is
the one that comes nearest to the rate on both sides, :math:`\Delta\psi \approx
\tfrac12(\dot\psi_- + \dot\psi_+)\Delta t`, if these agree well enough to tell.

Records that were sampled alike.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from oed_sysid.data import SAYS
from oed_sysid.errors import DataError, listed, located
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.runtime.constants import IMMATERIAL
from oed_sysid.runtime.display import as_html, counted

# -- angles that wrap ------------------------------------------------------------------


TURN = 2.0 * np.pi
# The period of a jump: 2 pi, or 360 where degrees passed as radians.
PERIODS = (TURN, 360.0)
# A jump is a clear wrap if what remains of it after adding the turn is this share of a turn;
# a signal that moves more than that between samples is too sparse to tell.
WRAP_SHARE = IMMATERIAL
# ... and is not faster than this multiple of what the signal does around it.
FASTER = 8.0
# A gap is so many usual steps long.
GAP = 4.0
# Fewer samples say nothing of a motion, or of a rate beside a gap.
MINIMUM_SAMPLES = 5


def on_circle(difference: np.ndarray) -> np.ndarray:
    r"""Differences of angles on the circle, :math:`[-\pi, \pi)`; NaN stays.

    Parameters
    ----------
    difference : numpy.ndarray
        rad.

    Examples
    --------
    >>> print(np.degrees(on_circle(np.radians([358.0, -190.0, 30.0]))).round(6))
    [ -2. 170.  30.]
    """
    with np.errstate(invalid="ignore"):
        return np.remainder(difference + 0.5 * TURN, TURN) - 0.5 * TURN


def unwrapped(
    values: np.ndarray, period: float = TURN, times: np.ndarray | None = None
) -> np.ndarray:
    """Continuous series of an angle; missing samples stay missing.

    Parameters
    ----------
    values : numpy.ndarray
        Shape ``(n_samples,)``, NaN where not sampled.
    period : float
        One turn, in the unit of the values.
    times : numpy.ndarray, optional
        Shape ``(n_samples,)``, s. With them full turns within gaps are counted by the rates on
        both sides.

    Examples
    --------
    >>> print(np.degrees(unwrapped(np.radians([358.0, np.nan, 2.0, 6.0]))).round(6))
    [358.  nan 362. 366.]
    """
    result = np.array(values, dtype=float)
    present = np.isfinite(result)
    series = np.unwrap(result[present], period=period)
    if times is not None:
        series = _with_turns_in_gaps(np.asarray(times, dtype=float)[present], series, period)
    result[present] = series
    return result


def _with_turns_in_gaps(times: np.ndarray, series: np.ndarray, period: float) -> np.ndarray:
    """Add the full turns that a steady motion makes while nothing is logged."""
    steps = np.diff(times)
    if steps.size < 2 * MINIMUM_SAMPLES:
        return series
    gaps = np.flatnonzero(steps > GAP * np.median(steps))
    edges = [0, *(gaps + 1), times.size]
    result = series.copy()
    for first, gap, last in zip(edges, edges[1:], edges[2:], strict=False):
        sides = slice(max(first, gap - 12), gap), slice(gap, min(last, gap + 12))
        if min(side.stop - side.start for side in sides) < MINIMUM_SAMPLES:
            continue
        before, after = (float(np.polyfit(times[s], series[s], 1)[0]) for s in sides)
        duration = float(steps[gap - 1])
        if abs(after - before) * duration <= 0.5 * period:  # else nobody knows which of two turns
            expected = 0.5 * (before + after) * duration
            turns = round((expected - (series[gap] - series[gap - 1])) / period)
            result[gap:] += turns * period
    return result


def clear_wraps(values: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Find jumps by a full turn that nothing but a wrapped angle explains.

    A jump counts only if the signal stays within one turn, if the jump is a turn up to 8 % of it,
    and if the motion that remains is no faster than the signal is around it. A heading that is
    sampled so sparsely that half a turn may lie between two samples shows no clear jump.

    Parameters
    ----------
    values : numpy.ndarray
        Shape ``(n_samples,)``, NaN where not sampled.

    Returns
    -------
    tuple of float and numpy.ndarray, or None
        The period (2 pi or 360) and the index of the sample after each jump; None without jumps.

    Examples
    --------
    >>> period, after = clear_wraps(np.radians([350.0, 354.0, 358.0, 2.0, 6.0]))
    >>> round(np.degrees(period)), after
    (360, array([3]))
    >>> clear_wraps(np.radians([10.0, 350.0, 20.0, 340.0])) is None
    True
    """
    finite = np.isfinite(values)
    if finite.sum() < 4:
        return None
    reach = float(np.max(values, where=finite, initial=-np.inf))
    reach -= float(np.min(values, where=finite, initial=np.inf))
    least, most = 1.0 - 2.0 * WRAP_SHARE, 1.0 + 0.5 * WRAP_SHARE
    periods = [p for p in PERIODS if least * p < reach < most * p]
    if not periods:  # of nearly all signals this is all that has to be looked at
        return None
    present = np.flatnonzero(finite)
    steps = np.diff(values[present])
    for period in periods:
        jumps = np.flatnonzero(np.abs(np.abs(steps) - period) < WRAP_SHARE * period)
        if not jumps.size:
            continue
        rest = np.abs(steps - period * np.round(steps / period))
        usual = np.delete(rest, jumps)
        pace = float(np.quantile(usual, 0.9)) if usual.size else np.inf
        if pace > WRAP_SHARE * period or rest[jumps].max() > FASTER * max(pace, 0.002 * period):
            continue
        return period, present[jumps + 1]
    return None


def check_wraps(
    channel: Input | Output,
    values: np.ndarray,
    where: str,
    *,
    raw: np.ndarray | None = None,
    unit: str = "rad",
    at: Callable[[int], str] = "at index {}".format,
    advice: str = 'declare Output("{}", "rad", wrap=True)',
) -> None:
    """Refuse an output in rad that jumps by full turns without being declared to wrap.

    Parameters
    ----------
    channel : Input or Output
        Inputs may jump.
    values : ndarray (n_samples,)
        Its series, in the channel's unit.
    where : str
        Words for the series, with which the message begins.
    raw : ndarray (n_samples,), optional
        The series as logged, in its ``unit``.
    unit : str
        Of the series as logged.
    at : callable
        Words for the place of a sample.
    advice : str
        What declares an angle that wraps, with the name in braces.

    Raises
    ------
    DataError
        If it does; the message says where, and what to do.
    """
    if not isinstance(channel, Output) or channel.wrap or channel.unit != "rad":
        return
    if (found := clear_wraps(values)) is None:
        return
    (period, after), raw = found, values if raw is None else raw
    row, advice = int(after[0]), advice.format(channel.name)
    last = raw[:row][np.isfinite(raw[:row])][-1]
    times = "once" if after.size == 1 else f"{after.size} times, first"
    jump = f"{where} jumps by a full turn {times} {at(row)}, "
    jump += f"from {last:.6g} to {raw[row]:.6g} {unit}. "
    if period == TURN:
        raise DataError(f"{jump}The angle is wrapped: {advice}.")
    raise DataError(
        f"{jump}The jump is 360 {unit}, so these are degrees: write the header as "
        f"'{channel.name} [deg]', and {advice}."
    )


# -- a measured record -----------------------------------------------------------------


TIME_ADVICE = (
    "Times have to increase strictly: sort the rows, remove the repeated ones, "
    "or cut the log where its clock was set."
)


@dataclass(frozen=True, eq=False)
class Record:
    """One uninterrupted measurement.

    Parameters
    ----------
    name : str
        Name of the record, for instance ``"zigzag_10_10"``.
    times : array_like
        Shape ``(n_samples,)``, in s, strictly increasing; any origin.
    inputs : array_like
        Shape ``(n_samples, n_inputs)``, SI, finite.
    outputs : array_like
        Shape ``(n_samples, n_outputs)``, SI; NaN where not sampled.
    channels : Channels
        Names and units of the columns.
    source : str
        Where the numbers come from.
    missing_outputs : tuple of str
        Outputs that were not measured at all; their columns are NaN.
    ignored_columns : tuple of str
        Columns of the source that no channel asked for.
    continuous : tuple of str
        Outputs with ``wrap=True`` that have been made continuous; filled in when the record is
        made from a log.
    notes : tuple of str
        What was done to the numbers on the way, in sentences.
    independent : bool
        Whether samples are tests of their own, such as captive ones, in whatever order: no
        disturbance force, colour or correlation links one to the next.

    Raises
    ------
    DataError
        If shapes, times or values cannot be worked with.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Channels, Input, Output
    >>> channels = Channels((Input("fin", "rad"),), (Output("q", "rad/s"),))
    >>> t = np.arange(6) * 0.5
    >>> record = Record("step", t, np.ones((6, 1)), 0.1 * t[:, None], channels)
    >>> print(record.n_samples, record.duration, record.sample_time, record.constant_channels)
    6 2.5 0.5 ('fin',)
    """

    name: str
    times: np.ndarray = field(repr=False)
    inputs: np.ndarray = field(repr=False)
    outputs: np.ndarray = field(repr=False)
    channels: Channels = field(repr=False)
    source: str = ""
    missing_outputs: tuple[str, ...] = ()
    ignored_columns: tuple[str, ...] = field(default=(), repr=False)
    continuous: tuple[str, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = field(default=(), repr=False)
    independent: bool = False

    def __post_init__(self) -> None:
        times = self._numbers("times", self.times)
        if times.ndim != 1:
            raise DataError(
                f"Record {self.name!r} has times of shape {times.shape}. Expected (n_samples,)."
            )
        inputs = self._columns("inputs", self.inputs, times.size, self.channels.input_names)
        outputs = self._columns("outputs", self.outputs, times.size, self.channels.output_names)
        self._make_continuous(outputs)
        for key, array in (("times", times), ("inputs", inputs), ("outputs", outputs)):
            array.setflags(write=False)
            object.__setattr__(self, key, array)
        object.__setattr__(self, "missing_outputs", tuple(self.missing_outputs))
        for fault in self._faults():
            raise DataError(fault)

    def residuals(self, predicted: np.ndarray) -> np.ndarray:
        """Measured minus predicted outputs; those that wrap are compared on the circle.

        Parameters
        ----------
        predicted : numpy.ndarray
            Shape ``(n_samples, n_outputs)``, SI.

        Returns
        -------
        numpy.ndarray
            Shape ``(n_samples, n_outputs)``; NaN where nothing was measured.

        Examples
        --------
        >>> from oed_sysid.physics.channels import Channels, Input, Output
        >>> channels = Channels((Input("rudder", "rad"),), (Output("psi", "rad", wrap=True),))
        >>> north = Record("north", np.arange(5.0), np.zeros(5), np.zeros(5), channels)
        >>> print(np.degrees(north.residuals(np.radians([[359.0]]))).round(6).ravel())
        [1. 1. 1. 1. 1.]
        """
        difference = self.outputs - predicted
        wraps = [output.wrap for output in self.channels.outputs]
        difference[:, wraps] = on_circle(difference[:, wraps])
        return difference

    def on_its_turn(self, output: str, angle: float) -> float:
        """The angle, moved by full turns next to the first sample of an output that wraps, rad."""
        column = self.channels.output_names.index(output)
        series = self.outputs[:, column]
        seen = series[np.isfinite(series)]
        if not (self.channels.outputs[column].wrap and seen.size):
            return angle
        return angle + TURN * round((float(seen[0]) - angle) / TURN)

    def _numbers(self, kind: str, values: ArrayLike) -> np.ndarray:
        try:
            return np.array(values, dtype=float)
        except (TypeError, ValueError):
            raise DataError(SAYS["no_numbers"].format(self, kind=kind, values=values)) from None

    def _columns(
        self, kind: str, values: ArrayLike, n_samples: int, names: tuple[str, ...]
    ) -> np.ndarray:
        """Copy as ``(n_samples, n_signals)``; a single signal may come as a vector."""
        array = self._numbers(kind, values)
        if array.ndim == 1 and len(names) == 1:
            array = array[:, np.newaxis]
        if not names and array.size == 0:
            array = np.empty((n_samples, 0))
        if array.ndim != 2 or array.shape[1] != len(names):
            raise DataError(
                f"Record {self.name!r} has {kind} of shape {array.shape}. Expected time first, "
                f"({n_samples}, {len(names)}), with the columns {listed(names)}."
            )
        if array.shape[0] != n_samples:
            raise DataError(
                f"Record {self.name!r} has {n_samples} times but {array.shape[0]} rows of "
                f"{kind} ({', '.join(names)}). Mark missing samples with NaN."
            )
        return array

    def _make_continuous(self, outputs: np.ndarray) -> None:
        """Unwrap the angles that are declared to wrap; refuse others that do. Works in place."""
        notes, done = list(self.notes), list(self.continuous)
        for column, output in enumerate(self.channels.outputs):
            values = outputs[:, column]
            if output.name in done:
                continue
            if not output.wrap:
                check_wraps(output, values, f"Record {self.name!r}: output {output.name!r}")
                continue
            whole = unwrapped(values, times=self.times)
            jumps = int(np.sum(np.abs(np.diff((whole - values)[np.isfinite(values)])) > 1.0))
            if jumps:
                notes.append(
                    f"{output.name} of record {self.name!r} was unwrapped: "
                    f"{counted(jumps, 'full turn')} added where the log jumps."
                )
            outputs[:, column] = whole
            done.append(output.name)
        object.__setattr__(self, "continuous", tuple(done))
        object.__setattr__(self, "notes", tuple(notes))

    def _faults(self) -> Iterator[str]:
        """What is wrong with times and values, in sentences, the worst first."""
        if self.n_samples < MINIMUM_SAMPLES:
            yield str(SAYS["few_samples"].format(self, least=MINIMUM_SAMPLES))
        if (fault := time_fault(self.times)) is not None:
            index, what = fault
            yield (
                f"Record {self.name!r}: time {what} at index {index} "
                f"(t = {self.times[index]}). {TIME_ADVICE}"
            )
        for row, column in np.argwhere(~np.isfinite(self.inputs)):
            yield (
                f"Record {self.name!r}: input {self.channels.input_names[column]!r} is "
                f"{self.inputs[row, column]} at index {row} (t = {self.times[row]:g} s). Inputs "
                "have to be known at every time: fill the gap by what the command was, or cut "
                "the record there with window()."
            )
        for row, column in np.argwhere(np.isinf(self.outputs)):
            yield (
                f"Record {self.name!r}: output {self.channels.output_names[column]!r} is infinite "
                f"at index {row}. Mark missing samples with NaN."
            )
        yield from self._contradictions()

    def _contradictions(self) -> Iterator[str]:
        """Where samples and ``missing_outputs`` say different things."""
        names, declared = self.channels.output_names, {*self.missing_outputs}
        empty = {*empty_outputs(self.outputs, names)}
        known = f"the outputs are {', '.join(names)}"
        says = f"Record {self.name!r} declares {{!r}} missing, but {{}}."
        yield from (says.format(name, known) for name in sorted(declared - {*names}))
        for name in sorted(empty - declared):
            yield str(SAYS["never_measured"].format(self, name=name))
        yield from (says.format(name, "it has samples") for name in sorted(declared - empty))
        if len(empty) == len(names):
            yield f"Record {self.name!r} has no measured output. At least one is needed."

    _repr_html_ = as_html

    def __repr__(self) -> str:
        return f"<Record {self.name!r}: {self.duration:.4g} s, {self.n_samples} samples>"

    @cached_property
    def content_hash(self) -> str:
        """Digest (SHA-256) of times, values, names and units; name and source excluded.

        Equal for two records exactly if they hold the same numbers of the same
        channels, on every machine.
        """
        named = [(one.name, one.unit) for one in self.channels.all]
        digest = hashlib.sha256(repr(named).encode())
        if self.independent:
            digest.update(b"independent")
        for array in (self.times, self.inputs, self.outputs):
            # One kind of zero, one kind of NaN, one order of bytes.
            plain = np.where(np.isnan(array), np.nan, array + 0.0).astype("<f8")
            digest.update(repr(plain.shape).encode())
            digest.update(plain.tobytes())
        return digest.hexdigest()

    @property
    def n_samples(self) -> int:
        """Number of times."""
        return self.times.size

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, in s."""
        return float(self.times[-1] - self.times[0])

    @property
    def sample_time(self) -> float:
        """Median time step, in s."""
        return float(np.median(np.diff(self.times)))

    @property
    def is_uniform(self) -> bool:
        """Whether all steps equal the median step within 0.1 %."""
        steps = np.diff(self.times)
        return bool(np.all(np.abs(steps - self.sample_time) <= 1e-3 * steps))

    @property
    def constant_channels(self) -> tuple[str, ...]:
        """Names of signals that never change: they excite or tell nothing."""
        names = self.channels.input_names + self.channels.output_names
        signals = np.hstack([self.inputs, self.outputs])
        return tuple(
            name
            for name, signal in zip(names, signals.T, strict=True)
            if name not in self.missing_outputs and np.nanmax(signal) == np.nanmin(signal)
        )

    def input(self, name: str) -> np.ndarray:
        """Return one input, shape ``(n_samples,)``."""
        return self.inputs[:, self._index(name, self.channels.input_names, "input")]

    def output(self, name: str) -> np.ndarray:
        """Return one output, shape ``(n_samples,)``; NaN where not sampled."""
        return self.outputs[:, self._index(name, self.channels.output_names, "output")]

    def _index(self, name: str, names: tuple[str, ...], kind: str) -> int:
        return located(DataError, f"Record {self.name!r} has no {kind}", [name], names)[0]

    def _take(self, rows: slice | np.ndarray, name: str) -> Record:
        outputs = self.outputs[rows]
        return replace(
            self,
            name=name,
            times=self.times[rows],
            inputs=self.inputs[rows],
            outputs=outputs,
            missing_outputs=empty_outputs(outputs, self.channels.output_names),
        )

    def window(self, start: float, stop: float) -> Record:
        """Return the samples with ``start <= t <= stop`` (s); times stay as they are."""
        return self._take((self.times >= start) & (self.times <= stop), self.name)

    def thin(self, step: int) -> Record:
        """Return every ``step``-th sample, without averaging.

        An input that is held between samples loses its switching times; thin
        only what changes slowly.
        """
        if step < 1:
            raise DataError(f"Cannot keep every {step}-th sample. Give a step of 1 or more.")
        return self._take(slice(None, None, step), self.name)

    def tests(self, rows: np.ndarray, name: str) -> Record:
        """Return some of a record's independent tests.

        Parameters
        ----------
        rows : ndarray of int
            Which, in ascending order.
        name : str
        """
        if not self.independent:
            raise DataError(SAYS["time_series"].format(self))
        return self._take(rows, name)

    def rename(self, name: str) -> Record:
        """Return the same record under another name."""
        return replace(self, name=name)

    def with_inputs(self, inputs: ArrayLike) -> Record:
        """Return the record with other inputs, shape ``(n_samples, n_inputs)``."""
        return replace(self, inputs=np.array(inputs, dtype=float))

    def with_outputs(self, outputs: ArrayLike) -> Record:
        """Return the record with other outputs, shape ``(n_samples, n_outputs)``."""
        array = np.array(outputs, dtype=float)
        names = self.channels.output_names
        empty = empty_outputs(array, names) if array.shape == self.outputs.shape else ()
        return replace(self, outputs=array, missing_outputs=empty)

    def segments(self, duration: float) -> tuple[Record, ...]:
        """Cut into equal pieces that last as nearly ``duration`` (s) as possible.

        Every sample belongs to exactly one piece, so no measurement counts twice.
        """
        if not duration > 0.0:
            raise DataError(f"Segments of {duration} s are not possible. Give a duration above 0.")
        n_segments = max(1, round(self.duration / duration))
        edges = np.linspace(self.times[0], self.times[-1], n_segments + 1)[1:-1]
        bounds = [0, *np.searchsorted(self.times, edges), self.n_samples]
        return tuple(
            self._take(slice(first, last), f"{self.name}_{number}")
            for number, (first, last) in enumerate(pairwise(bounds), start=1)
        )


def nearest(times: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest of ascending times of rows for every time, and how far it is."""
    right = np.clip(np.searchsorted(rows, times), 0, rows.size - 1)
    left = np.maximum(right - 1, 0)
    index = np.where(np.abs(rows[left] - times) <= np.abs(rows[right] - times), left, right)
    return index, np.abs(rows[index] - times)


def empty_outputs(outputs: np.ndarray, names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the outputs ``(n_samples, n_outputs)`` without any sample."""
    empty = np.all(np.isnan(outputs), axis=0)
    return tuple(name for name, is_empty in zip(names, empty, strict=True) if is_empty)


def time_fault(times: np.ndarray) -> tuple[int, str] | None:
    """Find the first time that is not finite or not later than the one before.

    Parameters
    ----------
    times : numpy.ndarray
        Shape ``(n_samples,)``.

    Returns
    -------
    tuple of int and str, or None
        Index and a verb phrase, ``None`` if there is no fault.

    Examples
    --------
    >>> time_fault(np.array([0.0, 1.0, 1.0, 0.5]))
    (2, 'repeats')
    """
    infinite = np.flatnonzero(~np.isfinite(times))
    if infinite.size:
        return int(infinite[0]), "is not a finite number"
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if not late.size:
        return None
    index = int(late[0]) + 1
    return index, "repeats" if times[index] == times[index - 1] else "runs backwards"


# -- records that were sampled alike ---------------------------------------------------


def sampled_alike(records: Sequence[Record]) -> list[list[int]]:
    """Places of the records, grouped by sample time: colour is estimated in samples."""
    groups: dict[float, list[int]] = {}
    for index, record in enumerate(records):
        step = record.sample_time
        alike = (other for other in groups if abs(step - other) < 0.01 * other)
        groups.setdefault(next(alike, step), []).append(index)
    return [*groups.values()]
