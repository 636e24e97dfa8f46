"""The report on one fit."""

from __future__ import annotations

import numpy as np

from oed_sysid.evidence.check import LogCheck
from oed_sysid.evidence.compare import Comparison
from oed_sysid.likelihood.fit import Fit
from oed_sysid.results.comparison_page import comparison_sections, log_verdict
from oed_sysid.results.fit_plots import (
    figure_fit,
    figure_whiteness,
    plot_correlation,
    plot_intervals,
)
from oed_sysid.results.page import Page, Picture, Section, Table
from oed_sysid.results.style import TWO_SIDED_95, new_figure
from oed_sysid.text.units import shown_unit

# A misfit within this share of the noise level counts as explained by it.
_EXPLAINED = 1.05
_MAX_RECORDS = 8
# Prior standard deviations beyond which an estimate contradicts the prior.
_SURPRISING = 3.0


def fit_page(
    fit: Fit, comparison: Comparison | None = None, *, log: LogCheck | None = None, style: int = 0
) -> Page:
    """Compose the report on a fit: verdict, estimates, records, residuals, equations.

    Parameters
    ----------
    fit : Fit
        The fit.
    comparison : Comparison, optional
        Of the fit with other records.
    log : LogCheck, optional
        What a check of the records found; said first.
    style : int
        Position of the model in a comparison, for its colour.

    Returns
    -------
    Page
        Call ``.write("fit.html")``.
    """
    way = fit.estimator.replace(", ", " with ", 1)
    return Page(
        title=fit.model.name,
        subtitle=f"Fitted by {way} to {', '.join(fit.dataset.names)}",
        verdict=(
            *log_verdict(log),
            *fit_verdict(fit),
            *(comparison.verdict.splitlines() if comparison else ()),
        ),
        numbers=(
            ("misfit", f"{fit.normalised_rms:.3g} × noise"),
            ("parameters", str(len(fit.names))),
            ("samples", f"{fit.n_observations:,}".replace(",", " ")),
            (f"independent {_steps_of(fit)}", f"{_effective(fit):,.0f}".replace(",", " ")),
            ("status", fit.status.code),
        ),
        sections=(
            _estimates(fit),
            *record_sections(fit, style=style),
            residual_section(fit, style=style),
            *(comparison_sections(comparison) if comparison is not None else ()),
            Section("Equations", listing=fit.model.equations()),
        ),
    )


def fit_verdict(fit: Fit) -> tuple[str, ...]:
    """Say in sentences whether a fit can be used, and for what."""
    says = [f"Do not use these values: {concern.text}" for concern in fit.grave]
    if fit.status.ok:
        says.append("The estimation converged.")
    else:
        why = str(fit.status).rstrip(".")
        says.append(f"The estimation did not converge ({why}). Do not use the values.")
    if fit.sigma_estimated.all():
        says.append(
            "The noise levels were estimated from the residuals, so the size of the misfit says "
            "nothing by itself; its correlation in time does."
        )
    elif fit.normalised_rms > _EXPLAINED:
        says.append(
            f"The misfit is {fit.normalised_rms:.3g} times the noise: the model lacks something "
            "that these records contain, or the noise is larger than declared."
        )
    else:
        says.append(
            f"The misfit is {fit.normalised_rms:.3g} times the noise: nothing in these records "
            "contradicts its size."
        )
    if fit.coloured:
        says.append(
            f"The residuals are correlated in time ({_effective(fit):.0f} independent samples of "
            f"{fit.n_observations}). Standard errors take this into account."
        )
    far = [name for name in fit.names if _surprise(fit, name) > _SURPRISING]
    if far:
        says.append(
            f"Further than {_SURPRISING:g} standard deviations from the prior: "
            f"{', '.join(far)}. A model that lacks an effect bends others to replace it."
        )
    null = fit.information.null_directions()
    says += [f"Not identifiable from these records: {words}." for words in null]
    bounds = [
        name
        for name, value in fit.values.items()
        if not fit.model.parameter(name).lower < value < fit.model.parameter(name).upper
    ]
    if bounds:
        says.append(f"At a bound, so without a valid interval: {', '.join(bounds)}.")
    return tuple(says)


def _estimates(fit: Fit) -> Section:
    rows = []
    for name, value in fit.values.items():
        parameter, error = fit.model.parameter(name), fit.std_errors[name]
        low, high = fit.interval(name)
        prior = "" if parameter.prior_mean is None else f"{parameter.prior_mean:.4g}"
        if parameter.prior_spread is not None:
            prior += f" ± {TWO_SIDED_95 * parameter.prior_spread:.2g}"
        share = f"{100 * error / abs(value):.2g} %" if value and np.isfinite(error) else ""
        interval = f"{low:.4g} to {high:.4g}" if np.isfinite(error) else "unbounded"
        rows.append((name, f"{value:.5g}", f"{error:.2g}", share, interval, prior, parameter.unit))
    headers = (
        "parameter", "value", "std. error", "relative", "95 % interval", "prior ± (95 %)", "unit",
    )  # fmt: skip
    figure, axes = new_figure(1, 1, size=(7.6, 1.3 + 0.34 * len(fit.names)))
    plot_intervals(fit, ax=axes[0, 0])
    pictures = [
        Picture.of(
            figure,
            "Estimates with 95 % intervals, divided by the prior (grey bars), or by "
            "themselves where nothing was.",
        )
    ]
    if len(fit.names) > 1:
        size = 2.0 + 0.42 * len(fit.names)
        figure, axes = new_figure(1, 1, size=(size + 0.8, size))
        plot_correlation(fit, ax=axes[0, 0])
        pictures.append(
            Picture.of(
                figure,
                "Correlation of the estimates. Two that are close to ±1 can be told apart only "
                "by other manoeuvres.",
            )
        )
    table = Table(headers, tuple(rows))
    return Section("Estimates", tables=(table,), pictures=tuple(pictures))


def record_sections(fit: Fit, *, style: int = 0) -> tuple[Section, ...]:
    """Data and model of each record, at most eight."""
    pictures = tuple(
        Picture.of(
            figure_fit(fit, index, style=style),
            f"{name}: dots are measured, the line is the model and its band holds 95 % of the "
            "noise around it. Right: measured minus model, with the band of the noise.",
        )
        for index, name in enumerate(fit.dataset.names[:_MAX_RECORDS])
    )
    rest = len(fit.dataset) - len(pictures)
    words = (f"{rest} further records are not drawn.",) if rest > 0 else ()
    return (Section("Records", words, pictures=pictures),)


def _steps_of(fit: Fit) -> str:
    """What is tested for independence: residuals, or innovations where random forces act."""
    return "samples" if fit.innovations is None else "innovations"


def residual_section(fit: Fit, *, style: int = 0) -> Section:
    """Size and colour of what the model leaves."""
    effective = fit.effective_samples()
    tests = fit.whiteness()
    rows = []
    for output, sigma, estimated in zip(
        fit.model.outputs, fit.sigma, fit.sigma_estimated, strict=True
    ):
        independent, total = effective[output.name]
        if not total and fit.tests_alone:
            continue
        factor, unit = shown_unit(output.unit)
        white = sum(test.is_white for test in tests[output.name])
        rows.append(
            (
                output.name,
                f"{factor * fit.rms[output.name]:.3g}",
                f"{factor * sigma:.3g} {'estimated' if estimated else 'declared'}",
                f"{fit.rms[output.name] / sigma:.3g}",
                f"{independent:.0f} of {total}",
                f"{white} of {len(tests[output.name])}",
                unit,
            )
        )
    headers = (
        "output", "rms residual", "noise", "ratio", f"independent {_steps_of(fit)}",
        "white in records", "unit",
    )  # fmt: skip
    words: tuple[str, ...] = ()
    if fit.innovations is not None:
        words = (
            "Random forces were estimated with the parameters. The table counts independent "
            "innovations, measured less expected from all earlier samples; the pictures show "
            "residuals, measured less the model running on its own.",
        )
    picture = Picture.of(
        figure_whiteness(fit, style=style),
        "Autocorrelation of the residuals, one line per record. White noise stays inside the "
        "grey band; slow curves are physics or sensor dynamics that the model lacks.",
    )
    return Section("Residuals", words, tables=(Table(headers, tuple(rows)),), pictures=(picture,))


def _surprise(fit: Fit, name: str) -> float:
    """Distance of an estimate from its prior mean, in standard deviations of the prior."""
    parameter = fit.model.parameter(name)
    if parameter.prior_spread is None or parameter.prior_mean is None:
        return 0.0
    return abs(fit.values[name] - parameter.prior_mean) / parameter.prior_spread


def _effective(fit: Fit) -> float:
    return sum(independent for independent, _ in fit.effective_samples().values())
