"""The report on a designed experiment."""

from __future__ import annotations

import numpy as np

from oed_sysid.design import Design
from oed_sysid.results.design_plots import figure_design
from oed_sysid.results.page import Page, Picture, Section


def design_page(design: Design, *, title: str = "") -> Page:
    """Compose the report on a design: what it will tell, commands, motion, sea-trial card."""
    motion = Picture.of(
        figure_design(design),
        "Left: commands and the motion that the model predicts, with their limits. Right: expected "
        "relative standard errors before, after the design, and after zigzags.",
    )
    best, worst = np.nanargmin(design.relative_errors), np.nanargmax(design.relative_errors)
    errors = design.relative_errors
    return Page(
        title=title or design.model.name,
        subtitle=f"Experiment {design.experiment.name!r}, criterion {design.criterion}",
        verdict=(
            *_verdict(design),
            "Limits reached: " + ("; ".join(design.active) or "none") + ".",
        ),
        numbers=(
            ("length", f"{design.experiment.duration:g} s"),
            (f"std. error, best: {design.names[best]}", f"{100 * errors[best]:.2g} %"),
            (f"std. error, worst: {design.names[worst]}", f"{100 * errors[worst]:.2g} %"),
        ),
        sections=(
            Section("What to run, and what it will tell", pictures=(motion,)),
            Section("Sea-trial card", listing=design.sea_trial_card()),
        ),
    )


def _verdict(design: Design) -> list[str]:
    says = []
    if design.assurance is not None and not design.assurance.is_safe:
        says.append(design.assurance.danger)
    for reference in design.references:
        mean, worst = design.gain(reference)
        note = f" ({reference.note})" if reference.note else ""
        says.append(
            f"Against a {reference.name}{note} of the same length, errors are {mean:.3g} times "
            f"smaller on geometric mean, {worst:.3g} times for the worst parameter."
        )
    for (first, second), misfit in design.misfits.items():
        enough = "" if misfit > 16 else ", which is not enough to decide"
        says.append(
            f"If {first} is true, {second} is expected to fit worse by {misfit:.3g} in twice the "
            f"log-likelihood{enough}."
        )
    return says
