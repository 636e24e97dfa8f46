"""Commands that estimate: fit."""

from __future__ import annotations

from typing import Annotated

import typer

from oed_sysid.cli.options import JsonFile, KnownNoise, ProblemName, Variant
from oed_sysid.cli.terminal import progress, say, store


def fit(
    problem: ProblemName,
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="CSV...",
            help="Records to fit: files, folders or patterns.",
            show_default=False,
        ),
    ],
    model: Variant = None,
    known_noise: KnownNoise = False,
    json_file: JsonFile = None,
) -> None:
    """Estimate the parameters of a problem's model from measured records.

    [bold]Example[/bold]: oed-sysid fit remus_diving_plane dive_1.csv dive_2.csv --json fit.json
    """
    from oed_sysid.dataset import read_csv
    from oed_sysid.estimators import MultipleShooting
    from oed_sysid.problem import load_problem

    chosen = load_problem(problem, variant=model)
    dataset = read_csv(files, chosen.channels)
    noise = "given" if known_noise else "auto"
    with progress("Fitting") as show:
        result = MultipleShooting(noise=noise, progress=show).fit(chosen.model, dataset)
    say(result.report())
    store(result.to_dict(), json_file)
    if not result.status.ok:
        raise typer.Exit(1)


COMMANDS = (fit,)
