"""What an axis' objects must hold before it may move, and what follows where the drive has no such object.

Every list is settled object by object: read, written where it differs, read back (`Sdo.settle`). The PDOs are
configured in NMT pre-operational only, as CiA 301 wants it.
"""

from drivers.canopen import frames, objects
from drivers.canopen.objects import Entry
from drivers.canopen.profile import BusProfile
from drivers.canopen.sdo import ObjectAbsent, Sdo
from drivers.canopen.units import Codec
from drivers.cia402.profile import AxisProfile, StopOptions

Setting = tuple[Entry, float]

INVALID = 1 << 31  # of a PDO's COB-ID
SYNCHRONOUS = 1  # transmission type: every SYNC

# PDO: communication object, mapping object, COB-ID without node, mapped objects (index, sub, bits)
PDOS = (
    (0x1400, 0x1600, frames.RPDO1, ((0x6040, 0, 16), (0x60FF, 0, 32))),
    (0x1800, 0x1A00, frames.TPDO1, ((0x6041, 0, 16), (0x606C, 0, 32), (0x6077, 0, 16))),
    (0x1801, 0x1A01, frames.TPDO2, ((0x6064, 0, 32), (0x2120, 1, 32))),
)

LIMITS = frozenset({objects.MAX_TORQUE, objects.MAX_MOTOR_SPEED, objects.POSITION_MIN, objects.POSITION_MAX})


def settle(sdo: Sdo, settings: tuple[Setting, ...]) -> frozenset[Entry]:
    """Settles each object; gives the objects that the drive does not have. WrongConfiguration where one differs."""
    absent: set[Entry] = set()
    for entry, value in settings:
        try:
            sdo.settle(entry, value)
        except ObjectAbsent:
            absent.add(entry)
    return frozenset(absent)


def standing(axis: AxisProfile, bus: BusProfile, options: StopOptions, codec: Codec) -> tuple[Setting, ...]:
    """What holds for the whole session: stop reactions, heartbeats, cycle times, ramps."""
    milliseconds = round(bus.sync_period * 1e3)
    return (
        (objects.HEARTBEAT_PRODUCER, round(bus.drive_heartbeat * 1e3)),
        (objects.HEARTBEAT_CONSUMER, bus.host_node << 16 | round(bus.host_timeout * 1e3)),
        (objects.CONNECTION_LOSS, options.connection_loss),
        (objects.QUICK_STOP_OPTION, options.quick_stop),
        (objects.SHUTDOWN_OPTION, options.shutdown),
        (objects.DISABLE_OPTION, options.disable_operation),
        (objects.HALT_OPTION, options.halt),
        (objects.FAULT_OPTION, options.fault_reaction),
        (objects.SYNC_PERIOD, milliseconds * 1000),
        (objects.CYCLE_VALUE, milliseconds),
        (objects.CYCLE_EXPONENT, -3),
        (objects.PROFILE_ACCELERATION, codec.raw_speed(axis.acceleration)),
        (objects.PROFILE_DECELERATION, codec.raw_speed(axis.acceleration)),
        (objects.QUICK_STOP_DECELERATION, codec.raw_speed(axis.quick_stop_deceleration)),
    )


def limits(codec: Codec, velocity: float, effort: float, window: tuple[float, float]) -> tuple[Setting, ...]:
    """The limits of one motion, SI on the joint side."""
    low, high = codec.raw_window(window)
    return (
        (objects.MAX_TORQUE, codec.raw_effort_limit(effort)),
        (objects.MAX_MOTOR_SPEED, codec.raw_speed(velocity)),
        (objects.POSITION_MIN, low),
        (objects.POSITION_MAX, high),
    )


def configure_pdos(sdo: Sdo, node: int) -> bool:
    """Maps the three PDOs unless they are as wanted; False if the drive lacks an object for that."""
    try:
        for communication, mapping, cob_id, mapped in PDOS:
            if not _is_mapped(sdo, communication, mapping, cob_id + node, mapped):
                identifier = Entry(communication, 1, "I", "COB-ID")
                sdo.write(identifier, INVALID | cob_id + node)
                sdo.settle(Entry(communication, 2, "B", "transmission type"), SYNCHRONOUS)
                sdo.write(Entry(mapping, 0, "B", "number of mapped objects"), 0)
                for number, entry in enumerate(mapped, start=1):
                    sdo.settle(Entry(mapping, number, "I", f"mapping {number}"), _packed(entry))
                sdo.settle(Entry(mapping, 0, "B", "number of mapped objects"), len(mapped))
                sdo.settle(identifier, cob_id + node)
    except ObjectAbsent:
        return False
    return True


def pdos_are_mapped(sdo: Sdo, node: int) -> bool:
    """Read back before each host-streamed sweep."""
    return all(_is_mapped(sdo, a, b, cob_id + node, mapped) for a, b, cob_id, mapped in PDOS)


def _is_mapped(
    sdo: Sdo, communication: int, mapping: int, cob_id: int, mapped: tuple[tuple[int, int, int], ...]
) -> bool:
    wanted: list[Setting] = [
        (Entry(communication, 1, "I", "COB-ID"), cob_id),
        (Entry(communication, 2, "B", "transmission type"), SYNCHRONOUS),
        (Entry(mapping, 0, "B", "number of mapped objects"), len(mapped)),
    ]
    wanted += [(Entry(mapping, k, "I", f"mapping {k}"), _packed(entry)) for k, entry in enumerate(mapped, start=1)]
    return all(sdo.read(entry) == value for entry, value in wanted)


def _packed(entry: tuple[int, int, int]) -> int:
    index, sub, bits = entry
    return index << 16 | sub << 8 | bits
