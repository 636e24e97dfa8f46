"""Records that were sampled alike."""

from __future__ import annotations

from collections.abc import Sequence

from oed_sysid.data.dataset import Record

# Share by which sample times may differ that are one.
SAME_SAMPLING = 0.01


def sampled_alike(records: Sequence[Record]) -> list[list[int]]:
    """Places of the records, grouped by sample time: colour is estimated in samples."""
    groups: list[tuple[float, list[int]]] = []
    for index, record in enumerate(records):
        for sample_time, members in groups:
            if abs(record.sample_time - sample_time) < SAME_SAMPLING * sample_time:
                members.append(index)
                break
        else:
            groups.append((record.sample_time, [index]))
    return [members for _, members in groups]
