"""What shapes an improvement, so that a later call finds the steps of one that did not end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood.archive import encode
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.runtime.journal import Journal


def opened(
    journal: Journal | None,
    model: Model,
    train: Dataset,
    validation: Dataset | None,
    candidates: Sequence[Effect],
    settings: Mapping[str, Any],
) -> Journal:
    """Open a journal for one improvement.

    Parameters
    ----------
    journal : Journal or None
        None keeps nothing.
    model : Model
    train, validation : Dataset
    candidates : sequence of Effect
    settings : mapping
        Further arguments of :func:`~oed_sysid.evidence.improve.improve`.

    Returns
    -------
    Journal
        With steps of an earlier call with equal content, if there was one.
    """
    keep = journal or Journal()
    if keep.folder is None:
        return keep
    content = {
        "task": "improve",
        "model": encode(model),
        "candidates": [encode(effect) for effect in candidates],
        "train": [[record.name, record.content_hash] for record in train],
        "validation": [[record.name, record.content_hash] for record in validation or ()],
        **settings,
    }
    keep.open(content, shared={"train": train, "validation": validation})
    return keep
