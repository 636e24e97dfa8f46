"""What usually goes wrong between a command and the actual value, of every actuator."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from oed_sysid.evidence.sizes import Sizes
from oed_sysid.evidence.usual_forces import commanded
from oed_sysid.physics import Effect
from oed_sysid.physics import signals as actuators
from oed_sysid.physics.model import Model

# Share of a signal's swing, and of a lift, that an effect makes.
OF_SWING, OF_LIFT = 0.1, 0.2
# A lag in samples, the longest delay in samples, and the most steps that its register may hold.
LAG, DELAY, LONGEST = 2.0, 4.0, 12
# An input in this unit or with such a name is no command but a measured flow.
FLOW_UNIT, FLOWS = "m/s", ("wind", "wave", "current")
# Names of twins that have nothing in common.
SIDES = ("port", "starboard", "left", "right", "upper", "lower")


def usual_commands(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Offsets, gains and what actuators do to commands, of each and of several alike."""
    units = {
        signal: unit
        for signal, unit in commanded(model).items()
        if sizes.swing.get(signal, 0.0) > 0 and unit != FLOW_UNIT and not signal.startswith(FLOWS)
    }
    alike: dict[tuple[str, str], list[str]] = {}
    for signal, unit in units.items():
        alike.setdefault((unit, _stem(signal)), []).append(signal)
    for signal, unit in units.items():
        share = OF_SWING * sizes.swing[signal]
        yield actuators.actuator_offset(f"{signal}_offset", signal, unit, scale=share)
        if len(alike[unit, _stem(signal)]) > 1:  # of one alone, free derivatives are its gain
            yield actuators.actuator_gain_error(f"{signal}_gain", signal)
        if unit == "rad":
            bend = OF_LIFT / sizes.swing[signal] ** 2
            yield actuators.stall(f"{signal}_stall", signal, scale=bend)
        yield from _moved((signal,), unit, sizes)
    for (unit, _), signals in alike.items():
        if len(signals) > 1:
            yield from _moved(signals, unit, sizes)


def _stem(signal: str) -> str:
    """What the names of twins have in common: ``n`` of ``n_l``, nothing of ``port``."""
    first = re.split(r"[_\d]", signal)[0]
    return "" if first in SIDES else first


def _moved(signals: Sequence[str], unit: str, sizes: Sizes) -> Iterator[Effect]:
    """What actuators do to their commands: of one, or of several alike."""
    name, lag = "_".join(signals), LAG * sizes.sample
    swing = float(np.mean([sizes.swing[signal] for signal in signals]))
    share = OF_SWING * swing
    yield actuators.actuator_lag(f"{name}_lag", signals, scale=lag)
    if DELAY * sizes.sample <= LONGEST * sizes.step:
        yield actuators.actuator_delay(
            f"{name}_delay", signals, max_delay=DELAY * sizes.sample, step=sizes.step,
            scale=0.5 * lag,
        )  # fmt: skip
    yield actuators.rate_limit(f"{name}_rate_limit", signals, unit, scale=lag / swing)
    yield actuators.deadband(f"{name}_deadband", signals, unit, scale=share)
    yield actuators.backlash(f"{name}_backlash", signals, unit, scale=share)
