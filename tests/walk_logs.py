"""Logs of the four walks: the records of a template as its vehicle's own logger would keep them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from log_writers import quaternion, write_dataflash, write_ulog
from scipy.io import savemat

from oed_sysid import Dataset

GAP = 60.0  # s between two runs, in which nothing was measured


@dataclass(frozen=True)
class Trial:
    """All runs of a trial, one after the other on one clock."""

    times: np.ndarray
    signals: dict[str, np.ndarray]
    spans: dict[str, tuple[float, float]]

    @classmethod
    def of(cls, data: Dataset) -> Trial:
        """Join records, with pauses between them."""
        times, spans, begin = [], {}, 10.0
        columns: dict[str, list[np.ndarray]] = {}
        for record in data:
            moved = record.times - record.times[0] + begin
            times.append(moved)
            spans[record.name] = (float(moved[0]), float(moved[-1]))
            for name in record.channels.input_names:
                columns.setdefault(name, []).append(record.input(name))
            for name in record.channels.output_names:
                columns.setdefault(name, []).append(record.output(name))
            begin = float(np.ceil(moved[-1] / 10.0) * 10.0 + GAP)
        joined = {name: np.concatenate(parts) for name, parts in columns.items()}
        return cls(np.concatenate(times), joined, spans)

    def every(self, step: int, *names: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Times and signals, every so many samples."""
        return self.times[::step], {name: self.signals[name][::step] for name in names}


def ship_log(trial: Trial, folder: Path) -> None:
    """``trial.ulg``: attitude as a quaternion, rudder normalised to 35 degrees, slow positions."""
    s, n = trial.signals, trial.times.size
    zero = np.zeros(n)
    slow, position = trial.every(2, "x", "y")
    write_ulog(
        folder / "trial.ulg",
        {
            "vehicle_attitude": (trial.times, {"q": quaternion(zero, zero, s["psi"])}),
            "vehicle_angular_velocity": (
                trial.times + 0.01,
                {"xyz": np.column_stack([zero, zero, s["r"]])},
            ),
            "vehicle_local_position": (slow + 0.02, position),
            "speed_log": (trial.times, {"u": s["u"], "v": s["v"]}),
            "actuator_controls_0": (trial.times, {"control": s["rudder"] / np.radians(35.0)}),
            "engine": (trial.times, {"thrust": s["thrust"] / 1000.0}),
        },
        start=0.0,
    )


def auv_log(trial: Trial, folder: Path) -> None:
    """``dive``, a ROS 2 bag: attitude ENU, rates and velocities forward-left-up, a mode."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types, s = store.types, trial.signals
    vector, rotation = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    turned = quaternion(s["phi"], -s["theta"], np.pi / 2 - s["psi"])

    def header(nano: int) -> object:
        stamp = types["builtin_interfaces/msg/Time"](sec=nano // 10**9, nanosec=nano % 10**9)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")

    def imu(i: int, nano: int) -> object:
        w, x, y, z = map(float, turned[i])
        rates = vector(float(s["p"][i]), -float(s["q"][i]), -float(s["r"][i]))
        nine = np.zeros(9)
        return types["sensor_msgs/msg/Imu"](
            header(nano), rotation(x, y, z, w), nine, rates, nine, vector(0.0, 0.0, 9.81), nine
        )

    def dvl(i: int, nano: int) -> object:
        speed = vector(float(s["u"][i]), -float(s["v"][i]), -float(s["w"][i]))
        twist = types["geometry_msgs/msg/Twist"](speed, vector(0.0, 0.0, 0.0))
        return types["geometry_msgs/msg/TwistStamped"](header(nano), twist)

    def number(values: np.ndarray) -> Callable[[int, int], object]:
        return lambda i, nano: types["std_msgs/msg/Float64"](float(values[i]))

    running = np.ones(trial.times.size)
    for _, last in trial.spans.values():
        running[np.searchsorted(trial.times, last)] = 0.0
    topics = [
        ("/imu/data", "sensor_msgs/msg/Imu", imu, 1),
        ("/dvl", "geometry_msgs/msg/TwistStamped", dvl, 2),
        ("/depth", "std_msgs/msg/Float64", number(s["z"]), 1),
        ("/stern", "std_msgs/msg/Float64", number(np.degrees(s["ds"])), 1),
        ("/rudder", "std_msgs/msg/Float64", number(np.degrees(s["dr"])), 1),
        ("/thrust", "std_msgs/msg/Float64", number(s["T"]), 1),
        ("/running", "std_msgs/msg/Float64", number(running), 1),
    ]
    with Writer(folder / "dive", version=8) as writer:
        for topic, kind, make, step in topics:
            connection = writer.add_connection(topic, kind, typestore=store)
            for i in range(0, trial.times.size, step):
                nano = round((trial.times[i] + 1.7e9) * 1e9)
                writer.write(connection, nano, store.serialize_cdr(make(i, nano), kind))


def usv_log(trial: Trial, folder: Path) -> None:
    """``00000007.BIN``: heading in degrees within a turn, propellers in rpm."""
    s = trial.signals
    slow, speed = trial.every(2, "u", "v")
    rpm = {f"rpm{i}": s[name] * 30 / np.pi for i, name in ((1, "n_port"), (2, "n_starboard"))}
    write_dataflash(
        folder / "00000007.BIN",
        {
            "ATT": (trial.times, {"Yaw": np.degrees(s["psi"]) % 360}),
            "IMU": (trial.times + 0.003, {"GyrZ": s["r"]}),
            "DVL": (slow, {"VX": speed["u"], "VY": speed["v"]}),
            "RPM": (trial.times, rpm),
        },
        {
            **{"ATT.Yaw": "h", "IMU.GyrZ": "E", "DVL.VX": "n", "DVL.VY": "n"},
            **{"RPM.rpm1": "q", "RPM.rpm2": "q"},
        },
    )


def torpedo_log(trial: Trial, folder: Path) -> None:
    """``run.mat``: two structures with times of their own."""
    s = trial.signals
    slow, speed = trial.every(2, "u", "w")
    fast = {"time": trial.times, "q": np.degrees(s["q"]), "theta": np.degrees(s["theta"])}
    savemat(
        folder / "run.mat",
        {
            "imu": fast | {"depth": s["z"]},
            "dvl": {"time": slow, "vx": speed["u"], "vz": speed["w"]},
            "cmd": {"time": trial.times, "stern": s["stern"], "thrust": s["thrust"]},
        },
    )


WRITERS = {"ship": ship_log, "auv": auv_log, "usv": usv_log, "torpedo": torpedo_log}
