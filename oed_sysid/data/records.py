r"""From a log and a mapping to records.

A channel is :math:`s\,c\,(x - x_0)` of the reading :math:`x`, with sign :math:`s`, factor
:math:`c` and trim :math:`x_0`, at the time of the log less the sensor's delay. Outputs keep their
own samples: nothing is interpolated, averaged or filtered. A row of a record holds the outputs that
were sampled within ``tolerance`` of each other and NaN for the rest. Inputs have to be known at
every row: a command that is held keeps its last value, and where it changes rarely its switching
times become rows of their own; a linear input is interpolated. What was done is said in notes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from oed_sysid.data import SAYS
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.log import Log, Series
from oed_sysid.data.mapping import Cut, LogMapping, Source
from oed_sysid.data.record import (
    GAP,
    MINIMUM_SAMPLES,
    Record,
    check_wraps,
    empty_outputs,
    nearest,
    unwrapped,
)
from oed_sysid.errors import DataError, located
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.runtime.constants import IMMATERIAL, MATERIAL
from oed_sysid.text.units import converts, same_unit, to_si


@dataclass(frozen=True, eq=False)
class Imported:
    """Records of a log, and what was done on the way.

    Attributes
    ----------
    dataset : Dataset
        One record per manoeuvre.
    notes : tuple of str
        What was kept, interpolated, left out.

    Examples
    --------
    What :func:`~oed_sysid.data.records.import_log` returns; see there.
    """

    dataset: Dataset
    notes: tuple[str, ...] = field(default=(), repr=False)


def import_log(
    log: Log, mapping: LogMapping, channels: Channels | None = None, *, name: str | None = None
) -> Imported:
    """Make records of a log.

    Parameters
    ----------
    log : Log
        As :func:`~oed_sysid.data.formats.open_log` returns it.
    mapping : LogMapping
        Which field is which channel.
    channels : Channels, optional
        Those of the problem; by default what the mapping itself says.
    name : str, optional
        Beginning of the records' names; by default that of the file.

    Returns
    -------
    Imported
        The records and what was done.

    Raises
    ------
    DataError
        If a field is missing, a unit does not fit, or a cut holds too few samples.

    Examples
    --------
    >>> from pathlib import Path
    >>> from oed_sysid.data.log import assemble
    >>> from oed_sysid.data.mapping import parse
    >>> t = np.arange(0.0, 10.0, 0.1)
    >>> log = assemble(Path("a.bin"), "test", {
    ...     "gyro": (t, {"z": np.degrees(0.1 * np.sin(t))}),
    ...     "servo": (t[::10], {"us": 1500 + t[::10]}),
    ... })
    >>> mapping = parse('''
    ... [inputs.rudder]
    ... field = "servo.us"
    ... trim = 1500
    ... unit = "deg"
    ... [outputs.r]
    ... field = "gyro.z"
    ... unit = "deg/s"
    ... ''')
    >>> record = import_log(log, mapping).dataset[0]
    >>> print(record.n_samples, record.output("r").max().round(6), record.input("rudder")[-1])
    100 0.099957 0.15707963267948966
    """
    stem = name or log.path.stem or "log"
    log = log.timed(mapping.time, mapping.time_unit)
    work = _Import(log, mapping, channels or mapping.channels(log))
    records = tuple(_Manoeuvre(work, cut).record() for cut in work.cuts(stem))
    return Imported(Dataset(records), tuple(dict.fromkeys(work.notes)))


class _Import:
    """A log, its mapping, and all channels over the whole log, SI."""

    def __init__(self, log: Log, mapping: LogMapping, channels: Channels) -> None:
        self.log, self.mapping, self.channels = log, mapping, channels
        self.notes = list(log.notes)
        self._check_names()
        inside = [one for one in channels.outputs if one.name in mapping.outputs]
        self.inputs = {c.name: self._signal(mapping.inputs[c.name], c) for c in channels.inputs}
        self.outputs = {c.name: self._signal(mapping.outputs[c.name], c) for c in inside}
        lost = [one.name for one in channels.outputs if one.name not in self.outputs]
        if lost:
            self.notes.append(f"Not in the mapping, so not measured: {', '.join(lost)}.")

    def _check_names(self) -> None:
        mapping, channels = self.mapping, self.channels
        for kind, given, known in (
            ("input", mapping.inputs, channels.input_names),
            ("output", mapping.outputs, channels.output_names),
        ):
            located(DataError, f"{mapping.where}: the problem has no {kind}", given, known)
        for name in (name for name in channels.input_names if name not in mapping.inputs):
            raise DataError(SAYS["unmapped_input"].format(mapping=mapping, name=name))

    def _signal(self, source: Source, channel: Input | Output) -> Series:
        """A channel in SI at the times when it was so."""
        log, name = self.log, channel.name
        if source.constant is not None:
            return self._constant(source, source.constant, channel)
        series = log[source.field]
        stated = self._unit(source, series, channel)
        values = source.sign * to_si(source.factor * (series.values - source.trim), stated)[0]
        if source.delay:
            self.notes.append(f"{name} was moved {source.delay:g} s towards the beginning.")
        if not source.wrap:
            check_wraps(
                channel,
                values,
                repr(source.field),
                at=lambda row: f"at {series.times[row]:.2f} s",
                advice="add  wrap = true  to [outputs.{}]",
            )
        present = np.isfinite(values)
        if not present.any():
            raise DataError(f"{source.field!r} of {log.path.name} holds no number.")
        return Series(name, series.times[present] - source.delay, values[present])

    def _constant(self, source: Source, value: float, channel: Input | Output) -> Series:
        """An input that was not logged."""
        name, unit = channel.name, source.unit or channel.unit
        _check_unit(f"{self.mapping.where}: [inputs.{name}]", unit, channel.unit)
        held = source.sign * float(to_si(value, unit)[0])
        self.notes.append(f"{name} was not logged: {held:.6g} {channel.unit} throughout.")
        return Series(name, np.array([self.log.span[0]]), np.array([held]))

    def _unit(self, source: Source, series: Series, channel: Input | Output) -> str:
        """Unit of a field, as the mapping says it, or else the log."""
        stated = source.unit or series.unit
        if stated is None:
            raise DataError(SAYS["unit_of_field"].format(self, source=source, channel=channel))
        _check_unit(f"{source.field!r}", stated, channel.unit)
        # A declared unit other than the log's own is not a conversion but a contradiction.
        if series.unit is not None and source.factor == 1.0 and not same_unit(stated, series.unit):
            self.notes.append(
                f"{source.field} is taken as {stated}, as the mapping says; the log says "
                f"{series.unit}."
            )
        return stated

    def cuts(self, stem: str) -> list[Cut]:
        """Manoeuvres of the mapping; the whole log where it asks for none."""
        mapping, (first, last) = self.mapping, self.log.span
        if away := [cut for cut in mapping.cuts if cut.start > last or cut.stop < first]:
            raise DataError(SAYS["cut_outside"].format(away=away, first=first, last=last))
        made: list[Cut] = []
        if mapping.while_ is not None:
            made += mapping.while_.find(self.log[mapping.while_.field], last)
        if mapping.by_commands is not None:
            commands = {name: (one.times, one.values) for name, one in self.inputs.items()}
            made += mapping.by_commands.find(commands, last)
        elif mapping.while_ is None and not mapping.cuts:
            return [Cut(stem, first, max(last, first + 1e-9))]
        found = [*mapping.cuts, *(replace(cut, name=f"{stem}_{cut.name}") for cut in made)]
        if not found:
            raise DataError(SAYS["no_manoeuvre"].format(self, mapping=mapping))
        return found


def _check_unit(where: str, unit: str, needed: str) -> None:
    if not converts(unit, needed):
        raise DataError(SAYS["unit_of_channel"].format(where=where, unit=unit, needed=needed))


class _Manoeuvre:
    """One cut of a log on its way to a record."""

    def __init__(self, work: _Import, cut: Cut) -> None:
        self.work, self.cut = work, cut
        self.pieces = {name: self._piece(one) for name, one in work.outputs.items()}
        if sum(piece.times.size for piece in self.pieces.values()) < MINIMUM_SAMPLES:
            raise DataError(
                f"Cut {cut.name!r} ({cut.start:g} to {cut.stop:g} s) holds fewer than "
                f"{MINIMUM_SAMPLES} samples of the outputs. Choose other times; oed-sysid import "
                f"{work.log.path.name} --list shows what the log spans."
            )
        if work.mapping.sample_time is not None:
            step = work.mapping.sample_time
            self.pieces = {name: self._thinned(p, step) for name, p in self.pieces.items()}
        steps = [piece.step for piece in self.pieces.values() if piece.times.size > 1]
        self.tolerance = work.mapping.tolerance or IMMATERIAL * min(steps, default=0.0)

    def _note(self, words: str) -> None:
        self.work.notes.append(f"{self.cut.name}: {words}")

    def record(self) -> Record:
        """The outputs in their rows, and the inputs at these."""
        channels, inputs = self.work.channels, self.work.inputs
        begun = [one.times[0] for one in inputs.values() if one.times.size > 1]
        start = max(begun, default=self.cut.start)
        rows = self._rows()
        early = rows < start
        if early.any():
            self._note(
                f"{int(early.sum())} rows before the first command at {start:.2f} s were "
                "left out: nobody knows what was commanded then."
            )
        rows = self._with_switches(rows[~early])
        outputs = self._placed(rows, start)
        columns = [self._at(inputs[one.name], rows, one) for one in channels.inputs]
        return Record(
            self.cut.name,
            rows,
            np.column_stack(columns) if columns else np.empty((rows.size, 0)),
            outputs,
            channels,
            source=str(self.work.log.path),
            missing_outputs=empty_outputs(outputs, channels.output_names),
        )

    def _placed(self, rows: np.ndarray, start: float) -> np.ndarray:
        """Outputs in their rows ``(n_rows, n_outputs)``; what was moved or lost is noted."""
        names, clock = self.work.channels.output_names, self.work.mapping.clock
        outputs = np.full((rows.size, len(names)), np.nan)
        moved = [
            _place(piece, rows, outputs[:, names.index(name)])
            for name, piece in self.pieces.items()
        ]
        if (most := max(moved)) > 0.0:
            self._note(f"samples of one moment share a row; the largest shift is {most:.3g} s.")
        every = sum(int(np.sum(piece.times >= start)) for piece in self.pieces.values())
        lost = every - int(np.isfinite(outputs).sum())
        if clock != "outputs" and lost > 0:
            self._note(f"{lost} samples away from those of {clock!r} were left out.")
        return outputs

    def _piece(self, signal: Series) -> Series:
        """What lies within the cut, its times checked to increase."""
        inside = (signal.times >= self.cut.start) & (signal.times <= self.cut.stop)
        times, values = signal.times[inside], signal.values[inside]
        steps = np.diff(times, prepend=-np.inf)
        if np.any(steps < 0.0):
            back = int(np.argmax(steps < 0.0))
            raise DataError(
                f"The clock of {signal.name!r} goes back at {times[back - 1]:.3f} s, by "
                f"{-steps[back]:.3g} s. Rows out of order: sort those of "
                f"{self.work.log.path.name} by time. The clock was set, or the vehicle restarted: "
                "cut the log there with [[cuts]]."
            )
        again = int(np.sum(steps == 0.0))
        if again:
            self.work.notes.append(
                f"{signal.name}: {again} repeated times; the first sample is kept."
            )
            times, values = times[steps > 0.0], values[steps > 0.0]
        if self.work.mapping.outputs[signal.name].wrap:
            # Within a manoeuvre: what was turned between two of them does not matter.
            whole = unwrapped(values)
            turns = int(np.sum(np.abs(np.diff(whole - values)) > 1.0))
            if turns:
                self._note(f"{signal.name} was unwrapped, jumps by a full turn undone: {turns}.")
            values = whole
        return Series(signal.name, times, values)

    def _thinned(self, piece: Series, step: float) -> Series:
        """One sample per interval: the one nearest to its centre, at its own time."""
        if piece.step >= step or not piece.times.size:
            return piece
        number = np.floor((piece.times - self.cut.start) / step + 0.5)
        distance = np.abs(piece.times - self.cut.start - number * step)
        order = np.lexsort((distance, number))
        keep = np.sort(order[np.unique(number[order], return_index=True)[1]])
        self.work.notes.append(
            f"{piece.name}: {keep.size} of {piece.times.size} samples kept, one per {step:g} s, "
            "without averaging."
        )
        return Series(piece.name, piece.times[keep], piece.values[keep])

    def _rows(self) -> np.ndarray:
        """Times of the rows: every sample is near one of them, no two are near each other."""
        clock = self.work.mapping.clock
        if clock != "outputs":
            return self.pieces[clock].times
        # The output with most samples sets rows first; the others join them where they can.
        rows = np.empty(0)
        for piece in sorted(self.pieces.values(), key=lambda one: -one.times.size):
            rows = self._joined(rows, piece.times) if rows.size else piece.times
        return np.unique(rows)

    def _joined(self, rows: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Rows, and the times that are near none of them."""
        _, distance = nearest(times, rows)
        return np.sort(np.concatenate([rows, times[distance > self.tolerance]]))

    def _with_switches(self, rows: np.ndarray) -> np.ndarray:
        """Rows with the moments at which held commands change."""
        for channel in self.work.channels.inputs:
            signal = self.work.inputs[channel.name]
            if channel.interpolation != "hold" or signal.times.size < 2 or rows.size < 2:
                continue
            changes = signal.times[1:][np.diff(signal.values) != 0.0]
            changes = np.unique(changes[(changes > rows[0]) & (changes < rows[-1])])
            more = self._joined(rows, changes)
            # They become rows where there are few of them beside those that are there.
            if more.size <= (1.0 + MATERIAL) * rows.size:
                rows = more
            else:
                step = float(np.median(np.diff(rows)))
                self._note(
                    f"{channel.name} changes {changes.size} times; each change counts from "
                    f"the next row on, up to {step:.3g} s late."
                )
        return rows

    def _at(self, signal: Series, rows: np.ndarray, channel: Input) -> np.ndarray:
        """An input at every row: held, or interpolated and said so."""
        order = np.argsort(signal.times, kind="stable")
        times, values = signal.times[order], signal.values[order]
        if times.size == 1:
            return np.full(rows.size, values[0])
        if channel.interpolation == "linear":
            gaps = np.diff(times[(times >= rows[0]) & (times <= rows[-1])])
            if gaps.size and gaps.max() > GAP * np.median(gaps):
                self._note(f"{channel.name} has a gap of {gaps.max():.3g} s, bridged by a line.")
            self.work.notes.append(
                f"{channel.name} is interpolated linearly at the rows of the outputs."
            )
            return np.interp(rows, times, values)
        # A command within the tolerance of a row is one of that moment.
        held = np.searchsorted(times, rows + self.tolerance + 1e-9, side="right") - 1
        return values[np.maximum(held, 0)]


def _place(piece: Series, rows: np.ndarray, column: np.ndarray) -> float:
    """Write an output's samples into their rows; the largest shift of a time, s."""
    if not piece.times.size:
        return 0.0
    index, distance = nearest(piece.times, rows)
    # Of several samples at one row the nearest is taken: it is written last.
    order = np.argsort(-distance, kind="stable")
    order = order[distance[order] <= 0.5 * piece.step]
    column[index[order]] = piece.values[order]
    return float(np.max(distance[order], initial=0.0))
