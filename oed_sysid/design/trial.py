"""What is run, how it is searched for, and the task that a search solves.

:class:`Trial` and :class:`Search` are checked when they are made; :class:`Task` puts them, with
what is known (:mod:`oed_sysid.design.knowledge`), into the arrays of a search.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from oed_sysid.design.assurance import Assurance, assess_limits
from oed_sysid.design.criteria import SAYS
from oed_sysid.design.knowledge import ExpectedInformation
from oed_sysid.design.library import ZigZags, as_piecewise
from oed_sysid.design.vehicles import (
    USABLE,
    Caution,
    LimitBounds,
    Robust,
    draw_models,
    in_own_waves,
)
from oed_sysid.design.waveforms import Grid, Levels, Parametrisation
from oed_sysid.errors import DesignError, located, respelled
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.simulation import trajectory_of
from oed_sysid.physics.model import Model


@dataclass(frozen=True, eq=False)
class Trial:
    """One run whose commands are to be designed.

    Parameters
    ----------
    limits : Limits
        Range of each designed input, its rate, and limits of states or outputs.
    duration, sample_time : float
        Length and sampling, s.
    inputs : sequence of str, optional
        Inputs to design; by default all that have limits and no constant.
    constants : mapping of str to float, optional
        Values of the other inputs.
    trim : mapping of str to float, optional
        Command before the run; by default zero, or the middle of a range without zero.
    initial : mapping of str to float, optional
        Start state.
    end : mapping of str to (lower, upper), optional
        Where states or outputs have to be at the end, for a return to the start.
    name : str
        Name of the experiment.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> Trial(load_problem("nomoto_sparse_heading").limits, 120.0, 1.0).duration
    120.0
    """

    limits: Limits
    duration: float
    sample_time: float
    inputs: Sequence[str] | None = None
    constants: Mapping[str, float] = field(default_factory=dict)
    trim: Mapping[str, float] = field(default_factory=dict)
    initial: Mapping[str, float] = field(default_factory=dict)
    end: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    name: str = "designed"

    def __post_init__(self) -> None:
        if not (self.sample_time > 0 and self.duration >= 10 * self.sample_time):
            raise DesignError(SAYS["short_run"].format(self))
        for name in ("constants", "initial"):
            values = {key: float(value) for key, value in getattr(self, name).items()}
            object.__setattr__(self, name, values)

    @classmethod
    def like(cls, pattern: Experiment, limits: Limits, *, duration: float | None = None) -> Trial:
        """Return a run with the length, sampling, constant inputs and start of an experiment.

        Parameters
        ----------
        pattern : Experiment
        limits : Limits
        duration : float, optional
            Another length, s.
        """
        length = float(pattern.duration or 0.0) if duration is None else duration
        return cls(
            limits, length, pattern.sample_time, constants=pattern.constants,
            initial=pattern.initial,
        )  # fmt: skip

    def designed_inputs(self, model: Model) -> tuple[str, ...]:
        """Inputs that are designed, checked; all others are constant."""
        limits, held = self.limits, self.constants
        limits.check_names(model)
        free = (n for n in model.input_names if n in limits.inputs and n not in held)
        if not (names := tuple(free if self.inputs is None else self.inputs)):
            raise DesignError(SAYS["nothing_to_design"])
        located(DesignError, f"Model {model.name!r} has no input", names, model.input_names)
        for name in names:
            if not np.all(np.isfinite(limits.inputs.get(name, np.inf))):
                raise DesignError(SAYS["no_finite_range"].format(name=name))
        for name in model.input_names:
            if name not in (*names, *held):
                raise DesignError(SAYS["input_left_open"].format(name=name))
        located(DesignError, f"Model {model.name!r} has no state", self.initial, model.state_names)
        return names

    def grid(self, model: Model) -> Grid:
        """What the designed commands have to fit in."""
        names = self.designed_inputs(model)
        grid = Grid.of(self.limits, names, self.duration, self.sample_time, self.trim)
        if np.any(grid.trim < grid.lower) or np.any(grid.trim > grid.upper):
            raise DesignError("A trim command lies outside the range of its input. Correct it.")
        return grid


Trial.__init__ = respelled(DesignError, {"neutral": "trim=..."})(Trial.__init__)  # type: ignore[method-assign]


@dataclass(frozen=True)
class Search:
    """How the commands of a run are searched for.

    Parameters
    ----------
    family : Parametrisation or ZigZags
        Family of commands.
    n_starts, n_candidates, n_steps : int
        Starts that are refined, rough manoeuvres tried, steps of refinement.
    n_workers : int, optional
        Threads; by default one per core, at most four.

    Examples
    --------
    >>> Search(n_starts=1, n_candidates=10).n_steps
    40
    """

    family: Parametrisation | ZigZags = Levels()  # noqa: RUF009 (frozen)
    n_starts: int = 3
    n_candidates: int = 80
    n_steps: int = 40
    n_workers: int | None = None

    def __post_init__(self) -> None:
        if min(self.n_starts, self.n_candidates, self.n_steps) < 1:
            raise DesignError("A search needs one start, one candidate and one step or more.")

    @property
    def workers(self) -> int:
        """Threads that are used."""
        return self.n_workers or min(4, os.cpu_count() or 1)


def held_by(**holders: Any) -> dict[str, str]:
    """What to write instead of arguments that are fields of dataclasses now, by argument.

    >>> held_by(search=Search)["n_starts"]
    'search=Search(n_starts=...)'
    """
    return {
        one.name: f"{argument}={holder.__name__}({one.name}=...)"
        for argument, holder in holders.items()
        for one in fields(holder)
    }


@dataclass(frozen=True, eq=False)
class Task:
    """A checked design task, and the vehicles on which it is judged.

    Attributes
    ----------
    expected : ExpectedInformation
    trial : Trial
    grid : Grid
    bounds : LimitBounds
    positions : ndarray of int
        Columns of the designed inputs.
    models : tuple of Model
        Sets of values that the criterion is taken over, the nominal one first.
    softness : float or None
        Width of the soft minimum over these; None for the mean.
    scenarios : tuple of Model
        Uncertain vehicles on which limits are kept.
    waves : tuple of (Model, ndarray)
        The same with disturbance forces as inputs, and a draw of these for each.
    caution : Caution or None
    n_waived : int
        Scenarios that may fail.
    """

    expected: ExpectedInformation
    trial: Trial
    grid: Grid
    bounds: LimitBounds
    positions: np.ndarray
    models: tuple[Model, ...]
    softness: float | None = None
    scenarios: tuple[Model, ...] = ()
    waves: tuple[tuple[Model, np.ndarray], ...] = ()
    caution: Caution | None = None
    n_waived: int = 0

    @classmethod
    def of(
        cls,
        expected: ExpectedInformation,
        trial: Trial,
        rng: np.random.Generator,
        *,
        robust: Robust | None = None,
        caution: Caution | None = None,
    ) -> Task:
        """Check a design task, and draw the vehicles that it is judged on."""
        model, known = expected.model, expected.prior
        grid = trial.grid(model)
        others = draw_models(model, robust.spread, robust.n_sets, known, rng) if robust else ()
        task = cls(
            expected, trial, grid, LimitBounds.of(model, trial.limits, trial.end),
            np.array([model.input_names.index(name) for name in grid.inputs]),
            (model, *others),
            softness=robust.softness if robust is not None and robust.worst else None,
            scenarios=caution.vehicles(model, known, rng) if caution else (), caution=caution,
            n_waived=caution.n_waived if caution else 0,
        )  # fmt: skip
        return task._with_waves(rng)

    @property
    def model(self) -> Model:
        """The nominal vehicle."""
        return self.expected.model

    @property
    def own(self) -> np.ndarray:
        """Start state, ``(n_own,)``."""
        return np.array([self.trial.initial.get(n, 0.0) for n in self.model.state_names])

    @property
    def trim(self) -> np.ndarray:
        """Trim commands of all inputs, ``(n_inputs,)``."""
        base = np.array([self.trial.constants.get(name, 0.0) for name in self.model.input_names])
        base[self.positions] = self.grid.trim
        return base

    def still(self) -> np.ndarray:
        """Trim commands at all samples, ``(n_times, n_inputs)``."""
        return np.broadcast_to(self.trim, (len(self.grid.times), len(self.trim))).copy()

    def designed(self, experiment: Experiment) -> np.ndarray:
        """Commands of the designed inputs in some experiment, ``(n_times, n_designed)``."""
        return trajectory_of(self.model, experiment).inputs[:, self.positions]

    def experiment(self, commands: np.ndarray) -> Experiment:
        """Return commands ``(n_times, n_inputs)`` as an experiment within the limits."""
        manoeuvres = [
            as_piecewise(i, self.grid.times, commands[:, p])
            for i, p in zip(self.grid.inputs, self.positions, strict=True)
        ]
        trial = self.trial
        return Experiment(
            trial.name, manoeuvres, duration=float(self.grid.times[-1]),
            sample_time=self.grid.step, constants=trial.constants, initial=trial.initial,
            limits=trial.limits,
        )  # fmt: skip

    def stricter(self, found: Assurance, rng: np.random.Generator) -> Task:
        """Return the task with more uncertain vehicles, of which fewer may fail.

        Parameters
        ----------
        found : Assurance
            What this task led to; it was not enough.
        rng : numpy.random.Generator
        """
        if (caution := self.caution) is None:
            return self
        more = caution.vehicles(self.model, self.expected.prior, rng)
        grown = self.n_waived * (1 + len(more) / len(self.scenarios))
        share = (1 - caution.probability) / max(1 - found.probability, 1e-3)
        allowed = int(USABLE * share * grown)
        # Without progress by counting, none may fail any more.
        n_waived = allowed if allowed < grown else 0
        return replace(self, scenarios=(*self.scenarios, *more), n_waived=n_waived)._with_waves(rng)

    def _with_waves(self, rng: np.random.Generator) -> Task:
        """The task whose uncertain vehicles meet waves, each its own, where any are expected."""
        if (sea := self.expected.sea) is None or not sea.has_forces or not self.scenarios:
            return self
        run, n_inputs = self.experiment(self.still()), len(self.model.inputs)
        met = [in_own_waves(vehicle, run, sea, rng) for vehicle in self.scenarios]
        waves = ((one, run.commands(one.input_names)[:, n_inputs:]) for one, run in met)
        return replace(self, waves=tuple(waves))

    def assured(self, experiment: Experiment, rng: np.random.Generator) -> Assurance | None:
        """On how many fresh vehicles an experiment keeps the limits; None without caution."""
        if (caution := self.caution) is None:
            return None
        return assess_limits(
            self.model, experiment, rng=rng, limits=self.trial.limits, spread=caution.spread,
            prior=self.expected.prior, vehicles=caution.n_checks, wanted=caution.probability,
            sea=self.expected.sea, others=caution.others,
        )  # fmt: skip
