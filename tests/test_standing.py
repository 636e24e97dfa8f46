"""When validation records agree with an effect."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from oed_sysid.evidence.search import confirmed


@pytest.mark.parametrize(
    ("gain", "excess", "distance", "agree"),
    [
        (3.0, 1.1, 9.0, True),  # more likely: that is enough
        (0.3, 3.0, 0.9, True),  # they could not tell, and training leaves no doubt
        (0.3, 1.5, 0.9, False),  # training does leave some
        (-0.6, 3.8, 0.7, True),
        (-2.5, 3.8, 0.7, False),  # less likely than chance
        (0.3, 3.0, 6.0, False),  # 36 +- 12 were expected
        (1.9, 2.1, 14.7, False),
    ],
)
def test_silence_is_no_contradiction(
    gain: float, excess: float, distance: float, agree: bool
) -> None:
    """An effect that validation records do not move need not gain there."""
    study = SimpleNamespace(validation=(), apart=lambda *_: distance)
    fit = SimpleNamespace()
    assert confirmed(study, fit, fit, gain, excess) == agree  # type: ignore[arg-type]
