r"""Standard manoeuvres within the same limits, to compare a design with.

Candidate runs of a programme: what a crew would know how to run, within the limits.

Every kind is made at several sizes and at every *pattern* (a speed, a start, constant inputs) and
is shrunk until all limits of the motion hold on the nominal vehicle and on vehicles drawn from
what is known. Circles and spirals are for vehicles with a heading. Commands of open-loop kinds
keep range and rate of the actuator by construction. With :math:`\bar\delta` the range of the
input,

.. math:: \delta(t) = \delta_0 + s\,\bar\delta\, g(t), \qquad s \in \{1, 0.6, 0.35, 0.2, 0.1, 0.05\}

with ``g`` between -1 and 1; zigzags are closed over the vehicle's attitude instead. Where the
attitude has a corridor of half-width :math:`b`, zigzags that look ahead reverse on

.. math:: \theta + T q - k\,(z - z_0) = \pm\theta_s, \qquad
    k = \frac{\theta_s}{\min(z_+ - z_0,\; z_0 - z_-)}

with a lead :math:`T` of the time in which full control turns the nominal vehicle by :math:`b/2`,
or half of it. Without a lead the swing goes on by as much as the vehicle is quick, several times
more on the worst of those that are possible, and it is they who make all runs gentle. The keeper
(gain :math:`k`, where the depth has limits) lets such a run be long.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import degrees, radians

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.design.limits import Corridor
from oed_sysid.design.waveforms import Grid, neutral_within
from oed_sysid.errors import DesignError, OedSysidError
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.manoeuvres import Piecewise, ZigZag, schroeder_phases
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.experiments.trajectory import state_names
from oed_sysid.likelihood.information import Information
from oed_sysid.physics.model import Model

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
            if _is_inside(model, corridor, run.states, run.outputs):
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


def _is_inside(model: Model, corridor: Corridor, states: np.ndarray, outputs: np.ndarray) -> bool:
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


KINDS = (
    "straight", "zigzag", "zigzag ahead", "3-2-1-1", "multisine", "levels", "circle", "spiral",
)  # fmt: skip
# Amplitudes tried, as shares of the range, until the limits hold; the largest and a gentler one
# are kept.
SHARES = (1.0, 0.6, 0.35, 0.2, 0.1, 0.05)
_GENTLER = 0.4
ZIGZAGS = (5.0, 10.0, 20.0)  # degrees, both of the control and of the attitude
# Attitudes of quick zigzags, as shares of the control's angle: a large control within a narrow
# corridor, on vehicles that answer it by more than the nominal one does.
_QUICK = (0.5, 0.25)
# Zigzags that look ahead: control as a share of its range, switch as one of the corridor, lead as
# one of the time that a half of the corridor takes.
_CONTROLS, _SWITCHES, _LEADS = (1.0, 0.5), (1.1, 0.8, 0.6, 0.4, 0.25), (1.0, 0.5)
_RATES = {"psi": "r", "theta": "q", "phi": "p"}
_KEPT = {"theta": "z"}
_PACES = (0.25, 0.6)  # of quick and slow variants, relative to a tenth of the run


@dataclass(frozen=True, eq=False)
class Candidate:
    """One run that may become part of a programme.

    Attributes
    ----------
    experiment : Experiment
    kind : str
        One of ``KINDS``, or ``"designed"``.
    cost : float
        Time that it takes with everything around it, s.
    kept : float
        Share of the drawn vehicles on which it kept its limits.
    """

    experiment: Experiment
    kind: str
    cost: float
    kept: float = 1.0

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.experiment.name


def candidate_runs(
    model: Model,
    patterns: Experiment | Iterable[Experiment],
    *,
    limits: Limits,
    rng: np.random.Generator,
    vehicles: Sequence[Model] = (),
    durations: Sequence[float] | None = None,
    turnaround: float = 600.0,
    kinds: Sequence[str] = KINDS,
    kept: float = 0.95,
) -> tuple[Candidate, ...]:
    """Return the library of runs that keep the limits.

    Parameters
    ----------
    model : Model
        The nominal vehicle.
    patterns : Experiment or iterable of Experiment
        Each lends its constant inputs (a speed), start state and sampling.
    limits : Limits
        Range and rate of the inputs, corridor of the motion.
    rng : numpy.random.Generator
        Source of random levels.
    vehicles : sequence of Model
        Others that are possible: a run is kept if its limits hold on enough of them.
    durations : sequence of float, optional
        Lengths, s; by default those of the patterns.
    turnaround : float
        Time between two runs, s: it counts in the cost of each.
    kinds : sequence of str
        Of :data:`KINDS`.
    kept : float
        Smallest share of the vehicles on which all limits have to hold.

    Returns
    -------
    tuple of Candidate

    Raises
    ------
    DesignError
        If no run keeps the limits.
    """
    listed = [patterns] if isinstance(patterns, Experiment) else list(patterns)
    for kind in kinds:
        if kind not in KINDS:
            raise DesignError(f"There is no kind of run {kind!r}. Kinds are {', '.join(KINDS)}.")
    if not listed or turnaround < 0:
        raise DesignError("Give one pattern or more, and a turnaround that is not negative.")
    found: list[Candidate] = []
    for number, pattern in enumerate(_speeds(listed)):
        for length in durations or (float(pattern.duration or 0.0),):
            stand = _Stand(model, limits, pattern, float(length), tuple(vehicles), kept)
            speed = "" if len(_speeds(listed)) == 1 else f" at {_label(model, pattern, number)}"
            tail = speed if durations is None or len(durations) == 1 else f"{speed}, {length:g} s"
            for experiment, kind, share in stand.runs(kinds, rng):
                named = replace(experiment, name=f"{experiment.name}{tail}")
                found.append(Candidate(named, kind, float(length) + turnaround, share))
    if not found:
        raise DesignError(
            "No run of any kind keeps the limits on the vehicles that are possible. Widen the "
            "limits, shorten the runs, or begin with a gentle run and plan from its fit."
        )
    return tuple(found)


def _speeds(patterns: Sequence[Experiment]) -> list[Experiment]:
    """Patterns that differ in constants or start."""
    kept: dict[tuple, Experiment] = {}
    for pattern in patterns:
        key = (tuple(sorted(pattern.constants.items())), tuple(sorted(pattern.initial.items())))
        kept.setdefault(key, pattern)
    return list(kept.values())


def _label(model: Model, pattern: Experiment, number: int) -> str:
    for state in model.states:
        if state.name == "u" and pattern.initial.get("u"):
            return f"{pattern.initial['u']:.3g} {state.unit}"
    return f"start {number + 1}"


class _Stand:
    """One pattern and length on which all kinds are tried."""

    def __init__(
        self,
        model: Model,
        limits: Limits,
        pattern: Experiment,
        length: float,
        vehicles: tuple[Model, ...],
        kept: float,
    ) -> None:
        held = dict(pattern.constants)
        names = [n for n in model.input_names if n in limits.inputs and n not in held]
        if not names:
            raise DesignError(
                f"Pattern {pattern.name!r} leaves no input with a range to command. Give "
                "Limits(inputs={'rudder': (-0.3, 0.3)}), on the command line --limit rudder=-17:17."
            )
        self.model, self.limits, self.pattern = model, limits, pattern
        self.vehicles, self.kept = vehicles, kept
        self.name = names[0]
        lower, upper = limits.inputs[self.name]
        rest = neutral_within(lower, upper)
        n = int(np.floor(length / pattern.sample_time + 1e-9))
        one = np.ones(1)
        self.grid = Grid(
            np.arange(n + 1) * pattern.sample_time, (self.name,), lower * one, upper * one,
            rest * one, limits.rates.get(self.name, np.inf) * (1 - 1e-9) * one,
        )  # fmt: skip
        others = {n: neutral_within(*limits.inputs[n]) for n in names[1:]}
        self.held = held | others
        self.corridor = Corridor.of(model, limits, {}, kernel(model).n_full)
        self.turns = bool({"psi", "r"} & {*model.state_names, *model.output_names})

    def runs(
        self, kinds: Sequence[str], rng: np.random.Generator
    ) -> Iterable[tuple[Experiment, str, float]]:
        """Every kind at its largest size that keeps the limits, and at a gentler one."""
        for kind in kinds:
            if kind == "straight":
                still = self.table("straight", np.zeros(len(self.grid.times)))
                share = self.keeps(still)
                if share is not None:
                    yield still, kind, share
            elif kind in ("circle", "spiral") and not self.turns:
                continue
            elif kind == "zigzag":
                yield from self.zigzags()
            elif kind == "zigzag ahead":
                yield from self.leading()
            else:
                for variant, wave in self.waves(kind, rng):
                    yield from self.sized(kind, variant, wave)

    def waves(self, kind: str, rng: np.random.Generator) -> Iterable[tuple[str, np.ndarray]]:
        """Shapes between -1 and 1 of an open-loop kind."""
        times = self.grid.times
        share = times / times[-1]
        if kind == "circle":
            yield "", np.ones(len(times))
            yield " to the other side", -np.ones(len(times))
        elif kind == "spiral":
            steps = np.array([1.0, 0.75, 0.5, 0.25, 0.0, -0.25, -0.5, -0.75, -1.0])
            yield "", steps[np.minimum((share * len(steps)).astype(int), len(steps) - 1)]
        for word, pace in zip(("quick", "slow"), _PACES, strict=True):
            unit = max(int(pace * len(times) / 10), 2)
            if kind == "3-2-1-1":
                block = np.repeat([1.0, -1.0, 1.0, -1.0], np.array([3, 2, 1, 1]) * unit)
                yield f" {word}", np.resize(np.concatenate([block, -block]), len(times))
            elif kind == "multisine":
                cycles = np.arange(1, 9) * (2.0 if word == "quick" else 1.0)
                phases = schroeder_phases(np.ones(len(cycles)))
                wave = np.cos(2 * np.pi * np.outer(share, cycles) + phases).sum(axis=1)
                yield f" {word}", wave / np.abs(wave).max()
            elif kind == "levels":
                drawn = rng.uniform(-1, 1, len(times) // unit + 1)
                yield f" {word}", np.repeat(drawn / np.abs(drawn).max(), unit)[: len(times)]

    def sized(
        self, kind: str, variant: str, wave: np.ndarray
    ) -> Iterable[tuple[Experiment, str, float]]:
        """Return the largest size that keeps the limits, then a gentler one."""
        for size in SHARES:
            run = self.table(self.title(f"{kind}{variant}", size), size * wave)
            share = self.keeps(run)
            if share is None:
                continue
            yield run, kind, share
            small = _GENTLER * size
            yield self.table(self.title(f"{kind}{variant}", small), small * wave), kind, 1.0
            return

    def title(self, kind: str, size: float) -> str:
        span = size * float(self.grid.upper[0] - self.grid.neutral[0])
        channel = next(i for i in self.model.inputs if i.name == self.name)
        angle = channel.unit == "rad"
        return f"{kind} {degrees(span):.2g} deg" if angle else f"{kind} {span:.3g} {channel.unit}"

    def table(self, name: str, wave: np.ndarray) -> Experiment:
        """Commands of one shape, within range and rate."""
        grid = self.grid
        width = np.where(wave > 0, grid.upper[0] - grid.neutral[0], grid.neutral[0] - grid.lower[0])
        orders = (grid.neutral[0] + width * wave)[None, :, None]
        commands = grid.limited(orders)[0, :, 0]
        return Experiment(
            name, as_piecewise(self.name, grid.times, commands), duration=float(grid.times[-1]),
            sample_time=grid.step, constants=self.held, initial=self.pattern.initial,
            limits=self.limits,
        )  # fmt: skip

    def zigzags(self) -> Iterable[tuple[Experiment, str, float]]:
        """Zigzags on the attitude.

        Of equal angles, made smaller together until the limits hold, and quick ones, which turn
        before the attitude has reached the control's angle.
        """
        known = (*self.model.output_names, *self.model.state_names)
        attitude = next((a for a in ATTITUDES if a in known), None)
        if attitude is None:
            return
        largest = self.reach
        sign = self.side(attitude)
        equal = [[(share * angle, share * angle) for share in SHARES[:4]] for angle in ZIGZAGS]
        quick = [[(angle, share * angle) for share in _QUICK] for angle in ZIGZAGS[1:]]
        seen: set[tuple[float, float]] = set()
        for family in (*equal, *quick):
            for control, turn in family:
                size, switch = round(control, 3), round(turn, 3)
                if (size, switch) in seen or radians(size) > largest:
                    continue
                run = self.swings(
                    f"zigzag {size:g}/{switch:g}", radians(size), radians(switch), sign, (attitude,)
                )
                held = self.keeps(run)
                if held is None:
                    continue
                seen.add((size, switch))
                yield run, "zigzag", held
                break

    def leading(self) -> Iterable[tuple[Experiment, str, float]]:
        """Zigzags that look ahead within a corridor of the attitude, about a keeper of the depth.

        Of each pair of control and lead the largest switch that keeps the limits, and the next.
        """
        known = (*self.model.output_names, *self.model.state_names)
        attitude = next((a for a in ATTITUDES if a in known), "")
        lower, upper = self.limits.signals.get(attitude, (-np.inf, np.inf))
        initial = dict(self.pattern.initial)
        begin = initial.get(attitude, 0.0)
        wide = min(upper - begin, begin - lower)
        if not (np.isfinite(wide) and wide > 0 and self.reach > 0) or _RATES[attitude] not in known:
            return
        largest = self.reach
        time = self.turning_time(attitude, begin, largest, 0.5 * wide)
        if time is None:
            return
        sign = self.side(attitude)
        kept, room = self.kept_depth(attitude, known)
        for control, share in product(_CONTROLS, _LEADS):
            size, lead = control * largest, float(f"{share * time:.2g}")
            found = 0
            for switch in (part * wide for part in _SWITCHES):
                run = self.swings(
                    f"zigzag {degrees(size):.3g}/{degrees(switch):.3g} {lead:g} s ahead",
                    size, switch, sign, (attitude, _RATES[attitude], *kept), lead=lead,
                    keep_gain=switch / room if kept else 0.0,
                )  # fmt: skip
                held = self.keeps(run)
                if held is None:
                    continue
                yield run, "zigzag ahead", held
                found += 1
                if found == 2:
                    break

    @property
    def reach(self) -> float:
        """Largest command to either side of the neutral one."""
        grid = self.grid
        return float(min(grid.upper[0] - grid.neutral[0], grid.neutral[0] - grid.lower[0]))

    def side(self, attitude: str) -> int:
        """+1 if a positive command lets the attitude grow."""
        neutral, initial = float(self.grid.neutral[0]), dict(self.pattern.initial)
        return _side(self.model, self.grid, 0, neutral, attitude, self.held, initial)

    def swings(
        self,
        name: str,
        amplitude: float,
        switch: float,
        sign: int,
        feedback: tuple[str, ...],
        *,
        lead: float = 0.0,
        keep_gain: float = 0.0,
    ) -> Experiment:
        """One zigzag of the commanded input about what the vehicle does; angles in rad."""
        grid = self.grid
        rate = float(grid.rates[0]) if np.isfinite(grid.rates[0]) else None
        shape = ZigZag(
            self.name, amplitude, switch, feedback=feedback, rate=rate, sign=sign,
            neutral=float(grid.neutral[0]), lead=lead, keep_gain=keep_gain,
        )  # fmt: skip
        return Experiment(
            name, shape, duration=float(grid.times[-1]), sample_time=grid.step,
            constants=self.held, initial=self.pattern.initial, feedback="true", limits=self.limits,
        )  # fmt: skip

    def kept_depth(self, attitude: str, known: Sequence[str]) -> tuple[tuple[str, ...], float]:
        """Signal that a zigzag on an attitude can keep, and the room to its nearer limit."""
        name = _KEPT.get(attitude, "")
        lower, upper = self.limits.signals.get(name, (-np.inf, np.inf))
        begin = self.pattern.initial.get(name, 0.0)
        room = min(upper - begin, begin - lower)
        return ((name,), room) if name in known and np.isfinite(room) and room > 0 else ((), np.inf)

    def turning_time(
        self, attitude: str, begin: float, control: float, angle: float
    ) -> float | None:
        """Time in which a control turns the nominal vehicle by an angle, s; None if never."""
        inputs = self.held | {self.name: float(self.grid.neutral[0]) + control}
        run = simulate_inputs(
            self.model, self.grid.times, inputs=inputs, initial=self.pattern.initial, throw=False
        )
        gone = np.abs(np.nan_to_num(run.signal(attitude), nan=np.inf) - begin) >= angle
        return float(self.grid.times[int(np.argmax(gone))]) if gone.any() else None

    def keeps(self, run: Experiment) -> float | None:
        """Share of the vehicles that keep the limits; None where it is too small."""
        return kept_on(run, (self.model, *self.vehicles), self.corridor, self.kept)


def kept_on(
    run: Experiment, vehicles: Sequence[Model], corridor: Corridor, wanted: float
) -> float | None:
    """Share of the vehicles on which a run keeps its limits; the first has to.

    Parameters
    ----------
    run : Experiment
    vehicles : sequence of Model
        The nominal one first.
    corridor : Corridor
    wanted : float
        Below this share of the others nothing is returned.
    """
    allowed = int((1 - wanted) * len(vehicles) + 1e-9)
    failed = 0
    free = replace(run, limits=Limits())
    commands = None
    for number, vehicle in enumerate(vehicles):
        if _inside(vehicle, free, corridor, commands):
            if number == 0 and not run.reacts:
                commands = free.commands(vehicle.input_names)
            continue
        failed += 1
        if number == 0 or failed > allowed:
            return None
    return 1.0 - failed / len(vehicles)


def _inside(
    vehicle: Model, run: Experiment, corridor: Corridor, commands: np.ndarray | None
) -> bool:
    try:
        if commands is None:
            commands = simulate(vehicle, run, noise=False).inputs
        motion = simulate_inputs(vehicle, run.times, inputs=commands, initial=run.initial)
    except OedSysidError:
        return False
    n_full = corridor.n_full
    for index, column in enumerate(corridor.columns):
        state = column < n_full
        values = motion.states[:, column] if state else motion.outputs[:, column - n_full]
        if values.min() < corridor.lower[index] or values.max() > corridor.upper[index]:
            return False
    return True
