"""Score test: how much each candidate would explain, without refitting.

With residual ``r``, existing sensitivities ``J`` and a candidate's ``s``, all
in the metric of the noise model, the existing unknowns are projected out and
``(s'r)^2 / s's`` of what is left is, for a candidate that is absent, a
chi-squared variable (Rao 1948).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from oed_sysid.diagnosis.greybox import GreyBox, Task, whitened
from oed_sysid.effects import Effect
from oed_sysid.parameters import Parameter

# Values of a shape parameter (a frequency, a time constant) that are tried, of the first and of
# every other one.
N_SHAPES, N_OTHER_SHAPES = 11, 3
# What is left of a candidate after projection, below which it is another name for a
# combination of parameters that are free already.
ABSORBED = 1e-3


@dataclass(frozen=True, eq=False)
class Score:
    """Evidence for one absent effect.

    Attributes
    ----------
    effect : Effect
    statistic : float
        Chi-squared statistic of the amplitudes, best shape.
    freedom : int
        Amplitudes and shape parameters.
    estimate : dict
        One-step estimate of amplitudes (and the shape that goes with it).
    std_errors : dict
        Standard errors of the amplitudes.
    distinct : float
        Share of the effect's signature that free parameters cannot imitate.
    signature : ndarray (n_rows, n_amplitudes)
        Whitened sensitivities with existing unknowns projected out.
    """

    effect: Effect
    statistic: float
    freedom: int
    estimate: dict[str, float]
    std_errors: dict[str, float]
    distinct: float
    signature: np.ndarray

    @property
    def absorbed(self) -> bool:
        """Whether the free parameters imitate the effect completely."""
        return self.distinct < ABSORBED


@dataclass(frozen=True, eq=False)
class _Variant:
    """Columns of one candidate at one shape."""

    effect: Effect
    amplitudes: tuple[str, ...]
    shape: dict[str, float]
    columns: list[np.ndarray]


def scores(
    task: Task, fit: GreyBox, candidates: Sequence[Effect]
) -> tuple[list[Score], np.ndarray]:
    """Score every candidate at a fit.

    Parameters
    ----------
    task : Task
        Its super-model holds the candidates.
    fit : GreyBox
        Fit of the present model.
    candidates : sequence of Effect
        Absent effects.

    Returns
    -------
    scores : list of Score
        Largest statistic first.
    residual : ndarray (n_rows,)
        Whitened residual with the existing unknowns projected out.
    """
    variants = _variants(task, fit, candidates)
    if not variants:
        return [], np.zeros(0)
    columns = [
        np.concatenate([v.columns[index] for v in variants], axis=2)
        for index in range(len(fit.initial))
    ]
    system = whitened(task, fit, columns)
    n_extra = columns[0].shape[2]
    known, extra = system.jacobian[:, :-n_extra], system.jacobian[:, -n_extra:]
    known = known[:, np.linalg.norm(known, axis=0) > 0]
    basis, _ = np.linalg.qr(known / np.linalg.norm(known, axis=0))
    residual = system.residual - basis @ (basis.T @ system.residual)
    projected = extra - basis @ (basis.T @ extra)
    best: dict[str, Score] = {}
    begin = 0
    for variant in variants:
        block = slice(begin, begin + len(variant.amplitudes))
        begin = block.stop
        score = _score(variant, extra[:, block], projected[:, block], residual)
        name = variant.effect.name
        if name not in best or score.statistic > best[name].statistic:
            best[name] = score
    return sorted(best.values(), key=lambda s: -s.statistic), residual


def _score(
    variant: _Variant, raw: np.ndarray, projected: np.ndarray, residual: np.ndarray
) -> Score:
    effect = variant.effect
    size = np.linalg.norm(raw, axis=0)
    left = np.linalg.norm(projected, axis=0)
    distinct = float(np.min(left / np.where(size > 0, size, np.inf)))
    freedom = len(effect.amplitude_names) + len(effect.shape_names)
    if distinct < ABSORBED:
        nothing = dict.fromkeys(variant.amplitudes, 0.0)
        endless = dict.fromkeys(variant.amplitudes, np.inf)
        return Score(effect, 0.0, freedom, nothing, endless, distinct, 0 * projected)
    matrix = projected.T @ projected
    right = projected.T @ residual
    amplitude = np.linalg.solve(matrix, right)
    errors = np.sqrt(np.diag(np.linalg.inv(matrix)))
    statistic = float(right @ amplitude)
    lower = [_parameter(effect, name).lower for name in variant.amplitudes]
    upper = [_parameter(effect, name).upper for name in variant.amplitudes]
    if len(amplitude) == 1 and (lower[0] >= 0 > amplitude[0] or upper[0] <= 0 < amplitude[0]):
        statistic, amplitude = 0.0, np.zeros(1)
    estimate = dict(zip(variant.amplitudes, np.clip(amplitude, lower, upper), strict=True))
    return Score(
        effect,
        statistic,
        freedom,
        {name: float(value) for name, value in (estimate | variant.shape).items()},
        dict(zip(variant.amplitudes, map(float, errors), strict=True)),
        distinct,
        projected,
    )


def _parameter(effect: Effect, name: str) -> Parameter:
    return next(p for p in effect.parameters if p.name == name)


def _variants(task: Task, fit: GreyBox, candidates: Sequence[Effect]) -> list[_Variant]:
    """Columns of every candidate, for every shape it may have."""
    smooth = [
        name
        for effect in candidates
        if not effect.shape_names
        if two_sided(effect)
        for name in effect.amplitude_names
    ]
    found = task.super_model.run(task.dataset, fit.initial, fit.values, smooth)
    n_own = len(fit.initial[0])
    variants = []
    for effect in candidates:
        amplitudes = effect.amplitude_names
        if effect.shape_names:
            for shape in _shapes(effect):
                runs = task.super_model.run(
                    task.dataset, fit.initial, dict(fit.values) | shape, amplitudes
                )
                if runs is not None:
                    parts = [r.jacobian[:, :, n_own:] for r in runs if r.jacobian is not None]
                    variants.append(_Variant(effect, amplitudes, shape, parts))
        elif all(name in smooth for name in amplitudes):
            if found is not None:
                where = [n_own + smooth.index(name) for name in amplitudes]
                parts = [r.jacobian[:, :, where] for r in found if r.jacobian is not None]
                variants.append(_Variant(effect, amplitudes, {}, parts))
        else:
            secant = _secant(task, fit, effect)
            if secant is not None:
                variants.append(_Variant(effect, amplitudes, {}, secant))
    return variants


def two_sided(effect: Effect) -> bool:
    """Whether amplitudes may have either sign; other effects often have a kink at zero."""
    return all(_parameter(effect, name).lower < 0 for name in effect.amplitude_names)


def _secant(task: Task, fit: GreyBox, effect: Effect) -> list[np.ndarray] | None:
    """Change of the outputs from nothing to the typical amplitude, per unit of it."""
    sizes = {name: _parameter(effect, name).magnitude for name in effect.amplitude_names}
    runs = task.super_model.run(
        task.dataset, fit.initial, dict(fit.values) | sizes, sensitivities=False
    )
    if runs is None:
        return None
    total = sum(sizes.values())
    return [
        ((moved.outputs - still) / total)[:, :, None]
        for moved, still in zip(runs, fit.outputs, strict=True)
    ]


def _shapes(effect: Effect) -> list[dict[str, float]]:
    """Grid over the bounds of the shape parameters, fine in the first and coarse in others."""
    axes = []
    for position, name in enumerate(effect.shape_names):
        parameter = _parameter(effect, name)
        low, high = parameter.lower, parameter.upper
        if not (np.isfinite(low) and np.isfinite(high)):
            low, high = sorted((0.5 * parameter.value, 2.0 * parameter.value))
        axes.append(np.linspace(low, high, N_SHAPES if position == 0 else N_OTHER_SHAPES))
    return [
        dict(zip(effect.shape_names, map(float, point), strict=True)) for point in product(*axes)
    ]
