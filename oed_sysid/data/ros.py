"""ROS 1 and ROS 2 bags, read with rosbags; MCAP files, read with mcap."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.log import Log, Rows, assemble, topics_of, until_torn
from oed_sysid.errors import DataError, library

# Longer arrays are pictures, scans and covariances.
MOST_ENTRIES = 16


# Time of arrival, time of the header and numbers of messages, by topic.
_Stamped = dict[str, list[tuple[int, int, dict[str, float]]]]


def _log(path: Path, kind: str, messages: Iterator[tuple[str, int, Callable[[], Any]]]) -> Log:
    """Log of topic, time of arrival (ns) and content of every message.

    Times stay whole nanoseconds as long as they count from far away: as floats they would be
    rounded.
    """
    rows: _Stamped = {}
    notes, skipped = list[str](), dict[str, str]()
    for topic, received, content in until_torn(messages, path, notes):
        if topic in skipped:
            continue
        try:
            numbers = dict(_flat(content(), ""))
        except Exception as error:  # an unknown type, or a torn message
            why = str(error) or type(error).__name__
            skipped[topic] = why if isinstance(error, DataError) else why[:80]
            continue
        seconds = numbers.pop("header.stamp.sec", numbers.pop("header.stamp.secs", 0.0))
        rest = numbers.pop("header.stamp.nanosec", numbers.pop("header.stamp.nsecs", 0.0))
        numbers.pop("header.seq", None)
        name = topic.strip("/").replace("/", "_") or "topic"
        rows.setdefault(name, []).append((received, int(seconds) * 10**9 + int(rest), numbers))
    notes += [f"Topic {topic} was left out: {why}" for topic, why in skipped.items()]
    if not rows and skipped:
        topic, why = next(iter(skipped.items()))
        raise DataError(f"No topic of {path.name} can be read. {topic}: {why}")
    return assemble(path, kind, topics_of(_timed(rows, notes)), notes=notes)


def _timed(rows: _Stamped, notes: list[str]) -> Rows:
    """Messages at the times of their headers, or of their arrival."""
    timed: Rows = {}
    first = min((got for every in rows.values() for got, _, _ in every), default=0)
    for name, every in rows.items():
        times = np.array([(got - first, own - first) for got, own, _ in every]) * 1e-9
        # A sensor's own clock is better than the recorder's, if it counts the same time.
        known = min(own for _, own, _ in every) > 0
        agrees = np.abs(times[:, 1] - times[:, 0]).max() < 60.0
        if known and not agrees:
            notes.append(f"{name}: header stamps are of another clock; times of arrival used.")
        clock = times[:, int(known and agrees)]
        timed[name] = [(time, row) for time, (_, _, row) in zip(clock, every, strict=True)]
    return timed


def _flat(message: Any, prefix: str) -> Iterator[tuple[str, float]]:
    """Names and values of all numbers in a message."""
    if isinstance(message, bool | int | float | np.number):
        yield prefix.lstrip("."), float(message)
    for key, value in _parts(message):
        yield from _flat(value, f"{prefix}{key}")


def _parts(message: Any) -> Iterator[tuple[str, Any]]:
    """Fields of a message and entries of a short array, by how they are written."""
    if isinstance(message, Mapping):
        yield from ((f".{key}", value) for key, value in message.items())
    elif hasattr(message, "__dataclass_fields__"):
        named = (key for key in message.__dataclass_fields__ if not key.startswith("__"))
        yield from ((f".{key}", getattr(message, key)) for key in named)
    elif isinstance(message, Sequence | np.ndarray) and not isinstance(message, str | bytes):
        few = len(message) <= MOST_ENTRIES
        yield from ((f"[{index}]", value) for index, value in enumerate(message if few else ()))


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
    highlevel = library("rosbags.highlevel", "Reading a ROS bag")
    typesys = library("rosbags.typesys", "Reading a ROS bag")
    store = typesys.get_typestore(typesys.Stores.LATEST) if path.is_dir() else None

    def messages() -> Iterator[tuple[str, int, Callable[[], Any]]]:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            for connection, received, raw in reader.messages():
                content = partial(reader.deserialize, raw, connection.msgtype)
                yield connection.topic, received, content

    return _log(path, "ROS 2 bag" if path.is_dir() else "ROS 1 bag", messages())


def read_mcap(path: Path) -> Log:
    """Read an MCAP file with messages of ROS 1, ROS 2, protobuf or JSON.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If mcap is missing, or nothing in the file can be read.
    """
    reader_module = library("mcap.reader", "Reading an MCAP file")
    decoders: dict[int, Callable[[bytes], Any]] = {}

    def content(schema: Any, channel: Any, raw: bytes) -> Any:
        if channel.id not in decoders:
            decoders[channel.id] = _decoder(schema, channel)
        return decoders[channel.id](raw)

    def messages() -> Iterator[tuple[str, int, Callable[[], Any]]]:
        with path.open("rb") as stream:
            reader = reader_module.NonSeekingReader(stream)
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                decoded = partial(content, schema, channel, message.data)
                yield channel.topic, message.log_time, decoded

    return _log(path, "MCAP file", messages())


def _decoder(schema: Any, channel: Any) -> Callable[[bytes], Any]:
    """What turns the bytes of a channel into a message."""
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding in ("cdr", "ros1") and schema is not None:
        typesys = library("rosbags.typesys", "Reading an MCAP file of ROS messages")
        name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        text, idl = schema.data.decode(), schema.encoding == "ros2idl"
        store.register(
            typesys.get_types_from_idl(text) if idl else typesys.get_types_from_msg(text, name)
        )
        read = getattr(store, f"deserialize_{channel.message_encoding}")
        return lambda raw: read(raw, name)
    if channel.message_encoding == "protobuf" and schema is not None:
        return _protobuf(schema)
    raise DataError(
        f"its messages are encoded as {channel.message_encoding!r}; protobuf, cdr (ROS 2), "
        "ros1 and json are read. Convert the file, or export the topic as CSV."
    )


def _protobuf(schema: Any) -> Callable[[bytes], Any]:
    """What turns bytes into a message by the descriptors that the file holds."""
    what = "Reading an MCAP file of protobuf messages"
    descriptor = library("google.protobuf.descriptor_pb2", what)
    pools = library("google.protobuf.descriptor_pool", what)
    factory = library("google.protobuf.message_factory", what)
    files = descriptor.FileDescriptorSet.FromString(schema.data)
    kinds = factory.GetMessageClassesForFiles
    pool = pools.DescriptorPool()
    waiting = list(files.file)
    while waiting:  # each file behind those that it needs
        known = {one.name for one in waiting}
        ready = [one for one in waiting if known.isdisjoint(one.dependency)]
        for one in ready:
            pool.Add(one)
        if not ready:
            raise DataError("its protobuf descriptors need each other in a circle.")
        waiting = [one for one in waiting if one not in ready]
    made = kinds([one.name for one in files.file], pool)[schema.name]
    return lambda raw: _plain(made.FromString(raw))


def _plain(message: Any) -> dict[str, Any]:
    """Fields of a protobuf message as numbers, lists and tables; a header's stamp as of ROS."""
    return {
        one.name: (
            [_plain(part) if one.message_type else part for part in value]
            if one.is_repeated
            else _plain(value)
            if one.message_type
            else value
        )
        for one in message.DESCRIPTOR.fields
        if not (one.message_type and one.message_type.GetOptions().map_entry)
        for value in (getattr(message, one.name),)
    }
