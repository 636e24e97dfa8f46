"""The sea-trial card: one page for the people on board."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees

import numpy as np

from oed_sysid.experiment import Experiment
from oed_sysid.model import Model
from oed_sysid.simulate import Trajectory

_MOST_ROWS = 24


def sea_trial_card(
    experiment: Experiment,
    model: Model,
    trajectory: Trajectory,
    accuracy: Sequence[str],
    active: Sequence[str],
) -> str:
    """Return what to run, for how long, what to watch and what to expect.

    Parameters
    ----------
    experiment : Experiment
        The manoeuvre.
    model : Model
        Behind the prediction.
    trajectory : Trajectory
        Predicted motion.
    accuracy : sequence of str
        Lines of the accuracy table.
    active : sequence of str
        Limits that the prediction reaches.
    """
    units = {s.name: s.unit for s in model.states} | {i.name: i.unit for i in model.inputs}
    units |= {o.name: o.unit for o in model.outputs if o.name not in units}
    duration = float(experiment.duration or 0.0)
    lines = [
        f"SEA TRIAL CARD   {experiment.name}   ({model.name})",
        "=" * 72,
        f"Length      {duration:g} s ({duration / 60:.1f} min); log every "
        f"{experiment.sample_time:g} s or faster",
        f"Start from  {_start(experiment, units)}",
        "            steady, controls neutral; log 10 s or more before the first command",
    ]
    if experiment.constants:
        held = ", ".join(f"{n} = {_value(v, units[n])}" for n, v in experiment.constants.items())
        lines.append(f"Hold        {held}")
    lines += ["", "Run"]
    if experiment.reacts and experiment.excitation is not None:
        lines.append(f"  {experiment.excitation.describe()}")
    else:
        lines += _orders(model, trajectory, units)
    lines += ["", "Expect (predicted range)"]
    for name in dict.fromkeys((*model.state_names, *model.output_names)):
        values = trajectory.signal(name)
        limit = experiment.limits.signals.get(name)
        bound = "" if limit is None else f"   ABORT outside {_range(*limit, units[name])}"
        lines.append(f"  {name:<10} {_range(values.min(), values.max(), units[name])}{bound}")
    lines += ["", "Watch", *(f"  reached in the prediction: {text}" for text in active)]
    if not active:
        lines.append("  no limit is reached in the prediction")
    lines += [
        "  a real vehicle differs: stop when a limit is passed, and keep the log; a part is useful",
        "",
        "Accuracy to expect (relative standard errors; white noise of the stated size)",
        *accuracy,
        "",
        "Noise assumed: "
        + ", ".join(
            f"{o.name} {o.noise_std:.3g} {o.unit}".rstrip()
            for o in model.outputs
            if o.noise_std is not None
        ),
        "Note wind, sea state, current, loading, and anything that was touched during the run.",
    ]
    return "\n".join(lines)


def _start(experiment: Experiment, units: dict[str, str]) -> str:
    given = [f"{n} = {_value(v, units[n])}" for n, v in experiment.initial.items() if v]
    return ", ".join(given) or "rest"


def _orders(model: Model, trajectory: Trajectory, units: dict[str, str]) -> list[str]:
    """Changes of the commands as rows, cut where there are many."""
    varied = [i for i, column in enumerate(trajectory.inputs.T) if np.ptp(column) > 0]
    names = [model.input_names[i] for i in varied]
    commands = trajectory.inputs[:, varied]
    rows = np.flatnonzero(np.any(np.diff(commands, axis=0) != 0, axis=1)) + 1
    lines = [f"  {'t [s]':>8}  " + "  ".join(f"{name:>14}" for name in names)]
    for row in [0, *rows[:_MOST_ROWS]]:
        cells = [
            f"{_value(value, units[name]):>14}"
            for value, name in zip(commands[row], names, strict=True)
        ]
        lines.append(f"  {trajectory.times[row]:>8.6g}  " + "  ".join(cells))
    if len(rows) > _MOST_ROWS:
        lines.append(f"  ... {len(rows) - _MOST_ROWS} more orders: play them from the CSV file")
    return lines


def _value(value: float, unit: str) -> str:
    if unit in ("rad", "rad/s"):
        return f"{degrees(value):.4g} {unit.replace('rad', 'deg')}"
    return f"{value:.4g} {unit}".rstrip()


def _range(lower: float, upper: float, unit: str) -> str:
    first = _value(lower, unit).split(" ")[0]
    return f"{first} to {_value(upper, unit)}"
