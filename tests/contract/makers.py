"""Profiles for nodes made of other drives' dictionaries (`tests.foreign_bench`)."""

from pathlib import Path
from typing import Any

from drivers.registry import load_profile
from tests.foreign_bench import Foreign

DEVICES = {
    "plain": "plain-402",
    "epos4": "maxon-epos4",
    "gold": "elmo-gold",
    "simpliq": "elmo-simpliq",
    "powerball": "schunk-powerball",
}
IDENTITIES = {  # vendor, product, revision; 0 where the maker's file tells none
    "plain": (0x5357, 0x0410, 0x00010000),
    "epos4": (0xFB, 0x65520000, 0x01700000),
    "gold": (0x9A, 0x00030923, 0x000103F6),
    "simpliq": (0x9A, 0, 0),
    "powerball": (0, 0, 0),
}
INCREMENTS = {"gold": 65536, "simpliq": 8192}  # of the encoders, a motor revolution
SYNC_PERIOD = 0.008  # s, as that of the benches
# s; host and drives share one computer, however busy: a late answer is no lost one
PATIENCE = {"silence": 6.0, "drive_timeout": 20.0, "host_timeout": 20.0, "sdo_timeout": 10.0}


def profile(
    dictionary: str, foreign: Foreign, base: Path, *, patient: bool = False, sync_period: float = SYNC_PERIOD
) -> dict[str, Any]:
    """The virtual machine's profile with other drives; files relative to `base`, the folder of the profiles."""
    content: dict[str, Any] = load_profile(base / "virtual-max100.yaml")
    bus = {"host": None, "port": None, **foreign.bus, "sync_period": sync_period, **(PATIENCE if patient else {})}
    vendor, product, revision = IDENTITIES[dictionary]
    own: dict[str, Any] = {
        "identity": {"vendor": vendor, "product": product, "revision": revision},
        "load_encoder": False,
    }
    if dictionary in INCREMENTS:
        own["increments"] = INCREMENTS[dictionary]
    return {
        **content,
        "eds": str(next(iter(foreign.files.values()))),
        "device": f"../devices/{DEVICES[dictionary]}.yaml",
        "bus": content["bus"] | bus,
        "maker_settings": [],
        "travel_limits": {"rad": 1e3},
        "axes": [axis | own for axis in content["axes"] if axis["joint"] in foreign.files],
    }
