"""Whitening under a noise model that admits that the model is wrong.

Deviations from the model's trajectory are driven by coloured generalized
forces (what the model lacks, or real disturbances) and seen through coloured
and white sensor noise. A Kalman filter on these deviations turns residuals
and sensitivities into innovations, in which scores and likelihoods mean what
they say (Kristensen, Madsen & Jorgensen 2004).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np

from oed_sysid.compiled.compile import call, load_source
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.runtime.threads import both_cores


@dataclass(frozen=True, eq=False)
class Deviations:
    """Linear dynamics of small deviations along one record.

    Attributes
    ----------
    transition : ndarray (n_times, n_states, n_states)
        From each sample to the next.
    force_gain : ndarray (n_times, n_states, n_forces)
        Effect on the next state of a unit force held between samples.
    output : ndarray (n_times, n_outputs, n_states)
        Effect of the state on the outputs.
    present : ndarray (n_times, n_outputs)
        1 where measured, else 0.
    sample_time : float
        Median time between samples, s.
    """

    transition: np.ndarray
    force_gain: np.ndarray
    output: np.ndarray
    present: np.ndarray
    sample_time: float


@dataclass(frozen=True, eq=False)
class Innovations:
    """Whitened columns of one record.

    Attributes
    ----------
    white : ndarray (n_times, n_outputs, n_columns)
        Innovations in units of their standard deviation; zero where nothing
        was measured.
    roots : ndarray (n_times, n_outputs)
        Standard deviation of each innovation given those before it; one where
        nothing was measured, infinite after a breakdown.
    """

    white: np.ndarray
    roots: np.ndarray

    @property
    def log_determinant(self) -> float:
        """Log determinant of the covariance of all measured samples."""
        return float(2.0 * np.log(self.roots).sum())


Job = tuple[NoiseModel, Deviations, np.ndarray]


def innovations(jobs: Sequence[Job]) -> list[Innovations]:
    """Filter columns of output deviations, several jobs side by side.

    Parameters
    ----------
    jobs : sequence of (NoiseModel, Deviations, ndarray (n_times, n_outputs, n_columns))
        Noise model, record and columns; entries not measured are ignored.
    """
    return both_cores(_filter, jobs)


def whiten(
    noise: NoiseModel, deviations: Sequence[Deviations], columns: Sequence[np.ndarray]
) -> tuple[list[np.ndarray], float]:
    """Whiten columns of several records under one noise model.

    Returns
    -------
    whitened : list of ndarray (n_times * n_outputs, n_columns)
    log_determinant : float
        Over all records; infinite where a covariance is not positive definite.
    """
    found = innovations([(noise, d, c) for d, c in zip(deviations, columns, strict=True)])
    whitened = [part.white.reshape(-1, part.white.shape[2]) for part in found]
    return whitened, sum(part.log_determinant for part in found)


def _filter(job: Job) -> Innovations:
    """Filter one record: without dynamics, in compiled code, or in NumPy."""
    noise, record, column = job
    seen = record.present[:, :, None] > 0
    if noise.is_white:
        roots = np.where(record.present > 0, noise.white, 1.0)
        return Innovations(np.where(seen, column, 0.0) / roots[:, :, None], roots)
    n_outputs, n_states = record.output.shape[1:]
    library = _library(n_states, record.force_gain.shape[2], n_outputs, int(noise.has_colour))
    if library is None:
        return _filter_numpy(noise, record, column)
    result = np.ascontiguousarray(np.where(seen, column, 0.0), dtype=float)
    roots = np.full(column.shape[:2], np.inf)
    force_memory, colour_memory = memories(noise, record)
    n_full = n_states + record.force_gain.shape[2] + n_outputs
    work = np.empty(2 * n_full * column.shape[2])
    call(
        library.innovations,
        column.shape[::2],
        record.transition,
        record.force_gain,
        record.output,
        record.present,
        noise.force**2,
        force_memory,
        noise.colour**2,
        colour_memory,
        noise.white**2,
        result,
        work,
        roots,
    )
    return Innovations(result, roots)


@lru_cache(maxsize=32)
def _library(n_states: int, n_forces: int, n_outputs: int, colour: int) -> ctypes.CDLL | None:
    return load_source(
        f"innovations-{n_states}-{n_forces}-{n_outputs}-{colour}",
        lambda: files("oed_sysid.compiled").joinpath("innovations.c").read_text(),
        what="the filter of linear deviations",
        flags=(f"-DNX={n_states}", f"-DNF={n_forces}", f"-DNY={n_outputs}", f"-DCOLOUR={colour}"),
    )


def memories(noise: NoiseModel, record: Deviations) -> tuple[np.ndarray, np.ndarray]:
    """What is left of each force and colour one sample later, as a factor."""
    with np.errstate(divide="ignore"):  # a process without memory
        force = np.exp(-record.sample_time / noise.force_time)
        colour = np.exp(-record.sample_time / noise.colour_time)
    return force, colour


def _filter_numpy(noise: NoiseModel, record: Deviations, column: np.ndarray) -> Innovations:
    """The same filter without compiled code, for machines that have no compiler."""
    n_outputs, n_states = record.output.shape[1:]
    n_forces = record.force_gain.shape[2]
    n = n_states + n_forces + (n_outputs if noise.has_colour else 0)
    force_memory, colour_memory = memories(noise, record)
    transition, gain = np.zeros((n, n)), np.zeros((n_outputs, n))
    covariance, drive = np.zeros((n, n)), np.zeros(n)
    forces = slice(n_states, n_states + n_forces)
    colours = slice(n_states + n_forces, n)
    transition[forces, forces] = np.diag(force_memory)
    covariance[forces, forces] = np.diag(noise.force**2)
    drive[forces] = noise.force**2 * (1 - force_memory**2)
    if noise.has_colour:
        transition[colours, colours] = np.diag(colour_memory)
        covariance[colours, colours] = np.diag(noise.colour**2)
        drive[colours] = noise.colour**2 * (1 - colour_memory**2)
        gain[:, colours] = np.eye(n_outputs)
    state = np.zeros((n, column.shape[2]))
    white, roots = np.zeros_like(column), np.ones(column.shape[:2])
    for k in range(len(column)):
        seen = record.present[k] > 0
        gain[:, :n_states] = record.output[k]
        h = gain[seen]
        innovation = h @ covariance @ h.T + np.diag(noise.white[seen] ** 2)
        try:
            lower = np.linalg.cholesky(innovation)
        except np.linalg.LinAlgError:
            roots[k:] = np.inf
            break
        roots[k][seen] = np.diag(lower)
        white[k][seen] = np.linalg.solve(lower, column[k][seen] - h @ state)
        root = np.linalg.solve(lower, h @ covariance)
        state = state + root.T @ white[k][seen]
        covariance = covariance - root.T @ root
        transition[:n_states, :n_states] = record.transition[k]
        transition[:n_states, forces] = record.force_gain[k]
        state = transition @ state
        covariance = transition @ covariance @ transition.T + np.diag(drive)
    return Innovations(white, roots)
