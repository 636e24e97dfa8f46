"""The grammar that all commands share.

Files stand after the problem, records to judge with after ``--validate``, and an option
that takes several values takes all that follow it (``--validate a.csv b.csv``). A
:class:`Command` reads its own line in this way and adds, where a trial is planned, the limits of
the problem that is named: ``--max-fin 10``.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any

import typer
import typer.main
from typer.core import TyperCommand

import oed_sysid
from oed_sysid.cli.options import signed

if TYPE_CHECKING:
    from oed_sysid.experiments.problem import Problem

# Older words that are still understood: for an option, or for the files after the problem.
OLDER = {"--test": "--validate", "--train": "", "--records": "", "--reveal": "--detect"}
_LIMITS = "oed_sysid.limits"


def spread(
    arguments: Sequence[str],
    options: Iterable[str],
    older: Mapping[str, str] | None = None,
) -> list[str]:
    """Repeat each option before every value that follows it.

    Parameters
    ----------
    arguments : sequence of str
        The line after the command's name.
    options : iterable of str
        Options that take one or more values.
    older : mapping of str to str, optional
        Older words for them; the empty word stands for the files themselves.

    Returns
    -------
    list of str
        ``--with a b`` becomes ``--with a --with b``; what comes before the
        first option, other options and what follows ``--`` stay as they are.

    Examples
    --------
    >>> spread(["ship", "a.csv", "--validate", "b.csv", "c.csv", "--json", "out"], ["--validate"])
    ['ship', 'a.csv', '--validate', 'b.csv', '--validate', 'c.csv', '--json', 'out']
    >>> spread(["ship", "--train", "a.csv", "b.csv", "--test", "c.csv"], ["--validate"], OLDER)
    ['ship', 'a.csv', 'b.csv', '--validate', 'c.csv']
    """
    several = set(options)
    named = {old: new for old, new in (older or {}).items() if old not in several}
    result: list[str] = []
    option, has_value = "", False
    for position, argument in enumerate(arguments):
        if argument == "--":
            return result + list(arguments[position:])
        word, equals, value = argument.partition("=")
        if named.get(word) == "":  # files after an older word stand alone
            option = ""
            result += [value] if equals else []
            continue
        argument = named.get(word, word) + equals + value
        if argument.startswith("-") and len(argument) > 1:
            # An option without a value stays alone, for the parser to complain about.
            option, has_value = argument if argument in several else "", False
        elif option and has_value:
            result.append(option)
        else:
            has_value = True
        result.append(argument)
    return result


class Command(TyperCommand):
    """A command with the grammar of this module."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Options of the command, and limits of the problem that its line names."""
        *own, last = super().get_params(ctx)
        return [*own, *ctx.meta.get(_LIMITS, ()), last]

    def _spread(self, args: Sequence[str]) -> list[str]:
        """Repeat options before their values; understand older words for them and for files."""
        lists = [one for one in self.params if one.param_type_name == "option" and one.multiple]
        several = [word for param in lists for word in param.opts]
        known = {*several, *("" for param in self.params if param.name == "files")}
        return spread(args, several, {old: new for old, new in OLDER.items() if new in known})

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read a line; limits become values of ``--limit``."""
        names = [param.name for param in self.params]
        args = self._spread(args)
        meant: dict[str, str] = {}
        # A problem is a program: completing a word must not run it.
        if "limit" in names and not ctx.resilient_parsing:
            ctx.meta[_LIMITS], meant = _limits(args, self.params)
        rest = super().parse_args(ctx, args)
        given = {name: ctx.params.pop(name, None) for name in meant}
        said = [f"{meant[name]}={value}" for name, value in given.items() if value is not None]
        if said:
            ctx.params["limit"] = [*(ctx.params.get("limit") or ()), *said]
        return rest


# -- limits of a problem as options ------------------------------------------------------


def _named_problem(args: Sequence[str]) -> Problem | None:
    """Problem that a line names; None where it cannot be loaded: the command says why."""
    named = _value_of("--problem", args) or next((w for w in args if not w.startswith("-")), None)
    if named is not None:
        with suppress(oed_sysid.OedSysidError):
            return oed_sysid.load_problem(named, variant=_value_of("--model", args))
    return None


def _limits(args: Sequence[str], params: Sequence[Any]) -> tuple[list[Any], dict[str, str]]:
    """Options for the limits of the problem that a line names, and what each one limits."""
    from oed_sysid.cli.limit_words import limit_words

    if (problem := _named_problem(args)) is None:
        return [], {}
    taken = {word for param in params for word in param.opts}
    panel = f"Limits of {problem.name}: angles in degrees, the rest in SI units"
    offered: list[inspect.Parameter] = []
    meant: dict[str, str] = {}
    for side, words, says in limit_words(problem.model, problem.limits):
        for word in words:
            written = f"--{side}-{word}" if side else f"--{word}"
            if written in taken:
                continue
            option = typer.Option(
                written, metavar="VALUE" if side else "LOW:HIGH", help=says, show_default=False,
                hidden=word != words[0],  # of several words for one channel the first is shown
                rich_help_panel=panel,
            )  # fmt: skip
            name, kind = f"limit_{len(offered)}", Annotated[str | None, option]
            meant[name] = f"{side}:{word}" if side else word
            keyword = inspect.Parameter.KEYWORD_ONLY
            offered.append(inspect.Parameter(name, keyword, default=None, annotation=kind))
    # As typer makes them of the signature of a command.
    app = typer.Typer(add_completion=False, rich_markup_mode="rich")
    app.command()(signed(lambda **_: None, offered))
    return list(typer.main.get_command(app).params), meant


def _value_of(option: str, args: Sequence[str]) -> str | None:
    """Value after an option on a line that has not been read yet."""
    for position, word in enumerate(args):
        if word == option and position + 1 < len(args):
            return args[position + 1]
        if word.startswith(f"{option}="):
            return word.partition("=")[2]
    return None
