"""Esso Osaka: turns by the rule that was made for KVLCC2's circles, unchanged.

Families, variants, settings and the score are those of ``problems/kvlcc2/structures.py``, with
what this ship's records have: wind, no measured thrust, no captive tests. A turn is replayed
with its measured rudder, revolutions and wind from the state at the execute; nothing after that
is used. Indices are of the track that u, v and heading integrate to, measured and predicted alike.

`reach` says what the same structures reach when turns are fitted too (`docs/extrapolation.md`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.harness import named
from oed_sysid import Dataset, Fit, MultipleShooting, Record, load_problem, simulate_inputs
from oed_sysid.errors import DataError, SimulationError
from oed_sysid.experiments.indices import turning_indices
from problems.esso_osaka.manoeuvring import MMG
from problems.esso_osaka.mavmm import MAVMM
from problems.esso_osaka.missing import WIND
from problems.esso_osaka.particulars import LENGTH
from problems.kvlcc2.averaging import StructureAverage, average_structures, peak_input
from problems.kvlcc2.structures import HORIZON, HORIZONS, REGRESSION, SCORED, ahead, variants

QUANTITIES = ("advance", "transfer", "tactical_diameter")
SETTLED = 30.0  # s for which an order must stand to be the turn's
STEADY_ORDER = np.radians(2.0)
BEFORE = 2.0  # s over which the state at the execute is averaged


def turn_of(record: Record) -> Record:
    """The part of a turning test from its execute on, until the rudder is moved again.

    Raises
    ------
    DataError
        If no rudder angle stands long enough.
    """
    rudder = record.input("delta")
    # A test ends in its turn, so that the later half shows the order.
    order = float(np.median(rudder[len(rudder) // 2 :]))
    held = np.abs(rudder - order) < STEADY_ORDER
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(int), [0]])))
    stretches = edges.reshape(-1, 2)
    if not len(stretches):
        raise DataError(f"Record {record.name!r} holds no rudder angle. Is it a turning test?")
    first, stop = stretches[np.argmax(stretches[:, 1] - stretches[:, 0])]
    if record.times[stop - 1] - record.times[first] < SETTLED:
        raise DataError(f"Record {record.name!r} holds no rudder angle for {SETTLED:g} s.")
    # The order was given where the rudder left its approach.
    before = np.flatnonzero(np.abs(rudder[: first + 1]) < 0.15 * abs(order))
    begin, end = (int(before[-1]) if len(before) else int(first)), int(stop) - 1
    return record.window(record.times[begin], record.times[end])


def indices_of(times: np.ndarray, states: np.ndarray) -> dict[str, float]:
    """Indices of a turn in ship lengths from u, v and psi, ``(n, 4)`` with r third."""
    u, v, psi = states[:, 0], states[:, 1], states[:, 3]
    north = np.cumsum(u * np.cos(psi) - v * np.sin(psi)) * (times[1] - times[0])
    east = np.cumsum(u * np.sin(psi) + v * np.cos(psi)) * (times[1] - times[0])
    found = turning_indices(times, north, east, psi, speed=np.hypot(u, v))
    return {name: getattr(found, name) / LENGTH for name in QUANTITIES}


def start_of(record: Record, turn: Record) -> dict[str, float]:
    """State at the execute: mean over the seconds before it."""
    before = record.window(turn.times[0] - BEFORE, turn.times[0] + 1e-6)
    names = record.channels.output_names
    return dict(zip(names, map(float, before.outputs.mean(axis=0)), strict=True))


def turns(dataset: Dataset) -> tuple[Callable[[Fit], Mapping[str, float]], dict[str, float]]:
    """What is asked of a fit, and what was measured, for some turning tests."""
    parts: list[tuple[str, Record, dict[str, float]]] = []
    measured: dict[str, float] = {}
    for record in dataset:
        turn = turn_of(record)
        parts.append((record.name, turn, start_of(record, turn)))
        found = indices_of(turn.times, turn.outputs)
        measured |= {f"{name} {record.name}": value for name, value in found.items()}

    def purpose(fit: Fit) -> dict[str, float]:
        wanted: dict[str, float] = {}
        for name, turn, start in parts:
            run = simulate_inputs(fit.model, turn.times, inputs=turn.inputs, initial=start)
            if not np.isfinite(run.outputs).all():
                raise SimulationError(f"{fit.model.name} diverges in {name}.")
            found = indices_of(turn.times, run.outputs)
            wanted |= {f"{quantity} {name}": value for quantity, value in found.items()}
        return wanted

    return purpose, measured


def predicted(train: Dataset, test: Dataset) -> tuple[StructureAverage, dict[str, float]]:
    """The rule applied: turns of ``test`` from the records of ``train``, and what was measured."""
    purpose, measured = turns(test)
    average = average_structures(
        variants(MAVMM, {"MMG": MMG + WIND}, train),
        train,
        purpose=purpose,
        strength=peak_input("delta"),
        horizon=HORIZON,
        scored=[name for name in measured if name.split()[0] in SCORED],
    )
    return average, measured


def reach() -> dict[str, dict[str, dict[str, float]]]:
    """Errors of the four turns by what was fitted: zigzags, these and the turns, the turns alone.

    What a structure errs in turns that it was fitted to is no prediction: it is what these records
    and this structure leave, and no transfer from zigzags can be expected to do better.

    Returns
    -------
    dict
        Rms error of `SCORED` over the turns, per cent, by structure and by what was fitted.
    """
    data = load_problem("esso_osaka").data()
    zigzags, circles = named(data, "zigzag"), named(data, "turn")
    purpose, measured = turns(circles)
    whole = MultipleShooting(disturbances="none")
    sets = {"zigzags": zigzags, "zigzags and turns": zigzags + circles, "turns": circles}
    families = (
        ("MAVMM, one step", MAVMM, REGRESSION),
        ("MAVMM, 10 s ahead", MAVMM, ahead(HORIZONS[0])),
        ("MAVMM, 40 s ahead", MAVMM, ahead(HORIZONS[1])),
        ("MAVMM, whole runs", MAVMM, whole),
        ("MMG, 10 s ahead", MMG + WIND, ahead(HORIZONS[0])),
        ("MMG, whole runs", MMG + WIND, whole),
    )
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name, model, estimator in families:
        found[name] = {}
        for what, fitted in sets.items():
            # Searches of the polynomial begin where its regression ended.
            start = REGRESSION.fit(model, fitted).model if model is MAVMM else model
            found[name][what] = _reached(purpose(estimator.fit(start, fitted)), measured)
    return found


def _reached(found: Mapping[str, float], measured: Mapping[str, float]) -> dict[str, float]:
    """Rms error over the turns of the advance and of the tactical diameter, per cent."""
    errors: dict[str, list[float]] = {quantity: [] for quantity in SCORED}
    for name, value in measured.items():
        if (quantity := name.split()[0]) in errors:
            errors[quantity].append(100 * (found[name] / value - 1))
    return {quantity: float(np.sqrt(np.mean(np.square(one)))) for quantity, one in errors.items()}
