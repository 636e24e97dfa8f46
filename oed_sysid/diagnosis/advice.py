"""What to believe of a search for missing physics, what not, and what to do next at sea."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from oed_sysid.diagnosis.rank import Ranking

# Invisible candidates that are named.
NAMED = 6


def advice(
    steps: Sequence[Any],
    ranking: Ranking,
    parameters: Sequence[Mapping[str, Any]],
    *,
    explained: bool,
    commanded: bool = True,
) -> list[str]:
    """Sentences for whoever goes to sea again.

    Parameters
    ----------
    steps : sequence of :class:`oed_sysid.diagnosis.improvement.Step`
    ranking : Ranking
        Of the first round: all candidates.
    parameters : sequence of mapping
        ``name``, ``value``, ``std_error`` and ``unit`` of every estimate.
    explained : bool
        Whether what remains is noise.
    commanded : bool
        Whether the model has inputs, so that a manoeuvre can be designed.
    """
    known = {score.effect.name: score.effect for score in ranking.scores}
    estimates = {row["name"]: row for row in parameters}
    believe, doubt, sea = [], [], []
    for step in steps:
        sizes = [_size(estimates[p.name]) for p in step.effect.parameters if p.name in estimates]
        tested = not np.isnan(step.test_gain)
        rivals = step.group[1:]
        what = " or ".join(step.group) if rivals else step.added
        believe.append(
            f"{what} is missing{', the untouched records agree' if tested else ''}"
            + (f": {', '.join(sizes)}." if sizes and not rivals else ".")
        )
        if rivals:
            doubt.append(
                f"that it is {step.added} ({', '.join(sizes)}): {', '.join(rivals)} "
                f"{'does' if len(rivals) == 1 else 'do'} as well."
            )
            sea += _manoeuvre(step.group, known, commanded)
        if not tested:
            doubt.append(f"{step.added} before an untouched record has confirmed it.")
    hidden = sorted(set(ranking.undetectable()) - {step.added for step in steps})
    if hidden:
        more = f" and {len(hidden) - NAMED} more" if len(hidden) > NAMED else ""
        doubt.append(
            f"that {', '.join(hidden[:NAMED])}{more} {'is' if len(hidden) == 1 else 'are'} absent: "
            f"{'its' if len(hidden) == 1 else 'their'} typical size would not show here."
        )
    if not explained:
        doubt.append("standard errors of the parameters: more is missing than was found.")
    return [
        *_listed("Believe", believe),
        *_listed("Do not believe", doubt),
        *_listed("Next at sea", list(dict.fromkeys(sea))),
    ]


def _manoeuvre(group: Sequence[str], known: Mapping[str, Any], commanded: bool) -> list[str]:
    """What tells the members of a group apart."""
    needs = {known[name].needs for name in group if name in known and known[name].needs}
    lines = []
    if needs:
        lines.append(f"to tell {' from '.join(group[:3])}: {'; '.join(sorted(needs))}.")
    if commanded:
        names = " ".join(name for name in group if name in known)
        lines.append(f"a manoeuvre for it: oed-sysid design PROBLEM --discriminate {names}")
    return lines


def _size(row: Mapping[str, Any]) -> str:
    unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
    return f"{row['name']} = {row['value']:.3g} +/- {row['std_error']:.2g}{unit}"


def _listed(title: str, lines: Sequence[str]) -> list[str]:
    return [f"{title}:", *(f"  - {line}" for line in lines)] if lines else []
