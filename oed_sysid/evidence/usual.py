"""Candidates where nobody named any: what usually goes wrong, written for the model at hand.

Low powers of every motion, currents, winds and weight, inertia, actuators and sensors: selections
from the library of effects, with typical sizes from the records: a force that would make a fifth
of the accelerations seen, a lag of two samples, backlash of a tenth of the command's standard
deviation. Sizes scale the unknowns; they are no priors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import ceil, prod
from typing import Any

import numpy as np

from oed_sysid.compiled.graph import ways
from oed_sysid.compiled.kernels import Kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.errors import DataError, ModelError, OedSysidError
from oed_sysid.evidence.check import LogCheck
from oed_sysid.evidence.propose import HORIZONTAL, Factors, Term, cyclic, product_text
from oed_sysid.evidence.sentences import SAYS, say
from oed_sysid.evidence.study import total_error
from oed_sysid.experiments.problem import Problem
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.between_records import FEWEST
from oed_sysid.likelihood.disturbances import (
    disturbance,
    equation_units,
    places,
    vehicle_axes,
)
from oed_sysid.likelihood.start_guess import (
    check_channels,
    kinematic_states,
    measured_states,
    slope,
)
from oed_sysid.physics import Effect, Environment, Force, amplitude, forces, signals
from oed_sysid.physics.candidates import listed
from oed_sysid.physics.frames import rotation
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.physics.table import ABKOWITZ, POLYNOMIAL, SOURCES
from oed_sysid.physics.variants import BY_RECORD, day_to_day
from oed_sysid.text import expressions
from oed_sysid.text.dimensions import dimension_of
from oed_sysid.text.units import dimension

# Typical sizes, as shares of the accelerations, inertia and lift seen, and of what signals do.
SHARE = 0.2
# A lag in samples, half of the shortest period that they show.
LAG = 0.5 * FEWEST
# Most steps that the register of a delay may hold.
LONGEST = 12
# Motions that a vehicle with a plane of symmetry couples: in the plane, and across it.
IN_PLANE, ACROSS = ("u", "w", "q"), ("v", "p", "r")
# Angles whose sine turns a floating or submerged body back.
RIGHTING = {"K": "phi", "M": "theta"}
# An input in this unit or with such a name is no command but a measured flow.
FLOW_UNIT, FLOWS = "m/s", ("wind", "wave", "current")


class Sizes:
    """Typical sizes of signals along records, by name; states are measured or guessed.

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
    reach : dict
        Largest magnitude of every state.
    reversing : frozenset of str
        What goes both ways.
    sample, step, duration : float
        Median sample time, shortest integration step and median duration of a record, s.
    """

    def __init__(self, model: Model, dataset: Dataset) -> None:
        pairs = [(record, _states(model, record)) for record in dataset]
        joined = _joined([series | _others(model, record) for record, series in pairs])
        rates = _joined(
            [{name: slope(r.times, values)[0] for name, values in of.items()} for r, of in pairs]
        )
        self.sample = float(np.median([record.sample_time for record in dataset]))
        self.step = min(
            r.sample_time / max(ceil(r.sample_time / model.step - 1e-9), 1) for r in dataset
        )
        self.duration = float(np.median([r.times[-1] - r.times[0] for r in dataset]))
        declared = {state.name: state.scale for state in model.states}  # where nothing tells one
        slow = {name: 10.0 * scale / self.duration for name, scale in declared.items()}
        self.swing = declared | _each(np.std, joined)
        self.level = declared | _each(total_error, joined)
        self.rate = slow | _each(total_error, rates)
        self.mobility = _mobility(model, dataset, _each(lambda values: values[0], joined))
        self.reach = _each(lambda values: np.max(np.abs(values)), joined)
        self.reversing = frozenset(name for name, v in joined.items() if v.min() < 0.0 < v.max())

    @property
    def time(self) -> float:
        """A time between those that the samples and the records show, s."""
        return float(np.sqrt(self.sample * self.duration))

    def force(self, equation: str, state: str) -> float:
        """Force or rate in an equation that makes the accelerations seen."""
        return self.rate[state] / self.mobility[equation]


def _each(size: Callable[[np.ndarray], float], of: dict[str, np.ndarray]) -> dict[str, float]:
    """A size of every signal."""
    return {name: float(size(values)) for name, values in of.items()}


def _joined(parts: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """All records of every signal that has a sample."""
    names = dict.fromkeys(name for part in parts for name in part)
    found = {name: np.concatenate([part[name] for part in parts if name in part]) for name in names}
    return {name: series for name, series in found.items() if series.size}


def _states(model: Model, record: Record) -> dict[str, np.ndarray]:
    """States that are measured, or follow from what is by kinematics."""
    seen = measured_states(model, record)
    seen |= {k: guess.series for k, guess in kinematic_states(model, record, dict(seen)).items()}
    return {model.state_names[k]: series for k, series in seen.items()}


def _others(model: Model, record: Record) -> dict[str, np.ndarray]:
    """Inputs, actuator signals and outputs that are no states."""
    known = dict(zip(model.input_names, record.inputs.T, strict=True))
    scope = {**model.values, **known, "t": record.times, "h": record.sample_time}
    own = {function.name for function in model.functions}
    for name, text in model.actuator_signals.items():
        if not expressions.functions(text) & own:
            found = expressions.to_numpy(text, scope, model.tables)
            known[name] = np.broadcast_to(found, record.times.shape)
    known |= dict(zip(model.output_names, record.outputs.T, strict=True))
    return {n: c[np.isfinite(c)] for n, c in known.items() if n not in model.state_names}


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
    sizes = Sizes(model, dataset)
    found: dict[str, Effect] = {}
    kinds = (
        _forces, _resistances, _hidden_states, _waves, _flows, _winds, _weights, _inertias,
        _commands, _sensors,
    )  # fmt: skip
    made = [effect for kind in kinds for effect in kind(model, sizes)]
    own = day_to_day(made) if len(dataset) > 1 else []
    for effect in (*made, *own):
        if effect.name in model.effect_names or effect.name in found:
            continue
        try:
            model + effect
        except ModelError:  # a signal that this model writes in its own way
            continue
        found[effect.name] = effect
    return tuple(found.values())


def _units(model: Model) -> dict[str, str]:
    return {state.name: state.unit for state in model.states}


def _sized(model: Model, sizes: Sizes) -> Iterator[tuple[str, str, float]]:
    """Equations with their states and typical forces, where these are above zero."""
    for equation in sizes.mobility:
        state = model.axes.get(equation, equation)
        size = SHARE * sizes.force(equation, state)
        if size > 0:
            yield equation, state, size


def _forces(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Terms of every equation that may lack one, absent."""
    units = _units(model) | {channel.name: channel.unit for channel in model.inputs}
    through = {text: signal for signal, text in model.signals.items() if text in units}
    units |= {signal: units[state] for state, signal in through.items()}
    commands = commanded(model)
    units |= commands
    levels = {through.get(name, name): level for name, level in sizes.level.items()}
    taken = {name.removesuffix("_prime") for name in model.free_names}
    for equation, state, size in _sized(model, sizes):
        for word, factors in _products(model, equation, state, through, commands):
            text = product_text(factors) or "1"
            level = prod(levels.get(name, 0.0) for name, _ in factors)
            if word.startswith("righting"):
                text, factors = f"sin({text})", ()
            term = Term(equation, text, factors)
            if level > 0 and term.symbol not in taken:
                yield _named(term.effect(model, units, size / level), word, equation, text)


def _per(load: str, unit: str) -> str:
    """Unit of a force over another."""
    return str((dimension(load) / dimension(unit)).plain)


def _equations(model: Model, sizes: Sizes) -> Iterator[dict[str, Any]]:
    """What rows of the table ask of every equation that may lack a force.

    Its state, typical force and units, and the position of the state. Coordinates that merely
    integrate a velocity lack none.
    """
    units, still, loads = _units(model), cyclic(model), equation_units(model)
    for name, state, size in _sized(model, sizes):
        if state in still:
            continue
        load = loads[name] if model.axes else str(dimension(loads[name]).plain)
        places = [p for p, text in model.kinematics.items() if text == state and p in units]
        facts = {"equation": name, "state": state, "size": size, "load": load}
        yield facts | {"unit": units[state], "position": next(iter(places), "")}


def _resistances(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Dry friction of every motion, end stops of coordinates on which a force may depend."""
    equations, units = [*_equations(model, sizes)], _units(model)
    for one in equations:
        if one["state"] in sizes.reversing:  # of one sign: a constant
            yield from listed("usual_friction", **one, level=sizes.level[one["state"]])
    for one in equations:
        position = one["position"]
        reach, unit = sizes.reach.get(position, 0.0), units.get(position, "")
        if reach > 0 and position not in (*HORIZONTAL, "psi"):
            per = _per(one["load"], unit)
            yield from listed(
                "usual_stop", **one, reach=reach, per_position=per, position_unit=unit
            )


def _hidden_states(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Forces through hidden states with free poles, driven by the own motion or a command."""
    commands = {} if len(model.axes) > 1 else commanded(model)
    for one in _equations(model, sizes):
        load, scale = one["load"], one["size"] / (sizes.level[one["state"]] or 1.0)
        facts = one | {"time": sizes.time, "per_motion": _per(load, one["unit"])}
        yield from listed("usual_memory", **facts, scale=scale)
        for signal, its in commands.items():
            if sizes.swing.get(signal, 0.0) > 0 and its:
                level, per = sizes.level[signal], _per(load, its)
                yield from listed("usual_command_memory", **facts, signal=signal, its=its,
                                  its_level=level, per_signal=per)  # fmt: skip


def _waves(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """A periodic force in every equation, of any frequency that the records tell."""
    # As periods of innovations are searched.
    low, high = 2.0 * np.pi * FEWEST / sizes.duration, 2.0 * np.pi / (FEWEST * sizes.sample)
    for one in _equations(model, sizes) if high > low else ():
        yield from listed("usual_wave", **one, low=low, high=high)


def _named(force: Force, word: str, equation: str, text: str) -> Force:
    """A term of the dictionary under a name that says what it is."""
    kind, _, signal = word.partition("_")
    # Drag, lift and trims are physics, other powers terms of a series. Where the equation is the
    # rate of a state, only its own square is a drag.
    squared = kind == "quadratic" and equation not in "XYZKMN" and signal != equation
    is_series = squared or kind in ("cubic", "hardening")
    return replace(
        force,
        name="_".join(part for part in (kind, equation, signal) if part),
        description=f"constant {equation}" if text == "1" else f"{text} in the {equation} equation",
        source=POLYNOMIAL if is_series else ABKOWITZ,
        needs=f"{signal} of varied size" if signal else "a steady part of the motion",
    )


def _products(
    model: Model, equation: str, state: str, through: dict[str, str], commands: dict[str, str]
) -> Iterator[tuple[str, Factors]]:
    """Word and factors of every product of motions and commands that an equation may lack."""
    yield "constant", ()
    surges = "u" in model.axes.values()
    forward = (through.get("u", "u"), False)
    for other in _coupled(model, equation, state):
        signal = through.get(other, other)
        plain, absolute = (signal, False), (signal, True)
        if equation == "X" and other != state:  # drag does not know starboard from port
            yield f"quadratic_{signal}", (plain, plain)
            continue
        lifts = surges and other != "u"
        yield (f"lift_{signal}", (forward, plain)) if lifts else (f"linear_{signal}", (plain,))
        yield f"quadratic_{signal}", (absolute, plain)
        if not model.axes or (other == state and other != "u"):
            yield f"cubic_{signal}", (plain,) * 3
    yield from _of_commands(model, equation, commands)
    angle = RIGHTING.get(equation)
    if angle in model.state_names:
        yield f"righting_{angle}", ((angle, False),)
        yield f"hardening_{angle}", ((angle, False),) * 3  # or softens as it heels


def _of_commands(
    model: Model, equation: str, commands: dict[str, str]
) -> Iterator[tuple[str, Factors]]:
    """Word and factors of every product with a command."""
    for signal, unit in commands.items():
        plain = (signal, False)
        if equation == "X" and unit == "rad":
            yield f"drag_{signal}", (plain, plain)
        elif not model.axes:
            yield f"quadratic_{signal}", ((signal, True), plain)


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
    found = {}
    for signal, text in model.actuator_signals.items():
        try:
            of = dimension_of(text, {name: dimension(unit) for name, unit in known.items()})
        except OedSysidError:  # units that do not fit are another message's matter
            of = None
        found[signal] = units.get(text, "" if of is None else str(of.plain))
    return found


def _flows(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Currents: in the flow where the model has one, else as a drift of its positions."""
    flow = {text: signal for signal, text in model.signals.items() if text in model.state_names}
    angles = set(model.state_names)
    scale = SHARE * sizes.level.get("u", 1.0)
    if {"u", "v", "w"} <= set(flow) and {"phi", "theta", "psi"} <= angles:
        # Columns of the rotation to north, east and down are axes of the body.
        axes = zip(*rotation(("phi", "theta", "psi")), strict=True)
        turned = {flow[state]: column for state, column in zip("uvw", axes, strict=True)}
        yield _current(("north", "east", "down"), turned, scale, "steady current")
    elif {"u", "v"} <= set(flow) and "psi" in angles:
        pair = (flow["u"], flow["v"])
        yield forces.current_horizontal_plane(flow=pair, scale=scale)
    elif "u" in flow and "psi" in angles and "v" not in angles:
        # A vehicle without sway meets the part of it along its heading.
        what = "steady horizontal current along the heading"
        along = {flow["u"]: ("cos(psi)", "sin(psi)")}
        yield _current(("north", "east"), along, scale, what)
    dives = "theta" in angles and "v" not in flow
    if dives and {"u", "w"} <= set(flow):
        pair = (flow["u"], flow["w"])
        yield forces.current_forward(flow=pair, scale=scale)
        yield forces.current_down(flow=pair, scale=0.5 * scale)
    if "u" not in flow:
        yield from _drifts(model, scale)


def _drifts(model: Model, scale: float) -> Iterator[Effect]:
    """A current that carries positions along, where forces do not know the flow."""
    still, angles = cyclic(model), {state.name for state in model.states if state.unit == "rad"}
    for state in model.states:
        # An angle turns velocities into its rate; or it is a distance run, on which nothing hangs.
        turned = angles & expressions.names(model.kinematics.get(state.name, "0"))
        named = model.axes and state.name in {*HORIZONTAL, "z", "zeta"} & model.kinematics.keys()
        if named or (state.unit == "m" and (turned or state.name in still)):
            name = f"drift_{state.name}"
            size = Parameter(f"E_{name}", 0.0, f"{state.unit}/s", scale=scale)
            yield Force(
                name,
                {state.name: size.name},
                (size,),
                description=f"current that carries the vehicle along {state.name}",
                source=SOURCES["CURRENT"],
                needs=f"{state.name} and velocities through the water",
            )


def _current(
    ways: Sequence[str], turned: Mapping[str, Sequence[str]], scale: float, description: str
) -> Effect:
    """A current in some directions; ``turned`` has its parts along each velocity of the flow."""
    towards = [amplitude(f"current_{way}", "m/s", scale=scale) for way in ways]
    terms = {
        flow: flow
        + "".join(f" - {size.name}*({text})" for size, text in zip(towards, parts, strict=True))
        for flow, parts in turned.items()
    }
    over = "velocity over ground, on several headings"
    return Environment(
        "current",
        terms,
        tuple(towards),
        description=description,
        source=SOURCES["CURRENT"],
        needs=over if len(ways) == 2 else f"position or {over}",
    )


def _weights(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Weight in water, where an angle turns it."""
    axes = vehicle_axes(model)
    if "Z" not in axes or not {"phi", "theta"} & set(model.state_names):
        return
    size = amplitude("weight", _load(model, "Z"), scale=SHARE * sizes.force(*axes["Z"]))
    pulls = zip("XYZ", rotation(model.state_names)[2], strict=True)
    yield Force(
        "weight",
        {axes[a][0]: f"{size.name}*({text})" for a, text in pulls if a in axes and text != "0"},
        (size,),
        description="weight less buoyancy differs from its nominal value",
        source=SOURCES["WEIGHT"],
        needs="several pitch angles",
    )


def _load(model: Model, axis: str) -> str:
    """Unit of the force of an axis: an acceleration where the equation is a rate."""
    load = equation_units(model)[vehicle_axes(model)[axis][0]]
    return load if model.axes else str(dimension(load).plain)


def _winds(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """A steady wind, where the heading is a state."""
    known = vehicle_axes(model)
    axes = {axis: known[axis] for axis in "XYN" if axis in known}
    if not {"X", "Y", "psi"} <= axes.keys() | set(model.state_names):
        return
    across = sizes.force(*axes["Y"])
    arm = sizes.force(*axes.get("N", axes["Y"])) / across if across > 0 else 1.0
    wind = forces.steady_wind(axes=tuple(axes), force=SHARE * across or 1.0, arm=arm or 1.0)
    push = _load(model, "Y")
    units = {"N": push, "m": _per(_load(model, "N"), push) if "N" in axes else "m"}
    yield _rewritten(wind, {axis: equation for axis, (equation, _) in axes.items()}, units)


def _rewritten(force: Force, equations: Mapping[str, str], units: Mapping[str, str]) -> Force:
    """A force of axes in the equations of a model, with their units."""
    return replace(
        force,
        terms={equations[axis]: text for axis, text in force.terms.items()},
        parameters=tuple(
            replace(one, unit=units.get(one.unit, one.unit)) for one in force.parameters
        ),
    )


def _inertias(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Errors of declared inertia; of equations that are rates free parameters hold it."""
    for axis, state in model.axes.items():
        mass = 1.0 / sizes.mobility[axis]
        yield from listed("usual_inertia", equation=axis, state=state, mass=mass)


def _commands(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Offsets, gains and what actuators do to commands, of each and of several alike."""
    units = {
        signal: unit
        for signal, unit in commanded(model).items()
        if sizes.swing.get(signal, 0.0) > 0 and unit != FLOW_UNIT and not signal.startswith(FLOWS)
    }
    way, speed = ways(model), _speed(model, sizes)
    alike: dict[tuple[str, bytes], list[str]] = {}
    for signal, unit in units.items():
        alike.setdefault((unit, way[signal]), []).append(signal)
    for signal, unit in units.items():
        several = len(alike[unit, way[signal]]) > 1  # of one alone, free derivatives are its gain
        yield from listed(
            "usual_command", signal=signal, unit=unit, time=sizes.time,
            swing=sizes.swing[signal], level=sizes.level[signal],
            twin=signal if several else None, angle=signal if unit == "rad" else None,
        )  # fmt: skip
        yield from _moved((signal,), unit, sizes, speed)
    for (unit, _), twins in alike.items():
        if len(twins) > 1:
            yield from _moved(twins, unit, sizes, speed)


def _speed(model: Model, sizes: Sizes) -> str | None:
    """The forward speed, where it is a state that changes."""
    _, state = vehicle_axes(model).get("X", ("", ""))
    if _units(model).get(state) != "m/s" or not sizes.swing[state] > 0.0:
        return None
    return state


def _moved(moved: Sequence[str], unit: str, sizes: Sizes, speed: str | None) -> list[Effect]:
    """What actuators do to their commands: of one, or of several alike."""
    lag = LAG * sizes.sample
    return listed(
        "usual_actuator", moved=moved, names="_".join(moved), unit=unit, lag=lag, step=sizes.step,
        duration=sizes.duration, speed=speed, pace=sizes.level.get(speed or "", 1.0) or 1.0,
        longest=2 * lag if 2 * lag <= LONGEST * sizes.step else None,
        swing=float(np.mean([sizes.swing[signal] for signal in moved])),
    )  # fmt: skip


def _sensors(model: Model, sizes: Sizes) -> Iterator[Effect]:
    measured = {output.name: output.unit for output in model.outputs}
    for name, unit in measured.items():
        swing = sizes.swing.get(name, 0.0)
        if swing > 0:
            # Only positions show where the vehicle went, and so that its compass is off.
            is_position = name in HORIZONTAL and unit == "m"
            told = not is_position and (name != "psi" or set(HORIZONTAL) & set(measured))
            yield from listed("usual_sensor", name=name, unit=unit, swing=swing,
                              plain=name if told else None, lag=LAG * sizes.sample)  # fmt: skip
    for across, rate in (("v", "r"), ("w", "q")):
        if across in measured:
            yield from listed(
                "usual_mounting", across=across, swing=sizes.swing[across],
                forward="u" if "u" in measured else None,
                rate=rate if rate in measured else None,
                turning=max(sizes.swing.get(rate, 0.0), 1e-300),
            )  # fmt: skip


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
    model: Model, dataset: Dataset, candidates: Sequence[Effect] | None, log: LogCheck | None = None
) -> tuple[tuple[Effect, ...], list[str]]:
    """The candidates that were named, or usual ones and a note that says so.

    Signals that a check of the logs found late bring a candidate of their own.
    """
    if candidates:
        # In one record what every record has of its own is what all share.
        twice = {f"{e.name}{BY_RECORD}" for e in candidates if len(dataset) == 1}
        return tuple(effect for effect in candidates if effect.name not in twice), []
    if dataset.only_tests:
        raise DataError(SAYS["candidates"]["tests"])
    usual = usual_effects(model, dataset)
    if not usual:
        raise DataError(SAYS["candidates"]["none"])
    late, notes = _late(dataset, log), [say("candidates", "made", count=len(usual))]
    if late:
        names = ", ".join(effect.name for effect in late)
        notes.append(say("candidates", "late", names=names))
    return (*usual, *late), notes


def _late(dataset: Dataset, log: LogCheck | None) -> tuple[Effect, ...]:
    """Delays of single sensors that a check found."""
    step = min(record.sample_time for record in dataset)
    late = [
        (one.signals[0], one.size)
        for one in (() if log is None else log.serious)
        if one.kind == "delay" and len(one.signals) == 1
        if one.signals[0] in dataset.channels.output_names
    ]
    return tuple(
        signals.sensor_delay(
            f"delay_{name}", name, max_delay=2.0 * (size + step), interval=step, scale=size
        )
        for name, size in late
        if size is not None and size > 0.0
    )
