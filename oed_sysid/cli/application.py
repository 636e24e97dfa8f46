"""The commands and how they are offered."""

from __future__ import annotations

from typing import Annotated

import typer

from oed_sysid.cli import (
    commands_benchmark,
    commands_data,
    commands_fit,
    commands_improve,
    commands_logs,
    commands_plan,
    commands_programme,
)
from oed_sysid.cli.arguments import Command
from oed_sysid.cli.options import described

EPILOG = (
    "Exit codes: 0 done; 1 the work ended without a usable result, such as a fit that did not "
    "converge or a log that is suspect; 2 the command line, a file or a problem has to be "
    "corrected; 3 an unexpected error; 130 interrupted.\n\n"
    "The whole path in Python and on the command line: README.md."
)

app = typer.Typer(
    name="oed-sysid",
    help="Identify ships and underwater vehicles: simulate, fit, and find what a model lacks.",
    epilog=EPILOG,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
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


COMMANDS = (
    *(commands_data.problems, commands_data.new, commands_data.simulate, commands_logs.import_),
    *(commands_logs.check, commands_plan.rank, commands_plan.design, commands_programme.programme),
    *(commands_programme.campaign, commands_fit.fit, commands_fit.compare, commands_fit.report),
    *(commands_improve.diagnose, commands_improve.improve, commands_data.export, commands_data.app),
)
for command in COMMANDS:
    name = command.__name__.rstrip("_")  # import is a word of Python
    alone = name in ("problems", "app")
    app.command(name, cls=Command, no_args_is_help=not alone)(described(command))
app.add_typer(commands_benchmark.app)
