"""The report on a diagnosis: where a model fails, and which effects would explain it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.compare import Diagnosis
from oed_sysid.evidence.locate import Located
from oed_sysid.evidence.rank import Ranking
from oed_sysid.results.force_plots import figure_force
from oed_sysid.results.improvement_plots import plot_located, plot_ranking
from oed_sysid.results.page import Page, Picture, Section, Table
from oed_sysid.results.style import new_figure


def diagnosis_page(diagnosis: Diagnosis, train: Dataset | None = None, *, title: str = "") -> Page:
    """Compose the report on a diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
        The finding.
    train : Dataset, optional
        Its records, to draw residual forces against their signals.
    title : str
        Heading; by default the name of the model.
    """
    group = diagnosis.group
    if not group:
        missing = "No candidate explains more than chance does."
    elif len(group) == 1:
        missing = f"Missing, as far as these records can tell: {group[0]}."
    else:
        missing = f"Missing, and these records cannot tell which: {', '.join(group)}."
    return Page(
        title=title or diagnosis.model.name,
        subtitle="Where the model fails and what may be missing; nothing was added",
        verdict=(diagnosis.location.verdict, missing),
        sections=(
            located_section(diagnosis.location, train),
            candidates_section(diagnosis.ranking),
            Section("Equations of the nominal model", listing=diagnosis.model.equations()),
        ),
    )


def located_section(located: Located, train: Dataset | None) -> Section:
    """Where the nominal model fails, with residual forces where the records are given."""
    if located.by_motion:
        return Section("Where the nominal model fails", (located.by_motion,))
    figure, axes = new_figure(1, 1, size=(7.6, 1.3 + 0.3 * min(len(located.gains), 14)))
    plot_located(located, ax=axes[0, 0])
    pictures = [
        Picture.of(
            figure,
            "How far a disturbance at each place of the signal chain is behind the best one in "
            "explaining what is left. Within the grey band the records cannot tell them apart; "
            "the last row is no disturbance at all.",
        )
    ]
    words = [located.verdict]
    if located.best is not None and train is not None and located.force_names:
        equation = max(located.force_names, key=lambda n: located.gains.get(f"force {n}", 0.0))
        pictures.append(
            Picture.of(
                figure_force(located, equation, train),
                f"Residual force of the {equation} equation: over time with its 95 % band, and "
                "against measured signals and commands (points: means with 95 % intervals). A "
                "curve that repeats itself is a law that the model lacks.",
            )
        )
        words.append(
            "A residual force is the part of the missing force that the free parameters could not "
            "absorb, not the missing force itself."
        )
    return Section("Where the nominal model fails", tuple(words), pictures=tuple(pictures))


def candidates_section(ranking: Ranking) -> Section:
    """Candidates by log-likelihood gain, and those that the records would not show."""
    figure, axes = new_figure(1, 1, size=(8.4, 5.2))
    plot_ranking(ranking, ax=axes[0, 0])
    picture = Picture.of(
        figure,
        "The candidates in the first round. The score is computed without refitting; the most "
        "promising candidates are then refitted.",
    )
    hidden = ranking.undetectable()
    words = []
    tables = []
    if hidden:
        words.append(
            f"{len(hidden)} of {len(ranking.scores)} candidates would not be seen in these "
            "records at their typical size. That they were not found says nothing about them."
        )
        units = {p.name: p.unit for score in ranking.scores for p in score.effect.parameters}
        rows = tuple((name, _visible_from(limits, units)) for name, limits in hidden.items())
        headers = ("candidate", "would be seen from")
        tables.append(Table(headers, rows, caption="Invisible at typical size", words=(1,)))
    return Section("Candidates", tuple(words), tuple(tables), (picture,))


def _visible_from(limits: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Amplitudes from which a candidate would show; none where free parameters imitate it."""
    if not all(np.isfinite(value) for value in limits.values()):
        return "no size: the free parameters imitate it"
    return ", ".join(
        f"{key} = {value:.3g} {'' if units[key] == '1' else units[key]}".rstrip()
        for key, value in limits.items()
    )
