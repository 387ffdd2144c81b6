"""Torque that ripples with the motor's angle: at orders that the robot file knows, and with its gear ratio?

The lines are those of `ripple_lines`: one phase in all poses, so they are of the motor and of no other thing.
"""

from collections.abc import Sequence

import numpy as np

from service.data_check.finding import Finding
from service.data_check.mechanics.ripple_lines import CHANCE, SAME, Line, ripple_lines
from service.data_check.record import AxisRecords
from service.identification.spectra.frequency_response import ripple_orders

LEAST = 0.001  # of rated effort, RMS: one step of a common drive
RATIO = 5e-4  # of the gear ratio: a difference that is told
WHOLE = 0.02  # magnets and teeth are counted: the orders of a motor are whole numbers
SIDE = (1.0, 2.0)  # an eccentric rotor turns a line of order o into weaker ones beside it
TRANSMISSION = 5.0  # below this order it is the gear that turns unevenly, above it the motor's magnets
APART = 0.25  # of the order that the range of the axis tells apart
WEAKER = 0.25  # of the strongest: less may be what the drive makes of that one


def ripples(axis: AxisRecords) -> list[Finding]:
    """A gear ratio with which the known orders repeat too often or too seldom, and unknown orders."""
    lines = ripple_lines(axis)
    return [*_ratio(axis, lines), *_unknown(axis, lines)]


def _ratio(axis: AxisRecords, lines: Sequence[Line]) -> list[Finding]:
    """Told by the strongest line of a known order, where its phases do not fit at all that order itself."""
    scale = _scale(lines)
    if scale is None:
        return []
    line, given = next(line for line in lines if line.known is not None), axis.axis.gear_ratio
    return [
        Finding(
            "gear_ratio", "warning", axis.joint, (), given * scale, given,
            f"{axis.joint}: the ripple of order {line.known:g} ({line.rms:.3g} {axis.unit}) repeats {scale:.5f} times "
            f"as often as the robot file's gear ratio {given:g} says; {given * scale:.6g} fits in all poses.",
            "Check the gear ratio in the robot file and in the drive.",
        )
    ]  # fmt: skip


def _scale(lines: Sequence[Line]) -> float | None:
    """By which the gear ratio is off; None where it is not."""
    line = next((line for line in lines if line.known is not None), None)
    if line is None or line.known is None:
        return None
    scale, off = line.order / line.known, abs(line.order - line.known)
    clear = off > APART * line.resolved and line.as_known - line.chance > -np.log(CHANCE)
    return scale if abs(scale - 1) > RATIO and clear else None


def _unknown(axis: AxisRecords, lines: Sequence[Line]) -> list[Finding]:
    """Those that are neither of the robot file nor beside a stronger one."""
    scale, findings = _scale(lines) or 1.0, list[Finding]()
    known = list(ripple_orders(axis.axis))
    for line in lines:
        order = line.order / scale
        near = [one for one in known if abs(order / one - 1) < SAME]
        beside = [one for one in known for side in SIDE if abs(abs(order - one) - side) < WHOLE * max(1.0, one / 20)]
        if near or beside or line.rms < max(LEAST * axis.axis.rated_effort, WEAKER * lines[0].rms):
            continue
        if abs(order - round(order)) > WHOLE * max(1.0, order / 20):
            continue
        order = float(round(order))
        known.append(order)
        kind = "transmission" if order < TRANSMISSION else "cogging"
        findings.append(
            Finding(
                "ripple_order", "warning", axis.joint, (), order, None,
                f"{axis.joint}: effort ripples {order:.6g} times a motor turn ({line.rms:.3g} {axis.unit} RMS, one "
                "phase in all poses), which the robot file does not know.",
                f"Add it to {kind}_orders of the robot file.",
            )
        )  # fmt: skip
    return findings
