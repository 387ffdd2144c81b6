"""CiA 402 drives on CANopen, through python-can and the SDO client of canopen."""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
from collections.abc import Mapping
from pathlib import Path

from drivers.canopen.fieldbus import CanopenFieldbus
from drivers.canopen.profile import parse_profile
from drivers.cia402.machine import Cia402Machine


def from_profile(profile: Mapping[str, object], base: Path) -> Cia402Machine:
    """Factory of the adapter (entry point ``sweepid.drives``). BadProfile names the key and the reason."""
    parsed = parse_profile(profile, base)
    return Cia402Machine(parsed.axes, CanopenFieldbus(parsed))
