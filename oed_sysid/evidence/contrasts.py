r"""What no motion can explain: faults of a log from kinematics, in one regression.

Free forces of unlimited strength make every velocity possible, so that only what the signals say
about each other is evidence. Of an equation :math:`\dot y = f(s)` between measured signals that is
the contrast

.. math:: e(t) = y(t) - c - \int^t f(s)\,dt,

from which true motion falls out: the rival of every fault, *the vehicle really moved so*, has been
projected out before any fault is asked. A fault that adds :math:`\varphi g_j(t)` to a logged
signal :math:`j` (the table :data:`SHAPES`) adds, to first order,

.. math:: \varphi \Bigl( g_y - \int^t \sum_j \frac{\partial f}{\partial s_j}\, g_j\,dt \Bigr)

to the contrast: one column for each candidate, whatever it is.

Noise. The contrast of block means holds the noise of :math:`y`, perhaps correlated, and the
integrated noise of the rates. The discrete cosine transform makes white noise and a random walk
around a free constant exactly diagonal, with variances :math:`1` and :math:`1/\lambda_k`,
:math:`\lambda_k = 2 - 2\cos(\pi k/n)`, and stationary noise nearly so. With
:math:`a_\rho(k) = (1-\rho)^2 / (1 - 2\rho\cos(\pi k/n) + \rho^2)` the variance of coefficient
:math:`k` is

.. math:: S_k = \sum_\rho v_\rho\, a_\rho(k)
    + \Bigl(\sum_\rho w_\rho\, a_\rho(k) + \sum_j s_j\, b_j(k)\Bigr) / \lambda_k,
    \qquad v, w, s \ge 0,

of largest likelihood (Whittle 1953), all candidates of every record in the regression, so that no
fault passes as noise; with :math:`x = \lambda_k / \lambda_j`,
:math:`b_j = h^2 x / ((1 - x)^2 + h^2 x)` are forces in a band of half an octave, as a sea's are, of
equations in which forces are noise; :math:`w_0` is not taken below what the fast noise of the rates
makes.
Sensors and motion share the low frequencies of it: strongly autocorrelated noise widens all
intervals instead of making biases.

Test. Of a candidate with score :math:`r` and information :math:`d`, given what is in, the
likelihood-ratio statistic is :math:`r^2/d`. The false-alarm budget :math:`\alpha` of a log is
divided by the number of candidates; the variance of the noise is itself estimated, with
:math:`\nu` degrees of freedom by Satterthwaite's rule from the information of
:math:`(v, w)`, and the limit is the square of Student's quantile at :math:`\nu`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product

import numpy as np
from scipy.fft import dct, idct
from scipy.special import stdtrit

from oed_sysid.evidence.chance import FALSE_CLAIMS
from oed_sysid.evidence.corrections import ADDED, lagged, level_axis, logged, pivot, undo
from oed_sysid.evidence.relations import READINGS, Relation, names_of, nominal_sides
from oed_sysid.evidence.result import Correction
from oed_sysid.evidence.traces import LEAST, Trace, fast_noise, units_of
from oed_sysid.likelihood.projection import ABSORBED
from oed_sysid.runtime.constants import MATERIAL, NEGLIGIBLE

# Resolution: block means of a piece; and places a record at which a step or a burst is tried before
# its place is refined.
MOST_BLOCKS = 240
PLACES = MOST_BLOCKS // 4
PLACED = np.arange(1, PLACES) / PLACES
# Variance of noise at one place of a record over that of the whole.
VARYING = 1.5
# Correlations of block means among which noise is composed.
CORRELATIONS = (0.0, 0.5, 0.8, 0.95)
# Width of a band of forces over its frequency, half an octave, and how many of them are tried: from
# periods of four blocks to those of which a long record holds twenty.
BAND, BANDS = 0.5 * math.log(2.0), 4
# A size beyond this many usual ones is none that such faults have.
LARGEST = 4.0
# What an equation may leave of the changes of its left side.
UNEXPLAINED = MATERIAL
# ... and of what noise makes (power); so far beyond a limit linearised scores mislead.
LOUDER = 8.0
# Effort: faults that one log is explained by, and iterations of its fit, at most.
MOST_FAULTS, SWEEPS = 6, 12
# Explanations are one group unless the odds between them are those of a false alarm.
CLOSE = -2.0 * math.log(FALSE_CLAIMS)
# Errors are that much wider than said: the law of the noise is estimated, faults are selected.
WIDER = 1.15
# Twice the logarithm of the odds, 7 to 1, by which some faults (a scale of positions, an actuator
# that fails) are rarer than their rivals; halved and doubled it is 3 and 55 to 1.
RARER = 4.0


@dataclass(frozen=True)
class Candidate:
    """A fault that a log may have: with a size, or another reading of the same numbers.

    Parameters
    ----------
    kind : str
        A key of :data:`SHAPES`, or of a reading (sign, unit, swap, frame, offset, misalignment).
    signals : tuple of str
        Signals that it acts on.
    unit : str
        Of the size.
    plausible, material : float
        Usual size, and the least that matters.
    other : tuple of str
        The rate, for a lever arm.
    record : str
        The only record that it acts in; empty for all of them.
    span : tuple of float
        Shares of the record at which a step or burst begins, and a burst ends.
    rare : float
        Twice the logarithm of the odds by which it is rarer than its rivals.
    positive : bool
        Whether it cannot be less than nothing: no lag is.
    meaning : str
        The other unit or the quarter of a turn of another reading, in words.
    """

    kind: str
    signals: tuple[str, ...]
    unit: str = "1"
    plausible: float = 1.0
    material: float = 0.0
    other: tuple[str, ...] = ()
    record: str = ""
    span: tuple[float, float] = (0.0, 1.0)
    rare: float = 0.0
    positive: bool = False
    meaning: str = ""

    @property
    def placed(self) -> bool:
        """Whether it begins within a record."""
        return self.span[0] > 0.0

    @property
    def largest(self) -> float:
        """Size beyond which none is so by chance; what is mounted wrong may be so by any angle."""
        return math.inf if self.kind == "misalignment" else LARGEST * self.plausible

    def correction(self, size: float) -> Correction:
        """How to undo a size of it."""
        return Correction(
            self.kind, self.signals, size, self.other, record=self.record, span=self.span
        )


class Motion:
    """Smooth signals of one record and their rates, from which signatures are made.

    A signal that an equation predicts is its prediction plus the straight line through what that
    leaves (more of it would be noise of the contrast that a signature could then explain); its
    rate is the right side of the equation.
    """

    def __init__(self, trace: Trace, relations: tuple[Relation, ...]) -> None:
        names = [*names_of(relations), *(logged(n) for r in relations for n in r.driven)]
        self.trace, self.elapsed = trace, trace.times - trace.times[0]
        self.raw = trace.filled(n for n in names if n in trace.values)
        self.known = {i: r for i, r in enumerate(relations) if self.raw.keys() >= {*r.names}}
        self.right = {
            i: r({n: self.raw[n] for n in r.signals}, trace.times) for i, r in self.known.items()
        }

    @cached_property
    def rates(self) -> dict[str, np.ndarray]:
        """Rates of signals, ``(n_times,)`` each."""
        told = {r.target: self.right[i] for i, r in self.known.items() if r.is_rate}
        untold = self.raw.keys() - told.keys()
        return told | {n: np.gradient(hann(self.raw[n], 9), self.trace.times) for n in untold}

    @cached_property
    def sides(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Rates of measured states and outputs about each sample, by the nominal model if any."""
        model = next((r.model for r in self.known.values() if r.model is not None), None)
        if model is None:
            return {}, {}
        trace, shown = self.trace, {o.name for o in model.outputs}
        values = self.raw | trace.filled(shown & trace.values.keys() - self.raw.keys())
        return nominal_sides(model, trace.times, values, trace.inputs)

    @cached_property
    def values(self) -> dict[str, np.ndarray]:
        """Signals, ``(n_times,)`` each."""
        times, values = self.trace.times, dict(self.raw)
        # Signals that others are read from come after these, predicted from what these predict.
        for i, one in sorted(self.known.items(), key=lambda known: not known[1].is_rate):
            if one.is_rate:
                predicted = one.integral(times, self.right[i][:, None])[:, 0]
            else:
                predicted = one({n: values[n] for n in one.signals}, times)
            line = np.polyfit(self.elapsed, self.raw[one.target] - predicted, 1)
            values[one.target] = predicted + np.polyval(line, self.elapsed)
        return values

    def has(self, one: Candidate) -> bool:
        """Whether a fault may be in this record."""
        here = one.record in ("", self.trace.name)
        return here and {*one.signals, *one.other} <= self.raw.keys()


def hann(series: np.ndarray, width: int) -> np.ndarray:
    """Series smoothed by a window of Hann."""
    width = max(3, min(width, series.size // 2))
    window = np.hanning(width + 2)[1:-1]
    padded = np.pad(series, (width // 2, width - 1 - width // 2), "reflect", reflect_type="odd")
    return np.convolve(padded, window / window.sum(), mode="valid")


def _added(one: Candidate, m: Motion) -> dict[str, np.ndarray]:
    return {n: ADDED[one.kind](one, m.values, m.elapsed) for n in one.signals}


def _turned(one: Candidate, m: Motion) -> dict[str, np.ndarray]:
    first, second = one.signals
    return {first: -m.values[second], second: m.values[first]}


def _scaled(one: Candidate, m: Motion) -> dict[str, np.ndarray]:
    trace = m.trace
    return {n: m.values[n] - pivot(trace.values[n], trace.units[n]) for n in one.signals}


def _lagging(one: Candidate, m: Motion) -> dict[str, np.ndarray]:
    # A secant: from the command on, a lag of no time is a delay, and far from one of a usual time.
    usual, times = 0.5 * one.plausible, m.trace.times
    return {n: (m.values[n] - lagged(times, m.values[n], usual)) / usual for n in one.signals}


# What a unit of each fault adds to the logged signals of a record.
SHAPES = dict.fromkeys(ADDED, _added) | {
    "scale": _scaled,
    "delay": lambda one, m: {n: -m.rates[n] for n in one.signals},
    "rate": lambda one, m: {n: -m.elapsed * m.rates[n] for n in one.signals},
    "misalignment": _turned,
    "lag": _lagging,
}


# -- candidates ------------------------------------------------------------------------------


def _displacements(relations: Sequence[Relation], units: Mapping[str, str]) -> list[Relation]:
    """Equations of positions: their rates are velocities along fixed axes."""
    return [r for r in relations if r.is_rate and units[r.target] == "m"]


def positions_of(relations: Sequence[Relation], units: Mapping[str, str]) -> tuple[str, ...]:
    """Signals whose rates are velocities along fixed axes."""
    return tuple(r.target for r in _displacements(relations, units))


def velocities_of(relations: Sequence[Relation], units: Mapping[str, str]) -> tuple[str, ...]:
    """Velocities that positions are the integrals of, in the order u, v, w."""
    order = ("u", "v", "w")
    found = [n for n in names_of(_displacements(relations, units)) if units[n] == "m/s"]
    return tuple(sorted(found, key=lambda n: order.index(n) if n in order else len(order)))


@dataclass(frozen=True)
class Question:
    """What is asked of signals.

    Parameters
    ----------
    relations : tuple of Relation
        The equations between them.
    common, single : tuple of Candidate
        Faults with a size, of all records and of single ones.
    local : tuple of Candidate
        What may begin at any place of a record: steps (and bursts) of signals, inputs that have
        lost their effect, forces that set in.
    readings : tuple of Found
        Other readings of the same numbers.
    given : tuple of Candidate
        Errors that are in every regression, of a size that is known before.
    known : tuple of Correction
        Steps that the signals show without any equation, which give them their sizes.
    """

    relations: tuple[Relation, ...]
    common: tuple[Candidate, ...]
    single: tuple[Candidate, ...] = ()
    local: tuple[Candidate, ...] = ()
    readings: tuple[Found, ...] = ()
    given: tuple[Candidate, ...] = ()
    known: tuple[Correction, ...] = ()

    @classmethod
    def of(
        cls,
        traces: Sequence[Trace],
        relations: tuple[Relation, ...],
        known: Iterable[Correction] = (),
    ) -> Question:
        """Everything that may be wrong with signals that equations relate."""
        facts = Facts(traces, relations)
        drifts = tuple(facts.drifts())
        # One position alone drifts as a misaligned velocity does.
        plain = [d for d in drifts if {*d.signals} - facts.integrated or len(facts.positions) > 1]
        common = (*facts.sensors(), *facts.clocks(), *facts.places(), *plain)
        apart = [c for c in (*common, *drifts) if c.kind in ("bias", "scale", "drift")]
        several = traces if 1 < len(traces) <= PLACES else ()
        pairs = ((t, c) for t, c in product(several, apart) if {*c.signals} <= t.values.keys())
        single = dict.fromkeys(replace(c, record=t.name) for t, c in pairs)
        local, read = map(facts.step_of, facts.size), readings(traces, relations)
        return cls(
            relations, common, tuple(single), tuple(local), tuple(read), known=tuple(known)
        )  # fmt: skip


class Facts:
    """What usual sizes follow from: units, sizes and noise of signals, and who integrates whom."""

    def __init__(self, traces: Sequence[Trace], relations: tuple[Relation, ...]) -> None:
        inner = {n for r in relations for n in r.signals}
        self.units = units_of(traces)
        self.size = {n: _rms(traces, n) for n in names_of(relations)}
        self.noise = {
            n: float(np.median([t.noise[n] for t in traces if n in t.noise])) for n in self.size
        }
        self.step = float(np.median([t.step for t in traces]))
        self.length = max(float(t.times[-1] - t.times[0]) for t in traces)
        self.integrated = {r.target for r in relations if r.is_rate} - inner
        self.positions = positions_of(relations, self.units)
        self.velocities = velocities_of(relations, self.units)

    def least(self, name: str) -> float:
        """Least constant error that matters."""
        return max(MATERIAL * self.noise[name], 1e-3 * self.size[name])

    def sensors(self) -> Iterator[Candidate]:
        """Constant and relative errors."""
        for n, size in self.size.items():
            if n not in self.integrated:
                yield Candidate("bias", (n,), self.units[n], 0.3 * size, self.least(n))
        for n in self.size:
            # Positions and depths are told by satellites and pressure: rarely of wrong scale.
            rare = RARER * (n in self.integrated)
            yield Candidate("scale", (n,), "1", 0.25, NEGLIGIBLE, rare=rare)

    def clocks(self) -> Iterator[Candidate]:
        """Delays and rates of clocks of each signal, of all positions and of all velocities."""
        together = (g for g in (self.positions, self.velocities) if len(g) > 1)
        for group in (*((n,) for n in self.size), *together):
            yield Candidate("delay", group, "s", max(0.7, 3.0 * self.step), MATERIAL * self.step)
            yield Candidate("rate", group, "1", 0.05, MATERIAL * self.step / self.length)

    def places(self) -> Iterator[Candidate]:
        """Lever arms and misalignments of velocities."""
        rates = [n for n in self.size if self.units[n] == "rad/s"]
        for name, rate in product(self.velocities, rates):
            if (name, rate) not in (("u", "p"), ("v", "q"), ("w", "r")):
                arm = 0.5 * max(self.size[v] for v in self.velocities) / self.size[rate]
                yield Candidate("lever", (name,), "m", arm, min(0.05, 0.02 * arm), (rate,))
        for pair in combinations(self.velocities, 2):
            yield Candidate("misalignment", pair, "rad", 0.1, 0.4 * NEGLIGIBLE)

    def drifts(self) -> Iterator[Candidate]:
        """Errors that grow with time."""
        for n, size in self.size.items():
            unit = {"m/s": "m/s^2", "rad/s": "rad/s^2"}.get(self.units[n], f"{self.units[n]}/s")
            least = 2.0 * self.least(n) / self.length
            yield Candidate("drift", (n,), unit, size / self.length, least)

    def step_of(self, name: str) -> Candidate:
        """A lasting jump of a signal."""
        least = 2.0 * self.noise[name] + 1e-3 * self.size[name]
        return Candidate("step", (name,), self.units[name], self.size[name], least)


def _rms(traces: Sequence[Trace], name: str) -> float:
    """Root mean square of the samples of a signal."""
    whole = np.concatenate([t.values[name] for t in traces if name in t.values])
    return float(np.sqrt(np.nanmean(whole**2))) + 1e-12


# -- contrasts -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Piece:
    """Cosine coefficients of one equation over one uninterrupted piece of a record.

    ``side`` is the equation in the record, ``times`` are those of the blocks, ``residual`` and
    ``target`` ``(n,)``, ``sampled`` ``(n, 2)`` is what is not known of the integral between
    samples, by what the nominal model leaves and by what it may lack
    (:meth:`~oed_sysid.evidence.relations.Relation.sampled`), ``columns`` ``(n, n_used)`` are those
    of the candidates ``used``, those in the record before those at its places; a block has
    ``group`` samples and length ``span`` in s; ``walk`` is the variance per block that the fast
    noise of the rates produces, ``level`` the deviation of the left side's, ``shares`` the part of
    each signal in ``walk``.
    """

    side: Side
    times: np.ndarray
    residual: np.ndarray
    target: np.ndarray
    sampled: np.ndarray
    columns: np.ndarray
    used: np.ndarray
    span: float
    group: int
    walk: float
    level: float
    shares: Mapping[str, float]

    @property
    def angle(self) -> np.ndarray:
        """Frequency of each coefficient, rad a block."""
        return np.pi * np.arange(1, self.times.size) / self.times.size

    @property
    def weight(self) -> np.ndarray:
        """Power of changes over about a second, of each coefficient's square."""
        return 2.0 - 2.0 * np.cos(max(1, round(1.0 / self.span)) * self.angle)

    @property
    def changes(self) -> tuple[float, float]:
        """Power of the changes over about a second of the contrast, and of the left side."""
        return float(self.weight @ self.residual**2), float(self.weight @ self.target**2)

    @property
    def series(self) -> np.ndarray:
        """The contrast about its mean, ``(n_blocks,)``."""
        return np.asarray(idct(np.append(0.0, self.residual), norm="ortho"))

    def columns_of(self, chosen: np.ndarray) -> np.ndarray:
        """Columns of some candidates, ``(n, n_chosen)``; zero where one says nothing here."""
        result = np.zeros((self.residual.size, chosen.size))
        into, here = np.nonzero(chosen[:, None] == self.used)
        result[:, into] = self.columns[:, here]
        return result


@dataclass(frozen=True)
class Anywhere:
    """A fault of one signal that may begin at any of :data:`PLACED`, in one equation of a record.

    ``first`` is the candidate at the first place; ``begins`` and ``ends`` are the times of all of
    them, s. A unit of it adds ``level`` to the left side while it lasts, and what ``left`` less the
    integral of ``inside``, ``(n_times,)`` each, has grown by since it began.
    """

    first: int
    begins: np.ndarray
    ends: np.ndarray
    level: float
    left: np.ndarray
    inside: np.ndarray

    def columns(self, times: np.ndarray, grown: np.ndarray, *, rated: bool) -> np.ndarray:
        """Its contrasts at the times of blocks, ``(n_blocks, n_places)``; ``grown`` of each."""
        n, begun = times.size, np.searchsorted(times, self.begins)

        def lasting(row: np.ndarray) -> np.ndarray:
            before = grown[np.minimum(row, n - 1)] if rated else 0.0
            since = np.arange(n)[:, None] >= row
            return np.where(since, self.level + grown[:, None] - before, 0.0)

        return lasting(begun) - lasting(np.maximum(np.searchsorted(times, self.ends), begun + 1))


def contrasts(
    trace: Trace,
    relations: tuple[Relation, ...],
    faults: Sequence[Candidate] = (),
    factors: Mapping[str, float] | None = None,
    places: Sequence[Candidate] = (),
) -> Iterator[Piece]:
    """Contrasts of all equations in one record, and the column of each candidate.

    ``factors`` are the scales that were undone, by signal: a contrast is taken in the unit that
    its left side was logged in, or shrinking a signal would shrink its noise. ``places`` are
    candidates that may begin anywhere, each at all of :data:`PLACED`. Of fewer than
    :data:`~oed_sysid.evidence.traces.LEAST` samples there are none.
    """
    if trace.times.size < LEAST:
        return
    factors = factors or {}
    motion = Motion(trace, relations)
    every = {k: SHAPES[f.kind](f, motion) for k, f in enumerate(faults) if motion.has(f)}
    for index, relation in motion.known.items():
        shapes = {k: shape for k, shape in every.items() if shape.keys() & {*relation.names}}
        side = Side(motion, index, set().union(*shapes.values()))
        begun = [*side.anywhere(len(faults), places)]
        pairs = [*side.pairs(shapes.values()), *((one.left, one.inside) for one in begun)]
        left, inside = (np.column_stack(one) for one in zip(*pairs, strict=True))
        factor = factors.get(relation.target, 1.0)
        yield from side.pieces(left, inside, [*shapes], begun, factor)


class Side:
    """One equation in one record.

    ``inner`` are the signals of its right side, ``slopes`` the derivatives of that by those that a
    fault touches, that have noise or move, ``(n_times,)`` each.
    """

    def __init__(self, motion: Motion, index: int, touched: set[str]) -> None:
        self.motion, self.index, self.relation = motion, index, motion.known[index]
        trace, self.inner = motion.trace, {n: motion.raw[n] for n in self.relation.signals}
        self.record = trace.name
        asked, moving = touched & {*(self.relation.asked or self.inner)}, motion.sides[0]
        names = (n for n in self.inner if n in asked or trace.noise[n] > 0.0 or n in moving)
        self.slopes = {n: self.relation.slope(self.inner, trace.times, n) for n in names}

    def pairs(
        self, shapes: Iterable[Mapping[str, np.ndarray]]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Residual, left side, sampling and candidates: each a left side less an integral."""
        motion, relation, times = self.motion, self.relation, self.motion.trace.times
        target, right = motion.trace.values[relation.target], motion.right[self.index]
        # By the chain rule, of what the nominal model says just before and just after each sample.
        known, (before, after) = (
            sum(
                (self.slopes[n] * one[n] for n in self.slopes if n in one),
                np.zeros((2, times.size)),
            )
            for one in motion.sides
        )
        # What motion between samples changes of an integral, and what is not known of it.
        sampled = relation.sampled(times, right, known, after - before) * relation.is_rate
        zero = np.zeros(times.size)
        yield target - sampled[0], right
        yield from ((one, zero) for one in (target, *sampled[1:]))
        for shape in shapes:
            own = {n: shape[n] for n in self.slopes.keys() & shape.keys()}
            yield shape.get(relation.target, zero), relation.along(self.inner, times, own)

    def anywhere(self, number: int, places: Sequence[Candidate]) -> Iterator[Anywhere]:
        """What may begin at any place of the record and shows here; candidates from a number on."""
        motion, times, zero = self.motion, self.motion.trace.times, 0.0 * self.motion.elapsed
        begins = times[0] + PLACED * motion.elapsed[-1]
        for k in range(0, len(places), PLACED.size):
            one, (name,), first = places[k], places[k].signals, number + k
            if one.record != motion.trace.name:
                continue
            lasts = motion.elapsed[-1] / PLACES if one.kind == "burst" else np.inf
            level = float(one.kind in ("step", "burst") and name == self.relation.target)
            if one.kind == "drift" and name == self.relation.target:
                yield Anywhere(first, begins, begins + lasts, level, motion.elapsed, zero)
            elif one.kind != "drift" and (level or name in self.slopes):
                own = motion.raw.get(logged(name), motion.raw[name]) if one.kind == "lost" else 1.0
                inside = own * self.slopes.get(name, zero)
                yield Anywhere(first, begins, begins + lasts, level, zero, inside)

    def pieces(
        self,
        left: np.ndarray,
        inside: np.ndarray,
        shaped: Sequence[int],
        begun: Sequence[Anywhere],
        factor: float,
    ) -> Iterator[Piece]:
        """Contrasts over each uninterrupted piece, as cosine coefficients of block means."""
        relation, rated, trace = self.relation, self.relation.is_rate, self.motion.trace
        power = {name: trace.noise[name] ** 2 * _spacing(trace, name) for name in self.slopes}
        used = np.array([*shaped, *(o.first + k for o in begun for k in range(PLACED.size))], int)
        for piece in trace.pieces(trace.usable(relation.signals), LEAST):
            times = trace.times[piece]
            rows = np.flatnonzero(np.isfinite(left[piece, 0]))
            # Means of blocks: what is fast tells no constant error, and long records stay cheap.
            group = max(1, -(-rows.size // MOST_BLOCKS))
            n = rows.size // group
            if n < LEAST:
                continue
            rows = rows[: n * group]
            sums = relation.integral(times, inside[piece]) if rated else inside[piece]
            # Left side less integral of the right: zero but for noise, and for what is wrong.
            whole = (left[piece] - sums)[rows]
            means = factor * whole.reshape(n, group, -1).mean(axis=1)
            middle = times[rows].reshape(n, group).mean(axis=1)
            grown = zip(begun, means[:, 4 + len(shaped) :].T, strict=True)
            placed = [one.columns(middle, series, rated=rated) for one, series in grown]
            # The constant is left out: an integral is known up to where it began.
            waves = dct(np.hstack([means[:, : 4 + len(shaped)], *placed]), axis=0, norm="ortho")[1:]
            if not waves[:, :2].any():  # a constant says nothing
                continue
            span = float(times[-1] - times[0]) / n
            walks = {k: float(np.mean(self.slopes[k][piece] ** 2)) * p for k, p in power.items()}
            total = sum(walks.values())
            shares = {name: walk / total if total else 0.0 for name, walk in walks.items()}
            yield Piece(
                self, middle, residual=waves[:, 0], target=waves[:, 1], sampled=waves[:, 2:4],
                columns=waves[:, 4:], used=used, span=span, group=group,
                walk=factor**2 * total * (span if rated else 0.0),
                level=factor * trace.noise[relation.target] / np.sqrt(group),
                shares={**shares, relation.target: -1.0},
            )  # fmt: skip


def _spacing(trace: Trace, name: str) -> float:
    """Median time between samples of a signal, s."""
    present = trace.times[np.isfinite(trace.values[name])]
    return float(np.median(np.diff(present)))


# -- noise -----------------------------------------------------------------------------------


def laws(angle: np.ndarray, *, forced: bool = False) -> np.ndarray:
    """Variances of unit noise of each kind at some frequencies, ``(n_kinds, n)``.

    Forces in bands are noise where an equation is ``forced``; from others all motion falls out.
    """
    cosine = np.cos(angle)
    still = [(1.0 - r) ** 2 / (1.0 - 2.0 * r * cosine + r * r) for r in CORRELATIONS]
    power = 2.0 - 2.0 * cosine
    centres = 0.5 * np.pi * np.exp(-BAND * np.arange(BANDS))
    x = power / (2.0 - 2.0 * np.cos(centres))[:, None]
    seas = BAND**2 * x / ((1.0 - x) ** 2 + BAND**2 * x)
    return np.array([*still, *(one / power for one in (*still, *(seas if forced else ())))])


def fitted_law(
    power: np.ndarray,
    basis: np.ndarray,
    floor: np.ndarray,
    left: np.ndarray | float = 1.0,
    begun: np.ndarray | None = None,
    turns: int = SWEEPS**2,
) -> np.ndarray:
    r"""Shares of each kind of noise of largest likelihood, ``(n_kinds,)``.

    Multiplicative steps on :math:`\sum_k \ln S_k + P_k/S_k` (Févotte & Idier 2011).

    Parameters
    ----------
    power : numpy.ndarray
        Squared coefficients, ``(n,)``.
    basis : numpy.ndarray
        Of :func:`laws`.
    floor : numpy.ndarray
        Least share of each kind.
    left : numpy.ndarray or float
        Share of each coefficient that the regression has left, ``(n,)``.
    begun : numpy.ndarray, optional
        Shares to begin from.
    turns : int
        Steps.
    """
    if begun is None:
        begun = (float(np.mean(power / left)) + 1e-300) / basis.mean(axis=1) / len(basis)
    shares = np.maximum(begun, floor)
    for _ in range(turns):
        variance = shares @ basis
        ratio = (basis @ (power / variance**2)) / (basis @ (left / variance))
        shares = np.maximum(shares * ratio, floor)
    return np.asarray(shares)


# -- regression ------------------------------------------------------------------------------


def assemble(
    pieces: Sequence[Piece],
    faults: Sequence[Candidate],
    places: Sequence[Candidate],
    inside: np.ndarray,
) -> tuple[System, System]:
    """Whiten all contrasts and sum their normal equations.

    ``inside`` are the candidates that are in the regression while the noise is estimated.

    Returns
    -------
    whole, wide : System
        Of ``faults``; and of those inside, with ``places``, which have columns only.
    """
    every, n = [*faults, *places], len(faults)
    gram, across = np.zeros((n, n)), np.zeros((inside.size, len(places)))
    own, right, doubt, relative = np.zeros((4, len(every)))
    for index in sorted({piece.side.index for piece in pieces}):
        mine = [piece for piece in pieces if piece.side.index == index]
        noise = Noise(mine, faults, inside)
        shares, law = noise.shares, noise.law
        part = shares * law.mean(axis=1)
        active = part > NEGLIGIBLE * part.sum()
        # Information on variances of normal coefficients: half the squared relative change of
        # each.
        fisher = np.linalg.pinv(0.5 * (law[active] / noise.variance**2) @ law[active].T)
        edges = np.cumsum([piece.residual.size for piece in mine])[:-1]
        levels, laws_of = np.split(noise.variance, edges), np.split(law, edges, axis=1)
        for piece, level, here in zip(mine, levels, laws_of, strict=True):
            used, white = piece.used, piece.columns / np.sqrt(level)[:, None]
            power, plain = np.sum(white**2, axis=0), used < n
            gram[np.ix_(used[plain], used[plain])] += white[:, plain].T @ white[:, plain]
            beside = piece.columns_of(inside) / np.sqrt(level)[:, None]
            across[:, used[~plain] - n] += beside.T @ white[:, ~plain]
            own[used] += power
            right[used] += white.T @ (piece.residual / np.sqrt(level))
            # Relative error of the information of each candidate, by the errors of the shares.
            slope = -(here[active] / level) @ white**2
            relative[used] += np.sum(slope * (fisher @ slope), axis=0)
            # Noise of the right side is integrated where the left side is a rate.
            first = len(CORRELATIONS) if piece.side.relation.is_rate else 0
            part = (shares[first:] @ here[first:]) / level
            noisy = 0.5 * _attenuation(piece, every, float(part.sum()), power)
            left, lacking = (piece.sampled / np.sqrt(level)[:, None]).T @ white
            right[used] -= noisy
            doubt[used] += np.abs(noisy) + np.abs(left) + np.abs(lacking)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = 2.0 * own**2 / relative
    freedom = np.clip(np.nan_to_num(freedom, nan=3.0, posinf=1e6), 3.0, 1e6)
    # Noise levels are estimates themselves: Student's distribution, shared among all that is
    # asked.
    limits = stdtrit(freedom, 1.0 - 0.5 * FALSE_CLAIMS / len(every)) ** 2
    # Noise of the rates enters by slopes that vary: at one place it may be that much louder.
    limits = limits * np.where([f.placed for f in every], VARYING, 1.0)
    wide = np.append(inside, np.arange(n, len(every)))
    block = np.hstack([gram[np.ix_(inside, inside)], across])
    return (
        System(faults, gram, own[:n], right[:n], limits[:n], doubt[:n]),
        System([every[k] for k in wide], block, own[wide], right[wide], limits[wide], doubt[wide]),
    )


class Noise:
    """Noise of one equation, estimated with some faults in the regression, and what is left of it.

    ``law`` are the variances of unit noise of each kind, ``(n_kinds, n)``, ``shares`` the estimated
    sizes of these and ``floor`` the least ones, ``variance`` that of every coefficient by these,
    ``target`` the coefficients of the left side,
    ``distance`` what is left, whitened and squared, and the price of the faults in it, and ``away``
    how many usual sizes the farthest constant error is from nothing.
    """

    def __init__(
        self, mine: Sequence[Piece], faults: Sequence[Candidate], nuisance: np.ndarray
    ) -> None:
        self.law = law = _joint_law(mine)
        y = np.concatenate([p.residual for p in mine])
        self.target = np.concatenate([p.target for p in mine])
        used = np.intersect1d(nuisance, np.concatenate([p.used for p in mine]))
        matrix = np.concatenate([p.columns_of(used) for p in mine])
        matrix *= np.array([faults[k].plausible for k in used])
        self.floor = floor = np.zeros(len(law))
        level, least = np.mean([p.level for p in mine]), 3e-5 * float(np.std(self.target))
        floor[0] = max(0.5 * float(level), least) ** 2
        floor[len(CORRELATIONS)] = 0.7 * float(np.mean([p.walk for p in mine]))
        # From the least noise there can be: under much noise the faults would be taken for it.
        variance, shares = floor @ law, None
        turns = 4 if used.size else 1  # what is left depends on the noise by the faults alone
        for _ in range(turns):
            white = matrix / np.sqrt(variance)[:, None]
            # Faults in units of their usual size, with a prior of one.
            inner = np.linalg.inv(white.T @ white + np.eye(used.size))
            hat = np.einsum("ij,ij->i", white @ inner, white)
            size = inner @ (white.T @ (y / np.sqrt(variance)))
            rest = y - matrix @ size
            left = np.clip(1.0 - hat, 0.05, 1.0)
            shares = fitted_law(rest**2, law, floor, left, shares, SWEEPS**2 // turns)
            variance = shares @ law
        self.shares, self.variance = np.asarray(shares), variance
        self.distance = float(np.sum(rest**2 / variance) + size @ size)
        constant = np.array([faults[k].kind == "bias" for k in used], bool)
        self.away = float(np.abs(size[constant]).max(initial=0.0))

    @property
    def told(self) -> float:
        """Information that the equation gives about its left side."""
        alone = fitted_law(self.target**2, self.law, self.floor) @ self.law
        return float(np.sum(np.log(alone / self.variance) + 1.0) - self.distance)


def _joint_law(mine: Sequence[Piece]) -> np.ndarray:
    """Variances of unit noise of each kind in pieces of one equation, ``(n_kinds, n)``.

    Means over fewer samples hold more of the white noise, longer blocks more of the integrated.
    """
    forced = bool(mine[0].side.relation.driven)
    law = np.concatenate([laws(p.angle, forced=forced) for p in mine], axis=1)
    sizes = [p.residual.size for p in mine]
    fewer, longer = np.array([(1.0 / p.group, p.span) for p in mine]).T
    law[0] *= np.repeat(fewer / fewer.mean(), sizes)
    law[len(CORRELATIONS) :] *= np.repeat(longer / longer.mean(), sizes)
    return law


def _attenuation(
    piece: Piece, faults: Sequence[Candidate], noise: float, own: np.ndarray
) -> np.ndarray:
    """Most that noise in the regressors of scales may have added to scores, ``(n_used,)``.

    The noise of a signal stands in the contrast and in its own regressor, which biases a scale by
    the ratio of noise to signal (errors in variables; Fuller 1987): between nothing and what it
    would be if all noise of the right side came from that signal, or if the signal, at rest, were
    nothing but noise. Half of it is subtracted.
    """
    used = (faults[k] for k in piece.used)
    scaled = [one.signals[0] if one.kind == "scale" else "" for one in used]
    most = noise * np.array([piece.shares.get(name, 0.0) for name in scaled])
    return np.clip(most, -own, own)


@dataclass(frozen=True)
class System:
    """Normal equations of all candidates, whitened: what each gains beside others.

    ``gram`` is ``(n_rows, n)``, without rows of what begins anywhere (the last of the candidates,
    which are chosen once they are picked for the next linearisation), ``own`` its diagonal
    ``(n,)``, ``right`` ``(n,)``, ``limits`` what each needs, ``doubt`` the half-width of what noise
    in a regressor and motion between samples may have added to ``right``.
    """

    faults: Sequence[Candidate]
    gram: np.ndarray
    own: np.ndarray
    right: np.ndarray
    limits: np.ndarray
    doubt: np.ndarray

    @classmethod
    def plain(cls, faults: Sequence[Candidate], gram: np.ndarray, right: np.ndarray) -> System:
        """Equations whose noise is known: limits are those of a normal score."""
        n = len(faults)
        limits = np.full(n, stdtrit(1e6, 1.0 - 0.5 * FALSE_CLAIMS / n) ** 2)
        return cls(faults, gram, gram.diagonal(), right, limits, np.zeros(n))

    def found(self, chosen: Sequence[int] | None = None) -> tuple[Found, ...]:
        """Accepted faults with errors, statistics and rivals, the strongest first."""
        chosen = self.chosen(()) if chosen is None else chosen
        size, std, own = self.sizes(chosen)
        result = []
        for i, k in enumerate(chosen):
            gain, other, error = self.beside([j for j in chosen if j != k])
            # What cannot be told by these records is a rival, however seldom it is so large.
            usual = self.of("plausible")
            short = own[i] + (size[i] / usual[k]) ** 2 - gain - (other / usual) ** 2
            near = self.able(chosen, other, error) & (short < CLOSE)
            told: dict[tuple[object, ...], Found] = {}
            for j in sorted(np.flatnonzero(near).tolist(), key=lambda j: -gain[j]):
                f = self.faults[j]
                rival = Found(f, float(other[j]), float(error[j]), float(gain[j]))
                told.setdefault((f.kind, f.signals, f.other, f.record), rival)
            mine = self.faults[k]
            told.pop((mine.kind, mine.signals, mine.other, mine.record), None)
            rivals = tuple(told.values())[:MOST_FAULTS]
            result.append(Found(mine, float(size[i]), WIDER * float(std[i]), float(own[i]), rivals))
        return tuple(sorted(result, key=lambda one: -one.gain))

    def given(self, n: int) -> System:
        """The same with the first ``n`` candidates in every regression, and asked no more."""
        if not n:
            return self
        across = self._inverse(range(n)) @ self.gram[:n]
        gram = self.gram - self.gram[:, :n] @ across
        own = self.own - np.sum(self.gram[:n] * across, axis=0)
        right = self.right - across.T @ self.right[:n]
        gram[:n], gram[:, :n], own[:n], right[:n] = 0.0, 0.0, 0.0, 0.0
        return replace(self, gram=gram, own=own, right=right)

    def strained(self, now: Sequence[int]) -> bool:
        """Whether a fault that matters is so far beyond its limit that linear scores mislead."""
        gain, size, _ = self.beside(now)
        far = (gain > LOUDER * self.limits) & (self._own(size) > self.of("material"))
        return bool(np.any(far))

    def of(self, what: str) -> np.ndarray:
        """A number of every candidate."""
        return self._numbers[what]

    @cached_property
    def _numbers(self) -> dict[str, np.ndarray]:
        """Numbers of all candidates, ``(n,)`` each."""
        names = ("plausible", "largest", "material", "rare", "positive")
        return {name: np.array([getattr(one, name) for one in self.faults]) for name in names}

    def _inverse(self, chosen: Sequence[int]) -> np.ndarray:
        """Covariance of the sizes of some; a usual size is what is known of each before."""
        a = list(chosen)
        return np.linalg.inv(self.gram[np.ix_(a, a)] + np.diag(self.of("plausible")[a] ** -2.0))

    def beside(self, chosen: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Statistic, size and standard deviation of every candidate beside some, ``(n,)`` each."""
        a, own = list(chosen), self.own
        across = self._inverse(a) @ self.gram[a]
        left = own - np.einsum("ij,ij->j", self.gram[a], across)
        score = self.right - across.T @ self.right[a]
        told = (left > NEGLIGIBLE * own) & (own > 0.0)
        left = np.where(told, left + self.of("plausible") ** -2.0, np.inf)
        return score**2 / left, score / left, left**-0.5

    def able(self, chosen: Sequence[int], size: np.ndarray, std: np.ndarray) -> np.ndarray:
        """Which candidates are of a size that matters and that such faults have."""
        own = self._own(size)
        result = (own >= self.least(std)) & (own <= self.of("largest"))
        result[list(chosen)] = False
        return result

    def _own(self, size: np.ndarray, chosen: Sequence[int] | slice = slice(None)) -> np.ndarray:
        """Sizes of candidates without their signs, where these may be either."""
        return np.where(self.of("positive")[chosen], size, np.abs(size))

    def sizes(self, chosen: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Size, covariance diagonal and own statistic of each chosen candidate."""
        a, inverse = list(chosen), self._inverse(chosen)
        size = inverse @ self.right[a]
        # A doubt is uniform, with the variance of a third of its half-width squared.
        unsure = ((inverse * self.doubt[a]) ** 2).sum(axis=1) / 3.0
        return size, np.sqrt(inverse.diagonal() + unsure), size**2 / inverse.diagonal()

    def sized(self, chosen: Sequence[int]) -> dict[Candidate, float]:
        """Sizes of some, by candidate."""
        sizes = zip(chosen, self.sizes(chosen)[0], strict=True)
        return {self.faults[k]: float(size) for k, size in sizes}

    def settled(self, before: Mapping[Candidate, float], chosen: Sequence[int]) -> bool:
        """Whether the faults chosen are those before, and sizes within a tenth of their errors."""
        now, std = self.sized(chosen), self.sizes(chosen)[1]
        moved = np.array([abs(size - before.get(fault, np.inf)) for fault, size in now.items()])
        return before.keys() == now.keys() and bool(np.all(moved < 0.1 * std + 1e-9))

    def visible(self, chosen: Sequence[int]) -> list[tuple[Candidate, float]]:
        """Every candidate with the least size that would be seen beside some."""
        error = self.beside(chosen)[2]
        told = np.sqrt(self.limits) * np.where(error > 0.0, error, np.inf)
        return [*zip(self.faults, np.maximum(told, self.least(error)).tolist(), strict=True)]

    def least(self, std: np.ndarray) -> np.ndarray:
        """Least sizes that matter, and that noise in a regressor or the sampling does not make."""
        return self.of("material") + 1.5 * std**2 * self.doubt

    def anywhere(self, chosen: Sequence[int]) -> list[tuple[Candidate, float]]:
        """What may begin at any place, with the size that would be seen at the median of them."""
        placed, step = self.visible(chosen)[len(self.gram) :], PLACED.size
        groups = (placed[k : k + step] for k in range(0, len(placed), step))
        return [(one[step // 2][0], float(np.median([size for _, size in one]))) for one in groups]

    def picked(self, chosen: Sequence[int]) -> list[Candidate]:
        """The likeliest places of what may begin anywhere, beside some; of each signal one."""
        gain, best = self.beside(chosen)[0], dict[tuple[str, tuple[str, ...], str], Candidate]()
        beyond = np.flatnonzero(gain > self.limits)
        for k in beyond[np.argsort(-gain[beyond])]:
            one = self.faults[k]
            if k >= len(self.gram):
                best.setdefault((one.kind, one.signals, one.record), one)
        return [*best.values()][:MOST_FAULTS]

    def price(self, chosen: Sequence[int]) -> np.ndarray:
        """What each has to gain beside a set that gains so much."""
        a = list(chosen)
        return np.maximum(self.limits, ABSORBED * float(self.sizes(a)[0] @ self.right[a]))

    def chosen(self, start: Sequence[int]) -> list[int]:
        """Forward selection with exchange and drop."""
        now = [k for k in start if self.own[k] > 0.0]
        seen: set[frozenset[int]] = set()
        while frozenset(now) not in seen:
            seen.add(frozenset(now))
            now = self._dropped(self._exchanged(self._added(now)))
        return now

    def _added(self, now: list[int]) -> list[int]:
        gain, size, std = self.beside(now)
        pays = self.able(now, size, std) & (gain > self.price(now))
        best = int(np.argmax(np.where(pays, gain - self.of("rare"), -np.inf)))
        return [*now, best] if pays[best] and len(now) < MOST_FAULTS else now

    def _exchanged(self, now: list[int]) -> list[int]:
        for k in tuple(now):
            rest = [j for j in now if j != k]
            gain, size, std = self.beside(rest)
            worth = gain - self.of("rare")
            better = np.where(self.able(rest, size, std), worth, -np.inf)
            best = int(np.argmax(better))
            if better[best] > worth[k] + 0.1 and self.faults[k].material > 0.0:
                now = [*rest, best]
        return now

    def _dropped(self, now: list[int]) -> list[int]:
        least, most = self.of("material"), 1.5 * LARGEST * self.of("plausible")
        while now:
            size, _, gain = self.sizes(now)
            short, own = gain - self.price(now)[now], self._own(size, now)
            small = (short < 0.0) | (own < least[now]) | (own > most[now])
            if not small.any():
                return now
            now = [k for k in now if k != now[int(np.argmin(np.where(small, short, np.inf)))]]
        return now


# -- search ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Found:
    """A fault, its size, error, statistic, and what it cannot be told from.

    Another reading of the numbers has no error; its size is the value that undoes it.
    """

    candidate: Candidate
    size: float = 1.0
    std: float = 0.0
    gain: float = 0.0
    rivals: tuple[Found, ...] = ()

    @property
    def correction(self) -> Correction:
        """How to undo it."""
        return self.candidate.correction(self.size)


@dataclass(frozen=True)
class Misfit:
    """What one equation leaves of its left side in a record, and the time of the most of it, s."""

    relation: int
    record: str
    share: float
    time: float


@dataclass(frozen=True)
class Result:
    """What a search ends with: faults, and all that were asked with the least visible size of each.

    Of what may begin at any place of a record that is the size at the median place. ``strained``
    where the signals were so far from agreeing that the linearised scores mislead, ``settled``
    where further linearisations would change nothing.
    """

    found: tuple[Found, ...]
    seen: Sequence[tuple[Candidate, float]]
    strained: bool = False
    settled: bool = True


def search(
    traces: Sequence[Trace],
    question: Question,
    *,
    start: Sequence[Found] = (),
    only_linear: bool = False,
) -> Result:
    """Find faults with a size; ``start`` are those of all records to begin from.

    With ``only_linear`` none is sought where the scores mislead, because readings come first there.
    """
    relations, n_given = question.relations, len(question.given)
    faults = [*question.given, *question.common, *question.single]
    places = [*_places(traces, question.local)]
    n_common = n_given + len(question.common)
    active = _begun(question, start)
    shift, strained, picked = 0.5 / PLACES, False, list[Candidate]()
    for turn in range(SWEEPS):
        near = [*_beside(active, shift)]
        faults = list(dict.fromkeys([*faults, *active, *near, *picked]))
        pieces = _linearised(traces, relations, faults, active, places)
        if not pieces:
            return Result((), [*dict.fromkeys(faults, np.inf).items()])
        now = [faults.index(fault) for fault in active]
        inside = np.union1d(np.arange(n_common), now).astype(int)
        whole, wide = assemble(pieces, faults, places, inside)
        system = whole.given(n_given)
        bench = replace(system, right=system.right + [*active.values()] @ system.gram[now])
        strained = strained if turn else bench.strained(now)
        if strained and only_linear:
            return Result((), bench.visible(now), strained)
        there = [*range(n_given), *np.searchsorted(inside, now).tolist()]
        picked = [fault for fault in wide.picked(there) if fault not in faults]
        chosen = bench.chosen(now)
        before, active = active, bench.sized(chosen)
        if not picked and (shift < 1e-3 or not near) and bench.settled(before, chosen):
            break
        shift *= 0.5 if near else 1.0
    else:
        # Beside errors that are given, sizes that go on changing are those of nothing.
        if n_given:
            return Result((), [*dict.fromkeys(faults, np.inf).items()], strained, settled=False)
    seen = [*bench.visible(chosen), *wide.anywhere(there)]
    return Result(bench.found(chosen), seen, strained)


def _places(traces: Sequence[Trace], local: Sequence[Candidate]) -> Iterator[Candidate]:
    """What may begin anywhere, at every place of every record; steps may also pass.

    One of many places is that much rarer than what holds for the whole record.
    """
    for trace, one in product(traces, local):
        for kind in ("step", "burst") if one.kind == "step" else (one.kind,):
            rare = one.rare + 2.0 * math.log(PLACES)
            here = replace(one, kind=kind, record=trace.name, rare=rare)
            for begin in PLACED.tolist():
                end = begin + 1.0 / PLACES if kind == "burst" else 1.0
                yield replace(here, span=(begin, end))


def _begun(question: Question, start: Sequence[Found]) -> dict[Candidate, float]:
    """Faults that a search begins with, and their sizes."""
    begun = {one.candidate: one.size for one in start}
    steps = {one.signals: one for one in question.local if one.kind == "step"}
    for one in question.known:
        here = replace(steps[one.signals], material=0.0, record=one.record, span=one.span)
        begun[here] = one.value
    return begun


def mended(
    traces: Iterable[Trace], found: Sequence[Found], relations: tuple[Relation, ...]
) -> list[Trace]:
    """Traces without what was found."""
    return [undo(trace, [one.correction for one in found], relations) for trace in traces]


def _linearised(
    traces: Sequence[Trace],
    relations: tuple[Relation, ...],
    faults: Sequence[Candidate],
    active: Mapping[Candidate, float],
    places: Sequence[Candidate],
) -> list[Piece]:
    """Contrasts of records with the active faults undone."""
    found = [Found(*one) for one in active.items()]
    scales = (f for f in active if f.kind == "scale" and not f.record)
    factors = {f.signals[0]: 1.0 + active[f] for f in scales}
    undone = mended(traces, found, relations)
    return [p for t in undone for p in contrasts(t, relations, faults, factors, places)]


def _beside(active: Iterable[Candidate], shift: float) -> Iterator[Candidate]:
    """What begins, or ends, a little earlier and later, where that is not known."""
    for one in active:
        if one.placed and one.material > 0.0:
            begin, end = one.span
            for by in (-shift, shift):
                yield replace(one, span=(begin + by, end))
                if one.kind == "burst":
                    yield replace(one, span=(begin, end + by))


def readings(traces: Sequence[Trace], relations: tuple[Relation, ...]) -> Iterator[Found]:
    """Signs, units, columns, axes and quarters of a heading that these signals may have wrong."""
    units, names = units_of(traces), names_of(relations)
    angles = [r.names for r in relations if r.is_rate and units[r.target] == "rad"]
    pairs = [pair for pair in angles if len(pair) == 2]
    yield from plain_readings([*((n,) for n in names), *pairs, *_of_one_unit(names, units)], units)
    yield from (Found(Candidate("swap", pair)) for pair in combinations(names, 2))
    yield from _axes(traces, relations, units)


def _of_one_unit(names: Sequence[str], units: Mapping[str, str]) -> Iterator[tuple[str, ...]]:
    """Signals of one unit, where there are several: what one instrument writes, it writes alike."""
    for unit in dict.fromkeys(units.values()):
        if len(some := tuple(name for name in names if units[name] == unit)) > 1:
            yield some


def _axes(
    traces: Sequence[Trace], relations: tuple[Relation, ...], units: dict[str, str]
) -> Iterator[Found]:
    """Velocities along the axes of the positions, and headings that count from elsewhere."""
    velocities, positions = velocities_of(relations, units), _displacements(relations, units)
    level = (level_axis(r, units, velocities) for r in positions)
    if any(level) and all(trace.values.keys() >= {*velocities} for trace in traces):
        yield Found(Candidate("frame", velocities))
    # A heading turns two positions; what other angles depend on counts from the vertical.
    pairs = combinations(positions, 2)
    headings = {n for a, b in pairs for n in {*a.signals} & {*b.signals} if units[n] == "rad"}
    headings -= {n for r in relations if units[r.target] == "rad" for n in r.signals}
    for angle, quarter in product(sorted(headings), (1, 2, 3)):
        turn = Candidate("offset", (angle,), meaning=f"{90 * quarter} deg")
        yield Found(turn, quarter * math.pi / 2.0)
    yield from _quarters(velocities, units)


def _quarters(velocities: Iterable[str], units: Mapping[str, str]) -> Iterator[Found]:
    """Pairs of velocities whose axes are turned by quarters of a turn in their plane."""
    for pair, quarter in product(combinations(velocities, 2), (1, 2, 3)):
        if units[pair[0]] == units[pair[1]] in ("m", "m/s", "rad/s"):
            turn = Candidate("misalignment", pair, meaning=f"{90 * quarter} deg", rare=RARER)
            yield Found(turn, quarter * math.pi / 2.0)


def plain_readings(groups: Iterable[tuple[str, ...]], units: Mapping[str, str]) -> Iterator[Found]:
    """The other sign and the other units of signals, alone or in groups of one quantity."""
    for group in groups:
        yield Found(Candidate("sign", group), -1.0)
        if len({units[n].partition("/")[0] for n in group}) == 1:
            for factor, meaning in READINGS.get(units[group[0]], ()):
                yield Found(Candidate("unit", group, meaning=meaning), factor)


def _as_blocks_show(trace: Trace) -> Trace:
    """A trace whose noise is larger by what means over blocks keep more of it than of white noise.

    They do where it is autocorrelated.
    """
    blocks = trace.thinned(MOST_BLOCKS)
    white = math.sqrt(blocks.times.size / trace.times.size)
    noise = {}
    for name, level in trace.noise.items():
        own, kept = fast_noise(trace.values[name]), fast_noise(blocks.values[name])
        noise[name] = level * max(1.0, kept / (white * own) if own > 0.0 else 1.0)
    return replace(trace, noise=noise)


def unexplained(traces: Sequence[Trace], relations: tuple[Relation, ...]) -> list[Misfit]:
    r"""Equations that fail although all that was found is undone.

    With :math:`\Delta` the change over about a second, an equation fails in a record where

    .. math:: \sum (\Delta e)^2 > \tfrac{1}{9} \sum (\Delta y)^2 \quad\text{and}\quad
        \sum (\Delta e)^2 > 8 \sum (\Delta\ \text{of noise and sampling})^2.

    Noise may leave all of a left side that hardly changes, hence the second condition;
    autocorrelated noise is larger than its blocks tell, but leaves less, hence the first.
    """
    result = []
    for trace, (index, relation) in product(map(_as_blocks_show, traces), enumerate(relations)):
        for piece in contrasts(trace, (relation,)):
            weight, (left, moved) = piece.weight, piece.changes
            noise = piece.level**2 + piece.walk / (2.0 - 2.0 * np.cos(piece.angle))
            expected = float(weight @ (noise + np.sum(piece.sampled**2, axis=1)))
            if left > UNEXPLAINED**2 * moved and left > LOUDER * expected:
                at = float(piece.times[int(np.argmax(np.abs(np.diff(piece.series))))])
                result.append(Misfit(index, trace.name, math.sqrt(left / moved), at))
    return result
