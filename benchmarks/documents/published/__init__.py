"""Numbers of `docs/published.md`: what five papers claim, and what their problems give here."""

from benchmarks.documents.page import Page, paper
from benchmarks.documents.published import auv, nomoto, sailboat, tanker, torpedo

__all__ = ["PAGE", "paper"]

PAGE = Page(
    "published",
    {
        "auv": auv.zigzag,
        "auv_excitations": auv.excitations,
        "nomoto": nomoto.without_noise,
        "nomoto_noise": nomoto.with_noise,
        "tanker": tanker.simulated,
        "tanker_cost": tanker.cost,
        "tanker_measured": tanker.measured,
        "sailboat": sailboat.derivatives,
        "sailboat_coverage": sailboat.coverage,
        "sailboat_speed": sailboat.speed,
        "torpedo": torpedo.allowed,
        "torpedo_swarm": torpedo.swarm,
        "torpedo_500_hz": torpedo.fast,
    },
)
