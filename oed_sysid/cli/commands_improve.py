"""Commands that find missing physics: diagnose, improve."""

from __future__ import annotations

import re
import time
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from oed_sysid.cli.options import (
    Disturbances,
    Files,
    Fresh,
    HtmlFile,
    JournalFolder,
    JsonFile,
    KnownNoise,
    PictureFile,
    ProblemName,
    ToValidate,
    Variant,
    disturbances_of,
    file_place,
)
from oed_sysid.cli.reading import read_records
from oed_sysid.cli.terminal import (
    Shown,
    deliver,
    drawn,
    invocation,
    journal,
    note,
    progress,
    say_log,
)

if TYPE_CHECKING:
    from oed_sysid.runtime.display import Report


def diagnose(
    problem: ProblemName,
    files: Files,
    model: Variant = None,
    known_noise: KnownNoise = False,
    disturbances: Disturbances = "auto",
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
    picture: PictureFile = None,
) -> None:
    """Say where a model fails and which effects may be missing, without adding any.

    [bold]Example[/bold]: oed-sysid diagnose remus_diving_plane dive_1.csv dive_2.csv
    """
    from oed_sysid.evidence.check import quick_check
    from oed_sysid.evidence.compare import diagnose as look
    from oed_sysid.experiments.problem import load_problem

    chosen = load_problem(problem, variant=model)
    records = read_records(files, chosen)
    log = quick_check(records, chosen.model)
    with progress("Looking"):
        result = look(
            chosen.model,
            records,
            candidates=chosen.effects,
            known_noise=known_noise,
            disturbances=disturbances_of(disturbances),
        )
    say_log(log)
    deliver(
        result.document(),
        result.to_dict(),
        page=partial(result.document, records, title=chosen.title),
        picture=partial(drawn, "figure_diagnosis", result.location, result.ranking),
        records=[records],
    )


def improve(
    problem: ProblemName,
    files: Files,
    validate: ToValidate = None,
    model: Variant = None,
    known_noise: KnownNoise = False,
    disturbances: Disturbances = "auto",
    max_effects: Annotated[
        int, typer.Option("--max-effects", min=1, help="Most effects to add.")
    ] = 4,
    save: Annotated[
        str | None,
        typer.Option(
            "--save",
            metavar="FILE",
            help="Keep the fit of the improved model, for report, export, compare --with and "
            "design --after.",
            callback=file_place,
        ),
    ] = None,
    json_file: JsonFile = None,
    html_file: HtmlFile = None,
    picture: PictureFile = None,
    kept_in: JournalFolder = None,
    fresh: Fresh = False,
) -> None:
    """Find the effects that a model lacks, and test the claim on validation records.

    [bold]Example[/bold]: oed-sysid improve remus_diving_plane dive_1.csv dive_2.csv
    --validate dive_3.csv --save better.json
    """
    from oed_sysid.evidence.compare import compare
    from oed_sysid.evidence.improve import improve
    from oed_sysid.evidence.preparation import prepared
    from oed_sysid.experiments.problem import load_problem

    chosen = load_problem(problem, variant=model)
    training = read_records(files, chosen)
    validation = read_records(validate, chosen) if validate else None
    with journal(kept_in, fresh) as keep:
        with progress("Starting") as show:
            result = improve(
                chosen.model,
                training,
                validation,
                candidates=chosen.effects,
                known_noise=known_noise,
                disturbances=disturbances_of(disturbances),
                max_effects=max_effects,
                progress=partial(_tell, show, _Rounds(max_effects)),
                journal=keep,
            )

        def page() -> Report:
            fits = {"nominal": result.base_fit} | ({"improved": result.fit} if result.steps else {})
            ready = prepared(training, validation)
            judged = ready.validation or ready.train
            comparison = compare(fits, judged, sigma=result.yardstick.sigma)
            return result.document(comparison, train=ready.train, title=chosen.title)

        deliver(
            result.document(),
            result.to_dict(),
            page=page,
            picture=partial(drawn, "plot_error_fall", result),
            records=[training, validation],
        )
        if save is not None:
            command, settings = invocation()
            result.fit.save(save, command=command, settings=settings)
            note(f"Written: {save}")
        if result.remains.kind == "log suspect":
            raise typer.Exit(1)


class _Rounds:
    """How long the search goes on at most: every round adds one effect.

    Parameters
    ----------
    n_most : int
        Rounds at most.
    """

    def __init__(self, n_most: int) -> None:
        self._n_most = n_most
        self._began: list[float] = []

    def left(self, round: int, now: float) -> float | None:
        """Return the seconds left at most when a round begins; None before the second."""
        if round == len(self._began) + 1:
            self._began.append(now)
        if len(self._began) < 2:
            return None
        longest = max(b - a for a, b in zip(self._began, self._began[1:], strict=False))
        return longest * (self._n_most - round + 1)


def _tell(show: Shown, rounds: _Rounds, what: str) -> None:
    show.say(what)
    named = re.search(r"round (\d+)", what)
    left = rounds.left(int(named[1]), time.monotonic()) if named else None
    if left is not None:
        show.left(left, at_most=True)


COMMANDS = (diagnose, improve)
