r"""One pass of the extended Kalman filter along a record, with every derivative that a fit needs.

.. math::
    x^-_{k+1} &= F(x^+_k), \quad P^- = F_x P^+ F_x' + Q \\
    S &= h' P^- h + r, \quad e = y - h(x^-), \quad
    x^+ = x^- + P^- h\, e / S, \quad P^+ = P^- - P^- h h' P^- / S

one output at a time. ``x`` stacks the uncertain states of the model, disturbances that are
first-order Gauss-Markov processes (each a parameter of the model, held over a step) and coloured
errors of sensors. Columns ``X`` are derivatives of ``x`` by start states and parameters along the
filtered path at frozen gain; levels of the noise carry exact tangents of mean and covariance
(Jazwinski 1970, *Stochastic processes and filtering theory*, sections 7.3 and 8.3; Åström 1980,
*Maximum likelihood and prediction error methods*, Automatica 16).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.compile import load
from oed_sysid.compiled.interpreter import interpreted
from oed_sysid.compiled.kernels import Kernel
from oed_sysid.physics.model import Model

FORCE_VARIANCE, FORCE_TIME, WHITE_VARIANCE, COLOUR_VARIANCE, COLOUR_TIME = range(5)
LEVEL_KINDS = (FORCE_VARIANCE, FORCE_TIME, WHITE_VARIANCE, COLOUR_VARIANCE, COLOUR_TIME)


@dataclass(frozen=True, eq=False)
class Disturbed:
    """Variances and times of everything random in one pass.

    Attributes
    ----------
    disturbances : tuple of str
        Parameters of the model that are random.
    variance, time : ndarray (n_disturbances,)
        Stationary variance, and correlation time in s; time zero is white from step to step.
    white : ndarray (n_outputs,)
        Variances of white sensor noise.
    coloured : ndarray of int (n_coloured,)
        Outputs with coloured errors.
    colour_variance, colour_time : ndarray (n_coloured,)
        Their variances, and correlation times in s.
    """

    disturbances: tuple[str, ...]
    variance: np.ndarray
    time: np.ndarray
    white: np.ndarray
    coloured: np.ndarray
    colour_variance: np.ndarray
    colour_time: np.ndarray


@dataclass(frozen=True, eq=False)
class FilterPass:
    """What one pass over one record returns.

    Attributes
    ----------
    gram : ndarray (n_columns + n_levels + 1, same)
        Sum of ``[de e]'[de e] / S``: derivatives of the innovations by columns and levels, then
        the innovation itself.
    level_slope : ndarray (n_levels,)
        Half the sum of ``q (1 - e^2/S)`` with ``q = d log S``.
    level_information : ndarray (n_levels, n_levels)
        Half the sum of ``q q'``.
    log_variance, square : float
        Sums of ``log S`` and ``e^2/S``.
    innovations, variances : ndarray (n_times, n_outputs)
        ``e``, NaN where nothing was measured, and ``S``, also where nothing was.
    rows : ndarray (n_times, n_outputs, n_columns + 2 n_levels) or None
        ``de / sqrt(S)``, also where nothing was measured, then ``q`` of the levels.
    path : ndarray (n_times, n_full + n_disturbances + n_coloured)
        Filtered means.
    gains : ndarray (n_times, n_outputs, 2, n_active + n_disturbances + n_coloured) or None
        Derivatives of each output, and the gain of its innovation; zero where missing.
    moves : ndarray (n_times, n + n_disturbances, n) or None
        Transition of ``n`` active components, disturbances and colours towards the next sample
        (zero at the last one), above the predicted covariance of the disturbances with them.
    failed_at : int
        First sample that is not finite, or -1.
    """

    gram: np.ndarray
    level_slope: np.ndarray
    level_information: np.ndarray
    log_variance: float
    square: float
    innovations: np.ndarray
    variances: np.ndarray
    rows: np.ndarray | None
    path: np.ndarray
    gains: np.ndarray | None
    moves: np.ndarray | None
    failed_at: int

    @property
    def ok(self) -> bool:
        """Whether everything stayed finite."""
        return self.failed_at < 0

    @property
    def objective(self) -> float:
        """Minus twice the log-likelihood, up to a constant."""
        value = self.log_variance + self.square
        return value if self.ok and np.isfinite(value) else np.inf


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
        self.plain = Kernel(model, compiled=False)
        self._free = {name: i for i, name in enumerate(model.free_names)}
        self._position = {name: i for i, name in enumerate(model.parameter_names)}
        self._library = load(model, selectable=True, filtered=True)
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
        if self._library is None:
            return self.plain.start(own, inputs, values, time)
        z = np.empty(self.n_full)
        dz = np.empty((self.n_full, self.n_own + self.plain.n_free))
        own, inputs, values = (np.ascontiguousarray(a, dtype=float) for a in (own, inputs, values))
        self._library.kernel_start(
            _at(own), _at(inputs), _at(values), ctypes.c_double(time), _at(z), _at(dz)
        )
        return z, dz

    def simulate(
        self, times: np.ndarray, inputs: np.ndarray, values: np.ndarray, own: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """Outputs, full states and success of the undisturbed model."""
        times = np.ascontiguousarray(times, dtype=float)
        inputs = np.ascontiguousarray(inputs, dtype=float).reshape(len(times), self.plain.n_inputs)
        values = np.ascontiguousarray(values, dtype=float)
        z0, _ = self.start(own, inputs[0], values, times[0])
        if self._library is None:
            run = self.plain.run(times, inputs, values, z0)
            return run.outputs, run.states, run.ok
        y = np.full((len(times), self.plain.n_outputs), np.nan)
        z = np.full((len(times), self.n_full), np.nan)
        first = np.zeros(1, dtype=np.intc)
        failed = self._library.kernel_run(
            len(times), _at(times), _at(inputs), _at(values), ctypes.c_double(self.model.step),
            1, _at(first), _at(z0), 0, _at(z), _at(y), None, None, None,
        )  # fmt: skip
        return y, z, failed < 0

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
            Levels with tangents, as numbered by ``LEVEL_KINDS``; index -1 is the time of all.
        rows : bool
            Whether to return the derivatives of every innovation.
        gains : bool
            Whether to return gains, for :meth:`replay`.
        moves : bool
            Whether to return transitions and covariances, for a smoother.
        longest_step : float, optional
            Longest time over which disturbances are held, s; the median sample time by default.
        """
        times = np.ascontiguousarray(times, dtype=float)
        n, plain = len(times), self.plain
        inputs = np.ascontiguousarray(inputs, dtype=float).reshape(n, plain.n_inputs)
        values = np.ascontiguousarray(values, dtype=float)
        measured = np.ascontiguousarray(measured, dtype=float)
        z0, dz0 = self.start(own, inputs[0], values, times[0])
        chosen = [self._free[name] for name in names]
        random = [self._free[name] for name in noise.disturbances]
        kept = np.arange(self.n_full) if active is None else np.asarray(active, dtype=int)
        kept = np.concatenate([kept, np.asarray(passing, dtype=int)])
        n_active = len(kept) - len(passing)
        n_own = self.n_own if own_columns else 0
        first = np.hstack(
            [dz0[kept][:, :n_own], dz0[kept][:, [self.n_own + index for index in chosen]]]
        )
        if longest_step is None:
            longest_step = float(np.median(np.diff(times))) if n > 1 else 1.0
        kinds = np.array([kind for kind, _ in levels], dtype=np.intc)
        indices = np.array([index for _, index in levels], dtype=np.intc)
        width = first.shape[1] + len(levels)
        size = self.n_full + len(random) + len(noise.coloured)
        inner = n_active + len(random) + len(noise.coloured)
        found = _Results.empty(n, plain.n_outputs, width, len(levels), size, rows)
        found.gains = np.zeros((n, plain.n_outputs, 2, inner)) if gains else None
        found.moves = np.zeros((n, inner + len(random), inner)) if moves else None
        if self._library is None:
            failed = _filter_numpy(
                self.model, times, inputs, values, z0, first, kept, chosen, random, measured,
                noise, list(zip(kinds, indices, strict=True)), longest_step, n_active, found,
            )  # fmt: skip
            return found.done(failed)
        columns = np.full(max(plain.n_free, 1), -1, dtype=np.intc)
        parameter, disturbance = n_active, n_active + len(chosen)
        columns[chosen] = parameter + np.arange(len(chosen))
        columns[random] = disturbance + np.arange(len(random))
        kept = np.ascontiguousarray(kept, dtype=np.intc)
        positions = np.array([self._position[d] for d in noise.disturbances], dtype=np.intc)
        coloured = np.ascontiguousarray(noise.coloured, dtype=np.intc)
        # Numbers a hair above zero: a process without memory has a time of zero.
        q_time, c_time = np.maximum(noise.time, 1e-9), np.maximum(noise.colour_time, 1e-9)
        arrays = [
            np.ascontiguousarray(a, dtype=float)
            for a in (first, noise.variance, q_time, noise.white, noise.colour_variance, c_time)
        ]
        x0, q_variance, q_time, white, c_variance, c_time = arrays
        work = np.empty(
            self._library.kernel_filter_work(
                n_active, len(passing), len(random), len(coloured), first.shape[1], len(levels)
            )
        )
        failed = self._library.kernel_filter(
            n, _at(times), _at(inputs), _at(values), ctypes.c_double(self.model.step),
            ctypes.c_double(longest_step), _at(z0), n_active, len(passing), _at(kept),
            first.shape[1], len(chosen), parameter, disturbance, _at(columns), _at(x0), len(random),
            _at(positions), _at(q_variance), _at(q_time), _at(white), len(coloured),
            _at(coloured), _at(c_variance), _at(c_time), _at(measured), len(levels), _at(kinds),
            _at(indices), _at(found.gram), _at(found.level), _at(found.e), _at(found.s),
            _at(found.rows), _at(found.path), _at(found.gains), _at(found.moves), _at(found.total),
            _at(work),
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
        gains : ndarray (n_times, n_outputs, 2, n_active + n_disturbances + n_coloured)
            As a pass with the same active components, disturbances and colours has kept them.

        Returns
        -------
        innovations : ndarray (n_times, n_outputs)
            NaN where nothing was measured.
        ok : bool
            Whether everything stayed finite.
        """
        times = np.ascontiguousarray(times, dtype=float)
        n, plain = len(times), self.plain
        inputs = np.ascontiguousarray(inputs, dtype=float).reshape(n, plain.n_inputs)
        values = np.ascontiguousarray(values, dtype=float)
        measured = np.ascontiguousarray(measured, dtype=float)
        z0, _ = self.start(own, inputs[0], values, times[0])
        kept = np.arange(self.n_full) if active is None else np.asarray(active, dtype=int)
        if longest_step is None:
            longest_step = float(np.median(np.diff(times))) if n > 1 else 1.0
        innovations = np.full((n, plain.n_outputs), np.nan)
        if self._library is None:
            failed = _replay_numpy(
                self.model, times, inputs, values, z0, kept, measured, noise, gains, longest_step,
                innovations,
            )  # fmt: skip
            return innovations, failed < 0
        kept = np.ascontiguousarray(kept, dtype=np.intc)
        positions = np.array([self._position[d] for d in noise.disturbances], dtype=np.intc)
        coloured = np.ascontiguousarray(noise.coloured, dtype=np.intc)
        q_time = np.ascontiguousarray(np.maximum(noise.time, 1e-9), dtype=float)
        c_time = np.ascontiguousarray(np.maximum(noise.colour_time, 1e-9), dtype=float)
        gains = np.ascontiguousarray(gains, dtype=float)
        mean, delta = np.empty((2, gains.shape[-1]))
        failed = self._library.kernel_replay(
            n, _at(times), _at(inputs), _at(values), ctypes.c_double(self.model.step),
            ctypes.c_double(longest_step), _at(z0), len(kept), _at(kept), len(positions),
            _at(positions), _at(q_time), len(coloured), _at(coloured), _at(c_time),
            _at(measured), _at(gains), _at(innovations), _at(mean), _at(delta),
        )  # fmt: skip
        return innovations, failed < 0


@dataclass(eq=False)
class _Results:
    """Arrays that a pass fills."""

    gram: np.ndarray
    level: np.ndarray
    e: np.ndarray
    s: np.ndarray
    rows: np.ndarray | None
    path: np.ndarray
    total: np.ndarray
    gains: np.ndarray | None = None
    moves: np.ndarray | None = None

    @classmethod
    def empty(
        cls, n: int, n_outputs: int, width: int, n_levels: int, size: int, rows: bool
    ) -> _Results:
        return cls(
            np.full((width + 1, width + 1), np.nan),
            np.zeros(n_levels * (n_levels + 1)),
            np.full((n, n_outputs), np.nan),
            np.full((n, n_outputs), np.nan),
            np.zeros((n, n_outputs, width + n_levels)) if rows else None,
            np.full((n, size), np.nan),
            np.full(2, np.inf),
        )

    def done(self, failed: int) -> FilterPass:
        n_levels = int((np.sqrt(1 + 4 * len(self.level)) - 1) / 2)
        return FilterPass(
            self.gram,
            self.level[:n_levels],
            self.level[n_levels:].reshape(n_levels, n_levels),
            float(self.total[0]),
            float(self.total[1]),
            self.e,
            self.s,
            self.rows,
            self.path,
            self.gains,
            self.moves,
            failed,
        )


def _filter_numpy(
    model: Model,
    times: np.ndarray,
    inputs: np.ndarray,
    values: np.ndarray,
    z0: np.ndarray,
    first: np.ndarray,
    kept: np.ndarray,
    chosen: Sequence[int],
    random: Sequence[int],
    measured: np.ndarray,
    noise: Disturbed,
    levels: Sequence[tuple[int, int]],
    longest_step: float,
    n_active: int,
    found: _Results,
) -> int:
    """The pass of ``filter.c`` on CasADi's interpreter, for machines without a compiler."""
    code = interpreted(model)
    n_full, names = len(z0), model.free_names
    position = [model.parameter_names.index(names[index]) for index in random]
    na, nc, nl = len(kept), len(noise.coloured), len(levels)
    nx, n_p, m = first.shape[1], len(chosen), len(kept) + len(random)
    size = m + nc
    linear = np.array(code.graph.linear_inputs, dtype=float)
    z, values = z0.copy(), values.copy()
    mean, big_x, p = np.zeros(size), np.zeros((size, nx)), np.zeros((size, size))
    big_x[:na] = first
    tail = np.concatenate([noise.variance, noise.colour_variance])
    taus = np.maximum(np.concatenate([noise.time, noise.colour_time]), 1e-9)
    p[range(na, size), range(na, size)] = tail
    d_p, d_m = np.zeros((nl, size, size)), np.zeros((nl, size))
    place = [
        na + i if k in (FORCE_VARIANCE, FORCE_TIME) else m + i if k != WHITE_VARIANCE else -1
        for k, i in levels
    ]
    for level, (kind, _) in enumerate(levels):
        if kind in (FORCE_VARIANCE, COLOUR_VARIANCE):
            d_p[level, place[level], place[level]] = 1.0
    gram, slope, information = np.zeros((nx + nl + 1,) * 2), np.zeros(nl), np.zeros((nl, nl))
    total = np.zeros(2)
    for k in range(len(times)):
        since = times[k] - times[k - 1] if k else (times[1] - times[0] if len(times) > 1 else 1.0)
        values[position] = mean[na:m]
        if not np.isfinite(z).all():
            return k
        y, _, dy, _ = (np.array(a) for a in code._sample(z, inputs[k], values, times[k], since))
        y = y.ravel()
        inside = [*range(n_active), *range(na, size)]
        if found.moves is not None:
            found.moves[k, len(inside) :] = p[na:m][:, inside]
        delta = np.zeros(size)
        for i in range(len(y)):
            h = np.zeros(size)
            h[:na], h[na:m] = dy[i, kept], dy[i, [n_full + r for r in random]]
            h[m:] = noise.coloured == i
            g = p @ h
            s = float(h @ g + noise.white[i])
            row = np.zeros(nx + nl + 1)
            row[nx - n_p : nx] = -dy[i, [n_full + c for c in chosen]]
            row[:nx] -= h @ big_x
            d_g = d_p @ h
            d_s = d_g @ h + np.array([k_ == WHITE_VARIANCE and i_ == i for k_, i_ in levels])
            row[nx:-1] = -d_m @ h
            found.s[k, i] = s
            if not s > 0:
                return k
            if found.rows is not None:
                found.rows[k, i, : nx + nl] = row[:-1] / np.sqrt(s)
            if not np.isfinite(measured[k, i]):
                continue
            e = float(measured[k, i] - y[i] - h @ delta - h[m:] @ mean[m:])
            if not np.isfinite(e):
                return k
            row[-1] = e
            q = d_s / s
            if found.rows is not None:
                found.rows[k, i, nx + nl :] = q
            big_x += np.outer(g, row[:nx]) / s
            d_m += ((d_g - np.outer(q, g)) * e + np.outer(row[nx:-1], g)) / s
            for level in range(nl):
                cross = np.outer(d_g[level], g)
                d_p[level] -= (cross + cross.T - q[level] * np.outer(g, g)) / s
            p -= np.outer(g, g) / s
            delta += g * e / s
            if found.gains is not None:
                found.gains[k, i] = h[inside], g[inside] / s
            gram += np.outer(row, row) / s
            slope += 0.5 * q * (1 - e**2 / s)
            information += 0.5 * np.outer(q, q)
            total += np.log(s), e**2 / s
            found.e[k, i] = e
        z[kept] += delta[:na]
        mean[na:] += delta[na:]
        found.path[k] = [*z, *mean[na:]]
        if k + 1 == len(times):
            break
        interval = times[k + 1] - times[k]
        steps = max(1, int(np.ceil(interval / longest_step - 1e-6)))
        move = linear * (inputs[k + 1] - inputs[k])
        for step in range(steps):
            values[position] = mean[na:m]
            s_ = np.zeros((n_full, n_full + len(names)))
            s_[:, :n_full] = np.eye(n_full)
            if step == 0:
                _, after, _, d_after = code._sample(z, inputs[k], values, times[k], since)
                z, s_ = np.array(after).ravel(), _chained(np.array(d_after), s_)
            inner = max(1, int(np.ceil(interval / steps / model.step - 1e-9)))
            for j in range(inner):
                a, b = (step + j / inner) / steps, (step + (j + 1) / inner) / steps
                z, d_z = code._advance(
                    z, inputs[k] + a * move, inputs[k] + b * move, values,
                    times[k] + a * interval, interval / steps / inner,
                )  # fmt: skip
                z, s_ = np.array(z).ravel(), _chained(np.array(d_z), s_)
            f = np.zeros((size, size))
            f[:na, :na] = s_[np.ix_(kept, kept)]
            f[:na, na:m] = s_[np.ix_(kept, n_full + np.array(random, dtype=int))]
            phi = np.exp(-interval / steps / taus)
            d_phi = phi * interval / steps / taus
            f[range(na, size), range(na, size)] = phi
            if found.moves is not None:
                within = f[np.ix_(inside, inside)]
                before = found.moves[k, : len(inside)] if step else np.eye(len(inside))
                found.moves[k, : len(inside)] = within @ before
            big_x = f @ big_x
            big_x[:na, nx - n_p :] += s_[np.ix_(kept, n_full + np.array(chosen, dtype=int))]
            for level, (kind, _) in enumerate(levels):
                at = place[level]
                d_m[level] = f @ d_m[level]
                d_p[level] = f @ d_p[level] @ f.T
                if kind in (FORCE_VARIANCE, COLOUR_VARIANCE):
                    d_p[level, at, at] += 1 - phi[at - na] ** 2
                elif kind in (FORCE_TIME, COLOUR_TIME):
                    all_of = range(na, m) if kind == FORCE_TIME else range(m, size)
                    for j in all_of if levels[level][1] < 0 else [at]:
                        change = d_phi[j - na]
                        d_m[level, j] += change * mean[j]
                        column = change * (f @ p[:, j])
                        d_p[level][:, j] += column
                        d_p[level][j] += column
                        d_p[level, j, j] -= 2 * tail[j - na] * phi[j - na] * change
            p = f @ p @ f.T
            p[range(na, size), range(na, size)] += tail * (1 - phi**2)
            mean[na:] *= phi
    found.gram[:] = gram
    found.level[:nl], found.level[nl:] = slope, information.ravel()
    found.total[:] = total
    return -1


def _replay_numpy(
    model: Model,
    times: np.ndarray,
    inputs: np.ndarray,
    values: np.ndarray,
    z0: np.ndarray,
    kept: np.ndarray,
    measured: np.ndarray,
    noise: Disturbed,
    gains: np.ndarray,
    longest_step: float,
    innovations: np.ndarray,
) -> int:
    """The pass of ``kernel_replay`` on CasADi's interpreter."""
    code = interpreted(model)
    position = [model.parameter_names.index(name) for name in noise.disturbances]
    na, m = len(kept), len(kept) + len(position)
    linear = np.array(code.graph.linear_inputs, dtype=float)
    taus = np.maximum(np.concatenate([noise.time, noise.colour_time]), 1e-9)
    z, values, mean = z0.copy(), values.copy(), np.zeros(gains.shape[-1])
    for k in range(len(times)):
        since = times[k] - times[k - 1] if k else (times[1] - times[0] if len(times) > 1 else 1.0)
        values[position] = mean[na:m]
        if not np.isfinite(z).all():
            return k
        y = np.array(code._sample(z, inputs[k], values, times[k], since)[0]).ravel()
        delta = np.zeros(len(mean))
        for i in np.flatnonzero(np.isfinite(measured[k])):
            h, gain = gains[k, i]
            e = measured[k, i] - y[i] - h @ delta - (noise.coloured == i) @ mean[m:]
            if not np.isfinite(e):
                return k
            delta += gain * e
            innovations[k, i] = e
        z[kept] += delta[:na]
        mean[na:] += delta[na:]
        if k + 1 == len(times):
            break
        interval = times[k + 1] - times[k]
        steps = max(1, int(np.ceil(interval / longest_step - 1e-6)))
        move = linear * (inputs[k + 1] - inputs[k])
        for step in range(steps):
            values[position] = mean[na:m]
            if step == 0:
                z = np.array(code._sample(z, inputs[k], values, times[k], since)[1]).ravel()
            inner = max(1, int(np.ceil(interval / steps / model.step - 1e-9)))
            for j in range(inner):
                a, b = (step + j / inner) / steps, (step + (j + 1) / inner) / steps
                z = np.array(
                    code._advance(
                        z, inputs[k] + a * move, inputs[k] + b * move, values,
                        times[k] + a * interval, interval / steps / inner,
                    )[0]
                ).ravel()  # fmt: skip
            mean[na:] *= np.exp(-interval / steps / taus)
    return -1


def _chained(jacobian: np.ndarray, s: np.ndarray) -> np.ndarray:
    n = len(s)
    result = jacobian[:, :n] @ s
    result[:, n:] += jacobian[:, n:]
    return result


def _at(array: np.ndarray | None) -> ctypes.c_void_p | None:
    return None if array is None else ctypes.c_void_p(array.ctypes.data)


_CACHE: dict[tuple[str, float], FilterKernel] = {}


def filter_kernel(model: Model) -> FilterKernel:
    """Return the filter of a model, compiled at most once per structure."""
    key = (model.structure_key(), model.step)
    if key not in _CACHE:
        _CACHE[key] = FilterKernel(model)
    return _CACHE[key]
