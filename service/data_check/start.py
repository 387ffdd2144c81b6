"""Check that a recording starts at the position of the axis in bundle.json."""

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.record import AxisRecords, Record


def start(axis: AxisRecords) -> list[Finding]:
    """Recordings that start at the position of another joint (wrong axis), or at an unknown position (wrong pose)."""
    elsewhere = axis.those(lambda record: abs(_first(record) - record.spec.pose[axis.index]) > _room(record))
    others = {
        joint: [record for record in elsewhere if abs(_first(record) - record.spec.pose[k]) <= _room(record)]
        for k, joint in enumerate(axis.robot.joints)
        if k != axis.index
    }
    joint = max(others, key=lambda name: len(others[name]), default=None)
    theirs = others[joint] if joint is not None and 2 * len(others[joint]) > len(elsewhere) else []
    rest = [record for record in elsewhere if record not in theirs]
    findings: list[Finding] = []
    if theirs:
        ids = tuple(record.id for record in theirs)
        findings.append(
            Finding(
                "wrong_axis", "wrong", axis.joint, ids, _first(theirs[0]), theirs[0].spec.pose[axis.index],
                f"{axis.joint}, {named(ids)}: position starts at {_first(theirs[0]):.4g}, where {joint} stands; "
                f"{axis.joint} stands at {theirs[0].spec.pose[axis.index]:.4g}.",
                f"Check whether these recordings are of {joint}: the columns, or `axis` in bundle.json.",
            )
        )  # fmt: skip
    if rest:
        ids, worst = tuple(record.id for record in rest), rest[0]
        pose = worst.spec.pose[axis.index]
        degrees = bool(not axis.prismatic and abs(np.radians(pose) - _first(worst)) <= _room(worst))
        findings.append(
            Finding(
                "wrong_pose", "wrong", axis.joint, ids, _first(worst), pose,
                f"{axis.joint}, {named(ids)}: position starts at {_first(worst):.4g}, but `pose` says {pose:.4g}"
                f"{' (in degrees?)' * degrees}.",
                "Check `pose`, the zero of the encoder, and that the recording belongs to this sweep and axis.",
            )
        )  # fmt: skip
    return findings


def _first(record: Record) -> float:
    return float(record.sweep.recording.position[0])


def _room(record: Record) -> float:
    """Tolerance, rad (m): a record may start with its window, after a run-up of about the same duration."""
    # 0.02 rad (m): possible difference by zero offsets and rounding of poses
    return 0.02 + float(np.ptp(record.sweep.recording.position)) * (record.spec.excitation != "standstill")
