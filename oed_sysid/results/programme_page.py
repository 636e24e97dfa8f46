"""The report on a programme of runs."""

from __future__ import annotations

from oed_sysid.design import Programme
from oed_sysid.results.page import Page, Picture, Section, Table
from oed_sysid.results.programme_plots import figure_programme


def programme_page(programme: Programme, *, title: str = "") -> Page:
    """Compose the report on a programme: danger first, then runs, accuracy and certificate."""
    picture = Picture.of(
        figure_programme(programme),
        "Every run: its command and the motion that the model predicts; dotted: what all but the "
        "most extreme of the possible vehicles stay within; dashed: limits. Right: expected "
        "relative standard errors.",
    )
    errors = programme.relative_errors
    worst = int(errors.argmax())
    rows = []
    for number, run in enumerate(programme.runs, start=1):
        kept = programme.assurances.get(run.name)
        share = "-" if kept is None or not kept.limited else f"{kept.probability:.0%}"
        length = f"{float(run.experiment.duration or 0.0):g} s"
        rows.append((str(number), run.name, length, share))
    danger = [
        f"DANGER: {name} leaves its limits on {1 - programme.assurances[name].probability:.0%} of "
        "the vehicles that are possible."
        for name in programme.unsafe
    ]
    if programme.danger_together:
        danger = [programme.danger_together]
    verdict = [
        *danger,
        f"{len(programme.runs)} runs in {programme.hours:.3g} h tell "
        f"{100 * programme.share:.3g} % of what the best programme of "
        f"{len(programme.candidates)} candidate runs could.",
    ]
    if programme.limited:
        verdict.append(
            f"All runs together keep their limits on {programme.kept:.0%} of the vehicles."
        )
    if programme.standard is not None:
        verdict.append(
            f"Standard trials ({', '.join(programme.standard.names)}) need "
            f"{programme.standard.ratio:.3g} times the ship time for the same criterion."
        )
    marked = tuple(i for i, run in enumerate(programme.runs) if run.name in programme.unsafe)
    return Page(
        title=title or programme.model.name,
        subtitle=f"Programme, criterion {programme.criterion}",
        verdict=tuple(verdict),
        numbers=(
            ("runs", str(len(programme.runs))),
            ("time", f"{programme.hours:.3g} h"),
            (f"std. error, worst: {programme.names[worst]}", f"{100 * errors[worst]:.2g} %"),
        ),
        sections=(
            Section(
                "What to run",
                tables=(
                    Table(("", "run", "length", "limits kept"), tuple(rows), words=(1,),
                          marked=marked),
                ),
                pictures=(picture,),
            ),
            Section("In words", listing=programme.report()),
        ),
    )  # fmt: skip
