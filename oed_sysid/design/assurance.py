"""How surely an experiment keeps its limits when the parameters are uncertain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import betaincinv

from oed_sysid.compiled.kernels import kernel
from oed_sysid.design.caution import Guards
from oed_sysid.design.corridor import Corridor
from oed_sysid.design.robust import draw_models
from oed_sysid.errors import DesignError, OedSysidError
from oed_sysid.experiment import Experiment, Limits
from oed_sysid.information import Information
from oed_sysid.model import Model
from oed_sysid.noise.model import NoiseModel
from oed_sysid.noise.realisation import at_sea
from oed_sysid.sensitivity.sea import sea_words
from oed_sysid.simulation import Trajectory, simulate, simulate_inputs

_CONFIDENCE = 0.95
# Ranges of the motion that are stated leave out this share of the vehicles at either end.
_TAIL = 0.025


@dataclass(frozen=True)
class Assurance:
    """On how many vehicles with other coefficients an experiment keeps its limits.

    Attributes
    ----------
    n_kept, n_checked : int
    wanted : float or None
        Probability that was asked for, if any.
    spread : float or None
        Relative half-width of the uniform draws; None if drawn from what is known.
    left : mapping of str to int
        How often each limit was the first to be left; "diverged" for no motion at all.
    ranges : mapping of str to (lowest, highest)
        Of every state and output, what all but the most extreme vehicles stay
        within (2.5 per cent left out at either end).
    limited : bool
        Whether there is any limit on the motion.
    waves : str
        Random forces that every vehicle met, in words; empty for none.
    """

    n_kept: int
    n_checked: int
    wanted: float | None
    spread: float | None
    left: Mapping[str, int]
    ranges: Mapping[str, tuple[float, float]]
    limited: bool
    waves: str = ""

    @property
    def probability(self) -> float:
        """Share of vehicles on which all limits were kept."""
        return self.n_kept / self.n_checked

    @property
    def at_least(self) -> float:
        """Lower end of the probability's one-sided 95 per cent interval (Clopper, Pearson)."""
        if self.n_kept == 0:
            return 0.0
        return float(betaincinv(self.n_kept, self.n_checked - self.n_kept + 1, 1 - _CONFIDENCE))

    @property
    def drawn(self) -> str:
        """Which vehicles were simulated, in words."""
        waves = f" in waves ({self.waves})" if self.waves else ""
        if self.spread is not None:
            return f"coefficients off by up to {self.spread:.0%}{waves}"
        return f"coefficients drawn from what is known{waves}"

    def report(self) -> str:
        """Return the probability in words."""
        if not self.limited:
            return "no limit on the motion was given"
        words = (
            f"limits kept on {self.probability:.1%} of {self.n_checked} simulated vehicles with "
            f"{self.drawn} (at least {self.at_least:.1%} with 95 % confidence)"
        )
        if self.wanted is not None and self.probability < self.wanted:
            words += f", LESS than the {self.wanted:.0%} asked for"
        if self.left:
            words += "; left first: " + ", ".join(f"{n} ({c})" for n, c in self.left.items())
        return words

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "n_kept": self.n_kept,
            "n_checked": self.n_checked,
            "at_least": self.at_least,
            "wanted": self.wanted,
            "spread": self.spread,
            "left": dict(self.left),
            "waves": self.waves,
            "ranges": {name: list(pair) for name, pair in self.ranges.items()},
        }


def assess_limits(
    model: Model,
    experiment: Experiment,
    *,
    rng: np.random.Generator,
    limits: Limits | None = None,
    spread: float | None = 0.3,
    prior: Information | None = None,
    n_vehicles: int = 400,
    wanted: float | None = None,
    sea: NoiseModel | None = None,
) -> Assurance:
    """Simulate an experiment on vehicles whose coefficients are not those believed.

    Parameters
    ----------
    model : Model
        What is believed.
    experiment : Experiment
        Any; one that reacts closes its loop on every vehicle.
    rng : numpy.random.Generator
        Source of the vehicles.
    limits : Limits, optional
        By default those of the experiment.
    spread : float or None
        Relative half-width of uniform draws around the values; None draws from
        what is known (prior standard deviations, and ``prior``).
    prior : Information, optional
        Such as that of a fit.
    n_vehicles : int
    wanted : float, optional
        Probability that is asked for, for the words of the report.
    sea : NoiseModel, optional
        Random forces: every vehicle meets waves of its own.

    Returns
    -------
    Assurance
    """
    if n_vehicles < 20:
        raise DesignError(f"{n_vehicles} vehicles tell no probability. Give 20 or more.")
    fresh = draw_models(model, spread, n_vehicles, prior, rng)
    corridor = Corridor.of(model, limits or experiment.limits, {}, kernel(model).n_full)
    own = np.array([experiment.initial.get(n, 0.0) for n in model.state_names])
    guards = Guards(fresh, experiment.times, np.array([0]), own, corridor)
    free = replace(experiment, limits=Limits())
    names = tuple(dict.fromkeys((*model.state_names, *model.output_names)))
    extremes: list[np.ndarray] = []
    kept, left = 0, Counter[str]()
    in_waves = sea is not None and sea.has_forces
    for index, vehicle in enumerate(fresh):
        try:
            meant, planned = vehicle, free
            if sea is not None and in_waves:
                meant, planned = at_sea(vehicle, free, sea, rng=rng)
            commands = simulate(meant, planned, noise=False).inputs
            run = simulate_inputs(
                meant, experiment.times, inputs=commands, initial=experiment.initial
            )
        except OedSysidError:
            left["diverged"] += 1
            continue
        signals = [run.signal(name) for name in names]
        extremes.append(np.array([[s.min(), s.max()] for s in signals]))
        if in_waves:
            first = _first_left(corridor, run)
        else:
            first = guards.first_left(guards.run(index, commands))
        kept += first is None
        if first is not None:
            left[first] += 1
    ranges = {}
    if extremes:
        ends = np.array(extremes)
        low = np.quantile(ends[:, :, 0], _TAIL, axis=0)
        high = np.quantile(ends[:, :, 1], 1 - _TAIL, axis=0)
        ranges = {n: (float(a), float(b)) for n, a, b in zip(names, low, high, strict=True)}
    return Assurance(
        kept, n_vehicles, wanted, spread, dict(left), ranges, bool(corridor.names),
        sea_words(sea) if sea is not None and in_waves else "",
    )  # fmt: skip


def _first_left(corridor: Corridor, run: Trajectory) -> str | None:
    """Limit that a motion leaves first; None if it keeps all."""
    found: list[tuple[int, str]] = []
    for index, name in enumerate(corridor.names):
        if corridor.at_end[index]:
            continue
        values = run.signal(name)
        beyond = np.flatnonzero((values < corridor.lower[index]) | (values > corridor.upper[index]))
        if len(beyond):
            found.append((int(beyond[0]), name))
    return min(found)[1] if found else None
