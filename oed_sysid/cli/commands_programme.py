"""Commands for a whole trial: plan several runs, then decide after each."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oed_sysid.cli.terminal import answer, deliver, drawn, note, progress, store
from oed_sysid.errors import DesignError

if TYPE_CHECKING:
    from oed_sysid.experiments.experiment import Experiment, Limits
    from oed_sysid.experiments.problem import Problem


def programme(
    problem: str,
    runs: int | None = None,
    hours: float | None = None,
    sea: str | None = None,
    patterns: list[str] | None = None,
    limit: list[str] | None = None,
    duration: float | None = None,
    turnaround: float = 10.0,
    criterion: str = "A",
    discriminate: list[str] | None = None,
    reveal: list[str] | None = None,
    uncertainty: float | None = None,
    sensor: list[str] | None = None,
    rounds: int = 1,
    after: Path | None = None,
    out: Path | None = None,
    model: str | None = None,
    seed: int = 0,
    json_file: Path | None = None,
    html_file: Path | None = None,
    picture: Path | None = None,
) -> None:
    """Plan several runs together: which, how often, in which order, and how near the optimum.

    [bold]Example[/bold]: oed-sysid programme remus_diving_plane --runs 5 --hours 2 --sea moderate
    """
    import numpy as np

    from oed_sysid.cli.commands_plan import _criterion, _noise
    from oed_sysid.design import Budget, Knowledge, ProgrammeSearch, design_programme
    from oed_sysid.experiments.problem import load_problem
    from oed_sysid.likelihood.fit import Fit

    chosen = load_problem(problem, variant=model)
    nominal = Fit.load(after) if after else chosen.model
    with progress("Planning") as show:
        found = design_programme(
            nominal,
            _patterns(chosen, patterns or []),
            limits=_limits(chosen, limit or []),
            rng=np.random.default_rng(seed),
            budget=Budget(hours, runs, 60.0 * turnaround, _numbers("--sensor", sensor or [])),
            criterion=_criterion(chosen, criterion, discriminate or [], reveal or []),
            knowledge=Knowledge(
                noise=_noise(chosen, nominal, sea), spread=_spread(chosen, uncertainty, after)
            ),
            search=ProgrammeSearch(
                durations=None if duration is None else (duration,), n_rounds=rounds
            ),
            progress=show.say,
        )
    deliver(
        found.document(title=chosen.title),
        found.to_dict(),
        picture=partial(drawn, "figure_programme", found),
    )
    note(f"Planned in {found.seconds:.0f} s.")
    if out is not None:
        for path in found.write(out):
            note(f"Written: {path}")


def campaign(
    folder: Path,
    problem: str | None = None,
    goal: list[str] | None = None,
    hours: float | None = None,
    record: Path | None = None,
    sea: str | None = None,
    patterns: list[str] | None = None,
    limit: list[str] | None = None,
    duration: float | None = None,
    turnaround: float = 10.0,
    uncertainty: float | None = None,
    model: str | None = None,
    seed: int = 0,
    json_file: Path | None = None,
) -> None:
    """Say after each run whether to stop, or what to run next and what it would buy.

    The state is a journal in FOLDER: the same command goes on after a break. Begin with --problem
    and --goal, then give each log with --record; the commands of the next run are written as
    next.csv.

    [bold]Example[/bold]: oed-sysid campaign trial --problem remus_diving_plane --goal all=5
    --hours 2
    """
    import numpy as np

    from oed_sysid.cli.commands_plan import _noise
    from oed_sysid.design import candidate_runs
    from oed_sysid.design.logbook import Logbook
    from oed_sysid.design.vehicles import draw_models
    from oed_sysid.experiments.problem import load_problem

    if Logbook.exists(folder):
        if problem is not None or goal:
            raise DesignError(
                f"{str(folder)!r} holds a campaign already. Leave out --problem and --goal to go "
                "on with it, or name another folder."
            )
        journal = Logbook.open(folder)
        chosen = load_problem(journal.problem, variant=journal.variant)
        journal = journal.of(chosen.model)
    else:
        if problem is None or not goal:
            raise DesignError(
                f"There is no campaign in {str(folder)!r}. Begin one with --problem and --goal."
            )
        chosen = load_problem(problem, variant=model)
        lent = _patterns(chosen, patterns or [])
        limits = _limits(chosen, limit or [])
        rng = np.random.default_rng(seed)
        vehicles = draw_models(chosen.model, _spread(chosen, uncertainty, None), 12, None, rng)
        with progress("Making candidate runs"):
            runs = candidate_runs(
                chosen.model, lent, limits=limits, rng=rng, vehicles=vehicles,
                durations=None if duration is None else (duration,),
                turnaround=60.0 * turnaround,
            )  # fmt: skip
        journal = Logbook.begin(
            folder, chosen.model, problem=problem, variant=model, candidates=runs, hours=hours,
            goals={n: v / 100.0 for n, v in _numbers("--goal", goal).items()},
            sea=_noise(chosen, chosen.model, sea), seed=seed,
        )  # fmt: skip
    if record is not None:
        with progress("Estimating") as show:
            journal = journal.with_record(record)
            show.say("deciding")
    decision = journal.decide()
    report = decision.report()
    if journal.fit is not None:
        concerns = "; ".join(str(one) for one in journal.fit.concerns)
        estimate = f"{journal.fit.status}{' ' + concerns if concerns else ''}"
        report += f"\n  estimate from {len(journal.records)} records: {estimate}"
    answer(decision.answer(len(journal.records), journal.hours_used), report)
    note(f"Decided in {decision.seconds:.2f} s.")
    path = journal.write_next(decision)
    if path is not None:
        note(f"Written: {path}")
    store(decision.to_dict(), json_file)


def _patterns(problem: Problem, names: list[str]) -> list[Experiment]:
    """Experiments that lend speeds and starts."""
    if names:
        return [problem.experiment(name) for name in names]
    if not problem.experiments:
        raise DesignError(f"Problem {problem.name!r} has no experiment to take settings from.")
    return list(problem.experiments.values())


def _limits(problem: Problem, given: list[str]) -> Limits:
    from oed_sysid.cli.limit_words import with_limits

    limits, said = with_limits(problem.model, problem.limits, given)
    for words in said:
        note(f"Limit: {words}.")
    return limits


def _spread(problem: Problem, uncertainty: float | None, after: Path | None) -> float | None:
    """Relative spread of vehicles; None where priors or a fit tell it."""
    if uncertainty is not None or after is not None:
        return uncertainty
    from oed_sysid.design.choices import usual_spread

    return usual_spread(problem.model)


def _numbers(option: str, given: list[str]) -> dict[str, float]:
    found: dict[str, Any] = {}
    for text in given:
        name, equals, number = text.partition("=")
        try:
            found[name] = float(number.rstrip("%")) if equals else None
        except ValueError:
            found[name] = None
        if found[name] is None:
            raise DesignError(f"{option} {text}: write NAME=NUMBER.")
    return found
