r"""How surely an experiment keeps its limits when parameters, structure and sea are uncertain.

Of :math:`n` vehicles drawn from what is known, each in waves of its own where any are expected,
:math:`k` keep all limits. Stated are the share and the lower end of its one-sided 95 % interval
(Clopper & Pearson),

.. math:: \hat p = k / n, \qquad \sum_{i=k}^n \binom ni p_-^i (1 - p_-)^{n-i} = 0.05

A limit says where the vehicle must not be; an *abort rule* says when the crew stops, before that:
at nine tenths of the way from the start to a limit (:math:`x_0 + 0.9\,(l - x_0)`), or, for
attitude, depth and speed without a limit, a tenth of the width outside the range that all but the
most extreme vehicles stay within. How often each would fire is counted on the same vehicles.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import betaincinv

from oed_sysid.compiled.kernels import kernel
from oed_sysid.design.caution import Guards
from oed_sysid.design.corridor import Corridor
from oed_sysid.design.robust import draw_structures
from oed_sysid.display import as_dict
from oed_sysid.errors import DesignError, OedSysidError
from oed_sysid.experiment import Experiment, Limits
from oed_sysid.information import Information
from oed_sysid.model import Model
from oed_sysid.noise.model import NoiseModel
from oed_sysid.noise.realisation import at_sea
from oed_sysid.sensitivity.sea import sea_words
from oed_sysid.simulation import Trajectory, simulate, simulate_inputs

_CONFIDENCE = 0.95
# Below this probability of keeping the limits a run is not safe, if none was asked for.
_SAFE = 0.9
# Ranges of the motion that are stated leave out this share of the vehicles at either end.
_TAIL = 0.025
# Part of the way from the start to a limit at which a run is stopped, and, of the width of the
# stated range, what an attitude, depth or speed without a limit may exceed it by.
_STOP, _BEYOND = 0.9, 0.1
# What a crew watches: attitude, depth, speed.
WATCHED = ("phi", "theta", "z", "u")


@dataclass(frozen=True)
class AbortRule:
    """When the crew stops a run.

    Attributes
    ----------
    signal : str
    lower, upper : float
        Stop outside; infinite for none.
    fires : float
        Share of the simulated vehicles on which it would.
    limited : bool
        Whether it stands before a limit; otherwise outside what is expected.
    """

    signal: str
    lower: float
    upper: float
    fires: float
    limited: bool

    to_dict = as_dict("signal", "lower", "upper", "fires", "limited")


@dataclass(frozen=True, eq=False)
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
    rules : tuple of AbortRule
        Where the crew stops, and how often it would.
    any_fires : float
        Share of the vehicles on which one rule or more fires.
    kept : ndarray of bool (n_checked,)
        On which of the vehicles all limits were kept, in the order they were given or drawn.
    """

    n_kept: int
    n_checked: int
    wanted: float | None
    spread: float | None
    left: Mapping[str, int]
    ranges: Mapping[str, tuple[float, float]]
    limited: bool
    waves: str = ""
    rules: tuple[AbortRule, ...] = ()
    any_fires: float = 0.0
    kept: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool), repr=False)

    @property
    def is_safe(self) -> bool:
        """Whether the limits hold as surely as was asked for, or on nine vehicles of ten."""
        return not self.limited or self.probability >= (self.wanted or _SAFE)

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

    @property
    def danger(self) -> str:
        """What stands first and in red where limits are likely to be left; empty where not."""
        if self.is_safe:
            return ""
        return (
            f"DANGER: on {1 - self.probability:.0%} of the vehicles that are possible "
            f"({self.drawn}) this run leaves its limits."
        )

    to_dict = as_dict(
        "n_kept", "n_checked", "at_least", "wanted", "spread", "left", "waves", "ranges",
        abort_rules="rules", any_rule_fires="any_fires",
    )  # fmt: skip


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
    others: Sequence[Model] = (),
    vehicles: Sequence[Model] | None = None,
) -> Assurance:
    """Simulate an experiment on vehicles whose coefficients are not the nominal ones.

    Parameters
    ----------
    model : Model
        The nominal vehicle.
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
    others : sequence of Model
        Other structures that remain possible; the vehicles are drawn from all in turn.
    vehicles : sequence of Model, optional
        Simulate these, drawn before; several runs are then judged on the same vehicles.

    Returns
    -------
    Assurance
    """
    n_vehicles = n_vehicles if vehicles is None else len(vehicles)
    if n_vehicles < 20:
        raise DesignError(f"{n_vehicles} vehicles tell no probability. Give 20 or more.")
    fresh = (
        draw_structures(model, others, spread, n_vehicles, prior, rng)
        if vehicles is None
        else tuple(vehicles)
    )
    corridor = Corridor.of(model, limits or experiment.limits, {}, kernel(model).n_full)
    own = np.array([experiment.initial.get(n, 0.0) for n in model.state_names])
    guards = Guards(fresh, experiment.times, np.array([0]), own, corridor)
    free = replace(experiment, limits=Limits())
    names = tuple(dict.fromkeys((*model.state_names, *model.output_names)))
    extremes: list[np.ndarray] = []
    kept, left = np.zeros(n_vehicles, dtype=bool), Counter[str]()
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
        kept[index] = first is None
        if first is not None:
            left[first] += 1
    ranges: dict[str, tuple[float, float]] = {}
    rules: tuple[AbortRule, ...] = ()
    stopped = 0.0
    if extremes:
        ends = np.array(extremes)
        low = np.quantile(ends[:, :, 0], _TAIL, axis=0)
        high = np.quantile(ends[:, :, 1], 1 - _TAIL, axis=0)
        ranges = {n: (float(a), float(b)) for n, a, b in zip(names, low, high, strict=True)}
        rules, stopped = _rules(experiment, corridor, names, ranges, ends, n_vehicles)
    return Assurance(
        int(kept.sum()), n_vehicles, wanted, spread, dict(left), ranges, bool(corridor.names),
        sea_words(sea) if sea is not None and in_waves else "", rules, stopped, kept,
    )  # fmt: skip


def _rules(
    experiment: Experiment,
    corridor: Corridor,
    names: Sequence[str],
    ranges: Mapping[str, tuple[float, float]],
    ends: np.ndarray,
    n_vehicles: int,
) -> tuple[tuple[AbortRule, ...], float]:
    """Abort rules, and the share of the vehicles on which any of them fires.

    ``ends`` are lowest and highest values ``(n_finite, n_names, 2)``; vehicles that diverged fire
    every rule.
    """
    diverged = n_vehicles - len(ends)
    found, any_fires = [], np.zeros(len(ends), dtype=bool)
    bounds = {
        name: (corridor.lower[i], corridor.upper[i])
        for i, name in enumerate(corridor.names)
        if not corridor.at_end[i]
    }
    for name in dict.fromkeys((*bounds, *(n for n in WATCHED if n in names))):
        if name in bounds:
            first = experiment.initial.get(name, 0.0)
            lower, upper = (first + _STOP * (bound - first) for bound in bounds[name])
        else:
            low, high = ranges[name]
            room = _BEYOND * max(high - low, 1e-9)
            lower, upper = low - room, high + room
        column = ends[:, list(names).index(name)]
        outside = (column[:, 0] < lower) | (column[:, 1] > upper)
        any_fires |= outside
        share = float((outside.sum() + diverged) / n_vehicles)
        found.append(AbortRule(name, float(lower), float(upper), share, name in bounds))
    return tuple(found), float((any_fires.sum() + diverged) / n_vehicles)


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
