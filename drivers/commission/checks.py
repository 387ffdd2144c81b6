"""Checks without energy: the node is the drive of the profile and at rest, it has each object that the adapter needs,
and what a connection will write differs from what it holds.

Nothing is written: a value that differs is a note, because the connection writes it and reads it back before energy.
What can never be written is a mismatch: an object that is missing or read-only, a command, a value that does not fit.
"""

import math
import struct
from collections.abc import Callable, Iterable, Iterator

from drivers.canopen.fieldbus import check_bus_load
from drivers.canopen.profile import NEEDED, STANDARD, CanopenAxis, Cia301, Codec, Entry, SetPointWay
from drivers.canopen.sdo import (
    ObjectAbsent,
    OtherType,
    Setting,
    limit_settings,
    pdos_are_mapped,
    session_settings,
    streaming_pdos,
)
from drivers.cia402 import states
from drivers.cia402.device import OperationMode
from drivers.cia402.states import PowerState, Statusword
from drivers.commission.drive import COMMANDS, CheckedNode, CheckRow
from drivers.errors import LimitExceeded, WrongConfiguration

_NAMES = ("vendor", "product", "revision", "serial")


def state(node: CheckedNode) -> Iterator[CheckRow]:
    """The drive has no energy and no fault, and its fieldbus controls it."""
    word = node.of_map("statusword")
    if word is None:
        return  # reported by `objects`
    found = states.decode(word)
    if found in states.ENERGISED:
        yield node.row(
            "energy", False, f"the drive is in '{found.value}' and this program did not enable it: disable the drive"
        )
    elif found in (PowerState.FAULT, PowerState.UNKNOWN):
        code = node.of_map("error_code")
        yield node.row(
            "fault", False, f"the drive is in '{found.value}'" + ("" if code is None else f", error {code:04X}h")
        )
    else:
        yield node.row("energy", True, f"none: '{found.value}'")
    remote = bool(word & Statusword.REMOTE)
    what = f"statusword {word:04X}h: bit 9 (remote) is {remote:d}"
    yield node.row(
        "remote", remote, what if remote else f"{what}: the drive does not obey the fieldbus: end its local mode"
    )


def who(node: CheckedNode) -> Iterator[CheckRow]:
    """Type, 1018h and rated torque. A drive that fits another axis of the profile is reported as swapped."""
    kind = node.value(Cia301.DEVICE_TYPE)
    fits = kind is not None and kind & 0xFFFF == Cia301.SERVO_DRIVE
    yield node.row("device-type", fits, f"1000h is {_hex(kind)}, a CiA 402 drive ends in 0192h")
    found = [node.value(entry) for entry in (Cia301.VENDOR, Cia301.PRODUCT, Cia301.REVISION, Cia301.SERIAL)]
    torque = rated_torque(node)
    wrong = [*_different(node.axis, found)]
    for name, have, want in zip(_NAMES, found, _identity_of(node.axis), strict=True):
        if want is None:
            yield node.note(
                name, f"{_hex(have)}; the profile has none, so a swapped drive of this type is not detected"
            )
        else:
            yield node.row(name, name not in wrong, f"the drive reports {_hex(have)}, the profile has {_hex(want)}")
    if torque is None:
        who_does = node.missing.get("rated_torque", "the drive does not report it")
        yield node.host("rated-torque", f"{node.axis.rated_torque:.4g} N m is not compared: {who_does}")
    else:
        yield node.row(
            "rated-torque",
            _alike(torque, node.axis),
            f"6076h: the motor has {torque:.4g} N m, the profile {node.axis.rated_torque:.4g} N m",
        )
    if wrong or (torque is not None and not _alike(torque, node.axis)):
        yield from _swapped(node, found, torque)


def rated_torque(node: CheckedNode) -> float | None:
    """Rated torque of the motor stored in the drive, N m; None if it is not reported."""
    raw = node.of_map("rated_torque")
    return None if raw is None else raw * node.map.units.rated_torque


def _swapped(node: CheckedNode, found: list[int | None], torque: float | None) -> Iterator[CheckRow]:
    for other in node.machine.axes:
        if other is node.axis or _different(other, found) or (torque is not None and not _alike(torque, other)):
            continue
        yield node.row(
            "swapped-nodes",
            False,
            f"node {node.axis.node} answers as the drive of {other.joint} (node {other.node}): node numbers or cables",
        )


def _identity_of(axis: CanopenAxis) -> tuple[int | None, ...]:
    identity = axis.identity
    return identity.vendor, identity.product, identity.revision, identity.serial


def _different(axis: CanopenAxis, found: list[int | None]) -> list[str]:
    pairs = zip(_NAMES, found, _identity_of(axis), strict=True)
    return [name for name, have, want in pairs if want is not None and have != want]


def _alike(torque: float, axis: CanopenAxis) -> bool:
    return math.isclose(torque, axis.rated_torque, rel_tol=2e-3)  # as at connect


def _hex(value: int | None) -> str:
    return "nothing" if value is None else f"{value:08X}h"


def present(node: CheckedNode) -> Iterator[CheckRow]:
    """Every object of the map and the heartbeats."""
    needed = NEEDED | _used(node) | set(node.map.streaming_needs) | {"rated_torque"}
    for name in STANDARD:
        entry = node.map.entry(name)
        if name in node.missing:
            yield node.host(f"object {name}", f"{entry}: missing, as the map says: {node.missing[name]}")
        elif _wanted(node, name):
            yield _there(node, name, entry, name in needed)
    yield _there(node, "heartbeat producer", Cia301.HEARTBEAT_PRODUCER, True)
    yield _there(node, "heartbeat consumer", Cia301.HEARTBEAT_CONSUMER, False)


def _used(node: CheckedNode) -> set[str]:
    """Objects that the map requires. One of its ways of excitation is sufficient (`settings` selects it)."""
    targets = {way.target for way in node.map.excitation}
    return node.map.used() - targets | {"target_position"}


def _wanted(node: CheckedNode, name: str) -> bool:
    """Whether the object is ever used."""
    only_with = {
        "current", "rated_current", "increments", "motor_revolutions", "velocity_unit", "interpolated_position",
        "target_velocity", "velocity_offset", "sample_counter", "torque",
    }  # fmt: skip
    return name not in only_with or name in node.map.used()


def _there(node: CheckedNode, name: str, entry: Entry, needed: bool) -> CheckRow:
    instead_of = {  # replacement if the drive has no such object
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
    listed = node.dictionary.objects.get((entry.index, entry.sub))
    found = node.answer(entry)
    if isinstance(found, OtherType):
        return node.row("wrong-type", False, f"{entry}: the drive's value is not {entry.type_name}, as the map has it")
    if node.absent(entry):
        if needed:
            return node.row("missing-object", False, f"{entry}: the drive does not have it, and nothing replaces it")
        if listed is not None:
            return node.row(
                "eds-differs", False, f"{entry}: in the EDS and not in the drive: the EDS is of another firmware"
            )
        instead = instead_of.get(name, "the drive has its own method: see the maker's manual")
        return node.host(f"object {name}", f"{entry}: missing: {instead}")
    if isinstance(found, WrongConfiguration):
        return node.row("refused-object", False, f"{entry}: the drive does not report its value: {found}")
    if listed is not None and listed.type != entry.type_name:
        return node.row(
            "type-in-eds", False, f"{entry}: {listed.type or 'no number'} in the EDS, {entry.type_name} in the map"
        )
    if entry in node.sdo.long:
        return node.note(f"object {name}", f"{entry}: present, sent in 4 bytes, of which {entry.type_name} is used")
    if listed is None:
        return node.row(
            "eds-differs", False, f"{entry}: in the drive and not in the EDS: the EDS is of another firmware"
        )
    return node.row(f"object {name}", True, f"{entry}: present, {entry.type_name}, {found:.0f}")


def of_map(node: CheckedNode) -> Iterator[CheckRow]:
    """Values that must be held before the units are read, and maker settings; a missing object is refused."""
    makers = [(Entry(m.index, m.sub, m.type, m.name), m.value) for m in node.machine.maker_settings]
    for check, wanted in (("map-setting", [(s.entry, s.value) for s in node.map.settings]), ("maker-setting", makers)):
        for entry, value in wanted:
            error = _obstacle(node, entry, value)
            if error:
                yield node.row(check, False, error)
        yield from _differences(node, check, wanted)


def standing(node: CheckedNode, units: Codec) -> Iterator[CheckRow]:
    """Stop reactions, heartbeats, cycle times, ramps."""
    machine = node.machine
    yield from _all(
        node, "setting", lambda: session_settings(node.axis, machine.bus, machine.stop_options, units, node.map)
    )


def limits(node: CheckedNode, units: Codec) -> Iterator[CheckRow]:
    """The profile's limits, where the drive has objects for them."""
    axis = node.axis
    yield from _all(
        node,
        "limit",
        lambda: limit_settings(units, axis.velocity_limit, axis.effort_limit, axis.position_limits, node.map),
    )


def way_of(node: CheckedNode) -> tuple[SetPointWay | None, list[CheckRow]]:
    """The excitation that a sweep will use, and whether the drive can move to poses."""
    rows: list[CheckRow] = []
    modes = node.of_map("supported_modes")
    if modes is not None and not modes >> (OperationMode.PROFILE_POSITION - 1) & 1:
        rows.append(
            node.row("no-profile-position", False, f"6502h is {modes:08X}h: the drive cannot move to a position")
        )
    there = [way for way in node.map.excitation if way.mode(modes) is not None]
    way = there[0] if there else None
    wanted = ", ".join(each.value for each in node.map.excitation)
    if way is None:
        rows.append(
            node.row(
                "no-excitation", False, f"6502h is {modes or 0:08X}h: none of the map's excitation modes: {wanted}"
            )
        )
    elif node.value(node.map.entry(way.target)) is None and node.map.measuring is None:
        target = node.map.entry(way.target)
        rows.append(node.row("no-excitation", False, f"{target}: the drive does not give the target of {way.value}"))
        way = None
    else:
        rows.append(node.row("excitation", True, f"{way.value} ({node.map.entry(way.target).index:04X}h)"))
    return way, rows


def mapping(node: CheckedNode, way: SetPointWay) -> Iterator[CheckRow]:
    """The PDOs of a streamed sweep, by the EDS and as the drive holds them, and the bus load."""
    pdos = streaming_pdos(node.map, way, node.axis.node)
    listed = node.dictionary.objects
    entries = [entry for pdo in pdos for entry in pdo.mapped if (entry.index, entry.sub) in listed]
    refused = [entry for entry in entries if not listed[entry.index, entry.sub].mappable]
    yield from (node.row("not-mappable", False, f"{each}: the EDS says that no PDO may carry it") for each in refused)
    if refused:
        return
    try:
        mapped = [pdos_are_mapped(node.sdo, (pdo,)) for pdo in pdos]
    except ObjectAbsent:
        yield node.row("pdos", False, "the drive lacks objects for its PDOs: nothing is streamed")
    except WrongConfiguration as error:
        yield node.row("pdos", False, str(error))
    else:
        open_ones = mapped.count(False)
        what = f"{len(pdos)} mapped, transmission type 1"
        yield (
            node.row("pdos", True, what)
            if not open_ones
            else node.note(
                "pdos", f"{open_ones} of {len(pdos)} are mapped otherwise: a connection maps them, with read-back"
            )
        )
    cyclic = tuple(pdo for pdo in pdos if pdo.mapped != (node.map.entry("controlword"),))
    bus = node.machine.bus
    try:
        check_bus_load(bus, [cyclic], len(node.machine.axes))
    except LimitExceeded as error:
        yield node.row("bus-load", False, str(error))
        return
    yield (
        node.note("bus-load", "not computed: the profile has no bitrate")
        if bus.bitrate is None
        else node.row("bus-load", True, f"a sweep of this axis leaves room at {bus.bitrate} bit/s")
    )


def _all(node: CheckedNode, check: str, make: Callable[[], tuple[Setting, ...]]) -> Iterator[CheckRow]:
    """Missing objects are reported by `objects`."""
    try:
        wanted = make()
    except LimitExceeded as error:
        yield node.row(check, False, f"in drive units: {error}")
        return
    missing = {node.map.entry(name) for name in node.missing}
    there = [(entry, value) for entry, value in wanted if entry not in missing and not node.absent(entry)]
    for entry, value in there:
        error = _obstacle(node, entry, value)
        if error:
            yield node.row(check, False, error)
    yield from _differences(node, check, there)


def _obstacle(node: CheckedNode, entry: Entry, value: float) -> str:
    """Why a connection could not make the object hold the value; "" if nothing is known that prevents it."""
    found = node.answer(entry)
    if (entry.index, entry.sub) in COMMANDS:
        return f"{node.sdo.place}: {entry}: a command, which no setting may be"
    if isinstance(found, WrongConfiguration):
        return str(found)
    try:
        entry.pack(value)
    except struct.error as error:
        return f"{node.sdo.place}: {entry} cannot hold {value:g}: {error}"
    listed = node.dictionary.objects.get((entry.index, entry.sub))
    if found != value and listed is not None and not listed.writable:
        return f"{node.sdo.place}: {entry}: holds {found:g}, must hold {value:g}, and is read-only in the EDS"
    return ""


def _differences(node: CheckedNode, check: str, wanted: Iterable[Setting]) -> Iterator[CheckRow]:
    """One row for all that hold their value, one note for all that do not."""
    readable = [
        (entry, value, found)
        for entry, value in wanted
        if not isinstance(found := node.answer(entry), WrongConfiguration) and not _obstacle(node, entry, value)
    ]
    other = [f"{entry} holds {found:g}, gets {value:g}" for entry, value, found in readable if found != value]
    if readable:
        yield node.row(f"{check}s", True, f"{len(readable) - len(other)} objects hold what a connection writes")
    if other:
        yield node.note(f"{check}s", f"a connection writes: {', '.join(other)}")
