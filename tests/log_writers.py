"""Logs in the formats of vehicles, written with the libraries that read them or byte by byte."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np

Topics = Mapping[str, tuple[np.ndarray, Mapping[str, np.ndarray]]]


@dataclass(frozen=True)
class Voyage:
    """What a boat did, sampled at different rates: heading at 10 Hz, yaw rate at 25 Hz, rudder."""

    t_psi: np.ndarray
    t_r: np.ndarray
    t_rudder: np.ndarray

    @classmethod
    def short(cls) -> Voyage:
        """A minute of it."""
        return cls(
            0.013 + np.arange(0.0, 60.0, 0.1),
            np.arange(0.0, 60.0, 0.04),
            np.arange(-0.5, 60.0, 5.0),
        )

    def psi(self, t: np.ndarray) -> np.ndarray:
        """Heading, rad: it passes 180 degrees."""
        return 3.0 + 0.5 * np.sin(0.2 * t)

    def r(self, t: np.ndarray) -> np.ndarray:
        """Yaw rate, rad/s."""
        return 0.1 * np.cos(0.2 * t)

    def rudder(self, t: np.ndarray) -> np.ndarray:
        """Command, rad, changed every 10 s."""
        return 0.2 * np.sign(np.sin(2 * np.pi * (np.floor(t / 5) + 0.5) / 4))

    def quaternion(self, t: np.ndarray) -> np.ndarray:
        """Attitude with a heel of 0.1 rad, body to NED, shape (n, 4)."""
        return quaternion(np.full(t.shape, 0.1), np.zeros(t.shape), self.psi(t))


def quaternion(phi: np.ndarray, theta: np.ndarray, psi: np.ndarray) -> np.ndarray:
    """Body to earth axes of Euler angles, scalar part first, shape (n, 4)."""
    a, b, c = np.cos(phi / 2), np.cos(theta / 2), np.cos(psi / 2)
    d, e, f = np.sin(phi / 2), np.sin(theta / 2), np.sin(psi / 2)
    return np.column_stack(
        [
            a * b * c + d * e * f,
            d * b * c - a * e * f,
            a * e * c + d * b * f,
            a * b * f - d * e * c,
        ]
    )


def write_ulog(path: Path, topics: Topics, *, start: float = 5.0) -> Path:
    """A ULog of single-precision fields, by the format's description (PX4 user guide, ULog)."""

    def block(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", int(start * 1e6))]
    parts.append(block(b"B", bytes(40)))
    for name, (_, fields) in topics.items():
        declared = [
            f"float {key}" if values.ndim == 1 else f"float[{values.shape[1]}] {key}"
            for key, values in fields.items()
        ]
        text = ";".join(["uint64_t timestamp", *declared])
        parts.append(block(b"F", f"{name}:{text};".encode()))
    for number, name in enumerate(topics):
        parts.append(block(b"A", struct.pack("<BH", 0, number) + name.encode()))
    rows = []
    for number, (times, fields) in enumerate(topics.values()):
        for i, time in enumerate(times):
            stamp = round((time + start) * 1e6)
            values = [np.ravel(v[i]) for v in fields.values()]
            body = struct.pack("<HQ", number, stamp)
            rows.append((stamp, block(b"D", body + np.concatenate(values).astype("<f4").tobytes())))
    parts += [row for _, row in sorted(rows, key=lambda one: one[0])]
    path.write_bytes(b"".join(parts))
    return path


def write_dataflash(path: Path, topics: Topics, units: Mapping[str, str]) -> Path:
    """An ArduPilot log with its own units and multipliers (messages FMT, UNIT, MULT, FMTU)."""

    def message(number: int, body: bytes) -> bytes:
        return b"\xa3\x95" + bytes([number]) + body

    def text(words: str, length: int) -> bytes:
        return words.encode()[:length].ljust(length, b"\0")

    def form(number: int, name: str, kinds: str, columns: str) -> bytes:
        size = 3 + struct.calcsize("<" + "".join(_KINDS[kind] for kind in kinds))
        body = bytes([number, size]) + text(name, 4) + text(kinds, 16) + text(columns, 64)
        return message(128, body)

    parts = [
        form(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
        form(129, "UNIT", "QbZ", "TimeUS,Id,Label"),
        form(130, "MULT", "Qbd", "TimeUS,Id,Mult"),
        form(131, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
    ]
    labels = {"s": "s", "d": "deg", "E": "rad/s", "Y": "us", "h": "degheading"}
    for key, label in (labels | {"n": "m/s", "q": "rpm"}).items():
        parts.append(message(129, struct.pack("<Qb", 0, ord(key)) + text(label, 64)))
    for key, factor in (("-", 0.0), ("0", 1.0), ("F", 1e-6)):
        parts.append(message(130, struct.pack("<Qbd", 0, ord(key), factor)))
    for number, (name, (_, fields)) in enumerate(topics.items(), start=140):
        parts.append(form(number, name, "Q" + "f" * len(fields), ",".join(["TimeUS", *fields])))
        ids = "s" + "".join(units[f"{name}.{key}"] for key in fields)
        body = struct.pack("<QB", 0, number) + text(ids, 16) + text("F" + "0" * len(fields), 16)
        parts.append(message(131, body))
    rows = []
    for number, (times, fields) in enumerate(topics.values(), start=140):
        for i, time in enumerate(times):
            stamp = round((time + 5.0) * 1e6)
            body = struct.pack(f"<Q{len(fields)}f", stamp, *(v[i] for v in fields.values()))
            rows.append((stamp, message(number, body)))
    parts += [row for _, row in sorted(rows, key=lambda one: one[0])]
    path.write_bytes(b"".join(parts))
    return path


_KINDS = {"B": "B", "b": "b", "n": "4s", "N": "16s", "Z": "64s", "Q": "Q", "d": "d", "f": "f"}


def write_bag(path: Path, voyage: Voyage, *, version: int) -> Path:
    """A ROS bag with an Imu (ENU, FLU) and a rudder command, as REP 103 has them."""
    from rosbags.typesys import Stores, get_typestore

    first = version == 1
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    types = store.types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    sequence = {"seq": 0} if first else {}

    def imu(t: float) -> tuple[int, object]:
        nano = round((t + 1.7e9) * 1e9)
        yaw = np.pi / 2 - float(voyage.psi(np.array(t)))  # ENU
        return nano, types["sensor_msgs/msg/Imu"](
            header(
                stamp=stamp(sec=nano // 10**9, nanosec=nano % 10**9), frame_id="base", **sequence
            ),
            quaternion(0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)),
            np.zeros(9),
            vector(0.0, 0.0, -float(voyage.r(np.array(t)))),
            np.zeros(9),
            vector(0.0, 0.0, 9.81),
            np.zeros(9),
        )

    def rudder(t: float) -> tuple[int, object]:
        nano = round((t + 1.7e9) * 1e9)
        return nano, types["std_msgs/msg/Float64"](float(voyage.rudder(np.array(t))))

    if first:
        from rosbags.rosbag1 import Writer

        writer, serialize = Writer(path), store.serialize_ros1
    else:
        from rosbags.rosbag2 import Writer as Writer2

        writer, serialize = Writer2(path, version=8), store.serialize_cdr
    with writer:
        for topic, kind, make, times in (
            ("/imu/data", "sensor_msgs/msg/Imu", imu, voyage.t_r),
            ("/rudder", "std_msgs/msg/Float64", rudder, voyage.t_rudder),
        ):
            connection = writer.add_connection(topic, kind, typestore=store)
            for t in times:
                nano, message = make(t)
                writer.write(connection, nano, serialize(message, kind))
    return path


def mcap(
    path: Path,
    schema: tuple[str, str, bytes],
    encoding: str,
    topics: Mapping[str, Iterable[tuple[int, bytes]]],
    **settings: int,
) -> Path:
    """An MCAP file of stamped messages of one schema: its name, encoding and definition."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream, **settings)
        writer.start()
        number = writer.register_schema(*schema)
        for topic, messages in topics.items():
            channel = writer.register_channel(topic, encoding, number)
            for nano, message in messages:
                writer.add_message(channel, nano, message, 0)
        writer.finish()
    return path


def write_mcap(path: Path, topics: Topics) -> Path:
    """An MCAP file of JSON messages."""
    messages = {
        name: [
            (nano, json.dumps({key: float(one[i]) for key, one in fields.items()}).encode())
            for i, nano in enumerate(round((time + 1.7e9) * 1e9) for time in times)
        ]
        for name, (times, fields) in topics.items()
    }
    return mcap(path, ("free", "jsonschema", b"{}"), "json", messages)


def sentence(body: str) -> str:
    """A sentence of NMEA 0183 with its checksum."""
    checksum = reduce(xor, body.encode())
    return f"${body}*{checksum:02X}"


def write_nmea(path: Path, voyage: Voyage, *, stamped: bool) -> Path:
    """Sentences of heading, rate of turn and position, with a time in front of each or not."""
    rows = []
    for t in voyage.t_psi:
        psi = np.degrees(voyage.psi(np.array(t))) % 360
        rows.append((t, f"HEHDT,{psi:.4f},T"))
        rows.append((t + 0.02, f"HEROT,{np.degrees(voyage.r(np.array(t + 0.02))) * 60:.4f},A"))
    for t in np.arange(0.0, 60.0, 1.0):
        clock = f"1200{t:05.2f}"
        rows.append((t, f"GPRMC,{clock},A,5400.0000,N,01000.{round(t):04d},E,4.0,90.0,010120,,"))
    rows.append((30.5, "HEHDT,12"))
    lines = []
    for t, body in sorted(rows):
        line = sentence(body) if body != "HEHDT,12" else "$HEHDT,12"
        lines.append(f"{t + 1.7e9:.3f} {line}" if stamped else line)
    path.write_text("\n".join(lines) + "\n")
    return path
