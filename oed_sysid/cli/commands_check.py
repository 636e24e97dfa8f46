"""The command that looks at logs before any model: check."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import typer

from oed_sysid.cli.reading import read_records
from oed_sysid.cli.terminal import deliver, drawn, note, progress
from oed_sysid.errors import DataError
from oed_sysid.runtime.files import make_folder


def check(
    problem: str,
    files: list[str],
    validate: list[str] | None = None,
    model: str | None = None,
    json_file: Path | None = None,
    html_file: Path | None = None,
    picture: Path | None = None,
    fix: Path | None = None,
) -> None:
    """Check logs for faults before any model: signs, units, axes, bias, delay, spikes and more.

    Ends with exit code 1 when the log is suspect.

    [bold]Example[/bold]: oed-sysid check remus_diving_plane dive_*.csv --html check.html
    """
    from oed_sysid.data.dataset import together, write_csv
    from oed_sysid.evidence.check import check as look
    from oed_sysid.evidence.check import corrected_copies, why_not_more
    from oed_sysid.experiments.problem import load_problem

    chosen = load_problem(problem, variant=model)
    records = read_records(files, chosen)
    if validate:  # a fault between the two, such as the same run in both, is found as well
        records = together(records, read_records(validate, chosen))
    with progress("Checking"):
        result = look(records, chosen)
    deliver(
        result.document(),
        result.to_dict(),
        page=partial(result.document, records, title=chosen.title),
        picture=partial(drawn, "figure_check", result),
    )
    if fix is not None:
        copies, done = corrected_copies(records, chosen, result)
        targets = [fix / f"{record.name.replace('/', '_')}.csv" for record in copies]
        if {target.resolve() for target in targets} & {Path(r.source).resolve() for r in records}:
            raise DataError(
                f"The corrected copies would overwrite the records in {str(fix)!r}. Give another "
                "folder to --fix."
            )
        make_folder(fix)
        for record, target in zip(copies, targets, strict=True):
            write_csv(record, target)
            note(f"Written: {target}")
        for line in done:
            note(f"Corrected in the copies: {line}")
        reason = why_not_more(result)
        if reason:
            note(f"Not corrected: {reason}")
        if not done:
            note("Nothing to correct: the copies equal the records.")
    if result.suspect:
        raise typer.Exit(1)


COMMANDS = (check,)
