"""What shapes a design, so that a later call finds the steps of one that did not end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from oed_sysid.batch.journal import Journal
from oed_sysid.errors import DataError
from oed_sysid.fitting.archive import encode


def opened(journal: Journal | None, settings: Mapping[str, Any]) -> Journal:
    """Open a journal for one design.

    Parameters
    ----------
    journal : Journal or None
        None keeps nothing.
    settings : mapping of str to object
        Every argument that shapes the result.

    Returns
    -------
    Journal
        With steps of an earlier call with equal settings, if there was one. Settings of which
        equality cannot be told, such as a criterion that is no dataclass, keep nothing.
    """
    keep = journal or Journal()
    if keep.folder is None:
        return keep
    try:
        content = encode(dict(settings))
    except DataError:
        return Journal()
    keep.open({"task": "design", "settings": content})
    return keep
