"""Checks that the node is the drive of the profile, at rest and without energy."""

import math
from collections.abc import Iterator

from drivers.canopen import objects
from drivers.canopen.profile import CanopenAxis
from drivers.cia402 import states
from drivers.cia402.states import State
from drivers.commission.read_only_drive import Node
from drivers.commission.sheet import Row

_WORDS = (objects.VENDOR, objects.PRODUCT, objects.REVISION, objects.SERIAL)
_NAMES = ("vendor", "product", "revision", "serial")
_ENERGISED = {State.SWITCHED_ON, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION}
_LIKE = 2e-3  # tolerance of the rated torque, as at connect


def state(node: Node) -> Iterator[Row]:
    """The drive has no energy and no fault, and its fieldbus controls it."""
    word = node.of_map("statusword")
    if word is None:
        return  # reported by `objects`
    found = states.decode(word)
    if found in _ENERGISED:
        yield node.row(
            "energy", False, f"the drive is in '{found.value}' and this program did not enable it: disable the drive"
        )
    elif found in (State.FAULT, State.UNKNOWN):
        code = node.of_map("error_code")
        yield node.row(
            "fault", False, f"the drive is in '{found.value}'" + ("" if code is None else f", error {code:04X}h")
        )
    else:
        yield node.row("energy", True, f"none: '{found.value}'")
    remote = bool(word & states.REMOTE)
    what = f"statusword {word:04X}h: bit 9 (remote) is {remote:d}"
    yield node.row(
        "remote", remote, what if remote else f"{what}: the drive does not obey the fieldbus: end its local mode"
    )


def who(node: Node) -> Iterator[Row]:
    """Type, 1018h and rated torque. A drive that fits another axis of the profile is reported as swapped."""
    kind = node.value(objects.DEVICE_TYPE)
    fits = kind is not None and kind & 0xFFFF == objects.SERVO_DRIVE
    yield node.row("device-type", fits, f"1000h is {_hex(kind)}, a CiA 402 drive ends in 0192h")
    found = [node.value(entry) for entry in _WORDS]
    torque = rated_torque(node)
    wrong = [*_different(node.axis, found)]
    for name, have, want in zip(_NAMES, found, _wanted(node.axis), strict=True):
        if want is None:
            yield node.note(
                name, f"{_hex(have)}; the profile has none, so a swapped drive of this type is not detected"
            )
        else:
            yield node.row(name, name not in wrong, f"the drive reports {_hex(have)}, the profile has {_hex(want)}")
    if torque is None:
        who_does = node.missing.get("rated_torque", "the drive does not report it")
        yield node.host("rated-torque", f"{node.axis.rated_torque:.4g} N m is not compared: {who_does}")
    else:
        yield node.row(
            "rated-torque",
            _alike(torque, node.axis),
            f"6076h: the motor has {torque:.4g} N m, the profile {node.axis.rated_torque:.4g} N m",
        )
    if wrong or (torque is not None and not _alike(torque, node.axis)):
        yield from _swapped(node, found, torque)


def rated_torque(node: Node) -> float | None:
    """Rated torque of the motor stored in the drive, N m; None if it is not reported."""
    raw = node.of_map("rated_torque")
    return None if raw is None else raw * node.map.units.rated_torque


def _swapped(node: Node, found: list[int | None], torque: float | None) -> Iterator[Row]:
    for other in node.machine.axes:
        if other is node.axis or _different(other, found) or (torque is not None and not _alike(torque, other)):
            continue
        yield node.row(
            "swapped-nodes",
            False,
            f"node {node.axis.node} answers as the drive of {other.joint} (node {other.node}): node numbers or cables",
        )


def _wanted(axis: CanopenAxis) -> tuple[int | None, ...]:
    identity = axis.identity
    return identity.vendor, identity.product, identity.revision, identity.serial


def _different(axis: CanopenAxis, found: list[int | None]) -> list[str]:
    pairs = zip(_NAMES, found, _wanted(axis), strict=True)
    return [name for name, have, want in pairs if want is not None and have != want]


def _alike(torque: float, axis: CanopenAxis) -> bool:
    return math.isclose(torque, axis.rated_torque, rel_tol=_LIKE)


def _hex(value: int | None) -> str:
    return "nothing" if value is None else f"{value:08X}h"
