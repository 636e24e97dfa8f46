"""Smoothed disturbances: what must have acted, given the whole record.

A fixed-interval smoother on the linear deviations (de Jong 1989; Durbin &
Koopman 2012, section 4.4). It needs no inverse of a state covariance, and it
smooths any number of columns at once: residuals, and the sensitivities by
which unknowns that were estimated from the same residuals are accounted for.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np

from oed_sysid.compiled.compile import call, load_source
from oed_sysid.likelihood.kalman import Deviations, memories
from oed_sysid.likelihood.noise_model import NoiseModel


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Disturbances and deviations of one record under one noise model.

    Attributes
    ----------
    forces : ndarray (n_times, n_forces, n_columns)
        Expectation of each disturbance given each column.
    states : ndarray (n_times, n_states, n_columns)
        Expectation of the deviations of the state.
    std : ndarray (n_times, n_forces)
        Standard deviation of the disturbances that is left.
    """

    forces: np.ndarray
    states: np.ndarray
    std: np.ndarray


def smooth(noise: NoiseModel, record: Deviations, column: np.ndarray) -> Smoothed:
    """Smooth columns of one record under a noise model.

    Parameters
    ----------
    noise : NoiseModel
    record : Deviations
    column : ndarray (n_times, n_outputs, n_columns)
        Residuals and sensitivities; entries not measured are ignored.
    """
    n_outputs, n_states = record.output.shape[1:]
    n_forces = record.force_gain.shape[2]
    colour = int(noise.has_colour)
    library = _library(n_states, n_forces, n_outputs, colour)
    if library is None:
        return smooth_numpy(noise, record, column)
    n, m = len(column), column.shape[2]
    size = n_states + n_forces + colour * n_outputs
    white = np.where(record.present[:, :, None] > 0, column, 0.0)
    states, variance = np.empty((n, size, m)), np.empty((n, n_forces))
    force_memory, colour_memory = memories(noise, record)
    failed = call(
        library.smoother,
        (n, m),
        record.transition,
        record.force_gain,
        record.output,
        record.present,
        noise.force**2,
        force_memory,
        noise.colour**2,
        colour_memory,
        noise.white**2,
        white,
        states,
        variance,
        np.empty(n * size * (2 * n_outputs + size)),
        np.empty(size * (m + 1)),
    )
    if failed:
        states, variance = np.full_like(states, np.nan), np.full_like(variance, np.nan)
    forces = slice(n_states, n_states + n_forces)
    return Smoothed(states[:, forces], states[:, :n_states], np.sqrt(np.maximum(variance, 0.0)))


@lru_cache(maxsize=32)
def _library(n_states: int, n_forces: int, n_outputs: int, colour: int) -> ctypes.CDLL | None:
    return load_source(
        f"smoother-{n_states}-{n_forces}-{n_outputs}-{colour}",
        lambda: files("oed_sysid.compiled").joinpath("smoother.c").read_text(),
        what="the smoother of linear deviations",
        flags=(f"-DNX={n_states}", f"-DNF={n_forces}", f"-DNY={n_outputs}", f"-DCOLOUR={colour}"),
    )


def smooth_numpy(noise: NoiseModel, record: Deviations, column: np.ndarray) -> Smoothed:
    """The same without compiled code, for machines that have no compiler."""
    n_outputs, n_states = record.output.shape[1:]
    n_forces, n = record.force_gain.shape[2], len(column)
    n_colours = n_outputs if noise.has_colour else 0
    size = n_states + n_forces + n_colours
    force_memory, colour_memory = memories(noise, record)
    memory = np.concatenate([force_memory, colour_memory[:n_colours]])
    stationary = np.concatenate([noise.force, noise.colour[:n_colours]]) ** 2
    extra = np.arange(n_states, size)
    covariance, drive = np.zeros((size, size)), np.zeros((size, size))
    covariance[extra, extra] = stationary
    drive[extra, extra] = stationary * (1.0 - memory**2)
    transition, output = np.zeros((n, size, size)), np.zeros((n, n_outputs, size))
    transition[:, :n_states, :n_states] = record.transition
    transition[:, :n_states, n_states : n_states + n_forces] = record.force_gain
    transition[:, extra, extra] = memory
    output[:, :, :n_states] = record.output
    output[:, np.arange(n_colours), size - n_colours + np.arange(n_colours)] = 1.0
    output *= record.present[:, :, None] > 0
    state = np.zeros((size, column.shape[2]))
    kept = []
    for k in range(n):
        seen = record.present[k] > 0
        product = output[k] @ covariance
        # A missing sample becomes a measurement of nothing.
        spread = product @ output[k].T + np.diag(np.where(seen, noise.white**2, 1.0))
        inverse = np.linalg.inv(np.linalg.cholesky(spread))
        white = inverse @ (np.where(seen[:, None], column[k], 0.0) - output[k] @ state)
        rows, gain = inverse @ output[k], inverse @ product
        kept.append((rows, gain, white, covariance, state))
        state = transition[k] @ (state + gain.T @ white)
        covariance = covariance - gain.T @ gain
        covariance = transition[k] @ covariance @ transition[k].T + drive
    forces = slice(n_states, n_states + n_forces)
    adjoint, information = np.zeros_like(state), np.zeros((size, size))
    mean, variance = np.empty((n, *state.shape)), np.empty((n, n_forces))
    for k in range(n - 1, -1, -1):
        rows, gain, white, covariance, state = kept[k]
        closed = transition[k] @ (np.eye(size) - gain.T @ rows)
        adjoint = rows.T @ white + closed.T @ adjoint
        information = rows.T @ rows + closed.T @ information @ closed
        mean[k] = state + covariance @ adjoint
        part = covariance[forces]
        variance[k] = np.diag(covariance)[forces] - np.sum((part @ information) * part, axis=1)
    return Smoothed(mean[:, forces], mean[:, :n_states], np.sqrt(np.maximum(variance, 0.0)))
