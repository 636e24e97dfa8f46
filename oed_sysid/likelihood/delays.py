r"""Delays of single signals, from the slope of what a model predicts.

An output that comes late by :math:`\tau` leaves :math:`-\tau\,\dot h` in its residual, an
input that acts late :math:`\tau\,\partial y/\partial\tau`, found by simulating with the shifted
input. With ``g`` this column and ``J`` those of all unknowns, in units of noise,

.. math:: I = g'g - g'J(J'J)^{+}J'g, \quad s = g'\epsilon - g'J(J'J)^{+}J'\epsilon, \quad
    \hat\tau = s/I, \quad \operatorname{std}\hat\tau = I^{-1/2},

a score test at delay zero with everything else estimated too (Cox & Hinkley 1974, ch. 9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.likelihood.estimate import Estimate

# Standard errors from which a departure counts: one output in 10^5 by chance.
CLEAR = 4.5
# Share of independent samples below which residuals are coloured.
COLOUR_SHARE = 0.8
# Share of the misfit beyond noise that a delay must explain where residuals are coloured.
DELAY_SHARE = 0.3


@dataclass(frozen=True)
class Delay:
    """Score estimate of the delay of one signal.

    Attributes
    ----------
    signal, kind : str
        Name, and ``output`` or ``input``.
    seconds, std : float
        Delay and standard error, s.
    gain : float
        What it explains, in twice the log-likelihood.
    share : float
        Of the misfit beyond noise.
    """

    signal: str
    kind: str
    seconds: float
    std: float
    gain: float
    share: float


def estimate_delays(fit: Estimate) -> tuple[Delay, ...]:
    """Score estimates of the delays of all outputs and inputs at a fit with white noise.

    See the equations above; residuals that are coloured enlarge the standard errors by the root
    of the ratio of all to independent samples, those larger than declared by their misfit.
    """
    runner, n_shared = kernel(fit.model), len(fit.names)
    free, own = fit.model.free_names, runner.n_own
    local = [name for name in free if name not in fit.names]
    width = own + len(local)
    inputs, outputs = fit.model.input_names, fit.model.output_names
    n_delays = len(outputs) + len(inputs)
    n_base = n_shared + width * len(fit.dataset)
    matrix = np.zeros((n_base + n_delays, n_base + n_delays))
    score = np.zeros(n_base + n_delays)
    squares, count = 0.0, 0
    for index, record in enumerate(fit.dataset):
        if record.n_samples < 3 or record.independent:
            continue
        values = values_of(fit, index)
        z0, dz0 = runner.start(fit.initial_states[index], record.inputs[0], values, record.times[0])
        run = runner.run(record.times, record.inputs, values, z0, sensitivities=True)
        sensitivities = run.output_sensitivities
        if sensitivities is None or not np.isfinite(sensitivities).all():
            return ()
        jacobian = sensitivities[:, :, : runner.n_full] @ dz0
        jacobian[:, :, own:] += sensitivities[:, :, runner.n_full :]
        order = [own + free.index(name) for name in fit.names]
        order += [*range(own), *(own + free.index(name) for name in local)]
        base = jacobian[:, :, order]
        late = np.zeros((*run.outputs.shape, n_delays))
        slope = np.gradient(run.outputs, record.times, axis=0)
        for column in range(len(outputs)):
            late[:, column, column] = -slope[:, column]
        shift = record.sample_time
        for column in range(len(inputs)):
            moved = record.inputs.copy()
            moved[:, column] = np.interp(
                record.times - shift, record.times, record.inputs[:, column]
            )
            if not np.array_equal(moved, record.inputs):
                after = runner.run(record.times, moved, values, z0).outputs
                late[:, :, len(outputs) + column] = (after - run.outputs) / shift
        scaled = fit.residuals[index] / fit.sigma
        present = np.isfinite(scaled)
        rows = np.concatenate([base, late], axis=2) / fit.sigma[:, None]
        rows = rows[present]
        errors = scaled[present]
        first = n_shared + index * width
        where = np.r_[0:n_shared, first : first + width, n_base : n_base + n_delays]
        if not np.isfinite(rows).all():
            return ()
        matrix[np.ix_(where, where)] += rows.T @ rows
        score[where] += rows.T @ errors
        squares, count = squares + float(errors @ errors), count + len(errors)
    information, slopes = _after_all_others(matrix, score, n_base)
    excess = max(squares - count, 1e-9)
    # Where the noise is larger than declared, errors are too.
    misfit = max(squares / max(count, 1), 1.0)
    slow = [max(n, 1) / max(effective, 1.0) for effective, n in fit.effective_samples().values()]
    found = []
    for column, (name, kind) in enumerate(
        [*((name, "output") for name in outputs), *((name, "input") for name in inputs)]
    ):
        own_information = information[column, column]
        if not own_information > 1e-9 * max(matrix[n_base + column, n_base + column], 1e-300):
            continue
        inflation = slow[column] if kind == "output" else max(slow)
        gain = float(slopes[column] ** 2 / own_information)
        found.append(
            Delay(
                name,
                kind,
                float(slopes[column] / own_information),
                float(np.sqrt(misfit * inflation / own_information)),
                gain,
                min(gain / excess, 1.0),
            )
        )
    return tuple(found)


def _after_all_others(
    matrix: np.ndarray, score: np.ndarray, n_base: int
) -> tuple[np.ndarray, np.ndarray]:
    """Information and score of the last unknowns once the first are estimated too."""
    inner = matrix[:n_base, :n_base]
    size = np.sqrt(np.maximum(np.diag(inner), 0.0))
    seen = size > 0
    unit = size[seen]
    values, vectors = np.linalg.eigh(inner[np.ix_(seen, seen)] / unit[:, None] / unit)
    clear = values > 1e-12 * values.max(initial=0.0)
    root = vectors[:, clear] / np.sqrt(values[clear])
    cross = (matrix[n_base:, :n_base][:, seen] / unit) @ root
    gradient = (score[:n_base][seen] / unit) @ root
    return matrix[n_base:, n_base:] - cross @ cross.T, score[n_base:] - cross @ gradient


def clear_delay(fit: Estimate, delays: Sequence[Delay]) -> Delay | None:
    """The one delay that explains most, if it is significant and worth a word."""
    clear = [d for d in delays if abs(d.seconds) > CLEAR * d.std]
    if not clear:
        return None
    coloured = any(
        effective < COLOUR_SHARE * n for effective, n in fit.effective_samples().values()
    )
    if coloured:
        clear = [d for d in clear if d.share > DELAY_SHARE]
    return max(clear, key=lambda d: d.gain, default=None)


def values_of(fit: Estimate, index: int) -> np.ndarray:
    """All parameter values in one record."""
    values = fit.model.value_vector
    names = fit.model.parameter_names
    for name, value in (fit.local_values[index] if fit.local_values else {}).items():
        values[names.index(name)] = value
    return values
