"""Torque ripple in the motor angle: are its orders those of the robot file, with its gear ratio?

The lines are those of `ripple_lines`. They have one phase in all poses, so they come from the motor.
"""

from collections.abc import Sequence

import numpy as np

from service.data_check.finding import Finding
from service.data_check.mechanics.ripple_lines import CHANCE, SAME, Line, ripple_lines
from service.data_check.record import AxisRecords
from service.identification.spectra.frequency_response import ripple_orders

SIDE = (1.0, 2.0)  # an eccentric rotor gives weaker lines at this distance from a line of order o


def ripples(axis: AxisRecords) -> list[Finding]:
    """Findings: a gear ratio with which the known orders are too high or too low, and unknown orders."""
    lines = ripple_lines(axis)
    return [*_ratio(axis, lines), *_unknown(axis, lines)]


def _ratio(axis: AxisRecords, lines: Sequence[Line]) -> list[Finding]:
    """From the strongest line of a known order, if its phases do not agree with that order."""
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
    """Factor by which the gear ratio is wrong; None if it is correct."""
    line = next((line for line in lines if line.known is not None), None)
    if line is None or line.known is None:
        return None
    scale, off = line.order / line.known, abs(line.order - line.known)
    # 0.25 of the order resolution over the range of the axis
    clear = off > 0.25 * line.resolved and line.as_known - line.chance > -np.log(CHANCE)
    # 5e-4 of the gear ratio: a larger difference is reported
    return scale if abs(scale - 1) > 5e-4 and clear else None


def _unknown(axis: AxisRecords, lines: Sequence[Line]) -> list[Finding]:
    """Lines that are neither in the robot file nor side lines of a stronger one."""
    whole = 0.02  # tolerance: orders of a motor are whole numbers (magnets, teeth)
    scale, findings = _scale(lines) or 1.0, list[Finding]()
    known = list(ripple_orders(axis.axis))
    for line in lines:
        order = line.order / scale
        near = [one for one in known if abs(order / one - 1) < SAME]
        beside = [one for one in known for side in SIDE if abs(abs(order - one) - side) < whole * max(1.0, one / 20)]
        # 0.001 of rated effort, RMS: one step of typical drives
        # 0.25 of the strongest line: a weaker one may be caused by the drive from that one
        if near or beside or line.rms < max(0.001 * axis.axis.rated_effort, 0.25 * lines[0].rms):
            continue
        if abs(order - round(order)) > whole * max(1.0, order / 20):
            continue
        order = float(round(order))
        known.append(order)
        # 5.0 order: below, transmission error of the gear; above, cogging of the motor
        kind = "transmission" if order < 5.0 else "cogging"
        findings.append(
            Finding(
                "ripple_order", "warning", axis.joint, (), order, None,
                f"{axis.joint}: effort ripples {order:.6g} times a motor turn ({line.rms:.3g} {axis.unit} RMS, one "
                "phase in all poses), which the robot file does not know.",
                f"Add it to {kind}_orders of the robot file.",
            )
        )  # fmt: skip
    return findings
