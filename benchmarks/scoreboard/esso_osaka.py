"""Esso Osaka: 100 s ahead from the measured start, over the published simulator's error.

Files beyond the twelve that are registered, put into ``esso_osaka/`` of the data folder, are
scored as they are found; nothing was chosen or fitted with them. A window is 100 s long, as those
of the published errors are; what is left at the end of a record is not scored, and the note says
how much it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.scoreboard.logs import further, pieces
from benchmarks.scoreboard.row import Row, attempted, missing
from oed_sysid import Dataset, MultipleShooting, Record, load_problem
from oed_sysid.errors import SimulationError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.physics.model import Model
from problems.esso_osaka.records import VALIDATION, windows

AHEAD, FITTED = 100.0, 25.0  # s
PUBLISHED = load_problem("esso_osaka").published["rms_100_s"]
SOURCE = (
    "1 by definition: simulator of the source's laboratory, rms "
    f"u {PUBLISHED['u_mps']} m/s, v {PUBLISHED['v_mps']} m/s, r {PUBLISHED['r_degps']} deg/s"
)


def learn() -> Model:
    """The model with wind, fitted to the seven training runs in pieces of 25 s."""
    problem = load_problem("esso_osaka")
    train, _ = problem.data().split(test=VALIDATION)
    model = problem.variant("wind").model
    return (
        MultipleShooting(disturbances="none", noise="given")
        .fit(model, windows(train, FITTED))
        .model
    )


def ahead(model: Model, record: Record) -> np.ndarray:
    """Rms of u, v, r over windows of 100 s, each from its first sample, over the published."""
    return relative(errors(model, record))


def relative(found: np.ndarray) -> np.ndarray:
    """Rms of errors ``(n, 3)`` over the published."""
    rms = np.sqrt(np.mean(found**2, axis=0))
    return rms / [PUBLISHED["u_mps"], PUBLISHED["v_mps"], np.radians(PUBLISHED["r_degps"])]


def errors(model: Model, record: Record) -> np.ndarray:
    """Errors of u, v, r over the windows of a record, ``(n, 3)``."""
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
        raise SimulationError(f"{model.name} leaves the numbers in it, so that no error is told.")
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
    for path in further():
        rows += attempted(
            f"Esso Osaka, {path.stem}, mean ratio",
            SOURCE,
            path.name,
            lambda path=path: [scored(model, path.stem, pieces(path, model.channels))],
        )
    if not further():
        what = "Esso Osaka, published test files"
        rows.append(missing(what, SOURCE, "esso_osaka/*.csv", "further logs of the source"))
    return rows
