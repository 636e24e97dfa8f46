r"""The sea-trial card: one page for the people on board.

Accuracy is stated as :math:`s_i / |\theta_i|` from the bound :math:`s_i = \sqrt{[F^{-1}]_{ii}}`
after the run; "times smaller than a zigzag's" is the ratio of the geometric means

.. math:: \exp \frac1n \sum_i \log \frac{s_i^{zigzag}}{s_i}

Orders merge a ramp within the actuator's rate into one line. Probabilities of limits and abort
rules come from :mod:`oed_sysid.design.assurance`.

Commands of a run as files that autopilots take.

An override list holds servo pulses: a command :math:`c` between the ends of its servo is

.. math:: \mathrm{pwm} = p_- + (p_+ - p_-)\, \frac{c - c_-}{c_+ - c_-}

in microseconds, rounded. Angles between orders are held. Whoever plays it sends each line at its
time as MAVLink ``RC_CHANNELS_OVERRIDE`` and repeats it more often than the override's time-out
(``RC_OVERRIDE_TIME``, 3 s); the channel has to be passed through to the servo (ArduPilot's manual
mode). Failsafes and a hand on the mode switch stay with the crew: the file knows nothing of limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from oed_sysid.data.log import library
from oed_sysid.design.assurance import TRUSTED
from oed_sysid.design.limits import quantity, span, units_of
from oed_sysid.design.missing_effects import missing_physics
from oed_sysid.errors import DesignError, FileError
from oed_sysid.experiments.simulation import Trajectory
from oed_sysid.information.noise import sea_words
from oed_sysid.information.ranking import POOR
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model
from oed_sysid.runtime.files import make_folder
from oed_sysid.text.csv_table import write_table

WIDTH = 92
# Relative error up to which a coefficient counts as found.
_GOOD = 0.05


def sea_trial_card(design: Any) -> str:
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
        "=" * WIDTH,
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
            lines.append(f"Orders of   {name}: {span(pair[0], pair[1], units[name])}{most}")
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


def _danger(design: Any) -> list[str]:
    """First lines where limits are likely to be left."""
    found = design.assurance
    if found is None or found.is_safe:
        return []
    return wrap(f"{found.danger} Read WATCH before anything else.", WIDTH)


def _start(design: Any, units: dict[str, str]) -> str:
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
    for first, last, name, value in found[:40]:
        order = f"{name} to {quantity(value, units[name])}"
        lines.append(
            f"  {trajectory.times[first]:>8.6g}  {order:<26} {trajectory.times[last]:>11.6g}"
        )
    if len(found) > 40:
        lines.append(f"  ... and {len(found) - 40} more")
    end = trajectory.times[-1]
    lines.append(f"  {end:>8.6g}  end of the run: controls neutral, recover")
    lines.append("  By hand: these orders. Better: play the table that --out writes.")
    return lines


def _motion(design: Any, units: dict[str, str]) -> list[str]:
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
            row += f" {'-' if other is None else _between(other[0], other[1], units[name]):<24}"
        limit = design.experiment.limits.signals.get(name)
        lines.append(
            f"{row} {'' if limit is None else span(limit[0], limit[1], units[name])}".rstrip()
        )
    if assurance is not None:
        lines.append(f"  95 % of vehicles: {assurance.drawn}, {assurance.n_checked} simulated")
    return lines


def _between(lower: float, upper: float, unit: str) -> str:
    return f"{quantity(lower, unit).split(' ')[0]} to {quantity(upper, unit)}"


def _watch(design: Any) -> list[str]:
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
        for line in wrap(text, WIDTH - 4, initial_indent="  - ", subsequent_indent="    ")
    ]
    return lines + abort_lines(design)


def abort_lines(design: Any) -> list[str]:
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


def _accuracy(design: Any) -> list[str]:
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
    usable = POOR if design.sea is None else TRUSTED
    for title, low, high in (
        (f"Found to {_GOOD:.0%} or better", 0.0, _GOOD),
        (f"Found to {usable:.0%}", _GOOD, usable),
        ("NOT found by this run; hold at nominal values, or add runs", usable, np.inf),
    ):
        names = [n for n, error in errors.items() if low < error <= high]
        if names:
            text = f"{title}: {', '.join(names)}"
            lines += wrap(text, WIDTH, initial_indent="  ", subsequent_indent="    ")
    return lines


def _noise(model: Model, sea: NoiseModel | None) -> list[str]:
    levels = ", ".join(
        f"{o.name} {quantity(o.noise_std, o.unit)}"
        for o in model.outputs
        if o.noise_std is not None
    )
    return [
        *wrap(f"Noise assumed: {levels}.", WIDTH),
        *([] if sea is None else wrap(f"Random forces assumed: {sea_words(sea)}.", WIDTH)),
        "Write down wind, sea, current, loading, battery, and anything touched during the run.",
    ]


# Topics of a bag that holds commands.
TOPIC = "/commands"


@dataclass(frozen=True)
class Servo:
    """Calibration of one servo.

    Parameters
    ----------
    channel : int
        RC channel, 1 to 18.
    lower, upper : float
        Commands at the two ends, SI units.
    lowest, highest : int
        Pulses there, microseconds; the lower may be the longer one.
    """

    channel: int
    lower: float
    upper: float
    lowest: int = 1100
    highest: int = 1900

    def __post_init__(self) -> None:
        if not 1 <= self.channel <= 18:
            raise DesignError(f"The servo channel is {self.channel}. Give 1 to 18.")
        if not self.lower < self.upper:
            raise DesignError(
                f"The servo's ends are {self.lower} and {self.upper}. Lower has to be below upper."
            )
        if self.lowest == self.highest or min(self.lowest, self.highest) < 500 or (
            max(self.lowest, self.highest) > 2500
        ):  # fmt: skip
            raise DesignError(
                f"The servo's pulses are {self.lowest} and {self.highest} us. Give two different "
                "ones between 500 and 2500."
            )

    def pulses(self, commands: np.ndarray) -> np.ndarray:
        """Pulses of commands ``(n_times,)``, microseconds.

        Raises
        ------
        DesignError
            If a command is beyond the servo's ends.

        Examples
        --------
        >>> Servo(1, -0.4, 0.4).pulses(np.array([-0.4, 0.0, 0.2]))
        array([1100, 1500, 1700])
        """
        room = 1e-9 * (self.upper - self.lower)
        if commands.min() < self.lower - room or commands.max() > self.upper + room:
            raise DesignError(
                f"The commands reach from {commands.min():.4g} to {commands.max():.4g}, the servo "
                f"on channel {self.channel} from {self.lower:.4g} to {self.upper:.4g}. Correct its "
                "ends, or design with a smaller range."
            )
        share = (commands - self.lower) / (self.upper - self.lower)
        return np.rint(self.lowest + share * (self.highest - self.lowest)).astype(int)


def write_overrides(
    path: str | Path,
    model: Model,
    times: np.ndarray,
    inputs: np.ndarray,
    *,
    servos: Mapping[str, Servo],
) -> Path:
    """Write an override list: time in ms and one column of pulses for each servo.

    A row stands where a pulse changes, and at the end.

    Parameters
    ----------
    path : str or Path
    model : Model
        Names the inputs.
    times : ndarray (n_times,)
        s, from the start of the run.
    inputs : ndarray (n_times, n_inputs)
        SI units.
    servos : mapping of str to Servo
        By input; inputs without one are not written.

    Returns
    -------
    Path

    Raises
    ------
    DesignError
        If a servo belongs to no input, two share a channel, or none is given.
    """
    _check(model, servos)
    channels = [servo.channel for servo in servos.values()]
    if len(set(channels)) < len(channels) or not channels:
        raise DesignError("Give one servo or more, each on a channel of its own.")
    columns = [
        servo.pulses(inputs[:, model.input_names.index(name)]) for name, servo in servos.items()
    ]
    pulses = np.column_stack(columns)
    changed = np.concatenate([[True], np.any(np.diff(pulses, axis=0) != 0, axis=1)])
    changed[-1] = True
    table = np.column_stack([np.rint(1000.0 * (times - times[0])), pulses])[changed]
    names = ["time [ms]", *(f"chan{channel}_raw [us]" for channel in channels)]
    place = Path(path)
    write_table(place, names, table)
    return place


def write_bag(path: str | Path, model: Model, times: np.ndarray, inputs: np.ndarray) -> Path:
    """Write a ROS 2 bag with one topic of ``std_msgs/msg/Float64`` for each input.

    ``ros2 bag play`` sends the commands at their times, SI units, as ``/commands/NAME``.

    Parameters
    ----------
    path : str or Path
        Folder of the bag, which must not exist yet.
    model, times, inputs
        See :func:`write_overrides`.

    Returns
    -------
    Path

    Raises
    ------
    FileError
        If the folder exists.
    DataError
        If rosbags is not installed.
    """
    place = Path(path)
    if place.exists():
        raise FileError(f"{str(place)!r} exists already. Name a folder that does not.")
    rosbag2 = library("rosbags.rosbag2", "a ROS bag")
    typesys = library("rosbags.typesys", "a ROS bag")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    kind = "std_msgs/msg/Float64"
    message = store.types[kind]
    make_folder(place.parent)
    with rosbag2.Writer(place, version=8) as writer:
        links = [
            writer.add_connection(f"{TOPIC}/{name}", kind, typestore=store)
            for name in model.input_names
        ]
        for time, row in zip(times - times[0], inputs, strict=True):
            for link, value in zip(links, row, strict=True):
                content = store.serialize_cdr(message(float(value)), kind)
                writer.write(link, round(1e9 * float(time)), content)
    return place


def _check(model: Model, servos: Mapping[str, Servo]) -> None:
    for name in servos:
        if name not in model.input_names:
            raise DesignError(
                f"The servo {name!r} is no input of model {model.name!r}; it has "
                f"{', '.join(model.input_names)}."
            )
