"""The report on a comparison of models with records."""

from __future__ import annotations

from oed_sysid.evidence.check import LogCheck
from oed_sysid.evidence.compare import Comparison, ModelMisfit
from oed_sysid.results.page import Page, Picture, Section, Table
from oed_sysid.results.prediction_plots import figure_predictions, plot_comparison
from oed_sysid.results.style import new_figure
from oed_sysid.text.units import shown_unit

_MAX_RECORDS = 6


def comparison_page(
    comparison: Comparison, *, title: str = "Models and records", log: LogCheck | None = None
) -> Page:
    """Compose the report on a comparison: verdict, misfit by output, predictions."""
    return Page(
        title=title,
        subtitle=f"Compared on {', '.join(comparison.dataset.names)}",
        verdict=(*log_verdict(log), *comparison.verdict.splitlines()),
        numbers=tuple((part.label, f"{part.relative:.3g} × noise") for part in comparison.models),
        sections=comparison_sections(comparison),
    )


def log_verdict(log: LogCheck | None) -> tuple[str, ...]:
    """What speaks against the log that a result is made from, to be said first."""
    return () if log is None else tuple(log.warning().splitlines())


def comparison_sections(comparison: Comparison) -> tuple[Section, ...]:
    """Misfit by output, and the predictions of each record."""
    figure, axes = new_figure(1, 1, size=(8.4, 3.8))
    plot_comparison(comparison, ax=axes[0, 0])
    bars = Picture.of(
        figure,
        "Root mean square error of each output in units of its noise; whiskers show the best and "
        "the worst record. At the line the error is as large as noise alone.",
    )
    names = comparison.dataset.names[:_MAX_RECORDS]
    labels = [part.label for part in comparison.models]
    predictions = [part.prediction for part in comparison.models]
    pictures = tuple(
        Picture.of(
            figure_predictions(predictions, name, labels=labels),
            f"{name}: dots are measured; bands hold 95 % of new measurements if the model is "
            "right. Right: errors in units of the noise, whose 95 % band is grey.",
        )
        for name in names
    )
    rest = len(comparison.dataset) - len(names)
    words = (f"{rest} further records are not drawn.",) if rest else ()
    return (
        Section(
            "Where the models differ from the records",
            (*comparison.verdict.splitlines(), *(f"Note: {note}" for note in comparison.notes)),
            tables=tuple(_table(part) for part in comparison.models),
            pictures=(bars,),
        ),
        Section("Predictions", words, pictures=pictures),
    )


def _table(part: ModelMisfit) -> Table:
    rows = []
    for one, ahead in zip(part.outputs, part.forecasts.relative, strict=True):
        if not (one.n_samples or one.in_time):  # captive tests measure forces alone
            continue
        factor, unit = shown_unit(one.output.unit)
        rows.append(
            (
                one.output.name,
                f"{factor * one.rmse:.3g} {unit}",
                f"{factor * one.sigma:.3g} {unit}",
                f"{one.relative:.3g}",
                f"{100 * one.coverage:.0f} %",
                f"{one.effective_samples:.0f} of {one.n_samples}",
                f"{ahead:.3g}" if one.in_time else "-",
                f"{one.where} ({one.worst[3]:.2g} × noise)" if one.where else "",
            )
        )
    headers = (
        "output", "rms error", "noise", "ratio", "in 95 % band", "independent samples",
        f"{part.forecasts.horizon:g} s ahead", "worst",
    )  # fmt: skip
    return Table(headers, tuple(rows), caption=part.label, words=(7,))
