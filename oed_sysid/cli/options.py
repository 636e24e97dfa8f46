"""Arguments and options of all commands: one table.

A command declares what it takes in its signature, in plain types or in groups of them; the row of
a parameter's name, or of ``command.name`` where a command means something of its own by it, says
how it is written and what it is. :func:`described` joins the two for typer, the page asks for its
options by the same rows (:func:`oed_sysid.app.panels.ask`), and :func:`line_of` writes the command
that repeats what the page was asked.
"""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

import oed_sysid
from oed_sysid.cli.study import DEFAULT_MODEL, Option, Study, Task, grouped, options_of
from oed_sysid.errors import FileError
from oed_sysid.runtime.files import check_place
from oed_sysid.runtime.tables import tables

# Endings of files that say how they are written.
_ENDINGS = {"picture": (".png", ".pdf", ".svg"), "card": (".txt", ".html", ".pdf")}


def checked(kind: str, value: Any) -> Any:
    """Say before the work where something could not be written, and return the place.

    Parameters
    ----------
    kind : str
        ``"file"``, ``"folder"``, ``"picture"``, ``"card"``, or ``"json"``, whose ``-`` is standard
        output.
    value : path or None
        Where.
    """
    if value is None or (kind == "json" and str(value) == "-"):
        return value
    if (endings := _ENDINGS.get(kind)) and Path(value).suffix.lower() not in endings:
        raise FileError(
            f"{str(value)!r} does not end as a {kind} does. Choose {', '.join(endings)}."
        )
    check_place(value, folder=kind == "folder")
    return value


def _problems(incomplete: str) -> list[str]:
    """Shipped problems whose names begin so; folders are completed by the shell itself."""
    return [name for name in oed_sysid.list_problems() if name.startswith(incomplete)]


@dataclass(frozen=True)
class Row:
    """One argument or option.

    Parameters
    ----------
    help : str
        What it is.
    metavar : str
        What stands for its value; choices are divided by ``|``.
    flag : str or None
        How an option is written, by default as the parameter is called; empty for an argument.
    place : str
        What is written there, see :func:`checked`; or ``"choice"``, of which there is no other.
    shown : bool or str
        What is said of the default.
    least : int, optional
        Least number.
    label : str
        What the page calls it; by default the first sentence of the help.
    offered : tuple
        What the page offers; by default the choices of ``metavar``.
    words : mapping of str to str
        What the page calls these.
    """

    help: str
    metavar: str = ""
    flag: str | None = None
    place: str = ""
    shown: bool | str = True
    least: int | None = None
    label: str = ""
    offered: Sequence[Any] = ()
    words: Mapping[str, str] = field(default_factory=dict)

    @property
    def choices(self) -> Sequence[Any]:
        """What there is to choose from; empty where anything can be given."""
        named = self.metavar.split("|") if "|" in self.metavar else []
        return self.offered or tuple(w for w in named if len(w) == 1 or w.islower())

    def declared(self, name: str, default: Any) -> Any:
        """Return what typer is told about a parameter of a command."""
        required = default is inspect.Parameter.empty
        settings: dict[str, Any] = {
            "help": self.help,
            "metavar": self.metavar or None,
            "callback": self.checked if self.place else None,
            "show_default": False if required or (default is None and self.shown is True)
            else self.shown,
            "min": self.least,
        }  # fmt: skip
        if self.flag == "":
            shipped = _problems if self.metavar == "PROBLEM" else None
            return typer.Argument(**settings, autocompletion=shipped)

        def complete(incomplete: str) -> list[str]:
            return [one for one in self.choices if one.startswith(incomplete)]

        known = complete if default in self.choices else None
        return typer.Option(*self.written(name).split(), **settings, autocompletion=known)

    def checked(self, value: Any) -> Any:
        """Refuse what is none of the choices, or a place that cannot be written to."""
        if self.place != "choice":
            return checked(self.place, value)
        if value is not None and value not in self.choices:
            raise typer.BadParameter(f"{value!r} is none of {', '.join(self.choices)}.")
        return value

    def written(self, name: str) -> str:
        """How the option of a parameter is written."""
        return self.flag or f"--{name.replace('_', '-')}"


_TABLE = tables(__file__)
ROWS = {name: Row(**row) for name, row in _TABLE.items()}


def row_of(command: str, name: str) -> Row:
    """Return the row of a command's option."""
    return ROWS.get(f"{command}.{name}") or ROWS[name]


def described(command: Callable[..., None], results: str = "json_file") -> Callable[..., None]:
    """Return a command whose signature says what the table does; groups are taken apart.

    ``results`` are options for what becomes of the result; see :mod:`oed_sysid.cli.terminal`.
    """

    @wraps(command)
    def called(**values: Any) -> None:
        command(**grouped(command, values))

    return declared(called, command.__name__, [*options_of(command), *places(results)])


def declared(
    command: Callable[..., None], name: str, options: Iterable[Option]
) -> Callable[..., None]:
    """Give a function of keyword arguments the signature that typer reads."""
    own, listed = list(options), []
    for one in [*own, *_shared({one.name for one in own})]:
        several = str(one.kind).startswith("tuple")
        kind = list[str] | None if several else one.kind
        default = None if several and one.default == () else one.default
        kind = Annotated[kind, row_of(name, one.name).declared(one.name, default)]
        form = inspect.Parameter.KEYWORD_ONLY
        listed.append(inspect.Parameter(one.name, form, default=default, annotation=kind))
    return signed(command, listed)


# What lines may say besides; no result is another by it.
SHARED = ("quiet", "debug", "time_unit", "form")


def _shared(names: Container[str]) -> Iterator[Option]:
    """Options of every command, of those that read records, and of those that print tables."""
    if "files" in names or "validate" in names:
        yield Option("time_unit", str | None, None)
    if "html_file" in names:
        yield Option("form", str, "text")
    yield from (Option("quiet", bool, False), Option("debug", bool, False))


def signed(command: Callable[..., None], listed: list[inspect.Parameter]) -> Callable[..., None]:
    """Give a function of keyword arguments a signature."""
    command.__signature__ = inspect.Signature(listed)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in listed}
    return command


def reads_of(task: Task) -> Iterator[Option]:
    """Options of the command of a task for what it is asked about."""
    empty = inspect.Parameter.empty
    yield Option("problem", str, empty)
    for word in task.reads.split():
        name = word.strip("[]")
        if name in ("files", "validate"):
            spare = word.startswith("[")
            yield Option(name, list[str] | None if spare else list[str], None if spare else empty)
    yield Option("model", str | None, None)
    if "noise" in task.reads:
        yield Option("known_noise", bool, False)
        yield Option("disturbances", str, "auto")


def places(names: str) -> Iterator[Option]:
    """Options that name files."""
    return (Option(name, Path | None, None) for name in names.split())


def results_of(task: Task) -> Iterator[Option]:
    """Options of the command of a task for what becomes of the result."""
    yield from places("json_file html_file picture")
    if "journal" in task.reads:
        yield Option("kept_in", Path | None, None)
        yield Option("fresh", bool, False)


def line_of(task: Task, study: Study, options: Mapping[str, Any], file: str = "") -> str:
    """Return the command that asks for a task, its records in the folders train and test.

    Examples
    --------
    >>> from oed_sysid.cli.tasks import TASKS
    >>> study = Study.named("remus_diving_plane")
    >>> line_of(TASKS["rank"], study, {"experiment": ("steps", "zigzag_5_5")})
    'oed-sysid rank remus_diving_plane --experiment steps zigzag_5_5 --html rank.html'
    """
    words = ["oed-sysid", task.name, study.source, *_asked_about(task, study)]
    for name, value in task.given(options).items():
        given = value if isinstance(value, tuple) else () if value is True else (value,)
        texts = (f"{one:.12g}" if isinstance(one, float) else str(one) for one in given)
        words += [row_of(task.name, name).written(name), *texts]
    return f"{shlex.join(words)} {task.keeps} --html {file or task.name}.html".replace("  ", " ")


def _asked_about(task: Task, study: Study) -> Iterator[str]:
    """Words of a command for the records and settings of a study."""
    if study.variant != DEFAULT_MODEL:
        yield from ("--model", study.variant)
    present = [name for name in ("train", "test") if getattr(study, name) is not None]
    if "files" in task.reads:
        yield from present[:1]
    if "validate" in task.reads and len(present) > 1:
        yield from ("--validate", "test")
    if "noise" in task.reads and study.known_noise:
        yield "--known-noise"
