"""Compares the drive with what a connection will write, object by object, and with the mapping of its PDOs.

Nothing is written: a value that differs is a note, because the connection writes it and reads it back before energy.
What can never be written is a mismatch: an object that is missing or read-only, a command, a value that does not fit.
"""

import struct
from collections.abc import Callable, Iterable, Iterator

from drivers.canopen import configuration
from drivers.canopen.bus_load import check_bus_load
from drivers.canopen.configuration import Setting
from drivers.canopen.device_map import Way
from drivers.canopen.objects import Entry
from drivers.canopen.sdo import ObjectAbsent
from drivers.canopen.units import Codec
from drivers.cia402.device import Mode
from drivers.commission.objects import mappable
from drivers.commission.read_only_drive import COMMANDS, Node
from drivers.commission.sheet import Row
from drivers.errors import LimitExceeded, WrongConfiguration


def of_map(node: Node) -> Iterator[Row]:
    """Objects that must hold a value before the units are read, and the manufacturer's settings; a missing one is
    refused.
    """
    makers = [(Entry(m.index, m.sub, m.type, m.name), m.value) for m in node.machine.maker_settings]
    for check, wanted in (("map-setting", [(s.entry, s.value) for s in node.map.settings]), ("maker-setting", makers)):
        for entry, value in wanted:
            error = _obstacle(node, entry, value)
            if error:
                yield node.row(check, False, error)
        yield from _differences(node, check, wanted)


def standing(node: Node, units: Codec) -> Iterator[Row]:
    """Stop reactions, heartbeats, cycle times, ramps."""
    machine = node.machine
    yield from _all(
        node, "setting", lambda: configuration.standing(node.axis, machine.bus, machine.stop_options, units, node.map)
    )


def limits(node: Node, units: Codec) -> Iterator[Row]:
    """The profile's limits, where the drive has objects for them."""
    axis = node.axis
    yield from _all(
        node,
        "limit",
        lambda: configuration.limits(units, axis.velocity_limit, axis.effort_limit, axis.position_limits, node.map),
    )


def way_of(node: Node) -> tuple[Way | None, list[Row]]:
    """The excitation that a sweep will use, and whether the drive can move to poses."""
    rows: list[Row] = []
    modes = node.of_map("supported_modes")
    if modes is not None and not modes >> (Mode.PROFILE_POSITION - 1) & 1:
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
    elif node.value(node.map.entry(way.target)) is None and not _own_sweep(node):
        target = node.map.entry(way.target)
        rows.append(node.row("no-excitation", False, f"{target}: the drive does not give the target of {way.value}"))
        way = None
    else:
        rows.append(node.row("excitation", True, f"{way.value} ({node.map.entry(way.target).index:04X}h)"))
    return way, rows


def mapping(node: Node, way: Way) -> Iterator[Row]:
    """The PDOs of a streamed sweep, written and read back, and the bus load."""
    refused = [*mappable(node, way)]
    yield from refused
    if refused:
        return
    pdos = configuration.pdos(node.map, way, node.axis.node)
    try:
        mapped = [configuration.pdos_are_mapped(node.sdo, (pdo,)) for pdo in pdos]
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


def _own_sweep(node: Node) -> bool:
    return node.map.measuring is not None


def _all(node: Node, check: str, make: Callable[[], tuple[Setting, ...]]) -> Iterator[Row]:
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


def _obstacle(node: Node, entry: Entry, value: float) -> str:
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


def _differences(node: Node, check: str, wanted: Iterable[Setting]) -> Iterator[Row]:
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
