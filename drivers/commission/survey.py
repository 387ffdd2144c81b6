"""Checks every drive of a profile without energy and without a change: each axis is only read."""

import asyncio
import hashlib
import queue
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path

from drivers.canopen import frames
from drivers.canopen.bus import CanopenBus
from drivers.canopen.fieldbus import check_alone
from drivers.canopen.profile import CanopenAxis, CanopenProfile, parse_profile
from drivers.commission import checks, units
from drivers.commission.drive import CheckedNode, CheckRow, CheckSheet, CheckVerdict, ReadOnlySdo, read_dictionary
from drivers.errors import BadProfile, CommunicationLost, ConnectionFailed
from drivers.registry import load_profile


def load(path: Path) -> CanopenProfile:
    """BadProfile names the file, the place and the reason; also raised for a profile of another fieldbus."""
    content = load_profile(path)
    if content.get("adapter") != "canopen":
        raise BadProfile(
            f"{path}: adapter: {content.get('adapter')!r} is not supported by this check, only 'canopen' is: check the "
            "drives by hand, as in docs/how-to/connect-a-modbus-drive.md, section Verify"
        )
    return parse_profile(content, path.parent)


def survey(profile: CanopenProfile, name: str, files: dict[str, str] | None = None) -> CheckSheet:
    """The sheet of a machine. Raises ConnectionFailed if the bus cannot be opened. Blocking; no event loop may run."""
    ways: dict[str, str] = {}
    rows: list[CheckRow] = []
    nodes = {axis.node: axis.joint for axis in profile.axes}
    bus = CanopenBus(profile.bus, tuple(nodes), profile.device_map.wires)
    events = bus.open_stream(*nodes)
    try:
        try:
            asyncio.run(check_alone(bus, profile))
        except ConnectionFailed as error:
            rows.append(CheckRow("", "other-host", CheckVerdict.MISMATCH, str(error)))
        else:
            for axis in profile.axes:
                rows += _axis(bus, axis, profile, ways)
        rows += _announced(events, nodes)
        if bus.watch.reason:
            rows.append(CheckRow("", "other-host", CheckVerdict.MISMATCH, bus.watch.reason))
    finally:
        bus.close()
    made = datetime.now(UTC).isoformat(timespec="seconds")
    return CheckSheet(name, made, files or {}, ways, tuple(rows))


def digests(path: Path) -> dict[str, str]:
    """SHA-256 of the profile and of the files that it names, by name: the files to which the sheet applies."""
    content = load_profile(path)
    named = [path, *(path.parent / str(content[key]) for key in ("eds", "device") if content.get(key))]
    return {each.name: hashlib.sha256(each.read_bytes()).hexdigest() for each in named}


def _axis(bus: CanopenBus, axis: CanopenAxis, profile: CanopenProfile, ways: dict[str, str]) -> Iterator[CheckRow]:
    place = f"{axis.joint} (node {axis.node})"
    sdo = ReadOnlySdo(bus.add_node(axis.node, None), place, bus.check_alive)
    node = CheckedNode(axis, profile, read_dictionary(profile.eds, axis.node), sdo)
    bus.expect_nodes()  # the time of an earlier silent node does not count
    try:
        other = [*checks.who(node)]
        yield from other
        if _wrong(other):
            yield node.note("not-asked", "units, limits, settings, mapping: it is not the drive of the profile")
            yield from checks.present(node)
            return
        yield from checks.state(node)
        yield from _looked_at(node)
        yield from _compared(node, ways)
    except CommunicationLost as error:
        causes = "power, cable, node number or bit rate; a drive that a stop put into NMT stopped: switch it off and on"
        yield node.row("no-answer", False, f"{error}: {causes}")


def _wrong(rows: list[CheckRow]) -> set[str]:
    return {row.check for row in rows if row.verdict is CheckVerdict.MISMATCH}


def _announced(events: "queue.SimpleQueue[frames.Event]", joints: Mapping[int, str]) -> Iterator[CheckRow]:
    """Errors that a drive announced during the check, also if it cleared them."""
    while not events.empty():
        event = events.get()
        if isinstance(event, frames.Emergency) and event.code:
            yield CheckRow(
                joints[event.node],
                "emcy",
                CheckVerdict.MISMATCH,
                f"EMCY {event.code:04X}h during the check, {event.register:02X}h in 1001h, data {event.maker.hex()}",
            )


def _looked_at(node: CheckedNode) -> Iterator[CheckRow]:
    """Checks that only read."""
    yield from checks.present(node)
    yield from units.scale(node)
    codec, rows = units.conversions(node)
    yield from rows
    if codec is not None:
        yield from units.limits(node, codec)
        yield from units.at_rest(node, codec)


def _compared(node: CheckedNode, ways: dict[str, str]) -> Iterator[CheckRow]:
    """What a connection writes; after the settings on which its units depend, `node` is the configured drive."""
    yield from checks.of_map(node)
    node = node.configured()
    codec, rows = units.conversions(node)
    yield from rows
    if codec is None:
        return
    yield from units.resolution(node, codec)
    way, rows = checks.way_of(node)
    yield from rows
    if way is not None:
        ways[node.axis.joint] = f"{way.value} ({node.map.entry(way.target).index:04X}h)"
        yield from checks.mapping(node, way)
    yield from checks.standing(node, codec)
    yield from checks.limits(node, codec)
