r"""What a run does on vehicles that are possible: limits kept, sea room, accuracy.

**Limits.** Of :math:`n` vehicles drawn from what is known, each in waves of its own where any are
expected, :math:`k` keep all limits. Stated are the share and the lower end of its one-sided 95 %
interval (Clopper & Pearson),

.. math:: \hat p = k / n, \qquad \sum_{i=k}^n \binom ni p_-^i (1 - p_-)^{n-i} = 0.05

A limit says where the vehicle must not be; an *abort rule* says when the crew stops, before that:
at nine tenths of the way from the start to a limit (:math:`x_0 + 0.9\,(l - x_0)`), or, for
attitude, depth and speed without a limit, a tenth of the width outside the range that all but the
most extreme vehicles stay within. How often each would fire is counted on the same vehicles.

**Tracks.** Of the nominal vehicle and of others drawn from what is known, in waves where any are
expected, the track is a state of the model (``x``, ``y``) or follows from its velocities,

.. math::
    \dot x = u \cos\psi - v \sin\psi, \quad \dot y = u \sin\psi + v \cos\psi
    \qquad\text{or}\qquad \dot x = u \cos\theta + w \sin\theta

in the horizontal plane from the start (x ahead, y to starboard), or along the course with depth
beneath it. The sea room is the box that all but a share of the vehicles stay within,

.. math:: [\,Q_{\alpha/2}(\min_t x),\; Q_{1 - \alpha/2}(\max_t x)\,]

and the same across, :math:`\alpha` being 5 %. A steady current is not in it: add its speed times
the length of the run.

**Accuracy.** The bound belongs to one set of values. On vehicles a few per cent off, realised
errors are 0.65 to 1.8 times those stated, so the bound is taken on vehicles drawn from what
is known as well,

.. math:: s_i(\theta) = \sqrt{[F(\theta)^{-1}]_{ii}}, \qquad \theta \sim p(\theta)

and the range is stated. Beyond ``TRUSTED`` a linear bound
under disturbance forces promises too much (calm fins with stated errors of 30 to 80 per cent
realised 3.4 times more), so that no number is given there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import isqrt

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.special import ndtr

from oed_sysid.design.criteria import SAYS, SURE
from oed_sysid.design.vehicles import (
    DOUBT,
    LimitBounds,
    at_least,
    draw_models,
    in_doubt,
    in_own_waves,
    motion,
    percent,
)
from oed_sysid.errors import DesignError, OedSysidError, respelled
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.simulation import Trajectory
from oed_sysid.information.bound import information_of
from oed_sysid.information.identifiability import ASSUMED
from oed_sysid.information.noise import Levels, sea_words
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import IMMATERIAL
from oed_sysid.runtime.display import TWO_SIDED_95, as_dict
from oed_sysid.runtime.parallel import run_cells

NO_LIMIT = "no limit on the motion was given"
# Ranges of the motion that are stated leave out this share of the vehicles at either end.
_TAIL = float(ndtr(-TWO_SIDED_95))
# What a crew watches: attitude, depth, speed.
WATCHED = ("phi", "theta", "z", "u")
# Relative error up to which a bound under disturbance forces is taken as it is, and a coefficient
# counts as told: what is assumed of one of which nothing is known.
TRUSTED = ASSUMED


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

    Examples
    --------
    >>> rule = AbortRule("z", -np.inf, 24.0, fires=0.02, limited=True)
    >>> rule.signal, rule.upper
    ('z', 24.0)
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
        Disturbance forces that every vehicle met, in words; empty for none.
    rules : tuple of AbortRule
        Where the crew stops, and how often it would.
    any_fires : float
        Share of the vehicles on which one rule or more fires.
    kept : ndarray of bool (n_checked,)
        On which of the vehicles all limits were kept, in the order they were given or drawn.
    doubted : ndarray of bool (n_checked,)
        Which of them were drawn as if priors were :data:`~oed_sysid.design.vehicles.DOUBT` times
        too narrow; empty or none where nothing rests on priors.
    tracks : PredictedTracks or None
        Where they go; None where the model knows no course: neither ``x`` and ``y``, nor surge with
        heading or pitch.

    Examples
    --------
    >>> told = Assurance(396, 400, 0.95, 0.3, {"z": 4}, {}, limited=True)
    >>> told.is_safe
    True
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
    doubted: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool), repr=False)
    tracks: PredictedTracks | None = field(default=None, repr=False)

    @classmethod
    def joint(cls, found: Iterable[Assurance]) -> Assurance:
        """Return how surely all of several runs, judged on the same vehicles, keep their limits."""
        limited = [one for one in found if one.limited]
        kept = np.all([one.kept for one in limited] or [np.ones(1, dtype=bool)], axis=0)
        wanted = max((one.wanted for one in limited if one.wanted), default=None)
        doubted = limited[0].doubted if limited else np.zeros(1, dtype=bool)
        return cls(
            int(kept.sum()), len(kept), wanted, None, {}, {}, bool(limited), kept=kept,
            doubted=doubted,
        )  # fmt: skip

    @property
    def is_safe(self) -> bool:
        """Whether the limits hold as surely as was asked for, or on nine vehicles of ten."""
        return not self.limited or self.probability >= (self.wanted or SURE)

    @property
    def is_enough(self) -> bool:
        """Whether the probability that was asked for, if any, is reached."""
        return self.wanted is None or self.probability >= self.wanted

    @property
    def probability(self) -> float:
        """Share of vehicles on which all limits were kept."""
        return self.n_kept / self.n_checked

    @property
    def at_least(self) -> float:
        """Lower end of the probability's one-sided 95 per cent interval (Clopper, Pearson).

        Where vehicles are drawn from priors, that of the half which doubts them: the bound then
        holds although priors believe too much.
        """
        if not self.doubted.any():
            return at_least(self.n_kept, self.n_checked)
        return at_least(int(self.kept[self.doubted].sum()), int(self.doubted.sum()))

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
            return NO_LIMIT
        doubt = f", priors {DOUBT:g} times too narrow included" if self.doubted.any() else ""
        words: str = SAYS["limits_kept"].format(self, doubt=doubt)
        if not self.is_enough:
            words += f", LESS than the {self.wanted:.0%} asked for"
        if self.left:
            words += "; left first: " + ", ".join(f"{n} ({c})" for n, c in self.left.items())
        return words

    @property
    def danger(self) -> str:
        """What stands first and in red where limits are likely to be left; empty where not."""
        return "" if self.is_safe else SAYS["danger"].format(self, left=1 - self.probability)

    to_dict = as_dict(
        "n_kept", "n_checked", "at_least", "wanted", "spread", "left", "waves", "ranges",
        abort_rules="rules", any_rule_fires="any_fires",
    )  # fmt: skip


@respelled(DesignError, {"n_vehicles": "vehicles=..."})
def assess_limits(
    model: Model,
    experiment: Experiment,
    *,
    rng: np.random.Generator,
    limits: Limits | None = None,
    spread: float | None = 0.3,
    prior: Information | None = None,
    vehicles: int | Sequence[Model] = 400,
    wanted: float | None = None,
    sea: NoiseModel | None = None,
    others: Sequence[Model] = (),
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
    vehicles : int or sequence of Model
        How many are drawn; or these, drawn before from the same ``spread``, ``prior`` and
        ``others``: several runs are then judged on the same ones.
    wanted : float, optional
        Probability that is asked for, for the words of the report.
    sea : NoiseModel, optional
        Disturbance forces: every vehicle meets waves of its own.
    others : sequence of Model
        Other structures that remain possible; the vehicles are drawn from all in turn.

    Returns
    -------
    Assurance

    Raises
    ------
    DesignError
        If fewer than 20 vehicles are asked for.

    Examples
    --------
    Of a run on 400 vehicles, their coefficients up to 20 % off::

        assess_limits(problem.model, run, rng=np.random.default_rng(0), spread=0.2).is_safe
    """
    fresh = vehicles
    if isinstance(fresh, int):
        fresh = draw_models(model, spread, fresh, prior, rng, others)
    if (n_vehicles := len(fresh)) < 20:
        raise DesignError(f"{n_vehicles} vehicles tell no probability. Give 20 or more.")
    bounds = LimitBounds.of(model, limits or experiment.limits)
    names = tuple(dict.fromkeys((*model.state_names, *model.output_names)))
    # Waves are drawn here and in order, so that numbers do not depend on who simulates.
    met = [in_own_waves(vehicle, experiment, sea, rng) for vehicle in fresh]
    first, extremes, tracks = zip(*_simulated(met, bounds, names), strict=True)
    kept = np.array([one is None for one in first])
    ends = np.array(extremes)
    ranges = _ranges(names, ends[np.isfinite(ends).all(axis=(1, 2))])
    rules, stopped = _rules(experiment, bounds, ranges, ends)
    waves = sea_words(sea) if sea is not None and sea.has_forces else ""
    return Assurance(
        int(kept.sum()), n_vehicles, wanted, spread, dict(Counter(filter(None, first))), ranges,
        bool(bounds.names), waves, rules, stopped, kept,
        in_doubt(model, spread, prior, n_vehicles, 1 + len(others)),
        PredictedTracks.of(motion(model, experiment), tracks),
    )  # fmt: skip


def _ranges(names: Sequence[str], ends: np.ndarray) -> dict[str, tuple[float, float]]:
    """What all but the most extreme vehicles stay within; nothing where all diverged."""
    if not len(ends):
        return {}
    # Of the lowest value of each vehicle, not of each moment: a run is safe as a whole.
    low = np.quantile(ends[:, :, 0], _TAIL, axis=0).tolist()
    high = np.quantile(ends[:, :, 1], 1 - _TAIL, axis=0).tolist()
    return dict(zip(names, zip(low, high, strict=True), strict=True))


# What one vehicle did: the limit left first, ranges ``(n_names, 2)``, the track.
_Behaviour = tuple[str | None, np.ndarray, np.ndarray | None]


def _simulated(
    met: Sequence[tuple[Model, Experiment]], bounds: LimitBounds, names: Sequence[str]
) -> list[_Behaviour]:
    """What all vehicles do, in their order, spread over processes."""
    # As many parts as vehicles in each: enough for several processes, and told when one is done.
    parts = np.array_split(np.arange(len(met)), 1 + isqrt(len(met)))
    work = partial(_behaviour, bounds=bounds, names=names)
    blocks = {f"vehicles from {i[0] + 1}": [met[j] for j in i] for i in parts if len(i)}
    return [one for part in run_cells(work, blocks, n_jobs=None).values() for one in part]


def _behaviour(
    met: Sequence[tuple[Model, Experiment]], bounds: LimitBounds, names: Sequence[str]
) -> list[_Behaviour]:
    """What several vehicles do in their runs."""
    found: list[_Behaviour] = []
    for vehicle, experiment in met:
        if (run := motion(vehicle, experiment)) is None:
            # Beyond whatever range anybody states.
            found.append(("diverged", np.tile([-np.inf, np.inf], (len(names), 1)), None))
            continue
        ends = np.array([[s.min(), s.max()] for s in map(run.signal, names)])
        found.append((bounds.first_left(run), ends, _track(run)))
    return found


def _rules(
    experiment: Experiment,
    bounds: LimitBounds,
    ranges: Mapping[str, tuple[float, float]],
    ends: np.ndarray,
) -> tuple[tuple[AbortRule, ...], float]:
    """Abort rules, and the share of the vehicles on which any of them fires.

    ``ends`` are lowest and highest values ``(n_vehicles, n_names, 2)``; vehicles that diverged fire
    every rule.
    """
    if not ranges:
        return (), 0.0
    found, any_fires = [], np.zeros(len(ends), dtype=bool)
    limited = dict(zip(bounds.names, zip(bounds.lower, bounds.upper, strict=True), strict=True))
    for name in dict.fromkeys((*limited, *(n for n in WATCHED if n in ranges))):
        if name in limited:
            first = experiment.initial.get(name, 0.0)
            # From the start towards the limit, so that the crew has time before it is reached.
            lower, upper = (first + (1 - IMMATERIAL) * (bound - first) for bound in limited[name])
        else:
            low, high = ranges[name]
            room = IMMATERIAL * max(high - low, 1e-9)
            lower, upper = low - room, high + room
        column = ends[:, list(ranges).index(name)]
        outside = (column[:, 0] < lower) | (column[:, 1] > upper)
        any_fires |= outside
        fires = float(outside.mean())
        found.append(AbortRule(name, float(lower), float(upper), fires, name in limited))
    return tuple(found), float(any_fires.mean())


@dataclass(frozen=True, eq=False)
class PredictedTracks:
    """Tracks of one run.

    Attributes
    ----------
    times : ndarray (n_times,)
        s.
    nominal : ndarray (n_times, 2)
        Of the nominal vehicle: ahead and to starboard, or along the course and depth, m.
    plausible : ndarray (n_vehicles, n_times, 2)
        Of others.
    is_vertical : bool
        Whether the second is depth.
    length : float or None
        Of the vehicle, m.

    Examples
    --------
    >>> t = np.arange(3.0)
    >>> ahead = np.column_stack([t, 0.0 * t])
    >>> PredictedTracks(t, ahead, ahead[None], is_vertical=False, length=2.0).plausible.shape
    (1, 3, 2)
    """

    times: np.ndarray
    nominal: np.ndarray
    plausible: np.ndarray
    is_vertical: bool
    length: float | None = None

    @classmethod
    def of(
        cls, run: Trajectory | None, others: Sequence[np.ndarray | None]
    ) -> PredictedTracks | None:
        """Tracks of the nominal vehicle's run and of others; None where there are none."""
        own = None if run is None else _track(run)
        found = [one for one in others if one is not None]
        if run is None or own is None or not found:
            return None
        known = _motion(run).keys()
        vertical = "psi" not in known and not {"x", "y"} <= known
        return cls(run.times, own, np.stack(found), vertical)

    @property
    def room(self) -> np.ndarray:
        """Box that all but the most extreme vehicles stay within, m.

        Returns
        -------
        ndarray (2, 2)
            Rows: along, across (or depth); columns: lowest, highest.
        """
        every = np.concatenate([self.nominal[None], self.plausible])
        low = np.quantile(every.min(axis=1), _TAIL, axis=0)
        high = np.quantile(every.max(axis=1), 1 - _TAIL, axis=0)
        own = self.nominal
        return np.array([np.minimum(low, own.min(axis=0)), np.maximum(high, own.max(axis=0))]).T

    def words(self) -> list[str]:
        """Sea room in words, in metres and lengths of the vehicle."""
        (back, ahead), (first, last) = self.room
        lines = [f"ahead {self._far(ahead)}, astern of the start {self._far(abs(min(back, 0.0)))}"]
        if self.is_vertical:
            lines.append(f"depth {first:.3g} to {last:.3g} m")
        else:
            port, starboard = abs(min(first, 0.0)), max(last, 0.0)
            lines.append(f"to port {self._far(port)}, to starboard {self._far(starboard)}")
        spread = np.abs(self.plausible - self.nominal).max(axis=(1, 2))
        far = self._far(float(np.quantile(spread, 1 - _TAIL)))
        return [*lines, SAYS["tracks_differ"].format(far=far, n=len(self.plausible))]

    def _far(self, metres: float) -> str:
        text = f"{metres:.3g} m"
        return text if self.length is None else f"{text} ({metres / self.length:.2g} L)"


def _motion(run: Trajectory) -> dict[str, np.ndarray]:
    """States and outputs of a run by name."""
    return {name: run.signal(name) for name in (*run.state_names, *run.output_names)}


def _track(run: Trajectory) -> np.ndarray | None:
    """Track from the start, ``(n_times, 2)``."""
    known, still = _motion(run), np.zeros(len(run.times))
    if {"x", "y"} <= known.keys():
        track = np.column_stack([known["x"], known["y"]])
        return np.asarray(track - track[0])
    if {"u", "psi"} <= known.keys():
        u, v, psi = known["u"], known.get("v", still), known["psi"] - known["psi"][0]
        # Kinematics in the plane, from the heading at the start.
        rates = [u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)]
        return cumulative_trapezoid(np.column_stack(rates), run.times, axis=0, initial=0)
    if not {"u", "theta", "z"} <= known.keys():
        return None
    u, w, theta = known["u"], known.get("w", still), known["theta"]
    ahead = u * np.cos(theta) + w * np.sin(theta)
    return np.column_stack([cumulative_trapezoid(ahead, run.times, initial=0), known["z"]])


def stated(error: float, sea: NoiseModel | None) -> str:
    """Return a relative error in words, or that there is none to be stated.

    >>> sea = NoiseModel(np.ones(1), np.zeros(1), np.ones(1), places=("force Z",))
    >>> stated(0.42, None), stated(0.42, sea), stated(0.12, sea)
    ('42%', 'not id.', '12%')
    """
    if sea is not None and sea.has_forces and not error <= TRUSTED:
        return "not id."
    return percent(error)


@dataclass(frozen=True, eq=False)
class AccuracyRange:
    """Relative errors on vehicles that are possible.

    Attributes
    ----------
    names : tuple of str
    lowest, highest : ndarray (n,)
        Shares of the values.
    n_drawn : int
        Vehicles on which the runs stayed finite.
    sea : NoiseModel or None

    Examples
    --------
    >>> AccuracyRange(("K",), np.array([0.02]), np.array([0.05]), 12).words("K")
    '2% to 5%'
    """

    names: tuple[str, ...]
    lowest: np.ndarray
    highest: np.ndarray
    n_drawn: int
    sea: NoiseModel | None = None

    def words(self, name: str) -> str:
        """Range of one parameter in words."""
        i = self.names.index(name)
        low, high = stated(self.lowest[i], self.sea), stated(self.highest[i], self.sea)
        return f"{low} to {high}" if low != high else low

    to_dict = as_dict(
        "n_drawn",
        parameters=lambda self: dict(
            zip(self.names, zip(self.lowest, self.highest, strict=True), strict=True)
        ),
    )


def accuracy_range(
    model: Model,
    runs: Experiment | Iterable[Experiment],
    *,
    rng: np.random.Generator,
    noise: Levels | NoiseModel | Fit = None,
    spread: float | None = None,
    prior: Information | None = None,
    n_draws: int = 12,
) -> AccuracyRange:
    """Predict errors on vehicles drawn from what is known.

    Parameters
    ----------
    model : Model
        The nominal vehicle.
    runs : Experiment or iterable of Experiment
        Planned together.
    rng : numpy.random.Generator
        Source of the vehicles.
    noise : optional
        See :func:`~oed_sysid.information.information_of`.
    spread : float or None
        Relative half-width of uniform draws around the values; None draws from what is
        known (prior standard deviations, or ``prior``).
    prior : Information, optional
        Known before the runs; counts in the errors too.
    n_draws : int

    Returns
    -------
    AccuracyRange

    Raises
    ------
    DesignError
        If the runs diverge on most vehicles.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading")
    >>> run = next(iter(ship.experiments.values()))
    >>> found = accuracy_range(ship.model, run, rng=np.random.default_rng(0), spread=0.2, n_draws=2)
    >>> found.names
    ('T', 'K')
    """
    listed = [runs] if isinstance(runs, Experiment) else list(runs)
    errors = []
    names: tuple[str, ...] = ()
    for vehicle in draw_models(model, spread, n_draws, prior, rng):
        try:
            found = information_of(vehicle, listed, noise=noise, priors=prior)
        except OedSysidError:
            continue
        names = found.names
        errors.append(found.std_errors / [model.parameter(name).reference for name in names])
    if len(errors) < max(2, n_draws // 2):
        raise DesignError(SAYS["no_range_of_accuracy"].format(n=len(errors), n_draws=n_draws))
    sea = noise.noise if isinstance(noise, Fit) else noise
    kept = sea if isinstance(sea, NoiseModel) and not sea.is_white else None
    low, high = np.min(errors, axis=0), np.max(errors, axis=0)
    return AccuracyRange(names, low, high, len(errors), kept)
