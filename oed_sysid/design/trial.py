"""Everything a design search needs, checked and put in arrays.

What shapes a design, so that a later call finds the steps of one that did not end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.design.assurance import Assurance, assess_limits
from oed_sysid.design.criteria import Criterion, Setting, log_determinant
from oed_sysid.design.library import as_piecewise
from oed_sysid.design.limits import Corridor
from oed_sysid.design.missing_effects import ByShifts, Chance, Completing, Discriminate, Reveal
from oed_sysid.design.objective import Objective, Scene, Score
from oed_sysid.design.vehicles import (
    Caution,
    Guards,
    Robust,
    draw_models,
    draw_structures,
    in_waves,
)
from oed_sysid.design.waveforms import Grid, Levels, Shape, neutral_within
from oed_sysid.errors import DataError, DesignError
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information.bound import disturbed_noise, information_of, prior_factor, triangle
from oed_sysid.information.noise import Colour, Noise, noise_of
from oed_sysid.information.noise import Levels as NoiseLevels
from oed_sysid.information.response import checked_noise
from oed_sysid.information.shifts import Shifts, joint_information, joint_prior
from oed_sysid.likelihood.archive import encode
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model
from oed_sysid.runtime.journal import Journal

# Failures allowed in the next round, beside what proportion says.
_STRICTER = 0.7


@dataclass(frozen=True, eq=False)
class Plan:
    """A checked design task; see :func:`~oed_sysid.design.design_experiment`."""

    model: Model
    models: tuple[Model, ...]
    limits: Limits
    grid: Grid
    corridor: Corridor
    criterion: Criterion | ByShifts
    softness: float | None
    positions: np.ndarray
    constants: dict[str, float]
    initial: dict[str, float]
    prior: Information | None
    start: str | Mapping[str, float]
    noise: Noise
    coloured: Colour
    sea: NoiseModel | None = None
    guards: tuple[Model, ...] = ()
    caution: Caution | None = None
    n_waived: int = 0
    shifts: Shifts | None = None
    joint_prior: np.ndarray | None = None
    raised: float = 1.0
    waves: tuple[tuple[Model, np.ndarray], ...] = ()

    def still(self) -> np.ndarray:
        """Neutral commands of all inputs, ``(n_times, n_inputs)``."""
        return np.broadcast_to(self._base, (len(self.grid.times), len(self.model.inputs))).copy()

    @property
    def _base(self) -> np.ndarray:
        base = np.array([self.constants.get(name, 0.0) for name in self.model.input_names])
        base[self.positions] = self.grid.neutral
        return base

    def designed(self, experiment: Experiment) -> np.ndarray:
        """Commands of the designed inputs in some experiment, ``(n_times, n_designed)``."""
        return simulate(self.model, experiment, noise=False).inputs[:, self.positions]

    def experiment(self, name: str, commands: np.ndarray) -> Experiment:
        """Return commands ``(n_times, n_inputs)`` as an experiment within the limits."""
        manoeuvres = [
            as_piecewise(i, self.grid.times, commands[:, p])
            for i, p in zip(self.grid.inputs, self.positions, strict=True)
        ]
        return Experiment(
            name, manoeuvres, duration=float(self.grid.times[-1]), sample_time=self.grid.step,
            constants=self.constants, initial=self.initial, limits=self.limits,
        )  # fmt: skip

    def bound(self, experiment: Experiment) -> Information:
        """Information after an experiment, prior knowledge included."""
        return information_of(
            self.model, experiment, noise=self.noise.sigma if self.sea is None else self.sea,
            coloured=self.coloured, priors=self.prior, start=self.start,
        )  # fmt: skip

    def worth(self, name: str, score: Score) -> float:
        """Criterion of commands under the random forces that are expected.

        A search sees white noise; what it found is chosen among with this.
        """
        if self.sea is None:
            return score.value
        experiment = self.experiment(name, score.commands)
        if isinstance(self.criterion, ByShifts):
            assert self.shifts is not None
            measure = self.criterion.bind_shifts(self.shifts, len(self._scales))
            return measure(self.joint(experiment))[0]
        found = self.bound(experiment)
        setting = Setting(self.model, found.names, self._scales, self.noise)
        matrix = found.matrix * self._scales[:, None] * self._scales
        return self.criterion.bind(setting)(matrix)[0]

    @property
    def _scales(self) -> np.ndarray:
        """Units of the shared parameters in all matrices."""
        return np.array([p.magnitude for p in self.model.free_parameters if not p.per_record])

    def joint(self, experiment: Experiment | None) -> np.ndarray:
        """Scaled information on ``[parameters, shifts]``, that in hand included; None: only that.

        Raises
        ------
        DesignError
            If the criterion does not ask for shifts.
        """
        if self.shifts is None or self.joint_prior is None:
            raise DesignError(f"The criterion {self.criterion.name!r} asks for no absent effect.")
        matrix = self.joint_prior
        if experiment is not None:
            matrix = matrix + joint_information(
                self.model, experiment, self.shifts, coloured=self.coloured, start=self.start,
                noise=self.noise.sigma if self.sea is None else self.sea,
            )  # fmt: skip
        units = np.concatenate([self._scales, np.ones(len(self.shifts))])
        return matrix * units[:, None] * units

    def told_under_forces(self, experiment: Experiment) -> Plan:
        """The plan whose search sees white noise as high as makes a run tell what it will tell.

        Without it a search by shifts would take records in hand, judged under the random forces,
        for worse than what it may plan.
        """
        if self.sea is None or not isinstance(self.criterion, ByShifts):
            return self
        told = [
            information_of(self.model, experiment, noise=noise, priors=None).matrix
            for noise in (self.noise.sigma, self.sea)
        ]
        units = self._scales[:, None] * self._scales
        white, forced = (log_determinant(matrix * units) for matrix in told)
        n = len(self._scales)
        return replace(self, raised=float(np.exp(0.5 * max(white - forced, 0.0) / n)))

    def objective(self, shape: Shape | None, n_workers: int) -> Objective:
        """Return the function to maximise; without a shape only given commands can be scored."""
        used = shape if shape is not None else Levels(2).on(self.grid)
        scenes, measures, priors = [], [], []
        own = self.own
        for member in self.models:
            shifts: Shifts | None = None
            if isinstance(self.criterion, ByShifts):
                shifts = self.shifts if member is self.model else self.criterion.shifts(member)
            noise = replace(self.noise, sigma=self.raised * self.noise.sigma)
            scene = Scene(
                member, self.grid.times, used.edges, own, noise, start=self.start, shifts=shifts
            )
            scales = scene.scales[scene.n_nuisance :]
            if isinstance(self.criterion, ByShifts):
                assert shifts is not None
                measures.append(self.criterion.bind_shifts(shifts, len(scene.names)))
            else:
                measures.append(
                    self.criterion.bind(Setting(member, scene.names, scales, self.noise))
                )
            matrix = np.zeros((len(scales), len(scales)))
            if shifts is not None:
                matrix = self.joint(None)
            elif self.prior is not None:
                matrix = self.prior.matrix * scales[:, None] * scales
            scenes.append(scene)
            priors.append(matrix)
        guards = None
        if self.caution is not None and self.corridor.names and self.guards:
            guards = Guards(
                self.guards, self.grid.times, scenes[0].edges, own, self.corridor, self.n_waived,
                self.waves,
            )  # fmt: skip
        return Objective(
            scenes, measures, priors, used, self.positions, self._base, self.corridor,
            softness=self.softness, n_workers=n_workers, guards=guards,
        )  # fmt: skip

    @property
    def own(self) -> np.ndarray:
        """Start state, ``(n_own,)``."""
        return np.array([self.initial.get(n, 0.0) for n in self.model.state_names])

    def stricter(self, found: Assurance, rng: np.random.Generator) -> Plan:
        """Return the plan with more uncertain vehicles, of which fewer may fail.

        Parameters
        ----------
        found : Assurance
            What this plan led to; it was not enough.
        rng : numpy.random.Generator
        """
        caution = self.caution
        if caution is None:
            return self
        more = draw_structures(
            self.model, caution.others, caution.spread, caution.n_sets, self.prior, rng
        )
        share = (1 - caution.probability) / max(1 - found.probability, 1e-3)
        n_sets = len(self.guards) + len(more)
        allowed = int(_STRICTER * share * self.n_waived * n_sets / len(self.guards))
        # Without progress by counting, none may fail any more.
        n_waived = allowed if allowed < self.n_waived * n_sets / len(self.guards) else 0
        wider = replace(self, guards=(*self.guards, *more), n_waived=n_waived)
        return wider.with_waves(rng)

    def with_waves(self, rng: np.random.Generator) -> Plan:
        """The plan whose uncertain vehicles meet waves, each its own, where any are expected."""
        if self.sea is None or not self.sea.has_forces or not self.guards:
            return self
        still = self.experiment("waves", self.still())
        return replace(self, waves=in_waves(self.guards, still, self.sea, rng))

    def assured(self, experiment: Experiment, rng: np.random.Generator) -> Assurance | None:
        """On how many fresh vehicles an experiment keeps the limits; None without caution."""
        if self.caution is None:
            return None
        return assess_limits(
            self.model, experiment, rng=rng, limits=self.limits, spread=self.caution.spread,
            prior=self.prior, n_vehicles=self.caution.n_checks, wanted=self.caution.probability,
            sea=self.sea, others=self.caution.others,
        )  # fmt: skip

    def misfits(self, experiment: Experiment) -> dict[tuple[str, str], float]:
        """Expected gain of every rival over every other, at the nominal values."""
        if not isinstance(self.criterion, Discriminate) or self.shifts is None:
            return {}
        return self.criterion.misfits(
            self.model, self.shifts, self.joint(experiment), len(self._scales)
        )

    def chances(self, experiment: Experiment) -> tuple[Chance, ...]:
        """How surely every candidate would show, before and after; empty for other criteria."""
        if not isinstance(self.criterion, Reveal) or self.shifts is None:
            return ()
        return self.criterion.chances(
            self.shifts, self.joint(None), self.joint(experiment), len(self._scales)
        )


def plan_of(
    given: Model | Fit,
    *,
    limits: Limits,
    duration: float,
    sample_time: float,
    rng: np.random.Generator,
    criterion: Criterion | ByShifts | Robust,
    inputs: Sequence[str] | None,
    constants: Mapping[str, float] | None,
    neutral: Mapping[str, float] | None,
    initial: Mapping[str, float] | None,
    end: Mapping[str, tuple[float, float]] | None,
    prior: str | Information | None,
    start: str | Mapping[str, float],
    noise: NoiseLevels | NoiseModel | Fit,
    coloured: Colour,
    caution: Caution | None = None,
) -> Plan:
    """Check a design task; the parameters are those of ``design_experiment``."""
    model = given.model if isinstance(given, Fit) else given
    if isinstance(given, Fit) and noise is None:
        noise = given
    limits.check_names(model)
    held = {k: float(v) for k, v in (constants or {}).items()}
    names = tuple(inputs) if inputs is not None else tuple(
        n for n in model.input_names if n in limits.inputs and n not in held
    )  # fmt: skip
    _check_inputs(model, limits, names, held)
    own_start = {k: float(v) for k, v in (initial or {}).items()}
    if unknown := [n for n in own_start if n not in model.state_names]:
        raise DesignError(
            f"The start names {unknown[0]!r}, but model {model.name!r} has the states "
            f"{', '.join(model.state_names)}."
        )
    model, sea, sigma = nominal_noise(model, noise)
    levels = noise_of(model, sigma, coloured)
    known = knowledge(given, model, prior)
    robust = criterion if isinstance(criterion, Robust) else None
    judged: Criterion | ByShifts = robust.criterion if robust else criterion  # type: ignore[assignment]
    shifts = judged.shifts(model) if isinstance(judged, ByShifts) else None
    joint = None
    if isinstance(judged, Completing):
        joint = judged.known
    elif shifts is not None:
        joint = joint_knowledge(
            given, model, shifts, sigma if sea is None else sea, prior, coloured
        )
    plan = Plan(
        model=model,
        models=(
            (model, *draw_models(model, robust.spread, robust.n_sets, known, rng))
            if robust
            else (model,)
        ),
        guards=(
            draw_structures(model, caution.others, caution.spread, caution.n_sets, known, rng)
            if caution
            else ()
        ),
        limits=limits,
        grid=_grid(model, limits, names, neutral or {}, duration, sample_time),
        corridor=Corridor.of(model, limits, end or {}, kernel(model).n_full),
        criterion=judged,
        softness=robust.softness if robust and robust.worst else None,
        positions=np.array([model.input_names.index(n) for n in names]),
        constants=held,
        initial=own_start,
        prior=known,
        start=start,
        noise=levels,
        coloured=coloured,
        sea=sea,
        caution=caution,
        n_waived=caution.n_waived if caution else 0,
        shifts=shifts,
        joint_prior=joint,
    )
    return plan.with_waves(rng)


def _check_inputs(
    model: Model, limits: Limits, names: tuple[str, ...], held: Mapping[str, float]
) -> None:
    if not names:
        raise DesignError(
            "No input is left to design. Give its range: Limits(inputs={'rudder': (-0.3, 0.3)}), "
            "on the command line --limit rudder=-17:17."
        )
    for name in names:
        if name not in model.input_names:
            raise DesignError(
                f"Model {model.name!r} has no input {name!r}. It has "
                f"{', '.join(model.input_names)}."
            )
        pair = limits.inputs.get(name)
        if pair is None or not np.all(np.isfinite(pair)):
            raise DesignError(
                f"The input {name!r} is to be designed but has no finite range. Give "
                f"Limits(inputs={{{name!r}: (lower, upper)}}), on the command line "
                f"--limit {name}=LOWER:UPPER."
            )
    for name in model.input_names:
        if name not in names and name not in held:
            raise DesignError(
                f"The input {name!r} is neither designed nor constant. Give "
                f"constants={{{name!r}: value}} or a range in the limits, on the command line "
                f"--limit {name}=LOWER:UPPER or --like with an experiment that holds it."
            )


def _grid(
    model: Model,
    limits: Limits,
    names: tuple[str, ...],
    neutral: Mapping[str, float],
    duration: float,
    sample_time: float,
) -> Grid:
    if not (sample_time > 0 and duration >= 10 * sample_time):
        raise DesignError(
            f"A run of {duration} s with a sample every {sample_time} s cannot be designed. Give a "
            "duration of ten samples or more."
        )
    lower, upper = np.array([limits.inputs[n] for n in names]).T
    rest = np.array([neutral.get(n, neutral_within(*limits.inputs[n])) for n in names])
    if np.any(rest < lower) or np.any(rest > upper):
        raise DesignError("A neutral command lies outside the range of its input. Correct it.")
    n_steps = int(np.floor(duration / sample_time + 1e-9))
    rates = np.array([limits.rates.get(n, np.inf) for n in names], dtype=float)
    # The rate is checked on differences of floating-point sums.
    return Grid(np.arange(n_steps + 1) * sample_time, names, lower, upper, rest, rates * (1 - 1e-9))


def nominal_noise(
    model: Model, noise: NoiseLevels | NoiseModel | Fit
) -> tuple[Model, NoiseModel | None, np.ndarray]:
    """Return the model with the sensors' levels in use, what is not white, and these levels.

    The levels belong to the model, so that reports and cards state them.
    """
    sea = disturbed_noise(noise)
    if sea is not None:
        sea = checked_noise(model, sea)
        noise = sea.sensors
    elif isinstance(noise, Fit):
        noise = noise.sigma
    sigma = noise_of(model, noise).sigma  # type: ignore[arg-type]
    outputs = tuple(
        replace(o, noise_std=float(s)) for o, s in zip(model.outputs, sigma, strict=True)
    )
    return replace(model, outputs=outputs), None if sea is None or sea.is_white else sea, sigma


def knowledge(
    given: Model | Fit, model: Model, prior: str | Information | None
) -> Information | None:
    """What is known before the experiment, on all shared free parameters."""
    shared = [p for p in model.free_parameters if not p.per_record]
    names = tuple(p.name for p in shared)
    scales = np.array([p.magnitude for p in shared])
    if prior is None:
        return None
    if isinstance(prior, Information):
        rows = prior_factor(model, names, prior)
    elif prior != "auto":
        raise DesignError(f"prior is {prior!r}. Choose 'auto', None or an Information.")
    elif isinstance(given, Fit):
        information = given.information
        if _has_own_errors(given):
            # Colour, scatter: what the fit really knows is the covariance that it states.
            information = Information.from_matrix(
                given.names, np.linalg.inv(given.covariance), information.scales
            )
        rows = prior_factor(model, names, information)
    else:
        rows = prior_factor(model, names, "model")
    if not rows.any():
        return None
    return Information(names, triangle(rows) * scales, scales)


def _has_own_errors(fit: Fit) -> bool:
    """Whether a fit states another covariance than the inverse of its information."""
    if not len(fit.names) or not np.all(np.isfinite(fit.covariance)):
        return False
    return not np.allclose(fit.covariance, fit.information.covariance, rtol=1e-9, atol=0.0)


def joint_knowledge(
    given: Model | Fit,
    model: Model,
    shifts: Shifts,
    noise: NoiseModel | np.ndarray,
    prior: str | Information | None,
    coloured: Colour = None,
) -> np.ndarray:
    """What is known before the experiment on shared parameters and absent effects together.

    A fit brings its records, judged at its values: what they would have shown is known.

    Returns
    -------
    ndarray (n_shared + n_columns, n_shared + n_columns)
        Parameters in SI units, effects in units of their size.
    """
    shared = tuple(p.name for p in model.free_parameters if not p.per_record)
    if not (isinstance(given, Fit) and isinstance(prior, str) and prior == "auto"):
        known = knowledge(given, model, prior)
        matrix = np.zeros((len(shared),) * 2) if known is None else known.matrix
        return joint_prior(matrix, len(shifts))
    rows = prior_factor(model, shared, "model")
    told = joint_information(
        model, given.dataset, shifts, noise=noise, coloured=coloured,
        initial_states=given.initial_states,
    )  # fmt: skip
    return joint_prior(rows.T @ rows, len(shifts)) + told


def opened(journal: Journal | None, settings: Mapping[str, Any]) -> Journal:
    """Open a journal for one design.

    Parameters
    ----------
    journal : Journal or None
        None keeps nothing.
    settings : mapping of str to object
        Every argument that shapes the result.

    Returns
    -------
    Journal
        With steps of an earlier call with equal settings, if there was one. Settings of which
        equality cannot be told, such as a criterion that is no dataclass, keep nothing.
    """
    keep = journal or Journal()
    if keep.folder is None:
        return keep
    try:
        content = encode(dict(settings))
    except DataError:
        return Journal()
    keep.open({"task": "design", "settings": content})
    return keep
