"""Do units, sign, gear and limits of the profile agree with what the drive itself was commissioned with?

What a drive holds of limits is evidence only until `sweepid` has written its own: `configured_before`.
"""

import math
from collections.abc import Iterator

from drivers.canopen.device_map import SPEEDS
from drivers.canopen.objects import HEARTBEAT_CONSUMER, INCREMENTS, MOTOR_REVOLUTIONS, VELOCITY_UNIT, Entry
from drivers.canopen.sdo import ObjectAbsent, OtherType
from drivers.canopen.units import Codec, codec, velocity_unit
from drivers.commission.identity import rated_torque
from drivers.commission.quiet import Node
from drivers.commission.sheet import Row
from drivers.errors import LimitExceeded, WrongConfiguration

POLARITY = Entry(0x607E, 0, "B", "polarity")
GEAR_MOTOR = Entry(0x6091, 1, "I", "gear ratio, motor revolutions")
GEAR_SHAFT = Entry(0x6091, 2, "I", "gear ratio, shaft revolutions")
_READINGS = 10  # of the speed at rest
_ROUNDING = 1e-3  # of a limit
STEPS = 20  # of the velocity unit in a line of a sweep, as the adapter wants them
MOST_EFFORT = 32.767  # of the rated torque: 16 bits of per mille
COARSE = 0.1  # of the velocity limit: beyond that no line of so many steps is of use


def scale(node: Node) -> Iterator[Row]:
    """What units, gear and polarity the drive tells itself."""
    polarity = node.listed(POLARITY)
    if polarity is not None:
        word = f"607Eh is {polarity:02X}h: the drive turns signs of position and speed, not of torque; it must be 0"
        yield node.row("polarity", polarity == 0, word if polarity else "607Eh turns no sign")
    yield from _gear(node)
    yield from _fixed_increments(node)
    yield from _fixed_velocity(node)


def conversions(node: Node) -> tuple[Codec | None, list[Row]]:
    """The axis' units as the drive holds them now; no codec where they are not understood, and the row that says so."""
    try:
        found = codec(node.axis, node.map.units, rated_torque(node) or node.axis.rated_torque, node.read)
    except (ObjectAbsent, OtherType):
        return None, []  # `objects` tells it
    except WrongConfiguration as error:
        return None, [node.row("units", False, f"not understood: {error}")]
    except ZeroDivisionError:
        found = None
    if found is None or not (math.isfinite(found.increments) and found.increments > 0):
        return None, [node.row("increments", False, "the drive has 0 increments a motor revolution")]
    return found, []


def at_rest(node: Node, units: Codec) -> Iterator[Row]:
    """Where the axis stands, and the noise of its speed."""
    axis = node.axis
    low, high = axis.position_limits
    raw = node.of_map("position")
    if raw is not None:
        place = float(units.position(raw))
        what = f"the axis is at {place:.5g} {axis.unit}, position_limits are {low:g} to {high:g} {axis.unit}"
        hint = (
            "" if low <= place <= high else ": position_offset, gear_ratio, increments, or an encoder never referenced"
        )
        yield node.row("position", low <= place <= high, what + hint)
    entry = node.map.entry("velocity")
    try:
        speeds = [abs(float(units.velocity(node.sdo.read(entry)))) for _ in range(_READINGS)]
    except WrongConfiguration:
        return  # `objects` tells it
    yield node.row(
        "standstill",
        max(speeds) <= axis.standstill_velocity,
        f"at rest up to {max(speeds):.3g} {axis.unit}/s is read, standstill_velocity is {axis.standstill_velocity:g}",
    )


def limits(node: Node, units: Codec) -> Iterator[Row]:
    """The profile's limits inside of those that the drive was commissioned with."""
    if configured_before(node):
        yield node.note(
            "drive-limits", "the drive holds limits of an earlier connection: power it off and on to compare its own"
        )
        return
    axis = node.axis
    try:
        speed, fastest = units.raw_speed(axis.velocity_limit), units.raw_max_speed(axis.velocity_limit)
        effort, window = units.raw_effort_limit(axis.effort_limit), units.raw_window(axis.position_limits)
    except LimitExceeded as error:
        yield node.row("limits", False, f"in drive units: {error}: gear_ratio or units")
        return
    most = MOST_EFFORT * units.rated_torque * abs(axis.gear_ratio)
    if axis.effort_limit > most:
        what = f"effort_limit {axis.effort_limit:g} {axis.effort_unit} is beyond {most:.4g}, all that 6077h can tell"
        yield node.row("effort-limit", False, f"{what}: limit or gear_ratio")
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


def resolution(node: Node, units: Codec) -> Iterator[Row]:
    """Whether a small sine is more than stairs; with the velocity unit that holds in the session."""
    least, limit = STEPS * abs(float(units.velocity(1.0))), node.axis.velocity_limit
    unit = f"{node.axis.unit}/s"
    what = f"lines from {least:.3g} {unit} on have {STEPS} steps of the drive's velocity unit"
    yield node.row("velocity-unit", least <= COARSE * limit, f"{what}; velocity_limit is {limit:g} {unit}")


def configured_before(node: Node) -> bool:
    """Whether `sweepid` has configured the drive since its power came on: it expects our own heartbeat."""
    bus = node.machine.bus
    return node.value(HEARTBEAT_CONSUMER) == bus.host_node << 16 | round(bus.host_timeout * 1e3)


def _gear(node: Node) -> Iterator[Row]:
    motor, shaft = node.listed(GEAR_MOTOR), node.listed(GEAR_SHAFT)
    if not motor or not shaft:
        return
    held, ratio = motor / shaft, abs(node.axis.gear_ratio)
    joint_side = node.map.units.side == "joint"
    fits = held == 1 or (joint_side and math.isclose(held, ratio, rel_tol=1e-6))
    wanted = f"the profile's {ratio:g}, or 1" if joint_side else "1, for the map counts on the motor side"
    yield node.row("gear", fits, f"6091h has {held:g} motor revolutions a shaft revolution; it must be {wanted}")


def _fixed_increments(node: Node) -> Iterator[Row]:
    """A number in map or profile beside an object that tells it."""
    units = node.map.units
    given = node.axis.increments if units.increments == "profile" else units.increments
    if isinstance(given, str) or given is None or "increments" in node.missing:
        return
    held, turns = node.listed(INCREMENTS), node.listed(MOTOR_REVOLUTIONS)
    if held:
        found = held / max(1, turns or 1)
        yield node.row("increments", found == given, f"608Fh has {found:g} a revolution, map or profile {given:g}")


def _fixed_velocity(node: Node) -> Iterator[Row]:
    unit = SPEEDS.get(node.map.units.velocity)
    code = node.listed(VELOCITY_UNIT)
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


def _beyond(node: Node, check: str, entry: Entry, wanted: int, held: int) -> Row:
    what = f"{entry}: the drive holds {held}, the profile's limit is {wanted} of its units"
    fits = wanted <= held * (1 + _ROUNDING) + 1
    return node.row(
        check, fits, what if fits else f"{what}, {wanted / held:.3g} times as much: limit, gear_ratio or unit"
    )


def _inside(node: Node, wanted: tuple[int, int], held: tuple[int, int]) -> Row:
    what = f"607Dh: the drive holds {held[0]} to {held[1]}, position_limits are {wanted[0]} to {wanted[1]} of its units"
    room = _ROUNDING * (held[1] - held[0]) + 1

    def within(low: int, high: int) -> bool:
        return low >= held[0] - room and high <= held[1] + room

    if within(*wanted):
        return node.row("position-limits", True, what)
    if within(-wanted[1], -wanted[0]):
        return node.row("sign", False, f"{what}: they fit the other way round, so the sign of gear_ratio is wrong")
    return node.row("position-limits", False, f"{what}: limits, gear_ratio, increments or position_offset")
