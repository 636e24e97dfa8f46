"""Normal equations of the segments of a record, gathered while the trajectory runs.

Least squares over independent segments needs of each the products of its
sensitivities and residuals only. Compiled code sums them sample by sample, so
that sensitivities are never written to memory; without a compiler NumPy forms
the same sums from :meth:`oed_sysid.compiled.kernels.Kernel.run`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.compile import call, doubles
from oed_sysid.compiled.kernels import Kernel, Run


@dataclass(frozen=True, eq=False)
class Blocks:
    """Sums over the samples of each segment.

    Attributes
    ----------
    gram : ndarray (n_segments, n_columns + 1, n_columns + 1)
        Products ``[J r]' [J r]`` of scaled sensitivities, by the segment's start
        state and the free parameters, and scaled residuals (measured minus model).
    ends : ndarray (n_segments, n_full) or None
        State at the next segment's first sample.
    end_sensitivities : ndarray (n_segments, n_full, n_columns) or None
        Its derivatives.
    """

    gram: np.ndarray
    ends: np.ndarray | None
    end_sensitivities: np.ndarray | None


@dataclass(frozen=True, eq=False)
class Elimination:
    """Normal equations of the parameters, start states eliminated.

    Attributes
    ----------
    matrix : ndarray (n_free, n_free)
    right : ndarray (n_free,)
    solved : ndarray (n_segments, n_full, n_free + 1)
        Start states answer a step of the parameters by the last column minus
        the others times that step.
    gain : float
        Right-hand sides times solutions of the start states: twice what they
        alone would gain.
    """

    matrix: np.ndarray
    right: np.ndarray
    solved: np.ndarray
    gain: float


def gather(
    kernel: Kernel,
    times: np.ndarray,
    inputs: np.ndarray,
    values: np.ndarray,
    nodes: np.ndarray,
    measured: np.ndarray,
    sigma: np.ndarray,
    *,
    starts: np.ndarray,
    linked: bool,
) -> Blocks | None:
    """Integrate the segments of one record and gather their normal equations.

    Parameters
    ----------
    kernel : Kernel
        Of the model.
    times, inputs, values, starts
        As :meth:`oed_sysid.compiled.kernels.Kernel.run` takes them.
    nodes : ndarray (n_segments, n_full)
        Full state at the start of each segment.
    measured : ndarray (n_times, n_outputs)
        Measurements; NaN weighs nothing.
    sigma : ndarray (n_outputs,)
        Standard deviations of the noise.
    linked : bool
        Whether ends and their derivatives are wanted.

    Returns
    -------
    Blocks or None
        None where a trajectory or a sum is not finite.
    """
    n_segments, size = len(starts), kernel.n_columns + 1
    if kernel.library is None:
        run = kernel.run(times, inputs, values, nodes, starts=starts, sensitivities=True)
        return _summed(run, measured, sigma, starts, linked)
    starts = np.ascontiguousarray(starts, dtype=np.intc)
    gram = np.empty((n_segments, size, size))
    ends = np.empty((n_segments, kernel.n_full)) if linked else None
    dends = np.empty((n_segments, kernel.n_full, kernel.n_columns)) if linked else None
    times, inputs, values, nodes, measured, weight = doubles(
        times, inputs, values, nodes, measured, 1.0 / sigma
    )
    failed = call(
        kernel.library.kernel_gather, len(times), times, inputs, values, float(kernel.model.step),
        n_segments, starts, nodes, measured, weight, gram, ends, dends,
    )  # fmt: skip
    if failed >= 0 or not np.isfinite(gram).all():
        return None
    return Blocks(gram, ends, dends)


def _summed(
    run: Run, measured: np.ndarray, sigma: np.ndarray, starts: np.ndarray, linked: bool
) -> Blocks | None:
    """The same sums by NumPy, from a run with its sensitivities."""
    if not run.ok or run.output_sensitivities is None:
        return None
    present = np.isfinite(measured)
    scaled = np.where(present, measured - run.outputs, 0.0) / sigma
    rows = run.output_sensitivities * (present / sigma)[:, :, None]
    both = np.concatenate([rows, scaled[:, :, None]], axis=2)
    with np.errstate(over="ignore", invalid="ignore"):
        # A segment's gram is [J r]' [J r] over its own rows.
        parts = [part.reshape(-1, both.shape[2]) for part in np.split(both, starts[1:])]
        gram = np.array([part.T @ part for part in parts])
    if not np.isfinite(gram).all():
        return None
    return Blocks(gram, run.ends, run.end_sensitivities) if linked else Blocks(gram, None, None)


def eliminate(
    gram: np.ndarray, away: np.ndarray, weight: np.ndarray, damping: float
) -> Elimination:
    """Eliminate the start states of independent segments.

    Parameters
    ----------
    gram : ndarray (n_segments, n_columns + 1, n_columns + 1)
        As in :class:`Blocks`.
    away : ndarray (n_segments, n_full)
        Start states minus their guesses.
    weight : ndarray (n_full,)
        What these differences weigh, above zero.
    damping : float
        Share by which the diagonal of the start states is raised.
    """
    n_full = len(weight)
    damped, diagonal = gram[:, :n_full, :n_full].copy(), range(n_full)
    damped[:, diagonal, diagonal] += weight
    damped[:, diagonal, diagonal] *= 1.0 + damping
    both = gram[:, :n_full, n_full:].copy()
    both[:, :, -1] -= weight * away
    # Equilibrated, and raised by rounding: what two start states share must not stop the step.
    scale = 1.0 / np.sqrt(np.maximum(damped[:, diagonal, diagonal], np.finfo(float).tiny))
    damped *= scale[:, :, None] * scale[:, None, :]
    damped[:, diagonal, diagonal] += n_full * np.finfo(float).eps
    # (G_zz + Omega)^-1 [G_zp, b_z]: how start states follow the parameters, and their own step.
    solved = scale[:, :, None] * np.linalg.solve(damped, scale[:, :, None] * both)
    # By axes: reshaping cannot infer sizes where no parameter is free.
    reduced = gram[:, n_full:-1, n_full:].sum(axis=0) - np.tensordot(
        both[:, :, :-1], solved, axes=([0, 1], [0, 1])
    )
    gain = float(np.vdot(both[:, :, -1], solved[:, :, -1]))
    return Elimination(reduced[:, :-1], reduced[:, -1], solved, gain)
