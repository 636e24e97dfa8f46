r"""Limits on what the vehicle does, as numbers for a search and as words for people.

Of a limited signal :math:`x_j` with bounds :math:`l_j, u_j` the excess is a share of its width
:math:`b_j = u_j - l_j` (of a bound alone: its absolute value),

.. math:: h_j(t) = \max\left(\frac{l_j - x_j(t)}{b_j}, \frac{x_j(t) - u_j}{b_j}\right)

and a run is inside where :math:`\max_{j,t} h_j \le 0`; limits on the end count at the last sample
only. In words angles are in degrees.

Vehicles that are possible: drawn from what is known, for criteria and for limits.

Values are drawn about the nominal ones, :math:`\theta_i (1 + s\, \epsilon_i)` with
:math:`\epsilon_i \sim U(-1, 1)`, or from what is known, :math:`\theta + L \epsilon` with
:math:`L L' = F_0^{-1}` and :math:`\epsilon \sim N(0, I)`, within the parameters' bounds. With
vehicles :math:`\theta_s` of every structure that remains possible in turn, motions
:math:`x(t; \theta_s)` under one and the same command and limits :math:`h(x) \le 0`, the search
keeps

.. math:: \#\{s : \max_t h(x(t; \theta_s)) > 0\} \le k, \qquad
    k = \left\lfloor \tfrac12 (1 - p)\, n \right\rfloor

for a wanted probability :math:`p` and :math:`n` vehicles (scenarios with discarding; half of the
allowed failures are left to vehicles that the search never saw). What is then stated is the share
of fresh vehicles that keep all limits, with the lower end of its one-sided 95 % interval (Clopper
& Pearson), not :math:`p` itself,

.. math:: \sum_{i=k}^n \binom ni p_-^i (1 - p_-)^{n-i} = 0.05 .

What somebody believes of a coefficient is often too narrow. Where declared priors are all that is
known, every other vehicle is drawn :data:`DOUBT` times as far from the nominal one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import degrees

import numpy as np
from scipy.special import betaincinv

from oed_sysid.compiled.kernels import Run, kernel
from oed_sysid.design.criteria import SAYS, Criterion
from oed_sysid.errors import DesignError, OedSysidError, located
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.simulation import Trajectory, trajectory_of
from oed_sysid.information.identifiability import ASSUMED
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.projection import root_of
from oed_sysid.likelihood.realisation import at_sea
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import NEGLIGIBLE


def units_of(model: Model) -> dict[str, str]:
    """Units of all states, inputs and outputs by name."""
    units = {output.name: output.unit for output in model.outputs}
    units |= {state.name: state.unit for effect in model.effects for state in effect.states}
    units |= {state.name: state.unit for state in model.states}
    return units | {channel.name: channel.unit for channel in model.inputs}


def quantity(value: float, unit: str) -> str:
    """Return a number with its unit, angles in degrees.

    Examples
    --------
    >>> quantity(0.0872665, "rad"), quantity(12.0, "m")
    ('5 deg', '12 m')
    """
    if unit in ("rad", "rad/s"):
        # Commands are floating-point sums: 5e-9 deg is zero.
        return f"{round(degrees(value), 6) + 0.0:.4g} {unit.replace('rad', 'deg')}"
    return f"{value:.4g} {unit}".rstrip()


def span(lower: float, upper: float, unit: str) -> str:
    """Return a range with one unit."""
    if lower == -float("inf"):
        return f"up to {quantity(upper, unit)}"
    if upper == float("inf"):
        return f"from {quantity(lower, unit)}"
    if lower == -upper:
        return f"+-{quantity(upper, unit)}"
    return between(lower, upper, unit)


def between(lower: float, upper: float, unit: str) -> str:
    """Return two numbers with one unit.

    >>> between(0.1, 0.2, "rad")
    '5.73 to 11.46 deg'
    """
    return f"{quantity(lower, unit).split(' ')[0]} to {quantity(upper, unit)}"


def outside(lower: float, upper: float, unit: str) -> str:
    """Return where a value is outside a range, whose ends may be none.

    >>> outside(-float("inf"), 12.0, "m")
    'above 12 m'
    """
    ends = (("below", lower), ("above", upper))
    return " or ".join(f"{word} {quantity(end, unit)}" for word, end in ends if abs(end) < 1e30)


def percent(share: float) -> str:
    """Return a relative error, a dash where nothing is known; beyond ten its size is no matter."""
    if not share < 1e4:
        return "-"
    if share > 10:
        return ">1000%"
    return f"{100 * share:.3g}%"


_SIDES = ("lower", "upper")


@dataclass(frozen=True, eq=False)
class LimitBounds:
    """Bounds on states and outputs during the experiment and at its end.

    Attributes
    ----------
    names : tuple of str
        Limited signals; those of the end come last.
    columns : ndarray of int (n_limits,)
        Columns of a vehicle's signals.
    lower, upper, width : ndarray (n_limits,)
    at_end : ndarray of bool (n_limits,)
        Whether only the last sample counts.
    n_full : int
        Columns of full states before the outputs.
    units : tuple of str
        Of the limited signals, for words.
    """

    names: tuple[str, ...]
    columns: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    width: np.ndarray
    at_end: np.ndarray
    n_full: int
    units: tuple[str, ...]

    @classmethod
    def of(
        cls, model: Model, limits: Limits, end: Mapping[str, tuple[float, float]] | None = None
    ) -> LimitBounds:
        """Return the bounds of a model's states (before outputs of the same name)."""
        states, n_full = model.all_state_names, kernel(model).n_full
        known = {name: n_full + i for i, name in enumerate(model.output_names)}
        known |= {name: i for i, name in enumerate(states)}
        # Checked as limits of the run are; a signal may have both.
        at_end = Limits(signals=end or {}).signals
        names = (*limits.signals, *at_end)
        lacking = f"A limit is on nothing: model {model.name!r} has no state or output"
        located(DesignError, lacking, names, {**dict.fromkeys(states), **known})
        lower, upper = np.reshape([*limits.signals.values(), *at_end.values()], (-1, 2)).T
        bound = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, 1.0))
        width = upper - lower
        # A limit on one side has no width: its own size is the unit.
        width = np.where(np.isfinite(width), width, np.maximum(np.abs(bound), 1e-3))
        units = units_of(model)
        columns = np.array([known[name] for name in names], dtype=int)
        last = np.arange(len(names)) >= len(limits.signals)
        labels = tuple(units[name] for name in names)
        return cls(names, columns, lower, upper, width, last, n_full, labels)

    def limited(self, signals: np.ndarray) -> np.ndarray:
        """The limited ones of a vehicle's full states and outputs, ``(n_times, n_limits)``."""
        return signals[:, self.columns]

    def excess(self, limited: np.ndarray) -> np.ndarray:
        """How far the limited signals are beyond their limits, as shares of the width.

        Parameters
        ----------
        limited : ndarray (n_times, n_limits)

        Returns
        -------
        ndarray (n_times, n_limits, 2)
            Below and above; negative inside, minus infinity where not limited.
        """
        both = np.stack([self.lower - limited, limited - self.upper], axis=2)
        both = both / self.width[:, None]
        both[:-1, self.at_end] = -np.inf
        return np.asarray(both)

    def during(self) -> LimitBounds:
        """The limits that hold during the run."""
        n = int((~self.at_end).sum())
        by_limit = [one.name for one in fields(self) if one.name != "n_full"]
        return replace(self, **{name: getattr(self, name)[:n] for name in by_limit})

    def worst(self, limited: np.ndarray) -> float:
        """Largest excess of a whole run; negative if all limits are kept."""
        return float(self.excess(limited).max(initial=-np.inf))

    def first_left(self, run: Trajectory) -> str | None:
        """Limit that a motion leaves first; None if it keeps all, those on its end waived."""
        if not (bounds := self.during()).names:
            return None
        excess = bounds.excess(np.column_stack([run.signal(name) for name in bounds.names]))
        outside = excess.max(axis=(1, 2)) > 0
        if not outside.any():
            return None
        first = excess[int(np.argmax(outside))]
        limit, side = np.unravel_index(int(np.argmax(first)), first.shape)
        return f"{self.names[limit]} {_SIDES[side]} limit"

    def reached(self, times: np.ndarray, limited: np.ndarray) -> tuple[str, ...]:
        """Limits that are reached within 1 %, in words."""
        return tuple(
            f"{self.names[i]} {_SIDES[side]} limit {quantity(bound, self.units[i])} {when}"
            for i, side, bound, _, when in self._extremes(times, limited, -NEGLIGIBLE)
        )

    def broken(self, times: np.ndarray, limited: np.ndarray) -> tuple[str, ...]:
        """Limits that are not kept, in words."""
        return tuple(
            f"{self.names[i]} is {quantity(value, self.units[i])} {when}, "
            f"{('below', 'above')[side]} its limit of {quantity(bound, self.units[i])}"
            for i, side, bound, value, when in self._extremes(times, limited, 1e-9)
        )

    def _extremes(
        self, times: np.ndarray, limited: np.ndarray, beyond: float
    ) -> Iterator[tuple[int, int, float, float, str]]:
        """Limit, side, bound, value and time of largest excesses above a share of the width."""
        excess = self.excess(limited)
        for index, bounds in enumerate(zip(self.lower, self.upper, strict=True)):
            for side, bound in enumerate(bounds):
                sample = int(np.argmax(excess[:, index, side]))
                if excess[sample, index, side] > beyond:
                    when = "at the end" if self.at_end[index] else f"at t = {times[sample]:g} s"
                    yield index, side, float(bound), float(limited[sample, index]), when


# Fresh vehicles that judge runs that are chosen from several.
CHECKED = 200
# How wrong coefficients may be where neither priors nor a fit tell, as a share of their values.
UNCERTAINTY = ASSUMED
# How much wider than declared a prior may be: one that says 8 % where 25 % is true.
DOUBT = 3.0


def check_spread(spread: float | None) -> None:
    """Refuse a relative half-width of uniform draws that is none."""
    if spread is not None and not 0 < spread < 1:
        raise DesignError(SAYS["no_spread"].format(spread=spread))


@dataclass(frozen=True)
class Robust:
    """Expected or worst value of a criterion over sampled parameter values.

    Limits are kept for every sampled set, so that a manoeuvre that is safe only
    for the nominal vehicle is not proposed.

    Parameters
    ----------
    criterion : Criterion
        Judged at every set.
    spread : float or None
        Relative half-width of uniform draws around the values; None draws from
        what is known (prior standard deviations, or the covariance of the fit).
    n_sets : int
        Sampled sets besides the nominal one.
    worst : bool
        Judge by the (soft) minimum instead of the mean.
    softness : float
        Width of the soft minimum, in units of the criterion.

    References
    ----------
    L. Pronzato, E. Walter, Robust experiment design via stochastic
    approximation, *Mathematical Biosciences* 75 (1985) 103-120: expectation;
    and Robust experiment design via maximin optimization, 89 (1988) 161-176.

    Examples
    --------
    >>> from oed_sysid.design import DOptimal
    >>> Robust(DOptimal(), spread=0.2, worst=True).n_sets
    6
    """

    criterion: Criterion
    spread: float | None = 0.3
    n_sets: int = 6
    worst: bool = False
    softness: float = 0.3

    def __post_init__(self) -> None:
        check_spread(self.spread)
        if self.n_sets < 1:
            raise DesignError(f"Robust has {self.n_sets} sets. Give one or more.")

    @property
    def name(self) -> str:
        """Name for reports."""
        kind = "worst" if self.worst else "expected"
        return f"{kind} {getattr(self.criterion, 'name', 'criterion')} over {self.n_sets + 1} sets"


def draw_models(
    model: Model,
    spread: float | None,
    n_sets: int,
    prior: Information | None,
    rng: np.random.Generator,
    others: Sequence[Model] = (),
) -> tuple[Model, ...]:
    """Return the model at sampled values.

    Parameters
    ----------
    model : Model
        At the nominal values; the prior is about its parameters.
    spread : float or None
        Relative half-width of uniform draws; None draws from what is known, and coefficients of
        which nothing is known up to :data:`UNCERTAINTY` off.
    n_sets : int
        How many.
    prior : Information or None
        What is known besides the parameters' ``prior_std``.
    rng : numpy.random.Generator
    others : sequence of Model
        Other structures, taken in turn; what the prior does not know of them stays at its value.
    """

    def drawn(structure: Model, n_drawn: int) -> list[Model]:
        """One structure at values drawn about its own."""
        names = structure.free_names
        values = np.array([p.value for p in structure.free_parameters])
        deviations, far = np.zeros((len(names),) * 2), np.full(len(names), spread or 0.0)
        if spread is None:
            deviations = _deviations(structure, prior)
            far = np.where(deviations.any(axis=1), 0.0, UNCERTAINTY)
        found = []
        for number in range(n_drawn):
            wide = DOUBT if prior is None and number % 2 else 1.0
            moved = values.copy()
            if deviations.any():
                # Every other vehicle from a prior that is wider: a mixture, since priors are wrong
                # themselves.
                moved += wide * deviations @ rng.standard_normal(len(names))
            if far.any():
                moved += values * far * rng.uniform(-1, 1, len(names))
            found.append(structure.within_bounds(dict(zip(names, moved, strict=True))))
        return found

    structures = (model, *others)
    n = len(structures)
    sets = [drawn(one, len(range(first, n_sets, n))) for first, one in enumerate(structures)]
    return tuple(sets[number % n][number // n] for number in range(n_sets))


def in_doubt(
    model: Model, spread: float | None, prior: Information | None, n_sets: int, structures: int = 1
) -> np.ndarray:
    """Which vehicles of :func:`draw_models` are drawn as if priors were too narrow, ``(n_sets,)``.

    Parameters
    ----------
    model, spread, prior, n_sets
        See :func:`draw_models`.
    structures : int
        The model and the others.
    """
    rests = spread is None and prior is None and bool(_deviations(model, None).any())
    return rests & (np.arange(n_sets) // structures % 2 == 1)


def _deviations(model: Model, prior: Information | None) -> np.ndarray:
    """Root of the covariance of what is known, ``(n_free, n_free)``; zero where nothing is."""
    names = model.free_names
    root = np.diag([parameter.prior_spread or 0.0 for parameter in model.free_parameters])
    if prior is not None:
        covariance = np.where(np.isfinite(prior.covariance), prior.covariance, 0.0)
        rows = [names.index(name) for name in prior.names]
        root[np.ix_(rows, rows)] = root_of(covariance)
    return root


# Share of the allowed failures that the search may use; the rest is for vehicles it never saw.
USABLE = 0.5


@dataclass(frozen=True)
class Caution:
    """How surely limits are to be kept when the parameters are uncertain.

    The search keeps the limits on many vehicles, their values drawn from what
    is known; a small share of them may fail. The result is judged on fresh
    vehicles, and this is the probability that is stated.

    Parameters
    ----------
    probability : float
        With which all limits during the run are to be kept together.
    spread : float or None
        Relative half-width of uniform draws around the values; None draws from
        what is known (prior standard deviations, or the covariance of a fit).
    n_sets : int
        Vehicles that the search sees.
    n_checks : int
        Fresh vehicles that judge the result.
    others : sequence of Model
        Other structures that remain possible, such as refits with either member of a group that
        the records cannot tell apart: the vehicles are drawn from all in turn.

    References
    ----------
    G. C. Calafiore, M. C. Campi, The scenario approach to robust control
    design, *IEEE Trans. Automatic Control* 51 (2006) 742-753.
    M. C. Campi, S. Garatti, A sampling-and-discarding approach to
    chance-constrained optimization, *J. Optimization Theory and Applications*
    148 (2011) 257-280.

    Examples
    --------
    >>> Caution(0.9, spread=0.3).probability
    0.9
    """

    probability: float = 0.95
    spread: float | None = None
    n_sets: int = 160
    n_checks: int = 600
    others: Sequence[Model] = ()

    @property
    def n_waived(self) -> int:
        """Vehicles that may fail in the search."""
        return int(USABLE * (1 - self.probability) * self.n_sets)

    def vehicles(
        self, model: Model, prior: Information | None, rng: np.random.Generator
    ) -> tuple[Model, ...]:
        """Vehicles that the search sees; see :func:`draw_models`."""
        return draw_models(model, self.spread, self.n_sets, prior, rng, self.others)

    def __post_init__(self) -> None:
        if not 0.5 <= self.probability < 1 or min(self.n_sets, self.n_checks) < 20:
            raise DesignError(SAYS["caution"].format(self))
        check_spread(self.spread)


@dataclass(frozen=True, eq=False)
class ScenarioRun:
    """What one uncertain vehicle does; ``signals`` are the limited ones, ``(n_times, n_limits)``.

    Attributes
    ----------
    signals : ndarray (n_times, n_limits)
    nodes : ndarray (n_edges, n_full)
    excess : float
        Largest, as a share of a limit's width; infinite where the trajectory diverges.
    """

    signals: np.ndarray
    nodes: np.ndarray
    excess: float


def in_own_waves(
    vehicle: Model, run: Experiment, sea: NoiseModel | None, rng: np.random.Generator
) -> tuple[Model, Experiment]:
    """A vehicle and its run, with one draw of disturbance forces where any are expected."""
    if sea is None or not sea.has_forces:
        return vehicle, run
    return at_sea(vehicle, replace(run, limits=Limits()), sea, rng=rng)


def motion(vehicle: Model, run: Experiment) -> Trajectory | None:
    """What a vehicle does in a run; None where it diverges.

    Parameters
    ----------
    vehicle : Model
    run : Experiment
        One that reacts closes its loop on this vehicle; its limits are not looked at.
    """
    try:
        return trajectory_of(vehicle, replace(run, limits=Limits()))
    except OedSysidError:
        return None


def kept_on(
    run: Experiment, vehicles: Sequence[Model], bounds: LimitBounds, wanted: float
) -> float | None:
    """Share of the vehicles on which a run keeps its limits; the first has to.

    Parameters
    ----------
    run : Experiment
    vehicles : sequence of Model
        The nominal one first.
    bounds : LimitBounds
    wanted : float
        Below this share of the others nothing is returned.
    """
    # Once more have failed than may, the rest need not be simulated.
    allowed = int((1 - wanted) * len(vehicles) + 1e-9)
    failed = 0
    for number, vehicle in enumerate(vehicles):
        found = motion(vehicle, run)
        if found is None or bounds.first_left(found) is not None:
            failed += 1
            if number == 0 or failed > allowed:
                return None
    return 1.0 - failed / len(vehicles)


def at_least(n_kept: int, n_checked: int) -> float:
    """Lower end of a share's one-sided 95 % interval (Clopper & Pearson).

    Examples
    --------
    >>> round(at_least(20, 20), 3), round(at_least(200, 200), 3), at_least(0, 20)
    (0.861, 0.985, 0.0)
    """
    return float(betaincinv(n_kept, n_checked - n_kept + 1, 0.05)) if n_kept else 0.0


class Scenarios:
    """Uncertain vehicles on which limits are kept; their information does not matter.

    Limits on the end of the run are goals of the nominal vehicle and not kept here.

    Parameters
    ----------
    models : sequence of Model
        At drawn values; of one structure or several with the same states and outputs.
    times : ndarray (n_times,)
    edges : ndarray of int (n_edges,)
        See :class:`~oed_sysid.design.objective.VehicleInformation`.
    own : ndarray (n_own,)
        Start state.
    bounds : LimitBounds
    n_waived : int
        How many of them may fail.
    waves : sequence of (Model, ndarray (n_times, n_waves)), optional
        Each of the vehicles with disturbance forces as further inputs, and one draw of these.
    """

    def __init__(
        self,
        models: Sequence[Model],
        times: np.ndarray,
        edges: np.ndarray,
        own: np.ndarray,
        bounds: LimitBounds,
        n_waived: int = 0,
        waves: Sequence[tuple[Model, np.ndarray]] = (),
    ) -> None:
        met = waves or [(model, np.empty((len(times), 0))) for model in models]
        self._vehicles = [(kernel(one), one.value_vector, forces) for one, forces in met]
        self.times, self.edges, self.own = times, edges, own
        self.bounds, self.n_waived = bounds.during(), n_waived
        self._waived: frozenset[int] = frozenset()

    def __len__(self) -> int:
        return len(self._vehicles)

    def run(self, index: int, commands: np.ndarray) -> ScenarioRun:
        """Simulate one vehicle."""
        run, signals = self._simulated(index, commands)
        excess = self.bounds.worst(signals) if run.ok else np.inf
        return ScenarioRun(signals, run.states[self.edges], excess)

    def change(
        self, index: int, before: ScenarioRun, commands: np.ndarray, edge: int
    ) -> np.ndarray:
        """Change of the limited signals from an edge on, zero where the trajectory diverges."""
        first = int(self.edges[edge])
        run, signals = self._simulated(index, commands, first, before.nodes[edge])
        changed = signals - before.signals[first:]
        return changed if run.ok else np.zeros_like(changed)

    def _simulated(
        self, index: int, commands: np.ndarray, first: int = 0, node: np.ndarray | None = None
    ) -> tuple[Run, np.ndarray]:
        """Run of one vehicle, in its own waves, from a sample on, and the limited signals."""
        runner, values, forces = self._vehicles[index]
        commands = np.hstack([commands, forces])
        if node is None or first == 0:
            node, _ = runner.start(self.own, commands[0], values, float(self.times[0]))
        run = runner.run(self.times[first:], commands[first:], values, node)
        # Own states come first in every structure; outputs count after those of the nominal one.
        states, n_full = run.states[:, : self.bounds.n_full], self.bounds.n_full
        missing = np.zeros((len(states), n_full - states.shape[1]))
        return run, self.bounds.limited(np.hstack([states, missing, run.outputs]))

    def waive(self, runs: Sequence[ScenarioRun]) -> None:
        """Leave the allowed number of vehicles, those furthest outside, out of the search.

        They stay the same for a while: a search whose worst vehicles change
        from step to step gets nowhere.
        """
        order = np.argsort([-run.excess for run in runs], kind="stable")
        self._waived = frozenset(int(i) for i in order[: self.n_waived])

    def level(self, runs: Sequence[ScenarioRun]) -> float:
        """Largest excess, waived vehicles left out; below zero if the others are inside."""
        kept = (run.excess for i, run in enumerate(runs) if i not in self._waived)
        return max(kept, default=-np.inf)

    def decisive(self, runs: Sequence[ScenarioRun]) -> list[int]:
        """Vehicles nearest to their limits, without those that are waived."""
        order = np.argsort([-run.excess for run in runs], kind="stable")
        kept = [int(i) for i in order if i not in self._waived and np.isfinite(runs[i].excess)]
        return kept[:20]  # that enter one linear program
