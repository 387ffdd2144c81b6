"""The device map of a type of drive (docs/reference/device-map.md): where its objects lie and in which unit, what goes
into which PDO, how a set-point enters, what it lacks and who does that instead.

What a map does not name lies where CiA 402 has it (`STANDARD`).
"""

import struct
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from drivers.canopen import objects
from drivers.canopen.frames import Wires
from drivers.canopen.objects import Entry
from drivers.cia402.device import Mode
from drivers.cia402.profile import Frozen, parse
from drivers.errors import BadProfile
from drivers.yaml_file import read_mapping

TYPES = {"i8": "b", "u8": "B", "i16": "h", "u16": "H", "i32": "i", "u32": "I"}
WireType = Literal["i8", "u8", "i16", "u16", "i32", "u32"]

STANDARD: dict[str, Entry] = {
    "sync_period": objects.SYNC_PERIOD,
    "connection_loss": objects.CONNECTION_LOSS,
    "error_code": objects.ERROR_CODE,
    "controlword": objects.CONTROLWORD,
    "statusword": objects.STATUSWORD,
    "quick_stop_option": objects.QUICK_STOP_OPTION,
    "shutdown_option": objects.SHUTDOWN_OPTION,
    "disable_option": objects.DISABLE_OPTION,
    "halt_option": objects.HALT_OPTION,
    "fault_option": objects.FAULT_OPTION,
    "mode": objects.MODE,
    "mode_display": objects.MODE_DISPLAY,
    "position": objects.POSITION,
    "velocity": objects.VELOCITY,
    "max_torque": objects.MAX_TORQUE,
    "rated_current": objects.RATED_CURRENT,
    "rated_torque": objects.RATED_TORQUE,
    "torque": objects.TORQUE,
    "current": objects.CURRENT,
    "target_position": objects.TARGET_POSITION,
    "position_min": objects.POSITION_MIN,
    "position_max": objects.POSITION_MAX,
    "max_profile_velocity": objects.MAX_PROFILE_VELOCITY,
    "max_speed": objects.MAX_MOTOR_SPEED,
    "profile_velocity": objects.PROFILE_VELOCITY,
    "profile_acceleration": objects.PROFILE_ACCELERATION,
    "profile_deceleration": objects.PROFILE_DECELERATION,
    "quick_stop_deceleration": objects.QUICK_STOP_DECELERATION,
    "increments": objects.INCREMENTS,
    "motor_revolutions": objects.MOTOR_REVOLUTIONS,
    "velocity_unit": objects.VELOCITY_UNIT,
    "velocity_offset": objects.VELOCITY_OFFSET,
    "interpolated_position": objects.INTERPOLATED_POSITION,
    "cycle_value": objects.CYCLE_VALUE,
    "cycle_exponent": objects.CYCLE_EXPONENT,
    "target_velocity": objects.TARGET_VELOCITY,
    "supported_modes": objects.SUPPORTED_MODES,
    "sample_counter": objects.SAMPLE_COUNTER,
}
NEEDED = frozenset(  # without these there is no moving and no measuring at all
    {"controlword", "statusword", "mode", "mode_display", "position", "velocity", "target_position", "profile_velocity"}
)
TOLD = {  # how the objects that a TPDO carries lie in it
    "statusword": "u16", "velocity": "i32", "torque": "i16", "current": "i16", "position": "i32",
    "sample_counter": "u32", "target_velocity": "i32", "target_position": "i32", "interpolated_position": "i32",
    "velocity_offset": "i32", "controlword": "u16",
}  # fmt: skip

# Revolutions a second in one raw unit; None: by an object or by the encoder.
SPEEDS: dict[str, float | None] = {
    "60A9h": None,
    "increments/s": None,
    "rev/min": 1 / 60,
    "1e-3 rev/min": 1e-3 / 60,
    "1e-3 deg/s": 1e-3 / 360,
}
Speed = Literal["60A9h", "increments/s", "rev/min", "1e-3 rev/min", "1e-3 deg/s"]
OtherSpeed = Literal["velocity", "increments/s", "rev/min", "1e-3 rev/min", "1e-3 deg/s"]


class Way(Enum):
    """How the set-points of a streamed sweep enter the drive: mode of operation, and the object that takes them.

    `VELOCITY_OFFSET` adds to a profile of the drive's own that stands still (60FFh = 0): past its ramps, and with
    standstill as what is left without it.
    """

    CYCLIC_VELOCITY = "cyclic_velocity"
    CYCLIC_POSITION = "cyclic_position"
    INTERPOLATED_POSITION = "interpolated_position"
    VELOCITY_OFFSET = "velocity_offset"

    @property
    def positions(self) -> bool:
        """Whether the host sends positions, and otherwise velocities."""
        return self in (Way.CYCLIC_POSITION, Way.INTERPOLATED_POSITION)

    @property
    def target(self) -> str:
        """Name of the object in the map."""
        return {Way.CYCLIC_VELOCITY: "target_velocity", Way.CYCLIC_POSITION: "target_position"}.get(self, self.value)

    def mode(self, supported: int | None) -> Mode | None:
        """The mode to take of those `supported` (6502h; None: nobody tells); None where the drive has none for it."""
        for mode in (
            (Mode.CYCLIC_VELOCITY, Mode.PROFILE_VELOCITY) if self is Way.VELOCITY_OFFSET else (Mode[self.name],)
        ):
            if supported is None or supported >> (mode - 1) & 1:
                return mode
        return None


class ObjectPlace(Frozen):
    """Where an object lies that is not where CiA 402 has it, or is not of its type."""

    index: int = Field(ge=0x1000, le=0x9FFF)
    sub: int = Field(default=0, ge=0, le=255)
    type: WireType


class MapSetting(Frozen):
    """An object that must hold a value before the units are read, in drive units; absent or different is refused."""

    name: str
    index: int = Field(ge=0x1000, le=0x9FFF)
    sub: int = Field(default=0, ge=0, le=255)
    type: WireType
    value: int

    @property
    def entry(self) -> Entry:
        return Entry(self.index, self.sub, TYPES[self.type], self.name)


class Units(Frozen):
    """What a raw value is. Revolutions are those of `side`."""

    side: Literal["motor", "joint"] = "motor"
    increments: float | Literal["608Fh", "profile"] = "608Fh"  # of the position, a revolution
    velocity: Speed = "60A9h"
    acceleration: OtherSpeed = "velocity"  # of so much a second
    max_speed: OtherSpeed = "velocity"
    rated_torque: float = Field(default=1e-3, gt=0)  # N m in one raw unit of the rated torque
    effort: Literal["torque", "current"] = "torque"  # per mille of rated torque, or of rated current


class Pdos(Frozen):
    """Numbers of the PDOs: RPDO `set_point` takes controlword and target, RPDO `stop` (if any) the controlword alone.

    TPDO `state` tells statusword, velocity and effort; TPDO `place` position and sample counter, or velocity once more.
    """

    set_point: int = Field(default=1, ge=1, le=4)
    stop: int | None = Field(default=None, ge=1, le=4)
    state: int = Field(default=1, ge=1, le=4)
    place: int = Field(default=2, ge=1, le=4)
    cob_id: Literal["writable", "fixed"] = "writable"  # fixed: a PDO is switched off by its number of objects
    unused_rpdos: tuple[int, ...] = ()  # to be switched off
    unused_tpdos: tuple[int, ...] = ()


class DeviceMap(Frozen):
    """A checked map."""

    description: str = ""
    vendor: int | None = None
    product: int | None = None
    objects: Mapping[str, ObjectPlace] = {}
    units: Units = Units()
    pdos: Pdos = Pdos()
    excitation: tuple[Way, ...] = Field(
        default=(Way.CYCLIC_VELOCITY,), min_length=1
    )  # the first that the drive supports (6502h)
    streaming_needs: tuple[str, ...] = ("cycle_value",)  # objects without which the drive does not know the cycle
    samples: Literal["counter", "window"] = "window"
    measuring: Literal["sweepid"] | None = None  # the maker's own sweep; "sweepid": docs/reference/virtual-drive.md
    settings: tuple[MapSetting, ...] = ()
    missing: Mapping[str, str] = {}  # object: who does it instead

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
            raise ValueError(f"missing: without {needless} no axis can be moved and measured")
        for name, place in self.objects.items():
            if place.type != TOLD.get(name, place.type):
                raise ValueError(f"objects.{name}: type must be {TOLD[name]}")
        if lacking := sorted(self.used() & self.missing.keys()):
            raise ValueError(f"missing: {lacking}, and the map uses it")
        self._check_pdos()
        return self

    def used(self) -> set[str]:
        """Objects that may be missing only where the map has another way."""
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
            raise ValueError("pdos.stop: a drive that follows positions is stopped by a controlword without a target")

    def entry(self, name: str) -> Entry:
        """The object of this name."""
        standard, place = STANDARD[name], self.objects.get(name)
        return standard if place is None else Entry(place.index, place.sub, TYPES[place.type], standard.name)

    @property
    def effort(self) -> Entry:
        """What tells the effort."""
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
"""The map of a profile that names none: config/devices/virtual-axis.yaml, as before there were maps."""


def load_device_map(path: Path) -> DeviceMap:
    """BadProfile names the file, the place and the reason."""
    try:
        return parse(DeviceMap, read_mapping(path, "description"))
    except BadProfile as error:
        raise BadProfile(f"device: {path}: {error}") from None


def bits(entry: Entry) -> int:
    """Of the object's value."""
    return 8 * struct.calcsize("<" + entry.type)
