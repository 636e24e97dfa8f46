"""Esso Osaka: 100 s ahead from the measured start, over the published simulator's error.

Files beyond the twelve that are registered, put into ``esso_osaka/`` of the data folder, are
scored as they are found; nothing was chosen or fitted with them. A window is 100 s long, as those
of the published errors are; what is left at the end of a record is not scored, and the note says
how much it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.scoreboard.row import Row, attempted, missing, place
from oed_sysid import Channels, Dataset, Model, MultipleShooting, Record, load_problem
from oed_sysid.data.third_party import registered
from oed_sysid.errors import DataError, SimulationError
from oed_sysid.experiments.simulation import simulate_inputs
from problems.esso_osaka.records import VALIDATION, load, record_of, windows

GAP = 0.15  # s between rows that a record may not bridge
SHORTEST = 25.0  # s of a piece that is scored
AHEAD, FITTED = 100.0, 25.0  # s
PUBLISHED = load_problem("esso_osaka").published["rms_100_s"]
SOURCE = (
    "1 by definition: simulator of the source's laboratory, rms "
    f"u {PUBLISHED['u_mps']} m/s, v {PUBLISHED['v_mps']} m/s, r {PUBLISHED['r_degps']} deg/s"
)


def further() -> list[Path]:
    """Logs in the data folder that are not registered."""
    known = {place(path) for path in registered("esso_osaka/")}
    return sorted(set(place("esso_osaka").glob("*.csv")) - known)


def pieces(path: Path, channels: Channels) -> list[Record]:
    """The log between its gaps in time, pieces that are too short left out.

    Raises
    ------
    DataError
        If times do not increase, or all pieces are too short.
    """
    table = load(path)
    if np.diff(table[:, 0]).min() <= 0:
        raise DataError(f"{path.name}: times do not increase. Sort its rows.")
    ends = np.flatnonzero(np.diff(table[:, 0]) > GAP) + 1
    parts = [part for part in np.split(table, ends) if part[-1, 0] - part[0, 0] >= SHORTEST]
    if not parts:
        longest = max(part[-1, 0] - part[0, 0] for part in np.split(table, ends))
        raise DataError(
            f"{path.name} is too short: its longest piece without gaps in time has {longest:.1f} s "
            f"({len(ends)} gaps); expected at least {SHORTEST:g} s. Put a longer log there."
        )
    names = [path.stem] if len(parts) == 1 else [f"{path.stem}_{k}" for k in range(len(parts))]
    return [
        record_of(part, channels, name, path.name) for part, name in zip(parts, names, strict=True)
    ]


def learn() -> Model:
    """The model with wind, fitted to the seven training runs in pieces of 25 s."""
    problem = load_problem("esso_osaka")
    train, _ = problem.data().split(test=VALIDATION)
    model = problem.variant("wind").model
    estimator = MultipleShooting(disturbances="none", noise="given")
    return estimator.fit(model, windows(train, FITTED)).model


def relative(found: np.ndarray) -> np.ndarray:
    """Rms of errors ``(n, 3)`` over the published."""
    rms = np.sqrt(np.mean(found**2, axis=0))
    return rms / [PUBLISHED["u_mps"], PUBLISHED["v_mps"], np.radians(PUBLISHED["r_degps"])]


def errors(model: Model, record: Record) -> np.ndarray:
    """Errors of u, v, r over windows of 100 s, each from its first sample, ``(n, 3)``."""
    found = []
    for part in windows(Dataset((record,)), min(AHEAD, record.duration)):
        start = dict(zip(model.state_names, part.outputs[0], strict=True))
        run = simulate_inputs(model, part.times, inputs=part.inputs, initial=start)
        found.append((run.outputs - part.outputs)[:, :3])
    return np.vstack(found)


def scored(model: Model, name: str, records: Sequence[Record]) -> Row:
    """The row of one log, which may come in pieces.

    Raises
    ------
    SimulationError
        If the model diverges in it.
    """
    ratio = relative(np.vstack([errors(model, record) for record in records]))
    if not np.isfinite(ratio).all():
        raise SimulationError(f"{model.name} diverges in it, so that no error is told.")
    note = "u {:.2f}, v {:.2f}, r {:.2f}; not fitted; ".format(*ratio) + extent(records)
    return Row(f"Esso Osaka, {name}, mean ratio", float(ratio.mean()), SOURCE, "", note)


def extent(records: Sequence[Record]) -> str:
    """How many windows of which length are scored, and what is left out at the ends."""
    lengths = [min(AHEAD, record.duration) for record in records]
    counts = [int(record.duration // own) for record, own in zip(records, lengths, strict=True)]
    left = sum(r.duration - n * own for r, n, own in zip(records, counts, lengths, strict=True))
    short = [f"{own:.0f} s" for own in lengths if own < AHEAD]
    full = sum(n for n, own in zip(counts, lengths, strict=True) if own == AHEAD)
    parts = [f"{full} window{'s' * (full > 1)} of {AHEAD:g} s"] if full else []
    if short:
        parts.append(f"{', '.join(short)} (shorter than {AHEAD:g} s, which flatters)")
    text = " and ".join(parts) + f", last {left:.0f} s left out"
    return f"{len(records)} pieces between gaps, {text}" if len(records) > 1 else text


def score() -> list[Row]:
    """A row per validation run, and per further file."""
    model = learn()
    rows = [
        scored(model, run.name, (run,))
        for run in load_problem("esso_osaka").data()
        if run.name in VALIDATION
    ]

    def one(path: Path) -> list[Row]:
        return [scored(model, path.stem, pieces(path, model.channels))]

    paths = further()
    for path in paths:
        what = f"Esso Osaka, {path.stem}, mean ratio"
        rows += attempted(what, SOURCE, path.name, partial(one, path))
    if not paths:
        what = "Esso Osaka, published test files"
        rows.append(missing(what, SOURCE, "esso_osaka/*.csv", "further logs of the source"))
    return rows
