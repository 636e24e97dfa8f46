"""What a check of these signals cannot tell, in sentences."""

from __future__ import annotations

from oed_sysid.evidence.discrete import positions_of, velocities_of
from oed_sysid.evidence.relations import Relation
from oed_sysid.evidence.traces import Trace
from oed_sysid.physics.model import Model


def unchecked(
    model: Model, relations: tuple[Relation, ...], traces: list[Trace]
) -> tuple[str, ...]:
    """Sentences about what the equations leave open."""
    units = {n: u for trace in traces for n, u in trace.units.items()}
    related = {n for r in relations for n in (r.target, *r.signals)}
    alone = [n for n in model.output_names if n in units and n not in related]
    said = []
    if alone:
        said.append(f"No equation without unknown parameters relates {', '.join(alone)}.")
    if not relations:
        return tuple(said)
    targets = [r.target for r in relations if r.is_rate]
    said.append(f"Constant offsets of {', '.join(targets)}, and a delay common to all signals.")
    angles = [r for r in relations if units.get(r.target) == "rad" and len(r.signals) == 1]
    positions, velocities = positions_of(relations, units), velocities_of(relations, units)
    lonely = [
        r for r in angles
        if not any(r.target in other.signals for other in relations)
    ]  # fmt: skip
    for r in lonely:
        pair = f"{r.target} and {r.signals[0]}"
        said.append(f"Which of {pair} has a wrong sign, unit, scale or delay; both alike.")
    for r in (r for r in angles if r not in lonely):
        said.append(f"A wrong sign or unit that {r.target} and {r.signals[0]} share in full.")
    if positions:
        said.append(
            f"The sign of {', '.join(positions)} against those of {', '.join(velocities)} together."
        )
        said.append("A bias of an attitude angle against a misalignment of the velocities.")
        said.append("At a single speed: a bias of a velocity against its scale.")
    if len(positions) > 1:
        said.append("On straight runs: a current against a bias of the velocities.")
    return tuple(said)
