r"""Replay with the helmsman in the loop: the rudder answers the predicted ship, not the logged one.

A logged rudder of a helmsman or an autopilot answers the motion that was logged. Replayed open
loop on a model that differs a little, it steers another ship: errors of heading integrate, and
for a course-unstable vessel they grow. In the loop the law is replayed instead, at a limited rate,
with the model's own heading and yaw rate. A helmsman or an autopilot that holds a course orders

.. math::
    \delta_k = \delta_0 + K_p (\psi_\mathrm{ref}(t_k) - \psi_k) - K_d r_k

within a limit; :math:`\psi_\mathrm{ref}` changes in steps (:class:`CourseControl`). Orders of a
zigzag (:class:`ZigzagControl`) are :math:`\pm\delta_a`, reversed where
:math:`|\psi_k - \psi_0|` passes :math:`\psi_s`.

A law is given, or read from the record: that of a course by :mod:`problems.kvlcc2.helmsman`.
Of a zigzag orders are the levels at which the logged rudder is held, each given where it leaves the
level before (:func:`oed_sysid.experiments.indices.rudder_legs`). In a log by samples the order lies
within the step after; the heading of reversal is that at half of it, from the smoothed heading
(:func:`problems.kvlcc2.helmsman.smooth_heading`), uncertain by the smoother and by
:math:`|r| \Delta t / \sqrt{12}`.

Bands are those of draws from the fit, each in its own loop with a law drawn from its own
uncertainty, in which the law sees noisy sensors, the rudder has the noise that the law did not
explain, and the start is as uncertain as its measurement.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.record import Record
from oed_sysid.errors import DataError, ModelError, located
from oed_sysid.experiments.indices import rudder_legs
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.noise_levels import fast_level
from oed_sysid.likelihood.start_guess import measured_columns, measured_states
from oed_sysid.physics.model import Model
from oed_sysid.prediction.draws import asked, parameter_sets
from oed_sysid.runtime.display import Report, Section, Table, as_text, digits, rounded, share
from oed_sysid.text.units import shown_unit

from .helmsman import correlation, fit_course_law, smooth_heading

__all__ = ["ClosedLoop", "Control", "CourseControl", "ZigzagControl", "closed_loop"]

# Share of a signal's amplitude from which on the draws' spread says that its phase is lost.
LOST = 0.5


class Control(ABC):
    """A law that gives one input from what is measured.

    Attributes
    ----------
    input : str
        The input that it gives.
    rate : float
        Largest change of the input per second.
    heading : str
        Output whose phase draws may lose; empty for none.
    noise_share : float
        Share of the sensors' noise that the law sees.
    """

    input: str
    rate: float
    heading: str = ""
    noise_share: float = 1.0

    @abstractmethod
    def order(self, memory: Any, seen: Mapping[str, float]) -> tuple[float, Any]:
        """Input that is asked for and the new memory, from outputs and ``time`` by name."""

    def start(self) -> Any:
        """Memory at the beginning of a record."""
        return None

    def drawn(self, rng: np.random.Generator) -> Control:
        """Law with numbers drawn from their uncertainty; itself where they are exact."""
        return self

    def disturbance(self, n_times: int, rng: np.random.Generator) -> np.ndarray:
        """What is added to the input besides the law, drawn ``(n_times,)``."""
        return np.zeros(n_times)

    def report(self) -> str:
        """The law in words; empty where there are none."""
        return ""


DEGREE = math.degrees(1.0)


@dataclass(frozen=True, eq=False)
class CourseEvidence:
    """What a record says of a course law.

    Attributes
    ----------
    names : tuple of str
        ``gain``, ``damping``, ``course 0``, ... (``neutral`` where the courses were given),
        ``rate``, ``limit``.
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
class CourseControl(Control):
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

    def order(self, memory: None, seen: Mapping[str, float]) -> tuple[float, None]:
        """See :class:`Control`."""
        past = [new for begin, new in self.changes if seen["time"] >= begin]
        error = (past or [self.course])[-1] - seen[self.heading]
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
        times, kept = zip((0.0, self.course), *self.changes, strict=True)
        courses = [value[name] for name in names if name.startswith("course")] or kept
        return replace(
            self, gain=value["gain"], damping=value["damping"], rate=abs(value["rate"]),
            limit=abs(value["limit"]), neutral=value.get("neutral", self.neutral),
            course=courses[0], changes=tuple(zip(times[1:], courses[1:], strict=True)),
        )  # fmt: skip

    def document(self) -> Report:
        """Return the law with standard errors, and what it explains, as a table."""
        known = self.evidence.std_errors if self.evidence else {}
        facts = [("gain", "gain", self.gain, 1.0), ("damping [s]", "damping", self.damping, 1.0)]
        for i, (time, course) in enumerate([(0.0, self.course), *self.changes]):
            since = f" from {time:.4g} s" if time else ""
            facts.append((f"course{since} [deg]", f"course {i}", course, DEGREE))
        if self.neutral or "neutral" in known:
            facts.append(("neutral [deg]", "neutral", self.neutral, DEGREE))
        facts.append(("rate [deg/s]", "rate", self.rate, DEGREE))
        facts.append(("limit [deg]", "limit", self.limit, DEGREE))
        rows = []
        for title, name, value, unit in facts:
            error = unit * known.get(name, 0.0)
            if math.isfinite(value):
                said = digits(error, 2) if error > 0 else ""
                rows.append((title, rounded(unit * value, error), said))
        explained = []
        if self.evidence:
            explained.append(
                f"explains {share(self.evidence.explained)} of the rudder's variance, rms "
                f"{DEGREE * self.evidence.rms:.2g} deg left"
            )
        section = Section("Law", explained, (Table(("", "value", "std error"), rows),), indent=2)
        return Report(f"course law of {self.input}", sections=(section,))

    report = as_text

    @classmethod
    def of(
        cls,
        record: Record,
        input: str,
        *,
        heading: str = "psi",
        yaw_rate: str = "r",
        courses: ArrayLike | str | None = None,
        most_changes: int = 8,
    ) -> CourseControl:
        """Identify the law from a record; equations in :mod:`problems.kvlcc2.helmsman`.

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
        followed, sees_noise, explained = fit_course_law(
            record, input, heading=heading, yaw_rate=yaw_rate, courses=series,
            most_changes=most_changes,
        )  # fmt: skip
        left = followed.residuals
        values = np.array([*followed.law, followed.rate, followed.limit])
        slope = np.eye(len(values))
        names = ["neutral"]
        changed = np.array(followed.changes, dtype=int)
        held = np.zeros(1 + len(changed))
        if series is None:
            # Of a level of the rudder and its changes: the courses at which it is zero.
            names = [f"course {i}" for i in range(len(held))]
            levels, gain = slice(2, 2 + len(held)), values[0]
            values[levels] = np.cumsum(values[levels]) / gain
            slope[levels, levels] = np.tril(np.ones((len(held), len(held)))) / gain
            slope[levels, 0] = -values[levels] / gain
        else:
            changed = np.flatnonzero(np.diff(series)) + 1
            held = series[[0, *changed]]
        evidence = CourseEvidence(
            ("gain", "damping", *names, "rate", "limit"), values,
            slope @ followed.covariance @ slope.T, explained,
            float(np.sqrt(np.mean(left**2))), correlation(left),
        )  # fmt: skip
        times = record.times - record.times[0]
        # A change lies between two samples.
        between = [float((times[k] + times[k - 1]) / 2) for k in changed]
        law = cls(
            input, 0.0, 0.0, float(held[0]), heading=heading, yaw_rate=yaw_rate,
            changes=tuple(zip(between, map(float, held[1:]), strict=True)),
            noise_share=float(sees_noise), evidence=evidence,
        )  # fmt: skip
        return law._with(values)


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
class ZigzagControl(Control):
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
        """See :class:`Control`."""
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
        if (known := self.evidence) is None:
            return self
        orders = self.orders + np.nan_to_num(known.orders) * rng.standard_normal(len(self.orders))
        moved = rng.standard_normal(len(self.reversals))
        headings = self.reversals + known.from_draw_to_draw * moved
        rate = self.rate + known.rate * rng.standard_normal()
        execute = self.execute + known.execute * rng.standard_normal()
        return replace(
            self, orders=tuple(map(float, orders)), reversals=tuple(map(float, headings)),
            rate=float(max(rate, 0.1 * self.rate)), execute=float(max(execute, 0.0)),
        )  # fmt: skip

    def document(self) -> Report:
        """Return orders, headings of reversal and rate with standard errors as a table."""
        known, n = self.evidence, len(self.orders)
        orders = [f"{DEGREE * order:.2f}" for order in self.orders]
        until = [*(f"{DEGREE * heading:.2f}" for heading in self.reversals), ""]
        errors = [[""] * n, [""] * n]
        if known is not None:
            errors = [[_error(one) for one in part] for part in (known.orders, known.reversals)]
        legs = map(str, range(1, n + 1))
        rows = list(zip(legs, orders, errors[0], until, [*errors[1], ""], strict=False))
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
        noise = fast_level([rudder])
        legs = rudder_legs(times, rudder, noise=noise)
        executes, unsure = legs.begins, noise / legs.rate
        begun = bool(executes[0] > times[0])
        step = float(np.median(np.diff(times)))
        smooth = smooth_heading(record, input, heading=heading, yaw_rate=yaw_rate)
        # Orders that were given at samples all begin at the same phase of a step.
        phases = np.exp(2j * np.pi * (executes - times[0]) / step)
        free = float(phases.mean().real <= AT_SAMPLES)
        half = step / math.sqrt(12)
        psi, error, r = np.array([smooth.at(time + step / 2) for time in executes[1:]]).T
        own = np.hypot(error, free * r * unsure)
        spread = np.hypot(own, np.abs(r) * half)
        return cls(
            input, tuple(map(float, legs.orders)), tuple(map(float, psi)),
            tuple(map(float, np.copysign(1.0, r))), legs.rate,
            legs.before, begun * float(max(executes[0] + step / 2 - times[0], 0.0)), heading, 0.0,
            ZigzagEvidence(
                legs.errors, spread, spread if free else own, legs.rate_error,
                begun * free * math.hypot(half, unsure),
            ),
        )  # fmt: skip


def _error(value: float) -> str:
    """Standard error in degrees."""
    return "" if math.isnan(value) else f"{max(DEGREE * value, 0.0):.2f}"


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A record predicted with the law in the loop, and with the logged input.

    Attributes
    ----------
    record : Record
        What was measured.
    outputs, open_loop : ndarray (n_times, n_outputs)
        Predicted in the loop, and with the logged input.
    inputs : ndarray (n_times,)
        The input that the law gave.
    std : ndarray (n_times, n_outputs)
        Standard deviation of the draws, sensor noise included.
    lower, upper : ndarray (n_times, n_outputs)
        95 % band of the draws; NaN without draws.
    failed : int
        Draws that diverged.
    caveat : str
        What to mind about the band; empty where nothing says so.
    law : str
        The law with its standard errors.
    """

    record: Record
    outputs: np.ndarray = field(repr=False)
    open_loop: np.ndarray = field(repr=False)
    inputs: np.ndarray = field(repr=False)
    std: np.ndarray = field(repr=False)
    lower: np.ndarray = field(repr=False)
    upper: np.ndarray = field(repr=False)
    failed: int = 0
    caveat: str = ""
    law: str = ""

    def rms(self, *, open_loop: bool = False) -> dict[str, float]:
        """Rms error of each output."""
        errors = self.record.residuals(self.open_loop if open_loop else self.outputs)
        size = np.sqrt(np.nanmean(errors**2, axis=0))
        return dict(zip(self.record.channels.output_names, map(float, size), strict=True))

    def coverage(self) -> dict[str, float]:
        """Share of the measurements within the 95 % band, by output."""
        inside = (self.record.outputs >= self.lower) & (self.record.outputs <= self.upper)
        seen = np.isfinite(self.record.outputs) & np.isfinite(self.lower)
        share = [float(inside[s, i].mean()) if s.any() else math.nan for i, s in enumerate(seen.T)]
        return dict(zip(self.record.channels.output_names, share, strict=True))

    def document(self) -> Report:
        """Return errors in and out of the loop as a table."""
        closed, opened, held = self.rms(), self.rms(open_loop=True), self.coverage()
        rows = []
        for output in self.record.channels.outputs:
            name, (factor, unit) = output.name, shown_unit(output.unit)
            errors = (f"{factor * one[name]:.3g}" for one in (closed, opened))
            inside = "" if math.isnan(held[name]) else share(held[name])
            rows.append((f"{name} [{unit}]", *errors, inside))
        headers = ("output", "in the loop", "logged input", "95 % band holds")
        mind = (self.caveat,) if self.caveat else ()
        errors_of = Section("Errors", mind, (Table(headers, rows),), indent=2)
        law = Section("Law", listing=self.law)
        return Report(f"replay of {self.record.name}, rms error", sections=(errors_of, law))

    report = as_text


def closed_loop(
    fit_or_model: Fit | Model,
    record: Record,
    control: Control,
    *,
    n_draws: int = 100,
    rng: np.random.Generator | None = None,
) -> ClosedLoop:
    """Predict a record whose rudder was a helmsman's, with the law in the loop.

    Parameters
    ----------
    fit_or_model : Fit or Model
        A fit gives a band.
    record : Record
        Its inputs but the law's are replayed; the start is its first sample.
    control : Control
        Such as :class:`CourseControl`, given or by ``CourseControl.of(record, ...)``.
    n_draws : int
        Parameter sets drawn from the fit.
    rng : numpy.random.Generator, optional
        Source of the draws; by default one with a fixed seed.

    Raises
    ------
    ModelError
        If the model has no such input.
    """
    fit, model = asked(fit_or_model)
    located(ModelError, f"Model {model.name!r} has no input", [control.input], model.input_names)
    rng = rng or np.random.default_rng(0)
    sigma = np.zeros(len(model.outputs)) if fit is None else fit.sigma
    held = model.fix(*model.free_names)
    table = parameter_sets(fit, model, n_draws, rng)
    quiet = np.zeros(len(sigma))
    outputs, inputs = _run(held, record, control, table[0], quiet, rng)
    opened = _run(held, record, None, table[0], quiet, rng)[0]
    runs = np.array(
        [_run(held, record, control.drawn(rng), values, sigma, rng)[0] for values in table[1:]]
    ).reshape(-1, *outputs.shape)
    drawn = runs[np.isfinite(runs).all(axis=(1, 2))]
    std = lower = upper = np.full(outputs.shape, np.nan)
    caveat = "" if fit is None else fit.caveat
    if len(drawn) > 1:
        noisy = drawn + sigma * rng.standard_normal(drawn.shape)
        std = np.sqrt(drawn.var(axis=0) + sigma**2)
        # The quantiles of few draws are those of a next one: i / (n + 1).
        lower, upper = np.quantile(noisy, [0.025, 0.975], axis=0, method="weibull")
        caveat = f"{caveat} {_lost(record, drawn, control.heading)}".strip()
    failed, said = len(runs) - len(drawn), control.report()
    return ClosedLoop(record, outputs, opened, inputs, std, lower, upper, failed, caveat, said)


def _lost(record: Record, drawn: np.ndarray, heading: str) -> str:
    """Say from when on the draws no longer agree on the heading."""
    if heading not in record.channels.output_names:
        return ""
    column = record.channels.output_names.index(heading)
    amplitude = np.nanstd(record.outputs[:, column])
    if not (beyond := np.flatnonzero(drawn[:, :, column].std(axis=0) > LOST * amplitude)).size:
        return ""
    return (
        f"From {record.times[beyond[0]] - record.times[0]:.4g} s on the draws differ by more than "
        f"half of the amplitude of {heading}: small errors in the times of the rudder grow in the "
        "loop, and the band says little there. Judge the part before, or the replay of the logged "
        "input."
    )


def _run(
    model: Model,
    record: Record,
    control: Control | None,
    values: np.ndarray,
    sigma: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs and the law's input, sample by sample; the logged input where there is no law.

    The law sees outputs with noise of ``sigma``, and so does the start.
    """
    compiled = kernel(model)
    own = np.zeros(compiled.n_own)
    columns = measured_columns(model)
    for position, series in measured_states(model, record).items():
        own[position] = series[0] + sigma[columns[position]] * rng.standard_normal()
    times, inputs = record.times, record.inputs.copy()
    state, _ = compiled.start(own, inputs[0], values, times[0])
    if control is None:
        run = compiled.run(times, inputs, values, state)
        return run.outputs, np.full(len(times), np.nan)
    column = model.input_names.index(control.input)
    names = model.output_names
    outputs = np.full((len(times), len(names)), np.nan)
    memory, last = control.start(), inputs[0, column]
    noisy = sigma * control.noise_share
    loose = control.disturbance(len(times), rng) if sigma.any() else np.zeros(len(times))
    seen = compiled.run(times[:2], inputs[:2], values, state).outputs[0]
    for k in range(len(times) - 1):
        outputs[k] = seen
        sensed = seen + noisy * rng.standard_normal(len(sigma))
        known = dict(zip(names, map(float, sensed), strict=True)) | {"time": times[k] - times[0]}
        wanted, memory = control.order(memory, known)
        if k:  # the first is what the log begins with
            reach = control.rate * (times[k] - times[k - 1])
            last = float(np.clip(wanted, last - reach, last + reach))
        # What is asked for at a sample acts until the next.
        inputs[k : k + 2, column] = last + loose[k]
        run = compiled.run(times[k : k + 2], inputs[k : k + 2], values, state)
        if not np.isfinite(run.outputs).all():
            return outputs, inputs[:, column]
        state, seen = run.states[1], run.outputs[1]
    outputs[-1] = seen
    return outputs, inputs[:, column]
