r"""Several runs together: which, how often, in which order, measured with what.

For each of a library of runs the information :math:`F_i(\theta_s)` is taken, disturbance forces
included, on the nominal vehicle and on others drawn from what is known; weights with a
certificate and whole runs by exchange follow :mod:`oed_sysid.design.allocation`. Then the
commands of the chosen runs are refined (column generation): with everything but run ``j``

.. math:: F_{-j} = F_0 + \sum_{i \ne j} x_i F_i

as knowledge before, :func:`~oed_sysid.design.design_experiment` looks for the command that
completes it; what it finds joins the library if it keeps its limits on enough vehicles, and the
weights are solved again. A search sees white noise, so its levels are raised by one factor until
a run is worth to it what it is worth under the forces (:mod:`oed_sysid.design.knowledge`).

The certificate covers the library, refined commands included, the criterion, the drawn vehicles and
the noise assumed. It does not cover commands that nobody proposed, nor a model of wrong structure.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, combinations

import numpy as np
from scipy.optimize import brentq

from oed_sysid.design.allocation import Library, Selection, Weights, order, select, weights
from oed_sysid.design.assurance import AccuracyRange, Assurance, assess_limits
from oed_sysid.design.criteria import SAYS, AOptimal, Criterion, EOptimal, inverse
from oed_sysid.design.experiment_design import find_design
from oed_sysid.design.knowledge import ExpectedInformation, Knowledge
from oed_sysid.design.library import KINDS, Candidate, as_piecewise, candidate_runs
from oed_sysid.design.result import Design, Programme, Standard
from oed_sysid.design.trial import Search, Task, Trial, held_by
from oed_sysid.design.vehicles import CHECKED, LimitBounds, draw_models, kept_on
from oed_sysid.design.waveforms import SIZES, Levels
from oed_sysid.errors import DesignError, OedSysidError, located, respelled
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.manoeuvres import Manoeuvre, Piecewise, ZigZag
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.physics.model import Model
from oed_sysid.runtime.threads import single_threaded

_REFINING = Search(Levels(20), n_starts=2, n_candidates=30, n_steps=10, n_workers=1)
STANDARD = ("zigzag 10/10", "zigzag 20/20", "circle")


@dataclass(frozen=True)
class Budget:
    """What a programme of runs may take.

    Parameters
    ----------
    hours : float, optional
        Time for everything, turnarounds and sensors included, h.
    n_runs : int, optional
        Largest number of runs. Give hours, a number of runs, or both.
    turnaround : float
        Between two runs, s.
    sensors : mapping of str to float, optional
        Outputs that need not be measured, and what each costs, h. All subsets are tried.

    Examples
    --------
    >>> Budget(hours=6.0, turnaround=900.0).hours
    6.0
    """

    hours: float | None = None
    n_runs: int | None = None
    turnaround: float = 600.0
    sensors: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.hours is None and self.n_runs is None:
            raise DesignError(SAYS["no_end"])


@dataclass(frozen=True)
class ProgrammeSearch:
    """How the runs of a programme are made, judged and refined.

    Parameters
    ----------
    durations, kinds
        See :func:`~oed_sysid.design.library.candidate_runs`.
    n_draws : int
        Vehicles besides the nominal one that the worth is averaged over.
    n_vehicles : int
        Vehicles on which limits are checked.
    n_rounds : int
        Rounds of refined commands.

    Examples
    --------
    >>> ProgrammeSearch(kinds=("zigzag", "circle"), n_rounds=0).kinds
    ('zigzag', 'circle')
    """

    durations: Sequence[float] | None = None
    kinds: Sequence[str] = KINDS
    n_draws: int = 4
    n_vehicles: int = 12
    n_rounds: int = 1


@respelled(DesignError, held_by(budget=Budget, knowledge=Knowledge, search=ProgrammeSearch))
@single_threaded
def design_programme(
    model: Model | Fit,
    patterns: Experiment | Iterable[Experiment],
    *,
    limits: Limits,
    budget: Budget,
    rng: np.random.Generator,
    criterion: Criterion = AOptimal(),  # noqa: B008 (frozen)
    knowledge: Knowledge = Knowledge(),  # noqa: B008 (frozen)
    search: ProgrammeSearch = ProgrammeSearch(),
    certainty: float = 0.95,
    progress: Callable[[str], None] | None = None,
) -> Programme:
    """Design the programme of runs that tells most for the time that there is.

    Parameters
    ----------
    model : Model or Fit
        The nominal vehicle; a fit brings its values, noise and information.
    patterns : Experiment or iterable of Experiment
        Each lends its constant inputs (a speed), start state, sampling and length.
    limits : Limits
        Range and rate of the inputs, limits of the motion.
    budget : Budget
        Hours, number of runs, time between runs, cost of sensors.
    rng : numpy.random.Generator
    criterion : Criterion, Discriminate or Detect
        Smooth: D, A, Ds or V; or what a search for missing physics is to find, for which a fit
        brings its records.
    knowledge : Knowledge
        What is known before, the noise to expect, and how much vehicles may differ.
    search : ProgrammeSearch
        Kinds and lengths of the runs, vehicles, rounds of refined commands.
    certainty : float
        Share of the vehicles on which all runs of the programme have to keep their limits.
    progress : callable, optional
        Called with what is being done, in words.

    Returns
    -------
    Programme

    Raises
    ------
    DesignError
        If no run keeps the limits, or none fits.

    Examples
    --------
    Six hours of runs that keep the limits of a problem::

        found = design_programme(problem.model, problem.experiments.values(), limits=problem.limits,
                                 budget=Budget(hours=6.0), rng=np.random.default_rng(0))
        print(found.report())
    """
    began = time.perf_counter()
    tell = progress or (lambda words: None)
    if isinstance(criterion, EOptimal):
        raise DesignError("E is not smooth, so that no bound can be stated. Choose D or A.")
    expected = ExpectedInformation.of(model, criterion, knowledge)
    nominal, spread = expected.model, knowledge.spread
    # A refined command is judged on enough vehicles before it is chosen.
    n_vehicles = max(search.n_vehicles, search.n_draws, 60)
    vehicles = draw_models(nominal, spread, n_vehicles, expected.prior, rng)
    tell("making candidate runs")
    runs = candidate_runs(
        nominal, patterns, limits=limits, rng=rng, vehicles=vehicles[: search.n_vehicles],
        durations=search.durations, turnaround=budget.turnaround, kinds=search.kinds,
        kept=certainty,
    )  # fmt: skip
    planner = _Planner(expected, vehicles, search.n_draws, limits, budget, certainty, spread, rng)
    tell(f"information of {len(runs)} candidate runs")
    names = tuple(budget.sensors)
    # All subsets: optional sensors are few, and their worth depends on each other.
    subsets = chain.from_iterable(combinations(names, n) for n in range(len(names) + 1))
    options = [planner.solve(runs, subset) for subset in subsets]
    plan = max(options, key=lambda one: one.chosen.value)
    for number in range(search.n_rounds):
        tell(f"refining commands, round {number + 1}")
        before, plan = plan.chosen.value, planner.refined(plan, number)
        if plan.chosen.value - before < 1e-3:
            break
    tell("checking limits on other vehicles")
    plan, safe = planner.kept_within(plan)
    return planner.programme(plan, safe, options, began)


@dataclass(frozen=True, eq=False)
class _Plan:
    """Runs that stay finite on all vehicles, their weights, and the whole runs chosen."""

    runs: tuple[Candidate, ...]
    subset: tuple[str, ...]
    library: Library
    shares: Weights
    chosen: Selection

    @property
    def picked(self) -> list[Candidate]:
        """Runs that are chosen once or more."""
        return [self.runs[int(i)] for i in np.flatnonzero(self.chosen.counts)]


@dataclass(frozen=True, eq=False)
class _Planner:
    """Information of runs on every vehicle, kept, and the two problems solved on it."""

    expected: ExpectedInformation
    vehicles: Sequence[Model]
    n_draws: int
    limits: Limits
    budget: Budget
    certainty: float
    spread: float | None
    rng: np.random.Generator
    known: dict[tuple[int, tuple[str, ...]], np.ndarray | None] = field(default_factory=dict)

    @cached_property
    def scales(self) -> np.ndarray:
        """Errors count relative to the values, on all vehicles alike."""
        model = self.expected.model
        return np.array([model.parameter(name).reference for name in self.expected.names])

    def measured(self, subset: Sequence[str]) -> tuple[str, ...]:
        """Outputs that are measured with some of the optional sensors."""
        model, optional = self.expected.model, self.budget.sensors
        located(DesignError, f"Model {model.name!r} has no output", optional, model.output_names)
        return tuple(n for n in model.output_names if n not in optional or n in subset)

    def sensor_hours(self, subset: Sequence[str]) -> float:
        """Time that some of the optional sensors take, h."""
        return float(sum(self.budget.sensors[name] for name in subset))

    def seconds(self, subset: Sequence[str]) -> float:
        """Time that is left for runs beside some of the optional sensors, s."""
        if self.budget.hours is None:
            return np.inf
        if (left := 3600.0 * (self.budget.hours - self.sensor_hours(subset))) <= 0:
            raise DesignError("The sensors alone take longer than there is time. Give more hours.")
        return left

    def information(
        self, runs: Sequence[Candidate], outputs: tuple[str, ...]
    ) -> list[np.ndarray | None]:
        """Relative information of runs on every vehicle, ``(n_vehicles, n, n)`` each.

        None where one vehicle diverges.
        """
        missing = [run for run in runs if (id(run), outputs) not in self.known]
        told = [
            list(map(one.told(outputs).matrix, (run.experiment for run in missing)))
            for one in map(self.expected.on, (self.expected.model, *self.vehicles[: self.n_draws]))
        ]
        for run, parts in zip(missing, zip(*told, strict=True), strict=True):
            found = [self.expected.relative(one, self.scales) for one in parts if one is not None]
            # A run that one vehicle cannot finish is no run to plan with.
            whole = len(found) == len(parts)
            self.known[id(run), outputs] = np.stack(found) if whole else None
        return [self.known[id(run), outputs] for run in runs]

    def solve(
        self,
        runs: Sequence[Candidate],
        subset: tuple[str, ...],
        begin: np.ndarray | None = None,
    ) -> _Plan:
        """Weights and whole runs, measured with some of the optional sensors."""
        expected, told = self.expected, self.information(runs, self.measured(subset))
        if not (there := [(run, m) for run, m in zip(runs, told, strict=True) if m is not None]):
            raise DesignError("No candidate run stays finite on all vehicles. Make them gentler.")
        kept = tuple(run for run, _ in there)
        library = Library(
            np.stack([matrix for _, matrix in there], axis=1),
            expected.relative(expected.before, self.scales), np.array([run.cost for run in kept]),
            expected.criterion, expected.measure(self.scales), self.seconds(subset),
            np.inf if self.budget.n_runs is None else self.budget.n_runs,
        )  # fmt: skip
        shares = weights(library)
        before = [] if begin is None else [np.append(begin, np.zeros(len(there) - len(begin), int))]
        return _Plan(kept, subset, library, shares, select(library, shares, before))

    def kept_within(self, plan: _Plan) -> tuple[_Plan, dict[str, Assurance]]:
        """Leave out runs that leave their limits, until all together keep them often enough.

        All runs are judged on the same fresh vehicles, so that it can be said on how many of
        them every run keeps its limits.
        """
        expected, safe = self.expected, dict[str, Assurance]()
        judges = draw_models(expected.model, self.spread, CHECKED, expected.prior, self.rng)
        while True:
            for run in plan.picked:
                if run.name not in safe:
                    safe[run.name] = assess_limits(
                        expected.model, run.experiment, rng=self.rng, limits=self.limits,
                        wanted=self.certainty, sea=expected.sea, vehicles=judges,
                        spread=self.spread, prior=expected.prior,
                    )  # fmt: skip
            leaves = self.leaving(plan, safe)
            kept = [run for run in plan.runs if run.name not in leaves]
            if len(kept) == len(plan.runs) or not kept:
                return plan, safe
            plan = self.solve(kept, plan.subset)

    def leaving(self, plan: _Plan, safe: Mapping[str, Assurance]) -> set[str]:
        """Runs left out for the limits: each unsafe one, or what is worst for all together."""
        limited = {run.name: safe[run.name] for run in plan.picked if safe[run.name].limited}
        leaves = {name for name, one in limited.items() if one.probability < self.certainty}
        if leaves or Assurance.joint(limited.values()).probability >= self.certainty:
            return leaves

        def without(name: str) -> float:
            others = (one for other, one in limited.items() if other != name)
            return Assurance.joint(others).probability

        return {max(limited, key=without)}

    def programme(
        self, plan: _Plan, safe: Mapping[str, Assurance], options: Sequence[_Plan], began: float
    ) -> Programme:
        """What is chosen as a result, beside what other sensors and no refinement would tell."""
        expected, budget, scales = self.expected, self.budget, self.scales
        unrefined, most = self.unrefined(plan), max(one.chosen.value for one in options)
        library, chosen, names = plan.library, plan.chosen, expected.names
        sequence = [plan.runs[i] for i in order(library, [int(n) for n in chosen.counts])]
        joint = library.total(chosen.counts.astype(float))
        totals = joint[:, : len(names), : len(names)]
        # Of every vehicle: where coefficients differ, so does what the same runs tell.
        errors = np.array([np.sqrt(np.diag(inverse(matrix))) for matrix in totals])
        low, high = errors.min(axis=0), errors.max(axis=0)
        worth = {", ".join(one.subset) or "none": one.chosen.value for one in options}
        optional = {words: (value, library.factor(value - most)) for words, value in worth.items()}
        return Programme(
            model=expected.model,
            runs=tuple(sequence),
            candidates=plan.runs,
            weights=plan.shares.repetitions,
            information=Information.from_matrix(
                names, totals[0] / scales[:, None] / scales, scales
            ),
            prior=expected.prior,
            criterion=expected.criterion.name,
            value=chosen.value,
            bound=plan.shares.bound,
            relaxed=plan.shares.value,
            share=min(1.0, library.factor(chosen.value - plan.shares.bound)),
            greedy_share=library.factor(unrefined.chosen.greedy - unrefined.chosen.value),
            refined_factor=library.factor(chosen.value - unrefined.chosen.value),
            assurances={run.name: safe[run.name] for run in sequence},
            sea=expected.sea,
            spread=AccuracyRange(names, low, high, len(errors), expected.sea),
            standard=_standard(names, plan),
            outputs=self.measured(plan.subset),
            sensor_hours=self.sensor_hours(plan.subset),
            sensor_options=optional if budget.sensors else {},
            turnaround=budget.turnaround,
            budget=(budget.hours, budget.n_runs),
            misfits=expected.misfits(joint[0]),
            chances=expected.detections(joint[0]),
            seconds=time.perf_counter() - began,
        )

    def unrefined(self, plan: _Plan) -> _Plan:
        """The best of the library without refined commands."""
        plain = [run for run in plan.runs if run.kind != "designed"]
        return plan if len(plain) == len(plan.runs) else self.solve(plain, plan.subset)

    def refined(self, plan: _Plan, number: int) -> _Plan:
        """Refine commands of the three runs that take most time, and choose anew."""
        counts = plan.chosen.counts
        most = min(3, int(np.count_nonzero(counts)))
        fresh = [
            self.completing(plan, int(j), f"designed {number + 1}{chr(97 + int(j) % 26)}")
            for j in np.argsort(-counts * plan.library.costs)[:most]
        ]
        found = [one for one in fresh if one is not None]
        # What was chosen before stays among the starts, so that nothing is lost.
        return self.solve((*plan.runs, *found), plan.subset, begin=counts) if found else plan

    def completing(self, plan: _Plan, j: int, name: str) -> Candidate | None:
        """Command that completes what all other runs tell; None where none is found."""
        run, pattern = plan.runs[j], plan.runs[j].experiment
        trial = Trial.like(pattern, self.limits)
        # Fewer samples in the search than at sea: levels are lowered to tell as much.
        coarse = max(pattern.sample_time, trial.duration / 150)
        coarse = float(pattern.sample_time * np.ceil(coarse / pattern.sample_time - 1e-9))
        expected = self.before(plan, j, np.sqrt(pattern.sample_time / coarse))
        bounds = LimitBounds.of(expected.model, self.limits)
        # The rest of the room between start and limits is for vehicles that differ.
        for room in SIZES[1:3]:
            tight = replace(
                trial, limits=_tightened(self.limits, pattern.initial, room), sample_time=coarse,
                name=name,
            )  # fmt: skip
            try:
                found = find_design(Task.of(expected, tight, self.rng), _REFINING, rng=self.rng)
            except OedSysidError:
                continue
            _, at, tail = run.name.partition(" at ")
            experiment = replace(
                found.experiment, sample_time=pattern.sample_time, limits=self.limits,
                manoeuvre=_ramped(found, self.limits, pattern.sample_time),
                name=f"{name} {at.strip()} {tail}".rstrip(),
            )  # fmt: skip
            kept = kept_on(experiment, (expected.model, *self.vehicles), bounds, self.certainty)
            if kept is not None:
                return Candidate(experiment, "designed", run.cost, kept)
        return None

    def before(self, plan: _Plan, j: int, sampling: float) -> ExpectedInformation:
        """What a search for one run may expect: all others done, white noise as high as tells."""
        expected, scales = self.expected, self.scales
        counts = plan.chosen.counts.astype(float)
        counts[j] -= 1
        n = len(scales)
        matrix = expected.relative(plan.library.total(counts)[0], 1.0 / scales)
        told = plan.library.information[0, j][:n, :n]
        raised = expected.raising(plan.runs[j].experiment, told, scales) * sampling
        return replace(
            expected, model=expected.model.with_noise(raised * expected.sigma), sea=None,
            before=matrix, sigma=raised * expected.sigma, raised=1.0, start="unknown",
            prior=Information.from_matrix(expected.names, matrix[:n, :n], scales),
        )  # fmt: skip


def _ramped(found: Design, limits: Limits, sample: float) -> tuple[Manoeuvre, ...]:
    """Commands at finer samples: an order within the rate of a coarse step becomes a ramp."""
    times = found.trajectory.times
    fine = np.arange(round(float(times[-1] - times[0]) / sample) + 1) * sample + times[0]
    columns = dict(zip(found.model.input_names, found.trajectory.inputs.T, strict=True))
    return tuple(
        as_piecewise(one.input, fine, np.interp(fine, times, columns[one.input]))
        if isinstance(one, Piecewise) and np.isfinite(limits.rates.get(one.input, np.inf))
        else one
        for one in found.experiment.manoeuvres
    )


def _tightened(limits: Limits, initial: Mapping[str, float], room: float) -> Limits:
    """Limits of the motion drawn in towards the start."""
    tight = {}
    for name, (lower, upper) in limits.signals.items():
        middle = min(max(initial.get(name, 0.0), lower), upper)
        pair = (middle + room * (lower - middle), middle + room * (upper - middle))
        inner = pair[0] < pair[1] and lower < middle < upper
        tight[name] = pair if inner else (lower, upper)
    return replace(limits, signals=tight)


def _standard(names: Sequence[str], plan: _Plan) -> Standard | None:
    """The standard programme within the same limits, and how long it would take."""
    runs, library = plan.runs, plan.library

    def worth(i: int) -> tuple[float, float]:
        """Of a trial the one at the speed at which it tells most.

        Of a zigzag that keeps the limits nowhere, the one of the largest angle that does.
        """
        alone = library.value(100.0 * np.eye(len(runs))[i])
        return getattr(_zigzag(runs[i]), "amplitude", 0.0), alone

    picked: list[int] = []
    for word in STANDARD:
        if found := [i for i in _same(word, runs) if i not in picked]:
            picked.append(max(found, key=worth))
    if not picked:
        return None
    counts = np.bincount(picked, minlength=len(runs)).astype(float)
    cost, own = (float(n @ library.costs) for n in (counts, plan.chosen.counts))
    n = len(names)
    errors = np.sqrt(np.diag(np.linalg.pinv(library.total(counts * own / cost)[0][:n, :n])))
    return Standard(
        tuple(runs[i].name for i in picked),
        _times(library, counts, plan.chosen.value) * cost / 3600.0, own / 3600.0,
        dict(zip(names, map(float, errors), strict=True)),
    )  # fmt: skip


def _same(word: str, runs: Sequence[Candidate]) -> list[int]:
    """Runs that are a standard trial, or of its kind; quick zigzags are no standard trials."""
    kind = word.partition(" ")[0]
    same = [i for i, run in enumerate(runs) if run.kind == kind and not _is_quick(run)]
    return [i for i in same if runs[i].name.startswith(word)] or same


def _zigzag(run: Candidate) -> ZigZag | None:
    shape = run.experiment.excitation
    return shape if isinstance(shape, ZigZag) else None


def _is_quick(run: Candidate) -> bool:
    """Whether a zigzag turns before its control's angle is reached, or looks ahead."""
    shape = _zigzag(run)
    return shape is not None and (shape.amplitude != shape.switch or shape.lead > 0)


def _times(library: Library, counts: np.ndarray, target: float) -> float:
    """How many times runs have to be repeated until they are worth a target."""

    def short(times: float) -> float:
        return target - library.value(times * counts)

    if short(1e4) > 0:
        return np.inf
    return 0.0 if short(0.0) <= 0 else float(brentq(short, 0.0, 1e4, rtol=1e-9))
