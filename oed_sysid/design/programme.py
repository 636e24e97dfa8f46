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
from itertools import combinations

import numpy as np

from oed_sysid.design.allocation import Library, Selection, Weights, order, select, weights
from oed_sysid.design.assurance import AccuracyRange, Assurance, assess_limits
from oed_sysid.design.criteria import AOptimal, Criterion, EOptimal, inverse
from oed_sysid.design.experiment_design import find_design
from oed_sysid.design.knowledge import ExpectedInformation, Knowledge
from oed_sysid.design.library import KINDS, Candidate, as_piecewise, candidate_runs
from oed_sysid.design.limits import LimitBounds
from oed_sysid.design.missing_effects import ByShifts
from oed_sysid.design.result import Design, Programme, Standard, joint_share
from oed_sysid.design.trial import Search, Task, Trial
from oed_sysid.design.vehicles import draw_models, kept_on
from oed_sysid.design.waveforms import Levels
from oed_sysid.errors import DesignError, OedSysidError, respelled
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.manoeuvres import Manoeuvre, Piecewise, ZigZag
from oed_sysid.information.bound import information_of
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.physics.model import Model
from oed_sysid.runtime.threads import single_threaded

# Shares of the room between start and limits within which commands are refined: the rest is for
# vehicles that differ.
_ROOM = (0.75, 0.5)
# Fresh vehicles that judge the runs chosen, and those that judge a refined command before.
_CHECKED, _SCREENED = 200, 60
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
    """

    hours: float | None = None
    n_runs: int | None = None
    turnaround: float = 600.0
    sensors: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.hours is None and self.n_runs is None:
            raise DesignError(
                "A programme needs an end. Give Budget(hours=...), Budget(n_runs=...), or both; on "
                "the command line --hours and --runs."
            )


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
    """

    durations: Sequence[float] | None = None
    kinds: Sequence[str] = KINDS
    n_draws: int = 4
    n_vehicles: int = 12
    n_rounds: int = 1


_GONE = {
    **{n: f"budget=Budget({n}=...)" for n in ("hours", "n_runs", "turnaround", "sensors")},
    **{n: f"knowledge=Knowledge({n}=...)" for n in ("noise", "spread", "prior")},
    **{
        n: f"search=ProgrammeSearch({n}=...)"
        for n in ("durations", "kinds", "n_draws", "n_vehicles", "n_rounds")
    },
}


@respelled(DesignError, _GONE)
@single_threaded
def design_programme(
    model: Model | Fit,
    patterns: Experiment | Iterable[Experiment],
    *,
    limits: Limits,
    budget: Budget,
    rng: np.random.Generator,
    criterion: Criterion | ByShifts = AOptimal(),  # noqa: B008 (frozen)
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
    """
    began = time.perf_counter()
    tell = progress or (lambda words: None)
    if isinstance(criterion, EOptimal):
        raise DesignError("E is not smooth, so that no bound can be stated. Choose D or A.")
    expected = ExpectedInformation.of(model, criterion, knowledge)
    nominal, known, spread = expected.model, expected.prior, knowledge.spread
    n_vehicles = max(search.n_vehicles, search.n_draws, _SCREENED)
    vehicles = draw_models(nominal, spread, n_vehicles, known, rng)
    tell("making candidate runs")
    runs = candidate_runs(
        nominal, patterns, limits=limits, rng=rng, vehicles=vehicles[: search.n_vehicles],
        durations=search.durations, turnaround=budget.turnaround, kinds=search.kinds,
        kept=certainty,
    )  # fmt: skip
    planner = _Planner(expected, (nominal, *vehicles[: search.n_draws]), limits, budget, certainty)
    tell(f"information of {len(runs)} candidate runs")
    options = {subset: planner.solve(runs, subset) for subset in _subsets(budget.sensors)}
    subset = max(options, key=lambda key: options[key].chosen.value)
    plan = options[subset]
    for number in range(search.n_rounds):
        tell(f"refining commands, round {number + 1}")
        better = planner.refined(plan, subset, vehicles, rng, number)
        gained = better.chosen.value - plan.chosen.value
        plan = better
        if gained < 1e-3:
            break
    tell("checking limits on other vehicles")
    plan, safe = planner.kept_within(plan, subset, spread, rng)
    return _result(planner, plan, safe, options, subset, time.perf_counter() - began)


def _result(
    planner: _Planner,
    plan: _Plan,
    safe: Mapping[str, Assurance],
    options: Mapping[tuple[str, ...], _Plan],
    subset: tuple[str, ...],
    seconds: float,
) -> Programme:
    """What was planned, with all that is stated about it."""
    plain = [run for run in plan.runs if run.kind != "designed"]
    first = plan if len(plain) == len(plan.runs) else planner.solve(plain, subset)
    expected, budget = planner.expected, planner.budget
    library, chosen = plan.library, plan.chosen
    sequence = [plan.runs[i] for i in order(library, [int(n) for n in chosen.counts])]
    joint = library.total(chosen.counts.astype(float))
    names, scales = expected.names, planner.scales
    totals = joint[:, : len(names), : len(names)]
    errors = np.array([np.sqrt(np.diag(inverse(matrix))) for matrix in totals])
    sizes = {key: option.chosen.value - options[subset].chosen.value
             for key, option in options.items()}  # fmt: skip
    return Programme(
        model=expected.model,
        runs=tuple(sequence),
        candidates=plan.runs,
        weights=plan.shares.repetitions,
        information=Information.from_matrix(names, totals[0] / scales[:, None] / scales, scales),
        prior=expected.prior,
        criterion=expected.criterion.name,
        value=chosen.value,
        bound=plan.shares.bound,
        relaxed=plan.shares.value,
        share=min(1.0, library.factor(chosen.value - plan.shares.bound)),
        greedy_share=library.factor(first.chosen.greedy - first.chosen.value),
        refined_factor=library.factor(chosen.value - first.chosen.value),
        n_library=len(plain),
        assurances={run.name: safe[run.name] for run in sequence},
        sea=expected.sea,
        spread=AccuracyRange(
            names, errors.min(axis=0), errors.max(axis=0), len(errors), expected.sea
        ),
        standard=_standard(names, plan),
        outputs=planner.measured(subset),
        sensor_hours=planner.sensor_hours(subset),
        sensor_options={
            ", ".join(key) or "none": (options[key].chosen.value, library.factor(size))
            for key, size in sizes.items()
        }
        if budget.sensors
        else {},
        turnaround=budget.turnaround,
        budget=(budget.hours, budget.n_runs),
        misfits=expected.misfits(joint[0]),
        chances=expected.detections(joint[0]),
        seconds=seconds,
    )


def _leaving(
    picked: Sequence[Candidate], safe: Mapping[str, Assurance], certainty: float
) -> set[str]:
    """Runs that are left out for the limits: each unsafe one, or what is worst for all together."""
    found = [safe[run.name] for run in picked]
    leaves = {
        run.name
        for run, one in zip(picked, found, strict=True)
        if one.limited and one.probability < certainty
    }
    if leaves or joint_share(found) >= certainty:
        return leaves

    def without(name: str) -> float:
        return joint_share([safe[run.name] for run in picked if run.name != name])

    return {max((run.name for run in picked), key=without)}


def _subsets(optional: Mapping[str, float]) -> list[tuple[str, ...]]:
    names = tuple(optional)
    return [pick for size in range(len(names) + 1) for pick in combinations(names, size)]


@dataclass(frozen=True, eq=False)
class _Plan:
    """Runs that stay finite on all vehicles, their weights, and the whole runs chosen."""

    runs: tuple[Candidate, ...]
    library: Library
    shares: Weights
    chosen: Selection

    @property
    def picked(self) -> list[Candidate]:
        """Runs that are chosen once or more."""
        return [self.runs[int(i)] for i in np.flatnonzero(self.chosen.counts)]


class _Planner:
    """Information of runs on every vehicle, kept, and the two problems solved on it."""

    def __init__(
        self,
        expected: ExpectedInformation,
        vehicles: Sequence[Model],
        limits: Limits,
        budget: Budget,
        certainty: float,
    ) -> None:
        self.expected, self.vehicles = expected, tuple(vehicles)
        self.limits, self.budget, self.certainty = limits, budget, certainty
        model = expected.model
        # Errors count relative to the values, on all vehicles alike.
        self.scales = np.array([model.parameter(name).reference for name in expected.names])
        self.measure = expected.measure(scales=self.scales)
        self.prior = expected.relative(expected.before, self.scales)
        self._cache: dict[tuple[int, tuple[str, ...]], np.ndarray | None] = {}

    def measured(self, subset: Sequence[str]) -> tuple[str, ...]:
        """Outputs that are measured with some of the optional sensors."""
        model, optional = self.expected.model, self.budget.sensors
        for name in optional:
            if name not in model.output_names:
                raise DesignError(
                    f"The sensor {name!r} is no output of model {model.name!r}; it has "
                    f"{', '.join(model.output_names)}."
                )
        return tuple(n for n in model.output_names if n not in optional or n in subset)

    def sensor_hours(self, subset: Sequence[str]) -> float:
        """Time that some of the optional sensors take, h."""
        return float(sum(self.budget.sensors[name] for name in subset))

    def information(
        self, runs: Sequence[Candidate], outputs: tuple[str, ...]
    ) -> list[np.ndarray | None]:
        """Relative information of runs on every vehicle, ``(n_vehicles, n, n)`` each.

        None where one vehicle diverges.
        """
        missing = [run for run in runs if (id(run), outputs) not in self._cache]
        experiments = [run.experiment for run in missing]
        told = [
            self.expected.each(experiments, vehicle=vehicle, outputs=outputs)
            for vehicle in self.vehicles
        ]
        for run, parts in zip(missing, zip(*told, strict=True), strict=True):
            found = [
                self.expected.relative(part, self.scales) for part in parts if part is not None
            ]
            whole = len(found) == len(parts)
            self._cache[id(run), outputs] = np.stack(found) if whole else None
        return [self._cache[id(run), outputs] for run in runs]

    def solve(
        self,
        runs: Sequence[Candidate],
        subset: tuple[str, ...],
        begin: np.ndarray | None = None,
    ) -> _Plan:
        """Weights and whole runs, measured with some of the optional sensors."""
        told = self.information(runs, self.measured(subset))
        there = [(run, m) for run, m in zip(runs, told, strict=True) if m is not None]
        if not there:
            raise DesignError("No candidate run stays finite on all vehicles. Make them gentler.")
        kept = tuple(run for run, _ in there)
        library = Library(
            np.stack([matrix for _, matrix in there], axis=1), self.prior,
            np.array([run.cost for run in kept]), self.expected.criterion, self.measure,
        )  # fmt: skip
        hours, n_runs = self.budget.hours, self.budget.n_runs
        budget = None if hours is None else 3600.0 * (hours - self.sensor_hours(subset))
        if budget is not None and budget <= 0:
            raise DesignError("The sensors alone take longer than there is time. Give more hours.")
        shares = weights(library, budget=budget, n_runs=n_runs)
        before = [] if begin is None else [np.append(begin, np.zeros(len(there) - len(begin), int))]
        chosen = select(library, shares, budget=budget, n_runs=n_runs, begin=before)
        return _Plan(kept, library, shares, chosen)

    def kept_within(
        self, plan: _Plan, subset: tuple[str, ...], spread: float | None, rng: np.random.Generator
    ) -> tuple[_Plan, dict[str, Assurance]]:
        """Leave out runs that leave their limits, until all together keep them often enough.

        All runs are judged on the same fresh vehicles, so that it can be said on how many of
        them every run keeps its limits.
        """
        expected, safe = self.expected, dict[str, Assurance]()
        judges = draw_models(expected.model, spread, _CHECKED, expected.prior, rng)
        while True:
            for run in plan.picked:
                if run.name not in safe:
                    found = assess_limits(
                        expected.model, run.experiment, rng=rng, limits=self.limits,
                        wanted=self.certainty, sea=expected.sea, vehicles=judges,
                    )  # fmt: skip
                    safe[run.name] = replace(found, spread=spread)
            leaves = _leaving(plan.picked, safe, self.certainty)
            kept = [run for run in plan.runs if run.name not in leaves]
            if len(kept) == len(plan.runs) or not kept:
                return plan, safe
            plan = self.solve(kept, subset)

    def refined(
        self,
        plan: _Plan,
        subset: tuple[str, ...],
        vehicles: Sequence[Model],
        rng: np.random.Generator,
        number: int,
    ) -> _Plan:
        """Refine commands of the three runs that take most time, and choose anew."""
        counts = plan.chosen.counts
        most = min(3, int(np.count_nonzero(counts)))
        fresh = []
        for j in np.argsort(-counts * plan.library.costs)[:most]:
            name = f"designed {number + 1}{chr(97 + int(j) % 26)}"
            found = self._completing(plan, int(j), vehicles, rng, name)
            if found is not None:
                fresh.append(found)
        if not fresh:
            return plan
        # What was chosen before stays among the starts, so that nothing is lost.
        return self.solve((*plan.runs, *fresh), subset, begin=counts)

    def _completing(
        self,
        plan: _Plan,
        j: int,
        vehicles: Sequence[Model],
        rng: np.random.Generator,
        name: str,
    ) -> Candidate | None:
        """Command that completes what all other runs tell; None where none is found."""
        run, pattern = plan.runs[j], plan.runs[j].experiment
        trial = Trial.like(pattern, self.limits)
        # Fewer samples in the search than at sea: levels are lowered to tell as much.
        coarse = max(pattern.sample_time, trial.duration / 150)
        coarse = float(pattern.sample_time * np.ceil(coarse / pattern.sample_time - 1e-9))
        expected = self._before(plan, j, np.sqrt(pattern.sample_time / coarse))
        bounds = LimitBounds.of(expected.model, self.limits)
        for room in _ROOM:
            signals = _tightened(self.limits, pattern.initial, room)
            tight = replace(
                trial, limits=replace(self.limits, signals=signals), sample_time=coarse, name=name
            )
            try:
                found = find_design(Task.of(expected, tight, rng), _REFINING, rng=rng)
            except OedSysidError:
                continue
            experiment = replace(
                found.experiment, sample_time=pattern.sample_time, limits=self.limits,
                manoeuvre=_ramped(found, self.limits, pattern.sample_time),
                name=f"{name} {_ending(run.name)}".strip(),
            )  # fmt: skip
            kept = kept_on(experiment, (expected.model, *vehicles), bounds, self.certainty)
            if kept is not None:
                return Candidate(experiment, "designed", run.cost, kept)
        return None

    def _before(self, plan: _Plan, j: int, sampling: float) -> ExpectedInformation:
        """What a search for one run may expect: all others done, white noise as high as tells."""
        expected, scales = self.expected, self.scales
        counts = plan.chosen.counts.astype(float)
        counts[j] -= 1
        rest = plan.library.total(counts)[0]
        n = len(scales)
        matrix = expected.relative(rest, 1.0 / scales)
        white = information_of(
            expected.model, plan.runs[j].experiment, noise=expected.sigma, priors=None
        )
        told = (expected.relative(white.matrix, scales), plan.library.information[0, j][:n, :n])
        # Directions that a run does not see count alike under both kinds of noise.
        logs = [np.linalg.slogdet(one + 1e-9 * np.eye(n))[1] for one in told]
        raised = np.exp(0.5 * max(logs[0] - logs[1], 0.0) / n) * sampling
        outputs = tuple(
            replace(o, noise_std=float(raised * s))
            for o, s in zip(expected.model.outputs, expected.sigma, strict=True)
        )
        return replace(
            expected, model=replace(expected.model, outputs=outputs), sea=None, before=matrix,
            sigma=raised * expected.sigma, raised=1.0, start="unknown", coloured=None,
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


def _ending(name: str) -> str:
    """What a run's name says of speed and length."""
    _, found, tail = name.partition(" at ")
    return found.strip() + " " + tail if found else ""


def _tightened(
    limits: Limits, initial: Mapping[str, float], room: float
) -> dict[str, tuple[float, float]]:
    """LimitBounds drawn in towards the start."""
    tight = {}
    for name, (lower, upper) in limits.signals.items():
        start = initial.get(name, 0.0)
        middle = min(max(start, lower), upper)
        tight[name] = (middle + room * (lower - middle), middle + room * (upper - middle))
        if not tight[name][0] < tight[name][1] or middle in (lower, upper):
            tight[name] = (lower, upper)
    return tight


def _standard(names: Sequence[str], plan: _Plan) -> Standard | None:
    """The standard programme within the same limits, and how long it would take."""
    runs, library = plan.runs, plan.library
    picked: list[int] = []
    for word in STANDARD:
        found = [i for i in _same(word, runs) if i not in picked]
        if found:
            # Of each trial the one at the speed at which it tells most; of a zigzag that keeps
            # the limits nowhere, the one of the largest angle that does.
            alone = {i: library.value(100.0 * np.eye(len(runs))[i]) for i in found}
            picked.append(max(found, key=lambda i: (_angle(runs[i]), alone[i])))
    if not picked:
        return None
    counts = np.zeros(len(runs))
    counts[picked] = 1.0
    cost, own = (float(n @ library.costs) for n in (counts, plan.chosen.counts))
    factor = _times(library, counts, plan.chosen.value)
    n = len(names)
    errors = np.sqrt(np.diag(np.linalg.pinv(library.total(counts * own / cost)[0][:n, :n])))
    return Standard(
        tuple(runs[i].name for i in picked), factor * cost / 3600.0, own / 3600.0,
        dict(zip(names, map(float, errors), strict=True)),
    )  # fmt: skip


def _same(word: str, runs: Sequence[Candidate]) -> list[int]:
    """Runs that are a standard trial, or of its kind; quick zigzags are no standard trials."""
    same = []
    for i, run in enumerate(runs):
        shape = run.experiment.excitation
        if run.kind == word.partition(" ")[0] and (
            run.kind != "zigzag"
            or (isinstance(shape, ZigZag) and shape.amplitude == shape.switch and not shape.lead)
        ):
            same.append(i)
    return [i for i in same if runs[i].name.startswith(word)] or same


def _angle(run: Candidate) -> float:
    """Angle of a zigzag's control, rad; nothing for other runs."""
    shape = run.experiment.excitation
    return shape.amplitude if isinstance(shape, ZigZag) else 0.0


def _times(library: Library, counts: np.ndarray, target: float) -> float:
    """How many times runs have to be repeated until they are worth a target."""
    if library.value(1e4 * counts) < target:
        return np.inf
    low, high = 0.0, 1.0
    while library.value(high * counts) < target:
        low, high = high, 2 * high
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if library.value(middle * counts) < target else (low, middle)
    return high
