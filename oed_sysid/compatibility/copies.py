"""Corrected copies of records: what was found is undone, and said."""

from __future__ import annotations

from oed_sysid.compatibility.corrections import corrected
from oed_sysid.compatibility.relations import relations
from oed_sysid.compatibility.result import Correction, LogCheck
from oed_sysid.data.dataset import Dataset
from oed_sysid.model import Model
from oed_sysid.problem import Problem

# A current is no fault of the log, and what stands for a dead sensor nobody knows.
LEFT_ALONE = ("drift", "duplicate", "gap", "clock")


def corrected_copies(
    dataset: Dataset, problem: Problem | Model, found: LogCheck
) -> tuple[Dataset, tuple[str, ...]]:
    """Return copies of records with the findings undone, and what was done in sentences.

    Bad samples become missing ones; faults with several explanations are undone by the first of
    them. Records that a finding calls a copy, clocks and currents are left as they are, and a
    sensor that is dead in a record counts as not measured there.

    Parameters
    ----------
    dataset : Dataset
        The records that were checked.
    problem : Problem or Model
        As given to :func:`~oed_sysid.compatibility.check`.
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
    for one in found.findings:
        fix = one.correction
        if fix is None or one.kind in LEFT_ALONE or not set(fix.signals) <= mine:
            continue
        fixes.append(fix)
        done.append(one.says)
    if not fixes:
        return dataset, ()
    return corrected(dataset, fixes, relations(model)), tuple(done)
