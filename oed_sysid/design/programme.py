r"""Several runs together: which, how often, in which order, measured with what.

For each of a library of runs the information :math:`F_i(\theta_s)` is taken, random forces
included, on the nominal vehicle and on others drawn from what is known; weights with a
certificate and whole runs by exchange follow :mod:`oed_sysid.design.allocation`. Then the
commands of the chosen runs are refined (column generation): with everything but run ``j``

.. math:: F_{-j} = F_0 + \sum_{i \ne j} x_i F_i

as knowledge before, :func:`~oed_sysid.design.design_experiment` looks for the command that
completes it; what it finds joins the library if it keeps its limits on enough vehicles, and the
weights are solved again. A search sees white noise, so its levels are raised by one factor until
a run is worth to it what it is worth under the forces,

.. math:: \kappa^2 = (\det F^{white}_j / \det F_j)^{1/n}

The certificate covers the library, refined commands included, the criterion, the drawn vehicles and
the noise assumed. It does not cover commands that nobody proposed, nor a model of wrong structure.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.design.allocation import Library, Selection, Weights, order, select, weights
from oed_sysid.design.assurance import AccuracyRange, Assurance, assess_limits
from oed_sysid.design.criteria import AOptimal, Criterion, EOptimal, Setting, inverse
from oed_sysid.design.experiment_design import design_experiment
from oed_sysid.design.library import KINDS, Candidate, as_piecewise, candidate_runs, kept_on
from oed_sysid.design.limits import Corridor
from oed_sysid.design.missing_effects import ByShifts, Chance, Completing, Discriminate, Reveal
from oed_sysid.design.result import Design, Programme, Standard, joint_share
from oed_sysid.design.trial import joint_knowledge, knowledge, nominal_noise
from oed_sysid.design.vehicles import draw_models
from oed_sysid.design.waveforms import Levels
from oed_sysid.errors import DesignError, OedSysidError
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.manoeuvres import Manoeuvre, Piecewise, ZigZag
from oed_sysid.information.bound import information_of, information_of_each
from oed_sysid.information.noise import Levels as NoiseLevels
from oed_sysid.information.noise import noise_of
from oed_sysid.information.shifts import Shifts, joint_information
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model
from oed_sysid.runtime.threads import single_threaded

# Shares of the corridor within which commands are refined: room for vehicles that differ.
_ROOM = (0.75, 0.5)
_LEVELS = 20
# Fresh vehicles that judge the runs chosen, and those that judge a refined command before.
_CHECKED, _SCREENED = 100, 60
_SAMPLES = 150  # of a refined command while it is searched
STANDARD = ("zigzag 10/10", "zigzag 20/20", "circle")


@single_threaded
def design_programme(
    model: Model | Fit,
    patterns: Experiment | Iterable[Experiment],
    *,
    limits: Limits,
    rng: np.random.Generator,
    hours: float | None = None,
    n_runs: int | None = None,
    criterion: Criterion | ByShifts = AOptimal(),  # noqa: B008 (frozen)
    noise: NoiseLevels | NoiseModel | Fit = None,
    spread: float | None = None,
    prior: str | Information | None = "auto",
    turnaround: float = 600.0,
    durations: Sequence[float] | None = None,
    kinds: Sequence[str] = KINDS,
    sensors: Mapping[str, float] | None = None,
    n_draws: int = 4,
    n_vehicles: int = 12,
    n_rounds: int = 1,
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
        Range and rate of the inputs, corridor of the motion.
    rng : numpy.random.Generator
    hours : float, optional
        Time for everything, turnarounds and sensors included, h.
    n_runs : int, optional
        Largest number of runs. Give hours, a number of runs, or both.
    criterion : Criterion, Discriminate or Reveal
        Smooth: D, A, Ds or V; or what a search for missing physics is to find, for which a fit
        brings its records.
    noise : optional
        Levels, a noise model with random forces, or a fit; see
        :func:`~oed_sysid.information.information_of`.
    spread : float or None
        Relative half-width of uniform draws of possible vehicles; None draws from what
        is known (prior standard deviations, or the fit).
    prior : {"auto", None} or Information
        Known before; see :func:`~oed_sysid.design.design_experiment`.
    turnaround : float
        Between two runs, s.
    durations, kinds
        See :func:`~oed_sysid.design.library.candidate_runs`.
    sensors : mapping of str to float, optional
        Outputs that need not be measured, and what each costs, h. All subsets are tried.
    n_draws : int
        Vehicles besides the nominal one that the worth is averaged over.
    n_vehicles : int
        Vehicles on which limits are checked.
    n_rounds : int
        Rounds of refined commands.
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
    given = model
    nominal = given.model if isinstance(given, Fit) else given
    if isinstance(given, Fit) and noise is None:
        noise = given
    nominal, sea, levels = nominal_noise(nominal, noise)
    known = knowledge(given, nominal, prior)
    vehicles = draw_models(nominal, spread, max(n_vehicles, n_draws, _SCREENED), known, rng)
    if isinstance(criterion, EOptimal):
        raise DesignError("E is not smooth, so that no bound can be stated. Choose D or A.")
    listed = [patterns] if isinstance(patterns, Experiment) else list(patterns)
    tell("making candidate runs")
    runs = list(
        candidate_runs(
            nominal, listed, limits=limits, rng=rng, vehicles=vehicles[:n_vehicles],
            durations=durations, turnaround=turnaround, kinds=kinds, kept=certainty,
        )
    )  # fmt: skip
    expected = levels if sea is None else sea
    shifts, before = None, None
    if isinstance(criterion, ByShifts):
        shifts = criterion.shifts(nominal)
        before = joint_knowledge(given, nominal, shifts, expected, prior)
    task = _Task(
        nominal, (nominal, *vehicles[:n_draws]), known, criterion, expected, hours, n_runs,
        shifts, before,
    )  # fmt: skip
    optional = dict(sensors or {})
    tell(f"information of {len(runs)} candidate runs")
    options = {
        subset: task.solve(runs, task.measured(subset, optional), _spent(subset, optional))
        for subset in _subsets(optional)
    }
    subset = max(options, key=lambda key: options[key][2].value)
    library, shares, chosen = options[subset]
    outputs, spent = task.measured(subset, optional), _spent(subset, optional)
    runs = task.kept
    for number in range(n_rounds):
        tell(f"refining commands, round {number + 1}")
        fresh = [
            found
            for j in np.argsort(-chosen.counts * library.costs)[:_most(chosen)]
            if (found := _refined(task, library, chosen, runs[int(j)], int(j), limits, vehicles,
                                  certainty, rng, f"designed {number + 1}{chr(97 + int(j) % 26)}"))
        ]  # fmt: skip
        if not fresh:
            break
        runs = [*runs, *fresh]
        # What was chosen before stays among the starts, so that nothing is lost.
        library, shares, better = task.solve(runs, outputs, spent, begin=chosen.counts)
        runs = task.kept
        gained = better.value - chosen.value
        chosen = better
        if gained < 1e-3:
            break
    safe: dict[str, Assurance] = {}
    # All runs are judged on the same fresh vehicles, so that it can be said on how many of them
    # every run keeps its limits.
    judges = draw_models(nominal, spread, _CHECKED, known, rng)
    while True:
        tell("checking limits on other vehicles")
        picked = [runs[int(i)] for i in np.flatnonzero(chosen.counts)]
        for run in picked:
            if run.name not in safe:
                safe[run.name] = replace(
                    assess_limits(
                        nominal, run.experiment, rng=rng, limits=limits, wanted=certainty, sea=sea,
                        vehicles=judges,
                    ),
                    spread=spread,
                )  # fmt: skip
        leaves = {name for name, one in safe.items() if not _is_safe(one, certainty)}
        if not leaves and joint_share([safe[run.name] for run in picked]) < certainty:
            leaves = {_worst(picked, safe)}
        kept = [run for run in runs if run.name not in leaves]
        if len(kept) == len(runs) or not kept:
            break
        library, shares, chosen = task.solve(kept, outputs, spent)
        runs = task.kept
    plain = [run for run in runs if run.kind != "designed"]
    first = chosen if len(plain) == len(runs) else task.solve(plain, outputs, spent)[2]
    sequence = [runs[i] for i in order(library, [int(n) for n in chosen.counts])]
    joint = library.total(chosen.counts.astype(float))
    names, scales = task.names, task.scales
    n = len(names)
    totals = joint[:, :n, :n]
    bound = Information.from_matrix(names, totals[0] / scales[:, None] / scales, scales)
    errors = np.array([np.sqrt(np.diag(inverse(matrix))) for matrix in totals])
    spread_of_errors = AccuracyRange(
        names, errors.min(axis=0), errors.max(axis=0), len(errors), sea
    )
    return Programme(
        model=nominal,
        runs=tuple(sequence),
        candidates=tuple(runs),
        weights=shares.repetitions,
        information=bound,
        prior=known,
        criterion=criterion.name,
        value=chosen.value,
        bound=shares.bound,
        relaxed=shares.value,
        share=min(1.0, library.factor(chosen.value - shares.bound)),
        greedy_share=library.factor(first.greedy - first.value),
        refined_factor=library.factor(chosen.value - first.value),
        n_library=len(plain),
        assurances={run.name: safe[run.name] for run in sequence},
        sea=sea,
        spread=spread_of_errors,
        standard=_standard(task, runs, library, chosen),
        outputs=outputs,
        sensor_hours=spent,
        sensor_options={
            ", ".join(key) or "none": (option[2].value, library.factor(
                option[2].value - options[subset][2].value))
            for key, option in options.items()
        } if optional else {},
        turnaround=turnaround,
        budget=(hours, n_runs),
        misfits=task.misfits(joint[0]),
        chances=task.chances(joint[0]),
        seconds=time.perf_counter() - began,
    )  # fmt: skip


def _is_safe(found: Assurance, certainty: float) -> bool:
    return not found.limited or found.probability >= certainty


def _worst(picked: Sequence[Candidate], safe: Mapping[str, Assurance]) -> str:
    """Run without which the others keep their limits together on the most vehicles."""
    return max(
        (run.name for run in picked),
        key=lambda name: joint_share([safe[run.name] for run in picked if run.name != name]),
    )


def _most(chosen: Selection) -> int:
    """Runs whose commands are refined in one round."""
    return min(3, int(np.count_nonzero(chosen.counts)))


def _subsets(optional: Mapping[str, float]) -> list[tuple[str, ...]]:
    names = tuple(optional)
    return [pick for size in range(len(names) + 1) for pick in combinations(names, size)]


def _spent(subset: Sequence[str], optional: Mapping[str, float]) -> float:
    return float(sum(optional[name] for name in subset))


class _Task:
    """Information of runs on every vehicle, kept, and the two problems solved on it."""

    def __init__(
        self,
        model: Model,
        vehicles: Sequence[Model],
        known: Information | None,
        criterion: Criterion | ByShifts,
        noise: NoiseModel | np.ndarray,
        hours: float | None,
        n_runs: int | None,
        shifts: Shifts | None = None,
        before: np.ndarray | None = None,
    ) -> None:
        shared = [p for p in model.free_parameters if not p.per_record]
        self.model, self.vehicles, self.noise = model, tuple(vehicles), noise
        self.names = tuple(p.name for p in shared)
        self.scales = np.array([p.reference for p in shared])
        self.criterion, self.hours, self.n_runs = criterion, hours, n_runs
        self.known = known
        self.shifts = shifts
        # Parameters in units of their values; effects are in units of their size already.
        self.units = self.scales
        if shifts is not None and before is not None:
            assert isinstance(criterion, ByShifts)
            self.measure = criterion.bind_shifts(shifts, len(shared))
            self.units = np.concatenate([self.scales, np.ones(len(shifts))])
            self.prior = before * self.units[:, None] * self.units
        else:
            assert isinstance(criterion, Criterion)
            setting = Setting(model, self.names, self.scales, noise_of(model, _sigma(noise)))
            self.measure = criterion.bind(setting)
            self.prior = np.zeros((len(shared),) * 2)
            if known is not None:
                self.prior = known.matrix * self.scales[:, None] * self.scales
        self.kept: list[Candidate] = []
        self._cache: dict[tuple[int, tuple[str, ...]], np.ndarray | None] = {}

    def measured(self, subset: Sequence[str], optional: Mapping[str, float]) -> tuple[str, ...]:
        """Outputs that are measured with some of the optional sensors."""
        for name in optional:
            if name not in self.model.output_names:
                raise DesignError(
                    f"The sensor {name!r} is no output of model {self.model.name!r}; it has "
                    f"{', '.join(self.model.output_names)}."
                )
        return tuple(n for n in self.model.output_names if n not in optional or n in subset)

    def information(
        self, runs: Sequence[Candidate], outputs: tuple[str, ...]
    ) -> list[np.ndarray | None]:
        """Relative information of runs on every vehicle, ``(n_vehicles, n, n)`` each.

        None where one vehicle diverges.
        """
        missing = [run for run in runs if (id(run), outputs) not in self._cache]
        told = [self._told(vehicle, missing, outputs) for vehicle in self.vehicles]
        for run, parts in zip(missing, zip(*told, strict=True), strict=True):
            found = [part for part in parts if part is not None]
            whole = len(found) == len(parts)
            self._cache[id(run), outputs] = (
                np.stack(found) * self.units[:, None] * self.units if whole else None
            )
        return [self._cache[id(run), outputs] for run in runs]

    def _told(
        self, vehicle: Model, runs: Sequence[Candidate], outputs: tuple[str, ...]
    ) -> list[np.ndarray | None]:
        """Information of runs on one vehicle, SI units; None where it diverges."""
        if self.shifts is None:
            each = information_of_each(
                vehicle, [run.experiment for run in runs], noise=self.noise, priors=None,
                outputs=outputs,
            )  # fmt: skip
            return [None if one is None else one.matrix for one in each]
        assert isinstance(self.criterion, ByShifts)
        shifts = self.shifts if vehicle is self.model else self.criterion.shifts(vehicle)
        found: list[np.ndarray | None] = []
        for run in runs:
            try:
                found.append(
                    joint_information(
                        vehicle, run.experiment, shifts, noise=self.noise, outputs=outputs
                    )
                )
            except OedSysidError:
                found.append(None)
        return found

    def misfits(self, total: np.ndarray) -> dict[tuple[str, str], float]:
        """For discrimination: expected gain of every rival over every other."""
        if not isinstance(self.criterion, Discriminate) or self.shifts is None:
            return {}
        return self.criterion.misfits(self.model, self.shifts, total, len(self.names))

    def chances(self, total: np.ndarray) -> tuple[Chance, ...]:
        """For effects to be revealed: how surely they show, before and after."""
        if not isinstance(self.criterion, Reveal) or self.shifts is None:
            return ()
        return self.criterion.chances(self.shifts, self.prior, total, len(self.names))

    def solve(
        self,
        runs: Sequence[Candidate],
        outputs: tuple[str, ...],
        spent: float,
        begin: np.ndarray | None = None,
    ) -> tuple[Library, Weights, Selection]:
        """Weights and whole runs; ``kept`` then holds the runs in the library's order."""
        told = self.information(runs, outputs)
        there = [(run, m) for run, m in zip(runs, told, strict=True) if m is not None]
        self.kept = [run for run, _ in there]
        if not there:
            raise DesignError("No candidate run stays finite on all vehicles. Make them gentler.")
        library = Library(
            np.stack([matrix for _, matrix in there], axis=1), self.prior,
            np.array([run.cost for run in self.kept]), self.criterion, self.measure,
        )  # fmt: skip
        budget = None if self.hours is None else 3600.0 * (self.hours - spent)
        if budget is not None and budget <= 0:
            raise DesignError("The sensors alone take longer than there is time. Give more hours.")
        shares = weights(library, budget=budget, n_runs=self.n_runs)
        before = [] if begin is None else [np.append(begin, np.zeros(len(there) - len(begin), int))]
        chosen = select(library, shares, budget=budget, n_runs=self.n_runs, begin=before)
        return library, shares, chosen


def _sigma(noise: NoiseModel | np.ndarray) -> np.ndarray:
    return noise.sensors if isinstance(noise, NoiseModel) else noise


def _refined(
    task: _Task,
    library: Library,
    chosen: Selection,
    run: Candidate,
    j: int,
    limits: Limits,
    vehicles: Sequence[Model],
    certainty: float,
    rng: np.random.Generator,
    name: str,
) -> Candidate | None:
    """Command that completes what all other runs tell; None where none is found."""
    counts = chosen.counts.astype(float)
    counts[j] -= 1
    scales = task.scales
    n = len(scales)
    joint = library.total(counts)[0]
    rest = joint[:n, :n]
    before = Information.from_matrix(task.names, rest / scales[:, None] / scales, scales)
    criterion = task.criterion
    if isinstance(criterion, ByShifts):
        criterion = Completing(criterion, joint / task.units[:, None] / task.units)
    white = information_of(task.model, run.experiment, noise=_sigma(task.noise), priors=None)
    ratio = np.linalg.slogdet(white.matrix * scales[:, None] * scales + 1e-9 * np.eye(n))[1]
    ratio -= np.linalg.slogdet(library.information[0, j][:n, :n] + 1e-9 * np.eye(n))[1]
    raised = _sigma(task.noise) * np.exp(0.5 * max(ratio, 0.0) / n)
    pattern = run.experiment
    duration = float(pattern.duration or 0.0)
    # Fewer samples in the search than at sea: levels are lowered to tell as much.
    coarse = max(pattern.sample_time, duration / _SAMPLES)
    coarse = pattern.sample_time * np.ceil(coarse / pattern.sample_time - 1e-9)
    raised = raised * np.sqrt(pattern.sample_time / coarse)
    corridor = Corridor.of(task.model, limits, {}, kernel(task.model).n_full)
    for room in _ROOM:
        tight = replace(limits, signals=_tightened(limits, pattern.initial, room))
        try:
            found = design_experiment(
                task.model, limits=tight, duration=duration, sample_time=float(coarse), rng=rng,
                criterion=criterion, parametrisation=Levels(_LEVELS), prior=before,
                constants=pattern.constants, initial=pattern.initial, noise=raised, n_starts=2,
                n_candidates=30, n_steps=10, n_workers=1, name=name,
            )  # fmt: skip
        except OedSysidError:
            continue
        experiment = replace(
            found.experiment, sample_time=pattern.sample_time, limits=limits,
            manoeuvre=_ramped(found, limits, pattern.sample_time),
            name=f"{name} {_ending(run.name)}".strip(),
        )  # fmt: skip
        kept = kept_on(experiment, (task.model, *vehicles), corridor, certainty)
        if kept is not None:
            return Candidate(experiment, "designed", run.cost, kept)
    return None


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
    """Corridor drawn in towards the start."""
    tight = {}
    for name, (lower, upper) in limits.signals.items():
        start = initial.get(name, 0.0)
        middle = min(max(start, lower), upper)
        tight[name] = (middle + room * (lower - middle), middle + room * (upper - middle))
        if not tight[name][0] < tight[name][1] or middle in (lower, upper):
            tight[name] = (lower, upper)
    return tight


def _is_equal(shape: object) -> bool:
    """Whether a zigzag turns at the angle of its control."""
    return isinstance(shape, ZigZag) and shape.amplitude == shape.switch and not shape.lead


def _angle(run: Candidate) -> float:
    """Angle of a zigzag's control, rad; nothing for other runs."""
    shape = run.experiment.excitation
    return shape.amplitude if isinstance(shape, ZigZag) else 0.0


def _standard(
    task: _Task, runs: Sequence[Candidate], library: Library, chosen: Selection
) -> Standard | None:
    """The standard programme within the same limits, and how long it would take.

    Of each trial the one at the speed at which it tells most; of a zigzag that keeps the limits
    nowhere, the one of the largest angle that does.
    """

    def alone(i: int) -> float:
        """Worth of one run alone, repeated."""
        return library.value(100.0 * np.eye(len(runs))[i])

    picked: list[int] = []
    for word in STANDARD:
        kind = word.partition(" ")[0]
        same = [i for i, run in enumerate(runs) if run.kind == kind]
        if kind == "zigzag":  # quick ones are no standard trials
            shapes = {i: runs[i].experiment.excitation for i in same}
            same = [i for i in same if _is_equal(shapes[i])]
        exact = [i for i in same if runs[i].name.startswith(word)]
        found = [i for i in exact or same if i not in picked]
        if found:
            picked.append(max(found, key=lambda i: (_angle(runs[i]), alone(i))))
    if not picked:
        return None
    counts = np.zeros(len(runs))
    counts[picked] = 1.0
    cost = float(counts @ library.costs)
    target = chosen.value
    low, high = 0.0, 1.0
    if library.value(1e4 * counts) < target:
        factor = np.inf
    else:
        while library.value(high * counts) < target:
            low, high = high, 2 * high
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if library.value(middle * counts) < target else (low, middle)
        factor = high
    own = float(chosen.counts @ library.costs)
    n = len(task.names)
    errors = np.sqrt(np.diag(np.linalg.pinv(library.total(counts * own / cost)[0][:n, :n])))
    return Standard(
        tuple(runs[i].name for i in picked), factor * cost / 3600.0, own / 3600.0,
        dict(zip(task.names, map(float, errors), strict=True)),
    )  # fmt: skip
