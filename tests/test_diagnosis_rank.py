"""Which candidates count as one with the best."""

from __future__ import annotations

import numpy as np

from oed_sysid import Force, Parameter
from oed_sysid.evidence.rank import Ranking
from oed_sysid.evidence.score import Score


def score(name: str, statistic: float, signature: np.ndarray) -> Score:
    """Score of a candidate with one amplitude."""
    effect = Force(name, {"X": f"E_{name}"}, (Parameter(f"E_{name}", 0.0, "N", scale=1.0),))
    amplitude = {f"E_{name}": 1.0}
    return Score(effect, statistic, 1, amplitude, amplitude, 0.5, signature[:, np.newaxis])


def test_a_candidate_that_was_not_refitted_joins_the_group_if_its_signature_is_the_same() -> None:
    """At a correlation of 0.995 two effects are one to the records; at 0.8 they are not."""
    rng = np.random.default_rng(0)
    first, other = np.linalg.qr(rng.standard_normal((200, 2)))[0].T
    ranking = Ranking(
        (
            score("drag", 40.0, first),
            score("alike", 39.0, -3.0 * (0.995 * first + np.sqrt(1 - 0.995**2) * other)),
            score("related", 30.0, 0.8 * first + 0.6 * other),
            score("absorbed", 0.0, 0.0 * first),
        ),
        (),
        first,
    )
    assert ranking.alike("drag") == ("alike",)
    assert set(ranking.alike("drag", 0.5)) == {"alike", "related"}
