r"""Steps of a clock: times that jump although the vehicle does not.

Over a gap of the times from :math:`t_i` to :math:`t_{i+1}` each equation
:math:`\dot y = f` predicts the change :math:`f\,(t_{i+1} - t_i)`. If the signals change as if only
one usual step had passed, the clock was set and no time is missing.
"""

from __future__ import annotations

import numpy as np

from oed_sysid.evidence.relations import Relation
from oed_sysid.evidence.result import Finding
from oed_sysid.evidence.traces import Trace

JUMP = 2.5
WRONG, RIGHT = 8.0, 4.0


def clock_findings(traces: list[Trace], relations: tuple[Relation, ...]) -> list[Finding]:
    """Gaps in time over which the signals contradict the clock."""
    result = []
    for trace in traces:
        steps = np.diff(trace.times)
        for k in np.flatnonzero(steps > JUMP * trace.step):
            if _contradicts(trace, relations, int(k)):
                result.append(
                    Finding(
                        "clock",
                        (),
                        (trace.name,),
                        f"the clock jumps by {steps[k]:.3g} s at t = {trace.times[k]:.6g} s, but "
                        f"the signals go on as if {trace.step:.3g} s had passed.",
                        "the model runs on through time that did not pass",
                        f"take {steps[k] - trace.step:.6g} s off all later times",
                        True,
                        size=float(steps[k] - trace.step),
                        unit="s",
                    )
                )
    return result


def _contradicts(trace: Trace, relations: tuple[Relation, ...], k: int) -> bool:
    """Whether the changes over a gap agree with a usual step, and not with the clock's."""
    by_clock, by_step = 0.0, 0.0
    span = trace.times[k + 1] - trace.times[k]
    for relation in relations:
        names = (relation.target, *relation.signals)
        if not relation.is_rate or any(name not in trace.values for name in names):
            continue
        rows = slice(max(k - 4, 0), k + 6)
        here = {name: trace.values[name][rows] for name in relation.signals}
        target = trace.values[relation.target]
        ends = (target[max(k - 4, 0) : k + 1], target[k + 1 : k + 6])
        if any(not np.isfinite(v).all() for v in (*here.values(), *ends)) or len(ends[1]) < 5:
            continue
        rate = float(np.mean(relation(here, trace.times[rows])))
        # Means of five samples on either side, five usual steps apart beside the gap.
        change = float(np.mean(ends[1]) - np.mean(ends[0]))
        noise = trace.noise[relation.target] * np.sqrt(2.0 / 5.0) + 0.02 * abs(rate) * span
        noise += 1e-9 + 1e-3 * abs(change)
        sides = 4.0 * trace.step
        by_clock = max(by_clock, abs(change - rate * (span + sides)) / noise)
        by_step = max(by_step, abs(change - rate * (trace.step + sides)) / noise)
    return by_clock > WRONG and by_step < RIGHT
