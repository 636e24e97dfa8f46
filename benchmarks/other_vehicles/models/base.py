"""What a nominal model of a vehicle has to offer to the benchmark."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from oed_sysid import Model
from oed_sysid.physics import Effect


@dataclass(frozen=True)
class Nominal:
    """Model, candidates, and how hidden sizes read in their amplitudes.

    Attributes
    ----------
    model : callable
        ``(declared, lacking) -> Model``: noise levels declared or not, and without the
        effect named, if any.
    candidates : tuple of Effect
        What may be missing; a hidden effect has the same name here.
    part_of : dict
        Effects that the model usually has, which cases may leave out.
    """

    model: Callable[[bool, str | None], Model]
    candidates: tuple[Effect, ...]
    part_of: Mapping[str, Effect]

    def effects(self, lacking: str | None) -> tuple[Effect, ...]:
        """Candidates of a case whose nominal model lacks one of its usual parts."""
        if lacking is None:
            return self.candidates
        part = self.part_of[lacking]
        absent = part.with_values(dict.fromkeys(part.amplitude_names, 0.0))
        return (*self.candidates, absent)

    def effect(self, name: str) -> Effect:
        """One effect by name."""
        known = {e.name: e for e in (*self.candidates, *self.part_of.values())}
        return known[name]

    def values(self, name: str, sizes: Mapping[str, float]) -> dict[str, float]:
        """Amplitudes of an effect from the simulator's sizes, which stand in the same order.

        One amplitude for several keys (the lags of two propellers) has the size of the first.
        """
        return dict(zip(self.effect(name).amplitude_names, sizes.values(), strict=False))
