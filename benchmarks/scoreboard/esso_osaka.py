"""Esso Osaka: 100 s ahead from the measured start, over the published simulator's error.

Files beyond the twelve that are registered, put into ``esso_osaka/`` of the data folder, are
scored as they are found; nothing was chosen or fitted with them.
"""

from __future__ import annotations

import numpy as np

from benchmarks.scoreboard.row import Row, missing, place
from oed_sysid import Dataset, MultipleShooting, Record, load_problem
from oed_sysid.data.third_party import registered
from oed_sysid.model import Model
from oed_sysid.simulation import simulate_inputs
from problems.esso_osaka.records import VALIDATION, read, windows

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
    errors = []
    for part in windows(Dataset((record,)), min(AHEAD, record.duration)):
        start = dict(zip(model.state_names, part.outputs[0], strict=True))
        run = simulate_inputs(model, part.times, inputs=part.inputs, initial=start)
        errors.append((run.outputs - part.outputs)[:, :3])
    rms = np.sqrt(np.mean(np.vstack(errors) ** 2, axis=0))
    return rms / [PUBLISHED["u_mps"], PUBLISHED["v_mps"], np.radians(PUBLISHED["r_degps"])]


def score() -> list[Row]:
    """A row per validation run, and per further file."""
    model = learn()
    runs = [run for run in load_problem("esso_osaka").data() if run.name in VALIDATION]
    known = {place(path) for path in registered("esso_osaka/")}
    further = sorted(set(place("esso_osaka").glob("*.csv")) - known)
    runs += [read(path, model.channels, name=path.stem) for path in further]
    rows = []
    for run in runs:
        ratio = ahead(model, run)
        note = "u {:.2f}, v {:.2f}, r {:.2f}; not fitted".format(*ratio)
        rows.append(
            Row(f"Esso Osaka, {run.name}, mean ratio", float(ratio.mean()), SOURCE, "", note)
        )
    if not further:
        what = "Esso Osaka, published test files"
        rows.append(missing(what, SOURCE, "esso_osaka/*.csv", "further logs of the source"))
    return rows
