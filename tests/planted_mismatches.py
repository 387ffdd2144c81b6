"""Mismatches to plant in a cabinet of `tests.commission_bench`, and the names by which the check tells them."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from canopen.objectdictionary import datatypes

from tests.commission_bench import DRIVES, OWN, Cabinet

BOTH = (OWN, "epos4")
KINDS = (*BOTH, "gold", "plain")
Change = Callable[[dict[str, Any], Path], dict[str, Any]]


@dataclass(frozen=True)
class Case:
    """A mismatch planted in the first drive or in its profile, and the names by which alone it is told."""

    name: str
    told: set[str]
    plant: Callable[[Cabinet], None] = lambda _: None
    change: Change = lambda content, _: content
    kinds: tuple[str, ...] = BOTH
    joints: tuple[str, ...] = ("joint_1",)


def variable(cabinet: Cabinet, index: int, sub: int, **changes: Any) -> None:
    """The object of the drive becomes another; its EDS stays."""
    variables = cabinet.dictionary()._variables
    other = copy(variables[index, sub])
    for name, value in changes.items():
        setattr(other, name, value)
    variables[index, sub] = other


def gone(index: int, sub: int = 0) -> Callable[[Cabinet], None]:
    return lambda cabinet: cabinet.dictionary()._variables.pop((index, sub))


def typed(index: int, sub: int, kind: int) -> Callable[[Cabinet], None]:
    return lambda cabinet: variable(cabinet, index, sub, data_type=kind)


def holds(index: int, sub: int, value: int) -> Callable[[Cabinet], None]:
    """From power-on on, as a commissioner left it."""

    def plant(cabinet: Cabinet) -> None:
        cabinet.dictionary().nameplate[index, sub] = value
        cabinet.node().boot()

    return plant


def enabled(cabinet: Cabinet) -> None:
    """By somebody else, long ago."""
    for word in (0x06, 0x07, 0x0F):
        cabinet.dictionary().download(0x6040, 0, word.to_bytes(2, "little"))


def swapped(cabinet: Cabinet) -> None:
    one, other = cabinet.node("joint_1"), cabinet.node("joint_2")
    first, second = one.number, other.number
    one.renumber(second)
    other.renumber(first)


def axis(**changes: Any) -> Change:
    def change(content: dict[str, Any], _: Path) -> dict[str, Any]:
        first, *rest = content["axes"]
        return content | {"axes": [first | changes, *rest]}

    return change


def roomy(change: Change) -> Change:
    """With room for what an axis goes when its host dies."""
    return lambda content, folder: change(content, folder) | {"travel_limits": {"rad": 1e3}}


def identity(**changes: Any) -> Change:
    return lambda content, folder: axis(identity=content["axes"][0]["identity"] | changes)(content, folder)


def bus(**changes: Any) -> Change:
    return lambda content, _: content | {"bus": content["bus"] | changes}


def profile(**changes: Any) -> Change:
    return lambda content, _: content | changes


def device(**changes: Any) -> Change:
    """Another device map: an EPOS4's, else the virtual drive's."""

    def change(content: dict[str, Any], folder: Path) -> dict[str, Any]:
        name = Path(content.get("device", "virtual-axis.yaml")).name
        given = yaml.safe_load((DRIVES.parent / "devices" / name).read_text())
        (folder / "map.yaml").write_text(yaml.safe_dump(given | changes))
        return content | {"device": str(folder / "map.yaml")}

    return change


def both(*changes: Change) -> Change:
    def change(content: dict[str, Any], folder: Path) -> dict[str, Any]:
        for each in changes:
            content = each(content, folder)
        return content

    return change


I16, I8 = datatypes.INTEGER16, datatypes.INTEGER8
ALL = ("joint_1", "joint_2")  # what is wrong with map or machine is wrong with each
EPOS4_ONLY, OWN_ONLY, GOLD_ONLY = ("epos4",), (OWN,), ("gold",)
WITH_GEAR = ("gold", "plain")  # in whose dictionaries 6091h is

CASES = [
    # who
    Case("no drive", {"no-answer"}, lambda c: setattr(c.node().disturbance, "mute", True), bus(sdo_timeout=0.3)),
    Case("device type", {"device-type"}, holds(0x1000, 0, 0x00030191)),
    Case("vendor", {"vendor"}, holds(0x1018, 1, 0x9A)),
    Case("product", {"product"}, holds(0x1018, 2, 0x65530000)),
    Case("revision", {"revision"}, holds(0x1018, 3, 0x01600000)),
    Case("serial number", {"serial"}, change=identity(serial=4711)),
    Case("rated torque of the drive", {"rated-torque"}, holds(0x6076, 0, 513)),
    Case("rated torque of the profile", {"rated-torque"}, change=axis(rated_torque=17.0)),
    Case("unit of the rated torque", {"rated-torque"}, change=device(units={"rated_torque": 1e-2}), joints=ALL),
    Case("swapped nodes", {"rated-torque", "swapped-nodes"}, swapped, joints=ALL),
    # state
    Case("energised by somebody", {"energy"}, enabled),
    Case("in fault", {"fault"}, lambda c: c.node().axis.fail(0x7305)),
    # objects
    *(
        Case(f"no {what}", {"missing-object"}, gone(index))
        for what, index in (
            ("statusword", 0x6041),
            ("position", 0x6064),
            ("velocity", 0x606C),
            ("target position", 0x607A),
            ("profile velocity", 0x6081),
            ("torque", 0x6077),
            ("mode display", 0x6061),
        )
    ),
    Case("no encoder increments", {"missing-object"}, gone(0x608F, 1), kinds=OWN_ONLY),
    Case("no encoder increments", {"missing-object"}, gone(0x3000, 5), kinds=EPOS4_ONLY),
    Case("no interpolation period", {"missing-object"}, gone(0x60C2, 1), kinds=EPOS4_ONLY),
    Case("no SYNC period", {"missing-object"}, gone(0x1006), kinds=OWN_ONLY),
    Case("no sample counter", {"missing-object"}, gone(0x2120, 1), kinds=OWN_ONLY),
    Case("a limit that the EDS has and the drive not", {"eds-differs"}, gone(0x607F)),
    Case("a watchdog that the EDS has and the drive not", {"eds-differs"}, gone(0x1016, 1)),
    Case("position of 16 bits", {"wrong-type"}, typed(0x6064, 0, I16)),
    Case("torque of 8 bits", {"wrong-type"}, typed(0x6077, 0, I8)),
    Case("mode of 16 bits", {"wrong-type"}, typed(0x6060, 0, I16)),
    Case(
        "max torque of the map unlike the EDS",
        {"type-in-eds"},
        change=device(objects={"max_torque": {"index": 0x6072, "type": "i16"}}),
        kinds=OWN_ONLY,
        joints=ALL,
    ),
    # units, sign, gear
    Case("velocity unit of another quantity", {"units"}, holds(0x60A9, 0, 0x00C00300), kinds=OWN_ONLY),
    *(
        Case(f"{unit} of the map, not of the drive", {told}, change=device(units=units), kinds=OWN_ONLY, joints=ALL)
        for unit, told, units in (
            ("velocity unit", "velocity-unit", {"velocity": "rev/min"}),
            ("increments", "increments", {"increments": 65536.0}),
        )
    ),
    Case(
        "velocity unit too coarse",
        {"velocity-unit"},
        change=both(device(settings=[]), axis(velocity_limit=0.1)),
        kinds=EPOS4_ONLY,
    ),
    Case("no increments at all", {"increments"}, holds(0x608F, 1, 0), kinds=OWN_ONLY),
    Case("no increments at all", {"increments"}, holds(0x3000, 5, 0), kinds=EPOS4_ONLY),
    *(
        Case(
            "sign of the gear",
            {"sign"},
            holds(0x607D, 2, limit),
            axis(gear_ratio=-171.0, position_limits=[-2.96, 2.0]),
            kinds,
        )
        for limit, kinds in ((57_080_000, OWN_ONLY), (174_200, EPOS4_ONLY))
    ),
    *(
        Case(f"polarity of {what}", {"polarity"}, holds(0x607E, 0, bits), kinds=GOLD_ONLY)
        for what, bits in (("position", 0x80), ("velocity", 0x40), ("both", 0xC0))
    ),
    Case("gear ratio in the drive", {"gear"}, holds(0x6091, 1, 171), kinds=WITH_GEAR),
    Case("gear ratio of shaft to motor", {"gear"}, holds(0x6091, 2, 2), kinds=WITH_GEAR),
    Case("gear too high", {"velocity-limit", "position-limits"}, change=axis(gear_ratio=342.0)),
    Case("gear too low", {"effort-limit"}, change=axis(gear_ratio=17.1), kinds=OWN_ONLY),
    Case("gear too low", {"effort-limit"}, change=axis(gear_ratio=1.71), kinds=EPOS4_ONLY),
    # limits
    Case("position limits wider than the drive's", {"position-limits"}, change=axis(position_limits=[-3.5, 2.9])),
    Case("velocity limit above the drive's", {"velocity-limit"}, change=roomy(axis(velocity_limit=2.5))),
    Case("effort limit above the drive's", {"effort-limit"}, change=axis(effort_limit=9000.0), kinds=OWN_ONLY),
    Case("position outside of its limits", {"position"}, change=axis(position_limits=[0.5, 2.0])),
    Case("position offset", {"position", "position-limits"}, change=axis(position_offset=3.1)),
    # what a connection writes
    Case(
        "a setting of the maker's that is absent",
        {"maker-setting"},
        change=profile(maker_settings=[{"name": "none", "index": 0x5ABC, "type": "H", "value": 1}]),
        joints=ALL,
    ),
    Case(
        "a setting of the map that is a command",
        {"map-setting"},
        change=device(settings=[{"name": "enable", "index": 0x6040, "type": "u16", "value": 15}]),
        kinds=OWN_ONLY,
        joints=ALL,
    ),
    Case("a PDO that is not there", {"pdos"}, gone(0x1801, 1)),
    Case("no way of excitation", {"no-excitation"}, holds(0x6502, 0, 0x1)),
    Case("no profile position", {"no-profile-position"}, holds(0x6502, 0, 0x100)),
    Case("a bus too slow", {"bus-load"}, change=bus(bitrate=50_000, sync_period=0.004), joints=ALL),
]
