"""Checks that the drive has each object that the adapter needs: present, of another type, or missing with a
replacement.
"""

from collections.abc import Iterator

from drivers.canopen import configuration
from drivers.canopen.device_map import NEEDED, STANDARD, TYPES, Way
from drivers.canopen.objects import HEARTBEAT_CONSUMER, HEARTBEAT_PRODUCER, Entry
from drivers.canopen.sdo import OtherType
from drivers.commission.read_only_drive import Node
from drivers.commission.sheet import Row
from drivers.errors import WrongConfiguration

_WIRE = {letter: name for name, letter in TYPES.items()}
_INSTEAD = {  # replacement if the drive has no such object
    "max_torque": "host: the envelope of each motion watches the effort",
    "max_speed": "host: the envelope of each motion watches the speed",
    "max_profile_velocity": "host: no move is commanded faster than velocity_limit",
    "position_min": "host: the envelope of each motion watches the position",
    "position_max": "host: the envelope of each motion watches the position",
    "connection_loss": "not monitored: a person must stay at the emergency stop while the machine moves",
    "heartbeat consumer": "not monitored: a person must stay at the emergency stop while the machine moves",
    "error_code": "reported by EMCY",
    "supported_modes": "the first excitation mode of the map is used",
    "rated_torque": "profile: rated_torque",
}
_ITSELF = "the drive has its own method: see the maker's manual"


def present(node: Node) -> Iterator[Row]:
    """Every object of the map and the heartbeats."""
    needed = NEEDED | _used(node) | set(node.map.streaming_needs) | {"rated_torque"}
    for name in STANDARD:
        entry = node.map.entry(name)
        if name in node.missing:
            yield node.host(f"object {name}", f"{entry}: missing, as the map says: {node.missing[name]}")
        elif _wanted(node, name):
            yield _there(node, name, entry, name in needed)
    yield _there(node, "heartbeat producer", HEARTBEAT_PRODUCER, True)
    yield _there(node, "heartbeat consumer", HEARTBEAT_CONSUMER, False)


def mappable(node: Node, way: Way) -> Iterator[Row]:
    """Whether the objects may be mapped to a PDO according to the EDS; `settings` checks whether the drive
    accepts it.
    """
    for pdo in configuration.pdos(node.map, way, node.axis.node):
        for entry in pdo.mapped:
            listed = node.dictionary.objects.get((entry.index, entry.sub))
            if listed is not None and not listed.mappable:
                yield node.row("not-mappable", False, f"{entry}: the EDS says that no PDO may carry it")


def _used(node: Node) -> set[str]:
    """Objects that the map requires. One of its ways of excitation is sufficient (`settings` selects it)."""
    targets = {way.target for way in node.map.excitation}
    return node.map.used() - targets | {"target_position"}


def _wanted(node: Node, name: str) -> bool:
    """Whether the object is ever used."""
    return name not in _ONLY_WITH or name in node.map.used()


_ONLY_WITH = {
    "current", "rated_current", "increments", "motor_revolutions", "velocity_unit", "interpolated_position",
    "target_velocity", "velocity_offset", "sample_counter", "torque",
}  # fmt: skip


def _there(node: Node, name: str, entry: Entry, needed: bool) -> Row:
    listed = node.dictionary.objects.get((entry.index, entry.sub))
    found = node.answer(entry)
    if isinstance(found, OtherType):
        return node.row(
            "wrong-type", False, f"{entry}: the drive's value is not {_WIRE[entry.type]}, as the map has it"
        )
    if node.absent(entry):
        if needed:
            return node.row("missing-object", False, f"{entry}: the drive does not have it, and nothing replaces it")
        if listed is not None:
            return node.row(
                "eds-differs", False, f"{entry}: in the EDS and not in the drive: the EDS is of another firmware"
            )
        return node.host(f"object {name}", f"{entry}: missing: {_INSTEAD.get(name, _ITSELF)}")
    if isinstance(found, WrongConfiguration):
        return node.row("refused-object", False, f"{entry}: the drive does not report its value: {found}")
    if listed is not None and listed.type != _WIRE[entry.type]:
        return node.row(
            "type-in-eds", False, f"{entry}: {listed.type or 'no number'} in the EDS, {_WIRE[entry.type]} in the map"
        )
    if entry in node.sdo.long:
        return node.note(f"object {name}", f"{entry}: present, sent in 4 bytes, of which {_WIRE[entry.type]} is used")
    if listed is None:
        return node.row(
            "eds-differs", False, f"{entry}: in the drive and not in the EDS: the EDS is of another firmware"
        )
    return node.row(f"object {name}", True, f"{entry}: present, {_WIRE[entry.type]}, {found:.0f}")
