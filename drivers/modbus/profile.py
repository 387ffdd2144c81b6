"""The profile of drives on Modbus: the line, its clocks, the register map, the units on it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

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

DIRECT = (0, 255)  # units of a TCP device that is no gateway (Modbus Messaging on TCP/IP V1.0b, 4.4.2.2)


class _Clocks(Frozen):
    """Times in s."""

    turnaround: ClassVar = 0.02  # maximum time until a drive begins its answer

    timeout: float = Field(default=0.5, gt=0, le=10)  # for an answer
    silence_between_frames: float = Field(default=0.0, ge=0, le=0.1)  # if the drive needs more than the standard
    watchdog: float = Field(default=1.0, gt=0, le=60)  # the drive stops after this silence of the host

    @model_validator(mode="after")
    def _consistent(self) -> "_Clocks":
        if self.watchdog < 2 * self.timeout:
            raise ValueError(f"watchdog {self.watchdog} s must be at least twice the timeout of {self.timeout} s")
        return self


class TcpProfile(_Clocks):
    """A drive or a gateway with Modbus TCP."""

    transport: Literal["tcp"]
    host: str = Field(min_length=1)
    port: int = Field(default=502, ge=1, le=65535)

    @property
    def place(self) -> str:
        return f"{self.host}:{self.port}"

    @property
    def silence(self) -> float:
        """Time between an answer and the next request, s."""
        return self.silence_between_frames

    @property
    def answer_time(self) -> float:
        """Time until an answer that is not awaited has ended, s: many servers drop a request that arrives before."""
        return self.turnaround

    def read_time(self, registers: int) -> float:
        """Approximate time to read `registers` registers, s: most drives answer in a cycle of a few ms."""
        return 4e-3


class RtuProfile(_Clocks):
    """A serial line."""

    transport: Literal["rtu"]
    device: str = Field(min_length=1)
    baudrate: int = Field(default=19200, ge=1200, le=4_000_000)
    parity: Literal["N", "E", "O"] = "E"
    stopbits: Literal[1, 2] = 1

    @property
    def place(self) -> str:
        return self.device

    @property
    def silence(self) -> float:
        """At least 3.5 characters, and 1.75 ms above 19,200 baud (Modbus over serial line V1.02, 2.5.1.1)."""
        return max(self.silence_between_frames, 3.5 * self._character if self.baudrate <= 19200 else 1.75e-3)

    @property
    def answer_time(self) -> float:
        """Time until the answer to a write that is not awaited has ended, s."""
        return self.turnaround + 8 * self._character

    def read_time(self, registers: int) -> float:
        """Approximate time to read `registers` registers, s: request of 8 bytes, answer of 5 and the registers."""
        return self.silence + (13 + 2 * registers) * self._character

    @property
    def _character(self) -> float:
        """Time of start bit, 8 bits, parity and stop bits; s."""
        return (9 + (self.parity != "N") + self.stopbits) / self.baudrate


Line = Annotated[TcpProfile | RtuProfile, Field(discriminator="transport")]


class ModbusAxis(AxisProfile):
    """One axis and its unit on the line. 255 and, for one drive alone, 0: a TCP drive that is addressed directly."""

    unit_id: int = Field(ge=0, le=255)

    @property
    def place(self) -> str:
        """As in "joint_1 (unit 1)"."""
        return f"{self.joint} (unit {self.unit_id})"


class ModbusProfile(Frozen):
    """A whole machine: one line, drives of one type."""

    adapter: Literal["modbus"]
    line: Line
    registers: Path
    emergency_stop_codes: tuple[int, ...] = ()  # values of error_code that mean safe torque off
    stop_options: StopOptions = StopOptions()
    travel_limits: TravelLimits = TravelLimits()
    axes: tuple[ModbusAxis, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> "ModbusProfile":
        require_different(self.axes, "unit ids", [axis.unit_id for axis in self.axes])
        for number, axis in enumerate(self.axes):
            direct = self.line.transport == "tcp" and axis.unit_id in DIRECT
            if not (1 <= axis.unit_id <= 247 or (direct and (axis.unit_id or len(self.axes) == 1))):
                raise ValueError(
                    f"axes.{number}.unit_id: {axis.unit_id} is not 1 to 247; a single drive with Modbus TCP of its own "
                    "may have 0 or 255"
                )
        require_near(self.axes, self.travel_limits, self.line.watchdog, "line.watchdog")
        return self


def parse_profile(profile: Mapping[str, object], base: Path) -> ModbusProfile:
    """A checked profile. `registers` is an existing file, relative to `base` unless it is absolute."""
    parsed = parse(ModbusProfile, profile)
    registers = existing_file("registers", base / parsed.registers)
    return parsed.model_copy(update={"registers": registers})
