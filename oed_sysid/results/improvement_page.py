"""The report on a search for missing physics."""

from __future__ import annotations

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.compare import Comparison
from oed_sysid.evidence.improvement import UNCONFIRMED, Improvement
from oed_sysid.results.comparison_page import comparison_sections, log_verdict
from oed_sysid.results.diagnosis_page import candidates_section, located_section
from oed_sysid.results.improvement_plots import plot_error_fall
from oed_sysid.results.page import Page, Picture, Section, Table
from oed_sysid.results.style import TWO_SIDED_95, new_figure


def improvement_page(
    improvement: Improvement,
    comparison: Comparison | None = None,
    *,
    train: Dataset | None = None,
    title: str = "",
) -> Page:
    """Compose the report on a search: verdict, steps, candidates, predictions, estimates.

    Parameters
    ----------
    improvement : Improvement
        The search.
    comparison : Comparison, optional
        Of the nominal and the improved model, best on validation records.
    train : Dataset, optional
        The training records, to draw residual forces against their signals.
    title : str
        Heading; by default the name of the model.
    """
    before, after = improvement.base_error, improvement.final_error
    which = "test" if np.isfinite(after["test"]) else "train"
    records = "validation" if which == "test" else "training"
    sections = [
        _steps(improvement),
        _advice(improvement),
        located_section(improvement.location, train),
        candidates_section(improvement.ranking),
    ]
    if comparison is not None:
        sections += comparison_sections(comparison)
    sections += [
        _estimates(improvement),
        Section("Equations of the improved model", listing=improvement.model.equations()),
    ]
    return Page(
        title=title or improvement.base.name,
        subtitle="What the model lacks, and what it predicts with it",
        verdict=improvement_verdict(improvement),
        numbers=(
            (f"error on {records} records, nominal", f"{before[which]:.3g} × noise"),
            ("improved", f"{after[which]:.3g} × noise"),
            ("effects added", str(len(improvement.steps))),
            ("candidates", str(len(improvement.ranking.scores))),
        ),
        sections=tuple(sections),
    )


def improvement_verdict(improvement: Improvement) -> tuple[str, ...]:
    """Say in sentences what is missing, what it brings, and whether the rest is noise."""
    before, after = improvement.base_error, improvement.final_error
    which = "test" if np.isfinite(after["test"]) else "train"
    records = "records that nothing was fitted to" if which == "test" else "training records"
    says = [
        *log_verdict(improvement.log),
        f"The nominal model predicts the {records} with an error of {before[which]:.3g} times "
        "the noise.",
    ]
    known = {score.effect.name for score in improvement.ranking.scores}
    suspect = improvement.remains.kind == "log suspect"
    lacks = "If the log were right, it would lack" if suspect else "It lacks"
    for step in improvement.steps:
        words = improvement.model.effect(step.added).description
        if step.added not in known:
            says.append(f"No known effect explains the rest alone; a term may: {words}.")
            continue
        meaning = f" ({words})" if words else ""
        rivals = [name for name in step.group if name != step.added]
        if rivals:
            says.append(
                f"{lacks} {step.added}{meaning}, or one of these, which the records cannot tell "
                f"from it: {', '.join(rivals)}."
            )
        else:
            says.append(f"{lacks} {step.added}{meaning}.")
    if improvement.steps and not suspect:
        says.append(f"Improved, its error is {after[which]:.3g} times the noise.")
    elif improvement.verdict == "unexplained":
        says.append(UNCONFIRMED)
    else:
        says.append("No candidate is missing that these records could show.")
    if which == "train":
        says.append("There were no validation records, so the claim has not been tested.")
    says.append(improvement.report().rstrip().splitlines()[-1])
    return tuple(says)


def _steps(improvement: Improvement) -> Section:
    rows = tuple(
        (
            step.added,
            f"{step.gain:.4g}",
            f"{step.needed:.3g}",
            f"{step.test_gain:.4g}" if np.isfinite(step.test_gain) else "",
            f"{step.train_error:.3g}",
            f"{step.test_error:.3g}" if np.isfinite(step.test_error) else "",
            ", ".join(name for name in step.group if name != step.added) or "none",
        )
        for step in improvement.steps
    )
    headers = (
        "added", "log-likelihood gain", "needed", "gain, validation", "error, training [noise]",
        "error, validation [noise]", "cannot be told from it",
    )  # fmt: skip
    figure, axes = new_figure(1, 1, size=(7.6, 3.8))
    plot_error_fall(improvement, ax=axes[0, 0])
    picture = Picture.of(
        figure,
        "Prediction error over whole records, in units of the noise. A right model has one.",
    )
    words = [
        "The log-likelihood gain is what twice the log-likelihood gains after all parameters and "
        "noise levels were estimated again; chance rarely exceeds the needed gain, however many "
        "candidates were tried. Errors are those of the model running on its own over whole "
        "records. Nothing was fitted to the validation records but their initial states."
    ]
    if improvement.rejected:
        refused = ", ".join(dict.fromkeys(improvement.rejected))
        words.append(f"Refused, because the validation records became less likely: {refused}.")
    tables = (*([Table(headers, rows, words=(6,))] if rows else []), _in_units(improvement))
    return Section("What is missing", tuple(words), tables=tables, pictures=(picture,))


def _advice(improvement: Improvement) -> Section:
    """What to believe, what not, and what to do next at sea."""
    words = tuple(line.replace("  - ", "\N{BULLET} ") for line in improvement.advice)
    words = (*words, *(f"Note: {note}" for note in improvement.notes))
    return Section("What to believe, and what to do next at sea", words)


def _in_units(improvement: Improvement) -> Table:
    """Errors of every output in its unit."""
    after = improvement.steps[-1].rms if improvement.steps else None
    header, *rows = improvement.yardstick.rows(improvement.base_rms, after)
    caption = " ".join(improvement.yardstick.notes())
    return Table(header, tuple(rows), caption=caption, words=(1,))


def _estimates(improvement: Improvement) -> Section:
    nominal = improvement.base.values
    rows = []
    for one in improvement.parameters:
        name, value, error = one["name"], one["value"], one["std_error"]
        prior = improvement.model.parameter(name)
        known = "" if prior.prior_mean is None else f"{prior.prior_mean:.4g}"
        if prior.prior_spread is not None:
            known += f" ± {TWO_SIDED_95 * prior.prior_spread:.2g}"
        rows.append(
            (
                name,
                f"{value:.5g}",
                f"{error:.2g}",
                f"{100 * error / abs(value):.2g} %" if value else "",
                f"{nominal[name]:.5g}" if name in nominal else "",
                known,
                one["unit"],
            )
        )
    headers = (
        "parameter", "value", "std. error", "relative", "without the effects",
        "prior ± (95 %)", "unit",
    )  # fmt: skip
    added = {parameter.name for step in improvement.steps for parameter in step.effect.parameters}
    marked = tuple(i for i, row in enumerate(rows) if row[0] in added)
    return Section("Estimates", tables=(Table(headers, tuple(rows), marked=marked),))
