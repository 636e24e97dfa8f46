"""Commands before any measurement: rank."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from oed_sysid.cli.options import JsonFile, ProblemName, Variant
from oed_sysid.cli.terminal import say, store
from oed_sysid.errors import ProblemError

if TYPE_CHECKING:
    from oed_sysid.dataset import Dataset
    from oed_sysid.experiment import Experiment
    from oed_sysid.problem import Problem


def rank(
    problem: ProblemName,
    experiment: Annotated[
        list[str] | None,
        typer.Option(
            "--experiment",
            metavar="NAME...",
            help="Planned experiments, together; by default all of the problem.",
            show_default=False,
        ),
    ] = None,
    records: Annotated[
        list[str] | None,
        typer.Option(
            "--records",
            metavar="CSV...",
            help="Records in hand instead of planned experiments.",
            show_default=False,
        ),
    ] = None,
    model: Variant = None,
    json_file: JsonFile = None,
) -> None:
    """Rank parameters by what experiments tell about them, before fitting anything.

    [bold]Example[/bold]: oed-sysid rank remus_diving_plane --experiment zigzag_5_5 steps
    """
    from oed_sysid.problem import load_problem
    from oed_sysid.sensitivity import identifiable_subset, information_of, rank_parameters

    chosen = load_problem(problem, variant=model)
    runs = _runs(chosen, experiment or [], records or [])
    ranking = rank_parameters(chosen.model, runs)
    subset = identifiable_subset(
        information_of(chosen.model, runs, priors=None), chosen.model.values
    )
    say(ranking.report())
    say()
    say(subset.report())
    store({"ranking": ranking.to_dict(), "subset": subset.to_dict()}, json_file)


def _runs(
    problem: Problem, experiments: list[str], records: list[str]
) -> Dataset | list[Experiment]:
    from oed_sysid.dataset import read_csv

    if records and experiments:
        raise ProblemError("Give either --experiment or --records, not both.")
    if records:
        return read_csv(records, problem.channels)
    names = experiments or list(problem.experiments)
    if not names:
        raise ProblemError(
            f"Problem {problem.name!r} has no experiments. Add one to its problem.py, or give "
            "--records."
        )
    return [problem.experiment(name) for name in names]


COMMANDS = (rank,)
