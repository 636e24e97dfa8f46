"""The report on a ranking: what planned experiments, or records, tell about parameters."""

from __future__ import annotations

import numpy as np

from oed_sysid.information import SensitivityRanking, Subset
from oed_sysid.results.design_plots import plot_sensitivity
from oed_sysid.results.page import Page, Picture, Section, Table
from oed_sysid.results.style import new_figure


def ranking_page(ranking: SensitivityRanking, subset: Subset, *, title: str = "") -> Page:
    """Compose the report on a ranking of parameters.

    Parameters
    ----------
    ranking : SensitivityRanking
        From :func:`~oed_sysid.information.rank_parameters`.
    subset : Subset
        From :func:`~oed_sysid.information.identifiable_subset`.
    title : str
        Heading.
    """
    figure, axes = new_figure(1, 1, size=(7.6, 1.4 + 0.3 * len(ranking.rows)))
    plot_sensitivity(ranking, ax=axes[0, 0])
    picture = Picture.of(
        figure,
        "Standard error of each parameter as a share of its value. The distance between the dots "
        "is what the other unknowns cost; beyond the dashed line the error exceeds the value.",
    )
    best, worst = ranking.rows[0], ranking.rows[-1]
    return Page(
        title=title or "What these experiments tell",
        subtitle=f"Parameters in {', '.join(ranking.runs)}",
        verdict=_verdict(ranking, subset),
        numbers=(
            (f"std. error, best: {best.name}", _percent(best.error)),
            (f"std. error, worst: {worst.name}", _percent(worst.error)),
            ("estimated together", f"{subset.size} of {len(subset.order)}"),
        ),
        sections=(
            Section("Accuracy to expect", pictures=(picture,)),
            Section(
                "Numbers",
                (
                    "Output change: relative change of the outputs when the parameter changes by "
                    f"{ranking.change:.0%}, summed over {', '.join(ranking.signals)}. It says what "
                    "moves the outputs, not what can be told apart.",
                ),
                tables=(_table(ranking),),
            ),
        ),
    )


def _verdict(ranking: SensitivityRanking, subset: Subset) -> tuple[str, ...]:
    if subset.left_out:
        together = (
            f"{subset.size} of {len(subset.order)} parameters can be estimated together. Fix, or "
            f"excite more: {', '.join(subset.left_out)}."
        )
    else:
        together = f"All {len(subset.order)} parameters can be estimated together."
    nothing = [f"Not determined: {text}." for text in ranking.information.null_directions()]
    return (together, *nothing, *(f"{text}." for text in ranking.disagreements))


def _table(ranking: SensitivityRanking) -> Table:
    rows = tuple(
        (
            row.name,
            f"{row.value:.4g}",
            _percent(row.error),
            _percent(row.error_alone),
            f"{row.inflation:.3g}",
            f"{row.output_change:.3g}",
            f"{row.peak_change:.3g}",
            row.unit,
        )
        for row in ranking.rows
    )
    headers = (
        "parameter", "value", "std. error", "if others were known", "ratio", "output change",
        "change of peaks", "unit",
    )  # fmt: skip
    return Table(headers, rows)


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %" if np.isfinite(share) else "not determined"
