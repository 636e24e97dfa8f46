"""Corrected copies of records: what was found is undone, and said."""

from __future__ import annotations

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.corrections import corrected
from oed_sysid.evidence.relations import relations
from oed_sysid.evidence.result import Correction, LogCheck
from oed_sysid.experiments.problem import Problem
from oed_sysid.physics.model import Model

# A current is no fault of the log, and what stands for a dead sensor nobody knows.
LEFT_ALONE = ("drift", "duplicate", "gap", "clock")


def corrected_copies(
    dataset: Dataset, problem: Problem | Model, found: LogCheck
) -> tuple[Dataset, tuple[str, ...]]:
    """Return copies of records with the findings undone, and what was done in sentences.

    Bad samples become missing ones; faults with several explanations are undone by the first of
    them. Records that a finding calls a copy, clocks and currents are left as they are, and a
    sensor that is dead in a record counts as not measured there. Where an equation stays
    unexplained with the findings undone, only the bad samples are left out: signs, units and sizes
    that make the rest agree a little better may answer the wrong question
    (:func:`why_not_more`).

    Parameters
    ----------
    dataset : Dataset
        The records that were checked.
    problem : Problem or Model
        As given to :func:`~oed_sysid.evidence.check`.
    found : LogCheck
        Its result.

    Returns
    -------
    copies : Dataset
    done : tuple of str
    """
    model = problem.model if isinstance(problem, Problem) else problem
    mine = {*dataset.channels.output_names, *dataset.channels.input_names}
    fixes: list[Correction] = []
    done = []
    doubtful = found.named("unexplained") is not None
    for one in found.findings:
        fix = one.correction
        if fix is None or (doubtful and fix.kind != "blank"):
            continue
        if one.kind in LEFT_ALONE or not set(fix.signals) <= mine:
            continue
        fixes.append(fix)
        done.append(one.says)
    if not fixes:
        return dataset, ()
    return corrected(dataset, fixes, relations(model)), tuple(done)


def why_not_more(found: LogCheck) -> str:
    """Return why faults that were found are not undone in the copies; empty if they are.

    Parameters
    ----------
    found : LogCheck
        Result of :func:`~oed_sysid.evidence.check`.
    """
    open_ones = [one for one in found.findings if one.kind == "unexplained"]
    left = [
        one.name
        for one in found.findings
        if one.correction is not None and one.correction.kind != "blank"
        if one.kind not in LEFT_ALONE
    ]
    if not open_ones:
        return ""
    size = open_ones[0].size or 0.0
    what = f"{', '.join(left)} is left as logged" if left else "nothing but bad samples is changed"
    return (
        f"{what}: with all findings undone an equation of {open_ones[0].signals[0]} still leaves "
        f"{100.0 * size:.0f} % unexplained, so that no correction can be relied on; mend that first"
    )
