"""Finds the shipped device maps that fit a dictionary."""

from collections.abc import Mapping
from pathlib import Path

from drivers.canopen.device_map import NEEDED, DeviceMap, Way, load_device_map
from drivers.canopen.objects import SUPPORTED_MODES
from drivers.commission.dictionary import Dictionary


def fitting(dictionary: Dictionary, devices: Path) -> Mapping[Path, DeviceMap]:
    """The maps in a folder that are for this drive, by file. Raises BadProfile for a map that cannot be read."""
    maps = {path: load_device_map(path) for path in sorted(devices.glob("*.yaml"))}
    return {path: device_map for path, device_map in maps.items() if _fits(dictionary, device_map)}


def ways(dictionary: Dictionary) -> tuple[Way, ...]:
    """Ways of excitation for which the dictionary has the objects and whose mode 6502h does not exclude."""
    plain = DeviceMap()
    modes = dictionary.value(SUPPORTED_MODES.index)
    return tuple(way for way in Way if _has(dictionary, plain, way.target) and way.mode(modes or None) is not None)


def _fits(dictionary: Dictionary, device_map: DeviceMap) -> bool:
    """Compares the manufacturer, the objects that the map requires, its first way, and which PDO settings may be
    changed.
    """
    if device_map.vendor is None:
        maker = device_map.description.split()[:1]
        if not maker or maker[0].lower() not in dictionary.name.lower():
            return False
    elif device_map.vendor != dictionary.vendor:
        return False
    if device_map.product not in (None, dictionary.product):
        return False
    first = device_map.excitation[0]
    needed = NEEDED | device_map.used() - {way.target for way in device_map.excitation} | {first.target}
    identifier = dictionary.objects.get((0x1400, 1))
    fixed = identifier is not None and not identifier.writable
    return (
        first in ways(dictionary)
        and all(_has(dictionary, device_map, name) for name in needed)
        and fixed == (device_map.pdos.cob_id == "fixed")
    )


def _has(dictionary: Dictionary, device_map: DeviceMap, name: str) -> bool:
    entry = device_map.entry(name)
    return (entry.index, entry.sub) in dictionary.objects
