r"""One pass of the extended Kalman filter along a record, with every derivative that a fit needs.

.. math::
    x^-_{k+1} &= F(x^+_k), \quad P^- = F_x P^+ F_x' + Q \\
    S &= h' P^- h + r, \quad e = y - h(x^-), \quad
    x^+ = x^- + P^- h\, e / S, \quad P^+ = P^- - P^- h h' P^- / S

one output at a time. ``x`` stacks the uncertain states of the model, disturbances that are
Gauss-Markov processes of first or second order (each acts through a parameter of the model, held
over a step), coloured errors of sensors, and the second states of disturbances
(:mod:`oed_sysid.compiled.filter_pass`). Columns ``X`` are derivatives of ``x`` by start states and
parameters along the filtered path at frozen gain; levels of the noise carry exact tangents of mean
and covariance (Jazwinski 1970, *Stochastic processes and filtering theory*, sections 7.3 and 8.3;
Åström 1980, *Maximum likelihood and prediction error methods*, Automatica 16).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence

import numpy as np

from oed_sysid.compiled.compile import call, doubles, load
from oed_sysid.compiled.filter_pass import (
    COLOUR_TIME,
    COLOUR_VARIANCE,
    FORCE_TIME,
    FORCE_VARIANCE,
    MOST_PROCESSES,
    SEA_DAMPING,
    SEA_PERIOD,
    SEA_VARIANCE,
    WHITE_VARIANCE,
    Disturbed,
    FilterPass,
    Results,
)
from oed_sysid.compiled.interpreted_filter import InterpretedFilter
from oed_sysid.compiled.kernels import Kernel
from oed_sysid.errors import ModelError
from oed_sysid.physics.model import Model

__all__ = [
    "COLOUR_TIME",
    "COLOUR_VARIANCE",
    "FORCE_TIME",
    "FORCE_VARIANCE",
    "SEA_DAMPING",
    "SEA_PERIOD",
    "SEA_VARIANCE",
    "WHITE_VARIANCE",
    "Disturbed",
    "FilterKernel",
    "FilterPass",
    "filter_kernel",
]


class FilterKernel:
    """Filter of one model structure.

    Parameters
    ----------
    model : Model
        Some of its free parameters are disturbances, at value zero. Columns
        are chosen at run time, so that one library serves every sub-model.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._free = {name: i for i, name in enumerate(model.free_names)}
        self._position = {name: i for i, name in enumerate(model.parameter_names)}
        self._library = load(model, selectable=True, filtered=True)
        self.plain = Kernel(model, compiled=False, library=self._library)
        if self._library is not None:
            self._library.kernel_filter_work.restype = ctypes.c_size_t

    def __reduce__(self) -> tuple[Callable[[Model], FilterKernel], tuple[Model]]:
        return filter_kernel, (self.model,)

    @property
    def n_full(self) -> int:
        """Length of the full state."""
        return self.plain.n_full

    @property
    def n_own(self) -> int:
        """Number of the model's own states."""
        return self.plain.n_own

    def start(
        self, own: np.ndarray, inputs: np.ndarray, values: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Full state at the first sample and its derivatives; see :meth:`Kernel.start`."""
        return self.plain.start(own, inputs, values, time)

    def simulate(
        self, times: np.ndarray, inputs: np.ndarray, values: np.ndarray, own: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """Outputs, full states and success of the undisturbed model."""
        z0, _ = self.start(own, inputs[0], values, times[0])
        run = self.plain.run(times, inputs, values, z0)
        return run.outputs, run.states, run.ok

    def filter(
        self,
        times: np.ndarray,
        inputs: np.ndarray,
        values: np.ndarray,
        own: np.ndarray,
        measured: np.ndarray,
        noise: Disturbed,
        *,
        names: Sequence[str] = (),
        own_columns: bool = True,
        active: Sequence[int] | np.ndarray | None = None,
        passing: Sequence[int] | np.ndarray = (),
        levels: Sequence[tuple[int, int]] = (),
        rows: bool = False,
        gains: bool = False,
        moves: bool = False,
        longest_step: float | None = None,
    ) -> FilterPass:
        """Filter one record.

        Parameters
        ----------
        times : ndarray (n_times,)
        inputs : ndarray (n_times, n_inputs)
        values : ndarray (n_parameters,)
            Of all parameters; disturbances are set by the filter.
        own : ndarray (n_own,)
            The model's own states at the first sample.
        measured : ndarray (n_times, n_outputs)
            NaN where missing.
        noise : Disturbed
        names : sequence of str
            Parameters with a column.
        own_columns : bool
            Whether the own start states have columns, which come first.
        active : sequence of int, optional
            Components of the full state that are uncertain; all by default.
        passing : sequence of int
            Components besides these that are certain, and only pass derivatives on.
        levels : sequence of (kind, index)
            Levels with tangents, ``FORCE_VARIANCE`` and its like; index -1 is the time of all.
            A ``SEA_VARIANCE`` counts among narrow-band disturbances, ``SEA_PERIOD`` and
            ``SEA_DAMPING`` are of a sea.
        rows : bool
            Whether to return the derivatives of every innovation.
        gains : bool
            Whether to return gains, for :meth:`replay`.
        moves : bool
            Whether to return transitions and covariances, for a smoother.
        longest_step : float, optional
            Longest time over which disturbances are held, s; the median sample time by default.
        """
        n, plain = len(times), self.plain
        times, inputs, values, measured = doubles(times, inputs, values, measured)
        inputs = inputs.reshape(n, plain.n_inputs)
        z0, dz0 = self.start(own, inputs[0], values, times[0])
        chosen = [self._free[name] for name in names]
        random = [self._free[name] for name in noise.acting]
        self._check_processes(noise)
        kept = np.arange(self.n_full) if active is None else np.asarray(active, dtype=int)
        kept = np.concatenate([kept, np.asarray(passing, dtype=int)])
        n_active = len(kept) - len(passing)
        n_own = self.n_own if own_columns else 0
        first = np.hstack(
            [dz0[kept][:, :n_own], dz0[kept][:, [self.n_own + index for index in chosen]]]
        )
        longest_step = _usual_step(times) if longest_step is None else float(longest_step)
        kinds = np.array([kind for kind, _ in levels], dtype=np.intc)
        indices = np.array([index for _, index in levels], dtype=np.intc)
        width = first.shape[1] + len(levels)
        n_random = len(noise.disturbances)
        size = self.n_full + n_random + len(noise.coloured)
        inner = n_active + n_random + len(noise.coloured) + noise.n_second
        found = Results.empty(n, plain.n_outputs, width, len(levels), size, rows)
        found.gains = np.zeros((n, plain.n_outputs, 2, inner)) if gains else None
        found.moves = np.zeros((n, inner + n_random, inner)) if moves else None
        if self._library is None:
            slow = InterpretedFilter(self.model, values, z0, kept, noise, longest_step)
            failed = slow.filter((times, inputs), measured, first, chosen, levels, n_active, found)
            return found.done(failed)
        columns = np.full(max(plain.n_free, 1), -1, dtype=np.intc)
        parameter, disturbance = n_active, n_active + len(chosen)
        columns[chosen] = parameter + np.arange(len(chosen))
        columns[random] = disturbance + np.arange(len(random))
        kept = np.ascontiguousarray(kept, dtype=np.intc)
        positions = np.array([self._position[d] for d in noise.disturbances], dtype=np.intc)
        acting = np.array([noise.acting.index(d) for d in noise.disturbances], dtype=np.intc)
        coloured = np.ascontiguousarray(noise.coloured, dtype=np.intc)
        # Numbers a hair above zero: a process without memory has a time of zero.
        q_time, c_time = np.maximum(noise.time, 1e-9), np.maximum(noise.colour_time, 1e-9)
        x0, q_variance, q_time, white, c_variance, c_time = doubles(
            first, noise.variance, q_time, noise.white, noise.colour_variance, c_time
        )
        work = np.empty(
            self._library.kernel_filter_work(
                n_active,
                len(passing),
                n_random,
                len(coloured),
                noise.n_second,
                first.shape[1],
                len(levels),
            )
        )
        h_max = float(self.model.step)
        failed = call(
            self._library.kernel_filter, n, times, inputs, values, h_max, longest_step,
            z0, n_active, len(passing), kept, first.shape[1], len(chosen), parameter, disturbance,
            columns, x0, n_random, len(random), positions, acting, q_variance, q_time,
            noise.damping, noise.turn, noise.sea, white, len(coloured), coloured, c_variance,
            c_time, measured,
            len(levels), kinds, indices, found.gram, found.level, found.e, found.s, found.rows,
            found.path, found.gains, found.moves, found.total, work,
        )  # fmt: skip
        return found.done(failed)

    def replay(
        self,
        times: np.ndarray,
        inputs: np.ndarray,
        values: np.ndarray,
        own: np.ndarray,
        measured: np.ndarray,
        noise: Disturbed,
        gains: np.ndarray,
        *,
        active: Sequence[int] | np.ndarray | None = None,
        longest_step: float | None = None,
    ) -> tuple[np.ndarray, bool]:
        """Innovations of other values at the gains of an earlier pass.

        What a change of the model does to the innovations at frozen gain, without derivatives
        and hence at a fraction of the cost of a pass.

        Parameters
        ----------
        times, inputs, values, own, measured, noise, active, longest_step
            As of :meth:`filter`.
        gains : ndarray (n_times, n_outputs, 2, n)
            As a pass with the same active components, disturbances and colours has kept them.

        Returns
        -------
        innovations : ndarray (n_times, n_outputs)
            NaN where nothing was measured.
        ok : bool
            Whether everything stayed finite.
        """
        n, plain = len(times), self.plain
        times, inputs, values, measured = doubles(times, inputs, values, measured)
        inputs = inputs.reshape(n, plain.n_inputs)
        z0, _ = self.start(own, inputs[0], values, times[0])
        kept = np.arange(self.n_full) if active is None else np.asarray(active, dtype=int)
        longest_step = _usual_step(times) if longest_step is None else float(longest_step)
        innovations = np.full((n, plain.n_outputs), np.nan)
        if self._library is None:
            slow = InterpretedFilter(self.model, values, z0, kept, noise, longest_step)
            failed = slow.replay((times, inputs), measured, gains, innovations)
            return innovations, failed < 0
        kept = np.ascontiguousarray(kept, dtype=np.intc)
        positions = np.array([self._position[d] for d in noise.disturbances], dtype=np.intc)
        coloured = np.ascontiguousarray(noise.coloured, dtype=np.intc)
        q_time, c_time, gains = doubles(
            np.maximum(noise.time, 1e-9), np.maximum(noise.colour_time, 1e-9), gains
        )
        mean, delta = np.empty((2, gains.shape[-1]))
        h_max = float(self.model.step)
        failed = call(
            self._library.kernel_replay, n, times, inputs, values, h_max, longest_step,
            z0, len(kept), kept, len(positions), positions, q_time, noise.damping, noise.turn,
            len(coloured), coloured, c_time, measured, gains, innovations, mean, delta,
        )  # fmt: skip
        return innovations, failed < 0

    def _check_processes(self, noise: Disturbed) -> None:
        for name in noise.acting:
            if noise.disturbances.count(name) > MOST_PROCESSES:
                raise ModelError(
                    f"More than {MOST_PROCESSES} processes act on {name!r}. Take fewer seas."
                )


def _usual_step(times: np.ndarray) -> float:
    return float(np.median(np.diff(times))) if len(times) > 1 else 1.0


_CACHE: dict[tuple[str, float], FilterKernel] = {}


def filter_kernel(model: Model) -> FilterKernel:
    """Return the filter of a model, compiled at most once per structure."""
    key = (model.structure_key(), model.step)
    if key not in _CACHE:
        _CACHE[key] = FilterKernel(model)
    return _CACHE[key]
