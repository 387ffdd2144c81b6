"""The robot file by itself and compared with recordings: gravity, prior, rated effort, limits, null values."""

import numpy as np

from service.data_check.finding import DataFinding, named
from service.data_check.record import AxisRecords
from service.model import Robot

EARTH = (9.7, 9.9)  # m/s^2, 9.76 to 9.84 on the ground; a tilted base does not change the magnitude


def description(robot: Robot) -> list[DataFinding]:
    """Errors of the robot file that need no recordings."""
    tightest = 1e-4
    widest = 1.0  # relative standard deviation: a larger one is no information (or is in percent)
    findings: list[DataFinding] = []
    length = float(np.linalg.norm(robot.gravity))
    if length and not EARTH[0] <= length <= EARTH[1]:
        findings.append(
            DataFinding(
                "gravity", "wrong", None, (), length, EARTH[1],
                f"gravity of the robot file is {length:.5g} long; on earth it is 9.81 m/s^2.",
                "Give gravity in m/s^2 in the base frame, or zeros for a robot without weight on its axes.",
            )
        )  # fmt: skip
    for name, value in robot.prior.model_dump().items():
        if not (value <= widest and (value >= tightest or name == "effort_gain")):
            findings.append(
                DataFinding(
                    "prior", "warning", None, (), value, widest if value > widest else tightest,
                    f"prior.{name} is {value:g}; it is a relative standard deviation, {tightest:g} to {widest:g}.",
                    "Give the prior as parts of one, 0.3 for 30 %.",
                )
            )  # fmt: skip
    return findings


def nominals(axis: AxisRecords) -> list[DataFinding]:
    """Null values that sweeps with lines need, and poses outside the limits of the URDF."""
    room = 0.02  # rad (m) beyond a limit
    findings: list[DataFinding] = []
    lines = axis.those(lambda record: record.turns and record.spec.periodic)
    unknown = [name for name in ("viscous_friction", "motor_inertia") if getattr(axis.axis, name) is None]
    if lines and unknown:
        findings.append(
            DataFinding(
                "missing_nominal", "warning", axis.joint, (), None, None,
                f"{axis.joint}: {' and '.join(unknown)} of the robot file {'is' if len(unknown) == 1 else 'are'} null.",
                "Take them from the data sheets: sweeps with sines tell the motor from the load by them.",
            )
        )  # fmt: skip
    joint = axis.robot.chain.joints[axis.index]
    outside = axis.those(lambda record: not joint.lower - room <= record.spec.pose[axis.index] <= joint.upper + room)
    if outside:
        ids, value = tuple(record.id for record in outside), outside[0].spec.pose[axis.index]
        limit = joint.upper if value > joint.upper else joint.lower
        findings.append(
            DataFinding(
                "outside_limits", "wrong", axis.joint, ids, value, limit,
                f"{axis.joint}, {named(ids)}: `pose` says {value:.4g}, beyond the URDF's limit {limit:.4g}.",
                "Check the unit and the zero of `pose`, and the limits of the URDF.",
            )
        )  # fmt: skip
    return findings


def rated_effort(axis: AxisRecords) -> list[DataFinding]:
    """Recorded effort that is impossibly large or small for the rated effort. Only used if inertia is plausible."""
    under = 0.002  # of the rated effort: each moving axis needs more
    over = 5.0  # times the rated effort: no drive gives more
    moving = axis.those(lambda record: record.travels)
    if not moving:
        return []
    largest = float(np.max([np.percentile(np.abs(record.effort), 99.5) for record in moving]))
    share = largest / axis.axis.rated_effort
    if under <= share <= over:
        return []
    return [
        DataFinding(
            "rated_effort", "wrong", axis.joint, tuple(record.id for record in moving), share,
            over if share > over else under,
            f"{axis.joint}: recorded effort reaches {largest:.4g} {axis.unit}, {share:.3g} times rated_effort "
            f"{axis.axis.rated_effort:g}, while inertia fits.",
            f"Give rated_effort in {axis.unit} on the joint side.",
        )
    ]  # fmt: skip
