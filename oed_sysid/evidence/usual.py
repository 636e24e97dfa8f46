"""Candidates where nobody named any: what usually goes wrong, written for the model at hand.

Actuators, sensors, currents, inertia and low powers of every motion, with typical sizes from the
records: a force that would make a fifth of the accelerations seen, a lag of two samples, a play
of a tenth of the command's swing. Sizes scale the unknowns; they are no priors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatch

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError
from oed_sysid.evidence.dictionary import HORIZONTAL
from oed_sysid.evidence.log_check import LogCheck
from oed_sysid.evidence.sizes import Sizes, sizes_of
from oed_sysid.evidence.usual_commands import LAG, OF_SWING, usual_commands
from oed_sysid.evidence.usual_forces import usual_forces
from oed_sysid.evidence.usual_surroundings import usual_surroundings
from oed_sysid.experiments.problem import Problem
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.physics import Effect, forces, in_each_record, signals
from oed_sysid.physics.model import Model

# Share of an inertia that an effect makes.
OF_INERTIA = 0.2
# Longest delay of a signal that came late, over that which the check found.
OF_DELAY = 2.0
# What is steady in a record and another in the next: trims, currents and winds.
FROM_DAY_TO_DAY = ("*_offset", "current*", "drift_*", "wind")


def usual_effects(model: Model, dataset: Dataset) -> tuple[Effect, ...]:
    """Candidate effects made from a model's own signals and the records' sizes.

    Parameters
    ----------
    model : Model
        The nominal model.
    dataset : Dataset
        Records that it is to be compared with.

    Returns
    -------
    tuple of Effect
        Absent, each with a name of its own; terms whose derivative is free in the model already
        are left out.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> problem = load_problem("remus_diving_plane")
    >>> [e.name for e in usual_effects(problem.model, problem.data())][:3]
    ['constant_X', 'linear_X_u_r', 'quadratic_X_u_r']
    """
    check_channels(model, dataset)
    sizes = sizes_of(model, dataset)
    found: dict[str, Effect] = {}
    made = (
        *usual_forces(model, sizes),
        *usual_surroundings(model, sizes),
        *_inertias(model, sizes),
        *usual_commands(model, sizes),
        *_sensors(model, sizes),
    )
    own = [
        in_each_record(effect)
        for effect in made
        if len(dataset) > 1 and any(fnmatch(effect.name, kind) for kind in FROM_DAY_TO_DAY)
    ]
    for effect in (*made, *own):
        if effect.name in model.effect_names or effect.name in found:
            continue
        try:
            model + effect
        except ModelError:  # a signal that this model writes in its own way
            continue
        found[effect.name] = effect
    return tuple(found.values())


def _inertias(model: Model, sizes: Sizes) -> Iterator[Effect]:
    for axis, state in model.axes.items():
        mass = 1.0 / sizes.mobility[axis]
        yield forces.added_mass_error(
            f"inertia_{axis}_{state}", axis, state, scale=OF_INERTIA * mass, bound=0.5 * mass
        )


def _sensors(model: Model, sizes: Sizes) -> Iterator[Effect]:
    measured = {output.name: output for output in model.outputs}
    for name, output in measured.items():
        swing = sizes.swing.get(name, 0.0)
        if swing <= 0:
            continue
        # Only positions show where the vehicle went, and so that its compass is off.
        is_position = name in HORIZONTAL and output.unit == "m"
        if not is_position and (name != "psi" or set(HORIZONTAL) & set(measured)):
            yield signals.sensor_bias(f"bias_{name}", name, output.unit, scale=OF_SWING * swing)
            yield signals.sensor_scale(f"scale_{name}", name)
        yield signals.sensor_lag(f"lag_{name}", name, scale=LAG * sizes.sample)
    for across, rate in (("v", "r"), ("w", "q")):
        if {"u", across} <= set(measured):
            yield signals.sensor_misalignment(f"misalignment_u_{across}", "u", across)
        if {across, rate} <= set(measured):
            arm = OF_SWING * sizes.swing[across] / max(sizes.swing[rate], 1e-300)
            yield signals.sensor_lever_arm(f"lever_arm_{across}", across, rate, scale=arm)


def equipped(problem: Problem, dataset: Dataset | None = None) -> Problem:
    """Return the problem, with usual candidates where it names none.

    Parameters
    ----------
    problem : Problem
    dataset : Dataset, optional
        Records that give the sizes; by default what its experiments would give.
    """
    if problem.effects:
        return problem
    if dataset is None:
        runs = [simulate(problem.model, run, noise=False) for run in problem.experiments.values()]
        if not runs:
            return problem
        dataset = Dataset(tuple(runs))
    return replace(problem, effects=usual_effects(problem.model, dataset))


def settled(
    model: Model,
    dataset: Dataset,
    candidates: Sequence[Effect] | None,
    log: LogCheck | None = None,
) -> tuple[tuple[Effect, ...], list[str]]:
    """The candidates that were named, or usual ones and a note that says so.

    Signals that a check of the logs found late bring a candidate of their own.
    """
    if candidates:
        return tuple(candidates), []
    if dataset.only_tests:
        raise DataError(
            "These records are independent tests at given motion (captive tests), from which no "
            "usual candidates are made: name candidates= yourself, in the signals of the model."
        )
    usual = usual_effects(model, dataset)
    if not usual:
        raise DataError(
            "There is no candidate effect, and none can be made: the signals of these records do "
            "not move. Give records of a manoeuvre, or effects of your own."
        )
    late = _late(dataset, log)
    notes = [
        f"No candidates were named: {len(usual)} usual ones were made from the model's signals and "
        "the records' sizes. Where you know the vehicle's own physics, name it: that tells more."
    ]
    if late:
        names = ", ".join(effect.name for effect in late)
        notes.append(f"The check of the logs finds signals that come late: {names} added to them.")
    return (*usual, *late), notes


def _late(dataset: Dataset, log: LogCheck | None) -> tuple[Effect, ...]:
    """Delays of single sensors that a check found."""
    step = min(record.sample_time for record in dataset)
    measured = dataset.channels.output_names
    found = []
    for finding in () if log is None else log.serious:
        size = finding.size or 0.0
        if finding.kind != "delay" or len(finding.signals) > 1 or not size > 0.0:
            continue
        (signal,) = finding.signals
        if signal in measured:
            most = OF_DELAY * size + 2.0 * step
            found.append(
                signals.sensor_delay(
                    f"delay_{signal}", signal, max_delay=most, interval=step, scale=size
                )
            )
    return tuple(found)
