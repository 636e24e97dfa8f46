"""The command that opens the application in a browser: app."""

from __future__ import annotations

from typing import Annotated

import typer


def app(
    problem: Annotated[
        str | None,
        typer.Argument(
            metavar="[PROBLEM]",
            help="Problem to begin with: a shipped one or a folder of your own.",
            show_default=False,
        ),
    ] = None,
    port: Annotated[int, typer.Option("--port", help="Port of this computer.")] = 8501,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Do not open a browser; only say the address.")
    ] = False,
) -> None:
    """Open the same in a browser, on this computer only. Needs the extra 'app'.

    [bold]Example[/bold]: oed-sysid app remus_diving_plane
    """
    from oed_sysid.app.launch import start

    start(problem, port=port, browser=not no_browser)


COMMANDS = (app,)
