"""`sensor_msgs/JointState` of a ROS bag: ROS 2 as SQLite or MCAP, file or folder, and ROS 1. Needs `sweepid[ros]`.

The channels are ``position``, ``velocity`` and ``effort`` of each joint, SI; the clock is that of the messages' heads,
or, where these are empty, the time of recording. An MCAP may hold JSON: `JointState`, Foxglove's ``JointStates``, or a
topic for each joint with its numbers, as `sweepid export recording` writes it.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from pydantic import BaseModel, ValidationError
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag2 import ReaderError as Ros2Error
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from service import BadInput
from service.formats.traces.containers import ChannelName, ListedChannel, Taken, check_numbers, shown
from service.model import Array
from service.store.files.columns import MOST_NUMBERS

LIBRARY_ERRORS: tuple[type[Exception], ...] = (AnyReaderError, McapError, Ros1Error, Ros2Error, SerdeError)
_MESSAGE = "sensor_msgs/msg/JointState"


class _Stamp(BaseModel):
    sec: float = 0.0
    nanosec: float = 0.0
    nsec: float = 0.0


class _Header(BaseModel):
    stamp: _Stamp = _Stamp()


class _Joint(BaseModel):
    name: str
    position: float | None = None
    velocity: float | None = None
    effort: float | None = None


class _Message(BaseModel):
    """JSON of `JointState`, of ``foxglove.JointStates``, or of one joint; what else it holds is passed over."""

    header: _Header = _Header()
    timestamp: _Stamp | None = None
    name: list[str] = []
    joints: list[_Joint] = []
    position: float | list[float] | None = None
    velocity: float | list[float] | None = None
    effort: float | list[float] | None = None


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
    states = _json_states(path)
    if states:
        topic = _chosen(path, states, wanted)
        if topic not in states:
            raise BadInput(str(path), f"has no topic {topic}; there are {shown(sorted(states))}")
        return topic, *_columns(states[topic])
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        topics = {each.topic: each for each in reader.connections if each.msgtype == _MESSAGE}
        if not topics or (wanted is not None and wanted not in topics):
            there = shown(sorted(f"{each.topic} ({each.msgtype})" for each in reader.connections))
            raise BadInput(str(path), f"has no {'topic ' + wanted if wanted else _MESSAGE}; there are {there}")
        topic = _chosen(path, topics, wanted)
        check_numbers(topics[topic].msgcount, 4, MOST_NUMBERS, str(path))
        rows: list[tuple[float, dict[str, float]]] = []
        for connection, recorded, raw in reader.messages(connections=[topics[topic]]):
            message = cast(Any, reader.deserialize(raw, connection.msgtype))
            stamp = message.header.stamp
            seconds = stamp.sec + 1e-9 * stamp.nanosec if stamp.sec or stamp.nanosec else recorded * 1e-9
            rows.append((float(seconds), dict(_values(message))))
    if not rows:
        raise BadInput(f"{path} topic {topic}", "has no messages")
    return topic, *_columns(rows)


def _chosen(path: Path, topics: Iterable[str], wanted: str | None) -> str:
    there = sorted(topics)
    if len(there) > 1 and wanted is None:
        raise BadInput(str(path), f"has joint states of {shown(there)}: choose one as `group` of the sweep")
    return wanted or there[0]


def _columns(rows: Sequence[tuple[float, dict[str, float]]]) -> tuple[Array, dict[str, Array]]:
    """Clock (n,) from the first message, s, and columns (n,) by name."""
    names = list(dict.fromkeys(name for _, values in rows for name in values))
    clock = np.array([stamp for stamp, _ in rows])
    return clock - clock[0], {name: np.array([values.get(name, np.nan) for _, values in rows]) for name in names}


def _json_states(path: Path) -> dict[str, list[tuple[float, dict[str, float]]]]:
    """Stamps, s, and values by topic, of an MCAP file of JSON; the topics of single joints are one."""
    if not path.is_file():
        return {}
    states: dict[str, list[tuple[float, dict[str, float]]]] = {}
    with path.open("rb") as stream:
        if not stream.read(5).endswith(b"MCAP"):
            return {}
        stream.seek(0)
        count, foreign = 0, dict[str, str]()
        for _, channel, message in make_reader(stream).iter_messages():
            if channel.message_encoding != "json":
                continue
            count += 1
            check_numbers(count, 4, MOST_NUMBERS, str(path))
            try:
                content = _Message.model_validate_json(message.data)
            except ValidationError as error:
                foreign.setdefault(channel.topic, f"message {count}: {error.errors()[0]['msg']}")
                continue
            values = dict(_json_values(content, channel.topic))
            if values:
                said = content.timestamp or content.header.stamp
                seconds = said.sec + 1e-9 * (said.nanosec or said.nsec)
                states.setdefault(channel.topic, []).append((seconds or message.log_time * 1e-9, values))
    for topic in states.keys() & foreign.keys():
        raise BadInput(f"{path} topic {topic}", foreign[topic])
    return states


def _json_values(content: _Message, topic: str) -> Iterator[tuple[str, float]]:
    for joint in content.joints:
        yield from _numbers(joint.name, (joint.position, joint.velocity, joint.effort))
    for row, joint in enumerate(content.name):
        lists = (content.position, content.velocity, content.effort)
        yield from _numbers(joint, (one[row] if isinstance(one, list) and row < len(one) else None for one in lists))
    if not content.joints and not content.name:
        yield from _numbers(topic.strip("/"), (content.position, content.velocity, content.effort))


def _numbers(joint: str, values: Iterable[float | list[float] | None]) -> Iterator[tuple[str, float]]:
    for what, value in zip(("position", "velocity", "effort"), values, strict=True):
        if isinstance(value, float):
            yield f"{joint}.{what}", value


def _values(message: Any) -> Iterator[tuple[str, float]]:
    for what in ("position", "velocity", "effort"):
        for joint, value in zip(message.name, getattr(message, what), strict=False):
            yield f"{joint}.{what}", float(value)
