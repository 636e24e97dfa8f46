"""The commands and how they are offered."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import typer

from oed_sysid.cli import commands
from oed_sysid.cli.arguments import Command
from oed_sysid.cli.options import declared, described, reads_of, results_of
from oed_sysid.cli.reading import study_of
from oed_sysid.cli.study import Task, grouped, options_of
from oed_sysid.cli.tasks import TASKS, Files
from oed_sysid.cli.terminal import deliver, journal, note, progress

EPILOG = (
    "Exit codes: 0 done; 1 the work ended without a usable result, such as a fit that did not "
    "converge; 2 the command line, a file or a problem has to be corrected; 3 an unexpected "
    "error; 4 the log is suspect; 130 interrupted.\n\n"
    "The whole path in Python and on the command line: README.md."
)
# In the order of the work; names that are no task's are those of functions.
ORDER = (
    "problems new simulate import check rank design programme campaign watch fit compare reduce "
    "report diagnose improve export app"
)
# What becomes of their results, where that is not numbers alone; `app` has none.
_DRAWN = ("simulate", "import", "report", "estimators")
RESULTS = dict.fromkeys(_DRAWN, "json_file picture") | {"app": ""}
_SETTINGS: dict[str, Any] = {"no_args_is_help": True, "rich_markup_mode": "rich"}

app = typer.Typer(
    name="oed-sysid",
    help="Identify ships and underwater vehicles: simulate, fit, and find what a model lacks.",
    epilog=EPILOG,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    **_SETTINGS,
)


def _version(wanted: bool) -> None:
    if wanted:
        from oed_sysid.runtime.version import __version__

        typer.echo(f"oed_sysid {__version__}")
        raise typer.Exit


@app.callback()
def _settings(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", callback=_version, is_eager=True)
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    pass  # --debug is looked for by oed_sysid.cli.main, where errors are said


def command_of(task: Task) -> Callable[..., None]:
    """Return the command of a task: read, work, print, write, and leave with its exit code."""
    own = {one.name for one in options_of(task.run)}
    writes = task.writes or Files

    def command(**given: Any) -> None:
        study = study_of(given)
        files: Files = writes(**grouped(writes, given))
        files.before(study)
        keeping = "kept_in" in given
        with journal(given.get("kept_in"), given.get("fresh", False), keeping=keeping) as keep:
            with progress(task.doing, keep) as show:
                outcome = task(study, show, {name: given[name] for name in own})
            text = "" if getattr(files, "card", None) else outcome.text
            deliver(outcome, (study.train, study.test), text=text)
            for line in files.write(outcome, study):
                note(line)
            if outcome.status:
                raise typer.Exit(outcome.status)

    listed = [*reads_of(task), *options_of(task.run), *options_of(writes), *results_of(task)]
    command.__doc__ = task.run.__doc__
    return declared(command, task.name, listed)


for _name in ORDER.split():
    if _name in TASKS:
        _command = command_of(TASKS[_name])
    else:
        _own = getattr(commands, _name, None) or getattr(commands, f"{_name}_")
        _command = described(_own, RESULTS.get(_name, "json_file"))
    app.command(_name, cls=Command, no_args_is_help=_name not in ("problems", "app"))(_command)

benchmarks = typer.Typer(
    name="benchmark", help="Compare methods on problems whose truth is known.", **_SETTINGS
)
for _own in (commands.estimators, commands.missing_physics):
    _command = described(_own, RESULTS.get(_own.__name__, "json_file"))
    benchmarks.command(_own.__name__.replace("_", "-"), cls=Command)(_command)
app.add_typer(benchmarks)
