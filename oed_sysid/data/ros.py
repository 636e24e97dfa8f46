"""ROS 1 and ROS 2 bags, read with rosbags; MCAP files, read with mcap."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.log import Log, assemble, library
from oed_sysid.errors import DataError

# Longer arrays are pictures, scans and covariances.
MOST_ENTRIES = 16


class _Topics:
    """Numbers of messages by topic, gathered one message at a time."""

    def __init__(self) -> None:
        self.received: dict[str, list[int]] = {}
        self.stamped: dict[str, list[int]] = {}
        self.rows: dict[str, list[dict[str, float]]] = {}

    def add(self, topic: str, received: int, message: Any) -> None:
        """Take one message; times in whole nanoseconds, as floats they would be rounded."""
        numbers = dict(_flat(message, ""))
        seconds = numbers.pop("header.stamp.sec", numbers.pop("header.stamp.secs", 0.0))
        rest = numbers.pop("header.stamp.nanosec", numbers.pop("header.stamp.nsecs", 0.0))
        numbers.pop("header.seq", None)
        name = topic.strip("/").replace("/", "_") or "topic"
        self.received.setdefault(name, []).append(received)
        self.stamped.setdefault(name, []).append(int(seconds) * 10**9 + int(rest))
        self.rows.setdefault(name, []).append(numbers)

    def log(self, path: Path, kind: str, notes: list[str]) -> Log:
        topics = {}
        first = min((min(times) for times in self.received.values()), default=0)
        for name, rows in self.rows.items():
            fields = dict.fromkeys(key for row in rows for key in row)
            known = min(self.stamped[name]) > 0
            received = np.array([time - first for time in self.received[name]]) * 1e-9
            stamped = np.array([time - first for time in self.stamped[name]]) * 1e-9
            # A sensor's own clock is better than the recorder's, if it counts the same time.
            own = known and np.abs(stamped - received).max() < 60.0
            if known and not own:
                notes.append(f"{name}: header stamps are of another clock; times of arrival used.")
            values = {key: np.array([row.get(key, np.nan) for row in rows]) for key in fields}
            if values:
                topics[name] = (stamped if own else received, values)
        return assemble(path, kind, topics, notes=notes)


def _flat(message: Any, prefix: str) -> Iterator[tuple[str, float]]:
    """Names and values of all numbers in a message."""
    if isinstance(message, bool | int | float | np.number):
        yield prefix, float(message)
    elif isinstance(message, Mapping):
        for key, value in message.items():
            yield from _flat(value, f"{prefix}.{key}" if prefix else str(key))
    elif hasattr(message, "__dataclass_fields__"):
        for key in message.__dataclass_fields__:
            if not key.startswith("__"):
                yield from _flat(getattr(message, key), f"{prefix}.{key}" if prefix else key)
    elif isinstance(message, Sequence | np.ndarray) and not isinstance(message, str | bytes):
        few = len(message) <= MOST_ENTRIES
        for index, value in enumerate(message if few else ()):
            yield from _flat(value, f"{prefix}[{index}]")


def read_bag(path: Path) -> Log:
    """Read a ROS 1 bag (file) or a ROS 2 bag (folder).

    Parameters
    ----------
    path : Path
        ``run.bag``, or the folder with ``metadata.yaml``.

    Raises
    ------
    DataError
        If rosbags is missing, or the bag is damaged or was not closed.
    """
    highlevel = library("rosbags.highlevel", "a ROS bag")
    typesys = library("rosbags.typesys", "a ROS bag")
    topics, notes, skipped = _Topics(), [], dict[str, str]()
    kind = "ROS 2 bag" if path.is_dir() else "ROS 1 bag"
    store = typesys.get_typestore(typesys.Stores.LATEST) if path.is_dir() else None
    try:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            for connection, nanoseconds, raw in reader.messages():
                if connection.topic in skipped:
                    continue
                try:
                    message = reader.deserialize(raw, connection.msgtype)
                except Exception as error:  # an unknown type, or a torn message
                    skipped[connection.topic] = str(error) or type(error).__name__
                    continue
                topics.add(connection.topic, nanoseconds, message)
    except Exception as error:  # whatever a damaged bag makes of the library
        if not topics.rows:
            raise
        notes.append(f"{path.name} breaks off ({str(error)[:80]}); what stands before is used.")
    notes += [f"Topic {topic} was left out: {why[:80]}" for topic, why in skipped.items()]
    return topics.log(path, kind, notes)


def read_mcap(path: Path) -> Log:
    """Read an MCAP file with messages of ROS 1, ROS 2 or JSON.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If mcap is missing, or nothing in the file can be read.
    """
    reader_module = library("mcap.reader", "an MCAP file")
    topics, notes, skipped = _Topics(), [], dict[str, str]()
    decoders: dict[int, Callable[[bytes], Any]] = {}
    try:
        with path.open("rb") as stream:
            reader = reader_module.NonSeekingReader(stream)
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                if channel.topic in skipped:
                    continue
                try:
                    if channel.id not in decoders:
                        decoders[channel.id] = _decoder(schema, channel)
                    content = decoders[channel.id](message.data)
                except DataError as error:
                    skipped[channel.topic] = str(error)
                    continue
                except Exception as error:  # a torn message
                    skipped[channel.topic] = str(error)[:80] or type(error).__name__
                    continue
                topics.add(channel.topic, message.log_time, content)
    except Exception:  # whatever a damaged file makes of the library
        if not topics.rows:
            raise
        notes.append(f"{path.name} breaks off; what stands before its end is used.")
    notes += [f"Topic {topic} was left out: {why}" for topic, why in skipped.items()]
    if not topics.rows and skipped:
        topic, why = next(iter(skipped.items()))
        raise DataError(f"No topic of {path.name} can be read. {topic}: {why}")
    return topics.log(path, "MCAP file", notes)


def _decoder(schema: Any, channel: Any) -> Callable[[bytes], Any]:
    """What turns the bytes of a channel into a message."""
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding in ("cdr", "ros1") and schema is not None:
        typesys = library("rosbags.typesys", "an MCAP file of ROS messages")
        name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        text = schema.data.decode()
        parse = typesys.get_types_from_idl if schema.encoding == "ros2idl" else None
        types = parse(text) if parse else typesys.get_types_from_msg(text, name)
        store.register(types)
        if channel.message_encoding == "cdr":
            return lambda raw: store.deserialize_cdr(raw, name)
        return lambda raw: store.deserialize_ros1(raw, name)
    raise DataError(
        f"its messages are encoded as {channel.message_encoding!r}; cdr (ROS 2), ros1 and json "
        "are read. Convert the file, or export the topic as CSV."
    )
