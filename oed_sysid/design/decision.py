r"""Stop or go on: what is known well enough after a run, and what the next one would bring.

What a model is for is a *goal*: standard deviations of some linear functions of the parameters,

.. math:: s_g = \max_t \sqrt{c_t' F^{-1} c_t} \le \text{tolerance}

with ``c`` a unit vector for a parameter, and the derivative of an output along a manoeuvre for a
prediction. With information :math:`F` in hand and :math:`F_i` of candidate run ``i`` (cost
:math:`c_i`)

.. math:: i^* = \arg\max_i \frac1{c_i} \sum_{g\ \text{not met}}
    \log \frac{s_g(F)}{\max(s_g(F + F_i), \text{tolerance})}

is the next run; repeating this on paper until all goals are met tells the hours that are left.
All of it is linear algebra on one set of derivatives, so that the answer is there before the
vehicle has turned.

Errors are those of a model that is right, and a model that lacks a term does not look wrong in one
run: coefficients stand for it, disturbance forces take the rest. So two more things are asked
before
everything is called known. Another run must have had the chance to contradict the first; where none
has, the one that tells most is the next. And what was known before and every record must agree
(:mod:`oed_sysid.likelihood.between_records`), apart from differences of a tenth of the goals. Where
they do not, no stated error holds, and no number of further runs mends it.

A campaign on disk: candidates, goals and records of a trial that may be broken off at any time.

Every step ends by writing ``journal.json`` as a whole; what was being done when the power failed is
simply done again. Records are copied into the folder, so that it can be carried home.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from oed_sysid.data.dataset import Dataset, read_csv
from oed_sysid.design.assurance import NO_LIMIT, Assurance, assess_limits
from oed_sysid.design.card import TrialCard
from oed_sysid.design.criteria import SAYS, DOptimal, inverse
from oed_sysid.design.knowledge import ExpectedInformation, Knowledge
from oed_sysid.design.library import Candidate
from oed_sysid.design.result import write_run
from oed_sysid.design.vehicles import (
    CHECKED,
    LimitBounds,
    draw_models,
    kept_on,
    percent,
    quantity,
    units_of,
)
from oed_sysid.errors import DataError, DesignError, FileError, located
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.problem import load_problem
from oed_sysid.information.noise import Levels
from oed_sysid.information.response import commanded_runs, respond
from oed_sysid.likelihood.archive import dataclasses_of, decode, encode, read_json
from oed_sysid.likelihood.between_records import CHANCE
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_model import NoiseModel, Sea
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import IMMATERIAL, NEGLIGIBLE
from oed_sysid.runtime.display import (
    TWO_SIDED_95,
    Report,
    Section,
    Table,
    as_dict,
    as_text,
    counted,
)
from oed_sysid.runtime.files import read_bytes, write_bytes, write_text


@runtime_checkable
class Goal(Protocol):
    """Contract of goals: linear functions of the parameters, and how well they have to be known.

    Examples
    --------
    :class:`ParameterGoal` and :class:`PredictionGoal` are such goals.
    """

    @property
    def name(self) -> str:
        """Name for reports."""

    @property
    def tolerance(self) -> float:
        """Largest standard deviation that is good enough."""

    def rows(self, model: Model, names: Sequence[str]) -> np.ndarray:
        """Derivatives of the functions by the parameters, ``(n_functions, n_names)``."""

    def words(self, model: Model, deviation: float) -> str:
        """Return a standard deviation as people say it."""


@dataclass(frozen=True)
class ParameterGoal:
    """A parameter is to be known to a share of its value.

    Parameters
    ----------
    parameter : str
    tolerance : float
        Standard error over value.

    Examples
    --------
    >>> ParameterGoal("M_uw", 0.05).tolerance
    0.05
    """

    parameter: str
    tolerance: float

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 10:
            raise DesignError(
                f"The goal of {self.parameter!r} is {self.tolerance}. Give a share such as 0.05."
            )

    @property
    def name(self) -> str:
        """Name for reports."""
        return self.parameter

    def rows(self, model: Model, names: Sequence[str]) -> np.ndarray:
        """Unit vector over the value."""
        (column,) = located(DesignError, _no_goal(model), [self.parameter], names)
        row = np.zeros((1, len(names)))
        row[0, column] = 1.0 / model.parameter(self.parameter).reference
        return row

    def words(self, model: Model, deviation: float) -> str:
        """Return a share in per cent."""
        return percent(deviation)


def _no_goal(model: Model) -> str:
    return f"A goal is about a free parameter; model {model.name!r} has no"


@dataclass(frozen=True)
class PredictionGoal:
    """An output of a manoeuvre is to be predicted with a standard deviation, start known.

    Parameters
    ----------
    experiment : Experiment
        What is to be predicted; its commands are those of the nominal vehicle.
    output : str
    tolerance : float
        In the output's unit, at the worst time.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> run = next(iter(load_problem("nomoto_sparse_heading").experiments.values()))
    >>> PredictionGoal(run, "psi", np.radians(2.0)).output
    'psi'
    """

    experiment: Experiment
    output: str
    tolerance: float

    @property
    def name(self) -> str:
        """Name for reports."""
        return f"{self.output} of {self.experiment.name}"

    def rows(self, model: Model, names: Sequence[str]) -> np.ndarray:
        """Derivatives of the output at every sample."""
        lacking = f"Model {model.name!r} has no output"
        (column,) = located(DesignError, lacking, [self.output], model.output_names)
        response = respond(model, commanded_runs(model, self.experiment)[0])
        wanted = [len(model.states) + model.free_names.index(name) for name in names]
        return np.asarray(response.jacobian[:, column, wanted])

    def words(self, model: Model, deviation: float) -> str:
        """Return a deviation with its unit."""
        return quantity(deviation, units_of(model)[self.output])


@dataclass(frozen=True)
class Progressed:
    """One goal now, and after the next run.

    Attributes
    ----------
    goal : Goal
    now, then : float
        Standard deviations; ``then`` equals ``now`` where nothing is to be run.
    """

    goal: Goal
    now: float
    then: float

    to_dict = as_dict("now", "then", name="goal.name", wanted="goal.tolerance", met="is_met")

    @property
    def is_met(self) -> bool:
        """Whether it is known well enough."""
        return self.now <= self.goal.tolerance


@dataclass(frozen=True)
class Contradiction:
    """Records, or what was known before them, that cannot all be right about the model.

    Attributes
    ----------
    source : str
        The record that differs most, or ``"what was known before"``.
    statistic : float
        Squared distance of what it says from what all others say, or of all from one another,
        whichever is less likely.
    freedom : int
        What it would be about, were all right.
    chance : float
        Of so large a statistic then, all comparisons taken together.
    apart : mapping of str to float
        Parameters in which the source differs from the others clearly, in standard errors.
    """

    source: str
    statistic: float
    freedom: int
    chance: float
    apart: Mapping[str, float]

    @property
    def text(self) -> str:
        """What was expected, what was found, what to do."""
        listed = ", ".join(f"{name} {value:+.1f}" for name, value in self.apart.items())
        where = f" ({listed} standard errors)" if listed else ""
        return str(SAYS["contradiction"].format(self, where=where))


@dataclass(frozen=True, eq=False)
class Decision:
    """What to do next.

    Attributes
    ----------
    model : Model
    action : str
        ``"go on"``, ``"enough"`` (all goals are met and another run has checked the model),
        ``"contradicted"`` (all goals are met on paper, but records contradict one another),
        ``"unchecked"`` (all goals are met on paper, and no run that keeps its limits could check
        the model), ``"useless"`` (no run that keeps its limits helps) or ``"no time"``.
    goals : tuple of Progressed
    next_run : Candidate or None
    runs_left, hours_left : int, float
        Until all goals are met, if runs go as planned; infinite if never.
    hours_available : float or None
    refused : tuple of str
        Runs that were better but leave their limits on too many possible vehicles.
    seconds : float
        Time that the decision took.
    assurance : Assurance or None
        On how many of the vehicles that remain possible the next run keeps its limits, the nominal
        one included.
    contradiction : Contradiction or None
        Why the errors must not be believed; None where nothing says so.

    Examples
    --------
    What :func:`decide` returns; see there.
    """

    model: Model
    action: str
    goals: tuple[Progressed, ...]
    next_run: Candidate | None
    runs_left: int
    hours_left: float
    hours_available: float | None
    refused: tuple[str, ...]
    seconds: float
    assurance: Assurance | None = None
    contradiction: Contradiction | None = None

    @property
    def kept(self) -> float | None:
        """Share of these vehicles; None where no limit on the motion was given."""
        safe = self.assurance
        return safe.probability if safe is not None and safe.limited else None

    @property
    def unmet(self) -> list[Progressed]:
        """Goals that are not known well enough now."""
        return [one for one in self.goals if not one.is_met]

    @property
    def stop(self) -> bool:
        """Whether to go home."""
        return self.action != "go on"

    def answer(self, n_runs: int = 0, hours: float = 0.0) -> str:
        """Return in one line whether to stop, or what to run next, its worth and its safety.

        Parameters
        ----------
        n_runs, hours : int, float
            Done so far.
        """
        done = f" after {counted(n_runs, 'run')}, {hours:.2g} h" if n_runs else ""
        run, unmet = self.next_run, self.unmet
        if run is None:
            n = len(self.goals)
            rest = f" ({n - len(unmet)} of {n} goals met)" if unmet else ""
            return f"STOP{done}: {SAYS['reasons'][self.action]}{rest}."
        brings, left = "checks what one run alone has said", "not all goals can be planned for"
        if unmet:
            # The goal that the run was chosen for, not one that it leaves as it is.
            far = max(unmet, key=lambda one: one.now / max(one.then, one.goal.tolerance))
            now, then = (far.goal.words(self.model, value) for value in (far.now, far.then))
            brings = f"brings {far.goal.name} from {now} to {then}"
        if np.isfinite(self.hours_left):
            left = f"{counted(self.runs_left, 'run')}, {self.hours_left:.2g} h to go"
        warned = "" if self.contradiction is None else SAYS["contradicted_before"]
        safe = self.assurance.report() if self.assurance else NO_LIMIT
        next_ = f"{run.name} next ({run.cost / 3600:.2g} h)"
        return f"{warned}GO ON{done}: {next_} {brings}; {left}; {safe}."

    def document(self) -> Report:
        """Return the decision, the verdict first."""
        rows = []
        for one in self.goals:
            values = (one.goal.tolerance, one.now, one.then)
            words = (one.goal.words(self.model, value) for value in values)
            rows.append((one.goal.name, *words, "met" if one.is_met else ""))
        headers = ("goal", "wanted", "now", "after next", "")
        short = self.hours_available is not None and self.hours_left > self.hours_available
        warnings = [] if self.contradiction is None else [f"WARNING: {self.contradiction.text}"]
        if short and self.next_run is not None:
            warnings.append(SAYS["too_little_time"].format(self))
        refused = [f"Not run: {name!r} may leave its limits." for name in self.refused]
        section = Section("Goals", refused, (Table(headers, rows),), indent=2)
        said = self.answer()
        return Report(said, answer=said, verdict=warnings, sections=(section,))

    report = as_text

    to_dict = as_dict(
        "action", "runs_left", "hours_left", "goals", "refused", "contradiction", "seconds",
        next_run=lambda self: None if self.next_run is None else self.next_run.name,
        limits_kept="assurance",
    )  # fmt: skip


def decide(
    fit: Fit | Model,
    candidates: Sequence[Candidate],
    goals: Sequence[Goal],
    *,
    rng: np.random.Generator,
    limits: Limits | None = None,
    noise: Levels | NoiseModel | Fit = None,
    prior: str | Information | None = "auto",
    hours: float | None = None,
    certainty: float = 0.95,
) -> Decision:
    """Say whether to stop, or what to run next and what it would bring.

    Parameters
    ----------
    fit : Fit or Model
        What is known after the last run; a model before the first.
    candidates : sequence of Candidate
        Runs to choose from, such as those of a :class:`~oed_sysid.design.Programme`.
    goals : sequence of Goal
        What the model is for.
    rng : numpy.random.Generator
        Source of the possible vehicles on which limits are checked.
    limits : Limits, optional
        That the next run has to keep on the vehicles that remain possible; by default its own.
    noise : optional
        Noise to expect; that of the fit by default.
    prior
        See :func:`~oed_sysid.design.design_experiment`.
    hours : float, optional
        Time that is left, h.
    certainty : float
        Share of possible vehicles on which limits have to hold.

    Returns
    -------
    Decision

    Raises
    ------
    DesignError
        Without goals or candidates.

    Examples
    --------
    After a fit, among the runs of a programme::

        goals = goals_of(fit.model, {"all": 0.05})
        print(decide(fit, programme.candidates, goals, rng=np.random.default_rng(0)).report())
    """
    began = time.perf_counter()
    if not goals or not candidates:
        raise DesignError("A decision needs one goal and one candidate run or more. Give both.")
    expected = ExpectedInformation.of(fit, DOptimal(), Knowledge(prior=prior, noise=noise))
    outlook = _Outlook.of(expected, candidates, goals)
    contradiction = _contradiction(fit, goals)
    # Where but one run has told the parameters, nothing could contradict it.
    of_one_run = isinstance(fit, Fit) and len(tuple(fit.dataset)) < 2
    needs_check = outlook.is_met and contradiction is None and of_one_run
    chosen: int | None = None
    safe: Assurance | None = None
    if needs_check or not outlook.is_met:
        outlook, chosen, safe = outlook.safe_run(limits, certainty, rng, check=needs_check)
    next_run, then, steps = None, outlook.now, list[int]()
    if chosen is not None:
        next_run, then = outlook.runs[chosen], outlook.deviations(outlook.told[chosen])
        steps = [chosen] if needs_check else outlook.path()
    contradicted = contradiction is not None
    action = outlook.action(next_run, hours, contradicted=contradicted, check=needs_check)
    return Decision(
        model=expected.model,
        action=action,
        goals=tuple(map(Progressed, goals, outlook.now.tolist(), then.tolist())),
        next_run=next_run if action == "go on" else None,
        runs_left=len(steps),
        hours_left=outlook.hours(steps),
        hours_available=hours,
        refused=tuple(dict.fromkeys(outlook.runs[i].name for i in outlook.refused)),
        seconds=time.perf_counter() - began,
        assurance=safe,
        contradiction=contradiction,
    )


def _contradiction(fit: Fit | Model, goals: Sequence[Goal]) -> Contradiction | None:
    """Records and priors of a fit that cannot all be right, by more than the goals care for."""
    if not isinstance(fit, Fit) or (sources := fit.sources) is None or not fit.status.ok:
        return None
    found = sources.agreement(allowance=_allowance(fit, goals), stated=fit.covariance)
    if found.chance >= CHANCE:
        return None
    least = int(np.argmin(found.chances))
    series = [record.name for record in fit.dataset if not record.independent]
    apart = sources.apart(found.worst)
    sizes = np.abs(apart)
    order = np.argsort(-sizes)[: np.count_nonzero(sizes > TWO_SIDED_95)].tolist()
    return Contradiction(
        source="what was known before" if found.worst == 0 else repr(series[found.worst - 1]),
        statistic=(found.statistic, *found.each)[least],
        freedom=(found.freedom, *found.each_freedom)[least],
        chance=found.chance,
        apart={fit.names[i]: float(apart[i]) for i in order},
    )


def _allowance(fit: Fit, goals: Sequence[Goal]) -> np.ndarray:
    """Differences of the parameters that no goal cares for, ``(n_names,)``."""
    wanted = {goal.name: goal.tolerance for goal in goals if isinstance(goal, ParameterGoal)}
    sizes = np.array([fit.model.parameter(name).reference for name in fit.names])
    return np.asarray(IMMATERIAL * sizes * [wanted.get(name, 0.0) for name in fit.names])


@dataclass(frozen=True, eq=False)
class _Outlook:
    """What is known, what each run would tell (relative units), and what is wanted."""

    expected: ExpectedInformation
    matrix: np.ndarray
    told: tuple[np.ndarray, ...]
    runs: tuple[Candidate, ...]
    rows: tuple[np.ndarray, ...]
    wanted: np.ndarray
    refused: Sequence[int] = ()

    @classmethod
    def of(
        cls, expected: ExpectedInformation, candidates: Sequence[Candidate], goals: Sequence[Goal]
    ) -> _Outlook:
        """Return the outlook, without runs that diverge on what is known now."""
        # Before their time: what the runs would tell does not depend on which is taken.
        told = expected.told()
        each = ((run, told.matrix(run.experiment)) for run in candidates)
        finite = [(run, expected.relative(one)) for run, one in each if one is not None]
        rows = (goal.rows(expected.model, expected.names) * expected.scales() for goal in goals)
        return cls(
            expected, expected.total(None), tuple(one for _, one in finite),
            tuple(run for run, _ in finite), tuple(rows),
            np.array([goal.tolerance for goal in goals]),
        )  # fmt: skip

    @property
    def now(self) -> np.ndarray:
        """Standard deviation of each goal."""
        return self.deviations(0.0)

    @property
    def is_met(self) -> bool:
        """Whether all goals are."""
        return bool(np.all(self.now <= self.wanted))

    def deviations(self, more: np.ndarray | float) -> np.ndarray:
        """Largest standard deviation of each goal with more information, ``(..., n_goals)``."""
        bound = inverse(self.matrix + more)
        # Standard deviation of a linear function of the parameters, at its worst time.
        parts = [np.sqrt(((row @ bound) * row).sum(axis=-1).max(axis=-1)) for row in self.rows]
        return np.stack(parts, axis=-1)

    def ranked(self, more: np.ndarray | float = 0.0, *, check: bool = False) -> list[int]:
        """Runs to do next, the best first: what brings goals nearer, or what could contradict."""
        if not (left := [i for i in range(len(self.runs)) if i not in self.refused]):
            return []
        told = np.stack([self.told[i] for i in left])
        if check:
            # What a run says of all parameters by itself is what it can contradict. Directions of
            # which nothing is known yet count much, but not without end.
            largest = max(float(np.diag(self.matrix).max(initial=0.0)), 1e-300)
            known = self.matrix + 1e-9 * largest * np.eye(len(self.matrix))
            gains = np.linalg.slogdet(known + told)[1] - np.linalg.slogdet(known)[1]
            worth = np.ones(len(left), dtype=bool)
        else:
            now, then = self.deviations(more), self.deviations(more + told)
            nearer = np.maximum(now, self.wanted) / np.maximum(then, self.wanted)
            gains = np.log(nearer).sum(axis=1)
            # What is nearly met needs little: a run that meets it is worth its fuel all the same.
            meets = (then > self.wanted).sum(axis=-1) < (now > self.wanted).sum()
            worth = (gains > NEGLIGIBLE) | meets
        order = np.argsort(-gains / [self.runs[i].cost for i in left], kind="stable")
        return [left[int(i)] for i in order if worth[i]]

    def safe_run(
        self, limits: Limits | None, certainty: float, rng: np.random.Generator, *, check: bool
    ) -> tuple[_Outlook, int | None, Assurance | None]:
        """Take the best run, and refuse those that leave their limits on too many vehicles."""
        model, prior = self.expected.model, self.expected.prior
        # Drawn once: runs are refused or taken on the same vehicles.
        others = draw_models(model, None, CHECKED, prior, rng)
        refused: list[int] = []
        for best in self.ranked(check=check):
            run = self.runs[best].experiment
            bounds = LimitBounds.of(model, limits or run.limits)
            if kept_on(run, (model, *others), bounds, certainty) is not None:
                found = assess_limits(
                    model, run, rng=rng, limits=limits, spread=None, vehicles=others,
                    prior=prior, wanted=certainty, sea=self.expected.sea,
                )  # fmt: skip
                if found.is_enough:
                    return replace(self, refused=refused), best, found
            refused.append(best)
        return replace(self, refused=refused), None, None

    def action(
        self, next_run: Candidate | None, hours: float | None, *, contradicted: bool, check: bool
    ) -> str:
        """What to do; see :class:`Decision`."""
        if self.is_met and not check:
            return "contradicted" if contradicted else "enough"
        if next_run is None:
            return "unchecked" if check else "useless"
        return "no time" if hours is not None and next_run.cost > 3600.0 * hours else "go on"

    def path(self) -> list[int]:
        """Runs, one after the other, until the goals are met, or nothing helps."""
        steps: list[int] = []
        more = np.zeros_like(self.matrix)
        while len(steps) < 40 and np.any(self.deviations(more) > self.wanted):
            if not (ranked := self.ranked(more)):
                break
            # Greedy: information only grows, so that what was taken is never in the way later.
            steps.append(ranked[0])
            more = more + self.told[ranked[0]]
        return steps

    def hours(self, steps: Sequence[int]) -> float:
        """Time of some runs; infinite if the goals are not met after them."""
        after = self.deviations(sum((self.told[i] for i in steps), np.zeros_like(self.matrix)))
        if not np.all(after <= self.wanted):
            return float("inf")
        return float(np.sum([self.runs[i].cost for i in steps])) / 3600.0


def goals_of(model: Model, given: Mapping[str, float]) -> tuple[ParameterGoal, ...]:
    """Return goals of parameters, ``{"M_uw": 0.05}``; ``"all"`` stands for each that is free.

    Returns
    -------
    tuple of ParameterGoal

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading").model
    >>> [goal.parameter for goal in goals_of(ship, {"all": 0.05})]
    ['T', 'K']
    """
    names = model.shared_names
    located(DesignError, _no_goal(model), given, (*names, "all"))
    each = [(n, t) for key, t in given.items() for n in (names if key == "all" else [key])]
    return tuple(ParameterGoal(name, tolerance) for name, tolerance in dict(each).items())


NAME = "journal.json"
_FIT = "fit.json"


@dataclass(frozen=True, eq=False)
class Logbook:
    """State of a campaign.

    Attributes
    ----------
    folder : Path
    model : Model
    problem : str
    variant : str or None
    candidates : tuple of Candidate
    goals : mapping of str to float
        Relative errors by parameter, or ``"all"``.
    hours : float or None
        For the whole trial.
    sea : NoiseModel or None
        Expected until a fit has found its own.
    records : tuple of str
        Files of the folder, in order.
    runs : tuple of str
        Names of the runs that were proposed, one for each record.
    proposed : str or None
        The run that is to be done next.
    seed : int
    fit : Fit or None
        Of all records.

    Raises
    ------
    DesignError
        If a goal is about nothing.
    """

    folder: Path
    model: Model = field(repr=False)
    problem: str
    variant: str | None
    candidates: Sequence[Candidate]
    goals: Mapping[str, float]
    hours: float | None
    sea: NoiseModel | None
    records: Sequence[str] = ()
    runs: Sequence[str] = ()
    proposed: str | None = None
    seed: int = 0
    fit: Fit | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        goals_of(self.model, self.goals)  # said now, not after the first run

    @staticmethod
    def exists(folder: str | Path) -> bool:
        """Whether a folder holds a campaign."""
        return (Path(folder) / NAME).is_file()

    @classmethod
    def open(cls, folder: str | Path) -> Logbook:
        """Read a campaign, and the fit of its records if there is one.

        Raises
        ------
        FileError
            If the journal cannot be read.
        """
        place = Path(folder) / NAME
        try:
            # When it is read: manoeuvres of one's own are known by then.
            kinds = (*dataclasses_of(Candidate), *dataclasses_of(NoiseModel))
            kept = decode(read_json(place), kinds)
            data = {name: kept[name] for name in _KEPT}
        except (DataError, KeyError, TypeError) as error:
            raise FileError(SAYS["no_journal"].format(place=str(place), error=error)) from None
        model = load_problem(data["problem"], variant=data["variant"]).model
        found = cls(Path(folder), model, **data)
        if not found.records:
            return found
        stored = found.folder / _FIT
        fit = Fit.load(stored) if stored.is_file() else None
        if fit is None or len(tuple(fit.dataset)) != len(found.records):
            fit = found.estimator.fit(model, found.dataset())
        return replace(found, fit=fit)

    def dataset(self) -> Dataset:
        """All records."""
        return read_csv([self.folder / name for name in self.records], self.model.channels)

    @property
    def estimator(self) -> MultipleShooting:
        """What estimates from the records; where a swell was expected, it is told that one acts."""
        swell = self.sea is not None and self.sea.seas
        return MultipleShooting(disturbances=Sea() if swell else "auto")

    @property
    def hours_used(self) -> float:
        """Time of the runs done, turnarounds included, h."""
        costs = {run.name: run.cost for run in self.candidates}
        return sum(costs.get(name, 0.0) for name in self.runs) / 3600.0

    def with_record(self, path: str | Path) -> Logbook:
        """Take a log in, estimate from all of them, and write the journal.

        Parameters
        ----------
        path : str or Path
            CSV of the run that was proposed last.

        Raises
        ------
        DataError
            If it cannot be read; nothing is changed then.
        """
        content = read_bytes(path)
        for name in self.records:
            if (self.folder / name).read_bytes() == content:
                raise DesignError(
                    f"{str(path)!r} is in the journal already, as {name}. Give the next log."
                )
        name = f"run_{len(self.records) + 1:02d}.csv"
        read_csv([Path(path)], self.model.channels)  # what cannot be read is not taken in
        write_bytes(self.folder / name, content)
        longer = replace(
            self, records=(*self.records, name), runs=(*self.runs, self.proposed or ""),
            proposed=None,
        )  # fmt: skip
        fit = self.estimator.fit(self.model, longer.dataset())
        fit.save(self.folder / _FIT)
        longer = replace(longer, fit=fit)
        longer.write()
        return longer

    def decide(self) -> Decision:
        """Stop, or what to run next."""
        if self.fit is not None and not self.fit.status.ok:
            raise DesignError(SAYS["not_converged"].format(self, n=len(self.records)))
        fitted = self.fit is not None and not self.fit.noise.is_white
        return decide(
            self.fit or self.model,
            self.candidates,
            goals_of(self.model, self.goals),
            rng=np.random.default_rng(self.seed),
            noise=None if fitted else self.sea,
            hours=None if self.hours is None else self.hours - self.hours_used,
        )

    def write_next(self, decision: Decision) -> Path | None:
        """Write commands and card of the next run as ``next.csv`` and ``next.txt``, and note it."""
        run = decision.next_run
        replace(self, proposed=None if run is None else run.name).write()
        if run is None:
            return None
        card = TrialCard.of(decision.model, run.experiment, decision.assurance, self.sea)
        return write_run(self.folder / "next.csv", card)[0]

    def write(self) -> None:
        """Write the journal, whole or not at all."""
        kept = encode({name: getattr(self, name) for name in _KEPT})
        write_text(self.folder / NAME, json.dumps(kept, allow_nan=False) + "\n")


# What the journal holds of a logbook.
_KEPT = [one.name for one in fields(Logbook) if one.name not in ("folder", "model", "fit")]
