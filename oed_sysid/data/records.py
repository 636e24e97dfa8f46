r"""From a log and a mapping to records.

A channel is :math:`s\,c\,(x - x_0)` of the reading :math:`x`, with sign :math:`s`, factor
:math:`c` and trim :math:`x_0`, at the time of the log less the sensor's delay. Outputs keep their
own samples: nothing is interpolated, averaged or filtered. A row of a record holds the outputs that
were sampled within ``tolerance`` of each other and NaN for the rest. Inputs have to be known at
every row: a command that is held keeps its last value, and where it changes rarely its switching
times become rows of their own; a linear input is interpolated. What was done is said in notes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.log import Log
from oed_sysid.data.mapping import Cut, LogMapping, Source
from oed_sysid.data.record import GAP, MINIMUM_SAMPLES, Record, clear_wraps, closest, unwrapped
from oed_sysid.errors import DataError
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.text.units import dimension, to_si

# Samples of outputs are the same moment within this share of the shortest sampling interval.
TOLERANCE = 0.1
# Switching times of a held command become rows if there are fewer of them than this share of rows.
RARE = 0.2


@dataclass(frozen=True, eq=False)
class Imported:
    """Records of a log, and what was done on the way.

    Attributes
    ----------
    dataset : Dataset
        One record per manoeuvre.
    notes : tuple of str
        What was kept, interpolated, left out.
    """

    dataset: Dataset
    notes: tuple[str, ...] = field(default=(), repr=False)


@dataclass(frozen=True, eq=False)
class _Signal:
    """One channel over the whole log, SI."""

    name: str
    times: np.ndarray
    values: np.ndarray
    wrap: bool = False

    @property
    def step(self) -> float:
        steps = np.diff(self.times)
        steps = steps[steps > 0.0]
        return float(np.median(steps)) if steps.size else np.inf


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
    notes = list(log.notes)
    wanted = channels or mapping.channels(log)
    _check_names(mapping, wanted)
    inputs = {one.name: _input(log, mapping, one, notes) for one in wanted.inputs}
    outputs = {
        one.name: _signal(log, mapping.outputs[one.name], one, notes)
        for one in wanted.outputs
        if one.name in mapping.outputs
    }
    lost = [one.name for one in wanted.outputs if one.name not in mapping.outputs]
    if lost:
        notes.append(f"Not in the mapping, so not measured: {', '.join(lost)}.")
    cuts = _cuts(log, mapping, inputs, stem)
    records = [_record(cut, wanted, mapping, inputs, outputs, log, notes) for cut in cuts]
    return Imported(Dataset(tuple(records)), tuple(dict.fromkeys(notes)))


def _check_names(mapping: LogMapping, channels: Channels) -> None:
    for kind, given, known in (
        ("input", mapping.inputs, channels.input_names),
        ("output", mapping.outputs, channels.output_names),
    ):
        for name in given:
            if name not in known:
                raise DataError(
                    f"{mapping.where}: {name!r} is no {kind} of the problem. It has "
                    f"{', '.join(known) or 'none'}." + closest(name, known)
                )
    for name in channels.input_names:
        if name not in mapping.inputs:
            raise DataError(
                f"{mapping.where} has no [inputs.{name}]. Inputs have to be known at every time: "
                "name its field, or give constant = number if it did not change."
            )


def _input(log: Log, mapping: LogMapping, channel: Input, notes: list[str]) -> _Signal:
    source = mapping.inputs[channel.name]
    if source.constant is None:
        return _signal(log, source, channel, notes)
    unit = source.unit or channel.unit
    _check_unit(f"{mapping.where}: [inputs.{channel.name}]", unit, channel.unit)
    value = source.sign * float(to_si(source.constant, unit)[0])
    notes.append(f"{channel.name} was not logged: {value:.6g} {channel.unit} throughout.")
    return _Signal(channel.name, np.array([log.span[0]]), np.array([value]))


def _signal(log: Log, source: Source, channel: Input | Output, notes: list[str]) -> _Signal:
    """A channel in SI at the times when it was so."""
    series = log[source.field]
    unit = source.unit or series.unit
    if unit is None:
        raise DataError(
            f"{source.field!r} has no unit in {log.path.name}. Say it in the mapping: unit = "
            f'"{channel.unit}", or whichever it is in.'
        )
    _check_unit(f"{source.field!r}", unit, channel.unit)
    # A declared unit other than the log's own is not a conversion but a contradiction.
    if series.unit is not None and source.factor == 1.0 and not _agree(unit, series.unit):
        notes.append(
            f"{source.field} is taken as {unit}, as the mapping says; the log says {series.unit}."
        )
    readings = source.factor * (series.values - source.trim)
    values = source.sign * to_si(readings, unit)[0]
    if source.delay:
        notes.append(f"{channel.name} was moved {source.delay:g} s towards the beginning.")
    present = np.isfinite(values)
    if isinstance(channel, Output) and channel.unit == "rad" and not (source.wrap or channel.wrap):
        found = clear_wraps(values)
        if found is not None:
            raise DataError(
                f"{source.field!r} jumps by a full turn {found[1].size} times, first at "
                f"{series.times[found[1][0]]:.2f} s. Add  wrap = true  to [outputs.{channel.name}]."
            )
    if not present.any():
        raise DataError(f"{source.field!r} of {log.path.name} holds no number.")
    times, values = series.times[present] - source.delay, values[present]
    return _Signal(channel.name, times, values, source.wrap)


def _check_unit(where: str, unit: str, needed: str) -> None:
    found, wanted = dimension(unit), dimension(needed)
    if found != wanted or found.radian != wanted.radian:
        raise DataError(
            f"{where} is in [{unit}], but the channel needs [{needed}] or a unit that converts to "
            "it. Correct unit in the mapping, or choose another field; a servo's microseconds or "
            "a normalised command need factor = ... and the unit that this leads to."
        )


def _agree(one: str, other: str) -> bool:
    if dimension(one) != dimension(other):
        return False
    return bool(np.isclose(float(to_si(1.0, one)[0]), float(to_si(1.0, other)[0])))


def _cuts(log: Log, mapping: LogMapping, inputs: Mapping[str, _Signal], stem: str) -> list[Cut]:
    first, last = log.span
    found = [replace(cut, name=cut.name) for cut in mapping.cuts]
    for cut in found:
        if cut.start > last or cut.stop < first:
            raise DataError(
                f"Cut {cut.name!r} is from {cut.start:g} to {cut.stop:g} s, but the log lasts from "
                f"{first:.1f} to {last:.1f} s."
            )
    if mapping.while_ is not None:
        found += [replace(cut, name=f"{stem}_{cut.name}") for cut in mapping.while_.of(log)]
    if mapping.by_commands is not None:
        commands = {name: (one.times, one.values) for name, one in inputs.items()}
        made = mapping.by_commands.find(commands, last)
        found += [replace(cut, name=f"{stem}_{cut.name}") for cut in made]
    if found:
        return found
    if mapping.while_ is not None or mapping.by_commands is not None:
        raise DataError(
            f"{mapping.where} finds no manoeuvre in {log.path.name}. Lower threshold or shortest, "
            "or look at the command with --list."
        )
    return [Cut(stem, first, max(last, first + 1e-9))]


def _record(
    cut: Cut,
    channels: Channels,
    mapping: LogMapping,
    inputs: Mapping[str, _Signal],
    outputs: Mapping[str, _Signal],
    log: Log,
    notes: list[str],
) -> Record:
    """One manoeuvre."""
    pieces = _pieces(cut, mapping, outputs, log, notes)
    steps = [piece.step for piece in pieces.values() if piece.times.size > 1]
    tolerance = mapping.tolerance or TOLERANCE * min(steps, default=0.0)
    start = max((one.times[0] for one in inputs.values() if one.times.size > 1), default=cut.start)
    rows = _commanded(cut, _rows(pieces, mapping, tolerance), start, notes)
    rows = _with_switches(rows, channels, inputs, cut, tolerance, notes)
    placed = {name: _placed(piece, rows) for name, piece in pieces.items()}
    _note_shifts(cut, mapping, pieces, placed, start, notes)
    nothing = np.full(rows.size, np.nan)
    table = {name: placed[name][0] if name in placed else nothing for name in channels.output_names}
    columns = [_at(inputs[one.name], rows, one, cut, tolerance, notes) for one in channels.inputs]
    return Record(
        cut.name,
        rows,
        np.column_stack(columns) if columns else np.empty((rows.size, 0)),
        np.column_stack(list(table.values())),
        channels,
        source=str(log.path),
        missing_outputs=tuple(name for name, one in table.items() if not np.isfinite(one).any()),
    )


def _pieces(
    cut: Cut, mapping: LogMapping, outputs: Mapping[str, _Signal], log: Log, notes: list[str]
) -> dict[str, _Signal]:
    """What the outputs hold within a cut, thinned if the mapping asks for it."""
    pieces = {name: _piece(signal, cut, log, notes) for name, signal in outputs.items()}
    if sum(piece.times.size for piece in pieces.values()) < MINIMUM_SAMPLES:
        raise DataError(
            f"Cut {cut.name!r} ({cut.start:g} to {cut.stop:g} s) holds fewer than "
            f"{MINIMUM_SAMPLES} samples of the outputs. Choose other times; oed-sysid import "
            f"{log.path.name} --list shows what the log spans."
        )
    if mapping.sample_time is not None:
        pieces = {n: _thinned(p, cut, mapping.sample_time, notes) for n, p in pieces.items()}
    return pieces


def _commanded(cut: Cut, rows: np.ndarray, start: float, notes: list[str]) -> np.ndarray:
    """Rows from the first command on."""
    early = rows < start
    if early.any():
        notes.append(
            f"{cut.name}: {int(early.sum())} rows before the first command at {start:.2f} s were "
            "left out: nobody knows what was commanded then."
        )
    return rows[~early]


def _note_shifts(
    cut: Cut,
    mapping: LogMapping,
    pieces: Mapping[str, _Signal],
    placed: Mapping[str, tuple[np.ndarray, float]],
    start: float,
    notes: list[str],
) -> None:
    """Say how far samples were moved to share rows, and how many found none."""
    moved = max((shift for _, shift in placed.values()), default=0.0)
    if moved > 0.0:
        notes.append(
            f"{cut.name}: samples of one moment share a row; the largest shift is {moved:.3g} s."
        )
    kept = sum(int(np.isfinite(column).sum()) for column, _ in placed.values())
    lost = sum(piece.times[piece.times >= start].size for piece in pieces.values()) - kept
    if mapping.clock != "outputs" and lost > 0:
        notes.append(
            f"{cut.name}: {lost} samples away from those of {mapping.clock!r} were left out."
        )


def _piece(signal: _Signal, cut: Cut, log: Log, notes: list[str]) -> _Signal:
    """What lies within a cut, its times checked to increase."""
    inside = (signal.times >= cut.start) & (signal.times <= cut.stop)
    times, values = signal.times[inside], signal.values[inside]
    back = np.flatnonzero(np.diff(times) < 0.0)
    if back.size:
        where = times[back[0]]
        raise DataError(
            f"The clock of {signal.name!r} goes back at {where:.3f} s, by "
            f"{times[back[0]] - times[back[0] + 1]:.3g} s: it was set, or the vehicle restarted. "
            f"Cut the log of {log.path.name} there with [[cuts]]."
        )
    again = np.concatenate([[False], np.diff(times) == 0.0])
    if again.any():
        notes.append(f"{signal.name}: {int(again.sum())} repeated times; the first sample is kept.")
        times, values = times[~again], values[~again]
    if signal.wrap:
        # Within a manoeuvre: what was turned between two of them does not matter.
        whole = unwrapped(values)
        turns = int(np.sum(np.abs(np.diff(whole - values)) > 1.0))
        if turns:
            notes.append(
                f"{cut.name}: {signal.name} was unwrapped, jumps by a full turn undone: {turns}."
            )
        values = whole
    return _Signal(signal.name, times, values)


def _thinned(piece: _Signal, cut: Cut, step: float, notes: list[str]) -> _Signal:
    """One sample per interval: the one nearest to its centre, at its own time."""
    if piece.step >= step or not piece.times.size:
        return piece
    number = np.floor((piece.times - cut.start) / step + 0.5)
    distance = np.abs(piece.times - cut.start - number * step)
    order = np.lexsort((distance, number))
    first = order[np.concatenate([[True], np.diff(number[order]) > 0.0])]
    notes.append(
        f"{piece.name}: {first.size} of {piece.times.size} samples kept, one per {step:g} s, "
        "without averaging."
    )
    keep = np.sort(first)
    return _Signal(piece.name, piece.times[keep], piece.values[keep])


def _rows(pieces: Mapping[str, _Signal], mapping: LogMapping, tolerance: float) -> np.ndarray:
    """Times of the rows: every sample is near one of them, no two are near each other."""
    if mapping.clock != "outputs":
        return pieces[mapping.clock].times
    # The output with most samples sets rows first; the others join them where they can.
    rows = np.empty(0)
    for piece in sorted(pieces.values(), key=lambda one: -one.times.size):
        if not rows.size:
            rows = piece.times
            continue
        _, distance = _nearest(piece.times, rows)
        rows = np.sort(np.concatenate([rows, piece.times[distance > tolerance]]))
    keep = np.concatenate([[True], np.diff(rows) > 0.0]) if rows.size else np.empty(0, bool)
    return rows[keep]


def _with_switches(
    rows: np.ndarray,
    channels: Channels,
    inputs: Mapping[str, _Signal],
    cut: Cut,
    tolerance: float,
    notes: list[str],
) -> np.ndarray:
    """Rows with the moments at which held commands change."""
    if rows.size < 2:
        return rows
    for channel in channels.inputs:
        signal = inputs[channel.name]
        if channel.interpolation != "hold" or signal.times.size < 2:
            continue
        changes = signal.times[1:][np.diff(signal.values) != 0.0]
        changes = changes[(changes > rows[0]) & (changes < rows[-1])]
        if not changes.size:
            continue
        _, distance = _nearest(changes, rows)
        away = np.unique(changes[distance > tolerance])
        if away.size <= RARE * rows.size:
            rows = np.sort(np.concatenate([rows, away]))
        else:
            step = float(np.median(np.diff(rows)))
            notes.append(
                f"{cut.name}: {channel.name} changes {changes.size} times; each change counts from "
                f"the next row on, up to {step:.3g} s late."
            )
    return rows


def _placed(piece: _Signal, rows: np.ndarray) -> tuple[np.ndarray, float]:
    """An output's samples in their rows, and the largest shift of a time."""
    column = np.full(rows.size, np.nan)
    if not piece.times.size:
        return column, 0.0
    index, distance = _nearest(piece.times, rows)
    half = 0.5 * piece.step if np.isfinite(piece.step) else np.inf
    # Of several samples at one row the nearest is taken: it is written last.
    order = np.argsort(-distance, kind="stable")
    order = order[distance[order] <= half]
    column[index[order]] = piece.values[order]
    used = distance[order]
    return column, float(used.max()) if used.size else 0.0


def _nearest(times: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest row of every time, and how far it is."""
    right = np.clip(np.searchsorted(rows, times), 0, rows.size - 1)
    left = np.maximum(right - 1, 0)
    index = np.where(np.abs(rows[left] - times) <= np.abs(rows[right] - times), left, right)
    return index, np.abs(rows[index] - times)


def _at(
    signal: _Signal,
    rows: np.ndarray,
    channel: Input,
    cut: Cut,
    tolerance: float,
    notes: list[str],
) -> np.ndarray:
    """An input at every row: held, or interpolated and said so."""
    order = np.argsort(signal.times, kind="stable")
    times, values = signal.times[order], signal.values[order]
    if times.size == 1:
        return np.full(rows.size, values[0])
    inside = times[(times >= rows[0]) & (times <= rows[-1])]
    gaps = np.diff(inside)
    if gaps.size and gaps.max() > GAP * np.median(gaps) and channel.interpolation == "linear":
        notes.append(
            f"{cut.name}: {channel.name} has a gap of {gaps.max():.3g} s, bridged by a line."
        )
    if channel.interpolation == "linear":
        notes.append(f"{channel.name} is interpolated linearly at the rows of the outputs.")
        return np.interp(rows, times, values)
    # A command within the tolerance of a row is one of that moment.
    held = np.searchsorted(times, rows + tolerance + 1e-9, side="right") - 1
    return values[np.maximum(held, 0)]
