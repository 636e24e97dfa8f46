"""Commands that find missing physics: diagnose, improve."""

from __future__ import annotations

import re
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from oed_sysid.cli.options import (
    disturbances_of,
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

# How progress begins that tells of an effect when it is confirmed.
CONFIRMED = "confirmed "


def diagnose(
    problem: str,
    files: list[str],
    model: str | None = None,
    known_noise: bool = False,
    disturbances: str = "auto",
    json_file: Path | None = None,
    html_file: Path | None = None,
    picture: Path | None = None,
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
    problem: str,
    files: list[str],
    validate: list[str] | None = None,
    model: str | None = None,
    known_noise: bool = False,
    disturbances: str = "auto",
    max_effects: int = 4,
    no_terms: bool = False,
    save: str | None = None,
    json_file: Path | None = None,
    html_file: Path | None = None,
    picture: Path | None = None,
    kept_in: Path | None = None,
    fresh: bool = False,
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
                terms=not no_terms,
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
    if what.startswith(CONFIRMED):
        note(f"{what[0].upper()}{what[1:]}.")  # stays, where progress is overwritten
    show.say(what)
    named = re.search(r"round (\d+)", what)
    left = rounds.left(int(named[1]), time.monotonic()) if named else None
    if left is not None:
        show.left(left, at_most=True)
