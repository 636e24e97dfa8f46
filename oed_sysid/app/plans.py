"""What planning asks for: what trials tell, and the trial that tells most."""

from __future__ import annotations

import io
import tempfile
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oed_sysid.app.jobs import Tell
from oed_sysid.app.study import Study
from oed_sysid.app.tasks import DRAWING, Outcome, fitted
from oed_sysid.design.choices import (
    CRITERIA,
    EFFORTS,
    FAMILIES,
    UNCERTAINTY,
    named,
    usual_spread,
)
from oed_sysid.experiments.experiment import Limits

if TYPE_CHECKING:
    from oed_sysid.design import Design
    from oed_sysid.design.result import Programme


@dataclass(frozen=True)
class DesignWish:
    """What a designed experiment shall be; as the options of ``oed-sysid design``.

    Parameters
    ----------
    like : str
        Experiment that lends sampling, constant inputs and start state.
    duration : float
        Length, s.
    ranges : tuple of (str, float, float)
        Input, least and largest command, SI.
    rates : tuple of (str, float)
        Input and largest slope, SI per second.
    corridors : tuple of (str, float, float)
        State or output, least and largest value, SI.
    criterion, family, effort : str
        As on the command line.
    rivals : tuple of str
        Candidates to tell apart; then no criterion is needed.
    after_fit : bool
        Whether to complete what the training records told already.
    certainty : float or None
        Probability with which limits are kept although coefficients are
        uncertain; None only states it.
    seed : int
        Of the search.
    """

    like: str
    duration: float
    ranges: tuple[tuple[str, float, float], ...] = ()
    rates: tuple[tuple[str, float], ...] = ()
    corridors: tuple[tuple[str, float, float], ...] = ()
    criterion: str = "D"
    family: str = "levels"
    effort: str = "quick"
    rivals: tuple[str, ...] = ()
    after_fit: bool = False
    certainty: float | None = None
    seed: int = 0


def rank(study: Study, experiments: tuple[str, ...], tell: Tell) -> Outcome:
    """Rank parameters by what experiments, or without any the training records, tell."""
    from oed_sysid.information import rank_parameters

    problem = study.problem
    runs = [problem.experiment(name) for name in experiments] or study.training()
    tell("computing sensitivities")
    ranking = rank_parameters(problem.model, runs)
    tell(DRAWING)
    return Outcome((ranking, ranking.together), ranking.document(title=problem.title).drawn())


def design(study: Study, wish: DesignWish, tell: Tell) -> Outcome:
    """Design the manoeuvre that tells most, within the limits."""
    from oed_sysid.design import (
        Caution,
        Discriminate,
        Search,
        Trial,
        assess_limits,
        design_experiment,
    )

    problem = study.problem
    pattern = problem.experiment(wish.like)
    nominal = fitted(study, problem.model, tell) if wish.after_fit else problem.model
    if wish.rivals:
        criterion: Any = Discriminate([problem.effect(name) for name in wish.rivals])
    else:
        criterion = named("criterion", wish.criterion, CRITERIA)()
    limits = limits_of(problem.limits, wish)
    spread = None if wish.after_fit else UNCERTAINTY
    result = design_experiment(
        nominal,
        Trial.like(pattern, limits, duration=wish.duration),
        rng=np.random.default_rng(wish.seed),
        criterion=criterion,
        search=Search(
            named("family", wish.family, FAMILIES)(), *named("effort", wish.effort, EFFORTS)
        ),
        caution=None if wish.certainty is None else Caution(wish.certainty, spread),
        progress=lambda state: tell(
            f"designing: start {state.start + 1}, round {state.round + 1}, {state.value:.4g}"
        ),
    )
    if result.assurance is None:
        tell("simulating other vehicles")
        stated = assess_limits(
            result.model, result.experiment, limits=limits, spread=spread, prior=result.prior,
            rng=np.random.default_rng(wish.seed), vehicles=200,
        )  # fmt: skip
        result = replace(result, assurance=stated)
    tell(DRAWING)
    return Outcome(result, result.document(title=problem.title).drawn())


@dataclass(frozen=True)
class ProgrammeWish:
    """What a programme of runs shall be; as the options of ``oed-sysid programme``.

    Parameters
    ----------
    runs : int
        Largest number of runs.
    hours : float or None
        Time for everything, h; None where only the number counts.
    turnaround : float
        Time between two runs, min.
    criterion : str
        ``"A"`` or ``"D"``.
    seed : int
        Of the search.
    """

    runs: int = 4
    hours: float | None = None
    turnaround: float = 10.0
    criterion: str = "A"
    seed: int = 0


def programme(study: Study, wish: ProgrammeWish, tell: Tell) -> Outcome:
    """Plan several runs together: which, how often and in which order."""
    from oed_sysid.design import Budget, Knowledge, design_programme

    problem = study.problem
    found = design_programme(
        problem.model,
        list(problem.experiments.values()),
        limits=problem.limits,
        rng=np.random.default_rng(wish.seed),
        budget=Budget(wish.hours, wish.runs, 60.0 * wish.turnaround),
        criterion=named("criterion", wish.criterion, CRITERIA)(),
        knowledge=Knowledge(spread=usual_spread(problem.model)),
        progress=tell,
    )
    tell(DRAWING)
    return Outcome(found, found.document(title=problem.title).drawn())


def tables(found: Programme) -> bytes:
    """Commands of every run of a programme as tables to play, in a ZIP file."""
    target = io.BytesIO()
    with (
        tempfile.TemporaryDirectory() as folder,
        zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as packed,
    ):
        for file in found.write(Path(folder)):
            packed.write(file, Path(file).name)
    return target.getvalue()


def limits_of(limits: Limits, wish: DesignWish) -> Limits:
    """Return the problem's limits with the ranges and rates that were wished."""
    ranges = {name: (lower, upper) for name, lower, upper in wish.ranges}
    corridors = {name: (lower, upper) for name, lower, upper in wish.corridors}
    return replace(
        limits,
        inputs={**limits.inputs, **ranges},
        rates={**limits.rates, **dict(wish.rates)},
        signals={**limits.signals, **corridors},
    )


def risk(design: Design) -> str:
    """Say what a design risks, where it leaves the limits more often than may be.

    Returns
    -------
    str
        Empty where limits are kept on the share of vehicles that was wanted, or on 90 %.
    """
    stated = design.assurance
    if stated is None or stated.is_safe:
        return ""
    return (
        f"{stated.danger} Left first: {', '.join(stated.left)}. Take narrower commands, wider "
        "limits, or ask for limits that are kept on uncertain vehicles."
    )


def commands_csv(design: Design) -> bytes:
    """Return the commands of a design as the file that an autopilot plays."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "design.csv"
        design.write_csv(path)
        return path.read_bytes()
