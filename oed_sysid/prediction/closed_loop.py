r"""Replay with the helmsman in the loop: the rudder answers the predicted ship, not the logged one.

A logged rudder of a helmsman or an autopilot answers the motion that was logged. Replayed open
loop on a model that differs a little, it steers another ship: errors of heading integrate, and
for a course-unstable vessel they grow. In the loop the law is replayed instead,

.. math::
    \delta_k = \delta_0 + K_p (\psi_\mathrm{ref} - \hat\psi_k) - K_d \hat r_k
    \qquad\text{or}\qquad
    \delta_k = \pm\delta_a \text{ reversed where } |\hat\psi_k - \psi_0| \text{ passes } \psi_s ,

at a limited rate, with the model's own :math:`\hat\psi, \hat r`. The law is given, or read from
the record (:mod:`oed_sysid.prediction.laws`). Bands are those of draws from the fit, each in its
own loop with a law drawn from its own uncertainty, in which the law sees noisy sensors, the rudder
has the noise that the law did not explain, and the start is as uncertain as its measurement.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.record import Record
from oed_sysid.errors import ModelError, located
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.start_guess import measured_columns, measured_states
from oed_sysid.physics.model import Model
from oed_sysid.prediction.draws import asked, parameter_sets
from oed_sysid.prediction.laws import CourseControl, ZigzagControl
from oed_sysid.runtime.display import Report, Section, Table, as_text, share
from oed_sysid.text.units import shown_unit

__all__ = ["ClosedLoop", "Control", "CourseControl", "UncertainControl", "ZigzagControl"]
__all__ += ["closed_loop"]

# Share of a signal's amplitude from which on the draws' spread says that its phase is lost.
LOST = 0.5


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


@runtime_checkable
class UncertainControl(Control, Protocol):
    """A law whose numbers are known to some accuracy only."""

    def drawn(self, rng: np.random.Generator) -> Control:
        """Law with numbers drawn from their uncertainty."""


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
        [_run(held, record, _drawn(control, rng), values, sigma, rng)[0] for values in table[1:]]
    ).reshape(-1, *outputs.shape)
    drawn = runs[np.isfinite(runs).all(axis=(1, 2))]
    std = lower = upper = np.full(outputs.shape, np.nan)
    caveat = "" if fit is None else fit.caveat
    if len(drawn) > 1:
        noisy = drawn + sigma * rng.standard_normal(drawn.shape)
        std = np.sqrt(drawn.var(axis=0) + sigma**2)
        # The quantiles of few draws are those of a next one: i / (n + 1).
        lower, upper = np.quantile(noisy, [0.025, 0.975], axis=0, method="weibull")
        caveat = f"{caveat} {_lost(record, drawn, getattr(control, 'heading', ''))}".strip()
    said = control.report() if hasattr(control, "report") else ""
    failed = len(runs) - len(drawn)
    return ClosedLoop(record, outputs, opened, inputs, std, lower, upper, failed, caveat, said)


def _drawn(control: Control, rng: np.random.Generator) -> Control:
    """The law, its numbers drawn where they are uncertain."""
    return control.drawn(rng) if isinstance(control, UncertainControl) else control


def _lost(record: Record, drawn: np.ndarray, heading: str) -> str:
    """Say from when on the draws no longer agree on the heading."""
    if heading not in record.channels.output_names:
        return ""
    column = record.channels.output_names.index(heading)
    amplitude = np.nanstd(record.outputs[:, column])
    beyond = np.flatnonzero(drawn[:, :, column].std(axis=0) > LOST * amplitude)
    if not beyond.size:
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
    noisy = sigma * getattr(control, "noise_share", 1.0)
    loose = np.zeros(len(times))
    if sigma.any() and isinstance(control, CourseControl):
        loose = control.disturbance(len(times), rng)
    first = compiled.run(times[:2], inputs[:2], values, state)
    seen = first.outputs[0]
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
