"""CiA 402 drives on CANopen, through python-can and canopen's SDO client."""

from collections.abc import Mapping
from pathlib import Path

from drivers.canopen.machine import CanopenMachine
from drivers.canopen.profile import parse_profile


def from_profile(profile: Mapping[str, object], base: Path) -> CanopenMachine:
    """The adapter's factory (entry point ``sweepid.drives``). BadProfile names the key and the reason."""
    return CanopenMachine(parse_profile(profile, base))
