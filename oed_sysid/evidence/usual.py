"""Candidates where nobody named any: what usually goes wrong, written for the model at hand.

Actuators, sensors, currents, inertia and low powers of every motion, with typical sizes from the
records: a force that would make a fifth of the accelerations seen, a lag of two samples, a play
of a tenth of the command's swing. Sizes scale the unknowns; they are no priors.

"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from math import ceil

import numpy as np

from oed_sysid.compiled.kernels import Kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.errors import DataError, ModelError, OedSysidError
from oed_sysid.evidence.check import LogCheck
from oed_sysid.evidence.dictionary import HORIZONTAL, Factors, Term, cyclic
from oed_sysid.experiments.problem import Problem
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.disturbances import disturbance, places
from oed_sysid.likelihood.start_guess import (
    check_channels,
    kinematic_states,
    measured_states,
    slope,
)
from oed_sysid.physics import Effect, Environment, Force, forces, in_each_record, signals
from oed_sysid.physics import signals as actuators
from oed_sysid.physics.frames import rotation
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.physics.table import ABKOWITZ
from oed_sysid.text import expressions
from oed_sysid.text.dimensions import dimension_of
from oed_sysid.text.units import Dimension, dimension

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


@dataclass(frozen=True)
class Sizes:
    """Typical sizes, by name.

    Attributes
    ----------
    swing : dict
        Standard deviation of every state, output and actuator signal.
    level : dict
        Root mean square of the same.
    rate : dict
        Root mean square of the rate of change of every state.
    mobility : dict
        What a unit force in an equation adds to the rate of its state.
    sample, step : float
        Median sample time and shortest integration step, s.
    """

    swing: dict[str, float]
    level: dict[str, float]
    rate: dict[str, float]
    mobility: dict[str, float]
    sample: float
    step: float

    def force(self, equation: str, state: str) -> float:
        """Force or rate in an equation that makes the accelerations seen."""
        return self.rate[state] / self.mobility[equation]


def _logged(model: Model, record: Record) -> dict[str, np.ndarray]:
    """Inputs, actuator signals that need no function of the user's, and outputs."""
    known = dict(zip(model.input_names, record.inputs.T, strict=True))
    scope = {**model.values, **known, "t": record.times, "h": record.sample_time}
    for name, text in model.actuator_signals.items():
        if not expressions.functions(text) & {f.name for f in model.functions}:
            found = expressions.to_numpy(text, scope, model.tables)
            known[name] = np.broadcast_to(found, record.times.shape)
    return known | dict(zip(model.output_names, record.outputs.T, strict=True))


def sizes_of(model: Model, dataset: Dataset) -> Sizes:
    """Sizes that a model's signals have along records, their states measured or guessed."""
    names = model.state_names
    pooled: dict[str, list[np.ndarray]] = {}
    slopes: dict[str, list[np.ndarray]] = {}
    for record in dataset:
        seen = measured_states(model, record)
        series = dict(seen)
        series |= {k: guess.series for k, guess in kinematic_states(model, record, seen).items()}
        for position, values in series.items():
            pooled.setdefault(names[position], []).append(values)
            slopes.setdefault(names[position], []).append(slope(record.times, values)[0])
        for name, column in _logged(model, record).items():
            if name not in names:
                pooled.setdefault(name, []).append(column[np.isfinite(column)])
    joined = {name: np.concatenate(parts) for name, parts in pooled.items()}
    swing = {name: float(np.std(values)) for name, values in joined.items() if values.size}
    level = {
        name: float(np.sqrt(np.mean(values**2))) for name, values in joined.items() if values.size
    }
    duration = float(np.median([record.times[-1] - record.times[0] for record in dataset]))
    rates = {
        name: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for name, parts in slopes.items()
    }
    for state in model.states:  # of a state that nothing tells, what its declaration says
        swing.setdefault(state.name, state.scale)
        level.setdefault(state.name, state.scale)
        rates.setdefault(state.name, 10.0 * state.scale / duration)
    sample = float(np.median([record.sample_time for record in dataset]))
    shortest = min(
        record.sample_time / max(ceil(record.sample_time / model.step - 1e-9), 1)
        for record in dataset
    )
    begin = {name: float(values[0]) for name, values in joined.items()}
    mobility = _mobility(model, dataset, begin)
    return Sizes(swing, level, rates, mobility, sample, shortest)


def _mobility(model: Model, dataset: Dataset, begin: dict[str, float]) -> dict[str, float]:
    """What a unit force in every equation adds to the rate of its state, at the first sample."""
    where = [place for place in places(model) if place.stage == "force"]
    forced = model + [disturbance(place) for place in where]
    kernel = Kernel(forced, compiled=False)
    record = dataset[0]
    time = 0.1 * min(model.step, record.sample_time)  # too short for damping to matter
    times = record.times[0] + np.array([0.0, time])
    own = np.array([begin.get(name, 0.0) for name in model.state_names])
    start, _ = kernel.start(own, record.inputs[0], forced.value_vector, times[0])
    run = kernel.run(
        times, record.inputs[:2], forced.value_vector, start[None, :], sensitivities=True
    )
    ends = np.asarray(run.end_sensitivities)[0]
    found = {}
    for place in where:
        state = model.axes.get(place.signal, place.signal)
        column = kernel.n_full + forced.free_names.index(disturbance(place).name)
        moved = float(ends[model.state_names.index(state), column]) / time
        found[place.signal] = abs(moved) if np.isfinite(moved) and moved else 1.0
    return found


# Share of the accelerations seen that a force makes.
OF_FORCE = 0.2
# Motions that a vehicle with a plane of symmetry couples: in the plane, and across it.
IN_PLANE, ACROSS = ("u", "w", "q"), ("v", "p", "r")
# Share of its typical speed over which dry friction changes sign.
SLOW = 0.02
# Angles whose sine turns a floating or submerged body back.
RIGHTING = {"K": "phi", "M": "theta"}


def usual_forces(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Terms of every equation that may lack one, absent."""
    units = {state.name: state.unit for state in model.states}
    units |= {channel.name: channel.unit for channel in model.inputs}
    through = {text: signal for signal, text in model.signals.items() if text in units}
    units |= {signal: units[state] for state, signal in through.items()}
    commands = commanded(model)
    units |= commands
    taken = {name.removesuffix("_prime") for name in model.free_names}
    for equation in sizes.mobility:
        state = model.axes.get(equation, equation)
        size = OF_FORCE * sizes.force(equation, state)
        for word, text, factors, level in _powers(model, sizes, equation, state, through, commands):
            term = Term(equation, text, factors)
            if size > 0 and level > 0 and term.symbol not in taken:
                yield _named(term.effect(model, units, size / level), word, equation, text)
        if size > 0 and not model.axes and state not in cyclic(model):
            yield forces.coulomb_friction(
                f"friction_{state}", equation, state, unit=_rate_unit(units[state]),
                velocity_unit=units[state], smooth=SLOW * sizes.level[state], scale=size,
            )  # fmt: skip


def _named(force: Force, word: str, equation: str, text: str) -> Force:
    """A term of the dictionary under a name that says what it is."""
    kind, _, signal = word.partition("_")
    return replace(
        force,
        name="_".join(part for part in (kind, equation, signal) if part),
        description=f"constant {equation}" if text == "1" else f"{text} in the {equation} equation",
        source=ABKOWITZ,
        needs=f"{signal} of varied size" if signal else "a steady part of the motion",
    )


def _rate_unit(unit: str) -> str:
    return str(Dimension((dimension(unit) / dimension("s")).exponents))


_Power = tuple[str, str, Factors, float]


def _powers(
    model: Model,
    sizes: Sizes,
    equation: str,
    state: str,
    through: dict[str, str],
    commands: dict[str, str],
) -> Iterator[_Power]:
    """Word, text, factors and typical size of every term that an equation may lack."""
    yield "constant", "1", (), 1.0
    for other in _coupled(model, equation, state):
        signal, level = through.get(other, other), sizes.level[other]
        plain, absolute = (signal, False), (signal, True)
        forward = through.get("u", "u")
        even = equation == "X" and other != "u"  # drag does not know starboard from port
        if even:
            yield f"quadratic_{signal}", f"{signal}**2", (plain, plain), level**2
            continue
        if "u" in model.axes.values() and other != "u":
            speed = sizes.level["u"]
            factors = ((forward, False), plain)
            yield f"lift_{signal}", f"{forward}*{signal}", factors, level * speed
        else:
            yield f"linear_{signal}", signal, (plain,), level
        yield f"quadratic_{signal}", f"abs({signal})*{signal}", (absolute, plain), level**2
        if not model.axes or (other == state and other != "u"):
            yield f"cubic_{signal}", f"{signal}**3", (plain,) * 3, level**3
    yield from _of_commands(model, sizes, equation, through, commands)
    angle = RIGHTING.get(equation)
    if angle in model.state_names:
        yield f"righting_{angle}", f"sin({angle})", (), sizes.level[angle]
        thrice = ((angle, False),) * 3  # a hull that hardens or softens as it heels
        yield f"hardening_{angle}", f"{angle}**3", thrice, sizes.level[angle] ** 3


def _of_commands(
    model: Model,
    sizes: Sizes,
    equation: str,
    through: dict[str, str],
    commands: dict[str, str],
) -> Iterator[_Power]:
    """What a deflection or a thrust does that no derivative holds."""
    for signal, unit in commands.items():
        level = sizes.level.get(signal, 0.0)
        twice = ((signal, False),) * 2
        if equation == "X" and unit == "rad":
            yield f"drag_{signal}", f"{signal}**2", twice, level**2
        elif equation == "X" and "u" in model.axes.values() and unit != "m/s":
            forward = through.get("u", "u")  # thrust falls with the speed of advance
            pair, size = ((forward, False), (signal, False)), level * sizes.level["u"]
            yield f"advance_{signal}", f"{forward}*{signal}", pair, size
        elif not model.axes:
            one, size = (signal, False), level**2
            yield f"quadratic_{signal}", f"abs({signal})*{signal}", ((signal, True), one), size


def _coupled(model: Model, equation: str, state: str) -> list[str]:
    """States whose motion an equation is expected to know, its own first."""
    if not model.axes:
        still = cyclic(model)
        others = [name for name in model.state_names if name != state and name not in still]
        return [state, *others]
    moving = list(model.axes.values())
    for plane in (IN_PLANE, ACROSS):
        if state in plane and equation != "X":
            moving = [name for name in moving if name in plane and name != "u"]
    return sorted(moving, key=lambda name: name != state)


def commanded(model: Model) -> dict[str, str]:
    """Actuator signals and their units, which follow from those of inputs and parameters."""
    units = {channel.name: channel.unit for channel in model.inputs}
    known = units | {p.name: p.unit for p in model.all_parameters}
    return {
        signal: units[text] if text in units else _unit(text, known)
        for signal, text in model.actuator_signals.items()
    }


def _unit(text: str, units: dict[str, str]) -> str:
    """Unit of an expression, radians dropped as in those of derivatives; empty if not told."""
    try:
        found = dimension_of(text, {name: dimension(unit) for name, unit in units.items()})
    except OedSysidError:  # units that do not fit are another message's matter
        return ""
    return "" if found is None else str(Dimension(found.exponents))


# Share of a signal's swing, and of a lift, that an effect makes.
OF_SWING, OF_LIFT = 0.1, 0.2
# A lag in samples, the longest delay in samples, and the most steps that its register may hold.
LAG, DELAY, LONGEST = 2.0, 4.0, 12
# An input in this unit or with such a name is no command but a measured flow.
FLOW_UNIT, FLOWS = "m/s", ("wind", "wave", "current")
# Names of twins that have nothing in common.
SIDES = ("port", "starboard", "left", "right", "upper", "lower")


def usual_commands(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Offsets, gains and what actuators do to commands, of each and of several alike."""
    units = {
        signal: unit
        for signal, unit in commanded(model).items()
        if sizes.swing.get(signal, 0.0) > 0 and unit != FLOW_UNIT and not signal.startswith(FLOWS)
    }
    alike: dict[tuple[str, str], list[str]] = {}
    for signal, unit in units.items():
        alike.setdefault((unit, _stem(signal)), []).append(signal)
    for signal, unit in units.items():
        share = OF_SWING * sizes.swing[signal]
        yield actuators.actuator_offset(f"{signal}_offset", signal, unit, scale=share)
        if len(alike[unit, _stem(signal)]) > 1:  # of one alone, free derivatives are its gain
            yield actuators.actuator_gain_error(f"{signal}_gain", signal)
        if unit == "rad":
            bend = OF_LIFT / sizes.swing[signal] ** 2
            yield actuators.stall(f"{signal}_stall", signal, scale=bend)
        yield from _moved((signal,), unit, sizes)
    for (unit, _), together in alike.items():
        if len(together) > 1:
            yield from _moved(together, unit, sizes)


def _stem(signal: str) -> str:
    """What the names of twins have in common: ``n`` of ``n_l``, nothing of ``port``."""
    first = re.split(r"[_\d]", signal)[0]
    return "" if first in SIDES else first


def _moved(signals: Sequence[str], unit: str, sizes: Sizes) -> Iterator[Effect]:
    """What actuators do to their commands: of one, or of several alike."""
    name, lag = "_".join(signals), LAG * sizes.sample
    swing = float(np.mean([sizes.swing[signal] for signal in signals]))
    share = OF_SWING * swing
    yield actuators.actuator_lag(f"{name}_lag", signals, scale=lag)
    if DELAY * sizes.sample <= LONGEST * sizes.step:
        yield actuators.actuator_delay(
            f"{name}_delay", signals, max_delay=DELAY * sizes.sample, step=sizes.step,
            scale=0.5 * lag,
        )  # fmt: skip
    yield actuators.rate_limit(f"{name}_rate_limit", signals, unit, scale=lag / swing)
    yield actuators.deadband(f"{name}_deadband", signals, unit, scale=share)
    yield actuators.backlash(f"{name}_backlash", signals, unit, scale=share)


# Share of the speed that a current has, and of the accelerations seen that a load makes.
OF_SPEED, OF_LOAD = 0.1, 0.2


def usual_surroundings(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Currents, winds and weight that a model can take, absent."""
    yield from _flows(model, sizes)
    yield from _winds(model, sizes)
    yield from _weights(model, sizes)


def _flows(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Currents: in the flow where the model has one, else as a drift of its positions."""
    states = {text: signal for signal, text in model.signals.items() if text in model.state_names}
    angles = set(model.state_names)
    speed = sizes.level.get("u", 1.0)
    if {"u", "v", "w"} <= set(states) and {"phi", "theta", "psi"} <= angles:
        yield _current(states, OF_SPEED * speed)
    elif {"u", "v"} <= set(states) and "psi" in angles:
        flow = (states["u"], states["v"])
        yield forces.current_horizontal_plane(flow=flow, scale=OF_SPEED * speed)
    elif "u" in states and "psi" in angles and "v" not in angles:
        yield _head_current(states["u"], OF_SPEED * speed)
    if {"u", "w"} <= set(states) and "theta" in angles and "v" not in states:
        flow = (states["u"], states["w"])
        yield forces.current_forward(flow=flow, scale=OF_SPEED * speed)
        yield forces.current_down(flow=flow, scale=0.5 * OF_SPEED * speed)
    if "u" not in states and model.axes:
        yield from _drifts(model, OF_SPEED * speed)


def _drifts(model: Model, speed: float) -> Iterator[Effect]:
    """Currents of a model without a flow: its positions move by themselves."""
    for state in model.states:
        if state.name in (*HORIZONTAL, "z", "zeta") and state.name in model.kinematics:
            name = f"drift_{state.name}"
            size = Parameter(f"E_{name}", 0.0, f"{state.unit}/s", scale=speed)
            yield Force(
                name,
                {state.name: size.name},
                (size,),
                description=f"current that carries the vehicle along {state.name}",
                source=forces.CURRENT,
                needs=f"{state.name} and velocities through the water",
            )


def _current(flow: dict[str, str], scale: float) -> Effect:
    """A current towards north, east and down on a vehicle of any attitude."""
    towards = [
        Parameter(f"E_current_{way}", 0.0, "m/s", -20 * scale, 20 * scale, scale=scale)
        for way in ("north", "east", "down")
    ]
    # Columns of the rotation to north, east and down are axes of the body.
    columns = zip(*rotation(("phi", "theta", "psi")), strict=True)
    terms = {
        flow[state]: flow[state]
        + "".join(f" - {size.name}*({text})" for size, text in zip(towards, column, strict=True))
        for state, column in zip("uvw", columns, strict=True)
    }
    return Environment(
        "current",
        terms,
        tuple(towards),
        description="steady current",
        source=forces.CURRENT,
        needs="position or velocity over ground, on several headings",
    )


def _head_current(flow: str, scale: float) -> Effect:
    """A current of which a vehicle without sway meets the part along its heading."""
    north, east = (
        Parameter(f"E_current_{way}", 0.0, "m/s", -20 * scale, 20 * scale, scale=scale)
        for way in ("north", "east")
    )
    return Environment(
        "current",
        {flow: f"{flow} - ({north.name}*cos(psi) + {east.name}*sin(psi))"},
        (north, east),
        description="steady horizontal current along the heading",
        source=forces.CURRENT,
        needs="velocity over ground, on several headings",
    )


def _weights(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Weight in water, where an angle turns it."""
    if "Z" not in model.axes or not {"phi", "theta"} & set(model.state_names):
        return
    size = Parameter("E_weight", 0.0, "N", scale=OF_LOAD * sizes.force("Z", model.axes["Z"]))
    pulls = zip("XYZ", rotation(model.state_names)[2], strict=True)
    yield Force(
        "weight",
        {a: f"{size.name}*({text})" for a, text in pulls if a in model.axes and text != "0"},
        (size,),
        description="weight less buoyancy differs from its nominal value",
        source=forces.WEIGHT,
        needs="several pitch angles",
    )


def _winds(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """A steady wind, where the heading is a state."""
    axes = tuple(axis for axis in ("X", "Y", "N") if axis in model.axes)
    if not {"X", "Y"} <= set(axes) or "psi" not in model.state_names:
        return
    across = sizes.force("Y", model.axes["Y"])
    arm = sizes.force("N", model.axes["N"]) / across if "N" in axes and across > 0 else 1.0
    yield forces.steady_wind(axes=axes, force=OF_LOAD * across or 1.0, arm=arm or 1.0)
