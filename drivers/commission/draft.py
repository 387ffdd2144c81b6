"""Drafts a drive profile and a device map from a dictionary; the loader refuses values that are left open."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from drivers.canopen.profile import NEEDED, PDO_TYPES, STANDARD, DeviceMap, Entry, SetPointWay, load_device_map
from drivers.cia402.profile import FILL_IN
from drivers.commission.drive import DriveDictionary

WITHOUT_EFFORT = "without 6077h or 6078h the drive cannot be used"


def profile_text(
    dictionary: DriveDictionary, joints: Sequence[str], eds: str, device: str, device_map: DeviceMap | None
) -> str:
    """A drive profile. `eds` and `device`: file names in it; `device_map` is the shipped one, if one fits."""
    bitrate = _open("bit/s, as the drives are set")
    lines = [
        f"# {dictionary.name or 'A drive'}: drafted from its dictionary. Values that begin with {FILL_IN} are refused.",
        "adapter: canopen",
        f"eds: {_text(eds)}",
        f"device: {_text(device)}",
        f"bus: {{interface: socketcan, channel: can0, bitrate: {bitrate}, sync_period: 0.004}}",
        "emergency_stop_codes: [] # values of 603Fh that mean safe torque off; the first emergency stop shows them",
        "axes:",
    ]
    for node, joint in enumerate(joints, 1):
        lines += [
            f"  - joint: {_text(joint)}",
            f"    node: {node}",
            *(f"    {line}" for line in _axis(dictionary, device_map)),
        ]
    return "\n".join([*lines, ""])


def map_text(dictionary: DriveDictionary) -> str:
    """A device map."""
    able = ways(dictionary)
    maker = ("vendor", dictionary.vendor), ("product", dictionary.product)
    excitation = (
        f"[{', '.join(way.value for way in able)}]" if able else _open("no object for set-points: none can be streamed")
    )
    lines = [
        f"# Drafted from a dictionary: compare it with its manual. Values that begin with {FILL_IN} are refused.",
        f"description: {_text(dictionary.name or 'unknown drive')}",
        *(f"{key}: 0x{value:08X}" for key, value in maker if value),
        f"excitation: {excitation}",
        f"pdos: {_pdos(dictionary, able)}",
        "units:",
        *(f"  {line}" for line in _units(dictionary)),
    ]
    for title, section in (("objects:", _objects(dictionary)), ("missing:", _missing(dictionary))):
        found = [*section]
        lines += [title, *found] if found else []
    return "\n".join([*lines, ""])


def shortcomings(dictionary: DriveDictionary) -> list[str]:
    """What the drive lacks for a measurement, and the excitation that remains; empty if it lacks nothing."""
    lost = [STANDARD[name] for name in STANDARD if name in NEEDED and not _has(dictionary, name)]
    able = ", ".join(f"{STANDARD[way.target].index:04X}h ({way.value})" for way in ways(dictionary))
    found: list[str] = []
    if lost:
        shown = ", ".join(f"{entry.index:04X}h" for entry in lost)
        found.append(f"not in the file: {shown}; without these the drive cannot be used")
    if not _efforts(dictionary):
        found.append(WITHOUT_EFFORT)
    if not able:
        found.append("no excitation remains: no object for set-points that 6502h allows")
    elif found:
        found.append(f"excitation that remains: {able}")
    return found


def unfilled(text: str) -> int:
    """Number of values that a person must fill in."""
    return text.count(f'"{FILL_IN}')


def _text(text: str) -> str:
    """In YAML notation, umlauts as they are."""
    return json.dumps(text, ensure_ascii=False)


def _open(what: str) -> str:
    return json.dumps(f"{FILL_IN} {what}")


def _axis(dictionary: DriveDictionary, device_map: DeviceMap | None) -> list[str]:
    stated = {"vendor": dictionary.vendor, "product": dictionary.product, "revision": dictionary.revision}
    identity = ", ".join(
        f"{key}: {_open(f'1018h of the drive, {key}') if value is None else f'0x{value:08X}'}"
        for key, value in stated.items()
    )
    rated = dictionary.value(0x6076)
    hint = f" (the file has {rated} in 6076h)" if rated else ""
    wanted = {
        "gear_ratio": "motor revolutions per joint revolution, signed",
        "rated_torque": f"N m of the motor, from its data sheet{hint}",
        "position_limits": "[lowest, highest] rad, small for the first moves",
        "velocity_limit": "rad/s, small for the first moves",
        "effort_limit": "N m on the joint side",
        "acceleration": "rad/s^2 of moves",
        "quick_stop_deceleration": "rad/s^2",
    }
    if device_map is None or device_map.units.increments == "profile":
        wanted["increments"] = "of the position, a motor revolution; delete this line where the device map has them"
    if device_map is not None and device_map.units.effort == "current":
        wanted["torque_constant"] = "N m/A of the motor, from its data sheet"
    lines = [f"identity: {{{identity}}} # add the serial number: it detects swapped drives"]
    lines += [f"{key}: {_open(what)}" for key, what in wanted.items()]
    return [
        *lines,
        "standstill_velocity: 1.0e-3 # rad/s, above the noise of the speed at rest (see sweepid commission check)",
    ]


def _has(dictionary: DriveDictionary, name: str) -> bool:
    entry = STANDARD[name]
    return (entry.index, entry.sub) in dictionary.objects


def _efforts(dictionary: DriveDictionary) -> list[str]:
    return [name for name in ("torque", "current") if _has(dictionary, name)]


def _units(dictionary: DriveDictionary) -> Iterator[str]:
    yield f"side: {_open('motor, or joint where the drive counts behind the gear')}"
    counts = dictionary.value(0x608F, 1)
    if counts is not None and counts > 1:
        yield f"increments: 608Fh # {counts} in the file"
    else:
        yield f"increments: {_open('608Fh, profile, or increments of the position a revolution')}"
    speed = _open("increments/s, rev/min, 1e-3 rev/min or 1e-3 deg/s")
    yield "velocity: 60A9h" if _has(dictionary, "velocity_unit") else f"velocity: {speed}"
    if _has(dictionary, "max_speed"):
        yield "max_speed: rev/min # as CiA 402 has it; velocity where the maker says so"
    if _has(dictionary, "rated_torque"):
        yield f"rated_torque: {_open('N m in one step of 6076h; CiA 402 has 1.0e-3')}"
    yield f"effort: {(_efforts(dictionary) or [_open('torque or current')])[0]}"


def _pdos(dictionary: DriveDictionary, able: Sequence[SetPointWay]) -> str:
    receive = [n for n in range(1, 5) if (0x13FF + n, 1) in dictionary.objects]
    transmit = [n for n in range(1, 5) if (0x17FF + n, 1) in dictionary.objects]
    if not receive or len(transmit) < 2:
        return _open(f"{len(receive)} RPDOs and {len(transmit)} TPDOs in the file: one and two are needed")
    parts = [f"set_point: {receive[0]}"]
    if len(receive) > 1:
        parts.append(f"stop: {receive[1]}")
    elif any(way.positions for way in able):
        parts.append(f"stop: {_open('a second RPDO, or cyclic_velocity alone')}")
    parts += [f"state: {transmit[0]}", f"place: {transmit[1]}"]
    if not dictionary.objects[0x13FF + receive[0], 1].writable:
        parts.append("cob_id: fixed")
    for key, numbers in (("unused_rpdos", receive[2:]), ("unused_tpdos", transmit[2:])):
        if numbers:
            parts.append(f"{key}: {numbers}")
    return f"{{{', '.join(parts)}}}"


def _objects(dictionary: DriveDictionary) -> Iterator[str]:
    """Objects with another type than in CiA 402."""
    for name, entry in STANDARD.items():
        listed = dictionary.objects.get((entry.index, entry.sub))
        if listed is None or listed.type == entry.type_name:
            continue
        if name in PDO_TYPES or not listed.type:
            what = f"{listed.type or 'no number'} in the file, and only {entry.type_name} can be used"
            yield f"  {name}: {_open(what)}"
        else:
            yield f"  {name}: {{index: 0x{entry.index:04X}, sub: {entry.sub}, type: {listed.type}}}"


def _missing(dictionary: DriveDictionary) -> Iterator[str]:
    able = {way.target for way in ways(dictionary)}
    targets = {way.target for way in SetPointWay}
    for name, entry in STANDARD.items():
        if name == "sample_counter":
            yield f"  {name}: {json.dumps('host: each sample belongs to the SYNC after which it came')}"
        elif not _has(dictionary, name):
            yield f"  {name}: {_instead(dictionary, name, entry, able, targets)}"


def _instead(dictionary: DriveDictionary, name: str, entry: Entry, able: set[str], targets: set[str]) -> str:
    needless = {  # object: (object that makes it unnecessary, reason)
        "torque": ("current", "6078h gives the current"),
        "current": ("torque", "6077h gives the torque"),
        "rated_current": ("torque", "6077h gives the torque"),
        "sync_period": ("cycle_value", "not needed: 60C2h has the cycle"),
    }
    if name in NEEDED:
        return _open(f"{entry} is not in the file: without it the drive cannot be used")
    if name in targets and able:
        return json.dumps(f"the set-points go into {', '.join(sorted(able))}")
    if name in ("torque", "current") and not _efforts(dictionary):
        return _open(f"{WITHOUT_EFFORT}; an object of its own goes into `objects`, and this line away")
    other, why = needless.get(name, ("", ""))
    return (
        json.dumps(why) if other and _has(dictionary, other) else _open(f"what replaces it: {entry} is not in the file")
    )


def fitting(dictionary: DriveDictionary, devices: Path) -> Mapping[Path, DeviceMap]:
    """The maps in a folder that are for this drive, by file. Raises BadProfile for a map that cannot be read."""
    maps = {path: load_device_map(path) for path in sorted(devices.glob("*.yaml"))}
    return {path: device_map for path, device_map in maps.items() if _fits(dictionary, device_map)}


def ways(dictionary: DriveDictionary) -> tuple[SetPointWay, ...]:
    """Ways of excitation for which the dictionary has the objects and whose mode 6502h does not exclude."""
    plain = DeviceMap()
    modes = dictionary.value(STANDARD["supported_modes"].index)
    return tuple(
        way for way in SetPointWay if _has_object(dictionary, plain, way.target) and way.mode(modes or None) is not None
    )


def _fits(dictionary: DriveDictionary, device_map: DeviceMap) -> bool:
    """By manufacturer, objects that the map requires, its first way, and which PDO settings may be changed."""
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
        and all(_has_object(dictionary, device_map, name) for name in needed)
        and fixed == (device_map.pdos.cob_id == "fixed")
    )


def _has_object(dictionary: DriveDictionary, device_map: DeviceMap, name: str) -> bool:
    entry = device_map.entry(name)
    return (entry.index, entry.sub) in dictionary.objects
