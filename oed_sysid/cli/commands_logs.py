"""Commands about logs before any model: import, check."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from oed_sysid.cli.reading import read_records
from oed_sysid.cli.terminal import answer, deliver, draw, drawn, note, progress, say, store
from oed_sysid.errors import DataError
from oed_sysid.runtime.display import counted
from oed_sysid.runtime.files import make_folder

if TYPE_CHECKING:
    from oed_sysid.data.logs import Imported, Log, LogMapping
    from oed_sysid.experiments.problem import Problem


def import_(
    log: Path,
    listing: bool = False,
    find: str = "",
    mapping: Path | None = None,
    draft: Path | None = None,
    problem: str | None = None,
    model: str | None = None,
    out: Path = Path("data"),
    json_file: Path | None = None,
    picture: Path | None = None,
) -> None:
    """Make records of a vehicle's own log: list its fields, map them to channels, cut, check.

    Ends with exit code 1 when the log is suspect; the records are written all the same.

    [bold]Example[/bold]: oed-sysid import trial.ulg --list

    [bold]Example[/bold]: oed-sysid import trial.ulg --map ship.toml --out my_ship/sea
    """
    from oed_sysid.data.logs import open_log
    from oed_sysid.data.mapping import read_mapping
    from oed_sysid.experiments.problem import load_problem

    chosen = read_mapping(mapping) if mapping is not None else None
    with progress(f"Reading {log.name}"):
        found = open_log(log)
    if listing or (mapping is None and draft is None):
        _list(log, found, find, json_file)
        return
    named = problem or ("" if chosen is None else chosen.problem)
    if draft is not None:
        _draft(log, found, named, model, draft)
        return
    assert chosen is not None
    target = load_problem(_place(named, mapping), variant=model) if named else None
    result, files = _written(found, chosen, target, out)
    for line in result.notes:
        note(line)
    from oed_sysid.evidence.check import quick_check, signal_check

    dataset = result.dataset
    checked = signal_check(dataset) if target is None else quick_check(dataset, target.model)
    answer(f"{counted(len(files), 'record')} written to {out}. {checked.verdict}")
    for file, record in zip(files, dataset, strict=True):
        rate = record.n_samples / max(record.duration, 1e-9)
        say(f"{file}: {record.duration:.1f} s, {record.n_samples} rows ({rate:.3g} per second)")
    say(checked.report())
    draw(partial(drawn, "figure_record", dataset.records[0]), picture)
    store(
        {"log": str(log), "files": [str(file) for file in files], "notes": list(result.notes)}
        | {"check": checked.to_dict()},
        json_file,
        records=[dataset],
    )
    if checked.suspect:
        raise typer.Exit(1)


def _list(log: Path, found: Log, find: str, json_file: Path | None) -> None:
    """Say which fields a log has."""
    first, *rest = found.describe(find).splitlines()
    answer(first, "\n".join(rest))
    keys = ("field", "samples", "rate", "span", "unit", "range")
    rows = [dict(zip(keys, row, strict=True)) for row in found.rows(find)]
    store({"log": str(log), "kind": found.kind, "fields": rows}, json_file)


def _draft(log: Path, found: Log, named: str, model: str | None, place: Path) -> None:
    """Write a first mapping from names and units."""
    from oed_sysid.data.logs import draft
    from oed_sysid.experiments.problem import load_problem

    if not named:
        raise DataError("--draft needs --problem: whose channels are wanted?")
    wanted = load_problem(_place(named, None), variant=model).channels
    made = draft(found, wanted, problem=named)
    if made is None:
        raise DataError(
            f"No field of {log.name} has the name of an output: "
            f"{', '.join(wanted.output_names)}. Write the mapping by hand; see --list."
        )
    made.write(place)
    note(f"Written: {place}. Read it: names are guesses, missing inputs are zero.")


def _place(named: str, mapping: Path | None) -> str:
    """A problem's folder as seen from here, or from beside the mapping file."""
    beside = mapping.parent / named if mapping is not None else None
    if not Path(named).is_dir() and beside is not None and beside.is_dir():
        return str(beside)
    return named


def _written(
    log: Log, mapping: LogMapping, problem: Problem | None, out: Path
) -> tuple[Imported, list[Path]]:
    """Write a CSV file for every record."""
    from oed_sysid.data.dataset import write_csv
    from oed_sysid.data.logs import import_log

    channels = problem.channels if problem is not None else None
    result = import_log(log, mapping, channels)
    if out.suffix.lower() == ".csv":
        raise DataError(f"{out} is a file. Give a folder to --out: every cut becomes a file in it.")
    files = [out / f"{record.name.replace('/', '_')}.csv" for record in result.dataset]
    if log.path.resolve() in {file.resolve() for file in files}:
        raise DataError(f"The records would overwrite {log.path}. Give another folder to --out.")
    make_folder(out)
    for record, file in zip(result.dataset, files, strict=True):
        write_csv(record, file)
    return result, files


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
