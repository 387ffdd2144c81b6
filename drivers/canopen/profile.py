"""The profile of drives on CANopen: bus, clocks and nodes.

Drive units on the motor side <-> SI on the joint side, by the unit objects of the drive.

The device map of a type of drive (docs/reference/device-map.md): index and unit of its objects, contents of its
PDOs, how a set-point enters, which objects are missing and what replaces them.

An object that a map does not name is at its CiA 402 index (`STANDARD`).
"""

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from drivers.bounded_yaml import read_mapping
from drivers.canopen.frames import Wires
from drivers.cia402.device import OperationMode
from drivers.cia402.profile import (
    AxisProfile,
    Frozen,
    Gear,
    StopOptions,
    TravelLimits,
    existing_file,
    parse,
    require_different,
    require_near,
)
from drivers.eds import object_dictionary
from drivers.errors import BadProfile, LimitExceeded, WrongConfiguration
from drivers.ports import Array


@dataclass(frozen=True, slots=True)
class Entry:
    """One object with its wire type (struct code, little endian) and its name in messages, which may differ."""

    index: int
    sub: int
    type: str
    name: str = field(compare=False)

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.sub:02X} {self.name}"

    @property
    def type_name(self) -> str:
        """The type as device maps name it, "i32"."""
        return next(name for name, letter in TYPES.items() if letter == self.type)

    def pack(self, value: float) -> bytes:
        """The bytes of the value. Raises struct.error if it does not fit the type."""
        return struct.pack("<" + self.type, value if self.type == "d" else int(value))

    def unpack(self, data: bytes) -> float:
        """The value of the bytes. Raises struct.error if their number is wrong."""
        value: float = struct.unpack("<" + self.type, data)[0]
        return value


class Cia301:
    """Objects of every CANopen node that the adapter uses; they are the same in every map."""

    DEVICE_TYPE = Entry(0x1000, 0, "I", "device type")
    ERROR_HISTORY = Entry(0x1003, 1, "I", "latest error")
    HEARTBEAT_CONSUMER = Entry(0x1016, 1, "I", "heartbeat consumer")
    HEARTBEAT_PRODUCER = Entry(0x1017, 0, "H", "heartbeat producer in ms")
    SYNC_COUNTER = Entry(0x1019, 0, "B", "synchronous counter overflow")
    VENDOR = Entry(0x1018, 1, "I", "vendor")
    PRODUCT = Entry(0x1018, 2, "I", "product")
    REVISION = Entry(0x1018, 3, "I", "revision")
    SERIAL = Entry(0x1018, 4, "I", "serial number")
    SERVO_DRIVE = 0x192
    """Low word of `DEVICE_TYPE`: CiA 402."""


TYPES = {"i8": "b", "u8": "B", "i16": "h", "u16": "H", "i32": "i", "u32": "I"}
WireType = Literal["i8", "u8", "i16", "u16", "i32", "u32"]

STANDARD = {
    "sync_period": Entry(0x1006, 0, "I", "communication cycle in us"),
    "connection_loss": Entry(0x6007, 0, "h", "abort connection option"),
    "error_code": Entry(0x603F, 0, "H", "error code"),
    "controlword": Entry(0x6040, 0, "H", "controlword"),
    "statusword": Entry(0x6041, 0, "H", "statusword"),
    "quick_stop_option": Entry(0x605A, 0, "h", "quick stop option"),
    "shutdown_option": Entry(0x605B, 0, "h", "shutdown option"),
    "disable_option": Entry(0x605C, 0, "h", "disable operation option"),
    "halt_option": Entry(0x605D, 0, "h", "halt option"),
    "fault_option": Entry(0x605E, 0, "h", "fault reaction option"),
    "mode": Entry(0x6060, 0, "b", "mode of operation"),
    "mode_display": Entry(0x6061, 0, "b", "mode of operation display"),
    "position": Entry(0x6064, 0, "i", "position"),
    "velocity": Entry(0x606C, 0, "i", "velocity"),
    "max_torque": Entry(0x6072, 0, "H", "max torque"),
    "rated_current": Entry(0x6075, 0, "I", "rated current in mA"),
    "rated_torque": Entry(0x6076, 0, "I", "rated torque in 10^-3 N m"),
    "torque": Entry(0x6077, 0, "h", "torque"),
    "current": Entry(0x6078, 0, "h", "current"),
    "target_position": Entry(0x607A, 0, "i", "target position"),
    "position_min": Entry(0x607D, 1, "i", "lower position limit"),
    "position_max": Entry(0x607D, 2, "i", "upper position limit"),
    "max_profile_velocity": Entry(0x607F, 0, "I", "max profile velocity"),
    "max_speed": Entry(0x6080, 0, "I", "max motor speed"),
    "profile_velocity": Entry(0x6081, 0, "I", "profile velocity"),
    "profile_acceleration": Entry(0x6083, 0, "I", "profile acceleration"),
    "profile_deceleration": Entry(0x6084, 0, "I", "profile deceleration"),
    "quick_stop_deceleration": Entry(0x6085, 0, "I", "quick stop deceleration"),
    "increments": Entry(0x608F, 1, "I", "encoder increments"),
    "motor_revolutions": Entry(0x608F, 2, "I", "motor revolutions"),
    "velocity_unit": Entry(0x60A9, 0, "I", "velocity unit"),
    "velocity_offset": Entry(0x60B1, 0, "i", "velocity offset"),
    "interpolated_position": Entry(0x60C1, 1, "i", "interpolated position"),
    "cycle_value": Entry(0x60C2, 1, "B", "interpolation period"),
    "cycle_exponent": Entry(0x60C2, 2, "b", "interpolation period's power of ten"),
    "target_velocity": Entry(0x60FF, 0, "i", "target velocity"),
    "supported_modes": Entry(0x6502, 0, "I", "supported drive modes"),
    "sample_counter": Entry(0x2120, 1, "I", "sample counter"),
}
NEEDED = frozenset(  # required to move and to measure
    {"controlword", "statusword", "mode", "mode_display", "position", "velocity", "target_position", "profile_velocity"}
)
PDO_TYPES = {  # required types of objects in PDOs
    "statusword": "u16", "velocity": "i32", "torque": "i16", "current": "i16", "position": "i32",
    "sample_counter": "u32", "target_velocity": "i32", "target_position": "i32", "interpolated_position": "i32",
    "velocity_offset": "i32", "controlword": "u16",
}  # fmt: skip

# Revolutions per second of one raw unit; None: given by an object or by the encoder.
SPEEDS: dict[str, float | None] = {
    "60A9h": None,
    "increments/s": None,
    "rev/min": 1 / 60,
    "1e-3 rev/min": 1e-3 / 60,
    "1e-3 deg/s": 1e-3 / 360,
}
Speed = Literal["60A9h", "increments/s", "rev/min", "1e-3 rev/min", "1e-3 deg/s"]
OtherSpeed = Literal["velocity", "increments/s", "rev/min", "1e-3 rev/min", "1e-3 deg/s"]


class SetPointWay(Enum):
    """How the set-points of a streamed sweep enter the drive: mode of operation, and object that receives them.

    `VELOCITY_OFFSET` is added to a profile of the drive that stands still (60FFh = 0). It bypasses the ramps of the
    profile, and without it the drive commands standstill.
    """

    CYCLIC_VELOCITY = "cyclic_velocity"
    CYCLIC_POSITION = "cyclic_position"
    INTERPOLATED_POSITION = "interpolated_position"
    VELOCITY_OFFSET = "velocity_offset"

    @property
    def positions(self) -> bool:
        """True if the host sends positions, False if it sends velocities."""
        return self in (SetPointWay.CYCLIC_POSITION, SetPointWay.INTERPOLATED_POSITION)

    @property
    def target(self) -> str:
        """Name of the target object in the map."""
        return {SetPointWay.CYCLIC_VELOCITY: "target_velocity", SetPointWay.CYCLIC_POSITION: "target_position"}.get(
            self, self.value
        )

    def mode(self, supported: int | None) -> OperationMode | None:
        """The mode to use among those `supported` (6502h; None: unknown); None if the drive has none."""
        for mode in (
            (OperationMode.CYCLIC_VELOCITY, OperationMode.PROFILE_VELOCITY)
            if self is SetPointWay.VELOCITY_OFFSET
            else (OperationMode[self.name],)
        ):
            if supported is None or supported >> (mode - 1) & 1:
                return mode
        return None


class ObjectPlace(Frozen):
    """Index and type of an object that differ from CiA 402."""

    index: int = Field(ge=0x1000, le=0x9FFF)
    sub: int = Field(default=0, ge=0, le=255)
    type: WireType


class MapSetting(ObjectPlace):
    """An object that must hold this value, in drive units, before the units are read; otherwise it is refused."""

    name: str
    value: int

    @property
    def entry(self) -> Entry:
        return Entry(self.index, self.sub, TYPES[self.type], self.name)


class DeviceUnits(Frozen):
    """Units of raw values. Revolutions are those of `side`."""

    side: Literal["motor", "joint"] = "motor"
    increments: float | Literal["608Fh", "profile"] = "608Fh"  # position increments per revolution
    velocity: Speed = "60A9h"
    acceleration: OtherSpeed = "velocity"  # this velocity unit per second
    max_speed: OtherSpeed = "velocity"
    rated_torque: float = Field(default=1e-3, gt=0)  # N m per raw unit of the rated torque
    effort: Literal["torque", "current"] = "torque"  # per mille of rated torque, or of rated current


class Pdos(Frozen):
    """Numbers of the PDOs: RPDO `set_point` carries controlword and target, RPDO `stop` (if any) only the controlword.

    TPDO `state` carries statusword, velocity and effort; TPDO `place` position and sample counter, or position and
    velocity.
    """

    set_point: int = Field(default=1, ge=1, le=4)
    stop: int | None = Field(default=None, ge=1, le=4)
    state: int = Field(default=1, ge=1, le=4)
    place: int = Field(default=2, ge=1, le=4)
    cob_id: Literal["writable", "fixed"] = "writable"  # fixed: a PDO is disabled by setting its number of objects to 0
    unused_rpdos: tuple[int, ...] = ()  # to be disabled
    unused_tpdos: tuple[int, ...] = ()


class DeviceMap(Frozen):
    """A checked map."""

    description: str = ""
    vendor: int | None = None
    product: int | None = None
    objects: Mapping[str, ObjectPlace] = {}
    units: DeviceUnits = DeviceUnits()
    pdos: Pdos = Pdos()
    excitation: tuple[SetPointWay, ...] = Field(
        default=(SetPointWay.CYCLIC_VELOCITY,), min_length=1
    )  # the first one that the drive supports (6502h) is used
    streaming_needs: tuple[str, ...] = ("cycle_value",)  # objects that tell the drive the cycle time
    samples: Literal["counter", "window"] = "window"
    measuring: Literal["sweepid"] | None = None  # drive's own sweep; "sweepid": docs/reference/virtual-drive.md
    settings: tuple[MapSetting, ...] = ()
    missing: Mapping[str, str] = {}  # object: what replaces it

    @model_validator(mode="after")
    def _consistent(self) -> "DeviceMap":
        for key, named in (
            ("objects", self.objects),
            ("missing", self.missing),
            ("streaming_needs", self.streaming_needs),
        ):
            if unknown := sorted(set(named) - STANDARD.keys()):
                raise ValueError(f"{key}: {unknown} are unknown")
        if needless := sorted(NEEDED & self.missing.keys()):
            raise ValueError(f"missing: {needless} are needed to move and measure an axis")
        for name, place in self.objects.items():
            if place.type != PDO_TYPES.get(name, place.type):
                raise ValueError(f"objects.{name}: type must be {PDO_TYPES[name]}")
        if lacking := sorted(self.used() & self.missing.keys()):
            raise ValueError(f"missing: {lacking} are used by this map")
        self._check_pdos()
        return self

    def used(self) -> set[str]:
        """Objects that may be missing only if the map has another way."""
        used = {self.units.effort, *(way.target for way in self.excitation)}
        for used_so, name in (
            (self.units.effort == "current", "rated_current"),
            (self.units.increments == "608Fh", "increments"),
            (self.units.velocity == "60A9h", "velocity_unit"),
            (self.samples == "counter", "sample_counter"),
        ):
            if used_so:
                used.add(name)
        return used

    def _check_pdos(self) -> None:
        pdos = self.pdos
        receive = [pdos.set_point, *([] if pdos.stop is None else [pdos.stop]), *pdos.unused_rpdos]
        transmit = [pdos.state, pdos.place, *pdos.unused_tpdos]
        for kind, numbers in (("RPDO", receive), ("TPDO", transmit)):
            if len(set(numbers)) < len(numbers) or not set(numbers) <= {1, 2, 3, 4}:
                raise ValueError(f"pdos: {kind} {numbers} must each be different, 1 to 4")
        if pdos.stop is None and any(way.positions for way in self.excitation):
            raise ValueError(
                "pdos.stop is missing: a drive that follows positions needs an RPDO with the controlword and no target"
            )

    def entry(self, name: str) -> Entry:
        standard, place = STANDARD[name], self.objects.get(name)
        return standard if place is None else Entry(place.index, place.sub, TYPES[place.type], standard.name)

    @property
    def effort(self) -> Entry:
        """The object that reports the effort."""
        return self.entry(self.units.effort)

    @property
    def wires(self) -> Wires:
        pdos = self.pdos
        return Wires(pdos.set_point, pdos.stop, pdos.state, pdos.place, counted=self.samples == "counter")


VIRTUAL_AXIS = DeviceMap(
    description="Virtual drive: own sweep, own trace, own sample counter",
    vendor=0x5357,
    streaming_needs=("sync_period",),
    samples="counter",
    measuring="sweepid",
)
"""Default map of a profile that names none, equal to config/devices/virtual-axis.yaml."""


def load_device_map(path: Path) -> DeviceMap:
    """BadProfile names the file, the place and the reason."""
    try:
        return parse(DeviceMap, read_mapping(path, "description"))
    except BadProfile as error:
        raise BadProfile(f"device: {path}: {error}") from None


def bits(entry: Entry) -> int:
    """Length of the object's value, bits."""
    return 8 * struct.calcsize("<" + entry.type)


class BusProfile(Frozen):
    """Address of the bus, in the terms of python-can, and its clocks. Times in s."""

    interface: str  # socketcand, socketcan, virtual, pcan, ...
    channel: str
    host: str | None = None  # of a socketcand gateway
    port: int | None = Field(default=None, ge=1, le=65535)
    bitrate: int | None = Field(default=None, gt=0)  # bit/s, where the interface sets it
    sync_period: float = Field(default=0.004, ge=0.001, le=0.1)  # cycle of host-streamed sweeps
    host_node: int = Field(default=127, ge=1, le=127)  # node id of our own heartbeat
    host_heartbeat: float = Field(default=0.1, gt=0)
    host_timeout: float = Field(default=1.0, gt=0, le=60)  # the drive stops after this silence of the host
    drive_heartbeat: float = Field(default=0.1, gt=0, le=60)
    drive_timeout: float = Field(default=1.0, gt=0)  # a node silent for longer is lost
    missed_cycles: int = Field(default=0, ge=0)  # allowed number of missed deadlines of a streamed sweep
    silence: float = Field(default=0.15, gt=0)  # a streaming axis silent for longer is lost
    sdo_timeout: float = Field(default=0.5, gt=0)

    @model_validator(mode="after")
    def _consistent(self) -> "BusProfile":
        if abs(self.sync_period * 1e3 - round(self.sync_period * 1e3)) > 1e-9:
            raise ValueError(f"sync_period {self.sync_period} s must be whole milliseconds")
        if self.interface == "socketcand" and (self.host is None or self.port is None):
            raise ValueError("socketcand needs host and port")
        if self.host_timeout < 2 * self.host_heartbeat or self.drive_timeout < 2 * self.drive_heartbeat:
            raise ValueError("a heartbeat's time-out must be at least twice its period")
        return self

    def waits(self, wires: Wires) -> bool:
        """Whether the host delays SYNC until all drives have answered: no sample counter, and late cycles allowed."""
        return self.missed_cycles > 0 and not wires.counted


class MakerSetting(Frozen):
    """A manufacturer's object that must hold a value, in drive units. A missing or different object is refused."""

    name: str
    index: int = Field(ge=0x2000, le=0x5FFF)
    sub: int = Field(default=0, ge=0, le=255)
    type: Literal["b", "B", "h", "H", "i", "I"]  # 8, 16, 32 bits; capitals unsigned
    value: int


class CanopenAxis(AxisProfile):
    """One axis and its node."""

    node: int = Field(ge=1, le=126)
    increments: float | None = Field(
        default=None, gt=0
    )  # position increments per motor revolution, if the map requires it
    torque_constant: float | None = Field(default=None, gt=0)  # N m/A, if the effort is reported as a current


class _Content(Frozen):
    """A profile as it is written in the file."""

    adapter: Literal["canopen"]
    bus: BusProfile
    eds: Path
    device: Path | None = None  # the device map; default: that of the virtual drive
    emergency_stop_codes: tuple[int, ...] = ()  # 603Fh values that mean safe torque off
    stop_options: StopOptions = StopOptions()
    travel_limits: TravelLimits = TravelLimits()
    maker_settings: tuple[MakerSetting, ...] = ()
    axes: tuple[CanopenAxis, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> "_Content":
        nodes = [axis.node for axis in self.axes]
        require_different(self.axes, "nodes", nodes)
        if self.bus.host_node in nodes:
            raise ValueError(f"host_node {self.bus.host_node} is the node of an axis")
        require_near(self.axes, self.travel_limits, self.bus.host_timeout, "bus.host_timeout")
        return self


class CanopenProfile(_Content):
    """A whole machine: one bus, its axes, and their type of drive."""

    device_map: DeviceMap = VIRTUAL_AXIS


def parse_profile(profile: Mapping[str, object], base: Path) -> CanopenProfile:
    """A checked profile with its device map. `eds` is an existing file, relative to `base` unless it is absolute."""
    parsed = parse(_Content, profile)
    eds = existing_file("eds", base / parsed.eds)
    _check_eds(parsed, eds)
    device_map = (
        VIRTUAL_AXIS if parsed.device is None else load_device_map(existing_file("device", base / parsed.device))
    )
    _check_map(parsed, device_map)
    return parse(CanopenProfile, dict(parsed) | {"eds": eds, "device_map": device_map})


def _check_map(profile: _Content, device_map: DeviceMap) -> None:
    """Raises BadProfile unless the map is for the devices of the profile, which have the values that it requires."""
    units = device_map.units
    for axis in profile.axes:
        found = (device_map.vendor, device_map.product)
        given = (axis.identity.vendor, axis.identity.product)
        for name, of_map, of_axis in zip(("vendor", "product"), found, given, strict=True):
            if profile.device is not None and of_map not in (None, of_axis):
                raise BadProfile(
                    f"device: {profile.device} is for {name} {of_map:08X}h; {axis.joint} is {of_axis:08X}h"
                )
        if units.increments == "profile" and axis.increments is None:
            raise BadProfile(f"axes: {axis.joint}: increments is missing: the device map says `increments: profile`")
        if units.effort == "current" and axis.torque_constant is None:
            raise BadProfile(
                f"axes: {axis.joint}: torque_constant is missing: the drive reports a current, "
                "so the profile must give N m/A"
            )
        if units.side == "joint" and axis.gear_ratio < 0:
            raise BadProfile(
                f"axes: {axis.joint}: gear_ratio must be above 0 for a drive that counts on the joint side"
            )


def _check_eds(profile: _Content, eds: Path) -> None:
    """Raises BadProfile unless the EDS is for the devices of the profile (CiA 306, section DeviceInfo).

    Some manufacturers omit vendor or product there, or write 0; the drives report them at connect.
    """
    try:
        about: Any = object_dictionary(eds, 1).device_information
    except (OSError, ValueError) as error:
        raise BadProfile(f"eds: {eds}: {error}") from None
    stated_numbers = {"Vendor": about.vendor_number, "Product": about.product_number}
    found = {key: number for key, number in stated_numbers.items() if number}
    for axis in profile.axes:
        given = {"Vendor": axis.identity.vendor, "Product": axis.identity.product}
        if found != {key: given[key] for key in found}:
            stated = ", ".join(f"{key.lower()} {number:08X}h" for key, number in found.items())
            raise BadProfile(
                f"eds: {eds} is for {stated}; {axis.joint} is {given['Vendor']:08X}h, {given['Product']:08X}h"
            )


@dataclass(frozen=True, slots=True)
class Codec(Gear):
    """One axis' conversions. Raw values are the integers on the wire; `rated_torque` is that of 6076h."""

    increments: float  # per motor revolution, 608Fh; divided by the gear ratio if the drive counts on the joint side
    velocity_unit: float  # motor rev/s per raw unit, 60A9h
    acceleration_unit: float | None = None  # motor rev/s^2 per raw unit; None: velocity units per s
    max_speed_unit: float | None = None  # motor rev/s per raw unit of 6080h; None: velocity units
    rated_effort: float | None = None  # N m of the motor at 1000 per mille; None: rated torque

    def position(self, raw: Array | float) -> Array:
        """6064h -> rad (m)."""
        return self.motor_position(np.asarray(raw) / self.increments)

    def velocity(self, raw: Array | float) -> Array:
        """606Ch -> rad/s (m/s)."""
        return np.asarray(raw) * (self.velocity_unit * math.tau / self.gear_ratio)

    def effort(self, raw: Array | float) -> Array:
        """6077h, per mille of rated torque (6078h: of rated current) -> N m (N)."""
        rated = self.rated_torque if self.rated_effort is None else self.rated_effort
        return np.asarray(raw) * (1e-3 * rated * self.gear_ratio)

    def raw_position(self, position: float) -> int:
        """rad (m) -> increments; LimitExceeded beyond 32 bits."""
        return _int32((position - self.position_offset) * self.gear_ratio / math.tau * self.increments, "position")

    def raw_velocity(self, velocity: float) -> int:
        """rad/s (m/s) -> 60A9h units, signed; LimitExceeded beyond 32 bits."""
        return _int32(velocity * self.gear_ratio / math.tau / self.velocity_unit, "velocity")

    def raw_speed(self, speed: float) -> int:
        """Magnitude of a speed, rad/s (m/s) -> 60A9h units; LimitExceeded beyond 32 bits."""
        return abs(self.raw_velocity(speed))

    def raw_acceleration(self, acceleration: float) -> int:
        """rad/s^2 (m/s^2) -> drive units, at least 1."""
        if self.acceleration_unit is None:
            return self.raw_speed(acceleration)
        return max(1, abs(_int32(acceleration * self.gear_ratio / math.tau / self.acceleration_unit, "acceleration")))

    def raw_max_speed(self, speed: float) -> int:
        """Magnitude of a speed in the unit of 6080h."""
        if self.max_speed_unit is None:
            return self.raw_speed(speed)
        return math.ceil(abs(speed * self.gear_ratio / math.tau / self.max_speed_unit))

    def raw_effort_limit(self, effort: float) -> int:
        """N m (N) -> per mille of rated torque, rounded down, at most the 16-bit maximum."""
        return min(math.floor(self.permille(effort)), 0xFFFF)

    def raw_window(self, window: tuple[float, float]) -> tuple[int, int]:
        """Joint limits, rad (m) -> increments, low before high for either sign of the gear ratio, of 32 bits."""
        scale = self.gear_ratio / math.tau * self.increments
        low, high = sorted((limit - self.position_offset) * scale for limit in window)
        return max(math.floor(low), -(2**31)), min(math.ceil(high), 2**31 - 1)


def codec(axis: CanopenAxis, units: DeviceUnits, rated_torque: float, read: Callable[[str], float]) -> Codec:
    """Built from the unit objects of the drive, the map and the profile; `read` returns an object of the map.
    `rated_torque` N m.

    Raises WrongConfiguration for unknown units.
    """
    turn = axis.gear_ratio if units.side == "joint" else 1.0  # motor revolutions per revolution of the counted side
    if units.increments == "608Fh":
        increments = read("increments") / max(1.0, read("motor_revolutions")) / turn
    elif units.increments == "profile":
        increments = axis.increments or math.nan  # never NaN: the profile check requires it
    else:
        increments = units.increments / turn

    def speed(unit: str) -> float | None:
        """Motor rev/s per raw unit; None: as the velocity."""
        if unit == "60A9h":
            return velocity_unit(int(read("velocity_unit")), increments * turn) * turn
        if unit == "increments/s":
            return 1 / increments
        known = SPEEDS.get(unit)
        return None if known is None else known * turn

    rated = None
    if units.effort == "current":
        rated = read("rated_current") * 1e-3 * (axis.torque_constant or math.nan)  # never NaN: see above
    return Codec(
        gear_ratio=axis.gear_ratio,
        position_offset=axis.position_offset,
        rated_torque=rated_torque,
        increments=increments,
        velocity_unit=speed(units.velocity) or 0.0,
        acceleration_unit=speed(units.acceleration),
        max_speed_unit=speed(units.max_speed),
        rated_effort=rated,
    )


def velocity_unit(code: int, increments: float) -> float:
    """60A9h -> motor rev/s per raw unit. WrongConfiguration unless it is revolutions (B4h) or increments (B5h) per s
    (03h) or min (47h).
    """
    prefix = (code >> 24) - 256 if code >> 31 else code >> 24
    numerator, denominator = (code >> 16) & 0xFF, (code >> 8) & 0xFF
    revolutions = {0xB4: 1.0, 0xB5: 1.0 / increments}.get(numerator)
    seconds = {0x03: 1.0, 0x47: 60.0}.get(denominator)
    if revolutions is None or seconds is None or not -9 <= prefix <= 9:
        raise WrongConfiguration(f"60A9h: velocity unit {code:08X}h is not 10^x rev or increments per s or min")
    return 10.0**prefix * revolutions / seconds


def _int32(value: float, what: str) -> int:
    if not abs(value) < 2**31 - 1:
        raise LimitExceeded(f"{what} {value:.6g} in drive units does not fit 32 bits")
    return round(value)
