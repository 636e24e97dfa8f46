r"""The controller of a run as a file: what flies it, not what it would have commanded.

A run that is closed over the vehicle reverses its order where

.. math:: \pm\left(y + T \dot y - y_0 - k\,(z - z_0)\right) \ge y_s

on the vehicle that is there. The table of the commands that the nominal vehicle would get is
another run on any other vehicle: it has its own probability of keeping the limits
(:func:`played`).

Every file holds the same law, with the plan as data: triggers, gains, limits of the commands, rules
at which the run is broken off, and the trim commands that follow. Names in the files are those
of the channels, which are identifiers; titles keep to a safe alphabet.

A MAVLink mission has no feedback. It serves runs without any whose orders are held: each is a
``DO_SET_SERVO``, the time to the next a ``NAV_DELAY``, and nothing in it ends the run early.

Commands of a run as files that autopilots take.

An override list holds servo pulses: a command :math:`c` between the ends of its servo is

.. math:: \mathrm{pwm} = p_- + (p_+ - p_-)\, \frac{c - c_-}{c_+ - c_-}

in microseconds, rounded. Angles between orders are held. Whoever plays it sends each line at its
time as MAVLink ``RC_CHANNELS_OVERRIDE`` and repeats it more often than the override's time-out
(``RC_OVERRIDE_TIME``, 3 s); the channel has to be passed through to the servo (ArduPilot's manual
mode). Failsafes and a hand on the mode switch stay with the crew: the file knows nothing of limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from math import degrees
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from oed_sysid.design.assurance import AbortRule
from oed_sysid.design.criteria import SAYS
from oed_sysid.design.library import as_piecewise
from oed_sysid.design.vehicles import outside, quantity, units_of
from oed_sysid.errors import DesignError, FileError, library, located
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.manoeuvres import Manoeuvre, ZigZag, ZigZagLike
from oed_sysid.experiments.simulation import trajectory_of
from oed_sysid.physics.model import Model
from oed_sysid.runtime.files import make_folder, write_text
from oed_sysid.runtime.version import __version__
from oed_sysid.text.csv_table import write_table
from oed_sysid.text.typeset import safe

# Kinds of files by their usual ending: pieces of text that follow one another.
KINDS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "ros2": (".py", ("law", "ros2")),
    "moos": (".py", ("law", "moos")),
    "ardupilot": (".lua", ("ardupilot",)),
    "mission": (".waypoints", ()),
    "words": (".txt", ()),
}
# Kinds that set servos.
BY_SERVO = ("ardupilot", "mission")
# Shortest time between two orders of a mission, s: an autopilot looks at its mission ten times a
# second or more, so that each order of a second is late by a tenth of its length at most.
SHORTEST_ORDER = 1.0
# MAVLink: frame of items without a place, home and its command, and the two commands of a run.
_FRAME, _WAYPOINT, _DELAY, _SET_SERVO = 2, 16, 93, 183
# What an autopilot knows of a vehicle without being told, after SNAME.
SEEN = ("x", "y", "z", "phi", "theta", "psi", "u", "v", "w", "p", "q", "r")


def played(model: Model, experiment: Experiment) -> Experiment:
    """The run as a table: what the nominal vehicle would be commanded, whatever vehicle it is.

    Parameters
    ----------
    model : Model
        The nominal vehicle.
    experiment : Experiment
        Any; one without feedback is returned as it is.

    Returns
    -------
    Experiment
        Without feedback.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading")
    >>> run = next(iter(ship.experiments.values()))
    >>> played(ship.model, run).name == run.name
    True
    """
    if not experiment.reacts:
        return experiment
    run = trajectory_of(model, experiment)
    columns = dict(zip(model.input_names, run.inputs.T, strict=True))
    moved = [one.input for one in experiment.manoeuvres]
    tables = (as_piecewise(name, run.times, columns[name]) for name in moved)
    return replace(experiment, manoeuvre=tuple(tables))


def write_controller(
    path: str | Path,
    model: Model,
    experiment: Experiment,
    kind: str,
    *,
    aborts: Sequence[AbortRule] | None = None,
    servos: Mapping[str, Servo] | None = None,
) -> Path:
    """Write what flies a run.

    Parameters
    ----------
    path : str or Path
        File to write.
    model : Model
        Names the channels.
    experiment : Experiment
        Zigzags, and whatever needs no feedback.
    kind : str
        ``"ardupilot"``, a Lua script; ``"ros2"``, a node that reads ``nav_msgs/Odometry``;
        ``"moos"``, an application of pymoos; ``"mission"``, a MAVLink mission (QGC WPL 110) of a
        run without feedback; ``"words"``, numbered rules for whoever programmes it.
    aborts : sequence of AbortRule, optional
        When the run is broken off, such as ``design.assurance.rules``; by default the limits of
        the experiment on the motion.
    servos : mapping of str to Servo, optional
        By input; ArduPilot's script and a mission need them.

    Returns
    -------
    Path

    Raises
    ------
    DesignError
        If the kind is unknown, the run has another feedback than zigzags, or a signal is not one
        that autopilots know.

    Examples
    --------
    >>> import tempfile
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading")
    >>> run = next(iter(ship.experiments.values()))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = write_controller(Path(folder) / "run.txt", ship.model, run, "words")
    ...     print(file.read_text().splitlines()[0])
    zigzag_15_15: 40 s, a decision every 0.01 s.
    """
    located(DesignError, "This package has no controller", [kind], KINDS)
    plan = plan_of(model, experiment, aborts)
    place = Path(path)
    if not KINDS[kind][1]:
        lines = words(model, plan) if kind == "words" else _mission(plan, servos or {})
        write_text(place, "\n".join(lines) + "\n")
        return place
    if unknown := [name for name in plan["signals"] if name not in SEEN]:
        raise DesignError(
            f"The run reacts to {', '.join(unknown)}, which autopilots do not know by that name; "
            f"known are {', '.join(SEEN)}. Name the signal so in the model, or write kind='words'."
        )
    marks = {"title": plan["name"], "source": f"written by oed_sysid {__version__}"}
    marks["written"] = repr(_moos_names(model, plan)) if kind == "moos" else ""
    marks["run"] = _lua(_with_servos(plan, servos or {})) if kind == "ardupilot" else repr(plan)
    folder = files("oed_sysid.design").joinpath("controller_files")
    parts = [folder.joinpath(f"{one}.txt").read_text(encoding="utf-8") for one in KINDS[kind][1]]
    write_text(place, Template("".join(parts)).substitute(marks))
    return place


def plan_of(
    model: Model, experiment: Experiment, aborts: Sequence[AbortRule] | None = None
) -> dict[str, Any]:
    """The run as plain data: channels, constants, rules at which it ends.

    Parameters
    ----------
    model : Model
        Names the channels.
    experiment : Experiment
        See :func:`write_controller`.
    aborts : sequence of AbortRule, optional
        See :func:`write_controller`.
    """
    experiment.check_model(model)
    channels = [_channel(one, experiment) for one in experiment.manoeuvres]
    ends = experiment.limits.signals.items()
    if aborts is not None:
        ends = {one.signal: (one.lower, one.upper) for one in aborts}.items()
    rules = []
    for name, pair in ends:
        # Bounds that every language can write.
        lower, upper = np.clip(pair, -1e30, 1e30).tolist()
        rules.append({"signal": name, "lower": lower, "upper": upper})
    signals = [name for one in channels for name in one.get("signals", ())]
    return {
        "name": safe(experiment.name),
        "duration": float(experiment.duration or 0.0),
        "period": float(experiment.sample_time),
        "signals": list(dict.fromkeys([*signals, *(rule["signal"] for rule in rules)])),
        "constants": dict(experiment.constants),
        "trim": {one["input"]: one["trim"] for one in channels},
        "channels": channels,
        "aborts": rules,
    }


def _channel(manoeuvre: Manoeuvre, experiment: Experiment) -> dict[str, Any]:
    """One input: what reverses it, or its table."""
    if isinstance(manoeuvre, ZigZag | ZigZagLike):
        amplitudes, switches, lead, keep_gain = manoeuvre.swings
        return {
            "input": manoeuvre.input, "kind": "zigzag", "signals": list(manoeuvre.feedback),
            "amplitudes": list(amplitudes), "switches": list(switches), "lead": lead,
            "keep_gain": keep_gain, "rate": manoeuvre.rate, "first": manoeuvre.first,
            "start": manoeuvre.start, "sign": manoeuvre.sign, "trim": manoeuvre.trim,
            "reference": manoeuvre.reference,
        }  # fmt: skip
    if manoeuvre.feedback:
        raise DesignError(
            f"The run {experiment.name!r} reacts as no zigzag does ({manoeuvre.describe()}). "
            "Write its table (design.played), or fly it by hand from kind='words'."
        )
    table = as_piecewise(manoeuvre.input, experiment.times, manoeuvre.commands(experiment.times))
    return {
        "input": manoeuvre.input, "kind": "table", "times": list(table.times),
        "values": list(table.values), "trim": float(table.values[0]),
    }  # fmt: skip


def _mission(plan: dict[str, Any], servos: Mapping[str, Servo]) -> list[str]:
    """Lines of a mission: servos, then the time until the next order; trim commands at the end."""
    name = _with_servos(plan, servos)["name"]
    if loops := [one["input"] for one in plan["channels"] if one["kind"] != "table"]:
        raise DesignError(SAYS["mission_reacts"].format(name=name, loops=", ".join(loops)))
    orders: dict[float, dict[str, float]] = {0.0: dict(plan["constants"])}
    for one in plan["channels"]:
        for time, value in zip(one["times"], one["values"], strict=True):
            orders.setdefault(time, {})[one["input"]] = value
    times = sorted(time for time in orders if time < plan["duration"])
    ends = [*times[1:], plan["duration"]]
    # A run may begin with one sample at trim.
    lasting = np.subtract(ends, times)[1:]
    if (shortest := float(lasting.min(initial=np.inf))) < SHORTEST_ORDER - 1e-9:
        raise DesignError(
            f"The run {name!r} has orders {shortest:.3g} s apart; those of a mission have to be "
            f"{SHORTEST_ORDER:g} s apart or more. Take samples that long, a controller of the kind "
            "'ardupilot', or overrides."
        )
    items: list[tuple[float, ...]] = [(0, _WAYPOINT)]
    for time, end in zip(times, ends, strict=True):
        items += _servo_items(orders[time], servos)
        items.append((_FRAME, _DELAY, round(end - time, 3)))
    items += _servo_items(plan["trim"], servos)
    lines = ["QGC WPL 110"]
    for number, (frame, what, *given) in enumerate(items):
        numbers = [*given, *(0.0 for _ in range(7 - len(given)))]
        cells = (number, int(number == 0), frame, what, *(f"{one:g}" for one in numbers), 1)
        lines.append("\t".join(map(str, cells)))
    return lines


def _servo_items(
    orders: Mapping[str, float], servos: Mapping[str, Servo]
) -> list[tuple[float, ...]]:
    """Items that set the servos; constants without one are left to whoever holds them."""
    return [
        (_FRAME, _SET_SERVO, servos[name].channel, int(servos[name].pulses(np.array([value]))[0]))
        for name, value in orders.items()
        if name in servos
    ]


def _with_servos(plan: dict[str, Any], servos: Mapping[str, Servo]) -> dict[str, Any]:
    """The plan with the calibration of its servos, which have to reach what is ordered."""
    if missing := [name for name in plan["trim"] if name not in servos]:
        raise DesignError(SAYS["no_servo"].format(names=", ".join(missing), missing=missing))
    for one in plan["channels"]:
        most = [s * a for a in one.get("amplitudes", ()) for s in (-1, 1)]
        servos[one["input"]].pulses(np.array([one["trim"] + a for a in most] or one["values"]))
    return plan | {"servos": {name: asdict(servo) for name, servo in servos.items()}}


def _moos_names(model: Model, plan: Mapping[str, Any]) -> dict[str, tuple[str, float]]:
    """MOOS variable and unit of each command; angles in degrees, others as they are."""
    units, found = units_of(model), {}
    for name in {**plan["constants"], **plan["trim"]}:
        if units[name] == "rad":
            turns = name.startswith(("rudder", "delta", "dr"))
            found[name] = ("DESIRED_RUDDER" if turns else "DESIRED_ELEVATOR", degrees(1.0))
        else:
            found[name] = ("DESIRED_THRUST" if name in ("n", "thrust") else name.upper(), 1.0)
    return found


def _lua(value: Any) -> str:
    """A value as Lua writes it; entries that are None are left out, which is nil."""
    if isinstance(value, Mapping):
        entries = {("given" if key == "reference" else key): one for key, one in value.items()}
        parts = [f"{key} = {_lua(one)}" for key, one in entries.items() if one is not None]
        return "{" + ", ".join(parts) + "}"
    if isinstance(value, list | tuple):
        return "{" + ", ".join(map(_lua, value)) + "}"
    if isinstance(value, str):
        return '"' + value.replace("\\", "").replace('"', "") + '"'
    return repr(value)


def words(model: Model, plan: Mapping[str, Any]) -> list[str]:
    """The run as numbered rules, angles in degrees.

    Parameters
    ----------
    model : Model
        Units of the channels.
    plan : mapping
        Of :func:`plan_of`.
    """
    units = units_of(model)
    lines = [f"{plan['name']}: {plan['duration']:g} s, a decision every {plan['period']:g} s."]
    for name, value in plan["constants"].items():
        lines.append(f"Hold {name} at {quantity(value, units[name])} throughout.")
    for one in plan["channels"]:
        lines += _rules(one, units)
    for rule in plan["aborts"]:
        where = outside(rule["lower"], rule["upper"], units[rule["signal"]])
        lines.append(f"Break off where {rule['signal']} is {where}, or unknown.")
    trim = ", ".join(f"{n} = {quantity(v, units[n])}" for n, v in plan["trim"].items())
    lines.append(f"At the end, or broken off: {trim}.")
    return [lines[0], *(f"{i}. {line}" for i, line in enumerate(lines[1:], start=1))]


def _rules(one: Mapping[str, Any], units: Mapping[str, str]) -> list[str]:
    """Rules of one input."""
    name, unit = one["input"], units[one["input"]]
    if one["kind"] == "table":
        orders = zip(one["times"], one["values"], strict=True)
        return [f"From {time:g} s on: {name} = {quantity(value, unit)}." for time, value in orders]
    by = units[one["signals"][0]]
    rate = "" if one["rate"] is None else f", at most {quantity(one['rate'], unit)}/s"
    first = one["first"]
    sizes = ", ".join(quantity(a, unit) for a in one["amplitudes"])
    ends = ", ".join(quantity(s, by) for s in one["switches"])
    way = "grown" if one["sign"] * first > 0 else "fallen"
    return [
        f"Until {one['start']:g} s: {name} = {quantity(one['trim'], unit)}.",
        f"Then {name} = {quantity(one['trim'], unit)} {'+' if first > 0 else '-'} {sizes} "
        f"(one after the other, the last again and again){rate}.",
        f"Count {_deviation(one, by)}.",
        f"Where D has {way} to {ends} (one after the other), reverse {name} and wait for the "
        "opposite.",
    ]  # fmt: skip


def _deviation(one: Mapping[str, Any], unit: str) -> str:
    """What a zigzag reverses on, D, in words."""
    signal, *others = one["signals"]
    zero = f"its value at {one['start']:g} s" if one["reference"] is None else "zero"
    if one["reference"]:
        zero = quantity(one["reference"], unit)
    far = f"D = {signal} minus {zero}"
    if one["lead"]:
        far += f", plus {one['lead']:.4g} s times {others[0]}"
    if one["keep_gain"]:
        far += f", minus {one['keep_gain']:.4g} times ({others[-1]} minus its first value)"
        far += ", this at most half the switch"
    return far


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

    Examples
    --------
    >>> servo = Servo(1, np.radians(-35.0), np.radians(35.0))
    >>> servo.lowest, servo.highest
    (1100, 1900)
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
        shortest, longest = sorted((self.lowest, self.highest))
        if not 500 <= shortest < longest <= 2500:
            raise DesignError(SAYS["servo_pulses"].format(self))

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

    Examples
    --------
    >>> import tempfile
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading").model
    >>> t, servo = np.arange(3.0), Servo(1, -0.6, 0.6)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     rows = np.array([[0.0], [0.3], [0.3]])
    ...     file = write_overrides(Path(folder) / "a.csv", ship, t, rows, servos={"delta": servo})
    ...     print(file.read_text().splitlines())
    ['time [ms],chan1_raw [us]', '0.0,1500.0', '1000.0,1700.0', '2000.0,1700.0']
    """
    columns = located(DesignError, f"Model {model.name!r} has no input", servos, model.input_names)
    channels = [servo.channel for servo in servos.values()]
    if len(set(channels)) < len(channels) or not channels:
        raise DesignError("Give one servo or more, each on a channel of its own.")
    pulses = np.column_stack(
        [servo.pulses(inputs[:, i]) for servo, i in zip(servos.values(), columns, strict=True)]
    )
    changed = np.concatenate([[True], np.any(np.diff(pulses, axis=0) != 0, axis=1)])
    changed[-1] = True
    table = np.column_stack([np.rint(1000.0 * (times - times[0])), pulses])[changed]
    place = Path(path)
    write_table(place, ["time [ms]", *(f"chan{channel}_raw [us]" for channel in channels)], table)
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

    Examples
    --------
    Of a run ``design.experiment`` on its samples::

        write_bag("run_bag", design.model, design.trajectory.times, design.trajectory.inputs)
    """
    if (place := Path(path)).exists():
        raise FileError(f"{str(place)!r} exists already. Name a folder that does not.")
    rosbag2 = library("rosbags.rosbag2", "Writing a ROS bag")
    typesys = library("rosbags.typesys", "Writing a ROS bag")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    kind = "std_msgs/msg/Float64"
    message = store.types[kind]
    make_folder(place.parent)
    with rosbag2.Writer(place, version=8) as writer:
        topics = (f"{TOPIC}/{name}" for name in model.input_names)
        links = [writer.add_connection(topic, kind, typestore=store) for topic in topics]
        for time, row in zip(times - times[0], inputs, strict=True):
            for link, value in zip(links, row, strict=True):
                content = store.serialize_cdr(message(float(value)), kind)
                writer.write(link, round(1e9 * float(time)), content)
    return place
