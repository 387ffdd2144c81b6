"""A drive of each register map at the other end of a real line, and the profile that leads to it."""

from pathlib import Path
from typing import Any

import pytest

from drivers.cia402.host_watch import HostWatch
from drivers.modbus.profile import ModbusProfile, RtuProfile, TcpProfile, parse_profile
from drivers.modbus.registers import RegisterMap, load_registers
from drivers.modbus.unit import ControlToken
from drivers.registry import load_profile
from tests.unit.drivers.modbus_bank import Bank, Request

DRIVES = Path(__file__).parents[3] / "config" / "drives"
MAPS = DRIVES.parent / "registers"
HIGH, LOW = (load_registers(MAPS / f"virtual-{order}-first.yaml") for order in ("high", "low"))
STATES = {0x00: 0x40, 0x02: 0x40, 0x06: 0x21, 0x07: 0x23, 0x0F: 0x27}  # statusword after a controlword

KINDS = pytest.mark.parametrize(("kind", "registers"), [("tcp", HIGH), ("rtu", LOW)], ids=["tcp", "rtu"])


def nobody() -> ControlToken:
    """Of a line whose drives have no register for an owner."""
    return ControlToken((), HIGH, HostWatch(60.0))


def drive(bank: Bank, registers: RegisterMap, unit: int, rated_torque: float) -> None:
    """A unit that has every register of the map, and follows its controlword and mode."""
    words = bank.registers.setdefault(unit, {})
    for signal in registers.signals.values():
        words |= dict.fromkeys(range(signal.address, signal.end), 0)
    trace = registers.trace
    assert trace is not None
    words |= dict.fromkeys(range(trace.address, trace.address + trace.registers), 0)
    contents = {"vendor": 0x5357, "product": 0x0402, "revision": 0x10000, "serial": 1000 + unit, "statusword": 0x40}
    contents |= {"constant": registers.constant}
    for name, value in (contents | {"rated_torque": rated_torque}).items():
        put(bank, registers, unit, name, value)


def put(bank: Bank, registers: RegisterMap, unit: int, name: str, value: float) -> None:
    signal = registers.signals[name]
    words = signal.format.encode(value)
    bank.registers[unit].update(zip(range(signal.address, signal.end), words, strict=False))


def get(bank: Bank, registers: RegisterMap, name: str, unit: int = 1) -> float:
    signal = registers.signals[name]
    return float(signal.format.decode([bank.registers[unit][k] for k in range(signal.address, signal.end)])[0])


def following(bank: Bank, registers: RegisterMap) -> None:
    def react(request: Request) -> None:
        if request.address == registers.signals["controlword"].address:
            controlword = int(get(bank, registers, "controlword", request.unit))
            put(bank, registers, request.unit, "statusword", STATES[controlword & 0xF])
        if request.address == registers.signals["mode"].address:
            put(bank, registers, request.unit, "mode_display", get(bank, registers, "mode", request.unit))

    bank.react = react


def profile_on(line: TcpProfile | RtuProfile, kind: str, axes: int = 1, **axis: Any) -> ModbusProfile:
    content = load_profile(DRIVES / f"virtual-max100-modbus-{kind}.yaml")
    all_axes: Any = content["axes"]
    content |= {
        "line": line.model_dump(),
        "travel_limits": {"rad": 1e3},
        "axes": [{**each, **axis} for each in all_axes[:axes]],
    }
    return parse_profile(content, DRIVES)
