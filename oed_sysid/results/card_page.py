"""The sea-trial card in one HTML file, to print or to mail."""

from __future__ import annotations

from oed_sysid.design import Design
from oed_sysid.design.assurance import PredictedTracks
from oed_sysid.results.card_plots import plot_orders, plot_tracks
from oed_sysid.results.page import Page, Picture, Section
from oed_sysid.results.style import new_figure


def card_page(design: Design, tracks: PredictedTracks | None = None, *, title: str = "") -> Page:
    """Compose the card: danger first, then what to run, where it goes, and when to stop.

    Parameters
    ----------
    design : Design
    tracks : PredictedTracks, optional
        From :func:`~oed_sysid.design.predicted_tracks`.
    title : str
    """
    safe = design.assurance
    verdict = []
    if safe is not None and not safe.is_safe:
        verdict.append(safe.danger)
    if safe is not None and safe.rules:
        verdict.append(
            f"Abort rules fire on {safe.any_fires:.1%} of {safe.n_checked} simulated vehicles."
        )
    figure, axes = new_figure(1, 1, size=(7.2, 2.6))
    plot_orders(design, ax=axes[0, 0])
    pictures = [Picture.of(figure, "Orders over time.")]
    if tracks is not None:
        figure, axes = new_figure(1, 1, size=(5.4, 4.6))
        plot_tracks(tracks, ax=axes[0, 0])
        pictures.append(
            Picture.of(
                figure,
                "Where the run goes: " + "; ".join(tracks.words()) + ".",
            )
        )
        verdict.append("Sea room: " + "; ".join(tracks.words()[:2]) + ".")
    return Page(
        title=title or design.model.name,
        subtitle=f"Sea-trial card of {design.experiment.name!r}",
        verdict=tuple(verdict) or (f"Criterion {design.criterion}.",),
        numbers=(
            ("length", f"{design.experiment.duration:g} s"),
            ("limits kept", "-" if safe is None else f"{safe.probability:.1%}"),
            ("stopped", "-" if safe is None else f"{safe.any_fires:.1%}"),
        ),
        sections=(
            Section("Card", listing=design.sea_trial_card()),
            Section("Orders and track", pictures=tuple(pictures)),
        ),
    )
