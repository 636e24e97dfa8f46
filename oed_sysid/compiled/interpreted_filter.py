"""The passes of ``filter.c`` on CasADi's interpreter, for machines without a compiler.

Equations and symbols are those of :mod:`oed_sysid.compiled.filtering`. Here every tangent is a
matrix of its own, and nothing is sparse.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed_sysid.compiled.filter_pass import (
    COLOUR_TIME,
    COLOUR_VARIANCE,
    FORCE_TIME,
    FORCE_VARIANCE,
    SEA_DAMPING,
    SEA_PERIOD,
    SEA_VARIANCE,
    WHITE_VARIANCE,
    Disturbed,
    Results,
)
from oed_sysid.compiled.interpreter import Commands, chained, interpreted
from oed_sysid.physics.model import Model


class InterpretedFilter:
    """One pass over one record.

    Parameters
    ----------
    model : Model
    values : ndarray (n_parameters,)
    z0 : ndarray (n_full,)
        Full state at the first sample.
    kept : sequence of int
        Components of it that are uncertain, then those that only pass derivatives on.
    noise : Disturbed
    longest_step : float
        Longest time over which disturbances are held, s.
    """

    def __init__(
        self,
        model: Model,
        values: np.ndarray,
        z0: np.ndarray,
        kept: np.ndarray,
        noise: Disturbed,
        longest_step: float,
    ) -> None:
        self.code, self.noise, self.longest_step = interpreted(model), noise, longest_step
        self.z, self.values, self.kept = z0.copy(), values.copy(), kept
        names = model.free_names
        self.position = [model.parameter_names.index(name) for name in noise.disturbances]
        n_full = len(z0)
        random = [n_full + names.index(name) for name in noise.disturbances]
        self.random = np.array(random, dtype=int)
        self.na, self.m = len(kept), len(kept) + len(self.random)
        self.coloured = slice(self.m, self.m + len(noise.coloured))
        self.size = self.coloured.stop + noise.n_second
        self.extra = slice(self.na, self.size)
        self.tail = noise.stationary
        self.mean = np.zeros(self.size)

    def replay(
        self, record: Commands, measured: np.ndarray, gains: np.ndarray, innovations: np.ndarray
    ) -> int:
        """Innovations at the gains of an earlier pass; -1, or the sample that is not finite."""
        for k in range(len(measured)):
            if not np.isfinite(self.z).all():
                return k
            self._let_act()
            y = self.code.sample(self.z, record, k, self.values)[0]
            delta = np.zeros(self.size)
            for i in np.flatnonzero(np.isfinite(measured[k])):
                h, gain = gains[k, i]
                own = (self.noise.coloured == i) @ self.mean[self.coloured]
                e = measured[k, i] - y[i] - h @ delta - own
                if not np.isfinite(e):
                    return k
                delta += gain * e
                innovations[k, i] = e
            self._correct(delta)
            for step, steps, length in self._parts(record[0], k):
                self._advance(record, k, (step, steps), None)
                self.mean[self.extra] = self.noise.memory(length)[0] @ self.mean[self.extra]
        return -1

    def filter(
        self,
        record: Commands,
        measured: np.ndarray,
        first: np.ndarray,
        chosen: Sequence[int],
        levels: Sequence[tuple[int, int]],
        n_active: int,
        found: Results,
    ) -> int:
        """Fill the results as the compiled loop does; -1, or the failing sample."""
        self.levels, self.found = levels, found
        self.chosen = len(self.z) + np.array(chosen, dtype=int)
        self.inside = [*range(n_active), *range(self.na, self.size)]
        nx, nl = first.shape[1], len(levels)
        self.big_x, self.p = np.zeros((self.size, nx)), np.zeros((self.size, self.size))
        self.big_x[: self.na] = first
        self.p[self.extra, self.extra] = np.diag(self.tail)
        self.d_p, self.d_m = np.zeros((nl, self.size, self.size)), np.zeros((nl, self.size))
        for level, (kind, index) in enumerate(levels):
            if kind in (FORCE_VARIANCE, COLOUR_VARIANCE, SEA_VARIANCE):
                self.d_p[level, self.extra, self.extra] = self._unit(kind, index)
        self.gram = np.zeros((nx + nl + 1,) * 2)
        self.slope, self.information, self.total = np.zeros(nl), np.zeros((nl, nl)), np.zeros(2)
        for k in range(len(measured)):
            if not np.isfinite(self.z).all() or not self._measure(record, k, measured[k]):
                return k
            for step, steps, length in self._parts(record[0], k):
                self._predict(record, k, (step, steps), length)
        found.gram[:] = self.gram
        found.level[:nl], found.level[nl:] = self.slope, self.information.ravel()
        found.total[:] = self.total
        return -1

    def _parts(self, times: np.ndarray, k: int) -> list[tuple[int, int, float]]:
        """Steps from sample ``k`` on over which disturbances are held; none after the last."""
        if k + 1 == len(times):
            return []
        interval = times[k + 1] - times[k]
        steps = max(1, int(np.ceil(interval / self.longest_step - 1e-6)))
        return [(step, steps, interval / steps) for step in range(steps)]

    def _unit(self, kind: int, index: int) -> np.ndarray:
        """Stationary covariance of a disturbance or colour of unit variance, with all of these."""
        noise = self.noise
        if kind == COLOUR_VARIANCE:
            index += self.m - self.na
        elif kind == SEA_VARIANCE:
            index += int(np.sum(noise.sea < 0))
        own = np.zeros(self.size - self.na)
        own[index] = 1.0
        if index < self.m - self.na:
            own[self.coloured.stop - self.na :] = own[: self.m - self.na][noise.turn != 0]
        return np.diag(own)

    def _lasting(self, kind: int, index: int) -> np.ndarray:
        """Disturbances, colours and second states of which a level is the time or damping."""
        noise = self.noise
        force, colour = np.arange(self.m - self.na), np.arange(len(noise.coloured))
        if kind == FORCE_TIME:
            hit = (noise.sea < 0) & ((index < 0) | (force == index))
        else:
            hit = (noise.sea == index) & (kind in (SEA_PERIOD, SEA_DAMPING))
        own = (kind == COLOUR_TIME) & ((index < 0) | (colour == index))
        return np.concatenate([hit, own, hit[noise.turn != 0]])

    def _let_act(self) -> None:
        """Disturbances into the parameters through which they act."""
        self.values[self.position] = 0.0
        np.add.at(self.values, self.position, self.mean[self.na : self.m])

    def _correct(self, delta: np.ndarray) -> None:
        self.z[self.kept] += delta[: self.na]
        self.mean[self.na :] += delta[self.na :]

    def _advance(
        self, record: Commands, k: int, part: tuple[int, int], s: np.ndarray | None
    ) -> np.ndarray | None:
        """Move the state, and sensitivities ``s``, over one part of the time to the next sample."""
        self._let_act()
        if part[0] == 0:  # sensor memory moves on with what is known after the measurement
            _, self.z, _, d_after = self.code.sample(self.z, record, k, self.values)
            s = None if s is None else chained(d_after, s)
        self.z, s = self.code.move(self.z, s, record, k, self.values, part)
        return s

    def _measure(self, record: Commands, k: int, measured: np.ndarray) -> bool:
        """Correct by one sample, one output at a time; whether everything is finite."""
        noise, found, na, m = self.noise, self.found, self.na, self.m
        self._let_act()
        y, _, dy, _ = self.code.sample(self.z, record, k, self.values)
        if found.moves is not None:
            found.moves[k, len(self.inside) :] = self.p[na:m][:, self.inside]
        nx, nl, n_p = self.big_x.shape[1], len(self.levels), len(self.chosen)
        delta, second = np.zeros(self.size), np.zeros(noise.n_second)
        for i in range(len(y)):
            of_sensor = noise.coloured == i
            h = np.concatenate([dy[i, self.kept], dy[i, self.random], of_sensor, second])
            g = self.p @ h
            s = float(h @ g + noise.white[i])
            found.s[k, i] = s
            if not s > 0:
                return False
            row = np.zeros(nx + nl + 1)
            row[nx - n_p : nx] = -dy[i, self.chosen]
            row[:nx] -= h @ self.big_x
            row[nx:-1] = -self.d_m @ h
            if found.rows is not None:
                found.rows[k, i, : nx + nl] = row[:-1] / np.sqrt(s)
            if not np.isfinite(measured[i]):
                continue
            row[-1] = e = float(measured[i] - y[i] - h @ delta - h[m:] @ self.mean[m:])
            if not np.isfinite(e):
                return False
            delta += g * e / s
            q = self._corrected(i, h, g, s, row)
            if found.rows is not None:
                found.rows[k, i, nx + nl :] = q
            if found.gains is not None:
                found.gains[k, i] = h[self.inside], g[self.inside] / s
            found.e[k, i] = e
        self._correct(delta)
        found.path[k] = [*self.z, *self.mean[na : self.coloured.stop]]
        return True

    def _corrected(
        self, output: int, h: np.ndarray, g: np.ndarray, s: float, row: np.ndarray
    ) -> np.ndarray:
        """Covariance, columns, tangents and sums after one scalar; ``q`` of the levels."""
        nx, e = self.big_x.shape[1], row[-1]
        own = [kind == WHITE_VARIANCE and index == output for kind, index in self.levels]
        d_g = self.d_p @ h
        q = (d_g @ h + np.array(own, dtype=float)) / s
        self.big_x += np.outer(g, row[:nx]) / s
        self.d_m += ((d_g - np.outer(q, g)) * e + np.outer(row[nx:-1], g)) / s
        cross = d_g[:, :, None] * g
        both = cross + np.swapaxes(cross, 1, 2)
        self.d_p -= (both - q[:, None, None] * np.outer(g, g)) / s
        self.p -= np.outer(g, g) / s
        self.gram += np.outer(row, row) / s
        self.slope += 0.5 * q * (1 - e**2 / s)
        self.information += 0.5 * np.outer(q, q)
        self.total += np.log(s), e**2 / s
        return q

    def _predict(self, record: Commands, k: int, part: tuple[int, int], length: float) -> None:
        """Mean, covariance, columns and tangents over one part of the time to the next sample."""
        na, m, extra, n_full = self.na, self.m, self.extra, len(self.z)
        s = self._advance(
            record, k, part, np.eye(n_full, n_full + len(self.code.graph.free_indices))
        )
        assert s is not None
        phi, by_time, by_damping = self.noise.memory(length)
        f = np.zeros((self.size, self.size))
        f[:na, :na] = s[np.ix_(self.kept, self.kept)]
        f[:na, na:m] = s[np.ix_(self.kept, self.random)]
        f[extra, extra] = phi
        if self.found.moves is not None:
            count = len(self.inside)
            before = self.found.moves[k, :count] if part[0] else np.eye(count)
            self.found.moves[k, :count] = f[np.ix_(self.inside, self.inside)] @ before
        self.big_x = f @ self.big_x
        self.big_x[:na, self.big_x.shape[1] - len(self.chosen) :] += s[
            np.ix_(self.kept, self.chosen)
        ]
        for level in range(len(self.levels)):
            kind = self.levels[level][0]
            self._predict_level(level, f, phi, by_damping if kind == SEA_DAMPING else by_time)
        self.p = f @ self.p @ f.T
        self.p[extra, extra] += np.diag(self.tail) - phi * self.tail @ phi.T
        self.mean[extra] = phi @ self.mean[extra]

    def _predict_level(self, level: int, f: np.ndarray, phi: np.ndarray, d_phi: np.ndarray) -> None:
        """Tangents by one level; the covariance is still the one before the step."""
        kind, index = self.levels[level]
        extra = self.extra
        d_p = f @ self.d_p[level] @ f.T
        self.d_m[level] = f @ self.d_m[level]
        if kind in (FORCE_VARIANCE, COLOUR_VARIANCE, SEA_VARIANCE):
            unit = self._unit(kind, index)
            d_p[extra, extra] += unit - phi @ unit @ phi.T
        elif kind != WHITE_VARIANCE:
            change = np.where(self._lasting(kind, index)[:, None], d_phi, 0.0)
            self.d_m[level, extra] += change @ self.mean[extra]
            moved = change @ (self.p[extra] @ f.T)
            d_p[extra] += moved
            d_p[:, extra] += moved.T
            fresh = change * self.tail @ phi.T
            d_p[extra, extra] -= fresh + fresh.T
        self.d_p[level] = d_p
