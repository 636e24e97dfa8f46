r"""One pass of the extended Kalman filter along a record, with every derivative that a fit needs.

.. math::
    x^-_{k+1} &= F(x^+_k), \quad P^- = F_x P^+ F_x' + Q \\
    S &= h' P^- h + r, \quad e = y - h(x^-), \quad
    x^+ = x^- + P^- h\, e / S, \quad P^+ = P^- - P^- h h' P^- / S

one output at a time. ``x`` stacks the uncertain states of the model, disturbances that are
Gauss-Markov processes of first, second or fourth order (each acts through a parameter of the
model, held over a step), coloured errors of sensors, and the further states of disturbances
(below). Columns ``X`` are derivatives of ``x`` by start states and
parameters along the filtered path at frozen gain; levels of the noise carry exact tangents of mean
and covariance (Jazwinski 1970, *Stochastic processes and filtering theory*, sections 7.3 and 8.3;
Åström 1980, *Maximum likelihood and prediction error methods*, Automatica 16).

A disturbance is one state of first order; two of second, with :math:`\omega = 2\pi/T`

.. math::
    \dot a = \omega b, \qquad
    \dot b = -\omega a - 2 \zeta \omega b + \sqrt{4 \zeta \omega}\, n(t) ,

of which acts the velocity :math:`b` (no power at frequency zero) or the displacement :math:`a`; or
four, the velocity of a second such pair that the first one drives,

.. math:: S(\omega) \propto \frac{\omega^4}
    {\left[(\omega_1^2 - \omega^2)^2 + (2 \zeta_1 \omega_1 \omega)^2\right]
    \left[(\omega_2^2 - \omega^2)^2 + (2 \zeta_2 \omega_2 \omega)^2\right]}

(Spanos 1983, *ARMA algorithms for ocean wave modeling*, J. Energy Resour. Technol. 105), steep
below its peak and with a tail above, as the spectra of a sea. In a basis
:math:`\dot x = \omega A x + B n` whose stationary covariance is the unit matrix, with the force
:math:`x_1` its first component, over a time :math:`h`

.. math:: \Phi = e^{A \omega h}, \qquad Q = \sigma^2 (I - \Phi \Phi') .

What acts over a step is the *mean* of the force, not its first value: values at the steps have the
tail beyond half a step's frequency folded back to low ones, where manoeuvres are, and a sea has no
power there; means lose it by :math:`\mathrm{sinc}^2`. With :math:`m` the mean that :math:`x_k` lets
expect and :math:`\nu_k` the rest, of unit variance and independent of :math:`x_k`,

.. math:: \frac1h \int_0^h x_1\, dt = m' x_k + s\, \nu_k, \qquad
    \begin{pmatrix} x_{k+1} \\ \nu_{k+1} \end{pmatrix} =
    \begin{pmatrix} \Phi & b \\ 0 & 0 \end{pmatrix}
    \begin{pmatrix} x_k \\ \nu_k \end{pmatrix} + \epsilon_k

whose stationary covariance is the unit matrix again, and stays so when a reflection turns
:math:`(m, s)` into the first axis. So the variance, that of the mean, enters force noise alone,
period and damping the transition alone.

*One wave in several equations* is one such process, of which each equation has a part by a standard
deviation and a phase,

.. math:: w_j = \sigma_j (\cos\varphi_j\, y_1 + \sin\varphi_j\, y_2) ,

where two reflections have put the mean of :math:`y_1` first, and second that of :math:`y_2`, which
is a quarter of a period behind it at every frequency, and so independent of it at any one time: of
second order the force, and the integral of a velocity or the rate of a displacement with its sign
turned. Of fourth order both are made of derivatives of :math:`x_0`, the noise through the two
pairs alone, with :math:`s = d/dt / \sqrt{\omega_1 \omega_2}`

.. math:: y_1 \propto (3 s^2 - 1)\, x_0, \qquad y_2 \propto (3 s - s^3)\, x_0, \qquad
    \left| \frac{y_2}{y_1} \right| = \frac{3 r + r^3}{1 + 3 r^2}
    = 1 + \frac{(r - 1)^3}{1 + 3 r^2}, \quad r = \frac{\omega}{\sqrt{\omega_1 \omega_2}} :

a phase is the same for all waves of the sea, and amplitudes differ by 2 % half as fast again. Where
they differ by 8 %, as the integral and the rate of a force do, the response of a vehicle far from
its own period is off by as much, and so is its stiffness.

Without a compiler the same passes run on CasADi's interpreter (:class:`InterpretedFilter`): there
derivatives by levels are complex steps, and nothing is sparse.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from oed_sysid.compiled.compile import call, doubles, load
from oed_sysid.compiled.graph import DIVERGED
from oed_sysid.compiled.interpreter import chained, interpreted
from oed_sysid.compiled.kernels import Kernel, Run
from oed_sysid.errors import ModelError
from oed_sysid.physics.model import Model

# Levels of the noise by kind.
FORCE_VARIANCE, FORCE_TIME, WHITE_VARIANCE, COLOUR_VARIANCE, COLOUR_TIME = range(5)
# Those of a sea: variances and phases count among all narrow-band disturbances.
SEA_VARIANCE, SEA_PERIOD, SEA_DAMPING, SEA_PHASE = range(5, 9)
# Kinds that are the stationary variance of a process.
VARIANCES = (FORCE_VARIANCE, COLOUR_VARIANCE, SEA_VARIANCE)
# Most disturbances that act through one parameter, as in ``filter.c``.
MOST_PROCESSES = 4
# Shapes of a sea, and how their equations turn: one pair of which the velocity or the displacement
# acts, or two, of fourth order.
SHAPES = {"jonswap": 2, "velocity": -1, "displacement": 1}
FOURTH = SHAPES["jonswap"]
# Frequencies of its two pairs over that of the peak, and the damping of the second: nearest, in
# the divergence of Whittle, to JONSWAP spectra of peakedness 1 to 7.
FIRST_PAIR, SECOND_PAIR, SECOND_DAMPING = 0.97, 1.67, 0.42


@dataclass(frozen=True, eq=False)
class Disturbed:
    """Variances and times of everything random in one pass.

    Attributes
    ----------
    disturbances : tuple of str
        Parameters of the model that are random; one stands there as often as processes act on it.
        Those of first order come first.
    variance, time : ndarray (n_disturbances,)
        Stationary variance, and correlation time or period in s; time zero is white from step to
        step.
    white : ndarray (n_outputs,)
        Variances of white sensor noise.
    coloured : ndarray of int (n_coloured,)
        Outputs with coloured errors.
    colour_variance, colour_time : ndarray (n_coloured,)
        Their variances, and correlation times in s.
    damping : ndarray (n_disturbances,), optional
        Of those of a sea.
    turn : ndarray of int (n_disturbances,), optional
        0 for first order, 1 where the displacement acts, -1 where the velocity does, or
        :data:`FOURTH`.
    sea : ndarray of int (n_disturbances,), optional
        Which of those of a sea share period and damping; -1 for first order.
    phase : ndarray (n_disturbances,), optional
        Of the parts of one wave, rad; NaN where a disturbance is a process of its own.
    """

    disturbances: tuple[str, ...]
    variance: np.ndarray
    time: np.ndarray
    white: np.ndarray
    coloured: np.ndarray
    colour_variance: np.ndarray
    colour_time: np.ndarray
    damping: Any = 0.0
    turn: Any = 0
    sea: Any = -1
    phase: Any = np.nan

    def __post_init__(self) -> None:
        coloured = np.ascontiguousarray(self.coloured, dtype=np.intc)
        object.__setattr__(self, "coloured", coloured)
        kinds = {"damping": float, "turn": np.intc, "sea": np.intc, "phase": float}
        for name, kind in kinds.items():
            given = np.asarray(getattr(self, name), dtype=kind)
            object.__setattr__(self, name, np.broadcast_to(given, self.variance.shape).copy())

    @property
    def acting(self) -> tuple[str, ...]:
        """Parameters of the model that are random, each once."""
        return tuple(dict.fromkeys(self.disturbances))

    @property
    def n_second(self) -> int:
        """Number of further states of disturbances, which come last of all."""
        return len(self.owner) - len(self.variance) - len(self.coloured)

    @cached_property
    def parts(self) -> np.ndarray:
        """Disturbances that are parts of one wave, ``(n_parts,)``."""
        return np.flatnonzero(np.isfinite(self.phase))

    @cached_property
    def owner(self) -> np.ndarray:
        """Process of every disturbance, colour and further state, ``(n,)``.

        That of a wave is its first part, behind which all of its states stand.
        """
        process = np.arange(len(self.variance) + len(self.coloured))
        further = np.where(self.turn == 0, 0, np.where(self.turn == FOURTH, 4, 2))
        for part in self.parts:
            process[part] = self.parts[self.sea[self.parts] == self.sea[part]][0]
            further[part] = further[part] + 2 if process[part] == part else 0
        return np.append(process, np.repeat(process[: len(further)], further)).astype(np.intc)

    @cached_property
    def _numbers(self) -> dict[int, np.ndarray]:
        """What disturbances and colours count as among those of a kind, below zero where none."""
        n_forces, n_colours = len(self.variance), len(self.coloured)
        process, first_order = np.arange(n_forces + n_colours), int(np.sum(self.sea < 0))
        colour = process - n_forces
        force = np.where(process < first_order, process, -1)
        part = np.where(process < n_forces, process - first_order, -1)
        sea = np.append(self.sea, np.full(n_colours, -1))
        return {
            COLOUR_VARIANCE: colour, COLOUR_TIME: colour, FORCE_VARIANCE: force, FORCE_TIME: force,
            SEA_VARIANCE: part, SEA_PHASE: part, SEA_PERIOD: sea, SEA_DAMPING: sea,
        }  # fmt: skip

    def touched(self, kind: int, index: int) -> np.ndarray:
        """Disturbances and colours of which a level is variance, time, damping or phase."""
        number = self._numbers[kind]
        return np.asarray(number >= 0 if index < 0 else number == index)

    def random(
        self,
        lengths: np.ndarray,
        following: np.ndarray,
        levels: Sequence[tuple[int, int]] = (),
    ) -> Random:
        r"""What disturbances, colours and further states do over some steps.

        Processes :math:`c` are independent of one another, and parts of waves are mixed from them:
        with :math:`x = T c` and :math:`c = S x`

        .. math:: \phi = T \phi_c S, \qquad D = T D_c T' .

        Parameters
        ----------
        lengths, following : ndarray (n_lengths,)
            Of a step and of the one behind it, s.
        levels : sequence of (kind, index)
            By which derivatives are wanted.
        """
        # Records of the same steps share it.
        asked = lengths.tobytes(), following.tobytes(), tuple(levels)
        if asked not in self._told:
            self._told[asked] = self._random(lengths, following, levels)
        return self._told[asked]

    @cached_property
    def _told(self) -> dict[tuple[bytes, bytes, tuple[tuple[int, int], ...]], Random]:
        """What has been told of some steps and levels."""
        return {}

    def _random(
        self, lengths: np.ndarray, following: np.ndarray, levels: Sequence[tuple[int, int]]
    ) -> Random:
        """Work it out; see :meth:`random`."""
        n, parts = len(self.owner), self.parts
        own = np.ones(n, dtype=bool)
        own[parts] = False
        owner, select = self.owner[own], np.eye(n)[own]
        variance = np.append(self.variance, self.colour_variance)[owner]
        variance[np.isin(owner, parts)] = 1.0
        mix, d_mix = self._mixed(select.T.copy(), owner)
        slopes_asked = any(kind in (SEA_PERIOD, SEA_DAMPING) for kind, _ in levels)
        core = self._transitions(lengths, following, owner, slopes=slopes_asked)

        def lifted(mix: np.ndarray, phi: np.ndarray) -> np.ndarray:
            return mix @ phi @ select if len(parts) else phi

        lanes = -(-len(levels) // 4) * 4  # whole vectors
        slopes, white = np.zeros((n, n, lanes)), np.zeros((len(self.white), lanes))
        moving: dict[int, np.ndarray] = {}
        each = np.arange(n)
        for at, (kind, index) in enumerate(levels):
            if kind == WHITE_VARIANCE:
                white[index, at] = 1.0
                continue
            hit = self.touched(kind, index)
            changed = next((d_mix[kind, j] for j in parts[hit[parts]] if (kind, j) in d_mix), None)
            if changed is not None:
                half = (changed * variance) @ mix.T
                slopes[:, :, at] = half + half.T
                moving[at] = lifted(changed, core[:, 0])
            elif kind in VARIANCES:
                slopes[each, each, at] = hit[self.owner]
            else:
                by = core[:, 2 if kind == SEA_DAMPING else 1]
                moving[at] = lifted(mix, np.where(hit[owner][:, None], by, 0.0))
        changes = np.zeros((len(lengths), len(moving), n, n))
        for change, one in enumerate(moving.values()):
            changes[:, change] = one
        which = np.array([*moving], dtype=np.intc)
        stationary = (mix * variance) @ mix.T
        return Random(stationary, lifted(mix, core[:, 0]), slopes, white, which, changes)

    def _mixed(
        self, mix: np.ndarray, owner: np.ndarray
    ) -> tuple[np.ndarray, dict[tuple[int, int], np.ndarray]]:
        """How parts of waves are mixed, ``(n, n_own)``; derivatives by kind of level and part."""
        slopes = {}
        for j in self.parts:
            turned = np.array([np.cos(self.phase[j]), np.sin(self.phase[j])])
            level = float(np.sqrt(self.variance[j]))
            by_phase = level * np.array([-turned[1], turned[0]])
            # Of records whose samples nothing links a part is absent.
            by_variance = turned * (0.5 / level if level > 0.0 else 0.0)
            wave = np.flatnonzero(owner == self.owner[j])[:2]
            mix[j, wave] = level * turned
            for kind, slope in ((SEA_VARIANCE, by_variance), (SEA_PHASE, by_phase)):
                slopes[kind, int(j)] = np.zeros_like(mix)
                slopes[kind, int(j)][j, wave] = slope
        return mix, slopes

    def _transitions(
        self, lengths: np.ndarray, following: np.ndarray, owner: np.ndarray, *, slopes: bool
    ) -> np.ndarray:
        """Of states of some processes, ``(n_lengths, 3, n, n)``.

        And their derivatives by the logarithms of all times and periods, and of all dampings; those
        of seas only with ``slopes``.
        """
        found = np.zeros((len(lengths), 3, len(owner), len(owner)))
        turn = np.append(self.turn, np.zeros(len(self.coloured), dtype=np.intc))[owner]
        # Numbers a hair above zero: a process without memory has a time of zero.
        times = np.maximum(np.append(self.time, self.colour_time), 1e-9)[owner]
        each = np.flatnonzero(turn == 0)
        found[:, 0, each, each] = left = np.exp(-lengths[:, None] / times[each])
        found[:, 1, each, each] = left * lengths[:, None] / times[each]
        means: dict[tuple[float, float, int, bool], np.ndarray] = {}  # places of a sea share them
        for j in np.unique(owner[turn != 0]):
            where, of_wave = np.flatnonzero(owner == j), bool(j in self.parts)
            kind = float(self.time[j]), float(self.damping[j]), int(self.turn[j]), of_wave
            if kind not in means:
                means[kind] = step_means(lengths, following, *kind, slopes=slopes)
            found[:, :, where[:, None], where] = means[kind]
        return found


@dataclass(frozen=True, eq=False)
class Random:
    """What random components do over steps of some lengths.

    Attributes
    ----------
    stationary : ndarray (n, n)
        Their covariance.
    memory : ndarray (n_lengths, n, n)
        Their transitions.
    by_level : ndarray (n, n, n_lanes)
        Derivatives of the covariance by levels; these in whole vectors of four.
    white_by_level : ndarray (n_outputs, n_lanes)
        Those of the variances of white noise.
    moving : ndarray of int (n_moving,)
        Levels that change the transitions.
    memory_by_level : ndarray (n_lengths, n_moving, n, n)
        Derivatives of the transitions by these; by times and dampings, of their logarithms.
    """

    stationary: np.ndarray
    memory: np.ndarray
    by_level: np.ndarray
    white_by_level: np.ndarray
    moving: np.ndarray
    memory_by_level: np.ndarray


def rates(turn: int, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """The matrix ``A`` above for a unit frequency, and ``y`` of one wave in these states.

    Returns
    -------
    ndarray (n_states, n_states), (2, n_states)
    """
    z = damping
    if turn != FOURTH:
        a = np.array([[z * (turn - 1), turn], [-turn, -z * (turn + 1)]])
        return a, np.diag([1.0, -turn])
    # Velocity and displacement of the driven pair, then of the one that drives.
    w, v = SECOND_PAIR, FIRST_PAIR
    a = np.array(
        [
            [-2 * SECOND_DAMPING * w, -w, w, 0],
            [w, 0, 0, 0],
            [0, 0, -2 * z * v, -v],
            [0, 0, v, 0],
        ]
    )
    drive = np.diag([0.0, 0.0, 1.0, 0.0])
    # In coordinates of unit stationary covariance, as the two states of a second-order sea are.
    root = np.linalg.cholesky(solve_continuous_lyapunov(a, -drive))
    # The displacement is in proportion to the first derivative of what passes both pairs alone.
    first, middle = np.array([0.0, 1.0, 0.0, 0.0]), np.sqrt(v * w)
    second = first @ a / middle**2
    behind = 3.0 * first / middle - second @ a / middle
    together = np.array([3.0 * second - first @ np.linalg.inv(a), behind]) @ root
    together /= np.linalg.norm(together, axis=1)[:, None]
    return np.linalg.solve(root, a @ root), together


@lru_cache(maxsize=256)
def _modes(turn: int, damping: float) -> tuple[np.ndarray, ...]:
    """Eigenvalues of these rates, vectors and their inverse, noise and what acts in these modes."""
    a, together = rates(turn, damping)
    values, vectors = np.linalg.eig(a.astype(complex))
    inverse = np.linalg.inv(vectors)
    spread = -(a + a.T)  # of rank one, as noise enters one equation
    strongest = int(np.argmax(np.diag(spread)))
    drive = spread[:, strongest] / np.sqrt(spread[strongest, strongest])
    acting = np.vstack([np.eye(len(a))[:1], together]) @ vectors
    return values, vectors, inverse, inverse @ drive, acting


def narrow_band(lengths: np.ndarray, period: float, damping: float, turn: int) -> np.ndarray:
    """Transitions of the states of a sea, its force first.

    Parameters
    ----------
    lengths : ndarray (n_lengths,)
        s.
    period : float
        s.
    damping : float
        Below one.
    turn : int
        1 where the displacement acts, -1 where the velocity does, :data:`FOURTH`.

    Returns
    -------
    ndarray (n_lengths, n_states, n_states)

    Examples
    --------
    >>> phi = narrow_band(np.array([8.0]), 8.0, 0.1, -1)[0]
    >>> float(np.linalg.det(phi).round(4)), float(np.exp(-4 * np.pi * 0.1).round(4))
    (0.2846, 0.2846)
    """
    values, vectors, inverse, *_ = _modes(turn, damping)
    angles = 2 * np.pi * np.asarray(lengths, dtype=float)[:, None] / period
    return np.asarray((vectors * np.exp(values * angles)[:, None, :] @ inverse).real)


def step_means(
    lengths: np.ndarray,
    following: np.ndarray,
    period: float,
    damping: float,
    turn: int,
    one_wave: bool = False,
    *,
    slopes: bool = True,
) -> np.ndarray:
    """Transitions of the mean force of a sea over steps and of its further states.

    Parameters
    ----------
    lengths, following : ndarray (n_lengths,)
        Of a step and of the one behind it, s.
    period, damping, turn
        As of :func:`narrow_band`.
    one_wave : bool
        Whether the means of both ``y`` come first.
    slopes : bool
        Whether derivatives are wanted; zero without.

    Returns
    -------
    ndarray (n_lengths, 3, n, n)
        In coordinates of unit stationary covariance, one more than there are states, two of one
        wave; and derivatives by the logarithms of period and damping.

    Examples
    --------
    Of means over eighths of a period, neighbours are correlated by nearly its cosine.

    >>> phi = step_means(np.array([1.0]), np.array([1.0]), 8.0, 0.01, -1)[0, 0]
    >>> float(phi[0, 0].round(1)), float(np.cos(2 * np.pi / 8).round(1))
    (0.7, 0.7)
    """
    angles = 2 * np.pi / period * np.stack([lengths, following])

    def over(factors: np.ndarray, damping: float) -> np.ndarray:
        """Of angles times some factors, ``(n_factors, n_lengths, n, n)``."""
        every = factors[:, None, None] * angles
        found = _with_mean(every.ravel(), damping, turn, one_wave)
        stepped, turned = (one.reshape(*every.shape, *one.shape[1:]) for one in found)
        return np.asarray(np.swapaxes(turned[:, 1], 2, 3) @ stepped[:, 0] @ turned[:, 0])

    moved = 1e-5 * np.array([0.0, -1.0, 1.0])[: 3 if slopes else 1]  # of the logarithm
    value, *ends = over(np.exp(moved), damping)  # a longer period turns less
    by = [np.zeros_like(value)] * 2
    if slopes:
        more, less = (over(np.ones(1), damping * np.exp(step))[0] for step in (1e-5, -1e-5))
        by = [(ends[0] - ends[1]) / 2e-5, (more - less) / 2e-5]
    return np.stack([value, *by], axis=1)


# On an interval of unit length: exact to rounding for the thirds of a wave that a step is at most.
_NODES, _WEIGHTS = 0.5 * np.array(np.polynomial.legendre.leggauss(10)) + [[0.5], [0.0]]


def _with_mean(
    angles: np.ndarray, damping: float, turn: int, one_wave: bool
) -> tuple[np.ndarray, np.ndarray]:
    r"""Transition of :math:`(x, \nu)` over steps of some angles, and what puts the mean first."""
    values, vectors, inverse, push, acting = _modes(turn, damping)
    n, size = len(angles), len(values)
    means = acting[1:] if one_wave else acting[:1]
    whole = size + len(means)
    # What a unit of noise that came some angle before the end has made of the states and the means:
    # their covariance is an integral of products, which loses nothing however short the step is.
    before = values * (angles[:, None] * _NODES)[:, :, None]
    root = np.sqrt(angles[:, None] * _WEIGHTS)[:, :, None]
    states = root * ((np.exp(before) * push) @ vectors.T).real
    made = ((np.expm1(before) / values * push) @ means.T).real / angles[:, None, None]
    fresh, rest = np.linalg.qr(root * made)
    stepped = np.zeros((n, whole, whole))
    powers = values * angles[:, None]
    stepped[:, :size, :size] = (vectors * np.exp(powers)[:, None, :] @ inverse).real
    stepped[:, :size, size:] = np.swapaxes(states, 1, 2) @ fresh
    acting = np.zeros((n, whole, len(means)))
    let_expect = ((np.expm1(powers) / powers)[:, None, :] * means @ inverse).real
    acting[:, :size] = np.swapaxes(let_expect, 1, 2)
    acting[:, size:] = rest
    turned = _reflection(acting[:, :, 0])
    if one_wave:
        inner = np.einsum("tij,ti->tj", turned, acting[:, :, 1])[:, 1:]
        turned[:, :, 1:] = turned[:, :, 1:] @ _reflection(inner)
    return stepped, turned


def _reflection(directions: np.ndarray) -> np.ndarray:
    """Orthogonal matrices, near one, whose first columns are some directions, ``(n, size, size)``.

    Householder's reflections, with their other columns turned round.
    """
    sign = np.where(directions[:, :1] < 0, -1.0, 1.0)
    axis = sign * directions / np.linalg.norm(directions, axis=1)[:, None]
    axis[:, 0] += 1.0
    found = axis[:, :, None] * axis[:, None, :] / axis[:, 0, None, None]
    found -= np.eye(axis.shape[1])
    found[:, :, 1:] *= -1.0
    found[:, :, 0] *= sign
    return np.asarray(found)


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps over which disturbances are held, from sample to sample.

    Attributes
    ----------
    longest : float
        s.
    which : ndarray of int (n_times - 1, 2)
        Transitions of the steps before each next sample, and of the last of them.
    lengths, following : ndarray (n_transitions,)
        Of the step of each transition and of the one behind it, s.
    """

    longest: float
    which: np.ndarray
    lengths: np.ndarray
    following: np.ndarray


@dataclass(frozen=True, eq=False)
class Along:
    """One record and what a model is along it.

    Attributes
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
    active : sequence of int, optional
        Components of the full state that are uncertain; all by default.
    passing : sequence of int
        Components besides these that are certain, and only pass derivatives on.
    longest_step : float, optional
        Longest time over which disturbances are held, s; the median sample time by default.
    beyond : ndarray (n_times, n_outputs), optional
        Largest square of an innovation, over its variance, that moves anything; any by default.
    """

    times: np.ndarray
    inputs: np.ndarray
    values: np.ndarray
    own: np.ndarray
    measured: np.ndarray
    noise: Disturbed
    active: Sequence[int] | np.ndarray | None = None
    passing: Sequence[int] | np.ndarray = ()
    longest_step: float | None = None
    beyond: np.ndarray | None = None

    def __post_init__(self) -> None:
        given = () if self.beyond is None else ("beyond",)
        for name in ("times", "inputs", "values", "measured", *given):
            object.__setattr__(self, name, *doubles(getattr(self, name)))

    @property
    def steps(self) -> Steps:
        """Steps over which disturbances are held."""
        return steps_along(self.times.tobytes(), self.longest_step)


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
    rows : ndarray (n_times, n_outputs, n_columns + 2 n_levels)
        ``de / sqrt(S)``, also where nothing was measured, then ``q`` of the levels. Rows, gains and
        moves have no times where they were not asked for.
    path : ndarray (n_times, n_full + n_disturbances + n_coloured)
        Filtered means.
    gains : ndarray (n_times, n_outputs, 2, n)
        Derivatives of each output, and the gain of its innovation, also where nothing was measured.
        The ``n`` are active components, disturbances, colours and second states of disturbances.
    moves : ndarray (n_times, n + n_disturbances, n)
        Their transition towards the next sample (zero at the last one), above the predicted
        covariance of the disturbances with them.
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
    rows: np.ndarray
    path: np.ndarray
    gains: np.ndarray
    moves: np.ndarray
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


# Complex step by which levels move: its square is no number any more.
_STEP = float(np.sqrt(np.finfo(float).tiny))


class InterpretedFilter:
    """One pass over one record.

    Parameters
    ----------
    model : Model
    along : Along
    z0 : ndarray (n_full,)
        Full state at the first sample.
    kept : sequence of int
        Components of it that are uncertain, then those that only pass derivatives on.
    """

    def __init__(self, model: Model, along: Along, z0: np.ndarray, kept: np.ndarray) -> None:
        self.code, self.noise, noise = interpreted(model), along.noise, along.noise
        self.longest_step = along.steps.longest
        self.record, self.measured = (along.times, along.inputs), along.measured
        self.z, self.values, self.kept = z0.copy(), along.values.copy(), kept
        self.position = [model.parameter_names.index(name) for name in noise.disturbances]
        free = [model.free_names.index(name) for name in noise.disturbances]
        self.random = len(z0) + np.array(free, dtype=int)
        self.na, self.m = len(kept), len(kept) + len(self.random)
        self.coloured = slice(self.m, self.m + len(noise.coloured))
        self.size = self.coloured.stop + noise.n_second
        self.extra = slice(self.na, self.size)
        self.levels: Sequence[tuple[int, int]] = ()
        most = np.inf if along.beyond is None else along.beyond
        self.beyond = np.broadcast_to(most, along.measured.shape)
        # Of the record as it is; below it, of derivatives by levels.
        self.mean = np.zeros((1, self.size))

    def replay(self, gains: np.ndarray, innovations: np.ndarray) -> int:
        """Innovations at the gains of an earlier pass; -1, or the sample that is not finite."""
        for k, measured in enumerate(self.measured):
            if not abs(self.z.sum()) < DIVERGED:
                return k
            y, acted = self._sample(k)[0], self.mean[0, self.na : self.m].copy()
            for i in np.flatnonzero(np.isfinite(measured)):
                h, gain = gains[k, i]
                e = measured[i] - y[i] + h[self.na : self.m] @ acted - self.mean[0] @ h
                if not np.isfinite(e):
                    return k
                self.mean += gain * e
                innovations[k, i] = e
            self._correct()
            for step, steps, lengths in self._parts(k):
                self._advance(k, (step, steps), np.zeros((len(self.z), 0)))
                phi = self._over(lengths).memory[0]
                self.mean[:, self.extra] = self.mean[:, self.extra] @ phi.T
        return -1

    def filter(
        self,
        first: np.ndarray,
        chosen: np.ndarray,
        levels: Sequence[tuple[int, int]],
        n_active: int,
        found: FilterPass,
        total: np.ndarray,
    ) -> int:
        """Fill the results as the compiled loop does; -1, or the failing sample.

        Mean and covariance are carried once as they are and once for every level, moved by a step
        so small that derivatives, the imaginary parts, are exact (Squire & Trapp 1998).
        """
        self.levels, self.found = levels, found
        self.chosen = len(self.z) + chosen
        self.inside = [*range(n_active), *range(self.na, self.size)]
        nx, nl = first.shape[1], len(levels)
        # Derivatives of the mean by columns, whose gain is frozen.
        self.d_mean = np.zeros((self.size, nx))
        self.d_mean[: self.na] = first
        self.own = slice(nx - len(chosen), nx)
        # Disturbances begin in their stationary distribution; start states are unknowns, without
        # any.
        begun = self.noise.random(np.zeros(0), np.zeros(0), levels)
        self.mean = np.zeros((1 + nl, self.size), dtype=complex)
        self.p = np.zeros((1 + nl, self.size, self.size), dtype=complex)
        self.p[:, self.extra, self.extra] = self._moved(begun.stationary, begun.by_level)
        self.white = self._moved(self.noise.white, begun.white_by_level)
        self.gram, self.total = np.zeros((nx + nl + 1,) * 2), np.zeros(2)
        for k, measured in enumerate(self.measured):
            if not abs(self.z.sum()) < DIVERGED or not self._measure(k, measured):
                return k
            for step, steps, lengths in self._parts(k):
                self._predict(k, (step, steps), lengths)
        found.gram[:], total[:] = self.gram, self.total
        return -1

    def _moved(self, value: np.ndarray, by_level: np.ndarray) -> np.ndarray:
        """A value, then the same with every level moved, ``(1 + n_levels, ...)``."""
        steps = np.moveaxis(by_level, -1, 0)[: len(self.levels)]
        return np.concatenate([value[None], value + 1j * _STEP * steps])

    def _parts(self, k: int) -> list[tuple[int, int, tuple[float, float]]]:
        """Steps from sample ``k`` on over which disturbances are held; none after the last.

        Each with its length and that of the step behind it.
        """
        times = self.record[0]
        if k + 1 == len(times):
            return []
        counts, lengths = steps_between(times[k : k + 3], self.longest_step)
        inner = [(step, counts[0], (lengths[0], lengths[0])) for step in range(counts[0] - 1)]
        return [*inner, (counts[0] - 1, counts[0], (lengths[0], lengths[-1]))]

    def _over(self, lengths: tuple[float, float]) -> Random:
        """What random components do over a step."""
        here, behind = np.array(lengths)[:, None]
        return self.noise.random(here, behind, self.levels)

    def _let_act(self) -> None:
        """Disturbances into the parameters through which they act."""
        self.values[self.position] = 0.0
        np.add.at(self.values, self.position, self.mean[0, self.na : self.m].real)

    def _sample(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Outputs and the state after a measurement under the disturbances, with derivatives."""
        self._let_act()
        return self.code.sample(self.z, self.record, k, self.values, self.longest_step)

    def _correct(self) -> None:
        """Take what a sample told of the state over into the state."""
        self.z[self.kept] += self.mean[0, : self.na].real
        self.mean.real[:, : self.na] = 0.0

    def _advance(self, k: int, part: tuple[int, int], s: np.ndarray) -> np.ndarray:
        """Move the state, and sensitivities ``s``, over one part of the time to the next sample."""
        self._let_act()
        if part[0] == 0:  # sensor memory moves on with what is known after the measurement
            _, self.z, _, d_after = self._sample(k)
            s = chained(d_after, s)
        self.z, s = self.code.move(self.z, s, self.record, k, self.values, part)
        return s

    def _measure(self, k: int, measured: np.ndarray) -> bool:
        """Correct by one sample, one output at a time; whether everything is finite."""
        noise, found, na, m, nx = self.noise, self.found, self.na, self.m, self.d_mean.shape[1]
        y, _, dy, _ = self._sample(k)
        acted = self.mean[0, na:m].real.copy()
        if len(found.moves):
            found.moves[k, len(self.inside) :] = self.p[0, na:m][:, self.inside].real
        # One scalar after the other: white noises of two sensors are independent.
        for i in range(len(y)):
            of_sensor, second = noise.coloured == i, np.zeros(noise.n_second)
            h = np.concatenate([dy[i, self.kept], dy[i, self.random], of_sensor, second])
            g = self.p @ h
            s = g @ h + self.white[:, i]
            found.variances[k, i] = variance = s[0].real
            if not variance > 0:
                return False
            # Outputs hold the disturbances; all else of the mean counts to first order.
            e = measured[i] - y[i] + h[na:m] @ acted - self.mean @ h
            # de = -h' dm - dy/dp, by levels as they move it, and e itself behind them.
            row = np.concatenate([-h @ self.d_mean, e[1:].imag / _STEP, e[:1].real])
            row[self.own] -= dy[i, self.chosen]
            if len(found.rows):
                found.rows[k, i, : len(row) - 1] = row[:-1] / np.sqrt(variance)
            if len(found.gains):
                found.gains[k, i] = h[self.inside], g[0, self.inside].real / variance
            if not np.isfinite(measured[i]):
                continue
            if not np.isfinite(row[-1]):
                return False
            found.innovations[k, i] = row[-1]
            square = row[-1] ** 2 / variance
            if square > self.beyond[k, i]:
                continue
            gain = g / s[:, None]
            self.mean += gain * e[:, None]
            self.d_mean += np.outer(gain[0].real, row[:nx])
            self.p -= gain[:, :, None] * g[:, None, :]
            q = np.log(s[1:]).imag / _STEP
            self.gram += np.outer(row, row) / variance
            found.level_slope[:] += 0.5 * q * (1 - square)
            found.level_information[:] += 0.5 * np.outer(q, q)
            self.total += np.log(variance), square
            if len(found.rows):
                found.rows[k, i, len(row) - 1 :] = q
        self._correct()
        found.path[k] = [*self.z, *self.mean[0, na : self.coloured.stop].real]
        return True

    def _predict(self, k: int, part: tuple[int, int], lengths: tuple[float, float]) -> None:
        """Mean, covariance and columns over one part of the time to the next sample."""
        na, extra, n_full = self.na, self.extra, len(self.z)
        s = self._advance(k, part, np.eye(n_full, n_full + len(self.code.graph.free_indices)))
        over = self._over(lengths)
        stationary = self._moved(over.stationary, over.by_level)
        phi = over.memory[0] + np.zeros_like(stationary)
        phi[1 + over.moving] += 1j * _STEP * over.memory_by_level[0]
        f = np.zeros_like(self.p)
        f[:, :na, :na] = s[np.ix_(self.kept, self.kept)]
        f[:, :na, na : self.m] = s[np.ix_(self.kept, self.random)]
        f[:, extra, extra] = phi
        if len(self.found.moves):
            count = len(self.inside)
            before = self.found.moves[k, :count] if part[0] else np.eye(count)
            self.found.moves[k, :count] = f[0].real[np.ix_(self.inside, self.inside)] @ before
        self.mean = (f @ self.mean[:, :, None])[:, :, 0]
        self.mean.real[:, :na] = 0.0  # in the state, which has moved on its own
        self.d_mean = f[0].real @ self.d_mean
        self.d_mean[:na, self.own] += s[np.ix_(self.kept, self.chosen)]
        # P^- = F P F' + D - phi D phi': stationary where nothing is measured.
        self.p = f @ self.p @ np.swapaxes(f, 1, 2)
        self.p[:, extra, extra] += stationary - phi @ stationary @ np.swapaxes(phi, 1, 2)
        self.p = 0.5 * (self.p + np.swapaxes(self.p, 1, 2))  # see filter.c


class FilterKernel(Kernel):
    """Filter of one model structure, and its trajectories without sensitivities.

    Parameters
    ----------
    model : Model
        Some of its free parameters are disturbances, at value zero. Columns
        are chosen at run time, so that one library serves every sub-model.
    """

    def __init__(self, model: Model) -> None:
        super().__init__(model)
        self.library = load(model, filtered=True)  # of the filter, in the place of its own
        self._free = {name: i for i, name in enumerate(model.free_names)}
        self._position = {name: i for i, name in enumerate(model.parameter_names)}
        if self.library is not None:
            self.library.kernel_filter_work.restype = ctypes.c_size_t

    def __reduce__(self) -> tuple[Callable[[Model], FilterKernel], tuple[Model]]:
        return filter_kernel, (self.model,)

    def part(self, model: Model, own: np.ndarray) -> Kernel | None:
        """Trajectories of a smaller model by the same library; None where nothing is compiled.

        Parameters
        ----------
        model : Model
            Without some effects, whose absence is their default.
        own : ndarray of int (n_full,)
            Components of the full state that it has.
        """
        return None if self.library is None else _Part(self, self.library, model, own)

    def filter(
        self,
        along: Along,
        *,
        names: Sequence[str] = (),
        own_columns: bool = True,
        levels: Sequence[tuple[int, int]] = (),
        rows: bool = False,
        gains: bool = False,
        moves: bool = False,
    ) -> FilterPass:
        """Filter one record.

        Parameters
        ----------
        along : Along
        names : sequence of str
            Parameters with a column.
        own_columns : bool
            Whether the own start states have columns, which come first.
        levels : sequence of (kind, index)
            Levels with tangents, ``FORCE_VARIANCE`` and its like; index -1 is the time of all.
            ``SEA_VARIANCE`` and ``SEA_PHASE`` count among narrow-band disturbances,
            ``SEA_PERIOD`` and ``SEA_DAMPING`` are of a sea.
        rows : bool
            Whether to return the derivatives of every innovation.
        gains : bool
            Whether to return gains, for :meth:`replay`.
        moves : bool
            Whether to return transitions and covariances, for a smoother.
        """
        n, noise, n_outputs, n_levels = len(along.times), along.noise, self.n_outputs, len(levels)
        passing = along.passing if own_columns or names else ()
        z0, dz0, kept = self._begun(along, passing)
        chosen = np.array([self._free[name] for name in names], dtype=int)
        random = [self._free[name] for name in noise.acting]
        if crowded := [n for n in noise.acting if noise.disturbances.count(n) > MOST_PROCESSES]:
            raise ModelError(
                f"More than {MOST_PROCESSES} processes act on {crowded[0]!r}. Take fewer seas."
            )
        n_active = len(kept) - len(passing)
        own_states = range(self.n_own if own_columns else 0)
        first = dz0[np.ix_(kept, [*own_states, *(self.n_own + chosen)])]
        width, n_random = first.shape[1] + n_levels, len(noise.disturbances)
        n_extra = len(noise.owner)
        inner = n_active + n_extra
        level, total = np.zeros(n_levels * (n_levels + 1)), np.full(2, np.inf)
        # What no pass fills stays NaN.
        found = FilterPass(
            gram=np.full((width + 1, width + 1), np.nan),
            level_slope=level[:n_levels],
            level_information=level[n_levels:].reshape(n_levels, n_levels),
            log_variance=np.inf,
            square=np.inf,
            innovations=np.full((n, n_outputs), np.nan),
            variances=np.full((n, n_outputs), np.nan),
            rows=np.zeros((n * rows, n_outputs, width + n_levels)),
            path=np.full((n, self.n_full + n_random + len(noise.coloured)), np.nan),
            gains=np.zeros((n * gains, n_outputs, 2, inner)),
            moves=np.zeros((n * moves, inner + n_random, inner)),
            failed_at=-1,
        )

        def done(failed: int) -> FilterPass:
            log_variance, square = map(float, total)
            return replace(found, log_variance=log_variance, square=square, failed_at=failed)

        if self.library is None:
            slow = InterpretedFilter(self.model, along, z0, kept)
            return done(slow.filter(first, chosen, levels, n_active, found, total))
        columns = np.full(max(self.n_free, 1), -1, dtype=np.intc)
        # Behind the active components: chosen parameters, then those that are random.
        columns[[*chosen, *random]] = n_active + np.arange(len(chosen) + len(random))
        positions = np.array([self._position[d] for d in noise.disturbances], dtype=np.intc)
        acting = np.array([noise.acting.index(d) for d in noise.disturbances], dtype=np.intc)
        steps = along.steps
        over = noise.random(steps.lengths, steps.following, levels)
        x0, white, stationary, memory, d_white, d_stationary, d_memory = doubles(
            first, noise.white, over.stationary, over.memory,
            over.white_by_level, over.by_level, over.memory_by_level,
        )  # fmt: skip
        sizes = (n_active, len(passing), n_random, n_extra, first.shape[1], n_levels)
        work = np.empty(self.library.kernel_filter_work(*sizes))
        failed = call(
            self.library.kernel_filter, n, along.times, along.inputs, along.values,
            float(self.model.step), steps.longest, z0, n_active, len(passing), kept, first.shape[1],
            len(chosen), n_active, n_active + len(chosen), columns, x0, n_random, len(random),
            positions, acting, white, len(noise.coloured), noise.coloured, n_extra, stationary,
            steps.which, memory, n_levels, d_white, d_stationary, len(over.moving),
            over.moving, d_memory, along.measured, along.beyond, found.gram, level,
            found.innovations, found.variances, found.rows, found.path, found.gains, found.moves,
            total, work,
        )  # fmt: skip
        return done(failed)

    def replay(self, along: Along, gains: np.ndarray) -> tuple[np.ndarray, bool]:
        """Innovations of other values at the gains of an earlier pass.

        What a change of the model does to the innovations at frozen gain, without derivatives
        and hence at a fraction of the cost of a pass.

        Parameters
        ----------
        along : Along
        gains : ndarray (n_times, n_outputs, 2, n)
            As a pass with the same active components, disturbances and colours has kept them.

        Returns
        -------
        innovations : ndarray (n_times, n_outputs)
            NaN where nothing was measured.
        ok : bool
            Whether everything stayed finite.
        """
        n, noise = len(along.times), along.noise
        z0, _, kept = self._begun(along, ())
        innovations = np.full((n, self.n_outputs), np.nan)
        if self.library is None:
            failed = InterpretedFilter(self.model, along, z0, kept).replay(gains, innovations)
            return innovations, failed < 0
        positions = np.array([self._position[d] for d in noise.disturbances], dtype=np.intc)
        steps = along.steps
        memory, gains = doubles(noise.random(steps.lengths, steps.following).memory, gains)
        mean, delta = np.empty((2, gains.shape[-1]))
        failed = call(
            self.library.kernel_replay, n, along.times, along.inputs, along.values,
            float(self.model.step), steps.longest, z0, len(kept), kept, len(positions), positions,
            len(noise.coloured), noise.coloured, len(noise.owner), steps.which, memory,
            along.measured, gains, innovations, mean, delta,
        )  # fmt: skip
        return innovations, failed < 0

    def _begun(
        self, along: Along, passing: Sequence[int] | np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """First full state, its derivatives, and the components that are kept."""
        z0, dz0 = self.start(along.own, along.inputs[0], along.values, along.times[0])
        active = range(self.n_full) if along.active is None else along.active
        return z0, dz0, np.ascontiguousarray([*active, *passing], dtype=np.intc)


class _Part(Kernel):
    """A model that is run as part of a larger one: a study compiles no other."""

    def __init__(
        self, wide: FilterKernel, library: ctypes.CDLL, model: Model, own: np.ndarray
    ) -> None:
        super().__init__(model, compiled=False)
        self._wide, self._select, self._own = wide, library.kernel_select, own
        names, free = wide.model.parameter_names, wide.model.free_names
        self._places = [names.index(name) for name in model.parameter_names]
        self._free = np.array([free.index(name) for name in model.free_names], dtype=int)
        self._values = wide.model.value_vector
        # Where a command stands still an absent memory would take its derivatives: begun aside,
        # it does not.
        memories = wide.n_full - sum(len(e.memory) for e in wide.model.effects)
        self._aside = np.setdiff1d(np.arange(memories, wide.n_full), own)

    def _widened(self, values: np.ndarray) -> np.ndarray:
        found = self._values.copy()
        found[self._places] = values
        return found

    def start(
        self, own: np.ndarray, inputs: np.ndarray, values: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        z, dz = self._wide.start(own, inputs, self._widened(values), time)
        columns = [*range(self.n_own), *(self.n_own + self._free)]
        return z[self._own], dz[np.ix_(self._own, columns)]

    def run(
        self,
        times: np.ndarray,
        inputs: np.ndarray,
        values: np.ndarray,
        nodes: np.ndarray,
        *,
        starts: np.ndarray | None = None,
        from_nodes: int | None = None,
        sensitivities: bool = False,
        n_columns: int | None = None,
    ) -> Run:
        wide, values, nodes = self._wide, self._widened(values), np.atleast_2d(nodes)
        first, _ = wide.start(nodes[0, : self.n_own], inputs[0], values, times[0])
        first[self._aside] += 1.0
        z = np.tile(first, (len(nodes), 1))
        z[:, self._own] = nodes
        columns = np.full(max(wide.n_free, 1), -1, dtype=np.intc)
        columns[self._free] = wide.n_full + np.arange(self.n_free)
        width = wide.n_full + self.n_free if sensitivities else 0
        call(self._select, width, columns)
        found = wide.run(
            times,
            inputs,
            values,
            z,
            starts=starts,
            from_nodes=from_nodes,
            n_columns=width or None,
        )
        kept = [*self._own, *range(wide.n_full, width)] if sensitivities else []
        return replace(
            found,
            states=found.states[:, self._own],
            ends=found.ends[:, self._own],
            output_sensitivities=found.output_sensitivities[:, :, kept],
            end_sensitivities=found.end_sensitivities[:, self._own][:, :, kept],
        )


def steps_between(times: np.ndarray, longest_step: float) -> tuple[np.ndarray, np.ndarray]:
    """How many steps each interval has, and their lengths, s, ``(n_intervals,)``."""
    intervals = np.diff(times)
    counts = np.maximum(1, np.ceil(intervals / longest_step - 1e-6).astype(int))
    return counts, (intervals / counts).round(12)


@lru_cache(maxsize=64)
def steps_along(times: bytes, longest: float | None) -> Steps:
    """Steps along the samples of a record, found once for all of its passes.

    Parameters
    ----------
    times : bytes
        Of the samples, doubles.
    longest : float or None
        Longest step, s; None for the median sample time.
    """
    samples = np.frombuffer(times)
    if longest is None:
        longest = float(np.median(np.diff(samples))) if len(samples) > 1 else 1.0
    lengths, own = np.unique(steps_between(samples, longest)[1], return_inverse=True)
    # A pair is one number: rows of two are sorted a hundred times as slowly.
    pairs = own * len(lengths) + np.stack([own, np.append(own[1:], own[-1:])])
    different, which = np.unique(pairs, return_inverse=True)
    inner, last = lengths[np.array(np.divmod(different, len(lengths)))]
    which = np.ascontiguousarray(which.reshape(pairs.shape).T, dtype=np.intc)
    return Steps(float(longest), which, inner, last)


_CACHE: dict[tuple[str, float], FilterKernel] = {}


def filter_kernel(model: Model) -> FilterKernel:
    """Return the filter of a model, compiled at most once per structure."""
    key = (model.structure_key(), model.step)
    if key not in _CACHE:
        _CACHE[key] = FilterKernel(model)
    return _CACHE[key]
