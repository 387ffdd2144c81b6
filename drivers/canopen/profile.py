"""The drive profile: what a person knows of the drives before the bus is opened."""

from collections.abc import Mapping
from configparser import ConfigParser
from configparser import Error as ConfigError
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from drivers.errors import BadProfile


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class BusProfile(_Frozen):
    """Where the bus is, in python-can's words, and its clocks. Times in s."""

    interface: str  # socketcand, socketcan, virtual, pcan, ...
    channel: str
    host: str | None = None  # of a socketcand gateway
    port: int | None = Field(default=None, ge=1, le=65535)
    bitrate: int | None = Field(default=None, gt=0)  # bit/s, where the interface sets it
    sync_period: float = Field(default=0.004, ge=0.001, le=0.1)  # cycle of host-streamed sweeps
    host_node: int = Field(default=127, ge=1, le=127)  # node id of our own heartbeat
    host_heartbeat: float = Field(default=0.1, gt=0)
    host_timeout: float = Field(default=1.0, gt=0, le=60)  # the drive stops after this silence of ours
    drive_heartbeat: float = Field(default=0.1, gt=0, le=60)
    drive_timeout: float = Field(default=1.0, gt=0)  # a node silent for so long is lost
    silence: float = Field(default=0.15, gt=0)  # a streaming axis silent for so long is lost
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


class StopOptions(_Frozen):
    """CiA 402 option codes 605Ah-605Eh and 6007h; makers differ, so they stand in the profile."""

    quick_stop: int = 2  # 605Ah: quick stop ramp, then switch on disabled
    shutdown: int = 0  # 605Bh: disable the drive function
    disable_operation: int = 1  # 605Ch: slow down, then disable
    halt: int = 1  # 605Dh: slow down, stay enabled
    fault_reaction: int = 2  # 605Eh: quick stop ramp
    connection_loss: int = 3  # 6007h: quick stop


class MakerSetting(_Frozen):
    """An object of the maker's that must hold a value, in drive units; absent or different is refused."""

    name: str
    index: int = Field(ge=0x2000, le=0x5FFF)
    sub: int = Field(default=0, ge=0, le=255)
    type: Literal["b", "B", "h", "H", "i", "I"]  # 8, 16, 32 bits; capitals unsigned
    value: int


class IdentityProfile(_Frozen):
    """Object 1018h as it must be."""

    vendor: int
    product: int
    revision: int


class AxisProfile(_Frozen):
    """One axis. Joint side in rad or m as `unit` says; `rated_torque` is the motor's, N m."""

    joint: str = Field(min_length=1)
    node: int = Field(ge=1, le=126)
    identity: IdentityProfile
    unit: Literal["rad", "m"] = "rad"
    gear_ratio: float  # motor revolutions per joint revolution; prismatic: motor rad per m; signed
    rated_torque: float = Field(gt=0)  # checked against 6076h
    load_encoder: bool = False  # a direct encoder on the joint, in the measuring function's trace
    position_offset: float = 0.0  # joint position where the motor encoder reads zero
    position_limits: tuple[float, float]
    velocity_limit: float = Field(gt=0)  # 1/s
    effort_limit: float = Field(gt=0)  # N m (N)
    acceleration: float = Field(gt=0)  # 1/s^2, positioning moves and the stop ladder's first rung
    quick_stop_deceleration: float = Field(gt=0)  # 1/s^2
    standstill_velocity: float = Field(gt=0)  # 1/s, above the noise of the speed reading

    @model_validator(mode="after")
    def _consistent(self) -> "AxisProfile":
        if self.gear_ratio == 0:
            raise ValueError("gear_ratio must not be 0")
        if self.load_encoder and self.unit == "m":
            raise ValueError("load_encoder: the trace gives it in revolutions, which a linear axis does not make")
        low, high = self.position_limits
        if low >= high:
            raise ValueError(f"position_limits: {low} is not below {high}")
        return self

    @property
    def effort_unit(self) -> str:
        return "N m" if self.unit == "rad" else "N"


class CanopenProfile(_Frozen):
    """A whole machine: one bus, its axes."""

    adapter: Literal["canopen"]
    bus: BusProfile
    eds: Path
    emergency_stop_codes: tuple[int, ...] = ()  # 603Fh values that mean safe torque off
    stop_options: StopOptions = StopOptions()
    maker_settings: tuple[MakerSetting, ...] = ()
    axes: tuple[AxisProfile, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> "CanopenProfile":
        joints = [axis.joint for axis in self.axes]
        nodes = [axis.node for axis in self.axes]
        if len(set(joints)) < len(joints) or len(set(nodes)) < len(nodes):
            raise ValueError(f"joints {joints} and nodes {nodes} must each be different")
        if self.bus.host_node in nodes:
            raise ValueError(f"host_node {self.bus.host_node} is the node of an axis")
        return self


def parse_profile(profile: Mapping[str, object], base: Path) -> CanopenProfile:
    """A checked profile whose `eds` is an existing file, relative to `base` where it is not absolute."""
    try:
        parsed = CanopenProfile.model_validate(profile)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "profile"
        given = "" if isinstance(first["input"], Mapping) else f" (given: {first['input']!r})"
        raise BadProfile(f"{place}: {first['msg']}{given}") from None
    eds = base / parsed.eds
    if not eds.is_file():
        raise BadProfile(f"eds: no file {eds}")
    _check_eds(parsed, eds)
    return parsed.model_copy(update={"eds": eds})


def _check_eds(profile: CanopenProfile, eds: Path) -> None:
    """BadProfile unless the EDS is for the devices of the profile (CiA 306, section DeviceInfo)."""
    parser = ConfigParser(interpolation=None, strict=False)
    try:
        parser.read(eds, encoding="utf-8")
        device = parser["DeviceInfo"]
        found = (int(device["VendorNumber"], 0), int(device["ProductNumber"], 0))
    except (ConfigError, KeyError, ValueError) as error:
        raise BadProfile(f"eds: {eds} has no usable section DeviceInfo: {error}") from None
    for axis in profile.axes:
        if found != (axis.identity.vendor, axis.identity.product):
            raise BadProfile(
                f"eds: {eds} is for vendor {found[0]:08X}h, product {found[1]:08X}h; {axis.joint} is "
                f"{axis.identity.vendor:08X}h, {axis.identity.product:08X}h"
            )
