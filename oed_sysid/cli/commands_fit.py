"""Commands that estimate and judge: fit, compare, report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oed_sysid.cli.options import HtmlFile, JsonFile, KnownNoise, ProblemName, Test, Train, Variant
from oed_sysid.cli.terminal import invocation, note, progress, say, store
from oed_sysid.errors import DataError

if TYPE_CHECKING:
    from oed_sysid.model import Model
    from oed_sysid.problem import Problem


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
    html_file: HtmlFile = None,
    save: Annotated[
        Path | None,
        typer.Option(
            "--save",
            metavar="FILE",
            help="Keep the whole fit, data included, for `oed-sysid report` and Fit.load.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Estimate the parameters of a problem's model from measured records.

    [bold]Example[/bold]: oed-sysid fit remus_diving_plane dive_1.csv dive_2.csv --json fit.json
    """
    from oed_sysid.data.dataset import read_csv
    from oed_sysid.estimators import MultipleShooting
    from oed_sysid.problem import load_problem

    chosen = load_problem(problem, variant=model)
    dataset = read_csv(files, chosen.channels)
    noise = "given" if known_noise else "auto"
    with progress("Fitting") as show:
        result = MultipleShooting(noise=noise, progress=show.iteration).fit(chosen.model, dataset)
    say(result.report())
    store(result.to_dict(), json_file, records=[dataset])
    if save is not None:
        command, settings = invocation()
        result.save(save, command=command, settings=settings)
        note(f"Written: {save}")
    if html_file is not None:
        from oed_sysid.report import fit_page

        note(f"Written: {fit_page(result).write(html_file)}")
    if not result.status.ok:
        raise typer.Exit(1)


def compare(
    problem: ProblemName,
    train: Train,
    test: Test,
    added: Annotated[
        list[str] | None,
        typer.Option(
            "--with",
            metavar="EFFECT...",
            help="Also compare the model with these candidates added, one by one; a+b adds two.",
            show_default=False,
        ),
    ] = None,
    model: Variant = None,
    known_noise: KnownNoise = False,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
) -> None:
    """Fit to training records and say where predictions of other records fail.

    [bold]Example[/bold]: oed-sysid compare remus_diving_plane --train t1.csv t2.csv --test v.csv
    """
    from oed_sysid.data.dataset import read_csv
    from oed_sysid.diagnosis.compare import compare as compare_models
    from oed_sysid.estimators import MultipleShooting
    from oed_sysid.problem import load_problem

    chosen = load_problem(problem, variant=model)
    training, untouched = (read_csv(files, chosen.channels) for files in (train, test))
    noise = "given" if known_noise else "auto"
    fits = {}
    with progress("Fitting") as show:
        for name, one in _models(chosen, added or []).items():
            show.say(f"Fitting {name}")
            fits[name] = MultipleShooting(noise=noise, progress=show.iteration).fit(one, training)
        show.say("Predicting")
        result = compare_models(fits, untouched)
    say(result.report())
    stopped = {name: fit for name, fit in fits.items() if not fit.status.ok}
    for name, fit in stopped.items():
        note(f"The fit of {name} ended as {fit.status}")
    store(result.to_dict(), json_file, records=[training, untouched])
    if html_file is not None:
        from oed_sysid.report import comparison_page

        note(f"Written: {comparison_page(result, title=chosen.title).write(html_file)}")
    if stopped:
        raise typer.Exit(1)


def report(
    saved: Annotated[
        Path,
        typer.Argument(
            metavar="FIT",
            help="What `oed-sysid fit --save FIT` kept, or the numbers of --json.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="The report, one HTML file.")
    ] = Path("report.html"),
    test: Annotated[
        list[str] | None,
        typer.Option(
            "--test",
            metavar="CSV...",
            help="Also show what the fit predicts for these records.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write the report on a saved fit, with its predictions of other records.

    [bold]Example[/bold]: oed-sysid report fit.json --test validation.csv --out fit.html
    """
    from oed_sysid.data.dataset import read_csv
    from oed_sysid.diagnosis.compare import compare as compare_models
    from oed_sysid.fitting.fit import Fit
    from oed_sysid.fitting.saved import is_numbers_of_fit, read_json, read_result
    from oed_sysid.report import fit_page, numbers_page

    content = read_json(saved)
    if is_numbers_of_fit(content):
        note(f"Written: {numbers_page(content).write(out)}")
        note(
            f"{saved} holds the numbers of a fit only. For pictures and predictions repeat the fit "
            "with --save FILE and report on that file."
        )
        if test:
            raise DataError(
                f"{saved} holds no model, so it predicts nothing. Repeat the fit with --save FILE, "
                "or leave out --test."
            )
        return
    kept = Fit.load(saved)
    made = read_result(saved, "fit")[1]
    if made.get("command"):
        note(f"Made by oed_sysid {made.get('version')}: {made['command']}")
    comparison = None
    if test:
        comparison = compare_models({kept.model.name: kept}, read_csv(test, kept.model.channels))
        say(comparison.verdict)
    note(f"Written: {fit_page(kept, comparison).write(out)}")


def _models(problem: Problem, added: list[str]) -> dict[str, Model]:
    """The believed model, and one for each group of candidates added to it."""
    models = {"as believed": problem.model}
    for group in added:
        effects = [problem.effect(name.strip()) for name in group.split("+")]
        models[f"with {' and '.join(effect.name for effect in effects)}"] = problem.model + effects
    return models


COMMANDS = (fit, compare, report)
