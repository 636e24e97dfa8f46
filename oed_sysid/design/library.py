r"""Runs that a crew would know, within the limits: standard ones, and candidates of a programme.

Every kind is made at several sizes, at every *pattern* (a speed, a start, constant inputs) and of
every input that the pattern does not hold, one after the other; it is shrunk until all limits of
the motion hold on the nominal vehicle and on vehicles drawn from what is known. Circles and
spirals are for vehicles with a heading, zigzags of inputs that are angles where there are any.
Commands of open-loop kinds keep range and rate of the actuator by construction. With
:math:`\bar\delta` the range of the input,

.. math:: \delta(t) = \delta_0 + s\,\bar\delta\, g(t), \qquad s \in \{1, 0.6, 0.35, 0.2, 0.1, 0.05\}

with ``g`` between -1 and 1; zigzags are closed over the vehicle's attitude instead. Where the
attitude has limits of half-width :math:`b`, zigzags that look ahead reverse on

.. math:: \theta + T q - k\,(z - z_0) = \pm\theta_s, \qquad
    k = \frac{\theta_s}{\min(z_+ - z_0,\; z_0 - z_-)}

with a lead :math:`T` of the time in which full control turns the nominal vehicle by :math:`b/2`,
or half of it. Without a lead the swing goes on by as much as the vehicle is quick, several times
more on the worst of those that are possible, and it is they who make all runs gentle. The keeper
(gain :math:`k`, where the depth has limits) lets such a run be long.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, product
from math import degrees, radians
from typing import TypeVar

import numpy as np

from oed_sysid.data.recognise import RATES
from oed_sysid.design.criteria import SAYS
from oed_sysid.design.vehicles import LimitBounds, kept_on, units_of
from oed_sysid.design.waveforms import SIZES, Grid, trim_within
from oed_sysid.errors import DesignError, located
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.manoeuvres import Piecewise, ZigZag, schroeder_phases
from oed_sysid.experiments.simulation import Trajectory, simulate_inputs
from oed_sysid.likelihood.information import Information
from oed_sysid.physics.model import Model

KINDS = (
    "straight", "zigzag", "zigzag ahead", "3-2-1-1", "multisine", "levels", "circle", "spiral",
)  # fmt: skip
# Those that are closed over the vehicle's attitude.
CLOSED = frozenset({"zigzag", "zigzag ahead"})
# Attitudes on which a zigzag reverses, in order of preference; what it can keep.
ATTITUDES = ("psi", "theta", "phi")
_KEPT = {"theta": "z"}
ZIGZAGS = (5.0, 10.0, 20.0)  # degrees, both of the control and of the attitude
_PACES = (0.25, 0.6)  # of quick and slow variants, relative to a tenth of the run


_Size = TypeVar("_Size")
# Name, run, and how it was made smaller to keep the limits.
Standard = tuple[str, Experiment, str]


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

    Examples
    --------
    One of ``design_experiment(...).references``; see :func:`~oed_sysid.design.design_experiment`.
    """

    name: str
    experiment: Experiment
    information: Information
    note: str = ""


def standard_manoeuvres(bench: Bench) -> list[Standard]:
    """Return zigzags of one designed input that keep the limits.

    It is the first that is an angle and has room on both sides of its trim value, as the
    angles of a zigzag mean nothing for a speed; else the first with room, else the first about
    the middle of its range. Without an attitude among the outputs or states, a square wave takes
    their place. Amplitude and switching angle are made smaller together until all limits are kept.

    Parameters
    ----------
    bench : Bench
        Of all designed inputs.
    """
    grid, moved = bench.grid, _moved(bench.model, bench.grid)
    others = {n: float(v) for n, v in zip(grid.inputs, grid.trim, strict=True)}
    held = {**bench.held, **{n: v for n, v in others.items() if n not in moved.inputs}}
    bench = replace(bench, grid=moved, held=held, limits=Limits())
    sizes = [(f"zigzag {angle:g}/{angle:g}", radians(angle)) for angle in ZIGZAGS[:2]]
    n = len(moved.times)
    square = np.sign(np.sin(np.pi * np.arange(n) * 8 / n) + 1e-12)

    def made(title: str, angle: float) -> Experiment:
        if bench.attitude:
            return bench.zigzag(title, min(angle, bench.reach), angle)
        return bench.held_commands(title, bench.trim + angle * bench.reach * square)

    found = []
    for title, angle in sizes if bench.attitude else [("square wave", 1.0)]:
        # As large as it may be, to 7 %: designs are judged against it.
        shares = (2.0 ** -np.arange(0.0, 5.6, 0.1)).tolist()
        runs = ((share, made(title, share * angle)) for share in shares)
        for share, run, _ in bench.keeping(runs):
            note = "" if share == 1.0 else f"at {share:.0%} of its angles to keep the limits"
            found.append((title, run, note))
    return found


def _moved(model: Model, grid: Grid) -> Grid:
    """The one input that a standard manoeuvre moves."""
    room = np.minimum(grid.upper - grid.trim, grid.trim - grid.lower)
    able = [name for name, one in zip(grid.inputs, room, strict=True) if one > 0.0]
    units = {channel.name: channel.unit for channel in model.inputs}
    angles = [name for name in able if units[name] == "rad"]
    one = grid.only((angles or able or grid.inputs)[0])
    return one if able else replace(one, trim=0.5 * (one.lower + one.upper))


def as_piecewise(name: str, times: np.ndarray, values: np.ndarray) -> Piecewise:
    """Return held commands, repeated values left out; the last time is kept."""
    keep = np.concatenate([[True], np.diff(values) != 0])
    keep[-1] = True
    return Piecewise(name, times[keep].tolist(), values[keep].tolist())


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

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> run = next(iter(load_problem("nomoto_sparse_heading").experiments.values()))
    >>> Candidate(run, "zigzag", cost=1200.0).cost
    1200.0
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
        Range and rate of the inputs, bounds of the motion.
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

    Examples
    --------
    The zigzags that keep the limits of a problem::

        runs = candidate_runs(problem.model, problem.experiments.values(), limits=problem.limits,
                              rng=np.random.default_rng(0), kinds=("zigzag",))
    """
    located(DesignError, "The library has no kind of run", kinds, KINDS)
    found: list[Candidate] = []
    speeds = _distinct([patterns] if isinstance(patterns, Experiment) else patterns)
    if not speeds or turnaround < 0:
        raise DesignError("Give one pattern or more, and a turnaround that is not negative.")
    for pattern, tail, length in _variants(model, speeds, durations):
        for bench, own, of in _benches(Bench.each(model, limits, pattern, length), kinds):
            tried = replace(bench, vehicles=vehicles, kept=kept)
            for experiment, kind, share in tried.runs(own, rng):
                said = f"{experiment.name}{of if kind != 'straight' else ''}{tail}"
                run = replace(experiment, name=said)
                found.append(Candidate(run, kind, length + turnaround, share))
    if not found:
        raise DesignError(SAYS["no_candidate"])
    return tuple(found)


def _benches(
    benches: Sequence[Bench], kinds: Sequence[str]
) -> Iterable[tuple[Bench, Sequence[str], str]]:
    """Each input with the kinds that mean something of it, and what names it among several."""
    any_angle = any(bench.unit == "rad" for bench in benches)
    for number, bench in enumerate(benches):
        # A straight run is the same of every input; the angles of a zigzag are none of a thrust.
        left_out = {"straight"} if number else set()
        left_out |= CLOSED if any_angle and bench.unit != "rad" else set()
        of = f" of {bench.name}" if len(benches) > 1 else ""
        yield bench, [kind for kind in kinds if kind not in left_out], of


def _distinct(patterns: Iterable[Experiment]) -> list[Experiment]:
    """Patterns that differ in constants or start."""
    kept: list[Experiment] = []
    for one in patterns:
        if (one.constants, one.initial) not in [(two.constants, two.initial) for two in kept]:
            kept.append(one)
    return kept


def _variants(
    model: Model, speeds: Sequence[Experiment], durations: Sequence[float] | None
) -> Iterable[tuple[Experiment, str, float]]:
    """Every pattern at every length, s, with what tells them apart in the names of runs."""
    for number, pattern in enumerate(speeds):
        speed = _label(model, pattern, number) if len(speeds) > 1 else ""
        lengths = list(map(float, durations or (pattern.duration or 0.0,)))
        for length in lengths:
            yield pattern, f"{speed}, {length:g} s" if len(lengths) > 1 else speed, length


def _label(model: Model, pattern: Experiment, number: int) -> str:
    for state in model.states:
        if state.name == "u" and pattern.initial.get("u"):
            return f" at {pattern.initial['u']:.3g} {state.unit}"
    return f" at start {number + 1}"


@dataclass(frozen=True)
class ZigZags:
    """Zigzags that reverse on an attitude, in the place of a table of commands.

    Being closed over the vehicle, they keep attitude limits also when the model is wrong, and
    they work for vehicles that are unstable on their own. The one of the library that tells most
    is taken.

    Parameters
    ----------
    feedback : str
        Attitude on which the command reverses; by default the first that the vehicle has.

    Examples
    --------
    >>> ZigZags(feedback="psi").feedback
    'psi'
    """

    feedback: str = ""

    @property
    def name(self) -> str:
        """Name for reports."""
        return f"zigzags on {self.feedback or 'an attitude'}"


@dataclass(frozen=True, eq=False)
class Bench:
    """One commanded input, and the runs that are made of it; angles in rad.

    ``kept`` is the share of the nominal and the other vehicles that have to keep the bounds.
    """

    model: Model
    grid: Grid
    held: Mapping[str, float]
    initial: Mapping[str, float]
    limits: Limits
    bounds: LimitBounds
    vehicles: Sequence[Model] = ()
    kept: float = 1.0
    feedback: str = ""

    @classmethod
    def each(cls, model: Model, limits: Limits, pattern: Experiment, length: float) -> list[Bench]:
        """One for every input that a pattern leaves to be commanded, the others at trim."""
        held = dict(pattern.constants)
        if not (names := [n for n in model.input_names if n in limits.inputs and n not in held]):
            raise DesignError(SAYS["nothing_to_command"].format(pattern=pattern))
        trims = {name: trim_within(*limits.inputs[name]) for name in names}
        bounds, made = LimitBounds.of(model, limits), []
        for name in names:
            grid = Grid.of(limits, [name], length, pattern.sample_time, {})
            others = held | {other: trims[other] for other in names if other != name}
            made.append(cls(model, grid, others, pattern.initial, limits, bounds))
        return made

    @property
    def name(self) -> str:
        """The input."""
        return self.grid.inputs[0]

    @property
    def unit(self) -> str:
        """Of the input."""
        return units_of(self.model)[self.name]

    @property
    def trim(self) -> float:
        """Its value before the run."""
        return float(self.grid.trim[0])

    @cached_property
    def known(self) -> set[str]:
        """States and outputs."""
        return {*self.model.output_names, *self.model.state_names}

    @property
    def attitude(self) -> str:
        """The one that a zigzag reverses on; empty where there is none."""
        return self.feedback or next((a for a in ATTITUDES if a in self.known), "")

    @property
    def reach(self) -> float:
        """Largest command to either side of the trim command."""
        grid = self.grid
        return float(min(grid.upper[0] - grid.trim[0], grid.trim[0] - grid.lower[0]))

    @cached_property
    def sign(self) -> int:
        """+1 if a positive command lets the attitude grow."""
        times = self.grid.times
        times = times[: min(len(times), max(5, len(times) // 10))]
        ends = []
        for end in (self.grid.lower[0], self.grid.upper[0]):
            run = self.held_at(self.trim + 0.2 * (float(end) - self.trim), times)
            ends.append(float(np.nan_to_num(run.signal(self.attitude)[-1])))
        return 1 if ends[1] >= ends[0] else -1

    def held_at(self, command: float, times: np.ndarray) -> Trajectory:
        """What the nominal vehicle does under one command."""
        inputs = {**self.held, self.name: command}
        return simulate_inputs(self.model, times, inputs=inputs, initial=self.initial, throw=False)

    def zigzag(
        self,
        name: str,
        amplitude: float,
        switch: float,
        feedback: tuple[str, ...] = (),
        *,
        lead: float = 0.0,
        keep_gain: float = 0.0,
    ) -> Experiment:
        """One zigzag of the commanded input about what the vehicle does."""
        rate = float(self.grid.rates[0])
        shape = ZigZag(
            self.name, amplitude, switch, feedback=(self.attitude, *feedback),
            rate=rate if np.isfinite(rate) else None, sign=self.sign, trim=self.trim,
            lead=lead, keep_gain=keep_gain,
        )  # fmt: skip
        # A zigzag is flown on what is known best; noise would make it one of many.
        return self._experiment(name, shape, feedback="true")

    def held_commands(self, name: str, orders: np.ndarray) -> Experiment:
        """Commands ``(n_times,)`` within range and rate, held from sample to sample."""
        commands = self.grid.limited(orders[None, :, None])[0, :, 0]
        return self._experiment(name, as_piecewise(self.name, self.grid.times, commands))

    def _experiment(
        self, name: str, shape: Piecewise | ZigZag, feedback: str = "measured"
    ) -> Experiment:
        return Experiment(
            name, shape, duration=float(self.grid.times[-1]), sample_time=self.grid.step,
            constants=self.held, initial=self.initial, limits=self.limits, feedback=feedback,
        )  # fmt: skip

    def runs(
        self, kinds: Sequence[str], rng: np.random.Generator
    ) -> Iterable[tuple[Experiment, str, float]]:
        """Every kind at its largest size that keeps the limits, and at a gentler one."""
        turns = bool({"psi", "r"} & self.known)
        closed = {"zigzag": self.zigzags, "zigzag ahead": self.zigzags_ahead}
        for kind in kinds:
            if kind in closed:
                yield from ((run, kind, share) for run, share in closed[kind]())
            elif turns or kind not in ("circle", "spiral"):
                for variant, wave in self.waves(kind, rng):
                    sized = self.sized(f"{kind}{variant}", wave)
                    yield from ((run, kind, share) for run, share in sized)

    def waves(self, kind: str, rng: np.random.Generator) -> Iterable[tuple[str, np.ndarray]]:
        """Shapes between -1 and 1 of an open-loop kind."""
        n = len(self.grid.times)
        share = self.grid.times / self.grid.times[-1]
        if kind == "straight":
            yield "", np.zeros(n)
        elif kind == "circle":
            yield "", np.ones(n)
            yield " to the other side", -np.ones(n)
        elif kind == "spiral":
            steps = np.linspace(1.0, -1.0, 9)
            yield "", steps[np.minimum((share * len(steps)).astype(int), len(steps) - 1)]
        else:
            for word, pace in zip((" quick", " slow"), _PACES, strict=True):
                yield word, self._paced(kind, max(int(pace * n / 10), 2), word == " quick", rng)

    def _paced(self, kind: str, unit: int, quick: bool, rng: np.random.Generator) -> np.ndarray:
        """A shape that is changed every so many samples."""
        n = len(self.grid.times)
        if kind == "3-2-1-1":
            block = np.repeat([1.0, -1.0, 1.0, -1.0], np.array([3, 2, 1, 1]) * unit)
            return np.resize(np.concatenate([block, -block]), n)
        if kind == "multisine":
            cycles = np.arange(1, 9) * (2.0 if quick else 1.0)
            share = self.grid.times / self.grid.times[-1]
            phases = schroeder_phases(np.ones(len(cycles)))
            wave = np.cos(2 * np.pi * np.outer(share, cycles) + phases).sum(axis=1)
            return np.asarray(wave / np.abs(wave).max())
        drawn = rng.uniform(-1, 1, n // unit + 1)
        return np.repeat(drawn / np.abs(drawn).max(), unit)[:n]

    def sized(self, name: str, wave: np.ndarray) -> Iterable[tuple[Experiment, float]]:
        """Return the largest size that keeps the limits, then a gentler one."""
        runs = ((size, self.table(name, size, wave)) for size in SIZES)
        for size, run, share in self.keeping(runs if wave.any() else islice(runs, 1)):
            yield run, share
            if wave.any():
                yield self.table(name, SIZES[2] * size, wave), 1.0

    def table(self, kind: str, size: float, wave: np.ndarray) -> Experiment:
        """Commands of one shape and size."""
        room = np.where(wave > 0, self.grid.upper, self.grid.lower) - self.trim
        largest = size * float(self.grid.upper[0] - self.trim)
        angle = self.unit == "rad"
        said = f"{degrees(largest):.2g} deg" if angle else f"{largest:.3g} {self.unit}"
        name = f"{kind} {said}" if wave.any() else kind
        return self.held_commands(name, self.trim + np.abs(room) * (size * wave))

    def zigzags(self) -> Iterable[tuple[Experiment, float]]:
        """Zigzags on the attitude.

        Of equal angles, made smaller together until the limits hold, and quick ones, which turn
        before the attitude has reached the control's angle.
        """
        equal = [(share, share) for share in SIZES[:5]]
        # A large control within narrow limits, on vehicles that answer it by more than this one.
        quick = [(1.0, SIZES[2]), (1.0, SIZES[4])]
        families = [(angle, equal) for angle in ZIGZAGS] + [(a, quick) for a in ZIGZAGS[1:]]
        seen: set[str] = set()
        for angle, shares in families:
            sizes = (one for one in self._sizes(angle, shares) if one[0] not in seen)
            for name, run, share in self.keeping((one[0], self.zigzag(*one)) for one in sizes):
                seen.add(name)
                yield run, share

    def _sizes(
        self, angle: float, shares: Iterable[tuple[float, float]]
    ) -> Iterable[tuple[str, float, float]]:
        """Name, control and attitude of zigzags, shares of an angle in degrees, within reach."""
        for control, turn in shares:
            size, switch = (float(f"{share * angle:.2g}") for share in (control, turn))
            if self.attitude and radians(size) <= self.reach:
                yield f"zigzag {size:g}/{switch:g}", radians(size), radians(switch)

    def zigzags_ahead(self) -> Iterable[tuple[Experiment, float]]:
        """Zigzags that look ahead within limits of the attitude, about a keeper of the depth.

        Of each pair of control and lead the largest switch that keeps the limits, and the next.
        """
        room, rate = self.room(self.attitude), RATES.get(self.attitude, "")
        time = self.turning_time(0.5 * room) if np.isfinite(room) and rate in self.known else None
        if time is None:
            return
        keeper = _KEPT.get(self.attitude, "")
        depth = self.room(keeper)
        kept = (keeper,) if np.isfinite(depth) else ()
        # Shares of the control's range, and of the time that half of the room takes.
        for control, share in product((SIZES[0], SIZES[2]), repeat=2):
            size, lead = control * self.reach, float(f"{share * time:.2g}")
            runs = (
                (switch, self.zigzag(
                    f"zigzag {degrees(size):.3g}/{degrees(switch):.3g} {lead:g} s ahead",
                    size, switch, (rate, *kept), lead=lead, keep_gain=switch / depth,
                ))
                for switch in (part * room for part in SIZES[:5])
            )  # fmt: skip
            yield from ((run, share) for _, run, share in self.keeping(runs, 2))

    def room(self, name: str) -> float:
        """Way from the start to the nearer limit of a signal; infinite where there is none."""
        lower, upper = self.limits.signals.get(name, (-np.inf, np.inf))
        begin = self.initial.get(name, 0.0)
        room = min(upper - begin, begin - lower)
        return room if name in self.known and room > 0 else np.inf

    def turning_time(self, angle: float) -> float | None:
        """Time in which full control turns the nominal vehicle by an angle, s; None if never."""
        if not self.reach > 0:
            return None
        run = self.held_at(self.trim + self.reach, self.grid.times)
        begin = self.initial.get(self.attitude, 0.0)
        turned = np.abs(np.nan_to_num(run.signal(self.attitude), nan=np.inf) - begin)
        gone = turned >= angle
        return float(self.grid.times[int(np.argmax(gone))]) if gone.any() else None

    def keeping(
        self, runs: Iterable[tuple[_Size, Experiment]], most: int = 1
    ) -> Iterable[tuple[_Size, Experiment, float]]:
        """The first sizes whose runs keep the limits on enough vehicles, and on which share."""
        vehicles = (self.model, *self.vehicles)
        tried = ((*one, kept_on(one[1], vehicles, self.bounds, self.kept)) for one in runs)
        return islice(((s, run, kept) for s, run, kept in tried if kept is not None), most)
