r"""Faults of a log that are there or not: signs, units, columns, axes.

Each hypothesis turns the logged signals into others. It is judged by how much of the changes of
every left side remains unexplained, over blocks of about a second,

.. math::

    G = \sum_j n_j \ln \frac{R_j^{\text{before}}}{R_j^{\text{after}}}, \qquad
    R_j = \frac{\sum (\Delta \bar y - \Delta \overline{\int f})^2}{\sum (\Delta \bar y)^2},

twice the logarithm of a likelihood ratio of normal residuals with unknown variances. The division
by the changes of :math:`y` is the Jacobian of a change of its unit, without which the smallest unit
would always win. Hypotheses are taken one after the other, the best first.

What a check of these signals cannot tell, in sentences.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from oed_sysid.evidence.blocks import LEAST_BLOCKS, integral
from oed_sysid.evidence.corrections import level_axis, undo
from oed_sysid.evidence.relations import Relation
from oed_sysid.evidence.result import Correction
from oed_sysid.evidence.traces import Trace
from oed_sysid.physics.model import Model

DEGREE = math.pi / 180.0
# Factor that turns the logged number into the right one, and what it means.
UNITS: dict[str, tuple[tuple[float, str], ...]] = {
    "rad": ((DEGREE, "deg"), (1.0 / DEGREE, "converted from deg twice")),
    "rad/s": (
        (DEGREE, "deg/s"),
        (1.0 / DEGREE, "converted from deg/s twice"),
        (2.0 * math.pi / 60.0, "rpm"),
    ),
    "m": ((0.3048, "ft"), (1.0 / 0.3048, "converted from ft twice"), (1e-3, "mm"), (1e3, "km")),
    "m/s": (
        (1852.0 / 3600.0, "kn"),
        (3600.0 / 1852.0, "converted from kn twice"),
        (0.3048, "ft/s"),
        (1.0 / 3.6, "km/h"),
        (3.6, "converted from km/h twice"),
        (1e-3, "mm/s"),
    ),
}
DELAYS = (-2.4, -1.2, -0.6, -0.3, 0.3, 0.6, 1.2, 2.4)
MOST_SAMPLES = 1500
MOST_FAULTS = 3
# Below this unexplained share an equation hides no discrete fault.
DOUBTFUL = 0.05
ACCEPTED = 40.0
# One equation has to lose this share of what it leaves unexplained.
HALVED = 0.5
# Hypotheses this close to the best one are its rivals.
CLOSE = 12.0
# A ratio below this is numerical.
FLOOR = 1e-8
# A rarer fault needs more evidence.
PENALTY = {
    "sign": 0.0,
    "unit": 2.0,
    "frame": 2.0,
    "swap": 4.0,
    "offset": 4.0,
    "delay": 6.0,
    "lever": 6.0,
}
# Faults with a size: here they only compete, and start the search for sizes.
SIZED = ("delay", "lever")


@dataclass(frozen=True)
class Discrete:
    """A discrete fault that was accepted: how to undo it, its gain, and its rivals."""

    correction: Correction
    gain: float
    meaning: str
    rivals: tuple[Hypothesis, ...]


@dataclass(frozen=True)
class Hypothesis:
    """A discrete fault that a log may have."""

    correction: Correction
    meaning: str


@dataclass(frozen=True)
class Ratios:
    """Unexplained shares of each equation, about zero and about the mean, with counts."""

    raw: np.ndarray
    centred: np.ndarray
    counts: np.ndarray

    def gain_over(self, other: Ratios) -> float:
        """Likelihood-ratio statistic of these ratios over others."""
        return float(np.sum(self.counts * np.log(other.raw / self.raw)))


@dataclass(frozen=True)
class Changes:
    """Changes from block to block over one piece of a record, ``(n_blocks - 1,)`` each.

    ``times`` lie between the blocks, ``left`` are the changes of the left side, ``rest`` what the
    right side leaves of them; a block has ``group`` samples and a ``length`` in s.
    """

    times: np.ndarray
    left: np.ndarray
    rest: np.ndarray
    group: int
    length: float


def search(
    traces: list[Trace], relations: tuple[Relation, ...]
) -> tuple[list[Discrete], list[Trace]]:
    """Find discrete faults.

    Parameters
    ----------
    traces : list of Trace
        The records.
    relations : tuple of Relation
        Equations between their signals.

    Returns
    -------
    found : list of Discrete
        At most three, in the order of their gains; a delay may be among them, as a start value.
    traces : list of Trace
        The records with them undone.
    """
    coarse = [trace.thinned(MOST_SAMPLES) for trace in traces]
    found: list[Discrete] = []
    # Shares that noise alone leaves need no hypothesis: an early end for logs that agree.
    for _ in range(MOST_FAULTS):
        now = ratios(coarse, relations)
        best, rivals = _best(coarse, relations, now)
        if best is None:
            break
        hypothesis, gain = best
        if hypothesis.correction.kind == "delay":
            hypothesis, gain = _refined(hypothesis, coarse, relations, now)
        found.append(Discrete(hypothesis.correction, gain, hypothesis.meaning, rivals))
        coarse = [undo(trace, (hypothesis.correction,), relations) for trace in coarse]
        traces = [undo(trace, (hypothesis.correction,), relations) for trace in traces]
    return found, traces


def _best(
    traces: list[Trace], relations: tuple[Relation, ...], now: Ratios
) -> tuple[tuple[Hypothesis, float] | None, tuple[Hypothesis, ...]]:
    """The hypothesis with the largest gain, if it is accepted, and those close to it."""
    scored: list[tuple[float, float, Hypothesis]] = []
    for hypothesis in hypotheses(traces, relations):
        touched = {*hypothesis.correction.signals}
        concerned = [
            i
            for i, r in enumerate(relations)
            if (touched & {r.target, *r.signals}) and now.counts[i] > 0
        ]
        if not concerned:
            continue
        if hypothesis.correction.kind == "lever":
            hypothesis = _fitted(hypothesis, traces, relations, concerned)
        changed = [undo(trace, (hypothesis.correction,), relations) for trace in traces]
        then = ratios(changed, relations, only=concerned, otherwise=now)
        gain = then.gain_over(now)
        halved = np.any(then.raw[concerned] < HALVED * now.raw[concerned])
        worse = np.any(then.centred[concerned] > 1.1 * now.centred[concerned] + 1e-3)
        if gain > ACCEPTED and halved and not worse:
            scored.append((gain - PENALTY[hypothesis.correction.kind], gain, hypothesis))
    if not scored:
        return None, ()
    scored.sort(key=lambda row: -row[0])
    value, gain, best = scored[0]
    rivals = tuple(h for v, _, h in scored[1:] if v > value - CLOSE)
    return (best, gain), rivals


def _fitted(
    one: Hypothesis, traces: list[Trace], relations: tuple[Relation, ...], concerned: list[int]
) -> Hypothesis:
    """A lever arm of least squares, each equation weighed by what it leaves."""
    above, below = 0.0, 1e-300
    # The base, too, lacks the samples that the rate lacks.
    none, unit = (replace(one.correction, value=arm) for arm in (0.0, 1.0))
    bases = [undo(trace, (none,), relations) for trace in traces]
    moved = [undo(trace, (unit,), relations) for trace in traces]
    for index in concerned:
        products = np.zeros(3)
        for before, after in zip(bases, moved, strict=True):
            pairs = zip(
                changes(before, relations[index]),
                changes(after, relations[index]),
                strict=True,
            )
            for base, turned in pairs:
                change = turned.rest - base.rest
                products += (base.rest @ change, change @ change, base.rest @ base.rest)
        if products[1] > 0.0:
            left = max(products[2] - products[0] ** 2 / products[1], 1e-9 * products[2])
            above -= products[0] / left
            below += products[1] / left
    return Hypothesis(replace(one.correction, value=above / below), one.meaning)


def _refined(
    one: Hypothesis, traces: list[Trace], relations: tuple[Relation, ...], now: Ratios
) -> tuple[Hypothesis, float]:
    """The delay near the one given that gains most."""
    delay, gain = one.correction.value, -math.inf
    width = 0.5 * abs(delay)
    for _ in range(5):
        trials = []
        for trial in (delay - width, delay, delay + width):
            fix = replace(one.correction, value=trial)
            then = ratios([undo(t, (fix,), relations) for t in traces], relations, otherwise=now)
            trials.append((then.gain_over(now), trial))
        gain, delay = max(trials)
        width /= 2.0
    return Hypothesis(replace(one.correction, value=delay), one.meaning), gain


def ratios(
    traces: list[Trace],
    relations: tuple[Relation, ...],
    *,
    only: list[int] | None = None,
    otherwise: Ratios | None = None,
) -> Ratios:
    """Unexplained share of the changes of each left side.

    Parameters
    ----------
    traces, relations
        The records and the equations.
    only : list of int, optional
        Equations to work out; the others are taken from ``otherwise``.
    otherwise : Ratios, optional
        See ``only``.
    """
    n = len(relations)
    raw, centred = np.ones(n), np.ones(n)
    counts = np.zeros(n)
    for i, relation in enumerate(relations):
        if only is not None and otherwise is not None and i not in only:
            raw[i], centred[i] = otherwise.raw[i], otherwise.centred[i]
            counts[i] = otherwise.counts[i]
            continue
        sums = np.zeros(4)
        for trace in traces:
            for left, rest in ((part.left, part.rest) for part in changes(trace, relation)):
                sums += (rest @ rest, left @ left, _spread(rest), _spread(left))
                counts[i] += left.size
        if counts[i] and sums[1] > 0.0 and sums[3] > 0.0:
            raw[i] = max(sums[0] / sums[1], FLOOR)
            centred[i] = max(sums[2] / sums[3], FLOOR)
        else:
            counts[i] = 0
    if otherwise is not None:
        # A hypothesis that leaves fewer blocks (a shift at the ends) gains nothing by that.
        counts = np.minimum(counts, otherwise.counts)
    return Ratios(raw, centred, counts)


def _spread(values: np.ndarray) -> float:
    return float(np.sum((values - values.mean()) ** 2))


def changes(trace: Trace, relation: Relation, *, every: int = 1) -> Iterator[Changes]:
    """Changes of a left side from block to block, and what is left of them.

    With ``every`` above one the right side is joined by straight lines between each so many
    samples, which tells how well it is sampled.
    """
    if any(name not in trace.values for name in (relation.target, *relation.signals)):
        return
    series, usable = trace.filled(relation.signals)
    if not series:
        return
    rate = relation(series, trace.times)
    if every > 1:
        rate = np.interp(trace.times, trace.times[::every], rate[::every])
    target = trace.values[relation.target]
    for piece in trace.pieces(usable, LEAST_BLOCKS):
        rows = np.flatnonzero(np.isfinite(target[piece])) + piece.start
        if rows.size < LEAST_BLOCKS:
            continue
        times = trace.times[piece]
        spacing = trace.step * (piece.stop - piece.start) / rows.size
        group = max(1, min(round(1.0 / spacing), rows.size // LEAST_BLOCKS))
        n = rows.size // group
        inside = integral(times, rate[piece][:, None])[:, 0] if relation.is_rate else rate[piece]
        rows = rows[: n * group]
        left = target[rows].reshape(n, group).mean(axis=1)
        right = inside[rows - piece.start].reshape(n, group).mean(axis=1)
        middle = trace.times[rows].reshape(n, group).mean(axis=1)
        between = 0.5 * (middle[1:] + middle[:-1])
        yield Changes(between, np.diff(left), np.diff(left - right), group, group * spacing)


def hypotheses(traces: list[Trace], relations: tuple[Relation, ...]) -> Iterator[Hypothesis]:
    """Discrete faults that these signals may have."""
    names = list(dict.fromkeys(n for r in relations for n in (r.target, *r.signals)))
    units = traces[0].units | {n: u for trace in traces for n, u in trace.units.items()}
    for name in names:
        yield Hypothesis(Correction("sign", (name,), -1.0), "")
        for factor, meaning in UNITS.get(units[name], ()):
            yield Hypothesis(Correction("unit", (name,), factor), meaning)
    for pair in combinations(names, 2):
        yield Hypothesis(Correction("swap", pair), "")
    yield from _geometry(traces, relations, units)
    # Faults with a size that would else be taken for one of these; only their start values.
    yield from (
        Hypothesis(Correction("lever", (v,), 0.0, (r,)), "") for v, r in levers(relations, units)
    )
    step = float(np.median([trace.step for trace in traces]))
    together = (positions_of(relations, units), velocities_of(relations, units))
    groups = [*((name,) for name in names), *(group for group in together if len(group) > 1)]
    delays = [delay for delay in DELAYS if abs(delay) > 0.5 * step]
    for group, delay in product(groups, delays):
        yield Hypothesis(Correction("delay", group, delay), "")


def _geometry(
    traces: list[Trace], relations: tuple[Relation, ...], units: dict[str, str]
) -> Iterator[Hypothesis]:
    """Velocities along earth's axes, and headings that count from elsewhere."""
    positions = [r for r in relations if r.is_rate and units[r.target] == "m"]
    velocities = velocities_of(relations, units)
    known = all(name in trace.values for trace in traces for name in velocities)
    level = {
        level_axis(r, traces[0].values, units, traces[0].times, velocities) for r in positions
    } - {None}
    if level and known:
        yield Hypothesis(Correction("frame", velocities), "")
    if len(positions) > 1:
        shared = set.intersection(*(set(r.signals) for r in positions))
        for angle in sorted(n for n in shared if units[n] == "rad"):
            for quarter in (1, 2, 3):
                offset = quarter * math.pi / 2.0
                yield Hypothesis(Correction("offset", (angle,), offset), f"{90 * quarter} deg")


def levers(relations: tuple[Relation, ...], units: dict[str, str]) -> tuple[tuple[str, str], ...]:
    """Velocities and the rates that a lever arm mixes into them."""
    inner = dict.fromkeys(n for r in relations for n in r.signals)
    rates = [n for n in inner if units[n] == "rad/s"]
    along = (("u", "p"), ("v", "q"), ("w", "r"))
    pairs = ((v, r) for v in velocities_of(relations, units) for r in rates)
    return tuple(pair for pair in pairs if pair not in along)


def positions_of(relations: tuple[Relation, ...], units: dict[str, str]) -> tuple[str, ...]:
    """Signals whose rates are velocities along fixed axes."""
    return tuple(r.target for r in relations if r.is_rate and units[r.target] == "m")


def velocities_of(relations: tuple[Relation, ...], units: dict[str, str]) -> tuple[str, ...]:
    """Velocities that positions are the integrals of, in order of appearance."""
    rates = [r for r in relations if r.is_rate and units[r.target] == "m"]
    order = ("u", "v", "w")
    found = dict.fromkeys(n for r in rates for n in r.signals if units[n] == "m/s")
    return tuple(sorted(found, key=lambda n: order.index(n) if n in order else len(order)))


def unchecked(
    model: Model, relations: tuple[Relation, ...], traces: list[Trace]
) -> tuple[str, ...]:
    """Sentences about what the equations leave open."""
    units = {n: u for trace in traces for n, u in trace.units.items()}
    related = {n for r in relations for n in (r.target, *r.signals)}
    alone = [n for n in model.output_names if n in units and n not in related]
    said = []
    if alone:
        said.append(f"No equation without unknown parameters relates {', '.join(alone)}.")
    if not relations:
        return tuple(said)
    targets = [r.target for r in relations if r.is_rate]
    said.append(f"Constant offsets of {', '.join(targets)}, and a delay common to all signals.")
    return (*said, *_of_angles(relations, units), *_of_positions(relations, units))


def _of_angles(relations: tuple[Relation, ...], units: dict[str, str]) -> list[str]:
    """What an angle and its one rate leave open."""
    angles = [r for r in relations if units.get(r.target) == "rad" and len(r.signals) == 1]
    elsewhere = {name for r in relations for name in r.signals}
    lonely = [
        f"Which of {r.target} and {r.signals[0]} has a wrong sign, unit, scale or delay; "
        "both alike."
        for r in angles
        if r.target not in elsewhere
    ]
    shared = [
        f"A wrong sign or unit that {r.target} and {r.signals[0]} share in full."
        for r in angles
        if r.target in elsewhere
    ]
    return [*lonely, *shared]


def _of_positions(relations: tuple[Relation, ...], units: dict[str, str]) -> list[str]:
    """What positions and velocities leave open."""
    positions, velocities = positions_of(relations, units), velocities_of(relations, units)
    said = []
    if positions:
        said.append(
            f"The sign of {', '.join(positions)} against those of {', '.join(velocities)} together."
        )
        said.append("A bias of an attitude angle against a misalignment of the velocities.")
        said.append("At a single speed: a bias of a velocity against its scale.")
    if len(positions) > 1:
        said.append("On straight runs: a current against a bias of the velocities.")
    return said
