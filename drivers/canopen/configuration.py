"""Values that the objects of an axis must hold before it may move, and the fallback if the drive lacks an object.

Each object of a list is read, written if it differs, and read back (`Sdo.settle`). PDOs are configured only in NMT
pre-operational, as CiA 301 requires.
"""

from contextlib import suppress
from dataclasses import dataclass

from drivers.canopen import frames, objects
from drivers.canopen.device_map import DeviceMap, Way, bits
from drivers.canopen.objects import Entry
from drivers.canopen.profile import BusProfile
from drivers.canopen.sdo import ObjectAbsent, Sdo
from drivers.canopen.units import Codec
from drivers.cia402.profile import AxisProfile, StopOptions
from drivers.errors import WrongConfiguration

Setting = tuple[Entry, float]

INVALID = 1 << 31  # of a PDO's COB-ID
NO_RTR = 1 << 30  # of a TPDO's COB-ID: stays as the manufacturer set it
SYNCHRONOUS = 1  # transmission type: every SYNC


@dataclass(frozen=True, slots=True)
class Pdo:
    """Required state of one PDO: communication and mapping object, COB-ID of the node, mapped objects."""

    communication: int
    mapping: int
    identifier: int
    mapped: tuple[Entry, ...]


def pdos(device_map: DeviceMap, way: Way, node: int) -> tuple[Pdo, ...]:
    """The PDOs of a streamed sweep, with the numbers of the map."""
    entry, numbers = device_map.entry, device_map.pdos
    second = entry("sample_counter" if device_map.samples == "counter" else "velocity")
    wanted = [_rpdo(numbers.set_point, node, entry("controlword"), entry(way.target))]
    if numbers.stop is not None:
        wanted.append(_rpdo(numbers.stop, node, entry("controlword")))
    wanted += [
        _tpdo(numbers.state, node, entry("statusword"), entry("velocity"), device_map.effort),
        _tpdo(numbers.place, node, entry("position"), second),
    ]
    return tuple(wanted)


def _rpdo(number: int, node: int, *mapped: Entry) -> Pdo:
    return Pdo(0x13FF + number, 0x15FF + number, frames.rpdo_id(number) + node, mapped)


def _tpdo(number: int, node: int, *mapped: Entry) -> Pdo:
    return Pdo(0x17FF + number, 0x19FF + number, frames.tpdo_id(number) + node, mapped)


def settle(sdo: Sdo, settings: tuple[Setting, ...]) -> frozenset[Entry]:
    """Settle each object. Returns the objects that the drive does not have. Raises WrongConfiguration if one
    differs.
    """
    absent: set[Entry] = set()
    for entry, value in settings:
        try:
            sdo.settle(entry, value)
        except ObjectAbsent:
            absent.add(entry)
    return frozenset(absent)


def settle_sync(sdo: Sdo) -> None:
    """SYNC without a counter byte: a drive in which 1019h is not 0 refuses such a SYNC with error 8240h (CiA 301,
    7.2.5).

    1019h may be changed only while 1006h is 0. `standing` sets 1006h afterwards.
    """
    try:
        if not sdo.read(objects.SYNC_COUNTER):
            return
    except ObjectAbsent:
        return
    with suppress(ObjectAbsent):
        sdo.settle(objects.SYNC_PERIOD, 0)
    sdo.settle(objects.SYNC_COUNTER, 0)


def standing(
    axis: AxisProfile, bus: BusProfile, options: StopOptions, codec: Codec, device_map: DeviceMap
) -> tuple[Setting, ...]:
    """Settings for the whole session: stop reactions, heartbeats, cycle times, ramps."""
    milliseconds = round(bus.sync_period * 1e3)
    at = device_map.entry
    return (
        (objects.HEARTBEAT_PRODUCER, round(bus.drive_heartbeat * 1e3)),
        (objects.HEARTBEAT_CONSUMER, bus.host_node << 16 | round(bus.host_timeout * 1e3)),
        (at("connection_loss"), options.connection_loss),
        (at("quick_stop_option"), options.quick_stop),
        (at("shutdown_option"), options.shutdown),
        (at("disable_option"), options.disable_operation),
        (at("halt_option"), options.halt),
        (at("fault_option"), options.fault_reaction),
        (at("sync_period"), milliseconds * 1000),
        (at("cycle_value"), milliseconds),
        (at("cycle_exponent"), -3),
        (at("profile_acceleration"), codec.raw_acceleration(axis.acceleration)),
        (at("profile_deceleration"), codec.raw_acceleration(axis.acceleration)),
        (at("quick_stop_deceleration"), codec.raw_acceleration(axis.quick_stop_deceleration)),
    )


def limits(
    codec: Codec, velocity: float, effort: float, window: tuple[float, float], device_map: DeviceMap
) -> tuple[Setting, ...]:
    """Limits of one motion, SI on the joint side."""
    low, high = codec.raw_window(window)
    at = device_map.entry
    return (
        (at("max_torque"), codec.raw_effort_limit(effort)),
        (at("max_profile_velocity"), codec.raw_speed(velocity)),  # a change of the velocity unit changes its meaning
        (at("max_speed"), codec.raw_max_speed(velocity)),
        (at("position_min"), low),
        (at("position_max"), high),
    )


def configure_pdos(sdo: Sdo, wanted: tuple[Pdo, ...], device_map: DeviceMap, node: int) -> bool:
    """Map the PDOs unless they are already mapped as required. Returns False if the drive lacks an object for that."""
    fixed = device_map.pdos.cob_id == "fixed"
    try:
        for pdo in _unused(device_map, node):
            _switch_off(sdo, pdo, fixed)
        for pdo in wanted:
            if not _is_mapped(sdo, pdo):
                _switch_off(sdo, pdo, fixed)
                sdo.settle(Entry(pdo.communication, 2, "B", "transmission type"), SYNCHRONOUS)
                sdo.write(Entry(pdo.mapping, 0, "B", "number of mapped objects"), 0)
                for number, entry in enumerate(pdo.mapped, start=1):
                    sdo.settle(Entry(pdo.mapping, number, "I", f"mapping {number}"), _packed(entry))
                sdo.settle(Entry(pdo.mapping, 0, "B", "number of mapped objects"), len(pdo.mapped))
                if not fixed:
                    sdo.write(_identifier(pdo), sdo.integer(_identifier(pdo)) & NO_RTR | pdo.identifier)
                if not _is_mapped(sdo, pdo):
                    found = sdo.integer(_identifier(pdo))
                    raise WrongConfiguration(f"{_identifier(pdo)}: is {found:08X}h, must be {pdo.identifier:08X}h")
    except ObjectAbsent:
        return False
    return True


def pdos_are_mapped(sdo: Sdo, wanted: tuple[Pdo, ...]) -> bool:
    """Whether the PDOs are mapped as required; read before each host-streamed sweep."""
    return all(_is_mapped(sdo, pdo) for pdo in wanted)


def _unused(device_map: DeviceMap, node: int) -> list[Pdo]:
    numbers = device_map.pdos
    receive = [_rpdo(number, node) for number in numbers.unused_rpdos]
    return [*receive, *(_tpdo(number, node) for number in numbers.unused_tpdos)]


def _identifier(pdo: Pdo) -> Entry:
    return Entry(pdo.communication, 1, "I", "COB-ID")


def _switch_off(sdo: Sdo, pdo: Pdo, fixed: bool) -> None:
    if fixed:
        sdo.settle(Entry(pdo.mapping, 0, "B", "number of mapped objects"), 0)
    else:
        found = sdo.integer(_identifier(pdo))
        if not found & INVALID:  # other bits may be changed only after this one is set (CiA 301)
            sdo.write(_identifier(pdo), INVALID | found)


def _is_mapped(sdo: Sdo, pdo: Pdo) -> bool:
    if sdo.integer(_identifier(pdo)) & ~NO_RTR != pdo.identifier:
        return False
    wanted: list[Setting] = [
        (Entry(pdo.communication, 2, "B", "transmission type"), SYNCHRONOUS),
        (Entry(pdo.mapping, 0, "B", "number of mapped objects"), len(pdo.mapped)),
    ]
    wanted += [(Entry(pdo.mapping, k, "I", f"mapping {k}"), _packed(entry)) for k, entry in enumerate(pdo.mapped, 1)]
    return all(sdo.read(entry) == value for entry, value in wanted)


def _packed(entry: Entry) -> int:
    return entry.index << 16 | entry.sub << 8 | bits(entry)
