r"""The verb of this package: design an experiment within limits; and several, one after another.

.. math::
    \max_{u \in \mathcal U}\ \varphi\left(F_0 + F(u; \hat\theta)\right) \quad\text{subject to}
    \quad h\left(x(t; u, \theta_s)\right) \le 0 \ \text{ for all but } k \text{ of the } \theta_s

with the information :math:`F` of the run (start states eliminated) and :math:`F_0` in hand, the
criterion :math:`\varphi` (:mod:`oed_sysid.design.criteria`), commands :math:`u` of a family within
range and rate (:mod:`oed_sysid.design.waveforms`), and limits :math:`h`
(:mod:`oed_sysid.design.vehicles`) on vehicles that are possible (:mod:`oed_sysid.design.vehicles`).
Rough manoeuvres are refined by sequential linear programs (:mod:`oed_sysid.design.search`).

In a campaign all records up to run ``k`` give

.. math::
    \hat\theta_k = \arg\max_\theta \sum_{j \le k} \log L_j(\theta), \qquad
    F_k = \sum_{j \le k} F_j(\hat\theta_k), \qquad
    u_{k+1} = \arg\max_u \varphi\left(F_k + F(u; \hat\theta_k)\right)

within limits that hold on the vehicles which :math:`F_k` leaves possible.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.design.assurance import Assurance
from oed_sysid.design.criteria import SAYS, Criterion, DOptimal
from oed_sysid.design.knowledge import ExpectedInformation, Knowledge
from oed_sysid.design.library import Bench, Reference, Standard, ZigZags, standard_manoeuvres
from oed_sysid.design.objective import Objective, Score
from oed_sysid.design.result import Design
from oed_sysid.design.search import Progress, again, refine_all, starts
from oed_sysid.design.trial import Search, Task, Trial, held_by
from oed_sysid.design.vehicles import Caution, Robust, motion, quantity, units_of
from oed_sysid.design.waveforms import Grid, Levels
from oed_sysid.errors import DesignError, OedSysidError, respelled
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.archive import encode
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import NEGLIGIBLE
from oed_sysid.runtime.journal import Journal, opened
from oed_sysid.runtime.threads import single_threaded

# The caution that nobody asked for must not take minutes.
_USUAL = Caution(n_sets=80, n_checks=400)
# Arguments that are gone: fields of what now holds them.
_RUN = held_by(trial=Trial)
_GONE = _RUN | held_by(search=Search, knowledge=Knowledge)
_GONE |= {"parametrisation": "search=Search(family=...)"}
_GONE_IN_SERIES = {
    name: new if name in _RUN else f"design=partial(design_experiment, {new})"
    for name, new in _GONE.items()
}


@respelled(DesignError, _GONE)
@single_threaded
def design_experiment(
    model: Model | Fit,
    trial: Trial,
    *,
    rng: np.random.Generator,
    criterion: Criterion | Robust = DOptimal(),  # noqa: B008 (frozen)
    search: Search = Search(),  # noqa: B008 (frozen)
    knowledge: Knowledge = Knowledge(),  # noqa: B008 (frozen)
    caution: Caution | str | None = "auto",
    progress: Callable[[Progress], None] | None = None,
    journal: Journal | None = None,
) -> Design:
    """Design the manoeuvre that tells most about the parameters, within limits.

    Rough manoeuvres of many kinds are tried first; the best are refined with
    exact sensitivities and gradients.

    Parameters
    ----------
    model : Model or Fit
        The nominal vehicle. A fit brings its values, noise levels and, as prior
        knowledge, its information: the next experiment completes the last.
    trial : Trial
        What is run: limits, length, sampling, inputs, start and end.
    rng : numpy.random.Generator
        Source of rough manoeuvres and sampled values.
    criterion : Criterion, Discriminate, Detect or Robust
        What is good. For the criteria of missing physics (``Discriminate``, ``Detect``) a fit
        brings its records: what these show already counts.
    search : Search
        Family of commands, and the effort.
    knowledge : Knowledge
        What is known before, and the noise to expect; by default all that the fit or the model
        says. With disturbance forces the search sees white noise (measured to cost 3 to 6 %); the
        choice among what it found, and the accuracy that is stated, see the forces.
    caution : Caution, "auto" or None
        How surely limits are to be kept although the parameters are uncertain. By default they
        hold on 95 % of the vehicles that a fit or priors leave possible, coefficients of which
        nothing is known up to 30 % off (or ``knowledge.spread``); where no such manoeuvre is
        found, one that keeps them on the nominal vehicle is returned and its report begins with
        the danger.
        With None limits are kept at the nominal values (and those of ``Robust``).
    progress : callable, optional
        Called with a :class:`~oed_sysid.design.search.Progress`.
    journal : Journal, optional
        Keeps every finished step; a later call with the same content goes on from them.

    Returns
    -------
    Design

    Raises
    ------
    DesignError
        If no manoeuvre keeps the limits; it says which and how far off.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> problem = load_problem("remus_diving_plane")
    >>> trial = Trial.like(problem.experiment("zigzag_5_5"), problem.limits, duration=20.0)
    >>> quick = Search(n_starts=1, n_candidates=5, n_steps=2)
    >>> found = design_experiment(
    ...     problem.model, trial, rng=np.random.default_rng(0), search=quick, caution=None
    ... )
    >>> found.experiment.duration
    20.0
    """
    settings = {
        "model": model, "trial": trial, "rng": rng.bit_generator.state, "criterion": criterion,
        "search": replace(search, n_workers=None), "knowledge": knowledge, "caution": caution,
    }  # fmt: skip
    keep = opened(journal, "design", lambda: encode(dict(settings)))
    automatic = caution == "auto"
    if isinstance(caution, str):
        if not automatic:
            raise DesignError(f"caution is {caution!r}. Give a Caution, 'auto' or None.")
        # Where there is no limit on the motion there is nothing to keep.
        caution = replace(_USUAL, spread=knowledge.spread) if trial.limits.signals else None
    robust = criterion if isinstance(criterion, Robust) else None
    judged: Any = criterion if robust is None else robust.criterion
    expected = ExpectedInformation.of(model, judged, knowledge)
    task = Task.of(expected, trial, rng, robust=robust, caution=caution)
    found = find_design(
        task, search, rng=rng, progress=progress, keep=keep, may_be_unsafe=automatic
    )
    return found if robust is None else replace(found, criterion=robust.name)


def find_design(
    task: Task,
    search: Search,
    *,
    rng: np.random.Generator,
    progress: Callable[[Progress], None] | None = None,
    keep: Journal | None = None,
    may_be_unsafe: bool = False,
) -> Design:
    """Solve a design task; see :func:`design_experiment`.

    Parameters
    ----------
    task : Task
    search : Search
    rng, progress, keep
        See :func:`design_experiment`.
    may_be_unsafe : bool
        Whether a run that does not keep the limits on all vehicles wanted is better than none.
    """
    began = time.perf_counter()
    if references := standard_manoeuvres(_bench(task)):
        task = replace(task, expected=task.expected.seen_white(references[0][1]))
    finder = _Finder(search, references, rng, progress, keep or Journal())
    # What nothing keeps as surely as that: the first line of the result says so.
    may_fail = (DesignError,) if may_be_unsafe else ()
    try:
        found, assurance = finder.tried(task)
    except DesignError:
        if not may_be_unsafe or task.caution is None:
            raise
        task = replace(task, scenarios=(), waves=())
        found, assurance = finder.tried(task)
    # With more and stricter vehicles, until fresh ones confirm the probability asked for.
    with suppress(*may_fail):
        for _ in range(3 if task.scenarios else 0):
            if assurance is None or assurance.is_enough:
                break
            task = task.stricter(assurance, rng)
            found, assurance = finder.tried(task, found.best)
    return finder.designed(task, found, assurance, began)


def _bench(task: Task) -> Bench:
    """The inputs of a task, and standard runs that are made of them, on the nominal vehicle."""
    trial, grid = task.trial, task.grid
    return Bench(task.model, grid, trial.constants, trial.initial, trial.limits, task.bounds)


def _worth(task: Task, score: Score) -> float:
    """Criterion under the noise that is expected; a search sees white noise."""
    if task.expected.sea is None:
        return score.value
    return task.expected.worth(task.experiment(score.commands))


@dataclass(frozen=True, eq=False)
class _Found:
    """Best member of a family, as an experiment, and what it took."""

    best: Score
    experiment: Experiment
    values: tuple[float, ...]
    n_evaluations: int


@dataclass(frozen=True, eq=False)
class _Finder:
    """What stays the same however often a task is searched."""

    search: Search
    references: Sequence[Standard]
    rng: np.random.Generator
    progress: Callable[[Progress], None] | None
    keep: Journal

    def tried(self, task: Task, begin: Score | None = None) -> tuple[_Found, Assurance | None]:
        """What is found, from rough manoeuvres or a given one, and how surely it keeps limits."""
        found = self._searched(task, begin)
        assured = partial(task.assured, found.experiment, self.rng)
        return found, self.keep.once("other vehicles", assured, rng=self.rng)

    def _searched(self, task: Task, begin: Score | None) -> _Found:
        """Search the family, from rough manoeuvres or from a given member."""
        search, family = self.search, self.search.family
        shape = None if isinstance(family, ZigZags) else family.on(task.grid)
        # Of what is closed over the vehicle, commands are given and no family is searched.
        objective = Objective(task, shape or Levels(2).on(task.grid), search.workers)
        _check_start(task)
        if isinstance(family, ZigZags):
            return _closed(task, family, objective)
        if begin is not None:
            first = again(objective, [begin])
        else:
            given = [task.designed(run) for _, run, _ in self.references]
            first, objective.n_evaluations = self.keep.once(
                "rough manoeuvres",
                lambda: (starts(objective, search, self.rng, given), objective.n_evaluations),
                rng=self.rng,
            )
        if not first:
            raise DesignError(SAYS["all_diverge"].format(search=search, task=task))
        reached, nearest, values = refine_all(
            objective, first, n_steps=search.n_steps, progress=self.progress, keep=self.keep
        )
        if not reached:
            raise DesignError(_infeasible(task, nearest))
        best = max(reached, key=partial(_worth, task))
        return _Found(best, task.experiment(best.commands), values, objective.n_evaluations)

    def designed(
        self, task: Task, found: _Found, assurance: Assurance | None, began: float
    ) -> Design:
        """What is found as a result: what it tells beside standard manoeuvres, what it reaches."""
        expected, grid, best = task.expected, task.grid, found.best
        played = task.experiment(best.commands)
        compared = []
        for title, run, note in self.references:
            with suppress(OedSysidError):
                compared.append(Reference(title, run, expected.bound(run), note))
        total = expected.before if expected.shifts is None else expected.total(played)
        return Design(
            assurance=assurance,
            sea=expected.sea,
            experiment=found.experiment,
            model=task.model,
            trajectory=simulate_inputs(
                task.model, grid.times, inputs=best.commands, initial=task.trial.initial
            ),
            information=expected.bound(played),
            prior=expected.prior,
            references=tuple(compared),
            criterion=expected.criterion.name,
            parametrisation=self.search.family.name,
            value=_worth(task, best),
            start_values=found.values,
            active=(
                *_actuator_limits(grid, best.commands[:, task.positions], units_of(task.model)),
                *task.bounds.reached(grid.times, task.bounds.limited(best.evaluations[0].signals)),
            ),
            misfits=expected.misfits(total),
            chances=expected.detections(total),
            n_evaluations=found.n_evaluations,
            seconds=time.perf_counter() - began,
        )


def _closed(task: Task, family: ZigZags, objective: Objective) -> _Found:
    """The zigzag of the library that tells most, closed over each vehicle."""
    n = len(task.scenarios)
    if len(task.grid.inputs) != 1:
        raise DesignError(SAYS["zigzag_of_one"].format(inputs=", ".join(task.grid.inputs)))
    kept = 1.0 - task.n_waived / n if n else 1.0
    bench = replace(_bench(task), vehicles=task.scenarios, kept=kept, feedback=family.feedback)
    scored = []
    for run, _ in (*bench.zigzags(), *bench.zigzags_ahead()):
        if (made := motion(task.model, run)) is not None:
            score = objective.score(np.zeros(0), commands=made.inputs, with_scenarios=False)
            scored += [(score, run)] if score.feasible else []
    if not scored:
        raise DesignError(SAYS["no_zigzag"].format(attitude=bench.attitude or "an attitude"))
    best, loop = max(scored, key=lambda one: one[0].value)
    values = tuple(score.value for score, _ in scored)
    return _Found(best, replace(loop, name=task.trial.name), values, objective.n_evaluations)


def _check_start(task: Task) -> None:
    """Raise if limits are broken before anything is commanded."""
    limits = task.trial.limits.signals
    run = simulate_inputs(
        task.model, task.grid.times, inputs=task.still(), initial=task.trial.initial, throw=False
    )
    first = {name: run.signal(name)[:1] for name in limits}
    if at_start := Limits(signals=dict(limits)).violations(run.times[:1], first):
        raise DesignError(SAYS["start_breaks"].format(broken="; ".join(at_start)))


def _infeasible(task: Task, nearest: Score) -> str:
    """Say which limits the nearest manoeuvre breaks, and what to do."""
    words = task.bounds.broken(task.grid.times, task.bounds.limited(nearest.evaluations[0].signals))
    if not words and task.caution is not None:
        return str(SAYS["none_safe"].format(task.caution))
    broken = "; ".join(words) or "for other values of the parameters the limits are left"
    return str(SAYS["none_feasible"].format(seconds=task.grid.times[-1], broken=broken))


def _actuator_limits(grid: Grid, commands: np.ndarray, units: Mapping[str, str]) -> tuple[str, ...]:
    """Actuator limits that the commands reach, in words."""
    words = []
    for i, name in enumerate(grid.inputs):
        command, unit, (low, high) = commands[:, i], units[name], (grid.lower[i], grid.upper[i])
        room, slopes = NEGLIGIBLE * (high - low), np.abs(np.diff(command)) / grid.step
        for limit, reached in (
            (f"lower limit {quantity(low, unit)}", np.abs(command - low) < room),
            (f"upper limit {quantity(high, unit)}", np.abs(command - high) < room),
            # An infinite rate is never reached.
            (f"rate limit {quantity(grid.rates[i], unit)}/s",
             slopes > (1 - NEGLIGIBLE) * grid.rates[i]),
        ):  # fmt: skip
            if reached.any():
                words.append(f"{name} {limit} for {reached.mean():.0%} of the time")
    return tuple(words)


# -- one after another -----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Stage:
    """One run of a campaign.

    Attributes
    ----------
    design : Design
        What was proposed, on what was known then.
    record : Record
        What was measured.
    fit : Fit
        All records up to here together.

    Examples
    --------
    One of those that :func:`campaign` returns.
    """

    design: Design
    record: Record
    fit: Fit


@respelled(DesignError, _GONE_IN_SERIES)
def campaign(
    model: Model | Fit,
    trial: Trial,
    measure: Callable[[Experiment], Record],
    n_runs: int,
    *,
    design: Callable[[Model | Fit, Trial], Design],
) -> tuple[Stage, ...]:
    """Design a run, measure it, estimate from all records, and design the next one.

    Each design uses the values and the information of the latest fit, so that
    wrong beliefs at the beginning cost one run and not all of them.

    Parameters
    ----------
    model : Model or Fit
        The nominal vehicle at first; the records of a fit are estimated from as well.
    trial : Trial
        Each run; its name is numbered.
    measure : callable
        Takes the designed experiment and returns the record: at sea the crew
        and a file, in a study :func:`oed_sysid.experiments.simulation.simulate`.
    n_runs : int
        How many.
    design : callable
        How one is designed: ``partial(design_experiment, rng=rng, criterion=...)``.

    Returns
    -------
    tuple of Stage
        One for each run.

    Raises
    ------
    DesignError
        If a run does not determine the parameters, so that nothing can be
        designed on its result.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading")
    >>> trial = Trial(ship.limits, 60.0, 1.0)
    >>> campaign(ship.model, trial, measure=None, n_runs=0, design=design_experiment)
    ()
    """
    # The noise levels of the model are trusted.
    estimator = MultipleShooting(disturbances="none", noise="given")
    nominal: Model | Fit = model
    start = model.model if isinstance(model, Fit) else model
    records = tuple(model.dataset) if isinstance(model, Fit) else ()
    stages: list[Stage] = []
    for index in range(n_runs):
        name = f"{trial.name}_{index + 1}"
        found = design(nominal, replace(trial, name=name))
        record = replace(measure(found.experiment), name=name)
        records = (*records, record)
        fit = estimator.fit(start, Dataset(records))
        if not fit.status.ok:
            raise DesignError(SAYS["run_not_converged"].format(name=name, fit=fit))
        stages.append(Stage(found, record, fit))
        nominal, start = fit, fit.model
    return tuple(stages)
