r"""Actuators that did not begin at their first command.

What an actuator remembers (the angle of a fin that lags, the side of a play) begins at the first
command of a record. Where the true one was :math:`s` beside it, the outputs miss
:math:`s\,\partial y/\partial m_0`, and parameters bend to it. As for delays
(:mod:`oed_sysid.likelihood.delays`), with ``g`` this column of one record, ``J`` those of all
unknowns
and :math:`\epsilon` the residuals, in units of noise,

.. math:: I = g'g - g'J(J'J)^{+}J'g, \quad \hat s = \frac{g'(1 - J(J'J)^{+}J')\epsilon}{I}, \quad
    \operatorname{std}\hat s = I^{-1/2} .

:func:`~oed_sysid.physics.unknown_start` makes it one of the unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.likelihood.delays import CLEAR, COLOUR_SHARE, DELAY_SHARE, values_of
from oed_sysid.likelihood.estimate import Estimate
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model


@dataclass(frozen=True)
class ActuatorStart:
    """Score estimate of where an actuator began in one record.

    Attributes
    ----------
    effect, signal, record : str
    size, std : float
        Actual value before the record less the first command, and its standard error, in the
        unit of the command.
    share : float
        Of the record's misfit beyond noise that it explains.
    """

    effect: str
    signal: str
    record: str
    size: float
    std: float
    share: float


def estimate_starts(fit: Estimate) -> tuple[ActuatorStart, ...]:
    """Score estimates of the starts of all actuators that begin at a command, largest first.

    Parameters
    ----------
    fit : Estimate
        To white noise. Residuals that are coloured enlarge the standard errors by the root of the
        ratio of all to independent samples, those larger than declared by their misfit.
    """
    columns = _memories(fit.model)
    if not columns:
        return ()
    runner = kernel(fit.model)
    n_shared, free = len(fit.names), fit.model.free_names
    local = [name for name in free if name not in fit.names]
    order = [runner.n_own + free.index(name) for name in fit.names]
    order += [*range(runner.n_own), *(runner.n_own + free.index(name) for name in local)]
    blocks, squares, count = [], 0.0, 0
    for index, record in enumerate(fit.dataset):
        if record.independent:
            continue
        found = _sensitivities(runner, fit, index)
        if found is None:
            return ()
        by_start, jacobian = found
        scaled = fit.residuals[index] / fit.sigma
        present = np.isfinite(scaled)
        late = np.stack([by_start[:, :, places].sum(axis=2) for _, _, places in columns], axis=2)
        rows = np.concatenate([jacobian[:, :, order], late], axis=2) / fit.sigma[:, None]
        blocks.append((record.name, rows[present], scaled[present]))
        squares, count = squares + float(scaled[present] @ scaled[present]), count + present.sum()
    slow = [max(n, 1) / max(some, 1.0) for some, n in fit.effective_samples().values()]
    inflation = max(squares / max(count, 1), 1.0) * max(slow, default=1.0)
    shared = np.zeros((n_shared, n_shared))
    parts = []
    for name, rows, errors in blocks:
        inside = rows[:, n_shared : len(order)]
        # Start states and parameters of the record itself, estimated along.
        apart = np.column_stack([rows[:, :n_shared], rows[:, len(order) :], errors])
        apart = apart - _projected(inside, apart)
        shared += apart[:, :n_shared].T @ apart[:, :n_shared]
        parts.append((name, apart, rows[:, len(order) :], errors))
    inverse = _inverse(shared)
    slope = sum((part[:, :n_shared].T @ part[:, -1] for _, part, _, _ in parts), np.zeros(n_shared))
    result = []
    for name, part, raw, errors in parts:
        for position, (effect, signal, _) in enumerate(columns):
            g = part[:, n_shared + position]
            cross = part[:, :n_shared].T @ g
            information = float(g @ g - cross @ inverse @ cross)
            if not information > 1e-9 * max(float(raw[:, position] @ raw[:, position]), 1e-300):
                continue
            size = float(g @ part[:, -1] - cross @ inverse @ slope) / information
            std = float(np.sqrt(inflation / information))
            excess = max(float(errors @ errors) - len(errors), 1e-9)
            share = min(size**2 * information / excess, 1.0)
            result.append(ActuatorStart(effect.name, signal, name, size, std, share))
    return tuple(sorted(result, key=lambda one: -abs(one.size / one.std)))


def clear_starts(fit: Estimate) -> tuple[ActuatorStart, ...]:
    """Starts that are not the first command, and, where residuals are coloured, worth a word."""
    clear = [one for one in estimate_starts(fit) if abs(one.size) > CLEAR * one.std]
    if any(some < COLOUR_SHARE * n for some, n in fit.effective_samples().values()):
        clear = [one for one in clear if one.share > DELAY_SHARE]
    return tuple(clear)


def _memories(model: Model) -> list[tuple[Effect, str, list[int]]]:
    """Effect, command and places in the full state of memories that begin at a command."""
    place = len(model.states) + sum(len(effect.states) for effect in model.effects)
    found = []
    for effect in model.effects:
        if effect.stage != "actuator":
            continue
        for signal in effect.terms:
            where = [place + i for i, m in enumerate(effect.memory) if m.initial == signal]
            if where:
                found.append((effect, signal, where))
        place += len(effect.memory)
    return found


def _sensitivities(
    runner: Kernel, fit: Estimate, index: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Derivatives of a record's outputs by the full start state, and by states and parameters."""
    record, values = fit.dataset[index], values_of(fit, index)
    z0, dz0 = runner.start(fit.initial_states[index], record.inputs[0], values, record.times[0])
    run = runner.run(record.times, record.inputs, values, z0, sensitivities=True)
    found = run.output_sensitivities
    if found is None or not np.isfinite(found).all():
        return None
    jacobian = found[:, :, : runner.n_full] @ dz0
    jacobian[:, :, runner.n_own :] += found[:, :, runner.n_full :]
    return found[:, :, : runner.n_full], jacobian


def _projected(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Part of some rows that columns explain."""
    size = np.linalg.norm(columns, axis=0)
    u, values, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    basis = u[:, values > 1e-9 * values.max(initial=0.0)]
    return np.asarray(basis @ (basis.T @ rows))


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of an information in the directions that it sees."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    scaled = matrix / scale[:, None] / scale
    inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    return np.asarray(inverse / scale[:, None] / scale)
