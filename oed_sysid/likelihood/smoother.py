r"""What must have acted, given the whole record: a smoother on the path of the filter.

One scalar measurement after the other, the filter of :mod:`oed_sysid.compiled.filtering` takes a
small deviation :math:`x_k` of its path through a sample and on to the next by

.. math::
    e_i = -h_i' \Bigl[\prod_{j<i} (I - g_j h_j')\Bigr] x_k = -\tilde h_i' x_k, \qquad
    x_{k+1} = F_k \Bigl[\prod_i (I - g_i h_i')\Bigr] x_k + u_k = L_k x_k + u_k

Backwards the same matrices gather what later innovations say of a sample (de Jong 1989,
*Smoothing and interpolation with the state-space model*; Durbin & Koopman 2012, section 4.4),

.. math::
    r_k = L_k' r_{k+1} + \sum_i \tilde h_i\, e_i / S_i, \qquad
    N_k = L_k' N_{k+1} L_k + \sum_i \tilde h_i \tilde h_i' / S_i

and a disturbance with rows :math:`P_w` of the predicted covariance is
:math:`\hat w_k = w^-_k + P_w r_k` with covariance :math:`P_{ww} - P_w N_k P_w'`. No covariance is
inverted, and any number of columns is smoothed at once.

Regressors along a path that has seen the whole record hold its noise: residual forces and pictures
come from here, parameters and their errors from the filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.compiled.filtering import FilterPass
from oed_sysid.errors import SimulationError
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.noise_levels import (
    NORMAL,
    RARE,
    runs_of,
    settled,
    size_of_few,
    surely_beyond,
)


@dataclass(frozen=True, eq=False)
class Path:
    """Small deviations of one record from the path of its filter.

    Attributes
    ----------
    closed : ndarray (n_times, n, n)
        From the prediction of one sample to that of the next.
    seen : ndarray (n_times, n_outputs, n)
        What each innovation sees of the prediction; zero where nothing was measured.
    drive : ndarray (n_times, n, n_disturbances)
        Effect of each disturbance, held over the step, on the next prediction, itself left out.
    memory : ndarray (n_times, n_random, n_random)
        Transition of the disturbances, and of the second states of those that are narrow-band,
        towards the next sample.
    gain : ndarray (n_times, n_outputs, n_random)
        Of the innovations on these.
    spread : ndarray (n_times, n_disturbances, n)
        Predicted covariance of the disturbances with everything.
    variances : ndarray (n_times, n_outputs)
        Of the innovations.
    first : int
        Position of the first disturbance among the components.
    """

    closed: np.ndarray
    seen: np.ndarray
    drive: np.ndarray
    memory: np.ndarray
    gain: np.ndarray
    spread: np.ndarray
    variances: np.ndarray
    first: int

    @classmethod
    def of(cls, part: FilterPass, n_coloured: int = 0, n_second: int = 0) -> Path:
        """Fold the measurements of a pass that kept its gains and moves into its transitions.

        Behind the disturbances stand ``n_coloured`` colours, then ``n_second`` further states of
        disturbances.
        """
        _, n_outputs, _, size = part.gains.shape
        n_random = part.moves.shape[1] - size
        first = size - n_second - n_coloured - n_random
        random = slice(first, first + n_random)
        # A narrow-band force has two states; both are random, and only they remember.
        wide = np.r_[first : first + n_random, size - n_second : size]
        transition, spread = part.moves[:, :size], part.moves[:, size:]
        # Scalar measurements one after the other: what an output sees has been through all before
        # it.
        through = np.broadcast_to(np.eye(size), transition.shape).copy()
        seen = np.empty((len(part.gains), n_outputs, size))
        gains = part.gains * np.isfinite(part.innovations)[:, :, None, None]
        for output in range(n_outputs):
            row, gain = gains[:, output, 0], gains[:, output, 1]
            seen[:, output] = np.einsum("ki,kij->kj", row, through)
            through -= gain[:, :, None] * seen[:, output, None, :]
        drive = transition[:, :, random].copy()
        # What is added is held over the step; it does not enter the disturbance itself.
        drive[:, wide] = 0.0
        memory = transition[:, wide[:, None], wide]
        gain = gains[:, :, 1, wide]
        closed = transition @ through
        return cls(closed, seen, drive, memory, gain, spread, part.variances, first)

    def responses(self, drive: np.ndarray) -> np.ndarray:
        """Innovations, in standard deviations, of what is added to every prediction.

        Parameters
        ----------
        drive : ndarray (n_times, n, n_columns)
            Added between a sample and the next.

        Returns
        -------
        ndarray (n_times, n_outputs, n_columns)
        """
        moved = np.zeros(drive.shape[1:])
        result = np.empty((*self.variances.shape, drive.shape[2]))
        for k, added in enumerate(drive):
            result[k] = -self.seen[k] @ moved
            moved = self.closed[k] @ moved + added
        return result / np.sqrt(self.variances)[:, :, None]

    def disturbances(self, innovations: np.ndarray) -> np.ndarray:
        """Disturbances that go with innovations or with their derivatives.

        Parameters
        ----------
        innovations : ndarray (n_times, n_outputs, n_columns)
            What stands where nothing was measured does not matter.

        Returns
        -------
        ndarray (n_times, n_disturbances, n_columns)
        """
        known = np.any(self.seen != 0, axis=2, keepdims=True)
        columns = np.where(known, innovations, 0.0)
        # Forwards: the filtered mean. Backwards below: what later innovations add to it.
        pushes = np.swapaxes(self.gain, 1, 2) @ columns
        told = np.swapaxes(self.seen, 1, 2) @ (columns / self.variances[:, :, None])
        n, size = self.seen.shape[0], self.seen.shape[2]
        count = self.drive.shape[2]
        result = np.empty((n, count, columns.shape[2]))
        mean = np.zeros(pushes.shape[1:])
        for k in range(n):
            result[k] = mean[:count]
            mean = self.memory[k] @ (mean + pushes[k])
        later = np.zeros((size, columns.shape[2]))
        for k in range(n - 1, -1, -1):
            later = told[k] + self.closed[k].T @ later
            result[k] += self.spread[k] @ later
        return result

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of every smoothed disturbance, ``(n_times, n_disturbances)``."""
        n, n_random, size = self.spread.shape
        told = np.swapaxes(self.seen, 1, 2) @ (self.seen / self.variances[:, :, None])
        later, removed = np.zeros((size, size)), np.empty((n, n_random))
        for k in range(n - 1, -1, -1):
            closed, rows = self.closed[k], self.spread[k]
            # N_k of the heading; only its part in the rows of the disturbances is wanted.
            later = told[k] + closed.T @ later @ closed
            removed[k] = np.sum((rows @ later) * rows, axis=1)
        own = np.arange(n_random)
        variance = self.spread[:, own, self.first + own] - removed
        # Where the record tells everything, the difference of two equal numbers may round below
        # zero.
        return np.sqrt(np.maximum(variance, 0.0))


def interpolated(part: FilterPass, used: np.ndarray) -> np.ndarray:
    r"""How far every sample is from what all others say of it, in standard deviations.

    With :math:`r, N` as they are behind a measurement that was used (de Jong 1988, *A
    cross-validation filter for time series models*, Biometrika 75), and one that was not,

    .. math:: u = e/S - (g/S)' r, \qquad
        t = u \,\bigl(1/S + (g/S)' N (g/S)\bigr)^{-1/2}, \quad
        u \,\bigl(1/S - (g/S)' N (g/S)\bigr)^{-1/2}

    Parameters
    ----------
    part : FilterPass
        With gains and moves.
    used : ndarray of bool (n_times, n_outputs)
        Samples that moved the filter.

    Returns
    -------
    ndarray (n_times, n_outputs)
        NaN where nothing was measured.
    """
    used = used & np.isfinite(part.innovations)
    # From sample to sample as one move; then all samples at once, one output after the other.
    path = Path.of(replace(part, innovations=np.where(used, part.innovations, np.nan)))
    weighted = np.swapaxes(path.seen / part.variances[:, :, None], 1, 2)
    pulls, added = weighted @ np.where(used, part.innovations, 0.0)[..., None], weighted @ path.seen
    r, later = np.zeros_like(pulls), np.zeros_like(path.closed)
    for k in range(len(r) - 1, 0, -1):
        back = path.closed[k].T
        r[k - 1], later[k - 1] = back @ r[k] + pulls[k], back @ later[k] @ back.T + added[k]
    move = part.moves[:, : path.closed.shape[1]]
    back = np.swapaxes(move, 1, 2)
    r, later = back @ r, back @ later @ move
    told = np.empty_like(part.innovations)
    for i in reversed(range(told.shape[1])):
        seen, gain = np.moveaxis(part.gains[:, i, :, :, None], 1, 0)
        variance, moves = part.variances[:, i, None, None], used[:, i, None, None]
        row, pulled = np.swapaxes(gain, 1, 2), later @ gain
        left = part.innovations[:, i, None, None] / variance - row @ r
        spread = row @ pulled
        # What all others say of a sample that is not used is known to rounding at best.
        own = 1.0 + variance * np.where(moves, spread, -spread)
        told[:, i] = (left * np.sqrt(variance / np.maximum(own, np.finfo(float).eps)))[:, 0, 0]
        # r before the measurement, and N likewise.
        seen = np.where(moves, seen, 0.0)
        r = r + seen * np.where(moves, left, 0.0)
        change = seen @ np.swapaxes(pulled - 0.5 * (spread + 1.0 / variance) * seen, 1, 2)
        later = later - change - np.swapaxes(change, 1, 2)
    return told


def outlying(
    problem: Filtered, unknowns: np.ndarray, out: Sequence[np.ndarray]
) -> tuple[tuple[np.ndarray, ...], bool]:
    """Samples that no motion between all others explains, per record.

    First the filter goes on without what it does not expect, so that groups that are off bend
    nothing. Each sample is then judged by all that are used, itself apart, until few change sides.

    Parameters
    ----------
    problem : Filtered
        With all samples.
    unknowns : ndarray (n_unknowns,)
    out : sequence of ndarray of bool (n_times, n_outputs)
        Samples that stay out whatever is expected.

    Returns
    -------
    off : tuple of ndarray of bool (n_times, n_outputs)
    understood : bool
        Whether hardly any other is unexpected; else it is the motion that is not understood.
    """
    count = int(np.isfinite(np.vstack([record.outputs for record in problem.records])).sum())
    surely = surely_beyond(RARE, count)
    limits = [np.where(part, 0.0, surely**2) for part in out]
    passes = problem.passes(unknowns, columns=False, beyond=limits)
    off = tuple(_beyond(part, limit) for part, limit in zip(passes, limits, strict=True))
    if not any(part.any() for part in off):
        return off, True
    for _ in range(10):  # four suffice as a rule
        passes = _without(problem, unknowns, off)
        if not all(part.ok for part in passes):
            return off, False
        before, off = off, _apart(passes, off, out, surely)
        if settled(before, off):
            break
    return off, _unexpected(_without(problem, unknowns, off), off, surely) <= RARE * count


def _unexpected(passes: Sequence[FilterPass], off: Sequence[np.ndarray], surely: float) -> int:
    """How many samples are beyond what normal noise does that are used."""
    pairs = zip(passes, off, strict=True)
    return sum(int(np.sum(_beyond(part, surely**2) & ~aside)) for part, aside in pairs)


def _beyond(part: FilterPass, limit: np.ndarray | float) -> np.ndarray:
    """Samples whose innovations, squared and over their variances, are beyond a limit."""
    return np.asarray(part.innovations**2 > limit * part.variances)


def _without(
    problem: Filtered, unknowns: np.ndarray, off: Sequence[np.ndarray]
) -> list[FilterPass]:
    """Passes that some samples do not move."""
    limits = [np.where(part, 0.0, np.inf) for part in off]
    return problem.passes(unknowns, columns=False, gains=True, moves=True, beyond=limits)


def _apart(
    passes: Sequence[FilterPass],
    off: Sequence[np.ndarray],
    out: Sequence[np.ndarray],
    surely: float,
) -> tuple[np.ndarray, ...]:
    """Samples beyond the size at which chance makes few of so many.

    Of those used, in a row of times the farthest alone, because it pulls at the others.
    """
    told = [np.abs(interpolated(p, ~part)) for p, part in zip(passes, off, strict=True)]
    every = np.vstack(told)
    never = np.isnan(every).all(axis=0)
    usual = np.maximum(NORMAL * np.nanmedian(np.where(never, 0.0, every), axis=0), 1.0)
    sizes = [np.nan_to_num(part / usual) for part in told]
    free = [size[~part & (size > 0.0)] for size, part in zip(sizes, out, strict=True)]
    limit = size_of_few(np.concatenate(free), surely)
    found = []
    for part, was, size in zip(out, off, sizes, strict=True):
        kept, rest = part | (was & (size > limit)), np.where(was, 0.0, size)
        for first, stop in runs_of(np.any(rest > limit, axis=1)):
            row, column = np.unravel_index(np.argmax(rest[first:stop]), rest[first:stop].shape)
            kept[first + row, column] = True
        found.append(kept)
    return tuple(found)


def smoothable(
    problem: Filtered, unknowns: np.ndarray
) -> tuple[list[FilterPass], tuple[Path, ...]]:
    """Passes of all records with what a smoother needs, and the paths of that."""
    passes = problem.passes(unknowns, rows=True, gains=True, moves=True)
    if not all(part.ok for part in passes):
        raise SimulationError(
            f"Model {problem.model.name!r} diverges although a force may act in every equation. "
            "Cut the record, or bound the parameters."
        )
    noise = problem.disturbed(unknowns)[0]
    return passes, tuple(Path.of(part, len(noise.coloured), noise.n_second) for part in passes)
