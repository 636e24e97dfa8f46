"""The error that the true structure leaves, fitted to the same records by the same means."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.missing_physics.simulator import Case
from oed_sysid import Force, Parameter
from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.improve import relative
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.evidence.rank import threshold
from oed_sysid.evidence.study import Study
from oed_sysid.experiments.problem import Problem
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.physics import Effect

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
    """Fit the true structure, from the nominal model's fit and from the truth."""
    effects = [_effect(problem, name) for name in case.effects]
    if not effects:  # the nominal structure is the true one
        error = found.base_error
        return Truth(0.0, {}, threshold(len(problem.effects), 1), error["train"], error["test"])
    known = [effect for effect in problem.effects if effect not in effects]
    unknown = any(name in UNKNOWN_TERMS for name in case.effects)
    candidates = effects if unknown else [*problem.effects]
    study, base = Study.begin(problem.model, train, test, candidates, known_noise=False)
    amplitudes: dict[str, float] = {}
    for effect in effects:
        amplitudes.update(_true_values(effect, case))
    fits: dict[str, FilteredSolution] = {}
    for left_out in ("", *(case.effects if len(case.effects) > 1 else ())):
        kept = [effect for effect in effects if effect.name != left_out]
        fits[left_out] = _best_fit(study, base, kept, amplitudes, case.derivatives)
    full = fits[""]
    freedom = max(len(e.amplitude_names) + len(e.shape_names) for e in effects)
    gains = {name: fits.get(name, base).objective - full.objective for name in case.effects}
    sigma = np.array([output.noise_std for output in problem.model.outputs])
    errors = relative(
        {"train": study.rms(full, train), "test": study.rms(full, test)}, sigma, study
    )
    return Truth(
        gain=base.objective - full.objective,
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


def _best_fit(
    study: Study,
    base: FilteredSolution,
    effects: Sequence[Effect],
    amplitudes: Mapping[str, float],
    derivatives: Mapping[str, float],
) -> FilteredSolution:
    """Most likely fit of one structure, from the nominal fit, with true sizes, and the truth."""
    start = dict(base.values) | dict(amplitudes)
    found = [
        study.estimate(effects, values, base, noise=study.loosened(base.noise), max_iterations=25)
        for values in (dict(base.values), start, start | dict(derivatives))
    ]
    best = min((fit for fit in found if fit is not None), key=lambda fit: fit.objective)
    return study.settle(best)
