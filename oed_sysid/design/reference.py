"""Standard manoeuvres within the same limits, to compare a design with."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np

from oed_sysid.design.corridor import Corridor
from oed_sysid.design.parametrisation import Grid
from oed_sysid.errors import OedSysidError
from oed_sysid.experiment import Experiment
from oed_sysid.information import Information
from oed_sysid.manoeuvres import Piecewise, ZigZag
from oed_sysid.model import Model
from oed_sysid.simulation import simulate, simulate_inputs
from oed_sysid.simulation.trajectory import state_names

# Attitudes on which a zigzag reverses, in order of preference.
ATTITUDES = ("psi", "theta", "phi")
_SHARES = (1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1)


@dataclass(frozen=True, eq=False)
class Reference:
    """A standard manoeuvre and what it would tell.

    Attributes
    ----------
    name : str
    experiment : Experiment
    information : Information
        Priors included, as for the design.
    note : str
        How it was made smaller to keep the limits; empty if it was not.
    """

    name: str
    experiment: Experiment
    information: Information
    note: str = ""


def zigzags(
    model: Model,
    grid: Grid,
    corridor: Corridor,
    *,
    constants: dict[str, float],
    initial: dict[str, float],
    angles: tuple[float, ...] = (5.0, 10.0),
) -> list[tuple[str, Experiment, str]]:
    """Return zigzags of one designed input that keep the limits.

    It is the first that is an angle and has room on both sides of its neutral value, as the
    angles of a zigzag mean nothing for a speed; else the first with room, else the first about
    the middle of its range. Without an attitude among the outputs or states, a square wave takes
    their place. Amplitude and switching angle are made smaller together until all limits are kept.

    Returns
    -------
    list of (name, Experiment, note)
    """
    column, neutral = _moved(model, grid)
    name = grid.inputs[column]
    known = (*model.output_names, *model.state_names)
    attitude = next((a for a in ATTITUDES if a in known), None)
    held = constants | {
        other: float(grid.neutral[i]) for i, other in enumerate(grid.inputs) if other != name
    }
    largest = float(min(grid.upper[column] - neutral, neutral - grid.lower[column]))
    rate = float(grid.rates[column]) if np.isfinite(grid.rates[column]) else None
    found = []
    for angle in angles if attitude else (0.0,):
        for share in _SHARES:
            if attitude:
                size = min(radians(angle) * share, largest)
                sign = _side(model, grid, column, neutral, attitude, held, initial)
                manoeuvre: ZigZag | Piecewise = ZigZag(
                    name, size, radians(angle) * share, feedback=(attitude,), rate=rate, sign=sign,
                    neutral=neutral,
                )  # fmt: skip
                title = f"zigzag {angle:g}/{angle:g}"
            else:
                manoeuvre = _square(grid, column, neutral, share * largest)
                title = "square wave"
            try:
                experiment = Experiment(
                    title, manoeuvre, duration=float(grid.times[-1]), sample_time=grid.step,
                    constants=held, initial=initial,
                    # A zigzag is flown on what is known best; noise would make it one of many.
                    feedback="true",
                )  # fmt: skip
                record = simulate(model, experiment, noise=False)
                run = simulate_inputs(model, record.times, inputs=record.inputs, initial=initial)
            except OedSysidError:
                continue
            if _inside(model, corridor, run.states, run.outputs):
                note = "" if share == 1.0 else f"at {share:.0%} of its angles to keep the limits"
                found.append((title, experiment, note))
                break
    return found


def _moved(model: Model, grid: Grid) -> tuple[int, float]:
    """Column of the input that a standard manoeuvre moves, and the value that it moves about."""
    room = np.minimum(grid.upper - grid.neutral, grid.neutral - grid.lower)
    able = [column for column in range(len(grid.inputs)) if room[column] > 0.0]
    units = {channel.name: channel.unit for channel in model.inputs}
    angles = [column for column in able if units[grid.inputs[column]] == "rad"]
    if not able:
        return 0, float(0.5 * (grid.lower[0] + grid.upper[0]))
    column = (angles or able)[0]
    return column, float(grid.neutral[column])


def _inside(model: Model, corridor: Corridor, states: np.ndarray, outputs: np.ndarray) -> bool:
    """Whether limits during the run are kept; what is asked of the end is waived."""
    n_states = len(state_names(model))
    for index, column in enumerate(corridor.columns):
        if corridor.at_end[index]:
            continue
        # States come first in a scene's signals, so a small column is a state.
        values = states[:, column] if column < n_states else outputs[:, column - corridor.n_full]
        if values.min() < corridor.lower[index] or values.max() > corridor.upper[index]:
            return False
    return True


def _side(
    model: Model,
    grid: Grid,
    column: int,
    neutral: float,
    attitude: str,
    held: dict[str, float],
    initial: dict[str, float],
) -> int:
    """+1 if a positive command lets the attitude grow."""
    n_times = min(len(grid.times), max(5, len(grid.times) // 10))
    times = grid.times[:n_times]
    ends = []
    for side in (-1.0, 1.0):
        size = 0.2 * (grid.upper[column] - neutral if side > 0 else neutral - grid.lower[column])
        inputs = held | {grid.inputs[column]: float(neutral + side * size)}
        run = simulate_inputs(model, times, inputs=inputs, initial=initial, throw=False)
        ends.append(float(np.nan_to_num(run.signal(attitude)[-1])))
    return 1 if ends[1] >= ends[0] else -1


def _square(grid: Grid, column: int, neutral: float, height: float) -> Piecewise:
    """Square wave of eight half-periods, within the rate limit."""
    period = np.sign(np.sin(np.pi * np.arange(len(grid.times)) * 8 / len(grid.times)) + 1e-12)
    orders = np.broadcast_to(grid.neutral, (1, len(grid.times), len(grid.inputs))).copy()
    orders[0, :, column] = neutral + height * period
    return as_piecewise(grid.inputs[column], grid.times, grid.limited(orders)[0, :, column])


def as_piecewise(name: str, times: np.ndarray, values: np.ndarray) -> Piecewise:
    """Return held commands, repeated values left out; the last time is kept."""
    keep = np.concatenate([[True], np.diff(values) != 0])
    keep[-1] = True
    return Piecewise(name, times[keep].tolist(), values[keep].tolist())
