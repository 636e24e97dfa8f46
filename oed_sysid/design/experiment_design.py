r"""The verb of this package: design an experiment within limits.

.. math::
    \max_{u \in \mathcal U}\ \varphi\left(F_0 + F(u; \hat\theta)\right) \quad\text{subject to}
    \quad h\left(x(t; u, \theta_s)\right) \le 0 \ \text{ for all but } k \text{ of the } \theta_s

with the information :math:`F` of the run (start states eliminated) and :math:`F_0` in hand, the
criterion :math:`\varphi` (:mod:`oed_sysid.design.criteria`), commands :math:`u` of a family within
range and rate (:mod:`oed_sysid.design.waveforms`), and limits :math:`h`
(:mod:`oed_sysid.design.limits`) on vehicles that are possible (:mod:`oed_sysid.design.vehicles`).
Rough manoeuvres are refined by sequential linear programs (:mod:`oed_sysid.design.search`).

Design, measure, estimate, design again.

With all records up to run ``k`` the estimate and what is known of it are

.. math::
    \hat\theta_k = \arg\max_\theta \sum_{j \le k} \log L_j(\theta), \qquad
    F_k = \sum_{j \le k} F_j(\hat\theta_k)

and the next command is the best on them,

.. math:: u_{k+1} = \arg\max_u \varphi\left(F_k + F(u; \hat\theta_k)\right)

within limits that hold on the vehicles which :math:`F_k` leaves possible
(:mod:`oed_sysid.design.vehicles`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.design.criteria import Criterion, DOptimal
from oed_sysid.design.library import Reference, zigzags
from oed_sysid.design.limits import quantity, units_of
from oed_sysid.design.missing_effects import ByShifts
from oed_sysid.design.objective import Objective, Score
from oed_sysid.design.result import Design
from oed_sysid.design.search import Found, Progress, ZigZags, again, search, search_zigzags, starts
from oed_sysid.design.trial import Plan, opened, plan_of
from oed_sysid.design.vehicles import Caution, Robust
from oed_sysid.design.waveforms import Grid, Levels, Parametrisation
from oed_sysid.errors import DesignError, OedSysidError
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.information.noise import Colour
from oed_sysid.information.noise import Levels as NoiseLevels
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model
from oed_sysid.runtime.journal import Journal
from oed_sysid.runtime.threads import single_threaded

# Rounds with more and stricter vehicles, until fresh ones confirm the probability asked for.
_N_STRICTER = 3
# Vehicles of the caution that nobody asked for: it must not take minutes.
_USUAL_SETS, _USUAL_CHECKS = 80, 400


@single_threaded
def design_experiment(
    model: Model | Fit,
    *,
    limits: Limits,
    duration: float,
    sample_time: float,
    rng: np.random.Generator,
    criterion: Criterion | ByShifts | Robust = DOptimal(),  # noqa: B008 (frozen)
    parametrisation: Parametrisation | ZigZags = Levels(),  # noqa: B008 (frozen)
    inputs: Sequence[str] | None = None,
    constants: Mapping[str, float] | None = None,
    neutral: Mapping[str, float] | None = None,
    initial: Mapping[str, float] | None = None,
    end: Mapping[str, tuple[float, float]] | None = None,
    prior: str | Information | None = "auto",
    start: str | Mapping[str, float] = "unknown",
    noise: NoiseLevels | NoiseModel | Fit = None,
    coloured: Colour = None,
    caution: Caution | str | None = "auto",
    n_starts: int = 3,
    n_candidates: int = 80,
    n_steps: int = 40,
    n_workers: int | None = None,
    name: str = "designed",
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
    limits : Limits
        Range of each designed input, its rate, and corridors of states or outputs.
    duration, sample_time : float
        Length and sampling of the run, s.
    rng : numpy.random.Generator
        Source of rough manoeuvres and sampled values.
    criterion : Criterion, Discriminate, Reveal or Robust
        What is good. For the criteria of missing physics (``Discriminate``, ``Reveal``) a fit
        brings its records: what these show already counts.
    parametrisation : Parametrisation or ZigZags
        Family of commands.
    inputs : sequence of str, optional
        Inputs to design; by default all that have limits and no constant.
    constants : mapping of str to float, optional
        Values of the other inputs.
    neutral : mapping of str to float, optional
        Command before the run; by default zero, or the middle of a range without zero.
    initial : mapping of str to float, optional
        Start state.
    end : mapping of str to (lower, upper), optional
        Where states or outputs have to be at the end, for a return to the start.
    prior : {"auto", None} or Information
        What is known before: of a fit its information, of a model the
        parameters' ``prior_std``; None ignores both.
    start : {"unknown", "known"} or mapping of str to float
        See :func:`~oed_sysid.information.information_of`.
    noise, coloured
        See :func:`~oed_sysid.information.information_of`; a fit's noise, random
        forces included, by default. With random forces the search sees white noise
        (measured to cost 3 to 6 %); the choice among what it found, and the
        accuracy that is stated, see the forces.
    caution : Caution, "auto" or None
        How surely limits are to be kept although the parameters are uncertain. By default they
        hold on 95 % of the vehicles that a fit leaves possible, where its covariance is known;
        where no such manoeuvre is found, one that keeps them on the nominal vehicle is returned
        and its report begins with the danger. For a model alone, or None, limits are kept at the
        nominal values (and those of ``Robust``).
    n_starts, n_candidates, n_steps : int
        Starts that are refined, rough manoeuvres tried, steps of refinement.
    n_workers : int, optional
        Threads; by default one per core, at most four.
    name : str
        Name of the experiment.
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
    """
    began = time.perf_counter()
    keep = opened(
        journal,
        {
            "model": model, "limits": limits, "duration": duration, "sample_time": sample_time,
            "rng": rng.bit_generator.state, "criterion": criterion,
            "parametrisation": parametrisation, "inputs": inputs, "constants": constants,
            "neutral": neutral, "initial": initial, "end": end, "prior": prior, "start": start,
            "noise": noise, "coloured": coloured, "caution": caution, "n_starts": n_starts,
            "n_candidates": n_candidates, "n_steps": n_steps, "name": name,
        },
    )  # fmt: skip
    automatic = caution == "auto"
    if isinstance(caution, str):
        caution = _usual_caution(model, limits, prior) if automatic else _unknown(caution)
    plan = plan_of(
        model, limits=limits, duration=duration, sample_time=sample_time, rng=rng,
        criterion=criterion, inputs=inputs, constants=constants, neutral=neutral,
        initial=initial, end=end, prior=prior, start=start, noise=noise, coloured=coloured,
        caution=caution,
    )  # fmt: skip
    workers = n_workers or min(4, os.cpu_count() or 1)
    references = zigzags(
        plan.model, plan.grid, plan.corridor, constants=plan.constants, initial=plan.initial
    )
    if references:
        plan = plan.told_under_forces(references[0][1])
    task = partial(
        _searched, parametrisation=parametrisation, references=references, rng=rng,
        n_candidates=n_candidates, n_starts=n_starts, n_steps=n_steps, workers=workers, name=name,
        progress=progress, keep=keep,
    )  # fmt: skip
    try:
        objective, found, best, experiment = task(plan)
    except DesignError:
        if not automatic or caution is None:
            raise
        # Nothing keeps the limits as surely as that: what follows says so in its first line.
        plan = replace(plan, guards=(), waves=())
        objective, found, best, experiment = task(plan)
    assurance = keep.once("other vehicles", partial(plan.assured, experiment, rng), rng=rng)
    for _ in range(_N_STRICTER):
        if assurance is None or caution is None or assurance.probability >= caution.probability:
            break
        if not plan.guards:
            break
        plan = plan.stricter(assurance, rng)
        try:
            objective, found, best, experiment = task(plan, begin=best)
        except DesignError:
            if not automatic:
                raise
            break
        assurance = keep.once("other vehicles", partial(plan.assured, experiment, rng), rng=rng)
    trajectory = simulate_inputs(
        plan.model, plan.grid.times, inputs=best.commands, initial=plan.initial
    )
    signals = best.views[0].signals
    active = (
        *_actuator_limits(plan.grid, best.commands[:, plan.positions], units_of(plan.model)),
        *plan.corridor.reached(plan.grid.times, signals),
    )
    bound = plan.bound
    compared = []
    for title, standard, note in references:
        try:
            compared.append(Reference(title, standard, bound(standard), note))
        except OedSysidError:
            continue
    return Design(
        assurance=assurance,
        sea=plan.sea,
        experiment=experiment,
        model=plan.model,
        trajectory=trajectory,
        information=bound(plan.experiment(name, best.commands)),
        prior=plan.prior,
        references=tuple(compared),
        criterion=criterion.name,
        parametrisation=parametrisation.name,
        value=plan.worth(name, best),
        start_values=found.values,
        active=active,
        misfits=plan.misfits(plan.experiment(name, best.commands)),
        chances=plan.chances(plan.experiment(name, best.commands)),
        n_evaluations=objective.n_evaluations,
        seconds=time.perf_counter() - began,
    )


def _usual_caution(
    given: Model | Fit, limits: Limits, prior: str | Information | None
) -> Caution | None:
    """Caution after a fit that tells how uncertain its parameters are; None for a model alone."""
    if not isinstance(given, Fit) or not limits.signals or prior is None:
        return None
    known = given.information if isinstance(prior, str) else prior
    if not np.all(np.isfinite(known.covariance)):
        return None
    return Caution(n_sets=_USUAL_SETS, n_checks=_USUAL_CHECKS)


def _unknown(caution: str) -> Caution:
    raise DesignError(f"caution is {caution!r}. Give a Caution, 'auto' or None.")


def design_series(model: Model | Fit, n_experiments: int, **settings: object) -> tuple[Design, ...]:
    """Design several experiments, each to complete the information of those before.

    Parameters
    ----------
    model : Model or Fit
        The nominal vehicle.
    n_experiments : int
        How many.
    **settings
        As for :func:`design_experiment`.

    Returns
    -------
    tuple of Design
        The information of each includes that of its predecessors.
    """
    found: list[Design] = []
    for index in range(n_experiments):
        chosen = dict(settings)
        if found:
            chosen["prior"] = found[-1].information
        chosen["name"] = f"{settings.get('name', 'designed')}_{index + 1}"
        found.append(design_experiment(model, **chosen))  # type: ignore[arg-type]
    return tuple(found)


def _searched(
    plan: Plan,
    *,
    parametrisation: Parametrisation | ZigZags,
    references: Sequence[tuple[str, Experiment, str]],
    rng: np.random.Generator,
    n_candidates: int,
    n_starts: int,
    n_steps: int,
    workers: int,
    name: str,
    progress: Callable[[Progress], None] | None,
    keep: Journal,
    begin: Score | None = None,
) -> tuple[Objective, Found, Score, Experiment]:
    """Search the family, from rough manoeuvres or from a given member."""
    if isinstance(parametrisation, ZigZags):
        objective = plan.objective(None, workers)
        _check_neutral(plan)
        tried = partial(
            search_zigzags, parametrisation, objective, plan.grid, plan.model,
            sign=_sign(references), constants=plan.constants, initial=plan.initial, rng=rng,
            guards=objective.guards,
        )  # fmt: skip
        (zigzag, nearest, loop), objective.n_evaluations = keep.once(
            "zigzags", lambda: (tried(), objective.n_evaluations), rng=rng
        )
        if nearest is None:
            raise DesignError(f"No zigzag on {parametrisation.feedback!r} stays finite.")
        found = Found(zigzag, nearest, (float("-inf") if zigzag is None else zigzag.value,))
        if zigzag is None or loop is None:
            raise DesignError(_infeasible(plan, found))
        return objective, found, zigzag, replace(loop, name=name, limits=plan.limits)
    objective = plan.objective(parametrisation.on(plan.grid), workers)
    _check_neutral(plan)
    if begin is not None:
        first = again(objective, plan.grid, begin)
    else:
        given = [plan.designed(exp) for _, exp, _ in references]
        rough = partial(
            starts, objective, plan.grid, rng, n_candidates=n_candidates, n_starts=n_starts,
            given=given,
        )  # fmt: skip
        first, objective.n_evaluations = keep.once(
            "rough manoeuvres", lambda: (rough(), objective.n_evaluations), rng=rng
        )
    if not first:
        raise DesignError(
            f"All {n_candidates} rough manoeuvres make model {plan.model.name!r} diverge: it "
            "is unstable on its own. Design a shorter run, or in Python a closed loop, "
            "parametrisation=ZigZags(...)."
        )
    found = search(objective, first, n_steps=n_steps, progress=progress, journal=keep)
    if found.best is None:
        raise DesignError(_infeasible(plan, found))
    best = found.best
    if plan.sea is not None and len(found.others) > 1:
        best = max(found.others, key=lambda score: plan.worth(name, score))
    return objective, found, best, plan.experiment(name, best.commands)


def _check_neutral(plan: Plan) -> None:
    """Raise if limits are broken even when nothing is commanded."""
    run = simulate_inputs(
        plan.model, plan.grid.times, inputs=plan.still(), initial=plan.initial, throw=False
    )
    first = {name: run.signal(name)[:1] for name in plan.limits.signals}
    at_start = Limits(signals=dict(plan.limits.signals)).violations(run.times[:1], first)
    if at_start:
        raise DesignError(
            f"The start already breaks the limits: {'; '.join(at_start)}. Change the start "
            "(initial, on the command line --like with another experiment) or the limits."
        )


def _infeasible(plan: Plan, found: Found) -> str:
    """Say which limits the nearest manoeuvre breaks, and what to do."""
    signals = found.nearest.views[0].signals
    words = plan.corridor.broken(plan.grid.times, signals)
    if not words and plan.caution is not None:
        raise DesignError(
            f"No manoeuvre was found that keeps all limits on {plan.caution.probability:.0%} of "
            "the vehicles with other coefficients. Design a shorter run, do a gentle trial first "
            "and design from its fit, or in Python a closed loop, parametrisation=ZigZags(...)."
        )
    if not words:
        words = ("for other values of the parameters the corridor is left",)
    return (
        f"No manoeuvre of {plan.grid.times[-1]:g} s was found that keeps all limits. In the "
        f"nearest one {'; '.join(words)}. Widen these limits, shorten the run, allow more "
        "actuator range, or ask for more starts."
    )


def _actuator_limits(grid: Grid, commands: np.ndarray, units: Mapping[str, str]) -> tuple[str, ...]:
    """Actuator limits that the commands reach, in words."""
    words = []
    for i, name in enumerate(grid.inputs):
        width = grid.upper[i] - grid.lower[i]
        for bound, side in ((grid.lower[i], "lower"), (grid.upper[i], "upper")):
            share = float(np.mean(np.abs(commands[:, i] - bound) < 0.01 * width))
            if share > 0:
                reached = quantity(bound, units[name])
                words.append(f"{name} {side} limit {reached} for {share:.0%} of the time")
        if np.isfinite(grid.rates[i]):
            slopes = np.abs(np.diff(commands[:, i])) / grid.step
            share = float(np.mean(slopes > 0.99 * grid.rates[i]))
            if share > 0:
                reached = quantity(grid.rates[i], units[name])
                words.append(f"{name} rate limit {reached}/s for {share:.0%} of the time")
    return tuple(words)


def _sign(references: Sequence[tuple[str, Experiment, str]]) -> int:
    for _, experiment, _ in references:
        sign = getattr(experiment.excitation, "sign", None)
        if sign is not None:
            return int(sign)
    return 1


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
    """

    design: Design
    record: Record
    fit: Fit


def campaign(
    model: Model | Fit,
    measure: Callable[[Experiment], Record],
    n_runs: int,
    *,
    data: Dataset | None = None,
    estimator: MultipleShooting | None = None,
    **settings: Any,
) -> tuple[Stage, ...]:
    """Design a run, measure it, estimate from all records, and design the next one.

    Each design uses the values and the information of the latest fit, so that
    wrong beliefs at the beginning cost one run and not all of them.

    Parameters
    ----------
    model : Model or Fit
        The nominal vehicle at first.
    measure : callable
        Takes the designed experiment and returns the record: at sea the crew
        and a file, in a study :func:`oed_sysid.experiments.simulation.simulate`.
    n_runs : int
        How many.
    data : Dataset, optional
        Records in hand; they are estimated from as well.
    estimator : MultipleShooting, optional
        By default one that trusts the noise levels of the model.
    **settings
        As for :func:`~oed_sysid.design.design_experiment`.

    Returns
    -------
    tuple of Stage
        One for each run.

    Raises
    ------
    DesignError
        If a run does not determine the parameters, so that nothing can be
        designed on its result.
    """
    chosen = estimator or MultipleShooting(disturbances="none", noise="given")
    nominal: Model | Fit = model
    start = model.model if isinstance(model, Fit) else model
    records = tuple(data) if data is not None else ()
    stages: list[Stage] = []
    for index in range(n_runs):
        name = f"{settings.get('name', 'run')}_{index + 1}"
        design = design_experiment(nominal, **{**settings, "name": name})
        record = replace(measure(design.experiment), name=name)
        records = (*records, record)
        fit = chosen.fit(start, Dataset(records))
        if not fit.status.ok:
            raise DesignError(
                f"After run {name!r} the estimation did not converge ({fit.status}). Fix "
                "parameters that the runs do not show, or begin with a run of another kind."
            )
        stages.append(Stage(design, record, fit))
        nominal, start = fit, fit.model
    return tuple(stages)
