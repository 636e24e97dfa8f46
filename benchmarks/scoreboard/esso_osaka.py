"""Esso Osaka: 100 s ahead from the measured start, over the published simulator's error.

Files beyond the twelve that are registered, put into ``esso_osaka/`` of the data folder, are
scored as they are found; nothing was chosen or fitted with them. A window is 100 s long, as those
of the published errors are; what is left at the end of a record is not scored, and the note says
how much it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.scoreboard.row import Row, attempted, missing, place
from oed_sysid import Channels, Dataset, MultipleShooting, Record, load_problem
from oed_sysid.data.third_party import registered
from oed_sysid.errors import DataError, SimulationError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.physics.model import Model
from problems.esso_osaka.records import VALIDATION, load, record_of, windows

SAMPLING = 0.1  # s


GAP = 0.15  # s between rows that a record may not bridge


SHORTEST = 25.0  # s of a piece that is scored


SHIP_SPEED = 3.0  # m/s; the model reaches 0.55 m/s


# Largest sizes by column that this ship and its instruments can have reached, and their units.
LIMITS: Mapping[int, tuple[str, float, str]] = {
    2: ("u", SHIP_SPEED, "m/s"),
    4: ("v", SHIP_SPEED / 2, "m/s"),
    6: ("r", 0.5, "rad/s"),
    7: ("revolutions", 40.0, "1/s"),
    8: ("rudder", 1.0, "rad"),
    11: ("true wind", 40.0, "m/s"),
}


# Heading changes over a second may differ from the mean yaw rate by this, rms, rad/s, and share of
# the rate's own size; in the twelve registered logs they differ by 0.003 to 0.013 rad/s.
RATE_AWAY, RATE_SHARE = 0.02, 0.5


# Mean velocities over ten seconds, of positions and of u, v and heading, likewise: there by 0.002
# to 0.012 m/s.
TRACK_AWAY, TRACK_SHARE = 0.05, 0.2


def further() -> list[Path]:
    """Logs in the data folder that are not registered."""
    known = {place(path) for path in registered("esso_osaka/")}
    return sorted(set(place("esso_osaka").glob("*.csv")) - known)


def pieces(path: Path, channels: Channels, *, shortest: float = SHORTEST) -> list[Record]:
    """The log between its gaps in time, pieces that are too short left out.

    Raises
    ------
    DataError
        If a column cannot be what its place or name says, or all pieces are too short.
    """
    table = load(path)
    _check(path.name, table)
    ends = np.flatnonzero(np.diff(table[:, 0]) > GAP) + 1
    parts = [part for part in np.split(table, ends) if part[-1, 0] - part[0, 0] >= shortest]
    if not parts:
        longest = max(part[-1, 0] - part[0, 0] for part in np.split(table, ends))
        raise DataError(
            f"{path.name} is too short: its longest piece without gaps in time has {longest:.1f} s "
            f"({len(ends)} gaps); expected at least {shortest:g} s. Put a longer log there."
        )
    names = [path.stem] if len(parts) == 1 else [f"{path.stem}_{k}" for k in range(len(parts))]
    return [
        record_of(part, channels, name, path.name) for part, name in zip(parts, names, strict=True)
    ]


def _check(file: str, table: np.ndarray) -> None:
    """Refuse times, sizes, headings and positions that cannot be those of this ship."""
    steps = np.diff(table[:, 0])
    if steps.min() <= 0:
        raise DataError(
            f"{file}: times do not increase at row {int(np.argmin(steps)) + 2} of the complete "
            "ones. Is the first column the time? Sort, and leave out rows that are there twice."
        )
    step = float(np.median(steps))
    if abs(step - SAMPLING) > 0.02 * SAMPLING:
        raise DataError(f"{file}: {step:g} s between samples; expected {SAMPLING:g} s. Resample.")
    for column, (name, limit, unit) in LIMITS.items():
        largest = float(np.abs(table[:, column]).max())
        if largest > limit:
            raise DataError(
                f"{file}: {name} reaches {largest:.3g} {unit}; expected at most {limit:g} {unit}. "
                "Are columns swapped, or the units others?"
            )
    times, psi = table[:, 0], np.unwrap(table[:, 5])
    turned, rate = _differ(times, psi, table[:, 6], lag=1.0)
    away, own = _rms(turned - rate), _rms(rate)
    if away > RATE_AWAY + RATE_SHARE * own:
        raise DataError(
            f"{file}: the heading turns by {_rms(turned):.3g} rad/s, the yaw rate has {own:.3g} "
            f"rad/s, and they differ by {away:.3g} rad/s rms. Are columns swapped, or degrees "
            "given for radians?"
        )
    u, v = table[:, 2], table[:, 4]
    for axis, column, velocity in (
        ("x", 1, u * np.cos(psi) - v * np.sin(psi)),
        ("y", 3, u * np.sin(psi) + v * np.cos(psi)),
    ):
        moved, said = _differ(times, table[:, column], velocity, lag=10.0)
        if _rms(moved - said) > TRACK_AWAY + TRACK_SHARE * _rms(np.hypot(u, v)):
            raise DataError(
                f"{file}: positions {axis} move by {_rms(moved):.3g} m/s, velocities and heading "
                f"say {_rms(said):.3g} m/s, and they differ by {_rms(moved - said):.3g} m/s rms. "
                "Are columns swapped?"
            )


def _differ(
    times: np.ndarray, values: np.ndarray, rates: np.ndarray, *, lag: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean rates over a lag of a value and of its derivative; stretches with gaps left out."""
    n = min(round(lag / SAMPLING), len(times) - 1)
    sums = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]))])
    spans = times[n:] - times[:-n]
    whole = np.abs(spans - n * SAMPLING) < 0.5 * SAMPLING
    found = (values[n:] - values[:-n]) / spans, (sums[n:] - sums[:-n]) / n
    return found[0][whole], found[1][whole]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


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
    for path in further():

        def one(path: Path = path) -> list[Row]:
            return [scored(model, path.stem, pieces(path, model.channels))]

        rows += attempted(f"Esso Osaka, {path.stem}, mean ratio", SOURCE, path.name, one)
    if not further():
        what = "Esso Osaka, published test files"
        rows.append(missing(what, SOURCE, "esso_osaka/*.csv", "further logs of the source"))
    return rows
