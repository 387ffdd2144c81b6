"""`sensor_msgs/JointState` of a ROS bag: ROS 2 as SQLite or MCAP, file or folder, and ROS 1. Needs `sweepid[ros]`.

The channels are ``position``, ``velocity`` and ``effort`` of each joint, SI; the clock is that of the messages' heads,
or, where these are empty, the time of recording. MCAP of JSON, as `sweepid export recording` writes it, is not a bag.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag2 import ReaderError as Ros2Error
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from service.formats.traces.containers import (
    Array,
    ChannelName,
    ListedChannel,
    Taken,
    check_numbers,
    shown,
)
from service.model.errors import BadInput
from service.store.files.columns import MOST_NUMBERS

LIBRARY_ERRORS: tuple[type[Exception], ...] = (AnyReaderError, Ros1Error, Ros2Error, SerdeError)
_TYPE = "sensor_msgs/msg/JointState"


def read(path: Path, sweeps: Sequence[Sequence[ChannelName]]) -> Iterator[Taken]:
    """The channels, one sweep after the other; `group` is a topic."""
    for channels in sweeps:
        topic, clock, columns = _records(path, next((str(each.group) for each in channels if each.group), None))
        for channel in channels:
            if channel.source not in columns:
                raise BadInput(f"{path} topic {topic}", f"has no {channel.source!r}; there are {shown(list(columns))}")
        yield Taken(np.array([columns[each.source] for each in channels]), ("SI",) * len(channels), clock)


def listed(path: Path) -> tuple[ListedChannel, ...]:
    """Position, velocity and effort of each joint."""
    topic, _, columns = _records(path, None)
    pairs = [(name, *name.rpartition(".")[::2]) for name in columns]
    return tuple(ListedChannel(name=name, unit="SI", group=topic, role=what, axis=joint) for name, joint, what in pairs)


def _records(path: Path, wanted: str | None) -> tuple[str, Array, dict[str, Array]]:
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        topics = {each.topic: each for each in reader.connections if each.msgtype == _TYPE}
        if not topics or (wanted is not None and wanted not in topics):
            there = shown(sorted(f"{each.topic} ({each.msgtype})" for each in reader.connections))
            raise BadInput(str(path), f"has no {'topic ' + wanted if wanted else _TYPE}; there are {there}")
        if len(topics) > 1 and wanted is None:
            raise BadInput(
                str(path), f"has joint states of {shown(sorted(topics))}: choose one as `group` of the sweep"
            )
        topic = wanted or next(iter(topics))
        check_numbers(topics[topic].msgcount, 4, MOST_NUMBERS, str(path))
        rows: list[tuple[float, dict[str, float]]] = []
        for connection, recorded, raw in reader.messages(connections=[topics[topic]]):
            message = cast(Any, reader.deserialize(raw, connection.msgtype))
            stamp = message.header.stamp
            seconds = stamp.sec + 1e-9 * stamp.nanosec if stamp.sec or stamp.nanosec else recorded * 1e-9
            rows.append((float(seconds), dict(_values(message))))
    names = list(dict.fromkeys(name for _, values in rows for name in values))
    if not rows:
        raise BadInput(f"{path} topic {topic}", "has no messages")
    clock = np.array([stamp for stamp, _ in rows])
    return topic, clock - clock[0], {name: np.array([values.get(name, np.nan) for _, values in rows]) for name in names}


def _values(message: Any) -> Iterator[tuple[str, float]]:
    for what in ("position", "velocity", "effort"):
        for joint, value in zip(message.name, getattr(message, what), strict=False):
            yield f"{joint}.{what}", float(value)
