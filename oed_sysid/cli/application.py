"""The commands and how they are offered."""

from __future__ import annotations

from typing import Annotated

import typer

from oed_sysid.cli import (
    commands_app,
    commands_benchmark,
    commands_check,
    commands_data,
    commands_export,
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


for module in (
    commands_data,
    commands_logs,
    commands_check,
    commands_plan,
    commands_programme,
    commands_fit,
    commands_improve,
    commands_export,
    commands_app,
):
    for command in module.COMMANDS:
        name = command.__name__.rstrip("_")  # import is a word of Python
        app.command(name, cls=Command, no_args_is_help=name not in ("problems", "app"))(
            described(command)
        )
app.add_typer(commands_benchmark.app)
