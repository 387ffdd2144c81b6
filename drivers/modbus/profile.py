"""The profile of drives on Modbus: the line, its clocks, the register map, the units on it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from drivers.cia402.profile import AxisProfile, Frozen, StopOptions, existing_file, parse, require_different

TURNAROUND = 0.02  # s that a drive may take to begin its answer
ROUND_TRIP = 4e-3  # s, of a Modbus TCP request: most drives answer from a cycle of some ms


class _Clocks(Frozen):
    """Times in s."""

    timeout: float = Field(default=0.5, gt=0, le=10)  # for an answer
    silence_between_frames: float = Field(default=0.0, ge=0, le=0.1)  # where the maker wants more than the standard
    watchdog: float = Field(default=1.0, gt=0, le=60)  # the drive stops after this silence of ours

    @model_validator(mode="after")
    def _consistent(self) -> "_Clocks":
        if self.watchdog < 2 * self.timeout:
            raise ValueError(f"watchdog {self.watchdog} s must be at least twice the timeout of {self.timeout} s")
        return self


class TcpLine(_Clocks):
    """A drive or a gateway that speaks Modbus TCP."""

    transport: Literal["tcp"]
    host: str = Field(min_length=1)
    port: int = Field(default=502, ge=1, le=65535)

    @property
    def place(self) -> str:
        return f"{self.host}:{self.port}"

    @property
    def silence(self) -> float:
        """Between an answer and the next request, s."""
        return self.silence_between_frames

    @property
    def answer_time(self) -> float:
        """Until an answer that nobody waits for is over, s: many a server drops a request that comes before."""
        return TURNAROUND

    def read_time(self, registers: int) -> float:
        """About what it takes to read so many registers, s; on TCP the round trip is what counts."""
        return ROUND_TRIP


class RtuLine(_Clocks):
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
        """Until an answer to a write that nobody waits for is over, s."""
        return TURNAROUND + 8 * self._character

    def read_time(self, registers: int) -> float:
        """About what it takes to read so many registers, s: request of 8 bytes, answer of 5 and the registers."""
        return self.silence + (13 + 2 * registers) * self._character

    @property
    def _character(self) -> float:
        """Start bit, 8 bits, parity, stop bits; s."""
        return (9 + (self.parity != "N") + self.stopbits) / self.baudrate


Line = Annotated[TcpLine | RtuLine, Field(discriminator="transport")]


class ModbusAxis(AxisProfile):
    """One axis and its unit on the line. Unit 0 would be everybody."""

    unit_id: int = Field(ge=1, le=247)


class ModbusProfile(Frozen):
    """A whole machine: one line, drives of one type."""

    adapter: Literal["modbus"]
    line: Line
    registers: Path
    emergency_stop_codes: tuple[int, ...] = ()  # values of error_code that mean safe torque off
    stop_options: StopOptions = StopOptions()
    axes: tuple[ModbusAxis, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> "ModbusProfile":
        require_different(self.axes, "unit ids", [axis.unit_id for axis in self.axes])
        return self


def parse_profile(profile: Mapping[str, object], base: Path) -> ModbusProfile:
    """A checked profile whose `registers` is an existing file, relative to `base` where it is not absolute."""
    parsed = parse(ModbusProfile, profile)
    registers = existing_file("registers", base / parsed.registers)
    return parsed.model_copy(update={"registers": registers})
