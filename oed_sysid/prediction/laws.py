r"""Laws of steering, given or read from a record: a held course, and the orders of a zigzag.

A helmsman or an autopilot that holds a course,

.. math::
    \delta_k = \delta_0 + K_p (\psi_\mathrm{ref}(t_k) - \psi_k) - K_d r_k ,

within a limit and at a limited rate; :math:`\psi_\mathrm{ref}` changes in steps
(:class:`CourseControl`).

Of a zigzag (:class:`ZigzagControl`) the logged rudder is held at an order, moves at its rate to the
next and is held again. Orders are the levels at which it is held; an order is given where the ramp
leaves the level before,

.. math::
    t_b = \bar t - \frac{\bar\delta - \delta_\mathrm{before}}{\dot\delta} ,

with the means of time and rudder over the ramp. In a log by samples the order lies within the
step after :math:`t_b`; the heading of reversal is that at half of it, from the smoothed heading
(:func:`oed_sysid.prediction.helmsman.smooth_heading`), uncertain by the smoother and by
:math:`|r| \Delta t / \sqrt{12}`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError
from oed_sysid.prediction.helmsman import CONSTANT, fit_course_law, rudder_noise, smooth_heading
from oed_sysid.runtime.display import Report, Section, Table, as_text, digits, rounded, share

DEGREE = math.degrees(1.0)


MOST_CHANGES = 8


@dataclass(frozen=True, eq=False)
class CourseEvidence:
    """What a record says of a course law.

    Attributes
    ----------
    names : tuple of str
        ``gain``, ``damping``, ``level 0``, ... (rudder at heading zero; ``neutral`` where the
        courses were given), ``rate``, ``limit``.
    values : ndarray (n_values,)
        SI.
    covariance : ndarray (n_values, n_values)
        Zero for a rate or limit that was not reached.
    explained : float
        Share of the rudder's variance that the law explains.
    rms : float
        Rudder that it does not explain, rad.
    memory : float
        Correlation of that from sample to sample.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray = field(repr=False)
    explained: float
    rms: float
    memory: float

    @property
    def std_errors(self) -> dict[str, float]:
        """Standard errors by name."""
        errors = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        return dict(zip(self.names, map(float, errors), strict=True))


@dataclass(frozen=True)
class CourseControl:
    """Proportional and damping law of a helmsman or an autopilot.

    Parameters
    ----------
    input : str
        Rudder.
    gain : float
        Rudder per heading error, 1.
    damping : float
        Rudder per yaw rate, s.
    course : float
        Heading that is held, rad.
    neutral : float
        Rudder at which it is held, rad.
    limit : float
        Largest rudder, rad.
    rate : float
        Largest rudder rate, rad/s.
    heading, yaw_rate : str
        Outputs that it sees.
    changes : tuple of (float, float)
        Time from the record's beginning, s, and the course from then on, rad.
    noise_share : float
        Share of the sensors' noise that it sees: 1, or 0 where it has better sensors.
    evidence : CourseEvidence, optional
        Standard errors, if it was read from a record.

    Examples
    --------
    >>> law = CourseControl("delta", 1.5, 6.0, 0.0, changes=((20.0, 0.4),))
    >>> [round(law.order(None, {"psi": 0.1, "r": 0.01, "time": t})[0], 2) for t in (10.0, 30.0)]
    [-0.21, 0.39]
    """

    input: str
    gain: float
    damping: float
    course: float
    neutral: float = 0.0
    limit: float = math.inf
    rate: float = math.inf
    heading: str = "psi"
    yaw_rate: str = "r"
    changes: tuple[tuple[float, float], ...] = ()
    noise_share: float = 1.0
    evidence: CourseEvidence | None = field(default=None, repr=False, compare=False)

    def start(self) -> None:
        """It has no memory."""

    def course_at(self, time: float) -> float:
        """Course at a time from the record's beginning, rad."""
        course = self.course
        for begin, new in self.changes:
            if time < begin:
                break
            course = new
        return course

    def order(self, memory: None, seen: Mapping[str, float]) -> tuple[float, None]:
        """See :class:`~oed_sysid.prediction.closed_loop.Control`."""
        course = self.course_at(seen["time"]) if self.changes else self.course
        error = course - seen[self.heading]
        wanted = self.neutral + self.gain * error - self.damping * seen[self.yaw_rate]
        return float(np.clip(wanted, -self.limit, self.limit)), memory

    def drawn(self, rng: np.random.Generator) -> CourseControl:
        """Law with numbers drawn from their uncertainty; itself where it was given."""
        if self.evidence is None:
            return self
        values = rng.multivariate_normal(
            self.evidence.values, self.evidence.covariance, method="eigh", check_valid="ignore"
        )
        return self._with(values)

    def disturbance(self, n_times: int, rng: np.random.Generator) -> np.ndarray:
        """Rudder that the law does not explain, drawn ``(n_times,)``, rad."""
        if self.evidence is None:
            return np.zeros(n_times)
        noise = rng.standard_normal(n_times)
        memory = float(np.clip(self.evidence.memory, 0.0, 0.99))
        for k in range(1, n_times):
            noise[k] = memory * noise[k - 1] + math.sqrt(1 - memory**2) * noise[k]
        return self.evidence.rms * noise

    def _with(self, values: np.ndarray) -> CourseControl:
        """The law with other values of the evidence's names."""
        names = self.evidence.names if self.evidence else ()
        value = dict(zip(names, map(float, values), strict=True))
        new = replace(
            self,
            gain=value["gain"],
            damping=value["damping"],
            rate=abs(value["rate"]),
            limit=abs(value["limit"]),
        )
        if "neutral" in value:
            return replace(new, neutral=value["neutral"])
        levels = [value[name] for name in names if name.startswith("level")]
        courses = [level / value["gain"] for level in np.cumsum(levels)]
        times = [time for time, _ in self.changes]
        return replace(new, course=courses[0], changes=tuple(zip(times, courses[1:], strict=True)))

    def document(self) -> Report:
        """Return the law with standard errors, and what it explains, as a table."""
        known = self.evidence.std_errors if self.evidence else {}
        facts = [("gain", self.gain, known.get("gain", 0.0)),
                 ("damping [s]", self.damping, known.get("damping", 0.0))]  # fmt: skip
        courses = ((0.0, self.course), *self.changes)
        for (time, course), error in zip(courses, self._course_errors(), strict=True):
            since = f" from {time:.4g} s" if time else ""
            facts.append((f"course{since} [deg]", DEGREE * course, DEGREE * error))
        for name in ("neutral", "rate", "limit"):
            unit = "deg/s" if name == "rate" else "deg"
            value = DEGREE * getattr(self, name)
            if name != "neutral" or self.neutral or "neutral" in known:
                facts.append((f"{name} [{unit}]", value, DEGREE * known.get(name, 0.0)))
        rows = [
            (name, rounded(value, error), digits(error, 2) if error > 0 else "")
            for name, value, error in facts
            if math.isfinite(value)
        ]
        explained = []
        if self.evidence:
            explained.append(
                f"explains {share(self.evidence.explained)} of the rudder's variance, rms "
                f"{DEGREE * self.evidence.rms:.2g} deg left"
            )
        table = Table(("", "value", "std error"), rows)
        section = Section("Law", explained, (table,), indent=2)
        return Report(f"course law of {self.input}", sections=(section,))

    report = as_text

    def _course_errors(self) -> list[float]:
        """Standard errors of the courses, rad; zero where they were given."""
        if self.evidence is None or "neutral" in self.evidence.names:
            return [0.0] * (1 + len(self.changes))
        names, covariance = self.evidence.names, self.evidence.covariance
        errors = []
        total = np.zeros(len(names))
        for position, name in enumerate(names):
            if not name.startswith("level"):
                continue
            total[position] = 1.0
            slope = total / self.gain
            slope[0] = -float(self.evidence.values[total > 0].sum()) / self.gain**2
            errors.append(math.sqrt(max(slope @ covariance @ slope, 0.0)))
        return errors

    @classmethod
    def of(
        cls,
        record: Record,
        input: str,
        *,
        heading: str = "psi",
        yaw_rate: str = "r",
        courses: ArrayLike | str | None = None,
        most_changes: int = MOST_CHANGES,
    ) -> CourseControl:
        """Identify the law from a record; equations in :mod:`oed_sysid.prediction.helmsman`.

        Parameters
        ----------
        record : Record
            With a rudder that was steered by a course law throughout.
        input : str
            The rudder.
        heading, yaw_rate : str
            Outputs that the law sees.
        courses : array_like (n_times,) or str, optional
            The ordered course, rad, or the input or output that holds it; by default constant
            with changes that are found. The rudder amidships and the course then cannot be told
            apart: the course is that at which the rudder is zero.
        most_changes : int
            Most changes of a course that is found.

        Raises
        ------
        DataError
            If the rudder is constant, if heading and yaw rate explain less than half of what
            changes of course leave of it, or if the law would drive the ship off its course.

        Examples
        --------
        >>> from oed_sysid.physics.channels import Channels, Input, Output
        >>> channels = Channels(
        ...     (Input("delta", "rad"),), (Output("psi", "rad"), Output("r", "rad/s")))
        >>> t = np.arange(0.0, 30.0, 0.5)
        >>> psi, r = 0.1 * np.sin(0.3 * t), 0.03 * np.cos(0.3 * t)
        >>> rudder = 0.02 + 1.5 * (0.05 - psi) - 4.0 * r
        >>> log = Record("held", t, rudder[:, None], np.column_stack([psi, r]), channels)
        >>> law = CourseControl.of(log, "delta")
        >>> print(round(law.gain, 2), round(law.damping, 2))
        1.5 4.0
        """
        series = None if courses is None else _series(record, courses)
        fit = fit_course_law(
            record,
            input,
            heading=heading,
            yaw_rate=yaw_rate,
            courses=series,
            most_changes=most_changes,
        )
        followed = fit.followed
        left = followed.residuals
        n_levels = len(followed.law) - 2
        levels = ["neutral"] if series is not None else []
        levels = levels or [f"level {i}" for i in range(n_levels)]
        evidence = CourseEvidence(
            ("gain", "damping", *levels, "rate", "limit"),
            np.array([*followed.law, followed.rate, followed.limit]),
            followed.covariance,
            fit.explained,
            float(np.sqrt(np.mean(left**2))),
            followed.memory,
        )
        times = record.times - record.times[0]
        # A change lies between two samples.
        changes = [(float((times[k] + times[k - 1]) / 2), 0.0) for k in fit.changes]
        course = 0.0
        if series is not None:
            course = float(series[0])
            changes = [
                (float((times[k] + times[k - 1]) / 2), float(series[k]))
                for k in np.flatnonzero(np.diff(series)) + 1
            ]
        law = cls(
            input,
            0.0,
            0.0,
            course,
            heading=heading,
            yaw_rate=yaw_rate,
            changes=tuple(changes),
            noise_share=float(fit.sees_noise),
            evidence=evidence,
        )
        return law._with(evidence.values)


def _series(record: Record, courses: ArrayLike | str) -> np.ndarray:
    """The ordered course, sample by sample."""
    if isinstance(courses, str):
        known = courses in record.channels.input_names
        return record.input(courses) if known else record.output(courses)
    series = np.array(courses, dtype=float)
    if series.shape != record.times.shape or not np.isfinite(series).all():
        raise DataError(
            f"The ordered courses have the shape {series.shape}, {np.isfinite(series).sum()} of "
            f"them numbers. Expected {record.times.shape} for record {record.name!r}, in rad."
        )
    return series


# Share of the rudder's range by which it has to move for a new order.
NEW_ORDER = 0.35


# A rudder within this share of its range, or so many standard deviations of noise, is held.
HELD = 0.02


HELD_NOISE = 4.0


# Mean cosine of the phases of orders from which on they were given at samples.
AT_SAMPLES = 0.9


@dataclass(frozen=True, eq=False)
class ZigzagEvidence:
    """Standard errors of what was read from a record.

    Attributes
    ----------
    orders : ndarray (n_legs,)
        rad; NaN for a leg in which the rudder was not held.
    reversals : ndarray (n_legs - 1,)
        rad, that of half a sample included.
    from_draw_to_draw : ndarray (n_legs - 1,)
        The same without what does not matter at the record's own samples, rad: where orders
        were given at samples, the replay gives them at the same ones.
    rate : float
        rad/s.
    execute : float
        s.
    """

    orders: np.ndarray
    reversals: np.ndarray
    from_draw_to_draw: np.ndarray
    rate: float
    execute: float


@dataclass(frozen=True)
class ZigzagControl:
    """Orders of a zigzag test, reversed where the heading says.

    Parameters
    ----------
    input : str
        Rudder.
    orders : tuple of float
        Rudder of each leg, rad.
    reversals : tuple of float
        Heading at which each leg ends, rad; passed in the direction of the sign of ``towards``.
    towards : tuple of float
        1 where the heading rises to its reversal, -1 where it falls.
    rate : float
        Largest rudder rate, rad/s.
    before : float
        Rudder before the first execute, rad.
    execute : float
        Time of the first order from the record's beginning, s.
    heading : str
        Output that it sees.
    noise_share : float
        Share of the sensors' noise that it sees; 0 where it was read from a record, whose
        headings of reversal hold that noise already.
    evidence : ZigzagEvidence, optional
        Standard errors, if it was read from a record.
    """

    input: str
    orders: tuple[float, ...]
    reversals: tuple[float, ...]
    towards: tuple[float, ...]
    rate: float
    before: float = 0.0
    execute: float = 0.0
    heading: str = "psi"
    noise_share: float = 1.0
    evidence: ZigzagEvidence | None = field(default=None, repr=False, compare=False)

    def start(self) -> int:
        """No leg yet."""
        return 0

    def order(self, memory: int, seen: Mapping[str, float]) -> tuple[float, int]:
        """See :class:`~oed_sysid.prediction.closed_loop.Control`."""
        if seen["time"] < self.execute:
            return self.before, memory
        leg = memory
        while leg < len(self.reversals) and (
            self.towards[leg] * (seen[self.heading] - self.reversals[leg]) >= 0
        ):
            leg += 1
        return self.orders[min(leg, len(self.orders) - 1)], leg

    def drawn(self, rng: np.random.Generator) -> ZigzagControl:
        """Law with numbers drawn from their uncertainty; itself where it was given."""
        known = self.evidence
        if known is None:
            return self
        orders = self.orders + np.nan_to_num(known.orders) * rng.standard_normal(len(self.orders))
        headings = self.reversals + known.from_draw_to_draw * rng.standard_normal(
            len(self.reversals)
        )
        rate = self.rate + known.rate * rng.standard_normal()
        return replace(
            self,
            orders=tuple(map(float, orders)),
            reversals=tuple(map(float, headings)),
            rate=float(max(rate, 0.1 * self.rate)),
            execute=float(max(self.execute + known.execute * rng.standard_normal(), 0.0)),
        )

    def document(self) -> Report:
        """Return orders, headings of reversal and rate with standard errors as a table."""
        known = self.evidence
        rows = []
        for leg, order in enumerate(self.orders):
            last = leg == len(self.reversals)
            rows.append(
                (
                    f"{leg + 1}",
                    f"{DEGREE * order:.2f}",
                    "" if known is None else _error(known.orders[leg]),
                    "" if last else f"{DEGREE * self.reversals[leg]:.2f}",
                    "" if last or known is None else _error(known.reversals[leg]),
                )
            )
        error = f", standard error {DEGREE * known.rate:.2g}" if known else ""
        said = [f"rate {DEGREE * self.rate:.3g} deg/s{error}; execute {self.execute:.4g} s"]
        if known is not None and np.isnan(known.orders).any():
            said.append(
                "Legs without a standard error were never held: their order is that of the "
                "other legs, or the largest rudder reached."
            )
        headers = ("leg", "order [deg]", "std error", "until heading [deg]", "std error")
        section = Section("Legs", said, (Table(headers, rows),), indent=2)
        return Report(f"zigzag of {self.input}", sections=(section,))

    report = as_text

    @classmethod
    def of(
        cls, record: Record, input: str, *, heading: str = "psi", yaw_rate: str = "r"
    ) -> ZigzagControl:
        """Read orders, headings of reversal and rudder rate from a record.

        Parameters
        ----------
        record : Record
            With a rudder that is held, reversed and held.
        input : str
            The rudder.
        heading : str
            Output that the law sees.
        yaw_rate : str
            Output that helps to smooth the heading, if the record has it.

        Raises
        ------
        DataError
            If the rudder is not reversed at least once.
        """
        rudder, times = record.input(input), record.times
        record.output(heading)
        span = float(np.ptp(rudder))
        legs = _legs(rudder, NEW_ORDER * span) if span > CONSTANT else []
        noise = rudder_noise(rudder)
        near = max(HELD_NOISE * noise, HELD * span)
        levels, errors = _levels(rudder, times, legs, near)
        # The first leg is the rudder before the test where it lies between the others.
        first = int(len(legs) > 1 and abs(levels[0] - np.mean([*_ends(levels)])) < 0.25 * span)
        if len(legs) < 2 + first:
            raise DataError(
                f"The rudder {input!r} of record {record.name!r} is never reversed: it is no "
                "zigzag. Use CourseControl, or replay the logged input."
            )
        begins, unsure, rate, rate_error = _ramps(rudder, times, legs, levels, errors, near)
        step = float(np.median(np.diff(times)))
        smooth = smooth_heading(record, input, heading=heading, yaw_rate=yaw_rate)
        reversals, towards, spread = [], [], []
        # Orders that were given at samples all begin at the same phase of a step.
        phases = np.exp(2j * np.pi * (np.array(begins) - times[0]) / step)
        at_samples = bool(phases.mean().real > AT_SAMPLES)
        for begin, error in zip(begins[first:], unsure[first:], strict=True):
            psi, psi_error, r = smooth.at(begin + step / 2)
            reversals.append(psi)
            towards.append(math.copysign(1.0, r))
            own = math.hypot(psi_error, 0.0 if at_samples else r * error)
            within = abs(r) * step / math.sqrt(12)
            spread.append((math.hypot(own, within), own if at_samples else math.hypot(own, within)))
        table = np.array(spread)
        half = step / math.sqrt(12)
        return cls(
            input,
            tuple(map(float, levels[first:])),
            tuple(reversals),
            tuple(towards),
            rate,
            float(levels[0]) if first else float(rudder[0]),
            float(max(begins[0] + step / 2 - times[0], 0.0)) if first else 0.0,
            heading,
            0.0,
            ZigzagEvidence(
                errors[first:],
                table[:, 0],
                table[:, 1],
                rate_error,
                math.hypot(half, unsure[0]) if first and not at_samples else 0.0,
            ),
        )


def _error(value: float) -> str:
    """Standard error in degrees."""
    return "" if math.isnan(value) else f"{max(DEGREE * value, 0.0):.2f}"


def _ends(levels: np.ndarray) -> tuple[float, float]:
    """Smallest and largest level."""
    return float(np.min(levels)), float(np.max(levels))


def _legs(rudder: np.ndarray, move: float) -> list[tuple[int, int, float]]:
    """Cut a rudder where it turns back by more than ``move``.

    Returns begin, end (exclusive) and side, 1 or -1, of each leg; legs meet where the rudder is
    half way from one extreme to the next.
    """
    extremes: list[tuple[int, float]] = []
    lowest = highest = 0
    side = 0.0
    for k, value in enumerate(rudder):
        if value > rudder[highest]:
            highest = k
        if value < rudder[lowest]:
            lowest = k
        if side <= 0 and value - rudder[lowest] > move:
            extremes.append((lowest, -1.0))
            side, highest = 1.0, k
        elif side >= 0 and rudder[highest] - value > move:
            extremes.append((highest, 1.0))
            side, lowest = -1.0, k
    if not extremes:
        return []
    extremes.append((highest if side > 0 else lowest, side))
    cuts = [0]
    for (k, _), (after, _) in pairwise(extremes):
        middle = (rudder[k] + rudder[after]) / 2
        past = (rudder[k : after + 1] - middle) * (rudder[after] - middle) >= 0
        cuts.append(k + int(past.argmax()))
    cuts.append(len(rudder))
    return [(a, b, s) for (a, b), (_, s) in zip(pairwise(cuts), extremes, strict=True)]


def _levels(
    rudder: np.ndarray, times: np.ndarray, legs: list[tuple[int, int, float]], near: float
) -> tuple[np.ndarray, np.ndarray]:
    """Level at which each leg is held and its standard error; NaN where it is not held."""
    fastest = float(np.quantile(np.abs(np.diff(rudder)) / np.diff(times), 0.98))
    # So many samples lie so near each other on the ramps to and from a peak.
    passing = 4 * near / max(fastest * float(np.median(np.diff(times))), 1e-12)
    levels, errors = [], []
    for begin, end, side in legs:
        values = np.sort(rudder[begin:end])
        counts = np.searchsorted(values, values + 2 * near, side="right") - np.arange(len(values))
        k = int(counts.argmax())
        group = values[k : k + counts[k]]
        middle = np.median(group)
        group = values[np.abs(values - middle) <= near]
        if len(group) >= max(3, 1.5 * passing):
            levels.append(float(np.median(group)))
            errors.append(float(1.25 * np.std(group) / math.sqrt(len(group))))
        else:
            levels.append(float(side * np.max(side * values)))
            errors.append(math.nan)
    for i, (_, _, side) in enumerate(legs):
        others = [
            level
            for level, error, leg in zip(levels[1:], errors[1:], legs[1:], strict=True)
            if leg[2] == side and math.isfinite(error)
        ]
        if math.isnan(errors[i]) and others:
            usual = float(np.median(others))
            # A peak beyond the others is an order of its own.
            levels[i] = levels[i] if side * (levels[i] - usual) > near else usual
    return np.array(levels), np.array(errors)


def _ramps(
    rudder: np.ndarray,
    times: np.ndarray,
    legs: list[tuple[int, int, float]],
    levels: np.ndarray,
    errors: np.ndarray,
    near: float,
) -> tuple[list[float], list[float], float, float]:
    """When each level is left, its standard error, and the rate with its standard error."""
    middles: list[tuple[float, float, int, int]] = []
    slopes = []
    for (begin, cut, _), (_, end, _), low, high in zip(
        legs, legs[1:], levels, levels[1:], strict=False
    ):
        side = math.copysign(1.0, high - low)
        gone = side * (rudder[begin:end] - low)
        left = begin + np.flatnonzero(gone[: cut - begin] <= near)
        last = int(left[-1]) if left.size else begin + int(gone[: cut - begin].argmin())
        come = cut + np.flatnonzero(side * (high - rudder[cut:end]) <= near)
        until = int(come[0]) if come.size else cut + int((side * rudder[cut:end]).argmax())
        inner = np.arange(last + 1, until)
        if len(inner) >= 3:
            slopes.append(abs(float(np.polyfit(times[inner], rudder[inner], 1)[0])))
        if len(inner):
            middles.append(
                (float(times[inner].mean()), float(rudder[inner].mean()), last, len(inner))
            )
        else:
            middles.append((math.nan, math.nan, last, 0))
    if slopes:
        rate = float(np.median(slopes))
        rate_error = 1.25 * float(np.std(slopes)) / math.sqrt(len(slopes))
    else:
        moves = np.abs(np.diff(levels)) / [
            times[min(last + count + 1, len(times) - 1)] - times[last]
            for _, _, last, count in middles
        ]
        rate, rate_error = float(np.max(moves)), 0.0
    noise = rudder_noise(rudder)
    begins: list[float] = []
    unsure: list[float] = []
    for i, (middle, value, last, count) in enumerate(middles):
        if not count:
            begins.append(float(times[last]))
            unsure.append(0.0)
            continue
        side = math.copysign(1.0, levels[i + 1] - levels[i])
        left_at = middle - side * float(value - levels[i]) / rate
        if math.isnan(errors[i]) and i and middles[i - 1][3]:
            # Never held: it turned where both ramps meet.
            before, reached = middles[i - 1][:2]
            left_at = (before + middle - side * (value - reached) / rate) / 2
        begins.append(float(left_at))
        drift = abs(value - levels[i]) / rate * rate_error / rate
        unsure.append(math.hypot(noise / math.sqrt(count) / rate, drift))
    return begins, unsure, rate, rate_error
