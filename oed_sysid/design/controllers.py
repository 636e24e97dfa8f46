r"""The controller of a run as a file: what flies it, not what it would have commanded.

A run that is closed over the vehicle reverses its order where

.. math:: \pm\left(y + T \dot y - y_0 - k\,(z - z_0)\right) \ge y_s

on the vehicle that is there. The table of the commands that the nominal vehicle would get is
another run on any other vehicle: it has its own probability of keeping the limits
(:func:`played`).

Every file holds the same law, with the plan as data: triggers, gains, limits of the commands, rules
at which the run is broken off, and the neutral commands that follow. Names in the files are those
of the channels, which are identifiers; titles keep to a safe alphabet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from importlib.resources import files
from math import degrees, isfinite
from pathlib import Path
from string import Template
from typing import Any

from oed_sysid.design.assurance import AbortRule
from oed_sysid.design.library import as_piecewise
from oed_sysid.design.limits import quantity, units_of
from oed_sysid.design.on_board import Servo
from oed_sysid.errors import DesignError
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.manoeuvres import Manoeuvre, ZigZag, ZigZagLike
from oed_sysid.experiments.simulation import simulate
from oed_sysid.physics.model import Model
from oed_sysid.runtime.files import write_text
from oed_sysid.runtime.version import __version__
from oed_sysid.text.typeset import safe

# Kinds of files by their usual ending: pieces of text that follow one another.
KINDS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "ros2": (".py", ("law", "ros2")),
    "moos": (".py", ("law", "moos")),
    "ardupilot": (".lua", ("ardupilot",)),
    "words": (".txt", ()),
}
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
    """
    if not experiment.reacts:
        return experiment
    run = simulate(model, experiment, noise=False)
    columns = dict(zip(model.input_names, run.inputs.T, strict=True))
    tables = [
        as_piecewise(one.input, run.times, columns[one.input]) for one in experiment.manoeuvres
    ]
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
        ``"moos"``, an application of pymoos; ``"words"``, numbered rules for whoever programmes it.
    aborts : sequence of AbortRule, optional
        When the run is broken off, such as ``design.assurance.rules``; by default the limits of
        the experiment on the motion.
    servos : mapping of str to Servo, optional
        By input; ArduPilot's script needs them.

    Returns
    -------
    Path

    Raises
    ------
    DesignError
        If the kind is unknown, the run has another feedback than zigzags, or a signal is not one
        that autopilots know.
    """
    if kind not in KINDS:
        raise DesignError(f"There is no controller {kind!r}. Kinds are {', '.join(KINDS)}.")
    plan = plan_of(model, experiment, aborts)
    place = Path(path)
    if kind == "words":
        write_text(place, "\n".join(words(model, plan)) + "\n")
        return place
    if unknown := [name for name in plan["signals"] if name not in SEEN]:
        raise DesignError(
            f"The run reacts to {', '.join(unknown)}, which autopilots do not know by that name; "
            f"known are {', '.join(SEEN)}. Name the signal so in the model, or write kind='words'."
        )
    marks = {"title": plan["name"], "source": f"written by oed_sysid {__version__}", "written": ""}
    if kind == "ardupilot":
        _check_servos(plan, servos or {})
        listed = {name: asdict(servo) for name, servo in (servos or {}).items()}
        marks["run"] = _lua(plan | {"servos": listed})
    else:
        marks["run"] = repr(plan)
        marks["written"] = repr(_moos_names(model, plan)) if kind == "moos" else ""
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
    if aborts is None:
        bounds = experiment.limits.signals.items()
        aborts = [AbortRule(name, low, high, 0.0, True) for name, (low, high) in bounds]
    rules = [
        {"signal": one.signal, "lower": _finite(one.lower, -1), "upper": _finite(one.upper, 1)}
        for one in aborts
    ]
    signals = [name for one in channels for name in one.get("signals", ())]
    return {
        "name": safe(experiment.name),
        "duration": float(experiment.duration or 0.0),
        "period": float(experiment.sample_time),
        "signals": list(dict.fromkeys([*signals, *(rule["signal"] for rule in rules)])),
        "constants": dict(experiment.constants),
        "neutral": {one["input"]: one["neutral"] for one in channels},
        "channels": channels,
        "aborts": rules,
    }


def _finite(bound: float, side: int) -> float:
    """A bound that every language can write."""
    return float(bound) if isfinite(bound) else side * 1e30


def _channel(manoeuvre: Manoeuvre, experiment: Experiment) -> dict[str, Any]:
    """One input: what reverses it, or its table."""
    if isinstance(manoeuvre, ZigZag | ZigZagLike):
        amplitudes, switches, lead, keep_gain = manoeuvre.swings
        return {
            "input": manoeuvre.input, "kind": "zigzag", "signals": list(manoeuvre.feedback),
            "amplitudes": list(amplitudes), "switches": list(switches), "lead": lead,
            "keep_gain": keep_gain, "rate": manoeuvre.rate, "first": manoeuvre.first,
            "start": manoeuvre.start, "sign": manoeuvre.sign, "neutral": manoeuvre.neutral,
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
        "values": list(table.values), "neutral": float(table.values[0]),
    }  # fmt: skip


def _check_servos(plan: Mapping[str, Any], servos: Mapping[str, Servo]) -> None:
    if missing := [name for name in plan["neutral"] if name not in servos]:
        raise DesignError(
            f"ArduPilot needs a servo for {', '.join(missing)}: "
            f"servos={{{missing[0]!r}: Servo(1, -0.4, 0.4)}}."
        )
    for one in plan["channels"]:
        most = [s * a for a in one.get("amplitudes", ()) for s in (-1, 1)]
        reach = [one["neutral"] + a for a in most] or one["values"]
        servo = servos[one["input"]]
        if min(reach) < servo.lower - 1e-9 or max(reach) > servo.upper + 1e-9:
            raise DesignError(
                f"{one['input']} is commanded from {min(reach):.4g} to {max(reach):.4g}, its servo "
                f"reaches from {servo.lower:.4g} to {servo.upper:.4g}."
            )


def _moos_names(model: Model, plan: Mapping[str, Any]) -> dict[str, tuple[str, float]]:
    """MOOS variable and unit of each command; angles in degrees, others as they are."""
    units, found = units_of(model), {}
    for name in {**plan["constants"], **plan["neutral"]}:
        if units[name] != "rad":
            found[name] = ("DESIRED_THRUST" if name in ("n", "thrust") else name.upper(), 1.0)
        elif name.startswith(("rudder", "delta", "dr")):
            found[name] = ("DESIRED_RUDDER", degrees(1.0))
        else:
            found[name] = ("DESIRED_ELEVATOR", degrees(1.0))
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
        ends = [
            f"{word} {quantity(rule[side], units[rule['signal']])}"
            for word, side in (("below", "lower"), ("above", "upper"))
            if abs(rule[side]) < 1e30
        ]
        lines.append(f"Break off where {rule['signal']} is {' or '.join(ends)}, or unknown.")
    neutral = ", ".join(f"{n} = {quantity(v, units[n])}" for n, v in plan["neutral"].items())
    lines.append(f"At the end, or broken off: {neutral}.")
    return [lines[0], *(f"{i}. {line}" for i, line in enumerate(lines[1:], start=1))]


def _rules(one: Mapping[str, Any], units: Mapping[str, str]) -> list[str]:
    """Rules of one input."""
    name, unit = one["input"], units[one["input"]]
    if one["kind"] == "table":
        orders = zip(one["times"], one["values"], strict=True)
        return [f"From {time:g} s on: {name} = {quantity(value, unit)}." for time, value in orders]
    signals = one["signals"]
    signal, by = signals[0], units[signals[0]]
    zero = f"its value at {one['start']:g} s" if one["reference"] is None else "zero"
    if one["reference"]:
        zero = quantity(one["reference"], by)
    far = f"D = {signal} minus {zero}"
    if one["lead"]:
        far += f", plus {one['lead']:.4g} s times {signals[1]}"
    if one["keep_gain"]:
        far += f", minus {one['keep_gain']:.4g} times ({signals[-1]} minus its first value)"
        far += ", this at most half the switch"
    rate = "" if one["rate"] is None else f", at most {quantity(one['rate'], unit)}/s"
    first = one["first"]
    sizes = ", ".join(quantity(a, unit) for a in one["amplitudes"])
    ends = ", ".join(quantity(s, by) for s in one["switches"])
    way = "grown" if one["sign"] * first > 0 else "fallen"
    return [
        f"Until {one['start']:g} s: {name} = {quantity(one['neutral'], unit)}.",
        f"Then {name} = {quantity(one['neutral'], unit)} {'+' if first > 0 else '-'} {sizes} "
        f"(one after the other, the last again and again){rate}.",
        f"Count {far}.",
        f"Where D has {way} to {ends} (one after the other), reverse {name} and wait for the "
        "opposite.",
    ]  # fmt: skip
