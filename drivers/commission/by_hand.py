"""Gear and sign of an axis without energy: a person turns the joint by a known travel and the drive reports the
travel.
"""

from collections.abc import Callable

from drivers.canopen.bus import Bus
from drivers.canopen.profile import CanopenAxis, CanopenProfile
from drivers.commission import units
from drivers.commission.dictionary import read_dictionary
from drivers.commission.read_only_drive import Node, ReadOnlySdo
from drivers.commission.sheet import Row, Verdict
from drivers.errors import BadProfile, CommunicationLost

TOLERANCE = 0.15  # of the travel: accuracy of turning by hand to a mark on the joint
LEAST = 0.05  # of the travel: less does not count as a turn


def turned(profile: CanopenProfile, joint: str, way: float, wait: Callable[[], None]) -> list[Row]:
    """The rows `turned`, `sign` and `gear`. `way` in rad (m), signed; `wait` returns after the joint was turned.

    Raises BadProfile for a joint that the profile does not have.
    """
    axis = named(profile, joint)
    bus = Bus(profile.bus, tuple(each.node for each in profile.axes), profile.device_map.wires)
    try:
        sdo = ReadOnlySdo(bus.add_node(axis.node, None), f"{joint} (node {axis.node})", bus.check_alive)
        node = Node(axis, profile, read_dictionary(profile.eds, axis.node), sdo)
        codec, rows = units.conversions(node)
        if codec is None:
            return rows
        entry = node.map.entry("position")
        before = float(codec.position(sdo.read(entry)))
        wait()
        bus.expect_nodes()  # the bus was not used while the person turned the joint
        return _judged(node, way, float(codec.position(sdo.read(entry))) - before)
    except CommunicationLost as error:
        return [Row(joint, "no-answer", Verdict.MISMATCH, str(error))]
    finally:
        bus.close()


def named(profile: CanopenProfile, joint: str) -> CanopenAxis:
    """Raises BadProfile for a joint that the profile does not have."""
    axis = next((each for each in profile.axes if each.joint == joint), None)
    if axis is None:
        raise BadProfile(f"axes: no joint {joint!r}; there are {', '.join(each.joint for each in profile.axes)}")
    return axis


def _judged(node: Node, way: float, found: float) -> list[Row]:
    unit = node.axis.unit
    what = f"turned by {way:+.4g} {unit}, the drive reports {found:+.4g} {unit}"
    if abs(found) < LEAST * abs(way):
        return [node.row("turned", False, f"{what}: another joint's encoder, or none")]
    share = abs(found / way)
    right = node.axis.gear_ratio * share
    return [
        node.row("turned", True, what),
        node.row("sign", found * way > 0, what if found * way > 0 else f"{what}: change the sign of gear_ratio"),
        node.row(
            "gear",
            abs(share - 1) <= TOLERANCE,
            f"{what}, {share:.3g} times the turn; gear_ratio is {node.axis.gear_ratio:g}"
            + (
                ""
                if abs(share - 1) <= TOLERANCE
                else f", this turn gives {abs(right):.4g}: check gear_ratio, increments and the unit of the joint"
            ),
        ),
    ]
