"""Typed SDO access to one node, and the values that the objects of an axis must hold before it may move.

Each object is read, written if it differs, and read back (`Sdo.settle`). PDOs are configured only in NMT
pre-operational, as CiA 301 requires. Blocking, for one thread at a time.
"""

import struct
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

import can
import canopen
from canopen.sdo.client import BlockUploadStream, SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.canopen import frames
from drivers.canopen.profile import STANDARD, BusProfile, Cia301, Codec, DeviceMap, Entry, SetPointWay, bits
from drivers.cia402.profile import AxisProfile, StopOptions
from drivers.errors import CauseCode, CommunicationLost, WrongConfiguration


class SharedSdoClient(SdoClient):
    """One of several clients of a node: the stop process also asks it for its state, and its answers reach everybody.

    An answer that names another object than the request (CiA 301, initiate services) is somebody else's; an abort that
    names none is taken for ours.
    """

    initiating = frozenset({*range(0x20, 0x30), 0x40, *range(0xA0, 0xA8, 4), *range(0xC0, 0xC8, 2)})
    """Requests that name an object: download, upload, block upload, block download."""

    _object: bytes | None = None  # index and sub-index of the request; None: a segment or block, which names none

    def send_request(self, request: bytes) -> None:
        self._object = bytes(request[1:4]) if request[0] in SharedSdoClient.initiating else None
        cast(Any, super()).send_request(request)

    def on_response(self, can_id: int, data: bytes, timestamp: float) -> None:
        if self._object is None or bytes(data[1:4]) in (self._object, bytes(3)):
            cast(Any, super()).on_response(can_id, data, timestamp)


class RemoteNode(canopen.RemoteNode):
    """With this client."""

    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> SdoClient:
        client = SharedSdoClient(rx_cobid, tx_cobid, self.object_dictionary)
        cast(Any, self).sdo_channels.append(client)
        return client


class _BlockUpload(BlockUploadStream):
    """canopen 2.4 calls `abort` of the stream if a block is missing, but the stream has no such method."""

    def abort(self, code: int) -> None:
        cast(Any, self.sdo_client).abort(code)


class ObjectAbsent(WrongConfiguration, code=CauseCode.WRONG_CONFIGURATION):
    """The drive does not have an object."""


class OtherType(WrongConfiguration, code=CauseCode.WRONG_CONFIGURATION):
    """The drive has the object, with another length."""


class Sdo:
    """Reads and writes objects of one node. Raises CommunicationLost if the node does not answer."""

    def __init__(self, client: SdoClient, place: str, check_alive: Callable[[], None]) -> None:
        """`place` as in "joint_1 (node 1)"; `check_alive` raises CommunicationLost once the bus is lost."""
        self.client = client
        self.place = place
        self._check_alive = check_alive

    def read(self, entry: Entry) -> float:
        """WrongConfiguration if the drive refuses; ObjectAbsent, OtherType if it has no such object or type."""
        self._check_alive()
        try:
            return entry.unpack(self._answer(entry))
        except (SdoAbortedError, SdoCommunicationError, can.CanError, OSError) as error:
            raise self._explain(entry, error) from None
        except struct.error as error:
            raise OtherType(
                self.place, f"{entry}: the drive's value has another type than the dictionary says: {error}"
            ) from None

    def integer(self, entry: Entry) -> int:
        return int(self.read(entry))

    def write(self, entry: Entry, value: float) -> None:
        """Errors as `read`; the value is not read back."""
        self._check_alive()
        try:
            self.client.download(entry.index, entry.sub, entry.pack(value))
        except (SdoAbortedError, SdoCommunicationError, can.CanError, OSError) as error:
            raise self._explain(entry, error, f" = {value:g}") from None
        except struct.error as error:
            raise WrongConfiguration(self.place, f"{entry} cannot hold {value:g}: {error}") from None

    def settle(self, entry: Entry, value: float) -> None:
        """Write `value` if the object holds another, and read it back. WrongConfiguration if it differs then."""
        if self.read(entry) == value:
            return
        self.write(entry, value)
        got = self.read(entry)
        if got != value:
            raise WrongConfiguration(self.place, f"{entry}: wrote {value:g}, drive holds {got:g}")

    def settle_all(self, settings: Iterable["Setting"]) -> frozenset[Entry]:
        """Settle each object. Returns those that the drive does not have. WrongConfiguration if one differs."""
        absent: set[Entry] = set()
        for entry, value in settings:
            try:
                self.settle(entry, value)
            except ObjectAbsent:
                absent.add(entry)
        return frozenset(absent)

    def settle_sync(self) -> None:
        """SYNC without a counter byte: a drive in which 1019h is not 0 refuses such a SYNC with error 8240h (CiA 301,
        7.2.5). 1019h may be changed only while 1006h is 0, which `session_settings` sets afterwards.
        """
        try:
            if not self.read(Cia301.SYNC_COUNTER):
                return
        except ObjectAbsent:
            return
        with suppress(ObjectAbsent):
            self.settle(STANDARD["sync_period"], 0)
        self.settle(Cia301.SYNC_COUNTER, 0)

    def upload(self, index: int, sub: int, block: bool) -> bytes:
        """A DOMAIN, by block or segmented transfer."""
        entry = Entry(index, sub, "s", "domain")
        self._check_alive()
        try:
            if not block:
                return self.client.upload(index, sub)
            with _BlockUpload(self.client, index, sub) as stream:
                return cast(bytes, stream.read())
        except (SdoAbortedError, SdoCommunicationError, can.CanError, OSError) as error:
            raise self._explain(entry, error) from None

    def _answer(self, entry: Entry) -> bytes:
        return self.client.upload(entry.index, entry.sub)

    def _explain(self, entry: Entry, error: Exception, value: str = "") -> WrongConfiguration | CommunicationLost:
        if not isinstance(error, SdoAbortedError):
            return CommunicationLost(self.place, f"{entry}{value}: {error}")
        absent = error.code in (0x06020000, 0x06090011)  # object, sub-index does not exist
        kind = ObjectAbsent if absent else WrongConfiguration
        return kind(self.place, f"{entry}{value}: {error}")


Setting = tuple[Entry, float]

INVALID = 1 << 31  # of a PDO's COB-ID
NO_RTR = 1 << 30  # of a TPDO's COB-ID: stays as the manufacturer set it
SYNCHRONOUS = 1  # transmission type: every SYNC


@dataclass(frozen=True, slots=True)
class PdoMapping:
    """Required state of one PDO: communication and mapping object, COB-ID of the node, mapped objects."""

    communication: int
    mapping: int
    identifier: int
    mapped: tuple[Entry, ...]


def streaming_pdos(device_map: DeviceMap, way: SetPointWay, node: int) -> tuple[PdoMapping, ...]:
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


def _rpdo(number: int, node: int, *mapped: Entry) -> PdoMapping:
    return PdoMapping(0x13FF + number, 0x15FF + number, frames.rpdo_id(number) + node, mapped)


def _tpdo(number: int, node: int, *mapped: Entry) -> PdoMapping:
    return PdoMapping(0x17FF + number, 0x19FF + number, frames.tpdo_id(number) + node, mapped)


def session_settings(
    axis: AxisProfile, bus: BusProfile, options: StopOptions, codec: Codec, device_map: DeviceMap
) -> tuple[Setting, ...]:
    """Settings for the whole session: stop reactions, heartbeats, cycle times, ramps."""
    milliseconds = round(bus.sync_period * 1e3)
    at = device_map.entry
    return (
        (Cia301.HEARTBEAT_PRODUCER, round(bus.drive_heartbeat * 1e3)),
        (Cia301.HEARTBEAT_CONSUMER, bus.host_node << 16 | round(bus.host_timeout * 1e3)),
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


def limit_settings(
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


def configure_pdos(sdo: Sdo, wanted: tuple[PdoMapping, ...], device_map: DeviceMap, node: int) -> bool:
    """Map the PDOs unless they are already mapped as required. Returns False if the drive lacks an object for that."""
    fixed = device_map.pdos.cob_id == "fixed"
    try:
        receive = [_rpdo(number, node) for number in device_map.pdos.unused_rpdos]
        for pdo in (*receive, *(_tpdo(number, node) for number in device_map.pdos.unused_tpdos)):
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


def pdos_are_mapped(sdo: Sdo, wanted: tuple[PdoMapping, ...]) -> bool:
    """Whether the PDOs are mapped as required; read before each host-streamed sweep."""
    return all(_is_mapped(sdo, pdo) for pdo in wanted)


def _identifier(pdo: PdoMapping) -> Entry:
    return Entry(pdo.communication, 1, "I", "COB-ID")


def _switch_off(sdo: Sdo, pdo: PdoMapping, fixed: bool) -> None:
    if fixed:
        sdo.settle(Entry(pdo.mapping, 0, "B", "number of mapped objects"), 0)
    else:
        found = sdo.integer(_identifier(pdo))
        if not found & INVALID:  # other bits may be changed only after this one is set (CiA 301)
            sdo.write(_identifier(pdo), INVALID | found)


def _is_mapped(sdo: Sdo, pdo: PdoMapping) -> bool:
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
