"""The profile of drives on CANopen: bus, clocks and nodes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from drivers.canopen.device_map import VIRTUAL_AXIS, DeviceMap, load_device_map
from drivers.canopen.frames import Wires
from drivers.cia402.profile import (
    AxisProfile,
    Frozen,
    StopOptions,
    TravelLimits,
    existing_file,
    parse,
    require_different,
    require_near,
)
from drivers.eds import object_dictionary
from drivers.errors import BadProfile


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
