"""The error that the true structure leaves, fitted to the same records by the same means."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from oed_sysid.diagnosis.greybox import GreyBox, Task, estimate
from oed_sysid.diagnosis.linearise import SuperModel, deviations
from oed_sysid.diagnosis.workbench import Workbench

from benchmarks.missing_physics.simulator import Case
from oed_sysid import Force, Parameter
from oed_sysid.data.dataset import Dataset
from oed_sysid.diagnosis.improvement import Improvement
from oed_sysid.diagnosis.rank import threshold
from oed_sysid.effects import Effect
from oed_sysid.noise.kalman import NoiseModel
from oed_sysid.problem import Problem

# The hidden terms that no vocabulary holds, as a user would write them.
UNKNOWN_TERMS = {
    "unknown_cubic_pitch_damping": ("M", "q**3"),
    "unknown_speed_pitch_damping": ("M", "u_r*q*abs(q)"),
    "unknown_pitch_moment_wq": ("M", "w_r*q"),
    "unknown_heave_rate_drag": ("Z", "w_r*abs(q)"),
    "unknown_pitch_drift_damping": ("M", "q*abs(w_r)"),
    "unknown_cubic_moment": ("M", "w_r**3"),
    "unknown_cubic_drag": ("X", "u_r**3"),
    "unknown_thrust_moment": ("M", "T"),
    "unknown_fin_in_slipstream": ("M", "T*ds"),
    "unknown_double_angle_moment": ("M", "sin(theta)*cos(theta)"),
}


@dataclass(frozen=True)
class Truth:
    """What could be known.

    Attributes
    ----------
    gain : float
        Twice the log-likelihood that the true structure gains on the believed one.
    gains : dict
        The same for each hidden effect when all others are in the model.
    needed : float
        Gain that a claim needs.
    train_error, test_error : float
        Of the true structure, in units of the noise.
    """

    gain: float
    gains: Mapping[str, float]
    needed: float
    train_error: float
    test_error: float

    @property
    def detectable(self) -> bool:
        """Whether every hidden effect shows."""
        return all(gain > self.needed for gain in self.gains.values())


def true_structure(
    problem: Problem, train: Dataset, test: Dataset, case: Case, found: Improvement
) -> Truth:
    """Fit the true structure, from the improvement's base fit and from the truth."""
    effects = [_effect(problem, name) for name in case.effects]
    if not effects:  # the believed structure is the true one
        error = found.base_error
        return Truth(0.0, {}, threshold(len(problem.effects), 1), error["train"], error["test"])
    known = [effect for effect in problem.effects if effect not in effects]
    unknown = any(name in UNKNOWN_TERMS for name in case.effects)
    candidates = effects if unknown else [*problem.effects]
    bench = _bench(problem, train, test, candidates, found.base_fit)
    sigma = np.array([output.noise_std for output in problem.model.outputs])
    amplitudes: dict[str, float] = {}
    for effect in effects:
        amplitudes.update(_true_values(effect, case))
    fits: dict[str, GreyBox] = {}
    for left_out in ("", *(case.effects if len(case.effects) > 1 else ())):
        names = [*problem.model.free_names]
        for effect in effects:
            if effect.name != left_out:
                names += [*effect.amplitude_names, *effect.shape_names]
        kept = {k: v for k, v in amplitudes.items() if k in names}
        fits[left_out] = _best_fit(bench, found.base_fit, names, kept, case.derivatives)
    full = fits[""]
    freedom = max(len(e.amplitude_names) + len(e.shape_names) for e in effects)
    base = found.base_fit.objective
    gains = {n: fits.get(n, found.base_fit).objective - full.objective for n in case.effects}
    errors = bench.errors(full, sigma)
    return Truth(
        gain=base - full.objective,
        gains=gains,
        needed=threshold(len(known) + len(effects), freedom),
        train_error=errors["train"],
        test_error=errors["test"],
    )


def _effect(problem: Problem, name: str) -> Effect:
    if name in UNKNOWN_TERMS:
        axis, term = UNKNOWN_TERMS[name]
        size = Parameter(f"E_{name}", 0.0, "1", scale=1.0)
        return Force(name, {axis: f"{size.name}*{term}"}, (size,), amplitudes=(size.name,))
    return next(effect for effect in problem.effects if effect.name == name)


def _true_values(effect: Effect, case: Case) -> dict[str, float]:
    size = case.effects[effect.name]
    if effect.name == "wave_heave_force":
        cosine, sine = effect.amplitude_names
        phase = case.wave_phase
        return {
            cosine: size * math.cos(phase),
            sine: -size * math.sin(phase),
            effect.shape_names[0]: case.wave_frequency,
        }
    if effect.name == "fin_rate_limit":
        size = 1.0 / size
    return {effect.amplitude_names[0]: size}


def _bench(
    problem: Problem, train: Dataset, test: Dataset, candidates: Sequence[Effect], fit: GreyBox
) -> Workbench:
    """The bench along the base fit of an improvement, without fitting it again."""
    super_model = SuperModel.build(problem.model, candidates)
    base = problem.model.with_values(dict(fit.values))
    lines = deviations(base, train, [run.states for run in fit.runs])
    white = np.array([output.noise_std for output in problem.model.outputs])
    force = np.maximum(fit.noise.force, np.max(fit.noise.force) * 0.1 + 1e-3)
    units = NoiseModel(white, white, force, fit.noise.colour_time, fit.noise.force_time)
    task = Task(super_model, train, lines, units, known_noise=False)
    return Workbench(task, replace(task, dataset=test, deviations=()))


def _best_fit(
    bench: Workbench,
    base: GreyBox,
    names: Sequence[str],
    amplitudes: Mapping[str, float],
    derivatives: Mapping[str, float],
) -> GreyBox:
    """Most likely fit of one structure over both starts, settled in its own linearisation."""
    starts = [dict(base.values) | dict(amplitudes)]
    starts.append(starts[0] | dict(derivatives))
    fits = []
    for start in starts:
        found = estimate(bench.train, names, start, base.initial, base.noise)
        if found is not None:
            fits.append(found)
    best = min(fits, key=lambda fit: fit.objective)
    return bench.settle(best)[1]
