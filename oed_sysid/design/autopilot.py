r"""Commands of a run as files that autopilots take.

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

import numpy as np

from oed_sysid.data.csv_table import write_table
from oed_sysid.errors import DesignError, FileError
from oed_sysid.files import make_folder
from oed_sysid.logs.libraries import library
from oed_sysid.model import Model

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
