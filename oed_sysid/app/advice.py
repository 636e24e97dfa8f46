"""What to do next, chosen from the evidence: one step, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from oed_sysid.cli.study import Study

DATA, CHECK, FIT, FAILS = "Data", "Check the log", "Fit", "Where it fails"
MISSING, PLAN = "What is missing", "Plan the next trial"
REPORT, EXPORT = "Report", "Export"
PLANNED = ("design", "programme")


@dataclass(frozen=True)
class Advice:
    """The next step of a study.

    Parameters
    ----------
    page : str
        Title of the page.
    why : str
        The evidence, in one sentence.
    """

    page: str
    why: str


def following(study: Study, results: Mapping[str, Any]) -> Advice:
    """Return the next step.

    Parameters
    ----------
    study : Study
    results : mapping
        Outcomes of the tasks that were done on these records, by the names of their reports.

    Examples
    --------
    >>> following(Study.named("remus_diving_plane"), {}).page
    'Data'
    """
    if study.train is None:
        return Advice(DATA, "There is no training record yet: give files, or choose records.")
    if "check" not in results:
        return Advice(CHECK, "Before anything is fitted: do the signals agree with each other?")
    if "improve" in results:
        return _after_search(study, results)
    if "fit" not in results:
        if results["check"].result.suspect:
            return Advice(DATA, "The log is suspect: mend it, or leave the records out.")
        return Advice(FIT, "The signals agree: estimate the parameters.")
    return _after_fit(study, results["fit"])


def _after_fit(study: Study, fit: Any) -> Advice:
    """Whether anything is missing, by what the nominal model predicts."""
    if fit.comparison is None:
        return Advice(
            MISSING, "Without a validation record a claim stays a hint; choose one first."
        )
    best = fit.comparison.best
    error = f"whole validation runs are {best.relative:.3g} × noise off"
    if best.is_noise:
        return Advice(
            PLAN, f"Nothing seems to be missing ({error}): sharpen what is least certain."
        )
    return Advice(MISSING, f"The model misses something: {error}.")


def _after_search(study: Study, results: Mapping[str, Any]) -> Advice:
    """What a search leaves to do."""
    found = results["improve"].result
    if any(task in results for task in PLANNED):
        return Advice(EXPORT, "The next trial is planned: take the model and the report along.")
    alike = next((step.group for step in found.steps if len(step.group) > 1), ())
    if alike:
        return Advice(PLAN, f"These records cannot tell {' from '.join(alike[:3])}: a trial can.")
    if found.verdict == "missing" and found.remains.kind in ("adequate", "disturbance"):
        return Advice(EXPORT, "With what was found the model predicts all that is not noise.")
    if found.verdict == "nothing_missing":
        return Advice(EXPORT, "Nothing is missing that these records could show.")
    return Advice(PLAN, "More is missing than was found: plan a trial that shows it.")
