"""Checks that units, sign, gear and limits of the profile agree with the commissioned values of the drive, or with a
turn of the joint by hand (`turned`).

The limits in a drive are evidence only until `sweepid` has written its own: `configured_before`.
"""

import math
from collections.abc import Callable, Iterator

from drivers.canopen.bus import CanopenBus
from drivers.canopen.profile import (
    SPEEDS,
    STANDARD,
    CanopenAxis,
    CanopenProfile,
    Cia301,
    Codec,
    Entry,
    codec,
    velocity_unit,
)
from drivers.canopen.sdo import ObjectAbsent, OtherType
from drivers.commission.checks import rated_torque
from drivers.commission.drive import CheckedNode, CheckRow, CheckVerdict, ReadOnlySdo, read_dictionary
from drivers.errors import BadProfile, CommunicationLost, LimitExceeded, WrongConfiguration

_ROUNDING = 1e-3  # tolerance relative to a limit


def scale(node: CheckedNode) -> Iterator[CheckRow]:
    """Units, gear and polarity as reported by the drive."""
    polarity = node.listed(Entry(0x607E, 0, "B", "polarity"))
    if polarity is not None:
        word = (
            f"607Eh is {polarity:02X}h: the drive inverts the signs of position and speed, not of torque; it must be 0"
        )
        yield node.row("polarity", polarity == 0, word if polarity else "607Eh inverts no sign")
    yield from _gear(node)
    yield from _fixed_increments(node)
    yield from _fixed_velocity(node)


def conversions(node: CheckedNode) -> tuple[Codec | None, list[CheckRow]]:
    """Units of the axis as the drive holds them now; no codec if they are not understood, and a row that says so."""
    try:
        found = codec(node.axis, node.map.units, rated_torque(node) or node.axis.rated_torque, node.read)
    except (ObjectAbsent, OtherType):
        return None, []  # reported by `objects`
    except WrongConfiguration as error:
        return None, [node.row("units", False, f"not understood: {error}")]
    except ZeroDivisionError:
        found = None
    if found is None or not (math.isfinite(found.increments) and found.increments > 0):
        return None, [node.row("increments", False, "the drive has 0 increments a motor revolution")]
    return found, []


def at_rest(node: CheckedNode, units: Codec) -> Iterator[CheckRow]:
    """Position of the axis, and noise of its speed."""
    axis = node.axis
    low, high = axis.position_limits
    raw = node.of_map("position")
    if raw is not None:
        place = float(units.position(raw))
        what = f"the axis is at {place:.5g} {axis.unit}, position_limits are {low:g} to {high:g} {axis.unit}"
        hint = (
            ""
            if low <= place <= high
            else ": check position_offset, gear_ratio, increments, and whether the encoder was referenced"
        )
        yield node.row("position", low <= place <= high, what + hint)
    entry = node.map.entry("velocity")
    try:
        speeds = [abs(float(units.velocity(node.sdo.read(entry)))) for _ in range(10)]
    except WrongConfiguration:
        return  # reported by `objects`
    yield node.row(
        "standstill",
        max(speeds) <= axis.standstill_velocity,
        f"velocity at rest is up to {max(speeds):.3g} {axis.unit}/s, "
        f"standstill_velocity is {axis.standstill_velocity:g} {axis.unit}/s",
    )


def limits(node: CheckedNode, units: Codec) -> Iterator[CheckRow]:
    """The profile's limits must be inside the commissioned limits of the drive."""
    if configured_before(node):
        yield node.row(
            "drive-limits",
            False,
            "the drive holds limits that a connection wrote: power it off and on, so that its own can be compared",
        )
        return
    axis = node.axis
    try:
        speed, fastest = units.raw_speed(axis.velocity_limit), units.raw_max_speed(axis.velocity_limit)
        effort, window = units.raw_effort_limit(axis.effort_limit), units.raw_window(axis.position_limits)
    except LimitExceeded as error:
        yield node.row("limits", False, f"in drive units: {error}: check gear_ratio and units")
        return
    most = 32.767 * units.rated_torque * abs(axis.gear_ratio)  # 16 bits of per mille
    if axis.effort_limit > most:
        what = f"effort_limit {axis.effort_limit:g} {axis.effort_unit} is above {most:.4g}, the largest value of 6077h"
        yield node.row("effort-limit", False, f"{what}: check effort_limit and gear_ratio")
    for check, name, wanted in (
        ("velocity-limit", "max_profile_velocity", speed),
        ("velocity-limit", "max_speed", fastest),
        ("effort-limit", "max_torque", effort),
    ):
        held = node.of_map(name)
        if held:
            yield _beyond(node, check, node.map.entry(name), wanted, held)
    low, high = node.of_map("position_min"), node.of_map("position_max")
    if low is not None and high is not None and low < high:
        yield _inside(node, window, (low, high))


def resolution(node: CheckedNode, units: Codec) -> Iterator[CheckRow]:
    """Whether the velocity unit, which stays the same in the session, is fine enough for a small sine: a line needs 20
    units, and one above a tenth of the limit cannot be used.
    """
    least, limit = 20 * abs(float(units.velocity(1.0))), node.axis.velocity_limit
    unit = f"{node.axis.unit}/s"
    what = f"lines from {least:.3g} {unit} on have 20 steps of the drive's velocity unit"
    yield node.row("velocity-unit", least <= 0.1 * limit, f"{what}; velocity_limit is {limit:g} {unit}")


def configured_before(node: CheckedNode) -> bool:
    """Whether `sweepid` has configured the drive since power-on: then it monitors the heartbeat of this host."""
    return (node.value(Cia301.HEARTBEAT_CONSUMER) or 0) >> 16 & 0x7F == node.machine.bus.host_node


def _gear(node: CheckedNode) -> Iterator[CheckRow]:
    motor, shaft = (node.listed(Entry(0x6091, sub, "I", "gear ratio")) for sub in (1, 2))
    if not motor or not shaft:
        return
    held, ratio = motor / shaft, abs(node.axis.gear_ratio)
    joint_side = node.map.units.side == "joint"
    fits = held == 1 or (joint_side and math.isclose(held, ratio, rel_tol=1e-6))
    wanted = f"the profile's {ratio:g}, or 1" if joint_side else "1, for the map counts on the motor side"
    yield node.row("gear", fits, f"6091h has {held:g} motor revolutions a shaft revolution; it must be {wanted}")


def _fixed_increments(node: CheckedNode) -> Iterator[CheckRow]:
    """A number in map or profile, in addition to an object of the drive that reports it."""
    units = node.map.units
    given = node.axis.increments if units.increments == "profile" else units.increments
    if isinstance(given, str) or given is None or "increments" in node.missing:
        return
    held, turns = node.listed(STANDARD["increments"]), node.listed(STANDARD["motor_revolutions"])
    if held:
        found = held / max(1, turns or 1)
        yield node.row("increments", found == given, f"608Fh has {found:g} a revolution, map or profile {given:g}")


def _fixed_velocity(node: CheckedNode) -> Iterator[CheckRow]:
    unit = SPEEDS.get(node.map.units.velocity)
    code = node.listed(STANDARD["velocity_unit"])
    if unit is None or not code:
        return
    try:
        held = velocity_unit(code, math.nan)
    except WrongConfiguration as error:
        yield node.row("velocity-unit", False, str(error))
        return
    fits = math.isclose(held, unit, rel_tol=1e-9)
    yield node.row(
        "velocity-unit",
        fits,
        f"60A9h is {code:08X}h, {held:.4g} rev/s in a step; the map has {node.map.units.velocity}",
    )


def _beyond(node: CheckedNode, check: str, entry: Entry, wanted: int, held: int) -> CheckRow:
    what = f"{entry}: the drive holds {held}, the profile's limit is {wanted} of its units"
    fits = wanted <= held * (1 + _ROUNDING) + 1
    return node.row(
        check,
        fits,
        what if fits else f"{what}, {wanted / held:.3g} times as much: check the limit, gear_ratio and the unit",
    )


def _inside(node: CheckedNode, wanted: tuple[int, int], held: tuple[int, int]) -> CheckRow:
    what = f"607Dh: the drive holds {held[0]} to {held[1]}, position_limits are {wanted[0]} to {wanted[1]} of its units"
    room = _ROUNDING * (held[1] - held[0]) + 1

    def within(low: int, high: int) -> bool:
        return low >= held[0] - room and high <= held[1] + room

    if within(*wanted):
        return node.row("position-limits", True, what)
    if within(-wanted[1], -wanted[0]):
        return node.row("sign", False, f"{what}: they fit with the other sign: change the sign of gear_ratio")
    return node.row(
        "position-limits", False, f"{what}: check position_limits, gear_ratio, increments and position_offset"
    )


def turned(profile: CanopenProfile, joint: str, way: float, wait: Callable[[], None]) -> list[CheckRow]:
    """The rows `turned`, `sign` and `gear`. `way` in rad (m), signed; `wait` returns after the joint was turned.

    Raises BadProfile for a joint that the profile does not have.
    """
    axis = named(profile, joint)
    bus = CanopenBus(profile.bus, tuple(each.node for each in profile.axes), profile.device_map.wires)
    try:
        sdo = ReadOnlySdo(bus.add_node(axis.node, None), f"{joint} (node {axis.node})", bus.check_alive)
        node = CheckedNode(axis, profile, read_dictionary(profile.eds, axis.node), sdo)
        codec, rows = conversions(node)
        if codec is None:
            return rows
        entry = node.map.entry("position")
        before = float(codec.position(sdo.read(entry)))
        wait()
        bus.expect_nodes()  # the bus was not used while the person turned the joint
        return _judged(node, way, float(codec.position(sdo.read(entry))) - before)
    except CommunicationLost as error:
        return [CheckRow(joint, "no-answer", CheckVerdict.MISMATCH, str(error))]
    finally:
        bus.close()


def named(profile: CanopenProfile, joint: str) -> CanopenAxis:
    """Raises BadProfile for a joint that the profile does not have."""
    axis = next((each for each in profile.axes if each.joint == joint), None)
    if axis is None:
        raise BadProfile(f"axes: no joint {joint!r}; there are {', '.join(each.joint for each in profile.axes)}")
    return axis


def _judged(node: CheckedNode, way: float, found: float) -> list[CheckRow]:
    unit = node.axis.unit
    what = f"turned by {way:+.4g} {unit}, the drive reports {found:+.4g} {unit}"
    if abs(found) < 0.05 * abs(way):
        return [node.row("turned", False, f"{what}: another joint's encoder, or none")]
    share = abs(found / way)
    right = node.axis.gear_ratio * share
    fits = abs(share - 1) <= 0.15  # accuracy of turning by hand to a mark on the joint
    return [
        node.row("turned", True, what),
        node.row("sign", found * way > 0, what if found * way > 0 else f"{what}: change the sign of gear_ratio"),
        node.row(
            "gear",
            fits,
            f"{what}, {share:.3g} times the turn; gear_ratio is {node.axis.gear_ratio:g}"
            + (
                ""
                if fits
                else f", this turn gives {abs(right):.4g}: check gear_ratio, increments and the unit of the joint"
            ),
        ),
    ]
