"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from oed_sysid.errors import FileError
from oed_sysid.runtime.files import check_place

# Formats of --picture.
PICTURES = (".png", ".pdf", ".svg")


def file_place(value: Any) -> Any:
    """Say before the work where a file could not be written; an option's callback."""
    if value is not None:
        check_place(value)
    return value


def folder_place(value: Any) -> Any:
    """Say before the work where files of a folder could not be written; an option's callback."""
    if value is not None:
        check_place(value, folder=True)
    return value


def picture_place(value: Any) -> Any:
    """As :func:`file_place`, of a picture; an option's callback."""
    return ending_of(value, PICTURES, "a picture")


def ending_of(value: Any, endings: tuple[str, ...], what: str) -> Any:
    """As :func:`file_place`, of a file whose ending says how it is written."""
    if value is not None and Path(value).suffix.lower() not in endings:
        raise FileError(f"{str(value)!r} does not end as {what} does. Choose {', '.join(endings)}.")
    return file_place(value)


def _problems(incomplete: str) -> list[str]:
    """Shipped problems whose names begin so; folders are completed by the shell itself."""
    from oed_sysid.experiments.problem import list_problems

    return [name for name in list_problems() if name.startswith(incomplete)]


def _one_of(*choices: str) -> Callable[[str], list[str]]:
    def complete(incomplete: str) -> list[str]:
        return [choice for choice in choices if choice.startswith(incomplete)]

    return complete


_PROBLEM = "A shipped problem (see: oed-sysid problems) or the path of a folder of your own."
ProblemName = Annotated[
    str,
    typer.Argument(metavar="PROBLEM", help=_PROBLEM, show_default=False, autocompletion=_problems),
]
Files = Annotated[
    list[str],
    typer.Argument(
        metavar="CSV...",
        help="Training records: files, folders or patterns.",
        show_default=False,
    ),
]
Validate = Annotated[
    list[str],
    typer.Option(
        "--validate",
        metavar="CSV...",
        help="Validation records; nothing is fitted to them.",
        show_default=False,
    ),
]
IfValidated = Annotated[
    list[str] | None,
    typer.Option(
        "--validate",
        metavar="CSV...",
        help="Validation records; nothing is fitted to them.",
        show_default=False,
    ),
]
ToValidate = Annotated[
    list[str] | None,
    typer.Option(
        "--validate",
        metavar="CSV...",
        help="Validation records; nothing is fitted to them. Without any, the last two fifths of a "
        "single record are kept for that.",
        show_default=False,
    ),
]
Effort = Annotated[
    str,
    typer.Option(
        "--effort",
        metavar="quick|normal|thorough",
        help="How many starts and steps: seconds, a minute, several minutes.",
        autocompletion=_one_of("quick", "normal", "thorough"),
    ),
]
Criterion = Annotated[
    str,
    typer.Option(
        "--criterion",
        metavar="D|A|E",
        help="What shall be small: D the errors of all parameters together, A their mean, E the "
        "worst combination.",
        autocompletion=_one_of("D", "A", "E"),
    ),
]
Family = Annotated[
    str,
    typer.Option(
        "--family",
        metavar="levels|multisine|pulses",
        help="Kind of command.",
        autocompletion=_one_of("levels", "multisine", "pulses"),
    ),
]
Variant = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help="Which of the problem's models is the nominal one, if it has several.",
        show_default=False,
    ),
]
Sea = Annotated[
    str | None,
    typer.Option(
        "--sea",
        metavar="STATE",
        help="Random forces to expect: still, calm, moderate, rough, or levels by equation as "
        "Z=0.3,M=0.06,time=2; with a fit those that it found.",
        show_default=False,
    ),
]
JsonFile = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Also write the result to FILE as JSON.",
        show_default=False,
        callback=file_place,
    ),
]
HtmlFile = Annotated[
    Path | None,
    typer.Option(
        "--html",
        metavar="FILE",
        help="Also write a report with pictures, one file that can be mailed.",
        show_default=False,
        callback=file_place,
    ),
]
PictureFile = Annotated[
    Path | None,
    typer.Option(
        "--picture",
        metavar="FILE",
        help="Also draw the result (PNG, PDF, SVG).",
        show_default=False,
        callback=picture_place,
    ),
]
KnownNoise = Annotated[
    bool,
    typer.Option(
        "--known-noise",
        help="Trust the noise levels that the problem declares instead of estimating them.",
    ),
]
ToTellApart = Annotated[
    list[str] | None,
    typer.Option(
        "--discriminate",
        metavar="EFFECT...",
        help="Tell these candidates apart instead of sharpening parameters.",
        show_default=False,
    ),
]
ToReveal = Annotated[
    list[str] | None,
    typer.Option(
        "--reveal",
        metavar="EFFECT...|all",
        help="Make these candidates visible, should they be missing, or all of the problem; "
        "with --after what its records have shown already counts.",
        show_default=False,
    ),
]
Disturbances = Annotated[
    str,
    typer.Option(
        "--disturbances",
        metavar="auto|none|all|NAMES",
        help="Where random forces may act: found out, nowhere, everywhere, or in the equations "
        "named, as Z,M.",
    ),
]


def noise_settings(known_noise: bool, disturbances: str) -> dict[str, Any]:
    """Settings of an estimator from ``--known-noise`` and ``--disturbances``."""
    return {
        "noise": "given" if known_noise else "auto",
        "disturbances": disturbances_of(disturbances),
    }


def disturbances_of(text: str) -> str | tuple[str, ...]:
    """What ``--disturbances`` says, as estimators take it."""
    if text in ("auto", "none", "all"):
        return text
    return tuple(name.strip() for name in text.split(",") if name.strip())


JournalFolder = Annotated[
    Path | None,
    typer.Option(
        "--journal",
        metavar="FOLDER",
        help="Where finished steps are kept until the command ends, so that it goes on from them "
        "when it is called again after an interruption.",
        show_default="in the user's cache",
        callback=folder_place,
    ),
]
Fresh = Annotated[
    bool,
    typer.Option("--fresh", help="Start over: forget what an interrupted call has finished."),
]
