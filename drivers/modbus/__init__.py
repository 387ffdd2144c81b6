"""CiA 402 drives on Modbus TCP and RTU, through pymodbus' client and a register map."""

from collections.abc import Mapping
from pathlib import Path

from drivers.cia402.machine import Cia402Machine
from drivers.modbus.fieldbus import ModbusFieldbus
from drivers.modbus.profile import parse_profile


def from_profile(profile: Mapping[str, object], base: Path) -> Cia402Machine:
    """Factory of the adapter (entry point ``sweepid.drives``). BadProfile names the key and the reason."""
    parsed = parse_profile(profile, base)
    return Cia402Machine(parsed.axes, ModbusFieldbus(parsed))
