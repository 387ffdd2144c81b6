"""The profile of drives on CANopen: bus, clocks and nodes.

Drive units on the motor side <-> SI on the joint side, by the unit objects of the drive.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from drivers.canopen.device_map import SPEEDS, VIRTUAL_AXIS, DeviceMap, DeviceUnits, load_device_map
from drivers.canopen.frames import Wires
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
