"""Commands that find missing physics: diagnose, improve."""

from __future__ import annotations

from typing import Annotated

import typer

from oed_sysid.cli.options import (
    Fresh,
    HtmlFile,
    JournalFolder,
    JsonFile,
    KnownNoise,
    ProblemName,
    Train,
    Variant,
)
from oed_sysid.cli.terminal import journal, note, progress, say, say_log, store


def diagnose(
    problem: ProblemName,
    train: Train,
    model: Variant = None,
    known_noise: KnownNoise = False,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
) -> None:
    """Say where a model fails and which effects may be missing, without adding any.

    [bold]Example[/bold]: oed-sysid diagnose remus_diving_plane --train train_*.csv
    """
    from oed_sysid.compatibility import quick_check
    from oed_sysid.data.dataset import read_csv
    from oed_sysid.diagnosis.diagnose import diagnose as look
    from oed_sysid.problem import load_problem

    chosen = load_problem(problem, variant=model)
    records = read_csv(train, chosen.channels)
    log = quick_check(records, chosen.model)
    with progress("Looking"):
        result = look(chosen.model, records, candidates=chosen.effects, known_noise=known_noise)
    say_log(log)
    say(result.report())
    store(result.to_dict(), json_file, records=[records])
    if html_file is not None:
        from oed_sysid.report import diagnosis_page

        note(f"Written: {diagnosis_page(result, records, title=chosen.title).write(html_file)}")


def improve(
    problem: ProblemName,
    train: Train,
    test: Annotated[
        list[str] | None,
        typer.Option(
            "--test",
            metavar="CSV...",
            help="Validation records to test the claim with; of a single record without them the "
            "last part is kept for that.",
            show_default=False,
        ),
    ] = None,
    model: Variant = None,
    known_noise: KnownNoise = False,
    max_effects: Annotated[
        int, typer.Option("--max-effects", min=1, help="Most effects to add.")
    ] = 4,
    save: Annotated[
        str | None,
        typer.Option("--save", metavar="FILE", help="Keep the fit of the improved model."),
    ] = None,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
    kept_in: JournalFolder = None,
    fresh: Fresh = False,
) -> None:
    """Find the effects that a model lacks, and test the claim on validation records.

    [bold]Example[/bold]: oed-sysid improve remus_diving_plane --train train_*.csv --test test_*.csv
    """
    from oed_sysid.data.dataset import read_csv
    from oed_sysid.diagnosis.compare import compare
    from oed_sysid.diagnosis.improve import improve
    from oed_sysid.diagnosis.preparation import prepared
    from oed_sysid.problem import load_problem

    chosen = load_problem(problem, variant=model)
    training = read_csv(train, chosen.channels)
    validation = read_csv(test, chosen.channels) if test else None
    with journal(kept_in, fresh) as keep:
        with progress("Starting") as show:
            result = improve(
                chosen.model,
                training,
                validation,
                candidates=chosen.effects,
                known_noise=known_noise,
                max_effects=max_effects,
                progress=show.say,
                journal=keep,
            )
        say(result.report())
        store(result.to_dict(), json_file, records=[training, validation])
        if save is not None:
            result.fit.save(save)
            note(f"Written: {save}")
        if html_file is not None:
            from oed_sysid.report import improvement_page

            fits = {"nominal": result.base_fit} | ({"improved": result.fit} if result.steps else {})
            ready = prepared(training, validation)
            comparison = compare(fits, ready.validation or ready.train)
            page = improvement_page(result, comparison, train=ready.train, title=chosen.title)
            note(f"Written: {page.write(html_file)}")
        if result.remains.kind == "log suspect":
            raise typer.Exit(1)


COMMANDS = (diagnose, improve)
