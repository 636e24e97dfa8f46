"""The command that hands a model on: export."""

from __future__ import annotations

from pathlib import Path

from oed_sysid.cli.terminal import answer, note, say
from oed_sysid.errors import DataError


def export(
    fit: Path,
    kind: str,
    out: Path = Path("model"),
    at: list[str] | None = None,
) -> None:
    """Write a fitted model for another program, with the covariance of its parameters.

    [bold]Example[/bold]: oed-sysid export better.json --as c --out my_auv_c
    """
    from oed_sysid.export import export as write
    from oed_sysid.likelihood.fit import Fit

    trim = {}
    for text in at or ():
        name, _, value = text.partition("=")
        try:
            trim[name.strip()] = float(value)
        except ValueError:
            raise DataError(f"--at {text!r} is no NAME=VALUE. Write --at u=1.5, say.") from None
    result = Fit.load(fit)
    files = list(write(result, kind, out, trim=trim or None))
    n = len(result.names)
    answer(f"{result.model.name} as {kind}, with {n} parameters and their covariance: {files[0]}")
    for file in files[1:]:
        say(str(file))
    if not result.status.ok:
        note(f"The fit ended as {result.status}")


COMMANDS = (export,)
