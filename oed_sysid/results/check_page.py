"""The report on a log check."""

from __future__ import annotations

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.check import Finding, LogCheck
from oed_sysid.evidence.words import amount
from oed_sysid.results.check_plots import figure_check, plot_balances
from oed_sysid.results.page import Page, Picture, Section, Table
from oed_sysid.results.record_plots import figure_record
from oed_sysid.results.style import new_figure

_MAX_RECORDS = 3


def check_page(found: LogCheck, dataset: Dataset | None = None, *, title: str = "") -> Page:
    """Compose the report on a log check: verdict, findings with fixes, equations, records.

    Parameters
    ----------
    found : LogCheck
        From :func:`~oed_sysid.evidence.check`.
    dataset : Dataset, optional
        The records; drawn if given.
    title : str
        Heading.
    """
    return Page(
        title=title or "Log check",
        subtitle=f"Log check of {', '.join(found.records)}",
        verdict=(found.verdict, *(one.says for one in found.serious)),
        numbers=(
            ("suspect", str(len(found.serious))),
            ("good to know", str(len(found.findings) - len(found.serious))),
            ("equations used", str(len(found.relations))),
        ),
        sections=check_sections(found, dataset),
    )


def check_sections(found: LogCheck, dataset: Dataset | None = None) -> tuple[Section, ...]:
    """Findings, equations between signals, what cannot be told, and the records."""
    sections = []
    if found.findings:
        sections.append(Section("Findings", tables=(_table(found),)))
    if found.balances:
        figure, axes = new_figure(1, 1, size=(7.0, 1.5 + 0.5 * len(found.balances)))
        plot_balances(found, ax=axes[0, 0])
        pictures = (
            Picture.of(
                figure,
                "How much of the changes of each left side the other signals do not explain, over "
                "blocks of about a second; at the dotted line they explain nothing. Noise alone "
                "leaves something, too.",
            ),
            Picture.of(
                figure_check(found),
                "Each signal minus the integral of the others. With sensors that agree this is "
                "noise around a constant, or a slow random walk; a fault has a shape.",
            ),
        )
        sections.append(Section("Equations between signals", pictures=pictures))
    if found.unchecked:
        sections.append(Section("What this check cannot tell", found.unchecked))
    if dataset is not None:
        drawn = tuple(
            Picture.of(figure_record(record), f"{record.name} as it was read.")
            for record in dataset.records[:_MAX_RECORDS]
        )
        sections.append(Section("Records", pictures=drawn))
    return tuple(sections)


def _table(found: LogCheck) -> Table:
    rows = tuple(
        (
            one.says + (f" Or: {'; '.join(one.alternatives)}." if one.alternatives else ""),
            _size(one),
            "" if one.gain is None else f"{one.gain:.0f}",
            one.changes,
            one.fix,
        )
        for one in found.findings
    )
    marked = tuple(i for i, one in enumerate(found.findings) if one.suspect)
    return Table(
        ("finding", "size, 95 % interval", "log-likelihood gain", "left as it is", "fix"),
        rows,
        caption="Suspect findings are stressed.",
        words=(0, 3, 4),
        marked=marked,
    )


def _size(one: Finding) -> str:
    if one.interval is not None and one.size is not None:
        return amount(one.size, one.interval, one.unit)
    return ""
