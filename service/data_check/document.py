"""Findings as JSON-able data: what `sweepid check --json` writes."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from service.data_check.finding import Finding, untrustworthy
from service.model.recording import Sweep
from service.model.robot import Robot


def findings_document(robot: Robot, sweeps: Sequence[Sweep], findings: Sequence[Finding]) -> dict[str, Any]:
    """`findings`, and for each axis that was swept whether its data can be trusted."""
    joints = {sweep.spec.axis for sweep in sweeps}
    return {
        "findings": [asdict(one) | {"sweeps": list(one.sweeps)} for one in findings],
        "axes": {
            joint: {
                "sweeps": sum(sweep.spec.axis == joint for sweep in sweeps),
                "trustworthy": not untrustworthy(findings, joint),
                "codes": sorted({one.code for one in findings if one.axis in (None, joint)}),
            }
            for joint in robot.joints
            if joint in joints
        },
    }
