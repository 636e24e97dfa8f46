r"""The sea-trial card: one page for the people on board.

Accuracy is stated as :math:`s_i / |\theta_i|` from the bound :math:`s_i = \sqrt{[F^{-1}]_{ii}}`
after the run; "times smaller than a zigzag's" is the ratio of the geometric means

.. math:: \exp \frac1n \sum_i \log \frac{s_i^{zigzag}}{s_i}

Orders merge a ramp within the actuator's rate into one line. Probabilities of limits and abort
rules come from :mod:`oed_sysid.design.assurance`.
"""

from __future__ import annotations

from textwrap import wrap
from typing import Protocol

import numpy as np

from oed_sysid.design.accuracy import TRUSTED
from oed_sysid.design.assurance import Assurance
from oed_sysid.design.quantities import quantity, span, units_of
from oed_sysid.design.reference import Reference
from oed_sysid.design.reveal import Chance, missing_physics
from oed_sysid.display import Table
from oed_sysid.experiment import Experiment
from oed_sysid.model import Model
from oed_sysid.noise.model import NoiseModel
from oed_sysid.sensitivity.sea import sea_words
from oed_sysid.simulation import Trajectory

_MOST_ORDERS = 40
_WIDTH = 92
# Relative errors up to which a coefficient counts as found, and as seen at all.
_GOOD, _USABLE = 0.05, 0.5


class Planned(Protocol):
    """What the card is written from: a :class:`~oed_sysid.design.result.Design`."""

    @property
    def experiment(self) -> Experiment:
        """The run."""

    @property
    def model(self) -> Model:
        """The nominal vehicle."""

    @property
    def trajectory(self) -> Trajectory:
        """What it is expected to do."""

    @property
    def active(self) -> tuple[str, ...]:
        """Limits that are reached, in words."""

    @property
    def assurance(self) -> Assurance | None:
        """How surely limits are kept."""

    @property
    def sea(self) -> NoiseModel | None:
        """Random forces and coloured sensors, if any."""

    @property
    def misfits(self) -> dict[tuple[str, str], float]:
        """Expected misfit of each rival."""

    @property
    def chances(self) -> tuple[Chance, ...]:
        """How surely each candidate effect would show."""

    @property
    def references(self) -> tuple[Reference, ...]:
        """Standard manoeuvres beside it."""

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters."""

    @property
    def relative_errors(self) -> np.ndarray:
        """Expected standard errors as shares of the values."""

    def gain(self, reference: Reference) -> tuple[float, float]:
        """How much larger a reference's errors are."""

    def accuracy(self, *, sort: bool = False) -> Table:
        """A row about every parameter."""


def sea_trial_card(design: Planned) -> str:
    """Return what to run, for how long, what to watch and what to expect.

    Parameters
    ----------
    design : Design
        The designed experiment.
    """
    experiment, model = design.experiment, design.model
    units = units_of(model)
    duration = float(experiment.duration or 0.0)
    lines = [
        *_danger(design),
        f"SEA TRIAL CARD   {experiment.name}   ({model.name})",
        "=" * _WIDTH,
        f"Length      {duration:g} s ({duration / 60:.1f} min), one run; log every "
        f"{experiment.sample_time:g} s or faster, commands and measurements on one clock",
        f"Start from  {_start(design, units)}; controls neutral, steady",
        "            log 10 s or more before the first order and after the last",
    ]
    if experiment.constants:
        held = ", ".join(f"{n} = {quantity(v, units[n])}" for n, v in experiment.constants.items())
        lines.append(f"Hold        {held}")
    for name, pair in experiment.limits.inputs.items():
        if name not in experiment.constants:
            rate = experiment.limits.rates.get(name)
            most = "" if rate is None else f", at most {quantity(rate, units[name])}/s"
            lines.append(f"Orders of   {name}: {span(*pair, units[name])}{most}")
    lines += ["", "RUN"]
    if experiment.reacts and experiment.excitation is not None:
        lines.append(f"  {experiment.excitation.describe()}")
    else:
        lines += _orders(model, design.trajectory, units)
    lines += ["", *_motion(design, units), "", "WATCH", *_watch(design)]
    lines += ["", *_accuracy(design), ""]
    if told := missing_physics(design.misfits, design.chances):
        lines += ["MISSING PHYSICS", *told, ""]
    lines += _noise(model, design.sea)
    return "\n".join(lines)


def _danger(design: Planned) -> list[str]:
    """First lines where limits are likely to be left."""
    found = design.assurance
    if found is None or found.is_safe:
        return []
    return wrap(f"{found.danger} Read WATCH before anything else.", _WIDTH)


def _start(design: Planned, units: dict[str, str]) -> str:
    initial = design.experiment.initial
    given = [f"{n} = {quantity(v, units[n])}" for n, v in initial.items() if v]
    speeds = [s.name for s in design.model.states if s.name in ("u", "v", "w")]
    if speeds and not any(initial.get(n, 0.0) for n in speeds):
        given.insert(0, "rest (no speed)")
    return ", ".join(given) or "rest"


def _orders(model: Model, trajectory: Trajectory, units: dict[str, str]) -> list[str]:
    """Orders as rows: when each begins, where it leads, and when it is reached."""
    found = []
    for index, name in enumerate(model.input_names):
        steps = np.diff(trajectory.inputs[:, index])
        row = 0
        while row < len(steps):
            if steps[row] == 0:
                row += 1
                continue
            last = row
            # A ramp within the rate limit is one order, not one for every sample.
            while last + 1 < len(steps) and steps[last + 1] * steps[row] > 0:
                last += 1
            found.append((row + 1, last + 1, name, trajectory.inputs[last + 1, index]))
            row = last + 1
    if not found:
        return ["  no orders: leave all controls as they are"]
    found.sort()
    lines = [f"  {'at t [s]':>8}  {'order':<26} {'reached [s]':>11}"]
    for first, last, name, value in found[:_MOST_ORDERS]:
        order = f"{name} to {quantity(value, units[name])}"
        lines.append(
            f"  {trajectory.times[first]:>8.6g}  {order:<26} {trajectory.times[last]:>11.6g}"
        )
    if len(found) > _MOST_ORDERS:
        lines.append(f"  ... and {len(found) - _MOST_ORDERS} more")
    end = trajectory.times[-1]
    lines.append(f"  {end:>8.6g}  end of the run: controls neutral, recover")
    lines.append("  By hand: these orders. Better: play the table that --out writes.")
    return lines


def _motion(design: Planned, units: dict[str, str]) -> list[str]:
    """Predicted ranges, what other vehicles would do, and where to stop."""
    model, assurance = design.model, design.assurance
    head = f"  {'':<10} {'predicted':<24}"
    if assurance is not None:
        head += f" {'95 % of vehicles':<24}"
    lines = ["EXPECT", f"{head} stop outside"]
    for name in dict.fromkeys((*model.state_names, *model.output_names)):
        values = design.trajectory.signal(name)
        row = f"  {name:<10} {_between(values.min(), values.max(), units[name]):<24}"
        if assurance is not None:
            other = assurance.ranges.get(name)
            row += f" {'-' if other is None else _between(*other, units[name]):<24}"
        limit = design.experiment.limits.signals.get(name)
        lines.append(f"{row} {'' if limit is None else span(*limit, units[name])}".rstrip())
    if assurance is not None:
        lines.append(f"  95 % of vehicles: {assurance.drawn}, {assurance.n_checked} simulated")
    return lines


def _between(lower: float, upper: float, unit: str) -> str:
    return f"{quantity(lower, unit).split(' ')[0]} to {quantity(upper, unit)}"


def _watch(design: Planned) -> list[str]:
    limits = design.experiment.limits.signals
    words = []
    if not limits:
        words.append(
            "NO LIMIT on the motion was given. Compare the ranges above with what depth, attitude "
            "and sea room allow; in doubt design anew with limits (such as --max-pitch 20)."
        )
    if design.assurance is not None and limits:
        words.append(f"Certainty: {design.assurance.report()}.")
        if not design.assurance.is_safe:
            words.append(
                "That is NOT safe unless the coefficients are known better: stand by to stop, fly "
                "a gentler run first, or design with --certainty 0.95."
            )
    words += [f"reached in the prediction: {text}" for text in design.active]
    if not design.active:
        words.append("no limit is reached in the prediction")
    if limits:
        words.append(
            "Stop when a limit is passed: controls neutral, recover, keep the log. Part of a run "
            "is useful."
        )
    lines = [
        line
        for text in words
        for line in wrap(text, _WIDTH - 4, initial_indent="  - ", subsequent_indent="    ")
    ]
    return lines + abort_lines(design)


def abort_lines(design: Planned) -> list[str]:
    """When to stop, and how often that is to be expected."""
    found = design.assurance
    if found is None or not found.rules:
        return []
    units = units_of(design.model)
    lines = ["", "STOP THE RUN (controls neutral, recover) when"]
    for rule in found.rules:
        bounds = [
            f"{word} {quantity(bound, units[rule.signal])}"
            for word, bound in (("below", rule.lower), ("above", rule.upper))
            if np.isfinite(bound)
        ]
        why = "before its limit" if rule.limited else "outside what is expected"
        lines.append(
            f"  {rule.signal:<8} {' or '.join(bounds):<36} {why}; fires on {rule.fires:.1%}"
        )
    return [*lines, f"  Any of these fires on {found.any_fires:.1%} of {found.n_checked} vehicles."]


def _accuracy(design: Planned) -> list[str]:
    kind = "white noise" if design.sea is None else "noise and random forces"
    lines = [f"ACCURACY TO EXPECT (standard error / value; {kind} as below)"]
    for reference in design.references:
        mean, worst = design.gain(reference)
        note = f", {reference.note}" if reference.note else ""
        lines.append(
            f"  Against a {reference.name}{note}, equally long: errors {mean:.2g} times smaller on "
            f"geometric mean, {worst:.2g} times for the worst."
        )
    lines += [f"  {line}" for line in design.accuracy(sort=True).lines()]
    errors = dict(zip(design.names, design.relative_errors, strict=True))
    usable = _USABLE if design.sea is None else TRUSTED
    for title, low, high in (
        (f"Found to {_GOOD:.0%} or better", 0.0, _GOOD),
        (f"Found to {usable:.0%}", _GOOD, usable),
        ("NOT found by this run; hold at nominal values, or add runs", usable, np.inf),
    ):
        names = [n for n, error in errors.items() if low < error <= high]
        if names:
            text = f"{title}: {', '.join(names)}"
            lines += wrap(text, _WIDTH, initial_indent="  ", subsequent_indent="    ")
    return lines


def _noise(model: Model, sea: NoiseModel | None) -> list[str]:
    levels = ", ".join(
        f"{o.name} {quantity(o.noise_std, o.unit)}"
        for o in model.outputs
        if o.noise_std is not None
    )
    return [
        *wrap(f"Noise assumed: {levels}.", _WIDTH),
        *([] if sea is None else wrap(f"Random forces assumed: {sea_words(sea)}.", _WIDTH)),
        "Write down wind, sea, current, loading, battery, and anything touched during the run.",
    ]
