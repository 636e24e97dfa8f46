"""The command that opens the application in a browser: app."""

from __future__ import annotations


def app(
    problem: str | None = None,
    port: int = 8501,
    no_browser: bool = False,
) -> None:
    """Open the same in a browser, on this computer only. Needs the extra 'app'.

    [bold]Example[/bold]: oed-sysid app remus_diving_plane
    """
    from oed_sysid.app.launch import start

    start(problem, port=port, browser=not no_browser)


COMMANDS = (app,)
