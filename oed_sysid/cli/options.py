"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

# Options that take several values after one flag; see oed_sysid.cli.arguments.
SEVERAL = (
    *(
        "--train",
        "--test",
        "--experiment",
        "--records",
        "--with",
        "--discriminate",
        "--reveal",
        "--servo",
        "--limit",
        "--avoid",
        "--at",
        "--patterns",
        "--goal",
        "--sensor",
    ),
    *("--problems", "--estimators", "--noise", "--sampling"),
)

ProblemName = Annotated[
    str,
    typer.Argument(
        metavar="PROBLEM",
        help="A shipped problem (see: oed-sysid problems) or the path of a folder of your own.",
        show_default=False,
    ),
]
Variant = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help="Which of the problem's models to believe, if it has several.",
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
        "--json", metavar="FILE", help="Also write the result to FILE as JSON.", show_default=False
    ),
]
HtmlFile = Annotated[
    Path | None,
    typer.Option(
        "--html",
        metavar="FILE",
        help="Also write a report with pictures, one file that can be mailed.",
        show_default=False,
    ),
]
PictureFile = Annotated[
    Path | None,
    typer.Option(
        "--picture", metavar="FILE", help="Also draw the result (PNG, PDF).", show_default=False
    ),
]
Train = Annotated[
    list[str],
    typer.Option(
        "--train",
        metavar="CSV...",
        help="Records to learn from: files, folders or patterns; several after one --train.",
        show_default=False,
    ),
]
Test = Annotated[
    list[str],
    typer.Option(
        "--test",
        metavar="CSV...",
        help="Records to judge with; nothing is fitted to them.",
        show_default=False,
    ),
]
KnownNoise = Annotated[
    bool,
    typer.Option(
        "--known-noise",
        help="Trust the noise levels that the problem declares instead of estimating them.",
    ),
]
JournalFolder = Annotated[
    Path | None,
    typer.Option(
        "--journal",
        metavar="FOLDER",
        help="Where finished steps are kept until the command ends, so that it goes on from them "
        "when it is called again after an interruption.",
        show_default="in the user's cache",
    ),
]
Fresh = Annotated[
    bool,
    typer.Option("--fresh", help="Start over: forget what an interrupted call has finished."),
]
