r"""Replay with the helmsman in the loop: the rudder answers the predicted ship, not the logged one.

A logged rudder of a helmsman or an autopilot answers the motion that was logged. Replayed open
loop on a model that differs a little, it steers another ship: errors of heading integrate, and
for a course-unstable vessel they grow. In the loop the law is replayed instead,

.. math::
    \delta_k = \delta_0 + K_p (\psi_\mathrm{ref} - \hat\psi_k) - K_d \hat r_k
    \qquad\text{or}\qquad
    \delta_k = \pm\delta_a \text{ reversed where } |\hat\psi_k - \psi_0| \text{ passes } \psi_s ,

at a limited rate, with the model's own :math:`\hat\psi, \hat r`. The law is given, or taken from
the record: the gains by least squares of the logged rudder, a zigzag's angles and headings of
reversal from the log. Bands are those of draws from the fit, each in its own loop, in which the
law sees noisy sensors and the start is as uncertain as its measurement.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.record import Record
from oed_sysid.errors import DataError, ModelError
from oed_sysid.fitting.fit import Fit, align
from oed_sysid.fitting.start_guess import measured_columns, measured_states
from oed_sysid.model import Model
from oed_sysid.predictions.draws import draw

# Share of the largest order from which on a rudder counts as put over.
OVER = 0.5
# A law that leaves this share of the rudder's variance unexplained is no law of the record.
UNEXPLAINED = 0.5
# Share of its largest angle or rate from which on a rudder counts as limited.
AT_LIMIT = 0.95
LEAST_SAMPLES = 20


class Control(Protocol):
    """A law that gives one input from what is measured."""

    @property
    def input(self) -> str:
        """The input that it gives."""

    def start(self) -> Any:
        """Memory at the beginning of a record."""

    def order(self, memory: Any, seen: Mapping[str, float]) -> tuple[float, Any]:
        """Input that is asked for and the new memory, from outputs by name."""

    @property
    def rate(self) -> float:
        """Largest change of the input per second."""


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

    def start(self) -> None:
        """It has no memory."""

    def order(self, memory: None, seen: Mapping[str, float]) -> tuple[float, None]:
        """See :class:`Control`."""
        error = self.course - seen[self.heading]
        wanted = self.neutral + self.gain * error - self.damping * seen[self.yaw_rate]
        return float(np.clip(wanted, -self.limit, self.limit)), memory

    @classmethod
    def of(
        cls, record: Record, input: str, *, heading: str = "psi", yaw_rate: str = "r"
    ) -> CourseControl:
        """Identify the law from a record, by least squares of its rudder.

        Noise of heading and yaw rate pulls the gains towards zero where the course is held well:
        take a part of the record in which it is changed.

        Raises
        ------
        DataError
            If heading and yaw rate explain less than half of the rudder's variance.

        Examples
        --------
        >>> from oed_sysid.channels import Channels, Input, Output
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
        rudder, psi, rate = record.input(input), record.output(heading), record.output(yaw_rate)
        steps = np.abs(np.diff(rudder)) / np.diff(record.times)
        # At a limit of angle or rate the rudder says nothing of the law.
        limited = np.abs(rudder) > AT_LIMIT * np.abs(rudder).max()
        limited[1:] |= steps > AT_LIMIT * steps.max()
        limited[0] = True  # what came before is not known
        seen = np.isfinite(psi) & np.isfinite(rate) & ~limited
        if seen.sum() < LEAST_SAMPLES:
            raise DataError(
                f"Only {seen.sum()} samples of record {record.name!r} have heading, yaw rate and a "
                f"rudder off its limits; {LEAST_SAMPLES} are needed. Give the law."
            )
        table = np.column_stack([np.ones(seen.sum()), -psi[seen], -rate[seen]])
        (level, gain, damping), *_ = np.linalg.lstsq(table, rudder[seen], rcond=None)
        left = rudder[seen] - table @ [level, gain, damping]
        whole = np.var(rudder[seen])
        if np.var(left) > UNEXPLAINED * whole:
            share = 100 * (1 - np.var(left) / max(whole, 1e-300))
            raise DataError(
                f"Heading and yaw rate explain {share:.0f} % of the variance of {input!r} in "
                f"record {record.name!r}: no helmsman held a course there. Give the law, or "
                "replay the logged input."
            )
        # The course that is held on the mean; the neutral rudder goes with it.
        course = float(np.mean(psi[seen]))
        return cls(
            input,
            float(gain),
            float(damping),
            course,
            float(level - gain * course),
            float(np.abs(rudder).max()),
            float(steps.max()),
            heading,
            yaw_rate,
        )


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
    """

    input: str
    orders: tuple[float, ...]
    reversals: tuple[float, ...]
    towards: tuple[float, ...]
    rate: float
    before: float = 0.0
    execute: float = 0.0
    heading: str = "psi"

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

    @classmethod
    def of(cls, record: Record, input: str, *, heading: str = "psi") -> ZigzagControl:
        """Read the orders and the headings of reversal from a record.

        Raises
        ------
        DataError
            If the rudder is not reversed at least once.
        """
        rudder, psi = record.input(input), record.output(heading)
        angle = float(np.abs(rudder).max())
        side = np.where(np.abs(rudder) > OVER * angle, np.sign(rudder), 0.0)
        put = [(k, s) for k, s in enumerate(side) if s]
        legs = [put[0]] if put else []
        for k, s in put:
            if s != legs[-1][1]:
                legs.append((k, s))
        if len(legs) < 2:
            raise DataError(
                f"The rudder of record {record.name!r} is never reversed: it is no zigzag. Use "
                "CourseControl, or replay the logged input."
            )
        times = record.times
        slopes = np.abs(np.diff(rudder)) / np.diff(times)
        rate = float(np.quantile(slopes[slopes > 0.5 * slopes.max()], 0.5))
        orders, reversals, towards = [], [], []
        starts = []
        for number, (k, s) in enumerate(legs):
            stop = legs[number + 1][0] if number + 1 < len(legs) else len(rudder)
            orders.append(float(s * np.median(np.abs(rudder[k:stop]))))
            # The rudder began to move before it was half over.
            previous = orders[number - 1] if number else float(rudder[0])
            back = abs(OVER * angle * s - previous) / rate
            starts.append(times[k] - back)
        for begin, (_, s) in zip(starts[1:], legs[1:], strict=True):
            reversals.append(float(np.interp(begin, times, psi)))
            towards.append(float(np.sign(np.interp(begin, times, np.gradient(psi, times)))) or s)
        return cls(
            input,
            tuple(orders),
            tuple(reversals),
            tuple(towards),
            rate,
            float(rudder[0]),
            float(max(starts[0] - times[0], 0.0)),
            heading,
        )


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
        Draws that left the numbers.
    caveat : str
        Why the band is too narrow; empty where nothing says so.
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

    def rms(self, *, open_loop: bool = False) -> dict[str, float]:
        """Rms error of each output."""
        errors = self.record.residuals(self.open_loop if open_loop else self.outputs)
        names = self.record.channels.output_names
        size = np.sqrt(np.nanmean(errors**2, axis=0))
        return dict(zip(names, map(float, size), strict=True))

    def coverage(self) -> dict[str, float]:
        """Share of the measurements within the 95 % band, by output."""
        inside = (self.record.outputs >= self.lower) & (self.record.outputs <= self.upper)
        seen = np.isfinite(self.record.outputs) & np.isfinite(self.lower)
        names = self.record.channels.output_names
        share = [float(inside[s, i].mean()) if s.any() else math.nan for i, s in enumerate(seen.T)]
        return dict(zip(names, share, strict=True))

    def report(self) -> str:
        """Return errors in and out of the loop as a table."""
        closed, opened, held = self.rms(), self.rms(open_loop=True), self.coverage()
        rows = [("output", "in the loop", "logged input", "95 % band holds")]
        for output in self.record.channels.outputs:
            name = output.name
            factor, unit = (
                (math.degrees(1.0), output.unit.replace("rad", "deg"))
                if output.unit in ("rad", "rad/s")
                else (1.0, output.unit)
            )
            rows.append(
                (
                    f"{name} [{unit}]",
                    f"{factor * closed[name]:.3g}",
                    f"{factor * opened[name]:.3g}",
                    "" if math.isnan(held[name]) else f"{100 * held[name]:.0f} %",
                )
            )
        lines = [f"replay of {self.record.name}, rms error", *(f"  {line}" for line in align(rows))]
        lines += [f"  {self.caveat}"] if self.caveat else []
        return "\n".join(lines)


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
    fit = fit_or_model if isinstance(fit_or_model, Fit) else None
    model = fit_or_model.model if isinstance(fit_or_model, Fit) else fit_or_model
    if control.input not in model.input_names:
        raise ModelError(
            f"The law gives {control.input!r}; model {model.name!r} has the inputs "
            f"{', '.join(model.input_names)}."
        )
    rng = rng or np.random.default_rng(0)
    sigma = np.zeros(len(model.outputs)) if fit is None else fit.sigma
    held = model.fix(*model.free_names)
    table = [held.value_vector]
    if fit is not None and n_draws > 0:
        table += list(draw(fit, n_draws, rng))
    runs = [_run(held, record, control, table[0], np.zeros(len(sigma)), rng)]
    runs += [_run(held, record, control, values, sigma, rng) for values in table[1:]]
    outputs, inputs = runs[0]
    opened = _run(held, record, None, table[0], np.zeros(len(sigma)), rng)[0]
    drawn = np.array([one for one, _ in runs[1:] if np.isfinite(one).all()])
    nothing = np.full(outputs.shape, np.nan)
    std, lower, upper = nothing, nothing, nothing
    if len(drawn) > 1:
        noisy = drawn + sigma * rng.standard_normal(drawn.shape)
        std = np.sqrt(drawn.var(axis=0) + sigma**2)
        lower, upper = np.quantile(noisy, [0.025, 0.975], axis=0)
    failed = len(runs) - 1 - len(drawn)
    caveat = fit_or_model.caveat if isinstance(fit_or_model, Fit) else ""
    return ClosedLoop(record, outputs, opened, inputs, std, lower, upper, failed, caveat)


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
    first = compiled.run(times[:2], inputs[:2], values, state)
    seen = first.outputs[0]
    for k in range(len(times) - 1):
        outputs[k] = seen
        noisy = seen + sigma * rng.standard_normal(len(sigma))
        known = dict(zip(names, map(float, noisy), strict=True)) | {"time": times[k] - times[0]}
        wanted, memory = control.order(memory, known)
        if k:  # the first is what the log begins with
            reach = control.rate * (times[k] - times[k - 1])
            last = float(np.clip(wanted, last - reach, last + reach))
        # What is asked for at a sample acts until the next.
        inputs[k : k + 2, column] = last
        run = compiled.run(times[k : k + 2], inputs[k : k + 2], values, state)
        if not np.isfinite(run.outputs).all():
            return outputs, inputs[:, column]
        state, seen = run.states[1], run.outputs[1]
    outputs[-1] = seen
    return outputs, inputs[:, column]
